"""Recipes: what they accept, what they refuse, and that each value is drawn by its own name."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

import lidarsim as ls
from lidarsim.datasets.recipe import load
from lidarsim.errors import ConfigError


def radius(path: Path, sequence: int, *overrides: str) -> float:
    shape = load(path, overrides).source.run(sequence).scene.objects[1].shape
    return float(shape.cast([[12.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]).t[0])  # from the center on


def test_values_are_drawn_anew_for_each_sequence(recipe: Path) -> None:
    radii = [radius(recipe, sequence) for sequence in range(3)]
    assert len(set(radii)) == 3
    assert all(1 <= value <= 2 for value in radii)


def test_adding_a_draw_leaves_the_others(recipe: Path) -> None:
    more = 'vary={"pose.position_m.2": {normal: [1, 0.1]}, "scene.1.radius_m": {uniform: [1, 2]}}'
    assert [radius(recipe, k, more) for k in range(3)] == [radius(recipe, k) for k in range(3)]
    assert [radius(recipe, k, "seed=8") for k in range(3)] != [radius(recipe, k) for k in range(3)]


def test_one_draw_can_be_set(recipe: Path) -> None:
    others = load(recipe).source.to_dict()["vary"]
    assert load(recipe, ["vary.scene.1.radius_m={uniform: [3, 4]}"]).source.to_dict()["vary"] == others | {
        "scene.1.radius_m": {"uniform": [3, 4]}
    }
    with pytest.raises(ConfigError, match=r"^--set vary\.scene\.1\.radius_m=3: expected a mapping with keys uniform,"):
        load(recipe, ["vary.scene.1.radius_m=3"])


def test_values_by_frame_change_within_a_sequence(recipe: Path) -> None:
    source = load(recipe).source
    sigmas = [source.run(1, frame).lidar.measurement.range_sigma for frame in range(4)]
    assert source.by_frame
    assert len(set(sigmas)) == 4
    assert len({id(source.run(1, frame).scene.objects[1].label) for frame in range(4)}) == 1


def test_a_preset_can_be_chosen(recipe: Path) -> None:
    vary = "vary={sensor.preset: {choice: [velodyne-vlp16, ouster-os1-64]}}"
    source = load(recipe, ["run.sensor={preset: velodyne-vlp16}", vary]).source
    names = {source.run(sequence).lidar.name for sequence in range(20)}
    assert names == {"velodyne-vlp16", "ouster-os1-64"}


def test_the_seed_of_the_noise_is_another_in_each_sequence(recipe: Path) -> None:
    source = load(recipe).source
    assert len({source.run(sequence).seed for sequence in range(3)}) == 3
    assert source.run(1, 0).seed == source.run(1, 3).seed


def test_shards_hold_each_frame_once(recipe: Path) -> None:
    made = load(recipe)
    parts = [(sequence, frames) for shard in range(made.shards) for sequence, frames in made.shard(shard)]
    found = [(sequence, frame) for sequence, frames in parts for frame in frames]
    assert found == [(sequence, frame) for sequence in range(3) for frame in range(4)]
    assert made.shards == 3
    assert all(frames for _, frames in parts)
    assert [list(made.shard(shard)) for shard in (1, 2)] == [
        [(1, range(1, 4)), (2, range(2))],
        [(2, range(2, 4))],
    ]


def test_a_million_frames_are_few_shards(recipe: Path) -> None:
    made = load(recipe, ["sequences=1000000", "frames=1", "shard_frames=null"])
    assert made.shards <= 100_000
    big = load(
        recipe, ["run.sensor={preset: ouster-os1-128}", "vary={}", "sequences=1000", "frames=1000", "shard_frames=null"]
    )
    assert 10 <= big.shard_frames <= 1000


def test_the_resolved_recipe_makes_the_same(recipe: Path, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    run = yaml.safe_load(recipe.read_text())["run"]
    (tmp_path / "runs" / "scene.yaml").write_text(yaml.safe_dump(run.pop("scene")))
    (tmp_path / "runs" / "run.yaml").write_text(yaml.safe_dump({**run, "scene": {"file": "scene.yaml"}}))
    here = tmp_path / "here.yaml"
    here.write_text(yaml.safe_dump({**yaml.safe_load(recipe.read_text()), "run": {"file": "runs/run.yaml"}}))
    resolved = tmp_path / "resolved.yaml"
    resolved.write_text(yaml.safe_dump(load(here).to_dict()))
    again = load(resolved)
    assert again.to_dict() == load(here).to_dict() == load(recipe).to_dict()
    for sequence in range(3):
        scans = [load(path).source.run(sequence, 2).scan(2) for path in (recipe, resolved)]
        np.testing.assert_array_equal(scans[0].range, scans[1].range)


def test_class_names_are_those_of_the_scene_and_of_the_recipe_over_them(recipe: Path) -> None:
    assert load(recipe, ["run.class_names={7: bin, 40: street}"]).class_names == {7: "bin", 40: "road"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("sequence=3", r"unknown key; did you mean sequences"),
        ("frames=0", r"--set frames=0: expected a value >= 1, got 0"),
        ("layout=tum", r"layout"),
        ("layout={type: shards, colour: red}", r"unknown key"),
        ("class_names={car: 1}", r"expected text"),
        ("class_names={car: auto}", r"expected a label"),
        ("vary={scene.1.radius_m: {uniform: [2, 1]}}", r"expected \[least, greatest\], got \[2"),
        ("vary={scene.1.radius_m: {uniform: [1]}}", r"expected at least 2 items"),
        ("vary={scene.1.radius_m: {log_uniform: [0, 1]}}", r"expected positive numbers"),
        ("vary={scene.1.radius_m: {normal: [1, -1]}}", r"sigma >= 0"),
        ("vary={scene.1.radius_m: {choice: [1, 2], weights: [1]}}", r"expected 2, one per choice, got 1"),
        ("vary={scene.1.radius_m: {choice: [1, 2], weights: [0, 1]}}", r"expected positive numbers"),
        ("vary={scene.1.radius_m: {uniform: [1, 2], weights: [1]}}", r"expected none without choice"),
        ("vary={scene.1.radius_m: {uniform: [1, 2], normal: [1, 2]}}", r"expected one of .*got uniform and normal"),
        ("vary={scene.1.radius_m: {per: frame}}", r"got none of them"),
        ("vary={scene.1.radius_m: {uniform: [-2, -1]}}", r"radius_m: expected .* got -1\.\d+"),
        ("vary={scene.1.radios_m: {uniform: [1, 2]}}", r"unknown key; did you mean radius_m"),
        ("vary={scene.7.radius_m: {uniform: [1, 2]}}", r"expected an index below 2, got '7'"),
        ("run.cloud={frame: world}", r"cloud.frame: expected sensor"),
        ("run.pose=[{time_s: 0}, {time_s: 0.1}]", r"trajectory"),
        *(
            (f"vary={{{key}: {{choice: [1, 2]}}}}", f"vary.{key}: expected no draw, since .*: use {told}")
            for key, told in {
                "seed": "the recipe's own key seed",
                "frames": "the recipe's own key frames",
                "class_names.5": "the recipe's own key class_names",
                "cloud.frame": r"run\.cloud",
            }.items()
        ),
        ("run.frames=7", r"^--set run\.frames=7: .*expected none, got 7: use the recipe's own key frames"),
        ("run.seed=5", r"^--set run\.seed=5: .*expected none, got 5: use the recipe's own key seed"),
        ("run.cloud.deskew_s=1e12", r"cloud\.deskew_s: expected a time from -1e\+09 to 1e\+09 s, got 1e\+12$"),
        ("run.scene.0.label=65536", r"recipe\.yaml:\d+: run\.scene: expected labels from 0 to 65535 in semantick"),
        ("class_names={65536: sky}", r"^--set class_names={65536: sky}: expected labels from 0 to 65535 in semantick"),
    ],
)  # fmt: skip
def test_mistakes_are_named(recipe: Path, change: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load(recipe, [change])


def test_an_error_in_a_draw_names_file_and_line(recipe: Path) -> None:
    recipe.write_text(recipe.read_text().replace("{uniform: [1, 2]}", "{uniform: [-3, -2]}"))
    with pytest.raises(ConfigError, match=r"recipe\.yaml:8: scene\.1\.radius_m: "):
        load(recipe)


def test_without_a_run(recipe: Path) -> None:
    recipe.write_text("layout: bags\n")
    with pytest.raises(ConfigError, match="missing key 'run'"):
        load(recipe)


def test_a_function_has_a_generator_of_its_own_a_sequence() -> None:
    from lidarsim.datasets.layouts import layout_of
    from lidarsim.datasets.recipe import from_function

    drawn = {}

    def scenes(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Lidar, None]:
        drawn.setdefault(sequence, []).append(rng.uniform())
        return ls.Scene(), ls.Lidar.preset("velodyne-vlp16"), None

    settings = {"sequences": 3, "frames": 2, "seed": 1, "layout": layout_of("shards"), "shard_frames": None}
    made = from_function(scenes, {}, **settings)
    for sequence in (2, 0, 1, 2):
        made.source.run(sequence)
    assert {key: len(set(values)) for key, values in drawn.items()} == {0: 1, 1: 1, 2: 1}
    assert len({values[0] for values in drawn.values()}) == 3


@pytest.mark.parametrize(
    ("result", "message"),
    [(None, "expected it to return"), ((1, 2, 3), "a Scene and a Lidar or a Rig first, got int, int")],
)
def test_a_function_that_returns_something_else(result: object, message: str, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=message):
        ls.generate(lambda rng, sequence: result, tmp_path)  # type: ignore[arg-type, return-value] # noqa: ARG005


RECIPES = sorted((Path(__file__).parents[2] / "configs" / "recipes").glob("*.yaml"))


@pytest.mark.slow("packaged recipes make data sets")
@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_the_recipes_that_come_along(path: Path, tmp_path: Path, slow: bool) -> None:
    """One sequence; more draws of each if thorough tests are asked for."""
    sequences = 10 if slow else 1
    small = [f"sequences={sequences}", "frames=1", "layout=semantickitti"]
    made = ls.generate(path, tmp_path / "out", overrides=small, pictures=0)
    assert made.frames == sequences
    assert made.points > 10_000
    labels = [np.unique(np.fromfile(file, np.uint32) & 0xFFFF) for file in sorted(tmp_path.rglob("*.label"))]
    assert set(np.concatenate(labels)) <= set(load(path).class_names)


def test_there_are_recipes() -> None:
    assert len(RECIPES) == 6


@pytest.mark.slow("packaged recipes make data sets")
def test_the_recipe_for_a_detector(tmp_path: Path) -> None:
    path = next(path for path in RECIPES if path.stem == "detection")
    ls.generate(path, tmp_path / "out", sequences=4, frames=1, pictures=0)
    sets = {file.stem: file.read_text().split() for file in (tmp_path / "out/ImageSets").iterdir()}
    assert {name: len(numbers) for name, numbers in sets.items()} == {"train": 3, "val": 1, "trainval": 4, "test": 0}
    lines = [line for file in (tmp_path / "out").rglob("label_2/*.txt") for line in file.read_text().splitlines()]
    names = [line.split()[0] for line in lines]
    assert {"Car", "Cyclist", "Pedestrian"} <= {*names} <= {"Car", "Truck", "Cyclist", "Pedestrian"}
    assert min(names.count(name) for name in ("Car", "Pedestrian")) > 4


STREET = Path(__file__).parents[2] / "configs" / "recipes" / "street.yaml"


def test_the_road_of_the_street_does_not_end() -> None:
    """Of KITTI's points, 10.5 % are beyond 20 m; a smooth road, seen with a hard edge, ended there."""
    source = load(STREET).source
    ranges, labels = [], []
    for sequence in range(3):
        (scans,) = dataclasses.replace(source.run(sequence), frames=range(20, 21)).scans()
        cloud = scans["roof"].point_cloud()
        ranges.append(np.linalg.norm(cloud.xyz, axis=1))
        labels.append(cloud.label)
    far = np.concatenate(ranges)
    assert 0.085 < np.mean(far > 20) < 0.125
    road = np.histogram(far[np.concatenate(labels) == 8], [15, 20, 25, 30, 35, 50])[0]
    assert (road > 50).all()
    assert (np.diff(road / [5, 5, 5, 5, 15]) < 0).all()


def test_the_street_is_made_of_materials_of_the_library() -> None:
    scene = yaml.safe_load((STREET.parents[1] / "scenes" / "street.yaml").read_text(encoding="utf-8"))["scene"]
    assert len(scene) > 40
    assert [item["name"] for item in scene if "material" not in item] == ["lamp", "advertising pillar"]
    groups = yaml.safe_load(STREET.read_text(encoding="utf-8"))["scatter"].values()
    assert all("material" in item for group in groups for item in group["objects"])


def test_materials_may_be_drawn(recipe: Path) -> None:
    drawn = 'vary={"scene.1.material": {choice: [asphalt, grass]}}'
    found = [load(recipe, [drawn]).source.run(k).scene.objects[1].material for k in range(8)]
    assert {material.roughness for material in found} == {0.0, ls.materials.ASPHALT.roughness}
    with pytest.raises(ConfigError, match=r"material: expected the name of a material, got 'gras'; did you mean grass"):
        load(recipe, [drawn.replace("grass", "gras")]).source.run(0)


def test_the_file_of_a_run_may_have_a_seed_and_frames(recipe: Path, tmp_path: Path) -> None:
    """Those of the recipe hold, and the resolved recipe has no others."""
    run = yaml.safe_load(recipe.read_text())["run"]
    (tmp_path / "run.yaml").write_text(yaml.safe_dump({**run, "seed": 5, "frames": 7}))
    made = load(recipe, [f"run={{file: {tmp_path}/run.yaml}}"])
    assert len(made.source.run(0).frames) == made.frames == 4
    (tmp_path / "again.yaml").write_text(made.text())
    assert load(tmp_path / "again.yaml").text() == made.text()
    assert made.to_dict() == load(recipe).to_dict()


def test_a_recipe_has_no_strips_or_stations(recipe: Path) -> None:
    with pytest.raises(ConfigError, match=r"pose: expected one pose or trajectory, got strips or stations$"):
        load(recipe, ["run.pose={stations: [{position_m: [0, 0, 1]}]}"]).source.run(0)


def test_threads_share_the_caches_of_a_recipe(recipe: Path) -> None:
    """Another thread, which makes another sequence, may replace what this one put there at any moment."""

    class Replaced(dict[int, object]):
        def __setitem__(self, sequence: int, value: object) -> None:
            super().__setitem__(sequence, value)
            self.clear()

    text = recipe.read_text().replace(", per: frame", "").replace("label: 40}", "label: 40, name: road}")
    rocks = (
        "objects: [{shape: sphere, center_m: [0, 0, 1], radius_m: 1}], on: [road], count: 5, area_m: [[5, -5], [9, 5]]"
    )
    recipe.write_text(f"{text}scatter: {{rocks: {{{rocks}}}}}\n")
    made = load(recipe)
    replaced = dataclasses.replace(made.source, runs=Replaced(), placed=Replaced())
    for sequence in (0, 1, 0):
        runs = made.source.run(sequence), replaced.run(sequence)
        assert len(runs[0].scene) == len(runs[1].scene) > 3


def test_the_packaged_recipes_have_kittis_unit() -> None:
    """Its rings, which are not those of the preset, steps of range that are lost, and scans corrected for motion."""
    preset = ls.Lidar.preset("velodyne-hdl64e-s3", noise="measured")
    for name in ("detection", "segmentation"):
        run = load(Path(name), ["scatter={}"]).source.run(0)
        assert run.lidar.measurement.range_resolution == 0.0
        assert run.lidar.measurement.range_sigma == preset.measurement.range_sigma
        apart = np.degrees(run.lidar.pattern.elevations - preset.pattern.elevations)
        assert 0.3 < np.abs(apart).max() < 1.0
        assert (run.cloud["frame"], run.cloud["deskew"]) == ("sensor", "middle")
        assert {"front", "back", "mast"} <= {item.name for item in run.scene}


def test_values_beside_the_file_of_a_scene_override_its_own(tmp_path: Path) -> None:
    """In the file or by --set, also with the file of a whole run; another file replaces a scene without one."""
    ball = "{shape: sphere, radius_m: 1, center_m: [5, 0, 0]}"
    (tmp_path / "balls.yaml").write_text(f"[{ball}, {ball}]")
    (tmp_path / "street.yaml").write_text("scene: {street: {length_m: 60}}")
    (tmp_path / "drive.yaml").write_text(
        "{scene: {street: {kind: rural, length_m: 200}}, sensor: {preset: velodyne-vlp16}}"
    )
    recipe = tmp_path / "recipe.yaml"

    def scene(run: str, *overrides: str) -> ls.Scene:
        recipe.write_text(f"{{layout: shards, run: {run}}}")
        return load(recipe, overrides).source.run(0).scene

    def extent(run: str, *overrides: str) -> float:
        return float(np.ptp(scene(run, *overrides).bounds[:, 0]))

    balls, street = (
        f"{{scene: {{file: {name}.yaml}}, sensor: {{preset: velodyne-vlp16}}}}" for name in ("balls", "street")
    )
    assert [item.shape.radius for item in scene(balls, "run.scene.1.radius_m=2")] == [1, 2]
    with pytest.raises(ConfigError, match=r"^--set run\.scene\.x\.y=2: expected an index below 2, got 'x'"):
        scene(balls, "run.scene.x.y=2")
    with pytest.raises(ConfigError, match=r"^--set run\.scene\.x\.y=2: scene\.x: unknown key"):
        scene(street, "run.scene.x.y=2")
    short = extent(street)
    assert extent(street.replace("street.yaml", "street.yaml, street: {length_m: 160}")) > short + 80
    assert extent(street, "run.scene.street.length_m=160") > short + 80
    assert extent("{file: drive.yaml}") > short + 80
    for run, *more in (
        ("{file: drive.yaml, scene: {file: street.yaml}}",),
        ("{file: drive.yaml}", f"run.scene.file={(tmp_path / 'street.yaml').as_posix()}"),
    ):
        assert extent(run, *more) == short
    assert extent("{file: drive.yaml, scene: {file: street.yaml}}", "run.scene.street.length_m=160") > short + 80
