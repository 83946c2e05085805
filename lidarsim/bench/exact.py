"""The exact first hit of each ray in rational numbers: the reference for the errors of ray casters.

Every float64 is a rational number. The solids of these worlds are intersections of slabs, 0 ≤ n·(x − p) ≤ h, and of
balls under affine maps, |A·(x − p)|² ≤ s. Along a ray each of these holds on an interval of t, whose ends are rational
or solve a quadratic equation with rational coefficients; the ray meets the surface at the ends of the intersection of
these intervals. So hits and misses are decided exactly. Square roots, and with them t, are rounded to 255 bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from lidarsim.bench.scenes import Floats, Integers, Rays, Spec, World

Vector: TypeAlias = tuple[Fraction, Fraction, Fraction]
Interval: TypeAlias = tuple[Fraction | float, Fraction | float]

ROUND = {"Sphere", "Cylinder", "Ellipsoid"}
GROUP = 256  # triangles that share a bounding box in the search for candidates
ROOT_BITS = 256  # precision of a square root
NOWHERE: Interval = (math.inf, -math.inf)
EVERYWHERE: Interval = (-math.inf, math.inf)


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact first hit of each ray.

    Attributes
    ----------
    t : list of Fraction or None
        Ray parameter of the hit, None for a miss.
    surface : ndarray of int64, shape (n,)
        Index of the triangle (for a mesh) or object that is hit, -1 for a miss.
    telling : ndarray of bool, shape (n,)
        Hits whose range distinguishes ray casters: all on meshes, else only those on round shapes.
    """

    t: list[Fraction | None]
    surface: Integers
    telling: npt.NDArray[np.bool_]


def first_hits(world: World, rays: Rays) -> Truth:
    """Return the exact first hits, among the objects or triangles that float64 bounds do not exclude."""
    find = _first_object if world.mesh is None else _first_triangle
    found = [find(world, o, d) for o, d in zip(rays.origins, rays.directions, strict=True)]
    surface = np.array([surface for _, surface in found], dtype=np.int64)
    telling = surface >= 0
    if world.mesh is None:
        telling &= np.array([spec.kind in ROUND for spec in world.shapes])[surface]
    return Truth([t for t, _ in found], surface, telling)


def ulps(exact: Fraction, value: float) -> float:
    """Return |value − exact| in units in the last place of the float64 nearest to `exact`."""
    return float(abs(Fraction(value) - exact) / Fraction(math.ulp(float(exact))))


def _first_object(world: World, origin: Floats, direction: Floats) -> tuple[Fraction | None, int]:
    _, low, high = _parts(world)
    o, d = _vector(origin), _vector(direction)
    candidates = np.flatnonzero(_may_meet(low, high, origin, direction)).tolist()
    return _nearest((solid_hit(world.shapes[index], o, d), index) for index in candidates)


def _first_triangle(world: World, origin: Floats, direction: Floats) -> tuple[Fraction | None, int]:
    assert world.mesh is not None  # noqa: S101 - checked by the only caller
    vertices, faces = world.mesh
    groups, low, high = _parts(world)
    near = np.flatnonzero(_may_meet(low, high, origin, direction))
    candidates = np.sort(np.concatenate([groups[part] for part in near])) if len(near) else np.zeros(0, dtype=np.int64)
    corners = vertices[faces[candidates]]
    kept = _may_pierce(corners - origin, direction)
    o, d = _vector(origin), _vector(direction)
    triangles = zip(candidates[kept].tolist(), corners[kept], strict=True)
    return _nearest((_triangle_hit(triangle, o, d), index) for index, triangle in triangles)


def _nearest(hits: Iterable[tuple[Fraction | None, int]]) -> tuple[Fraction | None, int]:
    """Return the least t and its index; of equal t, the least index."""
    return min(((t, index) for t, index in hits if t is not None), default=(None, -1))


def solid_hit(spec: Spec, origin: Vector, direction: Vector) -> Fraction | None:
    """Return the least t ≥ 0 at which a ray meets the surface of a plane or solid, or None.

    The plane through a point, sphere, ellipsoid, box or capped cylinder has no transform. The t is exact, except for
    square roots, which have 255 bits.
    """
    entry, leave = EVERYWHERE
    for low, high in _intervals(spec, origin, direction):
        entry, leave = max(entry, low), min(leave, high)
    if entry > leave:
        return None
    return next((t for t in (entry, leave) if isinstance(t, Fraction) and t >= 0), None)


def _intervals(spec: Spec, origin: Vector, d: Vector) -> list[Interval]:
    """Return intervals of t; the line is inside the solid on their intersection."""
    match spec.kind, spec.args:
        case "Plane.from_point", (point, normal):
            n = _vector(normal)
            slope = _dot(n, d)
            return [_slab(_dot(n, _minus(origin, _vector(point))), slope, Fraction(0)) if slope else NOWHERE]
        case "Sphere", (center, radius):
            return [_ball(_minus(origin, _vector(center)), d, Fraction(radius) ** 2)]
        case "Ellipsoid", (center, radii, rotation):
            columns = [_times(_vector(axis), Fraction(r)) for axis, r in zip(rotation.T, radii.tolist(), strict=True)]
            f = _minus(origin, _vector(center))
            return [_ball(_solve(columns, f), _solve(columns, d), Fraction(1))]
        case "Box", (size, center):
            f, sides = _minus(origin, _vector(center)), _vector(size)
            return [_slab(x + side / 2, rate, side) for x, rate, side in zip(f, d, sides, strict=True)]
        case "Cylinder", (start, end, radius):
            axis, f = _minus(_vector(end), _vector(start)), _minus(origin, _vector(start))
            square = _dot(axis, axis)
            side = _ball(_cross(axis, f), _cross(axis, d), Fraction(radius) ** 2 * square)
            return [side, _slab(_dot(axis, f), _dot(axis, d), square)]
    raise ValueError(f"spec: expected a shape of the analytic scene, got {spec.kind}")


def _slab(at: Fraction, rate: Fraction, width: Fraction) -> Interval:
    """Return the interval of t on which 0 ≤ at + rate·t ≤ width."""
    if rate == 0:
        return EVERYWHERE if 0 <= at <= width else NOWHERE
    ends = -at / rate, (width - at) / rate
    return min(ends), max(ends)


def _ball(f: Vector, g: Vector, square: Fraction) -> Interval:
    """Return the interval of t on which |f + t·g|² ≤ square.

    The two roots of a·t² + 2·b·t + c are q/a and c/q for q = −b ∓ √(b² − a·c), with − for b > 0, so that nothing
    cancels and t is as precise as the square root.
    """
    a, b, c = _dot(g, g), _dot(f, g), _dot(f, f) - square
    if a == 0:
        return EVERYWHERE if c <= 0 else NOWHERE
    discriminant = b * b - a * c
    if discriminant < 0:
        return NOWHERE
    q = -b - _root(discriminant) if b > 0 else -b + _root(discriminant)
    ends = (q / a, c / q) if q else (q, q)
    return min(ends), max(ends)


def _root(square: Fraction) -> Fraction:
    """Return the square root, rounded down to `ROOT_BITS` bits; exact if it is rational."""
    product = square.numerator * square.denominator  # √(n/d) = √(n·d)/d
    shift = max(0, ROOT_BITS - product.bit_length() // 2)
    return Fraction(math.isqrt(product << 2 * shift), square.denominator << shift)


def _triangle_hit(corners: Floats, origin: Vector, d: Vector) -> Fraction | None:
    """Return the t ≥ 0 at which a ray hits a closed triangle; None if it misses it or lies in its plane."""
    a, b, c = (_minus(_vector(corner), origin) for corner in corners)
    n = _cross(_minus(b, a), _minus(c, a))
    slope = _dot(n, d)
    signs = _dot(d, _cross(b, c)), _dot(d, _cross(c, a)), _dot(d, _cross(a, b))
    if slope == 0 or min(signs) < 0 < max(signs):
        return None
    t = _dot(n, a) / slope
    return t if t >= 0 else None


def _vector(values: npt.ArrayLike) -> Vector:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return Fraction(x), Fraction(y), Fraction(z)


def _dot(a: Vector, b: Vector) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _times(a: Vector, factor: Fraction) -> Vector:
    return a[0] * factor, a[1] * factor, a[2] * factor


def _solve(columns: list[Vector], v: Vector) -> Vector:
    """Return the coefficients of v in the basis of three vectors, by Cramer's rule."""
    a, b, c = columns
    determinant = _dot(a, _cross(b, c))
    return _dot(v, _cross(b, c)) / determinant, _dot(v, _cross(c, a)) / determinant, _dot(v, _cross(a, b)) / determinant


@lru_cache(maxsize=1)
def _parts(world: World) -> tuple[list[Integers], Floats, Floats]:
    """Return the parts of a world, objects or groups of triangles, and the corners of their bounding boxes."""
    if world.mesh is None:
        low, high = zip(*map(_box, world.shapes), strict=True)
        return [np.array([index]) for index in range(len(low))], np.array(low), np.array(high)
    vertices, faces = world.mesh
    groups = _groups(vertices[faces].mean(axis=1))
    corners = [vertices[faces[group]].reshape(-1, 3) for group in groups]
    return groups, np.array([c.min(axis=0) for c in corners]), np.array([c.max(axis=0) for c in corners])


def _groups(centers: Floats) -> list[Integers]:
    """Return groups of indices of neighbouring triangles, by the Morton order of their centres."""
    cells = (1023 * (centers - centers.min(axis=0)) / np.maximum(np.ptp(centers, axis=0), np.finfo(float).tiny)).astype(
        np.int64
    )
    code = sum((cells[:, axis] >> bit & 1) << (3 * bit + axis) for bit in range(10) for axis in range(3))
    return np.array_split(np.argsort(code, kind="stable"), math.ceil(len(centers) / GROUP))


def _box(spec: Spec) -> tuple[Floats, Floats]:
    """Return the corners of a bounding box of a shape."""
    match spec.kind, spec.args:
        case (("Sphere" | "Ellipsoid"), (center, radius, *_)):
            reach = np.full(3, np.max(radius))
            return center - reach, center + reach
        case "Box", (size, center):
            return center - size / 2, center + size / 2
        case "Cylinder", (start, end, radius, *_):
            return np.minimum(start, end) - radius, np.maximum(start, end) + radius
    return np.full(3, -np.inf), np.full(3, np.inf)


def _may_meet(low: Floats, high: Floats, origin: Floats, direction: Floats) -> npt.NDArray[np.bool_]:
    """Return which boxes the ray may meet.

    With the unit roundoff u = 2⁻⁵³, the way to a side takes two roundings and a quotient, so it is off by less than
    3u·(1 + 3u) of the sum of both coordinates. Sides are moved outward by more than that, 4u of it, and by the least
    normal number, so that a ray along a side at 0 divides no 0 by 0.
    """
    with np.errstate(all="ignore"):
        least = np.finfo(float).tiny
        below, above = (4 * 2.0**-53 * (np.abs(side) + np.abs(origin)) + least for side in (low, high))
        t = np.stack([low - below - origin, high + above - origin]) / direction
        near, far = np.fmin(t[0], t[1]), np.fmax(t[0], t[1])
    entry, leave = np.fmax.reduce(near, axis=1), np.fmin.reduce(far, axis=1)
    met: npt.NDArray[np.bool_] = (entry <= leave) & (leave >= 0)
    return met


def _may_pierce(corners: Floats, direction: Floats) -> npt.NDArray[np.bool_]:
    """Return which triangles the line may pierce; corners, (n, 3, 3), are relative to the origin of the line.

    d·(b × c) is a sum of six products of three numbers, each with at most eight roundings; |d| is about 1.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    signs = np.stack([np.cross(b, c) @ direction, np.cross(c, a) @ direction, np.cross(a, b) @ direction])
    doubt = 6 * 8 * 2.0**-52 * np.abs(corners).max(axis=(1, 2), initial=0.0) ** 2
    kept: npt.NDArray[np.bool_] = ~((signs > doubt).any(axis=0) & (signs < -doubt).any(axis=0))
    return kept
