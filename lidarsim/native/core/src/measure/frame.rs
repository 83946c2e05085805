//! The pulses of a frame, and what can be wrong with them.

use std::ops::Range;

use super::direction::{is_finite, is_unit};
use super::rng::Stream;
use crate::geometry::origins::Origins;
use crate::geometry::pose::Path;
use crate::geometry::vector::Point;

/// One frame to be fired.
pub struct Frame<'a> {
    pub origins: Origins<'a>,
    /// In the sensor frame, unit to rounding.
    pub directions: &'a [Point],
    /// Since the start of the frame, s.
    pub times: &'a [f64],
    pub rings: &'a [u16],
    /// The numbers of the pulses in the whole frame, unless they are all of them in order.
    pub indices: Option<&'a [u64]>,
    pub start: f64,
    pub path: &'a Path,
    pub stream: Stream,
}

impl Frame<'_> {
    /// Whether each of some pulses has a pose.
    #[inline(always)]
    pub(super) fn have_poses(&self, pulses: Range<usize>) -> bool {
        // A search for the first without a pose would not be vectorized. The span of a path is found
        // recursively.
        let span = self.path.span();
        self.times[pulses].iter().fold(true, |legal, time| legal & self.is_within(span, *time))
    }

    /// The error for the first illegal pulse, if there is one.
    #[cold]
    #[inline(never)]
    pub(super) fn check(&self, pulses: Range<usize>) -> Result<(), BadPulse> {
        for pulse in pulses {
            let fault = if !is_unit(self.directions[pulse]) {
                Fault::Direction
            } else if !is_finite(self.origins.of(pulse)) {
                Fault::Origin
            } else if !self.is_within(self.path.span(), self.times[pulse]) {
                Fault::Time
            } else {
                continue;
            };
            return Err(BadPulse { pulse, fault });
        }
        Ok(())
    }

    #[inline(always)]
    fn is_within(&self, [first, last]: [f64; 2], time: f64) -> bool {
        let time = self.start + time;
        time.is_finite() & (first <= time) & (time <= last)
    }
}

/// A pulse that cannot be fired, and why.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct BadPulse {
    pub pulse: usize,
    pub fault: Fault,
}

#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub enum Fault {
    /// Its direction is not a unit vector.
    Direction,
    /// Its origin is not finite.
    Origin,
    /// There is no pose for its time.
    Time,
}
