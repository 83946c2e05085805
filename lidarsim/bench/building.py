"""The cost of building a scene relative to one scan of it, as in pipelines that draw a new scene for each frame."""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

import lidarsim as ls
from lidarsim._base.validation import Floats
from lidarsim.bench import scenes

OBJECTS = 50
"""Number of objects of a scene, without its ground."""

SENSOR = "velodyne-hdl32e"

Drawn = tuple[type[ls.Shape], tuple[Any, ...], int, float, Floats | None]
"""Class of a shape, its arguments, label, reflectivity and transform."""


def rows(count: int, rounds: int) -> list[dict[str, Any]]:
    """Time building random scenes and scanning each once; the first scan builds the hierarchy.

    Parameters
    ----------
    count : int
        Number of scenes. They hold spheres, boxes, cylinders and ellipsoids over a plane, all with a label and a
        material and every third with a transform.
    rounds : int
        Repetitions; the median counts.

    Returns
    -------
    list of dict
        For a scan, and for a scan with its point cloud: `what`, `scenes`, `objects`, `rays` of a scan, the mean times
        `build` and `scan` of a scene, s, and `share`, the share of building in their sum.
    """
    drawn = [_draw(seed) for seed in range(count)]
    lidar, pose = ls.Lidar.preset(SENSOR), np.eye(4)
    pose[2, 3] = 2.0
    found = []
    for what in ("scan", "scan and point_cloud"):
        times = []
        for _ in range(rounds):
            build = scan = 0.0
            for objects in drawn:
                begin = time.perf_counter()
                scene = _build(objects)
                built = time.perf_counter()
                taken = lidar.scan(scene, pose, seed=1)
                if what != "scan":
                    taken.point_cloud()
                scan += time.perf_counter() - built
                build += built - begin
            times.append((build / count, scan / count))
        build, scan = (statistics.median(column) for column in zip(*times, strict=True))
        rays = len(lidar.pattern.pulses().time)
        size = {"scenes": count, "objects": OBJECTS, "rays": rays}
        found.append({"what": what, **size, "build": build, "scan": scan, "share": build / (build + scan)})
    return found


def _draw(seed: int) -> list[Drawn]:
    """Return the arguments of the objects of a scene, without its ground."""
    rng, drawn = np.random.default_rng(seed), []
    for k, spec in enumerate(scenes.analytic(OBJECTS, seed=seed).shapes[1:]):
        transform = None
        if k % 3 == 0:
            transform = np.eye(4)
            transform[:2, 3] = rng.uniform(-5.0, 5.0, 2)
        drawn.append((getattr(ls, spec.kind), spec.args, k % 20, float(rng.uniform(0.05, 0.9)), transform))
    return drawn


def _build(objects: list[Drawn]) -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((0.0, 0.0, 1.0), 0.0), label=40)
    for shape, arguments, label, reflectivity, transform in objects:
        material = ls.Material(reflectivity=reflectivity)
        scene.add(shape(*arguments), label=label, material=material, transform=transform)
    return scene
