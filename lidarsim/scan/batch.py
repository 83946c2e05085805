"""Batches: the scans of many sensors, poses or worlds in one call, as plain arrays."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple, Never, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.pickling import Pickled
from lidarsim._base.shown import extent, quantity, text_table
from lidarsim._base.validation import (
    UINT32,
    Floats,
    Instances,
    Transform,
    as_array,
    instances_of_rows,
    items,
    one_or_each,
    short_repr,
)
from lidarsim._base.validation import poses as checked_poses
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.motion.trajectory import Trajectory
from lidarsim.patterns import Pulses
from lidarsim.patterns._pulses import pulses_of
from lidarsim.scan.columns import Positions, ScanColumns, with_columns
from lidarsim.scan.scan import path_of, sensor_id, until_of
from lidarsim.sensor.sensor import Sensor
from lidarsim.world.atmosphere import Atmosphere, check_sensor
from lidarsim.world.scene import Scene, Snapshot

Poses: TypeAlias = "Transform | Sequence[Trajectory]"
"""Poses of shape (N, 4, 4), a RigidTransform of N poses, or N trajectories."""

_DEFAULT = ("range", "xyz", "intensity", "status", "label", "object_id")


@with_columns("N, n, k")
class ScanBatch(ScanColumns[Never], Positions, Pickled):
    """The scans of N rows: arrays with one entry per row and pulse, in firing order.

    `lidarsim.Lidar.scan_many` and `lidarsim.scan_many` make batches. A batch has only the arrays that were asked for,
    each C-contiguous in memory of its own: ``torch.from_numpy(batch.range)`` and ``jax.numpy.from_dlpack(batch.range)``
    take it without a copy. Arrays have shape (N, n), or (N, n, k) for sensors of k > 1 returns a pulse, where `status`
    and `return_count` still have shape (N, n). `xyz` is in the sensor frame at the time of the pulse, as in
    `Scan.point_cloud`. Unused entries of floating-point arrays are nan. If sensors or frames with different numbers of
    pulses are mixed, n is the largest; the surplus entries of a row are unused, with a `status` of 255.

    Where a `Scan` has None, a batch has 0 for the radial velocity of all hits, `Source.surface` for the source and 0
    for the path of all returns, the nominal direction of the pulse, and nan for mirrored points.

    Attributes
    ----------
    seed : ndarray of uint64, shape (N,)
        Seed of the noise of each row.
    frame : ndarray of uint32, shape (N,)
        Number of the frame of each row.
    time : ndarray of float64, shape (N,)
        Start of the frame of each row, s.

    Notes
    -----
    Row i equals ``lidar.scan(scene, poses[i], time=batch.time[i], frame=batch.frame[i], seed=batch.seed[i])``, bit for
    bit.
    """

    seed: npt.NDArray[np.uint64]
    frame: npt.NDArray[np.uint32]
    time: Floats

    def __init__(self) -> None:
        raise TypeError("ScanBatch: scan_many makes batches")

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of the arrays that the batch has, without `seed`, `frame` and `time`: tuple of str."""
        return tuple(name for name in self.__dict__ if name in _COLUMNS)

    def __getattr__(self, name: str) -> Any:
        """Raise an error that tells how to get an array that was not asked for."""
        if name in _COLUMNS:
            raise AttributeError(
                f"{name}: not in this batch, which has {', '.join(self.fields)}; ask for it in `fields`"
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __setattr__(self, name: str, value: object) -> None:
        if name in self.__dict__ and value is self.__dict__[name]:  # as after `batch.range *= 2`
            return
        raise AttributeError(f"{name}: a batch keeps its arrays; write into them")

    def _contents(self) -> dict[str, Any]:
        return {name: array for name, array in self.__dict__.items() if name in ScanBatch.__annotations__}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.seed)

    def __repr__(self) -> str:
        """Return the number of rows, and dtype, shape and extent of each array."""
        rows = [(name, f"{array.dtype} {array.shape}  {extent(array)}") for name, array in self._contents().items()]
        return text_table(f"ScanBatch of {quantity(len(self), 'row')}", rows)


_COLUMNS = ScanBatch._columns


class _Rows(NamedTuple):
    """What differs between rows, for the core."""

    scene: npt.NDArray[np.uint32]
    shot: npt.NDArray[np.uint32]
    start: Floats
    seed: npt.NDArray[np.uint64]
    frame: npt.NDArray[np.uint32]
    ignored: tuple[npt.NDArray[np.int64], npt.NDArray[np.uint64] | None] | None


def scan_many(
    lidar: Sensor | Sequence[Sensor],
    scene: Scene | Sequence[Scene],
    poses: Poses,
    *,
    sensor: npt.ArrayLike | None = None,
    time: npt.ArrayLike = 0.0,
    frame: npt.ArrayLike = 0,
    seed: npt.ArrayLike = 0,
    ignore: Instances | Collection[Instances] = (),
    fields: Collection[str] | None = None,
    out: ScanBatch | None = None,
) -> ScanBatch:
    """Fire one frame from each of N poses, in one call.

    Parameters
    ----------
    lidar : Lidar or sequence of Lidar
        The sensor, or sensors of a few kinds, all with the same number of returns.
    scene : Scene or sequence of N Scenes
        The scene, or one for each row. Copies (`copy.copy`) of a scene share its meshes and their hierarchies, so that
        worlds with a static part in common cost little.
    poses : array_like, shape (N, 4, 4), RigidTransform of N poses, or sequence of N Trajectories
        Sensor to world.
    sensor : array_like of int, shape (N,), optional
        The sensor of each row, as an index into `lidar`, which is then a sequence.
    time : float or array_like, shape (N,)
        Start of the frame, s.
    frame : int or array_like of int, shape (N,)
        Number of the frame, 0 to 2³² − 1. Advance it from step to step, so that the noise differs.
    seed : int or array_like of int, shape (N,)
        Seed of the noise, 0 to 2⁶⁴ − 1. An array holds the seed of each row. From one number, a seed is derived for
        each row, so that rows differ: ``np.random.SeedSequence(seed).generate_state(N, np.uint64)``. `ScanBatch.seed`
        has the seeds of the rows.
    ignore : collection of int, or collection of N collections of int
        Instances that the sensor does not see, as if they were not in the scene: of all rows, or of each row.
    fields : collection of str, optional
        The arrays of the batch: attributes of `ScanBatch`. Only these are computed. Default: range, xyz, intensity,
        status, label and object_id.
    out : ScanBatch, optional
        A batch of as many rows and returns, and as many pulses or more, whose arrays are overwritten; `fields` is then
        its own.

    Returns
    -------
    ScanBatch
        One row per pose; `out`, if it is given.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong type or shape or out of its range; if a pose is not rigid, or a trajectory or the
        motion of an object does not cover all pulses; if no object is of an instance to ignore; or if `out` does not
        fit. The error names the row.
    MemoryError
        If there is no memory for the arrays.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> wall = scene.add(ls.Plane((1, 0, 0), 10.0))
    >>> coarse, fine = (ls.Lidar(ls.patterns.Grid(np.linspace(-1, 1, n), [0.0], rate=20.0)) for n in (3, 5))
    >>> batch = ls.scan_many([coarse, fine], scene, [np.eye(4)] * 2, sensor=[0, 1], fields=["range", "status"])
    >>> batch.status
    array([[  0,   0,   0, 255, 255],
           [  0,   0,   0,   0,   0]], dtype=uint8)
    """
    lidars, kind = _sensors(lidar, sensor)
    where, rows = _where(poses)
    scenes, world_of = _worlds(scene, rows)
    start = _each("time", time, rows, np.float64)
    frames = _each("frame", frame, rows, np.uint32)
    seeds = _seeds(seed, rows)
    kinds = _each("sensor", kind, rows, np.uint32, at_most=len(lidars) - 1)
    ignored = instances_of_rows("ignore", ignore, rows)
    most = _most_returns(lidars)
    for each in lidars:
        _native.expect_room(min(math.prod(each.pattern.shape), sys.maxsize), each)  # before the pattern makes pulses
    airs: dict[Atmosphere | None, int] = {}
    for number, world in enumerate(scenes):
        airs.setdefault(world.atmosphere, number)
    for air, number in airs.items():
        place = "" if isinstance(scene, Scene) else f" in scene[{np.argmax(world_of == number)}]"
        for i, each in enumerate(lidars):
            check_sensor(air, each, of=(f" of lidar[{i}]" if isinstance(lidar, list | tuple) else "") + place)
    shots, shot_of = _shots(lidars, kinds, frames)
    pulses = max(len(made) for _, made in shots) if rows else max(len(pulses_of(each.pattern, 0)) for each in lidars)
    for row, world in enumerate(world_of.tolist() if any(world.movers for world in scenes) else ()):
        each, made = shots[shot_of[row]]
        if scenes[world].movers and len(made):
            fired = start[row] + made.time.min(), start[row] + made.time.max()
            until = until_of(made, start[row], 1.0 / each.pattern.rate)
            scenes[world].check_motions(*fired, until, argument=f"time[{row}]")
    if isinstance(where, list):
        paths = [
            path_of(pose, shots[shot][1], at, 1.0 / shots[shot][0].pattern.rate)
            for pose, shot, at in zip(where, shot_of.tolist(), start.tolist(), strict=True)
        ]
    if isinstance(out, ScanBatch):  # perhaps of a frame of more pulses
        pulses = max([pulses, *(getattr(out, name).shape[1] for name in out.fields)])
    batch = _arrays(fields, rows, pulses, most) if out is None else _reuse(out, fields, rows, pulses, most)
    contents = {name: array for name, array in batch.__dict__.items() if name in _COLUMNS}
    _native.scan_many(
        [world.native for world in scenes],
        [world.atmosphere for world in scenes],
        [(each, made, sensor_id(each.name)) for each, made in shots],
        paths if isinstance(where, list) else where.reshape(rows, 16),
        _Rows(world_of, shot_of, start, seeds, frames, ignored),
        pulses,
        most,
        contents,
    )
    counts = np.array([len(made) for _, made in shots])[shot_of] if shots else np.zeros(0, int)
    for name, array in contents.items() if (counts < pulses).any() else ():
        array[np.arange(pulses) >= counts[:, None]] = _COLUMNS[name].unused
    if "object_id" in contents:
        _rename(contents["object_id"], scenes, world_of)
    batch.__dict__.update(seed=seeds, frame=frames, time=start)
    return batch


def _sensors(lidar: Sensor | Sequence[Sensor], sensor: npt.ArrayLike | None) -> tuple[list[Sensor], npt.ArrayLike]:
    """Return the sensors, and the index of each row's or one for all."""
    if not isinstance(lidar, list | tuple):
        if sensor is not None:
            raise ArgumentTypeError("sensor", "none for a single lidar", short_repr(sensor))
        lidars = [lidar]
    else:
        lidars = list(lidar)
        if sensor is None:
            raise ArgumentTypeError("sensor", "an index for each row, as there is a sequence of lidars", "none")
    if not lidars:
        raise ArgumentValueError("lidar", "at least one", "none")
    for i, each in enumerate(lidars):
        if not hasattr(each, "_receiver"):
            name = f"lidar[{i}]" if isinstance(lidar, list | tuple) else "lidar"
            raise ArgumentTypeError(name, "a Lidar", short_repr(each))
    return cast("list[Sensor]", lidars), 0 if sensor is None else sensor


def _where(poses: object) -> tuple[Floats | list[Trajectory], int]:
    """Return the poses, checked and copied, or the trajectories; and the number of rows."""
    if isinstance(poses, Trajectory):
        hint = "one for each row, in a list"
        raise ArgumentTypeError("poses", "poses of shape (N, 4, 4) or N trajectories", "one trajectory", hint)
    if isinstance(poses, list | tuple) and (not poses or any(isinstance(pose, Trajectory) for pose in poses)):
        for i, pose in enumerate(poses):
            if not isinstance(pose, Trajectory):
                raise ArgumentTypeError(f"poses[{i}]", "a Trajectory like the others", short_repr(pose))
        return list(poses), len(poses)
    if isinstance(poses, list | tuple) and any(hasattr(pose, "as_matrix") for pose in poses):
        poses = np.array([pose.as_matrix() if hasattr(pose, "as_matrix") else pose for pose in poses])
    matrices = checked_poses("poses", cast("Transform", poses))
    return matrices, len(matrices)


def _worlds(scene: Scene | Sequence[Scene], rows: int) -> tuple[list[Snapshot], npt.NDArray[np.uint32]]:
    """Return the distinct scenes as they are now, and the index of each row's."""
    if isinstance(scene, Scene):
        return [scene._snapshot()], np.zeros(rows, np.uint32)
    if not isinstance(scene, Iterable):
        raise ArgumentTypeError("scene", "a Scene, or one for each row", short_repr(scene))
    given: list[Any] = list(scene)
    if len(given) != rows:
        raise ArgumentValueError("scene", f"a Scene, or one for each of {rows} rows", f"{len(given)} scenes")
    for i, each in enumerate(given):
        if not isinstance(each, Scene):
            raise ArgumentTypeError(f"scene[{i}]", "a Scene", short_repr(each))
    number: dict[int, int] = {}
    world_of = np.fromiter((number.setdefault(id(each), len(number)) for each in given), np.uint32, rows)
    distinct = {id(each): each for each in given}
    return [distinct[key]._snapshot() for key in number], world_of


def _shots(
    lidars: list[Sensor], kinds: npt.NDArray[np.uint32], frames: npt.NDArray[np.uint32]
) -> tuple[list[tuple[Sensor, Pulses]], npt.NDArray[np.uint32]]:
    """Return the distinct pairs of a sensor and the pulses of a frame, and the index of each row's."""
    if not len(frames):
        return [], np.zeros(0, np.uint32)
    if (frames == frames[0]).all() and len(lidars) == 1:  # a fast path for the common case
        return [(lidars[0], pulses_of(lidars[0].pattern, int(frames[0])))], np.zeros(len(frames), np.uint32)
    wanted, row_of = np.unique(np.stack([kinds, frames], axis=1), axis=0, return_inverse=True)
    shots: dict[tuple[int, int], tuple[Sensor, Pulses]] = {}
    shot_of = []
    for kind, frame in wanted.tolist():
        made = pulses_of(lidars[kind].pattern, frame)
        key = kind, id(made)  # a pattern whose frames are alike returns the same pulses for each
        shots.setdefault(key, (lidars[kind], made))
        shot_of.append(list(shots).index(key))
    return list(shots.values()), np.array(shot_of, np.uint32)[row_of.reshape(-1)]


def _most_returns(lidars: list[Sensor]) -> int:
    returns = [each.measurement.max_returns for each in lidars]
    for i, count in enumerate(returns):
        if count != returns[0]:
            got = f"{returns[0]} and, of lidar[{i}], {count}"
            raise ArgumentValueError("lidar", "sensors with one number of returns", got, "call scan_many once for each")
    return returns[0]


def _each(
    name: str, value: npt.ArrayLike, rows: int, dtype: type[np.generic], *, at_most: int = UINT32
) -> npt.NDArray[Any]:
    """Return `value`, one number or one for each row, as an array of shape (N,) of its own."""
    if dtype is np.float64:
        return np.full(rows, one_or_each(name, value, rows))
    given = as_array(name, value, "integers")
    if given.dtype.kind not in "iu" and given.size:
        # NumPy makes floats of integers on both sides of 2⁶³, and objects of those beyond 2⁶⁴.
        exact = np.array(value, object)
        if not all(isinstance(each, int | np.integer) and not isinstance(each, bool) for each in exact.flat):
            raise ArgumentTypeError(name, "integers", short_repr(value) if given.ndim == 0 else f"dtype {given.dtype}")
        given = exact
    if given.ndim and given.shape != (rows,):
        raise ArgumentValueError(name, f"one integer, or one for each of {rows} rows", f"shape {given.shape}")
    wrong = (given < 0) | (given > at_most)
    if wrong.any():
        i = int(np.argmax(wrong))
        got = f"{name}[{i}] = {short_repr(int(given[i]))}" if given.ndim else short_repr(int(given))
        raise ArgumentValueError(name, f"integers from 0 to {at_most}", got)
    return np.full(rows, given, dtype)


def _seeds(seed: npt.ArrayLike, rows: int) -> npt.NDArray[np.uint64]:
    given = _each("seed", seed, rows, np.uint64, at_most=2**64 - 1)
    if np.ndim(seed) == 0:
        derived: npt.NDArray[Any] = np.random.SeedSequence(int(np.asarray(seed))).generate_state(rows, np.uint64)
        return derived
    return given


def _shape(name: str, rows: int, pulses: int, most: int) -> tuple[int, ...]:
    column = _COLUMNS[name]
    return (rows, pulses, *((most,) if column.of_returns and most > 1 else ()), *column.shape)


def _arrays(fields: Collection[str] | None, rows: int, pulses: int, most: int) -> ScanBatch:
    """Return a batch with uninitialized arrays."""
    names = _DEFAULT if fields is None else items("fields", (fields,) if isinstance(fields, str) else fields, "names")
    for name in names:
        if not (isinstance(name, str) and name in _COLUMNS):
            raise ArgumentValueError("fields", f"names among {', '.join(_COLUMNS)}", short_repr(name))
    return ScanBatch._from_contents(
        {name: np.empty(_shape(name, rows, pulses, most), _COLUMNS[name].dtype) for name in names}
    )


def _reuse(out: ScanBatch, fields: Collection[str] | None, rows: int, pulses: int, most: int) -> ScanBatch:
    """Return `out` after checking that its arrays are those of this batch."""
    if not isinstance(out, ScanBatch):
        raise ArgumentTypeError("out", "a ScanBatch", short_repr(out))
    if fields is not None and {*fields} != {*out.fields}:
        raise ArgumentValueError("out", f"a batch of {', '.join(fields)}", f"one of {', '.join(out.fields)}")
    for name in out.fields:
        array, shape = getattr(out, name), _shape(name, rows, pulses, most)
        if array.shape != shape:
            raise ArgumentValueError("out", f"a batch whose {name} has shape {shape}", f"{array.shape}")
        if not array.flags.writeable:
            raise ArgumentValueError("out", f"a batch whose {name} can be written", "a read-only one")
    return out


def _rename(object_id: npt.NDArray[np.int32], worlds: list[Snapshot], world_of: npt.NDArray[np.uint32]) -> None:
    """Turn places in the core into ids, which differ once objects have been removed."""
    for i, world in enumerate(worlds):
        if world.ids is not None:
            own = world_of == i
            object_id[own] = world.ids_of(object_id[own])
