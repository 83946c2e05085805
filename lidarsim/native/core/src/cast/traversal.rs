//! Packets on their way through a scene: the hierarchy of its objects, and within it those of meshes.

use crate::arith::simd::{Isa, Task};
use crate::bvh::{Bvh, LANES, Mask, Packet, PacketWalk, Rays, Stack, Visitor, all, take};
use crate::cast::blocks::{Blocks, Looks};
use crate::cast::doubt::Doubts;
use crate::cast::local::Local;
use crate::cast::search::Searches;
use crate::cast::simple::{self, Met};
use crate::scene::TriangleMesh;
use crate::scene::{Geometry, Index, Object, Scene};
use crate::shapes::triangle::Block;

/// Packets that are on their way at once.
pub const TRAVERSALS: usize = 2;

/// Room for the search of a packet, to be used again and again.
pub struct Room {
    rays: Rays,
    stack: Stack,
    /// Among the objects.
    outer: PacketWalk,
    /// Within a mesh.
    inner: PacketWalk,
    doubts: Doubts,
    local: Option<Box<Local>>,
    looks: Looks,
}

impl Room {
    pub fn new() -> Self {
        Room {
            rays: Rays::empty(),
            stack: Stack::new(),
            outer: PacketWalk::new(),
            inner: PacketWalk::new(),
            doubts: Doubts::new(),
            local: None,
            looks: Looks::new(),
        }
    }
}

/// The search for the nearest hits of the rays of a packet.
pub struct Traversal<'a, 'b> {
    pub party: Party<'a, 'b>,
    index: &'a Index,
    size: f64,
    stage: Stage,
    stack: &'b mut Stack,
    /// Among the objects.
    outer: &'b mut PacketWalk,
    /// Within a mesh.
    inner: &'b mut PacketWalk,
    inside: Option<Inside<'a>>,
}

#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Idle,
    Ready,
    UnderWay,
}

/// A mesh that a packet has entered.
#[derive(Clone, Copy)]
struct Inside<'a> {
    id: u32,
    object: &'a Object,
    mesh: &'a TriangleMesh,
    hierarchy: &'a Bvh<Block>,
    /// The rays that may meet it.
    entered: Mask,
}

impl<'a, 'b> Traversal<'a, 'b> {
    pub fn new(scene: &'a Scene, range: (f64, f64), room: &'b mut Room) -> Self {
        let Room { rays, stack, outer, inner, doubts, local, looks } = room;
        let searches = Searches::new(scene, range);
        Traversal {
            party: Party { scene, rays, searches, doubts, left: 0, local, looks },
            index: scene.index(),
            size: scene.size(),
            stage: Stage::Idle,
            stack,
            outer,
            inner,
            inside: None,
        }
    }

    pub fn is_idle(&self) -> bool {
        self.stage == Stage::Idle
    }

    /// The party has new rays.
    pub fn make_ready(&mut self) {
        self.stage = Stage::Ready;
    }

    /// What a search may use while there are no rays.
    pub fn stack(&mut self) -> &mut Stack {
        self.stack
    }

    /// Goes to the next node, leaf or object, and visits it; false if there is none.
    #[inline(always)]
    fn step<I: Isa>(&mut self, met: &mut Met) -> bool {
        if self.stage == Stage::Ready {
            self.start::<I>(met);
        }
        while let Some(inside) = self.inside {
            if self.inner.go_on::<I>(self.stack, self.party.searches.limits()) {
                match inside.hierarchy.leaf(self.inner) {
                    Some(block) => {
                        let nearer = self.party.among_blocks(inside).meet::<I>(block, self.inner.mask());
                        self.inner.shorten(nearer);
                    }
                    None => inside.hierarchy.open::<I>(self.inner, self.stack),
                }
                return true;
            }
            self.set_out_within::<I>(inside);
        }
        if !self.outer.go_on::<I>(self.stack, self.party.searches.limits()) {
            return false;
        }
        match self.index.bounded.leaf(self.outer) {
            Some(&id) => self.meet::<I>(id, met),
            None => self.index.bounded.open::<I>(self.outer, self.stack),
        }
        true
    }

    #[inline(always)]
    fn start<I: Isa>(&mut self, met: &mut Met) {
        let Traversal { party, index, stack, outer, inner, .. } = self;
        self.stage = Stage::UnderWay;
        party.searches.restart::<I>();
        outer.stay(stack);
        let active = all(party.rays.count);
        for &object in &index.unbounded {
            party.meet_simple::<I>(object, active, met);
        }
        if party.rays.count == 1 || !party.rays.are_coherent::<I>(self.size) {
            I::call(Scattered { party, index, packets: [&mut outer.packet, &mut inner.packet], stack, met });
            return;
        }
        match index.bounded.only_leaf() {
            // The hierarchy of the mesh begins with what that above it would ask.
            Some(&id) if !party.scene.objects()[id as usize].is_simple() => self.enter::<I>(id, active),
            _ => {
                party.fill::<I>(&mut outer.packet, &index.bounded);
                index.bounded.set_out::<I>(outer, active, stack);
            }
        }
    }

    #[inline(always)]
    fn meet<I: Isa>(&mut self, id: u32, met: &mut Met) {
        let mask = self.outer.mask();
        if self.party.scene.objects()[id as usize].is_simple() {
            self.party.meet_simple::<I>(id, mask, met);
            self.outer.shorten(mask);
        } else {
            self.enter::<I>(id, mask);
        }
    }

    /// Has rays enter a mesh.
    #[inline(always)]
    fn enter<I: Isa>(&mut self, id: u32, mask: Mask) {
        self.inside = self.party.enter::<I>(id, mask, self.stack);
        self.inner.stay(self.stack);
    }

    /// Sends the next rays on their way through the mesh; leaves it if there are no more.
    #[inline(always)]
    fn set_out_within<I: Isa>(&mut self, inside: Inside<'a>) {
        let Traversal { party, stack, outer, inner, .. } = self;
        let mask = party.next(inside);
        if mask == 0 {
            outer.shorten(inside.entered);
            self.inside = None;
        } else if mask & (mask - 1) == 0 {
            I::call(Each { party, inside, mask, packet: &mut inner.packet, stack });
        } else {
            party.fill_within::<I>(&mut inner.packet, inside);
            inside.hierarchy.set_out::<I>(inner, mask, stack);
        }
    }
}

/// Goes on with packets by turns, a step each, so that while one waits for memory the others go on. The outcome is one that is through; none if none
/// was under way.
pub struct Advance<'t, 'a, 'b> {
    pub traversals: &'t mut [Traversal<'a, 'b>],
    pub met: &'t mut Met,
}

impl Task for Advance<'_, '_, '_> {
    type Output = Option<usize>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        let Advance { traversals, met } = self;
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
            if !traversals[k].step::<I>(met) {
                traversals[k].stage = Stage::Idle;
                traversals[k].party.settle::<I>();
                return Some(k);
            }
            turn = if turn + 1 < count { turn + 1 } else { 0 };
        }
    }
}

/// The rays of a packet and what they have found.
pub struct Party<'a, 'b> {
    scene: &'a Scene,
    pub rays: &'b mut Rays,
    pub searches: Searches<'a>,
    doubts: &'b mut Doubts,
    /// Rays that have yet to set out within the mesh that was entered.
    left: Mask,
    local: &'b mut Option<Box<Local>>,
    looks: &'b mut Looks,
}

impl<'a> Party<'a, '_> {
    #[inline(always)]
    fn meet_simple<I: Isa>(&mut self, id: u32, mask: Mask, met: &mut Met) {
        simple::meet::<I>(self.scene, id, self.rays, &mut self.searches, mask, met);
    }

    /// Fills a packet that is to go among the objects.
    #[inline(always)]
    fn fill<I: Isa>(&self, packet: &mut Packet, hierarchy: &Bvh<u32>) {
        packet.enter::<I>(self.rays, hierarchy.center(), self.searches.t_min(), self.searches.limits());
    }

    /// Fills a packet with the rays that set out last within a mesh.
    #[inline(always)]
    fn fill_within<I: Isa>(&self, packet: &mut Packet, inside: Inside) {
        let center = inside.hierarchy.center();
        packet.enter::<I>(self.rays_in(inside), center, self.searches.t_min(), self.searches.limits());
    }

    /// Has rays enter a mesh, in its coordinates; none if the object is no mesh. Those that packets do not hold search alone.
    #[inline(always)]
    fn enter<I: Isa>(&mut self, id: u32, mask: Mask, stack: &mut Stack) -> Option<Inside<'a>> {
        let object = &self.scene.objects()[id as usize];
        let Geometry::Mesh(mesh) = &object.geometry else { return None };
        self.left = mask;
        if !object.is_placed_as_made() {
            let local = self.local.get_or_insert_with(|| Box::new(Local::new()));
            self.left = local.take_up::<I>(object, self.rays, mask);
            let mut alone = mask & !self.left;
            while let Some(lane) = take(&mut alone) {
                self.searches.enter(self.rays, lane, id, mesh, stack);
            }
        }
        Some(Inside { id, object, mesh, hierarchy: mesh.hierarchy(), entered: mask })
    }

    /// The next rays that set out within the mesh: of one octant.
    fn next(&mut self, inside: Inside) -> Mask {
        let mut next = self.left;
        if next != 0
            && !inside.object.is_placed_as_made()
            && let Some(local) = self.local.as_mut()
        {
            next = local.next(next);
        }
        self.left &= !next;
        next
    }

    /// The rays that set out last, in the coordinates of the mesh.
    #[inline(always)]
    fn rays_in(&self, inside: Inside) -> &Rays {
        match &self.local {
            Some(local) if !inside.object.is_placed_as_made() => &local.rays,
            _ => self.rays,
        }
    }

    #[inline(always)]
    fn among_blocks(&mut self, inside: Inside<'a>) -> Blocks<'_, 'a> {
        let Party { scene, searches, looks, .. } = self;
        let world = &*self.rays;
        let Inside { id, mesh, .. } = inside;
        match &self.local {
            Some(local) if !inside.object.is_placed_as_made() => {
                Blocks { scene, mesh, id, rays: &local.rays, world, searches, doubts: None, looks }
            }
            _ => Blocks { scene, mesh, id, rays: world, world, searches, doubts: Some(&mut *self.doubts), looks },
        }
    }

    #[inline(always)]
    fn settle<I: Isa>(&mut self) {
        self.doubts.settle::<I>(self.scene, self.rays, &mut self.searches);
    }
}

/// Rays that go through a mesh one by one.
struct Each<'t, 'a, 'b> {
    party: &'t mut Party<'a, 'b>,
    inside: Inside<'a>,
    mask: Mask,
    packet: &'t mut Packet,
    stack: &'t mut Stack,
}

impl Task for Each<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let Each { party, inside, mask, packet, stack } = self;
        party.fill_within::<I>(packet, inside);
        inside.hierarchy.traverse_each::<I>(packet, mask, stack, &mut party.among_blocks(inside));
    }
}

/// A packet of rays that do not keep together.
struct Scattered<'t, 'a, 'b> {
    party: &'t mut Party<'a, 'b>,
    index: &'a Index,
    /// Among the objects, and within a mesh.
    packets: [&'t mut Packet; 2],
    stack: &'t mut Stack,
    met: &'t mut Met,
}

impl Task for Scattered<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let Scattered { party, index, packets: [outer, inner], stack, met } = self;
        let active = all(party.rays.count);
        match index.bounded.only_leaf() {
            Some(&id) => Objects { party, packet: inner, met }.meet::<I>(stack, id, active),
            None => {
                party.fill::<I>(outer, &index.bounded);
                let mut objects = Objects { party, packet: inner, met };
                index.bounded.traverse_each::<I>(outer, active, stack, &mut objects);
            }
        }
    }
}

/// Rays that go alone, among the objects of the scene.
struct Objects<'t, 'a, 'b> {
    party: &'t mut Party<'a, 'b>,
    /// Within a mesh.
    packet: &'t mut Packet,
    met: &'t mut Met,
}

impl Objects<'_, '_, '_> {
    #[inline(always)]
    fn meet<I: Isa>(&mut self, stack: &mut Stack, id: u32, mask: Mask) {
        let Some(inside) = self.party.enter::<I>(id, mask, stack) else {
            self.party.meet_simple::<I>(id, mask, self.met);
            return;
        };
        loop {
            let mask = self.party.next(inside);
            if mask == 0 {
                break;
            }
            I::call(Each { party: self.party, inside, mask, packet: self.packet, stack });
        }
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
            // Those that came to an object together go on together.
            mask &= !visited;
            if mask & 1 << lanes[k] != 0 {
                self.meet::<I>(stack, *id, mask);
                visited |= mask;
            }
        }
        visited
    }

    #[inline(always)]
    fn limits(&self) -> &[f64; LANES] {
        self.party.searches.limits()
    }
}
