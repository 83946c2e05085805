//! Traversal: by one ray, by a packet, and by interleaved single rays of a packet.

use super::Bvh;
use super::node::{Child, Node, WIDTH};
use super::packet::{FewBoxHits, Frustum, Packet, Slabs};
use super::ray_packet::{LANES, Mask, all, take};
use super::stack::{Entry, RayStack, SINGLE_RAYS, Stack};
use super::traversal_ray::TraversalRay;
use crate::arith::simd::Isa;

/// Intersects single rays with leaves. A trait, as a closure would not be compiled for the instruction set.
pub trait Visitor<L> {
    /// Intersects up to `SINGLE_RAYS` rays with one leaf each. Returns the mask of rays whose limit has
    /// decreased.
    fn visit<I: Isa>(&mut self, stack: &mut Stack, lanes: &[usize], leaves: &[&L]) -> Mask;

    /// The limit of t of each ray: hits beyond it are not needed.
    fn limits(&self) -> &[f64; LANES];
}

impl<L> Bvh<L> {
    /// Visits the leaves whose boxes the ray may enter, nearest box first. `visit` returns the new limit of
    /// t; it may traverse another hierarchy on the same stack.
    pub fn traverse(
        &self,
        ray: &mut TraversalRay,
        stack: &mut Stack,
        mut visit: impl FnMut(&mut Stack, &L) -> f64,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let base = stack.len;
        stack.push_sorted(base, Entry { near: 0.0, child: Child::node(0), mask: 0 });
        while let Some(entry) = stack.pop(base) {
            if entry.near > ray.limit() {
                continue;
            }
            if entry.child.is_leaf() {
                ray.lower_limit(visit(stack, &self.leaves[entry.child.index()]));
                continue;
            }
            let node = &self.nodes[entry.child.index()];
            let (near, far) = ray.intersect(&node.low, &node.high);
            let first = stack.len;
            let missed = node.missed_children(ray.parallel());
            for i in 0..WIDTH {
                if near[i] <= far[i] && missed >> i & 1 == 0 {
                    stack.push_sorted(first, Entry { near: near[i], child: node.child[i], mask: 0 });
                }
            }
        }
    }

    /// Begins the traversal of a packet set up for the hierarchy (`Packet::enter`).
    #[inline(always)]
    pub fn start<I: Isa>(&self, traversal: &mut PacketTraversal, active: Mask, stack: &mut Stack) {
        (traversal.base, traversal.nearer) = (stack.len, 0);
        if !self.nodes.is_empty() {
            traversal.frustum = traversal.packet.frustum_of_all::<I>();
            stack.push_if(active != 0, Entry { near: 0.0, child: Child::node(0), mask: active });
        }
    }

    /// The current leaf of a packet; `None` at an inner node.
    #[inline(always)]
    pub fn leaf(&self, traversal: &PacketTraversal) -> Option<&L> {
        if traversal.child.is_leaf() { Some(&self.leaves[traversal.child.index()]) } else { None }
    }

    /// Tests the children of a packet's current node and pushes those that rays may enter. Returns whether
    /// there are any.
    #[inline(always)]
    pub fn open<I: Isa>(&self, traversal: &PacketTraversal, stack: &mut Stack) -> bool {
        let before = stack.len;
        let PacketTraversal { packet, frustum, mask, .. } = traversal;
        let node = &self.nodes[traversal.child.index()];
        let may_miss = packet.may_miss_flat(node);
        // Farthest first and branchless: no branch depends on the outcome of a single test.
        if mask.count_ones() > FEW {
            let box_hits = frustum.intersect::<I>(&packet.octant, node);
            for (&near, &i) in box_hits.near.iter().zip(&box_hits.child).take(box_hits.count) {
                let (child, mut mask) =
                    (node.child[i as usize], packet.intersect::<I>(*mask, &box_hits, i as usize));
                if may_miss {
                    mask &= !packet.missing(mask, node, i as usize);
                }
                self.prefetch::<I>(if mask != 0 { child } else { traversal.child });
                stack.push_if(mask != 0, Entry { near, child, mask });
            }
        } else {
            let FewBoxHits { count, child, near, masks } = packet.intersect_few::<I>(*mask, frustum, node);
            for (&near, &i) in near.iter().zip(&child).take(count) {
                let (child, mut mask) = (node.child[i as usize], masks[i as usize]);
                if may_miss {
                    mask &= !packet.missing(mask, node, i as usize);
                }
                self.prefetch::<I>(child);
                stack.push_if(mask != 0, Entry { near, child, mask });
            }
        }
        stack.len > before
    }

    /// As `traverse`, for the rays of a packet one by one. `SINGLE_RAYS` traversals are interleaved, one step
    /// each in turn, which hides the latency of memory. Rays at nodes and rays at leaves are stepped in
    /// separate loops, so no branch depends on where a single ray goes.
    #[inline(always)]
    pub fn traverse_single<I: Isa>(
        &self,
        packet: &Packet,
        active: Mask,
        stack: &mut Stack,
        visitor: &mut impl Visitor<L>,
    ) {
        let Some(leaf) = self.leaves.first() else { return };
        let octant = packet.octant;
        let mut traversals = [RayTraversal::EMPTY; SINGLE_RAYS];
        let (mut waiting, mut progress) = (active, Progress { idle: all(SINGLE_RAYS), at_leaves: 0 });
        loop {
            while waiting != 0
                && let Some(k) = take(&mut progress.idle)
                && let Some(lane) = take(&mut waiting)
            {
                traversals[k].start(lane, packet, &mut stack.ray_stacks[k]);
            }
            let mut at_nodes = all(SINGLE_RAYS) & !(progress.idle | progress.at_leaves);
            let mut at_leaves = std::mem::take(&mut progress.at_leaves);
            if at_nodes | at_leaves == 0 {
                return;
            }
            while let Some(k) = take(&mut at_nodes) {
                let (traversal, ray_stack) = (&mut traversals[k], &mut stack.ray_stacks[k]);
                let node = &self.nodes[traversal.child.index()];
                let Slabs { mut near, mut far, .. } =
                    traversal.frustum.slabs::<I>(&octant, node, traversal.limit);
                if traversal.may_miss && node.is_flat() {
                    (near, far) = packet.narrowed::<I>(traversal.lane, node, (near, far));
                }
                ray_stack.push::<I>(near, far, &node.child);
                traversal.child = ray_stack.pop();
                self.prefetch::<I>(traversal.child);
                progress.note(k, traversal.child);
            }
            let (mut lanes, mut leaves, mut count) = ([0; SINGLE_RAYS], [leaf; SINGLE_RAYS], 0);
            let mut left = at_leaves;
            while let Some(k) = take(&mut left) {
                (lanes[count], leaves[count]) =
                    (traversals[k].lane, &self.leaves[traversals[k].child.index()]);
                count += 1;
            }
            let nearer =
                if count > 0 { visitor.visit::<I>(stack, &lanes[..count], &leaves[..count]) } else { 0 };
            while let Some(k) = take(&mut at_leaves) {
                let (traversal, ray_stack) = (&mut traversals[k], &mut stack.ray_stacks[k]);
                if nearer & 1 << traversal.lane != 0 {
                    traversal.limit = packet.limit_of(traversal.lane, visitor.limits()[traversal.lane]);
                    ray_stack.keep_within(traversal.limit, traversal.base);
                }
                traversal.child = ray_stack.pop();
                self.prefetch::<I>(traversal.child);
                progress.note(k, traversal.child);
            }
        }
    }

    /// Prefetches a node or a leaf, without a branch on the kind.
    #[inline(always)]
    fn prefetch<I: Isa>(&self, child: Child) {
        let leaf: *const [u8; 64] = self.leaves.as_ptr().wrapping_add(child.index()).cast();
        let node: *const [u8; 64] = self.nodes.as_ptr().wrapping_add(child.index()).cast();
        let start = if child.is_leaf() { leaf } else { node };
        for line in 0..size_of::<Node>().max(size_of::<L>()).div_ceil(64) {
            I::prefetch(start.wrapping_add(line));
        }
    }
}

/// The traversal of a hierarchy by a packet.
pub struct PacketTraversal {
    pub packet: Packet,
    frustum: Frustum,
    /// The current node or leaf, and the rays that may enter its box.
    child: Child,
    mask: Mask,
    /// Rays whose limits have decreased since the packet last read them.
    nearer: Mask,
    /// The base of its part of the stack.
    base: usize,
}

impl PacketTraversal {
    pub fn new() -> Self {
        PacketTraversal {
            packet: Packet::empty(),
            frustum: Frustum::EMPTY,
            child: Child::node(0),
            mask: 0,
            nearer: 0,
            base: 0,
        }
    }

    /// The rays that may enter the box of the current node or leaf.
    #[inline(always)]
    pub fn mask(&self) -> Mask {
        self.mask
    }

    /// Records the rays whose limits have decreased.
    #[inline(always)]
    pub fn lower_limits(&mut self, nearer: Mask) {
        self.nearer = nearer;
    }

    /// Pops the next node or leaf within the limits of t; false if there is none.
    #[inline(always)]
    pub fn next_entry<I: Isa>(&mut self, stack: &mut Stack, limits: &[f64; LANES]) -> bool {
        if self.nearer != 0 {
            self.packet.set_limits::<I>(limits);
            self.nearer = 0;
        }
        while let Some(Entry { near, child, mask }) = stack.pop(self.base) {
            let mask = self.packet.within::<I>(mask, near);
            if mask != 0 {
                (self.child, self.mask) = (child, mask);
                return true;
            }
        }
        false
    }

    /// Ends the traversal.
    pub fn stop(&mut self, stack: &Stack) {
        self.base = stack.len;
    }
}

/// The traversal of a hierarchy by a single ray.
#[derive(Clone, Copy)]
struct RayTraversal {
    lane: usize,
    frustum: Frustum,
    limit: f32,
    /// Whether it may miss flat children.
    may_miss: bool,
    child: Child,
    /// The base of its part of its stack.
    base: usize,
}

impl RayTraversal {
    const EMPTY: RayTraversal = RayTraversal {
        lane: 0,
        frustum: Frustum::EMPTY,
        limit: 0.0,
        may_miss: false,
        child: Child::node(0),
        base: 0,
    };

    #[inline(always)]
    fn start(&mut self, lane: usize, packet: &Packet, ray_stack: &mut RayStack) {
        self.lane = lane;
        packet.put_frustum_of_one(lane, &mut self.frustum);
        self.limit = packet.limit(lane);
        self.may_miss = packet.may_miss(lane);
        self.child = Child::node(0);
        ray_stack.child[ray_stack.len] = Child::END.0;
        ray_stack.len += 1;
        self.base = ray_stack.len;
    }
}

/// The interleaved traversals that have ended and those at a leaf, one bit each; the others are at inner
/// nodes.
struct Progress {
    idle: Mask,
    at_leaves: Mask,
}

impl Progress {
    #[inline(always)]
    fn note(&mut self, k: usize, child: Child) {
        self.idle |= Mask::from(child == Child::END) << k;
        self.at_leaves |= Mask::from(child.is_leaf()) << k;
    }
}

/// With up to this many active rays, a packet tests ray by ray against all boxes at once; with more, box by
/// box against all rays.
const FEW: u32 = 16;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::Interval;
    use crate::arith::simd::{Level, Task, dispatch};
    use crate::bvh::{Crossings, RayPacket};

    type Whole = [i64; 3];

    /// All corners, origins and directions are whole numbers, so brute force over the boxes is exact.
    struct Cube {
        low: Whole,
        high: Whole,
    }

    /// The numerator and the positive denominator of the t at which a ray enters a box; `None` if it misses.
    fn entry(cube: &Cube, origin: Whole, direction: Whole) -> Option<(i64, i64)> {
        let (mut near, mut far) = ((0, 1), (i64::MAX, 1));
        for axis in 0..3 {
            let (low, high, o, d) = (cube.low[axis], cube.high[axis], origin[axis], direction[axis]);
            if d == 0 {
                if o < low || high < o {
                    return None;
                }
                continue;
            }
            let (first, last) = if d > 0 { (low - o, high - o) } else { (o - high, o - low) };
            let less = |a: (i64, i64), b: (i64, i64)| {
                i128::from(a.0) * i128::from(b.1) < i128::from(b.0) * i128::from(a.1)
            };
            if less(near, (first, d.abs())) {
                near = (first, d.abs());
            }
            if less((last, d.abs()), far) {
                far = (last, d.abs());
            }
            if less(far, near) {
                return None;
            }
        }
        Some(near)
    }

    /// Whole numbers from 0 to `below`, from a linear congruential generator.
    fn numbers() -> impl FnMut(i64) -> i64 {
        let mut state = 1_u64;
        move |below| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as i64 % below
        }
    }

    /// Records the leaves that rays visit; in searches for the first box its t becomes the limit.
    struct Notes<'a> {
        cubes: &'a [Cube],
        rays: &'a [(Whole, Whole)],
        first_only: bool,
        offered: Vec<Vec<u32>>,
        limits: [f64; LANES],
    }

    impl Visitor<Vec<u32>> for Notes<'_> {
        fn visit<I: Isa>(&mut self, _: &mut Stack, lanes: &[usize], leaves: &[&Vec<u32>]) -> Mask {
            let mut nearer = 0;
            for (&lane, leaf) in lanes.iter().zip(leaves) {
                self.offered[lane].extend_from_slice(leaf);
                for &id in leaf.iter().filter(|_| self.first_only) {
                    let (origin, direction) = self.rays[lane];
                    let t = entry(&self.cubes[id as usize], origin, direction)
                        .map(|(num, den)| num as f64 / den as f64);
                    if let Some(t) = t.filter(|t| *t < self.limits[lane]) {
                        self.limits[lane] = t;
                        nearer |= 1 << lane;
                    }
                }
            }
            nearer
        }

        fn limits(&self) -> &[f64; LANES] {
            &self.limits
        }
    }

    struct Traverse<'a, 'b> {
        bvh: &'a Bvh<Vec<u32>>,
        seen: &'a RayPacket,
        crossings: Option<&'a Crossings>,
        active: Mask,
        together: bool,
        notes: &'a mut Notes<'b>,
    }

    impl Task for Traverse<'_, '_> {
        type Output = ();

        fn run<I: Isa>(self) {
            let Traverse { bvh, seen, crossings, active, together, notes } = self;
            let (mut traversal, mut stack) = (PacketTraversal::new(), Stack::new());
            traversal.packet.enter::<I>(seen, crossings, bvh.frame(), 0.0, &[f64::MAX; LANES]);
            if together {
                bvh.start::<I>(&mut traversal, active, &mut stack);
                while traversal.next_entry::<I>(&mut stack, notes.limits()) {
                    let Some(leaf) = bvh.leaf(&traversal) else {
                        bvh.open::<I>(&traversal, &mut stack);
                        continue;
                    };
                    let (mut nearer, mut left) = (0, traversal.mask());
                    while let Some(lane) = take(&mut left) {
                        nearer |= notes.visit::<I>(&mut stack, &[lane], &[leaf]);
                    }
                    traversal.lower_limits(nearer);
                }
            } else {
                bvh.traverse_single::<I>(&traversal.packet, active, &mut stack, notes);
            }
            assert!(stack.len == 0 && stack.ray_stacks.iter().all(|ray_stack| ray_stack.len == 0));
        }
    }

    fn cubes(count: usize, next: &mut impl FnMut(i64) -> i64) -> Vec<Cube> {
        let cube = |_| {
            let low = [0; 3].map(|_| next(2000) - 1000);
            Cube { low, high: low.map(|x| x + [0, 10, 60, 400][next(4) as usize]) }
        };
        (0..count).map(cube).collect()
    }

    /// Rays of one octant, from one corner of the scene or from anywhere, close together or many along an
    /// axis, each off by its whole error.
    fn rays(
        octant: u32,
        [origin_error, error]: [i64; 2],
        next: &mut impl FnMut(i64) -> i64,
    ) -> (Vec<(Whole, Whole)>, RayPacket) {
        let sign = |axis: usize| if octant >> axis & 1 != 0 { -1 } else { 1 };
        let (apart, narrow) = (next(2) * 1000, next(2) == 0);
        let mut seen = RayPacket::empty();
        (seen.octant, seen.count) = (octant, 40 + next(25) as usize);
        let ray = |lane: usize| {
            let origin =
                [0, 1, 2].map(|axis| -300 * sign(axis) + if apart > 0 { next(apart) - 500 } else { 0 });
            // Without errors, a direction may not be zero where the octant is negative.
            let least = |axis: usize| i64::from(error == 0 && sign(axis) < 0);
            let mut direction = [0, 1, 2].map(|axis: usize| {
                let size = if narrow {
                    30 + 7 * axis as i64 + next(3)
                } else {
                    [0, 1, 7, next(40)][next(4) as usize]
                };
                sign(axis) * size.max(least(axis))
            });
            if direction == [0; 3] {
                direction[0] = sign(0);
            }
            let given = [0, 1, 2].map(|axis| {
                let d = direction[axis] + error * (next(3) - 1);
                if (d < 0) == (sign(axis) < 0) { d } else { sign(axis).min(0) }
            });
            seen.set(
                lane,
                origin.map(|x| (x + origin_error * (next(3) - 1)) as f64),
                given.map(|x| x as f64),
            );
            (seen.origin_error[lane], seen.direction_error[lane]) = (origin_error as f64, error as f64);
            (origin, direction)
        };
        let true_rays = (0..LANES).map(ray).collect();
        (true_rays, seen)
    }

    #[test]
    fn rays_alone_and_together_are_offered_all_that_they_meet() {
        let mut next = numbers();
        let (mut hit, mut offered, mut possible) = (0, 0, 0);
        for (count, most) in [(0, 8), (1, 8), (7, 1), (300, 8), (1500, 1), (1500, 4)] {
            let cubes = cubes(count, &mut next);
            let bounds = |id: u32| {
                let Cube { low, high } = &cubes[id as usize];
                Some([0, 1, 2].map(|i| Interval { low: low[i] as f64, high: high[i] as f64 }))
            };
            let bvh = Bvh::new(count, bounds, most, <[u32]>::to_vec);
            for octant in 0..8 {
                for (errors, first_only) in
                    [([0, 0], false), ([5, 0], false), ([0, 1], false), ([0, 0], true)]
                {
                    let (rays, seen) = rays(octant, errors, &mut next);
                    let entries_of =
                        |&(o, d): &(Whole, Whole)| cubes.iter().map(|cube| entry(cube, o, d)).collect();
                    let entries: Vec<Vec<_>> = rays.iter().map(entries_of).collect();
                    let some =
                        all(seen.count) & (next(1 << 30) as u64 | (next(1 << 30) as u64) << 30 | 3 << 60);
                    for (level, together) in
                        Level::ALL.into_iter().flat_map(|level| [(level, false), (level, true)])
                    {
                        if level > Level::best() {
                            continue;
                        }
                        let mut notes = Notes {
                            cubes: &cubes,
                            rays: &rays,
                            first_only,
                            offered: vec![Vec::new(); LANES],
                            limits: [f64::MAX; LANES],
                        };
                        dispatch(
                            level,
                            Traverse {
                                bvh: &bvh,
                                seen: &seen,
                                crossings: None,
                                active: some,
                                together,
                                notes: &mut notes,
                            },
                        );
                        for (lane, &(origin, direction)) in rays.iter().enumerate() {
                            let found = &mut notes.offered[lane];
                            if some & 1 << lane == 0 {
                                assert!(found.is_empty(), "a ray that takes no part");
                                continue;
                            }
                            let count = found.len();
                            found.sort_unstable();
                            found.dedup();
                            // If the sign of no axis is known, absent children are visited, too, and lead to
                            // the first leaf.
                            assert!(errors[1] > 0 || found.len() == count, "a leaf comes twice");
                            if first_only {
                                let t =
                                    entries[lane].iter().flatten().map(|&(num, den)| num as f64 / den as f64);
                                assert_eq!(
                                    notes.limits[lane],
                                    t.fold(f64::MAX, f64::min),
                                    "{level:?} {together}"
                                );
                                continue;
                            }
                            for (id, _) in
                                entries[lane].iter().enumerate().filter(|(_, entry)| entry.is_some())
                            {
                                let is_offered = found.binary_search(&(id as u32)).is_ok();
                                assert!(
                                    is_offered,
                                    "{level:?} {together}: {origin:?} + t·{direction:?}, box {id}"
                                );
                                hit += 1;
                            }
                            if errors == [0, 0] && !together && most == 1 {
                                offered += found.len();
                                possible += cubes.len();
                            }
                        }
                    }
                }
            }
        }
        // Many boxes are hit, and few others are visited: hardly any that no ray came near.
        assert!(hit > 10_000, "{hit}");
        assert!(20 * offered < possible, "{offered} of {possible}");
    }

    /// Tiles of a plane among blocks. Rays are known to some metres only, but it is known where they cross
    /// the plane.
    #[test]
    fn tiles_of_a_plane_are_offered_where_rays_cross_it() {
        let mut next = numbers();
        let mut cubes = cubes(300, &mut next);
        cubes.extend((0..900).map(|k| {
            let low = [60 * (k % 30) - 900, 60 * (k / 30) - 900, 100];
            Cube { low, high: [low[0] + 60, low[1] + 60, 100] }
        }));
        let bounds = |id: u32| {
            let Cube { low, high } = &cubes[id as usize];
            Some([0, 1, 2].map(|i| Interval { low: low[i] as f64, high: high[i] as f64 }))
        };
        let bvh = Bvh::new(cubes.len(), bounds, 1, <[u32]>::to_vec);
        assert_eq!(bvh.frame().planes[2].to_bits(), 100.0_f64.to_bits());
        let (mut hits, mut tiles) = (0, [0; 2]);
        for round in 0..32 {
            let (rays, seen) = rays(round % 8, [5, 0], &mut next);
            let mut crossings = Crossings::NONE;
            (crossings.rays, crossings.axis) = (all(LANES), 2);
            for (lane, (o, d)) in rays.iter().enumerate() {
                let t = (100 - o[2]) as f64 / d[2] as f64;
                // In the plane there is no hit.
                let never = d[2] == 0;
                crossings.low[lane] = if never { f64::INFINITY } else { t.next_down() };
                crossings.high[lane] = if never { f64::NEG_INFINITY } else { t.next_up() };
            }
            for (level, together) in Level::ALL.into_iter().flat_map(|level| [(level, false), (level, true)])
            {
                if level > Level::best() {
                    continue;
                }
                for (tiles, crossings) in tiles.iter_mut().zip([Some(&crossings), None]) {
                    let (offered, limits) = (vec![Vec::new(); LANES], [f64::MAX; LANES]);
                    let mut notes = Notes { cubes: &cubes, rays: &rays, first_only: false, offered, limits };
                    let (bvh, seen, active) = (&bvh, &seen, all(seen.count));
                    dispatch(level, Traverse { bvh, seen, crossings, active, together, notes: &mut notes });
                    for (offered, (o, d)) in notes.offered.iter().zip(&rays).take(seen.count) {
                        *tiles += offered.iter().filter(|id| **id >= 300).count();
                        for (id, cube) in cubes.iter().enumerate() {
                            let is_met = entry(cube, *o, *d).is_some() && (d[2] != 0 || id < 300);
                            assert!(!is_met || offered.contains(&(id as u32)), "{level:?}: {o:?} {d:?} {id}");
                            hits += usize::from(is_met && id >= 300);
                        }
                    }
                }
            }
        }
        // Each is counted with and without the crossings.
        assert!(hits > 2000 && tiles[0] < hits && tiles[1] > 2 * tiles[0], "{hits}, {tiles:?}");
    }

    /// Straight down, with rounding errors as in the coordinates of an object: the sign is uncertain along
    /// two axes.
    #[test]
    fn directions_of_uncertain_sign_are_offered_little_more() {
        let mut next = numbers();
        let cubes = cubes(1500, &mut next);
        let bounds = |id: u32| {
            let Cube { low, high } = &cubes[id as usize];
            Some([0, 1, 2].map(|i| Interval { low: low[i] as f64, high: high[i] as f64 }))
        };
        let bvh = Bvh::new(cubes.len(), bounds, 1, <[u32]>::to_vec);
        let rays: Vec<(Whole, Whole)> =
            (0..LANES).map(|_| ([next(2000) - 1000, next(2000) - 1000, 3000], [0, 0, -1])).collect();
        let mut seen = RayPacket::empty();
        (seen.octant, seen.count) = (4, LANES);
        for (lane, (origin, direction)) in rays.iter().enumerate() {
            seen.set(lane, origin.map(|x| x as f64), direction.map(|x| x as f64));
        }
        for level in Level::available() {
            for together in [false, true] {
                let mut counts = [0; 2];
                for (count, error) in counts.iter_mut().zip([0.0, 1e-9]) {
                    seen.direction_error = [error; LANES];
                    let (offered, limits) = (vec![Vec::new(); LANES], [f64::MAX; LANES]);
                    let mut notes = Notes { cubes: &cubes, rays: &rays, first_only: false, offered, limits };
                    let (bvh, seen, crossings, active) = (&bvh, &seen, None, all(LANES));
                    dispatch(level, Traverse { bvh, seen, crossings, active, together, notes: &mut notes });
                    *count = notes.offered.iter().map(Vec::len).sum::<usize>();
                }
                let [known, vague] = counts;
                assert!(
                    200 < known && known <= vague && vague < known + known / 50,
                    "{level:?} {together}: {counts:?}"
                );
            }
        }
    }
}
