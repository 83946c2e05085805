//! Scan patterns: where the pulses of a frame go, and when.
//!
//! Pulses that fire together, or in one cycle, are a column; the columns of a frame start at ticks of a
//! steady clock. A formula is a loop over the columns, or channels, of a few registers, which the compiler
//! vectorizes. Each operation is rounded once, and what columns have in common is computed for blocks counted
//! from the start of the frame. So the bits of a pulse depend neither on the instruction set nor on the
//! pieces and threads that its frame is divided among.

mod cycles;
mod mid360;
mod oscillating_mirror;
mod palmer;
mod polar;
mod risley;
mod rotation;

use std::sync::atomic::{AtomicBool, Ordering};

pub use cycles::{Channels, CycleRun, Cycles};
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
    Cycles(&'a Cycles<'a>),
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
            Formula::Cycles(cycles) => cycles.channels().count(),
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
pub struct ColumnPiece<'a> {
    formula: Formula<'a>,
    /// The number of the first of them.
    first: usize,
    arrays: Arrays<'a>,
}

/// Writes all pulses of a frame, on all threads. `work` runs a piece. False if a prism reflects a pulse
/// totally.
pub fn fire(formula: Formula, mut arrays: Arrays, work: impl Fn(ColumnPiece) -> bool + Sync) -> bool {
    let beams = formula.beams();
    let count = arrays.directions.len() / beams.max(1);
    let columns = (MOST / beams.max(1)).max(1).next_multiple_of(LANES);
    let mut pieces = memory::with_capacity(count.div_ceil(columns));
    for first in (0..count).step_by(columns) {
        let arrays = arrays.split_off(columns.min(count - first) * beams);
        memory::push(&mut pieces, ColumnPiece { formula, first, arrays });
    }
    let all = AtomicBool::new(true);
    parallel::share(pieces.into_iter(), |piece| {
        if !work(piece) {
            all.store(false, Ordering::Relaxed);
        }
    });
    all.into_inner()
}

impl Task for ColumnPiece<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self) -> bool {
        let ColumnPiece { formula, first, arrays } = self;
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
    /// Goes to a block of columns: block b begins with column `b·LANES` of the frame.
    fn go_to(&self, block: usize, common: &mut Self::Common);
    /// Writes the directions of a beam in the block, by axis: NaN if it does not leave the sensor. What is
    /// written for columns that the frame does not have is unspecified.
    fn directions(&self, beam: usize, common: &Self::Common, directions: &mut [Lanes; 3]);
}

/// Writes the directions of consecutive columns from `first` on.
#[inline(always)]
fn fire_together<I: Isa, T: Together>(formula: &T, first: usize, arrays: Arrays) -> bool {
    let beams = formula.beams();
    let (mut places, mut common) = (arrays.directions, formula.common());
    let (mut directions, mut all) = ([[0.0; LANES]; 3], true);
    // Blocks are those of the frame: a piece may begin or end within one.
    let (mut block, mut skipped) = (first / LANES, first % LANES);
    while !places.is_empty() {
        let count = (LANES - skipped).min(places.len() / beams);
        let some = split_off(&mut places, count * beams);
        formula.go_to(block, &mut common);
        for beam in 0..beams {
            formula.directions(beam, &common, &mut directions);
            for x in &directions[0][skipped..skipped + count] {
                all &= !x.is_nan();
            }
            put::<I, LANES>(&directions, skipped, beam, beams, some);
        }
        (block, skipped) = (block + 1, 0);
    }
    all
}

/// Writes the vectors of a beam in up to N columns, without the first ones, to its places among those of all
/// beams. N is a multiple of eight.
#[inline(always)]
fn put<I: Isa, const N: usize>(
    vectors: &[[f64; N]; 3],
    skipped: usize,
    beam: usize,
    beams: usize,
    places: &mut [Point],
) {
    if beams == 1
        && let Ok(places) = <&mut [Point; N]>::try_from(&mut *places)
    {
        return interleave::<I, N>(vectors, places);
    }
    let mut points = [[0.0; 3]; N];
    interleave::<I, N>(vectors, &mut points);
    for (places, point) in places.chunks_exact_mut(beams).zip(&points[skipped..]) {
        places[beam] = *point;
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
/// 2⁻⁵⁴ = u/2. In |v|² ≈ 1 the squares round by u in all, their first sum by u/2 and the second by
/// u: half of that, 1.25u, is in the factor, which rounds by u. The products with it round by u of each
/// coordinate, u of the length.
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
    use crate::testing::{assert_slack, worst};

    /// A rotation by turns.
    fn rotation(first: f64, step: f64, angle: f64) -> Rotation {
        let phase = |turns: f64| ((turns - turns.floor()) * 2.0_f64.powi(64)) as u128 * (1 << 64);
        Rotation::new(phase(first), phase(step), angle)
    }

    /// More than those of a group of anchors of a rotor.
    const COLUMNS: usize = LANES * LANES + 107;

    /// Each formula over so many columns.
    fn for_each(test: impl Fn(&str, Formula)) {
        let rotation = rotation(0.37, 0.0123, 1.0);
        let beams = [-0.2, 0.0, 0.1].map(|z: f64| [(1.0 - z * z).sqrt(), 0.0, z]);
        let prisms = [[0.0, 0.31], [0.2, 0.0], [0.0, 0.0]].map(|tilts| Prism { tilts, rotation });
        let angles: Vec<f64> = (0..COLUMNS).map(|i| i as f64 * 0.005 - 2.8).collect();
        let runs = [(40, 0.0, 0.0, 0.25), (0, 0.0, 0.0, 0.0), (COLUMNS - 40, 50.0, 3.0, 0.5)];
        let runs = runs.map(|(columns, cycle, since, late)| CycleRun { columns, cycle, since, late });
        let many: Vec<Point> =
            (0..37).map(|i| [0.6, 0.0, 0.8].map(|x: f64| x + f64::from(i) * 1e-17)).collect();
        for (beams, origins) in [(&beams[..], &beams[..]), (&beams[..1], &[]), (&many, &many)] {
            let times: Vec<f64> = (0..beams.len()).map(|i| i as f64 * 1e-6).collect();
            let channels = Channels::new(beams, origins, &times);
            let cycles = Cycles::new(&channels, &runs, [1e4, 0.25], [3.0, -60.0]);
            test("cycles", Formula::Cycles(&cycles));
        }
        test("Mid-360", Formula::Mid360(&Mid360::new(rotation, 4950)));
        test("mirror", Formula::OscillatingMirror(&OscillatingMirror::new(1.3, 0.3, rotation)));
        test("Palmer", Formula::Palmer(&Palmer::new(0.4, rotation)));
        let elevations: Vec<f64> = angles.iter().map(|angle| 0.5 * angle).collect();
        test("polar", Formula::Polar(&Polar { azimuths: &angles, elevations: &elevations }));
        test("Risley", Formula::Risley(&Risley::new(&beams, &prisms, 1.5)));
    }

    /// The arrays of columns from `first` on.
    fn arrays_from(formula: Formula, first: usize, columns: usize, level: Level) -> [Vec<f64>; 3] {
        let turning = matches!(formula, Formula::Cycles(cycles) if cycles.channels().has_origins());
        let timed = matches!(formula, Formula::Cycles(_));
        let pulses = columns * formula.beams();
        let mut directions = vec![[f64::NAN; 3]; pulses];
        let mut origins = vec![[f64::NAN; 3]; if turning { pulses } else { 0 }];
        let mut times = vec![f64::NAN; if timed { pulses } else { 0 }];
        let arrays = Arrays { directions: &mut directions, origins: &mut origins, times: &mut times };
        assert!(dispatch(level, ColumnPiece { formula, first, arrays }));
        [directions.into_flattened(), origins.into_flattened(), times]
    }

    #[test]
    fn pulses_depend_neither_on_the_instruction_set_nor_on_the_pieces() {
        for_each(|name, formula| {
            let whole = arrays_from(formula, 0, COLUMNS, Level::Scalar);
            for level in Level::available() {
                assert_eq!(arrays_from(formula, 0, COLUMNS, level), whole, "{name}, {level:?}");
                // Within a block and at its ends, and within the second group of blocks.
                let pieces = [(0, 1), (1, 31), (32, 40), (72, 1000), (1072, COLUMNS - 1072)];
                let parts = pieces.map(|(first, count)| arrays_from(formula, first, count, level));
                for array in 0..3 {
                    let joined: Vec<f64> = parts.iter().flat_map(|part| part[array].clone()).collect();
                    assert_eq!(joined, whole[array], "{name}, {level:?}, array {array}");
                }
            }
            assert!(whole.iter().flatten().all(|x| x.is_finite()), "{name}");
        });
    }

    /// Beyond the first block and group, too; to well within what a column more or less would change.
    #[test]
    fn directions_are_those_of_the_definitions() {
        let of = |azimuth: f64, elevation: f64| {
            let (sin, cos) = azimuth.sin_cos();
            [elevation.cos() * cos, elevation.cos() * sin, elevation.sin()]
        };
        let check = |what: &str, formula: Formula, expected: &dyn Fn(usize) -> Point| {
            let [directions, ..] = arrays_from(formula, 0, COLUMNS, Level::best());
            for (pulse, found) in directions.as_chunks::<3>().0.iter().enumerate() {
                let off = (0..3).map(|axis| (found[axis] - expected(pulse)[axis]).abs()).fold(0.0, f64::max);
                assert!(off <= 2.0_f64.powi(-40), "{what}, {pulse}: {found:?} for {:?}", expected(pulse));
            }
        };
        let angles: Vec<f64> = (0..COLUMNS).map(|i| i as f64 * 0.005 - 2.8).collect();
        let elevations: Vec<f64> = angles.iter().map(|angle| 0.5 * angle).collect();
        let polar = Polar { azimuths: &angles, elevations: &elevations };
        check("polar", Formula::Polar(&polar), &|i| of(angles[i], elevations[i]));

        let turns = |i: usize| 0.37 + 0.0123 * i as f64;
        let palmer = Palmer::new(0.4, rotation(0.37, 0.0123, 1.0));
        check("Palmer", Formula::Palmer(&palmer), &|i| {
            let (sin, cos) = (std::f64::consts::TAU * turns(i) + 1.0).sin_cos();
            [f64::cos(0.4), f64::sin(0.4) * cos, f64::sin(0.4) * sin]
        });

        // To and fro at constant speed, from the left.
        let mirror = OscillatingMirror::new(1.3, 0.0, rotation(0.37, 0.0123, 0.0));
        check("mirror", Formula::OscillatingMirror(&mirror), &|i| {
            of(1.3 * (2.0 * (turns(i).fract() - 0.5).abs() - 0.5), 0.0)
        });

        let beams = [of(0.2, 0.1), of(-0.3, -0.2)];
        // One starts with the frame, one with it but for a part of a cycle, and one at another time.
        let runs = [(40, 0.0, 0.0, 0.25), (60, 45.0, 45.0, 0.5), (COLUMNS - 100, 110.0, 3.0, 0.5)];
        let runs = runs.map(|(columns, cycle, since, late)| CycleRun { columns, cycle, since, late });
        // The cycles since the frame and since the run.
        let cycles_to = |pulse: usize| {
            let (mut column, mut run) = (pulse / 2, 0);
            while column >= runs[run].columns {
                column -= runs[run].columns;
                run += 1;
            }
            let CycleRun { cycle, since, late, .. } = runs[run];
            [cycle + column as f64 + 0.25, since + column as f64 + late]
        };
        let channels = Channels::new(&beams, &beams, &[0.0, 1e-6]);
        let cycles = Cycles::new(&channels, &runs, [1e4, 0.25], [3.0, -60.0]);
        check("cycles", Formula::Cycles(&cycles), &|i| {
            let (azimuth, elevation) = [(0.2, 0.1), (-0.3, -0.2)][i % 2];
            of(azimuth + 3.0 - 60.0 * cycles_to(i)[1] / 1e4, elevation)
        });
        let [directions, origins, times] = arrays_from(Formula::Cycles(&cycles), 0, COLUMNS, Level::best());
        for (pulse, time) in times.iter().enumerate() {
            let later = [0.0, 1e-6][pulse % 2];
            assert!((time - (cycles_to(pulse)[0] / 1e4 + later)).abs() <= f64::EPSILON, "{pulse}: {time}");
        }
        // These origins are unit vectors, turned as the beams are.
        for (direction, origin) in directions.iter().zip(origins) {
            assert!((direction - origin).abs() <= 4.0 * f64::EPSILON, "{direction} {origin}");
        }
    }

    #[test]
    fn a_frame_of_the_mid_360_goes_on_where_another_stops() {
        let frame = |from: usize| {
            let mid360 = Mid360::new(rotation(0.375 * from as f64, 0.375, 0.0), 4900 + from);
            arrays_from(Formula::Mid360(&mid360), 0, COLUMNS, Level::best())[0].clone()
        };
        let (whole, numbers) = (frame(0), 3 * mid360::BEAMS);
        for from in [1, 32, 100, 1024] {
            let overlap = (COLUMNS - from) * numbers;
            for (later, number) in frame(from)[..overlap].iter().zip(&whole[from * numbers..]) {
                assert!((later - number).abs() <= 8.0 * f64::EPSILON, "from {from}: {later} for {number}");
            }
        }
    }

    #[test]
    fn frames_are_shared_among_threads_whole() {
        let beams: Vec<Point> = (0..100).map(|_| [1.0, 0.0, 0.0]).collect();
        let run = CycleRun { columns: 400, cycle: 0.0, since: 0.0, late: 0.0 };
        let channels = Channels::new(&beams, &[], &[0.0; 100]);
        let cycles = Cycles::new(&channels, &[run], [1e4, 0.0], [3.0, -60.0]);
        let (mut directions, mut times) = (vec![[f64::NAN; 3]; 40_000], vec![f64::NAN; 40_000]);
        let arrays = Arrays { directions: &mut directions, times: &mut times, ..Arrays::default() };
        let formula = Formula::Cycles(&cycles);
        assert!(fire(formula, arrays, |piece| dispatch(Level::Scalar, piece)));
        let [expected, _, expected_times] = arrays_from(formula, 0, 400, Level::Scalar);
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
        let off = |[a, b, c]: &[f64; 3]| {
            let v = [*a - 0.5, *b - 0.5, *c - 0.5];
            let length = excess(v) + 1.0;
            if !(length > 1e-3) {
                return 0.0;
            }
            // Away from unit length by as much as the doc allows.
            let near = v.map(|x| x / length.sqrt() * (1.0 + 2.0_f64.powi(-27) * (a * 1e4).fract()));
            (excess(unit(near)) / 2.0).abs() / BOUND
        };
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        let (found, at) = worst(20, 4000, draw, off);
        assert_slack(&format!("unit {at:?}"), found, 0.6);
    }

    #[test]
    fn total_reflection_is_found_behind_any_face() {
        let still = rotation(0.0, 0.0, 0.0);
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
        // Light that does not come from before a face, be this the first or another.
        assert!(!through(&[[0.1, 0.0]], &[[-0.6, 0.8, 0.0]]));
        assert!(!through(&[[0.0, 0.1]], &[[-0.6, 0.8, 0.0]]));
    }

    /// The second face reflects totally only while both prisms deviate the beam to the same side.
    #[test]
    fn total_reflection_counts_only_in_the_columns_of_the_piece() {
        let turning = Prism { tilts: [0.6, 0.0], rotation: rotation(0.5, 0.0123, 0.0) };
        let still = Prism { tilts: [0.0, -0.6], rotation: rotation(0.0, 0.0, 0.0) };
        let risley = Risley::new(&[[1.0, 0.0, 0.0]], &[turning, still], 1.5);
        let through = |first: usize, count: usize| {
            let mut directions = vec![[0.0; 3]; count];
            let arrays = Arrays { directions: &mut directions, ..Arrays::default() };
            dispatch(Level::best(), ColumnPiece { formula: Formula::Risley(&risley), first, arrays })
        };
        let each: Vec<bool> = (0..COLUMNS).map(|column| through(column, 1)).collect();
        for edge in 1..COLUMNS {
            if each[edge - 1] != each[edge] {
                let same = each[..edge].iter().rev().take_while(|is| **is == each[edge - 1]).count();
                assert_eq!(through(edge - same, same), each[edge - 1], "before {edge}");
                assert!(!through(edge - 1, 2), "across {edge}");
            }
        }
        let edges: Vec<usize> = (1..COLUMNS).filter(|&edge| each[edge - 1] != each[edge]).collect();
        assert!(edges.len() > 20 && edges.iter().any(|edge| edge % LANES > 8), "{edges:?}");
    }
}
