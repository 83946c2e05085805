"""Empty images, for readers that open one."""

from __future__ import annotations

import struct
import zlib
from functools import cache


@cache
def black_png(width: int, height: int) -> bytes:
    """Return a PNG of black pixels in red, green and blue, of 8 bits each."""
    rows = bytes(height * (1 + 3 * width))  # each begins with its filter, 0: none
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = (b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")
    parts = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
