"""Hesai's corrections: one CSV with the angles of the channels, and one with their firing times.

Hesai's x points to the right and y to the front of the sensor, and azimuths grow clockwise. Channel i, fired while the
rotor stands at azimuth a, looks from the optical centre, which turns with the rotor, at azimuth a + Azimuth[i] and
elevation Elevation[i]. Here the front is x and azimuths grow counter-clockwise, so that those of a rotor change their
sign. In an AT128 a mirror turns instead: its azimuths are 2 (block - start) - Azimuth[i], and keep it.

Source: HesaiTechnology/HesaiLidar_SDK_2.0, libhesai/UdpParser/src.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from lidarsim._validation import Floats, array
from lidarsim.errors import FileFormatError
from lidarsim.io.vendors._reading import refusals
from lidarsim.patterns import PolygonMirror, Spinning
from lidarsim.patterns.table import columns_of
from lidarsim.sensor import Lidar, register_lidar_reader

ANGLES = "Hesai angle correction CSV"
FIRING_TIMES = "Hesai firetime correction CSV"


class Model(NamedTuple):
    """How a model is told by its angles."""

    name: str
    channels: int
    top: float
    bottom: float
    preset: str | None = None


MODELS = (
    Model("Pandar40P", 40, 15.0, -25.0, "hesai-pandar40p"),
    Model("Pandar64", 64, 15.0, -25.0, "hesai-pandar64"),
    Model("PandarQT64", 64, 52.1, -52.1, "hesai-qt64"),
    Model("PandarXT32", 32, 15.0, -16.0, "hesai-xt32"),
    Model("XT32M2X", 32, 19.5, -20.8, "hesai-xt32m2x"),
    Model("PandarQT128", 128, 52.6, -52.6),
    Model("Pandar128 or OT128", 128, 15.0, -25.0),
    Model("AT128", 128, 12.9, -12.5, "hesai-at128"),
)
MARGIN = 1.5
"""How far the outer channels of a unit may be from its model's, degrees; units differ by less than half a degree."""


def recognise_angles(path: Path, text: str) -> bool:
    """Return whether `text`, the head of the file `path`, is that of an angle correction CSV."""
    del path
    return re.match(r"(EEFF.*\n)?(Channel|Laser id)\s*,\s*Elevation\s*,\s*Azimuth\s", text, re.IGNORECASE) is not None


def recognise_firing_times(path: Path, text: str) -> bool:
    """Return whether `text`, the head of the file `path`, is that of a firetime correction CSV."""
    del path
    return re.match(r"Channel\s*,\s*fire ?time", text, re.IGNORECASE) is not None


def read(
    path: Path, *, firing_times: str | Path | None = None, rate: float | None = None, noise: str | None = None
) -> Lidar:
    """Return the sensor whose angles a Hesai angle correction CSV lists.

    Everything else is that of the preset of the model, which is told by the number and the span of the channels.

    Parameters
    ----------
    path : path-like
        The file.
    firing_times : path-like, optional
        The firetime correction CSV of the sensor. Default: the preset's firing times.
    rate : float, optional
        Turns, and so frames, per second, Hz. Default: the preset's.
    noise : {"datasheet"}, optional
        As in `Lidar.preset`.

    Returns
    -------
    Lidar
        The sensor.

    Raises
    ------
    FileFormatError
        If a file is not whole or the sensor is of a model that is not covered.
    """
    with refusals(path, ANGLES):
        elevations, azimuths = _by_channel(path, "elevation", "azimuth")
        model = _model(elevations)
        if model.preset is None:
            raise ValueError(f"recognised a {model.name}, which is not covered: its firing times are missing")
    lidar = Lidar.preset(model.preset, noise=noise)
    pattern = cast("PolygonMirror | Spinning", lidar.pattern)
    mirror = isinstance(pattern, PolygonMirror)
    offsets = np.radians(azimuths if mirror else -azimuths)
    changes: dict[str, Any] = {"elevations": np.radians(elevations), "azimuth_offsets": offsets}
    if rate is not None:
        changes |= {"rate": rate, "line_rate": rate} if mirror else {"rate": rate}
    if firing_times is not None:
        with refusals(Path(firing_times), FIRING_TIMES):
            (times,) = _by_channel(Path(firing_times), "fire")
            if len(times) != model.channels:
                raise ValueError(f"expected the {model.channels} channels of a {model.name}, got {len(times)}")
            changes["firing_times"] = (times - times.min()) / 1e6
    return dataclasses.replace(lidar, pattern=dataclasses.replace(pattern, **changes))


def refuse_firing_times(path: Path) -> Lidar:
    """Say what to do with a firetime correction CSV, which is half of a sensor."""
    raise FileFormatError(
        f"{path}: {FIRING_TIMES}: the angles of the channels are missing: "
        f"give the {ANGLES} as the file and this one as its firing_times"
    )


def _by_channel(path: Path, *names: str) -> list[Floats]:
    """Return the columns whose names start with `names`, ordered by the channel numbers in the first column."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    if lines and lines[0].upper().startswith("EEFF"):
        del lines[0]
    if lines and re.fullmatch(r"[0-9a-fA-F]{64}", lines[-1].strip()):  # the SHA-256 of the file
        del lines[-1]
    (_, channel), *others = columns_of(lines).items()
    count = len(channel)
    if not np.array_equal(np.sort(channel), np.arange(1, count + 1)):
        raise ValueError(f"expected each of the channels 1 to {count} once")
    order = np.argsort(channel)
    named = {start: values for start in names for name, values in others if name.startswith(start)}
    missing = [name for name in names if name not in named]
    if missing:
        raise ValueError(f"expected a column that starts with {missing[0]}")
    return [array(name, named[name], (count,))[order] for name in names]


def _model(elevations: Floats) -> Model:
    top, bottom = elevations.max(), elevations.min()
    for model in MODELS:
        if model.channels == len(elevations) and max(abs(model.top - top), abs(model.bottom - bottom)) <= MARGIN:
            return model
    known = ", ".join(f"{model.name} ({model.channels}, {model.top} to {model.bottom})" for model in MODELS)
    raise ValueError(
        f"expected the channels of one of {known}, got {len(elevations)} channels from {top:g} to {bottom:g} degrees"
    )


register_lidar_reader(ANGLES, recognise_angles, read)
register_lidar_reader(FIRING_TIMES, recognise_firing_times, refuse_firing_times)
