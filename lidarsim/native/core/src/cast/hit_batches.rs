//! Hits on surfaces and on moving meshes, refined in batches: an interval Newton step in double-double yields
//! t and the normal. Lanes that stay uncertain are refined ray by ray.

use std::cell::Cell;
use std::marker::PhantomData;

use crate::arith::number::{DoubleDoubles, Interval, Lanes, Many, Number, OfRays, Stored};
use crate::arith::simd::{Floats, Isa, LaneTask, lanes};
use crate::bvh::{Mask, RayPacket, all, part_of_mask, take};
use crate::cast::closest_hit::ClosestHits;
use crate::cast::local_rays::{LocalRays, OfDoubleDoubles, RayParts, WorldRays};
use crate::cast::poses::Poses;
use crate::geometry::affine::{PlacementTask, Placements, RayPlacement};
use crate::geometry::vector::{self, Point, Vector};
use crate::scene::{EightHits, Geometry, Hit, Primitives, RootId, Scene, Sink, TimedRay, TriangleMesh};
use crate::shapes::newton::{Target, newton_step};
use crate::shapes::triangle::Triangles;
use crate::shapes::{Each, EachOf, Surface, SurfaceTask};

/// Lanes of the widest register.
const WIDEST: usize = 8;

/// Batches of hits, each on one part of one object: an implicit surface or a moving mesh.
pub struct HitBatches {
    batches: Vec<HitBatch>,
    /// A batch of adjacent lanes of a packet.
    neighbors: HitBatch,
    scratch: BatchScratch,
}

/// Scratch memory of the refinement of a batch.
struct BatchScratch {
    poses: Poses<BATCH_SIZE>,
    local: LocalRays<BATCH_SIZE>,
    refined: Refined,
}

/// Concurrent batches: a table indexed by a hash of object and part; a collision flushes the older batch.
const BATCHES: usize = 32;

/// Hits of a batch: two of the widest registers, so that each hides the latency of the other's divisions.
pub const BATCH_SIZE: usize = 2 * WIDEST;

/// At least this many hits of `BATCH_SIZE` adjacent lanes form their own batch; measurements show that fewer
/// are better collected.
const MANY: u32 = 8;

/// A hit that is to be refined.
pub struct BoundedHit {
    /// The ray's index in the arrays of hits.
    pub at: u32,
    pub root: RootId,
    /// Bounds of t.
    pub bounds: Interval,
    pub ray: TimedRay,
}

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct HitBatch {
    origin: [[f64; BATCH_SIZE]; 3],
    direction: [[f64; BATCH_SIZE]; 3],
    time: [f64; BATCH_SIZE],
    /// The bounds of t.
    low: [f64; BATCH_SIZE],
    high: [f64; BATCH_SIZE],
    /// Common to all hits, except for the primitive and the index of the root.
    root: RootId,
    primitive: [u32; BATCH_SIZE],
    index: [u8; BATCH_SIZE],
    at: [u32; BATCH_SIZE],
    /// One bit for each slot that holds a hit.
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

    /// Adds a hit to its batch, and refines the batch once it is full.
    #[inline(always)]
    pub fn push<I: Isa>(&mut self, scene: &Scene, hit: &BoundedHit, hits: &mut (impl Sink + ?Sized)) {
        let BoundedHit { at, root, bounds, ray: TimedRay { origin, direction, time } } = *hit;
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

    /// Refines the hits of adjacent lanes: those of `lanes`, among the `BATCH_SIZE` lanes from `start` on,
    /// that hit the same part of the same object as the first of them, if there are many. Returns the refined
    /// lanes.
    #[inline(always)]
    pub fn refine_neighbors<I: Isa>(
        &mut self,
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
        batch.flush::<I>(closest.scene(), &mut self.scratch, hits);
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
        let then = poses.gather::<I>(scene, self.root.object, &self.time, slots);
        let placements = Placements { first: object.inverse(), then };
        let world = WorldRays { origin: &self.origin, direction: &self.direction };
        refined.known = 0;
        let stepped = if placements.is_identity() {
            // `TriangleHits` refines hits on still meshes, unless their maps are extreme.
            match &object.geometry {
                Geometry::Surface(shape) => {
                    shape.dispatch::<I, _>(RefineBatch { rays: world, batch: self, refined })
                }
                Geometry::Mesh(_) => None,
                Geometry::Spheres(spheres) => self.refine_each::<I, _, _, _>(spheres, world, refined),
                Geometry::Disks(disks) => self.refine_each::<I, _, _, _>(disks, world, refined),
            }
        } else if local.localize::<I, OfDoubleDoubles>(placements, world, slots, self.has_one_origin()) {
            match &object.geometry {
                Geometry::Surface(shape) => {
                    shape.dispatch::<I, _>(RefineBatch { rays: &*local, batch: self, refined })
                }
                Geometry::Mesh(mesh) => {
                    let corners = &self.corners(mesh);
                    I::call_widest(RefineTriangleBatch { rays: &*local, corners, batch: self, refined })
                }
                Geometry::Spheres(spheres) => self.refine_each::<I, _, _, _>(spheres, &*local, refined),
                Geometry::Disks(disks) => self.refine_each::<I, _, _, _>(disks, &*local, refined),
            }
        } else {
            None
        };
        if !placements.is_identity() {
            placements.dispatch::<I, _>(TransformNormals(refined));
        }
        let id = self.root.object as i32;
        for eight in 0..BATCH_SIZE / WIDEST {
            let certain = part_of_mask::<WIDEST>(refined.known.into(), eight);
            let primitive = self.primitive.as_chunks().0[eight];
            let eight_hits = EightHits {
                t: &refined.t.as_chunks().0[eight],
                normal: [0, 1, 2].map(|axis| &refined.normal[axis].as_chunks().0[eight]),
                object: [id; WIDEST],
                primitive: primitive.map(|primitive| object.primitive_id(primitive)),
            };
            let written = hits.write_runs::<I>(&self.at.as_chunks().0[eight], certain, &eight_hits);
            self.slots &= !(Mask::from(written) << (eight * WIDEST));
        }
        while let Some(slot) = take(&mut self.slots) {
            let (at, primitive) = (self.at[slot] as usize, self.primitive[slot]);
            // No `Hit` is assembled first: reading several stores back as one load would stall.
            if refined.known & 1 << slot != 0 {
                let (normal, primitive) = (pick(&refined.normal, slot), object.primitive_id(primitive));
                hits.write(
                    at,
                    Hit { t: refined.t[slot], normal, object: self.root.object as i32, primitive },
                );
            } else {
                let bounds = Interval { low: self.low[slot], high: self.high[slot] };
                let root = RootId { primitive, index: self.index[slot], ..self.root };
                let (origin, direction) = (pick(&self.origin, slot), pick(&self.direction, slot));
                let ray = TimedRay { origin, direction, time: self.time[slot] };
                // The same step would fail again for a single ray.
                hits.write(
                    at,
                    match stepped {
                        Some(()) => scene.hit(&root, &ray),
                        None => scene.hit_within(&root, bounds, &ray),
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

    /// Refines hits on primitives of one object.
    #[inline(always)]
    fn refine_each<I: Isa, R: RayParts, S: Each<K>, const K: usize>(
        &self,
        primitives: &Primitives<S, K>,
        rays: R,
        refined: &mut Refined,
    ) -> Option<()> {
        let numbers = &self.numbers(primitives);
        I::call_widest(RefineEach { rays, numbers, batch: self, refined, kind: PhantomData::<S> })
    }

    /// The numbers of the primitives; empty slots repeat the first.
    #[inline(always)]
    fn numbers<S: Each<K>, const K: usize>(&self, primitives: &Primitives<S, K>) -> [[f64; BATCH_SIZE]; K] {
        let (mut numbers, first) = ([[0.0; BATCH_SIZE]; K], self.slots.trailing_zeros() as usize);
        for slot in 0..BATCH_SIZE {
            let row = primitives.row(self.primitive[if self.slots & 1 << slot != 0 { slot } else { first }]);
            for k in 0..K {
                numbers[k][slot] = row[k];
            }
        }
        numbers
    }
}

/// As `RefineBatch`, for hits on primitives of an object that holds many.
struct RefineEach<'a, R, S, const K: usize> {
    rays: R,
    numbers: &'a [[f64; BATCH_SIZE]; K],
    batch: &'a HitBatch,
    refined: &'a mut Refined,
    kind: PhantomData<S>,
}

impl<R: RayParts, S: Each<K>, const K: usize> LaneTask for RefineEach<'_, R, S, K> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, const N: usize>(self) {
        for i in 0..BATCH_SIZE / N {
            let active = Cell::new(part_of_mask::<N>(self.batch.slots, i));
            if active.get() == 0 {
                continue;
            }
            let mut numbers = [F::splat(0.0); K];
            for k in 0..K {
                numbers[k] = lanes::load(&self.numbers[k], i);
            }
            let target = EachOf::<S, F, K>(numbers, PhantomData);
            self.refined.refine::<R, F, N>(i, self.rays, &target, self.batch, &active);
        }
    }
}

#[inline(always)]
fn pick(v: &[[f64; BATCH_SIZE]; 3], slot: usize) -> Point {
    [v[0][slot], v[1][slot], v[2][slot]]
}

/// The refined hits of a batch.
struct Refined {
    /// One bit for each certain hit.
    known: u32,
    t: [f64; BATCH_SIZE],
    /// In the coordinates of the object, of any length, if these are not world coordinates.
    local_normal: [Stored<BATCH_SIZE>; 3],
    /// A unit normal in world coordinates.
    normal: [[f64; BATCH_SIZE]; 3],
}

/// Refines the hits of a batch. For rays in the coordinates of the object, `TransformNormals` computes the
/// world normals.
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

/// As `RefineBatch`, for hits on triangles of a mesh.
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

/// Computes the world normals; hits with an uncertain normal become unknown.
struct TransformNormals<'a>(&'a mut Refined);

impl PlacementTask for TransformNormals<'_> {
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
            // Closures would not be compiled for the instruction set.
            let [x, y, z] = &refined.local_normal;
            let normal = [
                DoubleDoubles::load(x, i, lanes),
                DoubleDoubles::load(y, i, lanes),
                DoubleDoubles::load(z, i, lanes),
            ];
            refined.store_normals(i, &placement.part(i).normals(normal, lanes), lanes);
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
            self.store_normals(i, &normal, lanes);
        } else {
            for axis in 0..3 {
                normal[axis].store(i, &mut self.local_normal[axis]);
            }
            self.known |= active.get() << (i * N);
        }
    }

    /// Stores the unit world normals of part `i`.
    #[inline(always)]
    fn store_normals<L: Lanes<N>, const N: usize>(
        &mut self,
        i: usize,
        along: &Vector<DoubleDoubles<L, N>>,
        lanes: L,
    ) {
        if let Ok(along) = Number::proportions(along) {
            let unit = vector::unit(along);
            for axis in 0..3 {
                self.normal[axis].as_chunks_mut().0[i] = unit[axis].store();
            }
            self.known |= lanes.active() << (i * N);
        }
    }
}
