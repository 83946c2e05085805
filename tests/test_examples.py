"""Every example runs unmodified, without a display and outside the checkout."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pictures
import pytest
from PIL import Image

from lidarsim.cli import main

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
IMAGES = Path(__file__).parents[1] / "examples" / "images"
GUIDE = (IMAGES.parent / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```bash\n(.*?)^```$", GUIDE, re.DOTALL | re.MULTILINE)
COMMANDS = [line for block in BLOCKS for line in block.splitlines()]


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
        draws_what_the_guide_shows(tmp_path / image.name, image)


def draws_what_the_guide_shows(picture: Path, image: Path) -> None:
    with Image.open(picture) as drawn, Image.open(image) as shown:
        assert drawn.width / drawn.height == pytest.approx(shown.width / shown.height, rel=0.01)
        assert len(drawn.convert("RGB").getcolors(2**24) or []) > 16  # it is not blank
    if image.stem == "street":
        # 128 colours have none for the axes of the sensor, which move a block by 18 of 255.
        assert pictures.difference(picture, image) < 25
        assert pictures.difference(picture, image.with_name("snippet.png")) > 100  # another picture fails


def test_the_guide_shows_every_example() -> None:
    for path in EXAMPLES:
        assert f"[`{path.name}`]({path.name})" in GUIDE
        assert f"python examples/{path.name}" in COMMANDS
    assert GUIDE.count("](images/") == len(EXAMPLES) - 3  # data loaders, clusters and nodes have nothing to show


@pytest.mark.parametrize("command", [command for command in COMMANDS if not command.startswith("python ")])
def test_every_command_of_the_guide_runs(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    program, *words = shlex.split(command)
    assert program == "lidarsim"
    with pytest.raises(SystemExit) as left:
        main(words)
    assert not left.value.code
    assert all(Path(file).exists() for option, file in pairwise(words) if option in {"--output", "--screenshot"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the configurations, in which the commands run one after another."""
    place = tmp_path_factory.mktemp("guide")
    shutil.copytree(EXAMPLES[0].parents[1] / "configs", place / "configs")
    return place
