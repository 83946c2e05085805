//! A scene during a span of time, at which rays are cast.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::{Index, Scene, WORN, size};
use crate::arith::number::Interval;
use crate::bvh::Bvh;
use crate::{memory, parallel};

/// The least number of boxes that a thread makes at a time.
const BOXES: usize = 64;

/// A scene with a hierarchy of its moving objects, in boxes around all of their places during a span of time.
#[derive(Debug)]
pub struct World<'a> {
    pub scene: &'a Scene,
    /// The index of the objects that stand still.
    pub index: &'a Index,
    movers: Option<Arc<Movers>>,
    /// The longest side of the box around all bounded objects.
    pub size: f64,
    /// Unique among the worlds of the process, but for those that differ in `ignored` alone.
    pub number: u64,
    /// The objects that rays pass through as if they were not there, ascending; see [`World::ignoring`].
    ignored: &'a [u32],
}

/// The number of the next world.
static NUMBER: AtomicU64 = AtomicU64::new(1);

/// The hierarchy of moving objects during a span of time.
#[derive(Debug)]
pub struct Movers {
    hierarchy: Bvh<u32>,
    /// The surface area of the hierarchy when it was built.
    surface: f32,
}

impl Movers {
    fn new(movers: &[u32], boxes: &[Option<[Interval; 3]>]) -> Self {
        let leaf = |places: &[u32]| movers[places[0] as usize];
        let hierarchy = Bvh::new(boxes.len(), |place| boxes[place as usize], 1, leaf);
        Movers { surface: hierarchy.surface(), hierarchy }
    }
}

/// The range of the finite times, as no ray is cast at others; [0, 0] if there are none. Eight at a time,
/// which vectorizes.
pub fn span(times: &[f64]) -> [f64; 2] {
    let (mut low, mut high) = ([f64::INFINITY; 8], [f64::NEG_INFINITY; 8]);
    let mut add = |k: usize, time: f64| {
        low[k] = if (time < low[k]) & (time > f64::NEG_INFINITY) { time } else { low[k] };
        high[k] = if (time > high[k]) & (time < f64::INFINITY) { time } else { high[k] };
    };
    let (eights, others) = times.as_chunks::<8>();
    for eight in eights {
        for k in 0..8 {
            add(k, eight[k]);
        }
    }
    for (k, &time) in others.iter().enumerate() {
        add(k, time);
    }
    let [first, last] =
        [low.into_iter().fold(f64::INFINITY, f64::min), high.into_iter().fold(f64::NEG_INFINITY, f64::max)];
    if first <= last { [first, last] } else { [0.0; 2] }
}

impl<'a> World<'a> {
    /// The same world without some objects, which must ascend.
    pub fn ignoring<'b>(&self, ignored: &'b [u32]) -> World<'b>
    where
        'a: 'b,
    {
        let World { scene, index, size, number, .. } = *self;
        World { scene, index, movers: self.movers.clone(), size, number, ignored }
    }

    /// Whether rays pass through an object.
    #[inline(always)]
    pub fn ignores(&self, object: u32) -> bool {
        !self.ignored.is_empty() && self.ignored.binary_search(&object).is_ok()
    }
}

impl World<'_> {
    /// The hierarchy of moving objects; `None` if nothing moves.
    #[inline(always)]
    pub fn movers(&self) -> Option<&Bvh<u32>> {
        self.movers.as_ref().map(|movers| &movers.hierarchy)
    }
}

impl Scene {
    /// The scene in a span of time (see [`span`]). The hierarchies of meshes and of objects that stand still
    /// are reused. That of moving objects is refitted from the previous span while it stays about as good,
    /// since successive frames differ little.
    pub fn during(&self, span: [f64; 2]) -> World<'_> {
        let boxes = self.boxes_during(&self.movers, span);
        let movers = self.moves().then(|| {
            let movers = self.refitted_movers(&boxes).unwrap_or_else(|| Movers::new(&self.movers, &boxes));
            let movers = Arc::new(movers);
            self.last_movers.store(Some(movers.clone()));
            movers
        });
        self.world(self.index(), movers, &boxes)
    }

    /// The world of some of the objects, those that `is_in` tells, in a span of time. `index` is their index.
    pub fn part_during<'a>(
        &'a self,
        index: &'a Index,
        span: [f64; 2],
        is_in: &dyn Fn(u32) -> bool,
    ) -> World<'a> {
        let mut movers = memory::copy(&self.movers);
        movers.retain(|&id| is_in(id));
        let boxes = self.boxes_during(&movers, span);
        let hierarchy = (!movers.is_empty()).then(|| Arc::new(Movers::new(&movers, &boxes)));
        self.world(index, hierarchy, &boxes)
    }

    /// A world; `boxes` are those of the movers.
    fn world<'a>(
        &'a self,
        index: &'a Index,
        movers: Option<Arc<Movers>>,
        boxes: &[Option<[Interval; 3]>],
    ) -> World<'a> {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        World { scene: self, index, movers, size: size(boxes).max(index.size), number, ignored: &[] }
    }

    /// The boxes around all places of moving objects during a span of time.
    fn boxes_during(&self, movers: &[u32], span: [f64; 2]) -> Vec<Option<[Interval; 3]>> {
        let bounds = |id: &u32| self.objects[*id as usize].bounds_during(span);
        let mut boxes = memory::with_capacity(movers.len());
        if movers.len() > BOXES {
            parallel::run(|| movers.par_iter().with_min_len(BOXES).map(bounds).collect_into_vec(&mut boxes));
        } else {
            boxes.extend(movers.iter().map(bounds));
        }
        boxes
    }

    /// The hierarchy of the previous span, refitted to the boxes of this one. `None` if there is none or it
    /// is worn out.
    fn refitted_movers(&self, boxes: &[Option<[Interval; 3]>]) -> Option<Movers> {
        let last = self.last_movers.load_full()?;
        let Movers { hierarchy, surface } = &*last;
        let bounds = |id: &u32| boxes[self.movers.binary_search(id).ok()?];
        let refitted = hierarchy.refitted(boxes.iter().flatten().count(), bounds)?;
        let is_good = refitted.surface() <= WORN * surface;
        if is_good { Some(Movers { hierarchy: refitted, surface: *surface }) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::numbers;

    #[test]
    fn spans_are_from_the_first_to_the_last_finite_time() {
        let (mut next, odd) = (numbers(), [f64::NAN, f64::INFINITY, f64::NEG_INFINITY]);
        for count in 0..40 {
            for share in [0.0, 0.5, 1.0] {
                let mut time = |_| if next() < share { odd[(3.0 * next()) as usize] } else { next() - 0.5 };
                let times: Vec<f64> = (0..count).map(&mut time).collect();
                let mut finite: Vec<f64> = times.iter().copied().filter(|time| time.is_finite()).collect();
                finite.sort_unstable_by(f64::total_cmp);
                let expected = finite.first().map_or([0.0; 2], |first| [*first, finite[finite.len() - 1]]);
                assert_eq!(span(&times), expected, "{times:?}");
            }
        }
    }
}
