//! The signs of U, V, W (Woop et al.) for one ray and triangle per lane, by expansions: an orientation filter
//! like Shewchuk's stage B.

use std::cmp::Ordering;

use super::crossing::{BOUND, from_origin};
use super::volume;
use crate::arith::expansion::{Expansion, V};
use crate::arith::number::{Dyadic, Number, UNIT, Uncertain};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point};
use crate::stop;

/// The signs of the volumes d·(c × b), d·(a × c), d·(b × a), as in `Triangle`.
pub struct Sides {
    signs: [Side; 3],
    /// Lanes whose numbers are zero or between 2^±200 in size; the results of other lanes are unknown.
    ordinary: u32,
}

impl Sides {
    /// The lanes whose ray certainly hits its triangle, and those whose ray certainly misses it. If all three
    /// are zero, the ray lies in the plane of the triangle, or the triangle has no area: a miss.
    #[inline(always)]
    pub fn hit_and_missed(&self) -> (u32, u32) {
        let [u, v, w] = &self.signs;
        let (below, above) = (u.below | v.below | w.below, u.above | v.above | w.above);
        let known = u.certain() & v.certain() & w.certain();
        (self.ordinary & known & (below ^ above), self.ordinary & (below & above | known & !(below | above)))
    }

    /// The lanes that `decide` can settle.
    #[inline(always)]
    pub fn unsure(&self) -> u32 {
        let (hit, missed) = self.hit_and_missed();
        self.ordinary & !(hit | missed)
    }

    /// Decides the unknown signs of a lane in exact arithmetic.
    #[cold]
    #[inline(never)]
    pub fn decide(&mut self, lane: usize, corners: [&Point; 3], ray: &Ray<Dyadic>) {
        stop::poll();
        let [a, b, c] = &corners.map(|corner| vector::negated(&ray.origin_from(vector::exact(*corner))));
        for (side, (p, q)) in self.signs.iter_mut().zip([(c, b), (a, c), (b, a)]) {
            if side.certain() >> lane & 1 == 0 {
                match volume(&ray.direction, p, q).sign() {
                    Ok(Ordering::Less) => side.below |= 1 << lane,
                    Ok(Ordering::Greater) => side.above |= 1 << lane,
                    Ok(Ordering::Equal) | Err(Uncertain) => side.zero |= 1 << lane,
                }
            }
        }
    }
}

/// The sides of rays and triangles, where they are certain.
///
/// As an expansion each is accurate to `BOUND`·S, with S = Σ(|pⱼqₖ| + |pₖqⱼ|)·|d_i|, like n·d in
/// `Crossing`. Underflow remains: all given numbers are zero or between 2^±200, so differences are zero or
/// at least 2⁻²⁵². Then S, if not zero, is at least 2⁻⁷⁰⁴, and u²·S is far above the loss to
/// underflow; if S is zero, so is the volume.
///
/// Coordinates of the origin may be smaller than that, as of rays next to a plane; see `Nudge`.
#[inline(always)]
pub fn sides<I: Isa>(corners: [V<I>; 3], o: V<I>, d: V<I>) -> Sides {
    let [a, b, c] = corners;
    let (o, nudge) = Nudge::<I>::of(o);
    let ordinary =
        ordinary::<I>(a) & ordinary::<I>(b) & ordinary::<I>(c) & ordinary::<I>(o) & ordinary::<I>(d);
    let (a, b, c) = (
        Expansion::<I>::vector_diff(a, o),
        Expansion::<I>::vector_diff(b, o),
        Expansion::<I>::vector_diff(c, o),
    );
    let volumes = [volume_of::<I>(c, b, d), volume_of::<I>(a, c, d), volume_of::<I>(b, a, d)];
    let signs = match nudge {
        None => [Side::of::<I>(volumes[0]), Side::of::<I>(volumes[1]), Side::of::<I>(volumes[2])],
        Some(nudge) => nudge.sides(volumes, corners, d),
    };
    Sides { signs, ordinary }
}

/// Coordinates of origins below 2⁻²⁰⁰, times 2⁶⁰⁰; the others are zero here.
///
/// The volume of p and q is affine in the origin: without these coordinates, v·2⁻⁶⁰⁰, it is V, and
/// with them V + d·(v × (p − q))·2⁻⁶⁰⁰. The triple product, of ordinary corners and an ordinary
/// direction, has factors of at least 2⁻⁴⁷⁴, 2⁻²⁵² and 2⁻²⁰⁰, so nothing underflows; six
/// roundings are less than 8u of R, the sum of the absolute values of its terms, and `Nudge::sides` takes
/// 16u. If V is not zero, it has the sign of the sum as soon as it exceeds its own error and
/// 2R·2⁻⁶⁰⁰, which bounds the change. If S = 0, V is zero, and the triple product alone has the
/// sign.
struct Nudge<I: Isa>(V<I>);

impl<I: Isa> Nudge<I> {
    /// The origins without tiny coordinates, and these, if there are any.
    #[inline(always)]
    fn of(o: V<I>) -> (V<I>, Option<Self>) {
        let (zero, least) = (I::F64x8::splat(0.0), I::F64x8::splat(LEAST_ORDINARY));
        let (mut kept, mut tiny, mut any) = (o, [zero; 3], 0);
        for axis in 0..3 {
            let size = o[axis].abs();
            let is_tiny = size.lt(least) & zero.lt(size);
            any |= is_tiny;
            kept[axis] = I::pick(is_tiny, zero, o[axis]);
            tiny[axis] = I::pick(is_tiny, o[axis].mul(I::F64x8::splat(1.0 / NUDGE)), zero);
        }
        (kept, if any != 0 { Some(Nudge(tiny)) } else { None })
    }

    /// The signs of volumes and their bounds, as of `volume_of` without the nudge.
    #[inline(always)]
    fn sides(&self, volumes: [(I::F64x8, I::F64x8); 3], [a, b, c]: [V<I>; 3], d: V<I>) -> [Side; 3] {
        let [u, v, w] = volumes;
        [
            self.side(u, lanes::sub(c, b), d),
            self.side(v, lanes::sub(a, c), d),
            self.side(w, lanes::sub(b, a), d),
        ]
    }

    #[inline(always)]
    fn side(&self, (volume, bound): (I::F64x8, I::F64x8), edge: V<I>, d: V<I>) -> Side {
        let zero = I::F64x8::splat(0.0);
        let (change, size) = self.change(edge, d);
        // What underflows here is less than the least normal number.
        let most = size.mul(I::F64x8::splat(2.0 * NUDGE)).add(I::F64x8::splat(f64::MIN_POSITIVE));
        let (is_moved, is_zero) = (zero.lt(size), bound.le(zero));
        let side = Side::of::<I>((volume, bound.add(I::pick(is_moved, most, zero))));
        let off = size.mul(I::F64x8::splat(CHANGE));
        Side {
            below: side.below | is_zero & change.lt(off.negated()),
            zero: side.zero,
            above: side.above | is_zero & off.lt(change),
        }
    }
}

impl<I: Isa> Nudge<I> {
    /// d·(v × edge), and R.
    #[inline(always)]
    fn change(&self, edge: V<I>, d: V<I>) -> (I::F64x8, I::F64x8) {
        let [x, y, z] = lanes::abs(self.0);
        let [e, f, g] = lanes::abs(edge);
        let sizes = [y.mul(g).add(z.mul(f)), z.mul(e).add(x.mul(g)), x.mul(f).add(y.mul(e))];
        (lanes::dot(d, lanes::cross(self.0, edge)), lanes::dot(lanes::abs(d), sizes))
    }
}

/// The error of a change of a volume, relative to R.
const CHANGE: f64 = 16.0 * UNIT;

/// 2⁻⁶⁰⁰.
const NUDGE: f64 = f64::from_bits((1023 - 600) << 52);
/// As `sides`, for triangles that are placed, and the rays in their coordinates, as of
/// `ExpandedInverse::points` and `vectors`.
///
/// A corner less the origin, of size P, has a low part of at most 7u·P and is off by 187u²·P
/// (`TrianglePlane::of_placed`). So the low part of a minor of two corners of sizes P and Q, with
/// A = PⱼQₖ + PₖQⱼ, is at most 16u·A; it rounds by 54u²·A, omits the products of low parts,
/// 49u²·A, and its terms are off by 374u²·A: less than 480u²·A in all. In its product with d,
/// whose low part is at most 6u and whose error 180u² of its size D, S = ΣA_iD_i, the low part is
/// at most 26u·S, its roundings come to 104u²·S, low parts omit 96u²·S, and with the errors of
/// minors and d that is less than 870u²·S. `BOUND` is taken three times, which is 960u². What
/// underflows loses less than `LEAST`, as d is less than 2³⁰⁰.
#[inline(always)]
pub fn placed_sides<I: Isa>(
    [a, b, c]: [V<I>; 3],
    o: ([Expansion<I>; 3], V<I>),
    d: ([Expansion<I>; 3], V<I>),
) -> Sides {
    let (a, b, c) = (from_origin::<I>(a, o), from_origin::<I>(b, o), from_origin::<I>(c, o));
    let signs = [placed_side::<I>(c, b, d), placed_side::<I>(a, c, d), placed_side::<I>(b, a, d)];
    Sides { signs, ordinary: 0xff }
}

/// 2⁻⁷⁰⁰.
const LEAST: f64 = f64::from_bits((1023 - 700) << 52);

#[inline(always)]
fn placed_side<I: Isa>(
    p: ([Expansion<I>; 3], V<I>),
    q: ([Expansion<I>; 3], V<I>),
    d: ([Expansion<I>; 3], V<I>),
) -> Side {
    let (volume, bound) = placed_volume::<I>(p, q, d);
    Side { zero: 0, ..Side::of::<I>((volume.rounded(), bound)) }
}

/// d·(p × q), and the bound of its error.
#[inline(always)]
fn placed_volume<I: Isa>(
    (p, p_size): ([Expansion<I>; 3], V<I>),
    (q, q_size): ([Expansion<I>; 3], V<I>),
    (d, d_size): ([Expansion<I>; 3], V<I>),
) -> (Expansion<I>, I::F64x8) {
    let (normal, _) = Expansion::cross(p, q);
    let size = [
        p_size[1].mul(q_size[2]).add(p_size[2].mul(q_size[1])),
        p_size[2].mul(q_size[0]).add(p_size[0].mul(q_size[2])),
        p_size[0].mul(q_size[1]).add(p_size[1].mul(q_size[0])),
    ];
    let bound = lanes::dot(size, d_size).mul_add(I::F64x8::splat(3.0 * BOUND), I::F64x8::splat(LEAST));
    (Expansion::dot(normal, d), bound)
}

/// Lanes by the sign of a volume, if it is certain.
struct Side {
    below: u32,
    zero: u32,
    above: u32,
}

impl Side {
    /// The signs of volumes that are known up to a bound.
    #[inline(always)]
    fn of<I: Isa>((volume, bound): (I::F64x8, I::F64x8)) -> Self {
        let zero = bound.le(I::F64x8::splat(0.0));
        Side { below: volume.lt(bound.negated()), zero, above: bound.lt(volume) }
    }

    #[inline(always)]
    fn certain(&self) -> u32 {
        self.below | self.zero | self.above
    }
}

/// d·(p × q), and the bound of its error.
#[inline(always)]
fn volume_of<I: Isa>(p: [Expansion<I>; 3], q: [Expansion<I>; 3], d: V<I>) -> (I::F64x8, I::F64x8) {
    let (normal, size) = Expansion::cross(p, q);
    let volume = Expansion::dot_plain(normal, d).rounded();
    (volume, lanes::dot(size, lanes::abs(d)).mul(I::F64x8::splat(BOUND)))
}

/// 2⁻²⁰⁰.
const LEAST_ORDINARY: f64 = f64::from_bits((1023 - 200) << 52);

/// Lanes in which all coordinates are zero or between 2^±200 in size.
#[inline(always)]
fn ordinary<I: Isa>(v: V<I>) -> u32 {
    let (tiny, huge) = (I::F64x8::splat(LEAST_ORDINARY), I::F64x8::splat(1.0 / LEAST_ORDINARY));
    let mut ordinary = 0xff;
    for axis in 0..3 {
        let size = v[axis].abs();
        ordinary &= size.le(I::F64x8::splat(0.0)) | tiny.le(size) & size.le(huge);
    }
    ordinary
}

#[cfg(test)]
mod tests {
    use super::super::{Crossing, Triangle, TrianglePlane, corners_of};
    use super::*;
    use crate::arith::simd::{Level, Portable, Task, dispatch};
    use crate::geometry::affine::{Affine, Inverse, Placement};
    use crate::shapes::Surface;
    use crate::testing::{assert_slack, numbers, worst};

    /// Eight pairs of a ray and a triangle.
    struct Probe<'a> {
        triangles: &'a [[Point; 3]; 8],
        rays: &'a [(Point, Point); 8],
    }

    impl Task for Probe<'_> {
        /// The result of `sides`; the hits after all decisions, and the valid lanes; and bounds of t, with
        /// the lanes in which they are known.
        type Output = ((u32, u32), (u32, u32), [f64; 8], [f64; 8], u32);

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            let corners = corners_of::<I>(&self.triangles.each_ref().map(|triangle| triangle.each_ref()));
            let (o, d) = (
                I::columns(self.rays.each_ref().map(|ray| &ray.0)),
                I::columns(self.rays.each_ref().map(|ray| &ray.1)),
            );
            let (t, known) = Crossing::<I>::new(&TrianglePlane::new(corners, o), d).bounds();
            let mut sides = sides::<I>(corners, o, d);
            let filtered = sides.hit_and_missed();
            for (lane, ([a, b, c], (o, d))) in self.triangles.iter().zip(self.rays).enumerate() {
                sides.decide(lane, [a, b, c], &Ray::new(*o, *d));
            }
            (filtered, (sides.hit_and_missed().0, sides.ordinary), t.low.store(), t.high.store(), known)
        }
    }

    /// A mean of the corners with exact weights, often on an edge.
    fn target([a, b, c]: [Point; 3], next: &mut impl FnMut() -> f64) -> Point {
        let [u, v, w] =
            [[4.0, 4.0, 0.0], [8.0, 0.0, 0.0], [2.0, 4.0, 2.0], [5.0, 6.0, -3.0]][(4.0 * next()) as usize];
        [0, 1, 2].map(|i| (u * a[i] + v * b[i] + w * c[i]) / 8.0)
    }

    #[test]
    fn what_is_certain_is_so() {
        let mut next = numbers();
        let (mut hit, mut missed, mut unsure, mut bounded) = (0, 0, 0, 0);
        for (place, size, whole) in [
            (0.0, 16.0, true),
            (5e6, 16.0, true),
            (0.0, 1.0, false),
            (5e6, 1e-3, false),
            (0.0, 1e-40, false),
            (0.0, 1e40, false),
            (0.0, 1e-70, false),
            (0.0, 1e100, false),
        ] {
            for _ in 0..150 {
                let mut point = || -> Point {
                    [0; 3].map(|_: u8| {
                        let x = size * (2.0 * next() - 1.0);
                        place + if whole { x.round() } else { x }
                    })
                };
                let triangles = [0; 8].map(|_: u8| [0; 3].map(|_: u8| point()));
                let origins = [0; 8].map(|_: u8| point());
                let rays = [0, 1, 2, 3, 4, 5, 6, 7].map(|lane: usize| {
                    let to = target(triangles[lane], &mut next);
                    (origins[lane], [0, 1, 2].map(|i| to[i] - origins[lane][i]))
                });
                let roots = [0, 1, 2, 3, 4, 5, 6, 7].map(|lane: usize| {
                    let [a, b, c] = triangles[lane];
                    match Triangle(a, b, c).roots(&Ray::<Dyadic>::new(rays[lane].0, rays[lane].1)) {
                        Ok([root, _]) => root,
                        Err(_) => unreachable!("exact arithmetic is never uncertain"),
                    }
                });
                for level in Level::available() {
                    let ((hits, misses), (decided, ordinary), low, high, known) =
                        dispatch(level, Probe { triangles: &triangles, rays: &rays });
                    assert_eq!(hits & misses, 0);
                    for (lane, root) in roots.iter().enumerate() {
                        let is = |mask: u32| mask >> lane & 1 != 0;
                        assert!(
                            !(is(hits) && root.is_none()),
                            "{level:?}: {:?}, {:?}",
                            triangles[lane],
                            rays[lane]
                        );
                        assert!(
                            !(is(misses) && root.is_some()),
                            "{level:?}: {:?}, {:?}",
                            triangles[lane],
                            rays[lane]
                        );
                        (hit, missed) = (hit + usize::from(is(hits)), missed + usize::from(is(misses)));
                        unsure += usize::from(!is(hits | misses));
                        // All is decided, except that a ray in the plane of a triangle, on no side, has no
                        // root.
                        if is(ordinary) {
                            assert_eq!(
                                is(decided),
                                root.is_some(),
                                "{level:?}: {:?}, {:?}",
                                triangles[lane],
                                rays[lane]
                            );
                        }
                        if let (Some(root), true) = (root, is(hits & known)) {
                            // t = b/a with a > 0.
                            let side = |t: f64| Dyadic::exact(t).times(&root.a).minus(&root.b).sign();
                            assert!(
                                side(low[lane]) != Ok(Ordering::Greater),
                                "{level:?}: {:?}",
                                triangles[lane]
                            );
                            assert!(
                                side(high[lane]) != Ok(Ordering::Less),
                                "{level:?}: {:?}",
                                triangles[lane]
                            );
                            // The bounds are tight.
                            let middle = low[lane].abs().max(high[lane].abs());
                            assert!(high[lane] - low[lane] <= 64.0 * f64::EPSILON * middle);
                            bounded += 1;
                        }
                        // Numbers beyond 2^±200 are not decided here.
                        assert!(!(size == 1e-70 || size == 1e100) || !is(hits | misses));
                    }
                }
            }
        }
        let levels = Level::available().count();
        assert!(hit > 1_600 * levels && missed > 1_000 * levels, "{hit}, {missed}");
        assert!(bounded > 1_300 * levels, "{bounded}");
        // Rays to edges with fractional coordinates, except those that rounding moves far enough aside.
        assert!(unsure > 1_000 * levels, "{unsure}");
    }

    /// The largest share of its bound that the change of a volume is off by.
    #[test]
    fn changes_of_volumes_are_as_near_as_the_bound_says() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 2.0 * next() - 1.0;
        let (found, _) = worst(8, 1500, draw, |x: &[f64; 12]| {
            let [v, p, q, d] = [0, 3, 6, 9].map(|k: usize| [x[k], x[k + 1], x[k + 2]]);
            let lanes = |p: Point| p.map(|x| [x; 8]);
            let edge = lanes::sub::<[f64; 8], 8>(lanes(p), lanes(q));
            let (change, size) = Nudge::<Portable>(lanes(v)).change(edge, lanes(d));
            let exact = |p: Point| -> [Dyadic; 3] { vector::exact(p) };
            let truth = super::volume(&exact(d), &exact(v), &vector::sub(&exact(p), &exact(q)));
            let off = Dyadic::exact(change[0]).minus(&truth).split().0.abs();
            if size[0] > 0.0 { off / (CHANGE * size[0]) } else { 0.0 }
        });
        assert_slack("change", found, 0.267);
    }

    /// Whole numbers times a power of two, and origins with coordinates next to them: as small as they come
    /// beside volumes that are as small, and far below them.
    #[test]
    fn tiny_coordinates_of_origins_are_heeded() {
        let mut next = numbers();
        let (mut hit, mut missed, mut open) = (0, 0, 0);
        for (size, tiny) in [(-199, -203), (-199, -330), (0, -203), (0, -1000), (0, -1072), (100, -700)] {
            for _ in 0..200 {
                let mut whole = |below: f64, power: i32| {
                    (below * (2.0 * next() - 1.0)).round()
                        * 2.0_f64.powi(power / 2)
                        * 2.0_f64.powi(power - power / 2)
                };
                let mut point = |flat: bool| -> Point {
                    [whole(3.0, size), whole(3.0, size), if flat { 0.0 } else { whole(2.0, size) }]
                };
                let triangles = [0; 8].map(|_: u8| [point(true), point(true), point(false)]);
                let origins = [0; 8].map(|_: u8| point(true));
                let directions = [0; 8].map(|_: u8| point(true));
                let rays = [0, 1, 2, 3, 4, 5, 6, 7].map(|lane: usize| {
                    let [x, y, _] = origins[lane];
                    let axis = if lane < 4 { 2 } else { lane % 3 };
                    let mut origin = [x, y, 0.0];
                    origin[axis] = whole(3.0, tiny);
                    (origin, directions[lane])
                });
                for level in Level::available() {
                    let ((hits, misses), (decided, ordinary), ..) =
                        dispatch(level, Probe { triangles: &triangles, rays: &rays });
                    assert_eq!(ordinary, 0xff);
                    for (lane, ([a, b, c], (o, d))) in triangles.iter().zip(&rays).enumerate() {
                        let root = Triangle(*a, *b, *c).roots(&Ray::<Dyadic>::new(*o, *d));
                        let is_hit = root.is_ok_and(|[root, _]| root.is_some());
                        let is = |mask: u32| mask >> lane & 1 != 0;
                        assert!(
                            !is(if is_hit { misses } else { hits }),
                            "{level:?}: {a:?} {b:?} {c:?} {o:?} {d:?}"
                        );
                        assert_eq!(is(decided), is_hit, "{level:?}: {a:?} {b:?} {c:?} {o:?} {d:?}");
                        (hit, missed) = (hit + usize::from(is(hits)), missed + usize::from(is(misses)));
                        open += usize::from(!is(hits | misses));
                    }
                }
            }
        }
        assert!(hit > 1000 && missed > 5000 && open < missed / 10, "{hit}, {missed}, {open}");
    }

    /// For consecutive Fibonacci numbers, xₙ·xₙ₊₂ − xₙ₊₁² = ±1: far below the resolution
    /// of expansions at such large products.
    #[test]
    fn signs_that_expansions_leave_open_are_decided() {
        let mut fibonacci = vec![1_u64, 1];
        while fibonacci.len() < 78 {
            fibonacci.push(fibonacci[fibonacci.len() - 1] + fibonacci[fibonacci.len() - 2]);
        }
        let point = |n: usize, sign: f64| [sign * fibonacci[n] as f64, sign * fibonacci[n + 1] as f64, 1.0];
        // The third corner is minus the sum of the others and the ray is inside, or it is the sum and the ray
        // is outside.
        let triangles = [0, 1, 2, 3, 4, 5, 6, 7].map(|lane: usize| {
            let (n, sign) = (71 + lane % 4, if lane < 4 { -1.0 } else { 1.0 });
            [point(n, 1.0), point(n + 1, 1.0), point(n + 2, sign)]
        });
        let rays = [([0.0; 3], [0.0, 0.0, 1.0]); 8];
        for level in Level::available() {
            let (filtered, decided, ..) = dispatch(level, Probe { triangles: &triangles, rays: &rays });
            assert_eq!((filtered, decided), ((0, 0), (0x0f, 0xff)), "{level:?}");
        }
    }

    /// The largest share of its bound that the volume of a placed edge is off by.
    #[test]
    fn volumes_of_placed_edges_are_as_near_as_the_bound_says() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 2.0 * next() - 1.0;
        let (found, _) = worst(8, 1500, draw, |x: &[f64; 24]| {
            let [p, q, o, d] = [0, 3, 6, 9].map(|k: usize| [x[k], x[k + 1], x[k + 2]]);
            let row = |k: usize| [x[k], x[k + 1], x[k + 2]];
            let Some(inverse) = Inverse::of(&Affine::new([row(12), row(15), row(18)], row(21)), None) else {
                return 0.0;
            };
            let Some(expanded) = inverse.expanded() else { return 0.0 };
            let lanes = |p: Point| p.map(|x| [x; 8]);
            let from = expanded.points::<Portable>(lanes(o));
            let [from_p, from_q] = [p, q].map(|p| from_origin::<Portable>(lanes(p), from));
            let (volume, bound) =
                placed_volume::<Portable>(from_p, from_q, expanded.vectors::<Portable>(lanes(d)));
            let ray: Ray<Dyadic> = inverse.local(Ray::new(o, d));
            let truth = super::volume(
                &ray.direction,
                &ray.origin_from(vector::exact(p)),
                &ray.origin_from(vector::exact(q)),
            );
            // The exact ray is scaled by its weight, and so are the three factors.
            let weight = ray.weight.unwrap_or(Dyadic::exact(1.0));
            let cube = weight.times(&weight).times(&weight);
            let found = Dyadic::exact(volume.high[0]).plus(&Dyadic::exact(volume.low[0])).times(&cube);
            found.minus(&truth).split().0.abs() / (cube.split().0.abs() * bound[0])
        });
        assert_slack("volume", found, 0.00349);
    }

    /// Whole numbers under maps of whole numbers, half of which reflect: rays to edges and corners.
    #[test]
    fn placed_triangles_are_hit_as_in_their_own_coordinates() {
        let mut next = numbers();
        let (mut hit, mut filtered, mut open) = (0, 0, 0);
        for _ in 0..600 {
            let mut whole = |size: f64| (size * (2.0 * next() - 1.0)).round();
            let mut point = |size: f64| [0; 3].map(|_: u8| whole(size));
            let (linear, offset) = ([point(3.0), point(3.0), point(3.0)], point(9.0));
            let (corners, origin) = ([0; 3].map(|_: u8| point(16.0)), point(16.0));
            let Some(inverse) = Inverse::of(&Affine::new(linear, offset), None) else { continue };
            let Some(expanded) = inverse.expanded() else { continue };
            let to = target(corners, &mut next);
            let direction: Point = [0, 1, 2].map(|i| to[i] - origin[i]);
            let map = |v: Point| -> Point { linear.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2]) };
            let placed = map(origin);
            let ray = ([0, 1, 2].map(|i| placed[i] + offset[i]), map(direction));
            let [a, b, c] = corners;
            let root = Triangle(a, b, c).roots(&Ray::<Dyadic>::new(origin, direction));
            let is_hit = root.is_ok_and(|[root, _]| root.is_some());
            let lanes = |p: Point| p.map(|x| [x; 8]);
            let mut sides = placed_sides::<Portable>(
                corners.map(lanes),
                expanded.points::<Portable>(lanes(ray.0)),
                expanded.vectors::<Portable>(lanes(ray.1)),
            );
            let (hits, misses) = sides.hit_and_missed();
            assert!(if is_hit { misses & 1 == 0 } else { hits & 1 == 0 });
            filtered += usize::from((hits | misses) & 1 != 0);
            open += usize::from((hits | misses) & 1 == 0);
            sides.decide(0, corners.each_ref(), &inverse.local(Ray::new(ray.0, ray.1)));
            // A triangle without an area has no root.
            assert_eq!(sides.hit_and_missed().0 & 1 != 0, is_hit, "{linear:?}, {corners:?}, {ray:?}");
            hit += usize::from(is_hit);
        }
        assert!(hit > 200 && filtered > 100 && open > 100, "{hit}, {filtered}, {open}");
    }

    #[test]
    fn an_exact_zero_is_certain() {
        // Whole numbers in a plane through the origin: the ray lies exactly in the plane of an edge and the
        // axis.
        let triangles = [[[0.0, 4.0, -1.0], [0.0, 4.0, 3.0], [5.0, 4.0, 0.0]]; 8];
        let rays = [[0.0, 1.0, 0.0]; 8].map(|direction| ([0.0, 0.0, 0.5], direction));
        for level in Level::available() {
            let (sides, decided, low, high, known) =
                dispatch(level, Probe { triangles: &triangles, rays: &rays });
            assert_eq!((sides, decided, known), ((0xff, 0), (0xff, 0xff), 0xff));
            assert!(low.iter().zip(high).all(|(low, high)| *low <= 4.0 && 4.0 <= high));
        }
    }
}
