"""The ray casters that lidarsim is compared with, one class each, called as Python users call them.

A caster is built from a world. Rays are converted to its input format beforehand, so only its own work is timed. A new
caster is a subclass of `Caster` and a line in `CASTERS`.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import io
import math
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any, ClassVar

import numpy as np

from lidarsim import _native
from lidarsim.bench import scenes, textbook
from lidarsim.bench.scenes import Floats, Integers, Rays, Spec, World

#: t of each ray, inf for a miss, and the triangle (for a mesh) or object that it hit, if the caster reports it.
Found = tuple[Floats, Integers | None]


class Caster(ABC):
    """A world prepared for casting.

    Parameters
    ----------
    world : World
        The scene.
    threads : int
        Threads to build with; single-threaded casters ignore it.
    """

    package: ClassVar[str]
    module: ClassVar[Any]
    meshes: ClassVar[bool] = False
    shapes: ClassVar[bool] = False
    any_origin: ClassVar[bool] = True
    one_thread: ClassVar[bool] = False
    triangles: int = 0  # if they differ from those of the world
    stride: ClassVar[int] = 1  # a slow caster is timed on every stride-th ray

    @classmethod
    @abstractmethod
    def load(cls) -> None:
        """Import the packages of the caster; raise `ImportError` if one is missing."""

    @classmethod
    def serves(cls, world: World) -> bool:
        """Return whether the caster can represent the world."""
        return cls.shapes if world.mesh is None else cls.meshes

    @abstractmethod
    def __init__(self, world: World, threads: int) -> None: ...

    @abstractmethod
    def prepare(self, rays: Rays) -> Any:
        """Return the rays in the input format of `cast`."""

    @abstractmethod
    def cast(self, rays: Any, threads: int) -> Any:
        """Find the nearest hit of each ray. This call is timed."""

    @abstractmethod
    def convert(self, answer: Any) -> Found:
        """Return the answer of `cast` in the common format."""


class Lidarsim(Caster):
    """`Scene.cast`."""

    package = "lidarsim"
    meshes = shapes = True

    @classmethod
    def load(cls) -> None:
        """Import nothing."""

    def __init__(self, world: World, threads: int) -> None:
        from lidarsim.world.scene import Scene

        _native.set_threads(threads)
        self.by_triangle = world.mesh is not None
        self.scene = Scene()
        for spec in world.shapes:
            self.scene.add(spec.build())

    def prepare(self, rays: Rays) -> Rays:
        """Return the rays as they are."""
        return rays

    def cast(self, rays: Rays, threads: int) -> Any:
        """Cast at the scene."""
        _native.set_threads(threads)
        return self.scene.cast(rays.origins, rays.directions)

    def convert(self, answer: Any) -> Found:
        """Return t and the triangle or object."""
        return answer.t, (answer.primitive_id if self.by_triangle else answer.object_id).astype(np.int64)

    def bytes(self) -> int:
        """Return the memory of the shapes and their hierarchies as counted by the core."""
        return sum(item.shape._native.bytes() for item in self.scene.objects)


class Open3D(Caster):
    """`RaycastingScene.cast_rays`: Embree in float32, one ray at a time."""

    package = "open3d"
    meshes = True

    @classmethod
    def load(cls) -> None:
        """Import Open3D and the library that its wheel lacks."""
        from lidarsim.viewers.open3d import import_open3d

        cls.module = import_open3d()

    def __init__(self, world: World, threads: int) -> None:
        assert world.mesh is not None  # noqa: S101 - see `serves`
        vertices, faces = world.mesh
        self.scene = self.module.t.geometry.RaycastingScene(nthreads=threads)
        self.scene.add_triangles(
            self.module.core.Tensor(vertices.astype(np.float32)), self.module.core.Tensor(faces.astype(np.uint32))
        )

    def prepare(self, rays: Rays) -> Any:
        """Return a tensor, (n, 6), float32."""
        return self.module.core.Tensor(np.concatenate([rays.origins, rays.directions], axis=1).astype(np.float32))

    def cast(self, rays: Any, threads: int) -> Any:
        """Cast at the scene."""
        return self.scene.cast_rays(rays, nthreads=threads)

    def convert(self, answer: Any) -> Found:
        """Return t and the triangle."""
        return answer["t_hit"].numpy().astype(np.float64), answer["primitive_ids"].numpy().astype(np.int64)


class Embreex(Caster):
    """`EmbreeScene.run` of embreex, used by trimesh: Embree in float32, one ray at a time, one thread."""

    package = "embreex"
    meshes = one_thread = True

    @classmethod
    def load(cls) -> None:
        """Import embreex."""
        importlib.import_module("embreex.mesh_construction")
        importlib.import_module("embreex.rtcore_scene")
        cls.module = importlib.import_module("embreex")

    def __init__(self, world: World, _threads: int) -> None:
        assert world.mesh is not None  # noqa: S101 - see `serves`
        vertices, faces = world.mesh
        self.scene = self.module.rtcore_scene.EmbreeScene()
        self.mesh = self.module.mesh_construction.TriangleMesh(
            self.scene, vertices.astype(np.float32), faces.astype(np.int32)
        )

    def prepare(self, rays: Rays) -> Any:
        """Return origins and directions in float32."""
        return rays.origins.astype(np.float32), rays.directions.astype(np.float32)

    def cast(self, rays: Any, _threads: int) -> Any:
        """Cast at the scene."""
        return self.scene.run(*rays, output=True)

    def convert(self, answer: Any) -> Found:
        """Return t and the triangle."""
        hit = answer["primID"] >= 0
        return np.where(hit, answer["tfar"].astype(np.float64), np.inf), answer["primID"].astype(np.int64)


class MuJoCo(Caster):
    """`mj_multiRay`: float64, rays from one point, one thread."""

    package = "mujoco"
    shapes = one_thread = True
    any_origin = False

    @classmethod
    def load(cls) -> None:
        """Import MuJoCo without its log file in the working folder."""
        cls.module = importlib.import_module("mujoco")
        cls.module.set_mju_user_warning(lambda _: None)

    def __init__(self, world: World, _threads: int) -> None:
        bodies = f'<site name="lidar" pos="{_text(world.sensor)}"/>' + "".join(map(_geom, world.shapes))
        self.model = self.module.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
        self.data = self.module.MjData(self.model)
        self.module.mj_forward(self.model, self.data)

    def prepare(self, rays: Rays) -> Any:
        """Return the origin, the directions and room for the answer."""
        n = len(rays)
        return rays.origins[0].copy(), rays.directions.ravel(), np.empty(n, dtype=np.int32), np.empty(n)

    def cast(self, rays: Any, _threads: int) -> Any:
        """Cast at the model."""
        origin, directions, geom, t = rays
        self.module.mj_multiRay(
            self.model, self.data, origin, directions, None, 1, -1, geom, t, None, len(t), self.module.mjMAXVAL
        )
        return geom, t

    def convert(self, answer: Any) -> Found:
        """Return t and the object."""
        geom, t = answer
        return np.where(geom < 0, np.inf, t), geom.astype(np.int64)


def _text(values: Any) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))


def _geom(spec: Spec) -> str:
    """Return the shape as an MJCF element; its numbers keep all their digits."""
    match spec.kind, spec.args:
        case "Sphere", (center, radius):
            form = f'type="sphere" size="{_text(radius)}" pos="{_text(center)}"'
        case "Box", (size, center):
            form = f'type="box" size="{_text(size / 2)}" pos="{_text(center)}"'
        case "Cylinder", (start, end, radius):
            form = f'type="cylinder" size="{_text(radius)}" fromto="{_text(start)} {_text(end)}"'
        case "Ellipsoid", (center, radii, rotation):
            axes = _text(rotation[:, :2].T.ravel())
            form = f'type="ellipsoid" size="{_text(radii)}" pos="{_text(center)}" xyaxes="{axes}"'
        case _, (point, normal):  # a plane, bounded for MuJoCo-LiDAR's trees
            form = f'type="plane" size="4000 4000 1" pos="{_text(point)}" zaxis="{_text(normal)}"'
    return f"<geom {form}/>"


class MuJoCoLidar(MuJoCo):
    """`MjLidarWrapper.trace_rays` with the back end that casts by `mj_multiRay`."""

    package = "mujoco-lidar"
    wrapper: ClassVar[Any]
    backend: ClassVar[str] = "cpu"
    arguments: ClassVar[dict[str, Any]] = {}

    @classmethod
    def load(cls) -> None:
        """Import MuJoCo-LiDAR and the back end."""
        super().load()
        cls.wrapper = importlib.import_module("mujoco_lidar").MjLidarWrapper

    def __init__(self, world: World, threads: int) -> None:
        super().__init__(world, threads)
        self.lidar = type(self).wrapper(self.model, "lidar", self.backend, cutoff_dist=1e6, args=self.arguments)

    def prepare(self, rays: Rays) -> Any:
        """Return azimuths and elevations: the rays start at the sensor."""
        x, y, z = rays.directions.T
        return np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1))

    def cast(self, rays: Any, _threads: int) -> Any:
        """Scan the model."""
        return self.lidar.trace_rays(self.data, *rays)

    def convert(self, answer: Any) -> Found:
        """Return t; the back end does not report what was hit."""
        t = np.array(answer, dtype=np.float64)
        return np.where(t < 0, np.inf, t), None


class MuJoCoLidarWarp(MuJoCoLidar):
    """The same with NVIDIA Warp on the CPU: float32, one thread."""

    backend = "warp"
    arguments: ClassVar[dict[str, Any]] = {"device": "cpu"}

    @classmethod
    def load(cls) -> None:
        """Import Warp as well."""
        super().load()
        warp = importlib.import_module("warp")
        warp.config.log_level = warp.LOG_ERROR
        warp.init()


class MuJoCoLidarTaichi(MuJoCoLidar):
    """The same with Taichi on the CPU: float32; the number of threads is set once, when Taichi starts."""

    backend = "taichi"
    one_thread = False

    @classmethod
    def load(cls) -> None:
        """Import Taichi as well, and start it on the CPU in place of a GPU."""
        super().load()
        importlib.import_module("mujoco_lidar.core_ti.mjlidar_ti")
        taichi: Any = importlib.import_module("taichi")
        taichi.init(arch=taichi.cpu, cpu_max_num_threads=os.cpu_count() or 1)
        taichi._is_initialized = True  # else the wrapper would start Taichi again


class Textbook(Caster):
    """The textbook formula in NumPy, shape by shape: float64, one thread."""

    package = "numpy"
    shapes = one_thread = True
    stride = 17  # coprime to the number of channels, so that all channels take part

    @classmethod
    def load(cls) -> None:
        """Import nothing."""

    def __init__(self, world: World, _threads: int) -> None:
        self.specs = world.shapes

    def prepare(self, rays: Rays) -> Rays:
        """Return the rays as they are."""
        return rays

    def cast(self, rays: Rays, _threads: int) -> Any:
        """Cast at each shape in turn."""
        nearest, surface = np.full(len(rays), math.inf), np.full(len(rays), -1)
        for index, spec in enumerate(self.specs):
            with np.errstate(all="ignore"):
                roots = textbook.FORMULAS[spec.kind](rays.origins, rays.directions, *spec.args)
                t = np.where(roots >= 0, roots, math.inf).min(axis=1)
            closer = t < nearest
            nearest[closer], surface[closer] = t[closer], index
        return nearest, surface

    def convert(self, answer: Any) -> Found:
        """Return t and the object."""
        nearest, surface = answer
        return nearest, surface


ABSENT, FAILING = "not installed", "fails here"  # prefixes of the states of casters that cannot run

#: Every caster by its name in the report.
CASTERS: dict[str, type[Caster]] = {
    "lidarsim": Lidarsim,
    "Open3D": Open3D,
    "embreex": Embreex,
    "MuJoCo": MuJoCo,
    "MuJoCo-LiDAR, mj_multiRay": MuJoCoLidar,
    "MuJoCo-LiDAR, Warp": MuJoCoLidarWarp,
    "MuJoCo-LiDAR, Taichi": MuJoCoLidarTaichi,
    "textbook NumPy": Textbook,
}


def find_installed() -> tuple[dict[str, type[Caster]], dict[str, str]]:
    """Return the casters that can run, and for each caster its version or the reason why it cannot."""
    casters, states = {}, {}
    for name, caster in CASTERS.items():
        try:
            # Hide the warnings and greetings of other packages.
            with warnings.catch_warnings(action="ignore"), redirect_stdout(io.StringIO()), threads_kept():
                caster.load()
                _try(caster)
        except (ImportError, OSError) as error:
            states[name] = f"{ABSENT} ({getattr(error, 'name', None) or caster.package})"
        except Exception as error:  # noqa: BLE001 - a package whose interface has changed may raise anything
            states[name] = f"{FAILING} ({type(error).__name__}: {error})"
        else:
            casters[name], states[name] = caster, version(caster.package)
    return casters, states


@contextmanager
def threads_kept() -> Iterator[None]:
    """Follow ``LIDARSIM_THREADS`` again afterwards, in place of the numbers that the casters set."""
    try:
        yield
    finally:
        _native.set_threads(None)


def _try(caster: type[Caster]) -> None:
    world = scenes.terrain(8) if caster.meshes else scenes.analytic(4)
    ready = caster(world, 1)
    ready.convert(ready.cast(ready.prepare(scenes.lidar(world, 4, 4, 1.0)), 1))


def version(package: str) -> str:
    """Return the version of an installed package, or "from a checkout"."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "from a checkout"
