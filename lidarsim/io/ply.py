"""PLY files: written binary little-endian; read in any encoding."""

from __future__ import annotations

from io import BytesIO
from typing import BinaryIO

from lidarsim._extras import import_extra
from lidarsim.errors import FileFormatError
from lidarsim.io._records import to_fields, to_records
from lidarsim.pointcloud import Fields, narrowed, register_format

NORMAL = ("nx", "ny", "nz")
CODES = {"f4", "f8", "i4", "u1", "u2"}
WIDENED = {"i1", "i2", "u4"}


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the fields as the element ``vertex``.

    Types are named by their size, since Open3D reads ``uint16`` but passes over ``ushort``. It passes over int8, int16
    and uint32, too: these are widened, and a comment names what they were.
    """
    widened = {name: array for name, array in fields.items() if array.dtype.str[1:] in WIDENED}
    records = to_records(fields | {name: narrowed(name, array) for name, array in widened.items()}, NORMAL, CODES)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment type {name} {array.dtype.name}" for name, array in widened.items()),
        f"element vertex {len(records)}",
        *(f"property {records.dtype[name].name} {name}" for name in records.dtype.names or ()),
        "end_header\n",
    ]
    file.write("\n".join(header).encode("ascii"))
    file.write(records.data)


def load(file: BinaryIO) -> Fields:
    """Read the element ``vertex``, lists left out; faces and other elements are passed over."""
    plyfile = import_extra("plyfile", "formats", "reading PLY files")
    head = file.read(1000)
    if not head.startswith(b"ply"):
        raise FileFormatError("it does not begin with 'ply'")
    file.seek(0)
    # A binary file is mapped into memory, which is fast; a text file would be left open.
    ply = plyfile.PlyData.read(BytesIO(file.read()) if b"format ascii" in head else file)
    if "vertex" not in ply:
        elements = ", ".join(element.name for element in ply) or "(none)"
        raise FileFormatError(f"it has no element 'vertex' among its elements {elements}")
    vertices = ply["vertex"]
    scalars = [prop.name for prop in vertices.properties if not isinstance(prop, plyfile.PlyListProperty)]
    fields = to_fields({name: vertices[name] for name in scalars}, NORMAL)
    for comment in ply.comments:
        match comment.split():
            case ["type", name, "int8" | "int16" | "uint32" as was] if name in fields:
                fields[name] = fields[name].astype(was)
    return fields


register_format(".ply", save=save, load=load)
