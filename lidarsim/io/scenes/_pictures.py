"""Images of textures, decoded by Pillow."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._records import EXPANSION
from lidarsim.io.scenes._model import Picture
from lidarsim.materials import LUMINANCE, Texture, Wrap, linear_light

FORMATS = ("BMP", "JPEG", "PNG", "TGA", "WEBP")
FEW_PIXELS, MOST_PIXELS = 1 << 24, 1 << 26
"""Most pixels of an image, 4096 × 4096, or 8192 × 8192 if it has a byte for every `EXPANSION` of them; the latter is
also the limit of all textures of a document, unless their bytes are so many: a small file can claim any number."""


class Textures:
    """The textures of a document, of which each image is counted and decoded once."""

    def __init__(self) -> None:
        self._made: dict[tuple[Picture, bytes], Texture] = {}
        self._pixels: dict[Picture, npt.NDArray[np.uint8]] = {}
        self._count = self._size = 0

    def texture(self, picture: Picture, color: Floats) -> Texture:
        """Return a texture of the luminance of an image, each pixel of which is multiplied by a linear colour."""
        key = picture, color.tobytes()
        if key not in self._made:
            pixels = self._decode(picture)
            shares = linear_light(np.arange(256) / 255.0)[:, None] * (color * LUMINANCE)
            values = np.empty(pixels.shape[:2], np.float32)
            for row, line in zip(values, pixels, strict=True):  # by rows, since float64 takes eight times the memory
                row[:] = sum(shares[line[:, channel], channel] for channel in range(3))
            self._made[key] = Texture(values, wrap=picture.wrap, interpolation=picture.interpolation)
        return self._made[key]

    def sample(self, picture: Picture, uv: Floats) -> Floats:
        """Return the linear colours of a texture at places, shape (n, 3)."""
        if picture not in self._pixels:
            self._pixels[picture] = self._decode(picture)
        pixels = self._pixels[picture]
        height, width = pixels.shape[:2]
        columns, right = _neighbours(uv[:, 0], width, picture.wrap[0])
        rows, below = _neighbours(uv[:, 1], height, picture.wrap[1])
        if picture.interpolation == "nearest":
            right, below = (np.where(share < 0.5, 0.0, 1.0) for share in (right, below))
        colors = np.zeros((len(uv), 3))
        for i in (0, 1):
            for j in (0, 1):
                weight = (below if i else 1.0 - below) * (right if j else 1.0 - right)
                colors += weight[:, None] * linear_light(pixels[rows[i], columns[j]] / 255.0)
        return colors

    def _decode(self, picture: Picture) -> npt.NDArray[np.uint8]:
        content = picture.read()
        pixels = _decode(content)
        self._count += pixels.shape[0] * pixels.shape[1]
        self._size += len(content)
        most = max(MOST_PIXELS, EXPANSION * self._size)
        if self._count > most:
            raise FileFormatError(f"expected at most {most:,} pixels in all textures, got {self._count:,}")
        return pixels


def _decode(content: bytes) -> npt.NDArray[np.uint8]:
    """Return the pixels of an image, shape (height, width, 3), after checking its size."""
    module = import_extra("PIL.Image", "formats", "reading textures")
    most = min(MOST_PIXELS, max(FEW_PIXELS, EXPANSION * len(content)))
    try:
        image = module.open(BytesIO(content), formats=FORMATS)
        size = image.width, image.height
        pixels: npt.NDArray[np.uint8] | None = None
        if size[0] * size[1] <= most:
            if image.mode.startswith("I"):  # 16 bits of grey, of PNG alone, which Pillow would cut off at 255
                image = module.fromarray(np.rint(np.asarray(image) / np.float32(257.0)).astype(np.uint8))
            pixels = np.asarray(image.convert("RGB"))
    except Exception as error:
        raise FileFormatError(f"a texture cannot be decoded as {', '.join(FORMATS)}") from error
    if pixels is None:
        raise FileFormatError(f"expected a texture of at most {most:,} pixels, got {size[0]} × {size[1]}")
    return pixels


def _neighbours(
    place: Floats, size: int, wrap: Wrap
) -> tuple[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]], Floats]:
    """Return the pixels on both sides of places, in sizes of the image, and the distance from the first in pixels."""
    period = {"repeat": 1.0, "mirror": 2.0}.get(wrap)
    inside = np.clip(place, 0.0, 1.0) if period is None else place % period
    at = inside * size - 0.5
    first = np.floor(at)
    pixels = [first.astype(np.int64) + step for step in (0, 1)]
    if wrap == "repeat":
        low, high = (pixel % size for pixel in pixels)
    else:
        if wrap == "mirror":
            pixels = [np.minimum(pixel % (2 * size), -1 - pixel % (2 * size) + 2 * size) for pixel in pixels]
        low, high = (np.clip(pixel, 0, size - 1) for pixel in pixels)
    return (low, high), at - first
