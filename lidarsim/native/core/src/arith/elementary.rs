//! Elementary functions whose bits are the same on every platform: additions, multiplications, divisions and
//! square roots in a fixed order. The bits of a C library's functions depend on its version and on the
//! processor.
//!
//! The series are Taylor series, truncated where the next term is below half an ulp.

/// Sum of c₀ + c₁x + c₂x² + …, by Horner's rule.
#[inline(always)]
pub fn polynomial<const N: usize>(coefficients: [f64; N], x: f64) -> f64 {
    let mut sum = coefficients[N - 1];
    for k in (0..N - 1).rev() {
        sum = sum * x + coefficients[k];
    }
    sum
}

/// ln 2 = LN_2_HIGH + LN_2_LOW; the high part has 32 bits, so its product with an exponent is exact.
const LN_2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
const LN_2_LOW: f64 = f64::from_bits(0x3dea_39ef_3579_3c76);

/// Natural logarithm of a positive, normal number, to within 1 ulp.
///
/// With x = 2ᵏ(1+f), 1+f between √½ and √2, and s = f/(2+f): ln(1+f) = 2 artanh s = f − s(f −
/// 2s²(1/3 + s²/5 + s⁴/7 + …)).
///
/// f and k·LN_2_HIGH are exact. The product of s and its factor is at most 0.068; the errors of s, of the
/// factor and of the product come to less than 3.5u of it: 0.24u. ln(1+f), at most 0.35, rounds by ¼u. The
/// last sum, if k ≠ 0, rounds by half an ulp of the result, or not at all if ln(1+f) and the result are
/// both in [¼, ½). Results in [¼, ½), whose ulp is ½u, are the worst: 0.49u, or, where |ln(1+f)| < ¼, s
/// is smaller, and it rounds by ⅛u, (0.11 + ⅛ + ¼)u.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    let bits = x.to_bits();
    let above_root = (bits & 0x000f_ffff_ffff_ffff) > 0x0006_a09e_667f_3bcd;
    let k = (bits >> 52) as i64 - 1023 + i64::from(above_root);
    let f = f64::from_bits(bits.wrapping_sub((k as u64) << 52)) - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let tail = 2.0 * z * polynomial(ODD_RECIPROCALS, z);
    let k = k as f64;
    k * LN_2_HIGH + (f - (s * (f - tail) - k * LN_2_LOW))
}

/// 1/3, 1/5, 1/7, …
const ODD_RECIPROCALS: [f64; 11] = {
    let mut c = [0.0; 11];
    let mut i = 0;
    while i < c.len() {
        c[i] = 1.0 / (2 * i + 3) as f64;
        i += 1;
    }
    c
};

/// 1/0!, 1/1!, 1/2!, …
pub const RECIPROCAL_FACTORIALS: [f64; 20] = {
    let mut c = [1.0; 20];
    let mut factorial = 1_u64;
    let mut i = 1;
    while i < c.len() {
        factorial *= i as u64;
        c[i] = 1.0 / factorial as f64;
        i += 1;
    }
    c
};

/// eˣ, to within 1 ulp where it is normal.
///
/// x = k·ln 2 + r, |r| ≤ 0.347. k·LN_2_HIGH and its difference from x are exact, and the rounding error
/// of `high − low` is added back. The worst case is r < 0, where the ulp of eʳ is u: eʳ − 1 − r is at
/// most 0.054; three roundings of it and one of its sum with the correction come to 0.19u; the sum with r
/// rounds by ¼u and the sum with 1 by ½u: 0.94u. For r > 0 the ulp is 2u, and the errors come to less than
/// 1.6u.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    // Beyond these arguments eˣ underflows to 0 or overflows to ∞. NaN stays NaN.
    let x = x.clamp(-746.0, 710.0);
    let k = (x * std::f64::consts::LOG2_E).round();
    let (high, low) = (x - k * LN_2_HIGH, k * LN_2_LOW);
    let r = high - low;
    const TAYLOR: [f64; 13] = {
        let mut c = [0.0; 13];
        let mut i = 0;
        while i < c.len() {
            c[i] = RECIPROCAL_FACTORIALS[i + 2];
            i += 1;
        }
        c
    };
    let e = 1.0 + (r + (((high - r) - low) + r * r * polynomial(TAYLOR, r)));
    // 2ᵏ itself may not be representable.
    let half = whole(k) >> 1;
    let power = |k: i64| f64::from_bits(((k + 1023) as u64) << 52);
    e * power(half) * power(whole(k) - half)
}

/// The largest angle that [`sin_cos`] accepts; `turns::sin_cos` accepts any.
pub const LARGEST_ANGLE: f64 = 1e6;

/// Sine and cosine, for |x| up to 10⁶, to within 1 ulp of 1.
///
/// The nearest multiple of π/2 is subtracted from x in three parts of at least 33 bits. The first difference
/// is exact; the others round by ½u each where |r| > ½, and less below. Sine: they move it by 0.71u at
/// most; the terms after r sum to 0.08, and four roundings of that come to 0.3u; the last sum rounds by ½u.
/// Cosine: they move it by 0.71u at most; the terms after 1 sum to 0.293 at most: r² rounds by ½u times ½,
/// the polynomial by ¼u times 0.62, and their product by ¼u; the last sum rounds by ½u. Both come to less
/// than 2u, an ulp of 1.
#[inline(always)]
pub fn sin_cos(x: f64) -> (f64, f64) {
    const PI_2: [f64; 3] = [
        f64::from_bits(0x3ff9_21fb_5440_0000),
        f64::from_bits(0x3dd0_b461_1a60_0000),
        f64::from_bits(0x3ba3_198a_2e03_7073),
    ];
    let k = (x * std::f64::consts::FRAC_2_PI).round();
    sin_cos_from_quarter(x - k * PI_2[0] - k * PI_2[1] - k * PI_2[2], whole(k))
}

/// Sine and cosine of r plus `quarter` quarter turns, |r| ≤ π/4.
#[inline(always)]
pub fn sin_cos_from_quarter(r: f64, quarter: i64) -> (f64, f64) {
    const fn alternating(first: usize) -> [f64; 9] {
        let mut c = [0.0; 9];
        let mut i = 0;
        while i < c.len() {
            c[i] = if i % 2 == 0 {
                -RECIPROCAL_FACTORIALS[first + 2 * i]
            } else {
                RECIPROCAL_FACTORIALS[first + 2 * i]
            };
            i += 1;
        }
        c
    }
    let z = r * r;
    let sin = r + r * z * polynomial(const { alternating(3) }, z);
    let cos = 1.0 + z * polynomial(const { alternating(2) }, z);
    // (sin, cos), (cos, −sin), (−sin, −cos), (−cos, sin): branchless, so that it vectorizes.
    let (a, b) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let negate = |x: f64, is: i64| f64::from_bits(x.to_bits() ^ ((is & 2) as u64) << 62);
    (negate(a, quarter), negate(b, quarter + 1))
}

/// A whole number below 2⁵¹ as an integer: adding 3·2⁵¹ moves it to the lowest bits.
#[inline(always)]
fn whole(x: f64) -> i64 {
    const BESIDE: f64 = 3.0 * (1_u64 << 51) as f64;
    (x + BESIDE).to_bits() as i64 - BESIDE.to_bits() as i64
}

/// The angle in [0, π/2] with this sine and cosine, both ≥ 0 and up to a common factor; its relative error
/// is below 3e-9, enough for float32.
///
/// arctan(x)/x on [0, 1] is a polynomial in x², fitted at the Chebyshev nodes.
#[inline(always)]
pub fn first_quadrant_angle(sin: f64, cos: f64) -> f64 {
    let steep = sin > cos;
    let (low, high) = if steep { (cos, sin) } else { (sin, cos) };
    let x = low / high;
    let angle = x * polynomial(ARCTAN, x * x);
    if steep { std::f64::consts::FRAC_PI_2 - angle } else { angle }
}

const ARCTAN: [f64; 10] = [
    0.9999999971605454,
    -0.3333327629198255,
    0.19998075281148714,
    -0.14260016082820906,
    0.10932341501303093,
    -0.08349724968301601,
    0.05708955593030619,
    -0.030351864785781172,
    0.010487649254949306,
    -0.0017011700640685973,
];

#[cfg(test)]
mod tests {
    use num_bigint::BigInt;

    use super::*;
    use crate::testing::{arc, fixed_point, float, half_pi, series, worst};

    /// `n` evenly spaced numbers from `low` to `high`.
    fn spread(low: f64, high: f64, n: usize) -> impl Iterator<Item = f64> {
        (0..n).map(move |i| low + (high - low) * i as f64 / (n - 1) as f64)
    }

    fn ln_2() -> BigInt {
        arc(26, 1) * 18 - arc(4801, 1) * 2 + arc(8749, 1) * 8
    }

    fn exponential(x: &BigInt) -> BigInt {
        series(x, 0, 1, 1)
    }

    /// The ulp of a number.
    fn ulp(x: f64) -> f64 {
        x.abs().next_up() - x.abs()
    }

    /// Compares with the series in 320-bit numbers: the worst error that a search finds is below the derived
    /// bound, and not far below.
    #[test]
    fn functions_are_as_near_as_is_derived() {
        let (two, quarter) = (ln_2(), half_pi());
        let off_exp = |x: f64| {
            let k = (x * std::f64::consts::LOG2_E).round();
            let truth = exponential(&(fixed_point(x) - &two * k as i64));
            let found = exp(x) * 2.0_f64.powi(-(k / 2.0) as i32) * 2.0_f64.powi((k / 2.0) as i32 - k as i32);
            float(&(fixed_point(found) - truth)).abs() / ulp(found)
        };
        // y − ln x = ln(eʸ/x) ≈ eʸ/x − 1.
        let off_ln = |x: f64| {
            let (y, k) = (ln(x), x.log2().round() as i32);
            let small = x * 2.0_f64.powi(-k / 2) * 2.0_f64.powi(-k - -k / 2);
            let truth = exponential(&(fixed_point(y) - &two * k));
            if y == 0.0 { 0.0 } else { float(&(truth - fixed_point(small))).abs() / small / ulp(y) }
        };
        let off_turn = |x: f64, which: usize| {
            let k = (x * std::f64::consts::FRAC_2_PI).round() as i64;
            let r = fixed_point(x) - &quarter * k;
            let (s, c) = (series(&r, 1, 2, -1), series(&r, 0, 2, -1));
            let truth = [[&s, &c], [&c, &s], [&s, &c], [&c, &s]][k.rem_euclid(4) as usize][which].clone();
            let negative =
                [[false, false], [false, true], [true, true], [true, false]][k.rem_euclid(4) as usize][which];
            let found = [sin_cos(x).0, sin_cos(x).1][which];
            float(&(fixed_point(found) - if negative { -truth } else { truth })).abs() / f64::EPSILON
        };
        type Error<'a> = &'a dyn Fn(f64) -> f64;
        let searches: [(&str, f64, f64, Error); 6] = [
            ("exp", -1.0, 1.0, &off_exp),
            ("exp", -700.0, 700.0, &off_exp),
            ("ln", 0.5, 2.0, &off_ln),
            ("ln", 1e-3, 1e3, &off_ln),
            ("sin", -10.0, 10.0, &|x| off_turn(x, 0)),
            ("cos", -1e6, 1e6, &|x| off_turn(x, 1)),
        ];
        for (what, low, high, off) in searches {
            let draw = |_: usize, next: &mut dyn FnMut() -> f64| low + (high - low) * next();
            let (found, x) =
                worst(10, 250, draw, |&[x]: &[f64; 1]| if low < x && x < high { off(x) } else { 0.0 });
            assert!(0.5 < found && found <= 1.0, "{what} of {x:?} is off by {found}");
        }
    }

    #[test]
    fn functions_of_plain_numbers_are_plain() {
        for k in -1022..1023 {
            let x = 1.3 * 2.0_f64.powi(k);
            // These may differ by an ulp.
            assert!((ln(x) - x.ln()).abs() <= 2.0 * ulp(x.ln()), "{x}: {} {}", ln(x), x.ln());
        }
        for x in spread(-708.0, 709.7, 2_001) {
            assert!((exp(x) - x.exp()).abs() <= 2.0 * ulp(x.exp()), "{x}: {} {}", exp(x), x.exp());
        }
        assert_eq!(ln(1.0), 0.0);
        assert_eq!([exp(0.0), exp(-1e4), exp(1e4)], [1.0, 0.0, f64::INFINITY]);
        assert!(exp(-740.0) > 0.0 && exp(f64::NAN).is_nan());
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
    }

    #[test]
    fn first_quadrant_angle_is_the_arc_tangent() {
        for angle in spread(0.0, std::f64::consts::FRAC_PI_2, 100_001) {
            let got = first_quadrant_angle(angle.sin(), angle.cos().max(0.0));
            assert!((got - angle).abs() <= 3e-9 * angle, "{angle}: {got}");
        }
        assert_eq!(first_quadrant_angle(0.0, 1.0), 0.0);
    }
}
