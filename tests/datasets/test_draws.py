"""Named streams: each stands for itself, and draws what it says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from lidarsim import _native
from lidarsim.config.document import Place, parse
from lidarsim.config.loader import validate
from lidarsim.datasets.draws import MOST_SIGMAS, Draw, Stream
from lidarsim.errors import ConfigError

N = 4000
SIGNIFICANCE = 1e-6
"""Of each test of a distribution; the streams are fixed, so a test that passes once always does."""


def streams(name: str = "key", seed: int = 5) -> list[Stream]:
    return [Stream(seed, name, sequence) for sequence in range(N)]


def test_a_stream_depends_on_each_of_its_names_and_on_nothing_else() -> None:
    keys = list(itertools.product((0, 1), ("a", "b", ""), (0, 1, 2), (None, 0, 1)))
    first = [Stream(*key).word() for key in keys]
    assert len(set(first)) == len(keys)
    assert first == [Stream(*key).word() for key in reversed(keys)][::-1]


def test_sequences_and_frames_share_no_words() -> None:
    words = [
        stream.word() for sequence in range(50) for frame in range(20)
        for stream in [Stream(0, "a", sequence, frame)] for _ in range(10)
    ]  # fmt: skip
    assert len(set(words)) == len(words) == 10_000


@pytest.mark.parametrize(
    ("kind", "parameters", "distribution"),
    [
        ("uniform", (-2.0, 3.0), stats.uniform(-2.0, 5.0)),
        ("log_uniform", (0.01, 10.0), stats.loguniform(0.01, 10.0)),
        ("normal", (1.0, 2.0), stats.norm(1.0, 2.0)),
    ],
)
def test_continuous_draws_have_their_distribution(
    kind: str, parameters: tuple[float, float], distribution: stats.rv_continuous
) -> None:
    drawn = np.array([getattr(stream, kind)(*parameters) for stream in streams()])
    assert len(np.unique(drawn)) == N
    assert stats.kstest(drawn, distribution.cdf).pvalue > SIGNIFICANCE


def test_integers_include_both_ends_and_are_even() -> None:
    drawn = [stream.integer(-1, 4) for stream in streams()]
    counts = np.bincount(np.array(drawn) + 1)
    assert len(counts) == 6
    assert stats.chisquare(counts).pvalue > SIGNIFICANCE


def test_indices_follow_their_weights() -> None:
    weights = np.array([1.0, 5.0, 2.0])
    counts = np.bincount([stream.index(weights.tolist()) for stream in streams()])
    assert stats.chisquare(counts, N * weights / weights.sum()).pvalue > SIGNIFICANCE


HUGE = "1" + "0" * 300


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        ("uniform: [1, .inf]", "f:1: uniform: expected [least, greatest], got [1.0, inf]"),
        ("uniform: [.nan, 1]", "f:1: uniform: expected [least, greatest], got [nan, 1.0]"),
        ("uniform: [2, 1]", "f:1: uniform: expected [least, greatest], got [2.0, 1.0]"),
        ("uniform: [-1.0e+308, 1.0e+308]",
         "f:1: uniform: expected a difference within float64's range, got [-1e+308, 1e+308]"),
        ("log_uniform: [0, 1]", "f:1: log_uniform: expected positive numbers, got [0.0, 1.0]"),
        ("log_uniform: [-1, 1]", "f:1: log_uniform: expected positive numbers, got [-1.0, 1.0]"),
        ("log_uniform: [1.0e-320, 1]", "f:1: log_uniform: expected a ratio within float64's range, got [1e-320, 1.0]"),
        ("log_uniform: [1, .inf]", "f:1: log_uniform: expected [least, greatest], got [1.0, inf]"),
        ("normal: [.nan, 1]", "f:1: normal: expected [mean, sigma] with sigma >= 0, got [nan, 1.0]"),
        ("normal: [1, .inf]", "f:1: normal: expected [mean, sigma] with sigma >= 0, got [1.0, inf]"),
        ("normal: [1, -1]", "f:1: normal: expected [mean, sigma] with sigma >= 0, got [1.0, -1.0]"),
        ("normal: [1.0e+308, 1.0e+308]",
         "f:1: normal: expected draws within float64's range, got [1e+308, 1e+308]"),
        ("integer: [1, 2.5]", "f:1: integer.1: expected an integer, got 2.5"),
        ("integer: [3, 2]", "f:1: integer: expected [least, greatest], got [3, 2]"),
        (f"integer: [0, {HUGE}]", "f:1: integer: expected integers of 63 bits, got an integer of 997 bits"),
        ("choice: []", "f:1: choice: expected at least 1 items, got a list of 0"),
        ("choice: [1], weights: []", "f:1: weights: expected 1, one per choice, got 0"),
        ("choice: [1, 2], weights: [1, .nan]", "f:1: weights.1: expected positive numbers, got nan"),
        ("choice: [1, 2], weights: [.inf, 1]", "f:1: weights.0: expected positive numbers, got inf"),
        ("choice: [1, 2], weights: [1.7e+308, 1.7e+308]", "f:1: weights: expected a sum within float64's range"),
        ("choice: [1], per: hour", "f:1: per: expected 'sequence' or 'frame', got 'hour'"),
        ("choice: 5", "f:1: choice: expected a list, got 5"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn(draw: str, message: str) -> None:
    root = parse(f"{{{draw}}}", "f")
    with pytest.raises(ConfigError) as caught:
        validate(Draw, root).check(Place(root))
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "draw",
    [
        "uniform: [-8.0e+307, 8.0e+307]",
        "uniform: [5, 5]",
        "uniform: [1.0e-320, 1.0e-319]",
        "log_uniform: [1.0e-150, 1.0e+150]",
        "log_uniform: [2, 2]",
        "normal: [1.0e+307, 1.0e+307]",
        "normal: [3, 0]",
        f"integer: [{-(2**63)}, {2**63}]",
        "choice: [1, 2], weights: [1.0e-300, 8.0e+307]",
    ],
)
def test_the_ends_of_what_can_be_drawn(draw: str) -> None:
    root = parse(f"{{{draw}}}", "f")
    made = validate(Draw, root)
    made.check(Place(root), numbers=True)
    values = np.array([float(made.draw(stream)) for stream in streams()])
    assert np.isfinite(values).all()
    if made.ends and made.choice is None:
        assert made.ends[0] <= values.min() <= values.max() <= made.ends[1]


def test_no_normal_number_is_further_off() -> None:
    least, greatest = _native.normal_quantile(np.array([0.5 * 2.0**-52, 1 - 2.0**-53]))
    assert MOST_SIGMAS - 0.1 < -least < MOST_SIGMAS
    assert MOST_SIGMAS - 0.1 < greatest < MOST_SIGMAS
