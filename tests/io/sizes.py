"""Size, and time to write and read, of a frame in each format, beside the time of its scan; the table in README.md.

python tests/io/sizes.py
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import lidarsim as ls
from lidarsim.scan.formats import FORMATS


def street() -> ls.Scene:
    """A scene that gives every pulse a point."""
    scene, rng = ls.Scene(), np.random.default_rng(0)
    scene.add(ls.Plane((0, 0, 1), -1.8), label=1)
    scene.add(ls.Sphere((0, 0, 0), 60.0), label=2, material=ls.Material(reflectivity=0.4))
    for index in range(200):
        scene.add(ls.Box((2, 2, 3), center=(*rng.uniform(-50, 50, 2), 0)), label=3 + index % 5)
    return scene


def milliseconds(work: Callable[[], object], times: int = 5) -> float:
    """The least of several times."""
    spent = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begin)
    return 1e3 * min(spent)


def main() -> None:
    """Print the table."""
    lidar, scene = ls.Lidar.preset("ouster-os1-128", noise="datasheet"), street()
    scan = lidar.scan(scene)
    cloud = scan.point_cloud()
    took = milliseconds(lambda: lidar.scan(scene).point_cloud())
    sys.stdout.write(f"{len(cloud):,} points of {len(scan):,} pulses, {len(cloud.fields)} fields: {took:.0f} ms\n")
    with tempfile.TemporaryDirectory() as folder:
        for suffix in FORMATS:
            path = Path(folder) / f"cloud{suffix}"
            written = milliseconds(lambda: cloud.save(path))  # noqa: B023
            load = ls.io.semantickitti.read_labels if suffix == ".label" else ls.PointCloud.load
            read = milliseconds(lambda: load(path))  # noqa: B023
            size = path.stat().st_size / 1e6
            sys.stdout.write(f"{suffix:8} {size:6.2f} MB, written in {written:6.0f} ms, read in {read:6.0f} ms\n")


if __name__ == "__main__":
    main()
