"""KITTI's object detection: ``training/velodyne``, ``label_2`` and ``calib``; points in the sensor frame.

Format: https://www.cvlibs.net/datasets/kitti/eval_object.php, the object development kit, readme.txt.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from lidarsim._base.shown import plain
from lidarsim._base.validation import Floats
from lidarsim.datasets.frames import Frame, Frames, boxes_at, folders, numbers, only, point_files, text_of
from lidarsim.errors import FileFormatError
from lidarsim.scan.boxes import Boxes
from lidarsim.scan.pointcloud import PointCloud

KINDS = ("Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Cyclist", "Tram", "Misc")
IGNORED = "DontCare"
PARTS = ("training", "testing", ".")
COLUMNS = (15, 16)
"""Columns of a label, without and with the score of a detector."""


def recognise(folder: Path) -> bool:
    """Return whether a folder is the benchmark, one sensor of it, or one of ``training`` and ``testing``."""
    return bool(_roots(folder))


def open_frames(folder: Path) -> Frames:
    """Return the frames of training, then those of testing."""
    roots = _roots(folder)
    files = [path for part in _parts(roots[0]) for path in point_files(part / "velodyne")]
    kinds = dict.fromkeys(KINDS)

    def read(first: int) -> Iterator[Frame]:
        for path in files[first:]:
            label = path.parents[1] / "label_2" / f"{path.stem}.txt"
            boxes = None
            if label.exists():
                boxes = _boxes(label, _to_camera(path.parents[1] / "calib" / label.name), kinds)
            yield Frame(PointCloud.load(path), boxes=boxes)

    labelled = any((part / "label_2").is_dir() for part in _parts(roots[0]))
    notes = [only(roots), "boxes are only of what the camera ahead sees" if labelled else ""]
    return Frames("KITTI detection", len(files), read, note="; ".join(filter(None, notes)))


def _roots(folder: Path) -> list[Path]:
    """Return the folders that have the benchmark: one, or one per sensor of a rig."""
    return [path for path in (folder, *folders(folder)) if path.name not in PARTS[:2] and _parts(path)] or (
        [folder] if _parts(folder) else []
    )


def _parts(folder: Path) -> list[Path]:
    """Return the folders that have points and calibrations."""
    parts = [folder / part for part in PARTS]
    return [part for part in parts if (part / "velodyne").is_dir() and (part / "calib").is_dir()]


def read_calibration(path: Path, shapes: Mapping[str, tuple[int, int]]) -> dict[str, Floats]:
    """Return matrices of these names and shapes in a calibration of KITTI, each as the upper left of one of (4, 4)."""
    found: dict[str, Floats] = {}
    for number, line in enumerate(text_of(path).splitlines(), 1):
        name, colon, rest = line.partition(":")
        if colon and (shape := shapes.get(name)):
            values = numbers(path, number, rest.split())
            if len(values) != np.prod(shape):
                raise FileFormatError(f"{path}: {name}: expected {np.prod(shape)} numbers, got {len(values)}")
            found[name] = np.eye(4)
            found[name][: shape[0], : shape[1]] = np.reshape(values, shape)
    return found


def _to_camera(path: Path) -> Floats:
    """Return the transform from the sensor to the rectified camera, shape (4, 4)."""
    found = read_calibration(path, {"R0_rect": (3, 3), "Tr_velo_to_cam": (3, 4)})
    if len(found) != 2:
        raise FileFormatError(f"{path}: expected R0_rect and Tr_velo_to_cam, got {', '.join(found) or 'neither'}")
    matrix: Floats = found["R0_rect"] @ found["Tr_velo_to_cam"]
    if not np.linalg.det(matrix):
        raise FileFormatError(f"{path}: expected transforms that can be inverted, got a singular one")
    return matrix


def _boxes(path: Path, to_camera: Floats, kinds: dict[str, None]) -> Boxes:
    """Return the boxes of a frame in the sensor frame.

    A label gives height, width and length, the middle of the bottom in the camera's frame (x right, y down, z ahead)
    and the angle about y, at 0 of which the box heads along x.
    """
    centers, sizes, rotations, labels = [], [], [], []
    back = np.linalg.inv(to_camera)
    for number, line in enumerate(text_of(path).splitlines(), 1):
        words = line.split()
        if not words or words[0] == IGNORED:
            continue
        if len(words) not in COLUMNS:
            columns = " or ".join(map(str, COLUMNS))
            raise FileFormatError(f"{path}: line {number}: expected {columns} columns, got {len(words)}")
        *_, height, width, length, x, y, z, yaw = numbers(path, number, words[1:15])
        along = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        up = np.array([0.0, -1.0, 0.0])
        centers.append(back[:3] @ [x, y - height / 2, z, 1.0])
        rotations.append(back[:3, :3] @ np.stack([along, np.cross(up, along), up], axis=1))
        sizes.append([length, width, height])
        kinds.setdefault(plain(words[0], most=40))
        labels.append(list(kinds).index(plain(words[0], most=40)) + 1)
    names = {label: name for label, name in enumerate(kinds, 1) if label in labels}
    return boxes_at(np.array(centers), np.array(sizes), np.array(rotations), labels, names)
