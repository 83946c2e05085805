"""Scene files of meshes with instances (``.glb``, ``.gltf``, ``.3mf``, ``.dae``, …), read by trimesh.

Files that a file names are read only if they lie beside or below it, and nothing is read from a network. A file of a
single mesh (``.obj``, ``.off``, ``.ply``, ``.stl``) becomes a scene of its parts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidarsim._files import beside, check_regular, reading_as
from lidarsim._validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io import _gltf
from lidarsim.io.meshes import SUFFIXES
from lidarsim.scene import Scene, register_scene_reader
from lidarsim.shapes import TriangleMesh
from lidarsim.shapes._polygons import Indices, triangulated
from lidarsim.shapes.triangle_mesh import MeshFile, read_mesh, register_mesh_reader


class Instance(NamedTuple):
    """A mesh as placed by a node."""

    name: str
    """Name of the node."""
    mesh: str
    transform: Floats
    """Mesh to scene, shape (4, 4)."""


class Beside:
    """Resolver through which trimesh reads the files beside a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def get(self, name: str) -> bytes:
        """Return the bytes of the file `name`; see `lidarsim._files.beside`."""
        return beside(self._path, name).read_bytes()

    __getitem__ = get


def recognise(path: Path, _head: bytes = b"") -> bool:
    """Return whether the suffix of a file is one of trimesh's; some formats have no signature."""
    import trimesh

    return path.suffix.lower().removeprefix(".") in trimesh.available_formats()


def read(path: Path) -> Scene:
    """Read a file as documented in `lidarsim.Scene.from_file`."""
    if path.suffix.lower() in SUFFIXES:
        meshes, instances = _parts(path)
    else:
        check_regular(path)
        with reading_as(path, "a scene"):
            meshes, instances = _loaded(path)
    scene = Scene()
    try:
        shapes = {name: TriangleMesh(*mesh) for name, mesh in meshes.items()}
        for instance in instances:
            scene.add(shapes[instance.mesh], name=instance.name, transform=instance.transform)
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from error
    return scene


def read_mesh_of_scene(path: Path) -> MeshFile:
    """Read all meshes of a file as one, in the order of its nodes."""
    meshes, instances = _loaded(path)
    vertices, corners = [np.empty((0, 3))], [np.empty(0, np.int64)]
    count = 0
    for instance in instances:
        points, faces = meshes[instance.mesh]
        turn, shift = instance.transform[:3, :3], instance.transform[:3, 3]
        if np.linalg.det(turn) < 0:  # a reflection, which would turn the surface inside out
            faces = faces[:, ::-1]
        vertices.append(points if np.array_equal(instance.transform, np.eye(4)) else points @ turn.T + shift)
        corners.append(faces.ravel() + count)
        count += len(points)
    joined = np.concatenate(corners)
    return MeshFile(np.concatenate(vertices), joined, np.full(len(joined) // 3, 3))


Meshes = dict[str, tuple[Floats, Indices]]
"""Vertices, (n, 3), and triangles, (m, 3), by name."""


def _parts(path: Path) -> tuple[Meshes, list[Instance]]:
    """Return the parts of a single-mesh file, each with its own vertices."""
    file = read_mesh(path)
    try:
        faces, of = triangulated(file.vertices, file.corners, file.sizes)
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from error
    if file.parts is None or len(file.names) < 2:
        name = next(filter(None, file.names), path.name)
        return {name: (file.vertices, faces)}, [Instance(name, name, np.eye(4))]
    meshes: Meshes = {}
    instances = []
    for part, name in enumerate(file.names):
        used, corners = np.unique(faces[file.parts[of] == part], return_inverse=True)
        meshes[str(part)] = file.vertices[used], corners.reshape(-1, 3)
        instances.append(Instance(name or path.name, str(part), np.eye(4)))
    return meshes, instances


def _loaded(path: Path) -> tuple[Meshes, list[Instance]]:
    """Return the meshes that trimesh reads from a file, and the instances in file order.

    Raises
    ------
    Exception
        Any error that a parser of trimesh raises.
    """
    import trimesh

    names: list[str] | None = None
    suffix = path.suffix.lower()
    with path.open("rb") as opened:
        file: Any = opened
        if suffix in {".glb", ".gltf"}:
            file, names = _gltf.prepared(path)
        options: dict[str, Any] = {"resolver": Beside(path), "process": False}
        if names is not None:
            options["skip_materials"] = True
        kind = "".join(path.suffixes[-2:]).lower() if suffix in {".gz", ".bz2"} else suffix
        loaded = trimesh.load_scene(file, file_type=kind.removeprefix("."), **options)
    meshes = {
        name: (np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))
        for name, mesh in loaded.geometry.items()
        if isinstance(mesh, trimesh.Trimesh)
    }
    instances = []
    for node in loaded.graph.nodes_geometry:
        transform, mesh = loaded.graph[node]
        if mesh in meshes:
            name = str(node) if names is None else names[int(str(node).partition("_")[0])]
            instances.append(Instance(name, str(mesh), np.asarray(transform)))
    if not any(len(meshes[instance.mesh][1]) for instance in instances):
        raise FileFormatError("it holds no triangles")
    return meshes, instances


register_mesh_reader(recognise, read_mesh_of_scene)
register_scene_reader("a scene of meshes, by its suffix", recognise, read)
