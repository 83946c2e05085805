"""One scan: fire the pulses of a frame at a scene, and keep what comes back beside the truth."""

from __future__ import annotations

import enum
import weakref
import zlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from lidarsim import _native, _validation
from lidarsim._validation import Floats, integer, real
from lidarsim.materials import Material
from lidarsim.pointcloud import PointCloud
from lidarsim.scene import Scene, SceneObject
from lidarsim.shapes import TriangleMesh
from lidarsim.trajectory import Trajectory

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from lidarsim.patterns import Pulses
    from lidarsim.sensor import Lidar

__all__ = ["Scan", "Status", "Summary", "scan"]


class Status(enum.IntEnum):
    """Why a pulse is or is not a point."""

    hit = 0
    miss = 1
    below_min_range = 2
    beyond_max_range = 3
    below_threshold = 4
    dropped = 5


class Summary(dict[str, int]):
    """Numbers of pulses by the name of their status; it prints as a table."""

    def __str__(self) -> str:
        """Return a line a status, with its share of all pulses."""
        total = sum(self.values())
        lines = [f"{name:16} {count:10,} {count / max(total, 1):7.1%}" for name, count in self.items()]
        return "\n".join([*lines, f"{'pulses':16} {total:10,}"])

    __repr__ = __str__


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A frame of a sensor: for each of n pulses, in firing order, up to k returns, and why there is none.

    k is the most returns that a pulse can have by the measurement, 1 unless more are asked for. Unused entries are
    nan, -1 for `object_id`, 0 for `label`. Of a pulse that hit something but is no point, the first entry still has
    the truth: of its strongest echo.

    Attributes
    ----------
    range : ndarray of float64, shape (n, k)
        Measured distance from the beam's origin along the pulse, m; nan where there is no return.
    true_range : ndarray of float64, shape (n, k)
        Distance along the direction that the pulse really took, m: the exact value to a relative 2.3e-16, for two
        roundings, of the ray parameter and of its product with the length of the direction.
    range_error : ndarray of float64, shape (n, k)
        Measured minus true range, m.
    intensity : ndarray of float32, shape (n, k)
        Received intensity; 1 is a white diffuser at normal incidence.
    object_id : ndarray of int32, shape (n, k)
        Object that was hit.
    label : ndarray of uint32, shape (n, k)
        Label of that object.
    normal : ndarray of float32, shape (n, k, 3)
        Unit outward normal there, in the world.
    incidence : ndarray of float32, shape (n, k)
        Angle between pulse and normal, 0 to π/2 rad.
    status : ndarray of uint8, shape (n,)
        A `Status` for each pulse.
    return_count : ndarray of uint8, shape (n,)
        Returns of each pulse.
    pulses : Pulses
        The pulses as the pattern gives them, in the sensor frame.
    lidar : Lidar
        The sensor.
    pose : ndarray of float64, shape (4, 4), or Trajectory
        Where the sensor was.
    time : float
        Start of the scan, s.
    frame : int
        Number of the frame.

    Notes
    -----
    With a beam that diverges, an echo's truth is that of the object which most of its power comes from, at the sub-ray
    nearest to the axis.
    """

    range: npt.NDArray[np.float64]
    true_range: npt.NDArray[np.float64]
    range_error: npt.NDArray[np.float64]
    intensity: npt.NDArray[np.float32]
    object_id: npt.NDArray[np.int32]
    label: npt.NDArray[np.uint32]
    normal: npt.NDArray[np.float32]
    incidence: npt.NDArray[np.float32]
    status: npt.NDArray[np.uint8]
    return_count: npt.NDArray[np.uint8]
    pulses: Pulses
    lidar: Lidar
    pose: Floats | Trajectory
    time: float
    frame: int

    def __len__(self) -> int:
        """Return the number of pulses."""
        return len(self.status)

    def point_cloud(self, frame: Literal["sensor", "world"] = "sensor", *, deskew: bool = False) -> PointCloud:
        """Return the returns as points, with all fields.

        Parameters
        ----------
        frame : {"sensor", "world"}
            Coordinates of points and normals. "sensor": as a driver gives them, each point in the frame that the
            sensor had when it fired the pulse, so that the cloud of a moving sensor is skewed. "world": through the
            pose at that time, so that it is not.
        deskew : bool
            Give the points of frame "sensor" in the one frame that the sensor had at the start of the scan, by the
            true poses.

        Returns
        -------
        PointCloud
            In firing order, the returns of a pulse one after the other. A point lies at the measured range from the
            beam's origin, in the direction that the pulse should have had, without angular jitter.

        Raises
        ------
        ValueError
            If `frame` is neither.
        """
        if frame not in {"sensor", "world"}:
            raise ValueError(f"frame: expected 'sensor' or 'world', got {frame!r}")
        coordinates = "start" if frame == "sensor" and deskew else frame
        return PointCloud(_native.points_of(self, _path(self.pose), coordinates))

    def range_image(self) -> npt.NDArray[np.float64]:
        """Return the ranges as an image.

        Returns
        -------
        ndarray of float64, shape (rings, columns)
            Range of the first entry of each pulse, m; nan where there is no return, or no pulse.
        """
        image = np.full(self.lidar.pattern.shape, np.nan)
        image[self.pulses.ring, self.pulses.column] = self.range[:, 0]
        return image

    def summary(self) -> Summary:
        """Return the numbers of pulses by status, which print as a table.

        Returns
        -------
        Summary
            A mapping from the name of each `Status` to a number.
        """
        counts = np.bincount(self.status, minlength=len(Status))
        return Summary({status.name: int(counts[status]) for status in Status})


def scan(
    lidar: Lidar,
    scene: Scene,
    pose: RigidTransform | npt.ArrayLike | Trajectory | None = None,
    *,
    time: float = 0.0,
    frame: int = 0,
    seed: int = 0,
    indices: npt.ArrayLike | None = None,
) -> Scan:
    """Fire the pulses of a frame at a scene and measure what comes back.

    Parameters
    ----------
    lidar : Lidar
        The sensor.
    scene : Scene
        What it looks at.
    pose : RigidTransform, array_like of shape (4, 4), or Trajectory, optional
        Sensor to world; default the identity. With a trajectory each pulse is fired from the pose at its own time.
    time : float
        When the frame starts, s: the pulse fired at t in the frame is fired at `time` + t on the trajectory.
    frame : int
        Number of the frame, 0 to 2³² − 1.
    seed : int
        Seed of all noise, 0 to 2⁶⁴ − 1. The same seed, sensor name and frame give the same bits.
    indices : array_like of int, shape (m,), optional
        Fire these pulses of the frame only, in this order. Their noise is the same as in the whole frame.

    Returns
    -------
    Scan
        One entry a pulse.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong type or out of its range, if the trajectory does not cover all pulses, or if a
        pulse of the pattern is not finite or its direction not of unit length.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, got {scene!r}")
    time = real("time", time)
    frame = integer("frame", frame, at_least=0, at_most=2**32 - 1)
    seed = integer("seed", seed, at_least=0, at_most=2**64 - 1)
    where = _where(pose)
    pulses = lidar.pattern.pulses(frame)
    chosen = None if indices is None else _indices(indices, len(pulses))
    if chosen is not None:
        pulses = replace(
            pulses,
            **{name: getattr(pulses, name)[chosen] for name in ("directions", "origins", "time", "ring", "column")},
        )
    arrays = _native.scan(
        scene.native,
        _appearances(scene),
        _path(where),
        pulses,
        chosen,
        lidar.measurement,
        (lidar.min_range, lidar.max_range),
        time,
        (seed, zlib.crc32(lidar.name.encode()), frame),
    )
    return Scan(**arrays, pulses=pulses, lidar=lidar, pose=where, time=time, frame=frame)


def _where(pose: RigidTransform | npt.ArrayLike | Trajectory | None) -> Floats | Trajectory:
    if isinstance(pose, Trajectory):
        return pose
    return np.eye(4) if pose is None else _validation.pose("pose", pose)


def _path(pose: Floats | Trajectory) -> _native.Path:
    return pose._native if isinstance(pose, Trajectory) else _native.Path.still(pose.tolist())


def _indices(value: npt.ArrayLike, pulses: int) -> npt.NDArray[np.uint64]:
    given = np.asarray(value)
    if given.ndim != 1 or (given.dtype.kind not in "iu" and given.size):
        raise ValueError(f"indices: expected integers of shape (m,), got {given.dtype} of shape {given.shape}")
    outside = (given < 0) | (given >= pulses)
    if outside.any():
        i = int(np.argmax(outside))
        raise ValueError(f"indices: expected 0 to {pulses - 1}, got indices[{i}] = {given[i]}")
    return given.astype(np.uint64)


_known_appearances: weakref.WeakKeyDictionary[Scene, tuple[int, _native.Appearances]] = weakref.WeakKeyDictionary()


def _appearances(scene: Scene) -> _native.Appearances:
    """Return labels and reflectivities of the objects, kept until an object is added."""
    count, appearances = _known_appearances.get(scene, (-1, None))
    if appearances is None or count != len(scene):
        objects = scene.objects
        appearances = _native.Appearances([_appearance(i, thing) for i, thing in enumerate(objects)])
        _known_appearances[scene] = len(objects), appearances
    return appearances


def _appearance(index: int, thing: SceneObject) -> tuple[int, str, Floats]:
    material: Material = thing.material
    values = np.atleast_1d(np.asarray(material.reflectivity, dtype=np.float64))
    if material.per != "object":
        per = material.per
        which = f"object {index} ({thing.name!r})" if thing.name else f"object {index}"
        if not isinstance(thing.shape, TriangleMesh):
            raise ValueError(
                f"{which}: expected a TriangleMesh for a reflectivity per {per}, got {type(thing.shape).__name__}"
            )
        wanted = len(thing.shape.faces) if material.per == "face" else len(thing.shape.vertices)
        if len(values) != wanted:
            raise ValueError(f"{which}: expected {wanted} reflectivities, one a {per}, got {len(values)}")
    return thing.label, material.per, values
