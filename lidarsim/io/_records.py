"""Clouds as one record per point, the layout that most formats share, converted in blocks to save memory.

Records hold only scalars, so vector fields are split into columns: `xyz` into ``x y z``, `normal` into the format's own
names, and any other field ``f`` of shape (n, m) into ``f.0`` to ``f.<m-1>``, names that no field can have.

If the coordinates of a file are named X, Y and Z, its writer capitalises names: lidarsim's names then match in any
case.
"""

from __future__ import annotations

import io
import itertools
import json
import math
import os
import re
import sys
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any, BinaryIO, TextIO

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.validation import UINT32, short
from lidarsim.errors import FileFormatError
from lidarsim.scan.fields import CANONICAL, Fields, first_misfit, fit
from lidarsim.scan.pointcloud import field_names

BLOCK = 1 << 14
"""Points converted at a time."""

SMALL, EXPANSION = 1 << 26, 100
"""A compressed file may expand to SMALL bytes, or to EXPANSION times its own size if that is more."""

HEADER = 1 << 24
"""Greatest size of a text header, bytes."""

MOST_COLUMNS = 10_000
"""Maximum number of columns of a file: each takes its own time and memory, even without points."""

FAR = 1e20
"""Greatest plausible coordinate in a file without a header, m; pulses along an infinite plane reach about 1e16."""

UINT16 = 2**16 - 1

OTHERS = "; are its columns others? PointCloud.load(…, columns=…) names them"

SAMPLE = 2048
"""Points used to check the number of columns."""


@contextmanager
def decoded(file: BinaryIO, encoding: str = "utf-8-sig") -> Iterator[TextIO]:
    """Yield the text of a file, with any line ends; the file stays open."""
    text = io.TextIOWrapper(file, encoding, "replace")
    try:
        yield text
    finally:
        text.detach()


def to_columns(fields: Fields, normal: Collection[str], codes: Collection[str]) -> Fields:
    """Split the fields into columns, as views, after checking that `to_fields` can restore them.

    `codes` lists the dtypes that the format can hold.
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
    """Yield the columns as records of `dtype`, a block at a time; names without a column are 0."""
    for number, block in enumerate(blocks(columns)):
        records = np.zeros(len(block["x"]), dtype)
        for name, column in block.items():
            set_column(records, name, column, number * BLOCK)
        yield records


def set_column(records: npt.NDArray[np.void], name: str, column: npt.NDArray[Any], first: int = 0) -> None:
    """Set a column of records, after checking that its type holds the numbers; `first` is the number of the first."""
    if misfit := first_misfit(name, column, records.dtype[name].type, first):
        raise FileFormatError("{}: expected {}, got {}".format(name, *misfit))
    records[name] = column


def from_records(file: BinaryIO, dtype: np.dtype[np.void], points: int | None = None) -> Iterator[Fields]:
    """Yield the columns of the next `points` records of a file, by default all that remain, a block at a time."""
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


def write_headerless(fields: Fields, file: BinaryIO, dtype: np.dtype[np.void], most: float) -> None:
    """Write records of float32 without a header, after checking that `headerless` takes them for what they are."""
    for number, records in enumerate(to_records(to_columns(fields, (), {"f4", "f8", "u1", "u2"}), dtype)):
        check_plausible(columns_of(records), most, number * BLOCK)
        file.write(records.data)


def headerless(file: BinaryIO, given: list[str] | None, own: Sequence[str], most: float) -> Fields:
    """Return the fields of a file of float32 records without a header.

    Its columns have the `given` names, of which those named "_" are skipped, or else the format's `own`, if the numbers
    are plausible: `most` is the greatest intensity.
    """
    return join(_headerless(file, given or own, None if given else most))


def _headerless(file: BinaryIO, names: Sequence[str], most: float | None) -> Iterator[Fields]:
    """Yield the fields block by block; with a greatest intensity, check that they are plausible."""
    dtype = np.dtype([(f"_ {i}" if name == "_" else name, "<f4") for i, name in enumerate(names)])
    for number, block in enumerate(from_records(file, dtype)):
        if most is not None:
            if not number:
                _check_number(np.stack(list(block.values()), 1), os.fstat(file.fileno()).st_size // 4)
            check_plausible(block, most, number * BLOCK, OTHERS)
        yield to_fields({name: column for name, column in block.items() if name in names}, (), xyz=np.float32)


def check_plausible(block: Fields, most: float, first: int, hint: str = "") -> None:
    """Raise an error unless numbers are plausible coordinates in m and intensities up to `most`.

    Coordinates may be NaN or infinite. Finite ones must not exceed `FAR`, nor be subnormal float32 numbers: those are
    the bits of an integer.
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
    """Raise an error if the first numbers of a file look like records of another length.

    With the right record length, each column has one distribution. With another length, each column mixes several, and
    the mean logarithm of the column variances is greater: the variance of a mixture is at least the mean variance of
    its parts, and the logarithm is concave. So a length with a smaller mean than the given one contradicts the latter,
    unless the points themselves alternate; then a common multiple of both lengths has a smaller mean again. Ranks
    replace the numbers, so that a few outliers do not decide. The logarithm of the variance of n numbers has an error
    of about (2 / n)^0.5 and a bias of 1.5 / n; from 256 points on, the error of the mean over all columns is at most
    0.1. Multiples of the given length are left out, since they too only show alternating points.
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


def parse_lines(lines: Iterable[str], dtype: np.dtype[np.void], points: int) -> Iterator[Fields]:
    """Yield the columns of `points` lines of text, one point each, `BLOCK` at a time; later lines are not read.

    In a block where a number does not fit an integer column of `dtype`, that column is float64.
    """
    lines = itertools.islice((line for line in lines if line and not line.isspace()), min(points, sys.maxsize))
    read = 0
    yield columns_of(np.empty(0, dtype))
    while part := list(itertools.islice(lines, BLOCK)):
        yield parse_block(part, dtype, read)
        read += len(part)
    if read < points:
        raise FileFormatError(f"it is truncated: {read} of {points} points")


def parse_block(lines: list[str], dtype: np.dtype[np.void], first: int) -> Fields:
    """Return the columns of lines of text, one point each, of which the first has the number `first`."""
    try:
        return columns_of(np.loadtxt(lines, dtype, comments=None, ndmin=1))
    except (ValueError, OverflowError):
        return _parse_one_by_one(lines, dtype, first)


def as_declared(columns: Fields, dtype: np.dtype[np.void]) -> Fields:
    """Return the columns of a text in the types that it declares.

    Where a number does not fit an integer type, the column is 0, and a further column, ``<name>_raw``, has the numbers.
    """
    typed, raw = {}, {}
    for name, column in columns.items():
        numbers, exact = fit(column, dtype[name].base)
        typed[name] = numbers.astype(dtype[name].base, copy=False)
        if not exact and dtype[name].base.kind in "iu":
            key = f"{name}_raw"
            while key in columns:
                key += "_raw"
            raw[key] = column
    return typed | raw


def _parse_one_by_one(lines: list[str], dtype: np.dtype[np.void], first: int) -> Fields:
    """Return the columns of lines that NumPy cannot parse as a block."""
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
        if next(words, None) is not None:
            raise FileFormatError(f"point {i}: expected {sum(sizes)} numbers, got more")
    return {name: _column(columns[name], dtype[name]) for name in names}


def _column(rows: list[list[float]], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return numbers as a column of `dtype`, or of float64 if an integer `dtype` cannot hold them."""
    if dtype.base.kind in "iu":
        low, high = np.iinfo(dtype.base).min, np.iinfo(dtype.base).max
        if not all(low <= value <= high and value == int(value) for row in rows for value in row):
            return np.array(rows, np.float64).reshape(-1, *dtype.shape)
        rows = [[int(value) for value in row] for row in rows]
    return np.array(rows, dtype.base).reshape(-1, *dtype.shape)


def number(word: str, what: str) -> float:
    """Parse a word as an int if possible, else as a float; NaN and infinity also as Windows prints them."""
    if re.fullmatch(r"[+-]?\d{1,20}", word):
        return int(word)
    with suppress(ValueError):
        if "_" not in word:  # which Python reads past
            return float(word)
    if found := re.fullmatch(r"([+-]?)(?:1\.#(inf|ind|[qs]nan)|nan\(\w*\))\d*", word.lower()):
        return float(f"{found[1]}inf") if found[2] == "inf" else math.nan
    comma = re.fullmatch(r"[+-]?\d{1,20},\d{1,20}", word)
    expected, got = ("a number with a point, not a comma", repr(word)) if comma else ("a number", "something else")
    raise FileFormatError(f"{what}: expected {expected}, got {got}")  # shows no text: it may be any file


def columns_of(records: npt.NDArray[np.void]) -> Fields:
    """Return the columns of records, as views."""
    return {name: records[name] for name in records.dtype.names or ()}


def blocks(columns: Fields, size: int = BLOCK) -> Iterator[Fields]:
    """Yield slices of the columns, or fields, of `size` points each; at least one slice."""
    points = len(next(iter(columns.values())))
    for start in range(0, max(points, 1), size):
        yield {name: column[start : start + size] for name, column in columns.items()}


def join(parts: Iterable[Fields]) -> Fields:
    """Join the blocks of a file, at least one, holding at most one field twice at a time."""
    lists: defaultdict[str, list[npt.NDArray[Any]]] = defaultdict(list)
    for part in parts:
        for name, array in part.items():
            lists[name].append(np.array(array))  # a copy: the array may be a view of a whole block of records
    return {name: np.concatenate(lists.pop(name), dtype=np.float64 if name == "xyz" else None) for name in list(lists)}


def to_fields(columns: Fields, normal: Collection[str], *, xyz: npt.DTypeLike = np.float64) -> Fields:
    """Return the fields that the columns of a file form; a column may have several entries per point."""
    check_columns(len(columns))
    columns = _in_lower_case(columns, normal)
    for name in "xyz":
        if name not in columns:
            raise FileFormatError(f"it has no {name} among its fields {short(', '.join(columns)) or '(none)'}")
        if columns[name].ndim != 1:
            raise FileFormatError(f"its field {name} has {columns[name].shape[1]} numbers per point, expected 1")
    vectors = {"xyz": list("xyz")}
    if normal and all(name in columns and columns[name].ndim == 1 for name in normal):
        vectors["normal"] = list(normal)
    whole = {"", *vectors, *columns}  # not split into components
    numbered = [(name, *name.rpartition(".")[::2]) for name in columns]
    # By number, since Open3D writes columns in any order.
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
    """Return the columns of a file; if its coordinates are X, Y and Z, put lidarsim's names into lower case."""
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
    """Return an ASCII comment for each class name: ``class 40 "road"``, with the name in JSON."""
    return [f"class {label} {json.dumps(name)}" for label, name in names.items()]


def read_commented_classes(comments: Iterable[str]) -> dict[int, str]:
    """Return the class names in the comments of a file by label; other comments are skipped."""
    names = {}
    for comment in comments:
        found = re.fullmatch(r"class (\d{1,10}) (\".*\")", comment.strip())
        if found and int(found[1]) <= UINT32:
            with suppress(ValueError):
                names[int(found[1])] = json.loads(found[2])
    return names


def header_lines(lines: Iterable[str]) -> bytes:
    """Return the lines of a header, in ASCII, after checking that it can be read back."""
    header = "".join(f"{line}\n" for line in lines).encode("ascii")
    if len(header) > HEADER:
        raise FileFormatError(
            f"this format cannot hold names of {len(header):,} bytes, expected {HEADER:,} at most; save as .npz"
        )
    return header


def check_columns(count: int) -> None:
    """Raise an error if a file has too many columns."""
    if count > MOST_COLUMNS:
        raise FileFormatError(f"expected at most {MOST_COLUMNS:,} columns, got {count:,}")


def expansion_limit(compressed: int) -> int:
    """Return the most bytes to which so many compressed ones may expand."""
    return max(SMALL, EXPANSION * compressed)


def check_expansion(size: int, compressed: int) -> None:
    """Raise an error if `compressed` bytes claim to expand to so many that they must be a decompression bomb."""
    if size > expansion_limit(compressed):
        raise FileFormatError(
            f"its {compressed:,} bytes claim to hold {size:,}, more than {EXPANSION} times as many: refused as a"
            " decompression bomb"
        )


class Expansion:
    """What the parts of a document take in memory, together: a small file can name the same numbers many times.

    `size` is that of the document and of the files that it names, known so far, bytes.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._taken = 0

    def take(self, size: int) -> None:
        """Count `size` bytes more; raise an error if all of them make the document a decompression bomb."""
        self._taken += size
        check_expansion(self._taken, self.size)


@cache
def zstd() -> Any:
    """Return the module that decompresses Zstandard: that of Python 3.14, or the one that rosbags installs."""
    name = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_extra(name, "formats", "reading compressed ROS bags")
