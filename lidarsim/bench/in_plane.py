"""Rays that lie in the plane of a surface: a lidar that looks along a flat floor or slope from its very height."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import lidarsim as ls
from lidarsim._base.validation import Floats

RAYS = 541
"""Rays of a turn, as of a 2D lidar."""

POSTS = 100
"""Posts of the mesh along a side."""

CORNERS = 5000
"""Corners of the polygon."""

COLLAPSED = 20_000
"""Triangles without an area."""

ABOVE = 0.5
"""Height above the plane at which the same rays are cast for comparison, m."""

TINY = 1e-300
"""Height of rays that are parallel to the plane and next to it, m."""

LEVEL = np.eye(3)

TILTED = np.array([[1, 0, 0], [0, np.sqrt(0.75), -0.5], [0, 0.5, np.sqrt(0.75)]])
"""A rotation by 30°, which leaves rays and vertices in one plane only up to rounding."""


def rays(height: float) -> tuple[Floats, Floats]:
    """Return origins and directions of horizontal rays all around, at a height, m: each of shape (n, 3)."""
    around = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    directions = np.column_stack([np.cos(around), np.sin(around), np.zeros(RAYS)])
    return np.tile((0.3, 0.17, height), (RAYS, 1)), directions


def worlds() -> dict[str, tuple[ls.Scene, Floats]]:
    """Return scenes by name; the surface of each lies in the plane z = 0, rotated by the given matrix."""
    half = POSTS / 2.0
    mesh = ls.TriangleMesh.from_heightfield(np.zeros((POSTS, POSTS)), 1.0, origin=(-half, -half))
    heights = np.maximum(0.0, np.outer(np.sin(np.arange(POSTS) / 8.0), np.sin(np.arange(POSTS) / 9.0))).round(2)
    around = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    radius = 10.0 + 2.0 * np.sin(40.0 * around)
    outline = np.column_stack([radius * np.cos(around), radius * np.sin(around), np.zeros(CORNERS)])
    along = np.column_stack([np.linspace(-half, half, COLLAPSED + 1), np.zeros((COLLAPSED + 1, 2))])
    i = np.arange(COLLAPSED)
    turned = np.array([[0, -1, 0, 0.25], [1, 0, 0, -0.5], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(1.0, 0.5, 0.0))
    hills = ls.TriangleMesh.from_heightfield(heights, 1.0, origin=(-half, -half))
    tilt = np.eye(4)
    tilt[:3, :3] = TILTED
    parts: dict[str, tuple[ls.Shape, dict[str, Any], Floats]] = {
        "plane": (ls.Plane((0, 0, 1), 0.0), {}, LEVEL),
        "box": (ls.Box((2.0 * half, 2.0 * half, 1.0), center=(0.0, 0.0, -0.5)), {}, LEVEL),
        "flat mesh": (mesh, {}, LEVEL),
        "flat mesh, turned and shifted": (mesh, {"transform": turned}, LEVEL),
        "flat mesh that moves": (mesh, {"motion": drive}, LEVEL),
        "height field with flat parts": (hills, {}, LEVEL),
        f"polygon of {CORNERS:,} corners": (ls.Polygon(outline), {}, LEVEL),
        f"{COLLAPSED:,} triangles without an area": (
            ls.TriangleMesh(along, np.column_stack([i, i + 1, i])),
            {},
            LEVEL,
        ),
        "flat mesh with tilted vertices": (ls.TriangleMesh(mesh.vertices @ TILTED.T, mesh.faces), {}, TILTED),
        "hills with tilted vertices": (ls.TriangleMesh(hills.vertices @ TILTED.T, hills.faces), {}, TILTED),
        "flat mesh under a tilt": (mesh, {"transform": tilt}, TILTED),
        "hills under a tilt": (hills, {"transform": tilt}, TILTED),
        "flat mesh that moves under a tilt": (mesh, {"transform": tilt, "motion": drive}, TILTED),
    }
    found = {}
    for name, (shape, options, rotation) in parts.items():
        scene = ls.Scene()
        scene.add(shape, **options)
        found[name] = (scene, rotation)
    return found


def calls() -> dict[str, Callable[[], Any]]:
    """Return the casts to time: by scene, at the height of the plane, next to it and above it."""
    heights = {"in the plane": 0.0, "next to it": TINY, "above": ABOVE}
    given = {where: rays(height) for where, height in heights.items()}
    what: dict[str, Callable[[], Any]] = {}
    for name, (scene, rotation) in worlds().items():
        for where, (origins, directions) in given.items():
            what[f"{name}; {where}"] = partial(scene.cast, origins @ rotation.T, directions @ rotation.T)
    return what


def over(times: dict[str, float]) -> list[dict[str, Any]]:
    """Return a row per scene, of the times of the calls, s.

    It has the time of the rays above the plane, s, and the times of those in it and next to it divided by that.
    """
    names = dict.fromkeys(name.split("; ")[0] for name in times)
    return [
        {
            "what": name,
            "seconds": times[f"{name}; above"],
            "in_plane": times[f"{name}; in the plane"] / times[f"{name}; above"],
            "next": times[f"{name}; next to it"] / times[f"{name}; above"],
        }
        for name in names
    ]
