"""Full waveforms: exact where the light is known in closed form, and the echoes of the scan are their peaks."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy import integrate, special

import lidarsim as ls

Floats = npt.NDArray[np.float64]
HALF_C = 299_792_458.0 / 2.0

LAST_PLACE = 2.0**-24 + 2.0**-38
"""Relative error of a sample: its rounding to float32. Before that, its range and that of the surface are off by an ulp
of 128 m each, 2⁻⁴⁶ m; 6σ off, with σ at least 0.06 m, the exponent changes by 6·2⁻⁴⁶/σ < 2⁻³⁹."""

CUT = math.exp(-18.0)
"""What is left of a Gaussian beyond the 6σ that are recorded."""


def sigma(pulse_length: float) -> float:
    """Standard deviation of a Gaussian pulse of this full width at half maximum, s, as a range, m."""
    return HALF_C * pulse_length / math.sqrt(8.0 * math.log(2.0))


def gaussian(ranges: Floats, at: float, width: float) -> Floats:
    result: Floats = np.exp(-0.5 * ((ranges - at) / width) ** 2)
    return result


def shoot(
    scene: ls.Scene,
    directions: npt.ArrayLike = ((1.0, 0.0, 0.0),),
    *,
    max_range: float = math.inf,
    min_range: float = 0.0,
    indices: npt.ArrayLike | None = None,
    seed: int = 0,
    pose: Any = None,
    **measurement: Any,
) -> ls.Scan:
    lidar = ls.Lidar(
        ls.patterns.Table(directions, rate=10.0),
        measurement=ls.Measurement(**measurement),
        max_range=max_range,
        min_range=min_range,
    )
    return (
        ls.scan.scan(lidar, scene, pose, seed=seed, indices=indices) if indices else lidar.scan(scene, pose, seed=seed)
    )


def wall(x: float, reflectivity: float = 1.0, **material: float) -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), x), material=ls.Material(reflectivity=reflectivity, **material))
    return scene


def fan(count: int = 200, spread: float = 0.5) -> Floats:
    angles = np.linspace(-spread, spread, count)
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])


def ball_and_wall() -> ls.Scene:
    scene = wall(40.0, 0.3)
    scene.add(ls.Sphere((20, 0, 0), 4.0), material=ls.Material(reflectivity=0.5, roughness=0.2))
    return scene


# --- Exact waveforms -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sample_period", [1e-9, 3.7e-10])
@pytest.mark.parametrize("distance", [0.5, 10.1, 99.7])
def test_a_plane_at_normal_incidence_gives_the_pulse_itself(distance: float, sample_period: float) -> None:
    waveforms = shoot(wall(distance, 0.25)).waveforms(sample_period)
    ranges, power = waveforms[0]
    mpmath.mp.prec = 200
    width = mpmath.mpf(299_792_458) / 2 * mpmath.mpf(5e-9) / mpmath.sqrt(8 * mpmath.log(2))
    step = mpmath.mpf(299_792_458) / 2 * mpmath.mpf(sample_period)
    first = int(waveforms.first[0])
    for k, found in enumerate(power.tolist()):
        way = (step * (first + k) - mpmath.mpf(distance)) / width
        expected = mpmath.mpf(0.25) / mpmath.mpf(distance) ** 2 * mpmath.exp(-(way**2) / 2)
        assert abs(found / expected - 1) <= LAST_PLACE
    assert len(power) == math.floor((distance + 6 * width) / step) - math.ceil((distance - 6 * width) / step) + 1
    assert np.array_equal(ranges, HALF_C * sample_period * (first + np.arange(len(power))))
    assert waveforms.time.tolist() == [first * sample_period]
    # As the emitted pulse, at its own place among the samples.
    reach, emitted = waveforms.emitted
    near = int(np.abs(ranges - distance).argmin())
    assert emitted.max() == emitted[len(emitted) // 2] == 1.0
    assert reach[len(reach) // 2] == 0.0
    assert abs(power[near] - 0.25 / distance**2 * np.exp(-0.5 * ((ranges[near] - distance) / float(width)) ** 2)) < 1e-6


def cells(rays: int) -> list[tuple[float, float, float, float, float]]:
    """The cells of a beam: least and greatest radius and angle, and the energy; in units of the half angle at 1/e²."""
    rings = {7: 1, 19: 2, 37: 3, 61: 4, 91: 5}[rays]
    width = 1.0 / (rings + 0.5)
    whole = 1.0 - math.exp(-2.0)
    found = [(0.0, width / 2, 0.0, 2 * math.pi, (1.0 - math.exp(-(width**2) / 2)) / whole)]
    for ring in range(1, rings + 1):
        near, far = (ring - 0.5) * width, (ring + 0.5) * width
        energy = (math.exp(-2.0 * near**2) - math.exp(-2.0 * far**2)) / whole / (6 * ring)
        half = math.pi / (6 * ring)
        found += [(near, far, 2 * j * half - half, 2 * j * half + half, energy) for j in range(6 * ring)]
    return found


def left_of(offset: float) -> float:
    """Share of the energy of a beam, cut off at its 1/e² ellipse, further left than so many half angles."""
    inner = integrate.quad(
        lambda y: math.exp(-2 * y**2) * special.erf(math.sqrt(2.0 * (1.0 - y**2))), offset, 1.0, epsabs=1e-13
    )[0]
    whole = integrate.quad(
        lambda y: math.exp(-2 * y**2) * special.erf(math.sqrt(2.0 * (1.0 - y**2))), -1.0, 1.0, epsabs=1e-13
    )[0]
    return inner / whole


@pytest.mark.parametrize("rays", [19, 37, 91])
@pytest.mark.parametrize("offset", [-0.55, 0.013, 0.31])
def test_two_surfaces_in_the_footprint_share_the_power_by_their_solid_angles(offset: float, rays: int) -> None:
    near, far, divergence, pulse_length = 50.0, 58.0, 1e-3, 4e-9
    scene = wall(far, 0.4)
    edge = offset * math.tan(divergence / 2) * near
    leaf = [[near, edge, -9.0], [near, 9.0, -9.0], [near, 9.0, 9.0], [near, edge, 9.0]]
    scene.add(ls.Polygon(leaf), material=ls.Material(reflectivity=0.7))
    scan = shoot(scene, beam=ls.Beam(divergence, pulse_length=pulse_length, rays=rays), returns=2)
    ranges, power = scan.waveforms(2e-10)[0]
    width = sigma(pulse_length)
    pulses = np.column_stack(
        [0.7 / near**2 * gaussian(ranges, near, width), 0.4 / far**2 * gaussian(ranges, far, width)]
    )
    shares = np.linalg.lstsq(pulses, power.astype(np.float64), rcond=None)[0]
    # Sub-rays meet the walls up to half a divergence off: the range is longer by R·ε²/2, with ε = 5e-4 rad, so R/σ
    # times that of the pulse's width; the cosine and 1/R² are less by ε²/2 and ε².
    skew = 0.5 * (divergence / 2) ** 2
    assert abs(shares.sum() - 1.0) < 4 * skew + (far * skew / width) ** 2 + far * skew / width / 10
    straddling, whole = 0.0, 0.0
    for low, high, begin, end, energy in cells(rays):
        around = np.linspace(begin, end, 400)
        sides = np.concatenate([low * np.cos(around), high * np.cos(around)])
        straddling += energy if sides.min() < offset < sides.max() else 0.0
        middle = 0.0 if low == 0.0 else 0.5 * (low + high) * math.cos(0.5 * (begin + end))
        whole += energy if middle > offset else 0.0
    assert abs(shares[0] - whole) < 1e-4
    assert abs(shares[0] - left_of(offset)) < straddling < 0.5


def slanted(ranges: Floats, distance: float, slope: float, half_angle: float, width: float) -> Floats:
    """Waveform of an oblique plane, up to a factor: the pulse convolved with the profile of the beam, along the slope.

    The profile exp(−2r²/w²), cut off at w, has the marginal exp(−2y²)·erf(√(2 − 2y²)) of y in units of w.
    """
    y = np.cos(np.pi * (np.arange(2000) + 0.5) / 2000)  # of Chebyshev: the marginal ends as a square root does
    weight = np.sqrt(1.0 - y**2) * np.exp(-2.0 * y**2) * special.erf(np.sqrt(2.0 - 2.0 * y**2))
    at = distance * (1.0 + slope * half_angle * y)
    result: Floats = (weight[:, None] * np.exp(-0.5 * ((ranges - at[:, None]) / width) ** 2)).sum(axis=0) / weight.sum()
    return result


@pytest.mark.parametrize("slope", [0.5, 2.0, 5.0])
def test_an_oblique_plane_stretches_the_pulse(slope: float) -> None:
    distance, divergence, pulse_length = 100.0, 4e-3, 2e-9
    scene = ls.Scene()
    scene.add(ls.Plane((1, slope, 0), distance))  # x + slope·y = distance: R ≈ distance·(1 − slope·y)
    width, errors = sigma(pulse_length), []
    for rays in (7, 19, 37, 61, 91):
        beam = ls.Beam(divergence, pulse_length=pulse_length, rays=rays)
        ranges, power = shoot(scene, beam=beam).waveforms(1e-10)[0]
        expected = slanted(ranges, distance, slope, divergence / 2, width) / distance**2 / math.hypot(1.0, slope)
        errors.append(float(np.abs(power - expected).max() / expected.max()))
        # A sub-ray's own spread adds δ²/2 to the variance, with δ the way to the next; the height of a Gaussian falls
        # by half of the relative growth. The rest is R and the cosine, which change by slope·ε over the footprint.
        rings = {7: 1, 19: 2, 37: 3, 61: 4, 91: 5}[rays]
        delta = distance * slope * divergence / 2 / (rings + 0.5)
        spread = (distance * slope * divergence / 2) ** 2 * 0.25 * (1 - 3 * math.exp(-2)) / (1 - math.exp(-2))
        assert errors[-1] < 0.5 * delta**2 / (width**2 + spread) + 3 * slope * divergence / 2, rays
    assert errors[-1] < errors[0]
