//! Capsule: all points at a distance of `radius` from the segment from `start` to `end`, which is the outer
//! surface of a cylinder and of two balls around its ends.
//!
//! A line crosses the side, extended without end, at two roots, with its part inside the capsule between
//! them. If it is between both ends at the first root, it enters the capsule there. If it is beyond an end,
//! it enters through that end's half of a sphere, or not at all: before the line reaches the side or the
//! other end, it crosses the disc between the half and the side. So it meets the ball, and enters it first.
//! The same holds, backwards, for where it leaves. The seams of the side and the halves belong to the side,
//! which has the same normals there.

use super::cylinder::{Cylinder, END, SIDE, START, Side};
use super::sphere::Sphere;
use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, parameters, roots};
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::ray::{Ray, union};
use crate::geometry::vector::{Point, Vector};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    pub start: Point,
    pub end: Point,
    pub radius: f64,
}

impl Capsule {
    #[inline(always)]
    fn cylinder(&self) -> Cylinder {
        Cylinder { start: self.start, end: self.end, radius: self.radius, capped: false }
    }

    #[inline(always)]
    fn ball(&self, end: u8) -> Sphere {
        Sphere { center: if end == START { self.start } else { self.end }, radius: self.radius }
    }

    /// The roots on the ball around an end.
    #[inline(always)]
    fn roots_of_ball<N: Number>(&self, end: u8, ray: &Ray<N>) -> Result<[Option<Root<N>>; 2], Uncertain> {
        let [first, second] = self.ball(end).roots(ray)?;
        Ok([of_part(first, end), of_part(second, end)])
    }
}

/// The root on a part of the surface. A line may touch each of the three parts, and `Surface::touching` is
/// not told which.
#[inline(always)]
fn of_part<N>(root: Option<Root<N>>, part: u8) -> Option<Root<N>> {
    match root {
        None => None,
        Some(root) => Some(Root { feature: part, touches: false, ..root }),
    }
}

impl Shape for Capsule {
    const MOST_ROOTS: usize = 2;

    const FORMS: &'static [Form] = &[&[("start", 3), ("end", 3), ("radius", 1)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [a, b, c, x, y, z, radius] = parameters(numbers)?;
        let Cylinder { start, end, radius, .. } =
            Cylinder::from_numbers(0, &[a, b, c, x, y, z, radius, 0.0])?;
        Ok(Capsule { start, end, radius })
    }
}

impl Surface for Capsule {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let side = Side::of(&self.cylinder(), ray);
        let (entry, exit) = if side.is_parallel()? {
            let (first, last) = if side.rise.sign()?.is_gt() { (START, END) } else { (END, START) };
            ((None, first), (None, last))
        } else {
            let [Some(entry), exit] = side.roots()? else { return Ok(roots([None, None])) };
            let first = side.beyond(&entry)?;
            let Some(exit) = exit else {
                // The balls touch the side, extended, at the seams alone.
                let is_on_capsule = first == SIDE;
                return Ok(roots([if is_on_capsule { of_part(Some(entry), SIDE) } else { None }, None]));
            };
            let last = side.beyond(&exit)?;
            if first == last && first != SIDE {
                return Ok(roots(self.roots_of_ball(first, ray)?));
            }
            ((Some(entry), first), (Some(exit), last))
        };
        let entry = match entry {
            (entry, SIDE) => entry,
            (_, end) => {
                let [first, _] = self.roots_of_ball(end, ray)?;
                first
            }
        };
        let exit = match exit {
            (exit, SIDE) => exit,
            (_, end) => match self.roots_of_ball(end, ray)? {
                // A line within the side touches both balls.
                [first, None] => first,
                [_, second] => second,
            },
        };
        Ok(roots([entry, exit]))
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
        match feature {
            SIDE => self.cylinder().implicit(ray, SIDE),
            end => self.ball(end).implicit(ray, 0),
        }
    }

    #[inline(always)]
    fn normal<N: Number>(&self, ray: &Ray<N>, feature: u8) -> Vector<N> {
        match feature {
            SIDE => self.cylinder().normal(ray, SIDE),
            end => self.ball(end).normal(ray, 0),
        }
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(union(self.ball(START).bounds()?, self.ball(END).bounds()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::Dyadic;

    const CAPSULE: Capsule = Capsule { start: [0.0; 3], end: [0.0, 0.0, 4.0], radius: 5.0 };

    /// The roots of a line, and the parts of the surface that they are on.
    fn roots_of(origin: Point, direction: Point) -> Vec<(f64, u8)> {
        let roots = CAPSULE.roots(&Ray::<Dyadic>::new(origin, direction)).into_iter().flatten().flatten();
        roots.map(|root| (Dyadic::round(&root).unwrap_or(f64::NAN), root.feature)).collect()
    }

    /// 3² + 4² = 5² at the heights of the seams, and next to them.
    #[test]
    fn a_seam_is_met_once() {
        let tiny = f64::from_bits(1);
        for (z, part) in [(-tiny, START), (0.0, SIDE), (4.0, SIDE), (4.0_f64.next_up(), END)] {
            let across = roots_of([-9.0, 3.0, z], [1.0, 0.0, 0.0]);
            assert_eq!(across, [(5.0, part), (13.0, part)], "{z}");
        }
        assert_eq!(roots_of([-9.0, 5.0, 0.0], [1.0, 0.0, 0.0]), [(9.0, SIDE)]);
        assert_eq!(roots_of([-9.0, 5.0, -tiny], [1.0, 0.0, 0.0]), []);
        // Through a seam into the ball around that end.
        assert_eq!(roots_of([6.0, 0.0, 5.0], [-1.0, 0.0, -5.0]), [(1.0, SIDE), (18.0 / 13.0, START)]);
    }

    #[test]
    fn a_line_along_the_axis_meets_both_ends() {
        for (x, y, reach) in [(0.0, 0.0, 5.0), (0.0, 3.0, 4.0), (3.0, 4.0, 0.0)] {
            let up = roots_of([x, y, -9.0], [0.0, 0.0, 1.0]);
            assert_eq!(up, [(9.0 - reach, START), (13.0 + reach, END)]);
            let down = roots_of([x, y, 9.0], [0.0, 0.0, -2.0]);
            assert_eq!(down, [(2.5 - reach / 2.0, END), (4.5 + reach / 2.0, START)]);
        }
        assert_eq!(roots_of([3.0, 4.0_f64.next_up(), -9.0], [0.0, 0.0, 1.0]), []);
    }

    #[test]
    fn a_line_that_touches_an_end_has_one_root() {
        assert_eq!(roots_of([-9.0, 0.0, -5.0], [1.0, 0.0, 0.0]), [(9.0, START)]);
        assert_eq!(roots_of([-9.0, 0.0, 9.0], [1.0, 0.0, 0.0]), [(9.0, END)]);
        assert_eq!(roots_of([-9.0, 0.0, 9.0_f64.next_up()], [1.0, 0.0, 0.0]), []);
        // At (3, 0, −4), along (4, 0, 3).
        assert_eq!(roots_of([-1.0, 0.0, -7.0], [4.0, 0.0, 3.0]), [(1.0, START)]);
    }
}
