"""A walking person: limbs of fixed length that swing at their joints.

Stride and joint angles against speed are those of R. Boulic, N. Magnenat Thalmann and D. Thalmann, A global human
walking model with real-time kinematic personification, The Visual Computer 6, 1990, pp. 344-358. With the relative
speed r = v / hip height (1/s), a cycle of two steps is 1.346 √r hip heights long (after V. T. Inman et al., Human
Walking, 1981), so that a person of 1.75 m who walks at 1.4 m/s takes 1.1 s for 1.5 m. Flexion of hip, knee, ankle,
shoulder and elbow is given there at a few moments of the cycle, linear in r between the relative speeds 0, 0.5, 1.3 and
3; half waves of a cosine join them here. The sides are half a cycle apart. The pelvis moves up and down only, so that
the lower foot stands on the ground.

Lengths of the limbs are shares of the height after R. Drillis and R. Contini, Body segment parameters, 1966, as D. A.
Winter gives them in Biomechanics and Motor Control of Human Movement, 2009, figure 4.1.
"""

from __future__ import annotations

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim._base.vectors import product, turned_about_y
from lidarsim.world.shapes import Capsule, Ellipsoid, Shape

__all__ = ["FASTEST", "HIP", "LIMBS", "figure", "gait_rate", "limbs", "postures"]

FOOT_HEIGHT, SHANK, THIGH, TORSO = 0.039, 0.246, 0.245, 0.288
UPPER_ARM, FOREARM = 0.186, 0.146 + 0.108 / 2  # half a hand is closed
HALF_HIPS, HALF_SHOULDERS = 0.191 / 2, 0.259 / 2
FOOT_RADIUS = 0.022
HEEL, TOE = (-0.03, 0.0, FOOT_RADIUS - FOOT_HEIGHT), (0.152 - 0.03 - 2 * FOOT_RADIUS, 0.0, FOOT_RADIUS - FOOT_HEIGHT)
HIP = FOOT_HEIGHT + SHANK + THIGH
"""Lengths as shares of the height: the foot's height, the limbs from joint to joint, half the distance between joints,
the ends of the axis of a foot, from the ankle, and the height of the hips."""

SPEEDS = 0.0, 0.5, 1.3, 3.0
"""Relative speeds, 1/s, at which the angles are given."""

FASTEST = SPEEDS[-1]

CYCLE = 1.346
"""Length of a cycle in hip heights, over the square root of the relative speed."""

# Moments of the cycle of a side, which begins as its heel strikes, and flexion at these, degrees, at each of `SPEEDS`.
HIP_FLEXION = (
    (0.5, (0, -15, -15, -15)),
    (0.9, (0, 25, 25, 31)),
    ((0.9, 0.9, 0.9, 1.1), (0, 25, 25, 30)),
)
KNEE_FLEXION = (
    ((0.0, 0.0, 0.0, -0.03), (3, 3, 3, 6)),
    ((0.17, 0.17, 0.17, 0.12), (3, 3, 3, 25)),
    (0.4, (3, 3, 3, 3)),
    ((0.75, 0.75, 0.75, 0.7), (3, 70, 70, 65)),
)
ANKLE_FLEXION = (
    (0.0, (-3, -3, -3, 2)),
    (0.08, (-3, -18, -18, -14)),
    ((0.5, 0.5, 0.5, 0.4), (-3, 8, 8, 5)),
    ((0.68, 0.68, 0.63, 0.57), (-3, -20, -20, -28)),  # the foot leaves the ground
    (0.85, (-3, -3, -3, 2)),
)
ELBOW_FLEXION = (
    (0.05, (3, 6, 14, 8)),
    ((0.5, 0.5, 0.51, 0.55), (3, 20, 44, 70)),
    ((0.9, 0.9, 0.9, 0.8), (3, 8, 17, 11)),
)
SHOULDER_SWING = 9.88
"""Amplitude at the shoulder, degrees, over the relative speed."""

LIMBS = 12
"""Number of limbs, torso and head among them."""

Flexion = tuple[tuple[float | tuple[float, ...], tuple[float, ...]], ...]


def gait_rate(relative_speed: Floats) -> Floats:
    """Return the cycles per second at a relative speed of either sign: its magnitude over the length of a cycle."""
    rate: Floats = np.sign(relative_speed) * np.sqrt(np.abs(relative_speed)) / CYCLE
    return rate


def limbs(height: float) -> list[tuple[str, Shape]]:
    """Return names and shapes of the limbs; each hangs down from its joint at the origin, and the person faces x."""
    h = height

    def hanging(length: float, radius: float) -> Capsule:
        return Capsule((0, 0, 0), (0, 0, -length * h), radius * h)

    one_side = {
        "thigh": hanging(THIGH, 0.046),
        "shank": hanging(SHANK - 0.01, 0.032),
        "foot": Capsule(np.multiply(h, HEEL), np.multiply(h, TOE), FOOT_RADIUS * h),
        "upper arm": hanging(UPPER_ARM, 0.026),
        "forearm": hanging(FOREARM, 0.021),
    }
    torso = Ellipsoid((0, 0, 0.45 * TORSO * h), (0.068 * h, HALF_SHOULDERS * h * 0.9, 0.62 * TORSO * h))
    head = Ellipsoid((0, 0, (1 - HIP - 0.072) * h), (0.058 * h, 0.046 * h, 0.072 * h))
    sides = [(f"{side} {name}", shape) for side in ("left", "right") for name, shape in one_side.items()]
    return [("torso", torso), ("head", head), *sides]


def postures(height: float, phase: Floats, relative_speed: Floats) -> list[Floats]:
    """Return the poses of the limbs relative to the ground below the hips, each of shape (n, 4, 4).

    Parameters
    ----------
    height : float
        Height of the person, m.
    phase : ndarray of float64, shape (n,)
        Number of cycles since the left heel struck.
    relative_speed : ndarray of float64, shape (n,)
        Speed over the height of the hips, 1/s, from 0 to `FASTEST`.
    """
    phases = np.mod([phase, phase + 0.5], 1.0)
    flexions = [
        np.radians(_flexion(points, phases, relative_speed))
        for points in (HIP_FLEXION, KNEE_FLEXION, ANKLE_FLEXION, ELBOW_FLEXION)
    ]
    swing = SHOULDER_SWING * relative_speed
    shoulders = np.radians(3 - swing / 2 - swing * np.cos(2 * np.pi * phases))
    chains = [
        _chain(height, side, hip, knee, ankle, shoulder, elbow)
        for side, hip, knee, ankle, elbow, shoulder in zip((1.0, -1.0), *flexions, shoulders, strict=True)
    ]
    ends = np.array([(*end, 1.0) for end in (HEEL, TOE)]).T * [[height], [height], [height], [1.0]]
    lowest = np.min([product(chain[2][:, 2], ends).min(axis=1) for chain in chains], axis=0) - FOOT_RADIUS * height
    up = np.tile(np.eye(4), (len(phase), 1, 1))
    up[:, 2, 3] = -lowest
    return [up, up, *(product(up, pose) for chain in chains for pose in chain)]


def figure(
    height: float,
    *,
    hip: tuple[float, float],
    knee: tuple[float, float],
    ankle: tuple[float, float] = (0.0, 0.0),
    shoulder: tuple[float, float] = (0.0, 0.0),
    elbow: tuple[float, float] = (10.0, 10.0),
    lean: float = 0.0,
) -> list[Floats]:
    """Return the poses, (4, 4), of the limbs of a person whose hips are at the origin.

    Parameters
    ----------
    height : float
        Height of the person, m.
    hip, knee, ankle, shoulder, elbow : (float, float)
        Flexion of the left and the right joint, degrees: thigh, foot and arm go ahead, shank goes back.
    lean : float
        How far the torso leans ahead, degrees.
    """
    torso = turned_about_y((0, 0, 0), np.radians([lean]))
    poses = [torso, torso]
    for index, side in enumerate((1.0, -1.0)):
        flexion = (np.radians([pair[index]]) for pair in (hip, knee, ankle, shoulder, elbow))
        thigh, shank, foot, upper, fore = _chain(height, side, *flexion)
        poses += [thigh, shank, foot, product(torso, upper), product(torso, fore)]
    return [pose[0] for pose in poses]


def _chain(  # noqa: PLR0917 - the joints, from the hip on
    height: float, side: float, hip: Floats, knee: Floats, ankle: Floats, shoulder: Floats, elbow: Floats
) -> list[Floats]:
    """Return the poses of thigh, shank, foot, upper arm and forearm of a side, 1 for the left, by the flexions, rad."""
    thigh = turned_about_y((0, side * HALF_HIPS * height, 0), -hip)
    shank = product(thigh, turned_about_y((0, 0, -THIGH * height), knee))
    foot = product(shank, turned_about_y((0, 0, -SHANK * height), -ankle))
    upper = turned_about_y((0, side * (HALF_SHOULDERS + 0.01) * height, 0.95 * TORSO * height), -shoulder)
    fore = product(upper, turned_about_y((0, 0, -UPPER_ARM * height), -elbow))
    return [thigh, shank, foot, upper, fore]


def _flexion(points: Flexion, phases: Floats, relative_speed: Floats) -> Floats:
    """Return the angles of both sides, degrees, (2, n), at phases from 0 to 1, (2, n), and speeds, (n,).

    From each point to the next they follow half a wave of a cosine.
    """
    speeds = [(np.broadcast_to(moment, len(SPEEDS)), angles) for moment, angles in points]
    moments, angles = (np.array([np.interp(relative_speed, SPEEDS, row[k]) for row in speeds]) for k in (0, 1))
    moments, angles = np.concatenate([moments - 1, moments, moments + 1]), np.tile(angles, (3, 1))
    before = (phases >= moments[:, None]).sum(axis=0) - 1  # of points at the same moment the last
    each = np.arange(len(relative_speed))
    start, end = moments[before, each], moments[before + 1, each]
    share = (1 - np.cos(np.pi * (phases - start) / (end - start))) / 2
    flexion: Floats = angles[before, each] + share * (angles[before + 1, each] - angles[before, each])
    return flexion
