//! Triangle mesh: triangles over shared vertices, with a hierarchy of their boxes.

use std::sync::OnceLock;

use super::{Surface, Triangle};
use crate::bvh::{Bvh, LEAF};
use crate::number::{Interval, UNIT};
use crate::pose;
use crate::simd::{Floats, Isa, lanes};
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
        self.hierarchy
            .get_or_init(|| Bvh::new(self.len(), |id| self.triangle(id).bounds(), LEAF, |ids| Block::new(ids, self)))
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

/// A leaf: up to eight triangles side by side, their vertices as float32 offsets from a float64 anchor.
///
/// What is decided here is certain for the vertices themselves, as the error of the offsets is in every bound; the rest is left to
/// exact arithmetic.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Block {
    /// By vertex, axis, triangle.
    offset: [[[f32; LEAF]; 3]; 3],
    id: [u32; LEAF],
    anchor: Point,
    /// The largest offset, and how far any of them is off.
    reach: f64,
    error: f64,
    count: u32,
}

type Lanes<I> = <I as Isa>::F64x8;

/// The triangles of a block as a ray's origin sees them.
pub struct Edges<I: Isa> {
    /// c × b, a × c, b × a.
    normals: [[Lanes<I>; 3]; 3],
    /// From the origin to the anchor.
    shift: Point,
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
        let anchor = mesh.triangle(ids[0]).0;
        let mut block = Block {
            offset: [[[0.0; LEAF]; 3]; 3],
            id: [0; LEAF],
            anchor,
            reach: 0.0,
            error: 0.0,
            count: ids.len() as u32,
        };
        for (lane, &id) in ids.iter().enumerate() {
            block.id[lane] = id;
            let Triangle(a, b, c) = mesh.triangle(id);
            for (vertex, p) in [a, b, c].into_iter().enumerate() {
                for axis in 0..3 {
                    let exact = p[axis] - anchor[axis];
                    let offset = exact as f32;
                    block.offset[vertex][axis][lane] = offset;
                    block.reach = block.reach.max(f64::from(offset).abs());
                    // The difference itself is rounded, too.
                    let error = (exact - f64::from(offset)).abs() + exact.abs() * (2.0 * UNIT);
                    block.error = block.error.max(error.next_up());
                }
            }
        }
        block
    }

    #[inline(always)]
    pub fn ids(&self) -> &[u32] {
        &self.id[..self.count as usize]
    }

    #[inline(always)]
    pub fn edges<I: Isa>(&self, origin: Point, origin_error: f64) -> Edges<I> {
        let shift = [self.anchor[0] - origin[0], self.anchor[1] - origin[1], self.anchor[2] - origin[2]];
        let (a, b, c) = (self.vertices::<I>(0, shift), self.vertices::<I>(1, shift), self.vertices::<I>(2, shift));
        let farthest = larger(shift[0].abs(), larger(shift[1].abs(), shift[2].abs()));
        Edges {
            normals: [lanes::fused_cross(c, b), lanes::fused_cross(a, c), lanes::fused_cross(b, a)],
            shift,
            // The sum rounds; a trifle more is as good.
            reach: (farthest + self.reach) * (1.0 + 4.0 * UNIT),
            error: self.error + origin_error,
        }
    }

    #[inline(always)]
    fn vertices<I: Isa>(&self, vertex: usize, shift: Point) -> [Lanes<I>; 3] {
        let [x, y, z] = widen::<I>(&self.offset[vertex]);
        [x.add(Lanes::<I>::splat(shift[0])), y.add(Lanes::<I>::splat(shift[1])), z.add(Lanes::<I>::splat(shift[2]))]
    }

    /// The triangles that a ray may meet, a bit each, and those of them that it surely meets: by the three volumes d·(c × b), d·(a × c),
    /// d·(b × a). Two of them with different signs rule a triangle out, three of one sign make a hit.
    ///
    /// With m ≥ all coordinates of a, b, c, and ε the error of the offsets and of the origin: a coordinate is off by δ = 3u·m + ε at most,
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
        let [a, b, c] = &self.offset;
        let (a, b, c) = (widen::<I>(a), widen::<I>(b), widen::<I>(c));
        let e1 = [b[0].sub(a[0]), b[1].sub(a[1]), b[2].sub(a[2])];
        let e2 = [c[0].sub(a[0]), c[1].sub(a[1]), c[2].sub(a[2])];
        let n = lanes::fused_cross(e1, e2);
        let shift: [Lanes<I>; 3] = lanes::splat(edges.shift);
        let seen = [a[0].add(shift[0]), a[1].add(shift[1]), a[2].add(shift[2])];
        Planes {
            normal: [n[0].store(), n[1].store(), n[2].store()],
            distance: lanes::fused_dot(n, seen).store(),
            size: n[0].abs().add(n[1].abs()).add(n[2].abs()).store(),
        }
    }

    /// Bounds of t = N·a/(N·d) for triangle i, which the ray surely meets; none if they would be of no use.
    ///
    /// With e ≥ all coordinates of the edges: were there no rounding, the triangle seen would be met in a point that is a mean of its vertices,
    /// so at most ε·|N|₁ off the true plane, |N| times; that is ε·|N|₁/|N·d| in t. The rounding of N, 8u·e² a coordinate, turns the
    /// plane about a point of the triangle and moves t by 24u·e³/|N·d|; a is off by 3u·m besides ε, the sum N·a rounds by 4u·m·|N|₁, and N·d by
    /// |N|₁·(4u·|d|∞ + ε_d). N itself, seen or true, differs by 8u·e² + 9ε·e a coordinate. All are doubled, so that second-order
    /// terms are covered while N·d is at least twice its error; the product with 1/(N·d) instead of a quotient rounds by 3u.
    #[inline(always)]
    pub fn meet<I: Isa>(
        &self,
        i: usize,
        edges: &Edges<I>,
        planes: &Planes,
        direction: Point,
        direction_error: f64,
    ) -> Option<Interval> {
        let den = pose::dot([planes.normal[0][i], planes.normal[1][i], planes.normal[2][i]], direction);
        let speed = larger(direction[0].abs(), larger(direction[1].abs(), direction[2].abs()));
        let e = 2.0 * self.reach;
        let wobble = 3.0 * e * (8.0 * UNIT * e + 9.0 * self.error);
        let slack = 4.0 * UNIT * speed + direction_error;
        let size = planes.size[i] + wobble;
        let den_error = 2.0 * (size * slack + wobble * speed) + f64::MIN_POSITIVE;
        let inverse = 1.0 / den;
        let t = planes.distance[i] * inverse;
        let moved = size * (7.0 * UNIT * edges.reach + edges.error + t.abs() * slack) + 24.0 * UNIT * e * e * e;
        // 1/(|N·d| − its error) is at most twice 1/|N·d|.
        let error = 4.0 * moved * inverse.abs() + t.abs() * (8.0 * UNIT) + f64::MIN_POSITIVE;
        let known = 2.0 * den_error < den.abs() && error < f64::INFINITY;
        if known { Some(Interval { low: t - error, high: t + error }) } else { None }
    }
}

#[inline(always)]
fn widen<I: Isa>(v: &[[f32; LEAF]; 3]) -> [Lanes<I>; 3] {
    [I::widen(&v[0]), I::widen(&v[1]), I::widen(&v[2])]
}

/// No NaN is met here; the comparison is one instruction.
#[inline(always)]
fn larger(x: f64, y: f64) -> f64 {
    if x > y { x } else { y }
}
