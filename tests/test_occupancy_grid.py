"""Occupancy grids: cells that surfaces pass through, by formulas, by scans, and as another reader sees the map."""

from __future__ import annotations

import copy
import itertools
from pathlib import Path

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import FileFormatError

Floats = npt.NDArray[np.float64]


def cells_on(grid: ls.OccupancyGrid, curve: Floats) -> npt.NDArray[np.bool_]:
    """The cells that hold points of a curve, (n, 2)."""
    found = np.zeros(grid.cells.shape, bool)
    index = np.floor((curve - grid.origin) / grid.resolution).astype(int)
    inside = ((index >= 0) & (index < found.shape[::-1])).all(axis=1)
    found[index[inside, 1], index[inside, 0]] = True
    return found


def near(grid: ls.OccupancyGrid, curve: Floats, slack: float) -> npt.NDArray[np.bool_]:
    """The same, with cells that the curve misses by `slack` at most."""
    return np.logical_or.reduce(
        [cells_on(grid, curve + np.array([x, y])) for x, y in itertools.product((-slack, 0, slack), repeat=2)]
    )


def check(grid: ls.OccupancyGrid, curve: Floats) -> None:
    """Check that the occupied cells are those of a densely sampled curve, but for cells that it hardly enters."""
    occupied = grid.cells == 100
    step = np.linalg.norm(np.diff(curve, axis=0), axis=1).max()
    assert step < grid.resolution / 50
    assert not (cells_on(grid, curve) & ~near(grid, curve, 0.0)).any()
    missed = cells_on(grid, curve) & ~occupied
    # Along lines an eighth of a cell apart, corners of a cell that are cut off by less may be missed.
    assert missed.sum() <= 0.05 * occupied.sum()
    assert not (occupied & ~near(grid, curve, 2 * step)).any()
    assert occupied.sum() > 20


ANGLES = np.linspace(0, 2 * np.pi, 20_001)
CIRCLE = np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))
BOUNDS = ((-3, -3), (3, 3))


def test_slices_of_curved_surfaces_are_their_curves() -> None:
    turned = np.eye(4)
    turned[:3, :3] = np.diag([2.0, 1.0, 1.0])
    for shape, transform, z, curve in (
        (ls.Sphere((0.3, 0.1, 0), 1.0), None, 0.6, 0.8 * CIRCLE + (0.3, 0.1)),
        (ls.Sphere((0, 0, 0), 1.0), turned, 0.6, 0.8 * CIRCLE * (2.0, 1.0)),
        (ls.Cylinder((0, 0, -1), (0, 0, 1), 1.5), None, 0.2, 1.5 * CIRCLE),
        (ls.Ellipsoid((0, 0, 0), (2.0, 1.0, 1.0)), None, 0.0, CIRCLE * (2.0, 1.0)),
        (ls.Capsule((0, 0, 0), (0, 0, 1), 0.7), None, 0.5, 0.7 * CIRCLE),
        (ls.Spheres([(0, 0, 0)], [1.0]), None, 0.0, CIRCLE),
    ):
        scene = ls.Scene()
        scene.add(shape, transform=transform)
        check(ls.occupancy(scene, 0.1, z, bounds=BOUNDS), curve)
    scene = ls.Scene()
    scene.add(ls.Plane((1, 2, 0), 0.5))
    share = np.linspace(-7, 7, 20_001)[:, None]
    check(ls.occupancy(scene, 0.1, 9.0, bounds=BOUNDS), np.array([0.5, 0.0]) + share * (2.0, -1.0) / np.sqrt(5))


def exact_cells(grid: ls.OccupancyGrid, start: Floats, end: Floats) -> set[tuple[int, int]]:
    """The cells that a segment passes through: those of the middles between all crossings of grid lines."""
    a, b = (np.asarray(p) - grid.origin for p in (start, end))
    shares = [0.0, 1.0]
    for axis in range(2):
        if a[axis] != b[axis]:
            low, high = sorted((a[axis], b[axis]))
            lines = np.arange(np.ceil(low / grid.resolution), np.floor(high / grid.resolution) + 1) * grid.resolution
            shares += ((lines - a[axis]) / (b[axis] - a[axis])).tolist()
    shares = sorted(share for share in shares if 0 <= share <= 1)
    middles = [a + (x + y) / 2 * (b - a) for x, y in itertools.pairwise(shares) if y - x > 1e-9]
    return {(int(y // grid.resolution), int(x // grid.resolution)) for x, y in middles}


def test_segments_of_triangles_occupy_the_cells_that_they_pass_through() -> None:
    rng = np.random.default_rng(2)
    for _ in range(30):
        start, end = rng.uniform(0, 6, (2, 2))
        scene = ls.Scene()
        scene.add(ls.Triangle((*start, -1), (*end, -1), (*((start + end) / 2), 7)), transform=np.diag([1, 1, 0.5, 1.0]))
        z = float(rng.uniform(-0.4, 3.4))
        grid = ls.occupancy(scene, 0.25, z, bounds=((0, 0), (6, 6)))
        # At a share s of the height, the sides of the triangle are at s/2 and 1 − s/2 of its base.
        share = (2.0 * z + 1.0) / 8.0 / 2.0
        first, second = start + share * (end - start), end + share * (start - end)
        found = {(int(i), int(j)) for i, j in np.argwhere(grid.cells == 100)}
        assert found == exact_cells(grid, first, second)
        assert found


def test_legs_within_a_cell_are_found_and_lying_faces_are_not() -> None:
    legs = [ls.Box((0.02, 0.02, 0.7), center=(x, y, 0.35)) for x in (0.525, 1.525) for y in (0.525, 0.925)]
    scene = ls.Scene()
    for leg in legs:
        scene.add(leg)
    scene.add(ls.Box((1.2, 0.6, 0.04), center=(1.025, 0.725, 0.72)))
    scene.add(ls.Polygon([(0, 0, 0.3), (2, 0, 0.3), (2, 1, 0.3), (0, 1, 0.3)]))  # lies in the slice
    grid = ls.occupancy(scene, 0.05, 0.3, bounds=((0, 0), (2, 1)))
    assert np.argwhere(grid.cells == 100).tolist() == [[10, 10], [10, 30], [18, 10], [18, 30]]
    np.testing.assert_array_equal(grid.index([(0.525, 0.525), (1.525, 0.925)]), [[10, 10], [18, 30]])


def test_round_posts_within_a_cell_are_found() -> None:
    scene = ls.Scene()
    scene.add(ls.Cylinder((0.55, 0.35, 0), (0.55, 0.35, 1), 0.02))
    scene.add(ls.Sphere((0.25, 0.75, 0.5), 0.02))
    grid = ls.occupancy(scene, 0.1, 0.5, bounds=((0, 0), (1, 1)))
    assert np.argwhere(grid.cells == 100).tolist() == [[3, 5], [7, 2]]


def test_hits_of_a_scan_in_the_slice_are_in_occupied_cells() -> None:
    rng = np.random.default_rng(3)
    scene = ls.Scene()
    scene.add(ls.Box((10, 8, 3), center=(0, 0, 1)))
    height = ls.TriangleMesh.from_heightfield(rng.uniform(-1, 1, (9, 9)), 0.3)
    for k in range(12):
        place = RigidTransform.from_components(np.append(rng.uniform((-4, -3), (4, 3)), 0.5), Rotation.random(rng=rng))
        shape = (ls.Box((0.5, 0.3, 0.7)), ls.Cylinder((0, 0, -1), (0, 0, 1), 0.2), height)[k % 3]
        scene.add(shape, transform=place)
    walker = ls.Trajectory([0.0, 10.0], [np.eye(4), RigidTransform.from_translation((2.0, 0, 0)).as_matrix()])
    scene.add(ls.Cylinder((-3, -2, 0), (-3, -2, 2), 0.3), motion=walker)
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.05, 0.5
    lidar = ls.Lidar(ls.patterns.Spinning([0.0], columns=3600, rate=1e6))
    grid = ls.occupancy(scene, 0.05, 0.5, time=5.0, free_from=pose[:2, 3])
    hits = lidar.scan(scene, pose, time=5.0).point_cloud(frame="world").xyz[:, :2]
    assert len(hits) == 3600
    near_hits = [grid.index(hits + shift) for shift in itertools.product((-1e-9, 1e-9), repeat=2)]
    occupied = np.array([grid.cells[tuple(index.T)] == 100 for index in near_hits]).any(axis=0)
    # A corner of a cell that a round object cuts off by less than an eighth of the cell's side may be missed.
    assert occupied.mean() > 0.995
    # Beams reach their hits through free cells.
    for share in np.linspace(0, 0.9, 7):
        index = grid.index(pose[:2, 3] + share * (hits - pose[:2, 3]))
        assert (grid.cells[tuple(index.T)] == 0).mean() > 0.9
    assert set(np.unique(grid.cells)) == {-1, 0, 100}


@pytest.mark.parametrize("turn", [None, np.diag([2.0, 1, 1, 1])])
def test_the_grid_covers_what_moves_where_it_is(turn: Floats | None) -> None:
    """At 5 s, a box of one metre has come from x = y = 0 to (20, 10), turned by 90°; a stretched one is 2 m along y."""
    there = RigidTransform.from_components((40.0, 20.0, 0), Rotation.from_euler("z", np.pi)).as_matrix()
    scene = ls.Scene()
    scene.add(ls.Box((1, 1, 2)), transform=turn, motion=ls.Trajectory([0.0, 10.0], [np.eye(4), there]))
    grid = ls.occupancy(scene, 0.25, 0.3, time=5.0)
    y, x = grid.resolution * (np.argwhere(grid.cells == 100) + 0.5).T + np.reshape(grid.origin[::-1], (2, 1))
    for values, middle, side in ((x, 20.0, 1.0), (y, 10.0, 1.0 if turn is None else 2.0)):
        assert abs(values.min() - (middle - side / 2)) < 0.25
        assert abs(values.max() - (middle + side / 2)) < 0.25
    with pytest.raises(ValueError, match="expected times within the motion of object 0"):
        ls.occupancy(scene, 0.25, 0.3, time=11.0)


def test_free_space_is_what_can_be_reached() -> None:
    scene = ls.Scene()
    scene.add(ls.Box((4, 4, 2)))
    scene.add(ls.Box((1, 1, 2)))
    grid = ls.occupancy(scene, 0.1, 0.01, free_from=(1.2, 1.2))
    at = {place: int(grid.cells[tuple(grid.index([place])[0])]) for place in ((1, 1), (0, 0), (2.05, 0), (2.0, 0.03))}
    assert at == {(1, 1): 0, (0, 0): -1, (2.05, 0): 100, (2.0, 0.03): 100} or at[0, 0] == -1
    several = ls.occupancy(scene, 0.1, 0.01, free_from=[(1.2, 1.2), (0, 0)])
    assert (several.cells == 0).sum() > (grid.cells == 0).sum()
    assert set(np.unique(ls.occupancy(scene, 0.1, 0.01).cells)) == {0, 100}


def test_a_saved_map_is_what_map_server_reads(tmp_path: Path) -> None:
    scene = ls.Scene()
    scene.add(ls.Box((4, 2, 2)))
    scene.add(ls.Box((0.4, 0.6, 2), center=(1, 0.4, 0)))
    grid = ls.occupancy(scene, 0.05, 0.01, free_from=(-1, 0))
    grid.save(tmp_path / "map.yaml")
    assert {path.name for path in tmp_path.iterdir()} == {"map.yaml", "map.pgm"}
    with (tmp_path / "map.yaml").open(encoding="utf-8") as file:
        fields = yaml.safe_load(file)
    assert fields["resolution"] == 0.05
    assert fields["origin"] == [*grid.origin, 0.0]
    # As nav2_map_server's map_io.cpp has it, in mode trinary.
    picture = np.asarray(PIL.Image.open(tmp_path / fields["image"]), float)
    occupancy = picture / 255.0 if fields["negate"] else (255.0 - picture) / 255.0
    assert fields["mode"] == "trinary"
    read = np.where(occupancy > fields["occupied_thresh"], 100, np.where(occupancy < fields["free_thresh"], 0, -1))
    np.testing.assert_array_equal(read[::-1], grid.cells)
    assert set(np.unique(read)) == {-1, 0, 100}
    with pytest.raises(FileFormatError):
        grid.save(tmp_path / "map.png")


def test_what_is_ignored_is_as_if_it_were_not_there() -> None:
    empty = ls.Scene()
    empty.add(ls.Box((4, 2, 2)))
    scene = copy.copy(empty)
    pose = np.eye(4)
    pose[0, 3] = 1.0
    motion = ls.Trajectory([0, 1], [pose, pose])
    scene.add(ls.Box((0.5, 0.5, 0.5)), motion=motion, instance=7)
    scene.add(ls.Sphere((9, 9, 0), 0.5), instance=7)
    wanted = ls.occupancy(empty, 0.1, 0.01, free_from=(1, 0), time=5.0)
    found = ls.occupancy(scene, 0.1, 0.01, free_from=(1, 0), time=5.0, ignore=[7])
    np.testing.assert_array_equal(found.cells, wanted.cells)
    assert found.origin == wanted.origin
    with pytest.raises(ValueError, match="ignore: expected instances of objects in the scene"):
        ls.occupancy(scene, 0.1, 0.01, ignore=[8])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"resolution": 0.0}, "resolution: expected a finite number > 0"),
        ({"resolution": 1e-6}, "resolution: expected a grid of at most 268,435,456 cells"),
        ({"z": np.nan}, "z: expected a finite number"),
        ({"bounds": ((0, 0), (0, 1))}, "bounds: expected minima below maxima"),
        ({"bounds": (0, 1)}, r"bounds: expected shape \(2, 2\)"),
        (
            {"free_from": (9, 9)},
            r"free_from: expected points in cells of the grid that are not occupied, got free_from = ",
        ),
        ({"free_from": [(0, 0), (2, 0.02)]}, r"not occupied, got free_from\[1\] = \[2.0, 0.02\]"),
        ({"free_from": (0, 0, 0)}, "free_from: expected shape"),
        ({"scene": ls.Scene()}, "bounds: expected some, since no object of the scene is bounded"),
    ],
)
def test_wrong_arguments_are_refused(options: dict[str, object], message: str) -> None:
    scene = ls.Scene()
    scene.add(ls.Box((4, 2, 2)))
    with pytest.raises(ValueError, match=message):
        ls.occupancy(**({"scene": scene, "resolution": 0.1, "z": 0.01} | options))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        ls.occupancy("scene", 0.1, 0.0)  # type: ignore[arg-type]
