//! The parameters of a measurement, and the formulas that hang on these alone.

use super::{Beam, Returns, Status};
use crate::arith::elementary::exp;

macro_rules! effects {
    ($($(#[$doc:meta])* $name:ident),+ $(,)?) => {
        /// Effects of a single number each, which is 0 while they are off.
        #[derive(Clone, Copy, Debug)]
        pub struct Effects {
            $($(#[$doc])* pub $name: f64),+
        }

        impl Effects {
            /// The number of each effect, by its name.
            pub fn by_name<E>(mut number: impl FnMut(&'static str) -> Result<f64, E>) -> Result<Self, E> {
                Ok(Effects { $($name: number(stringify!($name))?),+ })
            }
        }
    };
}

effects! {
    /// Standard deviation of the beam's azimuth, rad.
    azimuth_sigma,
    /// Standard deviation of the beam's elevation, rad.
    elevation_sigma,
    /// α of e^(−2αR), 1/m.
    extinction,
    /// Probability that a pulse gives no return.
    dropout,
    /// Added to every range, m.
    range_bias,
    /// Standard deviation of the bias of each channel, m.
    channel_bias_sigma,
    /// Least significant bit of the range, m.
    range_resolution,
}

/// The parameters, each neutral while its effect is off.
#[derive(Clone, Debug)]
pub struct Measurement {
    pub effects: Effects,
    pub detection: Option<Detection>,
    pub range_sigma: RangeSigma,
    pub beam: Option<Beam>,
    pub returns: Returns,
    /// The sensor's own range less the range from the beam's origin, m: empty for 0, one number for all rings, or one per ring.
    pub range_offset: Vec<f64>,
    pub min_range: f64,
    pub max_range: f64,
}

/// A target of this reflectivity at normal incidence is seen out to this range.
#[derive(Clone, Copy, Debug)]
pub struct Detection {
    pub reflectivity: f64,
    pub range: f64,
}

/// Standard deviation of the range, m.
#[derive(Clone, Debug)]
pub enum RangeSigma {
    /// √(a² + (bR)²)
    Formula { a: f64, b: f64 },
    /// (range, sigma) with rising ranges: linear between, constant outside.
    Table(Vec<[f64; 2]>),
}

impl Measurement {
    /// Rays that a pulse takes.
    pub fn rays(&self) -> usize {
        self.beam.as_ref().map_or(1, |beam| beam.len())
    }

    /// The most returns that a pulse can have: of one ray there is one echo.
    pub fn most_returns(&self) -> usize {
        if self.beam.is_some() { self.returns.most() } else { 1 }
    }

    /// Whether light need not come from where the pulse should have gone.
    pub fn strays(&self) -> bool {
        self.jitters() || self.beam.is_some()
    }

    #[inline(always)]
    pub(super) fn jitters(&self) -> bool {
        self.effects.azimuth_sigma > 0.0 || self.effects.elevation_sigma > 0.0
    }

    /// What is left of the light on the way there and back.
    #[inline(always)]
    pub(super) fn transmission(&self, range: f64) -> f64 {
        exp(-2.0 * self.effects.extinction * range)
    }

    /// To the nearest multiple of the resolution, halves to even.
    #[inline(always)]
    pub(super) fn quantised(&self, range: f64) -> f64 {
        let step = self.effects.range_resolution;
        if step > 0.0 { (range / step).round_ties_even() * step } else { range }
    }

    /// A range that the sensor reports as such, or why it does not.
    #[inline(always)]
    pub(super) fn gate(&self, range: f64) -> Result<f64, Status> {
        // Noise may carry a range beyond what float64 holds.
        if range < self.min_range {
            Err(Status::BelowMinRange)
        } else if range <= self.max_range && range < f64::INFINITY {
            Ok(range)
        } else {
            Err(Status::BeyondMaxRange)
        }
    }
}

impl RangeSigma {
    #[inline(always)]
    pub(super) fn is_zero(&self) -> bool {
        matches!(self, RangeSigma::Formula { a: 0.0, b: 0.0 })
    }

    #[inline(always)]
    pub(super) fn at(&self, range: f64) -> f64 {
        match self {
            // As most are; and nothing is rounded.
            RangeSigma::Formula { a, b: 0.0 } => *a,
            RangeSigma::Formula { a, b } => {
                let slope = b * range;
                (a * a + slope * slope).sqrt()
            }
            RangeSigma::Table(rows) => {
                let above = rows.partition_point(|row| row[0] <= range);
                let Some(&[r0, s0]) = rows[..above].last() else {
                    return rows.first().map_or(0.0, |row| row[1]);
                };
                rows.get(above).map_or(s0, |[r1, s1]| s0 + (s1 - s0) * ((range - r0) / (r1 - r0)))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_comes_from_the_formula_or_the_table() {
        assert_eq!(RangeSigma::Formula { a: 3.0, b: 0.4 }.at(10.0), 5.0);
        let table = RangeSigma::Table(vec![[1.0, 0.1], [2.0, 0.2], [4.0, 0.1]]);
        assert_eq!([0.5, 1.0, 2.0, 3.0, 4.0, 9.0].map(|r| table.at(r)), [0.1, 0.1, 0.2, 0.15000000000000002, 0.1, 0.1]);
    }
}
