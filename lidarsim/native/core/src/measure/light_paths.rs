//! The paths of light that goes on, and the surfaces that it meets.

use crate::bvh::Stack;
use crate::cast::{Departure, HitArrays, SurfaceHit};
use crate::geometry::vector::Point;
use crate::memory::resize;
use crate::scene::{Hit, TimedRay, World};

/// The scene behind panes and in mirrors.
pub struct LightTransport<'a> {
    /// The most surfaces of a path.
    pub depth: usize,
    /// The objects that light goes on from, and all others.
    pub passing: World<'a>,
    pub solid: World<'a>,
}

/// A surface that light met after it passed others or was mirrored.
#[derive(Clone, Copy)]
pub(super) struct LightPath {
    /// The ray that was fired.
    pub(super) ray: u32,
    /// How many surfaces came before.
    pub(super) passed: u8,
    /// The surface at which the light was mirrored last.
    pub(super) mirror: Option<u32>,
    /// The length of the path up to that mirror, m.
    pub(super) before: f64,
    /// The share of the power that comes back by this path.
    pub(super) share: f64,
}

/// The surfaces that the rays of a batch meet after the first. They follow the fired rays in the arrays of
/// rays and hits; each has the part of its path after the last mirror as its ray.
#[derive(Default)]
pub(super) struct LightPaths {
    /// The number of fired rays.
    pub(super) fired: usize,
    pub(super) paths: Vec<LightPath>,
    /// The surfaces in the order of their fired rays, and where those of each ray begin.
    order: Vec<u32>,
    starts: Vec<u32>,
    pub(super) front: Vec<PathVertex>,
    pub(super) steps: Vec<PathSegment>,
    pub(super) origins: Vec<Point>,
    pub(super) directions: Vec<Point>,
    pub(super) times: Vec<f64>,
    pub(super) solid: HitArrays,
    pub(super) stack: Option<Box<Stack>>,
}

/// A surface from which light may go on.
#[derive(Clone, Copy)]
pub(super) struct PathVertex {
    /// Its index in the arrays of rays and hits.
    pub(super) at: u32,
    pub(super) path: LightPath,
    pub(super) met: SurfaceHit,
    /// The closest hit of its ray on a surface from which light does not go on, once that is known.
    pub(super) solid: Option<Hit>,
}

/// A part of a path that is about to be followed.
#[derive(Clone, Copy)]
pub(super) struct PathSegment {
    pub(super) path: LightPath,
    pub(super) ray: TimedRay,
    pub(super) from: Departure,
    pub(super) solid: Option<Hit>,
}

impl LightPaths {
    pub(super) fn clear(&mut self, fired: usize) {
        self.fired = fired;
        self.paths.clear();
        self.order.clear();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// The path to a surface, unless a fired ray met it first.
    #[inline(always)]
    pub(super) fn path(&self, at: usize) -> Option<&LightPath> {
        if at < self.fired { None } else { self.paths.get(at - self.fired) }
    }

    /// `of` applied to the paths of eight surfaces, from 8·part on; `other` for those without a path.
    #[inline(always)]
    pub(super) fn each(&self, part: usize, other: f64, of: impl Fn(&LightPath) -> f64) -> [f64; 8] {
        let mut values = [other; 8];
        if 8 * part + 8 > self.fired {
            for (k, value) in values.iter_mut().enumerate() {
                *value = self.path(8 * part + k).map_or(other, &of);
            }
        }
        values
    }

    /// Whether the surfaces from 8·part on are part of any paths of more than one surface.
    #[inline(always)]
    pub(super) fn touch(&self, part: usize) -> bool {
        let last = 8 * part + 8;
        last > self.fired || self.starts[8 * part] < self.starts[last]
    }

    /// The fired ray that met a surface.
    #[inline(always)]
    pub(super) fn fired_ray(&self, at: usize) -> usize {
        self.path(at).map_or(at, |path| path.ray as usize)
    }

    /// The surfaces that a fired ray meets after the first, in the order of their numbers.
    #[inline(always)]
    pub(super) fn of(&self, ray: usize) -> &[u32] {
        if self.paths.is_empty() {
            return &[];
        }
        &self.order[self.starts[ray] as usize..self.starts[ray + 1] as usize]
    }

    /// Sorts the surfaces by their fired rays.
    pub(super) fn sort(&mut self) {
        resize(&mut self.starts, 0, 0);
        resize(&mut self.starts, self.fired + 2, 0);
        for path in &self.paths {
            self.starts[path.ray as usize + 2] += 1;
        }
        for ray in 2..self.starts.len() {
            self.starts[ray] += self.starts[ray - 1];
        }
        resize(&mut self.order, self.paths.len(), 0);
        for (at, path) in (self.fired as u32..).zip(&self.paths) {
            let place = &mut self.starts[path.ray as usize + 1];
            self.order[*place as usize] = at;
            *place += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_sorted_by_their_fired_rays() {
        let mut paths = LightPaths::default();
        paths.clear(5);
        for ray in [3, 1, 3, 1, 4, 3] {
            paths.paths.push(LightPath { ray, passed: 1, mirror: None, before: 0.0, share: 1.0 });
        }
        paths.sort();
        let found: Vec<&[u32]> = (0..5).map(|ray| paths.of(ray)).collect();
        assert_eq!(found, [&[][..], &[6, 8], &[], &[5, 7, 10], &[9]]);
        assert_eq!([0, 4, 5, 9, 10].map(|at| paths.fired_ray(at)), [0, 4, 3, 4, 3]);
    }
}
