//! Traversal stacks.

use super::build::DEPTH;
use super::node::{Child, WIDTH};
use super::ray_packet::Mask;
use crate::arith::simd::Isa;

/// A subtree yet to be visited, and a lower bound of t at its box.
#[derive(Clone, Copy)]
pub struct Entry {
    pub near: f32,
    pub child: Child,
    /// The rays of a packet that may enter it.
    pub mask: Mask,
}

/// The number of interleaved traversals of single rays.
pub const SINGLE_RAYS: usize = 16;

/// Traversal stacks, reused from cast to cast: one for packets, and one for each interleaved single ray. They
/// are deep enough for two levels of hierarchies, objects and triangles: each level of nodes pops one entry
/// and pushes at most `WIDTH`.
pub struct Stack {
    /// `push_if` writes one entry past the end.
    entries: [Entry; Stack::SIZE + 1],
    pub(super) len: usize,
    pub(super) ray_stacks: [RayStack; SINGLE_RAYS],
}

/// The subtrees that a single ray has yet to visit, all within its limit, with lower bounds of t. Of the
/// children of a node the nearest is on top.
#[derive(Clone, Copy)]
pub struct RayStack {
    pub near: [f32; RayStack::SIZE],
    pub child: [u32; RayStack::SIZE],
    pub len: usize,
}

impl RayStack {
    /// With an end for each of two hierarchies. A push always writes `WIDTH` entries, not all of which count.
    const SIZE: usize = Stack::SIZE + 2 + WIDTH;

    /// Pushes the children whose boxes the ray enters before it leaves them.
    #[inline(always)]
    pub(super) fn push<I: Isa>(&mut self, near: I::F32x8, far: I::F32x8, children: &[Child; WIDTH]) {
        let (count, near, children) = I::by_distance(near, far, &children.map(|child| child.0));
        self.near[self.len..self.len + WIDTH].copy_from_slice(&near);
        self.child[self.len..self.len + WIDTH].copy_from_slice(&children);
        self.len += count;
    }

    #[inline(always)]
    pub(super) fn pop(&mut self) -> Child {
        self.len -= 1;
        Child(self.child[self.len])
    }

    /// Drops the entries from `base` on that are beyond the limit.
    #[inline(always)]
    pub(super) fn keep_within(&mut self, limit: f32, base: usize) {
        let mut kept = base;
        for i in base..self.len {
            let (near, child) = (self.near[i], self.child[i]);
            (self.near[kept], self.child[kept]) = (near, child);
            kept += usize::from(near <= limit);
        }
        self.len = kept;
    }
}

impl Default for Stack {
    fn default() -> Self {
        Stack::new()
    }
}

impl Stack {
    const SIZE: usize = 2 * ((WIDTH - 1) * DEPTH + 1);

    pub fn new() -> Self {
        let empty = Entry { near: 0.0, child: Child(0), mask: 0 };
        let ray_stack = RayStack { near: [0.0; RayStack::SIZE], child: [0; RayStack::SIZE], len: 0 };
        Stack { entries: [empty; Stack::SIZE + 1], len: 0, ray_stacks: [ray_stack; SINGLE_RAYS] }
    }

    #[inline(always)]
    pub(super) fn pop(&mut self, base: usize) -> Option<Entry> {
        if self.len <= base {
            return None;
        }
        self.len -= 1;
        Some(self.entries[self.len])
    }

    #[inline(always)]
    pub(super) fn push_if(&mut self, condition: bool, entry: Entry) {
        self.entries[self.len] = entry;
        self.len += usize::from(condition);
    }

    /// Keeps the entries from `first` on in descending order of `near`, so that the nearest is popped first.
    pub(super) fn push_sorted(&mut self, first: usize, entry: Entry) {
        let mut i = self.len;
        while i > first && self.entries[i - 1].near < entry.near {
            self.entries[i] = self.entries[i - 1];
            i -= 1;
        }
        self.entries[i] = entry;
        self.len += 1;
    }
}
