//! The four beams of the Livox Mid-360.

use super::rotation::{Anchors, Rotation, Rotor};
use super::{LANES, Lanes, Together, set, unit};
use crate::arith::elementary::sin_cos;
use crate::memory;
use crate::once::Once;

pub(super) const BEAMS: usize = 4;

/// The numbers k of the beams.
const NUMBERS: [f64; BEAMS] = [-1.5, -0.5, 0.5, 1.5];

/// Ticks of the slow phase φ, of ten turns a second at 50,000 ticks a second, to a turn.
const SLOW_TURN: usize = 5000;

/// The beams in a frame: w, turned by −ψ about z, where w is the sum of kᵖ (C cos(aψ + bφ) + S
/// sin(aψ + bφ)) over the rows of a table.
pub struct Mid360 {
    /// ψ.
    fast: Rotor,
    /// The tick of the first column, modulo `SLOW_TURN`.
    slow: usize,
}

impl Mid360 {
    /// `tick` is that of the first column, less any number of turns of φ.
    pub fn new(fast: Rotation, tick: usize) -> Self {
        Mid360 { fast: Rotor::new(fast), slow: tick % SLOW_TURN }
    }
}

/// Numbers for each tick of a slow turn. The first follow the last again, for lanes across the end.
type Slow = Vec<f64>;

/// The sums of (C − iS) exp(ibφ) over b, for each φ.
struct Sums {
    /// By axis: the real part for p = a = 0, and that for p = 2, a = 0.
    still: [[Slow; 3]; 2],
    /// By axis: real and imaginary part for p = a = 1, and those for p = a = 2.
    turning: [[[Slow; 2]; 3]; 2],
}

static SUMS: Once<Sums> = Once::new();

impl Sums {
    fn new() -> Sums {
        // Angles of at most half a turn round less than those up to a whole one.
        let turns = |j: usize| if 2 * j > SLOW_TURN { j as f64 - SLOW_TURN as f64 } else { j as f64 };
        let circle = (0..SLOW_TURN).map(|j| sin_cos(std::f64::consts::TAU * turns(j) / SLOW_TURN as f64));
        let circle = memory::collect(circle);
        let (mut still, mut turning): ([[Slow; 3]; 2], [[[Slow; 2]; 3]; 2]) = Default::default();
        for sums in still.as_flattened_mut().iter_mut().chain(turning.as_flattened_mut().as_flattened_mut()) {
            memory::resize(sums, SLOW_TURN + LANES, 0.0);
        }
        for ([p, a], b, c, s) in ROWS {
            for axis in 0..3 {
                let (c, s) = (c[axis] * 1e-7, s[axis] * 1e-7);
                for j in 0..SLOW_TURN + LANES {
                    let (sin, cos) = circle[b.rem_euclid(SLOW_TURN as i64) as usize * j % SLOW_TURN];
                    let (real, imaginary) = (c * cos + s * sin, c * sin - s * cos);
                    if a == 0 {
                        still[p / 2][axis][j] += real;
                    } else {
                        turning[p - 1][axis][0][j] += real;
                        turning[p - 1][axis][1][j] += imaginary;
                    }
                }
            }
        }
        Sums { still, turning }
    }
}

/// What the beams of some ticks have in common.
pub struct Common {
    sums: &'static Sums,
    anchors: Anchors,
    /// Sine and cosine of ψ.
    fast: [Lanes; 2],
    /// By p and axis, what kᵖ multiplies.
    powers: [[Lanes; 3]; 3],
}

impl Together for Mid360 {
    type Common = Common;

    #[inline(always)]
    fn beams(&self) -> usize {
        BEAMS
    }

    #[inline(always)]
    fn common(&self) -> Common {
        let (sums, empty) = (SUMS.get_or_make(Sums::new), [0.0; LANES]);
        Common { sums, anchors: Anchors::NONE, fast: [empty; 2], powers: [[empty; 3]; 3] }
    }

    #[inline(always)]
    fn go_to(&self, block: usize, Common { sums, anchors, fast, powers }: &mut Common) {
        let first = (self.slow + block * LANES) % SLOW_TURN;
        *fast = self.fast.sin_cos(block, anchors);
        let [sin, cos] = &*fast;
        let Sums { still, turning } = *sums;
        for axis in 0..3 {
            let [zeroth, square] = [at(&still[0][axis], first), at(&still[1][axis], first)];
            let [once, once_i] = [at(&turning[0][axis][0], first), at(&turning[0][axis][1], first)];
            let [twice, twice_i] = [at(&turning[1][axis][0], first), at(&turning[1][axis][1], first)];
            powers[0][axis] = *zeroth;
            for lane in 0..LANES {
                let (sin, cos) = (sin[lane], cos[lane]);
                powers[1][axis][lane] = once[lane] * cos - once_i[lane] * sin;
                // exp(2iψ) = exp(iψ)².
                let (sin, cos) = (2.0 * (sin * cos), cos * cos - sin * sin);
                powers[2][axis][lane] = twice[lane] * cos - twice_i[lane] * sin + square[lane];
            }
        }
    }

    #[inline(always)]
    fn directions(&self, beam: usize, common: &Common, w: &mut [Lanes; 3]) {
        let Common { fast: [sin, cos], powers, .. } = common;
        let k = NUMBERS[beam];
        for axis in 0..3 {
            let [zeroth, first, second] = [&powers[0][axis], &powers[1][axis], &powers[2][axis]];
            for lane in 0..LANES {
                w[axis][lane] = zeroth[lane] + first[lane] * k + second[lane] * (k * k);
            }
        }
        for lane in 0..LANES {
            let ([x, y, z], sin, cos) = ([w[0][lane], w[1][lane], w[2][lane]], sin[lane], cos[lane]);
            let factor = 1.0 / (x * x + y * y + z * z).sqrt();
            let (x, y, z) = (x * factor, y * factor, z * factor);
            set(w, lane, unit([cos * x + sin * y, cos * y - sin * x, z]));
        }
    }
}

/// The numbers for some ticks from this one on.
#[inline(always)]
fn at(numbers: &[f64], first: usize) -> &Lanes {
    &numbers[first..first + LANES].as_chunks().0[0]
}

/// p and a, b, and by axis C and S, both in 1e-7.
type Row = ([usize; 2], i64, [f64; 3], [f64; 3]);

#[rustfmt::skip]
const ROWS: [Row; 42] = [
    ([0, 0], 0, [-96514.0, -8420251.0, 3341810.0], [0.0, 0.0, 0.0]),
    ([0, 0], 1, [-20548.0, 1489137.0, 3736204.0], [4410844.0, -33100.0, 43890.0]),
    ([0, 0], 2, [716.0, 62437.0, 6.0], [13.0, 1214.0, 2.0]),
    ([0, 0], 3, [-1340.0, 131569.0, 315265.0], [296963.0, -2227.0, 2519.0]),
    ([0, 0], 4, [113.0, 10012.0, 1.0], [3.0, 200.0, 0.0]),
    ([0, 0], 5, [-13.0, 5944.0, 11130.0], [11878.0, -56.0, 90.0]),
    ([0, 0], 6, [11.0, 955.0, -1.0], [2.0, 22.0, 1.0]),
    ([0, 0], 7, [0.0, 313.0, 291.0], [284.0, 2.0, 1.0]),
    ([0, 0], 8, [2.0, 77.0, 0.0], [0.0, 0.0, -1.0]),
    ([0, 0], 9, [1.0, 23.0, 5.0], [7.0, -3.0, -2.0]),
    ([0, 0], 10, [2.0, 7.0, 2.0], [-1.0, -1.0, 1.0]),
    ([1, 1], -8, [-2.0, -49.0, -27.0], [26.0, 2.0, 1.0]),
    ([1, 1], -7, [-2.0, -140.0, 2.0], [6.0, 4.0, -2.0]),
    ([1, 1], -6, [7.0, -553.0, -517.0], [525.0, 13.0, 14.0]),
    ([1, 1], -5, [-16.0, -1392.0, 35.0], [1.0, 46.0, -1.0]),
    ([1, 1], -4, [148.0, -5475.0, -6857.0], [6962.0, 96.0, 208.0]),
    ([1, 1], -3, [-192.0, -16714.0, 950.0], [4.0, 409.0, -21.0]),
    ([1, 1], -2, [1073.0, -32491.0, -45187.0], [45895.0, 494.0, 1424.0]),
    ([1, 1], -1, [-1994.0, -173763.0, 12653.0], [45.0, 3735.0, -271.0]),
    ([1, 1], 0, [-5038.0, -125420.0, -282883.0], [-301133.0, 4792.0, 3096.0]),
    ([1, 1], 1, [22.0, 1839.0, -952.0], [-3.0, -278.0, 19.0]),
    ([1, 1], 2, [-7.0, -2037.0, -517.0], [524.0, -10.0, 16.0]),
    ([1, 1], 3, [-19.0, -1603.0, 34.0], [1.0, 7.0, -1.0]),
    ([1, 1], 4, [-4.0, -281.0, 27.0], [-25.0, -5.0, -2.0]),
    ([1, 1], 5, [-2.0, -88.0, -1.0], [2.0, -4.0, 0.0]),
    ([1, 1], 6, [1.0, -34.0, 0.0], [1.0, -3.0, -1.0]),
    ([1, 1], 7, [0.0, -9.0, 1.0], [-2.0, -1.0, -2.0]),
    ([1, 1], 8, [0.0, -1.0, 3.0], [1.0, 1.0, 2.0]),
    ([2, 2], -4, [8.0, 733.0, -30.0], [1.0, -35.0, 0.0]),
    ([2, 2], -3, [-25.0, 1094.0, 820.0], [-712.0, -48.0, -43.0]),
    ([2, 2], -2, [44.0, 3680.0, -193.0], [-3.0, -156.0, 9.0]),
    ([2, 2], -1, [53.0, 1654.0, 618.0], [984.0, -61.0, -16.0]),
    ([2, 2], 0, [5.0, 203.0, 29.0], [1.0, 7.0, -3.0]),
    ([2, 2], 1, [-3.0, 74.0, -40.0], [-82.0, 4.0, 1.0]),
    ([2, 2], 2, [1.0, 83.0, -4.0], [-2.0, 0.0, 2.0]),
    ([2, 2], 3, [1.0, 26.0, -2.0], [6.0, 1.0, 0.0]),
    ([2, 2], 4, [2.0, 6.0, 3.0], [1.0, 2.0, 1.0]),
    ([2, 0], 0, [92.0, 8002.0, -509.0], [0.0, 0.0, 0.0]),
    ([2, 0], 1, [17.0, 3655.0, 2348.0], [2768.0, 11.0, 29.0]),
    ([2, 0], 2, [10.0, 843.0, -2.0], [1.0, 18.0, 0.0]),
    ([2, 0], 3, [3.0, 488.0, 199.0], [186.0, 9.0, 2.0]),
    ([2, 0], 4, [0.0, 165.0, 0.0], [0.0, 7.0, 1.0]),
];
