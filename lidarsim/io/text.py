"""Points as text: ``.csv`` with commas, ``.xyz`` with spaces, each with a first line that names the columns.

All fields are kept, vectors other than `xyz` and `normal` as one column per component, each number with the fewest
digits that restore it. Text has no types: fields that lidarsim knows get their own again, all others come back as
float64, which holds integers up to 2⁵³. A file of three columns without names is read as x, y, z.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.io._records import blocks, joined, to_columns, to_fields
from lidarsim.pointcloud import CANONICAL, Fields, register_format

NORMAL = ("nx", "ny", "nz")
CODES = {"b1", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
LINES = 1 << 12
"""Lines in memory at a time: text takes several times the memory of its numbers."""


def save(fields: Fields, file: BinaryIO, *, head: str, between: str) -> None:
    """Write a line of names, then one line per point."""
    columns = to_columns(fields, NORMAL, CODES)
    file.write(f"{head}{between.join(columns)}\n".encode("ascii"))
    for block in blocks(columns, LINES):
        rows = zip(*(_texts(column) for column in block.values()), strict=True)
        file.writelines(f"{between.join(row)}\n".encode("ascii") for row in rows)


def load(file: BinaryIO) -> Fields:
    """Read a line of names, if there is one, and the numbers below it."""
    text = io.TextIOWrapper(file, "utf-8-sig")
    try:
        first = text.readline()
        between = next((sign for sign in ",;" if sign in first), None)
        names = [name.strip().strip('"') for name in first.strip().lstrip("#/").split(between)]
        if _numeric(names):
            if len(names) != 3:
                raise FileFormatError(f"its first line has no column names, and there are {len(names)} columns")
            lines: Iterable[str] = itertools.chain([first], text)
            names = list("xyz")
        else:
            lines = text
        names = [name.lower() if name in {"X", "Y", "Z"} else name for name in names]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise FileFormatError(f"it has two columns named {twice!r}")
        return to_fields(joined(_parsed(lines, names, between)), NORMAL)
    finally:
        text.detach()


def _parsed(lines: Iterable[str], names: list[str], between: str | None) -> Iterator[Fields]:
    yield {name: _narrow(name, np.empty(0)) for name in names}
    rest = (line for line in lines if not line.isspace())
    while part := list(itertools.islice(rest, LINES)):
        numbers = np.loadtxt(part, delimiter=between, comments=None, ndmin=2)
        if numbers.shape[1] != len(names):
            raise FileFormatError(f"it has {len(names)} column names, but {numbers.shape[1]} numbers per line")
        yield {name: _narrow(name, column) for name, column in zip(names, numbers.T, strict=True)}


def _narrow(name: str, column: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    """Return the column in the dtype of lidarsim's field of that name, if it fits; a misfit is reported later."""
    _, dtype = CANONICAL.get(name, ((), np.float64))
    if issubclass(dtype, np.floating):
        return column.astype(dtype)
    with np.errstate(invalid="ignore"):
        narrow = column.astype(dtype)
    return narrow if np.array_equal(narrow, column) else column


def _texts(column: npt.NDArray[Any]) -> Iterable[str]:
    if column.dtype == np.float32:
        return map(str, column)  # a float32 is printed with fewer digits than the float64 of its value
    return map(repr, column.tolist() if column.dtype != np.bool_ else column.view(np.uint8).tolist())


def _numeric(words: list[str]) -> bool:
    try:
        return bool([float(word) for word in words])
    except ValueError:
        return False


register_format(".csv", save=partial(save, head="", between=","), load=load)
register_format(".xyz", save=partial(save, head="# ", between=" "), load=load)
