"""Maps of cells."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from PIL import Image

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.scan.cells import Cells
from lidarsim.viewers._colors import MAPS
from lidarsim.viewers.cells import DARKEST, LIGHTEST, relief

SIZE = (500, 400)


def draw(path: Path, cells: Cells, **looks: Any) -> np.ndarray:
    cells.plot(path, size=SIZE, **looks)
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert image.shape == (SIZE[1], SIZE[0], 3)
    return image


def near(image: np.ndarray, color: str) -> np.ndarray:
    return (np.abs(image - list(bytes.fromhex(color[1:]))) <= 12).all(axis=-1)


def test_north_is_above_and_cells_without_points_are_blank(tmp_path: Path) -> None:
    values = np.array([[9.0, np.nan], [0.0, 0.0]])  # the north-west alone is high
    cells = Cells(values, (500_000.0, 5e6, 500_020.0, 5e6 + 20), 10.0)
    low, high = MAPS["cividis"][0], MAPS["cividis"][-1]
    image = draw(tmp_path / "a.png", cells, color_map="cividis")
    stage = image[:, : SIZE[0] * 4 // 5]  # to the left of the colour bar
    rows, columns = np.nonzero(near(stage, high))
    below = np.nonzero(near(stage, low))
    assert min(len(rows), len(below[0])) > 3000
    assert rows.max() < below[0].min() + 2
    assert abs(columns.max() + 1 - (columns.min() + stage.shape[1]) / 2) < 20  # the western half
    north_east = image[int(np.median(rows)), 2 * columns.max() - int(np.median(columns))]
    assert north_east.tolist() == [255, 255, 255]


def test_limits_title_and_map_change_the_picture(tmp_path: Path) -> None:
    cells = Cells(np.arange(20.0).reshape(4, 5), (0.0, 0.0, 5.0, 4.0), 1.0)
    looks: list[dict[str, Any]] = [
        {}, {"limits": (0, 5)}, {"title": "$x$"}, {"color_map": "magma"}, {"hillshade": True},
    ]  # fmt: skip
    pictures = [draw(tmp_path / f"{i}.png", cells, **look).tobytes() for i, look in enumerate(looks)]
    assert len(set(pictures)) == len(looks)


def test_an_svg_is_the_same_each_time_and_has_its_size(tmp_path: Path) -> None:
    cells = Cells(np.full((1, 1), np.nan), (0.0, 0.0, 1.0, 1.0), 1.0)
    for name in ("a.svg", "b.svg"):
        cells.plot(tmp_path / name, hillshade=True, title="<none>", size=(720, 360))
    text = (tmp_path / "a.svg").read_bytes()
    assert text == (tmp_path / "b.svg").read_bytes()
    root = ET.fromstring(text)  # noqa: S314 - our own
    assert (root.get("width"), root.get("height")) == ("518.4pt", "259.2pt")  # 72 points an inch, 100 pixels an inch


def test_slopes_towards_the_sun_are_lighter() -> None:
    """Planes, whose gradient is exact, beside the cosine of the angle between normal and sun by hand."""
    x, y = np.meshgrid(np.arange(4) * 2.0, np.arange(5)[::-1] * 2.0)  # the first row is the northernmost
    grey = np.full((5, 4, 3), 0.5)
    level = 0.6 / math.sqrt(0.5**2 + 0.5**2 + 0.6**2)  # sine of the height of the sun, about 40°
    assert (relief(grey, np.full((5, 4), 7.0), 2.0) == 0.5).all()
    for east, north in ((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5), (1.0, -1.0), (-1.0, 1.0)):
        found = relief(grey, east * x + north * y, 2.0)
        cosine = (0.5 * east - 0.5 * north + 0.6) * (level / 0.6) / math.sqrt(1 + east**2 + north**2)
        if cosine < level:
            expected = 0.5 * (1 - DARKEST * min(1 - cosine / level, 1))
        else:
            expected = 0.5 + 0.5 * LIGHTEST * (cosine - level) / (1 - level)
        assert (east - north > 0) == (expected > 0.5)  # ground that falls to the north-west faces the sun
        # About ten operations on numbers of about 1, each rounded by 2⁻⁵³.
        np.testing.assert_allclose(found, expected, rtol=0, atol=16 * 2.0**-53)


def test_holes_have_no_relief_around_them() -> None:
    heights = np.full((5, 5), 3.0)
    heights[2, 2] = np.nan
    assert (relief(np.full((5, 5, 3), 0.5), heights, 1.0) == 0.5).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"limits": (3, 3)}, "limits: expected two numbers, the second greater, got 3 and 3"),
        ({"limits": 3}, "limits: expected shape (2,), got ()"),
        ({"color_map": "jet"}, "color_map: expected 'magma', 'viridis', 'cividis' or 'grey', got 'jet'"),
        ({"hillshade": 2}, "hillshade: expected "),
        ({"title": 5}, "title: expected text, got int"),
        ({"size": (5, 100)}, "size[0]: expected an integer from 16 to 16384, got 5"),
    ],
)
def test_bad_arguments(options: Any, message: str, tmp_path: Path) -> None:
    cells = Cells(np.zeros((2, 2)), (0.0, 0.0, 2.0, 2.0), 1.0)
    with pytest.raises((TypeError, ValueError)) as caught:
        cells.plot(tmp_path / "a.png", **options)
    assert str(caught.value).startswith(message)
    with pytest.raises(FileFormatError, match=r"unknown extension '.jpg', expected .png or .svg"):
        cells.plot(tmp_path / "a.jpg")
    assert not list(tmp_path.iterdir())


def test_a_survey_is_mapped(tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).uniform((0, 0, 0), (40, 20, 3), (5000, 3))
    ls.PointCloud(xyz=xyz).raster(cell=2.0, statistic="density").plot(tmp_path / "density.png")
    assert (tmp_path / "density.png").stat().st_size > 5000
