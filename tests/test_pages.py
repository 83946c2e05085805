"""The pages name every shape, pattern, layout, effect and format, and the package loads each."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from lidarsim.config import objects, sensors
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.scan.formats import FORMATS
from lidarsim.sensor.measurement import Measurement

ROOT = Path(__file__).parents[1]
CONFIGS = (ROOT / "configs" / "README.md").read_text(encoding="utf-8")
FILES = (ROOT / "lidarsim" / "io" / "README.md").read_text(encoding="utf-8")


def rows(page: str) -> dict[str, str]:
    """The lines of the page's tables by what their first cells name."""
    found: dict[str, str] = {}
    for line in page.splitlines():
        if line.startswith("| "):
            found |= dict.fromkeys(re.findall(r"`([^`]+)`", line.split(" | ")[0]), line)
    return found


def missing(keys: set[str], row: str) -> set[str]:
    """Keys that a row does not name."""
    return {key for key in keys if not re.search(rf"\b{re.escape(key)}\b", row)}


@pytest.mark.parametrize("name", objects.SHAPES)
def test_each_shape_has_its_row(name: str) -> None:
    assert (
        missing(
            objects.SHAPES[name].model_fields.keys() - objects.Object.model_fields.keys() - {"shape"},
            rows(CONFIGS)[name],
        )
        == set()
    )


@pytest.mark.parametrize("name", sensors.PATTERNS)
def test_each_pattern_has_its_row(name: str) -> None:
    assert missing(sensors.PATTERNS[name].model_fields.keys() - {"type"}, rows(CONFIGS)[name]) == set()


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_layout_has_its_row(name: str) -> None:
    assert missing(LAYOUTS[name].model_fields.keys() - {"type"}, rows(CONFIGS)[name]) == set()


def test_each_effect_is_named() -> None:
    assert missing(set(Measurement.configuration), rows(CONFIGS)["measurement"]) == set()


def test_each_format_has_its_row() -> None:
    named = {suffix for suffix in rows(FILES) if suffix.startswith(".")}
    assert FORMATS.keys() - named == set()


@pytest.mark.parametrize("package", ["world/shapes", "patterns", "io", "io/vendors", "io/trajectories"])
def test_each_module_is_loaded_so_that_it_registers_itself(package: str) -> None:
    code = "import lidarsim, sys; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    files = [file for file in (ROOT / "lidarsim" / package).glob("*.py") if not file.stem.startswith("_")]
    assert len(files) > 2
    assert {f"lidarsim.{package.replace('/', '.')}.{file.stem}" for file in files} - set(loaded) == set()
