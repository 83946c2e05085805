"""NumPy archives (``.npz``): one array per field under the field's name, as it is in memory. Nothing is lost."""

from __future__ import annotations

import os
from typing import IO, BinaryIO
from zipfile import ZipFile

import numpy as np

from lidarsim.errors import FileFormatError
from lidarsim.io._records import check_expansion
from lidarsim.pointcloud import Fields, register_format


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the fields, uncompressed; unlike `numpy.savez`, whatever their names are."""
    with ZipFile(file, "w") as archive:
        for name, array in fields.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)


def load(file: BinaryIO) -> Fields:
    """Read all arrays; nothing in the file is executed, and no claim of a size is believed unchecked."""
    if file.read(2) != b"PK":
        raise FileFormatError("it does not begin as a NumPy archive does")
    size = file.seek(0, os.SEEK_END)
    fields: Fields = {}
    with ZipFile(file) as archive:
        check_expansion(sum(entry.file_size for entry in archive.infolist()), size)
        for entry in archive.infolist():
            name = entry.filename.removesuffix(".npy")
            with archive.open(entry) as stream:
                _check_size(name, stream, entry.file_size)
            with archive.open(entry) as stream:
                fields[name] = np.lib.format.read_array(stream, allow_pickle=False)
    return fields


def _check_size(name: str, stream: IO[bytes], size: int) -> None:
    """Raise an error if the header of an array claims more bytes than its entry of the archive has."""
    version = np.lib.format.read_magic(stream)
    if version not in {(1, 0), (2, 0)}:
        raise FileFormatError(f"{name}: its array is of the unknown version {version}")
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(stream)
    claimed = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if not dtype.hasobject and claimed > size:
        raise FileFormatError(f"{name}: its array claims {claimed:,} bytes of {size:,}")


register_format(".npz", save=save, load=load, signature=b"PK\x03\x04")
