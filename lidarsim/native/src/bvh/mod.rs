//! A bounding volume hierarchy, eight children wide.
//!
//! Boxes are float32, relative to a float64 centre and rounded outward, so that a box never loses what it holds. They only
//! choose which primitives are asked; every decision is made elsewhere, in the numbers that were given.

mod build;
mod span;

pub use span::Span;

use crate::number::Interval;
use crate::vector::Point;

pub const WIDTH: usize = 8;

/// Most primitives a leaf may hold.
pub const LEAF: usize = 8;

/// Eight boxes, an axis after the other, and what they hold. An absent child has a box that nothing meets.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
struct Node {
    low: [[f32; WIDTH]; 3],
    high: [[f32; WIDTH]; 3],
    child: [Child; WIDTH],
}

/// The index of a node, or a range of `Bvh::order`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Child(u32);

impl Child {
    const LEAF_BIT: u32 = 1 << 31;
    const COUNT_SHIFT: u32 = 28;
    /// Starts of leaves have 28 bits.
    const MOST: usize = 1 << Self::COUNT_SHIFT;

    fn node(index: usize) -> Self {
        Child(index as u32)
    }

    fn leaf(start: usize, count: usize) -> Self {
        Child(Self::LEAF_BIT | ((count as u32 - 1) << Self::COUNT_SHIFT) | start as u32)
    }

    fn as_leaf(self) -> Option<std::ops::Range<usize>> {
        if self.0 & Self::LEAF_BIT == 0 {
            return None;
        }
        let start = self.0 as usize & (Self::MOST - 1);
        let count = ((self.0 & !Self::LEAF_BIT) >> Self::COUNT_SHIFT) as usize + 1;
        Some(start..start + count)
    }

    fn moved(self, nodes: usize) -> Self {
        if self.0 & Self::LEAF_BIT == 0 { Child(self.0 + nodes as u32) } else { self }
    }
}

#[derive(Clone, Debug)]
pub struct Bvh {
    center: Point,
    nodes: Vec<Node>,
    /// Primitive ids, leaf by leaf.
    pub order: Vec<u32>,
}

impl Bvh {
    /// Primitives without a box (none) are left out.
    pub fn new(bounds: &[Option<[Interval; 3]>]) -> Self {
        build::build(bounds)
    }

    pub fn center(&self) -> Point {
        self.center
    }

    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.order.len() * size_of::<u32>()
    }

    /// Offers the leaves that the ray may meet, nearest box first: `visit` gets a range of `order` and answers with the
    /// t beyond which nothing is wanted any more. It may traverse another hierarchy on the same stack.
    #[inline]
    pub fn traverse(
        &self,
        span: &mut Span,
        stack: &mut Stack,
        mut visit: impl FnMut(&mut Stack, std::ops::Range<usize>) -> f64,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let base = stack.len;
        stack.push_sorted(base, 0.0, Child::node(0));
        while let Some(child) = stack.pop(base, span.limit()) {
            if let Some(leaf) = child.as_leaf() {
                span.shorten(visit(stack, leaf));
                continue;
            }
            let node = &self.nodes[child.0 as usize];
            let (near, far) = span.meet(&node.low, &node.high);
            let first = stack.len;
            for i in 0..WIDTH {
                if near[i] <= far[i] {
                    stack.push_sorted(first, near[i], node.child[i]);
                }
            }
        }
    }
}

/// A traversal stack, to be used again and again, and deep enough for a hierarchy within a hierarchy: each level pops one entry
/// and pushes at most `WIDTH`.
pub struct Stack {
    near: [f32; Stack::SIZE],
    child: [Child; Stack::SIZE],
    len: usize,
}

impl Stack {
    const SIZE: usize = 2 * ((WIDTH - 1) * build::DEPTH + 1);

    pub fn new() -> Self {
        Stack { near: [0.0; Stack::SIZE], child: [Child(0); Stack::SIZE], len: 0 }
    }

    #[inline]
    fn pop(&mut self, base: usize, limit: f32) -> Option<Child> {
        while self.len > base {
            self.len -= 1;
            if self.near[self.len] <= limit {
                return Some(self.child[self.len]);
            }
        }
        None
    }

    /// Keeps the entries from `first` on in descending order of `near`, so that the nearest is popped first.
    #[inline]
    fn push_sorted(&mut self, first: usize, near: f32, child: Child) {
        let mut i = self.len;
        while i > first && self.near[i - 1] < near {
            self.near[i] = self.near[i - 1];
            self.child[i] = self.child[i - 1];
            i -= 1;
        }
        self.near[i] = near;
        self.child[i] = child;
        self.len += 1;
    }
}
