"""Data sets: many frames of varying scenes, made on one machine or many, with bit-identical results.

A frame depends only on the recipe and on the numbers of its sequence and frame, so a data set can be made in any order
by any number of workers, and existing frames need not be made again.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lidarsim._base.shown import quantity
from lidarsim._base.validation import flag, integer, named_labels, one_of, short_repr
from lidarsim.datasets.result import Generated
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, LidarsimError

if TYPE_CHECKING:
    import numpy as np
    from distributed import Client

    from lidarsim._base.files import PathLike
    from lidarsim._base.validation import Transform
    from lidarsim.datasets.loading import DataSet
    from lidarsim.lidar import Lidar
    from lidarsim.motion.trajectory import Trajectory
    from lidarsim.rig import Rig
    from lidarsim.run import Deskew
    from lidarsim.scan.pointcloud import PointCloud
    from lidarsim.world.scene import Scene

    MakeRun = Callable[[np.random.Generator, int], tuple[Scene, Lidar | Rig, Trajectory | Transform | None]]

__all__ = ["Generated", "generate", "load", "verify"]

TOLD = 10
"""Greatest number of failed shards that an error names."""


def generate(
    recipe: PathLike | MakeRun,
    output: PathLike,
    *,
    client: Client | None = None,
    after_scan: Callable[[PointCloud, np.random.Generator], PointCloud] | None = None,
    part: tuple[int, int] = (0, 1),
    overrides: Sequence[str] = (),
    sequences: int | None = None,
    frames: int | None = None,
    seed: int | None = None,
    layout: str | dict[str, Any] | None = None,
    shard_frames: int | None = None,
    class_names: dict[int, str] | None = None,
    splits: Mapping[str, float | Sequence[int]] | None = None,
    frame: Literal["sensor", "world"] = "sensor",
    deskew: Deskew | None = None,
    pictures: int = 3,
    verify: bool = False,
) -> Generated:
    """Make a data set, resume an incomplete one, or make the lost files of a complete one again.

    Existing files of the same data set are kept: after a crash, the same call continues where the last one stopped. Its
    files that are missing or of another size are made again, with the same bytes. Several calls may make the same data
    set at once. Nothing is written outside the output, and only files that a data set of the same recipe wrote are
    replaced or removed.

    Parameters
    ----------
    recipe : path-like or callable
        A YAML file (keys: ``configs/REFERENCE.md``), the name of a packaged recipe, such as ``"detection"``, or
        a function that takes a `numpy.random.Generator` and a sequence number, and returns a `Scene`, a `Lidar` or
        `Rig`, and its trajectory, its pose or None. Only the same function resumes a data set: its code must be equal,
        and so must the values of its defaults, of variables of enclosing functions and of the globals that it reads,
        also in the functions and classes that it uses; installed packages are compared by name only. These values must
        be picklable, and must not change between calls. Files that the function reads, and modules that it imports in
        its body, are not compared.
    output : str or path-like
        A folder, or a URL as text, such as ``s3://bucket/folder``.
    client : dask.distributed.Client, optional
        Client of the cluster whose workers make the data set; they must see the recipe's files, and an output folder,
        under the same paths. Default: this process.
    after_scan : callable, optional
        A function that gets the cloud of each frame of each sensor, with all columns, and a `numpy.random.Generator`
        that is seeded by the recipe's seed, the sequence, the frame and the sensor, and returns the cloud to write,
        such as one without the points that a learned model drops. It replaces that of the recipe, and is compared on
        resuming as a recipe function is. Boxes count the points that it returns; those with fewer than the `min_points`
        of the layout are left out. In layouts with boxes, clouds of scenes with mirrors have a field `mirrored`,
        bool: whether a point is a ghost, which boxes do not count. Default: that of the recipe; none for a function.
    part : tuple of int
        ``(i, n)`` makes only part i of n, counting from 0. The call that completes the data set writes its tables.
    overrides : sequence of str
        Values of a YAML recipe to replace or add, such as ``"run.sensor={preset: ouster-os1-64}"``.
    sequences, frames : int, optional
        Number of sequences, and of frames in each. Default: those of the recipe; 1 for a function.
    seed : int, optional
        Seed of all draws and all noise. Default: that of the recipe; 0 for a function.
    layout : str or dict, optional
        ``"semantickitti"``, ``"kitti"``, ``"openpcdet"``, ``"mmdetection3d"``, ``"nuscenes"``, ``"shards"`` or
        ``"bags"``, or a mapping with this as ``type`` and the layout's keys (``configs/REFERENCE.md``);
        ``configs/README.md`` lists the files of each layout. Default: that of the recipe; ``"shards"`` for a function.
    shard_frames : int, optional
        Number of frames made at a time. Default: as many as fire 40 million pulses, but at most 1/32 of all.
    class_names : dict of int to str, optional
        Class names by label; they replace those of the recipe and override those of the scene.
    splits : dict of str to float or sequence of int, optional
        Splits of the sequences by name: shares that sum to 1, such as ``{"train": 0.8, "val": 0.2}``, or lists of the
        numbers of their sequences. Default: those of the recipe; none for a function.
    frame : {"sensor", "world"}
        Coordinates of the points of a function's runs, as in `Scan.point_cloud`; "world" only in ``"shards"``. A YAML
        recipe has ``run.cloud.frame``.
    deskew : bool, {"start", "middle", "end"} or float, optional
        How the points of a function's runs are deskewed, as in `Scan.point_cloud`. Default: "start" in a layout with
        boxes, else False. In a layout with boxes, the points of moving instances are moved along. Points in bags are
        raw. A YAML recipe has ``run.cloud.deskew``.
    pictures : int
        Number of frames that the data card shows; none without PyVista. A complete data set keeps its number.
    verify : bool
        Whether to compare the SHA-256 of all existing files, too, which reads them whole; those that differ are made
        again. Default: only their sizes are compared.

    Returns
    -------
    Generated
        What was made.

    Raises
    ------
    ConfigError
        If the recipe cannot be used.
    LidarsimError
        If the output holds another data set, other files under names of this one, or damaged notes
        (`FileFormatError`), if the scheduler is lost, if lost files cannot be made again with the same bytes, or if
        shards failed three times; all other shards are made.
    OSError
        If the disk is full. Finished files stay, and the same call resumes.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range, if a sensor's name cannot be that of a file (in bags:
        of a topic), or if the layout cannot hold the label of a class or object.

    Examples
    --------
    >>> import tempfile
    >>> import lidarsim as ls
    >>> def scenes(rng, sequence):
    ...     scene = ls.Scene()
    ...     _ = scene.add(ls.Sphere((rng.uniform(5, 10), 0, 0), 1.0), label=1)
    ...     return scene, ls.Lidar.preset("velodyne-vlp16"), None
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = ls.generate(scenes, folder, sequences=2, layout="semantickitti", pictures=0)
    ...     done.frames, sorted(path.name for path in Path(folder).rglob("*.bin"))
    (2, ['000000.bin', '000000.bin'])
    """
    from lidarsim.datasets import after_scan as changes
    from lidarsim.datasets import recipe as recipes
    from lidarsim.datasets.layouts import layout_of
    from lidarsim.datasets.run import run
    from lidarsim.scan.scan import moment_of

    if not callable(recipe) and not isinstance(recipe, str | os.PathLike):
        raise ArgumentTypeError("recipe", "a path or a function", short_repr(recipe))
    part = _part(part)
    pictures = integer("pictures", pictures, at_least=0)
    verify = flag("verify", verify)
    if deskew is not None:
        moment_of(deskew, 1.0)  # only checks it
    one_of("frame", frame, ("sensor", "world"))
    _check_client(client)
    _check_texts(overrides)
    most = {"sequences": recipes.MOST, "frames": recipes.MOST, "seed": 2**64 - 1, "shard_frames": recipes.MOST**2}
    given: dict[str, Any] = {"sequences": sequences, "frames": frames, "seed": seed, "shard_frames": shard_frames}
    for name, value in given.items():
        if value is not None:
            given[name] = integer(name, value, at_least=int(name != "seed"), at_most=most[name])
    names = named_labels("class_names", class_names)
    given["splits"] = _splits(splits)
    chosen = None if layout is None else layout_of(layout)
    change = None if after_scan is None else changes.from_function(after_scan)
    if callable(recipe):
        if overrides:
            raise ArgumentValueError("overrides", "none with a function", short_repr(overrides))
        defaults = {"sequences": 1, "frames": 1, "seed": 0}
        settings = {key: defaults.get(key) if value is None else value for key, value in given.items()}
        settings["layout"] = chosen or layout_of("shards")
        made = recipes.from_function(recipe, names, deskew, frame, change, **settings)
    else:
        for name, value, default in (("deskew", deskew, None), ("frame", frame, "sensor")):
            if value != default:
                hint = f"use overrides=['run.cloud.{name}=…']"
                raise ArgumentValueError(name, f"{default} with a YAML recipe", short_repr(value), hint)
        if chosen is not None:
            given["layout"] = chosen.model_dump()
        if class_names is not None:
            given["class_names"] = {str(label): name for label, name in names.items()}
        values = {name: value for name, value in given.items() if value is not None}
        made = recipes.load(Path(recipe), overrides, values, change)
    result, failed = run(made, output, client, part, pictures, verify=verify)
    if failed:
        more = f" (and {len(failed) - TOLD} more)" if len(failed) > TOLD else ""
        raise LidarsimError(f"{quantity(len(failed), 'shard')} failed; " + "; ".join(map(str, failed[:TOLD])) + more)
    return result


def _part(part: object) -> tuple[int, int]:
    """Return the number of the part, and the number of parts."""
    if not isinstance(part, tuple | list) or len(part) != 2:
        wrong = ArgumentValueError if isinstance(part, tuple | list) else ArgumentTypeError
        raise wrong("part", "(i, n), part i of n", short_repr(part))
    count = integer("part[1]", part[1], at_least=1)
    return integer("part[0]", part[0], at_least=0, at_most=count - 1), count


def _check_texts(overrides: Sequence[str]) -> None:
    texts = isinstance(overrides, Sequence) and not isinstance(overrides, str | bytes)
    if not texts or not all(isinstance(text, str) for text in overrides):
        raise ArgumentTypeError("overrides", "a sequence of strings", short_repr(overrides))


def _splits(splits: object) -> dict[str, Any] | None:
    """Return splits in plain types; their values are checked with the recipe."""
    if splits is None:
        return None
    if not isinstance(splits, Mapping) or not all(isinstance(name, str) for name in splits):
        raise ArgumentTypeError("splits", "a mapping from names to shares or lists of sequences", short_repr(splits))
    return {name: [*part] if isinstance(part, tuple | range) else part for name, part in splits.items()}


def _check_client(client: object) -> None:
    """Raise an error unless `client` is a Dask client; a caller who has one has imported its package."""
    distributed = sys.modules.get("distributed")
    if client is not None and (distributed is None or not isinstance(client, distributed.Client)):
        raise ArgumentTypeError("client", "a dask.distributed.Client", short_repr(client))


def load(folder: PathLike, *, split: str | None = None) -> DataSet:
    """Read back a data set of any layout, lazily, for training.

    Parameters
    ----------
    folder : str or path-like
        The folder of a complete data set, or a URL as text, such as ``s3://bucket/folder``.
    split : str, optional
        Only the frames of this split. Default: all frames.

    Returns
    -------
    DataSet
        A sequence of frames, ordered by sequence, frame and sensor: ``len(frames)`` is their number, and ``frames[i]``
        reads one, with the cloud as the layout holds it, its boxes, poses and time, and images on demand; with a rig,
        the frames of each sensor count. It can be pickled, and used in threads and forked processes, and is a map-style
        data set of PyTorch. Reading a frame from bags reads the bag up to it; bags with a cut are refused.

    Raises
    ------
    FileFormatError
        If there is no complete data set, its notes are damaged, or it is of bags with a cut.
    TypeError, ValueError
        If the data set has no such split, or `folder` is no path.

    Examples
    --------
    >>> import tempfile
    >>> import lidarsim as ls
    >>> def scenes(rng, sequence):
    ...     scene = ls.Scene()
    ...     _ = scene.add(ls.Sphere((rng.uniform(5, 10), 0, 0), 1.0), label=1)
    ...     return scene, ls.Lidar.preset("velodyne-vlp16"), None
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = ls.generate(scenes, folder, sequences=2, layout="kitti", pictures=0)
    ...     frames = ls.datasets.load(folder)
    ...     frame = frames[1]
    >>> len(frames), frame.sequence, frame.boxes.label.tolist(), frame.image(size=(16, 900)).shape
    (2, 1, [1], (16, 900))
    """
    from lidarsim.datasets import loading

    return loading.load(folder, split)


def verify(output: PathLike) -> list[str]:
    """Check the SHA-256 of each file of a data set, and of its recipe.

    Parameters
    ----------
    output : str or path-like
        A folder, or a URL as text, such as ``s3://bucket/folder``.

    Returns
    -------
    list of str
        The problems, one line per file; empty if all files are intact.

    Raises
    ------
    FileFormatError
        If the data set does not exist or is incomplete, or its manifest is damaged.
    TypeError, ValueError
        If `output` is neither.
    """
    from lidarsim.datasets import manifest
    from lidarsim.datasets.store import open_store

    return [problem for problem in manifest.verify(open_store(output)) if problem]
