"""Measurement effects, each recovered from scans by the public API, and invalid parameters."""

from __future__ import annotations

import dataclasses
import math
import re
import statistics
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy import integrate, optimize, signal, stats
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim import _native
from lidarsim.scan.scan import scan as fire

Floats = npt.NDArray[np.float64]

POSE = RigidTransform.from_components([5.0, -3.0, 1.0], Rotation.from_euler("zyx", [2.0, 0.4, -0.7]))
"""Of a sensor that is turned about every axis."""

SIGMAS = 4.0
"""Confidence bounds of what is fitted: one fit in 16 000 lies outside."""

RETURNED = (
    "range",
    "true_range",
    "range_error",
    "intensity",
    "incidence",
    "normal",
    "object_id",
    "instance",
    "label",
    "true_direction",
)
"""The fields of a scan that have an entry for each return."""


def beams(directions: npt.ArrayLike, origins: npt.ArrayLike = (0.0, 0.0, 0.0), count: int = 1) -> ls.patterns.Table:
    directions = np.repeat(np.atleast_2d(directions), count, axis=0)
    origins = np.broadcast_to(origins, np.shape(directions) if np.ndim(origins) == 1 else np.shape(origins))
    return ls.patterns.Table(np.broadcast_to(directions, origins.shape), origins=origins, rate=10.0)


@dataclasses.dataclass(frozen=True)
class Along:
    """Pulses from the origin in directions that stay as they are; a `Table` makes them unit vectors."""

    directions: Floats
    rate: float = 10.0

    @property
    def shape(self) -> tuple[int, int]:
        return (1, len(self.directions))

    def pulses(self, frame: int = 0) -> ls.patterns.Pulses:
        pulses = beams([1.0, 0.0, 0.0], count=len(self.directions)).pulses(frame)
        return dataclasses.replace(pulses, directions=self.directions)


def before_wall(ranges: npt.ArrayLike) -> ls.patterns.Table:
    """Pulses at right angles to the plane x = 0, each from its own distance."""
    distances = np.asarray(ranges, dtype=float)
    return beams(np.tile([1.0, 0.0, 0.0], (len(distances), 1)), np.outer(distances, [-1.0, 0.0, 0.0]))


def wall(reflectivity: float = 1.0) -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 0.0), material=ls.Material(reflectivity=reflectivity))
    return scene


def measure(pattern: ls.patterns.Pattern, scene: ls.Scene, *, seed: int = 3, **parameters: Any) -> ls.Scan:
    gate = {name: parameters.pop(name) for name in ("min_range", "max_range") if name in parameters}
    return ls.Lidar(pattern, measurement=ls.Measurement(**parameters), **gate).scan(scene, seed=seed)


# Nothing asked for


def test_without_effects_the_range_is_the_truth() -> None:
    ranges = np.linspace(0.1, 300.0, 1000)
    scan = measure(before_wall(ranges), wall(0.25))
    assert (scan.status == ls.Status.hit).all()
    assert np.array_equal(scan.range[:, 0], ranges)
    assert np.array_equal(scan.true_range, scan.range)
    assert not scan.range_error.any()
    assert (scan.intensity == 0.25).all()
    assert not scan.incidence.any()


def test_nothing_is_added_to_a_miss() -> None:
    everything = {
        "range_sigma": 1.0, "range_bias": 1.0, "range_resolution": 0.1, "azimuth_sigma": 0.01, "elevation_sigma": 0.01,
        "dropout": 0.5, "detection": ls.Detection(0.1, 10.0), "extinction": 0.1, "power_sigma": 0.5,
        "beam": ls.Beam(0.1), "returns": 3,
    }  # fmt: skip
    scan = measure(beams([-1.0, 0.0, 0.0], (-5.0, 0.0, 0.0), count=1000), wall(), **everything)
    assert (scan.status == ls.Status.miss).all()
    assert scan.range.shape == (1000, 3)
    for name in ("range", "true_range", "range_error", "intensity", "normal", "incidence"):
        assert np.isnan(getattr(scan, name)).all(), name
    assert (scan.object_id == -1).all()
    assert not scan.label.any()
    assert not scan.return_count.any()
    assert len(scan.point_cloud()) == 0


# Range


def test_range_noise_gives_back_its_constants() -> None:
    a, b = 0.02, 1e-3
    distances = np.geomspace(1.0, 100.0, 25)
    count = 8000
    scan = measure(before_wall(np.repeat(distances, count)), wall(), range_sigma=a, range_sigma_slope=b)
    cloud = scan.point_cloud()
    variances = cloud.range_error.reshape(-1, count).var(axis=1, ddof=1)
    # σ² = a² + b²R² is linear in R²; the variance of a sample variance is 2σ⁴/(n−1). Weights from a first fit, then
    # from that.
    design = np.column_stack([np.ones_like(distances), distances**2])
    fit = np.array([a**2, b**2])
    for _ in range(3):
        spread = design @ fit * math.sqrt(2.0 / (count - 1))
        covariance = np.linalg.inv((design / spread[:, None] ** 2).T @ design)
        fit = covariance @ (design / spread[:, None] ** 2).T @ variances
    errors = np.sqrt(np.diag(covariance))
    assert (errors < [0.02 * a**2, 0.02 * b**2]).all()
    assert (np.abs(fit - [a**2, b**2]) < SIGMAS * errors).all()


def test_range_noise_follows_a_table() -> None:
    table = [(1.0, 0.01), (10.0, 0.01), (10.5, 0.03), (30.0, 0.05)]
    distances = np.array([0.5, 1.0, 5.0, 10.0, 10.25, 20.0, 30.0, 80.0])
    count = 20_000
    scan = measure(before_wall(np.repeat(distances, count)), wall(), range_sigma=table)
    sigmas = scan.range_error.reshape(-1, count).std(axis=1)
    expected = np.interp(distances, *np.transpose(table))
    assert (np.abs(sigmas / expected - 1.0) < SIGMAS / math.sqrt(2 * count)).all()


@pytest.mark.parametrize("beam", [None, ls.Beam(0.0, rays=7)], ids=["ray", "beam"])
@pytest.mark.parametrize("table", [False, True], ids=["formula", "table"])
def test_weak_echoes_are_noisier(table: bool, beam: ls.Beam | None) -> None:
    a, b, c, count = 0.01, 2e-4, 0.05, 20_000
    distances = np.array([1.0, 10.0, 30.0, 60.0, 90.0, 99.99])
    strong = {"range_sigma": [(1.0, 0.01), (100.0, 0.03)]} if table else {"range_sigma": a, "range_sigma_slope": b}
    limit = ls.Detection(0.1, 100.0)
    pattern = before_wall(np.repeat(distances, count))
    scan = measure(pattern, wall(0.1), range_sigma_limit=c, detection=limit, beam=beam, **strong)
    assert (scan.status == ls.Status.hit).all()
    sigmas = scan.range_error.reshape(-1, count).std(axis=1)
    variance = np.interp(distances, [1.0, 100.0], [0.01, 0.03]) ** 2 if table else a**2 + (b * distances) ** 2
    # The wall is the data sheet's target, so s = (100 m/R)².
    expected = np.sqrt(variance + c**2 * (distances / 100.0) ** 2)
    assert (np.abs(sigmas / expected - 1.0) < 5.0 / math.sqrt(2 * count)).all()
    # Of equal draws, the errors differ by the standard deviation alone.
    calm = measure(pattern, wall(0.1), detection=limit, beam=beam, **strong)
    ratio = scan.range_error[:, 0] / calm.range_error[:, 0]
    # Errors are differences of ranges below 128 m, each rounded by 2⁻⁴⁷: compared where they are at least 10⁻³ m.
    clear = np.abs(calm.range_error[:, 0]) > 1e-3
    assert clear.mean() > 0.8
    bound = 4 * 2.0**-47 / 1e-3
    assert np.allclose(ratio[clear], np.repeat(expected / np.sqrt(variance), count)[clear], rtol=bound, atol=0)


def test_the_limit_of_range_noise_alone_is_noise_too() -> None:
    count = 20_000
    parameters = {"range_sigma_limit": 0.05, "detection": ls.Detection(0.1, 100.0)}
    scan = measure(before_wall(np.full(count, 50.0)), wall(0.1), **parameters)
    assert abs(scan.range_error.std() / 0.025 - 1.0) < 5.0 / math.sqrt(2 * count)
    # What fluctuates and what the air weakens is the power that counts.
    foggy = measure(before_wall(np.full(count, 50.0)), wall(0.1), extinction=0.01, **parameters)
    assert abs(foggy.range_error.std() / (0.025 * math.exp(0.5)) - 1.0) < 5.0 / math.sqrt(2 * count)
    fluctuating = measure(before_wall(np.full(count, 50.0)), wall(0.1), power_sigma=0.2, **parameters)
    seen = fluctuating.status == ls.Status.hit
    factors = fluctuating.intensity[seen, 0].astype(float) / 0.1
    draws = scan.range_error[seen, 0] / 0.025
    expected = 0.025 / np.sqrt(factors) * draws
    # Half of an ulp of a float32 in the intensity; the ranges are rounded by 2⁻⁴⁸ each.
    assert np.allclose(fluctuating.range_error[seen, 0], expected, rtol=2.0**-24, atol=2.0**-45)


def test_bias_is_added() -> None:
    scan = measure(before_wall(np.full(10_000, 20.0)), wall(), range_bias=-0.05)
    assert np.array_equal(scan.range[:, 0], np.full(10_000, 20.0 - 0.05))
    noisy = measure(before_wall(np.full(10_000, 20.0)), wall(), range_bias=-0.05, range_sigma=0.02)
    assert abs(noisy.range_error.mean() + 0.05) < SIGMAS * 0.02 / 100.0


def test_ranges_are_quantised_last() -> None:
    step = 0.004
    scan = measure(before_wall(np.full(50_000, 20.0)), wall(), range_sigma=0.05, range_resolution=step)
    counts = scan.range[:, 0] / step
    assert np.array_equal(np.rint(counts) * step, scan.range[:, 0])
    assert len(np.unique(counts)) > 50
    exact = measure(before_wall(np.full(50_000, 20.0)), wall(), range_sigma=0.05)
    rest = scan.range - exact.range
    assert np.abs(rest).max() <= step / 2 * (1 + 1e-9)
    assert stats.kstest(rest[:, 0] / step + 0.5, "uniform").pvalue > 1e-3


def test_halves_are_rounded_to_even() -> None:
    scan = measure(before_wall([0.25, 0.75, 1.25, 1.75]), wall(), range_resolution=0.5)
    assert scan.range[:, 0].tolist() == [0.0, 1.0, 1.0, 2.0]


# Range gate


def test_the_gate_is_that_of_the_lidar() -> None:
    ranges = [0.5, math.nextafter(1.0, 0.0), 1.0, 5.0, 9.0, math.nextafter(9.0, 10.0), 20.0]
    scan = measure(before_wall(ranges), wall(), min_range=1.0, max_range=9.0)
    below, hit, beyond = ls.Status.below_min_range, ls.Status.hit, ls.Status.beyond_max_range
    assert scan.status.tolist() == [below, below, hit, hit, hit, beyond, beyond]
    assert np.isnan(scan.range[scan.status != hit]).all()
    assert scan.true_range[:, 0].tolist() == ranges


def test_what_noise_puts_out_of_the_gate_is_not_reported() -> None:
    count = 20_000
    near = measure(before_wall(np.full(count, 0.5)), wall(), range_sigma=0.5)
    below = near.status == ls.Status.below_min_range
    assert stats.binomtest(int(below.sum()), count, stats.norm.cdf(-1.0)).pvalue > 1e-3
    assert np.isnan(near.range[below]).all()
    assert np.nanmin(near.range) >= 0.0
    far = measure(before_wall(np.full(count, 49.5)), wall(), range_sigma=0.5, max_range=50.0)
    beyond = far.status == ls.Status.beyond_max_range
    assert stats.binomtest(int(beyond.sum()), count, stats.norm.cdf(-1.0)).pvalue > 1e-3
    assert np.nanmax(far.range) <= 50.0


@pytest.mark.parametrize(
    ("truth", "gate", "inside"),
    [
        (0.395, {"min_range": 0.4}, stats.norm.sf(0.005 / 0.03)),
        (50.01, {"max_range": 50.0}, stats.norm.cdf(-0.01 / 0.03)),
    ],
)
def test_the_gate_acts_on_what_is_measured(truth: float, gate: dict[str, float], inside: float) -> None:
    count = 20_000
    scan = measure(before_wall(np.full(count, truth)), wall(), range_sigma=0.03, **gate)
    hits = int((scan.status == ls.Status.hit).sum())
    assert stats.binomtest(hits, count, inside).pvalue > 1e-3


def test_the_gate_comes_last() -> None:
    """What rounds to the limit is inside; what is below the threshold or dropped is so, wherever it is."""
    ranges = [0.94, 0.96, 9.04, 9.06]
    scan = measure(before_wall(ranges), wall(), range_resolution=0.1, min_range=1.0, max_range=9.0)
    below, hit, beyond = ls.Status.below_min_range, ls.Status.hit, ls.Status.beyond_max_range
    assert scan.status.tolist() == [below, hit, hit, beyond]
    far = {"max_range": 5.0, "detection": ls.Detection(0.1, 5.0)}
    assert measure(before_wall([9.0]), wall(0.1), **far).status.tolist() == [ls.Status.below_threshold]
    assert measure(before_wall([9.0]), wall(), dropout=1.0, max_range=5.0).status.tolist() == [ls.Status.dropped]


# Biases and zeros of the channels


def rings_before_wall(rings: int, columns: int, distance: float = 20.0) -> ls.patterns.Table:
    """Pulses at right angles to the plane x = 0, those of a ring one after the other."""
    directions = np.tile([1.0, 0.0, 0.0], (rings * columns, 1))
    ring = np.repeat(np.arange(rings), columns)
    return ls.patterns.Table(directions, origins=directions * -distance, rings=ring, rate=10.0)


def test_a_channel_has_one_bias_in_all_frames() -> None:
    lidar = ls.Lidar(rings_before_wall(64, 16), measurement=ls.Measurement(channel_bias_sigma=0.02), name="unit")
    errors = lidar.scan(wall(), seed=3).range_error.reshape(64, 16)
    assert (errors == errors[:, :1]).all()
    assert len(np.unique(errors)) == 64
    for frame in (1, 9, 2**32 - 1):
        assert np.array_equal(lidar.scan(wall(), seed=3, frame=frame).range_error.reshape(64, 16), errors)
    for other in (dataclasses.replace(lidar, name="other").scan(wall(), seed=3), lidar.scan(wall(), seed=4)):
        assert not (other.range_error.reshape(64, 16) == errors).any()
    draws = [uniform(3, "unit", frame=0, pulse=ring, effect=4) for ring in range(64)]
    expected = 0.02 * np.array([statistics.NormalDist().inv_cdf(u) for u in draws])
    # 20 m and the bias are added and subtracted: two roundings of numbers near 20.
    assert np.allclose(errors[:, 0], expected, rtol=0, atol=2 * math.ulp(20.0))


def test_biases_of_channels_are_gaussian_and_beside_the_noise() -> None:
    count = 60_000
    pattern = rings_before_wall(count, 1)
    biases = measure(pattern, wall(), channel_bias_sigma=0.5).range_error[:, 0]
    assert stats.kstest(biases / 0.5, "norm").pvalue > 1e-3
    noise = measure(pattern, wall(), range_sigma=0.5).range_error[:, 0]
    both = measure(pattern, wall(), range_sigma=0.5, channel_bias_sigma=0.5, range_bias=1.0).range_error[:, 0]
    # A few roundings of numbers near 20.
    assert np.allclose(both, noise + biases + 1.0, rtol=0, atol=8 * math.ulp(20.0))
    assert abs(np.corrcoef(noise, biases)[0, 1]) < SIGMAS / math.sqrt(count)


def test_the_sensors_own_range_is_what_is_rounded_and_gated() -> None:
    ranges = np.array([0.96, 0.99, 4.987, 7.5, 8.97, 8.99])
    lidar = ls.Lidar(
        before_wall(ranges), min_range=1.0, max_range=9.0, range_offset=0.025,
        measurement=ls.Measurement(range_resolution=0.01),
    )  # fmt: skip
    scan = lidar.scan(wall())
    below, hit, beyond = ls.Status.below_min_range, ls.Status.hit, ls.Status.beyond_max_range
    assert scan.status.tolist() == [below, hit, hit, hit, hit, beyond]
    own = scan.range[1:-1, 0] + 0.025
    assert np.allclose(own, np.rint((ranges[1:-1] + 0.025) * 100) / 100, rtol=0, atol=2 * math.ulp(9.0))
    # The points stay where the surface is, to half of a step.
    assert np.abs(scan.range_error[1:-1]).max() <= 0.005 + 2 * math.ulp(9.0)
    still = dataclasses.replace(lidar, measurement=ls.Measurement()).scan(wall())
    assert np.allclose(still.range[1:-1, 0], ranges[1:-1], rtol=0, atol=math.ulp(9.0))


def test_each_ring_has_its_own_zero() -> None:
    offsets = [0.0, 0.012, -0.028]
    pattern = rings_before_wall(3, 4)
    lidar = ls.Lidar(pattern, range_offset=np.array(offsets), measurement=ls.Measurement(range_resolution=1.0))
    scan = lidar.scan(wall())
    assert np.allclose(scan.range.reshape(3, 4).T, 20.0 - np.array(offsets), rtol=0, atol=2 * math.ulp(20.0))
    some = fire(lidar, wall(), indices=[5, 1])
    assert np.array_equal(some.range, scan.range[[5, 1]])


def test_each_ring_has_its_own_bias() -> None:
    biases = np.array([0.0, 0.012, -0.028])
    pattern = rings_before_wall(3, 5)
    scan = measure(pattern, wall(), range_bias=biases)
    assert np.array_equal(scan.range[:, 0], scan.true_range[:, 0] + np.repeat(biases, 5))
    assert np.array_equal(measure(pattern, wall(), range_bias=0.25).range[:, 0], scan.true_range[:, 0] + 0.25)
    drawn = measure(pattern, wall(), channel_bias_sigma=0.5).range[:, 0] - scan.true_range[:, 0]
    both = measure(pattern, wall(), range_bias=biases, channel_bias_sigma=0.5).range[:, 0] - scan.true_range[:, 0]
    assert np.allclose(both, drawn + np.repeat(biases, 5), rtol=0, atol=4 * math.ulp(20.0))
    assert np.abs(drawn).min() > 0.01


def test_a_pulse_is_measured_alone_as_it_is_among_others() -> None:
    # 29 pulses, which is no multiple of eight, as far as and beyond the gate and the detection; some miss.
    pattern = before_wall(np.r_[np.geomspace(0.5, 300.0, 25), -1.0, 3.0, -2.0, 4.0])
    measurement = ls.Measurement(
        range_sigma=0.02,
        range_sigma_slope=1e-3,
        range_bias=0.01,
        range_resolution=0.004,
        elevation_sigma=1e-4,
        dropout=0.2,
        detection=ls.Detection(0.5, 60.0),
        extinction=1e-3,
    )
    lidar = ls.Lidar(pattern, measurement=measurement, min_range=1.0, max_range=200.0, range_offset=0.025)
    most = ls.Lidar(pattern, measurement=dataclasses.replace(measurement, detection=None), max_range=200.0)
    seen = set()
    for sensor in (lidar, most):
        scan = sensor.scan(wall(0.5), seed=4)
        seen |= set(scan.status.tolist())
        for i in range(29):
            alone = fire(sensor, wall(0.5), seed=4, indices=[i])
            for name in (*RETURNED, "status", "return_count"):
                assert getattr(alone, name)[0].tobytes() == getattr(scan, name)[i].tobytes(), (i, name)
    assert seen == set(ls.Status)


# Angles


@pytest.mark.parametrize("name", ["azimuth_sigma", "elevation_sigma"])
def test_angular_noise_is_recovered_from_a_grazing_plane(name: str) -> None:
    sigma, grazing, height, count = 5e-4, math.radians(5.0), 2.0, 100_000
    scene = ls.Scene()
    sin, cos = math.sin(grazing), math.cos(grazing)
    if name == "azimuth_sigma":
        scene.add(ls.Plane((0, 1, 0), height))
        direction = [cos, sin, 0.0]
    else:
        scene.add(ls.Plane((0, 0, 1), height))
        direction = [cos, 0.0, sin]
    cloud = measure(beams(direction, count=count), scene, **{name: sigma}).point_cloud()
    # The points lie on the nominal ray, at the range where the true one met the plane.
    assert np.allclose(cloud.xyz / cloud.range[:, None], direction, rtol=0, atol=2.0**-51)  # four roundings
    errors = np.arcsin(height / cloud.range) - grazing
    assert abs(errors.std() / sigma - 1.0) < SIGMAS / math.sqrt(2 * count)
    assert abs(errors.mean()) < SIGMAS * sigma / math.sqrt(count)
    assert np.array_equal(cloud.range, cloud.true_range)
    other = "elevation_sigma" if name == "azimuth_sigma" else "azimuth_sigma"
    still = measure(beams(direction, count=1000), scene, **{other: sigma}).point_cloud()
    # Across the plane's slope the range changes by the square of the angle, or with its cosine.
    assert still.range.std() < 10 * sigma**2 * still.range.mean()


def test_azimuth_noise_shrinks_towards_the_pole_and_does_nothing_at_it() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 1), 10.0))
    straight_up = measure(beams([0.0, 0.0, 1.0], count=100), scene, azimuth_sigma=0.01)
    assert np.array_equal(straight_up.range, np.full((100, 1), 10.0))
    spread = [
        measure(beams([0.0, math.cos(e), math.sin(e)], count=10_000), scene, azimuth_sigma=0.01).range.std()
        / (10.0 * math.cos(e) / math.sin(e) ** 2)
        for e in (0.8, 1.5)
    ]
    # dR/d(azimuth) = R²·cos(e)/10 with R = 10/sin(e), at azimuth 90°.
    assert np.allclose(spread, 0.01, rtol=SIGMAS / math.sqrt(2 * 10_000) + 0.01)


# Intensity and detection


def test_intensity_is_lamberts() -> None:
    angles = np.linspace(0.0, 1.5, 50)
    directions = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    scene, alpha = wall(0.6), 0.01
    origin = (-10.0, 0.0, 0.0)
    scan = measure(beams(directions, np.tile(origin, (50, 1))), scene, extinction=alpha)
    expected = 0.6 * np.cos(angles) * np.exp(-2 * alpha * 10.0 / np.cos(angles))
    assert np.allclose(scan.intensity[:, 0], expected, rtol=2.0**-23, atol=0)
    assert np.allclose(scan.incidence[:, 0], angles, rtol=2.0**-23, atol=2.0**-51)  # a float32 of a sine and a cosine


def test_a_retro_reflector_exceeds_one() -> None:
    assert measure(before_wall([10.0]), wall(300.0)).intensity.tolist() == [[300.0]]


def test_both_sides_of_a_surface_return_light() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 5.0), material=ls.Material(reflectivity=0.5))
    scan = measure(beams([1.0, 0.0, 0.0]), scene)
    assert scan.intensity.tolist() == [[0.5]]
    assert scan.incidence.tolist() == [[0.0]]
    assert scan.normal.tolist() == [[[1.0, 0.0, 0.0]]]


def backscatter(theta: mpmath.mpf, roughness: float, specular: float, width: float) -> mpmath.mpf:
    """f(θ) as it is documented."""
    square = mpmath.mpf(roughness) ** 2
    a, b = 1 - 0.5 * square / (square + mpmath.mpf("0.33")), mpmath.mpf("0.45") * square / (square + mpmath.mpf("0.09"))
    lobe = mpmath.exp(-((mpmath.tan(theta) / width) ** 2)) / mpmath.cos(theta) ** 5
    return a * mpmath.cos(theta) + b * mpmath.sin(theta) ** 2 + specular * lobe


@pytest.mark.parametrize("beam", [None, ls.Beam(0.0, rays=7)], ids=["ray", "beam"])
@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.5, math.pi / 2])
@pytest.mark.parametrize(("specular", "width"), [(0.0, 0.1), (0.5, 0.1), (300.0, 0.02), (3.0, 1.0)])
def test_rough_and_glossy_surfaces_follow_their_formula(
    beam: ls.Beam | None, roughness: float, specular: float, width: float
) -> None:
    angles = np.r_[0.0, np.geomspace(1e-6, 1.5, 120), 1.57, math.pi / 2 - 1e-6]
    directions = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    scene = ls.Scene()
    material = ls.Material(reflectivity=0.6, roughness=roughness, specular=specular, specular_width=width)
    scene.add(ls.Plane((1, 0, 0), 0.0), material=material)
    scan = measure(beams(directions, np.tile((-1.0, 0.0, 0.0), (len(angles), 1))), scene, beam=beam)
    # With u = 2⁻⁵³: the slope is rounded four times, so the exponent q is off by 8u·q and the highlight by (8q + 10)u.
    # Where q > 40 it is below 2⁻³⁶ of A·cos θ for all of these parameters, and its error less than u of the sum. The
    # rest rounds 12 times at most, 7 equal sub-rays 14 times more. Then the intensity becomes a float32.
    bound = 2.0**-24 + (8 * 40 + 36) * 2.0**-53
    with mpmath.workdps(40):
        for direction, found in zip(scan.pulses.directions, scan.intensity[:, 0], strict=True):
            theta = mpmath.atan2(mpmath.mpf(direction[1]), mpmath.mpf(direction[0]))
            expected = mpmath.mpf(0.6) * backscatter(theta, roughness, specular, width)
            assert abs(mpmath.mpf(float(found)) / expected - 1) <= bound, (direction, float(expected))
    if not roughness and not specular:
        smooth = measure(beams(directions, np.tile((-1.0, 0.0, 0.0), (len(angles), 1))), wall(0.6), beam=beam)
        assert scan.intensity.tobytes() == smooth.intensity.tobytes()


def test_each_object_returns_light_in_its_own_way() -> None:
    scene = ls.Scene()
    materials = [
        ls.Material(reflectivity=0.5),
        ls.Material(reflectivity=0.5, roughness=0.4),
        ls.Material(reflectivity=0.5, specular=2.0),
    ]
    for i, material in enumerate(materials):
        scene.add(ls.Sphere((10, 4.0 * i, 0), 1.5), material=material)
    pattern = ls.patterns.Grid(np.linspace(-0.3, 0.9, 200), np.linspace(-0.2, 0.2, 20), rate=10.0)
    scan = ls.Lidar(pattern).scan(scene)
    for i, material in enumerate(materials):
        alone = ls.Scene()
        alone.add(ls.Sphere((10, 4.0 * i, 0), 1.5), material=material)
        seen = scan.object_id[:, 0] == i
        assert seen.sum() > 50
        assert np.array_equal(scan.intensity[seen], ls.Lidar(pattern).scan(alone).intensity[seen])
    lambert = scan.object_id[:, 0] == 0
    cosines = np.cos(scan.incidence[lambert, 0].astype(float))
    # The incidence is a float32: at most 2⁻²⁴·π/2 of an angle, and so of its cosine.
    assert np.allclose(scan.intensity[lambert, 0], 0.5 * cosines, rtol=2.0**-24, atol=2.0**-23)


def test_a_brighter_surface_is_detected_farther() -> None:
    ranges = np.linspace(1.0, 400.0, 20_000)
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 0.0), material=ls.Material(reflectivity=0.1, specular=3.0, roughness=0.2))
    expected = 100.0 * math.sqrt(float(backscatter(mpmath.mpf(0), 0.2, 3.0, 0.1)))
    seen_to = last_range(measure(before_wall(ranges), scene, detection=ls.Detection(0.1, 100.0)))
    assert expected - (ranges[1] - ranges[0]) <= seen_to <= expected


def last_range(scan: ls.Scan) -> float:
    """The last range that is seen; none after the first that is not."""
    seen = scan.status == ls.Status.hit
    last = int(seen.sum())
    assert 10 < last < len(seen) - 10
    assert seen[:last].all()
    assert (scan.status[last:] == ls.Status.below_threshold).all()
    return float(scan.true_range[last - 1, 0])


def test_detection_cuts_exactly_at_its_range() -> None:
    ranges = [math.nextafter(150.0, 0.0), 150.0, math.nextafter(150.0, 151.0)]
    scan = measure(before_wall(ranges), wall(0.1), detection=ls.Detection(0.1, 150.0))
    assert scan.status[:2].tolist() == [ls.Status.hit, ls.Status.hit]
    # One ulp further the quotient I/R² may still round to the same.
    further = measure(before_wall([150.0 * (1 + 1e-15)]), wall(0.1), detection=ls.Detection(0.1, 150.0))
    assert further.status.tolist() == [ls.Status.below_threshold]


@pytest.mark.parametrize("reflectivity", [0.02, 0.1, 0.8, 5.0])
@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2])
@pytest.mark.parametrize("extinction", [0.0, 2e-3])
def test_detection_cuts_where_it_should(reflectivity: float, angle: float, extinction: float) -> None:
    least, seen_to = 0.1, 100.0
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    ranges = np.linspace(1.0, 1000.0, 20_000)
    pattern = beams(np.tile(direction, (len(ranges), 1)), -np.outer(ranges, direction))
    scan = measure(pattern, wall(reflectivity), detection=ls.Detection(least, seen_to), extinction=extinction)

    def excess(r: float) -> float:
        in_clear_air = least / seen_to**2
        return reflectivity * math.cos(angle) * math.exp(-2 * extinction * r) / r**2 - in_clear_air

    expected = optimize.brentq(excess, 1.0, 1000.0, xtol=1e-9)
    step = ranges[1] - ranges[0]
    assert expected - step <= last_range(scan) <= expected


def test_extinction_only_ever_hides() -> None:
    """The denser the air, the fewer echoes are seen, and none that was not seen before."""
    generator = np.random.default_rng(5)
    directions = generator.normal(size=(300, 3))
    limit = ls.Detection(0.1, 12.0)
    hidden = kept = 0
    for number in range(20):
        scene = ls.Scene()
        for _ in range(60):
            material = ls.Material(reflectivity=float(generator.uniform(0.02, 1.0)))
            scene.add(ls.Sphere(generator.uniform(-20, 20, 3), 1.5), material=material)
        for beam, returns in ((None, 1), (ls.Beam(0.1, pulse_length=2e-9, rays=37), 37)):
            pattern = beams(directions / np.linalg.norm(directions, axis=1)[:, None])
            before = None
            for extinction in (0.0, 1e-3, 0.01, 0.03, 0.1):
                parameters = {"detection": limit, "extinction": extinction, "beam": beam, "returns": returns}
                scan = measure(pattern, scene, seed=number, **parameters)
                if before is not None:
                    assert (scan.return_count <= before.return_count).all()
                    hidden += int((before.return_count - scan.return_count).sum())
                    kept += int(scan.return_count.sum())
                before = scan
    assert hidden > 500
    assert kept > 500


def test_a_dark_wall_is_seen_no_better_through_fog() -> None:
    for extinction in (0.0, 0.03):
        scan = measure(before_wall([60.0]), wall(0.02), detection=ls.Detection(0.1, 100.0), extinction=extinction)
        assert scan.status.tolist() == [ls.Status.below_threshold]


@pytest.mark.parametrize("beam", [None, ls.Beam(0.0, rays=7)], ids=["ray", "beam"])
def test_the_overlap_dims_what_is_near(beam: ls.Beam | None) -> None:
    near, far = 0.7, 2.9
    ranges = np.r_[0.0, np.linspace(0.01, 5.0, 400), near, far, math.nextafter(far, 0.0)]
    plain = measure(before_wall(ranges), wall(0.5), extinction=0.01, beam=beam)
    scan = measure(before_wall(ranges), wall(0.5), extinction=0.01, beam=beam, crossover=(near, far))
    assert np.array_equal(scan.range, plain.range)
    assert (scan.status == ls.Status.hit).all()
    overlap = np.clip((ranges - near) / (far - near), 0.0, 1.0)
    # Both intensities are rounded to float32.
    assert np.allclose(scan.intensity[:, 0], overlap * plain.intensity[:, 0], rtol=2.0**-22, atol=0)
    assert not scan.intensity[ranges <= near].any()
    assert np.array_equal(scan.intensity[ranges >= far], plain.intensity[ranges >= far])
    limit = ls.Detection(0.1, 100.0)
    seen = measure(before_wall(ranges), wall(0.5), detection=limit, beam=beam, crossover=(near, far)).status
    # Above 0 the wall is far brighter than the limit, but for the first 10⁻⁵ of the way.
    assert np.array_equal(seen == ls.Status.hit, ranges > near)
    assert (seen[ranges <= near] == ls.Status.below_threshold).all()


def test_a_near_surface_out_of_the_overlap_shades_but_does_not_shine() -> None:
    # Half of the footprint ends at a post at 20 m, the other half at the wall 3 m behind it.
    pattern, beam = beams([1.0, 0.0, 0.0], count=10), ls.Beam(4e-3, pulse_length=SLOW_PULSE)
    both = measure(pattern, edge(3.0), beam=beam, returns=2)
    assert (both.return_count == 2).all()
    scan = measure(pattern, edge(3.0), beam=beam, returns=2, crossover=(20.5, 21.5), detection=ls.Detection(0.1, 99.0))
    assert (scan.return_count == 1).all()
    assert (scan.label[:, 0] == 2).all()
    assert np.allclose(scan.intensity[:, 0], both.intensity[:, 1], rtol=2.0**-22, atol=0)


@pytest.mark.parametrize("beam", [None, ls.Beam(0.0, rays=7)], ids=["ray", "beam"])
def test_near_the_sensor_an_echo_needs_a_least_intensity(beam: ls.Beam | None) -> None:
    # 0.1 at 100 m is as much power as 0.004 at 20 m: up to there the least intensity is 0.004, from there on it grows.
    ranges = np.geomspace(0.1, 90.0, 400)
    for reflectivity, last in ((0.0039, 0.0), (0.0041, 20.0 * math.sqrt(0.0041 / 0.004)), (0.05, 100 * math.sqrt(0.5))):
        scan = measure(
            before_wall(ranges), wall(reflectivity), beam=beam, near_threshold=0.004, detection=ls.Detection(0.1, 100.0)
        )
        assert (scan.status == ls.Status.hit).tolist() == (ranges < last).tolist()
        assert (scan.status[ranges > last] == ls.Status.below_threshold).all()
    # Without a detection limit, up to the range where that of 0.1 at the greatest range begins.
    seen = measure(before_wall(ranges), wall(0.0039), beam=beam, near_threshold=0.004, max_range=100.0)
    assert (seen.status == ls.Status.hit).tolist() == (ranges >= 20.0).tolist()


def test_near_the_sensor_the_gain_rises_with_range() -> None:
    # A pane of 0.1 at 5 m and a wall of 0.2 at 15 m, both where the gain compensates 1/R²: the wall is the stronger.
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 5.0), material=ls.Material(reflectivity=0.1, transmission=1.0))
    scene.add(ls.Plane((1, 0, 0), 15.0), material=ls.Material(reflectivity=0.2))
    limit = ls.Detection(0.1, 100.0)
    for near, strongest in ((0.0, 5.0), (0.004, 15.0)):
        scan = measure(beams([1.0, 0.0, 0.0]), scene, depth=2, detection=limit, near_threshold=near)
        assert scan.range.tolist() == [[strongest]]
    # And the noise of weak echoes depends on it: at 2 m as at 20 m.
    noise = {"range_sigma_limit": 0.1, "detection": limit, "near_threshold": 0.004}
    errors = [measure(before_wall(np.full(4000, at)), wall(0.016), **noise).range_error for at in (2.0, 20.0)]
    for error in errors:
        assert error.std() == pytest.approx(0.1 / 2, rel=SIGMAS / math.sqrt(2 * 4000))


# The response


@pytest.mark.parametrize("beam", [None, ls.Beam(0.0, rays=7)], ids=["ray", "beam"])
def test_a_response_is_its_formula(beam: ls.Beam | None) -> None:
    ranges = np.linspace(0.5, 30.0, 60)
    response = ls.Response(range=[(1.0, 0.25), (5.0, 1.0), (20.0, 2.0)], exponent=0.7, resolution=1 / 255, limit=0.9)
    scan = measure(before_wall(ranges), wall(0.6), beam=beam, response=response)
    light = 0.6 * np.interp(ranges, [1.0, 5.0, 20.0], [0.25, 1.0, 2.0])
    expected = np.minimum(np.rint(light**0.7 * 255) / 255, 0.9)
    assert len(np.unique(expected)) > 20
    assert np.allclose(scan.intensity[:, 0], expected, rtol=2.0**-23, atol=0)
    assert measure(before_wall(ranges), wall(0.0), beam=beam, response=response).intensity.max() == 0.0


def test_a_response_has_a_curve() -> None:
    ranges = np.linspace(0.5, 30.0, 600)
    light = 2.0 * np.interp(ranges, [1.0, 20.0], [0.0, 4.0])
    curve, factors = [(0.1, 0.05), (1.0, 0.4), (6.0, 1.0)], [(1.0, 0.0), (20.0, 4.0)]
    response = ls.Response(range=factors, exponent=0.7, curve=curve, resolution=1 / 255, limit=0.99)
    scan = measure(before_wall(ranges), wall(2.0), response=response)
    expected = np.minimum(np.rint(np.interp(light**0.7, *np.transpose(curve)) * 255) / 255, 0.99)
    assert np.allclose(scan.intensity[:, 0], expected, rtol=2.0**-23, atol=0)
    # The noise is of the light: a fifth of that of 2 is seen where the curve rises by a fifth.
    noisy = ls.Response(sigma=0.01, curve=[(0.0, 0.0), (1.5, 1.5), (9.0, 3.0)])
    dim, bright = (
        measure(before_wall(np.full(4000, 5.0)), wall(light), response=noisy).intensity for light in (1.0, 2.0)
    )
    for seen, spread in ((dim, 0.01), (bright, 0.02 / 5.0)):
        assert seen.std() == pytest.approx(spread, rel=SIGMAS / math.sqrt(2 * 4000))


def test_detection_and_noise_see_the_light_itself() -> None:
    noisy = {
        "detection": ls.Detection(0.1, 60.0),
        "range_sigma_limit": 0.1,
        "range_sigma": 0.01,
        "near_threshold": 0.01,
    }
    plain, dim = (
        measure(before_wall(np.linspace(1.0, 90.0, 500)), wall(0.1), response=response, **noisy)
        for response in (None, ls.Response(range=[(1.0, 1e-6)]))
    )
    assert 0 < np.isfinite(plain.range).sum() < 500
    assert np.array_equal(plain.range, dim.range, equal_nan=True)
    assert np.allclose(dim.intensity, 1e-6 * plain.intensity, rtol=2.0**-22, atol=0, equal_nan=True)


def test_a_response_has_noise_and_factors_of_channels() -> None:
    response = ls.Response(sigma=0.03, ring_sigma=0.1)
    pattern, scene = rings_before_wall(400, 50), wall(0.5)
    first, other = (
        ls.Lidar(pattern, measurement=ls.Measurement(response=response))
        .scan(scene, frame=frame)
        .intensity.reshape(400, 50)
        .astype(float)
        for frame in (0, 1)
    )
    for image in (first, other):
        within = image / image.mean(axis=1, keepdims=True) - 1.0
        assert within.std() == pytest.approx(0.03 * math.sqrt(49 / 50), rel=SIGMAS / math.sqrt(2 * 400 * 50))
    factors = first.mean(axis=1) / 0.5
    assert np.log(factors).std() == pytest.approx(0.1, rel=SIGMAS / math.sqrt(2 * 400))
    assert factors.mean() == pytest.approx(1.0, abs=SIGMAS * 0.1 / math.sqrt(400))
    # Those of channels are the unit's, the noise is the frame's: a mean of 50 has a seventh of it.
    assert np.allclose(other.mean(axis=1) / 0.5, factors, rtol=8 * 0.03 / math.sqrt(25), atol=0)
    assert not np.array_equal(first, other)


def test_a_response_is_noisier_in_some_blocks_of_pulses_than_in_others() -> None:
    """The factors are 1 + σ·g·s, both normals from the documented draws; the pulses of the channels alternate."""
    sigma, block, channels = 0.05, 100, 4
    count = 50 * block
    toward = np.tile([1.0, 0.0, 0.0], (count, 1))
    order = np.arange(count)
    pattern = ls.patterns.Table(toward, origins=toward * -20.0, rings=order % channels, times=1e-6 * order, rate=10.0)
    response = ls.Response(sigma=sigma, sigma_block=block)
    lidar = ls.Lidar(pattern, measurement=ls.Measurement(response=response))
    for frame in (0, 7):
        factors = lidar.scan(wall(0.5), seed=3, frame=frame).intensity[:, 0].astype(float) / 0.5
        drawn = partial(uniform, 3, "", frame=frame)
        g = stats.norm.ppf([drawn(pulse=i, effect=9) for i in range(count)])
        keys = [(i // block) << 16 | i % channels for i in range(count)]
        s = stats.norm.ppf([drawn(pulse=key, effect=10, draw=1) for key in keys])
        assert np.allclose(factors, np.maximum(1.0 + sigma * g * s, 0.0), rtol=2.0**-22, atol=0)
        assert len(np.unique(s)) == channels * count // block


def test_what_is_no_echo_has_a_response_too() -> None:
    dark = {"detection": ls.Detection(0.1, 100.0), "false_returns": 1.0, "max_range": 50.0}
    plain, halved = (
        measure(away(50), wall(), response=response, **dark).intensity
        for response in (None, ls.Response(range=[(0.0, 0.5)]))
    )
    assert plain.min() > 0.0
    assert np.allclose(halved, plain / 2, rtol=2.0**-23, atol=0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ls.Response(range=[]), "range: expected shape"),
        (
            lambda: ls.Response(range=[(5.0, 1.0), (1.0, 1.0)]),
            "range: expected rising ranges, got 1.0 after 5.0 in row 1",
        ),
        (lambda: ls.Response(range=[(5.0, -1.0)]), "range: expected numbers >= 0, got range[0][1] = -1.0"),
        (lambda: ls.Response(curve=[(0.0, 1.0)]), "curve: expected 2 or more rows (intensity, reported), got 1"),
        (
            lambda: ls.Response(curve=[(0.0, 0.0), (1.0, 1.0), (2.0, 1.0)]),
            "curve: expected rising intensities, got 1.0 after 1.0 in row 2",
        ),
        (lambda: ls.Response(exponent=0.0), "exponent: expected a finite number > 0, got 0.0"),
        (lambda: ls.Response(sigma=-0.1), "sigma: expected a finite number >= 0, got -0.1"),
        (lambda: ls.Response(sigma_block=-1), "sigma_block: expected an integer >= 0, got -1"),
        (lambda: ls.Response(limit=0.0), "limit: expected a real number > 0, got 0.0"),
        (lambda: ls.Measurement(response=0.5), "response: expected a Response or None, got 0.5"),
        (lambda: ls.Measurement(near_threshold=2.0), "near_threshold: expected a finite number from 0 to 1, got 2.0"),
    ],
)
def test_a_bad_response_is_refused(make: Callable[[], object], said: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(said)}"):
        make()


def test_power_fluctuates_log_normally_about_its_mean() -> None:
    sigma, count = 0.3, 50_000
    pattern = before_wall(np.full(count, 20.0))
    scan = measure(pattern, wall(0.5), power_sigma=sigma)
    assert np.array_equal(scan.range, np.full((count, 1), 20.0))
    factors = scan.intensity[:, 0].astype(float) / 0.5
    assert stats.kstest(np.log(factors), stats.norm(-(sigma**2) / 2, sigma).cdf).pvalue > 1e-3
    spread = math.sqrt(math.expm1(sigma**2))
    assert abs(factors.mean() - 1.0) < 5.0 * spread / math.sqrt(count)
    # The draws are the documented ones.
    draws = [uniform(3, "", frame=0, pulse=i, effect=5) for i in range(1000)]
    expected = np.exp(sigma * stats.norm.ppf(draws) - sigma**2 / 2)
    assert np.allclose(factors[:1000], expected, rtol=2.0**-23, atol=0)


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-3, rays=7)], ids=["ray", "beam"])
def test_fluctuation_softens_the_edge_of_what_is_seen(beam: ls.Beam | None) -> None:
    sigma, count, least, seen_to = 0.4, 4000, 0.1, 100.0
    distances = np.linspace(60.0, 170.0, 12)
    pattern = before_wall(np.repeat(distances, count))
    limit = ls.Detection(least, seen_to)
    scan = measure(pattern, wall(least), detection=limit, power_sigma=sigma, beam=beam)
    hits = (scan.status == ls.Status.hit).reshape(-1, count)
    # s = (R₀/R)²·exp(w·g − w²/2) ≥ 1. A footprint of 1 mrad reaches no farther than its axis by 10⁻⁶ of the range.
    expected = stats.norm.cdf(np.log((seen_to / distances) ** 2) / sigma - sigma / 2)
    assert (np.diff(expected) < 0.0).all()
    assert expected[0] > 0.95
    assert expected[-1] < 0.01
    for seen, probability in zip(hits.sum(axis=1), expected, strict=True):
        assert stats.binomtest(int(seen), count, float(probability)).pvalue > 1e-5
    lost = scan.status != ls.Status.hit
    assert (scan.status[lost] == ls.Status.below_threshold).all()
    # The intensity has the factor that decided.
    powers = scan.intensity[:, 0].astype(float)[~lost] / scan.true_range[~lost, 0] ** 2
    assert (powers >= least / seen_to**2 * (1.0 - 2.0**-22)).all()


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-3, rays=7)], ids=["ray", "beam"])
def test_a_soft_limit_leaves_intensities_alone(beam: ls.Beam | None) -> None:
    sigma, count, distances = 0.4, 4000, np.linspace(60.0, 170.0, 12)
    pattern, limit = before_wall(np.repeat(distances, count)), ls.Detection(0.1, 100.0, sigma)
    clean = measure(pattern, wall(0.1), beam=beam).intensity[:, 0]
    # The near threshold dulls the power, and is below the far limit from 3 m on.
    scan = measure(pattern, wall(0.1), detection=limit, beam=beam, near_threshold=1e-3, near_range=1.0)
    seen = scan.status == ls.Status.hit
    assert np.array_equal(scan.intensity[seen, 0], clean[seen])
    draws = stats.norm.ppf([uniform(3, "", frame=0, pulse=i, effect=11) for i in range(0, 12 * count, 60)])
    power = (100.0 / np.repeat(distances, count)[::60]) ** 2 * np.exp(sigma * draws - sigma**2 / 2)
    assert np.array_equal(seen[::60], power >= 1.0)
    assert 0.2 < seen.mean() < 0.8


@pytest.mark.parametrize(("near", "share"), [(0.09, 1.0), (0.11, 0.0)])
def test_a_soft_limit_leaves_the_near_threshold_sharp(near: float, share: float) -> None:
    limit = ls.Detection(0.1, 100.0, 0.4)
    scan = measure(before_wall(np.full(1000, 5.0)), wall(0.1), detection=limit, near_threshold=near, near_range=9.0)
    assert (scan.status == ls.Status.hit).mean() == share


def test_each_echo_fluctuates_by_itself() -> None:
    pattern, scene = beams([1.0, 1e-5, 0.0], count=20_000), edge(3.0)
    beam = ls.Beam(4e-3, pulse_length=SLOW_PULSE)
    clean = measure(pattern, scene, beam=beam, returns=2)
    scan = measure(pattern, scene, beam=beam, returns=2, power_sigma=0.2)
    logs = np.log(scan.intensity.astype(float) / clean.intensity) + 0.02
    assert np.allclose(logs.std(axis=0), 0.2, rtol=5.0 / math.sqrt(2 * 20_000))
    assert abs(np.corrcoef(logs.T)[0, 1]) < 5.0 / math.sqrt(20_000)
    draws = [uniform(3, "", frame=0, pulse=i, effect=5, draw=1) for i in range(500)]
    assert np.allclose(logs[:500, 1], 0.2 * stats.norm.ppf(draws), rtol=0, atol=4 * 2.0**-23)
    # The strongest is the one whose power is, as received.
    one = measure(pattern, scene, beam=beam, power_sigma=0.2)
    second = scan.intensity[:, 1] / clean.range[:, 1] ** 2 > scan.intensity[:, 0] / clean.range[:, 0] ** 2
    assert 100 < second.sum() < 19_900
    assert np.array_equal(one.range[:, 0], np.where(second, scan.range[:, 1], scan.range[:, 0]))


def test_dropout_has_its_rate() -> None:
    for rate in (0.0, 0.001, 0.3, 1.0):
        scan = measure(before_wall(np.full(100_000, 10.0)), wall(), dropout=rate)
        lost = int((scan.status == ls.Status.dropped).sum())
        assert stats.binomtest(lost, 100_000, rate).pvalue > 1e-4 if 0 < rate < 1 else lost == rate * 100_000


def test_what_is_too_weak_is_not_dropped_too() -> None:
    scan = measure(before_wall([10.0, 90.0] * 1000), wall(0.1), detection=ls.Detection(0.1, 50.0), dropout=0.5)
    assert set(scan.status[0::2].tolist()) == {ls.Status.hit, ls.Status.dropped}
    assert set(scan.status[1::2].tolist()) == {ls.Status.below_threshold}


# False returns


def away(count: int) -> ls.patterns.Table:
    """Pulses that miss the wall."""
    return beams([-1.0, 0.0, 0.0], (-5.0, 0.0, 0.0), count=count)


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-3, rays=7)], ids=["ray", "beam"])
def test_false_returns_have_their_rate_and_are_uniform_over_the_gate(beam: ls.Beam | None) -> None:
    probability, count = 0.1, 40_000
    gate = {"min_range": 2.0, "max_range": 50.0}
    scan = measure(away(count), wall(), false_returns=probability, beam=beam, **gate)
    returned = scan.status == ls.Status.hit
    assert (scan.status[~returned] == ls.Status.miss).all()
    assert stats.binomtest(int(returned.sum()), count, probability).pvalue > 1e-6
    ranges = scan.range[returned, 0]
    assert stats.kstest(ranges, stats.uniform(2.0, 48.0).cdf).pvalue > 1e-6
    assert (scan.source[returned] == ls.Source.false_return).all()
    assert (scan.source[~returned] == 255).all()
    assert (scan.object_id == -1).all()
    assert not scan.label.any()
    assert not scan.instance.any()
    for name in ("true_range", "range_error", "normal", "incidence"):
        assert np.isnan(getattr(scan, name)).all(), name
    assert not scan.intensity[returned].any()
    assert np.isnan(scan.true_points()).all()
    cloud = scan.point_cloud()
    assert (cloud.source == ls.Source.false_return).all()
    assert np.array_equal(cloud.range, ranges)
    assert np.allclose(cloud.xyz, [-5.0, 0.0, 0.0] - np.outer(ranges, [1.0, 0.0, 0.0]), rtol=0, atol=4 * math.ulp(50.0))
    # The draws are the documented ones.
    draws = np.array([[uniform(3, "", frame=0, pulse=i, effect=6, draw=j) for j in (0, 1)] for i in range(1000)])
    assert np.array_equal(returned[:1000], draws[:, 0] < probability)
    expected = np.where(draws[:, 0] < probability, 2.0 + 48.0 * draws[:, 1], np.nan)
    assert np.array_equal(scan.range[:1000, 0], expected, equal_nan=True)


def test_every_pulse_has_a_false_return_at_most() -> None:
    assert (measure(away(100), wall(), false_returns=1.0, max_range=9.0).return_count == 1).all()
    plain = measure(away(100), wall(), max_range=9.0)
    assert plain.source is None
    assert "source" not in plain.point_cloud().fields


@pytest.mark.parametrize("beam", [None, ls.Beam(0.0, rays=7)], ids=["ray", "beam"])
def test_false_returns_are_among_the_others_by_range_and_the_weakest(beam: ls.Beam | None) -> None:
    count, effects = 4000, {"range_sigma": 0.02, "detection": ls.Detection(0.1, 60.0), "dropout": 0.1}
    parameters = {"beam": beam, "max_range": 50.0, "false_returns": 0.3, **effects}
    # The wall is seen by the first half of the pulses, and too dark for the second.
    scene = wall(0.1)
    pattern = before_wall(np.r_[np.full(count // 2, 20.0), np.full(count // 2, 70.0)])
    calm = measure(pattern, scene, **{**parameters, "false_returns": 0.0})
    misses = measure(away(count), scene, **parameters)
    falsely, seen = misses.return_count == 1, calm.return_count == 1
    dropped = calm.status == ls.Status.dropped
    assert dropped.sum() > 100
    assert 100 < falsely.sum() < 0.3 * count
    others = {
        "strongest": falsely & ~seen,
        "first": falsely & (~seen | (misses.range[:, 0] < 20.0)),
        1: falsely & (~seen | (misses.range[:, 0] < 20.0)),
        "last": falsely & (~seen | (misses.range[:, 0] > 20.0)),
    }
    for returns, shown in others.items():
        scan = measure(pattern, scene, returns=returns, **parameters)
        assert shown[: count // 2].any() or returns == "strongest"
        assert shown[count // 2 :].any()
        assert not scan.return_count[dropped].any()
        assert (scan.status[dropped] == ls.Status.dropped).all()
        assert np.array_equal(scan.range, np.where(shown[:, None], misses.range, calm.range), equal_nan=True)
        expected = np.where(shown, ls.Source.false_return, ls.Source.surface)
        assert np.array_equal(scan.source[:, 0], expected)
        for name in RETURNED[1:-1]:
            for part, like in ((shown, misses), (~shown, calm)):
                assert np.array_equal(getattr(scan, name)[part], getattr(like, name)[part], equal_nan=True), name
        assert np.array_equal(scan.status == ls.Status.hit, seen | shown)
        assert np.array_equal(np.isnan(scan.true_points()).any(axis=1), shown[scan.return_count == 1])
    # They have the least power that is detected.
    assert np.allclose(misses.intensity[falsely], 0.1 * (misses.range[falsely] / 60.0) ** 2, rtol=2.0**-23, atol=0)


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-2, rays=7)], ids=["ray", "beam"])
def test_false_returns_of_a_moving_sensor_have_no_truth(beam: ls.Beam | None) -> None:
    pattern = ls.patterns.Spinning(np.linspace(-0.5, 0.5, 8), columns=200)
    path = ls.Trajectory.from_twist(np.eye(4), (3.0, 1.0, 0.0), (0.5, -1.0, 4.0))
    effects = {"azimuth_sigma": 1e-3, "beam": beam, "returns": "first"}
    measurement = ls.Measurement(false_returns=0.3, **effects)  # type: ignore[arg-type]
    scan = ls.Lidar(pattern, measurement=measurement, max_range=30.0).scan(room()[0], path, seed=5)
    plain = ls.Lidar(pattern, measurement=ls.Measurement(**effects), max_range=30.0).scan(room()[0], path, seed=5)  # type: ignore[arg-type]
    assert scan.source is not None
    falsely = scan.source[:, 0] == ls.Source.false_return
    assert 100 < falsely.sum() < 0.3 * len(scan)
    for name in ("true_range", "range_error", "normal", "incidence", "true_direction", "radial_velocity"):
        assert np.isnan(getattr(scan, name)[falsely]).all(), name
        assert np.array_equal(getattr(scan, name)[~falsely], getattr(plain, name)[~falsely], equal_nan=True), name
    assert np.isfinite(scan.point_cloud(deskew=True).xyz).all()


def test_a_pulse_has_one_more_return_than_echoes() -> None:
    pattern, scene = beams([1.0, 1e-5, 0.0], count=2000), edge(3.0)
    beam = ls.Beam(4e-3, pulse_length=SLOW_PULSE)
    scan = measure(pattern, scene, beam=beam, returns=4, false_returns=0.5, max_range=50.0)
    alone = measure(pattern, scene, beam=beam, returns=4, max_range=50.0)
    assert (alone.return_count == 2).all()
    falsely = (scan.source == ls.Source.false_return).sum(axis=1)
    assert set(falsely.tolist()) == {0, 1}
    assert np.array_equal(scan.return_count, 2 + falsely)
    for i, count in enumerate(scan.return_count.tolist()):
        assert (np.diff(scan.range[i, :count]) > 0.0).all()
        real = scan.source[i] == ls.Source.surface
        for name in RETURNED:
            assert np.array_equal(getattr(scan, name)[i][real], getattr(alone, name)[i, :2]), name
    dual = measure(pattern, scene, beam=beam, returns="dual", false_returns=0.5, max_range=50.0)
    assert (dual.source[:, 0] == ls.Source.surface).all()
    last = np.where(scan.return_count == 3, scan.range[:, 2], scan.range[:, 1])
    assert np.array_equal(dual.range[:, 1], last)
    cloud = scan.point_cloud()
    assert np.array_equal(cloud.source == ls.Source.false_return, cloud.object_id == -1)


def test_false_returns_are_rounded_and_counted_from_the_sensors_own_zero() -> None:
    lidar = ls.Lidar(
        away(5000), min_range=2.0, max_range=9.0, range_offset=0.25,
        measurement=ls.Measurement(false_returns=1.0, range_resolution=0.5, range_sigma=1.0, range_bias=1.0),
    )  # fmt: skip
    scan = lidar.scan(wall())
    own = scan.range[:, 0] + 0.25
    assert set(own.tolist()) == set(np.arange(2.0, 9.1, 0.5).tolist())
    counts = np.bincount(np.rint(own / 0.5).astype(int))[4:]
    # Half a step at either end.
    assert stats.chisquare(counts, 5000 / 14 * np.r_[0.5, np.ones(13), 0.5]).pvalue > 1e-6


def test_false_returns_go_to_files(tmp_path: Path) -> None:
    cloud = measure(before_wall(np.full(500, 20.0)), wall(), false_returns=0.5, max_range=50.0, returns="first")
    points = cloud.point_cloud()
    assert set(points.source.tolist()) == {0, 2}
    for suffix in (".npz", ".pcd", ".ply"):
        points.save(tmp_path / f"cloud{suffix}")
        again = ls.PointCloud.load(tmp_path / f"cloud{suffix}")
        for name in ("source", "object_id", "range", "true_range"):
            assert getattr(again, name).tobytes() == getattr(points, name).tobytes(), (suffix, name)


def test_false_returns_need_a_gate_that_ends() -> None:
    measurement = ls.Measurement(false_returns=0.1)
    message = "max_range: expected a finite number with false_returns, got inf; they are uniform over the range gate"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Lidar(away(1), measurement=measurement)
    lidar = ls.Lidar(away(1), measurement=measurement, max_range=9.0)
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        dataclasses.replace(lidar, max_range=math.inf)


# The beam


SLOW_PULSE = 2 * 0.75 / 299_792_458.0
"""A pulse that is 0.75 m long: of equal echoes, those closer than 0.64 m are one."""


def footprint_mean(range_of: Callable[[float, float], tuple[float, float]], divergence: float) -> float:
    """Mean range over a Gaussian footprint out to 1/e², by received power; `range_of` gives range and cos θ."""

    def integral(with_range: bool) -> float:
        def integrand(phi: float, r: float) -> float:
            distance, cosine = range_of(r * math.cos(phi), r * math.sin(phi))
            power = math.exp(-2 * (2 * r / divergence) ** 2) * cosine / distance**2
            return r * power * (distance if with_range else 1.0)

        return float(integrate.dblquad(integrand, 0, divergence / 2, 0, 2 * math.pi, epsabs=0, epsrel=1e-10)[0])

    return integral(True) / integral(False)


@pytest.mark.parametrize("slant", [0.0, 0.5, 1.0, 1.4, 1.5])
def test_a_slanted_plane_gives_one_return_with_the_right_mean(slant: float) -> None:
    divergence, distance = 6e-3, 50.0
    normal = np.array([-math.cos(slant), 0.0, math.sin(slant)])
    scene = ls.Scene()
    scene.add(ls.Plane.from_point((distance, 0, 0), normal))

    def range_of(left: float, up: float) -> tuple[float, float]:
        direction = np.array([1.0, left, up])
        direction /= np.linalg.norm(direction)
        cosine = abs(float(normal @ direction))
        return distance * math.cos(slant) / cosine, cosine

    expected = footprint_mean(range_of, divergence)
    errors = []
    for rays in (5, 7, 19, 37, 61, 91):
        beam = ls.Beam(divergence, pulse_length=SLOW_PULSE, rays=rays)
        scan = measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, returns=min(rays, 5))
        assert scan.return_count.tolist() == [1]
        assert scan.true_range[0, 0] == distance
        errors.append(abs(scan.range[0, 0] - expected))
    # The mean is off the axis by the second moments of the profile, which the layouts keep to 1 %, and by far smaller
    # ones of higher order.
    assert max(errors) < 0.01 * abs(expected - distance)
    if slant >= 1.4:
        assert distance * (math.tan(slant + divergence / 2) - math.tan(slant - divergence / 2)) > 0.75


def test_a_grazed_plane_is_one_return_though_its_sub_rays_lie_far_apart() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -2.0))
    down = 0.02 + 3e-3 / 5 * np.arange(-2, 3)
    directions = np.column_stack([np.cos(down), 0 * down, -np.sin(down)])
    assert (-np.diff(scene.cast(np.zeros((5, 3)), directions).t) > 2.0).all()
    scan = measure(beams(directions[2]), scene, beam=ls.Beam(3e-3, pulse_length=SLOW_PULSE, rays=19), returns=5)
    assert scan.return_count.tolist() == [1]
    assert abs(scan.range_error[0, 0]) < 1.0


def edge(depth: float, *, near: float = 20.0, pose: RigidTransform | None = None, **material: Any) -> ls.Scene:
    """A wall at x = near for y > 0, and one further by `depth` behind it."""
    scene = ls.Scene()
    corners = [[near, 0, -50], [near, 0, 50], [near, 50, 50], [near, 50, -50]]
    scene.add(ls.Polygon(corners), label=1, material=ls.Material(**material), transform=pose)
    scene.add(ls.Plane((1, 0, 0), near + depth), label=2, transform=pose)
    return scene


def test_an_edge_gives_mixed_pixels_whose_share_falls_with_divergence() -> None:
    azimuths = np.linspace(-0.01, 0.01, 4001)
    pattern = beams(np.column_stack([np.cos(azimuths), np.sin(azimuths), 0 * azimuths]))
    shares = []
    for divergence in (8e-3, 4e-3, 2e-3, 1e-3, 0.0):
        scan = measure(pattern, edge(0.5), beam=ls.Beam(divergence, pulse_length=SLOW_PULSE, rays=91))
        x = scan.range[:, 0] * np.cos(azimuths)
        mixed = (x > 20.01) & (x < 20.49)
        assert ((x > 19.99) & (x < 20.51)).all()
        shares.append(mixed.mean())
    # A pulse is mixed if the edge is inside of its footprint: the share is the divergence over the 0.02 rad that are
    # scanned, less the outermost cells of 1/11 of the radius.
    expected = np.array([8e-3, 4e-3, 2e-3, 1e-3, 0.0]) / 0.02
    assert (shares <= expected + 1 / 4001).all()
    assert (shares >= expected * (1 - 2 / 11) - 1 / 4001).all()


# What hides from the receiver


@pytest.mark.parametrize("pose", [RigidTransform.identity(), POSE], ids=["still", "turned"])
@pytest.mark.parametrize("offset", [0.03, 0.0, -0.03])
def test_a_receiver_beside_the_emitter_loses_a_strip_beyond_an_edge(offset: float, pose: RigidTransform) -> None:
    azimuths = np.linspace(-0.03, 0.01, 4001)
    pattern = beams(np.column_stack([np.cos(azimuths), np.sin(azimuths), 0 * azimuths]))
    lidar = ls.Lidar(pattern, measurement=ls.Measurement(receiver_offset=offset))
    scan = lidar.scan(edge(3.0, near=2.0, pose=pose), pose)
    # Where the line from the receiver to the wall 5 m away passes the nearer one, which is to the left of y = 0.
    x, y = -offset * np.sin(azimuths), offset * np.cos(azimuths)
    passes = y + (5 * np.tan(azimuths) - y) * (2 - x) / (5 - x)
    hidden = (azimuths < 0) & (passes > 0)
    # Without the pulses on an edge: roundings are some 1e-15, and the next pulses are 1e-5 beside them.
    clear = (np.abs(passes) > 1e-9) & (np.abs(azimuths) > 1e-9)
    assert hidden[clear].sum() == (900 if offset > 0 else 0)
    assert np.array_equal(scan.status[clear] == ls.Status.miss, hidden[clear])
    seen = scan.status == ls.Status.hit
    assert np.array_equal(scan.label[clear & seen, 0], np.where(azimuths > 0, 1, 2)[clear & seen])


def test_the_receiver_misses_the_farther_of_two_echoes_on_one_side_of_an_edge() -> None:
    beam, pattern = ls.Beam(4e-3), beams([1.0, 0.0, 0.0])
    labels = []
    for offset in (-0.03, 0.0, 0.03):
        scan = measure(pattern, edge(3.0, near=2.0), beam=beam, returns=2, receiver_offset=offset)
        labels.append(scan.label[0, : scan.return_count[0]].tolist())
    assert labels == [[1, 2], [1, 2], [1]]


def test_the_receiver_sees_through_panes_and_past_what_is_nearer_than_its_offset() -> None:
    pattern = beams([math.cos(0.003), -math.sin(0.003), 0.0])
    for gap, transmission, status in (
        (3.0, 0.0, ls.Status.miss),
        (3.0, 0.5, ls.Status.hit),
        (0.029, 0.0, ls.Status.hit),
    ):
        scene = edge(gap, near=2.0, reflectivity=0.1, transmission=transmission)
        assert measure(pattern, scene, depth=2, receiver_offset=0.03).status.tolist() == [status], (gap, transmission)


@pytest.mark.parametrize("beam", [None, ls.Beam(0.1, rays=91)], ids=["ray", "beam"])
@pytest.mark.parametrize("x", [0.0, 3e-5, 3e-3])
def test_the_receiver_sees_what_is_nearer_than_its_offset(x: float, beam: ls.Beam | None) -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), x))
    aside, same = (measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, receiver_offset=b) for b in (0.03, 0.0))
    assert same.status.tolist() == [ls.Status.hit]
    assert aside.status.tolist() == [ls.Status.hit]
    assert aside.intensity == same.intensity


def slope_normal(around: float, slope: float) -> Floats:
    """Normal of a plane across the x axis, whose distance changes by `slope` a metre towards that angle."""
    normal = np.array([-1.0, slope * math.cos(around), slope * math.sin(around)])
    return normal / np.linalg.norm(normal)


@pytest.mark.parametrize("rays", [5, 7, 19, 37, 61, 91])
def test_a_slanted_plane_is_one_return_however_far_apart_its_sub_rays_lie(rays: int) -> None:
    beam = ls.Beam(6e-3, 2e-3, pulse_length=1e-9, rays=rays)
    extents = []
    for slope in (0.5, 3.0, 10.0, 30.0, 60.0):
        for around in np.linspace(0.0, 2 * np.pi, 25):
            scene = ls.Scene()
            scene.add(ls.Plane.from_point((50.0, 0.0, 0.0), slope_normal(around, slope)))
            scan = measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, returns=min(rays, 20))
            assert scan.return_count.tolist() == [1], (slope, around)
            extents.append(50.0 * slope * math.hypot(6e-3 * math.cos(around), 2e-3 * math.sin(around)))
    # From far below the length of the pulse, 0.15 m, to far above it.
    assert min(extents) < 0.1
    assert max(extents) > 10.0


def waveform(scene: ls.Scene, divergence: float, pulse_length: float, rays: int = 6000) -> tuple[Floats, Floats]:
    """The light over range that a receiver sees along x, of so many rays of equal energy; no part of lidarsim's beams.

    A spiral by the golden angle fills the footprint, its radii by the quantiles of the Gaussian profile.
    """
    energy = (np.arange(rays) + 0.5) / rays
    radius = divergence / 2.0 * np.sqrt(-0.5 * np.log(1.0 - energy * (1.0 - math.exp(-2.0))))
    angle = np.arange(rays) * np.pi * (3.0 - math.sqrt(5.0))
    directions = np.column_stack([np.ones(rays), radius * np.cos(angle), radius * np.sin(angle)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hits = scene.cast(np.zeros((rays, 3)), directions)
    t, cosine = hits.t[hits.hit], np.abs((hits.normal * directions).sum(axis=1))[hits.hit]
    sigma = 299_792_458.0 / 2.0 * pulse_length / math.sqrt(8.0 * math.log(2.0))
    step = sigma / 50.0
    ranges = np.arange(t.min() - 6.0 * sigma, t.max() + 6.0 * sigma, step)
    light = np.histogram(t, np.append(ranges, ranges[-1] + step) - step / 2.0, weights=cosine / t**2)[0]
    kernel = np.exp(-0.5 * (np.arange(-300, 301) / 50.0) ** 2)
    return ranges, signal.fftconvolve(light, kernel, "same")


def canopy(seed: int) -> ls.Scene:
    """Leaves of 10 cm, in any attitude, from 100 m to 110 m: 0.3 m² of them a m³."""
    generator = np.random.default_rng(seed)
    corners = 0.1 / math.sqrt(3.0) * np.array([[math.cos(a), math.sin(a), 0.0] for a in 2 * np.pi * np.arange(3) / 3])
    count = int(0.3 * 10.0 * 0.8**2 / (math.sqrt(3.0) / 4.0 * 0.1**2))
    attitudes = np.linalg.qr(generator.normal(size=(count, 3, 3)))[0]
    places = generator.uniform((100.0, -0.4, -0.4), (110.0, 0.4, 0.4), (count, 3))
    vertices = places[:, None] + corners @ attitudes
    scene = ls.Scene()
    scene.add(ls.TriangleMesh(vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)))
    return scene


def test_a_canopy_has_as_many_returns_as_its_waveform_has_peaks() -> None:
    divergence, pulse_length, trees = 4e-3, 5e-9, 100
    scenes = [canopy(seed) for seed in range(trees)]
    peaks = np.mean([len(signal.find_peaks(waveform(scene, divergence, pulse_length)[1])[0]) for scene in scenes])
    assert peaks > 4
    counts = {}
    for rays in (5, 7, 19, 37, 61, 91):
        beam = ls.Beam(divergence, pulse_length=pulse_length, rays=rays)
        scans = [measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, returns=rays) for scene in scenes]
        counts[rays] = np.mean([scan.return_count[0] for scan in scans])
    assert counts[5] < counts[7] < counts[19] < counts[37]
    assert abs(counts[37] / counts[91] - 1.0) < 0.05
    for rays in (37, 61, 91):
        assert abs(counts[rays] / peaks - 1.0) < 0.15


@pytest.mark.parametrize("separation", [1.3, 2.0, 3.0, 100.0])
def test_of_two_echoes_too_near_to_be_told_apart_the_stronger_stays(separation: float) -> None:
    dropped = 0
    pattern = beams([1.0, 0.0, 0.0])
    for seed in range(30):
        everything = measure(pattern, canopy(seed), beam=ls.Beam(4e-3, rays=91), returns=91)
        beam = ls.Beam(4e-3, rays=91, separation=separation)
        scan = measure(pattern, canopy(seed), beam=beam, returns=91)
        count = int(everything.return_count[0])
        ranges = everything.range[0, :count]
        powers = everything.intensity[0, :count] / ranges**2
        kept: list[int] = []
        for i in np.argsort(-powers, kind="stable"):
            if all(abs(ranges[i] - ranges[j]) >= separation for j in kept):
                kept.append(int(i))
        kept.sort()
        for name in RETURNED:
            assert np.array_equal(
                getattr(scan, name)[0, : len(kept)], getattr(everything, name)[0, kept], equal_nan=True
            ), name
        assert scan.return_count.tolist() == [len(kept)]
        dropped += count - len(kept)
        foggy = measure(pattern, canopy(seed), beam=beam, returns=91, extinction=0.05)
        assert foggy.object_id.tobytes() == scan.object_id.tobytes()
        assert foggy.true_range.tobytes() == scan.true_range.tobytes()
        same = measure(pattern, canopy(seed), beam=ls.Beam(4e-3, rays=91, separation=5e-324), returns=91)
        assert same.range.tobytes() == everything.range.tobytes()
    assert dropped > 10


def strips(gap: float, order: Sequence[int]) -> ls.Scene:
    """Upright strips of 0.5 mrad side by side, together as wide as the beam; the n-th at 100 m + `gap`·order[n]."""
    scene = ls.Scene()
    for n, step in enumerate(order):
        x = 100.0 + gap * step
        left, right = (-2e-3 + 5e-4 * n) * x, (-2e-3 + 5e-4 * (n + 1)) * x
        scene.add(ls.Polygon([[x, left, -2.0], [x, right, -2.0], [x, right, 2.0], [x, left, 2.0]]))
    return scene


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5, 6, 7), (0, 4, 1, 5, 2, 6, 3, 7), (3, 7, 2, 6, 1, 5, 0, 4)])
def test_strips_too_close_to_be_told_apart_give_the_peaks_of_their_waveform(order: tuple[int, ...]) -> None:
    scene = strips(0.6, order)
    ranges, light = waveform(scene, 4e-3, 5e-9)
    # Peaks that rise from their surroundings by more than the waveform is sampled to.
    peaks = ranges[signal.find_peaks(light, prominence=0.02 * light.max())[0]]
    ramp = order == tuple(range(8))
    assert len(peaks) == (1 if ramp else 2)
    # The waveform of the ramp is so flat that a second peak, of 0.03 % of its height, is all but there: 37 sub-rays,
    # which share out unevenly over the strips, show it.
    for rays in (19, 61, 91) if ramp else (19, 37, 61, 91):
        scan = measure(beams([1.0, 0.0, 0.0]), scene, beam=ls.Beam(4e-3, rays=rays), returns=7)
        assert scan.return_count.tolist() == [len(peaks)], rays
        # To less than one standard deviation of the pulse, 0.318 m: an echo is a mean, a peak a mode.
        assert np.abs(scan.range[0, : len(peaks)] - peaks).max() < 0.318, rays


@pytest.mark.parametrize("rays", [19, 37, 61, 91])
def test_strips_that_can_be_told_apart_are_separate_returns(rays: int) -> None:
    scan = measure(beams([1.0, 0.0, 0.0]), strips(1.5, range(8)), beam=ls.Beam(4e-3, rays=rays), returns=8)
    assert scan.return_count.tolist() == [8]
    # A strip is flat: its range changes by (2e-3)²/2 of it over the beam.
    assert np.allclose(scan.range[0], 100.0 + 1.5 * np.arange(8), rtol=2e-3**2 / 2, atol=0)


def test_two_surfaces_are_told_apart_from_two_standard_deviations_on() -> None:
    """Sparrow's criterion; of equal powers, so that the one that is further reflects the more."""
    sigma = 299_792_458.0 / 2.0 * 5e-9 / math.sqrt(8.0 * math.log(2.0))
    for distance in (20.0, 2000.0, 1e6):
        for widths, returns in ((1.0, 1), (1.99, 1), (2.01, 2), (3.0, 2), (100.0, 2), (1e6, 2)):
            scene = ls.Scene()
            far = distance + widths * sigma
            # Half of the sub-rays meet each; that on the axis, none.
            for x, side, reflectivity in ((distance, 1, 1.0), (far, -1, (far / distance) ** 2)):
                corners = np.array([[x, 1e-9, -5e4], [x, 1e-9, 5e4], [x, 5e4, 5e4], [x, 5e4, -5e4]]) * [1, side, 1]
                scene.add(ls.Polygon(corners), material=ls.Material(reflectivity=reflectivity))
            beam = ls.Beam(1e-6, pulse_length=5e-9, rays=7)
            scan = measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, returns=2)
            assert scan.return_count.tolist() == [returns], (distance, widths)


def test_echoes_apart_are_separate_returns() -> None:
    """The axis just on the near wall, so that a little more than half of the light is from there."""
    pattern, scene = beams([1.0, 1e-5, 0.0]), edge(3.0)
    beam = ls.Beam(4e-3, pulse_length=SLOW_PULSE)
    both = measure(pattern, scene, beam=beam, returns=4)
    assert both.return_count.tolist() == [2]
    assert both.label.tolist() == [[1, 2, 0, 0]]
    oblique = 2e-3**2 / 2  # at the edge of the beam, ranges are longer and cosines less by this
    assert np.allclose(both.range[0, :2], [20.0, 23.0], rtol=oblique, atol=0)
    assert np.isnan(both.range[0, 2:]).all()
    assert 0.5 < both.intensity[0, 0] < 0.7
    assert np.isclose(both.intensity[0, :2].sum(), 1.0, rtol=0, atol=oblique + 2.0**-23)
    cloud = both.point_cloud()
    assert cloud.return_number.tolist() == [1, 2]
    assert cloud.return_count.tolist() == [2, 2]
    modes = {"strongest": [1], "first": [1], "last": [2], "dual": [1, 2], 1: [1], 2: [1, 2]}
    for returns, labels in modes.items():
        assert measure(pattern, scene, beam=beam, returns=returns).label.tolist() == [labels], returns
    dark = edge(3.0, reflectivity=0.01)
    modes = {"strongest": [2], "first": [1], "last": [2], "dual": [2, 1], 1: [1], 2: [1, 2]}
    for returns, labels in modes.items():
        assert measure(pattern, dark, beam=beam, returns=returns).label.tolist() == [labels], returns


def steps(*, reflectivities: tuple[float, float, float]) -> ls.Scene:
    """Three walls, each seen past the edge of the one before it."""
    scene = ls.Scene()
    for i, (x, y, rho) in enumerate(zip((20, 25, 30), (0.02, -0.02, -50), reflectivities, strict=True)):
        corners = [[x, y, -50], [x, y, 50], [x, 50, 50], [x, 50, -50]]
        scene.add(ls.Polygon(corners), label=i + 1, material=ls.Material(reflectivity=rho))
    return scene


@pytest.mark.parametrize(
    ("reflectivities", "labels"),
    [((1, 1, 1), [2, 3]), ((9, 1, 1), [1, 3]), ((9, 1, 300), [3, 1]), ((1, 9, 300), [3, 2])],
)
def test_dual_is_the_strongest_and_the_last_or_the_next(
    reflectivities: tuple[float, float, float], labels: list[int]
) -> None:
    scene = steps(reflectivities=reflectivities)
    beam = ls.Beam(6e-3, pulse_length=SLOW_PULSE, rays=91)
    assert measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, returns=3).label.tolist() == [[1, 2, 3]]
    assert measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, returns="dual").label.tolist() == [labels]
    assert measure(beams([1.0, 0.0, 0.0]), scene, beam=beam, returns=2).label.tolist() == [[1, 2]]


def test_lost_echoes_leave_the_others() -> None:
    pattern, scene, beam = beams([1.0, 1e-5, 0.0]), edge(3.0), ls.Beam(4e-3, pulse_length=SLOW_PULSE)
    gated = measure(pattern, scene, beam=beam, returns="first", min_range=21.0)
    assert gated.label.tolist() == [[2]]
    assert gated.status.tolist() == [ls.Status.hit]
    weak = measure(pattern, scene, beam=beam, returns=2, detection=ls.Detection(0.5, 20.0))
    assert weak.label.tolist() == [[1, 0]]
    assert weak.return_count.tolist() == [1]
    none = measure(pattern, scene, beam=beam, returns=2, detection=ls.Detection(0.9, 20.0))
    assert none.status.tolist() == [ls.Status.below_threshold]
    assert none.label.tolist() == [[1, 0]]
    assert none.true_range[0, 0] == pytest.approx(math.hypot(20.0, 20.0 * 1e-5), rel=2.0**-51)
    assert np.isnan(none.range).all()
    assert np.isnan(none.intensity).all()


def curtain(count: int, x: float = 0.0) -> ls.TriangleMesh:
    """A wavy curtain at this x, 6 m wide and high, of 2·count² triangles."""
    y, z = np.meshgrid(np.linspace(-3.0, 3.0, count + 1), np.linspace(-3.0, 3.0, count + 1), indexing="ij")
    at = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, d, c])])
    return ls.TriangleMesh(np.column_stack([x + np.sin(y * z).ravel(), y.ravel(), z.ravel()]), faces)


ADVERSE: dict[str, list[tuple[ls.Shape, tuple[float, float, float]]]] = {
    "edges": [(ls.Box((1.0, 1.0, 1.0)), (4.0 + k % 3, (k - 10) * 0.8, (k % 5 - 2) * 0.7)) for k in range(21)],
    "slivers": [
        (
            ls.Triangle(
                (6.0 + k / 8, -5.0, 0.1 * k - 1.0), (6.0, 5.0, 0.1 * k - 1.0), (6.0, 5.0, 0.1 * k - 1.0 + 1e-6)
            ),
            (0, 0, 0),
        )
        for k in range(20)
    ],
    "coincident": [(ls.Box((2.0, 4.0, 2.0)), (5.0, 0.0, 0.0)), (ls.Box((2.0, 4.0, 2.0)), (5.0, 0.0, 0.0))],
    "grazing": [(ls.Plane((0, 0, 1), -1e-3), (0, 0, 0)), (ls.Plane((0, 1, 0), 1e-6), (0, 0, 0))],
    "around the origin": [(ls.Sphere((0, 0, 0), 3.0), (0, 0, 0)), (ls.Box((1e-3, 1e-3, 1e-3)), (0, 0, 0))],
    "triangles": [(curtain(4, 5.0), (0, 0, 0)), (curtain(30, 5.5), (0, 0, 0)), (curtain(90, 6.5), (0, 0, 0))],
    "placed triangles": [(curtain(4), (5.0, 0, 0)), (curtain(30), (5.5, 0, 0)), (curtain(90), (6.5, 0, 0))],
    "coincident triangles": [(curtain(8), (5.0, 0, 0)), (curtain(8), (5.0, 0, 0)), (curtain(8), (5.001, 0, 0))],
    "small": [(ls.Sphere((0, 0, 0), 2e-3), (3.0, 0.03 * (k % 20) - 0.3, 0.03 * (k // 20) - 0.3)) for k in range(400)],
}
"""Shapes, and where they stand: at their edges, narrower than a beam, at one place, or around the sensor."""


def adverse(name: str, count: int = 1003) -> tuple[ls.patterns.Table, ls.Scene]:
    """Pulses from the origin towards +x, and a scene of these shapes."""
    scene = ls.Scene()
    for shape, place in ADVERSE[name]:
        pose = np.eye(4)
        pose[:3, 3] = place
        scene.add(shape, transform=pose if any(place) else None)
    angles = np.random.default_rng(zlib.crc32(name.encode())).uniform(-0.4, 0.4, (count, 2))
    directions = np.column_stack([np.ones(len(angles)), angles])
    directions[::5, 1:] = 0.0  # along an axis, so that sub-rays lie in all octants
    return beams(directions / np.linalg.norm(directions, axis=1, keepdims=True)), scene


@pytest.mark.parametrize("name", ADVERSE)
def test_echoes_are_those_of_sub_rays_cast_alone(name: str, slow: bool) -> None:
    """With a pulse too short to join ranges, each echo is that of a ray along its sub-ray, to the bit."""
    pattern, scene = adverse(name, 50_000 if slow else 1003)
    for beam in (ls.Beam(0.02, pulse_length=1e-15, rays=7), ls.Beam(0.1, 0.02, pulse_length=1e-15, rays=19)):
        scan = measure(pattern, scene, beam=beam, returns=beam.rays)
        echoes = np.arange(beam.rays) < scan.return_count[:, None]
        assert scan.true_direction is not None
        along = scan.true_direction[echoes]
        alone = measure(Along(along), scene)
        assert len(along) > 100, name
        for column in ("object_id", "true_range", "normal"):
            assert np.array_equal(getattr(alone, column)[:, 0], getattr(scan, column)[echoes]), column


@pytest.mark.parametrize("name", ADVERSE)
@pytest.mark.parametrize("returns", [("strongest", "dual"), ("first", 2)], ids=["strongest", "first"])
@pytest.mark.parametrize("noisy", [False, True], ids=["clean", "noisy"])
def test_the_only_return_is_the_first_of_two(name: str, returns: tuple[Any, Any], noisy: bool) -> None:
    """Pulses that report one return are measured eight at a time if they have one echo; those of two, one by one."""
    pattern, scene = adverse(name)
    parameters: dict[str, Any] = {"beam": ls.Beam(0.01, rays=7), "max_range": 50.0}
    if noisy:
        parameters |= {
            "range_sigma": 0.02, "range_sigma_limit": 0.01, "dropout": 0.2, "false_returns": 0.3, "power_sigma": 0.4,
            "detection": ls.Detection(0.3, 6.0), "near_threshold": 0.1, "azimuth_sigma": 0.01,
            "response": ls.Response(sigma=0.1, sigma_block=20, ring_sigma=0.1),
        }  # fmt: skip
    one, two = (measure(pattern, scene, returns=kind, **parameters) for kind in returns)
    assert not noisy or two.return_count.max() == 2
    for column in RETURNED:
        assert np.array_equal(getattr(one, column)[:, 0], getattr(two, column)[:, 0], equal_nan=True), column
    assert np.array_equal(one.status, two.status)
    assert np.array_equal(one.return_count, np.minimum(two.return_count, 1))
    assert 0 < one.return_count.mean() <= 1


def test_part_of_the_footprint_beside_the_target_is_lost_light() -> None:
    scene = ls.Scene()
    corners = [[20, 0, -50], [20, 0, 50], [20, 50, 50], [20, 50, -50]]
    scene.add(ls.Polygon(corners))
    scan = measure(beams([1.0, -1e-5, 0.0]), scene, beam=ls.Beam(4e-3, rays=91))
    assert scan.status.tolist() == [ls.Status.hit]
    assert 0.4 < scan.intensity[0, 0] < 0.5
    # The axis misses: the truth is that of the sub-ray nearest to it, at 2/11 of half the divergence.
    assert 20.0 < scan.true_range[0, 0] < 20.0 * (1.0 + (2e-3 * 2 / 11) ** 2 / 2)


def test_a_beam_of_no_divergence_is_a_line() -> None:
    ranges = np.linspace(1.0, 200.0, 100)
    line = measure(before_wall(ranges), wall(0.3), extinction=1e-3)
    beam = measure(before_wall(ranges), wall(0.3), extinction=1e-3, beam=ls.Beam(0.0))
    assert np.array_equal(line.range, beam.range)
    assert np.allclose(line.intensity, beam.intensity, rtol=2.0**-23, atol=0)


def test_divergence_is_the_full_angle_and_elliptical() -> None:
    """A slit is seen as long as it is inside of the footprint."""
    for name, axis in (("divergence_azimuth", 1), ("divergence_elevation", 2)):
        angles = np.linspace(0.0, 6e-3, 601)
        directions = np.zeros((601, 3))
        directions[:, 0] = 1.0
        directions[:, axis] = angles
        scene = ls.Scene()
        corners = np.array([[10, -1e-4, -1.0], [10, 1e-4, -1.0], [10, 1e-4, 1.0], [10, -1e-4, 1.0]])
        scene.add(ls.Polygon(corners if axis == 1 else corners[:, [0, 2, 1]]))
        widths = {"divergence_azimuth": 1e-4, "divergence_elevation": 1e-4, name: 8e-3}
        scan = measure(beams(directions), scene, beam=ls.Beam(**widths, rays=91))
        seen = angles[scan.status == ls.Status.hit].max()
        # The outermost sub-rays stand at 10/11 of the half angle. Half the slit is 1e-5 rad, and so is a step.
        assert seen == pytest.approx(4e-3 * 10 / 11, rel=0, abs=2e-5)


def test_black_surfaces_have_echoes_of_no_light() -> None:
    scan = measure(before_wall([10.0]), wall(0.0), beam=ls.Beam(1e-3))
    assert scan.range[0, 0] == 10.0
    assert scan.intensity.tolist() == [[0.0]]


def test_a_surface_at_distance_zero() -> None:
    for parameters in ({}, {"beam": ls.Beam(1e-3)}, {"detection": ls.Detection(0.1, 10.0)}):
        scan = measure(before_wall([0.0]), wall(0.5), **parameters)
        assert scan.status.tolist() == [ls.Status.hit]
        assert scan.range.tolist() == [[0.0]]


# Where the beams really ended


ROUNDED = 22 * math.sqrt(3.0) * 12.0 * math.sqrt(3.0) * 2.0**-53
"""Distance by which 22 roundings of each coordinate move a point of the room, which is at most 12·√3 m away."""


def room() -> tuple[ls.Scene, list[Callable[[Floats], Floats]]]:
    """Walls, floor and ceiling about the origin, and spheres in between; and how far points are from each surface."""
    scene = ls.Scene()
    away: list[Callable[[Floats], Floats]] = []
    for normal in (*np.eye(3), *-np.eye(3)):
        scene.add(ls.Plane(normal, 12.0))
        away.append(lambda points, normal=normal: points @ normal - 12.0)
    for center in np.random.default_rng(11).uniform(-9.0, 9.0, (40, 3)):
        if np.linalg.norm(center) > 4.0:
            scene.add(ls.Sphere(center, 0.8))
            away.append(lambda points, center=center: np.linalg.norm(points - center, axis=1) - 0.8)
    return scene, away


def furthest(points: Floats, object_id: npt.NDArray[np.int32], away: list[Callable[[Floats], Floats]]) -> float:
    """The greatest distance of a point from the surface that it is said to be on."""
    return max(float(np.abs(distance(points[object_id == i])).max(initial=0.0)) for i, distance in enumerate(away))


STRAYING: dict[str, dict[str, Any]] = {
    "straight": {},
    "noise": {"range_sigma": 0.5, "range_resolution": 0.1, "dropout": 0.3},
    "jitter": {"azimuth_sigma": 0.02, "elevation_sigma": 0.02},
    "beam": {"beam": ls.Beam(0.1, pulse_length=1e-9, rays=19), "returns": 5},
    "all": {
        "azimuth_sigma": 0.02, "elevation_sigma": 0.02, "range_sigma": 0.5, "dropout": 0.3,
        "beam": ls.Beam(0.1, 0.05, pulse_length=1e-9, rays=37), "returns": "dual",
    },
}  # fmt: skip


@pytest.mark.parametrize("motion", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("straying", STRAYING)
def test_true_points_lie_on_the_surfaces(straying: str, motion: bool) -> None:
    pattern = ls.patterns.Spinning(
        np.linspace(-0.5, 0.5, 12), columns=90, firing_times=np.arange(12) * 1e-4, beam_origins=[(0.1, 0.0, 0.2)] * 12
    )
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix()
    pose[:3, 3] = (0.4, -0.3, 0.2)
    path = ls.Trajectory.from_twist(pose, (3.0, 1.0, 0.0), (0.5, -1.0, 4.0)) if motion else pose
    scene, away = room()
    lidar = ls.Lidar(pattern, measurement=ls.Measurement(**STRAYING[straying]))
    scan = lidar.scan(scene, path, time=0.7, seed=2)
    cloud = scan.point_cloud("world")
    world = scan.true_points("world")
    assert world.shape == cloud.xyz.shape
    assert len(world) > 700
    # The core ends its ray on the surface, but for the rounding of t; the point is the end of the same ray, worked out
    # from the sensor's frame. Each coordinate of it is rounded: in the core 3 times for the direction's turn and 3 for
    # the origin's place; for the point 3 for its length, 2 for its end, 4 for its place; 4 for the pose's not being
    # quite a rotation; and 3 for the distance that is looked at.
    assert len(np.unique(cloud.object_id)) > 20
    assert furthest(world, cloud.object_id, away) < ROUNDED
    # In the sensor's frame the way from the beam's origin is the true range.
    local = scan.true_points()
    pulse = np.repeat(np.arange(len(scan)), scan.return_count)
    way = local - scan.pulses.origins[pulse]
    # Eight roundings: of the point, of its difference, and of the length or the product of vectors.
    assert np.allclose(np.linalg.norm(way, axis=1), cloud.true_range, rtol=2.0**-50, atol=0)
    astray = np.linalg.norm(np.cross(way, scan.pulses.directions[pulse]), axis=1) / cloud.true_range
    if straying in {"straight", "noise"}:
        assert scan.true_direction is None
        assert astray.max() < 2.0**-50
    else:
        assert astray.mean() > 1e-3
        assert astray.max() < 0.5
    # The moving sensor's frames are those of the points, pulse by pulse.
    times = 0.7 + scan.pulses.time[pulse]
    poses = path.at(times).as_matrix() if isinstance(path, ls.Trajectory) else np.broadcast_to(pose, (len(pulse), 4, 4))
    expected = np.einsum("nij,nj->ni", poses[:, :3, :3], local) + poses[:, :3, 3]
    assert np.allclose(expected, world, rtol=0, atol=ROUNDED)


def test_true_points_are_the_points_where_nothing_errs() -> None:
    scan = ls.Lidar(ls.patterns.Spinning([-0.1, 0.1], columns=64)).scan(room()[0], np.eye(4))
    for frame in ("sensor", "world"):
        assert np.allclose(scan.true_points(frame), scan.point_cloud(frame).xyz, rtol=0, atol=8 * 2.0**-49)
    with pytest.raises(ValueError, match=r"^frame: expected 'sensor' or 'world', got 'start'$"):
        scan.true_points("start")  # type: ignore[arg-type]


def test_true_points_of_directions_that_are_unit_to_float32_only() -> None:
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions = (directions / np.linalg.norm(directions, axis=1)[:, None]).astype(np.float32).astype(float)
    scene, away = room()
    scan = ls.Lidar(Along(directions)).scan(scene)
    assert np.ptp(np.linalg.norm(scan.pulses.directions, axis=1)) > 1e-8
    assert furthest(scan.true_points(), scan.point_cloud().object_id, away) < ROUNDED


# Draws


def uniform(seed: int, name: str, *, frame: int, pulse: int, effect: int, draw: int = 0) -> float:
    """The draw as it is documented."""

    def philox(counter: list[int], key: list[int]) -> list[int]:
        return [int(word) for word in _native.philox(np.array([counter], dtype=np.uint32), key)[0]]

    key = philox([seed % 2**32, seed >> 32, zlib.crc32(name.encode()), 0], [0, 0])[:2]
    words = philox([pulse % 2**32, pulse >> 32, frame, effect << 16 | draw], key)
    return ((words[1] << 32 | words[0]) >> 12) * 2.0**-52 + 2.0**-53


def test_draws_are_the_documented_ones() -> None:
    seed, frame, name = 0x0123456789ABCDEF, 5, "vorne ä"
    everything = ls.Measurement(range_sigma=1.0, dropout=0.5, elevation_sigma=0.01, azimuth_sigma=0.01)
    pattern = beams([1.0, 1.0, 0.0], count=100)
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 50.0))
    scan = ls.Lidar(pattern, measurement=everything, name=name).scan(scene, seed=seed, frame=frame)
    dropped = [uniform(seed, name, frame=frame, pulse=i, effect=2) < 0.5 for i in range(100)]
    assert (scan.status == ls.Status.dropped).tolist() == dropped
    normal = statistics.NormalDist().inv_cdf
    noise = np.array([normal(uniform(seed, name, frame=frame, pulse=i, effect=3)) for i in range(100)])
    left = np.where(dropped, np.nan, noise)
    # The noise is added to a range of 50 m, and the difference taken.
    assert np.allclose(scan.range_error[:, 0], left, rtol=0, atol=2 * math.ulp(50.0), equal_nan=True)
    # The direction that a pulse took is that of the hit, seen from the sphere's centre.
    took = scan.normal[:, 0].astype(float)
    azimuth = np.array([normal(uniform(seed, name, frame=frame, pulse=i, effect=1)) for i in range(100)]) * 0.01
    elevation = (
        np.array([normal(uniform(seed, name, frame=frame, pulse=i, effect=1, draw=1)) for i in range(100)]) * 0.01
    )
    assert np.allclose(np.arctan2(took[:, 1], took[:, 0]), np.pi / 4 + azimuth, rtol=0, atol=2.0**-24)
    assert np.allclose(np.arcsin(took[:, 2]), elevation, rtol=0, atol=2.0**-24)  # float32, below 1


def test_each_echo_has_its_own_draw() -> None:
    pattern, scene = beams([1.0, 1e-5, 0.0], count=20_000), edge(3.0)
    beam = ls.Beam(4e-3, pulse_length=SLOW_PULSE)
    clean = measure(pattern, scene, beam=beam, returns=2)
    noisy = measure(pattern, scene, beam=beam, returns=2, range_sigma=0.1)
    errors = noisy.range - clean.range
    assert np.allclose(errors.std(axis=0), 0.1, rtol=SIGMAS / math.sqrt(2 * 20_000))
    assert abs(np.corrcoef(errors.T)[0, 1]) < SIGMAS / math.sqrt(20_000)
    # The same echo draws the same, whether the other one is reported, or lost, or not.
    last = measure(pattern, scene, beam=beam, returns="last", range_sigma=0.1)
    alone = measure(pattern, scene, beam=beam, returns=2, range_sigma=0.1, min_range=21.5)
    assert np.array_equal(last.range[:, 0], noisy.range[:, 1])
    assert np.array_equal(alone.range[:, 0], noisy.range[:, 1])


EFFECTS: dict[str, dict[str, Any]] = {
    "azimuth": {"azimuth_sigma": 1e-9},
    "elevation": {"elevation_sigma": 1e-9},
    "dropout": {"dropout": 0.3},
    "noise": {"range_sigma": 0.1},
    "noise of weak echoes": {"range_sigma_limit": 1e-9, "detection": ls.Detection(0.1, 1000.0)},
    "bias": {"range_bias": 0.5},
    "channel bias": {"channel_bias_sigma": 1e-9},
    "quantisation": {"range_resolution": 1e-9},
    "detection": {"detection": ls.Detection(0.1, 1000.0)},
    "extinction": {"extinction": 1e-3},
    "false returns": {"false_returns": 1e-9, "max_range": 1e3},
    "crossover": {"crossover": (0.0, 1.0)},
    "fluctuation": {"power_sigma": 1e-9},
    "soft detection": {"detection": ls.Detection(0.1, 1000.0, 1e-9)},
    "near threshold": {"near_threshold": 1e-9},
    "response": {"response": ls.Response(sigma=0.1, ring_sigma=0.1)},
    "beam": {"beam": ls.Beam(1e-9)},
}
"""Each effect so small that it changes nothing but by its draws, if it has any."""


@pytest.mark.parametrize("toggled", EFFECTS)
def test_an_effect_leaves_the_draws_of_the_others(toggled: str) -> None:
    def errors(effects: list[str]) -> tuple[Floats, list[bool]]:
        parameters = {key: value for name in effects for key, value in EFFECTS[name].items()}
        scan = measure(before_wall(np.full(5000, 20.0)), wall(), **parameters)
        dropped = scan.status == ls.Status.dropped
        return scan.range[:, 0], dropped.tolist()

    rest = [name for name in EFFECTS if name != toggled]
    with_it, without = errors([*rest, toggled]), errors(rest)
    shift = 0.5 if toggled == "bias" else 0.0
    if toggled == "dropout":
        kept = np.isfinite(with_it[0])
        assert 0 < kept.sum() < 5000
        assert not any(without[1])
        assert np.allclose(with_it[0][kept], without[0][kept], rtol=0, atol=1e-7)
        return
    assert with_it[1] == without[1]
    if toggled == "noise":
        assert np.nanstd(without[0]) < 1e-7 < np.nanstd(with_it[0])
        return
    assert np.allclose(with_it[0] - shift, without[0], rtol=0, atol=1e-7, equal_nan=True)


# Bad input


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"range_sigma": -0.1}, "range_sigma: expected a finite number >= 0, got -0.1"),
        ({"range_sigma": math.nan}, "range_sigma: expected a finite number >= 0, got nan"),
        ({"range_sigma_slope": -1e-3}, "range_sigma_slope: expected a finite number >= 0, got -0.001"),
        (
            {"range_sigma_limit": -0.1, "detection": ls.Detection(0.1, 9.0)},
            "range_sigma_limit: expected a finite number >= 0, got -0.1",
        ),
        (
            {"range_sigma_limit": 0.02},
            "range_sigma_limit: expected 0 without a detection limit, got 0.02; give `detection`",
        ),
        ({"range_bias": math.inf}, "range_bias: expected a finite number, got inf"),
        ({"channel_bias_sigma": -0.1}, "channel_bias_sigma: expected a finite number >= 0, got -0.1"),
        ({"range_resolution": -0.1}, "range_resolution: expected a finite number >= 0, got -0.1"),
        ({"azimuth_sigma": -0.1}, "azimuth_sigma: expected a finite number from 0 to 1, got -0.1"),
        ({"elevation_sigma": 2}, "elevation_sigma: expected a finite number from 0 to 1, got 2.0; degrees?"),
        ({"dropout": 1.5}, "dropout: expected a finite number from 0 to 1, got 1.5"),
        ({"dropout": -0.5}, "dropout: expected a finite number from 0 to 1, got -0.5"),
        ({"power_sigma": -0.1}, "power_sigma: expected a finite number >= 0, got -0.1"),
        ({"crossover": (-1.0, 2.0)}, "crossover: expected 0 <= near < far, got -1.0 and 2.0"),
        ({"crossover": (2.0, 2.0)}, "crossover: expected 0 <= near < far, got 2.0 and 2.0"),
        ({"crossover": (2.0,)}, "crossover: expected shape (2,), got (1,)"),
        ({"crossover": (0.5, math.inf)}, "crossover: expected finite numbers, got crossover[1] = inf"),
        ({"false_returns": 1.5}, "false_returns: expected a finite number from 0 to 1, got 1.5"),
        ({"false_returns": -0.1}, "false_returns: expected a finite number from 0 to 1, got -0.1"),
        ({"extinction": -1.0}, "extinction: expected a finite number >= 0, got -1.0"),
        ({"range_sigma": []}, "range_sigma: expected shape (n, 2), got (0,)"),
        ({"range_sigma": np.zeros((0, 2))}, "range_sigma: expected 1 or more rows (range, sigma), got 0"),
        ({"range_sigma": [1.0, 2.0]}, "range_sigma: expected shape (n, 2), got (2,)"),
        ({"range_sigma": [(1.0, 0.1), (1.0, 0.2)]}, "range_sigma: expected rising ranges, got 1.0 after 1.0 in row 1"),
        ({"range_sigma": [(2.0, 0.1), (1.0, 0.2)]}, "range_sigma: expected rising ranges, got 1.0 after 2.0 in row 1"),
        (
            {"range_sigma": [(1.0, 0.1), (2.0, -0.2)]},
            "range_sigma: expected numbers >= 0, got range_sigma[1][1] = -0.2",
        ),
        (
            {"range_sigma": [(1.0, math.nan)]},
            "range_sigma: expected finite numbers, got range_sigma[0][1] = nan",
        ),
        (
            {"range_sigma": [(1.0, 0.1)], "range_sigma_slope": 0.1},
            "range_sigma_slope: expected 0 with a table of range_sigma, got 0.1",
        ),
        (
            {"returns": "best"},
            "returns: expected 'strongest', 'first', 'last', 'dual' or a number, got 'best'",
        ),
        ({"returns": 0}, "returns: expected an integer from 1 to 255, got 0"),
        ({"returns": 256}, "returns: expected an integer from 1 to 255, got 256"),
        ({"depth": 0}, "depth: expected an integer from 1 to 255, got 0"),
        ({"depth": 256}, "depth: expected an integer from 1 to 255, got 256"),
    ],
)
def test_values_that_cannot_be_are_refused(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Measurement(**parameters)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"range_sigma": "2 cm"}, "range_sigma: expected a finite number >= 0, got '2 cm'"),
        ({"dropout": None}, "dropout: expected a finite number from 0 to 1, got None"),
        ({"crossover": "near"}, "crossover: expected real numbers of shape (2,), got 'near'"),
        ({"detection": 0.1}, "detection: expected a Detection or None, got 0.1"),
        ({"beam": 0.003}, "beam: expected a Beam or None, got 0.003"),
        ({"returns": 1.5}, "returns: expected an integer from 1 to 255, got 1.5"),
        ({"returns": True}, "returns: expected an integer from 1 to 255, got True"),
    ],
)
def test_wrong_types_are_refused(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=f"^{re.escape(message)}$"):
        ls.Measurement(**parameters)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ls.Detection(0.0, 10.0), "reflectivity: expected a finite number > 0 and <= 1, got 0.0"),
        (lambda: ls.Detection(0.1, -1.0), "range: expected a finite number > 0, got -1.0"),
        (lambda: ls.Beam(-1e-3), "divergence_azimuth: expected a finite number from 0 to 0.1, got -0.001"),
        (lambda: ls.Beam(1e-3, math.inf), "divergence_elevation: expected a finite number from 0 to 0.1, got inf"),
        (lambda: ls.Beam(1e-3, pulse_length=0.0), "pulse_length: expected a finite number > 0 and <= 1e-06, got 0.0"),
        (lambda: ls.Beam(1e-3, separation=-1.0), "separation: expected a finite number >= 0, got -1.0"),
        (lambda: ls.Beam(1e-3, separation=math.inf), "separation: expected a finite number >= 0, got inf"),
        (lambda: ls.Beam(1e-3, rays=10), "rays: expected 5, 7, 19, 37, 61 or 91, got 10"),
    ],
)
def test_parts_refuse_what_cannot_be(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        make()


def test_a_measurement_is_a_value() -> None:
    one = ls.Measurement(range_sigma=[(1, 0.1), (2, 0.2)], beam=ls.Beam(1e-3), returns=2)
    other = ls.Measurement(range_sigma=np.array([[1, 0.1], [2, 0.2]]), beam=ls.Beam(1e-3, 1e-3), returns=2)
    assert one == other
    assert hash(one) == hash(other)
    assert one.max_returns == 2
    assert dataclasses.replace(one, returns="first").max_returns == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.dropout = 0.5  # type: ignore[misc]


@pytest.mark.parametrize("returns", [1, 4, 255, "dual"])
def test_a_single_ray_reports_one_return_whatever_is_asked_for(returns: Any) -> None:
    lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-0.5, 0.5, 9), [-0.2], rate=10.0))
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.8))
    asked = dataclasses.replace(lidar, measurement=ls.Measurement(returns=returns))
    assert asked.measurement.max_returns == 1
    assert asked.measurement.returns == returns  # a beam given later has them
    scan = asked.scan(scene)
    assert (scan.return_count == 1).all()
    np.testing.assert_array_equal(scan.range, lidar.scan(scene).range)
    several = ls.Measurement(returns=returns, beam=ls.Beam(3e-3, rays=7))
    count = 2 if returns == "dual" else returns
    assert dataclasses.replace(lidar, measurement=several).scan(scene).range.shape == (9, count)
