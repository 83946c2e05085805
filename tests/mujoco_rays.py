"""A model with every type of geom, and the comparison of a scene with `mj_ray`."""

from __future__ import annotations

import math
import sys

import mujoco
import numpy as np
import numpy.typing as npt

import lidarsim as ls

EVERY_GEOM = """
<mujoco>
  <asset>
    <hfield name="hill" nrow="5" ncol="4" size="1.2 0.9 0.7 0.2"
            elevation="0 0.2 0.1 0.3  0.1 0.9 0.4 0.2  0.3 0.6 1 0.1  0 0.4 0.5 0.2  0.1 0 0.2 0"/>
    <mesh name="gem" vertex="-0.5 -0.4 -0.3  0.6 -0.4 -0.3  0.5 0.5 -0.2  -0.5 0.6 -0.4  0.1 0 0.8"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom name="ramp" type="plane" size="1.5 0.7 1" pos="-3 3 1.2" euler="25 -15 40"/>
    <geom name="hill" type="hfield" hfield="hill" pos="3.5 -3 0.3" euler="8 -5 30"/>
    <geom name="rock" type="mesh" mesh="gem" pos="-3 -3 0.7" euler="50 20 70"/>
    <body name="crate" pos="3 2 1.2" euler="30 40 50"><freejoint/><geom type="box" size="0.6 0.4 0.5"/></body>
    <body name="drum" pos="0 3.5 1.2" euler="70 20 10">
      <freejoint/>
      <geom name="drum" type="cylinder" size="0.5 0.6"/>
      <geom name="lid" type="ellipsoid" size="0.7 0.5 0.2" pos="0.2 0.1 0.9" euler="10 20 30"/>
    </body>
    <body name="arm" pos="0 -3 1.5">
      <joint axis="0 1 0"/>
      <geom name="arm" type="capsule" size="0.2" fromto="0 0 0 0.8 0.3 0.2"/>
      <body name="hand" pos="0.8 0.3 0.2">
        <joint axis="1 0 1"/>
        <geom name="hand" type="mesh" mesh="gem" pos="0.5 0 0"/>
        <site name="lidar" pos="0.2 -0.1 0.3" euler="10 20 30"/>
      </body>
    </body>
    <body name="ghost" mocap="true" pos="-3.5 0 1"><geom name="ghost" size="0.5"/></body>
  </worldbody>
</mujoco>
"""

# MuJoCo solves quadratics by the textbook's formula. Where a ray grazes a surface, the discriminant is the small
# difference of numbers of the size of b², each of which carries a few roundings. So t may be off by √ε of b/a, which is
# the distance to the middle of the geom. All geoms are within this distance of all origins.
FARTHEST = 20.0
TOLERANCE = 4 * math.sqrt(sys.float_info.epsilon) * FARTHEST


def compare(
    scene: ls.Scene,
    geoms: npt.NDArray[np.intp],
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    rays: int,
    seed: int = 0,
) -> None:
    """Check that rays meet the same geoms at the same distance as for `mj_ray`; `geoms` has that of each object.

    Planes, of which MuJoCo knows only the front, differ where a ray meets their back.
    """
    rng = np.random.default_rng(seed)
    origins = rng.uniform((-5, -5, 2.5), (5, 5, 4), (rays, 3))
    targets = rng.uniform((-5, -5, -0.5), (5, 5, 3), (rays, 3))
    directions = targets - origins
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hits = scene.cast(origins, directions)
    met, found, distance = np.append(geoms, -1)[hits.object_id], np.empty(rays, np.int32), np.empty(rays)
    for k, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        distance[k] = mujoco.mj_ray(model, data, origin, direction, None, 1, -1, found[k : k + 1])
    fronts = data.geom_xmat[met].reshape(-1, 3, 3)[:, :, 2]
    behind = (model.geom_type[met] == mujoco.mjtGeom.mjGEOM_PLANE) & (met >= 0)
    behind &= np.einsum("ij,ij->i", fronts, directions) >= 0
    np.testing.assert_array_equal(met[~behind], found[~behind])
    hit = ~behind & (found >= 0)
    np.testing.assert_allclose(hits.t[hit], distance[hit], rtol=0, atol=TOLERANCE)
    assert np.isinf(hits.t[~behind & (found < 0)]).all()
    assert (found[behind] != met[behind]).all()
    assert behind.sum() < rays / 20
    counts = np.bincount(found[hit], minlength=model.ngeom)
    assert (counts > rays / 1000).all(), counts
