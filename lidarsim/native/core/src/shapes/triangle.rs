//! Triangle: the signs of d·(c × b), d·(a × c), d·(b × a), with a, b, c seen from the origin of the ray.
//!
//! Each is six times the volume of a tetrahedron between the ray and an edge. An edge that two triangles share gives both
//! the same number with opposite signs, and the signs are exact: so no ray slips through between them
//! (S. Woop, C. Benthin, I. Wald, Watertight Ray/Triangle Intersection, JCGT 2013, has the same signs after a shear).

use std::cmp::Ordering;

use super::Surface;
use super::plane::triangle_normal;
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::{Root, Roots};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

#[derive(Clone, Copy, Debug)]
pub struct Triangle(pub Point, pub Point, pub Point);

impl Triangle {
    /// Whether the three vertices lie on one line, exactly.
    pub fn is_degenerate(&self) -> bool {
        struct Degenerate<'a>(&'a Triangle);
        impl crate::arith::number::Question for Degenerate<'_> {
            type Answer = bool;
            fn ask<N: Number<Floats = f64>>(&self) -> Result<bool, Uncertain> {
                let Triangle(a, b, c) = *self.0;
                // A certain non-zero settles it; an uncertain one does not unless all others are zero.
                let signs = triangle_normal::<N>(a, b, c).map(|x| x.is_zero());
                if signs.contains(&Ok(false)) { Ok(false) } else { Ok(signs[0]? && signs[1]? && signs[2]?) }
            }
        }
        crate::arith::number::certify(&Degenerate(self))
    }
}

impl Surface for Triangle {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let a = vector::negated(&ray.origin_from(vector::exact(self.0)));
        let b = vector::negated(&ray.origin_from(vector::exact(self.1)));
        let c = vector::negated(&ray.origin_from(vector::exact(self.2)));
        let d = &ray.direction;
        // Outside as soon as two signs differ, whatever the third may be.
        let mut positive = false;
        let mut negative = false;
        let mut unsure = false;
        for (p, q) in [(&c, &b), (&a, &c), (&b, &a)] {
            match vector::dot(d, &vector::cross(p, q)).sign() {
                Ok(sign) => {
                    positive |= sign == Ordering::Greater;
                    negative |= sign == Ordering::Less;
                }
                Err(Uncertain) => unsure = true,
            }
        }
        if positive && negative {
            return Ok([None, None]);
        }
        if unsure {
            return Err(Uncertain);
        }
        let normal: Vector<N> = triangle_normal(self.0, self.1, self.2);
        Ok([Root::ratio(vector::dot(&normal, &a), vector::dot(&normal, d), 0)?, None])
    }

    #[inline(always)]
    fn level<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
        vector::dot(&self.normal(ray, feature), &ray.origin_from(vector::exact(self.0))).doubled()
    }

    #[inline(always)]
    fn normal<N: Number>(&self, _: &Ray<N>, _: u8) -> Vector<N> {
        triangle_normal(self.0, self.1, self.2)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(std::array::from_fn(|i| Interval {
            low: self.0[i].min(self.1[i]).min(self.2[i]),
            high: self.0[i].max(self.1[i]).max(self.2[i]),
        }))
    }
}
