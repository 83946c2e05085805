//! A scene during a span of time, which is what rays are cast at.

use std::sync::Arc;

use rayon::prelude::*;

use super::{Index, Scene, WORN, size};
use crate::arith::number::Interval;
use crate::bvh::Bvh;
use crate::{memory, parallel};

/// Boxes that a thread makes at a time, at least.
const BOXES: usize = 64;

/// A scene, with a hierarchy of the objects that move in boxes around all of their places during a span of time.
#[derive(Debug)]
pub struct World<'a> {
    pub scene: &'a Scene,
    /// Of what does not move.
    pub index: &'a Index,
    movers: Option<Arc<Movers>>,
    /// The longest side of the box around all bounded objects.
    pub size: f64,
}

/// The hierarchy of what moves, during a span of time.
#[derive(Debug)]
pub struct Movers {
    hierarchy: Bvh<u32>,
    /// Of the hierarchy when it was built.
    surface: f32,
}

impl World<'_> {
    /// Of what moves; none if nothing does.
    #[inline(always)]
    pub fn movers(&self) -> Option<&Bvh<u32>> {
        self.movers.as_ref().map(|movers| &movers.hierarchy)
    }
}

impl Scene {
    /// The scene between the first and the last of some times. No hierarchy of a mesh or of what stands still is built anew for it, and that of what moves
    /// is the one of the span before, refitted, while it is about as good: frames that follow one another differ little.
    pub fn during(&self, times: impl Iterator<Item = f64>) -> World<'_> {
        let index = self.index();
        if !self.moves() {
            return World { scene: self, index, movers: None, size: index.size };
        }
        // A time that is not finite is that of a ray that will not be cast.
        let times = times.filter(|time| time.is_finite());
        let span = times.map(|time| [time; 2]).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]).unwrap_or_default();
        let bounds = |id: &u32| self.objects[*id as usize].bounds_during(span);
        let mut boxes: Vec<Option<[Interval; 3]>> = memory::with_capacity(self.movers.len());
        parallel::run(|| self.movers.par_iter().with_min_len(BOXES).map(bounds).collect_into_vec(&mut boxes));
        let movers = self.refitted_movers(&boxes).unwrap_or_else(|| {
            let leaf = |places: &[u32]| self.movers[places[0] as usize];
            let hierarchy = parallel::run(|| Bvh::new(boxes.len(), |place| boxes[place as usize], 1, leaf));
            Movers { surface: hierarchy.surface(), hierarchy }
        });
        let movers = Arc::new(movers);
        self.last_movers.store(Some(movers.clone()));
        World { scene: self, index, size: size(&boxes).max(index.size), movers: Some(movers) }
    }

    /// The hierarchy of the span before, for the boxes of what moves in this one; none if there was none, or it is worn out.
    fn refitted_movers(&self, boxes: &[Option<[Interval; 3]>]) -> Option<Movers> {
        let last = self.last_movers.load_full()?;
        let Movers { hierarchy, surface } = &*last;
        let bounds = |id: &u32| boxes[self.movers.binary_search(id).ok()?];
        let refitted = hierarchy.refitted(boxes.iter().flatten().count(), bounds)?;
        let is_good = refitted.surface() <= WORN * surface;
        if is_good { Some(Movers { hierarchy: refitted, surface: *surface }) } else { None }
    }
}
