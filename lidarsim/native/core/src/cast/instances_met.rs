//! What a packet knows of the instances that its rays meet. An instance is any number of objects.

use crate::bvh::{Mask, take};
use crate::memory;

/// The number of no instance.
pub const NO_INSTANCE: u32 = u32::MAX;

/// The instances that the rays of a packet have met.
pub struct InstancesMet<'a> {
    of_objects: &'a [u32],
    /// By instance, the rays that need no more tests for it.
    settled: Vec<Mask>,
    /// The instances with such rays, some of them twice.
    touched: Vec<u32>,
    /// Instances, and the rays that have met them.
    found: Vec<(u32, Mask)>,
}

impl<'a> InstancesMet<'a> {
    pub fn new(of_objects: &'a [u32], count: usize) -> Self {
        let mut settled = Vec::new();
        memory::resize(&mut settled, count, 0);
        InstancesMet { of_objects, settled, touched: Vec::new(), found: Vec::new() }
    }

    /// Restarts for other rays, with an instance each that is not asked for, or `NO_INSTANCE`.
    #[inline(always)]
    pub fn restart(&mut self, known: impl Iterator<Item = u32>) {
        self.found.clear();
        for instance in self.touched.drain(..) {
            self.settled[instance as usize] = 0;
        }
        // Neighbours often know the same instance.
        let (mut last, mut lanes) = (NO_INSTANCE, 0);
        for (lane, instance) in known.enumerate() {
            if instance != last {
                self.settle(last, lanes);
                (last, lanes) = (instance, 0);
            }
            lanes |= 1 << lane;
        }
        self.settle(last, lanes);
    }

    #[inline(always)]
    fn settle(&mut self, instance: u32, lanes: Mask) {
        if instance == NO_INSTANCE {
            return;
        }
        let settled = &mut self.settled[instance as usize];
        if *settled == 0 {
            memory::push(&mut self.touched, instance);
        }
        *settled |= lanes;
    }

    /// The rays of `mask` for which an object must be intersected.
    #[inline(always)]
    pub fn remaining(&self, object: u32, mask: Mask) -> Mask {
        match self.of_objects[object as usize] {
            NO_INSTANCE => 0,
            instance => mask & !self.settled[instance as usize],
        }
    }

    /// Notes the rays that meet an object.
    #[inline(always)]
    pub fn meet(&mut self, object: u32, lanes: Mask) {
        if lanes != 0 {
            let instance = self.of_objects[object as usize];
            self.settle(instance, lanes);
            memory::push(&mut self.found, (instance, lanes));
        }
    }

    /// Appends pairs of rays, which are at these indices, and instances.
    #[inline(always)]
    pub fn append(&self, at: &[u32], pairs: &mut Vec<(u32, u32)>) {
        for &(instance, mut lanes) in &self.found {
            memory::reserve(pairs, lanes.count_ones() as usize);
            while let Some(lane) = take(&mut lanes) {
                pairs.push((at[lane], instance));
            }
        }
    }
}
