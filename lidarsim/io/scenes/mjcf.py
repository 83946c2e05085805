"""MuJoCo's models (``.xml``, ``.urdf``), read by mujoco into scenes of exact shapes.

Each geom becomes an object. It is named after the geom or, if that has no name, after its body and its number in it.
The objects of a body share an instance, except those of the world body. A ray meets what `mj_ray` meets, with these
differences:

- Planes are met from both sides; for MuJoCo they have only a front.
- A geom defined by a signed distance function is the mesh that MuJoCo draws for it.
- From within a height field, only its surface is met, not also the plane of height 0 that MuJoCo has there.

Flexes and skins are left out; `mj_ray` does not meet them either.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.files import LONGEST, PathLike, check_regular
from lidarsim._base.validation import Floats, integer, short_repr
from lidarsim._base.vectors import transforms
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.io.scenes._build import UNTOUCHED, Imported, Placed, report, scene_with
from lidarsim.io.scenes._mjcf import collect, root_of
from lidarsim.materials import Material
from lidarsim.world.rules import Appearance, Options, Rule
from lidarsim.world.scene import Scene, register_scene_reader
from lidarsim.world.shapes import Box, Capsule, Cylinder, Ellipsoid, Plane, Polygon, Shape, Sphere, TriangleMesh

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

GROUPS = 6
"""Number of groups of geoms; as in MuJoCo, the last one has those of all higher numbers, too."""

MAXVAL = 1e10
"""Largest number that MuJoCo takes for valid (``mjMAXVAL``)."""

_turn = Lock()

SHOWN = (0, 1, 2)
"""Groups that MuJoCo's viewers show by default."""


def mujoco_module() -> ModuleType:
    """Import and return mujoco."""
    return import_extra("mujoco", "mujoco", "reading models of MuJoCo")


def recognise(path: Path, _head: bytes = b"") -> bool:
    """Return whether a file is MJCF or URDF, by its suffix and root element; SDF is refused with a converter."""
    return path.suffix.lower() in {".xml", ".urdf", ".mjcf"} and root_of(path).lower() in {"mujoco", "robot", "sdf"}


def load(path: PathLike) -> tuple[MjModel, list[str]]:
    """Return the model that an MJCF or URDF file describes, without its textures, and what MuJoCo leaves out of it.

    It may name only files beside or below it.
    """
    mujoco, path = mujoco_module(), Path(path)
    check_regular(path)
    files = collect(path)
    with _log_warnings(mujoco, path):
        try:
            model = mujoco.MjModel.from_xml_string(files.xml, files.assets)
        except Exception as error:
            problem = " ".join(str(error).split()).removeprefix("Error: ")
            for name, original in files.names.items():
                problem = problem.replace(name, original)
            raise FileFormatError(f"{path}: MuJoCo cannot read it: {problem[:LONGEST]}") from error
    unseen = f'visuals of links without collision ({files.unseen:,}; discardvisual="false" keeps them)'
    return model, [unseen] if files.unseen else []


@contextmanager
def _log_warnings(mujoco: ModuleType, path: Path) -> Iterator[None]:
    """Log warnings of MuJoCo, which else writes them to MUJOCO_LOG.TXT in the working folder.

    MuJoCo has one handler for all threads: they take turns, so that the last one leaves that of the program.
    """
    logger = logging.getLogger("lidarsim")
    with _turn:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda text: logger.warning("%s: MuJoCo: %s", path, text))
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(before)


def read(path: Path, *, rules: tuple[Rule, ...] = (), reflectivity: Appearance = None) -> Scene:
    """Read a file as documented in `lidarsim.Scene.from_file`, which checks the options."""
    return scene_with(import_file(path, Options(rules=rules, reflectivity=reflectivity)))


def import_file(path: Path, options: Options) -> Imported:
    """Return the objects of a file, at least one, after checking that the options name neither an axis nor a unit."""
    for name in ("up", "unit"):
        if getattr(options, name) is not None:
            raise ArgumentValueError(name, "none, since MJCF and URDF are z up and in metres", getattr(options, name))
    model, left_out = load(path)
    try:
        _, found = objects(model, place_bodies(model), path, options)
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from error
    found.left_out.extend(left_out)
    if not found.objects and not found.skipped:
        others = f"; left out: {', '.join(found.left_out)}" * bool(found.left_out)
        raise FileFormatError(f"{path}: it holds no geoms that are seen{others}")
    report(path, found.left_out)
    return found


def place_bodies(model: MjModel, keyframe: int | str | None = None) -> MjData:
    """Return data with the poses of all bodies, those of a keyframe or else the model's own (``qpos0``)."""
    mujoco = mujoco_module()
    data = mujoco.MjData(model)
    if keyframe is not None:
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_KEY, key) for key in range(model.nkey)]
        number = names.index(keyframe) if isinstance(keyframe, str) and keyframe in names else keyframe
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < model.nkey:
            known = ", ".join(filter(None, names)) or "none has a name"
            expected = f"a keyframe of the model, 0 to {model.nkey - 1} or a name" if model.nkey else "None"
            raise ArgumentValueError(
                "keyframe", expected, short_repr(keyframe), f"names: {known}" if model.nkey else ""
            )
        mujoco.mj_resetDataKeyframe(model, data, number)
    mujoco.mj_kinematics(model, data)
    return data


def objects(
    model: MjModel, data: MjData, path: Path, options: Options, groups: Collection[int] = SHOWN
) -> tuple[list[int], Imported]:
    """Return the geoms that are objects, as data places them, and the objects."""
    mujoco = mujoco_module()
    wanted = _groups(groups)
    geoms = [geom for geom in range(model.ngeom) if _visible(model, geom) and _group(model, geom) in wanted]
    kept, found, without_rule = [], [], []
    shapes: dict[tuple[str, int], Shape] = {}
    for geom, place in zip(geoms, poses(data, geoms), strict=True):
        body = int(model.geom_bodyid[geom])
        named: str | None = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, geom)
        name = named or f"{body_name(model, body)}/{geom - model.body_geomadr[body]}"
        material: str = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_MATERIAL, int(model.geom_matid[geom])) or ""
        node = "/".join([*_bodies(model, body), name.rpartition("/")[2] if not named else name])
        rule = next((rule for rule in options.rules if rule.matches(node, material)), None)
        if options.rules and rule is None:
            without_rule.append(node)
        rule = rule or UNTOUCHED
        if rule.skip:
            continue
        appearance = options.reflectivity if rule.reflectivity is None else rule.reflectivity
        kept.append(geom)
        found.append(
            Placed(
                _shape(mujoco, model, geom, shapes),
                name if rule.name is None else rule.name,
                rule.label,
                _material(model, geom, appearance),
                _instance(geom, body, rule),
                rule.instance,
                place,
                material,
            )
        )
    others = {"flexes": int(model.nflex), "skins": int(model.nskin)}
    left_out = [f"{what} ({count:,})" for what, count in others.items() if count]
    return kept, Imported(path, found, len(geoms) - len(kept), left_out, without_rule)


def _instance(geom: int, body: int, rule: Rule) -> Hashable:
    """Return what the objects of one instance have in common: their body, unless a rule says otherwise."""
    if rule.instance == "file":
        return "file"
    # Things of the world body, such as floor and walls, are not parts of one.
    return ("node", geom) if rule.instance == "node" or not (body or rule.instance == "parent") else ("parent", body)


def _bodies(model: MjModel, body: int) -> list[str]:
    """Return the names of the bodies from the world on, without it, to a body."""
    names = []
    while body:
        names.append(body_name(model, body))
        body = int(model.body_parentid[body])
    return names[::-1]


def body_name(model: MjModel, body: int) -> str:
    """Return the name of a body, or else its number."""
    mujoco = mujoco_module()
    name: str | None = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body)
    return name or str(body)


def poses(data: MjData, geoms: Sequence[int] | npt.NDArray[np.intp]) -> Floats:
    """Return the poses of geoms, geom to world: shape (n, 4, 4)."""
    index = np.asarray(geoms, np.intp)
    return transforms(np.reshape(data.geom_xmat[index], (-1, 3, 3)), data.geom_xpos[index])


def _groups(groups: object) -> set[int]:
    if isinstance(groups, str) or not isinstance(groups, Collection):
        raise ArgumentTypeError("groups", f"a sequence of integers from 0 to {GROUPS - 1}", short_repr(groups))
    return {integer(f"groups[{i}]", group, at_least=0, at_most=GROUPS - 1) for i, group in enumerate(groups)}


def _material(model: MjModel, geom: int, appearance: Appearance) -> Material | None:
    """Return the material of a geom."""
    if appearance is None or isinstance(appearance, Material):
        return appearance
    return Material(reflectivity=_luminance(model, geom) if appearance == "color" else appearance)


def _group(model: MjModel, geom: int) -> int:
    return min(max(int(model.geom_group[geom]), 0), GROUPS - 1)


def _visible(model: MjModel, geom: int) -> bool:
    """Return whether rays meet a geom: not if its material or, without one, the geom itself is transparent."""
    material = model.geom_matid[geom]
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return bool(rgba[3] != 0)


def _luminance(model: MjModel, geom: int) -> float:
    """Return the luminance of a geom's colour: its own, if it is not the default, or else that of its material."""
    material, rgba = model.geom_matid[geom], model.geom_rgba[geom]
    if material >= 0 and np.array_equal(rgba, np.array([0.5, 0.5, 0.5, 1.0], rgba.dtype)):
        rgba = model.mat_rgba[material]
    color = np.clip(np.asarray(rgba[:3], np.float64), 0.0, 1.0)
    luminance: Any = Material.from_colors(color[None]).reflectivity
    return float(luminance[0])


def _shape(mujoco: ModuleType, model: MjModel, geom: int, shared: dict[tuple[str, int], Shape]) -> Shape:
    """Return the shape of a geom in its own coordinates; geoms of one mesh or height field share it."""
    kind = mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_")
    if kind in _SHAPES:
        return _SHAPES[kind]([float(number) for number in model.geom_size[geom]])
    if kind not in _DATA:
        raise ArgumentValueError("model", f"geoms of the types {', '.join(_SHAPES | _DATA)}", kind)
    key = kind, int(model.geom_dataid[geom])
    if key not in shared:
        shared[key] = _DATA[kind](model, key[1])
    return shared[key]


def _plane(size: Sequence[float]) -> Shape:
    """Return a plane, or the rectangle of it that is drawn; along an axis of size 0 it is unlimited."""
    if size[0] <= 0 and size[1] <= 0:
        return Plane((0, 0, 1), 0.0)
    x, y = (half if half > 0 else MAXVAL for half in size[:2])
    return Polygon([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)])


def _mesh(model: MjModel, mesh: int) -> TriangleMesh:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return TriangleMesh(model.mesh_vert[first : first + count], model.mesh_face[start : start + faces])


def _height_field(model: MjModel, field: int) -> TriangleMesh:
    """Return the surface of a height field with its sides and bottom, closed."""
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    start = model.hfield_adr[field]
    x, y, height, base = (float(number) for number in model.hfield_size[field])
    z = model.hfield_data[start : start + rows * columns].astype(np.float64).reshape(rows, columns) * height
    # As MuJoCo evaluates them, j·dx − x, so that the last one may be off x by its rounding.
    xs, ys = (step * np.arange(n) - half for n, half in ((columns, x), (rows, y)) for step in (2.0 * half / (n - 1),))
    top = np.stack([*np.meshgrid(xs, ys), z], axis=-1).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    # The border, counterclockwise as seen from above, and below it the rim of the bottom, whose middle comes last.
    border = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    low = len(top) + np.arange(len(border))
    after, low_after = np.roll(border, -1), np.roll(low, -1)
    rim = np.column_stack([top[border, :2], np.full(len(border), -base)])
    middle = np.full(len(border), len(top) + len(rim))
    faces = [(a, b, c), (a, c, d), (low, low_after, after), (low, after, border), (low_after, low, middle)]
    return TriangleMesh(
        np.concatenate([top, rim, [(0.0, 0.0, -base)]]),
        np.concatenate([np.column_stack(corners) for corners in faces]),
    )


_SHAPES: dict[str, Callable[[Sequence[float]], Shape]] = {
    "PLANE": _plane,
    "SPHERE": lambda size: Sphere((0, 0, 0), size[0]),
    "CAPSULE": lambda size: Capsule((0, 0, -size[1]), (0, 0, size[1]), size[0]),
    "ELLIPSOID": lambda size: Ellipsoid((0, 0, 0), size),
    "CYLINDER": lambda size: Cylinder((0, 0, -size[1]), (0, 0, size[1]), size[0]),
    "BOX": lambda size: Box([2 * half for half in size]),
}
"""The shapes of geoms by MuJoCo's names of their types; they are made from the sizes."""

_DATA: dict[str, Callable[[MjModel, int], Shape]] = {"MESH": _mesh, "SDF": _mesh, "HFIELD": _height_field}
"""The shapes that are made from arrays of the model."""

register_scene_reader("MJCF or URDF", recognise, read)
