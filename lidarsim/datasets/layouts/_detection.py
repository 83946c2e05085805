"""What the layouts for detectors share: frames numbered through all sequences, and boxes with a heading and a class."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from lidarsim._base.validation import short_repr
from lidarsim._base.vectors import matvec, product
from lidarsim.datasets.layouts._layout import AnyBoxFilter, BoxFilter, Files, SampleFiles, Summary, class_name, root
from lidarsim.datasets.samples import Annotation
from lidarsim.errors import ArgumentValueError

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats

SETS = "ImageSets"
SPLITS = ("train", "val", "test")
"""Splits that readers expect, even if they are empty."""

IGNORED = "DontCare"
"""Class of labels that readers drop."""


@dataclass(frozen=True)
class Upright:
    """A box that is upright in the frame of the sensor.

    Attributes
    ----------
    center, size : ndarray of float64, shape (3,)
        Centre and size, m.
    axes : ndarray of float64, shape (3, 3)
        Its axes in the columns.
    yaw : float
        Heading from the x axis towards the y axis, rad.
    """

    center: Floats
    size: Floats
    axes: Floats
    yaw: float

    def values(self, height: float) -> list[float]:
        """Return x, y, z, length, width, height and heading, with z at a share of the height from the bottom."""
        x, y, z = self.center.tolist()
        length, width, tall = self.size.tolist()
        return [x, y, z + (height - 0.5) * tall, length, width, tall, self.yaw]


def upright(box: Annotation) -> Upright:
    """Return the upright box of the same centre and heading around a box."""
    turn, yaw = np.reshape(box.rotation, (3, 3)), math.atan2(box.rotation[3], box.rotation[0])
    axes = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return Upright(np.array(box.center), matvec(np.abs(product(axes.T, turn)), np.array(box.size)), axes, yaw)


class Detection(SampleFiles):
    """Base of layouts of points and labels per frame; the x, y, z and intensity of points are float32.

    Attributes
    ----------
    unfit : str
        Characters besides spaces that class names must not have.
    """

    columns: ClassVar[tuple[str, ...] | None] = ("intensity",)
    unfit: ClassVar[str] = ""

    boxes: AnyBoxFilter = BoxFilter()
    """Selection of boxes."""

    def check_classes(self, class_names: Mapping[int, str]) -> None:
        """Raise `ValueError` if a class name cannot stand in a label."""
        super().check_classes(class_names)
        labels = self.boxes.labels(class_names)
        for label, name in class_names.items():
            if labels is not None and label not in labels:
                continue
            fits = re.fullmatch(r"\S+", name) and not set(name) & set(self.unfit)
            if not name.isprintable() or not fits or name == IGNORED:
                without = " ".join(["spaces", *self.unfit])
                expected = f"printable text without {without}, and not {IGNORED}, in {self.type}"
                raise ArgumentValueError(f"class_names[{label}]", expected, short_repr(name))


def label_lines(boxes: Iterable[Annotation], names: Mapping[int, str], height: float) -> str:
    """Return a line per box: x, y, z, length, width, height, heading and class; see `Upright.values`."""
    rows = ((upright(box).values(height), class_name(box.label, names)) for box in boxes)
    return "".join(f"{' '.join(map(repr, values))} {name}\n" for values, name in rows)


def classes(summary: Summary, layout: Detection) -> dict[str, list[str]]:
    """Return by sensor the classes that its boxes in training have: in the order of the filter, else of their labels.

    Without boxes in training, they are those of all boxes.
    """
    found: dict[str, dict[bool, set[int]]] = {}
    for record in summary.records():
        part = found.setdefault(record.sensor, {True: set(), False: set()})[record.split in {"", SPLITS[0]}]
        part.update(box.label for box in record.boxes)
    asked = [name for name in layout.boxes.classes or () if isinstance(name, str)]
    rank = {name: number for number, name in enumerate(asked)}
    named: dict[str, list[str]] = {}
    for sensor, labels in found.items():
        names = dict.fromkeys(class_name(label, summary.class_names) for label in sorted(labels[True] or labels[False]))
        named[sensor] = sorted(names, key=lambda name: rank.get(name, len(rank)))
    return named


def write_sets(files: Files, summary: Summary) -> None:
    """Write the frames of each split; ``trainval`` has those of ``train`` and ``val``."""
    parts: dict[str, dict[str, list[int]]] = {}
    for record in summary.records():
        sets = parts.setdefault(record.sensor, {name: [] for name in (*SPLITS, *summary.splits)})
        sets[record.split or SPLITS[0]].append(record.extra["number"])
    for sensor, sets in sorted(parts.items()):
        both = {} if "trainval" in sets else {"trainval": sorted(sets["train"] + sets["val"])}
        for name, numbers in (sets | both).items():
            lines = "".join(f"{number:06}\n" for number in numbers)
            files.write(f"{root(sensor)}{SETS}/{name}.txt", lines.encode())


def point_range(boxes: Iterable[Annotation]) -> list[float]:
    """Return the least and then the greatest x, y and z of a range that holds boxes, m.

    Detectors need multiples of 16 voxels in x and y, and OpenPCDet's 40 in z. Sides of 6.4 m times a whole number suit
    voxels of 0.1 m, and 6 m in z those of 0.15 m. Without boxes, it is that of OpenPCDet's example.
    """
    reach, low, high = 0.0, math.inf, -math.inf
    for box in boxes:
        around = upright(box)
        reach = max(reach, float(np.abs(around.center[:2]).max() + np.hypot(*around.size[:2]) / 2))
        low = min(low, around.center[2] - around.size[2] / 2)
        high = max(high, around.center[2] + around.size[2] / 2)
    if not reach:
        return [-75.2, -75.2, -2.0, 75.2, 75.2, 4.0]
    side = round(math.ceil(reach / 3.2) * 3.2, 1)
    bottom = math.floor(low) - 1.0
    return [-side, -side, bottom, side, side, bottom + max(6.0, 2.0 * math.ceil((high - bottom) / 2))]
