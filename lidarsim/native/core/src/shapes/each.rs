//! Shapes of which one object holds many: tests of a ray against eight of them, and their formulas over
//! numbers that differ from lane to lane.

use super::newton::Target;
use super::surface::Surface;
use crate::arith::number::{Interval, Lanes, Number, OfRays, UNIT};
use crate::arith::simd::Isa;
use crate::geometry::point::dot;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{Point, Vector};

/// A shape that K numbers define: first its centre and a radius; it is within that ball.
///
/// A ray meets a shape iff polynomials of the numbers have certain signs. Tests evaluate them in float64 and
/// bound their errors: if each coordinate of the origin is off by ε and of the direction d by ε_d, f = o − c
/// is the origin relative to the centre, m = |f|₁ and L = |d|₁, the coordinates of f × d together are off by
/// less than
///
/// E = m·(4u·L + 4ε_d) + 4ε·(L + 2ε_d) + the smallest normal number.
///
/// A coordinate of f rounds by u of itself, the two products and the difference in a coordinate of f × d by
/// 2u of the products: 3u·m·L over all. The given errors add 2m·ε_d + 2L·ε + 6ε·ε_d. Second-order terms, and
/// the roundings of E itself, are within the rest, underflow within the last term. A sum f·d is off by less
/// than E, too: by 4u·m·L + m·ε_d + L·ε + 3ε·ε_d. Factors of 1 + 16u cover fewer than 16 roundings of a bound
/// and of what it is compared with. Where anything overflows or is NaN, so does a square of E, and
/// comparisons with it leave the ray uncertain.
pub trait Each<const K: usize>: Surface + Send + Sync {
    /// The most roots on a line: one or two.
    const ROOTS: usize;

    /// Eight shapes as seen from an origin.
    type Seen<I: Isa>;

    /// The numbers, of any kind.
    type Numbers<N>;

    /// The shape with these numbers.
    fn of(numbers: [f64; K]) -> Self;

    fn seen_from<I: Isa>(origin: Point, numbers: &[[f64; 8]; K]) -> Self::Seen<I>;

    /// The shapes that a ray may meet: all except those certainly missed.
    fn candidates<I: Isa>(seen: &Self::Seen<I>, ray: &EachRay) -> u32;

    /// Bounds of the roots on the shapes that `candidates` returns.
    fn crossings<I: Isa>(seen: &Self::Seen<I>, ray: &EachRay) -> EachCrossings<I>;

    fn of_rays<N: OfRays<L, M>, L: Lanes<M>, const M: usize>(
        numbers: &[L::Floats; K],
        lanes: L,
    ) -> Self::Numbers<N>;

    /// As `Surface::implicit`, of the shape with these numbers.
    fn implicit_of<N: Number>(numbers: Self::Numbers<N>, ray: &Ray<N>) -> N;

    /// As `Surface::normal`.
    fn normal_of<N: Number>(numbers: Self::Numbers<N>, ray: &Ray<N>) -> Vector<N>;
}

/// A ray at many shapes, with the terms of `Each` that depend on it alone.
pub struct EachRay {
    pub direction: Point,
    /// ε.
    pub off: f64,
    /// |d|², and an upper bound of how far the true one exceeds or falls below that, before rounding.
    pub square: f64,
    pub square_error: f64,
    /// An upper bound of the true |d|₁.
    pub length: f64,
    /// 4u·L + 4ε_d.
    pub turned: f64,
    /// The terms of E that do not depend on the shape.
    pub moved: f64,
}

impl EachRay {
    /// The ray with these bounds of the errors of its coordinates; `length` is |d|₁.
    #[inline(always)]
    pub fn new(direction: Point, length: f64, off: f64, bent: f64) -> Self {
        EachRay {
            direction,
            off,
            square: dot(direction, direction),
            square_error: 4.0 * bent * (length + bent),
            length: length + 4.0 * bent,
            turned: 4.0 * UNIT * length + 4.0 * bent,
            moved: 4.0 * off * (length + 2.0 * bent) + f64::MIN_POSITIVE,
        }
    }
}

/// The shapes that a ray certainly meets, with bounds of its roots, ascending; the first `Each::ROOTS` count.
pub struct EachCrossings<I: Isa> {
    pub certain: u32,
    pub t: [Interval<I::F64x8>; 2],
}

/// One shape per ray of a register, by number.
pub struct EachOf<S, F, const K: usize>(pub [F; K], pub std::marker::PhantomData<S>);

impl<S: Each<K>, L: Lanes<N>, const N: usize, const K: usize> Target<L, N> for EachOf<S, L::Floats, K> {
    #[inline(always)]
    fn implicit<M: OfRays<L, N>>(&self, ray: &Ray<M>, _: u8, lanes: L) -> M {
        S::implicit_of(S::of_rays(&self.0, lanes), ray)
    }

    #[inline(always)]
    fn normal<M: OfRays<L, N>>(&self, ray: &Ray<M>, _: u8, lanes: L) -> Vector<M> {
        S::normal_of(S::of_rays(&self.0, lanes), ray)
    }
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::{self, Dyadic, Number};
    use crate::arith::simd::{Floats, Level, Task, dispatch};
    use crate::shapes::{Disk, Sphere};
    use crate::testing::{assert_slack, numbers, worst};

    /// The masks of the shapes met and of those certainly met, and bounds of the roots.
    struct Tested<'a, S, const K: usize>(Point, EachRay, &'a [[f64; 8]; K], std::marker::PhantomData<S>);

    impl<S: Each<K>, const K: usize> Task for Tested<'_, S, K> {
        type Output = (u32, u32, [[[f64; 8]; 2]; 2]);

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            let seen = S::seen_from::<I>(self.0, self.2);
            let EachCrossings { certain, t } = S::crossings(&seen, &self.1);
            let [first, second] = t;
            let bounds = [[first.low.store(), first.high.store()], [second.low.store(), second.high.store()]];
            (S::candidates(&seen, &self.1), certain, bounds)
        }
    }

    /// Rays to, past and around shapes of all sizes, given to within errors, next to their rims and tangents.
    /// Returns how many pairs are met, certain, and met in truth.
    fn check<S: Each<K>, const K: usize>() -> [usize; 3] {
        let mut next = numbers();
        let mut found = [0; 3];
        for round in 0..3000 {
            let mut vector = |scale: f64| -> Point { [0; 3].map(|_: u8| scale * (2.0 * next() - 1.0)) };
            let (place, scale) = ([0.0, 1e3, 5e6][round % 3], [1.0, 1e-3, 1e4][round / 3 % 3]);
            let center = vector(place);
            let rows: [[f64; K]; 8] = std::array::from_fn(|_| {
                let ([x, y, z], n, r) = (vector(scale), vector(1.0), vector(scale)[0].abs() + 1e-3 * scale);
                let row = [center[0] + x, center[1] + y, center[2] + z, r, n[0], n[1], n[2]];
                std::array::from_fn(|k| row[k])
            });
            let aimed = &rows[round % 8];
            // A point near the rim of a disk, or of the outline of a sphere.
            let normal = if K == 4 { vector(1.0) } else { [aimed[K - 3], aimed[K - 2], aimed[K - 1]] };
            let out = crate::geometry::point::cross(normal, vector(1.0));
            let (length, share) = (dot(out, out).sqrt(), [0.5, 1.0, 1.0 - 1e-15, 1.0 + 1e-9][round / 9 % 4]);
            let target: Point = std::array::from_fn(|i| aimed[i] + aimed[3] * share * out[i] / length);
            let (away, bend) = (vector(10.0 * scale), vector(scale));
            let ray_origin: Point = std::array::from_fn(|i| target[i] + away[i] + bend[i]);
            let ray_direction: Point = std::array::from_fn(|i| target[i] - ray_origin[i]);
            let error = [0.0, 1e-12, 1e-6][round / 36 % 3];
            let off = |v: Point, by: Point| -> Point { std::array::from_fn(|i| v[i] + error * by[i]) };
            let (o, d) = (off(ray_origin, vector(scale)), off(ray_direction, vector(scale)));
            let largest =
                |a: Point, b: Point| (0..3).fold(0.0_f64, |m, i| m.max((a[i] - b[i]).abs().next_up()));
            let (o_error, d_error) =
                if error == 0.0 { (0.0, 0.0) } else { (largest(o, ray_origin), largest(d, ray_direction)) };
            let numbers: [[f64; 8]; K] = std::array::from_fn(|k| rows.map(|row| row[k]));
            for level in Level::available() {
                let length = d[0].abs() + d[1].abs() + d[2].abs();
                let ray = EachRay::new(d, length, o_error, d_error);
                let (met, certain, bounds) =
                    dispatch(level, Tested::<S, K>(o, ray, &numbers, std::marker::PhantomData));
                for (i, row) in rows.iter().enumerate() {
                    let exact = Ray::<Dyadic>::new(ray_origin, ray_direction);
                    let roots = S::of(*row).roots(&exact);
                    let Ok(roots) = roots else { unreachable!("exact arithmetic is never uncertain") };
                    let bit = 1 << i;
                    let count = roots.iter().flatten().count();
                    assert!(
                        count == 0 || met & bit != 0,
                        "{level:?} {row:?} {ray_origin:?} {ray_direction:?}"
                    );
                    found[0] += usize::from(met & bit != 0);
                    found[2] += usize::from(count > 0);
                    if certain & met & bit == 0 {
                        continue;
                    }
                    found[1] += 1;
                    assert_eq!(count, S::ROOTS, "{level:?} {row:?} {ray_origin:?} {ray_direction:?}");
                    for (root, [low, high]) in roots.iter().flatten().zip(&bounds) {
                        let end = |t: f64| number::Root::linear(Dyadic::exact(t), Dyadic::exact(1.0), 0);
                        let order = |t: f64| Dyadic::compare(root, &end(t));
                        assert!(order(low[i]) != Ok(Ordering::Less), "{level:?} {row:?}: {}", low[i]);
                        assert!(order(high[i]) != Ok(Ordering::Greater), "{level:?} {row:?}: {}", high[i]);
                    }
                }
            }
        }
        found
    }

    #[test]
    fn tests_of_eight_spheres_hold_what_is_true() {
        let [met, certain, truth] = check::<Sphere, 4>();
        assert!(
            truth > 10_000 && met < truth + truth / 10 && 10 * certain > 8 * truth,
            "{met} {certain} {truth}"
        );
    }

    #[test]
    fn tests_of_eight_disks_hold_what_is_true() {
        let [met, certain, truth] = check::<Disk, 7>();
        assert!(
            truth > 5_000 && met < truth + truth / 5 && 10 * certain > 7 * truth,
            "{met} {certain} {truth}"
        );
    }

    /// The error of the middle of the bounds of the first root, as a share of half their width.
    fn share<S: Each<K>, const K: usize>(row: [f64; K], origin: Point, direction: Point) -> f64 {
        let numbers = row.map(|number| [number; 8]);
        let length = direction[0].abs() + direction[1].abs() + direction[2].abs();
        let ray = EachRay::new(direction, length, 0.0, 0.0);
        let tested = Tested::<S, K>(origin, ray, &numbers, std::marker::PhantomData);
        let (_, certain, [[low, high], _]) = dispatch(Level::Scalar, tested);
        let Ok([Some(root), ..]) = S::of(row).roots(&Ray::<Dyadic>::new(origin, direction)) else {
            return 0.0;
        };
        let (Ok(t), true) = (Dyadic::value(&root), certain & 1 != 0) else { return 0.0 };
        let middle = Dyadic::exact(low[0]).plus(&Dyadic::exact(high[0])).times(&Dyadic::exact(0.5));
        t.minus(&middle).split().0.abs() / (0.5 * (high[0] - low[0]))
    }

    /// The slack is that of 1-norms, of the worst signs of all terms, and a factor of two.
    #[test]
    fn bounds_on_eight_shapes_are_as_wide_as_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        for (far, of_sphere, of_disk) in [(3.0, 0.0515, 0.125), (1e4, 0.0735, 0.131)] {
            let line = |x: &[f64; 9]| {
                let origin = [-far * (1.0 + x[3]), x[4], x[5]];
                (origin, [far * (1.0 + 0.5 * x[6]), x[7] - 0.5, x[8] - 0.5])
            };
            let sphere = worst(6, 2000, draw, |x: &[f64; 9]| {
                let (origin, direction) = line(x);
                share::<Sphere, 4>([x[0], x[1], x[2], 1.0], origin, direction)
            });
            let disk = worst(6, 2000, draw, |x: &[f64; 9]| {
                let (origin, direction) = line(x);
                share::<Disk, 7>([x[0], 0.5, 0.5, 1e3, 1.0, x[1], x[2]], origin, direction)
            });
            assert_slack("sphere", sphere.0, of_sphere);
            assert_slack("disk", disk.0, of_disk);
        }
    }
}
