//! Where hits are on the objects: in their own coordinates, and within the triangles of meshes.

use crate::arith::number::Interval;
use crate::geometry::affine::Inverse;
use crate::geometry::point::sub;
use crate::geometry::vector::Point;
use crate::scene::{Geometry, Hit, Scene, TimedRay};
use crate::shapes::triangle::barycentric;

impl Scene {
    /// The point of a hit in the object's own coordinates, rounded to float64.
    pub(super) fn place_on_object(&self, hit: &Hit, ray: &TimedRay) -> Point {
        let object = &self.objects()[hit.object as usize];
        let [o, d] = match object.inverse().and_then(Inverse::rounded) {
            _ if object.is_untransformed() => [ray.origin, ray.direction],
            Some(inverse) if object.motion().is_none() => {
                [inverse.points::<f64, 1>(ray.origin).0, inverse.vectors::<f64, 1>(ray.direction).0]
            }
            _ => object.at(ray.time).enclose(ray.origin, ray.direction).map(|point| point.map(middle)),
        };
        [0, 1, 2].map(|axis| o[axis] + hit.t * d[axis])
    }

    /// The vertices of the triangle of a mesh that was hit, and the barycentric coordinates of the hit.
    pub(super) fn barycentric(&self, hit: &Hit, ray: &TimedRay) -> Option<([u32; 3], [f64; 3])> {
        let object = self.at(hit.object as u32, ray.time);
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
