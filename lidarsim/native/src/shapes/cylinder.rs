//! Cylinder of radius r around the axis from `start` to `end`, A = end − start, which is not normalised.
//!
//! With f = o − start: n = d × A, m = f × A, the side is |m + t·n|² = r²·|A|². Its discriminant (n·m)² − |n|²·(|m|² − r²|A|²)
//! equals |A|²·(r²|n|² − (f·n)²), as n × m = −A·(f·n); so no squares of the distance cancel.

use std::cmp::Ordering;

use super::Surface;
use crate::number::{Interval, Number, Uncertain};
use crate::ray::Ray;
use crate::root::{Chord, Root, Roots};
use crate::vector::{self, Point, Vector};

const SIDE: u8 = 0;
const START: u8 = 1;
const END: u8 = 2;

#[derive(Clone, Copy, Debug)]
pub struct Cylinder {
    pub start: Point,
    pub end: Point,
    pub radius: f64,
    /// A solid's boundary, with caps at both ends; else the side alone.
    pub capped: bool,
}

impl Cylinder {
    fn axis<N: Number>(&self) -> Vector<N> {
        vector::sub(&vector::exact(self.end), &vector::exact(self.start))
    }
}

impl Surface for Cylinder {
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let axis: Vector<N> = self.axis();
        let length2 = vector::norm2(&axis);
        let f = ray.origin_from(vector::exact(self.start));
        let d = &ray.direction;
        let n = vector::cross(d, &axis);
        let m = vector::cross(&f, &axis);
        let r2 = ray.weighted(N::exact(self.radius)).squared();
        let a = vector::norm2(&n);
        let c = vector::norm2(&m).minus(&r2.times(&length2));

        // Heights along the axis, times |A|: the side reaches from 0 to `height`.
        let height = ray.weighted(length2.clone());
        let at_origin = vector::dot(&f, &axis);
        let rise = vector::dot(d, &axis);

        let side = if a.is_zero()? {
            if !self.capped || c.sign()? == Ordering::Greater {
                return Ok([None, None]);
            }
            None
        } else {
            let disc = length2.times(&r2.times(&a).minus(&vector::dot(&f, &n).squared()));
            let [first, second] = Root::quadratic(a, vector::dot(&n, &m).negated(), c, disc, SIDE)?;
            let Some(first) = first else { return Ok([None, None]) };
            Some((first, second))
        };

        if !self.capped {
            let Some((first, second)) = side else { return Ok([None, None]) };
            let inside = |root: Root<N>| -> Result<Option<Root<N>>, Uncertain> {
                let above = root.sign_of_linear(&at_origin, &rise)? != Ordering::Less;
                let inside = above && root.sign_of_linear(&at_origin.minus(&height), &rise)? != Ordering::Greater;
                Ok(inside.then_some(root))
            };
            let first = inside(first)?;
            let second = second.map_or(Ok(None), inside)?;
            return Ok(if first.is_none() { [second, None] } else { [first, second] });
        }

        let mut chord = Chord::whole_line();
        if let Some((first, second)) = side {
            let exit = second.unwrap_or(first.clone());
            chord.cut(first, exit)?;
        }
        let start = Root::ratio(at_origin.negated(), rise.clone(), START)?;
        let end = Root::ratio(height.minus(&at_origin), rise.clone(), END)?;
        if let (Some(start), Some(end)) = (start, end) {
            if rise.sign()? == Ordering::Greater { chord.cut(start, end)? } else { chord.cut(end, start)? }
        } else if at_origin.sign()? == Ordering::Less || at_origin.minus(&height).sign()? == Ordering::Greater {
            return Ok([None, None]);
        }
        chord.roots()
    }

    fn normal<N: Number>(&self, ray: &Ray<N>, t: &N, feature: u8) -> Vector<N> {
        let axis = self.axis();
        match feature {
            START => vector::negated(&axis),
            END => axis,
            _ => {
                // A × ((f + t·d) × A): the part of f + t·d across the axis, times |A|².
                let f = ray.origin_from(vector::exact(self.start));
                let p = vector::add(&f, &vector::scaled(&ray.direction, t));
                vector::cross(&axis, &vector::cross(&p, &axis))
            }
        }
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(std::array::from_fn(|i| Interval {
            low: (self.start[i].min(self.end[i]) - self.radius).next_down(),
            high: (self.start[i].max(self.end[i]) + self.radius).next_up(),
        }))
    }
}
