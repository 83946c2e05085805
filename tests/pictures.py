"""Comparison of pictures whose pixels may differ a little."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

ACROSS = 40
"""Number of blocks across a picture."""


def blocks(picture: Path) -> npt.NDArray[np.float64]:
    """Mean colours of square blocks, 0 to 255 each: the rows, the columns, and red, green and blue."""
    with Image.open(picture) as image:
        rows = round(ACROSS * image.height / image.width)
        return np.asarray(image.convert("RGB").resize((ACROSS, rows), Image.Resampling.BOX), np.float64)


def difference(one: Path, other: Path) -> float:
    """Greatest difference of the mean colour of any block, 0 to 255."""
    return float(np.abs(blocks(one) - blocks(other)).max())
