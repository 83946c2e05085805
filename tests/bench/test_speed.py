from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim import _native
from lidarsim.bench import (
    building,
    frames,
    in_plane,
    motion,
    patterns,
    peers,
    presets,
    realistic,
    robots,
    scenes,
    speed,
)
from lidarsim.bench.exact import Truth
from lidarsim.bench.speed import Plan, interleave, judge

pytestmark = pytest.mark.slow("the bench measures every scene and peer")

PLAN = Plan(
    triangles=2000,
    shapes=60,
    columns=(32, 64),
    random=1700,
    levels=(1, 2),
    sizes=(500, 2000),
    distances=(0.0, 1e6),
    threads=(1, 2),
    rounds=2,
    seconds=0.05,
    builds=2,
    scenes=3,
    robots=8,
    memory=("city",),
    sample=50,
)
SCENES = ("city", "terrain", "scans")


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    lines: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIDARSIM_THREADS", "1")
        measured = speed.measure(PLAN, lines.append)
        assert (os.environ["LIDARSIM_THREADS"], _native.threads()) == ("1", 1)
    assert lines[0] == "city, 9,794: building"
    read: dict[str, Any] = json.loads(json.dumps(measured))
    return read


def rows(results: dict[str, Any], **wanted: Any) -> list[dict[str, Any]]:
    return [row for row in results["speed"] if all(row[key] == value for key, value in wanted.items())]


def test_every_scene_has_its_rays_and_threads(results: dict[str, Any]) -> None:
    cells = {(row["scene"], row["rays"], row["threads"]) for row in rows(results, method="lidarsim")}
    expected = {
        (scene, rays, n)
        for scene in (*SCENES, "analytic")
        for rays in ("128 × 32", "16 × 64", "random")
        for n in (1, 2)
    }
    expected |= {(f"{scene} at UTM", "128 × 32", 2) for scene in (*SCENES, "analytic")}
    assert cells == expected


def test_every_installed_method_has_its_rows(results: dict[str, Any]) -> None:
    casters, _ = peers.find_installed()
    for name, kind in casters.items():
        seen = {row["scene"] for row in rows(results, method=name)}
        meshes = {f"{scene}{where}" for scene in SCENES for where in ("", " at UTM")} if kind.meshes else set()
        assert seen == meshes | ({"analytic", "analytic at UTM"} if kind.shapes else set())
    if "Open3D" in casters:
        levels = {row["method"] for row in rows(results, scene="analytic")} - set(casters)
        assert levels == {"Open3D, icosphere 1", "Open3D, icosphere 2"}
    assert list(results["casters"]) == list(peers.CASTERS)


def test_lidarsim_is_never_wrong(results: dict[str, Any]) -> None:
    judged = [row for row in results["speed"] + results["growth"] if row["method"] == "lidarsim"]
    assert len(judged) == 30
    for row in judged:
        error = row["error"]
        assert error["hits"] >= 15
        assert (error["lost"], error["invented"], error["other"]) == (0, 0, 0)
        assert error["max_ulp"] <= 0.5


def test_ratios_are_to_open3d(results: dict[str, Any]) -> None:
    if "Open3D" not in peers.find_installed()[0]:
        assert all(row["ratio"] is None for row in results["speed"])
        return
    cells: dict[Any, list[dict[str, Any]]] = {}
    for row in results["speed"]:
        cells.setdefault((row["scene"], row["rays"], row["threads"]), []).append(row)
    for cell in cells.values():
        (reference,) = [row for row in cell if row["reference"]]
        assert reference["method"].startswith("Open3D")
        for row in cell:
            assert row["ratio"] == pytest.approx(row["mrays"] / reference["mrays"])


def test_far_from_the_origin_only_float32_loses_the_range(results: dict[str, Any]) -> None:
    worst = {(row["method"], row["distance"]): row["error"]["max_mm"] for row in results["distance"]}
    assert worst["lidarsim", 0.0] < 1e-9
    assert worst["lidarsim", 1e6] < 1e-9
    if ("Open3D", 1e6) in worst:  # whose spacing there is 62 mm
        assert worst["Open3D", 1e6] > 10 > worst["Open3D", 0.0]


def test_growth_builds_and_memory(results: dict[str, Any]) -> None:
    sizes = [row["triangles"] for row in results["growth"] if row["method"] == "lidarsim"]
    assert sizes == [512, 2048]
    built = {(row["scene"], row["method"]): row for row in results["builds"]}
    assert {scene for scene, _ in built} == {*SCENES, "analytic"}
    for (scene, method), row in built.items():
        assert row["seconds"] > 0
        assert (row["resident"] is not None) == (scene == "city" and Path("/proc/self/statm").exists())
        assert (row["counted"] is not None) == (method == "lidarsim" and scene != "analytic")


def test_whole_scans_are_over_the_bare_cast(results: dict[str, Any]) -> None:
    scan = results["scan"]
    assert [row["what"] for row in scan][:2] == ["Scene.cast", "Lidar.scan, range noise"]
    assert all(row["rays"] == 128 * 32 for row in scan)
    assert [row["ratio"] for row in scan] == pytest.approx([row["seconds"] / scan[0]["seconds"] for row in scan])


def test_instances_are_hit_where_the_merged_mesh_is(results: dict[str, Any]) -> None:
    rows = results["instances"]
    expected = ["lidarsim, instances", "lidarsim, one mesh", "Open3D, one mesh"]
    assert [row["what"] for row in rows] == expected[: 3 if "Open3D" in peers.find_installed()[0] else 2]
    for row in rows:
        assert row["rays"] == 128 * 32
        assert row["triangles"] == 50 * 2000 - 50 * 4  # a closed mesh of n vertices has 2n − 4
        assert row["hits"] > 0.9 * row["rays"]
        assert row["ns"] > 0
    instances, merged, *others = rows
    assert (instances["other"], instances["off_mm"]) == (0, 0.0)
    # Merged vertices are rounded, by 2 ulp of 16 m at most; along a ray at 1° to a surface it is 57 times that.
    assert merged["other"] <= 2
    assert merged["off_mm"] < 2 * 57 * np.spacing(16.0) * 1e3
    for row in others:
        assert row["off_mm"] > merged["off_mm"]


def test_coincident_surfaces_change_no_hit(results: dict[str, Any]) -> None:
    assert len(results["coincident"]) == 10
    for row in results["coincident"]:
        assert row["rays"] == 64 * 32
        assert row["hits"] > 0.8 * row["rays"]
        assert row["wrong"] == 0
        assert row["ns"] > 0


def test_what_moves_is_over_the_same_standing_still(results: dict[str, Any]) -> None:
    seconds = {row["what"]: row["seconds"] for row in results["motion"]}
    assert [(row["over"], row["what"]) for row in results["motion"] if row["over"] != row["what"]] == [
        ("a still sensor, point_cloud", "a moving sensor, point_cloud"),
        ("1,000 still instances", "1,000 moving instances"),
        ("cast at what stands still", "the same with a time for each ray"),
        ("3,200 objects built anew, one ray", "one of 3,200 objects moved, one ray"),
    ]
    assert all(row["ratio"] == row["seconds"] / seconds[row["over"]] for row in results["motion"])
    assert len(seconds) == 8


def test_labelled_frames_are_over_their_scans(results: dict[str, Any]) -> None:
    rows = {row["what"]: row for row in results["frames"]}
    assert list(rows)[-4:] == [f"a labelled frame, {layout}" for layout in frames.LAYOUTS]
    assert {row["over"] for row in rows.values()} == {"Lidar.scan"}
    scan = rows["Lidar.scan"]["seconds"]
    assert all(row["ratio"] == row["seconds"] / scan for row in rows.values())
    assert all(rows[f"a labelled frame, {layout}"]["seconds"] > 0 for layout in frames.LAYOUTS)


def test_robots_are_over_one_cast_and_the_loop(results: dict[str, Any]) -> None:
    rows = {row["what"]: row for row in results["robots"]}
    cast, loop, geoms = (
        "Scene.cast of the same rays",
        "a loop of Lidar.scan",
        "scan_many, ranges, 100 geoms from one place",
    )
    peers_of_geoms = [f"{name}, the same" for name in peers.find_installed()[0] if name.startswith("MuJoCo")]
    assert {row["over"] for row in rows.values()} == {cast, loop, geoms, "scan_many, ranges"}
    assert set(peers_of_geoms) <= set(rows)
    assert all(rows[name]["over"] == geoms for name in peers_of_geoms)
    assert all(row["ratio"] == row["seconds"] / rows[row["over"]]["seconds"] for row in rows.values())


def test_new_frames_are_of_every_pattern_whose_frames_differ(results: dict[str, Any]) -> None:
    rows = {row["sensor"]: row for row in results["patterns"]}
    assert list(rows) == list(patterns.PRESETS)
    patterns_made = {row["pattern"] for row in rows.values()}
    assert patterns_made == {"Mid360", "OscillatingMirror", "Palmer", "PolygonMirror", "Risley", "Spinning"}
    for name, row in rows.items():
        made = [ls.Lidar.preset(name).pattern.pulses(frame) for frame in (1, 2)]
        assert made[0] is not made[1]
        assert row["pulses"] == pytest.approx(len(made[0]), abs=200)  # one column more or less
        assert row["ratio"] == pytest.approx(row["scan"] / row["cast"])
        assert row["make"] > 0.0


def test_sensors_are_timed_beside_open3d_on_their_own_rays(results: dict[str, Any]) -> None:
    rows = results["presets"]
    assert [(row["scene"], row["sensor"]) for row in rows] == list(itertools.product(speed.MESHES, presets.SENSORS))
    for row in rows:
        assert row["rays"] == len(ls.Lidar.preset(row["sensor"]).pattern.pulses(0))
        assert row["ratio"] == pytest.approx(row["Open3D"] / row["lidarsim"])
    ratios = np.array([row["ratio"] for row in rows])
    assert presets.mean(rows) == pytest.approx(np.exp(np.log(ratios).mean()))
    assert presets.mean([{"ratio": None}]) is None


def test_scans_of_real_sensors_are_over_clean_ones_and_beside_all_sub_rays(results: dict[str, Any]) -> None:
    rows = {row["sensor"]: row for row in results["realistic"]}
    assert list(rows) == list(realistic.SENSORS)
    assert {row["sub_rays"] for row in rows.values()} == {1, 5}
    for name, row in rows.items():
        assert row["pulses"] == len(ls.Lidar.preset(name).pattern.pulses(0))
        assert row["ratio"] == pytest.approx(row["measured"] / row["clean"])
        assert (row["Open3D"] is None) == (row["sub_rays"] == 1)
        if row["Open3D"] is not None:
            assert row["over_open3d"] == pytest.approx(row["Open3D"] / row["measured"])


def test_sub_rays_lie_within_the_beam() -> None:
    world = scenes.city(1000)
    lidar = ls.Lidar.preset("ouster-os1-128", noise="measured")
    beam, pulses = lidar.measurement.beam, lidar.pattern.pulses(0)
    assert beam is not None
    rays = realistic.sub_rays(lidar, beam, world)
    assert len(rays) == beam.rays * len(pulses)
    each = rays.directions.reshape(-1, beam.rays, 3)
    assert np.allclose(each[:, 0], pulses.directions, rtol=0.0, atol=1e-15)
    apart = np.linalg.norm(np.cross(each, each[:, :1]), axis=2)
    assert (apart[:, 1:] > 0.0).all()
    assert (apart < beam.divergence_azimuth / 2.0).all()
    assert np.array_equal(rays.origins[:: beam.rays], pulses.origins + world.sensor)


def test_rays_of_sensors_start_where_their_beams_do() -> None:
    world = scenes.city(1000)
    found = {name: presets.rays(name, world) for name in presets.SENSORS}
    starts = {name: len(np.unique(rays.origins, axis=0)) for name, rays in found.items()}
    assert {name for name, count in starts.items() if count == 1} == {
        name for name, rays in found.items() if rays.one_origin
    }
    assert starts["ouster-os1-128"] == 1024
    assert starts["velodyne-vlp16"] == len(found["velodyne-vlp16"])
    assert all(np.abs(rays.origins - world.sensor).max() < 0.3 for rays in found.values())


def test_robots_cast_the_rays_that_they_scan_with() -> None:
    calls = {name: call() for name, (_, call) in robots.calls((), 1, 3).items() if "geoms" not in name}
    hits = calls["Scene.cast of the same rays"]
    assert len(hits) == 3 * 360
    assert 0.4 < hits.hit.mean() < 1.0
    scene, places = robots.world(), robots.poses(3, 0)
    assert sum(len(item.shape) for item in scene if isinstance(item.shape, ls.TriangleMesh)) > 100_000
    lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-np.pi, np.pi, 360), [0.0], rate=20.0))
    cast = scene.cast(*robots._rays(lidar, places)).object_id.reshape(3, 360)
    batch = lidar.scan_many(scene, places, fields=["object_id"])
    assert (batch.object_id == cast).mean() > 0.999  # the poses are made orthonormal once more, which is a rounding
    assert len({row.tobytes() for row in robots.poses(3, 1)} & {row.tobytes() for row in places}) == 0


def test_rays_in_planes_are_timed_over_rays_above(results: dict[str, Any]) -> None:
    assert [row["what"] for row in results["in_plane"]] == list(in_plane.worlds())
    assert all(row["in_plane"] > 0.0 and row["next"] > 0.0 for row in results["in_plane"])


def test_rays_in_planes_lie_in_them() -> None:
    hits = {name: call() for name, call in in_plane.calls().items()}
    found = {name: int(hit.hit.sum()) for name, hit in hits.items() if "; above" not in name}
    tilted = {name for name in found if "tilt" in name}
    assert len(tilted) == 10
    assert all(in_plane.RAYS / 3 < found[name] < in_plane.RAYS for name in tilted)
    assert {name for name, count in found.items() if count} - tilted == {
        "box; in the plane",
        "height field with flat parts; in the plane",
        "height field with flat parts; next to it",
    }
    assert found["box; in the plane"] == in_plane.RAYS
    low, high = in_plane.rays(0.0), in_plane.rays(in_plane.TINY)
    assert not low[1][:, 2].any()
    assert (low[1] == high[1]).all()
    assert (high[0][:, 2] > low[0][:, 2]).all()


def test_what_is_moved_is_not_built_anew() -> None:
    """What is timed there finds what it has to."""
    scene = motion.instances(3, moving=False)
    calls = motion.calls(scene, np.array([0.0, 0.0, 5.0]), scenes.spinning(4, 32, 0.5))
    still, timed = (calls[name][1]() for name in ("cast at what stands still", "the same with a time for each ray"))
    assert 20 < still.hit.sum() < 128
    assert np.array_equal(still.t, timed.t)
    # The middle one is moved to the origin, and upwards at each call, above those that were there.
    built, moved = (calls[name][1]() for name in calls if "3,200" in name)
    # The top of the sphere, the step and the range: fewer than 8 roundings of numbers below 16.
    assert built.t[0] > moved.t[0] == pytest.approx(9.0 - 1.0 - 0.001, abs=8 * 2.0**-50)


def test_scenes_are_built_and_scanned_whole(results: dict[str, Any]) -> None:
    assert [(row["threads"], row["what"]) for row in results["scenes"]] == [
        (threads, what) for threads in (1, 2) for what in ("scan", "scan and point_cloud")
    ]
    pulses = ls.Lidar.preset(building.SENSOR).pattern.pulses()
    assert len(np.unique(pulses.ring)) == 32
    for row in results["scenes"]:
        assert (row["scenes"], row["objects"], row["rays"]) == (3, 50, len(pulses))
        assert row["build"] > 0
        assert row["share"] == row["build"] / (row["build"] + row["scan"])
    first, second = (building._build(building._draw(seed)) for seed in (0, 1))
    kinds = [type(item.shape).__name__ for item in first]
    assert {kind: kinds.count(kind) for kind in kinds} == {
        "Plane": 1,
        "Sphere": 13,
        "Box": 13,
        "Cylinder": 12,
        "Ellipsoid": 12,
    }
    assert sum(item.transform is not None for item in first) == 17
    assert not np.array_equal(first.bounds, second.bounds)


def test_lines_of_sight_are_where_hits_are(results: dict[str, Any]) -> None:
    assert [row["rays"] for row in results["sight"]] == ["128 × 32", "random"]
    for row in results["sight"]:
        assert row["hits"] > 1000
        assert row["wrong"] == 0
        assert row["ratio"] == pytest.approx(row["cast"] / row["occluded"])


def test_threads_are_compared_with_one(results: dict[str, Any]) -> None:
    rows = results["scaling"]
    assert [(row["scene"], row["threads"]) for row in rows] == [(s, n) for s in speed.MESHES for n in (1, 2)]
    for one, two in zip(rows[::2], rows[1::2], strict=True):
        assert one["ratio"] == 1.0
        assert two["ratio"] == pytest.approx(two["mrays"] / one["mrays"])


def test_growth_of_a_process_is_of_the_order_of_the_core_count() -> None:
    world = scenes.terrain(200_000)
    resident = speed._resident("lidarsim", world)
    if resident is None:
        pytest.skip("no /proc on this system")
    caster = peers.Lidarsim(world, 1)
    caster.cast(caster.prepare(scenes.lidar(world, 1, 1, 0.0)), 1)
    counted = caster.bytes() / world.triangles
    assert 0.8 * counted < resident < 1.5 * counted


def test_calls_take_turns() -> None:
    order: list[str] = []
    interleave({name: lambda name=name: order.append(name) for name in "abc"}, rounds=3, seconds=1.0)  # type: ignore[misc]
    assert "".join(order) == "abcabcabc"


def test_the_median_counts_and_the_slow_sit_out() -> None:
    clock = [0.0]

    def taking(*durations: float) -> Callable[[], None]:
        left = list(durations)

        def call() -> None:
            clock[0] += left.pop(0)

        return call

    calls = {"a": taking(1, 9, 2), "b": taking(4, 7), "c": taking(1, 2, 1, 3, 1)}
    times = interleave(calls, rounds=5, seconds=10.5, clock=lambda: clock[0])
    assert times == {"a": 2, "b": 5.5, "c": 1}


def test_judge_counts_and_measures() -> None:
    root = Fraction(math.isqrt(2 << 400), 1 << 200)  # √2 to 200 bits
    truth = Truth(
        t=[Fraction(2), Fraction(3), None, Fraction(1, 3), root, None],
        surface=np.array([0, 1, -1, 0, 5, -1]),
        telling=np.array([True, True, False, False, True, False]),
    )
    t = np.array([2.0, math.inf, math.inf, 1 / 3 + 2**-50, math.sqrt(2), 7.0])
    error = judge(truth, (t, np.array([0, -1, -1, 0, 4, 2])))
    assert (error.rays, error.hits, error.lost, error.invented, error.other) == (6, 4, 1, 1, 1)
    third = abs(Fraction(1 / 3 + 2**-50) - Fraction(1, 3)) / Fraction(math.ulp(1 / 3))
    assert error.max_ulp == pytest.approx(float(third), rel=1e-12)
    assert error.max_mm == pytest.approx(9.6673e-14, rel=1e-4)  # float(√2) is 1.41421356237309514547, √2 …504880
    assert error.median_mm == pytest.approx(error.max_mm / 2)
    assert judge(truth, (t, None)).other is None


def test_judge_of_nothing_found() -> None:
    truth = Truth([None, Fraction(1)], np.array([-1, 0]), np.array([False, True]))
    error = judge(truth, (np.array([math.inf, math.inf]), None))
    assert (error.lost, error.median_mm, error.p99_mm, error.max_mm, error.max_ulp) == (1, None, None, None, None)


def test_quick_plan_has_all_that_the_full_one_has() -> None:
    assert (speed.QUICK.triangles, speed.QUICK.shapes, speed.QUICK.columns) == (None, 400, (1024, 1800))
    assert len(speed.QUICK.levels) == len(speed.FULL.levels) == 5
    assert (min(speed.FULL.sizes), max(speed.FULL.sizes)) == (10_000, 10_000_000)
    assert speed.QUICK.threads == speed.FULL.threads == (1, 2)


def test_command_line_reports_an_earlier_run(
    results: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    earlier = tmp_path / "earlier.json"
    earlier.write_text(json.dumps(results), encoding="utf-8")
    assert speed.main(["--from", str(earlier), "-o", str(tmp_path / "out")]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("speed.json", "speed.md", "speed.png", "growth.png", "distance.png"),
        *("speed.svg", "growth.svg", "distance.svg"),
    }
    assert "lidarsim against exact arithmetic: 0 wrong of" in capsys.readouterr().out


def test_command_line_measures(
    results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plans: list[Plan] = []
    written: list[tuple[dict[str, Any], Path]] = []
    monkeypatch.setattr(speed, "measure", lambda plan, _: plans.append(plan) or results)
    monkeypatch.setattr(speed.report, "write", lambda *arguments: written.append(arguments))
    assert speed.main(["--quick", "-o", str(tmp_path)]) == 0
    assert speed.main(["-o", str(tmp_path)]) == 0
    assert plans == [speed.QUICK, speed.FULL]
    assert written == [(results, tmp_path)] * 2
    assert "speed.md" in capsys.readouterr().out
