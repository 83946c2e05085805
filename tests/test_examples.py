"""Every example runs unmodified, without a display and outside the checkout."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
IMAGES = Path(__file__).parents[1] / "examples" / "images"


def test_there_are_examples() -> None:
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setattr(sys, "argv", [str(path)])
    if "__main__" in path.read_text(encoding="utf-8"):  # its workers may import it
        subprocess.run([sys.executable, path], check=True)
    else:
        runpy.run_path(str(path), run_name="__main__")
    shown_as = [file for file in IMAGES.iterdir() if file.stem == path.stem]
    for image in shown_as:
        draws_what_the_gallery_shows(tmp_path / image.name, image)


def draws_what_the_gallery_shows(picture: Path, image: Path) -> None:
    with Image.open(picture) as drawn, Image.open(image) as shown:
        assert drawn.width / drawn.height == pytest.approx(shown.width / shown.height, rel=0.01)
        assert len(drawn.convert("RGB").getcolors(2**24) or []) > 16  # it is not blank


def test_the_gallery_shows_every_example() -> None:
    gallery = (IMAGES.parent / "README.md").read_text(encoding="utf-8")
    for path in EXAMPLES:
        assert f"[`{path.name}`]({path.name})" in gallery
    assert gallery.count("](images/") == len(EXAMPLES) - 2  # a loader of training data and a node have nothing to show
    assert [name for name in re.findall(r"\]\(([^)]+)\)", gallery) if not (IMAGES.parent / name).exists()] == []
