//! Many shapes of one kind in one object, in the leaves of their hierarchy.

use std::fmt;
use std::marker::PhantomData;

use crate::arith::number::Interval;
use crate::bvh::{Bvh, MAX_LEAF_SIZE};
use crate::geometry::ray::union;
use crate::shapes::{Disk, Each, Sphere};
use crate::{memory, stop};

pub type Spheres = Primitives<Sphere, 4>;
pub type Disks = Primitives<Disk, 7>;

/// Up to eight shapes: each of the numbers that define one, for all of them. Unused lanes repeat the first.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct PrimitiveLeaf<const K: usize> {
    pub numbers: [[f64; MAX_LEAF_SIZE]; K],
    ids: [u32; MAX_LEAF_SIZE],
    count: u32,
}

impl<const K: usize> PrimitiveLeaf<K> {
    fn new(ids: &[u32], rows: &[[f64; K]]) -> Self {
        let at = |lane: usize| ids[if lane < ids.len() { lane } else { 0 }];
        PrimitiveLeaf {
            numbers: std::array::from_fn(|k| std::array::from_fn(|lane| rows[at(lane) as usize][k])),
            ids: std::array::from_fn(at),
            count: ids.len() as u32,
        }
    }

    #[inline(always)]
    pub fn ids(&self) -> &[u32] {
        &self.ids[..self.count as usize]
    }

    /// The id of the shape in a lane.
    #[inline(always)]
    pub fn id(&self, lane: usize) -> u32 {
        self.ids[lane]
    }

    /// One bit for each shape.
    #[inline(always)]
    pub fn all(&self) -> u32 {
        (1 << self.count) - 1
    }

    #[inline(always)]
    pub fn row(&self, lane: usize) -> [f64; K] {
        let mut row = [0.0; K];
        for k in 0..K {
            row[k] = self.numbers[k][lane];
        }
        row
    }
}

/// Shapes of kind S, defined by K numbers each. The leaves of the hierarchy hold the only copy of the
/// numbers, so the hierarchy is built at once.
pub struct Primitives<S, const K: usize> {
    hierarchy: Bvh<PrimitiveLeaf<K>>,
    /// By id, eight times the index of the leaf plus the lane.
    places: Vec<u32>,
    bounds: Option<[Interval; 3]>,
    kind: PhantomData<S>,
}

impl<S, const K: usize> fmt::Debug for Primitives<S, K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Primitives").field("len", &self.places.len()).finish_non_exhaustive()
    }
}

impl<S: Each<K>, const K: usize> Primitives<S, K> {
    /// Each row holds the numbers of a bounded shape.
    pub fn new(rows: &[[f64; K]]) -> Self {
        // Room for leaves that are half full.
        let leaves = 2 * rows.len().div_ceil(MAX_LEAF_SIZE);
        memory::expect_room(leaves * size_of::<PrimitiveLeaf<K>>(), || {
            format!("a hierarchy over {} primitives", rows.len())
        });
        let hierarchy = Bvh::new(
            rows.len(),
            |id| S::of(rows[id as usize]).bounds(),
            MAX_LEAF_SIZE,
            |ids| PrimitiveLeaf::new(ids, rows),
        );
        let mut places = memory::with_capacity(rows.len());
        places.resize(rows.len(), 0);
        let mut bounds: Option<[Interval; 3]> = None;
        for (at, leaf) in hierarchy.leaves().iter().enumerate() {
            stop::poll();
            for (lane, &id) in leaf.ids().iter().enumerate() {
                places[id as usize] = (MAX_LEAF_SIZE * at + lane) as u32;
                bounds = bounds.into_iter().chain(S::of(leaf.row(lane)).bounds()).reduce(union);
            }
        }
        Primitives { hierarchy, places, bounds, kind: PhantomData }
    }

    pub fn len(&self) -> usize {
        self.places.len()
    }

    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    pub fn hierarchy(&self) -> &Bvh<PrimitiveLeaf<K>> {
        &self.hierarchy
    }

    pub fn bounds(&self) -> Option<[Interval; 3]> {
        self.bounds
    }

    /// The numbers of a shape.
    #[inline(always)]
    pub fn row(&self, id: u32) -> [f64; K] {
        let place = self.places[id as usize] as usize;
        self.hierarchy.leaves()[place / MAX_LEAF_SIZE].row(place % MAX_LEAF_SIZE)
    }

    /// The numbers of all shapes, by id.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = [f64; K]> {
        (0..self.len() as u32).map(|id| self.row(id))
    }

    #[inline(always)]
    pub fn shape(&self, id: u32) -> S {
        S::of(self.row(id))
    }

    pub fn bytes(&self) -> usize {
        self.hierarchy.bytes() + self.places.len() * size_of::<u32>()
    }
}
