"""Velodyne's calibration files, as used by the ROS drivers: a YAML with a list of the lasers of a unit.

The model of a channel, with range d, delta = vert_correction, rho = azimuth - rot_correction, Vo =
vert_offset_correction, Ho = horiz_offset_correction, X right and Y forward::

    q = d cos(delta) - Vo sin(delta)
    X = q sin(rho) - Ho cos(rho)
    Y = q cos(rho) + Ho sin(rho)
    Z = d sin(delta) + Vo cos(delta)

In lidarsim x = Y and y = -X. So at rho = 0 the beam origin, where d = 0, is (-Vo sin(delta), Ho, Vo cos(delta)), and
since the azimuth is -rho, rot_correction is the azimuth offset. Range corrections (dist_correction, focal_distance and
the like) turn raw readings into d and do not move points.

Source: ros-drivers/velodyne, velodyne_pointcloud/src/lib/rawdata.cc.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from lidarsim._base.files import redact
from lidarsim._base.validation import Floats, array, short_repr
from lidarsim.errors import ArgumentValueError, FileFormatError
from lidarsim.io.vendors._reading import refusals
from lidarsim.lidar import Lidar, register_lidar_reader
from lidarsim.patterns import Spinning
from lidarsim.patterns._parts import rotate

KIND = "Velodyne calibration YAML"

DEPTH = 8
"""Greatest nesting depth of lists and mappings; a calibration has three levels."""


class Model(NamedTuple):
    """Values that a calibration lacks; the preset gives all others."""

    lasers: int
    firing_us: Callable[[Floats], Floats]
    """Firing times of lasers since the start of their cycle by their ids, microseconds."""


# Source: ros-drivers/velodyne rawdata.cc and rawdata.h; valgur/velodyne_decoder src/packet_decoder.cpp, which cites the
# manuals and has the times of the VLS-128 since firmware 5.2.3.0; VLP-16 User Manual 63-9243 Rev D p. 49.
MODELS = {
    "velodyne-vlp16": Model(16, lambda laser: 2.304 * laser),
    "velodyne-vlp32c": Model(32, lambda laser: 2.304 * (laser // 2)),
    "velodyne-hdl32e": Model(32, lambda laser: 1.152 * laser),
    "velodyne-hdl64e-s2": Model(64, lambda laser: _fours(laser % 32, 6.0, (0.0, 1.26, 2.46, 3.66))),
    "velodyne-hdl64e-s3": Model(64, lambda laser: _fours(laser % 32, 7.2, (0.0, 1.3, 2.5, 3.7))),
    "velodyne-vls128": Model(128, lambda laser: 2.89 * (laser // 8 + laser // 64)),
}


def recognise(_path: Path, text: str) -> bool:
    """Return whether `text` is the head of a Velodyne calibration YAML."""
    return re.search(r"^lasers\s*:", text, re.MULTILINE) is not None and "vert_correction" in text


def read(path: Path, *, model: str | None = None, rate: float | None = None, noise: str | None = None) -> Lidar:
    """Return the sensor that a Velodyne calibration YAML describes.

    Rings count upwards from the lowest laser, as in the ROS driver.

    Parameters
    ----------
    path : path-like
        The file.
    model : str, optional
        Preset that gives the firing times, limits and noise. Default: by the number of lasers; for 32 the VLP-32C if
        lasers have azimuth offsets, else the HDL-32E; for 64 the HDL-64E S2.
    rate : float, optional
        Turns, and thus frames, per second, Hz. Default: the preset's.
    noise : {"datasheet", "measured"}, optional
        As in `Lidar.preset`.

    Returns
    -------
    Lidar
        The sensor.

    Raises
    ------
    FileFormatError
        If the file is incomplete or describes a sensor that is not supported.
    """
    with refusals(path, KIND):
        name, changes = _calibration(_yaml(path), model)
    lidar = Lidar.preset(name, noise=noise)
    if rate is not None:
        changes["rate"] = rate
    with refusals(path, KIND):
        return dataclasses.replace(lidar, pattern=dataclasses.replace(cast("Spinning", lidar.pattern), **changes))


def _yaml(path: Path) -> Any:
    import yaml

    text, loader = path.read_text(encoding="utf-8-sig"), getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    depth = 0
    try:
        for event in yaml.parse(text, loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEPTH or isinstance(event, yaml.AliasEvent):  # would exhaust the loader's stack or the memory
                raise ValueError("expected a list of lasers, got deeper nesting or an alias")
        return yaml.load(text, loader)  # noqa: S506 - a safe loader
    except yaml.MarkedYAMLError as error:
        where = f" at line {error.problem_mark.line + 1}" if error.problem_mark else ""
        problem = redact(ValueError(error.problem or error.context))
        raise FileFormatError(f"{path}: {KIND}: not valid YAML{where}: {problem}") from None
    except yaml.YAMLError as error:
        raise FileFormatError(f"{path}: {KIND}: not valid YAML: {redact(error)}") from None


def _calibration(document: object, name: str | None) -> tuple[str, dict[str, Any]]:
    """Return the preset, and the changes of a calibration to its pattern."""
    if not isinstance(document, dict) or "lasers" not in document:
        raise ValueError("lasers is missing")
    lasers = document["lasers"]
    if not isinstance(lasers, list) or not all(isinstance(laser, dict) for laser in lasers):
        raise ValueError("lasers: expected a list of mappings")
    if document.get("num_lasers") != len(lasers):
        given = short_repr(document["num_lasers"]) if "num_lasers" in document else "none"
        raise ArgumentValueError("num_lasers", f"{len(lasers)}, the number of lasers listed", given)
    ids = _column(lasers, "laser_id")
    if not np.array_equal(np.sort(ids), np.arange(len(lasers))):
        raise ValueError(f"laser_id: expected each of 0 to {len(lasers) - 1} once")
    elevation = _column(lasers, "vert_correction")
    azimuth_offset = _column(lasers, "rot_correction", 0.0)
    vertical = _column(lasers, "vert_offset_correction", 0.0)
    horizontal = _column(lasers, "horiz_offset_correction", 0.0)

    name = name or _model(len(lasers), azimuth_offset)
    if name not in MODELS:
        raise ArgumentValueError("model", f"one of {', '.join(MODELS)}", repr(name))
    if MODELS[name].lasers != len(lasers):
        raise ValueError(f"model: {name} has {MODELS[name].lasers} lasers, the file {len(lasers)}")

    rings = np.argsort(elevation, kind="stable")
    origin = np.stack([-vertical * np.sin(elevation), horizontal, vertical * np.cos(elevation)], axis=-1)
    return name, {
        "elevations": elevation[rings],
        "azimuth_offsets": azimuth_offset[rings],
        "firing_times": MODELS[name].firing_us(ids[rings]) / 1e6,
        "beam_origins": rotate(origin, azimuth_offset)[rings],
    }


def _fours(laser: Floats, group: float, within: tuple[float, ...]) -> Floats:
    """Return the firing times of lasers that fire in groups of four."""
    steps: Floats = np.array(within)[(laser % 4).astype(np.intp)]
    return group * (laser // 4) + steps


def _model(lasers: int, azimuth_offset: Floats) -> str:
    """Return the most likely model for a calibration."""
    if lasers == 32:
        return "velodyne-vlp32c" if azimuth_offset.any() else "velodyne-hdl32e"
    for name, model in MODELS.items():
        if model.lasers == lasers:
            return name
    known = sorted({model.lasers for model in MODELS.values()})
    raise ArgumentValueError("lasers", f"as many as a supported model has, {', '.join(map(str, known))}", lasers)


def _column(lasers: list[dict[str, Any]], key: str, default: float | None = None) -> Floats:
    """Return one value per laser."""
    for number, laser in enumerate(lasers):
        if default is None and key not in laser:
            raise ValueError(f"{key} is missing in lasers[{number}]")
    return array(key, [laser.get(key, default) for laser in lasers], (len(lasers),))


register_lidar_reader(KIND, recognise, read)
