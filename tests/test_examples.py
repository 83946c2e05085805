"""Every example runs as it stands, without a display and away from the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


def test_there_are_examples() -> None:
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path) -> None:
    headless = {**os.environ, "MPLBACKEND": "agg", "PYVISTA_OFF_SCREEN": "true"}
    result = subprocess.run(
        [sys.executable, path], cwd=tmp_path, env=headless, stderr=subprocess.PIPE, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
