//! Refitting: the boxes of a hierarchy are recomputed for primitives that have moved.

use rayon::prelude::*;

use super::build::{Aabb, PARALLEL, center_of, find_flat, planes_of};
use super::node::{Node, WIDTH};
use super::{Bvh, MAX_LEAF_SIZE};
use crate::arith::number::Interval;
use crate::geometry::ray::union;
use crate::geometry::vector::Point;
use crate::{memory, parallel, stop};

impl<L: Clone> Bvh<L> {
    /// The same hierarchy, around leaves with these bounds. `None` if the number of leaves differs or a leaf
    /// has no bounds.
    pub fn refitted(&self, leaves: usize, bounds: impl Fn(&L) -> Option<[Interval; 3]>) -> Option<Self> {
        if self.leaves.len() != leaves {
            return None;
        }
        let bounds: Option<Vec<_>> = self.leaves.iter().map(bounds).collect();
        let (nodes, planes) = fit(&self.nodes, &bounds?, self.center());
        Some(Bvh::with(self.center(), planes, nodes, self.leaves.clone()))
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
        let (nodes, planes) = fit(&self.nodes, &bounds, center);
        (Bvh::with(center, planes, nodes, leaves), all)
    }
}

/// The nodes, around leaves with these bounds, and the planes of the hierarchy.
fn fit(nodes: &[Node], leaves: &[[Interval; 3]], center: Point) -> (Vec<Node>, [f64; 3]) {
    let mut nodes = memory::copy(nodes);
    let mut boxes = memory::with_capacity(nodes.len());
    boxes.resize(nodes.len(), Aabb::EMPTY);
    // Each node comes before those below it.
    for (i, node) in nodes.iter_mut().enumerate().rev() {
        for k in 0..node.children() {
            let child = node.child[k];
            let around = if child.is_leaf() {
                Aabb::around(leaves[child.index()], center)
            } else {
                boxes[child.index()]
            };
            for axis in 0..3 {
                (node.low[axis][k], node.high[axis][k]) = (around.low(axis), around.high(axis));
            }
            boxes[i].include(&around);
        }
    }
    let planes = find_flat(&mut nodes, |leaf| planes_of(leaves[leaf]));
    (nodes, planes)
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
    pub(super) fn children(&self) -> usize {
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

    /// All points below a child.
    fn points_below(bvh: &Bvh<Vec<[f64; 3]>>, child: Child) -> Vec<[f64; 3]> {
        if child.is_leaf() {
            return bvh.leaves[child.index()].clone();
        }
        let node = &bvh.nodes[child.index()];
        node.child[..node.children()].iter().flat_map(|child| points_below(bvh, *child)).collect()
    }

    /// Checks which children are flat, and returns how many are and how many are not.
    fn check_flat(bvh: &Bvh<Vec<[f64; 3]>>) -> [usize; 2] {
        let mut found = [0; 2];
        for node in &bvh.nodes {
            for (k, child) in node.child[..node.children()].iter().enumerate() {
                let points = points_below(bvh, *child);
                for axis in 0..3 {
                    let is_flat = points.iter().all(|point| point[axis] == points[0][axis]);
                    assert_eq!(node.flat[axis] >> k & 1 != 0, is_flat);
                    found[usize::from(!is_flat)] += 1;
                }
            }
        }
        found
    }

    /// Terraces whose heights float32 does not tell apart, before and after they move.
    #[test]
    fn children_are_flat_where_all_below_lies_in_one_plane() {
        let mut next = numbers();
        let heights = [0.1, 0.1_f64.next_up(), 3.0];
        let mut points = || -> Vec<[f64; 3]> {
            (0..600).map(|i| [next() + f64::from(i / 100), next(), heights[i as usize / 100 % 3]]).collect()
        };
        let (first, second) = (points(), points());
        let box_of = |id: u32| Some(first[id as usize].map(Interval::point));
        let built = Bvh::new(first.len(), box_of, MAX_LEAF_SIZE, |ids| ids.to_vec());
        let with = |bvh: &Bvh<Vec<u32>>, points: &[[f64; 3]]| {
            let leaves = bvh.leaves.iter().map(|ids| ids.iter().map(|&id| points[id as usize]).collect());
            Bvh { frame: bvh.frame, nodes: memory::copy(&bvh.nodes), leaves: leaves.collect() }
        };
        let [flat, others] = check_flat(&with(&built, &first));
        assert!(flat > 50 && others > 100, "{flat}, {others}");
        let mut moved = second.clone();
        moved[..300].iter_mut().for_each(|point| point[2] += point[0]);
        let bounds = |ids: &Vec<u32>| {
            let points = ids.iter().map(|&id| moved[id as usize].map(Interval::point));
            (ids.clone(), points.reduce(union).unwrap_or([Interval::point(0.0); 3]))
        };
        let [still, bent] = check_flat(&with(&built.remade(bounds).0, &moved));
        assert!(0 < still && still < flat && bent > others, "{still}, {bent}");
    }

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
