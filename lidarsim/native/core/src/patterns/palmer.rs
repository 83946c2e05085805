//! A beam along a cone about x, deflected by a tilted rotating mirror.

use super::rotation::{Anchors, Rotation, Rotor};
use super::{LANES, Lanes, Together, set, unit};
use crate::arith::elementary::sin_cos;

/// (cos a, sin a cos h, sin a sin h), with h the angle of a rotation.
pub struct Palmer {
    /// Sine and cosine of a.
    half_angle: (f64, f64),
    rotor: Rotor,
}

impl Palmer {
    pub fn new(half_angle: f64, rotation: Rotation) -> Self {
        Palmer { half_angle: sin_cos(half_angle), rotor: Rotor::new(rotation) }
    }
}

impl Together for Palmer {
    /// With sines and cosines of h.
    type Common = (Anchors, [Lanes; 2]);

    #[inline(always)]
    fn common(&self) -> (Anchors, [Lanes; 2]) {
        (Anchors::NONE, [[0.0; LANES]; 2])
    }

    #[inline(always)]
    fn go_to(&self, block: usize, (anchors, turned): &mut (Anchors, [Lanes; 2])) {
        *turned = self.rotor.sin_cos(block, anchors);
    }

    #[inline(always)]
    fn directions(&self, _: usize, (_, [sin, cos]): &(Anchors, [Lanes; 2]), directions: &mut [Lanes; 3]) {
        let (across, along) = self.half_angle;
        for lane in 0..LANES {
            set(directions, lane, unit([along, across * cos[lane], across * sin[lane]]));
        }
    }
}
