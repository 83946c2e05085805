"""Time to make the pulses of a new frame, by pattern, beside the times of a cast and of a scan."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

import lidarsim as ls
from lidarsim._base.validation import Floats

PRESETS = (
    "hesai-ot128",
    "hesai-at128",
    "velodyne-vls128",
    "velodyne-hdl64e-s3",
    "velodyne-vlp16",
    "livox-avia",
    "livox-mid360",
    "livox-mid40",
    "leica-als50",
    "riegl-vq780i",
    "riegl-vq880g",
)
"""Sensors whose frames differ from one another; together they have every pattern of that kind."""

FRAMES = 4
"""Frames whose rays are made beforehand, to be cast in turn."""


def calls(scene: ls.Scene, place: Floats) -> dict[str, Callable[[], Any]]:
    """Return the calls to time: by the name of the preset and the step, ``pulses``, ``cast`` or ``scan``.

    Each call takes the next frame, since a processor learns the branches of rays that are cast again; ``cast`` repeats
    after `FRAMES` frames. The sensors are at `place`.
    """
    pose = np.eye(4)
    pose[:3, 3] = place
    what: dict[str, Callable[[], Any]] = {}
    for name in PRESETS:
        what |= {f"{name}, {kind}": call for kind, call in _calls(ls.Lidar.preset(name), scene, pose).items()}
    return what


def _calls(lidar: ls.Lidar, scene: ls.Scene, pose: Floats) -> dict[str, Callable[[], Any]]:
    frames = [lidar.pattern.pulses(k) for k in range(FRAMES)]
    rays = itertools.cycle([(pulses.origins + pose[:3, 3], pulses.directions) for pulses in frames])
    alone, whole = itertools.count(1), itertools.count(1)
    return {
        "pulses": lambda: lidar.pattern.pulses(next(alone)),
        "cast": lambda: scene.cast(*next(rays)),
        "scan": lambda: lidar.scan(scene, pose, frame=next(whole)),
    }


def over(times: dict[str, float]) -> list[dict[str, Any]]:
    """Return a row per preset, of the times of the calls, s.

    It has the sensor, the pattern and the number of pulses; the times of a pulse, s; and the time of a scan divided by
    that of a cast.
    """
    rows = []
    for name in PRESETS:
        pattern = ls.Lidar.preset(name).pattern
        pulses, cast, scan = (times[f"{name}, {kind}"] for kind in ("pulses", "cast", "scan"))
        count = len(pattern.pulses(0))
        rows.append(
            {
                "sensor": name,
                "pattern": type(pattern).__name__,
                "pulses": count,
                "make": pulses / count,
                "cast": cast / count,
                "scan": scan / count,
                "ratio": scan / cast,
            }
        )
    return rows
