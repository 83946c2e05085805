"""Livox's scan patterns for simulation: CSV files of Time/s, Azimuth/deg and Zenith/deg.

The files give no firing times, since their Time/s is the row number: pulses are fired in the order of the rows. The
field of view identifies the model, which determines the pulse rate.

Source: Livox-SDK/livox_laser_simulation, scan_mode/*.csv.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidarsim._base.validation import Floats, array, real
from lidarsim.io.vendors._reading import refusals
from lidarsim.lidar import Lidar, register_lidar_reader
from lidarsim.patterns import Table
from lidarsim.patterns._parts import directions_of
from lidarsim.patterns.table import columns_of

KIND = "Livox scan pattern CSV"


class Model(NamedTuple):
    """Field of view that identifies a model, degrees, and its firings."""

    horizontal: float
    vertical: float
    beams: int
    """Rows that fire together."""
    rate: float
    """Firings of each beam per second, Hz."""


MODELS = {
    "livox-mid40": Model(38.4, 38.4, 1, 100e3),
    "livox-mid70": Model(70.4, 70.4, 1, 100e3),
    "livox-mid360": Model(360.0, 59.4, 4, 50e3),
}
MARGIN = 2.0
"""Tolerance for the field of view of a file, degrees; ten thousand rows are within 1."""


def recognise(_path: Path, text: str) -> bool:
    """Return whether `text` is the head of a Livox scan pattern CSV."""
    return re.match(r"Time/s\s*,\s*Azimuth/deg\s*,\s*Zenith/deg\s", text, re.IGNORECASE) is not None


def read(path: Path, *, rate: float = 10.0, pulse_rate: float | None = None, noise: str | None = None) -> Lidar:
    """Return the sensor whose scan pattern a Livox CSV lists.

    Parameters
    ----------
    path : path-like
        The file.
    rate : float
        Frames per second, Hz.
    pulse_rate : float, optional
        Rows per second, Hz, for an unsupported model, which is assumed to have one beam. Default: that of the model
        with the file's field of view: Mid-40, Mid-70 or Mid-360.
    noise : {"datasheet", "measured"}, optional
        As in `Lidar.preset`.

    Returns
    -------
    Lidar
        The sensor, with the limits of its preset if it has one.

    Raises
    ------
    FileFormatError
        If the file is incomplete or the model is not supported.
    """
    with refusals(path, KIND):
        azimuth, zenith = list(columns_of(path.read_text(encoding="utf-8-sig").splitlines()).values())[1:]
        azimuth = (array("Azimuth/deg", azimuth, ("n",)) + 180.0) % 360.0 - 180.0
        elevation = array("Zenith/deg", 90.0 - zenith, ("n",))
        if pulse_rate is not None:
            name, model = "", Model(0.0, 0.0, 1, real("pulse_rate", pulse_rate, above=0.0))
        else:
            name, model = _model(azimuth, elevation)
        row = np.arange(len(azimuth))
        pattern = Table(
            directions_of(np.radians(azimuth), np.radians(elevation)),
            times=row // model.beams / model.rate,
            rings=row % model.beams,
            rate=rate,
        )
    return (
        dataclasses.replace(Lidar.preset(name, noise=noise), pattern=pattern) if name else Lidar(pattern, name="livox")
    )


def _model(azimuth: Floats, elevation: Floats) -> tuple[str, Model]:
    horizontal, vertical = np.ptp(azimuth), np.ptp(elevation)
    for name, model in MODELS.items():
        if max(abs(model.horizontal - horizontal), abs(model.vertical - vertical)) <= MARGIN:
            return name, model
    raise ValueError(
        f"recognised a field of view of {horizontal:.1f} by {vertical:.1f} degrees, of none of {', '.join(MODELS)}: "
        f"its pulse_rate is missing"
    )


register_lidar_reader(KIND, recognise, read)
