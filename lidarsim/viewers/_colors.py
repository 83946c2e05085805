"""Colours of points by a field, the same in all viewers: bright enough for a dark background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim.pointcloud import PointCloud

BACKGROUND = "#14181d"

# Magma, a perceptually uniform colour map (N. Smith and S. van der Walt, https://bids.github.io/colormap, CC0), at ten
# equal steps from 0.3, where it is clear of the background, to 1.
SEQUENTIAL = (
    "#641a80", "#832681", "#a3307e", "#c43c75", "#e24d66", "#f56b5c", "#fc9065", "#feb67c", "#fdda9c", "#fcfdbf",
)  # fmt: skip
# The colour of each category from 0 to 259; from 260 on they repeat. The first eight can be told apart by people with
# any kind of colour vision (M. Okabe and K. Ito, Color universal design, 2008, without black). Each later one is the
# colour farthest in OKLab (B. Ottosson, 2020) from all chosen before, among the 4096 colours of three hexadecimal
# digits that have a contrast of at least 3:1 with the background. First come 8 to 33 and the classes of SemanticKITTI,
# then the rest. That search takes longer than drawing a picture, so its result stands here; the tests repeat it.
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

UNITS = {"height": "m", "range": "m", "true_range": "m", "range_error": "m", "time": "s", "incidence": "rad"}
CATEGORIES = {"label", "object_id", "instance", "return_number", "return_count"}


@dataclass(frozen=True, slots=True, eq=False)
class Coloring:
    """A table of colours over the interval `limits` of `values`, one value a point; `names` are those of categories."""

    title: str
    values: npt.NDArray[Any]
    limits: tuple[float, float]
    table: list[str]
    names: list[str]

    def rgb(self) -> npt.NDArray[np.uint8]:
        """Return the colour of each point, shape (n, 3)."""
        low, high = self.limits
        index = np.nan_to_num((self.values - low) / (high - low) * len(self.table))
        return _channels(self.table).take(index.clip(0, len(self.table) - 1).astype(int), axis=0)


def coloring(cloud: PointCloud, color_by: str | None) -> Coloring:
    """Return the colours of a cloud by a scalar field, or ``"height"``; by default by intensity if it has that.

    The limits are the 1st and 99th percentile, so that a few outliers do not use up the range of colours. A category
    always has the same colour, whichever others the cloud contains.

    Raises
    ------
    ValueError
        If the cloud has no such scalar field.
    """
    scalars = ["height", *(name for name in cloud.fields if getattr(cloud, name).ndim == 1)]
    if color_by is None:
        color_by = "intensity" if "intensity" in scalars else "height"
    if color_by not in scalars:
        raise ValueError(f"color_by: expected one of {', '.join(scalars)}, got {color_by!r}")
    values = cloud.xyz[:, 2] if color_by == "height" else getattr(cloud, color_by)
    if color_by in CATEGORIES and len(cloud):
        found, index = np.unique(values, return_inverse=True)
        table = [QUALITATIVE[int(value) % len(QUALITATIVE)] for value in found]
        known = cloud.class_names if color_by == "label" else {}
        names = [known.get(int(value), str(value)) for value in found]
        return Coloring(color_by, index, (-0.5, len(found) - 0.5), table, names)
    finite = values[np.isfinite(values)].astype(np.float64)
    low, high = np.percentile(finite, (1, 99)) if len(finite) else (0.0, 1.0)
    if low == high:
        low, high = low - 0.5, high + 0.5
    title = f"{color_by} [{UNITS[color_by]}]" if color_by in UNITS else color_by
    return Coloring(title, values, (float(low), float(high)), _blend(SEQUENTIAL), [])


def _channels(colors: Sequence[str]) -> npt.NDArray[np.uint8]:
    return np.array([list(bytes.fromhex(color[1:])) for color in colors], np.uint8)


def _blend(anchors: Sequence[str], size: int = 256) -> list[str]:
    """Return `size` colours that run through the anchors."""
    steps = np.linspace(0, len(anchors) - 1, size)
    channels = [np.interp(steps, np.arange(len(anchors)), channel) for channel in _channels(anchors).T]
    return [f"#{bytes(color).hex()}" for color in np.rint(channels).astype(np.uint8).T]
