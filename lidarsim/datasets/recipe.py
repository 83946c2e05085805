"""Recipes of data sets: a run with varying values, or a function."""

from __future__ import annotations

import dataclasses
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from lidarsim._base.validation import Floats, optional_pose, short_repr
from lidarsim.config.document import (
    Loaded,
    Node,
    Place,
    argument,
    dump,
    entries,
    merge,
    node_of,
    parse_assignment,
    path_of,
    plain,
    read,
    replace,
    without,
)
from lidarsim.config.factories import Model
from lidarsim.config.loader import CHOICES, Change, assign, build_run, validate, whole
from lidarsim.config.objects import Mesh, SceneFile, size_of
from lidarsim.config.schema import names_by_label
from lidarsim.config.starter import configuration
from lidarsim.datasets import after_scan
from lidarsim.datasets.after_scan import AfterScan
from lidarsim.datasets.draws import Draw, Stream
from lidarsim.datasets.fingerprint import check_function, fingerprint, name_of
from lidarsim.datasets.layouts import AnyLayout, Layout
from lidarsim.datasets.scatter import Placed, Scatter, nearby, scatter
from lidarsim.datasets.scatter._folders import expand_files
from lidarsim.datasets.scattered import Scattered
from lidarsim.datasets.sources import hashes, paths, relocate
from lidarsim.datasets.splits import Splits, check_splits
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.lidar import Lidar
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig
from lidarsim.run import CloudArguments, Deskew, Run
from lidarsim.scan.scan import moment_of
from lidarsim.world.scene import Scene

if TYPE_CHECKING:
    from lidarsim._base.validation import Transform

SHARD_PULSES = 40_000_000
"""Default number of pulses per shard, which one core fires and writes in about 20 s."""

SHARDS = 32, 100_000
"""Fewest and most shards by default: enough for a few workers to end together, not too many for a scheduler."""

MOST_SHARDS = 1_000_000
"""Greatest number of shards that `shard_frames` may give: each has a file of notes, and all are listed."""

MOST = 2**32
"""Greatest number of sequences, and of frames in one: frame numbers have 32 bits."""


SHARED = {
    "seed": "the recipe's own key seed",
    "frames": "the recipe's own key frames",
    "class_names": "the recipe's own key class_names",
    "cloud": "run.cloud",
}
"""Keys of the run that cannot vary, each with the key that sets it for all frames."""

LATEST = 1e9
"""Greatest time to which points are deskewed, s; notes hold times up to a thousand times as long."""


class Settings(Model):
    """The keys of a recipe except its run."""

    sequences: Annotated[int, Field(ge=1, le=MOST)] = 1
    """Number of sequences."""
    frames: Annotated[int, Field(ge=1, le=MOST)] = 1
    """Number of frames in each."""
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    """Seed of all draws and all noise."""
    shard_frames: Annotated[int, Field(ge=1)] | None = None
    """Frames made at a time. Default: as many as fire 40 million pulses, but at most 1/32 of all."""
    layout: AnyLayout
    """Layout of the files, by name or with its keys."""
    class_names: dict[str, str] = Field(default={})
    """Names of labels; they override those of the run."""
    splits: dict[str, Any] = Field(default={})
    """Shares, `{train: 0.8, val: 0.2}`, or lists of sequences, `{train: [0, 1], val: [2]}`."""
    vary: dict[str, Draw] = Field(default={})
    """A [draw](#draw) for each key of the run that varies, written as in `--set`."""
    scatter: dict[str, Scatter] = Field(default={})
    """Groups of randomly placed objects, by name."""
    after_scan: str | None = None
    """`module:function` that changes each cloud before it is written."""


class Source(ABC):
    """Source of the runs of a data set; it can be pickled."""

    @abstractmethod
    def run(self, sequence: int, frame: int | None = None) -> Run:
        """Return the run of a sequence, or its state in one frame."""

    @property
    def by_frame(self) -> bool:
        """Whether the frames of a sequence differ in more than time."""
        return False

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the description of the runs as plain values."""

    @abstractmethod
    def files(self) -> dict[str, str]:
        """Return the SHA-256 of each file, or part of a function, that the runs depend on, by name."""

    def scatter_counts(self, sequence: int) -> Scattered:
        """Return the counts of the scattered objects of a sequence."""
        return Scattered()

    @abstractmethod
    def nearby(self, sequence: int) -> dict[str, float]:
        """Return the objects of the scene that are in the sensor's way in a sequence, and when each is first, s."""

    def sizes(self) -> dict[str, Floats]:
        """Return the size of each model that is scattered, by its file, m."""
        return {}

    def extremes(self) -> Iterable[Run]:
        """Yield the first run with the least and the greatest value of each draw, and with each choice."""
        return ()


@dataclass(frozen=True)
class Recipe:
    """Description of a data set.

    Attributes
    ----------
    source : Source
        Source of the run of each sequence.
    sequences, frames : int
        Number of sequences, and of frames in each.
    seed : int
        Seed of all draws and all noise.
    shard_frames : int
        Frames made at a time: frame f of sequence s belongs to shard ``(s * frames + f) // shard_frames``.
    layout : Layout
        File layout.
    class_names : dict of int to str
        Class names by label: those of the scene, overridden by those of the recipe.
    splits : Splits
        Splits of the sequences.
    after_scan : AfterScan or None
        Function that changes each cloud before it is written.
    """

    source: Source
    sequences: int
    frames: int
    seed: int
    shard_frames: int
    layout: Layout
    class_names: dict[int, str]
    splits: Splits
    after_scan: AfterScan | None = None

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.sequences * self.frames // self.shard_frames)

    def shard(self, index: int) -> Iterator[tuple[int, range]]:
        """Yield the sequences of a shard, each with its frames in the shard."""
        start, stop = index * self.shard_frames, min((index + 1) * self.shard_frames, self.sequences * self.frames)
        for sequence in range(start // self.frames, -(-stop // self.frames)):
            first = sequence * self.frames
            yield sequence, range(max(start - first, 0), min(stop - first, self.frames))

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain values, with all defaults filled in."""
        return {
            "sequences": self.sequences,
            "frames": self.frames,
            "seed": self.seed,
            "shard_frames": self.shard_frames,
            "layout": self.layout.model_dump(),
            "class_names": {str(label): name for label, name in sorted(self.class_names.items())},
            "splits": dict(self.splits.given),
            **({"after_scan": self.after_scan.name} if self.after_scan else {}),
            **self.source.to_dict(),
        }

    def files(self) -> dict[str, str]:
        """Return the SHA-256 of each file, or part of a function, that the data set depends on, by name."""
        own = self.after_scan.made_of if self.after_scan else {}
        return self.source.files() | {f"after_scan: {name}": digest for name, digest in own.items()}

    def text(self) -> str:
        """Return the recipe in YAML; `load` restores it if its source is a document."""
        return dump(self.to_dict())


def noise_seed(seed: int, sequence: int) -> int:
    """Return the seed of the noise in a sequence."""
    return Stream(seed, "noise", sequence).word()


@dataclass(frozen=True, eq=False)
class Document(Source):
    """Runs from a YAML document in which some values are drawn."""

    folder: str
    node: Node
    settings: Settings
    root: Node
    loaded: Loaded = field(default_factory=dict, repr=False)
    assembled: dict[tuple[int, ...], Node] = field(default_factory=dict, repr=False)
    placed: dict[int, tuple[list[Placed], Scattered]] = field(default_factory=dict, repr=False)
    """The scattered objects of the last sequence, and their counts."""
    runs: dict[int, Run] = field(default_factory=dict, repr=False)
    """The run of the last sequence, unless its frames differ."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave out the caches."""
        return Document, (self.folder, self.node, self.settings, self.root)

    @property
    def by_frame(self) -> bool:
        """Whether any value is drawn per frame."""
        return any(draw.per == "frame" for draw in self.settings.vary.values())

    def run(self, sequence: int, frame: int | None = None) -> Run:
        """Return the run of a sequence, or its state in one frame."""
        run = self.runs.get(sequence)  # none if frames differ
        if run is None:
            run = self._draw(sequence, frame)
            for instance in self.scatter(sequence, None if self.by_frame else run)[0]:
                instance.add_to(run.scene, self._groups)
            if not self.by_frame:
                _replace(self.runs, sequence, run)
        return run

    def scatter(self, sequence: int, first: Run | None = None) -> tuple[list[Placed], Scattered]:
        """Return the scattered objects of a sequence, and their counts; `first` is its run in its first frame."""
        if not self.settings.scatter:
            return [], Scattered()
        found = self.placed.get(sequence)
        if found is None:
            first = first or self._draw(sequence, 0)
            found = scatter(self.settings.scatter, self._groups, first, self.settings.seed, sequence)
            _replace(self.placed, sequence, found)
        return found

    @property
    def _groups(self) -> Place:
        """Place of the scattered objects in the recipe."""
        return Place(self.root, (), self.loaded) / "scatter"

    def scatter_counts(self, sequence: int) -> Scattered:
        """Return the counts of the scattered objects of a sequence."""
        return self.scatter(sequence)[1]

    def nearby(self, sequence: int) -> dict[str, float]:
        """Return the objects of the scene that are in the sensor's way in a sequence, and when each is first, s."""
        return nearby(self._draw(sequence, 0), self.settings.scatter)

    def sizes(self) -> dict[str, Floats]:
        """Return the size of each model that is scattered, by its file, m."""
        return {
            item.file: size_of(item, self._groups / name / "objects" / index)
            for name, group in self.settings.scatter.items()
            for index, item in enumerate(group.objects)
            if isinstance(item, Mesh | SceneFile)
        }

    def extremes(self) -> Iterable[Run]:
        """Yield the first run with the least and the greatest value of each draw, and with each choice."""
        return (self._draw(0, 0, {key: end}) for key, draw in self.settings.vary.items() for end in draw.extremes)

    def _draw(self, sequence: int, frame: int | None, numbers: Mapping[str, float] | None = None) -> Run:
        """Return the run with its drawn values; `numbers` replace what draws give, by key."""
        settings = self.settings
        choices: list[Change] = []
        others: list[Change] = []
        chosen = []
        draws = entries(entries(self.root)["vary"][1]) if settings.vary else {}
        for key, draw in settings.vary.items():
            stream = Stream(settings.seed, f"vary.{key}", sequence, frame if draw.per == "frame" else None)
            there = entries(draws[key][1])
            given = (numbers or {}).get(key)
            number = draw.draw(stream) if given is None else given
            value = (
                node_of(number, next(iter(there.values()))[0])
                if draw.choice is None
                else there["choice"][1].value[number]
            )
            if CHOICES.fullmatch(key):
                chosen.append(int(number))
            (choices if CHOICES.fullmatch(key) else others).append((key.split("."), value))
        node = self.assembled.get(tuple(chosen))
        if node is None:
            node = self.assembled.setdefault(tuple(chosen), whole(self.node, choices))
        for path, value in others:
            node = replace(node, path, value)
        run = build_run(node, self.loaded)
        if run.legs:
            pose = Place(node, (), self.loaded) / "pose"
            raise pose.error("expected one pose or trajectory, got strips or stations")
        cloud = entries(entries(node)["cloud"][1]) if "cloud" in entries(node) else {}
        if settings.layout.of_scans:
            run = dataclasses.replace(run, cloud={"frame": run.cloud["frame"], "deskew": False})
        elif settings.layout.box_filter is not None and cloud.keys().isdisjoint({"deskew", "deskew_s"}):
            run = dataclasses.replace(run, cloud={"frame": run.cloud["frame"], "deskew": "start"})
        with (Place(node, (), self.loaded) / "cloud" / "deskew_s").refusals({"deskew": ("", "")}):
            _check_deskew(run.cloud["deskew"])
        frames = range(run.frames.start, run.frames.start + settings.frames)
        return dataclasses.replace(run, seed=noise_seed(settings.seed, sequence), frames=frames)

    def to_dict(self) -> dict[str, Any]:
        """Return run and draws; paths are relative to the folder of the recipe."""
        chooses = any(CHOICES.fullmatch(key) for key in self.settings.vary)
        run = self.node if chooses else whole(self.node)
        if self.settings.layout.of_scans and "cloud" in entries(run):  # as the points are
            run = replace(run, ["cloud"], without(entries(run)["cloud"][1], "deskew", "deskew_s"))
        nodes = {"run": run}
        nodes |= {key: value for key, (_, value) in entries(self.root).items() if key in {"vary", "scatter"}}
        return {key: plain(relocate(node, self.folder)) for key, node in nodes.items()}

    def files(self) -> dict[str, str]:
        """Return the SHA-256 of each file that the recipe names or a draw may choose, and of the files they name."""
        return hashes([self.root, self.node, whole(self.node)], self.folder)


def _check_deskew(deskew: Deskew) -> None:
    """Raise `ValueError` if points are deskewed to a time that the notes of a data set cannot hold."""
    moment = moment_of(deskew, 1.0)
    if moment is not None and abs(moment) > LATEST:
        raise ArgumentValueError("deskew", f"a time from {-LATEST:g} to {LATEST:g} s", f"{moment:g}")


def _replace(cache: dict[int, Any], sequence: int, value: object) -> None:
    """Keep the value of a sequence alone. Threads share the caches, so none may rely on what it put there."""
    cache.clear()
    cache[sequence] = value


def load(
    path: Path,
    overrides: Sequence[str] = (),
    given: Mapping[str, object] | None = None,
    change: AfterScan | None = None,
) -> Recipe:
    """Return the recipe in a YAML file.

    Parameters
    ----------
    path : Path
        The file, or the name of a packaged recipe.
    overrides : sequence of str
        Values to replace or add.
    given : mapping of str to object, optional
        Values of the recipe's own keys, which override all others.
    change : AfterScan, optional
        Function that changes the clouds, instead of that of the recipe.

    Raises
    ------
    ConfigError
        If the recipe cannot be used; the message names file, line and key.
    """
    path = configuration(path).absolute()
    root = read(path)
    for assignment in overrides:
        assigned, new = parse_assignment(assignment)
        root = assign(root, _path(assigned), new)
    for name, value in (given or {}).items():
        root = replace(root, [name], argument(name, value))
    root = expand_files(root)
    loaded: Loaded = {}
    place = Place(root, (), loaded)
    if "run" not in entries(root):
        raise place.error("missing key 'run': a recipe has the configuration that it varies there")
    settings = validate(Settings, without(root, "run"))
    for key, draw in settings.vary.items():
        if not path_of(key):
            raise (place / "vary" / key).error("expected a key of the run, such as scene.0.radius_m")
        if told := SHARED.get(path_of(key)[0]):
            raise (place / "vary" / key).error(f"expected no draw, since it is the same in all frames: use {told}")
        draw.check(place / "vary" / key)
    for key, group in settings.scatter.items():
        group.check(place / "scatter" / key)
    for key in ("vary", "scatter"):  # reports missing files early, even if they are drawn late
        for keys, node in paths(entries(root)[key][1], (key,)) if key in entries(root) else ():
            place.at(keys).file(node.value)
    source = Document(str(path.parent), _run(place / "run", root), settings, root, loaded)
    names = names_by_label(settings.class_names, place / "class_names")
    with place.refusals({"class_names": ("class_names", "")}):
        settings.layout.check_labels(names, Scene())
    splits = Splits(check_splits(settings.splits, settings.sequences, place / "splits"))
    if change is not None:
        _check_change(change, settings.layout)
    elif settings.after_scan is not None:
        with (place / "after_scan").refusals({"after_scan": ("", "")}):
            change = after_scan.load(settings.after_scan, str(path.parent))
            _check_change(change, settings.layout)
    with (place / "run").refusals({key: (key, "") for key in ("class_names", "atmosphere", "scene")}):
        made = _recipe(source, settings, names, splits, change)
    with (place / "layout").refusals():
        made.layout.check_classes(made.class_names)
    if made.shards > MOST_SHARDS:
        raise (place / "shard_frames").error(f"expected at most {MOST_SHARDS:,} shards, got {made.shards:,}")
    return made


def _path(keys: list[str]) -> list[str]:
    """Return the path in a recipe of the keys of an assignment: the key of a draw has dots of its own."""
    return ["vary", ".".join(keys[1:])] if keys[0] == "vary" and keys[1:] else keys


def _run(place: Place, root: Node) -> Node:
    """Return the document of the run: the file that it names, merged with the changes to it.

    A recipe has a seed and a number of frames of its own.
    """
    node = entries(root)["run"][1]
    found = entries(node)
    for key in ("seed", "frames"):
        if key in found:
            got = short_repr(plain(found[key][1]))
            raise (place / key).error(f"expected none, got {got}: use the recipe's own key {key}")
    if "file" not in found:
        return node
    name = plain(found["file"][1])
    if not isinstance(name, str):
        raise (place / "file").error("expected the path of a configuration")
    base = read((place / "file").file(name))
    if "scene" in found and "file" in entries(found["scene"][1]):
        base = without(base, "scene")
    return without(merge(base, without(node, "file")), "seed", "frames")


MakeRun = Callable[[np.random.Generator, int], tuple[Scene, "Lidar | Rig", "Trajectory | Transform | None"]]


@dataclass(frozen=True)
class Function(Source):
    """Runs from a function; `made_of` is its fingerprint, and `cloud` tells the coordinates of its points."""

    function: MakeRun
    frames: int
    seed: int
    made_of: dict[str, str]
    cloud: CloudArguments

    def run(self, sequence: int, frame: int | None = None) -> Run:
        """Return the run of a sequence."""
        parts: Any = self.function(np.random.Generator(Stream(self.seed, "", sequence).bits), sequence)
        if not isinstance(parts, tuple) or len(parts) != 3:
            raise ArgumentTypeError("recipe", "it to return (scene, rig, trajectory)", type(parts).__name__)
        scene, sensor, pose = parts
        if not isinstance(scene, Scene) or not isinstance(sensor, Lidar | Rig):
            got = f"{type(scene).__name__}, {type(sensor).__name__}"
            raise ArgumentTypeError("recipe", "it to return a Scene and a Lidar or a Rig first", got)
        if not isinstance(pose, Trajectory):
            pose = optional_pose("recipe's pose", pose)
        seed = noise_seed(self.seed, sequence)
        return Run(scene, sensor, pose, seed, range(self.frames), self.cloud)

    def to_dict(self) -> dict[str, Any]:
        """Return the name of the function, and the coordinates of its points."""
        return {"function": name_of(self.function), "cloud": dict(self.cloud)}

    def files(self) -> dict[str, str]:
        """Return the hashes of the function's code and of the values that it takes from outside."""
        return dict(self.made_of)

    def nearby(self, sequence: int) -> dict[str, float]:
        """Return the objects that the sensor passes through in a sequence."""
        return nearby(self.run(sequence), {})


def from_function(
    function: MakeRun,
    class_names: dict[int, str],
    deskew: Deskew | None = None,
    frame: Literal["sensor", "world"] = "sensor",
    change: AfterScan | None = None,
    **settings: Any,
) -> Recipe:
    """Return the recipe of a function with settings that were checked before, except `splits`.

    Raises
    ------
    TypeError
        If the function does not take a generator and a number, or depends on a value that cannot be hashed.
    ValueError
        If there are too many shards, or the splits or the class names cannot be used.
    """
    check_function("recipe", function, "a generator and a number", "a path or a function")
    known = Settings.model_construct(**settings)
    splits = Splits(check_splits(known.splits, known.sequences))
    if deskew is None:
        deskew = False if known.layout.box_filter is None else "start"
    _check_deskew(deskew)
    if known.layout.of_scans and moment_of(deskew, 1.0) is not None:
        expected = f"False in {known.layout.type}, which has the messages of the sensors' drivers"
        raise ArgumentValueError("deskew", expected, short_repr(deskew))
    if change is not None:
        _check_change(change, known.layout)
    made_of = fingerprint(function)  # before a call, which may change its values
    source = Function(function, known.frames, known.seed, made_of, {"frame": frame, "deskew": deskew})
    made = _recipe(source, known, class_names, splits, change)
    made.layout.check_classes(made.class_names)
    if made.shards > MOST_SHARDS:
        raise ArgumentValueError("shard_frames", f"at most {MOST_SHARDS:,} shards", f"{made.shards:,}")
    return made


def _check_change(change: AfterScan, layout: Layout) -> None:
    if layout.of_scans:
        expected = f"none with {layout.type}, which has the messages of the sensors' drivers"
        raise ArgumentValueError("after_scan", expected, change.name)


def _recipe(
    source: Source, settings: Settings, class_names: dict[int, str], splits: Splits, change: AfterScan | None
) -> Recipe:
    """Return the recipe after checking the run of its first frame."""
    run = source.run(0, 0)
    if run.cloud["frame"] == "world" and not settings.layout.in_world:
        kind = settings.layout.type
        raise ArgumentValueError("cloud.frame", f"sensor in {kind}, which stores the poses separately", "world")
    run.check_coverage()
    total, shard_frames = settings.sequences * settings.frames, settings.shard_frames
    if shard_frames is None:
        pulses = sum(len(lidar.pattern.pulses(run.frames.start).time) for lidar in run.lidars.values())
        least, most = (-(-total // shards) for shards in reversed(SHARDS))
        shard_frames = max(1, least, min(SHARD_PULSES // max(pulses, 1), most))
    names = dict(run.scene.class_names) | class_names
    for label, name in names.items():
        if re.search("[\ud800-\udfff]", name):
            raise ArgumentValueError(f"class_names[{label}]", "text", f"half a character in {short_repr(name)}")
    settings.layout.check_labels(names, run.scene)
    return Recipe(
        source=source,
        sequences=settings.sequences,
        frames=settings.frames,
        seed=settings.seed,
        shard_frames=min(shard_frames, total),
        layout=settings.layout,
        class_names=names,
        splits=splits,
        after_scan=change,
    )
