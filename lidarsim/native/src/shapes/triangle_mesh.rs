//! Triangle mesh: triangles over shared vertices, with a hierarchy of their boxes.

use std::sync::OnceLock;

use super::{Surface, Triangle};
use crate::bvh::{Bvh, LEAF};
use crate::number::{Interval, UNIT};
use crate::parallel;
use crate::pose;
use crate::simd::{self, Floats, Isa, lanes};
use crate::vector::Point;

#[derive(Debug)]
pub struct TriangleMesh {
    vertices: Vec<Point>,
    faces: Vec<[u32; 3]>,
    /// Built when it is first cast at.
    hierarchy: OnceLock<Bvh<Block>>,
}

impl TriangleMesh {
    /// None if a face names a vertex that is not there.
    pub fn new(vertices: Vec<Point>, faces: Vec<[u32; 3]>) -> Option<Self> {
        let known = |i: &u32| (*i as usize) < vertices.len();
        faces.iter().flatten().all(known).then_some(TriangleMesh { vertices, faces, hierarchy: OnceLock::new() })
    }

    pub fn vertices(&self) -> &[Point] {
        &self.vertices
    }

    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    pub fn len(&self) -> usize {
        self.faces.len()
    }

    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// Brings what names the vertices of the triangle into the cache.
    #[inline(always)]
    pub fn prefetch_face<I: Isa>(&self, id: u32) {
        I::prefetch(&self.faces[id as usize]);
    }

    /// Brings the vertices of the triangle into the cache.
    #[inline(always)]
    pub fn prefetch_vertices<I: Isa>(&self, id: u32) {
        for v in self.faces[id as usize] {
            I::prefetch(&self.vertices[v as usize]);
        }
    }

    #[inline(always)]
    pub fn triangle(&self, id: u32) -> Triangle {
        let [a, b, c] = self.faces[id as usize].map(|v| self.vertices[v as usize]);
        Triangle(a, b, c)
    }

    pub fn degenerate(&self) -> usize {
        (0..self.len() as u32).filter(|&id| self.triangle(id).is_degenerate()).count()
    }

    pub fn hierarchy(&self) -> &Bvh<Block> {
        // Only what is built runs in the pool: a thread of it that waits for its fellows takes up other work, and must not come back here.
        self.hierarchy.get_or_init(|| {
            parallel::run(|| Bvh::new(self.len(), |id| self.triangle(id).bounds(), LEAF, |ids| Block::new(ids, self)))
        })
    }

    pub fn bounds(&self) -> Option<[Interval; 3]> {
        let mut all = self.faces.iter().flatten().map(|&v| self.vertices[v as usize]);
        let first = all.next()?.map(Interval::point);
        Some(all.fold(first, |b, v| {
            std::array::from_fn(|i| Interval { low: b[i].low.min(v[i]), high: b[i].high.max(v[i]) })
        }))
    }

    pub fn bytes(&self) -> usize {
        self.vertices.len() * size_of::<Point>()
            + self.faces.len() * size_of::<[u32; 3]>()
            + self.hierarchy.get().map_or(0, Bvh::bytes)
    }
}

/// A leaf: up to eight triangles side by side, their vertices on a grid.
///
/// What is decided here is certain for the vertices themselves, as the error of the grid is in every bound; the rest is left to
/// exact arithmetic.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Block {
    /// By vertex and triangle, x in the lowest bits: a coordinate k stands for anchor + (1 + k/2²¹)·2^exponent.
    grid: [[u64; LEAF]; 3],
    id: [u32; LEAF],
    anchor: Point,
    /// How far any coordinate is off.
    error: f32,
    exponent: i16,
    count: u16,
}

/// Bits of a coordinate.
const GRID: u32 = simd::FRACTION;

type Lanes<I> = <I as Isa>::F64x8;

/// The triangles of a block as a ray's origin sees them.
pub struct Edges<I: Isa> {
    /// a, b, c.
    vertices: [[Lanes<I>; 3]; 3],
    /// c × b, a × c, b × a.
    normals: [[Lanes<I>; 3]; 3],
    /// At least the largest coordinate of an edge, on the grid.
    scale: f64,
    /// At least the largest coordinate of a vertex, and the error of any of them.
    reach: f64,
    error: f64,
}

/// The planes of a block's triangles, as a ray's origin sees them: N = (b − a) × (c − a), N·a and |N|₁.
pub struct Planes {
    normal: [[f64; LEAF]; 3],
    distance: [f64; LEAF],
    size: [f64; LEAF],
}

impl Block {
    fn new(ids: &[u32], mesh: &TriangleMesh) -> Self {
        const STEPS: f64 = (1 << GRID) as f64;
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for &id in ids {
            let Triangle(a, b, c) = mesh.triangle(id);
            for p in [a, b, c] {
                for axis in 0..3 {
                    (low[axis], high[axis]) = (low[axis].min(p[axis]), high[axis].max(p[axis]));
                }
            }
        }
        let side = larger(high[0] - low[0], larger(high[1] - low[1], high[2] - low[2]));
        // A box this large leaves every decision to exact arithmetic.
        let (side, mut error) = if side < f64::MAX / 4.0 { (side, 0.0) } else { (1.0, f64::INFINITY) };
        // The power of two above the side, so that k < 2²¹ reaches over it.
        let exponent = (side.to_bits() >> 52) as i16 - 1022;
        let scale = power_of_two(exponent);
        let anchor = low.map(|x| x - scale);
        let (mut grid, mut all) = ([[0; LEAF]; 3], [0; LEAF]);
        for (lane, &id) in ids.iter().enumerate() {
            all[lane] = id;
            let Triangle(a, b, c) = mesh.triangle(id);
            for (vertex, p) in [a, b, c].into_iter().enumerate() {
                for axis in 0..3 {
                    let exact = p[axis] - anchor[axis];
                    let k = ((exact / scale - 1.0) * STEPS).round_ties_even().clamp(0.0, STEPS - 1.0);
                    grid[vertex][lane] |= (k as u64) << (GRID * axis as u32);
                    // The difference itself is rounded, too.
                    let off = (exact - (1.0 + k / STEPS) * scale).abs() + exact.abs() * (2.0 * UNIT);
                    error = larger(error, off);
                }
            }
        }
        let error = (error as f32).next_up();
        Block { grid, id: all, anchor, error, exponent, count: ids.len() as u16 }
    }

    #[inline(always)]
    pub fn ids(&self) -> &[u32] {
        &self.id[..self.count as usize]
    }

    #[inline(always)]
    pub fn edges<I: Isa>(&self, origin: Point, origin_error: f64) -> Edges<I> {
        let shift = [self.anchor[0] - origin[0], self.anchor[1] - origin[1], self.anchor[2] - origin[2]];
        let scale = power_of_two(self.exponent);
        let vertices = [
            self.vertices::<I>(0, scale, shift),
            self.vertices::<I>(1, scale, shift),
            self.vertices::<I>(2, scale, shift),
        ];
        let [a, b, c] = vertices;
        let farthest = larger(shift[0].abs(), larger(shift[1].abs(), shift[2].abs()));
        let error = f64::from(self.error) + origin_error;
        Edges {
            vertices,
            normals: [lanes::fused_cross(c, b), lanes::fused_cross(a, c), lanes::fused_cross(b, a)],
            scale,
            // The sum rounds; a trifle more is as good.
            reach: (farthest + 2.0 * scale + error) * (1.0 + 4.0 * UNIT),
            error,
        }
    }

    /// A vertex of each triangle, moved by `shift`.
    #[inline(always)]
    fn vertices<I: Isa>(&self, vertex: usize, scale: f64, shift: Point) -> [Lanes<I>; 3] {
        let (grid, scale) = (&self.grid[vertex], Lanes::<I>::splat(scale));
        [
            I::fraction::<0>(grid).fused(scale, Lanes::<I>::splat(shift[0])),
            I::fraction::<GRID>(grid).fused(scale, Lanes::<I>::splat(shift[1])),
            I::fraction::<{ 2 * GRID }>(grid).fused(scale, Lanes::<I>::splat(shift[2])),
        ]
    }

    /// The triangles that a ray may meet, a bit each, and those of them that it surely meets: by the three volumes d·(c × b), d·(a × c),
    /// d·(b × a). Two of them with different signs rule a triangle out, three of one sign make a hit.
    ///
    /// With m ≥ all coordinates of a, b, c, and ε the error of the grid and of the origin: a coordinate is off by δ = 3u·m + ε at most,
    /// a minor p·q − r·s of two of them by 4mδ + 2δ² + 4u·m², and the sum of its three products with d by that and 6u·m² a unit of |d|₁.
    /// While δ ≤ m, which m ≥ ε brings about, this is less than |d|₁·m·(28u·m + 6ε). An error ε_d of the direction adds 6m²·ε_d. The bound has
    /// 32, 8 and 8 in these places to cover its own roundings.
    #[inline(always)]
    pub fn candidates<I: Isa>(&self, edges: &Edges<I>, direction: Point, direction_error: f64) -> (u32, u32) {
        let d = lanes::splat(direction);
        let [n0, n1, n2] = edges.normals;
        let (u, v, w) = (lanes::fused_dot(d, n0), lanes::fused_dot(d, n1), lanes::fused_dot(d, n2));
        let m = larger(edges.reach, edges.error);
        let length = direction[0].abs() + direction[1].abs() + direction[2].abs();
        let bound =
            m * (length * (32.0 * UNIT * m + 8.0 * edges.error) + 8.0 * m * direction_error) + f64::MIN_POSITIVE;
        let least = Floats::min(Floats::min(u, v), w);
        let most = Floats::max(Floats::max(u, v), w);
        let (below, above) = (Lanes::<I>::splat(-bound), Lanes::<I>::splat(bound));
        let apart = least.lt(below) & above.lt(most);
        let together = above.lt(least) | most.lt(below);
        let candidates = !apart & ((1 << self.count) - 1);
        (candidates, candidates & together)
    }

    #[inline(always)]
    pub fn planes<I: Isa>(&self, edges: &Edges<I>) -> Planes {
        let [a, b, c] = edges.vertices;
        let e1 = [b[0].sub(a[0]), b[1].sub(a[1]), b[2].sub(a[2])];
        let e2 = [c[0].sub(a[0]), c[1].sub(a[1]), c[2].sub(a[2])];
        let n = lanes::fused_cross(e1, e2);
        Planes {
            normal: [n[0].store(), n[1].store(), n[2].store()],
            distance: lanes::fused_dot(n, a).store(),
            size: n[0].abs().add(n[1].abs()).add(n[2].abs()).store(),
        }
    }

    /// Bounds of t = N·a/(N·d) for triangle i, which the ray surely meets; none if they would be of no use.
    ///
    /// A vertex is off by δ = 3u·m + ε at most, as above. With e ≥ all coordinates of the edges, seen or true: were there no more rounding,
    /// the triangle seen would be met in a point that is a mean of its vertices, so at most δ·|N|₁ off the true plane, |N| times; that is
    /// δ·|N|₁/|N·d| in t. The rounding of N, 8u·e² a coordinate, turns the plane about a point of the triangle and moves t by
    /// 24u·e³/|N·d|; the sum N·a rounds by 4u·m·|N|₁, and N·d by |N|₁·(4u·|d|∞ + ε_d). N itself, seen or true, differs by 8u·e² + 9δ·e a
    /// coordinate. All are doubled, so that second-order terms are covered while N·d is at least twice its error; the product with
    /// 1/(N·d) instead of a quotient rounds by 3u.
    #[inline(always)]
    pub fn meet<I: Isa>(
        i: usize,
        edges: &Edges<I>,
        planes: &Planes,
        direction: Point,
        direction_error: f64,
    ) -> Option<Interval> {
        let den = pose::dot([planes.normal[0][i], planes.normal[1][i], planes.normal[2][i]], direction);
        let speed = larger(direction[0].abs(), larger(direction[1].abs(), direction[2].abs()));
        let off = 3.0 * UNIT * edges.reach + edges.error;
        let e = edges.scale + 2.0 * off;
        let wobble = 3.0 * e * (8.0 * UNIT * e + 9.0 * off);
        let slack = 4.0 * UNIT * speed + direction_error;
        let size = planes.size[i] + wobble;
        let den_error = 2.0 * (size * slack + wobble * speed) + f64::MIN_POSITIVE;
        let inverse = 1.0 / den;
        let t = planes.distance[i] * inverse;
        let moved = size * (off + 4.0 * UNIT * edges.reach + t.abs() * slack) + 24.0 * UNIT * e * e * e;
        // 1/(|N·d| − its error) is at most twice 1/|N·d|.
        let error = 4.0 * moved * inverse.abs() + t.abs() * (8.0 * UNIT) + f64::MIN_POSITIVE;
        let known = 2.0 * den_error < den.abs() && error < f64::INFINITY;
        if known { Some(Interval { low: t - error, high: t + error }) } else { None }
    }
}

/// No NaN is met here; the comparison is one instruction.
#[inline(always)]
fn larger(x: f64, y: f64) -> f64 {
    if x > y { x } else { y }
}

#[inline(always)]
fn power_of_two(exponent: i16) -> f64 {
    f64::from_bits(((i64::from(exponent) + 1023) as u64) << 52)
}
