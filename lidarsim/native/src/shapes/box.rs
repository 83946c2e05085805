//! Axis-aligned box with corners center ± size/2: the boundary of the intersection of three slabs.

use std::cmp::Ordering;

use super::Surface;
use crate::number::{Interval, Number, Uncertain};
use crate::ray::Ray;
use crate::root::{Chord, Root, Roots};
use crate::vector::{self, Point, Vector};

#[derive(Clone, Copy, Debug)]
pub struct Box {
    pub size: Point,
    pub center: Point,
}

impl Surface for Box {
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let two = N::exact(2.0);
        let mut chord = Chord::whole_line();
        for axis in 0..3 {
            // Twice the distances from the origin of the ray to both faces: so the halves of the size need not be rounded.
            let middle = two.times(&ray.weighted(N::exact(self.center[axis])).minus(&ray.origin[axis]));
            let half = ray.weighted(N::exact(self.size[axis]));
            let (low, high) = (middle.minus(&half), middle.plus(&half));
            let slope = two.times(&ray.direction[axis]);
            let face = 2 * axis as u8;
            match (Root::ratio(low.clone(), slope.clone(), face)?, Root::ratio(high.clone(), slope.clone(), face + 1)?)
            {
                (Some(low), Some(high)) => {
                    if slope.sign()? == Ordering::Greater {
                        chord.cut(low, high)?
                    } else {
                        chord.cut(high, low)?
                    }
                }
                _ => {
                    if low.sign()? == Ordering::Greater || high.sign()? == Ordering::Less {
                        return Ok([None, None]);
                    }
                }
            }
        }
        chord.roots()
    }

    fn normal<N: Number>(&self, _: &Ray<N>, _: &N, feature: u8) -> Vector<N> {
        let mut normal = [0.0; 3];
        normal[usize::from(feature / 2)] = if feature.is_multiple_of(2) { -1.0 } else { 1.0 };
        vector::exact(normal)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(std::array::from_fn(|i| {
            let half = self.size[i] / 2.0; // may round where the size is subnormal
            Interval {
                low: (self.center[i] - half.next_up()).next_down(),
                high: (self.center[i] + half.next_up()).next_up(),
            }
        }))
    }
}
