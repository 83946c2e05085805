"""Worlds of MuJoCo: scenes that follow the simulation of a model."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from lidarsim._base.files import PathLike
from lidarsim._base.pickling import Pickled
from lidarsim._base.validation import Floats, Transform, array, as_array, flag, integer, pose, short, short_repr
from lidarsim._base.vectors import transforms
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.io.scenes import mjcf
from lidarsim.io.scenes._build import report, scene_with
from lidarsim.materials import Material
from lidarsim.world.rules import Options, Rule

if TYPE_CHECKING:
    import mujoco

__all__ = ["World"]


class World(Pickled):
    """A scene that shows what a MuJoCo model and its data describe.

    Each geom is an object of the scene, of the same shape, named after the geom; one without a name is called after its
    body and its number in it: ``"wheel/0"``. Rays meet what `mj_ray` meets, with the exceptions that
    `lidarsim.io.scenes.mjcf` lists. Geoms of alpha 0, flexes and skins are left out.

    Parameters
    ----------
    model : mujoco.MjModel or path-like
        A model, or an MJCF or URDF file. A file may name others beside or below it; it may not use plugins, and its
        textures are not read.
    groups : collection of int
        Which groups of geoms the scene has, 0 to 5. Default: those that MuJoCo's viewers show. Robots often have their
        visible geoms in group 2, and others for collisions in group 3.
    rules : sequence of Rule
        Labels, materials and instances of the geoms; of those rules that match a geom, the first decides. The path of a
        geom has the names of the bodies from the top one on, and then its own or, without one, its number:
        ``"robot/wheel/0"``.
    reflectivity : float, Material or "color", optional
        Reflectivity or material of the geoms for which no rule gives one; "color" for the luminance of the colour of
        each, as `Material.from_colors` computes it. Default: a perfect diffuser.
    keyframe : int or str, optional
        Number or name of the keyframe that the scene shows until the first `update`. Default: the pose of the model
        itself (``qpos0``).

    Attributes
    ----------
    scene : Scene
        The scene. Things may be added to it and changed; `update` only sets the transforms of geoms that have moved.
    model : mujoco.MjModel
        The model. Changes of its shapes, such as of `geom_size`, are seen by a new `World` only.

    Raises
    ------
    MissingExtraError
        If mujoco is not installed.
    FileFormatError
        If the file cannot be read as a model.
    TypeError, ValueError
        If an argument is of another type or out of range.
    OSError
        If the file cannot be opened.

    Examples
    --------
    >>> import mujoco
    >>> import lidarsim as ls
    >>> model = mujoco.MjModel.from_xml_string('''
    ... <mujoco><worldbody>
    ...   <geom type="plane" size="0 0 1"/>
    ...   <site name="lidar" pos="0 0 0.5"/>
    ...   <body name="ball" pos="4 0 0.5"><freejoint/><geom size="0.5"/></body>
    ... </worldbody></mujoco>''')
    >>> world, data = ls.mujoco.World(model), mujoco.MjData(model)
    >>> data.qpos[0] = 5.0
    >>> mujoco.mj_forward(model, data)
    >>> world.update(data)
    >>> hits = world.scene.cast([world.pose(data, site="lidar")[:3, 3]], [[1, 0, 0]])
    >>> world.scene[hits.object_id[0]].name, hits.t
    ('ball/0', array([4.5]))
    """

    def __init__(
        self,
        model: mujoco.MjModel | PathLike,
        *,
        groups: Collection[int] = mjcf.SHOWN,
        rules: Sequence[Rule] = (),
        reflectivity: float | Material | Literal["color"] | None = None,
        keyframe: int | str | None = None,
    ) -> None:
        module = mjcf.mujoco_module()
        if isinstance(model, str | os.PathLike):
            path, (model, left_out) = Path(model), mjcf.load(model)
            report(path, left_out)
        elif not isinstance(model, module.MjModel):
            raise ArgumentTypeError("model", "a mujoco.MjModel or the path of a file", short_repr(model))
        data = mjcf.place_bodies(model, keyframe)
        self.model = model
        options = Options.from_arguments(None, None, rules, reflectivity)
        geoms, found = mjcf.objects(model, data, Path(), options, groups)
        self.scene = scene_with(found)
        objects = dict(zip(geoms, range(len(geoms)), strict=True))
        body = model.geom_bodyid
        self._bodies = {
            mjcf.body_name(model, int(body[geom])): self.scene[number].instance
            for geom, number in objects.items()
            if body[geom]
        }
        self._instances = [(int(body[geom]), self.scene[number].instance) for geom, number in objects.items()]
        self._sizes = {"geom_xpos": int(model.ngeom), "site_xpos": int(model.nsite), "xpos": int(model.nbody)}
        self._geoms = np.array(geoms, np.intp)
        self._moving = np.array([_moves(model, int(body[geom])) for geom in geoms], bool)
        self._poses = mjcf.poses(data, self._geoms)

    @property
    def bodies(self) -> Mapping[str, int]:
        """Instance of each body by its name, or by its number as text if it has none: read-only mapping of str to int.

        All objects of a body share the instance. Objects of the world body are instances of their own; that body and
        those without objects are not listed.
        """
        return MappingProxyType(self._bodies)

    def instances(self, body: str | int = 0, *, subtree: bool = True) -> list[int]:
        """Return the instances of a body, such as those that a sensor on it does not see.

        Parameters
        ----------
        body : str or int
            Name or number of the body. Default: the world body.
        subtree : bool
            Whether those of all bodies below it belong to it: of a robot's base, all of the robot.

        Returns
        -------
        list of int
            Numbers of `SceneObject.instance`, ascending; empty if the bodies have no objects.

        Raises
        ------
        TypeError, ValueError
            If the model has no such body.
        """
        root = self._number("body", body)
        parents = self.model.body_parentid
        chosen = {root}
        if flag("subtree", subtree):
            for number in range(root + 1, self.model.nbody):  # each body comes after its parent
                if int(parents[number]) in chosen:
                    chosen.add(number)
        return sorted({instance for number, instance in self._instances if number in chosen})

    def update(self, data: mujoco.MjData) -> None:
        """Move all objects to where their geoms are.

        Parameters
        ----------
        data : mujoco.MjData or mujoco.mjx.Data
            Data of the model, of one world. Poses are those of its last ``mj_forward`` or ``mj_kinematics``: after
            ``mj_step`` alone they are one step old.

        Raises
        ------
        TypeError, ValueError
            If these are not data of the model, or they have no poses yet, or one that is not finite; nothing is then
            moved.
        """
        self._check(data, "geom_xpos")
        self._move(mjcf.poses(data, self._geoms))

    def move(self, xpos: npt.ArrayLike, xquat: npt.ArrayLike) -> None:
        """Move all objects to where these bodies are: as `update`, from the poses of one of many worlds.

        Bodies that no joint and no mocap body moves stay, as does what is fixed to the world.

        Parameters
        ----------
        xpos : array_like, shape (nbody, 3)
            Positions of the bodies, m, as ``data.xpos``.
        xquat : array_like, shape (nbody, 4)
            Their orientations w, x, y, z, as ``data.xquat``; of any length but zero.

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a number is not finite or a quaternion is zero; nothing is then moved.
        """
        positions, turns = self._body_poses(xpos, xquat, ())
        geoms, poses = self._geoms[self._moving], self._poses.copy()
        body = self.model.geom_bodyid[geoms]
        poses[self._moving] = _place(
            positions[body], turns[body], self.model.geom_pos[geoms], self.model.geom_quat[geoms]
        )
        self._move(poses)

    def poses(
        self,
        xpos: npt.ArrayLike,
        xquat: npt.ArrayLike,
        *,
        site: str | None = None,
        body: str | int | None = None,
        offset: Transform | None = None,
    ) -> Floats:
        """Return where a site or body is in many worlds: the poses of a sensor on it, as for `Lidar.scan`.

        Parameters
        ----------
        xpos : array_like, shape (..., nbody, 3)
            Positions of the bodies of each world, m: ``data.xpos`` of MJX, or of many data, stacked.
        xquat : array_like, shape (..., nbody, 4)
            Their orientations w, x, y, z, as ``data.xquat``; of any length but zero.
        site : str, optional
            Name of the site; see `pose`.
        body : str or int, optional
            Name or number of the body, instead of a site.
        offset : array_like, shape (4, 4), or RigidTransform, optional
            Pose of the sensor on it; see `pose`.

        Returns
        -------
        ndarray of float64, shape (..., 4, 4)
            Sensor to world.

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a number is not finite, a quaternion is zero, the model has no such site or body, both
            or none is given, or the offset is not rigid.

        Examples
        --------
        >>> import mujoco
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> model = mujoco.MjModel.from_xml_string('''
        ... <mujoco><worldbody><geom type="plane" size="0 0 1"/>
        ...   <body name="robot"><freejoint/><geom size="0.1"/><site name="lidar" pos="0 0 0.2"/></body>
        ... </worldbody></mujoco>''')
        >>> world = ls.mujoco.World(model)
        >>> xpos, xquat = np.zeros((1000, 2, 3)), np.tile([1.0, 0, 0, 0], (1000, 2, 1))
        >>> xpos[:, 1, 0] = np.arange(1000)
        >>> world.poses(xpos, xquat, site="lidar")[7, :3, 3]
        array([7. , 0. , 0.2])
        """
        kind, number = self._mount_on(site, body)
        mount = None if offset is None else pose("offset", offset)
        positions, turns = self._body_poses(xpos, xquat, (...,))
        owner, place, turn = number, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        if kind == "site":
            owner = int(self.model.site_bodyid[number])
            place, turn = self.model.site_pos[number], self.model.site_quat[number]
        found = _place(positions[..., owner, :], turns[..., owner, :], place, turn)
        return found if mount is None else found @ mount

    def _move(self, poses: Floats) -> None:
        """Move the objects of all geoms to these places, geom to world."""
        if not np.isfinite(poses).all():
            wrong = ~np.isfinite(poses).all(axis=(1, 2))
            name = self.scene[int(np.argmax(wrong))].name
            raise ArgumentValueError(
                "data", "finite poses", f"one of {name!r} that is not", "is the simulation stable?"
            )
        moved = np.flatnonzero((poses != self._poses).any(axis=(1, 2)))
        self.scene.update_transforms(moved, poses[moved])
        self._poses = poses

    def pose(
        self,
        data: mujoco.MjData,
        *,
        site: str | None = None,
        body: str | int | None = None,
        offset: Transform | None = None,
    ) -> Floats:
        """Return where a site or body is: the pose of a sensor on it.

        Parameters
        ----------
        data : mujoco.MjData
            Data of the model; see `update`.
        site : str, optional
            Name of the site. Its x axis is the sensor's forward direction, and its z axis is up.
        body : str or int, optional
            Name or number of the body, or link of a URDF, instead of a site; URDF has no sites.
        offset : array_like, shape (4, 4), or RigidTransform, optional
            Pose of the sensor on the site or body, sensor to body, m: of a URDF the ``origin`` of the joint that fixes
            the sensor to its parent link. Default: the frame of the site or body itself.

        Returns
        -------
        ndarray of float64, shape (4, 4)
            Sensor to world.

        Raises
        ------
        TypeError, ValueError
            If these are not data of the model, or they have no poses yet, the model has no such site or body, both or
            none is given, or the offset is not rigid.

        Notes
        -----
        From a URDF, MuJoCo merges links with fixed joints with their parents, and a root link with the world. So a
        lidar's own link is not a body of the model, but its parent is. To keep all links, add
        ``<mujoco><compiler fusestatic="false"/></mujoco>`` to the URDF.

        Examples
        --------
        >>> import mujoco
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> model = mujoco.MjModel.from_xml_string('''
        ... <robot name="rover">
        ...   <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
        ...     </inertial><collision><geometry><sphere radius="0.2"/></geometry></collision></link>
        ...   <joint name="slide" type="prismatic"><parent link="world"/><child link="base"/><axis xyz="1 0 0"/>
        ...     <limit lower="0" upper="9"/></joint>
        ...   <link name="world"/>
        ... </robot>''')
        >>> world, data = ls.mujoco.World(model), mujoco.MjData(model)
        >>> data.qpos[0] = 3.0
        >>> mujoco.mj_forward(model, data)
        >>> mount = np.eye(4)
        >>> mount[2, 3] = 0.3
        >>> world.pose(data, body="base", offset=mount)[:3, 3]
        array([3. , 0. , 0.3])
        """
        kind, number = self._mount_on(site, body)
        mount = None if offset is None else pose("offset", offset)
        name = "site_" if kind == "site" else ""
        self._check(data, f"{name}xpos")
        turned = np.reshape(getattr(data, f"{name}xmat")[number], (3, 3))
        found = transforms(turned, getattr(data, f"{name}xpos")[number])
        return found if mount is None else found @ mount

    def _mount_on(self, site: object, body: str | int | None) -> tuple[Literal["site", "body"], int]:
        """Return whether a sensor is on a site or a body, and the number of that."""
        if (site is None) == (body is None):
            raise ArgumentTypeError("site, body", "one of them", "none" if site is None else "both")
        if body is not None:
            return "body", self._number("body", body)
        if not isinstance(site, str):
            raise ArgumentTypeError("site", "the name of a site", short_repr(site))
        return "site", self._number("site", site)

    def _number(self, kind: str, name: str | int) -> int:
        """Return the number of a body or site of the model, by its name or number."""
        module = mjcf.mujoco_module()
        which = getattr(module.mjtObj, f"mjOBJ_{kind.upper()}")
        count: int = getattr(self.model, f"n{kind}")
        if not isinstance(name, str):
            return integer(kind, name, at_least=0, at_most=count - 1)
        number: int = module.mj_name2id(self.model, which, name)
        if number < 0:
            known = [*filter(None, (module.mj_id2name(self.model, which, k) for k in range(count)))]
            near = difflib.get_close_matches(name, known)
            hint = f"did you mean {' or '.join(near)}?" if near else f"it has {short(', '.join(known) or 'none')}"
            if kind == "body" and not near:
                hint += "; of a URDF, MuJoCo merges links with fixed joints with their parents: see World.pose"
            raise ArgumentValueError(kind, f"the name of a {kind} of the model", short_repr(name), hint)
        return number

    def _body_poses(self, xpos: npt.ArrayLike, xquat: npt.ArrayLike, before: tuple[Any, ...]) -> tuple[Floats, Floats]:
        """Return positions and quaternions of all bodies after checking them; `before` is (...,) for many worlds."""
        found = []
        for name, value, width in (("xpos", xpos, 3), ("xquat", xquat, 4)):
            given = as_array(name, value, "numbers")
            worlds = given.shape[:-2] if before else ()
            if given.ndim < 2:
                worlds = ()
            found.append(array(name, given, (*worlds, self.model.nbody, width)))
        positions, turns = found
        if positions.shape[:-1] != turns.shape[:-1]:
            raise ArgumentValueError("xquat", f"shape {(*positions.shape[:-1], 4)}, as of xpos", turns.shape)
        zero = np.argwhere(~turns.any(axis=-1))
        if len(zero):
            where = "".join(f"[{i}]" for i in zero[0])
            raise ArgumentValueError("xquat", "quaternions other than zero", f"xquat{where} = 0")
        return positions, turns

    def _check(self, data: Any, name: str) -> None:
        """Check that these are data of the model with poses, by those of this name."""
        if not isinstance(data, mjcf.mujoco_module().MjData) and not _is_mjx(data):
            raise ArgumentTypeError("data", "a mujoco.MjData or a mujoco.mjx.Data", short_repr(data))
        right, found = (self._sizes[name], 3), getattr(data, name).shape
        if found != right:
            hint = "of many worlds? see World.move and World.poses" if len(found) > 2 else ""
            raise ArgumentValueError("data", f"data of the model, {name} of shape {right}", found, hint)
        if data.xmat[0][0] == 0.0:  # of the world's orientation, which mj_kinematics sets
            raise ArgumentValueError("data", "data with poses", "none", "call mujoco.mj_forward(model, data) first")

    def __repr__(self) -> str:
        """Return the number of bodies and objects."""
        return f"World: {self.model.nbody} bodies, {len(self.scene)} objects of which {self._moving.sum()} can move"

    def _contents(self) -> dict[str, Any]:
        return dict(vars(self))


def _is_mjx(data: object) -> bool:
    """Return whether this is data of MJX, without importing it."""
    return type(data).__module__.startswith("mujoco.mjx") and hasattr(data, "geom_xmat")


def _place(positions: Floats, turns: Floats, position: Floats, turn: Floats) -> Floats:
    """Return poses (..., 4, 4) of what has a position and a quaternion in bodies of these poses."""
    from scipy.spatial.transform import Rotation

    shape = positions.shape[:-1]
    bodies = Rotation.from_quat(turns.reshape(-1, 4), scalar_first=True)
    locals_ = Rotation.from_quat(turn, scalar_first=True)
    turned = (bodies * locals_).as_matrix().reshape(*shape, 3, 3)
    return transforms(turned, positions + bodies.apply(position).reshape(*shape, 3))


def _moves(model: mujoco.MjModel, body: int) -> bool:
    """Return whether data can move a body: it is not welded to the world, or a part of a mocap body."""
    return bool(model.body_weldid[body] != 0 or model.body_mocapid[model.body_rootid[body]] >= 0)
