"""Scan patterns: which pulses a frame fires, in the sensor frame.

The sensor frame is right-handed: x forward, y left, z up. Azimuths are measured from x towards y, that is
counter-clockwise seen from above, and elevations upwards from the x-y plane, both in rad. Times are in s since the
start of the frame.

Patterns are immutable. Two patterns of one class are equal if their arguments are equal. The arguments are attributes;
arrays are read-only copies. A frame depends only on the arguments and its number, so frames can be requested in any
order.
"""

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
