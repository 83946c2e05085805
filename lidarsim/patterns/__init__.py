"""Scan patterns: which pulses a frame fires, in the sensor frame."""

from __future__ import annotations

from lidarsim.patterns._pulses import Pattern, Pulses
from lidarsim.patterns.description import Description, describe
from lidarsim.patterns.grid import Grid
from lidarsim.patterns.mid360 import Mid360
from lidarsim.patterns.oscillating_mirror import OscillatingMirror
from lidarsim.patterns.palmer import Palmer
from lidarsim.patterns.polygon_mirror import PolygonMirror
from lidarsim.patterns.risley import Prism, Risley
from lidarsim.patterns.spinning import Spinning
from lidarsim.patterns.table import Table

__all__ = [
    "Description",
    "Grid",
    "Mid360",
    "OscillatingMirror",
    "Palmer",
    "Pattern",
    "PolygonMirror",
    "Prism",
    "Pulses",
    "Risley",
    "Spinning",
    "Table",
    "describe",
]
