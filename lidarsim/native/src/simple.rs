//! Packets at simple shapes, a register of rays at a time: bounds of where they meet, and the double-double look at the nearest hits.
//!
//! What lanes together are not certain of is asked ray by ray.

use std::cell::Cell;

use crate::affine::{AsMade, Placement};
use crate::bvh::{LANES, Mask, Rays};
use crate::number::{Balls, DdBalls, Interval, Many, Number, Uncertain};
use crate::ray::Ray;
use crate::scene::{Geometry, Hit, Place, Scene, Search, finished};
use crate::shapes::{Surface, SurfaceTask};
use crate::simd::{Floats, Isa};
use crate::trace::Sink;
use crate::vector::{self, Vector};

/// The coordinates of part `i` of vectors, an axis each.
#[inline(always)]
fn part<F: Floats<f64, N>, const N: usize>(v: &[&[f64]; 3], i: usize) -> [F; 3] {
    [F::load(&v[0].as_chunks().0[i]), F::load(&v[1].as_chunks().0[i]), F::load(&v[2].as_chunks().0[i])]
}

/// A packet's bits of part `i`, as bits of the lanes of a register.
#[inline(always)]
fn part_of_mask<const N: usize>(mask: Mask, i: usize) -> u32 {
    (mask >> (i * N)) as u32 & ((1 << N) - 1)
}

/// Takes the lowest lane out of a mask.
#[inline(always)]
fn take(mask: &mut Mask) -> Option<usize> {
    if *mask == 0 {
        return None;
    }
    let lane = mask.trailing_zeros() as usize;
    *mask &= *mask - 1;
    Some(lane)
}

/// Offers the hits of the rays of `mask` on an object to their searches.
#[inline(always)]
pub fn meet<'s, I: Isa>(scene: &'s Scene, id: u32, rays: &Rays, searches: &mut [Search<'s>; LANES], mask: Mask) {
    let object = &scene.objects()[id as usize];
    let mut met = Met { first: Bounds::none(), second: Bounds::none(), unsure: mask };
    let alone = mask & (mask - 1) == 0;
    if !alone && let Geometry::Simple(shape) = &object.geometry {
        let (t_min, met) = (searches[0].t_min, &mut met);
        match object.placement() {
            None => shape.apart::<I, _>(Meet { placement: AsMade, rays, t_min, met }),
            Some(placement) => shape.apart::<I, _>(Meet { placement, rays, t_min, met }),
        };
    }
    let place = |index| Place { object: id, primitive: 0, index };
    let mut left = met.first.lanes;
    while let Some(lane) = take(&mut left) {
        let search = &mut searches[lane];
        if !search.takes(place(0), met.first.of(lane)) && met.second.lanes & (1 << lane) != 0 {
            search.takes(place(1), met.second.of(lane));
        }
    }
    while let Some(lane) = take(&mut met.unsure) {
        searches[lane].consider(id, 0);
    }
}

/// What a packet finds on a surface.
struct Met {
    first: Bounds,
    /// Where the first lies before the range, or may.
    second: Bounds,
    /// Rays to be asked one by one.
    unsure: Mask,
}

/// Bounds of a root of each ray that has it.
struct Bounds {
    lanes: Mask,
    low: [f64; LANES],
    high: [f64; LANES],
}

impl Bounds {
    #[inline(always)]
    fn none() -> Self {
        Bounds { lanes: 0, low: [0.0; LANES], high: [0.0; LANES] }
    }

    #[inline(always)]
    fn of(&self, lane: usize) -> Interval {
        Interval { low: self.low[lane], high: self.high[lane] }
    }

    /// Puts those of some lanes of part `i`.
    #[inline(always)]
    fn put<F: Floats<f64, N>, const N: usize>(&mut self, i: usize, lanes: u32, t: Interval<F>) {
        put_lanes(&mut self.low, i, part_of_mask::<N>(self.lanes, i), lanes, t.low);
        put_lanes(&mut self.high, i, part_of_mask::<N>(self.lanes, i), lanes, t.high);
        self.lanes |= Mask::from(lanes) << (i * N);
    }
}

/// Puts some lanes of `x` into part `i` of `all`, where those of `there` are to stay.
#[inline(always)]
fn put_lanes<F: Floats<f64, N>, const N: usize>(all: &mut [f64], i: usize, there: u32, lanes: u32, x: F) {
    let (part, x) = (&mut all.as_chunks_mut::<N>().0[i], x.store());
    if there == 0 {
        *part = x;
        return;
    }
    let mut left = Mask::from(lanes);
    while let Some(lane) = take(&mut left) {
        part[lane] = x[lane];
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
        let [[ox, oy, oz], [dx, dy, dz]] = [&rays.origin, &rays.direction];
        let rays = std::mem::take(&mut met.unsure);
        for i in 0..LANES / N {
            let mut left = part_of_mask::<N>(rays, i);
            if left == 0 {
                continue;
            }
            let asked = Cell::new(left);
            let (o, d): ([F; 3], [F; 3]) = (part(&[ox, oy, oz], i), part(&[dx, dy, dz], i));
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
        if t.low.lt(F::splat(t_min)) & asked.get() != 0
            && let Some(second) = second
        {
            let t = Number::enclose(&second)?;
            self.second.put(i, asked.get(), t);
        }
        self.first.put(i, asked.get(), t);
        Ok(())
    }
}

#[inline(always)]
fn balls<'a, F: Floats<f64, N>, const N: usize>(v: [F; 3], asked: &'a Cell<u32>) -> Vector<Balls<Many<'a, F>, N>> {
    let lanes = Many::new(asked);
    [Balls::of_rays(v[0], lanes), Balls::of_rays(v[1], lanes), Balls::of_rays(v[2], lanes)]
}

#[inline(always)]
fn dd_balls<'a, F: Floats<f64, N>, const N: usize>(v: [F; 3], asked: &'a Cell<u32>) -> Vector<DdBalls<Many<'a, F>, N>> {
    let lanes = Many::new(asked);
    [DdBalls::of_rays(v[0], lanes), DdBalls::of_rays(v[1], lanes), DdBalls::of_rays(v[2], lanes)]
}

/// Hits on simple shapes that wait for others of the same object, to be finished together.
pub struct Pending {
    groups: Vec<Group>,
}

/// Objects that may wait at once; where two of them meet in one group, the first makes way.
const GROUPS: usize = 64;

/// Hits that may wait of one object: as many as the widest register has lanes.
const SEATS: usize = 8;

#[derive(Clone, Copy)]
struct Group {
    place: Place,
    count: usize,
    at: [u32; SEATS],
    origin: [[f64; SEATS]; 3],
    direction: [[f64; SEATS]; 3],
}

impl Pending {
    pub fn new() -> Self {
        let place = Place { object: 0, primitive: 0, index: 0 };
        let (origin, direction) = ([[0.0; SEATS]; 3], [[1.0; SEATS]; 3]);
        Pending { groups: vec![Group { place, count: 0, at: [0; SEATS], origin, direction }; GROUPS] }
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
        let group = &mut self.groups[(2 * place.object as usize + usize::from(place.index)) % GROUPS];
        if (group.place.object, group.place.index) != (place.object, place.index) {
            group.flush::<I>(scene, hits);
            group.place = place;
        }
        let seat = group.count;
        group.at[seat] = at;
        for axis in 0..3 {
            group.origin[axis][seat] = search.origin[axis];
            group.direction[axis][seat] = search.direction[axis];
        }
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
        for seat in 0..self.count {
            let pick = |v: &[[f64; SEATS]; 3]| [v[0][seat], v[1][seat], v[2][seat]];
            let hit = if found.known & (1 << seat) != 0 {
                let (t, normal) = (found.t[seat], pick(&found.normal));
                Hit { t, normal, object: self.place.object as i32, primitive: object.reported(&self.place) }
            } else {
                scene.hit(&self.place, pick(&self.origin), pick(&self.direction))
            };
            hits.put(self.at[seat] as usize, hit);
        }
        self.count = 0;
    }
}

/// t and a unit normal, of the hits that are certain.
struct Found {
    known: Mask,
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
        let [[ox, oy, oz], [dx, dy, dz]] = [&group.origin, &group.direction];
        for i in 0..SEATS / N {
            let mut left = part_of_mask::<N>((1 << group.count) - 1, i);
            if left == 0 {
                continue;
            }
            let asked = Cell::new(left);
            let (o, d): ([F; 3], [F; 3]) = (part(&[ox, oy, oz], i), part(&[dx, dy, dz], i));
            let world = Ray { origin: dd_balls(o, &asked), direction: dd_balls(d, &asked), weight: None };
            let ray = placement.local(world);
            while left != 0 {
                asked.set(left);
                if let Ok((t, normal)) = finished(placement, surface, &ray, group.place.index) {
                    let there = part_of_mask::<N>(found.known, i);
                    put_lanes(&mut found.t, i, there, asked.get(), t);
                    let [x, y, z] = vector::unit(normal);
                    put_lanes(&mut found.normal[0], i, there, asked.get(), x);
                    put_lanes(&mut found.normal[1], i, there, asked.get(), y);
                    put_lanes(&mut found.normal[2], i, there, asked.get(), z);
                    found.known |= Mask::from(asked.get()) << (i * N);
                }
                left &= !asked.get();
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
    use crate::vector::Point;

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
        // Code that is not optimised has large frames.
        let thread = std::thread::Builder::new().stack_size(1 << 26).spawn(compare_levels);
        assert!(thread.is_ok_and(|thread| thread.join().is_ok()));
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
