//! Many spheres, each defined by its centre and radius.

use super::each::{Each, EachCrossings, EachRay};
use super::sphere::Sphere;
use crate::arith::number::{Interval, Lanes, Number, OfRays, UNIT};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

/// Eight spheres as seen from an origin.
pub struct SeenSpheres<I: Isa> {
    /// f and m of `Each`.
    from: [I::F64x8; 3],
    size: I::F64x8,
    /// r² and 2r.
    square: I::F64x8,
    diameter: I::F64x8,
}

/// f × d, squared, and upper bounds: of E·(2r·|d| + E), and of that plus r²·|d|².
struct Distance<F> {
    square: F,
    margin: F,
    most: F,
}

impl<I: Isa> SeenSpheres<I> {
    /// A line meets a sphere iff |f × d| ≤ r·|d|, so |f × d|² ≤ r²·|d|² + E·(2r·|d| + E) as computed there.
    #[inline(always)]
    fn distance(&self, ray: &EachRay, error: I::F64x8) -> Distance<I::F64x8> {
        let g = lanes::fused_cross(self.from, lanes::splat(ray.direction));
        let margin = error.mul(self.diameter.fused(I::F64x8::splat(ray.length), error));
        let most = self.square.fused(I::F64x8::splat(ray.square + ray.square_error), margin);
        Distance { square: lanes::fused_dot(g, g), margin, most }
    }

    #[inline(always)]
    fn error(&self, ray: &EachRay) -> I::F64x8 {
        self.size.fused(I::F64x8::splat(ray.turned), I::F64x8::splat(ray.moved))
    }
}

impl Each<4> for Sphere {
    const ROOTS: usize = 2;

    type Seen<I: Isa> = SeenSpheres<I>;

    type Numbers<N> = (Vector<N>, N);

    fn of([x, y, z, radius]: [f64; 4]) -> Self {
        Sphere { center: [x, y, z], radius }
    }

    #[inline(always)]
    fn seen_from<I: Isa>(origin: Point, [x, y, z, r]: &[[f64; 8]; 4]) -> SeenSpheres<I> {
        let o = lanes::splat::<I::F64x8, 8>(origin);
        let from = [o[0].sub(I::F64x8::load(x)), o[1].sub(I::F64x8::load(y)), o[2].sub(I::F64x8::load(z))];
        let [x, y, z] = lanes::abs(from);
        let r = I::F64x8::load(r);
        SeenSpheres { from, size: x.add(y).add(z), square: r.mul(r), diameter: r.add(r) }
    }

    #[inline(always)]
    fn candidates<I: Isa>(seen: &SeenSpheres<I>, ray: &EachRay) -> u32 {
        let Distance { square, most, .. } = seen.distance(ray, seen.error(ray));
        let most = most.fused(I::F64x8::splat(1.0 + 16.0 * UNIT), I::F64x8::splat(f64::MIN_POSITIVE));
        !most.lt(square) & 0xff
    }

    /// t = (b ∓ √disc)/|d|², b = −f·d, disc = r²·|d|² − |f × d|².
    ///
    /// Of a sphere that may be met, disc is off by at most D = 16u·(r²·|d|² + …) + 3E·(2r·|d| + E), as |f ×
    /// d| ≤ r·|d| + E, and by the error of |d|². If disc > D the line meets the sphere twice, and √disc is
    /// off by D/√disc and its rounding, b by E. The true |d|² is at least ¾ of the computed one, which is
    /// tested, so a factor of two covers that and the terms of second order.
    #[inline(always)]
    fn crossings<I: Isa>(seen: &SeenSpheres<I>, ray: &EachRay) -> EachCrossings<I> {
        let error = seen.error(ray);
        let Distance { square, margin, most } = seen.distance(ray, error);
        let three = margin.fused(I::F64x8::splat(3.0), I::F64x8::splat(f64::MIN_POSITIVE));
        let bent = seen.square.fused(I::F64x8::splat(ray.square_error), three);
        let disc_error = most.fused(I::F64x8::splat(16.0 * UNIT), bent);
        let disc = seen.square.mul(I::F64x8::splat(ray.square)).sub(square);
        let root = disc.sqrt();
        let b = lanes::fused_dot(seen.from, lanes::splat(ray.direction)).negated();
        let inverse = 1.0 / ray.square;
        // Twice the error of the numerator over |d|², and of the quotient as a share of t.
        let off = disc_error.div(root).add(error);
        let off = b.abs().add(root).fused(I::F64x8::splat(4.0 * UNIT), off);
        let off = off.fused(I::F64x8::splat(2.0 * inverse), I::F64x8::splat(f64::MIN_POSITIVE));
        let share = I::F64x8::splat(2.0 * (ray.square_error * inverse + 8.0 * UNIT));
        let within = ray.square_error <= 0.25 * ray.square;
        let (first, second) = (b.sub(root), b.add(root));
        let (first, second) = (first.mul(I::F64x8::splat(inverse)), second.mul(I::F64x8::splat(inverse)));
        let offs = [first.abs().fused(share, off), second.abs().fused(share, off)];
        let infinity = I::F64x8::splat(f64::INFINITY);
        let certain = disc_error.lt(disc) & offs[0].lt(infinity) & offs[1].lt(infinity);
        let t = [
            Interval { low: first.sub(offs[0]), high: first.add(offs[0]) },
            Interval { low: second.sub(offs[1]), high: second.add(offs[1]) },
        ];
        EachCrossings { certain: if within { certain } else { 0 }, t }
    }

    #[inline(always)]
    fn of_rays<N: OfRays<L, M>, L: Lanes<M>, const M: usize>(
        [x, y, z, radius]: &[L::Floats; 4],
        lanes: L,
    ) -> (Vector<N>, N) {
        (vector::of_rays([*x, *y, *z], lanes), N::of_rays(*radius, lanes))
    }

    #[inline(always)]
    fn implicit_of<N: Number>((center, radius): (Vector<N>, N), ray: &Ray<N>) -> N {
        vector::norm2(&ray.origin_from(center)).minus(&ray.weighted(radius).squared())
    }

    #[inline(always)]
    fn normal_of<N: Number>((center, _): (Vector<N>, N), ray: &Ray<N>) -> Vector<N> {
        ray.origin_from(center)
    }
}
