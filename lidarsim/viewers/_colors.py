"""Colours of points by a field, the same in all viewers: bright enough for a dark background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim.pointcloud import PointCloud

BACKGROUND = "#14181d"

# Magma, a perceptually uniform colour map (N. Smith and S. van der Walt, https://bids.github.io/colormap, CC0), at ten
# equal steps from 0.3, where it is clear of the background, to 1.
SEQUENTIAL = (
    "#641a80", "#832681", "#a3307e", "#c43c75", "#e24d66", "#f56b5c", "#fc9065", "#feb67c", "#fdda9c", "#fcfdbf",
)  # fmt: skip
# For eyes with any colour vision (M. Okabe and K. Ito, Color universal design, 2008), without black.
QUALITATIVE = ("#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7", "#bbbbbb")

UNITS = {"height": "m", "range": "m", "true_range": "m", "range_error": "m", "time": "s", "incidence": "rad"}
CATEGORIES = {"label", "object_id", "return_number", "return_count"}


@dataclass(frozen=True, slots=True, eq=False)
class Coloring:
    """A table of colours over the interval `limits` of `values`, one value a point; `names` are those of categories."""

    title: str
    values: npt.NDArray[Any]
    limits: tuple[float, float]
    table: list[str]
    names: list[str]

    def rgb(self) -> npt.NDArray[np.uint8]:
        """Return the colour of each point, shape (n, 3)."""
        low, high = self.limits
        index = np.nan_to_num((self.values - low) / (high - low) * len(self.table))
        return _channels(self.table).take(index.clip(0, len(self.table) - 1).astype(int), axis=0)


def coloring(cloud: PointCloud, color_by: str | None) -> Coloring:
    """Return the colours of a cloud by a scalar field, or ``"height"``; by default by intensity if it has that.

    The limits are the 1st and 99th percentile, so that a few outliers do not take the colours of all others.

    Raises
    ------
    ValueError
        If the cloud has no such scalar field.
    """
    scalars = ["height", *(name for name in cloud.fields if getattr(cloud, name).ndim == 1)]
    if color_by is None:
        color_by = "intensity" if "intensity" in scalars else "height"
    if color_by not in scalars:
        raise ValueError(f"color_by: expected one of {', '.join(scalars)}, got {color_by!r}")
    values = cloud.xyz[:, 2] if color_by == "height" else getattr(cloud, color_by)
    if color_by in CATEGORIES and len(cloud):
        found, index = np.unique(values, return_inverse=True)
        table = [QUALITATIVE[i % len(QUALITATIVE)] for i in range(len(found))]
        return Coloring(color_by, index, (-0.5, len(found) - 0.5), table, [str(value) for value in found])
    finite = values[np.isfinite(values)].astype(np.float64)
    low, high = np.percentile(finite, (1, 99)) if len(finite) else (0.0, 1.0)
    if low == high:
        low, high = low - 0.5, high + 0.5
    title = f"{color_by} [{UNITS[color_by]}]" if color_by in UNITS else color_by
    return Coloring(title, values, (float(low), float(high)), _blend(SEQUENTIAL), [])


def _channels(colors: Sequence[str]) -> npt.NDArray[np.uint8]:
    return np.array([list(bytes.fromhex(color[1:])) for color in colors], np.uint8)


def _blend(anchors: Sequence[str], size: int = 256) -> list[str]:
    """Return `size` colours that run through the anchors."""
    steps = np.linspace(0, len(anchors) - 1, size)
    channels = [np.interp(steps, np.arange(len(anchors)), channel) for channel in _channels(anchors).T]
    return [f"#{bytes(color).hex()}" for color in np.rint(channels).astype(np.uint8).T]
