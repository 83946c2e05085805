"""NumPy archives (``.npz``): one array a field under the field's name, as it is in memory. Nothing is lost."""

from __future__ import annotations

import os
from typing import BinaryIO
from zipfile import ZipFile

import numpy as np

from lidarsim._files import read_array
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
                try:
                    fields[name] = read_array(stream, entry.file_size)
                except FileFormatError as error:
                    raise FileFormatError(f"{name}: {error}") from None
    return fields


register_format(".npz", save=save, load=load, signature=b"PK\x03\x04")
