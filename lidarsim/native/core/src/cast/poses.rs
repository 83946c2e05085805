//! The poses of moving objects at the times of rays.

use crate::bvh::{Mask, take};
use crate::geometry::affine::{Affine, Affines};
use crate::geometry::vector::Point;
use crate::scene::Scene;

/// The maps of a moving object at the times of M rays. Maps are cached across objects and rays, since
/// adjacent rays share many times.
pub struct Poses<const M: usize> {
    maps: Affines<M>,
    /// A table indexed by a hash of object and time; empty until something moves.
    kept: Vec<Kept>,
}

const TABLE_BITS: u32 = 10;

#[derive(Clone)]
struct Kept {
    object: u32,
    time: u64,
    columns: [Point; 4],
}

impl Kept {
    const NOTHING: Kept = Kept { object: u32::MAX, time: 0, columns: [[0.0; 3]; 4] };
}

impl<const M: usize> Poses<M> {
    pub fn new() -> Self {
        Poses { maps: Affines::UNSET, kept: Vec::new() }
    }

    /// Clears the cache for another scene.
    pub fn restart(&mut self, moves: bool) {
        self.kept.clear();
        if moves {
            self.kept.resize(1 << TABLE_BITS, Kept::NOTHING);
        }
    }

    /// The maps of an object at the times of the rays of `mask`.
    #[inline(never)]
    pub fn gather(&mut self, scene: &Scene, object: u32, times: &[f64; M], mask: Mask) -> &Affines<M> {
        let (mut left, mut last) = (mask, (f64::NAN, [[0.0; 3]; 4]));
        while let Some(i) = take(&mut left) {
            if times[i] != last.0 {
                last = (times[i], self.columns(scene, object, times[i]));
            }
            self.maps.set(i, &last.1);
        }
        &self.maps
    }

    fn columns(&mut self, scene: &Scene, object: u32, time: f64) -> [Point; 4] {
        // Multiplicative hashing: D. Knuth, The Art of Computer Programming, vol. 3, §6.4.
        const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
        let bits = time.to_bits();
        let hash = (bits ^ u64::from(object).wrapping_mul(GOLDEN)).wrapping_mul(GOLDEN) >> (64 - TABLE_BITS);
        let kept = &mut self.kept[hash as usize];
        if (kept.object, kept.time) != (object, bits)
            && let Some(motion) = scene.objects()[object as usize].motion()
        {
            *kept = Kept { object, time: bits, columns: Affine::from(motion.at(time)).columns() };
        }
        kept.columns
    }
}
