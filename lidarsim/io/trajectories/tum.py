"""TUM trajectories: ``t x y z qx qy qz qw`` per line, in s and m.

Format: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

from lidarsim._base.lines import numbers
from lidarsim._base.validation import Floats
from lidarsim.io.trajectories._quaternions import poses_of, write_poses
from lidarsim.motion.formats import register_trajectory_format

COLUMNS = 8


def recognise(line: str) -> bool:
    """Return whether `line` is the first line of a TUM file."""
    return len(line.split()) == COLUMNS


def read(lines: Iterator[str]) -> tuple[Floats, Floats]:
    """Return times and poses."""
    return poses_of(numbers(line.split(), COLUMNS) for line in lines)


def write(times: Floats, poses: Floats, file: BinaryIO) -> None:
    """Write times and poses."""
    file.write(b"# timestamp tx ty tz qx qy qz qw\n")
    write_poses(times, poses, file, " ")


register_trajectory_format(
    "TUM", "t x y z qx qy qz qw in each line", recognise, read, suffixes=(".tum", ".txt"), write=write
)
