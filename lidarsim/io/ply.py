"""PLY files (``.ply``): written binary little-endian; read in any encoding.

All fields are kept, vectors other than `xyz` and `normal` as one property per component; bool, int64 and uint64 cannot
be stored.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from io import BytesIO
from typing import Any, BinaryIO

from lidarsim._extras import import_extra
from lidarsim.errors import FileFormatError
from lidarsim.io._records import class_comments, commented_classes, record_of, to_columns, to_fields, to_records
from lidarsim.pointcloud import Fields, narrowed, register_format

NORMAL = ("nx", "ny", "nz")
CODES = {"f4", "f8", "i4", "u1", "u2"}
WIDENED = {"i1", "i2", "u4"}


def save(fields: Fields, file: BinaryIO, *, class_names: Mapping[int, str] | None = None) -> None:
    """Write the fields as the element ``vertex``.

    Types are named by their size, since Open3D reads ``uint16`` but skips ``ushort``. It also skips int8, int16 and
    uint32: these are widened, and a comment names the original type. Comments also hold the class names.
    """
    widened = {name: array for name, array in fields.items() if array.dtype.str[1:] in WIDENED}
    columns = to_columns(fields | {name: narrowed(name, array) for name, array in widened.items()}, NORMAL, CODES)
    record = record_of(columns)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment type {name} {array.dtype.name}" for name, array in widened.items()),
        *(f"comment {comment}" for comment in class_comments(class_names or {})),
        f"element vertex {len(fields['xyz'])}",
        *(f"property {record[name].name} {name}" for name in columns),
        "end_header\n",
    ]
    file.write("\n".join(header).encode("ascii"))
    file.writelines(records.data for records in to_records(columns, record))


def load(file: BinaryIO) -> dict[str, Any]:
    """Read the element ``vertex``, except lists; faces and other elements are skipped."""
    plyfile = import_extra("plyfile", "formats", "reading PLY files")
    text = _check_counts(file)
    # A binary file is mapped into memory, which is fast; a text file would be left open.
    ply = plyfile.PlyData.read(BytesIO(file.read()) if text else file)
    if "vertex" not in ply:
        elements = ", ".join(element.name for element in ply) or "(none)"
        raise FileFormatError(f"it has no element 'vertex' among its elements {elements}")
    vertices = ply["vertex"]
    scalars = [prop.name for prop in vertices.properties if not isinstance(prop, plyfile.PlyListProperty)]
    fields: dict[str, Any] = to_fields({name: vertices[name] for name in scalars}, NORMAL)
    for comment in ply.comments:
        match comment.split():
            case ["type", name, "int8" | "int16" | "uint32" as was] if name in fields:
                fields[name] = fields[name].astype(was)
    return fields | {"class_names": commented_classes(ply.comments)}


def _check_counts(file: BinaryIO) -> bool:
    """Return whether the file is text, after checking that it has the bytes for the elements that its header claims.

    A property of an element takes at least a byte, in text two with the space or line end after it.
    """
    if file.read(3) != b"ply":
        raise FileFormatError("it does not begin with 'ply'")
    elements: list[tuple[str, int, int]] = []
    text = False
    while (line := file.readline(1 << 16)).strip() != b"end_header":
        if not line:
            raise FileFormatError("its header has no end")
        words = line.decode("ascii", "replace").split()
        if words[:1] == ["element"] and len(words) == 3 and words[2].isdecimal():
            elements.append((words[1], int(words[2]), 0))
        elif words[:1] == ["property"] and elements:
            name, count, properties = elements[-1]
            elements[-1] = name, count, properties + 1
        text |= words[:2] == ["format", "ascii"]
    rest = os.fstat(file.fileno()).st_size - file.tell() + 1  # the last line of a text need not end
    for name, count, properties in elements:
        if count * max(properties, 1) * (1 + text) > rest:
            raise FileFormatError(f"it is truncated: its header claims {count} of the element {name!r}")
    file.seek(0)
    return text


register_format(".ply", save=save, load=load, signature=b"ply")
