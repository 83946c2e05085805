"""Scene files of meshes with instances (``.glb``, ``.gltf``, ``.3mf``, ``.dae``, …), read by trimesh."""

from __future__ import annotations

from pathlib import Path

from lidarsim._files import mesh_source, told
from lidarsim.errors import FileFormatError
from lidarsim.scene import Scene, register_scene_reader
from lidarsim.shapes import TriangleMesh


def recognise(path: Path, _head: bytes) -> bool:
    """Tell by its suffix whether trimesh reads a file; some of its formats have no signature."""
    import trimesh

    return path.suffix.lower().removeprefix(".") in trimesh.available_formats()


def read(path: Path) -> Scene:
    """Read as `lidarsim.Scene.from_file` documents."""
    import trimesh

    try:
        loaded = trimesh.load_scene(**mesh_source(path))
    except Exception as error:  # trimesh's readers raise whatever their parsers do
        raise FileFormatError(f"{path}: cannot be read as a scene: {told(error)}") from error
    meshes = {
        name: TriangleMesh.from_trimesh(mesh)
        for name, mesh in loaded.geometry.items()
        if isinstance(mesh, trimesh.Trimesh)
    }
    scene = Scene()
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        if name in meshes:
            scene.add(meshes[name], name=node, transform=transform)
    if not len(scene):
        raise FileFormatError(f"{path}: cannot be read as a scene: it holds no triangles")
    return scene


register_scene_reader("a scene of meshes, by its suffix", recognise, read)
