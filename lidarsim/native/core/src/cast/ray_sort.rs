//! Ray sorting: an order in which adjacent rays are coherent, by octant, origin and a Morton code of the
//! direction (K. Garanzha, C. Loop, Fast Ray Sorting and Breadth-First Packet Traversal for GPU Ray Tracing,
//! 2010).
//!
//! ```text
//! g = 1,024 rays if later ones are these, rotated, else 8,192
//! for each group of g rays, or of bundles:
//!     if the order of the last group suits:     move its indices by g, and go on
//!     (u, v), octant = place of d on |x| + |y| + |z| = 1
//!     if the rays go once round the octants:    they are a fan, and stay as they are
//!     key = octant, [cell of o,] Morton code of (u, v)        [if the origins are far apart]
//!     runs = rays near their predecessors, 4 or 16 as one     [if g = 1,024]
//!     order = radix sort of the keys of runs and other rays
//! ```
//!
//! | symbol | meaning | in the code |
//! |---|---|---|
//! | g | rays that are sorted together | `group`: `NEAR`, `MOST` |
//! | d, o | direction and origin of a ray, or of the first of a bundle | `directions`, `origins` |
//! | u, v | place on the face of an octant, 16 bits each; v rises with the elevation | `places` |
//! | octant | the signs of d | `octants` |
//! | cell | place of o in the box of the group's origins, three bits per axis | `add_cells` |
//! | item | a key, above the index of its first ray and a bit for runs | `items` |

use std::ops::Range;

use crate::arith::simd::{Floats, Isa, Task, lanes};
use crate::bvh::LANES;
use crate::geometry::origins::Origins;
use crate::geometry::point::dot;
use crate::geometry::vector::Point;
use crate::memory;
use crate::scene::Rays;

/// Rays that are sorted together if later ones reuse their order: they and their hits stay in the
/// first-level cache.
pub const NEAR: usize = 1024;

/// Most rays that are sorted together: they stay in the second-level cache, and their indices have 16 bits,
/// as their keys have.
pub const MOST: usize = 1 << 13;

/// Bits of a key per axis, for the direction within its octant and for the origin. The octant is above them.
const DIRECTION: u32 = 6;
const ORIGIN: u32 = 3;

/// Origins are close together if the box around them is smaller than the scene by this factor.
const CLOSE: f64 = 64.0;

/// Bits of the direction that count if origins differ.
const COARSE: u32 = 4;

/// Consecutive groups of rays, each in a coherent order. The struct is reused from cast to cast to keep its
/// memory.
#[derive(Default)]
pub struct RaySort {
    /// The longest side of the scene.
    size: f64,
    /// The number of the world at which the rays are cast.
    world: u64,
    has_times: bool,
    /// As in `Rays`.
    bundle: usize,
    /// Most rays that are sorted together.
    group: usize,
    start: usize,
    /// The number of sorted rays.
    count: usize,
    /// Whether these share one origin, to the bit.
    has_one_origin: bool,
    last: LastSorted,
    /// Of bundles, their first rays.
    axes: Vec<Point>,
    starts: Vec<Point>,
    places: Vec<u32>,
    octants: Vec<u32>,
    keys: Vec<u32>,
    /// Whether a ray is near its predecessor.
    near: Vec<u32>,
    items: Vec<u32>,
    sorted: Vec<u32>,
    order: Vec<u32>,
}

/// The last sorted group of `NEAR` rays of one origin; its order may suit later groups.
#[derive(Default)]
struct LastSorted {
    /// Where the sorted group begins; `None` if there is none.
    start: Option<usize>,
    /// The signs of the coordinates, one bit each.
    signs: Vec<u8>,
    /// The size of its packets.
    spread: f64,
}

struct SortNext<'a> {
    ray_sort: &'a mut RaySort,
    origins: Origins<'a>,
    directions: &'a [Point],
}

impl Task for SortNext<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self) -> bool {
        self.ray_sort.sort_next::<I>(self.origins, self.directions)
    }
}

impl RaySort {
    /// Restarts for these rays. The last order is kept if it was for the same world.
    pub fn restart(&mut self, rays: &Rays, (world, size): (u64, f64)) {
        let Rays { directions, times, bundle, .. } = *rays;
        self.bundle = bundle;
        self.group = group_size(directions, bundle);
        self.has_times = !times.is_empty();
        (self.size, self.start, self.count) = (size, 0, 0);
        if self.world != world {
            (self.world, self.last.start) = (world, None);
        }
        let room = self.group.min(directions.len()) + BLOCK + LONG_RUN.max(bundle);
        let RaySort { places, octants, keys, near, items, sorted, order, .. } = self;
        for vector in [places, octants, keys, near, items, sorted] {
            vector.clear();
            memory::reserve(vector, room);
        }
        memory::reserve(order, room);
        for vector in [&mut self.axes, &mut self.starts] {
            vector.clear();
            memory::reserve(vector, if bundle > 1 { room / bundle } else { 0 });
        }
    }

    /// Takes the next group of rays, if any, sorted by octant, by the cell of the origin if origins differ,
    /// and by direction along a Morton curve, so that tiles of directions stay together.
    #[inline(always)]
    pub fn advance<I: Isa>(&mut self, origins: Origins, directions: &[Point]) -> bool {
        I::call(SortNext { ray_sort: self, origins, directions })
    }

    #[inline(always)]
    fn sort_next<I: Isa>(&mut self, origins: Origins, directions: &[Point]) -> bool {
        let group = self.start..directions.len().min(self.start + self.group);
        if group.is_empty() {
            return false;
        }
        (self.start, self.count) = (group.end, group.len());
        let origins = origins.part(group.clone()).each();
        if self.bundle > 1 {
            self.sort_bundles::<I>(origins, &directions[group.clone()], group.start);
            return true;
        }
        self.has_one_origin = are_equal(origins);
        let together = self.group == NEAR && self.is_together::<I>(origins);
        if together && self.takes_over::<I>(directions, group.clone()) {
            return true;
        }
        self.last.start = None;
        let (low, high) = self.find_places::<I>(&directions[group.clone()]);
        if self.group == NEAR && self.are_a_fan(low, high) {
            self.order.clear();
            self.order.extend(group.start as u32..group.end as u32);
            return true;
        }
        let width = if together { WIDTH } else { 1.0 };
        self.direction_keys(low, high, width);
        if self.group != NEAR {
            self.add_cells::<I>(origins);
            self.radix_sort::<1>(group.start);
        } else if together {
            self.find_near::<RUN>(low, high, width, 2.0);
            self.radix_sort::<RUN>(group.start);
            self.keep::<I>(directions, group);
        } else {
            self.find_near::<LONG_RUN>(low, high, width, 3.0);
            self.radix_sort::<LONG_RUN>(group.start);
        }
        true
    }

    /// Sorts rays by the places of their bundles.
    #[inline(always)]
    fn sort_bundles<I: Isa>(&mut self, origins: &[Point], directions: &[Point], first: usize) {
        self.last.start = None;
        let bundle = self.bundle;
        let (mut axes, mut starts) = (std::mem::take(&mut self.axes), std::mem::take(&mut self.starts));
        axes.clear();
        axes.extend(directions.iter().step_by(bundle));
        starts.clear();
        starts.extend(origins.iter().step_by(bundle));
        self.has_one_origin = are_equal(&starts);
        let (low, high) = self.find_places::<I>(&axes);
        let together = !self.has_times && self.has_one_origin;
        self.direction_keys(low, high, if together { WIDTH } else { 1.0 });
        let within = self.add_cells::<I>(&starts);
        (self.axes, self.starts) = (axes, starts);
        self.items.clear();
        for ((k, key), rays) in self.keys.iter().enumerate().zip(directions.chunks_exact(bundle)) {
            let (axis, mut other) = (rays[0].map(f64::to_bits), [0; 3]);
            for ray in rays {
                for i in 0..3 {
                    other[i] |= ray[i].to_bits() ^ axis[i];
                }
            }
            if (other[0] | other[1] | other[2]) >> 63 == 0 {
                self.items.push(key << 16 | ((bundle * k) as u32) << 1 | 1);
                continue;
            }
            // Packets hold one octant, so each ray goes to those of its own.
            for (i, ray) in rays.iter().enumerate() {
                let [x, y, z] = ray.map(|x| u32::from(x.is_sign_negative()));
                let key = (x | y << 1 | z << 2) << within | key & ((1 << within) - 1);
                self.items.push(key << 16 | ((bundle * k + i) as u32) << 1);
            }
        }
        self.sort_items();
        self.put_in_order(first, directions.len(), bundle);
    }

    /// Records what identifies groups similar to the one just sorted.
    #[inline(always)]
    fn keep<I: Isa>(&mut self, directions: &[Point], group: Range<usize>) {
        if group.len() < NEAR {
            return;
        }
        self.last.start = Some(group.start);
        self.last.spread = self.spread::<I>(directions);
        self.last.signs.clear();
        for eight in directions[group].as_flattened().as_chunks().0 {
            self.last.signs.push(negative::<I>(eight));
        }
    }

    /// Reuses the order of the previous group if the next one is similar, as with a rotating sensor: each ray
    /// is in the same octant, and packets are about as narrow. Only samples of the packets are checked, since
    /// an unsuitable order is slow, not wrong.
    #[inline(always)]
    fn takes_over<I: Isa>(&mut self, directions: &[Point], group: Range<usize>) -> bool {
        let Some(before) = self.last.start.filter(|_| group.len() == NEAR) else { return false };
        let mut others = 0;
        for (eight, signs) in
            directions[group.clone()].as_flattened().as_chunks().0.iter().zip(&self.last.signs)
        {
            others |= negative::<I>(eight) ^ signs;
        }
        if others != 0 {
            return false;
        }
        let step = (group.start as u32).wrapping_sub(before as u32);
        for place in &mut self.order[..NEAR] {
            *place = place.wrapping_add(step);
        }
        self.last.start = Some(group.start);
        self.spread::<I>(directions) <= 1.25 * self.last.spread
    }

    /// The sum of the squared sizes of packets, from a sample of directions; a rotation of the sensor
    /// preserves it.
    #[inline(always)]
    fn spread<I: Isa>(&self, directions: &[Point]) -> f64 {
        let mut sum = I::F64x8::splat(0.0);
        // One packet per lane.
        for packets in self.order[..NEAR].as_chunks::<{ 8 * LANES }>().0 {
            let (mut low, mut high) =
                ([I::F64x8::splat(f64::INFINITY); 3], [I::F64x8::splat(f64::NEG_INFINITY); 3]);
            for i in (0..LANES).step_by(9) {
                let d = I::columns(
                    [0, 1, 2, 3, 4, 5, 6, 7].map(|k| &directions[packets[k * LANES + i] as usize]),
                );
                for axis in 0..3 {
                    (low[axis], high[axis]) =
                        (Floats::min(d[axis], low[axis]), Floats::max(d[axis], high[axis]));
                }
            }
            for axis in 0..3 {
                let size = high[axis].sub(low[axis]);
                sum = sum.add(size.mul(size));
            }
        }
        sum.store().iter().sum()
    }

    /// Indices of the rays of the group.
    #[inline(always)]
    pub fn indices(&self) -> &[u32] {
        &self.order[..self.count]
    }

    /// Whether all rays of the group have one origin, to the bit.
    #[inline(always)]
    pub fn has_one_origin(&self) -> bool {
        self.has_one_origin
    }

    /// Finds the octant of each direction and its place on its face of |x| + |y| + |z| = 1: two 16-bit
    /// coordinates, whose minima and maxima it returns. The second, |z|, depends on the elevation. The first
    /// is (|x| − |y|)/2 + s·|z|. At the azimuth of the first ray, where (|x| − |y|)/2 = s·(1 − |z|),
    /// it depends on the azimuth alone, so that tiles are upright; it is at most 1/2, as s is. For scattered
    /// rays, s is 0.
    #[inline(always)]
    fn find_places<I: Isa>(&mut self, directions: &[Point]) -> ([u32; 2], [u32; 2]) {
        self.places.clear();
        self.octants.clear();
        let (mut low, mut high) = ([u32::MAX; 2], [0; 2]);
        let [x, y, _] = directions[0].map(f64::abs);
        let slope = (0.5 * (x - y) / (x + y)) as f32;
        let slope = if self.group == NEAR && slope.is_finite() { slope } else { 0.0 };
        for block in directions.chunks(BLOCK) {
            let d = narrow::<I>(halves::<I>(block));
            let (mut place, mut octant) = ([0; BLOCK], [0; BLOCK]);
            let (mut least, mut most) = ([[0_u32; BLOCK]; 2], [[0_u32; BLOCK]; 2]);
            for k in 0..BLOCK {
                let [x, y, z] = [d[0][k], d[1][k], d[2][k]];
                // Overflows and NaN give arbitrary keys: extreme directions only sort badly.
                let scale = 65535.0 / (x.abs() + y.abs() + z.abs());
                let u = ((0.5 * (x.abs() - y.abs()) + slope * z.abs()) * scale + 32767.5 + WHOLE).to_bits()
                    & 0xffff;
                let v = (z.abs() * scale + WHOLE).to_bits() & 0xffff;
                place[k] = u | v << 16;
                octant[k] = x.to_bits() >> 31 | y.to_bits() >> 31 << 1 | z.to_bits() >> 31 << 2;
                (least[0][k], least[1][k], most[0][k], most[1][k]) = (u, v, u, v);
            }
            for k in 0..BLOCK {
                for i in 0..2 {
                    low[i] = low[i].min(least[i][k]);
                    high[i] = high[i].max(most[i][k]);
                }
            }
            self.places.extend_from_slice(&place);
            self.octants.extend_from_slice(&octant);
        }
        self.places.truncate(directions.len());
        self.octants.truncate(directions.len());
        (low, high)
    }

    /// Makes a key of each octant and of the place on a grid over the group, whose cells are `width` times as
    /// wide as tall.
    #[inline(always)]
    fn direction_keys(&mut self, low: [u32; 2], high: [u32; 2], width: f32) {
        const END: u32 = (1 << DIRECTION) - 1;
        let widest = ((high[0] - low[0]) as f32 / width).max((high[1] - low[1]) as f32).max(1.0);
        let scale = END as f32 / widest;
        let [u0, v0] = low;
        self.keys.clear();
        self.keys.resize(self.places.len(), 0);
        for ((key, place), octant) in self.keys.iter_mut().zip(&self.places).zip(&self.octants) {
            let (u, v) = ((place & 0xffff) - u0, (place >> 16) - v0);
            let u = (u as f32 * (scale / width) + WHOLE).to_bits() & END;
            let v = (v as f32 * scale + WHOLE).to_bits() & END;
            *key = octant << (2 * DIRECTION) | spread2(u) | spread2(v) << 1;
        }
    }

    /// Whether the rays, one after the other, cross each octant once, or return to the first, as in a fan:
    /// neighbours then make the narrowest packets.
    #[inline(always)]
    fn are_a_fan(&self, low: [u32; 2], high: [u32; 2]) -> bool {
        // The path on the faces is continuous across octants.
        let (mut path, mut octants, mut changes) = (0, 1 << self.octants[0], 0);
        for (places, pair) in self.places.windows(2).zip(self.octants.windows(2)) {
            path += (places[0] & 0xffff).abs_diff(places[1] & 0xffff);
            path += (places[0] >> 16).abs_diff(places[1] >> 16);
            changes += u32::from(pair[0] != pair[1]);
            octants |= 1_u32 << pair[1];
        }
        let returns = changes > 3 && self.octants.first() == self.octants.last();
        octants.count_ones() + u32::from(returns) == changes + 1
            && path <= (changes + 1) * (high[0] - low[0] + high[1] - low[1])
    }

    /// Finds rays that are near their predecessors. Runs of them are sorted as one and gathered into the same
    /// packet.
    #[inline(always)]
    fn find_near<const LENGTH: usize>(&mut self, low: [u32; 2], high: [u32; 2], width: f32, tiles: f64) {
        let n = self.places.len();
        // The largest extent of a run, in tiles: the share of the group's area that a packet covers.
        let area =
            (f64::from(high[0] - low[0]) / f64::from(width) + 1.0) * (f64::from(high[1] - low[1]) + 1.0);
        let tile = (area * LANES as f64 / n as f64).sqrt();
        let step = tiles * tile / (LENGTH - 1) as f64;
        let (across, up) = ((f64::from(width) * step) as u32, step as u32);
        self.near.clear();
        self.near.resize(n, 0);
        let pairs = self.places.windows(2).zip(self.octants.windows(2));
        for (near, (places, octants)) in self.near[1..].iter_mut().zip(pairs) {
            let u = (places[0] & 0xffff).abs_diff(places[1] & 0xffff);
            let v = (places[0] >> 16).abs_diff(places[1] >> 16);
            *near = u32::from((u <= across) & (v <= up) & (octants[0] == octants[1]));
        }
    }

    /// Whether rays with these origins may form packets of any shape: origins are close together relative to
    /// the scene, and no rays meet objects at times of their own.
    #[inline(always)]
    fn is_together<I: Isa>(&self, origins: &[Point]) -> bool {
        !self.has_times && (self.has_one_origin || !(extent::<I>(origins).1 > self.size / CLOSE))
    }

    /// Inserts the cell of the origin between octant and direction, which becomes coarser, unless the origins
    /// are close together relative to the scene. Returns the number of bits below the octant.
    #[inline(always)]
    fn add_cells<I: Isa>(&mut self, origins: &[Point]) -> u32 {
        const FINE: u32 = 2 * DIRECTION;
        const CELLS: u32 = 1 << ORIGIN;
        if self.has_one_origin {
            return FINE;
        }
        let (low, size) = extent::<I>(origins);
        if !(size > self.size / CLOSE) {
            return FINE;
        }
        let (low, scale) = (low.map(I::F64x8::splat), I::F64x8::splat(f64::from(CELLS) / size));
        for (keys, block) in self.keys.chunks_mut(BLOCK).zip(origins.chunks(BLOCK)) {
            let mut halves = halves::<I>(block);
            for half in &mut halves {
                for i in 0..3 {
                    half[i] = half[i].sub(low[i]).mul(scale);
                }
            }
            let [x, y, z] = narrow::<I>(halves);
            let mut cells = [0; BLOCK];
            for k in 0..BLOCK {
                // Adding a half makes rounding yield the number of the cell, counted from 1.
                let cell = |x: f32| ((x + 0.5 + WHOLE).to_bits() & 0xffff).clamp(1, CELLS) - 1;
                cells[k] = spread3(cell(x[k])) | spread3(cell(y[k])) << 1 | spread3(cell(z[k])) << 2;
            }
            for (key, cell) in keys.iter_mut().zip(cells) {
                let (octant, within) = (*key >> FINE, *key & ((1 << FINE) - 1));
                *key = (octant << (3 * ORIGIN) | cell) << COARSE | within >> (FINE - COARSE);
            }
        }
        3 * ORIGIN + COARSE
    }

    /// Sorts the indices by key; the sort is stable.
    #[inline(always)]
    fn radix_sort<const LENGTH: usize>(&mut self, first: usize) {
        // An index, and a bit that distinguishes runs from single rays.
        self.items.clear();
        for (run, keys) in self.keys.chunks(LENGTH).enumerate() {
            let start = LENGTH * run;
            let whole = LENGTH == 1
                || keys.len() == LENGTH
                    && self.near[start + 1..start + LENGTH].iter().fold(1, |all, near| all & near) == 1;
            for (i, key) in keys[..if whole { 1 } else { keys.len() }].iter().enumerate() {
                self.items.push(key << 16 | ((start + i) as u32) << 1 | u32::from(whole));
            }
        }
        self.sort_items();
        self.put_in_order(first, self.keys.len(), LENGTH);
    }

    /// Sorts the items by key.
    #[inline(always)]
    fn sort_items(&mut self) {
        const DIGITS: usize = 2;
        let digit = |item: u32, k: usize| (item >> (16 + 8 * k)) as usize & 0xff;
        let mut ends = [[0_u32; 1 << 8]; DIGITS];
        for item in &self.items {
            for k in 0..DIGITS {
                ends[k][digit(*item, k)] += 1;
            }
        }
        self.sorted.clear();
        self.sorted.resize(self.items.len(), 0);
        for k in 0..DIGITS {
            // All have the same digit: already in order.
            if ends[k][digit(self.items[0], k)] as usize == self.items.len() {
                continue;
            }
            let mut sum = 0;
            for end in &mut ends[k] {
                (*end, sum) = (sum, sum + *end);
            }
            for &item in &self.items {
                let place = &mut ends[k][digit(item, k)];
                self.sorted[*place as usize] = item;
                *place += 1;
            }
            std::mem::swap(&mut self.items, &mut self.sorted);
        }
    }

    /// Puts the `count` rays from `first` on into the order of the items, of which runs have `length` rays.
    #[inline(always)]
    fn put_in_order(&mut self, first: usize, count: usize, length: usize) {
        // The next ray overwrites the excess of a run over a single ray.
        self.order.resize(count + length - 1, 0);
        let mut end = 0;
        for item in &self.items {
            let at = first as u32 + ((item & 0xffff) >> 1);
            for (i, place) in self.order[end..end + length].iter_mut().enumerate() {
                *place = at + i as u32;
            }
            end += if item & 1 != 0 { length } else { 1 };
        }
    }
}

/// The ratio of width to height of the tiles that packets of a sensor cover: it mostly sees ground, whose
/// triangles look flat from afar. If the scene moves, such a packet would have more times than a square one.
const WIDTH: f32 = 4.0;

/// Most rays of a run, which may extend across two tiles.
const RUN: usize = 4;

/// The same if the scene moves, or the origins are far apart; longer runs give a packet fewer times or
/// origins. Such a run may extend across three tiles.
const LONG_RUN: usize = 16;

/// A float32 of this size has no fraction bits: adding it rounds, and the last bits of the sum are the
/// integer.
const WHOLE: f32 = 8_388_608.0;

/// Points per block.
const BLOCK: usize = 16;

/// The coordinates of both halves of a block, by axis; the first point pads a partial block.
#[inline(always)]
fn halves<I: Isa>(block: &[Point]) -> [[I::F64x8; 3]; 2] {
    match block.first_chunk() {
        Some(block) => columns::<I>(block),
        None => {
            let mut all = [block[0]; BLOCK];
            all[..block.len()].copy_from_slice(block);
            columns::<I>(&all)
        }
    }
}

#[inline(always)]
fn columns<I: Isa>([a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p]: &[Point; BLOCK]) -> [[I::F64x8; 3]; 2] {
    [I::columns([a, b, c, d, e, f, g, h]), I::columns([i, j, k, l, m, n, o, p])]
}

/// The coordinates as float32, by axis.
#[inline(always)]
fn narrow<I: Isa>([low, high]: [[I::F64x8; 3]; 2]) -> [[f32; BLOCK]; 3] {
    [
        I::narrow(low[0], high[0]).store(),
        I::narrow(low[1], high[1]).store(),
        I::narrow(low[2], high[2]).store(),
    ]
}

/// Whether adjacent rays are incoherent, so that sorting larger groups pays off.
fn are_scattered(directions: &[Point]) -> bool {
    const SAMPLES: usize = 16;
    let n = directions.len();
    let diverges = |i: usize| {
        let (a, b) = (directions[i], directions[i + 1]);
        // More than 30°.
        dot(a, b) < 0.866 * (dot(a, a) * dot(b, b)).sqrt()
    };
    n > 1 && (0..SAMPLES).filter(|&k| diverges(sample(k, n - 1))).count() > SAMPLES / 2
}

/// The number of rays that are sorted together. Later rays of a spinning sensor are earlier ones, rotated,
/// and reuse their order, so few suffice. Other patterns, such as rosettes, get narrower packets from many.
pub fn group_size(directions: &[Point], bundle: usize) -> usize {
    // A bundle is sorted as one, so that many rays cost little.
    if bundle > 1 {
        MOST.max(bundle) / bundle * bundle
    } else if are_scattered(directions) || !are_rotated(directions) {
        MOST
    } else {
        NEAR
    }
}

/// Whether the second `NEAR` rays are about the first ones, rotated, as with a spinning sensor: the angles
/// between rays are the same. Only some are compared.
fn are_rotated(directions: &[Point]) -> bool {
    const SAMPLES: usize = 16;
    let Some((first, second)) = directions.split_at_checked(NEAR).filter(|(_, rest)| rest.len() >= NEAR)
    else {
        return true;
    };
    let cosine = |a: Point, b: Point| dot(a, b) / (dot(a, a) * dot(b, b)).sqrt();
    let differs = |k: usize| {
        let (i, j) = (sample(2 * k, NEAR), sample(2 * k + 1, NEAR));
        (cosine(first[i], first[j]) - cosine(second[i], second[j])).abs() > 1.0 / 256.0
    };
    (0..SAMPLES).filter(|&k| differs(k)).count() <= SAMPLES / 2
}

/// The index of sample k of n rays, by Knuth's multiplicative hash: equal steps might always hit the ends of
/// columns.
fn sample(k: usize, n: usize) -> usize {
    (k as u32).wrapping_mul(2_654_435_769) as usize % n
}

/// The least coordinates of points, and the longest side of the box around them.
#[inline(always)]
fn extent<I: Isa>(points: &[Point]) -> (Point, f64) {
    let (mut least, mut most) = (lanes::splat::<I::F64x8, 8>(points[0]), lanes::splat(points[0]));
    for block in points.chunks(BLOCK) {
        for half in halves::<I>(block) {
            for i in 0..3 {
                (least[i], most[i]) = (Floats::min(half[i], least[i]), Floats::max(half[i], most[i]));
            }
        }
    }
    let (mut low, mut size) = ([0.0; 3], 0.0_f64);
    for i in 0..3 {
        low[i] = least[i].smallest();
        size = size.max(most[i].largest() - low[i]);
    }
    (low, size)
}

/// Whether points are equal to the bit, or none.
#[inline(always)]
fn are_equal(points: &[Point]) -> bool {
    let Some(first) = points.first().map(|point| point.map(f64::to_bits)) else { return true };
    if points[points.len() - 1].map(f64::to_bits) != first {
        return false;
    }
    let different = points.iter().fold(0, |all, point| {
        let [x, y, z] = point.map(f64::to_bits);
        all | x ^ first[0] | y ^ first[1] | z ^ first[2]
    });
    different == 0
}

/// The sign bits of eight numbers.
#[inline(always)]
fn negative<I: Isa>(numbers: &[f64; 8]) -> u8 {
    I::F64x8::load(numbers).lt(I::F64x8::splat(0.0)) as u8
}

/// Inserts a zero between any two of the lowest 16 bits.
#[inline(always)]
fn spread2(x: u32) -> u32 {
    let x = (x | x << 8) & 0x00ff_00ff;
    let x = (x | x << 4) & 0x0f0f_0f0f;
    let x = (x | x << 2) & 0x3333_3333;
    (x | x << 1) & 0x5555_5555
}

/// Inserts two zeros between any two of the lowest 4 bits.
#[inline(always)]
fn spread3(x: u32) -> u32 {
    (x & 1) | (x & 2) << 2 | (x & 4) << 4 | (x & 8) << 6
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::arith::simd::{Level, Task, dispatch};
    use crate::testing::numbers;

    /// A rotating sensor: adjacent rays point nearly the same way.
    fn sweep(n: usize) -> Vec<Point> {
        let azimuth = |i: usize| i as f64 * 0.01;
        (0..n).map(|i| [azimuth(i).cos(), azimuth(i).sin(), 0.3 - (i % 16) as f64 * 0.04]).collect()
    }

    fn scatter(n: usize) -> Vec<Point> {
        let mut number = numbers();
        (0..n).map(|_| [0; 3].map(|_: u8| number() - 0.5)).collect()
    }

    /// Anywhere in a cube, independent of the directions.
    fn places(n: usize, side: f64) -> Vec<Point> {
        scatter(2 * n)[n..].iter().map(|p| p.map(|x| side * x)).collect()
    }

    struct All<'a>(Rays<'a>, f64);

    impl Task for All<'_> {
        type Output = Vec<Vec<u32>>;

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            let All(rays, size) = self;
            let mut groups = Vec::new();
            let mut order = RaySort::default();
            // Some earlier use.
            order.restart(&Rays::new(&[], &[[1.0, 0.0, 0.0]; 2], &[]), (1, 1.0));
            assert!(order.advance::<I>(Origins::One([0.0; 3]), &[[1.0, 0.0, 0.0]; 2]));
            order.restart(&rays, (2, size));
            while order.advance::<I>(rays.origins, rays.directions) {
                groups.push(order.indices().to_vec());
            }
            groups
        }
    }

    fn groups(origins: &[Point], directions: &[Point], size: f64) -> Vec<Vec<u32>> {
        dispatch(Level::best(), All(Rays::new(origins, directions, &[]), size))
    }

    fn octant(d: Point) -> [bool; 3] {
        d.map(|x| x < 0.0)
    }

    /// The number of octants that the rays of a group are in, each of which comes once.
    fn octants_in_turn(group: &[u32], directions: &[Point]) -> usize {
        let mut octants: Vec<_> = group.iter().map(|&i| octant(directions[i as usize])).collect();
        octants.dedup();
        let runs = octants.len();
        octants.sort_unstable();
        octants.dedup();
        assert_eq!(octants.len(), runs, "an octant comes twice");
        runs
    }

    #[test]
    fn gives_each_ray_once_and_octants_together() {
        for n in [0, 1, 2, 15, 16, 17, 1023, 1024, 1025, 65_535, 65_536, 65_537, 70_000] {
            for (directions, near) in [(sweep(n), true), (scatter(n), false)] {
                let groups = groups(&places(n, 100.0), &directions, 100.0);
                let most = if near { NEAR } else { MOST };
                assert_eq!(groups.len(), n.div_ceil(most), "{n}");
                let mut start = 0;
                for group in groups {
                    let mut all = group.clone();
                    all.sort_unstable();
                    let end = n.min(start + most);
                    assert!(all.into_iter().eq(start as u32..end as u32));
                    let runs = octants_in_turn(&group, &directions);
                    assert!(runs > 1 || end - start < 100);
                    start = end;
                }
            }
        }
    }

    /// Seven rays about each of these directions.
    fn bundles(axes: &[Point]) -> Vec<Point> {
        let around = |axis: &Point| {
            let [x, y, z] = *axis;
            (0..7).map(move |k| if k == 0 { [x, y, z] } else { [x, y + 1e-3 * f64::from(k - 3), z - 1e-3] })
        };
        axes.iter().flat_map(around).collect()
    }

    /// A sensor that turns and one that looks anywhere; some rays look up where the others of their bundle
    /// look down, or left and right.
    #[test]
    fn bundles_stay_together_but_for_rays_of_other_octants() {
        for (n, near) in [(1, true), (3, false), (1170, true), (1171, true), (5000, true), (5000, false)] {
            let axes = if near { sweep(n) } else { scatter(n) };
            let directions = bundles(&axes);
            for far in [0.0, 100.0] {
                let starts: Vec<Point> = places(n, far).iter().flat_map(|start| [*start; 7]).collect();
                let rays = Rays { bundle: 7, ..Rays::new(&starts, &directions, &[]) };
                let groups = dispatch(Level::best(), All(rays, 100.0));
                assert_eq!(groups.len(), n.div_ceil(MOST / 7));
                for group in &groups {
                    octants_in_turn(group, &directions);
                }
                let order = groups.concat();
                let mut all = order.clone();
                all.sort_unstable();
                assert!(all.into_iter().eq(0..7 * n as u32));
                let is_whole = |k: usize| {
                    directions[7 * k..][..7].iter().all(|ray| octant(*ray) == octant(directions[7 * k]))
                };
                let (mut whole, mut at) = (0, 0);
                while at < order.len() {
                    let (k, rest) = (order[at] as usize / 7, order[at] % 7);
                    if is_whole(k) {
                        assert!(rest == 0 && order[at..at + 7].windows(2).all(|pair| pair[1] == pair[0] + 1));
                        whole += 1;
                    }
                    at += if is_whole(k) { 7 } else { 1 };
                }
                assert!(n < 100 || whole > n / 2 && whole < n, "{whole} of {n}");
            }
        }
    }

    /// Fired a column at a time, packets in the order of the sensor are tall and narrow; in tiles they are
    /// smaller.
    #[test]
    fn packets_of_bundles_are_tiles() {
        let direction = |i: usize| {
            let (azimuth, elevation) = (0.006 * (i / 128) as f64 + 0.2, 0.006 * (i % 128) as f64 + 0.1);
            [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()]
        };
        let directions = bundles(&(0..128 * 32).map(direction).collect::<Vec<_>>());
        let starts = vec![[0.0; 3]; directions.len()];
        let rays = Rays { bundle: 7, ..Rays::new(&starts, &directions, &[]) };
        let order = dispatch(Level::best(), All(rays, 100.0)).concat();
        let given: Vec<u32> = (0..directions.len() as u32).collect();
        let [size, before] = [order, given].map(|order| mean_size(&order, &directions));
        assert!(size < before, "{size}, {before}");
    }

    /// A packet of square tiles covers eight columns of this sensor.
    #[test]
    fn packets_have_few_times_if_the_scene_moves() {
        let direction = |i: usize| {
            let (azimuth, elevation) = (0.006 * (i / 128) as f64, 0.006 * (i % 128) as f64 - 0.4);
            [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()]
        };
        let directions: Vec<Point> = (0..128 * 128).map(direction).collect();
        let origins = vec![[0.0; 3]; directions.len()];
        let times =
            |packet: &[u32]| packet.iter().map(|i| i / 128).collect::<std::collections::BTreeSet<_>>().len();
        let each: Vec<f64> = (0..directions.len()).map(|i| (i / 128) as f64).collect();
        let [few, more] = [&each[..], &[]].map(|times_of_rays| {
            let rays = Rays::new(&origins, &directions, times_of_rays);
            let order = dispatch(Level::best(), All(rays, 100.0)).concat();
            order.chunks(LANES).map(times).sum::<usize>() as f64 / (order.len() / LANES) as f64
        });
        assert!(few < 6.5 && more > 7.5, "{few}, {more}");
    }

    /// A rosette: two prisms that turn at different rates.
    #[test]
    fn rosettes_are_sorted_in_large_groups_and_turns_in_small_ones() {
        let rosette = |i: usize| {
            let (a, b) = (0.61 * i as f64, -0.39 * i as f64 + 0.3);
            [1.0, 0.3 * (a.cos() + b.cos()), 0.3 * (a.sin() + b.sin())]
        };
        for n in [0, 1, 2, NEAR, 2 * NEAR - 1, 2 * NEAR, 9 * NEAR] {
            let rosette: Vec<Point> = (0..n).map(rosette).collect();
            assert_eq!(group_size(&rosette, 1), if n < 2 * NEAR { NEAR } else { MOST }, "{n}");
            assert_eq!(group_size(&sweep(n), 1), NEAR, "{n}");
            assert_eq!(group_size(&scatter(n), 1), if n < 2 { NEAR } else { MOST }, "{n}");
        }
    }

    /// A plane of rays through four quadrants and all round, level and tilted, and two rings at once.
    #[test]
    fn fans_keep_their_order_and_rings_are_sorted() {
        let ring = |n: usize, turn: f64, slope: f64, lift: f64| {
            let azimuth = move |i: usize| turn * i as f64 / n as f64 - 2.3;
            (0..n).map(move |i| [azimuth(i).cos(), azimuth(i).sin(), slope * azimuth(i).cos() + lift])
        };
        for n in [1, 20, 541, NEAR] {
            for turn in [4.7, TAU] {
                for (slope, lift) in [(0.0, 0.0), (0.3, 0.0), (0.0, 0.2)] {
                    let fan: Vec<Point> = ring(n, turn, slope, lift).collect();
                    assert_eq!(groups(&vec![[0.0; 3]; n], &fan, 1.0), [(0..n as u32).collect::<Vec<_>>()]);
                }
            }
        }
        let rings: Vec<Point> =
            ring(270, 4.7, 0.0, 0.2).zip(ring(270, 4.7, 0.0, 0.4)).flat_map(<[_; 2]>::from).collect();
        let order = groups(&[[0.0; 3]; 540], &rings, 1.0).concat();
        assert!(octants_in_turn(&order, &rings) == 4 && !order.is_sorted());
    }

    /// The mean diagonal of the boxes around the directions of packets.
    fn mean_size(order: &[u32], directions: &[Point]) -> f64 {
        let size = |packet: &[u32]| {
            let sides = [0, 1, 2].map(|axis| {
                let along = packet.iter().map(|&i| directions[i as usize][axis]);
                along.clone().fold(f64::MIN, f64::max) - along.fold(f64::MAX, f64::min)
            });
            sides.iter().map(|side| side.powi(2)).sum::<f64>().sqrt()
        };
        order.chunks(LANES).map(size).sum::<f64>() / order.len().div_ceil(LANES) as f64
    }

    /// A sensor that turns once, with its rings then in another order, and then looks anywhere; it moves once
    /// in between. Similar groups share one order, and packets are as small as if each group were sorted
    /// alone.
    #[test]
    fn an_order_is_taken_over_by_groups_that_are_like_it() {
        let mut number = numbers();
        let mut direction = |i: usize| {
            let (column, ring) = (i / 128, i % 128);
            let (ring, azimuth) = match column {
                ..1024 => (ring, 0.0061 * column as f64),
                1024..1152 => (37 * ring % 128, 0.0061 * (column - 1023) as f64),
                _ => ((128.0 * number()) as usize, 0.1 + number()),
            };
            let elevation = 0.006 * ring as f64 + 0.1;
            [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()]
        };
        let directions: Vec<Point> = (0..1280 * 128).map(&mut direction).collect();
        let mut origins = vec![[0.0; 3]; directions.len()];
        for (i, origin) in origins[135 * NEAR..136 * NEAR].iter_mut().enumerate() {
            origin[0] = i as f64 * 1e-6;
        }
        let together = groups(&origins, &directions, 100.0);
        let mut taken_over = 0;
        for (k, group) in together.iter().enumerate() {
            let first = NEAR * k;
            let mut all = group.clone();
            all.sort_unstable();
            assert!(all.into_iter().eq(first as u32..(first + NEAR) as u32));
            let relative =
                |group: &[u32], first: usize| group.iter().map(|i| i - first as u32).collect::<Vec<_>>();
            let part = first..first + NEAR;
            let alone = groups(&origins[part.clone()], &directions[part], 100.0).concat();
            let [found, expected] = [group, &alone.iter().map(|i| i + first as u32).collect()];
            let [size, least] = [found, expected].map(|order| mean_size(order, &directions));
            assert!(size <= 1.2 * least, "{k}: {size}, {least}");
            taken_over +=
                usize::from(k > 0 && relative(group, first) == relative(&together[k - 1], first - NEAR));
        }
        assert!((100..140).contains(&taken_over), "{taken_over}");
    }

    /// Between two groups of one origin there is one whose origins are far apart, as of a sensor that jumps.
    #[test]
    fn an_order_is_not_taken_over_across_another_group() {
        let direction = |i: usize| [1.0, 0.1 + 0.001 * (i % NEAR) as f64, 0.1 + 0.01 * (i % 16) as f64];
        let directions: Vec<Point> = (0..3 * NEAR).map(direction).collect();
        let mut origins = vec![[0.0; 3]; 3 * NEAR];
        origins[NEAR..2 * NEAR].copy_from_slice(&places(NEAR, 100.0));
        for (k, mut group) in groups(&origins, &directions, 100.0).into_iter().enumerate() {
            group.sort_unstable();
            assert!(group.into_iter().eq((NEAR * k) as u32..(NEAR * (k + 1)) as u32), "{k}");
        }
    }

    /// The orders of consecutive pieces of rays of one origin, each cast at a world.
    struct Pieces<'a, const N: usize>([&'a [Point]; N], [u64; N]);

    impl<const N: usize> Task for Pieces<'_, N> {
        type Output = [Vec<u32>; N];

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            let Pieces(pieces, worlds) = self;
            let mut order = RaySort::default();
            std::array::from_fn(|k| {
                order.restart(&Rays::new(&[], pieces[k], &[]), (worlds[k], 100.0));
                assert!(order.advance::<I>(Origins::One([0.0; 3]), pieces[k]));
                order.indices().to_vec()
            })
        }
    }

    #[test]
    fn an_order_is_taken_over_by_other_rays_at_the_same_world() {
        let direction = |i: usize| {
            let (azimuth, elevation) = (0.0061 * (i / 128) as f64 + 0.2, 0.006 * (i % 128) as f64 + 0.1);
            [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()]
        };
        let directions: Vec<Point> = (0..20 * NEAR).map(direction).collect();
        let pieces = [&directions[..NEAR], &directions[19 * NEAR..]];
        let alone = pieces.map(|piece| groups(&[[0.0; 3]; NEAR], piece, 100.0).concat());
        assert_ne!(alone[0], alone[1]);
        let orders = |worlds| dispatch(Level::best(), Pieces(pieces, worlds));
        assert_eq!(orders([7, 7]), [alone[0].clone(), alone[0].clone()]);
        assert_eq!(orders([7, 8]), alone);
        // Rays in other groups in between leave another order.
        let others = scatter(NEAR);
        let pieces = [&directions[..NEAR], &others, &directions[19 * NEAR..]];
        let [first, _, last] = dispatch(Level::best(), Pieces(pieces, [7; 3]));
        assert_eq!([first, last], alone);
    }

    #[test]
    fn neighbours_point_the_same_way() {
        let directions = scatter(70_000);
        assert!(are_scattered(&directions) && !are_scattered(&sweep(70_000)));
        for far in [0.0, 100.0] {
            let origins = places(70_000, far);
            let order = groups(&origins, &directions, 100.0).concat();
            let sorted: Vec<Point> = order.iter().map(|&i| directions[i as usize]).collect();
            assert!(!are_scattered(&sorted));
            // If origins differ, they are close to each other, too: below the mean distance in a cube, 0.66
            // of its side.
            let step = |pair: &[u32]| {
                let [a, b] = [pair[0], pair[1]].map(|i| origins[i as usize]);
                (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
            };
            let mean = order.windows(2).map(step).sum::<f64>() / order.len() as f64;
            assert!(mean <= 0.2 * far, "{mean}");
        }
    }

    #[test]
    fn one_origin_is_one_to_the_bit() {
        for n in [1, 2, 9, NEAR] {
            for origin in [[1.0, -2.0, 0.0], [f64::NAN; 3]] {
                let mut origins = vec![origin; n];
                assert!(are_equal(&origins));
                for i in (1..n).step_by(7) {
                    for axis in 0..3 {
                        origins[i][axis] = -origin[axis];
                        assert!(!are_equal(&origins), "{i} of {n}");
                        origins[i] = origin;
                    }
                }
            }
        }
    }

    #[test]
    fn equal_rays_keep_their_order() {
        let few = scatter(7);
        let turning = |n: usize| (0..n).map(|i| few[i / 100 % 7]).collect::<Vec<_>>();
        let mixed = |n: usize| (0..n).map(|i| few[i * i % 7]).collect::<Vec<_>>();
        for directions in [turning(1024), turning(5000), mixed(5000), mixed(70_000)] {
            for group in groups(&vec![[1.0; 3]; directions.len()], &directions, 1.0) {
                for kind in &few {
                    let equal: Vec<u32> =
                        group.iter().copied().filter(|&i| directions[i as usize] == *kind).collect();
                    assert!(equal.is_sorted());
                }
            }
        }
    }

    #[test]
    fn no_ray_is_lost_for_what_it_holds() {
        let odd = [
            f64::NAN,
            -f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            0.0,
            -0.0,
            5e-324,
            -1e-300,
            1e300,
            f64::MAX,
        ];
        for n in [1, 17, 1025, 5000] {
            for near in [true, false] {
                let mut number = numbers();
                let (mut origins, mut directions) = (scatter(n), if near { sweep(n) } else { scatter(n) });
                for i in (0..n).step_by(3) {
                    let v = if i % 2 == 0 { &mut origins[i] } else { &mut directions[i] };
                    *v = v.map(|x| if number() < 0.7 { odd[(10.0 * number()) as usize] } else { x });
                }
                directions[n / 2] = [0.0; 3];
                directions[0] = [f64::NAN; 3];
                for size in [0.0, 1.0, f64::INFINITY, f64::NAN] {
                    let mut all = groups(&origins, &directions, size).concat();
                    all.sort_unstable();
                    assert!(all.into_iter().eq(0..n as u32));
                }
            }
        }
    }
}
