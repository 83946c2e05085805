//! How a sensor measures: its effects, its beam, and the returns that it reports.

use super::beam::{self, Beam};
use super::echo::Returns;
use super::effects::Effects;
use super::parameters::Parameters;

/// Validated by the caller.
#[derive(Clone, Debug)]
pub struct Measurement {
    pub(super) effects: Effects,
    pub(super) beam: Option<Beam>,
    pub(super) returns: Returns,
    /// How far the receiver is to the left of the emitter, m.
    pub(super) receiver_offset: f64,
    /// Of echoes of the atmosphere.
    pub(super) air_label: u32,
    /// The most surfaces of a way of the light.
    depth: usize,
}

impl Measurement {
    pub fn from_parameters<P: Parameters>(parameters: &P) -> Result<Self, P::Error> {
        Ok(Measurement {
            effects: Effects::from_parameters(parameters)?,
            beam: Beam::from_parameters(parameters)?,
            returns: Returns::from_parameters(parameters)?,
            receiver_offset: parameters.number("measurement.receiver_offset")?,
            air_label: parameters.optional_number("atmosphere.label")?.map_or(0, |label| label as u32),
            depth: parameters.number("measurement.depth")? as usize,
        })
    }

    /// Rays of a pulse.
    pub fn rays(&self) -> usize {
        self.beam.as_ref().map_or(1, Beam::len)
    }

    /// The share of the energy of a pulse that one of its rays carries.
    pub(super) fn share(&self, sub_ray: usize) -> f64 {
        self.beam.as_ref().map_or(1.0, |beam| beam.shares()[sub_ray])
    }

    /// Standard deviation of the pulse, as a range, m.
    pub(super) fn pulse_sigma(&self) -> f64 {
        self.beam.as_ref().map_or_else(beam::default_pulse_sigma, |beam| beam.pulse_sigma)
    }

    /// The most returns of a pulse. A single ray has one echo, unless light goes on.
    pub fn most_returns(&self) -> usize {
        if self.beam.is_some() || self.depth > 1 { self.returns.most() } else { 1 }
    }

    /// The most surfaces that light meets one after another.
    pub fn depth(&self) -> usize {
        self.depth
    }

    /// Whether light may come from another direction than that of the pulse.
    pub fn strays(&self) -> bool {
        self.effects.turns() || self.beam.is_some()
    }

    /// Whether returns may come from anything but surfaces.
    pub fn tells_sources(&self) -> bool {
        self.effects.tells_sources()
    }

    /// The range and power of the mean echo of fog in front of no surface, if there is one.
    pub fn fog_echo(&self) -> Option<[f64; 2]> {
        self.effects.fog().map(|fog| [fog.range, fog.power])
    }

    /// How many patches of fog, and how many drops or flakes, of a pulse in front of no surface are seen on
    /// average.
    pub fn spots_seen(&self) -> [f64; 2] {
        let patches = self.effects.fog().map_or(0.0, |fog| fog.seen_on_average());
        [patches, self.effects.particles().map_or(0.0, |particles| particles.seen_on_average())]
    }

    /// The parameters that each ring has of its own, and the number of rings that have them.
    pub fn rings(&self) -> impl Iterator<Item = (&'static str, usize)> {
        self.effects.rings()
    }
}
