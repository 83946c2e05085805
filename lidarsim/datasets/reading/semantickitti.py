"""SemanticKITTI: ``sequences/00/velodyne`` with ``labels``, ``poses.txt``, ``calib.txt`` and ``times.txt``.

Format: https://github.com/PRBonn/semantic-kitti-api.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lidarsim._base.files import parsing
from lidarsim._base.validation import Floats
from lidarsim.config.document import plain, read
from lidarsim.datasets.frames import (
    Frame,
    Frames,
    folders,
    in_world,
    load_labelled,
    name_classes,
    names_in,
    numbers,
    only,
    point_files,
    text_of,
)
from lidarsim.datasets.reading.kitti import read_calibration
from lidarsim.errors import FileFormatError
from lidarsim.io.trajectories import kitti
from lidarsim.viewers._classes import SEMANTIC_KITTI

CLASSES = "semantic-kitti.yaml"


def recognise(folder: Path) -> bool:
    """Return whether a folder is a data set, one sensor of it, or one sequence."""
    return bool(_roots(folder)) or (folder / "velodyne").is_dir()


def open_frames(folder: Path) -> Frames:
    """Return the frames of all sequences of a sensor, in their order."""
    roots = _roots(folder)
    root = roots[0] if roots else folder
    sequences = folders(root / "sequences") if roots else [folder]
    clouds = [
        (sequence, point_files(sequence / "velodyne")) for sequence in sequences if (sequence / "velodyne").is_dir()
    ]
    classes = next((path for path in (root / CLASSES, root.absolute().parent.parent / CLASSES) if path.is_file()), None)
    names = {label: name for label, (name, _) in SEMANTIC_KITTI.items()}
    if classes is not None:
        found = plain(read(classes))
        names = names_in(found.get("labels") if isinstance(found, dict) else found, classes)

    def frames(first: int) -> Iterator[Frame]:
        for sequence, files in clouds:
            if first >= len(files):
                first -= len(files)
                continue
            poses, times = _poses(sequence, len(files)), _times(sequence, len(files))
            for number in range(first, len(files)):
                path = files[number]
                cloud = load_labelled(path, sequence / "labels" / f"{path.stem}.label")
                yield in_world(cloud, poses[number], None, times[number])
            first = 0

    count = sum(len(files) for _, files in clouds)
    return Frames("SemanticKITTI", count, lambda first: name_classes(frames(first), names), names, only(roots))


def _roots(folder: Path) -> list[Path]:
    """Return the folders that have sequences: one, or one per sensor of a rig."""
    return [path for path in (folder, *folders(folder)) if (path / "sequences").is_dir()]


def _poses(sequence: Path, count: int) -> list[Floats]:
    """Return the poses of the sensor; ``poses.txt`` has those of a camera."""
    path, calibration = sequence / "poses.txt", sequence / "calib.txt"
    if not path.is_file():
        return [np.eye(4)] * count
    with parsing(path, "file of KITTI poses"):
        _, poses = kitti.read(iter(text_of(path).splitlines()))
    if len(poses) < count:
        raise FileFormatError(f"{path}: expected a pose for each of the {count} frames, got {len(poses)}")
    found = read_calibration(calibration, {"Tr": (3, 4)}) if calibration.is_file() else {}
    to_camera = found.get("Tr", np.eye(4))
    if not np.linalg.det(to_camera):
        raise FileFormatError(f"{calibration}: Tr: expected a transform that can be inverted, got a singular one")
    back = np.linalg.inv(to_camera)
    return [back @ pose @ to_camera for pose in poses]


def _times(sequence: Path, count: int) -> list[float | None]:
    path = sequence / "times.txt"
    if not path.is_file():
        return [None] * count
    times: list[float | None] = []
    for number, line in enumerate(text_of(path).splitlines(), 1):
        times += numbers(path, number, line.split())
    if len(times) < count:
        raise FileFormatError(f"{path}: expected a time for each of the {count} frames, got {len(times)}")
    return times
