"""Scans with the noise and beam of real units, beside those without, and their sub-rays beside Open3D."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal

import numpy as np

import lidarsim as ls
from lidarsim.bench.peers import Caster
from lidarsim.bench.scenes import Rays, World

SENSORS = (
    "velodyne-vlp16",
    "velodyne-hdl64e-s3",
    "velodyne-vls128",
    "ouster-os1-128",
    "hesai-xt32",
    "hesai-pandar64",
)
"""Sensors whose noise was measured; the HDL-64E and the VLS-128 have no beam."""

NOISE: dict[str, Literal["datasheet", "measured"] | None] = {
    "clean": None,
    "datasheet": "datasheet",
    "measured": "measured",
}


def sub_rays(lidar: ls.Lidar, beam: ls.Beam, world: World) -> Rays:
    """Return the sub-rays of a frame of a sensor at the world's as rays of their own, for casters without beams.

    Pulse by pulse, these are the axis, then the others on a ring of half the beam's radius.
    """
    pulses = lidar.pattern.pulses(0)
    along = pulses.directions
    left = np.cross([0.0, 0.0, 1.0], along)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    up = np.cross(along, left)
    angle = np.arange(beam.rays - 1) * (2.0 * math.pi / (beam.rays - 1))
    wide, high = beam.divergence_azimuth / 4.0, (beam.divergence_elevation or beam.divergence_azimuth) / 4.0
    beside = wide * np.cos(angle)[:, None] * left[:, None] + high * np.sin(angle)[:, None] * up[:, None]
    directions = np.concatenate([along[:, None], along[:, None] + beside], axis=1).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.repeat(pulses.origins + world.sensor, beam.rays, axis=0)
    return Rays(f"{lidar.name}, sub-rays", origins, directions, one_origin=bool((origins == origins[0]).all()))


def calls(world: World, scene: ls.Scene, casters: Mapping[str, Caster], threads: int) -> dict[str, Callable[[], Any]]:
    """Return the calls to time.

    They are scans of new frames, by the names of the sensor and of its noise, and casts of all sub-rays by other
    casters that hold the world, by the names of the sensor and of the caster.
    """
    pose = np.eye(4)
    pose[:3, 3] = world.sensor
    what: dict[str, Callable[[], Any]] = {}
    for name in SENSORS:
        for kind, noise in NOISE.items():
            lidar, frames = ls.Lidar.preset(name, noise=noise), itertools.count()
            what[f"{name}, {kind}"] = partial(_scan, lidar, scene, pose, frames)
        if (beam := lidar.measurement.beam) is not None:
            rays = sub_rays(lidar, beam, world)
            for caster, other in casters.items():
                what[f"{name}, {caster}"] = partial(other.cast, other.prepare(rays), threads)
    return what


def _scan(lidar: ls.Lidar, scene: ls.Scene, pose: Any, frames: itertools.count[int]) -> ls.Scan:
    return lidar.scan(scene, pose, frame=next(frames))


def over(times: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return a row per sensor, of the times of the calls, s.

    It has the sensor, the pulses and the sub-rays of a pulse; the times of a pulse, s, without noise, with the data
    sheet's and as measured, and the last divided by the first; the time of Open3D for the sub-rays of a pulse, s, and
    that divided by the time of the measured scan. Without Open3D or a beam the last two are None.
    """
    rows = []
    for name in SENSORS:
        lidar = ls.Lidar.preset(name, noise="measured")
        count, beam = len(lidar.pattern.pulses(0)), lidar.measurement.beam
        clean, datasheet, measured = (times[f"{name}, {kind}"] / count for kind in NOISE)
        peer = times.get(f"{name}, Open3D")
        rows.append(
            {
                "sensor": name,
                "pulses": count,
                "sub_rays": 1 if beam is None else beam.rays,
                "clean": clean,
                "datasheet": datasheet,
                "measured": measured,
                "ratio": measured / clean,
                "Open3D": None if peer is None else peer / count,
                "over_open3d": None if peer is None else peer / count / measured,
            }
        )
    return rows
