"""What keeps rosbags, which reads MCAP files on their word, from allocating what a hostile one claims.

Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import os
import struct
import sys
from pathlib import Path
from typing import Any, NamedTuple

from lidarsim._extras import import_extra
from lidarsim.errors import FileFormatError
from lidarsim.io._records import check_expansion

MAGIC = b"\x89MCAP0\r\n"
CHUNK = 6  # code of its record
PIECE = 1 << 20


class CappedPath(type(Path())):  # type: ignore[misc]
    """A path whose file allocates no more for a read than it has bytes left."""

    def open(self, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        """Open the file."""
        return _Capped(io.FileIO(self)) if mode == "rb" else super().open(mode, *arguments, **options)


class _Capped(io.BufferedReader):
    def __init__(self, raw: io.FileIO) -> None:
        super().__init__(raw)
        self._size = os.fstat(raw.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(size if size is None or size < 0 else min(size, max(self._size - self.tell(), 0)))


class Chunk(NamedTuple):
    """What the head of a chunk says."""

    compression: str
    compressed: int
    raw: int


def check_chunks(path: Path) -> dict[int, Chunk]:
    """Return the chunks of a file by their place, after checking that none is a bomb; none, if it is no MCAP file."""
    chunks: dict[int, Chunk] = {}
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return chunks
        while len(head := file.read(9)) == 9:
            place, (length,) = file.tell(), struct.unpack("<Q", head[1:])
            if length > size - place:
                break  # the magic at the end, or a record that is truncated, which rosbags tells
            if head[0] == CHUNK and length >= 40:
                _, _, raw, _, letters = struct.unpack("<QQQII", file.read(32))
                compression = file.read(min(letters, length - 40)).decode("ascii", "replace")
                compressed = int.from_bytes(file.read(8), "little")
                if compressed > length:
                    raise FileFormatError(f"a chunk claims {compressed:,} bytes of {length:,}")
                check_expansion(raw, compressed)
                if compression == "zstd":
                    _check_zstd(file.read(compressed), raw)
                chunks[place - 9] = Chunk(compression, compressed, raw)
            file.seek(place + length)
    return chunks


def check_index(storage: Any, chunks: dict[int, Chunk]) -> None:
    """Raise an error if the index of rosbags' reader, which it goes by, has other chunks than the file."""
    for indexed in getattr(storage, "chunks", ()):
        claim = Chunk(indexed.compression, indexed.compressed_size, indexed.uncompressed_size)
        if chunks.get(indexed.chunk_start_offset) != claim:
            raise FileFormatError(f"its index has a chunk at byte {indexed.chunk_start_offset} that is not there")


def _check_zstd(data: bytes, claimed: int) -> None:
    """Raise an error if data become more than they claim."""
    module = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"  # as rosbags has it
    zstd = import_extra(module, "formats", "reading compressed ROS bags")
    size = 0
    while data:
        decompressor = zstd.ZstdDecompressor()
        while not decompressor.eof:
            piece = decompressor.decompress(data, max_length=PIECE)
            data = b""
            size += len(piece)
            if size > claimed:
                raise FileFormatError(f"a chunk claims {claimed:,} bytes and has more: refused as a decompression bomb")
            if not piece and decompressor.needs_input:
                return  # truncated, which rosbags tells
        data = decompressor.unused_data
