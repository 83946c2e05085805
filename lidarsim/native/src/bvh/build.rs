//! Building by the surface area heuristic over bins (I. Wald, On fast construction of SAH-based bounding volume hierarchies, 2007).
//!
//! A node starts as one range of primitives and splits the range of largest surface until it has eight.

use rayon::prelude::*;

use super::span::{down, up};
use super::{Bvh, Child, LEAF, Node, WIDTH};
use crate::memory;
use crate::number::Interval;
use crate::vector::Point;

const BINS: usize = 16;

/// Levels of nodes split by surface; below them ranges are halved, so that eight equal ones are left of each.
const BY_SURFACE: usize = 16;

/// Most levels of nodes: 2³⁰ primitives are down to leaves of one after 10 more, and a level for what is uneven.
pub const DEPTH: usize = BY_SURFACE + 11;

/// Subtrees of more primitives than this are built in parallel.
const PARALLEL: usize = 4096;

#[derive(Clone, Copy)]
struct Bounds {
    low: [f32; 3],
    high: [f32; 3],
}

impl Bounds {
    const EMPTY: Bounds = Bounds { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    fn include(&mut self, other: &Bounds) {
        for i in 0..3 {
            self.low[i] = self.low[i].min(other.low[i]);
            self.high[i] = self.high[i].max(other.high[i]);
        }
    }

    /// Half the surface; zero for an empty box.
    fn surface(&self) -> f32 {
        let [x, y, z] = std::array::from_fn(|i| (self.high[i] - self.low[i]).max(0.0));
        x * y + y * z + z * x
    }
}

#[derive(Clone, Copy)]
struct Item {
    bounds: Bounds,
    id: u32,
}

impl Item {
    /// Halved first, so that the middle stays finite.
    fn middle(&self, axis: usize) -> f32 {
        0.5 * self.bounds.low[axis] + 0.5 * self.bounds.high[axis]
    }
}

pub fn build<L: Send>(bounds: &[Option<[Interval; 3]>], most: usize, leaf: impl Fn(&[u32]) -> L + Sync) -> Bvh<L> {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for b in bounds.iter().flatten() {
        for i in 0..3 {
            low[i] = low[i].min(b[i].low);
            high[i] = high[i].max(b[i].high);
        }
    }
    let center: Point = std::array::from_fn(|i| {
        let middle = 0.5 * low[i] + 0.5 * high[i];
        if middle.is_finite() { middle } else { 0.0 }
    });
    let mut items: Vec<Item> = bounds
        .par_iter()
        .enumerate()
        .filter_map(|(id, b)| {
            let b = (*b)?;
            let bounds = Bounds {
                low: std::array::from_fn(|i| down(b[i].low - center[i])),
                high: std::array::from_fn(|i| up(b[i].high - center[i])),
            };
            Some(Item { bounds, id: id as u32 })
        })
        .collect();
    let Part { nodes, leaves } = if items.is_empty() { Part::default() } else { subtree(&mut items, most, 0) };
    let mut start = 0;
    let starts: Vec<usize> = leaves
        .iter()
        .map(|len| {
            start += len;
            start - len
        })
        .collect();
    let mut made = memory::with_capacity(leaves.len());
    starts
        .into_par_iter()
        .zip(&leaves)
        .map(|(start, &len)| {
            let mut ids = [0; LEAF];
            for (id, item) in ids.iter_mut().zip(&items[start..start + len]) {
                *id = item.id;
            }
            leaf(&ids[..len])
        })
        .collect_into_vec(&mut made);
    Bvh { center, nodes: memory::copy(&nodes), leaves: made }
}

/// Nodes, the root first, and the lengths of the leaves below them, in the order of the items.
#[derive(Default)]
struct Part {
    nodes: Vec<Node>,
    leaves: Vec<usize>,
}

fn subtree(items: &mut [Item], most: usize, depth: usize) -> Part {
    let ranges = split_wide(items, most, depth);
    let mut node = Node {
        low: [[f32::INFINITY; WIDTH]; 3],
        high: [[f32::NEG_INFINITY; WIDTH]; 3],
        child: [Child::leaf(0); WIDTH],
    };
    for (i, range) in ranges.iter().enumerate() {
        for axis in 0..3 {
            node.low[axis][i] = range.bounds.low[axis];
            node.high[axis][i] = range.bounds.high[axis];
        }
    }
    let parallel = items.len() > PARALLEL;
    let mut rest = items;
    let children: Vec<_> = ranges
        .iter()
        .map(|range| {
            let (part, tail) = std::mem::take(&mut rest).split_at_mut(range.len);
            rest = tail;
            (range.leaf, part)
        })
        .collect();
    let grow = |(leaf, part): (bool, &mut [Item])| {
        if leaf { Part { nodes: Vec::new(), leaves: vec![part.len()] } } else { subtree(part, most, depth + 1) }
    };
    let children: Vec<Part> =
        if parallel { children.into_par_iter().map(grow).collect() } else { children.into_iter().map(grow).collect() };
    let mut all = Part { nodes: vec![node], leaves: Vec::new() };
    for (i, part) in children.into_iter().enumerate() {
        let (nodes, leaves) = (all.nodes.len(), all.leaves.len());
        all.nodes[0].child[i] = if part.nodes.is_empty() { Child::leaf(leaves) } else { Child::node(nodes) };
        all.nodes.extend(part.nodes.into_iter().map(|mut node| {
            node.child = node.child.map(|child| child.moved(nodes, leaves));
            node
        }));
        all.leaves.extend(part.leaves);
    }
    all
}

struct Range {
    len: usize,
    bounds: Bounds,
    leaf: bool,
}

/// Orders `items` into at most eight ranges.
fn split_wide(items: &mut [Item], most: usize, depth: usize) -> Vec<Range> {
    let range = |items: &[Item]| {
        let mut bounds = Bounds::EMPTY;
        items.iter().for_each(|item| bounds.include(&item.bounds));
        Range { len: items.len(), bounds, leaf: items.len() <= most }
    };
    let mut ranges = vec![range(items)];
    while ranges.len() < WIDTH {
        let key = |r: &Range| if depth < BY_SURFACE { r.bounds.surface() } else { r.len as f32 };
        let splits = (0..ranges.len()).filter(|&i| !ranges[i].leaf);
        let Some(widest) = splits.max_by(|&i, &j| key(&ranges[i]).total_cmp(&key(&ranges[j]))) else {
            break;
        };
        let start: usize = ranges[..widest].iter().map(|r| r.len).sum();
        let part = &mut items[start..start + ranges[widest].len];
        let at = split(part, most, depth < BY_SURFACE);
        let (left, right) = (range(&part[..at]), range(&part[at..]));
        ranges.splice(widest..=widest, [left, right]);
    }
    ranges
}

/// Orders `items`, two or more, into two parts that are not empty, and returns the length of the first.
fn split(items: &mut [Item], most: usize, by_surface: bool) -> usize {
    let mut middles = Bounds::EMPTY;
    for item in items.iter() {
        let m = std::array::from_fn(|i| item.middle(i));
        middles.include(&Bounds { low: m, high: m });
    }
    let mut best: Option<(f32, usize, usize)> = None;
    if by_surface {
        for axis in 0..3 {
            let extent = middles.high[axis] - middles.low[axis];
            if !(extent > 0.0 && extent.is_finite()) {
                continue;
            }
            let mut bins = [(Bounds::EMPTY, 0usize); BINS];
            for item in items.iter() {
                let bin = &mut bins[bin_of(item.middle(axis), middles.low[axis], extent)];
                bin.0.include(&item.bounds);
                bin.1 += 1;
            }
            let mut right = [(0.0_f32, 0usize); BINS];
            let (mut side, mut count) = (Bounds::EMPTY, 0);
            for i in (1..BINS).rev() {
                side.include(&bins[i].0);
                count += bins[i].1;
                right[i] = (side.surface(), count);
            }
            let (mut side, mut count) = (Bounds::EMPTY, 0);
            for i in 1..BINS {
                side.include(&bins[i - 1].0);
                count += bins[i - 1].1;
                if count == 0 || right[i].1 == 0 {
                    continue;
                }
                let cost = side.surface() * leaves(count, most) + right[i].0 * leaves(right[i].1, most);
                if best.is_none_or(|(least, ..)| cost < least) {
                    best = Some((cost, axis, i));
                }
            }
        }
    }
    if let Some((_, axis, bin)) = best {
        let extent = middles.high[axis] - middles.low[axis];
        return partition(items, |item| bin_of(item.middle(axis), middles.low[axis], extent) < bin);
    }
    let extent = |i: usize| middles.high[i] - middles.low[i];
    let axis = (1..3).fold(0, |widest, i| if extent(i) > extent(widest) { i } else { widest });
    let half = items.len() / 2;
    items.select_nth_unstable_by(half, |a, b| a.middle(axis).total_cmp(&b.middle(axis)));
    half
}

/// A leaf costs the same whether it is full or not.
fn leaves(count: usize, most: usize) -> f32 {
    count.div_ceil(most) as f32
}

fn bin_of(middle: f32, low: f32, extent: f32) -> usize {
    (((middle - low) / extent * BINS as f32) as usize).min(BINS - 1)
}

fn partition(items: &mut [Item], first: impl Fn(&Item) -> bool) -> usize {
    let mut count = 0;
    for i in 0..items.len() {
        if first(&items[i]) {
            items.swap(i, count);
            count += 1;
        }
    }
    count
}
