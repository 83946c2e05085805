"""Every example runs unmodified, without a display and outside the checkout.

`reality.py` is run by ``presets/test_reality.py``, which also holds what it finds.
"""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pictures
import pytest
from PIL import Image

import lidarsim as ls
from lidarsim.cli import main

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
IMAGES = ROOT / "examples" / "images"
INDEX, *PAGES = sorted((ROOT / "examples").glob("*.md"))
TEXTS = {page.stem: page.read_text(encoding="utf-8") for page in PAGES}
SMALL = {"generate": ["--set", "sequences=1", "--set", "frames=1", "--pictures", "0"]}
"""Options that commands of pages get, so that they take seconds."""


def test_there_are_examples() -> None:
    assert EXAMPLES
    assert INDEX.name == "README.md"
    assert len(PAGES) > 10


@pytest.mark.slow("every example, command and code block of a page, and the notebook, runs as it stands")
@pytest.mark.parametrize("path", [path for path in EXAMPLES if path.stem != "reality"], ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setattr(sys, "argv", [str(path)])
    if "__main__" in path.read_text(encoding="utf-8"):  # its workers may import it
        subprocess.run([sys.executable, path], check=True)
    else:
        runpy.run_path(str(path), run_name="__main__")
    shown_as = [file for file in IMAGES.iterdir() if file.stem.partition("-")[0] == path.stem]
    for image in shown_as:
        draws_what_the_page_shows(tmp_path / image.name, image)


def draws_what_the_page_shows(picture: Path, image: Path) -> None:
    assert pictures.is_as_shown(picture, image)
    if image.stem == "street":
        assert pictures.difference(picture, image) < 25
        assert pictures.difference(picture, image.with_name("snippet.png")) > 100  # another picture fails


def test_a_reduced_picture_keeps_the_colours_of_its_legend(tmp_path: Path) -> None:
    """A patch of 8 × 8 pixels among a million of other colours, such as points of other classes, dark and bright."""
    draw = np.random.default_rng(1)
    classes = np.array([(255, 200, 0), (255, 0, 255), (0, 175, 0), (100, 150, 245), (135, 60, 0), (75, 0, 75)])
    points = classes[draw.integers(6, size=(800, 1400))] * draw.random((800, 1400, 1))
    pixels = np.clip(points + draw.normal(0, 12, points.shape), 0, 255).astype(np.uint8) // 8 * 8
    pixels[20:28, 600:608] = cyan = 50, 255, 255
    Image.fromarray(pixels).save(tmp_path / "drawn.png")
    pictures.reduce(tmp_path / "drawn.png", tmp_path / "shown.png")
    with Image.open(tmp_path / "shown.png") as shown:
        assert shown.mode == "P"  # at most 256 colours
        assert (np.asarray(shown.convert("RGB"))[20:28, 600:608] == cyan).all()


def test_a_page_shows_draws_of_each_generator_of_worlds() -> None:
    page = (ROOT / "lidarsim" / "worlds" / "README.md").read_text(encoding="utf-8")
    shown = {f"worlds-{name}.png" for name in (*ls.worlds.GENERATORS, "street")}
    assert set(re.findall(r"\]\(../../examples/images/([^)]+)\)", page)) == shown
    assert all((IMAGES / name).stat().st_size < 250_000 for name in shown)


def test_the_pages_show_every_example_and_picture() -> None:
    everything = "".join(TEXTS.values())
    for path in EXAMPLES:
        assert f"[`{path.name}`]({path.name})" in everything
        assert re.search(rf"^python examples/{path.name}$", everything, re.MULTILINE)
    others = [ROOT / "README.md", *(ROOT / "lidarsim" / name / "README.md" for name in ("presets", "worlds"))]
    shown = everything + "".join(page.read_text(encoding="utf-8") for page in others)
    assert [image.name for image in IMAGES.iterdir() if f"images/{image.name})" not in shown] == []


@pytest.mark.parametrize("name", TEXTS)
def test_a_page_is_in_the_index_and_has_the_parts_of_one(name: str) -> None:
    assert f"]({name}.md) |" in INDEX.read_text(encoding="utf-8")
    headings = re.findall(r"^## (.*)$", TEXTS[name], re.MULTILINE)
    assert {"Three things people change", "Limits"} <= set(headings)
    assert "](images/" in TEXTS[name]
    assert len(TEXTS[name].split()) < 550


@pytest.mark.slow("every example, command and code block of a page, and the notebook, runs as it stands")
@pytest.mark.parametrize("name", TEXTS)
def test_the_commands_and_code_of_a_page_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One after another, in a folder with the configurations; scripts have tests of their own."""
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, Any] = {}
    blocks = re.findall(r"^```(bash|python)\n(.*?)^```$", TEXTS[name], re.DOTALL | re.MULTILINE)
    assert blocks
    for language, block in blocks:
        if language == "python":
            exec(compile(block, f"{name}.md", "exec"), names)  # noqa: S102 - of our own pages
            continue
        for program, *words in map(shlex.split, block.splitlines()):
            if program == "python":
                assert (ROOT / words[0]) in EXAMPLES
                continue
            assert program == "lidarsim"
            with pytest.raises(SystemExit) as left:
                main([*words, *SMALL.get(words[0], []), *(["--workers", "1"] if "--workers" in words else [])])
            assert not left.value.code, words
            wanted = [file for option, file in pairwise(words) if option in {"--output", "--screenshot", "--html"}]
            for file in map(Path, wanted):
                assert file.exists() or list(tmp_path.glob(f"{file.stem}_*{file.suffix}")), words  # one a frame


@pytest.mark.slow("every example, command and code block of a page, and the notebook, runs as it stands")
def test_the_notebook_shows_what_it_makes(tmp_path: Path) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    notebook = nbformat.read(ROOT / "examples" / "notebook.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # pages are large
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    results = [output["data"] for cell in cells for output in cell.outputs if output.output_type == "execute_result"]
    shown = [data.get("text/html", data["text/plain"]) for data in results]
    expected = ["<caption>Scene: ", "Scan of ", "PointCloud: ", "<iframe", "Boxes of ", "range noise", "'xyz'"]
    for text, start in zip(shown, expected, strict=True):
        assert start in text
    assert (tmp_path / "scan.pcd").exists()


@pytest.fixture(scope="module")
def learn() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "examples" / "learn.py"))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of the packaged recipe for segmentation."""
    place = tmp_path_factory.mktemp("learn") / "simulated"
    ls.generate("segmentation", place, sequences=1, frames=2, seed=1, pictures=0)
    return place


def test_learn_sees_real_frames_as_simulated_ones(learn: dict[str, Any], simulated: Path) -> None:
    loaded, (read, *_) = ls.datasets.load(simulated), learn["real"](simulated / "sequences" / "00")
    channels, classes = learn["image"](loaded[0])
    for of, expected in zip(learn["image"](read), (channels, classes), strict=True):
        np.testing.assert_array_equal(of, expected)
    seen = channels[0] > 0
    assert 0.5 < seen.mean() < 1.0
    assert (classes[~seen] == learn["OTHER"]).all()
    assert {0, 2, 4} <= set(np.unique(classes[seen]).tolist())  # cars, ground, plants
    ground = channels[1][classes == 2]
    assert np.median(ground) == pytest.approx(-1.73, abs=0.2)  # the height of the sensor


def test_learn_varies_frames_and_keeps_their_classes(learn: dict[str, Any], simulated: Path) -> None:
    channels, classes = learn["image"](ls.datasets.load(simulated)[0])
    rng = np.random.default_rng(1)
    for _ in range(5):
        changed, known = learn["augment"](rng, channels, classes)
        seen = changed[0] > 0
        assert 0.2 < seen.mean() < (channels[0] > 0).mean()
        assert (known[~seen] == learn["OTHER"]).all()
        assert np.median(changed[1][known == 2]) == pytest.approx(np.median(channels[1][classes == 2]), abs=0.6)


def test_learn_trains_and_counts(learn: dict[str, Any], simulated: Path) -> None:
    torch = pytest.importorskip("torch")
    frames = list(ls.datasets.load(simulated))
    net, again = (learn["train"]([frames, frames[:1]], 3, 1) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(net.state_dict().values(), again.state_dict().values(), strict=True))
    count = learn["confusion"](net, frames)
    known = [classes[classes != learn["OTHER"]] for _, classes in map(learn["image"], frames)]
    np.testing.assert_array_equal(count.sum(1), np.bincount(np.concatenate(known), minlength=5))


def test_learn_asks_for_rare_classes_as_for_others(learn: dict[str, Any]) -> None:
    """The loss of sure scores is the entropy of the wrong ones, 20 each, and 1 less the mean IoU of what is there."""
    torch = pytest.importorskip("torch")
    classes = torch.full((1, 2, 50), 2)
    classes[0, 0, 0], classes[0, 1, :10] = 1, learn["OTHER"]
    found = torch.full((1, 2, 50), 2)  # the rare one is missed, and one of 89 others is taken for a car
    found[0, 0, 1] = 0
    scores = 20.0 * torch.nn.functional.one_hot(found, 5).movedim(-1, 1)
    expected = 20.0 * 2 / 90 + 1 - (0 + 88 / 90) / 2
    assert learn["loss_of"](scores, classes).item() == pytest.approx(expected, abs=1e-4)


def test_learn_finds_classes_where_they_are(learn: dict[str, Any]) -> None:
    """A network that tells pixels with points from those without is right in every view."""
    torch = pytest.importorskip("torch")

    def net(images: Any) -> Any:
        return torch.nn.functional.one_hot(images[:, 4].long(), 5).movedim(-1, 1).float()

    channels = np.random.default_rng(1).integers(0, 2, (3, 64, 1024)).astype(np.float32)
    np.testing.assert_array_equal(learn["classify"](net, channels), channels[0])


def test_learn_reports_intersection_over_union(learn: dict[str, Any]) -> None:
    count = np.diag([6, 0, 4, 2, 0])
    count[0, 2] = 2
    first, _, car, person, ground, *_ = learn["report"](count).splitlines()
    assert car.split()[1:5] == ["0.750", "0.750", "0.000", "0.250"]
    assert (person.split()[1], ground.split()[1]) == ("nan", "0.667")
    assert first == f"mean IoU {(6 / 8 + 4 / 6 + 1) / 3:.3f}"
