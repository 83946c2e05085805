"""Images of textures, decoded by Pillow."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes._model import Picture
from lidarsim.materials import LUMINANCE, Texture, Wrap, linear_light

FORMATS = ("BMP", "JPEG", "PNG", "TGA", "WEBP")
MOST_PIXELS = 1 << 26
"""Most pixels of an image, 8192 × 8192: a small file can claim any number of them."""


def texture(picture: Picture, color: Floats) -> Texture:
    """Return a texture of the luminance of an image, each pixel of which is multiplied by a linear colour."""
    pixels = _decoded(picture.read())
    shares = linear_light(np.arange(256) / 255.0)[:, None] * (color * LUMINANCE)
    values = np.empty(pixels.shape[:2], np.float32)
    for row, line in zip(values, pixels, strict=True):  # by rows, since float64 takes eight times the memory
        row[:] = sum(shares[line[:, channel], channel] for channel in range(3))
    return Texture(values, wrap=picture.wrap, interpolation=picture.interpolation)


def sampled(picture: Picture, uv: Floats) -> Floats:
    """Return the linear colours of a texture at places, shape (n, 3)."""
    pixels = _decoded(picture.read())
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


def _decoded(content: bytes) -> npt.NDArray[np.uint8]:
    """Return the pixels of an image, shape (height, width, 3), after checking its size."""
    module = import_extra("PIL.Image", "formats", "reading textures")
    try:
        image = module.open(BytesIO(content), formats=FORMATS)
        size = image.width, image.height
        pixels: npt.NDArray[np.uint8] | None = None
        if size[0] * size[1] <= MOST_PIXELS:
            if image.mode.startswith("I"):  # 16 bits of grey, of PNG alone, which Pillow would cut off at 255
                image = module.fromarray(np.rint(np.asarray(image) / np.float32(257.0)).astype(np.uint8))
            pixels = np.asarray(image.convert("RGB"))
    except Exception as error:
        raise FileFormatError(f"a texture cannot be decoded as {', '.join(FORMATS)}") from error
    if pixels is None:
        raise FileFormatError(f"expected a texture of at most {MOST_PIXELS:,} pixels, got {size[0]} × {size[1]}")
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
