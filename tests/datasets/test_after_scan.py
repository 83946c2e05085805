"""Functions that change the clouds of a data set before they are written."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.cli.cluster import cluster
from lidarsim.datasets import manifest
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.datasets.store import open_store
from lidarsim.errors import ConfigError, LidarsimError

MODULE = """\
from dataclasses import dataclass


@dataclass
class Share:
    kept: float


SHARE = Share({share})


def drop(cloud, rng):
    return cloud[rng.random(len(cloud)) < SHARE.kept]
"""


def keep(cloud: ls.PointCloud, rng: np.random.Generator) -> ls.PointCloud:
    del rng
    return cloud


def thin(cloud: ls.PointCloud, rng: np.random.Generator) -> ls.PointCloud:
    return cloud[rng.random(len(cloud)) < 0.5]


def ball_alone(cloud: ls.PointCloud, rng: np.random.Generator) -> ls.PointCloud:
    del rng
    return cloud[cloud.label != 40]


def plane_alone(cloud: ls.PointCloud, rng: np.random.Generator) -> ls.PointCloud:
    del rng
    return cloud[cloud.label == 40]


def make(recipe: Path, out: Path, change: Any = None, layout: str = "semantickitti", **more: Any) -> Path:
    ls.generate(recipe, out, after_scan=change, layout=layout, pictures=0, **more)
    return out


def points(out: Path) -> list[np.ndarray]:
    return [np.fromfile(path, np.float32).reshape(-1, 4) for path in sorted(out.rglob("velodyne/*.bin"))]


def archives(out: Path) -> Iterator[dict[str, np.ndarray]]:
    for path in sorted((out / "shards").iterdir()):
        with tarfile.open(path) as tar:
            for member in tar:
                if member.name.endswith(".npz"):
                    yield dict(np.load(io.BytesIO(tar.extractfile(member).read())))  # type: ignore[union-attr]


def infinite(cloud: ls.PointCloud) -> ls.PointCloud:
    changed = cloud.copy()
    xyz = changed.xyz.copy()
    xyz[-1] = np.inf
    changed.xyz = xyz
    return changed


def far(cloud: ls.PointCloud, rng: np.random.Generator) -> ls.PointCloud:
    del rng
    changed = cloud.copy()
    changed.xyz = 1e39 * cloud.xyz
    return changed


@pytest.fixture
def named(recipe: Path) -> Path:
    """A recipe that names a function of a file beside it."""
    (recipe.parent / "ray_drop.py").write_text(MODULE.format(share=0.5))
    recipe.write_text(recipe.read_text() + "after_scan: ray_drop:drop\n")
    return recipe


def test_the_cloud_that_is_returned_is_written(recipe: Path, tmp_path: Path) -> None:
    whole, half = points(make(recipe, tmp_path / "whole")), points(make(recipe, tmp_path / "half", thin))
    assert len(whole) == len(half) == 12
    kept = []
    for all_points, some in zip(whole, half, strict=True):
        rows = {row.tobytes() for row in all_points}
        assert all(row.tobytes() in rows for row in some)
        kept.append(len(some) / len(all_points))
    # 12 frames of 15 points and more: a share of 0.5 has a standard deviation of at most 0.5 / √180 = 0.037.
    assert abs(np.mean(kept) - 0.5) < 6 * 0.037
    assert len({np.float64(share) for share in kept}) > 3  # a generator of its own per frame
    parts = sorted((tmp_path / "half/manifest").glob("0*.json"))
    records = [record for part in parts for record in json.loads(part.read_text())["records"]]
    assert [record["points"] for record in records] == [len(some) for some in half]


@pytest.mark.slow("functions after the scan leave the bytes to the recipe alone")
def test_an_unchanged_cloud_gives_the_same_files(
    recipe: Path, tmp_path: Path, tree: Callable[[Path], dict[str, str]]
) -> None:
    for layout in LAYOUTS.keys() - {"bags"}:
        before = tree(make(recipe, tmp_path / layout, layout=layout))
        after = tree(make(recipe, tmp_path / f"{layout}_after", keep, layout))
        differing = {name for name in before if before[name] != after.get(name)}
        about = {name for name in before if name.startswith(("manifest", "recipe.yaml", "README.md", "v1.0-"))}
        assert differing <= about, layout  # tokens of nuScenes depend on the recipe
        assert {"recipe.yaml", "README.md", "manifest.jsonl"} <= differing


def test_all_columns_are_given(tmp_path: Path) -> None:
    lidar = ls.Lidar.preset("velodyne-vlp16")
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.0))
    expected = lidar.scan(scene).point_cloud().fields

    def scenes(rng: np.random.Generator, number: int) -> Any:
        del rng, number
        return scene, lidar, None

    def check(cloud: ls.PointCloud, rng: np.random.Generator) -> ls.PointCloud:
        del rng
        assert set(expected) <= set(cloud.fields), cloud.fields
        return cloud

    assert {"incidence", "normal", "true_range", "column"} <= set(expected)
    ls.generate(scenes, tmp_path / "out", layout="kitti", after_scan=check, pictures=0)


@pytest.mark.slow("functions after the scan leave the bytes to the recipe alone")
def test_files_are_the_same_for_any_number_of_workers(
    named: Path, tmp_path: Path, tree: Callable[[Path], dict[str, str]]
) -> None:
    alone = tree(make(named, tmp_path / "alone"))
    for part in (1, 0):
        make(named, tmp_path / "parts", part=(part, 2))
    assert tree(tmp_path / "parts") == alone
    with cluster(2, None) as client:
        make(named, tmp_path / "workers", client=client)
    assert tree(tmp_path / "workers") == alone


def test_each_sensor_has_its_own_generator(recipe: Path, tmp_path: Path) -> None:
    pattern = "{type: grid, azimuths_deg: [-5, 0, 5], elevations_deg: [-20, -15, -10, -5], rate_hz: 10}"
    grid = f"{{sensor: {{pattern: {pattern}}}}}"
    text = recipe.read_text()
    head, rest = text[: text.index("vary:")], text[text.index("  pose:") :]
    recipe.write_text(f"{head}run:\n  rig: {{a: {grid}, b: {grid}}}\n{rest}")
    out = make(recipe, tmp_path / "out", thin)
    first = [np.fromfile(path, np.float32) for path in sorted((out / "a").rglob("velodyne/*.bin"))]
    second = [np.fromfile(path, np.float32) for path in sorted((out / "b").rglob("velodyne/*.bin"))]
    assert len(first) == len(second) == 12
    assert any(len(a) != len(b) or not np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_boxes_count_the_points_that_are_left(recipe: Path, tmp_path: Path) -> None:
    def boxes(out: Path) -> list[list[dict[str, Any]]]:
        parts = sorted((out / "manifest").glob("0*.json"))
        return [record["boxes"] for part in parts for record in json.loads(part.read_text())["records"]]

    options: Any = {"layout": {"type": "shards", "fields": ["label", "instance"], "boxes": True}}
    whole = boxes(make(recipe, tmp_path / "whole", **options))
    balls = boxes(make(recipe, tmp_path / "balls", ball_alone, **options))
    planes = boxes(make(recipe, tmp_path / "planes", plane_alone, **options))
    some = boxes(make(recipe, tmp_path / "some", thin, **options))
    assert any(whole)
    assert balls == whole
    assert not any(planes)
    out = tmp_path / "some"
    count = 0
    for cloud, known in zip(archives(out), some, strict=True):
        for box in known:
            assert box["points"] == np.count_nonzero(cloud["instance"] == box["instance"]) > 0
            count += 1
    assert count > 0


def test_boxes_count_no_ghosts_in_mirrors(tmp_path: Path) -> None:
    def scenes(rng: np.random.Generator, number: int) -> Any:
        del rng, number
        scene = ls.Scene()
        scene.add(ls.Plane((0, 0, 1), -1.0), material=ls.materials.ASPHALT_WET)
        scene.add(ls.Box((2, 2, 2), center=(8, 0, 0)))
        pattern = ls.patterns.Spinning(np.radians([-10.0, -5.0, 0.0]), columns=360)
        return scene, ls.Lidar(pattern, measurement=ls.Measurement(depth=2, returns="dual")), None

    layout = {"type": "shards", "fields": ["instance"], "boxes": True}
    for name, change in (("before", None), ("after", keep)):
        ls.generate(scenes, tmp_path / name, layout=layout, after_scan=change, pictures=0)
    (before,), (after,) = (ls.datasets.load(tmp_path / name) for name in ("before", "after"))
    assert before.boxes is not None
    assert after.boxes is not None
    assert before.boxes.points.tolist() == after.boxes.points.tolist()
    assert before.boxes.points[0] < np.count_nonzero(before.cloud.instance == before.boxes.instance[0])


def test_it_is_part_of_what_a_data_set_is_made_of(named: Path, tmp_path: Path) -> None:
    out = make(named, tmp_path / "out")
    head = manifest.complete_head(open_store(out))
    assert head is not None
    assert {name.partition(":")[0] for name in head.sources} == {"after_scan"}
    assert make(named, out) == out  # nothing to do
    (named.parent / "ray_drop.py").write_text(MODULE.format(share=0.25))
    with pytest.raises(LidarsimError, match="same sources"):
        make(named, out)
    (named.parent / "ray_drop.py").write_text("# moved\n" + MODULE.format(share=0.5))
    make(named, out)
    with pytest.raises(LidarsimError, match="same recipe"):
        make(named, out, keep)


def test_a_module_that_python_finds(recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/found_drop.py").write_text(MODULE.format(share=0.0))
    monkeypatch.syspath_prepend(tmp_path / "elsewhere")
    out = tmp_path / "out"
    make(recipe, out, overrides=["after_scan=found_drop:drop"])
    assert not any(map(len, points(out)))


def test_the_card_names_it(named: Path, tmp_path: Path) -> None:
    card = (make(named, tmp_path / "out") / "README.md").read_text().replace("\\", "")
    assert "ray_drop:drop changed each cloud" in card


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("drop", "expected module:function, .*got 'drop'"),
        ("../ray_drop:drop", r"expected module:function, .*got '\.\./ray_drop:drop'"),
        ("no_such_module:drop", "expected module:function, .*No module named"),
        ("ray_drop:other", "expected a function of ray_drop, got 'other'"),
        ("ray_drop:SHARE", "expected a function, got "),
        ("ray_drop:Share", "expected a function, got the class"),
        ("broken:drop", "expected module:function, .*oops"),
        ("narrow:drop", r"expected a function of a cloud and a generator, got one of \(cloud\)$"),
    ],
)
def test_a_name_that_cannot_be_used(named: Path, tmp_path: Path, name: str, said: str) -> None:
    (named.parent / "broken.py").write_text("raise RuntimeError('oops')")
    (named.parent / "narrow.py").write_text("def drop(cloud): return cloud")
    with pytest.raises(ConfigError, match=said) as caught:
        make(named, tmp_path / "out", overrides=[f"after_scan={name}"])
    assert str(caught.value).startswith(f"--set after_scan={name}: expected ")
    assert "\n" not in str(caught.value)


def test_bad_arguments(recipe: Path, tmp_path: Path) -> None:
    for value, said in [
        (3, "after_scan: expected a function, got 3"),
        ("ray_drop:drop", "after_scan: expected a function, got 'ray_drop:drop'"),
        (lambda cloud: cloud, "after_scan: expected a function of a cloud and a generator"),
    ]:
        with pytest.raises(TypeError, match=said):
            make(recipe, tmp_path / "out", value)
    with pytest.raises(ValueError, match=r"^after_scan: expected none with bags"):
        make(recipe, tmp_path / "out", keep, "bags")


def test_the_layout_bags_refuses_a_function_by_its_key(named: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^--set after_scan=ray_drop:drop: expected none with bags"):
        make(named, tmp_path / "out", layout="bags", overrides=["after_scan=ray_drop:drop"])
    line = named.read_text().splitlines().index("after_scan: ray_drop:drop") + 1
    with pytest.raises(ConfigError, match=rf"\.yaml:{line}: after_scan: expected none with bags"):
        make(named, tmp_path / "out", layout="bags")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda cloud, rng: None, "to return a PointCloud, got NoneType"),  # noqa: ARG005
        (lambda *_: 1 / 0, "to return a PointCloud, got ZeroDivisionError: division by zero"),
        (lambda cloud, rng: ls.PointCloud(cloud.xyz), "to return a cloud with instance, intensity, label, range"),  # noqa: ARG005
        (lambda cloud, rng: infinite(cloud), "to return finite points"),  # noqa: ARG005
    ],
)
def test_a_cloud_that_cannot_be_written(recipe: Path, tmp_path: Path, change: Any, said: str) -> None:
    with pytest.raises(LidarsimError, match=f"sequence 0, frame 0 .*after_scan: expected .*{said}"):
        make(recipe, tmp_path / "out", change)


@pytest.mark.parametrize("layout", ["semantickitti", "shards"])
def test_points_beyond_float32_are_refused(recipe: Path, tmp_path: Path, layout: str) -> None:
    with pytest.raises(LidarsimError, match=r"frame 0 .*: (xyz|x): expected numbers that float32 can hold, got "):
        make(recipe, tmp_path / "out", far, layout)
