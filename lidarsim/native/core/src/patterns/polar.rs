//! Beams at given azimuths and elevations.

use super::rotation::sines_and_cosines;
use super::{LANES, Lanes, Together, set, unit};
use crate::arith::elementary::LARGEST_ANGLE;
use crate::arith::turns;

/// An azimuth, from x to y, and an elevation above the x-y plane for each beam, rad. All are finite.
pub struct Polar<'a> {
    pub azimuths: &'a [f64],
    pub elevations: &'a [f64],
}

impl Together for Polar<'_> {
    /// Sines and cosines of azimuths and elevations.
    type Common = [[Lanes; 2]; 2];

    #[inline(always)]
    fn common(&self) -> [[Lanes; 2]; 2] {
        Default::default()
    }

    #[inline(always)]
    fn go_to(&self, block: usize, common: &mut [[Lanes; 2]; 2]) {
        for (common, angles) in common.iter_mut().zip([self.azimuths, self.elevations]) {
            let angles = &angles[block * LANES..];
            let (mut some, count) = ([0.0; LANES], angles.len().min(LANES));
            some[..count].copy_from_slice(&angles[..count]);
            *common = sines_and_cosines(&some);
            for lane in 0..LANES {
                if some[lane].abs() > LARGEST_ANGLE {
                    [common[0][lane], common[1][lane]] = turns::sin_cos(some[lane]).into();
                }
            }
        }
    }

    #[inline(always)]
    fn directions(&self, _: usize, common: &[[Lanes; 2]; 2], directions: &mut [Lanes; 3]) {
        let [[sin, cos], [up, across]] = common;
        for lane in 0..LANES {
            let across = across[lane];
            set(directions, lane, unit([across * cos[lane], across * sin[lane], up[lane]]));
        }
    }
}
