//! The double-double look at the nearest triangle.

use crate::number::UNIT;
use crate::scene::{Hit, Place, Scene, Search};
use crate::shapes::Triangle;
use crate::simd::{Floats, Isa, lanes};
use crate::trace::Sink;
use crate::vector::Point;

/// Hits on triangles that were not moved, to be refined eight at a time.
pub struct Batch {
    count: usize,
    at: [u32; 8],
    place: [Place; 8],
    ray: [(Point, Point); 8],
}

impl Batch {
    pub fn new() -> Self {
        Batch { count: 0, at: [0; 8], place: [Place::of_triangle(0, 0); 8], ray: [([0.0; 3], [0.0; 3]); 8] }
    }

    #[inline(always)]
    pub fn push<I: Isa>(
        &mut self,
        scene: &Scene,
        at: u32,
        place: Place,
        search: &Search,
        hits: &mut (impl Sink + ?Sized),
    ) {
        let lane = self.count;
        self.ray[lane] = (search.origin, search.direction);
        (self.at[lane], self.place[lane]) = (at, place);
        self.count += 1;
        if self.count == 8 {
            self.flush::<I>(scene, hits);
        }
    }

    /// t in double-double: t = n·(a − o)/(n·d), n = (b − a) × (c − a).
    ///
    /// The differences are exact as double-doubles. With A_i = |e₁ⱼe₂ₖ| + |e₁ₖe₂ⱼ|, a coordinate of n is off by 8.1u²·A_i (two products of 5u²
    /// and a sum of 3u² relative to it), so n·(a − o) by less than 20u²·ΣA_i|r_i|, and n·d likewise (see `number::dd` for the bounds of the
    /// operations). 32 covers the roundings of these bounds. The quotient adds 16u² of itself.
    #[inline(always)]
    pub fn flush<I: Isa>(&mut self, scene: &Scene, hits: &mut (impl Sink + ?Sized)) {
        if self.count == 0 {
            return;
        }
        // Vertices, origin and direction, by axis and lane.
        let mut points = [[[1.0; 8]; 3]; 5];
        for lane in 0..self.count {
            let place = &self.place[lane];
            let Triangle(a, b, c) = scene.objects()[place.object as usize].triangle(place.primitive);
            let (o, d) = self.ray[lane];
            for (points, p) in points.iter_mut().zip([a, b, c, o, d]) {
                for axis in 0..3 {
                    points[axis][lane] = p[axis];
                }
            }
        }
        let [a, b, c, o, d] = &points;
        let (a, b, c): (V<I>, V<I>, V<I>) = (lanes::load(a), lanes::load(b), lanes::load(c));
        let (o, d): (V<I>, V<I>) = (lanes::load(o), lanes::load(d));
        let (e1, e2, r) = (Dd::<I>::differences(b, a), Dd::<I>::differences(c, a), Dd::<I>::differences(a, o));
        let (n0, s0) = Dd::minor(e1[1], e2[2], e1[2], e2[1]);
        let (n1, s1) = Dd::minor(e1[2], e2[0], e1[0], e2[2]);
        let (n2, s2) = Dd::minor(e1[0], e2[1], e1[1], e2[0]);
        let num = n0.times(r[0]).plus(n1.times(r[1])).plus(n2.times(r[2]));
        let den = n0.scaled(d[0]).plus(n1.scaled(d[1])).plus(n2.scaled(d[2]));
        let t = num.over(den);

        let unit2 = UNIT * UNIT;
        let size = [s0, s1, s2];
        let num_error =
            lanes::dot(size, [r[0].high.abs(), r[1].high.abs(), r[2].high.abs()]).mul(I::F64x8::splat(32.0 * unit2));
        let den_error = lanes::dot(size, lanes::abs(d)).mul(I::F64x8::splat(32.0 * unit2));
        let error = num_error.add(t.high.abs().mul(den_error)).div(den.high.abs());
        let error = error.mul(I::F64x8::splat(1.0 + 1.0 / 64.0)).add(t.high.abs().mul(I::F64x8::splat(20.0 * unit2)));
        // Rounding is monotone: where both ends of the error round to the same number, so does the truth.
        let up = t.high.add(t.low.add(error));
        let down = t.high.add(t.low.sub(error));
        // 2^±400: what underflow loses is far below the error while the numbers are ordinary; den is at least twice its error.
        let tiny = I::F64x8::splat(f64::from_bits((1023 - 400) << 52));
        let huge = I::F64x8::splat(f64::from_bits((1023 + 400) << 52));
        let den_high = den.high.abs();
        let ordinary = tiny.lt(den_high)
            & den_high.lt(huge)
            & tiny.lt(num.high.abs())
            & num.high.abs().lt(huge)
            & den_error.mul(I::F64x8::splat(128.0)).lt(den_high);
        let certain = ordinary & up.le(t.high) & t.high.le(down);

        let n = [n0.high, n1.high, n2.high];
        let square = lanes::dot(n, n);
        let length = square.sqrt();
        // The normal is right to 2⁻⁶⁰ of its length.
        let total = s0.add(s1).add(s2).mul(I::F64x8::splat(16.0 * unit2 * 2_f64.powi(60)));
        let fine = tiny.lt(square) & square.lt(huge) & total.lt(length);
        let normal = [n[0].div(length).store(), n[1].div(length).store(), n[2].div(length).store()];
        let t = t.high.store();
        for lane in 0..self.count {
            let place = &self.place[lane];
            let object = &scene.objects()[place.object as usize];
            let (origin, direction) = self.ray[lane];
            let hit = if certain & fine & (1 << lane) != 0 {
                let normal = [normal[0][lane], normal[1][lane], normal[2][lane]];
                Hit { t: t[lane], normal, object: place.object as i32, primitive: object.reported(place) }
            } else {
                scene.hit(place, origin, direction)
            };
            hits.put(self.at[lane] as usize, hit);
        }
        self.count = 0;
    }
}

type V<I> = [<I as Isa>::F64x8; 3];

/// Double-doubles side by side; the algorithms of `number::dd` without the running bound.
#[derive(Clone, Copy)]
struct Dd<I: Isa> {
    high: I::F64x8,
    low: I::F64x8,
}

impl<I: Isa> Dd<I> {
    /// a − b, exactly, an axis each.
    #[inline(always)]
    fn differences(a: V<I>, b: V<I>) -> [Self; 3] {
        [Self::difference(a[0], b[0]), Self::difference(a[1], b[1]), Self::difference(a[2], b[2])]
    }

    /// p·q − r·s, and |p·q| + |r·s|.
    #[inline(always)]
    fn minor(p: Self, q: Self, r: Self, s: Self) -> (Self, I::F64x8) {
        let (first, second) = (p.times(q), r.times(s));
        (first.minus(second), first.high.abs().add(second.high.abs()))
    }

    /// a − b, exactly.
    #[inline(always)]
    fn difference(a: I::F64x8, b: I::F64x8) -> Self {
        let high = a.sub(b);
        let z = high.sub(a);
        Dd { high, low: a.sub(high.sub(z)).sub(b.add(z)) }
    }

    /// a + b, exactly, for |a| ≥ |b|.
    #[inline(always)]
    fn fast(a: I::F64x8, b: I::F64x8) -> Self {
        let high = a.add(b);
        Dd { high, low: b.sub(high.sub(a)) }
    }

    #[inline(always)]
    fn two_sum(a: I::F64x8, b: I::F64x8) -> Self {
        let high = a.add(b);
        let z = high.sub(a);
        Dd { high, low: a.sub(high.sub(z)).add(b.sub(z)) }
    }

    #[inline(always)]
    fn negated(self) -> Self {
        let zero = I::F64x8::splat(0.0);
        Dd { high: zero.sub(self.high), low: zero.sub(self.low) }
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        let s = Self::two_sum(self.high, other.high);
        let t = Self::two_sum(self.low, other.low);
        let v = Self::fast(s.high, s.low.add(t.high));
        Self::fast(v.high, t.low.add(v.low))
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.plus(other.negated())
    }

    #[inline(always)]
    fn product(a: I::F64x8, b: I::F64x8) -> (I::F64x8, I::F64x8) {
        let p = a.mul(b);
        (p, a.mul_add(b, I::F64x8::splat(0.0).sub(p)))
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        let (p, e) = Self::product(self.high, other.high);
        let cross = self.low.mul_add(other.high, self.high.mul_add(other.low, self.low.mul(other.low)));
        Self::fast(p, e.add(cross))
    }

    /// DWTimesFP3 (Algorithm 9, 2u²).
    #[inline(always)]
    fn scaled(self, x: I::F64x8) -> Self {
        let (p, e) = Self::product(self.high, x);
        Self::fast(p, self.low.mul_add(x, e))
    }

    #[inline(always)]
    fn over(self, b: Self) -> Self {
        let t = self.high.div(b.high);
        let (p, e) = Self::product(b.high, t);
        let r = Self::fast(p, b.low.mul_add(t, e));
        let delta = self.high.sub(r.high).add(self.low.sub(r.low));
        Self::fast(t, delta.div(b.high))
    }
}
