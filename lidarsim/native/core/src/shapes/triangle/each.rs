//! One triangle per ray of a register.

use super::normal_through;
use crate::arith::number::{Lanes, OfRays};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Vector, of_rays};
use crate::shapes::newton::Target;

/// One triangle per ray, by corner and axis.
pub struct Triangles<F>(pub [[F; 3]; 3]);

/// As for `Triangle`.
impl<L: Lanes<N>, const N: usize> Target<L, N> for Triangles<L::Floats> {
    #[inline(always)]
    fn implicit<K: OfRays<L, N>>(&self, ray: &Ray<K>, feature: u8, lanes: L) -> K {
        let from = ray.origin_from(of_rays(self.0[0], lanes));
        vector::dot(&self.normal(ray, feature, lanes), &from).doubled()
    }

    #[inline(always)]
    fn normal<K: OfRays<L, N>>(&self, _: &Ray<K>, _: u8, lanes: L) -> Vector<K> {
        let [a, b, c] = self.0;
        normal_through(&of_rays(a, lanes), &of_rays(b, lanes), &of_rays(c, lanes))
    }
}
