//! The primitive intersector: tests rays of a packet against the shapes in the leaves of an object that holds
//! many. Per ray, one test of the balls around eight shapes culls most; pairs of a ray and a shape that
//! remain are collected, and their roots bounded, one pair per lane.

use std::cell::Cell;
use std::marker::PhantomData;

use crate::arith::number::{Interval, Many, Number, RunningErrors, UNIT, Uncertain};
use crate::arith::simd::{Floats, Isa, LaneTask, Task, lanes};
use crate::bvh::{LANES, Mask, RayPacket, Stack, Visitor, all, part_of_mask, take};
use crate::cast::closest_hit::ClosestHits;
use crate::geometry::point::dot;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{Point, of_rays};
use crate::scene::{PrimitiveLeaf, RootId};
use crate::shapes::{Each, MOST_ROOTS, of_each};

/// Intersects rays of one octant, in the local coordinates of an object, with the leaves of its hierarchy.
pub struct PrimitiveIntersector<'a, 's, S, const K: usize> {
    pub id: u32,
    pub rays: &'a RayPacket,
    /// The same rays in world coordinates.
    pub world: &'a RayPacket,
    /// Whether they are the same packet.
    pub in_world: bool,
    pub closest: &'a mut ClosestHits<'s>,
    pub pairs: &'a mut Pairs,
    pub kind: PhantomData<S>,
}

/// Pairs whose roots are bounded together: two of the widest registers.
const PAIRS: usize = 16;

/// The most numbers that define a shape.
const NUMBERS: usize = 7;

/// Pairs of a ray and a shape, and bounds of their roots.
#[repr(C, align(64))]
pub struct Pairs {
    origin: [[f64; PAIRS]; 3],
    direction: [[f64; PAIRS]; 3],
    origin_error: [f64; PAIRS],
    direction_error: [f64; PAIRS],
    numbers: [[f64; PAIRS]; NUMBERS],
    /// Bounds of the roots, and how many there are.
    low: [[f64; PAIRS]; MOST_ROOTS],
    high: [[f64; PAIRS]; MOST_ROOTS],
    roots: [u8; PAIRS],
    lane: [u8; PAIRS],
    primitive: [u32; PAIRS],
    count: usize,
    /// Pairs whose roots are uncertain.
    unsure: Mask,
}

impl Pairs {
    pub fn new() -> Self {
        Pairs {
            origin: [[0.0; PAIRS]; 3],
            direction: [[1.0; PAIRS]; 3],
            origin_error: [0.0; PAIRS],
            direction_error: [0.0; PAIRS],
            numbers: [[1.0; PAIRS]; NUMBERS],
            low: [[0.0; PAIRS]; MOST_ROOTS],
            high: [[0.0; PAIRS]; MOST_ROOTS],
            roots: [0; PAIRS],
            lane: [0; PAIRS],
            primitive: [0; PAIRS],
            count: 0,
            unsure: 0,
        }
    }

    #[inline(always)]
    fn push<const K: usize>(&mut self, rays: &RayPacket, lane: usize, leaf: &PrimitiveLeaf<K>, i: usize) {
        let at = self.count;
        for axis in 0..3 {
            self.origin[axis][at] = rays.origin[axis][lane];
            self.direction[axis][at] = rays.direction[axis][lane];
        }
        (self.origin_error[at], self.direction_error[at]) =
            (rays.origin_error[lane], rays.direction_error[lane]);
        for k in 0..K {
            self.numbers[k][at] = leaf.numbers[k][i];
        }
        (self.lane[at], self.primitive[at]) = (lane as u8, leaf.id(i));
        self.count += 1;
    }
}

impl<S: Each<K>, const K: usize> PrimitiveIntersector<'_, '_, S, K> {
    /// Intersects these rays with a leaf, and returns the mask of those whose limits may have decreased.
    #[inline(always)]
    pub fn intersect<I: Isa>(&mut self, leaf: &PrimitiveLeaf<K>, mask: Mask) -> Mask {
        let mut nearer = 0;
        for group in self.rays.origin_groups() {
            let mut left = mask & group;
            if left == 0 {
                continue;
            }
            let balls = Balls::<I>::seen_from(self.rays.origin(left.trailing_zeros() as usize), leaf);
            while let Some(lane) = take(&mut left) {
                nearer |= self.test::<I>(&balls, leaf, lane);
            }
        }
        nearer | self.resolve::<I>()
    }

    /// Collects the shapes of a leaf that a ray may meet.
    #[inline(always)]
    fn test<I: Isa>(&mut self, balls: &Balls<I>, leaf: &PrimitiveLeaf<K>, lane: usize) -> Mask {
        let mut candidates = Mask::from(balls.met_by(&BallRay::new(self.rays, lane)) & leaf.all());
        let mut nearer = 0;
        while let Some(i) = take(&mut candidates) {
            self.pairs.push(self.rays, lane, leaf, i);
            if self.pairs.count == PAIRS {
                nearer |= self.resolve::<I>();
            }
        }
        nearer
    }

    /// Bounds the roots of the pairs, updates the closest hits of their rays, and forgets the pairs.
    #[inline(always)]
    fn resolve<I: Isa>(&mut self) -> Mask {
        if self.pairs.count == 0 { 0 } else { I::call(Resolve(self)) }
    }
}

struct Resolve<'t, 'a, 's, S, const K: usize>(&'t mut PrimitiveIntersector<'a, 's, S, K>);

impl<S: Each<K>, const K: usize> Task for Resolve<'_, '_, '_, S, K> {
    type Output = Mask;

    #[inline(always)]
    fn run<I: Isa>(self) -> Mask {
        let PrimitiveIntersector { id, rays, world, in_world, ref mut closest, ref mut pairs, .. } = *self.0;
        let bounded = if in_world {
            I::call_widest(BoundRoots::<S, K, true> { pairs, kind: PhantomData })
        } else {
            I::call_widest(BoundRoots::<S, K, false> { pairs, kind: PhantomData })
        };
        let mut nearer = 0;
        for k in 0..std::mem::take(&mut pairs.count) {
            let (lane, primitive) = (usize::from(pairs.lane[k]), pairs.primitive[k]);
            if bounded.is_none() || pairs.unsure & 1 << k != 0 {
                // The same float64 numbers would leave it uncertain again.
                if bounded.is_some() && in_world {
                    closest.intersect_exactly(world, lane, id, primitive);
                } else {
                    closest.intersect(world, lane, id, primitive);
                }
                nearer |= 1 << lane;
                continue;
            }
            for index in 0..pairs.roots[k] {
                let (low, high) = (&pairs.low[usize::from(index)], &pairs.high[usize::from(index)]);
                let t = rays.t_of_ray(lane, Interval { low: low[k], high: high[k] });
                if t.high < closest.t_min() {
                    continue;
                }
                if t.low < closest.t_min() {
                    closest.intersect(world, lane, id, primitive);
                    nearer |= 1 << lane;
                } else {
                    let root = RootId { object: id, primitive, index, feature: 0 };
                    nearer |= Mask::from(closest.accept_only(world, lane, root, t)) << lane;
                }
                break;
            }
        }
        nearer
    }
}

impl<S: Each<K>, const K: usize> Visitor<PrimitiveLeaf<K>> for PrimitiveIntersector<'_, '_, S, K> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, _: &mut Stack, lanes: &[usize], leaves: &[&PrimitiveLeaf<K>]) -> Mask {
        let mut nearer = 0;
        for (&lane, leaf) in lanes.iter().zip(leaves) {
            nearer |= self.test::<I>(&Balls::seen_from(self.rays.origin(lane), leaf), leaf, lane);
        }
        nearer | self.resolve::<I>()
    }

    #[inline(always)]
    fn limits(&self) -> &[f64; LANES] {
        self.closest.limits()
    }
}

/// The balls around the shapes of a leaf, as seen from the origin of rays.
struct Balls<I: Isa> {
    /// The origin relative to the centres, and the 1-norms of that.
    from: [I::F64x8; 3],
    size: I::F64x8,
    /// r² and 2r.
    square: I::F64x8,
    diameter: I::F64x8,
}

/// A ray at balls.
struct BallRay {
    direction: Point,
    /// Upper bounds of |d|² and |d|₁.
    square: f64,
    length: f64,
    /// See `Balls::met_by`.
    turned: f64,
    moved: f64,
}

impl BallRay {
    #[inline(always)]
    fn new(rays: &RayPacket, lane: usize) -> Self {
        let (d, length) = (rays.direction(lane), rays.length[lane]);
        let (off, bent) = (rays.origin_error[lane], rays.direction_error[lane]);
        BallRay {
            direction: d,
            square: dot(d, d) + bent * (4.0 * length + 4.0 * bent),
            length: length + 4.0 * bent,
            turned: 4.0 * UNIT * length + 4.0 * bent,
            moved: 4.0 * off * (length + 2.0 * bent) + f64::MIN_POSITIVE,
        }
    }
}

impl<I: Isa> Balls<I> {
    #[inline(always)]
    fn seen_from<const K: usize>(origin: Point, leaf: &PrimitiveLeaf<K>) -> Self {
        let o = lanes::splat::<I::F64x8, 8>(origin);
        let number = &leaf.numbers;
        let from = [
            o[0].sub(I::F64x8::load(&number[0])),
            o[1].sub(I::F64x8::load(&number[1])),
            o[2].sub(I::F64x8::load(&number[2])),
        ];
        let [x, y, z] = lanes::abs(from);
        let r = I::F64x8::load(&number[3]);
        Balls { from, size: x.add(y).add(z), square: r.mul(r), diameter: r.add(r) }
    }

    /// The balls that a ray may meet: all except those certainly passed.
    ///
    /// With f = o − c, a line meets a ball iff |f × d| ≤ r·|d|. Let each coordinate of o be off by ε, of d by
    /// ε_d, and let m = |f|₁. A coordinate of f rounds by u of itself, the two products and the difference of
    /// a coordinate of f × d by 2u of the products, so over all three coordinates f × d is off by less than
    /// 3u·m·|d|₁ + 2m·ε_d + 2|d|₁·ε + 6ε·ε_d, up to second-order terms. E has 4, 4, 4 and 8 in these places,
    /// for those terms and its own roundings, and the smallest normal number, for underflow. So
    /// |f × d|² ≤ r²·|d|² + E·(2r·|d| + E) at balls that are met. The factor covers the roundings of both
    /// sides, fewer than 16 of relative size u each; that of |f × d|² may lose to underflow less than what is
    /// added. Where anything overflows or is NaN, E² is as well, and the ball counts as met.
    #[inline(always)]
    fn met_by(&self, ray: &BallRay) -> u32 {
        let g = lanes::fused_cross(self.from, lanes::splat(ray.direction));
        let error = self.size.fused(I::F64x8::splat(ray.turned), I::F64x8::splat(ray.moved));
        let margin = error.mul(self.diameter.fused(I::F64x8::splat(ray.length), error));
        let most = self.square.fused(I::F64x8::splat(ray.square), margin);
        let most = most.fused(I::F64x8::splat(1.0 + 16.0 * UNIT), I::F64x8::splat(f64::MIN_POSITIVE));
        !most.lt(lanes::fused_dot(g, g))
    }
}

/// Bounds the roots of pairs. `GIVEN` says that the rays have no errors.
struct BoundRoots<'t, S, const K: usize, const GIVEN: bool> {
    pairs: &'t mut Pairs,
    kind: PhantomData<S>,
}

impl<S: Each<K>, const K: usize, const GIVEN: bool> LaneTask for BoundRoots<'_, S, K, GIVEN> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, const N: usize>(self) {
        let pairs = self.pairs;
        pairs.unsure = 0;
        for i in 0..pairs.count.div_ceil(N) {
            let mut left = part_of_mask::<N>(all(pairs.count), i);
            let active = Cell::new(left);
            let lanes = Many::<F>::new(&active);
            let (o, d) = (lanes::part::<F, N, PAIRS>(&pairs.origin, i), lanes::part(&pairs.direction, i));
            let ray = if GIVEN {
                Ray { origin: of_rays(o, lanes), direction: of_rays(d, lanes), weight: None }
            } else {
                let off = lanes::load::<F, N>(&pairs.origin_error, i);
                let bent = lanes::load::<F, N>(&pairs.direction_error, i);
                Ray {
                    origin: [
                        RunningErrors::within(o[0], off, lanes),
                        RunningErrors::within(o[1], off, lanes),
                        RunningErrors::within(o[2], off, lanes),
                    ],
                    direction: [
                        RunningErrors::within(d[0], bent, lanes),
                        RunningErrors::within(d[1], bent, lanes),
                        RunningErrors::within(d[2], bent, lanes),
                    ],
                    weight: None,
                }
            };
            let mut numbers = [F::splat(0.0); K];
            for k in 0..K {
                numbers[k] = lanes::load(&pairs.numbers[k], i);
            }
            let numbers = of_each(&numbers, lanes);
            while left != 0 {
                active.set(left);
                if pairs.bound::<F, S, N, K>(i, &numbers, &ray, &active).is_err() {
                    pairs.unsure |= Mask::from(active.get()) << (i * N);
                }
                left &= !active.get();
            }
        }
    }
}

impl Pairs {
    /// Bounds the roots of the active pairs of part `i`.
    #[inline(always)]
    fn bound<'a, F: Floats<f64, N>, S: Each<K>, const N: usize, const K: usize>(
        &mut self,
        i: usize,
        numbers: &[RunningErrors<Many<'a, F>, N>; K],
        ray: &Ray<RunningErrors<Many<'a, F>, N>>,
        active: &Cell<u32>,
    ) -> Result<(), Uncertain> {
        let roots = S::roots_of(numbers, ray)?;
        let mut count = 0;
        for k in 0..MOST_ROOTS {
            let Some(root) = &roots[k] else { break };
            let t = Number::enclose(root)?;
            // Other lanes may hold bounds already.
            let (low, high) = (t.low.store(), t.high.store());
            let mut left = Mask::from(active.get());
            while let Some(lane) = take(&mut left) {
                (self.low[k][i * N + lane], self.high[k][i * N + lane]) = (low[lane], high[lane]);
            }
            count += 1;
        }
        let mut left = Mask::from(active.get());
        while let Some(lane) = take(&mut left) {
            self.roots[i * N + lane] = count;
        }
        Ok(())
    }
}
