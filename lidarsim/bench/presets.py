"""The rays of sensors as they fire them: lidarsim and Open3D on a frame of each."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

import lidarsim as ls
from lidarsim.bench.peers import Caster
from lidarsim.bench.scenes import Rays, World

SENSORS = (
    "velodyne-vlp16",
    "velodyne-hdl64e-s3",
    "ouster-os1-128",
    "hesai-ot128",
    "livox-mid360",
    "livox-avia",
    "hokuyo-utm30lx",
    "sick-lms111",
)
"""Sensors with one origin a pulse, a column or a frame; with rings, rosettes or a plane of rays."""


def rays(sensor: str, world: World) -> Rays:
    """Return the rays of a frame of a preset at the world's sensor, in firing order, from the origins of its beams."""
    pulses = ls.Lidar.preset(sensor).pattern.pulses(0)
    origins, directions = pulses.origins + world.sensor, np.ascontiguousarray(pulses.directions)
    return Rays(sensor, origins, directions, one_origin=bool((origins == origins[0]).all()))


def calls(world: World, casters: Mapping[str, Caster], threads: int) -> dict[str, Callable[[], Any]]:
    """Return the casts to time, by the names of the sensor and of the caster that holds the world."""
    what: dict[str, Callable[[], Any]] = {}
    for sensor in SENSORS:
        given = rays(sensor, world)
        for name, caster in casters.items():
            what[f"{sensor}, {name}"] = partial(caster.cast, caster.prepare(given), threads)
    return what


def over(times: Mapping[str, float], world: World) -> list[dict[str, Any]]:
    """Return a row per sensor, of the times of the calls, s.

    It has the scene, the sensor and the number of rays; the times of a ray, s; and that of Open3D over that of
    lidarsim. Without Open3D the last two are None.
    """
    rows = []
    for sensor in SENSORS:
        count = len(rays(sensor, world))
        own, peer = times[f"{sensor}, lidarsim"], times.get(f"{sensor}, Open3D")
        rows.append(
            {
                "scene": world.name,
                "sensor": sensor,
                "rays": count,
                "lidarsim": own / count,
                "Open3D": None if peer is None else peer / count,
                "ratio": None if peer is None else peer / own,
            }
        )
    return rows


def mean(rows: list[dict[str, Any]]) -> float | None:
    """Return the geometric mean of the ratios, None if there are none."""
    ratios = [row["ratio"] for row in rows if row["ratio"] is not None]
    return statistics.geometric_mean(ratios) if ratios else None
