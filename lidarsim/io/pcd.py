"""PCD files of the Point Cloud Library (``.pcd``): written binary; read binary, compressed or ASCII.

All fields are kept, vectors other than `xyz` and `normal` as one field per component; bool cannot be stored.
Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html.
"""

from __future__ import annotations

import itertools
import os
import struct
import sys
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim._extras import import_extra
from lidarsim._validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._records import (
    BLOCK,
    blocks,
    check_expansion,
    class_comments,
    commented_classes,
    from_records,
    joined,
    record_of,
    to_columns,
    to_fields,
    to_records,
)
from lidarsim.pointcloud import Fields, register_format

NORMAL = ("normal_x", "normal_y", "normal_z")
CODES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
KEYS = {"VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"}


def save(
    fields: Fields, file: BinaryIO, *, pose: Floats | None = None, class_names: Mapping[int, str] | None = None
) -> None:
    """Write the fields as ``DATA binary``; VIEWPOINT, ``tx ty tz qw qx qy qz``, takes the points into the world.

    Normals get the type of the positions: Open3D's reader assumes so, and returns garbage otherwise. Comments hold
    the class names.
    """
    if "normal" in fields:
        fields = fields | {"normal": fields["normal"].astype(fields["xyz"].dtype)}
    columns = to_columns(fields, NORMAL, CODES)
    record = record_of(columns)
    parts = [record[name] for name in columns]
    points = len(fields["xyz"])
    comments = "".join(f"# {comment}\n" for comment in class_comments(class_names or {}))
    header = f"""\
# .PCD v0.7 - Point Cloud Data file format
{comments}VERSION 0.7
FIELDS {" ".join(columns)}
SIZE {" ".join(str(part.itemsize) for part in parts)}
TYPE {" ".join(part.kind.upper() for part in parts)}
COUNT {" ".join("1" for _ in parts)}
WIDTH {points}
HEIGHT 1
VIEWPOINT {_viewpoint(pose)}
POINTS {points}
DATA binary
"""
    file.write(header.encode("ascii"))
    file.writelines(records.data for records in to_records(columns, record))


def _viewpoint(pose: Floats | None) -> str:
    if pose is None:
        return "0 0 0 1 0 0 0"
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()
    return " ".join(map(repr, (*pose[:3, 3].tolist(), w, x, y, z)))


def load(file: BinaryIO) -> dict[str, Any]:
    """Read the points in the file's own coordinates: like other readers, this one leaves VIEWPOINT unapplied."""
    header = _header(file)
    points, dtype = _layout(header)
    encoding = header["DATA"][0]
    if encoding == "ascii":
        parts = _parsed(file, points, dtype)
    elif encoding == "binary":
        parts = from_records(file, dtype, points)
    elif encoding == "binary_compressed":
        parts = blocks(_decompressed(file, points, dtype) if points else _columns(np.empty(0, dtype)))
    else:
        raise FileFormatError(f"its DATA is {encoding!r}, expected ascii, binary or binary_compressed")
    columns = joined(parts)
    fields = to_fields({name: column for name, column in columns.items() if not name.startswith("_ ")}, NORMAL)
    return fields | {"class_names": commented_classes(header.get("#", ()))}


def _header(file: BinaryIO) -> dict[str, list[str]]:
    """Return the values of each key, and the comments as those of "#"."""
    header: dict[str, list[str]] = {}
    while "DATA" not in header:
        line = file.readline(1 << 16)
        if line.startswith(b"#"):
            header.setdefault("#", []).append(line[1:].decode("ascii", "replace"))
            continue
        if line.isspace():
            continue
        key, *values = line.decode("ascii", "replace").split() or [""]
        if key not in KEYS:
            raise FileFormatError("expected the header of a PCD file, got something else")
        header[key] = values
    for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA"):
        if not header.get(key):
            raise FileFormatError(f"its header has no {key}")
    for key in ("WIDTH", "HEIGHT"):
        if not header[key][0].isdecimal():
            raise FileFormatError(f"its {key} is {header[key][0]}, expected a count")
    return header


def _layout(header: dict[str, list[str]]) -> tuple[int, np.dtype[np.void]]:
    """Return the number of points and the dtype of one."""
    fields = header["FIELDS"]
    counts = header.get("COUNT", ["1"] * len(fields))  # optional before version 0.7
    for key, values in (("SIZE", header["SIZE"]), ("TYPE", header["TYPE"]), ("COUNT", counts)):
        if len(values) != len(fields):
            raise FileFormatError(f"its header has {len(fields)} FIELDS, but {len(values)} {key}")
    parts = []
    for i, (name, size, kind, count) in enumerate(zip(fields, header["SIZE"], header["TYPE"], counts, strict=True)):
        if f"{kind.lower()}{size}" not in CODES or not count.isdecimal():
            raise FileFormatError(f"its field {name} has the unknown layout TYPE {kind}, SIZE {size}, COUNT {count}")
        shape = () if count == "1" else (int(count),)
        parts.append((f"_ {i}" if name == "_" else name, f"<{kind.lower()}{size}", shape))  # "_" is padding
    return int(header["WIDTH"][0]) * int(header["HEIGHT"][0]), np.dtype(parts)


def _parsed(file: BinaryIO, points: int, dtype: np.dtype[np.void]) -> Iterator[Fields]:
    """Yield the columns of ``DATA ascii``, one point per line."""
    lines = itertools.islice((line for line in file if not line.isspace()), min(points, sys.maxsize))
    read = 0
    yield _columns(np.empty(0, dtype))
    while part := list(itertools.islice(lines, BLOCK)):
        records = np.loadtxt(part, dtype, comments=None, ndmin=1)
        read += len(records)
        yield _columns(records)
    if read < points:
        raise FileFormatError(f"it is truncated: {read} of {points} points")


def _columns(records: npt.NDArray[np.void]) -> Fields:
    return {name: records[name] for name in records.dtype.names or ()}


def _decompressed(file: BinaryIO, points: int, dtype: np.dtype[np.void]) -> Fields:
    """Return the columns of ``DATA binary_compressed``: LZF over the fields, one after the other."""
    lzf = import_extra("lzf", "formats", "reading compressed PCD files")
    sizes = file.read(8)
    compressed, size = struct.unpack("<II", sizes) if len(sizes) == 8 else (1, 0)
    if compressed > os.fstat(file.fileno()).st_size - file.tell():
        raise FileFormatError("it is truncated inside its compressed data")
    if size != points * dtype.itemsize:
        raise FileFormatError(f"its compressed data holds {size} bytes, expected {points * dtype.itemsize}")
    check_expansion(size, compressed)
    data = lzf.decompress(file.read(compressed), size)
    if data is None or len(data) != size:
        raise FileFormatError("its compressed data is damaged")
    columns: Fields = {}
    offset = 0
    for name in dtype.names or ():
        columns[name] = np.ndarray((points, *dtype[name].shape), dtype[name].base, data, offset)
        offset += points * dtype[name].itemsize
    return columns


register_format(".pcd", save=save, load=load, signature=b"# .PCD")
