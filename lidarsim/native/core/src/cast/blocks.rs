//! Rays of a packet at the leaves of a mesh.

use crate::arith::simd::Isa;
use crate::bvh::{LANES, LEAF, Mask, Rays, Stack, Visitor, WALKS, take};
use crate::cast::doubt::Doubts;
use crate::cast::search::Searches;
use crate::scene::TriangleMesh;
use crate::scene::{Place, Scene};
use crate::shapes::triangle::{Bearing, Block, Planes};

/// Rays of one octant, in the coordinates of a mesh, among its triangles.
pub struct Blocks<'a, 's> {
    pub scene: &'s Scene,
    pub mesh: &'s TriangleMesh,
    pub id: u32,
    pub rays: &'a Rays,
    /// The same, as they are in the world.
    pub world: &'a Rays,
    pub searches: &'a mut Searches<'s>,
    /// None if the mesh was moved.
    pub doubts: Option<&'a mut Doubts>,
    pub looks: &'a mut Looks,
}

/// Room for what rays see of blocks.
pub struct Looks {
    /// Of the rays that may meet a block, one after the other, the sums of volumes.
    sums: [[f64; LEAF]; LANES],
    planes: [Planes; WALKS],
}

impl Looks {
    pub fn new() -> Self {
        Looks { sums: [[0.0; LEAF]; LANES], planes: [Planes::NONE; WALKS] }
    }
}

/// What a ray has seen of a block: the candidates, and the sure ones of them. A byte each, as an array of this is written anew at each look.
#[derive(Clone, Copy)]
struct Seen {
    lane: u8,
    candidates: u8,
    sure: u8,
    /// Which of the blocks it was.
    block: u8,
}

impl Seen {
    const NOTHING: Seen = Seen { lane: 0, candidates: 0, sure: 0, block: 0 };
}

impl Blocks<'_, '_> {
    /// Meets the block with these rays, and says which of them want less than before.
    #[inline(always)]
    pub fn meet<I: Isa>(&mut self, block: &Block, mask: Mask) -> Mask {
        // One loop, so that there is one look.
        let (mut nearer, mut left) = (0, mask);
        while left != 0 {
            let one_origin = self.rays.one_origin || left & (left - 1) == 0;
            let same = if one_origin { left } else { left & self.rays.at_origin_of(left.trailing_zeros() as usize) };
            nearer |= self.look::<I>(block, same);
            left &= !same;
        }
        nearer
    }

    #[inline(always)]
    fn bearing(&self, lane: usize) -> Bearing {
        let Rays { length, direction_error, .. } = self.rays;
        Bearing { direction: self.rays.direction(lane), length: length[lane], error: direction_error[lane] }
    }

    /// As `meet`, with rays of one origin.
    #[inline(always)]
    fn look<I: Isa>(&mut self, block: &Block, mask: Mask) -> Mask {
        let first = mask.trailing_zeros() as usize;
        let edges = block.edges::<I>(self.rays.origin(first), self.rays.origin_error[first]);
        // All rays look before one acts on what it saw, so that no branch hangs on a single look.
        let mut seen = [Seen::NOTHING; LANES];
        let mut count = 0;
        let mut left = mask;
        while let Some(lane) = take(&mut left) {
            let (candidates, sure) = block.candidates::<I>(&edges, &self.bearing(lane), &mut self.looks.sums[count]);
            seen[count] = Seen { lane: lane as u8, candidates: candidates as u8, sure: sure as u8, block: 0 };
            count += usize::from(candidates != 0);
        }
        if count == 0 {
            return 0;
        }
        self.looks.planes[0] = block.planes::<I>(&edges);
        self.act::<I>(&seen[..count], &[block])
    }

    /// Takes what rays have seen of blocks, and says which of the rays want less than before.
    #[inline(always)]
    fn act<I: Isa>(&mut self, seen: &[Seen], blocks: &[&Block]) -> Mask {
        let mut nearer = 0;
        for (k, &Seen { lane, candidates, sure, block }) in seen.iter().enumerate() {
            let (lane, mut candidates) = (usize::from(lane), Mask::from(candidates));
            let (bearing, block) = (self.bearing(lane), usize::from(block));
            while let Some(i) = take(&mut candidates) {
                let primitive = blocks[block].ids()[i];
                let known = if sure & 1 << i != 0 {
                    Block::meet::<I>(i, &self.looks.planes[block], &bearing, &self.looks.sums[k])
                } else {
                    None
                };
                match known {
                    Some(t) if t.low > self.searches.limits()[lane] => continue,
                    Some(t) => self.searches.offer(self.world, lane, Place::of_triangle(self.id, primitive), t),
                    None => {
                        self.doubt::<I>(lane, primitive);
                        continue;
                    }
                }
                self.mesh.prefetch_face::<I>(primitive);
                nearer |= 1 << lane;
            }
        }
        nearer
    }

    /// Keeps for later what a look could not tell.
    #[inline(always)]
    fn doubt<I: Isa>(&mut self, lane: usize, primitive: u32) {
        let Some(doubts) = &mut self.doubts else {
            self.searches.consider(self.world, lane, self.id, primitive);
            return;
        };
        if doubts.are_full() {
            doubts.settle::<I>(self.scene, self.world, self.searches);
        }
        doubts.push::<I>(self.scene, lane, Place::of_triangle(self.id, primitive));
    }
}

impl Visitor<Block> for Blocks<'_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, _: &mut Stack, lanes: &[usize], blocks: &[&Block]) -> Mask {
        let mut seen = [Seen::NOTHING; WALKS];
        let mut count = 0;
        for (k, (&lane, block)) in lanes.iter().zip(blocks).enumerate() {
            let edges = block.edges::<I>(self.rays.origin(lane), self.rays.origin_error[lane]);
            let (candidates, sure) = block.candidates::<I>(&edges, &self.bearing(lane), &mut self.looks.sums[count]);
            self.looks.planes[k] = block.planes::<I>(&edges);
            seen[count] = Seen { lane: lane as u8, candidates: candidates as u8, sure: sure as u8, block: k as u8 };
            count += usize::from(candidates != 0);
        }
        self.act::<I>(&seen[..count], blocks)
    }

    #[inline(always)]
    fn limits(&self) -> &[f64; LANES] {
        self.searches.limits()
    }
}
