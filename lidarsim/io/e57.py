"""ASTM E57 files (``.e57``) of terrestrial scanners, by pye57 (``lidarsim[survey]``).

A cloud is one scan, with the pose of `PointCloud.save`: xyz as float64 in the frame of the scanner, `intensity`, `time`
(timeStamp), `column` and `ring` (columnIndex, rowIndex), `return_number` and `return_count` (returnIndex from 0 on,
returnCount) and the bytes `red`, `green` and `blue`. All other fields are lost.

When a file is read, its scans become one cloud in the world, and `scan` counts them if there are several. Where a scan
lacks a field of another, its points have NaN there, or 0 in fields of integers. Points that the file marks as invalid
are left out. All numbers of the points are read, also those that lidarsim does not write.

Format: ASTM E2807.
"""

from __future__ import annotations

import os
import shutil
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO
from uuid import uuid4

import numpy as np

from lidarsim._base import validation
from lidarsim._base.extras import import_extra
from lidarsim._base.files import link
from lidarsim._base.validation import Floats
from lidarsim._base.vectors import product
from lidarsim.errors import FileFormatError
from lidarsim.io._records import Expansion, to_fields
from lidarsim.io._scanners import COLOURS, check_finite, colours_of, join_lists
from lidarsim.scan.fields import Fields, fit
from lidarsim.scan.formats import register_format

NAMES = {
    **{f"cartesian{axis.upper()}": axis for axis in "xyz"},
    "intensity": "intensity",
    "timeStamp": "time",
    "columnIndex": "column",
    "rowIndex": "ring",
    "returnIndex": "return_number",
    "returnCount": "return_count",
    **{f"color{colour.capitalize()}": colour for colour in COLOURS},
}
"""lidarsim's names by those of E57."""

SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
VALID = "cartesianInvalidState"
"""0 for each point that is written: pye57 asks for it. A column of one value takes no space."""
INVALID = (VALID, "sphericalInvalidState")


def _library() -> Any:
    return import_extra("pye57", "survey", "reading and writing E57 files")


def save(fields: Fields, file: BinaryIO, *, pose: Floats | None = None) -> None:
    """Write one scan."""
    check_finite(fields)
    library = _library()
    columns = {**dict(zip("xyz", fields["xyz"].T, strict=True)), **colours_of(fields)}
    columns |= {name: fields[name] for name in NAMES.values() if name in fields and name not in columns}
    if "return_number" in columns:
        columns["return_number"] = columns["return_number"].astype(np.int64) - 1
    columns[VALID] = np.zeros(len(fields["xyz"]), np.int8)
    with TemporaryDirectory() as folder:
        path = str(Path(folder) / "cloud.e57")
        written = library.E57(path, "w")
        try:
            _write(library.libe57, written, columns, np.eye(4) if pose is None else pose)
            written.close()
        except library.libe57.E57Exception as error:
            raise OSError(f"{str(error).partition(chr(10))[0]} in {folder}") from error
        finally:
            written.image_file.cancel()  # unless it is closed: what fails once would fail again when it is freed
        with Path(path).open("rb") as whole:
            shutil.copyfileobj(whole, file)


def _write(e57: Any, written: Any, columns: Fields, pose: Floats) -> None:
    from scipy.spatial.transform import Rotation

    image = written.image_file
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()
    scan, prototype = e57.StructureNode(image), e57.StructureNode(image)
    scan.set("guid", e57.StringNode(image, f"{{{uuid4()}}}"))
    scan.set("name", e57.StringNode(image, "scan"))
    placed = {"rotation": {"w": w, "x": x, "y": y, "z": z}, "translation": dict(zip("xyz", pose[:3, 3], strict=True))}
    node = e57.StructureNode(image)
    scan.set("pose", node)
    for part, numbers in placed.items():
        inner = e57.StructureNode(image)
        node.set(part, inner)
        for name, number in numbers.items():
            inner.set(name, e57.FloatNode(image, float(number)))
    buffers, kept = e57.VectorSourceDestBuffer(), []
    n = len(columns["x"])
    for name, own in (NAMES | {VALID: VALID}).items():
        if own not in columns:
            continue
        column = columns[own]
        if column.dtype.kind == "f":
            precision = e57.E57_SINGLE if column.dtype == np.float32 else e57.E57_DOUBLE
            prototype.set(name, e57.FloatNode(image, 0.0, precision))
        else:
            least, most = (int(column.min()), int(column.max())) if n else (0, 0)
            if own in COLOURS:
                least, most = 0, 255
            prototype.set(name, e57.IntegerNode(image, least, least, most))
        kept.append(np.ascontiguousarray(column, np.float32 if column.dtype == np.float32 else np.float64))
        buffers.append(e57.SourceDestBuffer(image, name, kept[-1], n, True, True))
    points = e57.CompressedVectorNode(image, prototype, e57.VectorNode(image, True))
    scan.set("points", points)
    written.data3d.append(scan)
    writer = points.writer(buffers)
    try:
        if n:
            writer.write(n)
        writer.close()
    finally:
        del writer  # an error would keep it until the file is gone, to which it writes again when it is freed


def load(file: BinaryIO) -> Fields:
    """Read all scans."""
    library = _library()
    path = Path(file.name)
    plain = nullcontext(path) if file.name.isprintable() else link(path, "cloud.e57")  # pye57 takes no other text
    with plain as place, library.E57(str(place)) as read:
        count = read.scan_count
        expansion = Expansion(os.fstat(file.fileno()).st_size)
        columns = join_lists(_scan(library, read, i, expansion) for i in range(count))
    if count < 2:
        columns.pop("scan", None)
    return to_fields(columns, ())


def _scan(library: Any, read: Any, index: int, expansion: Expansion) -> Fields:
    header = read.get_header(index)
    n, names = int(header.point_count), list(header.point_fields)
    if n < 0 or len(set(names)) != len(names):
        raise FileFormatError("its points are damaged")
    expansion.take(8 * n * len(names))
    e57, buffers, numbers = library.libe57, library.libe57.VectorSourceDestBuffer(), {}
    for name in names:
        numbers[name] = np.zeros(n)
        buffers.append(e57.SourceDestBuffer(read.image_file, name, numbers[name], n, True, True))
    if n:
        reader = header.points.reader(buffers)
        found = reader.read()
        reader.close()
        if found != n:
            raise FileFormatError(f"it is truncated: {found} of {n} points")
    valid = np.ones(n, bool)
    for name in INVALID:
        valid &= numbers.pop(name, np.zeros(n)) == 0
    fields = {NAMES.get(name, name): column[valid] for name, column in numbers.items()}
    if "x" not in fields and all(name in fields for name in SPHERICAL):
        r, azimuth, elevation = (fields.pop(name) for name in SPHERICAL)
        ahead = r * np.cos(elevation)
        fields |= {"x": ahead * np.cos(azimuth), "y": ahead * np.sin(azimuth), "z": r * np.sin(elevation)}
    if "return_number" in fields:
        fields["return_number"] += 1
    for name in COLOURS:
        if name in fields and fit(fields[name], np.uint8)[1]:
            fields[name] = fields[name].astype(np.uint8)
    if header.has_pose() and all(name in fields for name in "xyz"):
        fields |= _to_world(np.stack([fields[name] for name in "xyz"], axis=1), header)
    return fields | {"scan": np.full(len(next(iter(fields.values()), ())), index, np.uint32)}


def _to_world(xyz: Floats, header: Any) -> Fields:
    """Return the coordinates in the world."""
    from scipy.spatial.transform import Rotation

    quaternion, shift = np.array(header.rotation, float), np.array(header.translation, float)
    length = float(np.linalg.norm(quaternion))
    if not (abs(length - 1.0) <= validation.NEARLY_RIGID and np.isfinite(shift).all()):
        raise FileFormatError(f"the pose of a scan has a quaternion of length {length:.6g}, expected 1")
    rotation = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    if not (np.array_equal(rotation, np.eye(3)) and not shift.any()):
        xyz = product(rotation, xyz[..., None])[..., 0] + shift
    return dict(zip("xyz", xyz.T, strict=True))


register_format(".e57", save=save, load=load, signature=b"ASTM-E57")
