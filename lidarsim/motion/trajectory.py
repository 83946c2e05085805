"""Trajectories: poses over time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base import validation
from lidarsim._base.files import PathLike, atomic_writer
from lidarsim._base.names import explain_arguments
from lidarsim._base.pickling import Immutable
from lidarsim._base.validation import Floats, Transform, angles, array, ask_above
from lidarsim._base.vectors import gauss_markov, product, sigmas_of_axes, transforms
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.motion import strips
from lidarsim.motion._rotation_spline import NoSplineError, angular_accelerations, rotation_steps
from lidarsim.motion.formats import read_poses, writer_of

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

INTERPOLATIONS = ("linear", "spline")

LARGEST = 2.0**980
"""Maximum of coordinates and velocities; up to it, nothing overflows in the core."""

FASTEST_TURN = 30.0
"""Angular velocity, rad/s, beyond which the unit is probably another one; gyroscopes saturate at 35 rad/s."""

LARGEST_TILT = math.pi / 8
"""Maximum of errors of orientation, rad; those of mounts and navigation systems are far below it."""

BOTH = "times, poses"
"""Argument that errors name if times and poses do not go together."""

CAMERA_TO_BODY = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From the axes of a camera (x to the right, y down, z ahead) to those of a body (x ahead, y to the left, z up)."""


class Trajectory(Immutable):
    """Rigid pose of a sensor or an object over time.

    The trajectory passes exactly through each given pose. Between two poses, with u = (t − tᵢ)/(tᵢ₊₁ − tᵢ) from 0 to 1,
    the position is pᵢ + s(u) and the orientation Rᵢ exp(φ(u)), where s and φ are polynomials in u without constant
    term. With "linear" interpolation both are linear: the position moves at constant velocity, and the orientation
    turns at a constant rate about a fixed axis (slerp). With "spline" both are cubic, and linear and angular velocity
    and acceleration are continuous.

    For a scan, the trajectory must cover the frame up to its end, 1/rate after its start. A firing cycle that is then
    incomplete is completed at the final velocities of the trajectory.

    Parameters
    ----------
    times : array_like, shape (n,)
        Strictly increasing times, s; at least one.
    poses : RigidTransform of n, or array_like, shape (n, 4, 4)
        Pose at each time: rigid transform from the moving frame to the world, positions in m.
    interpolation : {"linear", "spline"}
        Interpolation between the given poses.

    Raises
    ------
    TypeError, ValueError
        If the times do not increase, a pose is not rigid to within 1e-6, the numbers of times and poses differ, there
        is no such interpolation, or no spline is found. This can happen if rotations are large and one step lasts
        hundreds of times as long as the next.

    Notes
    -----
    Splines are those of `scipy.interpolate.CubicSpline` (with its default, not-a-knot end conditions) for the position
    and of `scipy.spatial.transform.RotationSpline` for the orientation (N. Mayorov, Smooth Attitude Interpolation,
    2019), which begins and ends at the mean angular velocity of the first and the last step. The equations of the
    latter are solved to rounding, whereas SciPy stops after ten iterations.

    ``trajectory @ mount`` is the trajectory of a sensor mounted on the body that follows `trajectory`; `mount`, a 4×4
    array or a RigidTransform, is the sensor's pose on the body (extrinsics), sensor to body. It also holds between the
    given poses: a sensor away from the centre of a turning body moves on an arc. ``T @ trajectory`` is the same motion
    seen from another world; `T`, also a 4×4 array or a RigidTransform, is rigid, from the old world to the new.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> there = np.eye(4)
    >>> there[:3, 3] = (10, 0, 0)
    >>> trajectory = ls.Trajectory([0.0, 1.0], [np.eye(4), there])
    >>> trajectory.at(0.25).translation
    array([2.5, 0. , 0. ])
    >>> roof = np.eye(4)
    >>> roof[:3, 3] = (0, 0, 2)
    >>> (trajectory @ roof).at(0.25).translation
    array([2.5, 0. , 2. ])
    """

    @explain_arguments
    def __init__(
        self,
        times: npt.ArrayLike,
        poses: RigidTransform | npt.ArrayLike,
        *,
        interpolation: Literal["linear", "spline"] = "linear",
    ) -> None:
        rising = np.array(array("times", times, ("n",)))
        if not len(rising):
            raise ArgumentValueError("times", "at least one", "none")
        late = rising[1:] <= rising[:-1]
        if late.any():
            i = int(np.argmax(late)) + 1
            raise ArgumentValueError("times", "rising times", f"times[{i}] = {rising[i]} after {rising[i - 1]}")
        given: Any = poses.as_matrix() if hasattr(poses, "as_matrix") else poses
        try:
            shape = np.shape(given)
        except ValueError:  # a ragged sequence
            shape = ()
        if len(shape) != 3 or shape[0] != len(rising):
            got = shape or "a ragged sequence"
            hint = "positions are poses[:, :3, 3]" if shape[-1:] == (3,) else ""
            raise ArgumentValueError("poses", f"shape ({len(rising)}, 4, 4), one per time", got, hint)
        matrices = validation.poses("poses", given).copy()
        validation.one_of("interpolation", interpolation, INTERPOLATIONS)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            steps = _spline_steps(rising, matrices) if interpolation == "spline" else _linear_steps(matrices)
            # A velocity is at most three times the sum of the coefficients over the duration of the step.
            velocities = np.abs(steps).sum(axis=2) / np.diff(rising)[:, None, None]
            largest = np.max([np.abs(part).max(initial=0.0) for part in (matrices[:, :3, 3], steps, velocities)])
            length = rising[-1] - rising[0]
        if not (largest <= LARGEST and np.isfinite(length)):
            expected = "times, positions and velocities within the range of float64"
            raise ArgumentValueError(BOTH, expected, "others")
        rising.setflags(write=False)
        self._times = rising
        self._recipe: _Recipe = "knots", (rising, matrices.reshape(-1, 16), steps.reshape(-1, 18)), ()
        self._native = _build(self._recipe)

    @classmethod
    def from_twist(
        cls,
        pose: Transform,
        linear: npt.ArrayLike = (0.0, 0.0, 0.0),
        angular: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> Trajectory:
        """Return an unbounded trajectory of constant velocity and angular velocity.

        Parameters
        ----------
        pose : RigidTransform or array_like, shape (4, 4)
            Pose at time 0.
        linear : array_like, shape (3,)
            Velocity in the moving frame, m/s: (10, 0, 0) is 10 m/s ahead.
        angular : array_like, shape (3,)
            Angular velocity in the moving frame, rad/s: (0, 0, 0.5) turns to the left.

        Returns
        -------
        Trajectory
            pose·exp(t·twist), with the exponential map of SE(3) (T. D. Barfoot, State Estimation for Robotics, 2017,
            ch. 7): a circle or a screw if both velocities are non-zero.

        Raises
        ------
        TypeError, ValueError
            If the pose is not rigid, or a position or velocity is not finite or beyond 2⁹⁸⁰.

        Notes
        -----
        Orientations are accurate to 10⁻¹⁰ rad at any time: from an angle |angular|·t of 10⁶ rad on, it is computed
        exactly and then reduced to one turn.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> circle = ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0), angular=(0, 0, 0.5))
        >>> circle.at(np.pi).translation.round(9)
        array([2., 2., 0.])
        """
        start = validation.pose("pose", pose)
        velocities = array("linear", linear, (3,)), array("angular", angular, (3,))
        for name, values in ("pose", start[:3, 3]), ("linear", velocities[0]), ("angular", velocities[1]):
            _in_range(name, values)
        ask_above("angular", velocities[1], FASTEST_TURN, "rad/s", "degrees per second?")
        arguments = start.tolist(), *(velocity.tolist() for velocity in velocities)
        return cls._make(np.zeros(1), ("twist", arguments, ()))

    @classmethod
    def load(
        cls,
        path: PathLike,
        *,
        times: PathLike | npt.ArrayLike | None = None,
        interpolation: Literal["linear", "spline"] = "linear",
        axes: Literal["body", "camera"] = "body",
        scene: str | None = None,
        start: float | None = None,
    ) -> Trajectory:
        """Read a file of poses, whose format is determined by its content, or for nuScenes by its name.

        - TUM: ``t x y z qx qy qz qw`` per line, in s and m.
        - KITTI poses: the upper three rows of a 4×4 matrix per line, 12 numbers.
        - CSV with a header line that includes the columns ``time_s,x_m,y_m,z_m,qx,qy,qz,qw`` in any order.
        - nuScenes: ``ego_pose.json``, with ``scene.json``, ``sample.json`` and ``sample_data.json`` beside it. The
          poses are those of the ego vehicle for all sample data of a `scene`, and time 0 is the first of them.

        Empty lines and lines that begin with ``#`` are skipped. Quaternions must have unit length and matrices must be
        orthonormal, to two decimals; they are then normalised to rounding.

        Parameters
        ----------
        path : path-like
            The file.
        times : path-like or array_like, shape (n,), optional
            Times of KITTI poses, which have none of their own, s: an array, or a file with one number per line.
        interpolation : {"linear", "spline"}
            Interpolation between the given poses.
        axes : {"body", "camera"}
            Axes of the world and of the moving frame in the file. "body": x ahead, y to the left, z up, as everywhere
            in lidarsim. "camera": x to the right, y down, z ahead, as in the poses of the KITTI data set and of visual
            odometry; both frames are turned to the axes of "body".
        scene : str, optional
            Name of a scene of nuScenes, such as "scene-0061"; by default the only one in the tables.
        start : float, optional
            Time of the first pose, s: all times are shifted alike. By default, times are those of the file. Frames of a
            run start at 0, whereas TUM files often have Unix times.

        Returns
        -------
        Trajectory
            Trajectory through the poses of the file. Poses of the KITTI data set are those of the left camera: with
            ``axes="camera"``, ``trajectory @ CAMERA_TO_BODY @ Tr`` is the trajectory of the lidar, where ``Tr`` is the
            matrix of its calibration and ``CAMERA_TO_BODY`` is ``[[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0,
            1]]``.

        Raises
        ------
        FileFormatError
            If a file cannot be read or has none of these formats; the message names the line. If there is no such
            scene, or its poses are incomplete.
        TypeError, ValueError
            If `times` are missing, superfluous, or not as many as the poses, or if `scene` is given for another format.
        """
        validation.one_of("axes", axes, ("body", "camera"))
        if scene is not None and not isinstance(scene, str):
            raise ArgumentTypeError("scene", "the name of a scene", validation.short_repr(scene))
        first = None if start is None else validation.real("start", start)
        stamps, poses = read_poses(path, times, scene)
        if axes == "camera":
            poses = CAMERA_TO_BODY @ poses @ CAMERA_TO_BODY.T  # exact: coordinates change only place and sign
        if first is not None and len(stamps):
            stamps = stamps - stamps[0] + first
        try:
            return cls(stamps, poses, interpolation=interpolation)
        except ArgumentValueError as error:
            if error.argument != BOTH:  # one of this call, not what the file says
                raise
            raise FileFormatError(f"{path}: {error.problem}") from error

    @classmethod
    def strips(
        cls,
        area: npt.ArrayLike,
        *,
        height: float,
        speed: float,
        overlap: float,
        field_of_view: float,
        heading: float = 0.0,
        turn: float = 60.0,
        ground: float = 0.0,
        margin: float = 0.0,
    ) -> list[Trajectory]:
        """Return the parallel strips of an airborne survey that cover an area.

        On level ground a sensor sees a swath of 2·height·tan(field_of_view / 2). The lines of flight are
        swath·(1 − overlap) apart. There are as many as cover the area, so that the outer ones reach equally far beyond
        it. Each strip is as long as the part of the area in its swath, and the strips follow each other from right to
        left, to and fro.

        Parameters
        ----------
        area : array_like, shape (4,) or (n, 2)
            x_min, y_min, x_max, y_max of a rectangle, or the corners of a polygon in order, m.
        height : float
            Height of the flight above the ground, m.
        speed : float
            Speed, m/s.
        overlap : float
            Share of the swath that adjacent strips have in common, from 0 to less than 1. On hills it is less, since
            swaths are narrower where the ground is higher.
        field_of_view : float
            Angle that the sensor sees across the line of flight, symmetric to the nadir, rad, less than π.
        heading : float
            Direction of the first strip, counter-clockwise from the x axis, rad: π/2 is along y, north in UTM. Every
            second strip goes the other way.
        turn : float
            Time from the end of a strip to the start of the next, s. The turns are not part of the trajectories.
        ground : float
            Height of the ground, the z coordinate above which `height` counts, m.
        margin : float
            Distance for which each strip is flown beyond the area at both ends, m.

        Returns
        -------
        list of Trajectory
            One for each strip, of constant velocity, with spans one after the other; the first starts at 0. The poses
            are those of a body with x ahead, y to the left and z up: ``strip @ mount`` is the trajectory of a sensor.
            An airborne preset, which looks along its own x axis, is pitched by 90° to look down.

        Raises
        ------
        TypeError, ValueError
            If an argument is out of its range, the area has no length or needs more than 10,000 strips.

        Examples
        --------
        >>> from math import radians
        >>> import lidarsim as ls
        >>> strips = ls.Trajectory.strips(
        ...     (0, 0, 1000, 900), height=500, speed=50, overlap=0.3, field_of_view=radians(45)
        ... )
        >>> [strip.span for strip in strips]
        [(0.0, 20.0), (80.0, 100.0), (160.0, 180.0)]
        """
        return [
            cls(times, poses)
            for times, poses in strips.legs(
                area,
                height=height,
                speed=speed,
                overlap=overlap,
                field_of_view=field_of_view,
                heading=heading,
                turn=turn,
                ground=ground,
                margin=margin,
            )
        ]

    def save(self, path: PathLike) -> None:
        """Write the given poses to a file; its suffix determines the format.

        ``.tum`` and ``.txt`` are TUM, ``.csv`` is CSV and ``.kitti`` KITTI poses, which omit the times; `load` reads
        all of them. Numbers are written at full precision. The interpolation is not stored: a spline must be loaded
        with ``interpolation="spline"``, and poses of a mounted sensor are interpolated directly, not through its body.

        Parameters
        ----------
        path : path-like
            The file, in a folder that exists.

        Raises
        ------
        FileFormatError
            If the suffix is unknown.
        ValueError
            If this is a constant twist, which its one pose does not describe.
        OSError
            If the file cannot be written.
        """
        write = writer_of(path)
        if self._recipe[0] == "twist":
            raise ArgumentValueError(
                "trajectory", "one of given poses", "a constant twist", "sample it before it is saved"
            )
        with atomic_writer(path) as file:
            write(self.times, self._native.at(self._times), file)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time at which there is a pose, s: tuple of float; -inf and inf for a constant twist.

        A twist has no poses where its positions would exceed the range of float64.
        """
        return (-math.inf, math.inf) if self._recipe[0] == "twist" else self._native.span()

    @property
    def times(self) -> Floats:
        """Times of the given poses, s: read-only ndarray of float64, shape (n,); only 0 for a constant twist."""
        return self._times

    @property
    def poses(self) -> RigidTransform:
        """The given poses, moving frame to world: RigidTransform of n; for a mounted sensor, the sensor's poses."""
        return self.at(self._times)

    def at(self, times: npt.ArrayLike) -> RigidTransform:
        """Return the poses at some times.

        Parameters
        ----------
        times : array_like, shape () or (n,)
            Times within the span, s.

        Returns
        -------
        RigidTransform
            Moving frame to world: one pose, or n of them.

        Raises
        ------
        TypeError, ValueError
            If `times` are not numbers of either shape, or there is no pose at one of them.
        """
        from scipy.spatial.transform import RigidTransform

        when = self._within(times)
        matrices = self._native.at(np.atleast_1d(when))
        return RigidTransform.from_matrix(matrices if when.ndim else matrices[0])

    def velocity(self, times: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return the velocities at some times.

        Parameters
        ----------
        times : array_like, shape () or (n,)
            Times within the span, s.

        Returns
        -------
        linear : ndarray of float64, shape (3,) or (n, 3)
            Velocity of the origin of the moving frame, in the world, m/s.
        angular : ndarray of float64, shape (3,) or (n, 3)
            Angular velocity in the moving frame, rad/s. Linear interpolation has jumps at the given poses: both
            velocities are those after the pose, or before it at the last pose.

        Raises
        ------
        TypeError, ValueError
            If `times` are not numbers of either shape, or there is no pose at one of them.

        Notes
        -----
        The velocities are the derivatives of the formulas of the class. For a rotation vector φ with derivative φ̇, the
        angular velocity is (I − b[φ] + c[φ]²)φ̇, b = (1 − cos θ)/θ², c = (θ − sin θ)/θ³, θ = |φ| (T. D. Barfoot, State
        Estimation for Robotics, 2017, ch. 7). A sensor mounted at m on a body with orientation R has the body's
        velocity plus R(ω × m).

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> circle = ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0), angular=(0, 0, 0.5))
        >>> linear, angular = circle.velocity(np.pi)
        >>> linear.round(9)
        array([0., 1., 0.])
        >>> angular
        array([0. , 0. , 0.5])
        """
        when = self._within(times)
        velocities = self._native.velocity(np.atleast_1d(when))
        linear, angular = (np.ascontiguousarray(velocities[:, i]) for i in (0, 1))
        return (linear, angular) if when.ndim else (linear[0], angular[0])

    def acceleration(self, times: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return the accelerations at some times.

        Parameters
        ----------
        times : array_like, shape () or (n,)
            Times within the span, s.

        Returns
        -------
        linear : ndarray of float64, shape (3,) or (n, 3)
            Acceleration of the origin of the moving frame, in the world, m/s².
        angular : ndarray of float64, shape (3,) or (n, 3)
            Angular acceleration in the moving frame, rad/s².

        Raises
        ------
        TypeError, ValueError
            If `times` are not numbers of either shape, or there is no pose at one of them. If the velocity jumps at the
            given poses, as with linear interpolation, or an acceleration is beyond the range of float64.

        Notes
        -----
        The accelerations are the derivatives of the formulas of the class. With the notation of `velocity`, the
        angular acceleration is J(φ)φ̈ + J̇φ̇, J = I − b[φ] + c[φ]². A sensor mounted at m on a body with orientation R,
        angular velocity ω and angular acceleration α has the body's acceleration plus R(α × m + ω × (ω × m)).

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> circle = ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0), angular=(0, 0, 0.5))
        >>> circle.acceleration(0.0)[0]
        array([0. , 0.5, 0. ])
        """
        when = self._within(times)
        kind, arguments, mounts = self._recipe
        body = _build((kind, arguments, ()))
        flat = np.atleast_1d(when)
        rotations, rates = body.at(flat)[:, :3, :3], body.velocity(flat)[:, 1]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if kind == "twist":
                _, ahead, turn = map(np.array, arguments)
                linear, angular = product(rotations, np.cross(turn, ahead)[:, None])[..., 0], np.zeros_like(rates)
            else:
                linear, angular = _knot_accelerations(arguments[0], arguments[2].reshape(-1, 2, 3, 3), flat)
            mount = np.eye(4)
            for further in mounts:
                mount = product(mount, np.array(further))
            arm = mount[:3, 3]
            turning = np.cross(angular, arm) + np.cross(rates, np.cross(rates, arm))
            linear = linear + product(rotations, turning[..., None])[..., 0]
            angular = product(mount[:3, :3].T, angular[..., None])[..., 0]
        if not (np.isfinite(linear).all() and np.isfinite(angular).all()):
            raise ArgumentValueError("trajectory", "accelerations within the range of float64", "ones beyond it")
        return (linear, angular) if when.ndim else (linear[0], angular[0])

    def _within(self, times: npt.ArrayLike) -> Floats:
        """Return `times`, of shape () or (n,), after checking that there is a pose at each."""
        when = validation.one_or_each("times", times, "n")
        flat = np.atleast_1d(when)
        first, last = self._native.span()
        outside = (flat < first) | (flat > last)
        if outside.any():
            i = int(np.argmax(outside))
            which = f"times[{i}]" if when.ndim else "times"
            raise ArgumentValueError("times", f"times from {first} to {last} s", f"{which} = {flat[i]}")
        return when

    __array_ufunc__ = None  # an array on the left leaves the product to `__rmatmul__`

    def __matmul__(self, mount: Transform) -> Trajectory:
        """Return the trajectory of a sensor mounted on the body of this trajectory; `mount` is sensor to body."""
        if isinstance(mount, Trajectory):
            raise ArgumentTypeError("mount", "a pose", "a Trajectory")
        matrix = _in_range("mount", validation.pose("mount", mount)).tolist()
        kind, arguments, mounts = self._recipe
        return self._make(self._times, (kind, arguments, (*mounts, matrix)), self._native.mounted(matrix))

    def __rmatmul__(self, world: Transform) -> Trajectory:
        """Return the same motion in another world; `world` maps the present world to the new one."""
        matrix = _in_range("world", validation.pose("world", world))
        kind, arguments, mounts = self._recipe
        if kind == "twist":
            start, *velocities = arguments
            moved = product(matrix, np.array(start))
            arguments = _in_range("world", moved).tolist(), *velocities
        else:
            times, poses, steps = arguments
            # A step adds s(u) to the position, which turns with the world, and exp(φ(u)) on the right, which does not.
            turned = steps.reshape(-1, 2, 3, 3).copy()
            turned[:, 0] = product(matrix[:3, :3], turned[:, 0, :, :, None])[..., 0]
            moved = product(matrix, poses.reshape(-1, 4, 4))
            arguments = times, _in_range("world", moved).reshape(-1, 16), _in_range("world", turned).reshape(-1, 18)
        return self._make(self._times, (kind, arguments, mounts))

    def perturbed(
        self,
        *,
        position_sigma: npt.ArrayLike = 0.0,
        orientation_sigma: npt.ArrayLike = 0.0,
        correlation_time: float = math.inf,
        boresight: npt.ArrayLike = (0.0, 0.0, 0.0),
        lever_arm: npt.ArrayLike = (0.0, 0.0, 0.0),
        seed: int = 0,
    ) -> Trajectory:
        """Return the trajectory as a navigation system with errors reports it.

        ``scan.point_cloud("world", pose=trajectory.perturbed(…))`` places the points of a scan with it: strips of a
        flight that do not fit each other, with a known truth.

        Parameters
        ----------
        position_sigma : float or array_like, shape (3,)
            Standard deviation of the position, the same or for each axis of the world, m.
        orientation_sigma : float or array_like, shape (3,)
            Standard deviation of the orientation, a rotation vector in the axes of the moving frame: roll, pitch and
            yaw, rad, up to pi/8.
        correlation_time : float
            Time after which the correlation of these errors has fallen to 1/e, s. Infinite: they are constant.
        boresight : array_like, shape (3,)
            Constant error of the sensor's orientation on the body: roll, pitch and yaw about the fixed axes x, y and z
            in this order, rad, up to pi/8 each.
        lever_arm : array_like, shape (3,)
            Constant error of the sensor's position, in the axes of the moving frame, m.
        seed : int
            Seed of the errors, 0 to 2⁶⁴ − 1.

        Returns
        -------
        Trajectory
            ``error @ self @ mount``, with the same span. With a finite correlation time, the errors are those of each
            pose and of enough poses between, a tenth of the correlation time apart at most, and are interpolated as
            the trajectory is; those of a mounted sensor with the body that carries it.

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type or shape, is negative or not finite, or the correlation time would need
            more than ten million poses.

        Notes
        -----
        The errors are first-order Gauss-Markov processes, stationary from the start: e(t + Δ) = ρ e(t) + σ √(1 − ρ²) g,
        with ρ = exp(−Δ/τ) and g standard normal (A. Gelb, Applied Optimal Estimation, 1974, section 3.8).

        The moving frame of ``body @ mount`` is that of the sensor: a scanner that is pitched to look down rolls about
        the nadir. ``body.perturbed(…) @ mount`` has roll, pitch and yaw of the body.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> flight = ls.Trajectory.from_twist(np.eye(4), linear=(60, 0, 0))
        >>> flight.perturbed(lever_arm=(0, 0, 0.1)).at(1.0).translation
        array([60. ,  0. ,  0.1])
        """
        from scipy.spatial.transform import Rotation

        position, orientation = (
            sigmas_of_axes(name, given)
            for name, given in (("position_sigma", position_sigma), ("orientation_sigma", orientation_sigma))
        )
        scale = validation.real("correlation_time", correlation_time, above=0.0, infinite=True)
        angles("orientation_sigma", orientation, at_most=LARGEST_TILT)
        turn = angles("boresight", array("boresight", boresight, (3,)), at_most=LARGEST_TILT)
        arm = array("lever_arm", lever_arm, (3,))
        seed = validation.integer("seed", seed, at_least=0, at_most=2**64 - 1)
        mount = transforms(Rotation.from_euler("xyz", turn).as_matrix(), arm)
        sigmas = np.concatenate([position, orientation])
        if not sigmas.any():
            return self @ mount
        if math.isinf(scale):
            error = sigmas * gauss_markov(np.zeros(1), scale, seed)[0]
            turned = transforms(Rotation.from_rotvec(error[3:]).as_matrix(), 0.0)
            return transforms(np.eye(3), error[:3]) @ self @ turned @ mount
        kind, arguments, mounts = self._recipe
        if kind == "twist":
            hint = "give it poses at times"
            raise ArgumentValueError("correlation_time", "inf, as the trajectory has no end", scale, hint)
        is_spline = bool(arguments[2].reshape(-1, 2, 3, 3)[:, :, 1:].any())
        times = _refine(self._times, 0.1 * scale)
        errors = sigmas * gauss_markov(times, scale, seed)
        # Between its poses, it is the body that moves as interpolated. It turns about the sensor that it carries.
        poses, carried = _build((kind, arguments, ())).at(times), _build(("still", (np.eye(4).tolist(),), mounts))
        sensor: Floats = carried.at(np.zeros(1))[0]
        turns = product(sensor[:3, :3], product(Rotation.from_rotvec(errors[:, 3:]).as_matrix(), sensor[:3, :3].T))
        shifts = sensor[:3, 3:] - product(turns, sensor[:3, 3:])
        poses[:, :3, 3] += errors[:, :3] + product(poses[:, :3, :3], shifts)[..., 0]
        poses[:, :3, :3] = product(poses[:, :3, :3], turns)
        return Trajectory(times, poses, interpolation="spline" if is_spline else "linear") @ sensor @ mount

    @classmethod
    def _make(cls, times: Floats, recipe: _Recipe, native: _native.Path | None = None) -> Self:
        trajectory = cls.__new__(cls)
        times.setflags(write=False)
        trajectory._times, trajectory._recipe = times, recipe
        trajectory._native = _build(recipe) if native is None else native
        return trajectory

    @classmethod
    def _through(cls, times: Floats, poses: Floats) -> list[Self]:
        """Return linear trajectories through rigid poses, of shape (m, n, 4, 4), at the same rising times."""
        knots = zip(poses.reshape(len(poses), -1, 16), _linear_steps(poses), strict=True)
        return [cls._make(times, ("knots", (times, own, steps.reshape(-1, 18)), ())) for own, steps in knots]

    def _contents(self) -> dict[str, Any]:
        return {"times": self._times, "recipe": self._recipe}

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        return cls._make(**contents)

    def __repr__(self) -> str:
        """Return the class and the span."""
        return "Trajectory({:.12g} to {:.12g} s)".format(*self.span)


_Recipe = tuple[str, tuple[Any, ...], tuple[Any, ...]]
"""Constructor of a path in the core, its arguments, and the mounts on it."""


def _build(recipe: _Recipe) -> _native.Path:
    kind, arguments, mounts = recipe
    path: _native.Path = getattr(_native.Path, kind)(*arguments)
    for mount in mounts:
        path = path.mounted(mount)
    return path


def sensor_pose(pose: Floats | Trajectory, mount: Floats) -> Floats | Trajectory:
    """Return the pose, sensor to world, of a sensor that is mounted on a static or moving body.

    It has the same bits on every processor, unlike a matrix product in NumPy.
    """
    if isinstance(pose, Trajectory):
        return pose @ mount
    still: Floats = _native.Path.still(pose.tolist()).mounted(mount.tolist()).at(np.zeros(1))[0]
    if not np.isfinite(still).all():
        raise ArgumentValueError("mount, pose", "positions within the range of float64", "a sum beyond it")
    return still


MOST_POSES = 10_000_000
"""Most poses of a perturbed trajectory: 1.3 GB."""


def _refine(times: Floats, step: float) -> Floats:
    """Insert equally spaced times so that no step exceeds `step`."""
    lengths = np.diff(times)
    with np.errstate(over="ignore"):
        counts = np.ceil(lengths / step)
    if not counts.sum() < MOST_POSES:
        expected = f"a time that needs at most {MOST_POSES:,} poses"
        raise ArgumentValueError("correlation_time", expected, f"{10.0 * step:g} s, which needs {counts.sum():.3g}")
    parts = np.maximum(counts, 1).astype(np.intp)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    fine = np.repeat(times[:-1], parts) + np.repeat(lengths / parts, parts) * within
    return np.append(fine, times[-1])


def _in_range(name: str, values: Floats) -> Floats:
    """Return `values`, coordinates or velocities, after checking that none is beyond `LARGEST`."""
    if not np.abs(values).max(initial=0.0) <= LARGEST:
        raise ArgumentValueError(name, f"numbers up to {LARGEST:.3g} of what moves", f"{np.abs(values).max():.3g}")
    return values


def _turns(matrices: Floats) -> Floats:
    """Return the rotation vector from each pose, of shape (…, n, 4, 4), to the next, in the frame of the former."""
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_matrix(matrices[..., :3, :3].reshape(-1, 3, 3))
    before = np.arange(len(rotations)).reshape(matrices.shape[:-2])[..., :-1]
    turns: Floats = (rotations[before.ravel()].inv() * rotations[before.ravel() + 1]).as_rotvec()
    return turns.reshape(*before.shape, 3)


def _linear_steps(matrices: Floats) -> Floats:
    """Return, per step, the coefficients of u, u² and u³ of translation and rotation vector: (…, n - 1, 2, 3, 3)."""
    turns = _turns(matrices)
    steps = np.zeros((*turns.shape[:-1], 2, 3, 3))
    steps[..., 0, 0, :] = np.diff(matrices[..., :3, 3], axis=-2)
    steps[..., 1, 0, :] = turns
    return steps


def _spline_steps(times: Floats, matrices: Floats) -> Floats:
    """Return the coefficients of splines, in the form of `_linear_steps`."""
    from scipy.interpolate import CubicSpline

    if len(times) < 3:
        return _linear_steps(matrices)  # a spline through two poses is linear
    # Scaling the times by a power of two keeps the bits of the coefficients, and squares do not overflow.
    scaled = np.ldexp(times, -math.frexp(times[-1] - times[0])[1])
    lengths = np.diff(scaled)
    steps = np.full((len(lengths), 2, 3, 3), np.nan)
    try:
        position = CubicSpline(scaled, matrices[:, :3, 3]).c  # terms in (t - t_i)³, (t - t_i)², …, 1
    except (ValueError, np.linalg.LinAlgError):  # raised on overflow
        return steps
    for power in (1, 2, 3):
        steps[:, 0, power - 1] = position[3 - power] * lengths[:, None] ** power
    try:
        steps[:, 1] = rotation_steps(lengths, _turns(matrices))
    except NoSplineError as error:
        raise ArgumentValueError(
            "poses",
            "orientations that a spline can join",
            f"ones whose spline was not found near times[{error.knot}] = {times[error.knot]}",
            "use more even times, smaller turns or interpolation='linear'",
        ) from None
    return steps


def _knot_accelerations(times: Floats, steps: Floats, when: Floats) -> tuple[Floats, Floats]:
    """Return the second derivatives of positions and the angular accelerations, shape (n, 3) each.

    `steps` are coefficients in the form of `_linear_steps`.
    """
    if not len(steps):
        return np.zeros((len(when), 3)), np.zeros((len(when), 3))
    lengths = np.diff(times)
    # Linear steps differ in velocity unless they are all at rest or equal; a spline has terms in u² or u³.
    velocities = steps[:, :, 0] / lengths[:, None, None]
    if not steps[:, :, 1:].any() and (velocities[1:] != velocities[:-1]).any():
        k = 1 + int(np.argmax((velocities[1:] != velocities[:-1]).any(axis=(1, 2))))
        raise ArgumentValueError(
            "trajectory",
            "one of continuous velocity",
            f"linear interpolation, whose velocity jumps at times[{k}] = {times[k]}",
            'make or load it with interpolation="spline"',
        )
    i = np.clip(np.searchsorted(times, when, side="right") - 1, 0, len(steps) - 1)
    h = lengths[i][:, None]
    u = (when - times[i])[:, None] / h
    (_, p2, p3), (r1, r2, r3) = np.moveaxis(steps[i], 0, 2)
    turns = ((r3 * u + r2) * u + r1) * u
    rates = ((3 * r3 * u + 2 * r2) * u + r1) / h
    bends = (6 * r3 * u + 2 * r2) / h / h
    return (6 * p3 * u + 2 * p2) / h / h, angular_accelerations(turns, rates, bends)
