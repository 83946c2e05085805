"""Data sets: many frames of scenes that vary, made on one machine or on many, always the same to the last bit.

A frame depends on the recipe and on the numbers of its sequence and of the frame alone, so a data set can be made in
any order and by any number of workers, and what is there already need not be made again.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lidarsim._shown import counted
from lidarsim._validation import integer, named_labels, shown
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, LidarsimError

if TYPE_CHECKING:
    import numpy as np
    from distributed import Client

    from lidarsim._files import PathLike
    from lidarsim._validation import Transform
    from lidarsim.rig import Rig
    from lidarsim.scene import Scene
    from lidarsim.sensor import Lidar
    from lidarsim.trajectory import Trajectory

    MakeRun = Callable[[np.random.Generator, int], tuple[Scene, Lidar | Rig, Trajectory | Transform | None]]

__all__ = ["Generated", "generate", "verify"]

TOLD = 10
"""Failed shards that an error names, at most."""


@dataclass(frozen=True)
class Generated:
    """What a call of `generate` did.

    Attributes
    ----------
    frames, points : int
        Made by this call; what was there before is not counted.
    seconds : float
        How long that took.
    shards_left : int
        Shards that are still to be made by other parts; 0 when the data set is complete.
    """

    frames: int
    points: int
    seconds: float
    shards_left: int


def generate(
    recipe: str | Path | MakeRun,
    output: PathLike,
    *,
    client: Client | None = None,
    part: tuple[int, int] = (0, 1),
    overrides: Sequence[str] = (),
    sequences: int | None = None,
    frames: int | None = None,
    seed: int | None = None,
    layout: str | dict[str, Any] | None = None,
    shard_frames: int | None = None,
    class_names: dict[int, str] | None = None,
    pictures: int = 3,
) -> Generated:
    """Make a data set, or resume one that is not complete.

    Existing files of the same data set are kept: after a crash, the same call continues where the last one stopped.
    Several calls may make the same data set at once. Nothing is written outside of the output, and nothing is replaced
    or removed there that no data set of the same recipe wrote.

    Parameters
    ----------
    recipe : path-like or callable
        A YAML file (``configs/README.md`` has its keys), or a function that takes a `numpy.random.Generator` and the
        number of a sequence, and returns a `Scene`, a `Lidar` or `Rig`, and its trajectory, its pose or None. A data
        set is resumed only by the same function: of the same code, with the same values of the defaults, the variables
        of functions around it and the globals that it reads, and of those of the functions and classes that it calls;
        of installed packages, names alone count. So these values must be such that they can be pickled, and must not
        change from call to call. Files that the function reads, and modules that it imports in its body, are not
        compared.
    output : str or path-like
        A folder, or as text a URL such as ``s3://bucket/folder``.
    client : dask.distributed.Client, optional
        Client of the cluster whose workers make the data set; they see the files that the recipe names, and a folder as
        output, under the same paths. Default: this process.
    part : tuple of int
        ``(i, n)`` makes only part i of n, counting from 0. The call that completes the data set writes its tables.
    overrides : sequence of str
        Values of a recipe in YAML to replace or add, such as ``"run.sensor.preset=ouster-os1-64"``.
    sequences, frames : int, optional
        Number of sequences, and of frames in each. Default: those of the recipe; 1 for a function.
    seed : int, optional
        Seed of all draws and all noise. Default: that of the recipe; 0 for a function.
    layout : str or dict, optional
        ``"semantickitti"``, ``"nuscenes"``, ``"shards"`` or ``"bags"``, or a mapping with that as ``type`` and the
        layout's options. Default: that of the recipe; ``"shards"`` for a function.
    shard_frames : int, optional
        Number of frames made at a time. Default: as many as fire 40 million pulses, but at most a 32nd of all.
    class_names : dict of int to str, optional
        Class names by label, in place of the recipe's own, and over those of the scene.
    pictures : int
        Number of frames that the data card shows; without PyVista it shows none.

    Returns
    -------
    Generated
        What was made.

    Raises
    ------
    ConfigError
        If the recipe cannot be used.
    LidarsimError
        If the output holds another data set, other files under the names that the data set writes, or damaged notes of
        it (`FileFormatError`), the scheduler is lost, or shards failed three times; all others are made.
    OSError
        If the disk is full. What is done stays, and the same call resumes.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range, a sensor has a name that a file, or in bags a topic,
        cannot have, or a class or object of the scene a label that the layout cannot hold.

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
    from lidarsim.datasets import recipe as recipes
    from lidarsim.datasets.layouts import layout_of
    from lidarsim.datasets.run import run

    if not callable(recipe) and not isinstance(recipe, str | os.PathLike):
        raise ArgumentTypeError("recipe", "a path or a function", shown(recipe))
    part = _part(part)
    pictures = integer("pictures", pictures, at_least=0)
    _check_client(client)
    texts = isinstance(overrides, Sequence) and not isinstance(overrides, str | bytes)
    if not texts or not all(isinstance(text, str) for text in overrides):
        raise ArgumentTypeError("overrides", "a sequence of strings", shown(overrides))
    most = {"sequences": recipes.MOST, "frames": recipes.MOST, "seed": 2**64 - 1, "shard_frames": recipes.MOST**2}
    given: dict[str, Any] = {"sequences": sequences, "frames": frames, "seed": seed, "shard_frames": shard_frames}
    for name, value in given.items():
        if value is not None:
            given[name] = integer(name, value, at_least=int(name != "seed"), at_most=most[name])
    names = named_labels("class_names", class_names)
    chosen = None if layout is None else layout_of(layout)
    if callable(recipe):
        if overrides:
            raise ArgumentValueError("overrides", "none with a function", shown(overrides))
        defaults = {"sequences": 1, "frames": 1, "seed": 0}
        settings = {key: defaults.get(key) if value is None else value for key, value in given.items()}
        made = recipes.from_function(recipe, names, layout=chosen or layout_of("shards"), **settings)
    else:
        if chosen is not None:
            given["layout"] = chosen.model_dump()
        if class_names is not None:
            given["class_names"] = {str(label): name for label, name in names.items()}
        values = {name: value for name, value in given.items() if value is not None}
        made = recipes.load(Path(recipe), overrides, values)
    result, failed = run(made, output, client, part, pictures)
    if failed:
        more = f" (and {len(failed) - TOLD} more)" if len(failed) > TOLD else ""
        raise LidarsimError(f"{counted(len(failed), 'shard')} failed; " + "; ".join(map(str, failed[:TOLD])) + more)
    return result


def _part(part: object) -> tuple[int, int]:
    """Return the number of a part, and of all parts."""
    if not isinstance(part, tuple | list) or len(part) != 2:
        wrong = ArgumentValueError if isinstance(part, tuple | list) else ArgumentTypeError
        raise wrong("part", "(i, n), part i of n", shown(part))
    count = integer("part[1]", part[1], at_least=1)
    return integer("part[0]", part[0], at_least=0, at_most=count - 1), count


def _check_client(client: object) -> None:
    """Raise an error unless `client` is one of Dask: whoever has one has imported its package."""
    distributed = sys.modules.get("distributed")
    if client is not None and (distributed is None or not isinstance(client, distributed.Client)):
        raise ArgumentTypeError("client", "a dask.distributed.Client", shown(client))


def verify(output: PathLike) -> list[str]:
    """Check the SHA-256 of each file of a data set, and of its recipe.

    Parameters
    ----------
    output : str or path-like
        A folder, or as text a URL such as ``s3://bucket/folder``.

    Returns
    -------
    list of str
        What is wrong, one line per file; empty if all is well.

    Raises
    ------
    FileFormatError
        If there is no data set, or an incomplete one, or its manifest is damaged.
    TypeError, ValueError
        If `output` is no such thing.
    """
    from lidarsim.datasets import manifest
    from lidarsim.datasets.store import open_store

    return [problem for problem in manifest.verify(open_store(output)) if problem]
