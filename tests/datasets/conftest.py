"""A small recipe, and what a data set holds."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

import lidarsim as ls

RECIPE = """\
sequences: 3
frames: 4
seed: 7
shard_frames: 5
layout: semantickitti
class_names: {"40": road}
vary:
  scene.1.radius_m: {uniform: [1, 2]}
  scene.1.label: {choice: [10, 30], weights: [1, 3]}
  sensor.measurement.range_sigma_m: {log_uniform: [0.001, 0.1], per: frame}
run:
  sensor:
    pattern: {type: grid, azimuths_deg: [-20, -10, 0, 10, 20], elevations_deg: [-20, -5, 0, 5], rate_hz: 10}
  pose: {position_m: [0, 0, 1.5], linear_m_per_s: [3, 0, 0]}
  scene:
    - {shape: plane, normal: [0, 0, 1], label: 40}
    - {shape: sphere, center_m: [12, 0, 1], radius_m: 1}
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "recipe.yaml"
    path.write_text(RECIPE)
    return path


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file by its name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="session")
def tree() -> Callable[[Path], dict[str, str]]:
    return hashes


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recipe, for tests that leave it as it is."""
    path = tmp_path_factory.mktemp("shared") / "recipe.yaml"
    path.write_text(RECIPE)
    return path


@pytest.fixture(scope="session")
def whole(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What one process makes of the recipe in one go."""
    out = tmp_path_factory.mktemp("whole")
    ls.generate(shared, out, pictures=0)
    return hashes(out)
