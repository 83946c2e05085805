//! The texture of a surface: small cells that return more or less light than their neighbours.
//!
//! Reflectivity is multiplied by exp(v·g − v²/2), of mean 1, with a standard normal g for each cell of a
//! cubic grid in the object's own coordinates. The random numbers depend on the cell and the object alone,
//! so that all scans of all sensors see the same surface.

use super::rng::{NormalQuantiles, philox, uniform};
use crate::arith::elementary::{exp, ln};
use crate::arith::simd::{Isa, Task};
use crate::geometry::vector::Point;

/// The texture of an object.
#[derive(Clone, Copy, Debug)]
pub struct Grain {
    /// v, the standard deviation of the factor's logarithm.
    sigma: f64,
    /// Edge of a cell, m.
    edge: f64,
    /// Id of the object in its scene, which stays when other objects are removed.
    object: u32,
}

/// Where cells begin, as shares of an edge: faces of objects lie at round coordinates, where rounding would
/// draw one cell or the other.
const SHIFT: [f64; 3] = [0.381_966, 0.618_034, 0.276_393];

/// No stream of pulses has this key: theirs are drawn.
const KEY: [u32; 2] = [0, 1];

impl Grain {
    /// `variation`: relative standard deviation of the factor. None: without texture.
    pub fn new(variation: f64, edge: f64, object: u32) -> Option<Self> {
        // That of a log-normal variable is √(exp(v²) − 1).
        let sigma = ln(1.0 + variation * variation).sqrt();
        (sigma > 0.0).then_some(Grain { sigma, edge, object })
    }

    /// The cell of a point in the object's own coordinates.
    #[inline(always)]
    fn cell(&self, point: Point) -> [u32; 3] {
        [0, 1, 2].map(|axis| (point[axis] / self.edge + SHIFT[axis]).floor() as i64 as u32)
    }
}

/// Hits on objects with texture.
#[derive(Default)]
pub(super) struct GrainHits {
    /// Per hit: its index among all hits.
    indices: Vec<usize>,
    /// Per hit: the coordinates of its cell, and its object.
    counters: [Vec<u32>; 4],
    sigmas: Vec<f64>,
    /// Per hit: the factor of its cell, once computed.
    factors: Vec<f64>,
}

impl GrainHits {
    /// Adds a hit at a point in the object's own coordinates.
    #[inline(always)]
    pub(super) fn push(&mut self, index: usize, grain: &Grain, point: Point) {
        let [x, y, z] = grain.cell(point);
        for (column, number) in self.counters.iter_mut().zip([x, y, z, grain.object]) {
            column.push(number);
        }
        self.indices.push(index);
        self.sigmas.push(grain.sigma);
    }

    /// Multiplies the reflectivities of the hits by the factors of their cells, and clears the hits.
    #[inline(always)]
    pub(super) fn apply<I: Isa>(&mut self, reflectivity: &mut [f64]) {
        if self.indices.is_empty() {
            return;
        }
        I::call(Factors(self));
        for (&i, factor) in self.indices.iter().zip(&self.factors) {
            reflectivity[i] *= factor;
        }
        self.indices.clear();
        self.sigmas.clear();
        self.counters.iter_mut().for_each(Vec::clear);
    }
}

/// Computes the factors of hits, in loops that become vector instructions.
struct Factors<'a>(&'a mut GrainHits);

impl Task for Factors<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let GrainHits { counters: [x, y, z, object], sigmas, factors, .. } = self.0;
        factors.clear();
        factors.extend(
            x.iter()
                .zip(&*y)
                .zip(&*z)
                .zip(&*object)
                .map(|(((x, y), z), o)| uniform(philox([*x, *y, *z, *o], KEY))),
        );
        I::call(NormalQuantiles(factors));
        for (factor, sigma) in factors.iter_mut().zip(&*sigmas) {
            *factor = exp(sigma * (*factor - 0.5 * sigma));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Level, dispatch};

    /// The factor at a point of an object, the same on each instruction set.
    fn factor(grain: &Grain, point: Point) -> f64 {
        struct Apply<'a>(&'a mut GrainHits, &'a mut [f64]);
        impl Task for Apply<'_> {
            type Output = ();
            fn run<I: Isa>(self) {
                self.0.apply::<I>(self.1);
            }
        }
        let factors = Level::available().map(|level| {
            let (mut hits, mut values) = (GrainHits::default(), [1.0; 9]);
            (0..9).for_each(|i| hits.push(i, grain, point));
            dispatch(level, Apply(&mut hits, &mut values));
            assert!(hits.indices.is_empty() && values == [values[0]; 9]);
            values[0].to_bits()
        });
        let factors: Vec<u64> = factors.collect();
        assert!(factors.iter().all(|bits| *bits == factors[0]));
        f64::from_bits(factors[0])
    }

    #[test]
    fn cells_have_factors_of_mean_1_and_of_the_variation() {
        assert!(Grain::new(0.0, 0.1, 7).is_none());
        let [grain, other] = [7, 8].map(|object| Grain::new(0.3, 0.1, object).unwrap());
        let centre = |i: i32, shift: f64| (f64::from(i) + 0.5 - shift) * 0.1;
        let mut factors = Vec::new();
        for i in 0..100 {
            for j in 0..100 {
                let point = [centre(i - 50, SHIFT[0]), centre(j - 50, SHIFT[1]), 0.0];
                let here = factor(&grain, point);
                // All of the cell alike.
                assert_eq!(here, factor(&grain, [point[0] + 0.049, point[1] - 0.049, 0.003]));
                assert_ne!(here, factor(&other, point));
                assert_ne!(here, factor(&grain, [point[0] + 0.1, point[1], 0.0]));
                factors.push(here);
            }
        }
        let mean = factors.iter().sum::<f64>() / 1e4;
        let variance = factors.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 1e4;
        // Five standard deviations of the mean; the kurtosis of such a variable, 4.6, is that of the
        // variance.
        assert!((mean - 1.0).abs() < 5.0 * 0.3 / 100.0, "{mean}");
        assert!((variance / 0.09 - 1.0).abs() < 5.0 * 3.6_f64.sqrt() / 100.0, "{variance}");
    }
}
