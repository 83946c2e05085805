//! The overlap of beam and receiver near the sensor, where they look past each other.

use super::Effect;
use crate::arith::simd::Floats;
use crate::measure::parameters::{Parameters, Value};

/// The overlap ξ: 0 up to `near`, linear in between, 1 from `far` on, m.
#[derive(Clone, Debug)]
pub(super) struct Crossover {
    pub(super) near: f64,
    pub(super) far: f64,
}

impl Effect for Crossover {
    type Draws = ();

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        const NAME: &str = "measurement.crossover";
        match parameters.value(NAME)? {
            Value::Nothing => Ok(None),
            Value::Numbers(ends) => match ends[..] {
                [near, far] => Ok(Some(Crossover { near, far })),
                _ => Err(parameters.unexpected(NAME, Value::Numbers(ends))),
            },
            other => Err(parameters.unexpected(NAME, other)),
        }
    }

    #[inline(always)]
    fn gather<F: Floats<f64, N>, const N: usize>(&self, range: F, intensity: F) -> F {
        // The quotient is at least 1 from `far` on, since rounding keeps order.
        let overlap = range.sub(F::splat(self.near)).div(F::splat(self.far - self.near));
        intensity.mul(overlap.max(F::splat(0.0)).min(F::splat(1.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_overlap_rises_from_0_to_1() {
        let crossover = Crossover { near: 0.5, far: 2.5 };
        let ranges = [0.0, 0.5, 1.0, 1.5, 2.5_f64.next_down(), 2.5, 9.0, f64::INFINITY];
        let overlaps = [0.0, 0.0, 0.5, 1.0, 2.0 * (1.0 - f64::EPSILON), 2.0, 2.0, 2.0];
        assert_eq!(ranges.map(|range| crossover.gather(range, 2.0)), overlaps);
        let thirds = Crossover { near: 0.1, far: 0.3 };
        assert_eq!([0.1, 0.3].map(|range| thirds.gather(range, 1.0)), [0.0, 1.0]);
    }
}
