"""Rotating prisms: patterns that do not repeat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.names import explain_arguments
from lidarsim._base.pickling import Value
from lidarsim._base.validation import (
    FASTEST,
    Floats,
    Vector,
    angle,
    array,
    freeze,
    frequency,
    items,
    nonzero_vectors,
    real,
    short_repr,
)
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.patterns._parts import TURN, SteadyPattern, Ticks, cycles, rings, unit

DENSEST = 10.0
"""Refractive index, more than twice that of the densest glasses and semiconductors, of which germanium has 4."""

CHECKED = 1 << 16
"""Pulses of the first frame, at most, that are made to see whether the prisms let the beams through."""


@dataclass(frozen=True)
class Prism(Value):
    """A wedge of glass that rotates about the x axis.

    Each face is perpendicular to x or tilted. At time t the normal of a face tilted by `a` is ``(cos a, sin a cos h,
    sin a sin h)`` with ``h = 2 pi rotation_rate t + phase``.

    Parameters
    ----------
    rotation_rate : float
        Turns per second, Hz, positive from y towards z.
    phase : float
        Angle at time 0, rad.
    entry_tilt, exit_tilt : float
        Tilts of the faces where the light enters and where it leaves, rad.

    Raises
    ------
    TypeError, ValueError
        If an argument is not a finite number, a tilt not between -pi/2 and pi/2, or the phase more than a turn.
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "rotation_rate_hz": float,
        "rotation_rate_rpm": float,
        "phase_deg": float,
        "entry_tilt_deg": float,
        "exit_tilt_deg": float,
    }

    rotation_rate: float
    _: KW_ONLY
    phase: float = 0.0
    entry_tilt: float = 0.0
    exit_tilt: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        rotation_rate = real("rotation_rate", self.rotation_rate)
        if abs(rotation_rate) > FASTEST:
            raise ArgumentValueError("rotation_rate", f"one up to {FASTEST:g} Hz either way", rotation_rate)
        object.__setattr__(self, "rotation_rate", rotation_rate)
        for name, most in (("phase", TURN), ("entry_tilt", TURN / 4), ("exit_tilt", TURN / 4)):
            object.__setattr__(self, name, angle(name, getattr(self, name), at_least=-most, at_most=most))


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Risley(SteadyPattern):
    """Beams along x that a sequence of rotating prisms refracts: the rosettes of non-repetitive lidars.

    Pulse `m` fires at ``m / pulse_rate``, all beams together. Frame `k` takes the pulses from ``k / rate`` to ``(k + 1)
    / rate``, so the pattern continues from frame to frame. Each face refracts a beam d by Snell's law in vector form:
    with N the normal of the face and r the ratio of the refractive indices before and behind it, the beam leaves along
    ``r d + (sqrt(1 - r**2 (1 - (d.N)**2)) - r d.N) N``.

    Parameters
    ----------
    prisms : sequence of Prism
        The prisms, in the order in which the light passes them.
    refractive_index : float
        Refractive index of the prisms, in air (1).
    pulse_rate : float
        Pulses per second of each beam, Hz.
    rate : float
        Frames per second, Hz.
    beams : array_like, shape (b, 3), optional
        Directions of the beams before the first prism, of any length but 0. A beam's index here is its ring. Default:
        one along x.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape or is out of its range, or a prism reflects a beam totally among the
        first 65,536 pulses. If one does later, `pulses` raises ValueError.

    Notes
    -----
    For the vector form of Snell's law see G. H. Spencer and M. V. R. K. Murty, General ray-tracing procedure, J. Opt.
    Soc. Am. 52, 1962, 672-678. All beams leave from the origin: their lateral shift in the prisms is not modelled.

    Examples
    --------
    >>> from math import radians
    >>> from lidarsim.patterns import Prism, Risley
    >>> prisms = [Prism(121.57, exit_tilt=radians(18)), Prism(-77.73, entry_tilt=radians(18))]
    >>> pattern = Risley(prisms, refractive_index=1.5089, pulse_rate=100e3, rate=10.0)
    >>> pattern.shape, len(pattern.pulses(frame=7))
    ((1, 10000), 10000)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "prisms": list[Prism],
        "refractive_index": float,
        "pulse_rate_khz": float,
        "rate_hz": float,
        "beams": list[Vector],
    }

    prisms: tuple[Prism, ...]
    refractive_index: float
    pulse_rate: float
    rate: float
    beams: Floats

    @explain_arguments
    def __init__(
        self,
        prisms: Sequence[Prism],
        *,
        refractive_index: float,
        pulse_rate: float,
        rate: float,
        beams: npt.ArrayLike = ((1.0, 0.0, 0.0),),
    ) -> None:
        set_ = object.__setattr__
        set_(self, "prisms", tuple(items("prisms", prisms, "Prism objects")))
        for i, prism in enumerate(self.prisms):
            if not isinstance(prism, Prism):
                raise ArgumentTypeError("prisms", "Prism objects", f"prisms[{i}] = {short_repr(prism)}")
        set_(self, "refractive_index", real("refractive_index", refractive_index, at_least=1.0))
        if self.refractive_index > DENSEST:
            raise ArgumentValueError("refractive_index", f"one up to {DENSEST:g}", f"{self.refractive_index:g}")
        set_(self, "pulse_rate", frequency("pulse_rate", pulse_rate))
        set_(self, "rate", frequency("rate", rate, at_most=self.pulse_rate))
        set_(self, "beams", freeze(unit(nonzero_vectors("beams", array("beams", beams, ("beams", 3))))))
        rings("beams", len(self.beams))
        cycles("pulse_rate", self.pulse_rate, self.rate)
        first = Ticks.of(0, self.pulse_rate, self.rate)
        first = replace(first, count=min(first.count, max(1, CHECKED // len(self.beams))))
        self._fire(first, np.empty((first.count * len(self.beams), 3)))

    @property
    def _beams(self) -> int:
        return len(self.beams)

    def _fire(self, ticks: Ticks, directions: Floats) -> None:
        prisms = [
            ((prism.entry_tilt, prism.exit_tilt), ticks.turns(prism.rotation_rate), prism.phase)
            for prism in self.prisms
        ]
        if not _native.fire_risley(self.beams, prisms, self.refractive_index, directions):
            raise ArgumentValueError("prisms", "each face to let the beams through", "total reflection")
