"""Tables of nuScenes with lidarseg and boxes, as its development kit reads them.

``v1.0-lidarsim/`` holds the tables, ``samples/LIDAR_TOP/`` the points of key frames, ``sweeps/LIDAR_TOP/`` those of the
frames between them, and ``lidarseg/v1.0-lidarsim/`` a uint8 class per point of key frames. A sequence is a scene. With
``key_every: 10``, every tenth frame, the first included, is a key frame, that is, a sample; by default every frame is.
The sensor of a run is LIDAR_TOP; sensors of a rig are LIDAR_ and their names. Points keep lidarsim's axes, x forward;
``calibrated_sensor`` accounts for this. The map is empty. The kit only knows the colours of nuScenes' own classes; for
others it needs those in ``colormap.json``::

    NuScenes("v1.0-lidarsim", folder, colormap=json.loads(Path(folder, "colormap.json").read_text()))

Each instance with points in a key frame has one annotation, the box of `Scan.boxes` at the time of the sample, with the
points of all sensors. The points of a key frame are deskewed to that time for all sensors, and those of a sweep to its
own; points of moving instances are moved along. With ``cloud: {deskew: false}`` they are raw, and each box is where its
points are on average. Categories are the classes. Attributes are nuScenes' own for classes named ``vehicle.…`` or
``human.pedestrian.…``, and ``moving`` or ``still`` for others. Visibility is the share of the instance's pulses that
reach it, for the sensor that sees it best.

Splits are in ``v1.0-lidarsim/splits.json``, where the kit finds them by the names ``lidarsim_train`` and so on: it
gives the scenes of nuScenes itself for ``train``.

Format: https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from lidarsim._base.validation import Floats, short_repr
from lidarsim._base.vectors import inverse, product
from lidarsim.datasets.layouts._images import black_png
from lidarsim.datasets.layouts._layout import (
    AnyBoxFilter,
    BoxFilter,
    Extra,
    Files,
    Notes,
    SampleFiles,
    Summary,
    class_name,
    encode,
)
from lidarsim.datasets.samples import Annotation, Record, Sample
from lidarsim.errors import ArgumentValueError
from lidarsim.io import nuscenes
from lidarsim.io._units import integers
from lidarsim.viewers._classes import class_color
from lidarsim.viewers._colors import QUALITATIVE

if TYPE_CHECKING:
    from lidarsim.datasets.store import Store
    from lidarsim.run import Run
    from lidarsim.scan.fields import Fields

VERSION, COLORS, LABELS = "v1.0-lidarsim", "colormap.json", "lidarseg"
POINTS, SWEEPS, MAPS = "samples", "sweeps", "maps"
NOISE = {0: "noise"}
"""Name of label 0, unless it has another."""

SPLIT = "lidarsim_"
"""Prefix of the names of splits: the kit has nuScenes' own scenes under names such as train."""

START, APART = 1_577_836_800_000_000, 3_600_000_000
"""Time 0 of the first sequence, the start of 2020, and time between sequences, µs: the kit sorts scenes by their times,
which must differ."""

VISIBILITY = {"1": (0, 40), "2": (40, 60), "3": (60, 80), "4": (80, 100)}
"""Visibility levels of nuScenes by token, %."""

MOTION = {
    "human.pedestrian.": ("pedestrian.moving", "pedestrian.standing"),
    **dict.fromkeys(("vehicle.bicycle", "vehicle.motorcycle"), ("cycle.with_rider", "cycle.without_rider")),
    "vehicle.": ("vehicle.moving", "vehicle.parked"),
}
"""Attributes of instances that move and of those that do not, by the beginning of their class."""


class NuScenes(SampleFiles):
    """Tables of nuScenes with lidarseg and boxes."""

    notes: ClassVar[type[Notes]] = Notes
    greatest_label: ClassVar[int] = 255
    columns: ClassVar[tuple[str, ...] | None] = ("intensity", "label", "ring")
    reading: ClassVar[str] = f"""
nuScenes' development kit only knows the colours of its own classes; those of this data set are in `{COLORS}`:

```python
import json
from pathlib import Path

from nuscenes import NuScenes

colors = json.loads(Path(FOLDER, "{COLORS}").read_text())
data = NuScenes("{VERSION}", FOLDER, colormap=colors)
```
"""

    type: Literal["nuscenes"]
    boxes: AnyBoxFilter = BoxFilter()
    """Selection of boxes."""
    key_every: Annotated[int, Field(ge=1)] = 1
    """Every how many frames one is a key frame; the others are sweeps. Some lack the slower sensors of a rig."""

    @property
    def least_points(self) -> int:
        """Least number of points of one sensor on an instance with a box: `min_points` is for all sensors together."""
        return min(self.boxes.min_points, 1)

    def shares_stamp(self, frame: int) -> bool:
        """Return whether a frame is a key frame."""
        return frame % self.key_every == 0

    def has_boxes(self, frame: int) -> bool:
        """Return whether a frame is a key frame."""
        return self.shares_stamp(frame)

    def check(self, run: Run) -> None:
        """Raise `ValueError` if a sensor's name cannot be that of a file, or two sensors have the same channel."""
        super().check(run)
        seen: dict[str, str] = {}
        for sensor in run.lidars:
            if (other := seen.setdefault(_channel(sensor), sensor)) != sensor:
                expected = "names that differ in more than case and LIDAR_"
                raise ArgumentValueError("sensors", expected, f"{other!r} and {sensor!r}")

    def check_classes(self, class_names: Mapping[int, str]) -> None:
        """Raise `ValueError` if two categories have one name: the kit finds them by it."""
        super().check_classes(class_names)
        seen: dict[str, int] = {}
        for label, name in (NOISE | {**class_names}).items():
            own = re.fullmatch(r"class_(0|[1-9][0-9]*)", name)
            if not name or not name.isprintable() or (own and own[1] != str(label)):
                expected = "printable text in nuscenes, and no other label's class_…"
                raise ArgumentValueError(f"class_names[{label}]", expected, short_repr(name))
            if (other := seen.setdefault(name, label)) != label:
                raise ArgumentValueError(
                    f"class_names[{label}]", f"another name than label {other} has", short_repr(name)
                )

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return the folders of tables, points, labels and maps, and the colours."""
        return {VERSION, POINTS, LABELS, MAPS, COLORS} | ({SWEEPS} if self.key_every > 1 else set())

    def annotations(self, frame: Iterable[Record]) -> Iterator[tuple[Record, Annotation]]:
        """Yield one box per instance of a key frame, with the points of all sensors and the greatest visibility."""
        merged: dict[int, tuple[Record, Annotation]] = {}
        for record in frame:
            for box in record.boxes if self.shares_stamp(record.frame) else ():
                first, other = merged.get(box.instance, (record, None))
                if other is not None:
                    shares = [share for share in (other.visibility, box.visibility) if share is not None]
                    points, best = other.points + box.points, max(shares, default=None)
                    box = dataclasses.replace(other, points=points, visibility=best)  # noqa: PLW2901
                merged[box.instance] = first, box
        least = self.boxes.min_points
        return (pair for _, pair in sorted(merged.items()) if pair[1].points >= least)

    def note(self, sample: Sample) -> Extra:
        """Return no notes."""
        return {}

    def contents(self, record: Record, sample: Sample) -> dict[str, bytes]:
        """Return points, and labels in key frames."""
        files = {self.points(record): encode(nuscenes.save, sample.cloud._arrays())}
        if self.shares_stamp(record.frame):
            label = integers("label", sample.cloud.label, np.uint8, "a class of lidarseg")
            files[_labels(record)] = label.tobytes()
        return files

    def read(self, store: Store, record: Record) -> Fields:
        """Return coordinates, intensity and ring, and the labels of key frames."""
        with store.reading(self.points(record)) as path, path.open("rb") as file:
            fields = nuscenes.load(file, columns=list(nuscenes.NAMES))
        if self.shares_stamp(record.frame):
            with store.open(_labels(record)) as file:
                fields["label"] = np.frombuffer(file.read(), np.uint8).astype(np.uint32)
        return fields

    def points(self, record: Record) -> str:
        """Return the name of the file with the points of a sample or sweep."""
        channel, folder = _channel(record.sensor), POINTS if self.shares_stamp(record.frame) else SWEEPS
        return f"{folder}/{channel}/{_scene(record.sequence)}__{channel}__{record.frame:06}.pcd.bin"

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the tables, each in one pass over the samples."""
        tables = _Tables(self, summary)
        for name in (
            *("attribute", "calibrated_sensor", "category", "ego_pose", "instance", "lidarseg", "log", "map", "sample"),
            *("sample_annotation", "sample_data", "scene", "sensor", "visibility"),
        ):
            files.write_json(f"{VERSION}/{name}.json", getattr(tables, name)())
        if summary.splits:
            splits = {SPLIT + name: [_scene(number) for number in numbers] for name, numbers in summary.splits.items()}
            files.write(f"{VERSION}/splits.json", json.dumps(splits).encode() + b"\n")
        files.write(f"{MAPS}/empty.png", black_png(1, 1))
        colors = {row["name"]: _color(row["index"], row["name"]) for row in tables.category()}
        files.write(COLORS, json.dumps(colors).encode() + b"\n")


def _color(label: int, name: str) -> list[int]:
    color = class_color(name) or QUALITATIVE[label % len(QUALITATIVE)]
    return list(bytes.fromhex(color[1:])) if label else [0, 0, 0]


def _categories(names: Mapping[int, str]) -> dict[int, str]:
    """Return the name of each label from 0 to the greatest: the kit needs consecutive indices."""
    known = NOISE | {**names}
    return {label: class_name(label, known) for label in range(max(known) + 1)}


def _attribute(category: str, *, moves: bool) -> str:
    moving, still = next((pair for start, pair in MOTION.items() if category.startswith(start)), ("moving", "still"))
    return moving if moves else still


def _channel(sensor: str) -> str:
    name = sensor.upper() or "TOP"
    return name if name.startswith("LIDAR_") else f"LIDAR_{name}"


def _scene(sequence: int) -> str:
    return f"scene-{sequence:04}"


def _labels(record: Record) -> str:
    name = f"{_scene(record.sequence)}__{_channel(record.sensor)}__{record.frame:06}"
    return f"{LABELS}/{VERSION}/{name}_lidarseg.bin"


def _stamp(record: Record) -> int:
    return START + record.sequence * APART + round(record.seconds * 1e6)


def _pose(matrix: Floats) -> dict[str, list[float]]:
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(matrix[:3, :3]).as_quat(canonical=True, scalar_first=True)
    return {"translation": matrix[:3, 3].tolist(), "rotation": quaternion.tolist()}


class _Tables:
    """The rows of each table."""

    def __init__(self, layout: NuScenes, summary: Summary) -> None:
        self.layout, self.summary = layout, summary
        self.categories = _categories(summary.class_names)

    def token(self, *parts: object) -> str:
        text = "/".join(map(str, (self.summary.digest, *parts)))
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def of(self, record: Record, table: str) -> str:
        return self.token(table, record.sequence, record.frame, record.sensor)

    def sequences(self) -> Iterator[list[Record]]:
        for _, records in groupby(self.summary.records(), lambda record: record.sequence):
            yield list(records)

    def key_frames(self, records: list[Record]) -> list[Record]:
        """Return the first record of each key frame."""
        firsts = (next(group) for _, group in groupby(records, lambda record: record.frame))
        return [record for record in firsts if self.layout.shares_stamp(record.frame)]

    def category(self) -> Iterator[dict[str, Any]]:
        for label, name in self.categories.items():
            yield {"token": self.token("category", label), "name": name, "description": "", "index": label}

    def attribute(self) -> Iterator[dict[str, Any]]:
        for name in dict.fromkeys(itertools.chain(*MOTION.values(), ("moving", "still"))):
            yield {"token": self.token("attribute", name), "name": name, "description": ""}

    def visibility(self) -> Iterator[dict[str, Any]]:
        for token, (low, high) in VISIBILITY.items():
            about = f"visibility of whole object is between {low} and {high}%"
            yield {"token": token, "level": f"v{low}-{high}", "description": about}

    def chains(self, records: list[Record]) -> dict[int, list[tuple[Record, Annotation]]]:
        """Return the boxes of each instance of a sequence in the order of time."""
        chains: dict[int, list[tuple[Record, Annotation]]] = {}
        for _, frame in groupby(records, lambda record: record.frame):
            for record, box in self.layout.annotations(frame):
                chains.setdefault(box.instance, []).append((record, box))
        return chains

    def box(self, record: Record, box: Annotation) -> str:
        return self.token("sample_annotation", record.sequence, record.frame, box.instance)

    def instance(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            for number, chain in self.chains(records).items():
                yield {
                    "token": self.token("instance", records[0].sequence, number),
                    "category_token": self.token("category", chain[0][1].label),
                    "nbr_annotations": len(chain),
                    "first_annotation_token": self.box(*chain[0]),
                    "last_annotation_token": self.box(*chain[-1]),
                }

    def sample_annotation(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            for number, chain in self.chains(records).items():
                tokens = ["", *itertools.starmap(self.box, chain), ""]
                for index, (record, box) in enumerate(chain):
                    attribute = _attribute(self.categories[box.label], moves=any(box.velocity))
                    length, width, height = box.size
                    seen = np.searchsorted([high for _, high in VISIBILITY.values()], 100 * (box.visibility or 0.0))
                    yield {
                        "token": tokens[index + 1],
                        "sample_token": self.token("sample", record.sequence, record.frame),
                        "instance_token": self.token("instance", record.sequence, number),
                        "attribute_tokens": [self.token("attribute", attribute)],
                        "visibility_token": [*VISIBILITY][seen],
                        "size": [width, length, height],
                        "num_lidar_pts": box.points,
                        "num_radar_pts": 0,
                        "prev": tokens[index],
                        "next": tokens[index + 2],
                        **_pose(product(record.matrix, box.matrix)),
                    }

    def log(self) -> Iterator[dict[str, Any]]:
        yield {
            "token": self.token("log"), "logfile": "", "vehicle": "lidarsim", "date_captured": "2020-01-01",
            "location": "lidarsim",
        }  # fmt: skip

    def map(self) -> Iterator[dict[str, Any]]:
        yield {
            "token": self.token("map"), "log_tokens": [self.token("log")], "category": "semantic_prior",
            "filename": f"{MAPS}/empty.png",
        }  # fmt: skip

    def sensor(self) -> Iterator[dict[str, Any]]:
        for channel in sorted({_channel(record.sensor) for record in self.summary.records()}):
            yield {"token": self.token("sensor", channel), "channel": channel, "modality": "lidar"}

    def calibrated_sensor(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            firsts = {record.sensor: record for record in reversed(records)}
            for name, record in sorted(firsts.items()):
                yield {
                    "token": self.token("calibrated_sensor", record.sequence, name),
                    "sensor_token": self.token("sensor", _channel(name)),
                    **_pose(product(inverse(record.body_matrix), record.matrix)),
                    "camera_intrinsic": [],
                }

    def scene(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            number, keys = records[0].sequence, self.key_frames(records)
            yield {
                "token": self.token("scene", number),
                "log_token": self.token("log"),
                "nbr_samples": len(keys),
                "first_sample_token": self.token("sample", number, keys[0].frame),
                "last_sample_token": self.token("sample", number, keys[-1].frame),
                "name": _scene(number),
                "description": "",
            }

    def sample(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            frames = self.key_frames(records)
            tokens = ["", *(self.token("sample", record.sequence, record.frame) for record in frames), ""]
            for index, record in enumerate(frames):
                yield {
                    "token": tokens[index + 1], "timestamp": _stamp(record), "prev": tokens[index],
                    "next": tokens[index + 2], "scene_token": self.token("scene", record.sequence),
                }  # fmt: skip

    def sample_data(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            keys = [record.frame for record in self.key_frames(records)]
            for name in sorted({record.sensor for record in records}):
                own = [record for record in records if record.sensor == name]
                tokens = ["", *(self.of(record, "sample_data") for record in own), ""]
                for index, record in enumerate(own):
                    following = keys[min(bisect_left(keys, record.frame), len(keys) - 1)]
                    yield {
                        "token": tokens[index + 1],
                        "sample_token": self.token("sample", record.sequence, following),
                        "ego_pose_token": self.of(record, "ego_pose"),
                        "calibrated_sensor_token": self.token("calibrated_sensor", record.sequence, name),
                        "timestamp": _stamp(record),
                        "fileformat": "pcd",
                        "is_key_frame": self.layout.shares_stamp(record.frame),
                        "height": 0,
                        "width": 0,
                        "filename": self.layout.points(record),
                        "prev": tokens[index],
                        "next": tokens[index + 2],
                    }

    def ego_pose(self) -> Iterator[dict[str, Any]]:
        for record in self.summary.records():
            yield {
                "token": self.of(record, "ego_pose"), "timestamp": _stamp(record), **_pose(record.body_matrix)
            }  # fmt: skip

    def lidarseg(self) -> Iterator[dict[str, Any]]:
        keys = (record for record in self.summary.records() if self.layout.shares_stamp(record.frame))
        for record in keys:
            token = self.of(record, "sample_data")
            yield {"token": token, "sample_data_token": token, "filename": _labels(record)}
