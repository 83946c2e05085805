"""Files that a data set is made from: a data set is not resumed after any of them changed."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyproj
import pytest
import trimesh

import lidarsim as ls
from lidarsim.datasets.recipe import load
from lidarsim.datasets.sources import hashes
from lidarsim.errors import ConfigError, LidarsimError

SCENE = "- {shape: sphere, center_m: [5, 0, 0], radius_m: 1}\n"
SENSOR = "preset: velodyne-vlp16\n"
TABLE = "azimuth_deg,elevation_deg\n0,0\n1,0\n"
TABLE_SENSOR = "pattern: {type: table, file: deep/table.csv, rate_hz: 10}\n"
POSES = "0 0 0 1 0 0 0 1\n9 0 0 1 0 0 0 1\n"
RUN = "sensor: {preset: velodyne-vlp16}\nscene: [{shape: sphere, center_m: [5, 0, 0], radius_m: 1}]\n"


def ball(path: Path) -> None:
    trimesh.creation.icosphere(1).export(path, encoding="ascii")


def gltf(path: Path) -> None:
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.icosphere(1))).items():
        (path if name == "model.gltf" else path.parent / name).write_bytes(content)


def text(content: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(content) and None


def projection(path: Path) -> None:
    path.write_text(pyproj.CRS("EPSG:25832").to_wkt("WKT1_ESRI"))


TIP = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MJCF = "run: {scene: [{shape: scene_file, file: a.xml}]}"
MODEL = {
    "a.xml": text(
        """<mujoco><compiler meshdir="deep"/><include file="deep/part.xml"/>
        <asset><model name="other" file="other.xml"/></asset>
        <worldbody><geom type="mesh" mesh="tip"/><body><attach model="other" body="b" prefix="o"/></body></worldbody>
        </mujoco>"""
    ),
    "deep/part.xml": text('<mujoco><asset><mesh name="tip" file="tip.obj"/></asset></mujoco>'),
    "deep/tip.obj": text(TIP),
    "other.xml": text('<mujoco><worldbody><body name="b"><geom type="sphere" size="1"/></body></worldbody></mujoco>'),
}
URDF = """<robot name="r"><link name="a">
<collision><geometry><mesh filename="deep/tip.obj"/></geometry></collision>
</link></robot>"""
GRID = "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 9\n1 1\n1 1\n"
GLTF = "run: {scene: [{shape: mesh, file: a.gltf}]}"
OBJ = "mtllib my colours.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
GROUND = "{shape: plane, normal: [0, 0, 1], name: g}"
GROUP = "{objects: [{shape: mesh, file: b.ply}], on: [g], count: 0, area_m: [[0, 0], [1, 1]]}"

TABLES = {
    "scene": '[{"token": "A", "name": "a"}]',
    "sample": '[{"token": "s", "scene_token": "A"}]',
    "sample_data": '[{"sample_token": "s", "ego_pose_token": "p"}, {"sample_token": "s", "ego_pose_token": "q"}]',
    "ego_pose": """[{"token": "p", "timestamp": 0, "translation": [0, 0, 0], "rotation": [1, 0, 0, 0]},
        {"token": "q", "timestamp": 9000000, "translation": [9, 0, 0], "rotation": [1, 0, 0, 0]}]""",
}

Files = dict[str, Callable[[Path], None]]
RECIPES: dict[str, tuple[str, Files, str]] = {
    "a run": ("run: {file: a.yaml}", {"a.yaml": text(RUN)}, "a.yaml"),
    "a mesh": ("run: {scene: [{shape: mesh, file: a.ply}]}", {"a.ply": ball}, "a.ply"),
    "a mesh that is chosen": (
        "vary: {scene.0.file: {choice: [a.ply, b.ply]}}\nrun: {scene: [{shape: mesh, file: a.ply}]}",
        {"a.ply": ball, "b.ply": ball},
        "b.ply",
    ),
    "an object that is chosen": (
        "vary: {scene.0: {choice: [{shape: mesh, file: a.ply}, {shape: mesh, file: b.ply}]}}\nrun: {scene: [{}]}",
        {"a.ply": ball, "b.ply": ball},
        "b.ply",
    ),
    "a mesh that is scattered": (
        f"scatter: {{cars: {GROUP}}}\nrun: {{scene: [{GROUND}]}}",
        {"b.ply": ball},
        "b.ply",
    ),
    "a scene": ("run: {scene: {file: a.yaml}}", {"a.yaml": text(SCENE)}, "a.yaml"),
    "a scene that is chosen": (
        "vary: {scene.file: {choice: [a.yaml, b.yaml]}}\nrun: {scene: {file: a.yaml}}",
        {"a.yaml": text(SCENE), "b.yaml": text(SCENE)},
        "b.yaml",
    ),
    "a mesh in a scene that is chosen": (
        "vary: {scene.file: {choice: [a.yaml, deep/b.yaml]}}\nrun: {scene: {file: a.yaml}}",
        {"a.yaml": text(SCENE), "deep/b.yaml": text("[{shape: mesh, file: b.ply}]"), "deep/b.ply": ball},
        "deep/b.ply",
    ),
    "a sensor": ("run: {scene: [], sensor: {file: a.yaml}}", {"a.yaml": text(SENSOR)}, "a.yaml"),
    "a sensor that is chosen": (
        "vary: {sensor: {choice: [{file: a.yaml}, {file: b.yaml}]}}\nrun: {scene: [], sensor: {file: a.yaml}}",
        {"a.yaml": text(SENSOR), "b.yaml": text(SENSOR)},
        "b.yaml",
    ),
    "a table in a sensor in a sensor that is chosen": (
        "vary: {sensor.file: {choice: [a.yaml, b.yaml]}}\nrun: {scene: [], sensor: {file: a.yaml}}",
        {
            "a.yaml": text(SENSOR),
            "b.yaml": text("file: c.yaml"),
            "c.yaml": text(TABLE_SENSOR),
            "deep/table.csv": text(TABLE),
        },
        "deep/table.csv",
    ),
    "a table in a sensor of a rig": (
        "run: {scene: [], rig: {top: {sensor: {file: a.yaml}}}}",
        {"a.yaml": text(TABLE_SENSOR), "deep/table.csv": text(TABLE)},
        "deep/table.csv",
    ),
    "poses": ("run: {scene: [], pose: {file: a.txt}}", {"a.txt": text(POSES)}, "a.txt"),
    "poses that are chosen": (
        "vary: {pose: {choice: [{position_m: [0, 0, 1]}, {file: b.txt}]}}\nrun: {scene: []}",
        {"b.txt": text(POSES)},
        "b.txt",
    ),
    "the tables of nuScenes": (
        "run: {scene: [], pose: {file: ego_pose.json, scene: a}}",
        {f"{name}.json": text(rows) for name, rows in TABLES.items()},
        "sample_data.json",
    ),
    "the buffer of a glTF": (GLTF, {"a.gltf": gltf}, "gltf_buffer_1.bin"),
    "the materials of an OBJ": (
        "run: {scene: [{shape: mesh, file: a.obj}]}",
        {"a.obj": text(OBJ), "my colours.mtl": text("newmtl a\n")},
        "my colours.mtl",
    ),
    "the mesh of an included part of MJCF": (MJCF, MODEL, "deep/tip.obj"),
    "an included part of MJCF": (MJCF, MODEL, "deep/part.xml"),
    "a model that MJCF attaches": (MJCF, MODEL, "other.xml"),
    "the mesh of a URDF": (
        "run: {scene: [{shape: scene_file, file: a.urdf}]}",
        {"a.urdf": text(URDF), "deep/tip.obj": text(TIP)},
        "deep/tip.obj",
    ),
    "the projection of a grid": (
        "run: {scene: [{shape: raster, file: a.asc}]}",
        {"a.asc": text(GRID), "a.prj": projection},
        "a.prj",
    ),
}


def write(folder: Path, recipe: str, files: Files) -> Path:
    (folder / "deep").mkdir()
    for name, make in files.items():
        make(folder / name)
    path = folder / "recipe.yaml"
    path.write_text(f"layout: semantickitti\nsequences: 2\nshard_frames: 1\n{recipe}\n")
    return path


@pytest.mark.parametrize("case", RECIPES)
def test_no_data_set_is_resumed_with_another_file(case: str, tmp_path: Path) -> None:
    recipe, files, changed = RECIPES[case]
    more = [] if case == "a run" or "sensor:" in recipe else ["run.sensor={preset: velodyne-vlp16}"]
    path = write(tmp_path, recipe, files)
    made = load(path, more).source.files()
    assert changed in made
    assert set(files) <= made.keys()
    ls.generate(path, tmp_path / "out", overrides=more, part=(0, 2), pictures=0)
    with (tmp_path / changed).open("ab") as file:
        file.write(b"\n")  # also of a file of which no other bit differs
    again = load(path, more).source.files()
    assert {name for name in made if made[name] != again[name]} == {changed}
    name = re.escape(ascii(changed))
    with pytest.raises(
        LidarsimError, match=rf"with the same sources \({{{name}: '\w+'}}\), got {{{name}: '\w+'}} there"
    ):
        ls.generate(path, tmp_path / "out", overrides=more, pictures=0)


def test_paths_of_overrides_are_relative_to_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, RUN.join(["run:\n  ", ""]).replace("\nscene", "\n  scene"), {})
    (tmp_path / "elsewhere" / "deep").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "elsewhere")
    ball(Path("deep/a.ply"))
    ball(Path("deep/b.ply"))
    made = load(path, ["run.scene.0={shape: mesh, file: deep/a.ply}", "vary={scene.0.file: {choice: [deep/b.ply]}}"])
    assert made.source.files().keys() == {"elsewhere/deep/a.ply", "elsewhere/deep/b.ply"}
    (tmp_path / "again.yaml").write_text(made.text())
    assert load(tmp_path / "again.yaml").to_dict() == made.to_dict()
    assert load(tmp_path / "again.yaml").source.files() == made.source.files()


@pytest.mark.parametrize(
    ("recipe", "key"),
    [
        ("vary: {scene.0.file: {choice: [a.ply, gone.ply]}}\nrun: {scene: [{shape: mesh, file: a.ply}]}",
         "vary.scene.0.file.choice.1"),
        ("vary: {scene: {choice: [[], [{shape: mesh, file: gone.ply}]]}}\nrun: {scene: []}",
         "vary.scene.choice.1.0.file"),
    ],
)  # fmt: skip
def test_files_that_may_be_chosen_are_there(recipe: str, key: str, tmp_path: Path) -> None:
    path = write(tmp_path, recipe, {"a.ply": ball})
    with pytest.raises(ConfigError, match=rf"recipe\.yaml:4: {key}: cannot read .*gone\.ply: No such file"):
        load(path, ["run.sensor={preset: velodyne-vlp16}"])


def test_words_for_people_are_no_files(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    sheet = "datasheet: {file: notes.txt, times: 5 ns}, sources: {file: 'http://a'}"
    sensor = f"run: {{scene: [], sensor: {{preset: velodyne-vlp16, {sheet}}}}}"
    made = load(write(tmp_path, sensor, {}))
    assert made.source.files() == {}
    assert made.to_dict()["run"]["sensor"]["datasheet"]["file"] == "notes.txt"
    assert made.to_dict()["run"]["sensor"]["sources"]["file"] == "http://a"


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "/etc/hostname",
        "a\ud800",
        "data:application/octet-stream;base64,AAAA",
        "a%00b",
        "gone.bin",
        5,
        ".",
        None,
    ],
)
def test_files_outside_the_folder_of_a_mesh_are_not_read(uri: object, tmp_path: Path) -> None:
    from lidarsim.config.document import parse

    (tmp_path / "in").mkdir()
    (tmp_path / "secret.bin").write_bytes(b"secret")
    (tmp_path / "in" / "link.bin").symlink_to(tmp_path / "secret.bin")
    for buffers in ([{"uri": uri}], [{"uri": "link.bin"}], {"uri": uri}, None):
        (tmp_path / "in" / "a.gltf").write_text(json.dumps({"buffers": buffers}))
        assert hashes([parse("file: in/a.gltf", str(tmp_path / "f"))], str(tmp_path)).keys() == {"in/a.gltf"}


@pytest.mark.parametrize("content", [b"", b"glTF", b"\xff" * 30, b"[" * 5000, b'{"buffers": 5}', b"[]"])
def test_damaged_meshes_name_nothing(content: bytes, tmp_path: Path) -> None:
    from lidarsim.config.document import parse

    for name in ("a.gltf", "a.glb", "a.obj"):
        (tmp_path / name).write_bytes(content)
        assert hashes([parse(f"file: {name}", str(tmp_path / "f"))], str(tmp_path)).keys() == {name}


def test_the_images_of_materials(tmp_path: Path) -> None:
    from lidarsim.config.document import parse

    (tmp_path / "sub").mkdir()
    for name in ("sub/a b.png", "c.png", "d.png"):
        (tmp_path / name).write_bytes(b"image")
    (tmp_path / "a.obj").write_text("mtllib a.mtl b.mtl\n")
    (tmp_path / "b.mtl").write_text("newmtl n\n")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd -clamp on sub\\a b.png\nmap_Kd\n")
    (tmp_path / "a.dae").write_text(
        "<image><init_from>c.png</init_from></image><init_from><ref>d.png</ref></init_from>"
    )
    found = hashes([parse("file: a.obj", str(tmp_path / "f"))], str(tmp_path))
    assert found.keys() == {"a.obj", "a.mtl", "b.mtl", "sub/a b.png"}
    found = hashes([parse("file: a.dae", str(tmp_path / "f"))], str(tmp_path))
    assert found.keys() == {"a.dae", "c.png", "d.png"}


def test_the_buffers_of_a_binary_gltf(tmp_path: Path) -> None:
    from lidarsim.config.document import parse

    chunk = json.dumps({"buffers": [{}, {"uri": "b%20c.bin"}]}).encode()
    head = b"glTF" + np.array([2, 20 + len(chunk), len(chunk)], "<u4").tobytes() + b"JSON"
    (tmp_path / "a.glb").write_bytes(head + chunk)
    (tmp_path / "b c.bin").write_bytes(base64.b64decode("AAAA"))
    found = hashes([parse("file: a.glb", str(tmp_path / "f"))], str(tmp_path))
    assert found.keys() == {"a.glb", "b c.bin"}
