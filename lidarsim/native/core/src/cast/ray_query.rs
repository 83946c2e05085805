//! Queries of one ray, which visit every primitive that the ray may intersect.

use crate::arith::number::Interval;
use crate::arith::simd::Portable;
use crate::bvh::{Bvh, Stack, TraversalRay, take};
use crate::cast::placed_rays::middle_of_one;
use crate::geometry::ray::Bounds;
use crate::scene::{Geometry, Primitives, Scene, TimedRay, World};
use crate::shapes::{Each, EachRay};

pub trait RayQuery<'a> {
    fn scene(&self) -> &'a Scene;
    fn ray(&self) -> &TimedRay;
    fn t_min(&self) -> f64;

    /// The largest t that still matters.
    fn limit(&self) -> f64;

    /// Whether no primitive of an object needs a visit.
    fn skips(&self, _object: u32) -> bool {
        false
    }

    /// Visits a primitive of an object.
    fn visit(&mut self, object: u32, primitive: u32);

    /// Traverses the whole scene.
    fn run(&mut self, world: &World, stack: &mut Stack) {
        for &object in &world.index.unbounded {
            if !world.ignores(object) {
                self.visit(object, 0);
            }
        }
        self.traverse(world, &world.index.bounded, stack);
        if let Some(movers) = world.movers() {
            self.traverse(world, movers, stack);
        }
    }

    fn traverse(&mut self, world: &World, hierarchy: &Bvh<u32>, stack: &mut Stack) {
        let TimedRay { origin, direction, .. } = *self.ray();
        let ray = [origin.map(Interval::point), direction.map(Interval::point)];
        self.traverse_within(hierarchy, ray, stack, |query, leaf, stack| {
            if !world.ignores(*leaf) && !query.skips(*leaf) {
                query.enter(*leaf, stack);
            }
        });
    }

    /// Traverses one object.
    fn enter(&mut self, object: u32, stack: &mut Stack) {
        match &self.scene().objects()[object as usize].geometry {
            Geometry::Surface(_) => self.visit(object, 0),
            Geometry::Mesh(mesh) => {
                if let Some(leaf) = mesh.hierarchy().only_leaf() {
                    leaf.ids().iter().for_each(|primitive| self.visit(object, *primitive));
                    return;
                }
                let ray = self.local_ray(object);
                self.traverse_within(mesh.hierarchy(), ray, stack, |query, leaf, _| {
                    leaf.ids().iter().for_each(|primitive| query.visit(object, *primitive));
                });
            }
            Geometry::Spheres(spheres) => self.traverse_primitives(object, spheres, stack),
            Geometry::Disks(disks) => self.traverse_primitives(object, disks, stack),
        }
    }

    /// The ray in the local coordinates of an object: bounds of its origin and of its direction.
    fn local_ray(&self, object: u32) -> [Bounds<f64>; 2] {
        let TimedRay { origin, direction, time } = *self.ray();
        self.scene().at(object, time).enclose(origin, direction)
    }

    /// Visits the primitives of an object except those that the ray certainly misses.
    fn traverse_primitives<S: Each<K>, const K: usize>(
        &mut self,
        object: u32,
        primitives: &Primitives<S, K>,
        stack: &mut Stack,
    ) {
        let local = self.local_ray(object);
        let [(origin, off), (direction, bent)] = local.map(middle_of_one);
        let length = direction.iter().map(|x| x.abs()).sum();
        let ray = EachRay::new(direction, length, off, bent);
        self.traverse_within(primitives.hierarchy(), local, stack, |query, leaf, _| {
            let seen = S::seen_from::<Portable>(origin, &leaf.numbers);
            let mut left = (S::candidates(&seen, &ray) & leaf.all()).into();
            while let Some(lane) = take(&mut left) {
                query.visit(object, leaf.id(lane));
            }
        });
    }

    fn traverse_within<L>(
        &mut self,
        hierarchy: &Bvh<L>,
        [origin, direction]: [Bounds<f64>; 2],
        stack: &mut Stack,
        visit: impl Fn(&mut Self, &L, &mut Stack),
    ) {
        let mut ray = TraversalRay::new(origin, direction, hierarchy.center(), self.t_min(), self.limit());
        hierarchy.traverse(&mut ray, stack, |stack, leaf| {
            visit(self, leaf, stack);
            self.limit()
        });
    }
}
