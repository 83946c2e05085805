//! The signs of the slope of a waveform.

use super::beam::REACH;
use crate::arith::elementary::exp;
use crate::arith::simd::{Floats, Isa, lanes};
use crate::memory::resize;

/// Unit roundoff of float32.
const U: f32 = f32::EPSILON / 2.0;

/// The Gaussians of a waveform. Its memory is reused from one pulse to the next.
#[derive(Default)]
pub(super) struct Gaussians {
    all: Vec<Gaussian>,
    /// Samples that float32 leaves uncertain, their places and indices.
    uncertain: Vec<f64>,
    indices: Vec<usize>,
}

#[derive(Clone, Copy)]
struct Gaussian {
    range: f64,
    /// Power over σ², and 1/σ.
    weight: f64,
    inverse: f64,
    /// Beyond this distance it is dark.
    reach: f64,
}

impl Gaussians {
    pub(super) fn clear(&mut self) {
        self.all.clear();
    }

    pub(super) fn add(&mut self, range: f64, power: f64, variance: f64) {
        let (sigma, weight) = (variance.sqrt(), power / variance);
        let inverse = 1.0 / sigma;
        self.all.push(Gaussian { range, weight, inverse, reach: REACH * sigma });
    }

    /// Writes numbers of the signs of the slope at these places.
    #[inline(always)]
    pub(super) fn slopes<I: Isa>(&mut self, places: &[f64], slopes: &mut Vec<f64>) {
        slopes.clear();
        resize(slopes, places.len(), 0.0);
        self.uncertain.clear();
        self.indices.clear();
        let most = self.all.iter().fold(0.0_f64, |most, gaussian| gaussian.weight.max(most));
        for (block, places) in places.chunks(16).enumerate() {
            let mut sixteen = [places[0]; 16];
            sixteen[..places.len()].copy_from_slice(places);
            let (estimates, certain) = self.estimate::<I>(&sixteen, most);
            for (k, (place, estimate)) in places.iter().zip(estimates).enumerate() {
                if certain >> k & 1 != 0 {
                    slopes[16 * block + k] = f64::from(estimate);
                } else {
                    self.uncertain.push(*place);
                    self.indices.push(16 * block + k);
                }
            }
        }
        for (places, indices) in self.uncertain.chunks(8).zip(self.indices.chunks(8)) {
            let mut eight = [places[0]; 8];
            eight[..places.len()].copy_from_slice(places);
            for (index, slope) in indices.iter().zip(self.sum(&eight)) {
                slopes[*index] = slope;
            }
        }
    }

    /// The slopes at eight places.
    #[inline(always)]
    fn sum(&self, places: &[f64; 8]) -> [f64; 8] {
        let mut slopes = [0.0; 8];
        for Gaussian { range, weight, inverse, reach } in &self.all {
            for k in 0..8 {
                let way = (range - places[k]) * inverse;
                let part = weight * way * exp(-0.5 * (way * way));
                let is_near = (places[k] >= range - reach) & (places[k] <= range + reach);
                slopes[k] += if is_near { part } else { 0.0 };
            }
        }
        slopes
    }

    /// The slopes at sixteen places, over the largest weight, in float32; and those of which the sign is that
    /// of the sum in float64.
    ///
    /// The ways are those of the sum, rounded by u, and what they add is off by (859 + n)·u of `size`, see
    /// `gaussian`: its weight and the products round by 4u, and the sum of n by n·u. In place of 2⁻⁵³
    /// of its own size, which the sum in float64 may be off, there is room in 1024. Where a Gaussian is dark
    /// in the sum, it is below 8.5·e^(−8.5²/2) < 2⁻⁴⁹ of its weight here, as it is where its way
    /// is cut off; and numbers that underflow are less than that. NaN is not certain.
    #[inline(always)]
    fn estimate<I: Isa>(&self, places: &[f64; 16], most: f64) -> ([f32; 16], u32) {
        let [low, high] = [lanes::load::<I::F64x8, 8>(places, 0), lanes::load::<I::F64x8, 8>(places, 1)];
        let zero = I::F32x16::splat(0.0);
        let (mut slope, mut size) = (zero, zero);
        for Gaussian { range, weight, inverse, .. } in &self.all {
            let (range, inverse) = (I::F64x8::splat(*range), I::F64x8::splat(*inverse));
            let way = I::narrow(range.sub(low).mul(inverse), range.sub(high).mul(inverse));
            // NaN stays NaN.
            let way = I::F32x16::splat(-CUT).max(I::F32x16::splat(CUT).min(way));
            let part = gaussian::<I>(way).mul(I::F32x16::splat((weight / most) as f32)).mul(way);
            (slope, size) = (slope.add(part), size.add(part.abs()));
        }
        let n = self.all.len() as f32;
        let off = size.mul(I::F32x16::splat((1024.0 + 2.0 * n) * U)).add(I::F32x16::splat(n * DARK));
        (slope.store(), off.lt(slope.abs()))
    }
}

/// Ways are cut off here, where a Gaussian is dark: e^(−9²/2) does not underflow.
const CUT: f32 = 9.0;

/// 2⁻⁴⁸
const DARK: f32 = 1.0 / (1_u64 << 48) as f32;

/// e^(−x²/2) for |x| ≤ 8.5, to within 855u: p²⁵⁶ with p = e^z and z = −x²/512.
///
/// If x is off by u, z is by 3u of itself, and 256·z by 109u. The series up to z⁵ is off by z⁶/720,
/// less than
/// 0.2u; it rounds by less than 1.4u, and p is 0.868 at least: 1.9u, which are 487u of p²⁵⁶. The squares
/// round by u each, 255u in all as the later ones double what the earlier ones are off. That is 851u, and
/// what is of second order is less than u.
#[inline(always)]
fn gaussian<I: Isa>(x: I::F32x16) -> I::F32x16 {
    let z = x.mul(x).mul(I::F32x16::splat(-1.0 / 512.0));
    let mut p = I::F32x16::splat(1.0 / 120.0);
    for c in [1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        p = p.fused(z, I::F32x16::splat(c));
    }
    for _ in 0..8 {
        p = p.mul(p);
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Level, Task, dispatch};
    use crate::testing::{assert_slack, numbers};

    struct Estimate<'a>(&'a Gaussians, &'a [f64; 16], f64);

    impl Task for Estimate<'_> {
        type Output = ([f32; 16], u32);

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            self.0.estimate::<I>(self.1, self.2)
        }
    }

    struct Slopes<'a>(&'a mut Gaussians, &'a [f64]);

    impl Task for Slopes<'_> {
        type Output = Vec<f64>;

        #[inline(always)]
        fn run<I: Isa>(self) -> Vec<f64> {
            let mut slopes = vec![7.0];
            self.0.slopes::<I>(self.1, &mut slopes);
            slopes
        }
    }

    fn levels() -> impl Iterator<Item = Level> {
        Level::ALL.into_iter().filter(|level| *level <= Level::best())
    }

    /// Of a few lights about 20 m, and places among them.
    fn draw(count: usize, next: &mut impl FnMut() -> f64) -> (Gaussians, [f64; 16]) {
        let mut gaussians = Gaussians::default();
        for _ in 0..count {
            let sigma = 0.1 + next();
            gaussians.add(20.0 + 12.0 * next(), (20.0 * next()).exp2(), sigma * sigma);
        }
        (gaussians, [0; 16].map(|_: u8| 18.0 + 16.0 * next()))
    }

    #[test]
    fn estimates_are_as_near_as_it_says() {
        let (mut next, mut share) = (numbers(), 0.0_f64);
        for round in 0..2000 {
            let (gaussians, places) = draw(1 + round % 19, &mut next);
            let most = gaussians.all.iter().fold(0.0_f64, |most, one| one.weight.max(most));
            let (n, u) = (gaussians.all.len() as f64, f64::from(U));
            for level in levels() {
                let (estimates, _) = dispatch(level, Estimate(&gaussians, &places, most));
                let halves = places.as_chunks::<8>().0.iter().flat_map(|eight| gaussians.sum(eight));
                for ((place, estimate), slope) in places.iter().zip(estimates).zip(halves) {
                    let size = |one: &Gaussian| {
                        let way = (one.range - place) * one.inverse;
                        (one.weight / most * way * (-0.5 * way * way).exp()).abs()
                    };
                    let size: f64 = gaussians.all.iter().map(size).sum();
                    let bound = (1024.0 + 2.0 * n) * u * size + n * f64::from(DARK);
                    share = share.max((f64::from(estimate) - slope / most).abs() / bound);
                }
            }
        }
        assert_slack("estimates", share, 0.42);
    }

    /// A place half way between two equal lights has no slope, which float32 cannot tell.
    #[test]
    fn signs_are_those_of_the_sum() {
        let odd = [0.0, f64::INFINITY, f64::NAN, 5e-324, 1e-300, 1e300];
        let (mut next, mut certain, mut uncertain) = (numbers(), 0, 0);
        for round in 0..2000 {
            let (mut gaussians, places) = draw(1 + round % 19, &mut next);
            let mut places = places[..1 + round % 16].to_vec();
            if round % 3 == 0 {
                gaussians.clear();
                gaussians.add(20.0, 2.0, 0.25);
                gaussians.add(21.0, 2.0, 0.25);
                places.extend([20.5; 20]);
            }
            if round % 3 == 1 {
                let mut draw = |x: f64| if next() < 0.3 { odd[(6.0 * next()) as usize] } else { x };
                let (range, power, variance) = (draw(25.0), draw(1.0), draw(0.1));
                gaussians.add(range, power, variance);
                places.push(draw(25.0));
            }
            for level in levels() {
                let slopes = dispatch(level, Slopes(&mut gaussians, &places));
                assert_eq!(slopes.len(), places.len());
                for (place, slope) in places.iter().zip(slopes) {
                    let [sum, ..] = gaussians.sum(&[*place; 8]);
                    assert_eq!(
                        [slope > 0.0, slope < 0.0],
                        [sum > 0.0, sum < 0.0],
                        "{place}: {slope}, {sum}, {level:?}"
                    );
                }
                uncertain += gaussians.uncertain.len();
                certain += places.len() - gaussians.uncertain.len();
            }
        }
        assert!(certain > 10_000 && uncertain > 10_000, "{certain}, {uncertain}");
    }
}
