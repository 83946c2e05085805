//! Coincident surfaces: roots whose order follows from the construction of the scene, for any ray. Objects
//! stand on floors and meshes are exported twice, so such ties are common, and would all need exact
//! arithmetic.

use std::cmp::Ordering;
use std::sync::Arc;

use super::object::with_shape;
use super::{Geometry, Object, RootId};
use crate::arith::root::TOUCHING;
use crate::geometry::axis_plane::AxisPlane;
use crate::shapes::Surface;

/// The order of two roots on a line, if it follows from the numbers that define their objects.
pub fn order(x: &Object, a: &RootId, y: &Object, b: &RootId) -> Option<Ordering> {
    if x.is_placed_as(y) {
        // A line has the same coordinates in both objects, so equal surfaces have the same roots.
        if are_same_surface(x, a, y, b) {
            let place = |root: &RootId| if root.index == TOUCHING { 0 } else { root.index };
            return Some(place(a).cmp(&place(b)));
        }
        let plane = local_plane(x, a);
        if plane.is_some() && plane == local_plane(y, b) {
            return Some(Ordering::Equal);
        }
        if x.is_untransformed() {
            return None;
        }
    }
    let plane = world_plane(x, a);
    (plane.is_some() && plane == world_plane(y, b)).then_some(Ordering::Equal)
}

/// Whether both roots are on equal surfaces, or on triangles with the same corners.
fn are_same_surface(x: &Object, a: &RootId, y: &Object, b: &RootId) -> bool {
    match (&x.geometry, &y.geometry) {
        (Geometry::Mesh(mesh), Geometry::Mesh(other))
            if Arc::ptr_eq(mesh, other) && a.primitive == b.primitive =>
        {
            true
        }
        (Geometry::Spheres(spheres), Geometry::Spheres(others)) => {
            spheres.row(a.primitive) == others.row(b.primitive)
        }
        (Geometry::Disks(disks), Geometry::Disks(others)) => {
            disks.row(a.primitive) == others.row(b.primitive)
        }
        (Geometry::Surface(surface), Geometry::Surface(other)) if surface == other => true,
        _ => {
            x.is_triangle()
                && y.is_triangle()
                && x.triangle(a.primitive).has_corners_of(&y.triangle(b.primitive))
        }
    }
}

/// The plane perpendicular to an axis that contains this root's part of the surface, in the coordinates of
/// the object.
fn local_plane(object: &Object, at: &RootId) -> Option<AxisPlane> {
    with_shape!(&object.geometry, at.primitive, shape => shape.axis_plane(at.feature))
}

/// As `local_plane`, in world coordinates, for objects that do not move.
fn world_plane(object: &Object, at: &RootId) -> Option<AxisPlane> {
    if object.motion().is_some() {
        return None;
    }
    object.maps().iter().try_fold(local_plane(object, at)?, |plane, map| map.image_of_plane(plane))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number;
    use crate::geometry::affine::Affine;
    use crate::geometry::vector::Point;
    use crate::scene::TimedRay;
    use crate::scene::predicates::{RootIntervals, RootOn, RootOrder};
    use crate::scene::tests::{FLAT, object, tipped};
    use crate::shapes::{AnySurface, Box, Capsule, Cylinder, Disk, Ellipsoid, Plane, Sphere, Triangle};
    use crate::testing::numbers;

    const TURN: [[f64; 3]; 3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    const SKEW: [[f64; 3]; 3] = [[0.5, 0.25, -1.0], [0.0, 2.0, 0.125], [1.0, 0.0, 0.75]];

    fn of(surface: impl Into<AnySurface>) -> Object {
        Object::new(Geometry::Surface(surface.into()), false)
    }

    fn place(object: &Object, linear: [[f64; 3]; 3], offset: Point) -> Object {
        object
            .transformed(Affine::new(linear, offset))
            .unwrap_or_else(|| unreachable!("the map can be inverted"))
    }

    fn ground() -> Object {
        of(Plane::Distance { normal: [0.0, 0.0, 1.0], distance: 0.0 })
    }

    fn slab(thickness: f64) -> Object {
        of(Box::new([20.0, 20.0, thickness], [0.0; 3]))
    }

    fn cylinder(base: f64) -> Object {
        of(Cylinder { start: [1.0, 1.0, base], end: [1.0, 1.0, 3.0], radius: 4.0, capped: true })
    }

    fn capsule() -> Object {
        of(Capsule { start: [1.0, 1.0, -2.0], end: [0.5, 1.0, 2.0], radius: 3.0 })
    }

    fn disk(height: f64) -> Object {
        of(Disk { center: [1.0, 1.0, height], normal: [0.0, 0.0, -2.0], radius: 4.0 })
    }

    /// Compares `order` with exact arithmetic at each pair of roots, on rays into the middle of the objects.
    /// Returns how many pairs `order` called equal, how many it ordered, and how many are equal.
    fn check(x: &Object, y: &Object) -> [usize; 3] {
        let objects = [x.clone(), y.clone()];
        let mut next = numbers();
        let mut found = [0; 3];
        for _ in 0..300 {
            let mut point = |z: f64| {
                [0, 1, 2].map(|i| (16.0 * next()).round() / 4.0 - 2.0 + if i == 2 { z } else { 0.0 })
            };
            let (origin, target) = (point(9.0), point(0.0));
            let direction = [0, 1, 2].map(|i| target[i] - origin[i]);
            let ray = TimedRay { origin, direction, time: 0.0 };
            let roots = [0, 1].map(|id: u32| {
                let object = objects[id as usize].at(0.0);
                let primitives =
                    if let Geometry::Mesh(mesh) = &object.geometry { mesh.len() as u32 } else { 1 };
                let on = |primitive| {
                    let found = number::decide(&RootIntervals { object, id, primitive, ray });
                    found.into_iter().flatten().map(|(at, _)| at)
                };
                (0..primitives).flat_map(on).collect::<Vec<_>>()
            });
            for a in &roots[0] {
                for b in &roots[1] {
                    let told = order(x, a, y, b);
                    assert_eq!(told, order(y, b, x, a).map(Ordering::reverse));
                    let [a, b] = [(x, a), (y, b)].map(|(x, at)| RootOn { object: x.at(0.0), at, ray: &ray });
                    let exact = number::decide(&RootOrder([a, b]));
                    assert!(told.is_none_or(|told| told == exact), "{:?} {:?} {ray:?}", a.at, b.at);
                    found[0] += usize::from(told == Some(Ordering::Equal));
                    found[1] += usize::from(told.is_some_and(|told| told != Ordering::Equal));
                    found[2] += usize::from(exact == Ordering::Equal);
                }
            }
        }
        found
    }

    #[test]
    fn every_tie_of_coincident_surfaces_is_told() {
        let tipped = |z| object(tipped(z), 3);
        let (sphere, turned) =
            (of(Sphere { center: [0.0; 3], radius: 3.0 }), place(&slab(4.0), SKEW, [1.0, 0.5, 0.0]));
        let ellipsoid = Ellipsoid::new([1.0, 0.0, 0.0], [2.0, 4.0, 3.0], TURN).map(of);
        let bent = Triangle([0.0, 0.0, 1.0], [0.0, 8.0, 1.5], [8.0, 0.0, 1.0]);
        let mut pairs = vec![
            (sphere.clone(), sphere),
            (cylinder(-3.0), cylinder(-3.0)),
            (capsule(), capsule()),
            (place(&capsule(), SKEW, [0.5; 3]), place(&capsule(), SKEW, [0.5; 3])),
            (turned.clone(), turned),
            (tipped(1.5), tipped(1.5)),
            (place(&tipped(1.5), SKEW, [0.5; 3]), place(&tipped(1.5), SKEW, [0.5; 3])),
            // The same triangle in a mesh, and alone with its corners in another order.
            (tipped(1.5), of(bent)),
            (tipped(1.0), object(FLAT, 0)),
            // Floors, tops and caps in one plane.
            (ground(), of(Plane::PointNormal { point: [5.0, 7.0, 0.0], normal: [0.0, 0.0, -3.0] })),
            (ground(), of(Plane::Distance { normal: [0.0, -0.0, -3.0], distance: 0.0 })),
            (ground(), of(Plane::Points([0.0; 3], [1.0, 0.0, 0.0], [3.0, 2.0, 0.0]))),
            (ground(), of(Box::new([20.0, 20.0, 0.1], [0.0, 0.0, -0.05]))),
            (ground(), place(&slab(0.1), TURN, [0.0, 0.0, -0.05])),
            (ground(), place(&place(&slab(0.25), TURN, [0.0, 0.0, 1.0]), TURN, [0.0, 0.0, -1.125])),
            (
                of(Plane::PointNormal { point: [0.0, 9.0, 9.0], normal: [1.0, 0.0, 0.0] }),
                place(&of(FLAT), [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]], [1.0, -2.0, 0.0]),
            ),
            (ground(), cylinder(0.0)),
            (ground(), disk(0.0)),
            (disk(2.0), place(&slab(4.0), TURN, [0.0; 3])),
            (place(&ground(), SKEW, [0.0; 3]), place(&cylinder(0.0), SKEW, [0.0; 3])),
            (place(&tipped(1.0), SKEW, [0.0; 3]), place(&object(FLAT, 7), SKEW, [0.0; 3])),
            // The first is transformed to a place, the other is made there.
            (place(&object(FLAT, 2), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.1]], [0.0; 3]), {
                let Triangle(a, b, c) = FLAT;
                of(Triangle([a[0], a[1], 0.1], [b[0], b[1], 0.1], [c[0], c[1], 0.1]))
            }),
        ];
        pairs.extend(ellipsoid.map(|ellipsoid| (ellipsoid.clone(), ellipsoid)));
        assert_eq!(pairs.len(), 23);
        for (k, (x, y)) in pairs.iter().enumerate() {
            let [equal, _, ties] = check(x, y);
            assert!(equal > 10, "pair {k}: {equal}");
            // Except on lines through a rim, where two parts of a surface meet.
            assert!(10 * equal >= 9 * ties, "pair {k}: {equal} of {ties}");
        }
    }

    #[test]
    fn roots_of_one_surface_come_in_their_order() {
        let ordered =
            [cylinder(-3.0), capsule(), place(&slab(4.0), SKEW, [1.0, 0.5, 0.0])].map(|x| check(&x, &x)[1]);
        assert!(ordered.iter().all(|&ordered| ordered > 50), "{ordered:?}");
    }

    #[test]
    fn what_is_apart_by_a_rounding_is_left_to_arithmetic() {
        let near = 0.1_f64.next_up();
        for (x, y) in [
            (object(tipped(1.5), 2), object(tipped(1.5_f64.next_up()), 2)),
            (object(FLAT, 2), object(Triangle(FLAT.0, FLAT.1, [0.0, 8.0, 1.0_f64.next_down()]), 0)),
            (ground(), of(Box::new([20.0, 20.0, near], [0.0, 0.0, -0.05]))),
            (ground(), place(&slab(near), TURN, [0.0, 0.0, -0.05])),
            (ground(), disk(5e-324)),
            (ground(), place(&ground(), TURN, [0.0, 0.0, 5e-324])),
            (
                of(Sphere { center: [0.0; 3], radius: 3.0 }),
                of(Sphere { center: [0.0, 0.0, 5e-324], radius: 3.0 }),
            ),
            (place(&slab(4.0), SKEW, [1.0, 0.5, 0.0]), place(&slab(4.0), SKEW, [1.0, 0.5, 5e-324])),
            // In one plane, but not perpendicular to an axis.
            (
                of(Triangle([0.0; 3], [4.0, 0.0, 4.0], [0.0, 4.0, 4.0])),
                of(Triangle([0.0; 3], [8.0, 0.0, 8.0], [0.0, 8.0, 8.0])),
            ),
        ] {
            assert_eq!(check(&x, &y)[0], 0);
        }
    }
}
