"""Scenes that change between frames: instances that move and a body that bends, and the same in Embree and Open3D."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import lidarsim as ls
from lidarsim._base.validation import Floats
from lidarsim.bench import motion
from lidarsim.bench.peers import CASTERS

INSTANCES = 1000
"""Number of instances, of 1,280 faces each."""

SIDE = 225
"""Vertices of the body along a side: 2·224² = 100,352 faces."""

STEP = 0.01
"""Move of the instances, and phase of the wave of the body, from one frame to the next."""

HEIGHT = 9.0
"""Height above the origin from which one ray is cast downward in each frame, m: the hierarchies are made for it."""

TRIANGLE, INSTANCE = 0, 121
INDEX, VERTEX = 0, 1
UINT3, FLOAT3, FLOAT3X4 = 0x5003, 0x9003, 0x9134
LOW, MEDIUM, REFIT = 0, 1, 3
DYNAMIC, ROBUST = 1, 4
"""Constants of Embree's API."""


class Embree:
    """Embree's own API, of the library that embreex brings along, whose Python classes can change no scene.

    Parameters
    ----------
    threads : int
        Number of threads.
    """

    def __init__(self, threads: int) -> None:
        root = Path(CASTERS["embreex"].module.__file__).parent
        (library,) = [*root.parent.glob("embreex.libs/*embree4*"), *root.glob(".dylibs/*embree4*")]
        self.api = ctypes.CDLL(str(library))
        for name in ("NewDevice", "NewScene", "NewGeometry", "SetNewGeometryBuffer"):
            getattr(self.api, f"rtc{name}").restype = ctypes.c_void_p
        self.device = self.pointer("NewDevice", f"threads={threads}".encode())

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the API; sizes and flags are passed as such."""
        return getattr(self.api, f"rtc{name}")(*arguments)

    def pointer(self, name: str, *arguments: Any) -> ctypes.c_void_p:
        """Call a function that returns a handle."""
        return ctypes.c_void_p(self.call(name, *arguments))

    def scene(self, *geometries: ctypes.c_void_p, quality: int = MEDIUM) -> ctypes.c_void_p:
        """Return a scene that is robust and may change, with its hierarchy; that of a mesh is refitted if it is LOW."""
        made = self.pointer("NewScene", self.device)
        self.call("SetSceneFlags", made, DYNAMIC | ROBUST)
        self.call("SetSceneBuildQuality", made, quality)
        for geometry in geometries:
            self.call("CommitGeometry", geometry)
            self.call("AttachGeometry", made, geometry)
        self.call("CommitScene", made)
        return made

    def mesh(self, vertices: Floats, faces: npt.NDArray[np.integer], quality: int) -> tuple[ctypes.c_void_p, Floats]:
        """Return a mesh, and its array of vertices in float32."""
        made = self.pointer("NewGeometry", self.device, TRIANGLE)
        self.call("SetGeometryBuildQuality", made, quality)
        for kind, form, values, number in (
            (INDEX, UINT3, faces, ctypes.c_uint32),
            (VERTEX, FLOAT3, vertices, ctypes.c_float),
        ):
            place = self.pointer(
                "SetNewGeometryBuffer", made, kind, 0, form, ctypes.c_size_t(12), ctypes.c_size_t(len(values))
            )
            array = np.ctypeslib.as_array(ctypes.cast(place, ctypes.POINTER(number)), values.shape)
            array[:] = values
        return made, array

    def instance(self, of: ctypes.c_void_p) -> ctypes.c_void_p:
        """Return an instance of a scene."""
        made = self.pointer("NewGeometry", self.device, INSTANCE)
        self.call("SetGeometryInstancedScene", made, of)
        return made

    def place(self, instance: ctypes.c_void_p, pose: npt.NDArray[np.float32]) -> None:
        """Place an instance by the upper three rows of a matrix."""
        self.call("SetGeometryTransform", instance, 0, FLOAT3X4, pose.ctypes.data_as(ctypes.c_void_p))
        self.call("CommitGeometry", instance)

    def t(self, scene: ctypes.c_void_p, ray: tuple[Floats, Floats]) -> float:
        """Return t of a ray: its origin and direction, (1, 3)."""
        # Of an aligned RTCRayHit: origin, nearest t, direction, time, farthest t, mask, id and flags of the ray, and
        # normal, u, v and ids of the hit.
        room = np.zeros(64, np.float32)
        found = room[-(room.ctypes.data // 4) % 16 :][:32]
        found[:3], found[4:7], found[8] = ray[0][0], ray[1][0], np.inf
        found[9:].view(np.uint32)[0] = found[17:].view(np.uint32)[:4] = 2**32 - 1
        self.call("Intersect1", scene, found.ctypes.data_as(ctypes.c_void_p), None)
        return float(found[8])


def wavy_sheet(side: int, phase: float) -> Floats:
    """Return the vertices of a square sheet with a wave, m: ndarray of float64, shape (side², 3)."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-5.0, 5.0, side)] * 2, indexing="ij"))
    return np.stack([x, y, 0.3 * np.sin(x + phase)], axis=1)


def _down(x: float, y: float) -> tuple[Floats, Floats]:
    return np.array([[x, y, HEIGHT]]), np.array([[0.0, 0.0, -1.0]])


def calls(casters: Collection[str], threads: int, side: int = SIDE) -> motion.Calls:
    """Return the calls to time, each of which returns t of a ray.

    `casters` are the names of the installed ray casters, which build with some threads; `side` is the number of
    vertices of the body along a side.
    """
    crowd, moving = (motion.instances(INSTANCES, moving=moving) for moving in (False, True))
    ids = [item.id for item in crowd][1:]  # without the ground
    poses = np.array([crowd[number].transform for number in ids])
    faces = ls.TriangleMesh.from_heightfield(np.zeros((side, side)), 1.0).faces
    at, on = (_down(x, y) for x, y in (poses[0, :2, 3], (0.3, 0.2)))
    body, sheet = ls.Scene(), ls.TriangleMesh(wavy_sheet(side, 0.0), faces)
    whole, lifts = body.add(sheet), _lift(poses)
    times, phases, others = _steps(), _steps(), _steps()

    def move_instances() -> float:
        for number, pose in zip(ids, next(lifts), strict=True):
            crowd.update(number, transform=pose)
        return float(crowd.cast(*at).t[0])

    def refit_mesh() -> float:
        body.update(whole, shape=sheet.deformed(wavy_sheet(side, next(phases))))
        return float(body.cast(*on).t[0])

    def rebuild_mesh() -> float:
        scene = ls.Scene()
        scene.add(ls.TriangleMesh(wavy_sheet(side, next(others)), faces))
        return float(scene.cast(*on).t[0])

    move, bend = f"{INSTANCES:,} instances moved", f"{len(faces):,} faces refitted"
    anew = f"{len(faces):,} faces built anew"
    own: motion.Calls = {
        move: (move, move_instances),
        f"{INSTANCES:,} instances with motions": (move, lambda: float(moving.cast(*at, time=next(times)).t[0])),
        bend: (bend, refit_mesh),
        anew: (bend, rebuild_mesh),
    }
    if "embreex" in casters:
        embree = Embree(threads)
        own[f"{move}, Embree"] = move, _place(embree, crowd[ids[0]].shape, poses, at)
        own[f"{bend}, Embree"] = bend, _commit(embree, side, faces, on, REFIT)
        own[f"{anew}, Embree"] = bend, _commit(embree, side, faces, on, MEDIUM)
    if "Open3D" in casters:
        own[f"{anew}, Open3D"] = bend, _add(side, faces, on, threads)
    return own


def _steps() -> Iterator[float]:
    """Return the phases, or times, of successive frames."""
    return itertools.cycle([STEP * k for k in range(8)])


def _lift(poses: Floats) -> Iterator[Floats]:
    """Return the poses of the instances in successive frames."""
    for step in _steps():
        here = poses.copy()
        here[:, 2, 3] += step
        yield here


def _place(embree: Embree, shape: Any, poses: Floats, ray: tuple[Floats, Floats]) -> Callable[[], float]:
    """Return a call that moves instances of a shape."""
    one = embree.scene(embree.mesh(shape.vertices, shape.faces, MEDIUM)[0])
    instances, lifts = [embree.instance(one) for _ in poses], _lift(poses)
    many = embree.scene(*instances)

    def call() -> float:
        for instance, pose in zip(instances, next(lifts)[:, :3].astype(np.float32), strict=True):
            embree.place(instance, pose)
        embree.call("CommitScene", many)
        return embree.t(many, ray)

    return call


def _commit(
    embree: Embree, side: int, faces: npt.NDArray[np.integer], ray: tuple[Floats, Floats], quality: int
) -> Callable[[], float]:
    """Return a call that bends the body, and refits its hierarchy or makes another."""
    phases = _steps()
    mesh, vertices = embree.mesh(wavy_sheet(side, 0.0), faces, quality)
    scene = embree.scene(mesh, quality=LOW if quality == REFIT else MEDIUM)

    def call() -> float:
        vertices[:] = wavy_sheet(side, next(phases))
        embree.call("UpdateGeometryBuffer", mesh, VERTEX, 0)
        embree.call("CommitGeometry", mesh)
        embree.call("CommitScene", scene)
        return embree.t(scene, ray)

    return call


def _add(side: int, faces: npt.NDArray[np.integer], ray: tuple[Floats, Floats], threads: int) -> Callable[[], float]:
    """Return a call that bends the body in Open3D, whose scenes have no changes."""
    open3d, phases = CASTERS["Open3D"].module, _steps()
    tensor, triangles = open3d.core.Tensor, faces.astype(np.uint32)

    def call() -> float:
        scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
        scene.add_triangles(tensor(wavy_sheet(side, next(phases)).astype(np.float32)), tensor(triangles))
        rays = tensor(np.concatenate(ray, axis=1).astype(np.float32))
        return float(scene.cast_rays(rays, nthreads=threads)["t_hit"].numpy()[0])

    return call
