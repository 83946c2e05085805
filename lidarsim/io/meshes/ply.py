"""PLY files (``.ply``) in any encoding: vertices, their colours, faces and triangle strips; all else is skipped.

plyfile, which `lidarsim.io.ply` takes for lists in clouds, makes an array of each face: it takes eight times as long.

Format: Greg Turk, The PLY Polygon File Format (http://paulbourke.net/dataformats/ply).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io.meshes._lines import Indices, Lines, floats, lines_of, polygons
from lidarsim.io.ply import ORDERS, TYPES, Order
from lidarsim.world.shapes._polygons import of_strips
from lidarsim.world.shapes.triangle_mesh import MeshFile, register_mesh_reader

_TYPES = {name: np.dtype(code) for name, code in {**TYPES, "int64": "i8", "uint64": "u8"}.items()}
_INDICES = ("vertex_indices", "vertex_index")
_COLORS = ("red", "green", "blue")


@dataclass
class _Property:
    name: str
    dtype: np.dtype[Any]
    count: np.dtype[Any] | None = None
    """Type of a list's length; None for scalars."""


class _Values(NamedTuple):
    """Values of an element, by the index of the property."""

    scalars: dict[int, npt.NDArray[Any]]
    lists: dict[int, tuple[Indices, Indices]]
    """Per list: its concatenated values, truncated to integers, and its length in each row."""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    def place(self, *names: str) -> int:
        """Return the index of the property with one of the names."""
        places = [k for k, prop in enumerate(self.properties) if prop.name in names]
        if len(places) != 1:
            raise FileFormatError(f"its element {self.name} has {len(places)} properties {' or '.join(names)}")
        return places[0]


def read(path: Path) -> MeshFile:
    """Read a file."""
    data = path.read_bytes()
    order, elements, start, line = _header(data)
    if order == ORDERS["ascii"]:
        values = _text(data[start:], line, elements)
    else:
        values = _binary(memoryview(data)[start:], order, elements)
    vertices = np.empty((0, 3))
    colors = None
    corners, sizes = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for element, (scalars, lists) in zip(elements, values, strict=True):
        if element.name == "vertex":
            vertices = np.stack([_scalar(element, scalars, axis) for axis in "xyz"], axis=1)
            if {*_COLORS} <= {prop.name for prop in element.properties}:
                colors = partial(_colors, element, scalars)
        elif element.name in {"face", "tristrips"} and element.count:
            place = element.place(*_INDICES)
            if place not in lists or element.properties[place].dtype.kind == "f":
                raise FileFormatError(f"its element {element.name} has vertex indices that are no list of integers")
            found = lists[place] if element.name == "face" else of_strips(*lists[place])
            corners.append(found[0])
            sizes.append(found[1])
    return MeshFile(vertices, np.concatenate(corners), np.concatenate(sizes), colors=colors)


def _header(data: bytes) -> tuple[Order, list[_Element], int, int]:
    """Return the byte order ("=" for text), the elements, and the first byte and line after the header."""
    mark = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if mark is None:
        raise FileFormatError("it does not begin with the line 'ply'")
    ending = mark[1]
    order: Order | None = None
    elements: list[_Element] = []
    start, number = mark.end(), 1
    while True:
        stop = data.find(ending, start)
        if stop < 0:
            raise FileFormatError("its header has no end")
        words = data[start:stop].decode("latin-1").split()
        start, number = stop + len(ending), number + 1
        match words:
            case ["end_header"]:
                if order is None:
                    raise FileFormatError("its header has no format")
                return order, elements, start, number + 1
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in ORDERS:
                order = ORDERS[name]
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 19:
                elements.append(_Element(name, int(count)))
            case ["property", "list", count, kind, name] if elements and {count, kind} <= _TYPES.keys():
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case _:
                raise FileFormatError(f"line {number}: expected a format, element, property or comment of PLY 1.0")


def _scalar(element: _Element, scalars: dict[int, npt.NDArray[Any]], name: str) -> Floats:
    place = element.place(name)
    if place not in scalars:
        raise FileFormatError(f"its element {element.name} has a list {name}, expected a number")
    return scalars[place].astype(np.float64)


def _colors(element: _Element, scalars: dict[int, npt.NDArray[Any]]) -> Floats:
    """Return the colours of the vertices, shape (n, 3); in integers, 255 is 1."""
    full = [1.0 if element.properties[element.place(name)].dtype.kind == "f" else 255.0 for name in _COLORS]
    return np.stack([_scalar(element, scalars, name) for name in _COLORS], axis=1) / full


def _text(data: bytes, line: int, elements: list[_Element]) -> list[_Values]:
    """Read the elements of a text file: one row per line, without empty lines."""
    lines = lines_of(data, first=line)
    values = []
    start = 0
    for element in elements:
        rows = lines[start : start + element.count]
        start += len(rows)
        if len(rows) < element.count:
            raise _explain_truncation(len(rows), element)
        properties = element.properties
        if not any(prop.count for prop in properties):
            values.append(_Values(dict(enumerate(floats(rows, len(properties)).T)), {}))
        elif len(properties) == 1 and properties[0].dtype.kind in "iu":  # most faces
            values.append(_Values({}, {0: polygons(rows)}))
        else:
            values.append(_text_lists(rows, element))
    if start < len(lines):
        raise FileFormatError(f"line {lines.numbers[start]}: expected the end, after all that the header claims")
    return values


def _text_lists(rows: Lines, element: _Element) -> _Values:
    columns: list[list[float]] = [[] for _ in element.properties]
    sizes: list[list[int]] = [[] for _ in element.properties]
    for number, text in rows:
        try:
            row = list(map(float, text.replace("_", "?").split()))  # float accepts 1_0
        except ValueError:
            raise FileFormatError(f"line {number}: expected numbers, got something else") from None
        place = 0
        for prop, column, lengths in zip(element.properties, columns, sizes, strict=True):
            size = 1
            if prop.count:
                size = int(row[place]) if place < len(row) and row[place].is_integer() else -1
                lengths.append(size)
                place += 1
            part = row[place : place + max(size, 0)]
            if len(part) != size:
                raise FileFormatError(f"line {number}: expected as many numbers as its lists claim, got fewer")
            if prop.dtype.kind != "f" and not all(map(float.is_integer, part)):
                raise FileFormatError(f"line {number}: expected integers, got something else")
            column.extend(part)
            place += size
        if place < len(row):
            raise FileFormatError(f"line {number}: expected as many numbers as its lists claim, got more")
    found = _Values({}, {})
    for k, prop in enumerate(element.properties):
        if prop.count:
            whole = np.clip(np.nan_to_num(columns[k]), -(2**62), 2**62)  # keeps wrong indices out of range
            found.lists[k] = whole.astype(np.int64), np.array(sizes[k], np.int64)
        else:
            found.scalars[k] = np.array(columns[k])
    return found


def _explain_truncation(rows: int, element: _Element) -> FileFormatError:
    return FileFormatError(f"it is truncated: {rows:,} of {element.count:,} of the element {element.name}")


def _binary(data: memoryview, order: Order, elements: list[_Element]) -> list[_Values]:
    """Read the elements of a binary file in its byte order."""
    values = []
    for element in elements:
        for prop in element.properties:
            prop.dtype = prop.dtype.newbyteorder(order)
            prop.count = prop.count and prop.count.newbyteorder(order)
        found, size = _binary_rows(data, element) or _binary_lists(data, element)
        values.append(found)
        data = data[size:]
    if bytes(data[:4096]).strip(b"\0 \t\r\n"):  # some programs pad the end
        raise FileFormatError("expected the end, after all that the header claims")
    return values


def _binary_rows(data: memoryview, element: _Element) -> tuple[_Values, int] | None:
    """Read rows of equal length; return them and their size in bytes, or None if lists differ in length or are cut."""
    parts: list[tuple[str, Any]] = []
    place = 0
    for k, prop in enumerate(element.properties):
        size = 1
        if prop.count:
            size = _size(data, place, prop.count) if element.count else 0
            parts.append((f"size{k}", prop.count))
            place += prop.count.itemsize
            if size < 0 or place + size * prop.dtype.itemsize > len(data):
                return None
        parts.append((f"{k}", (prop.dtype, (size,)) if prop.count else prop.dtype))
        place += size * prop.dtype.itemsize
    if place * element.count > len(data):
        if any(prop.count for prop in element.properties):
            return None
        raise _explain_truncation(len(data) // place, element)
    rows = np.frombuffer(data, np.dtype(parts), element.count) if place else np.empty(0, np.dtype(parts))
    scalars, lists = {}, {}
    for k, prop in enumerate(element.properties):
        if not prop.count:
            scalars[k] = rows[f"{k}"]
            continue
        sizes = rows[f"size{k}"].astype(np.int64)
        if len(sizes) and (sizes != sizes[0]).any():
            return None
        lists[k] = rows[f"{k}"].astype(np.int64).ravel(), sizes
    return _Values(scalars, lists), place * element.count


def _binary_lists(data: memoryview, element: _Element) -> tuple[_Values, int]:
    """Read rows of any length one by one; return them and their size in bytes."""
    parts: dict[int, list[npt.NDArray[Any]]] = {k: [] for k in range(len(element.properties))}
    place = 0
    for row in range(element.count):
        for k, prop in enumerate(element.properties):
            size = 1
            if prop.count:
                size = _size(data, place, prop.count)
                place += prop.count.itemsize
            end = place + size * prop.dtype.itemsize
            if size < 0 or end > len(data):
                raise _explain_truncation(row, element)
            parts[k].append(np.frombuffer(data, prop.dtype, size, place))
            place = end
    scalars, lists = {}, {}
    for k, prop in enumerate(element.properties):
        joined = np.concatenate([np.empty(0, prop.dtype), *parts[k]])
        if prop.count:
            lists[k] = joined.astype(np.int64), np.array([len(part) for part in parts[k]], np.int64)
        else:
            scalars[k] = joined
    return _Values(scalars, lists), place


def _size(data: memoryview, place: int, dtype: np.dtype[Any]) -> int:
    """Return the length of a list, or −1 if the data end before it."""
    return int(np.frombuffer(data, dtype, 1, place)[0]) if place + dtype.itemsize <= len(data) else -1


register_mesh_reader(lambda path: path.suffix.lower() == ".ply", read)
