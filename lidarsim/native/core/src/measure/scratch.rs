//! Memory that one batch of pulses leaves to the next.

use super::effects::Draws;
use super::grain::GrainHits;
use super::light_paths::LightPaths;
use crate::cast::HitArrays;
use crate::geometry::origins::Origins;
use crate::geometry::pose::Motion;
use crate::geometry::vector::Point;
use crate::memory::resize;
use crate::scene::TimedRay;

/// What a batch of pulses needs. With a beam, a pulse has several rays, which follow one another.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) rays: RayArrays,
    pub(super) hits: HitArrays,
    /// From the receiver to what the rays hit.
    pub(super) shadow_rays: RayArrays,
    /// The surfaces that light goes on to.
    pub(super) paths: LightPaths,
    /// Per ray; unspecified for misses.
    pub(super) reflectivity: Vec<f64>,
    /// Empty between batches.
    pub(super) grain_hits: GrainHits,
    /// Whether all surfaces that were hit are Lambert's.
    pub(super) is_lambert: bool,
    pub(super) light: LightArrays,
    /// Per row: the products of the ray's direction with the relative velocity of the surface, and with
    /// itself. Empty if nothing moves.
    pub(super) range_rate: Vec<[f64; 2]>,
    pub(super) velocities: Velocities,
    /// Per pulse: its number in the whole frame.
    pub(super) indices: Vec<u64>,
    pub(super) draws: Draws,
    /// One bit per pulse, eight to a byte: whether it is measured one by one.
    pub(super) wanted: Vec<u8>,
}

/// Rays in the world.
#[derive(Default)]
pub(super) struct RayArrays {
    /// One per ray, or a common one.
    pub(super) origins: Vec<Point>,
    pub(super) directions: Vec<Point>,
    /// Empty if no surface moves.
    pub(super) times: Vec<f64>,
}

impl RayArrays {
    #[inline(always)]
    pub(super) fn origins(&self) -> Origins<'_> {
        match self.origins[..] {
            [origin] => Origins::One(origin),
            _ => Origins::Each(&self.origins),
        }
    }

    /// Gives each ray an origin of its own, so that rays from elsewhere can follow.
    pub(super) fn separate_origins(&mut self) {
        if let [origin] = self.origins[..] {
            resize(&mut self.origins, self.directions.len(), origin);
        }
    }

    #[inline(always)]
    pub(super) fn at(&self, ray: usize) -> TimedRay {
        let time = *self.times.get(ray).unwrap_or(&0.0);
        TimedRay { origin: self.origins().of(ray), direction: self.directions[ray], time }
    }
}

/// With a beam, per ray: the light that it brings back. Unspecified for misses.
#[derive(Default)]
pub(super) struct LightArrays {
    pub(super) range: Vec<f64>,
    /// Of the incidence.
    pub(super) cosine: Vec<f64>,
    /// In clear air.
    pub(super) intensity: Vec<f64>,
    /// The share that the atmosphere leaves.
    pub(super) transmission: Vec<f64>,
    /// What the atmosphere leaves of the intensity, and the power of that.
    pub(super) received: Vec<f64>,
    pub(super) power: Vec<f64>,
}

/// Velocities in the world.
#[derive(Default)]
pub(super) struct Velocities {
    /// Per pulse: that of its origin. Empty if the sensor does not move.
    pub(super) origins: Vec<Point>,
    /// The motion of the moving object that was hit last, and when: neighbours often hit it at one time.
    pub(super) object: Option<((i32, f64), Motion)>,
}
