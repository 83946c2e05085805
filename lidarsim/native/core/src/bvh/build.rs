//! Building by the binned surface area heuristic (I. Wald, On fast construction of SAH-based bounding volume
//! hierarchies, 2007).
//!
//! A binary tree is grown first and then collapsed into wide nodes by its optimal cut (H. Ylitie et al.,
//! Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs, 2017). The hierarchy does not
//! depend on the number of threads.

use std::ops::Range;

use rayon::prelude::*;

use super::node::{Child, Node, WIDTH};
use super::traversal_ray::{down, up};
use super::{Bvh, MAX_LEAF_SIZE};
use crate::arith::number::Interval;
use crate::geometry::ray::union;
use crate::geometry::vector::Point;
use crate::memory;
use crate::stop::Job;

const BINS: usize = 16;

/// Levels of the binary tree that are split by surface area; below them ranges are halved.
const BY_SURFACE: usize = 40;

/// Most levels of nodes. Each takes at least one level of the binary tree, and 2³⁰ primitives are halved
/// 30 times.
pub const DEPTH: usize = BY_SURFACE + 30;

/// Above this number of primitives the threads of the current pool build in parallel.
pub const PARALLEL: usize = 4096;

/// Least items of a piece of the work, which unwinds once if the job is stopped.
const PIECE: usize = 512;

/// Ranges of fewer primitives are split by position alone.
const SIZED: usize = 4096;

/// A box: its low corner and its negated high corner, so that a union takes minima.
#[derive(Clone, Copy)]
pub struct Aabb([f32; 6]);

impl Aabb {
    pub const EMPTY: Aabb = Aabb([f32::INFINITY; 6]);

    pub fn new(low: [f32; 3], high: [f32; 3]) -> Self {
        Aabb([low[0], low[1], low[2], -high[0], -high[1], -high[2]])
    }

    /// Relative to `center`, rounded outward.
    pub fn around(bounds: [Interval; 3], center: Point) -> Self {
        let corner = |round: fn(f64) -> f32, side: fn(&Interval) -> f64| {
            std::array::from_fn(|i| round(side(&bounds[i]) - center[i]))
        };
        Aabb::new(corner(down, |side| side.low), corner(up, |side| side.high))
    }

    #[inline]
    pub fn include(&mut self, other: &Aabb) {
        for i in 0..6 {
            // A NaN leaves the bound as it is.
            self.0[i] = if other.0[i] < self.0[i] { other.0[i] } else { self.0[i] };
        }
    }

    pub fn low(&self, axis: usize) -> f32 {
        self.0[axis]
    }

    pub fn high(&self, axis: usize) -> f32 {
        -self.0[3 + axis]
    }

    /// Half the surface area; zero for an empty box.
    #[inline]
    pub fn surface(&self) -> f32 {
        let side = |axis| (self.high(axis) - self.low(axis)).max(0.0);
        let (x, y, z) = (side(0), side(1), side(2));
        x * y + y * z + z * x
    }
}

#[derive(Clone, Copy)]
struct Item {
    bounds: Aabb,
    id: u32,
}

impl Item {
    /// Halving first keeps it finite.
    #[inline]
    fn middle(&self, axis: usize) -> f32 {
        0.5 * self.bounds.low(axis) + 0.5 * self.bounds.high(axis)
    }
}

/// Boxes around items, and around their centres.
#[derive(Clone, Copy)]
struct Extent {
    bounds: Aabb,
    middles: Aabb,
}

impl Extent {
    const EMPTY: Extent = Extent { bounds: Aabb::EMPTY, middles: Aabb::EMPTY };

    fn of(items: &[Item]) -> Self {
        items.iter().fold(Extent::EMPTY, |mut extent, item| {
            extent.bounds.include(&item.bounds);
            extent.include_middle(item);
            extent
        })
    }

    #[inline]
    fn include_middle(&mut self, item: &Item) {
        let [x, y, z] = [item.middle(0), item.middle(1), item.middle(2)];
        self.middles.include(&Aabb([x, y, z, -x, -y, -z]));
    }
}

/// `bounds` returns the bounds of each of `count` primitives.
pub fn build<L: Send>(
    count: usize,
    bounds: impl Fn(u32) -> Option<[Interval; 3]> + Sync,
    most: usize,
    leaf: impl Fn(&[u32]) -> L + Sync,
) -> Bvh<L> {
    let job = &*Job::current();
    let (Bvh { frame, nodes, leaves }, items) = build_ranges(count, &bounds, most, job);
    let leaf = |at: u32| {
        job.poll();
        let range = leaves[at as usize].clone();
        let mut ids = [0; MAX_LEAF_SIZE];
        for (id, item) in ids.iter_mut().zip(&items[range.clone()]) {
            *id = item.id;
        }
        leaf(&ids[..range.len()])
    };
    Bvh { frame, nodes, leaves: collect(leaves.len(), count > PARALLEL, leaf) }
}

/// Builds a hierarchy whose leaves are ranges of items, and returns both. It is compiled once for all kinds
/// of leaves.
fn build_ranges(
    count: usize,
    bounds: &(dyn Fn(u32) -> Option<[Interval; 3]> + Sync),
    most: usize,
    job: &Job,
) -> (Bvh<Range<usize>>, Vec<Item>) {
    let bounds = |id| {
        job.poll();
        bounds(id)
    };
    let ids = 0..count as u32;
    let nothing = [Interval { low: f64::INFINITY, high: f64::NEG_INFINITY }; 3];
    let shared = count > PARALLEL;
    let all = if shared {
        ids.into_par_iter().with_min_len(PARALLEL).filter_map(bounds).reduce(|| nothing, union)
    } else {
        ids.filter_map(bounds).fold(nothing, union)
    };
    let center = center_of(all);
    let item = |id| {
        let bounds = bounds(id).map_or(Aabb::EMPTY, |bounds| Aabb::around(bounds, center));
        Item { bounds, id }
    };
    let mut items = collect(count, shared, item);
    // `down` returns less than infinity.
    items.retain(|item| item.bounds.low(0) < f32::INFINITY);
    let mut parts = Parts { nodes: Vec::new(), leaves: Vec::new() };
    if !items.is_empty() {
        let extent = Extent::of(&items);
        parts.add(&Tree::grow(&mut items, extent, most, 0, job), 0, job);
    }
    let Parts { nodes, leaves } = parts;
    let planes = collect(leaves.len(), shared, |at| {
        let items = &items[leaves[at as usize].clone()];
        items.iter().filter_map(|item| bounds(item.id)).reduce(union).map_or(NOT_FLAT, planes_of)
    });
    let mut nodes = memory::copy(&nodes);
    let planes = find_flat(&mut nodes, |leaf| planes[leaf]);
    (Bvh::with(center, planes, nodes, leaves), items)
}

/// By axis, the coordinate of the plane that contains a part of a hierarchy, or NaN.
type ContainingPlanes = [f64; 3];

const NOT_FLAT: ContainingPlanes = [f64::NAN; 3];

/// The planes perpendicular to the axes that contain a box.
pub fn planes_of(bounds: [Interval; 3]) -> ContainingPlanes {
    bounds.map(|side| if side.low == side.high { side.low } else { f64::NAN })
}

/// Sets which children are flat, from the planes that contain each leaf, and returns the planes of the
/// hierarchy. Each node comes before those below.
pub fn find_flat(nodes: &mut [Node], leaf: impl Fn(usize) -> ContainingPlanes) -> ContainingPlanes {
    let mut majority = [Majority::NONE; 3];
    let mut planes = memory::with_capacity(nodes.len());
    planes.resize(nodes.len(), NOT_FLAT);
    for (i, node) in nodes.iter_mut().enumerate().rev() {
        node.flat = [0; 3];
        for k in 0..node.children() {
            let child = node.child[k];
            let of_child = if child.is_leaf() { leaf(child.index()) } else { planes[child.index()] };
            for axis in 0..3 {
                if child.is_leaf() {
                    majority[axis].count(of_child[axis]);
                }
                node.flat[axis] |= u8::from(!of_child[axis].is_nan()) << k;
                if k == 0 {
                    planes[i][axis] = of_child[axis];
                } else if planes[i][axis] != of_child[axis] {
                    planes[i][axis] = f64::NAN;
                }
            }
        }
    }
    let of_hierarchy = majority.map(|majority| majority.plane);
    for node in nodes {
        node.level = [0; 3];
        for k in 0..node.children() {
            let child = node.child[k];
            let of_child = if child.is_leaf() { leaf(child.index()) } else { planes[child.index()] };
            for axis in 0..3 {
                node.level[axis] |= u8::from(of_child[axis] == of_hierarchy[axis]) << k;
            }
        }
    }
    of_hierarchy
}

/// The plane of more than half of the flat leaves if there is one, otherwise the plane of some of them
/// (R. Boyer, J. Moore, MJRTY, 1981).
#[derive(Clone, Copy)]
struct Majority {
    plane: f64,
    lead: usize,
}

impl Majority {
    const NONE: Majority = Majority { plane: f64::NAN, lead: 0 };

    fn count(&mut self, plane: f64) {
        if plane.is_nan() {
            return;
        }
        if self.lead == 0 {
            self.plane = plane;
        }
        self.lead = if plane == self.plane { self.lead + 1 } else { self.lead - 1 };
    }
}

/// The centre of a hierarchy with these bounds, which may be empty or unlimited.
pub fn center_of(bounds: [Interval; 3]) -> Point {
    bounds.map(|side| {
        let middle = side.middle();
        if middle.is_finite() { middle } else { 0.0 }
    })
}

/// The values of `make` for the numbers below `count`, in order. If `shared`, all threads of the pool take
/// part.
fn collect<T: Send>(count: usize, shared: bool, make: impl Fn(u32) -> T + Sync) -> Vec<T> {
    let mut made = memory::with_capacity(count);
    let numbers = 0..count as u32;
    if shared {
        numbers.into_par_iter().with_min_len(PIECE).map(&make).collect_into_vec(&mut made);
    } else {
        made.extend(numbers.map(make));
    }
    made
}

/// A binary tree over consecutive items.
struct Tree {
    bounds: Aabb,
    len: usize,
    /// The least surface area of the inner nodes if the tree becomes up to 1, 2, … children of a node.
    cost: [f32; WIDTH],
    /// `None` for a leaf.
    halves: Option<Box<[Tree; 2]>>,
}

impl Tree {
    /// Grows a tree over `items`, which it reorders.
    fn grow(items: &mut [Item], extent: Extent, most: usize, depth: usize, job: &Job) -> Tree {
        job.poll();
        let (bounds, len) = (extent.bounds, items.len());
        if len <= most {
            return Tree { bounds, len, cost: [0.0; WIDTH], halves: None };
        }
        let by_surface = if depth < BY_SURFACE { split(items, &extent, most) } else { None };
        let (at, [a, b]) = by_surface.unwrap_or_else(|| halve(items, &extent, most));
        let (first, second) = items.split_at_mut(at);
        let mut first = || Tree::grow(first, a, most, depth + 1, job);
        let mut second = || Tree::grow(second, b, most, depth + 1, job);
        let (a, b) = if len > PARALLEL { rayon::join(first, second) } else { (first(), second()) };
        let mut cost = [f32::INFINITY; WIDTH];
        for slots in 2..=WIDTH {
            cost[slots - 1] =
                shares(slots).map(|(i, j)| a.cost[i - 1] + b.cost[j - 1]).fold(cost[slots - 2], f32::min);
        }
        cost[0] = bounds.surface() + cost[WIDTH - 1];
        for slots in 2..=WIDTH {
            cost[slots - 1] = cost[slots - 1].min(cost[slots - 2]);
        }
        Tree { bounds, len, cost, halves: Some(memory::boxed([a, b])) }
    }

    /// The best cut of the tree's halves into at most `slots` children.
    fn cut<'a>(&'a self, slots: usize, children: &mut Vec<&'a Tree>) {
        let Some(halves) = &self.halves else {
            children.push(self);
            return;
        };
        let [a, b] = halves.as_ref();
        let cost = |(i, j): (usize, usize)| a.cost[i - 1] + b.cost[j - 1];
        let mut best = (1, slots - 1);
        for share in shares(slots) {
            if cost(share) < cost(best) {
                best = share;
            }
        }
        for (half, slots) in [(a, best.0), (b, best.1)] {
            if half.cost[slots - 1] < half.cost[0] {
                half.cut(slots, children);
            } else {
                children.push(half);
            }
        }
    }
}

/// The ways to share the slots between two.
fn shares(slots: usize) -> impl Iterator<Item = (usize, usize)> {
    (1..slots).map(move |i| (i, slots - i))
}

/// The nodes, the root first and each before its descendants, and the leaves.
struct Parts {
    nodes: Vec<Node>,
    leaves: Vec<Range<usize>>,
}

impl Parts {
    /// Adds a tree as a node; its items begin at `start`.
    fn add(&mut self, tree: &Tree, mut start: usize, job: &Job) {
        job.poll();
        let mut children = Vec::with_capacity(WIDTH);
        tree.cut(WIDTH, &mut children);
        let at = self.nodes.len();
        let node = Node {
            low: [[f32::INFINITY; WIDTH]; 3],
            high: [[f32::NEG_INFINITY; WIDTH]; 3],
            child: [Child::leaf(0); WIDTH],
            flat: [0; 3],
            level: [0; 3],
        };
        memory::push(&mut self.nodes, node);
        for (i, child) in children.into_iter().enumerate() {
            let (nodes, leaves) = (self.nodes.len(), self.leaves.len());
            let node = &mut self.nodes[at];
            for axis in 0..3 {
                node.low[axis][i] = child.bounds.low(axis);
                node.high[axis][i] = child.bounds.high(axis);
            }
            if child.halves.is_none() {
                node.child[i] = Child::leaf(leaves);
                memory::push(&mut self.leaves, start..start + child.len);
            } else {
                node.child[i] = Child::node(nodes);
                self.add(child, start, job);
            }
            start += child.len;
        }
    }
}

/// Sorts items into bins: by their centre along an axis, or by surface area, one bin per power of two.
/// Otherwise a few large items would enlarge the boxes of all others.
struct Grid {
    low: [f32; 3],
    scale: [f32; 3],
    /// The bits of the largest possible surface area.
    largest: u32,
}

impl Grid {
    const SIZE: usize = 3;
    const KEYS: usize = 4;

    fn over(extent: &Extent) -> Self {
        let low = [0, 1, 2].map(|axis| extent.middles.low(axis));
        let scale = [0, 1, 2].map(|axis| BINS as f32 / (extent.middles.high(axis) - low[axis]));
        Grid { low, scale, largest: extent.bounds.surface().to_bits() }
    }

    /// If the extent is zero or not finite, NaN becomes bin 0.
    #[inline]
    fn bin(&self, key: usize, item: &Item) -> usize {
        let bin = if key == Grid::SIZE {
            self.largest.saturating_sub(item.bounds.surface().to_bits()) >> (f32::MANTISSA_DIGITS - 1)
        } else {
            ((item.middle(key) - self.low[key]) * self.scale[key]) as i32 as u32
        };
        (bin as usize).min(BINS - 1)
    }
}

type Bins = [[(Aabb, usize); BINS]; Grid::KEYS];

fn fill(items: &[Item], grid: &Grid, keys: usize) -> Bins {
    let empty = [[(Aabb::EMPTY, 0); BINS]; Grid::KEYS];
    if items.len() > 16 * PARALLEL {
        let parts = items.par_chunks(4 * PARALLEL).map(|part| fill(part, grid, keys));
        return parts.reduce(
            || empty,
            |mut bins, others| {
                for ((bounds, count), (other, more)) in
                    bins.as_flattened_mut().iter_mut().zip(others.as_flattened())
                {
                    bounds.include(other);
                    *count += more;
                }
                bins
            },
        );
    }
    let mut bins = empty;
    for item in items {
        for key in 0..keys {
            let (bounds, count) = &mut bins[key][grid.bin(key, item)];
            bounds.include(&item.bounds);
            *count += 1;
        }
    }
    bins
}

/// Orders `items` into two parts that minimize surface area times leaves. Returns the length of the first and
/// the extents of both.
fn split(items: &mut [Item], extent: &Extent, most: usize) -> Option<(usize, [Extent; 2])> {
    let grid = Grid::over(extent);
    let keys = if items.len() < SIZED { Grid::SIZE } else { Grid::KEYS };
    let bins = fill(items, &grid, keys);
    let mut best: Option<(f32, usize, usize)> = None;
    for key in 0..keys {
        let bins = &bins[key];
        let mut right = [(0.0, 0); BINS];
        let (mut side, mut count) = (Aabb::EMPTY, 0);
        for i in (1..BINS).rev() {
            side.include(&bins[i].0);
            count += bins[i].1;
            right[i] = (side.surface() * leaves(count, most), count);
        }
        let (mut side, mut count) = (Aabb::EMPTY, 0);
        for i in 1..BINS {
            side.include(&bins[i - 1].0);
            count += bins[i - 1].1;
            if count == 0 || right[i].1 == 0 {
                continue;
            }
            let cost = side.surface() * leaves(count, most) + right[i].0;
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, key, i));
            }
        }
    }
    let (_, key, bin) = best?;
    let mut extents = [Extent::EMPTY; 2];
    for i in 0..BINS {
        extents[usize::from(i >= bin)].bounds.include(&bins[key][i].0);
    }
    let at = partition(items, |item| {
        let first = grid.bin(key, item) < bin;
        extents[usize::from(!first)].include_middle(item);
        first
    });
    Some((at, extents))
}

/// As `split`, but in the middle along the longest axis, between full leaves.
fn halve(items: &mut [Item], extent: &Extent, most: usize) -> (usize, [Extent; 2]) {
    let length = |axis| extent.middles.high(axis) - extent.middles.low(axis);
    let axis = (1..3).fold(0, |longest, axis| if length(axis) > length(longest) { axis } else { longest });
    let half = items.len().div_ceil(most) / 2 * most;
    items.select_nth_unstable_by(half, |a, b| a.middle(axis).total_cmp(&b.middle(axis)));
    (half, [Extent::of(&items[..half]), Extent::of(&items[half..])])
}

/// The number of leaves: a partly filled leaf costs as much as a full one.
fn leaves(count: usize, most: usize) -> f32 {
    count.div_ceil(most) as f32
}

/// Moves the items that are `first` to the front, testing each once, and counts them.
fn partition(items: &mut [Item], mut first: impl FnMut(&Item) -> bool) -> usize {
    let (mut start, mut end) = (0, items.len());
    loop {
        while start < end && first(&items[start]) {
            start += 1;
        }
        if start == end {
            return start;
        }
        end -= 1;
        while start < end && !first(&items[end]) {
            end -= 1;
        }
        if start == end {
            return start;
        }
        items.swap(start, end);
        start += 1;
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::parallel;
    use crate::testing::numbers;

    type Boxes = Vec<Option<[Interval; 3]>>;

    fn hierarchy_of(boxes: &Boxes, most: usize) -> Bvh<Vec<u32>> {
        build(boxes.len(), |id| boxes[id as usize], most, <[u32]>::to_vec)
    }

    fn of_points(points: impl Iterator<Item = [f64; 3]>) -> Boxes {
        points.map(|p| Some(p.map(Interval::point))).collect()
    }

    /// Boxes of all sizes, some flat, some very large.
    fn mixed_boxes(count: usize) -> Boxes {
        let mut next = numbers();
        let mut side = |scale: f64| {
            let low = 100.0 * next();
            Interval { low, high: low + scale * next() }
        };
        let scale =
            |i: usize| [1e-3, 1e-3, 0.0, 0.1, 1e-3, 1e-3, 1e-3, if i % 1000 == 7 { 1e3 } else { 1.0 }][i % 8];
        (0..count).map(|i| Some([side(scale(i)), side(scale(i)), side(0.1 * scale(i))])).collect()
    }

    /// Checks that every primitive with a box is in one leaf and inside all boxes above. Returns the levels
    /// of nodes.
    fn check(boxes: &Boxes, most: usize) -> usize {
        let bvh = hierarchy_of(boxes, most);
        let mut found = Vec::new();
        let mut levels = 0;
        let everything = [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]];
        let mut left = vec![(Child::node(0), everything, 0)];
        if bvh.nodes.is_empty() {
            left.clear();
        }
        while let Some((child, [low, high], level)) = left.pop() {
            levels = levels.max(level);
            if child.is_leaf() {
                let ids = &bvh.leaves[child.index()];
                assert!((1..=most).contains(&ids.len()));
                for &id in ids {
                    let sides = boxes[id as usize].unwrap();
                    for i in 0..3 {
                        assert!(
                            low[i] <= sides[i].low - bvh.center()[i]
                                && sides[i].high - bvh.center()[i] <= high[i]
                        );
                    }
                }
                found.extend_from_slice(ids);
                continue;
            }
            let node = &bvh.nodes[child.index()];
            for i in (0..WIDTH).filter(|&i| node.low[0][i] <= node.high[0][i]) {
                let inner = [node.low, node.high].map(|corner| corner.map(|side| f64::from(side[i])));
                assert!((0..3).all(|axis| low[axis] <= inner[0][axis] && inner[1][axis] <= high[axis]));
                left.push((node.child[i], inner, level + 1));
            }
        }
        found.sort_unstable();
        assert!(found.into_iter().eq((0..boxes.len() as u32).filter(|&id| boxes[id as usize].is_some())));
        levels
    }

    #[test]
    fn work_that_is_stopped_unwinds_few_times() {
        let count = 1 << 20;
        let unwound = AtomicUsize::new(0);
        let stop = |_| {
            unwound.fetch_add(1, Ordering::Relaxed);
            resume_unwind(Box::new(()))
        };
        let outcome = catch_unwind(AssertUnwindSafe(|| parallel::run(|| collect::<()>(count, true, stop))));
        assert!(outcome.is_err() && unwound.into_inner() <= count / PIECE);
    }

    #[test]
    fn holds_every_primitive_once() {
        for count in [0, 1, 2, 7, 8, 9, 63, 64, 65, 257, 5000, 20_000] {
            check(&mixed_boxes(count), 8);
            check(&mixed_boxes(count), 1);
        }
        let some: Boxes =
            mixed_boxes(1000).into_iter().enumerate().map(|(i, b)| b.filter(|_| i % 3 == 0)).collect();
        check(&some, 8);
        check(&vec![None; 10], 8);
    }

    #[test]
    fn stays_flat() {
        assert!(check(&vec![Some([Interval::point(3.0); 3]); 50_000], 8) <= DEPTH);
        for factor in [0.5, 0.9, 0.99] {
            let power = |i: i32| f64::powi(factor, i).max(1e-30);
            assert!(check(&of_points((0..5000).map(|i| [power(i), 0.0, 0.0])), 1) <= DEPTH);
            assert!(check(&of_points((0..5000).map(|i| [power(i), power(i / 2), power(i / 3)])), 8) <= DEPTH);
        }
        let nested = |i: i32| Some([Interval { low: -f64::powi(1.01, i), high: f64::powi(1.01, i) }; 3]);
        assert!(check(&(0..5000).map(nested).collect(), 1) <= DEPTH);
    }

    #[test]
    fn takes_boxes_beyond_float32() {
        for size in [1e-300, 1e-40, 1e30, 1e38, 1e60, 1e300] {
            check(
                &of_points(
                    std::iter::repeat_with(numbers())
                        .take(3000)
                        .map(|x| [size * (x - 0.5), size * x * x, -size * x]),
                ),
                8,
            );
        }
        let mut boxes = mixed_boxes(3000);
        boxes.push(Some([Interval { low: f64::NEG_INFINITY, high: f64::INFINITY }; 3]));
        boxes.push(Some([0.0, -1e308, 1e308].map(|x| Interval { low: x, high: f64::INFINITY })));
        check(&boxes, 8);
    }

    #[test]
    fn is_the_same_on_any_number_of_threads() {
        let boxes = mixed_boxes(50_000);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let bvh = pool.install(|| hierarchy_of(&boxes, 8));
            (format!("{:?}", bvh.nodes), bvh.leaves)
        };
        assert!(on(1) == on(2) && on(1) == on(5));
    }
}
