"""Buffers, buffer views and accessors of glTF, as NumPy arrays.

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3.6 and 4.4.
"""

from __future__ import annotations

import base64
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote_to_bytes

import numpy as np
import numpy.typing as npt

from lidarsim._base.files import beside
from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._records import Expansion
from lidarsim.io.scenes import _gltf_document as gltf

T = TypeVar("T")

DTYPES: dict[int, np.dtype[Any]] = {
    5120: np.dtype("i1"),
    5121: np.dtype("u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MOST_ZEROS = 1 << 22
"""Most elements of an accessor without a buffer view, whose zeros take no byte of the file."""
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


class Data:
    """The data of a document: in files beside or below its own, `path`, or in the binary chunk of a GLB."""

    def __init__(self, path: Path, document: gltf.Document, binary: bytes | memoryview | None) -> None:
        self._path = path
        self._document = document
        self._binary = binary
        self._buffers: dict[int, memoryview] = {}
        self._accessors: dict[int, npt.NDArray[Any]] = {}
        self._numbers: dict[int, Floats] = {}
        self.expansion = Expansion(path.stat().st_size)

    def buffer(self, index: int, where: str) -> memoryview:
        """Return the bytes of a buffer; `where` is the place of the index."""
        if index not in self._buffers:
            buffer = at(self._document.buffers, index, where)
            name = f"buffers[{index}]"
            if buffer.uri is not None:
                content: bytes | memoryview = self.file(buffer.uri, name)
            elif index == 0 and self._binary is not None:
                content = self._binary
            else:
                compressed = next((extension for extension in MESHOPT if extension in buffer.extensions), None)
                raise FileFormatError(f"{name}: {f'{compressed} is not supported' if compressed else 'it has no data'}")
            if len(content) < buffer.byte_length:
                raise FileFormatError(f"{name}: truncated, {len(content):,} of {buffer.byte_length:,} bytes")
            self._buffers[index] = memoryview(content)[: buffer.byte_length]
        return self._buffers[index]

    def file(self, uri: str, where: str) -> bytes:
        """Return the bytes that a URI holds or names."""
        if not uri.startswith("data:"):
            try:
                content = beside(self._path, uri).read_bytes()
            except (FileFormatError, OSError) as error:
                raise FileFormatError(f"{where}.uri: {getattr(error, 'strerror', None) or error}") from None
            self.expansion.size += len(content)
            return content
        head, comma, text = uri.partition(",")
        if not comma:
            raise FileFormatError(f"{where}.uri: expected data after a comma")
        if not head.endswith(";base64"):
            return unquote_to_bytes(text)
        try:
            return base64.b64decode(text, validate=True)
        except ValueError:
            raise FileFormatError(f"{where}.uri: expected data in base64") from None

    def view(self, index: int, where: str) -> memoryview:
        """Return the bytes of a buffer view."""
        view = at(self._document.buffer_views, index, where)
        name = f"bufferViews[{index}]"
        try:
            buffer = self.buffer(view.buffer, f"{name}.buffer")
        except FileFormatError:
            for extension in MESHOPT:
                if extension in view.extensions:
                    raise FileFormatError(f"{name}: {extension} is not supported") from None
            raise
        end = view.byte_offset + view.byte_length
        if end > len(buffer):
            raise FileFormatError(
                f"{name}: expected bytes up to {end:,}, got {len(buffer):,} in buffers[{view.buffer}]"
            )
        return buffer[view.byte_offset : end]

    def accessor(self, index: int, where: str, kinds: Collection[str], dtypes: str) -> npt.NDArray[Any]:
        """Return the numbers of an accessor as they are stored, read-only, shape (count, width).

        `where` is the place of its index, for errors. Expected are its types, such as "VEC3", in `kinds`, and the kinds
        of its numbers in `dtypes`, as NumPy's: "f" floating-point, "i" signed, "u" unsigned integers.
        """
        accessor = at(self._document.accessors, index, where)
        name = f"accessors[{index}]"
        if accessor.type not in kinds:
            raise FileFormatError(f"{name}.type: expected {' or '.join(kinds)} for {where}, got {accessor.type}")
        dtype = DTYPES[accessor.component_type]
        if dtype.kind not in dtypes:
            raise FileFormatError(f"{name}.componentType: {accessor.component_type} is none of {where}")
        if index not in self._accessors:
            values = self._load(accessor, name, dtype)
            if accessor.sparse is not None:
                values = self._replace(values, accessor.sparse, f"{name}.sparse")
            values.setflags(write=False)
            self.expansion.take(values.nbytes)
            self._accessors[index] = values
        return self._accessors[index]

    def numbers(self, index: int, where: str, kinds: Collection[str], dtypes: str = "fiu") -> Floats:
        """Return the numbers of an accessor, normalised if it says so; parameters as of `accessor`."""
        stored = self.accessor(index, where, kinds, dtypes)
        if index not in self._numbers:
            values = real(stored, normalized=self._document.accessors[index].normalized)
            values.setflags(write=False)
            self.expansion.take(values.nbytes)
            self._numbers[index] = values
        return self._numbers[index]

    def _load(self, accessor: gltf.Accessor, name: str, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
        width = WIDTHS[accessor.type]
        if accessor.buffer_view is None:
            if accessor.count > MOST_ZEROS:
                raise FileFormatError(f"{name}.count: expected at most {MOST_ZEROS:,} without a buffer view")
            return np.zeros((accessor.count, width), dtype)
        where = f"{name}.bufferView"
        view = self.view(accessor.buffer_view, where)
        stride = self._document.buffer_views[accessor.buffer_view].byte_stride
        return _table(view, accessor.byte_offset, (accessor.count, width), dtype, name, stride=stride)

    def _replace(self, values: npt.NDArray[Any], sparse: gltf.Sparse, name: str) -> npt.NDArray[Any]:
        """Return the values with some replaced."""
        if sparse.count > len(values):
            raise FileFormatError(f"{name}.count: expected at most {len(values):,}, got {sparse.count:,}")
        indices, stored = sparse.indices, sparse.values
        view = self.view(indices.buffer_view, f"{name}.indices.bufferView")
        dtype = DTYPES[indices.component_type]
        places = _table(view, indices.byte_offset, (sparse.count, 1), dtype, f"{name}.indices")[:, 0].astype(np.int64)
        wrong = np.flatnonzero((places >= len(values)) | (np.diff(places, prepend=-1) <= 0))
        if len(wrong):
            got = places[wrong[0]]
            expected = f"ascending indices below {len(values)}"
            raise FileFormatError(f"{name}.indices: expected {expected}, got {got} at place {wrong[0]}")
        view = self.view(stored.buffer_view, f"{name}.values.bufferView")
        changed = values.copy()
        shape = sparse.count, values.shape[1]
        changed[places] = _table(view, stored.byte_offset, shape, values.dtype, f"{name}.values")
        return changed


def at(items: Sequence[T], index: int, where: str) -> T:
    """Return an item of a list of the document."""
    if index >= len(items):
        raise FileFormatError(f"{where}: expected an index below {len(items)}, got {index}")
    return items[index]


def check_finite(values: npt.NDArray[Any], where: str) -> None:
    """Raise an error at the first number of rows that is not finite."""
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        i, j = wrong[0]
        raise FileFormatError(f"{where}[{i}]: expected finite numbers, got {values[i, j]}")


def real(stored: npt.NDArray[Any], *, normalized: bool) -> Floats:
    """Return stored numbers as float64; normalised integers as documented in section 3.11."""
    values = stored.astype(np.float64)
    if normalized and stored.dtype.kind in "iu":
        values /= np.iinfo(stored.dtype).max
        np.maximum(values, -1.0, out=values)
    return values


def _table(
    view: memoryview, offset: int, shape: tuple[int, int], dtype: np.dtype[Any], name: str, *, stride: int | None = None
) -> npt.NDArray[Any]:
    """Return a copy of rows of numbers in a buffer view, after checking that they lie in it."""
    size = shape[1] * dtype.itemsize
    step = size if stride is None else stride
    if step < size:
        raise FileFormatError(f"{name}: expected a byteStride of at least {size}, got {step}")
    end = offset + (shape[0] - 1) * step + size
    if end > len(view):
        raise FileFormatError(f"{name}: expected bytes up to {end:,}, got {len(view):,} in its bufferView")
    rows: npt.NDArray[Any] = np.ndarray(shape, dtype, view, offset, (step, dtype.itemsize))
    return rows.copy()
