//! A bounding volume hierarchy, eight children wide.
//!
//! Boxes are float32, relative to a float64 centre and rounded outward, and slab tests are conservative (T.
//! Ize, Robust BVH Ray Traversal, JCGT 2013): traversal culls primitives, but never one that a ray
//! intersects. Exact intersection of the float64 input happens elsewhere.

mod build;
mod crossings;
mod node;
mod packet;
mod ray_packet;
mod refit;
mod stack;
mod traversal;
mod traversal_ray;

use crate::arith::number::Interval;
use crate::geometry::vector::Point;
use crate::parallel;
use node::Node;

pub use crossings::Crossings;
pub use packet::{EnterHierarchy, Packet};
pub use ray_packet::{LANES, LARGEST, Mask, RayPacket, SMALLEST, all, is_run, part_of_mask, take};
pub use stack::Stack;
pub use traversal::{PacketTraversal, Visitor};
pub use traversal_ray::TraversalRay;

/// Most primitives a leaf may hold.
pub const MAX_LEAF_SIZE: usize = 8;

/// A hierarchy over leaves of any kind.
#[derive(Clone, Debug)]
pub struct Bvh<L> {
    frame: BoxFrame,
    nodes: Vec<Node>,
    leaves: Vec<L>,
}

/// The coordinates of the boxes of a hierarchy, and how far these reach.
#[derive(Clone, Copy, Debug)]
pub struct BoxFrame {
    pub center: Point,
    /// How far the boxes reach from the centre along each axis; infinity if there are none.
    reach: [f32; 3],
    /// By axis, the coordinate of a plane that contains leaves, or NaN: the plane of most flat leaves, if
    /// most of them lie in one plane.
    pub planes: [f64; 3],
}

impl BoxFrame {
    /// How far the boxes reach from the centre along any axis; infinity if there are none.
    pub fn longest_reach(&self) -> f64 {
        let [x, y, z] = self.reach;
        x.max(y).max(z).into()
    }
}

impl<L: Send> Bvh<L> {
    /// Builds a hierarchy of primitives 0 to `count`, without those whose bounds are `None`. `leaf` makes a
    /// leaf of up to `most` primitives, at most `MAX_LEAF_SIZE`.
    pub fn new(
        count: usize,
        bounds: impl Fn(u32) -> Option<[Interval; 3]> + Sync,
        most: usize,
        leaf: impl Fn(&[u32]) -> L + Sync,
    ) -> Self {
        let build = || build::build(count, &bounds, most.min(MAX_LEAF_SIZE), &leaf);
        // Waking other threads takes as long as building over some hundreds of primitives.
        if count > build::PARALLEL { parallel::run(build) } else { build() }
    }
}

impl<L> Bvh<L> {
    pub fn center(&self) -> Point {
        self.frame.center
    }

    pub fn frame(&self) -> BoxFrame {
        self.frame
    }

    fn with(center: Point, planes: [f64; 3], nodes: Vec<Node>, leaves: Vec<L>) -> Self {
        let along = |root: &Node, axis: usize| {
            root.low[axis].map(|x| -x).into_iter().chain(root.high[axis]).fold(0.0, f32::max)
        };
        let reach = [0, 1, 2].map(|axis| nodes.first().map_or(f32::INFINITY, |root| along(root, axis)));
        Bvh { frame: BoxFrame { center, reach, planes }, nodes, leaves }
    }

    /// The leaf, if it is the only one.
    pub fn only_leaf(&self) -> Option<&L> {
        if self.leaves.len() == 1 { self.leaves.first() } else { None }
    }

    pub fn leaves(&self) -> &[L] {
        &self.leaves
    }

    /// The leaves and their boxes, whose coordinates are rounded once.
    pub fn boxes(&self) -> impl Iterator<Item = (&L, [Interval; 3])> {
        let side = |node: &Node, axis: usize, k: usize| Interval {
            low: self.frame.center[axis] + f64::from(node.low[axis][k]),
            high: self.frame.center[axis] + f64::from(node.high[axis][k]),
        };
        self.nodes.iter().flat_map(move |node| {
            let leaves = (0..node.children()).filter(|&k| node.child[k].is_leaf());
            leaves.map(move |k| {
                (&self.leaves[node.child[k].index()], [0, 1, 2].map(|axis| side(node, axis, k)))
            })
        })
    }

    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.leaves.len() * size_of::<L>()
    }
}
