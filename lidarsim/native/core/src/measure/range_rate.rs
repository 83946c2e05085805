//! Radial velocity: how fast the true range grows.

use super::scan::Scan;
use super::scratch::{RayArrays, Scratch, Velocities};
use crate::geometry::point::{dot, sub};
use crate::geometry::pose::Path;
use crate::geometry::vector::Point;
use crate::scene::{Hit, TimedRay};

impl Scan<'_> {
    /// The products of the direction of a ray of a pulse with the relative velocity of what it hits, and with
    /// itself.
    #[inline(always)]
    pub(super) fn range_rate(&self, pulse: usize, ray: usize, scratch: &mut Scratch) -> [f64; 2] {
        if scratch.paths.path(ray).is_some_and(|path| path.mirror.is_some()) {
            return self.range_rate_in_mirrors(pulse, ray, scratch);
        }
        let (velocity, direction) = (self.velocity(pulse, ray, scratch), scratch.rays.directions[ray]);
        [dot(velocity, direction), dot(direction, direction)]
    }

    /// As `range_rate`, of a path that mirrors bend: the rate of change of its length.
    ///
    /// A path of straight parts with directions dᵢ, between points of velocities vᵢ, has the rate Σ
    /// (vᵢ₊₁ − vᵢ)·dᵢ. So each point adds its velocity times the direction of the light that
    /// comes less that of the light that leaves. By Fermat's principle the points at which mirrors are met
    /// do not add to it by moving along them: their velocities are those of the mirrors.
    #[inline]
    fn range_rate_in_mirrors(&self, pulse: usize, surface: usize, scratch: &mut Scratch) -> [f64; 2] {
        let mut direction = scratch.rays.directions[surface];
        let mut rate = dot(self.velocity_of_surface(surface, scratch), direction);
        let mut path = scratch.paths.path(surface).copied();
        while let Some(mirror) = path.and_then(|path| path.mirror) {
            let mirror = mirror as usize;
            let incoming = scratch.rays.directions[mirror];
            rate += dot(self.velocity_of_surface(mirror, scratch), sub(incoming, direction));
            direction = incoming;
            path = scratch.paths.path(mirror).copied();
        }
        if let Some(&origin) = scratch.velocities.origins.get(pulse) {
            rate -= dot(origin, direction);
        }
        [rate, dot(direction, direction)]
    }

    /// The velocity of the point that a ray of a pulse hits, relative to the origin of the pulse.
    #[inline(always)]
    fn velocity(&self, pulse: usize, ray: usize, scratch: &mut Scratch) -> Point {
        let velocity = self.velocity_of_surface(ray, scratch);
        match scratch.velocities.origins.get(pulse) {
            Some(&origin) => sub(velocity, origin),
            None => velocity,
        }
    }

    /// The velocity of the point that a ray hits.
    #[inline(always)]
    fn velocity_of_surface(&self, ray: usize, scratch: &mut Scratch) -> Point {
        let mut velocity = [0.0; 3];
        if let Some(&time) = scratch.rays.times.get(ray)
            && let Some(path) = self.world.scene.objects()[scratch.hits.object[ray] as usize].motion()
        {
            velocity =
                velocity_on(path, time, &scratch.hits.at(ray), ray, &scratch.rays, &mut scratch.velocities);
        }
        velocity
    }
}

#[inline(never)]
fn velocity_on(
    path: &Path,
    time: f64,
    hit: &Hit,
    ray: usize,
    rays: &RayArrays,
    velocities: &mut Velocities,
) -> Point {
    let TimedRay { origin, direction, .. } = rays.at(ray);
    let point = std::array::from_fn(|k| origin[k] + hit.t * direction[k]);
    let key = (hit.object, time);
    let motion = match &mut velocities.object {
        Some((last, motion)) if *last == key => motion,
        other => &mut other.insert((key, path.motion(time))).1,
    };
    motion.velocity_of(motion.pose.place_back(point))
}
