//! The surface intersector: tests packets against implicit surfaces, one register of rays at a time. It
//! bounds roots in float64 with running errors; lanes that stay uncertain are decided ray by ray.

use std::cell::Cell;

use crate::arith::number::{Interval, Many, Number, RunningErrors, Uncertain};
use crate::arith::simd::{Floats, Isa, Task};
use crate::bvh::{LANES, Mask, RayPacket, part_of_mask, take};
use crate::cast::closest_hit::ClosestHits;
use crate::cast::local_rays::{LocalRays, OfRunningErrors, RayParts, WorldRays};
use crate::cast::poses::Poses;
use crate::geometry::affine::Placements;
use crate::geometry::ray::Ray;
use crate::scene::{Geometry, RootId};
use crate::shapes::{MOST_ROOTS, Surface, SurfaceTask};

/// The memory of intersections of packets with surfaces. Reused, as it is large.
pub struct SurfaceIntersector {
    local: LocalRays<LANES>,
    hits: SurfaceHits,
}

impl SurfaceIntersector {
    pub fn new() -> Self {
        let nothing = AgreeingLanes { eight: 0, lanes: 0, roots: [RootBounds::NONE; MOST_ROOTS], count: 0 };
        SurfaceIntersector {
            local: LocalRays::UNSET,
            hits: SurfaceHits { agreeing: [nothing; LANES], count: 0, unsure: 0 },
        }
    }
}

/// Intersects the rays of `mask` with an object and updates their closest hits. Returns the mask of rays
/// whose limits may have decreased.
pub struct IntersectSurface<'t, 'a> {
    pub surfaces: &'t mut SurfaceIntersector,
    pub rays: &'t RayPacket,
    pub closest: &'t mut ClosestHits<'a>,
    /// The poses of moving objects at the times of the rays.
    pub poses: &'t mut Poses<LANES>,
    pub id: u32,
    pub mask: Mask,
}

impl Task for IntersectSurface<'_, '_> {
    type Output = Mask;

    #[inline(always)]
    fn run<I: Isa>(self) -> Mask {
        let IntersectSurface { surfaces, rays, closest, poses, id, mask } = self;
        let SurfaceIntersector { local, hits } = surfaces;
        let scene = closest.scene();
        (hits.count, hits.unsure) = (0, mask);
        let object = &scene.objects()[id as usize];
        let alone = mask & (mask - 1) == 0;
        let mut filtered = false;
        if (!alone || object.motion().is_some())
            && let Geometry::Surface(shape) = &object.geometry
        {
            let t_min = closest.t_min();
            let then = poses.gather::<I>(scene, id, &rays.time, mask);
            let placements = Placements { first: object.inverse(), then };
            let world = WorldRays { origin: &rays.origin, direction: &rays.direction };
            filtered = if placements.is_identity() {
                shape.dispatch::<I, _>(BoundRoots { rays: world, t_min, hits }).is_some()
            } else {
                local.localize::<I, OfRunningErrors>(placements, world, mask, rays.one_origin)
                    && shape.dispatch::<I, _>(BoundRoots { rays: &*local, t_min, hits }).is_some()
            };
        }
        let root = |index: usize, feature| RootId { object: id, primitive: 0, index: index as u8, feature };
        let mut nearer = hits.unsure;
        for agreeing in &hits.agreeing[..hits.count] {
            let mut left = agreeing.lanes;
            for (index, roots) in agreeing.roots[..agreeing.count].iter().enumerate() {
                let t = Interval { low: I::F64x8::load(&roots.low), high: I::F64x8::load(&roots.high) };
                let accepted =
                    closest.accept_eight::<I>(rays, agreeing.eight, left, root(index, roots.feature), t);
                nearer |= Mask::from(accepted.nearer) << (8 * agreeing.eight);
                left = accepted.early;
            }
        }
        while let Some(lane) = take(&mut hits.unsure) {
            if filtered {
                closest.intersect_exactly(rays, lane, id, 0);
            } else {
                closest.intersect(rays, lane, id, 0);
            }
        }
        nearer
    }
}

/// The hits of a packet on a surface.
struct SurfaceHits {
    agreeing: [AgreeingLanes; LANES],
    count: usize,
    /// Rays to be decided one by one.
    unsure: Mask,
}

/// Lanes of the packet whose roots took the same branches.
#[derive(Clone, Copy)]
struct AgreeingLanes {
    /// The index of the eight lanes in the packet, and one bit for each.
    eight: usize,
    lanes: u32,
    /// The roots up to the first that is in or beyond the range in all lanes.
    roots: [RootBounds; MOST_ROOTS],
    count: usize,
}

/// Lanes of the widest register.
const WIDEST: usize = 8;

/// Bounds of one root per lane, for eight lanes on one part of the surface.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct RootBounds {
    low: [f64; WIDEST],
    high: [f64; WIDEST],
    feature: u8,
}

impl RootBounds {
    const NONE: RootBounds = RootBounds { feature: 0, low: [0.0; WIDEST], high: [0.0; WIDEST] };

    #[inline(always)]
    fn set<F: Floats<f64, N>, const N: usize>(&mut self, part: usize, feature: u8, t: Interval<F>) {
        self.feature = feature;
        self.low.as_chunks_mut().0[part] = t.low.store();
        self.high.as_chunks_mut().0[part] = t.high.store();
    }
}

/// Bounds the roots of the rays that are unsure in `hits`.
struct BoundRoots<'a, R> {
    rays: R,
    t_min: f64,
    hits: &'a mut SurfaceHits,
}

impl<R: RayParts> SurfaceTask for BoundRoots<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, S: Surface, const N: usize>(self, surface: &S) {
        let BoundRoots { rays, t_min, hits } = self;
        let mask = std::mem::take(&mut hits.unsure);
        for i in 0..LANES / N {
            let mut left = part_of_mask::<N>(mask, i);
            if left == 0 {
                continue;
            }
            let active = Cell::new(left);
            let ray = rays.part(i, Many::new(&active));
            while left != 0 {
                active.set(left);
                if hits.bound::<F, S, N>(i, surface, &ray, &active, t_min).is_err() {
                    hits.unsure |= Mask::from(active.get()) << (i * N);
                }
                left &= !active.get();
            }
        }
    }
}

impl SurfaceHits {
    /// Bounds the roots of the active rays of part `i`.
    #[inline(always)]
    fn bound<F: Floats<f64, N>, S: Surface, const N: usize>(
        &mut self,
        i: usize,
        surface: &S,
        ray: &Ray<RunningErrors<Many<F>, N>>,
        active: &Cell<u32>,
        t_min: f64,
    ) -> Result<(), Uncertain> {
        let [first, others @ ..] = surface.roots(ray)?;
        let Some(first) = first else { return Ok(()) };
        let t = Number::enclose(&first)?;
        let mut behind = t.low.lt(F::splat(t_min)) & active.get();
        // There are as many entries as rays, and each ray is in only one: the index is in range.
        let agreeing = &mut self.agreeing[self.count];
        let part = i % (WIDEST / N);
        agreeing.roots[0].set(part, first.feature, t);
        agreeing.count = 1;
        for k in 1..MOST_ROOTS {
            if behind == 0 {
                break;
            }
            let Some(root) = &others[k - 1] else { break };
            let t = Number::enclose(root)?;
            behind = t.low.lt(F::splat(t_min)) & active.get();
            agreeing.roots[k].set(part, root.feature, t);
            agreeing.count = k + 1;
        }
        (agreeing.eight, agreeing.lanes) = (i * N / WIDEST, active.get() << (part * N));
        self.count += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;
    use std::sync::Arc;

    use super::*;
    use crate::arith::simd::Level;
    use crate::cast::columns::HitArrays;
    use crate::cast::ray_sort::NEAR;
    use crate::geometry::affine::Affine;
    use crate::geometry::vector::Point;
    use crate::scene::{Hit, Object, Rays, Scene, TRange, TriangleMesh};
    use crate::shapes::{AnySurface, Box, Capsule, Cylinder, Disk, Ellipsoid, Plane, Sphere, Triangle};
    use crate::testing::with_large_frames;

    fn shapes() -> Vec<Object> {
        let turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let cylinder =
            |capped| Cylinder { start: [0.0, 0.0, -1.0], end: [0.0, 0.0, 1.0], radius: 1.0, capped };
        let surfaces: Vec<AnySurface> = vec![
            Sphere { center: [0.0; 3], radius: 1.0 }.into(),
            Box::new([2.0; 3], [0.0; 3]).into(),
            cylinder(true).into(),
            cylinder(false).into(),
            Capsule { start: [0.0, 0.0, -0.5], end: [0.0, 0.0, 0.5], radius: 1.0 }.into(),
            Disk { center: [0.0, 0.0, 1.0], normal: [0.0, 0.0, 1.0], radius: 1.0 }.into(),
            Triangle([-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0]).into(),
            Plane::PointNormal { point: [0.0, 0.0, 1.0], normal: [0.0, 0.0, 1.0] }.into(),
        ];
        let ellipsoid = Ellipsoid::new([0.0; 3], [1.0, 1.0, 2.0], turn).map(AnySurface::from);
        let surfaces = surfaces.into_iter().chain(ellipsoid).map(Geometry::Surface);
        let octahedron = TriangleMesh::new(
            [0, 1, 2]
                .iter()
                .flat_map(|&axis| {
                    [-1.0, 1.0].map(|x| std::array::from_fn(|i| if i == axis { x } else { 0.0 }))
                })
                .collect(),
            (0..8).map(|k| [k & 1, 2 + (k >> 1 & 1), 4 + (k >> 2)]).collect(),
        );
        let mesh = octahedron.map(|mesh| Geometry::Mesh(Arc::new(mesh)));
        let objects = surfaces.chain(mesh).map(|geometry| Object::new(geometry, false));
        let sheared = Affine::new([[1.0, 0.25, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -1.0]], [0.5, 0.0, 0.0]);
        let twice =
            |object: &Object| object.transformed(sheared)?.transformed(Affine::new(turn, [0.0, 0.5, 0.0]));
        objects
            .flat_map(|object| [twice(&object), object.transformed(sheared), Some(object)])
            .flatten()
            .collect()
    }

    /// Adjacent rays that hit the same part of an object, as many as are sorted together; and rays from a few
    /// origins to and past the points of a grid, many of which are corners, on edges, or points of tangency.
    fn rays() -> (Vec<Point>, Vec<Point>) {
        let (mut origins, mut directions) = (Vec::new(), Vec::new());
        for k in 0..NEAR as i32 {
            origins.push([0.25, -3.0, 0.5]);
            directions.push([f64::from(k % 32) / 64.0 - 0.3, 1.0, f64::from(k / 32) / 64.0 - 0.4]);
        }
        for origin in
            [[0.0, 0.0, 3.0], [1.0, -4.0, 0.0], [0.25, 0.125, 0.0], [-3.0, 2.0, 1.0], [0.1, 0.2, 4.3]]
        {
            for k in 0..343 {
                let point = [k % 7, k / 7 % 7, k / 49].map(|i| f64::from(i) / 2.0 - 1.5);
                let direction = [point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]];
                if direction != [0.0; 3] {
                    origins.push(origin);
                    directions.push(direction);
                }
            }
        }
        (origins, directions)
    }

    #[test]
    fn lanes_find_what_single_rays_do() {
        with_large_frames(compare_levels);
    }

    fn compare_levels() {
        let (origins, directions) = rays();
        let (mut hit, mut missed) = (0, 0);
        let all = shapes();
        let scenes = all.iter().map(|object| vec![object.clone()]).chain([all.clone()]);
        for objects in scenes {
            let scene = Scene::new(objects);
            for range in [TRange::RAY, TRange { min: 1.0, max: 3.0 }] {
                let world = scene.during([0.0; 2]);
                let cast = |level, rays: Range<usize>| {
                    let mut hits = HitArrays::of(rays.len());
                    let rays = Rays::new(&origins[rays.clone()], &directions[rays], &[]);
                    assert!(world.cast(level, rays, range, &mut hits.columns()));
                    hits.iter().collect::<Vec<_>>()
                };
                let indices = 0..origins.len();
                let expected: Vec<Hit> =
                    indices.clone().flat_map(|i| cast(Level::Scalar, i..i + 1)).collect();
                hit += expected.iter().filter(|hit| hit.object >= 0).count();
                missed += expected.iter().filter(|hit| hit.object < 0).count();
                for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                    for (i, (hit, expected)) in cast(level, indices.clone()).iter().zip(&expected).enumerate()
                    {
                        let bits = |hit: &Hit| {
                            (hit.t.to_bits(), hit.normal.map(f64::to_bits), hit.object, hit.primitive)
                        };
                        assert_eq!(
                            bits(hit),
                            bits(expected),
                            "{level:?}: {:?} + t·{:?}",
                            origins[i],
                            directions[i]
                        );
                    }
                }
            }
        }
        assert!(hit > 5_000 && missed > 5_000, "{hit}, {missed}");
    }

    /// Its normal, a product, underflows float64 and points down.
    #[test]
    fn a_plane_through_points_close_together_has_the_normal_that_single_rays_find() {
        with_large_frames(|| {
            for size in [1.0, 1e-100, 1e-170] {
                let plane = Plane::Points([-size, -size, 1.0], [0.0, size, 1.0], [size, -size, 1.0]);
                let scene = Scene::new(vec![Object::new(Geometry::Surface(plane.into()), false)]);
                let (origins, directions) = ([[0.0, 0.0, 3.0]; 64], [[0.125, 0.25, -1.0]; 64]);
                for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                    let mut hits = HitArrays::of(64);
                    let rays = Rays::new(&origins, &directions, &[]);
                    assert!(scene.during([0.0; 2]).cast(level, rays, TRange::RAY, &mut hits.columns()));
                    for hit in hits.iter() {
                        assert_eq!((hit.t, hit.normal), (2.0, [0.0, 0.0, -1.0]), "{level:?}, {size}");
                    }
                }
            }
        });
    }
}
