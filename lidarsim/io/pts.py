"""Points of terrestrial scanners (``.pts``, Leica Cyclone): their number in the first line, then a line per point.

A line has x, y, z in m, and intensity and red, green, blue if the cloud has these fields, at full precision; all others
are lost.

When a file is read, intensity is the number in the file, whose range differs by program: 0 to 1, 0 to 255, or -2048 to
2047. Several lists of points in a file, each with its number, become one cloud. Lines may differ in length: where a
line has none, intensity is NaN and a colour 0.

Format: https://paulbourke.net/dataformats/pts.
"""

from __future__ import annotations

from typing import BinaryIO

from lidarsim.io._records import to_fields
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
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format

LAYOUTS = {3: (*"xyz",), 4: (*"xyz", "intensity"), 6: (*"xyz", *COLOURS), 7: (*"xyz", "intensity", *COLOURS)}
"""Names by the number of columns."""


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the number of points and the points."""
    check_finite(fields)
    columns = dict(zip("xyz", fields["xyz"].T, strict=True))
    if "intensity" in fields:
        columns["intensity"] = fields["intensity"]
    file.write(f"{len(fields['xyz'])}\n".encode("ascii"))
    write_lines(columns | colours_of(fields), file)


def load(file: BinaryIO) -> Fields:
    """Read all lists of points."""
    with lines_of(file, "number of points") as lines:
        counts = (whole_number(head, "number of points") for head in lines)
        return to_fields(join_lists(part for count in counts for part in points_of(lines, count, LAYOUTS)), ())


register_format(".pts", save=save, load=load)
