//! The leaf intersector: tests rays of a packet against the triangles of a mesh's leaves.

use crate::arith::number::UNIT;
use crate::arith::simd::{Floats, Isa};
use crate::bvh::{LANES, Mask, RayPacket, Stack, Visitor, part_of_mask, take};
use crate::cast::closest_hit::ClosestHits;
use crate::cast::deferred::DeferredCandidates;
use crate::geometry::vector::Point;
use crate::scene::TriangleMesh;
use crate::scene::{RootId, Scene};
use crate::shapes::triangle::{Edges, LEAF_SIZE, Leaf, LeafRay, LeafRays, Planes, RayBounds, TriangleTest};

/// With at least this many rays, triangles of a leaf are culled for all of them. If few triangles remain,
/// each is tested against eight rays at a time.
const MANY: u32 = 16;

/// Intersects rays of one octant, in the local coordinates of a mesh, with its leaves.
pub struct LeafIntersector<'a, 's> {
    pub scene: &'s Scene,
    pub mesh: &'s TriangleMesh,
    pub id: u32,
    pub rays: &'a RayPacket,
    /// The same rays in world coordinates.
    pub world: &'a RayPacket,
    pub closest: &'a mut ClosestHits<'s>,
    /// Whether the mesh is transformed.
    pub transformed: bool,
    /// `None` if the mesh moves, or is transformed by an extreme map.
    pub deferred: Option<&'a mut DeferredCandidates>,
    pub scratch: &'a mut LeafScratch,
}

/// Scratch memory of the tests in leaves.
#[repr(C, align(64))]
pub struct LeafScratch {
    /// For each ray with candidates, the sums U + V + W by triangle.
    sums: [[f64; LEAF_SIZE]; LANES],
    /// The tests of these rays.
    tests: [LeafTest; LANES],
    /// The planes of the leaves of single rays, or of the one leaf of a packet.
    planes: [Planes; LANES],
    /// Their normals, if the rays of the packet start apart.
    plane_normals: [[f64; LEAF_SIZE]; 3],
    /// Bounds of the rays that traverse the mesh, computed on first use.
    pub bounds: Option<RayBounds>,
}

impl LeafScratch {
    pub fn new() -> Self {
        let (sums, nothing) =
            ([[0.0; LEAF_SIZE]; LANES], LeafTest { lane: 0, candidates: 0, sure: 0, planes: 0 });
        LeafScratch {
            sums,
            tests: [nothing; LANES],
            planes: [Planes::NONE; LANES],
            plane_normals: [[0.0; LEAF_SIZE]; 3],
            bounds: None,
        }
    }

    /// Keeps a test, with the next planes, if it has candidates; branchless.
    #[inline(always)]
    fn keep(&mut self, tests: &mut LeafTests, lane: usize, candidates: u32, sure: u32) {
        let planes = tests.planes as u8;
        self.tests[tests.count] =
            LeafTest { lane: lane as u8, candidates: candidates as u8, sure: sure as u8, planes };
        tests.count += usize::from(candidates != 0);
    }
}

/// The test of a ray in a leaf: masks of the candidates, and of the certain hits among them.
#[derive(Clone, Copy)]
struct LeafTest {
    lane: u8,
    candidates: u8,
    sure: u8,
    /// The index of the leaf's planes as seen from the origin of the ray.
    planes: u8,
}

/// The number of tests with candidates, and of planes for them.
#[derive(Clone, Copy, Default)]
struct LeafTests {
    count: usize,
    planes: usize,
}

impl LeafIntersector<'_, '_> {
    /// Intersects these rays with a leaf, and returns the mask of those whose limits have decreased.
    #[inline(always)]
    pub fn intersect<I: Isa>(&mut self, leaf: &Leaf, mask: Mask) -> Mask {
        if self.rays.one_origin {
            self.intersect_from::<I, false>(leaf, mask)
        } else {
            self.intersect_from::<I, true>(leaf, mask)
        }
    }

    /// As `intersect`; `APART` says that rays start apart from the first.
    #[inline(always)]
    fn intersect_from<I: Isa, const APART: bool>(&mut self, leaf: &Leaf, mask: Mask) -> Mask {
        let RayPacket { spread, largest_origin_error, has_offsets, .. } = *self.rays;
        let edges = leaf.edges(&leaf.grid_vertices::<I>(), self.rays.origin(0), spread, largest_origin_error);
        // Not in transformed meshes, whose visits are too many and too short to bound the rays for each.
        if mask.count_ones() >= MANY && !has_offsets && !self.transformed {
            let reachable = leaf.reachable::<I, APART>(&edges, &self.bounds::<I, APART>());
            let eights = (0..LANES / 8).filter(|&eight| part_of_mask::<8>(mask, eight) != 0).count();
            if reachable.count_ones() as usize * eights < mask.count_ones() as usize {
                return self.test_each::<I, APART>(leaf, &edges, reachable, mask);
            }
        }
        // All rays are tested before any result is used, so no branch depends on a single test.
        let (mut tests, mut left) = (LeafTests::default(), mask);
        while let Some(lane) = take(&mut left) {
            let sums = &mut self.scratch.sums[tests.count];
            let (candidates, sure) =
                leaf.candidates::<I, APART>(&edges, &ray::<APART>(self.rays, lane), sums);
            self.scratch.keep(&mut tests, lane, candidates, sure);
        }
        if tests.count > 0 {
            self.scratch.planes[0] = leaf.planes::<I>(&edges);
            if APART {
                self.scratch.plane_normals = edges.plane_normals();
            }
        }
        self.accept::<I, APART>(tests, |_| leaf, Some(&edges))
    }

    /// Intersects rays with these triangles of a leaf, one after the other.
    #[inline(always)]
    fn test_each<I: Isa, const APART: bool>(
        &mut self,
        leaf: &Leaf,
        edges: &Edges<I>,
        reachable: u32,
        mask: Mask,
    ) -> Mask {
        let (stored, planes) = (edges.store(), leaf.planes(edges));
        let (mut nearer, mut left) = (0, Mask::from(reachable));
        while let Some(i) = take(&mut left) {
            let root = RootId::of_triangle(self.id, leaf.ids()[i]);
            let before = nearer;
            for eight in 0..LANES / 8 {
                let active = part_of_mask::<8>(mask, eight);
                if active == 0 {
                    continue;
                }
                let TriangleTest { candidates, known, t } =
                    Leaf::test::<I, APART>(i, &stored, &planes, &self.eight_rays::<I, APART>(eight));
                let (known, mut unknown) = (known & active, Mask::from(candidates & !known & active));
                let taken = self.closest.accept_eight::<I>(self.world, eight, known, root, t);
                nearer |= Mask::from(taken.nearer) << (8 * eight);
                while let Some(k) = take(&mut unknown) {
                    nearer |= self.defer::<I>(8 * eight + k, root.primitive);
                }
            }
            if nearer != before {
                self.mesh.prefetch_face::<I>(root.primitive);
            }
        }
        nearer
    }

    /// Bounds of all rays.
    #[inline(always)]
    fn bounds<I: Isa, const APART: bool>(&mut self) -> RayBounds {
        if let Some(bounds) = self.scratch.bounds {
            return bounds;
        }
        let LeafRays { direction, mut error, moment, .. } = self.eight_rays::<I, APART>(0);
        let (mut low, mut high) = ([direction, moment], [direction, moment]);
        for eight in 1..self.rays.count.div_ceil(8) {
            let rays = self.eight_rays::<I, APART>(eight);
            for (k, column) in [rays.direction, rays.moment].into_iter().enumerate() {
                for axis in 0..3 {
                    low[k][axis] = Floats::min(low[k][axis], column[axis]);
                    high[k][axis] = Floats::max(high[k][axis], column[axis]);
                }
            }
            error = Floats::max(error, rays.error);
        }
        let [low, low_moment] = [smallest(low[0]), smallest(low[1])];
        let [high, high_moment] = [largest(high[0]), largest(high[1])];
        let length = (0..3).fold(0.0, |sum, i| sum + low[i].abs().max(high[i].abs()));
        // Two roundings, and one here.
        let length = length * (1.0 + 4.0 * UNIT);
        let error = error.largest();
        *self.scratch.bounds.insert(RayBounds { low, high, low_moment, high_moment, length, error })
    }

    #[inline(always)]
    fn eight_rays<I: Isa, const APART: bool>(&self, eight: usize) -> LeafRays<I> {
        let RayPacket { length, direction_error, .. } = self.rays;
        let nothing = [I::F64x8::splat(0.0); 3];
        LeafRays {
            direction: self.rays.directions::<I>(eight),
            length: I::F64x8::load(&length.as_chunks().0[eight]),
            error: I::F64x8::load(&direction_error.as_chunks().0[eight]),
            start: if APART { self.rays.starts::<I>(eight) } else { nothing },
            moment: if APART { self.rays.moments::<I>(eight) } else { nothing },
        }
    }

    /// Updates the closest hits from tests in leaves, and returns the mask of rays whose limits have
    /// decreased. The edges of the leaf are given if all rays share it.
    #[inline(always)]
    fn accept<'l, I: Isa, const APART: bool>(
        &mut self,
        tests: LeafTests,
        leaf: impl Fn(usize) -> &'l Leaf,
        edges: Option<&Edges<I>>,
    ) -> Mask {
        let mut nearer = 0;
        for k in 0..tests.count {
            let LeafTest { lane, candidates, sure, planes } = self.scratch.tests[k];
            let (lane, mut candidates) = (usize::from(lane), Mask::from(candidates));
            let (ray, planes, mut unknown) = (ray::<APART>(self.rays, lane), usize::from(planes), 0);
            while let Some(i) = take(&mut candidates) {
                let primitive = leaf(planes).ids()[i];
                let known = if sure & 1 << i != 0 {
                    let LeafScratch { planes: all, plane_normals, sums, .. } = &*self.scratch;
                    let t = all[planes].intersect_one::<APART>(i, plane_normals, &ray, &sums[k]);
                    t.map(|t| self.rays.t_of_ray(lane, t))
                } else {
                    None
                };
                let Some(t) = known else {
                    unknown |= 1 << i;
                    continue;
                };
                if self.closest.accept_only(self.world, lane, RootId::of_triangle(self.id, primitive), t) {
                    self.mesh.prefetch_face::<I>(primitive);
                    nearer |= 1 << lane;
                }
            }
            if unknown != 0 {
                let leaf = leaf(planes);
                let beside = match edges {
                    Some(edges) => Leaf::beside::<I, APART>(edges, &ray),
                    None => {
                        let error = self.rays.origin_error[lane];
                        let vertices = leaf.grid_vertices::<I>();
                        let edges = leaf.edges(&vertices, self.rays.origin(lane), 0.0, error);
                        Leaf::beside::<I, APART>(&edges, &ray)
                    }
                };
                let mut unknown = Mask::from(unknown & !beside);
                while let Some(i) = take(&mut unknown) {
                    nearer |= self.defer::<I>(lane, leaf.ids()[i]);
                }
            }
        }
        nearer
    }

    /// Defers a candidate that the test in the leaf left uncertain. Returns the rays whose limits may have
    /// decreased.
    #[inline(always)]
    fn defer<I: Isa>(&mut self, lane: usize, primitive: u32) -> Mask {
        let Some(deferred) = &mut self.deferred else {
            self.closest.intersect(self.world, lane, self.id, primitive);
            return 1 << lane;
        };
        let nearer = if deferred.is_full(self.scene, self.id) {
            deferred.resolve::<I>(self.scene, self.world, self.closest)
        } else {
            0
        };
        deferred.push::<I>(self.scene, lane, RootId::of_triangle(self.id, primitive));
        nearer
    }
}

impl Visitor<Leaf> for LeafIntersector<'_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, _: &mut Stack, lanes: &[usize], leaves: &[&Leaf]) -> Mask {
        let mut tests = LeafTests::default();
        for (&lane, leaf) in lanes.iter().zip(leaves) {
            let (origin, error) = (self.rays.origin(lane), self.rays.origin_error[lane]);
            let edges = leaf.edges(&leaf.grid_vertices::<I>(), origin, 0.0, error);
            let sums = &mut self.scratch.sums[tests.count];
            let (candidates, sure) =
                leaf.candidates::<I, false>(&edges, &ray::<false>(self.rays, lane), sums);
            self.scratch.planes[tests.planes] = leaf.planes::<I>(&edges);
            self.scratch.keep(&mut tests, lane, candidates, sure);
            tests.planes += 1;
        }
        self.accept::<I, false>(tests, |k| leaves[k], None)
    }

    #[inline(always)]
    fn limits(&self) -> &[f64; LANES] {
        self.closest.limits()
    }
}

/// The ray of a lane; relative to the origin of the first ray if rays start `APART` from it.
#[inline(always)]
fn ray<const APART: bool>(rays: &RayPacket, lane: usize) -> LeafRay {
    let (direction, length, error) = (rays.direction(lane), rays.length[lane], rays.direction_error[lane]);
    let [start, moment] = if APART { [rays.start(lane), rays.moment(lane)] } else { [[0.0; 3]; 2] };
    LeafRay { direction, length, error, start, moment }
}

#[inline(always)]
fn smallest<F: Floats<f64, 8>>([x, y, z]: [F; 3]) -> Point {
    [x.smallest(), y.smallest(), z.smallest()]
}

#[inline(always)]
fn largest<F: Floats<f64, 8>>([x, y, z]: [F; 3]) -> Point {
    [x.largest(), y.largest(), z.largest()]
}
