"""An exact oracle of every shape: slow, plain, and independent of the arithmetic that it judges.

Every float64 is an integer over a power of two, so a ray and a shape are integers over one denominator. Whether they
meet is then decided in Python's integers, and where they meet is a number (p + s·√d) / q with integer p, s, d, q: a
`Surd`, which is compared exactly and rounded correctly. No tolerance, no precision setting, nothing that could run out.

The classes bear the names of lidarsim's shapes and take the same arguments, so that
``oracle.Sphere(center, radius)`` judges ``lidarsim.Sphere(center, radius)``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

__all__ = [
    "Box",
    "Capsule",
    "Crossing",
    "Cylinder",
    "Disk",
    "Disks",
    "Ellipsoid",
    "Plane",
    "Polygon",
    "Ray",
    "Scene",
    "Shape",
    "Sphere",
    "Spheres",
    "Surd",
    "Transformed",
    "Triangle",
    "TriangleMesh",
    "nearest",
    "roots",
    "unit",
]

Floats = npt.NDArray[np.float64]
Vector = tuple[int, int, int]
Point = tuple[Fraction, Fraction, Fraction]
Rational = tuple[int, int]  # numerator, denominator > 0


class Exact(Protocol):
    """A number with an exact ratio: a float or a Fraction."""

    def as_integer_ratio(self) -> tuple[int, int]: ...


def _integers(values: Iterable[Exact]) -> tuple[list[int], int]:
    """Return dyadic numbers as integers over one power of two."""
    ratios = [value.as_integer_ratio() for value in values]
    denominator = max(d for _, d in ratios)
    return [n * (denominator // d) for n, d in ratios], denominator


def _floats(values: Any) -> list[float]:
    flat: list[float] = np.asarray(values, dtype=np.float64).ravel().tolist()
    return flat


def _vector(a: Sequence[int]) -> Vector:
    return (a[0], a[1], a[2])


def _dot(a: Vector, b: Vector) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _minus(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _times(a: Vector, k: int) -> Vector:
    return (a[0] * k, a[1] * k, a[2] * k)


def _sign(a: int, b: int = 0, d: int = 0) -> int:
    """Sign of a + b·√d."""
    left = (a > 0) - (a < 0)
    right = ((b > 0) - (b < 0)) if d else 0
    if left * right >= 0:
        return left or right
    square = a * a - b * b * d
    return left * ((square > 0) - (square < 0))


def _divide(p: int, q: int) -> float:
    """Return p / q correctly rounded (which Python's division of integers is), with overflow to infinity."""
    try:
        return p / q
    except OverflowError:
        return math.inf if p > 0 else -math.inf


class Surd:
    """The real number (p + s·√d) / q, with integers p, s, d ≥ 0 and q > 0; rational if s = 0."""

    __slots__ = ("d", "p", "q", "s")

    def __init__(self, p: int, q: int, s: int = 0, d: int = 0) -> None:
        if q < 0:
            p, q, s = -p, -q, -s
        if s:
            root = math.isqrt(d)
            if root * root == d:
                p, s, d = p + s * root, 0, 0
        self.p, self.q, self.s, self.d = p, q, s, d

    def times(self, by: Rational) -> Surd:
        """Return this number times a positive rational."""
        result = Surd.__new__(Surd)
        result.p, result.q, result.s, result.d = self.p * by[0], self.q * by[1], self.s * by[0], self.d
        return result

    def compare(self, other: Surd) -> int:
        """Return −1, 0, 1 as this number is below, equal to, above `other`, exactly."""
        a, b, c = self.p * other.q - other.p * self.q, self.s * other.q, -other.s * self.q
        left, right = _sign(a, b, self.d), _sign(0, c, other.d)
        if left * right >= 0:
            return left or right
        return left * _sign(a * a + b * b * self.d - c * c * other.d, 2 * a * b, self.d)

    def __lt__(self, other: Surd) -> bool:
        """Say whether this number is exactly below `other`."""
        return self.compare(other) < 0

    def __le__(self, other: Surd) -> bool:
        """Say whether this number is exactly `other` or below it."""
        return self.compare(other) <= 0

    def __eq__(self, other: object) -> bool:
        """Say whether this number is exactly `other`."""
        return isinstance(other, Surd) and self.compare(other) == 0

    __hash__ = None  # type: ignore[assignment]

    def _bracket(self, bits: int) -> tuple[int, int, int]:
        """Return integers lo, hi, q with lo/q ≤ this number ≤ hi/q and hi − lo ≤ 1."""
        lo = (self.p << bits) + (
            math.isqrt(self.s * self.s * self.d << 2 * bits)
            if self.s >= 0
            else -math.isqrt(self.s * self.s * self.d << 2 * bits) - 1
        )
        return lo, lo + 1, self.q << bits

    def __float__(self) -> float:
        """Return the float64 nearest to this number, ties to even."""
        if not self.s:
            return _divide(self.p, self.q)
        bits = 64  # an irrational is never halfway between two floats, so some precision tells
        while True:
            lo, hi, q = self._bracket(bits)
            below, above = _divide(lo, q), _divide(hi, q)
            if below == above:
                return below
            bits *= 2

    def fraction(self, bits: int = 320) -> Fraction:
        """Return a rational within a relative 2^−bits of this number; the number itself if it is rational."""
        if not self.s:
            return Fraction(self.p, self.q)
        work = bits
        while True:
            lo, _, q = self._bracket(work)
            if abs(lo).bit_length() > bits:
                return Fraction(lo, q)
            work *= 2

    def ulps(self, value: float) -> float:
        """Return |value − this number| in units in the last place of the float64 nearest to it."""
        nearest_float = float(self)
        if math.isinf(nearest_float) or not math.isfinite(value):
            return 0.0 if value == nearest_float else math.inf
        error = abs(Fraction(value) - self.fraction()) / Fraction(math.ulp(nearest_float))
        return _divide(error.numerator, error.denominator)

    def __repr__(self) -> str:
        """Show the nearest float64."""
        return f"Surd({float(self)!r})"


class Ray:
    """The line x(τ) = (o + τ·d) / w in integers, with t = τ·scale for the t of the ray as it was given."""

    __slots__ = ("d", "o", "scale", "w")

    def __init__(self, o: Vector, d: Vector, w: int, scale: Rational) -> None:
        self.o, self.d, self.w, self.scale = o, d, w, scale

    @classmethod
    def of(cls, origin: Sequence[float], direction: Sequence[float]) -> Ray:
        """Return the ray of float64 numbers, exactly."""
        (ox, oy, oz), w = _integers(origin)
        (dx, dy, dz), v = _integers(direction)
        return cls((ox, oy, oz), (dx, dy, dz), w, (v, w))

    def about(self, point: Vector, denominator: int) -> tuple[Vector, Vector]:
        """Return f, g with x(τ) − point/denominator = (f + τ·g) / (w·denominator)."""
        o, d, w = self.o, self.d, self.w
        f = (o[0] * denominator - point[0] * w, o[1] * denominator - point[1] * w, o[2] * denominator - point[2] * w)
        return f, _times(d, denominator)

    def at(self, t: Surd) -> Point:
        """Return the point at t of the given ray: exact for a rational t, else to a relative 2^−320 of t."""
        tau = t.fraction() * Fraction(self.scale[1], self.scale[0])
        x, y, z = ((o + tau * d) / self.w for o, d in zip(self.o, self.d, strict=True))
        return x, y, z


@dataclass(frozen=True, slots=True)
class Crossing:
    """A point where a line meets a surface: its t and the faces that hold it (more than one on an edge or a rim)."""

    t: Surd
    faces: tuple[int, ...] = (0,)


class Shape:
    """A surface that lines meet."""

    primitives = False  # whether faces are primitives, and the lowest of them decides

    def crossings(self, ray: Ray) -> list[Crossing]:
        """Return every point of the line on the surface, in ascending order of t, no t twice."""
        return self._crossings(ray)

    def _crossings(self, ray: Ray) -> list[Crossing]:
        raise NotImplementedError

    def _normal(self, point: Point, face: int, /) -> Point:
        """Return an outward normal, of any length, of `face` at `point`."""
        raise NotImplementedError

    def normals(self, ray: Ray, crossing: Crossing) -> Floats:
        """Return the unit normals, (m, 3), that may be reported at `crossing`: one for each face that holds it."""
        faces = (min(crossing.faces),) if self.primitives else crossing.faces
        point = ray.at(crossing.t)
        return np.array([unit(self._normal(point, face)) for face in faces])


def unit(vector: Sequence[Fraction]) -> list[float]:
    """Return vector / |vector|, each component correctly rounded."""
    denominator = math.lcm(*(v.denominator for v in vector))
    n = [int(v * denominator) for v in vector]
    square = sum(v * v for v in n)
    return [float(Surd(0, square, v, square)) for v in n]


def _quadratic(a: int, b: int, c: int) -> list[Surd]:
    """Return the distinct real roots of a·τ² + 2·b·τ + c, a > 0, ascending."""
    discriminant = b * b - a * c
    if discriminant < 0:
        return []
    if discriminant == 0:
        return [Surd(-b, a)]
    return [Surd(-b, a, -1, discriminant), Surd(-b, a, 1, discriminant)]


class Plane(Shape):
    """The points p with normal·p = distance, the normal as given, not made unit."""

    def __init__(self, normal: Any, distance: float) -> None:
        n, scale = _integers(_floats(normal))
        offset = Fraction(float(distance)) * scale
        self._set(_vector(n), offset)

    def _set(self, n: Vector, offset: Fraction) -> None:
        self.n, self.offset = n, offset.as_integer_ratio()  # n·p = offset

    @classmethod
    def from_point(cls, point: Any, normal: Any) -> Plane:
        """Return the points p with normal·(p − point) = 0."""
        plane = cls.__new__(cls)
        n, _ = _integers(_floats(normal))
        p, denominator = _integers(_floats(point))
        plane._set(_vector(n), Fraction(_dot(_vector(n), _vector(p)), denominator))
        return plane

    @classmethod
    def from_points(cls, a: Any, b: Any, c: Any) -> Plane:
        """Return the plane through three points, its normal along (b − a) × (c − a)."""
        plane = cls.__new__(cls)
        p, denominator = _integers(_floats([a, b, c]))
        first = _vector(p[:3])
        n = _cross(_minus(_vector(p[3:6]), first), _minus(_vector(p[6:]), first))
        plane._set(n, Fraction(_dot(n, first), denominator))
        return plane

    def _crossings(self, ray: Ray) -> list[Crossing]:
        slope = _dot(self.n, ray.d)
        if slope == 0:
            return []
        top, bottom = self.offset
        return [Crossing(Surd(top * ray.w - bottom * _dot(self.n, ray.o), bottom * slope).times(ray.scale))]

    def _normal(self, _point: Point, _face: int, /) -> Point:
        return Fraction(self.n[0]), Fraction(self.n[1]), Fraction(self.n[2])


class Sphere(Shape):
    """The points at distance radius from the centre."""

    def __init__(self, center: Any, radius: float) -> None:
        (x, y, z, self.radius), self.w = _integers([*_floats(center), float(radius)])
        self.center = (x, y, z)

    def _crossings(self, ray: Ray) -> list[Crossing]:
        f, g = ray.about(self.center, self.w)
        r = self.radius * ray.w
        return [Crossing(t.times(ray.scale)) for t in _quadratic(_dot(g, g), _dot(f, g), _dot(f, f) - r * r)]

    def _normal(self, point: Point, _face: int, /) -> Point:
        x, y, z = (p - Fraction(c, self.w) for p, c in zip(point, self.center, strict=True))
        return x, y, z


class Box(Shape):
    """The boundary of the closed box of corners center ± size/2; faces 2·axis (low) and 2·axis + 1 (high)."""

    def __init__(self, size: Any, center: Any = (0.0, 0.0, 0.0)) -> None:
        n, self.w = _integers([*_floats(size), *_floats(center)])
        self.size, self.center = _vector(n[:3]), _vector(n[3:])

    def _crossings(self, ray: Ray) -> list[Crossing]:
        f, g = ray.about(self.center, self.w)
        spans = []
        for axis in range(3):
            half, twice, rate = self.size[axis] * ray.w, 2 * f[axis], 2 * g[axis]
            if rate == 0:
                if abs(twice) > half:
                    return []
            else:
                near, far = (-half, half) if rate > 0 else (half, -half)
                spans.append((Surd(near - twice, rate), Surd(far - twice, rate)))
        entry, leave = max(span[0] for span in spans), min(span[1] for span in spans)
        if leave < entry:
            return []
        return [
            Crossing(t.times(ray.scale), self._faces(f, g, ray.w, t))
            for t in ((entry,) if entry == leave else (entry, leave))
        ]

    def _faces(self, f: Vector, g: Vector, w: int, tau: Surd) -> tuple[int, ...]:
        offsets = [2 * (f[axis] * tau.q + g[axis] * tau.p) for axis in range(3)]
        return tuple(
            2 * axis + (offset > 0) for axis, offset in enumerate(offsets) if abs(offset) == self.size[axis] * w * tau.q
        )

    def _normal(self, _point: Point, face: int, /) -> Point:
        x, y, z = (Fraction((2 * (face % 2) - 1) * (face // 2 == axis)) for axis in range(3))
        return x, y, z


class Cylinder(Shape):
    """The side about start–end and, if capped, its two discs; faces 0 side, 1 the cap at start, 2 the cap at end."""

    def __init__(self, start: Any, end: Any, radius: float, capped: bool = True) -> None:
        n, self.w = _integers([*_floats(start), *_floats(end), float(radius)])
        self.start, self.end, self.radius, self.capped = _vector(n[:3]), _vector(n[3:6]), n[6], capped
        self.axis = _minus(self.end, self.start)

    def _crossings(self, ray: Ray) -> list[Crossing]:
        axis, square = self.axis, _dot(self.axis, self.axis)
        f, g = ray.about(self.start, self.w)
        height, rate, top = _dot(f, axis), _dot(g, axis), square * ray.w  # on the side where 0 ≤ height + τ·rate ≤ top
        m, n = _cross(f, axis), _cross(g, axis)
        a, b, c = _dot(n, n), _dot(m, n), _dot(m, m) - self.radius * self.radius * ray.w * ray.w * square
        side = _quadratic(a, b, c) if a else []
        slab: list[tuple[Surd, int]] = []
        if rate:
            slab = sorted(
                [(Surd(-height, rate), 1), (Surd(top - height, rate), 2)], key=lambda item: (item[1] == 2) == (rate > 0)
            )
        elif not 0 <= height <= top:
            return []
        level = () if rate else tuple(face for face, at in ((1, 0), (2, top)) if height == at and self.capped)
        if not self.capped:
            inside = [t for t in side if not slab or slab[0][0] <= t <= slab[1][0]]
            return [Crossing(t.times(ray.scale)) for t in inside]
        if not side and (a or c > 0):
            return []
        ends = []
        for which in (0, -1):
            candidates = [(t, (0, *level)) for t in side[which : which + 1 or None]] + [
                (t, (face,)) for t, face in slab[which : which + 1 or None]
            ]
            chosen, faces = candidates[0]
            for t, more in candidates[1:]:
                order = t.compare(chosen) * (1 if which == 0 else -1)
                chosen, faces = (t, more) if order > 0 else (chosen, (*faces, *more) if order == 0 else faces)
            ends.append((chosen, faces))
        if not a and c == 0:
            ends = [(t, (0, *faces)) for t, faces in ends]
        entry, leave = ends
        order = entry[0].compare(leave[0])
        if order > 0:
            return []
        if order == 0:
            ends = [(entry[0], tuple(sorted({*entry[1], *leave[1]})))]
        return [Crossing(t.times(ray.scale), faces) for t, faces in ends]

    def _normal(self, point: Point, face: int, /) -> Point:
        x, y, z = (Fraction(a) for a in self.axis)
        if face:
            return (-x, -y, -z) if face == 1 else (x, y, z)
        f = [p - Fraction(s, self.w) for p, s in zip(point, self.start, strict=True)]
        along = (f[0] * x + f[1] * y + f[2] * z) / (x * x + y * y + z * z)
        return f[0] - along * x, f[1] - along * y, f[2] - along * z


class Capsule(Shape):
    """The side about start–end and the outer half of the sphere around each; faces 0 side, 1 at start, 2 at end."""

    def __init__(self, start: Any, end: Any, radius: float) -> None:
        self.side = Cylinder(start, end, radius, capped=False)
        self.balls = {1: Sphere(start, radius), 2: Sphere(end, radius)}

    def _crossings(self, ray: Ray) -> list[Crossing]:
        found = [(crossing.t, 0) for crossing in self.side._crossings(ray)]
        for face, ball in self.balls.items():
            f, g = ray.about(ball.center, ball.w)
            height, rate, r = _dot(f, self.side.axis), _dot(g, self.side.axis), ball.radius * ray.w
            for t in _quadratic(_dot(g, g), _dot(f, g), _dot(f, f) - r * r):
                above = _sign(height * t.q + rate * t.p, rate * t.s, t.d)  # the plane through the ball's centre
                if above in {0, -1 if face == 1 else 1}:
                    found.append((t.times(ray.scale), face))
        return _merge(found)

    def _normal(self, point: Point, face: int, /) -> Point:
        return self.balls[face]._normal(point, 0) if face else self.side._normal(point, 0)


class Disk(Shape):
    """The points p with normal·(p − center) = 0 and |p − center| ≤ radius."""

    def __init__(self, center: Any, normal: Any, radius: float) -> None:
        self.ball, self.plane = Sphere(center, radius), Plane.from_point(center, normal)

    def _crossings(self, ray: Ray) -> list[Crossing]:
        n = self.plane.n
        f, g = ray.about(self.ball.center, self.ball.w)
        a, b = _dot(n, g), -_dot(n, f)
        if a == 0:
            return []
        x, y, z = (p * a + q * b for p, q in zip(f, g, strict=True))
        if x * x + y * y + z * z > (self.ball.radius * ray.w * a) ** 2:
            return []
        return [Crossing(Surd(b, a).times(ray.scale))]

    def _normal(self, point: Point, face: int, /) -> Point:
        return self.plane._normal(point, face)


class _Many(Shape):
    """Several shapes, told apart."""

    primitives = True

    def __init__(self, shapes: Iterable[Shape]) -> None:
        self.shapes = list(shapes)

    def _crossings(self, ray: Ray) -> list[Crossing]:
        return _merge([(crossing.t, i) for i, shape in enumerate(self.shapes) for crossing in shape._crossings(ray)])

    def _normal(self, point: Point, face: int, /) -> Point:
        return self.shapes[face]._normal(point, 0)


class Spheres(_Many):
    """Spheres of these centres and radii."""

    def __init__(self, centers: Any, radii: Any) -> None:
        rows = np.asarray(centers, dtype=np.float64).reshape(-1, 3).tolist()
        super().__init__(map(Sphere, rows, np.broadcast_to(radii, len(rows)).tolist()))


class Disks(_Many):
    """Disks of these centres, normals and radii."""

    def __init__(self, centers: Any, normals: Any, radii: Any) -> None:
        rows = np.asarray(centers, dtype=np.float64).reshape(-1, 3).tolist()
        across = np.asarray(normals, dtype=np.float64).tolist()
        super().__init__(map(Disk, rows, across, np.broadcast_to(radii, len(rows)).tolist()))


class TriangleMesh(Shape):
    """Closed triangles (edges and vertices belong to them); one that is degenerate, or seen edge-on, is never met."""

    primitives = True

    def __init__(self, vertices: Any, faces: Any) -> None:
        flat, self.w = _integers(_floats(vertices))
        self.vertices = [_vector(flat[i : i + 3]) for i in range(0, len(flat), 3)]
        self.faces: list[list[int]] = np.asarray(faces).tolist()
        self.planes: dict[int, Vector] = {}
        self.anchor = self.vertices[0]
        offsets = [[_divide(x, self.w) for x in _minus(v, self.anchor)] for v in self.vertices]
        self.corners = np.array(offsets)[np.asarray(faces)]

    def _candidates(self, ray: Ray) -> Iterable[int]:
        """Return the triangles that float64 edge signs do not rule out by a wide margin."""
        if len(self.faces) <= 16:
            return range(len(self.faces))
        f, _ = ray.about(self.anchor, self.w)
        shift = max(max(map(abs, ray.d)).bit_length() - 60, 0)
        longest = max(map(abs, ray.d)) >> shift
        d = np.array([(v >> shift) / longest for v in ray.d])
        offset = np.array([_divide(v, ray.w * self.w) for v in f])
        with np.errstate(all="ignore"):
            a, b, c = corners = np.moveaxis(self.corners - offset, 1, 0)
            signs = np.stack([np.cross(b, c) @ d, np.cross(c, a) @ d, np.cross(a, b) @ d])
            # Each difference is off by less than 4·2⁻⁵³ of the largest number met, so each of a determinant's six
            # products by less than 32·2⁻⁵³ of that number squared.
            largest = max(float(np.abs(numbers).max()) for numbers in (corners, self.corners, offset))
            doubt = 6 * 32 * 2.0**-53 * largest * largest + 1e-300  # products may underflow
            ruled_out = (signs > doubt).any(axis=0) & (signs < -doubt).any(axis=0)
        return map(int, np.flatnonzero(~ruled_out))

    def _plane(self, face: int) -> Vector:
        if face not in self.planes:
            a, b, c = (self.vertices[i] for i in self.faces[face])
            self.planes[face] = _cross(_minus(b, a), _minus(c, a))
        return self.planes[face]

    def _crossings(self, ray: Ray) -> list[Crossing]:
        found: list[tuple[Surd, int]] = []
        o, d, w, scale = ray.o, ray.d, ray.w, self.w
        for face in self._candidates(ray):
            n = self._plane(face)
            slope = _dot(n, d)
            if slope == 0:
                continue
            a, b, c = (_minus(_times(self.vertices[i], w), _times(o, scale)) for i in self.faces[face])
            signs = (_dot(d, _cross(b, c)), _dot(d, _cross(c, a)), _dot(d, _cross(a, b)))
            if min(signs) < 0 < max(signs):
                continue
            found.append((Surd(_dot(n, a), slope * scale).times(ray.scale), face))
        return _merge(found)

    def _normal(self, _point: Point, face: int, /) -> Point:
        n = self._plane(face)
        return Fraction(n[0]), Fraction(n[1]), Fraction(n[2])


def _merge(found: list[tuple[Surd, int]]) -> list[Crossing]:
    """Return crossings in ascending order, those of exactly the same t as one."""
    merged: list[Crossing] = []
    for t, face in sorted(found, key=lambda item: item[0]):
        if merged and merged[-1].t == t:
            merged[-1] = Crossing(t, (*merged[-1].faces, face))
        else:
            merged.append(Crossing(t, (face,)))
    return merged


class Triangle(TriangleMesh):
    """One closed triangle; its normal is along (b − a) × (c − a)."""

    def __init__(self, a: Any, b: Any, c: Any) -> None:
        super().__init__([_floats(a), _floats(b), _floats(c)], [[0, 1, 2]])


class Polygon(Shape):
    """The closed region of a simple polygon, its vertices exactly in one plane; the normal is by the right hand."""

    def __init__(self, vertices: Any) -> None:
        flat, self.w = _integers(_floats(vertices))
        self.vertices = [_vector(flat[i : i + 3]) for i in range(0, len(flat), 3)]
        n = (0, 0, 0)
        for a, b in self._edges():
            e = _cross(_minus(a, self.vertices[0]), _minus(b, self.vertices[0]))
            n = (n[0] + e[0], n[1] + e[1], n[2] + e[2])
        self.n = n
        if any(_dot(n, _minus(v, self.vertices[0])) for v in self.vertices):
            raise ValueError("vertices: the oracle's polygon is exactly planar")

    def _edges(self) -> Iterable[tuple[Vector, Vector]]:
        return zip(self.vertices, self.vertices[1:] + self.vertices[:1], strict=True)

    def _crossings(self, ray: Ray) -> list[Crossing]:
        slope = _dot(self.n, ray.d)
        if slope == 0:
            return []
        f, g = ray.about(self.vertices[0], self.w)
        tau = Surd(-_dot(self.n, f), _dot(self.n, g))
        drop = max(range(3), key=lambda axis: abs(self.n[axis]))
        u, v = (axis for axis in range(3) if axis != drop)
        o, d = _times(ray.o, self.w), _times(ray.d, self.w)
        x, y, w = o[u] * tau.q + d[u] * tau.p, o[v] * tau.q + d[v] * tau.p, ray.w * tau.q
        inside = False
        for a, b in self._edges():
            ax, ay, bx, by = a[u] * w - x, a[v] * w - y, b[u] * w - x, b[v] * w - y
            turn = ax * by - ay * bx
            if turn == 0 and ax * bx + ay * by <= 0:
                return [Crossing(tau.times(ray.scale))]
            if (ay > 0) != (by > 0):
                inside ^= (turn > 0) == (by > ay)
        return [Crossing(tau.times(ray.scale))] if inside else []

    def _normal(self, _point: Point, _face: int, /) -> Point:
        return Fraction(self.n[0]), Fraction(self.n[1]), Fraction(self.n[2])


class Transformed(Shape):
    """The image of a shape under an invertible affine map, 4×4 or 3×4, whose entries are exact: floats or fractions."""

    def __init__(self, shape: Shape, matrix: Any) -> None:
        self.shape, self.primitives = shape, shape.primitives
        rows = [[entry if isinstance(entry, Fraction) else float(entry) for entry in row] for row in list(matrix)[:3]]
        linear, self.scale = _integers([entry for row in rows for entry in row[:3]])
        origin, self.w = _integers([row[3] for row in rows])
        a, b, c = (_vector(linear[i : i + 3]) for i in (0, 3, 6))
        self.origin = _vector(origin)
        # the adjugate's columns are the cross products of the rows
        columns = (_cross(b, c), _cross(c, a), _cross(a, b))
        self.determinant = _dot(a, columns[0])
        if self.determinant == 0:
            raise ValueError("matrix: singular")
        self.adjugate = tuple(_vector([column[i] for column in columns]) for i in range(3))

    def local(self, ray: Ray) -> Ray:
        """Return the ray as the untransformed shape meets it; its t is the same."""
        f, g = ray.about(self.origin, self.w)
        sign = 1 if self.determinant > 0 else -1
        o, d = (_times(_vector([_dot(row, v) for row in self.adjugate]), self.scale * sign) for v in (f, g))
        return Ray(o, d, ray.w * self.w * abs(self.determinant), ray.scale)

    def _crossings(self, ray: Ray) -> list[Crossing]:
        return self.shape._crossings(self.local(ray))

    def _normal(self, point: Point, face: int, /) -> Point:
        offset = [
            (p - Fraction(c, self.w)) * self.scale / self.determinant for p, c in zip(point, self.origin, strict=True)
        ]
        x, y, z = (sum((a * v for a, v in zip(row, offset, strict=True)), Fraction(0)) for row in self.adjugate)
        n = self.shape._normal((x, y, z), face)
        # the inverse transpose keeps an outward normal outward, under a reflection too
        x, y, z = (
            sum((self.adjugate[i][j] * n[i] for i in range(3)), Fraction(0)) / self.determinant for j in range(3)
        )
        return x, y, z


class Ellipsoid(Transformed):
    """The image of the unit sphere under u → center + rotation·diag(radii)·u, the rotation's entries as given."""

    def __init__(self, center: Any, radii: Any, rotation: Any = None) -> None:
        if hasattr(rotation, "as_matrix"):
            rotation = rotation.as_matrix()
        axes = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        lengths = [Fraction(r) for r in _floats(radii)]
        rows = [
            [Fraction(float(axes[i, j])) * lengths[j] for j in range(3)] + [Fraction(c)]
            for i, c in enumerate(_floats(center))
        ]
        super().__init__(Sphere((0.0, 0.0, 0.0), 1.0), rows)


class Scene:
    """Shapes in the order they were added; `nearest` is the brute force over all of them."""

    def __init__(self) -> None:
        self.shapes: list[Shape] = []

    def add(self, shape: Shape, transform: Any = None) -> int:
        """Add a shape, moved by `transform`, and return its object id."""
        self.shapes.append(shape if transform is None else Transformed(shape, transform))
        return len(self.shapes) - 1

    def nearest(self, ray: Ray, t_min: float = 0.0, t_max: float = math.inf) -> tuple[int, Crossing] | None:
        """Return object and crossing of the smallest exact t whose float64 is in range; of equals the first object."""
        best: tuple[int, Crossing] | None = None
        for index, shape in enumerate(self.shapes):
            crossing = nearest(shape, ray, t_min, t_max)
            if crossing is not None and (best is None or crossing.t < best[1].t):
                best = index, crossing
        return best


def nearest(shape: Shape, ray: Ray, t_min: float = 0.0, t_max: float = math.inf) -> Crossing | None:
    """Return the first crossing whose t is not negative and, rounded to float64, finite and in [t_min, t_max]."""
    for crossing in shape.crossings(ray):
        t = float(crossing.t)
        if t_min <= t <= t_max and not math.isinf(t) and not crossing.t < Surd(0, 1):
            return crossing
    return None


def roots(shape: Shape, origins: Any, directions: Any) -> list[list[Surd]]:
    """Return for each ray every t where its line meets the shape, exact, ascending."""
    o, d = (np.asarray(array, dtype=np.float64).tolist() for array in (origins, directions))
    return [[crossing.t for crossing in shape.crossings(Ray.of(a, b))] for a, b in zip(o, d, strict=True)]
