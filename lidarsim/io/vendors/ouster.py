"""Ouster's metadata JSON, in the old flat and the new nested form.

The published range-to-xyz formula for column m of W, channel i and range r, with transforms in mm::

    n  = sqrt(B03**2 + B23**2)       B = beam_to_lidar_transform
    te = 2 pi - 2 pi m / W           encoder angle
    ta = -beam_azimuth_angles[i]     phi = beam_altitude_angles[i]
    x  = (r - n) cos(te + ta) cos(phi) + B03 cos(te)
    y  = (r - n) sin(te + ta) cos(phi) + B03 sin(te)
    z  = (r - n) sin(phi) + B23

followed by lidar_to_sensor_transform. So a beam leaves the head at (B03, 0, B23), and Ouster's range is the distance
from there plus n.

Source: Ouster Software User Manual, "Lidar Range to XYZ"; ouster-sdk, ouster_client/src/lidar_scan.cpp, make_xyz_lut.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from lidarsim._base.validation import Floats, array, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.io.vendors._reading import refusals
from lidarsim.lidar import Lidar, register_lidar_reader
from lidarsim.patterns import Spinning

KIND = "Ouster metadata JSON"

MODES = ("512x10", "512x20", "1024x10", "1024x20", "2048x10", "4096x5")

PRESETS = {"OS-0": "ouster-os0-128", "OS-1": "ouster-os1-128", "OS-2": "ouster-os2-128"}
"""Presets with the limits and noise of a product, by the start of its prod_line."""

BEAM_ORIGIN_MM = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}
"""Distance from the axis to the beam origins, for old files that lack it (ouster-sdk, ouster_client/src/types.cpp)."""

STEEPEST = ("OS-0", 45.0), ("OS-1", 22.5), ("OS-1", 16.6), ("OS-2", 11.25)
"""Greatest absolute altitude angle of the beams of a product, degrees; files without a prod_line are told by it."""

MARGIN = 1.5
"""Tolerance for the beams of a unit, degrees."""

LOW_DATA_RATE_STEP = 0.008
"""Step of the ranges, m, in the profiles of low data rate, whose ranges have 15 bits (ouster-sdk, lidar_frame.rst)."""

LIDAR_TO_SENSOR = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]


def recognise(_path: Path, text: str) -> bool:
    """Return whether `text` is the head of an Ouster metadata JSON."""
    keys = r'"(beam_altitude_angles|beam_azimuth_angles|beam_intrinsics|lidar_origin_to_beam_origin_mm)"'
    return text.lstrip().startswith("{") and re.search(keys, text) is not None


def read(path: Path, *, mode: str | None = None, noise: str | None = None) -> Lidar:
    """Return the sensor that an Ouster metadata JSON describes.

    Files that older software has reduced have no ``prod_line``: then the angles of the beams tell the product.

    Parameters
    ----------
    path : path-like
        The file.
    mode : str, optional
        Columns per turn and turns per second, such as "1024x20", with the full turn as field of view. Default: the
        mode and column window of the file.
    noise : {"datasheet", "measured"}, optional
        As in `Lidar.preset`.

    Returns
    -------
    Lidar
        The sensor, with the limits and noise of the OS0, OS1 or OS2 preset. Its range is measured from the beam origin,
        and its range offset is n. With noise, ranges have steps of 8 mm if ``udp_profile_lidar`` is a profile of low
        data rate.

    Raises
    ------
    FileFormatError
        If the file is incomplete or describes a sensor that is not supported.
    """
    with refusals(path, KIND):
        try:
            document = json.loads(path.read_text(encoding="utf-8-sig"))
        except json.JSONDecodeError as error:
            raise FileFormatError(f"{path}: {KIND}: not valid JSON at line {error.lineno}: {error.msg}") from None
        parts = ("config_params", "sensor_info", "beam_intrinsics", "lidar_intrinsics")
        keys = document | {key: value for part in parts for key, value in _mapping(document, part).items()}
        product = str(keys.get("prod_line") or "") or _product(keys)
        if product[:4] not in PRESETS:
            known = ", ".join(PRESETS)
            raise ArgumentValueError("prod_line", f"a product that starts with {known}", short_repr(product))
        origin = _beam_origin(keys, product)
        pattern = _pattern(keys, origin, mode)
        low_data_rate = "RNG15" in str(_data_format(keys).get("udp_profile_lidar", keys.get("udp_profile_lidar")))
    preset = Lidar.preset(PRESETS[product[:4]], noise=noise)
    measurement = preset.measurement
    if low_data_rate and measurement.range_resolution:
        measurement = dataclasses.replace(measurement, range_resolution=LOW_DATA_RATE_STEP)
    offset = math.hypot(*origin) / 1e3
    name = f"ouster-{product.lower()}"
    return dataclasses.replace(
        preset, pattern=pattern, measurement=measurement, range_offset=offset, name=name, model=name
    )


def _product(keys: dict[str, Any]) -> str:
    """Return the prod_line that the number and the angles of the beams tell; empty if they fit none."""
    altitudes = _altitudes(keys)
    steepest = np.abs(altitudes).max(initial=0.0)
    found = next((product for product, angle in STEEPEST if abs(steepest - angle) <= MARGIN), None)
    return f"{found}-{len(altitudes)}" if found else ""


def _altitudes(keys: dict[str, Any]) -> Floats:
    if "beam_altitude_angles" not in keys:
        raise ValueError("beam_altitude_angles is missing")
    return array("beam_altitude_angles", keys["beam_altitude_angles"], ("channels",))


def _pattern(keys: dict[str, Any], origin: Floats, mode: str | None) -> Spinning:
    altitudes = _altitudes(keys)
    if "beam_azimuth_angles" not in keys:
        raise ValueError("beam_azimuth_angles is missing")
    azimuths = array("beam_azimuth_angles", keys["beam_azimuth_angles"], (len(altitudes),))
    columns, rate = _mode(mode, keys.get("lidar_mode"))
    data_format = _data_format(keys)
    for key, expected in (("pixels_per_column", len(altitudes)), ("columns_per_frame", columns)):
        if data_format.get(key, expected) != expected and not (mode and key == "columns_per_frame"):
            raise ArgumentValueError(key, str(expected), short_repr(data_format[key]))
    first, count = 0, columns
    if mode is None and "column_window" in data_format:
        window = array("column_window", data_format["column_window"], (2,))
        if not np.array_equal(window, np.clip(np.floor(window), 0, columns - 1)):
            raise ArgumentValueError(
                "column_window", f"columns from 0 to {columns - 1}", short_repr(data_format["column_window"])
            )
        first = int(window[0])
        count = int(window[1] - window[0]) % columns + 1

    to_sensor = _transform("lidar_to_sensor_transform", keys.get("lidar_to_sensor_transform", LIDAR_TO_SENSOR))
    if not np.array_equal(to_sensor[2, :3], (0, 0, 1)) or to_sensor[:2, 3].any():
        raise ValueError("lidar_to_sensor_transform: expected a turn about z and a shift along it")
    return Spinning(
        np.radians(altitudes),
        azimuth_offsets=-np.radians(azimuths),
        columns=columns,
        rate=rate,
        beam_origins=(origin + to_sensor[:3, 3]) / 1e3,
        field_of_view=2.0 * math.pi * (count / columns),
        start_azimuth=math.atan2(to_sensor[1, 0], to_sensor[0, 0]) - 2.0 * math.pi * (first / columns),
    )


def _data_format(keys: dict[str, Any]) -> dict[str, Any]:
    return _mapping(keys, "lidar_data_format") or _mapping(keys, "data_format")


def _mode(asked: str | None, given: object) -> tuple[int, float]:
    """Return the columns per turn and the turns per second."""
    mode = given if asked is None else asked
    if mode not in MODES:
        name = "lidar_mode" if asked is None else "mode"
        raise ArgumentValueError(name, f"one of {', '.join(MODES)}", short_repr(mode))
    columns, rate = str(mode).split("x")
    return int(columns), float(rate)


def _beam_origin(keys: dict[str, Any], product: str) -> Floats:
    """Return the position at which the beams leave the head, mm, shape (3,)."""
    if "beam_to_lidar_transform" not in keys:
        distance = keys.get("lidar_origin_to_beam_origin_mm", BEAM_ORIGIN_MM[product[:4]])
        return array("lidar_origin_to_beam_origin_mm", [distance, 0.0, 0.0], (3,))
    beam_to_lidar = _transform("beam_to_lidar_transform", keys["beam_to_lidar_transform"])
    if beam_to_lidar[1, 3] or not np.array_equal(beam_to_lidar[:3, :3], np.eye(3)):
        raise ValueError("beam_to_lidar_transform: expected a shift along x and z alone")
    return beam_to_lidar[:3, 3]


def _mapping(document: dict[str, Any], key: str) -> dict[str, Any]:
    value = document.get(key, {})
    if not isinstance(value, dict):
        raise ArgumentTypeError(key, "an object", short_repr(value))
    return value


def _transform(name: str, value: object) -> Floats:
    return array(name, value, (16,)).reshape(4, 4)


register_lidar_reader(KIND, recognise, read)
