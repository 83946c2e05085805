//! Where rays cross the plane of a hierarchy.

use super::ray_packet::{LANES, Mask};

/// Rays of a packet, and bounds of the t at which each crosses the plane of the hierarchy perpendicular to an
/// axis. Rays that never cross it have an empty interval.
#[repr(C, align(64))]
pub struct Crossings {
    pub rays: Mask,
    pub axis: usize,
    pub low: [f64; LANES],
    pub high: [f64; LANES],
}

impl Crossings {
    pub const NONE: Crossings = Crossings { rays: 0, axis: 0, low: [0.0; LANES], high: [0.0; LANES] };
}
