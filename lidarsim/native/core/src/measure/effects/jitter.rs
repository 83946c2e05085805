//! Angular jitter: the error of a pulse's direction, before it is cast.

use super::{Effect, Pulses};
use crate::arith::simd::Isa;
use crate::geometry::vector::Point;
use crate::measure::direction::turned;
use crate::measure::parameters::Parameters;
use crate::measure::rng::EffectId;

#[derive(Clone, Debug)]
pub(super) struct Jitter {
    /// Standard deviation of the azimuth, rad.
    azimuth_sigma: f64,
    /// Standard deviation of the elevation, rad.
    elevation_sigma: f64,
}

/// Per pulse. The normals of an angle without an error are zero.
#[derive(Default)]
pub(super) struct Jittered {
    azimuth: Vec<f64>,
    elevation: Vec<f64>,
    /// The directions with their errors, in the sensor frame.
    pub(super) directions: Vec<Point>,
}

const AZIMUTH: u16 = 0;
const ELEVATION: u16 = 1;

impl Effect for Jitter {
    const ID: Option<EffectId> = Some(EffectId(1));
    type Draws = Jittered;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let azimuth_sigma = parameters.number("measurement.azimuth_sigma")?;
        let elevation_sigma = parameters.number("measurement.elevation_sigma")?;
        let is_on = azimuth_sigma > 0.0 || elevation_sigma > 0.0;
        Ok(is_on.then_some(Jitter { azimuth_sigma, elevation_sigma }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, draws: &mut Jittered) {
        let Jittered { azimuth, elevation, directions } = draws;
        for (sigma, draw, normals) in
            [(self.azimuth_sigma, AZIMUTH, &mut *azimuth), (self.elevation_sigma, ELEVATION, &mut *elevation)]
        {
            if sigma > 0.0 {
                pulses.normals::<I, Self>(draw, normals);
            } else {
                normals.clear();
                normals.resize(pulses.indices.len(), 0.0);
            }
        }
        directions.resize(pulses.directions.len(), [0.0; 3]);
        let normals = azimuth.iter().zip(&*elevation);
        for ((turn, direction), (azimuth, elevation)) in
            directions.iter_mut().zip(pulses.directions).zip(normals)
        {
            let (azimuth, elevation) = (self.azimuth_sigma * azimuth, self.elevation_sigma * elevation);
            *turn = turned(*direction, azimuth, elevation);
        }
    }
}
