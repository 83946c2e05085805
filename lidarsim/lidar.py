"""Lidar sensors: a scan pattern, a range gate and measurement errors, from a preset, a file or parts."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from lidarsim._base.files import PathLike, check_path, check_regular
from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Instances, Transform, check_options, frames, function, integer, items, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.scan import scan as _scan
from lidarsim.scan.batch import Poses, ScanBatch, scan_many
from lidarsim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from lidarsim.motion.trajectory import Trajectory
    from lidarsim.scan.scan import Scan
    from lidarsim.world.scene import Scene

HEAD = 1 << 16
"""Bytes at the start of a file that determine its kind."""

OWN = "lidarsim YAML"
"""Kind of lidarsim's own files: every YAML that is of no other kind."""

PRESETS = Path(__file__).parent / "presets"

_readers: dict[str, tuple[Callable[[Path, str], bool], Callable[..., Lidar]]] = {}


def register_lidar_reader(name: str, recognise: Callable[[Path, str], bool], read: Callable[..., Lidar]) -> None:
    """Let `Lidar.from_file` read one more kind of file; the kind registered last is tried first.

    Parameters
    ----------
    name : str
        Name of the kind of file in errors, such as "Ouster metadata JSON".
    recognise : callable
        ``recognise(path, text)`` returns whether a file is of this kind; `text` is its first 64 KiB, without a byte
        order mark and with invalid UTF-8 replaced.
    read : callable
        ``read(path, **options)`` returns the `Lidar`; its keyword arguments are the options that `from_file` takes.

    Raises
    ------
    TypeError
        If `recognise` or `read` is no such function.
    """
    function("recognise", recognise, "a path and a text", 2)
    function("read", read, "a path", 1)
    _readers[name] = recognise, read


@explain_arguments
@dataclass(frozen=True, init=False, repr=False, eq=False)  # else other names could be set, as max_rnge
class Lidar(Sensor):
    """A lidar sensor.

    Immutable; `dataclasses.replace` returns a changed copy.

    Parameters
    ----------
    pattern : Pattern
        Scan pattern: one of `lidarsim.patterns` or any object with `rate`, `shape` and `pulses`.
    measurement : Measurement
        Noise and other effects; all of them are off by default.
    min_range, max_range : float
        Range gate, m, both ends included. It applies to the range that the sensor reports. `false_returns` require a
        finite `max_range`.
    range_offset : float or sequence of float, one per ring
        Range that the sensor reports minus range from the beam's origin, m, for sensors with another zero of range.
        Quantisation and range gate apply to the reported range; `Scan.range` is measured from the beam's origin.
    name : str
        Name of the sensor. Sensors with different names draw different noise from the same seed.
    model : str
        Model of the sensor, such as "ouster-os1-128". Its vendor determines the point layout in bags. Default: the
        name.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or is out of its range.
    """

    @explain_arguments
    def scan(
        self,
        scene: Scene,
        pose: Transform | Trajectory | None = None,
        *,
        time: float = 0.0,
        frame: int = 0,
        seed: int = 0,
        ignore: Instances = (),
    ) -> Scan:
        """Scan a scene for one frame.

        Parameters
        ----------
        scene : Scene
            The scene to scan.
        pose : RigidTransform, array_like of shape (4, 4) or Trajectory, optional
            Sensor to world; with a trajectory, each pulse is fired from the pose at its time. Default: identity.
        time : float
            Start of the frame, s, on the clock of the trajectory and of moving objects.
        frame : int
            Number of the frame, 0 to 2³² − 1; non-repetitive patterns and noise differ between frames.
        seed : int
            Seed of the noise, 0 to 2⁶⁴ − 1. The same seed, frame and name of the sensor give the same bits.
        ignore : collection of int
            Instances that the sensor does not see, as if they were not in the scene: the body that carries it, for
            example, or a window that it looks through.

        Returns
        -------
        Scan
            One entry per pulse, in firing order, and return.

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type or shape or is out of its range, if the trajectory or the motion of an
            object does not cover all pulses, if a pulse of the pattern is not finite or its direction is not of unit
            length, or if no object is of an instance to ignore.
        MemoryError
            If there is no memory for the returns; raised before the pulses are made, with the number of bytes.
        """
        return _scan.scan(self, scene, pose, time=time, frame=frame, seed=seed, ignore=ignore)

    def frames(
        self,
        scene: Scene,
        pose: Transform | Trajectory | None,
        count: int,
        *,
        first: int = 0,
        seed: int = 0,
        ignore: Instances = (),
    ) -> Iterator[Scan]:
        """Scan a scene frame by frame; frame k starts at ``k / pattern.rate``, s.

        Pattern, noise and time advance together. Frames are scanned lazily: each sees the scene at the time of the
        request.

        Parameters
        ----------
        scene : Scene
            The scene to scan.
        pose : RigidTransform, array_like of shape (4, 4), Trajectory or None
            Sensor to world, as in `scan`; None is the identity.
        count : int
            Number of frames, >= 0.
        first : int
            Number of the first frame, >= 0.
        seed : int
            Seed of the noise.
        ignore : collection of int
            Instances that the sensor does not see, as in `scan`.

        Returns
        -------
        iterator of Scan
            One scan per frame.

        Raises
        ------
        TypeError, ValueError
            At once, if an argument has the wrong type or shape or is out of its range, if the trajectory does not cover
            the first and the last frame, or if no object is of an instance to ignore.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> wall = scene.add(ls.Plane((1, 0, 0), 10.0))
        >>> lidar = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0))
        >>> drive = ls.Trajectory.from_twist(np.eye(4), linear=(5, 0, 0))
        >>> [float(scan.range[0, 0]) for scan in lidar.frames(scene, drive, 3)]
        [10.0, 9.5, 9.0]
        """
        numbers = frames(first, count)
        seed = integer("seed", seed, at_least=0, at_most=2**64 - 1)
        unseen = items("ignore", ignore, "instance numbers")
        where = _scan.check_coverage(self, scene, pose, numbers, ignore=unseen)
        rate = self.pattern.rate
        return (self.scan(scene, where, time=k / rate, frame=k, seed=seed, ignore=unseen) for k in numbers)

    def scan_many(
        self,
        scene: Scene | Sequence[Scene],
        poses: Poses,
        *,
        time: npt.ArrayLike = 0.0,
        frame: npt.ArrayLike = 0,
        seed: npt.ArrayLike = 0,
        ignore: Instances | Collection[Instances] = (),
        fields: Collection[str] | None = None,
        out: ScanBatch | None = None,
    ) -> ScanBatch:
        """Fire one frame from each of N poses, in one call: the scans of many robots, or of many worlds.

        See `lidarsim.scan_many`, which also takes several sensors.

        Parameters
        ----------
        scene : Scene or sequence of N Scenes
            The scene, or one for each row. Copies (`copy.copy`) of a scene share its meshes.
        poses : array_like, shape (N, 4, 4), RigidTransform of N poses, or sequence of N Trajectories
            Sensor to world.
        time : float or array_like, shape (N,)
            Start of the frame, s.
        frame : int or array_like of int, shape (N,)
            Number of the frame.
        seed : int or array_like of int, shape (N,)
            Seed of the noise. An array holds the seed of each row. From one number, a seed is derived for each row, so
            that rows differ: ``np.random.SeedSequence(seed).generate_state(N, np.uint64)``.
        ignore : collection of int, or collection of N collections of int
            Instances that the sensor does not see: of all rows, or of each row.
        fields : collection of str, optional
            The arrays of the batch. Default: range, xyz, intensity, status, label and object_id.
        out : ScanBatch, optional
            A batch of as many rows and returns, and as many pulses or more, whose arrays are overwritten; `fields` is
            then its own.

        Returns
        -------
        ScanBatch
            Arrays of shape (N, n), or (N, n, k) for sensors of several returns.

        Raises
        ------
        TypeError, ValueError
            As for `scan`; the error names the row. Also if `out` does not fit.
        MemoryError
            If there is no memory for the arrays.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> wall = scene.add(ls.Plane((1, 0, 0), 10.0))
        >>> lidar = ls.Lidar(ls.patterns.Grid([-0.5, 0.0, 0.5], [0.0], rate=20.0))
        >>> poses = np.broadcast_to(np.eye(4), (1000, 4, 4)).copy()
        >>> poses[:, 0, 3] = np.linspace(0, 9, 1000)
        >>> batch = lidar.scan_many(scene, poses, fields=["range", "status"])
        >>> batch.range.shape, batch.range[-1].round(3)
        ((1000, 3), array([1.139, 1.   , 1.139]))
        >>> poses[:, 0, 3] -= 1
        >>> batch = lidar.scan_many(scene, poses, out=batch)
        """
        return scan_many(self, scene, poses, time=time, frame=frame, seed=seed, ignore=ignore, fields=fields, out=out)

    @staticmethod
    def presets() -> list[str]:
        """Return the names of the sensor presets.

        Returns
        -------
        list of str
            Names in alphabetical order.
        """
        return sorted(path.stem for path in PRESETS.glob("*.yaml"))

    @classmethod
    def preset(
        cls, name: str, *, mode: str | None = None, noise: str | None = None, rate: float | None = None
    ) -> Lidar:
        """Return the preset of a real sensor.

        Parameters
        ----------
        name : str
            One of `presets()`.
        mode : str, optional
            One of the sensor's modes, such as "1024x20" for an Ouster. Default: the mode that its file describes.
        noise : {"datasheet", "measured"}, optional
            "datasheet" enables the noise stated in the sensor's datasheet. "measured" replaces it by what captures of
            real units show, as far as that is known: noise, channel biases, beam, detection limits, response, lost
            pulses and least range. Most values are from one unit. Default: none.
        rate : float, optional
            Frames per second, Hz. A frame of a sensor that fires at a fixed rate then has more or fewer pulses.
            Default: that of the file or mode.

        Returns
        -------
        Lidar
            The sensor described in lidarsim/presets/NAME.yaml, which gives the source of each number;
            ``lidarsim sensors NAME`` prints them.

        Raises
        ------
        TypeError, ValueError
            If there is no such preset, mode or noise, or the pattern has no such rate.

        Examples
        --------
        >>> import lidarsim as ls
        >>> ls.Lidar.preset("livox-mid360", rate=20).pattern.shape
        (4, 2500)
        >>> ls.Lidar.preset("hesai-xt32", noise="datasheet").measurement.range_sigma
        0.005
        >>> ls.Lidar.preset("hesai-xt32", noise="measured").measurement.range_sigma
        0.0028
        """
        _, read = _readers[OWN]
        lidar = read(preset_path(name), mode=mode, noise=noise)
        if rate is None:
            return lidar
        try:
            return replace(lidar, pattern=replace(lidar.pattern, rate=rate))  # type: ignore[type-var]
        except ArgumentValueError as error:
            if error.argument == "rate":
                raise
            raise ArgumentValueError("rate", f"a rate that {name} can have", f"{rate}, with {error}") from None

    @classmethod
    def from_file(cls, path: PathLike, **options: Any) -> Lidar:
        """Return the sensor described by a file: lidarsim's own YAML or a vendor's file, recognised by its content.

        Parameters
        ----------
        path : path-like
            The file.
        **options
            Settings that are not in the file. lidarsim's YAML: `mode` and `noise`, as in `preset`. Ouster metadata
            JSON: `mode`, `noise`. Velodyne calibration YAML: `model` (a preset), `rate`, `noise`. Hesai angle
            correction CSV or DAT: `firing_times` (the other CSV), `rate`, `noise`. RoboSense angle CSV: `rate`,
            `noise`. Livox scan pattern CSV: `rate`, `pulse_rate`, `noise`.

        Returns
        -------
        Lidar
            The sensor.

        Raises
        ------
        FileFormatError
            If the file cannot be read, is of an unknown kind or incomplete, or describes a sensor that is not
            supported.
        TypeError
            If a file of this kind has no such option.
        """
        path = check_path(path)
        kind = kind_of(path)
        if kind is None:
            raise FileFormatError(f"{path}: expected a file of one of these kinds: {', '.join(sorted(_readers))}")
        _, read = _readers[kind]
        check_options(kind, read, options)
        lidar = read(path, **options)
        if not isinstance(lidar, Lidar):
            raise ArgumentTypeError(f"reader {kind!r}", "a Lidar", short_repr(lidar))
        return lidar


def kind_of(path: Path) -> str | None:
    """Return the name of the reader that recognises a file; None if none does.

    Raises
    ------
    FileFormatError
        If the file cannot be read.
    """
    try:
        check_regular(path)
        with path.open("rb") as file:
            text = file.read(HEAD).decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read the file: {error.strerror}") from None
    return next((kind for kind, (recognise, _) in reversed(_readers.items()) if recognise(path, text)), None)


def preset_path(name: str) -> Path:
    """Return the file of a preset.

    Raises
    ------
    TypeError, ValueError
        If there is no preset of that name.
    """
    if not isinstance(name, str):
        raise ArgumentTypeError("preset", "the name of a sensor", short_repr(name))
    known = Lidar.presets()
    if name not in known:
        bare = {preset.replace("-", ""): preset for preset in known}
        asked = "".join(filter(str.isalnum, name.lower()))
        near = [preset for text, preset in bare.items() if asked in text][:3] if asked else []
        near = near or [bare[text] for text in difflib.get_close_matches(asked, bare, n=3, cutoff=0.4)]
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(known)}"
        raise ArgumentValueError("preset", "the name of a sensor", repr(name), hint)
    return PRESETS / f"{name}.yaml"
