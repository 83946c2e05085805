"""HTML pages: interactive pictures for browsers and notebooks in one self-contained file, drawn by Plotly."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, atomic_writer
from lidarsim._base.shown import plain, quantity
from lidarsim._base.validation import Floats
from lidarsim._base.views import Camera
from lidarsim.scan.boxes import Boxes
from lidarsim.viewers._boxes import LINES, lines
from lidarsim.viewers._colors import AXES, MISSING, PATH, Coloring, field_of
from lidarsim.viewers._picture import AXIS, CAMERAS, MARGIN, Frame, Picture, split_by_color
from lidarsim.viewers._surfaces import Surface, merge_surfaces

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from plotly.basedatatypes import BaseTraceType

MOST = 400_000
"""Greatest number of points on a page, evenly chosen from all frames: more slow browsers down."""
ANGLE = np.radians(45.0)
"""Plotly's vertical angle of view, rad."""
STAGE = 0.82
"""Width relative to the page for which the view is made; the legend is over the rest of it."""
RIGHT = {"x": 0.99, "xanchor": "right"}
LONGEST = 24
"""Greatest length of a name in the legend, characters."""
HOVERED = ("range", "intensity", "range_error", "ring", "object_id")
"""Fields that a page shows for the point under the pointer."""


@dataclass(frozen=True, slots=True, repr=False)
class Page:
    """A page that a notebook displays.

    Attributes
    ----------
    text : str
        The whole page in HTML.
    height : int
        Height of its frame in the notebook, pixels.
    """

    text: str
    height: int

    def _repr_html_(self) -> str:
        source = html.escape(self.text, quote=True)
        return f'<iframe srcdoc="{source}" style="width: 100%; height: {self.height}px; border: none"></iframe>'


def write(picture: Picture, path: PathLike, *, size: tuple[int, int], point_size: float | None) -> None:
    """Write a picture as a page of all frames, with a slider.

    The page is designed for a width and a height, pixels, and fills the window of the browser.

    Raises
    ------
    MissingExtraError
        If Plotly is not installed.
    OSError
        If the file cannot be written.
    """
    text = page(picture, size=size, point_size=point_size).text
    with atomic_writer(path) as file:
        file.write(text.encode())


def page(picture: Picture, *, size: tuple[int, int], point_size: float | None) -> Page:
    """Return a picture as a page for a notebook; the parameters are those of `write`."""
    figure = _figure(picture, STAGE * size[0] / size[1], point_size)
    text = figure.to_html(
        include_plotlyjs=True,
        div_id="lidarsim",
        default_height="100vh",
        config={"displaylogo": False, "responsive": True, "scrollZoom": True},
        auto_play=False,
    )
    style = f"<style>html, body {{ margin: 0; background: {picture.theme.background}; }}</style>"
    return Page(text.replace("</head>", f"{style}<title>lidarsim</title></head>", 1), min(size[1], 700))


def _figure(picture: Picture, aspect: float, point_size: float | None) -> go.Figure:
    go = import_extra("plotly.graph_objects", "html", "a page")
    seen = picture.points_to_show()
    every = np.concatenate(
        [seen]
        + [frame.cloud.xyz for frame in picture.frames]
        + [surface.points() for surface in picture.every_surface]
        + [frame.pose[None, :3, 3] for frame in picture.frames]
    )
    low, high = every.min(axis=0), every.max(axis=0)
    # Map coordinates have too many digits for float32 and for ticks.
    shift = np.round((low + high) / 2000) * 1000 if np.abs(every).max() > 1e4 else np.zeros(3)
    reach = float(np.linalg.norm(seen - seen.mean(axis=0), axis=1).max())
    step = max(1, -(-sum(len(frame.cloud) for frame in picture.frames) // MOST))
    most = max(len(frame.cloud) for frame in picture.frames) // step
    dot = point_size or float(np.clip(1.2 * (100_000 / max(most, 1)) ** 0.25, 1, 4))
    moving = [
        _moving(go, picture, frame, shift=shift, reach=reach, step=step, dot=dot)
        + _meshes(go, picture, frame.movers, shift)
        + _boxes(go, picture, frame.boxes, shift)
        for frame in picture.frames
    ]
    still = [*_meshes(go, picture, picture.surfaces, shift, legend=True), *_path(go, picture, shift)]
    figure = go.Figure(data=[*moving[0], *still])
    half = MARGIN * np.maximum((high - low) / 2, 1e-3 * reach)  # else Plotly clips points that float32 rounds outwards
    whole = float(half.max())
    centre = (low + high) / 2

    def camera(name: Camera | Floats) -> dict[str, dict[str, float]]:
        """Return a view in Plotly's unit, the longest edge of the axes' box."""
        view = replace(picture, camera=name).view(0, seen, aspect, angle=ANGLE)
        eye, target = ((point - centre) / (2 * whole) for point in (view.eye, view.target))
        named = {"eye": eye, "center": target, "up": view.up}
        return {name: dict(zip("xyz", map(float, value), strict=True)) for name, value in named.items()}

    axes = {
        f"{name}axis": {
            "title": f"{name} [m]" + (f", from {shift[i]:,.0f}" if shift[i] else ""),
            "range": [float(centre[i] - half[i] - shift[i]), float(centre[i] + half[i] - shift[i])],
            "gridcolor": picture.theme.grid,
            "zerolinecolor": picture.theme.grid,
            "showbackground": False,
            "showspikes": False,
        }
        for i, name in enumerate("xyz")
    }
    figure.update_layout(
        template=None,
        paper_bgcolor=picture.theme.background,
        font={"color": picture.theme.text},
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
        legend={
            "itemsizing": "constant",
            "bgcolor": picture.theme.background,
            # A colour bar has the title, and the middle of the height.
            **({"y": 0.02, "yanchor": "bottom"} if picture.colors.scaled else {"title": picture.colors.title}),
            **RIGHT,
        },
        annotations=_annotations(picture),
        scene={
            **axes,
            "aspectmode": "manual",
            "aspectratio": {name: float(half[i] / whole) for i, name in enumerate("xyz")},
            "camera": camera(picture.camera),
            "dragmode": "turntable",
        },
        updatemenus=[
            {
                "type": "buttons",
                "direction": "right",
                "showactive": False,
                "x": 0.01,
                "xanchor": "left",
                "y": 1.0,
                "yanchor": "bottom",
                "bgcolor": picture.theme.grid,
                "buttons": [
                    {
                        "label": name,
                        "method": "relayout",
                        "args": [{"scene.camera": camera(name)}],
                    }
                    for name in CAMERAS
                ],
            }
        ],
    )
    if len(moving) > 1:
        names = [str(number) for number in range(len(moving))]
        figure.frames = [
            go.Frame(data=traces, name=name, traces=list(range(len(traces))))
            for name, traces in zip(names, moving, strict=True)
        ]
        still_now = {"mode": "immediate", "transition": {"duration": 0}, "frame": {"duration": 0, "redraw": True}}
        figure.update_layout(
            sliders=[
                {
                    "currentvalue": {"prefix": "", "font": {"color": picture.theme.text}},
                    "font": {"color": picture.theme.background},  # long texts at its ends would be cut off
                    "len": 0.8,
                    "x": 0.05,
                    "steps": [
                        {"label": frame.title or name, "method": "animate", "args": [[name], still_now]}
                        for name, frame in zip(names, picture.frames, strict=True)
                    ],
                }
            ]
        )
    return figure


def _annotations(picture: Picture) -> list[dict[str, Any]]:
    """Return the title of a single frame, and what a picture of points says if there are none."""
    place = {"xref": "paper", "yref": "paper", "showarrow": False, "bgcolor": picture.theme.background}
    found = []
    if len(picture.frames) == 1 and picture.frames[0].title:
        title = html.escape(picture.frames[0].title, quote=False)
        found.append({"text": title, "x": 0.01, "y": 0.99, "xanchor": "left", "yanchor": "top", **place})
    if picture.of_points and not picture.has_points:
        found.append({"text": "no points", "x": STAGE / 2, "y": 0.5, **place})
    return found


def _xyz(points: Floats) -> dict[str, npt.NDArray[np.float32]]:
    return {name: np.ascontiguousarray(points[:, i], np.float32) for i, name in enumerate("xyz")}


def _moving(
    go: ModuleType, picture: Picture, frame: Frame, *, shift: Floats, reach: float, step: int, dot: float
) -> list[BaseTraceType]:
    """Return the traces of a frame: points, one trace per category, and the sensor's axes; same order in all frames."""
    cloud, colors = frame.cloud[::step], picture.colors
    values = field_of(cloud, colors.field)
    told = [name for name in HOVERED if name in cloud.fields]
    lines = [f"{name} %{{customdata[{i}]:.4~f}}" for i, name in enumerate(told)]

    def points(chosen: npt.NDArray[np.bool_], name: str, marker: dict[str, Any], *, legend: bool) -> BaseTraceType:
        part = cloud[chosen]
        columns = [np.asarray(getattr(part, field), np.float32) for field in told]
        return go.Scatter3d(
            # An empty trace would be missing in the legend, which also explains the colours of surfaces.
            **_xyz(part.xyz - shift if len(part) else np.full((1, 3), np.nan)),
            mode="markers",
            marker={"size": dot, **marker},
            name=html.escape(plain(name, most=LONGEST), quote=False),  # Plotly interprets tags and some entities
            showlegend=legend,
            customdata=np.stack(columns, axis=-1) if columns else None,
            hovertemplate="<br>".join(["x %{x:.2f}, y %{y:.2f}, z %{z:.2f}", *lines]),
        )

    traces = []
    if colors.names:
        for color, (category, name) in zip(colors.table, colors.names.items(), strict=True):
            traces.append(points(values == category, name, {"color": color}, legend=True))
    else:
        known = np.isfinite(values)
        numbers = colors.places(values[known]) if known.any() else [0.0]
        scaled = {"color": numbers, **_scale(colors, picture.theme.background, bar=colors.scaled)}
        traces.append(points(known, colors.title, scaled, legend=False))
        if colors.missing:
            traces.append(points(~known, "not finite", {"color": MISSING}, legend=True))
    start = frame.pose[:3, 3] - shift
    for axis, color in enumerate(AXES):
        ends = np.stack([start, start + AXIS * reach * frame.pose[:3, axis]])
        traces.append(
            go.Scatter3d(
                **_xyz(ends), mode="lines", line={"color": color, "width": 6}, hoverinfo="skip", showlegend=False
            )
        )
    return traces


def _scale(colors: Coloring, background: str, *, bar: bool) -> dict[str, Any]:
    """Return the colour scale of a trace, with a colour bar if `bar`."""
    ticks = colors.ticks()
    return {
        "cmin": 0.0,
        "cmax": 1.0,
        "colorscale": [[i / (len(colors.table) - 1), color] for i, color in enumerate(colors.table)],
        "showscale": bar,
        "colorbar": {
            "title": "<br>".join([colors.title, *filter(None, [colors.clipped])]),
            "tickvals": colors.places(list(ticks)).tolist(),
            "ticktext": list(ticks.values()),
            "len": 0.7,
            "bgcolor": background,
            **RIGHT,
        },
    }


def _meshes(
    go: ModuleType, picture: Picture, surfaces: Sequence[Surface], shift: Floats, *, legend: bool = False
) -> list[BaseTraceType]:
    """Return surfaces, merged by colour; with `legend`, one entry stands for all of them."""
    colors = picture.colors
    by_height = colors.field == "height"
    by_color: dict[str, list[Surface]] = {}
    for surface in surfaces:
        for color, part in split_by_color(surface, picture):
            by_color.setdefault(color, []).append(part)
    traces: list[BaseTraceType] = []
    for color, group in by_color.items():
        points, faces = merge_surfaces(group, shift)
        corners = {name: np.ascontiguousarray(faces[:, i], np.int32) for i, name in enumerate("ijk")}
        look: dict[str, Any] = {"color": color}
        if by_height:
            look = {
                "intensity": colors.places(points[:, 2] + shift[2]),
                **_scale(colors, picture.theme.background, bar=False),
            }
        traces.append(
            go.Mesh3d(
                **_xyz(points),
                **corners,
                **look,
                opacity=0.2 if picture.has_points else 1.0,
                flatshading=True,
                hoverinfo="skip",
                name="surfaces",
                legendgroup="surfaces",
                showlegend=legend and not traces,
            )
        )
    return traces


def _boxes(go: ModuleType, picture: Picture, boxes: Boxes | None, shift: Floats) -> list[BaseTraceType]:
    """Return the boxes of a frame, one trace per class of all frames."""
    labels = sorted({label for frame in picture.frames if frame.boxes for label in frame.boxes.label.tolist()})
    traces = []
    for label in labels:
        own = None if boxes is None else boxes[boxes.label == label]
        name = html.escape(plain(picture.class_name(label), most=LONGEST), quote=False)
        points, told = np.full((1, 3), np.nan), [""]
        if own is not None and len(own):
            gaps = np.full((len(own), LINES, 1, 3), np.nan)  # between two lines
            points = np.concatenate([lines(own) - shift, gaps], axis=2).reshape(-1, 3)
            about = (
                f"{name} {number}, " + " × ".join(f"{edge:.2f}" for edge in size) + f" m, {quantity(count, 'point')}"
                for number, size, count in zip(
                    own.instance.tolist(), own.size.tolist(), own.points.tolist(), strict=True
                )
            )
            told = [text for text in about for _ in range(3 * LINES)]
        traces.append(
            go.Scatter3d(
                **_xyz(points),
                mode="lines",
                line={"color": picture.class_color(label), "width": 2},
                name=name,
                text=told,
                hoverinfo="text",
                legendgroup="boxes",
                legendgrouptitle={"text": "boxes"},
                showlegend=picture.colors.field != "label",
            )
        )
    return traces


def _path(go: ModuleType, picture: Picture, shift: Floats) -> list[BaseTraceType]:
    if not len(picture.path):
        return []
    line = {"color": PATH, "width": 4}
    return [go.Scatter3d(**_xyz(picture.path - shift), mode="lines", line=line, hoverinfo="skip", name="path")]
