"""Random numbers by name: a draw does not depend on other draws or on their order."""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from lidarsim import _native
from lidarsim._base.validation import short_repr
from lidarsim.config.factories import Model, Pair, either

if TYPE_CHECKING:
    from lidarsim.config.document import Place

MOST_INTEGER = 2**63
"""Greatest absolute bound of a drawn integer, so that one word of a stream covers the interval."""

MOST_SIGMAS = 8.3
"""Bound of normal draws in sigmas: -Φ⁻¹(2⁻⁵³), for the smallest `Stream.unit`, is 8.21."""

KINDS = ("uniform", "log_uniform", "normal", "integer", "choice")


class Stream:
    """The random numbers of one key of a recipe in one sequence, or in one frame if it is drawn per frame.

    The generator is Philox4x64-10 (Salmon et al., Parallel random numbers: as easy as 1, 2, 3, 2011), with the BLAKE2b
    hash of seed and name as key, and the sequence and frame as counter.

    Parameters
    ----------
    seed : int
        Seed of the data set, 0 to 2⁶⁴ − 1.
    name : str
        Name of the draw.
    sequence : int
        Number of the sequence.
    frame : int, optional
        Number of the frame.
    """

    def __init__(self, seed: int, name: str, sequence: int, frame: int | None = None) -> None:
        key = hashlib.blake2b(name.encode(), digest_size=16, key=seed.to_bytes(8, "little")).digest()
        counter = [0, 0, 0 if frame is None else frame + 1, sequence]
        self.bits = np.random.Philox(key=np.frombuffer(key, np.uint64), counter=np.array(counter, np.uint64))

    def word(self) -> int:
        """Return an integer from 0 to 2⁶⁴ − 1."""
        return int(self.bits.random_raw())

    def unit(self) -> float:
        """Return a number strictly between 0 and 1: (k + ½)·2⁻⁵², which is a float64."""
        return ((self.word() >> 12) + 0.5) * 2.0**-52

    def uniform(self, low: float, high: float) -> float:
        """Return a number from `low` to `high`."""
        return low + (high - low) * self.unit()

    def log_uniform(self, low: float, high: float) -> float:
        """Return a number from `low` to `high` whose logarithm is uniform."""
        return low * math.exp(self.unit() * math.log(high / low))

    def normal(self, mean: float, sigma: float) -> float:
        """Return a normally distributed number."""
        return mean + sigma * float(_native.normal_quantile(np.array([self.unit()]))[0])

    def integer(self, low: int, high: int) -> int:
        """Return an integer from `low` to `high`, both included."""
        return low + self.word() * (high - low + 1) // 2**64

    def index(self, weights: Sequence[float]) -> int:
        """Return an index with a probability proportional to its weight; weights are positive."""
        sums = np.cumsum(weights)
        return int(np.searchsorted(sums[:-1], self.unit() * sums[-1], side="right"))


class _End(Stream):
    """A stream that repeats one word."""

    def __init__(self, word: int) -> None:
        self._word = word

    def word(self) -> int:
        return self._word


class Draw(Model):
    """Distribution of a drawn value."""

    uniform: Pair | None = None
    """Least and greatest value."""
    log_uniform: Pair | None = None
    """The same, uniform in the logarithm."""
    normal: Pair | None = None
    """Mean and standard deviation."""
    integer: Annotated[list[int], Field(min_length=2, max_length=2)] | None = None
    """Least and greatest integer, both included."""
    choice: Annotated[list[Any], Field(min_length=1)] | None = None
    """Any values."""
    weights: list[float] | None = None
    """Weight of each choice. Default: equal."""
    per: Literal["sequence", "frame"] = "sequence"
    """How often it is drawn."""

    @model_validator(mode="after")
    def _one(self) -> Draw:
        given = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            found = {"kinds": ", ".join(KINDS), "got": " and ".join(given) or "none of them"}
            raise PydanticCustomError("draw", "expected one of {kinds}, got {got}", found)
        return self

    def check(self, place: Place, *, numbers: bool = False) -> None:
        """Raise an error if the draw is impossible or, with `numbers`, if it may not give a number."""
        if numbers:
            self._check_numbers(place)
        for kind in ("uniform", "log_uniform", "integer"):
            low, high = getattr(self, kind) or (1, 1)
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise (place / kind).error(f"expected [least, greatest], got [{low}, {high}]")
        low, high = self.uniform or (0.0, 0.0)
        if not math.isfinite(high - low):
            raise (place / "uniform").error(f"expected a difference within float64's range, got [{low}, {high}]")
        low, high = self.log_uniform or (1.0, 1.0)
        if low <= 0:
            raise (place / "log_uniform").error(f"expected positive numbers, got [{low}, {high}]")
        if low * sys.float_info.max < high:
            raise (place / "log_uniform").error(f"expected a ratio within float64's range, got [{low}, {high}]")
        for end in self.integer or ():
            if not -MOST_INTEGER <= end <= MOST_INTEGER:
                raise (place / "integer").error(f"expected integers of 63 bits, got {short_repr(end)}")
        mean, sigma = self.normal or (0.0, 0.0)
        if not (math.isfinite(mean) and math.isfinite(sigma) and sigma >= 0):
            raise (place / "normal").error(f"expected [mean, sigma] with sigma >= 0, got [{mean}, {sigma}]")
        if not math.isfinite(abs(mean) + MOST_SIGMAS * sigma):
            raise (place / "normal").error(f"expected draws within float64's range, got [{mean}, {sigma}]")
        self._check_weights(place / "weights")

    def _check_numbers(self, place: Place) -> None:
        for index, value in enumerate(self.choice or ()):
            if type(value) not in {int, float} or not math.isfinite(value):
                raise (place / "choice" / index).error(f"expected numbers, each finite, got {short_repr(value)}")
        if self.per == "frame":
            raise (place / "per").error("expected sequence, since objects are placed once in each, got frame")

    def _check_weights(self, place: Place) -> None:
        if self.weights is None:
            return
        if self.choice is None or len(self.weights) != len(self.choice):
            expected = "none without choice" if self.choice is None else f"{len(self.choice)}, one per choice"
            raise place.error(f"expected {expected}, got {len(self.weights)}")
        for index, weight in enumerate(self.weights):
            if not 0 < weight < math.inf:
                raise (place / index).error(f"expected positive numbers, got {weight}")
        if sum(self.weights) == math.inf:
            raise place.error("expected a sum within float64's range")

    @property
    def ends(self) -> tuple[float, float] | None:
        """Least and greatest possible number; None for a normal distribution, which is unbounded."""
        values = self.uniform or self.log_uniform or self.integer or self.choice
        return (min(values), max(values)) if values else None

    @property
    def extremes(self) -> Sequence[float]:
        """What `draw` returns at the ends of its range, or all that it returns of choices; none if it is unbounded."""
        if self.normal is not None:
            return ()
        return range(len(self.choice)) if self.choice else [self.draw(_End(word)) for word in (0, 2**64 - 1)]

    def draw(self, stream: Stream) -> Any:
        """Return the drawn value, or the index of a choice."""
        if self.uniform is not None:
            return stream.uniform(*self.uniform)
        if self.log_uniform is not None:
            return stream.log_uniform(*self.log_uniform)
        if self.normal is not None:
            return stream.normal(*self.normal)
        if self.integer is not None:
            return stream.integer(*self.integer)
        return stream.index(self.weights or [1.0] * len(self.choice or ()))


if TYPE_CHECKING:
    DrawOr = float | Draw
else:
    DrawOr = either(float, Draw, lambda value: isinstance(value, dict))


def draw_number(value: float | Draw, stream: Stream) -> float:
    """Return a number, drawn if `value` is a `Draw`."""
    if not isinstance(value, Draw):
        return value
    number = value.draw(stream)
    return float(number if value.choice is None else value.choice[number])
