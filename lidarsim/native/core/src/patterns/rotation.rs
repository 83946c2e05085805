//! Steady rotations.

use std::f64::consts::TAU;

use super::{LANES, Lanes};
use crate::arith::elementary::{sin_cos, sin_cos_from_quarter};
use crate::arith::turns;

/// A steady rotation: its phase at tick m of a frame is `first + m·step`.
///
/// Phases are integers in units of 2⁻¹²⁸ of a turn. They wrap around as turns do, so none is rounded.
#[derive(Clone, Copy, Debug)]
pub struct Rotation {
    first: u128,
    step: u128,
}

impl Rotation {
    /// `angle`, rad, is added to all phases.
    pub fn new(first: u128, step: u128, angle: f64) -> Self {
        Rotation { first: first.wrapping_add(turns::phase(angle)), step }
    }

    fn phase(&self, tick: usize) -> u128 {
        self.first.wrapping_add(self.step.wrapping_mul(tick as u128))
    }

    /// The phases in a block of ticks, in turns from 0 to 1, to within 2⁻⁵³.
    #[inline(always)]
    pub(super) fn turns(&self, block: usize) -> Lanes {
        let [first, step] = [(self.phase(block * LANES) >> 64) as u64, (self.step >> 64) as u64];
        let mut turns = [0.0; LANES];
        for lane in 0..LANES {
            turns[lane] = first.wrapping_add(step.wrapping_mul(lane as u64)) as f64 * UNIT;
        }
        turns
    }
}

/// 2⁻⁶⁴.
const UNIT: f64 = 1.0 / (1_u128 << 64) as f64;

/// Sine and cosine of a rotation at each tick, to within 9.1u.
///
/// exp(i(α + λ)) = exp(iα) exp(iλ), with α the phase at the first tick of a block of the frame and λ
/// what the ticks since then add. The sines and cosines of α and λ are off by 2.5u each. Their sums of two
/// products are therefore off by 2.5u (|sin α| + |cos α| + |sin λ| + |cos λ|) ≤ 7.1u; the products
/// round by u in all, and the sum by u.
pub struct Rotor {
    rotation: Rotation,
    /// Sines and cosines of each λ.
    steps: [Lanes; 2],
}

/// Sines and cosines of α for a group of blocks, as many as there are lanes: group g begins with block
/// `g·LANES`.
#[derive(Clone, Copy)]
pub struct Anchors {
    group: usize,
    anchors: [Lanes; 2],
}

impl Anchors {
    /// Of no group yet.
    pub const NONE: Anchors = Anchors { group: usize::MAX, anchors: [[0.0; LANES]; 2] };
}

impl Rotor {
    pub fn new(rotation: Rotation) -> Self {
        Rotor { rotation, steps: sines_and_cosines_of_phases(0, rotation.step) }
    }

    /// Sines and cosines in a block of ticks.
    #[inline(always)]
    pub(super) fn sin_cos(&self, block: usize, anchors: &mut Anchors) -> [Lanes; 2] {
        let (group, number) = (block / LANES, block % LANES);
        if anchors.group != group {
            let first = self.rotation.phase(group * LANES * LANES);
            let step = self.rotation.step.wrapping_mul(LANES as u128);
            *anchors = Anchors { group, anchors: sines_and_cosines_of_phases(first, step) };
        }
        let (sin, cos) = (anchors.anchors[0][number], anchors.anchors[1][number]);
        let [step_sines, step_cosines] = &self.steps;
        let [mut sines, mut cosines] = [[0.0; LANES]; 2];
        for lane in 0..LANES {
            sines[lane] = sin * step_cosines[lane] + cos * step_sines[lane];
            cosines[lane] = cos * step_cosines[lane] - sin * step_sines[lane];
        }
        [sines, cosines]
    }
}

/// Sines and cosines of phases a step apart, to within 2.5u.
///
/// r, at most π/4, is the phase less the nearest quarter of a turn. The integer, 2π and their product are
/// rounded: r is off by 2.4u·|r|, which moves sine and cosine by 1.34u at most. What follows adds 1.16u, as
/// `elementary::sin_cos` derives.
#[inline(always)]
fn sines_and_cosines_of_phases(first: u128, step: u128) -> [Lanes; 2] {
    let mut phases = [0; LANES];
    for lane in 0..LANES {
        phases[lane] = (first.wrapping_add(step.wrapping_mul(lane as u128)) >> 64) as u64;
    }
    let [mut sines, mut cosines] = [[0.0; LANES]; 2];
    for lane in 0..LANES {
        let quarter = phases[lane].wrapping_add(1 << 61) >> 62;
        let rest = phases[lane].wrapping_sub(quarter << 62) as i64;
        (sines[lane], cosines[lane]) = sin_cos_from_quarter(rest as f64 * (TAU * UNIT), quarter as i64);
    }
    [sines, cosines]
}

/// Sines and cosines of angles up to [`LARGEST_ANGLE`](crate::arith::elementary::LARGEST_ANGLE).
#[inline(always)]
pub(super) fn sines_and_cosines(angles: &Lanes) -> [Lanes; 2] {
    let [mut sines, mut cosines] = [[0.0; LANES]; 2];
    for lane in 0..LANES {
        (sines[lane], cosines[lane]) = sin_cos(angles[lane]);
    }
    [sines, cosines]
}

#[cfg(test)]
mod tests {
    use num_bigint::BigInt;

    use super::*;
    use crate::testing::{assert_slack, fixed_point, float, half_pi, numbers, series, worst};

    /// Sine and cosine of a phase, in fixed point.
    fn truth(phase: u128) -> [BigInt; 2] {
        let angle = (BigInt::from(phase) * half_pi() * 4) >> 128;
        [series(&angle, 1, 2, -1), series(&angle, 0, 2, -1)]
    }

    /// A part of a turn.
    fn phase(turns: f64) -> u128 {
        ((turns - turns.floor()) * 2.0_f64.powi(64)) as u128 * ((1 << 64) + 12345)
    }

    #[test]
    fn rotors_are_as_near_as_is_derived() {
        let off = |&[first, step, tick]: &[f64; 3]| {
            let (rotation, tick) =
                (Rotation::new(phase(first), phase(step), 0.0), (4e9 * tick.abs()) as usize);
            let [sines, cosines] = Rotor::new(rotation).sin_cos(tick / LANES, &mut Anchors::NONE.clone());
            let [sin, cos] = truth(rotation.phase(tick));
            let error = |found: f64, truth: BigInt| float(&(fixed_point(found) - truth)).abs();
            let lane = tick % LANES;
            error(sines[lane], sin).max(error(cosines[lane], cos)) / (9.1 * f64::EPSILON / 2.0)
        };
        let (found, at) = worst(10, 250, |_, next| next(), off);
        assert_slack(&format!("rotor {at:?}"), found, 0.4);
    }

    #[test]
    fn phases_are_those_of_the_ticks() {
        let mut number = numbers();
        for _ in 0..100 {
            let (first, step, angle) = (phase(number()), phase(number()), 20.0 * number() - 10.0);
            let rotation = Rotation::new(first, step, angle);
            let added = rotation.first.wrapping_sub(first);
            let turned = (added >> 64) as f64 * UNIT * TAU - angle;
            assert!((turned / TAU - (turned / TAU).round()).abs() < 4.0 * f64::EPSILON, "{angle}: {added}");
            let tick = (1e6 * number()) as usize;
            let (mut sum, block) = (rotation.first, tick / LANES);
            for _ in 0..tick {
                sum = sum.wrapping_add(step);
            }
            assert_eq!(rotation.phase(tick), sum);
            let turns = rotation.turns(block)[tick % LANES];
            let exact = (sum >> 64) as f64 * UNIT;
            assert!((turns - exact).abs() <= 2.0_f64.powi(-53), "{turns} {exact}");
            assert!((0.0..=1.0).contains(&turns));
        }
    }

    #[test]
    fn anchors_are_those_of_the_group() {
        let rotor = Rotor::new(Rotation::new(phase(0.3), phase(0.0123), 0.0));
        let mut kept = Anchors::NONE;
        for block in [0, 1, 31, 32, 33, 1024, 64, 63, 0] {
            assert_eq!(rotor.sin_cos(block, &mut kept), rotor.sin_cos(block, &mut Anchors::NONE.clone()));
        }
    }
}
