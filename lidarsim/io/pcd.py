"""PCD files of the Point Cloud Library: written binary; read binary, compressed or ASCII.

Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html.
"""

from __future__ import annotations

import os
import struct
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from lidarsim._extras import import_extra
from lidarsim._validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._records import to_fields, to_records
from lidarsim.pointcloud import Fields, register_format

NORMAL = ("normal_x", "normal_y", "normal_z")
CODES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
KEYS = {"VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"}


def save(fields: Fields, file: BinaryIO, *, pose: Floats | None = None) -> None:
    """Write the fields as ``DATA binary``; VIEWPOINT, ``tx ty tz qw qx qy qz``, takes the points into the world.

    Normals get the type of the positions: Open3D's reader takes them to have it, and gives garbage where they do not.
    """
    if "normal" in fields:
        fields = fields | {"normal": fields["normal"].astype(fields["xyz"].dtype)}
    records = to_records(fields, NORMAL, CODES)
    columns = [(name, records.dtype[name]) for name in records.dtype.names or ()]
    header = f"""\
# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS {" ".join(name for name, _ in columns)}
SIZE {" ".join(str(dtype.itemsize) for _, dtype in columns)}
TYPE {" ".join(dtype.kind.upper() for _, dtype in columns)}
COUNT {" ".join("1" for _ in columns)}
WIDTH {len(records)}
HEIGHT 1
VIEWPOINT {_viewpoint(pose)}
POINTS {len(records)}
DATA binary
"""
    file.write(header.encode("ascii"))
    file.write(records.data)


def _viewpoint(pose: Floats | None) -> str:
    if pose is None:
        return "0 0 0 1 0 0 0"
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()
    return " ".join(map(repr, (*pose[:3, 3].tolist(), w, x, y, z)))


def load(file: BinaryIO) -> Fields:
    """Read the points in the file's own coordinates: like other readers, this one leaves VIEWPOINT unapplied."""
    header = _header(file)
    points, dtype = _layout(header)
    encoding = header["DATA"][0]
    if encoding == "ascii":
        lines = [line for line in file if not line.isspace()][:points]
        records = np.loadtxt(lines, dtype, comments=None, ndmin=1) if lines else np.empty(0, dtype)
    elif encoding == "binary":
        # Not file.read(points * itemsize): a damaged count must not ask for that much memory.
        rest = os.fstat(file.fileno()).st_size - file.tell()
        records = np.frombuffer(file.read(min(points, rest // dtype.itemsize) * dtype.itemsize), dtype)
    elif encoding == "binary_compressed":
        records = _decompressed(file, points, dtype) if points else np.empty(0, dtype)
    else:
        raise FileFormatError(f"its DATA is {encoding!r}, expected ascii, binary or binary_compressed")
    if len(records) < points:
        raise FileFormatError(f"it is truncated: {len(records)} of {points} points")
    return to_fields({name: records[name] for name in dtype.names or () if not name.startswith("_ ")}, NORMAL)


def _header(file: BinaryIO) -> dict[str, list[str]]:
    header: dict[str, list[str]] = {}
    while "DATA" not in header:
        line = file.readline(1 << 16)
        if line.startswith(b"#") or line.isspace():
            continue
        key, *values = line.decode("ascii", "replace").split() or [""]
        if key not in KEYS:
            raise FileFormatError(f"expected the header of a PCD file, got {line[:20]!r}")
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


def _decompressed(file: BinaryIO, points: int, dtype: np.dtype[np.void]) -> npt.NDArray[np.void]:
    """Return the records of ``DATA binary_compressed``: LZF over the fields, one after the other."""
    lzf = import_extra("lzf", "formats", "reading compressed PCD files")
    sizes = file.read(8)
    compressed, size = struct.unpack("<II", sizes) if len(sizes) == 8 else (1, 0)
    block = file.read(compressed)
    if len(block) < compressed:
        raise FileFormatError("it is truncated inside its compressed data")
    if size != points * dtype.itemsize:
        raise FileFormatError(f"its compressed data holds {size} bytes, expected {points * dtype.itemsize}")
    data = lzf.decompress(block, size)
    if data is None or len(data) != size:
        raise FileFormatError("its compressed data is damaged")
    records = np.empty(points, dtype)
    offset = 0
    for name in dtype.names or ():
        records[name] = np.ndarray(points, dtype[name], data, offset)
        offset += points * dtype[name].itemsize
    return records


register_format(".pcd", save=save, load=load)
