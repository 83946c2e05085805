"""Fog, rain and snow: figures of the literature, quadrature and statistics of what the core computes and draws."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import pickle
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy import integrate, stats

import lidarsim as ls
from lidarsim import _native
from lidarsim.scan.scan import scan as fire

LIGHT = 299_792_458.0
FOG = ls.Atmosphere.fog(50.0, label=7)
RAIN = ls.Atmosphere.rain(10.0, label=8)
LIMIT = ls.Detection(0.1, 100.0)
ALL_AIR = (0.0, 0.01)
"""Overlap of a receiver that, without a `near_threshold`, sees all of the air from the least range on."""
SIGMAS = 5.0
"""Bounds of statistics: one in 1.7 million lies outside."""


def pulses(count: int) -> ls.patterns.Table:
    """Pulses along x."""
    return ls.patterns.Table(np.tile([1.0, 0.0, 0.0], (count, 1)), rate=10.0)


def sensor(count: int = 1, *, min_range: float = 0.9, max_range: float = math.inf, **measurement: Any) -> ls.Lidar:
    effects = ls.Measurement(**{"crossover": ALL_AIR, **measurement})
    return ls.Lidar(pulses(count), measurement=effects, min_range=min_range, max_range=max_range)


def scene(atmosphere: ls.Atmosphere | None, *walls: float, reflectivity: float = 1.0) -> ls.Scene:
    """Walls at right angles to x."""
    made = ls.Scene()
    for x in walls:
        made.add(ls.Plane((1, 0, 0), x), label=1, material=ls.Material(reflectivity=reflectivity))
    made.atmosphere = atmosphere
    return made


# Formulas


def test_extinction_and_backscatter_are_those_of_the_literature() -> None:
    # Koschmieder: light falls to 5 % on the way of the visibility.
    assert math.exp(-ls.Atmosphere.fog(80.0).extinction * 80.0) == pytest.approx(0.05, rel=4e-16)
    assert ls.Atmosphere.fog(1.0).extinction == pytest.approx(2.996, abs=5e-4)
    assert ls.Atmosphere.fog(80.0).backscatter == pytest.approx(0.046 / 80.0, rel=4e-16)
    # Hahner et al. 2021: of a hard target at 30 m in α = 0.06/m, 0.0273 is left.
    assert math.exp(-2 * 0.06 * 30.0) == pytest.approx(0.0273, abs=5e-5)
    # Goodin et al. 2019: 10 mm/h over 50 m and back leave 0.0187.
    assert math.exp(-2 * RAIN.extinction * 50.0) == pytest.approx(0.0187, abs=5e-5)
    assert ls.Atmosphere.rain(1.0).extinction == 0.01
    # ITU-R P.1814: 5.54 dB/km at 1 mm/h.
    assert 1e4 * ls.Atmosphere.snow(1.0).extinction / math.log(10.0) == pytest.approx(5.545, abs=5e-4)


@pytest.mark.parametrize("rate", [1.0, 10.0, 100.0])
def test_drops_are_those_of_marshall_and_palmer(rate: float) -> None:
    rain = ls.Atmosphere.rain(rate)
    slope = 4.1 * rate**-0.21  # per mm
    with mpmath.workdps(30):
        number = mpmath.quad(lambda d: 8000 * mpmath.exp(-slope * d), [0, 1, 10, mpmath.inf])
        section = mpmath.quad(lambda d: 8000 * mpmath.exp(-slope * d) * mpmath.pi / 4 * d**2, [0, 1, 10, mpmath.inf])
    # Drops per m³, and their geometric section, m²/m³; eight roundings, of which the power makes three.
    assert rain.intercept / rain.slope == pytest.approx(float(number), rel=8 * 2.0**-53)
    assert rain.intercept * math.pi / 2 / rain.slope**3 == pytest.approx(float(section) * 1e-6, rel=16 * 2.0**-53)


def test_flakes_are_those_of_sekhon_and_srivastava() -> None:
    # At 1 mm/h of water: 2500 per m³ and mm, falling by e in 1/2.29 mm.
    snow = ls.Atmosphere.snow(1.0)
    assert (snow.intercept, snow.slope) == (2.5e6, 2290.0)
    assert ls.Atmosphere.snow(4.0).slope == pytest.approx(2290.0 * 4.0**-0.45, rel=4 * 2.0**-53)
    assert ls.Atmosphere.snow(4.0).intercept == pytest.approx(2.5e6 * 4.0**-0.94, rel=4 * 2.0**-53)


def test_a_drop_reflects_at_both_sides() -> None:
    # Rays of a small offset b, by Snell's law: the near side turns them by 2b/a, the far side by 2b/a·(2 − n)/n. What
    # an offset ring sends into a cone is the square of their quotient; a white disk sends 1/π·π(2a)²/4 = a².
    n, a, b = 1.328, 1.0, 1e-4
    outside, inside = math.asin(b / a), math.asin(b / a / n)
    mirrored = ((n - 1) / (n + 1)) ** 2
    near = mirrored * (b / (2 * outside)) ** 2
    far = mirrored * (1 - mirrored) ** 2 * (b / (4 * inside - 2 * outside)) ** 2
    assert ls.Atmosphere.rain(3.0).reflectance == pytest.approx(
        (near + far) / a**2, rel=(b / a) ** 2
    )  # which is neglected


def simpson_error(function: Callable[[float], float], edges: npt.NDArray[np.float64]) -> float:
    """Bound on the error of Simpson's rule in cells between edges: h⁴/72·∫|f⁗|, where h is half of a cell.

    1/72 is the maximum of the rule's Peano kernel, 2.5 times its mean, so that differences may stand for f⁗.
    """
    bound = 0.0
    for low, high in itertools.pairwise(edges):
        values = [function(x) for x in np.linspace(low, high, 9)]
        bound += (
            ((high - low) / 2) ** 4 / 72 * np.abs(np.diff(values, 4)).mean() / ((high - low) / 8) ** 4 * (high - low)
        )
    return bound


# Fog


def response(
    at: Any, shape: Callable[[Any], Any], ends: tuple[Any, Any], overlap: tuple[float, float], alpha: float
) -> Any:
    """∫ shape(R − r)·ξ(r)/r²·exp(−2αr) dr, of a shape that is 0 unless its argument is between the ends."""
    near, far = (mpmath.mpf(x) for x in overlap)
    low, high = max(at - ends[1], near), at - ends[0]

    def integrand(r: Any) -> Any:
        gathered = 1 if r >= far else (r - near) / (far - near)
        return shape(at - r) * gathered / r**2 * mpmath.exp(-2 * alpha * r)

    points = sorted({low, min(max(far, low), high), min(max(at, low), high), high})
    return mpmath.quad(integrand, points) if low < high else mpmath.mpf(0)


@pytest.mark.parametrize(("alpha", "peak", "height"), [(0.06, 4.60, 3.8156e-9), (0.005, 4.70, 4.5679e-9)])
def test_the_response_is_that_of_hahner(alpha: float, peak: float, height: float) -> None:
    """With their pulse, sin² over 40 ns, of which half is above half of the maximum, and their overlap.

    Their ranges are steps of 0.1 m from the start of the pulse, their integral is over time. They integrate in steps,
    which they get to 5·10⁻⁵.
    """
    half = mpmath.mpf(20e-9) * LIGHT / 2  # m
    pulse = lambda x: mpmath.sin(mpmath.pi * x / (2 * half)) ** 2  # noqa: E731
    with mpmath.workdps(20):
        steps = [mpmath.mpf(k) / 10 for k in range(35, 60)]
        found = [float(response(at, pulse, (0, 2 * half), (0.9, 1.0), alpha) * 2 / LIGHT) for at in steps]
    best = int(np.argmax(found))
    assert float(steps[best]) == peak
    assert found[best] == pytest.approx(height, rel=1e-4)


@pytest.mark.parametrize(("alpha", "theirs"), [(0.06, (4.60, 3.8156e-9)), (0.005, (4.70, 4.5679e-9))])
def test_a_gaussian_pulse_has_nearly_the_same_echo(alpha: float, theirs: tuple[float, float]) -> None:
    """sin² begins 20 ns, 3.00 m, before its middle. The Gaussian of the same half-power width is wider at its foot."""
    beam = ls.Beam(1e-3, pulse_length=20e-9)
    lidar = sensor(crossover=(0.9, 1.0), beam=beam)
    air = ls.Atmosphere(extinction=alpha, backscatter=1e-3)
    echo = air.fog_echo(lidar)
    assert echo is not None
    at, power = echo[0], echo[1] / echo[0] ** 2
    begin, height = theirs[0] - 20e-9 * LIGHT / 2, theirs[1] * LIGHT / 2
    assert abs(at - begin) < 0.06  # their steps are 0.1 m apart
    assert power / (math.pi * 1e-3) == pytest.approx(height, rel=2e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.005, 0.06, 1.0])
@pytest.mark.parametrize(
    ("overlap", "min_range", "length"),
    [((0.9, 1.0), 0.0, 20e-9), ((0.1, 4.0), 0.5, 5e-9), (None, 0.3, None), ((0.0, 2.0), 0.05, 1e-9), (None, 3.0, 1e-6)],
)
def test_the_echo_of_fog_is_the_peak_of_the_response(
    alpha: float, overlap: tuple[float, float] | None, min_range: float, length: float | None
) -> None:
    beam = None if length is None else ls.Beam(1e-3, pulse_length=length)
    lidar = sensor(min_range=min_range, crossover=overlap, beam=beam, near_threshold=0.01)
    beta = 2e-3
    echo = ls.Atmosphere(extinction=alpha, backscatter=beta).fog_echo(lidar)
    assert echo is not None
    at, power = echo[0], echo[1] / echo[0] ** 2
    sigma = LIGHT / 2 * (length or 5e-9) / math.sqrt(8 * math.log(2))
    # An overlap that begins at the sensor is seen from the least range on.
    near = overlap[0] if overlap and overlap[0] > 0 else min_range
    slant = overlap or (0.0, 0.0)

    def weight(r: Any) -> Any:
        gathered = 1 if r >= slant[1] else (r - slant[0]) / (slant[1] - slant[0])
        return gathered / r**2 * mpmath.exp(-2 * alpha * r)

    def integral(factor: Callable[[Any], Any]) -> Any:
        reach = 10 * sigma
        low, high = max(at - reach, near), at + reach
        points = sorted({low, high, *(p for p in (slant[1], at, at - sigma, at + sigma, 2 * low) if low < p < high)})
        gauss = lambda r: mpmath.exp(-(((at - r) / sigma) ** 2) / 2)  # noqa: E731
        return mpmath.quad(lambda r: gauss(r) * factor(r) * weight(r), points)

    with mpmath.workdps(20):
        height = integral(lambda _: 1)
        slope = integral(lambda r: (r - at) / sigma**2)
        curve = integral(lambda r: ((r - at) / sigma**2) ** 2 - 1 / sigma**2)
    # The core integrates over ln r in front of and behind the full overlap, with 256 steps each, up to 8.5σ from the
    # peak, and to where extinction leaves less than 2⁻³² of what it does at the beginning.
    begin, end = max(near, at - 8.5 * sigma), at + 8.5 * sigma
    if alpha > 0:
        end = min(end, begin + 16 * math.log(2) / alpha)
    middle = min(max(slant[1], begin), end)

    def integrand(r: float) -> float:
        return math.exp(-(((at - r) / sigma) ** 2) / 2) * float(weight(r))

    bound = sum(
        simpson_error(lambda u: integrand(math.exp(u)) * math.exp(u), np.linspace(math.log(a), math.log(b), 129))
        for a, b in ((begin, middle), (middle, end))
        if a < b
    )
    assert power == pytest.approx(float(math.pi * beta * height), rel=bound / float(height) + 2.0**-32)
    # By Newton's method, how far off the peak is: less than 10⁻⁴σ, at which the height is that to 10⁻⁸.
    assert curve < 0
    assert abs(slope / curve) < 1e-4 * sigma


def test_pulses_into_the_sky_have_the_echo_of_fog() -> None:
    lidar = sensor(200, range_sigma=0.1)
    scan = lidar.scan(scene(FOG))
    echo = FOG.fog_echo(lidar)
    assert echo is not None
    assert (scan.status == ls.Status.hit).all()
    assert (scan.source == ls.Source.atmosphere).all()
    assert (scan.object_id == -1).all()
    assert not scan.instance.any()
    assert (scan.label == 7).all()
    assert (scan.true_range == echo[0]).all()
    assert np.array_equal(scan.range_error, scan.range - scan.true_range)
    assert abs(scan.range_error.mean()) < SIGMAS * 0.1 / math.sqrt(200)
    assert scan.range_error.std() == pytest.approx(0.1, rel=SIGMAS / math.sqrt(2 * 200))
    assert np.allclose(scan.intensity, echo[1], rtol=2.0**-23, atol=0)
    assert np.isnan(scan.normal).all()
    assert np.isnan(scan.incidence).all()
    assert np.allclose(scan.true_points(), [[echo[0], 0.0, 0.0]], rtol=4 * 2.0**-53, atol=0)
    cloud = scan.point_cloud()
    assert len(cloud) == 200
    assert (cloud.source == ls.Source.atmosphere).all()


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-4, rays=7)], ids=["ray", "beam"])
def test_fog_weakens_what_is_behind_it_and_competes_with_it(beam: ls.Beam | None) -> None:
    oblique = 5e-5**2 / 2  # at the edge of the beam, ranges are longer and cosines less by this
    for distance in (6.0, 30.0):
        # The sky lies behind the wall at the distance: what each mode reports of fog and wall.
        clear = sensor(beam=beam, extinction=FOG.extinction).scan(scene(None, distance))
        lidar = sensor(beam=beam)
        echo = FOG.fog_echo(lidar)
        assert echo is not None
        fog = echo[1] / echo[0] ** 2
        wall = math.exp(-2 * FOG.extinction * distance) / distance**2
        for returns in ("strongest", "first", "last", *(("dual", 2) if beam else ())):
            scan = sensor(beam=beam, returns=returns).scan(scene(FOG, distance))
            nearest = [0, 1]
            strongest = [int(wall > fog), int(wall < fog)]
            order = {"strongest": strongest[:1], "first": [0], "last": [1], "dual": strongest, 2: nearest}[returns]
            if returns == "dual":
                order = [strongest[0], 1] if strongest[0] != 1 else [1, 0]
            expected = [(echo, ls.Source.atmosphere), ((distance, clear.intensity[0, 0]), ls.Source.surface)]
            assert scan.return_count[0] == len(order)
            for k, which in enumerate(order):
                (at, intensity), source = expected[which]
                assert scan.source[0, k] == source
                assert scan.range[0, k] == pytest.approx(at, rel=oblique)  # of a beam, a mean
                assert float(scan.intensity[0, k]) == pytest.approx(float(intensity), rel=2.0**-23 + oblique)
    assert fog > wall  # the last wall, 30 m off


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-4, rays=7)], ids=["ray", "beam"])
def test_a_near_surface_hides_the_fog(beam: ls.Beam | None) -> None:
    lidar = sensor(beam=beam, returns="first")
    echo = FOG.fog_echo(lidar)
    assert echo is not None
    hides_to = echo[0] + 2 * LIGHT / 2 * 5e-9 / math.sqrt(8 * math.log(2))
    near, far = (lidar.scan(scene(FOG, hides_to + x)) for x in (-1e-6, 1e-6))
    assert near.source[0, 0] == ls.Source.surface
    assert far.source[0, 0] == ls.Source.atmosphere


def test_fog_keeps_the_share_of_the_beam_that_no_near_surface_takes() -> None:
    beam = ls.Beam(0.02, rays=91)
    made = scene(FOG)
    made.add(ls.Box((0.1, 2.0, 2.0), (1.1, -1.0, 0.0)), material=ls.Material(reflectivity=0.0))  # right of the axis
    scan = sensor(beam=beam, returns="last", detection=ls.Detection(0.1, 1e4)).scan(made)
    echo = FOG.fog_echo(sensor(beam=beam))
    assert echo is not None
    # The box takes the sub-rays on its edge: the axis and the others in its plane, 11 of 91.
    assert scan.source[0, 0] == ls.Source.atmosphere
    assert 0.4 < scan.intensity[0, 0] / echo[1] < 0.5


def test_echoes_that_the_receiver_cannot_tell_apart_are_the_stronger() -> None:
    for reflectivity, source in ((1.0, ls.Source.surface), (1e-4, ls.Source.atmosphere)):
        made = scene(FOG, 3.0, reflectivity=reflectivity)
        resolved = sensor(beam=ls.Beam(1e-4, rays=7), returns=2).scan(made)
        merged = sensor(beam=ls.Beam(1e-4, rays=7, separation=2.5), returns=2).scan(made)
        assert resolved.source[0].tolist() == [ls.Source.atmosphere, ls.Source.surface]
        assert merged.return_count[0] == 1
        assert merged.source[0, 0] == source


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-4, rays=7)], ids=["ray", "beam"])
def test_what_is_not_detected_is_no_echo(beam: ls.Beam | None) -> None:
    thin = ls.Atmosphere.fog(2000.0)
    blind = {"beam": beam, "detection": ls.Detection(0.1, 20.0)}
    for walls, status in (((), ls.Status.miss), ((100.0,), ls.Status.below_threshold)):
        scan = sensor(**blind).scan(scene(thin, *walls))
        assert scan.status.tolist() == [status]
        assert scan.source[0, 0] == (0 if walls else 255)
    assert sensor(beam=beam, detection=ls.Detection(0.1, 200.0)).scan(scene(thin)).status[0] == ls.Status.hit


def test_fog_needs_a_range_from_which_it_is_seen() -> None:
    uses: list[Callable[[ls.Lidar], object]] = [
        lambda lidar: lidar.scan(scene(FOG)),
        lambda lidar: lidar.frames(scene(FOG), None, 1),
        FOG.fog_echo,
    ]
    dull, open_ = sensor(min_range=0.0, crossover=None, near_threshold=NEAR), sensor(min_range=0.0)
    for lidar, use in itertools.product((dull, open_), uses):
        with pytest.raises(ValueError, match=r"^min_range: expected a number > 0 in fog, got 0.0; or give"):
            use(lidar)
    assert sensor(min_range=0.0, crossover=(0.1, 1.0)).scan(scene(FOG)).status[0] == ls.Status.hit
    assert sensor(min_range=0.0).scan(scene(ls.Atmosphere(extinction=0.1))).status[0] == ls.Status.miss


# The threshold near the sensor


def test_fog_needs_a_receiver_that_is_dull_near_by() -> None:
    """The error says what to write, and each of these remedies is one."""
    bare, world = ls.Lidar.preset("hesai-xt32"), scene(FOG, 20.0)
    message = (
        'near_threshold: expected a number > 0 in fog, got 0.0; a preset has one with the noise "datasheet"; give a '
        "sensor of your own 0.01, a near range of 20 m and a minimum range > 0; or, to see all of the fog from a range "
        "on, a crossover such as 0.9 to 1 m"
    )
    uses: list[Callable[[ls.Lidar], object]] = [
        lambda lidar: lidar.scan(world),
        lambda lidar: lidar.frames(world, None, 1),
        lambda lidar: lidar.scan_many(world, np.eye(4)[None]),
        FOG.fog_echo,
        FOG.patches_seen,
    ]
    for use in uses:
        with pytest.raises(ls.errors.ArgumentValueError) as error:
            use(bare)
        assert str(error.value) == message
    own = dataclasses.replace(bare, measurement=ls.Measurement(near_threshold=0.01, near_range=20.0))
    all_of_it = dataclasses.replace(bare, measurement=ls.Measurement(crossover=(0.9, 1.0)))
    for lidar in (ls.Lidar.preset("hesai-xt32", noise="datasheet"), own, all_of_it):
        assert lidar.scan(world).source is not None
    for air in (ls.Atmosphere(extinction=0.1), RAIN, ls.Atmosphere.snow(1.0)):
        world.atmosphere = air
        assert (bare.scan(world).status == ls.Status.hit).any()


SIGMA = LIGHT / 2 * 5e-9 / math.sqrt(8 * math.log(2))
"""Standard deviation of the pulse without a beam, m."""
NEAR = 0.004
"""A threshold that FOG exceeds in one of some pulses."""


def patches(begin: float, limit: ls.Detection, near_range: float) -> tuple[Callable[..., float], Callable[..., float]]:
    """The mean intensity of FOG against range, and how many echoes exceed the threshold per length of the beam."""

    def mean(at: float) -> float:
        def light(r: float) -> float:
            return math.exp(-0.5 * ((at - r) / SIGMA) ** 2 - 2 * FOG.extinction * r) / r**2

        low, high = max(begin, at - 8.5 * SIGMA), at + 8.5 * SIGMA
        parts = [integrate.quad(light, a, b, epsrel=1e-10)[0] for a, b in itertools.pairwise((low, max(low, at), high))]
        return math.pi * FOG.backscatter * sum(parts) * at**2

    def density(at: float) -> float:
        far = limit.reflectivity / limit.range**2 * at**2
        least = max(far, NEAR * min(1.0, (near_range / at) ** 2))
        return math.exp(-((math.gamma(1 + 1 / 0.7) * least / mean(at)) ** 0.7)) / math.sqrt(2 * math.pi) / SIGMA

    return mean, density


def test_patches_of_fog_exceed_the_threshold_as_a_poisson_process() -> None:
    count, limit = 20_000, ls.Detection(0.1, 60.0)
    lidar = sensor(count, detection=limit, near_threshold=NEAR, near_range=10.0, returns="first")
    mean, density = patches(0.9, limit, 10.0)
    edges = 0.9 + np.linspace(0, 1, 201) ** 2 * 79.1
    # Trapezoids, whose error is below the tolerance: with half as many, the sum changes by less than that.
    values = np.array([density(r) for r in edges])
    expected, coarse = np.trapezoid(values, edges), np.trapezoid(values[::2], edges[::2])
    assert abs(expected - coarse) < 0.003 * expected
    found = FOG.patches_seen(lidar)
    assert found == pytest.approx(expected, rel=0.003)
    assert 0.1 < found < 2.0
    scan = lidar.scan(scene(FOG), seed=4)
    seen = scan.status == ls.Status.hit
    assert (scan.source[seen] == ls.Source.atmosphere).all()
    assert (scan.label[seen] == 7).all()
    share = 1 - math.exp(-found)
    assert abs(seen.mean() - share) < SIGMAS * math.sqrt(share * (1 - share) / count)
    # The nearest of each pulse: their ranges, and by how much they exceed the threshold.
    ranges = scan.range[seen, 0]
    sums = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(edges))])
    chance = (1 - np.exp(-np.interp(ranges, edges, sums))) / share
    assert stats.kstest(chance, "uniform").pvalue > 1e-6
    some = slice(0, 1000)
    means = np.array([mean(r) for r in ranges[some]])
    least = np.maximum(0.1 / 60.0**2 * ranges[some] ** 2, NEAR * np.minimum(1, (10.0 / ranges[some]) ** 2))
    excess = [(math.gamma(1 + 1 / 0.7) * x) ** 0.7 for x in (scan.intensity[seen, 0][some] / means, least / means)]
    assert stats.kstest(excess[0] - excess[1], "expon").pvalue > 1e-6


def test_a_fluctuation_reveals_patches_that_are_too_dim_on_average() -> None:
    w, count, limit = 0.6, 20_000, ls.Detection(0.1, 60.0)
    mean, _ = patches(0.9, limit, 10.0)
    r = 0.9 + np.linspace(0, 1, 201) ** 2 * 79.1
    least = np.maximum(0.1 / 60.0**2 * r**2, NEAR * np.minimum(1, (10.0 / r) ** 2)) / [mean(at) for at in r]
    g = np.linspace(-8, 8, 161)
    rarity = (math.gamma(1 + 1 / 0.7) * least / np.exp(w * g - w * w / 2)[:, None]) ** 0.7
    density = stats.norm.pdf(g) * (g[1] - g[0]) @ np.exp(-rarity) / math.sqrt(2 * math.pi) / SIGMA
    expected = np.trapezoid(density, r)
    assert abs(expected - np.trapezoid(density[::2], r[::2])) < 0.003 * expected
    near: dict[str, Any] = {"detection": limit, "near_threshold": NEAR, "near_range": 10.0}
    assert expected < FOG.patches_seen(sensor(**near, power_sigma=w)) < 2 * expected
    scan = sensor(count, **near, power_sigma=w, returns=255, depth=2).scan(scene(FOG), seed=4)
    tolerance = SIGMAS * math.sqrt(expected / count) + 0.003 * expected
    assert abs(scan.return_count.mean() - expected) < tolerance


def test_a_lidar_measures_in_one_air_after_another() -> None:
    def measure(lidar: ls.Lidar, air: ls.Atmosphere | None) -> npt.NDArray[np.float64]:
        return lidar.scan(scene(air, 20.0)).range

    airs, lidar = [None, RAIN, FOG], sensor(2000, detection=LIMIT)
    alone = [measure(sensor(2000, detection=LIMIT), air) for air in airs]
    assert not any(np.array_equal(a, b, equal_nan=True) for a, b in itertools.combinations(alone, 2))
    for k in (1, 2, 1, 1, 0, 1):
        assert np.array_equal(measure(lidar, airs[k]), alone[k], equal_nan=True)


def test_patches_are_the_same_with_a_beam_and_behind_no_surface() -> None:
    count, limit = 5000, ls.Detection(0.1, 60.0)
    lidar = sensor(count, detection=limit, near_threshold=NEAR, returns="first")
    beam = sensor(count, detection=limit, near_threshold=NEAR, returns="first", beam=ls.Beam(0.0, rays=7))
    sky, wall = lidar.scan(scene(FOG)), lidar.scan(scene(FOG, 3.0))
    near = sky.range[:, 0] < 3.0
    assert 100 < near.sum() < (sky.status == ls.Status.hit).sum() < count
    assert ((wall.source[:, 0] == ls.Source.atmosphere) == near).all()
    assert np.array_equal(wall.range[near], sky.range[near])
    assert (wall.range[~near] == 3.0).all()
    # Of pulses of more than one echo within 2σ, the beam has the strongest.
    other = beam.scan(scene(FOG))
    assert (other.status == sky.status).all()
    assert (other.range[:, 0] == sky.range[:, 0]).mean() > 0.5


def test_a_dense_fog_without_a_limit_is_measured_too() -> None:
    scan = sensor(500, near_threshold=NEAR).scan(scene(FOG))
    assert 0 < (scan.status == ls.Status.hit).sum() < 500


def test_summaries_say_if_the_air_takes_most_points() -> None:
    lidar = sensor(10)
    note = lidar.scan(scene(FOG)).summary().note
    assert note == "10 of 10 points are echoes of the air: is near_threshold=0.01 missing in the measurement?"
    assert not sensor(10, near_threshold=0.01).scan(scene(FOG, 3.0)).summary().note
    assert not lidar.scan(scene(FOG, 1.0)).summary().note


# Rain and snow


def density(air: ls.Atmosphere, least: float, begin: float, widths: tuple[float, float]) -> Callable[[float], float]:
    """How many particles are seen per length of the beam."""

    def at(r: float) -> float:
        if r < begin:
            return 0.0
        section = math.pi * math.prod((air.aperture + r * width) / 2 for width in widths)
        unit = air.reflectance * math.pi / 4 / section * math.exp(-2 * air.extinction * r) / r**2
        return section * air.intercept / air.slope * math.exp(-air.slope * math.sqrt(least / unit))

    return at


@pytest.mark.parametrize("air", [RAIN, ls.Atmosphere.snow(1.0, label=8)], ids=["rain", "snow"])
@pytest.mark.parametrize("beam", [None, ls.Beam(2e-3, 1e-3, rays=7)], ids=["ray", "beam"])
def test_the_number_of_particles_seen_is_an_integral(air: ls.Atmosphere, beam: ls.Beam | None) -> None:
    widths = (2e-3, 1e-3) if beam else (3e-3, 3e-3)
    at = density(air, 0.1 / 100.0**2, 0.9, widths)
    parts = [integrate.quad(at, a, b, epsabs=0, epsrel=1e-11) for a, b in ((0.9, 5), (5, 20), (20, 50), (50, 400))]
    expected, error = map(sum, zip(*parts, strict=True))
    found = air.particles_seen(sensor(beam=beam, detection=LIMIT))
    # The core integrates in 1024 cells that widen with the range, up to where at most exp(−64) are seen.
    end = 1.0
    while end < 400 and at(end) > math.exp(-64) * at(0.9):
        end *= 2
    bound = simpson_error(at, 0.9 + (end - 0.9) * np.linspace(0, 1, 1025) ** 2)
    assert found == pytest.approx(expected, rel=0, abs=bound + error)
    # Without a limit, a target of 10 % at the maximum range has it.
    assert air.particles_seen(sensor(beam=beam, max_range=100.0)) == found


@pytest.mark.parametrize("air", [RAIN, ls.Atmosphere.snow(0.5, label=8)], ids=["rain", "snow"])
def test_particles_are_a_poisson_process(air: ls.Atmosphere) -> None:
    """All echoes of pulses into the sky: how many, where, and how bright, against the formulas."""
    count, least = 20_000, 0.1 / 100.0**2
    # Of pulses this short, two echoes are one if they are nearer than 2σ = 1.3e-5 m.
    beam = ls.Beam(3e-3, rays=91, pulse_length=1e-13)
    scan = sensor(count, beam=beam, detection=LIMIT, returns=40).scan(scene(air), seed=5)
    mean = air.particles_seen(sensor(beam=beam, detection=LIMIT))
    assert mean > 0.1
    numbers = scan.return_count
    assert abs(numbers.mean() - mean) < SIGMAS * math.sqrt(mean / count)
    # The variance of a sample variance of Poisson numbers is (μ + 2μ²)/n.
    assert abs(numbers.var() - mean) < SIGMAS * math.sqrt((mean + 2 * mean**2) / count)
    ranges = scan.range[np.isfinite(scan.range)]
    assert (scan.source[np.isfinite(scan.range)] == ls.Source.atmosphere).all()
    assert (scan.label[np.isfinite(scan.range)] == 8).all()
    at = density(air, least, 0.9, (3e-3, 3e-3))
    edges = np.linspace(0.9, np.quantile(ranges, 0.999), 30)
    expected = np.array([integrate.quad(at, a, b)[0] for a, b in itertools.pairwise(edges)]) * count
    histogram = np.histogram(ranges, edges)[0]
    assert (np.abs(histogram - expected) < SIGMAS * np.sqrt(expected)).all()
    # Their sizes exceed the least that is seen by an exponential variable.
    intensity = scan.intensity[np.isfinite(scan.range)].astype(float)
    section = math.pi * ((0.01 + 3e-3 * ranges) / 2) ** 2
    share = np.exp(-2 * air.extinction * ranges)
    unit = air.reflectance * math.pi / 4 / section * share
    excess = air.slope * (np.sqrt(intensity / unit) - np.sqrt(least / unit) * ranges)
    # Intensities are float32. A flake that fills the beam is no brighter than that.
    assert excess.min() > -1e-4
    if air is RAIN:
        assert abs(excess.mean() - 1.0) < SIGMAS / math.sqrt(len(excess))
        assert stats.kstest(excess, "expon").pvalue > 1e-6
    else:
        assert (intensity < share * (1 + 1e-6)).all()


def test_single_rays_see_the_same_drops_as_beams_do() -> None:
    count = 5000
    ray = sensor(count, detection=LIMIT).scan(scene(RAIN), seed=2)
    beam = sensor(count, beam=ls.Beam(3e-3, rays=7, pulse_length=1e-13), detection=LIMIT).scan(scene(RAIN), seed=2)
    seen = ray.status == ls.Status.hit
    assert 100 < seen.sum() < count
    for name in ("status", "range", "true_range", "intensity", "label", "source"):
        assert np.array_equal(getattr(ray, name), getattr(beam, name), equal_nan=True), name


def test_drops_behind_a_surface_are_not_seen() -> None:
    count, distance = 20_000, 5.0
    sky = sensor(count, detection=LIMIT, returns="first").scan(scene(RAIN))
    wall = sensor(count, detection=LIMIT, returns="first").scan(scene(RAIN, distance))
    drops = wall.source[:, 0] == ls.Source.atmosphere
    assert 100 < drops.sum() < count
    assert (wall.range[drops] < distance).all()
    # Those in front of it are the same, as are what and where the others hit.
    assert np.array_equal(drops, np.nan_to_num(sky.range[:, 0], nan=99.0) < distance)
    assert np.array_equal(sky.range[drops], wall.range[drops])
    assert (wall.range[~drops] == distance).all()


def test_drops_behind_a_pane_are_not_seen() -> None:
    distance, lidar = 2.0, sensor(5000, detection=LIMIT, depth=2, returns=40)
    behind_glass = scene(RAIN)
    behind_glass.add(ls.Plane((1, 0, 0), distance), material=ls.Material(reflectivity=0.0, transmission=1.0))
    sky, glass = lidar.scan(scene(RAIN)).range, lidar.scan(behind_glass).range
    assert min(np.sum(sky < distance), np.sum(sky > distance)) > 100
    assert np.array_equal(glass, np.where(sky < distance, sky, np.nan), equal_nan=True)


def test_drops_are_in_a_sub_ray_that_nothing_blocks() -> None:
    made = scene(RAIN)
    made.add(ls.Box((0.1, 2.0, 2.0), (0.8, -1.0, 0.0)), material=ls.Material(reflectivity=0.0))  # right of the axis
    beam = ls.Beam(3e-3, rays=37, pulse_length=1e-13)
    lidar = sensor(20_000, beam=beam, detection=LIMIT, returns="strongest")
    half, whole = lidar.scan(made), lidar.scan(scene(RAIN))
    seen = half.source[:, 0] == ls.Source.atmosphere
    assert (half.true_direction[seen, 0, 1] > 0).all()
    assert 0.3 < seen.sum() / (whole.source[:, 0] == ls.Source.atmosphere).sum() < 0.6


@pytest.mark.parametrize("soft", [False, True], ids=["power", "limit"])
def test_a_fluctuation_reveals_drops_that_are_too_dim_on_average(*, soft: bool) -> None:
    def effects(w: float) -> dict[str, Any]:
        return {"detection": dataclasses.replace(LIMIT, sigma=w)} if soft else {"detection": LIMIT, "power_sigma": w}

    # Each drop has exp(w·g − w²/2) of its power: thinned from the least that may be seen, integrated over g.
    w, g = 0.5, np.linspace(-8, 8, 161)
    weights = stats.norm.pdf(g) * (g[1] - g[0])
    of_factor = [
        integrate.quad(density(RAIN, 0.1 / 100.0**2 / f, 0.9, (3e-3, 3e-3)), 0.9, 60.0)[0]
        for f in np.exp(w * g - w * w / 2)
    ]
    expected = float(weights @ of_factor)
    # Half of the factors are below the largest of the first layer, half of the others below that of the second, ...
    drawn = RAIN.particles_seen(sensor(**effects(0.5)))
    assert drawn > 2 * expected if soft else expected < drawn < 2 * expected
    count = 20_000
    beam = ls.Beam(3e-3, rays=91, pulse_length=1e-13)
    scan = sensor(count, beam=beam, returns=40, **effects(w)).scan(scene(RAIN), seed=1)
    assert abs(scan.return_count.mean() - expected) < SIGMAS * math.sqrt(expected / count)


@pytest.mark.parametrize(
    ("lidar", "got"),
    [
        (sensor(), "None"),
        (sensor(max_range=1e300), "None"),
        (sensor(max_range=100.0, detection=ls.Detection(0.1, 1e200)), "Detection(reflectivity=0.1, range=1e+200"),
    ],
)
def test_rain_needs_a_limit_of_what_is_seen(lidar: ls.Lidar, got: str) -> None:
    for use in (lambda: lidar.scan(scene(RAIN)), lambda: RAIN.particles_seen(lidar)):
        with pytest.raises(ValueError, match=r"^detection: expected a detection limit below 1e154 m in rain") as caught:
            use()
        assert f", got {got}" in str(caught.value)
        assert str(caught.value).count("; or a maximum range below that; ") == 1


def test_rain_is_seen_up_to_the_farthest_limit() -> None:
    scan = sensor(max_range=9e153).scan(scene(RAIN))
    assert scan.source is not None
    assert scan.source.tolist() == [[ls.Source.atmosphere]]


# Draws


def everything() -> ls.Atmosphere:
    return dataclasses.replace(RAIN, backscatter=1e-4)


def equal(a: ls.Scan, b: ls.Scan, part: npt.NDArray[Any] | slice = slice(None)) -> bool:
    names = [field.name for field in dataclasses.fields(a) if isinstance(getattr(a, field.name), np.ndarray)]
    assert {"range", "source"} <= set(names)
    return all(
        np.array_equal(getattr(a, name)[part], getattr(b, name), equal_nan=True) for name in names if name != "pose"
    )


@pytest.mark.parametrize("near", [0.0, 0.0005], ids=["one echo", "patches"])
@pytest.mark.parametrize("beam", [None, ls.Beam(3e-3, rays=7)], ids=["ray", "beam"])
def test_bits_are_the_same_for_threads_instruction_sets_and_subsets(
    beam: ls.Beam | None, near: float, monkeypatch: pytest.MonkeyPatch, instruction_sets: list[str]
) -> None:
    lidar = ls.Lidar(
        ls.patterns.Spinning(np.linspace(-0.4, 0.4, 9), columns=250),
        measurement=ls.Measurement(
            beam=beam, detection=LIMIT, range_sigma=0.02, power_sigma=0.2, range_sigma_limit=0.1, azimuth_sigma=1e-3,
            returns=3 if beam else "strongest", dropout=0.1, near_threshold=near, crossover=ALL_AIR,
            false_returns=0.05,
            response=ls.Response(
                range=[(1, 0.5), (9, 1)], exponent=0.8, sigma=0.1, ring_sigma=0.1, curve=[(0, 0), (0.1, 0.2), (9, 1)],
                resolution=1e-4,
            ),
        ),
        max_range=100.0,
        min_range=0.9,
    )  # fmt: skip
    made = scene(everything(), 20.0)
    made.add(ls.Plane((0, 0, 1), -2.0), material=ls.Material(reflectivity=0.5, variation=0.2))
    expected = lidar.scan(made, seed=4)
    assert {ls.Source.surface, ls.Source.atmosphere, ls.Source.false_return if beam or near else 255} <= {
        *expected.source.flat
    }
    assert instruction_sets
    for isa in instruction_sets:
        for threads in (1, 3):
            monkeypatch.setenv("LIDARSIM_ISA", isa)
            monkeypatch.setenv("LIDARSIM_THREADS", str(threads))
            assert equal(lidar.scan(made, seed=4), expected)
    some = np.array([3, 100, 1001, 7, 2000])
    assert equal(expected, fire(lidar, made, seed=4, indices=some), some)


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-4, rays=7)], ids=["ray", "beam"])
def test_the_air_leaves_the_draws_of_surfaces(beam: ls.Beam | None) -> None:
    noise = {"range_sigma": 0.02, "power_sigma": 0.1, "dropout": 0.1, "detection": LIMIT, "beam": beam}
    air = dataclasses.replace(everything(), extinction=0.0)
    lidar = sensor(3000, returns="last", **noise)
    with_it, without = lidar.scan(scene(air, 8.0)), lidar.scan(scene(None, 8.0))
    surfaces = with_it.source[:, 0] == ls.Source.surface
    assert surfaces.sum() > 2500
    for name in ("range", "intensity", "status"):
        assert np.array_equal(getattr(with_it, name)[surfaces], getattr(without, name)[surfaces], equal_nan=True), name


@pytest.mark.parametrize("beam", [None, ls.Beam(1e-4, rays=7)], ids=["ray", "beam"])
def test_the_noise_of_the_air_has_the_documented_draws(beam: ls.Beam | None) -> None:
    scan = sensor(16, beam=beam, range_sigma=0.5).scan(scene(FOG), seed=9)
    # Effect 3, draw 32768 of each pulse.
    key = _native.philox(np.array([[9, 0, zlib.crc32(b""), 0]], dtype=np.uint32), [0, 0])[0, :2].tolist()
    counters = np.array([[pulse, 0, 0, 3 << 16 | 32768] for pulse in range(16)], dtype=np.uint32)
    low, high = _native.philox(counters, key)[:, :2].astype(np.uint64).T
    cells = (high << np.uint64(32) | low) >> np.uint64(12)
    normals = _native.normal_quantile((cells + 0.5) / 2.0**52)
    # The range and its error round once each.
    kept = scan.status == ls.Status.hit
    assert kept.sum() > 8
    assert np.allclose(scan.range_error[kept, 0], 0.5 * normals[kept], rtol=0, atol=8 * 2.0**-52)


def test_other_effects_leave_the_drops() -> None:
    plain = sensor(3000, detection=LIMIT).scan(scene(RAIN))
    noisy = sensor(3000, detection=LIMIT, range_sigma=0.05, azimuth_sigma=1e-3, range_bias=0.1).scan(
        scene(dataclasses.replace(RAIN, backscatter=1e-12))
    )
    assert np.array_equal(plain.true_range, noisy.true_range, equal_nan=True)
    assert np.nanstd(noisy.range_error) == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize("beam", [None, ls.Beam(3e-3, rays=7)], ids=["ray", "beam"])
def test_clear_air_and_air_that_only_weakens_change_nothing_else(beam: ls.Beam | None) -> None:
    made = scene(None, 20.0)
    clear = sensor(50, beam=beam, extinction=0.02).scan(made)
    made.atmosphere = ls.Atmosphere(extinction=0.02, label=5)
    thin = sensor(50, beam=beam).scan(made)
    assert clear.source is thin.source is None
    assert np.array_equal(clear.intensity, thin.intensity)
    assert np.array_equal(clear.range, thin.range)


def test_false_returns_and_echoes_of_the_air_compete() -> None:
    lidar = sensor(2000, returns="first", max_range=50.0, false_returns=0.5)
    scan = lidar.scan(scene(FOG))
    alone = sensor(2000, returns="first", max_range=50.0, false_returns=0.5).scan(scene(None))
    echo = FOG.fog_echo(lidar)
    assert echo is not None
    nearer = np.nan_to_num(alone.range[:, 0], nan=99.0) < echo[0]
    assert nearer.any()
    assert np.array_equal(scan.source[:, 0] == ls.Source.false_return, nearer)
    assert np.isnan(scan.true_range[nearer]).all()
    assert not scan.label[nearer].any()


# Scenes, configurations and arguments


def test_scenes_keep_their_atmosphere(tmp_path: Path) -> None:
    made = scene(FOG, 20.0)
    made.update(0, label=3)
    for other in (made, copy.copy(made), copy.deepcopy(made), pickle.loads(pickle.dumps(made))):  # noqa: S301 - our own
        assert other.atmosphere is not None
        assert dataclasses.asdict(other.atmosphere) == dataclasses.asdict(FOG)
    assert "Atmosphere(extinction=0.0599" in repr(made)
    lidar = sensor(10)
    foggy = lidar.scan(made)
    made.atmosphere = None
    assert lidar.scan(made).source is None
    assert foggy.source is not None
    foggy.point_cloud().save(tmp_path / "fog.npz")
    assert (ls.PointCloud.load(tmp_path / "fog.npz").source == ls.Source.atmosphere).all()
    assert ls.Scene().atmosphere is None


def test_a_change_of_the_air_keeps_the_objects_in_the_core() -> None:
    made = scene(None, 20.0)
    before = made._snapshot()
    made.atmosphere = FOG
    after = made._snapshot()
    assert after.native is before.native
    assert (before.atmosphere, after.atmosphere) == (None, FOG)
    made.add(ls.Plane((1, 0, 0), 30.0))
    assert made._snapshot().native is not before.native
    assert made._snapshot().atmosphere is FOG


def test_only_an_atmosphere_is_one() -> None:
    made = scene(FOG)
    with pytest.raises(TypeError, match=r"^atmosphere: expected an Atmosphere or None, got 'fog'"):
        made.atmosphere = "fog"  # type: ignore[assignment]
    assert made.atmosphere is FOG


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ls.Atmosphere.fog(0.0), "visibility: expected a finite number > 0, got 0.0"),
        (lambda: ls.Atmosphere.fog(-5.0), "visibility: expected a finite number > 0, got -5.0"),
        (lambda: ls.Atmosphere.fog(math.nan), "visibility: expected a finite number > 0, got nan"),
        (lambda: ls.Atmosphere.fog(1e-320), "visibility: expected a visibility with a finite extinction, got 1e-320"),
        (lambda: ls.Atmosphere.rain(0.0), "rate: expected a finite number > 0 and <= 200, got 0.0"),
        (lambda: ls.Atmosphere.rain(201.0), "rate: expected a finite number > 0 and <= 200, got 201.0"),
        (lambda: ls.Atmosphere.rain(math.nan), "rate: expected a finite number > 0 and <= 200, got nan"),
        (lambda: ls.Atmosphere.snow(11.0), "rate: expected a finite number > 0 and <= 10, got 11.0"),
        (lambda: ls.Atmosphere.snow(-1.0), "rate: expected a finite number > 0 and <= 10, got -1.0"),
        (lambda: ls.Atmosphere(extinction=-0.1), "extinction: expected a finite number >= 0, got -0.1"),
        (lambda: ls.Atmosphere(backscatter=math.inf), "backscatter: expected a finite number >= 0, got inf"),
        (lambda: ls.Atmosphere(intercept=-1.0), "intercept: expected a finite number >= 0, got -1.0"),
        (lambda: ls.Atmosphere(slope=0.0), "slope: expected a finite number > 0, got 0.0"),
        (lambda: ls.Atmosphere(reflectance=-1.0), "reflectance: expected a finite number >= 0, got -1.0"),
        (lambda: ls.Atmosphere(aperture=0.0), "aperture: expected a finite number > 0, got 0.0"),
        (lambda: ls.Atmosphere(divergence=3.0), "divergence: expected a finite number from 0 to 0.1, got 3.0; mrad?"),
        (lambda: ls.Atmosphere(label=-1), "label: expected an integer from 0 to 4294967295, got -1"),
    ],
)
def test_bad_arguments_are_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=r".") as error:
        make()
    assert str(error.value) == message


RUN = """
scene: [{shape: plane, normal: [1, 0, 0], distance_m: 30}]
sensor:
  pattern: {type: grid, azimuths_deg: [0], elevations_deg: [0], rate_hz: 10}
  measurement: {crossover_m: [0.9, 1.0]}
  max_range_m: 100
"""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{fog: {visibility_m: 80}}", ls.Atmosphere.fog(80.0)),
        ("{rain: {rate_mm_per_h: 10}, label: 4}", ls.Atmosphere.rain(10.0, label=4)),
        (
            "{snow: {rate_mm_per_h: 2}, divergence_mrad: 1}",
            dataclasses.replace(ls.Atmosphere.snow(2.0), divergence=1e-3),
        ),
        (
            "{rain: {rate_mm_per_h: 10}, extinction_per_m: 0.0016}",
            dataclasses.replace(RAIN, extinction=0.0016, label=0),
        ),
        ("{extinction_per_m: 0.1, backscatter_per_m_sr: 0.002}", ls.Atmosphere(extinction=0.1, backscatter=0.002)),
        ("null", None),
    ],
)
def test_configurations_have_an_atmosphere(tmp_path: Path, text: str, expected: ls.Atmosphere | None) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(f"{RUN}atmosphere: {text}\n", encoding="utf-8")
    for found in (ls.config.load(path).scene.atmosphere, ls.Scene.from_file(path).atmosphere):
        if expected is None:
            assert found is None
        else:
            assert found is not None
            assert dataclasses.asdict(found) == dataclasses.asdict(expected)


def test_a_run_overrides_the_atmosphere_of_its_scene(tmp_path: Path) -> None:
    (tmp_path / "street.yaml").write_text("scene: []\natmosphere: {fog: {visibility_m: 80}}\n", encoding="utf-8")
    run = RUN.replace("[{shape: plane, normal: [1, 0, 0], distance_m: 30}]", "{file: street.yaml}")
    (tmp_path / "run.yaml").write_text(run, encoding="utf-8")
    (tmp_path / "clear.yaml").write_text(f"{run}atmosphere: null\n", encoding="utf-8")
    found = ls.config.load(tmp_path / "run.yaml").scene.atmosphere
    assert found is not None
    assert found.extinction == ls.Atmosphere.fog(80.0).extinction
    assert ls.config.load(tmp_path / "clear.yaml").scene.atmosphere is None
    changed = ls.config.load(tmp_path / "run.yaml", ["atmosphere.fog.visibility_m=40"]).scene.atmosphere
    assert changed is not None
    assert changed.extinction == ls.Atmosphere.fog(40.0).extinction


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{fog: {visibility_m: 0}}", "atmosphere.fog.visibility_m: expected a finite number > 0, got 0.0"),
        (
            "{fog: {visibility_m: 9}, rain: {rate_mm_per_h: 1}}",
            "atmosphere.rain: expected one of fog, rain and snow, got",
        ),
        (
            "{rain: {rate_mm_per_h: 300}}",
            "atmosphere.rain.rate_mm_per_h: expected a finite number > 0 and <= 200, got 300",
        ),
        ("{mist: {}}", "atmosphere.mist: unknown key; expected one of fog, rain, snow"),
        ("{fog: {}}", "atmosphere.fog: missing key 'visibility_m'"),
    ],
)
def test_bad_configurations_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(f"{RUN}atmosphere: {text}\n", encoding="utf-8")
    with pytest.raises(ls.errors.ConfigError) as error:
        ls.config.load(path)
    assert message in str(error.value)


def test_recipes_vary_the_atmosphere(tmp_path: Path) -> None:
    recipe = tmp_path / "recipe.yaml"
    (tmp_path / "run.yaml").write_text(f"{RUN}atmosphere: {{fog: {{visibility_m: 80}}, label: 7}}\n", encoding="utf-8")
    recipe.write_text(
        "run: {file: run.yaml}\nlayout: {type: shards}\nsequences: 3\nseed: 1\n"
        "vary: {atmosphere.fog.visibility_m: {uniform: [30, 300]}}\n",
        encoding="utf-8",
    )
    ls.generate(recipe, tmp_path / "set", pictures=0)
    card = (tmp_path / "set" / "README.md").read_text(encoding="utf-8")
    assert "Air of the first frame: Atmosphere" in card
    assert "| 7 |" in card


def test_check_states_the_air(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from lidarsim.cli import main

    path = tmp_path / "run.yaml"
    for text, said in (
        ("{fog: {visibility_m: 50}}", "on average an echo of intensity"),
        ("{fog: {visibility_m: 50}}", "points are echoes of the air: is near_threshold=0.01 missing"),
        ("{rain: {rate_mm_per_h: 10}}", "echoes of drops or flakes per pulse"),
        ("{extinction_per_m: 0.1}", "without echoes"),
    ):
        path.write_text(f"{RUN}atmosphere: {text}\n", encoding="utf-8")
        with pytest.raises(SystemExit) as end:
            main(["check", str(path)])
        assert end.value.code == 0
        assert said in " ".join(capsys.readouterr().out.split())


def test_air_has_its_name_where_its_label_is_of_nothing_else() -> None:
    world = ls.Scene(class_names={40: "road"})
    world.add(ls.Plane((0, 0, 1), -1.8), label=40)
    world.atmosphere = ls.Atmosphere.fog(visibility=60.0)
    assert dict(world.class_names) == {40: "road", 0: "air"}
    cloud = ls.Lidar.preset("velodyne-vlp16", noise="datasheet").scan(world).point_cloud()
    in_air = cloud.source == ls.Source.atmosphere
    assert in_air.any()
    np.testing.assert_array_equal(cloud.label == "air", in_air)
    number = world.add(ls.Sphere((20, 0, 0), 1.0))  # label 0, as the air
    assert 0 not in world.class_names
    world.update(number, label=3)
    world.atmosphere = ls.Atmosphere.fog(visibility=60.0, label=40)
    assert dict(world.class_names) == {40: "road"}  # a given name stays
    world.atmosphere = None
    assert dict(world.class_names) == {40: "road"}
