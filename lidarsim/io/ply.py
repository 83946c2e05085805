"""PLY files (``.ply``): written binary little-endian; read in any encoding, with any line ends.

All fields are kept, vectors other than `xyz` and `normal` as one property per component; bool, int64 and uint64 cannot
be stored. Where a number in an ASCII file does not fit the type of its property, the field is 0 and a field
``<name>_raw`` has the numbers of the file. List properties of the element ``vertex`` and other elements are not read.
"""

from __future__ import annotations

import io
import itertools
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Literal

import numpy as np

from lidarsim._base.extras import import_extra
from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError
from lidarsim.io import _records
from lidarsim.scan.fields import Fields, narrow
from lidarsim.scan.formats import register_format

NORMAL = ("nx", "ny", "nz")
CODES = {"f4", "f8", "i4", "u1", "u2"}
WIDENED = {"i1", "i2", "u4"}
Order = Literal["=", "<", ">"]
ORDERS: dict[str, Order] = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Byte order of each encoding."""

SPELLINGS = {
    "i1": ("int8", "char"),
    "i2": ("int16", "short"),
    "i4": ("int32", "int"),
    "u1": ("uint8", "uchar"),
    "u2": ("uint16", "ushort"),
    "u4": ("uint32", "uint"),
    "f4": ("float32", "float"),
    "f8": ("float64", "double"),
}
TYPES = {name: kind for kind, names in SPELLINGS.items() for name in names}


def save(fields: Fields, file: BinaryIO, *, class_names: Mapping[int, str] | None = None) -> None:
    """Write the fields as the element ``vertex``.

    Types are named by their size, since Open3D reads ``uint16`` but skips ``ushort``. It also skips int8, int16 and
    uint32: these are widened, and a comment names the original type. Comments also hold the class names.
    """
    widened = {name: array for name, array in fields.items() if array.dtype.str[1:] in WIDENED}
    fields = fields | {name: narrow(name, array) for name, array in widened.items()}
    columns = _records.to_columns(fields, NORMAL, CODES)
    record = _records.record_of(columns)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment type {name} {array.dtype.name}" for name, array in widened.items()),
        *(f"comment {comment}" for comment in _records.class_comments(class_names or {})),
        f"element vertex {len(fields['xyz'])}",
        *(f"property {record[name].name} {name}" for name in columns),
        "end_header",
    ]
    file.write(_records.header_lines(header))
    file.writelines(records.data for records in _records.to_records(columns, record))


@dataclass
class _Element:
    name: str
    count: int
    types: dict[str, str] = field(default_factory=dict)
    """NumPy type of each property; for a list, ``"list"`` and plyfile's names of its two types."""

    @property
    def has_lists(self) -> bool:
        return any(kind.startswith("list") for kind in self.types.values())


@dataclass
class _Header:
    encoding: str
    comments: list[str]
    elements: dict[str, _Element]
    size: int  # bytes


def load(file: BinaryIO) -> dict[str, Any]:
    """Read the element ``vertex``, except lists; faces and other elements are skipped."""
    header = _header(file)
    _check_counts(header, os.fstat(file.fileno()).st_size - header.size)
    if "vertex" not in header.elements:
        elements = ", ".join(header.elements) or "(none)"
        raise FileFormatError(f"it has no element 'vertex' among its elements {short(elements)}")
    vertices = header.elements["vertex"]
    before = list(itertools.takewhile(lambda element: element is not vertices, header.elements.values()))
    file.seek(header.size)
    binary = header.encoding != "ascii"
    if vertices.has_lists or (binary and any(element.has_lists for element in before)):
        columns = _with_lists(file, header)
    elif binary:
        dtypes = [_dtype(element, ORDERS[header.encoding]) for element in (*before, vertices)]
        skipped = sum(element.count * dtype.itemsize for element, dtype in zip(before, dtypes, strict=False))
        file.seek(skipped, os.SEEK_CUR)
        columns = _records.join(_records.from_records(file, dtypes[-1], vertices.count))
    else:
        with _records.decoded(file, "ascii") as text:
            skipped = sum(element.count for element in before)
            lines = itertools.islice((line for line in text if not line.isspace()), skipped, None)
            dtype = _dtype(vertices, "=")
            columns = _records.as_declared(_records.join(_records.parse_lines(lines, dtype, vertices.count)), dtype)
    fields: dict[str, Any] = _records.to_fields(columns, NORMAL)
    for comment in header.comments:
        match comment.split():
            case ["type", name, "int8" | "int16" | "uint32" as was] if name in fields:
                narrow = fields[name].astype(was)
                if np.array_equal(narrow, fields[name]):
                    fields[name] = narrow
    return fields | {"class_names": _records.read_commented_classes(header.comments)}


def _dtype(element: _Element, order: str) -> np.dtype[np.void]:
    return np.dtype([(name, order + kind) for name, kind in element.types.items()])


def _header(file: BinaryIO) -> _Header:
    """Parse a header."""
    (first, *lines), size = _header_lines(file)
    if first.strip() != b"ply":
        raise FileFormatError(f"it does not begin with 'ply' alone, but with {short(repr(first))}")
    header = _Header("", [], {}, size)
    for number, line in enumerate(lines, 2):
        _add_line(header, line, number)
    if not header.encoding:
        raise FileFormatError("its header has no format")
    return header


def _header_lines(file: BinaryIO) -> tuple[list[bytes], int]:
    """Return the lines of a header except the last, and its size in bytes; all lines end as the first does."""
    head, end = file.read(3), None
    if head != b"ply":
        raise FileFormatError("it does not begin with 'ply'")
    while not end:
        more = file.read(max(1 << 16, len(head)))
        head += more
        newline = re.search(rb"\r\n|\r(?=.)|\n|$", head, re.DOTALL)
        last = b"\r" if newline and newline[0] == b"\r" else b"\n"
        end = re.search(rb"[\r\n][ \t]*end_header[ \t\r]*?(?:%s%s)" % (last, b"" if more else rb"|\Z"), head)
        if not end and (not more or len(head) > _records.HEADER):
            raise FileFormatError("its header has no end")
    return re.split(rb"\r?\n|\r", head[: end.start()]), end.end()


def _add_line(header: _Header, line: bytes, number: int) -> None:
    """Parse one line of the header."""
    words = line.decode("utf-8", "replace").split()
    element = next(reversed(header.elements.values()), None)
    match words:
        case []:
            pass
        case ["comment" | "obj_info" as key, *_]:
            header.comments.append(line.decode("ascii", "replace").strip().removeprefix(key).strip())
        case ["format", kind, *_] if kind in ORDERS:
            header.encoding = kind
        case ["element", name, count] if count.isdecimal() and name not in header.elements:
            header.elements[name] = _Element(name, int(count))
        case ["property", "list", length, kind, *name] if element and name and {length, kind} <= TYPES.keys():
            _add_property(element, " ".join(name), f"list {length} {kind}")
        case ["property", kind, *name] if element and name and kind in TYPES:
            _add_property(element, " ".join(name), TYPES[kind])
        case _:
            raise FileFormatError(f"line {number} of its header is not understood: {short(repr(' '.join(words)))}")


def _add_property(element: _Element, name: str, kind: str) -> None:
    _records.check_columns(len(element.types) + 1)
    if name in element.types:
        raise FileFormatError(f"its element {element.name!r} has two properties named {short(repr(name))}")
    element.types[name] = kind


def _check_counts(header: _Header, rest: int) -> None:
    """Check that the `rest` bytes after the header can hold the elements that it claims.

    A property takes at least one byte, in text two with the following space or line end.
    """
    text = header.encoding == "ascii"
    for element in header.elements.values():
        if element.count * max(len(element.types), 1) * (1 + text) > rest + text:  # the last line need not end
            raise FileFormatError(
                f"it is truncated: its header claims {element.count} of the element {short(element.name)!r}"
            )


def _with_lists(file: BinaryIO, header: _Header) -> Fields:
    """Read the scalar properties of the vertices with plyfile, from a copy of the header with simple names."""
    plyfile = import_extra("plyfile", "formats", "reading PLY files that have lists")
    lines = ["ply", f"format {header.encoding} 1.0"]
    for i, element in enumerate(header.elements.values()):
        lines.append(f"element e{i} {element.count}")
        lines += [
            f"property {SPELLINGS[kind][0] if kind in SPELLINGS else kind} p{j}"
            for j, kind in enumerate(element.types.values())
        ]
    if header.encoding == "ascii":
        with _records.decoded(file, "ascii") as text:
            rest = "".join(line for line in text if not line.isspace()).encode("ascii", "replace")
    else:
        rest = file.read()
    ply = plyfile.PlyData.read(io.BytesIO(_records.header_lines([*lines, "end_header"]) + rest))
    number = list(header.elements).index("vertex")
    vertices = ply[f"e{number}"]
    kinds = header.elements["vertex"].types
    return {name: vertices[f"p{j}"] for j, (name, kind) in enumerate(kinds.items()) if not kind.startswith("list")}


register_format(".ply", save=save, load=load, signature=b"ply")
