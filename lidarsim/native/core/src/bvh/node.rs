//! Nodes of a hierarchy.

/// Children of a node.
pub const WIDTH: usize = 8;

/// Eight child boxes as a structure of arrays, by axis, and the children. An absent child has an empty box.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Node {
    pub low: [[f32; WIDTH]; 3],
    pub high: [[f32; WIDTH]; 3],
    pub child: [Child; WIDTH],
    /// By axis, the children whose primitives lie in one plane perpendicular to it, exactly: a bit each. A
    /// ray parallel to the plane hits none of them.
    pub flat: [u8; 3],
    /// By axis, those of them that lie in the plane of the hierarchy (`BoxFrame::planes`).
    pub level: [u8; 3],
}

impl Node {
    /// The flat children that a ray misses because its direction is exactly zero along these axes.
    #[inline(always)]
    pub fn missed_children(&self, parallel: u8) -> u8 {
        let along = |axis: usize| if parallel >> axis & 1 != 0 { self.flat[axis] } else { 0 };
        along(0) | along(1) | along(2)
    }

    #[inline(always)]
    pub fn is_flat(&self) -> bool {
        self.flat != [0; 3]
    }
}

/// The index of a node or of a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Child(pub u32);

impl Child {
    const LEAF_BIT: u32 = 1 << 31;
    /// End of a stack: no node has the root as a child.
    pub const END: Child = Child::node(0);

    pub const fn node(index: usize) -> Self {
        Child(index as u32)
    }

    pub fn leaf(index: usize) -> Self {
        Child(Self::LEAF_BIT | index as u32)
    }

    #[inline(always)]
    pub fn is_leaf(self) -> bool {
        self.0 & Self::LEAF_BIT != 0
    }

    #[inline(always)]
    pub fn index(self) -> usize {
        (self.0 & !Self::LEAF_BIT) as usize
    }
}
