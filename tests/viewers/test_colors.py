"""Colours by a field."""

import numpy as np
import pytest

from lidarsim.pointcloud import PointCloud
from lidarsim.viewers._colors import QUALITATIVE, SEQUENTIAL, coloring


def cloud(**fields: object) -> PointCloud:
    return PointCloud({"xyz": np.arange(12.0).reshape(4, 3), **fields})


def test_default_is_intensity_then_height() -> None:
    assert coloring(cloud(), None).title == "height [m]"
    assert coloring(cloud(intensity=[1, 2, 3, 4]), None).title == "intensity"


def test_sequential_colours_run_from_end_to_end() -> None:
    rgb = coloring(cloud(range=[0.0, 1.0, 2.0, 3.0]), "range").rgb()
    assert bytes(rgb[0]).hex() == SEQUENTIAL[0][1:]
    assert bytes(rgb[3]).hex() == SEQUENTIAL[-1][1:]
    lightness = rgb @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > 0).all()


def test_limits_pass_over_outliers_and_nan() -> None:
    values = np.concatenate([np.linspace(0, 1, 999), [1e6, np.nan, -np.inf]])
    colors = coloring(PointCloud(xyz=np.zeros((1002, 3)), gain=values), "gain")
    low, high = colors.limits
    assert 0 < low < 0.02
    assert 0.98 < high < 1.0
    assert colors.rgb().shape == (1002, 3)


def test_categories_have_a_colour_each_and_keep_their_names() -> None:
    colors = coloring(cloud(label=[40, 10, 40, 81]), "label")
    assert colors.names == ["10", "40", "81"]
    assert [f"#{bytes(rgb).hex()}" for rgb in colors.rgb()] == [QUALITATIVE[i] for i in (1, 0, 1, 2)]


def test_more_categories_than_colours_repeat_them() -> None:
    labels = np.arange(20)
    colors = coloring(PointCloud(xyz=np.zeros((20, 3)), label=labels), "label")
    assert [f"#{bytes(rgb).hex()}" for rgb in colors.rgb()] == [QUALITATIVE[i % len(QUALITATIVE)] for i in labels]


@pytest.mark.parametrize("field", ["label", "range", "height"])
def test_no_points(field: str) -> None:
    empty = PointCloud(xyz=np.empty((0, 3)), label=np.empty(0, np.uint32), range=np.empty(0))
    assert coloring(empty, field).rgb().shape == (0, 3)


def test_unknown_field_names_those_there_are() -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        coloring(cloud(ring=[1, 2, 3, 4], normal=np.zeros((4, 3))), "normal")
    assert str(caught.value) == "color_by: expected one of height, ring, got 'normal'"
