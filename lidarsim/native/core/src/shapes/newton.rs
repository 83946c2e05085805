//! Refinement of a closest hit by one step of the interval Newton operator N(T) = m − F(m)/F'(T) (R. Moore,
//! Interval Analysis, 1966), with F(m) in double-double: t, correctly rounded, and the normal there.

use super::Surface;
use crate::arith::number::{
    DoubleDoubles, Interval, Lanes, Number, OfRays, PAD, RunningErrors, UNDERFLOW, UNIT, Uncertain,
};
use crate::arith::simd::Floats;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Vector};

/// The surface that rays hit: one for all lanes, or one per lane.
pub trait Target<L: Lanes<N>, const N: usize> {
    /// As `Surface::implicit`.
    fn implicit<K: OfRays<L, N>>(&self, ray: &Ray<K>, feature: u8, lanes: L) -> K;
    /// As `Surface::normal`.
    fn normal<K: OfRays<L, N>>(&self, ray: &Ray<K>, feature: u8, lanes: L) -> Vector<K>;
}

impl<S: Surface, L: Lanes<N>, const N: usize> Target<L, N> for S {
    #[inline(always)]
    fn implicit<K: OfRays<L, N>>(&self, ray: &Ray<K>, feature: u8, _: L) -> K {
        Surface::implicit(self, ray, feature)
    }

    #[inline(always)]
    fn normal<K: OfRays<L, N>>(&self, ray: &Ray<K>, feature: u8, _: L) -> Vector<K> {
        Surface::normal(self, ray, feature)
    }
}

/// t, rounded to the nearest float64, and a normal there, in the coordinates of the surface, as the rays are.
/// `bounds` enclose a root on part `feature` of the surface.
///
/// Let F(t) be the target's implicit function at t, t* the root within the bounds, m their middle, T an
/// interval around m that contains them, and S ± e an enclosure of F'(T), e < |S|. Then t* − m =
/// −F(m)/F'(ξ), ξ in T. With F(m) = f ± r this is −f/S, with an error of less than r/(|S| − e) +
/// |f|·e/(|S|·(|S| − e)) and the rounding of the quotient.
#[inline(always)]
pub fn newton_step<L: Lanes<N>, const N: usize>(
    ray: &Ray<DoubleDoubles<L, N>>,
    target: &impl Target<L, N>,
    feature: u8,
    bounds: Interval<L::Floats>,
    lanes: L,
) -> Result<(L::Floats, Vector<DoubleDoubles<L, N>>), Uncertain> {
    let (middle, step, near) = step_from_middle(ray, target, feature, bounds, lanes)?;
    let t = middle.plus(&step).rounded()?;
    Ok((t, target.normal(&near.at(&step), feature, lanes)))
}

/// The middle of the bounds, t minus the middle, and the ray starting at the middle.
type NewtonStep<L, const N: usize> = (DoubleDoubles<L, N>, DoubleDoubles<L, N>, Ray<DoubleDoubles<L, N>>);

#[inline(always)]
fn step_from_middle<L: Lanes<N>, const N: usize>(
    ray: &Ray<DoubleDoubles<L, N>>,
    target: &impl Target<L, N>,
    feature: u8,
    bounds: Interval<L::Floats>,
    lanes: L,
) -> Result<NewtonStep<L, N>, Uncertain> {
    let half = L::Floats::splat(0.5);
    let middle = bounds.low.mul(half).add(bounds.high.mul(half));
    let (pad, unit) = (L::Floats::splat(PAD), L::Floats::splat(UNIT));
    let reach = bounds.high.sub(middle).max(middle.sub(bounds.low)).mul(pad);
    let float = Ray::<RunningErrors<L, N>>::from(ray);
    let normal = target.normal(&float.at(&RunningErrors::within(middle, reach, lanes)), feature, lanes);
    let (slope, slope_error) = vector::dot(&normal, &float.direction).doubled().parts();

    let middle = DoubleDoubles::of_rays(middle, lanes);
    let near = ray.at(&middle);
    let (implicit, implicit_error) = target.implicit(&near, feature, lanes).parts();
    // F(m) has a low part, too.
    let rest = implicit.abs().fused(unit, implicit_error);
    let slope_size = slope.abs();
    let margin = slope_size.mul(L::Floats::splat(1.0 - 2.0 * UNIT)).sub(slope_error.mul(pad));
    lanes.keep(L::Floats::splat(0.0).lt(margin))?;
    let step = implicit.div(slope).negated();
    let error = step.abs().fused(slope_size.fused(unit, slope_error), rest).div(margin).mul(pad);
    Ok((middle, DoubleDoubles::within(step, error.fused(pad, L::Floats::splat(UNDERFLOW)), lanes), near))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::arith::number::{Dyadic, One};
    use crate::geometry::vector::Point;
    use crate::shapes::Sphere;
    use crate::testing::{assert_slack, worst};

    /// The error of a step as a share of its bound, on a ray into a surface, with a root within bounds of
    /// width `wide` at the relative position `at`.
    pub fn share(surface: &impl Surface, [origin, direction]: [Point; 2], at: f64, wide: f64) -> f64 {
        let Ok([Some(root), _]) = surface.roots(&Ray::<Dyadic>::new(origin, direction)) else { return 0.0 };
        let Ok(t) = Dyadic::value(&root) else { return 0.0 };
        let middle = t.split().0 + 0.999 * wide * (2.0 * at - 1.0).clamp(-1.0, 1.0);
        let bounds = Interval { low: middle - wide, high: middle + wide };
        let Ok((middle, step, _)) =
            step_from_middle::<One, 1>(&Ray::new(origin, direction), surface, 0, bounds, One)
        else {
            return 0.0;
        };
        let ((middle, _), (step, error)) = (middle.parts(), step.parts());
        t.minus(&Dyadic::exact(middle)).minus(&Dyadic::exact(step)).split().0.abs() / error
    }

    /// Here the error comes from the slope, which varies up to the far side of the bounds. The test of
    /// planes, whose slope is constant, covers the error of F.
    #[test]
    fn steps_are_as_near_as_their_bounds_say() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        for (wide, known) in [(0.8, 0.202), (1e-10, 0.285), (4.0 * UNIT, 0.118)] {
            let of_sphere = |&[y, z, r, at]: &[f64; 4]| {
                let sphere = Sphere { center: [0.0; 3], radius: 2.0 + r };
                share(&sphere, [[-3.0, y, z], [1.0, 0.25, 0.0]], at, wide)
            };
            assert_slack("step", worst(6, 1000, draw, of_sphere).0, known);
        }
    }
}
