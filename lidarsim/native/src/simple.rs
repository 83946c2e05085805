//! Packets at simple shapes, a register of rays at a time: bounds of where they meet, and the double-double look at the nearest hits.
//!
//! What lanes together are not certain of is asked ray by ray.

use std::cell::Cell;

use crate::affine::{AsMade, Placement};
use crate::bvh::{LANES, Mask, Rays, take};
use crate::finish::{Meeting, finish};
use crate::number::{Balls, Interval, Many, Number, Uncertain};
use crate::ray::Ray;
use crate::scene::{Geometry, Hit, Place, Scene};
use crate::search::Searches;
use crate::shapes::{Surface, SurfaceTask};
use crate::simd::{Floats, Isa, lanes};
use crate::trace::Sink;
use crate::vector::{self, Point, Vector};

/// Part `i` of many numbers.
#[inline(always)]
fn load<F: Floats<f64, N>, const N: usize>(x: &[f64], i: usize) -> F {
    F::load(&x.as_chunks().0[i])
}

/// A packet's bits of part `i`, as bits of the lanes of a register.
#[inline(always)]
fn part_of_mask<const N: usize>(mask: Mask, i: usize) -> u32 {
    (mask >> (i * N)) as u32 & ((1 << N) - 1)
}

/// Offers the hits of the rays of `mask` on an object to their searches.
#[inline(always)]
pub fn meet<I: Isa>(scene: &Scene, id: u32, rays: &Rays, searches: &mut Searches, mask: Mask, met: &mut Met) {
    let object = &scene.objects()[id as usize];
    (met.count, met.unsure) = (0, mask);
    let alone = mask & (mask - 1) == 0;
    let mut asked = false;
    if !alone && let Geometry::Simple(shape) = &object.geometry {
        let (t_min, met) = (searches.t_min(), &mut *met);
        let done = match object.placement() {
            None => shape.apart::<I, _>(Meet { placement: AsMade, rays, t_min, met }),
            Some(placement) => shape.apart::<I, _>(Meet { placement, rays, t_min, met }),
        };
        asked = done.is_some();
    }
    let place = |index: usize, feature| Place { object: id, primitive: 0, index: index as u8, feature };
    for some in &met.some[..met.count] {
        let mut left = Mask::from(some.lanes);
        while let Some(lane) = take(&mut left) {
            for (index, roots) in some.roots[..some.count].iter().enumerate() {
                let t = Interval { low: roots.low[lane], high: roots.high[lane] };
                if searches.takes(rays, some.start + lane, place(index, roots.feature), t) {
                    break;
                }
            }
        }
    }
    while let Some(lane) = take(&mut met.unsure) {
        if asked {
            searches.decide(rays, lane, id, 0);
        } else {
            searches.consider(rays, lane, id, 0);
        }
    }
}

/// What a packet finds on a surface. Kept from one to the next, as it is large.
pub struct Met {
    some: [Alike; LANES],
    count: usize,
    /// Rays to be asked one by one.
    unsure: Mask,
}

/// Rays side by side for which the same is true of a surface.
#[derive(Clone, Copy)]
struct Alike {
    /// A bit each, from lane `start` of the packet on.
    lanes: u32,
    start: usize,
    /// The first root, and the second too where the first may lie before the range.
    roots: [Roots; 2],
    count: usize,
}

/// Lanes of the widest register.
const WIDEST: usize = 8;

/// Bounds of a root of each, on one part of the surface.
#[derive(Clone, Copy)]
struct Roots {
    feature: u8,
    low: [f64; WIDEST],
    high: [f64; WIDEST],
}

impl Roots {
    const NONE: Roots = Roots { feature: 0, low: [0.0; WIDEST], high: [0.0; WIDEST] };

    #[inline(always)]
    fn set<F: Floats<f64, N>, const N: usize>(&mut self, feature: u8, t: Interval<F>) {
        self.feature = feature;
        self.low.as_chunks_mut().0[0] = t.low.store();
        self.high.as_chunks_mut().0[0] = t.high.store();
    }
}

impl Met {
    pub fn new() -> Self {
        Met { some: [Alike { lanes: 0, start: 0, roots: [Roots::NONE; 2], count: 0 }; LANES], count: 0, unsure: 0 }
    }
}

/// Bounds of the roots of the rays that `met` is unsure of.
struct Meet<'a, P> {
    placement: P,
    rays: &'a Rays,
    t_min: f64,
    met: &'a mut Met,
}

impl<P: Placement> SurfaceTask for Meet<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, S: Surface, const N: usize>(self, surface: &S) {
        let Meet { placement, rays, t_min, met } = self;
        let mask = std::mem::take(&mut met.unsure);
        for i in 0..LANES / N {
            let mut left = part_of_mask::<N>(mask, i);
            if left == 0 {
                continue;
            }
            let asked = Cell::new(left);
            let (o, d): ([F; 3], [F; 3]) = (lanes::part(&rays.origin, i), lanes::part(&rays.direction, i));
            let world = Ray { origin: balls(o, &asked), direction: balls(d, &asked), weight: None };
            let ray = placement.local(world);
            while left != 0 {
                asked.set(left);
                if met.bound(i, surface, &ray, &asked, t_min).is_err() {
                    met.unsure |= Mask::from(asked.get()) << (i * N);
                }
                left &= !asked.get();
            }
        }
    }
}

impl Met {
    /// The rays of part `i` that are still asked.
    #[inline(always)]
    fn bound<F: Floats<f64, N>, S: Surface, const N: usize>(
        &mut self,
        i: usize,
        surface: &S,
        ray: &Ray<Balls<Many<F>, N>>,
        asked: &Cell<u32>,
        t_min: f64,
    ) -> Result<(), Uncertain> {
        let [first, second] = surface.roots(ray)?;
        let Some(first) = first else { return Ok(()) };
        let t = Number::enclose(&first)?;
        let behind = t.low.lt(F::splat(t_min));
        // As many as there are rays are enough: each ray has its place in one alone.
        let alike = &mut self.some[self.count];
        alike.roots[0].set(first.feature, t);
        alike.count = 1;
        if behind & asked.get() != 0
            && let Some(second) = second
        {
            alike.roots[1].set(second.feature, Number::enclose(&second)?);
            alike.count = 2;
        }
        (alike.lanes, alike.start) = (asked.get(), i * N);
        self.count += 1;
        Ok(())
    }
}

#[inline(always)]
fn balls<'a, F: Floats<f64, N>, const N: usize>(v: [F; 3], asked: &'a Cell<u32>) -> Vector<Balls<Many<'a, F>, N>> {
    let lanes = Many::new(asked);
    [Balls::of_rays(v[0], lanes), Balls::of_rays(v[1], lanes), Balls::of_rays(v[2], lanes)]
}

/// Hits on simple shapes that wait for others on the same part of the same object, to be finished together.
pub struct Pending {
    groups: Vec<Group>,
}

/// Parts of objects that may wait at once; where two of them meet in one group, the first makes way.
const GROUPS: usize = 32;

/// Hits that may wait of one part of an object: two of the widest registers, of which one is worked on while the other waits for its quotients.
const SEATS: usize = 2 * WIDEST;

#[derive(Clone, Copy)]
struct Group {
    /// Of all but for `index`, which says which root.
    place: Place,
    index: [u8; SEATS],
    count: usize,
    at: [u32; SEATS],
    origin: [[f64; SEATS]; 3],
    direction: [[f64; SEATS]; 3],
    /// Of t.
    low: [f64; SEATS],
    high: [f64; SEATS],
}

impl Pending {
    pub fn new() -> Self {
        let empty = Group {
            place: Place { object: 0, primitive: 0, index: 0, feature: 0 },
            count: 0,
            at: [0; SEATS],
            index: [0; SEATS],
            origin: [[0.0; SEATS]; 3],
            direction: [[1.0; SEATS]; 3],
            low: [0.0; SEATS],
            high: [0.0; SEATS],
        };
        Pending { groups: vec![empty; GROUPS] }
    }

    /// Takes a hit, with the ray and bounds of t; one on a mesh is finished at once.
    #[inline(always)]
    pub fn push<I: Isa>(
        &mut self,
        scene: &Scene,
        at: u32,
        place: Place,
        (origin, direction, bounds): (Point, Point, Interval),
        hits: &mut (impl Sink + ?Sized),
    ) {
        if !scene.objects()[place.object as usize].is_simple() {
            hits.put(at as usize, scene.hit_within(&place, bounds, origin, direction));
            return;
        }
        let group = &mut self.groups[(7 * place.object as usize + usize::from(place.feature)) % GROUPS];
        if (group.place.object, group.place.feature) != (place.object, place.feature) {
            group.flush::<I>(scene, hits);
            group.place = place;
        }
        let seat = group.count;
        (group.at[seat], group.index[seat]) = (at, place.index);
        for axis in 0..3 {
            group.origin[axis][seat] = origin[axis];
            group.direction[axis][seat] = direction[axis];
        }
        (group.low[seat], group.high[seat]) = (bounds.low, bounds.high);
        group.count += 1;
        if group.count == SEATS {
            group.flush::<I>(scene, hits);
        }
    }

    #[inline(always)]
    pub fn flush<I: Isa>(&mut self, scene: &Scene, hits: &mut (impl Sink + ?Sized)) {
        for group in &mut self.groups {
            group.flush::<I>(scene, hits);
        }
    }
}

impl Group {
    #[inline(always)]
    fn flush<I: Isa>(&mut self, scene: &Scene, hits: &mut (impl Sink + ?Sized)) {
        if self.count == 0 {
            return;
        }
        let object = &scene.objects()[self.place.object as usize];
        let mut found = Found { known: 0, t: [0.0; SEATS], normal: [[0.0; SEATS]; 3] };
        if let Geometry::Simple(shape) = &object.geometry {
            let (group, found) = (&*self, &mut found);
            match object.placement() {
                None => shape.apart::<I, _>(Finish { placement: AsMade, group, found }),
                Some(placement) => shape.apart::<I, _>(Finish { placement, group, found }),
            };
        }
        let (object, primitive) = (self.place.object as i32, object.reported(self.place.primitive));
        for seat in 0..self.count {
            let at = self.at[seat] as usize;
            // No hit is put together first: to read back in one piece what was written in several takes long.
            if found.known & (1 << seat) != 0 {
                hits.put(at, Hit { t: found.t[seat], normal: pick(&found.normal, seat), object, primitive });
            } else {
                let bounds = Interval { low: self.low[seat], high: self.high[seat] };
                let place = Place { index: self.index[seat], ..self.place };
                let (origin, direction) = (pick(&self.origin, seat), pick(&self.direction, seat));
                hits.put(at, scene.hit_within(&place, bounds, origin, direction));
            }
        }
        self.count = 0;
    }
}

#[inline(always)]
fn pick(v: &[[f64; SEATS]; 3], seat: usize) -> Point {
    [v[0][seat], v[1][seat], v[2][seat]]
}

/// t and a unit normal, of the hits that are certain.
struct Found {
    known: u32,
    t: [f64; SEATS],
    normal: [[f64; SEATS]; 3],
}

/// Finishes the hits of a group.
struct Finish<'a, P> {
    placement: P,
    group: &'a Group,
    found: &'a mut Found,
}

impl<P: Placement> SurfaceTask for Finish<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, S: Surface, const N: usize>(self, surface: &S) {
        let Finish { placement, group, found } = self;
        for i in 0..group.count.div_ceil(N) {
            let asked = Cell::new(((1_u32 << group.count) - 1) >> (i * N) & ((1 << N) - 1));
            let bounds = Interval { low: load(&group.low, i), high: load(&group.high, i) };
            let origin: [F; 3] = lanes::part(&group.origin, i);
            let meeting =
                Meeting { feature: group.place.feature, origin, direction: lanes::part(&group.direction, i), bounds };
            if let Ok((t, normal)) = finish(placement, surface, &meeting, Many::new(&asked)) {
                let [x, y, z] = vector::unit(normal);
                found.t.as_chunks_mut().0[i] = t.store();
                found.normal[0].as_chunks_mut().0[i] = x.store();
                found.normal[1].as_chunks_mut().0[i] = y.store();
                found.normal[2].as_chunks_mut().0[i] = z.store();
                found.known |= asked.get() << (i * N);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::affine::Affine;
    use crate::scene::Object;
    use crate::shapes::{Box, Cylinder, Ellipsoid, Plane, Simple, Sphere, Triangle};
    use crate::simd::Level;
    use crate::testing::with_large_frames;

    fn shapes() -> Vec<Object> {
        let turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let cylinder = |capped| Cylinder { start: [0.0, 0.0, -1.0], end: [0.0, 0.0, 1.0], radius: 1.0, capped };
        let simple: Vec<Simple> = vec![
            Sphere { center: [0.0; 3], radius: 1.0 }.into(),
            Box { size: [2.0; 3], center: [0.0; 3] }.into(),
            cylinder(true).into(),
            cylinder(false).into(),
            Triangle([-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0]).into(),
            Plane::PointNormal { point: [0.0, 0.0, 1.0], normal: [0.0, 0.0, 1.0] }.into(),
        ];
        let ellipsoid = Ellipsoid::new([0.0; 3], [1.0, 1.0, 2.0], turn).map(Simple::from);
        let objects = simple.into_iter().chain(ellipsoid).map(|shape| Object::new(Geometry::Simple(shape), false));
        let sheared = Affine::new([[1.0, 0.25, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -1.0]], [0.5, 0.0, 0.0]);
        let twice = |object: &Object| object.moved(sheared)?.moved(Affine::new(turn, [0.0, 0.5, 0.0]));
        objects.flat_map(|object| [twice(&object), object.moved(sheared), Some(object)]).flatten().collect()
    }

    /// From a few origins to the points of a grid, of which many are corners, on edges, or where a line touches; and past them.
    fn rays() -> (Vec<Point>, Vec<Point>) {
        let (mut origins, mut directions) = (Vec::new(), Vec::new());
        for origin in [[0.0, 0.0, 3.0], [1.0, -4.0, 0.0], [0.25, 0.125, 0.0], [-3.0, 2.0, 1.0], [0.1, 0.2, 4.3]] {
            for k in 0..343 {
                let point = [k % 7, k / 7 % 7, k / 49].map(|i| f64::from(i) / 2.0 - 1.5);
                let direction = [point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]];
                if direction != [0.0; 3] {
                    origins.push(origin);
                    directions.push(direction);
                }
            }
        }
        (origins, directions)
    }

    #[test]
    fn lanes_find_what_single_rays_do() {
        with_large_frames(compare_levels);
    }

    fn compare_levels() {
        let (origins, directions) = rays();
        let (mut met, mut missed) = (0, 0);
        let all = shapes();
        let scenes = all.iter().map(|object| vec![object.clone()]).chain([all.clone()]);
        for objects in scenes {
            let scene = Scene::new(objects);
            for range in [(0.0, f64::INFINITY), (1.0, 3.0)] {
                let cast = |level| {
                    let mut hits = vec![Hit::MISS; origins.len()];
                    assert!(scene.cast(level, &origins, &directions, range, &mut hits[..]));
                    hits
                };
                let expected = cast(Level::Scalar);
                met += expected.iter().filter(|hit| hit.object >= 0).count();
                missed += expected.iter().filter(|hit| hit.object < 0).count();
                for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                    for (i, (hit, expected)) in cast(level).iter().zip(&expected).enumerate() {
                        let bits = |hit: &Hit| (hit.t.to_bits(), hit.normal.map(f64::to_bits), hit.object);
                        assert_eq!(bits(hit), bits(expected), "{level:?}: {:?} + t·{:?}", origins[i], directions[i]);
                    }
                }
            }
        }
        assert!(met > 5_000 && missed > 5_000, "{met}, {missed}");
    }
}
