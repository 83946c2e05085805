//! Beams that rotating prisms refract.

use super::rotation::{Anchors, Rotation, Rotor};
use super::{LANES, Lanes, Together, set, unit};
use crate::arith::elementary::sin_cos;
use crate::geometry::vector::Point;
use crate::memory;

/// A wedge that rotates about x: tilts of the faces where the light enters and leaves, rad.
#[derive(Clone, Copy, Debug)]
pub struct Prism {
    pub tilts: [f64; 2],
    pub rotation: Rotation,
}

/// Beams through a sequence of prisms.
///
/// A beam is a vector p along it whose length is the refractive index. By Snell's law a face with the unit
/// normal N leaves alone what is perpendicular to N, so that p·N becomes √((p·N)² + m² − n²) with
/// the indices n before and m behind it.
///
/// |p|² − m² stays what it was, but for roundings: normals are off by up to 20u in |N|², and the
/// products and sums, each below 2m, come to less than 44m²u. With m ≤ 10 the length is therefore within
/// 2⁻²⁷ of 1 behind 10,000 prisms, as `unit` needs.
pub struct Risley {
    /// Behind the faces before the first that is tilted, which refract a beam the same way at all times.
    beams: Vec<Point>,
    rotors: Vec<Rotor>,
    /// The others.
    faces: Vec<Face>,
}

/// A face with the unit normal (cos a, sin a cos h, sin a sin h), with a its tilt and h the angle of a rotor.
struct Face {
    rotor: usize,
    /// Sine and cosine of a.
    tilt: (f64, f64),
    /// m² and m² − n².
    index: f64,
    step: f64,
}

/// What the beams of some columns have in common, by rotor.
pub struct Turned {
    anchors: Vec<Anchors>,
    /// Sines and cosines of h.
    turned: Vec<[Lanes; 2]>,
}

impl Risley {
    /// The beams are unit vectors. The refractive index is that of the prisms, in air.
    pub fn new(beams: &[Point], prisms: &[Prism], refractive_index: f64) -> Self {
        let glass = refractive_index * refractive_index;
        let mut beams = memory::copy(beams);
        let mut faces = memory::with_capacity(2 * prisms.len());
        for (rotor, prism) in prisms.iter().enumerate() {
            let sides = [(glass, glass - 1.0), (1.0, 1.0 - glass)];
            for (tilt, (index, step)) in prism.tilts.into_iter().zip(sides) {
                if tilt == 0.0 && faces.is_empty() {
                    for beam in &mut beams {
                        beam[0] = behind_flat(*beam, index);
                    }
                } else {
                    faces.push(Face { rotor, tilt: sin_cos(tilt), index, step });
                }
            }
        }
        let rotors = memory::collect(prisms.iter().map(|prism| Rotor::new(prism.rotation)));
        Risley { beams, rotors, faces }
    }
}

impl Together for Risley {
    type Common = Turned;

    #[inline(always)]
    fn beams(&self) -> usize {
        self.beams.len()
    }

    #[inline(always)]
    fn common(&self) -> Turned {
        let (mut anchors, mut turned) = (Vec::new(), Vec::new());
        memory::resize(&mut anchors, self.rotors.len(), Anchors::NONE);
        memory::resize(&mut turned, self.rotors.len(), [[0.0; LANES]; 2]);
        Turned { anchors, turned }
    }

    #[inline(always)]
    fn go_to(&self, block: usize, Turned { anchors, turned }: &mut Turned) {
        for rotor in 0..self.rotors.len() {
            turned[rotor] = self.rotors[rotor].sin_cos(block, &mut anchors[rotor]);
        }
    }

    #[inline(always)]
    fn directions(&self, beam: usize, Turned { turned, .. }: &Turned, directions: &mut [Lanes; 3]) {
        for lane in 0..LANES {
            set(directions, lane, self.beams[beam]);
        }
        for face in 0..self.faces.len() {
            let Face { rotor, tilt, index, step } = self.faces[face];
            if tilt == (0.0, 1.0) {
                for lane in 0..LANES {
                    let beam = [directions[0][lane], directions[1][lane], directions[2][lane]];
                    directions[0][lane] = behind_flat(beam, index);
                }
            } else {
                refract(directions, tilt, &turned[rotor], step);
            }
        }
        for lane in 0..LANES {
            let direction = [directions[0][lane], directions[1][lane], directions[2][lane]];
            set(directions, lane, unit(direction));
        }
    }
}

/// Refracts beams at a face.
#[inline(always)]
fn refract(beams: &mut [Lanes; 3], (across, along): (f64, f64), [sin, cos]: &[Lanes; 2], step: f64) {
    for lane in 0..LANES {
        let ([x, y, z], sin, cos) = ([beams[0][lane], beams[1][lane], beams[2][lane]], sin[lane], cos[lane]);
        let before = along * x + across * (cos * y + sin * z);
        let more = behind(before, before * before + step) - before;
        let more_across = across * more;
        set(beams, lane, [x + along * more, y + more_across * cos, z + more_across * sin]);
    }
}

/// p·x behind a face perpendicular to x: it follows from |p| = m, so errors of the length before do not
/// count.
#[inline(always)]
fn behind_flat([x, y, z]: Point, index: f64) -> f64 {
    behind(x, index - (y * y + z * z))
}

/// p·N behind a face, from that before it and its square behind; NaN if the face reflects the beam totally,
/// or if the beam does not come from before the face.
#[inline(always)]
fn behind(before: f64, square: f64) -> f64 {
    (if before > 0.0 { square } else { f64::NAN }).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::{Arrays, Formula, fire};
    use super::*;
    use crate::arith::simd::{Level, dispatch};

    const INDEX: f64 = 1.5;

    /// A beam along x behind a prism whose tilt is towards an angle about x.
    fn behind_prism(tilts: [f64; 2], angle: f64) -> Point {
        let risley =
            Risley::new(&[[1.0, 0.0, 0.0]], &[Prism { tilts, rotation: Rotation::new(0, 0, angle) }], INDEX);
        let mut directions = [[0.0; 3]];
        let arrays = Arrays { directions: &mut directions, ..Arrays::default() };
        assert!(fire(Formula::Risley(&risley), arrays, |piece| dispatch(Level::Scalar, piece)));
        directions[0]
    }

    #[test]
    fn faces_of_one_tilt_only_shift_a_beam() {
        for angle in [0.0, 1.0, 2.5, 4.0] {
            let [x, y, z] = behind_prism([0.3, 0.3], angle);
            let off = (x - 1.0).abs().max(y.abs()).max(z.abs());
            assert!(off <= 4.0 * f64::EPSILON, "{angle}: {x} {y} {z}");
        }
    }

    #[test]
    fn prisms_deviate_by_snells_law() {
        for (tilt, angle) in [(0.3_f64, 0.0_f64), (0.1, 1.0), (-0.5, 2.0), (0.2, -3.0), (0.4, 5.0)] {
            // Into glass light turns towards the normal, into air away from it.
            let inside = tilt - (f64::sin(tilt) / INDEX).asin();
            let entry: f64 = (INDEX * f64::sin(inside)).asin();
            let exit: f64 = tilt - (INDEX * f64::sin(tilt)).asin();
            for (tilts, deviation) in [([tilt, 0.0], entry), ([0.0, tilt], exit)] {
                let (sin, cos) = deviation.sin_cos();
                let expected = [cos, sin * angle.cos(), sin * angle.sin()];
                let found = behind_prism(tilts, angle);
                let off = (0..3).map(|axis| (found[axis] - expected[axis]).abs()).fold(0.0, f64::max);
                assert!(off <= 4.0 * f64::EPSILON, "{tilts:?} at {angle}: {found:?} for {expected:?}");
            }
        }
    }
}
