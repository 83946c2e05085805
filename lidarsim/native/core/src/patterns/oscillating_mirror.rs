//! A beam in the x-y plane, deflected by an oscillating mirror.

use super::rotation::{Rotation, sines_and_cosines};
use super::{LANES, Lanes, Together, set, unit};

/// A beam that swings between the ends of a field of view, from the left, at constant speed; it reverses at
/// constant acceleration.
pub struct OscillatingMirror {
    /// From end to end, rad.
    field_of_view: f64,
    /// The part T of the time that the reversals take.
    turn: f64,
    /// A turn is a period, there and back.
    swinging: Rotation,
}

impl OscillatingMirror {
    pub fn new(field_of_view: f64, turn: f64, swinging: Rotation) -> Self {
        // A quotient by a smaller number would overflow: it counts as no reversal time.
        let turn = if turn >= f64::MIN_POSITIVE { turn } else { 0.0 };
        OscillatingMirror { field_of_view, turn, swinging }
    }

    /// Azimuths at phases in turns, from 0 to 1.
    ///
    /// A swing one way takes the time 1: half a reversal (T/2), a ramp (1 − T), half a reversal (T/2). It
    /// covers the distance 2, so the speed on the ramp is v = 2/(1 − T/2). At a time e before the end of a
    /// swing, the distance left is (v/T) e².
    #[inline(always)]
    fn azimuths(&self, turns: &Lanes) -> Lanes {
        let (half, speed) = (0.5 * self.turn, 2.0 / (1.0 - 0.5 * self.turn));
        let bend = speed / if self.turn > 0.0 { self.turn } else { 1.0 };
        let mut azimuths = [0.0; LANES];
        for lane in 0..LANES {
            let swing = 2.0 * (turns[lane] - 0.5).abs();
            let other = 1.0 - swing;
            let to_end = if swing < other { swing } else { other };
            let (ramp, reversal) = (speed * (0.5 - to_end), 1.0 - bend * (to_end * to_end));
            let depth = if to_end < half { reversal } else { ramp };
            azimuths[lane] = 0.5 * self.field_of_view * depth.copysign(swing - 0.5);
        }
        azimuths
    }
}

impl Together for OscillatingMirror {
    /// Sines and cosines of the azimuths.
    type Common = [Lanes; 2];

    #[inline(always)]
    fn common(&self) -> [Lanes; 2] {
        Default::default()
    }

    #[inline(always)]
    fn go_to(&self, block: usize, common: &mut [Lanes; 2]) {
        *common = sines_and_cosines(&self.azimuths(&self.swinging.turns(block)));
    }

    #[inline(always)]
    fn directions(&self, _: usize, [sin, cos]: &[Lanes; 2], directions: &mut [Lanes; 3]) {
        for lane in 0..LANES {
            set(directions, lane, unit([cos[lane], sin[lane], 0.0]));
        }
    }
}
