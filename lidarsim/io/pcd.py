"""PCD files of the Point Cloud Library (``.pcd``): written binary; read binary, compressed or ASCII.

`xyz` is float32 if that keeps every coordinate to 0.1 mm, as it does up to 2048 m from the origin; else it is float64,
which lidarsim and Open3D read, but not the Point Cloud Library, and a warning says so. The argument `float32` decides
otherwise. All fields are kept, vectors other than `xyz` and `normal` as one field per component; bool cannot be stored.

Files of old versions are read as the Point Cloud Library reads them: FIELDS may be called COLUMNS, missing SIZE and
TYPE mean float32, VERSION, COUNT, VIEWPOINT and HEIGHT are optional, and POINTS can replace WIDTH. Where a number in an
ASCII file does not fit the TYPE of its field, such as NaN in an integer field, the field is 0 and a field
``<name>_raw`` has the numbers of the file. Organised clouds are read row by row. A field with the COUNT 0 has no bytes
and is left out.

Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html.
"""

from __future__ import annotations

import math
import os
import struct
import warnings
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.validation import Floats, short
from lidarsim.errors import FileFormatError
from lidarsim.io import _records
from lidarsim.io._units import KEPT, rounding_error
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format

NORMAL = ("normal_x", "normal_y", "normal_z")
CODES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
DEFAULTS = {"SIZE": "4", "TYPE": "F", "COUNT": "1"}
"""Keys that describe a field, with their defaults for old files."""

KEYS = {"VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"}


def save(
    fields: Fields,
    file: BinaryIO,
    *,
    pose: Floats | None = None,
    class_names: Mapping[int, str] | None = None,
    float32: bool | None = None,
) -> None:
    """Write the fields as ``DATA binary``; VIEWPOINT, ``tx ty tz qw qx qy qz``, maps the points to the world.

    Normals get the type of the positions, since Open3D's reader assumes so and returns garbage otherwise. Comments
    hold the class names.
    """
    if float32 is None:
        fields = fields | {"xyz": _as_readers_take(fields["xyz"])}
    if "normal" in fields:
        fields = fields | {"normal": fields["normal"].astype(fields["xyz"].dtype)}
    columns = _records.to_columns(fields, NORMAL, CODES)
    record = _records.record_of(columns)
    parts = [record[name] for name in columns]
    points = len(fields["xyz"])
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {comment}" for comment in _records.class_comments(class_names or {})),
        "VERSION 0.7",
        f"FIELDS {' '.join(columns)}",
        f"SIZE {' '.join(str(part.itemsize) for part in parts)}",
        f"TYPE {' '.join(part.kind.upper() for part in parts)}",
        f"COUNT {' '.join('1' for _ in parts)}",
        f"WIDTH {points}",
        "HEIGHT 1",
        f"VIEWPOINT {_viewpoint(pose)}",
        f"POINTS {points}",
        "DATA binary",
    ]
    file.write(_records.header_lines(header))
    file.writelines(records.data for records in _records.to_records(columns, record))


def _as_readers_take(xyz: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the positions as float32 if that keeps them to 0.1 mm, else unchanged, with a warning."""
    error = rounding_error(xyz)
    if error <= KEPT:
        return xyz.astype(np.float32)
    message = (
        f"xyz: written as float64, since float32 would move points by up to {error:.2g} m; the Point Cloud Library "
        "reads only float32 (float32=True writes that, float32=False is silent)"
    )
    warnings.warn(message, stacklevel=4)  # at the call of PointCloud.save
    return xyz


def _viewpoint(pose: Floats | None) -> str:
    if pose is None:
        return "0 0 0 1 0 0 0"
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()
    return " ".join(map(repr, (*pose[:3, 3].tolist(), w, x, y, z)))


def load(file: BinaryIO) -> dict[str, Any]:
    """Read the points in the coordinates of the file: as in other readers, VIEWPOINT is not applied."""
    header = _header(file)
    points, dtype = _points(header), _layout(header)
    encoding = header["DATA"][0].lower()
    if encoding == "ascii":
        each = sum(math.prod(dtype[name].shape) for name in dtype.names or ())
        if points and 2 * each > os.fstat(file.fileno()).st_size - file.tell() + 1:  # a digit and a space each
            raise FileFormatError(f"it is truncated: 0 of {points} points")
        parts = _records.parse_lines((line.decode("ascii", "replace") for line in file), dtype, points)
    elif encoding == "binary":
        parts = _records.from_records(file, dtype, points)
    elif encoding == "binary_compressed":
        empty = _records.columns_of(np.empty(0, dtype))
        parts = _records.blocks(_decompress(file, points, dtype) if points else empty)
    else:
        raise FileFormatError(f"its DATA is {encoding!r}, expected ascii, binary or binary_compressed")
    columns = {name: column for name, column in _records.join(parts).items() if not name.startswith("_ ")}
    fields = _records.to_fields(_records.as_declared(columns, dtype), NORMAL)
    return fields | {"class_names": _records.read_commented_classes(header.get("#", ()))}


def _header(file: BinaryIO) -> dict[str, list[str]]:
    """Return the values of each key, and the comments under "#"."""
    header: dict[str, list[str]] = {}
    while "DATA" not in header:
        line = file.readline(_records.HEADER)
        if line.startswith(b"#"):
            header.setdefault("#", []).append(line[1:].decode("ascii", "replace"))
            continue
        if line.isspace():
            continue
        key, *values = line.decode("utf-8", "replace").split() or [""]
        key = "FIELDS" if key == "COLUMNS" else key
        if key not in KEYS:
            raise FileFormatError("expected the header of a PCD file, got something else")
        header[key] = values
    for key in ("FIELDS", "DATA"):
        if not header.get(key):
            raise FileFormatError(f"its header has no {key}")
    return header


def _points(header: dict[str, list[str]]) -> int:
    """Return the number of points."""
    sizes = {key: header[key][0] for key in ("WIDTH", "HEIGHT", "POINTS") if header.get(key)}
    for key, size in sizes.items():
        if not size.isdecimal():
            raise FileFormatError(f"its {key} is {size}, expected a count")
    if not sizes.keys() & {"WIDTH", "POINTS"}:
        raise FileFormatError("its header has no WIDTH")
    height = int(sizes.get("HEIGHT", 1))
    points = int(sizes["POINTS"]) if "POINTS" in sizes else height * int(sizes["WIDTH"])
    width = int(sizes["WIDTH"]) if "WIDTH" in sizes else points // max(height, 1)
    if width * height != points:
        raise FileFormatError(f"its WIDTH of {width} times its HEIGHT of {height} is not its POINTS, {points}")
    return points


def _layout(header: dict[str, list[str]]) -> np.dtype[np.void]:
    """Return the dtype of a point."""
    fields = header["FIELDS"]
    _records.check_columns(len(fields))
    values = [header.get(key) or [default] * len(fields) for key, default in DEFAULTS.items()]
    for key, given in zip(DEFAULTS, values, strict=True):
        if len(given) != len(fields):
            raise FileFormatError(f"its header has {len(fields)} FIELDS, but {len(given)} {key}")
    parts: dict[str, tuple[str, tuple[int, ...]]] = {}
    for i, (name, size, kind, count) in enumerate(zip(fields, *values, strict=True)):
        if count == "0":
            continue
        if f"{kind.lower()}{size}" not in CODES or not count.isdecimal() or not int(count):
            raise FileFormatError(
                f"its field {short(name)} has the unknown layout TYPE {kind}, SIZE {size}, COUNT {count}"
            )
        if name in parts:
            raise FileFormatError(f"it has two fields named {short(repr(name))}")
        shape = () if count == "1" else (int(count),)
        parts[f"_ {i}" if name == "_" else name] = f"<{kind.lower()}{size}", shape  # "_" is padding
    return np.dtype([(name, *part) for name, part in parts.items()])


def _decompress(file: BinaryIO, points: int, dtype: np.dtype[np.void]) -> Fields:
    """Return the columns of ``DATA binary_compressed``: the concatenated fields, compressed by LZF."""
    lzf = import_extra("lzf", "formats", "reading compressed PCD files")
    sizes = file.read(8)
    compressed, size = struct.unpack("<II", sizes) if len(sizes) == 8 else (1, 0)
    if compressed > os.fstat(file.fileno()).st_size - file.tell():
        raise FileFormatError("it is truncated inside its compressed data")
    if size != points * dtype.itemsize:
        raise FileFormatError(f"its compressed data holds {size} bytes, expected {points * dtype.itemsize}")
    _records.check_expansion(size, compressed)
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
