"""Random shapes, and rays aimed at where the decisions about them are close."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from conformance.samples import SAMPLES, Move
from exact import cases, oracle

__all__ = ["KINDS", "random_case"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Aim:
    """Targets and directions through them, before an origin is chosen; `unit` is the step of the lattice."""

    spec: cases.Spec
    targets: Floats
    directions: Floats
    unit: float


def random_case(rng: np.random.Generator, kind: str, rays: int = 100) -> cases.Case:
    """Return a random case of `kind`: adversarial targets, any offset and scale; every third on a lattice."""
    lattice = bool(rng.random() < 0.3)
    size = float(2.0 ** rng.integers(-12, 12)) if lattice else float(10 ** rng.uniform(-4, 4))
    offset = np.zeros(3) if rng.random() < 0.4 else rng.normal(size=3) * 10 ** rng.uniform(0, 9) * size
    center = np.rint(rng.uniform(-4, 4, 3)) * size if lattice else offset
    aim = MAKERS.get(kind, _random_sample)(rng, kind, rays, size, center, lattice=lattice)
    if lattice:
        target = np.rint(aim.targets / aim.unit) * aim.unit
        d = np.rint(rng.uniform(-3, 3, (rays, 3))) if rng.random() < 0.7 else np.eye(3)[rng.integers(0, 3, rays)]
        d = np.where(d.any(axis=1, keepdims=True), d, (1.0, 0.0, 0.0)) * aim.unit
        origins = target - d * rng.integers(-4, 9, (rays, 1))
    else:
        reach = 10 ** rng.uniform(-6, 6, (rays, 1)) * rng.choice(
            [1.0, 1.0, -1.0, 0.0], (rays, 1), p=(0.4, 0.4, 0.1, 0.1)
        )
        origins = aim.targets - aim.directions * reach
        aimed = aim.targets - origins
        d = np.where((rng.random((rays, 1)) < 0.5) & aimed.any(axis=1, keepdims=True), aimed, aim.directions)
    spec = aim.spec
    if rng.random() < 0.25:
        matrix = cases.transforms()["mirror"] if lattice else list(cases.transforms().values())[rng.integers(7)]
        linear = matrix[:3, :3]
        spec = cases.Spec(spec.kind, spec.args, matrix)
        origins, d = origins @ linear.T + matrix[:3, 3], d @ linear.T
    d = np.where(d.any(axis=1, keepdims=True), d, (1.0, 0.0, 0.0))
    if rng.random() < 0.2:
        d = d / np.abs(d).max(axis=1, keepdims=True) * 2.0 ** rng.integers(-500, 500)
    return cases.Case(
        f"random {kind}", f"random, {kind}", spec, np.ascontiguousarray(origins), np.ascontiguousarray(d), 0
    )


def _units(rng: np.random.Generator, n: int) -> Floats:
    v = rng.normal(size=(n, 3))
    unit: Floats = v / np.linalg.norm(v, axis=1, keepdims=True)
    return unit


def _near_one(rng: np.random.Generator, n: int) -> Floats:
    """Return (n, 1) factors, most of which crowd around 1: 1 ± 2^−k."""
    one = 1 + rng.choice([-1.0, 1.0], (n, 1)) * 2.0 ** -rng.integers(1, 56, (n, 1))
    return np.where(rng.random((n, 1)) < 0.3, rng.uniform(0, 1.1, (n, 1)), one)


def _random_plane(rng: np.random.Generator, _kind: str, n: int, size: float, center: Floats, *, lattice: bool) -> _Aim:
    normal = np.rint(rng.uniform(-4, 4, 3)) if lattice else rng.normal(size=3) * 10.0 ** rng.integers(-6, 6)
    normal = normal if normal.any() else np.array((0.0, 0.0, 1.0))
    along = np.cross(normal, rng.normal(size=(n, 3)))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    d = along + normal * 10.0 ** rng.uniform(-18, 0, (n, 1)) * rng.choice([-1.0, 1.0], (n, 1))
    legs = np.array(((1.0, 0.0, 2.0), (0.0, 3.0, -1.0))) if lattice else along[:2]
    spec = (
        cases.Spec("Plane", (normal, float(normal @ center))),
        cases.Spec("Plane.from_point", (center, normal)),
        cases.Spec("Plane.from_points", (center, center + legs[0] * size, center + legs[1] * size)),
    )[rng.integers(3)]
    return _Aim(spec, center + along * size, d, size / 2)


def _random_solid(rng: np.random.Generator, kind: str, n: int, size: float, center: Floats, *, lattice: bool) -> _Aim:
    def lengths(count: int) -> Floats:
        return size * np.asarray(2.0 ** rng.integers(-3, 4, count) if lattice else 10 ** rng.uniform(-3, 3, count))

    turn = np.eye(3) if lattice else cases.rotations(1, int(rng.integers(1 << 30)))[0]
    match kind:
        case "Sphere":
            linear = np.eye(3) * size * 5
            spec = cases.Spec(kind, (center, size * 5))
        case "Ellipsoid":
            radii = lengths(3)
            linear = turn * radii
            spec = cases.Spec(kind, (center, radii, turn))
        case "Box":
            half = lengths(3)
            linear = np.diag(half)
            spec = cases.Spec(kind, (2 * half, center))
        case _:
            radius, half_height = (5 * size, 4 * size) if lattice else lengths(2)
            linear = turn * np.array((radius, radius, half_height))
            axis = linear[:, 2]
            spec = cases.Spec(kind, (center - axis, center + axis, float(radius), bool(rng.integers(2))))
    target, d = _solid_targets(rng, kind, n)
    return _Aim(spec, target @ linear.T + center, d @ linear.T, size / 2)


def _solid_targets(rng: np.random.Generator, kind: str, n: int) -> tuple[Floats, Floats]:
    """Return points of, and directions nearly tangent to or through, the unit ball, [−1, 1]³ or the cylinder in it."""
    u = _units(rng, n)
    if kind in {"Sphere", "Ellipsoid"}:
        v = np.cross(u, _units(rng, n))
        return _near_one(rng, n) * v / np.linalg.norm(v, axis=1, keepdims=True), u
    if kind == "Box":
        target = rng.choice([-1.0, 1.0, 0.0], (n, 3))
        target = np.where(rng.random((n, 3)) < 0.25, rng.uniform(-1, 1, (n, 3)), target)
        return target, np.where(rng.random((n, 1)) < 0.3, np.eye(3)[rng.integers(0, 3, n)], u)
    around, zero = rng.uniform(0, 2 * np.pi, (n, 1)), np.zeros((n, 1))
    radial = np.concatenate([np.cos(around), np.sin(around), zero], axis=1)
    tangent = np.concatenate([-np.sin(around), np.cos(around), zero], axis=1)
    axis = np.array((0.0, 0.0, 1.0))
    rim = rng.choice([-1.0, 1.0], (n, 1)) * _near_one(rng, n)
    z = np.where(rng.random((n, 1)) < 0.5, rim, rng.uniform(-1, 1, (n, 1)))
    parts = ((radial, (0.0, 1.0, 1e-9)), (tangent, (0.0, 1.0)), (axis, (0.0, 1.0, 1e-7)))
    d = sum(rng.choice(weights, (n, 1)) * part for part, weights in parts)
    return radial * _near_one(rng, n) + z * axis, np.where(np.any(d, axis=1, keepdims=True), d, axis)


def _random_capsule(rng: np.random.Generator, kind: str, n: int, size: float, center: Floats, *, lattice: bool) -> _Aim:
    """Aim at the side and its seams as at those of a cylinder, or where lines nearly touch the ball around an end."""
    half, radius = (
        size * (np.array((0.0, 0.0, 4.0)) if lattice else _units(rng, 1)[0] * 10 ** rng.uniform(-3, 3)),
        5 * size,
    )
    axis = half / np.linalg.norm(half)
    across = np.cross(axis, (1.0, 0.0, 0.0) if lattice else rng.normal(size=3))
    across /= np.linalg.norm(across)
    turn = np.stack([across, np.cross(axis, across), axis], axis=1)
    on_side, along_side = _solid_targets(rng, "Cylinder", n)
    linear = turn * (radius, radius, np.linalg.norm(half))
    on_ball, past_ball = _solid_targets(rng, "Sphere", n)
    is_end = rng.random((n, 1)) < 0.5
    target = np.where(is_end, radius * on_ball + rng.choice([-1.0, 1.0], (n, 1)) * half, on_side @ linear.T)
    d = np.where(is_end, radius * past_ball, along_side @ linear.T)
    return _Aim(cases.Spec(kind, (center - half, center + half, radius)), center + target, d, size / 2)


def _random_disk(rng: np.random.Generator, kind: str, n: int, size: float, center: Floats, *, lattice: bool) -> _Aim:
    """Aim near the rim, from all sides and nearly within the plane."""
    normal = np.rint(rng.uniform(-4, 4, 3)) if lattice else rng.normal(size=3) * 10.0 ** rng.integers(-6, 6)
    normal = normal if normal.any() else np.array((0.0, 0.0, 1.0))
    out = np.cross(normal, rng.normal(size=(n, 3)))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    upward = normal / np.linalg.norm(normal) * 10.0 ** rng.uniform(-15, 0, (n, 1)) * rng.choice([-1.0, 1.0], (n, 1))
    along = rng.choice([-1.0, 0.0, 1.0], (n, 1)) * np.cross(upward, out) / np.linalg.norm(upward, axis=1, keepdims=True)
    d = np.where(rng.random((n, 1)) < 0.3, _units(rng, n), out * rng.choice([-1.0, 0.0, 1.0], (n, 1)) + along + upward)
    spec = cases.Spec(kind, (center, normal, 5 * size))
    return _Aim(spec, center + 5 * size * _near_one(rng, n) * out, d * size, size / 2)


def _random_many(rng: np.random.Generator, kind: str, n: int, size: float, center: Floats, *, lattice: bool) -> _Aim:
    """Aim at one of many as at one alone."""
    one = kind.removesuffix("s")
    aim = MAKERS[one](rng, one, n, size, center, lattice=lattice)
    return replace(aim, spec=cases.among_others(aim.spec))


def _random_facets(rng: np.random.Generator, kind: str, n: int, size: float, center: Floats, *, lattice: bool) -> _Aim:
    unit = size / 2
    if kind == "Triangle":
        corners = np.rint(rng.uniform(-4, 4, (3, 3))) * size if lattice else rng.normal(size=(3, 3)) * size
        if not lattice and rng.random() < 0.4:  # a sliver
            side = rng.random() * (corners[1] - corners[0])
            corners[2] = corners[0] + side + rng.normal(size=3) * size * 10 ** rng.uniform(-12, 0)
        corners = corners + center
        if not np.cross(corners[1] - corners[0], corners[2] - corners[0]).any():
            corners = center + np.array([(0, 0, 0), (4, 0, 1), (0, 2, 0)]) * size
        spec = cases.Spec(kind, tuple(corners))
    elif kind == "Polygon":  # exactly planar, so of integers times a power of two
        unit = 2.0 ** float(np.rint(np.log2(size)))
        points = 6 if lattice else int(rng.integers(3, 12))
        corners = cases.star(
            points,
            np.random.default_rng(3) if lattice else rng,
            rng.integers(-3, 4, 2).tolist(),
            16 if lattice else 1000,
        )
        corners = corners * unit
        spec = cases.Spec(kind, (corners,))
    else:
        corners, faces = cases.fan(int(rng.integers(3, 12)))
        corners = corners + rng.normal(size=corners.shape) * 0.1
        corners = (np.rint(corners * 4) if lattice else corners) * size + center
        spec = cases.Spec(kind, (corners, faces))
    i, j, k = rng.integers(0, len(corners), (3, n))
    s = np.where(rng.random((n, 1)) < 0.4, rng.uniform(0, 1, (n, 1)), rng.choice([0.0, 0.5, 1.0], (n, 1)))
    inward = np.where(rng.random((n, 1)) < 0.6, 0.0, rng.uniform(0, 0.5, (n, 1)))
    target = corners[i] + s * (corners[(i + 1) % len(corners)] - corners[i])
    target = target + inward * (corners[k] - target)
    extent = np.ptp(corners)
    across = corners[j] - corners[i] + 10.0 ** rng.uniform(-15, 0, (n, 1)) * _units(rng, n) * extent
    d = np.where(rng.random((n, 1)) < 0.4, across, _units(rng, n) * extent)
    return _Aim(spec, target, d, unit)


def _random_sample(rng: np.random.Generator, kind: str, n: int, size: float, center: Floats, *, lattice: bool) -> _Aim:
    """Aim at a sample of the conformance suite, in part where lines that meet it border on lines that miss it."""
    samples = [sample for sample in SAMPLES if sample.shape == kind]
    size = 2.0 ** float(np.rint(np.log2(size)))  # so that a sample is moved exactly
    center = np.rint(center / size * 64) * size / 64
    spec = samples[rng.integers(len(samples))].spec(Move(scale=size, shift=center))
    judge, d = spec.judge(), _units(rng, n) * size
    near, far = (center + reach * size * rng.uniform(-1, 1, (n, 3)) for reach in (0.5, 3))
    for i, halvings in enumerate(rng.integers(0, 56, n)):
        for _ in range(halvings):
            middle = (near[i] + far[i]) / 2
            met = judge.crossings(oracle.Ray.of(middle.tolist(), d[i].tolist()))
            (near if met else far)[i] = middle
    return _Aim(spec, np.where(rng.random((n, 1)) < 0.7, near, far), d, size / 64 if lattice else size)


#: What aims at each kind of shape; `_random_sample` at all others.
MAKERS: dict[str, Callable[..., _Aim]] = {
    "Plane": _random_plane,
    "Sphere": _random_solid,
    "Ellipsoid": _random_solid,
    "Box": _random_solid,
    "Cylinder": _random_solid,
    "Capsule": _random_capsule,
    "Disk": _random_disk,
    "Spheres": _random_many,
    "Disks": _random_many,
    "Triangle": _random_facets,
    "Polygon": _random_facets,
    "TriangleMesh": _random_facets,
}
KINDS = tuple(dict.fromkeys([*MAKERS, *(sample.shape for sample in SAMPLES)]))
