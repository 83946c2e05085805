"""Fits of a sensor: what simulated captures were made with comes back, or is left with a reason."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.cli import main

ELEVATIONS = np.radians(np.linspace(-24.0, 15.0, 40))
GROUND = ls.Material(reflectivity=0.25)
FRAMES = 3


def scene() -> ls.Scene:
    """A level ground with boxes on it, one so near that a part of it is nearer than any least range here."""
    made = ls.Scene()
    made.add(ls.Plane((0, 0, 1), -1.8), material=GROUND)
    for x, y, reflectivity in ((6, 4, 0.6), (-7, 5, 0.4), (-5, -9, 0.7), (9, -8, 0.5), (14, 3, 0.8)):
        made.add(ls.Box((3, 4, 3), (x, y, -0.3)), material=ls.Material(reflectivity=reflectivity))
    made.add(ls.Box((3, 0.5, 2.5), (0, -1, -0.5)), material=ls.Material(reflectivity=0.4))
    return made


def unit(seed: int) -> ls.Lidar:
    """A sensor with values drawn at random; in every second draw the detection limit is soft, and the ground fades."""
    rng = np.random.default_rng(seed)
    step, fades = float(rng.choice([0.001, 0.002, 0.004, 0.005])), seed % 2 == 0
    response = ls.Response(
        range=[(2.0, rng.uniform(0.2, 0.6)), (10.0, rng.uniform(0.4, 1.0))],
        sigma=rng.uniform(0.03, 0.15),
        ring_sigma=rng.uniform(0.03, 0.2),
        resolution=float(rng.choice([1 / 255, 0.01, 1 / 1023])),
        limit=float(rng.choice([1.0, 0.6])),
    )
    sigma = rng.uniform(0.6 * step + 0.002, 0.03)
    measurement = ls.Measurement(
        range_sigma=[(3.0, 0.008), (12.0, 0.02)] if seed % 5 == 4 else sigma,
        range_resolution=step,
        channel_bias_sigma=rng.uniform(0.003, 0.02),
        dropout=rng.uniform(0.001, 0.03),
        detection=ls.Detection(0.1, rng.uniform(25.0, 70.0), rng.uniform(0.2, 0.9)) if fades else None,
        response=response,
    )
    pattern = ls.patterns.Spinning(ELEVATIONS, columns=1024)
    near = rng.uniform(0.6, 1.2)
    return ls.Lidar(pattern, measurement=measurement, min_range=near, max_range=120.0, name=f"unit {seed}")


def start(of: ls.Lidar) -> ls.Lidar:
    """What a data sheet says of a unit: the same model, with other values."""
    response = ls.Response(resolution=of.measurement.response.resolution if of.measurement.response else 0.0)
    detection = None if of.measurement.detection is None else ls.Detection(0.1, 80.0)
    sheet = ls.Measurement(range_sigma=0.02, detection=detection, response=response)
    return replace(of, measurement=sheet, min_range=0.5)


def clouds(of: ls.Lidar, seed: int = 0, count: int = FRAMES) -> list[ls.PointCloud]:
    return [scan.point_cloud() for scan in of.frames(scene(), None, count, seed=seed)]


def true_value(of: ls.Lidar, name: str) -> Any:
    value: Any = of if hasattr(of, name) else of.measurement
    for part in name.split("."):
        value = getattr(value, part, None)
    return value


def at(value: Any, cell: ls.comparison.Cell) -> float:
    """A number, or a table at the range of a cell."""
    return float(value) if isinstance(value, float) else float(np.interp(float(cell.label[:-2]), *np.transpose(value)))


def check_intervals(seed: int) -> list[tuple[str, bool]]:
    """Names of the values that frames of a unit tell, one for each row of a table, and whether each interval holds."""
    of = unit(seed)
    fitted, comparison = ls.fit(clouds(of, seed), start(of), ground=GROUND)
    found = []
    for measure in comparison:
        if measure.verdict == "not measured":
            assert measure.why
            assert true_value(fitted, measure.name) == true_value(start(of), measure.name)
            continue
        value = true_value(of, measure.name)
        if measure.by == "range":
            ends = [(at(value, cell), *cell.real_interval) for cell in measure.cells]
        elif isinstance(value, float):
            ends = [(value, *measure.real_interval)]
        else:
            ends = [(value[0][1], -np.inf, -np.inf)]  # one number for a table
        # Steps and limits of intensities, which are float32, are exact to 6 digits, and a limit to the step.
        slack = (1e-6 + true_value(of, "response.resolution") * measure.name.endswith("limit")) * (
            "res" in measure.name
        )
        found += [(measure.name, bool(low - slack <= it <= high + slack)) for it, low, high in ends]
    return found


def test_what_was_put_in_comes_back(slow: bool) -> None:
    """Intervals of 95 % hold in 95 % of the cases, by chance seldom in fewer than `least` says.

    Of n independent cases each holds with probability 0.95, so their number is binomial; fewer than its quantile of
    1/1000 are no chance. Rows of one table are independent enough: they are of other points.
    """
    from scipy.stats import binom

    told: Counter[str] = Counter()
    inside: Counter[str] = Counter()
    for seed in range(40) if slow else (6, 7):
        for name, holds in check_intervals(seed):
            told[name] += 1
            inside[name] += holds
    assert set(told) >= {"range_sigma", "channel_bias_sigma", "range_resolution", "dropout", "min_range"}
    assert set(told) >= {
        "detection.range",
        "detection.sigma",
        "response.range",
        "response.ring_sigma",
        "response.sigma",
    }
    assert set(told) >= {"response.resolution", *(["response.limit"] if slow else [])}
    for name, count in told.items():
        assert inside[name] >= binom.ppf(1e-3, count, 0.95), f"{name}: {inside[name]} of {count}"
    assert sum(inside.values()) >= binom.ppf(1e-3, told.total(), 0.95), f"{inside} of {told}"


def test_intervals_are_narrow() -> None:
    """The intervals that hold are of use: noise to 5 %, the limit of detection to 10 %, drop-out to a half."""
    of = unit(6)
    _, comparison = ls.fit(clouds(of), start(of), ground=GROUND)
    for name, most in {"range_sigma": 0.05, "detection.range": 0.1, "detection.sigma": 0.3, "dropout": 0.5}.items():
        low, high = comparison[name].real_interval
        assert 0.0 < high - low < 2.0 * most * comparison[name].real, name
        assert comparison[name].verdict == "differs"
    assert len(comparison["channel_bias_sigma"].cells) == len(ELEVATIONS)


def test_each_ring_gets_its_own_bias() -> None:
    """The biases of the unit less what is linear over the eight rings of a tile, in which planes are fitted."""
    from scipy.stats import binom

    of = unit(6)
    fitted, comparison = ls.fit(clouds(of), start(of), ground=GROUND)
    assert fitted.measurement.channel_bias_sigma == 0.0
    exact = replace(of, measurement=ls.Measurement(channel_bias_sigma=of.measurement.channel_bias_sigma)).scan(scene())
    hit = exact.status == ls.Status.hit
    rings = exact.pulses.ring[hit]
    true = (np.bincount(rings, exact.range_error[hit, 0]) / np.bincount(rings)).reshape(-1, 8)
    line = np.column_stack([np.ones(8), np.arange(8.0)])
    true -= (line @ np.linalg.lstsq(line, true.T, rcond=None)[0]).T
    half = np.array([np.ptp(cell.real_interval) / 2 for cell in comparison["channel_bias_sigma"].cells])
    own = np.asarray(fitted.measurement.range_bias)
    assert half.max() < 0.5 * own.std()
    inside = np.abs(own - true.ravel()) <= half + 5e-4 * np.abs(own)  # they have four digits
    assert inside.sum() >= binom.ppf(1e-3, len(own), 0.95)


def test_biases_hold_less_error_than_the_deviations_that_tell_them() -> None:
    """Rings get of a deviation what is likely a bias: where noise is great, they are nearer to the true ones."""
    line = np.column_stack([np.ones(8), np.arange(8.0)])
    deviations, biases = [], []
    for seed in range(5):
        of = replace(unit(6), measurement=ls.Measurement(channel_bias_sigma=0.003, range_sigma=0.05))
        exact = replace(of, measurement=ls.Measurement(channel_bias_sigma=0.003)).scan(scene(), seed=seed)
        hit = exact.status == ls.Status.hit
        rings = exact.pulses.ring[hit]
        true = (np.bincount(rings, exact.range_error[hit, 0]) / np.bincount(rings)).reshape(-1, 8)
        true -= (line @ np.linalg.lstsq(line, true.T, rcond=None)[0]).T
        fitted, comparison = ls.fit(clouds(of, seed, 1), start(of))
        if fitted.measurement.channel_bias_sigma == 0.0:
            for cell in comparison["channel_bias_sigma"].cells:
                ring = int(cell.label.removeprefix("ring "))
                deviations.append(cell.real - true.ravel()[ring])
                biases.append(np.asarray(fitted.measurement.range_bias)[ring] - true.ravel()[ring])
    assert len(biases) > len(ELEVATIONS)
    assert np.std(biases) < 0.9 * np.std(deviations)


def test_spread_of_ring_factors_is_that_of_the_rings() -> None:
    """Bright and dim rings count alike, and so do those that see no more than a part of a tile."""
    of = unit(6)
    assert of.measurement.response is not None
    own = replace(of, measurement=ls.Measurement(response=ls.Response(ring_sigma=of.measurement.response.ring_sigma)))
    around = ls.Scene()
    around.add(ls.Sphere((0, 0, 0), 10.0), material=ls.Material(reflectivity=0.5))
    exact = own.scan(around)
    true = np.log(np.bincount(exact.pulses.ring, exact.intensity[:, 0])).reshape(-1, 8)
    line = np.column_stack([np.ones(8), np.arange(8.0)])
    true -= (line @ np.linalg.lstsq(line, true.T, rcond=None)[0]).T
    _, comparison = ls.fit(clouds(of), start(of), ground=GROUND)
    spread = np.sqrt((true**2).sum() / (true.size * 6 / 8))
    assert comparison["response.ring_sigma"].real == pytest.approx(spread, rel=0.1)


@pytest.mark.parametrize("sigma", [[(2.0, 0.004), (10.0, 0.008), (60.0, 0.03)], 0.006], ids=["table", "slope"])
def test_noise_keeps_its_shape_over_range(sigma: Any) -> None:
    """A unit noisier than the sensor by half has more noise than that by half at ranges without planes, too."""
    sheet = ls.Measurement(range_sigma=sigma, range_sigma_slope=0.0 if isinstance(sigma, list) else 0.001)
    times = np.array([1.0, 1.5])
    noisy = [tuple(row * times) for row in sigma] if isinstance(sigma, list) else 1.5 * sigma
    measurement = replace(sheet, range_sigma=noisy, range_sigma_slope=1.5 * sheet.range_sigma_slope)
    of = replace(unit(6), measurement=measurement)
    fitted, comparison = ls.fit(clouds(of), replace(of, measurement=sheet))
    table = fitted.measurement.range_sigma
    if isinstance(table, tuple):
        assert np.interp(60.0, *np.transpose(table)) == pytest.approx(0.045, rel=0.1)
        assert len(comparison["range_sigma"].cells) == len(table)
    else:
        assert table == pytest.approx(1.5 * sigma, rel=0.1)
        assert fitted.measurement.range_sigma_slope == pytest.approx(0.0015, rel=0.1)


def test_one_noisy_surface_tells_little() -> None:
    """Noise by range is drawn to that of all ranges where few columns tell it."""
    from lidarsim.comparison._estimators import _draw_to

    values, errors = np.array([1.0, 1.2, 4.0]), np.array([0.01, 0.01, 1.5])
    likely = _draw_to(1.1, values, errors)
    assert likely[:2] == pytest.approx(values[:2], rel=0.02)
    assert 1.1 < likely[2] < 1.5
    assert _draw_to(1.0, np.array([1.0, 1.01]), np.array([0.5, 0.5])) == pytest.approx([1.0, 1.0])
    # With errors alike, the square of the spread is the variance of the values less that of their errors.
    values = np.array([0.7, 1.0, 1.1, 1.6])
    spread = values.var(ddof=1) - 0.2**2
    expected = values.mean() + spread / (spread + 0.2**2) * (values - values.mean())
    assert _draw_to(values.mean(), values, np.full(4, 0.2)) == pytest.approx(expected)


def test_drop_out_is_that_beyond_the_near_field() -> None:
    of = replace(unit(7), min_range=0.3)
    rng = np.random.default_rng(0)
    seen = []
    for cloud in clouds(of):
        near = np.linalg.norm(cloud.xyz, axis=1) < 1.0
        seen.append(cloud[~near | (rng.random(len(cloud)) < 0.8)])
    low, high = ls.fit(seen, of)[1]["dropout"].real_interval
    assert low <= of.measurement.dropout <= high


@pytest.mark.parametrize(
    ("returned", "why"),
    [
        (lambda away: 1.0 - 0.1 / away**2, "the share of lost pulses depends on range: 0.0"),
        (lambda away: away < 1.5, "too few pulses at smooth surfaces at several ranges beyond 1 m"),
    ],
    ids=["oftener near", "one range"],
)
def test_what_may_depend_on_range_is_no_drop_out(returned: Callable[[Any], Any], why: str) -> None:
    of = replace(unit(7), min_range=0.3)
    rng = np.random.default_rng(0)
    seen = [cloud[rng.random(len(cloud)) < returned(np.linalg.norm(cloud.xyz, axis=1))] for cloud in clouds(of)]
    fitted, comparison = ls.fit(seen, of)
    assert comparison["dropout"].why.startswith(why)
    assert fitted.measurement.dropout == of.measurement.dropout


@pytest.mark.parametrize(("more", "told"), [(0.0025, True), (0.01, False)])
def test_drop_out_may_differ_by_range_as_little_as_compare_neglects(more: float, told: bool) -> None:
    """Chance alone explains neither; but 0.0025 on nearer surfaces are within 0.002 of the mean of all."""
    of = replace(unit(29), min_range=0.3)
    rng = np.random.default_rng(0)
    seen = [cloud[rng.random(len(cloud)) > more * (np.linalg.norm(cloud.xyz, axis=1) < 5.0)] for cloud in clouds(of)]
    assert (ls.fit(seen, of)[1]["dropout"].verdict != "not measured") == told


def test_a_ground_that_fades_too_gradually_tells_no_limit() -> None:
    of = unit(7)
    rng = np.random.default_rng(0)
    seen = []
    for cloud in clouds(of):
        away = np.linalg.norm(cloud.xyz, axis=1)
        returned = rng.random(len(cloud)) < 1.0 - 0.14 * np.log(np.maximum(away / 2.0, 1.0))
        seen.append(cloud[returned | (cloud.xyz[:, 2] > -1.5)])
    fitted, comparison = ls.fit(seen, of)
    assert comparison["detection.range"].why == "the ground fades too gradually"
    assert fitted.measurement.detection is None


def test_a_curve_is_undone() -> None:
    """Counts tell the light up to where the curve is flat; of what is brighter, only a reflector is told apart."""
    of = unit(6)
    assert of.measurement.response is not None
    curve = [(0.0, 0.0), (0.2, 0.15), (1.0, 0.392), (785.0, 1.0)]
    response = replace(of.measurement.response, curve=curve, resolution=1 / 255, limit=1.0)
    of = replace(of, measurement=replace(of.measurement, response=response))
    begun = replace(start(of), measurement=ls.Measurement(response=ls.Response(curve=curve)))
    made = scene()
    made.add(ls.Box((2, 1, 2), (0, 9, 0)), material=ls.Material(reflectivity=4000.0))
    made.add(ls.Box((4, 4, 3), (-8, -2, 0)), material=ls.Material(reflectivity=4.0))
    seen = [scan.point_cloud() for scan in of.frames(made, None, FRAMES)]
    fitted, comparison = ls.fit(seen, begun, ground=GROUND)
    assert fitted.measurement.response is not None
    assert fitted.measurement.response.curve == response.curve
    assert comparison["response.sigma"].real == pytest.approx(response.sigma, rel=0.05)
    assert comparison["response.ring_sigma"].real == pytest.approx(response.ring_sigma, rel=0.3)
    ranges, factors = np.transpose(np.asarray(response.range))
    assert fitted.measurement.response.limit == pytest.approx(1.0, rel=1e-6)
    for cell in comparison["response.range"].cells:
        true = np.interp(float(cell.label.removesuffix(" m")), ranges, factors)
        assert cell.real == pytest.approx(true, rel=3 * response.ring_sigma / math.sqrt(2)), cell.label
    _, comparison = ls.fit([cloud[cloud.intensity < 0.393] for cloud in seen], begun)
    assert comparison["response.limit"].why == "the curve is flat there, so that intensities pile up"


def test_a_limit_shows_by_what_piles_up_at_it() -> None:
    """Of unit 24, nine times as many points have the greatest intensity as any other near it; of unit 0, one has it."""
    _, comparison = ls.fit(clouds(unit(24), 24), start(unit(24)))
    assert comparison["response.limit"].real == pytest.approx(0.6, rel=1e-6)
    _, comparison = ls.fit(clouds(unit(0)), start(unit(0)))
    assert comparison["response.limit"].why == "no intensities pile up at the greatest"


@pytest.mark.slow("a fitted sensor is alike in what the data sheet has otherwise")
def test_the_fitted_sensor_is_alike_where_the_sheet_differs() -> None:
    of = unit(7)
    told, kept = clouds(of, count=2), clouds(of, count=4)[2:]
    fitted, _ = ls.fit(told, start(of), ground=GROUND)
    names = ("range noise", "holes in smooth rings", "scatter of intensity", "range step")
    before, after = (ls.compare(kept, clouds(each, seed=9, count=2)) for each in (start(of), fitted))
    assert {before[name].verdict for name in names} == {"differs"}
    assert {after[name].verdict for name in names} <= {"alike", "cannot tell"}


def without(cloud: ls.PointCloud, *left_out: str, **changes: Any) -> ls.PointCloud:
    kept = {name: getattr(cloud, name) for name in ("xyz", "intensity", "ring", "column") if name not in left_out}
    return ls.PointCloud(kept | changes)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda cloud: without(cloud, "intensity"), {"response.limit": "the clouds have no intensity"}),
        (
            lambda cloud: without(cloud, intensity=np.zeros(len(cloud), np.float32)),
            {"response.sigma": "all intensities are 0", "response.ring_sigma": "all intensities are 0"},
        ),
        (
            lambda cloud: without(cloud[cloud.xyz[:, 2] > -1.5]),
            {"detection.range": "no ground is seen: no level plane of 500 points or more below the sensor"},
        ),
        (
            lambda cloud: without(
                cloud, xyz=cloud.xyz + np.random.default_rng(len(cloud)).normal(0, 3e-3, (len(cloud), 3))
            ),
            {"range_resolution": "ranges are no multiples of a common step from 0.5 to 50 mm"},
        ),
        (  # 2⁻²⁵, the step of float32 from 0.25 to 0.5
            lambda cloud: without(
                cloud, intensity=np.random.default_rng(len(cloud)).uniform(0.25, 0.5, len(cloud)).astype(np.float32)
            ),
            {"response.resolution": "intensities are no multiples of a common step"},
        ),
    ],
    ids=["no intensity", "dark", "no ground", "no step", "float32"],
)
def test_what_is_not_told_is_left(change: Callable[[ls.PointCloud], ls.PointCloud], why: dict[str, str]) -> None:
    of = unit(6)
    sheet = start(of)
    fitted, comparison = ls.fit(map(change, clouds(of, count=2)), sheet)
    for name, reason in why.items():
        assert comparison[name].verdict == "not measured"
        assert comparison[name].why == reason
        assert true_value(fitted, name) == true_value(sheet, name)
    assert comparison["range_sigma"].verdict == "differs"
    assert comparison["response.exponent"].why == "this takes targets of known reflectivities"


def test_noise_that_is_stronger_in_some_blocks_is_left() -> None:
    of = unit(6)
    response = ls.Response(sigma=0.1, sigma_block=1280)
    fitted, comparison = ls.fit(clouds(of), replace(of, measurement=ls.Measurement(response=response)))
    assert comparison["response.sigma"].why == "it is stronger in some blocks of pulses than in others"
    assert true_value(fitted, "response.sigma") == 0.1


def test_bad_input_is_one_line() -> None:
    of = unit(2)
    (cloud,) = clouds(of, count=1)
    few = without(cloud[:999])
    turned = without(cloud, ring=(len(ELEVATIONS) - 1 - cloud.ring).astype(np.uint16))
    in_mm = without(cloud, xyz=1000.0 * cloud.xyz)
    for real, sensor, message in (
        (in_mm, of, "real: expected frames of unit 2, which sees 120 m, got half of the points beyond "),
        (cloud, "hesai-xt32", "real: expected frames of hesai-xt32 with 32 rings, got ring 39"),
        (turned, of, "real: expected frames of unit 2, got points "),
        (few, of, "real: expected 1,000 points or more, got 999"),
        (cloud, 3, "sensor: expected a Lidar, the name of a preset or a file, got 3"),
        (cloud, "hesai-xt33", "preset: expected the name of a sensor, got 'hesai-xt33'"),
        (without(cloud, "ring"), ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0)), "real: expected frames of the"),
    ):
        with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}"):
            ls.fit(real, sensor)
    with pytest.raises(TypeError, match=r"^ground: expected a Material or None, got 'asphalt'"):
        ls.fit(cloud, of, ground="asphalt")  # type: ignore[arg-type]


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as left:
        main([*map(str, arguments)])
    return int(left.value.code or 0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    lidar = ls.Lidar.preset("velodyne-vlp16", noise="measured")
    noisy = replace(lidar, measurement=replace(lidar.measurement, range_sigma=0.03))
    (tmp_path / "real").mkdir()
    for i, cloud in enumerate(clouds(noisy, count=2)):
        cloud.save(tmp_path / "real" / f"{i}.pcd")
    return tmp_path


@pytest.mark.usefixtures("folder")
def test_the_command_writes_a_sensor(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("fit", "real", "-o", "mine.yaml", "--ground", "asphalt") == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert "sensor velodyne-vlp16, noise measured" in printed.out
    assert re.search(r"range_sigma +0\.008 +0\.0\d+ \[0\.0\d+, 0\.0\d+\] +m +[\d,]+\n", printed.out)
    assert re.search(r"response\.exponent +left: this takes targets of known reflectivities", printed.out)
    text = Path("mine.yaml").read_text(encoding="utf-8")
    assert re.search(r"range_sigma_m: 0\.0\d+  # 0\.0\d+ to 0\.0\d+; [\d,]+\n", text)
    assert "# Left: response.exponent: this takes targets of known reflectivities.\n" in text
    fitted, _ = ls.fit("real", "velodyne-vlp16", ground=ls.materials.ASPHALT)
    assert ls.Lidar.from_file("mine.yaml").measurement == fitted.measurement
    assert abs(fitted.measurement.range_sigma - 0.03) < 0.002  # type: ignore[operator]
    assert run("scan", "demo", "-o", "a.pcd", "--set", "sensor={file: mine.yaml}") == 0


@pytest.mark.usefixtures("folder")
def test_a_folder_of_any_name_is_named_in_a_comment() -> None:
    name = os.fsdecode(b"a\nname: b\xff")
    Path("real").rename(name)
    assert run("fit", name, "-o", "mine.yaml") == 0
    assert ls.Lidar.from_file("mine.yaml").name == "velodyne-vlp16"


@pytest.mark.usefixtures("folder")
def test_the_command_starts_from_a_file() -> None:
    own = Path("own #1 ü.yaml")
    own.write_text("preset: velodyne-vlp16\nname: mine\nmax_range_m: 80\n", encoding="utf-8")
    Path("out").mkdir()
    assert run("fit", "real", "-o", "out/fitted.yaml", "--preset", own) == 0
    fitted, _ = ls.fit("real", own)
    read = ls.Lidar.from_file("out/fitted.yaml")
    assert read.measurement == fitted.measurement
    assert (read.name, read.max_range) == ("mine", 80.0)


@pytest.mark.usefixtures("folder")
def test_the_command_does_not_overwrite_what_it_starts_from(capsys: pytest.CaptureFixture[str]) -> None:
    Path("own.yaml").write_text("preset: velodyne-vlp16\n", encoding="utf-8")
    assert run("fit", "real", "-o", "own.yaml", "--preset", "own.yaml") == 2
    assert "--output: expected another file than --preset, got own.yaml" in capsys.readouterr().err
    assert Path("own.yaml").read_text(encoding="utf-8") == "preset: velodyne-vlp16\n"


def test_tables_are_written_row_by_row() -> None:
    from lidarsim.cli.printing import format_fit

    of = replace(unit(4), name="velodyne-vlp16")
    fitted, comparison = ls.fit(clouds(of), start(of), ground=GROUND)
    text = format_fit(start(of), fitted, comparison, {})
    rows = re.findall(r"^  - (\[.+\])  # .+ to .+; [\d,]+$", text.split("channel_bias")[0], re.MULTILINE)
    assert rows == [str([*row]) for row in fitted.measurement.range_sigma]  # type: ignore[union-attr]
    assert len(rows) >= 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("real", "-o", "mine.pdf"), "mine.pdf: unknown extension '.pdf', expected .yaml or .yml"),
        (("nowhere.npz", "-o", "mine.yaml"), "nowhere.npz: no such file"),
        (("real", "-o", "a.yaml", "--preset", "vlp17"), "preset: expected the name of a sensor, got 'vlp17'"),
        (("real", "-o", "a.yaml", "--preset", "hesai-xt32"), "real: expected frames of hesai-xt32, got points"),
        (("real", "-o", "a.yaml", "--ground", "tarmac"), "--ground: expected the name of a material, got 'tarmac'"),
        (("flat.npz", "-o", "a.yaml"), "preset: expected the name of a sensor, got none; no preset has beams"),
        (
            ("few.npz", "-o", "a.yaml"),
            "real: expected 1,000 points or more in the first frame, got 999; of smaller frames, give the --preset",
        ),
        (("real",), "Missing option"),
    ],
)
def test_the_command_explains_a_mistake_in_a_line(
    folder: Path, arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, count in (("flat.npz", 2000), ("few.npz", 999)):
        ls.PointCloud({"xyz": np.ones((count, 3)), "ring": np.zeros(count, np.uint16)}).save(name)
    assert run("fit", *arguments) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""
    assert not list(folder.glob("*.yaml"))
