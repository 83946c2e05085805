"""Files of plots that Matplotlib draws."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, atomic_writer, check_suffix

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg")
"""Kinds of files."""


def write(figure: Figure, path: PathLike, *, dpi: float) -> None:
    """Write a figure; the same figure always gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    path : path-like
        The file, PNG or SVG.
    dpi : float
        Pixels per inch, also of what an SVG has as pixels.

    Raises
    ------
    FileFormatError
        If the suffix is not one of `SUFFIXES`.
    OSError
        If the file cannot be written.
    """
    kind = check_suffix(path, SUFFIXES)[1:]
    metadata: dict[str, Any] = {"Date": None} if kind == "svg" else {}
    settings = import_extra("matplotlib", "pyvista", "this picture").rc_context({"svg.hashsalt": "lidarsim"})
    with settings, atomic_writer(path) as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)  # missing glyphs of a name become boxes
        figure.savefig(file, format=kind, dpi=dpi, metadata=metadata)
