"""Scene files: one module per format, each of which returns nodes; `_build` makes objects of them."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Literal

from lidarsim.errors import FileFormatError
from lidarsim.io.meshes import SUFFIXES
from lidarsim.io.scenes import mjcf
from lidarsim.io.scenes._build import Imported, Reader, import_file, mesh_of, scene_with
from lidarsim.io.scenes.others import CONVERTERS
from lidarsim.world.rules import Appearance, Options, Rule
from lidarsim.world.scene import Scene, register_scene_reader
from lidarsim.world.shapes.triangle_mesh import MeshFile, register_mesh_reader

__all__ = ["Imported", "objects_of"]

MODULES = {
    **dict.fromkeys((".glb", ".gltf"), "gltf"),
    **dict.fromkeys((".dae", ".zae"), "dae"),
    **dict.fromkeys(SUFFIXES, "mesh_files"),
    **dict.fromkeys(CONVERTERS, "others"),
}
"""Modules by suffix, imported with the first file, since pydantic takes long."""


def _reader(path: Path) -> Reader:
    if not _recognise(path):
        known = ", ".join(sorted(MODULES.keys() - CONVERTERS.keys()))
        raise FileFormatError(f"{path}: expected a scene file ({known}), MJCF or URDF")
    module = importlib.import_module(f"lidarsim.io.scenes.{MODULES[path.suffix.lower()]}")
    read: Reader = module.read
    return read


def _recognise(path: Path, _head: bytes = b"") -> bool:
    return path.suffix.lower() in MODULES


def _read(
    path: Path,
    *,
    up: Literal["y", "z"] | None = None,
    unit: float | None = None,
    rules: tuple[Rule, ...] = (),
    reflectivity: Appearance = None,
) -> Scene:
    """Read a file as documented in `lidarsim.Scene.from_file`, which checks the options."""
    return scene_with(import_file(path, _reader(path), Options(up, unit, rules, reflectivity)))


def objects_of(path: Path, options: Options) -> Imported:
    """Return the objects of a file and what became of its parts."""
    if mjcf.recognise(path):
        return mjcf.import_file(path, options)
    return import_file(path, _reader(path), options)


def _read_mesh(path: Path) -> MeshFile:
    """Read a file as documented in `lidarsim.TriangleMesh.from_file`."""
    return mesh_of(_reader(path), path)


register_mesh_reader(_recognise, _read_mesh)
register_scene_reader("a scene of meshes, by its suffix", _recognise, _read)
