"""SemanticKITTI: scans, labels and poses as its development kit reads them.

``sequences/00/velodyne/000000.bin`` holds the points, ``labels/000000.label`` their classes and instances,
``poses.txt`` the poses in a camera frame, relative to the first, ``calib.txt`` the rotation from sensor to camera,
``times.txt`` the times since the first in s, and ``semantic-kitti.yaml`` the classes and the splits: ``val`` is called
``valid`` there, and without splits all sequences are in ``train``. With a rig, all of these are in a
folder per sensor. File k, counting from 0, belongs to line k of ``poses.txt`` and ``times.txt``, as readers of KITTI
expect: a sensor that is slower than the rig counts its own frames. ``seconds`` in ``manifest.jsonl`` is the time that
all sensors share.

Format: https://github.com/PRBonn/semantic-kitti-api, https://www.cvlibs.net/datasets/kitti/eval_odometry.php.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import groupby
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import yaml

from lidarsim.datasets.layouts._layout import Extra, Files, Layout, Noted, Summary, Write
from lidarsim.datasets.samples import Number, Record, Sample
from lidarsim.errors import LidarsimError
from lidarsim.io import kitti, semantickitti
from lidarsim.io.trajectories.kitti import write as write_poses
from lidarsim.rig import Rig
from lidarsim.viewers._classes import class_color
from lidarsim.viewers._colors import QUALITATIVE

if TYPE_CHECKING:
    from lidarsim.datasets.store import Store
    from lidarsim.run import Run
    from lidarsim.scan.fields import Fields

CLASSES = "semantic-kitti.yaml"

# KITTI's camera looks along z, with x right and y down; here it is at the sensor. There are no images, but readers
# expect the projections P0 to P3 of four cameras: identities.
CAMERA = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


class Numbered(Noted):
    """Number of a sample within its sensor's samples of the sequence."""

    number: Number


class SemanticKitti(Layout):
    """Scans, labels and poses for SemanticKITTI's development kit."""

    noted: ClassVar[type[Noted]] = Numbered
    greatest_label: ClassVar[int] = 2**16 - 1
    held: ClassVar[tuple[str, ...] | None] = ("intensity", "label", "instance")

    type: Literal["semantickitti"]

    def names(self, run: Run, sequences: int) -> set[str]:
        """Return a folder per sensor of a rig, or the names for a single sensor."""
        del sequences
        return set(run.sensor) if isinstance(run.sensor, Rig) else {"sequences", CLASSES}

    @contextmanager
    def writer(self, files: Files, shard: int) -> Iterator[Write]:
        """Yield a function that writes the two files of a sample."""
        del shard

        def write(sample: Sample) -> Extra:
            number = _number(sample)
            record, fields = sample.record, {name: getattr(sample.cloud, name) for name in sample.cloud.fields}
            about = {"points": record.points, "seconds": record.seconds, "seed": sample.run.seed}
            for folder, suffix, save in (("velodyne", "bin", kitti.save), ("labels", "label", semantickitti.save)):
                buffer = BytesIO()
                save(fields, buffer)
                files.write(f"{_folder(record)}/{folder}/{number:06}.{suffix}", buffer.getbuffer(), **about)
            return {"number": number}

        yield write

    def read(self, store: Store, record: Record) -> Fields:
        """Return coordinates, intensity, label and instance."""
        folder, number = _folder(record), record.extra["number"]
        with store.reading(f"{folder}/velodyne/{number:06}.bin") as path, path.open("rb") as file:
            fields = kitti.load(file, columns=list(kitti.NAMES))
        with store.reading(f"{folder}/labels/{number:06}.label") as path:
            label, instance = semantickitti.read_labels(path)
        return fields | {"label": label, "instance": instance}

    def finish(self, files: Files, summary: Summary) -> None:
        """Write poses, calibration and times of each sequence, and the classes."""
        sequences = []
        sensors = set()
        for sequence, group in groupby(summary.records(), lambda record: record.sequence):
            sequences.append(sequence)
            records = list(group)
            for sensor in sorted({record.sensor for record in records}):
                sensors.add(sensor)
                _finish(files, [record for record in records if record.sensor == sensor])
        text = yaml.safe_dump(_classes(summary.class_names, _splits(summary, sequences)), sort_keys=False).encode()
        for sensor in sorted(sensors):
            files.write(f"{_root(sensor)}{CLASSES}", text)


def _number(sample: Sample) -> int:
    """Return the number of a frame within its sensor's frames of the sequence."""
    run, name = sample.run, sample.record.sensor
    if not isinstance(run.sensor, Rig):
        return sample.record.frame
    first = run.frames.start
    return sample.scan.frame - run.sensor._numbers(run.sensor[name], first, first).start


def _root(sensor: str) -> str:
    return f"{sensor}/" if sensor else ""


def _folder(record: Record) -> str:
    return f"{_root(record.sensor)}sequences/{record.sequence:02}"


def _finish(files: Files, records: list[Record]) -> None:
    """Write the tables of a sensor in a sequence."""
    folder = _folder(records[0])
    numbers = [record.extra["number"] for record in records]
    if numbers != [*range(len(records))]:  # the rate varies between frames
        raise LidarsimError(f"{folder}: expected frames numbered from 0 to {len(records) - 1}, got {numbers[:20]} …")
    first = np.linalg.inv(records[0].matrix)
    to_sensor = CAMERA.T  # the inverse of a rotation
    poses = BytesIO()
    # The first pose is the exact identity, not the rounded product of a matrix and its inverse.
    relative = np.array([np.eye(4), *(CAMERA @ (first @ record.matrix) @ to_sensor for record in records[1:])])
    write_poses(np.zeros(len(records)), relative, poses)
    files.write(f"{folder}/poses.txt", poses.getvalue())
    files.write(
        f"{folder}/times.txt", "".join(f"{record.seconds - records[0].seconds:.9e}\n" for record in records).encode()
    )
    lines = {**{f"P{index}": np.eye(4) for index in range(4)}, "Tr": CAMERA}
    rows = (f"{name}: {' '.join(f'{value:.12e}' for value in matrix[:3].flat)}\n" for name, matrix in lines.items())
    files.write(f"{folder}/calib.txt", "".join(rows).encode())


def _splits(summary: Summary, sequences: list[int]) -> dict[str, list[int]]:
    """Return the splits by the kit's names, of which it needs three."""
    given = {"valid" if name == "val" else name: numbers for name, numbers in summary.splits.items()}
    return {"train": [] if given else sequences, "valid": [], "test": []} | given


def _classes(names: dict[int, str], splits: dict[str, list[int]]) -> dict[str, object]:
    """Return the classes in the kit's format; colours are blue, green, red."""
    labels = {0: "unlabeled", **names}
    learnt = {label: index for index, label in enumerate(sorted(labels))}
    return {
        "name": "lidarsim",
        "labels": dict(sorted(labels.items())),
        "color_map": {label: _color(label, labels[label]) if label else [0, 0, 0] for label in sorted(labels)},
        "learning_map": learnt,
        "learning_map_inv": {index: label for label, index in learnt.items()},
        "learning_ignore": {index: label == 0 for label, index in learnt.items()},
        "split": splits,
    }


def _color(label: int, name: str) -> list[int]:
    """Return blue, green and red, the order of the file."""
    color = class_color(name, label) or QUALITATIVE[label % len(QUALITATIVE)]
    return list(bytes.fromhex(color[1:]))[::-1]
