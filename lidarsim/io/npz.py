"""NumPy archives (``.npz``): one array per field, under the field's name, without loss."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, BinaryIO
from zipfile import ZipFile

import numpy as np

from lidarsim._base.files import read_array
from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError
from lidarsim.io._records import SMALL, check_columns, check_expansion
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format

LONGEST = (1 << 16) - 1 - len(".npy")
"""Greatest length of a name in a ZIP archive, characters."""


def save(fields: Fields, file: BinaryIO, *, class_names: Mapping[int, str] | None = None) -> None:
    """Write the fields uncompressed; unlike `numpy.savez`, with any names.

    Class names, if any, are stored as records of ``label`` and ``name`` in the array ``class_names``.
    """
    check_columns(len(fields))
    for name in fields:
        if len(name) > LONGEST:
            raise FileFormatError(f"{short(name)}: this format holds names of at most {LONGEST:,} characters")
    if class_names:
        for label, text in class_names.items():
            if text.endswith("\0"):
                raise FileFormatError(f"class_names[{label}]: this format cannot hold a name that ends with a null")
        longest = max(1, *map(len, class_names.values()))
        if longest * 4 * len(class_names) > SMALL:
            raise FileFormatError(
                f"class_names: this format cannot hold {len(class_names)} names as long as {longest:,}"
            )
        records = np.array(list(class_names.items()), np.dtype([("label", "<u4"), ("name", f"<U{longest}")]))
        fields = fields | {"class_names": records}
    with ZipFile(file, "w") as archive:
        for name, array in fields.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)


def load(file: BinaryIO) -> dict[str, Any]:
    """Read all arrays; nothing in the file is executed, and the sizes that it claims are checked."""
    if file.read(2) != b"PK":
        raise FileFormatError("it does not begin as a NumPy archive does")
    size = file.seek(0, os.SEEK_END)
    fields: dict[str, Any] = {}
    with ZipFile(file) as archive:
        check_columns(len(archive.infolist()))
        check_expansion(sum(entry.file_size for entry in archive.infolist()), size)
        for entry in archive.infolist():
            name = entry.filename.removesuffix(".npy")
            if name in fields:
                raise FileFormatError(f"it has two arrays named {short(repr(name))}")
            with archive.open(entry) as stream:
                try:
                    fields[name] = read_array(stream, entry.file_size)
                except FileFormatError as error:
                    raise FileFormatError(f"{name}: {error}") from None
    names = fields.get("class_names")
    if names is not None and names.dtype.names == ("label", "name"):
        fields["class_names"] = {int(label): str(name) for label, name in names.tolist()}
    return fields


register_format(".npz", save=save, load=load, signature=b"PK\x03\x04")
