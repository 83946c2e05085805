"""The cost of motion and of changes: scans of moving scenes and of the same scenes at rest, in turns."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

import lidarsim as ls
from lidarsim._base.validation import Floats
from lidarsim.patterns import Pattern

Calls = dict[str, tuple[str, Callable[[], Any]]]
"""By the name of each call: the name of the call to compare it with, and the call to time."""

SPEED = 15.0
"""Speed of moving sensors and objects, m/s."""

OBJECTS = 3200
"""Number of objects of the scene in which one object is moved."""

PERIOD = 0.1
"""Period of a frame, s."""


def instances(count: int, *, moving: bool) -> ls.Scene:
    """Return a ground plane and instances of one mesh around the origin, at rest or each with its own motion.

    In the middle of the first frame, moving ones are at the poses of those at rest.
    """
    import trimesh

    scene, draw = ls.Scene(), np.random.default_rng(7)
    scene.add(ls.Plane((0, 0, 1), -2.0))
    mesh = ls.TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=3, radius=1.0))
    for place, heading in zip(draw.uniform(-80, 80, (count, 2)), draw.uniform(-math.pi, math.pi, count), strict=True):
        cos, sin = math.cos(heading), math.sin(heading)
        pose = np.array([[cos, -sin, 0, place[0]], [sin, cos, 0, place[1]], [0, 0, 1, -1.0], [0, 0, 0, 1]])
        if moving:
            back = np.eye(4)
            back[0, 3] = -SPEED * PERIOD / 2.0
            scene.add(mesh, motion=ls.Trajectory.from_twist(pose @ back, (SPEED, 0, 0), (0, 0, 0.2)))
        else:
            scene.add(mesh, transform=pose)
    return scene


def calls(scene: ls.Scene, place: Floats, pattern: Pattern) -> Calls:
    """Return the calls to time: the sensor starts at `place` and drives through a static scene."""
    lidar, still = ls.Lidar(pattern), np.eye(4)
    still[:3, 3] = place
    drive = ls.Trajectory.from_twist(still, (SPEED, 0, 0), (0, 0, 0.2))
    pulses, crowds = pattern.pulses(), [instances(1000, moving=moving) for moving in (False, True)]
    rays, times = (pulses.origins + place, pulses.directions), pulses.time
    changing, where, ray = instances(OBJECTS, moving=False), np.eye(4), ([[0.0, 0.0, 9.0]], [[0.0, 0.0, -1.0]])

    def build() -> ls.Hits:
        built = ls.Scene()
        for item in changing:
            built.add(item.shape, transform=item.transform)
        return built.cast(*ray)

    def change() -> ls.Hits:
        where[2, 3] += 0.001
        changing.update(OBJECTS // 2, transform=where)
        return changing.cast(*ray)

    compared: list[tuple[str, Callable[[], Any], str, Callable[[], Any]]] = [
        (
            "a still sensor, point_cloud",
            lambda: lidar.scan(scene, still).point_cloud(),
            "a moving sensor, point_cloud",
            lambda: lidar.scan(scene, drive).point_cloud(),
        ),
        (
            "1,000 still instances",
            lambda: lidar.scan(crowds[0]),
            "1,000 moving instances",
            lambda: lidar.scan(crowds[1]),
        ),
        (
            "cast at what stands still",
            lambda: scene.cast(*rays),
            "the same with a time for each ray",
            lambda: scene.cast(*rays, time=times),
        ),
        (f"{OBJECTS:,} objects built anew, one ray", build, f"one of {OBJECTS:,} objects moved, one ray", change),
    ]
    what: Calls = {}
    for base, known, name, call in compared:
        what |= {base: (base, known), name: (base, call)}
    return what


def unpaired(what: Calls) -> dict[str, Callable[[], Any]]:
    """Return the calls to time without those that they are compared with."""
    return {name: call for name, (_, call) in what.items()}


def over(times: dict[str, float], what: Calls) -> list[dict[str, Any]]:
    """Return a row per call, with its time and its ratio to the call that it is compared with."""
    return [
        {"what": name, "over": base, "seconds": times[name], "ratio": times[name] / times[base]}
        for name, (base, _) in what.items()
    ]
