//! Beams that rotating prisms refract.

use super::{LANES, Lanes, Rotation, Together, set};
use crate::arith::elementary::sin_cos;
use crate::geometry::vector::Point;
use crate::memory;

/// A wedge that rotates about x: tilts of the faces where the light enters and leaves, rad.
#[derive(Clone, Copy, Debug)]
pub struct Prism {
    pub tilts: [f64; 2],
    pub rotation: Rotation,
}

/// Beams, unit vectors, through a sequence of prisms.
pub struct Risley {
    /// Behind the faces before the first that is tilted, which refract a beam the same way at all times.
    beams: Vec<Point>,
    prisms: Vec<Wedge>,
    /// As of `Faces`, at those first faces.
    least: [Lanes; 2],
}

struct Wedge {
    rotation: Rotation,
    faces: [Face; 2],
}

struct Face {
    /// The ratio of the refractive indices before and behind it.
    ratio: f64,
    /// Sine and cosine of the tilt; `None` if the face is perpendicular to x.
    tilt: Option<(f64, f64)>,
    /// Whether the beams of `Risley` are behind it.
    is_passed: bool,
}

/// What the beams of some columns have in common.
pub struct Faces {
    /// The unit normals of both faces of each prism.
    normals: Vec<[[Lanes; 3]; 2]>,
    /// The least, of all columns so far, of what is negative where reflection is total, and of the cosine of
    /// the angle of incidence.
    least: [Lanes; 2],
}

impl Risley {
    /// The refractive index is that of the prisms, in air.
    pub fn new(beams: &[Point], prisms: &[Prism], refractive_index: f64) -> Self {
        let mut made = Risley {
            beams: memory::copy(beams),
            prisms: memory::with_capacity(prisms.len()),
            least: [[1.0; LANES]; 2],
        };
        let mut is_first = true;
        for Prism { tilts: [entry, exit], rotation } in prisms {
            let faces = [(*entry, 1.0 / refractive_index), (*exit, refractive_index)].map(|(tilt, ratio)| {
                is_first &= tilt == 0.0;
                if is_first {
                    made.pass(ratio);
                }
                Face { ratio, tilt: (tilt != 0.0).then(|| sin_cos(tilt)), is_passed: is_first }
            });
            made.prisms.push(Wedge { rotation: *rotation, faces });
        }
        made
    }

    /// Lets the beams through a face perpendicular to x.
    fn pass(&mut self, ratio: f64) {
        for beam in &mut self.beams {
            let mut lanes = beam.map(|x| [x; LANES]);
            refract_flat(&mut lanes, ratio, &mut self.least);
            *beam = lanes.map(|lanes| lanes[0]);
        }
    }
}

impl Together for Risley {
    type Common = Faces;

    #[inline(always)]
    fn beams(&self) -> usize {
        self.beams.len()
    }

    #[inline(always)]
    fn common(&self) -> Faces {
        let mut normals = Vec::new();
        memory::resize(&mut normals, self.prisms.len(), [[[0.0; LANES]; 3]; 2]);
        Faces { normals, least: self.least }
    }

    #[inline(always)]
    fn go_to(&self, columns: &Lanes, common: &mut Faces) {
        for (wedge, normals) in self.prisms.iter().zip(&mut common.normals) {
            if !wedge.faces.iter().any(|face| face.tilt.is_some()) {
                continue;
            }
            let [sin, cos] = wedge.rotation.sin_cos(columns);
            for (face, normals) in wedge.faces.iter().zip(normals) {
                if let Some((across, along)) = face.tilt {
                    for lane in 0..LANES {
                        set(normals, lane, [along, across * cos[lane], across * sin[lane]]);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn directions(&self, beam: usize, common: &mut Faces) -> [Lanes; 3] {
        let (mut directions, mut least) = ([[0.0; LANES]; 3], common.least);
        for lane in 0..LANES {
            set(&mut directions, lane, self.beams[beam]);
        }
        for (wedge, normals) in self.prisms.iter().zip(&common.normals) {
            for (face, normals) in wedge.faces.iter().zip(normals) {
                if face.tilt.is_some() {
                    refract(&mut directions, normals, face.ratio, &mut least);
                } else if !face.is_passed {
                    refract_flat(&mut directions, face.ratio, &mut least);
                }
            }
            for lane in 0..LANES {
                let [x, y, z] = &directions;
                let direction = normalized([x[lane], y[lane], z[lane]]);
                set(&mut directions, lane, direction);
            }
        }
        common.least = least;
        directions
    }

    #[inline(always)]
    fn is_whole(&self, Faces { least: [squares, cosines], .. }: &Faces) -> bool {
        squares.iter().all(|square| *square >= 0.0) && cosines.iter().all(|cosine| *cosine > 0.0)
    }
}

/// Refracts unit vectors d at a face with unit normals N, r being the ratio of the indices before and behind
/// it. By Snell's law in vector form d leaves along r d + (√s − r d·N) N, with s = 1 − r² (1 −
/// (d·N)²).
#[inline(always)]
fn refract(directions: &mut [Lanes; 3], normals: &[Lanes; 3], ratio: f64, least: &mut [Lanes; 2]) {
    for lane in 0..LANES {
        let [x, y, z] = [directions[0][lane], directions[1][lane], directions[2][lane]];
        let [nx, ny, nz] = [normals[0][lane], normals[1][lane], normals[2][lane]];
        let along = x * nx + y * ny + z * nz;
        let turn = turn(along, ratio, lane, least);
        let refracted = [ratio * x + turn * nx, ratio * y + turn * ny, ratio * z + turn * nz];
        set(directions, lane, refracted);
    }
}

/// As `refract`, with the normals along x.
#[inline(always)]
fn refract_flat(directions: &mut [Lanes; 3], ratio: f64, least: &mut [Lanes; 2]) {
    for lane in 0..LANES {
        let [x, y, z] = [directions[0][lane], directions[1][lane], directions[2][lane]];
        let turn = turn(x, ratio, lane, least);
        set(directions, lane, [ratio * x + turn, ratio * y, ratio * z]);
    }
}

/// √s − r d·N. Keeps the least s, negative if reflection is total, and the least d·N.
#[inline(always)]
fn turn(along: f64, ratio: f64, lane: usize, [squares, cosines]: &mut [Lanes; 2]) -> f64 {
    let square = 1.0 - ratio * ratio * (1.0 - along * along);
    // What is NaN, behind a total reflection, changes neither.
    squares[lane] = if square < squares[lane] { square } else { squares[lane] };
    cosines[lane] = if along < cosines[lane] { along } else { cosines[lane] };
    square.sqrt() - ratio * along
}

/// Normalizes v to within 4u, for |v| within 2⁻¹⁹ of 1, as refraction near total reflection leaves it:
/// there √s is off by up to √(8u).
///
/// As `unit`, with the next term: 1 − e/2 + 3e²/8 leaves 5|e|³/16 < 2⁻⁵⁵ = u/4. e is exact, from
/// |v|² off by
/// 2.5u; what it is multiplied with rounds far less, and the factor rounds by u.
#[inline(always)]
pub(super) fn normalized([x, y, z]: Point) -> Point {
    let e = x * x + y * y + z * z - 1.0;
    let factor = 1.0 - e * (0.5 - 0.375 * e);
    [x * factor, y * factor, z * factor]
}
