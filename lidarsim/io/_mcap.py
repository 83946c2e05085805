"""Read the messages of an MCAP file in file order, without its index, in the memory of one chunk.

rosbags writes such files, but when it reads them, it trusts their sizes: it allocates what they claim and decompresses
without a limit. `storage` reduces the copies of a large message that rosbags holds while writing from four to three.

Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

from lidarsim._base.extras import import_extra
from lidarsim._base.validation import short
from lidarsim.errors import FileFormatError
from lidarsim.io._records import check_expansion, zstd

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 3, 4, 5, 6, 15


@cache
def storage() -> Any:
    """Return the storage class with which rosbags writes MCAP files."""
    base: Any = import_extra("rosbags.rosbag2.storage_mcap", "formats", "writing ROS bags").McapWriter

    class Storage(base):  # type: ignore[misc]
        """Writer of rosbags that writes a full chunk only after it has freed its own copy of the last message."""

        _writing = _full = False

        def write(self, *message: Any) -> None:
            self._writing, self._full = True, False
            super().write(*message)
            self._writing = False
            if self._full:
                self.close_chunk()

        def close_chunk(self) -> None:
            if self._writing:
                self._full = True
            else:
                super().close_chunk()

    return Storage


def messages(path: Path) -> Iterator[tuple[str, str, int, memoryview]]:
    """Yield topic, type, recording time (ns) and data of each message."""
    types: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise FileFormatError("it does not begin as an MCAP file does")
        for code, body in _records(file):
            if code == SCHEMA:
                types[_number(body, 2)] = _text(body, 2)
            elif code == CHANNEL:
                channels[_number(body, 2)] = _text(body, 4), types.get(_number(body[2:], 2), "(no type)")
            elif code == MESSAGE:
                topic, kind = channels[_number(body, 2)]
                yield topic, kind, _number(body[6:], 8), body[22:]


def _records(file: BinaryIO) -> Iterator[tuple[int, memoryview]]:
    """Yield the records of the data section, including those in chunks."""
    place = file.tell()
    size = file.seek(0, 2)
    file.seek(place)
    while True:
        head = file.read(9)
        length = _number(memoryview(head)[1:], 8)
        if length > size - file.tell():
            raise FileFormatError("it is truncated inside a record")
        if head[0] == DATA_END:
            return
        if head[0] not in {SCHEMA, CHANNEL, MESSAGE, CHUNK}:
            file.seek(length, 1)
        elif head[0] == CHUNK:
            yield from _inside(_chunk(memoryview(file.read(length))))
        else:
            yield head[0], memoryview(file.read(length))


def _inside(chunk: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the records of a chunk."""
    while chunk:
        length = _number(chunk[1:], 8)
        if length > len(chunk) - 9:
            raise FileFormatError("it is truncated inside a chunk")
        yield chunk[0], chunk[9 : 9 + length]
        chunk = chunk[9 + length :]


def _chunk(body: memoryview) -> memoryview:
    """Return the records of a chunk, decompressed to at most the size that it claims."""
    _, _, size, checksum, letters = struct.unpack_from("<QQQII", body)
    compression, data = _text(body, 28), body[40 + letters :]
    if len(data) != _number(body[32 + letters :], 8):
        raise FileFormatError("it is truncated inside a chunk")
    check_expansion(size, len(data))
    if compression:
        if compression == "zstd":
            decompressor = zstd().ZstdDecompressor()
        elif compression == "lz4":
            decompressor = import_extra("lz4.frame", "formats", "reading compressed ROS bags").LZ4FrameDecompressor()
        else:
            raise FileFormatError(f"its chunks are compressed by {short(ascii(compression))}, expected zstd or lz4")
        data = memoryview(decompressor.decompress(data, max_length=size + 1))
    if len(data) != size or (checksum and zlib.crc32(data) != checksum):
        raise FileFormatError(f"a chunk is damaged: it claims {size:,} bytes and has others, or of another number")
    return data


def _number(body: memoryview, size: int) -> int:
    if len(body) < size:
        raise FileFormatError("it is truncated")
    return int.from_bytes(body[:size], "little")


def _text(body: memoryview, place: int) -> str:
    length = _number(body[place:], 4)
    return bytes(body[place + 4 : place + 4 + length]).decode()
