"""Readers of data sets, for viewing: one module per layout, with a line in `READERS`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

from lidarsim._base.files import Place
from lidarsim.datasets.frames import Frame, Frames
from lidarsim.datasets.reading import bags, files, generated, kitti, nuscenes, semantickitti, shards

__all__ = ["Frame", "Frames", "open_frames"]


class Reader(Protocol):
    """A module that reads a layout."""

    def recognise(self, path: Path, /) -> bool:
        """Return whether a path has the layout."""

    def open_frames(self, path: Path, /) -> Frames:
        """Return its frames."""


READERS: tuple[Reader, ...] = (nuscenes, shards, kitti, semantickitti, bags, generated)
"""Readers of folders, in the order in which they are asked."""


def open_frames(path: Path) -> Frames:
    """Return the frames of a data set, a bag, a folder of point clouds or a point cloud file.

    Raises
    ------
    FileFormatError, LidarsimError
        If there is nothing to show, or a table of the data set is damaged; its points are read later.
    OSError
        If it cannot be read.
    """
    place = Place(path)
    with place.errors_as_given():
        readers = READERS if path.is_dir() else (bags,)
        reader = next((reader for reader in readers if reader.recognise(place.path)), files)
        opened = reader.open_frames(place.path)
    return replace(opened, read=lambda first: place.each(opened.read(first)))
