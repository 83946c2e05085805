"""Oriented boxes as lines, for all viewers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim._base.vectors import CUBE
from lidarsim.scan.boxes import Boxes

_EDGES = [(i, j) for i in range(8) for j in range(i) if np.abs(CUBE[i] - CUBE[j]).sum() == 1.0]
LINES = len(_EDGES) + 2
"""Number of lines of a box: its edges, and two on its roof that point where it heads."""


def lines(boxes: Boxes) -> Floats:
    """Return the lines of boxes, m: ndarray of float64, shape (m, `LINES`, 2, 3).

    The mark of the heading is an arrow head on the roof, from its front corners to a point half a width ahead.
    """
    corners = boxes.corners
    edges = corners[:, _EDGES]
    width = np.minimum(boxes.size[:, 0], boxes.size[:, 1])
    front = corners[:, [5, 7]]  # in the order of `numpy.ndindex`: (1, 0, 1) and (1, 1, 1), on the roof
    tip = front.mean(axis=1) + 0.5 * width[:, None] * boxes.rotation[:, :, 0]
    arrow = np.stack([front, np.broadcast_to(tip[:, None], front.shape)], axis=2)
    return np.concatenate([edges, arrow], axis=1)


def transform_boxes(boxes: Boxes, pose: Floats) -> Boxes:
    """Return boxes in other coordinates, to which a rigid transform of shape (4, 4) leads."""
    turn = pose[:3, :3]
    return replace(
        boxes,
        center=boxes.center @ turn.T + pose[:3, 3],
        rotation=turn @ boxes.rotation,
        velocity=boxes.velocity @ turn.T,
        in_sensor_frame=False,
    )
