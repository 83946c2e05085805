"""Degrees where radians are meant: an error that asks, in every pattern."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lidarsim.errors import FileFormatError
from lidarsim.patterns import Grid, OscillatingMirror, Palmer, PolygonMirror, Prism, Spinning, Table

LINE = {"sweep": 1.5, "field_of_view": 1.0, "line_rate": 10.0, "pulse_rate": 1e3, "rate": 1.0}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Spinning([1, 15]), "elevations: expected numbers from -1.5708 to 1.5708, got elevations[1] = 15"),
        (lambda: Spinning([-90]), "elevations: expected numbers from -1.5708 to 1.5708, got elevations[0] = -90"),
        (
            lambda: Spinning([0], azimuth_offsets=10),
            "azimuth_offsets: expected numbers from -6.28319 to 6.28319, got azimuth_offsets[0] = 10",
        ),
        (
            lambda: Spinning([0], field_of_view=360),
            "field_of_view: expected a finite number > 0 and <= 6.28319, got 360.0",
        ),
        (
            lambda: Spinning([0], start_azimuth=-180),
            "start_azimuth: expected a finite number from -6.28319 to 6.28319, got -180.0",
        ),
        (
            lambda: Grid([0, 45], [0], rate=10),
            "azimuths: expected numbers from -6.28319 to 6.28319, got azimuths[1] = 45",
        ),
        (
            lambda: Grid([0], [12], rate=10),
            "elevations: expected numbers from -1.5708 to 1.5708, got elevations[0] = 12",
        ),
        (
            lambda: PolygonMirror([5], **LINE),
            "elevations: expected numbers from -1.5708 to 1.5708, got elevations[0] = 5",
        ),
        (
            lambda: PolygonMirror(**{**LINE, "sweep": 90}),
            "sweep: expected a finite number > 0 and <= 12.5664, got 90.0",
        ),
        (
            lambda: PolygonMirror(azimuth_offsets=20, **LINE),
            "azimuth_offsets: expected numbers from -6.28319 to 6.28319, got azimuth_offsets[0] = 20",
        ),
        (
            lambda: OscillatingMirror(field_of_view=60, scan_rate=1, pulse_rate=100, rate=1),
            "field_of_view: expected a finite number > 0 and <= 6.28319, got 60.0",
        ),
        (
            lambda: Palmer(half_angle=20, scan_rate=1, pulse_rate=100, rate=1),
            "half_angle: expected a finite number > 0 and <= 3.14159, got 20.0",
        ),
        (lambda: Prism(100, exit_tilt=18), "exit_tilt: expected a finite number from -1.5708 to 1.5708, got 18.0"),
        (lambda: Prism(100, phase=90), "phase: expected a finite number from -6.28319 to 6.28319, got 90.0"),
    ],
)
def test_degrees_are_asked_after(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}; degrees\\?$"):
        make()


def test_the_bounds_themselves_are_angles() -> None:
    assert Spinning([math.pi / 2, -math.pi / 2], azimuth_offsets=2 * math.pi, field_of_view=2 * math.pi).shape[0] == 2
    assert Spinning(np.radians([90, -90]), start_azimuth=np.radians(360)).shape[0] == 2


@pytest.mark.parametrize("column", ["azimuth", "elevation"])
def test_files_in_radians(column: str, tmp_path: Path) -> None:
    values = {"azimuth": [0.1, 0.2], "elevation": [0.0, 0.1], column: [0.1, 45.0]}
    table = np.column_stack([values["azimuth"], values["elevation"]])
    np.save(tmp_path / "table.npy", table)
    with pytest.raises(FileFormatError, match=rf"table.npy: {column}_rad: expected .* = 45; degrees\?$"):
        Table.from_file(tmp_path / "table.npy", rate=10.0)
