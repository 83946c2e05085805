//! SIMD registers of floats: one trait, and one implementation per instruction set.
//!
//! Algorithms are written once, over [`Isa`], as functions that are always inlined; [`dispatch`] compiles
//! them for each instruction set and picks one at run time. Only these files use processor-specific code.

mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use portable::Portable;

/// N floats with element-wise operations.
pub trait Floats<T, const N: usize>: Copy {
    fn splat(x: T) -> Self;
    fn load(x: &[T; N]) -> Self;
    fn store(self) -> [T; N];
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    fn negated(self) -> Self;
    /// self·b + c, rounded once.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// self·b + c, rounded once or twice, whichever is faster.
    fn fused(self, b: Self, c: Self) -> Self;
    /// The larger; `other` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// The smaller; `other` where either is NaN.
    fn min(self, other: Self) -> Self;
    /// Mask of the lanes in which self ≤ other; clear where one is NaN.
    fn le(self, other: Self) -> u32;
    /// Mask of the lanes in which self < other; clear where one is NaN.
    fn lt(self, other: Self) -> u32;
    /// The largest lane; no lane may be NaN.
    fn largest(self) -> T;
    /// The smallest lane; no lane may be NaN.
    fn smallest(self) -> T;
    /// `then` where self ≤ other, else `otherwise`.
    fn le_pick(self, other: Self, then: Self, otherwise: Self) -> Self;
    /// Runs an operation. On x86 it is compiled for the instruction set by itself and then inlined.
    #[inline(always)]
    fn run<O: Operation>(operation: O) -> O::Output {
        operation.run()
    }
}

/// Steps on registers that many formulas have in common: an always inlined `run`.
pub trait Operation {
    type Output;
    fn run(self) -> Self::Output;
}

/// Declares functions over registers `F` of N lanes, each as an [`Operation`]. The compiler simplifies it
/// once and then inlines it; what is always inlined, it simplifies anew in each formula.
macro_rules! operations {
    ($(
        $(#[$about:meta])*
        $visibility:vis fn $name:ident($($input:ident: $of:ty),+) -> $output:ty $steps:block
    )+) => {
        $(
            $(#[$about])*
            #[inline(always)]
            $visibility fn $name<F: Floats<f64, N>, const N: usize>($($input: $of),+) -> $output {
                struct Inputs<F, const N: usize>($($of),+);

                impl<F: Floats<f64, N>, const N: usize> $crate::arith::simd::Operation for Inputs<F, N> {
                    type Output = $output;

                    #[inline(always)]
                    fn run(self) -> $output {
                        let Inputs($($input),+) = self;
                        $steps
                    }
                }

                F::run(Inputs($($input),+))
            }
        )+
    };
}

pub(crate) use operations;

/// Bits of the integers that [`Isa::fraction`] converts.
pub const FRACTION: u32 = 21;

/// Their shift within a float64, to the top of its 52 fraction bits.
const PLACE: u32 = 52 - FRACTION;

/// The fraction bits, and the bits of 1.
const FRACTION_MASK: u64 = ((1 << FRACTION) - 1) << PLACE;
const ONE: u64 = 1.0_f64.to_bits();

/// The bits of a float32 without its sign and its last three bits, which hold the lane number during sorting.
const DISTANCE_MASK: u32 = 0x7fff_fff8;

/// An instruction set.
pub trait Isa: Copy {
    type F32x8: Floats<f32, 8>;
    type F32x16: Floats<f32, 16>;
    type F64x8: Floats<f64, 8>;
    /// Eight 64-bit masks.
    type Masks: Copy;

    /// 1 + k/2²¹, with k the 21 bits from bit `FIRST` on.
    fn fraction<const FIRST: u32>(x: &[u64; 8]) -> Self::F64x8;
    /// a·b + c, rounded once or twice, whichever is faster.
    fn fused(a: f64, b: f64, c: f64) -> f64;
    /// Both halves, rounded to float32.
    fn narrow(low: Self::F64x8, high: Self::F64x8) -> Self::F32x16;
    /// The coordinates of eight points, by axis.
    fn columns(points: [&[f64; 3]; 8]) -> [Self::F64x8; 3];
    /// As `columns`, for two runs of adjacent points.
    fn columns_of_runs(runs: [&[[f64; 3]; 4]; 2]) -> [Self::F64x8; 3];
    /// As `columns`, for points given as consecutive coordinates.
    fn deinterleaved(points: [Self::F64x8; 3]) -> [Self::F64x8; 3];
    /// The inverse of `deinterleaved`.
    fn interleaved(columns: [Self::F64x8; 3]) -> [Self::F64x8; 3];
    /// Selects the distances with `near` ≤ `far` and sorts them with their payloads, farthest first.
    /// Returns their number, the distances with the last three bits rounded down, and the payloads; the rest
    /// of the arrays is unspecified. No distance may be negative.
    fn by_distance(near: Self::F32x8, far: Self::F32x8, what: &[u32; 8]) -> (usize, [f32; 8], [u32; 8]);
    /// Eight empty masks.
    fn no_masks() -> Self::Masks;
    /// Sets a bit in the masks where `near` ≤ `far`.
    fn mark(masks: Self::Masks, near: Self::F32x8, far: Self::F32x8, bit: u64) -> Self::Masks;
    fn masks(masks: Self::Masks) -> [u64; 8];
    /// `then` in these lanes, `otherwise` elsewhere.
    fn pick(lanes: u32, then: Self::F64x8, otherwise: Self::F64x8) -> Self::F64x8;
    /// Writes a number to the places of these lanes.
    fn put(lanes: u32, number: u32, places: &mut [u32; 8]);
    /// Prefetches the cache line of `address`.
    fn prefetch<T>(address: *const T);
    /// Runs the task out of line, in a function compiled for this instruction set: code with several callers
    /// is compiled once, and no function becomes too large.
    fn call<T: Task>(task: T) -> T::Output;
    /// Runs the task with the widest registers, out of line and never inlined. `None` if registers have a
    /// single lane.
    fn call_widest<T: LaneTask>(task: T) -> Option<T::Output>;
}

/// The coordinates of consecutive points, by axis.
#[inline(always)]
pub fn load_points<I: Isa>(points: &[[f64; 3]; 8]) -> [I::F64x8; 3] {
    let (registers, _) = points.as_flattened().as_chunks();
    I::deinterleaved([
        I::F64x8::load(&registers[0]),
        I::F64x8::load(&registers[1]),
        I::F64x8::load(&registers[2]),
    ])
}

/// The inverse of `load_points`.
#[inline(always)]
pub fn store_points<I: Isa>(columns: [I::F64x8; 3], places: &mut [f64; 24]) {
    for (places, register) in places.as_chunks_mut().0.iter_mut().zip(I::interleaved(columns)) {
        *places = register.store();
    }
}

/// Prefetches a value that may straddle two cache lines.
#[inline(always)]
pub fn prefetch_across<I: Isa, T>(value: &T) {
    let start: *const u8 = std::ptr::from_ref(value).cast();
    I::prefetch(start);
    I::prefetch(start.wrapping_add(size_of::<T>() - 1));
}

/// A function that is generic over the instruction set: an always inlined `run`. `Isa::call` compiles it once
/// for all of its callers.
///
/// Work that is done once per packet, object or batch should be a task. Inlined into a loop, it would hardly
/// be faster, and the time to compile a function grows faster than its length.
pub trait Task {
    type Output;
    fn run<I: Isa>(self) -> Self::Output;
}

/// A function that is generic over registers of N lanes: an always inlined `run`.
pub trait LaneTask {
    type Output;
    fn run<F: Floats<f64, N>, const N: usize>(self) -> Self::Output;
}

/// The instruction sets, each a superset of those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    Scalar,
    Avx2,
    Avx512,
}

impl Level {
    pub const ALL: [Level; 3] = [Level::Scalar, Level::Avx2, Level::Avx512];

    pub fn name(self) -> &'static str {
        match self {
            Level::Scalar => "scalar",
            Level::Avx2 => "avx2",
            Level::Avx512 => "avx512",
        }
    }

    /// The best level of this machine.
    #[cfg(target_arch = "x86_64")]
    pub fn best() -> Level {
        if !(is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")) {
            Level::Scalar
        } else if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw")
        {
            Level::Avx512
        } else {
            Level::Avx2
        }
    }

    /// The best level of this machine.
    #[cfg(not(target_arch = "x86_64"))]
    pub fn best() -> Level {
        Level::Scalar
    }

    /// The levels of this machine.
    #[cfg(test)]
    pub fn available() -> impl Iterator<Item = Level> {
        Level::ALL.into_iter().filter(|level| *level <= Level::best())
    }

    /// The level with this name.
    pub fn from_name(name: &str) -> Option<Level> {
        Level::ALL.into_iter().find(|level| level.name() == name)
    }
}

/// Runs tasks compiled for one instruction set, which the machine must support.
pub trait Runner: Sync {
    fn run<T: Task>(task: T) -> T::Output;
}

/// Any machine.
pub struct OnPortable;

/// A machine with AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
pub struct OnAvx2;

/// A machine with AVX-512.
#[cfg(target_arch = "x86_64")]
pub struct OnAvx512;

impl Runner for OnPortable {
    fn run<T: Task>(task: T) -> T::Output {
        Portable::call(task)
    }
}

#[cfg(target_arch = "x86_64")]
impl Runner for OnAvx2 {
    fn run<T: Task>(task: T) -> T::Output {
        assert!(Level::best() >= Level::Avx2);
        // SAFETY: the machine has what the level needs.
        unsafe { x86::run_avx2(task) }
    }
}

#[cfg(target_arch = "x86_64")]
impl Runner for OnAvx512 {
    fn run<T: Task>(task: T) -> T::Output {
        assert!(Level::best() >= Level::Avx512);
        // SAFETY: the machine has what the level needs.
        unsafe { x86::run_avx512(task) }
    }
}

/// Runs the task compiled for `level`, which this machine must support.
#[cfg(test)]
pub fn dispatch<T: Task>(level: Level, task: T) -> T::Output {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => OnAvx2::run(task),
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => OnAvx512::run(task),
        _ => OnPortable::run(task),
    }
}

/// Vectors of lanes, without closures, which would not be compiled for the instruction set.
pub mod lanes {
    use super::Floats;

    /// A byte for each of eight lanes, the first in the lowest: `value` in those of a mask, 0 in others.
    #[inline(always)]
    pub fn bytes(mask: u32, value: u8) -> u64 {
        // Byte k keeps bit k of the mask; adding 127 carries it to bit 7.
        let bits = (u64::from(mask) * 0x0101_0101_0101_0101) & 0x8040_2010_0804_0201;
        ((bits + 0x7f7f_7f7f_7f7f_7f7f) >> 7 & 0x0101_0101_0101_0101) * u64::from(value)
    }

    #[inline(always)]
    pub fn splat<F: Floats<f64, N>, const N: usize>(v: [f64; 3]) -> [F; 3] {
        [F::splat(v[0]), F::splat(v[1]), F::splat(v[2])]
    }

    /// Part `i` of an array of numbers.
    #[inline(always)]
    pub fn load<F: Floats<f64, N>, const N: usize>(x: &[f64], i: usize) -> F {
        F::load(&x.as_chunks().0[i])
    }

    /// The coordinates of part `i` of vectors, by axis.
    #[inline(always)]
    pub fn part<F: Floats<f64, N>, const N: usize, const M: usize>(
        [x, y, z]: &[[f64; M]; 3],
        i: usize,
    ) -> [F; 3] {
        [load(x, i), load(y, i), load(z, i)]
    }

    #[inline(always)]
    pub fn abs<F: Floats<f64, 8>>(v: [F; 3]) -> [F; 3] {
        [v[0].abs(), v[1].abs(), v[2].abs()]
    }

    #[inline(always)]
    pub fn dot<F: Floats<f64, N>, const N: usize>(a: [F; 3], b: [F; 3]) -> F {
        a[0].mul(b[0]).add(a[1].mul(b[1])).add(a[2].mul(b[2]))
    }

    #[inline(always)]
    pub fn store<F: Floats<f64, 8>>(v: [F; 3]) -> [[f64; 8]; 3] {
        [v[0].store(), v[1].store(), v[2].store()]
    }

    #[inline(always)]
    pub fn add<F: Floats<f64, N>, const N: usize>(a: [F; 3], b: [F; 3]) -> [F; 3] {
        [a[0].add(b[0]), a[1].add(b[1]), a[2].add(b[2])]
    }

    #[inline(always)]
    pub fn sub<F: Floats<f64, N>, const N: usize>(a: [F; 3], b: [F; 3]) -> [F; 3] {
        [a[0].sub(b[0]), a[1].sub(b[1]), a[2].sub(b[2])]
    }

    #[inline(always)]
    pub fn scaled<F: Floats<f64, N>, const N: usize>(v: [F; 3], by: F) -> [F; 3] {
        [v[0].mul(by), v[1].mul(by), v[2].mul(by)]
    }

    #[inline(always)]
    pub fn divided<F: Floats<f64, N>, const N: usize>(v: [F; 3], by: F) -> [F; 3] {
        [v[0].div(by), v[1].div(by), v[2].div(by)]
    }

    #[inline(always)]
    pub fn cross<F: Floats<f64, N>, const N: usize>(a: [F; 3], b: [F; 3]) -> [F; 3] {
        [
            a[1].mul(b[2]).sub(a[2].mul(b[1])),
            a[2].mul(b[0]).sub(a[0].mul(b[2])),
            a[0].mul(b[1]).sub(a[1].mul(b[0])),
        ]
    }

    /// As `dot`, with fewer roundings where that is faster.
    #[inline(always)]
    pub fn fused_dot<F: Floats<f64, N>, const N: usize>(a: [F; 3], b: [F; 3]) -> F {
        a[0].fused(b[0], a[1].fused(b[1], a[2].mul(b[2])))
    }

    /// a·b + c.
    #[inline(always)]
    pub fn fused_sum<F: Floats<f64, N>, const N: usize>(a: [F; 3], b: [F; 3], c: F) -> F {
        a[0].fused(b[0], a[1].fused(b[1], a[2].fused(b[2], c)))
    }

    #[inline(always)]
    pub fn fused_cross<F: Floats<f64, 8>>(a: [F; 3], b: [F; 3]) -> [F; 3] {
        [
            a[1].fused(b[2], a[2].mul(b[1]).negated()),
            a[2].fused(b[0], a[0].mul(b[2]).negated()),
            a[0].fused(b[1], a[1].mul(b[0]).negated()),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_tell_the_lanes_of_a_mask() {
        for mask in 0..256 {
            for value in [0, 1, 5, u8::MAX] {
                let expected = std::array::from_fn(|k| if mask >> k & 1 != 0 { value } else { 0 });
                assert_eq!(lanes::bytes(mask, value).to_le_bytes(), expected, "{mask}");
            }
        }
    }

    struct Fractions<'a>(&'a [u64; 8]);

    impl Task for Fractions<'_> {
        type Output = [(u32, [f64; 8]); 5];

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            let x = self.0;
            [
                (0, I::fraction::<0>(x).store()),
                (21, I::fraction::<21>(x).store()),
                (31, I::fraction::<31>(x).store()),
                (42, I::fraction::<42>(x).store()),
                (43, I::fraction::<43>(x).store()),
            ]
        }
    }

    struct Transpose<'a> {
        points: &'a [[f64; 3]],
        at: [usize; 8],
    }

    impl Task for Transpose<'_> {
        type Output = [[[f64; 8]; 3]; 4];

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            let columns = I::columns(self.at.map(|i| &self.points[i]));
            let interleaved = I::interleaved(columns);
            // Runs from the first and the second point asked for, or the last four points if fewer follow.
            let run = |i: usize| &self.points[self.at[i].min(self.points.len() - 4)..].as_chunks().0[0];
            let runs = I::columns_of_runs([run(0), run(1)]);
            [columns, interleaved, I::deinterleaved(interleaved), runs]
                .map(|registers| registers.map(I::F64x8::store))
        }
    }

    #[test]
    fn columns_hold_the_points_asked_for() {
        let mut number = crate::testing::numbers();
        // The last point ends where the array does.
        let points: Vec<[f64; 3]> = (0..11).map(|_| [0; 3].map(|_: u8| number())).collect();
        for _ in 0..200 {
            let at = [0; 8].map(|_: u8| (11.0 * number()) as usize);
            for level in Level::available() {
                let [columns @ [x, y, z], interleaved, again, runs] =
                    dispatch(level, Transpose { points: &points, at });
                for lane in 0..8 {
                    assert_eq!([x[lane], y[lane], z[lane]], points[at[lane]], "{level:?}");
                }
                assert_eq!(*interleaved.as_flattened(), *at.map(|i| points[i]).as_flattened(), "{level:?}");
                assert_eq!(again, columns, "{level:?}");
                for lane in 0..8 {
                    let place = at[lane / 4].min(points.len() - 4) + lane % 4;
                    assert_eq!(runs.map(|column| column[lane]), points[place], "{level:?}");
                }
            }
        }
    }

    struct Selected<'a>(u32, &'a [f64; 8], &'a [f64; 8], u32, [u32; 8]);

    impl Task for Selected<'_> {
        type Output = ([f64; 8], [u32; 8]);

        #[inline(always)]
        fn run<I: Isa>(mut self) -> Self::Output {
            I::put(self.0, self.3, &mut self.4);
            (I::pick(self.0, I::F64x8::load(self.1), I::F64x8::load(self.2)).store(), self.4)
        }
    }

    #[test]
    fn lanes_are_selected_by_their_bits() {
        let then = [0.5, -0.0, f64::INFINITY, 1e300, -3.0, 5e-324, 7.0, 8.0];
        let (otherwise, number) = (then.map(|x| 2.0 - x), 0x8000_0001);
        let places = [0, 1, u32::MAX, 3, 1 << 31, 5, 6, 7];
        for lanes in 0..256 {
            for level in Level::available() {
                let (picked, put) = dispatch(level, Selected(lanes, &then, &otherwise, number, places));
                for i in 0..8 {
                    let (x, place) =
                        if lanes & 1 << i != 0 { (then[i], number) } else { (otherwise[i], places[i]) };
                    assert_eq!((picked[i].to_bits(), put[i]), (x.to_bits(), place), "{level:?}, {lanes:b}");
                }
            }
        }
    }

    struct Distances<'a>(&'a [f32; 8], &'a [f32; 8], &'a [u32; 8]);

    impl Task for Distances<'_> {
        type Output = (usize, [f32; 8], [u32; 8]);

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            I::by_distance(I::F32x8::load(self.0), I::F32x8::load(self.1), self.2)
        }
    }

    #[test]
    fn distances_are_sorted_with_what_belongs_to_them() {
        let mut number = crate::testing::numbers();
        let mut counts = [0; 9];
        for round in 0..2000 {
            let near = [0; 8].map(|_: u8| match (30.0 * number()) as u32 {
                0 => 0.0,
                1 => -0.0,
                2 => f32::MAX,
                3 => f32::INFINITY,
                4 => 1.0 + 1e-6 * number() as f32,
                _ => (100.0 * number()) as f32,
            });
            let reach = 1e4_f64.powf(number());
            let far = [0; 8].map(|_: u8| if number() < 0.05 { f32::NAN } else { (reach * number()) as f32 });
            let what = [0; 8].map(|_: u8| (u32::MAX as f64 * number()) as u32);
            let hit: Vec<usize> = (0..8).filter(|&i| near[i] <= far[i]).collect();
            counts[hit.len()] += 1;
            for level in Level::available() {
                let (count, distances, found) = dispatch(level, Distances(&near, &far, &what));
                assert_eq!(count, hit.len());
                assert!(distances[..count].is_sorted_by(|a, b| a >= b), "{level:?}, {round}");
                let mut left = hit.clone();
                for (distance, found) in distances[..count].iter().zip(found) {
                    let at = left.iter().position(|&i| {
                        what[i] == found && distance.to_bits() == near[i].abs().to_bits() & !7
                    });
                    assert!(at.is_some(), "{level:?}: {distance} of {near:?}");
                    left.remove(at.unwrap_or(0));
                }
            }
        }
        assert!(counts[..8].iter().all(|&count| count > 20), "{counts:?}");
    }

    #[test]
    fn fractions_are_those_of_the_bits() {
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state
        };
        let random: Vec<[u64; 8]> = (0..200).map(|_| [0; 8].map(|_: u8| next())).collect();
        for x in random.iter().chain(&[
            [0; 8],
            [u64::MAX; 8],
            [0, 1, 1 << 20, 1 << 21, 1 << 41, 1 << 42, 1 << 62, 1 << 63],
        ]) {
            for level in Level::available() {
                for (first, found) in dispatch(level, Fractions(x)) {
                    let k = x.map(|x| x >> first & 0x1f_ffff);
                    assert_eq!(
                        found,
                        k.map(|k| 1.0 + k as f64 / 2_097_152.0),
                        "{level:?}, bit {first} of {x:x?}"
                    );
                }
            }
        }
    }
}
