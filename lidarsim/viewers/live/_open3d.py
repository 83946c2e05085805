"""Open3D: a window that shows each frame as it comes."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from lidarsim.errors import LidarsimError
from lidarsim.viewers._boxes import LINES, lines
from lidarsim.viewers._colors import DARK
from lidarsim.viewers._display import require_display
from lidarsim.viewers.open3d import import_open3d

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.viewers.live._moment import Moment, Painted, World

__all__ = ["Open3D"]

SIZE = 1600, 1000
ZOOM = 0.25
"""Share of the whole that is seen at first."""
AXES = 1.0
"""Length of the sensors' axes, m."""


class Open3D:
    """Show frames in a window of Open3D, with the edges of the surfaces; closing it ends the scan."""

    def __init__(self) -> None:
        require_display()
        self._o3d: Any = import_open3d()
        self.paced = True
        self.where = ""
        self._drawn: dict[str, Any] = {}

    def __enter__(self) -> Self:
        """Open the window."""
        self._window = self._o3d.visualization.Visualizer()
        if not self._window.create_window("lidarsim", *SIZE):
            raise LidarsimError("Open3D cannot open a window here: is there OpenGL?")
        look = self._window.get_render_option()
        look.background_color = np.array(list(bytes.fromhex(DARK.background[1:]))) / 255
        look.point_size = 2.0
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keep the last frame until the user closes the window, unless there was an error; then close it."""
        try:
            while error is None and self._window.poll_events():
                self._window.update_renderer()
        finally:
            self._window.destroy_window()

    def begin(self, world: World) -> None:
        """Keep the surfaces, which are drawn with the first frame."""
        self._origin, self._static, self._target = world.origin, world.static, world.target
        self._towards = world.eye - world.target

    def wait(self, seconds: float) -> None:
        """Let the user turn the view."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self._window.poll_events():
            self._window.update_renderer()

    def show(self, moment: Moment) -> bool:
        """Draw a frame."""
        first = not self._drawn
        points = np.concatenate([sensor.in_world() for sensor in moment.sensors.values()]) - self._origin
        colors = np.concatenate([sensor.rgb for sensor in moment.sensors.values()]) / 255
        self._put("points", self._o3d.geometry.PointCloud, points=points, colors=colors)
        if first:
            self._edges("surfaces", self._static)
        if moment.movers:
            self._edges("movers", moment.movers)
        if moment.boxes is not None:
            ends = lines(moment.boxes).reshape(-1, 3) - self._origin
            self._lines("boxes", ends, np.repeat(_channels(moment.box_colors), LINES, axis=0))
        for name, sensor in moment.sensors.items():
            base = sensor.pose[:3, 3] - self._origin
            ends = np.stack([np.broadcast_to(base, (3, 3)), base + AXES * sensor.pose[:3, :3].T], axis=1)
            self._lines(f"axes of {name}", ends.reshape(-1, 3), np.eye(3))
        if first:
            self._window.reset_view_point(True)
            view = self._window.get_view_control()
            view.set_lookat(self._target - self._origin)
            view.set_front(self._towards)
            view.set_up((0.0, 0.0, 1.0))
            view.set_zoom(ZOOM)
        open_ = bool(self._window.poll_events())
        self._window.update_renderer()
        return open_

    def _edges(self, name: str, parts: list[Painted]) -> None:
        ends, colors = [np.empty((0, 3))], [np.empty((0, 3))]
        for part in parts:
            faces = part.surface.faces
            edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
            ends.append((part.surface.points() - self._origin)[edges].reshape(-1, 3))
            colors.append(np.broadcast_to(_channels([part.color]), (len(edges), 3)))
        self._lines(name, np.concatenate(ends), 0.4 * np.concatenate(colors))

    def _lines(self, name: str, ends: Floats, colors: Floats) -> None:
        joints = np.arange(len(ends), dtype=np.int32).reshape(-1, 2)
        self._put(name, self._o3d.geometry.LineSet, points=ends, lines=joints, colors=colors)

    def _put(self, name: str, kind: Any, **arrays: Any) -> None:
        """Draw arrays as a geometry, in place of the one with this name."""
        made = name not in self._drawn
        if made:
            self._drawn[name] = kind()
        thing = self._drawn[name]
        wrap = {"lines": self._o3d.utility.Vector2iVector}
        for part, array in arrays.items():
            setattr(thing, part, wrap.get(part, self._o3d.utility.Vector3dVector)(np.ascontiguousarray(array)))
        if made:
            self._window.add_geometry(thing, False)
        else:
            self._window.update_geometry(thing)


def _channels(colors: list[str]) -> Floats:
    rgb: Floats = np.array([list(bytes.fromhex(color[1:])) for color in colors]).reshape(-1, 3) / 255
    return rgb
