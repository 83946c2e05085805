//! The scene, as a measurement uses it.

use crate::arith::number::Interval;
use crate::arith::simd::Isa;
use crate::bvh::Stack;
use crate::cast::{self, Cast, Departure, HitArrays, SurfaceHit};
use crate::geometry::affine::Inverse;
use crate::geometry::point::sub;
use crate::geometry::pose::Path;
use crate::geometry::vector::Point;
use crate::scene::{Geometry, Hit, Rays, Sink, TRange, TimedRay, World};
use crate::shapes::triangle::barycentric;

/// Finds the surfaces that rays hit.
pub trait Caster: Sync {
    /// Whether any surface moves, so that rays need times.
    fn moves(&self) -> bool;

    /// Writes the closest hit with t ≥ 0 of each ray, at its time.
    fn cast<I: Isa>(&self, rays: Rays, hits: &mut HitArrays);

    /// Writes any hit with 0 ≤ t ≤ 1 of each ray that has one.
    fn find_any<I: Isa>(&self, rays: Rays, hits: &mut impl Sink);

    /// The vertices of the triangle of a mesh that was hit, and the barycentric coordinates of the hit.
    fn barycentric(&self, hit: &Hit, ray: &TimedRay) -> Option<([u32; 3], [f64; 3])>;

    /// The point of a hit in the object's own coordinates, rounded to float64.
    fn local(&self, hit: &Hit, ray: &TimedRay) -> Point;

    /// The next hit of a ray (see [`next_hit`](crate::cast::next_hit)).
    fn next_hit(
        &self,
        passing: &Self,
        solid: &Hit,
        ray: &TimedRay,
        from: &Departure,
        stack: &mut Stack,
    ) -> Option<SurfaceHit>;

    /// The motion of an object, if it moves.
    fn path(&self, object: i32) -> Option<&Path>;
}

impl Caster for World<'_> {
    fn moves(&self) -> bool {
        self.scene.moves()
    }

    #[inline(always)]
    fn cast<I: Isa>(&self, rays: Rays, hits: &mut HitArrays) {
        // The rays are legal: the pulses have been checked.
        I::call(Cast { world: self, rays, range: TRange::RAY, hits: &mut hits.columns() });
    }

    #[inline(always)]
    fn find_any<I: Isa>(&self, rays: Rays, hits: &mut impl Sink) {
        I::call(Cast { world: self, rays, range: TRange { min: 0.0, max: 1.0 }, hits });
    }

    fn next_hit(
        &self,
        passing: &Self,
        solid: &Hit,
        ray: &TimedRay,
        from: &Departure,
        stack: &mut Stack,
    ) -> Option<SurfaceHit> {
        cast::next_hit(self, passing, solid, ray, from, stack)
    }

    fn path(&self, object: i32) -> Option<&Path> {
        self.scene.objects()[object as usize].motion()
    }

    fn local(&self, hit: &Hit, ray: &TimedRay) -> Point {
        let object = &self.scene.objects()[hit.object as usize];
        let [o, d] = match object.inverse().and_then(Inverse::rounded) {
            _ if object.is_untransformed() => [ray.origin, ray.direction],
            Some(inverse) if object.motion().is_none() => {
                [inverse.points::<f64, 1>(ray.origin).0, inverse.vectors::<f64, 1>(ray.direction).0]
            }
            _ => object.at(ray.time).enclose(ray.origin, ray.direction).map(|point| point.map(middle)),
        };
        [0, 1, 2].map(|axis| o[axis] + hit.t * d[axis])
    }

    fn barycentric(&self, hit: &Hit, ray: &TimedRay) -> Option<([u32; 3], [f64; 3])> {
        let object = self.scene.at(hit.object as u32, ray.time);
        let Geometry::Mesh(mesh) = &object.geometry else { return None };
        let vertices = mesh.faces()[hit.primitive as usize];
        let [o, d] = object.enclose(ray.origin, ray.direction);
        // Relative to the hit, a triangle far from the origin of coordinates keeps its digits.
        let along = d.map(|x| hit.t * middle(x));
        let corners = vertices.map(|v| sub(sub(mesh.vertices()[v as usize], o.map(middle)), along));
        Some((vertices, barycentric(corners)))
    }
}

fn middle(x: Interval) -> f64 {
    x.low + 0.5 * (x.high - x.low)
}
