//! Beams that widen: their sub-rays, and the echoes these make.

use super::Rays;
use super::echo::{Echo, Light};
use crate::arith::elementary::{exp, sin_cos};
use crate::geometry::pose::dot;

/// A diverging beam as a few sub-rays.
#[derive(Clone, Debug)]
pub struct Beam {
    /// Of each sub-ray, its tangent of azimuth and elevation against the axis, and its share of the energy. The first is the axis.
    cells: Vec<([f64; 2], f64)>,
    /// Echoes closer than this are one, m.
    resolution: f64,
}

impl Beam {
    /// `divergence`: full angles at 1/e² of the axis' intensity, rad. The ellipse that they bound is divided into a disc and m
    /// rings about it, m·(m+1)·3 + 1 = `rays`, each as wide as the disc; ring k has 6k sub-rays. Each carries the energy that a
    /// Gaussian beam, of profile exp(−2r²/w²), has in its cell; what lies outside of the ellipse is spread over all.
    pub fn new(divergence: [f64; 2], rays: usize, resolution: f64) -> Self {
        let rings = (1..).take_while(|m| 3 * m * (m + 1) < rays).count();
        // In units of the half angle w.
        let width = 1.0 / (rings as f64 + 0.5);
        let inside = |radius: f64| 1.0 - exp(-2.0 * radius * radius);
        let mut cells = vec![([0.0; 2], inside(width / 2.0) / inside(1.0))];
        for k in 1..=rings {
            let radius = k as f64 * width;
            let energy = inside(radius + width / 2.0) - inside(radius - width / 2.0);
            for j in 0..6 * k {
                let (sin, cos) = sin_cos(std::f64::consts::TAU * j as f64 / (6 * k) as f64);
                let offset = [radius * cos * divergence[0] / 2.0, radius * sin * divergence[1] / 2.0];
                cells.push((offset, energy / inside(1.0) / (6 * k) as f64));
            }
        }
        Beam { cells, resolution }
    }

    /// The number of sub-rays.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// Offset of each sub-ray.
    pub(super) fn offsets(&self) -> impl Iterator<Item = [f64; 2]> {
        self.cells.iter().map(|(offset, _)| *offset)
    }

    /// Of each sub-ray of the pulse, the ray and its share of the energy.
    pub(super) fn sub_rays(&self, pulse: usize) -> impl Iterator<Item = (usize, f64)> {
        (pulse * self.cells.len()..).zip(&self.cells).map(|(ray, (_, share))| (ray, *share))
    }
}

impl Rays {
    /// The echoes of a pulse, by rising range.
    ///
    /// Two sub-rays are of one echo if their ranges differ by less than the resolution, or if each meets the tangent plane of
    /// the other's hit that close to its own hit: on a slanted plane the few sub-rays may lie further apart than that, where
    /// a real footprint has no gaps. An echo is all that hangs together so.
    pub(super) fn echoes(&self, beam: &Beam, mut lights: Vec<Light>, echoes: &mut Vec<Echo>) {
        echoes.clear();
        let close = |a: f64, b: f64| (a - b).abs() < beam.resolution;
        let (least, most) = lights.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), l| (a.min(l.range), b.max(l.range)));
        if close(least, most) {
            echoes.push(self.merge(&lights));
            return;
        }
        lights.sort_by(|a, b| a.range.total_cmp(&b.range).then(a.ray.cmp(&b.ray)));
        // group[i] is the nearest light of the echo that light i belongs to.
        let mut group: Vec<usize> = Vec::with_capacity(lights.len());
        for i in 0..lights.len() {
            group.push(if i > 0 && close(lights[i].range, lights[i - 1].range) { group[i - 1] } else { i });
        }
        if group.last().is_some_and(|&g| g > 0) {
            for i in 1..lights.len() {
                for j in 0..i {
                    let (low, high) = (group[i].min(group[j]), group[i].max(group[j]));
                    let (a, b) = (&lights[i], &lights[j]);
                    if low < high && close(self.onto_plane(a, b), b.range) && close(self.onto_plane(b, a), a.range) {
                        group.iter_mut().filter(|g| **g == high).for_each(|g| *g = low);
                    }
                }
            }
        }
        for leader in (0..lights.len()).filter(|&i| group[i] == i) {
            let members = (leader..lights.len()).filter(|&i| group[i] == leader).map(|i| lights[i]);
            echoes.push(self.merge(&members.collect::<Vec<_>>()));
        }
        echoes.sort_by(|a, b| a.range.total_cmp(&b.range));
    }

    /// Where the ray of `other` meets the tangent plane of what `light` hit. Both start at the same point.
    fn onto_plane(&self, light: &Light, other: &Light) -> f64 {
        let normal = self.hits[light.ray].normal;
        light.range * dot(normal, self.directions[light.ray]) / dot(normal, self.directions[other.ray])
    }

    /// The echo of one light or more.
    fn merge(&self, lights: &[Light]) -> Echo {
        let object = |light: &Light| self.hits[light.ray].object;
        let share = |of: i32| lights.iter().filter(|l| object(l) == of).map(|l| l.power).sum::<f64>();
        let main = *lights.iter().fold(&lights[0], |best, light| {
            let (a, b) = (object(light), object(best));
            let better = if a == b { light.ray < best.ray } else { share(a) > share(b) };
            if better { light } else { best }
        });
        let power: f64 = lights.iter().map(|l| l.power).sum();
        let moment: f64 = lights.iter().map(|l| l.power * (l.range - main.range)).sum();
        // No mean where no power comes back, from a black surface, or infinite power, from distance zero.
        let mean = moment / power;
        Echo {
            range: main.range + if mean.is_finite() { mean } else { 0.0 },
            intensity: lights.iter().map(|l| l.intensity).sum(),
            power,
            ..Echo::of(main)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beam_has_all_of_its_energy_and_is_balanced() {
        for (rays, rings) in [(7, 1), (19, 2), (37, 3), (61, 4), (91, 5)] {
            let beam = Beam::new([2.0, 1.0], rays, 1.0);
            assert_eq!(beam.cells.len(), rays);
            assert_eq!(beam.cells[0].0, [0.0; 2]);
            let sum = |of: fn([f64; 2]) -> f64| beam.cells.iter().map(|(at, share)| share * of(*at)).sum::<f64>();
            assert!((sum(|_| 1.0) - 1.0).abs() < 1e-15);
            assert!(
                sum(|[x, _]| x).abs() < 1e-16 && sum(|[_, y]| y).abs() < 1e-16 && sum(|[x, y]| x * y).abs() < 1e-16
            );
            // ∫r²·exp(−2r²)·r dr over ∫exp(−2r²)·r dr, up to 1: half of it on each axis, of half angles 1 and 1/2.
            let moment = (1.0 - 3.0 * (-2.0_f64).exp()) / (2.0 * (1.0 - (-2.0_f64).exp()));
            assert!((sum(|[x, _]| x * x) / (moment / 2.0) - 1.0).abs() < 0.01);
            assert!((sum(|[_, y]| y * y) / (moment / 8.0) - 1.0).abs() < 0.01);
            let outermost = beam.cells.iter().map(|(at, _)| at[0]).fold(0.0, f64::max);
            assert!((outermost - f64::from(rings) / (f64::from(rings) + 0.5)).abs() < 1e-15);
        }
    }
}
