"""Named streams: each stands for itself, and draws what it says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from lidarsim.datasets.draws import Stream

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
