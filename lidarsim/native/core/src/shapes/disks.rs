//! Many disks, each defined by its centre, radius and normal.

use super::disk::Disk;
use super::each::{Each, EachCrossings, EachRay};
use crate::arith::number::{Interval, Lanes, Number, OfRays, UNIT};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

/// Eight disks as seen from an origin.
pub struct SeenDisks<I: Isa> {
    /// f and m of `Each`.
    from: [I::F64x8; 3],
    size: I::F64x8,
    radius: I::F64x8,
    /// n, and ν = |n|₁.
    normal: [I::F64x8; 3],
    steepness: I::F64x8,
}

/// How a ray passes the centres of disks.
struct Passage<F> {
    /// |q|², q = n × (f × d).
    square: F,
    /// An upper bound of the error of q.
    off: F,
    /// s = n·d, and an upper bound of its error.
    slope: F,
    slope_error: F,
}

impl<I: Isa> SeenDisks<I> {
    /// With s = n·d, the line meets the plane at s·f − (n·f)·d = q relative to the centre, times s, so it
    /// meets the disk iff |q| ≤ r·|s|.
    ///
    /// With g = f × d, the products and differences of q round by less than 3u·ν·|g|₁, and the error of g
    /// adds ν·E: together less than Q = ν·(4u·|g|₁ + E) + the smallest normal number. The slope rounds by
    /// 3u·ν·L and is off by ν·ε_d: together less than S = ν·(4u·L + 4ε_d) + that number.
    #[inline(always)]
    fn passage(&self, ray: &EachRay) -> Passage<I::F64x8> {
        let (d, least) = (lanes::splat::<I::F64x8, 8>(ray.direction), I::F64x8::splat(f64::MIN_POSITIVE));
        let (turned, moved) = (I::F64x8::splat(ray.turned), I::F64x8::splat(ray.moved));
        let g = lanes::fused_cross(self.from, d);
        let [x, y, z] = lanes::abs(g);
        let error = self.size.fused(turned, moved);
        let error = x.add(y).add(z).fused(I::F64x8::splat(4.0 * UNIT), error);
        let q = lanes::fused_cross(self.normal, g);
        Passage {
            square: lanes::fused_dot(q, q),
            off: self.steepness.fused(error, least),
            slope: lanes::fused_dot(self.normal, d),
            slope_error: self.steepness.fused(turned, least),
        }
    }
}

impl Each<7> for Disk {
    const ROOTS: usize = 1;

    type Seen<I: Isa> = SeenDisks<I>;

    type Numbers<N> = (Vector<N>, Vector<N>);

    fn of([x, y, z, radius, i, j, k]: [f64; 7]) -> Self {
        Disk { center: [x, y, z], normal: [i, j, k], radius }
    }

    #[inline(always)]
    fn seen_from<I: Isa>(origin: Point, [x, y, z, r, i, j, k]: &[[f64; 8]; 7]) -> SeenDisks<I> {
        let o = lanes::splat::<I::F64x8, 8>(origin);
        let from = [o[0].sub(I::F64x8::load(x)), o[1].sub(I::F64x8::load(y)), o[2].sub(I::F64x8::load(z))];
        let normal = [I::F64x8::load(i), I::F64x8::load(j), I::F64x8::load(k)];
        let ([x, y, z], [i, j, k]) = (lanes::abs(from), lanes::abs(normal));
        let (size, steepness) = (x.add(y).add(z), i.add(j).add(k));
        SeenDisks { from, size, radius: I::F64x8::load(r), normal, steepness }
    }

    /// All where |q| ≤ r·(|s| + S) + Q.
    #[inline(always)]
    fn candidates<I: Isa>(seen: &SeenDisks<I>, ray: &EachRay) -> u32 {
        let Passage { square, off, slope, slope_error } = seen.passage(ray);
        let most = seen.radius.fused(slope.abs().add(slope_error), off);
        let factor = I::F64x8::splat(1.0 + 16.0 * UNIT);
        let most = most.mul(most).fused(factor, I::F64x8::splat(f64::MIN_POSITIVE));
        !most.lt(square) & 0xff
    }

    /// t = −n·f/s.
    ///
    /// The disk is certainly met if |q| ≤ r·(|s| − S) − Q: both terms and the difference round by less than
    /// 8u of r·(|s| + S) + Q. The height n·f rounds by 3u·ν·m, that of f included by 4u·ν·m, and is off by
    /// ν·ε, so t by at most (ν·(5u·m + ε) + |t|·S)/(|s| − S) and its own roundings; S ≤ |s|/2 is tested, and
    /// the factor of two covers that and the terms of second order.
    #[inline(always)]
    fn crossings<I: Isa>(seen: &SeenDisks<I>, ray: &EachRay) -> EachCrossings<I> {
        let Passage { square, off, slope, slope_error } = seen.passage(ray);
        let (zero, least) = (I::F64x8::splat(0.0), I::F64x8::splat(f64::MIN_POSITIVE));
        let (steep, two) = (slope.abs(), I::F64x8::splat(2.0));
        let most = seen.radius.fused(steep.add(slope_error), off);
        let sure =
            seen.radius.mul(steep.sub(slope_error)).sub(off).sub(most.mul(I::F64x8::splat(8.0 * UNIT)));
        let inside = square.fused(I::F64x8::splat(1.0 + 16.0 * UNIT), least).lt(sure.mul(sure));
        let inverse = I::F64x8::splat(1.0).div(slope);
        let height = lanes::fused_dot(seen.normal, seen.from).negated();
        let t = height.mul(inverse);
        let size = seen.size.fused(I::F64x8::splat(5.0 * UNIT), I::F64x8::splat(2.0 * ray.off));
        let height_error = seen.steepness.fused(size, least);
        let error = t.abs().fused(slope_error, height_error).mul(inverse.abs()).mul(two);
        let error = t.abs().fused(I::F64x8::splat(8.0 * UNIT), error).add(least);
        let certain = inside
            & zero.lt(sure)
            & slope_error.add(slope_error).le(steep)
            & error.lt(I::F64x8::splat(f64::INFINITY));
        let t = Interval { low: t.sub(error), high: t.add(error) };
        EachCrossings { certain, t: [t; 2] }
    }

    #[inline(always)]
    fn of_rays<N: OfRays<L, M>, L: Lanes<M>, const M: usize>(
        [x, y, z, _, i, j, k]: &[L::Floats; 7],
        lanes: L,
    ) -> (Vector<N>, Vector<N>) {
        (vector::of_rays([*x, *y, *z], lanes), vector::of_rays([*i, *j, *k], lanes))
    }

    #[inline(always)]
    fn implicit_of<N: Number>((center, normal): (Vector<N>, Vector<N>), ray: &Ray<N>) -> N {
        vector::dot(&normal, &ray.origin_from(center)).doubled()
    }

    #[inline(always)]
    fn normal_of<N: Number>((_, normal): (Vector<N>, Vector<N>), _: &Ray<N>) -> Vector<N> {
        normal
    }
}
