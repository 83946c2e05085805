//! Surfaces that the beam lights and the receiver beside the emitter does not see, since others hide them.

use std::ops::Range;

use super::direction::Axis;
use super::scan::Scan;
use super::scratch::Scratch;
use crate::arith::simd::Isa;
use crate::cast::{Cast, HitArrays};
use crate::geometry::point::{dot, sub};
use crate::memory::resize;
use crate::scene::{Hit, Rays, Sink, TRange, TimedRay};

/// Turns the hits whose shadow rays hit anything into misses, but for those of the `seen` rays.
struct Hide<'a> {
    hits: &'a mut HitArrays,
    seen: &'a [usize],
}

impl Sink for Hide<'_> {
    const ANY: bool = true;

    fn clear(&mut self, _: Range<usize>) {}

    #[inline(always)]
    fn write(&mut self, i: usize, _: Hit) {
        if self.seen.binary_search(&i).is_err() {
            self.hits.columns().write(i, Hit::MISS);
        }
    }
}

impl Scan<'_> {
    /// Turns hits that the receiver does not see into misses. The receiver is to the left of the emitter by
    /// `offset`, m.
    ///
    /// A shadow ray leads from the receiver to the offset before the surface that was hit, so that this one
    /// does not hide itself. A surface nearer to it than that would hide a strip of less than (offset/range)²
    /// rad. A hit nearer to the receiver than the offset is seen. Its shadow ray and that of a miss, as long
    /// as the offset, decide nothing.
    pub(super) fn hide<I: Isa>(&self, pulses: Range<usize>, offset: f64, scratch: &mut Scratch) {
        let (frame, bundle, least) = (self.frame, self.measurement.rays(), offset.abs());
        let Scratch { rays, hits, shadow_rays, .. } = scratch;
        resize(&mut shadow_rays.origins, hits.len(), [0.0; 3]);
        resize(&mut shadow_rays.directions, hits.len(), [0.0; 3]);
        let mut seen = Vec::new();
        for (k, pulse) in pulses.enumerate() {
            let pose = frame.path.at(frame.start + frame.times[pulse]);
            let aside = pose.turn(Axis::of(frame.directions[pulse]).left().map(|x| offset * x));
            for ray in k * bundle..(k + 1) * bundle {
                let TimedRay { origin, direction, .. } = rays.at(ray);
                let way = sub(direction.map(|x| hits.t[ray] * x), aside);
                let share = 1.0 - least / dot(way, way).sqrt();
                shadow_rays.origins[ray] = [0, 1, 2].map(|axis| origin[axis] + aside[axis]);
                let is_hit = hits.object[ray] >= 0;
                shadow_rays.directions[ray] =
                    if is_hit && share > 0.0 { way.map(|x| share * x) } else { direction.map(|x| least * x) };
                if is_hit && share <= 0.0 {
                    seen.push(ray);
                }
            }
        }
        // Through panes the receiver sees.
        let opaque = self.transport.as_ref().map_or(self.world, |transport| &transport.solid);
        let rays = Rays::new(&shadow_rays.origins, &shadow_rays.directions, &rays.times);
        I::call(Cast {
            world: opaque,
            rays: Rays { bundle, ..rays },
            range: TRange { min: 0.0, max: 1.0 },
            hits: &mut Hide { hits, seen: &seen },
        });
    }
}
