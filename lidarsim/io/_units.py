"""Numbers as vendors give them, and the check that a number fits where a format puts it."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.pointcloud import Fields

if TYPE_CHECKING:
    from lidarsim.scan import Sensor


def warn_above(most: float, intensity: npt.NDArray[np.float32] | None, where: str) -> None:
    """Warn if a cloud has an intensity beyond the greatest of a format, for which that is written instead."""
    if intensity is not None and (intensity > np.float32(most)).any():
        message = f"intensity: {where} ends at {most:g}; what is brighter is written as {most:g}"
        warnings.warn(message, stacklevel=4)  # at the call of PointCloud.save


def reflectivity(intensity: npt.NDArray[np.float32], diffuse: int = 100) -> npt.NDArray[np.uint8]:
    """Return the intensity as the byte in which vendors give reflectivity.

    0 to `diffuse` is linear in what a diffuse target reflects, 0 to 100 %; a retro-reflector returns more than any of
    them and goes on along the same line, up to 255. Velodyne, Ouster and RoboSense end the diffuse part at 100 (VLP-16
    User Manual 63-9243; Ouster's retro-reflective part is logarithmic, of which no formula is published), Hesai's line
    is this one (PandarXT and Pandar64 User Manuals, linear mapping), and Livox ends it at 150 (Mid-360 User Manual).
    """
    held = np.clip(np.nan_to_num(intensity), 0, np.float32(255 / diffuse))
    scaled: npt.NDArray[np.uint8] = np.rint(held * np.float32(diffuse)).astype(np.uint8)
    return scaled


def fitting(
    name: str, values: npt.NDArray[Any], dtype: npt.DTypeLike, what: str, *, at_most: int | None = None, first: int = 0
) -> npt.NDArray[Any]:
    """Return whole numbers as integers of `dtype`, after checking that each of them fits there.

    `what` says where, and `first` is the number of the first point of a block.
    """
    low, high = np.iinfo(dtype).min, np.iinfo(dtype).max if at_most is None else at_most
    wrong = ~((values >= low) & (values <= high) & (values == np.floor(values)))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise FileFormatError(f"{name}: expected {low} to {high} for {what}, got {name}[{first + i}] = {values[i]}")
    return values.astype(dtype)


def vendor_range(fields: Fields, lidar: Sensor | None) -> npt.NDArray[np.float64]:
    """Return the range as the vendor counts it, m: from where the sensor has its zero, which may differ by the ring."""
    offset = np.asarray(lidar.range_offset if lidar else 0.0)
    shifted: npt.NDArray[np.float64] = fields["range"] + (offset[fields["ring"]] if offset.ndim else offset)
    return shifted
