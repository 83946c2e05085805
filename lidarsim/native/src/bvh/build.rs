//! Building by the surface area heuristic over bins (I. Wald, On fast construction of SAH-based bounding volume hierarchies, 2007).
//!
//! A node starts as one range of primitives and splits the range of largest surface until it has eight.

use rayon::prelude::*;

use super::span::{down, up};
use super::{Bvh, Child, LEAF, Node, WIDTH};
use crate::number::Interval;
use crate::vector::Point;

const BINS: usize = 16;

/// Levels of nodes split by surface; below them ranges are halved, so that eight equal ones are left of each.
const BY_SURFACE: usize = 16;

/// Most levels of nodes: 2²⁸ primitives are down to leaves after 10 more.
pub const DEPTH: usize = BY_SURFACE + 10;

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

pub fn build(bounds: &[Option<[Interval; 3]>]) -> Bvh {
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
    let nodes = if items.is_empty() { Vec::new() } else { subtree(&mut items, 0, 0) };
    Bvh { center, nodes, order: items.iter().map(|item| item.id).collect() }
}

/// The nodes over `items`, whose first has index `start` in the whole order; the root comes first.
fn subtree(items: &mut [Item], start: usize, depth: usize) -> Vec<Node> {
    let ranges = split_wide(items, depth);
    let mut node = Node {
        low: [[f32::INFINITY; WIDTH]; 3],
        high: [[f32::NEG_INFINITY; WIDTH]; 3],
        child: [Child::leaf(0, 1); WIDTH],
    };
    let parallel = items.len() > PARALLEL;
    let mut parts = Vec::with_capacity(ranges.len());
    let mut rest = items;
    let mut offset = start;
    for (i, range) in ranges.iter().enumerate() {
        for axis in 0..3 {
            node.low[axis][i] = range.bounds.low[axis];
            node.high[axis][i] = range.bounds.high[axis];
        }
        let (part, tail) = rest.split_at_mut(range.len);
        rest = tail;
        if range.leaf {
            node.child[i] = Child::leaf(offset, range.len);
        } else {
            parts.push((i, part, offset));
        }
        offset += range.len;
    }
    let grow = |(i, part, offset): (usize, &mut [Item], usize)| (i, subtree(part, offset, depth + 1));
    let children: Vec<_> =
        if parallel { parts.into_par_iter().map(grow).collect() } else { parts.into_iter().map(grow).collect() };
    let mut nodes = Vec::with_capacity(1 + children.iter().map(|(_, c)| c.len()).sum::<usize>());
    nodes.push(node);
    for (i, child) in children {
        let base = nodes.len();
        nodes[0].child[i] = Child::node(base);
        nodes.extend(child.into_iter().map(|mut node| {
            node.child = node.child.map(|c| c.moved(base));
            node
        }));
    }
    nodes
}

struct Range {
    len: usize,
    bounds: Bounds,
    leaf: bool,
}

/// Orders `items` into at most eight ranges.
fn split_wide(items: &mut [Item], depth: usize) -> Vec<Range> {
    let range = |items: &[Item]| {
        let mut bounds = Bounds::EMPTY;
        items.iter().for_each(|item| bounds.include(&item.bounds));
        Range { len: items.len(), bounds, leaf: items.len() == 1 }
    };
    let mut ranges = vec![range(items)];
    while ranges.len() < WIDTH {
        // Ranges that must be split come before those that may be; among them, the largest surface.
        let key = |r: &Range| (r.len > LEAF, if depth < BY_SURFACE { r.bounds.surface() } else { r.len as f32 });
        let Some(widest) = (0..ranges.len()).filter(|&i| !ranges[i].leaf).max_by(|&i, &j| {
            key(&ranges[i]).partial_cmp(&key(&ranges[j])).unwrap_or(std::cmp::Ordering::Equal)
        }) else {
            break;
        };
        let start: usize = ranges[..widest].iter().map(|r| r.len).sum();
        let len = ranges[widest].len;
        let part = &mut items[start..start + len];
        match split(part, &ranges[widest].bounds, depth < BY_SURFACE) {
            None => ranges[widest].leaf = true,
            Some(at) => {
                let (left, right) = (range(&part[..at]), range(&part[at..]));
                ranges.splice(widest..=widest, [left, right]);
            }
        }
    }
    for range in &mut ranges {
        range.leaf |= range.len <= LEAF;
    }
    ranges
}

/// Cost of a node against that of one primitive.
const NODE_COST: f32 = 1.0;

/// Orders `items` into two parts and returns the length of the first; none where a leaf is as good.
fn split(items: &mut [Item], bounds: &Bounds, by_surface: bool) -> Option<usize> {
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
                let cost = side.surface() * count as f32 + right[i].0 * right[i].1 as f32;
                if best.is_none_or(|(least, ..)| cost < least) {
                    best = Some((cost, axis, i));
                }
            }
        }
    }
    let surface = bounds.surface();
    match best {
        Some((cost, axis, bin)) => {
            if items.len() <= LEAF && cost + NODE_COST * surface >= items.len() as f32 * surface {
                return None;
            }
            let extent = middles.high[axis] - middles.low[axis];
            let middle = partition(items, |item| bin_of(item.middle(axis), middles.low[axis], extent) < bin);
            Some(middle)
        }
        None if items.len() <= LEAF => None,
        None => {
            let axis = (0..3).max_by(|&i, &j| {
                (middles.high[i] - middles.low[i]).total_cmp(&(middles.high[j] - middles.low[j]))
            });
            let half = items.len() / 2;
            if let Some(axis) = axis {
                items.select_nth_unstable_by(half, |a, b| a.middle(axis).total_cmp(&b.middle(axis)));
            }
            Some(half)
        }
    }
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
