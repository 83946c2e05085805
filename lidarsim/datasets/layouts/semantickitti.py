"""SemanticKITTI: scans, labels and poses as its development kit reads them.

``sequences/00/velodyne/000000.bin`` holds the points, ``labels/000000.label`` their classes and instances,
``poses.txt`` the poses in a camera frame, relative to the first, ``calib.txt`` the rotation from sensor to camera,
``times.txt`` the times since the first in s, and ``semantic-kitti.yaml`` the classes, their shares of all points, by
which trainers weight them, and the splits: ``val`` is called ``valid`` there, and without splits all sequences are in
``train``. With a rig, all of these are in a folder per sensor. File k, counting from 0, belongs to line k of
``poses.txt`` and ``times.txt``, as readers of KITTI expect: a sensor that is slower than the rig counts its own frames.
``seconds`` in ``manifest.jsonl`` is the time that all sensors share.

Format: https://github.com/PRBonn/semantic-kitti-api, https://www.cvlibs.net/datasets/kitti/eval_odometry.php.
"""

from __future__ import annotations

from io import BytesIO
from itertools import groupby
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import yaml

from lidarsim._base.vectors import inverse, product
from lidarsim.datasets.layouts._kitti import TO_CAMERA, calibration, read_points
from lidarsim.datasets.layouts._layout import Extra, Files, SampleFiles, Summary, encode, number_name, root
from lidarsim.datasets.samples import Record, Sample
from lidarsim.errors import LidarsimError
from lidarsim.io import kitti, semantickitti
from lidarsim.io.trajectories.kitti import write as write_poses
from lidarsim.rig import Rig
from lidarsim.viewers._classes import class_color
from lidarsim.viewers._colors import QUALITATIVE

if TYPE_CHECKING:
    from lidarsim.datasets.store import Store
    from lidarsim.scan.fields import Fields

CLASSES = "semantic-kitti.yaml"


class SemanticKitti(SampleFiles):
    """Scans, labels and poses for SemanticKITTI's development kit."""

    greatest_label: ClassVar[int] = 2**16 - 1
    columns: ClassVar[tuple[str, ...] | None] = ("intensity", "label", "instance")
    top: ClassVar[tuple[str, ...]] = ("sequences", CLASSES)

    type: Literal["semantickitti"]

    def note(self, sample: Sample) -> Extra:
        """Return the number of a sample among those of its sensor in the sequence."""
        run, name = sample.run, sample.record.sensor
        if not isinstance(run.sensor, Rig):
            return {"number": sample.record.frame}
        first = run.frames.start
        return {"number": sample.scan.frame - run.sensor._numbers(run.sensor[name], first, first).start}

    def contents(self, record: Record, sample: Sample) -> dict[str, bytes]:
        """Return points and labels."""
        fields = sample.cloud._arrays()
        return {_points(record): encode(kitti.save, fields), _labels(record): encode(semantickitti.save, fields)}

    def read(self, store: Store, record: Record) -> Fields:
        """Return coordinates, intensity, label and instance."""
        fields = read_points(store, _points(record))
        with store.reading(_labels(record)) as path:
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
        classes = _classes(summary.class_names, summary.labels, _splits(summary, sequences))
        text = yaml.safe_dump(classes, sort_keys=False).encode()
        for sensor in sorted(sensors):
            files.write(f"{root(sensor)}{CLASSES}", text)


def _folder(record: Record) -> str:
    return f"{root(record.sensor)}sequences/{record.sequence:02}"


def _points(record: Record) -> str:
    return f"{_folder(record)}/velodyne/{number_name(record)}.bin"


def _labels(record: Record) -> str:
    return f"{_folder(record)}/labels/{number_name(record)}.label"


def _finish(files: Files, records: list[Record]) -> None:
    """Write the tables of a sensor in a sequence."""
    folder = _folder(records[0])
    numbers = [record.extra["number"] for record in records]
    if numbers != [*range(len(records))]:  # the rate varies between frames
        raise LidarsimError(f"{folder}: expected frames numbered from 0 to {len(records) - 1}, got {numbers[:20]} …")
    first = inverse(records[0].matrix)
    to_sensor = TO_CAMERA.T  # the inverse of a rotation
    poses = BytesIO()
    # The first pose is the exact identity, not the rounded product of a matrix and its inverse.
    relative = np.array(
        [np.eye(4), *(product(product(TO_CAMERA, product(first, record.matrix)), to_sensor) for record in records[1:])]
    )
    write_poses(np.zeros(len(records)), relative, poses)
    files.write(f"{folder}/poses.txt", poses.getvalue())
    times = (f"{record.seconds - records[0].seconds:.9e}\n" for record in records)
    files.write(f"{folder}/times.txt", "".join(times).encode())
    # There are no images, but readers expect the projections of four cameras.
    projections = {f"P{index}": np.eye(3, 4) for index in range(4)}
    files.write(f"{folder}/calib.txt", calibration(projections | {"Tr": TO_CAMERA[:3]}))


def _splits(summary: Summary, sequences: list[int]) -> dict[str, list[int]]:
    """Return the splits by the kit's names, of which it needs three."""
    given = {"valid" if name == "val" else name: numbers for name, numbers in summary.splits.items()}
    return {"train": [] if given else sequences, "valid": [], "test": []} | given


def _classes(names: dict[int, str], points: dict[int, int], splits: dict[str, list[int]]) -> dict[str, object]:
    """Return the classes in the kit's format: colours are blue, green, red; the content has shares of all points."""
    labels = {0: "unlabeled", **names}
    total = max(sum(points.values()), 1)
    learnt = {label: index for index, label in enumerate(sorted(labels))}
    return {
        "name": "lidarsim",
        "labels": dict(sorted(labels.items())),
        "color_map": {label: _color(label, labels[label]) if label else [0, 0, 0] for label in sorted(labels)},
        "content": {label: points.get(label, 0) / total for label in sorted(labels)},
        "learning_map": learnt,
        "learning_map_inv": {index: label for label, index in learnt.items()},
        "learning_ignore": {index: label == 0 for label, index in learnt.items()},
        "split": splits,
    }


def _color(label: int, name: str) -> list[int]:
    """Return blue, green and red, the order of the file."""
    color = class_color(name, label) or QUALITATIVE[label % len(QUALITATIVE)]
    return list(bytes.fromhex(color[1:]))[::-1]
