//! The surface intersector: packets against implicit surfaces, a register of rays at a time. It bounds the roots in float64 with running errors, and refines
//! the closest hits in batches by double-double; batches also refine hits on meshes that move.
//!
//! Lanes that stay uncertain are decided ray by ray.

use std::cell::Cell;

use crate::arith::number::{DoubleDoubles, Interval, Lanes, Many, Number, OfRays, RunningErrors, Stored, Uncertain};
use crate::arith::simd::{Floats, Isa, LaneTask, lanes};
use crate::bvh::{LANES, Mask, RayPacket, all, part_of_mask, take};
use crate::cast::closest_hit::ClosestHits;
use crate::cast::local_rays::{LocalRays, OfDoubleDoubles, OfRunningErrors, RayParts, WorldRays};
use crate::cast::poses::Poses;
use crate::geometry::affine::{PlacementTask, Placements, RayPlacement};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};
use crate::scene::TriangleMesh;
use crate::scene::{EightHits, Geometry, Hit, RootId, Scene, Sink};
use crate::shapes::newton::{Target, newton_step};
use crate::shapes::triangle::Triangles;
use crate::shapes::{Surface, SurfaceTask};

/// What packets are intersected with surfaces by. Reused, as it is large.
pub struct SurfaceIntersector {
    local: LocalRays<LANES>,
    hits: SurfaceHits,
}

impl SurfaceIntersector {
    pub fn new() -> Self {
        let nothing = AgreeingLanes { eight: 0, lanes: 0, roots: [RootBounds::NONE; 2], count: 0 };
        SurfaceIntersector {
            local: LocalRays::UNSET,
            hits: SurfaceHits { agreeing: [nothing; LANES], count: 0, unsure: 0 },
        }
    }

    /// Intersects the rays of `mask` with an object, updates their closest hits, and returns the mask of those whose limits may have decreased.
    #[inline(always)]
    pub fn intersect<I: Isa>(
        &mut self,
        scene: &Scene,
        id: u32,
        rays: &RayPacket,
        mask: Mask,
        closest: &mut ClosestHits,
        poses: &mut Poses<LANES>,
    ) -> Mask {
        let SurfaceIntersector { local, hits } = self;
        (hits.count, hits.unsure) = (0, mask);
        let object = &scene.objects()[id as usize];
        let (alone, moves) = (mask & (mask - 1) == 0, object.motion().is_some());
        let mut filtered = false;
        if (!alone || moves)
            && let Geometry::Surface(shape) = &object.geometry
        {
            let t_min = closest.t_min();
            let then = if moves { Some(poses.gather(scene, id, &rays.time, mask)) } else { None };
            let placements = Placements { first: object.inverse(), then };
            let world = WorldRays { origin: &rays.origin, direction: &rays.direction };
            filtered = if placements.is_identity() {
                shape.apart::<I, _>(BoundRoots { rays: world, t_min, hits }).is_some()
            } else {
                local.place::<I, OfRunningErrors>(placements, world, mask, rays.one_origin)
                    && shape.apart::<I, _>(BoundRoots { rays: &*local, t_min, hits }).is_some()
            };
        }
        let root = |index: usize, feature| RootId { object: id, primitive: 0, index: index as u8, feature };
        let mut nearer = hits.unsure;
        for agreeing in &hits.agreeing[..hits.count] {
            let mut left = agreeing.lanes;
            for (index, roots) in agreeing.roots[..agreeing.count].iter().enumerate() {
                let t = Interval { low: I::F64x8::load(&roots.low), high: I::F64x8::load(&roots.high) };
                let taken = closest.take_eight::<I>(rays, agreeing.eight, left, root(index, roots.feature), t);
                nearer |= Mask::from(taken.nearer) << (8 * agreeing.eight);
                left = taken.early;
            }
        }
        while let Some(lane) = take(&mut hits.unsure) {
            if filtered {
                closest.consider_exactly(rays, lane, id, 0);
            } else {
                closest.consider(rays, lane, id, 0);
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
    /// Of which eight lanes of the packet, and a bit for each.
    eight: usize,
    lanes: u32,
    /// The first root, and the second too where the first may lie before the range.
    roots: [RootBounds; 2],
    count: usize,
}

/// Lanes of the widest register.
const WIDEST: usize = 8;

/// Bounds of a root of each of eight lanes, on one part of the surface.
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

/// Bounds the roots of the rays that `hits` is unsure of.
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
        let [first, second] = surface.roots(ray)?;
        let Some(first) = first else { return Ok(()) };
        let t = Number::enclose(&first)?;
        let behind = t.low.lt(F::splat(t_min));
        // There are as many as rays, and each ray is in one of them alone: the index is in range.
        let agreeing = &mut self.agreeing[self.count];
        let part = i % (WIDEST / N);
        agreeing.roots[0].set(part, first.feature, t);
        agreeing.count = 1;
        if behind & active.get() != 0
            && let Some(second) = second
        {
            agreeing.roots[1].set(part, second.feature, Number::enclose(&second)?);
            agreeing.count = 2;
        }
        (agreeing.eight, agreeing.lanes) = (i * N / WIDEST, active.get() << (part * N));
        self.count += 1;
        Ok(())
    }
}

/// Batches of hits on one part of one object each, an implicit surface or a mesh that moves, to be refined together.
pub struct HitBatches {
    batches: Vec<HitBatch>,
    /// Of neighbouring lanes of a packet.
    neighbors: HitBatch,
    scratch: BatchScratch,
}

/// Scratch memory of the refinement of a batch.
struct BatchScratch {
    poses: Poses<BATCH_SIZE>,
    local: LocalRays<BATCH_SIZE>,
    refined: Refined,
}

/// Batches at once, a table indexed by a hash of object and part; on a collision the older batch is flushed.
const BATCHES: usize = 32;

/// Hits of a batch: two of the widest registers, so that the latency of one's divisions is hidden by the other's work.
pub const BATCH_SIZE: usize = 2 * WIDEST;

/// From so many on, hits of `BATCH_SIZE` neighbouring lanes are a batch of their own: as measured, fewer are better collected.
const MANY: u32 = 8;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct HitBatch {
    origin: [[f64; BATCH_SIZE]; 3],
    direction: [[f64; BATCH_SIZE]; 3],
    time: [f64; BATCH_SIZE],
    /// Of t.
    low: [f64; BATCH_SIZE],
    high: [f64; BATCH_SIZE],
    /// Of all hits, but for the primitive and the index of the root.
    root: RootId,
    primitive: [u32; BATCH_SIZE],
    index: [u8; BATCH_SIZE],
    at: [u32; BATCH_SIZE],
    /// A bit for each slot that holds a hit.
    slots: Mask,
}

impl HitBatches {
    pub fn new() -> Self {
        let empty = HitBatch {
            root: RootId { object: 0, primitive: 0, index: 0, feature: 0 },
            primitive: [0; BATCH_SIZE],
            at: [0; BATCH_SIZE],
            index: [0; BATCH_SIZE],
            origin: [[0.0; BATCH_SIZE]; 3],
            direction: [[1.0; BATCH_SIZE]; 3],
            time: [0.0; BATCH_SIZE],
            low: [0.0; BATCH_SIZE],
            high: [0.0; BATCH_SIZE],
            slots: 0,
        };
        let refined = Refined {
            known: 0,
            t: [0.0; BATCH_SIZE],
            local_normal: [Stored::UNSET; 3],
            normal: [[0.0; BATCH_SIZE]; 3],
        };
        let scratch = BatchScratch { poses: Poses::new(), local: LocalRays::UNSET, refined };
        HitBatches { batches: vec![empty; BATCHES], neighbors: empty, scratch }
    }

    /// Begins anew with another scene.
    pub fn restart(&mut self, scene: &Scene) {
        self.scratch.poses.restart(scene.moves());
    }

    /// Takes a hit, with the ray and bounds of t.
    #[inline(always)]
    pub fn push<I: Isa>(
        &mut self,
        scene: &Scene,
        at: u32,
        root: RootId,
        (origin, direction, time, bounds): (Point, Point, f64, Interval),
        hits: &mut (impl Sink + ?Sized),
    ) {
        let batch = &mut self.batches[(7 * root.object as usize + usize::from(root.feature)) % BATCHES];
        if (batch.root.object, batch.root.feature) != (root.object, root.feature) {
            batch.flush::<I>(scene, &mut self.scratch, hits);
            batch.root = root;
        }
        let slot = batch.slots.trailing_ones() as usize;
        (batch.at[slot], batch.primitive[slot], batch.index[slot]) = (at, root.primitive, root.index);
        for axis in 0..3 {
            batch.origin[axis][slot] = origin[axis];
            batch.direction[axis][slot] = direction[axis];
        }
        batch.time[slot] = time;
        (batch.low[slot], batch.high[slot]) = (bounds.low, bounds.high);
        batch.slots |= 1 << slot;
        if batch.slots == all(BATCH_SIZE) {
            batch.flush::<I>(scene, &mut self.scratch, hits);
        }
    }

    /// Takes the hits of those of `lanes`, among the `BATCH_SIZE` lanes of the packet from `start` on, that are on the same part of the same object as
    /// the first, if these are many. Returns the lanes taken.
    #[inline(always)]
    pub fn take_neighbors<I: Isa>(
        &mut self,
        scene: &Scene,
        rays: &RayPacket,
        closest: &ClosestHits,
        start: usize,
        lanes: Mask,
        hits: &mut (impl Sink + ?Sized),
    ) -> Mask {
        let (first, i) = (lanes.trailing_zeros() as usize, start / BATCH_SIZE);
        let these = lanes & closest.lanes_like::<BATCH_SIZE>(first, i);
        if these.count_ones() < MANY {
            return 0;
        }
        let batch = &mut self.neighbors;
        for axis in 0..3 {
            batch.origin[axis] = rays.origin[axis].as_chunks().0[i];
            batch.direction[axis] = rays.direction[axis].as_chunks().0[i];
        }
        batch.time = rays.time.as_chunks().0[i];
        batch.at = rays.at.as_chunks().0[i];
        batch.root = closest.root(first);
        batch.index = [batch.root.index; BATCH_SIZE];
        batch.primitive = closest.primitives().as_chunks().0[i];
        for part in 0..BATCH_SIZE / WIDEST {
            let Interval { low, high } = closest.bounds_of_eight::<I>(start / WIDEST + part);
            batch.low.as_chunks_mut().0[part] = low.store();
            batch.high.as_chunks_mut().0[part] = high.store();
        }
        batch.slots = these >> start;
        batch.flush::<I>(scene, &mut self.scratch, hits);
        these
    }

    #[inline(always)]
    pub fn flush<I: Isa>(&mut self, scene: &Scene, hits: &mut (impl Sink + ?Sized)) {
        for batch in &mut self.batches {
            batch.flush::<I>(scene, &mut self.scratch, hits);
        }
    }
}

impl HitBatch {
    #[inline(always)]
    fn flush<I: Isa>(&mut self, scene: &Scene, scratch: &mut BatchScratch, hits: &mut (impl Sink + ?Sized)) {
        if self.slots == 0 {
            return;
        }
        let BatchScratch { poses, local, refined } = scratch;
        let object = &scene.objects()[self.root.object as usize];
        let slots = self.slots;
        let then = object.motion().map(|_| poses.gather(scene, self.root.object, &self.time, slots));
        let placements = Placements { first: object.inverse(), then };
        let world = WorldRays { origin: &self.origin, direction: &self.direction };
        refined.known = 0;
        let stepped = if placements.is_identity() {
            // Hits on meshes that stand still are refined by `TriangleHits`, unless their maps are extreme.
            match &object.geometry {
                Geometry::Surface(shape) => shape.apart::<I, _>(RefineBatch { rays: world, batch: self, refined }),
                Geometry::Mesh(_) => None,
            }
        } else if local.place::<I, OfDoubleDoubles>(placements, world, slots, self.has_one_origin()) {
            match &object.geometry {
                Geometry::Surface(shape) => shape.apart::<I, _>(RefineBatch { rays: &*local, batch: self, refined }),
                Geometry::Mesh(mesh) => {
                    let corners = &self.corners(mesh);
                    I::apart(RefineTriangleBatch { rays: &*local, corners, batch: self, refined })
                }
            }
        } else {
            None
        };
        if !placements.is_identity() {
            placements.apart::<I, _>(PlaceNormals(refined));
        }
        let id = self.root.object as i32;
        for eight in 0..BATCH_SIZE / WIDEST {
            let certain = part_of_mask::<WIDEST>(refined.known.into(), eight);
            let primitive = self.primitive.as_chunks().0[eight];
            let eight_hits = EightHits {
                t: &refined.t.as_chunks().0[eight],
                normal: [0, 1, 2].map(|axis| &refined.normal[axis].as_chunks().0[eight]),
                object: [id; WIDEST],
                primitive: primitive.map(|primitive| object.reported(primitive)),
            };
            let put = hits.put_runs::<I>(&self.at.as_chunks().0[eight], certain, &eight_hits);
            self.slots &= !(Mask::from(put) << (eight * WIDEST));
        }
        while let Some(slot) = take(&mut self.slots) {
            let (at, primitive) = (self.at[slot] as usize, self.primitive[slot]);
            // No hit is put together first: to read back in one piece what was written in several takes long.
            if refined.known & 1 << slot != 0 {
                let (normal, primitive) = (pick(&refined.normal, slot), object.reported(primitive));
                hits.put(at, Hit { t: refined.t[slot], normal, object: self.root.object as i32, primitive });
            } else {
                let bounds = Interval { low: self.low[slot], high: self.high[slot] };
                let root = RootId { primitive, index: self.index[slot], ..self.root };
                let (origin, direction) = (pick(&self.origin, slot), pick(&self.direction, slot));
                let time = self.time[slot];
                // Alone it would take the same step.
                hits.put(
                    at,
                    match stepped {
                        Some(()) => scene.hit(&root, origin, direction, time),
                        None => scene.hit_within(&root, bounds, origin, direction, time),
                    },
                );
            }
        }
    }

    /// Whether all rays start at one point, to the bit.
    #[inline(always)]
    fn has_one_origin(&self) -> bool {
        let (first, mut others) = (self.slots.trailing_zeros() as usize, 0);
        for column in &self.origin {
            for (slot, x) in column.iter().enumerate() {
                others |= Mask::from(x.to_bits() != column[first].to_bits()) << slot;
            }
        }
        others & self.slots == 0
    }

    /// The corners of the triangles, by corner and axis; empty slots repeat the first.
    #[inline(always)]
    fn corners(&self, mesh: &TriangleMesh) -> [[[f64; BATCH_SIZE]; 3]; 3] {
        let (mut corners, first) = ([[[0.0; BATCH_SIZE]; 3]; 3], self.slots.trailing_zeros() as usize);
        for slot in 0..BATCH_SIZE {
            let primitive = self.primitive[if self.slots & 1 << slot != 0 { slot } else { first }];
            for (corner, point) in mesh.corners(primitive).into_iter().enumerate() {
                for axis in 0..3 {
                    corners[corner][axis][slot] = point[axis];
                }
            }
        }
        corners
    }
}

#[inline(always)]
fn pick(v: &[[f64; BATCH_SIZE]; 3], slot: usize) -> Point {
    [v[0][slot], v[1][slot], v[2][slot]]
}

/// The refined hits of a batch.
struct Refined {
    /// A bit for each hit that is certain.
    known: u32,
    t: [f64; BATCH_SIZE],
    /// In the coordinates of the object, of any length, where these are not those of the world.
    local_normal: [Stored<BATCH_SIZE>; 3],
    /// A unit normal in the coordinates of the world.
    normal: [[f64; BATCH_SIZE]; 3],
}

/// Refines the hits of a batch; where rays are in the coordinates of the object, the normals in the world are left to `PlaceNormals`.
struct RefineBatch<'a, R> {
    rays: R,
    batch: &'a HitBatch,
    refined: &'a mut Refined,
}

impl<R: RayParts> SurfaceTask for RefineBatch<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, S: Surface, const N: usize>(self, surface: &S) {
        let RefineBatch { rays, batch, refined } = self;
        let plane = surface.axis_plane(batch.root.feature);
        for i in 0..BATCH_SIZE / N {
            let active = Cell::new(part_of_mask::<N>(batch.slots, i));
            if active.get() == 0 {
                continue;
            }
            if let Some(plane) = &plane
                && let Some((origin, direction)) = rays.along::<F, N>(plane.axis, i)
            {
                let lanes = Many::<F>::new(&active);
                let Ok(t) = plane.t(origin, direction, lanes) else { continue };
                refined.t.as_chunks_mut().0[i] = t.store();
                // The normal of a plane is the same for all rays.
                let ray = rays.part::<DoubleDoubles<Many<F>, N>, _, N>(i, lanes);
                let (along, error) = surface.normal(&ray, batch.root.feature)[plane.axis].parts();
                let Ok(()) = lanes.keep(error.lt(along.abs())) else { continue };
                for normal in &mut refined.normal {
                    normal.as_chunks_mut().0[i] = F::splat(0.0).store();
                }
                let sign = F::splat(0.0).le_pick(along, F::splat(1.0), F::splat(-1.0));
                refined.normal[plane.axis].as_chunks_mut().0[i] = sign.store();
                refined.known |= active.get() << (i * N);
            } else {
                refined.refine::<R, F, N>(i, rays, surface, batch, &active);
            }
        }
    }
}

/// As `RefineBatch`, of hits on triangles of a mesh.
struct RefineTriangleBatch<'a, R> {
    rays: R,
    corners: &'a [[[f64; BATCH_SIZE]; 3]; 3],
    batch: &'a HitBatch,
    refined: &'a mut Refined,
}

impl<R: RayParts> LaneTask for RefineTriangleBatch<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, const N: usize>(self) {
        let [a, b, c] = self.corners;
        for i in 0..BATCH_SIZE / N {
            let active = Cell::new(part_of_mask::<N>(self.batch.slots, i));
            if active.get() == 0 {
                continue;
            }
            let triangles = Triangles([lanes::part(a, i), lanes::part(b, i), lanes::part(c, i)]);
            self.refined.refine::<R, F, N>(i, self.rays, &triangles, self.batch, &active);
        }
    }
}

/// Works out the normals in the world; hits of which one is uncertain are no longer known.
struct PlaceNormals<'a>(&'a mut Refined);

impl PlacementTask for PlaceNormals<'_> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, P: RayPlacement, const N: usize>(self, placement: P) {
        let refined = self.0;
        let known = std::mem::take(&mut refined.known);
        for i in 0..BATCH_SIZE / N {
            let active = Cell::new(part_of_mask::<N>(Mask::from(known), i));
            if active.get() == 0 {
                continue;
            }
            let lanes = Many::<F>::new(&active);
            // Without closures: these would not be compiled for the instruction set.
            let [x, y, z] = &refined.local_normal;
            let normal =
                [DoubleDoubles::load(x, i, lanes), DoubleDoubles::load(y, i, lanes), DoubleDoubles::load(z, i, lanes)];
            refined.put_normals(i, &placement.part(i).normals(normal, lanes), lanes);
        }
    }
}

impl Refined {
    /// Refines part `i` of a batch.
    #[inline(always)]
    fn refine<'a, R: RayParts, F: Floats<f64, N>, const N: usize>(
        &mut self,
        i: usize,
        rays: R,
        target: &impl Target<Many<'a, F>, N>,
        batch: &HitBatch,
        active: &'a Cell<u32>,
    ) {
        let lanes = Many::new(active);
        let bounds = Interval { low: lanes::load(&batch.low, i), high: lanes::load(&batch.high, i) };
        let ray = rays.part::<DoubleDoubles<Many<F>, N>, _, N>(i, lanes);
        let Ok((t, normal)) = newton_step(&ray, target, batch.root.feature, bounds, lanes) else { return };
        self.t.as_chunks_mut().0[i] = t.store();
        if R::IN_WORLD {
            self.put_normals(i, &normal, lanes);
        } else {
            for axis in 0..3 {
                normal[axis].store(i, &mut self.local_normal[axis]);
            }
            self.known |= active.get() << (i * N);
        }
    }

    /// Puts unit normals of part `i`, known ones, along these in the world.
    #[inline(always)]
    fn put_normals<L: Lanes<N>, const N: usize>(&mut self, i: usize, along: &Vector<DoubleDoubles<L, N>>, lanes: L) {
        if let Ok(along) = Number::proportions(along) {
            let unit = vector::unit(along);
            for axis in 0..3 {
                self.normal[axis].as_chunks_mut().0[i] = unit[axis].store();
            }
            self.known |= lanes.active() << (i * N);
        }
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
    use crate::scene::Object;
    use crate::shapes::{AnySurface, Box, Cylinder, Ellipsoid, Plane, Sphere, Triangle};
    use crate::testing::with_large_frames;

    fn shapes() -> Vec<Object> {
        let turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let cylinder = |capped| Cylinder { start: [0.0, 0.0, -1.0], end: [0.0, 0.0, 1.0], radius: 1.0, capped };
        let surfaces: Vec<AnySurface> = vec![
            Sphere { center: [0.0; 3], radius: 1.0 }.into(),
            Box { size: [2.0; 3], center: [0.0; 3] }.into(),
            cylinder(true).into(),
            cylinder(false).into(),
            Triangle([-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0]).into(),
            Plane::PointNormal { point: [0.0, 0.0, 1.0], normal: [0.0, 0.0, 1.0] }.into(),
        ];
        let ellipsoid = Ellipsoid::new([0.0; 3], [1.0, 1.0, 2.0], turn).map(AnySurface::from);
        let surfaces = surfaces.into_iter().chain(ellipsoid).map(Geometry::Surface);
        let octahedron = TriangleMesh::new(
            [0, 1, 2]
                .iter()
                .flat_map(|&axis| [-1.0, 1.0].map(|x| std::array::from_fn(|i| if i == axis { x } else { 0.0 })))
                .collect(),
            (0..8).map(|k| [k & 1, 2 + (k >> 1 & 1), 4 + (k >> 2)]).collect(),
        );
        let mesh = octahedron.map(|mesh| Geometry::Mesh(Arc::new(mesh)));
        let objects = surfaces.chain(mesh).map(|geometry| Object::new(geometry, false));
        let sheared = Affine::new([[1.0, 0.25, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -1.0]], [0.5, 0.0, 0.0]);
        let twice = |object: &Object| object.transformed(sheared)?.transformed(Affine::new(turn, [0.0, 0.5, 0.0]));
        objects.flat_map(|object| [twice(&object), object.transformed(sheared), Some(object)]).flatten().collect()
    }

    /// Side by side, so that neighbours meet the same part of an object, as many as are sorted together. And from a few origins to the points of a grid, of
    /// which many are corners, on edges, or where a line touches; and past them.
    fn rays() -> (Vec<Point>, Vec<Point>) {
        let (mut origins, mut directions) = (Vec::new(), Vec::new());
        for k in 0..NEAR as i32 {
            origins.push([0.25, -3.0, 0.5]);
            directions.push([f64::from(k % 32) / 64.0 - 0.3, 1.0, f64::from(k / 32) / 64.0 - 0.4]);
        }
        for origin in [[0.0, 0.0, 3.0], [1.0, -4.0, 0.0], [0.25, 0.125, 0.0], [-3.0, 2.0, 1.0], [0.1, 0.2, 4.3]] {
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
            for range in [(0.0, f64::INFINITY), (1.0, 3.0)] {
                let world = scene.during([0.0; 2]);
                let cast = |level, rays: Range<usize>| {
                    let mut hits = HitArrays::of(rays.len());
                    let rays = (&origins[rays.clone()], &directions[rays], &[][..]);
                    assert!(world.cast(level, rays, range, &mut hits.columns()));
                    hits.iter().collect::<Vec<_>>()
                };
                let indices = 0..origins.len();
                let expected: Vec<Hit> = indices.clone().flat_map(|i| cast(Level::Scalar, i..i + 1)).collect();
                hit += expected.iter().filter(|hit| hit.object >= 0).count();
                missed += expected.iter().filter(|hit| hit.object < 0).count();
                for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                    for (i, (hit, expected)) in cast(level, indices.clone()).iter().zip(&expected).enumerate() {
                        let bits =
                            |hit: &Hit| (hit.t.to_bits(), hit.normal.map(f64::to_bits), hit.object, hit.primitive);
                        assert_eq!(bits(hit), bits(expected), "{level:?}: {:?} + t·{:?}", origins[i], directions[i]);
                    }
                }
            }
        }
        assert!(hit > 5_000 && missed > 5_000, "{hit}, {missed}");
    }

    /// Its normal, a product, is too small for a float64 number; it points down.
    #[test]
    fn a_plane_through_points_close_together_has_the_normal_that_single_rays_find() {
        with_large_frames(|| {
            for size in [1.0, 1e-100, 1e-170] {
                let plane = Plane::Points([-size, -size, 1.0], [0.0, size, 1.0], [size, -size, 1.0]);
                let scene = Scene::new(vec![Object::new(Geometry::Surface(plane.into()), false)]);
                let (origins, directions) = ([[0.0, 0.0, 3.0]; 64], [[0.125, 0.25, -1.0]; 64]);
                for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                    let mut hits = HitArrays::of(64);
                    let rays = (&origins[..], &directions[..], &[][..]);
                    assert!(scene.during([0.0; 2]).cast(level, rays, (0.0, f64::INFINITY), &mut hits.columns()));
                    for hit in hits.iter() {
                        assert_eq!((hit.t, hit.normal), (2.0, [0.0, 0.0, -1.0]), "{level:?}, {size}");
                    }
                }
            }
        });
    }
}
