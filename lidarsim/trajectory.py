"""Poses over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim import _native, _validation
from lidarsim._validation import Floats, Transform, array

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

__all__ = ["Trajectory"]


class Trajectory:
    """Rigid poses over time: where a sensor, or an object, is at each moment.

    Between two given poses the position is linear in time, and the orientation turns at a constant rate about a fixed
    axis (Slerp). For a scan it has to last to the end of the frame, 1/rate after its start: a firing cycle that is then
    under way is completed at the velocities that the trajectory ends with.

    Parameters
    ----------
    times : array_like, shape (n,)
        Rising times, s.
    poses : RigidTransform of n, or array_like, shape (n, 4, 4)
        Pose at each time: rigid transform from the moving frame to the world.

    Raises
    ------
    TypeError, ValueError
        If times do not rise, a pose is not rigid, or their numbers differ.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> there = np.eye(4)
    >>> there[:3, 3] = (10, 0, 0)
    >>> trajectory = ls.Trajectory([0.0, 1.0], [np.eye(4), there])
    >>> trajectory.at(0.25).translation
    array([2.5, 0. , 0. ])
    """

    def __init__(self, times: npt.ArrayLike, poses: RigidTransform | npt.ArrayLike) -> None:
        rising = array("times", times, ("n",))
        if not len(rising):
            raise ValueError("times: expected at least one, got none")
        if (np.diff(rising) <= 0.0).any():
            i = int(np.argmax(np.diff(rising) <= 0.0)) + 1
            raise ValueError(f"times: expected rising times, got times[{i}] = {rising[i]} after {rising[i - 1]}")
        given: Any = poses.as_matrix() if hasattr(poses, "as_matrix") else poses
        if np.ndim(given) != 3 or len(given) != len(rising):
            raise ValueError(f"poses: expected shape ({len(rising)}, 4, 4), one a time, got {np.shape(given)}")
        matrices = np.array([_validation.pose(f"poses[{i}]", matrix) for i, matrix in enumerate(given)])
        self._native = _native.Path.knots(rising.tolist(), matrices.tolist(), _turns(matrices).tolist())

    @classmethod
    def from_twist(
        cls,
        pose: Transform,
        linear: npt.ArrayLike = (0.0, 0.0, 0.0),
        angular: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> Trajectory:
        """Return the trajectory of constant velocity, without beginning or end.

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
            pose·exp(t·twist): with both velocities a circle or a screw.

        Raises
        ------
        TypeError, ValueError
            If the pose is not rigid or a velocity not finite.

        Examples
        --------
        >>> import numpy as np
        >>> import lidarsim as ls
        >>> circle = ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0), angular=(0, 0, 0.5))
        >>> circle.at(np.pi).translation.round(9)
        array([2., 2., 0.])
        """
        trajectory = cls.__new__(cls)
        start = _validation.pose("pose", pose)
        velocities = array("linear", linear, (3,)), array("angular", angular, (3,))
        trajectory._native = _native.Path.twist(start.tolist(), *(velocity.tolist() for velocity in velocities))
        return trajectory

    @property
    def span(self) -> tuple[float, float]:
        """First and last time at which there is a pose, s."""
        return self._native.span()

    def at(self, times: npt.ArrayLike) -> RigidTransform:
        """Return the poses at some times.

        Parameters
        ----------
        times : array_like, shape () or (n,)
            Times within the span, s.

        Returns
        -------
        RigidTransform
            One pose, or n of them.

        Raises
        ------
        ValueError
            If there is no pose at one of the times.
        """
        from scipy.spatial.transform import RigidTransform

        given = np.asarray(times)
        when = array("times", given, ("n",) if given.ndim else ())
        flat = np.atleast_1d(when)
        first, last = self.span
        outside = (flat < first) | (flat > last)
        if outside.any():
            i = int(np.argmax(outside))
            raise ValueError(f"times: expected times from {first} to {last} s, got times[{i}] = {flat[i]}")
        matrices = self._native.at(flat)
        return RigidTransform.from_matrix(matrices if given.ndim else matrices[0])

    def __repr__(self) -> str:
        """Return the class and the span."""
        return "Trajectory({:g} to {:g} s)".format(*self.span)


def _turns(matrices: Floats) -> Floats:
    """Return the rotation vectors from each pose to the next, in the frame of the first of both."""
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_matrix(matrices[:, :3, :3])
    turns: Floats = (rotations[:-1].inv() * rotations[1:]).as_rotvec()
    return turns
