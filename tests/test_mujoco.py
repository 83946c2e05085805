"""Worlds of MuJoCo: after each update, rays meet what `mj_ray` meets."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError, MissingExtraError
from tests.mujoco_rays import EVERY_GEOM, TOLERANCE, compare

BALL = '<mujoco><worldbody><body name="b"><freejoint/><geom size="1" {}/></body></worldbody></mujoco>'


def every_geom() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(EVERY_GEOM)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def move(model: mujoco.MjModel, data: mujoco.MjData, seed: int) -> None:
    """Move everything that can move, by a step or two."""
    rng = np.random.default_rng(seed)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(scale=0.7, size=model.nv), 1.0)
    data.mocap_pos += rng.normal(scale=0.5, size=data.mocap_pos.shape)
    mujoco.mj_forward(model, data)


def test_after_an_update_rays_meet_what_mj_ray_meets() -> None:
    model, data = every_geom()
    world = ls.mujoco.World(model)
    geoms = np.arange(model.ngeom)
    compare(world.scene, geoms, model, data, rays=2000)
    for seed in range(3):
        before = data.geom_xpos.copy()
        move(model, data, seed)
        still = (data.geom_xpos == before).all(axis=1)
        assert still.sum() == 4  # floor, ramp, hill and rock
        compared = [item.transform for item in world.scene]
        world.update(data)
        same = [np.array_equal(item.transform, place) for item, place in zip(world.scene, compared, strict=True)]
        assert same == still.tolist()
        compare(world.scene, geoms, model, data, rays=10_000, seed=seed)


def test_an_update_moves_what_a_change_of_the_model_moved() -> None:
    model, data = every_geom()
    world = ls.mujoco.World(model)
    model.geom_pos += 0.3  # of the hill, the ramp and the floor, too, which no joint moves
    mujoco.mj_forward(model, data)
    world.update(data)
    compare(world.scene, np.arange(model.ngeom), model, data, rays=2000)


def test_mocap_bodies_and_their_children_move() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body mocap="true"><body pos="0 0 1"><geom size="0.5"/></body></body></worldbody></mujoco>'
    )
    data, world = mujoco.MjData(model), ls.mujoco.World(model)
    data.mocap_pos[0] = 3, 0, -1
    mujoco.mj_kinematics(model, data)
    world.update(data)
    assert world.scene.cast([[0, 0, 0]], [[1, 0, 0]]).t.tolist() == [2.5]


def test_bodies_carry_sensors() -> None:
    """Of a URDF there are no sites, and a lidar's own link is merged with its parent."""
    model, data = every_geom()
    move(model, data, 5)
    world = ls.mujoco.World(model)
    site = model.site("lidar").id
    offset = np.eye(4)
    offset[:3, :3] = Rotation.from_quat(model.site_quat[site], scalar_first=True).as_matrix()
    offset[:3, 3] = model.site_pos[site]
    near = 64 * np.finfo(float).eps * 8  # some dozens of roundings of numbers up to 8
    expected = world.pose(data, site="lidar")
    for name in ("hand", model.body("hand").id):
        for mount in (offset, RigidTransform.from_matrix(offset)):
            found = world.pose(data, body=name, offset=mount)
            np.testing.assert_allclose(found, expected, rtol=0, atol=near)
            many = world.poses(np.tile(data.xpos, (2, 1, 1)), np.tile(data.xquat, (2, 1, 1)), body=name, offset=mount)
            np.testing.assert_allclose(many, [expected] * 2, rtol=0, atol=near)
    bare = world.pose(data, body="hand")
    np.testing.assert_array_equal(bare[:3, 3], data.body("hand").xpos)
    np.testing.assert_array_equal(bare[:3, :3], data.body("hand").xmat.reshape(3, 3))
    np.testing.assert_array_equal(world.pose(data, body=0), np.eye(4))
    moved_site = world.pose(data, site="lidar", offset=offset)
    np.testing.assert_allclose(moved_site, expected @ offset, rtol=0, atol=near)


def test_sites_carry_sensors() -> None:
    model, data = every_geom()
    world = ls.mujoco.World(model)
    move(model, data, 5)
    world.update(data)
    pose = world.pose(data, site="lidar")
    assert pose.shape == (4, 4)
    np.testing.assert_array_equal(pose[:3, :3], data.site("lidar").xmat.reshape(3, 3))
    np.testing.assert_array_equal(pose[:3, 3], data.site("lidar").xpos)
    scan = ls.Lidar(ls.patterns.Spinning([0.0, -0.4], columns=64, rate=10.0)).scan(world.scene, pose)
    cloud = scan.point_cloud(frame="world")
    direction = cloud.xyz - pose[:3, 3]
    found = np.zeros(1, np.int32)
    for point, along, item in zip(cloud.xyz, direction, cloud.object_id, strict=True):
        distance = mujoco.mj_ray(model, data, pose[:3, 3], along, None, 1, -1, found)
        assert found[0] == item, point
        assert distance == pytest.approx(1.0, rel=0, abs=TOLERANCE / np.linalg.norm(along))
    assert len(cloud) > 64


def test_keyframes() -> None:
    text = EVERY_GEOM.replace("</mujoco>", '<keyframe><key name="home"/><key name="up"/></keyframe></mujoco>')
    model = mujoco.MjModel.from_xml_string(text)
    model.key_qpos[1, 2] += 2.0  # the crate
    crate = ls.mujoco.World(model).scene.find("crate/0")[0]
    heights = [ls.mujoco.World(model, keyframe=key).scene[crate].transform[2, 3] for key in ("home", "up", 1)]  # type: ignore[index]
    assert heights == [1.2, 3.2, 3.2]
    for wrong in ("down", 2, -1, True, 0.0):
        with pytest.raises(ArgumentValueError, match="keyframe: expected a keyframe of the model, 0 to 1 or a name"):
            ls.mujoco.World(model, keyframe=wrong)  # type: ignore[arg-type]
    with pytest.raises(ArgumentValueError, match="keyframe: expected None, got 0"):
        ls.mujoco.World(mujoco.MjModel.from_xml_string(BALL.format("")), keyframe=0)


def test_groups_and_bodies() -> None:
    geoms = "".join(f'<body name="b{group}"><geom size="1" group="{group}"/></body>' for group in range(5))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}<body/></worldbody></mujoco>")
    world = ls.mujoco.World(model)
    assert dict(world.bodies) == {"b0": 1, "b1": 2, "b2": 3}
    assert [item.instance for item in world.scene] == [1, 2, 3]
    assert [item.name for item in ls.mujoco.World(model, groups={4, 3}).scene] == ["b3/0", "b4/0"]
    assert len(ls.mujoco.World(model, groups=[]).scene) == 0
    model.geom_group[:] = 9  # as MuJoCo does, in the last group
    assert len(ls.mujoco.World(model, groups=(5,)).scene) == 5
    for wrong in ([6], [-1]):
        with pytest.raises(ArgumentValueError, match=r"groups\[0\]: expected an integer"):
            ls.mujoco.World(model, groups=wrong)
    for kind in ("012", 3, [1.5], [True], None):
        with pytest.raises(ArgumentTypeError, match="groups"):
            ls.mujoco.World(model, groups=kind)  # type: ignore[arg-type]


def test_reflectivity() -> None:
    text = """<mujoco><asset><material name="red" rgba="1 0 0 1"/></asset><worldbody>
      <geom size="1" material="red"/> <geom size="1" material="red" rgba="0 1 0 1"/> <geom size="1" rgba="1 1 2 1"/>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    found = [item.material.reflectivity for item in ls.mujoco.World(model, reflectivity="color").scene]
    assert found == pytest.approx([0.2126, 0.7152, 1.0])  # ITU-R BT.709
    assert {item.material.reflectivity for item in ls.mujoco.World(model).scene} == {1.0}
    assert {item.material.reflectivity for item in ls.mujoco.World(model, reflectivity=0.3).scene} == {0.3}
    asphalt = ls.materials.ASPHALT
    assert {item.material for item in ls.mujoco.World(model, reflectivity=asphalt).scene} == {asphalt}
    for wrong in ("colour", -1.0):
        with pytest.raises(ArgumentValueError, match="reflectivity"):
            ls.mujoco.World(model, reflectivity=wrong)  # type: ignore[arg-type]


def test_rules() -> None:
    model, data = every_geom()
    rules = [
        ls.Rule(node="arm/*", label=5, instance=77),
        ls.Rule(node="drum/lid", name="top", label=6, reflectivity=0.5, instance="node"),
        ls.Rule(node="r*", label=7, instance="parent"),
        ls.Rule(node="crate/0", skip=True),
    ]
    world = ls.mujoco.World(model, rules=rules)
    assert {item.name: item.label for item in world.scene} == {
        **dict.fromkeys(("floor", "hill", "ghost", "drum"), 0),
        "ramp": 7,
        "rock": 7,
        "top": 6,
        "arm": 5,
        "hand": 5,
    }
    instance = {item.name: item.instance for item in world.scene}
    assert instance["arm"] == instance["hand"] == 77
    assert instance["ramp"] == instance["rock"]
    assert len(set(instance.values())) == 7
    assert world.scene[world.scene.find("top")[0]].material.reflectivity == 0.5
    move(model, data, 3)
    world.update(data)
    geoms = np.array([k for k in range(model.ngeom) if k != model.geom(4).id])
    assert [item.name for item in world.scene] == [model.geom(k).name.replace("lid", "top") for k in geoms]
    place = world.scene[world.scene.find("top")[0]].transform
    np.testing.assert_array_equal(place[:3, 3], data.geom("lid").xpos)  # type: ignore[index]


def test_models_from_files(tmp_path: Path) -> None:
    path = tmp_path / "ball.xml"
    path.write_text(BALL.format(""), encoding="utf-8")
    world = ls.mujoco.World(path)
    assert world.model.ngeom == len(world.scene) == 1
    data = mujoco.MjData(world.model)
    data.qpos[0] = 3.0
    mujoco.mj_kinematics(world.model, data)
    world.update(data)
    assert world.scene.cast([[0, 0, 0]], [[1, 0, 0]]).t.tolist() == [2.0]
    path.write_text(BALL.format('file="x"'), encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"ball\.xml:1: geom names a file"):
        ls.mujoco.World(str(path))
    with pytest.raises(FileNotFoundError):
        ls.mujoco.World(tmp_path / "no.xml")


def test_bad_arguments() -> None:
    model, data = every_geom()
    world = ls.mujoco.World(model)
    before = [item.transform for item in world.scene]
    fresh = mujoco.MjData(model)
    other = mujoco.MjData(mujoco.MjModel.from_xml_string(BALL.format("")))
    wrong: list[tuple[Callable[[], Any], type[Exception], str]] = [
        (
            lambda: ls.mujoco.World(3),
            ArgumentTypeError,
            "model: expected a mujoco.MjModel or the path of a file, got 3",
        ),  # type: ignore[arg-type]
        (lambda: world.update(model), ArgumentTypeError, "data: expected a mujoco.MjData"),
        (
            lambda: world.update(other),
            ArgumentValueError,
            r"data: expected data of the model, geom_xpos of shape \(10, 3\), got \(1, 3\)",
        ),
        (lambda: world.pose(other, site="lidar"), ArgumentValueError, "data: expected data of the model"),
        (
            lambda: world.update(fresh),
            ArgumentValueError,
            r"data: expected data with poses, got none; call .*mj_forward",
        ),
        (lambda: world.pose(fresh, site="lidar"), ArgumentValueError, "data: expected data with poses"),
        (lambda: world.pose(data, site="x"), ArgumentValueError, "site: expected the name of a site .* it has lidar"),
        (lambda: world.pose(data), ArgumentTypeError, "site, body: expected one of them, got none"),
        (
            lambda: world.pose(data, site="lidar", body="arm"),
            ArgumentTypeError,
            "site, body: expected one of them, got both",
        ),
        (
            lambda: world.pose(data, body="armm"),
            ArgumentValueError,
            "body: expected the name of a body of the model, got 'armm'; did you mean arm",
        ),
        (
            lambda: world.pose(data, body="lidar_link"),
            ArgumentValueError,
            "it has world, crate, drum, arm, hand, ghost; of a URDF, MuJoCo merges links with fixed joints",
        ),
        (lambda: world.pose(data, body=99), ArgumentValueError, "body: expected an integer from 0 to 5, got 99"),
        (
            lambda: world.pose(data, body="arm", offset=2 * np.eye(4)),
            ArgumentValueError,
            r"offset: expected a last row of \(0, 0, 0, 1\)",
        ),
        (lambda: world.pose(data, site=0), ArgumentTypeError, "site: expected the name of a site, got 0"),  # type: ignore[arg-type]
    ]
    for call, kind, message in wrong:
        with pytest.raises(kind, match=message):
            call()
    move(model, data, 1)
    data.geom_xpos[model.geom("hand").id] = np.nan
    with pytest.raises(ArgumentValueError, match="data: expected finite poses, got one of 'hand' that is not"):
        world.update(data)
    for item, place in zip(world.scene, before, strict=True):
        np.testing.assert_array_equal(item.transform, place)


@pytest.mark.parametrize("twin", [copy.copy, copy.deepcopy, lambda world: pickle.loads(pickle.dumps(world))])  # noqa: S301
def test_copies_share_nothing(twin: Callable[[ls.mujoco.World], ls.mujoco.World]) -> None:
    model, data = every_geom()
    world = ls.mujoco.World(model)
    other = twin(world)
    move(model, data, 2)
    world.update(data)
    changed = [
        not np.array_equal(one.transform, two.transform) for one, two in zip(world.scene, other.scene, strict=True)
    ]
    assert sum(changed) == model.ngeom - 4
    other.update(data)
    for one, two in zip(world.scene, other.scene, strict=True):
        np.testing.assert_array_equal(one.transform, two.transform)
    assert repr(other) == repr(world) == "World: 6 bodies, 10 objects of which 6 can move"


def test_without_mujoco(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    (tmp_path / "a.xml").write_text("<mujoco/>", encoding="utf-8")
    for read in (ls.mujoco.World, ls.Scene.from_file):
        with pytest.raises(MissingExtraError, match=r'needs mujoco: pip install "lidarsim\[mujoco\]"'):
            read(tmp_path / "a.xml")


def test_importing_lidarsim_does_not_import_mujoco() -> None:
    code = "import sys, lidarsim.mujoco; print('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


ROBOT = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="0 0 1"/>
  <body name="base" pos="0 0 1"><freejoint/><geom type="box" size="0.3 0.2 0.1" pos="0.1 0 0" euler="0 0 30"/>
    <site name="lidar" pos="0.1 0.2 0.3" euler="10 20 30"/>
    <body name="arm" pos="0.3 0 0"><joint axis="0 1 0"/><geom type="capsule" size="0.05 0.2" pos="0 0 0.2"/>
      <body pos="0 0 0.4"><joint axis="1 0 0"/><geom name="hand" size="0.1"/></body>
    </body>
  </body>
  <body name="ball" pos="3 0 1"><freejoint/><geom size="0.2"/></body>
</worldbody></mujoco>
"""


def test_poses_in_many_worlds_are_those_of_each() -> None:
    model = mujoco.MjModel.from_xml_string(ROBOT)
    world, rng = ls.mujoco.World(model), np.random.default_rng(0)
    worlds = []
    for _ in range(6):
        data = mujoco.MjData(model)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
        mujoco.mj_forward(model, data)
        worlds.append(data)
    xpos, xquat = (np.stack([getattr(data, name) for data in worlds]) for name in ("xpos", "xquat"))
    found = world.poses(xpos, xquat, site="lidar")
    assert found.shape == (6, 4, 4)
    # Two products of rotations, each rounded, of numbers below 8.
    tolerance = 64 * np.finfo(float).eps
    for pose, data in zip(found, worlds, strict=True):
        np.testing.assert_allclose(pose, world.pose(data, site="lidar"), rtol=0, atol=tolerance)
    grid = world.poses(xpos.reshape(2, 3, -1, 3), xquat.reshape(2, 3, -1, 4), site="lidar")
    np.testing.assert_array_equal(grid.reshape(6, 4, 4), found)
    one = world.poses(xpos[0].astype(np.float32), 2.0 * xquat[0], site="lidar")
    np.testing.assert_allclose(one[:3, :3], found[0, :3, :3], rtol=0, atol=tolerance)
    # Positions below 8 m in float32 are rounded by at most 2⁻²² m.
    np.testing.assert_allclose(one[:3, 3], found[0, :3, 3], rtol=0, atol=2.0**-22 + tolerance)
    other = ls.mujoco.World(model)
    for k, data in enumerate(worlds):
        world.update(data)
        other.move(xpos[k], xquat[k])
        for item, twin in zip(world.scene, other.scene, strict=True):
            assert (item.transform is None) == (twin.transform is None)
            if item.transform is not None and twin.transform is not None:
                np.testing.assert_allclose(item.transform, twin.transform, rtol=0, atol=tolerance)


def test_instances_of_a_body_and_of_all_below_it() -> None:
    world = ls.mujoco.World(mujoco.MjModel.from_xml_string(ROBOT))
    by_name = {item.name: item.instance for item in world.scene}
    base, arm, hand = by_name["base/0"], by_name["arm/0"], by_name["hand"]
    assert world.instances("base") == sorted([base, arm, hand])
    assert world.instances("base", subtree=False) == [base]
    assert world.instances("arm") == sorted([arm, hand])
    assert world.instances(3) == [hand]
    assert world.instances(0, subtree=False) == [by_name["floor"]]
    assert world.instances() == sorted(by_name.values())
    pose = world.pose(_still(world.model), site="lidar")
    hits = world.scene.cast(np.tile(pose[:3, 3], (500, 1)), np.random.default_rng(0).normal(size=(500, 3)))
    own = {world.scene[number].instance for number in hits.object_id[hits.hit].tolist()}
    assert own & set(world.instances("base"))


def _still(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize(
    ("act", "error", "message"),
    [
        (lambda w: w.instances("leg"), ArgumentValueError, "body: expected the name of a body of the model, got 'leg'"),
        (lambda w: w.instances(9), ArgumentValueError, "body: expected an integer from 0 to 4, got 9"),
        (lambda w: w.instances(1.5), ArgumentTypeError, "body: expected an integer"),
        (lambda w: w.instances("base", subtree=2), ArgumentTypeError, "subtree: expected True or False"),
        (
            lambda w: w.poses(np.zeros((7, 5, 3)), np.ones((7, 5, 4)), site="eye"),
            ArgumentValueError,
            "site: expected the name of a site of the model, got 'eye'",
        ),
        (
            lambda w: w.poses(np.zeros((7, 4, 3)), np.ones((7, 5, 4)), site="lidar"),
            ArgumentValueError,
            r"xpos: expected shape \(7, 5, 3\), got \(7, 4, 3\)",
        ),
        (
            lambda w: w.poses(np.zeros((7, 5, 3)), np.ones((6, 5, 4)), site="lidar"),
            ArgumentValueError,
            r"xquat: expected shape \(7, 5, 4\), as of xpos, got \(6, 5, 4\)",
        ),
        (
            lambda w: w.poses(np.zeros((2, 5, 3)), np.zeros((2, 5, 4)), site="lidar"),
            ArgumentValueError,
            r"xquat: expected quaternions other than zero, got xquat\[0\]\[0\] = 0",
        ),
        (
            lambda w: w.poses(np.full((2, 5, 3), np.nan), np.ones((2, 5, 4)), site="lidar"),
            ArgumentValueError,
            "xpos: expected finite numbers",
        ),
        (lambda w: w.poses(3.0, 4.0, site="lidar"), ArgumentValueError, r"xpos: expected shape \(5, 3\)"),
        (
            lambda w: w.move(np.zeros((2, 5, 3)), np.ones((2, 5, 4))),
            ArgumentValueError,
            r"xpos: expected shape \(5, 3\), got \(2, 5, 3\)",
        ),
    ],
)
def test_what_is_no_body_pose_or_instance_is_refused(
    act: Callable[[ls.mujoco.World], object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        act(ls.mujoco.World(mujoco.MjModel.from_xml_string(ROBOT)))
