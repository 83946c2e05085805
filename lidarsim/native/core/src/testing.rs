//! Shared helpers of unit tests.

use num_bigint::{BigInt, Sign};

/// Numbers in [0, 1) from a linear congruential generator.
pub fn numbers() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Words of random bits.
pub fn words() -> impl FnMut() -> u64 {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    }
}

/// Runs a test on a large stack: unoptimized code has large frames.
pub fn with_large_frames(test: fn()) {
    let thread = std::thread::Builder::new().stack_size(1 << 26).spawn(test);
    assert!(thread.is_ok_and(|thread| thread.join().is_ok()));
}

/// The largest score that hill climbing finds, and its argument. From each of several starts, each step
/// changes one number a little or redraws it, and is kept if the score does not fall.
pub fn worst<const N: usize>(
    starts: usize,
    steps: usize,
    mut draw: impl FnMut(usize, &mut dyn FnMut() -> f64) -> f64,
    mut score: impl FnMut(&[f64; N]) -> f64,
) -> (f64, [f64; N]) {
    let mut next = numbers();
    let mut best = (f64::NEG_INFINITY, [0.0; N]);
    for _ in 0..starts {
        let mut at: [f64; N] = std::array::from_fn(|i| draw(i, &mut next));
        let mut height = score(&at);
        for _ in 0..steps {
            let (i, kind) = ((N as f64 * next()) as usize, (4.0 * next()) as u32);
            let mut other = at;
            other[i] = match kind {
                0 => draw(i, &mut next),
                1 => at[i].next_up(),
                2 => at[i].next_down(),
                _ => at[i] * (1.0 + (next() - 0.5) * 2.0_f64.powi(-(50.0 * next()) as i32)),
            };
            let reached = score(&other);
            if reached >= height {
                (at, height) = (other, reached);
            }
        }
        if height > best.0 {
            best = (height, at);
        }
    }
    best
}

/// Asserts that the worst case is about as known: a bound has this much slack and no more, so that no change
/// to it goes unnoticed.
pub fn assert_slack(what: &str, worst: f64, known: f64) {
    assert!(worst <= 1.0, "{what}: the bound is exceeded: {worst}");
    assert!(0.8 * known <= worst && worst <= 1.25 * known, "{what}: {worst} of the bound, {known} was known");
}

/// Fixed-point numbers: multiples of 2⁻³²⁰, rounded down.
const BITS: u64 = 320;

pub fn fixed_point(x: f64) -> BigInt {
    let exponent = ((x.to_bits() >> 52 & 0x7ff) as i64 - 1075).max(-1074);
    let mantissa = BigInt::from(
        (x / 2.0_f64.powi(exponent as i32 / 2) / 2.0_f64.powi(exponent as i32 - exponent as i32 / 2)) as i64,
    );
    let shift = BITS as i64 + exponent;
    if shift >= 0 { mantissa << shift as u64 } else { mantissa >> -shift as u64 }
}

fn one() -> BigInt {
    BigInt::from(1) << BITS
}

/// x/2³²⁰, for |x| not too large.
pub fn float(x: &BigInt) -> f64 {
    let cut: BigInt = x >> (BITS - 200);
    let digits: Vec<u32> = cut.iter_u32_digits().collect();
    let sum = digits.iter().rev().fold(0.0, |sum, &digit| sum * 4294967296.0 + f64::from(digit));
    let sign = if cut.sign() == Sign::Minus { -1.0 } else { 1.0 };
    sign * sum * 2.0_f64.powi(-200)
}

/// x/1 + s·x³/3 + x⁵/5 + s·x⁷/7 + … for x = 1/n: arctan x (s = −1) or artanh x (s = 1).
pub fn arc(n: i64, s: i64) -> BigInt {
    let (mut sum, mut power, mut k) = (BigInt::ZERO, one() / n, 1);
    while power != BigInt::ZERO {
        sum += &power / k * if k % 4 == 3 { s } else { 1 };
        power /= n * n;
        k += 2;
    }
    sum
}

/// Machin's formula.
pub fn half_pi() -> BigInt {
    arc(5, -1) * 8 - arc(239, -1) * 2
}

/// Σ xⁱ/i! over i = `first`, `first` + `step`, …; each sign is `sign` times the one before.
pub fn series(x: &BigInt, first: u32, step: u32, sign: i64) -> BigInt {
    let (mut sum, mut term, mut flip) = (BigInt::ZERO, one(), 1);
    for i in 0.. {
        if i >= first && (i - first).is_multiple_of(step) {
            sum += &term * flip;
            flip *= sign;
        }
        term = (term * x / (i + 1)) >> BITS;
        if i > 200 {
            break;
        }
    }
    sum
}
