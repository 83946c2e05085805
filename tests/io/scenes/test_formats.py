"""COLLADA, OBJ and the formats that are not read: against other readers and by hand."""

from __future__ import annotations

import logging
import re
import tracemalloc
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest
import trimesh

import lidarsim as ls
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.io.scenes import mesh_files
from lidarsim.io.scenes.others import CONVERTERS
from lidarsim.viewers.open3d import import_open3d

ROUNDING = 2.0**-53
"""Largest relative error of a float64 that is rounded once."""

REC_709 = np.array([0.2126, 0.7152, 0.0722])


def refusal(path: Path, **options: Any) -> str:
    with pytest.raises(FileFormatError) as caught:
        ls.Scene.from_file(path, **options)
    text = str(caught.value)
    assert text.startswith(f"{path}: cannot be read as a scene: ")
    return text.removeprefix(f"{path}: cannot be read as a scene: ")


def decode_srgb(value: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """IEC 61966-2-1."""
    encoded = np.asarray(value, float)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


# COLLADA

SQUARE = "0 0 0  4 0 0  4 4 0  0 4 0  2 1 0"
NOTCHED = """<polylist count="1" material="m"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>5</vcount><p>0 1 2 4 3</p></polylist>"""


def collada(
    nodes: str,
    faces: str = NOTCHED,
    *,
    unit: str = "",
    up: str = "<up_axis>Z_UP</up_axis>",
    positions: str = SQUARE,
    more: str = "",
) -> str:
    count = len(positions.split())
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{unit}{up}</asset>{more}
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="{count}">{positions}</float_array>
<technique_common><accessor source="#a" count="{count // 3}" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{faces}</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


ONE = '<node name="wall"><instance_geometry url="#g"/></node>'


def dae(folder: Path, *arguments: str, **options: str) -> Path:
    path = folder / "a.dae"
    path.write_text(collada(*arguments, **options), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("up", "expected"),
    [("X_UP", (-2.0, -3.0, 1.0)), ("Y_UP", (1.0, -3.0, 2.0)), ("Z_UP", (1.0, 2.0, 3.0)), ("", (1.0, -3.0, 2.0))],
)
def test_collada_declares_axes_and_unit(up: str, expected: tuple[float, ...], tmp_path: Path) -> None:
    """x up: COLLADA 1.4.1, table of up_axis: right is −y, in is z."""
    path = dae(
        tmp_path,
        '<node><translate>1 2 3</translate><instance_geometry url="#g"/></node>',
        unit='<unit name="inch" meter="0,0254"/>',  # with the decimal comma of some programs
        up=up and f"<up_axis>{up}</up_axis>",
    )
    (item,) = ls.Scene.from_file(path)
    assert item.transform is not None
    np.testing.assert_allclose(item.transform[:3, 3], np.multiply(expected, 0.0254), rtol=4 * ROUNDING)
    assert np.linalg.det(item.transform) == pytest.approx(0.0254**3, rel=16 * ROUNDING)
    (item,) = ls.Scene.from_file(path, up="z", unit=2.0)
    assert item.transform is not None
    assert item.transform[:3, 3].tolist() == [2, 4, 6]


def test_collada_keeps_float64_and_concave_polygons(tmp_path: Path) -> None:
    positions = "500000.123 0 0  500004.123 0 0  500004.123 4 0  500000.123 4 0  500002.123 1 0"
    (item,) = ls.Scene.from_file(dae(tmp_path, ONE, positions=positions))
    assert item.name == "wall"
    hits = item.shape.cast([[500002.123, 3, 1], [500000.5, 2, 1], [500002.123, 0.5, 1]], [[0, 0, -1]] * 3)
    assert hits.hit.tolist() == [False, True, True]
    assert item.shape.vertices[0, 0] == 500000.123  # type: ignore[attr-defined]


def test_collada_nodes(tmp_path: Path) -> None:
    nodes = """<node id="top" name="top"><scale>2 2 2</scale><rotate>0 0 1 90</rotate><instance_camera url="#none"/>
    <node id="below"><translate>1 0 0</translate><instance_geometry url="#g"/><instance_geometry url="#g"/></node>
    <instance_node url="#lib"/></node><node name="last"><instance_geometry url="#g"/></node>"""
    library = '<library_nodes><node id="lib" name="of the library"><instance_geometry url="#g"/></node></library_nodes>'
    scene = ls.Scene.from_file(dae(tmp_path, nodes, more=library))
    assert [(item.name, item.instance) for item in scene] == [
        ("below", 1),
        ("below", 1),
        ("of the library", 1),
        ("last", 4),
    ]
    assert len({id(item.shape) for item in scene}) == 1
    matrix = scene[0].transform
    assert matrix is not None
    assert matrix.tolist() == [[0, -2, 0, 0], [2, 0, 0, 2], [0, 0, 2, 0], [0, 0, 0, 1]]


def test_collada_nodes_may_look_at_a_point(tmp_path: Path) -> None:
    """The eye is the origin of the node, its −z axis points at the interest, and up lies in the plane of y and z."""
    camera = "<node><lookat>9 9 9 0 0 0 0 0 1</lookat><instance_camera url='#none'/></node>"
    nodes = "<node><lookat>{}</lookat><instance_geometry url='#g'/></node>"
    (item,) = ls.Scene.from_file(dae(tmp_path, camera + nodes.format("1 2 3 1 7 3 5 -4 0")))
    assert item.transform is not None
    assert item.transform.tolist() == [[0, 1, 0, 1], [0, 0, -1, 2], [-1, 0, 0, 3], [0, 0, 0, 1]]
    rng = np.random.default_rng(6)
    eye, interest, up = rng.uniform(-5, 5, (3, 3))
    numbers = " ".join(map(str, (*eye, *interest, *up)))
    (item,) = ls.Scene.from_file(dae(tmp_path, nodes.format(numbers)))
    assert item.transform is not None
    expected = np.linalg.solve(item.transform, [*interest, 1])
    near = 64 * ROUNDING * 10  # some dozens of roundings of numbers up to 10
    np.testing.assert_allclose(expected, [0, 0, -np.linalg.norm(interest - eye), 1], rtol=0, atol=near)
    turned = item.transform[:3, :3].T @ up
    assert abs(turned[0]) < near
    assert turned[1] > 0
    np.testing.assert_allclose(item.transform[:3, :3].T @ item.transform[:3, :3], np.eye(3), rtol=0, atol=near)
    assert np.linalg.det(item.transform) > 0


@pytest.mark.parametrize("angle", [30.0, -50.0, 0.0])
def test_collada_nodes_may_be_skewed(angle: float, tmp_path: Path) -> None:
    """The first axis turns by the angle towards the second, along which all points move, and what lies across stays."""
    rng = np.random.default_rng(9)
    for turned, moved in (([1, 0, 0], [0, 2, 0]), ([1, 0.5, 0.25], [0, 3, 0]), rng.uniform(-1, 1, (2, 3)).tolist()):
        skew = f"<skew>{angle} {' '.join(map(str, (*turned, *moved)))}</skew>"
        (item,) = ls.Scene.from_file(dae(tmp_path, f"<node>{skew}<instance_geometry url='#g'/></node>"))
        matrix = np.eye(3) if item.transform is None else item.transform[:3, :3]
        a, b = (np.array(axis) / np.linalg.norm(axis) for axis in (turned, moved))
        image = matrix @ a
        cross = np.cross(a, b)
        side = np.cross(cross, a) / np.linalg.norm(cross)  # across a, towards b
        found = np.degrees(np.arctan2(image @ side, image @ a))
        assert found == pytest.approx(angle, abs=1e4 * ROUNDING * 180)  # the tangents of angles to within 1° of 90°
        np.testing.assert_allclose(matrix @ cross, cross, rtol=0, atol=1e4 * ROUNDING)
        np.testing.assert_allclose(matrix @ b, b, rtol=0, atol=1e4 * ROUNDING)
        np.testing.assert_allclose(np.cross(matrix - np.eye(3), b, axisa=0, axisb=0), 0, rtol=0, atol=1e4 * ROUNDING)


MATRIX = '<node><matrix>1 0 0 5 0 1 0 0 0 0 1 0 {}</matrix><instance_geometry url="#g"/></node>'


@pytest.mark.parametrize("row", ["0 0 0 1", "0 0 0 1.0000001", "0 0 0 1.00000012", "-0 0 1e-60 0.99999994"])
def test_collada_matrices_end_in_the_row_of_an_affine_map(row: str, tmp_path: Path) -> None:
    (item,) = ls.Scene.from_file(dae(tmp_path, MATRIX.format(row)))
    assert item.transform is not None
    assert item.transform[3].tolist() == [0, 0, 0, 1]
    assert item.transform[0].tolist() == [1, 0, 0, 5]


HOLED = """<polygons count="2"><input semantic="VERTEX" source="#v" offset="0"/>
<ph><p>0 1 2 3</p><h>{}</h></ph><p>0 1 2</p></polygons>"""


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("order", ["4 5 6 7", "7 6 5 4"])
def test_collada_polygons_have_holes(turned: bool, order: str, tmp_path: Path) -> None:
    """A square of side 4 at x = y = 0 with a hole of side 2 in the middle, and a triangle 5 m above its half."""
    points = np.array([[0, 0], [4, 0], [4, 4], [0, 4], [1, 1], [3, 1], [3, 3], [1, 3]])
    corners = np.column_stack((points, points @ (0.5, 0.25)))[:, [1, 0, 2] if turned else [0, 1, 2]]
    path = dae(tmp_path, ONE, HOLED.format(order), positions=" ".join(map(str, corners.ravel().tolist())))
    (item,) = ls.Scene.from_file(path)
    assert isinstance(item.shape, ls.TriangleMesh)
    assert len(item.shape) == 9
    places = np.random.default_rng(3).uniform(0, 4, (500, 2))
    sheet = ls.TriangleMesh(item.shape.vertices, item.shape.faces[1:])
    hits = sheet.cast(np.column_stack((places, np.full(500, 9.0))), [[0, 0, -1]] * 500)
    inside = (np.abs(places - 2) < 1).all(axis=1)
    assert 0 < inside.sum() < 500
    np.testing.assert_array_equal(hits.hit, ~inside)
    assert (np.sign(hits.normal[hits.hit, 2]) == (-1 if turned else 1)).all()


PRIMITIVES = {
    "triangles": ('<triangles count="2">{}<p>0 1 2 0 2 3</p></triangles>', [[0, 1, 2], [0, 2, 3]]),
    "polygons": ('<polygons count="2">{}<p>0 1 2 3</p><p>0 1 4</p></polygons>', [[0, 1, 2], [0, 2, 3], [0, 1, 4]]),
    "fans": ('<trifans count="2">{}<p>0 1 2 3</p><p>4 1 2</p></trifans>', [[0, 1, 2], [0, 2, 3], [4, 1, 2]]),
    "strips": ('<tristrips count="1">{}<p>0 1 2 3 4</p></tristrips>', [[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
}


@pytest.mark.parametrize(("text", "expected"), PRIMITIVES.values(), ids=PRIMITIVES)
def test_collada_primitives(text: str, expected: list[list[int]], tmp_path: Path) -> None:
    faces = text.format('<input semantic="VERTEX" source="#v" offset="0"/>')
    (item,) = ls.Scene.from_file(dae(tmp_path, ONE, faces))
    points = np.array(SQUARE.split(), float).reshape(-1, 3)
    assert isinstance(item.shape, ls.TriangleMesh)
    np.testing.assert_array_equal(item.shape.vertices[item.shape.faces], points[expected])


def test_collada_lines_and_controllers_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    nodes = f'{ONE}<node><instance_controller url="#c"/></node>'
    morph = '<library_controllers><controller id="c"><morph source="#g"/></controller></library_controllers>'
    path = dae(tmp_path, nodes, f'{NOTCHED}<lines count="0"><p/></lines>', more=morph)
    with caplog.at_level(logging.WARNING, "lidarsim"):
        assert len(ls.Scene.from_file(path)) == 1
    assert caplog.messages == [f"{path}: left out: lines (1), morphed meshes (1)"]


def test_collada_is_what_trimesh_reads(tmp_path: Path) -> None:
    path = tmp_path / "a.dae"
    path.write_bytes(trimesh.exchange.dae.export_collada(trimesh.creation.icosphere(subdivisions=2)))
    (item,), mesh = ls.Scene.from_file(path, up="z", unit=1), trimesh.load_mesh(path, process=False)
    assert isinstance(item.shape, ls.TriangleMesh)
    ours, theirs = item.shape.vertices[item.shape.faces], mesh.vertices[mesh.faces]
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=2.0**-24)  # it keeps float32


def test_collada_ids_that_geometries_repeat_are_their_own(tmp_path: Path) -> None:
    path = tmp_path / "a.dae"
    boxes = [
        trimesh.creation.box(sides, trimesh.transformations.translation_matrix(sides))
        for sides in [(1, 2, 3), (4, 5, 6)]
    ]
    path.write_bytes(trimesh.exchange.dae.export_collada(boxes))
    assert path.read_text().count('id="verts-array"') == 2
    scene = ls.Scene.from_file(path, up="z", unit=1)
    assert len(scene) == 2
    for item, box in zip(scene, boxes, strict=True):
        np.testing.assert_array_equal(item.bounds, box.bounds)


def test_collada_skins_that_repeat_ids_have_their_own_joints(tmp_path: Path) -> None:
    skin = skin_xml("Name_array", "hip knee")
    other = skin.replace('id="c"', 'id="d"').replace(">0.25 0.75<", ">0.75 0.25<")
    nodes = SKIN_NODES.replace('url="#c"', 'url="#d"')
    alone = dae(tmp_path, nodes, more=other)
    (expected,) = ls.Scene.from_file(alone)
    (item,) = ls.Scene.from_file(dae(tmp_path, nodes, more=skin + other))
    np.testing.assert_array_equal(item.shape.vertices, expected.shape.vertices)  # type: ignore[attr-defined]


COLORED = """<library_images><image id="i"><init_from>sub%20folder/i.png</init_from></image></library_images>
<library_materials><material id="m1" name="Paint"><instance_effect url="#e"/></material></library_materials>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique sid="t"><phong><diffuse>{}</diffuse></phong></technique></profile_COMMON></effect></library_effects>"""
BOUND = """<node name="n"><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="m" target="#m1"/></technique_common></bind_material></instance_geometry></node>"""


def test_collada_colors(tmp_path: Path) -> None:
    path = dae(tmp_path, BOUND, more=COLORED.format("<color>0.5 0.25 1 1</color>"))
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    assert item.material.reflectivity == pytest.approx(decode_srgb([0.5, 0.25, 1]) @ REC_709, rel=4 * ROUNDING)
    (item,) = ls.Scene.from_file(path, rules=[ls.Rule(material="Paint", label=7)])
    assert (item.label, item.material.reflectivity) == (7, 1.0)


def test_collada_textures(tmp_path: Path) -> None:
    (tmp_path / "sub folder").mkdir()
    pixels = np.random.default_rng(1).integers(0, 256, (3, 4, 3), np.uint8)
    PIL.Image.fromarray(pixels).save(tmp_path / "sub folder" / "i.png")
    places = """<source id="t"><float_array id="ta">0 0 1 0 0.5 0.25</float_array><technique_common>
    <accessor source="#ta" count="3" stride="2"><param name="S" type="float"/><param name="T" type="float"/></accessor>
    </technique_common></source>"""
    faces = """<triangles count="1" material="m"><input semantic="VERTEX" source="#v" offset="0"/>
    <input semantic="TEXCOORD" source="#t" offset="1" set="0"/><p>0 2 1 1 2 0</p></triangles>"""
    more = COLORED.format('<texture texture="sa" texcoord="UV"/>')
    path = dae(tmp_path, BOUND, places + faces, more=more)
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    assert isinstance(item.material.reflectivity, ls.Texture)
    np.testing.assert_allclose(item.material.reflectivity.values, decode_srgb(pixels / 255) @ REC_709, rtol=2.0**-24)
    assert item.material.texture_coordinates is not None
    assert item.material.texture_coordinates.tolist() == [[[0.5, 0.75], [1, 1], [0, 1]]]
    assert (item.material.reflectivity.wrap, item.material.reflectivity.interpolation) == (("repeat",) * 2, "linear")
    sampler = "<wrap_s>CLAMP</wrap_s><wrap_t>MIRROR</wrap_t><minfilter>LINEAR</minfilter><magfilter>NEAREST</magfilter>"
    dae(tmp_path, BOUND, places + faces, more=more.replace("</sampler2D>", f"{sampler}</sampler2D>"))
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    assert isinstance(item.material.reflectivity, ls.Texture)
    assert item.material.reflectivity.wrap == ("clamp", "mirror")
    assert item.material.reflectivity.interpolation == "nearest"
    (tmp_path / "sub folder" / "i.png").unlink()
    assert len(ls.Scene.from_file(path)) == 1
    assert refusal(path, reflectivity="color") == "it names a file that is not there"


def skin_xml(names: str, joints: str, weights: str = "0 0 1 1  0 0 1 1  0 0 1 1  0 0 1 1  0 0 1 1") -> str:
    """A skin of two joints, which have a quarter and three quarters of each vertex."""
    matrices = [np.diag([2.0, 1, 1, 1]), np.array([[0, 1, 0, 3], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])]
    numbers = " ".join(str(x) for matrix in matrices for x in matrix.ravel())
    return f"""<library_controllers><controller id="c"><skin source="#g">
    <bind_shape_matrix>1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1</bind_shape_matrix>
    <source id="j"><{names} count="2">{joints}</{names}></source>
    <source id="m"><float_array id="ma" count="32">{numbers}</float_array><technique_common>
    <accessor source="#ma" count="2" stride="16"><param type="float4x4"/></accessor></technique_common></source>
    <source id="w"><float_array id="wa" count="2">0.25 0.75</float_array><technique_common>
    <accessor source="#wa" count="2" stride="1"><param type="float"/></accessor></technique_common></source>
    <joints><input semantic="JOINT" source="#j"/><input semantic="INV_BIND_MATRIX" source="#m"/></joints>
    <vertex_weights count="5"><input semantic="JOINT" source="#j" offset="0"/>
    <input semantic="WEIGHT" source="#w" offset="1"/><vcount>2 2 2 2 2</vcount><v>{weights}</v></vertex_weights>
    </skin></controller></library_controllers>"""


SKIN_NODES = """<node name="body"><translate>100 0 0</translate><instance_controller url="#c"><skeleton>#root</skeleton>
</instance_controller></node><node id="root" sid="hip"><translate>0 0 5</translate>
<node id="knee_id" sid="knee"><rotate>0 0 1 90</rotate></node></node>"""


@pytest.mark.parametrize(("names", "joints"), [("Name_array", "hip knee"), ("IDREF_array", "root knee_id")])
def test_collada_skins_are_at_rest(names: str, joints: str, tmp_path: Path) -> None:
    """Each vertex by the formula of the specification, in homogeneous coordinates."""
    (item,) = ls.Scene.from_file(dae(tmp_path, SKIN_NODES, more=skin_xml(names, joints)))
    assert (item.name, item.transform) == ("body", None)
    shape = np.eye(4)
    shape[0, 3] = 1
    hip = np.eye(4)
    hip[2, 3] = 5
    knee = hip @ [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    inverse = [np.diag([2.0, 1, 1, 1]), np.array([[0, 1, 0, 3], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])]
    points = np.array(SQUARE.split(), float).reshape(-1, 3)
    expected = [
        sum(w * j @ i @ shape @ [*point, 1] for w, j, i in zip((0.25, 0.75), (hip, knee), inverse, strict=True))[:3]
        for point in points
    ]
    np.testing.assert_allclose(item.shape.vertices, expected, rtol=8 * ROUNDING)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (skin_xml("Name_array", "hip elbow"), "joint 'elbow': expected a node of the scene"),
        (skin_xml("Name_array", "hip"), "controller of '#g': expected 1 INV_BIND_MATRIX, one a joint, got 2"),
        (
            skin_xml("Name_array", "hip knee", "0 0"),
            "controller of '#g': expected 5 counts and indices for each, got 5",
        ),
        (
            skin_xml("Name_array", "hip knee", "0 0 2 1 " * 5),
            "controller of '#g': expected joints below 2 and weights below 2",
        ),
    ],
)
def test_wrong_skins_of_collada(text: str, message: str, tmp_path: Path) -> None:
    assert refusal(dae(tmp_path, SKIN_NODES, more=text)).startswith(message)


def test_collada_in_an_archive(tmp_path: Path) -> None:
    content = BytesIO()
    PIL.Image.new("RGB", (2, 2), "white").save(content, "PNG")
    places = """<source id="t"><float_array id="ta">0 0</float_array><technique_common>
    <accessor source="#ta" count="1" stride="2"/></technique_common></source>"""
    faces = """<triangles count="1" material="m"><input semantic="VERTEX" source="#v" offset="0"/>
    <input semantic="TEXCOORD" source="#t" offset="1"/><p>0 0 1 0 2 0</p></triangles>"""
    text = collada(BOUND, places + faces, more=COLORED.format('<texture texture="sa"/>'))
    manifest = "<dae_root>deep/a.dae</dae_root>"
    path = tmp_path / "a.zae"
    for number, files in enumerate(
        ({"deep/a.dae": text}, {"deep/a.dae": text, "b.dae": "", "manifest.xml": f"<x>{manifest}</x>"}, {"b.txt": ""})
    ):
        with zipfile.ZipFile(path, "w") as archive:
            for name, words in files.items():
                archive.writestr(name, words)
            archive.writestr("deep/sub folder/i.png", content.getvalue())
        if number < 2:
            (item,) = ls.Scene.from_file(path, reflectivity="color")
            assert isinstance(item.material.reflectivity, ls.Texture)
            assert item.material.reflectivity.values.tolist() == [[1, 1], [1, 1]]
    assert refusal(path) == "expected one COLLADA document in the archive, got 0"


def test_archives_that_are_bombs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.zae"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.dae", " " * (1 << 27))
    assert refusal(path) == "'a.dae': expected at most 100 bytes for each that it takes in the archive"
    path.write_bytes(path.read_bytes()[:-30])
    assert "not a zip file" in refusal(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.dae", "<a/>" * (1 << 20))
    assert "refused as a decompression bomb" in refusal(path)


WRONG_COLLADA = {
    "no XML": ("<COLLADA", "the file is damaged XML: line 1"),
    "entities": (
        '<!DOCTYPE x [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><COLLADA>&b;</COLLADA>',
        "expected XML without a document type",
    ),
    "other": ("<svg/>", "expected COLLADA as the first element"),
    "up": (collada(ONE, up="<up_axis>W_UP</up_axis>"), "asset/up_axis: expected X_UP, Y_UP, Z_UP"),
    "unit": (collada(ONE, unit='<unit meter="0"/>'), "asset/unit, meter: expected a finite number > 0, got 0.0"),
    "reference": (
        collada('<node><instance_geometry url="#x"/></node>'),
        "instance_geometry: expected the id of a geometry in this file, got '#x'",
    ),
    "cycle": (
        collada('<node id="n"><instance_node url="#n"/></node>'),
        "expected at most 1000 nodes in line",
    ),
    "row": (
        collada(MATRIX.format("0 0 0 1.0000003")),
        "node '0', matrix: expected (0, 0, 0, 1) as the last row, got [0.0, 0.0, 0.0, 1.0000003]",
    ),
    "view": (
        collada("<node><lookat>1 2 3 1 2 9 0 0 1</lookat></node>"),
        "node '0', lookat: expected an eye apart from its interest, and up not along its view",
    ),
    "skew": (
        collada("<node><skew>70 1 0 0 1 2 0</skew></node>"),
        "node '0', skew: expected two axes that differ in direction, and an angle less than that from the first to the",
    ),
    "skew along itself": (collada("<node><skew>6 1 0 0 2 0 0</skew></node>"), "node '0', skew: expected two axes"),
    "skew along nothing": (collada("<node><skew>6 1 0 0 0 0 0</skew></node>"), "node '0', skew: expected two axes"),
    "truncated": (
        collada(ONE).replace('count="5"', 'count="6"'),
        "source 'p': truncated, 15 of 18 numbers",
    ),
    "corners": (
        collada(ONE).replace("0 1 2 4 3", "0 1 2 4"),
        "geometry 'g', polylist: expected 1 faces of 5 corners in all, got 1 and 4 corners",
    ),
    "index": (
        collada(ONE).replace("0 1 2 4 3", "0 1 2 4 5"),
        "geometry 'g', polylist: faces: expected indices from 0 to 4, got faces[0][4] = 5",
    ),
    "negative": (collada(ONE).replace("0 1 2 4 3", "0 1 2 4 -1"), "geometry 'g', polylist: expected integers >= 0"),
    "infinite": (
        collada(ONE, positions=f"{SQUARE} INF 0 0"),
        "geometry 'g', polylist: vertices: expected finite numbers, got vertices[5][0] = inf",
    ),
    "words": (collada(ONE, positions="x y z"), "source 'p': expected numbers"),
    "matrix": (collada("<node><matrix>1 2 3</matrix></node>"), "node '0', matrix: expected 16 numbers, got 3"),
    "hole": (
        collada(ONE, HOLED.format("4 5")),
        "geometry 'g', polygons: expected an outline and holes of at least three corners",
    ),
    "index of a hole": (
        collada(ONE, HOLED.format("4 5 9")),
        "geometry 'g', polygons: faces: expected indices from 0 to 4, got faces[1][1] = 5",
    ),
    "nothing": (collada("<node/>"), "it holds no triangles"),
}


@pytest.mark.parametrize(("text", "message"), WRONG_COLLADA.values(), ids=WRONG_COLLADA)
def test_wrong_collada(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.dae"
    path.write_text(text, encoding="utf-8")
    assert refusal(path).startswith(message)


# OBJ and other mesh files


def test_obj_objects_are_nodes_of_several_materials(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(
        "mtllib none.mtl\nv 0 0 0\nv\t1 0 0\nv 0 1 0\no car\nusemtl red\nf 1 2 3\nusemtl glass\nf -3 -2 -1\n"
        "o road\nusemtl tar\nf 1 2 3\no car\nusemtl red\nf 3 2 1\n",
        encoding="utf-8",
    )
    scene = ls.Scene.from_file(path)
    assert [(item.name, item.instance, len(item.shape)) for item in scene] == [  # type: ignore[arg-type]
        ("car", 1, 2),
        ("car", 1, 1),
        ("road", 3, 1),
    ]
    scene = ls.Scene.from_file(path, rules=[ls.Rule(material="glass", skip=True), ls.Rule(node="car", label=2)])
    assert [(item.name, item.label) for item in scene] == [("car", 2), ("road", 0)]


def test_obj_objects_whose_faces_alternate_keep_their_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    points = np.column_stack((np.cumsum(rng.uniform(1, 2, 30)), np.linspace(0, 1, 30) ** 2, np.zeros(30)))
    faces: dict[str, list[list[int]]] = {}
    lines = [f"v {x} {y} {z}" for x, y, z in points.tolist()]
    for name in rng.choice(list("abcde"), 60):
        corners = rng.choice(30, 3, replace=False).tolist()
        faces.setdefault(name, []).append(corners)
        lines += [f"o {name}", "f " + " ".join(str(corner + 1) for corner in corners)]
    path = tmp_path / "a.obj"
    path.write_text("\n".join(lines), encoding="utf-8")
    scene = ls.Scene.from_file(path)
    assert [item.name for item in scene] == list(faces)
    for item, expected in zip(scene, faces.values(), strict=True):
        assert isinstance(item.shape, ls.TriangleMesh)
        np.testing.assert_array_equal(item.shape.vertices, points[np.unique(expected)])
        np.testing.assert_array_equal(item.shape.vertices[item.shape.faces], points[expected])


def test_memory_grows_with_the_number_of_objects_and_not_with_its_square(tmp_path: Path) -> None:
    peaks = []
    for count in (2000, 4000):
        path = tmp_path / "a.obj"
        lines = (f"o {k}\nf 1 2 3\nf 3 2 1\n" for k in range(count))
        path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "".join(lines), encoding="utf-8")
        tracemalloc.start()
        assert len(mesh_files.read(path).nodes) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 2.5 * peaks[0]


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".stl"])
def test_mesh_files_have_the_units_and_axes_that_are_given(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    trimesh.creation.box((1, 2, 3)).apply_translation((0, 0, 5)).export(path)
    np.testing.assert_array_equal(ls.Scene.from_file(path).bounds, [[-0.5, -1, 3.5], [0.5, 1, 6.5]])
    moved = ls.Scene.from_file(path, up="y", unit=0.5).bounds
    np.testing.assert_allclose(moved, [[-0.25, -3.25, -0.5], [0.25, -1.75, 0.5]], rtol=16 * ROUNDING)
    np.testing.assert_array_equal(ls.TriangleMesh.from_file(path).vertices[:, 2].max(), 6.5)


def test_obj_colors(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\no a\nusemtl red\nf 1 2 3\no b\nusemtl grey\nf 1 2 3\no c\nusemtl x\nf 1 2 3\n"
    path.write_text(f"mtllib my materials.mtl\n{faces}", encoding="utf-8")
    (tmp_path / "my materials.mtl").write_text("newmtl red\nKd 0.5 0 0\nnewmtl grey\nKd 0.5\n", encoding="utf-8")
    found = [item.material.reflectivity for item in ls.Scene.from_file(path, reflectivity="color")]
    half = float(decode_srgb(0.5))
    assert found == pytest.approx([0.2126 * half, half, 1.0], rel=4 * ROUNDING)
    path.write_text("v 0 0 0 1 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0 0 0 0\nf 1 2 3\n", encoding="utf-8")
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    np.testing.assert_allclose(item.material.reflectivity, [0.2126, half, 0.0], rtol=8 * ROUNDING)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_colors_of_vertices_are_those_that_trimesh_reads(encoding: str, tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.visual.vertex_colors = np.random.default_rng(8).integers(0, 256, (8, 4), np.uint8)
    ply, obj = tmp_path / "a.ply", tmp_path / "a.obj"
    ply.write_bytes(trimesh.exchange.ply.export_ply(box, encoding=encoding))
    obj.write_text(trimesh.exchange.obj.export_obj(box, digits=17), encoding="utf-8")
    for path in (ply, obj):
        (item,) = ls.Scene.from_file(path, reflectivity="color")
        loaded = trimesh.load_mesh(path, process=False)
        np.testing.assert_array_equal(item.shape.vertices, loaded.vertices)  # type: ignore[attr-defined]
        expected = decode_srgb(loaded.visual.vertex_colors[:, :3] / 255) @ REC_709
        np.testing.assert_allclose(item.material.reflectivity, expected, rtol=8 * ROUNDING)
        (item,) = ls.Scene.from_file(path)
        assert item.material.reflectivity == 1.0


PLY = """ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z
property {0} blue\nproperty {0} green\nproperty {0} red\nelement face 1
property list uchar int vertex_indices\nend_header
0 0 0 {1}\n1 0 0 0 0 0\n0 1 0 0 0 0\n3 0 1 2\n"""


@pytest.mark.parametrize(
    ("kind", "color", "expected"),
    [
        ("float", "1 0.5 0.25", [0.25, 0.5, 1]),
        ("uchar", "255 51 102", [0.4, 0.2, 1]),
        ("int", "255 51 102", [0.4, 0.2, 1]),
        ("float", "255 0 0", 255),
        ("ushort", "510 0 0", 2),
    ],
)
def test_colors_of_ply(
    kind: str, color: str, expected: list[float] | float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.ply"
    path.write_text(PLY.format(kind, color), encoding="utf-8")
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    if isinstance(expected, list):
        np.testing.assert_allclose(
            item.material.reflectivity, [decode_srgb(expected) @ REC_709, 0, 0], rtol=8 * ROUNDING
        )
        assert not caplog.messages
    else:
        message = f"colours of vertices (expected numbers from 0 to 1, got {expected})"
        assert caplog.messages == [f"{path}: left out: {message}"]
        assert item.material.reflectivity == 1.0


@pytest.mark.parametrize(
    ("vertices", "problem"),
    [
        ("v 0 0 0 255 0 0\nv 1 0 0 0 0 0\nv 0 1 0 0 0 0", "numbers from 0 to 1, got 255"),
        ("v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0", "three numbers behind the coordinates of each"),
        ("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0", ""),
        ("v 0 0 0 # the first of all\nv 1 0 0\nv 0 1 0", ""),
    ],
)
def test_colors_of_obj_that_are_not_read_are_reported(
    vertices: str, problem: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.obj"
    path.write_text(f"{vertices}\no a\nf 1 2 3\no b\nf 3 2 1\n", encoding="utf-8")
    assert [item.material.reflectivity for item in ls.Scene.from_file(path, reflectivity="color")] == [1.0, 1.0]
    expected = [f"{path}: left out: colours of vertices (expected {problem})"] if problem else []
    assert caplog.messages == expected


def test_obj_names_several_libraries_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl grey\nf 1 2 3\nusemtl dark\nf 1 2 3\n"
    path.write_text(f"mtllib a.mtl  b.mtl\n{faces}", encoding="utf-8")
    (tmp_path / "a.mtl").write_text("newmtl grey\nKd 0.5 0.5 0.5 # grey\n", encoding="utf-8")
    (tmp_path / "b.mtl").write_text("newmtl dark\nKd 0.25#\n", encoding="utf-8")
    found = [item.material.reflectivity for item in ls.Scene.from_file(path, reflectivity="color")]
    assert found == pytest.approx(decode_srgb([0.5, 0.25]).tolist(), rel=4 * ROUNDING)
    path.write_text(f"mtllib a.mtl ../b.mtl\n{faces}", encoding="utf-8")
    assert refusal(path, reflectivity="color") == "mtllib '../b.mtl': it names a file that is not there"
    (tmp_path.parent / "b.mtl").touch()
    message = "mtllib '../b.mtl': it names something that is no regular file beside or below it"
    assert refusal(path, reflectivity="color") == message


def test_obj_textures(tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (2, 2, 3), np.uint8)
    PIL.Image.fromarray(pixels).save(tmp_path / "my image.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 0.5 0.5 0.5\nmap_Kd -clamp on my image.png\n", encoding="utf-8")
    path = tmp_path / "a.obj"
    path.write_text(
        "mtllib a.mtl\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nvt 0 0\nvt 1 0\nusemtl m\nf 1/1 2/-1 3/2/7\n"
        "vt 1 0.75\nvt 0 1\no other\nf 1/1 2/2 3/-2 4/4\n",
        encoding="utf-8",
    )
    first, second = ls.Scene.from_file(path, reflectivity="color")
    assert isinstance(first.material.reflectivity, ls.Texture)
    expected = decode_srgb(0.5) * (decode_srgb(pixels / 255) @ REC_709)
    np.testing.assert_allclose(first.material.reflectivity.values, expected, rtol=2.0**-24)
    assert first.material.reflectivity is second.material.reflectivity
    assert first.material.texture_coordinates is not None
    assert second.material.texture_coordinates is not None
    assert first.material.texture_coordinates.tolist() == [[[0, 1], [1, 1], [1, 1]]]
    assert second.material.texture_coordinates.tolist() == [[[0, 1], [1, 1], [1, 0.25]], [[0, 1], [1, 0.25], [0, 0]]]


@pytest.mark.parametrize(
    ("options", "wrap"),
    [
        ("", "repeat"),
        ("-s 1 1 1", "repeat"),
        ("-s 1.000000 1.000000 1.000000 -o 0.0 0 0", "repeat"),
        ("-o 0", "repeat"),
        ("-mm 0 1 -bm 0.5 -t 0 0 0", "repeat"),
        ("-blendu on -blendv off -cc off -imfchan l -texres 512 -boost 2", "repeat"),
        ("-clamp off", "repeat"),
        ("-clamp on -s 1 1", "clamp"),
    ],
)
@pytest.mark.parametrize("name", ["a.png", "of 2  kinds.png", '"a b.png"', "sub\\a.png"])
def test_options_of_textures_that_change_nothing(options: str, wrap: str, name: str, tmp_path: Path) -> None:
    file = tmp_path / name.strip('"').replace("\\", "/")
    file.parent.mkdir(exist_ok=True)
    PIL.Image.new("RGB", (2, 2), "white").save(file)
    (tmp_path / "a b.mtl").write_text(f"newmtl m\nmap_Kd {options} {name}\n", encoding="utf-8")
    path = tmp_path / "a.obj"
    path.write_text('mtllib "a b.mtl"\nv 0 0 0\nv 4 0 0\nv 4 4 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n', encoding="utf-8")
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    assert isinstance(item.material.reflectivity, ls.Texture)
    assert item.material.reflectivity.wrap == (wrap, wrap)


@pytest.mark.parametrize("option", ["-s 1 2", "-o 0.5", "-t 0 0 1", "-mm 0.1 1", "-mm 0 2"])
def test_options_of_textures_that_are_not_supported(option: str, tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text(f"newmtl m\nmap_Kd {option} a.png\n", encoding="utf-8")
    path = tmp_path / "a.obj"
    path.write_text("mtllib a.mtl\nv 0 0 0\nv 4 0 0\nv 4 4 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n", encoding="utf-8")
    assert f"map_Kd: its option {option.partition(' ')[0]} is not supported, except" in refusal(
        path, reflectivity="color"
    )


def test_textures_of_16_bits_are_read_to_the_nearest_of_8(tmp_path: Path) -> None:
    grey = np.array([[0, 128, 129, 255], [256, 257 * 127, 257 * 128 + 128, 65535]])
    PIL.Image.fromarray(grey.astype(np.uint16)).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n", encoding="utf-8")
    path = tmp_path / "a.obj"
    path.write_text("mtllib a.mtl\nv 0 0 0\nv 4 0 0\nv 4 4 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n", encoding="utf-8")
    (item,) = ls.Scene.from_file(path, reflectivity="color")
    assert isinstance(item.material.reflectivity, ls.Texture)
    expected = decode_srgb(np.array([[0, 0, 1, 1], [1, 127, 128, 255]]) / 255)
    np.testing.assert_allclose(item.material.reflectivity.values, expected, rtol=2.0**-23)


def test_wrong_material_libraries(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n", encoding="utf-8")
    assert len(ls.Scene.from_file(path)) == 1
    assert refusal(path, reflectivity="color") == "mtllib 'a.mtl': it names a file that is not there"
    for text, message in (
        ("newmtl m\nKd x", "line 2: expected Kd and one or three numbers"),
        ("newmtl m\nKd # 0.5", "line 2: expected Kd and one or three numbers"),
        ("newmtl m\nmap_Kd ../a.png", "map_Kd '../a.png': it names a file that is not there"),
        ("newmtl m\nmap_Kd -s 2 2 1 a.png", "map_Kd: its option -s is not supported"),
        ("newmtl m\nmap_Kd /dev/zero", "map_Kd '/dev/zero': it names a file by other than a relative path"),
    ):
        (tmp_path / "a.mtl").write_text(text, encoding="utf-8")
        if "map_Kd" in text:
            path.write_text(path.read_text().replace("f 1 2 3", "vt 0 0\nf 1/1 2/1 3/1"), encoding="utf-8")
        assert message in refusal(path, reflectivity="color")


# Meshes of other libraries


def test_scenes_of_trimesh() -> None:
    scene, place, mirror = trimesh.Scene(), np.eye(4), np.diag([-1.0, 1, 1, 1])
    place[0, 3] = 10
    box = trimesh.creation.box()
    scene.add_geometry(box, transform=place)
    scene.add_geometry(box.copy(), transform=mirror)
    scene.add_geometry(trimesh.PointCloud([[99, 0, 0]]))
    mesh = ls.TriangleMesh.from_trimesh(scene)
    np.testing.assert_array_equal(
        mesh.vertices, np.concatenate([box.vertices + place[:3, 3], box.vertices * [-1, 1, 1]])
    )
    assert len(mesh) == 2 * len(box.faces)
    for start in ([20.0, 0.1, 0.2], [-20.0, 0.1, 0.2]):  # from either side, both boxes face the ray
        hits = mesh.cast([start], [[-np.sign(start[0]), 0, 0]])
        assert hits.normal[0].tolist() == [np.sign(start[0]), 0, 0]


def test_what_is_no_mesh_of_trimesh_is_named(tmp_path: Path) -> None:
    for given, message in (
        (None, "mesh: expected a trimesh.Trimesh or trimesh.Scene, got NoneType"),
        ("a.glb", "mesh: expected a trimesh.Trimesh or trimesh.Scene, got str; TriangleMesh.from_file reads files"),
        (tmp_path, "TriangleMesh.from_file reads files"),
        (trimesh.PointCloud([[0, 0, 0]]), "got PointCloud; Disks.from_points makes surfaces of points"),
    ):
        with pytest.raises(ArgumentTypeError, match=re.escape(message)):
            ls.TriangleMesh.from_trimesh(given)  # type: ignore[arg-type]
    with pytest.raises(ArgumentValueError, match=r"mesh: expected a trimesh.Scene with meshes, got one without"):
        ls.TriangleMesh.from_trimesh(trimesh.Scene())


def test_what_is_no_mesh_of_open3d_is_named() -> None:
    o3d = import_open3d()
    for given, message in (
        (None, "mesh: expected an Open3D TriangleMesh, got NoneType"),
        ("a.ply", "got str; TriangleMesh.from_file reads files"),
        (o3d.geometry.PointCloud(), "got PointCloud; Disks.from_points makes surfaces of points"),
        (o3d.geometry.LineSet(), "mesh: expected an Open3D TriangleMesh, got LineSet"),
        (o3d.t.geometry.PointCloud(), "mesh: expected an Open3D TriangleMesh, got PointCloud"),
        (o3d.t.geometry.LineSet(), "mesh: expected an Open3D TriangleMesh, got LineSet"),
    ):
        with pytest.raises(ArgumentTypeError, match=re.escape(message)):
            ls.TriangleMesh.from_open3d(given)  # type: ignore[arg-type]
    with pytest.raises(ArgumentValueError, match="mesh: expected positions of vertices and indices of triangles"):
        ls.TriangleMesh.from_open3d(o3d.t.geometry.TriangleMesh())
    assert len(ls.TriangleMesh.from_open3d(o3d.geometry.TriangleMesh())) == 0


# Formats that are not read


def test_archives_of_meshes_are_no_scenes(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(FileFormatError, match=r"a\.zip: expected a scene of one of these kinds"):
        ls.Scene.from_file(path)


@pytest.mark.parametrize("suffix", CONVERTERS)
def test_formats_that_are_not_read_name_a_converter(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix.upper()}"
    path.write_bytes(b"anything")
    target = "(GLB|OBJ|PLY|MJCF|URDF)( or GLB)?"
    assert re.fullmatch(rf"[\w ]+ is not read; convert it to {target} with [\w -]+", refusal(path))
    with pytest.raises(FileFormatError, match=r"is not read; convert it to"):
        ls.TriangleMesh.from_file(path)
