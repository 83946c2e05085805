//! Triangle mesh: triangles over shared vertices, with a hierarchy of their boxes.

use std::sync::OnceLock;

use super::{Surface, Triangle};
use crate::bvh::{Bvh, LEAF};
use crate::number::{Interval, UNIT};
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
            Bvh::new(&bounds, LEAF, |ids| Block::new(ids, self))
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
/// What is decided here is certain for the vertices themselves, as the error of the offsets is in every bound; the rest is left to
/// exact arithmetic.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
pub struct Block {
    /// By vertex, axis, triangle.
    offset: [[[f32; LEAF]; 3]; 3],
    id: [u32; LEAF],
    /// The faces, by triangle.
    face: [[u32; 3]; LEAF],
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
    a: [Lanes<I>; 3],
    /// At least the largest coordinate of a vertex, and the error of any of them.
    reach: f64,
    error: f64,
}

/// The planes of a block's triangles, as a ray's origin sees them.
pub struct Planes<I: Isa> {
    /// N = (b − a) × (c − a), N·a and |N|₁.
    normal: [Lanes<I>; 3],
    distance: Lanes<I>,
    size: Lanes<I>,
}

/// What a ray does to the triangles of a block, a bit each.
pub struct Met {
    /// Hits, with bounds of t for each triangle.
    pub hit: u32,
    pub low: [f64; LEAF],
    pub high: [f64; LEAF],
    /// Triangles that exact arithmetic has to look at.
    pub unsure: u32,
}

impl Block {
    fn new(ids: &[u32], mesh: &TriangleMesh) -> Self {
        let anchor = mesh.triangle(ids[0]).0;
        let mut block = Block {
            offset: [[[0.0; LEAF]; 3]; 3],
            id: [0; LEAF],
            face: [[0; 3]; LEAF],
            anchor,
            reach: 0.0,
            error: 0.0,
            count: ids.len() as u32,
        };
        for (lane, &id) in ids.iter().enumerate() {
            (block.id[lane], block.face[lane]) = (id, mesh.faces[id as usize]);
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

    /// Has the vertices of triangle i in the cache for when its hit is refined.
    #[inline(always)]
    pub fn prefetch<I: Isa>(&self, i: usize, mesh: &TriangleMesh) {
        I::prefetch(&mesh.faces[self.id[i] as usize]);
        for v in self.face[i] {
            I::prefetch(&mesh.vertices[v as usize]);
        }
    }

    #[inline(always)]
    pub fn edges<I: Isa>(&self, origin: Point, origin_error: f64) -> Edges<I> {
        let shift = [self.anchor[0] - origin[0], self.anchor[1] - origin[1], self.anchor[2] - origin[2]];
        let (a, b, c) = (self.vertex::<I>(0, shift), self.vertex::<I>(1, shift), self.vertex::<I>(2, shift));
        let larger = |x: f64, y: f64| if x > y { x } else { y };
        let farthest = larger(shift[0].abs(), larger(shift[1].abs(), shift[2].abs()));
        Edges {
            normals: [lanes::cross(c, b), lanes::cross(a, c), lanes::cross(b, a)],
            a,
            // The sum rounds; a trifle more is as good.
            reach: (farthest + self.reach) * (1.0 + 4.0 * UNIT),
            error: self.error + origin_error,
        }
    }

    #[inline(always)]
    fn vertex<I: Isa>(&self, vertex: usize, shift: Point) -> [Lanes<I>; 3] {
        let [x, y, z] = &self.offset[vertex];
        [
            I::widen(x).add(Lanes::<I>::splat(shift[0])),
            I::widen(y).add(Lanes::<I>::splat(shift[1])),
            I::widen(z).add(Lanes::<I>::splat(shift[2])),
        ]
    }

    #[inline(always)]
    pub fn planes<I: Isa>(&self, edges: &Edges<I>) -> Planes<I> {
        let (a, b, c) = (self.vertex::<I>(0, [0.0; 3]), self.vertex::<I>(1, [0.0; 3]), self.vertex::<I>(2, [0.0; 3]));
        let e1 = [b[0].sub(a[0]), b[1].sub(a[1]), b[2].sub(a[2])];
        let e2 = [c[0].sub(a[0]), c[1].sub(a[1]), c[2].sub(a[2])];
        let normal = lanes::cross(e1, e2);
        let size = normal[0].abs().add(normal[1].abs()).add(normal[2].abs());
        Planes { normal, distance: lanes::dot(normal, edges.a), size }
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
        let (u, v, w) = (lanes::dot(d, n0), lanes::dot(d, n1), lanes::dot(d, n2));
        let m = if edges.reach > edges.error { edges.reach } else { edges.error };
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

    /// Bounds of t = N·a/(N·d) for the candidates, and those whose bounds do not begin beyond `limit`.
    ///
    /// With e ≥ all coordinates of the edges: were there no rounding, the triangle seen would be met in a point that is a mean of its vertices,
    /// so at most ε·|N|₁ off the true plane, |N| times; that is ε·|N|₁/|N·d| in t. The rounding of N, 8u·e² a coordinate, turns the
    /// plane about a point of the triangle and moves t by 24u·e³/|N·d|; a is off by 3u·m besides ε, the sum N·a rounds by 4u·m·|N|₁, and N·d by
    /// |N|₁·(4u·|d|∞ + ε_d). N itself, seen or true, differs by 8u·e² + 9ε·e a coordinate. All are doubled, so that second-order
    /// terms are covered while N·d is at least twice its error.
    #[inline(always)]
    pub fn meet<I: Isa>(
        &self,
        edges: &Edges<I>,
        planes: &Planes<I>,
        (candidates, sure): (u32, u32),
        direction: Point,
        direction_error: f64,
        limit: f64,
    ) -> Met {
        let splat = Lanes::<I>::splat;
        let larger = |x: f64, y: f64| if x > y { x } else { y };
        let speed = larger(direction[0].abs(), larger(direction[1].abs(), direction[2].abs()));
        let e = 2.0 * self.reach;
        let wobble = 3.0 * e * (8.0 * UNIT * e + 9.0 * self.error);
        let slack = 4.0 * UNIT * speed + direction_error;
        let size = planes.size.add(splat(wobble));
        let den = lanes::dot(planes.normal, lanes::splat(direction));
        let den_error = size.mul(splat(2.0 * slack)).add(splat(2.0 * wobble * speed + f64::MIN_POSITIVE));
        let steep = den_error.add(den_error).lt(den.abs());
        let t = planes.distance.div(den);
        let shifted = splat(7.0 * UNIT * edges.reach + edges.error).add(t.abs().mul(splat(slack)));
        let moved = size.mul(shifted).add(splat(24.0 * UNIT * e * e * e));
        let error = moved.add(moved).div(den.abs().sub(den_error));
        let error = error.add(t.abs().mul(splat(4.0 * UNIT))).add(splat(f64::MIN_POSITIVE));
        let (low, high) = (t.sub(error), t.add(error));
        let known = sure & steep & error.lt(splat(f64::INFINITY));
        Met { hit: known & low.le(splat(limit)), low: low.store(), high: high.store(), unsure: candidates & !known }
    }
}
