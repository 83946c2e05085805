//! Range noise: a normal variable for each echo, of a standard deviation that may depend on range.

use super::detection::DetectionLimit;
use super::{Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::measure::parameters::{Parameters, Value};
use crate::measure::rng::EffectId;

#[derive(Clone, Debug)]
pub(super) struct RangeNoise {
    sigma: Sigma,
    weakness: Option<Weakness>,
}

/// The standard deviation of strong echoes, m.
#[derive(Clone, Debug)]
enum Sigma {
    /// √(a² + (b·R)²)
    Formula { a: f64, b: f64 },
    /// (range, sigma) with rising ranges: linear between, constant outside.
    Table(Vec<[f64; 2]>),
}

/// What is added to the variance of weak echoes: c²/s, s the power in units of the least that is seen.
#[derive(Clone, Debug)]
struct Weakness {
    /// c², m².
    variance: f64,
    least_power: f64,
}

impl Effect for RangeNoise {
    /// Draw i is for the i-th echo of a pulse, from the nearest, counted before any is lost.
    const ID: Option<EffectId> = Some(EffectId(3));
    /// Normals of the first echoes. Further echoes draw as they come.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let sigma = match parameters.value("measurement.range_sigma")? {
            Value::Rows(rows) => Sigma::Table(rows),
            a => Sigma::Formula {
                a: parameters.as_number("measurement.range_sigma", a)?,
                b: parameters.number("measurement.range_sigma_slope")?,
            },
        };
        let mut weakness = None;
        let limit = parameters.number("measurement.range_sigma_limit")?;
        if limit > 0.0 {
            let Some(detection) = DetectionLimit::from_parameters(parameters)? else {
                return Err(parameters.unexpected("measurement.detection", Value::Nothing));
            };
            weakness = Some(Weakness { variance: limit * limit, least_power: detection.power });
        }
        let is_off = matches!(sigma, Sigma::Formula { a: 0.0, b: 0.0 }) && weakness.is_none();
        Ok((!is_off).then_some(RangeNoise { sigma, weakness }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, normals: &mut Vec<f64>) {
        pulses.normals::<I, Self>(0, normals);
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        pulses: &Pulses,
        normals: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        let normal = match echoes.number {
            0 => lanes::load(normals, echoes.part),
            number => pulses.lane_normals::<Self, F, N>(number, echoes),
        };
        let mut sigma = self.sigma.at(echoes.range);
        if let Some(Weakness { variance, least_power }) = self.weakness {
            let weak = F::splat(variance).mul(F::splat(least_power).div(echoes.power));
            sigma = sigma.mul(sigma).add(weak).sqrt();
        }
        echoes.error = echoes.error.add(sigma.mul(normal));
    }
}

impl Sigma {
    #[inline(always)]
    fn at<F: Floats<f64, N>, const N: usize>(&self, range: F) -> F {
        match self {
            // Most sensors. Nothing is rounded.
            Sigma::Formula { a, b: 0.0 } => F::splat(*a),
            Sigma::Formula { a, b } => {
                let slope = F::splat(*b).mul(range);
                F::splat(a * a).add(slope.mul(slope)).sqrt()
            }
            Sigma::Table(rows) => {
                let mut sigmas = range.store();
                for sigma in &mut sigmas {
                    *sigma = interpolate(rows, *sigma);
                }
                F::load(&sigmas)
            }
        }
    }
}

/// A table at a range: linear between its rows, constant outside.
#[inline(always)]
pub(super) fn interpolate(rows: &[[f64; 2]], range: f64) -> f64 {
    let above = rows.partition_point(|row| row[0] <= range);
    let Some(&[r0, s0]) = rows[..above].last() else {
        return rows.first().map_or(0.0, |row| row[1]);
    };
    rows.get(above).map_or(s0, |[r1, s1]| s0 + (s1 - s0) * ((range - r0) / (r1 - r0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigma_comes_from_the_formula_or_the_table() {
        assert_eq!(Sigma::Formula { a: 3.0, b: 0.4 }.at(10.0), 5.0);
        let table = Sigma::Table(vec![[1.0, 0.1], [2.0, 0.2], [4.0, 0.1]]);
        let ranges = [0.5, 1.0, 2.0, 3.0, 4.0, 9.0];
        assert_eq!(ranges.map(|range| table.at(range)), [0.1, 0.1, 0.2, 0.15000000000000002, 0.1, 0.1]);
    }
}
