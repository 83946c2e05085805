//! A beam along a cone about x, deflected by a tilted rotating mirror.

use super::{LANES, Lanes, Rotation, Together, set, unit};
use crate::arith::elementary::sin_cos;

/// (cos a, sin a cos h, sin a sin h), with h the angle of a rotation.
pub struct Palmer {
    /// Sine and cosine of a.
    half_angle: (f64, f64),
    rotation: Rotation,
}

impl Palmer {
    pub fn new(half_angle: f64, rotation: Rotation) -> Self {
        Palmer { half_angle: sin_cos(half_angle), rotation }
    }
}

impl Together for Palmer {
    /// Sines and cosines of h.
    type Common = [Lanes; 2];

    #[inline(always)]
    fn common(&self) -> [Lanes; 2] {
        Default::default()
    }

    #[inline(always)]
    fn go_to(&self, columns: &Lanes, common: &mut [Lanes; 2]) {
        *common = self.rotation.sin_cos(columns);
    }

    #[inline(always)]
    fn directions(&self, _: usize, [sin, cos]: &mut [Lanes; 2]) -> [Lanes; 3] {
        let (across, along) = self.half_angle;
        let mut directions = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            set(&mut directions, lane, unit([along, across * cos[lane], across * sin[lane]]));
        }
        directions
    }
}
