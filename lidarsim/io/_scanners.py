"""Text of terrestrial scanners, shared by PTS and PTX: x y z, intensity and colours, without names."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import BinaryIO

import numpy as np

from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError
from lidarsim.io._records import blocks, joined, parsed
from lidarsim.io._units import fitting
from lidarsim.scan.pointcloud import Fields

COLOURS = ("red", "green", "blue")
TYPES = {**dict.fromkeys("xyz", "f8"), "intensity": "f4", **dict.fromkeys(COLOURS, "u1")}
LINES = 1 << 11
"""Lines in memory at a time."""


@contextmanager
def lines_of(file: BinaryIO, begins: str) -> Iterator[Iterator[str]]:
    """Yield an iterator over the lines of a file that are not blank; the error for none says how a file `begins`."""
    text = io.TextIOWrapper(file, "utf-8-sig", "replace")
    try:
        lines = (line for line in text if not line.isspace())
        first = next(lines, None)
        if first is None:
            raise FileFormatError(f"expected the {begins}, got nothing")
        yield itertools.chain([first], lines)
    finally:
        text.detach()


def whole_number(line: str, what: str) -> int:
    """Return the number of a line that has one only."""
    if not re.fullmatch(r"\d{1,18}", line.strip()):
        raise FileFormatError(f"{what}: expected a whole number, got {short(repr(line.strip()))}")
    return int(line)


def points_of(lines: Iterator[str], count: int, layouts: Mapping[int, tuple[str, ...]]) -> Iterator[Fields]:
    """Yield the columns of the next `count` lines, block by block; memory follows what is there, not the number.

    The number of columns of the first line tells their names.
    """
    if not count:
        return
    first = next(lines, "")
    found = len(first.split())
    if found not in layouts:
        expected = " or ".join(map(str, layouts))
        raise FileFormatError(f"expected {expected} columns, got {found}" if first else "it is truncated: no points")
    dtype = np.dtype([(name, TYPES[name]) for name in layouts[found]])
    yield from parsed(itertools.chain([first], lines), dtype, count, LINES)


def joined_lists(parts: Iterable[Fields]) -> Fields:
    """Join the blocks of several lists of points; there are none if all are empty."""
    known: list[str] = []

    def alike() -> Iterator[Fields]:
        for part in parts:
            known[:] = known or part
            if list(part) != known:
                raise FileFormatError(
                    f"expected lists of the same columns, got {', '.join(known)} and {', '.join(part)}"
                )
            yield part

    return joined(alike()) or {name: np.empty(0) for name in "xyz"}


def coloured(fields: Fields) -> Fields:
    """Return the colours of a cloud by name, as bytes; none unless it has all three."""
    if not all(name in fields and fields[name].ndim == 1 for name in COLOURS):
        return {}
    return {name: fitting(name, fields[name], np.uint8, "a colour") for name in COLOURS}


def check_finite(fields: Fields) -> None:
    """Raise an error if a coordinate is not finite."""
    wrong = ~np.isfinite(fields["xyz"]).all(axis=1)
    if wrong.any():
        i = int(np.argmax(wrong))
        raise FileFormatError(f"xyz: expected finite coordinates, got xyz[{i}] = {fields['xyz'][i].tolist()}")


def write_lines(columns: Fields, file: BinaryIO) -> None:
    """Write a line per point, each number with the fewest digits that restore it."""
    for block in blocks(columns, LINES):
        # An item of a float32 array prints as float32; tolist would widen it.
        texts = (map(str, part if part.dtype == np.float32 else part.tolist()) for part in block.values())
        file.writelines(f"{' '.join(row)}\n".encode("ascii") for row in zip(*texts, strict=True))
