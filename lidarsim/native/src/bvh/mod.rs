//! A bounding volume hierarchy, eight children wide.
//!
//! Boxes are float32, relative to a float64 centre and rounded outward, so that a box never loses what it holds. They only
//! choose which primitives are asked; every decision is made elsewhere, in the numbers that were given.

mod build;
mod packet;
mod span;

use packet::Hull;
pub use packet::{LANES, Mask, Packet, Rays, all};
pub use span::Span;

use crate::number::Interval;
use crate::simd::Isa;
use crate::vector::Point;

pub const WIDTH: usize = 8;

/// Most primitives a leaf may hold.
pub const LEAF: usize = 8;

/// Eight boxes, an axis after the other, and what they hold. An absent child has a box that nothing meets.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Node {
    low: [[f32; WIDTH]; 3],
    high: [[f32; WIDTH]; 3],
    child: [Child; WIDTH],
}

/// The index of a node or of a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Child(u32);

impl Child {
    const LEAF_BIT: u32 = 1 << 31;

    fn node(index: usize) -> Self {
        Child(index as u32)
    }

    fn leaf(index: usize) -> Self {
        Child(Self::LEAF_BIT | index as u32)
    }

    #[inline(always)]
    fn is_leaf(self) -> bool {
        self.0 & Self::LEAF_BIT != 0
    }

    #[inline(always)]
    fn index(self) -> usize {
        (self.0 & !Self::LEAF_BIT) as usize
    }
}

/// What the rays of a packet do at the leaves. A trait and no closure, which would not be compiled for the instruction set.
pub trait Visitor<L> {
    /// Gets the rays that may meet the leaf, and says which of them want less than before.
    fn visit<I: Isa>(&mut self, stack: &mut Stack, leaf: &L, mask: Mask) -> Mask;

    /// The t beyond which nothing is wanted of the ray.
    fn limit(&self, lane: usize) -> f64;
}

/// A hierarchy over leaves of whatever kind.
#[derive(Clone, Debug)]
pub struct Bvh<L> {
    center: Point,
    nodes: Vec<Node>,
    leaves: Vec<L>,
}

impl<L: Send> Bvh<L> {
    /// Over primitives 0 to `count`; those without a box (none) are left out. `leaf` makes a leaf of up to `most` primitives, at
    /// most `LEAF`.
    pub fn new(
        count: usize,
        bounds: impl Fn(u32) -> Option<[Interval; 3]> + Sync,
        most: usize,
        leaf: impl Fn(&[u32]) -> L + Sync,
    ) -> Self {
        build::build(count, bounds, most.min(LEAF), leaf)
    }

    pub fn center(&self) -> Point {
        self.center
    }

    /// The leaf, if there is but one.
    pub fn only_leaf(&self) -> Option<&L> {
        if self.leaves.len() == 1 { self.leaves.first() } else { None }
    }

    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.leaves.len() * size_of::<L>()
    }

    /// Offers the leaves that the ray may meet, nearest box first: `visit` answers with the t beyond which nothing is wanted
    /// any more. It may traverse another hierarchy on the same stack.
    pub fn traverse(&self, span: &mut Span, stack: &mut Stack, mut visit: impl FnMut(&mut Stack, &L) -> f64) {
        if self.nodes.is_empty() {
            return;
        }
        let base = stack.len[0];
        stack.push_sorted(0, base, Entry { near: 0.0, child: Child::node(0), mask: 0 });
        while let Some(entry) = stack.pop(0, base) {
            if entry.near > span.limit() {
                continue;
            }
            if entry.child.is_leaf() {
                span.shorten(visit(stack, &self.leaves[entry.child.index()]));
                continue;
            }
            let node = &self.nodes[entry.child.index()];
            let (near, far) = span.meet(&node.low, &node.high);
            let first = stack.len[0];
            for i in 0..WIDTH {
                if near[i] <= far[i] {
                    stack.push_sorted(0, first, Entry { near: near[i], child: node.child[i], mask: 0 });
                }
            }
        }
    }

    /// As `traverse`, for rays of a packet: together if they are coherent, else one after the other.
    #[inline(always)]
    pub fn traverse_packet<I: Isa>(
        &self,
        packet: &mut Packet,
        active: Mask,
        coherent: bool,
        stack: &mut Stack,
        visitor: &mut impl Visitor<L>,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        if coherent && active & (active - 1) != 0 {
            self.traverse_together::<I>(packet, active, stack, visitor);
            return;
        }
        self.traverse_each::<I>(packet, active, stack, visitor);
    }

    #[inline(always)]
    fn traverse_together<I: Isa>(
        &self,
        packet: &mut Packet,
        active: Mask,
        stack: &mut Stack,
        visitor: &mut impl Visitor<L>,
    ) {
        let hull = packet.hull_of_all::<I>();
        let base = stack.len[0];
        let mut entry = Entry { near: 0.0, child: Child::node(0), mask: active };
        loop {
            if entry.child.is_leaf() {
                let mut nearer = visitor.visit::<I>(stack, &self.leaves[entry.child.index()], entry.mask);
                while nearer != 0 {
                    let lane = nearer.trailing_zeros() as usize;
                    nearer &= nearer - 1;
                    packet.set_limit(lane, visitor.limit(lane));
                }
            } else {
                let node = &self.nodes[entry.child.index()];
                let meeting = hull.meet::<I>(node, f32::INFINITY);
                let mut met = meeting.met;
                let first = stack.len[0];
                while met != 0 {
                    let i = met.trailing_zeros() as usize;
                    met &= met - 1;
                    let mask = packet.meet::<I>(entry.mask, &meeting, i);
                    if mask != 0 {
                        let child = node.child[i];
                        self.prefetch::<I>(child);
                        stack.push_sorted(0, first, Entry { near: meeting.near[i], child, mask });
                    }
                }
            }
            entry = loop {
                let Some(mut next) = stack.pop(0, base) else { return };
                next.mask = packet.within::<I>(next.mask, next.near);
                if next.mask != 0 {
                    break next;
                }
            }
        }
    }

    /// A few rays by turns, a step each: while one waits for memory, the others go on.
    #[inline(always)]
    fn traverse_each<I: Isa>(
        &self,
        packet: &mut Packet,
        active: Mask,
        stack: &mut Stack,
        visitor: &mut impl Visitor<L>,
    ) {
        let mut left = active;
        let start = |lane: usize, stack: usize, base: usize, packet: &Packet| Walk {
            lane,
            hull: packet.hull_of_one(lane),
            limit: packet.limit(lane),
            child: Child::node(0),
            stack,
            base,
        };
        let mut walks = [start(left.trailing_zeros() as usize, 0, 0, packet); WALKS];
        let mut going = 0;
        while going < WALKS && left != 0 {
            walks[going] = start(left.trailing_zeros() as usize, 1 + going, stack.len[1 + going], packet);
            left &= left - 1;
            going += 1;
        }
        let mut k = 0;
        while going > 0 {
            let walk = &mut walks[k];
            if self.step::<I>(walk, packet, stack, visitor) {
                k += 1;
            } else if left != 0 {
                *walk = start(left.trailing_zeros() as usize, walk.stack, walk.base, packet);
                left &= left - 1;
            } else {
                going -= 1;
                walks.swap(k, going);
            }
            if k >= going {
                k = 0;
            }
        }
    }

    /// One node or leaf; false at the end of the walk.
    #[inline(always)]
    fn step<I: Isa>(
        &self,
        walk: &mut Walk,
        packet: &mut Packet,
        stack: &mut Stack,
        visitor: &mut impl Visitor<L>,
    ) -> bool {
        if walk.child.is_leaf() {
            if visitor.visit::<I>(stack, &self.leaves[walk.child.index()], 1 << walk.lane) != 0 {
                packet.set_limit(walk.lane, visitor.limit(walk.lane));
                walk.limit = packet.limit(walk.lane);
            }
        } else {
            let node = &self.nodes[walk.child.index()];
            let meeting = walk.hull.meet::<I>(node, walk.limit);
            let mut met = meeting.met;
            if met != 0 && met & (met - 1) == 0 {
                walk.child = node.child[met.trailing_zeros() as usize];
                self.prefetch::<I>(walk.child);
                return true;
            }
            let first = stack.len[walk.stack];
            while met != 0 {
                let i = met.trailing_zeros() as usize;
                met &= met - 1;
                stack.push_sorted(walk.stack, first, Entry { near: meeting.near[i], child: node.child[i], mask: 0 });
            }
        }
        while let Some(next) = stack.pop(walk.stack, walk.base) {
            if next.near <= walk.limit {
                walk.child = next.child;
                self.prefetch::<I>(walk.child);
                return true;
            }
        }
        false
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, child: Child) {
        if child.is_leaf() {
            prefetch::<I, L>(&self.leaves[child.index()]);
        } else {
            prefetch::<I, Node>(&self.nodes[child.index()]);
        }
    }
}

/// Brings all of it into the cache.
#[inline(always)]
fn prefetch<I: Isa, T>(what: &T) {
    let start: *const T = what;
    for line in 0..size_of::<T>().div_ceil(64) {
        I::prefetch(start.cast::<[u8; 64]>().wrapping_add(line));
    }
}

/// A ray on its way through a hierarchy.
#[derive(Clone, Copy)]
struct Walk {
    lane: usize,
    hull: Hull,
    limit: f32,
    child: Child,
    /// Which stack, and where it begins.
    stack: usize,
    base: usize,
}

/// A subtree still to be visited, and how near it may be.
#[derive(Clone, Copy)]
struct Entry {
    near: f32,
    child: Child,
    /// The rays of a packet that may meet it.
    mask: Mask,
}

/// Rays that a thread traces by turns.
const WALKS: usize = 4;

/// Traversal stacks, to be used again and again: one for rays together, and one for each that goes alone. They are deep enough for a hierarchy
/// within a hierarchy: each level pops one entry and pushes at most `WIDTH`.
pub struct Stack {
    entries: [[Entry; Stack::SIZE]; 1 + WALKS],
    len: [usize; 1 + WALKS],
}

impl Default for Stack {
    fn default() -> Self {
        Stack::new()
    }
}

impl Stack {
    const SIZE: usize = 2 * ((WIDTH - 1) * build::DEPTH + 1);

    pub fn new() -> Self {
        let empty = Entry { near: 0.0, child: Child(0), mask: 0 };
        Stack { entries: [[empty; Stack::SIZE]; 1 + WALKS], len: [0; 1 + WALKS] }
    }

    #[inline(always)]
    fn pop(&mut self, which: usize, base: usize) -> Option<Entry> {
        if self.len[which] <= base {
            return None;
        }
        self.len[which] -= 1;
        Some(self.entries[which][self.len[which]])
    }

    /// Keeps the entries from `first` on in descending order of `near`, so that the nearest is popped first.
    #[inline(always)]
    fn push_sorted(&mut self, which: usize, first: usize, entry: Entry) {
        let (entries, len) = (&mut self.entries[which], &mut self.len[which]);
        let mut i = *len;
        while i > first && entries[i - 1].near < entry.near {
            entries[i] = entries[i - 1];
            i -= 1;
        }
        entries[i] = entry;
        *len += 1;
    }
}
