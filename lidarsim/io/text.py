"""Points as text: ``.csv`` with commas, ``.xyz`` and ``.txt`` with spaces, each with a header line of column names.

All fields are kept, vectors other than `xyz` and `normal` as one column per component, each number with the fewest
digits that restore it. Text has no types: fields that lidarsim knows get their own type, all others are read as
float64 or, if they are integers and one is beyond 2⁵³, as int64 or uint64.

Files from other programs may have commas, semicolons, tabs or blanks between the numbers, comments that begin with # or
//, empty lines, separators at the ends of lines, and empty cells, which become NaN. Column names come from the first
line that is not a comment or, if that has numbers, from the last comment that names x, y and z. Numbers need a decimal
point: a decimal comma is refused. Columns without names get those of `columns` in `PointCloud.load`, or else:

=======  ==============================================================================================================
columns  fields
=======  ==============================================================================================================
3        x y z
4        x y z intensity
6        x y z and, if the other three are unit vectors, the normal, or, if they are colours, red green blue
7        x y z, and intensity and red green blue in the order in which the three can be colours, if only one order fits
=======  ==============================================================================================================

All others are x y z ``column_4`` ``column_5`` and so on. Colours are integers from 0 to 255; each channel must exceed
15 somewhere, so that return counts, which end at 15 in LAS, do not pass for colours. A first line of one number is the
number of points, as in PTS; then six columns are x y z red green blue, and seven x y z intensity red green blue.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any, BinaryIO, NamedTuple, TextIO

import numpy as np
import numpy.typing as npt

from lidarsim._base.lines import bare
from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError
from lidarsim.io._records import blocks, check_columns, decoded, number, to_columns, to_fields
from lidarsim.scan.fields import CANONICAL, Fields, fit
from lidarsim.scan.formats import register_format

NORMAL = ("nx", "ny", "nz")
CODES = {"b1", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
COLOURS = ("red", "green", "blue")
COMMENTS = ("#", "//")
COMMENT = re.compile(r"(?:^|(?<=[\s,;]))(?:#|//)")
DECIMAL = r"[+-]?\d+,\d+"
"""A number with a decimal comma."""

NUMBER = r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?|[+-]?(?i:nan|inf|infinity|1\.#\w+|nan\(\w*\))"

LINES = 1 << 12
"""Lines in memory at a time; text takes several times the memory of its numbers."""


def save(fields: Fields, file: BinaryIO, *, head: str, between: str) -> None:
    """Write a header line of column names, then one line per point."""
    columns = to_columns(fields, NORMAL, CODES)
    file.write(f"{head}{between.join(columns)}\n".encode("ascii"))
    known = {*CANONICAL, *(NORMAL if "normal" in fields else ())}
    for block in blocks(columns, LINES):
        rows = zip(*(_texts(column, name in known) for name, column in block.items()), strict=True)
        file.writelines(f"{between.join(row)}\n".encode("ascii") for row in rows)


def load(file: BinaryIO, *, columns: list[str] | None = None) -> Fields:
    """Read the numbers; column names come from the file, from `columns` or from the layout."""
    with decoded(file) as text:
        head = _head(text)
        if head.names is not None:
            if not {"x", "y", "z"}.intersection(name.lower() for name in head.names):
                raise FileFormatError("it has no x among its fields")  # shows no content: it may be any file
            twice = next((name for name, count in Counter(head.names).items() if count > 1), None)
            if twice is not None:
                raise FileFormatError(f"it has two columns named {short(repr(twice))}")
        if head.names is not None and columns is not None:
            raise FileFormatError(f"columns: expected none, since a line names them: {short(', '.join(head.names))}")
        names = head.names or columns or [f"column {i + 1}" for i in range(head.columns)]
        check_columns(len(names))
        if head.names is None and columns is None and 0 < head.columns < 3:
            raise FileFormatError(f"its first line has no column names, and there are {head.columns} columns")
        lines = itertools.chain(head.first, _lines(text, head.first[0][0] if head.first else 0))
        read = _join(_parse(lines, names, head.between))
        count = _count(head, names, read)
        names, read = names[:count], read[:count]
    found = len(read[0]) if read else 0
    if head.points not in {None, found}:
        raise FileFormatError(f"its first line says {head.points} points, but there are {found}")
    if head.names is None and columns is None:
        names = _layout(read, scanner=head.points is not None)
    vectors: defaultdict[str, list[int]] = defaultdict(list)
    for i, name in enumerate(names):
        vectors[name.rpartition(".")[0]].append(i)
    for base, places in vectors.items():
        if base:
            for i, column in zip(places, _alike([read[i] for i in places]), strict=True):
                read[i] = column
    return to_fields({name: column for name, column in zip(names, read, strict=True) if name != "_"}, NORMAL)


class _Head(NamedTuple):
    names: list[str] | None  # column names, if a line has them
    points: int | None  # number of points, if a line has it
    columns: int  # 0: no line has numbers
    between: str | None  # separator; None: blanks
    first: list[tuple[int, str]]  # first line of numbers, with its line number
    is_open: bool  # the first line of numbers ends with a separator


def _head(text: TextIO) -> _Head:
    """Read up to and including the first line of numbers."""
    points, comments, above = None, list[str](), ""
    first, cells, between = list[tuple[int, str]](), list[str](), None
    for at, line in enumerate(text, 1):
        words = line.strip()
        if words.startswith(COMMENTS):
            comments.append(words.lstrip("#/"))
        elif words:
            bare = _strip_comment(words)
            between = _separator(bare)
            cells = bare.split(between)
            if not above and points is None and len(cells) == 1 and bare.isdecimal():
                points = int(bare)
            elif not above and points is None and not _numeric(cells):
                above = words
            else:
                first = [(at, line)]
                break
    columns = len(cells) if first else None
    names = _names(above, columns) if above else None
    if names is None:
        candidates = (_names(comment, columns) for comment in reversed(comments))
        names = next((found for found in candidates if {name.lower() for name in found} >= set("xyz")), None)
    return _Head(names, points, columns or 0, between, first, bool(first) and not cells[-1])


def _lines(text: TextIO, last: int) -> Iterator[tuple[int, str]]:
    """Yield the lines after number `last` that are neither blank nor comments, with their numbers."""
    for at, line in enumerate(text, last + 1):
        if (words := line.lstrip()) and not words.startswith(COMMENTS):
            yield at, line


def _separator(line: str) -> str | None:
    """Return the separator of a line, None for blanks; decimal commas in words between blanks do not count."""
    if all(re.fullmatch(DECIMAL, word) for word in line.split()[:4]) and len(line.split()) > 1:
        return None
    return next((sign for sign in ";,\t" if sign in line and (sign != "\t" or " " not in line)), None)


def _names(line: str, columns: int | None = None) -> list[str]:
    """Return the names in a line, split so that they match the number of columns if possible."""
    between = next((sign for sign in ";,\t" if sign in line), None)
    names = [] if between is None else next(csv.reader([line], delimiter=between, skipinitialspace=True))
    if between is None or (columns not in {None, len(names)} and len(line.split()) == columns):
        names = line.split()
    if len(names) - 1 == columns and not bare(names[-1]):
        names.pop()  # a comma at the end
    return [bare(name) or f"unnamed {i}" for i, name in enumerate(names, 1)]


def _count(head: _Head, names: list[str], read: list[npt.NDArray[Any]]) -> int:
    """Return the number of columns without that after a separator at the end, which has neither name nor numbers."""
    count = len(names)
    is_nothing = head.is_open and names[-1] in {f"unnamed {count}", f"column {count}"} and np.isnan(read[-1]).all()
    return count - 1 if is_nothing else count


def _layout(columns: list[npt.NDArray[Any]], *, scanner: bool) -> list[str]:
    """Return names for unnamed columns, as documented for the module."""
    count = len(columns)
    names = [*"xyz", *(f"column_{i + 1}" for i in range(3, count))][:count]
    if count == 4:
        names[3:] = ["intensity"]
    elif count == 6 and _are_normals(columns[3:]):
        names[3:] = NORMAL
    elif count == 6 and (scanner or _are_colours(columns[3:])):
        names[3:] = COLOURS
    elif count == 7 and (scanner or (_are_colours(columns[4:]) and not _are_colours(columns[3:6]))):
        names[3:] = ["intensity", *COLOURS]
    elif count == 7 and _are_colours(columns[3:6]) and not _are_colours(columns[4:]):
        names[3:] = [*COLOURS, "intensity"]
    return names


def _are_colours(columns: list[npt.NDArray[Any]]) -> bool:
    """Return whether columns are bytes, each with a value beyond 15, the greatest return count of LAS."""
    return all(
        ((column >= 0) & (column <= 255) & (column == np.floor(column))).all() and column.max(initial=0) > 15
        for column in columns
    )


def _are_normals(columns: list[npt.NDArray[Any]]) -> bool:
    """Return whether each row has length 1 up to rounding to three decimals, an error of at most 3**0.5 / 2 * 1e-3."""
    length = np.sqrt(sum(column.astype(np.float64) ** 2 for column in columns))
    return bool(len(length)) and bool((np.abs(length - 1) <= 1e-3).all())


def _parse(lines: Iterable[tuple[int, str]], names: list[str], between: str | None) -> Iterator[list[npt.NDArray[Any]]]:
    """Yield the columns block by block; at least one block."""
    yield [_narrow(name, np.empty(0)) for name in names]
    iterator = iter(lines)
    while part := list(itertools.islice(iterator, LINES)):
        try:
            numbers = np.loadtxt([line for _, line in part], delimiter=between, comments=None, ndmin=2)
        except ValueError:
            numbers = np.empty((0, 0))
        if numbers.shape != (len(part), len(names)):
            numbers = np.array([_numbers(line, at, names, between) for at, line in part], np.float64)
        great = (np.abs(numbers) >= 2**53).any(axis=0)  # 2**53 + 1 is rounded to 2**53
        columns = [_narrow(name, column) for name, column in zip(names, numbers.T, strict=True)]
        for i in np.flatnonzero(great):
            columns[i] = _exact([_cells(line, between)[i] for _, line in part], columns[i])
        yield columns


def _strip_comment(line: str) -> str:
    """Return a line without the comment at its end."""
    return COMMENT.split(line)[0].strip(" ")


def _cells(line: str, between: str | None) -> list[str]:
    return list(map(bare, _strip_comment(line).strip(None if between is None else " \r\n").split(between)))


def _numbers(line: str, at: int, names: list[str], between: str | None) -> list[float]:
    """Return the numbers of a line that NumPy cannot parse, with empty cells as NaN; `at` is its line number."""
    cells = _cells(line, between)
    if len(cells) == len(names) + 1 and not cells[-1]:
        cells.pop()  # a comma at the end
    if len(cells) != len(names):
        raise FileFormatError(f"line {at}: expected {len(names)} numbers ({short(', '.join(names))}), got {len(cells)}")
    return [
        number(cell, f"line {at}, {short(name)}") if cell else np.nan for name, cell in zip(names, cells, strict=True)
    ]


def _exact(cells: list[str], column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a column with numbers beyond 2⁵³ as 64-bit integers if all its numbers are integers that fit."""
    numbers = [number(cell, "") if cell else np.nan for cell in cells]
    if not all(isinstance(value, int) for value in numbers):
        return column
    low, high = min(numbers), max(numbers)
    if low >= -(2**63) and high < 2**63:
        return np.array(numbers, np.int64)
    return np.array(numbers, np.uint64) if low >= 0 and high < 2**64 else column


def _join(parts: Iterable[list[npt.NDArray[Any]]]) -> list[npt.NDArray[Any]]:
    """Join the blocks, holding at most one column twice at a time."""
    columns = [list(blocks) for blocks in zip(*parts, strict=True)][::-1]
    return [np.concatenate(_alike(columns.pop())) for _ in range(len(columns))]


def _alike(parts: list[npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
    """Convert arrays to one common integer type if some are integers and all can be."""
    dtypes = {part.dtype for part in parts}
    wide = np.uint64 if np.dtype(np.uint64) in dtypes else np.int64
    if len(dtypes) == 1 or not any(dtype.kind in "iu" for dtype in dtypes):
        return parts
    return [part.astype(wide) for part in parts] if all(fit(part, wide)[1] for part in parts) else parts


def _narrow(name: str, column: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    """Return a copy of the column in the dtype of lidarsim's field of that name, if nothing is lost."""
    _, dtype = CANONICAL.get(name, ((), np.float64))
    exact = dtype is np.float64 or fit(column, dtype)[1]
    return np.array(column, dtype if exact else np.float64)


def _texts(column: npt.NDArray[Any], known: bool) -> Iterable[str]:
    if column.dtype == np.float32 and known:
        return map(str, column)  # it is read as float32, which needs fewer digits than float64
    return map(repr, column.tolist() if column.dtype != np.bool_ else column.view(np.uint8).tolist())


def _numeric(words: list[str]) -> bool:
    """Return whether all words are empty or numbers, also with decimal commas, and one at least is a number."""
    words = list(map(bare, words))
    return any(words) and all(not word or re.fullmatch(NUMBER, word) for word in words)


register_format(".csv", save=partial(save, head="", between=","), load=load)
for _suffix in (".xyz", ".txt"):
    register_format(_suffix, save=partial(save, head="# ", between=" "), load=load)
