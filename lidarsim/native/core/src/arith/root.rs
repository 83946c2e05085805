//! Roots of linear and quadratic equations, kept as their coefficients: the intersections of a line with a
//! surface before rounding.

use std::cmp::Ordering;

pub use super::number::Root;
use super::number::{Number, Uncertain};

/// The index of the root of a line that touches a surface, which has no second root.
pub const TOUCHING: u8 = 2;

impl<N: Number> Root<N> {
    /// t = num/den, den > 0.
    #[inline(always)]
    pub fn linear(num: N, den: N, feature: u8) -> Self {
        Root {
            a: den,
            b: num,
            c: N::exact(0.0),
            disc: N::exact(0.0),
            branch: 0,
            t: None,
            touches: false,
            feature,
        }
    }

    /// t = b/a, a > 0: the double root of a·t² − 2b·t + c = 0.
    #[inline(always)]
    pub fn touching(a: N, b: N, feature: u8) -> Self {
        Root { touches: true, ..Root::linear(b, a, feature) }
    }

    /// t = num/den; `None` if den = 0.
    #[inline(always)]
    pub fn ratio(num: N, den: N, feature: u8) -> Result<Option<Self>, Uncertain> {
        Ok(match den.sign()? {
            Ordering::Equal => None,
            Ordering::Greater => Some(Root::linear(num, den, feature)),
            Ordering::Less => Some(Root::linear(num.negated(), den.negated(), feature)),
        })
    }

    /// The roots of a·t² − 2b·t + c = 0, a > 0, ascending; disc has sign `order`: one root if zero, none
    /// if negative.
    #[inline(always)]
    pub fn quadratic(a: N, b: N, c: N, disc: N, order: Ordering, feature: u8) -> Roots<N> {
        match order {
            Ordering::Less => [None, None],
            Ordering::Equal => [Some(Root::touching(a, b, feature)), None],
            Ordering::Greater => {
                let first = Root { a, b, c, disc, branch: -1, t: None, touches: false, feature };
                [Some(first.clone()), Some(first.other())]
            }
        }
    }

    /// The sign of t = (b + branch·√disc)/a, a > 0.
    pub fn sign(&self) -> Result<Ordering, Uncertain> {
        match self.branch {
            0 => self.b.sign(),
            branch => N::sign_of_surd(&self.b, &N::exact(f64::from(branch)), &self.disc),
        }
    }

    /// The other root of the quadratic equation.
    #[inline(always)]
    pub fn other(self) -> Self {
        Root { branch: -self.branch, t: None, ..self }
    }

    /// Computes t, in kinds of number that round it.
    #[inline(always)]
    fn with_t(mut self) -> Result<Self, Uncertain> {
        self.t = N::locate(&self)?;
        Ok(self)
    }

    /// Sign of p + q·t.
    #[inline(always)]
    pub fn sign_of_linear(&self, p: &N, q: &N) -> Result<Ordering, Uncertain> {
        let constant = p.times(&self.a).plus(&q.times(&self.b));
        if self.branch == 0 {
            return constant.sign();
        }
        let slope = if self.branch > 0 { q.clone() } else { q.negated() };
        N::sign_of_surd(&constant, &slope, &self.disc)
    }
}

/// The roots of a surface of degree two or of a convex solid, ascending and distinct.
pub type Roots<N> = [Option<Root<N>>; 2];

/// The part of a line inside a convex solid, from the largest `entry` to the least `exit`, while one part of
/// the boundary after another cuts it.
#[derive(Clone)]
pub struct Chord<N> {
    entry: Option<Root<N>>,
    exit: Option<Root<N>>,
}

impl<N: Number> Chord<N> {
    #[inline(always)]
    pub fn whole_line() -> Self {
        Chord { entry: None, exit: None }
    }

    #[inline(always)]
    pub fn cut(&mut self, entry: Root<N>, exit: Root<N>) -> Result<(), Uncertain> {
        let (entry, exit) = (entry.with_t()?, exit.with_t()?);
        let later = match &self.entry {
            None => true,
            Some(now) => N::compare(&entry, now)? == Ordering::Greater,
        };
        if later {
            self.entry = Some(entry);
        }
        let earlier = match &self.exit {
            None => true,
            Some(now) => N::compare(&exit, now)? == Ordering::Less,
        };
        if earlier {
            self.exit = Some(exit);
        }
        Ok(())
    }

    #[inline(always)]
    pub fn roots(self) -> Result<Roots<N>, Uncertain> {
        let Chord { entry: Some(entry), exit: Some(exit) } = self else { return Ok([None, None]) };
        Ok(match N::compare(&entry, &exit)? {
            Ordering::Less => [Some(entry), Some(exit)],
            Ordering::Equal => [Some(entry), None],
            Ordering::Greater => [None, None],
        })
    }
}
