"""Terrain from rasters, against rasterio's own values and positions and a triangulation in plain loops."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import rasterio
from rasterio import Affine
from rasterio._env import get_gdal_config
from rasterio.crs import CRS

import lidarsim as ls
from lidarsim import config
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, ConfigError, FileFormatError
from lidarsim.io import raster

UTM = "EPSG:32632"
NORTH_UP = Affine(10, 0, 500_000.5, 0, -7.5, 5_200_000.25)
NO_DATA = -9999.0
Grid = npt.NDArray[Any]


def heights(rows: int = 30, columns: int = 40, *, holes: float = 0.1, seed: int = 1) -> Grid:
    """Random heights as float32, with the share `holes` without data."""
    rng = np.random.default_rng(seed)
    z = rng.normal(300, 20, (rows, columns)).astype(np.float32)
    z[rng.random(z.shape) < holes] = NO_DATA
    return z


def tiff(path: Path, *bands: Grid, transform: Affine = NORTH_UP, **more: Any) -> Path:
    """A GeoTIFF of these bands."""
    profile = {"crs": UTM, "nodata": NO_DATA, "dtype": bands[0].dtype.name, "transform": transform, **more}
    rows, columns = bands[0].shape
    with rasterio.open(path, "w", driver="GTiff", height=rows, width=columns, count=len(bands), **profile) as file:
        for number, band in enumerate(bands, 1):
            file.write(band, number)
    return path


def asc(path: Path, z: Grid, header: str = "xllcorner 500000.5\nyllcorner 5200000.25\ncellsize 2.5\n") -> Path:
    """An Esri ASCII grid, with all digits of float64."""
    rows = "\n".join(" ".join(map(repr, row)) for row in z.tolist())
    path.write_text(f"ncols {z.shape[1]}\nnrows {z.shape[0]}\n{header}NODATA_value -9999\n{rows}\n", encoding="ascii")
    return path


def nodes(path: Path, band: int = 1, **options: Any) -> tuple[Grid, Grid]:
    """Positions of the nodes of a file, (rows, columns, 3), z as rasterio has it, and whether each has data."""
    with rasterio.open(path, **options) as file:
        values = file.read(band, masked=True)
        i, j = np.indices(file.shape)
        places = rasterio.transform.xy(file.transform, i.ravel(), j.ravel())
        x, y = (np.reshape(place, file.shape) for place in places)
    z = values.data.astype(np.float64)
    return np.stack([x, y, z], axis=-1), ~np.ma.getmaskarray(values) & ~np.isnan(z)


def compose(*transforms: Affine) -> Affine:
    """The transforms after each other, the last first."""
    matrix = np.linalg.multi_dot([np.reshape(transform, (3, 3)) for transform in (*transforms, Affine.identity())])
    return Affine(*matrix[:2].ravel())


def triangles(points: Grid, there: Grid) -> set[frozenset[tuple[float, ...]]]:
    """The two triangles of each cell whose corners are all there, in loops; rows run to the left of columns."""
    found = set()
    rows, columns = there.shape
    for i in range(rows - 1):
        for j in range(columns - 1):
            a, b, c, d = (i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)
            for corners in ((a, b, c), (a, c, d)):
                if all(there[corner] for corner in corners):
                    found.add(frozenset(tuple(points[corner].tolist()) for corner in corners))
    return found


def of_mesh(mesh: ls.TriangleMesh) -> set[frozenset[tuple[float, ...]]]:
    corners = mesh.vertices[mesh.faces]
    assert len({frozenset(map(tuple, triangle)) for triangle in corners.tolist()}) == len(mesh)
    return {frozenset(map(tuple, triangle)) for triangle in corners.tolist()}


def agrees(mesh: ls.TriangleMesh, points: Grid, there: Grid) -> None:
    """The mesh has these nodes, bit for bit, and these triangles, with normals upwards."""
    assert {tuple(vertex) for vertex in mesh.vertices.tolist()} == {tuple(node) for node in points[there].tolist()}
    assert len(mesh.vertices) == there.sum()
    assert of_mesh(mesh) == triangles(points, there)
    assert mesh.grid == there.shape
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


@pytest.mark.parametrize("kind", ["float32", "float64", "int16", "uint8", "int32", "uint16"])
def test_nodes_of_a_geotiff_are_those_of_rasterio(kind: str, tmp_path: Path) -> None:
    z = heights().astype(np.float64)
    z[z == NO_DATA] = 7
    path = tiff(tmp_path / "dem.tif", z.astype(kind), nodata=7)
    points, there = nodes(path)
    assert 0 < there.sum() < there.size
    mesh = ls.TriangleMesh.from_raster(path)
    agrees(mesh, points[::-1], there[::-1])
    assert mesh.crs == UTM


def test_nodes_of_an_ascii_grid_have_all_their_digits(tmp_path: Path) -> None:
    z = np.random.default_rng(2).normal(300, 20, (9, 13))
    z[3, 4] = NO_DATA
    path = asc(tmp_path / "dem.asc", z)
    points, there = nodes(path, DATATYPE="Float64")
    assert np.array_equal(points[..., 2], z)
    assert there.sum() == z.size - 1
    mesh = ls.TriangleMesh.from_raster(path)
    agrees(mesh, points[::-1], there[::-1])
    assert mesh.crs is None
    assert mesh.vertices[0].tolist() == [500_000.5 + 1.25, 5_200_000.25 + 1.25, z[-1, 0]]
    corner = ls.TriangleMesh.from_raster(
        asc(tmp_path / "center.asc", z, "xllcenter 500001.75\nyllcenter 5200001.5\ncellsize 2.5\n")
    )
    assert corner == mesh


def test_an_ascii_grid_has_no_data_at_minus_9999_if_it_declares_none(tmp_path: Path) -> None:
    path = tmp_path / "dem.asc"
    path.write_text("ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 -9999\n4 5 6\n", encoding="ascii")
    mesh = ls.TriangleMesh.from_raster(path)
    assert sorted(mesh.vertices[:, 2].tolist()) == [1, 2, 4, 5, 6]
    assert len(mesh) == 2


@pytest.mark.parametrize("columns", [1, -1], ids=["east", "west"])
def test_either_order_of_the_rows_is_the_same_terrain(columns: int, tmp_path: Path) -> None:
    z = heights()
    one = ls.TriangleMesh.from_raster(tiff(tmp_path / "a.tif", z))
    rows = Affine(columns * 10, 0, 500_000.5 + (0 if columns > 0 else 400), 0, 7.5, 5_200_000.25 - 30 * 7.5)
    other = ls.TriangleMesh.from_raster(tiff(tmp_path / "b.tif", z[::-1, ::columns], transform=rows))
    points, there = nodes(tmp_path / "b.tif")
    agrees(other, points if columns > 0 else points[::-1], there if columns > 0 else there[::-1])
    assert len(one) == len(other)
    if columns > 0:
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.faces, other.faces)


@pytest.mark.parametrize("degrees", [30, -100, 190])
def test_a_rotated_and_sheared_raster(degrees: float, tmp_path: Path) -> None:
    transform = compose(NORTH_UP, Affine.rotation(degrees), Affine.shear(10))
    path = tiff(tmp_path / "dem.tif", heights(), transform=transform)
    points, there = nodes(path)
    agrees(ls.TriangleMesh.from_raster(path), points[::-1], there[::-1])
    message = f"window: expected none, since the pixels of {path} are rotated or sheared, got [0.0, 0.0, 1.0, 1.0]"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.TriangleMesh.from_raster(path, window=(0, 0, 1, 1))


def test_pixels_declared_as_points_have_their_nodes_at_the_tie_points(tmp_path: Path) -> None:
    z = heights(holes=0)
    path = tiff(tmp_path / "dem.tif", z)
    area = ls.TriangleMesh.from_raster(path)
    with rasterio.open(path, "r+") as file:
        file.update_tags(AREA_OR_POINT="Point")
        file.transform = NORTH_UP
    with rasterio.Env(GTIFF_POINT_GEO_IGNORE="YES"):
        with rasterio.open(path) as file:
            assert file.tags()["AREA_OR_POINT"] == "Point"
            tie = file.transform.c, file.transform.f + (len(z) - 1) * file.transform.e
        point = ls.TriangleMesh.from_raster(path)
    assert point == area
    assert point.vertices[0].tolist() == [*tie, z[-1, 0]]


def test_bands_scales_and_units(tmp_path: Path) -> None:
    raw = heights().astype(np.float64)
    path = tiff(tmp_path / "dem.tif", raw + 1, raw * 2, nodata=None)
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets, file.units = (1.0, 0.1), (0.0, -5.0), ("m", "ft")
    first, second = (ls.TriangleMesh.from_raster(path, band=band) for band in (1, 2))
    assert np.array_equal(first.vertices[:, 2].reshape(raw.shape)[::-1], raw + 1)
    assert np.array_equal(second.vertices[:, 2].reshape(raw.shape)[::-1], (raw * 2 * 0.1 - 5.0) * 0.3048)
    for band, kind in ((3, ValueError), (0, ValueError), (1.5, TypeError), ("1", TypeError)):
        with pytest.raises(kind, match=r"^band: expected "):
            ls.TriangleMesh.from_raster(path, band=band)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("crs", "unit", "metres"),
    [
        ("EPSG:32632+5773", None, 1.0),
        ("EPSG:32632+6360", None, 1200 / 3937),
        ("EPSG:32632+8228", None, 0.3048),
        ("EPSG:32632+6360", "m", 1.0),
        (UTM, "US survey foot", 1200 / 3937),
        (UTM, "Feet", 0.3048),
    ],
)
def test_heights_in_feet_become_metres(crs: str, unit: str | None, metres: float, tmp_path: Path) -> None:
    z = heights(holes=0)
    path = tiff(tmp_path / "dem.tif", z, crs=crs)
    if unit:
        with rasterio.open(path, "r+") as file:
            file.units = (unit,)
    got = ls.TriangleMesh.from_raster(path).vertices[:, 2].reshape(z.shape)[::-1]
    # The factor of a file is rounded to 15 digits, and a product once.
    assert np.abs(got - z.astype(np.float64) * metres).max() <= 400 * 2e-15


def test_masks_and_nan_are_holes(tmp_path: Path) -> None:
    z = heights(holes=0)
    z[3, 4] = np.nan
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        path = tiff(tmp_path / "dem.tif", z, nodata=None)
        with rasterio.open(path, "r+") as file:
            mask = np.full(z.shape, 255, np.uint8)
            mask[10:13, 20:25] = 0
            file.write_mask(mask)
    there = (mask > 0) & ~np.isnan(z)
    mesh = ls.TriangleMesh.from_raster(path)
    assert len(mesh.vertices) == there.sum() == z.size - 16
    agrees(mesh, nodes(path)[0][::-1], there[::-1])


@pytest.mark.parametrize("dtype", [np.int16, np.float32, np.float64])
def test_masked_heights_are_holes(dtype: type[np.generic], tmp_path: Path) -> None:
    z = heights().astype(dtype)
    path = tiff(tmp_path / "dem.tif", z)
    with rasterio.open(path) as file:
        masked = file.read(1, masked=True)
    assert masked.mask.sum() == (z == NO_DATA).sum() > 0
    i, j = np.nonzero(z != NO_DATA)
    mesh = ls.TriangleMesh.from_heightfield(masked, 2.0)
    np.testing.assert_array_equal(mesh.vertices, np.column_stack((2.0 * j, 2.0 * i, z[i, j])))
    assert len(mesh) == len(ls.TriangleMesh.from_raster(path))
    whole = np.ma.masked_array(np.zeros((2, 2), dtype))
    assert len(ls.TriangleMesh.from_heightfield(whole, 1.0)) == 2


@pytest.mark.parametrize("stride", [1, 2, 3, 7, 13])
@pytest.mark.parametrize("layout", ["strips", "tiles", "ascii"])
def test_strides(stride: int, layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raster, "PIECE", 500)  # several pieces
    z = heights()
    if layout == "ascii":
        path = asc(tmp_path / "dem.asc", z.astype(np.float64))
    else:
        tiles = {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate"} if layout == "tiles" else {}
        path = tiff(tmp_path / "dem.tif", z, **tiles)
        with rasterio.open(path, "r+") as file:  # averages, which are not to be read
            file.build_overviews([2, 4], rasterio.enums.Resampling.average)
    points, there = nodes(path)
    kept = points[::stride, ::stride][::-1], there[::stride, ::stride][::-1]
    agrees(ls.TriangleMesh.from_raster(path, stride=stride), *kept)


def test_a_stride_leaves_two_rows(tmp_path: Path) -> None:
    path = tiff(tmp_path / "dem.tif", heights())
    for stride in (30, 10**12):
        with pytest.raises(ValueError, match=f"^stride: expected one below .*\\(30, 40\\), got {stride}$"):
            ls.TriangleMesh.from_raster(path, stride=stride)
    with pytest.raises(ValueError, match=r"^stride: expected an integer >= 1, got 0$"):
        ls.TriangleMesh.from_raster(path, stride=0)


@pytest.mark.slow("windows of rasters are covered by the fewest nodes")
@pytest.mark.parametrize("south_up", [False, True])
@pytest.mark.parametrize("stride", [1, 3])
def test_windows_are_covered_by_the_fewest_nodes(stride: int, south_up: bool, tmp_path: Path) -> None:
    transform = compose(NORTH_UP, Affine.translation(0, 30), Affine.scale(1, -1)) if south_up else NORTH_UP
    path = tiff(tmp_path / "dem.tif", heights(holes=0), transform=transform)
    points, there = nodes(path)
    points, there = points[::stride, ::stride], there[::stride, ::stride]
    if not south_up:
        points, there = points[::-1], there[::-1]
    x, y = points[0, :, 0], points[:, 0, 1]
    rng = np.random.default_rng(3)
    kept = set()
    for trial in range(60):
        low, high = np.sort(rng.uniform((x[0] - 20, y[0] - 20), (x[-1] + 20, y[-1] + 20), (2, 2)), axis=0)
        if trial % 2:  # at nodes, exactly
            i, j = (np.sort(rng.choice(len(of), 2, replace=False)) for of in (x, y))
            low, high = np.column_stack((x[i], y[j]))
        if high[0] <= x[0] or low[0] >= x[-1] or high[1] <= y[0] or low[1] >= y[-1]:
            continue
        ends = []
        for of, a, b in ((x, low[0], high[0]), (y, low[1], high[1])):
            first = max([0, *(k for k in range(len(of)) if of[k] <= a)])
            last = min([len(of) - 1, *(k for k in range(len(of)) if of[k] >= b)])
            ends.append(slice(first, last + 1))
        part = ends[1], ends[0]
        mesh = ls.TriangleMesh.from_raster(path, window=(*low, *high), stride=stride)
        agrees(mesh, points[part], there[part])
        kept.add(mesh.grid)
    assert len(kept) > 20


def test_windows_that_share_an_edge_meet(tmp_path: Path) -> None:
    """No ray passes between two windows, wherever their common edge lies."""
    path = tiff(tmp_path / "dem.tif", heights(holes=0))
    left, bottom, right, top = 500_000, 5_199_000, 500_500, 5_201_000
    for edge in (500_205.5, 500_207.3):
        scene = ls.Scene()
        scene.add(ls.TriangleMesh.from_raster(path, window=(left, bottom, edge, top), stride=2))
        scene.add(ls.TriangleMesh.from_raster(path, window=(edge, bottom, right, top), stride=2))
        rng = np.random.default_rng(4)
        low, high = scene.bounds
        down = np.column_stack([rng.uniform(edge - 25, edge + 25, 500), rng.uniform(low[1], high[1], 500)])
        hits = scene.cast(np.column_stack([down, np.full(500, 1000.0)]), np.tile((0, 0, -1.0), (500, 1)))
        assert hits.hit.all()
        assert set(hits.object_id.tolist()) == {0, 1}


@pytest.mark.parametrize(
    ("window", "reason"),
    [
        ((0, 0, 10, 10), "expected one that overlaps the nodes of .*, x 500005.5 to 500395.5, y .*"),
        ((500_000, 5_200_000, 500_005.5, 5_200_010), "expected one that overlaps"),
        ((10, 0, 0, 10), r"expected x_min < x_max and y_min < y_max in x_min, y_min, x_max, y_max, got \[10.0, 0.0, "),
        ((0, 0, 10), r"expected shape \(4,\), got \(3,\)"),
        ((0, 0, np.inf, 10), r"expected finite numbers, got window\[2\] = inf"),
    ],
)
def test_bad_windows(window: tuple[float, ...], reason: str, tmp_path: Path) -> None:
    path = tiff(tmp_path / "dem.tif", heights())
    with pytest.raises(ValueError, match=f"^window: {reason}"):
        ls.TriangleMesh.from_raster(path, window=window)


def test_rays_pass_through_holes_alone(tmp_path: Path) -> None:
    z = heights(holes=0.3)
    path = tiff(tmp_path / "dem.tif", z)
    points, there = nodes(path)
    mesh = ls.TriangleMesh.from_raster(path)
    rng = np.random.default_rng(5)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    at = rng.uniform(low, high, (4000, 3))
    at[:, 2] = 1000
    hit = mesh.cast(at, np.tile((0, 0, -1.0), (4000, 1))).hit
    # The cell and the triangle of it below each ray, by its fractions from the lower left node.
    points, there = points[::-1], there[::-1]
    across, up = (at[:, 0] - points[0, 0, 0]) / 10, (at[:, 1] - points[0, 0, 1]) / 7.5
    j, i = across.astype(int), up.astype(int)
    below = across - j >= up - i  # a, b, c, else a, c, d
    third = np.where(below, there[i, j + 1], there[i + 1, j])
    expected = there[i, j] & there[i + 1, j + 1] & third
    assert 500 < expected.sum() < 3500
    assert np.array_equal(hit, expected)
    # Straight down, exactly, at the nodes in the corner of a triangle.
    used = np.unique(mesh.faces)
    top = mesh.vertices[used] + np.array((0, 0, 1000))
    hits = mesh.cast(top, np.tile((0, 0, -1.0), (len(used), 1)))
    assert np.array_equal(top[:, 2] - hits.t, mesh.vertices[used, 2])


def test_the_coordinate_reference_system_is_kept(tmp_path: Path) -> None:
    mesh = ls.TriangleMesh.from_raster(tiff(tmp_path / "dem.tif", heights()), transform=np.eye(4))
    again = pickle.loads(pickle.dumps(mesh))  # noqa: S301
    assert (again.crs, again.grid) == (UTM, (30, 40))
    assert again == mesh
    other = ls.TriangleMesh.from_raster(tiff(tmp_path / "b.tif", heights(), crs="EPSG:25832"), transform=np.eye(4))
    assert np.array_equal(other.vertices, mesh.vertices)
    assert other != mesh
    assert "EPSG:32632" in repr(mesh)
    assert ls.TriangleMesh(mesh.vertices, mesh.faces).crs is None
    scene = pickle.loads(pickle.dumps(ls.Scene.from_file(tmp_path / "dem.tif")))  # noqa: S301
    assert scene[0].shape.crs == UTM
    assert scene[0].name == "dem.tif"


@pytest.mark.parametrize("version", ["WKT1_ESRI", "WKT1_GDAL"])
def test_the_system_of_an_ascii_grid_is_in_the_file_beside_it(version: str, tmp_path: Path) -> None:
    path = asc(tmp_path / "dem.asc", heights().astype(np.float64))
    (tmp_path / "dem.prj").write_text(CRS.from_string(UTM).to_wkt(version=version), encoding="utf-8")
    crs = ls.TriangleMesh.from_raster(path).crs
    assert crs is not None
    assert raster.same_crs(crs, UTM)
    assert not raster.same_crs(crs, "EPSG:32633")


def test_heights_of_an_ascii_grid_are_in_the_unit_of_its_system(tmp_path: Path) -> None:
    z = heights(holes=0).astype(np.float64)
    path = asc(tmp_path / "dem.asc", z)
    (tmp_path / "dem.prj").write_text(CRS.from_string("EPSG:32632+6360").to_wkt(version="WKT1_GDAL"), encoding="utf-8")
    got = ls.TriangleMesh.from_raster(path).vertices[:, 2].reshape(z.shape)[::-1]
    assert np.abs(got - z * (1200 / 3937)).max() <= 400 * 2e-15  # as above


@pytest.mark.parametrize(
    ("crs", "reason"),
    [
        ("EPSG:4326", r"expected coordinates in metres, got degree \(EPSG:4326\); reproject it, as with gdalwarp"),
        ("EPSG:4979", "expected coordinates in metres, got degree"),
        ("EPSG:2263", "expected coordinates in metres, got US survey foot"),
        ("EPSG:4978", "expected coordinates of a map, got those of EPSG:4978"),
        ("EPSG:32632+5715", "expected heights, got depths"),
    ],
)
def test_other_coordinates_are_refused(crs: str, reason: str, tmp_path: Path) -> None:
    path = tiff(tmp_path / "dem.tif", heights(), crs=crs)
    assert re.match(reason, refusal(path))


def test_a_metre_of_the_projection_is_one_on_the_ground(tmp_path: Path) -> None:
    """In Web Mercator at 47° north it is cos 47°; at the equator the same projection is right, and so is UTM."""
    north = compose(Affine.translation(1_000_000, 5_950_000), Affine.scale(30, -30))
    path = tiff(tmp_path / "dem.tif", heights(), crs="EPSG:3857", transform=north)
    assert re.match(
        "expected coordinates in metres, got EPSG:3857, where 1 m is 0.68. m on the ground; repro", refusal(path)
    )
    equator = compose(Affine.translation(1_000_000, 0), Affine.scale(30, -30))
    tiff(path, heights(), crs="EPSG:3857", transform=equator)
    assert ls.TriangleMesh.from_raster(path).crs == "EPSG:3857"


@pytest.mark.parametrize("number", [-9999, -999, -32768, 32767, float(np.finfo(np.float32).min), 1e20, 1e38])
@pytest.mark.parametrize("declared", [None, 1.0])
def test_no_data_that_is_not_declared(number: float, declared: float | None, tmp_path: Path) -> None:
    z = heights(holes=0.0)
    z[3, 5:9] = number
    path = tiff(tmp_path / "dem.tif", z, nodata=declared)
    assert re.match(
        r"expected heights, got \S+ m in row 3, column 5; no data\? declare it, as by gdal_edit", refusal(path)
    )
    with pytest.raises(
        ArgumentValueError, match=r"z: expected heights, or NaN for a hole, got z\[3\]\[5\] = .*; no data\?"
    ):
        ls.TriangleMesh.from_heightfield(z, 1.0)
    z[3, 5:9] = np.nan
    assert ls.TriangleMesh.from_heightfield(z, 1.0).grid == z.shape
    trench = np.linspace(-9999, -9000, 1200).reshape(30, 40)  # a depth among others
    assert ls.TriangleMesh.from_heightfield(trench, 1.0).grid == (30, 40)


def refusal(path: Path, **options: Any) -> str:
    with pytest.raises(FileFormatError) as caught:
        ls.TriangleMesh.from_raster(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text.removeprefix(f"{path}: ")


def test_rasters_that_are_no_terrain(tmp_path: Path) -> None:
    z, path = heights(), tmp_path / "dem.tif"

    def refusal_of(*bands: Grid, **more: Any) -> str:
        return refusal(tiff(path, *bands, **more))

    assert refusal_of(z.astype(np.complex64), nodata=None) == "band 1: expected real numbers, got complex64"
    colours = [z.astype(np.uint8)] * 3
    assert refusal_of(*colours, nodata=None, photometric="RGB") == "band 1: expected heights, got colours (red)"
    assert refusal_of(z[:1]) == "expected at least 2 rows and 2 columns, got 1 × 40"
    assert refusal_of(np.full_like(z, NO_DATA)).startswith("expected a triangle of heights, got no data")
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        tiff(path, z, transform=None)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        assert refusal(path) == "it has no geotransform, which would place its pixels"
    assert refusal_of(z, transform=Affine(1, 1, 0, 1, 1, 0)).startswith(
        "its geotransform cannot be inverted: (1.0, 1.0, 0.0"
    )
    assert refusal_of(z, transform=Affine(1e307, 0, 0, 0, 1e-3, 1)).startswith("expected coordinates within the range")
    z[4, 5] = np.inf
    assert refusal_of(z) == "expected finite heights, got inf in row 4, column 5"
    z[4, 5] = 1
    for field, value, reason in (
        ("units", ("degC",), "band 1: expected heights in metres or feet, got the unit 'degC'"),
        ("scales", (np.nan,), "band 1: expected a finite scale and offset, got nan and 0.0"),
        ("scales", (1e308,), "expected finite heights, got "),
    ):
        tiff(path, z)
        with rasterio.open(path, "r+") as file:
            setattr(file, field, value)
        assert refusal(path).startswith(reason)


def test_large_rasters_are_read_in_part(tmp_path: Path) -> None:
    path = tmp_path / "dem.tif"
    options = {"tiled": True, "sparse_ok": True, "bigtiff": "YES", "nodata": 0, "crs": UTM, "transform": NORTH_UP}
    size = 2**17
    with rasterio.open(path, "w", driver="GTiff", height=size, width=size, count=1, dtype="float32", **options) as file:
        file.write(heights(100, 100, holes=0.0), 1, window=((0, 100), (0, 100)))
    assert path.stat().st_size < 1 << 22
    most = 100 * path.stat().st_size // 8
    assert 1 << 24 < most < 1 << 26
    assert refusal(path) == (
        f"expected at most {most:,} nodes in a file of this size, which take {254e-9 * most:.0f} GB, got"
        " 131,072 × 131,072 = 17,179,869,184; read a part of them (window) or every n-th row and column (stride)"
    )
    x, y = 500_000.5 + 505, 5_200_000.25 - 50.5 * 7.5
    mesh = ls.TriangleMesh.from_raster(path, window=(500_000, y, x, 5_300_000))
    assert mesh.grid == (51, 51)
    assert np.array_equal(mesh.vertices[:, 2].reshape(51, 51)[::-1], heights(100, 100, holes=0.0)[:51, :51])
    assert "131,072" not in refusal(path, stride=2**15)  # four by four nodes, of which one has a height


def test_files_that_claim_more_than_they_have_take_no_memory(tmp_path: Path) -> None:
    grid = asc(tmp_path / "dem.asc", heights().astype(np.float64))
    text = grid.read_text(encoding="ascii").replace("nrows 30", "nrows 100000").replace("ncols 40", "ncols 600")
    grid.write_text(text, encoding="ascii")
    path, size = tmp_path / "dem.tif", 2**17
    options = {"blockysize": 1024, "sparse_ok": True, "nodata": 0, "crs": UTM, "transform": NORTH_UP, "BIGTIFF": "YES"}
    with rasterio.open(path, "w", driver="GTiff", height=size, width=size, count=1, dtype="float32", **options):
        pass
    tracemalloc.start()
    assert refusal(grid) == f"it is truncated: 100,000 × 600 heights in {len(text):,} bytes"
    assert refusal(path, window=(500_000, 5_199_000, 501_000, 5_200_000)) == (
        "expected blocks of at most 67,108,864 pixels, got 134,217,728; tile it: gdal_translate -co TILED=YES"
    )
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 24


def test_only_the_file_itself_is_read(tmp_path: Path) -> None:
    """Neither what lies beside it nor what it names: other drivers, folders in archives, URLs."""
    z = heights()
    path = tiff(tmp_path / "dem.tif", z)
    mesh = ls.TriangleMesh.from_raster(path)
    moved = compose(Affine.translation(1, 0), NORTH_UP)
    bare = tiff(tmp_path / "bare.tif", np.where(z == -9999, 0, z), transform=moved, crs=None, nodata=None)
    plain = ls.TriangleMesh.from_raster(bare)
    grid = asc(tmp_path / "grid.asc", z.astype(np.float64))
    ascii_grid = ls.TriangleMesh.from_raster(grid)
    for file in (path, bare, grid):
        file.with_suffix(".tfw").write_text("1\n0\n0\n1\n0\n0\n", encoding="ascii")
        Path(f"{file}.aux.xml").write_text(
            "<PAMDataset><SRS>EPSG:4326</SRS><GeoTransform>0,1,0,0,0,1</GeoTransform>"
            '<PAMRasterBand band="1"><NoDataValue>1</NoDataValue><Scale>5</Scale></PAMRasterBand></PAMDataset>',
            encoding="utf-8",
        )
        with rasterio.open(
            f"{file}.msk", "w", driver="GTiff", height=30, width=40, count=1, dtype="uint8", transform=NORTH_UP
        ) as mask:
            mask.write(np.zeros((30, 40), np.uint8), 1)
            mask.update_tags(INTERNAL_MASK_FLAGS_1="2")
    with rasterio.open(bare) as file:
        assert file.crs == "EPSG:4326"  # what GDAL reads if it may
        assert file.scales == (5.0,)
    assert ls.TriangleMesh.from_raster(path) == mesh
    assert ls.TriangleMesh.from_raster(bare) == plain
    assert ls.TriangleMesh.from_raster(grid) == ascii_grid
    virtual = tmp_path / "virtual.tif"
    virtual.write_text(
        '<VRTDataset rasterXSize="40" rasterYSize="30"><GeoTransform>0,1,0,0,0,1</GeoTransform>'
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="1">dem.tif'
        "</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>",
        encoding="utf-8",
    )
    with rasterio.open(virtual) as file:
        assert file.driver == "VRT"
    assert "not a readable raster of heights" in refusal(virtual)
    for name in ("http://127.0.0.1:9/dem.tif", f"GTIFF_DIR:1:{path}", f"/vsizip/{path}", f"zip://{path}"):
        with pytest.raises(FileNotFoundError, match=f"^{re.escape(str(Path(name)))}: no such file$"):
            ls.TriangleMesh.from_raster(name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_options_of_gdal_hold_for_the_reader_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, read, seen = tiff(tmp_path / "a.tif", heights(holes=0.0)), raster._heights, []

    def option() -> object:
        return get_gdal_config("GDAL_PAM_ENABLED")

    def elsewhere() -> object:
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(option).result()

    def watch(*arguments: Any) -> Grid:
        seen.append((option(), elsewhere()))
        return read(*arguments)

    monkeypatch.setattr(raster, "_heights", watch)
    before = option(), elsewhere()
    ls.TriangleMesh.from_raster(path)
    assert before == (None, None)
    assert seen == [("NO", None)]
    assert (option(), elsewhere()) == before


def test_no_pipe_beside_a_file_is_opened(tmp_path: Path) -> None:
    """In another process, since no signal ends one that waits for a pipe within GDAL."""
    path, grid = tiff(tmp_path / "dem.tif", heights()), asc(tmp_path / "grid.asc", heights().astype(np.float64))
    for file in (path, grid):
        for suffix in (".ovr", ".msk", ".aux.xml", ".tfw", ".prj", ".wld", ".IMD", "_RPC.TXT", ".aux", ".tab"):
            for beside in {file.with_name(file.stem + suffix), file.with_name(file.name + suffix)}:
                os.mkfifo(beside)
    code = "import sys, lidarsim as ls; print(ls.TriangleMesh.from_raster(sys.argv[1]).crs)"
    done = [
        subprocess.run([sys.executable, "-c", code, file], capture_output=True, text=True, timeout=60, check=False)
        for file in (path, grid)
    ]
    assert done[0].stdout == f"{UTM}\n"
    assert f"{grid}: {tmp_path / 'grid.prj'}: expected a regular file, got a pipe or device" in done[1].stderr


def test_configurations(tmp_path: Path) -> None:
    tiff(tmp_path / "dem.tif", heights(), heights(seed=2))
    run = tmp_path / "run.yaml"

    def load(*objects: str) -> ls.Scene:
        run.write_text("sensor: {preset: velodyne-vlp16}\nscene:\n" + "".join(f"- {text}\n" for text in objects))
        return config.load(run).scene

    part = "{shape: raster, file: dem.tif, band: 2, window_m: [500000, 5199900, 500200, 5200000], stride: 2, label: 3}"
    scene = load(part, part, "{shape: raster, file: dem.tif}", "{shape: plane, normal: [0, 0, 1]}")
    window = 500_000, 5_199_900, 500_200, 5_200_000
    expected = ls.TriangleMesh.from_raster(tmp_path / "dem.tif", band=2, window=window, stride=2)
    assert scene[0].shape == expected
    assert scene[0].shape is scene[1].shape
    assert scene[0].label == 3
    assert scene[2].shape == ls.TriangleMesh.from_raster(tmp_path / "dem.tif")
    for text, reason in (
        ("{shape: raster, file: dem.tif, band: 3}", "band: expected a band of .*dem.tif, 1 to 2, got 3"),
        ("{shape: raster, file: dem.tif, stride: 0}", "stride: expected an integer >= 1, got 0"),
        ("{shape: raster, file: dem.tif, window_m: [0, 0, 1, 1]}", "window_m: expected one that overlaps"),
        ("{shape: raster, file: dem.tif, window_m: [0, 0, 1]}", "window_m: expected at least 4 items, got a list of 3"),
        ("{shape: raster, file: none.tif}", "file: cannot read .*none.tif: No such file or directory"),
        ("{shape: raster, file: run.yaml}", f"{re.escape(str(run))}: not a readable raster of heights: "),
    ):
        with pytest.raises(ConfigError, match=rf"^{re.escape(str(run))}:3: scene\.0(: |\.){reason}"):
            load(text)


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (CRS.from_string(UTM).to_wkt(), True),
        ("EPSG:32632+5773", True),  # UTM alone tells nothing of heights
        ("EPSG:32633", False),
        ("EPSG:32633+5773", False),
        ("EPSG:25832", False),
    ],
)
def test_the_same_coordinate_reference_system_in_other_words(other: str, same: bool) -> None:
    assert raster.same_crs(UTM, other) is raster.same_crs(other, UTM) is same
    assert not raster.same_crs("EPSG:32632+6360", "EPSG:32632+5773")


def test_rasters_of_a_scene_have_one_coordinate_reference_system(tmp_path: Path) -> None:
    for name, crs in (("a", UTM), ("b", "EPSG:32633"), ("c", None)):
        tiff(tmp_path / f"{name}.tif", heights(), crs=crs)
    grid = asc(tmp_path / "d.asc", heights().astype(np.float64))
    grid.with_suffix(".prj").write_text(CRS.from_string(UTM).to_wkt(version="WKT1_ESRI"), encoding="utf-8")
    run = tmp_path / "run.yaml"
    text = "sensor: {preset: velodyne-vlp16}\nscene:\n" + "".join(
        f"- {{shape: raster, file: {name}}}\n" for name in ("a.tif", "c.tif", "d.asc")
    )
    run.write_text(text, encoding="utf-8")
    assert len(config.load(run).scene) == 3
    run.write_text(f"{text}- {{shape: raster, file: b.tif}}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        config.load(run)
    assert str(caught.value) == (
        f"{run}:6: scene.3.file: expected a raster in EPSG:32632, as object 0 is, got one in EPSG:32633"
    )


def test_a_georeference_is_in_the_system_of_the_rasters(tmp_path: Path) -> None:
    """In another zone, the points of a survey would be hundreds of kilometres away."""
    tiff(tmp_path / "dem.tif", heights(), crs=UTM)
    run = tmp_path / "run.yaml"
    run.write_text(
        "scene: [{shape: raster, file: dem.tif}]\nsensor: {preset: velodyne-vlp16}\ncloud: {frame: world}\n",
        encoding="utf-8",
    )
    for crs in ("32632", "EPSG:32632+5773"):
        assert str(config.load(run, [f"georeference.crs={crs}"]).crs) == crs
    for crs in ("EPSG:32633", "EPSG:32633+5773"):
        with pytest.raises(ConfigError) as caught:
            config.load(run, [f"georeference.crs={crs}"])
        expected = f"expected the system of object 0, 'EPSG:32632', got '{crs}'"
        assert str(caught.value) == f"--set georeference.crs={crs}: {expected}"


def test_without_rasterio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tiff(tmp_path / "dem.tif", heights())
    for package in ("pyproj", "rasterio"):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(ls.errors.MissingExtraError, match=f"^reading a raster needs {package}"):
            ls.TriangleMesh.from_raster(path)
    with pytest.raises((ArgumentTypeError, TypeError)):
        ls.TriangleMesh.from_raster(5)  # type: ignore[arg-type]


def test_nothing_is_printed(tmp_path: Path) -> None:
    """GDAL tells of a damaged file in the exception alone."""
    path = tiff(tmp_path / "dem.tif", heights(300, 300), tiled=True, compress="deflate")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    code = "from lidarsim.cli import main; main()"
    command = [sys.executable, "-c", code, "view", str(path), "--screenshot", str(tmp_path / "a.png")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stdout == ""
    assert re.fullmatch(f"lidarsim: {re.escape(str(path))}: not a readable raster of heights: .*\n", result.stderr)
