//! Refitting: the boxes of a hierarchy are recomputed for primitives that have moved.

use super::Bvh;
use super::build::Aabb;
use super::node::{Node, WIDTH};
use crate::arith::number::Interval;

impl<L: Clone> Bvh<L> {
    /// The same hierarchy, around leaves with these bounds. `None` if the number of leaves differs or a leaf
    /// has no bounds.
    pub fn refitted(&self, leaves: usize, bounds: impl Fn(&L) -> Option<[Interval; 3]>) -> Option<Self> {
        if self.leaves.len() != leaves {
            return None;
        }
        let mut hierarchy = self.clone();
        let mut boxes = vec![Aabb::EMPTY; self.nodes.len()];
        // Each node comes before those below it.
        for (i, node) in hierarchy.nodes.iter_mut().enumerate().rev() {
            for k in 0..node.children() {
                let child = node.child[k];
                let around = if child.is_leaf() {
                    Aabb::around(bounds(&self.leaves[child.index()])?, self.center())
                } else {
                    boxes[child.index()]
                };
                for axis in 0..3 {
                    (node.low[axis][k], node.high[axis][k]) = (around.low(axis), around.high(axis));
                }
                boxes[i].include(&around);
            }
        }
        Some(Bvh::with(hierarchy.center(), hierarchy.nodes, hierarchy.leaves))
    }
}

impl<L> Bvh<L> {
    /// The surface area of all nodes, which determines the cost of a traversal (J. Goldsmith, J. Salmon,
    /// Automatic creation of object hierarchies for ray tracing, 1987).
    pub fn surface(&self) -> f32 {
        let inner = |node: &Node| {
            let node = *node;
            (0..node.children())
                .filter(move |&k| !node.child[k].is_leaf())
                .map(move |k| node.bounds(k).surface())
        };
        let root = self.nodes.first().map_or(0.0, |root| {
            let mut whole = Aabb::EMPTY;
            (0..root.children()).for_each(|k| whole.include(&root.bounds(k)));
            whole.surface()
        });
        self.nodes.iter().flat_map(inner).fold(root, |sum, surface| sum + surface)
    }
}

impl Node {
    /// The number of children, which come first.
    fn children(&self) -> usize {
        (0..WIDTH).position(|k| !(self.low[0][k] < f32::INFINITY)).unwrap_or(WIDTH)
    }

    fn bounds(&self, k: usize) -> Aabb {
        Aabb::new(self.low.map(|low| low[k]), self.high.map(|high| high[k]))
    }
}
