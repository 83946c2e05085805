"""The script that writes the tables of the page on speed and accuracy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tables
from exact import accuracy, adversarial, cases

from lidarsim.bench import report

SECTIONS = """\
# Title

<!-- accuracy: begin, by hand -->
old
<!-- accuracy: end -->

Between.

<!-- speed: begin -->
old
<!-- speed: end -->

After.
"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    file = tmp_path / "lidarsim" / "bench" / "README.md"
    file.parent.mkdir(parents=True)
    file.write_text(SECTIONS, encoding="utf-8")
    return file


@pytest.fixture
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judge no more than it takes to see that the script does."""
    hard = cases.hard_cases()[:3]
    monkeypatch.setattr(cases, "hard_cases", lambda: hard)
    monkeypatch.setattr(cases, "OFFSETS", {"5e6": 5e6})


@pytest.mark.usefixtures("_few")
def test_the_tables_are_written(
    page: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    figures, drawn = page.with_name("speed.json"), []
    figures.write_text(json.dumps({"some": "figures"}), encoding="utf-8")
    monkeypatch.setattr(report, "overview", lambda results, pictures: f"{results['some']} ![]({pictures}speed.png)")
    for name in ("plot_speed", "plot_distance"):
        monkeypatch.setattr(report, name, lambda _, path: drawn.append(path))
    assert tables.main([str(figures)], page) == 0
    text, printed = page.read_text(encoding="utf-8"), capsys.readouterr().out
    assert text.startswith(
        f"# Title\n\n<!-- accuracy: begin, by hand -->\n{printed}\n<!-- accuracy: end -->\n\nBetween.\n\n"
    )
    assert text.endswith(
        "<!-- speed: begin -->\nfigures ![](../../examples/images/speed.png)\n<!-- speed: end -->\n\nAfter.\n"
    )
    assert "| plane, grazing" in printed
    images = page.parents[2] / "examples" / "images"
    assert drawn == [images / "speed.png", images / "distance.png"]


@pytest.mark.usefixtures("_few")
def test_without_figures_the_section_on_speed_stays(page: Path) -> None:
    assert tables.main([], page) == 0
    assert page.read_text(encoding="utf-8").endswith(SECTIONS.partition("Between.")[2])


@pytest.mark.usefixtures("_few")
def test_the_script_fails_if_lidarsim_errs(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(accuracy.ENGINES, "lidarsim", lambda _, origins, __: np.ones(len(origins)))
    assert tables.main([], page) == 1


def test_random_rays_are_judged_and_nothing_is_written(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tables.main(["--random", "80"], page) == 0
    assert f"TriangleMesh: {80 // len(adversarial.KINDS)} rays" in capsys.readouterr().out
    assert page.read_text(encoding="utf-8") == SECTIONS


def test_a_page_without_the_section_is_left_alone(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text("# Title\n", encoding="utf-8")
    with pytest.raises(ValueError) as raised:  # noqa: PT011 - the message is compared whole
        tables.replace_section(page, "speed", "text")
    assert str(raised.value) == f"{page}: expected a section between the comments 'speed: begin' and 'speed: end'"
    assert page.read_text(encoding="utf-8") == "# Title\n"


def test_the_page_has_its_sections(tmp_path: Path) -> None:
    copy = tmp_path / "README.md"
    copy.write_text(tables.PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    for name in ("accuracy", "speed"):
        tables.replace_section(copy, name, f"new {name}")
    assert [f"new {name}" in copy.read_text(encoding="utf-8") for name in ("accuracy", "speed")] == [True, True]
