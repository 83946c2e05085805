//! What a packet knows of the things that its rays meet. A thing is any number of objects.

use crate::bvh::{Mask, take};
use crate::memory;

/// The number of no thing.
pub const NO_THING: u32 = u32::MAX;

/// The things that the rays of a packet have met.
pub struct ThingsMet<'a> {
    of_objects: &'a [u32],
    /// By thing, the rays that need no more tests for it.
    settled: Vec<Mask>,
    /// The things with such rays, some of them twice.
    touched: Vec<u32>,
    /// Things, and the rays that have met them.
    found: Vec<(u32, Mask)>,
}

impl<'a> ThingsMet<'a> {
    pub fn new(of_objects: &'a [u32], count: usize) -> Self {
        let mut settled = Vec::new();
        memory::resize(&mut settled, count, 0);
        ThingsMet { of_objects, settled, touched: Vec::new(), found: Vec::new() }
    }

    /// Restarts for other rays, with a thing each that is not asked for, or `NO_THING`.
    #[inline(always)]
    pub fn restart(&mut self, known: impl Iterator<Item = u32>) {
        self.found.clear();
        for thing in self.touched.drain(..) {
            self.settled[thing as usize] = 0;
        }
        // Neighbours often know the same thing.
        let (mut last, mut lanes) = (NO_THING, 0);
        for (lane, thing) in known.enumerate() {
            if thing != last {
                self.settle(last, lanes);
                (last, lanes) = (thing, 0);
            }
            lanes |= 1 << lane;
        }
        self.settle(last, lanes);
    }

    #[inline(always)]
    fn settle(&mut self, thing: u32, lanes: Mask) {
        if thing == NO_THING {
            return;
        }
        let settled = &mut self.settled[thing as usize];
        if *settled == 0 {
            memory::push(&mut self.touched, thing);
        }
        *settled |= lanes;
    }

    /// The rays of `mask` for which an object must be intersected.
    #[inline(always)]
    pub fn asked(&self, object: u32, mask: Mask) -> Mask {
        match self.of_objects[object as usize] {
            NO_THING => 0,
            thing => mask & !self.settled[thing as usize],
        }
    }

    /// Notes the rays that meet an object.
    #[inline(always)]
    pub fn meet(&mut self, object: u32, lanes: Mask) {
        if lanes != 0 {
            let thing = self.of_objects[object as usize];
            self.settle(thing, lanes);
            memory::push(&mut self.found, (thing, lanes));
        }
    }

    /// Appends pairs of rays, which are at these indices, and things.
    #[inline(always)]
    pub fn append(&self, at: &[u32], pairs: &mut Vec<(u32, u32)>) {
        for &(thing, mut lanes) in &self.found {
            memory::reserve(pairs, lanes.count_ones() as usize);
            while let Some(lane) = take(&mut lanes) {
                pairs.push((at[lane], thing));
            }
        }
    }
}
