//! Refitting: the boxes of a hierarchy are recomputed for primitives that have moved.

use rayon::prelude::*;

use super::build::{Aabb, PARALLEL, center_of, union};
use super::node::{Node, WIDTH};
use super::{Bvh, MAX_LEAF_SIZE};
use crate::arith::number::Interval;
use crate::{memory, parallel, stop};

impl<L: Clone> Bvh<L> {
    /// The same hierarchy, around leaves with these bounds. `None` if the number of leaves differs or a leaf
    /// has no bounds.
    pub fn refitted(&self, leaves: usize, bounds: impl Fn(&L) -> Option<[Interval; 3]>) -> Option<Self> {
        if self.leaves.len() != leaves {
            return None;
        }
        let around = |leaf: usize| Some(Aabb::around(bounds(&self.leaves[leaf])?, self.center()));
        Some(Bvh::with(self.center(), fitted(&self.nodes, around)?, self.leaves.clone()))
    }
}

impl<L: Send + Sync> Bvh<L> {
    /// The same hierarchy with each leaf made anew, with its bounds; and the bounds of all leaves, if there
    /// are any.
    pub fn remade(&self, make: impl Fn(&L) -> (L, [Interval; 3]) + Sync) -> (Self, Option<[Interval; 3]>) {
        let make = |leaf: &L| {
            stop::poll();
            make(leaf)
        };
        let count = self.leaves.len();
        let (mut leaves, mut bounds) = (memory::with_capacity(count), memory::with_capacity(count));
        // As for a build, waking other threads would take as long as the work.
        if count > PARALLEL / MAX_LEAF_SIZE {
            let work = self.leaves.par_iter().with_min_len(PARALLEL / MAX_LEAF_SIZE).map(make);
            parallel::run(|| work.unzip_into_vecs(&mut leaves, &mut bounds));
        } else {
            for leaf in &self.leaves {
                let (leaf, around) = make(leaf);
                leaves.push(leaf);
                bounds.push(around);
            }
        }
        let all = bounds.iter().copied().reduce(union);
        // Far from the old centre float32 boxes would be coarse.
        let center = all.map_or(self.center(), center_of);
        let nodes = fitted(&self.nodes, |leaf| Some(Aabb::around(bounds[leaf], center)));
        (Bvh::with(center, nodes.unwrap_or_default(), leaves), all)
    }
}

/// The nodes, around leaves with these boxes. `None` if a leaf has none.
fn fitted(nodes: &[Node], leaf: impl Fn(usize) -> Option<Aabb>) -> Option<Vec<Node>> {
    let mut nodes = memory::copy(nodes);
    let mut boxes = memory::with_capacity(nodes.len());
    boxes.resize(nodes.len(), Aabb::EMPTY);
    // Each node comes before those below it.
    for (i, node) in nodes.iter_mut().enumerate().rev() {
        for k in 0..node.children() {
            let child = node.child[k];
            let around = if child.is_leaf() { leaf(child.index())? } else { boxes[child.index()] };
            for axis in 0..3 {
                (node.low[axis][k], node.high[axis][k]) = (around.low(axis), around.high(axis));
            }
            boxes[i].include(&around);
        }
    }
    Some(nodes)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bvh::node::Child;
    use crate::testing::numbers;

    /// Checks that each leaf, its points, lies in all boxes above it, which are as tight as float32 allows.
    fn check(bvh: &Bvh<Vec<[f64; 3]>>) {
        let mut found = 0;
        let mut left = vec![(Child::node(0), Aabb::EMPTY)];
        while let Some((child, outer)) = left.pop() {
            let mut around = Aabb::EMPTY;
            if child.is_leaf() {
                found += 1;
                for &point in &bvh.leaves[child.index()] {
                    around.include(&Aabb::around(point.map(Interval::point), bvh.center()));
                }
            } else {
                let node = &bvh.nodes[child.index()];
                for k in 0..node.children() {
                    around.include(&node.bounds(k));
                    left.push((node.child[k], node.bounds(k)));
                }
            }
            let is_same = |axis| outer.low(axis) == around.low(axis) && outer.high(axis) == around.high(axis);
            assert!(child == Child::node(0) || (0..3).all(is_same));
        }
        assert_eq!(found, bvh.leaves.len());
    }

    #[test]
    fn boxes_of_remade_leaves_are_as_tight_as_those_of_a_build() {
        for count in [1, 9, 5000, 20_000] {
            let mut next = numbers();
            let mut points = || (0..count).map(|_| [next(), 1e3 * next(), 0.0]).collect::<Vec<_>>();
            let (first, mut second) = (points(), points());
            second.iter_mut().for_each(|point| point[0] += 1e9);
            let of = |points: &[[f64; 3]], ids: &[u32]| -> Vec<_> {
                ids.iter().map(|&id| points[id as usize]).collect()
            };
            let bounds = |points: &[[f64; 3]]| {
                [0, 1, 2].map(|axis| Interval {
                    low: points.iter().map(|point| point[axis]).fold(f64::INFINITY, f64::min),
                    high: points.iter().map(|point| point[axis]).fold(f64::NEG_INFINITY, f64::max),
                })
            };
            let box_of = |id: u32| Some(first[id as usize].map(Interval::point));
            let built = Bvh::new(count, box_of, MAX_LEAF_SIZE, |ids| ids.to_vec());
            let (remade, all) = built.remade(|ids| (ids.clone(), bounds(&of(&second, ids))));
            assert_eq!(format!("{all:?}"), format!("{:?}", Some(bounds(&second))));
            assert_eq!(remade.leaves, built.leaves);
            let points = |ids: &Vec<u32>| of(&second, ids);
            check(&Bvh {
                frame: remade.frame,
                nodes: remade.nodes,
                leaves: remade.leaves.iter().map(points).collect(),
            });
            assert!((remade.frame.center[0] - 1e9).abs() <= 1.0);
        }
    }
}
