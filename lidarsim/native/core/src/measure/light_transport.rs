//! Light that goes on: through surfaces that transmit it, and from mirrors.
//!
//! A pane lets the share T of the light pass straight on, and a mirror sends the share M on in the mirrored
//! direction. What a surface further on sends back takes the same path in reverse, since light paths are
//! reversible, and is weakened by the same shares once more. So the power that is received by a path is that
//! of the surface at its end, seen at the length of the path, times the square of the product of the shares.
//! The surfaces on the path send back their own light as if they were the last.
//!
//! A pulse meets up to `depth` surfaces on each path. At each depth, the paths of a ray are up to twice as
//! many as before; the `MOST_PATHS` of greatest share are followed, of equal ones the first, where straight
//! on comes before mirrored.

use super::columns::unused;
use super::direction::distance;
use super::echo::Echo;
use super::light_paths::{LightPath, LightPaths, LightTransport, PathSegment, PathVertex};
use super::scan::Scan;
use super::scratch::Scratch;
use crate::arith::simd::Isa;
use crate::cast::{Cast, Departure, SurfaceHit, next_hit};
use crate::geometry::point::dot;
use crate::geometry::vector::Point;
use crate::memory::push;
use crate::scene::{Hit, Rays, TRange, TimedRay, World};
use crate::stop;

/// Paths of a ray that are followed at each depth.
const MOST_PATHS: usize = 16;

/// Paths that are followed between two polls for a stop of the scan.
const POLL: usize = 64;

impl Scan<'_> {
    /// Follows the light of the fired rays that goes on.
    pub(super) fn go_on<I: Isa>(&self, transport: &LightTransport, scratch: &mut Scratch) {
        let fired = scratch.hits.len();
        let mut paths = std::mem::take(&mut scratch.paths);
        paths.front.clear();
        for at in 0..fired {
            if self.goes_on(scratch.hits.object[at]) {
                let met = SurfaceHit::from(scratch.hits.at(at));
                let path = LightPath { ray: at as u32, passed: 0, mirror: None, before: 0.0, share: 1.0 };
                push(&mut paths.front, PathVertex { at: at as u32, path, met, solid: None });
            }
        }
        if !paths.front.is_empty() {
            scratch.rays.separate_origins();
        }
        for _ in 1..transport.depth {
            if paths.front.is_empty() {
                break;
            }
            self.leave(&mut paths, scratch);
            find_solid::<I>(&transport.solid, &mut paths);
            self.arrive(transport, &mut paths, scratch);
        }
        paths.sort();
        scratch.paths = paths;
    }

    #[inline]
    fn goes_on(&self, object: i32) -> bool {
        self.appearances.get(object as usize).is_some_and(|appearance| appearance.goes_on())
    }

    /// The steps from the surfaces at the front, those of a ray together.
    #[inline]
    fn leave(&self, paths: &mut LightPaths, scratch: &Scratch) {
        let LightPaths { front, steps, .. } = paths;
        steps.clear();
        let mut first = 0;
        for i in 0..front.len() {
            let PathVertex { at, path, met, solid } = front[i];
            let (hit, ray) = (met.hit, scratch.rays.at(at as usize));
            let appearance = &self.appearances[hit.object as usize];
            let [passed, mirrored] = [appearance.transmission, appearance.mirror];
            let path = LightPath { passed: path.passed + 1, ..path };
            if passed > 0.0 {
                let path = LightPath { share: path.share * passed * passed, ..path };
                push(steps, PathSegment { path, ray, from: Departure::Passed(met), solid });
            }
            if mirrored > 0.0
                && let Some(next) = mirror_image(&ray, &hit)
            {
                let before = path.before + distance::<f64, 1>(hit.t, ray.direction);
                let share = path.share * mirrored * mirrored;
                let path = LightPath { mirror: Some(at), before, share, ..path };
                push(
                    steps,
                    PathSegment { path, ray: next, from: Departure::Mirrored(ray, met), solid: None },
                );
            }
            if front.get(i + 1).is_none_or(|next| next.path.ray != path.ray) {
                keep_strongest(steps, first);
                first = steps.len();
            }
        }
    }

    /// Finds the next surface of each step.
    #[inline]
    fn arrive(&self, transport: &LightTransport, paths: &mut LightPaths, scratch: &mut Scratch) {
        let LightPaths { paths, front, steps, stack, .. } = paths;
        let (rays, hits) = (&mut scratch.rays, &mut scratch.hits);
        let stack = stack.get_or_insert_default();
        front.clear();
        for (i, PathSegment { path, ray, from, solid }) in steps.iter().enumerate() {
            if i.is_multiple_of(POLL) {
                stop::poll();
            }
            let solid = solid.unwrap_or(Hit::MISS);
            let found = next_hit(self.world, &transport.passing, &solid, ray, from, stack);
            let Some(met) = found else { continue };
            let at = hits.len();
            push(paths, *path);
            push(&mut rays.origins, ray.origin);
            push(&mut rays.directions, ray.direction);
            if !rays.times.is_empty() {
                push(&mut rays.times, ray.time);
            }
            hits.push(&met.hit);
            if self.goes_on(met.hit.object) {
                push(front, PathVertex { at: at as u32, path: *path, met, solid: Some(solid) });
            }
        }
    }
}

/// Keeps the steps of a ray, those from `first` on, of the greatest shares, in their order.
fn keep_strongest(steps: &mut Vec<PathSegment>, first: usize) {
    if steps.len() - first > MOST_PATHS {
        let mut shares: Vec<f64> = steps[first..].iter().map(|step| step.path.share).collect();
        shares.sort_unstable_by(|a, b| b.total_cmp(a));
        let least = shares[MOST_PATHS - 1];
        let mut equal = MOST_PATHS - shares.iter().filter(|share| **share > least).count();
        let mut i = 0;
        steps.retain(|step| {
            i += 1;
            let is_kept = i <= first || step.path.share > least || step.path.share == least && equal > 0;
            equal -= usize::from(i > first && is_kept && step.path.share == least);
            is_kept
        });
    }
}

/// Finds the closest solid hit of each step that does not know it. Neighbours that go straight on, and those
/// that a mirror turns, are alike; together they are not.
fn find_solid<I: Isa>(solid: &World, paths: &mut LightPaths) {
    let LightPaths { steps, origins, directions, times, solid: hits, .. } = paths;
    for are_mirrored in [false, true] {
        let is_asked = |step: &PathSegment| {
            step.solid.is_none() && matches!(step.from, Departure::Mirrored(..)) == are_mirrored
        };
        for array in [&mut *origins, &mut *directions] {
            array.clear();
        }
        times.clear();
        for step in steps.iter().filter(|step| is_asked(step)) {
            push(origins, step.ray.origin);
            push(directions, step.ray.direction);
            if solid.scene.moves() {
                push(times, step.ray.time);
            }
        }
        if origins.is_empty() {
            continue;
        }
        hits.resize(origins.len());
        let rays = Rays::new(origins, directions, times);
        I::call(Cast { world: solid, rays, range: TRange::RAY, hits: &mut hits.columns() });
        for (at, step) in steps.iter_mut().filter(|step| is_asked(step)).enumerate() {
            step.solid = Some(hits.at(at));
        }
    }
}

/// The ray that a mirror makes of one that hits it: from the point o + t·d, in the direction d −
/// (2·(d·n)/(n·n))·n. Both are evaluated in float64 once, the products of a sum from x to z. `None` if
/// the point overflows.
fn mirror_image(ray: &TimedRay, hit: &Hit) -> Option<TimedRay> {
    let (d, n) = (ray.direction, hit.normal);
    let twice = 2.0 * dot(d, n) / dot(n, n);
    let direction = [0, 1, 2].map(|k| d[k] - twice * n[k]);
    let origin = [0, 1, 2].map(|k| ray.origin[k] + hit.t * d[k]);
    let is_legal = origin.iter().chain(&direction).all(|x| x.is_finite()) && direction != [0.0; 3];
    is_legal.then_some(TimedRay { origin, direction, time: ray.time })
}

impl Scan<'_> {
    /// The place of a surface that was seen in mirrors, in the sensor frame when it fired a pulse.
    #[inline]
    pub(super) fn mirrored_point(&self, pulse: usize, at: usize, scratch: &Scratch) -> Point {
        if scratch.paths.path(at).is_none_or(|path| path.mirror.is_none()) {
            return unused::mirrored_point;
        }
        let TimedRay { origin, direction, .. } = scratch.rays.at(at);
        let point = [0, 1, 2].map(|k| origin[k] + scratch.hits.t[at] * direction[k]);
        self.frame.path.at(self.frame.start + self.frame.times[pulse]).place_back(point)
    }
}

impl Scratch {
    /// The echoes of the lights of a fired ray, by rising range.
    pub(super) fn echoes_of_ray(&self, ray: usize, echoes: &mut Vec<Echo>) {
        echoes.clear();
        echoes.extend(self.light_of(ray).into_iter().chain(self.further_lights(ray)).map(Echo::of));
        echoes.sort_unstable_by(|a, b| a.range.total_cmp(&b.range).then(a.ray.cmp(&b.ray)));
    }

    /// The normal of a surface as the fired rays see it: that of its image, if it is seen in mirrors.
    pub(super) fn normal_of_image(&self, at: usize) -> Point {
        let mut normal = self.hits.normal(at);
        let mut path = self.paths.path(at);
        while let Some(mirror) = path.and_then(|path| path.mirror) {
            let n = self.hits.normal(mirror as usize);
            let twice = 2.0 * dot(normal, n) / dot(n, n);
            normal = [0, 1, 2].map(|k| normal[k] - twice * n[k]);
            path = self.paths.path(mirror as usize);
        }
        normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    fn step(share: f64, passed: u8) -> PathSegment {
        let ray = TimedRay { origin: [0.0; 3], direction: [1.0, 0.0, 0.0], time: 0.0 };
        let from = Departure::Passed(SurfaceHit::from(Hit::MISS));
        PathSegment {
            path: LightPath { ray: 0, passed, mirror: None, before: 0.0, share },
            ray,
            from,
            solid: None,
        }
    }

    #[test]
    fn the_strongest_paths_are_kept_in_their_order() {
        let others = [step(0.0, 200), step(1.0, 201)];
        let kept = |shares: &[f64]| {
            let mut steps: Vec<PathSegment> = others.to_vec();
            steps.extend((0..).zip(shares).map(|(passed, share)| step(*share, passed)));
            keep_strongest(&mut steps, others.len());
            let passed: Vec<u8> = steps.iter().map(|step| step.path.passed).collect();
            assert_eq!(passed[..2], [200, 201]);
            passed[2..].to_vec()
        };
        assert_eq!(kept(&[0.5; MOST_PATHS]), (0..MOST_PATHS as u8).collect::<Vec<_>>());
        assert_eq!(kept(&[0.5; 3 * MOST_PATHS]), (0..MOST_PATHS as u8).collect::<Vec<_>>());
        let rising: Vec<f64> = (0..40).map(|k| f64::from(k) / 40.0).collect();
        assert_eq!(kept(&rising), (40 - MOST_PATHS as u8..40).collect::<Vec<_>>());
        let mut mixed = vec![0.25; 20];
        (mixed[3], mixed[19]) = (0.5, 0.75);
        let expected: Vec<u8> = (0..15).chain([19]).collect();
        assert_eq!(kept(&mixed), expected);
    }
}
