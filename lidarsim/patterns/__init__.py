"""Scan patterns: which pulses a frame fires, in the sensor frame.

The sensor frame is right-handed: x forward, y left, z up. Azimuths are measured from x towards y, that is
counter-clockwise seen from above, and elevations upwards from the x-y plane, both in rad. Times are in s since the
start of the frame.

The patterns here are immutable, and two of one class are equal if their arguments are. The arguments are attributes,
arrays as read-only copies. A frame depends on them and on its number alone, so frames can be requested in any order.
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
