"""A cloud as one record a point, the layout that PCD and PLY share.

Records hold scalars alone, so a vector field is split into columns: by convention `xyz` into ``x y z`` and `normal`
into the format's own names; any other field ``f`` of shape (n, m) into ``f.0`` to ``f.<m-1>``, names that no field has.
"""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.pointcloud import Fields


def to_records(fields: Fields, normal: Collection[str], codes: Collection[str]) -> npt.NDArray[np.void]:
    """Return the packed little-endian records of `fields`; `codes` are the dtypes that the format can hold."""
    columns: Fields = {}
    for name, array in fields.items():
        if array.dtype.str[1:] not in codes:
            raise FileFormatError(f"{name}: this format cannot hold {array.dtype}; convert it, or save as .npz")
        if array.ndim == 1:
            columns[name] = array
        else:
            parts = {"xyz": "xyz", "normal": normal}.get(name) or [f"{name}.{i}" for i in range(array.shape[1])]
            columns |= zip(parts, array.T, strict=True)
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    records = np.empty(len(fields["xyz"]), dtype)
    for name, column in columns.items():
        records[name] = column
    return records


def to_fields(columns: Fields, normal: Collection[str]) -> Fields:
    """Return the fields that the columns of a file make up, where a column may have several entries a point."""
    for name in "xyz":
        if name not in columns:
            raise FileFormatError(f"it has no {name} among its fields {', '.join(columns) or '(none)'}")
    vectors = {"xyz": list("xyz")}
    if columns.keys() >= set(normal):
        vectors["normal"] = list(normal)
    for name in columns:
        base, _, index = name.rpartition(".")
        if base and index == str(len(vectors.get(base, ()))):
            vectors.setdefault(base, []).append(name)
    fields = {_identifier(name): np.stack([columns.pop(part) for part in parts], 1) for name, parts in vectors.items()}
    return fields | {_identifier(name): column for name, column in columns.items()}


def _identifier(name: str) -> str:
    return re.sub(r"\W|^(?=\d)", "_", name, flags=re.ASCII)
