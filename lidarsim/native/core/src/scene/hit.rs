//! Hits, and the sinks that receive them.

use std::ops::Range;

use crate::arith::simd::{Floats, Isa};
use crate::bvh::is_run;
use crate::geometry::vector::Point;

/// The closest hit of a ray.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// In units of the length of the direction, correctly rounded; infinite for a miss.
    pub t: f64,
    /// A unit vector, outward as the shape defines it.
    pub normal: Point,
    /// −1 for a miss.
    pub object: i32,
    /// The triangle of a mesh; else 0.
    pub primitive: i32,
}

impl Hit {
    pub const MISS: Hit = Hit { t: f64::INFINITY, normal: [0.0; 3], object: -1, primitive: 0 };
    /// A hit of an any-hit query, which has no t and no normal.
    pub const UNREFINED: Hit = Hit { t: f64::NAN, object: 0, ..Hit::MISS };
}

/// Hits of eight rays.
pub struct EightHits<'a> {
    pub t: &'a [f64; 8],
    /// By axis.
    pub normal: [&'a [f64; 8]; 3],
    pub object: [i32; 8],
    pub primitive: [i32; 8],
}

/// Hits of four consecutive rays.
pub struct HitRun {
    pub t: [f64; 4],
    /// The coordinates of the normals, ray by ray.
    pub normals: [[f64; 4]; 3],
    pub object: [i32; 4],
    pub primitive: [i32; 4],
}

/// Receives the hits of rays. Rays start as misses; only hits are written.
pub trait Sink {
    /// Whether any hit of a ray suffices; then `Hit::UNREFINED` is written.
    const ANY: bool = false;

    /// Writes `Hit::MISS` for consecutive rays before their hits are written in any order. This brings whole
    /// cache lines of the arrays into the cache.
    fn clear(&mut self, rays: Range<usize>);
    /// Writes the hit of ray i.
    fn write(&mut self, i: usize, hit: Hit);

    /// Writes the hits of four consecutive rays, the first of index i.
    #[inline(always)]
    fn write_run(&mut self, i: usize, hits: &HitRun) {
        let normals = hits.normals.as_flattened().as_chunks().0;
        for (k, normal) in normals.iter().enumerate() {
            self.write(
                i + k,
                Hit { t: hits.t[k], normal: *normal, object: hits.object[k], primitive: hits.primitive[k] },
            );
        }
    }

    /// Writes those hits of eight rays that form runs, and returns their lanes. A run is four of `lanes`
    /// whose rays are consecutive, as sorted rays of a sensor often are.
    #[inline(always)]
    fn write_runs<I: Isa>(&mut self, rays: &[u32; 8], lanes: u32, hits: &EightHits) -> u32 {
        let runs = [0, 1].map(|half| lanes >> (4 * half) & 0xf == 0xf && is_run(&rays.as_chunks().0[half]));
        if runs == [false; 2] {
            return 0;
        }
        let [x, y, z] = &hits.normal;
        let normals = I::interleaved([I::F64x8::load(x), I::F64x8::load(y), I::F64x8::load(z)]);
        let [a, b, c] =
            normals.map(I::F64x8::store).map(|eight| [eight.as_chunks().0[0], eight.as_chunks().0[1]]);
        let normals = [[a[0], a[1], b[0]], [b[1], c[0], c[1]]];
        let mut written = 0;
        for half in 0..2 {
            if runs[half] {
                let (t, object) = (hits.t.as_chunks().0[half], hits.object.as_chunks().0[half]);
                let run = HitRun {
                    t,
                    normals: normals[half],
                    object,
                    primitive: hits.primitive.as_chunks().0[half],
                };
                self.write_run(rays[4 * half] as usize, &run);
                written |= 0xf << (4 * half);
            }
        }
        written
    }
}
