//! The leaf intersector: rays of a packet against the triangles of a mesh's leaves.

use crate::arith::simd::Isa;
use crate::bvh::{LANES, Mask, RayPacket, SINGLE_RAYS, Stack, Visitor, take};
use crate::cast::closest_hit::ClosestHits;
use crate::cast::deferred::DeferredCandidates;
use crate::scene::TriangleMesh;
use crate::scene::{RootId, Scene};
use crate::shapes::triangle::{LEAF_SIZE, Leaf, LeafRay, Planes};

/// Intersects rays of one octant, in the local coordinates of a mesh, with its leaves.
pub struct LeafIntersector<'a, 's> {
    pub scene: &'s Scene,
    pub mesh: &'s TriangleMesh,
    pub id: u32,
    pub rays: &'a RayPacket,
    /// The same rays in world coordinates.
    pub world: &'a RayPacket,
    pub closest: &'a mut ClosestHits<'s>,
    /// None if the mesh is transformed.
    pub deferred: Option<&'a mut DeferredCandidates>,
    pub scratch: &'a mut LeafScratch,
}

/// Scratch memory of the tests in leaves.
pub struct LeafScratch {
    /// Of the rays with candidates, one after the other, the sums U + V + W by triangle.
    sums: [[f64; LEAF_SIZE]; LANES],
    planes: [Planes; SINGLE_RAYS],
}

impl LeafScratch {
    pub fn new() -> Self {
        LeafScratch { sums: [[0.0; LEAF_SIZE]; LANES], planes: [Planes::NONE; SINGLE_RAYS] }
    }
}

/// The test of a ray in a leaf: masks of the candidates, and of those that are certain hits. Bytes, as an array of these is cleared for each leaf.
#[derive(Clone, Copy)]
struct LeafTest {
    lane: u8,
    candidates: u8,
    sure: u8,
    /// The index of the leaf.
    leaf: u8,
}

impl LeafTest {
    const NOTHING: LeafTest = LeafTest { lane: 0, candidates: 0, sure: 0, leaf: 0 };
}

impl LeafIntersector<'_, '_> {
    /// Intersects these rays with a leaf, and returns the mask of those whose limits have decreased.
    #[inline(always)]
    pub fn intersect<I: Isa>(&mut self, leaf: &Leaf, mask: Mask) -> Mask {
        let mut nearer = 0;
        for group in self.rays.origin_groups() {
            let same = mask & group;
            if same != 0 {
                nearer |= self.test::<I>(leaf, same);
            }
        }
        nearer
    }

    #[inline(always)]
    fn ray(&self, lane: usize) -> LeafRay {
        let RayPacket { length, direction_error, .. } = self.rays;
        LeafRay { direction: self.rays.direction(lane), length: length[lane], error: direction_error[lane] }
    }

    /// As `intersect`, with rays of one origin.
    #[inline(always)]
    fn test<I: Isa>(&mut self, leaf: &Leaf, mask: Mask) -> Mask {
        let first = mask.trailing_zeros() as usize;
        let edges = leaf.edges::<I>(self.rays.origin(first), self.rays.origin_error[first]);
        // All rays are tested before any result is used, so that no branch depends on a single test.
        let mut tests = [LeafTest::NOTHING; LANES];
        let mut count = 0;
        let mut left = mask;
        while let Some(lane) = take(&mut left) {
            let (candidates, sure) = leaf.candidates::<I>(&edges, &self.ray(lane), &mut self.scratch.sums[count]);
            tests[count] = LeafTest { lane: lane as u8, candidates: candidates as u8, sure: sure as u8, leaf: 0 };
            count += usize::from(candidates != 0);
        }
        if count == 0 {
            return 0;
        }
        self.scratch.planes[0] = leaf.planes::<I>(&edges);
        self.accept::<I>(&tests[..count], &[leaf])
    }

    /// Updates the closest hits by tests in leaves, and returns the mask of rays whose limits have decreased.
    #[inline(always)]
    fn accept<I: Isa>(&mut self, tests: &[LeafTest], leaves: &[&Leaf]) -> Mask {
        let mut nearer = 0;
        for (k, &LeafTest { lane, candidates, sure, leaf }) in tests.iter().enumerate() {
            let (lane, mut candidates) = (usize::from(lane), Mask::from(candidates));
            let (ray, leaf) = (self.ray(lane), usize::from(leaf));
            while let Some(i) = take(&mut candidates) {
                let primitive = leaves[leaf].ids()[i];
                let known = if sure & 1 << i != 0 {
                    let t = Leaf::intersect::<I>(i, &self.scratch.planes[leaf], &ray, &self.scratch.sums[k]);
                    t.map(|t| self.rays.t_of_ray(lane, t))
                } else {
                    None
                };
                match known {
                    Some(t) if t.low > self.closest.limits()[lane] => continue,
                    Some(t) => self.closest.offer(self.world, lane, RootId::of_triangle(self.id, primitive), t),
                    None => {
                        self.defer::<I>(lane, primitive);
                        continue;
                    }
                }
                self.mesh.prefetch_face::<I>(primitive);
                nearer |= 1 << lane;
            }
        }
        nearer
    }

    /// Defers a candidate that the test in the leaf left uncertain.
    #[inline(always)]
    fn defer<I: Isa>(&mut self, lane: usize, primitive: u32) {
        let Some(deferred) = &mut self.deferred else {
            self.closest.consider(self.world, lane, self.id, primitive);
            return;
        };
        if deferred.is_full() {
            deferred.resolve::<I>(self.scene, self.world, self.closest);
        }
        deferred.push::<I>(self.scene, lane, RootId::of_triangle(self.id, primitive));
    }
}

impl Visitor<Leaf> for LeafIntersector<'_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, _: &mut Stack, lanes: &[usize], leaves: &[&Leaf]) -> Mask {
        let mut tests = [LeafTest::NOTHING; SINGLE_RAYS];
        let mut count = 0;
        for (k, (&lane, leaf)) in lanes.iter().zip(leaves).enumerate() {
            let edges = leaf.edges::<I>(self.rays.origin(lane), self.rays.origin_error[lane]);
            let (candidates, sure) = leaf.candidates::<I>(&edges, &self.ray(lane), &mut self.scratch.sums[count]);
            self.scratch.planes[k] = leaf.planes::<I>(&edges);
            tests[count] = LeafTest { lane: lane as u8, candidates: candidates as u8, sure: sure as u8, leaf: k as u8 };
            count += usize::from(candidates != 0);
        }
        self.accept::<I>(&tests[..count], leaves)
    }

    #[inline(always)]
    fn limits(&self) -> &[f64; LANES] {
        self.closest.limits()
    }
}
