"""Parsing shared by the text formats. Errors name the line and the expectation, but never show the file's content.

NumPy parses all lines at once; only if it fails are they parsed one by one, to find the number of the first wrong one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError

Indices = npt.NDArray[np.int64]


class Lines:
    """Lines of a file with their numbers, counted from 1; two lists are faster than a million tuples."""

    def __init__(self, numbers: list[int] | None = None, texts: list[str] | None = None) -> None:
        self.numbers = numbers if numbers is not None else []
        self.texts = texts if texts is not None else []

    def append(self, number: int, text: str) -> None:
        """Append a line."""
        self.numbers.append(number)
        self.texts.append(text)

    def __len__(self) -> int:
        return len(self.texts)

    def __iter__(self) -> Iterator[tuple[int, str]]:
        return zip(self.numbers, self.texts, strict=True)

    def __getitem__(self, part: slice) -> Lines:
        return Lines(self.numbers[part], self.texts[part])

    def only(self, places: Indices) -> Lines:
        """Return the lines at the given places."""
        if len(places) == len(self):
            return self
        return Lines([self.numbers[k] for k in places], [self.texts[k] for k in places])


def lines_of(data: bytes, *, first: int = 1) -> Lines:
    """Return the non-empty lines, with any line ends; `first` is the number of the first line."""
    text = data.removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="replace")
    stripped = list(map(str.strip, text.replace("\r\n", "\n").replace("\r", "\n").split("\n")))
    return Lines([number for number, line in enumerate(stripped, first) if line], list(filter(None, stripped)))


def floats(lines: Lines, width: int, *, more: bool = False) -> Floats:
    """Return the `width` numbers of each line, shape (lines, width); with `more`, further words may follow."""
    return _table(lines, width, np.dtype(np.float64), more)


def integers(lines: Lines, width: int, *, more: bool = False) -> Indices:
    """Return the `width` integers of at most 64 bits of each line, shape (lines, width)."""
    return _table(lines, width, np.dtype(np.int64), more)


def polygons(lines: Lines, *, more: bool = False) -> tuple[Indices, Indices]:
    """Return the concatenated faces, given as a count and that many integers per line, and their sizes."""
    sizes = integers(lines, 1, more=True)[:, 0]
    wrong = np.flatnonzero((sizes < 0) | (sizes > max(map(len, lines.texts), default=0)))
    if len(wrong):
        raise FileFormatError(f"line {lines.numbers[wrong[0]]}: expected {sizes[wrong[0]]} indices after their count")
    return join(lines, sizes, 1, more=more), sizes


def join(lines: Lines, sizes: Indices, skipped: int, *, more: bool = False) -> Indices:
    """Return the integers of lines of different lengths, concatenated, without the first `skipped` of each line."""
    starts = np.cumsum(sizes) - sizes
    values = np.empty(int(sizes.sum()), np.int64)
    for size in np.unique(sizes).tolist():
        which = np.flatnonzero(sizes == size)
        rows = integers(lines.only(which), skipped + size, more=more)
        values[starts[which, None] + np.arange(size)] = rows[:, skipped:]
    return values


def _table(lines: Lines, width: int, dtype: np.dtype[Any], more: bool) -> npt.NDArray[Any]:
    if not lines:
        return np.empty((0, width), dtype)
    columns = range(width) if more else None
    try:
        rows = np.loadtxt(lines.texts, dtype, ndmin=2, usecols=columns, comments=None)
    except (ValueError, OverflowError):
        rows = None
    if rows is not None and rows.shape == (len(lines), width):
        return rows
    what, parse = ("integers", int) if dtype.kind == "i" else ("numbers", float)
    for number, text in lines:
        words = text.split()
        if len(words) < width or (len(words) > width and not more):
            wanted = f"{'at least ' * more}{width} {what if width > 1 else what[:-1]}"
            raise FileFormatError(f"line {number}: expected {wanted}, got {len(words)}")
        if not all(_parses(word, parse) for word in words[:width]):
            raise FileFormatError(f"line {number}: expected {what}, got something else")
    raise FileFormatError(f"expected {what}, got something else")


def _parses(word: str, parse: type[int | float]) -> bool:
    try:
        number = parse(word)
    except ValueError:
        return False
    return "_" not in word and (parse is float or abs(number) < 2**63)
