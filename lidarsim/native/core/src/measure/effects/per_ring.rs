//! A length that all rings of a sensor share, or one of each ring.

use super::Pulses;
use crate::measure::parameters::{Parameters, Value};

#[derive(Clone, Debug)]
pub(super) enum PerRing {
    All(f64),
    Each(Vec<f64>),
}

impl PerRing {
    pub(super) fn from_parameters<P: Parameters>(
        parameters: &P,
        name: &'static str,
    ) -> Result<Self, P::Error> {
        Ok(match parameters.value(name)? {
            Value::Numbers(lengths) => match lengths[..] {
                [] => PerRing::All(0.0),
                [length] => PerRing::All(length),
                _ => PerRing::Each(lengths),
            },
            length => PerRing::All(parameters.as_number(name, length)?),
        })
    }

    /// How many rings have a length, if each has its own.
    pub(super) fn rings(&self) -> Option<usize> {
        match self {
            PerRing::All(_) => None,
            PerRing::Each(lengths) => Some(lengths.len()),
        }
    }

    /// Adds its length to that of each pulse.
    pub(super) fn add_to(&self, of_pulses: &mut [f64], pulses: &Pulses) {
        match self {
            PerRing::All(length) => of_pulses.iter_mut().for_each(|sum| *sum += length),
            PerRing::Each(lengths) => {
                for (sum, ring) in of_pulses.iter_mut().zip(pulses.rings) {
                    *sum += lengths[usize::from(*ring)];
                }
            }
        }
    }
}
