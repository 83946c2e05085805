//! Scan patterns: where the pulses of a frame go, and when.
//!
//! Pulses that fire together, or in one cycle, are a column; the columns of a frame start at ticks of a
//! steady clock. A formula is a loop over the columns, or channels, of a few registers, which the compiler
//! vectorizes. Each operation is rounded once, so the bits of a pulse depend neither on the instruction set
//! nor on the lanes, pieces and threads that its frame is divided among.

mod cycles;
mod mid360;
mod oscillating_mirror;
mod palmer;
mod polar;
mod risley;
mod rotation;

use std::sync::atomic::{AtomicBool, Ordering};

pub use cycles::{Cycles, Run};
pub use mid360::Mid360;
pub use oscillating_mirror::OscillatingMirror;
pub use palmer::Palmer;
pub use polar::Polar;
pub use risley::{Prism, Risley};
pub use rotation::Rotation;

use crate::arith::simd::{Floats, Isa, Task, store_points};
use crate::geometry::vector::Point;
use crate::memory::{self, split_off};
use crate::parallel;

/// Columns, or channels, whose pulses are computed together: enough for two of the widest registers, so that
/// one operation need not wait for the one before.
const LANES: usize = 32;

/// One number for each of them.
type Lanes = [f64; LANES];

/// Most pulses of a piece of a frame: they stay in the second-level cache.
const MOST: usize = 1 << 13;

/// The formula of a family of patterns, for one frame.
#[derive(Clone, Copy)]
pub enum Formula<'a> {
    Cycles(&'a Cycles),
    Mid360(&'a Mid360),
    OscillatingMirror(&'a OscillatingMirror),
    Palmer(&'a Palmer),
    Polar(&'a Polar<'a>),
    Risley(&'a Risley),
}

impl Formula<'_> {
    /// Pulses of a column.
    fn beams(&self) -> usize {
        match self {
            Formula::Cycles(cycles) => cycles.channels(),
            Formula::Mid360(_) => mid360::BEAMS,
            Formula::Risley(risley) => risley.beams(),
            Formula::OscillatingMirror(_) | Formula::Palmer(_) | Formula::Polar(_) => 1,
        }
    }
}

/// The arrays of some pulses, in firing order.
#[derive(Default)]
pub struct Arrays<'a> {
    /// Unit vectors.
    pub directions: &'a mut [Point],
    /// Where the pulses leave the sensor. Only of [`Cycles`] whose origins turn with the head; else empty.
    pub origins: &'a mut [Point],
    /// Since the start of the frame, s. Only of [`Cycles`]; else empty.
    pub times: &'a mut [f64],
}

impl<'a> Arrays<'a> {
    /// The first pulses, which are no longer in these arrays.
    fn split_off(&mut self, count: usize) -> Arrays<'a> {
        let [origins, times] = [self.origins.len(), self.times.len()].map(|length| length.min(count));
        Arrays {
            directions: split_off(&mut self.directions, count),
            origins: split_off(&mut self.origins, origins),
            times: split_off(&mut self.times, times),
        }
    }
}

/// Consecutive columns of a frame.
pub struct Piece<'a> {
    formula: Formula<'a>,
    /// The number of the first of them.
    first: usize,
    arrays: Arrays<'a>,
}

/// Writes all pulses of a frame, on all threads. `work` runs a piece. False if a prism reflects a pulse
/// totally.
pub fn fire(formula: Formula, mut arrays: Arrays, work: impl Fn(Piece) -> bool + Sync) -> bool {
    let beams = formula.beams();
    let count = arrays.directions.len() / beams.max(1);
    let columns = (MOST / beams.max(1)).max(1).next_multiple_of(LANES);
    let mut pieces = memory::with_capacity(count.div_ceil(columns));
    for first in (0..count).step_by(columns) {
        let arrays = arrays.split_off(columns.min(count - first) * beams);
        memory::push(&mut pieces, Piece { formula, first, arrays });
    }
    let all = AtomicBool::new(true);
    parallel::share(pieces.into_iter(), |piece| {
        if !work(piece) {
            all.store(false, Ordering::Relaxed);
        }
    });
    all.into_inner()
}

impl Task for Piece<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self) -> bool {
        let Piece { formula, first, arrays } = self;
        match formula {
            Formula::Cycles(cycles) => cycles.fire::<I>(first, arrays),
            Formula::Mid360(mid360) => fire_together::<I, _>(mid360, first, arrays),
            Formula::OscillatingMirror(mirror) => fire_together::<I, _>(mirror, first, arrays),
            Formula::Palmer(palmer) => fire_together::<I, _>(palmer, first, arrays),
            Formula::Polar(polar) => fire_together::<I, _>(polar, first, arrays),
            Formula::Risley(risley) => fire_together::<I, _>(risley, first, arrays),
        }
    }
}

/// Beams that fire together.
trait Together {
    /// What the beams of some columns have in common.
    type Common;

    #[inline(always)]
    fn beams(&self) -> usize {
        1
    }
    fn common(&self) -> Self::Common;
    /// Goes to the columns of these numbers, which are whole.
    fn go_to(&self, columns: &Lanes, common: &mut Self::Common);
    /// The directions of a beam, by axis.
    fn directions(&self, beam: usize, common: &mut Self::Common) -> [Lanes; 3];
    /// Whether all beams that were computed leave the sensor.
    #[inline(always)]
    fn is_whole(&self, _: &Self::Common) -> bool {
        true
    }
}

/// Writes the directions of consecutive columns from `first` on.
#[inline(always)]
fn fire_together<I: Isa, T: Together>(formula: &T, first: usize, arrays: Arrays) -> bool {
    let beams = formula.beams();
    let last = (first + arrays.directions.len() / beams).saturating_sub(1);
    let mut common = formula.common();
    for (number, places) in arrays.directions.chunks_mut(LANES * beams).enumerate() {
        // Lanes without a column repeat the last.
        let mut columns = [0.0; LANES];
        for lane in 0..LANES {
            columns[lane] = (first + number * LANES + lane).min(last) as f64;
        }
        formula.go_to(&columns, &mut common);
        for beam in 0..beams {
            put::<I, LANES>(&formula.directions(beam, &mut common), beam, beams, places);
        }
    }
    formula.is_whole(&common)
}

/// Writes the vectors of a beam in up to N columns to its places among those of all beams. N is a multiple of
/// eight.
#[inline(always)]
fn put<I: Isa, const N: usize>(vectors: &[[f64; N]; 3], beam: usize, beams: usize, places: &mut [Point]) {
    if beams == 1
        && let Ok(places) = <&mut [Point; N]>::try_from(&mut *places)
    {
        return interleave::<I, N>(vectors, places);
    }
    let mut points = [[0.0; 3]; N];
    interleave::<I, N>(vectors, &mut points);
    for (place, point) in places[beam..].iter_mut().step_by(beams).zip(points) {
        *place = point;
    }
}

#[inline(always)]
fn interleave<I: Isa, const N: usize>([x, y, z]: &[[f64; N]; 3], places: &mut [Point; N]) {
    let (x, y, z) = (x.as_chunks::<8>().0, y.as_chunks::<8>().0, z.as_chunks::<8>().0);
    for (i, places) in places.as_flattened_mut().as_chunks_mut().0.iter_mut().enumerate() {
        store_points::<I>([I::F64x8::load(&x[i]), I::F64x8::load(&y[i]), I::F64x8::load(&z[i])], places);
    }
}

/// Normalizes v to within 4u, for |v| within 2⁻²⁷ of 1: a step of Newton's iteration for 1/√|v|².
///
/// With e = |v|² − 1 the length becomes (1+e)^½ (1 − e/2) = 1 − 3e²/8 + …, off by less than
/// 2⁻⁵⁴ = u/2. In
/// |v|² ≈ 1 the squares round by u in all, their first sum by u/2 and the second by u: half of that, 1.25u,
/// is in the factor, which rounds by u. The products with it round by u of each coordinate, u of the length.
#[inline(always)]
fn unit([x, y, z]: Point) -> Point {
    let factor = 1.5 - 0.5 * (x * x + y * y + z * z);
    [x * factor, y * factor, z * factor]
}

/// Sets the coordinates in one lane.
#[inline(always)]
fn set<const N: usize>(columns: &mut [[f64; N]; 3], lane: usize, [x, y, z]: Point) {
    (columns[0][lane], columns[1][lane], columns[2][lane]) = (x, y, z);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Level, dispatch};
    use crate::testing::{assert_slack, numbers, worst};

    const ROTATION: Rotation = Rotation { first: 0.37, step: 0.0123, angle: 1.0 };

    /// Each formula over some columns.
    fn for_each(test: impl Fn(&str, Formula, usize)) {
        let beams = [-0.2, 0.0, 0.1].map(|z: f64| [(1.0 - z * z).sqrt(), 0.0, z]);
        let prisms = [[0.0, 0.31], [0.2, 0.0], [0.0, 0.0]].map(|tilts| Prism { tilts, rotation: ROTATION });
        let angles: Vec<f64> = (0..101).map(|i| f64::from(i) * 0.06 - 3.0).collect();
        let runs = [(40, 0.0, 0.0, 0.25), (0, 0.0, 0.0, 0.0), (61, 50.0, 3.0, 0.5)];
        let runs = runs.map(|(columns, cycle, since, late)| Run { columns, cycle, since, late });
        let many: Vec<Point> =
            (0..37).map(|i| [0.6, 0.0, 0.8].map(|x: f64| x + f64::from(i) * 1e-17)).collect();
        for (beams, origins) in [(&beams[..], &beams[..]), (&beams[..1], &[]), (&many, &many)] {
            let times: Vec<f64> = (0..beams.len()).map(|i| i as f64 * 1e-6).collect();
            let cycles = Cycles::new(beams, origins, &times, &runs, [1e4, 0.25], [3.0, -60.0]);
            test("cycles", Formula::Cycles(&cycles), cycles.columns());
        }
        test("Mid-360", Formula::Mid360(&Mid360::new(ROTATION, 4950)), 101);
        test("mirror", Formula::OscillatingMirror(&OscillatingMirror::new(1.3, 0.3, ROTATION)), 101);
        test("Palmer", Formula::Palmer(&Palmer::new(0.4, ROTATION)), 101);
        let elevations: Vec<f64> = angles.iter().map(|angle| 0.5 * angle).collect();
        test("polar", Formula::Polar(&Polar { azimuths: &angles, elevations: &elevations }), 101);
        test("Risley", Formula::Risley(&Risley::new(&beams, &prisms, 1.5)), 101);
    }

    /// The arrays of columns from `first` on.
    fn fired(formula: Formula, first: usize, columns: usize, level: Level) -> [Vec<f64>; 3] {
        let turning = matches!(formula, Formula::Cycles(cycles) if cycles.has_origins());
        let timed = matches!(formula, Formula::Cycles(_));
        let pulses = columns * formula.beams();
        let mut directions = vec![[f64::NAN; 3]; pulses];
        let mut origins = vec![[f64::NAN; 3]; if turning { pulses } else { 0 }];
        let mut times = vec![f64::NAN; if timed { pulses } else { 0 }];
        let arrays = Arrays { directions: &mut directions, origins: &mut origins, times: &mut times };
        assert!(dispatch(level, Piece { formula, first, arrays }));
        [directions.into_flattened(), origins.into_flattened(), times]
    }

    #[test]
    fn pulses_depend_neither_on_the_instruction_set_nor_on_the_pieces() {
        for_each(|name, formula, columns| {
            let whole = fired(formula, 0, columns, Level::Scalar);
            for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                assert_eq!(fired(formula, 0, columns, level), whole, "{name}, {level:?}");
                let pieces = [(0, 1), (1, 31), (32, 40), (72, 29)];
                let parts = pieces.map(|(first, count)| fired(formula, first, count, level));
                for array in 0..3 {
                    let joined: Vec<f64> = parts.iter().flat_map(|part| part[array].clone()).collect();
                    assert_eq!(joined, whole[array], "{name}, {level:?}, array {array}");
                }
            }
            assert!(whole.iter().flatten().all(|x| x.is_finite()), "{name}");
        });
    }

    #[test]
    fn frames_are_shared_among_threads_whole() {
        let beams: Vec<Point> = (0..100).map(|_| [1.0, 0.0, 0.0]).collect();
        let run = Run { columns: 400, cycle: 0.0, since: 0.0, late: 0.0 };
        let cycles = Cycles::new(&beams, &[], &[0.0; 100], &[run], [1e4, 0.0], [3.0, -60.0]);
        let (mut directions, mut times) = (vec![[f64::NAN; 3]; 40_000], vec![f64::NAN; 40_000]);
        let arrays = Arrays { directions: &mut directions, times: &mut times, ..Arrays::default() };
        let formula = Formula::Cycles(&cycles);
        assert!(fire(formula, arrays, |piece| dispatch(Level::Scalar, piece)));
        let [expected, _, expected_times] = fired(formula, 0, 400, Level::Scalar);
        assert_eq!(directions.as_flattened(), expected);
        assert_eq!(times, expected_times);
    }

    /// |v|² − 1, exactly but for roundings of the squares of u.
    fn excess(v: Point) -> f64 {
        let squares = v.map(|x| (x * x, x.mul_add(x, -(x * x))));
        let mut sum = (-1.0, 0.0);
        for (high, low) in squares {
            let both = sum.0 + high;
            let part = both - sum.0;
            sum = (both, sum.1 + ((sum.0 - (both - part)) + (high - part)) + low);
        }
        sum.0 + sum.1
    }

    #[test]
    fn vectors_get_unit_length_to_what_is_derived() {
        const BOUND: f64 = 4.0 * f64::EPSILON / 2.0;
        let off = |[a, b, c]: &[f64; 3], from: fn(Point) -> Point, least: f64| {
            let v = [*a - 0.5, *b - 0.5, *c - 0.5];
            let length = excess(v) + 1.0;
            if !(length > 1e-3) {
                return 0.0;
            }
            // Away from unit length by as much as the doc allows.
            let near = v.map(|x| x / length.sqrt() * (1.0 + least * (a * 1e4).fract()));
            (excess(from(near)) / 2.0).abs() / BOUND
        };
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        let (found, at) = worst(20, 4000, draw, |v: &[f64; 3]| off(v, unit, 2.0_f64.powi(-27)));
        assert_slack(&format!("unit {at:?}"), found, 0.6);
        let (found, at) = worst(20, 4000, draw, |v: &[f64; 3]| off(v, risley::normalized, 2.0_f64.powi(-19)));
        assert_slack(&format!("normalized {at:?}"), found, 0.6);
    }

    #[test]
    fn whole_turns_change_nothing() {
        let mut number = numbers();
        for _ in 0..100 {
            let first = (number() * 1024.0).floor() / 1024.0;
            let ticks = std::array::from_fn(|lane| lane as f64);
            let few = Rotation { first, step: 0.0, angle: 0.7 }.sin_cos(&ticks);
            let many = Rotation { first, step: 2.0_f64.powi(36), angle: 0.7 }.sin_cos(&ticks);
            assert_eq!(few, many);
        }
    }

    #[test]
    fn total_reflection_is_found_behind_any_face() {
        let still = Rotation { first: 0.0, step: 0.0, angle: 0.0 };
        let through = |tilts: &[[f64; 2]], beams: &[Point]| {
            let prisms: Vec<Prism> = tilts.iter().map(|&tilts| Prism { tilts, rotation: still }).collect();
            let risley = Risley::new(beams, &prisms, 1.5);
            let mut directions = vec![[0.0; 3]; beams.len() * 3];
            let arrays = Arrays { directions: &mut directions, ..Arrays::default() };
            fire(Formula::Risley(&risley), arrays, |piece| dispatch(Level::Scalar, piece))
        };
        let (straight, steep) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        // Glass of index 1.5 reflects totally from 0.7297 rad on.
        assert!(through(&[[0.0, 0.72]], &[straight]));
        assert!(!through(&[[0.0, 0.74]], &[straight]));
        // What follows, a face or another beam, does not hide it.
        assert!(!through(&[[0.0, 0.74], [0.0, 0.1]], &[straight]));
        assert!(!through(&[[0.0, 0.1]], &[straight, steep, straight]));
        assert!(!through(&[[0.1, 0.0]], &[[-0.6, 0.8, 0.0]]));
    }
}
