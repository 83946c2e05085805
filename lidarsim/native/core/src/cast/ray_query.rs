//! Queries of one ray, which visit every primitive that the ray may intersect.

use crate::arith::number::Interval;
use crate::bvh::{Bvh, Stack, TraversalRay};
use crate::scene::{Geometry, PrimitiveLeaf, Scene, TimedRay, World};
use crate::shapes::triangle::Leaf;

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
        let (o, d) = (origin.map(Interval::point), direction.map(Interval::point));
        let mut ray = TraversalRay::new(o, d, hierarchy.center(), self.t_min(), self.limit());
        hierarchy.traverse(&mut ray, stack, |stack, leaf| {
            if !world.ignores(*leaf) && !self.skips(*leaf) {
                self.enter(*leaf, stack);
            }
            self.limit()
        });
    }

    /// Traverses one object.
    fn enter(&mut self, object: u32, stack: &mut Stack) {
        match &self.scene().objects()[object as usize].geometry {
            Geometry::Surface(_) => self.visit(object, 0),
            Geometry::Mesh(mesh) => self.traverse_within(object, mesh.hierarchy(), Leaf::ids, stack),
            Geometry::Spheres(spheres) => {
                self.traverse_within(object, spheres.hierarchy(), PrimitiveLeaf::ids, stack);
            }
            Geometry::Disks(disks) => {
                self.traverse_within(object, disks.hierarchy(), PrimitiveLeaf::ids, stack);
            }
        }
    }

    fn traverse_within<L>(
        &mut self,
        object: u32,
        hierarchy: &Bvh<L>,
        ids: impl Fn(&L) -> &[u32],
        stack: &mut Stack,
    ) {
        if let Some(leaf) = hierarchy.only_leaf() {
            ids(leaf).iter().for_each(|primitive| self.visit(object, *primitive));
            return;
        }
        let TimedRay { origin, direction, time } = *self.ray();
        let [o, d] = self.scene().at(object, time).enclose(origin, direction);
        let mut ray = TraversalRay::new(o, d, hierarchy.center(), self.t_min(), self.limit());
        hierarchy.traverse(&mut ray, stack, |_, leaf| {
            for &primitive in ids(leaf) {
                self.visit(object, primitive);
            }
            self.limit()
        });
    }
}
