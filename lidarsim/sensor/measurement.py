"""Measurement effects: noise, intensity, detection, returns.

The steps for a pulse are, in order: angular jitter, sub-rays of the beam, cast, intensity, echoes, fluctuation of the
power, detection, drop-out, range noise and biases, false returns, quantisation, range gate, response to intensities,
choice of returns. Misses
stay misses, except for false returns and echoes of the air. The range gate of the `Lidar` applies to the measured
range, noise included, not to the true range.

Random numbers come from Philox4x32-10 (J. K. Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC11, 2011);
Gaussian numbers use the inverse of the normal distribution function (M. J. Wichura, Algorithm AS 241, Applied
Statistics 37, 1988). The generator's key is derived from the seed and the sensor's name; its counter consists of pulse,
frame, effect and draw. The noise of a pulse depends only on these, and not on threads, other pulses or other effects.
The ids of the effects are permanent: 1 angular jitter (draw 0 azimuth, 1 elevation), 2 drop-out, 3 range noise (one
draw per echo, the nearest first), 4 channel bias (frame 0, with the ring in place of the pulse), 5 fluctuation of the
power (one draw per echo, the nearest first), 6 false returns (draw 0 whether there is one, 1 its range), 7 drops and
flakes (draws 3k to 3k + 2 the way to the k-th, its size and its place in the beam), 8 patches of fog (likewise), 9
noise of the intensity (one draw per echo, the nearest first), 10 factors of channels (as 4), 11 soft detection limit
(one draw per echo, the nearest first). Echoes of the air (`Atmosphere`) have the draws from 32768 on of effects 3, 5, 9
and 11: fog, then drops and flakes, then patches of fog. The draw 32767 of effect 9 is for false returns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import explain_arguments
from lidarsim._base.pickling import Immutable
from lidarsim._base.validation import (
    angle,
    array,
    ask_above,
    beam_angle,
    each_ring,
    integer,
    is_several,
    real,
    share,
    short_repr,
)
from lidarsim.errors import ArgumentTypeError, ArgumentValueError

PULSE_LENGTH = 5e-9
"""Default duration of a pulse, full width at half maximum, s."""

ReturnMode = Literal["strongest", "first", "last", "dual"]
Pairs = Sequence[Sequence[float]] | npt.NDArray[np.float64]


@dataclass(frozen=True)
class Detection(Immutable):
    """A detection limit as a datasheet states it: "150 m at 10 %".

    A target of this reflectivity at normal incidence is detected up to this range, and any other target as long as it
    returns at least as much power: an echo of intensity I from range R is kept if I/R² >= ρ/r². Datasheet figures are
    for clear air, so the `extinction` of a `Measurement` weakens the echo but does not lower this threshold: it can
    hide a target, never reveal one.

    With a `sigma` s, the detection limit is soft: each echo is compared with exp(s·g − s²/2) times its power, with a
    standard normal g. The probability of detection then falls gradually with range, as that of real roads does, while
    intensities stay as they are.

    Parameters
    ----------
    reflectivity : float
        ρ, > 0 and <= 1; 0.1 for 10 %.
    range : float
        r, m, > 0.
    sigma : float
        s, standard deviation of the logarithm of the factor; 0 for a sharp limit.

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Detection(reflectivity=0.1, range=150.0)
    Detection(reflectivity=0.1, range=150.0, sigma=0.0)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "reflectivity": float,
        "range_m": float,
        "sigma": float,
    }

    reflectivity: float
    range: float
    sigma: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        object.__setattr__(self, "reflectivity", share("reflectivity", self.reflectivity))
        object.__setattr__(self, "range", real("range", self.range, above=0.0))
        object.__setattr__(self, "sigma", real("sigma", self.sigma, at_least=0.0))


@explain_arguments
@dataclass(frozen=True)
class Beam(Immutable):
    """A diverging beam, sampled by sub-rays over its footprint.

    The profile is an elliptical Gaussian, cut off where its intensity is 1/e² of that on the axis. One sub-ray lies on
    the axis, the others on rings of 6, 12, 18, … around it, or four on one ring; each has the energy of the profile in
    its part of the footprint. Together they form the waveform, the received power over time. The peaks of the waveform
    are the echoes; an echo consists of the sub-rays between the valleys on either side of its peak. The range of an
    echo is the mean over its sub-rays, weighted by received power, I/R²; an echo at an edge therefore lies between the
    two surfaces (a mixed pixel). Its intensity is the sum over its sub-rays, each weighted by its share of the energy.

    Parameters
    ----------
    divergence_azimuth, divergence_elevation : float
        Full angles, horizontal and vertical, between the directions where the intensity is 1/e² of that on the axis,
        0 to 0.1 rad. (The full angle at half maximum is 0.589 times that.) Without the vertical one, the beam is round.
    pulse_length : float
        Duration of the pulse, full width at half maximum, s, > 0 and at most 1 µs.
    rays : int
        Number of sub-rays per pulse: 5, 7, 19, 37, 61 or 91.
    separation : float
        Least distance at which the receiver tells two echoes apart, m, >= 0: of two nearer ones only the stronger is
        an echo, decided from the strongest of the pulse on, by the power in clear air. Default: any two peaks of the
        waveform are told apart.

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range.

    Notes
    -----
    The waveform over range is a sum of Gaussians, one per sub-ray, of standard deviation σ = c/2·`pulse_length`/2.355:
    the usual model of full-waveform lidar (W. Wagner et al., Gaussian decomposition and calibration of a novel
    small-footprint full-waveform digitising airborne laser scanner, ISPRS J. 60, 2006). Two surfaces of equal power are
    resolved if they are more than 2σ apart, 0.64 m at 5 ns; surfaces of unequal power need a greater distance. On a
    slanted surface, the Gaussian of a sub-ray is widened by the spread in range of its part of the footprint. A slanted
    wall therefore gives one echo, as do stairs whose steps are too short to be resolved. As `rays` grows, the number of
    echoes converges to the number of peaks of the waveform.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Beam(3.0e-3, 1.5e-3, pulse_length=6e-9)
    Beam(divergence_azimuth=0.003, divergence_elevation=0.0015, pulse_length=6e-09, rays=19, separation=0.0)
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "divergence_azimuth_mrad": float,
        "divergence_elevation_mrad": float,
        "pulse_length_ns": float,
        "rays": int,
        "separation_m": float,
    }

    divergence_azimuth: float
    divergence_elevation: float | None = None
    pulse_length: float = PULSE_LENGTH
    rays: int = 19
    separation: float = 0.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        elevation = self.divergence_azimuth if self.divergence_elevation is None else self.divergence_elevation
        for name, value in (("divergence_azimuth", self.divergence_azimuth), ("divergence_elevation", elevation)):
            object.__setattr__(self, name, beam_angle(name, value))
        object.__setattr__(self, "pulse_length", real("pulse_length", self.pulse_length, above=0.0, at_most=1e-6))
        object.__setattr__(self, "rays", integer("rays", self.rays))
        if self.rays not in {5, 7, 19, 37, 61, 91}:
            raise ArgumentValueError("rays", "5, 7, 19, 37, 61 or 91", self.rays)
        object.__setattr__(self, "separation", real("separation", self.separation, at_least=0.0))


@dataclass(frozen=True, kw_only=True)
class Response(Immutable):
    """What a sensor reports for an intensity.

    Of an echo of intensity I from range R the sensor reports

        I' = min(`limit`, round(h((I · f(R) · c)^`exponent` · (1 + `sigma`·g·s))))

    with the factor f of `range`, a factor c of the channel, a standard normal g, a standard normal s of the channel and
    block of pulses (`sigma_block`), or 1, and the function h that is the `curve`; a negative 1 + `sigma`·g·s counts as
    0. Detection and range noise depend on I itself.

    Parameters
    ----------
    range : sequence of (range, factor), shape (n, 2), optional
        Factor against range, m: what the vendor's compensation for range leaves, and the drop near the sensor. Linear
        between rows, constant before the first and after the last; the ranges must increase. Default: 1.
    exponent : float
        Exponent, > 0: below 1, the sensor compresses intensities.
    sigma : float
        Relative standard deviation, from echo to echo.
    sigma_block : int
        Consecutive pulses of a frame, >= 0, in which the noise of a channel is equally strong: s is drawn once for each
        channel and block. 20 columns of 64 channels are 1280 pulses. 0: s is 1.
    ring_sigma : float
        Standard deviation of the logarithm of c, the factor of a channel (ring), of mean 1. It depends on the seed, the
        sensor's name and the ring, and is the same in all frames.
    curve : sequence of (intensity, reported), shape (n, 2), optional
        h, the transfer curve. Velodyne's is [(0, 0), (1, 100/255), (785, 1)]: up to 100 of 255 counts for diffuse
        targets, the rest for retro-reflectors. Linear between rows, constant before the first and after the last; both
        numbers must increase. Default: the intensity itself.
    resolution : float
        Quantisation step, halves rounded to even; 0 for none. 1/255 for bytes, with 1 for 255.
    limit : float
        Largest intensity that is reported, > 0.

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range, or those of a table do not increase.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Response(range=[(1, 0.3), (5, 1)], sigma=0.02, resolution=1 / 255, limit=1.0).range
    ((1.0, 0.3), (5.0, 1.0))
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "range_m": list[tuple[float, float]],
        "exponent": float,
        "sigma": float,
        "sigma_block": int,
        "ring_sigma": float,
        "curve": list[tuple[float, float]],
        "resolution": float,
        "limit": float,
    }

    range: Pairs | None = None
    exponent: float = 1.0
    sigma: float = 0.0
    sigma_block: int = 0
    ring_sigma: float = 0.0
    curve: Pairs | None = None
    resolution: float = 0.0
    limit: float = math.inf

    def __post_init__(self) -> None:
        """Check the arguments."""
        if self.range is not None:
            object.__setattr__(self, "range", _table("range", self.range, "factor"))
        if self.curve is not None:
            object.__setattr__(self, "curve", _table("curve", self.curve, "reported", at="intensity", columns=2))
        for name in ("sigma", "ring_sigma", "resolution"):
            object.__setattr__(self, name, real(name, getattr(self, name), at_least=0.0))
        object.__setattr__(self, "sigma_block", integer("sigma_block", self.sigma_block, at_least=0))
        object.__setattr__(self, "exponent", real("exponent", self.exponent, above=0.0))
        object.__setattr__(self, "limit", real("limit", self.limit, above=0.0, infinite=True))


@explain_arguments
@dataclass(frozen=True, kw_only=True, repr=False)
class Measurement(Immutable):
    """How a sensor measures what its pulses hit. Every effect is off by default.

    Parameters
    ----------
    range_sigma : float or sequence of (range, sigma), shape (n, 2)
        Standard deviation of the range, m: a in √(a² + (b·R)²). Or a table of it over range, both in m, as in
        datasheets: linear between rows, constant before the first and after the last; the ranges must increase.
    range_sigma_slope : float
        b in √(a² + (b·R)²), m per m: the part that is proportional to range.
    range_sigma_limit : float
        c, m: the additional standard deviation of weak echoes, √(a² + (b·R)² + c²/s); it also adds to a table. s is the
        received power relative to the detection limit, so an echo at the limit has c, and one four times as strong has
        c/2. It requires `detection`, which sets the limit.
    range_bias : float or sequence of float, one per ring
        Bias that is added to every range, or to those of each channel (ring), m; may be negative.
    channel_bias_sigma : float
        Standard deviation of a further range bias of each channel, m. It depends on the seed, the sensor's name
        and the ring, and is the same in all frames. Together with `range_bias` it models what datasheets call
        accuracy; `range_sigma` models what they call precision or repeatability.
    range_resolution : float
        Quantisation step of the reported range, m, halves rounded to even; 0 for none. The reported range is the
        measured range plus the `range_offset` of the `Lidar`.
    azimuth_sigma, elevation_sigma : float
        Standard deviations of the angles by which a pulse deviates from its nominal direction, 0 to 1 rad. Points are
        still computed from the nominal direction; `Scan.true_points` returns the points that the pulses actually hit.
    dropout : float
        Probability that a pulse is lost, 0 to 1.
    detection : Detection, optional
        Detection limit. Default: every echo is detected.
    power_sigma : float
        w, standard deviation of the logarithm of the received power of an echo: power and intensity are multiplied by
        exp(w·g − w²/2), with a standard normal g, which keeps their means. With a `detection` limit, the probability of
        detection then falls gradually with range, as with its `sigma`; without one, only intensities fluctuate.
    crossover : tuple of float, (near, far), optional
        Ranges at which the beam enters the receiver's field of view and lies completely inside it, m, 0 <= near < far.
        The intensity is multiplied by the overlap, which is 0 up to `near`, linear in between and 1 from `far` on. Only
        a `detection` limit or a `near_threshold` hides echoes that become too weak. Default: the overlap is 1
        everywhere.
    receiver_offset : float
        Distance of the receiver to the left of the emitter, seen along the pulse, m; negative: to the right; 0 for a
        coaxial sensor. What other surfaces hide from the receiver is a miss. See the notes.
    near_threshold : float
        i, least intensity that is detected near the sensor, 0 to 1; 0 for none. See the notes.
    near_range : float
        n, range up to which it holds, m, > 0.
    extinction : float
        Extinction coefficient α of the atmosphere, 1/m: an echo is weakened by the factor exp(−2αR). The
        extinction of the scene's `Atmosphere` is added.
    false_returns : float
        Probability that a pulse has one more return, without a surface, 0 to 1. Its range is uniform over the range
        gate of the `Lidar`, which must have a `max_range`, and is quantised. It is the weakest echo of its pulse: it
        counts for `returns` "first", "last" or a number, and is the "strongest" only if no other echo is detected. Its
        intensity is that of the detection limit at its range, or 0 without one. Dropped pulses have none.
        `Scan.source` marks false returns.
    beam : Beam, optional
        Diverging beam. Default: none; each pulse is a single ray.
    returns : {"strongest", "first", "last", "dual"} or int
        Which echoes of a pulse are reported. "dual": the strongest and the last or, if these are the same echo, the two
        strongest. A number up to 255: at most that many, the nearest first. Echoes are in order of their ranges before
        errors. Without a `beam`, and with a `depth` of 1, a pulse has one echo, so that "dual" and numbers report one
        return, too.
    depth : int
        The most surfaces that light meets one after another, 1 to 255. With 1, each ray ends at the first surface. With
        more, light goes on from surfaces whose `Material` has a `transmission` or a `mirror`. See the notes.
    response : Response, optional
        What the sensor reports for an intensity. Default: the intensity itself.

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type or out of its range.

    Notes
    -----
    Intensity is I = ρ·f(θ)·ξ(R)·exp(−2αR), with reflectivity ρ, angle of incidence θ and overlap ξ: 1 for a white
    diffuser at normal incidence. f(θ) is cos θ, unless the `Material` says otherwise. Intensity is not divided by R²,
    since sensors report intensity corrected for range; the power that decides detection is I/R², as in the lidar
    equation for targets larger than the beam (A. V. Jelalian, Laser Radar Systems, Artech House, 1992).

    Near the sensor, real receivers are far less sensitive than their limit far off: they are desensitised after each
    pulse, and their gain rises with time. With a `near_threshold` i, an echo is kept only if I/R² is at least the
    greater of the limit ρ/r² of the `detection` and i/R²·min(1, (n/R)²), which falls with R² up to the `near_range` n
    and with R⁴ from there on. (Without a `detection`, the latter holds where it is above the limit of the reflectivity
    0.1 at the `max_range` of the `Lidar`.) Which echo of a pulse is the strongest, and how much of `range_sigma_limit`
    it has, depends on its power relative to this threshold. Without it, fog, rain and snow outshine all surfaces: a
    scan in fog is then refused, unless there is a `crossover` (`Atmosphere`).

    The receiver of a biaxial sensor stands beside the emitter. Beyond an edge of a nearer surface, on one side of it,
    the beam lights what that surface hides from the receiver: with an offset b, a strip b·(1/near - 1/far) rad wide. A
    VLP-16 loses it (lidarsim/presets/README.md). A surface is hidden if an opaque one meets the segment from the
    receiver to it, more than |b| before its end; light does not go on from it then, either.

    With a `depth` of more than 1, a surface with shares T transmitted and M mirrored sends on T of the light straight
    ahead and M in the mirrored direction. Each surface further on returns light as any does, from the range that is the
    length of the whole way, and along the pulse as it was fired: what is seen in a mirror is a ghost behind it. Light
    takes the same way out and back, so that its power and intensity are multiplied by T² or M² for each surface before.
    ξ, extinction and 1/R² are those of the length of the way, θ is the incidence at the surface that is met. Without a
    `beam`, each surface is an echo of its own; with one, all are part of one waveform.

    Straight on, the next surface is the next hit of the same ray in the order of `Scene.cast_all`, exactly. From a
    mirror, the ray starts at the point p = o + t·d and has the direction d - (2·(d·n)/(n·n))·n, with t and n of the hit
    as `Scene.cast` returns them, each evaluated in float64 once; its hits are exact for these numbers. The mirror, and
    what coincides with it at that point, are left out: of a curved surface the crossing nearest to p, of a flat one all
    crossings. Where ways branch, the 16 of the greatest share are followed from each depth to the next, for each ray.

    Examples
    --------
    >>> import lidarsim as ls
    >>> noisy = ls.Measurement(range_sigma=0.02, dropout=0.01, detection=ls.Detection(0.1, 100.0))
    >>> table = ls.Measurement(range_sigma=[(0.1, 0.01), (10.0, 0.01), (30.0, 0.03)])
    """

    configuration: ClassVar[Mapping[str, object]] = {
        "range_sigma_m": float | list[tuple[float, float]],
        "range_sigma_slope": float,
        "range_sigma_limit_m": float,
        "range_bias_m": float | list[float],
        "channel_bias_sigma_m": float,
        "range_resolution_m": float,
        "azimuth_sigma_deg": float,
        "elevation_sigma_deg": float,
        "dropout": float,
        "detection": Detection,
        "power_sigma": float,
        "crossover_m": tuple[float, float],
        "receiver_offset_mm": float,
        "near_threshold": float,
        "near_range_m": float,
        "extinction_per_m": float,
        "false_returns": float,
        "beam": Beam,
        "returns": int | str,
        "depth": int,
        "response": Response,
    }

    range_sigma: float | Pairs = 0.0
    range_sigma_slope: float = 0.0
    range_sigma_limit: float = 0.0
    range_bias: float | Sequence[float] = 0.0
    channel_bias_sigma: float = 0.0
    range_resolution: float = 0.0
    azimuth_sigma: float = 0.0
    elevation_sigma: float = 0.0
    dropout: float = 0.0
    detection: Detection | None = None
    power_sigma: float = 0.0
    crossover: tuple[float, float] | None = None
    receiver_offset: float = 0.0
    near_threshold: float = 0.0
    near_range: float = 20.0
    extinction: float = 0.0
    false_returns: float = 0.0
    beam: Beam | None = None
    returns: ReturnMode | int = "strongest"
    depth: int = 1
    response: Response | None = None

    def __post_init__(self) -> None:
        """Check the arguments."""
        is_table = is_several(self.range_sigma)
        for name, at_most in _NUMBERS.items():
            if not (name == "range_sigma" and is_table):
                number = angle if name in {"azimuth_sigma", "elevation_sigma"} else real
                object.__setattr__(self, name, number(name, getattr(self, name), at_least=0.0, at_most=at_most))
        object.__setattr__(self, "receiver_offset", real("receiver_offset", self.receiver_offset))
        object.__setattr__(self, "near_range", real("near_range", self.near_range, above=0.0))
        object.__setattr__(self, "range_bias", each_ring("range_bias", self.range_bias))
        if is_table:
            object.__setattr__(self, "range_sigma", _sigma_table(self.range_sigma, self.range_sigma_slope))
        if self.detection is not None and not isinstance(self.detection, Detection):
            raise ArgumentTypeError("detection", "a Detection or None", short_repr(self.detection))
        if self.range_sigma_limit > 0.0 and self.detection is None:
            given = self.range_sigma_limit
            raise ArgumentValueError("range_sigma_limit", "0 without a detection limit", given, "give `detection`")
        if self.crossover is not None:
            object.__setattr__(self, "crossover", _crossover(self.crossover))
        if self.beam is not None and not isinstance(self.beam, Beam):
            raise ArgumentTypeError("beam", "a Beam or None", short_repr(self.beam))
        if self.response is not None and not isinstance(self.response, Response):
            raise ArgumentTypeError("response", "a Response or None", short_repr(self.response))
        object.__setattr__(self, "depth", integer("depth", self.depth, at_least=1, at_most=255))
        object.__setattr__(self, "returns", _returns(self.returns))
        for name, (most, unit, question) in _USUAL.items():
            values = getattr(self, name)
            if name == "range_sigma" and is_table:
                values = np.array(values)[:, 1]
            ask_above(name, values, most, unit, question)

    @property
    def max_returns(self) -> int:
        """Maximum number of returns of a pulse: int; 1 of a single ray whose light does not go on."""
        if self.beam is None and self.depth == 1:
            return 1
        return self.returns if isinstance(self.returns, int) else 2 if self.returns == "dual" else 1


_USUAL = {
    **dict.fromkeys(
        ("range_sigma", "range_sigma_limit", "range_bias", "channel_bias_sigma", "range_resolution", "receiver_offset"),
        (1.0, "m", "mm?"),
    ),
    **dict.fromkeys(("azimuth_sigma", "elevation_sigma"), (0.02, "rad", "degrees?")),
}
"""Largest usual error, its unit, and the question about a larger one, by name."""

_NUMBERS = {
    "range_sigma": math.inf,
    "range_sigma_slope": math.inf,
    "range_sigma_limit": math.inf,
    "channel_bias_sigma": math.inf,
    "range_resolution": math.inf,
    "azimuth_sigma": 1.0,
    "elevation_sigma": 1.0,
    "dropout": 1.0,
    "power_sigma": math.inf,
    "near_threshold": 1.0,
    "extinction": math.inf,
    "false_returns": 1.0,
}
"""Parameters that are numbers >= 0, with the upper bound of each."""


def _sigma_table(rows: object, slope: object) -> tuple[tuple[float, float], ...]:
    table = _table("range_sigma", rows, "sigma")
    if slope != 0.0:
        raise ArgumentValueError("range_sigma_slope", "0 with a table of range_sigma", repr(slope))
    return table


def _table(
    name: str, rows: object, value: str, *, at: str = "range", columns: int = 1
) -> tuple[tuple[float, float], ...]:
    """Return the checked rows (`at`, `value`) of an argument; its first `columns` columns must rise."""
    table = array(name, rows, ("n", 2))
    if len(table) < columns:
        raise ArgumentValueError(name, f"{columns} or more rows ({at}, {value})", len(table))
    if (table < 0.0).any():
        i, j = np.argwhere(table < 0.0)[0]
        raise ArgumentValueError(name, "numbers >= 0", f"{name}[{i}][{j}] = {table[i, j]}")
    falling = np.diff(table[:, :columns], axis=0) <= 0.0
    if falling.any():
        i, j = np.argwhere(falling)[0]
        expected = "rising ranges" if at == "range" else "rising intensities"
        raise ArgumentValueError(name, expected, f"{table[i + 1, j]} after {table[i, j]} in row {i + 1}")
    return tuple((float(x), float(number)) for x, number in table)


def _crossover(value: object) -> tuple[float, float]:
    near, far = array("crossover", value, (2,)).tolist()
    if not 0.0 <= near < far:
        raise ArgumentValueError("crossover", "0 <= near < far", f"{near} and {far}")
    return near, far


def _returns(value: object) -> ReturnMode | int:
    names = get_args(ReturnMode)
    if not isinstance(value, str):
        return integer("returns", value, at_least=1, at_most=255)
    if value not in names:
        raise ArgumentValueError("returns", f"{', '.join(map(repr, names))} or a number", repr(value))
    return value  # type: ignore[return-value]
