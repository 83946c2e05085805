"""Materials: values, colours and invalid arguments."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim import materials

GUIDE = (Path(__file__).parents[1] / "configs" / "REFERENCE.md").read_text(encoding="utf-8")


def test_a_material_is_a_value() -> None:
    assert ls.Material() == ls.Material(reflectivity=1)
    assert ls.Material(reflectivity=[0.5, 1.0], per="face") == ls.Material(reflectivity=np.array([0.5, 1]), per="face")
    assert ls.Material(reflectivity=[0.5, 1.0], per="face") != ls.Material(reflectivity=[0.5, 1.0], per="vertex")
    assert ls.Material(reflectivity=[0.5], per="face") != ls.Material(reflectivity=0.5)
    assert ls.Material() != 1.0
    assert len({ls.Material(), ls.Material(reflectivity=1.0), ls.Material(reflectivity=2.0)}) == 2


def test_roughness_and_highlight_are_part_of_the_value() -> None:
    rough = ls.Material(reflectivity=0.2, roughness=0.3, specular=4, specular_width=0.05)
    assert (rough.roughness, rough.specular, rough.specular_width) == (0.3, 4.0, 0.05)
    assert rough == pickle.loads(pickle.dumps(rough)) == copy.deepcopy(rough)  # noqa: S301 - our own
    assert hash(rough) == hash(pickle.loads(pickle.dumps(rough)))  # noqa: S301
    for other in ({"roughness": 0.2}, {"specular": 3}, {"specular_width": 0.06}):
        changed = {"roughness": 0.3, "specular": 4, "specular_width": 0.05, **other}
        assert ls.Material(reflectivity=0.2, **changed) != rough  # type: ignore[arg-type]
    assert repr(rough) == (
        "Material(reflectivity=0.2, per='object', roughness=0.3, specular=4.0, specular_width=0.05, transmission=0.0, "
        "mirror=0.0)"
    )
    each = ls.Material(reflectivity=[0.1, 0.2], per="face", roughness=0.1)
    assert each.roughness == 0.1


def test_arrays_are_kept_as_read_only_copies() -> None:
    values = np.array([0.5, 1.0])
    material = ls.Material(reflectivity=values, per="vertex")
    values[0] = 9.0
    assert isinstance(material.reflectivity, np.ndarray)
    assert material.reflectivity.tolist() == [0.5, 1.0]
    assert not material.reflectivity.flags.writeable


def test_colours_become_luminance() -> None:
    colors = np.array([[0, 0, 0], [255, 255, 255], [255, 0, 0], [0, 255, 0], [0, 0, 255], [128, 128, 128]], np.uint8)
    expected = [0.0, 1.0, 0.2126, 0.7152, 0.0722, 0.2158605]
    by_integers, by_floats = ls.Material.from_colors(colors), ls.Material.from_colors(colors / 255.0)
    assert by_integers.per == "vertex"
    assert np.allclose(by_integers.reflectivity, expected, rtol=0, atol=0.5e-7)  # seven digits
    assert by_integers == by_floats
    opaque = np.column_stack([colors, np.full(6, 128, np.uint8)])
    assert ls.Material.from_colors(opaque, per="face") == ls.Material(reflectivity=by_integers.reflectivity, per="face")


@pytest.mark.parametrize(
    ("parameters", "error", "message"),
    [
        ({"reflectivity": -0.5}, ValueError, "reflectivity: expected a finite number >= 0, got -0.5"),
        ({"reflectivity": math.nan}, ValueError, "reflectivity: expected a finite number >= 0, got nan"),
        (
            {"reflectivity": [0.1, 0.2]},
            TypeError,
            "reflectivity: expected one number, or an array with per='face' or per='vertex', got [0.1, 0.2]",
        ),
        ({"reflectivity": 0.5, "per": "face"}, ValueError, "reflectivity: expected shape (n,), got ()"),
        (
            {"reflectivity": [0.1, -0.2], "per": "face"},
            ValueError,
            "reflectivity: expected numbers >= 0, got reflectivity[1] = -0.2",
        ),
        (
            {"reflectivity": [0.1, math.inf], "per": "vertex"},
            ValueError,
            "reflectivity: expected finite numbers, got reflectivity[1] = inf",
        ),
        ({"roughness": -0.1}, ValueError, "roughness: expected a finite number from 0 to 1.5708, got -0.1"),
        ({"roughness": 20}, ValueError, "roughness: expected a finite number from 0 to 1.5708, got 20.0; degrees?"),
        ({"roughness": "high"}, TypeError, "roughness: expected a finite number from 0 to 1.5708, got 'high'"),
        ({"specular": -1.0}, ValueError, "specular: expected a finite number >= 0, got -1.0"),
        ({"specular": math.inf}, ValueError, "specular: expected a finite number >= 0, got inf"),
        ({"specular_width": 0.0}, ValueError, "specular_width: expected a finite number > 0, got 0.0"),
        ({"specular_width": math.nan}, ValueError, "specular_width: expected a finite number > 0, got nan"),
        ({"transmission": -0.1}, ValueError, "transmission: expected a finite number from 0 to 1, got -0.1"),
        ({"mirror": 1.5}, ValueError, "mirror: expected a finite number from 0 to 1, got 1.5"),
        ({"mirror": "glass"}, TypeError, "mirror: expected a finite number from 0 to 1, got 'glass'"),
        (
            {"transmission": 0.7, "mirror": 0.4},
            ValueError,
            "mirror: expected at most 0.3 beside a transmission of 0.7, got 0.4; more light would go on than comes",
        ),
        ({"per": "side"}, ValueError, "per: expected 'object', 'face', 'vertex' or 'texture', got 'side'"),
    ],
)
def test_materials_that_cannot_be_are_refused(parameters: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        ls.Material(**parameters)


@pytest.mark.parametrize(
    ("colors", "message"),
    [
        ([0.1, 0.2, 0.3], "colors: expected shape (n, 3) or (n, 4), got (3,)"),
        ([[0.1, 0.2, 1.3]], "colors: expected numbers from 0 to 1, got 0.1 to 1.3"),
        ([[0, 20, 256]], "colors: expected numbers from 0 to 255, got 0 to 256"),
    ],
)
def test_colours_that_cannot_be_are_refused(colors: list[Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Material.from_colors(colors)


LIBRARY = {name: getattr(materials, name) for name in materials.SOURCES}
BRIGHTER_THAN_WHITE = {"ROAD_PAINT", "SIGN_SHEETING"}


def test_each_material_of_the_library_has_a_source() -> None:
    assert len(LIBRARY) > 30
    assert list(LIBRARY) == list(materials.SOURCES)
    assert sorted([*LIBRARY, "Material", "SOURCES", "Texture", "named"]) == sorted(materials.__all__)
    for name, source in materials.SOURCES.items():
        assert re.search(r"\b20[0-2]\d\b", source), f"{name} has no year"
        assert re.search(r"https?://\w", source), f"{name} has no address"
        assert re.search(r"\b0\.\d|\d+ (to \d+ )?(m?cd)/", source), f"{name} has no values"
        assert "  " not in source, name


def test_the_values_of_the_library_are_in_range() -> None:
    for name, material in LIBRARY.items():
        assert material.per == "object"
        assert isinstance(material.reflectivity, float)
        assert material.reflectivity > 0
        assert (material.reflectivity > 1) == (name in BRIGHTER_THAN_WHITE), name
        assert material.specular == 0


def test_materials_at_1550_nm_are_those_at_905_nm_in_other_light() -> None:
    pairs = {name: (LIBRARY[name], LIBRARY[f"{name}_1550"]) for name in LIBRARY if f"{name}_1550" in LIBRARY}
    assert len(pairs) > 10
    assert {f"{name}_1550" for name in pairs} == {name for name in LIBRARY if name.endswith("_1550")}
    for name, (near, far) in pairs.items():
        assert near.roughness == far.roughness, name
    ratio = {name: float(far.reflectivity) / float(near.reflectivity) for name, (near, far) in pairs.items()}
    assert all(ratio[name] < 0.5 for name in ("GRASS", "FOLIAGE", "CONIFER", "SNOW"))  # their water absorbs the light
    assert all(ratio[name] > 1 for name in ("ASPHALT", "ASPHALT_LIGHT", "CONCRETE", "BRICK", "SOIL", "BARK"))


def test_retroreflectors_return_what_their_standards_ask_for() -> None:
    """Relative to a white diffuser at normal incidence, of which both coefficients are 1/π."""
    assert ls.materials.SIGN_SHEETING.reflectivity == pytest.approx(math.pi * 250, rel=0.001)
    for material, luminance in ((ls.materials.ROAD_PAINT, 0.25), (ls.materials.ROAD_PAINT_WORN, 0.13)):
        m = material.roughness
        at_grazing_incidence = 0.45 * m**2 / (m**2 + 0.09)
        assert material.reflectivity * at_grazing_incidence == pytest.approx(math.pi * luminance, rel=0.005)


def test_light_goes_on_by_the_shares_of_the_sources() -> None:
    index = 1.5130 - 0.003169 * 0.905**2 + 0.003962 / 0.905**2  # Rubin's formula for clear glass
    face = ((index - 1) / (index + 1)) ** 2
    absorbed = 1 - ls.materials.GLASS.transmission - ls.materials.GLASS.mirror
    assert face == pytest.approx(0.042, abs=0.001)
    assert ls.materials.GLASS.mirror < 2 * face
    through = (1 - absorbed) ** 2
    assert ls.materials.MIRROR.mirror == pytest.approx(face + (1 - face) ** 2 * through * 0.97, abs=0.02)
    dry = ls.materials.ASPHALT.reflectivity
    assert isinstance(dry, float)
    assert ls.materials.ASPHALT_WET.reflectivity == pytest.approx(dry / (1.33**2 * (1 - dry) + dry), abs=0.005)
    incoming, refracted = math.radians(70), math.asin(math.sin(math.radians(70)) / 1.33)
    across = math.sin(incoming - refracted) ** 2 / math.sin(incoming + refracted) ** 2
    along = math.tan(incoming - refracted) ** 2 / math.tan(incoming + refracted) ** 2
    assert ls.materials.ASPHALT_WET.mirror == pytest.approx((across + along) / 2, abs=0.006)
    rows = re.findall(r"^\| `(\w+)` \|[^|]+\|[^|]+\|[^|]+\| ([\d.]*) \| ([\d.]*) \| [\d.]* \|$", GUIDE, re.MULTILINE)
    going_on = {name.lower(): item for name, item in LIBRARY.items() if item.transmission + item.mirror > 0}
    assert {name: (float(a or 0), float(b or 0)) for name, a, b in rows if a or b} == {
        name: (item.transmission, item.mirror) for name, item in going_on.items()
    }


def test_shares_are_part_of_the_value() -> None:
    tinted = ls.Material(reflectivity=0.1, transmission=0.4, mirror=0.1)
    assert (tinted.transmission, tinted.mirror) == (0.4, 0.1)
    assert tinted == ls.Material(reflectivity=0.1, transmission=0.4, mirror=0.1)
    assert tinted != ls.Material(reflectivity=0.1, transmission=0.4)
    assert copy.deepcopy(tinted) == tinted
    assert repr(tinted).endswith("specular_width=0.1, transmission=0.4, mirror=0.1)")


def test_materials_are_found_by_name() -> None:
    for name, material in LIBRARY.items():
        assert materials.named(name) is material
        assert materials.named(name.lower()) is material
    with pytest.raises(ValueError, match=r"^name: expected the name of a material, got 'gras'; did you mean grass or"):
        materials.named("gras")
    with pytest.raises(ValueError, match=r"^name: expected the name of a material, got 'x'; there are asphalt, "):
        materials.named("x")
    for hidden in ("SOURCES", "Material", "_ROAD", "math", "ſkin", ""):
        with pytest.raises(ValueError, match=r"^name: expected the name of a material"):
            materials.named(hidden)
    with pytest.raises(TypeError, match=r"^name: expected the name of a material, got None$"):
        materials.named(None)  # type: ignore[arg-type]


def test_the_guide_lists_the_library() -> None:
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]*) \| ([\d.]*) \| (\d*) \|[^|]+\|[^|]+\|[^|]+\|$", GUIDE, re.MULTILINE)
    assert [name for name, *_ in rows] == [name.lower() for name in LIBRARY if not name.endswith("_1550")]
    for name, near, far, roughness in rows:
        material = materials.named(name)
        assert float(near) == material.reflectivity
        assert int(roughness or 0) == round(math.degrees(material.roughness))
        assert bool(far) == (f"{name}_1550".upper() in LIBRARY)
        if far:
            assert float(far) == materials.named(f"{name}_1550").reflectivity


def read_material(tmp_path: Path, keys: str) -> ls.Material:
    """Return the material of a sphere with these keys of a configuration."""
    path = tmp_path / "run.yaml"
    path.write_text(
        f"sensor: {{preset: velodyne-vlp16}}\nscene:\n- {{shape: sphere, center_m: [5, 0, 0], radius_m: 1{keys}}}\n"
    )
    return ls.config.load(path).scene.objects[0].material


def test_an_object_of_a_configuration_names_its_material(tmp_path: Path) -> None:
    assert read_material(tmp_path, "") == ls.Material()
    assert read_material(tmp_path, ", material: null") == ls.Material()
    assert read_material(tmp_path, ", material: asphalt") == ls.materials.ASPHALT
    assert read_material(tmp_path, ", material: Snow_1550") == ls.materials.SNOW_1550


def test_keys_of_an_object_override_its_material(tmp_path: Path) -> None:
    brighter = read_material(tmp_path, ", material: asphalt, reflectivity: 0.4")
    texture = {"variation": ls.materials.ASPHALT.variation, "grain": ls.materials.ASPHALT.grain}
    assert brighter == ls.Material(reflectivity=0.4, roughness=ls.materials.ASPHALT.roughness, **texture)
    smooth = read_material(tmp_path, ", material: asphalt, roughness_deg: 0, specular: 2, specular_width: 0.2")
    assert smooth == ls.Material(reflectivity=0.17, specular=2, specular_width=0.2, **texture)
    even = read_material(tmp_path, ", material: asphalt, roughness_deg: 0, variation: 0, grain_m: 0.2")
    assert even == ls.Material(reflectivity=0.17)
    assert even != smooth


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (", material: asphlat", "expected the name of a material, got 'asphlat'; did you mean asphalt or"),
        (", material: x", "expected the name of a material, got 'x'; there are asphalt, "),
        (", material: 3", "expected text, got 3"),
        (", material: [asphalt]", "expected text, got"),
    ],
)
def test_a_material_that_there_is_not(keys: str, message: str, tmp_path: Path) -> None:
    place = f"{tmp_path / 'run.yaml'}:3: scene.0.material: "
    with pytest.raises(ValueError, match=f"^{re.escape(place)}{re.escape(message)}"):
        read_material(tmp_path, keys)


def return_rates(preset: str, mode: str | None, height: float, road: ls.Material, edges: list[int]) -> Any:
    """Share of the pulses that a flat road returns, for each range between two `edges`, m."""
    lidar = ls.Lidar.preset(preset, mode=mode, noise="measured")
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0), material=road)
    pose = np.eye(4)
    pose[2, 3] = height
    noisy, exact = (each.scan(scene, pose, seed=3) for each in (lidar, clean(lidar)))
    reached = exact.status == ls.Status.hit
    ranges = np.digitize(np.linalg.norm(exact.point_cloud().xyz, axis=1), edges)
    seen = (noisy.status == ls.Status.hit)[reached]
    assert all(np.count_nonzero(ranges == k) > 500 for k in range(1, len(edges)))
    return np.array([seen[ranges == k].mean() for k in range(1, len(edges))])


def clean(lidar: ls.Lidar) -> ls.Lidar:
    return dataclasses.replace(lidar, measurement=ls.Measurement(), min_range=0.0, max_range=math.inf)


# Shares of returns from the ground, unless occluded, by range, in captures: one OS1-128 1.93 m above a road (ouster-sdk
# test data, BSD-3-Clause), and KITTI's HDL-64E 1.75 m above three (statistics of three frames, their mean).
OS1_EDGES = [5, 7, 9, 11, 13, 15, 18, 21, 25, 30, 35, 40, 50, 60, 80]
OS1_SEEN = [0.937, 0.991, 0.988, 0.972, 0.952, 0.953, 0.896, 0.653, 0.409, 0.283, 0.155, 0.077, 0.032, 0.006]
# KITTI has a ring at 39 m and the next at 44 m, the preset at 40 and 45 m, so that the edge between them is at 41 m.
KITTI_EDGES = [5, 7, 9, 11, 13, 15, 18, 21, 25, 30, 35, 41, 50, 60, 80]
KITTI_SEEN = [0.881, 0.966, 0.992, 0.940, 0.920, 0.913, 0.863, 0.887, 0.909, 0.875, 0.841, 0.461, 0.449, 0.374]


def test_a_road_of_asphalt_is_seen_as_far_as_in_a_capture_of_an_ouster() -> None:
    sensor = "ouster-os1-128", "512x10", 1.932
    assert np.abs(return_rates(*sensor, ls.materials.ASPHALT, OS1_EDGES) - OS1_SEEN).max() < 0.1
    smooth = ls.Material(reflectivity=0.17)
    assert np.abs(return_rates(*sensor, smooth, OS1_EDGES) - OS1_SEEN).max() > 0.3


def test_a_road_of_light_asphalt_is_seen_as_far_as_in_kitti() -> None:
    sensor = "velodyne-hdl64e-s3", None, 1.752
    # Farther off, kerbs and grass beside real roads still return what a flat road does not.
    edges, seen = KITTI_EDGES[:12], KITTI_SEEN[:11]
    assert np.abs(return_rates(*sensor, ls.materials.ASPHALT_LIGHT, edges) - seen).max() < 0.17


# Texture


def test_texture_is_that_of_the_cells_of_an_object() -> None:
    """A wall twice, one of them turned and moved: the same cells, and others than those of the other object."""
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    turned[:3, 3] = (20.0, 5.0, 0.0)
    targets = np.random.default_rng(2).uniform([0.0, -5.0, -5.0], [0.0, 5.0, 5.0], (2000, 3))
    material = ls.Material(reflectivity=0.4, variation=0.2, grain=0.1)
    found = []
    for pose in (np.eye(4), turned):
        scene = ls.Scene()
        wall = ls.Polygon([(0, -6, -6), (0, 6, -6), (0, 6, 6), (0, -6, 6)])
        scene.add(wall, material=material, transform=pose)
        points = targets @ pose[:3, :3].T + pose[:3, 3]
        origins = points + pose[:3, :3] @ [-3.0, 0.0, 0.0]
        pattern = ls.patterns.Table(np.tile(pose[:3, :3] @ [1.0, 0.0, 0.0], (2000, 1)), origins=origins, rate=10.0)
        lidar = ls.Lidar(pattern)
        found.append(lidar.scan(scene, seed=1).intensity[:, 0] / 0.4)
        # Another seed and frame see the same.
        assert np.array_equal(lidar.scan(scene, seed=2, frame=3).intensity[:, 0] / 0.4, found[-1])
    # All but the points on the edges of cells.
    assert (np.abs(found[0] - found[1]) < 1e-6).mean() > 0.999
    # The factor is log-normal, of mean 1 and the relative standard deviation 0.2; it is one in each cell.
    sigma = math.sqrt(math.log(1 + 0.2**2))
    cells = [tuple(cell) for cell in np.floor(targets / 0.1 + [0.0, 0.618034, 0.276393])]
    of_cell = dict(zip(cells, found[0].tolist(), strict=True))
    assert [of_cell[cell] for cell in cells] == found[0].tolist()
    values = np.log(list(of_cell.values()))
    assert len(values) > 1500
    assert values.std() == pytest.approx(sigma, rel=5 / math.sqrt(2 * len(values)))
    assert values.mean() == pytest.approx(-(sigma**2) / 2, abs=5 * sigma / math.sqrt(len(values)))


def test_objects_of_one_texture_differ() -> None:
    scene = ls.Scene()
    material = ls.Material(reflectivity=0.4, variation=0.2)
    for x in (10.0, 20.0):
        scene.add(ls.Plane((1, 0, 0), 0.0), material=material, transform=np.eye(4) + np.eye(4, k=3) * x)
    origins = np.zeros((1000, 3))
    origins[:, 1] = np.arange(1000) * 0.5
    origins[500:, 0] = 15.0
    origins[500:, 1] -= 250.0
    lidar = ls.Lidar(ls.patterns.Table(np.tile([1.0, 0.0, 0.0], (1000, 1)), origins=origins, rate=10.0))
    first, second = np.split(lidar.scan(scene).intensity[:, 0], 2)
    assert len(np.unique(first)) > 490
    assert not (first == second).any()
    assert abs(np.corrcoef(first, second)[0, 1]) < 5 / math.sqrt(500)


def test_a_texture_stays_when_another_object_is_removed() -> None:
    scene = ls.Scene()
    other = scene.add(ls.Sphere((-10, 0, 0), 1.0))
    scene.add(ls.Plane((1, 0, 0), 5.0), material=ls.Material(variation=0.2))
    lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-0.5, 0.5, 100), [0.0], rate=10.0))
    before = lidar.scan(scene, ignore=[scene[other].instance])
    scene.remove(other)
    assert np.array_equal(lidar.scan(scene).intensity, before.intensity)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"variation": -0.1}, "variation: expected a finite number from 0 to 10, got -0.1"),
        ({"grain": 0.0}, "grain: expected a finite number > 0, got 0.0"),
    ],
)
def test_a_bad_texture_is_refused(keys: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(said)}$"):
        ls.Material(**keys)  # type: ignore[arg-type]
