"""What a data set is made from: a run and what varies in it, or a function."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import numpy as np
import yaml
from pydantic import Field

from lidarsim._validation import integer
from lidarsim.config.document import (
    Loaded,
    Node,
    Place,
    assigned,
    entries,
    merge,
    plain,
    read,
    replace,
    without,
    written,
)
from lidarsim.config.loader import CHOICES, Change, built, checked, whole
from lidarsim.config.schema import Model, labelled
from lidarsim.datasets.draws import Draw, Stream
from lidarsim.datasets.layouts import AnyLayout, Layout, layout_of
from lidarsim.datasets.scatter import Placed, Scatter, scatter
from lidarsim.errors import ConfigError
from lidarsim.rig import Rig
from lidarsim.run import Run
from lidarsim.scene import Scene
from lidarsim.sensor import Lidar
from lidarsim.trajectory import Trajectory

if TYPE_CHECKING:
    from lidarsim._validation import Transform

__all__ = ["Recipe", "from_function", "load"]

SHARD_PULSES = 40_000_000
"""Pulses of a shard by default: what one core fires and writes in some 20 s."""

SHARDS = 32, 100_000
"""Fewest and most shards: enough for a few workers to end at about the same time, not too many for a scheduler."""

FILES = {"file", "times", "firing_times"}
"""Keys whose values are paths, relative to the folder of the file that they are written in."""


class Settings(Model):
    """The keys of a recipe beside its run."""

    sequences: Annotated[int, Field(ge=1)] = 1
    frames: Annotated[int, Field(ge=1)] = 1
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    shard_frames: Annotated[int, Field(ge=1)] | None = None
    layout: AnyLayout
    class_names: dict[str, str] = Field(default={})
    vary: dict[str, Draw] = Field(default={})
    scatter: dict[str, Scatter] = Field(default={})


class Source(Protocol):
    """Where the runs of a data set come from; it can be pickled."""

    def run(self, sequence: int, frame: int | None = None) -> Run:
        """Return the run of a sequence, or as it is in one frame."""

    @property
    def by_frame(self) -> bool:
        """Whether the frames of a sequence differ in more than time."""

    def resolved(self) -> dict[str, Any]:
        """Return what the runs are made from, as plain values."""

    def files(self) -> dict[str, str]:
        """Return the SHA-256 of each file that the runs are made from, by its name in `resolved`."""


@dataclass(frozen=True)
class Recipe:
    """What a data set is made from.

    Attributes
    ----------
    source : Source
        Gives the run of each sequence.
    sequences, frames : int
        How many sequences there are, and frames in each.
    seed : int
        Seed of all draws and all noise.
    shard_frames : int
        How many frames are made at a time: frame f of sequence s belongs to shard ``(s * frames + f) // shard_frames``.
    layout : Layout
        How the files are laid out.
    class_names : dict of int to str
        Names of labels: those of the scene, and those of the recipe over them.
    """

    source: Source
    sequences: int
    frames: int
    seed: int
    shard_frames: int
    layout: Layout
    class_names: dict[int, str]

    @property
    def shards(self) -> int:
        """How many shards there are."""
        return -(-self.sequences * self.frames // self.shard_frames)

    def shard(self, index: int) -> Iterator[tuple[int, range]]:
        """Yield the sequences of a shard, each with those of its frames that are in the shard."""
        start, stop = index * self.shard_frames, min((index + 1) * self.shard_frames, self.sequences * self.frames)
        for sequence in range(start // self.frames, -(-stop // self.frames)):
            first = sequence * self.frames
            yield sequence, range(max(start - first, 0), min(stop - first, self.frames))

    def resolved(self) -> dict[str, Any]:
        """Return the recipe as plain values, with all defaults filled in."""
        return {
            "sequences": self.sequences,
            "frames": self.frames,
            "seed": self.seed,
            "shard_frames": self.shard_frames,
            "layout": self.layout.model_dump(),
            "class_names": {str(label): name for label, name in sorted(self.class_names.items())},
            **self.source.resolved(),
        }


def noise_seed(seed: int, sequence: int) -> int:
    """Return the seed of the noise in a sequence."""
    return Stream(seed, "noise", sequence).word()


@dataclass(frozen=True, eq=False)
class Document:
    """Runs of a YAML document in which some values are drawn."""

    folder: str
    node: Node
    settings: Settings
    root: Node
    loaded: Loaded = field(default_factory=dict, repr=False)
    assembled: dict[tuple[int, ...], Node] = field(default_factory=dict, repr=False)
    placed: dict[int, list[Placed]] = field(default_factory=dict, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave out what was loaded."""
        return Document, (self.folder, self.node, self.settings, self.root)

    @property
    def by_frame(self) -> bool:
        """Whether anything is drawn anew for each frame."""
        return any(draw.per == "frame" for draw in self.settings.vary.values())

    def run(self, sequence: int, frame: int | None = None) -> Run:
        """Return the run of a sequence, or what it is in one frame."""
        run = self._drawn(sequence, frame)
        groups, place = self.settings.scatter, Place(self.root, (), self.loaded) / "scatter"
        if groups and sequence not in self.placed:
            self.placed.clear()
            first = self._drawn(sequence, 0) if self.by_frame else run
            self.placed[sequence] = scatter(groups, place, first, self.settings.seed, sequence)
        for placed in self.placed.get(sequence, ()):
            item = groups[placed.group].objects[placed.index]
            item.add_at(placed.motion, placed.scale, run.scene, place / placed.group / "objects" / placed.index)
        return run

    def _drawn(self, sequence: int, frame: int | None) -> Run:
        """Return the run with the values that vary."""
        settings = self.settings
        choices: list[Change] = []
        others: list[Change] = []
        chosen = []
        for key, draw in settings.vary.items():
            stream = Stream(settings.seed, f"vary.{key}", sequence, frame if draw.per == "frame" else None)
            there = entries(entries(entries(self.root)["vary"][1])[key][1])
            number = draw.draw(stream)
            value: Node
            if draw.choice is not None:
                value = there["choice"][1].value[number]
            else:
                value = written(number, next(iter(there.values()))[0])
            if CHOICES.fullmatch(key):
                choices.append((key.split("."), value))
                chosen.append(int(number))
            else:
                others.append((key.split("."), value))
        node = self.assembled.get(tuple(chosen))
        if node is None:
            node = self.assembled.setdefault(tuple(chosen), whole(self.node, choices))
        for path, value in others:
            node = replace(node, path, value)
        run = built(node, self.loaded)
        frames = range(run.frames.start, run.frames.start + settings.frames)
        return dataclasses.replace(run, seed=noise_seed(settings.seed, sequence), frames=frames)

    def resolved(self) -> dict[str, Any]:
        """Return run and draws; paths are relative to the folder of the recipe."""
        chooses = any(CHOICES.fullmatch(key) for key in self.settings.vary)
        nodes = {"run": self.node if chooses else whole(self.node)}
        nodes |= {key: value for key, (_, value) in entries(self.root).items() if key in {"vary", "scatter"}}
        return {key: plain(self._located(node)) for key, node in nodes.items()}

    def files(self) -> dict[str, str]:
        """Return the SHA-256 of each file that the recipe names, by its path from the folder of the recipe."""
        hashes: dict[str, str] = {}
        nodes = [self._located(whole(self.node)), self._located(without(self.root, "run"))]
        while nodes:
            node = nodes.pop()
            for key, (_, value) in entries(node).items():
                if key in FILES and isinstance(value, yaml.ScalarNode):
                    path = Path(self.folder) / value.value
                    hashes[value.value] = hashlib.sha256(path.read_bytes()).hexdigest()
                nodes.append(value)
            if isinstance(node, yaml.SequenceNode):
                nodes.extend(node.value)
        return dict(sorted(hashes.items()))

    def _located(self, node: Node) -> Node:
        """Return a document whose paths are relative to the folder of the recipe, wherever they are written."""
        if isinstance(node, yaml.SequenceNode):
            return yaml.SequenceNode(node.tag, [self._located(item) for item in node.value], node.start_mark)
        if not isinstance(node, yaml.MappingNode):
            return node
        items: list[tuple[Node, Node]] = []
        for key, value in node.value:
            if key.value in FILES and isinstance(value, yaml.ScalarNode):
                path = Path(value.start_mark.name).parent / value.value
                path = Path(os.path.relpath(path, self.folder))
                items.append((key, yaml.ScalarNode(value.tag, path.as_posix(), value.start_mark, value.end_mark)))
            else:
                items.append((key, self._located(value)))
        return yaml.MappingNode(node.tag, items, node.start_mark, node.end_mark)


def load(path: Path, overrides: Sequence[str] = ()) -> Recipe:
    """Return the recipe in a YAML file.

    Raises
    ------
    ConfigError
        If the recipe cannot be used; the message names file, line and key.
    """
    path = path.absolute()
    root = read(path)
    for assignment in overrides:
        root = replace(root, *assigned(assignment))
    place = Place(root)
    if "run" not in entries(root):
        raise place.error("missing key 'run': a recipe has the configuration that it varies there")
    settings = checked(Settings, without(root, "run"))
    for key, draw in settings.vary.items():
        draw.check(place / "vary" / key)
    for key, group in settings.scatter.items():
        group.check(place / "scatter" / key)
    source = Document(str(path.parent), _run(place / "run", root), settings, root)
    return _recipe(source, settings, labelled(settings.class_names, place / "class_names"))


def _run(place: Place, root: Node) -> Node:
    """Return the document of the run: the file that it names, and the differences from it."""
    node = entries(root)["run"][1]
    found = entries(node)
    if "file" not in found:
        return node
    name = plain(found["file"][1])
    if not isinstance(name, str):
        raise (place / "file").error("expected the path of a configuration")
    return merge(read((place / "file").file(name)), without(node, "file"))


MakeRun = Callable[[np.random.Generator, int], tuple[Scene, "Lidar | Rig", "Trajectory | Transform | None"]]


@dataclass(frozen=True)
class Function:
    """Runs of a function."""

    function: MakeRun
    frames: int
    seed: int
    by_frame: bool = False

    def run(self, sequence: int, frame: int | None = None) -> Run:
        """Return the run of a sequence."""
        del frame
        parts: Any = self.function(np.random.Generator(Stream(self.seed, "", sequence).bits), sequence)
        if not isinstance(parts, tuple) or len(parts) != 3:
            raise TypeError(f"recipe: expected it to return (scene, rig, trajectory), got {type(parts).__name__}")
        scene, sensor, pose = parts
        if not isinstance(scene, Scene) or not isinstance(sensor, Lidar | Rig):
            got = f"{type(scene).__name__}, {type(sensor).__name__}"
            raise TypeError(f"recipe: expected it to return a Scene and a Lidar or a Rig first, got {got}")
        still = np.eye(4) if pose is None else pose
        seed = noise_seed(self.seed, sequence)
        return Run(scene, sensor, still, seed, range(self.frames), {"frame": "sensor", "deskew": False})

    def resolved(self) -> dict[str, Any]:
        """Return the name of the function."""
        return {"function": f"{self.function.__module__}.{self.function.__qualname__}"}

    def files(self) -> dict[str, str]:
        """Return the SHA-256 of the function's source, if it can be read."""
        try:
            text = inspect.getsource(self.function)
        except OSError:
            return {}
        return {self.function.__qualname__: hashlib.sha256(text.encode()).hexdigest()}


def from_function(function: MakeRun, class_names: dict[int, str], **settings: Any) -> Recipe:
    """Return the recipe that a function is, with these settings.

    Raises
    ------
    TypeError, ValueError
        If a setting is of the wrong type or out of its range.
    """
    for name, least in {"sequences": 1, "frames": 1, "seed": 0, "shard_frames": 1}.items():
        if settings[name] is not None:
            settings[name] = integer(name, settings[name], at_least=least, at_most=2**64 - 1)
    settings["layout"] = layout_of(settings["layout"])
    known = Settings.model_construct(**settings)
    return _recipe(Function(function, known.frames, known.seed), known, class_names)


def _recipe(source: Source, settings: Settings, class_names: dict[int, str]) -> Recipe:
    """Return the recipe after checking the run of its first frame."""
    run = source.run(0, 0)
    if run.cloud["frame"] == "world":
        raise ConfigError("cloud.frame: expected sensor, since a data set stores the poses separately, got world")
    run.check_coverage()
    total, shard_frames = settings.sequences * settings.frames, settings.shard_frames
    if shard_frames is None:
        pulses = sum(len(lidar.pattern.pulses(run.frames.start).time) for lidar in run.lidars.values())
        least, most = (-(-total // shards) for shards in reversed(SHARDS))
        shard_frames = max(1, least, min(SHARD_PULSES // max(pulses, 1), most))
    return Recipe(
        source=source,
        sequences=settings.sequences,
        frames=settings.frames,
        seed=settings.seed,
        shard_frames=min(shard_frames, total),
        layout=settings.layout,
        class_names=dict(run.scene.class_names) | class_names,
    )
