"""Textbook formulas for rays and solids in plain float64: the baseline to beat.

They are correct in exact arithmetic and written as they are usually taught, without care for rounding: the general
quadratic formula, whose difference cancels, and a plane by its rounded distance from the origin. Two common slips of
lecture notes are corrected:

- The constant term of the sphere's quadratic is (o − c)·(o − c) − r², sometimes written 2(o − c) − r² (a vector minus a
  number, which has no meaning).
- The equation of a cylinder's side is |p − c|² = r² across the axis, sometimes written = 0 (which is the axis alone).

Each function takes origins and directions of shape (n, 3), with directions of any length, and the arguments of
lidarsim's constructor. It returns every t at which the line meets the surface, (n, k), ascending and padded with NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def dot(a: Floats, b: Floats) -> Floats:
    """Return the dot products of vectors along the last axis."""
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product


def quadratic(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return the roots of a·t² + b·t + c by (−b ± √(b² − 4ac)) / 2a, (n, 2)."""
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - 4 * a * c)
        return np.stack([(-b - root) / (2 * a), (-b + root) / (2 * a)], axis=-1)


def plane(origins: Floats, directions: Floats, normal: Any, distance: float) -> Floats:
    """Return t = (d − n·o) / (n·v) of the plane n·p = d."""
    n = np.asarray(normal, dtype=np.float64)
    slope = directions @ n
    with np.errstate(all="ignore"):
        return np.where(slope == 0, np.nan, (distance - origins @ n) / slope)[:, None]


def plane_through(origins: Floats, directions: Floats, point: Any, normal: Any) -> Floats:
    """Return t for the plane n·p = n·point."""
    return plane(origins, directions, normal, float(np.dot(normal, point)))


def sphere(origins: Floats, directions: Floats, center: Any, radius: float) -> Floats:
    """Return the roots of (v·v) t² + 2 v·(o − c) t + (o − c)·(o − c) − r² = 0."""
    f = origins - np.asarray(center, dtype=np.float64)
    return quadratic(dot(directions, directions), 2 * dot(directions, f), dot(f, f) - radius * radius)


def ellipsoid(origins: Floats, directions: Floats, center: Any, radii: Any, rotation: Any = None) -> Floats:
    """Return the roots for the unit sphere, to which the inverse map takes the ellipsoid and the ray."""
    axes = np.eye(3) if rotation is None else np.asarray(getattr(rotation, "as_matrix", lambda: rotation)())
    inverse = np.linalg.inv(axes * np.asarray(radii, dtype=np.float64))
    return sphere(
        (origins - np.asarray(center, dtype=np.float64)) @ inverse.T, directions @ inverse.T, np.zeros(3), 1.0
    )


def box(origins: Floats, directions: Floats, size: Any, center: Any = (0.0, 0.0, 0.0)) -> Floats:
    """Return entry and exit of the slabs |p − center| ≤ size / 2, dividing by each component of the direction."""
    f, half = origins - np.asarray(center, dtype=np.float64), np.asarray(size, dtype=np.float64) / 2
    with np.errstate(all="ignore"):
        bounds = np.stack([(-half - f) / directions, (half - f) / directions])
        entry, leave = bounds.min(axis=0).max(axis=-1), bounds.max(axis=0).min(axis=-1)
        return np.where((entry <= leave)[:, None], np.stack([entry, leave], axis=-1), np.nan)


def cylinder(  # noqa: PLR0917
    origins: Floats, directions: Floats, start: Any, end: Any, radius: float, capped: bool = True
) -> Floats:
    """Return the roots of |(p − s) − ((p − s)·a) a|² = r² between the ends (a: unit axis), and those of the caps."""
    s, e = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    height = float(np.linalg.norm(e - s))
    axis = (e - s) / height
    f = origins - s
    fz, dz = f @ axis, directions @ axis
    across, along = f - fz[:, None] * axis, directions - dz[:, None] * axis
    t = quadratic(dot(along, along), 2 * dot(across, along), dot(across, across) - radius * radius)
    with np.errstate(all="ignore"):
        z = fz[:, None] + t * dz[:, None]
        t = np.where((z >= 0) & (z <= height), t, np.nan)
        if capped:
            caps = (np.array([0.0, height]) - fz[:, None]) / dz[:, None]
            point = across[:, None, :] + caps[:, :, None] * along[:, None, :]
            caps = np.where(dot(point, point) <= radius * radius, caps, np.nan)
            t = np.concatenate([t, caps], axis=1)
    return np.sort(t, axis=1)[:, :2]


#: The formula of each shape, by the name of its class or constructor.
FORMULAS: dict[str, Callable[..., Floats]] = {
    "Box": box,
    "Cylinder": cylinder,
    "Ellipsoid": ellipsoid,
    "Plane": plane,
    "Plane.from_point": plane_through,
    "Sphere": sphere,
}
