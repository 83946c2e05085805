from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError, MissingExtraError
from lidarsim.viewers._colors import BACKGROUND
from lidarsim.viewers.pattern import _on_plane, draw
from tests.patterns.families import FAMILIES

image = pytest.importorskip("matplotlib.image")  # comes with pyvista, an extra


ONE_OF_EACH = {type(pattern): name for name, pattern in FAMILIES.items()}.values()
"""Beside them come those with a footprint of another kind."""


@pytest.mark.slow("every family of patterns is drawn")
@pytest.mark.parametrize("name", [*ONE_OF_EACH, "vlp16", "hokuyo", "vq780"])
def test_every_family_is_drawn(tmp_path: Path, name: str) -> None:
    path = tmp_path / "pattern.png"
    draw(ls.Lidar(FAMILIES[name]), path)
    picture = image.imread(path)[:, :, :3]
    assert picture.shape == (840, 1680, 3)
    background = [int(BACKGROUND[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    drawn = np.abs(picture - background).max(axis=-1) > 0.3
    assert drawn[80:740, 90:750].sum() > 10  # marks inside the frames, of three directions at least
    assert drawn[100:740, 860:1480].sum() > 10


def test_more_frames_draw_more(tmp_path: Path) -> None:
    lidar = ls.Lidar(FAMILIES["mid40"])
    counts = []
    for frames in (1, 4):
        draw(lidar, tmp_path / "pattern.png", frames=frames)
        counts.append((image.imread(tmp_path / "pattern.png")[80:740, 90:750, :3].max(axis=-1) > 0.3).sum())
    assert counts[1] > 1.5 * counts[0]


def test_footprint_is_where_the_pulses_meet_the_plane() -> None:
    origins = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    directions = np.array([[0.6, 0.0, -0.8], [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    hits, met = _on_plane(origins, directions, axis=2, at=-3.0)
    np.testing.assert_array_equal(met, [True, False, False])
    np.testing.assert_allclose(hits[0], [3.0, 0.0, -3.0])


def test_bad_paths_and_frames_are_named(tmp_path: Path) -> None:
    lidar = ls.Lidar(FAMILIES["flash"])
    with pytest.raises(FileFormatError, match=re.escape(".png")):
        draw(lidar, tmp_path / "pattern.jpg")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        draw(lidar, tmp_path / "missing" / "pattern.png")
    with pytest.raises(ValueError, match=r"^frames: expected an integer >= 1, got 0$"):
        draw(lidar, tmp_path / "pattern.png", frames=0)
    assert not list(tmp_path.iterdir())


def test_missing_matplotlib_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=re.escape('pip install "lidarsim[pyvista]"')):
        draw(ls.Lidar(FAMILIES["flash"]), tmp_path / "pattern.png")


def test_an_svg_is_the_same_each_time(tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        draw(ls.Lidar(FAMILIES["mid40"]), tmp_path / name)
    text = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert text == (tmp_path / "b.svg").read_text(encoding="utf-8")
    assert "<svg" in text
    assert len(text) < 2e6  # the marks are pixels
