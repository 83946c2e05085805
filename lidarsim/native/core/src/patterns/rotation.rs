//! Steady rotations.

use std::f64::consts::TAU;

use super::{LANES, Lanes};
use crate::arith::elementary::{LARGEST_ANGLE, sin_cos};

/// A rotation with a phase of `first + m·step` turns, and another angle, at tick m of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Rotation {
    pub first: f64,
    pub step: f64,
    /// Up to a turn either way, rad.
    pub angle: f64,
}

/// Turns, with a phase of one more, that make an angle below [`LARGEST_ANGLE`]. Of more, whole turns, which
/// are exact in float64, are taken away first; of fewer not, as the sum of turns and angle is rounded.
const MOST_TURNS: f64 = 100_000.0;
const _: () = assert!((MOST_TURNS + 2.0) * TAU < LARGEST_ANGLE);

impl Rotation {
    /// The phases at some ticks, in turns.
    #[inline(always)]
    pub(super) fn turns(&self, ticks: &Lanes) -> Lanes {
        let mut turns = [0.0; LANES];
        for lane in 0..LANES {
            turns[lane] = self.first + ticks[lane] * self.step;
        }
        turns
    }

    /// Sines and cosines at some ticks.
    #[inline(always)]
    pub(super) fn sin_cos(&self, ticks: &Lanes) -> [Lanes; 2] {
        let mut turns = self.turns(ticks);
        // They grow from lane to lane.
        if turns[0].abs() > MOST_TURNS || turns[LANES - 1].abs() > MOST_TURNS {
            for turns in &mut turns {
                *turns -= if turns.abs() > MOST_TURNS { turns.floor() } else { 0.0 };
            }
        }
        let mut angles = [0.0; LANES];
        for lane in 0..LANES {
            angles[lane] = TAU * turns[lane] + self.angle;
        }
        sines_and_cosines(&angles)
    }
}

/// Sines and cosines of angles up to [`LARGEST_ANGLE`].
#[inline(always)]
pub(super) fn sines_and_cosines(angles: &Lanes) -> [Lanes; 2] {
    let [mut sines, mut cosines] = [[0.0; LANES]; 2];
    for lane in 0..LANES {
        (sines[lane], cosines[lane]) = sin_cos(angles[lane]);
    }
    [sines, cosines]
}
