"""A picture of a scan pattern: where its pulses go, and what they leave on a plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lidarsim._extras import import_extra
from lidarsim._files import PathLike, atomic_writer
from lidarsim.viewers._colors import BACKGROUND, SEQUENTIAL
from lidarsim.viewers.pyvista import check_screenshot

if TYPE_CHECKING:
    from lidarsim.sensor import Lidar


def draw(lidar: Lidar, path: PathLike) -> None:
    """Draw the first frame of a sensor into a PNG file: azimuth and elevation of its pulses, and their marks on a plane.

    The plane stands across the sensor's line of sight at a distance of 10 m; a sensor that looks all around has the ground
    2 m below it.

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

    middle = directions.mean(axis=0)
    axis = int(np.argmax(np.abs(middle)))
    around = abs(middle[axis]) < 0.5
    axis, sign, distance = (2, -1.0, 2.0) if around else (axis, float(np.sign(middle[axis])), 10.0)
    right, up = {0: (1, 2), 1: (0, 2), 2: (1, 0)}[axis]
    towards = sign * directions[:, axis] > 0.05  # flatter than that ends far outside the picture
    reach = (sign * distance - pulses.origins[towards, axis]) / directions[towards, axis]
    marks = pulses.origins[towards] + reach[:, None] * directions[towards]

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
    plane.scatter(marks[:, right], marks[:, up], **{**style, "c": style["c"][towards]})
    names = "xyz"
    where = "ground, 2 m below" if around else f"plane {names[axis]} = {sign * distance:g} m"
    plane.set(xlabel=f"{names[right]} [m]", ylabel=f"{names[up]} [m]", title=f"marks on the {where}", aspect="equal")
    plane.invert_xaxis()
    if around:
        plane.set(xlim=(20, -20), ylim=(-20, 20))
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
