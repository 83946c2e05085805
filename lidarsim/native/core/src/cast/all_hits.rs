//! All hits of rays, ascending.

use std::cmp::Ordering;

use crate::arith::number;
use crate::bvh::Stack;
use crate::cast::ray_query::RayQuery;
use crate::geometry::vector::Point;
use crate::scene::{BoundedRoot, Hit, Rays, RootId, Scene, TRange, TimedRay, World};
use crate::{memory, parallel};

/// Rays that a thread takes at a time.
const PIECE: usize = 256;

/// Roots beyond the requested ones that are collected before the farthest are discarded.
const SPARE: usize = 32;

/// The roots of a ray on a primitive whose rounded t is in range. A negative t is not, even if it rounds to
/// zero.
pub fn roots_in_range(
    scene: &Scene,
    ray: &TimedRay,
    TRange { min, max }: TRange,
    object: u32,
    primitive: u32,
) -> impl Iterator<Item = BoundedRoot> {
    let found = number::decide(&scene.root_intervals(object, primitive, ray));
    found.into_iter().flatten().filter(move |(at, t)| {
        if t.high < min || t.low > max {
            return false;
        }
        if min <= t.low && t.high <= max {
            return true;
        }
        let rounded = scene.t(at, ray);
        let is_negative = || rounded == 0.0 && min == 0.0 && scene.is_negative(at, ray);
        min <= rounded && rounded <= max && !is_negative()
    })
}

/// The nearest hits of one ray.
struct AllHits<'a> {
    scene: &'a Scene,
    ray: TimedRay,
    range: TRange,
    most: usize,
    /// Roots in range, with bounds of t, in any order; more than `most` only between two prunings.
    roots: Vec<BoundedRoot>,
    limit: f64,
}

impl<'a> RayQuery<'a> for AllHits<'a> {
    fn scene(&self) -> &'a Scene {
        self.scene
    }

    fn ray(&self) -> &TimedRay {
        &self.ray
    }

    fn t_min(&self) -> f64 {
        self.range.min
    }

    fn limit(&self) -> f64 {
        self.limit
    }

    fn visit(&mut self, object: u32, primitive: u32) {
        for (at, t) in roots_in_range(self.scene, &self.ray, self.range, object, primitive) {
            if t.low <= self.limit {
                memory::push(&mut self.roots, (at, t));
            }
        }
        if self.roots.len() >= self.most.saturating_add(SPARE) {
            self.prune();
        }
    }
}

/// The order of the exact t; of equal ones, the lowest object and then the lowest primitive come first.
pub(super) fn order(scene: &Scene, ray: &TimedRay, a: &BoundedRoot, b: &BoundedRoot) -> Ordering {
    let ids = |root: &RootId| (root.object, root.primitive, root.index);
    order_of_t(scene, ray, a, b).then_with(|| ids(&a.0).cmp(&ids(&b.0)))
}

/// The order of the exact t.
pub(super) fn order_of_t(scene: &Scene, ray: &TimedRay, a: &BoundedRoot, b: &BoundedRoot) -> Ordering {
    if a.1.high < b.1.low {
        Ordering::Less
    } else if b.1.high < a.1.low {
        Ordering::Greater
    } else {
        scene.compare(&a.0, &b.0, ray)
    }
}

impl AllHits<'_> {
    /// Sorts the roots, and keeps the nearest. An object that the ray meets at a common edge or corner of
    /// several primitives is hit once there.
    fn prune(&mut self) {
        let mut roots = std::mem::take(&mut self.roots);
        roots.sort_by(|a, b| order(self.scene, &self.ray, a, b));
        roots.dedup_by(|b, a| {
            a.0.object == b.0.object
                && a.1.high >= b.1.low
                && self.scene.compare(&a.0, &b.0, &self.ray) == Ordering::Equal
        });
        roots.truncate(self.most);
        if roots.len() == self.most
            && let Some((_, last)) = roots.last()
        {
            self.limit = self.limit.min(last.high);
        }
        self.roots = roots;
    }
}

/// Rows of the hits of rays, `most` per ray.
pub struct HitRows<'a> {
    pub most: usize,
    pub t: &'a mut [f64],
    pub object: &'a mut [i32],
    pub primitive: &'a mut [i32],
    /// Three coordinates each.
    pub normal: &'a mut [Point],
}

/// Writes the nearest hits of each ray with t_min ≤ t ≤ t_max in ascending order. All numbers must be
/// finite and no direction zero. Rows must be those of misses at first.
pub fn cast_all(world: &World, rays: Rays, range: TRange, rows: HitRows) {
    let HitRows { most, t, object, primitive, normal } = rows;
    let range = TRange { max: range.max.min(f64::MAX), ..range };
    let size = PIECE * most;
    let rows = t
        .chunks_mut(size)
        .zip(object.chunks_mut(size))
        .zip(primitive.chunks_mut(size).zip(normal.chunks_mut(size)))
        .enumerate();
    parallel::share(rows, |(piece, ((t, object), (primitive, normal)))| {
        let mut stack = Stack::new();
        let mut query = AllHits {
            scene: world.scene,
            ray: TimedRay { origin: [0.0; 3], direction: [0.0; 3], time: 0.0 },
            range,
            most,
            roots: Vec::new(),
            limit: range.max,
        };
        for row in 0..t.len() / most {
            let i = piece * PIECE + row;
            let time = rays.times.get(i).copied().unwrap_or(0.0);
            query.ray = TimedRay { origin: rays.origins.of(i), direction: rays.directions[i], time };
            query.limit = range.max;
            query.run(world, &mut stack);
            query.prune();
            for (place, (root, bounds)) in (row * most..).zip(query.roots.drain(..)) {
                let hit = world.scene.hit_within(&root, bounds, &query.ray);
                let Hit { t: at, normal: along, object: id, primitive: part } = hit;
                (t[place], normal[place], object[place], primitive[place]) = (at, along, id, part);
            }
        }
    });
}
