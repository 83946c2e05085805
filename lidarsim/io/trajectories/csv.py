"""CSV files of poses: the first line names the columns, including ``time_s,x_m,y_m,z_m,qx,qy,qz,qw``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

from lidarsim._base.lines import cells, numbers
from lidarsim._base.validation import Floats
from lidarsim.io.trajectories._quaternions import poses_of, write_poses
from lidarsim.motion.formats import register_trajectory_format

COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def recognise(line: str) -> bool:
    """Return whether `line` is the first line of a CSV file."""
    return "," in line


def read(lines: Iterator[str]) -> tuple[Floats, Floats]:
    """Return times and poses; other columns are skipped."""
    header = next(lines)
    names = cells(header)
    if any(names.count(name) != 1 for name in COLUMNS):
        raise ValueError(f"expected each of the columns {','.join(COLUMNS)} once, got others")
    places = [names.index(name) for name in COLUMNS]

    def row(line: str) -> list[float]:
        texts = cells(line)
        if len(texts) != len(names):
            raise ValueError(f"expected {len(names)} values, as the first line has names, got {len(texts)}")
        return numbers([texts[place] for place in places], len(COLUMNS))

    return poses_of(map(row, lines))


def write(times: Floats, poses: Floats, file: BinaryIO) -> None:
    """Write times and poses."""
    file.write((",".join(COLUMNS) + "\n").encode("ascii"))
    write_poses(times, poses, file, ",")


register_trajectory_format(
    "CSV", f"{','.join(COLUMNS)} in the first line", recognise, read, suffixes=(".csv",), write=write
)
