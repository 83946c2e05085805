"""The data card: what names of others show on it, as a reader of Markdown sees it."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

import lidarsim as ls
from lidarsim.datasets import card, manifest
from lidarsim.datasets.card import escape
from lidarsim.datasets.samples import RANGES
from lidarsim.datasets.statistics import POINTS, VISIBILITY, _bin
from lidarsim.datasets.store import open_store

NASTY = [
    "a|b", "a\\|b", "x\n\n# Heading\n\n<script>alert(1)</script>", "![x](http://127.0.0.1/a.png)",
    "<img src=x onerror=y>", "[a](javascript:b)", "\x1b]0;title\x07", "`code", "``a``", "*a* **b** __c__ _d_ a_b",
    "&lt;b&gt; &#124; &amp", "~~a~~", "https://example.org www.example.org a@example.org", "\\", "a\\", "$x$",
    "a\r\n| b | c |\n", "\u202egnp.exe", "  a  ", "",
]  # fmt: skip
MARKDOWN = MarkdownIt("gfm-like", {"linkify": False})


def cells(name: str) -> list[str]:
    """The HTML of the cells in the row of a table that has a name in its second cell."""
    html = MARKDOWN.render(f"| a | b | c |\n|---|---|---|\n| 1 | {escape(name)} | 3 |\n\nafter\n")
    assert html.endswith("<p>after</p>\n")
    return re.findall(r"<td>(.*?)</td>", html, re.DOTALL)


def printable(name: str) -> str:
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in name).strip(" ")


@pytest.mark.parametrize("name", NASTY)
def test_a_name_is_one_cell_of_text(name: str) -> None:
    first, second, third = cells(name)
    assert (first, third) == ("1", "3")
    assert "<" not in second
    assert unescape(second) == printable(name)


@given(st.text(alphabet=st.sampled_from("ab \\|`*_[]()<>&!~$#-+.:/@^{}=\n\t\x1b\x00'\"1"), max_size=30))
def test_any_name_is_one_cell_of_text(name: str) -> None:
    assert unescape(cells(name)[1]) == printable(name)
    assert "<" not in cells(name)[1]


def test_usual_names_stay_as_they_are() -> None:
    usual = ["velodyne-vlp16", "traffic_sign", "car (parked)", "Straße", "truck+trailer", "Hesai XT32, 32 rings"]
    assert [escape(name) for name in usual] == usual


def test_no_address_becomes_a_link() -> None:
    """As GitHub makes them of bare addresses: each is broken by a backslash, which is not shown."""
    assert escape("see https://a.example, WWW.b.example or c@d.example") == (
        r"see https\://a.example, WWW\.b.example or c\@d.example"
    )


def test_a_long_name_is_cut() -> None:
    assert len(escape("x" * 10_000_000)) == 200


def test_the_card_of_a_data_set(tmp_path: Path) -> None:
    names = dict(enumerate(NASTY[:6], start=1))

    def scenes(rng: object, sequence: int) -> tuple[ls.Scene, ls.Lidar, None]:  # noqa: ARG001
        scene = ls.Scene(class_names={7: NASTY[6]})
        for label in range(1, 8):
            scene.add(ls.Box((0.1, 0.1, 4.0), (0.5 * label, 8.0, 0.0)), label=label)
        pattern = ls.patterns.Spinning([0.0], columns=3600)
        return scene, ls.Lidar(pattern, model="<b>m</b>|\n# n"), None

    ls.generate(scenes, tmp_path, class_names=names, pictures=0, layout="semantickitti")
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    html = MARKDOWN.render(text)
    assert html.count("<h1>") == 1
    assert html.count("<h2>") == 2
    assert not re.search(r"<(script|img|a|b|em)\b", html)
    rows = [re.findall(r"<td.*?>(.*?)</td>", row, re.DOTALL) for row in re.findall(r"<tr>(.*?)</tr>", html, re.DOTALL)]
    classes = {int(row[0]): unescape(row[1]) for row in rows if len(row) == 5}
    assert classes == {label: printable(name) for label, name in (names | {7: NASTY[6]}).items()}
    assert text.isascii() or "\x1b" not in text


def test_the_card_counts_the_boxes_of_the_data_set(tmp_path: Path) -> None:
    """As one who reads all frames does."""

    def scenes(rng: np.random.Generator, *_: object) -> tuple[ls.Scene, ls.Lidar, npt.NDArray[np.float64]]:
        scene = ls.Scene(class_names={1: "car", 2: "person"})
        scene.add(ls.Plane((0, 0, 1), -1.8), instance=0)
        for k, turn in enumerate(rng.uniform(0.0, 2 * np.pi, 12)):
            x, y = (4 + 5 * k) * np.array([np.cos(turn), np.sin(turn)])
            scene.add(ls.Box((4, 2, 1.5) if k % 2 else (0.5, 0.5, 1.8), center=(x, y, -0.9)), label=2 - k % 2)
        lidar = ls.Lidar(ls.patterns.Spinning(np.radians(np.linspace(-20, 5, 32)), columns=600))
        return scene, lidar, np.eye(4)

    ls.generate(scenes, tmp_path, sequences=3, frames=2, pictures=0, layout="openpcdet")
    boxes = [frame.boxes for frame in ls.datasets.load(tmp_path) if frame.boxes is not None]
    label, points, visibility = (
        np.concatenate([getattr(box, name) for box in boxes]) for name in ("label", "points", "visibility")
    )
    distance = np.linalg.norm(np.concatenate([box.center for box in boxes]), axis=1)
    text = (tmp_path / "README.md").read_text(encoding="utf-8").partition("## Boxes")[2]
    assert f"\n{len(label)} boxes" in text
    for number, name in ((1, "car"), (2, "person")):
        whole, *histograms = re.findall(rf"^\| {name} \| (.*) \|$", text, re.MULTILINE)
        of = label == number
        count, share, _, *means = whole.split(" | ")
        assert (int(count), share) == (of.sum(), f"{of.mean():.2%}")
        assert float(means[3]) == pytest.approx(distance[of].mean(), abs=0.051)
        assert float(means[4]) == pytest.approx(points[of].mean(), abs=0.051)
        for values, edges, told in zip(
            (distance, points, visibility), (RANGES, POINTS, VISIBILITY), histograms, strict=True
        ):
            counts = np.histogram(values[of], edges)[0].tolist()
            row = [int(part) for part in told.split(" | ")]
            assert "-".join(map(str, row)) in "-".join(map(str, counts))  # without empty bins at the ends
            assert sum(row) == sum(counts) == of.sum() > 10


def test_pictures_show_the_boxes_of_the_data_set_from_two_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def scenes(rng: object, sequence: int) -> tuple[ls.Scene, ls.Lidar, None]:  # noqa: ARG001
        scene = ls.Scene(class_names={1: "Car"})
        scene.add(ls.Box((4, 2, 1.5), (10, 0, 0)), label=1, instance=7)
        scene.add(ls.Box((4, 2, 1.5), (-10, 0, 0)), label=1, instance=8)  # behind: KITTI has no box of it
        return scene, ls.Lidar(ls.patterns.Spinning(np.radians([-2.0, 0.0, 2.0]), columns=1800)), None

    shown: list[dict[str, Any]] = []

    def show(scans: object, **options: Any) -> None:  # noqa: ARG001
        shown.append(options)
        Path(options["save"]).write_bytes(b"picture")

    monkeypatch.setattr(card, "show", show)
    for layout, places in {"kitti": [10.0], "nuscenes": [-10.0, 10.0], "semantickitti": None}.items():
        shown.clear()
        ls.generate(scenes, tmp_path / layout, pictures=1, layout=layout, seed=2)
        text = (tmp_path / layout / "README.md").read_text(encoding="utf-8")
        assert [options["camera"] for options in shown] == ["behind", "birds-eye"]
        assert manifest.pictures(open_store(tmp_path / layout)) == 1  # frames
        for options in shown:
            name = f"pictures/000000_000000_{options['camera']}.png"
            assert f"({name})" in text
            assert (tmp_path / layout / name).read_bytes() == b"picture"
            boxes = options["boxes"]
            assert places is None if boxes is None else sorted(boxes.center[:, 0].round(3).tolist()) == places


@pytest.mark.parametrize("edges", [RANGES, POINTS, VISIBILITY])
def test_boxes_are_counted_as_numpy_does(edges: tuple[float, ...]) -> None:
    ends = [edge for edge in edges if edge < np.inf]
    for value in [*ends, *np.nextafter(ends[1:], -np.inf), *np.nextafter(ends[:-1], np.inf)]:
        counts = np.zeros(len(edges) - 1, int)
        counts[_bin(value, edges)] += 1
        assert counts.tolist() == np.histogram(value, edges)[0].tolist()


def test_the_card_says_of_what_kinds_scattered_objects_are(tmp_path: Path) -> None:
    ls.generate("detection", tmp_path, sequences=1, frames=1, pictures=0)
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "| traffic | hatchback 4, saloon 2, estate 2, suv 2, van 2, lorry 2, bicycle 4 |" in text
    assert "| people | pedestrian |" in text
