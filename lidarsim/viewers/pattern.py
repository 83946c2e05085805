"""Pictures of scan patterns: the directions of the pulses, and their footprint on a plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, check_folder, check_suffix
from lidarsim._base.shown import plain, quantity
from lidarsim._base.validation import Floats, integer
from lidarsim.errors import ArgumentValueError
from lidarsim.patterns import OscillatingMirror, Palmer, PolygonMirror
from lidarsim.patterns._pulses import pulses_of
from lidarsim.viewers import _plots as plots
from lidarsim.viewers._colors import BACKGROUND, SEQUENTIAL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection

    from lidarsim.lidar import Lidar

MOST = 200_000
"""Greatest number of pulses in a picture, evenly chosen: more only fill the same pixels."""


def draw(lidar: Lidar, path: PathLike, *, frames: int = 1) -> None:
    """Draw the scan pattern of a sensor: azimuth and elevation, and its footprint on a plane, coloured by time.

    The plane is a wall 10 m ahead; for sensors that see 180° or more, the ground 2 m below; for an airborne scanner's
    mirror, the ground under an aircraft at 100 m and 60 m/s. A sensor that sees 180° or more and never looks down is
    drawn at a range of 10 m instead, and one with a single elevation as time over azimuth.

    Parameters
    ----------
    lidar : Lidar
        The sensor.
    path : path-like
        The file, PNG or SVG.
    frames : int
        Number of frames to draw, from frame 0 on.

    Raises
    ------
    FileFormatError
        If the suffix of `path` is neither ``.png`` nor ``.svg``.
    MissingExtraError
        If Matplotlib, a dependency of PyVista, is not installed.
    OSError
        If the file cannot be written.
    TypeError, ValueError
        If `frames` is not an integer >= 1, or the sensor fires no pulses.
    """
    check_suffix(path, plots.SUFFIXES)
    check_folder(path)
    parts = [pulses_of(lidar.pattern, frame) for frame in range(integer("frames", frames, at_least=1))]
    figures = import_extra("matplotlib.figure", "pyvista", "this picture")
    count = sum(map(len, parts))
    if not count:
        raise ArgumentValueError("lidar", "a sensor that fires pulses", "one without")
    every = max(1, math.ceil(count / MOST))
    time = np.concatenate([pulses.time + frame / lidar.pattern.rate for frame, pulses in enumerate(parts)])[::every]
    directions = np.concatenate([pulses.directions for pulses in parts])[::every]
    origins = np.concatenate([pulses.origins for pulses in parts])[::every]

    sheet = figures.Figure(figsize=(14, 7), facecolor=BACKGROUND, layout="constrained")
    angles, plane = sheet.subplots(1, 2)
    drawn = [_draw_angles(angles, directions, time), _draw_footprint(plane, lidar, origins, directions, time)]
    first, last = 1e3 * time.min(), 1e3 * time.max()
    for points in drawn:
        points.set_clim(first, last if last > first else first + 1.0)
    for axes in (angles, plane):
        axes.invert_xaxis()  # y and azimuth grow to the left
    sheet.colorbar(drawn[1], ax=[angles, plane], label="time [ms]", shrink=0.8)
    length = time[-1] - time[0]
    name = plain(lidar.name or type(lidar.pattern).__name__, most=60)
    title = f"{name}: {quantity(count, 'pulse')} in {1e3 * length:.1f} ms"
    sheet.suptitle(title, color="white", parse_math=False)  # names are not formulas
    for axes in sheet.axes:
        axes.set_facecolor(BACKGROUND)
        axes.tick_params(colors="white")
        for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
            text.set_color("white")
        for spine in axes.spines.values():
            spine.set_color("#555555")
    plots.write(sheet, path, dpi=120)


def _draw_angles(axes: Axes, directions: Floats, time: Floats) -> PathCollection:
    x, y, z = directions.T
    azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(np.clip(z, -1.0, 1.0)))
    if np.ptp(elevation) > 0.0:
        points = _scatter(axes, azimuth, elevation, time)
        axes.set(title="directions", xlabel="azimuth [°]", ylabel="elevation [°]")
    else:
        points = _scatter(axes, azimuth, 1e3 * time, time)
        axes.set(title=f"directions, elevation {elevation[0]:g}°", xlabel="azimuth [°]", ylabel="time [ms]")
    if np.ptp(azimuth) > 180.0:
        axes.set_xticks(np.arange(-180, 181, 45))
    return points


def _draw_footprint(axes: Axes, lidar: Lidar, origins: Floats, directions: Floats, time: Floats) -> PathCollection:
    x, y, z = directions.T
    if isinstance(lidar.pattern, OscillatingMirror | Palmer | PolygonMirror) and lidar.pattern.shape[0] == 1:
        hits, met = _on_plane(origins, directions, axis=0, at=100.0)
        points = _scatter(axes, hits[met, 1], (hits[:, 2] + 60.0 * time)[met], time[met])
        axes.set(title="on the ground from 100 m at 60 m/s", xlabel="across [m]", ylabel="along [m]")
    elif np.ptp(np.arctan2(y, x)) < math.pi:
        hits, met = _on_plane(origins, directions, axis=0, at=10.0)
        points = _scatter(axes, hits[met, 1], hits[met, 2], time[met])
        axes.set(title="on a wall 10 m ahead", xlabel="y [m]", ylabel="z [m]", aspect="equal")
    elif (z < 0.0).any():
        hits, met = _on_plane(origins, directions, axis=2, at=-2.0)
        met &= np.hypot(hits[:, 0], hits[:, 1]) < 50.0
        points = _scatter(axes, hits[met, 1], hits[met, 0], time[met])
        axes.set(title="on the ground 2 m below, to 50 m", xlabel="y [m]", ylabel="x [m]", aspect="equal")
    else:
        hits = origins + 10.0 * directions
        points = _scatter(axes, hits[:, 1], hits[:, 0], time)
        axes.set(title="at a range of 10 m, from above", xlabel="y [m]", ylabel="x [m]", aspect="equal")
    return points


def _on_plane(origins: Floats, directions: Floats, *, axis: int, at: float) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the hits of the pulses on the plane where a coordinate is `at`, and which pulses hit it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (at - origins[:, axis]) / directions[:, axis]
        met = np.isfinite(distance) & (distance > 0.0)
        return origins + distance[:, None] * directions, met


def _scatter(axes: Axes, across: Floats, up: Floats, time: Floats) -> PathCollection:
    """Draw points coloured by time, smaller for more points."""
    colors = import_extra("matplotlib.colors", "pyvista", "this picture")
    colormap = colors.LinearSegmentedColormap.from_list("time", SEQUENTIAL)
    size = min(12.0, max(0.4, 3e4 / max(len(time), 1)))
    return axes.scatter(across, up, c=1e3 * time, s=size, cmap=colormap, linewidths=0, rasterized=True)
