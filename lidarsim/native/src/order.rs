//! An order of rays in which neighbours point the same way and start near each other.

use crate::scene::Scene;
use crate::vector::Point;

/// Fewer rays than this stay in their order: there is little to gain from sorting them.
const WORTHWHILE: usize = 64;

/// Bits of a key for the direction within its octant, an axis, and for the origin, an axis.
const DIRECTION: u32 = 9;
const ORIGIN: u32 = 4;

/// Indices of the rays, sorted by octant, by the cell of the origin where origins differ, and by direction along a Z-curve, so that tiles of
/// directions stay together.
#[inline(always)]
pub fn coherent_order(scene: &Scene, origins: &[Point], directions: &[Point]) -> Vec<u32> {
    let order: Vec<u32> = (0..directions.len() as u32).collect();
    if directions.len() < WORTHWHILE {
        return order;
    }
    let keys = direction_keys(directions);
    match cells(scene, origins) {
        None => radix_sort(order, &keys, 2 * DIRECTION + 3),
        Some(cell) => {
            // Coarser directions, below the cell; the octant stays on top.
            let keys: Vec<u32> = keys
                .iter()
                .zip(origins)
                .map(|(key, o)| {
                    let (octant, within) = (key >> (2 * DIRECTION), key & ((1 << (2 * DIRECTION)) - 1));
                    (octant << (3 * ORIGIN) | cell(o)) << 12 | within >> (2 * DIRECTION - 12)
                })
                .collect();
            radix_sort(order, &keys, 3 + 3 * ORIGIN + 12)
        }
    }
}

/// Of each direction the octant, and a place on its face of the octahedron |x| + |y| + |z| = 1.
#[inline(always)]
fn direction_keys(directions: &[Point]) -> Vec<u32> {
    const BLOCK: usize = 16;
    /// A float32 of this size has no bits behind the point: to add it is to round, and the sum's last bits are the integer.
    const WHOLE: f32 = 8_388_608.0;
    let most = (1_u32 << DIRECTION) - 1;
    let mut keys = Vec::with_capacity(directions.len() + BLOCK);
    for block in directions.chunks(BLOCK) {
        let mut d = [[1.0_f32; BLOCK]; 3];
        for (k, v) in block.iter().enumerate() {
            for i in 0..3 {
                d[i][k] = v[i] as f32;
            }
        }
        let mut key = [0; BLOCK];
        for k in 0..BLOCK {
            let [x, y, z] = [d[0][k], d[1][k], d[2][k]];
            // What overflows or is no number gives some key: extreme directions only sort badly.
            let scale = most as f32 / (x.abs() + y.abs() + z.abs());
            let (u, v) = ((x.abs() * scale + WHOLE).to_bits() & most, (y.abs() * scale + WHOLE).to_bits() & most);
            let octant = x.to_bits() >> 31 | y.to_bits() >> 31 << 1 | z.to_bits() >> 31 << 2;
            key[k] = octant << (2 * DIRECTION) | spread2(u) | spread2(v) << 1;
        }
        keys.extend_from_slice(&key);
    }
    keys.truncate(directions.len());
    keys
}

/// A function that numbers the cells of a grid over the origins; none if these are close together, against the size of the scene.
#[inline(always)]
fn cells(scene: &Scene, origins: &[Point]) -> Option<impl Fn(&Point) -> u32> {
    if origins.iter().all(|o| *o == origins[0]) {
        return None;
    }
    let (mut low, mut high) = (origins[0], origins[0]);
    for o in origins {
        for i in 0..3 {
            low[i] = low[i].min(o[i]);
            high[i] = high[i].max(o[i]);
        }
    }
    let size = (0..3).fold(0.0_f64, |m, i| m.max(high[i] - low[i]));
    if !(size > scene.size() / 64.0) {
        return None;
    }
    let scale = f64::from(1_u32 << ORIGIN) / size;
    let most = (1 << ORIGIN) - 1;
    Some(move |o: &Point| {
        let cell = |i: usize| (((o[i] - low[i]) * scale) as u32).min(most);
        spread3(cell(0)) | spread3(cell(1)) << 1 | spread3(cell(2)) << 2
    })
}

/// A zero between any two of the lowest 16 bits.
#[inline(always)]
fn spread2(x: u32) -> u32 {
    let x = (x | x << 8) & 0x00ff_00ff;
    let x = (x | x << 4) & 0x0f0f_0f0f;
    let x = (x | x << 2) & 0x3333_3333;
    (x | x << 1) & 0x5555_5555
}

/// Two zeros between any two of the lowest 4 bits.
#[inline(always)]
fn spread3(x: u32) -> u32 {
    (x & 1) | (x & 2) << 2 | (x & 4) << 4 | (x & 8) << 6
}

/// Sorts indices by their keys of so many bits; equal keys keep their order.
#[inline(always)]
fn radix_sort(mut order: Vec<u32>, keys: &[u32], bits: u32) -> Vec<u32> {
    const DIGIT: u32 = 11;
    let mut sorted = vec![0; order.len()];
    for shift in (0..bits).step_by(DIGIT as usize) {
        let digit = |i: u32| (keys[i as usize] >> shift) as usize & ((1 << DIGIT) - 1);
        let mut ends = [0_u32; 1 << DIGIT];
        for &i in &order {
            ends[digit(i)] += 1;
        }
        let mut sum = 0;
        for end in &mut ends {
            (*end, sum) = (sum, sum + *end);
        }
        for &i in &order {
            let place = &mut ends[digit(i)];
            sorted[*place as usize] = i;
            *place += 1;
        }
        std::mem::swap(&mut order, &mut sorted);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sorts_stably() {
        let keys: Vec<u32> = (0..5000_u32).map(|i| i.wrapping_mul(2654435761) >> 12).collect();
        let order = radix_sort((0..5000).collect(), &keys, 20);
        let mut expected: Vec<u32> = (0..5000).collect();
        expected.sort_by_key(|&i| keys[i as usize]);
        assert_eq!(order, expected);
    }
}
