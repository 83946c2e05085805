"""Maps of cells: values in colours, and relief as shaded by the sun."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import get_args

import numpy as np

from lidarsim._base import validation
from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, check_folder, check_suffix
from lidarsim._base.shown import plain
from lidarsim._base.validation import Floats, one_of
from lidarsim._base.views import ColorMap, register_view
from lidarsim.errors import ArgumentTypeError
from lidarsim.scan.cells import Cells
from lidarsim.viewers import _plots as plots
from lidarsim.viewers._colors import MAPS, check_limits
from lidarsim.viewers._picture import TO_SUN
from lidarsim.viewers._show import check_size

MOST = 4096
"""Greatest number of rows and columns in a picture; of more cells, every other one is left out, or more of them."""
DPI = 100
DARKEST, LIGHTEST = 0.8, 0.5
"""Greatest shares of black and of white in the colours of relief."""


def plot(
    cells: Cells,
    path: PathLike,
    *,
    hillshade: bool,
    title: str,
    limits: Sequence[float] | None,
    color_map: str,
    size: tuple[int, int],
) -> None:
    """Draw a map as documented in `Cells.plot`."""
    check_suffix(path, plots.SUFFIXES)
    check_folder(path)
    if not isinstance(title, str):
        raise ArgumentTypeError("title", "text", type(title).__name__)
    one_of("color_map", color_map, get_args(ColorMap))
    validation.flag("hillshade", hillshade)
    width, height = check_size(size)
    figures = import_extra("matplotlib.figure", "pyvista", "this picture")
    colors = import_extra("matplotlib.colors", "pyvista", "this picture")
    step = max(1, math.ceil(max(cells.values.shape) / MOST))
    values = cells.values[::step, ::step]
    finite = values[np.isfinite(values)]
    low, high = check_limits(limits) or ((finite.min(), finite.max()) if len(finite) else (0.0, 1.0))
    scale = colors.Normalize(low, high)
    table = colors.LinearSegmentedColormap.from_list(color_map, MAPS[color_map])
    rgba = table(scale(np.ma.masked_invalid(values)))
    if hillshade:
        rgba[..., :3] = relief(rgba[..., :3], values, cells.cell * step)
    rgba[~np.isfinite(values), 3] = 0.0
    figure = figures.Figure(figsize=(width / DPI, height / DPI), layout="constrained")
    axes = figure.add_subplot()
    west, south, east, north = cells.bounds
    axes.imshow(rgba, extent=(west, east, south, north))
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.locator_params(nbins=5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:,.10g}")
    axes.set_title(plain(title, most=80), parse_math=False)
    mapped = import_extra("matplotlib.cm", "pyvista", "this picture").ScalarMappable(scale, table)
    figure.colorbar(
        mapped, ax=axes, label=cells.quantity, extend="both" if limits is not None else "neither", shrink=0.8
    )
    plots.write(figure, path, dpi=DPI)


def relief(rgb: Floats, heights: Floats, cell: float) -> Floats:
    """Return colours, shape (rows, columns, 3), darker on slopes away from the sun and lighter on those towards it.

    A surface of the gradient (p, q) has the normal (−p, −q, 1), and `light` is its cosine with `TO_SUN`. Level ground
    keeps its colour, as do cells without a neighbour of known height.
    """
    slopes = [np.zeros_like(heights), np.zeros_like(heights)]
    for axis in (0, 1):
        if heights.shape[axis] > 1:
            slopes[axis] = np.nan_to_num(np.gradient(heights, cell, axis=axis))
    north, east = -slopes[0], slopes[1]  # the rows run southward
    towards = TO_SUN / np.linalg.norm(TO_SUN)
    light = (towards[2] - east * towards[0] - north * towards[1]) / np.sqrt(1.0 + east**2 + north**2)
    dark = (1.0 - light / towards[2]).clip(0.0, 1.0)[..., None]
    bright = ((light - towards[2]) / (1.0 - towards[2])).clip(0.0, 1.0)[..., None]
    shaded: Floats = rgb * (1.0 - DARKEST * dark) + (1.0 - rgb) * LIGHTEST * bright
    return shaded


register_view(Cells, "plot", plot)
