//! The range as the sensor reads it: with all errors, and from the sensor's own zero instead of the beam's
//! origin.

use super::{Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, lanes};
use crate::measure::parameters::{Parameters, Value};

#[derive(Clone, Debug)]
pub(super) struct Reading {
    offset: Offset,
}

/// The sensor's own range less the range from the beam's origin, m.
#[derive(Clone, Debug)]
enum Offset {
    Sensor(f64),
    Rings(Vec<f64>),
}

impl Effect for Reading {
    /// The offset of each pulse; unspecified if all rings have one.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let offset = match parameters.value("range_offset")? {
            Value::Numbers(offsets) => match offsets[..] {
                [] => Offset::Sensor(0.0),
                [offset] => Offset::Sensor(offset),
                _ => Offset::Rings(offsets),
            },
            offset => Offset::Sensor(parameters.as_number("range_offset", offset)?),
        };
        Ok(Some(Reading { offset }))
    }

    #[inline(always)]
    fn draw(&self, pulses: &Pulses, offsets: &mut Vec<f64>) {
        if let Offset::Rings(of_rings) = &self.offset {
            offsets.clear();
            offsets.extend(pulses.rings.iter().map(|ring| of_rings[usize::from(*ring)]));
            offsets.resize(pulses.padded(), 0.0);
        }
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        _: &Pulses,
        offsets: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        echoes.offset = match self.offset {
            Offset::Sensor(offset) => F::splat(offset),
            Offset::Rings(_) => lanes::load(offsets, echoes.part),
        };
        echoes.reading = echoes.range.add(echoes.error).add(echoes.offset);
    }
}

impl Reading {
    /// How many rings have an offset, if each has its own.
    pub(super) fn rings(&self) -> Option<usize> {
        match &self.offset {
            Offset::Sensor(_) => None,
            Offset::Rings(offsets) => Some(offsets.len()),
        }
    }
}
