//! View culling: the pulses of a frame that cannot meet some objects, found without a cast.
//!
//! Seen from the sensor in the middle of the frame, an object lies in a box. The ray of any pulse starts near
//! the sensor and runs nearly as its direction says there, so that it can meet only the box widened by what
//! the sensor moves and turns meanwhile. All pulses are then taken to start at one point, and each widened
//! box is a window: a range of azimuths, and a range of slopes z/(|x| + |y|). Each bin of azimuth has the
//! range of the slopes of its windows, in which the slope of a pulse must lie.

use crate::arith::number::{Interval, UNIT};
use crate::bvh::Bvh;
use crate::geometry::affine::Affine;
use crate::geometry::dop::Dop;
use crate::geometry::origins::Origins;
use crate::geometry::pose::Path;
use crate::geometry::vector::{Point, length_above};
use crate::memory;
use crate::scene::World;

/// The bins of half a turn.
const BINS: usize = 512;

/// The directions in the sensor frame in which some objects may be met.
pub struct Windows {
    /// By bin, the range of slopes: of half a turn from the x axis to its negative, and then of the other
    /// half, again from the x axis.
    slopes: Vec<Interval>,
}

impl Windows {
    /// The windows of the objects of a world that `is_asked` tells, for pulses from these origins, in the
    /// sensor frame, along a path within a span of time; `None` if some may be met in any direction.
    pub fn new(
        origins: Origins,
        path: &Path,
        [first, last]: [f64; 2],
        world: &World,
        is_asked: impl Fn(u32) -> bool,
    ) -> Option<Self> {
        let view = Affine::from(path.at(first + 0.5 * (last - first)).inverse());
        let [travel, turn] = path.drift([first, last]);
        let start = match origins {
            Origins::One(origin) => length_above(origin),
            Origins::Each(origins) => length_above(farthest(origins)),
        };
        let (mut slopes, none) = (Vec::new(), Interval { low: f64::INFINITY, high: f64::NEG_INFINITY });
        memory::resize(&mut slopes, 2 * BINS, none);
        if world.index.unbounded.iter().any(|&id| is_asked(id)) {
            return None;
        }
        let boxes = world.index.bounded.boxes().chain(world.movers().into_iter().flat_map(Bvh::boxes));
        for (_, bounds) in boxes.filter(|(id, _)| is_asked(**id)) {
            let seen = Dop::of_box(bounds).image(&view);
            // Let M be the middle pose, and T the pose of a pulse with origin o and direction d. If its ray
            // meets a point q of the box, s·d = T⁻¹M·q − o for some s ≥ 0. T⁻¹M turns by at most
            // `turn` and moves by at most `travel`. Both include an allowance for rounded poses, relative
            // to all lengths, which far exceeds the rounding of the box, of its image and of the ray.
            let reach = length_above(seen.map(|side| side.low.abs().max(side.high.abs())));
            let wide = (travel + turn.min(2.0) * (reach + travel) + start) * (1.0 + 16.0 * UNIT);
            let window = seen.map(|side| Interval { low: side.low - wide, high: side.high + wide });
            add(&mut slopes, window)?;
        }
        Some(Windows { slopes })
    }

    /// Whether a pulse may meet any of the objects.
    #[inline(always)]
    pub fn hold(&self, [x, y, z]: &Point) -> bool {
        let level = x.abs() + y.abs();
        let (bin, slope) = (bin(x / level, *y < 0.0), z / level);
        let Interval { low, high } = self.slopes[bin];
        // A vertical direction has no azimuth.
        low <= slope && slope <= high || level == 0.0
    }
}

/// The bin of x/(|x| + |y|), which falls from 1 to −1 in half a turn from the x axis on.
#[inline(always)]
fn bin(place: f64, is_below: bool) -> usize {
    let within = ((0.5 - 0.5 * place) * BINS as f64) as usize;
    within.min(BINS - 1) + if is_below { BINS } else { 0 }
}

/// Extends the slopes of the bins that a box covers; `None` if the z axis crosses it, or it is not finite.
fn add(slopes: &mut [Interval], [x, y, z]: [Interval; 3]) -> Option<()> {
    let nearest = |side: Interval| side.low.max(0.0) - side.high.min(0.0);
    let most = |side: Interval| side.low.abs().max(side.high.abs());
    let (near, far) = (nearest(x) + nearest(y), most(x) + most(y));
    if !(near > 0.0 && (far + most(z)).is_finite()) {
        return None;
    }
    // These and the slopes of pulses have at most four roundings each.
    let low = z.low / if z.low < 0.0 { near } else { far };
    let high = z.high / if z.high > 0.0 { near } else { far };
    let [low, high] = [low - 8.0 * UNIT * low.abs(), high + 8.0 * UNIT * high.abs()];
    let halves = [(y.high >= 0.0, y.low.max(0.0), y.high), (y.low <= 0.0, y.low, y.high.min(0.0))];
    for (half, (is_met, first, last)) in halves.into_iter().enumerate() {
        if !is_met {
            continue;
        }
        // Of a rectangle on one side of the x axis, corners have the extreme azimuths; one bin more at either
        // end, as quotients are rounded.
        let corners = [[x.low, first], [x.low, last], [x.high, first], [x.high, last]];
        let bins = corners.map(|[x, y]| bin(x / (x.abs() + y.abs()), half == 1));
        let [from, to] =
            bins.into_iter().fold([usize::MAX, 0], |[from, to], bin| [from.min(bin), to.max(bin)]);
        let [from, to] = [from.saturating_sub(1).max(half * BINS), (to + 1).min((half + 1) * BINS - 1)];
        for slope in &mut slopes[from..=to] {
            *slope = Interval { low: slope.low.min(low), high: slope.high.max(high) };
        }
    }
    Some(())
}

/// The greatest magnitudes of the coordinates of points. Eight points at a time, which vectorizes.
fn farthest(points: &[Point]) -> Point {
    let (mut most, (eights, others)) = ([0.0_f64; 24], points.as_flattened().as_chunks::<24>());
    for eight in eights {
        for (most, x) in most.iter_mut().zip(eight) {
            *most = if x.abs() > *most { x.abs() } else { *most };
        }
    }
    for (most, x) in most.iter_mut().zip(others) {
        *most = most.max(x.abs());
    }
    let point = |axis: usize| most.iter().skip(axis).step_by(3).fold(0.0, |most: f64, x| most.max(*x));
    [0, 1, 2].map(point)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::pose::Pose;
    use crate::geometry::vector::length_above;
    use crate::scene::{Geometry, Object, Scene};
    use crate::shapes::Sphere;
    use crate::testing::numbers;

    /// Balls around a sensor that in turn moves fast, turns fast, and has pulses that start far from it.
    #[test]
    fn windows_hold_all_pulses_that_meet_a_ball_and_few_others() {
        let mut number = numbers();
        let (mut met, mut held, mut count, mut anywhere) = (0, 0, 0, 0);
        for round in 0..120 {
            let mut within = |most: f64| [(); 3].map(|()| most * (2.0 * number() - 1.0));
            let [speed, spin, aside] = [[30.0, 0.01, 0.01], [0.01, 3.0, 0.01], [0.01, 0.01, 2.0]][round % 3];
            let still = Path::Still(Pose::from_rows([
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ]));
            let moving = |within: &mut dyn FnMut(f64) -> Point, place: f64, speed: f64, spin: f64| {
                let start = Path::twist(still.at(0.0), within(place), within(2.0)).at(1.0);
                Path::twist(start, within(speed), within(spin))
            };
            let (sensor, mount) =
                (moving(&mut within, 5.0, speed, spin), moving(&mut within, 2.0, 0.0, 0.0).at(0.0));
            let path = if round % 2 == 0 { sensor } else { Arc::new(sensor).mounted(&mount) };
            let balls: Vec<(Path, Sphere)> = (0..4)
                .map(|_| {
                    let center = path.at(0.0).place(within(40.0));
                    (moving(&mut within, 0.0, 10.0, 0.1), Sphere { center, radius: 0.5 })
                })
                .collect();
            let object = |(path, ball): &(Path, Sphere)| {
                Object::new(Geometry::Surface((*ball).into()), false).moving(Arc::new(path.clone()))
            };
            let scene = Scene::new(balls.iter().map(object).collect());
            let times: Vec<f64> = (0..500).map(|i| f64::from(i) * 2e-4).collect();
            let origins: Vec<Point> = times.iter().map(|_| within(aside)).collect();
            let (mut directions, mut others) = (Vec::new(), Vec::new());
            for (i, (time, origin)) in times.iter().zip(&origins).enumerate() {
                let (motion, Sphere { center, radius }) = &balls[i % balls.len()];
                let (out, pose) = (within(1.0), path.at(0.5 + time));
                let length = length_above(out);
                let point = motion
                    .at(0.5 + time)
                    .place(std::array::from_fn(|k| center[k] + radius * out[k] / length));
                let there = pose.place_back(point);
                directions.push(std::array::from_fn(|k| there[k] - origin[k]));
                others.push(within(1.0));
            }
            let span = [0.5, 0.5 + times[times.len() - 1]];
            let found = Windows::new(Origins::Each(&origins), &path, span, &scene.during(span), |_| true);
            let Some(windows) = found else {
                anywhere += 1;
                continue;
            };
            for direction in &directions {
                assert!(windows.hold(direction), "{round} {direction:?}");
                met += 1;
            }
            held += others.iter().filter(|direction| windows.hold(direction)).count();
            count += others.len();
        }
        assert!(met > 30_000 && anywhere < 60, "{met} {anywhere}");
        assert!(held * 4 < count && held > 0, "{held} of {count}");
    }
}
