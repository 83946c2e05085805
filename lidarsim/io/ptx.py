"""Scans of terrestrial scanners (``.ptx``, Leica Cyclone): a header with the pose, then the grid of points as text.

A line has x, y, z in m, at full precision, in the frame of the scanner, intensity from 0 to 1, and red, green, blue if
the cloud has these fields. The grid is that of `column` and `ring`, if the cloud has them, each pair occurs once and at
least one place in 16 has a point; else it is a single row. Places without a point are ``0 0 0 0.5``, so that a point at
the origin is refused, and so is an intensity that is negative or NaN. All other fields are lost, and `PointCloud.save`
warns of intensity beyond 1, which is written as 1. The pose of `PointCloud.save` becomes the matrix of the header.

When a file is read, the points are transformed by that matrix, into the world. Places without a point are left out;
`column` and `ring` are those of the grid, unless it is a single row or column, and `scan` counts the scans of a file of
several. Points of lines without colours are black among others with colours.

Format: https://paulbourke.net/dataformats/ptx.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim._base.vectors import product
from lidarsim.errors import FileFormatError
from lidarsim.io._records import check_plausible, to_fields
from lidarsim.io._records import number as number_of
from lidarsim.io._scanners import (
    COLOURS,
    check_finite,
    colours_of,
    join_lists,
    lines_of,
    points_of,
    whole_number,
    write_lines,
)
from lidarsim.io._units import warn_above
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format

LAYOUTS = {4: (*"xyz", "intensity"), 7: (*"xyz", "intensity", *COLOURS)}
"""Names by the number of columns."""

MISSING = 0.5
"""Intensity of a place without a point."""

SPARSEST = 16
"""Most places per point of a grid that is written."""


def save(fields: Fields, file: BinaryIO, *, pose: Floats | None = None) -> None:
    """Write the header and the grid, column by column."""
    check_finite(fields)
    xyz, n = fields["xyz"], len(fields["xyz"])
    if (at_origin := ~xyz.any(axis=1)).any():
        i = int(np.argmax(at_origin))
        raise FileFormatError(f"xyz: expected no point at the origin, where PTX has none, got xyz[{i}] = [0, 0, 0]")
    intensity = fields.get("intensity", np.full(n, MISSING, np.float32))
    check_plausible({"intensity": intensity}, np.inf, 0)
    warn_above(1.0, intensity, "the intensity of PTX")
    points = {"xyz": xyz, "intensity": np.minimum(intensity, np.float32(1.0)), **colours_of(fields)}
    columns, rows, places = _grid(fields)
    whole = {name: np.zeros((columns * rows, *part.shape[1:]), part.dtype) for name, part in points.items()}
    whole["intensity"][:] = MISSING
    for name, part in points.items():
        whole[name][places] = part
    matrix = np.eye(4) if pose is None else pose
    head = [[columns], [rows], matrix[:3, 3].tolist(), *matrix[:3, :3].T.tolist(), *matrix.T.tolist()]
    file.writelines(f"{' '.join(map(repr, line))}\n".encode("ascii") for line in head)
    write_lines({**dict(zip("xyz", whole.pop("xyz").T, strict=True)), **whole}, file)


def _grid(fields: Fields) -> tuple[int, int, np.ndarray]:
    """Return the numbers of columns and rows, and the place of each point."""
    n = len(fields["xyz"])
    if n and "column" in fields and "ring" in fields:
        column, ring = fields["column"].astype(np.int64), fields["ring"].astype(np.int64)
        columns, rows = int(column.max()) + 1, int(ring.max()) + 1
        if columns * rows <= SPARSEST * n:
            places = column * rows + ring
            if len(np.unique(places)) == n:
                return columns, rows, places
    return n, 1 if n else 0, np.arange(n)


def load(file: BinaryIO) -> Fields:
    """Read all scans."""
    with lines_of(file, "number of columns") as lines:
        scans = (_scan(head, lines, scan) for scan, head in enumerate(lines))
        columns = join_lists(part for scan in scans for part in scan)
    unneeded = [] if "scan" in columns and columns["scan"].any() else ["scan"]
    if "column" in columns and not (columns["column"].any() and columns["ring"].any()):
        unneeded += ["column", "ring"]
    for name in unneeded:
        columns.pop(name, None)
    return to_fields(columns, ())


def _scan(head: str, lines: Iterator[str], scan: int) -> Iterator[Fields]:
    """Yield the points of a scan, block by block."""
    columns, rows = whole_number(head, "number of columns"), whole_number(next(lines, ""), "number of rows")
    for name in ("position", "x axis", "y axis", "z axis"):
        _numbers(next(lines, ""), 3, name)
    matrix = np.array([_numbers(next(lines, ""), 4, f"row {i + 1} of the matrix") for i in range(4)]).T
    if matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise FileFormatError(f"its matrix has the last column {matrix[3].tolist()}, expected 0 0 0 1")
    is_moved = not np.array_equal(matrix, np.eye(4))
    place = 0
    for block in points_of(lines, columns * rows, LAYOUTS):
        xyz = np.stack([block[name] for name in "xyz"], axis=1)
        kept = xyz.any(axis=1)
        places = place + np.flatnonzero(kept)
        place += len(xyz)
        xyz = xyz[kept]
        if is_moved:
            xyz = product(matrix[:3, :3], xyz[..., None])[..., 0] + matrix[:3, 3]
        rest = {name: part[kept] for name, part in block.items() if name not in "xyz"}
        grid = {
            "column": (places // rows).astype(np.min_scalar_type(columns)),
            "ring": (places % rows).astype(np.min_scalar_type(rows)),
            "scan": np.full(len(xyz), scan, np.min_scalar_type(scan)),
        }
        yield {**dict(zip("xyz", xyz.T, strict=True)), **rest, **grid}


def _numbers(line: str, count: int, what: str) -> list[float]:
    words = line.split()
    values = [float(number_of(word, what)) for word in words[: count + 1]]
    if len(values) != count or not np.isfinite(values).all():
        raise FileFormatError(f"{what}: expected {count} finite numbers, got {len(words)}")
    return values


register_format(".ptx", save=save, load=load)
