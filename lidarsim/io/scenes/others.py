"""Formats that are not read, with a program that converts them, and the rest of those that trimesh reads."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from lidarsim._files import beside
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes._model import Names, Node, Part, SceneFile

CONVERTERS = {
    ".3ds": ("3DS", "GLB with assimp"),
    ".blend": ("Blender", "GLB with Blender"),
    ".cityjson": ("CityJSON", "OBJ or GLB with cjio"),
    ".fbx": ("FBX", "GLB with Blender or FBX2glTF"),
    ".ifc": ("IFC", "GLB with IfcConvert"),
    ".ifczip": ("IFC", "GLB with IfcConvert"),
    ".iges": ("IGES", "OBJ with FreeCAD"),
    ".json": ("JSON", "OBJ or GLB with cjio if it is CityJSON"),
    ".skp": ("SketchUp", "GLB with SketchUp"),
    ".step": ("STEP", "OBJ with FreeCAD"),
    ".stp": ("STEP", "OBJ with FreeCAD"),
    ".usd": ("USD", "GLB with Blender"),
    ".usda": ("USD", "GLB with Blender"),
    ".usdc": ("USD", "GLB with Blender"),
    ".usdz": ("USD", "GLB with Blender"),
    ".wrl": ("VRML", "GLB with Blender"),
    ".x3d": ("X3D", "GLB with Blender"),
    ".x3db": ("X3D", "GLB with Blender"),
    ".x3dv": ("X3D", "GLB with Blender"),
    ".xodr": ("OpenDRIVE", "OBJ with libOpenDRIVE"),
}
"""Names of formats that are not read, and what to convert them to, with which program."""


class Beside:
    """Resolver through which trimesh reads the files beside a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def get(self, name: str) -> bytes:
        """Return the bytes of the file `name`; see `lidarsim._files.beside`."""
        return beside(self._path, name).read_bytes()

    __getitem__ = get


def known(path: Path) -> bool:
    """Return whether the suffix of a file is one of trimesh's, or of a format that has a converter."""
    if path.suffix.lower() in CONVERTERS:
        return True
    import trimesh

    return path.suffix.lower().removeprefix(".") in trimesh.available_formats()


def read(path: Path) -> SceneFile:
    """Read a file by trimesh, in its units and axes: the nodes in its order, by its names.

    Raises
    ------
    FileFormatError
        For a format that is not read; it names a converter.
    Exception
        Any error that a parser of trimesh raises.
    """
    suffix = path.suffix.lower()
    if suffix in CONVERTERS:
        name, how = CONVERTERS[suffix]
        raise FileFormatError(f"{name} is not read; convert it to {how}")
    import trimesh

    kind = "".join(path.suffixes[-2:]).lower() if suffix in {".gz", ".bz2"} else suffix
    with path.open("rb") as opened:
        options: dict[str, Any] = {"resolver": Beside(path), "process": False}
        loaded = trimesh.load_scene(opened, file_type=kind.removeprefix("."), **options)
    parts = {name: (_part(mesh),) for name, mesh in loaded.geometry.items() if isinstance(mesh, trimesh.Trimesh)}
    file = SceneFile()
    for number, node in enumerate(loaded.graph.nodes_geometry):
        transform, mesh = loaded.graph[node]
        if mesh in parts:
            key = number, 0
            file.add(
                Node(Names(re.sub(r"\s+", " ", str(node))), np.array(transform, np.float64), parts[mesh], key, key, key)
            )
    return file


def _part(mesh: Any) -> Part:
    faces = np.asarray(mesh.faces, np.int64)
    return Part(np.asarray(mesh.vertices, np.float64), faces.ravel(), np.full(len(faces), 3))
