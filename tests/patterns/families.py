"""One sample or more of each family of scan patterns, and what each pulse of it must be, in 50 digits.

An oracle gives direction, origin and time of the pulse of a ring and a clock tick by the definition of the family;
ticks count from time 0, and no angle is reduced.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import mpmath as mp
import numpy as np
from mpmath import mpf

from lidarsim.patterns import (
    Grid,
    Mid360,
    OscillatingMirror,
    Palmer,
    Pattern,
    PolygonMirror,
    Prism,
    Risley,
    Spinning,
    Table,
)

LATE = 1_234_567
"""A frame a day or more after the first."""

DATA = Path(__file__).parents[1] / "data" / "sensors"

VLP16 = Spinning(
    np.radians(np.arange(-15.0, 17.0, 2.0)),
    column_period=55.296e-6,
    firing_times=np.r_[0:16:2, 1:16:2] * 2.304e-6,
    beam_origins=np.c_[np.full(16, 0.003), np.zeros(16), np.linspace(0.01, -0.01, 16)],
)
OUSTER = Spinning(
    np.radians([20.0, 7.0, -6.0, -19.0]),
    azimuth_offsets=np.radians([-4.2, -1.4, 1.4, 4.2]),
    columns=1024,
    rate=20.0,
    beam_origins=(0.015806, 0.0, 0.03618),
)
HOKUYO = Spinning(
    [0.0],
    columns=1440,
    rate=40.0,
    clockwise=False,
    field_of_view=np.radians(270.25),
    start_azimuth=np.radians(-135.0),
)
PARTIAL = Spinning([0.1, -0.2], columns=700.25, rate=7.0, field_of_view=1.0, firing_times=[1e-4, 0.0])
MID40 = Risley(
    [
        Prism(7294 / 60, phase=np.pi, exit_tilt=np.radians(18.0)),
        Prism(-4664 / 60, entry_tilt=np.radians(18.0)),
    ],
    refractive_index=1.5089,
    pulse_rate=100e3,
    rate=10.0,
)
THREE_PRISMS = Risley(
    [Prism(-131.5463, entry_tilt=0.54), Prism(40.8032, entry_tilt=0.52, phase=1.0), Prism(213.1611, entry_tilt=0.055)],
    refractive_index=1.51,
    pulse_rate=40e3,
    rate=30.0,
    beams=[[1.0, 0.0, z] for z in (-0.05, 0.0, 0.05)],
)
ALS50 = OscillatingMirror(field_of_view=np.radians(75.0), scan_rate=24.7, pulse_rate=150e3, rate=10.0, turn=0.3)
TRIANGLE = OscillatingMirror(field_of_view=1.0, scan_rate=11.0, pulse_rate=20e3, rate=3.0)
VQ780 = PolygonMirror(
    sweep=np.radians(90.0), field_of_view=np.radians(60.0), line_rate=297.0, pulse_rate=500e3, rate=10.0
)
AT128 = PolygonMirror(
    np.radians([12.9, 12.7, 12.5]),
    sweep=np.radians(240.0),
    field_of_view=np.radians(120.0),
    line_rate=10.0,
    pulse_rate=24e3,
    rate=10.0,
    azimuth_offsets=np.radians([2.4, -0.65, 2.4]),
    firing_times=[8.24e-6, 0.0, 4.112e-6],
)
VQ880 = Palmer(half_angle=np.radians(20.0), scan_rate=79.9, pulse_rate=200e3, rate=10.0)
FLASH = Grid(np.radians(np.linspace(30.0, -30.0, 16)), np.radians(np.linspace(10.0, -10.0, 6)), rate=25.0)
COLUMNS = Grid([0.3, 0.1, -0.1, -0.3], [0.2, 0.0], rate=10.0, column_period=0.02)
TABLE = Table(np.eye(3)[np.arange(30) % 3], times=np.arange(30) / 100.0, rings=np.arange(30) % 2, rate=10.0)

FAMILIES: dict[str, Pattern] = {
    "vlp16": VLP16,
    "ouster": OUSTER,
    "hokuyo": HOKUYO,
    "partial": PARTIAL,
    "mid40": MID40,
    "three prisms": THREE_PRISMS,
    "mid360": Mid360(),
    "als50": ALS50,
    "triangle": TRIANGLE,
    "vq780": VQ780,
    "at128": AT128,
    "vq880": VQ880,
    "flash": FLASH,
    "columns": COLUMNS,
    "table": TABLE,
}
"""Each family under every common test; `test_families` fails if one is missing."""

Expected = tuple[list[mpf], list[mpf], mpf]
"""Direction, origin and time since time 0."""


def exact(value: float) -> mpf:
    """Return a float64 as it is."""
    return mpf(float(value))


def polar(azimuth: mpf, elevation: mpf) -> list[mpf]:
    """Return a unit vector."""
    return [mp.cos(elevation) * mp.cos(azimuth), mp.cos(elevation) * mp.sin(azimuth), mp.sin(elevation)]


def spinning(pattern: Spinning, frame: int, tick: int, ring: int) -> Expected:
    """Return what the channel `ring` must fire in the cycle `tick`; its turn is that of the head since `frame`."""
    rate = exact(pattern.rate)
    time = tick / (rate * exact(pattern.columns_per_turn)) + exact(pattern.firing_times[ring])
    turned = (-1 if pattern.clockwise else 1) * 2 * mp.pi * (rate * time - frame)
    head = exact(pattern.start_azimuth) + turned
    direction = polar(head + exact(pattern.azimuth_offsets[ring]), exact(pattern.elevations[ring]))
    x, y, z = map(exact, pattern.beam_origins[ring])
    return direction, [mp.cos(head) * x - mp.sin(head) * y, mp.sin(head) * x + mp.cos(head) * y, z], time


def risley(pattern: Risley, frame: int, tick: int, ring: int) -> Expected:
    """Return what the beam `ring` must fire at `tick`, by Snell's law with angles of incidence instead of vectors."""
    del frame
    time = tick / exact(pattern.pulse_rate)
    direction = mp.matrix(list(map(exact, pattern.beams[ring])))
    direction /= mp.norm(direction)
    index = exact(pattern.refractive_index)
    for prism in pattern.prisms:
        angle = 2 * mp.pi * exact(prism.rotation_rate) * time + exact(prism.phase)
        for given, before, behind in ((prism.entry_tilt, 1, index), (prism.exit_tilt, index, 1)):
            tilt = exact(given)
            normal = mp.matrix([mp.cos(tilt), mp.sin(tilt) * mp.cos(angle), mp.sin(tilt) * mp.sin(angle)])
            cosine = (direction.T * normal)[0]
            across = direction - cosine * normal
            if mp.norm(across) > 0:
                sine = mp.norm(across) * before / behind
                direction = mp.sqrt(1 - sine**2) * normal + sine * across / mp.norm(across)
    return list(direction), [mpf(0)] * 3, time


def oscillating(pattern: OscillatingMirror, frame: int, tick: int, ring: int) -> Expected:
    """Return what must be fired at `tick`: speed integrated from one end to the other."""
    del frame, ring
    time = tick / exact(pattern.pulse_rate)
    phase = 2 * mp.frac(exact(pattern.scan_rate) * time)
    way = phase if phase <= 1 else 2 - phase  # from the left end, time in swings one way
    turn = exact(pattern.turn) / 2
    speed = 2 / (1 - turn)

    def travel(t: mpf) -> mpf:
        if t < turn:
            return speed * t**2 / (2 * turn)
        if t < 1 - turn:
            return speed * (t - turn / 2)
        return 2 - travel(1 - t)

    azimuth = exact(pattern.field_of_view) / 2 * (1 - travel(way))
    return polar(azimuth, mpf(0)), [mpf(0)] * 3, time


def polygon(pattern: PolygonMirror, frame: int, tick: int, ring: int) -> Expected:
    """Return what the channel `ring` must fire in the cycle `tick`."""
    del frame
    cycle = tick / exact(pattern.pulse_rate)
    line_rate = exact(pattern.line_rate)
    line = mp.floor(cycle * line_rate)
    time = cycle + exact(pattern.firing_times[ring])
    azimuth = exact(pattern.field_of_view) / 2 - exact(pattern.sweep) * (time * line_rate - line)
    direction = polar(azimuth + exact(pattern.azimuth_offsets[ring]), exact(pattern.elevations[ring]))
    return direction, [mpf(0)] * 3, time


def palmer(pattern: Palmer, frame: int, tick: int, ring: int) -> Expected:
    """Return what must be fired at `tick`."""
    del frame, ring
    time = tick / exact(pattern.pulse_rate)
    half, angle = exact(pattern.half_angle), 2 * mp.pi * exact(pattern.scan_rate) * time
    return [mp.cos(half), mp.sin(half) * mp.cos(angle), mp.sin(half) * mp.sin(angle)], [mpf(0)] * 3, time


ORACLES: dict[type, tuple[Callable[..., Expected], Callable[..., Fraction]]] = {
    Spinning: (spinning, lambda p: Fraction(p.rate) * Fraction(p.columns_per_turn)),
    Risley: (risley, lambda p: Fraction(p.pulse_rate)),
    OscillatingMirror: (oscillating, lambda p: Fraction(p.pulse_rate)),
    PolygonMirror: (polygon, lambda p: Fraction(p.pulse_rate)),
    Palmer: (palmer, lambda p: Fraction(p.pulse_rate)),
}
"""The oracle of each family that a clock drives, and the rate of that clock."""
