"""The animations of a glTF file, and where its nodes are at rest.

Format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, sections 3.7.2, 3.7.3 and 3.11, and appendix C.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io.scenes import _gltf_document as gltf
from lidarsim.io.scenes._animation import WIDTHS, Animation, Figure, Pose, Sampler, rotations
from lidarsim.io.scenes._gltf_data import Data, at, check_finite
from lidarsim.io.scenes._model import affine


def animations_of(document: gltf.Document, data: Data) -> dict[str, Animation]:
    """Return the animations of a document by name, after checking them; those without a name have their number."""
    found: dict[str, Animation] = {}
    samples: dict[tuple[int, str], Floats] = {}
    for number, animation in enumerate(document.animations):
        name = animation.name or str(number)
        channels = dict(_channels(document, data, number, animation, samples))
        if channels:
            duration = max(float(sampler.times[-1]) for sampler in channels.values())
            found[name if name not in found else f"{name}/{number}"] = Animation(duration, channels)
    return found


def _channels(
    document: gltf.Document,
    data: Data,
    number: int,
    animation: gltf.Animation,
    samples: dict[tuple[int, str], Floats],
) -> Iterator[tuple[tuple[int, str], Sampler]]:
    """Yield the samplers of an animation by node and property."""
    seen: set[tuple[int, str]] = set()
    for place, channel in enumerate(animation.channels):
        where = f"animations[{number}].channels[{place}]"
        sampler = at(animation.samplers, channel.sampler, f"{where}.sampler")
        node, path = channel.target.node, channel.target.path
        if node is None or path not in {*WIDTHS, "weights"}:  # what an extension animates is passed over
            continue
        target = at(document.nodes, node, f"{where}.target.node")
        if target.matrix is not None and path != "weights":
            raise FileFormatError(f"{where}: expected a node without a matrix, got nodes[{node}]")
        if (node, path) in seen:
            raise FileFormatError(f"{where}: expected one channel a property, got another of the {path} of {node}")
        seen.add((node, path))
        yield (node, path), _sampler(data, sampler, f"animations[{number}].samplers[{channel.sampler}]", path, samples)


def _sampler(
    data: Data, sampler: gltf.AnimationSampler, where: str, path: str, samples: dict[tuple[int, str], Floats]
) -> Sampler:
    """Return a sampler after checking its numbers. Samplers share the arrays of their accessors by `samples`."""

    def numbers(accessor: int, name: str, kinds: Collection[str]) -> Floats:
        key = accessor, name
        if key not in samples:
            values = data.numbers(accessor, f"{where}.{name}", kinds)
            check_finite(values, f"{where}.{name}")
            samples[key] = values
        return samples[key]

    times = numbers(sampler.input, "input", ["SCALAR"])[:, 0]
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        i = int(wrong[0])
        raise FileFormatError(f"{where}.input: expected ascending times, got {times[i + 1]} s after {times[i]} s")
    kind = f"VEC{WIDTHS[path]}" if path in WIDTHS else "SCALAR"
    values = numbers(sampler.output, "output", [kind])
    cubic = sampler.interpolation == "CUBICSPLINE"
    keys = len(times) * (3 if cubic else 1)
    if len(values) % keys or (path in WIDTHS and len(values) != keys):
        expected = f"{keys}" if path in WIDTHS else f"a multiple of {keys}"
        raise FileFormatError(f"{where}.output: expected {expected} values, got {len(values)}")
    shaped = values.reshape((len(times), 3, -1) if cubic else (len(times), -1))
    if path == "rotation":
        zero = np.flatnonzero(~(shaped[:, 1] if cubic else shaped).any(axis=1))
        if len(zero):
            raise FileFormatError(f"{where}.output: expected quaternions other than zero, got zero at key {zero[0]}")
    return Sampler(times, shaped, sampler.interpolation, path == "rotation")


def weights_animated(animations: Mapping[str, Animation]) -> dict[int, int]:
    """Return the number of weights of each node whose morph targets are animated."""
    found: dict[int, int] = {}
    for animation in animations.values():
        for (node, path), sampler in animation.channels.items():
            if path == "weights":
                width = sampler.values.shape[-1]
                if found.setdefault(node, width) != width:
                    raise FileFormatError(f"animations: expected {found[node]} weights of nodes[{node}], got {width}")
    return found


def figure_of(
    animations: Mapping[str, Animation],
    nodes: Sequence[Any],
    order: Sequence[int],
    parents: Sequence[int | None],
    rest: Pose,
) -> Figure | None:
    """Return the moving nodes of a document, or None; `order` has each node before those below it."""
    if not animations:
        return None
    targets = {key for animation in animations.values() for key in animation.channels}
    targeted = {node for node, path in targets if path != "weights"}
    local: dict[int, tuple[Floats, Floats, Floats] | Floats] = {}
    for index in order:
        node = nodes[index]
        if index in targeted:
            given = (node.translation or [0.0] * 3, node.rotation or [0.0, 0.0, 0.0, 1.0], node.scale or [1.0] * 3)
            translation, rotation, scale = (np.array(part) for part in given)
            local[index] = translation, rotation, scale
        elif parents[index] in local:
            local[index] = local_of(node, f"nodes[{index}]")
    weighted = frozenset(node for node, path in targets if path == "weights")
    return Figure(animations, parents, rest, local, weighted)


def local_of(node: gltf.Node, where: str) -> Floats:
    """Return the transform of a node at rest, shape (4, 4)."""
    parts = (node.translation, node.rotation, node.scale)
    if node.matrix is not None:
        if any(part is not None for part in parts):
            raise FileFormatError(f"{where}: expected either a matrix or translation, rotation and scale, got both")
        return affine(np.reshape(node.matrix, (4, 4)).T, f"{where}.matrix")  # stored column by column
    matrix = np.eye(4)
    if node.rotation is not None:
        matrix[:3, :3] = rotations(np.array([node.rotation]), f"{where}.rotation")[0]
    if node.scale is not None:
        matrix[:3, :3] *= node.scale
    if node.translation is not None:
        matrix[:3, 3] = node.translation
    return matrix
