//! Leaves of a mesh: eight triangles as a structure of arrays, with vertices quantized to a grid.
//!
//! ```text
//! edges of the leaf, once per packet:  a, b, c = anchor + grid·scale − reference;  c×b, a×c, b×a;  N·a
//! for each ray, eight triangles at once:  U, V, W = d·(c×b), d·(a×c), d·(b×a)
//!     if it starts at o, apart:           U += (b − c)·(o × d), and V, W likewise
//!     E = |d|₁·m·(64u·m + 12ε) + 12m²·ε_d  what a volume is off by, at most
//!     if one of them < −E and another > E:  a miss
//!     else if all > E or all < −E:          a certain hit, with t = a·(c×b)/(U + V + W) within bounds
//!     else:                                 uncertain: certainly beside the ray, or deferred to exact tests
//! ```
//!
//! | symbol | meaning | in the code |
//! |---|---|---|
//! | a, b, c | corners on the grid, relative to the reference | `Edges::vertices` |
//! | c×b, a×c, b×a | normals of the volumes | `Edges::normals` |
//! | N | normal of the triangle, (b − a) × (c − a) | `plane_normals` |
//! | d, o | direction and start of the ray | `LeafRay::direction`, `start` |
//! | U, V, W | six times the volumes of d with the sides | `volumes` |
//! | m, s | upper bounds of the coordinates; of the sides | `reach`, `scale` |
//! | ε, ε_d | error of the grid and the start; of the direction | `Edges::error`, `LeafRay::error` |
//! | δ, u | error of a coordinate, 4u·m + ε; 2⁻⁵³ | `off`, `UNIT` |

use super::Triangle;
use crate::arith::number::{Interval, UNIT};
use crate::arith::simd::{self, Floats, Isa, lanes};
use crate::geometry::point::cross;
use crate::geometry::vector::Point;

/// Most triangles in a leaf: one per lane of a register.
pub const LEAF_SIZE: usize = 8;

/// Up to eight triangles with their vertices on a grid.
///
/// Decisions here are certain for the vertices as given, since every bound includes the error of the grid;
/// uncertain candidates are deferred.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Leaf {
    /// By vertex and triangle, x in the lowest bits: a coordinate k stands for anchor + (1 +
    /// k/2²¹)·2^exponent.
    grid: [[u64; LEAF_SIZE]; 3],
    id: [u32; LEAF_SIZE],
    anchor: Point,
    /// A bound of the error of any coordinate.
    error: f32,
    exponent: i16,
    count: u8,
    /// Every triangle has |N|₁ ≤ 8·2^(2·exponent − thinness), N = (b − a) × (c − a).
    thinness: u8,
}

/// Bits of a coordinate.
const GRID: u32 = simd::FRACTION;

type F64x8<I> = <I as Isa>::F64x8;

/// The triangles of a leaf on its grid, by vertex: 1 + k/2²¹ for each coordinate.
pub struct GridVertices<I: Isa>([[F64x8<I>; 3]; 3]);

/// The triangles of a leaf relative to a reference point, near which rays start.
pub struct Edges<I: Isa> {
    /// a, b, c.
    vertices: [[F64x8<I>; 3]; 3],
    /// c × b, a × c, b × a.
    normals: [[F64x8<I>; 3]; 3],
    /// b − c, c − a, a − b.
    sides: [[F64x8<I>; 3]; 3],
    /// An upper bound of the coordinates of edges, on the grid.
    scale: f64,
    /// Upper bounds of the coordinates of vertices, relative to the reference or the start of a ray, and of
    /// their error.
    reach: f64,
    error: f64,
    /// The error of the volumes, per unit of a direction's length and of its error.
    bound: [f64; 2],
}

/// The planes of a leaf's triangles relative to a reference point.
#[repr(C, align(64))]
pub struct Planes {
    /// a·(c × b), with the sign of the volumes.
    distance: [f64; LEAF_SIZE],
    /// Four times the error of the sum of the volumes, per unit of a direction's length and of its error.
    turned: [f64; 2],
    /// The same for the distance.
    moved: f64,
}

/// A ray's direction, an upper bound of |d|₁, and the error of any coordinate; and if it starts apart from
/// the reference, its start relative to that, and its moment, start × direction.
#[derive(Clone, Copy)]
pub struct LeafRay {
    pub direction: Point,
    pub length: f64,
    pub error: f64,
    pub start: Point,
    pub moment: Point,
}

/// The data of `Edges` that `Leaf::test` needs, by triangle.
#[repr(C, align(64))]
pub struct StoredEdges {
    normals: [[[f64; LEAF_SIZE]; 3]; 3],
    sides: [[[f64; LEAF_SIZE]; 3]; 3],
    plane_normals: [[f64; LEAF_SIZE]; 3],
    bound: [f64; 2],
}

/// Eight rays; see `LeafRay`.
pub struct LeafRays<I: Isa> {
    pub direction: [F64x8<I>; 3],
    pub length: F64x8<I>,
    pub error: F64x8<I>,
    pub start: [F64x8<I>; 3],
    pub moment: [F64x8<I>; 3],
}

/// Bounds of many rays: of each coordinate of direction and moment, of the sum of the largest |dᵢ|, and of
/// the error of any coordinate of the direction.
#[derive(Clone, Copy)]
pub struct RayBounds {
    pub low: Point,
    pub high: Point,
    pub low_moment: Point,
    pub high_moment: Point,
    pub length: f64,
    pub error: f64,
}

/// Eight rays against one triangle: the rays that may hit it, those that certainly hit it at a t with known
/// bounds, and these bounds.
pub struct TriangleTest<I: Isa> {
    pub candidates: u32,
    pub known: u32,
    pub t: Interval<F64x8<I>>,
}

impl Leaf {
    /// A leaf of up to `LEAF_SIZE` triangles, at least one.
    pub fn new(ids: &[u32], triangle: impl Fn(u32) -> Triangle) -> Self {
        Self::with_bounds(ids, triangle).0
    }

    /// As `new`, with the bounds of all vertices. Loops are over lanes, so that they vectorize.
    pub fn with_bounds(ids: &[u32], triangle: impl Fn(u32) -> Triangle) -> (Self, [Interval; 3]) {
        const STEPS: f64 = (1 << GRID) as f64;
        /// Adding it rounds a number in [0, 2²¹) to the nearest integer, ties to even, which is then in the
        /// lowest bits.
        const ROUNDING: f64 = (1_u64 << (f64::MANTISSA_DIGITS - 1)) as f64;
        // By vertex and axis; unused lanes repeat the first.
        let mut vertices = [[[0.0; LEAF_SIZE]; 3]; 3];
        let mut all = [0; LEAF_SIZE];
        for lane in 0..LEAF_SIZE {
            let Triangle(a, b, c) = triangle(ids[if lane < ids.len() { lane } else { 0 }]);
            for (vertex, p) in [a, b, c].into_iter().enumerate() {
                for axis in 0..3 {
                    vertices[vertex][axis][lane] = p[axis];
                }
            }
            all[lane] = if lane < ids.len() { ids[lane] } else { 0 };
        }
        let mut bounds = [Interval { low: 0.0, high: 0.0 }; 3];
        for axis in 0..3 {
            let (mut low, mut high) = (vertices[0][axis], vertices[0][axis]);
            for vertex in &vertices[1..] {
                for lane in 0..LEAF_SIZE {
                    low[lane] = smaller(low[lane], vertex[axis][lane]);
                    high[lane] = larger(high[lane], vertex[axis][lane]);
                }
            }
            bounds[axis].low = low.into_iter().fold(f64::INFINITY, smaller);
            bounds[axis].high = high.into_iter().fold(f64::NEG_INFINITY, larger);
        }
        let [x, y, z] = [0, 1, 2].map(|axis| bounds[axis].high - bounds[axis].low);
        let side = larger(x, larger(y, z));
        // A box this large leaves every decision to exact arithmetic.
        let (side, error) = if side < f64::MAX / 4.0 { (side, 0.0) } else { (1.0, f64::INFINITY) };
        // The power of two above the side, so that k < 2²¹ covers it; products with its inverse are exact.
        let exponent = (side.to_bits() >> 52) as i16 - 1022;
        let (scale, inverse) = (power_of_two(exponent), power_of_two(-exponent));
        let anchor = bounds.map(|side| side.low - scale);
        // The largest |N|₁, of sides in units of the scale, which are at most 1, so that less than 32
        // roundings are u each.
        let [a, b, c] = &vertices;
        let mut thicknesses = [0.0; LEAF_SIZE];
        for lane in 0..LEAF_SIZE {
            let edge = |p: &[[f64; LEAF_SIZE]; 3]| {
                [
                    (p[0][lane] - a[0][lane]) * inverse,
                    (p[1][lane] - a[1][lane]) * inverse,
                    (p[2][lane] - a[2][lane]) * inverse,
                ]
            };
            let [x, y, z] = cross(edge(b), edge(c));
            thicknesses[lane] = x.abs() + y.abs() + z.abs();
        }
        let thickness = thicknesses.into_iter().fold(0.0, larger);
        let (mut grid, mut errors) = ([[0; LEAF_SIZE]; 3], [error; LEAF_SIZE]);
        for vertex in 0..3 {
            for axis in 0..3 {
                for lane in 0..LEAF_SIZE {
                    let exact = vertices[vertex][axis][lane] - anchor[axis];
                    let inside = larger((exact * inverse - 1.0) * STEPS, 0.0);
                    let rounded = smaller(inside, STEPS - 1.0) + ROUNDING;
                    grid[vertex][lane] |= (rounded.to_bits() - ROUNDING.to_bits()) << (GRID * axis as u32);
                    // The difference itself is rounded, too.
                    let place = (1.0 + (rounded - ROUNDING) * (1.0 / STEPS)) * scale;
                    let off = (exact - place).abs() + exact.abs() * (2.0 * UNIT);
                    errors[lane] = larger(errors[lane], off);
                }
            }
        }
        for vertex in &mut grid {
            vertex[ids.len()..].fill(0);
        }
        let error = (errors.into_iter().fold(0.0, larger) as f32).next_up();
        let above = ((thickness + 32.0 * UNIT).to_bits() >> 52) as i16 - 1022;
        let thinness = (3 - above).clamp(0, u8::MAX.into()) as u8;
        let leaf = Leaf { grid, id: all, anchor, error, exponent, count: ids.len() as u8, thinness };
        (leaf, bounds)
    }

    #[inline(always)]
    pub fn ids(&self) -> &[u32] {
        &self.id[..self.count as usize]
    }

    /// The triangles relative to a reference point. No coordinate of a ray's start differs from it by more
    /// than `spread`, and none is off by more than `start_error`.
    #[inline(always)]
    pub fn edges<I: Isa>(
        &self,
        grid: &GridVertices<I>,
        reference: Point,
        spread: f64,
        start_error: f64,
    ) -> Edges<I> {
        let shift =
            [self.anchor[0] - reference[0], self.anchor[1] - reference[1], self.anchor[2] - reference[2]];
        let scale = power_of_two(self.exponent);
        let vertices = [
            moved::<I>(&grid.0[0], scale, shift),
            moved::<I>(&grid.0[1], scale, shift),
            moved::<I>(&grid.0[2], scale, shift),
        ];
        let [a, b, c] = vertices;
        let farthest = larger(shift[0].abs(), larger(shift[1].abs(), shift[2].abs()));
        let error = f64::from(self.error) + start_error;
        // The sum rounds; a slightly larger value is as good.
        let reach = (farthest + 2.0 * scale + spread + error) * (1.0 + 4.0 * UNIT);
        Edges {
            vertices,
            normals: [lanes::fused_cross(c, b), lanes::fused_cross(a, c), lanes::fused_cross(b, a)],
            sides: [lanes::sub(b, c), lanes::sub(c, a), lanes::sub(a, b)],
            scale,
            reach,
            error,
            // The bound of `candidates` with `reach` in place of m: `reach` includes ε.
            bound: [reach * (64.0 * UNIT * reach + 12.0 * error), 12.0 * reach * reach],
        }
    }

    /// The vertices of each triangle on the grid.
    #[inline(always)]
    pub fn grid_vertices<I: Isa>(&self) -> GridVertices<I> {
        GridVertices([
            fractions::<I>(&self.grid[0]),
            fractions::<I>(&self.grid[1]),
            fractions::<I>(&self.grid[2]),
        ])
    }

    /// The candidates, triangles that a ray may hit, and the certain hits among them, one bit each, by the
    /// three volumes U = d·(c × b), V = d·(a × c), W = d·(b × a). Two different signs are a miss,
    /// three equal signs a hit. U + V + W is stored in `sums`. `APART` says that the ray may start apart
    /// from the reference, by o: with a, b, c relative to the reference, U is then
    /// d·(c × b) + (b − c)·(o × d), as (c − o) × (b − o) = c × b + o × (c − b).
    ///
    /// With m ≥ all coordinates of a, b, c plus those of o, and ε the error of the grid and of the start:
    /// a coordinate is off by at most δ = 3u·m + ε, a minor p·q − r·s of two of them by
    /// 4mδ + 2δ² + 4u·m², and the sum of its three products with d by that and 6u·m² per unit of
    /// |d|₁. While δ ≤ m, which m ≥ ε implies, this is less than |d|₁·m·(28u·m + 6ε). An error
    /// ε_d of the direction adds 6m²·ε_d.
    ///
    /// With o, a side b − c times o's largest coordinate is at most m²/2, as m is at least twice the
    /// scale of the grid plus ε and what o reaches; so the side times the moment o × d is at most
    /// m²·|d|₁. The side is off by 2δ and its own rounding, 13u·m/2 + 2ε, and the coordinates of the
    /// moment together by |d|₁·(6u·m + 2ε): the start is off by u·m + ε, and two products and a
    /// difference round. That is 13u·m² + 4m·ε and 3u·m² + 2m·ε for the product, whose own
    /// roundings, and the larger ones of the sums that it joins, add 8u·m². All together, a volume is off
    /// by less than |d|₁·m·(52u·m + 11ε), as ε is the error of the grid for the terms in 10ε and
    /// that of the start for the others, and ε_d adds 9m²·ε_d. The bound has 64, 12 and 12 in these
    /// places to cover its own roundings.
    #[inline(always)]
    pub fn candidates<I: Isa, const APART: bool>(
        &self,
        edges: &Edges<I>,
        ray: &LeafRay,
        sums: &mut [f64; LEAF_SIZE],
    ) -> (u32, u32) {
        let moment = lanes::splat(ray.moment);
        let (volumes, sum) =
            volumes::<_, APART>(lanes::splat(ray.direction), edges.normals, moment, edges.sides);
        *sums = sum.store();
        let (mixed, equal) = signs(volumes, F64x8::<I>::splat(edges.bound_of(ray.length, ray.error)));
        let candidates = !mixed & self.all();
        (candidates, candidates & equal)
    }

    /// The triangles that certainly lie beside the line of a ray: their vertices are on one side of the plane
    /// through the line that is perpendicular to the triangle. The volumes of a ray in the plane of triangles
    /// are all about zero, however far beside it they are.
    ///
    /// With N = (b − a) × (c − a) and w = d × N, that side of a vertex a is the sign of w·(a − o).
    /// Each N gives a plane through the line, so that of the grid needs no bound. With n ≥ all coordinates
    /// of N, and m, δ and ε as in `candidates`: |wᵢ| ≤ n·|d|₁, and wᵢ rounds by 2u of that; in
    /// w·a and w·o, of at most 3n·|d|₁·m together, that is 6u·m, the errors of a and o come to
    /// 3·(4u·m + 2ε), and products and sums round by 12u·m, all times n·|d|₁. An error ε_d of the
    /// direction adds 6n·m·ε_d. So the side is off by less than n/m times the bound of `candidates`.
    #[inline(always)]
    pub fn beside<I: Isa, const APART: bool>(edges: &Edges<I>, ray: &LeafRay) -> u32 {
        let (sides, _, bound) = sides::<I, APART>(edges, ray);
        signs(sides, bound).1
    }

    /// The triangles that any of many rays may hit: all except those with one volume negative for every ray
    /// and another one positive for every ray.
    ///
    /// Over the box of the directions, n·d is least and largest at the ends of each coordinate, as is the
    /// product of a side over the box of the moments. As in `candidates`, products and sums round there;
    /// they are at most those of a direction with the largest coordinates, so the bound is the same with its
    /// length.
    #[inline(always)]
    pub fn reachable<I: Isa, const APART: bool>(&self, edges: &Edges<I>, rays: &RayBounds) -> u32 {
        let (low, high) = (lanes::splat::<F64x8<I>, 8>(rays.low), lanes::splat(rays.high));
        let (low_moment, high_moment) = (lanes::splat(rays.low_moment), lanes::splat(rays.high_moment));
        let bound = F64x8::<I>::splat(edges.bound_of(rays.length, rays.error));
        let (mut negative, mut positive) = (0, 0);
        for (n, side) in edges.normals.into_iter().zip(edges.sides) {
            let (mut least, mut most) = range_of_dot(n, low, high);
            if APART {
                let (less, more) = range_of_dot(side, low_moment, high_moment);
                (least, most) = (least.add(less), most.add(more));
            }
            negative |= most.lt(bound.negated());
            positive |= bound.lt(least);
        }
        !(negative & positive) & self.all()
    }

    /// `candidates` and `intersect` for triangle i and eight rays.
    #[inline(always)]
    pub fn test<I: Isa, const APART: bool>(
        i: usize,
        edges: &StoredEdges,
        planes: &Planes,
        rays: &LeafRays<I>,
    ) -> TriangleTest<I> {
        let [normals, sides] = [three::<I>(&edges.normals, i), three::<I>(&edges.sides, i)];
        let (volumes, sum) = volumes::<_, APART>(rays.direction, normals, rays.moment, sides);
        let bound = rays.error.fused(F64x8::<I>::splat(edges.bound[1]), F64x8::<I>::splat(f64::MIN_POSITIVE));
        let (mixed, equal) = signs(volumes, rays.length.fused(F64x8::<I>::splat(edges.bound[0]), bound));
        let mut distance = F64x8::<I>::splat(planes.distance[i]);
        if APART {
            let normal = lanes::splat(row(&edges.plane_normals, i));
            distance = distance.add(lanes::fused_dot(normal, rays.start));
        }
        let (known, t) = planes.intersect(distance, sum, rays.length, rays.error);
        TriangleTest { candidates: !mixed & 0xff, known: !mixed & equal & known, t }
    }

    #[inline(always)]
    fn all(&self) -> u32 {
        (1 << self.count) - 1
    }

    #[inline(always)]
    pub fn planes<I: Isa>(&self, edges: &Edges<I>) -> Planes {
        let off = edges.off();
        // If the square underflows, |N|₁ is less than the added number.
        let size = edges.scale * edges.scale * power_of_two(3 - i16::from(self.thinness)) + f64::MIN_POSITIVE;
        let square = edges.reach * edges.reach;
        Planes {
            distance: lanes::fused_dot(edges.normals[0], edges.vertices[0]).store(),
            turned: [512.0 * UNIT * square, 4.0 * size],
            moved: 4.0 * (size * off + 64.0 * UNIT * square * edges.reach) + f64::MIN_POSITIVE,
        }
    }
}

impl Planes {
    pub const NONE: Planes = Planes { distance: [0.0; LEAF_SIZE], turned: [0.0; 2], moved: 0.0 };

    /// Bounds of t at a certain hit of a ray on triangle i, from the sums of `Leaf::candidates`; `None` if
    /// they would be useless.
    #[inline(always)]
    pub fn intersect_one<const APART: bool>(
        &self,
        i: usize,
        plane_normals: &[[f64; LEAF_SIZE]; 3],
        ray: &LeafRay,
        sums: &[f64; LEAF_SIZE],
    ) -> Option<Interval> {
        let mut distance = self.distance[i];
        if APART {
            distance += lanes::fused_dot::<f64, 1>(row(plane_normals, i), ray.start);
        }
        let (known, t) = self.intersect::<f64, 1>(distance, sums[i], ray.length, ray.error);
        if known != 0 { Some(t) } else { None }
    }

    /// Bounds of t = N·a/(N·d), N = (b − a) × (c − a), and the lanes in which they are valid, for
    /// certain hits.
    ///
    /// N is the negated sum of c × b, a × c and b × a, so t is a·(c × b) over the sum of the volumes.
    /// A ray that starts apart from the reference, by o, has a·(c × b) + N·o in place of a·(c × b).
    ///
    /// With m as above, for triangle and start as seen: a minor rounds by 4u·m², so the distance by
    /// 12u·m³ and, as a sum of products of 2m³, by 16u·m³ more: 28. A side is at most the scale s ≤
    /// m/2, up to rounding, so a coordinate of N is at most m²/2 and rounds by 2u·m²; N·o rounds by
    /// 11u·m³, and its sum with the former by 8u·m³: 47. A volume rounds by 15u·m² and 6u·m² per
    /// unit of |d|₁, and the sum of the three by 15u·m² more: 78. `Leaf::planes` has 64 and 128.
    ///
    /// Relative to the start, a vertex is off by at most δ = 4u·m + ε. The hit on the quantized triangle
    /// is a convex combination of its vertices, so it is at most δ·|N|₁ off the true plane, times |N|:
    /// that is δ·|N|₁/|N·d| in t, and an error ε_d of the direction adds |t|·|N|₁·ε_d/|N·d|.
    /// While the computed |N·d| is at least twice all its errors, the true one is at least half of it; with
    /// another factor of two, for second-order terms, that makes the four in `planes`.
    ///
    /// The product with 1/(N·d), in place of a quotient, and t ± off round by less than 5u·|t|. Nothing
    /// is added for that: the volumes need 4·78 of the 4·128 in `planes`, which leaves
    /// 200u·m²·|d|₁·|t|/|N·d|. The computed |N·d| ≤ (2s² + 78u·m²)·|d|₁ with s ≤ m/2, so
    /// that is above 300u·|t|.
    ///
    /// |N·d| is indeed at least twice its errors. The sides as seen are at most s, and 2s ≤ m, as m is the
    /// `reach` here. As the hit is certain, each volume exceeds its bound, and the sum of the three exceeds
    /// |d|₁·m·(192u·m + 36ε) + 36m²·ε_d; it is at most 2s²·|d|₁, up to rounding, so ε < s/36
    /// and u·m² < s²/57. It also exceeds 512u·m²·|d|₁, which is tested here. So it exceeds a tenth
    /// of this and nine tenths of that: |d|₁·m·(224u·m + 32ε) + 32m²·ε_d. The true N·d differs
    /// from it by 78u·m²·|d|₁; by ε_d·|N|₁, less than 2m²·ε_d; and as a side is off by 2δ, N by
    /// 8δ·s + 8δ² per coordinate, by less than 8.5δ·s·|d|₁. Twice all that is less than
    /// |d|₁·m·(190u·m + 9ε) + 4m²·ε_d.
    #[inline(always)]
    fn intersect<F: Floats<f64, N>, const N: usize>(
        &self,
        distance: F,
        sum: F,
        length: F,
        error: F,
    ) -> (u32, Interval<F>) {
        let least = F::splat(f64::MIN_POSITIVE);
        let inverse = F::splat(1.0).div(sum);
        let t = distance.mul(inverse);
        let turned = length.fused(F::splat(self.turned[0]), error.mul(F::splat(self.turned[1])));
        let moved = t.abs().fused(turned, F::splat(self.moved));
        let off = moved.fused(inverse.abs(), least);
        let known = turned.add(least).lt(sum.abs()) & off.lt(F::splat(f64::INFINITY));
        (known, Interval { low: t.sub(off), high: t.add(off) })
    }
}

impl<I: Isa> Edges<I> {
    /// The largest error of any coordinate of a vertex.
    fn off(&self) -> f64 {
        4.0 * UNIT * self.reach + self.error
    }

    /// The largest error of the volumes, for a direction of this length and error.
    #[inline(always)]
    fn bound_of(&self, length: f64, error: f64) -> f64 {
        I::fused(length, self.bound[0], I::fused(error, self.bound[1], f64::MIN_POSITIVE))
    }

    /// N = (b − a) × (c − a), by axis.
    #[inline(always)]
    pub fn plane_normals(&self) -> [[f64; LEAF_SIZE]; 3] {
        lanes::store(lanes::fused_cross(self.sides[1], self.sides[2]))
    }

    #[inline(always)]
    pub fn store(&self) -> StoredEdges {
        let ([u, v, w], [bc, ca, ab]) = (self.normals, self.sides);
        StoredEdges {
            normals: [lanes::store(u), lanes::store(v), lanes::store(w)],
            sides: [lanes::store(bc), lanes::store(ca), lanes::store(ab)],
            plane_normals: self.plane_normals(),
            bound: self.bound,
        }
    }
}

#[inline(always)]
fn fractions<I: Isa>(grid: &[u64; LEAF_SIZE]) -> [F64x8<I>; 3] {
    [I::fraction::<0>(grid), I::fraction::<GRID>(grid), I::fraction::<{ 2 * GRID }>(grid)]
}

/// U, V and W, and their sum.
#[inline(always)]
fn volumes<F: Floats<f64, 8>, const APART: bool>(
    direction: [F; 3],
    normals: [[F; 3]; 3],
    moment: [F; 3],
    sides: [[F; 3]; 3],
) -> ([F; 3], F) {
    let mut volumes = [F::splat(0.0); 3];
    for ((volume, normal), side) in volumes.iter_mut().zip(normals).zip(sides) {
        *volume = if APART {
            lanes::fused_sum(direction, normal, lanes::fused_dot(moment, side))
        } else {
            lanes::fused_dot(direction, normal)
        };
    }
    let [u, v, w] = volumes;
    (volumes, u.add(v).add(w))
}

/// The sides of the vertices as in `Leaf::beside`, N, and the bound of the errors.
#[inline(always)]
fn sides<I: Isa, const APART: bool>(
    edges: &Edges<I>,
    ray: &LeafRay,
) -> ([F64x8<I>; 3], [F64x8<I>; 3], F64x8<I>) {
    let normal: [F64x8<I>; 3] = lanes::fused_cross(edges.sides[1], edges.sides[2]);
    let across = lanes::fused_cross(lanes::splat(ray.direction), normal);
    let [a, b, c] = edges.vertices;
    let mut sides = [lanes::fused_dot(across, a), lanes::fused_dot(across, b), lanes::fused_dot(across, c)];
    if APART {
        let start = lanes::fused_dot(across, lanes::splat(ray.start));
        sides = [sides[0].sub(start), sides[1].sub(start), sides[2].sub(start)];
    }
    let size = normal[0].abs().max(normal[1].abs()).max(normal[2].abs());
    let bound = F64x8::<I>::splat(edges.bound_of(ray.length, ray.error) / edges.reach);
    (sides, normal, size.fused(bound, F64x8::<I>::splat(f64::MIN_POSITIVE)))
}

/// Three vectors of triangle i.
#[inline(always)]
fn three<I: Isa>([p, q, r]: &[[[f64; LEAF_SIZE]; 3]; 3], i: usize) -> [[F64x8<I>; 3]; 3] {
    [lanes::splat(row(p, i)), lanes::splat(row(q, i)), lanes::splat(row(r, i))]
}

/// Vector i.
#[inline(always)]
fn row([x, y, z]: &[[f64; LEAF_SIZE]; 3], i: usize) -> Point {
    [x[i], y[i], z[i]]
}

/// The lanes in which two volumes certainly have different signs, and those in which all three certainly have
/// the same sign.
#[inline(always)]
fn signs<F: Floats<f64, 8>>([u, v, w]: [F; 3], bound: F) -> (u32, u32) {
    let (least, most) = (Floats::min(Floats::min(u, v), w), Floats::max(Floats::max(u, v), w));
    let below = bound.negated();
    (least.lt(below) & bound.lt(most), bound.lt(least) | most.lt(below))
}

/// The least and the largest product of a vector with those of a box.
#[inline(always)]
fn range_of_dot<F: Floats<f64, 8>>(n: [F; 3], low: [F; 3], high: [F; 3]) -> (F, F) {
    let (x0, x1) = ends(n[0].mul(low[0]), n[0].mul(high[0]));
    let (y0, y1) = ends(n[1].mul(low[1]), n[1].mul(high[1]));
    let (z0, z1) = ends(n[2].mul(low[2]), n[2].mul(high[2]));
    (x0.add(y0).add(z0), x1.add(y1).add(z1))
}

/// The smaller and the larger number.
#[inline(always)]
fn ends<F: Floats<f64, 8>>(x: F, y: F) -> (F, F) {
    (Floats::min(x, y), Floats::max(x, y))
}

#[inline(always)]
fn moved<I: Isa>([x, y, z]: &[F64x8<I>; 3], scale: f64, shift: Point) -> [F64x8<I>; 3] {
    let scale = F64x8::<I>::splat(scale);
    [
        x.fused(scale, F64x8::<I>::splat(shift[0])),
        y.fused(scale, F64x8::<I>::splat(shift[1])),
        z.fused(scale, F64x8::<I>::splat(shift[2])),
    ]
}

/// The larger of two numbers that are not NaN: one instruction.
#[inline(always)]
fn larger(x: f64, y: f64) -> f64 {
    if x > y { x } else { y }
}

/// The smaller of two numbers that are not NaN.
#[inline(always)]
fn smaller(x: f64, y: f64) -> f64 {
    if x < y { x } else { y }
}

#[inline(always)]
fn power_of_two(exponent: i16) -> f64 {
    f64::from_bits(((i64::from(exponent) + 1023) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::arith::simd::{Level, Portable, Task, dispatch};
    use crate::geometry::point;
    use crate::geometry::ray::Ray;
    use crate::shapes::Surface;
    use crate::testing::{assert_slack, numbers, worst};

    /// Up to eight triangles over points in a box of side `size` at `place`; some are slivers and some have
    /// no area.
    fn mesh(place: f64, size: f64, count: usize, next: &mut impl FnMut() -> f64) -> Vec<Triangle> {
        let flat = if next() < 0.3 { 0.0 } else { 1.0 };
        let mut vertices: Vec<Point> =
            (0..9).map(|_| [1.0, 0.7, flat].map(|side| place + size * side * (next() - 0.5))).collect();
        // One ulp from the first.
        vertices.push([vertices[0][0].next_up(), vertices[0][1], vertices[0][2]]);
        let mut vertex = || vertices[(10.0 * next()) as usize];
        (0..count).map(|_| Triangle(vertex(), vertex(), vertex())).collect()
    }

    fn leaf(mesh: &[Triangle]) -> Leaf {
        // Ids need be neither sorted nor consecutive.
        let ids: Vec<u32> = (0..mesh.len() as u32).rev().collect();
        let leaf = Leaf::new(&ids, |id| mesh[id as usize]);
        assert_eq!(leaf.ids(), ids);
        leaf
    }

    /// Whether |x − y| ≤ bound.
    fn within(x: &Dyadic, y: &Dyadic, bound: f64) -> bool {
        let (off, bound) = (x.minus(y), Dyadic::exact(bound));
        off.minus(&bound).sign() != Ok(Ordering::Greater) && off.plus(&bound).sign() != Ok(Ordering::Less)
    }

    fn corners(mesh: &[Triangle], id: u32) -> [Point; 3] {
        let Triangle(a, b, c) = mesh[id as usize];
        [a, b, c]
    }

    /// Places and sizes of boxes.
    const BOXES: [(f64, f64); 15] = [
        (0.0, 1.0),
        (0.0, 1e-9),
        (0.0, 1e6),
        (3.0, 0.01),
        (5e6, 1e-3),
        (5e6, 100.0),
        (1e9, 1e-7),
        (-1e15, 30.0),
        (0.0, 0.0),
        (5e6, 0.0),
        (0.0, 1e-300),
        (0.0, 5e-324),
        (1e300, 0.0),
        (1e300, 1e290),
        (0.0, 1e36),
    ];

    #[test]
    fn the_grid_is_as_near_as_it_says() {
        let mut next = numbers();
        for (place, size) in BOXES {
            for count in 1..=LEAF_SIZE {
                let mesh = mesh(place, size, count, &mut next);
                let leaf = leaf(&mesh);
                let error = f64::from(leaf.error);
                assert!(error > 0.0);
                if error == f64::INFINITY {
                    assert!(size.max(place) > 1e44, "{place}, {size}");
                    continue;
                }
                // Half a step of the grid, plus the rounding of numbers at that place and of float32.
                let half = power_of_two(leaf.exponent) / 4_194_304.0;
                let rounded = place.abs() * (8.0 * UNIT) + f64::from(f32::MIN_POSITIVE);
                assert!(error <= 1.01 * half + rounded && half <= size + rounded, "{place}, {size}: {error}");
                let scale = Dyadic::exact(power_of_two(leaf.exponent));
                for (lane, &id) in leaf.ids().iter().enumerate() {
                    for (vertex, corner) in corners(&mesh, id).iter().enumerate() {
                        for axis in 0..3 {
                            let k = leaf.grid[vertex][lane] >> (21 * axis) & 0x1f_ffff;
                            let along = Dyadic::exact(1.0 + k as f64 / 2_097_152.0).times(&scale);
                            let seen = Dyadic::exact(leaf.anchor[axis]).plus(&along);
                            assert!(
                                within(&seen, &Dyadic::exact(corner[axis]), error),
                                "{place}, {size}: {corner:?}"
                            );
                        }
                    }
                }
            }
        }
    }

    /// The results of a leaf for a ray.
    struct Said {
        /// For this ray and its neighbour.
        reachable: u32,
        candidates: u32,
        sure: u32,
        /// For single rays.
        beside: u32,
        /// For certain hits.
        t: [Option<Interval>; LEAF_SIZE],
    }

    struct Probe<'a> {
        leaf: &'a Leaf,
        /// The reference; the rays start apart from it if it differs from their origin.
        reference: Point,
        origin: (Point, f64),
        directions: &'a [(Point, f64)],
    }

    impl Task for Probe<'_> {
        /// Vertices as seen from the origin and a bound of their error; and the results for the rays, first
        /// one by one, then eight at a time.
        type Output = ([[[f64; LEAF_SIZE]; 3]; 3], f64, Vec<Said>);

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            if self.reference == self.origin.0 { self.tell::<I, false>() } else { self.tell::<I, true>() }
        }
    }

    impl Probe<'_> {
        #[inline(always)]
        fn tell<I: Isa, const APART: bool>(self) -> <Self as Task>::Output {
            let (origin, origin_error) = self.origin;
            let start = point::sub(origin, self.reference);
            let spread = start.iter().fold(0.0_f64, |most, x| x.abs().max(most));
            let edges =
                self.leaf.edges(&self.leaf.grid_vertices::<I>(), self.reference, spread, origin_error);
            let planes = self.leaf.planes::<I>(&edges);
            let mut told = Vec::new();
            for pair in self.directions.chunks(2) {
                let reachable = self.leaf.reachable::<I, APART>(&edges, &around(start, pair));
                for &(direction, direction_error) in pair {
                    let ray = leaf_ray(start, direction, direction_error);
                    let mut sums = [0.0; LEAF_SIZE];
                    let (candidates, sure) = self.leaf.candidates::<I, APART>(&edges, &ray, &mut sums);
                    let mut t = [None; LEAF_SIZE];
                    for i in 0..LEAF_SIZE {
                        if sure & 1 << i != 0 {
                            t[i] = planes.intersect_one::<APART>(i, &edges.plane_normals(), &ray, &sums);
                        }
                    }
                    let beside = Leaf::beside::<I, APART>(&edges, &ray);
                    told.push(Said { reachable, candidates, sure, beside, t });
                }
            }
            let one_by_one = told.len();
            for (group, eight) in self.directions.chunks(8).enumerate() {
                let of = |k: usize| {
                    leaf_ray(start, eight[k.min(eight.len() - 1)].0, eight[k.min(eight.len() - 1)].1)
                };
                let column =
                    |value: &dyn Fn(LeafRay) -> f64| I::F64x8::load(&std::array::from_fn(|k| value(of(k))));
                let rays = LeafRays {
                    direction: [0, 1, 2].map(|axis| column(&|ray| ray.direction[axis])),
                    length: column(&|ray| ray.length),
                    error: column(&|ray| ray.error),
                    start: [0, 1, 2].map(|axis| column(&|ray| ray.start[axis])),
                    moment: [0, 1, 2].map(|axis| column(&|ray| ray.moment[axis])),
                };
                for k in 0..eight.len() {
                    let Said { reachable, .. } = told[8 * group + k];
                    told.push(Said { reachable, candidates: 0, sure: 0, beside: 0, t: [None; LEAF_SIZE] });
                }
                for i in 0..self.leaf.ids().len() {
                    let TriangleTest { candidates, known, t } =
                        Leaf::test::<I, APART>(i, &edges.store(), &planes, &rays);
                    let (low, high) = (t.low.store(), t.high.store());
                    for (k, said) in told[one_by_one + 8 * group..].iter_mut().enumerate() {
                        said.candidates |= (candidates >> k & 1) << i;
                        said.sure |= (known >> k & 1) << i;
                        if known >> k & 1 != 0 {
                            said.t[i] = Some(Interval { low: low[k], high: high[k] });
                        }
                    }
                }
            }
            let mut seen = [[[0.0; LEAF_SIZE]; 3]; 3];
            for vertex in 0..3 {
                for axis in 0..3 {
                    seen[vertex][axis] = edges.vertices[vertex][axis].store();
                }
            }
            (seen, edges.off(), told)
        }
    }

    fn leaf_ray(start: Point, direction: Point, error: f64) -> LeafRay {
        let length = direction.iter().map(|x| x.abs()).sum();
        LeafRay { direction, length, error, start, moment: cross(start, direction) }
    }

    fn around(start: Point, rays: &[(Point, f64)]) -> RayBounds {
        let of = |rays: &[Point], value: fn(f64, f64) -> f64| {
            [0, 1, 2].map(|axis| rays.iter().fold(rays[0][axis], |x, d| value(x, d[axis])))
        };
        let directions: Vec<Point> = rays.iter().map(|ray| ray.0).collect();
        let moments: Vec<Point> = directions.iter().map(|d| cross(start, *d)).collect();
        let (low, high) = (of(&directions, f64::min), of(&directions, f64::max));
        let (low_moment, high_moment) = (of(&moments, f64::min), of(&moments, f64::max));
        let length = (0..3).map(|i| low[i].abs().max(high[i].abs())).sum();
        let error = rays.iter().fold(0.0, |most, ray| ray.1.max(most));
        RayBounds { low, high, low_moment, high_moment, length, error }
    }

    /// A point of the triangle, often on an edge or at a corner.
    fn target(corners: [Point; 3], next: &mut impl FnMut() -> f64) -> Point {
        let mut weights = [0; 3].map(|_: u8| if next() < 0.25 { 0.0 } else { next() });
        if weights == [0.0; 3] {
            weights[(3.0 * next()) as usize] = 1.0;
        }
        let sum = weights[0] + weights[1] + weights[2];
        [0, 1, 2].map(|axis| (0..3).map(|k| weights[k] / sum * corners[k][axis]).sum())
    }

    #[test]
    fn what_a_leaf_is_certain_of_is_so() {
        let mut next = numbers();
        // Hits, certain ones among them, and those with bounds of t; misses, those ruled out, and those ruled
        // out for two rays at once.
        let (mut hit, mut sure, mut bounded, mut missed, mut out, mut beyond) = (0, 0, 0, 0, 0, 0);
        let mut beside = 0;
        for (place, size) in BOXES {
            for round in 0..12 {
                let mesh = mesh(place, size, [8, 5, 1][round % 3], &mut next);
                let leaf = leaf(&mesh);
                let distance = size.max(place.abs() * 1e-12) * [0.3, 3.0, 1e3, 1e6][round % 4];
                // The true ray lies within the errors of the given ray.
                let vague = if round % 2 == 0 { 0.0 } else { 1e-9 * size };
                let off = |next: &mut dyn FnMut() -> f64, by: f64| 0.9 * by * (2.0 * next() - 1.0);
                let origin: Point = [0; 3].map(|_: u8| place + distance * (next() - 0.5));
                let shown = origin.map(|x| x + off(&mut next, vague));
                let shown_error = (0..3).fold(0.0_f64, |e, i| e.max((shown[i] - origin[i]).abs().next_up()));
                let shown_error = if vague == 0.0 { 0.0 } else { shown_error };
                let mut directions = Vec::new();
                for _ in 0..40 {
                    let id = (mesh.len() as f64 * next()) as u32;
                    let to = target(corners(&mesh, id), &mut next);
                    let direction: Point = [0, 1, 2].map(|axis| {
                        let d = to[axis] - origin[axis];
                        if next() < 0.1 { d + size * (next() - 0.5) } else { d }
                    });
                    let by = if vague == 0.0 { 0.0 } else { 1e-9 * direction[0].abs() };
                    let seen = direction.map(|x| x + off(&mut next, by));
                    let error = (0..3).fold(0.0_f64, |e, i| e.max((seen[i] - direction[i]).abs().next_up()));
                    directions.push((direction, (seen, if by == 0.0 { 0.0 } else { error })));
                }
                let given: Vec<(Point, f64)> = directions.iter().map(|(_, given)| *given).collect();
                let exact = |id: u32, d: Point| match mesh[id as usize].roots(&Ray::<Dyadic>::new(origin, d))
                {
                    Ok([root, _]) => root,
                    Err(_) => unreachable!("exact arithmetic is never uncertain"),
                };
                let roots: Vec<Vec<_>> = directions
                    .iter()
                    .map(|(d, _)| leaf.ids().iter().map(|&id| exact(id, *d)).collect())
                    .collect();
                let apart = [1e-3, 1.0, 30.0][round % 3] * distance;
                let apart = shown.map(|x| x + apart * (next() - 0.5));
                let levels = Level::available();
                for (level, reference) in levels.flat_map(|level| [(level, shown), (level, apart)]) {
                    let probe =
                        Probe { leaf: &leaf, reference, origin: (shown, shown_error), directions: &given };
                    let (seen, seen_error, told) = dispatch(level, probe);
                    let from = if reference == shown { origin } else { reference };
                    for (lane, &id) in leaf.ids().iter().enumerate() {
                        for (vertex, corner) in corners(&mesh, id).iter().enumerate() {
                            for axis in 0..3 {
                                let x = Dyadic::exact(corner[axis]).minus(&Dyadic::exact(from[axis]));
                                let seen = Dyadic::exact(seen[vertex][axis][lane]);
                                assert!(
                                    seen_error == f64::INFINITY || within(&x, &seen, seen_error),
                                    "{place}, {size}"
                                );
                            }
                        }
                    }
                    for (told, roots) in told.iter().zip(roots.iter().cycle()) {
                        assert_eq!(
                            (told.candidates >> leaf.ids().len(), told.sure & !told.candidates),
                            (0, 0)
                        );
                        for (lane, root) in roots.iter().enumerate() {
                            let is = |mask: u32| mask >> lane & 1 != 0;
                            let Some(root) = root else {
                                assert!(!is(told.sure), "{level:?}: {place}, {size}");
                                missed += 1;
                                out += usize::from(!is(told.candidates));
                                beyond += usize::from(!is(told.reachable));
                                beside += usize::from(is(told.beside));
                                continue;
                            };
                            assert!(is(told.candidates) && is(told.reachable), "{level:?}: {place}, {size}");
                            assert!(!is(told.beside), "{level:?}: {place}, {size}");
                            hit += 1;
                            sure += usize::from(is(told.sure));
                            if let Some(t) = &told.t[lane] {
                                // t = b/a with a > 0.
                                let side = |t: f64| Dyadic::exact(t).times(&root.a).minus(&root.b).sign();
                                assert!(
                                    side(t.low) != Ok(Ordering::Greater),
                                    "{level:?}: {place}, {size}, {t:?}"
                                );
                                assert!(
                                    side(t.high) != Ok(Ordering::Less),
                                    "{level:?}: {place}, {size}, {t:?}"
                                );
                                bounded += 1;
                            }
                        }
                    }
                }
            }
        }
        assert!(hit > 16_000 && sure > 8_000 && bounded > 8_000, "{hit}, {sure}, {bounded}");
        assert!(missed > 100_000 && out > 40_000 && beyond > 10_000, "{missed}, {out}, {beyond}");
        assert!(beside > 10_000, "{beside}");
    }

    /// A triangle in a box of side 1, a ray towards a weighted mean of its vertices, and both as the leaf
    /// sees them.
    struct Shown {
        leaf: Leaf,
        /// The exact vertices relative to the true origin, and the true direction.
        vertices: [[Dyadic; 3]; 3],
        direction: [Dyadic; 3],
        edges: Edges<Portable>,
        ray: LeafRay,
    }

    /// Sources of error: the vertices are on the grid or anywhere, and the origin or the direction has an
    /// error. The origin is up to `distance` along each axis from the hit, and up to `apart` from the
    /// reference.
    #[derive(Clone, Copy)]
    struct From {
        on_grid: bool,
        distance: f64,
        apart: f64,
        origin_error: f64,
        direction_error: f64,
    }

    const EXACT: From =
        From { on_grid: true, distance: 3.0, apart: 0.0, origin_error: 0.0, direction_error: 0.0 };

    const FROM: [From; 8] = [
        From { distance: 1e4, ..EXACT },
        From { distance: 1e-6, ..EXACT },
        From { on_grid: false, ..EXACT },
        From { origin_error: 1e-5, ..EXACT },
        From { direction_error: 1e-5, ..EXACT },
        From { distance: 1e-3, apart: 1e3, ..EXACT },
        From { on_grid: false, apart: 1.0, ..EXACT },
        From { apart: 3.0, origin_error: 1e-5, direction_error: 1e-5, ..EXACT },
    ];

    impl Shown {
        fn new(x: &[f64; 21], from: From) -> Self {
            const STEPS: f64 = (1 << GRID) as f64;
            let place = |x: f64| {
                let x = x.abs().min(0.999);
                if from.on_grid { (x * STEPS).round() / STEPS } else { x }
            };
            let vertices: [Point; 3] = [0, 1, 2].map(|k| [0, 1, 2].map(|axis| place(x[3 * k + axis])));
            let weights = [0, 1, 2].map(|k: usize| x[12 + k].abs() + 1e-9);
            let sum: f64 = weights.iter().sum();
            let target: Point =
                [0, 1, 2].map(|axis| (0..3).map(|k| weights[k] / sum * vertices[k][axis]).sum());
            let origin: Point =
                [0, 1, 2].map(|axis| target[axis] + from.distance * (2.0 * x[9 + axis] - 1.0));
            let direction: Point = [0, 1, 2].map(|axis| target[axis] - origin[axis]);
            let off = |k: usize, by: f64| Dyadic::exact(by * (4.0 * x[15 + k] - 2.0).clamp(-1.0, 1.0));
            let true_origin = [0, 1, 2].map(|k| Dyadic::exact(origin[k]).plus(&off(k, from.origin_error)));
            let true_direction =
                [0, 1, 2].map(|k| Dyadic::exact(direction[k]).plus(&off(k, from.direction_error)));
            let [a, b, c] = vertices;
            let leaf = Leaf::new(&[0], |_| Triangle(a, b, c));
            let reference: Point =
                [0, 1, 2].map(|axis| origin[axis] + from.apart * (2.0 * x[18 + axis] - 1.0));
            let start = point::sub(origin, reference);
            let spread = start.iter().fold(0.0_f64, |most, x| x.abs().max(most));
            let edges = leaf.edges(&leaf.grid_vertices::<Portable>(), reference, spread, from.origin_error);
            Shown {
                vertices: vertices
                    .map(|v| crate::geometry::vector::sub(&crate::geometry::vector::exact(v), &true_origin)),
                direction: true_direction,
                edges,
                ray: leaf_ray(start, direction, from.direction_error),
                leaf,
            }
        }

        /// The largest error of a vertex as a share of its bound.
        fn places(&self) -> f64 {
            let off = |k: usize, axis: usize| {
                let seen = Dyadic::exact(self.edges.vertices[k][axis][0]);
                seen.minus(&Dyadic::exact(self.ray.start[axis]))
                    .minus(&self.vertices[k][axis])
                    .split()
                    .0
                    .abs()
                    / self.edges.off()
            };
            (0..9).fold(0.0, |largest, i| off(i / 3, i % 3).max(largest))
        }

        /// The largest error of a volume as a share of its bound.
        fn volumes(&self) -> f64 {
            let [a, b, c] = &self.vertices;
            let bound = self.ray.length * self.edges.bound[0] + self.ray.error * self.edges.bound[1];
            let mut largest: f64 = 0.0;
            let [direction, moment] = [lanes::splat(self.ray.direction), lanes::splat(self.ray.moment)];
            let (seen, _) =
                volumes::<[f64; 8], true>(direction, self.edges.normals, moment, self.edges.sides);
            for ((p, q), seen) in [(c, b), (a, c), (b, a)].into_iter().zip(seen) {
                let truth =
                    crate::geometry::vector::dot(&self.direction, &crate::geometry::vector::cross(p, q));
                largest = largest.max(truth.minus(&Dyadic::exact(seen[0])).split().0.abs() / bound);
            }
            largest
        }

        /// The largest error of the side of a vertex as a share of its bound.
        fn sides(&self) -> f64 {
            let (sides, normal, bound) = sides::<Portable, true>(&self.edges, &self.ray);
            let normal = [0, 1, 2].map(|axis| Dyadic::exact(normal[axis][0]));
            let across = crate::geometry::vector::cross(&self.direction, &normal);
            let off = |k: usize| {
                let truth = crate::geometry::vector::dot(&across, &self.vertices[k]);
                truth.minus(&Dyadic::exact(sides[k][0])).split().0.abs() / bound[0]
            };
            off(0).max(off(1)).max(off(2))
        }

        /// The error of t as a share of its bound, if there is one.
        fn t(&self) -> f64 {
            let mut sums = [0.0; LEAF_SIZE];
            let (_, sure) = self.leaf.candidates::<Portable, true>(&self.edges, &self.ray, &mut sums);
            let planes = self.leaf.planes::<Portable>(&self.edges);
            if sure & 1 == 0 {
                return 0.0;
            }
            let Some(t) = planes.intersect_one::<true>(0, &self.edges.plane_normals(), &self.ray, &sums)
            else {
                return 0.0;
            };
            let [a, b, c] = &self.vertices;
            let normal = crate::shapes::triangle::normal_through(a, b, c);
            let (num, den) = (
                crate::geometry::vector::dot(&normal, a),
                crate::geometry::vector::dot(&normal, &self.direction),
            );
            let middle = Dyadic::exact(t.low).plus(&Dyadic::exact(t.high)).times(&Dyadic::exact(0.5));
            let off = middle.times(&den).minus(&num).split().0 / den.split().0;
            off.abs() / (0.5 * (t.high - t.low))
        }
    }

    /// Each source of error alone. The slack comes from `reach`, which exceeds vertices and edges by a factor
    /// of two or more, and from assuming the worst signs of all terms of a determinant, which cannot
    /// coincide; one bound serves rays that start at the reference or apart from it. In t, roundings of the
    /// volumes dominate for far origins, and those of the distance for origins almost on the triangle.
    #[test]
    fn errors_of_a_leaf_are_the_share_of_their_bounds_that_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        let found = FROM.map(|from| {
            let volume = worst(8, 1500, draw, |x| Shown::new(x, from).volumes()).0;
            let t = worst(8, 1500, draw, |x| Shown::new(x, from).t()).0;
            (volume, t, worst(8, 1500, draw, |x| Shown::new(x, from).sides()).0)
        });
        for ((volume, t, side), known) in found.into_iter().zip([
            (0.0196, 0.00264, 0.032),
            (0.00176, 0.000229, 0.011),
            (0.0649, 0.243, 0.162),
            (0.0524, 0.25, 0.165),
            (0.0974, 0.25, 0.307),
            (0.00473, 0.0014, 0.035),
            (0.0419, 0.243, 0.159),
            (0.0574, 0.25, 0.192),
        ]) {
            assert_slack("volume", volume, known.0);
            assert_slack("t", t, known.1);
            assert_slack("side", side, known.2);
        }
    }

    /// On the grid and from afar, a vertex is off by two of the three counted roundings: of the anchor less
    /// the origin, and of the sum with it.
    #[test]
    fn vertices_are_off_by_the_share_of_their_bound_that_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        // So far that the grid is finer than the last place there.
        let from = From { distance: 3e10, ..FROM[0] };
        assert_slack("vertex", worst(8, 3000, draw, |x| Shown::new(x, from).places()).0, 0.45);
    }

    /// |N|₁ just above a power of two, which sides rounded down would move just below it.
    #[test]
    fn normals_are_no_longer_than_a_leaf_says() {
        let (x, y) = (1.0 - UNIT, 0.5);
        let (s, t) = (0.49 * UNIT, 0.49 * UNIT);
        let mut meshes = vec![vec![Triangle([-t, -s, 0.0], [x, -s, 0.0], [-t, y, 0.0])]];
        let mut next = numbers();
        meshes.extend((0..500).map(|k| mesh([0.0, 5e6][k % 2], 1.0, 1, &mut next)));
        for mesh in meshes {
            let leaf = leaf(&mesh);
            let [a, b, c] = corners(&mesh, 0).map(crate::geometry::vector::exact::<Dyadic>);
            let sum = crate::shapes::triangle::normal_through(&a, &b, &c)
                .map(|x| if x.sign() == Ok(Ordering::Less) { x.negated() } else { x })
                .iter()
                .fold(Dyadic::exact(0.0), |sum, x| sum.plus(x));
            let unit = Dyadic::exact(power_of_two(leaf.exponent)).squared();
            let most = unit.times(&Dyadic::exact(power_of_two(3 - i16::from(leaf.thinness))));
            assert!(sum.minus(&most).sign() != Ok(Ordering::Greater), "{mesh:?}");
        }
    }

    #[test]
    fn a_huge_box_leaves_all_to_exact_arithmetic() {
        let mut next = numbers();
        for (place, size) in [(0.0, 1e308), (0.0, f64::MAX), (1e308, 1e308), (0.0, 1e46), (1e300, 1e290)] {
            for count in 1..=LEAF_SIZE {
                let mesh = mesh(place, size, count, &mut next);
                let leaf = leaf(&mesh);
                let directions: Vec<(Point, f64)> = (0..20)
                    .map(|k| {
                        ([0; 3].map(|_: u8| (next() - 0.5) * [1e-29, 1.0, 1e29][k % 3]), [0.0, 1e-9][k % 2])
                    })
                    .collect();
                let origins = [[0.0; 3], [1e29, -1e29, 3.0]];
                for (origin, reference) in origins.into_iter().flat_map(|o| [(o, o), (o, [1.0; 3])]) {
                    for level in Level::available() {
                        let probe =
                            Probe { leaf: &leaf, reference, origin: (origin, 0.0), directions: &directions };
                        for told in dispatch(level, probe).2 {
                            assert_eq!(
                                (told.candidates, told.sure),
                                ((1 << count) - 1, 0),
                                "{level:?}: {place}, {size}"
                            );
                        }
                    }
                }
            }
        }
    }
}
