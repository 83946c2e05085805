"""Text of terrestrial scanners, shared by PTS and PTX: x y z, intensity and colours, without names."""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.io._records import blocks, decoded, parse_block
from lidarsim.io._units import integers
from lidarsim.scan.fields import CANONICAL, Fields

COLOURS = ("red", "green", "blue")
TYPES = {**dict.fromkeys("xyz", "f8"), "intensity": "f4", **dict.fromkeys(COLOURS, "u1")}
LINES = 1 << 11
"""Lines in memory at a time."""


@contextmanager
def lines_of(file: BinaryIO, begins: str) -> Iterator[Iterator[str]]:
    """Yield an iterator over the lines of a file that are not blank; the error for none says how a file `begins`."""
    with decoded(file) as text:
        lines = (line for line in text if not line.isspace())
        first = next(lines, None)
        if first is None:
            raise FileFormatError(f"expected the {begins}, got nothing")
        yield itertools.chain([first], lines)


def whole_number(line: str, what: str) -> int:
    """Return the number of a line that has one only."""
    if not re.fullmatch(r"\d{1,18}", line.strip()):
        raise FileFormatError(f"{what}: expected a whole number, got something else")  # not quoted: it may be any file
    return int(line)


def points_of(lines: Iterator[str], count: int, layouts: Mapping[int, tuple[str, ...]]) -> Iterator[Fields]:
    """Yield the columns of the next `count` lines, block by block; memory follows what is there, not the number.

    The number of columns of a line tells their names.
    """
    read = 0
    while read < count:
        part = list(itertools.islice(lines, min(LINES, count - read)))
        if not part:
            raise FileFormatError(f"it is truncated: {read or 'no'}{f' of {count}' if read else ''} points")
        widths = [len(line.split()) for line in part]
        for i, width in enumerate(widths):
            if width not in layouts:
                expected = " or ".join(map(str, layouts))
                raise FileFormatError(f"point {read + i}: expected {expected} columns, got {width}")
        if len(set(widths)) == 1:
            yield _block(part, layouts[widths[0]], read)
        else:
            yield _parse_mixed(part, widths, layouts, read)
        read += len(part)


def _block(lines: list[str], names: Sequence[str], first: int) -> Fields:
    return parse_block(lines, np.dtype([(name, TYPES[name]) for name in names]), first)


def _parse_mixed(lines: list[str], widths: list[int], layouts: Mapping[int, tuple[str, ...]], first: int) -> Fields:
    """Return the columns of lines of different layouts, in their order."""
    parts, places = list[Fields](), list[int]()
    for width in sorted(set(widths)):
        chosen = [i for i, other in enumerate(widths) if other == width]
        parts.append(_block([lines[i] for i in chosen], layouts[width], first))
        places += chosen
    order = np.argsort(places)
    return {name: column[order] for name, column in join_lists(parts).items()}


def join_lists(parts: Iterable[Fields]) -> Fields:
    """Join the blocks of several lists of points; there are none if all are empty.

    Where a list lacks a column, its points have NaN there, or 0 if the column is of integers.
    """
    lists: defaultdict[str, list[npt.NDArray[Any]]] = defaultdict(list)
    points = 0
    for part in parts:
        for name in "xyz":
            if name not in part:
                raise FileFormatError(f"it has points without {name}")
        count = len(part["x"])
        for name in {**part, **lists}:
            column = np.array(part[name]) if name in part else _missing(name, lists[name][0].dtype, count)
            if name not in lists and points:
                lists[name].append(_missing(name, column.dtype, points))
            lists[name].append(column)
        points += count
    return {name: np.concatenate(lists.pop(name)) for name in list(lists)} or {name: np.empty(0) for name in "xyz"}


def _missing(name: str, dtype: np.dtype[Any], count: int) -> npt.NDArray[Any]:
    """Return what points without a column have in it."""
    is_integer = np.dtype(CANONICAL.get(name, ((), dtype))[1]).kind in "iu"
    return np.zeros(count, dtype) if is_integer or dtype.kind in "iu" else np.full(count, np.nan, dtype)


def colours_of(fields: Fields) -> Fields:
    """Return the colours of a cloud by name, as bytes; none unless it has all three."""
    if not all(name in fields and fields[name].ndim == 1 for name in COLOURS):
        return {}
    return {name: integers(name, fields[name], np.uint8, "a colour") for name in COLOURS}


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
