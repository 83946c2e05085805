"""Vendors' units, and checks that numbers fit in a format."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.scan.fields import Fields
from lidarsim.sensor.sensor import Sensor

KEPT = 1e-4
"""By how much float32 may move coordinates without a warning, m."""


def warn_above(most: float, intensity: npt.NDArray[np.float32] | None, where: str) -> None:
    """Warn if an intensity exceeds the format's greatest, which is written instead."""
    if intensity is not None and (intensity > np.float32(most)).any():
        message = f"intensity: {where} ends at {most:g}; what is brighter is written as {most:g}"
        warnings.warn(message, stacklevel=4)  # at the call of PointCloud.save


def rounding_error(xyz: npt.NDArray[np.float64 | np.float32]) -> float:
    """Return by how much float32 moves the coordinates at most, m."""
    with np.errstate(over="ignore", invalid="ignore"):
        single = xyz.astype(np.float32)
        return float(np.nanmax(np.where(single == xyz, 0.0, np.abs(single - xyz)), initial=0.0))


def warn_moved(xyz: npt.NDArray[np.float64 | np.float32]) -> None:
    """Warn if float32, in which the format holds coordinates, moves a point by more than `KEPT`."""
    error = rounding_error(xyz)
    if error > KEPT:
        message = f"xyz: float32 moves points by up to {error:.2g} m; save the cloud in the sensor's frame"
        warnings.warn(message, stacklevel=4)  # at the call of PointCloud.save


def reflectivity(intensity: npt.NDArray[np.float32], diffuse: int = 100) -> npt.NDArray[np.uint8]:
    """Return the intensity as the reflectivity byte of vendors.

    0 to `diffuse` is linear in the reflectivity of a diffuse target, 0 to 100 %; retro-reflectors return more and
    continue the same line up to 255. The diffuse part ends at 100 for Velodyne, Ouster and RoboSense (VLP-16 User
    Manual 63-9243; Ouster's retro-reflective part is logarithmic, with no published formula) and at 150 for Livox
    (Mid-360 User Manual); Hesai uses this line (PandarXT and Pandar64 User Manuals, linear mapping).
    """
    held = np.minimum(np.fmax(intensity, np.float32(0)), np.float32(255 / diffuse))  # nan becomes 0
    scaled: npt.NDArray[np.uint8] = np.rint(held * np.float32(diffuse)).astype(np.uint8)
    return scaled


def integers(
    name: str,
    values: npt.NDArray[Any],
    dtype: npt.DTypeLike,
    what: str,
    *,
    at_least: int | None = None,
    at_most: int | None = None,
    first: int = 0,
) -> npt.NDArray[Any]:
    """Return integers as `dtype`, after checking that each fits.

    `what` names the place for the error message; `first` is the number of the block's first point.
    """
    low = np.iinfo(dtype).min if at_least is None else at_least
    high = np.iinfo(dtype).max if at_most is None else at_most
    wrong = ~((values >= low) & (values <= high) & (values == np.floor(values)))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise FileFormatError(f"{name}: expected {low} to {high} for {what}, got {name}[{first + i}] = {values[i]}")
    return values.astype(dtype)


def vendor_range(fields: Fields, lidar: Sensor | None) -> npt.NDArray[np.float64]:
    """Return the range from the vendor's zero, which may differ by ring, m."""
    offset = np.asarray(lidar.range_offset if lidar else 0.0)
    shifted: npt.NDArray[np.float64] = fields["range"] + (offset[fields["ring"]] if offset.ndim else offset)
    return shifted
