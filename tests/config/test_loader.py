"""Configurations: what they build, and what each mistake in one is answered with."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
from math import radians
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from conformance.samples import SAMPLES, Move, Sample

import lidarsim as ls
from lidarsim.cli.keys import EXAMPLES
from lidarsim.config import objects, poses, sensors
from lidarsim.config.units import argument_of
from lidarsim.errors import ConfigError
from lidarsim.lidar import preset_path

CONFIG = """\
seed: 3
frames: 2
sensor:
  name: toy
  pattern:
    type: spinning
    elevations_deg: [-10, 0, 10]
    columns: 32
    firing_times_us: 55.296
  max_range_m: 50
pose:
  position_m: [1, 2, 3]
  rotation_deg: {yaw: 90}
scene:
  - {shape: plane, name: road, normal: [0, 0, 1], label: 40, reflectivity: 0.2}
  - shape: sphere
    center_m: [1, 2, 3]
    radius_m: 0.5
"""


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def load(text: str, *overrides: str) -> object:
    Path("run.yaml").write_text(text, encoding="utf-8")
    return ls.config.load("run.yaml", overrides)


def refusal(text: str, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load(text, *overrides)
    return str(caught.value)


def test_the_model_of_a_preset_stays_under_another_name() -> None:
    scene = "scene: []\nsensor: {preset: ouster-os1-64, name: front"
    lidar = load(f"{scene}}}\n").lidar
    assert (lidar.name, lidar.model) == ("front", "ouster-os1-64")
    assert load(f"{scene}, model: hesai-x}}\n").lidar.model == "hesai-x"


def test_a_configuration_is_built() -> None:
    run = load(CONFIG)
    road, ball = run.scene.objects
    assert (road.name, road.label, road.material.reflectivity, road.transform) == ("road", 40, 0.2, None)
    assert isinstance(road.shape, ls.Plane)
    assert isinstance(ball.shape, ls.Sphere)
    assert run.lidar.name == "toy"
    assert (run.lidar.min_range, run.lidar.max_range) == (0.0, 50.0)
    assert run.lidar.pattern.elevations == pytest.approx(np.radians([-10, 0, 10]), abs=0)
    assert (run.seed, run.frames) == (3, range(2))
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    assert np.abs(run.pose - expected).max() <= np.finfo(float).eps  # cos 90° in float64


def test_units_are_converted_without_a_second_rounding() -> None:
    assert load(CONFIG).lidar.pattern.firing_times[0] == 55.296e-6


def test_rotations_turn_about_fixed_axes_x_first() -> None:
    pose = load(CONFIG, "pose.rotation_deg={roll: 90, yaw: 90}", "pose.position_m=[0, 0, 0]").pose
    assert np.abs(pose @ [0, 1, 0, 1] - [0, 0, 1, 1]).max() <= 2.0**-52  # y, rolled up to z, stays there under yaw
    assert np.abs(pose @ [0, 0, 1, 1] - [1, 0, 0, 1]).max() <= 2.0**-52  # z, rolled down to -y, yaws to x


def test_objects_are_scaled_then_turned_then_moved() -> None:
    run = load(CONFIG, "scene.1.scale=[2, 3, -4]", "scene.1.rotation_deg={yaw: 90}", "scene.1.position_m=[5, 6, 7]")
    expected = [[0, -3, 0, 5], [2, 0, 0, 6], [0, 0, -4, 7], [0, 0, 0, 1]]
    assert np.abs(run.scene.objects[1].transform - expected).max() <= 4 * 2.0**-52


def test_a_matrix_is_taken_as_it_is() -> None:
    matrix = [[1, 2, 0, 3], [0, 1, 0, 0.1], [0, 0, 1, 1e9], [0, 0, 0, 1]]
    run = load(CONFIG, f"scene.1.matrix={matrix}")
    assert np.array_equal(run.scene.objects[1].transform, matrix)


FLOOR = np.stack([*np.mgrid[-2:3, -2:3], np.full((5, 5), 2)], axis=-1).reshape(-1, 3)
SHAPES = {
    "plane": ("{normal: [0, 0, 1], distance_m: 2}", ls.Plane((0, 0, 1), 2)),
    "plane through a point": ("{shape: plane, normal: [0, 1, 1], point_m: [0, 0, 2]}", ls.Plane((0, 1, 1), 2)),
    "sphere": ("{center_m: [0, 0, 2], radius_m: 1}", ls.Sphere((0, 0, 2), 1)),
    "ellipsoid": ("{center_m: [0, 0, 3], radii_m: [1, 2, 2]}", ls.Ellipsoid((0, 0, 3), (1, 2, 2))),
    "box": ("{size_m: [2, 2, 4]}", ls.Box((2, 2, 4))),
    "cylinder": ("{start_m: [0, 0, 1], end_m: [0, 0, 5], radius_m: 1}", ls.Cylinder((0, 0, 1), (0, 0, 5), 1)),
    "open cylinder": (
        "{shape: cylinder, start_m: [-9, 0, 1], end_m: [9, 0, 1], radius_m: 0.5, capped: false}",
        ls.Cylinder((-9, 0, 1), (9, 0, 1), 0.5, capped=False),
    ),
    "capsule": ("{start_m: [0, 0, 1], end_m: [0, 0, 3], radius_m: 1}", ls.Capsule((0, 0, 1), (0, 0, 3), 1)),
    "disk": ("{center_m: [0, 0, 2], normal: [0, 1, 2], radius_m: 1}", ls.Disk((0, 0, 2), (0, 1, 2), 1)),
    "spheres": (
        "{centers_m: [[0, 0, 2], [1, 1, 3]], radii_m: [1, 0.5]}",
        ls.Spheres([(0, 0, 2), (1, 1, 3)], [1, 0.5]),
    ),
    "disks": (
        "{centers_m: [[0, 0, 2], [1, 1, 3]], normals: [[0, 1, 2], [0, 0, 1]], radii_m: 1}",
        ls.Disks([(0, 0, 2), (1, 1, 3)], [(0, 1, 2), (0, 0, 1)], 1),
    ),
    "surfels": ("{file: floor.npz, radius_m: 0.5, neighbours: 5}", ls.Disks(FLOOR, [(0, 0, 1)] * len(FLOOR), 0.5)),
    "triangle": (
        "{a_m: [-1, -1, 2], b_m: [1, -1, 2], c_m: [0, 1, 3]}",
        ls.Triangle((-1, -1, 2), (1, -1, 2), (0, 1, 3)),
    ),
    "polygon": (
        "{vertices_m: [[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]]}",
        ls.Polygon([(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)]),
    ),
    "mesh": ("{file: tetrahedron.ply}", None),
    "heightfield": (
        "{file: heights.npy, spacing_m: [1, 2], origin_m: [-1, -2]}",
        ls.TriangleMesh.from_heightfield([[2, 2, 2], [3, 3, 3], [2, 2, 2]], (1, 2), (-1, -2)),
    ),
    "raster": (
        "{file: dem.asc, window_m: [-2, -2, 2, 3]}",
        ls.TriangleMesh.from_heightfield([[2, 2, 3], [3, 3, 2], [2, 2, 4.0]], 2, (-2, -2)),
    ),
    "scene_file": ("{file: scene.glb, up: z}", None),
}


@pytest.mark.parametrize("name", SHAPES)
def test_each_shape_is_the_one_that_python_makes(name: str) -> None:
    corners = np.array([(-1, -1, 1), (1, -1, 1), (0, 1, 1), (0, 0, 4.0)])
    solid = trimesh.Trimesh(corners, [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)], process=False)
    solid.export("tetrahedron.ply")
    trimesh.Scene({"thing": solid}).export("scene.glb")
    np.save("heights.npy", np.array([[2, 2, 2], [3, 3, 3], [2, 2, 2.0]]))
    rows = "2 2 4 9\n3 3 2 9\n2 2 3 9\n"
    Path("dem.asc").write_text(f"ncols 4\nnrows 3\nxllcorner -3\nyllcorner -3\ncellsize 2\n{rows}", encoding="ascii")
    ls.PointCloud(xyz=FLOOR.astype(float)).save("floor.npz")
    values, expected = SHAPES[name]
    text = values if "shape:" in values else values.replace("{", f"{{shape: {name}, ", 1)
    run = load(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{text}]")
    if expected is None:
        expected = ls.TriangleMesh(corners, solid.faces)
    rng = np.random.default_rng(1)
    origins = rng.uniform((-3, -3, 6), (3, 3, 9), (500, 3))
    directions = rng.uniform((-1.5, -1.5, 0), (1.5, 1.5, 4), (500, 3)) - origins
    got, want = run.scene.cast(origins, directions), expected.cast(origins, directions)
    assert want.hit.sum() > 50
    assert np.array_equal(got.t, want.t)
    assert np.array_equal(got.normal, want.normal)


def test_surfels_have_the_labels_of_their_cloud(caplog: pytest.LogCaptureFixture) -> None:
    labels = np.arange(len(FLOOR) + 1, dtype=np.uint32)
    ls.PointCloud(xyz=np.concatenate([FLOOR[:1], FLOOR]).astype(float), label=labels).save("floor.pcd")
    start = "sensor: {preset: velodyne-vlp16}\nscene: [{shape: surfels, file: floor.pcd, neighbours: 5"
    (floor,) = load(start + "}]").scene.objects
    assert "points: 1 of 26 have no disk: 1 repeated" in caplog.text
    np.testing.assert_array_equal(floor.label, [0, *labels[2:]])
    (floor,) = load(start + ", label: 3}]").scene.objects
    assert floor.label == 3
    with pytest.raises(ConfigError, match=r"neighbours: expected an integer >= 3, got 2"):
        load(start.replace("5", "2") + "}]")
    with pytest.raises(ConfigError, match=r"radius_m: expected numbers > 0, got radii = 0.0"):
        load(start + ", radius_m: 0.0}]")
    with pytest.raises(ConfigError, match=r"file: expected more than 90 different points, got 25"):
        load(start.replace("5", "90") + "}]")


@pytest.mark.parametrize(
    "sample",
    [sample for sample in SAMPLES if sample.name in objects.SHAPES.keys() - {"mesh"}],
    ids=lambda sample: sample.name,
)
def test_each_sample_of_a_shape_is_the_same_in_yaml(sample: Sample) -> None:
    own = objects.SHAPES[sample.name].model_fields.keys() - objects.Object.model_fields.keys()
    keys = {argument_of(key): key for key in own}
    names = inspect.signature(getattr(ls, sample.kind)).parameters
    given = {name: value for name, value in zip(names, sample.arguments(Move()), strict=False) if name in keys}
    assert len(given) >= 1
    item = {"shape": sample.name} | {keys[name]: np.asarray(value).tolist() for name, value in given.items()}
    (built,) = load(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{json.dumps(item)}]").scene.objects
    assert built.shape == getattr(ls, sample.kind)(**given)


def test_every_shape_has_a_case() -> None:
    assert objects.SHAPES.keys() <= {*SHAPES, *ls.worlds.GENERATORS, *(sample.name for sample in SAMPLES)}


@pytest.mark.parametrize("name", sensors.PATTERNS)
def test_the_example_of_each_pattern_is_built(name: str) -> None:
    np.savetxt("directions.csv", np.eye(3), delimiter=",", header="x,y,z", comments="")
    run = load(yaml.safe_dump({"sensor": {"pattern": yaml.safe_load(EXAMPLES[name])}, "scene": []}))
    assert type(run.lidar.pattern) is sensors.PATTERNS[name].constructor


def test_objects_of_one_file_share_their_mesh() -> None:
    trimesh.creation.box().export("box.ply")
    first, second = load(
        "sensor: {preset: velodyne-vlp16}\nscene: [&box {shape: mesh, file: box.ply}, *box]"
    ).scene.objects
    assert first.shape is second.shape


def test_instances_of_a_scene_file_share_their_mesh() -> None:
    moved = np.eye(4)
    moved[:3, 3] = 4, 5, 6
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), node_name="one", geom_name="box")
    scene.graph.update(frame_to="two", frame_from=scene.graph.base_frame, matrix=moved, geometry="box")
    scene.export("scene.glb")
    run = load(
        "sensor: {preset: velodyne-vlp16}\n"
        "scene:\n"
        "  - {shape: scene_file, file: scene.glb, up: z, name: hall, label: 7, position_m: [1, 0, 0],"
        "     rotation_deg: {yaw: 90}}"
    )
    objects = {item.name: item for item in run.scene.objects}
    assert objects.keys() == {"hall/one", "hall/two"}
    assert objects["hall/one"].shape is objects["hall/two"].shape
    assert objects["hall/two"].label == 7
    assert objects["hall/two"].transform[:3, 3] == pytest.approx([-4, 4, 6])  # (4, 5, 6), turned, then moved


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ("", [2, 3, 4]),
        ("instance: 50,", [50, 50, 50]),
        ("instance: 50, rules: [{node: '*b', instance: node}],", [50, 3, 50]),
        ("instance: 50, rules: [{node: '*b', instance: 7}],", [50, 7, 50]),
    ],
)
def test_the_instance_of_a_scene_file_is_that_of_the_parts_without_one_by_a_rule(
    more: str, expected: list[int]
) -> None:
    faces = "".join(f"o {name}\nv 5 0 0\nv 5 1 0\nv 5 0 1\nf -3 -2 -1\n" for name in "abc")
    Path("parts.obj").write_text(faces, encoding="utf-8")
    Path("parts.xml").write_text(
        "<mujoco><worldbody>"
        + "".join(f"<body name='{name}'><geom name='{name}' size='1'/></body>" for name in "abc")
        + "</worldbody></mujoco>",
        encoding="utf-8",
    )
    for file in ("parts.obj", "parts.xml"):
        ball = "{shape: sphere, center_m: [0, 0, 9], radius_m: 1}"
        scene = f"scene: [{ball}, {{shape: scene_file, {more} file: {file}}}]"
        _, *parts = load(f"sensor: {{preset: velodyne-vlp16}}\n{scene}").scene.objects
        assert [part.instance for part in parts] == expected


def test_scene_files_of_mujoco() -> None:
    arm = '<body name="arm" pos="4 0 0"><geom type="box" size="1 2 3"/><geom size="1"/></body>'
    Path("arm.xml").write_text(f"<mujoco><worldbody><geom size='1'/>{arm}</worldbody></mujoco>", encoding="utf-8")
    item = "{shape: scene_file, file: arm.xml, name: %s, label: 7, reflectivity: 0.3, position_m: [0, %d, 0]}"
    ball = "{shape: sphere, center_m: [0, 0, 9], radius_m: 1}"
    scene = f"scene: [{ball}, {item % ('left', 5)}, {item % ('right', -5)}]"
    _, *objects = load(f"sensor: {{preset: velodyne-vlp16}}\n{scene}").scene.objects
    assert [object_.name for object_ in objects] == [
        f"{side}/{name}" for side in ("left", "right") for name in ("world/0", "arm/0", "arm/1")
    ]
    assert [object_.instance for object_ in objects] == [2, 3, 3, 5, 6, 6]
    assert {(object_.label, object_.material.reflectivity) for object_ in objects} == {(7, 0.3)}
    assert objects[1].shape == ls.Box((2, 4, 6))
    assert objects[1].shape is objects[4].shape
    assert objects[4].transform[:3, 3].tolist() == [4, -5, 0]
    Path("arm.xml").write_text("<mujoco>", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"arm\.xml:1: not well-formed XML: no element found"):
        load(f"sensor: {{preset: velodyne-vlp16}}\n{scene}")


def test_patterns_without_a_preset() -> None:
    Path("rows.csv").write_text("x,y,z\n1,0,0\n0,1,0\n", encoding="utf-8")
    grid = "{pattern: {type: grid, azimuths_deg: [-1, 0, 1], elevations_deg: [0, 1], rate_hz: 5}}"
    assert load(f"sensor: {grid}\nscene: []").lidar.pattern.shape == (2, 3)
    table = "{pattern: {type: table, file: rows.csv, rate_hz: 5, pulse_rate_khz: 1}}"
    pulses = load(f"sensor: {table}\nscene: []").lidar.pattern.pulses()
    assert pulses.directions.tolist() == [[1, 0, 0], [0, 1, 0]]
    assert pulses.time.tolist() == [0, 1e-3]


MEASUREMENT = """
    range_sigma_m: [[1, 0.01], [10, 0.02]]
    range_sigma_limit_m: 0.05
    range_bias_m: 0.1
    channel_bias_sigma_m: 0.03
    range_resolution_m: 0.004
    azimuth_sigma_deg: 0.01
    elevation_sigma_deg: 0.02
    dropout: 0.1
    detection: {reflectivity: 0.1, range_m: 90}
    power_sigma: 0.2
    crossover_m: [0.5, 3]
    receiver_offset_mm: -25
    near_threshold: 0.02
    near_range_m: 15
    response: {
      range_m: [[1, 0.5], [5, 1]], exponent: 0.5, sigma: 0.02, sigma_block: 1280, ring_sigma: 0.1,
      curve: [[0, 0], [9, 1]], resolution: 0.01, limit: 1
    }
    extinction_per_m: 0.001
    false_returns: 0.01
    beam: {divergence_azimuth_mrad: 3, divergence_elevation_mrad: 1.5, pulse_length_ns: 6, rays: 7, separation_m: 1.5}
    returns: 2
    depth: 3
"""


def test_every_effect_of_the_measurement() -> None:
    measurement = load(f"sensor:\n  preset: velodyne-vlp16\n  measurement:{MEASUREMENT}\nscene: []").lidar.measurement
    assert measurement == ls.Measurement(
        range_sigma=[(1, 0.01), (10, 0.02)],
        range_sigma_limit=0.05,
        range_bias=0.1,
        channel_bias_sigma=0.03,
        range_resolution=0.004,
        azimuth_sigma=radians(0.01),
        elevation_sigma=radians(0.02),
        dropout=0.1,
        detection=ls.Detection(reflectivity=0.1, range=90),
        power_sigma=0.2,
        crossover=(0.5, 3.0),
        receiver_offset=-0.025,
        near_threshold=0.02,
        near_range=15.0,
        response=ls.Response(
            range=[(1, 0.5), (5, 1)],
            exponent=0.5,
            sigma=0.02,
            sigma_block=1280,
            ring_sigma=0.1,
            curve=[(0, 0), (9, 1)],
            resolution=0.01,
            limit=1.0,
        ),
        extinction=0.001,
        false_returns=0.01,
        beam=ls.Beam(3e-3, 1.5e-3, pulse_length=6e-9, rays=7, separation=1.5),
        returns=2,
        depth=3,
    )
    given = yaml.safe_load(MEASUREMENT).keys()
    arguments = {field.name for field in dataclasses.fields(ls.Measurement)}
    # `range_sigma_limit` begins as `range_sigma` does.
    assert {max((name for name in arguments if key.startswith(name)), key=len) for key in given} | {
        "range_sigma_slope"
    } == arguments


def test_effects_that_cannot_be_are_refused_at_their_keys() -> None:
    for measurement, message in (
        ("{crossover_m: [3, 1]}", "measurement.crossover_m: expected 0 <= near < far, got 3.0 and 1.0"),
        ("{crossover_m: 3}", "measurement.crossover_m: "),
        ("{range_sigma_limit_m: 0.1}", "measurement.range_sigma_limit_m: expected 0 without a detection limit"),
        ("{false_returns: 2}", "measurement.false_returns: expected a finite number from 0 to 1, got 2.0"),
        (
            "{false_returns: 0.1}",
            "run.yaml:1: sensor: max_range_m: expected a finite number with false_returns, got inf",
        ),
        ("{depth: 256}", "measurement.depth: expected an integer from 1 to 255, got 256"),
        ("{beam: {divergence_azimuth_mrad: 1, separation_m: -1}}", "beam.separation_m: expected a finite number >= 0"),
    ):
        sensor = f"{{pattern: {{type: spinning, elevations_deg: [0]}}, measurement: {measurement}}}"
        with pytest.raises(ls.errors.ConfigError, match=re.escape(message)):
            load(f"sensor: {sensor}\nscene: []")


def test_errors_of_several_parts_name_the_key_and_its_line() -> None:
    sensor = "sensor:\n  preset: velodyne-vlp16\n  datasheet_noise: {range_bias_m: 0}\n  measurement:\n"
    assert refusal(f"{sensor}    range_bias_m: [0.1, 0.2]\nscene: []") == (
        "run.yaml:5: sensor.measurement.range_bias_m: expected one number, or one per ring (16), got 2"
    )


def test_range_offset_is_a_number_or_a_list() -> None:
    rings = [0.001 * ring for ring in range(16)]
    assert load(f"sensor: {{preset: velodyne-vlp16, range_offset_m: {rings}}}\nscene: []").lidar.range_offset == tuple(
        rings
    )
    assert load(f"sensor: {{file: {OUSTER}, range_offset_m: 0.028}}\nscene: []").lidar.range_offset == 0.028
    assert refusal("sensor:\n  preset: velodyne-vlp16\n  range_offset_m: [0.1]\nscene: []") == (
        "run.yaml:3: sensor.range_offset_m: expected one number, or one per ring (16), got 1"
    )


@pytest.mark.parametrize(
    ("measurement", "message"),
    [
        ("dropout: 2", "dropout: expected a finite number from 0 to 1, got 2.0"),
        ("range_sigma_m: -1", "range_sigma_m: expected a finite number >= 0, got -1.0"),
        ("range_sigma_m: [[2, 1], [1, 1]]", "range_sigma_m: expected rising ranges, got 1.0 after 2.0 in row 1"),
        ("detection: {range_m: 5}", "detection: missing key 'reflectivity'"),
        ("detection: {reflectivity: 20, range_m: 5}",
         "detection.reflectivity: expected a finite number > 0 and <= 1, got 20.0; percent?"),
        ("beam: {divergence_azimuth_mrad: -1}",
         "beam.divergence_azimuth_mrad: expected a finite number from 0 to 0.1, got -0.001 (in rad)"),
        ("beam: {divergence_azimuth_mrad: 1, rays: 8}", "beam.rays: expected 5, 7, 19, 37, 61 or 91, got 8"),
        ("returns: all", "returns: expected 'strongest', 'first', 'last', 'dual' or a number, got 'all'"),
    ],
)  # fmt: skip
def test_bad_measurement(measurement: str, message: str) -> None:
    got = refusal(f"sensor:\n  preset: velodyne-vlp16\n  measurement: {{{measurement}}}\nscene: []")
    assert got == f"run.yaml:3: sensor.measurement.{message}"


def test_reflectivity_for_each_face() -> None:
    trimesh.creation.box().export("box.ply")
    item = "{shape: mesh, file: box.ply, reflectivity: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11], reflectivity_per: face}"
    material = load(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{item}]").scene.objects[0].material
    assert material.per == "face"
    assert material.reflectivity.tolist() == list(range(12))


def test_light_that_goes_on_from_an_object() -> None:
    item = "{shape: sphere, center_m: [9, 0, 0], radius_m: 1, material: glass"
    objects = f"scene: [{item}}}, {item}, transmission: 0.5}}, {item}, mirror: 0.2, reflectivity: 0.3}}]"
    materials = [item.material for item in load(f"sensor: {{preset: velodyne-vlp16}}\n{objects}").scene]
    assert materials == [
        ls.materials.GLASS,
        ls.Material(reflectivity=0.01, transmission=0.5, mirror=0.07),
        ls.Material(reflectivity=0.3, transmission=0.77, mirror=0.2),
    ]
    for keys, message in (
        ("transmission: 2", "scene.1.transmission: expected a finite number from 0 to 1, got 2.0"),
        ("mirror: 0.5", "scene.1.mirror: expected at most 0.23 beside a transmission of 0.77, got 0.5"),
    ):
        with pytest.raises(ls.errors.ConfigError, match=re.escape(message)):
            load(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{item}}}, {item}, {keys}}}]")


def test_roughness_and_highlight_of_an_object() -> None:
    item = "{shape: sphere, center_m: [9, 0, 0], radius_m: 1, reflectivity: 0.2, roughness_deg: 20"
    objects = f"scene: [{item}}}, {item}, specular: 5, specular_width: 0.05}}]"
    rough, glossy = load(f"sensor: {{preset: velodyne-vlp16}}\n{objects}").scene.objects
    assert rough.material == ls.Material(reflectivity=0.2, roughness=radians(20.0))
    assert glossy.material == ls.Material(reflectivity=0.2, roughness=radians(20), specular=5, specular_width=0.05)
    with pytest.raises(
        ls.errors.ConfigError, match=r"scene\.1\.specular_width: expected a finite number > 0, got 0\.0"
    ):
        load(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{item}}}, {item}, specular_width: 0}}]")


def test_a_sensor_that_moves() -> None:
    run = load(CONFIG, "pose.linear_m_per_s=[4, 0, 0]", "pose.angular_deg_per_s=[0, 0, 90]")
    expected = ls.Trajectory.from_twist(load(CONFIG).pose, (4, 0, 0), (0, 0, radians(90)))
    assert np.array_equal(run.pose.at(0.3).as_matrix(), expected.at(0.3).as_matrix())
    scan = run.scan(1)
    assert scan.time == 0.1
    again = run.lidar.scan(run.scene, expected, time=0.1, frame=1, seed=3)
    assert np.array_equal(scan.range, again.range, equal_nan=True)


def test_a_sensor_on_a_trajectory() -> None:
    run = load(CONFIG, "pose=[{time_s: 0}, {time_s: 2, position_m: [4, 0, 0], rotation_deg: {yaw: 90}}]")
    assert run.pose.at(1).translation.tolist() == [2, 0, 0]
    assert run.pose.at(1).rotation.as_euler("ZYX", degrees=True) == pytest.approx([45, 0, 0])
    assert refusal(CONFIG, "pose=[{time_s: 1}, {time_s: 1}]") == (
        "--set pose=[{time_s: 1}, {time_s: 1}]: times: expected rising times, got times[1] = 1.0 after 1.0"
    )
    assert refusal(CONFIG, "pose=[{position_m: [0, 0, 0]}]").endswith("pose.0: missing key 'time_s'")


TUM = "".join(f"{t} {2 * t * t} 0 1 0 0 0 1\n" for t in range(4))


def test_poses_from_a_file() -> None:
    Path("runs").mkdir()
    Path("runs/drive.tum").write_text(TUM, encoding="utf-8")
    Path("run.yaml").write_text(CONFIG, encoding="utf-8")
    drive = ls.Trajectory.load("runs/drive.tum")
    assert load(CONFIG, "pose={file: runs/drive.tum}").pose.at(0.5).translation.tolist() == [1, 0, 1]
    curved = load(CONFIG, "pose={file: runs/drive.tum, interpolation: spline}").pose
    expected = ls.Trajectory(drive.times, drive.poses, interpolation="spline")
    assert np.array_equal(curved.at(0.5).as_matrix(), expected.at(0.5).as_matrix())
    assert curved.at(0.5).translation[0] == pytest.approx(0.5, rel=0, abs=16 * 2.0**-53)  # 2t², which a cubic can be
    drive.save("runs/drive.kitti")
    Path("runs/times.txt").write_text("0\n1\n2\n3\n", encoding="utf-8")
    timed = load(CONFIG, "pose={file: runs/drive.kitti, times: runs/times.txt}").pose
    assert np.array_equal(timed.poses.as_matrix(), drive.poses.as_matrix())
    # Paths are relative to the file that they stand in.
    Path("runs/run.yaml").write_text(CONFIG.replace("pose:", "pose: {file: drive.tum}\nnothing:"), encoding="utf-8")
    text = Path("runs/run.yaml").read_text(encoding="utf-8")
    Path("runs/run.yaml").write_text(re.sub(r"nothing:\n(  .*\n)+", "", text), encoding="utf-8")
    assert ls.config.load("runs/run.yaml").pose.span == (0.0, 3.0)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ("{file: gone.tum}", "pose.file: cannot read gone.tum: No such file or directory"),
        ("{file: bad.tum}", "bad.tum:2: expected 8 numbers, got 2"),
        ("{file: drive.kitti}", "times: expected those of drive.kitti, since KITTI has none of its own, got none"),
        ("{file: drive.kitti, times: gone.txt}", "pose.times: cannot read gone.txt: No such file or directory"),
        (
            "{file: drive.kitti, times: bad.tum}",
            "bad.tum:1: expected 1 number, got 8",
        ),
        (
            "{file: drive.kitti, interpolation: cubic}",
            "pose.interpolation: expected 'linear' or 'spline', got 'cubic'",
        ),
        ("{file: 5}", "pose.file: expected text, got 5"),
        (
            "{file: drive.kitti, color: red}",
            "pose.color: unknown key; expected one of "
            + ", ".join(poses.TrajectoryFile.model_fields),
        ),
    ],
)  # fmt: skip
def test_bad_files_of_poses(pose: str, message: str) -> None:
    Path("bad.tum").write_text(TUM.splitlines()[0] + "\n1 2\n", encoding="utf-8")
    Path("drive.kitti").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n", encoding="utf-8")
    assert refusal(CONFIG, f"pose={pose}") == f"--set pose={pose}: {message}"


RIG = """\
seed: 5
frames: 3
rig:
  top:
    sensor: {preset: velodyne-vlp16, noise: datasheet}
    position_m: [1, 0, 2]
  left:
    sensor: {preset: velodyne-vlp16, name: port, max_range_m: 60}
    position_m: [0.5, 0.8, 1]
    rotation_deg: {yaw: 90}
    offset_s: 0.05
pose: {linear_m_per_s: [8, 0, 0]}
scene:
  - {shape: plane, normal: [0, 0, 1], label: 40}
  - {shape: box, size_m: [100, 1, 6], center_m: [0, 9, 3]}
"""


def test_a_rig() -> None:
    run = load(RIG)
    assert (list(run.sensor), run.rate, run.frames, run.time(2)) == (["top", "left"], 10.0, range(3), 0.2)
    top, left = run.sensor.values()
    assert (top.mount[:3, 3].tolist(), top.offset, left.offset) == ([1, 0, 2], 0.0, 0.05)
    assert np.abs(left.mount[:3, 0] - [0, 1, 0]).max() <= 2.0**-52
    assert (top.lidar.measurement.channel_bias_sigma, left.lidar.max_range) == (0.0173, 60.0)
    assert (top.lidar.name, left.lidar.name) == ("top", "left")
    frames = list(run.scans())
    assert [[(name, scan.frame, scan.time) for name, scan in scans.items()] for scans in frames] == [
        [("top", k, k / 10.0), ("left", k, k / 10.0 + 0.05)] for k in range(3)
    ]
    expected = next(run.sensor.frames(run.scene, run.pose, 1, first=2, seed=5))
    for name, scan in frames[2].items():
        assert np.isfinite(scan.range).sum() > 1000
        assert np.array_equal(scan.range, expected[name].range, equal_nan=True)
    for use in (lambda: run.lidar, run.scan):
        with pytest.raises(ConfigError, match=r"^rig: expected a run with one sensor, got Rig\(top, left at 10 Hz\)$"):
            use()


def test_runs_of_one_sensor_give_all_their_frames() -> None:
    run = load(CONFIG, "first_frame=4")
    frames = list(run.scans())
    assert [list(scans) for scans in frames] == [[""], [""]]
    for k, scans in enumerate(frames, start=4):
        assert np.array_equal(scans[""].range, run.scan(k).range, equal_nan=True)
    assert (run.rate, run.lidar is run.sensor) == (10.0, True)


def test_overrides_reach_into_a_rig() -> None:
    changes = [
        ("rig.left.sensor.preset=velodyne-hdl32e", lambda rig: rig["left"].lidar.pattern.shape[0], 32),
        ("rig.left.sensor.measurement.dropout=0.5", lambda rig: rig["left"].lidar.measurement.dropout, 0.5),
        ("rig.top.sensor.noise=none", lambda rig: rig["top"].lidar.measurement, ls.Measurement()),
        ("rig.top.offset_s=0.01", lambda rig: rig["top"].offset, 0.01),
        ("rig.right={sensor: {preset: velodyne-vlp16}}", lambda rig: rig["right"].lidar.max_range, 100.0),
        ("rig.right.sensor={preset: velodyne-vlp16}", lambda rig: rig["right"].mount.tolist(), np.eye(4).tolist()),
        ("rig={a: {sensor: {preset: velodyne-vlp16}}}", list, ["a"]),
    ]
    for assignment, get, expected in changes:
        assert get(load(RIG, assignment).sensor) == expected, assignment
        assert get(load(RIG, assignment, "seed=1").sensor) == expected, assignment


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed: 5", "sensor: {preset: velodyne-vlp16}", "run.yaml:3: rig: expected either sensor or rig, got both"),
        ("noise: datasheet", "noise: loud",
         "run.yaml:5: rig.top.sensor.noise: expected none, datasheet or measured, got 'loud'"),
        ("preset: velodyne-vlp16, name", "name",
         "run.yaml:8: rig.left.sensor: expected one of the keys preset, file, pattern, got none of them"),
        ("    sensor: {preset: velodyne-vlp16, noise: datasheet}\n", "",
         "run.yaml:4: rig.top: missing key 'sensor', 'imu' or 'gnss'"),
        ("offset_s: 0.05", "offset_s: late", "run.yaml:11: rig.left.offset_s: expected a number, got 'late'"),
        ("offset_s: 0.05", "offset_s: .inf", "run.yaml:11: rig.left.offset_s: expected a finite number, got inf"),
        ("offset_s: 0.05", "offset_s: -.inf", "run.yaml:11: rig.left.offset_s: expected a finite number, got -inf"),
        ("offset_s: 0.05", "offset_s: .nan", "run.yaml:11: rig.left.offset_s: expected a finite number, got nan"),
        ("  top:", "  ../top:", "run.yaml:4: rig.../top: expected a name of letters, digits, _ and -"),
        ("position_m: [1, 0, 2]", "matrix: [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
         ("run.yaml:6: rig.top.matrix: expected a rigid transform (orthonormal rotation), got one 3 away from it, "
          "determinant 2")),
        ("position_m: [1, 0, 2]", "scale: 2",
         ("run.yaml:6: rig.top.scale: unknown key; expected one of position_m, rotation_deg, matrix, sensor, "
          "imu, gnss, offset_s")),
        ("max_range_m: 60", "max_range_m: -1",
         "run.yaml:8: rig.left.sensor.max_range_m: expected a real number >= 0.5, got -1.0"),
    ],
)  # fmt: skip
def test_bad_rigs(old: str, new: str, message: str) -> None:
    assert old in RIG
    assert refusal(RIG.replace(old, new, 1)) == message


IMU = """\
    imu:
      rate_hz: 200
      gyroscope: {noise_density_deg_per_s_per_sqrt_hz: 0.005, random_walk_deg_per_s2_per_sqrt_hz: 0.001,
        range_deg_per_s: 450}
      accelerometer: {noise_density_m_per_s2_per_sqrt_hz: 0.002, bias_m_per_s2: 0.1,
        random_walk_m_per_s3_per_sqrt_hz: 0.01, misalignment_deg: 0.5}
      latitude_deg: 48
"""
WITH_IMU = RIG.replace("  top:\n", f"  box:\n    position_m: [1, 0, 2]\n{IMU}  top:\n", 1)


def test_an_imu_in_a_rig() -> None:
    run = load(WITH_IMU)
    mount = np.eye(4)
    mount[:3, 3] = 1, 0, 2
    assert run.imus == {
        "box": ls.Imu(
            200.0,
            mount=mount,
            gyroscope=ls.ImuErrors(
                noise_density=np.radians(0.005), random_walk=np.radians(0.001), range=np.radians(450.0)
            ),
            accelerometer=ls.ImuErrors(noise_density=0.002, bias=0.1, random_walk=0.01, misalignment=np.radians(0.5)),
            latitude=np.radians(48.0),
            name="box",
        )
    }
    assert "box" not in run.sensor
    assert load(WITH_IMU, "rig.box.imu.rate_hz=100").imus["box"].rate == 100.0
    assert load(RIG).imus == {}


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("rig.box.imu.rate_hz=0", "expected a finite number > 0, got 0.0"),
        ("rig.box.imu.gyroscope.bias_deg_per_s=-1", "expected a finite number >= 0, got -0.0174"),
        ("rig.box.imu.latitude_deg=91", "expected a finite number from -1.57"),
        ("rig.box.imu.range_m=5", "unknown key"),
        ("rig.box.offset_s=0.1", "expected none beside an imu"),
        ("rig.box.sensor={preset: velodyne-vlp16}", "expected none beside an imu"),
        ("rig.box.imu={}", "missing key 'rate_hz'"),
        ("rig={a: {imu: {rate_hz: 200}}}", "sensors: expected at least one Lidar, got Imu"),
    ],
)
def test_bad_imus(assignment: str, message: str) -> None:
    problem = refusal(WITH_IMU, assignment)
    assert assignment.split("=", maxsplit=1)[0] in problem
    assert message in problem


ORIGIN = "georeference={origin: {latitude_deg: 48, longitude_deg: 11}}"


def test_a_receiver_in_a_rig() -> None:
    gnss = (
        "{gnss: {rate_hz: 5, position_sigma_m: [1, 1, 2], drift_sigma_m: 3, drift_time_s: 60}, position_m: [1, 0, 2]}"
    )
    run = load(RIG, f"rig.roof={gnss}", ORIGIN)
    mount = np.eye(4)
    mount[:3, 3] = 1, 0, 2
    assert run.receivers == {
        "roof": ls.Gnss(5.0, mount=mount, position_sigma=(1, 1, 2), drift_sigma=3.0, drift_time=60.0, name="roof")
    }
    assert run.georeference == ls.Georeference(origin=(np.radians(48.0), np.radians(11.0), 0.0))
    assert "roof" not in run.sensor
    assert load(RIG).receivers == {}
    wavering = load(WITH_IMU, "rig.box.imu.gyroscope.bias_instability_deg_per_h=2").imus["box"]
    assert wavering.gyroscope.bias_instability == np.radians(2.0) / 3600
    projected = load(RIG, f"rig.roof={gnss}", "georeference={crs: EPSG:25832}").georeference
    assert projected == ls.Georeference(crs="EPSG:25832")


@pytest.mark.parametrize(
    ("roof", "message"),
    [
        ("{gnss: {rate_hz: 0}}", "rig.roof.gnss.rate_hz: expected a finite number > 0, got 0.0"),
        ("{gnss: {rate_hz: 5, position_sigma_m: -1}}", "rig.roof.gnss.position_sigma_m: expected numbers >= 0, got -1"),
        ("{gnss: {rate_hz: 5}, offset_s: 1}", "rig.roof.offset_s: expected none beside a gnss"),
        ("{gnss: {rate_hz: 5}, imu: {rate_hz: 5}}", "rig.roof.gnss: expected none beside an imu"),
        ("{gnss: {rate_hz: 5, crs: 1}}", "rig.roof.gnss.crs: unknown key"),
    ],
)
def test_bad_receivers(roof: str, message: str) -> None:
    assert message in refusal(RIG, f"rig.roof={roof}", ORIGIN)


def test_a_rig_without_sensors_and_a_run_without_either() -> None:
    assert refusal("rig: {}\nscene: []") == "run.yaml:1: rig: sensors: expected at least one, got none"
    assert refusal("rig: 5\nscene: []") == "run.yaml:1: rig: expected a mapping, got 5"
    assert refusal("scene: []") == "run.yaml:1: missing key 'sensor' or 'rig'"


def test_an_empty_scene_is_legal() -> None:
    scan = load("sensor: {preset: velodyne-vlp16}\nscene: []").scan()
    assert len(scan.status) > 1000
    assert (scan.status == ls.Status.miss).all()
    assert len(scan.point_cloud()) == 0


def test_a_sensor_without_pulses_is_legal() -> None:
    grid = "{pattern: {type: grid, azimuths_deg: [], elevations_deg: [1], rate_hz: 5}}"
    scan = load(f"sensor: {grid}\nscene: [{{shape: plane, normal: [0, 0, 1]}}]").scan()
    assert len(scan.status) == len(scan.point_cloud()) == 0


# Sensors


def test_a_preset_and_the_difference() -> None:
    sensor = "{preset: ouster-os1-64, name: mine, max_range_m: 60, pattern: {columns: 512}}"
    run, preset = load(f"sensor: {sensor}\nscene: []"), ls.Lidar.preset("ouster-os1-64")
    assert (run.lidar.name, run.lidar.max_range, run.lidar.min_range) == ("mine", 60, preset.min_range)
    assert run.lidar.pattern.columns == 512
    assert preset.pattern.columns == 1024  # what is read once is not changed by the other
    assert np.array_equal(run.lidar.pattern.elevations, preset.pattern.elevations)


def test_columns_take_the_place_of_the_period_of_a_preset_and_the_other_way_round() -> None:
    scene, preset = "\nscene: []", ls.Lidar.preset("velodyne-hdl64e-s2").pattern
    assert preset.column_period is not None
    sensor = "sensor: {preset: velodyne-hdl64e-s2"
    for run in (
        load(sensor + "}" + scene, "sensor.pattern.columns=900"),
        load(sensor + ", pattern: {columns: 900}}" + scene),
    ):
        assert (run.lidar.pattern.columns, run.lidar.pattern.column_period) == (900, None)
        assert np.array_equal(run.lidar.pattern.elevations, preset.elevations)
    slow = load("sensor: {preset: ouster-os1-64}" + scene, "sensor.pattern.column_period_us=100").lidar.pattern
    assert (slow.columns, slow.column_period, slow.shape[1]) == (None, 1e-4, 1000)
    rig = load("rig: {top: {sensor: {preset: velodyne-vlp16}}}" + scene, "rig.top.sensor.pattern.columns=900")
    assert rig.sensor["top"].lidar.pattern.columns == 900
    with pytest.raises(ls.errors.ConfigError, match="columns, column_period: expected one of them"):
        load(sensor + ", pattern: {columns: 900, column_period_us: 100}}" + scene)


def test_modes_come_under_the_difference() -> None:
    run = load("sensor: {preset: ouster-os1-64, mode: 512x20, pattern: {rate_hz: 5}}\nscene: []")
    assert (run.lidar.pattern.columns, run.lidar.pattern.rate) == (512, 5)


def test_noise_comes_under_the_difference() -> None:
    sensor = "{preset: velodyne-vlp16, noise: datasheet, measurement: {range_sigma_m: 0.5}}"
    measurement = load(f"sensor: {sensor}\nscene: []").lidar.measurement
    preset = ls.Lidar.preset("velodyne-vlp16", noise="datasheet").measurement
    assert measurement.range_sigma == 0.5
    assert measurement.range_resolution == preset.range_resolution > 0
    assert load("sensor: {preset: velodyne-vlp16, noise: none}\nscene: []").lidar.measurement == ls.Measurement()


def test_measured_noise_comes_under_the_difference() -> None:
    sensor = "{preset: velodyne-vlp32c, noise: measured, measurement: {range_sigma_m: 0.5}}"
    lidar = load(f"sensor: {sensor}\nscene: []").lidar
    preset = ls.Lidar.preset("velodyne-vlp32c", noise="measured")
    assert lidar.measurement == dataclasses.replace(preset.measurement, range_sigma=0.5)
    assert lidar.min_range == preset.min_range != ls.Lidar.preset("velodyne-vlp32c").min_range
    exact = load("sensor: {preset: velodyne-vlp32c}\nscene: []", "sensor.noise=measured", "sensor.min_range_m=2").lidar
    assert (exact.measurement, exact.min_range) == (preset.measurement, 2)
    single = load(
        "sensor: {preset: hesai-xt32, noise: measured, measurement: {beam: null}}\nscene: []"
    ).lidar.measurement
    assert single == dataclasses.replace(ls.Lidar.preset("hesai-xt32", noise="measured").measurement, beam=None)


def test_a_sensor_of_ones_own_may_be_measured() -> None:
    pattern = "pattern: {type: mid360}\nmeasurement: {dropout: 0.1}\n"
    Path("mine.yaml").write_text(f"{pattern}measured: {{measurement: {{range_sigma_m: 0.01}}, max_range_m: 9}}\n")
    lidar = ls.Lidar.from_file("mine.yaml", noise="measured")
    assert (lidar.measurement, lidar.max_range) == (ls.Measurement(range_sigma=0.01, dropout=0.1), 9)
    assert ls.Lidar.from_file("mine.yaml").measurement == ls.Measurement(dropout=0.1)
    with pytest.raises(
        ValueError, match=r"^noise: expected none, since the sensor has no datasheet_noise, got 'datasheet'$"
    ):
        ls.Lidar.from_file("mine.yaml", noise="datasheet")
    Path("mine.yaml").write_text(f"{pattern}measured:\n  measurement:\n    range_sigma: 0.01\n")
    with pytest.raises(ConfigError) as caught:
        ls.Lidar.from_file("mine.yaml")
    assert str(caught.value).startswith("mine.yaml:5: measured.measurement.range_sigma: unknown key; did you mean")


def test_sensors_of_sensors() -> None:
    Path("sensors").mkdir()
    Path("sensors/near.yaml").write_text("preset: velodyne-vlp16\nmax_range_m: 30\n", encoding="utf-8")
    Path("sensors/nearer.yaml").write_text("file: near.yaml\nmin_range_m: 2\n", encoding="utf-8")
    run = load("sensor: {file: sensors/nearer.yaml, name: mine}\nscene: []")
    assert (run.lidar.name, run.lidar.min_range, run.lidar.max_range) == ("mine", 2, 30)
    lidar = ls.Lidar.from_file("sensors/nearer.yaml", noise="datasheet")
    assert (lidar.name, lidar.max_range) == ("velodyne-vlp16", 30)
    assert lidar.measurement.channel_bias_sigma > 0


def test_a_scene_of_its_own() -> None:
    Path("scenes").mkdir()
    trimesh.creation.box().export("scenes/box.ply")
    Path("scenes/hall.yaml").write_text("- {shape: mesh, file: box.ply, name: box}\n", encoding="utf-8")
    text = "sensor: {preset: velodyne-vlp16}\nscene: {file: scenes/hall.yaml}"
    assert load(text).scene.objects[0].name == "box"
    assert load(text, "scene.0.name=cube").scene.objects[0].name == "cube"
    assert refusal(text, "scene.0.label=-1") == (
        "--set scene.0.label=-1: expected an integer from 0 to 4294967295, got -1"
    )


HALL = """\
class_names: {1: wall, 7: bin}
scene:
  - {shape: box, size_m: [1, 1, 1], label: 7}
"""


def test_class_names_reach_scene_and_points() -> None:
    run = load(CONFIG.replace("scene:", "class_names: {40: road, 4294967295: ball}\nscene:"))
    assert run.scene.class_names == {40: "road", 2**32 - 1: "ball"}
    assert run.scan().point_cloud().class_names == run.scene.class_names
    assert load(CONFIG, "class_names.3=tree").scene.class_names == {3: "tree"}


def test_class_names_of_a_scene_of_its_own() -> None:
    Path("hall.yaml").write_text(HALL, encoding="utf-8")
    text = "sensor: {preset: velodyne-vlp16}\nscene: {file: hall.yaml}\n"
    run = load(text)
    assert (len(run.scene), run.scene.class_names) == (1, {1: "wall", 7: "bin"})
    named = load(f"{text}class_names: {{7: basket, 8: lamp}}", "class_names.1=panel", "scene.0.label=9")
    assert named.scene.class_names == {1: "panel", 7: "basket", 8: "lamp"}
    assert named.scene.objects[0].label == 9
    for path in ("hall.yaml", "run.yaml"):
        scene = ls.Scene.from_file(path)
        assert (len(scene), scene.class_names[1]) == (1, "wall")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("1: wall", "wall: 1", "hall.yaml:1: class_names.wall: expected text, got 1"),
        ("1: wall", "wall: wall", "hall.yaml:1: class_names.wall: expected a label, 0 to 4294967295"),
        ("1: wall", "-1: wall", "hall.yaml:1: class_names.-1: expected a label, 0 to 4294967295"),
        ("1: wall", "01: wall", "hall.yaml:1: class_names.01: expected a label, 0 to 4294967295"),
        ("1: wall", "٣: wall", "hall.yaml:1: class_names.٣: expected a label, 0 to 4294967295"),
        (
            "1: wall",
            f"'{'9' * 500}': wall",
            f"hall.yaml:1: class_names.{'9' * 187}…: expected a label, 0 to 4294967295",
        ),
        ("1: wall", "4294967296: wall", "hall.yaml:1: class_names.4294967296: expected a label, 0 to 4294967295"),
        ("{1: wall, 7: bin}", "[wall, bin]", "hall.yaml:1: class_names: expected a mapping, got a list of 2"),
        ("class_names:", "class_name:", "hall.yaml:1: class_name: unknown key; did you mean class_names?"),
        ("scene:", "objects:", "hall.yaml:2: objects: unknown key; expected one of scene, class_names, atmosphere"),
        ("label: 7", "label: car", "hall.yaml:3: scene.0.label: expected an integer, got 'car'"),
    ],
)
def test_bad_class_names(old: str, new: str, message: str) -> None:
    assert old in HALL
    Path("hall.yaml").write_text(HALL.replace(old, new), encoding="utf-8")
    got = refusal("sensor: {preset: velodyne-vlp16}\nscene: {file: hall.yaml}")
    assert got.partition(" (and ")[0] == message


def test_overrides_choose_what_is_included_first() -> None:
    text = "sensor: {preset: velodyne-vlp16, max_range_m: 7}\nscene: []"
    run = load(text, "sensor.pattern.columns=100", "sensor.preset=ouster-os1-64", "sensor.mode=512x20")
    assert (run.lidar.name, run.lidar.pattern.columns, run.lidar.pattern.rate) == ("ouster-os1-64", 100, 20)
    assert run.lidar.max_range == 7
    assert load(text, "sensor.pattern.elevations_deg.3=1").lidar.pattern.elevations[3] == radians(1)


VENDORS = Path(__file__).parents[1] / "data" / "sensors"
OUSTER = VENDORS / "ouster" / "2_1_2_os1-991913000010-64.json"


def test_a_vendors_file_and_the_difference() -> None:
    sensor = f"{{file: {OUSTER}, mode: 512x10, noise: datasheet, name: mine, max_range_m: 9}}"
    lidar, expected = load(f"sensor: {sensor}\nscene: []").lidar, ls.Lidar.from_file(OUSTER, mode="512x10")
    assert (lidar.name, lidar.max_range, lidar.min_range) == ("mine", 9, expected.min_range)
    assert np.array_equal(lidar.pattern.pulses().directions, expected.pattern.pulses().directions)
    assert lidar.measurement == ls.Lidar.from_file(OUSTER, noise="datasheet").measurement != ls.Measurement()
    real = load(f"sensor: {{file: {OUSTER}, noise: measured}}\nscene: []").lidar
    assert real.measurement == ls.Lidar.preset("ouster-os1-128", noise="measured").measurement != lidar.measurement
    quiet = load(f"sensor: {{file: {OUSTER}, noise: datasheet, measurement: {{range_sigma_m: 0.5}}}}\nscene: []")
    assert quiet.lidar.measurement == dataclasses.replace(lidar.measurement, range_sigma=0.5)


def test_a_vendors_file_that_leaves_something_open() -> None:
    angles, times = (VENDORS / "hesai" / f"Pandar40P_{what}_Correction_File.csv" for what in ("Angle", "Firetime"))
    lidar = load(f"sensor: {{file: {angles}, firing_times: {times}, rate_hz: 20}}\nscene: []").lidar
    expected = ls.Lidar.from_file(angles, firing_times=times, rate=20)
    assert np.array_equal(lidar.pattern.pulses().time, expected.pattern.pulses().time)


def test_a_vendors_file_that_leaves_nothing_of_that_kind_open() -> None:
    assert refusal(f"sensor:\n  file: {OUSTER}\n  rate_hz: 5\nscene: []") == (
        "run.yaml:3: sensor.rate_hz: expected none, since Ouster metadata JSON has mode, noise as options, got 5.0"
    )
    assert refusal("sensor: {file: run.yaml}\nscene: []") == (
        "run.yaml:1: expected one of the keys preset, file, pattern, got none of them"
    )


# Bad input


SENSOR_KEYS = (
    "preset, file, mode, noise, name, measurement, min_range_m, max_range_m, range_offset_m, pattern, model, "
    "description, datasheet_noise, measured, modes, datasheet, sources"
)
SHAPE_NAMES = ", ".join(map(repr, objects.SHAPES))
PATTERN_NAMES = ", ".join(map(repr, sensors.PATTERNS))
MEASURED = ", ".join(name for name in ls.Lidar.presets() if "\nmeasured:" in preset_path(name).read_text("utf-8"))
VLP = "did you mean velodyne-vlp16 or velodyne-vls128 or velodyne-vlp32c?"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        # keys
        ("seed: 3", "sed: 3", "run.yaml:1: sed: unknown key; did you mean seed?"),
        ("radius_m: 0.5", "radius: 0.5", "run.yaml:18: scene.1.radius: unknown key; did you mean radius_m?"),
        ("  max_range_m: 50", "  color: red", f"run.yaml:10: sensor.color: unknown key; expected one of {SENSOR_KEYS}"),
        ("  max_range_m: 50", "  nois: none", "run.yaml:10: sensor.nois: unknown key; did you mean noise?"),
        ("    radius_m: 0.5\n", "", "run.yaml:16: scene.1: missing key 'radius_m'"),
        ("scene:", "scene: []\nscene:", "run.yaml:15: scene: this key is already on line 14"),
        ("name: road", "nme: road, sape: 3", "run.yaml:15: scene.0.nme: unknown key; did you mean name?"),
        # wrong types
        ("seed: 3", "seed: three", "run.yaml:1: seed: expected an integer, got 'three'"),
        ("seed: 3", "seed: 3.5", "run.yaml:1: seed: expected an integer, got 3.5"),
        ("seed: 3", "seed: true", "run.yaml:1: seed: expected an integer, got true"),
        ("seed: 3", "seed: -3", "run.yaml:1: seed: expected a value >= 0, got -3"),
        ("frames: 2", "frames: 0", "run.yaml:2: frames: expected a value >= 1, got 0"),
        ("name: road", "name: 5", "run.yaml:15: scene.0.name: expected text, got 5"),
        ("radius_m: 0.5", "radius_m: wide", "run.yaml:18: scene.1.radius_m: expected a number, got 'wide'"),
        ("radius_m: 0.5", "radius_m:", "run.yaml:18: scene.1.radius_m: expected a number, got nothing"),
        ("[1, 2, 3]\n    radius", "3\n    radius", "run.yaml:17: scene.1.center_m: expected a list, got 3"),
        ("[0, 0, 1]", "[0, 1]", "run.yaml:15: scene.0.normal: expected at least 3 items, got a list of 2"),
        ("[0, 0, 1]", "[0, 0, up]", "run.yaml:15: scene.0.normal.2: expected a number, got 'up'"),
        ("{yaw: 90}", "90", "run.yaml:13: pose.rotation_deg: expected a mapping with keys roll, pitch, yaw, got 90"),
        ("{yaw: 90}", "[0, 0, 90]",
         "run.yaml:13: pose.rotation_deg: expected a mapping with keys roll, pitch, yaw, got a list of 3"),
        ("columns: 32", "start_azimuth_deg: 400",
         ("run.yaml:8: sensor.pattern.start_azimuth_deg: expected a finite number from -6.28319 to 6.28319, "
          f"got {radians(400)} (in rad)")),
        ("  - {shape: plane", "  - 5\n  - {shape: plane", "run.yaml:15: scene.0: expected a mapping, got 5"),
        # choices
        ("shape: sphere", "shape: spheer", f"run.yaml:16: scene.1.shape: expected one of {SHAPE_NAMES}, got 'spheer'"),
        ("shape: sphere", "name: ball", "run.yaml:16: scene.1: missing key 'shape'"),
        ("type: spinning", "type: 5", f"run.yaml:6: sensor.pattern.type: expected one of {PATTERN_NAMES}, got 5"),
        # what only the constructor knows, at the key of the argument
        ("radius_m: 0.5", "radius_m: -0.5", "run.yaml:18: scene.1.radius_m: expected a finite number > 0, got -0.5"),
        ("frames: 2", "frames: 4294967297", "run.yaml:2: frames: expected a value <= 4294967296, got 4294967297"),
        ("frames: 2", "frames: 4294967296\nfirst_frame: 1",
         "run.yaml:2: frames: expected at most 4294967296 with first_frame, got 4294967296"),
        ("frames: 2", "first_frame: 4294967296",
         "run.yaml:2: first_frame: expected a value < 4294967296, got 4294967296"),
        ("frames: 2", "cloud: {deskew_s: .nan}", "run.yaml:2: cloud.deskew_s: expected a finite number, got nan"),
        ("position_m: [1, 2, 3]", "position_m: [1, 2, .nan]",
         "run.yaml:12: pose.position_m.2: expected a finite number, got nan"),
        ("{yaw: 90}", "{yaw: .inf}", "run.yaml:13: pose.rotation_deg.yaw: expected a finite number, got inf"),
        ("radius_m: 0.5", "radius_m: 0.5\n    scale: [1, .inf, 1]",
         "run.yaml:19: scene.1.scale.1: expected a finite number, got inf"),
        ("radius_m: 0.5", "radius_m: 1e400",
         "run.yaml:18: scene.1.radius_m: expected a number from -1.8e308 to 1.8e308, got 1e400"),
        ("radius_m: 0.5", "radius_m: 1+5j", "run.yaml:18: scene.1.radius_m: expected a number, got '1+5j'"),
        ("columns: 32", "columns: 0x" + "f" * 300,
         ("run.yaml:8: sensor.pattern.columns: expected a number from -1.8e308 to 1.8e308, "
          "got 0xffffffffff...fffffffffffff")),
        ("radius_m: 0.5", "radius_m: .nan", "run.yaml:18: scene.1.radius_m: expected a finite number > 0, got nan"),
        ("[0, 0, 1]", "[0, 0, 0]", "run.yaml:15: scene.0.normal: expected non-zero vectors, got normal = (0, 0, 0)"),
        ("label: 40", "label: -1", "run.yaml:15: scene.0.label: expected an integer from 0 to 4294967295, got -1"),
        ("reflectivity: 0.2", "reflectivity: -1",
         "run.yaml:15: scene.0.reflectivity: expected a finite number >= 0, got -1.0"),
        ("max_range_m: 50", "max_range_m: -5",
         "run.yaml:10: sensor.max_range_m: expected a real number >= 0, got -5.0"),
        ("columns: 32", "columns: 0", "run.yaml:8: sensor.pattern.columns: expected a finite number >= 1, got 0.0"),
        ("columns: 32", "field_of_view_deg: 400",
         ("run.yaml:8: sensor.pattern.field_of_view_deg: expected a finite number > 0 and <= 6.28319, "
         f"got {radians(400)} (in rad)")),
        ("columns: 32", "columns: 32\n    column_period_us: 9",
         "run.yaml:5: sensor.pattern: columns, column_period: expected one of them, got 32.0 and 9e-06"),
        ("normal: [0, 0, 1]", "normal: [0, 0, 1], point_m: [0, 0, 0], distance_m: 1",
         "run.yaml:15: scene.0.distance_m: expected either distance_m or point_m, got both"),
        # several at once
        ("seed: 3\nframes: 2", "seed: x\nframes: y", "run.yaml:1: seed: expected an integer, got 'x' (and 1 more)"),
    ],
)  # fmt: skip
def test_bad_value(old: str, new: str, message: str) -> None:
    assert old in CONFIG
    assert refusal(CONFIG.replace(old, new, 1)) == message


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ("5", "run.yaml:1: sensor: expected a mapping with preset, file or pattern, got 5"),
        ("{}", "run.yaml:1: sensor: expected one of the keys preset, file, pattern, got none of them"),
        ("{preset: 5}", "run.yaml:1: sensor.preset: expected text, got 5"),
        ("{preset: velodyne-vlp17}",
         f"run.yaml:1: sensor.preset: expected the name of a sensor, got 'velodyne-vlp17'; {VLP}"),
        ("{preset: velodyne-vlp16, file: x}", "run.yaml:1: sensor.file: expected a preset or a file, got both"),
        ("{preset: velodyne-vlp16, mode: 512x10}",
         "run.yaml:1: sensor.mode: expected none, since the sensor has no modes, got '512x10'"),
        ("{preset: ouster-os1-64, mode: 1x1}",
         "run.yaml:1: sensor.mode: expected one of 512x10, 512x20, 1024x10, 1024x20, 2048x10, got '1x1'"),
        ("{preset: velodyne-vlp16, noise: loud}",
         "run.yaml:1: sensor.noise: expected none, datasheet or measured, got 'loud'"),
        ("{pattern: {type: mid360}, noise: datasheet}",
         "run.yaml:1: sensor.noise: expected none, since the sensor has no datasheet_noise, got 'datasheet'"),
        ("{pattern: {type: mid360}, noise: measured}",
         f"run.yaml:1: sensor.noise: expected none, got 'measured'; the presets with measured noise are {MEASURED}"),
        ("{file: gone.yaml}", "run.yaml:1: sensor.file: cannot read gone.yaml: No such file or directory"),
        ("{file: self.yaml}", "self.yaml:1: file: expected another file, got one that includes this one"),
        ("{pattern: {type: risley, prisms: [{phase_deg: 1}], refractive_index: 1.5, pulse_rate_khz: 1, rate_hz: 1}}",
         "run.yaml:1: sensor.pattern.prisms.0: missing key 'rotation_rate_hz' or 'rotation_rate_rpm'"),
        ("{preset: livox-mid40, pattern: {prisms: [{rotation_rate_hz: 1, rotation_rate_rpm: 60}]}}",
         "run.yaml:1: sensor.pattern.prisms.0.rotation_rate_rpm: given already as rotation_rate_hz"),
    ],
)  # fmt: skip
def test_bad_sensor(sensor: str, message: str) -> None:
    Path("self.yaml").write_text("file: self.yaml\n", encoding="utf-8")
    assert refusal(f"sensor: {sensor}\nscene: []") == message


FOG, RAIN = "atmosphere: {fog: {visibility_m: 50}}", "atmosphere: {rain: {rate_mm_per_h: 5}}"


@pytest.mark.parametrize(
    ("air", "toy", "message"),
    [
        (FOG, "name: toy", "run.yaml:4: sensor: measurement.near_threshold: expected a number > 0 in fog, got 0.0; a "),
        (FOG, "measurement: {range_bias_m: 1}",
         "run.yaml:4: sensor.measurement: near_threshold: expected a number > 0 in fog, got 0.0; a preset has one "),
        (FOG, "measurement: {near_threshold: 0}",
         "run.yaml:4: sensor.measurement.near_threshold: expected a number > 0 in fog, got 0.0; a preset has one "),
        (FOG, "measurement: {crossover_m: [0, 1]}",
         "run.yaml:4: sensor: min_range_m: expected a number > 0 in fog, got 0.0; or give the measurement a "),
        (RAIN, "measurement: {detection: {reflectivity: 0.1, range_m: 1e200}}",
         "run.yaml:4: sensor.measurement.detection: expected a detection limit below 1e154 m in rain or snow, got "),
    ],
)  # fmt: skip
def test_what_weather_needs_is_named_as_a_key_of_the_sensor(air: str, toy: str, message: str) -> None:
    assert refusal(CONFIG.replace("name: toy", toy) + air).startswith(message)
    pattern = "pattern: {type: grid, azimuths_deg: [0], elevations_deg: [0], rate_hz: 5}"
    in_rig = refusal(f"rig: {{top: {{sensor: {{{toy}, {pattern}}}}}}}\nscene: []\n{air}")
    assert in_rig.startswith(re.sub(r":\d+: sensor", ":1: rig.top.sensor", message))


def test_an_error_in_an_included_file_names_that_file() -> None:
    Path("near.yaml").write_text("preset: velodyne-vlp16\n\nmax_range: 3\n", encoding="utf-8")
    assert refusal("sensor: {file: near.yaml}\nscene: []") == (
        "near.yaml:3: sensor.max_range: unknown key; did you mean max_range_m or min_range_m?"
    )


PLY = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 7
"""


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.ply", None, "cannot read gone.ply: No such file or directory"),
        ("points.obj", "v 0 0 0\n", "points.obj: cannot be read as a mesh: it holds no triangles"),
        ("nan.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n",
         "nan.obj: vertices: expected finite numbers, got vertices[2][1] = nan"),
        ("range.ply", PLY, "range.ply: faces: expected indices from 0 to 2, got faces[0][2] = 7"),
    ],
)  # fmt: skip
def test_bad_mesh_file(name: str, content: str | None, message: str) -> None:
    if content is not None:
        Path(name).write_text(content, encoding="utf-8")
    got = refusal(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{{shape: mesh, file: {name}}}]")
    assert got == f"run.yaml:2: scene.0.file: {message}"


@pytest.mark.parametrize(("shape", "what"), [("mesh", "mesh"), ("scene_file", "scene")])
def test_a_file_that_trimesh_cannot_read(shape: str, what: str) -> None:
    Path("text.glb").write_text("no mesh", encoding="utf-8")
    got = refusal(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{{shape: {shape}, file: text.glb}}]")
    assert got.startswith(f"run.yaml:2: scene.0.file: text.glb: cannot be read as a {what}: ")


@pytest.mark.parametrize("name", ["scene.txt", "scene", "page.xml"])
def test_a_file_that_is_no_scene(name: str) -> None:
    Path(name).write_text("<html/>", encoding="utf-8")
    got = refusal(f"sensor: {{preset: velodyne-vlp16}}\nscene: [{{shape: scene_file, file: {name}}}]")
    assert got.startswith(f"run.yaml:2: scene.0.file: {name}: expected a scene file (.dae, .glb, ")
    assert got.endswith("), MJCF or URDF")


def test_bad_heights() -> None:
    Path("z.npy").write_text("no array", encoding="utf-8")
    text = "sensor: {preset: velodyne-vlp16}\nscene: [{shape: heightfield, file: z.npy, spacing_m: 1}]"
    assert refusal(text).startswith(
        "run.yaml:2: scene.0.file: z.npy: not a readable .npy file: the magic string is not correct"
    )
    np.save("z.npy", np.array([[1.0, np.inf], [0.0, 0.0]]))
    assert refusal(text) == "run.yaml:2: scene.0: z: expected finite heights, or NaN for a hole, got z[0][1] = inf"
    np.save("z.npy", np.array([[1.0, np.nan], [0.0, 0.0]]))
    mesh = load(text).scene[0].shape
    assert isinstance(mesh, ls.TriangleMesh)
    assert (len(mesh), mesh.grid) == (1, (2, 2))


def test_bad_transforms() -> None:
    matrix = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    assert refusal(CONFIG, f"pose.matrix={matrix}") == (
        f"--set pose.matrix={matrix}: expected the matrix alone, got position_m beside it"
    )
    assert (
        refusal(CONFIG, "scene.1.scale=0")
        == "run.yaml:16: scene.1: transform: expected an invertible matrix, got determinant 0"
    )
    matrix = "[[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    assert refusal(CONFIG, f"pose={{matrix: {matrix}}}") == (
        f"--set pose={{matrix: {matrix}}}: pose.matrix: expected a rigid transform (orthonormal rotation), "
        "got one 3 away from it, determinant 2"
    )


def test_missing_configuration() -> None:
    with pytest.raises(ConfigError) as caught:
        ls.config.load("gone.yaml")
    assert str(caught.value) == "gone.yaml: cannot read the file: No such file or directory"


def test_a_document_that_is_no_mapping() -> None:
    keys = "scene, class_names, atmosphere, sensor, rig, pose, seed, first_frame, frames, cloud, georeference"
    assert refusal("- 1") == f"run.yaml:1: expected a mapping with keys {keys}, got a list of 1"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "crs: EPSG:4326",
            "georeference.crs: expected a projected system, since coordinates are in m, got WGS 84, whose coordinate",
        ),
        ("crs: EPSG:25832", "expected points in the world, with cloud.frame: world"),
        ("crs: 25832, origin: {latitude_deg: 1, longitude_deg: 1}", "origin: expected either crs or origin, got both"),
        ("origin: {latitude_deg: 91, longitude_deg: 1}", "origin.latitude_deg: expected a value <= 90.0, got 91"),
        (
            "origin: {latitude_deg: 9, longitude_deg: 1, altitude_m: 1.0e+9}",
            "origin.altitude_m: expected a finite number",
        ),
        ("origin: {latitude_deg: 9}", "origin: missing key 'longitude_deg'"),
        ("start: today", "expected a moment such as 2026-05-01T10:00:00+02:00, got 'today'"),
        ("start: 2026-05-01", "got 2026-05-01T00:00:00; 2026-05-01T00:00:00+00:00 is one in UTC"),
        ("start: 1970-01-01T00:00:00Z", "expected a moment since the GPS epoch, 1980-01-06 UTC, got 1970-01-01T00:00"),
    ],
)
def test_georeferences_that_do_not_fit(override: str, message: str) -> None:
    found = refusal("scene: []\nsensor: {preset: velodyne-vlp16}\n", f"georeference={{{override}}}")
    assert found.startswith(f"--set georeference={{{override}}}: ")
    assert message in found


def test_reading_a_sensor_says_what_is_wrong_with_its_options() -> None:
    with pytest.raises(ValueError, match=r"^mode: expected none, since the sensor has no modes, got 'fast'$"):
        ls.Lidar.preset("velodyne-vlp16", mode="fast")
    with pytest.raises(ValueError, match=r"^noise: expected none, datasheet or measured, got 'loud'$"):
        ls.Lidar.preset("velodyne-vlp16", noise="loud")
