"""Images of patterns: straight up, left to right, no pulse lost."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import lidarsim as ls
from lidarsim.patterns import Grid, PolygonMirror, Pulses, Spinning, Table
from lidarsim.patterns.raster import projection, rows_and_columns

WITHOUT = {"leica-als50", "riegl-vq780i", "riegl-vq880g"} | {
    name for name in ls.Lidar.presets() if name.startswith("livox")
}


def angles_of(pulses: Pulses) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return azimuths and elevations in an image, nan where there is no pulse."""
    row, column, shape = rows_and_columns(pulses, pulses)
    x, y, z = pulses.directions.T
    image = np.full((*shape, 2), np.nan)
    image[row, column] = np.column_stack([np.arctan2(y, x), np.arcsin(np.clip(z, -1.0, 1.0))])
    assert np.isfinite(image[..., 0]).sum() == len(pulses)  # each has a pixel of its own
    return image[..., 0], image[..., 1]


@pytest.mark.parametrize("frame", [0, 3])
@pytest.mark.parametrize("name", [name for name in ls.Lidar.presets() if name not in WITHOUT])
def test_presets_stand_upright(name: str, frame: int) -> None:
    pattern = ls.Lidar.preset(name).pattern
    azimuth, elevation = angles_of(pattern.pulses(frame))
    height = np.nanmean(elevation, axis=1)
    assert len(height) == pattern.shape[0]
    seen = ~np.isnan(azimuth).all(axis=0)
    assert (~seen).sum() <= 1  # the last part of a turn that is no whole number of columns, where no cycle starts in it
    assert (azimuth.shape[1], seen.sum()) >= (pattern.shape[1], pattern.shape[1] - 1)
    assert (np.diff(height) <= 1e-12).all()  # the top ring first; sines and cosines are right to some 2⁻⁵³
    right = -np.diff(np.unwrap(azimuth[:, ~np.isnan(azimuth).any(axis=0)], axis=1), axis=1)
    step = np.median(right)
    assert (right > 0.0).all()
    # In a column all look the same way: half a column to either side of its middle, and, of a turn that is no whole
    # number of columns, less than another one where a ring has gone round.
    whole = abs(2 * np.pi / step - round(2 * np.pi / step)) < 1e-6
    within = azimuth[:, seen] - np.nanmedian(azimuth[:, seen], axis=0)
    within = (within + np.pi) % (2 * np.pi) - np.pi
    assert np.nanmax(np.abs(within)) <= (1.0 if whole else 2.0) * step * (1 + 1e-6)
    assert np.nanmedian(np.abs(within)) <= 0.5 * step * (1 + 1e-6)
    if azimuth.shape[1] * step > 6.28:
        forward = np.nanmedian(azimuth[:, azimuth.shape[1] // 2])
        assert abs(forward) <= 1.5 * step


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("start", [None, 0.0, 1.0, -3.0])
def test_where_a_turn_starts_and_which_way_it_goes_changes_nothing(clockwise: bool, start: float | None) -> None:
    pattern = Spinning(
        [0.1, -0.1, 0.0],
        azimuth_offsets=np.radians([3.0, -3.0, 0.5]),
        columns=360,
        clockwise=clockwise,
        start_azimuth=start,
    )
    azimuth, elevation = angles_of(pattern.pulses())
    assert azimuth.shape == (3, 360)
    assert elevation[:, 0].round(9).tolist() == [0.1, 0.0, -0.1]
    expected = np.radians(180.0 - np.arange(360))
    away = (azimuth - expected + np.pi) % (2 * np.pi) - np.pi
    # Half a column for the pixel, and a rounding where it is just that.
    assert np.abs(away).max() <= np.radians(0.5) + 1e-6


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("columns", [360, 1024, 4096])
def test_half_a_column_goes_one_way_in_all_rings(dtype: type, columns: int) -> None:
    offsets = np.tile([0.5, 3.5], 32) * 2 * np.pi / columns
    given = Spinning(np.linspace(0.3, -0.3, 64), azimuth_offsets=offsets, columns=columns).pulses()
    directions = given.directions.astype(dtype)
    azimuth, _ = angles_of(Pulses(directions, given.origins, given.time, given.ring, given.column))
    assert azimuth.shape == (64, columns)
    assert np.abs(np.exp(1j * azimuth) - np.exp(1j * azimuth[0])).max() < 16 * np.finfo(dtype).eps  # of up to 2π each


def test_a_grid_is_as_it_is() -> None:
    azimuths, elevations = np.radians([-20, -3, 5, 40]), np.radians([-10, 0, 20])
    for across in (azimuths, azimuths[::-1]):
        azimuth, elevation = angles_of(Grid(across, elevations, rate=10.0).pulses())
        assert np.allclose(azimuth, np.tile(azimuths[::-1], (3, 1)))
        assert np.allclose(elevation, np.tile(elevations[::-1, None], (1, 4)))


def test_offsets_of_a_field_of_view_widen_the_image() -> None:
    pattern = PolygonMirror(
        [0.1, 0.0],
        sweep=2.0,
        field_of_view=1.0,
        line_rate=10.0,
        pulse_rate=2000.0,
        rate=10.0,
        azimuth_offsets=[0.0, 0.05],
    )
    azimuth, _ = angles_of(pattern.pulses())
    assert azimuth.shape == (2, 105)
    assert np.isnan(azimuth).sum() == 10
    assert np.isnan(azimuth[0, :5]).all()
    assert np.nanmax(np.abs(azimuth[0] - azimuth[1])) < 1e-9


def test_firing_times_that_alternate_from_column_to_column_leave_no_empty_column() -> None:
    columns, step = np.arange(1800), 2 * np.pi / 1800
    for late in (-0.45, 0.45):  # of a column
        azimuths = np.pi - step * (columns + late * (columns % 2))
        directions = np.column_stack([np.cos(azimuths), np.sin(azimuths), np.zeros(1800)])
        azimuth, _ = angles_of(Table(directions, columns=columns, rate=10.0).pulses())
        assert azimuth.shape == (1, 1800)


@pytest.mark.parametrize("apart", [0.011, 0.009])
def test_rings_may_wander_within_bands_of_their_own(apart: float) -> None:
    azimuths = np.linspace(0.5, -0.5, 101)
    wander = 0.005 * np.sin(20 * azimuths)  # 0.01 rad from its lowest to its highest
    tilt = np.concatenate([wander, wander + apart])
    turn = np.tile(azimuths, 2)
    directions = np.column_stack([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    pattern = Table(directions, rings=np.repeat([0, 1], 101), columns=np.tile(np.arange(101), 2), rate=10.0)
    if apart < 0.01:
        with pytest.raises(ValueError, match=r"^size: "):
            angles_of(pattern.pulses())
        return
    azimuth, elevation = angles_of(pattern.pulses())
    assert azimuth.shape == (2, 101)
    assert np.allclose(elevation, [wander + apart, wander], rtol=0.0, atol=1e-15)  # a few roundings of 0.016 at most


@pytest.mark.parametrize(
    "directions",
    [
        [[1, 0, 0], [1, 1, 0], [1, 0.5, 0]],  # to and fro
        [[1, 0, 0], [1, 1, 0.1], [1, 2, 0]],  # up and down
        [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 1e-9, 0]],  # round and round
    ],
)
def test_other_patterns_are_refused(directions: list[list[float]]) -> None:
    pulses = Table(directions, rate=10.0).pulses()
    with pytest.raises(ValueError, match=r"^size: expected \(rows, columns\) of the image"):
        rows_and_columns(pulses, pulses)


def test_a_projection_has_equal_steps() -> None:
    azimuth, elevation = np.radians([30.0, 9.9, 0.0, -10.1, -30.0]), np.radians([-5.0, 4.9, 0.0, 1.7, 5.0])
    across = np.cos(elevation)
    directions = np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
    pulses = Table(directions, times=np.arange(5) * 1e-3, rate=10.0).pulses()
    row, column, shape = projection(pulses, pulses, (2, 3))
    assert (row.tolist(), column.tolist(), shape) == ([1, 0, 1, 0, 0], [0, 1, 1, 2, 2], (2, 3))
    # Behind the sensor, where azimuths jump from π to -π, the left is the right of those who look ahead.
    behind = Table(-directions * [1, 1, -1], times=np.arange(5) * 1e-3, rate=10.0).pulses()
    assert projection(behind, behind, (2, 3))[1].tolist() == column.tolist()


def test_one_pulse_and_none() -> None:
    one = Table([[1, 2, 3]], rate=10.0).pulses()
    assert [values.tolist() for values in rows_and_columns(one, one)[:2]] == [[0], [0]]
    assert [values.tolist() for values in projection(one, one, (4, 4))[:2]] == [[0], [0]]
    none = Pulses(np.empty((0, 3)), np.empty((0, 3)), [], [], [])
    assert rows_and_columns(none, none)[2] == (0, 0)
    assert projection(none, none, (4, 4))[2] == (4, 4)
