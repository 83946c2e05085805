"""The pages name every shape, pattern, layout, effect and format, and the package loads each."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from lidarsim.cli import keys
from lidarsim.config import document, loader, objects, sensors
from lidarsim.config.schema import Config
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.datasets.recipe import Settings
from lidarsim.errors import ConfigError
from lidarsim.io import packets
from lidarsim.scan.formats import FORMATS

ROOT = Path(__file__).parents[1]
REFERENCE = (ROOT / "configs" / "REFERENCE.md").read_text(encoding="utf-8")
FILES = (ROOT / "lidarsim" / "io" / "README.md").read_text(encoding="utf-8")
MODELS = {**objects.SHAPES, **sensors.PATTERNS, **LAYOUTS, "measurement": sensors.Effects}


def rows(page: str) -> dict[str, str]:
    """The lines of the page's tables by what their first cells name."""
    found: dict[str, str] = {}
    for line in page.splitlines():
        if line.startswith("| "):
            found |= dict.fromkeys(re.findall(r"`([^`]+)`", line.split(" | ")[0]), line)
    return found


@pytest.mark.parametrize("name", MODELS)
def test_each_key_has_its_row(name: str) -> None:
    keys = MODELS[name].model_fields.keys() - {"shape", "type"}
    if name in objects.SHAPES:
        keys -= objects.Object.model_fields.keys()
    (section,) = re.findall(rf"^### {name}\n(.*?)(?=^##|\Z)", REFERENCE, re.DOTALL | re.MULTILINE)
    assert keys - rows(section).keys() == set()


def test_the_keys_of_all_sensors_have_rows() -> None:
    assert {*sensors.Sensor.keys()} - rows(keys.page("sensor")).keys() - rows(keys.page("file")).keys() == set()
    assert "[sensor](#sensor) or [file](#file)" in keys.page("rig")


def test_the_reference_is_what_the_command_prints() -> None:
    assert keys.page("all") == REFERENCE  # else: lidarsim check --keys all > configs/REFERENCE.md
    assert f"\n{keys.page('waypoint')}" in REFERENCE


def test_a_default_of_the_configuration_replaces_that_of_the_constructor() -> None:
    cells = rows(keys.page("strips"))["margin_m"].strip("| ").split(" | ")
    assert cells[2] == ""
    assert "Default: that of a frame." in cells[3]
    assert rows(keys.page("strips"))["turn_s"].split(" | ")[2] == "60"


def test_each_section_has_an_example_and_each_key_a_meaning() -> None:
    assert keys.EXAMPLES.keys() == keys.SECTIONS.keys()
    told, _, _ = REFERENCE.partition("### materials")
    assert [row for row in rows(told).values() if not row.split(" | ")[3].strip(" |")] == []


@pytest.mark.parametrize("name", keys.EXAMPLES)
def test_each_example_is_valid(name: str, tmp_path: Path) -> None:
    path = tmp_path / "example.yaml"
    path.write_text(keys.EXAMPLES[name], encoding="utf-8")
    node = document.read(path)
    model = objects.SHAPES["sphere"] if name == "object" else keys.SECTIONS[name].model
    loader.validate(model, loader.whole(node) if name == "run" else node)
    if len(found := document.entries(node)) > 1:  # a check that can fail
        wrong = document.replace(node, ["nothing"], next(iter(found.values()))[1])
        with pytest.raises(ConfigError, match="unknown key"):
            loader.validate(model, wrong)


def snippets() -> list[str]:
    """The pieces of YAML on the pages about configurations and tasks, each pose by itself."""
    texts = [page.read_text(encoding="utf-8") for page in sorted(ROOT.glob("*/*.md")) if page.name != "REFERENCE.md"]
    blocks = re.findall(r"^```yaml\n(.*?)^```$", "\n".join(texts), re.DOTALL | re.MULTILINE)
    return [part for block in blocks for part in re.split(r"^(?=pose:)", block, flags=re.MULTILINE) if part]


@pytest.mark.parametrize("text", snippets())
def test_the_yaml_of_the_pages_is_valid(text: str, tmp_path: Path) -> None:
    path = tmp_path / "snippet.yaml"
    path.write_text(f"scene:\n{text}" if text.startswith("-") else text, encoding="utf-8")
    node = document.read(path)
    found = document.entries(node)
    if "layout" in found:
        loader.validate(Settings, document.without(node, "run"))
        return
    for key, value in {"scene": "[]", "sensor": "{preset: ouster-os1-64}"}.items():
        if key not in found and not (key == "sensor" and "rig" in found):
            path.write_text(path.read_text(encoding="utf-8") + f"\n{key}: {value}\n", encoding="utf-8")
    loader.validate(Config, loader.whole(document.read(path)))


def test_there_are_snippets() -> None:
    assert len(snippets()) > 8


def test_each_format_has_its_row() -> None:
    named = {suffix for suffix in rows(FILES) if suffix.startswith(".")}
    assert FORMATS.keys() - named == set()


def test_each_variant_of_packets_has_its_row() -> None:
    table = FILES.partition("| models | variants |")[2].partition("\n\n")[0]
    named = {name for row in table.splitlines()[2:] for name in re.findall(r"`([^`]+)`", row.split(" | ")[1])}
    assert len(packets.variants()) > 5
    assert set(packets.variants()) - named == set()


@pytest.mark.parametrize("package", ["world/shapes", "patterns", "io", "io/packets", "io/vendors", "io/trajectories"])
def test_each_module_is_loaded_so_that_it_registers_itself(package: str) -> None:
    code = "import lidarsim, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    files = [file for file in (ROOT / "lidarsim" / package).glob("*.py") if not file.stem.startswith("_")]
    assert len(files) > 2
    assert {f"lidarsim.{package.replace('/', '.')}.{file.stem}" for file in files} - set(loaded) == set()
