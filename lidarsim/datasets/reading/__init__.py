"""Readers of data sets, for viewing: one module per layout, with a line in `READERS`."""

from __future__ import annotations

from pathlib import Path

from lidarsim.datasets.reading import bags, files, kitti, nuscenes, semantickitti, shards
from lidarsim.datasets.reading._frames import Frame, Frames

__all__ = ["Frame", "Frames", "open_frames"]

READERS = (nuscenes, shards, kitti, semantickitti)
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
    readers = READERS if path.is_dir() else ()
    reader = next((reader for reader in (*readers, bags) if reader.recognise(path)), files)
    return reader.open_frames(path)
