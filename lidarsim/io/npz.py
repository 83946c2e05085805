"""NumPy archives (``.npz``): one array a field under the field's name, as it is in memory."""

from __future__ import annotations

from typing import BinaryIO
from zipfile import ZipFile

import numpy as np

from lidarsim.errors import FileFormatError
from lidarsim.pointcloud import Fields, register_format


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the fields, uncompressed; unlike `numpy.savez`, whatever their names are."""
    with ZipFile(file, "w") as archive:
        for name, array in fields.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)


def load(file: BinaryIO) -> Fields:
    """Read all arrays; nothing in the file is executed."""
    if file.read(2) != b"PK":
        raise FileFormatError("it does not begin as a NumPy archive does")
    file.seek(0)
    with np.load(file, allow_pickle=False) as archive:
        return dict(archive)


register_format(".npz", save=save, load=load)
