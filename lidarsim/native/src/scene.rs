//! Objects, and the nearest of them along a ray.

use std::cmp::Ordering;
use std::sync::{Arc, OnceLock};

use crate::affine::{Adjugate, Affine};
use crate::bvh::{Bvh, Span, Stack};
use crate::number::{self, DdBall, Interval, Number, Question, Uncertain};
use crate::ray::Ray;
use crate::root::{Root, Roots};
use crate::shapes::{Simple, Surface, Triangle, TriangleMesh};
use crate::vector::{self, Point};

/// What an object looks like in its own coordinates.
#[derive(Clone, Debug)]
pub enum Geometry {
    Simple(Simple),
    Mesh(Arc<TriangleMesh>),
}

/// A geometry and the maps that take it into the world, the first one first.
#[derive(Clone, Debug)]
pub struct Object {
    pub geometry: Geometry,
    maps: Vec<Affine>,
    /// A mesh whose triangles are parts of one primitive, as those of a polygon are.
    whole: bool,
}

impl Object {
    pub fn new(geometry: Geometry, whole: bool) -> Self {
        Object { geometry, maps: Vec::new(), whole }
    }

    /// The object moved by one more map.
    pub fn moved(&self, map: Affine) -> Self {
        let mut object = self.clone();
        if !map.is_identity() {
            object.maps.push(map);
        }
        object
    }

    /// A triangle of a mesh: its vertices, and where they are in the world, rounded.
    pub fn corners(&self, primitive: u32) -> Option<([u32; 3], [Point; 3])> {
        let Geometry::Mesh(mesh) = &self.geometry else { return None };
        let vertices = *mesh.faces().get(primitive as usize)?;
        let place = |v: u32| self.maps.iter().fold(mesh.vertices()[v as usize], |p, map| map.place(p));
        Some((vertices, vertices.map(place)))
    }

    fn local<N: Number>(&self, origin: Point, direction: Point) -> Result<Ray<N>, Uncertain> {
        let ray = Ray::new(origin, direction);
        self.maps.iter().rev().try_fold(ray, |ray, map| Ok(Adjugate::new(map)?.apply(&ray)))
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        let local = match &self.geometry {
            Geometry::Simple(shape) => shape.bounds()?,
            Geometry::Mesh(mesh) => mesh.bounds()?,
        };
        let bounds = self.maps.iter().fold(local, |bounds, map| map.image(bounds));
        Some(bounds.map(|b| Interval {
            low: if b.low.is_nan() { f64::NEG_INFINITY } else { b.low },
            high: if b.high.is_nan() { f64::INFINITY } else { b.high },
        }))
    }

    fn is_empty(&self) -> bool {
        matches!(&self.geometry, Geometry::Mesh(mesh) if mesh.is_empty())
    }

    fn roots<N: Number>(&self, primitive: u32, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        match &self.geometry {
            Geometry::Simple(shape) => shape.roots(ray),
            Geometry::Mesh(mesh) => mesh.triangle(primitive).roots(ray),
        }
    }

    fn root<N: Number>(&self, at: &Place, origin: Point, direction: Point) -> Result<Root<N>, Uncertain> {
        let roots = self.roots(at.primitive, &self.local(origin, direction)?)?;
        let [first, second] = roots;
        (if at.index == 0 { first } else { second }).ok_or(Uncertain)
    }

    /// The unit normal in the world.
    fn normal(&self, at: &Place, origin: Point, direction: Point, t: f64) -> Point {
        let normal = || -> Result<Point, Uncertain> {
            let ray = self.local::<DdBall>(origin, direction)?;
            let t = self
                .root::<DdBall>(at, origin, direction)
                .and_then(|root| DdBall::of_root(&root))
                .unwrap_or(DdBall::exact(t));
            let mut normal = match &self.geometry {
                Geometry::Simple(shape) => shape.normal(&ray, t, at.feature),
                Geometry::Mesh(mesh) => mesh.triangle(at.primitive).normal(&ray, t, at.feature),
            };
            for map in &self.maps {
                normal = Adjugate::new(map)?.normal(&normal);
            }
            Ok(vector::unit(normal.map(DdBall::value)))
        };
        normal().unwrap_or([0.0; 3])
    }
}

/// Which root of which primitive.
#[derive(Clone, Copy, Debug)]
struct Place {
    object: u32,
    primitive: u32,
    index: u8,
    feature: u8,
}

/// Where a ray first meets the scene.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// In units of the length of the direction, correctly rounded; infinite for a miss.
    pub t: f64,
    /// Unit, outward as the shape defines it.
    pub normal: Point,
    /// −1 for a miss.
    pub object: i32,
    /// Triangle of a mesh; else 0.
    pub primitive: i32,
}

impl Hit {
    pub const MISS: Hit = Hit { t: f64::INFINITY, normal: [0.0; 3], object: -1, primitive: 0 };
}

#[derive(Clone, Debug, Default)]
pub struct Scene {
    objects: Vec<Object>,
    index: OnceLock<Index>,
}

#[derive(Clone, Debug)]
struct Index {
    /// Objects without an end, asked by every ray.
    unbounded: Vec<u32>,
    bounded: Bvh,
}

impl Scene {
    pub fn new(objects: Vec<Object>) -> Self {
        Scene { objects, index: OnceLock::new() }
    }

    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Builds the hierarchies that are not there yet, with the threads of the pool that this is called in.
    pub fn prepare(&self) {
        for object in &self.objects {
            if let Geometry::Mesh(mesh) = &object.geometry {
                mesh.hierarchy();
            }
        }
        self.index();
    }

    fn index(&self) -> &Index {
        self.index.get_or_init(|| {
            let bounds: Vec<_> = self.objects.iter().map(Object::bounds).collect();
            let endless = |&i: &usize| bounds[i].is_none() && !self.objects[i].is_empty();
            let unbounded = (0..bounds.len()).filter(endless).map(|i| i as u32).collect();
            Index { unbounded, bounded: Bvh::new(&bounds) }
        })
    }

    /// The nearest hit of each ray with t_min ≤ t ≤ t_max, on this thread. Of equal t the lowest object comes first, then the
    /// lowest primitive.
    pub fn cast(&self, origins: &[Point], directions: &[Point], t_min: f64, t_max: f64, hits: &mut [Hit]) {
        let mut stack = Stack::new();
        for ((&origin, &direction), hit) in origins.iter().zip(directions).zip(hits) {
            *hit = Search { scene: self, origin, direction, t_min, t_max, best: None }.run(&mut stack);
        }
    }

    /// Every t, ascending and distinct, at which the line meets the object.
    pub fn roots(&self, object: u32, origin: Point, direction: Point) -> Vec<f64> {
        let primitives = self.primitives_on_line(object, origin, direction);
        let mut places: Vec<Place> = Vec::new();
        for primitive in primitives {
            let found = number::certify(&Candidates { object: &self.objects[object as usize], primitive, origin, direction });
            for (index, (_, feature)) in found.iter().flatten().enumerate() {
                places.push(Place { object, primitive, index: index as u8, feature: *feature });
            }
        }
        let order = |a: &Place, b: &Place| number::certify(&Compare { scene: self, a, b, origin, direction });
        places.sort_by(order);
        places.dedup_by(|a, b| order(a, b) == Ordering::Equal);
        places.iter().map(|at| self.t(at, origin, direction)).collect()
    }

    fn primitives_on_line(&self, object: u32, origin: Point, direction: Point) -> Vec<u32> {
        let object = &self.objects[object as usize];
        let Geometry::Mesh(mesh) = &object.geometry else { return vec![0] };
        let mut found = Vec::new();
        let mut stack = Stack::new();
        for direction in [direction, direction.map(|x| -x)] {
            let (o, d) = number::certify(&Enclose { object, origin, direction });
            let hierarchy = mesh.hierarchy();
            let mut span = Span::new(o, d, hierarchy.center(), 0.0, f64::INFINITY);
            hierarchy.traverse(&mut span, &mut stack, |_, leaf| {
                found.extend_from_slice(&hierarchy.order[leaf]);
                f64::INFINITY
            });
        }
        found.sort_unstable();
        found.dedup();
        found
    }

    fn t(&self, at: &Place, origin: Point, direction: Point) -> f64 {
        number::certify_finely(&Rounded { object: &self.objects[at.object as usize], at, origin, direction })
    }
}

/// The search for the nearest hit of one ray.
struct Search<'a> {
    scene: &'a Scene,
    origin: Point,
    direction: Point,
    t_min: f64,
    t_max: f64,
    best: Option<(Place, Interval)>,
}

impl Search<'_> {
    fn run(mut self, stack: &mut Stack) -> Hit {
        let index = self.scene.index();
        for &object in &index.unbounded {
            self.consider(object, 0);
        }
        let (o, d) = (self.origin.map(Interval::point), self.direction.map(Interval::point));
        let mut span = Span::new(o, d, index.bounded.center(), self.t_min, self.limit());
        index.bounded.traverse(&mut span, stack, |stack, leaf| {
            for &object in &index.bounded.order[leaf] {
                match &self.scene.objects[object as usize].geometry {
                    Geometry::Simple(_) => self.consider(object, 0),
                    Geometry::Mesh(mesh) => self.enter(object, mesh, stack),
                }
            }
            self.limit()
        });
        let Some((at, _)) = self.best else { return Hit::MISS };
        let object = &self.scene.objects[at.object as usize];
        let t = self.scene.t(&at, self.origin, self.direction);
        Hit {
            t,
            normal: object.normal(&at, self.origin, self.direction, t),
            object: at.object as i32,
            primitive: if object.whole { 0 } else { at.primitive as i32 },
        }
    }

    /// Nothing beyond this t is nearer.
    fn limit(&self) -> f64 {
        self.best.map_or(self.t_max, |(_, t)| t.high.min(self.t_max))
    }

    fn enter(&mut self, id: u32, mesh: &TriangleMesh, stack: &mut Stack) {
        let object = &self.scene.objects[id as usize];
        let (o, d) = if object.maps.is_empty() {
            (self.origin.map(Interval::point), self.direction.map(Interval::point))
        } else {
            number::certify(&Enclose { object, origin: self.origin, direction: self.direction })
        };
        let hierarchy = mesh.hierarchy();
        let filter = Filter::new(o, d);
        let mut span = Span::new(o, d, hierarchy.center(), self.t_min, self.limit());
        hierarchy.traverse(&mut span, stack, |_, leaf| {
            for &primitive in &hierarchy.order[leaf] {
                if !filter.surely_misses(&mesh.triangle(primitive)) {
                    self.consider(id, primitive);
                }
            }
            self.limit()
        });
    }

    /// Keeps the primitive's first hit in range if it is the nearest so far.
    fn consider(&mut self, id: u32, primitive: u32) {
        let (origin, direction) = (self.origin, self.direction);
        let object = &self.scene.objects[id as usize];
        let found = number::certify(&Candidates { object, primitive, origin, direction });
        for (index, &(t, feature)) in found.iter().flatten().enumerate() {
            let at = Place { object: id, primitive, index: index as u8, feature };
            // The range is that of the rounded t: rounding is monotone, so bounds of t settle it but for the last ulps.
            let rounded = || self.scene.t(&at, origin, direction);
            if t.high < self.t_min || (t.low < self.t_min && rounded() < self.t_min) {
                continue;
            }
            if t.low > self.limit() || (t.high > self.t_max && rounded() > self.t_max) {
                return;
            }
            if self.best.as_ref().is_none_or(|(best, bounds)| {
                t.high < bounds.low
                    || match number::certify(&Compare { scene: self.scene, a: &at, b: best, origin, direction }) {
                        Ordering::Less => true,
                        Ordering::Equal => (id, primitive) < (best.object, best.primitive),
                        Ordering::Greater => false,
                    }
            }) {
                self.best = Some((at, t));
            }
            return;
        }
    }
}

/// The roots of a primitive: bounds of each, and the part of the surface.
struct Candidates<'a> {
    object: &'a Object,
    primitive: u32,
    origin: Point,
    direction: Point,
}

impl Question for Candidates<'_> {
    type Answer = [Option<(Interval, u8)>; 2];

    #[inline]
    fn ask<N: Number>(&self) -> Result<Self::Answer, Uncertain> {
        let roots = self.object.roots::<N>(self.primitive, &self.object.local(self.origin, self.direction)?)?;
        let mut found = [None; 2];
        for (found, root) in found.iter_mut().zip(roots.iter().flatten()) {
            *found = Some((N::enclose(root)?, root.feature));
        }
        Ok(found)
    }
}

struct Compare<'a> {
    scene: &'a Scene,
    a: &'a Place,
    b: &'a Place,
    origin: Point,
    direction: Point,
}

impl Question for Compare<'_> {
    type Answer = Ordering;

    fn ask<N: Number>(&self) -> Result<Ordering, Uncertain> {
        let root = |at: &Place| self.scene.objects[at.object as usize].root::<N>(at, self.origin, self.direction);
        N::compare(&root(self.a)?, &root(self.b)?)
    }
}

struct Rounded<'a> {
    object: &'a Object,
    at: &'a Place,
    origin: Point,
    direction: Point,
}

impl Question for Rounded<'_> {
    type Answer = f64;

    fn ask<N: Number>(&self) -> Result<f64, Uncertain> {
        N::round(&self.object.root::<N>(self.at, self.origin, self.direction)?)
    }
}

/// Bounds of the ray in the coordinates of an object.
struct Enclose<'a> {
    object: &'a Object,
    origin: Point,
    direction: Point,
}

impl Question for Enclose<'_> {
    type Answer = ([Interval; 3], [Interval; 3]);

    fn ask<N: Number>(&self) -> Result<Self::Answer, Uncertain> {
        self.object.local::<N>(self.origin, self.direction)?.enclose()
    }
}

/// A quick float64 test that rules out most triangles of a leaf.
struct Filter {
    origin: Point,
    direction: Point,
    /// Bounds of the errors of origin and direction, and 1-norm of the direction.
    origin_error: f64,
    direction_error: f64,
    length: f64,
}

impl Filter {
    fn new(origin: [Interval; 3], direction: [Interval; 3]) -> Self {
        let middle = |x: Interval| if x.low == x.high { x.low } else { 0.5 * x.low + 0.5 * x.high };
        let error = |v: [Interval; 3]| v.iter().fold(0.0_f64, |e, x| e.max(x.high - x.low));
        let d = direction.map(middle);
        Filter {
            origin: origin.map(middle),
            direction: d,
            origin_error: error(origin),
            direction_error: error(direction),
            length: d[0].abs() + d[1].abs() + d[2].abs(),
        }
    }

    /// Whether two of the signs of `Triangle` differ beyond all rounding.
    ///
    /// With m the largest coordinate of a, b, c, each off by at most δ = u·m + ε, a minor of two of them is off by at most
    /// 4mδ + 2δ² + 3u·m² + …, so by less than 8m(u·m + ε) while ε ≤ m; the sum of three products with d adds 4u·2m² a unit of |d|₁, and
    /// the error of d 2m² times 3 of it. All in all less than m·(|d|₁·(16u·m + 8ε) + 6m·ε_d), doubled here for the roundings of the
    /// bound and ε > m (then the bound exceeds every sign).
    #[inline(always)]
    fn surely_misses(&self, triangle: &Triangle) -> bool {
        let relative = |v: Point| [v[0] - self.origin[0], v[1] - self.origin[1], v[2] - self.origin[2]];
        let (a, b, c) = (relative(triangle.0), relative(triangle.1), relative(triangle.2));
        let d = self.direction;
        let volume = |p: Point, q: Point| {
            d[0] * (p[1] * q[2] - p[2] * q[1]) + d[1] * (p[2] * q[0] - p[0] * q[2]) + d[2] * (p[0] * q[1] - p[1] * q[0])
        };
        let (u, v, w) = (volume(c, b), volume(a, c), volume(b, a));
        let m = [a, b, c].iter().flatten().fold(self.origin_error, |m, x| m.max(x.abs()));
        let bound = 2.0
            * m
            * (self.length * (16.0 * number::UNIT * m + 8.0 * self.origin_error) + 6.0 * m * self.direction_error)
            + f64::MIN_POSITIVE;
        u.min(v).min(w) < -bound && u.max(v).max(w) > bound
    }
}
