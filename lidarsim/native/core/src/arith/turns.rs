//! Sine and cosine of angles of any size, reduced exactly.
//!
//! An angle is the product of a turn rate and a number, as for a body that has turned at a constant rate
//! since time 0. The rate is kept in turns, as an integer in units of 2⁻¹²¹⁶. Of its product with
//! m·2ᵉ only the bits around the binary point are computed: bits further left are whole turns, and bits
//! further right are negligible (M. Payne, R. Hanek, Radian reduction for trigonometric functions, ACM SIGNUM
//! Newsletter 18, 1983).

use std::f64::consts::TAU;

use num_bigint::BigUint;

use crate::arith::elementary::sin_cos_from_quarter;

/// Fraction bits of a rate: those that the largest float64, below 2¹⁰²⁴, shifts up to the point, and
/// 192 more.
const PLACES: i64 = 1216;

/// 1/2π in units of 2⁻²³⁰⁴, rounded down, least significant digits first.
static PER_RADIAN: [u64; 36] = [
    0xb12b_5053_4b17_4003,
    0xc571_852d_6746_70f0,
    0xbe9b_b55d_cb4c_10ce,
    0x61fc_4864_1f1f_091a,
    0x27ce_87cd_72bc_9fc7,
    0xf0cf_49bb_dac7_97be,
    0x0cb0_b793_e60c_9f6e,
    0xa97f_c1c1_4fdf_8cfa,
    0xb76b_d134_55c6_414f,
    0xa0d6_711d_a2e5_8729,
    0x0670_d9f3_773a_024a,
    0x5838_9ef0_231a_d1f1,
    0x4181_8555_b29c_ea32,
    0x237f_f620_135c_c9cc,
    0x1966_6157_c528_1a10,
    0x6a78_e458_57b9_86c2,
    0xfc33_ef08_26bd_0d87,
    0x1580_cc11_bf1e_daea,
    0x9afe_d7ec_47e3_5742,
    0xcf41_ce7d_e294_a4ba,
    0x5d49_eeb1_faf9_7c5e,
    0xd3d1_8fd9_a797_fa8b,
    0xdb4d_9fb3_c9f2_c26d,
    0xfbcb_c462_d682_9b47,
    0xc7fe_25ff_f781_6603,
    0x2721_17e2_ef7e_4a0e,
    0x4e64_758e_60d4_ce7d,
    0x3a67_1c09_ad17_df90,
    0xba20_8d7d_4bae_d121,
    0x3f87_7ac7_2c4a_69cf,
    0x0192_4bba_8274_6487,
    0x6dc9_1b8e_9093_74b8,
    0x7f94_58ea_f7ae_f158,
    0x36d8_a566_4f10_e410,
    0x7f09_d5f4_7d4d_3770,
    0x28be_60db_9391_054a,
];

/// A turn rate ≥ 0, in turns per unit of time: the digits of an integer, least significant first.
#[derive(Clone, Debug)]
pub struct TurnRate(Vec<u64>);

impl TurnRate {
    /// The rate of an angular velocity in rad, to within 2 units.
    ///
    /// With coordinates mᵢ·2ᵉ, of one e, the rate is √(Σ mᵢ²)·2ᵉ/2π. The root is rounded down
    /// to a unit. The error of 1/2π adds less than 1 to its product, as the other factor is below
    /// 2¹⁰²⁵⁺¹²¹⁶.
    pub fn new(angular: [f64; 3]) -> Self {
        let parts = angular.map(parts);
        let least = parts.iter().filter(|(m, _)| *m > 0).map(|(_, e)| *e).min().unwrap_or(0);
        let square: BigUint =
            parts.iter().map(|(m, e)| (BigUint::from(*m) << (e - least).max(0)).pow(2)).sum();
        let root = (square << (2 * (least + PLACES))).sqrt();
        let bytes: Vec<u8> = PER_RADIAN.iter().flat_map(|limb| limb.to_le_bytes()).collect();
        let turns: BigUint = (root * BigUint::from_bytes_le(&bytes)) >> (64 * PER_RADIAN.len());
        TurnRate(turns.to_u64_digits())
    }

    /// Sine and cosine of the angle reached at a time, as accurate as `sin_cos`.
    pub fn sin_cos(&self, time: f64) -> (f64, f64) {
        sin_cos_of(&self.0, time)
    }
}

/// Sine and cosine of any finite angle, to within 1 ulp of 1.
pub fn sin_cos(angle: f64) -> (f64, f64) {
    sin_cos_of(&PER_RADIAN[PER_RADIAN.len() - PLACES as usize / 64..], angle)
}

/// A finite angle in units of 2⁻¹²⁸ of a turn, without whole turns, to within a unit.
pub fn phase(angle: f64) -> u128 {
    let turned = fraction(&PER_RADIAN[PER_RADIAN.len() - PLACES as usize / 64..], angle);
    if angle < 0.0 { turned.wrapping_neg() } else { turned }
}

fn sin_cos_of(rate: &[u64], time: f64) -> (f64, f64) {
    // In units of 2⁻¹²⁸ of a turn a quarter has 126 bits; the remainder is at most half a quarter
    // either way.
    let turned = fraction(rate, time);
    let quarter = turned.wrapping_add(1 << 125) >> 126;
    let rest = turned.wrapping_sub(quarter << 126) as i128;
    // Three roundings of r ≤ π/4, 3u in all, move sine and cosine by less than 0.75u each beyond the error
    // that `sin_cos` allows in r itself.
    let (sin, cos) = sin_cos_from_quarter(rest as f64 / 2.0_f64.powi(128) * TAU, quarter as i64);
    (if time < 0.0 { -sin } else { sin }, cos)
}

/// The fraction of |time| times a rate, in units of 2⁻¹²⁸; for an exact rate, less than 2⁻¹⁰ of a
/// unit too low.
///
/// With time = m·2ᵉ and `window` the bits of the rate worth 2⁻ᵉ⁻¹ to 2⁻ᵉ⁻¹⁹², the product
/// m·window is off by less than m units of 2⁻¹⁹².
fn fraction(rate: &[u64], time: f64) -> u128 {
    let (m, e) = parts(time);
    let first = (PLACES - 192 - e) as usize;
    let limb = |i: usize| u128::from(rate.get(i).copied().unwrap_or(0));
    let window = |i: usize| {
        let (limbs, bits) = ((first + 64 * i) / 64, (first + 64 * i) % 64);
        ((limb(limbs + 1) << 64 | limb(limbs)) >> bits) as u64
    };
    let low = (u128::from(m) * u128::from(window(0))) >> 64;
    let middle = u128::from(m) * u128::from(window(1)) + low;
    let high = u128::from(m) * u128::from(window(2)) + (middle >> 64);
    high << 64 | middle & u128::from(u64::MAX)
}

/// |x| = m·2ᵉ; ±∞ counts as ±2¹⁰²⁴.
pub fn parts(x: f64) -> (u64, i64) {
    let bits = x.to_bits();
    let (exponent, mantissa) = ((bits >> 52 & 0x7ff) as i64, bits & ((1 << 52) - 1));
    if exponent == 0 { (mantissa, -1074) } else { (mantissa | 1 << 52, exponent - 1075) }
}

#[cfg(test)]
mod tests {
    use num_bigint::BigInt;

    use super::*;
    use crate::testing::numbers;

    /// π·2ᵇ, by Machin's formula; the error is below the number of terms.
    fn pi(bits: u64) -> BigInt {
        let arc = |n: i64| {
            let (mut sum, mut power, mut k) = (BigInt::ZERO, (BigInt::from(1) << bits) / n, 1_i64);
            while power != BigInt::ZERO {
                sum += &power / if k % 4 == 1 { k } else { -k };
                power /= n * n;
                k += 2;
            }
            sum
        };
        arc(5) * 16 - arc(239) * 4
    }

    #[test]
    fn the_digits_are_those_of_pi() {
        let bytes: Vec<u8> = PER_RADIAN.iter().flat_map(|limb| limb.to_le_bytes()).collect();
        let digits = BigInt::from(BigUint::from_bytes_le(&bytes));
        let bits = 64 * PER_RADIAN.len() as u64;
        // digits·2π = 2ᵇ less the truncation, up to 2π; π has 64 more bits, which the division removes.
        let short: BigInt = (BigInt::from(1) << (bits + 64)) - ((digits * pi(bits + 64) * 2) >> bits);
        assert!(short > BigInt::ZERO && short < BigInt::from(7) << 64, "{short}");
    }

    /// Compares with the fraction of the same integer product, and 2π to 2,400 bits.
    #[test]
    fn angles_of_all_sizes_are_reduced() {
        let mut number = numbers();
        let two_pi: BigInt = pi(2400) * 2;
        for k in 0..2000 {
            let exponent = (2100.0 * number()) as i32 - 1075;
            let x = (1.0 + number()) * 2.0_f64.powi(exponent / 2) * 2.0_f64.powi(exponent - exponent / 2);
            let x = [x, f64::MAX, f64::from_bits(1), 1e22, 6381956970095103.0 * 2.0_f64.powi(797)]
                [if k < 5 { k } else { 0 }];
            if !x.is_finite() {
                continue;
            }
            let (m, e) = parts(x);
            let angle = BigInt::from(m) << (2400 + e);
            let rest = &angle - (&angle / &two_pi) * &two_pi;
            // rest/2²⁴⁰⁰ to 60 bits is a float64 up to rounding, below 2π.
            let radians = i128::try_from(&rest >> (2400 - 100)).unwrap() as f64 * 2.0_f64.powi(-100);
            let (sin, cos) = sin_cos(x);
            let (other_sin, other_cos) = crate::arith::elementary::sin_cos(radians);
            assert!((sin - other_sin).abs() < 1e-15 && (cos - other_cos).abs() < 1e-15, "{x}: {sin} {cos}");
            assert_eq!(sin_cos(-x), (-sin, cos));
        }
    }

    #[test]
    fn a_rate_along_an_axis_is_that_of_an_angle() {
        let mut number = numbers();
        for _ in 0..500 {
            let time = (1.0 + number()) * 2.0_f64.powi((1900.0 * (number() - 0.5)) as i32);
            for (axis, rate) in [(0, 1.0), (1, 2.0_f64.powi(-60)), (2, -(2.0_f64.powi(71)))] {
                let mut angular = [0.0; 3];
                angular[axis] = rate;
                let (sin, cos) = TurnRate::new(angular).sin_cos(time);
                let expected = sin_cos(rate.abs() * time);
                assert!(
                    (sin - expected.0).abs() < 1e-15 && (cos - expected.1).abs() < 1e-15,
                    "{angular:?} {time}"
                );
            }
            // (3, 4, 12)·s turns at the rate 13 s.
            let s = (1.0 + number()) * 2.0_f64.powi(200);
            let s = f64::from_bits(s.to_bits() & !15);
            let (sin, cos) = TurnRate::new([3.0 * s, -4.0 * s, 12.0 * s]).sin_cos(1.0);
            let expected = sin_cos(13.0 * s);
            assert!((sin - expected.0).abs() < 1e-15 && (cos - expected.1).abs() < 1e-15, "{s}");
        }
        assert_eq!(TurnRate::new([0.0; 3]).sin_cos(f64::MAX), (0.0, 1.0));
    }
}
