"""File layouts of data sets: one module per layout, with a line in `LAYOUTS`."""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Discriminator, TypeAdapter, ValidationError

from lidarsim.datasets.layouts._layout import Files, Layout, Summary, class_name
from lidarsim.datasets.layouts.bags import Bags
from lidarsim.datasets.layouts.kitti import Kitti
from lidarsim.datasets.layouts.mmdetection3d import MMDetection3D
from lidarsim.datasets.layouts.nuscenes import NuScenes
from lidarsim.datasets.layouts.openpcdet import OpenPCDet
from lidarsim.datasets.layouts.semantickitti import SemanticKitti
from lidarsim.datasets.layouts.shards import Shards
from lidarsim.errors import ArgumentValueError

__all__ = ["LAYOUTS", "AnyLayout", "Files", "Layout", "Summary", "class_name", "layout_of"]

LAYOUTS: dict[str, type[Layout]] = {
    "bags": Bags,
    "kitti": Kitti,
    "mmdetection3d": MMDetection3D,
    "nuscenes": NuScenes,
    "openpcdet": OpenPCDet,
    "semantickitti": SemanticKitti,
    "shards": Shards,
}


def _by_name(value: object) -> object:
    return {"type": value} if isinstance(value, str) else value


if TYPE_CHECKING:
    AnyLayout = Layout
else:
    AnyLayout = Annotated[reduce(or_, LAYOUTS.values()), Discriminator("type"), BeforeValidator(_by_name)]


def layout_of(value: str | dict[str, Any]) -> Layout:
    """Return the layout with a name, or from a mapping with the name as ``type`` and its options.

    Raises
    ------
    ValueError
        If there is no such layout or option.
    """
    try:
        layout: Layout = TypeAdapter(AnyLayout).validate_python(value)
    except ValidationError as invalid:
        raise ArgumentValueError("layout", f"one of {', '.join(LAYOUTS)} and its options", repr(value)) from invalid
    return layout
