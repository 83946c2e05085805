//! View culling: the pulses that cannot meet some instances, found without a cast.
//!
//! The box of an instance is given in the sensor frame at the middle of a short span of time. It is widened
//! by how far the sensor moves and turns in that span, and by how far apart pulses start. All pulses of the
//! span are then taken to start at one point, and each widened box is a window: in each bin of azimuth that
//! it covers, a range of slopes z/(|x| + |y|). A pulse can meet the instance only if its slope is in that
//! range.

use crate::arith::number::{Interval, UNIT};
use crate::bvh::Bvh;
use crate::cast::NO_INSTANCE;
use crate::geometry::affine::Affine;
use crate::geometry::dop::Dop;
use crate::geometry::origins::Origins;
use crate::geometry::pose::Path;
use crate::geometry::ray::union;
use crate::geometry::vector::{Point, length_above};
use crate::memory;
use crate::scene::World;

/// The bins of half a turn.
const BINS: usize = 512;

const ANY: Interval = Interval { low: f64::NEG_INFINITY, high: f64::INFINITY };
const NONE: Interval = Interval { low: f64::INFINITY, high: f64::NEG_INFINITY };

/// The box of each instance, around all of its objects. `instances` has the instance of each object of the
/// world, or `NO_INSTANCE`; `count` is the number of instances.
pub fn boxes_of_instances(world: &World, instances: &[u32], count: usize) -> Vec<(u32, [Interval; 3])> {
    let mut boxes = Vec::new();
    memory::resize(&mut boxes, count, [NONE; 3]);
    let unbounded = world.index.unbounded.iter().map(|id| (id, [ANY; 3]));
    let movers = world.movers().into_iter().flat_map(Bvh::boxes);
    for (id, bounds) in unbounded.chain(world.index.bounded.boxes()).chain(movers) {
        let instance = instances[*id as usize];
        if instance != NO_INSTANCE {
            let all = &mut boxes[instance as usize];
            *all = union(*all, bounds);
        }
    }
    (0..).zip(boxes).filter(|(_, bounds)| bounds[0].low <= bounds[0].high).collect()
}

/// The directions in the sensor frame in which some instances may be met.
pub struct Windows {
    /// Instances and their ranges of slopes, sorted by bin. The first `BINS` go from the x axis to its
    /// negative where y ≥ 0, the others where y < 0.
    windows: Vec<(u32, Interval)>,
    /// The index of the first window of each bin, and the number of all windows.
    starts: [u32; 2 * BINS + 1],
}

impl Windows {
    /// The windows of boxes in the world. `origins`, in the sensor frame, are those of the pulses, which are
    /// fired along the path within a span of time, s.
    pub fn new(
        origins: Origins,
        path: &Path,
        [first, last]: [f64; 2],
        boxes: &[(u32, [Interval; 3])],
    ) -> Self {
        let view = Affine::from(path.at(first + 0.5 * (last - first)).inverse());
        let [travel, turn] = path.drift([first, last]);
        let starts = match origins {
            Origins::One(origin) => origin.map(Interval::point),
            Origins::Each(origins) => box_around(origins),
        };
        let middle = starts.map(Interval::middle);
        let aside = 0.5 * length_above(starts.map(|side| side.high - side.low));
        let mut of_bins = Vec::new();
        for (instance, bounds) in boxes {
            let seen = Dop::of_box(*bounds).image(&view);
            // Let M be the middle pose, and T the pose of a pulse with origin o and direction d. If its ray
            // meets a point q of the box, s·d = T⁻¹M·q − o for some s ≥ 0. T⁻¹M turns by at most
            // `turn` and moves by at most `travel`. Both include an allowance for rounded poses, relative
            // to all lengths, which far exceeds the rounding of the box, of its image, of the ray, and of
            // `middle`, from which o is at most `aside` away.
            let reach = length_above(seen.map(farthest)) + length_above(middle);
            let wide = (travel + turn.min(2.0) * (reach + travel) + aside) * (1.0 + 16.0 * UNIT);
            let side = |axis: usize| Interval {
                low: seen[axis].low - middle[axis] - wide,
                high: seen[axis].high - middle[axis] + wide,
            };
            add(&mut of_bins, *instance, [0, 1, 2].map(side));
        }
        Windows::by_bin(&of_bins)
    }

    /// A counting sort of windows by bin.
    fn by_bin(of_bins: &[(usize, u32, Interval)]) -> Self {
        let mut starts = [0; 2 * BINS + 1];
        for (bin, ..) in of_bins {
            starts[*bin] += 1;
        }
        let mut end = 0;
        for start in &mut starts {
            end += *start;
            *start = end;
        }
        let mut windows = Vec::new();
        memory::resize(&mut windows, of_bins.len(), (0, NONE));
        for &(bin, instance, slopes) in of_bins {
            starts[bin] -= 1;
            windows[starts[bin] as usize] = (instance, slopes);
        }
        Windows { windows, starts }
    }

    /// Whether a pulse may meet an instance other than `known`.
    #[inline(always)]
    pub fn hold(&self, [x, y, z]: &Point, known: u32) -> bool {
        let level = x.abs() + y.abs();
        let (bin, slope) = (bin(x / level, *y < 0.0), z / level);
        let may_meet = |(instance, slopes): &(u32, Interval)| {
            (*instance != known) & (slopes.low <= slope) & (slope <= slopes.high)
        };
        // A vertical direction has no azimuth.
        self.of_bin(bin).iter().any(may_meet) || level == 0.0
    }

    #[inline(always)]
    fn of_bin(&self, bin: usize) -> &[(u32, Interval)] {
        &self.windows[self.starts[bin] as usize..self.starts[bin + 1] as usize]
    }
}

/// Adds the window of a box, which has all directions if the z axis crosses the box or it is not finite.
fn add(of_bins: &mut Vec<(usize, u32, Interval)>, instance: u32, [x, y, z]: [Interval; 3]) {
    let (near, far) = (nearest(x) + nearest(y), farthest(x) + farthest(y));
    if !(near > 0.0 && (far + farthest(z)).is_finite()) {
        (0..2 * BINS).for_each(|bin| memory::push(of_bins, (bin, instance, ANY)));
        return;
    }
    let halves = [
        (y.high >= 0.0, Interval { low: y.low.max(0.0), ..y }),
        (y.low <= 0.0, Interval { high: y.high.min(0.0), ..y }),
    ];
    for (half, (is_met, y)) in halves.into_iter().enumerate() {
        if !is_met {
            continue;
        }
        // Of a rectangle on one side of the x axis, corners have the extreme azimuths; one bin more at
        // either end, as quotients are rounded.
        let corners = [[x.low, y.low], [x.low, y.high], [x.high, y.low], [x.high, y.high]];
        let bins = corners.map(|[x, y]| bin(x / (x.abs() + y.abs()), false));
        let [from, to] =
            bins.into_iter().fold([usize::MAX, 0], |[from, to], bin| [from.min(bin), to.max(bin)]);
        for bin in from.saturating_sub(1)..=(to + 1).min(BINS - 1) {
            let slopes = slopes_within(bin, [x, y, z]);
            memory::push(of_bins, (half * BINS + bin, instance, slopes));
        }
    }
}

/// The slopes in a bin of half a turn that a box on one side of the x axis covers.
///
/// A point (x, y) at a distance t = |x| + |y| is in the bin by x/t. As that quotient is rounded, the range of
/// x/t is widened by a bin at either end.
fn slopes_within(bin: usize, [x, y, z]: [Interval; 3]) -> Interval {
    let place = |end: f64| (1.0 - 2.0 * end / BINS as f64).clamp(-1.0, 1.0);
    let across = Interval { low: place(bin as f64 + 2.0), high: place(bin as f64 - 1.0) };
    let (least, most) = (nearest(across), farthest(across));
    let near = (nearest(x) / most).max(nearest(y) / (1.0 - least)).max(nearest(x) + nearest(y));
    let far = (farthest(x) / least).min(farthest(y) / (1.0 - most)).min(farthest(x) + farthest(y));
    // These and the slopes of pulses have at most four roundings each.
    let low = z.low / if z.low < 0.0 { near } else { far };
    let high = z.high / if z.high > 0.0 { near } else { far };
    Interval { low: low - 8.0 * UNIT * low.abs(), high: high + 8.0 * UNIT * high.abs() }
}

/// The least magnitude in an interval.
fn nearest(side: Interval) -> f64 {
    side.low.max(0.0) - side.high.min(0.0)
}

/// The greatest magnitude in an interval.
fn farthest(side: Interval) -> f64 {
    side.low.abs().max(side.high.abs())
}

/// The bin of x/(|x| + |y|), which falls from 1 to −1 in half a turn from the x axis on.
#[inline(always)]
fn bin(place: f64, is_below: bool) -> usize {
    let within = ((0.5 - 0.5 * place) * BINS as f64) as usize;
    within.min(BINS - 1) + if is_below { BINS } else { 0 }
}

/// The box around points. It takes eight at a time, which vectorizes.
fn box_around(points: &[Point]) -> [Interval; 3] {
    let ([mut low, mut high], (eights, others)) =
        ([[f64::INFINITY; 24], [f64::NEG_INFINITY; 24]], points.as_flattened().as_chunks::<24>());
    for eight in eights {
        for k in 0..24 {
            low[k] = if eight[k] < low[k] { eight[k] } else { low[k] };
            high[k] = if eight[k] > high[k] { eight[k] } else { high[k] };
        }
    }
    for (k, x) in others.iter().enumerate() {
        (low[k], high[k]) = (low[k].min(*x), high[k].max(*x));
    }
    let at = |k: usize| [0, 1, 2].map(|axis| Interval { low: low[3 * k + axis], high: high[3 * k + axis] });
    (0..8).map(at).fold([NONE; 3], union)
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
        let (mut met, mut alone, mut held, mut count, mut anywhere) = (0, 0, 0, 0, 0);
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
            // Pulses start beside the frame of the sensor, too.
            let mount = within(12.0);
            let origin = |from: Point| std::array::from_fn(|k| mount[k] + from[k]);
            let origins: Vec<Point> = times.iter().map(|_| origin(within(aside))).collect();
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
            let instances = [0, 1, 2, NO_INSTANCE];
            let boxes = boxes_of_instances(&scene.during(span), &instances, 3);
            assert_eq!(boxes.len(), 3);
            let windows = Windows::new(Origins::Each(&origins), &path, span, &boxes);
            if windows.of_bin(0).iter().any(|(_, slopes)| slopes.low == ANY.low) {
                anywhere += 1;
                continue;
            }
            for (direction, instance) in directions.iter().zip(instances.into_iter().cycle()) {
                if instance != NO_INSTANCE {
                    let other = (instance + 1) % 3;
                    assert!(windows.hold(direction, NO_INSTANCE), "{round} {direction:?}");
                    assert!(windows.hold(direction, other), "{round} {direction:?}");
                    alone += usize::from(!windows.hold(direction, instance));
                    met += 1;
                }
            }
            held += others.iter().filter(|direction| windows.hold(direction, NO_INSTANCE)).count();
            count += others.len();
        }
        assert!(met > 20_000 && anywhere < 60, "{met} {anywhere}");
        assert!(alone > met / 2, "{alone} of {met}");
        assert!(held * 4 < count && held > 0, "{held} of {count}");
    }

    #[test]
    fn slopes_of_bins_hold_those_of_the_points_of_a_box() {
        let mut number = numbers();
        let (mut narrow, mut count) = (0, 0);
        for round in 0..3000 {
            let mut side = |low: f64, high: f64| {
                let [a, b] = [(); 2].map(|()| low + (high - low) * number());
                Interval { low: a.min(b), high: a.max(b) }
            };
            let size = [0.1, 1.0, 10.0][round % 3];
            let bounds = [side(-size, size), side(0.0, 2.0), side(-2.0, 1.0)];
            let [x, y, z] = bounds;
            let (near, far) = (nearest(x) + nearest(y), farthest(x) + farthest(y));
            let least = z.low / if z.low < 0.0 { near } else { far };
            for k in 0..40 {
                let place = |axis: usize, x: f64| {
                    let Interval { low, high } = bounds[axis];
                    if k < 8 { [low, high][k >> axis & 1] } else { (low + (high - low) * x).min(high) }
                };
                let [x, y, z] = [0, 1, 2].map(|axis| place(axis, number()));
                let level = x.abs() + y.abs();
                let (found, slope) = (bin(x / level, false), z / level);
                for beside in found.saturating_sub(1)..=(found + 1).min(BINS - 1) {
                    let Interval { low, high } = slopes_within(beside, bounds);
                    assert!(low <= slope && slope <= high, "{bounds:?} {x} {y} {z}");
                    narrow += usize::from(low - least > 0.1 * least.abs());
                    count += 1;
                }
            }
        }
        assert!(narrow * 4 > count, "{narrow} of {count}");
    }
}
