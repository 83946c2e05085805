"""Hard inputs: rays and shapes on which floating point goes wrong, each named."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from conformance.samples import SAMPLES
from exact.spec import Spec
from scipy.spatial.transform import Rotation

from lidarsim.bench.scenes import UTM, rotations

__all__ = [
    "OFFSETS",
    "Case",
    "Spec",
    "basic_specs",
    "closed_meshes",
    "fan",
    "hard_cases",
    "leak_rays",
    "rotations",
    "star",
    "transforms",
]

Floats = npt.NDArray[np.float64]

OFFSETS = {"0": 0.0, "5e5": 5e5, "5e6": 5e6, "6.4e6": 6.4e6, "1e9": 1e9}

GRAZING = (1e-2, 1e-4, 2e-5, 1e-8, 1e-12)
IMPACTS: dict[str, Callable[[float], float]] = {
    "0": lambda _: 0.0,
    "0.5": lambda r: 0.5 * r,
    "1-1e-5": lambda r: r * (1 - 1e-5),
    "1-1e-12": lambda r: r * (1 - 1e-12),
    "1-2^-53": lambda r: float(np.nextafter(r, 0.0)),
    "1": lambda r: r,
    "1+2^-52": lambda r: float(np.nextafter(r, np.inf)),
}
SCALES = (1.0, 2.0, 2.0**-50, 2.0**50, 2.0**500, 2.0**-500, 1e150, 1e-150, 1e160, 1e-160, 1e200, 1e-200)


@dataclass(frozen=True)
class Case:
    """Rays at a shape. `group` is its row in the accuracy table; `hits` and `misses` are the least it must hold."""

    name: str
    group: str
    spec: Spec
    origins: Floats = field(repr=False)
    directions: Floats = field(repr=False)
    hits: int = 1
    misses: int = 0


def _rays(pairs: Sequence[tuple[Any, Any]]) -> tuple[Floats, Floats]:
    array = np.array([[np.asarray(o, dtype=np.float64), np.asarray(d, dtype=np.float64)] for o, d in pairs])
    return np.ascontiguousarray(array[:, 0]), np.ascontiguousarray(array[:, 1])


def _affine(linear: Any, translation: Any = (0.0, 0.0, 0.0)) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, translation
    return matrix


def hard_cases() -> list[Case]:
    """Return every named case."""
    makers = (
        _planes,
        _spheres,
        _ellipsoids,
        _boxes,
        _cylinders,
        _capsules,
        _disks,
        _many,
        _triangles,
        _meshes,
        _polygons,
        _scalings,
        _transformations,
    )
    return list(itertools.chain.from_iterable(maker() for maker in makers))


def _planes() -> Iterator[Case]:
    rng = np.random.default_rng(1)
    for offset, shift in OFFSETS.items():
        for angle in GRAZING:
            normal = rng.normal(size=3)
            along = np.cross(normal, rng.normal(size=(20, 3)))
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            point = shift + rng.normal(size=3)
            directions = along + rng.choice([-1, 1], (20, 1)) * angle * normal / np.linalg.norm(normal)
            origins = point + rng.normal(size=(20, 3)) * 10
            yield Case(
                f"plane-grazing-{angle:g}-at-{offset}",
                "plane, grazing 1e-2 … 1e-12 rad",
                Spec("Plane.from_point", (point, normal)),
                origins,
                directions,
            )
            yield Case(
                f"plane-distance-grazing-{angle:g}-at-{offset}",
                "plane, grazing 1e-2 … 1e-12 rad",
                Spec("Plane", (normal, float(normal @ point))),
                origins,
                directions,
            )
            yield Case(
                f"plane-of-three-points-grazing-{angle:g}-at-{offset}",
                "plane, grazing 1e-2 … 1e-12 rad",
                Spec("Plane.from_points", (point, point + along[0], point + along[1])),
                origins,
                directions,
            )
    nx, ny, nz = 0.1, 0.7, -0.3
    parallel = [(ny, -nx, 0.0), (0.0, nz, -ny), (nz, 0.0, -nx)]
    nearly = [(np.nextafter(x, 9) if x else 0.0, y, z) for x, y, z in parallel]
    nearly += [(x, np.nextafter(y, -9) if y else 0.0, z) for x, y, z in parallel]
    # the products of the components cancel exactly; one ulp aside they do not, though the rounded products may
    pairs = [(o, d) for o in ((0.0, 0.0, 0.0), (3.0, 4.0, 5.0), tuple(UTM)) for d in (*parallel, *nearly)]
    origins, directions = _rays(pairs)
    spec = Spec("Plane", ((nx, ny, nz), 2.0))
    yield Case("plane-parallel-and-one-ulp-off", "plane, parallel or one ulp off", spec, origins, directions, 6, 9)
    origins, directions = _rays([((1.0, 2.0, 3.0), d) for d in ((1, 0, 0), (0, -1, 0), (3, -2, 0.0), (-0.0, 1, -0.0))])
    spec = Spec("Plane", ((0.0, 0.0, 2.0), 6.0))
    yield Case("plane-ray-inside-it", "plane, parallel or one ulp off", spec, origins, directions, 0, 4)
    origins, directions = _rays([((1, 2, 3), (0.5, 1, s * z)) for s in (-1, 1) for z in (1, 1e-200, 5e-324, 1e200)])
    yield Case("plane-origin-on-it", "plane, parallel or one ulp off", spec, origins, directions, 8)


def _spheres() -> Iterator[Case]:
    for r, distance in itertools.product((1e-3, 1.0, 6.371e6), (0.0, 1e-9, 1e-3, 10.0, 1e6, 1e8)):
        for label, impact in IMPACTS.items():
            b = impact(r)
            group = f"sphere, b/r = {label.replace('-1e', ' − 1e').replace('-2', ' − 2').replace('+', ' + ')}"
            pairs: list[tuple[Any, Any]] = []
            for axis, sign, back, scale in itertools.product(range(3), (-1, 1), (distance, r + distance), (1.0, 3.7)):
                e, f = np.zeros(3), np.zeros(3)
                e[axis], f[(axis + 1) % 3] = sign, b
                pairs.append((f - back * e, e * scale))
            origins, directions = _rays(pairs)
            hits, misses = (0, len(pairs)) if label == "1+2^-52" else (len(pairs) // 2, 0)
            name = f"sphere-r{r:g}-distance{distance:g}-b{label}"
            yield Case(name, group, Spec("Sphere", ((0, 0, 0), r)), origins, directions, hits, misses)
            turned = rotations(12, 2)
            for where, center in (("turned", np.zeros(3)), ("turned-utm", UTM)):
                spec = Spec("Sphere", (center, r))
                o, d = (
                    np.einsum("nij,nj->ni", turned, origins[:12]) + center,
                    np.einsum("nij,nj->ni", turned, directions[:12]),
                )
                yield Case(f"{name}-{where}", group, spec, o, d, 0)
    for scale in (1e-3, 1.0, 1.0e6):
        # 3² + 4² = 5² and 2² + 3² + 6² = 7² put the origin on the sphere exactly, while the scale is an integer
        for radius, point in ((5.0, (3.0, 4.0, 0.0)), (7.0, (-2.0, 3.0, 6.0))):
            pairs = []
            p = np.array(point)
            tangent = np.array((-p[1], p[0], 0.0))
            for d in (p, -p, tangent, -tangent, tangent + 1e-9 * p, tangent - 1e-9 * p, (1.0, 0.5, -0.25)):
                pairs += [
                    (p * scale, np.asarray(d)),
                    (np.nextafter(p, 0) * scale, d),
                    (np.nextafter(p, 9 * p) * scale, d),
                ]
            origins, directions = _rays(pairs)
            spec = Spec("Sphere", ((0, 0, 0), radius * scale))
            yield Case(
                f"sphere-origin-on-surface-r{radius:g}x{scale:g}",
                "sphere, origin on it ± 1 ulp",
                spec,
                origins,
                directions,
                5,
            )
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(24, 3))
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    for where, depth in (("center", 100.0), ("half-way", 50.0), ("1e-9-inside", 1e-9), ("1e-9-outside", -1e-9)):
        spec = Spec("Sphere", ((1.0, -2.0, 3.0), 100.0))
        origins = np.array((1.0, -2.0, 3.0)) + unit * (100.0 - depth)
        for way, d in (("out", directions), ("in", -directions), ("along", np.cross(directions, (1.0, 2.0, 3.0)))):
            yield Case(f"sphere-from-{where}-{way}", "sphere, origin within 1e-9 of it or inside", spec, origins, d, 0)
    down = np.array((0.0, 0.0, 6.371e6 + 1e-3))
    for angle in GRAZING:
        around = np.linspace(0, 6, 20)
        d = np.stack([np.cos(around), np.sin(around), np.full(20, -angle)], axis=1)
        o = np.tile(down, (20, 1))
        yield Case(
            f"sphere-planet-grazing-{angle:g}",
            "planet r 6.371e6 from 1e-3 above",
            Spec("Sphere", ((0, 0, 0), 6.371e6)),
            o,
            d,
            0,
        )
    o = down + rng.normal(size=(20, 3)) * (1, 1, 0)
    d = rng.normal(size=(20, 3)) * (1, 1, 0.1) - (0, 0, 3)
    yield Case(
        "sphere-planet-downward", "planet r 6.371e6 from 1e-3 above", Spec("Sphere", ((0, 0, 0), 6.371e6)), o, d, 20
    )


def _ellipsoids() -> Iterator[Case]:
    turns = rotations(3, 4)
    for aspect, (label, impact) in itertools.product((1.0, 1e3, 1e6, 1e-6), IMPACTS.items()):
        radii = np.array((1.0, aspect, 2.0))
        pairs = []
        for axis, sign in itertools.product(range(3), (-1, 1)):
            e, f = np.zeros(3), np.zeros(3)
            e[axis], f[(axis + 1) % 3] = sign, impact(radii[(axis + 1) % 3])
            pairs += [(f - 3 * radii[axis] * e, e), (f - 1e6 * e, 1.7 * e)]
        origins, directions = _rays(pairs)
        group = "ellipsoid, tangent and nearly"
        hits, misses = (0, 12) if label == "1+2^-52" else (6, 0)
        name = f"ellipsoid-aspect{aspect:g}-b{label}"
        yield Case(name, group, Spec("Ellipsoid", ((0, 0, 0), radii)), origins, directions, hits, misses)
        for turn, (where, center) in zip(turns, (("turned", np.zeros(3)), ("turned-utm", UTM)), strict=False):
            spec = Spec("Ellipsoid", (center, radii, turn))
            yield Case(f"{name}-{where}", group, spec, origins @ turn.T + center, directions @ turn.T, 0)
    rng = np.random.default_rng(5)
    for radii in np.array(((1e-3, 2e-3, 1e-3), (1.0, 0.1, 10.0), (1e-6, 1.0, 1e6))):
        d = rng.normal(size=(30, 3)) @ (turns[2] * radii).T
        o = UTM - d * np.exp(rng.uniform(0, 20, (30, 1))) + rng.normal(size=(30, 3)) * min(radii)
        yield Case(
            f"ellipsoid-far-{radii[0]:g}-{radii[2]:g}",
            "ellipsoid, far",
            Spec("Ellipsoid", (UTM, radii, turns[2])),
            o,
            d,
            5,
        )


def _boxes() -> Iterator[Case]:
    sizes = {"cube": (2.0, 2.0, 2.0), "flat": (2.0, 4.0, 1e-12), "thin": (1e-6, 1.0, 1e6), "plate": (1e6, 1.0, 1e-6)}
    for (label, size), (where, shift) in itertools.product(
        sizes.items(), (("0", 0.0), ("5e6", 5e6), ("2^30", 2.0**30))
    ):
        half = np.array(size) / 2
        corners = np.array(list(itertools.product((-1, 1), repeat=3))) * half
        rng = np.random.default_rng(6)
        pairs = []
        for axis, sign in itertools.product(range(3), (-1, 1)):
            e = np.zeros(3)
            e[axis] = sign
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for a, b in itertools.product((-1, 0, 0.5, 1), repeat=2):  # in a face and along an edge at ±1
                side = np.zeros(3)
                side[u], side[v] = a * half[u], b * half[v]
                pairs += [(side - 3 * half[axis] * e, e), (side, 2.5 * e), (side + 3 * half[axis] * e, e)]
            out = np.zeros(3)
            out[u] = np.nextafter(half[u], np.inf)
            pairs += [(out - 3 * half[axis] * e, e), (-out - 3 * half[axis] * e, np.where(e == 0, -0.0, e))]
        exact = len(pairs)
        for corner in corners:
            for towards in rng.integers(-3, 4, (6, 3)) / 2.0:
                d = towards * half
                if d.any():
                    pairs += [(corner - d, d), (corner + d, d)]  # through the corner, from either side
            edge = corner * (1, 1, rng.uniform(-1, 1))
            pairs += [(edge - 4 * d, d) for d in rng.normal(size=(3, 3)) * half]
        origins, directions = _rays(pairs)
        spec = Spec("Box", (size, (shift, shift, shift)))
        name = f"box-{label}-at-{where}"
        group = "box, in faces, along edges, through corners"
        yield Case(
            f"{name}-axis-parallel", group, spec, origins[:exact] + shift, directions[:exact], 60, 0 if shift else 12
        )
        yield Case(f"{name}-edges-corners", group, spec, origins[exact:] + shift, directions[exact:], 20)


def _across(r: float, heights: Sequence[float]) -> list[tuple[Any, Any]]:
    """Rays across the z axis at some heights: through a wall of radius r, along its tangents and past it."""
    pairs: list[tuple[Any, Any]] = []
    for z, impact in itertools.product(heights, IMPACTS.values()):
        pairs += [
            ((-3 * r, impact(r), z), (1.0, 0, 0)),
            ((impact(r), 7 * r, z), (0, -3.0, 0)),
            ((-impact(r), 0, z), (0, 1.0, 0)),
        ]
    return pairs


def _through_rims(r: float, h: float) -> list[tuple[Any, Any]]:
    """Rays through the circles of radius r at the heights 0 and h."""
    pairs: list[tuple[Any, Any]] = []
    for (x, y), z in itertools.product(((1, 0), (-0.6, 0.8), (0.6, -0.8)), (0.0, h)):
        rim = np.array((x * r, y * r, z))  # (3, 4)/5 of r = 5 is on the rim exactly
        for towards in (
            (x * r, y * r, h),
            (x * r, y * r, -h),
            (-y * r, x * r, h),
            (-y * r, x * r, 0),
            (r, 2 * r, 0.5 * h),
            (r, -r, -3 * h),
        ):
            step = np.array(towards)
            pairs += [(rim - step, step), (rim + 2 * step, step), (rim + 2 * step, -step), (rim, step)]
    return pairs


def _grazing(r: float, h: float, angle: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Points of a wall of radius r and height h, and directions at an angle to it."""
    around = rng.uniform(0, 6.28, 24)
    wall = np.stack([r * np.cos(around), r * np.sin(around), h * rng.uniform(0, 1, 24)], axis=1)
    inward = -wall * (1, 1, 0) / r
    d = inward * angle * rng.choice([-1, 1], (24, 1)) + np.array((0, 0, 1.0)) * rng.choice([-1, 1], (24, 1))
    return wall, d


def _to_tangents(
    radius: float, shift: float, heights: Sequence[float], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats, Floats]:
    """Start and axis of a tilted wall, and points of it at some heights with directions, most nearly tangent."""
    start = shift + rng.normal(size=3)
    axis = rng.normal(size=3)
    u = np.cross(axis, rng.normal(size=(60, 3)))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axis, u)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    z = rng.choice(heights, (60, 1))
    b = radius * rng.choice([0.3, 1 - 1e-9, 1 - 1e-15, 1], (60, 1))
    target = start + z * axis + u * np.sqrt(radius * radius - b * b) + v * b
    return start, axis, target, u + rng.normal(size=(60, 1)) * axis


def _cylinders() -> Iterator[Case]:
    sizes = {
        "unit": (5.0, 10.0),
        "needle": (1e-6, 1.0),
        "disc": (1e6, 1.0),
        "flat": (1.0, 1e-12),
        "thread": (1e-12, 1.0),
    }
    for (label, (r, h)), capped in itertools.product(sizes.items(), (True, False)):
        where = "capped" if capped else "open"
        group = f"cylinder ({where})"
        spec = Spec("Cylinder", ((0, 0, 0), (0, 0, h), r, capped))
        pairs: list[tuple[Any, Any]] = []
        for sign in (-1, 1):
            for rho in (0.0, 0.5 * r, np.nextafter(r, 0), r, np.nextafter(r, np.inf)):
                pairs += [((rho, 0, z * h), (0, 0, sign * 1.5)) for z in (-1, 0, 0.5, 1, 2)]
                pairs += [((0, -rho, -h), (0.0, -0.0, sign * 0.1))]
        yield Case(
            f"cylinder-{where}-{label}-along-axis",
            f"{group}, along the axis and in the wall",
            spec,
            *_rays(pairs),
            20 * capped,
            12,
        )
        pairs = _across(r, (0.0, 0.5 * h, h, np.nextafter(h, 9 * h), -5e-324))
        yield Case(
            f"cylinder-{where}-{label}-across", f"{group}, tangent and at the rim's height", spec, *_rays(pairs), 30, 30
        )
        pairs = _through_rims(r, h)
        yield Case(f"cylinder-{where}-{label}-through-rim", f"{group}, through the rim", spec, *_rays(pairs), 20)
        for angle in GRAZING:
            wall, d = _grazing(r, h, angle, np.random.default_rng(7))
            yield Case(
                f"cylinder-{where}-{label}-grazing-{angle:g}",
                f"{group}, grazing the wall",
                spec,
                wall - d * 2 * h,
                d,
                0,
            )
    rng = np.random.default_rng(8)
    for (offset, shift), capped in itertools.product(OFFSETS.items(), (True, False)):
        radius = 0.37
        start, axis, target, d = _to_tangents(radius, shift, (0, 1e-17, 0.3, 0.99999, 1, 1 + 1e-16), rng)
        where = "capped" if capped else "open"
        spec = Spec("Cylinder", (start, start + axis, radius, capped))
        origins = target + d * rng.choice([1e-9, 1.0, 100.0], (60, 1))
        yield Case(
            f"cylinder-{where}-tilted-at-{offset}",
            f"cylinder ({where}), tilted, to tangents and rims",
            spec,
            origins,
            -d,
            10,
        )


def _capsules() -> Iterator[Case]:
    sizes = {
        "unit": (5.0, 10.0),
        "needle": (1e-6, 1.0),
        "ball": (1e6, 1.0),
        "nearly-a-sphere": (1.0, 1e-12),
        "thread": (1e-12, 1.0),
    }
    for label, (r, h) in sizes.items():
        spec = Spec("Capsule", ((0, 0, 0), (0, 0, h), r))
        pairs: list[tuple[Any, Any]] = []
        for sign in (-1, 1):
            for rho in (0.0, 0.5 * r, np.nextafter(r, 0), r, np.nextafter(r, np.inf)):
                pairs += [((rho, 0, z), (0, 0, sign * 1.5)) for z in (-2 * r, -r, 0, 0.5 * h, h, h + r, h + 2 * r)]
                pairs += [((0, -rho, -h), (0.0, -0.0, sign * 0.1))]
        yield Case(
            f"capsule-{label}-along-axis", "capsule, along the axis and in the wall", spec, *_rays(pairs), 20, 12
        )
        pairs = _across(r, (-5e-324, 0.0, 0.5 * h, h, np.nextafter(h, 9 * h)))
        yield Case(f"capsule-{label}-across", "capsule, tangent and at the seams' height", spec, *_rays(pairs), 30, 15)
        pairs = []
        for beyond, impact in itertools.product((-1, 1), IMPACTS.values()):  # impact(r) beyond an end; 5² = 3² + 4²
            z = h + impact(r) if beyond > 0 else -impact(r)
            pairs += [((-3 * r, 0, z), (1.0, 0, 0)), ((0, 2 * r, z), (0, -0.25, 0)), ((0, 0, z), (3.0, -4.0, 0))]
            pairs += [((-0.6 * r, -3 * r, beyond * impact(0.8 * r) + h * (beyond > 0)), (0, 2.0, 0))]
        yield Case(f"capsule-{label}-over-the-ends", "capsule, tangent to the ends", spec, *_rays(pairs), 20, 4)
        pairs = _through_rims(r, h)
        yield Case(f"capsule-{label}-through-seam", "capsule, through the seams", spec, *_rays(pairs), 20)
        for angle in GRAZING:
            wall, d = _grazing(r, h, angle, np.random.default_rng(9))
            yield Case(
                f"capsule-{label}-grazing-{angle:g}", "capsule, grazing the wall", spec, wall - d * 2 * (h + r), d, 0
            )
    rng = np.random.default_rng(10)
    for offset, shift in OFFSETS.items():
        radius, heights = 0.37, (-0.2, 0, 1e-17, 0.3, 0.99999, 1, 1 + 1e-16, 1.2)
        start, axis, target, d = _to_tangents(radius, shift, heights, rng)
        yield Case(
            f"capsule-tilted-at-{offset}",
            "capsule, tilted, to tangents and seams",
            Spec("Capsule", (start, start + axis, radius)),
            target + d * rng.choice([1e-9, 1.0, 100.0], (60, 1)),
            -d,
            10,
        )


def _disks() -> Iterator[Case]:
    group = "disk, to the rim and in its plane"
    for label, r in (("unit", 5.0), ("tiny", 2.0**-40), ("wide", 2.0**40)):
        pairs: list[tuple[Any, Any]] = []
        for (x, y), impact in itertools.product(((1, 0), (0, -1), (-0.6, 0.8), (0.8, 0.6)), IMPACTS.values()):
            point = np.array((x * impact(r), y * impact(r), 0.0))
            for d in ((0, 0, 1.0), (0, 0, -3.0), (r, 0, 0.5 * r), (-y * r, x * r, r), (r, 2 * r, 1e-3 * r)):
                pairs += [(point, d), (point - 2 * np.array(d), d)]
            pairs += [(point - 2 * r, (1, 0, 0)), (point, (x, y, 0))]  # beside the plane and within it
        yield Case(f"disk-{label}", group, Spec("Disk", ((0, 0, 0), (0, 0, 2.0), r)), *_rays(pairs), 100, 60)
    rng = np.random.default_rng(11)
    for (offset, shift), angle in itertools.product(OFFSETS.items(), GRAZING):
        center, normal, radius = shift + rng.normal(size=3), rng.normal(size=3) * 10.0 ** rng.integers(-6, 6), 0.37
        n = normal / np.linalg.norm(normal)
        u = np.cross(n, rng.normal(size=(30, 3)))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        target = center + radius * u * (1 + rng.choice([-1, 0, 1], (30, 1)) * rng.choice([1e-16, 1e-9, 0.5], (30, 1)))
        d = np.cross(n, u) * rng.choice([0.0, 1.0], (30, 1)) + u + angle * n * rng.choice([-1, 1], (30, 1))
        yield Case(
            f"disk-grazing-{angle:g}-at-{offset}",
            "disk, grazing 1e-2 … 1e-12 rad",
            Spec("Disk", (center, normal, radius)),
            target - d * rng.choice([1e-3, 1.0, 100.0], (30, 1)),
            d,
            0,
        )


def _triangle_rays(a: Any, b: Any, c: Any, rng: np.random.Generator, distance: float) -> tuple[Floats, Floats]:
    """Rays to the vertices, to edge midpoints and points p + s·e, inside, and just outside of a triangle."""
    corners = np.array([a, b, c])
    targets = [*corners, *((corners + np.roll(corners, 1, 0)) / 2)]
    for i, s in itertools.product(range(3), rng.uniform(0, 1, 4)):
        targets.append(corners[i] + s * (corners[(i + 1) % 3] - corners[i]))
    targets += list(rng.dirichlet((1, 1, 1), 6) @ corners)
    centroid = corners.mean(axis=0)
    targets += [centroid + (p - centroid) * (1 + s) for p in corners for s in (1e-15, 1e-3, 1.0)]
    goal = np.repeat(np.array(targets), 2, axis=0)
    size = np.abs(corners - centroid).max()
    origins = centroid + rng.normal(size=goal.shape) * distance * size
    return origins, goal - origins


def _many() -> Iterator[Case]:
    """Yield cases of one sphere or disk, with others beside, inside and on top of it."""
    chosen = [case for case in _spheres() if "-utm" in case.name or "distance0.001" in case.name]
    for case in [*chosen[:24], *_disks()]:
        spec = among_others(case.spec)
        yield Case(f"many-{case.name}", f"many: {case.group}", spec, case.origins, case.directions, 0)


def among_others(spec: Spec) -> Spec:
    """Return the sphere or disk with others, as one object of many."""
    center, *normal, radius = spec.args
    steps = np.array([(0, 0, 0), *np.eye(3), *-np.eye(3), (1, 1, 1), (-1, 1, 0), (0, 0, 0), (0.5, 0, 0)])
    radii = radius * np.array([1, 0.5, 0.25, 1, 2, 1, 1, 0.125, 1, 1, 0.5])
    normals = [np.tile(n, (len(steps), 1)) for n in normal]
    return Spec(f"{spec.kind}s", (np.asarray(center) + radius * steps, *normals, radii), spec.transform)


def _triangles() -> Iterator[Case]:
    rng = np.random.default_rng(9)
    for (offset, shift), distance in itertools.product(OFFSETS.items(), (0.5, 50.0, 1e6)):
        a, b, c = shift + rng.normal(size=(3, 3))
        rays = _triangle_rays(a, b, c, rng, distance)
        spec = Spec("Triangle", (a, b, c))
        yield Case(f"triangle-at-{offset}-from-{distance:g}", f"triangle at {offset} m", spec, *rays, 10)
    for aspect, (where, shift) in itertools.product((1e4, 1e8, 1e12), (("0", 0.0), ("5e6", 5e6))):
        for trial in range(3):
            a, b = shift + rng.normal(size=(2, 3))
            c = a + 0.4 * (b - a) + rng.normal(size=3) / aspect
            if not np.cross(b - a, c - a).any():
                continue
            rays = _triangle_rays(a, b, c, rng, 3.0)
            name = f"triangle-sliver-{aspect:g}-at-{where}-{trial}"
            yield Case(name, f"triangle, sliver of aspect {aspect:g}", Spec("Triangle", (a, b, c)), *rays, 0)
    for angle, (where, shift) in itertools.product(GRAZING, (("0", 0.0), ("5e6", 5e6))):
        a, b, c = shift + rng.normal(size=(3, 3))
        n = np.cross(b - a, c - a)
        n /= np.linalg.norm(n)
        inside = rng.dirichlet((1, 1, 1), 30) @ np.array([a, b, c])
        d = np.cross(n, rng.normal(size=(30, 3))) + n * angle * rng.choice([-1, 1], (30, 1))
        origins = inside - d * rng.uniform(1, 30, (30, 1))
        yield Case(
            f"triangle-grazing-{angle:g}-at-{where}",
            "triangle, grazing 1e-2 … 1e-12 rad",
            Spec("Triangle", (a, b, c)),
            origins,
            d,
            0,
        )
    tiny, huge = 1e-6, 1e8
    for label, size, distance in (("tiny-far", tiny, 1e12), ("huge-near", huge, 1e-9)):
        a, b, c = rng.normal(size=(3, 3)) * size
        rays = _triangle_rays(a, b, c, rng, distance)
        yield Case(
            f"triangle-{label}", "triangle, tiny and far or huge and near", Spec("Triangle", (a, b, c)), *rays, 10
        )
    a, b, c = (0.0, 0.0, 0.0), (4.0, 1.0, 2.0), (1.0, 5.0, 3.0)
    in_plane = [
        (a, b),
        (b, c),
        ((-4, -1, -2), b),
        ((-5, -6, -5), (5.0, 6.0, 5.0)),
        (np.add(a, c), np.subtract(b, c)),
        ((9, 0, 0), (5, 6, 5)),
    ]
    yield Case(
        "triangle-ray-in-its-plane", "triangle, ray in its plane", Spec("Triangle", (a, b, c)), *_rays(in_plane), 0, 6
    )
    grid = [((x, y, z), (0, 0, -z)) for x in range(-1, 6) for y in range(-1, 6) for z in (7.0, -3.0)]
    spec = Spec("Triangle", ((0, 0, 0), (4, 0, 0), (0, 4, 0)))
    yield Case("triangle-integer-grid", "triangle, integer grid", spec, *_rays(grid), 30, 30)
    ulp = [
        ((x, y, 1.0), (0, 0, -1.0))
        for x in (-5e-324, 0.0, 5e-324, 1.0)
        for y in (-1e-310, -0.0, 2.0, np.nextafter(3.0, 9))
    ]
    yield Case("triangle-one-ulp-off-the-edge", "triangle, integer grid", spec, *_rays(ulp), 5, 5)


def fan(valence: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return a closed double fan: two apexes, each in `valence` triangles."""
    around = np.arange(valence) * (2 * np.pi / valence)
    ring = np.stack([np.cos(around), np.sin(around), 0.1 * np.cos(3 * around)], axis=1)
    i = np.arange(valence)
    j = (i + 1) % valence
    top, bottom = np.full(valence, valence), np.full(valence, valence + 1)
    faces = np.concatenate([np.stack([i, j, top], axis=1), np.stack([j, i, bottom], axis=1)])
    return np.concatenate([ring, [(0.1, 0.2, 1.0), (-0.1, 0.1, -0.8)]]), faces


def closed_meshes() -> dict[str, tuple[Floats, npt.NDArray[np.int64], Floats]]:
    """Return closed meshes about the origin, each with a point inside it."""
    import trimesh

    zero = np.zeros(3)
    tetrahedron = np.array([(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)])
    meshes = {"tetrahedron": (tetrahedron, np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)]), zero)}
    for name, mesh, inside in (
        ("box", trimesh.creation.box((2.0, 1.0, 0.5)), zero),
        ("icosphere", trimesh.creation.icosphere(subdivisions=2), zero),
        ("torus", trimesh.creation.torus(1.0, 0.4, major_sections=20, minor_sections=9), np.array((0.98, 0.17, 0.03))),
    ):
        meshes[name] = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64), inside
    for valence in (3, 4, 7, 30, 100):
        meshes[f"fan-{valence}"] = (*fan(valence), zero)
    return meshes


def leak_rays(
    vertices: Floats, faces: npt.NDArray[np.int64], inside: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return rays, of any length, from inside to each vertex, edge midpoint, point p + s·e of an edge, and centroid."""
    corners = vertices[faces]
    edges = corners[:, [1, 2, 0]] - corners
    targets = [
        vertices,
        ((corners + corners[:, [1, 2, 0]]) / 2).reshape(-1, 3),
        (corners + rng.uniform(size=(len(faces), 3, 1)) * edges).reshape(-1, 3),
        corners.mean(axis=1),
    ]
    directions = np.concatenate(targets) - inside
    directions *= 2.0 ** rng.integers(-40, 40, (len(directions), 1))
    return np.broadcast_to(inside, directions.shape).copy(), directions


def _meshes() -> Iterator[Case]:
    rng = np.random.default_rng(10)
    shapes = closed_meshes()
    for name, (offset, shift) in itertools.product(("tetrahedron", "torus", "fan-7", "fan-100"), OFFSETS.items()):
        vertices, faces, inside = shapes[name]
        vertices = vertices + shift
        inside = inside + shift
        origins, directions = leak_rays(vertices, faces, inside, rng)
        keep = rng.permutation(len(origins))[:60]
        spec = Spec("TriangleMesh", (vertices, faces))
        group = f"closed mesh at {offset} m, to vertices and edges"
        yield Case(f"mesh-{name}-inside-at-{offset}", group, spec, origins[keep], directions[keep], len(keep))
        outside = inside + rng.normal(size=(len(keep), 3)) * 4
        target = origins[keep] + directions[keep] / np.linalg.norm(directions[keep], axis=1, keepdims=True)
        yield Case(f"mesh-{name}-outside-at-{offset}", group, spec, outside, target - outside, 10)
    x, y = (g.ravel().astype(float) for g in np.meshgrid(np.arange(6), np.arange(6)))
    vertices = np.stack([x, y, np.mod(x * y, 3.0)], axis=1)
    i = (np.arange(5)[:, None] * 6 + np.arange(5)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 7], 1), np.stack([i, i + 7, i + 6], 1)])
    half = np.arange(-1, 12) / 2
    down = [((u, v, 9.0), (0, 0, -1.0)) for u in half for v in half]
    spec = Spec("TriangleMesh", (vertices, faces))
    yield Case("mesh-integer-grid-axis-parallel", "mesh, integer grid, axis-parallel rays", spec, *_rays(down), 100, 20)
    along = [((-3.0, v, w), (1.0, 0, -0.0)) for v in half for w in (0.0, 0.5, 1.0, 2.0)]
    yield Case("mesh-integer-grid-along-rows", "mesh, integer grid, axis-parallel rays", spec, *_rays(along), 20, 5)
    vertices, faces = terraces(6)
    level = [0.0, 1.0, 2.0, 5e-324, 1e-300, 1.0 + 2.0**-52]
    along = [(o, d) for z in level for o, d in _level_rays(rng, 6, z, 12)]
    spec = Spec("TriangleMesh", (vertices, faces))
    yield Case(
        "mesh-terraces-rays-in-their-planes", "mesh, rays in the planes of its parts", spec, *_rays(along), 20, 10
    )
    x, y = (g.ravel().astype(float) for g in np.meshgrid(np.arange(7), np.arange(7)))
    i = (np.arange(6)[:, None] * 7 + np.arange(6)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 8], 1), np.stack([i, i + 8, i + 7], 1)])
    for axes, angles in (("x", (30,)), ("xy", (10, 45)), ("zxy", (15, 30, 60))):
        tilt = Rotation.from_euler(axes, angles, degrees=True).as_matrix()
        floor = np.column_stack([x, y, np.zeros(len(x))])
        group = "mesh, rays in the plane of a tilted floor"
        along = [(tilt @ o, tilt @ d) for z in (0.0, 2.0**-52) for o, d in _level_rays(rng, 6, z, 30)]
        spec = Spec("TriangleMesh", (floor @ tilt.T, faces))
        yield Case(f"mesh-floor-tilted-{axes}-rays-in-its-plane", group, spec, *_rays(along), 8, 4)
        spec = Spec("TriangleMesh", (floor, faces), _affine(tilt))
        yield Case(f"mesh-floor-under-a-tilt-{axes}-rays-in-its-plane", group, spec, *_rays(along), 2, 4)
    # two coplanar triangles overlap, one twice; then zero area in three ways
    vertices = np.array([(0, 0, 0), (4, 0, 0), (0, 4, 0), (4, 4, 0), (2, 0, 0), (2, 2, 0)], dtype=float)
    faces = np.array([(0, 0, 1), (0, 4, 1), (3, 3, 3), (0, 1, 3), (0, 1, 2), (2, 0, 1), (1, 3, 2)])
    down = [((u, v, 5.0), (0, 0, -2.5)) for u in half for v in half]
    spec = Spec("TriangleMesh", (vertices, faces))
    yield Case(
        "mesh-coplanar-overlaps-and-no-area",
        "mesh, coplanar overlaps and degenerate triangles",
        spec,
        *_rays(down),
        80,
        20,
    )


def terraces(n: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return n × n flat squares of whole heights, from (0, 0) to (n, n), with a wall wherever two heights differ."""
    height = np.mod(np.add.outer(np.arange(n) // 2, np.arange(n) // 3), 3).astype(float)
    quads = []
    for i, j in itertools.product(range(n), range(n)):
        z = height[i, j]
        quads.append([(i, j, z), (i + 1, j, z), (i + 1, j + 1, z), (i, j + 1, z)])
        for k, m, a, b in ((i + 1, j, (i + 1, j), (i + 1, j + 1)), (i, j + 1, (i, j + 1), (i + 1, j + 1))):
            if k < n and m < n and height[k, m] != z:
                quads.append([(*a, z), (*b, z), (*b, height[k, m]), (*a, height[k, m])])
    corner = 4 * np.arange(len(quads))[:, None]
    faces = np.concatenate([corner + np.array([0, 1, 2]), corner + np.array([0, 2, 3])])
    return np.array(quads, dtype=float).reshape(-1, 3), faces


def _level_rays(rng: np.random.Generator, n: int, z: float, count: int) -> list[tuple[Any, Any]]:
    """Return horizontal rays at a height, along the rows of a grid, its diagonals and across."""
    places = rng.integers(-2, 2 * n + 4, (count, 2)) / 2
    ways = rng.choice([-1.0, -0.0, 0.0, 0.5, 1.0], (count, 2)) + rng.choice([0.0, 2.0**-30], (count, 1))
    zeros = rng.choice([0.0, -0.0], count)
    return [((x, y, z), (u or 1.0, v, w)) for (x, y), (u, v), w in zip(places, ways, zeros, strict=True)]


def star(points: int, rng: np.random.Generator, slope: Sequence[int] = (2, -3), size: int = 1000) -> Floats:
    """Return a simple polygon, not convex, of integer coordinates in the plane z = slope·(x, y)."""
    around = (np.arange(points) + rng.uniform(0.1, 0.9, points)) * (2 * np.pi / points)
    radius = np.where(np.arange(points) % 2, rng.uniform(0.2, 0.5, points), rng.uniform(0.7, 1, points))
    x, y = np.rint(size * radius * np.cos(around)), np.rint(size * radius * np.sin(around))
    return np.stack([x, y, slope[0] * x + slope[1] * y], axis=1)


def _polygons() -> Iterator[Case]:
    rng = np.random.default_rng(11)
    for points, (where, shift) in itertools.product((3, 4, 8, 25), (("0", 0.0), ("2^22", 2.0**22))):
        vertices = star(points, rng)
        nxt = np.roll(vertices, -1, axis=0)
        targets = np.concatenate(
            [
                vertices,
                (vertices + nxt) / 2,
                vertices + rng.uniform(size=(points, 1)) * (nxt - vertices),
                vertices * 0.3,
                vertices * 1.01,
            ]
        )
        origins = rng.normal(size=targets.shape) * 2000
        spec = Spec("Polygon", (vertices + shift,))
        name = f"polygon-{points}-at-{where}"
        yield Case(name, "polygon, to vertices and edges", spec, origins + shift, (targets - origins) * 3, points)
        level = np.rint(rng.uniform(-1000, 1000, (60, 2)))
        pairs = [((x, y, 9000.0), (0, 0, -1.0)) for x, y in [*level.tolist(), *vertices[:, :2].tolist()]]
        origins, directions = _rays(pairs)
        yield Case(f"{name}-axis-parallel", "polygon, to vertices and edges", spec, origins + shift, directions, points)
    comb = np.array(
        [(0, 0, 0), (6, 0, 0), (6, 3, 0), (5, 3, 0), (5, 1, 0), (4, 1, 0), (4, 3, 0), (2, 3, 0), (2, 1, 0), (0, 1, 0)]
    )
    half = np.arange(-1, 14) / 2
    pairs = [((u, v, 1.0), (0, 0, -1.0)) for u in half for v in half[:9]]
    yield Case(
        "polygon-comb-integer-grid",
        "polygon, to vertices and edges",
        Spec("Polygon", (comb.astype(float),)),
        *_rays(pairs),
        50,
        30,
    )


def basic_specs() -> dict[str, Spec]:
    """Return one plain sample of each kind, about a metre in size, near the origin.

    Of a shape that is not named here it is the first sample of the conformance suite.
    """
    turn = rotations(1, 12)[0]
    vertices, faces = fan(5)
    specs = {
        "plane": Spec("Plane", ((1.0, 2.0, 3.0), 0.5)),
        "sphere": Spec("Sphere", ((0.1, 0.2, 0.3), 0.9)),
        "ellipsoid": Spec("Ellipsoid", ((0.1, 0.2, 0.3), (1.2, 0.5, 0.8), turn)),
        "box": Spec("Box", ((1.5, 1.1, 0.7), (0.1, 0.2, 0.3))),
        "cylinder": Spec("Cylinder", ((0.1, 0.2, -0.6), (0.3, 0.1, 0.8), 0.7)),
        "open-cylinder": Spec("Cylinder", ((0.1, 0.2, -0.6), (0.3, 0.1, 0.8), 0.7, False)),
        "capsule": Spec("Capsule", ((0.1, 0.2, -0.4), (0.3, 0.1, 0.5), 0.6)),
        "disk": Spec("Disk", ((0.1, 0.2, 0.3), (1.0, 2.0, 3.0), 0.9)),
        "triangle": Spec("Triangle", ((1.3, 0.1, 0.2), (-0.7, 1.1, 0.1), (-0.6, -0.9, 0.4))),
        "polygon": Spec("Polygon", (star(9, np.random.default_rng(12)) / 1024,)),
        "mesh": Spec("TriangleMesh", (vertices, faces)),
    }
    known = {spec.kind for spec in specs.values()}
    for sample in reversed(SAMPLES):
        if sample.shape not in known:
            specs[sample.name] = sample.spec()
    return specs


def _scalings() -> Iterator[Case]:
    rng = np.random.default_rng(13)
    for name, spec in basic_specs().items():
        origins = rng.normal(size=(20, 3)) * 3
        towards = rng.uniform(-0.5, 0.5, (20, 3)) - origins
        axis_parallel = np.eye(3)[rng.integers(0, 3, 20)] * rng.choice([-1, 1], (20, 1))
        level = rng.uniform(-0.4, 0.4, (20, 3)) - 4 * axis_parallel
        for scale in SCALES:
            o, d = (
                np.concatenate([origins, level]),
                np.concatenate([towards, np.where(axis_parallel == 0, -0.0, axis_parallel)]),
            )
            yield Case(f"{name}-direction-times-{scale:g}", "directions times 2^k and 1e±200", spec, o, d * scale, 5)
        near = rng.uniform(-0.3, 0.3, (20, 3))
        tiny = rng.choice([0.0, -0.0, 5e-324, -1e-310, 2e-308, 1e-300], (20, 3)) + axis_parallel * 1e-307
        yield Case(f"{name}-subnormal-direction", "directions times 2^k and 1e±200", spec, near, tiny, 1)
        mixed = rng.choice([5e-324, -1e-310, 1e-200, 1.0, -1e200], (20, 3))
        yield Case(f"{name}-mixed-direction", "directions times 2^k and 1e±200", spec, near, mixed, 1)


def transforms() -> dict[str, Floats]:
    """Return affine maps: each kind that a user may give."""
    turn = rotations(2, 14)
    return {
        "turn-utm": _affine(turn[0], UTM),
        "uneven": _affine(turn[0] @ np.diag((1e3, 1.0, 1e-3)) @ turn[1]),
        "reflection": _affine(np.diag((-1.0, 1.0, 1.0)) @ turn[1], (1.0, 2.0, 3.0)),
        "mirror": _affine(np.diag((1.0, 1.0, -1.0))),
        "shear": _affine(((1.0, 0.5, 0.0), (0.0, 1.0, 0.25), (0.125, 0.0, 1.0)), (5.0, -3.0, 2.0)),
        "shrink-far": _affine(turn[1] * 1e-3, UTM),
        "thirds": _affine(np.diag((1 / 3, 1 / 7, -1 / 11)), (0.1, 0.2, 0.3)),
    }


def _transformations() -> Iterator[Case]:
    rng = np.random.default_rng(15)
    for (shape, spec), (name, matrix) in itertools.product(basic_specs().items(), transforms().items()):
        origins = rng.normal(size=(40, 3)) * 3
        directions = rng.uniform(-0.6, 0.6, (40, 3)) - origins
        linear = matrix[:3, :3]
        moved = Spec(spec.kind, spec.args, matrix)
        o, d = origins @ linear.T + matrix[:3, 3], directions @ linear.T
        yield Case(f"{shape}-transform-{name}", "through a transform", moved, o, d, 5)
