"""The cost of labelled frames beside that of their scans: what a data set computes besides."""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np

import lidarsim as ls
from lidarsim.bench.motion import Calls
from lidarsim.datasets.layouts import Files, layout_of
from lidarsim.datasets.recipe import Function, Recipe
from lidarsim.datasets.sampling import samples
from lidarsim.datasets.splits import Splits
from lidarsim.datasets.store import open_store

LAYOUTS = ("kitti", "nuscenes", "openpcdet", "shards")
"""Layouts of which a frame is written."""

MOVERS = 16
"""Number of cars that drive along the street, and of people who walk there."""

CLASSES = [10, 18, 30, 31]
"""Labels of the instances with boxes: cars, lorries, people and riders."""

PERIOD = 0.1
"""Period of a frame, s."""


def street() -> ls.Scene:
    """Return a street in which cars drive and people walk, as many of each, along x."""
    scene, draw = ls.worlds.street(1).scene, np.random.default_rng(7)
    for k in range(MOVERS):
        heading, share = math.pi * (k % 2), k / MOVERS - 0.5
        cos, sin = math.cos(heading), math.sin(heading)
        place = np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        for asset, span, aside, speed in (
            (ls.worlds.vehicle("saloon", draw), 120.0, 2.0, 8.0),
            (ls.worlds.pedestrian(draw, posture="walking"), 60.0, 6.0, 1.4),
        ):
            place[:2, 3] = share * span, -aside * cos
            asset.add_to(scene, motion=ls.Trajectory.from_twist(place, (speed, 0, 0), (0, 0, 0.05)))
    return scene


def calls(files: ExitStack) -> Calls:
    """Return the calls to time, each of which takes the next of some frames; `files` removes what they write."""
    scene, lidar, start = street(), ls.Lidar.preset("velodyne-hdl64e-s3"), np.eye(4)
    start[2, 3] = 1.73
    drive, turn = ls.Trajectory.from_twist(start, (8, 0, 0), (0, 0, 0.1)), itertools.cycle(range(4))

    def scan() -> ls.Scan:
        frame = next(turn)
        return lidar.scan(scene, drive, time=frame * PERIOD, frame=frame)

    known, base = scan(), "Lidar.scan"
    what: Calls = {
        base: (base, scan),
        "Scan.point_cloud": (base, known.point_cloud),
        "Scan.point_cloud, deskewed with movers": (base, lambda: known.point_cloud(deskew=True, deskew_movers=True)),
        "Scan.boxes": (base, lambda: known.boxes(deskew=True)),
        "Scan.boxes, of cars and people with 5 points": (
            base,
            lambda: known.boxes(deskew=True, min_points=5, labels=CLASSES),
        ),
    }
    for layout in LAYOUTS:
        what[f"a labelled frame, {layout}"] = base, _frame(layout, scene, lidar, drive, files)
    return what


def _frame(layout: str, scene: ls.Scene, lidar: ls.Lidar, drive: ls.Trajectory, files: ExitStack) -> Callable[[], None]:
    """Return a call that scans the next frame of a data set and writes it."""
    boxes = {"classes": CLASSES, "min_points": 5}
    source = Function(lambda *_: (scene, lidar, drive), 4, 0, {}, {"frame": "sensor", "deskew": "start"})
    kind = layout_of({"type": layout, "boxes": boxes})
    recipe = Recipe(source, 1, 4, 0, 4, kind, dict(scene.class_names), Splits({}))
    run, turn = source.run(0), itertools.cycle(range(4))
    store = files.enter_context(open_store(files.enter_context(tempfile.TemporaryDirectory())).batch())
    write = files.enter_context(kind.writer(Files(store), 0))

    def frame() -> None:
        number = next(turn)
        scan = lidar.scan(scene, drive, time=number * PERIOD, frame=number)
        for sample in samples(recipe, run, 0, number, {"": scan}):
            write(sample)

    return frame
