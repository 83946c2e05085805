"""Tables of nuScenes with lidarseg, as its development kit reads them.

``v1.0-lidarsim/`` holds the tables, ``samples/LIDAR_TOP/`` the points, ``lidarseg/v1.0-lidarsim/`` a uint8 class per
point. A sequence is a scene, and each frame a sample. The sensor of a run is LIDAR_TOP; sensors of a rig are LIDAR_ and
their names. Points keep lidarsim's axes, x forward; ``calibrated_sensor`` accounts for this. The map is empty. The kit
only knows the colours of nuScenes' own classes; for others it needs those in ``colormap.json``::

    NuScenes("v1.0-lidarsim", folder, colormap=json.loads(Path(folder, "colormap.json").read_text()))

Each instance with points in a frame gets an upright box at its pose at the time of the sample, with the heading of the
x axis of its first object. Unbounded objects, objects with a label per face and instance 0 get none. Categories are
the classes; the attribute is ``moving`` or ``still``. Visibility is a share of camera images: without cameras,
``visibility_token`` is an empty string, which the schema uses where nothing is annotated; ``num_lidar_pts`` tells how
well the lidars see an object. Points are deskewed only if the run says so: ``cloud: {deskew: start}`` moves them to the
time of the sample.

Format: https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import groupby
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from lidarsim._validation import Floats
from lidarsim.datasets.layouts._layout import Extra, Files, Layout, Noted, Summary, Write
from lidarsim.datasets.samples import Number, Record, Sample
from lidarsim.io import nuscenes
from lidarsim.io._units import fitting
from lidarsim.scene import SceneObject
from lidarsim.viewers._colors import QUALITATIVE

if TYPE_CHECKING:
    from lidarsim.run import Run

VERSION, COLORS, LABELS = "v1.0-lidarsim", "colormap.json", "lidarseg"
POINTS, MAPS = "samples", "maps"
START, APART = 1_577_836_800_000_000, 3_600_000_000
"""Time 0 of the first sequence, the start of 2020, and time between sequences, µs: the kit sorts scenes by their times,
which must differ."""

VISIBILITY = {"1": (0, 40), "2": (40, 60), "3": (60, 80), "4": (80, 100)}
"""Visibility levels of nuScenes by token, %."""


Three = Annotated[list[float], Field(min_length=3, max_length=3)]
Four = Annotated[list[float], Field(min_length=4, max_length=4)]


class NotedBox(Noted):
    """An instance with points in a frame."""

    instance: Number
    label: Annotated[int, Field(ge=0, le=255)]
    points: Number
    moving: bool
    translation: Three
    rotation: Four
    size: Three


class NotedBoxes(Noted):
    """The boxes of a sample."""

    boxes: list[NotedBox]


class NuScenes(Layout):
    """Tables of nuScenes with lidarseg and boxes."""

    noted: ClassVar[type[Noted]] = NotedBoxes
    greatest_label: ClassVar[int] = 255
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
    boxes: list[int] | None = None

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return the folders of tables, points, labels and maps, and the colours."""
        del run, sequences
        return {VERSION, POINTS, LABELS, MAPS, COLORS}

    @contextmanager
    def writer(self, files: Files, shard: int) -> Iterator[Write]:
        """Yield a function that writes the two files of a sample."""
        del shard
        sample_of: tuple[int, int] | None = None
        time = 0.0

        def write(sample: Sample) -> Extra:
            nonlocal sample_of, time
            if (sample.record.sequence, sample.record.frame) != sample_of:  # the first sensor's time counts
                sample_of, time = (sample.record.sequence, sample.record.frame), sample.record.seconds
            record, fields = sample.record, {name: getattr(sample.cloud, name) for name in sample.cloud.fields}
            about = {"points": record.points, "seconds": record.seconds, "seed": sample.run.seed}
            buffer = BytesIO()
            nuscenes.save(fields, buffer)
            files.write(_points(record), buffer.getbuffer(), **about)
            label = fitting("label", sample.cloud.label, np.uint8, "a class of lidarseg")
            files.write(_labels(record), label.astype(np.uint8).tobytes(), **about)
            return {"boxes": list(_boxes(sample, time, self.boxes))}

        yield write

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the tables, each in one pass over the samples."""
        tables = _Tables(summary)
        for name in (
            *("attribute", "calibrated_sensor", "category", "ego_pose", "instance", "lidarseg", "log", "map", "sample"),
            *("sample_annotation", "sample_data", "scene", "sensor", "visibility"),
        ):
            files.write_json(f"{VERSION}/{name}.json", getattr(tables, name)())
        files.write(f"{MAPS}/empty.png", _black_pixel())
        colors = {row["name"]: _color(row["index"]) for row in tables.category()}
        files.write(COLORS, json.dumps(colors).encode() + b"\n")


def _color(label: int) -> list[int]:
    return list(bytes.fromhex(QUALITATIVE[label % len(QUALITATIVE)][1:])) if label else [0, 0, 0]


def _boxes(sample: Sample, time: float, labels: list[int] | None) -> Iterator[dict[str, Any]]:
    """Yield the instances that have points, with their boxes at the given time."""
    found, counts = np.unique(sample.cloud.instance, return_counts=True)
    points = dict(zip(found.tolist(), counts.tolist(), strict=True))
    parts: dict[int, list[SceneObject]] = {}
    for item in sample.run.scene.objects:
        if item.instance and item.instance in points:
            parts.setdefault(item.instance, []).append(item)
    for instance, items in sorted(parts.items()):
        if not all(item.shape.bounded and isinstance(item.label, int) for item in items):
            continue
        if labels is None or items[0].label in labels:
            yield {
                "instance": instance, "label": items[0].label, "points": points[instance],
                "moving": any(item.motion is not None for item in items), **_box(items, time),
            }  # fmt: skip


def _box(items: list[SceneObject], time: float) -> dict[str, list[float]]:
    """Return the upright box around objects in the kit's format: width before length."""
    places = [np.eye(4) if item.transform is None else item.transform for item in items]
    for index, item in enumerate(items):
        if item.motion is not None:
            places[index] = item.motion.at(time).as_matrix() @ places[index]
    yaw = np.arctan2(places[0][1, 0], places[0][0, 0])
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    bounds = np.array([item.shape._image(turn.T @ place).bounds() for item, place in zip(items, places, strict=True)])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    length, width, height = (high - low).tolist()
    return {
        "translation": (turn[:3, :3] @ (low + high) / 2).tolist(),
        "rotation": [float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))],
        "size": [width, length, height],
    }


def _channel(sensor: str) -> str:
    return f"LIDAR_{sensor.upper()}" if sensor else "LIDAR_TOP"


def _points(record: Record) -> str:
    channel = _channel(record.sensor)
    return f"{POINTS}/{channel}/scene-{record.sequence:04}__{channel}__{record.frame:06}.pcd.bin"


def _labels(record: Record) -> str:
    name = f"scene-{record.sequence:04}__{_channel(record.sensor)}__{record.frame:06}"
    return f"{LABELS}/{VERSION}/{name}_lidarseg.bin"


def _stamp(record: Record) -> int:
    return START + record.sequence * APART + round(record.seconds * 1e6)


def _placed(matrix: Floats) -> dict[str, list[float]]:
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(matrix[:3, :3]).as_quat(canonical=True, scalar_first=True)
    return {"translation": matrix[:3, 3].tolist(), "rotation": quaternion.tolist()}


class _Tables:
    """The rows of each table."""

    def __init__(self, summary: Summary) -> None:
        self.summary = summary

    def token(self, *parts: object) -> str:
        text = "/".join(map(str, (self.summary.digest, *parts)))
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def of(self, record: Record, table: str) -> str:
        return self.token(table, record.sequence, record.frame, record.sensor)

    def sequences(self) -> Iterator[list[Record]]:
        for _, records in groupby(self.summary.records(), lambda record: record.sequence):
            yield list(records)

    def frames(self, records: list[Record]) -> list[Record]:
        """Return the first record of each frame."""
        return [next(group) for _, group in groupby(records, lambda record: record.frame)]

    def category(self) -> Iterator[dict[str, Any]]:
        names = {0: "noise", **self.summary.class_names}
        for label in range(max(names) + 1):  # the kit needs consecutive indices
            name = names.get(label, f"class_{label}")
            yield {"token": self.token("category", label), "name": name, "description": "", "index": label}

    def attribute(self) -> Iterator[dict[str, Any]]:
        for name in ("moving", "still"):
            yield {"token": self.token("attribute", name), "name": name, "description": ""}

    def visibility(self) -> Iterator[dict[str, Any]]:
        for token, (low, high) in VISIBILITY.items():
            about = f"visibility of whole object is between {low} and {high}%"
            yield {"token": token, "level": f"v{low}-{high}", "description": about}

    def annotations(self, records: list[Record]) -> dict[int, list[dict[str, Any]]]:
        """Return the boxes of each instance of a sequence, frame by frame, counting the points of all sensors."""
        chains: dict[int, list[dict[str, Any]]] = {}
        for record in records:
            for box in record.extra["boxes"]:
                chain = chains.setdefault(box["instance"], [])
                if chain and chain[-1]["frame"] == record.frame:
                    chain[-1]["points"] += box["points"]
                else:
                    token = self.token("sample_annotation", record.sequence, record.frame, box["instance"])
                    chain.append({"token": token, "frame": record.frame, **box})
        return chains

    def instance(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            for number, chain in self.annotations(records).items():
                yield {
                    "token": self.token("instance", records[0].sequence, number),
                    "category_token": self.token("category", chain[0]["label"]),
                    "nbr_annotations": len(chain),
                    "first_annotation_token": chain[0]["token"],
                    "last_annotation_token": chain[-1]["token"],
                }

    def sample_annotation(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            sequence = records[0].sequence
            for number, chain in self.annotations(records).items():
                tokens = ["", *(box["token"] for box in chain), ""]
                for index, box in enumerate(chain):
                    yield {
                        "token": tokens[index + 1],
                        "sample_token": self.token("sample", sequence, box["frame"]),
                        "instance_token": self.token("instance", sequence, number),
                        "attribute_tokens": [self.token("attribute", "moving" if box["moving"] else "still")],
                        "visibility_token": "",
                        "translation": box["translation"],
                        "size": box["size"],
                        "rotation": box["rotation"],
                        "num_lidar_pts": box["points"],
                        "num_radar_pts": 0,
                        "prev": tokens[index],
                        "next": tokens[index + 2],
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
                    **_placed(np.linalg.inv(record.body_matrix) @ record.matrix),
                    "camera_intrinsic": [],
                }

    def scene(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            number = records[0].sequence
            yield {
                "token": self.token("scene", number),
                "log_token": self.token("log"),
                "nbr_samples": len(self.frames(records)),
                "first_sample_token": self.token("sample", number, records[0].frame),
                "last_sample_token": self.token("sample", number, records[-1].frame),
                "name": f"scene-{number:04}",
                "description": "",
            }

    def sample(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            frames = self.frames(records)
            tokens = ["", *(self.token("sample", record.sequence, record.frame) for record in frames), ""]
            for index, record in enumerate(frames):
                yield {
                    "token": tokens[index + 1], "timestamp": _stamp(record), "prev": tokens[index],
                    "next": tokens[index + 2], "scene_token": self.token("scene", record.sequence),
                }  # fmt: skip

    def sample_data(self) -> Iterator[dict[str, Any]]:
        for records in self.sequences():
            for name in sorted({record.sensor for record in records}):
                own = [record for record in records if record.sensor == name]
                tokens = ["", *(self.of(record, "sample_data") for record in own), ""]
                for index, record in enumerate(own):
                    yield {
                        "token": tokens[index + 1],
                        "sample_token": self.token("sample", record.sequence, record.frame),
                        "ego_pose_token": self.of(record, "ego_pose"),
                        "calibrated_sensor_token": self.token("calibrated_sensor", record.sequence, name),
                        "timestamp": _stamp(record),
                        "fileformat": "pcd",
                        "is_key_frame": True,
                        "height": 0,
                        "width": 0,
                        "filename": _points(record),
                        "prev": tokens[index],
                        "next": tokens[index + 2],
                    }

    def ego_pose(self) -> Iterator[dict[str, Any]]:
        for record in self.summary.records():
            yield {
                "token": self.of(record, "ego_pose"), "timestamp": _stamp(record), **_placed(record.body_matrix)
            }  # fmt: skip

    def lidarseg(self) -> Iterator[dict[str, Any]]:
        for record in self.summary.records():
            token = self.of(record, "sample_data")
            yield {"token": token, "sample_data_token": token, "filename": _labels(record)}


def _black_pixel() -> bytes:
    """Return a PNG of one black pixel, since the kit opens a map."""
    chunks = (b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(b"\0\0")), (b"IEND", b"")
    parts = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
