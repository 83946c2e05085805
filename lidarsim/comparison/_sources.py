"""What `compare` takes as one side: clouds and scans, and the files, folders and bags that hold clouds."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sized
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidarsim._base.files import Place, natural
from lidarsim._base.validation import short_repr
from lidarsim.errors import ArgumentTypeError, FileFormatError
from lidarsim.io import rosbag
from lidarsim.scan.formats import is_point_cloud
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan

Given = PointCloud | Scan | str | os.PathLike[str] | Iterable[PointCloud | Scan | str | os.PathLike[str]]

FORMS = "a PointCloud, a Scan, a point cloud file, a ROS 2 bag, a folder of these, or an iterable of clouds or scans"
VENDOR_UNIT = 100.0
"""Reflectivity of a white diffuser in the units of the vendors, which are whole numbers of percent."""


@dataclass(frozen=True)
class Source:
    """The frames of one side.

    Attributes
    ----------
    name : str
        What it is, for the report; "" of an iterable.
    frames : iterator of PointCloud or Scan
        Read one by one.
    count : int or None
        Number of frames, where it is known before they are read.
    """

    name: str
    frames: Iterator[PointCloud | Scan]
    count: int | None


def source(argument: str, given: Given) -> Source:
    """Return one side of a comparison, `given` as one of `FORMS`; errors name the `argument`.

    Files are listed at once, and read as the frames are.

    Raises
    ------
    TypeError, ValueError, OSError
        If it is none of these, or there is nothing to read.
    """
    if isinstance(given, PointCloud | Scan):
        return Source(_find_name(given), iter([given]), 1)
    if isinstance(given, str | os.PathLike):
        place = Place(given)
        files = _files(place)
        count = None if any(map(rosbag.is_bag, files)) else len(files)
        return Source(str(Path(given)), place.each(_read(files)), count)
    frames: Iterator[object]
    try:
        frames, count = iter(given), len(given) if isinstance(given, Sized) else None
    except TypeError:
        raise ArgumentTypeError(argument, FORMS, short_repr(given)) from None
    if isinstance(given, list | tuple):
        frames = iter([Place(frame) if isinstance(frame, str | os.PathLike) else frame for frame in given])
    return Source("", _each(argument, frames), count)


def intensity_unit(first: PointCloud | Scan) -> float:
    """Return the intensity of a white diffuser in the units of a cloud.

    Whole numbers of which some are above 1 are a vendor's reflectivity in percent; all else is lidarsim's own.
    """
    if isinstance(first, Scan) or "intensity" not in first.fields or not len(first):
        return 1.0
    known = first.intensity[np.isfinite(first.intensity)]
    whole = known.size > 0 and bool((known == np.rint(known)).all() and known.max() > 1.0)
    return VENDOR_UNIT if whole else 1.0


def _find_name(given: PointCloud | Scan) -> str:
    return given.lidar.name or "scan" if isinstance(given, Scan) else "cloud"


def _each(argument: str, frames: Iterator[object]) -> Iterator[PointCloud | Scan]:
    for i, frame in enumerate(frames):
        if isinstance(frame, PointCloud | Scan):
            yield frame
        elif isinstance(frame, str | os.PathLike | Place):
            place = frame if isinstance(frame, Place) else Place(frame)
            yield from place.each(_read(_files(place)))
        else:
            raise ArgumentTypeError(f"{argument}[{i}]", "a PointCloud, a Scan or a path", short_repr(frame))


def _files(place: Place) -> list[Path]:
    """Return a file, or those of a folder and its subfolders that hold points, by the numbers in their names."""
    path = place.path
    if not path.is_dir():
        return [path]
    found = [
        file
        for file in path.rglob("*")
        if not any(part.startswith(".") for part in file.relative_to(path).parts)  # of what is being written
        and (is_point_cloud(file) or rosbag.is_bag(file))
        and file.suffix not in {".label", ".txt"}  # SemanticKITTI's labels, and notes, beside the points
        and file.is_file()
    ]
    if not found:
        raise FileFormatError(f"{place}: expected point clouds or bags in the folder, got none")
    return sorted(found, key=lambda file: [natural(part) for part in file.relative_to(path).parts])


def _read(files: list[Path]) -> Iterator[PointCloud]:
    for file in files:
        if not rosbag.is_bag(file):
            yield PointCloud.load(file)
            continue
        topic = None
        for message in rosbag.read(file):
            topic = topic or message.topic
            if message.topic != topic:
                raise FileFormatError(
                    f"{file}: expected the clouds of one sensor, got the topics {topic} and {message.topic}; "
                    "lidarsim.io.rosbag.read(…, topic=…) chooses one"
                )
            yield message.cloud
