//! Cylinder of radius r around the axis from `start` to `end`, A = end − start, which is not normalized.
//!
//! With f = o − start: n = d × A, m = f × A, the side is |m + t·n|² = r²·|A|². Its discriminant
//! (n·m)² − |n|²·(|m|² − r²|A|²) equals |A|²·(r²|n|² − (f·n)²), as n × m = −A·(f·n),
//! so squares of the distance do not cancel.

use std::cmp::Ordering;

use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, parameters, positive, roots};
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::{Chord, Root};
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::point;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

pub(super) const SIDE: u8 = 0;
pub(super) const START: u8 = 1;
pub(super) const END: u8 = 2;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    pub start: Point,
    pub end: Point,
    pub radius: f64,
    /// Whether caps close both ends; otherwise there is only the side.
    pub capped: bool,
}

impl Cylinder {
    #[inline(always)]
    fn axis<N: Number>(&self) -> Vector<N> {
        vector::sub(&vector::exact(self.end), &vector::exact(self.start))
    }
}

/// A line, and the side extended without end.
pub(super) struct Side<N> {
    length2: N,
    r2: N,
    f: Vector<N>,
    n: Vector<N>,
    m: Vector<N>,
    a: N,
    c: N,
    /// Heights along the axis, times |A|. The line is at `at_origin` + t·`rise`; the ends are at 0 and
    /// `height`.
    at_origin: N,
    pub rise: N,
    height: N,
}

impl<N: Number> Side<N> {
    #[inline(always)]
    pub fn of(cylinder: &Cylinder, ray: &Ray<N>) -> Self {
        let axis: Vector<N> = cylinder.axis();
        let length2 = vector::norm2(&axis);
        let f = ray.origin_from(vector::exact(cylinder.start));
        let d = &ray.direction;
        let n = vector::cross(d, &axis);
        let m = vector::cross(&f, &axis);
        let r2 = ray.weighted(N::exact(cylinder.radius)).squared();
        let a = vector::norm2(&n);
        let c = vector::norm2(&m).minus(&r2.times(&length2));
        let height = ray.weighted(length2.clone());
        let at_origin = vector::dot(&f, &axis);
        let rise = vector::dot(d, &axis);
        Side { length2, r2, f, n, m, a, c, at_origin, rise, height }
    }

    #[inline(always)]
    pub fn is_parallel(&self) -> Result<bool, Uncertain> {
        self.a.is_zero()
    }

    /// The roots of a line that is not parallel to the axis.
    #[inline(always)]
    pub fn roots(&self) -> Result<[Option<Root<N>>; 2], Uncertain> {
        let across = vector::dot(&self.f, &self.n).squared();
        let disc = self.length2.times(&self.r2.times(&self.a).minus(&across));
        let order = disc.sign()?;
        let b = vector::dot(&self.n, &self.m).negated();
        Ok(Root::quadratic(self.a.clone(), b, self.c.clone(), disc, order, SIDE))
    }

    /// `START` or `END` if the line is beyond that end at the root, else `SIDE`.
    #[inline(always)]
    pub fn beyond(&self, root: &Root<N>) -> Result<u8, Uncertain> {
        if root.sign_of_linear(&self.at_origin, &self.rise)? == Ordering::Less {
            return Ok(START);
        }
        let past_end = self.at_origin.minus(&self.height);
        Ok(if root.sign_of_linear(&past_end, &self.rise)? == Ordering::Greater { END } else { SIDE })
    }
}

impl Shape for Cylinder {
    const MOST_ROOTS: usize = 2;

    /// `capped` is 1 or 0.
    const FORMS: &'static [Form] = &[&[("start", 3), ("end", 3), ("radius", 1), ("capped", 1)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [a, b, c, x, y, z, radius, capped] = parameters(numbers)?;
        if [a, b, c] == [x, y, z] {
            let both = format!("{:?} for both", (x, y, z));
            return Err(IllegalArgument::new("end", "a point other than start", both));
        }
        positive("radius", radius)?;
        Ok(Cylinder { start: [a, b, c], end: [x, y, z], radius, capped: capped != 0.0 })
    }
}

impl Surface for Cylinder {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let side = Side::of(self, ray);
        let crossed = if side.is_parallel()? {
            if !self.capped || side.c.sign()? == Ordering::Greater {
                return Ok(roots([None, None]));
            }
            None
        } else {
            let [Some(first), second] = side.roots()? else { return Ok(roots([None, None])) };
            Some((first, second))
        };

        if !self.capped {
            let Some((first, second)) = crossed else { return Ok(roots([None, None])) };
            let first = if side.beyond(&first)? == SIDE { Some(first) } else { None };
            let second = match second {
                Some(second) if side.beyond(&second)? == SIDE => Some(second),
                _ => None,
            };
            return Ok(roots(if first.is_none() { [second, None] } else { [first, second] }));
        }

        let mut chord = Chord::whole_line();
        if let Some((first, _)) = crossed {
            // The same root if the line touches the side.
            let exit = first.clone().other();
            chord.cut(first, exit)?;
        }
        let Side { at_origin, rise, height, .. } = side;
        let to_end = height.minus(&at_origin);
        let (entry, exit) = match rise.sign()? {
            Ordering::Greater => {
                (Root::linear(at_origin.negated(), rise.clone(), START), Root::linear(to_end, rise, END))
            }
            Ordering::Less => {
                let fall = rise.negated();
                (Root::linear(to_end.negated(), fall.clone(), END), Root::linear(at_origin, fall, START))
            }
            Ordering::Equal => {
                let beside = at_origin.sign()? == Ordering::Less || to_end.sign()? == Ordering::Less;
                return if beside { Ok(roots([None, None])) } else { Ok(roots(chord.roots()?)) };
            }
        };
        chord.cut(entry, exit)?;
        Ok(roots(chord.roots()?))
    }

    #[inline(always)]
    fn touching<N: Number>(&self, ray: &Ray<N>) -> Option<Root<N>> {
        let axis: Vector<N> = self.axis();
        let n = vector::cross(&ray.direction, &axis);
        let m = vector::cross(&ray.origin_from(vector::exact(self.start)), &axis);
        Some(Root::touching(vector::norm2(&n), vector::dot(&n, &m).negated(), SIDE))
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
        let axis = self.axis();
        let f = ray.origin_from(vector::exact(if feature == END { self.end } else { self.start }));
        match feature {
            START => vector::dot(&axis, &f).doubled().negated(),
            END => vector::dot(&axis, &f).doubled(),
            _ => {
                let r2 = ray.weighted(N::exact(self.radius)).squared();
                vector::norm2(&vector::cross(&f, &axis)).minus(&r2.times(&vector::norm2(&axis)))
            }
        }
    }

    #[inline(always)]
    fn normal<N: Number>(&self, ray: &Ray<N>, feature: u8) -> Vector<N> {
        let axis = self.axis();
        match feature {
            START => vector::negated(&axis),
            END => axis,
            _ => {
                // A × (f × A): the component of f perpendicular to the axis, times |A|².
                let f = ray.origin_from(vector::exact(self.start));
                vector::cross(&axis, &vector::cross(&f, &axis))
            }
        }
    }

    fn axis_plane(&self, feature: u8) -> Option<AxisPlane> {
        let center = match feature {
            START => self.start,
            END => self.end,
            _ => return None,
        };
        let axis = (0..3).find(|&axis| (0..3).all(|i| (self.start[i] == self.end[i]) == (i != axis)))?;
        AxisPlane::at(axis, center[axis], 0.0)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        let reach = vector::reach_of_circle(point::sub(self.end, self.start), self.radius);
        Some(std::array::from_fn(|i| Interval {
            low: (self.start[i].min(self.end[i]) - reach[i]).next_down(),
            high: (self.start[i].max(self.end[i]) + reach[i]).next_up(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_is_close_around_both_circles() {
        // The expected bounds are off by less than 16 roundings of numbers near 1. The box reaches 16 + 32 ε
        // too far along the share of the radius, and is rounded outward where |end| ≤ 4: 64 ε cover both.
        let (off, close) = (8.0 * f64::EPSILON, 72.0 * f64::EPSILON);
        for end in [[0.0, 0.0, 2.0], [3.0, 0.0, 4.0], [1.0, -2.0, 2.0], [1e-200, 2e-200, 0.0]] {
            let cylinder = Cylinder { start: [0.0; 3], end, radius: 1.0, capped: true };
            let length = (end[0] * end[0] + end[1] * end[1] + end[2] * end[2]).sqrt();
            for (i, side) in cylinder.bounds().into_iter().flatten().enumerate() {
                // Squares of the shortest axis underflow; its circles are those of (1, 2, 0).
                let share = if length > 0.0 { end[i] / length } else { [1.0, 2.0, 0.0][i] / 5_f64.sqrt() };
                let reach = (1.0 - share * share).max(0.0).sqrt();
                let (low, high) = (end[i].min(0.0) - reach, end[i].max(0.0) + reach);
                assert!(low - close <= side.low && side.low <= low + off);
                assert!(high - off <= side.high && side.high <= high + close);
            }
        }
    }
}
