//! Exact arithmetic on dyadic rationals, integers times powers of two. Every float64 is one, and they are
//! closed under sums and products.

use std::borrow::Cow;
use std::cmp::Ordering;

use super::integer::Integer;
use super::{Interval, Kinds, Number, Root, Uncertain, approximate, nearly};
use crate::arith::turns::parts;

/// The number `mantissa · 2^exponent`.
#[derive(Clone, Debug)]
pub struct Dyadic {
    mantissa: Integer,
    exponent: i64,
}

/// Bits of an approximate root: rounded to float64, it is the nearest number or a neighbour of it.
const NEAR_BITS: i64 = 64;

/// Bits of a root beyond those of the longest coefficient; see `value`.
const BEYOND: i64 = 128;

impl Dyadic {
    fn zero() -> Self {
        Dyadic { mantissa: Integer::ZERO, exponent: 0 }
    }

    fn ordering(&self) -> Ordering {
        self.mantissa.sign()
    }

    /// 2^(top − 1) ≤ |self| < 2^top, unless it is zero.
    fn top(&self) -> i64 {
        self.mantissa.bits() as i64 + self.exponent
    }

    /// The sum, or the difference if `minus`.
    fn sum(&self, other: &Self, minus: bool) -> Self {
        if other.mantissa.is_zero() {
            return self.clone();
        }
        if self.mantissa.is_zero() {
            return if minus { other.negated() } else { other.clone() };
        }
        let shift = (self.exponent - other.exponent).unsigned_abs();
        if self.exponent >= other.exponent {
            return Dyadic {
                mantissa: self.mantissa.shifted_plus(shift, &other.mantissa, minus),
                exponent: other.exponent,
            };
        }
        let mut mantissa = other.mantissa.shifted_plus(shift, &self.mantissa, minus);
        if minus {
            mantissa.negate();
        }
        Dyadic { mantissa, exponent: self.exponent }
    }

    /// Rounded to the nearest float64, ties to even; ±∞ on overflow.
    fn nearest(&self) -> f64 {
        if self.mantissa.is_zero() {
            return 0.0;
        }
        let top = self.top();
        if top > 1024 {
            return if self.mantissa.is_negative() { f64::NEG_INFINITY } else { f64::INFINITY };
        }
        let last = (top - 53).max(-1074); // exponent of the last bit of a float64 of this size
        let leading = self.mantissa.leading();
        let keep = top - last;
        let (kept, rest) = match keep {
            ..0 => return self.signed(0.0),
            0 => (0, leading),
            keep => ((leading >> (128 - keep)) as u64, leading << keep),
        };
        const HALF: u128 = 1 << 127;
        let up = rest > HALF || rest == HALF && kept & 1 != 0;
        // At most 2^53, so exact; the product is exact, too, or overflows.
        self.signed(scale((kept + u64::from(up)) as f64, last))
    }

    /// Two float64 numbers whose sum is the number to within u²/2; the second is at most u times the first.
    /// `None` close to overflow or underflow.
    pub(super) fn leading_parts(&self) -> Option<(f64, f64)> {
        let top = self.top();
        if !(-800..=1000).contains(&top) {
            return None;
        }
        let leading = self.mantissa.leading();
        let high = (leading >> 64) as u64;
        // The remainder of the first is at most 2^10, so exact.
        let rest = (i128::from(high) - (high as f64) as i128) as f64 + scale(leading as u64 as f64, -64);
        Some((self.signed(scale(high as f64, top - 64)), self.signed(scale(rest, top - 64))))
    }

    fn signed(&self, magnitude: f64) -> f64 {
        if self.mantissa.is_negative() { -magnitude } else { magnitude }
    }

    /// √self for self ≥ 0: exact if the root is dyadic, else truncated to at least this many bits.
    fn sqrt(&self, bits: i64) -> Self {
        if self.mantissa.is_zero() {
            return Dyadic::zero();
        }
        let mut shift = (2 * bits - self.mantissa.bits() as i64).max(0);
        if (self.exponent - shift) % 2 != 0 {
            shift += 1;
        }
        let root = (self.mantissa.magnitude() << shift as u64).sqrt();
        Dyadic { mantissa: Integer::from_magnitude(false, &root), exponent: (self.exponent - shift) / 2 }
    }

    /// The quotient, truncated to at least this many bits, and whether it is exact.
    fn quotient(&self, den: &Self, bits: i64) -> (Self, bool) {
        let shift = (den.mantissa.bits() as i64 - self.mantissa.bits() as i64 + bits).max(0);
        let (n, d) = (self.mantissa.magnitude() << shift as u64, den.mantissa.magnitude());
        let quotient = &n / &d;
        let negative = self.mantissa.is_negative() != den.mantissa.is_negative();
        let mantissa = Integer::from_magnitude(negative, &quotient);
        (Dyadic { mantissa, exponent: self.exponent - den.exponent - shift }, quotient * d == n)
    }

    /// The quotient rounded to the nearest float64, ties to even; ±∞ on overflow.
    fn ratio(&self, den: &Self) -> f64 {
        // At least 66 bits, and a sticky bit below them.
        let (quotient, is_exact) = self.quotient(den, 66);
        let sticky = Integer::new(quotient.mantissa.is_negative(), u64::from(!is_exact));
        Dyadic {
            mantissa: quotient.mantissa.shifted_plus(1, &sticky, false),
            exponent: quotient.exponent - 1,
        }
        .nearest()
    }

    /// The root as a quotient of sums without cancellation, as in `RunningError::of_root`, with its square
    /// root truncated to `bits`.
    fn fraction(root: &Root<Self>, bits: i64) -> (Self, Self) {
        if root.branch == 0 {
            return (root.b.clone(), root.a.clone());
        }
        let s = root.disc.sqrt(bits);
        let s = if root.branch < 0 { s.negated() } else { s };
        let sign = root.b.ordering();
        if sign != Ordering::Equal && (sign == Ordering::Greater) != (root.branch > 0) {
            (root.c.clone(), root.b.minus(&s))
        } else {
            (root.b.plus(&s), root.a.clone())
        }
    }

    /// The order of the root and x: the sign of (b − x·a) + branch·√disc, as a > 0.
    fn compare_with(root: &Root<Self>, x: &Self) -> Ordering {
        Self::surd(&root.b.minus(&x.times(&root.a)), &Self::exact(f64::from(root.branch)), &root.disc)
    }

    /// The order of the root and the midpoint of two neighbours; an infinite neighbour counts as
    /// ±2¹⁰²⁴, as in rounding.
    fn compare_with_middle(root: &Root<Self>, low: f64, high: f64) -> Ordering {
        Self::compare_with(root, &Self::exact(low).plus(&Self::exact(high)).times(&Self::exact(0.5)))
    }

    /// Sign of p + x·√d + y·√e, for d, e ≥ 0. Once both sides of a comparison have the same sign,
    /// they may be squared.
    fn sign_of_two_surds(p: &Self, x: &Self, d: &Self, y: &Self, e: &Self) -> Ordering {
        let left = Self::surd(p, x, d);
        let right = surd_term(&y.negated(), e);
        if left != right || left == Ordering::Equal {
            return left.cmp(&right);
        }
        // left² − right² = (p² + x²d − y²e) + 2px·√d
        let squared = p.squared().plus(&x.squared().times(d)).minus(&y.squared().times(e));
        let twice = Dyadic::exact(2.0).times(p).times(x);
        let order = Self::surd(&squared, &twice, d);
        if left == Ordering::Greater { order } else { order.reverse() }
    }

    fn surd(p: &Self, q: &Self, d: &Self) -> Ordering {
        let (left, right) = (p.ordering(), surd_term(&q.negated(), d));
        if left != right || left == Ordering::Equal {
            return left.cmp(&right);
        }
        let [near_p, near_q, near_d] = [p, q, d].map(nearly);
        let order = near_p.squared().minus(&near_q.squared().times(&near_d)).sign();
        let order = order.unwrap_or_else(|Uncertain| p.squared().minus(&q.squared().times(d)).ordering());
        if left == Ordering::Greater { order } else { order.reverse() }
    }
}

/// Sign of q·√d.
fn surd_term(q: &Dyadic, d: &Dyadic) -> Ordering {
    if d.ordering() == Ordering::Equal { Ordering::Equal } else { q.ordering() }
}

/// x · 2^k for −1074 ≤ k ≤ 971; exact unless it overflows.
fn scale(x: f64, k: i64) -> f64 {
    let power = |k: i64| f64::from_bits(((k + 1023) as u64) << 52);
    if k < -1000 { x * power(k + 200) * power(-200) } else { x * power(k) }
}

impl Number for Dyadic {
    type Floats = f64;

    /// ±∞ becomes ±2¹⁰²⁴.
    fn exact(x: f64) -> Self {
        let (mantissa, exponent) = parts(x);
        if mantissa == 0 {
            return Dyadic::zero();
        }
        let zeros = mantissa.trailing_zeros();
        Dyadic { mantissa: Integer::new(x < 0.0, mantissa >> zeros), exponent: exponent + i64::from(zeros) }
    }

    fn plus(&self, other: &Self) -> Self {
        self.sum(other, false)
    }

    fn minus(&self, other: &Self) -> Self {
        self.sum(other, true)
    }

    fn times(&self, other: &Self) -> Self {
        Dyadic { mantissa: self.mantissa.times(&other.mantissa), exponent: self.exponent + other.exponent }
    }

    fn negated(&self) -> Self {
        let mut negated = self.clone();
        negated.mantissa.negate();
        negated
    }

    fn sign(&self) -> Result<Ordering, Uncertain> {
        Ok(self.ordering())
    }

    fn sign_of_surd(p: &Self, q: &Self, d: &Self) -> Result<Ordering, Uncertain> {
        Ok(Self::surd(p, q, d))
    }

    fn compare(a: &Root<Self>, b: &Root<Self>) -> Result<Ordering, Uncertain> {
        if a.branch != 0 || b.branch != 0 {
            let order = Number::compare(&approximate(a), &approximate(b));
            if order.is_ok() {
                return order;
            }
        }
        // t₁ − t₂ has the sign of p + β₁a₂·√d₁ − β₂a₁·√d₂, as a₁, a₂ > 0.
        let p = a.b.times(&b.a).minus(&b.b.times(&a.a));
        let x = Dyadic::exact(f64::from(a.branch)).times(&b.a);
        let y = Dyadic::exact(f64::from(-b.branch)).times(&a.a);
        Ok(Self::sign_of_two_surds(&p, &x, &a.disc, &y, &b.disc))
    }

    fn locate(_: &Root<Self>) -> Result<Option<Self>, Uncertain> {
        Ok(None)
    }

    /// Near a midpoint of two float64 numbers no number of bits of a root tells which side it is on. So the
    /// root itself is compared with the midpoints around a float64 near it.
    fn round(root: &Root<Self>) -> Result<f64, Uncertain> {
        let t = Number::round(&approximate(root));
        if t.is_ok() {
            return t;
        }
        let (num, den) = Self::fraction(root, NEAR_BITS);
        let near = num.ratio(&den);
        if root.branch == 0 {
            return Ok(near);
        }
        let (below, above) = (near.next_down(), near.next_up());
        let is_odd = near.to_bits() & 1 != 0;
        Ok(match Self::compare_with_middle(root, below, near) {
            Ordering::Less => below,
            Ordering::Equal if is_odd => below,
            _ => match Self::compare_with_middle(root, near, above) {
                Ordering::Greater => above,
                Ordering::Equal if is_odd => above,
                _ => near,
            },
        })
    }

    /// In a normal, the origin and t·d may cancel by as many bits as the longest coefficient has.
    fn value(root: &Root<Self>) -> Result<Self, Uncertain> {
        let longest =
            [&root.a, &root.b, &root.c, &root.disc].map(|x| x.mantissa.bits() as i64).into_iter().max();
        let bits = longest.unwrap_or(0) + BEYOND;
        let (num, den) = Self::fraction(root, bits);
        Ok(num.quotient(&den, bits).0)
    }

    fn split(&self) -> (f64, Self) {
        let near = self.nearest().clamp(f64::MIN, f64::MAX);
        (near, self.minus(&Dyadic::exact(near)))
    }

    fn of_kinds<K: Kinds>(kinds: &K) -> Cow<'_, K::In<Self>> {
        Cow::Borrowed(kinds.dyadic())
    }

    fn proportions(v: &[Self; 3]) -> Result<[f64; 3], Uncertain> {
        let largest = v.iter().filter(|x| !x.mantissa.is_zero()).map(Self::top).max().unwrap_or(0);
        Ok(v.each_ref()
            .map(|x| Dyadic { mantissa: x.mantissa.clone(), exponent: x.exponent - largest }.nearest()))
    }

    fn enclose(root: &Root<Self>) -> Result<Interval, Uncertain> {
        let t = Self::round(root)?;
        Ok(Interval { low: t.next_down(), high: t.next_up() })
    }
}

#[cfg(test)]
mod tests {
    use num_bigint::BigUint;

    use super::*;

    #[test]
    fn rounds_quotients_like_the_processor() {
        let numbers = [1.0, 3.0, -7.0, 0.1, 1e-300, -2.5e300, 5e-324, 1.7976931348623157e308, 6.0];
        let mut checked = 0;
        for a in numbers {
            for b in numbers {
                assert_eq!(
                    Dyadic::exact(a).ratio(&Dyadic::exact(b)).to_bits(),
                    (a / b).to_bits(),
                    "{a} / {b}"
                );
                checked += 1;
            }
        }
        assert_eq!(checked, 81);
    }

    #[test]
    fn square_roots_round_like_the_processor() {
        for x in [2.0, 4.0, 0.3, 1e-310, 5e-324, 1e300, 9007199254740993.0] {
            let root = Dyadic::exact(x).sqrt(256).ratio(&Dyadic::exact(1.0));
            assert_eq!(root.to_bits(), f64::sqrt(x).to_bits(), "√{x}");
        }
    }

    /// A quotient whose distance from a midpoint of two float64 numbers is below 2⁻³⁰⁰ of itself.
    #[test]
    fn quotients_next_to_midpoints_are_rounded_to_nearest() {
        let divisor =
            Dyadic { mantissa: Integer::from_magnitude(false, &BigUint::from(3_u32).pow(200)), exponent: -7 };
        for (middle, low, high) in [(9007199254740993_u64, 0.0, 2.0), (9007199254740995, 0.0, 2.0)] {
            let whole = divisor.times(&Dyadic { mantissa: Integer::new(false, middle), exponent: 0 });
            for (less, expected) in [(true, low), (false, high)] {
                let beside = whole.plus(&Dyadic { mantissa: Integer::new(less, 1), exponent: -7 });
                assert_eq!(beside.ratio(&divisor), (middle - 1) as f64 + expected, "{middle}, {less}");
            }
        }
    }

    /// Both roots of t² − 2bt + b² − disc = 0.
    fn roots(b: Dyadic, disc: Dyadic) -> [Root<Dyadic>; 2] {
        let c = b.squared().minus(&disc);
        match Root::quadratic(Dyadic::exact(1.0), b, c, disc, Ordering::Greater, 0) {
            [Some(first), Some(second)] => [first, second],
            _ => unreachable!("there are two"),
        }
    }

    #[test]
    fn roots_without_an_end_are_rounded_like_those_of_the_processor() {
        // Some sizes are beyond what double-double resolves.
        for (k, scale) in (2..2000).zip([1.0, 2.0_f64.powi(-450), 2.0_f64.powi(505)].into_iter().cycle()) {
            let x = f64::from(k) * 1.1;
            let disc = Dyadic::exact(x).times(&Dyadic::exact(scale).squared());
            for (root, expected) in
                roots(Dyadic::zero(), disc).iter().zip([-x.sqrt() * scale, x.sqrt() * scale])
            {
                assert_eq!(Dyadic::round(root), Ok(expected), "√{x}");
                let Ok(Interval { low, high }) = Dyadic::enclose(root) else {
                    unreachable!("that is certain")
                };
                let beside = [low, high].map(|x| Dyadic::compare_with(root, &Dyadic::exact(x)));
                assert_eq!(beside, [Ordering::Greater, Ordering::Less], "√{x}");
            }
        }
    }

    #[test]
    fn roots_next_to_midpoints_are_rounded_to_nearest() {
        let number = |mantissa: i64, exponent| Dyadic {
            mantissa: Integer::new(mantissa < 0, mantissa.unsigned_abs()),
            exponent,
        };
        let mut checked = 0;
        for x in [
            1.0,
            1.0_f64.next_up(),
            2.0,
            -3.0,
            5e-324,
            1e-320,
            f64::MIN_POSITIVE,
            1e300,
            f64::MAX.next_down(),
        ] {
            for (low, high) in [(x, x.next_up()), (x.next_down(), x)] {
                let even = if low.to_bits() & 1 == 0 { low } else { high };
                let middle = number(1, -1).times(&Dyadic::exact(low).plus(&Dyadic::exact(high)));
                for away in [-1, -60, -200, -256, -300, -1000, -5000] {
                    // b ± √disc is the midpoint, or differs from it by less than 2^away of the root of the
                    // discriminant.
                    let s = number(3, middle.exponent);
                    for (off, expected) in [(-1, [low, high]), (0, [even, even]), (1, [high, low])] {
                        let disc = s.squared().times(&number(1, 0).plus(&number(off, away)));
                        // The second root is above b, the first below; both cross the midpoint as the
                        // discriminant changes.
                        for (branch, b) in [(1, middle.minus(&s)), (0, middle.plus(&s))] {
                            let near = Dyadic::compare_with_middle(
                                &roots(b.clone(), disc.clone())[branch],
                                low,
                                high,
                            );
                            assert_eq!(near, if branch == 1 { off.cmp(&0) } else { 0.cmp(&off) });
                            if away < -1 {
                                let rounded = Dyadic::round(&roots(b, disc.clone())[branch]);
                                assert_eq!(rounded, Ok(expected[1 - branch]), "{x}, {away}, {off}, {branch}");
                                checked += 1;
                            }
                        }
                    }
                }
            }
        }
        assert_eq!(checked, 9 * 2 * 6 * 3 * 2);
    }

    #[test]
    fn roots_beyond_the_largest_number_are_infinite_from_its_midpoint_on() {
        let number = |mantissa: i64, exponent| Dyadic {
            mantissa: Integer::new(mantissa < 0, mantissa.unsigned_abs()),
            exponent,
        };
        let middle = Dyadic::exact(f64::MAX).plus(&number(1, 970));
        for (off, expected) in [(-1, f64::MAX), (0, f64::INFINITY), (1, f64::INFINITY)] {
            let disc = number(1, 0).plus(&number(off, -3000));
            let [_, root] = roots(middle.minus(&number(1, 0)), disc.clone());
            assert_eq!(Dyadic::round(&root), Ok(expected));
            let [root, _] = roots(middle.negated().plus(&number(1, 0)), disc);
            assert_eq!(Dyadic::round(&root), Ok(-expected));
        }
    }

    #[test]
    fn compares_sums_of_surds() {
        let n = Dyadic::exact;
        // √2 + √3 against 3.1462643699419723 (rounded down) and its successor.
        let below = 3.146264369941972_f64;
        for (p, expected) in [(below, Ordering::Greater), (below.next_up(), Ordering::Less)] {
            let order = Dyadic::sign_of_two_surds(&n(-p), &n(1.0), &n(2.0), &n(1.0), &n(3.0));
            assert_eq!(order, expected);
        }
        // 1 + √4 − √9 = 0
        let order = Dyadic::sign_of_two_surds(&n(1.0), &n(1.0), &n(4.0), &n(-1.0), &n(9.0));
        assert_eq!(order, Ordering::Equal);
    }
}
