//! A scene during a span of time, which is what rays are cast at.

use rayon::prelude::*;

use super::{Index, Scene, size};
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
    /// None if nothing moves.
    pub movers: Option<Bvh<u32>>,
    /// The longest side of the box around all bounded objects.
    pub size: f64,
}

impl Scene {
    /// The scene between the first and the last of some times. No hierarchy of a mesh or of what stands still is built anew for it.
    pub fn during(&self, times: impl Iterator<Item = f64>) -> World<'_> {
        let index = self.index();
        if !self.moves() {
            return World { scene: self, index, movers: None, size: index.size };
        }
        // A time that is not finite is that of a ray that will not be cast.
        let times = times.filter(|time| time.is_finite());
        let span = times.map(|time| [time; 2]).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]).unwrap_or_default();
        let bounds = |id: &u32| self.objects[*id as usize].bounds_during(span);
        let leaf = |places: &[u32]| self.movers[places[0] as usize];
        let (movers, longest) = parallel::run(|| {
            let mut boxes: Vec<Option<[Interval; 3]>> = memory::with_capacity(self.movers.len());
            self.movers.par_iter().with_min_len(BOXES).map(bounds).collect_into_vec(&mut boxes);
            (Bvh::new(boxes.len(), |place| boxes[place as usize], 1, leaf), size(&boxes))
        });
        World { scene: self, index, movers: Some(movers), size: longest.max(index.size) }
    }
}
