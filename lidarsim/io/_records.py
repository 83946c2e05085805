"""A cloud as one record per point, the layout that most formats share, in blocks that take little memory.

Records hold scalars alone, so a vector field is split into columns: by convention `xyz` into ``x y z`` and `normal`
into the format's own names; any other field ``f`` of shape (n, m) into ``f.0`` to ``f.<m-1>``, names that no field has.
"""

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim._validation import UINT32
from lidarsim.errors import FileFormatError
from lidarsim.pointcloud import Fields

BLOCK = 1 << 14
"""Points that are converted at a time."""

SMALL, EXPANSION = 1 << 26, 100
"""Bytes that any compressed file may expand to, and how many times its own size beyond them."""


def to_columns(fields: Fields, normal: Collection[str], codes: Collection[str]) -> Fields:
    """Return the columns that the fields are split into, as views; `codes` are the dtypes that the format can hold."""
    columns: Fields = {}
    for name, array in fields.items():
        if array.dtype.str[1:] not in codes:
            raise FileFormatError(f"{name}: this format cannot hold {array.dtype}; convert it, or save as .npz")
        if array.ndim == 1:
            columns[name] = array
        else:
            parts = {"xyz": "xyz", "normal": normal}.get(name) or [f"{name}.{i}" for i in range(array.shape[1])]
            columns |= zip(parts, array.T, strict=True)
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
                f"its {rest} bytes are not a multiple of {dtype.itemsize}, those of a point ({names})"
            )
    if points * dtype.itemsize > rest:
        raise FileFormatError(f"it is truncated: {rest // dtype.itemsize} of {points} points")
    for start in range(0, max(points, 1), BLOCK):
        records = np.frombuffer(file.read(min(BLOCK, points - start) * dtype.itemsize), dtype)
        yield {name: records[name] for name in dtype.names or ()}


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
    for name in "xyz":
        if name not in columns:
            raise FileFormatError(f"it has no {name} among its fields {', '.join(columns) or '(none)'}")
    columns = dict(columns)
    vectors = {"xyz": list("xyz")}
    if normal and columns.keys() >= set(normal):
        vectors["normal"] = list(normal)
    for name in columns:
        base, _, index = name.rpartition(".")
        if base and index == str(len(vectors.get(base, ()))):
            vectors.setdefault(base, []).append(name)
    fields: Fields = {}
    for name, parts in vectors.items():
        dtype = xyz if name == "xyz" else None
        fields[_identifier(name)] = np.stack([columns.pop(part) for part in parts], 1, dtype=dtype)
    return fields | {_identifier(name): column for name, column in columns.items()}


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


def check_expansion(size: int, compressed: int) -> None:
    """Raise an error if `compressed` bytes claim to hold so many that they must have been made to fill the memory."""
    if size > max(SMALL, EXPANSION * compressed):
        raise FileFormatError(
            f"its {compressed:,} bytes claim to hold {size:,}, more than {EXPANSION} times as many: refused as a"
            " decompression bomb"
        )


def _identifier(name: str) -> str:
    return re.sub(r"\W|^(?=\d)", "_", name, flags=re.ASCII)
