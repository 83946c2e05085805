"""Grids of a cloud beside sums by hand and beside GDAL."""

from __future__ import annotations

import copy
import math
import pickle
import statistics
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.scan.cells import STATISTICS, Statistic

UTM = np.array([500_000.0, 5_400_000.0, 300.0])


@pytest.fixture(scope="module")
def cloud() -> ls.PointCloud:
    rng = np.random.default_rng(3)
    xyz = UTM + rng.uniform((-20, -10, 0), (20, 30, 5), (2000, 3))
    return ls.PointCloud(xyz=xyz, intensity=rng.random(2000), label=rng.integers(0, 9, 2000))


def by_hand(cloud: ls.PointCloud, field: str, cell: float, statistic: str) -> dict[tuple[int, int], float]:
    values = cloud.xyz[:, 2] if field == "z" else getattr(cloud, field)
    groups = defaultdict(list)
    for (x, y, _), value in zip(cloud.xyz.tolist(), values.tolist(), strict=True):
        groups[math.floor(x / cell), math.floor(y / cell)].append(value)
    functions: dict[str, Any] = {
        "count": len,
        "density": lambda group: len(group) / cell**2,
        "min": min,
        "max": max,
        "mean": statistics.fmean,
        "std": statistics.pstdev,
    }
    return {place: functions[statistic](group) for place, group in groups.items()}


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("field", ["z", "intensity", "label"])
def test_each_cell_has_the_statistic_of_its_points(cloud: ls.PointCloud, field: str, statistic: Statistic) -> None:
    cells = cloud.raster(field, cell=2.5, statistic=statistic)
    right = by_hand(cloud, field, 2.5, statistic)
    rows, columns = cells.values.shape
    left, bottom = (math.floor(v / 2.5) for v in cells.bounds[:2])
    assert (rows, columns) == (16, 16)
    empty = 0.0 if statistic in {"count", "density"} else np.nan
    expected = [[right.get((left + j, bottom + rows - 1 - i), empty) for j in range(columns)] for i in range(rows)]
    assert len(right) > 200
    # Sums of up to 20 numbers below 512, each rounding of which is at most 2**-45; roots magnify them near zero only.
    np.testing.assert_allclose(cells.values, expected, rtol=0, atol=64 * 2.0**-45)


def test_edges_are_multiples_of_the_cell_or_as_asked_for(cloud: ls.PointCloud) -> None:
    cells = ls.PointCloud(xyz=[[1.0, 2.0, 5.0], [2.9, 2.9, 7.0]]).raster(cell=1.0)
    assert cells.bounds == (1.0, 2.0, 3.0, 3.0)
    np.testing.assert_array_equal(np.asarray(cells), [[5.0, 7.0]])
    part = cloud.raster(cell=5.0, statistic="count", bounds=(500_001, 5_400_000, 500_010, 5_400_006))
    assert part.bounds == (500_000, 5_400_000, 500_010, 5_400_010)
    x, y = cloud.xyz[:, :2].T
    inside = (x >= 500_000) & (x < 500_010) & (y >= 5_400_000) & (y < 5_400_010)
    assert part.values.sum() == inside.sum() > 50
    assert cloud.raster(cell=5.0, statistic="count").values.sum() == len(cloud)
    unknown = ls.PointCloud(xyz=[[0.5, 0.5, np.nan], [0.5, 0.5, 1.0], [np.nan, 0.5, 9.0]])
    assert unknown.raster(cell=1.0, statistic="max").values.tolist() == [[1.0]]
    assert unknown.raster(cell=1.0, statistic="count").values.tolist() == [[2.0]]


def test_gdal_reads_the_file_at_its_place(cloud: ls.PointCloud, tmp_path: Path) -> None:
    cells = cloud.raster(cell=2.0, statistic="max")
    cells.save(tmp_path / "top.tif", crs="EPSG:25832")
    with rasterio.open(tmp_path / "top.tif") as file:
        assert file.crs.to_epsg() == 25832
        np.testing.assert_array_equal(file.read(1), cells.values)
        assert tuple(file.bounds) == cells.bounds
        highest = int(np.argmax(cloud.xyz[:, 2]))
        assert next(file.sample([cloud.xyz[highest, :2]]))[0] == cloud.xyz[highest, 2]
    cells.save(tmp_path / "none.tif")
    with rasterio.open(tmp_path / "none.tif") as file:
        assert file.crs is None
    mesh = ls.TriangleMesh.from_raster(tmp_path / "top.tif")
    assert mesh.bounds[1, 2] == cloud.xyz[:, 2].max()
    for same in (copy.deepcopy(cells), pickle.loads(pickle.dumps(cells))):  # noqa: S301
        np.testing.assert_array_equal(same.values, cells.values)
        assert same.bounds == cells.bounds


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"cell": 0.0}, "cell: expected a finite number > 0, got 0.0"),
        ({"cell": 1e-6}, "cell: expected cells of which at most 268,435,456 cover the points, got "),
        (
            {"cell": 1.0, "statistic": "median"},
            "statistic: expected 'count', .* 'mean' or 'std', got 'median'",
        ),
        ({"cell": 1.0, "field": "xyz"}, "field: expected one of x, y, z, intensity, label, got 'xyz'"),
        ({"cell": 1.0, "bounds": (0, 0, 0, 1)}, "bounds: expected x_min < x_max and y_min < y_max, got"),
    ],
)
def test_arguments_that_do_not_fit(cloud: ls.PointCloud, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cloud.raster(**arguments)


def test_no_points_have_no_bounds(tmp_path: Path) -> None:
    empty = ls.PointCloud(xyz=np.empty((0, 3)))
    with pytest.raises(
        ValueError, match="bounds: expected x_min, y_min, x_max, y_max for a cloud without points, got None"
    ):
        empty.raster(cell=1.0)
    cells = empty.raster(cell=1.0, bounds=(0, 0, 2, 1))
    assert np.isnan(cells.values).all()
    with pytest.raises(FileFormatError, match="unknown extension"):
        cells.save(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("field", "statistic", "quantity"),
    [
        ("z", "max", "max of z [m]"),
        ("intensity", "mean", "mean of intensity"),
        ("z", "count", "points"),
        ("z", "density", "points per m²"),
    ],
)
def test_the_colour_bar_has_name_and_unit(
    cloud: ls.PointCloud, field: str, statistic: Statistic, quantity: str, tmp_path: Path
) -> None:
    cells = cloud.raster(field, cell=5.0, statistic=statistic)
    assert cells.quantity == quantity
    cells.plot(tmp_path / "map.svg")
    assert f"<!-- {quantity} -->" in (tmp_path / "map.svg").read_text(encoding="utf-8")
