"""Full waveforms: exact where the light is known in closed form, and the echoes of the scan are their peaks."""

from __future__ import annotations

import copy
import math
import pickle
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy import integrate, signal, special

import lidarsim as ls
from lidarsim.errors import FileFormatError

Floats = npt.NDArray[np.float64]
HALF_C = 299_792_458.0 / 2.0

LAST_PLACE = 2.0**-24 + 2.0**-38
"""Relative error of a sample: its rounding to float32. Before that, its range and that of the surface are off by an ulp
of 128 m each, 2⁻⁴⁶ m; 6σ off, with σ at least 0.06 m, the exponent changes by 6·2⁻⁴⁶/σ < 2⁻³⁹."""

CUT = math.exp(-18.0)
"""What is left of a Gaussian beyond the 6σ that are recorded."""

ALL_AIR = (0.0, 0.01)
"""Overlap of a receiver that sees all of fog, rain and snow from the least range on."""


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
        measurement=ls.Measurement(**{"crossover": ALL_AIR, **measurement}),
        max_range=max_range,
        min_range=min_range,
    )
    return (
        ls.scan.scan.scan(lidar, scene, pose, seed=seed, indices=indices)
        if indices
        else lidar.scan(scene, pose, seed=seed)
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
    # float32 rounds by 2⁻²⁴; the argument of exp is at most 18, with some roundings of float64.
    np.testing.assert_allclose(emitted, np.exp(-0.5 * (reach / float(width)) ** 2), rtol=1.01 * 2.0**-24)
    assert abs(power[near] - 0.25 / distance**2 * np.exp(-0.5 * ((ranges[near] - distance) / float(width)) ** 2)) < 1e-6


def cells(rays: int) -> list[tuple[float, float, float, float, float]]:
    """The cells of a beam: least and greatest radius and angle, and the energy; in units of the half angle at 1/e²."""
    rings = {5: 1, 7: 1, 19: 2, 37: 3, 61: 4, 91: 5}[rays]
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


def oblique_waveform(ranges: Floats, distance: float, slope: float, half_angle: float, width: float) -> Floats:
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
    for rays in (5, 7, 19, 37, 61, 91):
        beam = ls.Beam(divergence, pulse_length=pulse_length, rays=rays)
        ranges, power = shoot(scene, beam=beam).waveforms(1e-10)[0]
        expected = (
            oblique_waveform(ranges, distance, slope, divergence / 2, width) / distance**2 / math.hypot(1.0, slope)
        )
        errors.append(float(np.abs(power - expected).max() / expected.max()))
        # A sub-ray's own spread adds δ²/2 to the variance, with δ the way to the next; the height of a Gaussian falls
        # by half of the relative growth. The rest is R and the cosine, which change by slope·ε over the footprint.
        rings = {5: 1, 7: 1, 19: 2, 37: 3, 61: 4, 91: 5}[rays]
        delta = distance * slope * divergence / 2 / (rings + 0.5)
        spread = (distance * slope * divergence / 2) ** 2 * 0.25 * (1 - 3 * math.exp(-2)) / (1 - math.exp(-2))
        assert errors[-1] < 0.5 * delta**2 / (width**2 + spread) + 3 * slope * divergence / 2, rays
    assert errors[-1] < errors[0]


def densely(scene: ls.Scene, ranges: Floats, divergence: float, pulse_length: float, rays: int = 5000) -> Floats:
    """The waveform along x as HELIOS++ sums it, with a Gaussian pulse: that of each of many narrow rays, by its energy.

    A spiral by the golden angle fills the footprint, its radii by the quantiles of the Gaussian profile. (HELIOS++ has
    rings, and the pulse (t/τ)²·exp(−t/τ).)
    """
    energy = (np.arange(rays) + 0.5) / rays
    radius = np.tan(divergence / 2.0) * np.sqrt(-0.5 * np.log(1.0 - energy * (1.0 - math.exp(-2.0))))
    angle = np.arange(rays) * np.pi * (3.0 - math.sqrt(5.0))
    directions = np.column_stack([np.ones(rays), radius * np.cos(angle), radius * np.sin(angle)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hits = scene.cast(np.zeros((rays, 3)), directions)
    t, normal = hits.t[hits.hit], hits.normal[hits.hit]
    power = np.abs((normal * directions[hits.hit]).sum(axis=1)) / t**2 / rays
    expected = np.zeros(len(ranges))
    for at, share in zip(t, power, strict=True):
        expected += share * gaussian(ranges, at, sigma(pulse_length))
    return expected


def crown(seed: int, leaves: int = 900) -> ls.Scene:
    """Leaves of 6 cm before a slanted ground."""
    generator = np.random.default_rng(seed)
    corners = 0.06 * np.array([[math.cos(a), math.sin(a), 0.0] for a in 2 * np.pi * np.arange(3) / 3])
    attitudes = np.linalg.qr(generator.normal(size=(leaves, 3, 3)))[0]
    places = generator.uniform((100.0, -0.4, -0.4), (108.0, 0.4, 0.4), (leaves, 3))
    vertices = (places[:, None] + corners @ attitudes).reshape(-1, 3)
    scene = ls.Scene()
    scene.add(ls.TriangleMesh(vertices, np.arange(3 * leaves).reshape(-1, 3)))
    scene.add(ls.Plane((1, 0.3, 0), 115.0))
    return scene


def test_waveforms_are_those_of_a_dense_footprint() -> None:
    divergence, pulse_length, errors = 3e-3, 4e-9, {}
    scenes = [crown(seed) for seed in range(4)]
    for rays in (7, 91):
        beam = ls.Beam(divergence, pulse_length=pulse_length, rays=rays)
        apart = []
        for scene in scenes:
            ranges, power = shoot(scene, beam=beam).waveforms(5e-10)[0]
            expected = densely(scene, ranges, divergence, pulse_length)
            apart.append(np.linalg.norm(power - expected) / np.linalg.norm(expected))
        errors[rays] = np.mean(apart)
    # Rays at random, of which n reach a stretch as long as a pulse, have an error of 1/√n; those on rings less. The
    # crown is 8 m deep, and ∫g²/(∫g)² of a pulse is 1/(2√π·σ).
    assert errors[91] < 1.0 / math.sqrt(91 * 2.0 * math.sqrt(math.pi) * sigma(pulse_length) / 8.0)
    assert errors[91] < errors[7] / 2


# --- The echoes of the scan ------------------------------------------------------------------------------------------


def peaks_of(power: npt.NDArray[np.float32], prominence: float) -> npt.NDArray[np.intp]:
    """Peaks that rise from the valleys beside them by this share of their own height."""
    found, properties = signal.find_peaks(power.astype(np.float64), prominence=0.0)
    kept: npt.NDArray[np.intp] = found[properties["prominences"] >= prominence * power[found]]
    return kept


@pytest.mark.parametrize("pulse_length", [1e-9, 5e-9])
def test_the_peaks_are_the_echoes_of_the_scan(pulse_length: float) -> None:
    beam = ls.Beam(3e-3, pulse_length=pulse_length, rays=91)
    width, echoes = sigma(pulse_length), 0
    for seed in range(20):
        scan = shoot(crown(seed), beam=beam, returns=91)
        count = int(scan.return_count[0])
        ranges, power = scan.waveforms(pulse_length / 50)[0]
        # The core looks for valleys where two sub-rays alone would have one: it may miss shallow ones.
        all_peaks, clear = peaks_of(power, 0.0), peaks_of(power, 0.05)
        assert len(clear) <= count <= len(all_peaks)
        found = scan.true_range[0, :count]
        near = np.abs(ranges[all_peaks][:, None] - scan.range[0, :count]).min(axis=0)
        assert near.max() < 2.0 * width, found
        # The light between the valleys is that of the echo, but for the tails of its neighbours.
        if len(all_peaks) == count:
            deep = [int(low + power[low:high].argmin()) for low, high in pairwise(all_peaks)]
            parts = np.split(np.arange(len(power)), deep)
            area = np.array([power[part].sum(dtype=np.float64) for part in parts]) * (ranges[1] - ranges[0])
            middle = np.array([np.average(ranges[part], weights=power[part]) for part in parts])
            given = scan.intensity[0, :count] / scan.range[0, :count] ** 2
            floor = np.array([max(power[part[0]], power[part[-1]]) / power[part].max() for part in parts])
            alone = floor < 1e-4
            assert np.abs(area / width / math.sqrt(2 * math.pi) / given - 1.0)[alone].max(initial=0.0) < 1e-3
            assert np.abs(middle - scan.range[0, :count])[alone].max(initial=0.0) < 1e-3
            echoes += int(alone.sum())
    assert echoes >= 10


def test_panes_and_mirrors_are_in_the_waveform_of_a_single_ray() -> None:
    scene = wall(30.0, 0.5)
    scene.add(ls.Plane((1, 0, 0), 10.0), material=ls.Material(reflectivity=0.04, transmission=0.8))
    scan = shoot(scene, depth=3, returns=2)
    assert scan.true_range.tolist() == [[10.0, 30.0]]
    ranges, power = scan.waveforms(1e-10)[0]
    width = sigma(5e-9)
    expected = 0.04 / 100 * gaussian(ranges, 10.0, width) + 0.8**2 * 0.5 / 900 * gaussian(ranges, 30.0, width)
    # Powers and intensities are float32, the former of a curve to 2⁻³⁸ of its peak.
    assert np.abs(power - expected).max() < (2.0**-24 + 2.0**-38) * expected.max()
    assert np.allclose(scan.intensity, [[0.04, 0.8**2 * 0.5]], rtol=2.0**-24, atol=0)
    # Off a mirror at 45°, onto a wall to the side: at the length of the way.
    scene = ls.Scene()
    scene.add(ls.Plane((1, 1, 0), 10.0), material=ls.Material(reflectivity=0.0, mirror=0.9))
    scene.add(ls.Plane((0, 1, 0), -7.0), material=ls.Material(reflectivity=0.5))
    ranges, power = shoot(scene, depth=2).waveforms(1e-11)[0]
    assert abs(ranges[power.argmax()] - 17.0) < HALF_C * 1e-11
    assert abs(power.max() / (0.9**2 * 0.5 / 17.0**2) - 1.0) < 1e-5


def test_extinction_weakens_the_light() -> None:
    scene = wall(30.0, 0.5)
    clear = shoot(scene).waveforms()[0].power
    dim = shoot(scene, extinction=0.01).waveforms()[0].power
    assert np.allclose(dim, clear * math.exp(-0.6), rtol=2.0**-22, atol=0.0)


# --- Weather ---------------------------------------------------------------------------------------------------------


def fog_alone(at: float, begin: float, end: float, air: ls.Atmosphere, width: float) -> float:
    """π·β·∫ g(R − r)/r²·exp(−2αr) dr."""

    def integrand(r: float) -> float:
        return math.exp(-0.5 * ((at - r) / width) ** 2 - 2.0 * air.extinction * r) / r**2

    low, high = max(begin, at - 9 * width), min(end, at + 9 * width)
    if low >= high:
        return 0.0
    result: float = integrate.quad(integrand, low, high, epsabs=0.0, epsrel=1e-11, limit=200)[0]
    return math.pi * air.backscatter * result


@pytest.mark.parametrize("distance", [4.0, 25.0, math.inf])
def test_fog_is_the_integral_of_its_backscatter(distance: float) -> None:
    scene = ls.Scene() if distance == math.inf else wall(distance, 0.2)
    scene.atmosphere = air = ls.Atmosphere.fog(visibility=50.0)
    width = sigma(5e-9)
    scan = shoot(scene, min_range=1.0, max_range=120.0)
    ranges, power = scan.waveforms()[0]
    surface = 0.2 * math.exp(-2.0 * air.extinction * distance) / distance**2
    expected = np.array([fog_alone(at, 1.0, distance, air, width) for at in ranges])
    top = expected.max()
    if distance < math.inf:
        expected += surface * gaussian(ranges, distance, width)
        assert 0.0 <= distance + 6.0 * width - ranges[-1] < ranges[1] - ranges[0]
    else:
        assert 100.0 < ranges[-1] <= 120.0 + 6.0 * width
    # Simpson's rule: 2·10⁻⁶ of the peak; what is cut off; float32.
    error = np.abs(power - expected)
    assert (error <= 2e-6 * top + CUT * (surface + top) + LAST_PLACE * expected).all()
    if distance == math.inf:
        # The scan's echo is the peak.
        assert scan.source is not None
        assert scan.source.tolist() == [[ls.Source.atmosphere]]
        fine, power = scan.waveforms(1e-11)[0]
        assert abs(fine[power.argmax()] - scan.true_range[0, 0]) < 0.01
        assert abs(power.max() * scan.true_range[0, 0] ** 2 / scan.intensity[0, 0] - 1.0) < 5e-6


def test_fog_ends_where_each_sub_ray_does() -> None:
    scene = wall(9.0, 0.2)
    scene.add(ls.Polygon([[5.0, 0.0013, -9], [5.0, 9, -9], [5.0, 9, 9], [5.0, 0.0013, 9]]))
    scene.atmosphere = air = ls.Atmosphere.fog(visibility=30.0)
    beam = ls.Beam(4e-3, rays=19)
    scan = shoot(scene, min_range=1.0, max_range=50.0, beam=beam, returns=3)
    ranges, power = scan.waveforms(3e-10)[0]
    width = sigma(5e-9)
    near = sum(
        energy
        for low, high, begin, end, energy in cells(19)
        if low and (low + high) * math.cos((begin + end) / 2) > 0.26
    )
    assert 0.2 < near < 0.5
    dim = [math.exp(-2 * air.extinction * at) / at**2 for at in (5.0, 9.0)]
    expected = near * dim[0] * gaussian(ranges, 5.0, width) + (1 - near) * 0.2 * dim[1] * gaussian(ranges, 9.0, width)
    fog = [np.array([fog_alone(at, 1.0, end, air, width) for at in ranges]) for end in (5.0, 9.0)]
    expected += near * fog[0] + (1 - near) * fog[1]
    # The way of a sub-ray is longer by R·ε²/2 < 2e-5 m, of σ = 0.3 m; and weaker by 3·ε²/2.
    assert np.abs(power - expected).max() < 1e-4 * expected.max()


def test_drops_and_flakes_are_those_of_the_scan() -> None:
    scene = wall(60.0, 0.2)
    scene.atmosphere = ls.Atmosphere.snow(rate=5.0)
    detection = ls.Detection(0.1, 150.0)
    scan = shoot(
        scene,
        fan(400),
        seed=7,
        min_range=1.0,
        max_range=200.0,
        beam=ls.Beam(2e-3, pulse_length=2e-9),
        returns=10,
        detection=detection,
    )
    assert scan.source is not None
    flakes = scan.source == ls.Source.atmosphere
    assert flakes.sum() > 50
    waveforms = scan.waveforms(1e-10)
    width = sigma(2e-9)
    for pulse, number in np.argwhere(flakes):
        ranges, power = waveforms[pulse]
        at = scan.true_range[pulse, number]
        near = int(np.abs(ranges - at).argmin())
        peak = scan.intensity[pulse, number] / at**2 * np.exp(-0.5 * ((ranges[near] - at) / width) ** 2)
        assert power[near] >= 0.999999 * peak
    # Alone, a flake is a Gaussian.
    alone = np.flatnonzero((scan.return_count == 2) & flakes[:, 0] & (scan.true_range[:, 0] < 40.0))
    assert len(alone) > 5
    exact = 0
    for pulse in alone:
        ranges, power = waveforms[pulse]
        at = scan.true_range[pulse, 0]
        expected = scan.intensity[pulse, 0] / at**2 * gaussian(ranges, at, width)
        around = np.abs(ranges - at) < 3 * width
        exact += bool(np.allclose(power[around], expected[around], rtol=1e-5, atol=0.0))
    assert exact > len(alone) / 2  # others have neighbours that are not told apart


# --- The same pulses, and which of them ------------------------------------------------------------------------------


def test_jittered_pulses_are_fired_in_the_same_directions() -> None:
    scan = shoot(ball_and_wall(), fan(), seed=11, azimuth_sigma=5e-3, elevation_sigma=3e-3)
    other = shoot(ball_and_wall(), fan(), seed=12, azimuth_sigma=5e-3, elevation_sigma=3e-3)
    assert np.abs(scan.true_range - other.true_range).max() > 0.1
    for pulse, (ranges, power) in enumerate(scan.waveforms(1e-10)):
        assert abs(ranges[power.argmax()] - scan.true_range[pulse, 0]) <= 0.5001 * HALF_C * 1e-10


def test_sensor_and_scene_move() -> None:
    scene = wall(40.0)
    scene.add(ls.Sphere((20, 0, 0), 4.0), motion=ls.Trajectory.from_twist(np.eye(4), (0, 30.0, 0), (0, 0, 0)))
    drive = ls.Trajectory.from_twist(np.eye(4), (20.0, 0, 0), (0, 0, 0.1))
    lidar = ls.Lidar(ls.patterns.Table(fan(), times=np.linspace(0.0, 0.09, 200), rate=10.0))
    scan = lidar.scan(scene, drive, time=0.25)
    assert len(np.unique(scan.object_id)) == 2
    for pulse, (ranges, power) in enumerate(scan.waveforms(1e-10)):
        assert abs(ranges[power.argmax()] - scan.true_range[pulse, 0]) <= 0.5001 * HALF_C * 1e-10


def test_some_pulses_are_as_among_all() -> None:
    scene = crown(3)
    scene.atmosphere = ls.Atmosphere.rain(rate=20.0)
    settings = {"beam": ls.Beam(3e-3), "azimuth_sigma": 1e-3, "returns": 3, "max_range": 150.0, "min_range": 0.5}
    scan = shoot(scene, fan(300, 0.003), **settings)
    everything = scan.waveforms()
    assert everything.pulse.tolist() == list(range(300))
    chosen = [7, 3, 3, 299]
    some = scan.waveforms(pulses=chosen)
    assert some.pulse.tolist() == chosen
    mask = np.isin(np.arange(300), chosen)
    masked = scan.waveforms(pulses=mask)
    assert masked.pulse.tolist() == [3, 7, 299]
    part = shoot(scene, fan(300, 0.003), indices=[9, 7, 3, 299], **settings).waveforms(pulses=[1, 2, 2, 3])
    for waveforms in (some, part):
        for i, pulse in enumerate(chosen):
            assert waveforms.first[i] == everything.first[pulse]
            assert waveforms[i].power.tobytes() == everything[pulse].power.tobytes()
    assert len(scan.waveforms(pulses=[])) == 0
    assert len(scan.waveforms(pulses=np.zeros(300, bool)).samples) == 0


@pytest.mark.parametrize("air", [None, ls.Atmosphere.fog(visibility=80.0), ls.Atmosphere.snow(rate=2.0)])
def test_the_same_bits_on_any_number_of_threads_and_any_instruction_set(
    air: ls.Atmosphere | None, instruction_sets: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = crown(1)
    scene.atmosphere = air
    lidar = ls.Lidar(
        ls.patterns.Grid(np.linspace(-0.004, 0.004, 15), np.linspace(-0.004, 0.004, 15), rate=10.0),
        measurement=ls.Measurement(beam=ls.Beam(2e-3), returns=4, power_sigma=0.2, crossover=ALL_AIR),
        min_range=1.0,
        max_range=130.0,
    )
    found = set()
    for threads, isa in enumerate(instruction_sets, 1):
        monkeypatch.setenv("LIDARSIM_THREADS", str(threads))
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        waveforms = lidar.scan(scene).waveforms()
        assert len(waveforms.samples) > 5000
        found.add((waveforms.samples.tobytes(), waveforms.first.tobytes(), waveforms.offsets.tobytes()))
    assert len(found) == 1


def test_the_scene_as_it_was_scanned_and_what_the_sensor_did_not_see() -> None:
    scene = ball_and_wall()
    lidar = ls.Lidar(ls.patterns.Table([[1.0, 0, 0]], rate=10.0))
    scan, blind = lidar.scan(scene), lidar.scan(scene, ignore=[2])
    scene.remove(1)
    assert abs(scan.waveforms(1e-10)[0].range.mean() - 16.0) < 0.01
    assert abs(blind.waveforms(1e-10)[0].range.mean() - 40.0) < 0.01
    assert scan.waveforms().samples.tobytes() == copy.deepcopy(scan).waveforms().samples.tobytes()


# --- Ends ------------------------------------------------------------------------------------------------------------


def test_pulses_without_light_have_no_samples() -> None:
    scene = wall(40.0, 0.0)
    scan = shoot(scene, [[1.0, 0, 0], [-1.0, 0, 0], [0.0, 1.0, 0]])
    waveforms = scan.waveforms()
    assert waveforms.counts.tolist() == [0, 0, 0]
    assert waveforms.offsets.tolist() == [0, 0, 0, 0]
    assert [len(power) for _, power in waveforms] == [0, 0, 0]
    assert repr(waveforms) == "Waveforms of 3 pulses: 0 samples, one every 1 ns"


def test_waveforms_end_at_the_maximum_range() -> None:
    lidar = {"max_range": 50.0}
    width = sigma(5e-9)
    assert shoot(wall(50.0), **lidar).waveforms().counts[0] > 20
    assert shoot(wall(50.0 + 13 * width), **lidar).waveforms().counts.tolist() == [0]
    # Half of the light of a surface just beyond.
    ranges, _ = shoot(wall(50.0 + 6 * width), **lidar).waveforms(1e-11)[0]
    assert abs(ranges[0] - 50.0) < 0.01
    assert abs(ranges[-1] - 50.0 - 6 * width) < 0.01
    # Ground at grazing incidence, whose light is spread over kilometres.
    ground = ls.Scene()
    ground.add(ls.Plane((0, 0, 1), -1.0))
    grazing = shoot(ground, [[math.cos(1e-3), 0.0, -math.sin(1e-3)]], beam=ls.Beam(1e-3), max_range=200.0)
    assert grazing.waveforms().counts[0] < 1500


def test_a_surface_at_the_sensor_is_infinitely_bright() -> None:
    scan = shoot(wall(0.0))
    assert scan.true_range.tolist() == [[0.0]]
    _, power = scan.waveforms()[0]
    assert np.isinf(power).all()


# --- Arguments and files ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sample_period": 0.0}, "sample_period: expected a finite number > 0 and <= 1e-06, got 0.0"),
        ({"sample_period": math.nan}, "sample_period: expected a finite number > 0 and <= 1e-06, got nan"),
        ({"sample_period": 1.0}, "sample_period: expected a finite number > 0 and <= 1e-06, got 1.0"),
        ({"sample_period": "1 ns"}, "sample_period: expected a finite number > 0 and <= 1e-06, got '1 ns'"),
        ({"pulses": [0, 200]}, "pulses: expected 0 to 199, got pulses[1] = 200"),
        ({"pulses": [-1]}, "pulses: expected 0 to 199, got pulses[0] = -1"),
        ({"pulses": [0.5]}, "pulses: expected integers of shape (m,), got float64 of shape (1,)"),
        ({"pulses": [True]}, "pulses: expected a mask of shape (200,), got shape (1,)"),
        ({"pulses": "all"}, "pulses: expected integers of shape (m,), got <U3 of shape ()"),
    ],
)
def test_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError)) as caught:
        shoot(ball_and_wall(), fan()).waveforms(**arguments)
    assert str(caught.value) == message


def test_memory_is_stated_before_it_is_used() -> None:
    with pytest.raises(MemoryError) as caught:
        shoot(ball_and_wall(), fan()).waveforms(1e-22)
    assert "for the waveforms of 200 pulses, " in str(caught.value)
    assert " GiB (choose fewer by `pulses`, or a longer `sample_period`)" in str(caught.value)
    scene = ls.Scene()
    scene.atmosphere = ls.Atmosphere.fog(visibility=50.0)
    with pytest.raises(MemoryError, match="the waveform of fog"):
        shoot(scene, min_range=1.0).waveforms(1e-22)


def test_a_pickled_scan_has_none() -> None:
    scan = pickle.loads(pickle.dumps(shoot(ball_and_wall())))  # noqa: S301
    with pytest.raises(ValueError, match="scan: expected one with its scene, got one from a pickle"):
        scan.waveforms()


def test_waveforms_by_number() -> None:
    waveforms = shoot(ball_and_wall(), fan(3)).waveforms()
    assert len(waveforms) == len(list(waveforms)) == 3
    assert waveforms[-1].power.tobytes() == waveforms[2].power.tobytes()
    for wrong in (3, -4):
        with pytest.raises(IndexError, match=f"index: expected -3 to 2, got {wrong}"):
            waveforms[wrong]
    with pytest.raises(TypeError, match="index: expected the number of a waveform, got 'a'"):
        waveforms["a"]  # type: ignore[index]
    nearest, farthest = min(one.range.min() for one in waveforms), max(one.range.max() for one in waveforms)
    assert repr(waveforms) == (
        f"Waveforms of 3 pulses: 75 samples, one every 1 ns\n  range  {nearest:.6g} … {farthest:.6g} m"
    )
    assert "<caption>Waveforms of 3 pulses" in waveforms._repr_html_()
    same = pickle.loads(pickle.dumps(waveforms))  # noqa: S301
    assert same.samples.tobytes() == waveforms.samples.tobytes()


def test_files_keep_everything(tmp_path: Path) -> None:
    waveforms = shoot(ball_and_wall(), fan(20), beam=ls.Beam(1e-3, pulse_length=3e-9)).waveforms(7e-10)
    waveforms.save(tmp_path / "w.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["w.npz"]
    loaded = ls.Waveforms.load(tmp_path / "w.npz")
    with np.load(tmp_path / "w.npz") as arrays:
        assert sorted(arrays) == ["first", "offsets", "pulse", "pulse_length", "sample_period", "samples"]
        for name in arrays:
            assert np.array_equal(arrays[name], getattr(waveforms, name))
            assert np.array_equal(getattr(loaded, name), getattr(waveforms, name))
            assert np.asarray(getattr(loaded, name)).dtype == np.asarray(getattr(waveforms, name)).dtype
    assert (loaded.sample_period, loaded.pulse_length) == (7e-10, 3e-9)
    with pytest.raises(FileFormatError, match=r"w\.las: unknown extension '\.las', expected \.npz"):
        waveforms.save(tmp_path / "w.las")
    with pytest.raises(FileFormatError, match=r"w\.las: unknown extension '\.las', expected \.npz"):
        ls.Waveforms.load(tmp_path / "w.las")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"samples": None}, "it has no array samples"),
        ({"more": np.zeros(3)}, "it has other arrays, too"),
        ({"samples": np.zeros(50)}, "samples: expected one row of float32, got float64 of shape (50,)"),
        ({"pulse": np.zeros((2, 1), np.int64)}, "pulse: expected one row of int64, got int64 of shape (2, 1)"),
        ({"first": np.zeros(3, np.int64)}, "pulse, first, offsets: expected m, m and m + 1 of them, got 2, 3 and 3"),
        (
            {"offsets": np.array([0, 80, 50])},
            "offsets: expected numbers that rise from 0 to the number of samples",
        ),
        ({"offsets": np.array([0, 25, 51])}, "offsets: expected numbers that rise from 0 to the number of samples"),
        ({"offsets": np.array([1, 25, 50])}, "offsets: expected numbers that rise from 0 to the number of samples"),
        ({"sample_period": np.array(0.0)}, "sample_period: expected a finite number > 0, got 0.0"),
        (
            {"pulse_length": np.array([1.0, 2.0])},
            "pulse_length: expected a finite number > 0, got an array of shape (2,)",
        ),
        ({"pulse_length": np.array("x")}, "pulse_length: expected a finite number > 0, got 'x'"),
    ],
)
def test_damaged_files(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "w.npz"
    waveforms = shoot(ball_and_wall(), fan(2)).waveforms()
    assert waveforms.counts.tolist() == [25, 25]
    waveforms.save(path)
    with np.load(path) as arrays:
        contents = {**arrays, **change}
    np.savez(path, **{name: array for name, array in contents.items() if array is not None})
    with pytest.raises(FileFormatError) as caught:
        ls.Waveforms.load(path)
    assert str(caught.value) == f"{path}: not a readable file of waveforms: {message}"


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "w.npz"
    path.write_bytes(b"no archive")
    with pytest.raises(FileFormatError, match="does not begin as a NumPy archive does"):
        ls.Waveforms.load(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("samples.npy", b"none")
    with pytest.raises(FileFormatError, match="not a readable file of waveforms"):
        ls.Waveforms.load(path)
    with pytest.raises(FileNotFoundError):
        ls.Waveforms.load(tmp_path / "none.npz")
