"""Many small scans at once, as robot learning makes them: one call, a loop, and other ray casters."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim._base.validation import Floats
from lidarsim.bench import motion, scenes
from lidarsim.bench.peers import CASTERS
from lidarsim.bench.scenes import Rays
from lidarsim.scan.columns import ScanColumns

ROWS = 1000
"""Number of robots."""

BEAMS = 360
"""Beams of each robot's lidar."""

SHAPES = 100
"""Number of shapes in the scene, besides a mesh."""

SIDE = 225
"""Posts of the mesh along a side: a terrain of 2·224² = 100,352 triangles."""

STEPS = 4
"""Different steps that the calls go through in turn, so that the poses are new at each call."""

PARTS = 20
"""Scans that a peer is timed with, in place of one for each robot."""


def world() -> ls.Scene:
    """Return a scene of shapes on a rough terrain, around the origin."""
    scene, draw = ls.Scene(), np.random.default_rng(3)
    spacing = 60.0 / (SIDE - 1)
    scene.add(ls.TriangleMesh.from_heightfield(draw.uniform(0.0, 0.3, (SIDE, SIDE)), spacing, origin=(-30.0, -30.0)))
    for i, (x, y, size) in enumerate(draw.uniform((-28, -28, 0.3), (28, 28, 1.2), (SHAPES, 3))):
        scene.add(
            (
                ls.Sphere((x, y, 1.0), size),
                ls.Box((size, 2.0, 2.0), center=(x, y, 1.0)),
                ls.Cylinder((x, y, 0.0), (x, y, 2.5), 0.5 * size),
                ls.Ellipsoid((x, y, 1.0), (size, 0.5, 1.0)),
            )[i % 4]
        )
    return scene


def poses(rows: int, step: int) -> Floats:
    """Return the poses of the sensors at a step: ndarray of float64, shape (rows, 4, 4)."""
    draw = np.random.default_rng(step)
    places = np.broadcast_to(np.eye(4), (rows, 4, 4)).copy()
    angles = draw.uniform((-math.pi, -0.1, -0.1), (math.pi, 0.1, 0.1), (rows, 3))
    places[:, :3, :3] = Rotation.from_euler("zyx", angles).as_matrix()
    places[:, :3, 3] = draw.uniform((-25, -25, 0.8), (25, 25, 1.5), (rows, 3))
    return places


def calls(casters: Collection[str], threads: int, rows: int = ROWS) -> motion.Calls:
    """Return the calls to time for `rows` robots, including those of the installed casters of MuJoCo geoms."""
    scene, lidar = world(), ls.Lidar(ls.patterns.Grid(np.linspace(-math.pi, math.pi, BEAMS), [0.0], rate=20.0))
    noisy = ls.Lidar(lidar.pattern, measurement=ls.Measurement(range_sigma=0.01), name="noisy")
    steps = [poses(rows, step) for step in range(STEPS)]
    rays = [_rays(lidar, places) for places in steps]
    own = np.random.default_rng(9).integers(2, 2 + SHAPES, (rows, 1))
    turn = iter(range(1 << 62))

    def step() -> int:
        return next(turn) % STEPS

    batch = lidar.scan_many(scene, steps[0], fields=["range"])
    whole = lidar.scan_many(scene, steps[0])
    cast, loop = "Scene.cast of the same rays", "a loop of Lidar.scan"
    what: motion.Calls = {
        cast: (cast, lambda: scene.cast(*rays[step()])),
        "scan_many, ranges": (cast, lambda: lidar.scan_many(scene, steps[step()], out=batch)),
        "scan_many, ranges, one shape ignored in each row": (
            "scan_many, ranges",
            lambda: lidar.scan_many(scene, steps[step()], out=batch, ignore=own),
        ),
        "scan_many, the default arrays": (cast, lambda: lidar.scan_many(scene, steps[step()], out=whole)),
        "scan_many, the default arrays, range noise": (cast, lambda: noisy.scan_many(scene, steps[step()], out=whole)),
        loop: (loop, lambda: [lidar.scan(scene, pose) for pose in steps[step()]]),
        "scan_many, all arrays of the loop": (
            loop,
            lambda: lidar.scan_many(scene, steps[step()], fields=_ARRAYS),
        ),
    }
    geoms = scenes.analytic(SHAPES)
    rebuilt = ls.Scene()
    for spec in geoms.shapes:
        rebuilt.add(spec.build())
    here = np.tile(np.eye(4), (rows, 1, 1))
    here[:, :3, 3] = geoms.sensor
    ranges = lidar.scan_many(rebuilt, here, fields=["range"])
    known = f"scan_many, ranges, {SHAPES} geoms from one place"
    what[known] = known, lambda: lidar.scan_many(rebuilt, here, out=ranges)
    for name in casters:
        if name.startswith("MuJoCo"):
            what[f"{name}, the same"] = known, _peer(name, geoms, threads, lidar)
    return what


_ARRAYS = tuple(name for name, column in ScanColumns._columns.items() if not column.condition)
"""The arrays that every `Scan` has."""


def _rays(lidar: ls.Lidar, places: Floats) -> tuple[Floats, Floats]:
    """Return origins and directions of all beams in the world."""
    directions = np.einsum("nij,bj->nbi", places[:, :3, :3], lidar.pattern.pulses().directions)
    origins = np.repeat(places[:, None, :3, 3], directions.shape[1], axis=1)
    return origins.reshape(-1, 3), np.ascontiguousarray(directions).reshape(-1, 3)


def _peer(name: str, geoms: scenes.World, threads: int, lidar: ls.Lidar) -> Callable[[], Any]:
    """Return a call of `PARTS` scans by a peer."""
    caster = CASTERS[name](geoms, threads)
    directions: npt.NDArray[np.float64] = np.ascontiguousarray(lidar.pattern.pulses().directions)
    rays = caster.prepare(Rays("ring", np.tile(geoms.sensor, (len(directions), 1)), directions, one_origin=True))
    return lambda: [caster.cast(rays, threads) for _ in range(PARTS)]


def over(times: dict[str, float], what: motion.Calls, rows: int = ROWS) -> list[dict[str, Any]]:
    """Return the rows of `motion.over`; the times of peers are scaled to `rows` robots."""
    scales = {name: rows / PARTS if name.startswith("MuJoCo") else 1.0 for name in times}
    return motion.over({name: scales[name] * time for name, time in times.items()}, what)
