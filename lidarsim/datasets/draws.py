"""Random numbers by name: what is drawn for one thing does not depend on what else is drawn, or when."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

import numpy as np

from lidarsim import _native

__all__ = ["Stream"]


class Stream:
    """The random numbers of one thing: of a key of a recipe, in one sequence, and in one frame if they are drawn anew.

    They are those of Philox4x64-10 (Salmon et al., Parallel random numbers: as easy as 1, 2, 3, 2011), its key the
    BLAKE2b hash of seed and name, its counter the sequence and the frame.

    Parameters
    ----------
    seed : int
        Of the data set, 0 to 2⁶⁴ − 1.
    name : str
        What is drawn.
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
        """Return a number between 0 and 1, both excluded: (k + ½)·2⁻⁵², which is a float64."""
        return ((self.word() >> 12) + 0.5) * 2.0**-52

    def uniform(self, low: float, high: float) -> float:
        """Return a number from `low` to `high`."""
        return low + (high - low) * self.unit()

    def log_uniform(self, low: float, high: float) -> float:
        """Return a number from `low` to `high` whose logarithm is uniform."""
        return low * math.exp(self.unit() * math.log(high / low))

    def normal(self, mean: float, sigma: float) -> float:
        """Return a number of the normal distribution."""
        return mean + sigma * float(_native.normal_quantile(np.array([self.unit()]))[0])

    def integer(self, low: int, high: int) -> int:
        """Return an integer from `low` to `high`, both included."""
        return low + self.word() * (high - low + 1) // 2**64

    def index(self, weights: Sequence[float]) -> int:
        """Return an index, each with a probability in proportion to its weight, which is positive."""
        sums = np.cumsum(weights)
        return int(np.searchsorted(sums[:-1], self.unit() * sums[-1], side="right"))
