"""A cloud as one record per point, the layout that most formats share, in blocks that take little memory.

Records hold scalars alone, so a vector field is split into columns: by convention `xyz` into ``x y z`` and `normal`
into the format's own names; any other field ``f`` of shape (n, m) into ``f.0`` to ``f.<m-1>``, names that no field has.

A file whose coordinates are named X, Y and Z is of a program that capitalises names: there, lidarsim's names count
whatever their case.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import sys
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim._validation import UINT32, short
from lidarsim.errors import FileFormatError
from lidarsim.pointcloud import CANONICAL, Fields, field_names, held

BLOCK = 1 << 14
"""Points that are converted at a time."""

SMALL, EXPANSION = 1 << 26, 100
"""Bytes that any compressed file may expand to, and how many times its own size beyond them."""

HEADER = 1 << 24
"""Bytes of a header of text, at most."""

FAR = 1e20
"""The greatest coordinate of a file that says nothing of itself, m; pulses along an endless plane reach some 1e16."""

UINT16 = 2**16 - 1

OTHERS = "; are its columns others? PointCloud.load(…, columns=…) names them"

SAMPLE = 2048
"""Points by which their number of columns is judged."""


def to_columns(fields: Fields, normal: Collection[str], codes: Collection[str]) -> Fields:
    """Return the columns that the fields are split into, as views, after checking that `to_fields` would join them.

    `codes` are the dtypes that the format can hold.
    """
    columns: Fields = {}
    for name, array in fields.items():
        if array.dtype.str[1:] not in codes:
            raise FileFormatError(f"{name}: this format cannot hold {array.dtype}; convert it, or save as .npz")
        if array.ndim == 1:
            columns[name] = array
        else:
            parts = {"xyz": "xyz", "normal": normal}.get(name) or [f"{name}.{i}" for i in range(array.shape[1])]
            columns |= zip(parts, array.T, strict=True)
    lost = fields.keys() - to_fields({name: column[:0] for name, column in columns.items()}, normal).keys()
    if lost:
        parts = f"{', '.join(normal)} are the components of 'normal'"
        raise FileFormatError(f"{min(lost)}: this format cannot hold a field of this name, since {parts}; rename it")
    return columns


def record_of(columns: Fields) -> np.dtype[np.void]:
    """Return the packed little-endian dtype of one point."""
    return np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])


def to_records(columns: Fields, dtype: np.dtype[np.void]) -> Iterator[npt.NDArray[np.void]]:
    """Yield the columns as records of `dtype`, a block at a time; what has no column is 0."""
    for block in blocks(columns):
        records = np.zeros(len(block["x"]), dtype)
        for name, column in block.items():
            records[name] = column
        yield records


def from_records(file: BinaryIO, dtype: np.dtype[np.void], points: int | None = None) -> Iterator[Fields]:
    """Yield the columns of the next `points` records of a file, or of all in the rest of it, a block at a time."""
    if not dtype.itemsize:
        raise FileFormatError("its points have no bytes")
    rest = os.fstat(file.fileno()).st_size - file.tell()
    if points is None:
        points, over = divmod(rest, dtype.itemsize)
        if over:
            names = ", ".join(dtype.names or ())
            raise FileFormatError(
                f"its {rest} bytes are not a multiple of {dtype.itemsize}, those of a point ({names}){OTHERS}"
            )
    if points * dtype.itemsize > rest:
        raise FileFormatError(f"it is truncated: {rest // dtype.itemsize} of {points} points")
    for start in range(0, max(points, 1), BLOCK):
        records = np.frombuffer(file.read(min(BLOCK, points - start) * dtype.itemsize), dtype)
        yield columns_of(records)


def headerless(file: BinaryIO, given: list[str] | None, own: Sequence[str], most: float) -> Fields:
    """Return the fields of a file of float32 records that says nothing of itself.

    Parameters
    ----------
    file : binary file
        At its start.
    given : list of str, optional
        Names of the columns; "_": not read. By default `own`, if the numbers can be such.
    own : sequence of str
        Names of the format's columns, among them x, y, z and intensity.
    most : float
        The greatest intensity of the format, or of anything in its form.
    """
    names = given or own
    return joined(_headerless(file, names, None if given else most))


def _headerless(file: BinaryIO, names: Sequence[str], most: float | None) -> Iterator[Fields]:
    """Yield the fields block by block, after checking, if there is a greatest intensity, that they can be such."""
    dtype = np.dtype([(f"_ {i}" if name == "_" else name, "<f4") for i, name in enumerate(names)])
    for number, block in enumerate(from_records(file, dtype)):
        if most is not None:
            if not number:
                _check_number(np.stack(list(block.values()), 1), os.fstat(file.fileno()).st_size // 4)
            check_plausible(block, most, number * BLOCK, OTHERS)
        yield to_fields({name: column for name, column in block.items() if name in names}, (), xyz=np.float32)


def check_plausible(block: Fields, most: float, first: int, hint: str = "") -> None:
    """Raise an error unless numbers can be coordinates in m and intensities up to `most`.

    Coordinates may be NaN or infinite. No finite one is beyond `FAR`, nor below the normal numbers of float32: such
    are the bits of an integer.
    """
    tiny = np.finfo(np.float32).tiny
    for name, values in block.items():
        if name == "intensity":
            wrong = ~((values >= 0) & (values <= most))
            expected = f"numbers from 0 to {most:g}"
        elif name == "ring":
            wrong = ~((values >= 0) & (values <= UINT16) & (values == np.floor(values)))
            expected = f"integers from 0 to {UINT16}"
        else:
            size = np.abs(values)
            wrong = ((size > FAR) & (size < np.inf)) | ((size < tiny) & (size > 0))
            expected = f"0, or {tiny:.1e} to {FAR:.0e} m"
        if wrong.any():
            i = int(np.argmax(wrong))
            raise FileFormatError(f"{name}: expected {expected}, got {name}[{first + i}] = {values[i]}{hint}")


def _check_number(records: npt.NDArray[np.float32], size: int) -> None:
    """Raise an error if the numbers of a file, of which these are the first, look like records of another length.

    If the records have p numbers, each column has one distribution. Read as records of another length, each column is
    a mixture of those, of which the mean logarithm of the variances is greater: a mixture has at least the mean of the
    variances, and the logarithm is concave. So a length that makes it less than the given one does contradicts that
    one, unless it is the points that come in turns: a common multiple of both then makes it less again. Ranks stand for
    the numbers, so that a few great ones do not decide. The logarithm of the variance of n numbers is off by some
    (2 / n)^0.5, and by 1.5 / n on the average, of which the mean over all columns has no more than 0.1 from 256 points
    on. Multiples of the given length are left out: these, too, are points that come in turns.
    """
    if len(records) < 256:
        return
    own = records.shape[1]
    numbers = records[:SAMPLE].ravel()
    ranks = np.unique(numbers, return_inverse=True)[1] / len(numbers)

    def spread(length: int) -> float:
        columns = ranks[: len(ranks) // length * length].reshape(-1, length)
        return float(np.log(columns.var(axis=0) + len(numbers) ** -2.0).mean())

    lengths = [length for length in range(3, 11) if length % own and size % length == 0]
    spreads = {length: spread(length) for length in lengths}
    likely = min(lengths, key=lambda length: (round(spreads[length], 1), length), default=own)
    if likely == own or spreads[likely] > spread(own) - 0.5 or spread(math.lcm(likely, own)) < spreads[likely] - 0.25:
        return
    raise FileFormatError(
        f"its numbers look like {likely} columns, expected {own}: "
        f'PointCloud.load(…, columns=("x", "y", "z", …)) names them'
    )


def parsed(lines: Iterable[str], dtype: np.dtype[np.void], points: int) -> Iterator[Fields]:
    """Yield the columns of lines of text, one point each, at least `points` of them; what follows is not read.

    A column of integers is of float64 in a block where a number is none of `dtype`.
    """
    lines = itertools.islice((line for line in lines if line and not line.isspace()), min(points, sys.maxsize))
    read = 0
    yield columns_of(np.empty(0, dtype))
    while part := list(itertools.islice(lines, BLOCK)):
        try:
            yield columns_of(np.loadtxt(part, dtype, comments=None, ndmin=1))
        except (ValueError, OverflowError):
            yield _parsed_one_by_one(part, dtype, read)
        read += len(part)
    if read < points:
        raise FileFormatError(f"it is truncated: {read} of {points} points")


def as_declared(columns: Fields, dtype: np.dtype[np.void]) -> Fields:
    """Return the columns of a text in the types that it declares.

    Where one of its numbers is none of an integer type, the column is 0, and one more, ``<name>_raw``, has the numbers.
    """
    typed, raw = {}, {}
    for name, column in columns.items():
        numbers, exact = held(column, dtype[name].base)
        typed[name] = numbers.astype(dtype[name].base, copy=False)
        if not exact and dtype[name].base.kind in "iu":
            key = f"{name}_raw"
            while key in columns:
                key += "_raw"
            raw[key] = column
    return typed | raw


def _parsed_one_by_one(lines: list[str], dtype: np.dtype[np.void], first: int) -> Fields:
    """Return the columns of lines, of which some are not as NumPy would have them."""
    names = dtype.names or ()
    sizes = [math.prod(dtype[name].shape) for name in names]
    columns: dict[str, list[list[float]]] = {name: [] for name in names}
    for i, line in enumerate(lines, first):
        words = iter(line.split())
        for name, size in zip(names, sizes, strict=True):
            numbers = [number(word, f"{name}[{i}]") for word in itertools.islice(words, size)]
            if len(numbers) < size:
                raise FileFormatError(f"{name}[{i}]: expected a number, got the end of the line")
            columns[name].append(numbers)
        if (word := next(words, None)) is not None:
            raise FileFormatError(f"point {i}: expected {sum(sizes)} numbers, got more: {short(repr(word))}")
    return {name: _column(columns[name], dtype[name]) for name in names}


def _column(rows: list[list[float]], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return numbers as a column of `dtype`, or of float64 if its integers cannot hold them."""
    if dtype.base.kind in "iu":
        low, high = np.iinfo(dtype.base).min, np.iinfo(dtype.base).max
        if not all(low <= value <= high and value == int(value) for row in rows for value in row):
            return np.array(rows, np.float64).reshape(-1, *dtype.shape)
        rows = [[int(value) for value in row] for row in rows]
    return np.array(rows, dtype.base).reshape(-1, *dtype.shape)


def number(word: str, what: str) -> float:
    """Return the number that a word of a text is: an int if it is one, NaN and infinity also as Windows prints them."""
    if re.fullmatch(r"[+-]?\d{1,20}", word):
        return int(word)
    with suppress(ValueError):
        return float(word)
    if found := re.fullmatch(r"([+-]?)(?:1\.#(inf|ind|[qs]nan)|nan\(\w*\))\d*", word.lower()):
        return float(f"{found[1]}inf") if found[2] == "inf" else math.nan
    comma = " with a point, not a comma" if re.fullmatch(r"[+-]?\d+,\d+", word) else ""
    raise FileFormatError(f"{what}: expected a number{comma}, got {short(repr(word))}")


def columns_of(records: npt.NDArray[np.void]) -> Fields:
    """Return the columns of records, as views."""
    return {name: records[name] for name in records.dtype.names or ()}


def blocks(columns: Fields, size: int = BLOCK) -> Iterator[Fields]:
    """Yield slices of the columns, or fields, of `size` points each, one at least."""
    points = len(next(iter(columns.values())))
    for start in range(0, max(points, 1), size):
        yield {name: column[start : start + size] for name, column in columns.items()}


def joined(parts: Iterable[Fields]) -> Fields:
    """Return the blocks of a file, one at least, as one; at most one field is there twice at a time."""
    lists: defaultdict[str, list[npt.NDArray[Any]]] = defaultdict(list)
    for part in parts:
        for name, array in part.items():
            lists[name].append(np.array(array))  # a copy: the array may be a view of a whole block of records
    return {name: np.concatenate(lists.pop(name), dtype=np.float64 if name == "xyz" else None) for name in list(lists)}


def to_fields(columns: Fields, normal: Collection[str], *, xyz: npt.DTypeLike = np.float64) -> Fields:
    """Return the fields that the columns of a file make up, where a column may have several entries a point."""
    columns = _in_lower_case(columns, normal)
    for name in "xyz":
        if name not in columns:
            raise FileFormatError(f"it has no {name} among its fields {short(', '.join(columns)) or '(none)'}")
        if columns[name].ndim != 1:
            raise FileFormatError(f"its field {name} has {columns[name].shape[1]} numbers per point, expected 1")
    vectors = {"xyz": list("xyz")}
    if normal and all(name in columns and columns[name].ndim == 1 for name in normal):
        vectors["normal"] = list(normal)
    whole = {"", *vectors, *columns}  # what is not split
    numbered = [(name, *name.rpartition(".")[::2]) for name in columns]
    # In the order of their numbers, since Open3D writes columns in any order.
    for name, base, index in sorted(numbered, key=lambda column: (len(column[2]), column[2])):
        column = columns[name]
        if base in whole or column.ndim != 1:
            continue
        parts = vectors.get(base, [])
        if index == str(len(parts)) and (not parts or column.dtype == columns[parts[0]].dtype):
            vectors.setdefault(base, []).append(name)
    arrays = [
        np.stack([columns.pop(part) for part in parts], 1, dtype=xyz if name == "xyz" else None)
        for name, parts in vectors.items()
    ]
    return dict(zip(field_names([*vectors, *columns]), [*arrays, *columns.values()], strict=True))


def _in_lower_case(columns: Fields, normal: Collection[str]) -> Fields:
    """Return the columns of a file, with lidarsim's names in lower case if those of the coordinates are capitals."""
    if columns.keys() & set("xyz") or not columns.keys() >= set("XYZ"):
        return dict(columns)
    known = {*"xyz", *CANONICAL, *normal} - columns.keys()
    renamed = {}
    for name, column in columns.items():
        lower = name.lower()
        renamed[lower if lower in known else name] = column
        known.discard(lower)
    return renamed


def class_comments(names: Mapping[int, str]) -> list[str]:
    """Return a comment for each name of a label, in ASCII: ``class 40 "road"``, the name as JSON has it."""
    return [f"class {label} {json.dumps(name)}" for label, name in names.items()]


def commented_classes(comments: Iterable[str]) -> dict[int, str]:
    """Return the names of labels that are among the comments of a file; what is not such a name is skipped."""
    names = {}
    for comment in comments:
        found = re.fullmatch(r"class (\d{1,10}) (\".*\")", comment.strip())
        if found and int(found[1]) <= UINT32:
            with suppress(ValueError):
                names[int(found[1])] = json.loads(found[2])
    return names


def header_lines(lines: Iterable[str]) -> bytes:
    """Return the lines of a header, in ASCII, after checking that it is no longer than what is read."""
    header = "".join(f"{line}\n" for line in lines).encode("ascii")
    if len(header) > HEADER:
        raise FileFormatError(
            f"this format cannot hold names of {len(header):,} bytes, expected {HEADER:,} at most; save as .npz"
        )
    return header


def check_expansion(size: int, compressed: int) -> None:
    """Raise an error if `compressed` bytes claim to hold so many that they must have been made to fill the memory."""
    if size > max(SMALL, EXPANSION * compressed):
        raise FileFormatError(
            f"its {compressed:,} bytes claim to hold {size:,}, more than {EXPANSION} times as many: refused as a"
            " decompression bomb"
        )
