"""Comparisons: each measure against what the clouds were made with, verdicts on altered copies, files and reports."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import distance

import lidarsim as ls
import lidarsim.comparison as comparison_module
from lidarsim.cli import main
from lidarsim.comparison import Cell, Measure
from lidarsim.comparison import _inferred as inferred
from lidarsim.comparison import _measures as measures
from lidarsim.comparison import _statistics as statistics
from lidarsim.comparison._frame import Frame
from lidarsim.comparison._report import page, plot

SIGMA, STEP, LOST = 0.012, 0.004, 0.02
"""What the sensor of these tests does: noise and step of the range, m, and share of lost pulses."""
RINGS = 32
OFFSETS = np.radians(np.tile([3.0, 1.0, -1.0, -3.0], RINGS // 4))
ELEVATIONS = np.radians(np.linspace(-20.0, 15.0, RINGS))
SENSOR = ls.Lidar(
    ls.patterns.Spinning(ELEVATIONS, azimuth_offsets=OFFSETS, columns=1024),
    measurement=ls.Measurement(
        range_sigma=SIGMA,
        range_resolution=STEP,
        dropout=LOST,
        beam=ls.Beam(3e-3, pulse_length=3e-9, rays=7),
        returns="dual",
    ),
    name="test",
)


def scene() -> ls.Scene:
    """A hall with pillars before its walls."""
    made = ls.Scene()
    made.add(ls.Plane((0, 0, 1), -1.8), material=ls.Material(reflectivity=0.2))
    made.add(ls.Box((40, 24, 16)), material=ls.Material(reflectivity=0.5))
    for x in (-9, -5, 5, 9):
        for y in (-6, 6):
            made.add(ls.Box((0.8, 0.8, 16), (x, y, 0)), material=ls.Material(reflectivity=0.8))
    return made


def frames(lidar: ls.Lidar = SENSOR, *, count: int = 2, first: int = 0) -> list[ls.PointCloud]:
    return [scan.point_cloud() for scan in lidar.frames(scene(), None, count, first=first)]


def frames_with(**values: Any) -> list[ls.PointCloud]:
    """Frames of the sensor with another measurement."""
    return frames(replace(SENSOR, measurement=replace(SENSOR.measurement, **values)), first=10)


@pytest.fixture(scope="module")
def real() -> list[ls.PointCloud]:
    return frames()


@pytest.fixture(scope="module")
def again() -> list[ls.PointCloud]:
    """The same sensor in the same scene, with other noise."""
    return frames(first=10)


@pytest.fixture(scope="module")
def alike(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> ls.Comparison:
    return ls.compare(real, again)


def change(cloud: ls.PointCloud, ranges: np.ndarray | None = None, **fields: Any) -> ls.PointCloud:
    """The same points at other ranges, or with other fields."""
    own = {name: getattr(cloud, name) for name in ("xyz", "range", "intensity", "ring", "column", "return_number")}
    if ranges is not None:
        own["xyz"] = cloud.xyz * (ranges / cloud.range)[:, None]
        own["range"] = ranges
    return ls.PointCloud(own | fields)


def smooth(cloud: ls.PointCloud) -> ls.PointCloud:
    """Each range the mean of three neighbours along its ring, where they are of one surface."""
    order = np.lexsort((cloud.column, cloud.ring))
    ranges = cloud.range.copy()
    r = ranges[order]
    near = np.maximum(np.abs(r[1:-1] - r[:-2]), np.abs(r[1:-1] - r[2:])) < 0.2
    r[1:-1][near] = ((cloud.range[order][:-2] + r[2:] + r[1:-1]) / 3)[near]
    ranges[order] = r
    return change(cloud, ranges)


def cells(measure: Measure) -> dict[str, Cell]:
    return {cell.label: cell for cell in measure.cells}


# verdicts


def test_another_recording_of_one_scene_is_alike_in_all(alike: ls.Comparison) -> None:
    assert [measure.name for measure in alike.differing] == []
    assert sum(measure.verdict == "alike" for measure in alike) >= 17
    assert all(measure.why for measure in alike)
    assert len(alike["points by ring"].cells) == RINGS


def test_one_frame_is_enough(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> None:
    comparison = ls.compare(real[0], again[0])
    assert comparison.differing == ()
    assert "two frames" in comparison["density-aware Chamfer distance"].why
    assert sum(measure.verdict == "alike" for measure in comparison) >= 14


ALTERED: dict[str, tuple[Callable[[list[ls.PointCloud]], list[ls.PointCloud]], set[str], set[str]]] = {
    "shifted": (
        lambda clouds: [change(cloud, cloud.range + 7 * STEP) for cloud in clouds],
        {"range offset in one scene"},
        {"density-aware Chamfer distance"},
    ),
    "one ring shifted": (
        lambda clouds: [change(cloud, cloud.range + 5 * STEP * (cloud.ring == 20)) for cloud in clouds],
        {"ring bias"},
        set(),
    ),
    "smoothed": (lambda clouds: [*map(smooth, clouds)], {"range noise", "range step"}, set()),
    "noisier": (
        lambda _: frames_with(range_sigma=1.4 * SIGMA),
        {"range noise"},
        {"density-aware Chamfer distance"},
    ),
    "rings permuted": (
        lambda clouds: [change(cloud, ring=(cloud.ring * 5 + 3) % RINGS) for cloud in clouds],
        {"ring elevation", "ring azimuth offset"},
        {"points by ring", "ring bias"},
    ),
    "more lost": (
        lambda _: frames_with(dropout=LOST + 0.06),
        {"return rate by range", "return rate by incidence", "holes in smooth rings"},
        {"density-aware Chamfer distance", "lost returns at edges", "runs of missing pixels"},
    ),
    "one return": (
        lambda _: frames_with(returns="strongest"),
        {"dual returns at edges"},
        {"dual returns"},
    ),
    "another step": (lambda _: frames_with(range_resolution=0.005), {"range step"}, set()),
    "dimmer": (
        lambda clouds: [change(cloud, intensity=0.7 * cloud.intensity) for cloud in clouds],
        {"intensity by range", "intensity by incidence", "distribution of intensity"},
        set(),
    ),
    "cut off": (
        lambda clouds: [cloud[cloud.range < 18.0] for cloud in clouds],
        {"points by range"},
        {
            "points by ring",
            "return rate by range",
            "return rate by incidence",
            "density-aware Chamfer distance",
            "lost returns at edges",
            "dual returns at edges",
            "intensity by range",
            "intensity by incidence",
            "distribution of intensity",
            "distribution of height",
        },
    ),
}


@pytest.mark.slow("each measure finds what differs, and chance alone is no difference")
@pytest.mark.parametrize(("alter", "named", "also"), ALTERED.values(), ids=ALTERED)
def test_the_measure_that_differs_is_named(
    real: list[ls.PointCloud],
    again: list[ls.PointCloud],
    alter: Callable[[list[ls.PointCloud]], list[ls.PointCloud]],
    named: set[str],
    also: set[str],
) -> None:
    found = {measure.name for measure in ls.compare(real, alter(again)).differing}
    assert named <= found
    assert found <= named | also


def test_the_ring_that_differs_is_named(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> None:
    shift = 5 * STEP
    bias = ls.compare(real, [change(cloud, cloud.range + shift * (cloud.ring == 20)) for cloud in again])["ring bias"]
    assert bias.where == "ring 20"
    # Planes over eight rings follow one of them by 1/8 in the mean and up to 7/24 more in their slope.
    assert 0.55 * shift < bias.difference < shift
    assert bias.difference_interval[0] < bias.difference < bias.difference_interval[1]


def test_chance_alone_makes_no_difference() -> None:
    """Of 40 comparisons of 300 cells of pure noise, at most one in twenty may find one; 6 has a probability of 1 %."""
    rng = np.random.default_rng(1)
    alarms = 0
    for trial in range(40):
        sides = []
        for side in range(2):
            units = statistics.Units()
            cell, block = (part.ravel() for part in np.meshgrid(np.arange(300), np.arange(16)))
            samples = statistics.Samples(cell, block, rng.normal(size=cell.size))
            units.add(statistics.Mean().sums(samples, 300))
            # With one seed, units are resampled in pairs.
            sides.append(statistics.estimate(statistics.Mean(), units, 300, seed=2 * trial + side * (trial % 2)))
        one, other = sides
        error = statistics.error_of_difference(one, other)
        chance = statistics.critical(300, np.minimum(one.units, other.units)) * error
        alarms += bool((np.abs(other.value - one.value) > chance).any())
    assert alarms < 6


@pytest.mark.slow("each measure finds what differs, and chance alone is no difference")
@pytest.mark.parametrize("altered", [{"range_sigma": 0.03}, {"range_bias": 0.02}], ids=["noise", "bias"])
@pytest.mark.parametrize("columns", [1024, 128, 48, 24])
def test_a_centimetre_of_noise_or_two_of_bias_is_never_alike(altered: dict[str, float], columns: int) -> None:
    """With all of a frame it differs; with less of it, the data may not tell."""
    sides = []
    for first, values in ((0, {"range_sigma": 0.02}), (5, {"range_sigma": 0.02} | altered)):
        lidar = replace(SENSOR, measurement=ls.Measurement(**values))
        sides.append([cloud[cloud.column < columns] for cloud in frames(lidar, count=1, first=first)])
    name = "range noise" if "range_sigma" in altered else "range offset in one scene"
    verdict = ls.compare(*sides)[name].verdict
    assert verdict == "differs" if columns == 1024 else verdict in {"differs", "cannot tell", "not measured"}


def test_few_data_cannot_tell(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> None:
    """A verdict rests on its power: alike only if what is relevant would have counted."""
    few = ls.compare(*([cloud[cloud.column % 256 < 24] for cloud in side[:1]] for side in (real, again)))
    untold = [measure for measure in few if measure.verdict == "cannot tell"]
    assert untold
    assert all("chance could hide" in measure.why for measure in untold)
    for measure in few:
        if measure.verdict == "alike" and measure.cells[-1].label == "all":
            limit = measures.STATISTICS[measure.name]
            # What is relevant over all is a mean of limits, each at most that of the greatest value.
            most = max(abs(cell.real) for cell in measure.cells if np.isfinite(cell.least))
            rounding = 1.0 + 2.0 * len(measure.cells) * np.finfo(float).eps  # of weights that add up to 1
            assert measure.cells[-1].least <= max(limit.least, limit.relative * most) * rounding


def test_a_difference_that_no_cell_shows_is_seen_over_all() -> None:
    rng = np.random.default_rng(6)
    statistic = replace(measures.STATISTICS["range offset in one scene"], summary=statistics.Mean(), least=0.05)
    sides = []
    for shift in (0.0, 0.1):
        units = statistics.Units()
        cell, block = (part.ravel() for part in np.meshgrid(np.repeat(np.arange(14), 10), np.arange(16)))
        samples = statistics.Samples(cell, block, rng.normal(shift, 0.5, cell.size))
        units.add(statistics.Mean().sums(samples, 14))
        sides.append(units)
    contrast = comparison_module._contrast(statistic, *comparison_module._estimate(statistic, *sides, seed=0))
    found = comparison_module._measure(statistic, contrast, tests=300)
    assert [cell.label for cell in found.cells if cell.differs] == ["all"]
    assert (found.verdict, found.where) == ("differs", "all")


# each measure against what the clouds were made with


def test_noise_is_that_of_the_sensor(alike: ls.Comparison) -> None:
    # Quantisation adds q²/12 to the variance. The third differences of n columns in a row have squares that are
    # correlated by (15/20)², (6/20)² and (1/20)², which more than doubles the variance of their mean, 2/n; to leave out
    # a fifth, as little as doubles it again. So the relative error of σ is below √(2.4/n), here with 4 of it, and with
    # 2e-3 for bins that are 6 % wide, in which the mean square is off by 6 %²/12.
    expected = np.hypot(SIGMA, STEP / np.sqrt(12.0))
    well_known = [cell for cell in alike["range noise"].cells if min(cell.n_real, cell.n_simulated) > 3000]
    assert len(well_known) >= 2
    for cell in well_known:
        for value, n in ((cell.real, cell.n_real), (cell.simulated, cell.n_simulated)):
            assert value == pytest.approx(expected, rel=4.0 * np.sqrt(2.4 / n) + 2e-3)


def test_noise_is_not_that_of_edges() -> None:
    """Of noise-free clouds nothing is left but what a sinusoid of 1/range has, whatever edges there are."""
    lidar = ls.Lidar(SENSOR.pattern)
    noise = ls.compare(frames(lidar), frames(lidar))["range noise"]
    assert sum(cell.n_real for cell in noise.cells) > 20_000
    # Third differences up to 8 sin³(δ/2) r/cosθ, over √20: at δ = 2π/1024, r = 24 m and cosθ = 0.5 2.5e-6 m; the lowest
    # bin ends at 1e-5 m. Rows of the pillars' faces are as flat.
    assert all(cell.real < 1e-5 for cell in noise.cells if cell.n_real > 500)


def test_return_rates_are_those_of_the_sensor(alike: ls.Comparison) -> None:
    for name in ("return rate by range", "return rate by incidence", "holes in smooth rings"):
        expected = LOST if name.startswith("holes") else 1.0 - LOST
        for cell in alike[name].cells:
            if cell.n_real > 1000:
                # Binomial, within 4 σ; a pulse at the end of a plane counts only if it returns, one in forty or so.
                tolerance = 4.0 * np.sqrt(LOST * (1.0 - LOST) / cell.n_real) + 0.05 * LOST
                assert cell.real == pytest.approx(expected, abs=tolerance)


def test_scans_know_what_became_of_each_pulse() -> None:
    """Beyond the reach of the sensor nothing returns, and no cloud tells that there is something."""
    limit = ls.Detection(reflectivity=0.1, range=12.0)
    lidar = replace(SENSOR, measurement=ls.Measurement(detection=limit))
    scans = [list(lidar.frames(scene(), None, 2, first=first)) for first in (0, 5)]
    rates = cells(ls.compare(*scans)["return rate by range"])
    truth = np.concatenate([scan.true_range[:, 0] for scan in scans[0]])
    returned = np.concatenate([scan.return_count > 0 for scan in scans[0]])
    far = (truth >= 20.0) & (truth < 35.0)
    assert 0.0 < returned[far].mean() < 1.0
    assert rates["20 to 35 m"].real == returned[far].mean()  # whole numbers add up exactly
    assert rates["20 to 35 m"].n_real == far.sum()


def test_ring_biases_are_those_of_the_rings(real: list[ls.PointCloud]) -> None:
    biases = 2 * STEP * np.where(np.arange(RINGS) % 2, 1.0, -1.0)
    bias = ls.compare(real, [change(cloud, cloud.range + biases[cloud.ring]) for cloud in real])["ring bias"]
    compared = [cell for cell in bias.cells if np.isfinite(cell.least)]
    assert len(compared) > 20  # the others see the ground alone, at a grazing angle
    found = np.array([cell.difference for cell in compared])
    wanted = biases[[int(cell.label.removeprefix("ring ")) for cell in compared]]
    # A line through ±1 in turns at the eight places −3.5, −2.5, …, 3.5 of a tile has the slope 4/42, and takes 1/3 of
    # the pattern at its ends; noise has a few hundredths.
    assert (np.abs(found - wanted) < 0.4 * np.abs(wanted)).all()


def slope_error(x: np.ndarray, y: np.ndarray) -> float:
    """What rounding does to the slope of a regression at most, (nΣxy − ΣxΣy)/(nΣx² − (Σx)²).

    A sum of n terms is off by n/2 ulp, a product of two sums by n, so both differences by 2n with the ulp of what is
    subtracted, n²·r_x·r_y and n²·r_x², where r is the root mean square. The denominator is q·n²·r_x², with the share q
    of the variance in the mean square, and the slope at most r_y/(r_x √q).
    """
    size = np.sqrt((y * y).mean() / (x * x).mean())
    share = x.var() / (x * x).mean()
    return float(2.0 * len(x) * np.finfo(float).eps * size * (1.0 / share + share**-1.5))


def test_rings_are_where_the_sensor_has_them(alike: ls.Comparison, real: list[ls.PointCloud]) -> None:
    # Points lie in the nominal directions to rounding.
    elevation = [cell.real for cell in alike["ring elevation"].cells if cell.label != "all"]
    xyz, ring = (np.concatenate([getattr(cloud, name) for cloud in real]) for name in ("xyz", "ring"))
    away = np.hypot(xyz[:, 0], xyz[:, 1])
    bounds = [slope_error(away[ring == i], xyz[ring == i, 2]) for i in range(RINGS)]
    assert (np.abs(elevation - ELEVATIONS) < bounds).all()
    # Azimuths are off by 2 ulp of π at most, the step by four times that over an eighth of the columns, so that of the
    # last column by 32 of it, and the mean of n offsets by n ulp of the greatest.
    azimuth = [cell.real for cell in alike["ring azimuth offset"].cells]
    bound = 2.0 * (1 + 8 * 4) * np.spacing(np.pi) + np.bincount(ring).max() * np.spacing(np.abs(OFFSETS).max())
    assert (np.abs(azimuth - (OFFSETS - OFFSETS.mean())) < bound).all()


def test_steps_are_found() -> None:
    rng = np.random.default_rng(0)
    for step in (*measures.STEPS, 0.0):
        ranges = rng.uniform(2.0, 80.0, 4000)
        ranges = np.rint(ranges / step) * step + 0.0003 if step else ranges
        samples = statistics.Samples(np.zeros(4000, int), rng.integers(0, 16, 4000), ranges)
        summary = statistics.Step(measures.STEPS)
        assert summary.value(summary.sums(samples, 1).sum(axis=0)) == step


def rings_of(*rows: list[float]) -> ls.PointCloud:
    """A cloud of rings, one a row, with a column for each number; nan is a pulse without a return."""
    points, ring, column = [], [], []
    for i, row in enumerate(rows):
        for k, r in enumerate(row):
            if np.isfinite(r):
                azimuth, elevation = -0.005 * k, 0.01 * i
                flat = np.cos(elevation)
                points.append(r * np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]))
                ring.append(i)
                column.append(k)
    return ls.PointCloud(xyz=points, ring=ring, column=column)


def test_edges_are_counted() -> None:
    nan, near, far = np.nan, [5.0] * 4, [7.3] * 4
    clean, between, gap = near + far, [*near, 6.1, *far], [*near, nan, *far]
    row = [*clean, *between[::-1], *gap, *clean[::-1], *between, *clean[::-1]]
    frame = Frame.of(rings_of(row, row), None, 1.0)
    mixed, lost, dual = measures.mixed_points(frame), measures.lost_at_edges(frame), measures.dual_at_edges(frame)
    jumps = [a != b for a, b in pairwise(row) if np.isfinite(a) and np.isfinite(b)]
    assert (mixed.value.sum(), lost.value.sum(), dual.value.sum()) == (4.0, 2.0, 0.0)
    # A mixed point makes two jumps of its own.
    assert mixed.weight[(mixed.value == 0) & (lost.value == 0)].sum() == 2 * (sum(jumps) - 2 * 2)
    assert set(mixed.cell) == {measures.BY_JUMP.labels.index("2 to 3 m")}


def test_a_slanted_surface_has_no_edges() -> None:
    row = [10.0 + 0.4 * k for k in range(40)]
    assert len(measures.mixed_points(Frame.of(rings_of(row, row), None, 1.0)).cell) == 0


def test_a_gentle_step_is_no_edge() -> None:
    """From side to side it is 0.11 m, but the lines through the sides are 0.07 m apart at the pixel between them."""
    row = [9.98, 10.0, 10.02, 10.06, 10.13, 10.15, 10.17]
    assert len(measures.mixed_points(Frame.of(rings_of(row, row), None, 1.0)).cell) == 0


def test_rings_too_short_for_two_sides_have_no_edges() -> None:
    for row in ([5.0, 5.0, 6.0, 7.0, 7.0], [5.0] * 3 + [7.0] * 3):
        assert len(measures.mixed_points(Frame.of(rings_of(*[row] * 8), None, 1.0)).cell) == 0


@pytest.mark.parametrize(
    "between",
    [[5.2, 5.2], [5.2, 5.3], [5.1, 5.2, 5.3], [5.2, 5.35, 5.35], [5.13, 5.13, 5.26, 5.26], [5.06, 5.25, 5.44]],
    ids=["a tread", "two treads", "three treads", "a narrow and a wide tread", "two wide treads", "a rounded edge"],
)
def test_surfaces_between_two_sides_are_no_edges(between: list[float]) -> None:
    row = [5.0] * 6 + between + [5.5] * 6
    frame = Frame.of(rings_of(row, row[::-1]), None, 1.0)
    assert len(measures.mixed_points(frame).cell) == 0
    one = [5.0] * 6 + [5.2] + [5.5] * 6
    assert measures.mixed_points(Frame.of(rings_of(one, one), None, 1.0)).value.tolist() == [1.0, 1.0]


def arc(radius: float, low: float, high: float) -> ls.TriangleMesh:
    """A part of a round wall from one azimuth to another."""
    azimuth = np.linspace(low, high, 9)
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    corners = [(x[k], y[k], z) for z in (-5.0, 5.0) for k in range(9)]
    return ls.TriangleMesh(corners, [face for k in range(8) for face in ((k, k + 1, k + 10), (k, k + 10, k + 9))])


def test_mixed_points_are_those_at_edges_of_boards_and_not_those_beside_strips() -> None:
    """Round boards before a round wall; beside every second stands a strip 2.5 columns wide, half way to the wall."""
    columns, boards, near, far = 1024, 41, 5.0, 5.4
    step, half = 2.0 * np.pi / columns, 0.05
    made = ls.Scene()
    made.add(ls.Cylinder((0, 0, -5), (0, 0, 5), far, capped=False))
    edges = []
    for board in range(boards):
        low, high = 2.0 * np.pi * board / boards + np.array([-half, half])
        made.add(arc(near, low, high))
        edges.append(low)
        if board % 2:
            made.add(arc(0.5 * (near + far), high, high + 2.5 * step))
        else:
            edges.append(high)
    beam = ls.Beam(1.3 * step, pulse_length=10e-9, rays=91)  # too long a pulse to tell two echoes apart
    pattern = ls.patterns.Spinning(np.radians([-1.0, 0.0, 1.0]), columns=columns)
    frame = Frame.of(ls.Lidar(pattern, measurement=ls.Measurement(beam=beam)).scan(made), None, 1.0)

    # At an edge, the pulse with an echo between the two surfaces is one of the two nearest.
    azimuth = np.arctan2(frame.xyz[:, 1], frame.xyz[:, 0])
    away = np.abs(np.angle(np.exp(1j * (azimuth[:, None] - edges))))
    share = (frame.reach - near) / (far - near)
    mixed = (away < step)[(share > 0.2) & (share < 0.8)].sum()
    samples = measures.mixed_points(frame)
    assert samples.weight.sum() == len(pattern.elevations) * len(edges)
    assert samples.value.sum() == mixed
    # The middle three fifths of a Gaussian beam are 0.375 of its width; 41 edges of boards meet columns 1/41 apart.
    assert abs(mixed / samples.weight.sum() - 0.375 * 1.3) < 1.0 / boards
    assert set(samples.cell) == {measures.BY_JUMP.labels.index("0.3 to 0.45 m")}


def test_runs_of_missing_pixels_are_counted() -> None:
    nan = np.nan
    row = [5.0, nan, 5.0, nan, nan, 5.0, 5.0, *[nan] * 7, 5.0, nan, 5.0]
    samples = measures.runs_of_missing(Frame.of(rings_of(row, [5.0] * len(row)), None, 1.0))
    lengths = np.bincount(samples.cell[samples.cell >= 0], minlength=9)
    assert dict(zip(measures.BY_RUN.labels, lengths, strict=True)) == dict.fromkeys(measures.BY_RUN.labels, 0) | {
        "1": 2,
        "2": 1,
        "6 to 9": 1,
    }


def test_isolated_points_are_counted() -> None:
    nan = np.nan
    wall = [20.0] * 12
    # One point in the air; then two next to each other; a point 0.9 m before the wall, which is within 5 % of 20 m.
    rows = [
        wall,
        [*wall[:4], 9.0, *wall[5:]],
        [*wall[:8], 6.0, 6.2, *wall[10:]],
        [19.1, *wall[1:]],
        [nan] * 4 + wall[4:],
    ]
    samples = measures.isolated_points(Frame.of(rings_of(*rows), None, 1.0))
    assert len(samples.value) == 5 * 12 - 4
    assert samples.value.sum() == 1.0
    assert measures.BY_RANGE.labels[samples.cell[samples.value == 1.0].item()] == "8 to 12 m"


def test_the_scatter_of_intensity_is_that_of_the_surface(real: list[ls.PointCloud]) -> None:
    rng = np.random.default_rng(8)
    clouds = [change(cloud, intensity=0.4 * (1.0 + 0.12 * rng.normal(size=len(cloud)))) for cloud in real]
    cells = [cell for cell in ls.compare(real, clouds)["scatter of intensity"].cells if cell.n_simulated > 3000]
    assert len(cells) >= 3
    for cell in cells:
        # Half of |x| of a normal x is below 0.6745 σ, where its density is 0.6356/σ: the median of n has a relative
        # error of 0.5/(√n · 0.6356 · 0.6745) = 1.17/√n, and about √2 times that, since second differences next to each
        # other are correlated. Here with 4 of it, and 1 % since the mean of three varies by 7 %, and for the bins.
        assert cell.simulated == pytest.approx(0.12, rel=4.0 * 1.65 / np.sqrt(cell.n_simulated) + 0.01)


def test_a_rate_of_none_has_an_error() -> None:
    sums = np.array([[99.0, 99.0, 0.0]])
    assert statistics.Rate().error(sums) == pytest.approx(np.sqrt(0.005 * 0.995 / 100.0))


def test_dual_returns_and_their_separation() -> None:
    rng = np.random.default_rng(2)
    sides = []
    for _ in range(2):
        single = rings_of(*[[5.0] * 1000] * 8)
        twice = rng.random(len(single)) < 0.3
        apart = rng.uniform(0.6, 4.0, twice.sum())
        second = single.xyz[twice] * (1.0 + apart / 5.0)[:, None]
        sides.append(
            ls.PointCloud(
                xyz=np.concatenate([single.xyz, second]),
                ring=np.concatenate([single.ring, single.ring[twice]]),
                column=np.concatenate([single.column, single.column[twice]]),
            )
        )
    comparison = ls.compare(*sides)
    share, separation = comparison["dual returns"], comparison["separation of dual returns"]
    assert share.real == np.mean(np.unique(sides[0].ring * 1000 + sides[0].column, return_counts=True)[1] == 2)
    assert share.n_real == 8000
    # The 1st percentile of a uniform distribution; of 2,400 samples it is off by 0.2 % of its width, here with 4 of it.
    assert separation.real == pytest.approx(0.6 + 0.01 * 3.4, abs=0.03)
    # Of 8,000 pulses the difference of two shares of 0.3 is off by 0.007, which is more than is relevant.
    assert share.verdict == "cannot tell"
    assert separation.verdict != "differs"


def test_intensity_in_percent_is_that_of_lidarsim(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> None:
    percent = [change(cloud, intensity=np.rint(100.0 * cloud.intensity)) for cloud in again]
    comparison = ls.compare(real, percent)
    assert comparison["intensity by range"].verdict == "alike"
    assert comparison["range noise"].verdict == "alike"


def test_intensities_that_are_photon_counts(real: list[ls.PointCloud]) -> None:
    """Whole numbers of 16 bits, of which a fourfold gain is seen."""
    counts = [
        [change(cloud, intensity=np.rint(gain * (2000 + 1000 * cloud.intensity))) for cloud in real]
        for gain in (1.0, 4.0)
    ]
    comparison = ls.compare(*counts)
    for name in ("intensity by range", "intensity by incidence", "distribution of intensity"):
        assert comparison[name].verdict == "differs", name
    assert comparison["scatter of intensity"].verdict == "alike"


def test_chamfer_distance_is_that_of_the_paper() -> None:
    rng = np.random.default_rng(3)
    one, other = (ls.PointCloud(xyz=rng.normal(3.0, size=(n, 3))) for n in (300, 200))
    pair = measures.Pair(*(Frame.of(cloud, None, 1.0) for cloud in (one, other)))
    samples = measures.chamfer(pair)
    summary = statistics.Mean()
    found = summary.value(summary.sums(samples, 1).sum(axis=0)).item()
    halves = []
    for a, b in ((one.xyz, other.xyz), (other.xyz, one.xyz)):
        distance = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=-1))
        nearest = distance.argmin(axis=1)
        crowd = np.array([(nearest == k).sum() for k in nearest])
        halves.append((1.0 - np.exp(-10.0 * distance.min(axis=1)) / crowd).mean())
    # Each of two sums of 500 positive terms is off by 250 ulp at most, its terms by a few.
    assert found == pytest.approx(np.mean(halves), rel=600 * np.finfo(float).eps)


# statistics


def test_divergences_are_those_of_jensen_and_shannon() -> None:
    one, other = np.random.default_rng(9).integers(0, 50, (2, 4, 30)).astype(float)
    expected = distance.jensenshannon(one, other, base=2, axis=1) ** 2
    # Sums of 30 terms below 1, each rounded a few times.
    assert statistics.jensen_shannon(one, other) == pytest.approx(expected, abs=300 * np.finfo(float).eps)
    assert statistics.jensen_shannon(np.array([1.0, 0.0]), np.array([0.0, 3.0])) == 1.0
    assert statistics.jensen_shannon(one, 2.0 * one) == pytest.approx(np.zeros(4), abs=300 * np.finfo(float).eps)


def test_divergence_by_chance_is_that_of_the_other_side() -> None:
    """Both sides from one distribution: what is found lies within what chance makes; from another, far beyond."""
    rng = np.random.default_rng(10)
    summary = statistics.Divergence(np.linspace(-4.0, 4.0, 41))

    def side(shift: float) -> statistics.Units:
        units = statistics.Units()
        block = np.repeat(np.arange(16), 200)
        samples = statistics.Samples(np.zeros(3200, int), block, rng.normal(shift, 1.0, 3200))
        units.add(summary.sums(samples, 1))
        return units

    for seed in range(20):
        chance, found = statistics.divergence(side(0.0), side(0.0), seed)
        assert abs(found.value - chance.value) < 4.0 * statistics.error_of_difference(chance, found)
    chance, found = statistics.divergence(side(0.0), side(0.5), 0)
    assert found.value - chance.value > 6.0 * statistics.error_of_difference(chance, found)


def test_statistics_of_histograms() -> None:
    values = np.random.default_rng(4).gamma(2.0, size=5000)
    edges = np.linspace(0.0, 20.0, 2001)
    counts = np.histogram(values, edges)[0].astype(float)
    centres, width = 0.5 * (edges[1:] + edges[:-1]), edges[1]
    assert statistics.trimmed_mean(0.1, 0.9)(centres, counts) == pytest.approx(
        stats.trim_mean(values, 0.1), abs=width / 2
    )
    for share in (0.01, 0.5, 0.99):
        assert statistics.quantile(share)(centres, counts) == pytest.approx(np.quantile(values, share), abs=2 * width)
    sigma = np.abs(np.random.default_rng(5).normal(size=200_000))
    sigma[:4000] = 50.0  # a fiftieth of outliers
    counts = np.histogram(sigma, edges)[0].astype(float)
    # The outliers take a fiftieth of the places of 0.8; the quantile at which the rest ends moves from 0.8 to 0.816.
    assert statistics.robust_sigma(centres, counts) == pytest.approx(1.0, abs=0.04)
    assert np.isnan(statistics.quantile(0.5)(centres, np.zeros(2000)))


def test_a_slope_is_that_of_a_regression() -> None:
    rng = np.random.default_rng(6)
    x = rng.uniform(3.0, 9.0, 1000)
    y = 0.3 * x + rng.normal(size=1000)
    samples = statistics.Samples(np.zeros(1000, int), rng.integers(0, 16, 1000), y, other=x)
    found = statistics.Slope().value(statistics.Slope().sums(samples, 1).sum(axis=0)).item()
    assert np.tan(found) == pytest.approx(stats.linregress(x, y).slope, rel=0.0, abs=slope_error(x, y))


@pytest.mark.parametrize("count", [1, 16, 17, 18, 144, 145, 200, 600])
def test_any_number_of_frames_takes_bounded_memory(count: int) -> None:
    units = statistics.Units()
    for frame in range(count):
        sums = np.zeros((statistics.BLOCKS, 2 + frame % 3, 1))
        sums[frame % statistics.BLOCKS, 0] = frame + 1.0
        sums[:, 1] = 1.0
        units.add(sums)
    held = units.sums(units.cells)
    assert len(held) <= max(statistics.MOST, statistics.BLOCKS * statistics.FEW)
    assert len(held) >= min(count, statistics.MOST // 2)
    assert held.sum(axis=0)[:2, 0].tolist() == [count * (count + 1) / 2, 16.0 * count]
    if count > statistics.FEW:
        per_unit = held[:-1, 1, 0]  # the last may be of fewer frames
        assert len(set(per_unit.tolist())) == 1


def test_the_bootstrap_has_the_spread_of_the_mean() -> None:
    units = statistics.Units()
    values = np.random.default_rng(7).normal(2.0, 1.0, size=(128, 50))
    for row in values:
        sums = np.zeros((statistics.BLOCKS, 1, 3))
        sums[0, 0] = [50.0, 50.0, row.sum()]
        units.add(sums)
    found = statistics.estimate(statistics.Mean(), units, 1, seed=0)
    spread = values.mean(axis=1).std(ddof=1) / np.sqrt(len(units.sums(1)))
    # 400 resamples know a standard deviation to 1/√800, here with 4 of it.
    assert found.error.item() == pytest.approx(spread, rel=4.0 / np.sqrt(800.0) + 0.2)
    low, high = found.interval(0)
    assert low < found.value.item() < high


# what clouds do not tell


@pytest.mark.parametrize("name", ["velodyne-vlp16", "ouster-os1-64", "hesai-pandar64"])
def test_a_sensor_tells_the_columns(name: str) -> None:
    lidar = ls.Lidar.preset(name)
    cloud = lidar.scan(scene()).point_cloud()
    # The head of a real one starts anywhere: a third of a column further.
    turn = np.deg2rad(120.0) / lidar.pattern.shape[1]
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    bare = ls.PointCloud(xyz=cloud.xyz @ rotation.T, ring=cloud.ring)
    known = Frame.of(cloud, None, 1.0).image
    told = Frame.of(bare, lidar, 1.0).image
    assert known is not None
    assert told is not None
    assert known.counted
    assert not told.counted
    assert told.rings.tolist() == known.rings.tolist()
    assert (told.point >= 0).sum() >= 0.999 * len(cloud)
    # The points of a ring follow one another as they do in its columns, but for where a turn begins.
    known_pairs, told_pairs = (
        {pair for row in image.point for pair in pairwise(row[row >= 0].tolist())} for image in (known, told)
    )
    assert len(known_pairs - told_pairs) <= 2 * len(known.rings)


@pytest.mark.parametrize("rate", [5.0, 9.66, 20.0])
def test_a_head_may_turn_at_another_rate(rate: float) -> None:
    lidar = ls.Lidar.preset("velodyne-vlp16", noise="measured")
    cloud = replace(lidar, pattern=replace(lidar.pattern, rate=rate)).scan(scene()).point_cloud()
    image = Frame.of(ls.PointCloud(xyz=cloud.xyz, ring=cloud.ring), lidar, 1.0).image
    assert image is not None
    # The step is known to 0.1 % or so, by which some points share a pixel.
    assert (image.point >= 0).sum() >= 0.995 * len(cloud)
    assert image.point.shape[1] == pytest.approx(int(cloud.column.max()) + 1, rel=5e-3)


def turn(xyz: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Points turned about z, each by its angle."""
    x, y, z = xyz.T
    return np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z], axis=-1)


def test_jitter_about_half_a_column_moves_no_point() -> None:
    cloud = ls.Lidar(SENSOR.pattern).scan(scene()).point_cloud()
    jitter = np.random.default_rng(8).uniform(0.4, 0.6, len(cloud)) * 2.0 * np.pi / 1024
    image = Frame.of(ls.PointCloud(xyz=turn(cloud.xyz, jitter), ring=cloud.ring), SENSOR, 1.0).image
    assert image is not None
    assert (image.point >= 0).sum() >= len(cloud) - RINGS  # a turn may begin within a column


def test_two_pulses_of_a_column_are_no_dual_return() -> None:
    cloud = ls.Lidar(SENSOR.pattern).scan(scene()).point_cloud()
    stray = np.where(np.arange(len(cloud)) % 97 == 0, 0.7 * 2.0 * np.pi / 1024, 0.0)
    image = Frame.of(ls.PointCloud(xyz=turn(cloud.xyz, stray), ring=cloud.ring), SENSOR, 1.0).image
    assert image is not None
    assert (image.point >= 0).sum() >= len(cloud) - RINGS
    assert image.returns.max() == 1


def test_the_origins_of_beams_count_for_what_is_near() -> None:
    """At 0.6 m a beam that starts 5 cm beside the axis meets what lies 5 degrees, or 14 columns, off its azimuth."""
    near = ls.Scene()
    near.add(ls.Box((40, 24, 16)))
    near.add(ls.Box((0.4, 1.0, 4.0), (0.8, 0.0, 0.0)))
    lidar = ls.Lidar(ls.patterns.Spinning(ELEVATIONS, columns=1024, beam_origins=(0.0, 0.05, 0.0)))
    cloud = lidar.scan(near).point_cloud()
    assert (cloud.range < 1.0).sum() > 1000
    image = Frame.of(ls.PointCloud(xyz=cloud.xyz, ring=cloud.ring), lidar, 1.0).image
    assert image is not None
    assert (image.point >= 0).sum() > 0.99 * len(cloud)


def test_a_sensor_whose_rings_do_not_turn_tells_no_columns() -> None:
    lidar = ls.Lidar.preset("livox-mid40")
    cloud = lidar.scan(scene()).point_cloud()
    assert ls.compare(cloud, cloud)["range noise"].why == (
        "the real clouds have columns that are no even steps of azimuth, as if points were not in the sensor frame"
    )
    comparison = ls.compare(*[ls.PointCloud(xyz=cloud.xyz, ring=cloud.ring)] * 2, sensor=lidar)
    assert comparison["range noise"].why == (
        "the real clouds have no columns that follow from their azimuths and the sensor"
    )


RING_BY_RING, AS_FIRED, SHUFFLED = "ring by ring", "as fired", "shuffled"


def without_rings(cloud: ls.PointCloud, order: str, path: Path) -> tuple[ls.PointCloud, np.ndarray]:
    """A cloud after KITTI's file, in which the rings follow one another from the top down; and its rings."""
    azimuth = np.mod(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]), 2.0 * np.pi)
    chosen = {
        RING_BY_RING: np.lexsort((azimuth, -cloud.ring.astype(int))),
        AS_FIRED: np.arange(len(cloud)),
        SHUFFLED: np.random.default_rng(9).permutation(len(cloud)),
    }[order]
    ls.PointCloud(xyz=cloud.xyz[chosen], intensity=np.minimum(cloud.intensity[chosen], 1.0)).save(path)
    bare = ls.PointCloud.load(path)
    assert "ring" not in bare.fields
    return bare, cloud.ring[chosen]


@pytest.mark.slow("a sensor tells the rings of clouds without them")
@pytest.mark.parametrize("order", [RING_BY_RING, AS_FIRED, SHUFFLED])
@pytest.mark.parametrize("name", ["velodyne-vlp16", "velodyne-hdl64e-s2", "velodyne-hdl64e-s3", "ouster-os1-64"])
def test_a_sensor_tells_the_rings(name: str, order: str, tmp_path: Path) -> None:
    noise = {"velodyne-hdl64e-s2": "datasheet"}.get(name, "measured")
    lidar = ls.Lidar.preset(name, noise=noise)
    bare, ring = without_rings(lidar.scan(scene(), seed=3).point_cloud(), order, tmp_path / "a.bin")
    frame = Frame.of(bare, lidar, 1.0)
    assert len(frame) > 20_000
    assert frame.ring is not None
    assert (frame.ring == ring).mean() >= 0.995
    assert frame.inferred == f"the {'order' if order == RING_BY_RING else 'elevations'} of the points"
    assert ("elevation" in frame.missing) == (order != RING_BY_RING)


def test_rings_of_another_unit_are_those_of_the_order_or_none(tmp_path: Path) -> None:
    """The lasers of another unit look 0.2° elsewhere, where rings are 0.3° apart, and the head tilts as it drives."""
    lidar = ls.Lidar.preset("velodyne-hdl64e-s3", noise="measured")
    cloud = lidar.scan(scene(), seed=3).point_cloud()
    rng = np.random.default_rng(10)
    away = np.hypot(cloud.xyz[:, 0], cloud.xyz[:, 1])
    tilt = np.radians(rng.normal(0.0, 0.2, 64))[cloud.ring] + np.radians(0.3) * np.sin(
        3.0 * cloud.time / cloud.time[-1]
    )
    unlike = change(cloud, xyz=cloud.xyz + np.outer(away * tilt, [0.0, 0.0, 1.0]))
    bare, ring = without_rings(unlike, RING_BY_RING, tmp_path / "a.bin")
    frame = Frame.of(bare, lidar, 1.0)
    assert frame.ring is not None
    assert (frame.ring == ring).mean() >= 0.995
    frame = Frame.of(without_rings(unlike, SHUFFLED, tmp_path / "b.bin")[0], lidar, 1.0)
    assert frame.ring is None
    assert frame.missing["ring"] == "have no rings that follow from their elevations, or their order, and the sensor"


def test_rings_that_see_nothing_are_left_out(tmp_path: Path) -> None:
    lidar = ls.Lidar.preset("velodyne-hdl64e-s3", noise="measured")
    cloud = lidar.scan(scene(), seed=3).point_cloud()
    cloud = cloud[(cloud.ring > 3) & (cloud.ring < 55) & (cloud.ring != 30)]
    bare, ring = without_rings(cloud, RING_BY_RING, tmp_path / "a.bin")
    frame = Frame.of(bare, lidar, 1.0)
    assert frame.inferred == "the order of the points"
    assert frame.ring is not None
    assert (frame.ring == ring).mean() >= 0.995


def test_turns_are_rings_in_the_best_order() -> None:
    rng = np.random.default_rng(11)
    for _ in range(20):
        cost = rng.random((4, 7))
        best = min(combinations(range(7), 4), key=lambda columns: cost[range(4), list(columns)].sum())
        assert inferred._rising(cost).tolist() == list(best)


@pytest.mark.slow("each measure finds what differs, and chance alone is no difference")
def test_clouds_without_rings_are_compared(tmp_path: Path) -> None:
    lidar = ls.Lidar.preset("velodyne-vlp16", noise="measured")
    clouds = [scan.point_cloud() for scan in lidar.frames(scene(), None, 4, seed=1)]
    real, _ = without_rings(clouds[0], RING_BY_RING, tmp_path / "a.bin")
    simulated, _ = without_rings(clouds[2], AS_FIRED, tmp_path / "b.bin")
    comparison = ls.compare(real, simulated, sensor=lidar)
    assert comparison.differing == ()
    measured = ("points by ring", "range noise", "holes in smooth rings")
    assert "not measured" not in {comparison[name].verdict for name in measured}
    assert comparison.notes == (
        "the rings of the real clouds are inferred from the order of the points",
        "the rings of the simulated clouds are inferred from the elevations of the points",
    )
    assert comparison.notes[0] in str(comparison)
    assert comparison.real.rings == 16
    assert "rings but those that follow from the elevations" in comparison["ring elevation"].why
    assert ls.compare(real, clouds[2], sensor=lidar)["ring elevation"].verdict == "alike"


def test_without_rings_it_says_what_needs_them(real: list[ls.PointCloud]) -> None:
    comparison = ls.compare([ls.PointCloud(xyz=cloud.xyz) for cloud in real], real)
    why = "the real clouds have no rings; the argument sensor tells them"
    without = {measure.name for measure in comparison if measure.why == why}
    assert f"not measured, since {why}: points by ring, " in str(comparison)
    assert {"points by ring", "range noise", "ring bias", "ring elevation", "dual returns"} <= without
    assert comparison["intensity by range"].why == "the real clouds have no intensity"
    assert comparison["points by range"].verdict == "alike"
    assert np.isnan(comparison["ring bias"].real)


@pytest.mark.slow("each measure finds what differs, and chance alone is no difference")
def test_unlike_sensors_are_noted(real: list[ls.PointCloud]) -> None:
    few = [cloud[cloud.ring % 2 == 0] for cloud in real]
    comparison = ls.compare(real, few)
    assert comparison["ring elevation"].why == "the real clouds have points in 32 rings, the simulated ones in 16"
    assert "unlike sensors" in comparison.notes[0]
    assert comparison["range noise"].verdict == "alike"
    assert ls.compare(real, few, sensor=SENSOR).notes == ()


def test_points_in_millimetres_are_noted(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> None:
    in_mm = [change(cloud, 1000.0 * cloud.range) for cloud in again]
    (note,) = ls.compare(real[:1], in_mm[:1]).notes
    middle = 1000.0 * np.median(again[0].range)
    assert note == f"half of the simulated points are beyond {middle:.4g} m, and all real ones nearer: mm?"
    assert ls.compare(real[:1], again[:1]).notes == ()


def test_points_in_the_world_are_noted(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> None:
    station = np.eye(4)
    station[0, 3] = 5_264_000
    notes = ls.compare(*([clouds[0].transformed(station)] for clouds in (real, again))).notes
    assert notes == tuple(
        f"ranges of the {side} clouds differ from the distances to the origin by 5.264e+06 m, as if points were not in"
        " the sensor frame"
        for side in ("real", "simulated")
    )


def test_what_does_not_overlap_is_not_paired(real: list[ls.PointCloud], again: list[ls.PointCloud]) -> None:
    elsewhere = [change(cloud, 5.0 * cloud.range) for cloud in again]
    comparison = ls.compare(real, elsewhere)
    for name in ("range offset in one scene", "density-aware Chamfer distance"):
        assert "do not overlap" in comparison[name].why


@pytest.mark.slow("every kind of argument and odd numbers are taken")
def test_strange_numbers_are_no_burden(real: list[ls.PointCloud]) -> None:
    cloud = change(real[0], ring=np.full(len(real[0]), 60_000))
    assert "have rings up to 60,000" in ls.compare(cloud, real)["points by ring"].why
    wide = change(real[0], column=np.where(np.arange(len(real[0])) == 5, 2**32 - 1, real[0].column))
    assert ls.compare(wide, real)["range noise"].why == "the real clouds have too many columns for their points"
    ticks = [change(cloud, column=cloud.column * 44 + 7) for cloud in real]
    assert ls.compare(real, ticks).to_dict() == ls.compare(real, real).to_dict()
    holes = np.where(np.arange(len(real[0]))[:, None] % 7 == 0, np.nan, real[0].xyz)
    assert ls.compare(ls.PointCloud(xyz=holes), real).real.points == np.isfinite(holes[:, 0]).sum()


# what is given


@pytest.mark.slow("every kind of argument and odd numbers are taken")
def test_files_folders_bags_and_scans_are_taken(tmp_path: Path) -> None:
    lidar = ls.Lidar.preset("velodyne-vlp16", noise="datasheet")
    scans = list(lidar.frames(scene(), None, 3))
    (tmp_path / "clouds" / "deep").mkdir(parents=True)
    for i, scan in enumerate(scans):
        scan.point_cloud().save(tmp_path / "clouds" / ("deep" if i else "") / f"frame_{i}.npz")
    (tmp_path / "clouds" / "poses.tum").write_text("", encoding="utf-8")
    with ls.io.rosbag.Writer(tmp_path / "drive.mcap") as bag:
        for scan in scans:
            bag.write(scan)
    points = sum(len(scan.point_cloud()) for scan in scans)
    given = {
        "folder": tmp_path / "clouds",
        "bag": str(tmp_path / "drive.mcap"),
        "paths": sorted((tmp_path / "clouds").rglob("*.npz")),
        "scans": iter(scans),
        "clouds": (scan.point_cloud() for scan in scans),
    }
    for name, one in given.items():
        comparison = ls.compare(one, scans[0], sensor="velodyne-vlp16")
        assert (comparison.real.frames, comparison.real.points) == (3, points), name
        assert comparison["range noise"].verdict == "alike", name
    assert ls.compare(tmp_path / "clouds" / "frame_0.npz", scans[0]).real.frames == 1


def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    from lidarsim.comparison import source

    for place, name in enumerate(("f9", "f10", "f100", "f²", ".f11")):
        ls.PointCloud(xyz=[[place, 0, 0]]).save(tmp_path / f"{name}.xyz")
    read = source("real", tmp_path)
    assert read.count == 4
    assert [float(cloud.xyz[0, 0]) for cloud in read.frames] == [0.0, 1.0, 2.0, 3.0]


def test_one_frame_is_held_at_a_time(real: list[ls.PointCloud]) -> None:
    order = []

    def note_reads(name: str) -> Any:
        for cloud in real:
            order.append(name)
            yield cloud

    ls.compare(note_reads("real"), note_reads("simulated"))
    assert order == ["real", "simulated"] * 2


MISTAKES: dict[str, tuple[Callable[[Path], Any], type[Exception], str]] = {
    "a number": (lambda _: ls.compare(3, ls.PointCloud([[1.0, 0, 0]])), TypeError, "real: expected a PointCloud"),
    "numbers": (
        lambda _: ls.compare(ls.PointCloud([[1.0, 0, 0]]), [3]),
        TypeError,
        "simulated[0]: expected a PointCloud, a Scan or a path, got 3",
    ),
    "no points": (
        lambda _: ls.compare(ls.PointCloud([[1.0, 0, 0]]), ls.PointCloud(np.zeros((4, 3)))),
        ValueError,
        "simulated: expected points, got none in 1 frame",
    ),
    "no frames": (
        lambda _: ls.compare([], ls.PointCloud([[1.0, 0, 0]])),
        ValueError,
        "real: expected points, got none in 0 frames",
    ),
    "no such sensor": (
        lambda _: ls.compare(*[ls.PointCloud([[1.0, 0, 0]])] * 2, sensor="os1"),
        ValueError,
        "sensor: expected a Lidar, a file or one of ",
    ),
    "a sensor of another type": (
        lambda _: ls.compare(*[ls.PointCloud([[1.0, 0, 0]])] * 2, sensor=5),
        TypeError,
        "sensor: expected a Lidar, the name of a preset or a file, got 5",
    ),
    "no such file of a sensor": (
        lambda folder: ls.compare(*[ls.PointCloud([[1.0, 0, 0]])] * 2, sensor=folder / "own.yaml"),
        ls.errors.FileFormatError,
        "own.yaml: cannot read the file",
    ),
    "points in millimetres": (
        lambda _: ls.compare(*(ls.PointCloud([[x, 0, 0]] * 2) for x in (9.0, 9e3)), sensor="velodyne-vlp16"),
        ValueError,
        "simulated: expected frames of velodyne-vlp16, which sees 100 m, got half of the points beyond 9000 m; mm?",
    ),
    "an empty folder": (
        lambda folder: ls.compare(folder, folder),
        ls.errors.FileFormatError,
        "expected point clouds or bags in the folder, got none",
    ),
    "no file": (lambda folder: ls.compare(folder / "a.pcd", folder / "b.pcd"), FileNotFoundError, "no such file"),
}


@pytest.mark.parametrize(("mistake", "kind", "message"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_explained(
    mistake: Callable[[Path], Any], kind: type[Exception], message: str, tmp_path: Path
) -> None:
    with pytest.raises(kind) as raised:
        mistake(tmp_path)
    assert message in str(raised.value)


def test_a_bag_of_two_sensors_is_not_mixed(tmp_path: Path) -> None:
    scan = ls.Lidar.preset("velodyne-vlp16").scan(scene())
    with ls.io.rosbag.Writer(tmp_path / "two.mcap", sensors={"a": np.eye(4), "b": np.eye(4)}) as bag:
        bag.write({"a": scan, "b": scan})
    with pytest.raises(ValueError, match="expected the clouds of one sensor, got the topics /a/points and /b/points"):
        ls.compare(tmp_path / "two.mcap", scan)


# what comes out


class Checker(HTMLParser):
    """Elements that are open, and what is loaded from elsewhere."""

    VOID = frozenset({"meta", "br", "line", "circle", "rect"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []
        self.seen: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        self.loaded += [value or "" for name, value in attrs if name in {"src", "href"} and not value.startswith("#")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_reports_of_files_whose_names_are_not_utf_8(alike: ls.Comparison, tmp_path: Path) -> None:
    name = os.fsdecode(b"\xff.pcd")
    named = replace(alike, real=replace(alike.real, name=name))
    for suffix in (".html", ".json"):
        named.save(tmp_path / f"report{suffix}")
    assert "\\udcff.pcd" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "report.json").read_bytes())["real"]["name"] == name


def test_the_page_needs_nothing_else(alike: ls.Comparison, tmp_path: Path) -> None:
    alike.save(tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    assert checker.loaded == []
    assert {"svg", "table", "style"} <= checker.seen
    assert all(measure.name in text for measure in alike)
    assert {f">{measure.by}</text>" in text for measure in alike if len(measure.cells) > 1} == {True}
    assert text.count("<svg") == sum(measure.verdict != "not measured" for measure in alike)
    assert "nan" not in text.replace("finance", "")


def test_names_are_text_in_the_page(alike: ls.Comparison) -> None:
    odd = replace(alike, real=replace(alike.real, name="<script>&"), notes=("<b>",))
    text = page(odd)
    assert "<script>" not in text
    assert "<b>" not in text
    assert "&lt;script&gt;&amp;" in text


def test_a_plot_spans_what_is_compared() -> None:
    few = Cell(label="ring 0", real=7e5, simulated=0.7, differs=False)
    many = [
        Cell(label=f"ring {i}", real=0.5, simulated=0.9, real_interval=(0.4, 0.6), least=0.1, differs=True)
        for i in (1, 2)
    ]
    measure = Measure(name="a", unit="m", verdict="differs", why="", by="ring", cells=(few, *many))
    drawn = plot(measure)
    assert drawn.count("<circle") == 5  # without the one that lies beyond the axis
    assert drawn.count('fill="var(--card)"') == 1
    for text in (">ring</text>", ">m</text>", "differs", "too few samples"):
        assert text in drawn


def test_json_holds_all_and_no_nan(alike: ls.Comparison, tmp_path: Path) -> None:
    alike.save(tmp_path / "report.json")
    read = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert read == json.loads(json.dumps(alike.to_dict()))
    assert [measure["name"] for measure in read["measures"]] == [measure.name for measure in alike]
    noise = read["measures"][[measure.name for measure in alike].index("range noise")]
    assert noise["real"] == alike["range noise"].real
    assert len(noise["cells"]) == len(alike["range noise"].cells)
    with pytest.raises(ls.errors.FileFormatError, match="unknown extension"):
        alike.save(tmp_path / "report.pdf")


def test_a_comparison_is_a_sequence(alike: ls.Comparison) -> None:
    assert len(alike) == len(measures.STATISTICS)
    assert alike[0] is alike.measures[0]
    assert alike["range noise"] in alike
    assert alike[:2] == alike.measures[:2]
    with pytest.raises(KeyError, match="expected one of points by range"):
        alike["noise"]
    assert str(pickle.loads(pickle.dumps(alike))) == str(alike)  # noqa: S301
    assert "range noise" in str(alike)
    assert "alike" in repr(alike["range noise"])
    assert "<table>" in alike._repr_html_()


def test_the_same_clouds_give_the_same_numbers(real: list[ls.PointCloud], alike: ls.Comparison) -> None:
    assert ls.compare(real, frames(first=10)).to_dict() == alike.to_dict()


# the command


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as left:
        main([*map(str, arguments)])
    return int(left.value.code or 0)


@pytest.fixture
def folders(real: list[ls.PointCloud], again: list[ls.PointCloud], tmp_path: Path) -> tuple[Path, Path]:
    for name, clouds in (("real", real), ("sim", again)):
        (tmp_path / name).mkdir()
        for i, cloud in enumerate(clouds):
            cloud.save(tmp_path / name / f"{i}.npz")
    return tmp_path / "real", tmp_path / "sim"


def test_the_command_prints_the_table(folders: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    folder = folders[0].parent
    own = folder / "own.yaml"
    own.write_text("preset: velodyne-vlp16\nname: own\n", encoding="utf-8")
    assert run("compare", *folders, "-o", folder / "r.html", "--json", folder / "r.json", "--sensor", own) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert f"real {folders[0]}: 2 frames, " in printed.out
    assert "range noise" in printed.out
    assert "0 of " in printed.out
    assert (folder / "r.html").stat().st_size > 10_000
    assert json.loads((folder / "r.json").read_text(encoding="utf-8"))["real"]["frames"] == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("real", "nowhere.npz"), "nowhere.npz: no such file"),
        (("real", "sim", "--sensor", "os1"), "--sensor: expected a Lidar, a file or one of"),
        (("real", "sim", "-o", "r.pdf"), "r.pdf: unknown extension '.pdf', expected .html"),
        (("real", "sim", "--json", "no/r.json"), "the folder no does not exist"),
        (("real",), "Missing argument"),
    ],
)
def test_the_command_explains_a_mistake_in_a_line(
    folders: tuple[Path, Path],
    arguments: tuple[str, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folders[0].parent)
    assert run("compare", *arguments) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""


# the page


def test_the_page_names_each_measure_and_what_is_relevant() -> None:
    text = (Path(ls.__file__).parent / "comparison" / "README.md").read_text(encoding="utf-8")
    rows = {line.split("`")[1]: line.split("|")[-2].strip() for line in text.splitlines() if line[:3] == "| `"}
    assert list(rows) == list(measures.STATISTICS)
    for name, said in rows.items():
        statistic = measures.STATISTICS[name]
        scale = 1e3 if "mm" in said or "mrad" in said else 1.0
        limits = {f"{scale * statistic.least:g}"} if statistic.least else set()
        limits |= {f"{100 * statistic.relative:g}"} if statistic.relative else set()
        assert {part.split()[0] for part in said.split(", ")} == (limits or {"any"}), name
