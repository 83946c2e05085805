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
    fn go_to(&self, columns: &Lanes, common: &mut [[Lanes; 2]; 2]) {
        for (common, angles) in common.iter_mut().zip([self.azimuths, self.elevations]) {
            let mut some = [0.0; LANES];
            for lane in 0..LANES {
                some[lane] = angles[columns[lane] as usize];
            }
            *common = sines_and_cosines(&some);
            for lane in 0..LANES {
                if some[lane].abs() > LARGEST_ANGLE {
                    [common[0][lane], common[1][lane]] = turns::sin_cos(some[lane]).into();
                }
            }
        }
    }

    #[inline(always)]
    fn directions(&self, _: usize, common: &mut [[Lanes; 2]; 2]) -> [Lanes; 3] {
        let [[sin, cos], [up, across]] = common;
        let mut directions = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            let across = across[lane];
            set(&mut directions, lane, unit([across * cos[lane], across * sin[lane], up[lane]]));
        }
        directions
    }
}
