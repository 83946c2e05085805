"""Presets are as near to captures of real sensors as their page says."""

from __future__ import annotations

import contextlib
import io
import math
import runpy
from dataclasses import dataclass
from pathlib import Path

import pictures
import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "lidarsim" / "presets" / "README.md"

Figures = list[tuple[dict[str, str], float, float, float]]


pytestmark = pytest.mark.slow("the example about reality finds what its page says, within the spread of real units")


@dataclass(frozen=True)
class Run:
    """What the example prints, draws and finds: row of the captures, real, simulated as measured, as the data sheet."""

    printed: str
    picture: Path
    figures: Figures

    def of(self, quantity: str) -> Figures:
        """Return the figures of a quantity."""
        return [figure for figure in self.figures if figure[0]["quantity"] == quantity]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    printed, place = io.StringIO(), tmp_path_factory.mktemp("reality")
    with contextlib.chdir(place), contextlib.redirect_stdout(printed):
        names = runpy.run_path(str(ROOT / "examples" / "reality.py"), run_name="__main__")
    return Run(printed.getvalue(), place / "reality.png", names["results"])


def test_page_has_the_table_of_the_example(run: Run) -> None:
    _, _, rest = PAGE.read_text(encoding="utf-8").partition("<!-- reality: begin, written by examples/reality.py -->\n")
    table, end, _ = rest.partition("<!-- reality: end -->")
    assert end
    assert table == run.printed
    assert pictures.is_as_shown(run.picture, ROOT / "examples" / "images" / "reality.png")


def test_noise_is_within_the_spread_of_units(run: Run) -> None:
    """Units of one model differ by more than 30 %; the figures farther off are those that the page names."""
    figures = run.of("noise")
    off = {(row["preset"], row["x"], real) for row, real, measured, _ in figures if abs(measured / real - 1.0) > 0.3}
    assert off == {
        ("hesai-pandar64", "6.5", 3.42),
        ("velodyne-vlp32c", "6.5", 12.01),
        ("ouster-os0-128", "10", 3.53),
        ("ouster-os2-128", "10", 15.41),
    }
    sheets = [abs(math.log(sheet / real)) > math.log(1.3) for _, real, _, sheet in figures]
    assert sum(sheets) > 5 * len(off)
    assert len(figures) == 25


def test_roads_return_as_many_pulses(run: Run) -> None:
    """A share of 4000 pulses is right to 0.03 (four sigma); the rest is what the fitted parameters leave."""
    off = [(row["preset"], row["x"]) for row, real, measured, _ in run.of("road") if abs(measured - real) > 0.15]
    assert off == []
    error = [sum(abs(figure[i] - figure[1]) for figure in run.of("road")) for i in (2, 3)]
    assert error[1] > 3.0 * error[0]
    assert len(run.of("road")) == 25


def test_edges_have_as_many_dual_returns(run: Run) -> None:
    figures = run.of("dual returns")
    assert len(figures) == 7
    assert [row["preset"] for row, real, measured, _ in figures if abs(measured - real) > 0.09] == []
    assert {sheet for *_, sheet in figures} == {0.0}  # they have no beam


def test_edges_lose_as_many_pulses(run: Run) -> None:
    """Of the sensor that is off, pulses are lost on one side, and none is simulated there."""
    figures = run.of("lost returns")
    assert len(figures) == 5
    off = [row["preset"] for row, real, measured, _ in figures if abs(measured - real) > 0.06]
    assert off == ["hesai-pandar64"]
    assert {sheet for *_, sheet in figures} == {0.0}


def test_small_edges_have_as_many_mixed_points(run: Run) -> None:
    figures = run.of("mixed points")
    assert len(figures) == 7
    assert [row["preset"] for row, real, measured, _ in figures if abs(measured - real) > 0.15] == []
    assert {sheet for *_, sheet in figures} == {0.0}


def test_smooth_surfaces_have_as_many_holes(run: Run) -> None:
    """Within a factor of 3; of 16,384 pulses, 3 or more are lost."""
    figures = run.of("holes")
    assert all(1.0 / 3.0 < measured / real < 3.0 for _, real, measured, _ in figures)
    assert len(figures) == 12
