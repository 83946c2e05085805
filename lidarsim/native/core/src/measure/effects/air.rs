//! What echoes of fog, rain and snow have in common: where the receiver sees the air, and how much of its
//! light comes back.

use super::Effect;
use super::crossover::Crossover;
use super::extinction::Extinction;
use crate::arith::elementary::exp;
use crate::measure::parameters::Parameters;

/// Echoes of the air draw these numbers of the effects that draw for each echo; those of surfaces draw the
/// numbers below, so that neither change the other.
pub(in crate::measure) const FIRST_NUMBER: u16 = 1 << 15;

#[derive(Clone, Debug)]
pub(super) struct Air {
    /// From here on the receiver sees the air, m.
    pub(super) begin: f64,
    crossover: Option<Crossover>,
    /// α, 1/m.
    pub(super) extinction: f64,
}

impl Air {
    /// The receiver sees the air from where the overlap of beam and receiver begins. Without an overlap, or
    /// if it begins at the sensor, it is blind up to its least range.
    pub(super) fn from_parameters<P: Parameters>(parameters: &P) -> Result<Self, P::Error> {
        let crossover = Crossover::from_parameters(parameters)?;
        let near = crossover.as_ref().map_or(0.0, |crossover| crossover.near);
        let begin = if near > 0.0 { near } else { parameters.number("min_range")? };
        Ok(Air { begin, crossover, extinction: Extinction::coefficient(parameters)? })
    }

    /// From here on the overlap is 1.
    pub(super) fn overlaps_from(&self) -> f64 {
        self.crossover.as_ref().map_or(self.begin, |crossover| self.begin.max(crossover.far))
    }

    /// ξ(r)·exp(−2αr − x).
    pub(super) fn share(&self, range: f64, x: f64) -> f64 {
        let share = exp(-2.0 * self.extinction * range - x);
        self.crossover.as_ref().map_or(share, |crossover| crossover.gather(range, share))
    }

    /// Air that the receiver sees in full from a range on.
    #[cfg(test)]
    pub(super) fn clear(begin: f64, extinction: f64) -> Self {
        Air { begin, crossover: None, extinction }
    }
}
