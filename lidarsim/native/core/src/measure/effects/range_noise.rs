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
                interpolate(rows, &mut sigmas);
                F::load(&sigmas)
            }
        }
    }
}

/// Replaces each number by the value of a table there: linear between rows, whose first columns rise,
/// constant outside. Loops are over lanes, so that they vectorize.
#[inline(always)]
pub(super) fn interpolate<const N: usize>(rows: &[[f64; 2]], numbers: &mut [f64; N]) {
    let first = rows.first().unwrap_or(&[0.0; 2]);
    // The rows on both sides of each number; outside the table, the same row twice.
    let [mut low, mut low_value, mut high, mut high_value] =
        [[first[0]; N], [first[1]; N], [first[0]; N], [first[1]; N]];
    for (k, row) in rows.iter().enumerate() {
        let next = rows.get(k + 1).unwrap_or(row);
        for i in 0..N {
            let is_above = row[0] <= numbers[i];
            low[i] = if is_above { row[0] } else { low[i] };
            low_value[i] = if is_above { row[1] } else { low_value[i] };
            high[i] = if is_above { next[0] } else { high[i] };
            high_value[i] = if is_above { next[1] } else { high_value[i] };
        }
    }
    for i in 0..N {
        let share = (numbers[i] - low[i]) / (high[i] - low[i]);
        let between = low_value[i] + (high_value[i] - low_value[i]) * share;
        numbers[i] = if low[i] < high[i] { between } else { low_value[i] };
    }
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
