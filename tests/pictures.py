"""Pictures of the pages: made smaller, and compared although their pixels differ a little.

``python tests/pictures.py DRAWN SHOWN [WIDTH]`` writes the picture DRAWN, in 256 colours, as SHOWN.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

BLOCKS = 40, 25
"""Number of blocks across a picture and down."""


def blocks(picture: Path) -> npt.NDArray[np.float64]:
    """Mean colours of blocks, 0 to 255 each: the rows, the columns, and red, green and blue."""
    with Image.open(picture) as image:
        return np.asarray(image.convert("RGB").resize(BLOCKS, Image.Resampling.BOX), np.float64)


def difference(one: Path, other: Path) -> float:
    """Greatest difference of the mean colour of any block, 0 to 255."""
    return float(np.abs(blocks(one) - blocks(other)).max())


def is_as_shown(drawn: Path, shown: Path) -> bool:
    """Whether a picture has the shape of another, within a hundredth, and is not blank."""
    with Image.open(drawn) as one, Image.open(shown) as other:
        shape = abs(one.width / one.height / (other.width / other.height) - 1.0) < 0.01
        return shape and len(one.convert("RGB").getcolors(2**24) or []) > 16


def reduce(drawn: Path, shown: Path, width: int | None = None) -> None:
    """Write a picture with fewer colours and, if a width is given, fewer pixels."""
    with Image.open(drawn) as image:
        picture = image.convert("RGB")
    if width is not None:
        picture = picture.resize((width, round(width * picture.height / picture.width)), Image.Resampling.LANCZOS)
    # Median cut, the default, gives a class with few points the colour of another one.
    reduced = picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    reduced.save(shown, optimize=True)


if __name__ == "__main__":
    reduce(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:]))
