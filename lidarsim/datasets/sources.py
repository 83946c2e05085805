"""Files that a data set depends on: those that its recipe names, and those that these files name in turn."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

import yaml

from lidarsim._base.files import beside, noting_reads
from lidarsim.config.document import Node, entries, folder_of, read
from lidarsim.errors import ConfigError, FileFormatError
from lidarsim.io import raster
from lidarsim.io.scenes import mjcf
from lidarsim.io.scenes._mjcf import collect
from lidarsim.io.scenes.mesh_files import file_name, map_kd
from lidarsim.io.trajectories.nuscenes import TABLES

FILES = {"file", "times", "firing_times"}
"""Keys whose values are paths, relative to the folder of their document."""

FREE = {"datasheet", "sources"}
"""Keys of a sensor with free text and numbers for people."""

YAML = {".yaml", ".yml"}

GLB = 20
"""Bytes before the JSON of a binary glTF: a file header of 12 and a chunk header of 8, which begins with the length."""


def paths(node: Node, keys: tuple[int | str, ...] = ()) -> Iterator[tuple[tuple[int | str, ...], Node]]:
    """Yield the nodes that are paths, each with its keys; all choices of a draw are included.

    Parameters
    ----------
    node : Node
        A document, or a part of one.
    keys : tuple of int and str
        The keys of `node`.
    """
    yield from _paths(node, keys, is_path=False)


def _paths(node: Node, keys: tuple[int | str, ...], *, is_path: bool) -> Iterator[tuple[tuple[int | str, ...], Node]]:
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _paths(item, (*keys, index), is_path=is_path)
    elif isinstance(node, yaml.MappingNode):
        for key, (_, value) in entries(node).items():
            if key not in FREE:
                yield from _paths(value, (*keys, key), is_path=_is_path(key, is_path))
    elif is_path and node.tag.endswith(":str"):
        yield keys, node


def _is_path(key: str, above: bool) -> bool:
    """Return whether the value of a key is a path: ``file``, ``scene.1.file``, or a ``choice`` within them."""
    return key.rpartition(".")[2] in FILES or (above and key == "choice")


def relocate(node: Node, folder: str, *, is_path: bool = False) -> Node:
    """Return a document with all paths made relative to `folder`."""
    if isinstance(node, yaml.SequenceNode):
        items = [relocate(item, folder, is_path=is_path) for item in node.value]
        return yaml.SequenceNode(node.tag, items, node.start_mark, node.end_mark)
    if isinstance(node, yaml.MappingNode):
        pairs = [
            (key, value if key.value in FREE else relocate(value, folder, is_path=_is_path(key.value, is_path)))
            for key, value in node.value
        ]
        return yaml.MappingNode(node.tag, pairs, node.start_mark, node.end_mark)
    if is_path and node.tag.endswith(":str"):
        return yaml.ScalarNode(node.tag, _relative(folder, _path(node)), node.start_mark, node.end_mark)
    return node


def _path(node: Node) -> Path:
    return folder_of(node.start_mark) / str(node.value)


def _relative(folder: str, path: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()


def hashes(nodes: Iterable[Node], folder: str) -> dict[str, str]:
    """Return the SHA-256 of each file that documents name, by its path from `folder`.

    Files that these name in turn are included: those in YAML, the buffers and images of glTF, the materials of OBJ and
    their images, the images of COLLADA, all that a model of MuJoCo names but its textures, the projection of an ASCII
    grid, and the tables beside poses of nuScenes.
    """
    found: dict[str, str] = {}
    documents = list(nodes)
    while documents:
        for _, node in paths(documents.pop()):
            path = _path(node)
            if not path.is_file() or _relative(folder, path) in found:
                continue
            for file in [path, *_files_named_in(path)]:
                with file.open("rb") as content:
                    found[_relative(folder, file)] = hashlib.file_digest(content, "sha256").hexdigest()
            if path.suffix.lower() in YAML:
                with suppress(ConfigError):  # a vendor's file
                    documents.append(read(path))
    return dict(sorted(found.items()))


def _files_named_in(path: Path) -> list[Path]:
    """Return the files that a file names, resolved as its reader does; empty if the reader refuses the file."""
    names: list[str] = []
    found: set[Path] = set()
    suffix = path.suffix.lower()
    with suppress(AttributeError, KeyError, RecursionError, TypeError, ValueError), path.open("rb") as file:
        if path.name == TABLES[-1]:
            names = list(TABLES[:-1])
        elif suffix in {".gltf", ".glb"}:
            content = _gltf(file, binary=suffix == ".glb")
            items = [item for kind in ("buffers", "images") for item in content.get(kind, ())]
            names = [item["uri"] for item in items if "uri" in item]
        elif suffix == ".obj":
            lines = (line.split(None, 1) for line in file if line.lstrip().startswith(b"mtllib"))
            texts = [words[1].decode().strip() for words in lines if len(words) == 2]
            names = [
                name for text in texts for name in dict.fromkeys((file_name(text), *text.split()))
            ]  # one, or several
        elif suffix == ".mtl":
            lines = (line.split(None, 1) for line in file if line.lstrip().startswith(b"map_Kd"))
            names = [map_kd(words[1].decode()).name for words in lines if len(words) == 2]
        elif suffix == ".dae":
            names = [name.decode().strip() for name in re.findall(rb"<(?:init_from|ref)>([^<]+)<", file.read())]
        elif mjcf.recognise(path):
            with noting_reads() as found:
                collect(path)
        elif file.read(4) not in raster.TIFF:  # a grid may have any suffix
            names = [quote(place.name) for place in raster.projections(path)]
    for name in names:
        with suppress(AttributeError, FileFormatError, OSError, TypeError, ValueError):
            found.add(beside(path, name))
    folder = path.parent.resolve()
    files = [path.parent / file.relative_to(folder) if file.is_relative_to(folder) else file for file in sorted(found)]
    return files + [image for file in files if file.suffix.lower() == ".mtl" for image in _files_named_in(file)]


def _gltf(file: BinaryIO, *, binary: bool) -> Any:
    return json.loads(file.read(int.from_bytes(file.read(GLB)[12:16], "little") if binary else -1))
