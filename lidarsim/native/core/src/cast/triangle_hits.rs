//! Refines the closest hits on still triangles, by expansions.

use crate::arith::expansion::V;
use crate::arith::simd::{self, Floats, Isa, Task};
use crate::bvh::{LANES, Mask, RayPacket, part_of_mask, take};
use crate::cast::closest_hit::{ClosestHits, timed_ray};
use crate::geometry::affine::Inverse;
use crate::scene::{EightHits, Hit, RootId, Scene, Sink};
use crate::shapes::triangle::{Corners, Crossing, NOWHERE, TrianglePlane, corners_of};

/// The hits of a packet on triangles.
#[repr(C, align(64))]
pub struct TriangleHits<'a> {
    /// The refined t.
    t: [f64; LANES],
    normal: [[f64; LANES]; 3],
    object: [u32; LANES],
    primitive: [u32; LANES],
    corners: Corners<'a, LANES>,
    lanes: Mask,
    /// Hits on triangles that a map has placed.
    placed: Mask,
}

impl<'a> TriangleHits<'a> {
    pub fn new() -> Self {
        let corners = [[NOWHERE; 3]; LANES];
        let (t, normal) = ([0.0; LANES], [[0.0; LANES]; 3]);
        TriangleHits { lanes: 0, placed: 0, object: [0; LANES], primitive: [0; LANES], corners, t, normal }
    }

    /// Takes the closest hits of these lanes, on given and on placed triangles.
    #[inline(always)]
    pub fn gather(&mut self, closest: &ClosestHits, given: Mask, placed: Mask) {
        (self.lanes, self.placed) = (given | placed, placed);
        (self.object, self.primitive) = closest.objects_and_primitives();
    }

    /// Prefetches the corners of the triangles.
    #[inline(always)]
    pub fn prefetch<I: Isa>(&mut self, scene: &'a Scene) {
        let (mut left, mut last) = (self.lanes, None);
        while let Some(lane) = take(&mut left) {
            let triangle = (self.object[lane], self.primitive[lane]);
            if let Some((known, corners)) = last
                && known == triangle
            {
                self.corners[lane] = corners;
                continue;
            }
            let corners = scene.objects()[self.object[lane] as usize].corners(self.primitive[lane]);
            for corner in corners {
                simd::prefetch_across::<I, _>(corner);
            }
            (self.corners[lane], last) = (corners, Some((triangle, corners)));
        }
    }

    /// Refines the hits of the packet and writes them.
    #[inline(always)]
    pub fn refine<I: Isa>(&mut self, scene: &Scene, rays: &RayPacket, hits: &mut (impl Sink + ?Sized)) {
        // All are computed before the first is written, which would wait for long dependency chains.
        let mut certain = I::call(Refine { triangle_hits: self, rays });
        if self.placed != 0 {
            certain |= I::call(RefinePlaced { triangle_hits: self, scene, rays });
        }
        for eight in 0..LANES / 8 {
            let lanes = part_of_mask::<8>(certain, eight);
            let (object, primitive) = (self.object.as_chunks().0[eight], self.primitive.as_chunks().0[eight]);
            let id = object[0];
            // Lanes without a hit hold arbitrary numbers, so an id is valid only if a lane with a hit has it,
            // too.
            if lanes == 0 || object != [id; 8] {
                continue;
            }
            let on = &scene.objects()[id as usize];
            let eight_hits = EightHits {
                t: &self.t.as_chunks().0[eight],
                normal: [0, 1, 2].map(|axis| &self.normal[axis].as_chunks().0[eight]),
                object: object.map(|id| id as i32),
                primitive: primitive.map(|primitive| on.primitive_id(primitive)),
            };
            let put = hits.write_runs::<I>(&rays.at.as_chunks().0[eight], lanes, &eight_hits);
            self.lanes &= !(Mask::from(put) << (8 * eight));
        }
        while let Some(lane) = take(&mut self.lanes) {
            let (at, object, primitive) = (rays.at[lane] as usize, self.object[lane], self.primitive[lane]);
            // No `Hit` is assembled first: reading several stores back as one load would stall.
            if certain & 1 << lane != 0 {
                let normal = [self.normal[0][lane], self.normal[1][lane], self.normal[2][lane]];
                let primitive = scene.objects()[object as usize].primitive_id(primitive);
                hits.write(at, Hit { t: self.t[lane], normal, object: object as i32, primitive });
            } else {
                let root = &RootId::of_triangle(object, primitive);
                hits.write(at, scene.hit(root, &timed_ray(rays, lane)));
            }
        }
    }
}

/// The planes of eight hits; their unit normals, and the lanes in which these are accurate; and the triangle,
/// if all hits are on one.
type Latest<I> = (TrianglePlane<I>, ([<I as Isa>::F64x8; 3], u32), Option<(u32, u32)>);

/// Computes t and the normals on triangles as given. Returns the lanes in which both are certain.
struct Refine<'t, 'a> {
    triangle_hits: &'t mut TriangleHits<'a>,
    rays: &'t RayPacket,
}

impl Task for Refine<'_, '_> {
    type Output = Mask;

    #[inline(always)]
    fn run<I: Isa>(self) -> Mask {
        let Refine {
            triangle_hits: TriangleHits { lanes, placed, object, primitive, corners, t, normal },
            rays,
        } = self;
        let given = *lanes & !*placed;
        let (mut certain, mut left) = (0, given);
        // If the last eight hits were on one triangle, the next eight may be on it, too.
        let mut latest: Option<Latest<I>> = None;
        while left != 0 {
            let first = left.trailing_zeros() as usize;
            let eight = first / 8;
            let mask = part_of_mask::<8>(given, eight);
            left &= !(0xff << (8 * eight));
            let triangle = (object[first], primitive[first]);
            let (objects, primitives) =
                (&object.as_chunks::<8>().0[eight], &primitive.as_chunks::<8>().0[eight]);
            let mut others = 0;
            for k in 0..8 {
                others |= u32::from((objects[k], primitives[k]) != triangle) << k;
            }
            let one = if others & mask == 0 { Some(triangle) } else { None };
            let (plane, (unit, fine)) = match latest {
                Some((plane, normal, of)) if one.is_some() && one == of => {
                    (if rays.one_origin { plane } else { plane.seen_from(rays.origins::<I>(eight)) }, normal)
                }
                _ => {
                    let corners =
                        if one.is_some() { &[corners[first]; 8] } else { &corners.as_chunks().0[eight] };
                    let plane = TrianglePlane::<I>::new(corners_of::<I>(corners), rays.origins::<I>(eight));
                    (plane, plane.unit_normal())
                }
            };
            latest = Some((plane, (unit, fine), one));
            let (refined, sure) = Crossing::<I>::new(&plane, rays.directions::<I>(eight)).rounded();
            t.as_chunks_mut().0[eight] = refined.store();
            for axis in 0..3 {
                normal[axis].as_chunks_mut().0[eight] = unit[axis].store();
            }
            certain |= Mask::from(sure & fine & mask) << (8 * eight);
            let left = mask & !sure;
            if left != 0 {
                let corners =
                    if one.is_some() { &[corners[first]; 8] } else { &corners.as_chunks().0[eight] };
                let (origins, directions) = (rays.origins::<I>(eight), rays.directions::<I>(eight));
                let (refined, sure) =
                    Crossing::<I>::long(corners_of::<I>(corners), origins, directions).rounded();
                let (unit, fine) = plane.common_unit_normal();
                let found = (refined.store(), [unit[0].store(), unit[1].store(), unit[2].store()]);
                certain |= put(t, normal, eight, sure & fine & left, found);
            }
        }
        certain
    }
}

/// As `Refine`, for hits on placed triangles.
struct RefinePlaced<'t, 'a> {
    triangle_hits: &'t mut TriangleHits<'a>,
    scene: &'t Scene,
    rays: &'t RayPacket,
}

impl Task for RefinePlaced<'_, '_> {
    type Output = Mask;

    #[inline(always)]
    fn run<I: Isa>(self) -> Mask {
        let RefinePlaced {
            triangle_hits: TriangleHits { placed, object, corners, t, normal, .. },
            scene,
            rays,
        } = self;
        let (mut certain, mut left) = (0, *placed);
        while left != 0 {
            let first = left.trailing_zeros() as usize;
            let id = object[first];
            let inverse = scene.objects()[id as usize].inverse().and_then(Inverse::expanded);
            let mut origin = None;
            for eight in first / 8..LANES / 8 {
                let mut mask = part_of_mask::<8>(left, eight);
                for (k, other) in object.as_chunks::<8>().0[eight].iter().enumerate() {
                    mask &= !(u32::from(*other != id) << k);
                }
                left &= !(Mask::from(mask) << (8 * eight));
                let (Some(inverse), true) = (inverse, mask != 0) else { continue };
                let from = match origin {
                    Some(origin) if rays.one_origin => origin,
                    _ => inverse.points::<I>(rays.origins::<I>(eight)),
                };
                origin = Some(from);
                let triangles = corners_of::<I>(&corners.as_chunks().0[eight]);
                let plane = TrianglePlane::<I>::of_placed(triangles, inverse, from);
                let (unit, fine) = plane.common_unit_normal();
                let (refined, sure) = Crossing::<I>::new(&plane, rays.directions::<I>(eight)).rounded();
                let unit = [unit[0].store(), unit[1].store(), unit[2].store()];
                certain |= put(t, normal, eight, sure & fine & mask, (refined.store(), unit));
                let mut open = mask & fine & !sure;
                let (Some(map), true) = (&inverse.map, open != 0) else { continue };
                for axis in 0..3 {
                    let level = open & is_level::<I>(&triangles, axis);
                    if level != 0 {
                        let (o, d) = (rays.origins::<I>(eight), rays.directions::<I>(eight));
                        let height = triangles[0][axis];
                        let (refined, sure) =
                            Crossing::<I>::of_placed_level(map, axis, height, o, d).rounded();
                        certain |= put(t, normal, eight, sure & level, (refined.store(), unit));
                        open &= !level;
                    }
                }
            }
        }
        certain
    }
}

/// The lanes in which all corners have the same coordinate along an axis.
#[inline(always)]
fn is_level<I: Isa>([a, b, c]: &[V<I>; 3], axis: usize) -> u32 {
    let (a, b, c) = (a[axis], b[axis], c[axis]);
    a.le(b) & b.le(a) & a.le(c) & c.le(a)
}

/// Puts t and normals to these lanes of the eight, and returns them as lanes of the packet.
#[inline(always)]
fn put(
    t: &mut [f64; LANES],
    normal: &mut [[f64; LANES]; 3],
    eight: usize,
    lanes: u32,
    (refined, unit): ([f64; 8], [[f64; 8]; 3]),
) -> Mask {
    let mut left = Mask::from(lanes);
    while let Some(k) = take(&mut left) {
        let lane = 8 * eight + k;
        t[lane] = refined[k];
        for axis in 0..3 {
            normal[axis][lane] = unit[axis][k];
        }
    }
    Mask::from(lanes) << (8 * eight)
}
