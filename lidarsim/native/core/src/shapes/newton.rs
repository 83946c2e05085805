//! Refinement of a closest hit by one step of the interval Newton operator N(T) = m − F(m)/F'(T) (R. Moore, Interval Analysis, 1966), with F(m) in
//! double-double: t, correctly rounded, and the normal there.

use super::Surface;
use crate::arith::number::{
    DoubleDoubles, Interval, Lanes, Number, OfRays, PAD, RunningErrors, UNDERFLOW, UNIT, Uncertain,
};
use crate::arith::simd::Floats;
use crate::geometry::affine::RayPlacement;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Vector, of_rays};

/// The surface that rays hit: one for all lanes, or one each.
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

/// Rays, and brackets of their roots on part `feature` of a surface.
pub struct RootBracket<F> {
    pub feature: u8,
    pub origin: [F; 3],
    pub direction: [F; 3],
    /// Of t.
    pub bounds: Interval<F>,
}

/// t, rounded to the nearest float64, and a normal in the world as `Number::proportions` gives it.
///
/// Let F(t) be the target's implicit function at t, t* the root within the bounds, m their middle, T an interval around m that holds them, and
/// S ± e an enclosure of F'(T), e < |S|. Then t* − m = −F(m)/F'(ξ), ξ in T. With F(m) = f ± r this is −f/S, off by less than r/(|S| − e), and
/// |f|·e/(|S|·(|S| − e)), and the rounding of the quotient.
#[inline(always)]
pub fn newton_step<L: Lanes<N>, const N: usize>(
    placement: impl RayPlacement,
    target: &impl Target<L, N>,
    bracket: &RootBracket<L::Floats>,
    lanes: L,
) -> Result<(L::Floats, [L::Floats; 3]), Uncertain> {
    let RootBracket { feature, origin, direction, bounds } = *bracket;
    let float: Ray<RunningErrors<L, N>> =
        Ray { origin: of_rays(origin, lanes), direction: of_rays(direction, lanes), weight: None };
    let double: Ray<DoubleDoubles<L, N>> =
        Ray { origin: of_rays(origin, lanes), direction: of_rays(direction, lanes), weight: None };
    let half = L::Floats::splat(0.5);
    let middle = bounds.low.mul(half).add(bounds.high.mul(half));
    let (pad, unit) = (L::Floats::splat(PAD), L::Floats::splat(UNIT));
    let reach = bounds.high.sub(middle).max(middle.sub(bounds.low)).mul(pad);
    let somewhere = float.at(&RunningErrors::within(middle, reach, lanes));
    let normal = placement.normals(target.normal(&placement.local_rays(somewhere, lanes), feature, lanes), lanes);
    let (slope, slope_error) = vector::dot(&normal, &float.direction).doubled().parts();

    let middle = DoubleDoubles::of_rays(middle, lanes);
    let near = double.at(&middle);
    let (implicit, implicit_error) =
        target.implicit(&placement.local_rays(near.clone(), lanes), feature, lanes).parts();
    // The number has a lower half.
    let rest = implicit.abs().fused(unit, implicit_error);
    let slope_size = slope.abs();
    let margin = slope_size.mul(L::Floats::splat(1.0 - 2.0 * UNIT)).sub(slope_error.mul(pad));
    lanes.keep(L::Floats::splat(0.0).lt(margin))?;
    let step = implicit.div(slope).negated();
    let error = step.abs().fused(slope_size.fused(unit, slope_error), rest).div(margin).mul(pad);
    let step = DoubleDoubles::within(step, error.fused(pad, L::Floats::splat(UNDERFLOW)), lanes);

    let t = middle.plus(&step).rounded()?;
    let normal = placement.normals(target.normal(&placement.local_rays(near.at(&step), lanes), feature, lanes), lanes);
    Ok((t, DoubleDoubles::proportions(&normal)?))
}
