"""Models of MuJoCo: rays meet what `mj_ray` meets, and no file but those beside or below a model is read."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

import mujoco
import numpy as np
import PIL.Image
import pytest
import trimesh

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes import _mjcf, mjcf
from tests.mujoco_rays import EVERY_GEOM, compare

GEOM = '<geom size="1"/>'


def write(folder: Path, content: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content, encoding="utf-8")
    return path


def model(body: str, head: str = "") -> str:
    return f"<mujoco>\n{head}\n<worldbody>\n{body}\n</worldbody>\n</mujoco>"


def with_mesh(file: str, compiler: str = "") -> str:
    return model('<geom type="mesh" mesh="box"/>', f'{compiler}<asset><mesh name="box" file="{file}"/></asset>')


def box(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box().export(path)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(FileFormatError) as caught:
        ls.Scene.from_file(path)
    assert str(path.parent.parent) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_rays_meet_what_mj_ray_meets(tmp_path: Path) -> None:
    path = write(tmp_path, EVERY_GEOM)
    scene = ls.Scene.from_file(path)
    reference = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(reference)
    mujoco.mj_forward(reference, data)
    assert len(scene) == reference.ngeom
    kinds = {type(item.shape).__name__ for item in scene}
    assert kinds == {"Plane", "Polygon", "Sphere", "Capsule", "Ellipsoid", "Cylinder", "Box", "TriangleMesh"}
    compare(scene, np.arange(reference.ngeom), reference, data, rays=12_000)


def test_a_height_field_is_closed(tmp_path: Path) -> None:
    path = write(tmp_path, EVERY_GEOM)
    (item,) = (item for item in ls.Scene.from_file(path) if item.name == "hill")
    mesh = trimesh.Trimesh(item.shape.vertices, item.shape.faces, process=False)  # type: ignore[attr-defined]
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    field = mujoco.MjModel.from_xml_path(str(path))
    x, y, height, base = field.hfield_size[0]
    rows, columns = field.hfield_nrow[0], field.hfield_ncol[0]
    z = field.hfield_data.reshape(rows, columns).astype(float)
    means = (2 * z[:-1, :-1] + z[:-1, 1:] + z[1:, :-1] + 2 * z[1:, 1:]) / 6  # of two prisms of triangles each
    volume = 4 * x * y * (base + height * means.mean())
    assert mesh.volume == pytest.approx(volume, rel=len(mesh.faces) * 2.0**-53)  # each rounds


def test_names_instances_and_poses(tmp_path: Path) -> None:
    body = """
    <geom name="floor" type="plane" size="0 0 1"/> <geom size="1"/>
    <body name="arm" pos="1 2 3" euler="0 0 90">
      <geom size="1"/> <geom size="2"/>
      <body><geom name="tip" pos="1 0 0" size="1"/></body>
    </body>"""
    scene = ls.Scene.from_file(write(tmp_path, model(body)))
    assert [item.name for item in scene] == ["floor", "world/1", "arm/0", "arm/1", "tip"]
    floor, ball, *arm, tip = (item.instance for item in scene)
    assert arm[0] == arm[1]
    assert len({floor, ball, arm[0], tip}) == 4
    place = scene[scene.find("tip")[0]].transform
    assert place is not None
    np.testing.assert_allclose(place[:3, 3], [1, 3, 3], rtol=0, atol=8 * 3 * 2.0**-53)
    assert scene[0].transform is not None


def test_invisible_geoms_and_groups_are_left_out(tmp_path: Path) -> None:
    body = """
    <geom name="seen" size="1"/> <geom name="clear" size="1" rgba="1 1 1 0"/>
    <geom name="glass" size="1" material="glass"/> <geom name="tinted" size="1" material="blue" rgba="1 1 1 0"/>
    <geom name="visual" size="1" group="2"/> <geom name="collision" size="1" group="3"/>"""
    head = '<asset><material name="glass" rgba="1 1 1 0"/><material name="blue" rgba="0 0 1 1"/></asset>'
    path = write(tmp_path, model(body, head))
    assert [item.name for item in ls.Scene.from_file(path)] == ["seen", "tinted", "visual"]


def test_geoms_of_one_mesh_share_it(tmp_path: Path) -> None:
    box(tmp_path / "box.stl")
    head = '<asset><mesh file="box.stl"/></asset>'
    body = '<geom type="mesh" mesh="box"/><geom type="mesh" mesh="box" pos="3 0 0"/>'
    first, second = ls.Scene.from_file(write(tmp_path, model(body, head)))
    assert first.shape is second.shape
    np.testing.assert_allclose(np.ptp(first.shape.vertices, axis=0), 1.0)  # type: ignore[attr-defined]


def test_a_strip_of_a_plane_is_as_long_as_mujoco_counts(tmp_path: Path) -> None:
    scene = ls.Scene.from_file(write(tmp_path, model('<geom type="plane" size="1 0 1"/>')))
    hits = scene.cast([[0, 0, 1], [0, 0, 1]], [[0.9, 1e9, -1], [1.1, 0, -1]])
    assert hits.t.tolist() == [1.0, np.inf]


def test_files_are_found_as_mujoco_finds_them(tmp_path: Path) -> None:
    box(tmp_path / "meshes" / "deep" / "box.stl")
    box(tmp_path / "parts" / "assets" / "wheel.obj")
    write(
        tmp_path,
        '<mujoco><compiler meshdir="assets"/><asset><mesh file="wheel.obj"/></asset>'
        '<worldbody><body name="wheel"><geom type="mesh" mesh="wheel"/></body></worldbody></mujoco>',
        "parts/wheel.xml",
    )
    write(tmp_path, '<mujocoinclude><include file="balls.xml"/></mujocoinclude>', "parts/more.xml")  # beside it
    write(tmp_path, f"<mujocoinclude>{GEOM}</mujocoinclude>", "parts/balls.xml")
    head = """<compiler meshdir="meshes" texturedir="/nowhere"/><asset><mesh file="deep/box.stl"/>
      <texture name="t" type="2d" file="/etc/passwd"/><material name="m" texture="t"/>
      <model name="wheel" file="parts/wheel.xml"/></asset>"""
    body = """<geom type="mesh" mesh="box" material="m"/><include file="parts/more.xml"/>
      <attach model="wheel" body="wheel" prefix="left/"/><attach model="wheel" body="wheel" prefix="right/"/>"""
    scene = ls.Scene.from_file(write(tmp_path, model(body, head)))
    assert [(item.name, type(item.shape).__name__) for item in scene] == [
        ("world/0", "TriangleMesh"),
        ("world/1", "Sphere"),
        ("left/wheel/0", "TriangleMesh"),
        ("right/wheel/0", "TriangleMesh"),
    ]


ROBOT = """<robot name="r"><link name="base"><visual><geometry><mesh filename="package://r/no.dae"/></geometry></visual>
  <collision><geometry><mesh filename="{}"/></geometry></collision></link>
  <gazebo><plugin filename="libno.so"/></gazebo></robot>"""


@pytest.mark.parametrize("name", ["package://r/meshes/box.stl", "meshes/box.stl", "file://meshes/box.stl"])
def test_urdf(name: str, tmp_path: Path) -> None:
    box(tmp_path / "meshes" / "box.stl")
    (item,) = ls.Scene.from_file(write(tmp_path, ROBOT.format(name), "r.urdf"))
    assert len(item.shape) == 12  # type: ignore[arg-type]


@pytest.mark.parametrize("file", ["sub dir/box.stl", "sub%20dir/box.stl"])
def test_urdf_files_may_be_quoted(file: str, tmp_path: Path) -> None:
    box(tmp_path / "model" / file)
    box(tmp_path / "box.stl")
    for name in (file, "package://r/" + file.replace(" ", "%20")):
        (item,) = ls.Scene.from_file(write(tmp_path / "model", ROBOT.format(name), "r.urdf"))
        assert len(item.shape) == 12  # type: ignore[arg-type]
    for name in ("%2e%2e/box.stl", quote(str(tmp_path / "box.stl"), safe="")):
        assert f"mesh '{name}': {OUTSIDE}" in refusal(write(tmp_path / "model", ROBOT.format(name), "r.urdf"))


def link(name: str, *kinds: str) -> str:
    shapes = "".join(f'<{kind}><geometry><box size="1 2 3"/></geometry></{kind}>' for kind in kinds)
    return f'<link name="{name}">{shapes}</link>'


JOINT = '<joint name="{0}" type="fixed"><parent link="a"/><child link="{0}"/></joint>'
KEPT = '<mujoco><compiler discardvisual="false"/></mujoco>'
UNSEEN = 'left out: visuals of links without collision ({}; discardvisual="false" keeps them)'


@pytest.mark.parametrize("read", [ls.Scene.from_file, lambda path: ls.mujoco.World(path).scene])
def test_links_of_a_urdf_that_have_visuals_alone_are_reported(
    read: Callable[[Path], ls.Scene], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    links = link("a", "visual", "collision") + link("b", "visual", "visual") + link("c") + link("d", "visual")
    more = "<gazebo><visual/><collision/></gazebo>"
    robot = f'<robot name="r">{{}}{more}{links}{"".join(map(JOINT.format, "bcd"))}</robot>'
    path = write(tmp_path, robot.format(""), "r.urdf")
    assert len(read(path)) == 1
    assert caplog.messages == [f"{path}: {UNSEEN.format(2)}"]
    assert len(read(write(tmp_path, robot.format(KEPT), "r.urdf"))) == 5
    assert len(caplog.messages) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (f'<robot name="r">{link("a", "visual")}</robot>', f"; {UNSEEN.format(1)}"),
        (model(""), ""),
        (model('<geom size="1" group="3"/><geom size="1" rgba="1 1 1 0"/>'), ""),
    ],
)
def test_models_without_geoms_are_no_scenes(content: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path, content)
    assert refusal(path) == f"{path}: it holds no geoms that are seen{message}"
    everything = write(tmp_path, model(GEOM))
    assert len(ls.Scene.from_file(everything, rules=[ls.Rule(skip=True)])) == 0


TACTILE = "<asset><mesh name='m' builtin='sphere' params='400'/></asset><sensor>{}</sensor>".format(
    "<tactile geom='g' mesh='m'/>" * 10
)

OUTSIDE = "only regular files beside or below "


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (with_mesh("../box.stl"), f"mesh '../box.stl': {OUTSIDE}"),
        (with_mesh("ABSOLUTE"), f"ABSOLUTE': {OUTSIDE}"),
        (with_mesh("box.stl", '<compiler meshdir=".."/>'), f"mesh 'box.stl': {OUTSIDE}"),
        (with_mesh("box.stl", '<compiler assetdir="FOLDER"/>'), f"mesh 'box.stl': {OUTSIDE}"),
        (with_mesh("&#x2e;&#46;/box.stl"), f"mesh '../box.stl': {OUTSIDE}"),
        (with_mesh("link.stl"), f"mesh 'link.stl': {OUTSIDE}"),
        (with_mesh("http://example.com/box.stl"), OUTSIDE),
        (with_mesh("here.stl"), "mesh 'here.stl': no such file"),
        (with_mesh(""), OUTSIDE),
        (model('<include file="../part.xml"/>'), f"include '../part.xml': {OUTSIDE}"),
        (model("", '<asset><model file="../part.xml"/></asset>'), f"model '../part.xml': {OUTSIDE}"),
        (model("", '<asset><hfield name="h" file="../h.png" size="1 1 1 1"/></asset>'), "hfield '../h.png': no such"),
        (model("", '<asset><skin file="../box.stl"/></asset>'), f"skin '../box.stl': {OUTSIDE}"),
        (model('<flexcomp name="f" type="mesh" file="../box.stl"/>'), f"flexcomp '../box.stl': {OUTSIDE}"),
        (model(f'{GEOM}<geom file="box.stl"/>'), "geom names a file, which is not read"),
        (model("", '<extension><plugin plugin="x"/></extension>'), "plugins of MuJoCo are not loaded from files"),
        (model("", '<asset><model file="robot.xml"/></asset>'), "model 'robot.xml' is part of itself"),
        (model('<include file="robot.xml"/>'), "'robot.xml' is included already"),
        ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco>&a;</mujoco>', "expected XML without a document type"),
        (model("<body>" * 300 + GEOM + "</body>" * 300), "expected at most 256 levels of elements, got more"),
        (
            model(f'<replicate count="200"><replicate count="2e2">{GEOM}</replicate></replicate>'),
            "expected at most 20,000 copies of elements, got more",
        ),
        (model('<flexcomp name="a" type="grid" count="999 999 999"/>'), "expected at most 20,000 copies of elements"),
        (model('<flexcomp name="a" type="grid" count="26 26 16"/>'), "expected at most 20,000 copies of elements"),
        (model(f'<replicate count="{" " * 2000}30000">{GEOM}</replicate>'), "expected at most 20,000 copies"),
        (
            model("", '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>'),
            "expected at most 20,000,000 numbers, got more",
        ),
        (model(GEOM, '<size nuserdata="2000000000"/>'), "expected at most 20,000,000 numbers, got more"),
        ("<mujoco><a></mujoco>", "not well-formed XML: mismatched tag"),
        ('<?xml version="1.0" encoding="x-none"?><mujoco/>', "not XML of an encoding that Python knows"),
        (
            model('<geom type="ball"/>'),
            "MuJoCo cannot read it: XML Error: invalid keyword: 'ball' Element 'geom', line 4",
        ),
        (with_mesh("bad.stl"), "MuJoCo cannot read it: "),
        (model('<geom size="nan"/>'), "MuJoCo cannot read it: "),
    ],
)
def test_refusals(content: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "model"
    outside = box(tmp_path / "box.stl")
    folder.mkdir()
    (folder / "link.stl").symlink_to(outside)
    (folder / "bad.stl").write_bytes(b"solid")
    write(tmp_path, model(GEOM), "part.xml")
    work = box(tmp_path / "work" / "here.stl").parent  # a file of the working folder is no better than any other
    monkeypatch.chdir(work)
    content = content.replace("ABSOLUTE", str(outside)).replace("FOLDER", str(tmp_path))
    told = refusal(write(folder, content))
    assert message.replace("ABSOLUTE", str(outside)) in told
    assert not re.search(r"lidarsim\d", told)


@pytest.mark.parametrize(
    ("body", "head"),
    [
        (GEOM, "<sensor><user dim='400000000'/></sensor>"),
        (GEOM, "<sensor>" + '<user dim="9000000"/>' * 3 + "</sensor>"),  # no single one of them
        ('<geom name="g" size="1"/>', "<sensor><contact geom1='g' num='4e8'/></sensor>"),
        ('<camera name="c" resolution="20000 20000"/>', "<sensor><rangefinder camera='c'/></sensor>"),
        (GEOM, "<sensor><clock nsample='400000000'/></sensor>"),
        (GEOM, "<sensor><user dim='9000' nsample='9000'/></sensor>"),
        (GEOM, "<actuator><motor joint='j' nsample='400000000'/></actuator>"),
        (GEOM, "<actuator><general joint='j' dyntype='user' actdim='400000000'/></actuator>"),
        (GEOM, "<default><motor nsample='9000000'/></default>"),
        (GEOM, "<custom><numeric name='n' data='1' size='400000000'/></custom>"),
        (GEOM * 40, "<size nuser_geom='1000000'/>"),
        (GEOM * 40, "<size nkey='1000000'/>"),
        (GEOM * 400, f"<keyframe>{'<key/>' * 9000}</keyframe>"),
        (f"{GEOM * 4000}<geom size='1' user='{'1 ' * 9000}'/>", ""),
        (GEOM, "<asset><hfield name='h' nrow='900' ncol='900' size='1 1 1 1'/></asset>" * 2),
        (GEOM, "<asset><mesh name='m' builtin='supersphere' params='400 1 1'/></asset>" * 3),
        (f"<replicate count='9000'>{GEOM}</replicate>", "<size nuser_geom='9000'/>"),
        ('<geom name="g" size="1"/>', TACTILE),
    ],
)
def test_counts_of_a_whole_document_are_limited(body: str, head: str, tmp_path: Path) -> None:
    assert "expected at most 20,000,000 numbers" in refusal(write(tmp_path, model(body, head)))


def test_heights_of_images_count_together(tmp_path: Path) -> None:
    """A picture of one colour takes a few kilobytes."""
    PIL.Image.new("L", (900, 900)).save(tmp_path / "h.png")
    fields = "".join(f'<hfield name="h{k}" file="h.png" size="1 1 1 1"/>' for k in range(2))
    assert "expected at most 20,000,000 numbers, got more" in refusal(
        write(tmp_path, model(GEOM, f"<asset>{fields}</asset>"))
    )


def test_files_that_are_named_again_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = box(tmp_path / "box.stl").stat().st_size
    monkeypatch.setattr(_mjcf, "NUMBERS", 10 * (size // 12))
    for count in (10, 12):
        meshes = "".join(f'<mesh name="m{k}" file="box.stl"/>' for k in range(count))
        path = write(tmp_path, model(GEOM, f"<asset>{meshes}</asset>"))
        if count == 10:
            assert len(ls.Scene.from_file(path)) == 1
        else:
            assert "numbers, got more" in refusal(path)


def test_ordinary_sensors_are_read(tmp_path: Path) -> None:
    sensors = '<rangefinder camera="c"/><user dim="90"/><clock nsample="50"/><contact geom1="g" num="9"/>'
    body = '<camera name="c" resolution="64 48"/><geom name="g" size="1" user="1 2 3"/>'
    path = write(tmp_path, model(body, f"<sensor>{sensors}</sensor><keyframe><key/></keyframe>"))
    assert len(ls.Scene.from_file(path)) == 1


@pytest.mark.parametrize(
    "before",
    [
        f"<!--{' licence' * 20_000}-->",
        "\ufeff",
        "\ufeff<?xml version='1.0'?>\n<!--" + "line\n" * 70_000 + "-->",
        " " * 70_000,
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_models_are_recognised_by_their_root_element(before: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    before = before.removeprefix("\ufeff") if encoding == "utf-16" else before  # which writes one itself
    path.write_text(before + model(GEOM), encoding=encoding)
    assert len(ls.Scene.from_file(path)) == 1
    path.write_text(before + model(GEOM).replace("mujoco", "svg"), encoding=encoding)
    with pytest.raises(FileFormatError, match="expected a scene of one of these kinds"):
        ls.Scene.from_file(path)


@pytest.mark.parametrize("name", ["world.xml", "model.sdf", "empty.world"])
def test_sdf_names_a_converter(name: str, tmp_path: Path) -> None:
    path = write(tmp_path, "<?xml version='1.0'?><sdf version='1.9'><world name='w'/></sdf>", name)
    assert "SDF of Gazebo is not read; convert it to MJCF with gz-mujoco" in refusal(path)
    with pytest.raises(FileFormatError, match="SDF of Gazebo is not read"):
        ls.mujoco.World(path)


@pytest.mark.parametrize(
    "content",
    [
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="a.xacro"/></robot>',
        '<robot><link name="${prefix}base"/></robot>',
        '<robot><link name="a"><visual><geometry><mesh filename="$(find p)/a.stl"/></geometry></visual></link></robot>',
    ],
)
@pytest.mark.parametrize("name", ["robot.urdf", "robot.urdf.xacro"])
def test_xacro_names_its_expander(content: str, name: str, tmp_path: Path) -> None:
    assert "xacro is not read; convert it to URDF with xacro" in refusal(write(tmp_path, content, name))


def test_models_that_attach_each_other_multiply(tmp_path: Path) -> None:
    attach = "".join(f'<attach model="m" body="b" prefix="{k}/"/>' for k in range(10))
    write(tmp_path, model(f'<body name="b">{GEOM}</body>'), "m0.xml")
    for k in range(1, 6):
        head = f'<asset><model name="m" file="m{k - 1}.xml"/></asset>'
        write(tmp_path, model(f'<body name="b">{attach}</body>', head), f"m{k}.xml")
    assert len(ls.Scene.from_file(tmp_path / "m2.xml")) == 100
    assert "expected at most 20,000 copies of elements" in refusal(tmp_path / "m5.xml")


def test_models_that_name_each_other_multiply(tmp_path: Path) -> None:
    write(tmp_path, model(f'<body name="b">{GEOM}</body>'), "m0.xml")
    for k in range(1, 8):
        names = "".join(f'<model name="m{i}" file="m{k - 1}.xml"/>' for i in range(10))
        write(tmp_path, model(GEOM, f"<asset>{names}</asset>"), f"m{k}.xml")
    assert len(ls.Scene.from_file(tmp_path / "m2.xml")) == 1
    assert "expected at most 20,000 copies of elements" in refusal(tmp_path / "m7.xml")


def test_memory_is_not_counted(tmp_path: Path) -> None:
    assert len(ls.Scene.from_file(write(tmp_path, model(GEOM, '<size memory="1000000000"/>')))) == 1


def test_relative_paths_of_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, model('<include file="robot.xml"/>'))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileFormatError, match=r"^robot\.xml:4: 'robot\.xml' is included already$"):
        ls.Scene.from_file("robot.xml")


def test_warnings_are_logged_and_leave_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    told: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(told.append)
    try:
        write(tmp_path, model(f'<body name="b">{GEOM}</body>', '<option timestep="0.004"/>'), "part.xml")
        head = (
            '<compiler conflict="warning"/><option timestep="0.003"/><asset><model name="p" file="part.xml"/></asset>'
        )
        path = write(tmp_path, model('<attach model="p" body="b" prefix="p/"/>', head))
        assert len(ls.Scene.from_file(path)) == 1
        assert f"{path}: MuJoCo: Attach conflict" in caplog.text
        assert told == []
        assert list(work.iterdir()) == []
        mujoco.MjModel.from_xml_path(str(path))
        assert len(told) == 1  # the handler of the user is in place again
    finally:
        mujoco.set_mju_user_warning(before)


@pytest.mark.parametrize(
    ("name", "content", "known"),
    [
        ("a.xml", "<mujoco/>", True),
        ("a.URDF", '\ufeff<?xml version="1.0"?>\n<!-- <a> -->\n<robot name="r">', True),
        ("a.xml", "<annotation/>", False),
        ("a.xml", "<!--a-->" * 5000 + "<annotation/>", False),
        ("a.xml", "<mujocoinclude/>", False),
        ("a.txt", "<mujoco/>", False),
    ],
)
def test_what_is_recognised(name: str, content: str, known: bool, tmp_path: Path) -> None:
    path = write(tmp_path, content, name)
    assert mjcf.recognise(path) is known
    if not known:
        with pytest.raises(FileFormatError, match="expected a scene of one of these kinds"):
            ls.Scene.from_file(path)


def test_flexes_are_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    flex = '<flexcomp name="f" type="grid" count="3 3 1" spacing="1 1 1" dim="2" radius="0.1"/>'
    scene = ls.Scene.from_file(write(tmp_path, model(flex + GEOM)))
    assert [type(item.shape).__name__ for item in scene] == ["Sphere"]
    assert "left out: flexes (1)" in caplog.text


Edit = Callable[[str], str]
EDITS: dict[str, Edit] = {
    "comments": lambda text: text.replace("<worldbody>", "<!-- one\ntwo -->\n<worldbody>"),
    "attributes on lines of their own": lambda text: text.replace("<geom ", "<geom\n "),
    "signs": lambda text: text.replace('name="it"', 'name="&lt;it&gt; &amp; &quot;&#39;&#233;"'),
    "another encoding": lambda text: f'<?xml version="1.0" encoding="iso-8859-1"?>{text}',
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_documents_mean_the_same_to_mujoco(edit: Edit, tmp_path: Path) -> None:
    text = edit(model('<geom name="it" size="1"/>\n<geom size="0.5"/>'))
    scene = ls.Scene.from_file(write(tmp_path, text))
    reference = mujoco.MjModel.from_xml_string(text)
    assert [item.name for item in scene] == [reference.geom(0).name, "world/1"]
    broken = text.replace('"0.5"', '"0.5" kind="x"')
    with pytest.raises(ValueError, match="line") as theirs:
        mujoco.MjModel.from_xml_string(broken)
    told = refusal(write(tmp_path, broken))
    assert told.endswith(" ".join(str(theirs.value).split()))
