"""Random numbers of the core: generator, distribution and independence."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats

import lidarsim as ls
from lidarsim import _native

PULSES = 1 << 20
"""Enough draws for the tests of their law."""

LEAST_P = 1e-3
"""A test of a law fails below this probability: at fixed seeds it passes for good, or the law is wrong."""


def reference_philox(counter: list[int], key: list[int]) -> list[int]:
    """Philox4x32-10 as its authors' paper states it, in Python's integers."""
    for _ in range(10):
        first, second = 0xD2511F53 * counter[0], 0xCD9E8D57 * counter[2]
        counter = [
            (second >> 32) ^ counter[1] ^ key[0],
            second % 2**32,
            (first >> 32) ^ counter[3] ^ key[1],
            first % 2**32,
        ]
        key = [(key[0] + 0x9E3779B9) % 2**32, (key[1] + 0xBB67AE85) % 2**32]
    return counter


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        ([0] * 4, [0] * 2, [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
        ([2**32 - 1] * 4, [2**32 - 1] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
        (
            [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
            [0xA4093822, 0x299F31D0],
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_philox_gives_the_known_answers(counter: list[int], key: list[int], words: list[int]) -> None:
    assert reference_philox(counter, key) == words
    assert _native.philox(np.array([counter], dtype=np.uint32), key).tolist() == [words]


def test_philox_equals_the_reference() -> None:
    generator = np.random.default_rng(1)
    counters = generator.integers(0, 2**32, (500, 4), dtype=np.uint32)
    key = generator.integers(0, 2**32, 2).tolist()
    expected = [reference_philox(counter, key) for counter in counters.tolist()]
    assert _native.philox(counters, key).tolist() == expected


def test_the_normal_quantile_is_right_to_rounding() -> None:
    # Wichura states the rational functions to 1e-16. Numerator and denominator are each 7 steps of Horner's rule over
    # terms of one sign, 14 roundings of 2⁻⁵³ at most; the argument of the tails, √(−ln p), adds 2, on which the
    # quotient hangs less than linearly.
    bound = 1e-16 + (14 + 14 + 4) * 2.0**-53
    generator = np.random.default_rng(2)
    p = np.concatenate(
        [
            generator.uniform(0.0, 1.0, 500),
            10.0 ** generator.uniform(-15.9, -1.0, 500),
            1.0 - 10.0 ** generator.uniform(-15.0, -1.0, 500),
            [2.0**-53, 1.0 - 2.0**-53, 0.075, 0.925, math.exp(-25.0), 0.25],
        ]
    )
    got = _native.normal_quantile(p)
    with mpmath.workdps(40):
        exact = [mpmath.sqrt(2) * mpmath.erfinv(2 * mpmath.mpf(x) - 1) for x in p.tolist()]
        errors = [abs(mpmath.mpf(g) / e - 1) for g, e in zip(got.tolist(), exact, strict=True)]
    assert max(errors) <= bound
    assert _native.normal_quantile(np.array([0.5])).tolist() == [0.0]


# As a user meets them: a sensor before a wall 100 m away whose noise has σ = 1 m gives one Gaussian a pulse.


def wall(distance: float = 100.0) -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane.from_point((distance, 0, 0), (1, 0, 0)))
    return scene


def ahead(pulses: int) -> npt.NDArray[np.float64]:
    return np.tile([1.0, 0.0, 0.0], (pulses, 1))


def noise(*, seed: int = 7, frame: int = 0, name: str = "front", pulses: int = PULSES) -> npt.NDArray[np.float64]:
    lidar = ls.Lidar(
        ls.patterns.Table(ahead(pulses), rate=10.0), measurement=ls.Measurement(range_sigma=1.0), name=name
    )
    return lidar.scan(wall(), seed=seed, frame=frame).range_error[:, 0]


@pytest.fixture(scope="module")
def draws() -> npt.NDArray[np.float64]:
    return noise()


def test_noise_is_gaussian(draws: npt.NDArray[np.float64]) -> None:
    assert len(draws) >= 10**6
    assert stats.kstest(draws, "norm").pvalue > LEAST_P
    edges = stats.norm.ppf(np.linspace(0.0, 1.0, 257))
    assert stats.chisquare(np.histogram(draws, edges)[0]).pvalue > LEAST_P


def test_the_tails_are_those_of_a_gaussian(draws: npt.NDArray[np.float64]) -> None:
    for sigmas in (3.0, 4.0, 4.5):
        for beyond in (draws < -sigmas, draws > sigmas):
            p = stats.binomtest(int(beyond.sum()), len(draws), stats.norm.cdf(-sigmas)).pvalue
            assert p > LEAST_P, sigmas


def correlation(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
    """Correlation in units of its own standard deviation, 1/√n."""
    return float(np.corrcoef(a, b)[0, 1]) * math.sqrt(len(a))


@pytest.mark.parametrize(
    "other",
    [{"seed": 8}, {"seed": 7 + 2**32}, {"frame": 1}, {"frame": 2**31}, {"name": "rear"}, {"name": ""}],
    ids=str,
)
def test_seeds_frames_and_sensors_are_independent(draws: npt.NDArray[np.float64], other: dict[str, int | str]) -> None:
    others = noise(**other)  # type: ignore[arg-type]
    # Beyond 4.4 standard deviations in one of 10⁵ cases.
    for a, b in ((draws, others), (draws**2, others**2), (draws[:-1], others[1:])):
        assert abs(correlation(a, b)) < 4.4
    assert not (draws == others).any()


def test_neighbouring_pulses_are_independent(draws: npt.NDArray[np.float64]) -> None:
    for lag in (1, 2, 16, 64, 128, 1024, 65536):
        assert abs(correlation(draws[:-lag], draws[lag:])) < 4.4
        assert abs(correlation(draws[:-lag] ** 2, draws[lag:] ** 2)) < 4.4


def test_dropout_and_noise_are_independent(draws: npt.NDArray[np.float64]) -> None:
    lidar = ls.Lidar(ls.patterns.Table(ahead(PULSES), rate=10.0), measurement=ls.Measurement(dropout=0.3), name="front")
    dropped = lidar.scan(wall(), seed=7).status == ls.Status.dropped
    assert stats.binomtest(int(dropped.sum()), PULSES, 0.3).pvalue > LEAST_P
    assert abs(correlation(draws, dropped.astype(float))) < 4.4
    assert stats.ks_2samp(draws[dropped], draws[~dropped]).pvalue > LEAST_P


def test_angular_jitter_is_gaussian_and_independent(draws: npt.NDArray[np.float64]) -> None:
    # Half left of the wall's normal the range tells the azimuth, half up of it the elevation.
    sigma = 1e-3
    angles = {}
    for name, direction in (("azimuth", (1, 1, 0)), ("elevation", (1, 0, 1))):
        lidar = ls.Lidar(
            ls.patterns.Table(np.tile(direction, (PULSES, 1)), rate=10.0),
            measurement=ls.Measurement(**{f"{name}_sigma": sigma}),  # type: ignore[arg-type]
            name="front",
        )
        scan = lidar.scan(wall(), seed=7)
        angles[name] = (np.arccos(100.0 / scan.true_range[:, 0]) - np.pi / 4.0) / sigma
        assert stats.kstest(angles[name], "norm").pvalue > LEAST_P
        assert abs(correlation(angles[name], draws)) < 4.4
    assert abs(correlation(angles["azimuth"], angles["elevation"])) < 4.4
