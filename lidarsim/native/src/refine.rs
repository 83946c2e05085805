//! The last look at the nearest triangle, with twice the digits of float64.

use crate::number::UNIT;
use crate::scene::{Hit, Place, Scene, Search};
use crate::shapes::Triangle;
use crate::simd::{Floats, Isa, lanes};
use crate::trace::Sink;

/// Hits on triangles that were not moved, to be refined eight at a time. They wait until as many others have come, while their vertices do.
pub struct Batch {
    halves: [Pending; 2],
    /// Which half hits come to.
    coming: usize,
}

const PENDING: usize = 16;

struct Pending {
    count: usize,
    at: [u32; PENDING],
    place: [Place; PENDING],
    /// By axis.
    origin: [[f64; PENDING]; 3],
    direction: [[f64; PENDING]; 3],
}

impl Batch {
    pub fn new() -> Self {
        Batch { halves: [Pending::new(), Pending::new()], coming: 0 }
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
        scene.objects()[place.object as usize].prefetch::<I>(place.primitive);
        let coming = &mut self.halves[self.coming];
        let k = coming.count;
        (coming.at[k], coming.place[k]) = (at, place);
        for axis in 0..3 {
            coming.origin[axis][k] = search.origin[axis];
            coming.direction[axis][k] = search.direction[axis];
        }
        coming.count += 1;
        if coming.count == PENDING {
            self.coming = 1 - self.coming;
            self.halves[self.coming].flush::<I>(scene, hits);
        }
    }

    #[inline(always)]
    pub fn flush<I: Isa>(&mut self, scene: &Scene, hits: &mut (impl Sink + ?Sized)) {
        for half in &mut self.halves {
            half.flush::<I>(scene, hits);
        }
    }
}

impl Pending {
    fn new() -> Self {
        Pending {
            count: 0,
            at: [0; PENDING],
            place: [Place::of_triangle(0, 0); PENDING],
            origin: [[0.0; PENDING]; 3],
            direction: [[1.0; PENDING]; 3],
        }
    }

    #[inline(always)]
    fn flush<I: Isa>(&mut self, scene: &Scene, hits: &mut (impl Sink + ?Sized)) {
        // By vertex and axis. All are gathered before the first is read: what was just written is slow to read.
        let mut vertices = [[[1.0; PENDING]; 3]; 3];
        for k in 0..self.count {
            let place = &self.place[k];
            let Triangle(a, b, c) = scene.objects()[place.object as usize].triangle(place.primitive);
            for axis in 0..3 {
                vertices[0][axis][k] = a[axis];
                vertices[1][axis][k] = b[axis];
                vertices[2][axis][k] = c[axis];
            }
        }
        for start in (0..self.count).step_by(8) {
            self.refine::<I>(start, &vertices, scene, hits);
        }
        self.count = 0;
    }

    /// t = n·(a − o)/(n·d), n = (b − a) × (c − a), in pairs.
    ///
    /// The differences are exact. With A_i = |e₁ⱼe₂ₖ| + |e₁ₖe₂ⱼ|, the low part of a coordinate of n is at most 5u·A_i, from fewer than 10 roundings,
    /// and leaves out two products of u²·A_i in all: so the coordinate is off by less than 52u²·A_i. The low part of n·(a − o) is at most
    /// 12u·ΣA_i|r_i|, from fewer than 16 roundings, and leaves out 5u²·ΣA_i|r_i|: with what n is off, less than 250u²·ΣA_i|r_i|. For n·d it is
    /// less. 320 covers the roundings of these bounds.
    ///
    /// T ≈ t is corrected by its residual ρ = n·(a − o) − T·(n·d), of which N − T·D is exact by Sterbenz's lemma while T is within a factor of two
    /// of N/D. The roundings of ρ, of the quotient and of 1/(n·d) are less than 16u of the larger parts, which are |ρ| and the low parts.
    #[inline(always)]
    fn refine<I: Isa>(
        &self,
        start: usize,
        vertices: &[[[f64; PENDING]; 3]; 3],
        scene: &Scene,
        hits: &mut (impl Sink + ?Sized),
    ) {
        let lanes = start..self.count.min(start + 8);
        let [a, b, c] = vertices;
        let (a, b, c) = (eight::<I>(a, start), eight::<I>(b, start), eight::<I>(c, start));
        let (o, d) = (eight::<I>(&self.origin, start), eight::<I>(&self.direction, start));
        let (e1, e2, r) = (Pair::<I>::differences(b, a), Pair::<I>::differences(c, a), Pair::<I>::differences(a, o));
        let (n0, s0) = Pair::minor(e1[1], e2[2], e1[2], e2[1]);
        let (n1, s1) = Pair::minor(e1[2], e2[0], e1[0], e2[2]);
        let (n2, s2) = Pair::minor(e1[0], e2[1], e1[1], e2[0]);
        let (n, size) = ([n0, n1, n2], [s0, s1, s2]);
        let (num, den) = (Pair::dot(n, r), Pair::dot_plain(n, d));

        let unit = I::F64x8::splat(UNIT);
        let unit2 = I::F64x8::splat(320.0 * UNIT * UNIT);
        let (num_high, den_high) = (num.high.add(num.low), den.high.add(den.low));
        let inverse = I::F64x8::splat(1.0).div(den_high);
        let first = num_high.mul(inverse);
        let (p, q) = Pair::<I>::product(first, den.high);
        let lows = num.low.sub(first.mul(den.low));
        let correction = num.high.sub(p).sub(q).add(lows).mul(inverse);
        let t = Pair::<I>::fast(first, correction);

        let num_error = lanes::dot(size, [r[0].high.abs(), r[1].high.abs(), r[2].high.abs()]).mul(unit2);
        let den_error = lanes::dot(size, lanes::abs(d)).mul(unit2);
        let parts = num.low.abs().add(first.mul(den.low).abs()).add(first.mul(den.high).abs().mul(unit));
        let roundings = parts.mul(inverse).abs().add(correction.abs()).mul(I::F64x8::splat(16.0 * UNIT));
        let error = num_error.add(first.abs().mul(den_error)).mul(inverse).abs();
        let error = error.add(roundings).mul(I::F64x8::splat(1.0 + 1.0 / 16.0));
        // Rounding is monotone: where both ends of the error round to the same number, so does the truth.
        let up = t.high.add(t.low.add(error));
        let down = t.high.add(t.low.sub(error));
        // 2^±400: what underflow loses is far below the error while the numbers are ordinary. den is at least 128 times its error and its low part,
        // and num at least 8 times its low part, so that T is within 2 % of N/D and 20 % of the truth.
        let tiny = I::F64x8::splat(f64::from_bits((1023 - 400) << 52));
        let huge = I::F64x8::splat(f64::from_bits((1023 + 400) << 52));
        let (num_size, den_size) = (num_high.abs(), den_high.abs());
        let ordinary = tiny.lt(den_size)
            & den_size.lt(huge)
            & tiny.lt(num_size)
            & num_size.lt(huge)
            & den_error.add(den.low.abs()).mul(I::F64x8::splat(128.0)).lt(den_size)
            & num.low.abs().mul(I::F64x8::splat(8.0)).lt(num_size);
        let certain = ordinary & up.le(t.high) & t.high.le(down);

        let n = [n0.high.add(n0.low), n1.high.add(n1.low), n2.high.add(n2.low)];
        let square = lanes::dot(n, n);
        let length = square.sqrt();
        // The normal is right to 2⁻⁶⁰ of its length, and three roundings.
        let total = s0.add(s1).add(s2).mul(unit2).mul(I::F64x8::splat(2_f64.powi(60)));
        let fine = tiny.lt(square) & square.lt(huge) & total.lt(length);
        let shrink = I::F64x8::splat(1.0).div(length);
        let normal = [n[0].mul(shrink).store(), n[1].mul(shrink).store(), n[2].mul(shrink).store()];
        let t = t.high.store();
        for k in lanes {
            let (place, lane) = (&self.place[k], k - start);
            let object = &scene.objects()[place.object as usize];
            // No hit is put together first: to read back in one piece what was written in two takes long.
            if certain & fine & (1 << lane) != 0 {
                let normal = [normal[0][lane], normal[1][lane], normal[2][lane]];
                let primitive = object.reported(place);
                hits.put(self.at[k] as usize, Hit { t: t[lane], normal, object: place.object as i32, primitive });
            } else {
                let origin = [self.origin[0][k], self.origin[1][k], self.origin[2][k]];
                let direction = [self.direction[0][k], self.direction[1][k], self.direction[2][k]];
                hits.put(self.at[k] as usize, scene.hit(place, origin, direction));
            }
        }
    }
}

/// Eight of the vectors from `start`, a multiple of eight, on.
#[inline(always)]
fn eight<I: Isa>(v: &[[f64; PENDING]; 3], start: usize) -> V<I> {
    [
        I::F64x8::load(&v[0].as_chunks().0[start / 8]),
        I::F64x8::load(&v[1].as_chunks().0[start / 8]),
        I::F64x8::load(&v[2].as_chunks().0[start / 8]),
    ]
}

type V<I> = [<I as Isa>::F64x8; 3];

/// Sums high + low side by side that are not brought into a normal form: low is small beside the terms that made high (M. Lange, S. Rump,
/// Faithfully rounded floating-point computations, ACM TOMS 46, 2020).
#[derive(Clone, Copy)]
struct Pair<I: Isa> {
    high: I::F64x8,
    low: I::F64x8,
}

impl<I: Isa> Pair<I> {
    /// a − b, exactly, an axis each.
    #[inline(always)]
    fn differences(a: V<I>, b: V<I>) -> [Self; 3] {
        [Self::difference(a[0], b[0]), Self::difference(a[1], b[1]), Self::difference(a[2], b[2])]
    }

    /// a − b, exactly.
    #[inline(always)]
    fn difference(a: I::F64x8, b: I::F64x8) -> Self {
        let high = a.sub(b);
        let z = high.sub(a);
        Pair { high, low: a.sub(high.sub(z)).sub(b.add(z)) }
    }

    /// a + b, exactly.
    #[inline(always)]
    fn sum(a: I::F64x8, b: I::F64x8) -> Self {
        let high = a.add(b);
        let z = high.sub(a);
        Pair { high, low: a.sub(high.sub(z)).add(b.sub(z)) }
    }

    /// a + b, exactly, for |a| ≥ |b|.
    #[inline(always)]
    fn fast(a: I::F64x8, b: I::F64x8) -> Self {
        let high = a.add(b);
        Pair { high, low: b.sub(high.sub(a)) }
    }

    /// a·b, exactly.
    #[inline(always)]
    fn product(a: I::F64x8, b: I::F64x8) -> (I::F64x8, I::F64x8) {
        let p = a.mul(b);
        (p, a.mul_add(b, I::F64x8::splat(0.0).sub(p)))
    }

    /// p·q − r·s, and |p·q| + |r·s|.
    #[inline(always)]
    fn minor(p: Self, q: Self, r: Self, s: Self) -> (Self, I::F64x8) {
        let (a, a_low) = Self::product(p.high, q.high);
        let (b, b_low) = Self::product(r.high, s.high);
        let Pair { high, low } = Self::difference(a, b);
        let first = p.low.mul_add(q.high, p.high.mul_add(q.low, a_low));
        let second = r.low.mul_add(s.high, r.high.mul_add(s.low, b_low));
        (Pair { high, low: low.add(first.sub(second)) }, a.abs().add(b.abs()))
    }

    #[inline(always)]
    fn dot(a: [Self; 3], b: [Self; 3]) -> Self {
        let (x, x_low) = Self::product(a[0].high, b[0].high);
        let (y, y_low) = Self::product(a[1].high, b[1].high);
        let (z, z_low) = Self::product(a[2].high, b[2].high);
        let x_low = a[0].low.mul_add(b[0].high, a[0].high.mul_add(b[0].low, x_low));
        let y_low = a[1].low.mul_add(b[1].high, a[1].high.mul_add(b[1].low, y_low));
        let z_low = a[2].low.mul_add(b[2].high, a[2].high.mul_add(b[2].low, z_low));
        Self::sum_of_three((x, y, z), (x_low, y_low, z_low))
    }

    #[inline(always)]
    fn dot_plain(a: [Self; 3], b: V<I>) -> Self {
        let (x, x_low) = Self::product(a[0].high, b[0]);
        let (y, y_low) = Self::product(a[1].high, b[1]);
        let (z, z_low) = Self::product(a[2].high, b[2]);
        let x_low = a[0].low.mul_add(b[0], x_low);
        let y_low = a[1].low.mul_add(b[1], y_low);
        let z_low = a[2].low.mul_add(b[2], z_low);
        Self::sum_of_three((x, y, z), (x_low, y_low, z_low))
    }

    #[inline(always)]
    fn sum_of_three(
        (x, y, z): (I::F64x8, I::F64x8, I::F64x8),
        (x_low, y_low, z_low): (I::F64x8, I::F64x8, I::F64x8),
    ) -> Self {
        let xy = Self::sum(x, y);
        let all = Self::sum(xy.high, z);
        Pair { high: all.high, low: xy.low.add(all.low).add(x_low.add(y_low).add(z_low)) }
    }
}
