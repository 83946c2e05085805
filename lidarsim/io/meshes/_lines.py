"""What the formats of text share. Errors name the line and what was expected, never what the file holds there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._validation import Floats
from lidarsim.errors import FileFormatError


class Line(NamedTuple):
    """The words of a line, and its number from 1 on."""

    number: int
    words: list[str]


def lines_of(data: bytes, *, first: int = 1) -> Iterator[Line]:
    """Yield the lines that are not empty, whatever ends them; `first` is the number of the first."""
    text = data.removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="replace")
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), first):
        if words := line.split():
            yield Line(number, words)


def floats(line: int, words: Sequence[str]) -> list[float]:
    """Return the numbers that some words of a line are."""
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) < len(words) or any("_" in word for word in words):
        raise FileFormatError(f"line {line}: expected numbers, got something else")
    return values


def integers(line: int, words: Sequence[str]) -> list[int]:
    """Return the integers of at most 64 bits that some words of a line are."""
    try:
        values = [int(word) for word in words]
    except ValueError:
        values = []
    if len(values) < len(words) or any(abs(value) >= 1 << 63 for value in values):
        raise FileFormatError(f"line {line}: expected integers, got something else")
    return values


def table(lines: Sequence[Line], columns: Sequence[int]) -> Floats:
    """Return some columns of the lines as numbers, shape (lines, columns)."""
    try:
        rows = [[line.words[column] for column in columns] for line in lines]
    except IndexError:
        short = next(line.number for line in lines if len(line.words) <= max(columns))
        raise FileFormatError(f"line {short}: expected at least {max(columns) + 1} numbers, got fewer") from None
    values = [floats(line.number, row) for line, row in zip(lines, rows, strict=True)]
    return np.array(values, np.float64).reshape(len(lines), len(columns))


def polygons(lines: Sequence[Line]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the faces in lines of a count and as many indices, one after the other, and their sizes."""
    corners: list[int] = []
    sizes: list[int] = []
    for line in lines:
        (size,) = integers(line.number, line.words[:1])
        if not 0 <= size < len(line.words):
            raise FileFormatError(f"line {line.number}: expected {size} indices after their count, got fewer")
        corners += integers(line.number, line.words[1 : size + 1])
        sizes.append(size)
    return np.array(corners, np.int64), np.array(sizes, np.int64)
