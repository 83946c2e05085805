//! Integers of any length. The limbs of short ones are stored inline, without an allocation.

use std::cmp::Ordering;

use num_bigint::BigUint;

/// Inline limbs: enough for the predicates of all shapes at float64 coordinates of about one size.
const LIMBS: usize = 8;

/// Sign and magnitude.
#[derive(Clone, Debug)]
pub struct Integer {
    /// False for zero.
    negative: bool,
    /// The number of limbs, without leading zeros.
    length: usize,
    /// The least significant limb first; unused by longer integers.
    short: [u64; LIMBS],
    /// All limbs of an integer that has more than `LIMBS`.
    long: Vec<u64>,
}

impl Integer {
    pub const ZERO: Self = Integer { negative: false, length: 0, short: [0; LIMBS], long: Vec::new() };

    pub fn new(negative: bool, magnitude: u64) -> Self {
        Self::of_two_limbs(negative, u128::from(magnitude))
    }

    /// The magnitude of an integer of at most two limbs.
    #[inline(always)]
    fn low(&self) -> u128 {
        u128::from(self.short[1]) << 64 | u128::from(self.short[0])
    }

    #[inline(always)]
    fn of_two_limbs(negative: bool, magnitude: u128) -> Self {
        let mut integer = Self::ZERO;
        (integer.short[0], integer.short[1]) = (magnitude as u64, (magnitude >> 64) as u64);
        integer.length = usize::from(magnitude != 0) + usize::from(integer.short[1] != 0);
        integer.negative = negative && magnitude != 0;
        integer
    }

    pub fn from_magnitude(negative: bool, magnitude: &BigUint) -> Self {
        let mut integer = Self::of_length(negative, magnitude.bits().div_ceil(64) as usize);
        for (limb, digit) in integer.limbs_mut().iter_mut().zip(magnitude.iter_u64_digits()) {
            *limb = digit;
        }
        integer.trim();
        integer
    }

    /// With zeroed limbs, to be written and trimmed.
    #[inline(always)]
    fn of_length(negative: bool, length: usize) -> Self {
        let long = if length > LIMBS { vec![0; length] } else { Vec::new() };
        Integer { negative, length, short: [0; LIMBS], long }
    }

    #[inline(always)]
    fn limbs(&self) -> &[u64] {
        if self.length > LIMBS { &self.long[..self.length] } else { &self.short[..self.length] }
    }

    #[inline(always)]
    fn limbs_mut(&mut self) -> &mut [u64] {
        if self.length > LIMBS { &mut self.long[..self.length] } else { &mut self.short[..self.length] }
    }

    /// Removes leading zeros, and the sign of zero.
    #[inline(always)]
    fn trim(&mut self) {
        let length = self.limbs().iter().rposition(|limb| *limb != 0).map_or(0, |last| last + 1);
        if self.length > LIMBS && length <= LIMBS {
            self.short.copy_from_slice(&std::mem::take(&mut self.long)[..LIMBS]);
        }
        self.length = length;
        self.negative &= length > 0;
    }

    /// The order of the integer and zero.
    pub fn sign(&self) -> Ordering {
        if self.negative { Ordering::Less } else { 0.cmp(&self.length).reverse() }
    }

    pub fn is_zero(&self) -> bool {
        self.length == 0
    }

    pub fn is_negative(&self) -> bool {
        self.negative
    }

    /// The length of the magnitude in bits.
    #[inline(always)]
    pub fn bits(&self) -> u64 {
        self.limbs().last().map_or(0, |last| 64 * self.length as u64 - u64::from(last.leading_zeros()))
    }

    /// The 128 leading bits of the magnitude, padded with zeros. If the magnitude is longer, the last bit is
    /// set if any bit beyond it is.
    pub fn leading(&self) -> u128 {
        let limbs = self.limbs();
        let limb = |k: usize| if k < limbs.len() { limbs[limbs.len() - 1 - k] } else { 0 };
        let (wide, shift) = (u128::from(limb(0)) << 64 | u128::from(limb(1)), limb(0).leading_zeros());
        let next = u128::from(limb(2)) << shift;
        let below = next as u64 != 0 || (3..limbs.len()).any(|k| limb(k) != 0);
        wide << shift | next >> 64 | u128::from(below)
    }

    pub fn magnitude(&self) -> BigUint {
        BigUint::new(self.limbs().iter().flat_map(|limb| [*limb as u32, (*limb >> 32) as u32]).collect())
    }

    pub fn negate(&mut self) {
        self.negative = !self.negative && self.length > 0;
    }

    /// self · 2^shift + other, or − other if `minus`.
    pub fn shifted_plus(&self, shift: u64, other: &Self, minus: bool) -> Self {
        let bits = (self.bits() + shift).max(other.bits()) + 1;
        if bits <= 128 {
            let (x, y) = (self.low() << shift, other.low());
            let other_negative = other.negative != minus;
            if self.negative == other_negative {
                return Self::of_two_limbs(self.negative, x + y);
            }
            return if x >= y {
                Self::of_two_limbs(self.negative, x - y)
            } else {
                Self::of_two_limbs(other_negative, y - x)
            };
        }
        let length = bits.div_ceil(64) as usize;
        let mut sum = Self::of_length(self.negative, length);
        let (limbs, added) = (sum.limbs_mut(), other.limbs());
        let (whole, part) = ((shift / 64) as usize, shift % 64);
        let mut above = 0;
        for (i, &x) in self.limbs().iter().enumerate() {
            let wide = u128::from(x) << part;
            limbs[whole + i] = wide as u64 | above;
            above = (wide >> 64) as u64;
        }
        if above != 0 {
            limbs[whole + self.length] = above;
        }
        let at = |i: usize| if i < added.len() { added[i] } else { 0 };
        let mut carry = false;
        if self.negative == (other.negative != minus) {
            for (i, x) in limbs.iter_mut().enumerate() {
                let (partial, over) = x.overflowing_add(at(i));
                let (total, again) = partial.overflowing_add(u64::from(carry));
                (*x, carry) = (total, over | again);
            }
        } else {
            for (i, x) in limbs.iter_mut().enumerate() {
                let (partial, under) = x.overflowing_sub(at(i));
                let (total, again) = partial.overflowing_sub(u64::from(carry));
                (*x, carry) = (total, under | again);
            }
            if carry {
                // The other is larger: the remainder is 2^(64·length) less the difference.
                for x in limbs.iter_mut() {
                    (*x, carry) = (!*x).overflowing_add(u64::from(carry));
                }
                sum.negative = !sum.negative;
            }
        }
        sum.trim();
        sum
    }

    pub fn times(&self, other: &Self) -> Self {
        if self.length <= 1 && other.length <= 1 {
            return Self::of_two_limbs(
                self.negative != other.negative,
                u128::from(self.short[0]) * u128::from(other.short[0]),
            );
        }
        let mut product = Self::of_length(self.negative != other.negative, self.length + other.length);
        let (limbs, factor) = (product.limbs_mut(), other.limbs());
        for (i, &x) in self.limbs().iter().enumerate() {
            let row = &mut limbs[i..=i + factor.len()];
            let mut carry = 0;
            for (to, &y) in row.iter_mut().zip(factor) {
                let wide = u128::from(x) * u128::from(y) + u128::from(*to) + u128::from(carry);
                (*to, carry) = (wide as u64, (wide >> 64) as u64);
            }
            row[factor.len()] = carry;
        }
        product.trim();
        product
    }
}

#[cfg(test)]
mod tests {
    use num_bigint::{BigInt, Sign};

    use super::*;
    use crate::testing::words;

    /// Magnitudes of lengths around limbs and around the longest short integer: powers of two, their
    /// predecessors, and others.
    fn integers() -> Vec<BigInt> {
        let mut next = words();
        let mut found = vec![BigInt::ZERO];
        for bits in [
            1, 2, 53, 63, 64, 65, 127, 128, 129, 191, 192, 256, 320, 447, 448, 449, 510, 511, 512, 513, 576,
            1100,
        ] {
            let power: BigInt = BigInt::from(1) << (bits - 1);
            let digits: Vec<u32> = (0..40).map(|_| next() as u32).collect();
            let random = BigInt::from_biguint(Sign::Plus, BigUint::new(digits)) % &power;
            let holes = (BigInt::from(next()) << (bits / 2)) % &power;
            for x in [power.clone(), 2 * &power - 1, &power + random, &power + holes] {
                found.extend([-&x, x]);
            }
        }
        found
    }

    fn integer(x: &BigInt) -> Integer {
        Integer::from_magnitude(x.sign() == Sign::Minus, x.magnitude())
    }

    /// The same number, with the fewest limbs and in the right storage.
    fn assert_is(found: &Integer, expected: &BigInt) {
        assert_eq!(found.limbs(), expected.iter_u64_digits().collect::<Vec<_>>());
        assert_eq!(found.negative, expected.sign() == Sign::Minus);
        assert!(found.short[found.length.min(LIMBS)..].iter().all(|limb| *limb == 0), "{found:?}");
    }

    #[test]
    fn sums_and_products_are_those_of_big_integers() {
        let all = integers();
        let (mut short, mut long) = (0, 0);
        for x in &all {
            for y in &all {
                let (a, b) = (integer(x), integer(y));
                for shift in [0, 1, 63, 64, 65, 127, 200, 448, 511, 600] {
                    let sum = a.shifted_plus(shift, &b, false);
                    assert_is(&sum, &((x << shift) + y));
                    assert_is(&a.shifted_plus(shift, &b, true), &((x << shift) - y));
                    // A sum that cancels.
                    assert_is(&a.shifted_plus(shift, &integer(&(y - (x << shift))), false), y);
                    *(if sum.long.is_empty() { &mut short } else { &mut long }) += 1;
                }
                assert_is(&a.times(&b), &(x * y));
            }
        }
        assert!(short > 50_000 && long > 50_000, "{short}, {long}");
    }

    #[test]
    fn an_integer_is_as_it_was_made() {
        for x in integers() {
            let a = integer(&x);
            assert_is(&a, &x);
            let mut negated = a.clone();
            negated.negate();
            assert_is(&negated, &-&x);
            assert_eq!((a.sign(), a.bits()), (x.cmp(&BigInt::ZERO), x.bits()));
            assert_eq!((a.is_zero(), a.is_negative()), (x == BigInt::ZERO, x < BigInt::ZERO));
            assert_eq!(&a.magnitude(), x.magnitude());
            if x.bits() <= 64 {
                let magnitude = x.iter_u64_digits().next().unwrap_or(0);
                assert_is(&Integer::new(x.sign() == Sign::Minus, magnitude), &x);
            }
        }
        assert_is(&Integer::new(true, 0), &BigInt::ZERO);
    }

    #[test]
    fn leading_bits_tell_what_is_beyond_them() {
        let mut beyond = 0;
        for x in integers().into_iter().filter(|x| *x != BigInt::ZERO) {
            let (magnitude, bits) = (x.magnitude(), x.bits());
            let expected = if bits <= 128 {
                magnitude << (128 - bits)
            } else {
                let cut = magnitude >> (bits - 128);
                let is_cut = &cut << (bits - 128) != *magnitude;
                beyond += u32::from(is_cut && !cut.bit(0));
                if is_cut { cut | BigUint::from(1_u32) } else { cut }
            };
            assert_eq!(BigUint::from(integer(&x).leading()), expected, "{x}");
        }
        assert!(beyond > 10, "{beyond}");
    }
}
