//! Triangle mesh: triangles over shared vertices, with a hierarchy of their boxes.

use std::sync::OnceLock;

use super::{Surface, Triangle};
use crate::bvh::{Bvh, LEAF};
use crate::number::{Interval, UNIT};
use crate::refine::Seen;
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

    #[inline(always)]
    pub fn triangle(&self, id: u32) -> Triangle {
        let [a, b, c] = self.faces[id as usize].map(|v| self.vertices[v as usize]);
        Triangle(a, b, c)
    }

    pub fn degenerate(&self) -> usize {
        (0..self.len() as u32).filter(|&id| self.triangle(id).is_degenerate()).count()
    }

    pub fn hierarchy(&self) -> &Bvh<Block> {
        self.hierarchy.get_or_init(|| {
            let bounds: Vec<_> = (0..self.len() as u32).map(|id| self.triangle(id).bounds()).collect();
            Bvh::new(&bounds, |ids| Block::new(ids, |id| self.triangle(id)))
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

/// A leaf: up to eight triangles side by side, their vertices as float32 offsets from a float64 anchor.
///
/// It only rules triangles out, with the error of the offsets in its bound; what it does not rule out is looked at again with
/// the vertices themselves.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
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

/// The edges of a block's triangles as a ray's origin sees them: c × b, a × c, b × a.
pub struct Edges<I: Isa> {
    normals: [[I::F64x8; 3]; 3],
    /// The largest coordinate of a vertex, or a bit more.
    reach: f64,
    /// See `Block::candidates`.
    error: f64,
}

impl Block {
    fn new(ids: &[u32], triangle: impl Fn(u32) -> Triangle) -> Self {
        let anchor = triangle(ids[0]).0;
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
            let Triangle(a, b, c) = triangle(id);
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
    pub fn edges<I: Isa>(&self, origin: Point) -> Edges<I> {
        let shift = [self.anchor[0] - origin[0], self.anchor[1] - origin[1], self.anchor[2] - origin[2]];
        let (a, b, c) = (self.vertex::<I>(0, shift), self.vertex::<I>(1, shift), self.vertex::<I>(2, shift));
        let farthest = shift[0].abs().max(shift[1].abs()).max(shift[2].abs());
        Edges {
            normals: [lanes::cross(c, b), lanes::cross(a, c), lanes::cross(b, a)],
            // The sum rounds; a trifle more than it is as good.
            reach: (farthest + self.reach) * (1.0 + 4.0 * UNIT),
            error: self.error,
        }
    }

    #[inline(always)]
    fn vertex<I: Isa>(&self, vertex: usize, shift: Point) -> [I::F64x8; 3] {
        let [x, y, z] = &self.offset[vertex];
        [
            I::widen(x).add(I::F64x8::splat(shift[0])),
            I::widen(y).add(I::F64x8::splat(shift[1])),
            I::widen(z).add(I::F64x8::splat(shift[2])),
        ]
    }

    /// Triangle i as a ray sees it, whose origin is off by so much.
    #[inline(always)]
    pub fn seen(&self, i: usize, origin: Point, origin_error: f64) -> Seen {
        let [a, b, c] = &self.offset;
        let vertex = |v: &[[f32; LEAF]; 3]| [f64::from(v[0][i]), f64::from(v[1][i]), f64::from(v[2][i])];
        let (a, b, c) = (vertex(a), vertex(b), vertex(c));
        let shift = [self.anchor[0] - origin[0], self.anchor[1] - origin[1], self.anchor[2] - origin[2]];
        let farthest = shift[0].abs().max(shift[1].abs()).max(shift[2].abs());
        let add = |p: Point| [p[0] + shift[0], p[1] + shift[1], p[2] + shift[2]];
        let sub = |p: Point, q: Point| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
        // The shift rounds by itself, before the rounding that `Seen` knows of.
        let error = self.error + origin_error + 2.0 * UNIT * farthest;
        Seen { vertices: [add(a), add(b), add(c)], edges: [sub(b, a), sub(c, a)], error }
    }

    /// The triangles that a ray from the origin of `edges` may meet, a bit each: those whose three volumes d·(c × b), d·(a × c),
    /// d·(b × a) have no two signs that differ beyond all rounding.
    ///
    /// With m ≥ all coordinates of a, b, c, and ε the error of the offsets and of the origin: a coordinate is off by δ = 3u·m + ε at most,
    /// a minor p·q − r·s of two of them by 4mδ + 2δ² + 4u·m², and the sum of its three products with d by that and 6u·m² a unit of |d|₁.
    /// While δ ≤ m, which m ≥ ε brings about, this is less than |d|₁·m·(28u·m + 6ε). An error ε_d of the direction adds 6m²·ε_d. The bound has
    /// 32, 8 and 8 in these places to cover its own roundings.
    #[inline(always)]
    pub fn candidates<I: Isa>(
        &self,
        edges: &Edges<I>,
        direction: Point,
        origin_error: f64,
        direction_error: f64,
    ) -> u32 {
        let d = lanes::splat(direction);
        let [n0, n1, n2] = edges.normals;
        let (u, v, w) = (lanes::dot(d, n0), lanes::dot(d, n1), lanes::dot(d, n2));
        let error = edges.error + origin_error;
        let m = if edges.reach > error { edges.reach } else { error };
        let length = direction[0].abs() + direction[1].abs() + direction[2].abs();
        let bound = m * (length * (32.0 * UNIT * m + 8.0 * error) + 8.0 * m * direction_error) + f64::MIN_POSITIVE;
        let least = Floats::min(Floats::min(u, v), w);
        let most = Floats::max(Floats::max(u, v), w);
        let apart = least.lt(I::F64x8::splat(-bound)) & I::F64x8::splat(bound).lt(most);
        !apart & ((1 << self.count) - 1)
    }
}
