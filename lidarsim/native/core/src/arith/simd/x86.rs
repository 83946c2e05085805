//! AVX2 with FMA, and AVX-512.
//!
//! SAFETY of all intrinsics here: only operations of the types below execute them. The types are private to
//! this file and reach other code only as the parameter of a task, from `run_avx2` and `run_avx512`, which
//! their `Runner` calls only on machines with the features. So code that knows such a type runs only where
//! the features exist. Loads and stores are unaligned and go through references to arrays of the register's
//! size.

use core::arch::x86_64::*;

use super::{DISTANCE_MASK, FRACTION_MASK, Floats, Isa, LaneTask, ONE, Operation, PLACE, Task};

#[derive(Clone, Copy)]
struct Avx2;

#[derive(Clone, Copy)]
struct Avx512;

/// A register of floats. A type of the standard library would be known everywhere.
#[derive(Clone, Copy)]
#[repr(transparent)]
struct Register<R>(R);

type F32x8 = Register<__m256>;
type F64x4 = Register<__m256d>;
type F32x16 = Register<__m512>;
type F64x8 = Register<__m512d>;

/// # Safety
///
/// The machine must have AVX2 and FMA.
#[target_feature(enable = "avx2,fma")]
#[inline(never)]
pub unsafe fn run_avx2<T: Task>(task: T) -> T::Output {
    task.run::<Avx2>()
}

/// # Safety
///
/// As `run_avx2`.
#[target_feature(enable = "avx2,fma")]
#[inline(never)]
unsafe fn call_widest_avx2<T: LaneTask>(task: T) -> T::Output {
    task.run::<F64x4, 4>()
}

/// # Safety
///
/// The machine must have AVX-512 F, VL, DQ and BW, AVX2 and FMA.
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512dq,avx512bw")]
#[inline(never)]
pub unsafe fn run_avx512<T: Task>(task: T) -> T::Output {
    task.run::<Avx512>()
}

/// # Safety
///
/// As `run_avx512`.
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512dq,avx512bw")]
#[inline(never)]
unsafe fn call_widest_avx512<T: LaneTask>(task: T) -> T::Output {
    task.run::<F64x8, 8>()
}

/// # Safety
///
/// As `run_avx2`.
#[target_feature(enable = "avx2,fma")]
#[inline]
unsafe fn inline_avx2<O: Operation>(operation: O) -> O::Output {
    operation.run()
}

/// # Safety
///
/// As `run_avx512`.
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512dq,avx512bw")]
#[inline]
unsafe fn inline_avx512<O: Operation>(operation: O) -> O::Output {
    operation.run()
}

impl Isa for Avx2 {
    type F32x8 = F32x8;
    type F32x16 = Two<F32x8>;
    type F64x8 = Two<F64x4>;
    type Masks = Two<__m256i>;

    #[inline(always)]
    fn fraction<const FIRST: u32>(x: &[u64; 8]) -> Self::F64x8 {
        // SAFETY: as above; both halves lie within the array.
        unsafe {
            Two(
                Register(fraction_of_four::<FIRST>(_mm256_loadu_si256(x.as_ptr().cast()))),
                Register(fraction_of_four::<FIRST>(_mm256_loadu_si256(x.as_ptr().add(4).cast()))),
            )
        }
    }

    #[inline(always)]
    fn fused(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn narrow(low: Self::F64x8, high: Self::F64x8) -> Self::F32x16 {
        // SAFETY: as above.
        unsafe {
            Two(
                Register(_mm256_set_m128(_mm256_cvtpd_ps(low.1.0), _mm256_cvtpd_ps(low.0.0))),
                Register(_mm256_set_m128(_mm256_cvtpd_ps(high.1.0), _mm256_cvtpd_ps(high.0.0))),
            )
        }
    }

    #[inline(always)]
    fn columns([a, b, c, d, e, f, g, h]: [&[f64; 3]; 8]) -> [Self::F64x8; 3] {
        let ([x0, y0, z0], [x1, y1, z1]) = (columns_of_four([a, b, c, d]), columns_of_four([e, f, g, h]));
        [Two(Register(x0), Register(x1)), Two(Register(y0), Register(y1)), Two(Register(z0), Register(z1))]
    }

    #[inline(always)]
    fn columns_of_runs([low, high]: [&[[f64; 3]; 4]; 2]) -> [Self::F64x8; 3] {
        let ([x0, y0, z0], [x1, y1, z1]) = (columns_of_run(low), columns_of_run(high));
        [Two(x0, x1), Two(y0, y1), Two(z0, z1)]
    }

    #[inline(always)]
    fn deinterleaved([Two(a, b), Two(c, d), Two(e, f)]: [Self::F64x8; 3]) -> [Self::F64x8; 3] {
        let ([x0, y0, z0], [x1, y1, z1]) = (four_deinterleaved(a, b, c), four_deinterleaved(d, e, f));
        [Two(x0, x1), Two(y0, y1), Two(z0, z1)]
    }

    #[inline(always)]
    fn interleaved([x, y, z]: [Self::F64x8; 3]) -> [Self::F64x8; 3] {
        let ([a, b, c], [d, e, f]) = (four_interleaved(x.0, y.0, z.0), four_interleaved(x.1, y.1, z.1));
        [Two(a, b), Two(c, d), Two(e, f)]
    }

    #[inline(always)]
    fn by_distance(
        Register(near): F32x8,
        Register(far): F32x8,
        what: &[u32; 8],
    ) -> (usize, [f32; 8], [u32; 8]) {
        // SAFETY: as above.
        unsafe {
            let hit = _mm256_cmp_ps::<_CMP_LE_OQ>(near, far);
            let keys = keys(near);
            // Missed boxes get key −1 and come last.
            let missed = _mm256_xor_si256(_mm256_castps_si256(hit), _mm256_set1_epi32(-1));
            let keys = sorted(_mm256_or_si256(keys, missed));
            let (distances, found) = in_order(keys, what);
            (_mm256_movemask_ps(hit).count_ones() as usize, distances, found)
        }
    }

    #[inline(always)]
    fn no_masks() -> Self::Masks {
        // SAFETY: as above.
        unsafe { Two(_mm256_setzero_si256(), _mm256_setzero_si256()) }
    }

    #[inline(always)]
    fn mark(masks: Self::Masks, Register(near): F32x8, Register(far): F32x8, bit: u64) -> Self::Masks {
        // SAFETY: as above.
        unsafe {
            let bit = _mm256_set1_epi64x(bit as i64);
            let hit = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LE_OQ>(near, far));
            let low = _mm256_cvtepi32_epi64(_mm256_castsi256_si128(hit));
            let high = _mm256_cvtepi32_epi64(_mm256_extracti128_si256::<1>(hit));
            Two(
                _mm256_or_si256(masks.0, _mm256_and_si256(low, bit)),
                _mm256_or_si256(masks.1, _mm256_and_si256(high, bit)),
            )
        }
    }

    #[inline(always)]
    fn masks(masks: Self::Masks) -> [u64; 8] {
        let mut bits = [0; 8];
        // SAFETY: as above; both halves lie within the array.
        unsafe {
            _mm256_storeu_si256(bits.as_mut_ptr().cast(), masks.0);
            _mm256_storeu_si256(bits.as_mut_ptr().add(4).cast(), masks.1);
        }
        bits
    }

    #[inline(always)]
    fn pick(lanes: u32, then: Self::F64x8, otherwise: Self::F64x8) -> Self::F64x8 {
        // SAFETY: as above.
        unsafe {
            let lanes = _mm256_set1_epi64x(lanes.into());
            let of = |bits| _mm256_castsi256_pd(_mm256_cmpeq_epi64(_mm256_and_si256(lanes, bits), bits));
            let (low, high) = (of(_mm256_setr_epi64x(1, 2, 4, 8)), of(_mm256_setr_epi64x(16, 32, 64, 128)));
            Two(
                Register(_mm256_blendv_pd(otherwise.0.0, then.0.0, low)),
                Register(_mm256_blendv_pd(otherwise.1.0, then.1.0, high)),
            )
        }
    }

    #[inline(always)]
    fn put(lanes: u32, number: u32, places: &mut [u32; 8]) {
        // SAFETY: as above; the array is as long as the register.
        unsafe {
            let bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let these = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(lanes as i32), bits), bits);
            let old = _mm256_loadu_si256(places.as_ptr().cast());
            let new = _mm256_blendv_epi8(old, _mm256_set1_epi32(number as i32), these);
            _mm256_storeu_si256(places.as_mut_ptr().cast(), new);
        }
    }

    #[inline(always)]
    fn prefetch<T>(address: *const T) {
        // SAFETY: a prefetch of any address is harmless.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address.cast()) }
    }

    #[inline(always)]
    fn call<T: Task>(task: T) -> T::Output {
        // SAFETY: as above.
        unsafe { run_avx2(task) }
    }

    #[inline(always)]
    fn call_widest<T: LaneTask>(task: T) -> Option<T::Output> {
        // SAFETY: as above.
        Some(unsafe { call_widest_avx2(task) })
    }
}

#[inline(always)]
fn fraction_of_four<const FIRST: u32>(x: __m256i) -> __m256d {
    // SAFETY: as above.
    unsafe {
        let placed = if FIRST < PLACE {
            _mm256_sll_epi64(x, _mm_cvtsi32_si128((PLACE - FIRST) as i32))
        } else {
            _mm256_srl_epi64(x, _mm_cvtsi32_si128((FIRST - PLACE) as i32))
        };
        let fraction = _mm256_and_si256(placed, _mm256_set1_epi64x(FRACTION_MASK as i64));
        _mm256_castsi256_pd(_mm256_or_si256(fraction, _mm256_set1_epi64x(ONE as i64)))
    }
}

/// Distances, rounded down in their last three bits, which hold the lane numbers.
#[inline(always)]
fn keys(near: __m256) -> __m256i {
    // SAFETY: as above.
    unsafe {
        let distances = _mm256_and_si256(_mm256_castps_si256(near), _mm256_set1_epi32(DISTANCE_MASK as i32));
        _mm256_or_si256(distances, _mm256_set_epi32(7, 6, 5, 4, 3, 2, 1, 0))
    }
}

/// The distances of keys, and the payloads of their lanes.
#[inline(always)]
fn in_order(keys: __m256i, what: &[u32; 8]) -> ([f32; 8], [u32; 8]) {
    let (mut distances, mut found) = ([0.0; 8], [0; 8]);
    // SAFETY: as above; the arrays are as long as the registers.
    unsafe {
        let what = _mm256_permutevar8x32_epi32(_mm256_loadu_si256(what.as_ptr().cast()), keys);
        let near = _mm256_and_si256(keys, _mm256_set1_epi32(DISTANCE_MASK as i32));
        _mm256_storeu_ps(distances.as_mut_ptr(), _mm256_castsi256_ps(near));
        _mm256_storeu_si256(found.as_mut_ptr().cast(), what);
    }
    (distances, found)
}

/// Eight signed integers in descending order: Batcher's bitonic sort. In each step the lanes of the mask,
/// from the right, keep the larger of two.
#[inline(always)]
fn sorted(x: __m256i) -> __m256i {
    // SAFETY: as above.
    unsafe {
        let x = exchange::<0b1001_1001>(x, _mm256_shuffle_epi32::<0b10_11_00_01>(x));
        let x = exchange::<0b1100_0011>(x, _mm256_shuffle_epi32::<0b01_00_11_10>(x));
        let x = exchange::<0b1010_0101>(x, _mm256_shuffle_epi32::<0b10_11_00_01>(x));
        let x = exchange::<0b0000_1111>(x, _mm256_permute2x128_si256::<1>(x, x));
        let x = exchange::<0b0011_0011>(x, _mm256_shuffle_epi32::<0b01_00_11_10>(x));
        exchange::<0b0101_0101>(x, _mm256_shuffle_epi32::<0b10_11_00_01>(x))
    }
}

#[inline(always)]
fn exchange<const LARGER: i32>(x: __m256i, other: __m256i) -> __m256i {
    // SAFETY: as above.
    unsafe { _mm256_blend_epi32::<LARGER>(_mm256_min_epi32(x, other), _mm256_max_epi32(x, other)) }
}

/// A point in the lower three lanes. The mask suppresses the load of the fourth, beyond the point.
#[inline(always)]
fn point(x: &[f64; 3]) -> __m256d {
    // SAFETY: as above; the lanes that are loaded lie within the array.
    unsafe { _mm256_maskload_pd(x.as_ptr(), _mm256_set_epi64x(0, -1, -1, -1)) }
}

#[inline(always)]
fn columns_of_four([a, b, c, d]: [&[f64; 3]; 4]) -> [__m256d; 3] {
    let (a, b, c, d) = (point(a), point(b), point(c), point(d));
    // SAFETY: as above.
    unsafe {
        let (ab, cd) = (_mm256_unpacklo_pd(a, b), _mm256_unpacklo_pd(c, d));
        let y = _mm256_permute2f128_pd::<0x20>(_mm256_unpackhi_pd(a, b), _mm256_unpackhi_pd(c, d));
        [_mm256_permute2f128_pd::<0x20>(ab, cd), y, _mm256_permute2f128_pd::<0x31>(ab, cd)]
    }
}

/// The coordinates of four adjacent points, by axis.
#[inline(always)]
fn columns_of_run(run: &[[f64; 3]; 4]) -> [F64x4; 3] {
    let (quarters, _) = run.as_flattened().as_chunks();
    four_deinterleaved(F64x4::load(&quarters[0]), F64x4::load(&quarters[1]), F64x4::load(&quarters[2]))
}

/// Four points, from consecutive coordinates to one register per axis.
#[inline(always)]
fn four_deinterleaved(Register(a): F64x4, Register(b): F64x4, Register(c): F64x4) -> [F64x4; 3] {
    // SAFETY: as above.
    unsafe {
        let (xy, yz) = (_mm256_permute2f128_pd::<0x30>(a, b), _mm256_permute2f128_pd::<0x30>(b, c));
        let zx = _mm256_permute2f128_pd::<0x21>(a, c);
        [
            Register(_mm256_shuffle_pd::<0b10_10>(xy, zx)),
            Register(_mm256_shuffle_pd::<0b01_01>(xy, yz)),
            Register(_mm256_shuffle_pd::<0b10_10>(zx, yz)),
        ]
    }
}

/// The inverse of `four_deinterleaved`.
#[inline(always)]
fn four_interleaved(Register(x): F64x4, Register(y): F64x4, Register(z): F64x4) -> [F64x4; 3] {
    // SAFETY: as above.
    unsafe {
        let (xy, yz, zx) =
            (_mm256_unpacklo_pd(x, y), _mm256_unpackhi_pd(y, z), _mm256_shuffle_pd::<0b10_10>(z, x));
        [
            Register(_mm256_permute2f128_pd::<0x20>(xy, zx)),
            Register(_mm256_blend_pd::<0b11_00>(yz, xy)),
            Register(_mm256_permute2f128_pd::<0x31>(zx, yz)),
        ]
    }
}

impl Isa for Avx512 {
    type F32x8 = F32x8;
    type F32x16 = F32x16;
    type F64x8 = F64x8;
    type Masks = __m512i;

    #[inline(always)]
    fn fraction<const FIRST: u32>(x: &[u64; 8]) -> Self::F64x8 {
        // SAFETY: as above.
        unsafe {
            let x = _mm512_loadu_si512(x.as_ptr().cast());
            let placed = if FIRST < PLACE {
                _mm512_sll_epi64(x, _mm_cvtsi32_si128((PLACE - FIRST) as i32))
            } else {
                _mm512_srl_epi64(x, _mm_cvtsi32_si128((FIRST - PLACE) as i32))
            };
            let fraction = _mm512_and_si512(placed, _mm512_set1_epi64(FRACTION_MASK as i64));
            Register(_mm512_castsi512_pd(_mm512_or_si512(fraction, _mm512_set1_epi64(ONE as i64))))
        }
    }

    #[inline(always)]
    fn fused(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn narrow(Register(low): F64x8, Register(high): F64x8) -> F32x16 {
        // SAFETY: as above.
        unsafe {
            Register(_mm512_insertf32x8::<1>(
                _mm512_castps256_ps512(_mm512_cvtpd_ps(low)),
                _mm512_cvtpd_ps(high),
            ))
        }
    }

    #[inline(always)]
    fn columns([a, b, c, d, e, f, g, h]: [&[f64; 3]; 8]) -> [Self::F64x8; 3] {
        // SAFETY: as above.
        unsafe {
            // Two points per register: first their coordinates are interleaved with those of the next points,
            // then the halves are joined.
            let (ac, bd) = (pair_of_points(a, c), pair_of_points(b, d));
            let (eg, fh) = (pair_of_points(e, g), pair_of_points(f, h));
            let (xz0, xz1) = (_mm512_unpacklo_pd(ac, bd), _mm512_unpacklo_pd(eg, fh));
            let (y0, y1) = (_mm512_unpackhi_pd(ac, bd), _mm512_unpackhi_pd(eg, fh));
            [
                Register(_mm512_shuffle_f64x2::<0b10_00_10_00>(xz0, xz1)),
                Register(_mm512_shuffle_f64x2::<0b10_00_10_00>(y0, y1)),
                Register(_mm512_shuffle_f64x2::<0b11_01_11_01>(xz0, xz1)),
            ]
        }
    }

    #[inline(always)]
    fn columns_of_runs([low, high]: [&[[f64; 3]; 4]; 2]) -> [F64x8; 3] {
        let (low, high) = (low.as_flattened(), high.as_flattened());
        // SAFETY: as above; each load is of eight or four of twelve numbers.
        unsafe {
            let first = _mm512_loadu_pd(low.as_ptr());
            let middle = _mm512_castpd256_pd512(_mm256_loadu_pd(low.as_ptr().add(8)));
            let middle = _mm512_insertf64x4::<1>(middle, _mm256_loadu_pd(high.as_ptr()));
            let last = _mm512_loadu_pd(high.as_ptr().add(4));
            Self::deinterleaved([Register(first), Register(middle), Register(last)])
        }
    }

    #[inline(always)]
    fn deinterleaved([Register(a), Register(b), Register(c)]: [F64x8; 3]) -> [F64x8; 3] {
        // SAFETY: as above.
        unsafe {
            // First from a and b, with arbitrary values in the places of c's elements; in the second step
            // element k of c is k + 8.
            let x = _mm512_permutex2var_pd(a, _mm512_setr_epi64(0, 3, 6, 9, 12, 15, 0, 0), b);
            let y = _mm512_permutex2var_pd(a, _mm512_setr_epi64(1, 4, 7, 10, 13, 0, 0, 0), b);
            let z = _mm512_permutex2var_pd(a, _mm512_setr_epi64(2, 5, 8, 11, 14, 0, 0, 0), b);
            [
                Register(_mm512_permutex2var_pd(x, _mm512_setr_epi64(0, 1, 2, 3, 4, 5, 10, 13), c)),
                Register(_mm512_permutex2var_pd(y, _mm512_setr_epi64(0, 1, 2, 3, 4, 8, 11, 14), c)),
                Register(_mm512_permutex2var_pd(z, _mm512_setr_epi64(0, 1, 2, 3, 4, 9, 12, 15), c)),
            ]
        }
    }

    #[inline(always)]
    fn interleaved([Register(x), Register(y), Register(z)]: [F64x8; 3]) -> [F64x8; 3] {
        // SAFETY: as above.
        unsafe {
            // x and y in their places, with arbitrary values in those of z; then z, whose element k is k + 8
            // in the second step.
            let xy0 = _mm512_permutex2var_pd(x, _mm512_setr_epi64(0, 8, 0, 1, 9, 0, 2, 10), y);
            let xy1 = _mm512_permutex2var_pd(x, _mm512_setr_epi64(0, 3, 11, 0, 4, 12, 0, 5), y);
            let xy2 = _mm512_permutex2var_pd(x, _mm512_setr_epi64(13, 0, 6, 14, 0, 7, 15, 0), y);
            [
                Register(_mm512_permutex2var_pd(xy0, _mm512_setr_epi64(0, 1, 8, 3, 4, 9, 6, 7), z)),
                Register(_mm512_permutex2var_pd(xy1, _mm512_setr_epi64(10, 1, 2, 11, 4, 5, 12, 7), z)),
                Register(_mm512_permutex2var_pd(xy2, _mm512_setr_epi64(0, 13, 2, 3, 14, 5, 6, 15), z)),
            ]
        }
    }

    #[inline(always)]
    fn by_distance(
        Register(near): F32x8,
        Register(far): F32x8,
        what: &[u32; 8],
    ) -> (usize, [f32; 8], [u32; 8]) {
        // SAFETY: as above.
        unsafe {
            let hit = _mm256_cmp_ps_mask::<_CMP_LE_OQ>(near, far);
            let count = hit.count_ones() as usize;
            let keys = keys(near);
            // Zeros follow: no key is less.
            let keys = _mm256_maskz_compress_epi32(hit, keys);
            let keys = if count > 2 {
                sorted(keys)
            } else {
                exchange::<0b01>(keys, _mm256_shuffle_epi32::<0b10_11_00_01>(keys))
            };
            let (distances, found) = in_order(keys, what);
            (count, distances, found)
        }
    }

    #[inline(always)]
    fn no_masks() -> __m512i {
        // SAFETY: as above.
        unsafe { _mm512_setzero_si512() }
    }

    #[inline(always)]
    fn mark(masks: __m512i, Register(near): F32x8, Register(far): F32x8, bit: u64) -> __m512i {
        // SAFETY: as above.
        unsafe {
            let hit = _mm256_cmp_ps_mask::<_CMP_LE_OQ>(near, far);
            _mm512_mask_or_epi64(masks, hit, masks, _mm512_set1_epi64(bit as i64))
        }
    }

    #[inline(always)]
    fn masks(masks: __m512i) -> [u64; 8] {
        let mut bits = [0; 8];
        // SAFETY: as above.
        unsafe { _mm512_storeu_si512(bits.as_mut_ptr().cast(), masks) };
        bits
    }

    #[inline(always)]
    fn pick(lanes: u32, Register(then): F64x8, Register(otherwise): F64x8) -> F64x8 {
        // SAFETY: as above.
        unsafe { Register(_mm512_mask_blend_pd(lanes as u8, otherwise, then)) }
    }

    #[inline(always)]
    fn put(lanes: u32, number: u32, places: &mut [u32; 8]) {
        // SAFETY: as above; the array is as long as the register.
        unsafe {
            let old = _mm256_loadu_si256(places.as_ptr().cast());
            let new = _mm256_mask_blend_epi32(lanes as u8, old, _mm256_set1_epi32(number as i32));
            _mm256_storeu_si256(places.as_mut_ptr().cast(), new);
        }
    }

    #[inline(always)]
    fn prefetch<T>(address: *const T) {
        Avx2::prefetch(address);
    }

    #[inline(always)]
    fn call<T: Task>(task: T) -> T::Output {
        // SAFETY: as above.
        unsafe { run_avx512(task) }
    }

    #[inline(always)]
    fn call_widest<T: LaneTask>(task: T) -> Option<T::Output> {
        // SAFETY: as above.
        Some(unsafe { call_widest_avx512(task) })
    }
}

#[inline(always)]
fn pair_of_points(low: &[f64; 3], high: &[f64; 3]) -> __m512d {
    // SAFETY: as above.
    unsafe { _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(point(low)), point(high)) }
}

/// Implements `Floats` by the intrinsics of these names, and by expressions where the widths differ.
macro_rules! register {
    (
        $register:ty, $float:ty, $n:literal, $inline:ident,
        [$set1:ident, $loadu:ident, $storeu:ident, $add:ident, $sub:ident, $mul:ident, $div:ident,
         $sqrt:ident, $fmadd:ident, $max:ident, $min:ident],
        |$x:ident| { abs: $abs:expr, largest: $largest:expr, smallest: $smallest:expr }
        |$a:ident, $b:ident, $then:ident, $else:ident| { le: $le:expr, lt: $lt:expr, le_pick: $le_pick:expr }
    ) => {
        impl Floats<$float, $n> for Register<$register> {
            #[inline(always)]
            fn splat(x: $float) -> Self {
                // SAFETY: as above.
                Register(unsafe { $set1(x) })
            }
            #[inline(always)]
            fn load(x: &[$float; $n]) -> Self {
                // SAFETY: as above.
                Register(unsafe { $loadu(x.as_ptr()) })
            }
            #[inline(always)]
            fn store(self) -> [$float; $n] {
                let mut x = [0.0; $n];
                // SAFETY: as above.
                unsafe { $storeu(x.as_mut_ptr(), self.0) };
                x
            }
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $add(self.0, other.0) })
            }
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $sub(self.0, other.0) })
            }
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $mul(self.0, other.0) })
            }
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $div(self.0, other.0) })
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $sqrt(self.0) })
            }
            #[inline(always)]
            fn abs(self) -> Self {
                let $x = self.0;
                // SAFETY: as above.
                Register(unsafe { $abs })
            }
            #[inline(always)]
            fn negated(self) -> Self {
                Self::splat(-0.0).sub(self)
            }
            #[inline(always)]
            fn mul_add(self, b: Self, c: Self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $fmadd(self.0, b.0, c.0) })
            }
            #[inline(always)]
            fn fused(self, b: Self, c: Self) -> Self {
                self.mul_add(b, c)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $max(self.0, other.0) })
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                // SAFETY: as above.
                Register(unsafe { $min(self.0, other.0) })
            }
            #[inline(always)]
            fn le(self, other: Self) -> u32 {
                let ($a, $b) = (self.0, other.0);
                // SAFETY: as above.
                unsafe { $le as u32 }
            }
            #[inline(always)]
            fn lt(self, other: Self) -> u32 {
                let ($a, $b) = (self.0, other.0);
                // SAFETY: as above.
                unsafe { $lt as u32 }
            }
            #[inline(always)]
            fn largest(self) -> $float {
                let $x = self.0;
                // SAFETY: as above.
                unsafe { $largest }
            }
            #[inline(always)]
            fn smallest(self) -> $float {
                let $x = self.0;
                // SAFETY: as above.
                unsafe { $smallest }
            }
            #[inline(always)]
            fn le_pick(self, other: Self, then: Self, otherwise: Self) -> Self {
                let ($a, $b, $then, $else) = (self.0, other.0, then.0, otherwise.0);
                // SAFETY: as above.
                Register(unsafe { $le_pick })
            }
            #[inline(always)]
            fn run<O: Operation>(operation: O) -> O::Output {
                // SAFETY: as above.
                unsafe { $inline(operation) }
            }
        }
    };
}

register!(
    __m256, f32, 8, inline_avx2,
    [_mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps,
     _mm256_div_ps, _mm256_sqrt_ps, _mm256_fmadd_ps, _mm256_max_ps, _mm256_min_ps],
    |x| {
        abs: _mm256_andnot_ps(_mm256_set1_ps(-0.0), x),
        largest: {
            let x = _mm_max_ps(_mm256_castps256_ps128(x), _mm256_extractf128_ps::<1>(x));
            let x = _mm_max_ps(x, _mm_movehl_ps(x, x));
            _mm_cvtss_f32(_mm_max_ss(x, _mm_movehdup_ps(x)))
        },
        smallest: {
            let x = _mm_min_ps(_mm256_castps256_ps128(x), _mm256_extractf128_ps::<1>(x));
            let x = _mm_min_ps(x, _mm_movehl_ps(x, x));
            _mm_cvtss_f32(_mm_min_ss(x, _mm_movehdup_ps(x)))
        }
    }
    |a, b, then, otherwise| {
        le: _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(a, b)),
        lt: _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a, b)),
        le_pick: _mm256_blendv_ps(otherwise, then, _mm256_cmp_ps::<_CMP_LE_OQ>(a, b))
    }
);
register!(
    __m256d, f64, 4, inline_avx2,
    [_mm256_set1_pd, _mm256_loadu_pd, _mm256_storeu_pd, _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd,
     _mm256_div_pd, _mm256_sqrt_pd, _mm256_fmadd_pd, _mm256_max_pd, _mm256_min_pd],
    |x| {
        abs: _mm256_andnot_pd(_mm256_set1_pd(-0.0), x),
        largest: {
            let x = _mm_max_pd(_mm256_castpd256_pd128(x), _mm256_extractf128_pd::<1>(x));
            _mm_cvtsd_f64(_mm_max_sd(x, _mm_unpackhi_pd(x, x)))
        },
        smallest: {
            let x = _mm_min_pd(_mm256_castpd256_pd128(x), _mm256_extractf128_pd::<1>(x));
            _mm_cvtsd_f64(_mm_min_sd(x, _mm_unpackhi_pd(x, x)))
        }
    }
    |a, b, then, otherwise| {
        le: _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LE_OQ>(a, b)),
        lt: _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LT_OQ>(a, b)),
        le_pick: _mm256_blendv_pd(otherwise, then, _mm256_cmp_pd::<_CMP_LE_OQ>(a, b))
    }
);
register!(
    __m512, f32, 16, inline_avx512,
    [_mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps,
     _mm512_div_ps, _mm512_sqrt_ps, _mm512_fmadd_ps, _mm512_max_ps, _mm512_min_ps],
    |x| { abs: _mm512_abs_ps(x), largest: _mm512_reduce_max_ps(x), smallest: _mm512_reduce_min_ps(x) }
    |a, b, then, otherwise| {
        le: _mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b),
        lt: _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b),
        le_pick: _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b), otherwise, then)
    }
);
register!(
    __m512d, f64, 8, inline_avx512,
    [_mm512_set1_pd, _mm512_loadu_pd, _mm512_storeu_pd, _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd,
     _mm512_div_pd, _mm512_sqrt_pd, _mm512_fmadd_pd, _mm512_max_pd, _mm512_min_pd],
    |x| { abs: _mm512_abs_pd(x), largest: _mm512_reduce_max_pd(x), smallest: _mm512_reduce_min_pd(x) }
    |a, b, then, otherwise| {
        le: _mm512_cmp_pd_mask::<_CMP_LE_OQ>(a, b),
        lt: _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b),
        le_pick: _mm512_mask_blend_pd(_mm512_cmp_pd_mask::<_CMP_LE_OQ>(a, b), otherwise, then)
    }
);

/// Two registers as one of twice as many lanes.
#[derive(Clone, Copy)]
struct Two<R>(R, R);

macro_rules! two {
    ($register:ty, $float:ty, $half:literal, $n:literal) => {
        impl Floats<$float, $n> for Two<$register> {
            #[inline(always)]
            fn splat(x: $float) -> Self {
                let half = <$register>::splat(x);
                Two(half, half)
            }
            #[inline(always)]
            fn load(x: &[$float; $n]) -> Self {
                let [low, high]: &[[$float; $half]; 2] =
                    x.as_chunks().0.try_into().unwrap_or(&[[0.0; $half]; 2]);
                Two(<$register>::load(low), <$register>::load(high))
            }
            #[inline(always)]
            fn store(self) -> [$float; $n] {
                let mut x = [0.0; $n];
                x[..$half].copy_from_slice(&self.0.store());
                x[$half..].copy_from_slice(&self.1.store());
                x
            }
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                Two(self.0.add(other.0), self.1.add(other.1))
            }
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                Two(self.0.sub(other.0), self.1.sub(other.1))
            }
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                Two(self.0.mul(other.0), self.1.mul(other.1))
            }
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                Two(self.0.div(other.0), self.1.div(other.1))
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                Two(self.0.sqrt(), self.1.sqrt())
            }
            #[inline(always)]
            fn abs(self) -> Self {
                Two(self.0.abs(), self.1.abs())
            }
            #[inline(always)]
            fn negated(self) -> Self {
                Two(self.0.negated(), self.1.negated())
            }
            #[inline(always)]
            fn mul_add(self, b: Self, c: Self) -> Self {
                Two(self.0.mul_add(b.0, c.0), self.1.mul_add(b.1, c.1))
            }
            #[inline(always)]
            fn fused(self, b: Self, c: Self) -> Self {
                self.mul_add(b, c)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                Two(Floats::max(self.0, other.0), Floats::max(self.1, other.1))
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                Two(Floats::min(self.0, other.0), Floats::min(self.1, other.1))
            }
            #[inline(always)]
            fn le(self, other: Self) -> u32 {
                self.0.le(other.0) | self.1.le(other.1) << $half
            }
            #[inline(always)]
            fn lt(self, other: Self) -> u32 {
                self.0.lt(other.0) | self.1.lt(other.1) << $half
            }
            #[inline(always)]
            fn largest(self) -> $float {
                Floats::max(self.0, self.1).largest()
            }
            #[inline(always)]
            fn smallest(self) -> $float {
                Floats::min(self.0, self.1).smallest()
            }
            #[inline(always)]
            fn le_pick(self, other: Self, then: Self, otherwise: Self) -> Self {
                let first = self.0.le_pick(other.0, then.0, otherwise.0);
                Two(first, self.1.le_pick(other.1, then.1, otherwise.1))
            }
            #[inline(always)]
            fn run<O: Operation>(operation: O) -> O::Output {
                // SAFETY: as above.
                unsafe { inline_avx2(operation) }
            }
        }
    };
}

two!(F32x8, f32, 8, 16);
two!(F64x4, f64, 4, 8);
