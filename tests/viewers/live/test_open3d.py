"""Open3D: what its window is given in each frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import LidarsimError
from lidarsim.viewers._boxes import LINES
from lidarsim.viewers.live import _open3d
from lidarsim.viewers.open3d import import_open3d
from tests.test_live import FAR, drive, rig, street


class Window:
    """A window that keeps what it is given, and that the user closes after so many events."""

    events = 10**9
    opens = True

    def __init__(self) -> None:
        self.points: list[np.ndarray] = []
        self.colors: list[np.ndarray] = []
        self.lines: dict[int, int] = {}
        self.geometries: list[Any] = []
        self.closed = False
        windows.append(self)

    def create_window(self, *_: object) -> bool:
        return self.opens

    def get_render_option(self) -> Any:
        return self

    def get_view_control(self) -> Any:
        return self

    def set_lookat(self, place: Any) -> None:
        self.target = np.array(place)

    def set_front(self, way: Any) -> None:
        self.front = np.array(way)

    def set_up(self, *_: object) -> None:
        pass

    set_zoom = reset_view_point = set_up

    def add_geometry(self, thing: Any, *_: object) -> None:
        self.geometries.append(thing)
        self.update_geometry(thing)

    def update_geometry(self, thing: Any) -> None:
        if hasattr(thing, "lines"):
            self.lines[id(thing)] = len(thing.lines)
        else:
            self.points.append(np.array(thing.points))
            self.colors.append(np.array(thing.colors))

    def poll_events(self) -> bool:
        self.events -= 1
        return self.events > 0

    def update_renderer(self) -> None:
        pass

    def destroy_window(self) -> None:
        self.closed = True


windows: list[Window] = []


@pytest.fixture(autouse=True)
def _with_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    windows.clear()
    monkeypatch.setattr(_open3d, "require_display", lambda: None)
    monkeypatch.setattr(import_open3d().visualization, "Visualizer", Window)
    monkeypatch.setattr(_open3d.Open3D, "wait", lambda *_: None)


def test_frames_are_drawn_in_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Window, "events", 4)
    scans = list(rig().frames(street(FAR), drive(FAR), 3))
    assert ls.stream(scans, "open3d", scene=street(FAR)) == 3
    (window,) = windows
    assert len(window.points) == 3
    for points, colors, given in zip(window.points, window.colors, scans, strict=True):
        expected = np.concatenate([scan.point_cloud("world").xyz for scan in given.values()])
        # The float64 of map coordinates: a few roundings of half an ulp of 2^23 m each.
        np.testing.assert_allclose(points + np.array([432_000, 5_412_000, 0]), expected, rtol=0, atol=4 * 2.0**-30)
        assert {tuple((255 * rgb).round().astype(int)) for rgb in colors} == {(0x64, 0x96, 0xF5), (255, 0, 255)}
    assert len(window.geometries) == 6  # points, surfaces, movers, boxes and the axes of two sensors
    assert 2 * LINES in window.lines.values()
    assert window.target.tolist() == [120.0, 490.0, 0.0]
    assert window.front[0] < 0 < window.front[2]  # from behind and above
    assert window.closed


def test_closing_the_window_ends_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Window, "events", 2)
    assert ls.stream(rig().frames(street(), drive(), 50), "open3d") == 2
    assert windows[0].closed


def test_no_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Window, "opens", False)
    with pytest.raises(LidarsimError, match="Open3D cannot open a window here"):
        ls.stream(rig().frames(street(), drive(), 1), "open3d")
