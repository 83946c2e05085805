"""Colours of points by a field, the same in all viewers and bright enough for a dark background."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.shown import plain
from lidarsim._base.validation import Floats, array, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.materials import LUMINANCE, linear_light
from lidarsim.scan.fields import with_unit
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Source
from lidarsim.viewers import _classes as classes
from lidarsim.viewers._classes import class_color

PATH = "#ffd24a"
AXES = ("#ff4b4b", "#4bd964", "#4b8bff")
"""Colours of the sensor's axes x, y, z."""

# Magma, a perceptually uniform colour map (N. Smith and S. van der Walt, https://bids.github.io/colormap, CC0), at ten
# equal steps from 0.3, where it stands out from the background, to 1.
SEQUENTIAL = (
    "#641a80", "#832681", "#a3307e", "#c43c75", "#e24d66", "#f56b5c", "#fc9065", "#feb67c", "#fdda9c", "#fcfdbf",
)  # fmt: skip
MAPS = {
    "magma": SEQUENTIAL,
    # S. van der Walt and N. Smith, as above.
    "viridis": (
        "#440154", "#482878", "#3e4a89", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725",
    ),
    # J. Nuñez, C. Anderton and R. Renslow, 2018: the same to people with and without colour vision deficiency.
    "cividis": (
        "#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838",
    ),
    "grey": ("#404040", "#ffffff"),
}  # fmt: skip
"""Colour maps by name."""
DIVERGING = ("#1e8fff", "#79b8ff", "#c9ced4", "#ff9473", "#ff4a26")
"""From blue through grey to red, for signed values."""
CONTRAST = 3.0
"""Least contrast of a class with the background, as WCAG 2.1 wants of graphics."""
MISSING = "#6b727a"
"""Colour of a point whose value is not finite."""


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of what is not data.

    Attributes
    ----------
    background, grid, text, surface : str
        Colours of the background, of the grid on the ground, of texts, and of surfaces without a class.
    """

    background: str
    grid: str
    text: str
    surface: str


DARK = Theme(background="#14181d", grid="#3d4754", text="#e8eaed", surface="#aab4c0")
WHITE = Theme(background="#ffffff", grid="#d5dae0", text="#1b1f24", surface="#8b95a1")
THEMES = {"dark": DARK, "white": WHITE}
BACKGROUND = DARK.background

NAME = 40
"""Greatest length of a category's name, characters."""
# Colours of categories 0 to 259; from 260 on they repeat. The first eight are distinct with any kind of colour vision
# (M. Okabe and K. Ito, Color universal design, 2008, without black). Each later one is the farthest in OKLab
# (B. Ottosson, 2020) from all chosen before, among the 4096 colours of three hexadecimal digits that have a contrast of
# at least 3:1 with the background. Categories 8 to 33 and the classes of SemanticKITTI are chosen first, then the rest.
# The search takes longer than drawing a picture, so its result is stored here; the tests repeat it.
# fmt: off
_CATEGORIES = (
    "e69f0056b4e9009e73f0e4420072b2d55e00cc79a7bbbbbb9900ff00dd00ff22ffffffff00ffddbb0099776600ff99ffff00667777ff"
    "88557744cc990055ff88aa00998866bb55dd99ff00cc0022ffcceeff88770077007788bb77ddffaa99ff337766ffbb88aa00cc99ffff"
    "dd33996666ccaa99bb9966aaff55bbcc00ffbb880088ddbb8844bbcc0066ee6677667788cceebb99dd6600990077aa99dd77ff1177ee"
    "00ee99ffbb009955ff886655eeaabbff7700bb5566ccddeeccbb00ffff00aa6600997788aa77ffaa4488ffddbb55cc550099ffaabb77"
    "77881100ccddcccc99cc77663388447799eedd99dd00ff66ccbbffdd00cc99bbee66886666aa662288ccff00bbdd3355dd55ccaa77cc"
    "ff77dd556699eedd8800bbaabb55aabbee5500bb6688bbbbdd33006644ee999944dd44ffdd77cc5566ffdd8833ff9955775599aaaa99"
    "ff66ff99ffcc9966dd887733dd558855eeee7799aabb33bb11ddccee664499cc00ff44dd11aaccdd8888228888ddcc55ddff77eeffcc"
    "8833ddaa66553366ccbbdd8866666655770088cc7788aacc88eeaa99ccdd77ee00bbaa3333aa33bbaadd117744778888aa33eeff3399"
    "aa8888bb3355ccff22ddaa6655ccff559988559944ff6699ffaaddddaa995577bb00778899bb44cc99aabb7733eecccccc554499aa77"
    "8877cc5588ee5599ccbb88ddbbddcc9988ee88aaff9988aaccffaa77bb77ccffeecc66770088aaddbbdd7755dd66dd44aaccffffbbff"
    "44ffaa55774466dd99ffaa99ddccff995555008811bb9955dd88bbbb6699ddeeff99eedd999988cc99ff667766dd55aa7755ffcc66ee"
    "66664477996677668866ccbb5555cc9955bb33aaffbb55ffcc1188998800cc4477aadd0011aaaaff4455ffeedd99cc9966bb1177ee66"
    "bb551133ddee8877aa00dd77ee88ffffeeaaaaccbb9999ddbb8866bb443344aa8855bbccee66dd4455eeccee88eebb6622cc2288bb99"
    "bbaa77ccbb66ee9999ddbbbb33bb88aa77aa88ddddff77889977665577ddffaa33dd00aaccdd55cc33ddbbcc55ffbbcc33eebb779900"
    "00bb00ff88bbaa4400ff331199ff992299aaffff99cc9977"
)
# fmt: on
QUALITATIVE = tuple(f"#{_CATEGORIES[i : i + 6]}" for i in range(0, len(_CATEGORIES), 6))
_EIGHT = ["#885511", "#224488", "#009966", "#778811", "#4466aa", "#881111", "#aa3366", "#aa8899"]
LIGHT = classes.ON_LIGHT | dict(zip(QUALITATIVE, _EIGHT, strict=False))
"""Colours on a light background instead of those on a dark one, distinct with any kind of colour vision."""

FEW = 12
"""Greatest number of values of an integer field that are listed instead of shown as a scale."""
CATEGORIES = {"label", "object_id", "instance", "sensor", "return_number", "return_count", "source"}
SOURCES: Mapping[int, str] = {Source.surface: "surface", Source.atmosphere: "air", Source.false_return: "false return"}
UNLABELLED = "#909090"
"""Colour of an unnamed label 0 beside named labels; echoes of the air have this label by default."""


@dataclass(frozen=True, slots=True, eq=False)
class Coloring:
    """Colours of the values of a field: one per category, or a colour map over an interval.

    Attributes
    ----------
    field : str
        The field.
    limits : tuple of float
        Values at the ends of the table.
    extent : tuple of float
        Least and greatest value; beyond the limits if there are a few outliers.
    table : list of str
        Colours from one limit to the other, or of the categories.
    names : dict of int to str
        Names of the categories, in the order of the table; empty if the field has none.
    scaled : bool
        Whether there are finite values, for which a legend shows a colour bar.
    missing : bool
        Whether there are values that are not finite, which are drawn in `MISSING`.
    """

    field: str
    limits: tuple[float, float]
    extent: tuple[float, float]
    table: list[str]
    names: dict[int, str]
    scaled: bool = False
    missing: bool = False

    @property
    def title(self) -> str:
        """Name of the field with its unit."""
        return with_unit(self.field)

    @property
    def clipped(self) -> str:
        """Note on values beyond the limits; empty if there are none."""
        return "" if self.extent == self.limits else "all: {} to {}".format(*map(_readable, self.extent))

    @property
    def notes(self) -> list[str]:
        """Lines of the legend below the colours."""
        return [*filter(None, [self.clipped]), *["grey: not finite"] * self.missing]

    def color(self, category: int) -> str:
        """Return the colour of a category."""
        return dict(zip(self.names, self.table, strict=True))[category]

    def rgb(self, cloud: PointCloud) -> npt.NDArray[np.uint8]:
        """Return the colour of each point, shape (n, 3)."""
        return self.rgb_of(field_of(cloud, self.field))

    def rgb_of(self, values: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
        """Return the colour of each value of the field, shape (n, 3)."""
        if self.names:
            categories: npt.NDArray[np.uint8] = _channels(self.table)[np.searchsorted(list(self.names), values)]
            return categories
        finite, last = np.isfinite(values), len(self.table) - 1
        index = np.where(finite, self.places(values) * len(self.table), 0).clip(0, last).astype(int)
        colors: npt.NDArray[np.uint8] = _channels(self.table)[index]
        colors[~finite] = _channels([MISSING])
        return colors

    def places(self, values: npt.ArrayLike) -> Floats:
        """Return the positions of numbers between the limits: 0 at the first, 1 at the second."""
        low, high = self.limits
        unit = max(abs(low), abs(high))  # prevents overflow in the difference
        places: Floats = (np.asarray(values, np.float64) / unit - low / unit) / (high / unit - low / unit)
        return places

    def ticks(self) -> dict[float, str]:
        """Return about five round values between the limits, with their texts."""
        low, high = (Fraction(repr(limit)) for limit in self.limits)  # decimal: 0.1, not 0.1 + 5.6e-18
        step = round_step((high - low) / 6)
        numbers = [float(i * step) for i in range(math.ceil(low / step), math.floor(high / step) + 1)]
        if not 1e-6 < step < 1e9:
            return {number: f"{number:g}" for number in numbers}
        digits = next(digits for digits in count() if (step * 10**digits).denominator == 1)
        return {number: f"{number:,.{digits}f}" for number in numbers}


def field_of(cloud: PointCloud, name: str) -> npt.NDArray[Any]:
    """Return a scalar field of a cloud, or z for ``"height"``; an empty cloud need not have the field."""
    values: npt.NDArray[Any] = cloud.xyz[:, 2] if name == "height" or not len(cloud) else getattr(cloud, name)
    return values


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of categories and surfaces.

    Attributes
    ----------
    names : mapping of str to mapping of int to str
        Names of categories, by field.
    others : mapping of str to iterable of int
        Categories of the surfaces and boxes, by field.
    objects : mapping of int to str
        Names of the objects with a label, which stand for labels without a name.
    heights : ndarray of float64, shape (2,), or None
        Least and greatest height of the surfaces, m: the limits if there are no points.
    """

    names: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    others: Mapping[str, Iterable[int]] = field(default_factory=dict)
    objects: Mapping[int, str] = field(default_factory=dict)
    heights: Floats | None = None


@dataclass(frozen=True, slots=True)
class Style:
    """How to colour.

    Attributes
    ----------
    theme : Theme
        Colours of what is not data.
    color_map : str or None
        One of `MAPS`, or the default of the field.
    limits : tuple of float or None
        Values at the ends of the colour map; None: those of the data.
    """

    theme: Theme = DARK
    color_map: str | None = None
    limits: tuple[float, float] | None = None


def coloring(
    clouds: Sequence[PointCloud], color_by: str | None, known: Known | None = None, style: Style | None = None
) -> Coloring:
    """Return the colours of clouds by a scalar field or ``"height"``; by default by intensity if they have it.

    A category always has the same colour, independent of the others. Errors and velocities get colours that are
    symmetric about 0. If a few outliers would take most of the range, it ends at the 1st and 99th percentile. An
    integer field of a few values has a colour for each.

    Parameters
    ----------
    clouds : sequence of PointCloud
        At least one.
    color_by : str, optional
        The field.
    known : Known, optional
        Names and categories that the clouds do not tell.
    style : Style, optional
        How to colour.

    Raises
    ------
    TypeError, ValueError
        If `color_by` is not a scalar field of all clouds with points.
    """
    known, style = known or Known(), style or Style()
    if not isinstance(color_by, str | None):
        raise ArgumentTypeError("color_by", "the name of a field", short_repr(color_by))
    clouds = [cloud for cloud in clouds if len(cloud)] or clouds  # a rig may have no scan in a frame
    fields = [["height", *(name for name in cloud.fields if getattr(cloud, name).ndim == 1)] for cloud in clouds]
    scalars = [name for name in fields[0] if all(name in others for others in fields)]
    if color_by is None:
        color_by = "intensity" if "intensity" in scalars else "height"
    if color_by not in scalars:
        raise ArgumentValueError("color_by", f"one of {', '.join(scalars)}", short_repr(color_by))
    values = np.concatenate([field_of(cloud, color_by) for cloud in clouds])
    if color_by == "height" and not len(values) and known.heights is not None:
        values = known.heights
    if color_by in CATEGORIES:
        categories = {*map(int, np.unique(values)), *known.others.get(color_by, ())}
        if categories:
            objects = known.objects if color_by == "label" else {}
            names = SOURCES if color_by == "source" else known.names.get(color_by, {})
            return _categorical(color_by, categories, names, objects, style.theme)
    if values.dtype == np.bool_ and len(values):
        return _categorical(color_by, {0, 1}, {0: "false", 1: "true"}, {}, style.theme)
    diverges = "error" in color_by or "velocity" in color_by
    anchors = MAPS[style.color_map] if style.color_map else DIVERGING if diverges else SEQUENTIAL
    adapts = style.theme is not DARK and style.color_map is None  # the colours of the maps are for the dark background
    if values.dtype.kind in "iu" and style.limits is None and 0 < len(few := np.unique(values)) <= FEW:
        table = _blend(anchors, len(few))
        table = [legible(color, style.theme.background) for color in table] if adapts else table
        span = float(few[0]), float(few[-1])
        return Coloring(color_by, span, span, table, {int(value): f"{value:,}" for value in few})
    finite = values[np.isfinite(values)].astype(np.float64)
    limits, extent = _limits(finite)
    if style.limits is not None:
        limits = style.limits
    elif diverges:
        most = max(map(abs, limits))
        extent = extent if extent != limits else (-most, most)
        limits = -most, most
    table = _blend(anchors)
    if adapts:
        table = [legible(color, style.theme.background) for color in table]
    return Coloring(color_by, limits, extent, table, {}, len(finite) > 0, len(finite) < len(values))


def check_limits(limits: Sequence[float] | None) -> tuple[float, float] | None:
    """Return limits after checking that they are two numbers, the second greater.

    Raises
    ------
    TypeError, ValueError
        If they are not.
    """
    if limits is None:
        return None
    low, high = array("limits", limits, (2,)).tolist()
    if not low < high:
        raise ArgumentValueError("limits", "two numbers, the second greater", f"{low:g} and {high:g}")
    return low, high


def class_coloring(labels: Iterable[int], known: Known, theme: Theme) -> Coloring:
    """Return the colours of those labels that have a name, or the name of an object, for boxes and surfaces."""
    names = known.names.get("label", {})
    named = {label for label in labels if names.get(label, known.objects.get(label, "")).strip()}
    return _categorical("label", named, names, known.objects, theme)


def instance_coloring(names: Mapping[int, str], theme: Theme) -> Coloring:
    """Return the colours of instances with these names, for surfaces."""
    return _categorical("instance", names, names, {}, theme)


def _categorical(
    name: str, values: Iterable[int], names: Mapping[int, str], objects: Mapping[int, str], theme: Theme
) -> Coloring:
    """Return the colours of categories: by the meaning of their names or those of objects, else by their numbers."""
    found, table = {}, []
    for value in sorted(values):
        own, other = names.get(value, "").strip(), objects.get(value, "").strip()
        found[value] = plain(own or other or value, most=NAME)
        color = class_color(own, value) if own else class_color(other)
        if name == "label" and value == 0 and not (own or other) and {**names, **objects}:
            found[value], color = "unlabelled", UNLABELLED
        table.append(legible(color or QUALITATIVE[value % len(QUALITATIVE)], theme.background))
    span = (float(min(found, default=0)), float(max(found, default=0)))
    return Coloring(name, span, span, table, found)


@cache
def legible(color: str, background: str = BACKGROUND) -> str:
    """Return a colour of sufficient contrast: mixed with as little white (on a light background, black) as it needs."""
    back = luminance(background)
    end = 255 if back < 0.5 else 0
    color = color if back < 0.5 else LIGHT.get(color, color)
    channels = _channels([color])[0].astype(np.int64)
    for part in range(256):
        mixed = (channels * (255 - part) + end * part) // 255
        mixed_color = f"#{bytes(mixed.astype(np.uint8)).hex()}"
        low, high = sorted((luminance(mixed_color), back))
        if high + 0.05 >= CONTRAST * (low + 0.05):
            return mixed_color
    raise AssertionError  # white and black have it


def luminance(color: str) -> float:
    """Return the relative luminance of a colour (WCAG 2.1): 0 for black, 1 for white."""
    return float(linear_light(_channels([color])[0] / 255) @ LUMINANCE)


def _limits(finite: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of the colours, and the least and greatest value."""
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.5, 0.5)
    if low == high:
        half = max(0.5, math.ulp(low))  # the ulp of great numbers exceeds 0.5
        return (low - half, high + half), (low - half, high + half)
    with np.errstate(over="ignore"):  # differences of numbers near 1e308 are infinite, which makes no outlier
        first, last = map(float, np.percentile(finite, (1, 99)))
    outliers = high - low > 2.0 * (last - first) > 0.0
    return ((first, last) if outliers else (low, high)), (low, high)


def round_step(least: Fraction) -> Fraction:
    """Return the smallest number >= `least` that is 1, 2, 2.5, 5 or 10 times a power of ten."""
    power = Fraction(10) ** math.floor(math.log10(least.numerator) - math.log10(least.denominator))
    # Next to a power of ten, rounding may put the logarithm on its other side, which needs the factor 20.
    return next(step for factor in (2, 4, 5, 10, 20, 40) if (step := factor * power / 2) >= least)


def _readable(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _channels(colors: Sequence[str]) -> npt.NDArray[np.uint8]:
    return np.array([list(bytes.fromhex(color[1:])) for color in colors], np.uint8)


def _blend(anchors: Sequence[str], size: int = 256) -> list[str]:
    """Return `size` colours that run through the anchors."""
    steps = np.linspace(0, len(anchors) - 1, size)
    channels = [np.interp(steps, np.arange(len(anchors)), channel) for channel in _channels(anchors).T]
    return [f"#{bytes(color).hex()}" for color in np.rint(channels).astype(np.uint8).T]
