//! Counter-based random numbers: a draw depends on its purpose, never on earlier draws.
//!
//! Philox4x32-10 (J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw: Parallel random numbers: as easy as 1,
//! 2, 3. SC11) turns a counter and a key into 128 random bits. A Gaussian is one uniform through the inverse
//! of the normal distribution.

use crate::arith::elementary::{ln, polynomial};
use crate::arith::simd::{Isa, Task};

/// The permanent id of an effect, a part of the counter: see `effects`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EffectId(pub u16);

/// 128 random bits of a counter and a key.
#[inline(always)]
pub fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let product0 = 0xd251_1f53 * u64::from(counter[0]);
        let product1 = 0xcd9e_8d57 * u64::from(counter[2]);
        counter = [
            (product1 >> 32) as u32 ^ counter[1] ^ key[0],
            product1 as u32,
            (product0 >> 32) as u32 ^ counter[3] ^ key[1],
            product0 as u32,
        ];
        // The golden ratio and √3 − 1, to 32 bits.
        key = [key[0].wrapping_add(0x9e37_79b9), key[1].wrapping_add(0xbb67_ae85)];
    }
    counter
}

/// Uniform in the open interval (0, 1), from random bits: the middle of one of 2⁵² equal cells. So are 1 − u
/// and 1/2 − u, exactly.
#[inline(always)]
pub fn uniform([low, high, ..]: [u32; 4]) -> f64 {
    let cell = (u64::from(high) << 32 | u64::from(low)) >> 12;
    (f64::from_bits(1.0_f64.to_bits() | cell) - 1.0) + f64::EPSILON / 2.0
}

/// The random numbers of one frame of one sensor.
#[derive(Clone, Copy, Debug)]
pub struct Stream {
    key: [u32; 2],
    frame: u32,
}

impl Stream {
    /// The key is itself drawn from seed and sensor, so that no two sensors share draws.
    pub fn new(seed: u64, sensor: u32, frame: u32) -> Self {
        let [first, second, ..] = philox([seed as u32, (seed >> 32) as u32, sensor, 0], [0, 0]);
        Stream { key: [first, second], frame }
    }

    /// The draws of the unit, which are the same in every frame.
    pub fn of_unit(self) -> Self {
        Stream { frame: 0, ..self }
    }

    /// Uniform in the open interval (0, 1).
    #[inline(always)]
    pub fn uniform(&self, pulse: u64, effect: EffectId, draw: u16) -> f64 {
        let purpose = u32::from(effect.0) << 16 | u32::from(draw);
        uniform(philox([pulse as u32, (pulse >> 32) as u32, self.frame, purpose], self.key))
    }

    /// Gaussian with mean 0 and variance 1.
    #[inline(never)]
    pub fn normal(&self, pulse: u64, effect: EffectId, draw: u16) -> f64 {
        normal_quantile(self.uniform(pulse, effect, draw))
    }

    /// Draws a uniform number for each pulse. Many effects draw, so it is compiled once for each instruction
    /// set.
    #[inline(always)]
    pub fn uniforms<I: Isa>(&self, pulses: &[u64], effect: EffectId, draw: u16, uniforms: &mut Vec<f64>) {
        I::call(Uniforms(ForPulses { stream: self, pulses, effect, draw, numbers: uniforms }));
    }

    /// Draws a normal number for each pulse, compiled as `uniforms` is.
    #[inline(always)]
    pub fn normals<I: Isa>(&self, pulses: &[u64], effect: EffectId, draw: u16, normals: &mut Vec<f64>) {
        I::call(Normals(ForPulses { stream: self, pulses, effect, draw, numbers: normals }));
    }
}

/// Random numbers, one for each pulse.
struct ForPulses<'a> {
    stream: &'a Stream,
    pulses: &'a [u64],
    effect: EffectId,
    draw: u16,
    numbers: &'a mut Vec<f64>,
}

struct Uniforms<'a>(ForPulses<'a>);

impl Task for Uniforms<'_> {
    type Output = ();

    /// A loop that becomes vector instructions.
    #[inline(always)]
    fn run<I: Isa>(self) {
        let ForPulses { stream, pulses, effect, draw, numbers } = self.0;
        numbers.resize(pulses.len(), 0.0);
        for (p, pulse) in numbers.iter_mut().zip(pulses) {
            *p = stream.uniform(*pulse, effect, draw);
        }
    }
}

struct Normals<'a>(ForPulses<'a>);

impl Task for Normals<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let ForPulses { stream, pulses, effect, draw, numbers } = self.0;
        stream.uniforms::<I>(pulses, effect, draw, numbers);
        I::call(NormalQuantiles(numbers));
    }
}

/// Replaces each probability by its [`normal_quantile`].
pub(super) struct NormalQuantiles<'a>(pub &'a mut [f64]);

impl Task for NormalQuantiles<'_> {
    type Output = ();

    /// One kind of formula at a time.
    #[inline(always)]
    fn run<I: Isa>(self) {
        let numbers = self.0;
        // The indices of the tails, found without branches: one in seven would be mispredicted.
        let (mut places, mut count) = (vec![0; numbers.len()], 0);
        for (i, &p) in numbers.iter().enumerate() {
            places[count] = i;
            count += usize::from(is_tail(p));
        }
        places.truncate(count);
        let uniforms: Vec<f64> = places.iter().map(|&i| numbers[i]).collect();
        let mut tails = uniforms.clone();
        for p in &mut tails {
            *p = tail(*p);
        }
        for p in numbers.iter_mut() {
            *p = central(*p - 0.5);
        }
        for ((&i, &normal), &p) in places.iter().zip(&tails).zip(&uniforms) {
            numbers[i] = if is_far_tail(p) { far_tail(p) } else { normal };
        }
    }
}

/// The number that a standard normal variable stays below with probability `p`, 0 < p < 1.
///
/// Algorithm AS 241, PPND16 (M. J. Wichura: The percentage points of the normal distribution. Applied
/// Statistics 37, 1988).
#[inline(always)]
pub fn normal_quantile(p: f64) -> f64 {
    if !is_tail(p) {
        central(p - 0.5)
    } else if !is_far_tail(p) {
        tail(p)
    } else {
        far_tail(p)
    }
}

#[inline(always)]
fn is_tail(p: f64) -> bool {
    (p - 0.5).abs() > 0.425
}

/// Further out than √(−ln p) = 5.
#[inline(always)]
fn is_far_tail(p: f64) -> bool {
    p.min(1.0 - p) < 1.388794386496402e-11
}

#[inline(always)]
fn central(q: f64) -> f64 {
    let r = 0.180625 - q * q;
    q * polynomial(CENTRAL.0, r) / polynomial(CENTRAL.1, r)
}

#[inline(always)]
fn tail(p: f64) -> f64 {
    let r = (-ln(p.min(1.0 - p))).sqrt() - 1.6;
    (polynomial(TAIL.0, r) / polynomial(TAIL.1, r)).copysign(p - 0.5)
}

#[cold]
#[inline(never)]
fn far_tail(p: f64) -> f64 {
    let r = (-ln(p.min(1.0 - p))).sqrt() - 5.0;
    (polynomial(FAR_TAIL.0, r) / polynomial(FAR_TAIL.1, r)).copysign(p - 0.5)
}

/// Numerator and denominator.
type Ratio = ([f64; 8], [f64; 8]);

#[expect(clippy::excessive_precision, reason = "the digits as published")]
const CENTRAL: Ratio = (
    [
        3.3871328727963666080e0,
        1.3314166789178437745e2,
        1.9715909503065514427e3,
        1.3731693765509461125e4,
        4.5921953931549871457e4,
        6.7265770927008700853e4,
        3.3430575583588128105e4,
        2.5090809287301226727e3,
    ],
    [
        1.0,
        4.2313330701600911252e1,
        6.8718700749205790830e2,
        5.3941960214247511077e3,
        2.1213794301586595867e4,
        3.9307895800092710610e4,
        2.8729085735721942674e4,
        5.2264952788528545610e3,
    ],
);

#[expect(clippy::excessive_precision, reason = "the digits as published")]
const TAIL: Ratio = (
    [
        1.42343711074968357734e0,
        4.63033784615654529590e0,
        5.76949722146069140550e0,
        3.64784832476320460504e0,
        1.27045825245236838258e0,
        2.41780725177450611770e-1,
        2.27238449892691845833e-2,
        7.74545014278341407640e-4,
    ],
    [
        1.0,
        2.05319162663775882187e0,
        1.67638483018380384940e0,
        6.89767334985100004550e-1,
        1.48103976427480074590e-1,
        1.51986665636164571966e-2,
        5.47593808499534494600e-4,
        1.05075007164441684324e-9,
    ],
);

#[expect(clippy::excessive_precision, reason = "the digits as published")]
const FAR_TAIL: Ratio = (
    [
        6.65790464350110377720e0,
        5.46378491116411436990e0,
        1.78482653991729133580e0,
        2.96560571828504891230e-1,
        2.65321895265761230930e-2,
        1.24266094738807843860e-3,
        2.71155556874348757815e-5,
        2.01033439929228813265e-7,
    ],
    [
        1.0,
        5.99832206555887937690e-1,
        1.36929880922735805310e-1,
        1.48753612908506148525e-2,
        7.86869131145613259100e-4,
        1.84631831751005468180e-5,
        1.42151175831644588870e-7,
        2.04426310338993978564e-15,
    ],
);

#[cfg(test)]
mod tests {
    use super::*;

    /// The known answers that come with the authors' Random123 library.
    #[test]
    fn philox_gives_the_known_answers() {
        assert_eq!(philox([0; 4], [0; 2]), [0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8]);
        assert_eq!(philox([u32::MAX; 4], [u32::MAX; 2]), [0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd]);
        assert_eq!(
            philox([0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344], [0xa4093822, 0x299f31d0]),
            [0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1]
        );
    }

    #[test]
    fn the_uniform_stays_inside_and_is_symmetric() {
        let extreme = |cell: u64| (f64::from_bits(1.0_f64.to_bits() | cell) - 1.0) + f64::EPSILON / 2.0;
        let (least, most) = (extreme(0), extreme((1 << 52) - 1));
        assert!(least > 0.0 && most < 1.0);
        assert_eq!(1.0 - most, least);
        assert!(normal_quantile(least).is_finite());
        assert_eq!(normal_quantile(least), -normal_quantile(most));
    }

    #[test]
    fn the_quantile_rises() {
        let p = (1..100_000).map(|i| i as f64 / 100_000.0);
        let z: Vec<f64> = p.map(normal_quantile).collect();
        assert!(z.windows(2).all(|w| w[0] < w[1]));
        assert_eq!(normal_quantile(0.5), 0.0);
    }

    /// Wichura's own check values.
    #[test]
    fn the_quantile_gives_the_published_values() {
        for (p, z) in [(0.25, -0.6744897501960817), (0.001, -3.090232306167814), (1e-20, -9.262340089798408)]
        {
            assert!((normal_quantile(p) / z - 1.0).abs() < 4e-16, "{p}");
        }
    }
}
