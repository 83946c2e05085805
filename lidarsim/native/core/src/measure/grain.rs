//! The texture of a surface: small cells that return more or less light than their neighbours.
//!
//! Reflectivity is multiplied by exp(v·g − v²/2), of mean 1, with a standard normal g for each cell of a
//! cubic grid in the object's own coordinates. The random numbers depend on the cell and the object alone,
//! so that all scans of all sensors see the same surface.

use super::rng::{normal_quantile, philox, uniform};
use crate::arith::elementary::{exp, ln};
use crate::geometry::vector::Point;

/// The texture of an object.
#[derive(Clone, Copy, Debug)]
pub struct Grain {
    /// v, the standard deviation of the factor's logarithm.
    sigma: f64,
    /// Edge of a cell, m.
    edge: f64,
}

/// Where cells begin, as shares of an edge: faces of objects lie at round coordinates, where rounding would
/// draw one cell or the other.
const SHIFT: [f64; 3] = [0.381_966, 0.618_034, 0.276_393];

/// No stream of pulses has this key: theirs are drawn.
const KEY: [u32; 2] = [0, 1];

impl Grain {
    /// `variation`: relative standard deviation of the factor. None: without texture.
    pub fn new(variation: f64, edge: f64) -> Option<Self> {
        // That of a log-normal variable is √(exp(v²) − 1).
        let sigma = ln(1.0 + variation * variation).sqrt();
        (sigma > 0.0).then_some(Grain { sigma, edge })
    }

    /// The factor at a point in the object's own coordinates.
    ///
    /// It is compiled once for all instruction sets.
    pub(super) fn at(&self, object: i32, point: Point) -> f64 {
        let cell = [0, 1, 2].map(|axis| (point[axis] / self.edge + SHIFT[axis]).floor() as i64 as u32);
        let normal = normal_quantile(uniform(philox([cell[0], cell[1], cell[2], object as u32], KEY)));
        exp(self.sigma * (normal - 0.5 * self.sigma))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_have_factors_of_mean_1_and_of_the_variation() {
        assert!(Grain::new(0.0, 0.1).is_none());
        let grain = Grain::new(0.3, 0.1).unwrap();
        let centre = |i: i32, shift: f64| (f64::from(i) + 0.5 - shift) * 0.1;
        let mut factors = Vec::new();
        for i in 0..100 {
            for j in 0..100 {
                let point = [centre(i - 50, SHIFT[0]), centre(j - 50, SHIFT[1]), 0.0];
                let factor = grain.at(7, point);
                // All of the cell alike.
                assert_eq!(factor, grain.at(7, [point[0] + 0.049, point[1] - 0.049, 0.003]));
                assert_ne!(factor, grain.at(8, point));
                assert_ne!(factor, grain.at(7, [point[0] + 0.1, point[1], 0.0]));
                factors.push(factor);
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
