//! Affine maps, object to world, whose inverse is never rounded.

mod expanded;
mod rounded;

use std::cmp::Ordering;
use std::sync::Arc;

use crate::arith::number::{
    self, DoubleDouble, Dyadic, Interval, Kinds, Lanes, Number, OfRays, Predicate, RunningError, Uncertain,
};
use crate::arith::simd::{Floats, Isa, LaneTask, lanes};
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::pose::Pose;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};
use crate::once::Once;

pub use expanded::ExpandedInverse;
pub use rounded::RoundedInverse;

/// x ↦ linear·x + offset, with rows `linear[i]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    linear: [[f64; 3]; 3],
    offset: Point,
}

impl Affine {
    /// Takes the upper rows of a 4×4 homogeneous matrix.
    pub fn from_rows(m: [[f64; 4]; 3]) -> Self {
        Affine { linear: m.map(|r| [r[0], r[1], r[2]]), offset: [m[0][3], m[1][3], m[2][3]] }
    }

    pub fn new(linear: [[f64; 3]; 3], offset: Point) -> Self {
        Affine { linear, offset }
    }

    /// The columns of the homogeneous matrix; the last is the offset.
    pub fn columns(&self) -> [Point; 4] {
        let [x, y, z] = self.linear;
        [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]], self.offset]
    }

    pub fn is_identity(&self) -> bool {
        *self == Affine::new([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0; 3])
    }

    /// A box around the offset. `reach` returns how far it reaches down and up along an axis, from the row of
    /// that axis.
    pub fn around(&self, reach: impl Fn([f64; 3]) -> [f64; 2]) -> [Interval; 3] {
        std::array::from_fn(|i| {
            let [below, above] = reach(self.linear[i]);
            Interval { low: (self.offset[i] - below).next_down(), high: (self.offset[i] + above).next_up() }
        })
    }

    /// The image of a plane perpendicular to an axis, if it is known to be such a plane.
    pub fn image_of_plane(&self, plane: AxisPlane) -> Option<AxisPlane> {
        // The one coordinate that depends on that of the plane alone.
        let axis = self.linear.iter().position(|row| (0..3).all(|j| (row[j] != 0.0) == (j == plane.axis)))?;
        plane.image(axis, self.linear[axis][plane.axis], self.offset[axis])
    }
}

impl From<Pose> for Affine {
    #[inline(always)]
    fn from(pose: Pose) -> Self {
        Affine::from_rows(pose.rows())
    }
}

/// The inverse of a sequence of affine maps, in each kind of [`Number`].
#[derive(Debug)]
pub struct Inverse {
    running_error: Adjugate<RunningError>,
    double_double: Adjugate<DoubleDouble>,
    /// Made on first use; most objects never need it.
    dyadic: Once<Adjugate<Dyadic>>,
    /// Made when a mesh is first entered; `None` if its bounds are uncertain.
    rounded: Once<Option<RoundedInverse>>,
    /// Made when a triangle is first hit.
    expanded: Once<Option<ExpandedInverse>>,
    last: Affine,
    reflects: bool,
    before: Option<Arc<Inverse>>,
}

impl Inverse {
    /// The inverse of a map and of those before it. `None` if the determinant is zero, exactly.
    pub fn of(map: &Affine, before: Option<Arc<Inverse>>) -> Option<Self> {
        let reflects = number::decide(&Determinant(map))? == Ordering::Less;
        Some(Inverse {
            running_error: Adjugate::of(map, reflects, before.as_ref().map(|before| &before.running_error)),
            double_double: Adjugate::of(map, reflects, before.as_ref().map(|before| &before.double_double)),
            dyadic: Once::new(),
            rounded: Once::new(),
            expanded: Once::new(),
            last: *map,
            reflects,
            before,
        })
    }

    /// In float64; `None` if the bounds of its error are uncertain.
    pub fn rounded(&self) -> Option<&RoundedInverse> {
        self.rounded.get_or_make(|| RoundedInverse::of(&self.double_double, &self.running_error)).as_ref()
    }

    /// As expansions; `None` if numbers are so large or small that products of several may overflow or
    /// underflow.
    pub fn expanded(&self) -> Option<&ExpandedInverse> {
        let map = if self.before.is_none() { Some(self.last) } else { None };
        self.expanded.get_or_make(|| ExpandedInverse::of(&self.double_double, map)).as_ref()
    }
}

/// The sign of the determinant of a map.
struct Determinant<'a>(&'a Affine);

impl Predicate for Determinant<'_> {
    type Answer = Option<Ordering>;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Self::Answer, Uncertain> {
        let sign = Cofactors::<N>::new(&self.0.linear.map(vector::exact)).determinant.sign()?;
        Ok(if sign == Ordering::Equal { None } else { Some(sign) })
    }
}

impl Kinds for Inverse {
    type In<N: Clone> = Adjugate<N>;

    #[inline(always)]
    fn running_error(&self) -> &Adjugate<RunningError> {
        &self.running_error
    }

    #[inline(always)]
    fn double_double(&self) -> &Adjugate<DoubleDouble> {
        &self.double_double
    }

    #[inline(always)]
    fn dyadic(&self) -> &Adjugate<Dyadic> {
        self.dyadic.get_or_make(|| {
            Adjugate::of(&self.last, self.reflects, self.before.as_ref().map(|before| before.dyadic()))
        })
    }

    #[inline(always)]
    fn convert<N: Clone, M: Clone + for<'a> From<&'a N>>(kept: &Adjugate<N>) -> Adjugate<M> {
        let [r0, r1, r2] = &kept.linear.rows;
        let rest = match &kept.rest {
            None => None,
            Some(rest) => Some(convert(rest)),
        };
        let determinant = M::from(&kept.linear.determinant);
        Adjugate {
            linear: Cofactors { rows: [convert(r0), convert(r1), convert(r2)], determinant },
            offset: kept.offset,
            rest,
        }
    }
}

#[inline(always)]
fn convert<N, M: for<'a> From<&'a N>>(v: &Vector<N>) -> Vector<M> {
    [M::from(&v[0]), M::from(&v[1]), M::from(&v[2])]
}

/// How a surface is placed in the world.
pub trait Placement: Copy {
    /// A world ray in the coordinates of the surface.
    fn local<N: Number>(self, ray: Ray<N>) -> Ray<N>;
    /// A normal of the surface in world coordinates, of any length.
    fn normal<N: Number>(self, normal: Vector<N>) -> Vector<N>;
}

/// The identity map.
#[derive(Clone, Copy)]
pub struct Identity;

impl Placement for Identity {
    #[inline(always)]
    fn local<N: Number>(self, ray: Ray<N>) -> Ray<N> {
        ray
    }

    #[inline(always)]
    fn normal<N: Number>(self, normal: Vector<N>) -> Vector<N> {
        normal
    }
}

impl Placement for &Inverse {
    #[inline(always)]
    fn local<N: Number>(self, ray: Ray<N>) -> Ray<N> {
        N::of_kinds(self).apply(&ray)
    }

    #[inline(always)]
    fn normal<N: Number>(self, normal: Vector<N>) -> Vector<N> {
        N::of_kinds(self).normal(&normal)
    }
}

impl<P: Placement> Placement for Option<P> {
    #[inline(always)]
    fn local<N: Number>(self, ray: Ray<N>) -> Ray<N> {
        match self {
            None => ray,
            Some(placement) => placement.local(ray),
        }
    }

    #[inline(always)]
    fn normal<N: Number>(self, normal: Vector<N>) -> Vector<N> {
        match self {
            None => normal,
            Some(placement) => placement.normal(normal),
        }
    }
}

/// The placement of the rays of a packet: one for all, or one for each.
pub trait RayPlacement: Copy {
    /// The placement of part `i` of the packet, a register of rays.
    #[inline(always)]
    fn part(self, _: usize) -> Self {
        self
    }

    /// As `Placement::local`.
    fn local_rays<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, ray: Ray<K>, lanes: L) -> Ray<K>;
    /// As `Placement::normal`.
    fn normals<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, normal: Vector<K>, lanes: L) -> Vector<K>;
}

impl<P: Placement> RayPlacement for P {
    #[inline(always)]
    fn local_rays<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, ray: Ray<K>, _: L) -> Ray<K> {
        self.local(ray)
    }

    #[inline(always)]
    fn normals<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, normal: Vector<K>, _: L) -> Vector<K> {
        self.normal(normal)
    }
}

/// Placement by `first`, and then by a map that preserves orientation and is inverted for each ray. Either
/// may be absent.
#[derive(Clone, Copy)]
pub struct ComposedPlacement<'a> {
    pub first: Option<&'a Inverse>,
    pub then: Option<&'a Affine>,
}

impl Placement for ComposedPlacement<'_> {
    #[inline(always)]
    fn local<N: Number>(self, ray: Ray<N>) -> Ray<N> {
        self.first.local(match self.then {
            None => ray,
            Some(then) => then.inverse_of_ray(&ray),
        })
    }

    #[inline(always)]
    fn normal<N: Number>(self, normal: Vector<N>) -> Vector<N> {
        let normal = self.first.normal(normal);
        match self.then {
            None => normal,
            Some(then) => then.image_of_normal(&normal),
        }
    }
}

/// Out of line; inlined, they would be compiled into each formula for each kind of number.
impl Affine {
    #[inline(never)]
    fn inverse_of_ray<N: Number>(&self, ray: &Ray<N>) -> Ray<N> {
        let from = ray.origin_from(vector::exact(self.offset));
        Cofactors::new(&self.linear.map(vector::exact)).apply(from, ray)
    }

    #[inline(never)]
    fn image_of_normal<N: Number>(&self, normal: &Vector<N>) -> Vector<N> {
        Cofactors::new(&self.linear.map(vector::exact)).normal(normal)
    }
}

/// As [`ComposedPlacement`], with one map for each of M rays after the placement that all share.
#[derive(Clone, Copy)]
struct ComposedPlacements<'a, P, const M: usize> {
    first: P,
    then: &'a Affines<M>,
    part: usize,
}

/// How an object places rays, M at a time.
#[derive(Clone, Copy)]
pub struct Placements<'a, const M: usize> {
    /// The inverse of the maps that all rays share; `None` if there are none.
    pub first: Option<&'a Inverse>,
    /// For a moving object, the maps that follow, one per ray.
    pub then: Option<&'a Affines<M>>,
}

/// A function that is generic over the type of a placement and over registers of N lanes: an always inlined
/// `run`.
pub trait PlacementTask {
    type Output;
    fn run<F: Floats<f64, N>, P: RayPlacement, const N: usize>(self, placement: P) -> Self::Output;
}

struct With<P, T>(P, T);

impl<P: RayPlacement, T: PlacementTask> LaneTask for With<P, T> {
    type Output = T::Output;

    #[inline(always)]
    fn run<F: Floats<f64, N>, const N: usize>(self) -> T::Output {
        self.1.run::<F, P, N>(self.0)
    }
}

impl<const M: usize> Placements<'_, M> {
    pub fn is_identity(self) -> bool {
        self.first.is_none() && self.then.is_none()
    }

    /// Runs the task in a separate function for each type of placement; see `Isa::call_widest`.
    #[inline(always)]
    pub fn dispatch<I: Isa, T: PlacementTask>(self, task: T) -> Option<T::Output> {
        match (self.first, self.then) {
            (None, None) => I::call_widest(With(Identity, task)),
            (Some(placement), None) => I::call_widest(With(placement, task)),
            (None, Some(then)) => {
                I::call_widest(With(ComposedPlacements { first: Identity, then, part: 0 }, task))
            }
            (Some(first), Some(then)) => {
                I::call_widest(With(ComposedPlacements { first, then, part: 0 }, task))
            }
        }
    }
}

/// M affine maps: by column of the homogeneous matrix, and by coordinate.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Affines<const M: usize>([[[f64; M]; 3]; 4]);

impl<const M: usize> Affines<M> {
    pub const UNSET: Self = Affines([[[0.0; M]; 3]; 4]);

    /// Sets the maps from 8·part on.
    #[inline(always)]
    pub fn set(&mut self, part: usize, poses: &Pose<[f64; 8]>) {
        for (kept, column) in self.0.iter_mut().zip(poses.columns()) {
            for (kept, eight) in kept.iter_mut().zip(column) {
                kept[8 * part..][..8].copy_from_slice(&eight);
            }
        }
    }
}

impl<P: Placement, const M: usize> ComposedPlacements<'_, P, M> {
    #[inline(always)]
    fn column<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, j: usize, lanes: L) -> Vector<K> {
        vector::of_rays(lanes::part(&self.then.0[j], self.part), lanes)
    }

    #[inline(always)]
    fn cofactors<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, lanes: L) -> Cofactors<K> {
        let ([a, b, c], [d, e, f], [g, h, i]) =
            (self.column(0, lanes), self.column(1, lanes), self.column(2, lanes));
        Cofactors::new(&[[a, d, g], [b, e, h], [c, f, i]])
    }
}

impl<P: Placement, const M: usize> RayPlacement for ComposedPlacements<'_, P, M> {
    #[inline(always)]
    fn part(self, part: usize) -> Self {
        ComposedPlacements { part, ..self }
    }

    #[inline(always)]
    fn local_rays<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, ray: Ray<K>, lanes: L) -> Ray<K> {
        let from = ray.origin_from(self.column(3, lanes));
        self.first.local(self.cofactors(lanes).apply(from, &ray))
    }

    #[inline(always)]
    fn normals<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, normal: Vector<K>, lanes: L) -> Vector<K> {
        self.cofactors(lanes).normal(&self.first.normal(normal))
    }
}

/// The inverse of a linear map before its division: linear⁻¹ = rows/determinant, with the rows of the
/// adjugate.
#[derive(Clone, Debug)]
struct Cofactors<N> {
    rows: [Vector<N>; 3],
    determinant: N,
}

impl<N: Number> Cofactors<N> {
    /// Takes the rows of the map.
    #[inline(always)]
    fn new([r0, r1, r2]: &[Vector<N>; 3]) -> Self {
        // The columns of the adjugate are the cross products of the rows.
        let [c0, c1, c2] = [vector::cross(r1, r2), vector::cross(r2, r0), vector::cross(r0, r1)];
        let determinant = vector::dot(r0, &c0);
        // Closures would not be compiled for the instruction set.
        let ([a, b, c], [d, e, f], [g, h, i]) = (c0, c1, c2);
        Cofactors { rows: [[a, d, g], [b, e, h], [c, f, i]], determinant }
    }

    /// The ray in the coordinates before the map, for a positive determinant; `from` is its origin less the
    /// offset of the map, times the weight.
    #[inline(always)]
    fn apply(&self, from: Vector<N>, ray: &Ray<N>) -> Ray<N> {
        let weight = ray.weighted(self.determinant.clone());
        Ray { origin: self.times(&from), direction: self.times(&ray.direction), weight: Some(weight) }
    }

    #[inline(always)]
    fn times(&self, v: &Vector<N>) -> Vector<N> {
        [vector::dot(&self.rows[0], v), vector::dot(&self.rows[1], v), vector::dot(&self.rows[2], v)]
    }

    /// A normal after the map, times a positive number: linear⁻ᵀ·normal.
    #[inline(always)]
    fn normal(&self, n: &Vector<N>) -> Vector<N> {
        let [r0, r1, r2] = &self.rows;
        let sum = vector::add(&vector::scaled(r0, &n[0]), &vector::scaled(r1, &n[1]));
        vector::add(&sum, &vector::scaled(r2, &n[2]))
    }
}

/// |determinant| times the inverse of an affine map: a negative determinant flips the signs of the cofactors,
/// so that outward normals stay outward through a reflection.
#[derive(Clone, Debug)]
pub struct Adjugate<N> {
    linear: Cofactors<N>,
    /// In float64, so that the difference from a nearby origin keeps all its digits.
    offset: Point,
    /// The true offset less `offset`; `None` if they are equal.
    rest: Option<Vector<N>>,
}

impl<N: Number<Floats = f64>> Adjugate<N> {
    /// The adjugate of a map whose determinant is negative if `reflects`, and of the maps before it.
    fn of(map: &Affine, reflects: bool, before: Option<&Self>) -> Self {
        let Cofactors { rows, determinant } = Cofactors::<N>::new(&map.linear.map(vector::exact));
        let (rows, determinant) = if reflects {
            (rows.each_ref().map(vector::negated), determinant.negated())
        } else {
            (rows, determinant)
        };
        let own = Adjugate { linear: Cofactors { rows, determinant }, offset: map.offset, rest: None };
        match before {
            None => own,
            Some(before) => own.after(before, map),
        }
    }

    /// x = L₂·(L₁·y + t₁) + t₂, so
    /// adj(L₁)·adj(L₂)·(x − (L₂·t₁ + t₂)) = det L₁·det L₂·y.
    fn after(&self, first: &Self, second: &Affine) -> Self {
        let [r0, r1, r2] = &self.linear.rows;
        let columns: [Vector<N>; 3] = std::array::from_fn(|j| [r0[j].clone(), r1[j].clone(), r2[j].clone()]);
        let (offset, rest) = if first.rest.is_none() && first.offset == [0.0; 3] {
            (self.offset, self.rest.clone())
        } else {
            let (from, to) = (first.whole_offset(), self.whole_offset());
            let parts =
                [0, 1, 2].map(|i| vector::dot(&vector::exact(second.linear[i]), &from).plus(&to[i]).split());
            (parts.each_ref().map(|(near, _)| *near), Some(parts.map(|(_, rest)| rest)))
        };
        let product = |row: &Vector<N>| columns.each_ref().map(|column| vector::dot(row, column));
        let linear = Cofactors {
            rows: first.linear.rows.each_ref().map(product),
            determinant: self.linear.determinant.times(&first.linear.determinant),
        };
        Adjugate { linear, offset, rest }
    }

    fn whole_offset(&self) -> Vector<N> {
        let near = vector::exact(self.offset);
        match &self.rest {
            None => near,
            Some(rest) => vector::add(&near, rest),
        }
    }
}

impl<N: Number> Adjugate<N> {
    /// A world ray in the coordinates of the object.
    #[inline(always)]
    pub fn apply(&self, ray: &Ray<N>) -> Ray<N> {
        let mut from = ray.origin_from(vector::exact(self.offset));
        if let Some([x, y, z]) = self.rest.clone() {
            from = vector::sub(&from, &[ray.weighted(x), ray.weighted(y), ray.weighted(z)]);
        }
        self.linear.apply(from, ray)
    }

    /// A normal of the object in world coordinates, times a positive number.
    #[inline(always)]
    pub fn normal(&self, n: &Vector<N>) -> Vector<N> {
        self.linear.normal(n)
    }
}
