//! Elementary functions whose bits are the same on every platform: additions, multiplications, divisions and square roots
//! in a written order, where the bits of a C library's functions hang on its version and on the processor.
//!
//! The series are Taylor's, cut where the next term is below half an ulp.

/// Sum of c₀ + c₁x + c₂x² + …, by Horner's rule.
#[inline(always)]
pub fn polynomial<const N: usize>(coefficients: [f64; N], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// ln 2 = LN_2_HIGH + LN_2_LOW; the high part has 32 bits, so that an exponent times it is exact.
const LN_2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
const LN_2_LOW: f64 = f64::from_bits(0x3dea_39ef_3579_3c76);

/// Natural logarithm of a positive, normal number, to within 1 ulp.
///
/// With x = 2ᵏ(1+f), 1+f between √½ and √2, and s = f/(2+f): ln(1+f) = 2 artanh s = f − s(f − 2s²(1/3 + s²/5 + s⁴/7 + …)).
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
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    // Past these, float64 holds nothing but 0 and ∞, which is what they give. NaN stays.
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
    // 2ᵏ itself may not be a float64.
    let half = whole(k) >> 1;
    let power = |k: i64| f64::from_bits(((k + 1023) as u64) << 52);
    e * power(half) * power(whole(k) - half)
}

/// Sine and cosine, for |x| up to 10⁶, to within 1 ulp of 1.
///
/// x less the nearest multiple of π/2, which is subtracted in three parts of 33 bits and more.
#[inline(always)]
pub fn sin_cos(x: f64) -> (f64, f64) {
    const PI_2: [f64; 3] = [
        f64::from_bits(0x3ff9_21fb_5440_0000),
        f64::from_bits(0x3dd0_b461_1a60_0000),
        f64::from_bits(0x3ba3_198a_2e03_7073),
    ];
    let k = (x * std::f64::consts::FRAC_2_PI).round();
    let r = x - k * PI_2[0] - k * PI_2[1] - k * PI_2[2];
    const fn alternating(first: usize) -> [f64; 9] {
        let mut c = [0.0; 9];
        let mut i = 0;
        while i < c.len() {
            c[i] =
                if i % 2 == 0 { -RECIPROCAL_FACTORIALS[first + 2 * i] } else { RECIPROCAL_FACTORIALS[first + 2 * i] };
            i += 1;
        }
        c
    }
    let z = r * r;
    let sin = r + r * z * polynomial(const { alternating(3) }, z);
    let cos = 1.0 + z * polynomial(const { alternating(2) }, z);
    // (sin, cos), (cos, −sin), (−sin, −cos), (−cos, sin): without a branch, for several at once.
    let quarter = whole(k);
    let (a, b) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let negate = |x: f64, is: i64| f64::from_bits(x.to_bits() ^ ((is & 2) as u64) << 62);
    (negate(a, quarter), negate(b, quarter + 1))
}

/// A whole number below 2⁵¹ as an integer: beside 3·2⁵¹ it is in the last bits.
#[inline(always)]
fn whole(x: f64) -> i64 {
    const BESIDE: f64 = 3.0 * (1_u64 << 51) as f64;
    (x + BESIDE).to_bits() as i64 - BESIDE.to_bits() as i64
}

/// The angle in [0, π/2] whose sine and cosine are as `sin` to `cos`, both ≥ 0, to within 3e-9 of itself: good for float32.
///
/// arctan(x)/x on [0, 1] as a polynomial in x², fitted at Chebyshev's points.
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
    use super::*;

    /// `n` numbers spread evenly from `low` to `high`.
    fn spread(low: f64, high: f64, n: usize) -> impl Iterator<Item = f64> {
        (0..n).map(move |i| low + (high - low) * i as f64 / (n - 1) as f64)
    }

    fn ulps(got: f64, expected: f64) -> f64 {
        (got - expected).abs() / (expected.next_up() - expected).abs()
    }

    // The C library's own functions are within an ulp or so, which makes 2 of ours.
    #[test]
    fn ln_is_the_logarithm() {
        for x in spread(1e-3, 3.0, 100_001).chain((-1022..1023).map(|k| 1.3 * 2.0_f64.powi(k))) {
            assert!(ulps(ln(x), x.ln()) <= 2.0, "{x}: {} {}", ln(x), x.ln());
        }
        assert_eq!(ln(1.0), 0.0);
    }

    #[test]
    fn exp_is_the_exponential() {
        for x in spread(-708.0, 709.7, 100_001).chain(spread(-1.0, 1.0, 10_001)) {
            assert!(ulps(exp(x), x.exp()) <= 2.0, "{x}: {} {}", exp(x), x.exp());
        }
        assert_eq!([exp(0.0), exp(-1e4), exp(1e4)], [1.0, 0.0, f64::INFINITY]);
        assert!(exp(-740.0) > 0.0 && exp(f64::NAN).is_nan());
    }

    #[test]
    fn sin_cos_are_sine_and_cosine() {
        for x in spread(-10.0, 10.0, 100_001).chain(spread(9.9e5, 1e6, 10_001)) {
            let (sin, cos) = sin_cos(x);
            let ulp_of_one = f64::EPSILON;
            assert!((sin - x.sin()).abs() <= ulp_of_one && (cos - x.cos()).abs() <= ulp_of_one, "{x}: {sin} {cos}");
        }
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
