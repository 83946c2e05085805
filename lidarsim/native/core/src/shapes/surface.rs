//! The interface of an implicit surface.

use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::{Root, TOUCHING};
use crate::arith::simd::Floats;
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::ray::Ray;
use crate::geometry::vector::Vector;

/// The roots on a line, ascending and distinct, those that there are first.
pub type Roots<N> = [Option<Root<N>>; super::MOST_ROOTS];

/// The roots on a line of a surface that has two at most. This is the one place that a surface with more
/// roots does not compile with: it then has to append `None` here. A copy to a longer array slows cylinders
/// down by a quarter.
#[inline(always)]
pub fn roots<N>(two: [Option<Root<N>>; 2]) -> Roots<N> {
    two
}

/// A surface that a line intersects a few times.
pub trait Surface {
    /// Every t, of either sign, at which the line intersects the surface: ascending and distinct.
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain>;

    /// The root of a line that touches the surface, which is not checked; none of a surface without such
    /// lines.
    fn touching<N: Number>(&self, _ray: &Ray<N>) -> Option<Root<N>> {
        None
    }

    /// The root of a line that intersects the surface, which is not checked; none of a surface that a line
    /// may intersect twice.
    fn only_root<N: Number>(&self, _ray: &Ray<N>) -> Option<Result<Root<N>, Uncertain>> {
        None
    }

    /// The root of this index, as in `RootId`, which there is.
    #[inline(always)]
    fn root<N: Number>(&self, ray: &Ray<N>, index: u8) -> Result<Root<N>, Uncertain> {
        if let Some(root) = self.only_root(ray) {
            return root;
        }
        if index == TOUCHING {
            return self.touching(ray).ok_or(Uncertain);
        }
        let [first, mut others @ ..] = self.roots(ray)?;
        match index {
            0 => first,
            _ => others.get_mut(usize::from(index) - 1).and_then(Option::take),
        }
        .ok_or(Uncertain)
    }

    /// The implicit function F at the ray's origin: zero on part `feature` of the surface, and of degree two
    /// at most.
    fn implicit<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N;

    /// An outward normal at the ray's origin, on part `feature` of the surface or near it: half the gradient
    /// of `implicit`.
    fn normal<N: Number>(&self, ray: &Ray<N>, feature: u8) -> Vector<N>;

    /// The plane perpendicular to an axis that part `feature` of the surface lies in, where there is one and
    /// float64 arithmetic tells it.
    fn axis_plane(&self, _feature: u8) -> Option<AxisPlane> {
        None
    }

    /// An axis-aligned bounding box; none if the surface is unbounded.
    fn bounds(&self) -> Option<[Interval; 3]>;
}

/// A surface that is made from its parameters.
pub trait Shape: Surface + Sized {
    /// Most roots on a line.
    const MOST_ROOTS: usize;

    /// The sets of arguments that the shape is made from, one or more.
    const FORMS: &'static [Form];

    /// The shape with the arguments of a form, which are finite, in its order. The error names an illegal
    /// argument.
    fn from_numbers(form: usize, numbers: &[f64]) -> Result<Self, IllegalArgument>;
}

/// An argument of a shape that cannot be used.
pub struct IllegalArgument {
    pub argument: &'static str,
    pub expected: &'static str,
    pub got: String,
}

impl IllegalArgument {
    pub fn new(argument: &'static str, expected: &'static str, got: impl Into<String>) -> Self {
        IllegalArgument { argument, expected, got: got.into() }
    }
}

/// The names of some arguments, and how many numbers each has.
pub type Form = &'static [(&'static str, usize)];

/// The numbers of arguments as an array; an error if there are not N.
pub fn parameters<const N: usize>(numbers: &[f64]) -> Result<[f64; N], IllegalArgument> {
    let wrong = |_| IllegalArgument::new("numbers", "as many as the form has", numbers.len().to_string());
    numbers.try_into().map_err(wrong)
}

/// An error unless a parameter is > 0.
pub fn positive(name: &'static str, number: f64) -> Result<(), IllegalArgument> {
    if number > 0.0 {
        return Ok(());
    }
    Err(IllegalArgument::new(name, "a finite number > 0", format!("{number:?}")))
}

/// An error unless all numbers of a parameter are > 0.
pub fn all_positive(name: &'static str, numbers: &[f64]) -> Result<(), IllegalArgument> {
    match numbers.iter().enumerate().find(|&(_, number)| !(*number > 0.0)) {
        None => Ok(()),
        Some((i, number)) => {
            Err(IllegalArgument::new(name, "numbers > 0", format!("{name}[{i}] = {number:?}")))
        }
    }
}

/// A function that is generic over the type of a surface and over registers of N lanes: an always inlined
/// `run`.
pub trait SurfaceTask {
    type Output;
    fn run<F: Floats<f64, N>, S: Surface, const N: usize>(self, surface: &S) -> Self::Output;
}
