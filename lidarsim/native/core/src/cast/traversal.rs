//! The two-level traversal of a scene by packets: through the hierarchy of objects, and inside it the
//! hierarchies of meshes.
//!
//! ```text
//! for each of two packets in turn:              (`Advance`: one waits for memory while the other goes on)
//!     intersect the unbounded objects
//!     if the packet is incoherent:              trace its rays one by one
//!     for each hierarchy of objects (those that stand still, then those that move), nearest box first:
//!         at a surface:                         bound its roots, and keep the nearest
//!         at a mesh, or at many shapes:         take the rays that enter into its coordinates
//!             for those of each octant:         traverse its hierarchy, nearest box first
//!                 at a leaf:                    test its triangles; defer what is uncertain
//!         lower the limits of rays with nearer hits
//!     resolve what is deferred, exactly
//! ```
//!
//! | word | meaning | in the code |
//! |---|---|---|
//! | outer, inner | traversal of objects; of the primitives in one | `Traversal::outer`, `inner` |
//! | visit | of an object that holds primitives, by the rays that may hit it | `ObjectVisit` |
//! | pending | rays of other octants, yet to traverse the visited object | `PacketState::pending` |
//! | limit | t beyond which a ray needs no hit | `ClosestHits::limits` |
//! | step | from one node with children to the next; then the other packet goes on | `Traversal::step` |
//! | stage | whether a packet has rays, and has begun | `Stage` |

use std::marker::PhantomData;

use crate::arith::simd::{Isa, Task};
use crate::bvh::{
    BoxFrame, Bvh, Crossings, EnterHierarchy, LANES, Mask, Packet, PacketTraversal, RayPacket, Stack,
    Visitor, all, take,
};
use crate::cast::closest_hit::ClosestHits;
use crate::cast::deferred::DeferredCandidates;
use crate::cast::grazing::{FindCrossings, grazing};
use crate::cast::instances_met::InstancesMet;
use crate::cast::leaf_intersector::{LeafIntersector, LeafScratch};
use crate::cast::placed_rays::PlacedRays;
use crate::cast::poses::Poses;
use crate::cast::primitive_intersector::PrimitiveIntersector;
use crate::cast::surface_intersector::{IntersectSurface, SurfaceIntersector};
use crate::geometry::vector::Point;
use crate::scene::{Disks, Geometry, Object, Primitives, Scene, Spheres, TRange, TriangleMesh, World};
use crate::shapes::triangle::Leaf;
use crate::shapes::{Disk, Each, Sphere};

/// The number of interleaved packets: one goes on while the other waits for memory.
pub const TRAVERSALS: usize = 2;

/// Scratch memory of the traversal of a packet, reused from packet to packet.
pub struct TraversalScratch {
    rays: RayPacket,
    near_rays: Option<Box<RayPacket>>,
    stack: Stack,
    /// Through the objects.
    outer: PacketTraversal,
    /// Inside a mesh.
    inner: PacketTraversal,
    deferred: DeferredCandidates,
    placed_rays: Option<Box<PlacedRays>>,
    crossings: Option<Box<Crossings>>,
    poses: Poses<LANES>,
    scratch: LeafScratch,
}

impl TraversalScratch {
    pub fn new() -> Self {
        TraversalScratch {
            rays: RayPacket::empty(),
            near_rays: None,
            stack: Stack::new(),
            outer: PacketTraversal::new(),
            inner: PacketTraversal::new(),
            deferred: DeferredCandidates::new(),
            placed_rays: None,
            crossings: None,
            poses: Poses::new(),
            scratch: LeafScratch::new(),
        }
    }
}

/// The traversal of a scene by a packet.
pub struct Traversal<'a, 'b> {
    pub state: PacketState<'a, 'b>,
    world: &'a World<'a>,
    /// The hierarchy of objects being traversed, and the next one: moving objects follow those that stand
    /// still.
    hierarchy: &'a Bvh<u32>,
    later: Option<&'a Bvh<u32>>,
    stage: Stage,
    stack: &'b mut Stack,
    /// Through the objects.
    outer: &'b mut PacketTraversal,
    /// Inside a mesh.
    inner: &'b mut PacketTraversal,
    visit: Option<ObjectVisit<'a>>,
}

#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Idle,
    Ready,
    UnderWay,
}

/// The visit of an object that holds primitives, placed in the scene as an instance, by a packet.
#[derive(Clone, Copy)]
struct ObjectVisit<'a> {
    id: u32,
    object: &'a Object,
    hierarchy: Hierarchy<'a>,
    /// The rays that may intersect it.
    entered: Mask,
}

/// The hierarchy of an object over its primitives.
#[derive(Clone, Copy)]
enum Hierarchy<'a> {
    Mesh(&'a TriangleMesh, &'a Bvh<Leaf>),
    Spheres(&'a Spheres),
    Disks(&'a Disks),
}

impl<'a> Hierarchy<'a> {
    #[inline(always)]
    fn of(geometry: &'a Geometry) -> Option<Self> {
        Some(match geometry {
            Geometry::Surface(_) => return None,
            Geometry::Mesh(mesh) => Hierarchy::Mesh(mesh, mesh.hierarchy()),
            Geometry::Spheres(spheres) => Hierarchy::Spheres(spheres),
            Geometry::Disks(disks) => Hierarchy::Disks(disks),
        })
    }

    #[inline(always)]
    fn frame(self) -> BoxFrame {
        match self {
            Hierarchy::Mesh(_, hierarchy) => hierarchy.frame(),
            Hierarchy::Spheres(spheres) => spheres.hierarchy().frame(),
            Hierarchy::Disks(disks) => disks.hierarchy().frame(),
        }
    }
}

impl<'a, 'b> Traversal<'a, 'b> {
    pub fn new(world: &'a World, range: TRange, any: bool, scratch: &'b mut TraversalScratch) -> Self {
        let TraversalScratch {
            rays,
            near_rays,
            stack,
            outer,
            inner,
            deferred,
            placed_rays,
            crossings,
            poses,
            scratch,
        } = scratch;
        let scene = world.scene;
        let closest = ClosestHits::new(scene, range, any);
        Traversal {
            state: PacketState {
                scene,
                rays,
                near_rays,
                are_far: false,
                closest,
                instances: None,
                deferred,
                pending: 0,
                placed_rays,
                crossings,
                poses,
                scratch,
            },
            world,
            hierarchy: &world.index.bounded,
            later: None,
            stage: Stage::Idle,
            stack,
            outer,
            inner,
            visit: None,
        }
    }

    pub fn is_idle(&self) -> bool {
        self.stage == Stage::Idle
    }

    /// Marks the packet as filled with new rays.
    pub fn make_ready(&mut self) {
        self.stage = Stage::Ready;
    }

    /// The stack, for a single ray while the packet is idle.
    pub fn stack(&mut self) -> &mut Stack {
        self.stack
    }

    /// Continues to a node with children that rays may enter, and stops there: the nearest child is next, but
    /// has only just been prefetched; all others have had time to arrive. False if nothing is left.
    #[inline(always)]
    fn step<I: Isa>(&mut self, surfaces: &mut SurfaceIntersector) -> bool {
        if self.stage == Stage::Ready {
            self.start::<I>(surfaces);
        }
        loop {
            while let Some(visit) = self.visit {
                if !self.inner.next_entry::<I>(self.stack, self.state.closest.limits()) {
                    self.continue_visit::<I>(visit);
                    continue;
                }
                let waits = match visit.hierarchy {
                    Hierarchy::Mesh(mesh, hierarchy) => {
                        if let Some(leaf) = hierarchy.leaf(self.inner) {
                            let mut leaves = self.state.leaf_intersector(visit, mesh);
                            let nearer = leaves.intersect::<I>(leaf, self.inner.mask());
                            self.inner.lower_limits(nearer);
                            false
                        } else {
                            hierarchy.open::<I>(self.inner, self.stack)
                        }
                    }
                    Hierarchy::Spheres(spheres) => self.step_within::<I, _, _>(visit, spheres),
                    Hierarchy::Disks(disks) => self.step_within::<I, _, _>(visit, disks),
                };
                if waits {
                    return true;
                }
            }
            if !self.outer.next_entry::<I>(self.stack, self.state.closest.limits()) {
                let Some(hierarchy) = self.later.take() else { return false };
                self.start_in::<I>(hierarchy);
            } else if let Some(&id) = self.hierarchy.leaf(self.outer) {
                self.intersect::<I>(id, surfaces);
            } else if self.hierarchy.open::<I>(self.outer, self.stack) {
                return true;
            }
        }
    }

    /// A step in the hierarchy of primitives. Returns whether rays may enter children of a node.
    #[inline(always)]
    fn step_within<I: Isa, S: Each<K>, const K: usize>(
        &mut self,
        visit: ObjectVisit<'a>,
        primitives: &'a Primitives<S, K>,
    ) -> bool {
        let Traversal { state, stack, inner, .. } = self;
        I::call(StepWithin { state, visit, primitives, inner, stack })
    }

    #[inline(always)]
    fn start<I: Isa>(&mut self, surfaces: &mut SurfaceIntersector) {
        let Traversal { state, stack, outer, inner, .. } = self;
        let world = self.world;
        self.stage = Stage::UnderWay;
        state.closest.restart::<I>();
        outer.stop(stack);
        let active = all(state.rays.count);
        for &object in &world.index.unbounded {
            if !world.ignores(object) {
                let asked = state.remaining(object, active);
                let nearer = state.intersect_surface::<I>(object, asked, surfaces);
                state.leave::<I>(object, nearer);
            }
        }
        if state.rays.count == 1 || !state.rays.are_coherent::<I>(world.size) {
            I::call(Incoherent {
                state,
                world,
                packets: [&mut outer.packet, &mut inner.packet],
                stack,
                surfaces,
            });
            return;
        }
        state.rays.compare_origins::<I>();
        self.later = world.movers();
        self.start_in::<I>(&world.index.bounded);
    }

    /// Begins the traversal of a hierarchy of objects.
    #[inline(always)]
    fn start_in<I: Isa>(&mut self, hierarchy: &'a Bvh<u32>) {
        self.hierarchy = hierarchy;
        let Traversal { state, stack, outer, .. } = self;
        let active = all(state.rays.count);
        state.approach::<I>(hierarchy);
        match hierarchy.only_leaf() {
            // The root of the mesh's own hierarchy does the same test as the hierarchy of objects.
            Some(&id) if !state.scene.objects()[id as usize].is_surface() => {
                if !self.world.ignores(id) {
                    self.enter::<I>(id, active);
                }
            }
            _ => {
                state.fill::<I>(&mut outer.packet, hierarchy);
                hierarchy.start::<I>(outer, active, stack);
            }
        }
    }

    #[inline(always)]
    fn intersect<I: Isa>(&mut self, id: u32, surfaces: &mut SurfaceIntersector) {
        if self.world.ignores(id) {
            return;
        }
        let mask = self.outer.mask();
        if self.state.scene.objects()[id as usize].is_surface() {
            let asked = self.state.remaining(id, mask);
            let nearer = self.state.intersect_surface::<I>(id, asked, surfaces);
            self.outer.lower_limits(self.state.leave::<I>(id, nearer));
        } else {
            self.enter::<I>(id, mask);
        }
    }

    /// Begins a visit of an object.
    #[inline(always)]
    fn enter<I: Isa>(&mut self, id: u32, mask: Mask) {
        let asked = self.state.remaining(id, mask);
        I::call(StartWithin { traversal: self, new: Some((id, asked)) });
    }

    /// Traverses the visited object with the next rays, or ends the visit if none are left.
    #[inline(always)]
    fn continue_visit<I: Isa>(&mut self, visit: ObjectVisit<'a>) {
        if self.state.pending == 0 {
            self.outer.lower_limits(self.state.leave::<I>(visit.id, visit.entered));
            self.visit = None;
        } else {
            I::call(StartWithin { traversal: self, new: None });
        }
    }
}

/// Interleaves the traversals of packets, one step each in turn, which hides the latency of memory. Returns
/// one that has ended; `None` if all were idle.
pub struct Advance<'t, 'a, 'b> {
    pub traversals: &'t mut [Traversal<'a, 'b>],
    pub surfaces: &'t mut SurfaceIntersector,
}

impl Task for Advance<'_, '_, '_> {
    type Output = Option<usize>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        let Advance { traversals, surfaces } = self;
        let (mut going, mut count) = ([0; TRAVERSALS], 0);
        for (k, traversal) in traversals.iter().enumerate() {
            going[count] = k;
            count += usize::from(!traversal.is_idle());
        }
        if count == 0 {
            return None;
        }
        let mut turn = 0;
        loop {
            let k = going[turn];
            if !traversals[k].step::<I>(surfaces) {
                traversals[k].stage = Stage::Idle;
                traversals[k].state.resolve::<I>();
                return Some(k);
            }
            turn = if turn + 1 < count { turn + 1 } else { 0 };
        }
    }
}

/// The state of a packet: its rays, their closest hits so far, and the deferred candidates.
pub struct PacketState<'a, 'b> {
    scene: &'a Scene,
    pub rays: &'b mut RayPacket,
    /// The rays with starts near the traversed hierarchy, if they come from far away.
    near_rays: &'b mut Option<Box<RayPacket>>,
    are_far: bool,
    pub closest: ClosestHits<'a>,
    /// In a query for instances; then each object is intersected as if it stood alone.
    pub instances: Option<InstancesMet<'a>>,
    deferred: &'b mut DeferredCandidates,
    /// Rays yet to traverse the visited mesh.
    pending: Mask,
    placed_rays: &'b mut Option<Box<PlacedRays>>,
    /// Where rays cross the plane of the visited mesh.
    crossings: &'b mut Option<Box<Crossings>>,
    poses: &'b mut Poses<LANES>,
    scratch: &'b mut LeafScratch,
}

impl<'a> PacketState<'a, '_> {
    /// The rays of `mask` for which an object is to be intersected.
    #[inline(always)]
    fn remaining(&self, id: u32, mask: Mask) -> Mask {
        self.instances.as_ref().map_or(mask, |instances| instances.remaining(id, mask))
    }

    /// Ends the intersection of an object, which may have decreased the limits of rays, and returns those for
    /// which it has. In a query for instances, no object hides another.
    #[inline(always)]
    fn leave<I: Isa>(&mut self, id: u32, nearer: Mask) -> Mask {
        if self.instances.is_none() {
            return nearer;
        }
        if nearer != 0 {
            self.resolve::<I>();
            let found = self.closest.hits::<I>();
            self.closest.restart::<I>();
            if let Some(instances) = &mut self.instances {
                instances.meet(id, found);
            }
        }
        0
    }

    #[inline(always)]
    fn intersect_surface<I: Isa>(&mut self, id: u32, mask: Mask, surfaces: &mut SurfaceIntersector) -> Mask {
        let PacketState { rays, closest, poses, .. } = self;
        I::call(IntersectSurface { surfaces, rays, closest, poses, id, mask })
    }

    /// Moves the starts of rays from far away close to a hierarchy of objects.
    #[inline(always)]
    fn approach<I: Isa>(&mut self, hierarchy: &Bvh<u32>) {
        let (center, reach) = (hierarchy.center(), hierarchy.frame().longest_reach());
        self.are_far = self.rays.are_far(center, reach);
        if self.are_far {
            I::call(Approach { rays: self.rays, near_rays: self.near_rays, center, reach });
        }
    }

    /// The rays, with starts near the hierarchy if they come from far away.
    #[inline(always)]
    fn near_rays(&self) -> &RayPacket {
        match &*self.near_rays {
            Some(near_rays) if self.are_far => near_rays,
            _ => self.rays,
        }
    }

    /// Sets up a packet for the hierarchy of objects.
    #[inline(always)]
    fn fill<I: Isa>(&self, packet: &mut Packet, hierarchy: &Bvh<u32>) {
        let (t_min, limits) = (self.closest.t_min(), self.closest.limits());
        I::call(EnterHierarchy {
            packet,
            rays: self.near_rays(),
            crossings: None,
            frame: hierarchy.frame(),
            t_min,
            limits,
        });
    }

    /// Sets up a packet for a mesh, with the rays that `next` chose last.
    #[inline(always)]
    fn fill_within<I: Isa>(&mut self, packet: &mut Packet, visit: ObjectVisit) {
        self.scratch.bounds = None;
        let frame = visit.hierarchy.frame();
        let (t_min, limits) = (self.closest.t_min(), self.closest.limits());
        packet.enter::<I>(self.rays_in(visit), self.crossings.as_deref(), frame, t_min, limits);
    }

    /// Begins a visit of an object, with rays in local coordinates; `None` if the object is not a mesh. Rays
    /// that do not fit into packets are traced singly.
    #[inline(always)]
    fn enter<I: Isa>(&mut self, id: u32, mask: Mask, stack: &mut Stack) -> Option<ObjectVisit<'a>> {
        let object = &self.scene.objects()[id as usize];
        let hierarchy = Hierarchy::of(&object.geometry)?;
        let (mut local, mut then) = (&*self.rays, None);
        self.pending = mask;
        if !object.is_untransformed() {
            let placed_rays = self.placed_rays.get_or_insert_with(|| Box::new(PlacedRays::new()));
            then = self.poses.gather::<I>(self.scene, id, &self.rays.time, mask);
            self.pending = placed_rays.gather::<I>(object, then, self.rays, mask);
            let mut alone = mask & !self.pending;
            while let Some(lane) = take(&mut alone) {
                self.closest.enter(self.rays, lane, id, stack);
            }
            local = placed_rays.all_rays();
        }
        if let Some(crossings) = self.crossings {
            crossings.rays = 0;
        }
        let frame = hierarchy.frame();
        if let Some((axis, rays)) = grazing::<I>(local, self.pending, frame) {
            let crossings = self.crossings.get_or_insert_with(|| Box::new(Crossings::NONE));
            let (world, plane) = (&*self.rays, frame.planes[axis]);
            I::call(FindCrossings { object, then, world, rays, axis, plane, crossings });
        }
        Some(ObjectVisit { id, object, hierarchy, entered: mask })
    }

    /// Takes the next of the pending rays, all of one octant.
    #[inline(always)]
    fn next<I: Isa>(&mut self, visit: ObjectVisit) -> Mask {
        let mut next = self.pending;
        if !visit.object.is_untransformed()
            && let Some(placed_rays) = self.placed_rays.as_mut()
        {
            next = placed_rays.next::<I>(next);
            let frame = visit.hierarchy.frame();
            let (center, reach) = (frame.center, frame.longest_reach());
            if placed_rays.rays().are_far(center, reach) {
                placed_rays.rays_mut().start_near::<I>(center, reach);
            }
        }
        self.pending &= !next;
        next
    }

    /// The rays that `next` chose last, in the coordinates of the mesh.
    #[inline(always)]
    fn rays_in(&self, visit: ObjectVisit) -> &RayPacket {
        match &self.placed_rays {
            Some(placed_rays) if !visit.object.is_untransformed() => placed_rays.rays(),
            _ => self.near_rays(),
        }
    }

    #[inline(always)]
    fn leaf_intersector(
        &mut self,
        visit: ObjectVisit<'a>,
        mesh: &'a TriangleMesh,
    ) -> LeafIntersector<'_, 'a> {
        let PacketState { scene, closest, scratch, .. } = self;
        let world = &*self.rays;
        let ObjectVisit { id, object, .. } = visit;
        let transformed = !object.is_untransformed();
        let rays = match (&self.placed_rays, &self.near_rays) {
            (Some(placed_rays), _) if transformed => placed_rays.rays(),
            (_, Some(near_rays)) if self.are_far => &**near_rays,
            _ => world,
        };
        let can_defer = !transformed || object.is_placed_triangle();
        let deferred = if can_defer { Some(&mut *self.deferred) } else { None };
        LeafIntersector { scene, mesh, id, rays, world, closest, transformed, deferred, scratch }
    }

    #[inline(always)]
    fn primitive_intersector<S: Each<K>, const K: usize>(
        &mut self,
        visit: ObjectVisit<'a>,
    ) -> PrimitiveIntersector<'_, 'a, S, K> {
        let rays = match (&self.placed_rays, &self.near_rays) {
            (Some(placed_rays), _) if !visit.object.is_untransformed() => placed_rays.rays(),
            (_, Some(near_rays)) if self.are_far => &**near_rays,
            _ => &*self.rays,
        };
        PrimitiveIntersector {
            id: visit.id,
            rays,
            world: self.rays,
            closest: &mut self.closest,
            kind: PhantomData,
        }
    }

    #[inline(always)]
    fn resolve<I: Isa>(&mut self) {
        self.deferred.resolve::<I>(self.scene, self.rays, &mut self.closest);
    }
}

/// Begins the traversal of the visited object by the next of the pending rays, all of one octant.
struct StartWithin<'t, 'a, 'b> {
    traversal: &'t mut Traversal<'a, 'b>,
    /// An object to visit, and the rays that may intersect it; `None` to go on with the current visit.
    new: Option<(u32, Mask)>,
}

impl Task for StartWithin<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let Traversal { state, visit, stack, inner, .. } = self.traversal;
        if let Some((id, mask)) = self.new {
            *visit = state.enter::<I>(id, mask, stack);
            inner.stop(stack);
        }
        let (Some(visit), true) = (*visit, state.pending != 0) else { return };
        let mask = state.next::<I>(visit);
        if mask & (mask - 1) == 0 {
            I::call(SingleRays { state, visit, mask, packet: &mut inner.packet, stack });
            return;
        }
        state.fill_within::<I>(&mut inner.packet, visit);
        match visit.hierarchy {
            Hierarchy::Mesh(_, hierarchy) => hierarchy.start::<I>(inner, mask, stack),
            Hierarchy::Spheres(spheres) => spheres.hierarchy().start::<I>(inner, mask, stack),
            Hierarchy::Disks(disks) => disks.hierarchy().start::<I>(inner, mask, stack),
        }
    }
}

/// Copies rays from far away and moves their starts close to a hierarchy.
struct Approach<'t> {
    rays: &'t RayPacket,
    near_rays: &'t mut Option<Box<RayPacket>>,
    center: Point,
    reach: f64,
}

impl Task for Approach<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let near_rays = self.near_rays.get_or_insert_with(|| Box::new(RayPacket::empty()));
        (**near_rays).clone_from(self.rays);
        near_rays.start_near::<I>(self.center, self.reach);
    }
}

/// A step of a packet in the hierarchy of primitives; see `Traversal::step_within`.
struct StepWithin<'t, 'a, 'b, S, const K: usize> {
    state: &'t mut PacketState<'a, 'b>,
    visit: ObjectVisit<'a>,
    primitives: &'a Primitives<S, K>,
    inner: &'t mut PacketTraversal,
    stack: &'t mut Stack,
}

impl<S: Each<K>, const K: usize> Task for StepWithin<'_, '_, '_, S, K> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self) -> bool {
        let StepWithin { state, visit, primitives, inner, stack } = self;
        let hierarchy = primitives.hierarchy();
        let Some(leaf) = hierarchy.leaf(inner) else { return hierarchy.open::<I>(inner, stack) };
        let nearer = state.primitive_intersector::<S, K>(visit).intersect::<I>(leaf, inner.mask());
        inner.lower_limits(nearer);
        false
    }
}

/// Rays that traverse a mesh one by one.
struct SingleRays<'t, 'a, 'b> {
    state: &'t mut PacketState<'a, 'b>,
    visit: ObjectVisit<'a>,
    mask: Mask,
    packet: &'t mut Packet,
    stack: &'t mut Stack,
}

impl Task for SingleRays<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let SingleRays { state, visit, mask, packet, stack } = self;
        state.fill_within::<I>(packet, visit);
        match visit.hierarchy {
            Hierarchy::Mesh(mesh, hierarchy) => {
                let mut leaves = state.leaf_intersector(visit, mesh);
                hierarchy.traverse_single::<I>(packet, mask, stack, &mut leaves);
            }
            Hierarchy::Spheres(spheres) => {
                let mut leaves = state.primitive_intersector::<Sphere, 4>(visit);
                spheres.hierarchy().traverse_single::<I>(packet, mask, stack, &mut leaves);
            }
            Hierarchy::Disks(disks) => {
                let mut leaves = state.primitive_intersector::<Disk, 7>(visit);
                disks.hierarchy().traverse_single::<I>(packet, mask, stack, &mut leaves);
            }
        }
    }
}

/// A packet of incoherent rays, which are traced one by one.
struct Incoherent<'t, 'a, 'b> {
    state: &'t mut PacketState<'a, 'b>,
    world: &'a World<'a>,
    /// Through the objects, and inside a mesh.
    packets: [&'t mut Packet; 2],
    stack: &'t mut Stack,
    surfaces: &'t mut SurfaceIntersector,
}

impl Task for Incoherent<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let Incoherent { state, world, packets: [outer, inner], stack, surfaces } = self;
        let active = all(state.rays.count);
        for hierarchy in [Some(&world.index.bounded), world.movers()].into_iter().flatten() {
            state.approach::<I>(hierarchy);
            match hierarchy.only_leaf() {
                Some(&id) => {
                    Objects { state, world, packet: inner, surfaces }.intersect::<I>(stack, id, active)
                }
                None => {
                    state.fill::<I>(outer, hierarchy);
                    let mut objects = Objects { state, world, packet: inner, surfaces };
                    hierarchy.traverse_single::<I>(outer, active, stack, &mut objects);
                }
            }
        }
    }
}

/// Single rays that traverse the hierarchy of objects.
struct Objects<'t, 'a, 'b> {
    state: &'t mut PacketState<'a, 'b>,
    world: &'a World<'a>,
    /// Inside a mesh.
    packet: &'t mut Packet,
    surfaces: &'t mut SurfaceIntersector,
}

impl Objects<'_, '_, '_> {
    #[inline(always)]
    fn intersect<I: Isa>(&mut self, stack: &mut Stack, id: u32, mask: Mask) {
        if self.world.ignores(id) {
            return;
        }
        let mask = self.state.remaining(id, mask);
        let Some(visit) = self.state.enter::<I>(id, mask, stack) else {
            let nearer = self.state.intersect_surface::<I>(id, mask, self.surfaces);
            self.state.leave::<I>(id, nearer);
            return;
        };
        while self.state.pending != 0 {
            let mask = self.state.next::<I>(visit);
            I::call(SingleRays { state: self.state, visit, mask, packet: self.packet, stack });
        }
        self.state.leave::<I>(id, visit.entered);
    }
}

impl Visitor<u32> for Objects<'_, '_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, stack: &mut Stack, lanes: &[usize], ids: &[&u32]) -> Mask {
        let mut visited = 0;
        for (k, &id) in ids.iter().enumerate() {
            let mut mask = 0;
            for (lane, other) in lanes[k..].iter().zip(&ids[k..]) {
                mask |= Mask::from(*other == id) << lane;
            }
            // Rays that reach the same object in the same step visit it together.
            mask &= !visited;
            if mask & 1 << lanes[k] != 0 {
                self.intersect::<I>(stack, *id, mask);
                visited |= mask;
            }
        }
        visited
    }

    #[inline(always)]
    fn limits(&self) -> &[f64; LANES] {
        self.state.closest.limits()
    }
}
