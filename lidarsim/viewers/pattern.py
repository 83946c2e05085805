"""A picture of a scan pattern: where its pulses go, and what they leave on a plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lidarsim._extras import import_extra
from lidarsim._files import PathLike, atomic_writer
from lidarsim.viewers._colors import BACKGROUND, SEQUENTIAL
from lidarsim.viewers.pyvista import check_screenshot

# Sine of the flattest angle to the plane whose marks are drawn: others lie far outside the picture.
FLATTEST = 0.02

if TYPE_CHECKING:
    from lidarsim.sensor import Lidar


def draw(lidar: Lidar, path: PathLike) -> None:
    """Draw the first frame of a sensor into a PNG: its pulses by azimuth and elevation, and their marks on a plane.

    The plane stands across the line of sight at a distance of 10 m; for a sensor that looks all around it is the ground
    2 m below.

    Parameters
    ----------
    lidar : Lidar
        The sensor.
    path : path-like
        The PNG file.

    Raises
    ------
    FileFormatError
        If the suffix of `path` is not ``.png``.
    MissingExtraError
        If Matplotlib, which PyVista brings along, is not installed.
    OSError
        If the file cannot be written.
    """
    check_screenshot(path)
    figure = import_extra("matplotlib.figure", "pyvista", "this picture")
    colors = import_extra("matplotlib.colors", "pyvista", "this picture")
    pulses = lidar.pattern.pulses()
    directions = pulses.directions
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    elevation = np.degrees(np.arcsin(np.clip(directions[:, 2], -1.0, 1.0)))

    sight = directions.mean(axis=0)
    below = -directions[:, 2] > FLATTEST
    ground = np.abs(sight).max() < 0.5 and bool(below.any())
    axis = 2 if ground else int(np.argmax(np.abs(sight)))
    height = -2.0 if ground else math.copysign(10.0, sight[axis])
    across, along = {0: (1, 2), 1: (0, 2), 2: (1, 0)}[axis]
    towards = math.copysign(1.0, height) * directions[:, axis] > FLATTEST
    reach = (height - pulses.origins[towards, axis]) / directions[towards, axis]
    marks = (pulses.origins[towards] + reach[:, None] * directions[towards])[:, [across, along]]

    style = {
        "c": pulses.time * 1e3,
        "cmap": colors.LinearSegmentedColormap.from_list("time", SEQUENTIAL),
        "s": np.clip(40_000 / len(pulses), 0.2, 8.0),
        "linewidths": 0,
    }
    sheet = figure.Figure(figsize=(16, 7), facecolor=BACKGROUND, layout="constrained")
    angles, plane = sheet.subplots(1, 2)
    points = angles.scatter(azimuth, elevation, **style)
    angles.set(xlabel="azimuth [°]", ylabel="elevation [°]", title=f"{lidar.name}: {len(pulses):,} pulses")
    angles.invert_xaxis()  # left is left
    plane.scatter(*marks.T, **{**style, "c": style["c"][towards]})
    frame = "xyz"
    plane.set(
        xlabel=f"{frame[across]} [m]",
        ylabel=f"{frame[along]} [m]",
        aspect="equal",
        title=f"marks on {frame[axis]} = {height:g} m",
    )
    if len(marks):
        distances = np.linalg.norm(marks, axis=1)
        window = min(1.05 * float(distances.max()), max(20.0, 3.0 * float(distances.min())))
        plane.set(xlim=(window, -window), ylim=(-window, window))
    sheet.colorbar(points, ax=[angles, plane], label="time [ms]")
    for axes in sheet.axes:
        axes.set_facecolor(BACKGROUND)
        axes.tick_params(colors="white")
        for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
            text.set_color("white")
        for spine in axes.spines.values():
            spine.set_color("#555555")
    with atomic_writer(path) as file:
        sheet.savefig(file, format="png", dpi=100)
