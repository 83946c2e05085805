//! A portable implementation on arrays.

use super::{DISTANCE_MASK, FRACTION_MASK, Floats, Isa, LaneTask, ONE, PLACE, Task};

#[derive(Clone, Copy)]
pub struct Portable;

impl Isa for Portable {
    type F32x8 = [f32; 8];
    type F32x16 = [f32; 16];
    type F64x8 = [f64; 8];
    type Masks = [u64; 8];

    #[inline(always)]
    fn fraction<const FIRST: u32>(x: &[u64; 8]) -> [f64; 8] {
        x.map(|x| {
            let placed = if FIRST < PLACE { x << (PLACE - FIRST) } else { x >> (FIRST - PLACE) };
            f64::from_bits(placed & FRACTION_MASK | ONE)
        })
    }

    #[inline(always)]
    fn fused(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }

    #[inline(always)]
    fn narrow(low: [f64; 8], high: [f64; 8]) -> [f32; 16] {
        std::array::from_fn(|i| (if i < 8 { low[i] } else { high[i - 8] }) as f32)
    }

    #[inline(always)]
    fn columns(points: [&[f64; 3]; 8]) -> [[f64; 8]; 3] {
        std::array::from_fn(|axis| points.map(|point| point[axis]))
    }

    #[inline(always)]
    fn columns_of_runs([[a, b, c, d], [e, f, g, h]]: [&[[f64; 3]; 4]; 2]) -> [[f64; 8]; 3] {
        Self::columns([a, b, c, d, e, f, g, h])
    }

    #[inline(always)]
    fn deinterleaved(points: [[f64; 8]; 3]) -> [[f64; 8]; 3] {
        std::array::from_fn(|axis| std::array::from_fn(|k| points[(3 * k + axis) / 8][(3 * k + axis) % 8]))
    }

    #[inline(always)]
    fn interleaved(columns: [[f64; 8]; 3]) -> [[f64; 8]; 3] {
        std::array::from_fn(|i| std::array::from_fn(|k| columns[(8 * i + k) % 3][(8 * i + k) / 3]))
    }

    #[inline(always)]
    fn by_distance(near: [f32; 8], far: [f32; 8], what: &[u32; 8]) -> (usize, [f32; 8], [u32; 8]) {
        let (mut count, mut distances, mut sorted) = (0, [0.0; 8], [0; 8]);
        for i in 0..8 {
            if near[i] <= far[i] {
                let distance = f32::from_bits(near[i].to_bits() & DISTANCE_MASK);
                let mut k = count;
                while k > 0 && distances[k - 1] < distance {
                    (distances[k], sorted[k]) = (distances[k - 1], sorted[k - 1]);
                    k -= 1;
                }
                (distances[k], sorted[k]) = (distance, what[i]);
                count += 1;
            }
        }
        (count, distances, sorted)
    }

    #[inline(always)]
    fn no_masks() -> [u64; 8] {
        [0; 8]
    }

    #[inline(always)]
    fn mark(masks: [u64; 8], near: [f32; 8], far: [f32; 8], bit: u64) -> [u64; 8] {
        std::array::from_fn(|i| if near[i] <= far[i] { masks[i] | bit } else { masks[i] })
    }

    #[inline(always)]
    fn masks(masks: [u64; 8]) -> [u64; 8] {
        masks
    }

    #[inline(always)]
    fn pick(lanes: u32, then: [f64; 8], otherwise: [f64; 8]) -> [f64; 8] {
        std::array::from_fn(|i| if lanes & 1 << i != 0 { then[i] } else { otherwise[i] })
    }

    #[inline(always)]
    fn put(lanes: u32, number: u32, places: &mut [u32; 8]) {
        for (i, place) in places.iter_mut().enumerate() {
            *place = if lanes & 1 << i != 0 { number } else { *place };
        }
    }

    #[inline(always)]
    fn prefetch<T>(_: *const T) {}

    #[inline(never)]
    fn call<T: Task>(task: T) -> T::Output {
        task.run::<Portable>()
    }

    #[inline(always)]
    fn call_widest<T: LaneTask>(_: T) -> Option<T::Output> {
        None
    }
}

macro_rules! arrays {
    ($float:ty, $n:literal) => {
        impl Floats<$float, $n> for [$float; $n] {
            #[inline(always)]
            fn splat(x: $float) -> Self {
                [x; $n]
            }
            #[inline(always)]
            fn load(x: &[$float; $n]) -> Self {
                *x
            }
            #[inline(always)]
            fn store(self) -> [$float; $n] {
                self
            }
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                std::array::from_fn(|i| self[i] + other[i])
            }
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                std::array::from_fn(|i| self[i] - other[i])
            }
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                std::array::from_fn(|i| self[i] * other[i])
            }
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                std::array::from_fn(|i| self[i] / other[i])
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.map(<$float>::sqrt)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.map(<$float>::abs)
            }
            #[inline(always)]
            fn negated(self) -> Self {
                self.map(|x| -x)
            }
            #[inline(always)]
            fn mul_add(self, b: Self, c: Self) -> Self {
                std::array::from_fn(|i| self[i].mul_add(b[i], c[i]))
            }
            #[inline(always)]
            fn fused(self, b: Self, c: Self) -> Self {
                std::array::from_fn(|i| self[i] * b[i] + c[i])
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                std::array::from_fn(|i| if self[i] > other[i] { self[i] } else { other[i] })
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                std::array::from_fn(|i| if self[i] < other[i] { self[i] } else { other[i] })
            }
            #[inline(always)]
            fn le(self, other: Self) -> u32 {
                (0..$n).fold(0, |mask, i| mask | u32::from(self[i] <= other[i]) << i)
            }
            #[inline(always)]
            fn lt(self, other: Self) -> u32 {
                (0..$n).fold(0, |mask, i| mask | u32::from(self[i] < other[i]) << i)
            }
            #[inline(always)]
            fn largest(self) -> $float {
                self.into_iter().fold(<$float>::NEG_INFINITY, <$float>::max)
            }
            #[inline(always)]
            fn smallest(self) -> $float {
                self.into_iter().fold(<$float>::INFINITY, <$float>::min)
            }
            #[inline(always)]
            fn le_pick(self, other: Self, then: Self, otherwise: Self) -> Self {
                std::array::from_fn(|i| if self[i] <= other[i] { then[i] } else { otherwise[i] })
            }
        }
    };
}

arrays!(f32, 8);
arrays!(f32, 16);
arrays!(f64, 8);

/// A single float, for arithmetic over any number of lanes.
impl Floats<f64, 1> for f64 {
    #[inline(always)]
    fn splat(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn load(x: &[f64; 1]) -> Self {
        x[0]
    }
    #[inline(always)]
    fn store(self) -> [f64; 1] {
        [self]
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self + other
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self - other
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self * other
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self / other
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    #[inline(always)]
    fn negated(self) -> Self {
        -self
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        f64::mul_add(self, b, c)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        u32::from(self <= other)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        u32::from(self < other)
    }
    #[inline(always)]
    fn le_pick(self, other: Self, then: Self, otherwise: Self) -> Self {
        if self <= other { then } else { otherwise }
    }
    #[inline(always)]
    fn fused(self, b: Self, c: Self) -> Self {
        self * b + c
    }
    #[inline(always)]
    fn largest(self) -> f64 {
        self
    }
    #[inline(always)]
    fn smallest(self) -> f64 {
        self
    }
}
