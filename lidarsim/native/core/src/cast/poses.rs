//! The poses of moving objects at the times of rays.

use crate::arith::simd::Isa;
use crate::bvh::Mask;
use crate::geometry::affine::Affines;
use crate::scene::Scene;

/// The maps of a moving object at the times of M rays, a multiple of eight.
pub struct Poses<const M: usize>(Affines<M>);

impl<const M: usize> Poses<M> {
    pub fn new() -> Self {
        Poses(Affines::UNSET)
    }

    /// The maps of an object at the times of the rays of `mask`, s; `None` if it does not move. Maps of other
    /// rays are unspecified.
    #[inline(always)]
    pub fn gather<I: Isa>(
        &mut self,
        scene: &Scene,
        object: u32,
        times: &[f64; M],
        mask: Mask,
    ) -> Option<&Affines<M>> {
        let path = scene.objects()[object as usize].motion()?;
        for (part, eight) in times.as_chunks::<8>().0.iter().enumerate() {
            let lanes = mask >> (8 * part) & 0xff;
            if lanes != 0 {
                // Lanes outside of the mask get the time of one in it, as theirs may be anything.
                let first = eight[lanes.trailing_zeros() as usize];
                let times = std::array::from_fn(|k| if lanes >> k & 1 == 1 { eight[k] } else { first });
                self.0.set(part, &path.poses::<I>(&times));
            }
        }
        Some(&self.0)
    }
}
