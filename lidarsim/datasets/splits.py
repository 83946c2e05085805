"""Splits of a data set by sequence, such as train and val.

With shares, the intervals of the splits divide 0 to 1 in their order, and sequence n belongs to that of ``frac(n φ)``,
φ = (√5 − 1)/2. This depends on the number of the sequence only, so more sequences do not move the others, and it
spreads evenly: of ten sequences, shares of 0.8 and 0.2 get eight and two, the fourth and the ninth.

Source: D. E. Knuth, The Art of Computer Programming 3, 6.4 (Fibonacci hashing).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING

from lidarsim._base.files import check_names
from lidarsim._base.shown import quantity
from lidarsim._base.validation import short_repr
from lidarsim.errors import ArgumentValueError

if TYPE_CHECKING:
    from lidarsim.config.document import Place

Parts = Mapping[str, "float | list[int]"]
"""A share of the sequences, or their numbers, by the name of a split."""

GOLDEN = 0x9E3779B97F4A7C15
"""The odd integer nearest to 2⁶⁴ (√5 − 1)/2."""


@dataclass(frozen=True)
class Splits:
    """Which sequence is in which split.

    Attributes
    ----------
    given : dict of str to float or list of int
        Shares or sequences of the splits; empty for none.
    """

    given: Parts = field(default_factory=dict)

    def of(self, sequence: int) -> str:
        """Return the split of a sequence; empty without splits."""
        if not self.given:
            return ""
        if self._lists:
            return self._lists[sequence]
        place = sequence * GOLDEN % 2**64 / 2**64
        return next((name for name, end in self._ends.items() if place < end), [*self.given][-1])

    def sequences(self, count: int) -> dict[str, list[int]]:
        """Return the numbers of each split's sequences, of `count` in all."""
        found: dict[str, list[int]] = {name: [] for name in self.given}
        for sequence in range(count if found else 0):
            found[self.of(sequence)].append(sequence)
        return found

    @cached_property
    def _lists(self) -> dict[int, str]:
        return {sequence: name for name, part in self.given.items() if isinstance(part, list) for sequence in part}

    @cached_property
    def _ends(self) -> dict[str, float]:
        shares = (share for share in self.given.values() if isinstance(share, float))
        return dict(zip(self.given, accumulate(shares), strict=True))


def check_splits(
    splits: Mapping[str, object] | None, sequences: int, place: Place | None = None
) -> dict[str, float | list[int]]:
    """Return the splits after checking them.

    Parameters
    ----------
    splits : mapping of str to object, or None
        The values to check.
    sequences : int
        Number of sequences.
    place : Place, optional
        Place of the splits in a recipe, for the errors.

    Raises
    ------
    ConfigError
        If they are wrong and there is a place.
    ValueError
        If they are wrong and there is none.
    """

    def wrong(key: str, expected: str, got: str) -> Exception:
        if place is not None:
            return (place / key if key else place).error(f"expected {expected}, got {got}")
        return ArgumentValueError(f"splits.{key}" if key else "splits", expected, got)

    if not splits:
        return {}
    try:
        check_names("splits", splits)
    except ArgumentValueError as error:
        if place is None:
            raise
        raise place.error(error.problem) from None
    parts: dict[str, float | list[int]] = {}
    for name, part in splits.items():
        if isinstance(part, int | float) and not isinstance(part, bool) and 0 < part <= 1:
            parts[name] = float(part)
        elif isinstance(part, list) and all(type(number) is int for number in part):
            parts[name] = [*part]
        else:
            raise wrong(name, "a share, 0 to 1, or a list of the numbers of sequences", short_repr(part))
    shares = [part for part in parts.values() if isinstance(part, float)]
    if shares and len(shares) < len(parts):
        raise wrong("", "either shares or lists of sequences", "both")
    if not shares:
        _check_lists({name: part for name, part in parts.items() if isinstance(part, list)}, sequences, wrong)
        return parts
    # A share is rounded by at most 2⁻⁵⁴, since it is at most 1, and their exact sum, close to 1, by at most 2⁻⁵³.
    if abs(math.fsum(shares) - 1.0) > len(shares) * 2.0**-54 + 2.0**-53:
        raise wrong("", "shares that sum to 1", repr(math.fsum(shares)))
    if empty := [name for name, numbers in Splits(parts).sequences(sequences).items() if not numbers]:
        logging.getLogger("lidarsim").warning(
            "splits: none of %s is in %s; more sequences, or lists of them, give it some",
            quantity(sequences, "sequence"),
            ", ".join(empty),
        )
    return parts


def _check_lists(lists: dict[str, list[int]], sequences: int, wrong: Callable[[str, str, str], Exception]) -> None:
    """Check that each sequence is in one list."""
    seen: dict[int, str] = {}
    for name, numbers in lists.items():
        for number in numbers:
            if not 0 <= number < sequences:
                raise wrong(name, f"numbers of sequences, 0 to {sequences - 1}", str(number))
            if number in seen:
                there = "twice" if seen[number] == name else f"in {seen[number]} too"
                raise wrong(name, "each sequence once", f"{number} {there}")
            seen[number] = name
    if lists and len(seen) < sequences:
        first = next(number for number in range(sequences) if number not in seen)
        raise wrong("", f"each of the {quantity(sequences, 'sequence')} in a split", f"none for {first}")
