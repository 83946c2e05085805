"""Files of plots that Matplotlib draws."""

from __future__ import annotations

import re
from io import BytesIO
from typing import TYPE_CHECKING, Any

from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, atomic_writer, check_suffix

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg")
"""Kinds of files."""
MISSING = "□"


def write(figure: Figure, path: PathLike, *, dpi: float) -> None:
    """Write a figure as PNG or SVG; the same figure always gives the same bytes.

    `dpi` is the number of pixels per inch, also of what an SVG has as pixels.

    Raises
    ------
    FileFormatError
        If the suffix is not one of `SUFFIXES`.
    OSError
        If the file cannot be written.
    """
    kind = check_suffix(path, SUFFIXES)[1:]
    metadata: dict[str, Any] = {"Date": None} if kind == "svg" else {}
    _replace_missing_glyphs(figure)
    drawn = BytesIO()
    figure.savefig(drawn, format=kind, dpi=dpi, metadata=metadata)
    with atomic_writer(path) as file:
        file.write(_number_identifiers(drawn.getvalue()) if kind == "svg" else drawn.getvalue())


def _replace_missing_glyphs(figure: Figure) -> None:
    """Draw a box for each character that the font of a text lacks, of which Matplotlib would warn."""
    fonts = import_extra("matplotlib.font_manager", "pyvista", "this picture")
    texts = import_extra("matplotlib.text", "pyvista", "this picture")
    for text in figure.findobj(texts.Text):
        known = fonts.get_font(fonts.findfont(text.get_fontproperties())).get_charmap()
        text.set_text("".join(c if ord(c) in known or c == "\n" else MISSING for c in text.get_text()))


def _number_identifiers(svg: bytes) -> bytes:
    """Return an SVG whose identifiers, in which Matplotlib has random numbers, are numbered in their order."""
    names: dict[bytes, bytes] = {}
    return _RANDOM.sub(lambda found: names.setdefault(found[0], b"i%d" % len(names)), svg)


_RANDOM = re.compile(rb"(?<=[\"#])[a-z]+[0-9a-f]{10}(?=[\")])")
