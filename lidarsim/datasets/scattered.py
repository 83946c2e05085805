"""Counts of scattered objects: how many were asked for, how many were placed, and which rules left out the others."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from lidarsim._base.shown import quantity

MOST_RULES = 3
"""Greatest number of rules that a line names; the others are summed up."""

Count = Annotated[int, Field(ge=0, lt=2**63)]


@dataclass(frozen=True)
class Tally:
    """Numbers of objects of a group.

    Attributes
    ----------
    asked, placed : int
        Objects asked for, and objects placed.
    refused : dict of str to int
        Of the places tried for objects that were left out, the number that each rule refused.
    """

    asked: Count = 0
    placed: Count = 0
    refused: dict[str, Count] = field(default_factory=dict)

    def __add__(self, other: Tally) -> Tally:
        return Tally(self.asked + other.asked, self.placed + other.placed, _sum(self.refused, other.refused))

    @property
    def rules(self) -> str:
        """The rules that refused places, the most frequent first, each with its share."""
        total = sum(self.refused.values())
        ranked = sorted(self.refused.items(), key=lambda item: (-item[1], item[0]))
        rest = sum(count for _, count in ranked[MOST_RULES:])
        named = ranked[:MOST_RULES] + [("others", rest)] * bool(rest)
        return ", ".join(f"{rule} ({count / total:.0%})" for rule, count in named)


@dataclass(frozen=True)
class Scattered:
    """Counts of the scattered objects of some sequences.

    Attributes
    ----------
    sequences : int
        Number of sequences.
    groups : dict of str to Tally
        Numbers of each group.
    near : dict of str to int
        Objects of the scene to which the sensor comes nearer than its clearance, with the number of sequences.
    """

    sequences: Count = 0
    groups: dict[str, Tally] = field(default_factory=dict)
    near: dict[str, Count] = field(default_factory=dict)

    def __add__(self, other: Scattered) -> Scattered:
        names = dict.fromkeys([*self.groups, *other.groups])
        groups = {name: self.groups.get(name, Tally()) + other.groups.get(name, Tally()) for name in names}
        return Scattered(self.sequences + other.sequences, groups, _sum(self.near, other.near))

    @property
    def short(self) -> dict[str, Tally]:
        """The groups of which objects were left out."""
        return {name: tally for name, tally in self.groups.items() if tally.placed < tally.asked}

    def warnings(self) -> list[str]:
        """Return one line per object of the scene that is in the way of the sensor."""
        of = quantity(self.sequences, "sequence")
        return [
            f"the sensor comes nearer to {name}, of the scene, than clear_m in {count} of {of}"
            for name, count in self.near.items()
        ]

    def lines(self) -> list[str]:
        """Return one line per group of which objects were left out, and the warnings."""
        left = [
            f"{name}: {tally.placed} of {tally.asked} objects placed; places were refused by: {tally.rules}"
            for name, tally in self.short.items()
        ]
        return [*left, *self.warnings()]


def _sum(one: dict[str, int], other: dict[str, int]) -> dict[str, int]:
    return dict(Counter(one) + Counter(other))
