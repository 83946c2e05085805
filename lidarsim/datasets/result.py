"""What a call of `lidarsim.generate` made."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Generated:
    """Result of a call of `generate`.

    Attributes
    ----------
    frames, points : int
        Frames and points made by this call; existing ones are not counted, those of lost files are.
    seconds : float
        Duration, pictures of the data card included, s.
    shards_left : int
        Shards that other parts still have to make; 0 if the data set is complete.
    made_again : tuple of str
        Names of lost and damaged files that were made again.
    left_out : tuple of str
        Of the sequences whose first frame this call made, one line per group of scattered objects that were not all
        placed, with both numbers and the rules that refused them, and one per object of the scene in the sensor's way.
    """

    frames: int
    points: int
    seconds: float
    shards_left: int
    made_again: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
