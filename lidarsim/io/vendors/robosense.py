"""RoboSense's angle files, as used by the ROS driver: a CSV without a header, one line per channel of a unit.

A line gives the elevation of a channel and, for the RS-LiDAR-32, its clockwise azimuth relative to the head, degrees.
Lines are ordered by channel, not by elevation.

Source: RoboSense-LiDAR/ros_rslidar, rslidar_pointcloud/data/rs_lidar_16/angle.csv and rs_lidar_32/angle.csv; firing
times: RoboSense-LiDAR/rs_driver, decoder_RS16.hpp and decoder_RS32.hpp.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from lidarsim._base.validation import array
from lidarsim.io.vendors._reading import refusals
from lidarsim.lidar import Lidar, register_lidar_reader
from lidarsim.patterns import Spinning
from lidarsim.patterns.table import number_rows

KIND = "RoboSense angle CSV"


class Model(NamedTuple):
    """Values that the file lacks, and that the preset has in the order of its rings."""

    preset: str
    firing_us: list[float]
    """Firing time of each channel since the start of its cycle, microseconds."""


MODELS = {
    (16, 1): Model("robosense-rs16", [2.8 * channel for channel in range(16)]),
    (32, 2): Model(
        "robosense-rs32",
        [start + 2.88 * step for start in (0.0, 1.44) for step in (*range(15), 15.5)],
    ),
}
"""Models by the number of lines and of values per line."""


def recognise(_path: Path, text: str) -> bool:
    """Return whether `text` is the head of a RoboSense angle CSV."""
    number = r"[ \t]*-?\d+(\.\d+)?[ \t]*"
    return re.fullmatch(rf"({number}(\r?\n|$)){{16}}|({number},{number}(\r?\n|$)){{32}}", text) is not None


def read(path: Path, *, rate: float | None = None, noise: str | None = None) -> Lidar:
    """Return the sensor that a RoboSense CSV describes: an RS-LiDAR-16 or RS-LiDAR-32, by the number of lines.

    Rings count upwards from the lowest channel, as in the ROS driver.

    Parameters
    ----------
    path : path-like
        The file.
    rate : float, optional
        Turns, and thus frames, per second, Hz. Default: the preset's.
    noise : {"datasheet", "measured"}, optional
        As in `Lidar.preset`.

    Returns
    -------
    Lidar
        The sensor, otherwise like its preset.

    Raises
    ------
    FileFormatError
        If the file cannot be read.
    """
    with refusals(path, KIND):
        rows = number_rows(path.read_text(encoding="utf-8-sig").splitlines())
        angles = array("angles", rows, ("n", "of each"))
        if angles.shape not in MODELS:
            raise ValueError(f"expected 16 lines of an angle or 32 of two, got shape {angles.shape}")
    model = MODELS[angles.shape]
    lidar = Lidar.preset(model.preset, noise=noise)
    pattern = cast("Spinning", lidar.pattern)
    rings = np.argsort(angles[:, 0], kind="stable")
    elevation, azimuth = np.radians(np.c_[angles, np.zeros(len(angles))][rings, :2].T)  # the RS-LiDAR-16 has azimuth 0
    with refusals(path, KIND):
        pattern = dataclasses.replace(
            pattern,
            elevations=elevation,
            azimuth_offsets=-azimuth,
            firing_times=np.array(model.firing_us)[rings] / 1e6,
            rate=pattern.rate if rate is None else rate,
        )
    return dataclasses.replace(lidar, pattern=pattern)


register_lidar_reader(KIND, recognise, read)
