//! Beams that widen, and their sub-rays.

use super::direction::length_beside;
use super::parameters::Parameters;
use crate::arith::elementary::{exp, sin_cos};

/// Half of the speed of light in vacuum, m/s: light travels a range twice.
pub(super) const HALF_SPEED_OF_LIGHT: f64 = 299_792_458.0 / 2.0;

/// A diverging beam as a few sub-rays.
#[derive(Clone, Debug)]
pub struct Beam {
    /// Per sub-ray: tangents of azimuth and elevation to the axis. The first sub-ray is the axis.
    offsets: Vec<[f64; 2]>,
    /// Per sub-ray: its share of the energy.
    shares: Vec<f64>,
    /// Eight sub-rays each: both tangents, and the length that belongs to them. The axis fills the last.
    eights: Vec<[[f64; 8]; 3]>,
    /// Standard deviation of the pulse, as a range, m.
    pub(super) pulse_sigma: f64,
    /// The least distance at which the receiver tells two echoes apart, m.
    pub(super) separation: f64,
}

/// Beyond so many standard deviations, more than √(2·52·ln 2), a Gaussian is below 2⁻⁵² of its peak.
pub(super) const REACH: f64 = 8.5;

/// Duration of a pulse of a sensor without a beam, full width at half maximum, s: as a beam has by default.
const PULSE_LENGTH: f64 = 5e-9;

/// Standard deviation of the pulses of a sensor, as a range, m.
pub(super) fn pulse_sigma<P: Parameters>(parameters: &P) -> Result<f64, P::Error> {
    let length = parameters.optional_number("measurement.beam.pulse_length")?.unwrap_or(PULSE_LENGTH);
    Ok(sigma(HALF_SPEED_OF_LIGHT * length))
}

/// The same of a sensor without a beam.
pub(super) fn default_pulse_sigma() -> f64 {
    sigma(HALF_SPEED_OF_LIGHT * PULSE_LENGTH)
}

/// Full angles of the beam of a sensor, if it has one, rad.
pub(super) fn divergence<P: Parameters>(parameters: &P) -> Result<Option<[f64; 2]>, P::Error> {
    let Some(azimuth) = parameters.optional_number("measurement.beam.divergence_azimuth")? else {
        return Ok(None);
    };
    Ok(Some([azimuth, parameters.number("measurement.beam.divergence_elevation")?]))
}

/// Standard deviation of a Gaussian of this full width at half maximum: it is half of its maximum √(2 ln 2)
/// standard deviations from its middle.
fn sigma(width: f64) -> f64 {
    width / (8.0 * std::f64::consts::LN_2).sqrt()
}

impl Beam {
    pub(super) fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let Some(divergence) = divergence(parameters)? else { return Ok(None) };
        let rays = parameters.number("measurement.beam.rays")? as usize;
        let pulse_length = parameters.number("measurement.beam.pulse_length")?;
        let separation = parameters.number("measurement.beam.separation")?;
        let beam = Beam::new(divergence, rays, HALF_SPEED_OF_LIGHT * pulse_length);
        Ok(Some(Beam { separation, ..beam }))
    }

    /// `divergence`: full angles at 1/e² of the axis' intensity, rad; `pulse_length`: full width at half
    /// maximum, as a range, m.
    ///
    /// The ellipse that the angles bound is divided into a disc and m rings about it, m·(m+1)·3 + 1 =
    /// `rays`, each as wide as the disc; ring k has 6k sub-rays. Each carries the energy that a Gaussian
    /// beam, of profile exp(−2r²/w²), has in its cell; what lies outside of the ellipse is spread over
    /// all.
    ///
    /// Of five sub-rays, one ring has four, turned by π/8, so that an edge that is upright, level or leans by
    /// 45° crosses them one by one, at ±cos(π/8) and ±sin(π/8) radii of the ring.
    pub fn new(divergence: [f64; 2], rays: usize, pulse_length: f64) -> Self {
        let (rings, on_first, start) = match rays {
            5 => (1, 4, std::f64::consts::FRAC_PI_8),
            _ => ((1..).take_while(|m| 3 * m * (m + 1) < rays).count(), 6, 0.0),
        };
        // In units of the half angle w.
        let width = 1.0 / (rings as f64 + 0.5);
        let inside = |radius: f64| 1.0 - exp(-2.0 * radius * radius);
        let (mut offsets, mut shares) = (vec![[0.0; 2]], vec![inside(width / 2.0) / inside(1.0)]);
        for k in 1..=rings {
            let radius = k as f64 * width;
            let energy = inside(radius + width / 2.0) - inside(radius - width / 2.0);
            let count = on_first * k;
            for j in 0..count {
                let (sin, cos) = sin_cos(start + std::f64::consts::TAU * j as f64 / count as f64);
                offsets.push([radius * cos * divergence[0] / 2.0, radius * sin * divergence[1] / 2.0]);
                shares.push(energy / inside(1.0) / count as f64);
            }
        }
        let eight = |these: &[[f64; 2]]| {
            let these: [[f64; 2]; 8] = std::array::from_fn(|k| *these.get(k).unwrap_or(&offsets[0]));
            [these.map(|[left, _]| left), these.map(|[_, up]| up), these.map(length_beside)]
        };
        let eights = offsets.chunks(8).map(eight).collect();
        Beam { offsets, shares, eights, pulse_sigma: sigma(pulse_length), separation: 0.0 }
    }

    /// The number of sub-rays.
    pub(super) fn len(&self) -> usize {
        self.offsets.len()
    }

    pub(super) fn offset(&self, sub_ray: usize) -> [f64; 2] {
        self.offsets[sub_ray]
    }

    /// The share of the energy that each sub-ray carries.
    pub(super) fn shares(&self) -> &[f64] {
        &self.shares
    }

    /// The sub-ray in whose part of the energy this share of it ends.
    pub(super) fn at_share(&self, share: f64) -> usize {
        let mut sum = 0.0;
        let parts = self.shares.iter().take_while(|part| {
            sum += **part;
            sum < share
        });
        parts.count().min(self.len() - 1)
    }

    /// The sub-rays in eights, by tangent to the left, upward, and the length that belongs to them.
    pub(super) fn eights(&self) -> &[[[f64; 8]; 3]] {
        &self.eights
    }

    /// The ray and the share of energy of each sub-ray of a pulse.
    pub(super) fn sub_rays(&self, pulse: usize) -> impl Iterator<Item = (usize, f64)> {
        (pulse * self.len()..).zip(self.shares.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beam_has_all_of_its_energy_and_is_balanced() {
        for (rays, rings) in [(5, 1), (7, 1), (19, 2), (37, 3), (61, 4), (91, 5)] {
            let beam = Beam::new([2.0, 1.0], rays, 1.0);
            assert_eq!((beam.len(), beam.shares.len()), (rays, rays));
            assert_eq!(beam.offset(0), [0.0; 2]);
            let sum = |of: fn([f64; 2]) -> f64| {
                beam.offsets.iter().zip(&beam.shares).map(|(at, share)| share * of(*at)).sum::<f64>()
            };
            assert!((sum(|_| 1.0) - 1.0).abs() < 1e-15);
            assert!(
                sum(|[x, _]| x).abs() < 1e-16
                    && sum(|[_, y]| y).abs() < 1e-16
                    && sum(|[x, y]| x * y).abs() < 1e-16
            );
            // ∫r²·exp(−2r²)·r dr over ∫exp(−2r²)·r dr, up to 1: half of it on each axis, of
            // half angles 1 and 1/2.
            let moment = (1.0 - 3.0 * (-2.0_f64).exp()) / (2.0 * (1.0 - (-2.0_f64).exp()));
            assert!((sum(|[x, _]| x * x) / (moment / 2.0) - 1.0).abs() < 0.01);
            assert!((sum(|[_, y]| y * y) / (moment / 8.0) - 1.0).abs() < 0.01);
            let outermost = beam.offsets.iter().map(|[x, y]| x.hypot(2.0 * y)).fold(0.0, f64::max);
            assert!((outermost - f64::from(rings) / (f64::from(rings) + 0.5)).abs() < 1e-15);
        }
    }
}
