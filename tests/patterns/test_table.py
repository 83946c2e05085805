from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarsim.errors import FileFormatError
from lidarsim.patterns import Table
from tests.patterns.families import TABLE


def test_list_is_cut_into_frames_by_its_times_and_starts_again() -> None:
    frames = [TABLE.pulses(frame) for frame in range(6)]
    for frame, pulses in enumerate(frames):
        assert len(pulses) == 10
        np.testing.assert_allclose(pulses.time, np.arange(10) / 100, atol=1e-15)
        index = np.arange(10) + 10 * (frame % 3)
        np.testing.assert_array_equal(pulses.directions, np.eye(3)[index % 3])
        np.testing.assert_array_equal(pulses.ring, index % 2)


def test_pulses_come_in_firing_order_whatever_the_order_of_the_list() -> None:
    pattern = Table(
        [[2, 0, 0], [0, 3, 0], [0, 0, 4]], times=[0.02, 0.01, 0.01], rings=[0, 1, 0], columns=[7, 8, 9], rate=10.0
    )
    pulses = pattern.pulses()
    np.testing.assert_array_equal(pulses.directions, [[0, 0, 1], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(pulses.ring, [0, 1, 0])
    np.testing.assert_array_equal(pulses.column, [9, 8, 7])
    assert pattern.shape == (2, 10)


@pytest.mark.parametrize("scale", [5e-324, 1e-200, 1e-150, 1e150, 1e200, 1e308])
def test_directions_may_be_of_any_length(scale: float) -> None:
    directions = Table([[scale, 0, 0], [scale, -scale, 0]], rate=1.0, rings=[0, 1]).pulses().directions
    np.testing.assert_allclose(directions, [[1, 0, 0], [np.sqrt(0.5), -np.sqrt(0.5), 0]], rtol=2e-16)


def test_list_may_be_long_and_sparse() -> None:
    pattern = Table([[1, 0, 0], [0, 1, 0]], times=[0.0, 1e9], rate=1000.0)
    assert pattern.shape == (1, 1)
    assert [len(pattern.pulses(frame)) for frame in (0, 1, 10**12, 10**12 + 1)] == [1, 0, 1, 1]


def test_columns_count_the_pulses_of_a_ring_by_default() -> None:
    pattern = Table(np.ones((5, 3)), times=np.arange(5) / 100, rings=[0, 2, 0, 0, 2], rate=10.0)
    np.testing.assert_array_equal(pattern.pulses().column, [0, 0, 1, 2, 1])
    assert pattern.shape == (3, 3)


def test_origins_may_be_one_for_all_or_one_each() -> None:
    one = Table(np.ones((2, 3)), rings=[0, 1], origins=(0.0, 0.0, 0.1), rate=1.0).pulses().origins
    np.testing.assert_array_equal(one, [[0.0, 0.0, 0.1]] * 2)
    each = Table(np.ones((2, 3)), rings=[1, 0], origins=[[1, 0, 0], [2, 0, 0]], rate=1.0).pulses().origins
    np.testing.assert_array_equal(each, [[2, 0, 0], [1, 0, 0]])


def test_frame_without_pulses_is_empty() -> None:
    pattern = Table([[1, 0, 0], [0, 1, 0]], times=[0.0, 0.25], rate=10.0)
    assert [len(pattern.pulses(frame)) for frame in range(4)] == [1, 0, 1, 1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"directions": np.empty((0, 3))}, "directions: expected at least one pulse, got none"),
        ({"directions": [[0, 0, 0]]}, "directions: expected non-zero vectors, got directions[0] = (0, 0, 0)"),
        ({"directions": [[1, np.nan, 0]]}, "directions: expected finite numbers, got directions[0][1] = nan"),
        (
            {"directions": [[1, 0]]},
            (
                "directions: expected shape (n, 3), got (1, 2); of azimuth a and elevation e: "
                "[cos e · cos a, cos e · sin a, sin e]"
            ),
        ),
        ({"times": [0.0, -1.0]}, "times: expected times >= 0, got times[1] = -1"),
        ({"times": [0.0]}, "times: expected shape (2,), got (1,)"),
        ({"rings": [0, 0.5]}, "rings: expected whole numbers from 0 to 65535, got rings[1] = 0.5"),
        ({"columns": [-1, 0]}, "columns: expected whole numbers from 0 to 4294967295, got columns[0] = -1"),
        ({"rate": 0}, "rate: expected a finite number > 0, got 0.0"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        Table(**{"directions": np.eye(3)[:2], "rate": 10.0, **arguments})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x,y,z\n1,0,0\n0,2,0\n", [[1, 0, 0], [0, 1, 0]]),
        ("\ufeffElevation_deg, Azimuth_deg\r\n0,90\r\n90,0\r\n", [[0, 1, 0], [0, 0, 1]]),
        ("azimuth_rad,elevation_rad\n0,0\n0,0.5\n", [[1, 0, 0], [np.cos(0.5), 0, np.sin(0.5)]]),
    ],
)
def test_csv_may_give_components_or_angles(tmp_path: Path, text: str, expected: list[list[float]]) -> None:
    path = tmp_path / "pattern.csv"
    path.write_bytes(text.encode())
    pulses = Table.from_file(path, rate=2.0, pulse_rate=10.0).pulses()
    np.testing.assert_allclose(pulses.directions, expected, atol=1e-16)
    np.testing.assert_allclose(pulses.time, [0.0, 0.1])


def test_csv_may_give_time_ring_and_column(tmp_path: Path) -> None:
    path = tmp_path / "pattern.csv"
    path.write_text("time_s,x,y,z,ring,column\n0.01,1,0,0,3,5\n0,0,1,0,4,6\n")
    pulses = Table.from_file(path, rate=2.0).pulses()
    np.testing.assert_array_equal(pulses.ring, [4, 3])
    np.testing.assert_array_equal(pulses.column, [6, 5])
    np.testing.assert_array_equal(pulses.time, [0.0, 0.01])


@pytest.mark.parametrize(
    "values", [np.array([[1, 0, 0], [0, 1, 0]], np.float32), np.array([[0.0, 0.0], [np.pi / 2, 0.0]])]
)
def test_npy_may_give_components_or_angles(tmp_path: Path, values: np.ndarray) -> None:
    path = tmp_path / "pattern.npy"
    np.save(path, values)
    np.testing.assert_allclose(Table.from_file(path, rate=1.0).pulses().directions, [[1, 0, 0], [0, 1, 0]], atol=1e-16)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", b"", "expected a .csv or .npy file"),
        ("a.csv", None, "cannot read the file: No such file or directory"),
        ("a.csv", b"", "expected a line of names and lines of numbers, got no numbers"),
        ("a.csv", b"x,y,z\n", "expected a line of names and lines of numbers, got no numbers"),
        (
            "a.csv",
            b"x,y\n1,0\n",
            "expected columns x, y, z or azimuth_deg, elevation_deg or azimuth_rad, elevation_rad, got others",
        ),
        ("a.csv", b"x,y,z,w\n1,0,0,0\n", "column 4: expected one of x, y, z, time_s, ring, column, got another"),
        ("a.csv", b"x,y,z\n1,0\n", "expected 2 different names in the first line, got 3"),
        ("a.csv", b"x,x,z\n1,0,0\n", "expected 3 different names in the first line, got 2"),
        ("a.csv", b"x,y,z\n1,0,nan\n", "z: expected finite numbers, got z[0] = nan"),
        (
            "a.csv",
            b"azimuth_deg,elevation_deg\n0,0\n1e999,0\n",
            "azimuth_deg: expected finite numbers, got azimuth_deg[1] = inf",
        ),
        ("a.csv", b"x,y,z,time_s\n1,0,0,0\n", "pulse_rate: expected none with the column time_s, got 10.0"),
        ("a.csv", b"x,y,z\n1,0,up\n", "line 2: expected numbers, got something else"),
        ("a.npy", b"\x93NUMPY", "not a readable .npy file: EOF: reading magic string, expected 8 bytes got 6"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, name: str, content: bytes | None, message: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: {message}')}$"):
        Table.from_file(path, rate=1.0, pulse_rate=10.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((2, 4)), "expected numbers of shape (n, 3) or (n, 2), got float64 of shape (2, 4)"),
        (np.array([["a", "b"]]), "expected numbers of shape (n, 3) or (n, 2), got <U1 of shape (1, 2)"),
        (
            np.array([[{}, {}]], object),
            "not a readable .npy file: Object arrays cannot be loaded when allow_pickle=False",
        ),
    ],
)
def test_bad_arrays_are_named(tmp_path: Path, values: np.ndarray, message: str) -> None:
    path = tmp_path / "a.npy"
    np.save(path, values, allow_pickle=True)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: {message}')}$"):
        Table.from_file(path, rate=1.0)
