"""Statistics of the boxes of a data set, in one pass over its records."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.datasets.samples import RANGES

if TYPE_CHECKING:
    from lidarsim.datasets.layouts import Layout
    from lidarsim.datasets.samples import Annotation, Record

POINTS = (0.0, 1.0, 5.0, 20.0, 100.0, 500.0, 2000.0, np.inf)
"""Edges of the histogram of points on an instance."""

VISIBILITY = (0.0, 0.4, 0.6, 0.8, 1.0)
"""Edges of the histogram of visibility: nuScenes' levels."""


def _bins(edges: tuple[float, ...]) -> npt.NDArray[np.int64]:
    return np.zeros(len(edges) - 1, np.int64)


def _bin(value: float, edges: tuple[float, ...]) -> int:
    """Return the bin of a value from the first to the last edge; as in `numpy.histogram`, the last bin has its end."""
    return min(bisect_right(edges, value), len(edges) - 1) - 1


@dataclass
class BoxStatistics:
    """Sums over the boxes of a class in a split.

    Attributes
    ----------
    count, points : int
        Number of boxes, and of points on their instances.
    size : ndarray of float64, shape (3,)
        Sum of the lengths, widths and heights, m.
    distance : float
        Sum of the distances of the centres from the sensor, m.
    distances, numbers, visibilities : ndarray of int64
        Histograms of the distance, of the points and of the visibility, by the edges `RANGES`, `POINTS` and
        `VISIBILITY`; instances that no pulse would hit have no visibility.
    """

    count: int = 0
    points: int = 0
    size: Floats = field(default_factory=lambda: np.zeros(3))
    distance: float = 0.0
    distances: npt.NDArray[np.int64] = field(default_factory=lambda: _bins(RANGES))
    numbers: npt.NDArray[np.int64] = field(default_factory=lambda: _bins(POINTS))
    visibilities: npt.NDArray[np.int64] = field(default_factory=lambda: _bins(VISIBILITY))

    def add(self, box: Annotation, distance: float) -> None:
        """Add a box at a distance from the sensor, m."""
        self.count += 1
        self.points += box.points
        self.size += box.size
        self.distance += distance
        self.distances[_bin(distance, RANGES)] += 1
        self.numbers[_bin(box.points, POINTS)] += 1
        if box.visibility is not None:
            self.visibilities[_bin(box.visibility, VISIBILITY)] += 1


def box_statistics(
    layout: Layout, records: Iterable[Record], *, in_world: bool
) -> dict[tuple[int, str], BoxStatistics]:
    """Return the statistics by label and split, in ascending order of the label."""
    found: dict[tuple[int, str], BoxStatistics] = {}
    for _, frame in groupby(records, lambda record: (record.sequence, record.frame)):
        for record, box in layout.annotations(frame):
            origin = record.matrix[:3, 3] if in_world else np.zeros(3)
            there = found.setdefault((box.label, record.split), BoxStatistics())
            there.add(box, float(np.linalg.norm(box.center - origin)))
    return dict(sorted(found.items(), key=lambda item: item[0][0]))
