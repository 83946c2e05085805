"""Estimates of the parameters of a sensor, each with an interval, or why there is none.

Each function marked by `value` estimates one parameter from the sums of a `Fit`, or raises `UntoldError` with the
reason why the frames do not tell it. Later estimates use earlier ones: they are made in the order of this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from lidarsim._base.shown import quantity
from lidarsim._base.validation import Floats
from lidarsim.comparison._captures import (
    APPROACHES,
    BY_RANGE,
    FEWEST_STEPS,
    NEAR_FIELD,
    POWERS,
    Captures,
    UntoldError,
)
from lidarsim.comparison._measures import STATISTICS, STEPS
from lidarsim.comparison._result import Interval
from lidarsim.comparison._statistics import FEWEST_UNITS, Indices, critical
from lidarsim.sensor.measurement import Detection, Measurement, Response

FEWEST_POINTS = 1000
"""Fewest points of all frames that are fitted."""
FEWEST = 300
"""Fewest samples of a value."""
FEWEST_OF_RING = 50.0
"""Fewest points that tell the number of a ring."""
FAINT = 6.0
"""Standard deviations of the logarithm of the power above the detection limit from which each pulse is detected: 3.7
for 1 in 10,000, and the rest for the neighbours that tell the power."""
VAGUE = math.log(4.0)
"""Greatest reach of the interval of the logarithm of the power at the limit: half or twice the range of the limit."""
EDGES = 20
"""Surfaces cut off by the least range that tell it."""
RETURNING = 0.97
"""Share of the pulses that are not dropped from which the intensities of the ground are those of all its echoes."""


@dataclass(frozen=True)
class Found:
    """A value that the frames tell.

    Attributes
    ----------
    value : float, or tuple of (range, value)
        The value, or a table.
    interval : tuple of float
        Its 95 % interval; of a table that of its mean.
    count : int
        Number of samples.
    how : str
        What it rests on.
    rows : tuple of (label, value, low, high, count)
        Its parts: rows of a table, or rings.
    changes : dict
        Parameters of the measurement that the value replaces, or that take its place.
    """

    value: float | tuple[tuple[float, float], ...]
    interval: Interval
    count: int
    how: str
    rows: tuple[tuple[str, float, float, float, int], ...] = ()
    changes: dict[str, Any] = field(default_factory=dict)

    @property
    def mean(self) -> float:
        """The value, or the mean of a table, weighted by its samples."""
        if isinstance(self.value, float):
            return self.value
        return float(np.average([row[1] for row in self.rows], weights=[row[4] for row in self.rows]))


VALUES: dict[str, tuple[str, Callable[[Fit], Found]]] = {}
"""Unit and estimator of each value by its name: attributes of the `Measurement` or the `Lidar`, with dots between."""


def value(name: str, unit: str = "1") -> Callable[[Callable[[Fit], Found]], Callable[[Fit], Found]]:
    """Register an estimator."""

    def register(function: Callable[[Fit], Found]) -> Callable[[Fit], Found]:
        VALUES[name] = unit, function
        return function

    return register


class Fit(Captures):
    """The sums over the frames, and the sensor with the values found so far."""

    @property
    def ground_rate(self) -> float:
        """Greatest share of the pulses that the ground returns at a range; 0 if none is known."""
        found = self.estimate("ground by range")
        return float(found.value[found.has(100)].max(initial=0.0))

    @cached_property
    def fade(self) -> Fade:
        """How returns from the ground fade."""
        return _fade(self)


def _ends(center: float, error: float, units: float) -> Interval:
    """Return the interval of a value with its standard error from so many units."""
    reach = float(critical(1, np.array(units))) * error
    return max(float(center - reach), 0.0), float(center + reach)


@value("range_resolution", "m")
def _range_resolution(fit: Fit) -> Found:
    """Greatest step, of those looked for, of which all ranges are multiples."""
    steps = fit.estimate("step")
    step = float(np.nanmax(steps.value))
    if not step:
        low, high = 1e3 * STEPS[0], 1e3 * STEPS[-1]
        raise UntoldError(f"ranges are no multiples of a common step from {low:g} to {high:g} mm")
    return Found(step, (step, step), int(steps.count[0]), "all ranges are multiples of it")


@value("range_sigma", "m")
def _range_sigma(fit: Fit) -> Found:
    """Noise of the range within a ring on planes, from third differences of 1/range, less the rounding of the range.

    That of the sensor times a number where all ranges agree to chance, else a table by range.
    """
    found, at = fit.estimate("noise"), fit.estimate("noise at").value
    rounding = fit.lidar.measurement.range_resolution
    with np.errstate(invalid="ignore"):
        square = found.value**2 - rounding**2 / 12.0
        told = found.has(FEWEST) & (square > (0.3 * rounding) ** 2)
    if not told.any():
        hidden = f"the rounding to {1e3 * rounding:g} mm hides it"
        raise UntoldError(hidden if found.has(FEWEST).any() else f"fewer than {FEWEST} samples on planes")
    sigma, n, at, units = np.sqrt(square[told]), found.count[told], at[told], found.units[told]
    error = np.maximum(found.error[told] * found.value[told] / sigma, 1e-9)  # 1 nm, which no range resolves
    errors = fit.lidar.measurement
    whole = not errors.range_sigma_limit  # else the sensor's table lacks the noise of weak echoes
    was = _noise_at(errors, at) if whole else np.ones(len(at))
    # Errors of noise are shares of it, so that its mean is that of the logarithms.
    factors, shares = np.log(sigma / was), error / sigma
    mean = float(np.average(factors, weights=shares**-2))
    times = _ends(1.0, float((shares**-2).sum() ** -0.5), float(np.median(units)))
    how, total = "noise of all surfaces, weak echoes included, in place of other terms", int(n.sum())
    changes = {"range_sigma_slope": 0.0, "range_sigma_limit": 0.0}
    table = np.array(errors.range_sigma) if whole and isinstance(errors.range_sigma, tuple) else np.zeros((0, 2))
    rows: list[tuple[float, float, float, float, int]]
    if not _agree(factors, shares, mean):
        how = f"{how}; by range"
        ends = [_ends(*each) for each in zip(sigma, error, units, strict=True)]
        likely = was * np.exp(_draw_to(mean, factors, shares))
        rows = [*zip(at, likely, *np.transpose(ends), n, strict=True)]
        # Where the frames have no planes, the noise goes on as that of the sensor does.
        for end, row, beyond in ((0, rows[0], table[:, 0] < 0.98 * at[0]), (-1, rows[-1], table[:, 0] > 1.02 * at[-1])):
            value, low, high = (number / was[end] for number in row[1:4])
            rows += [(place, one * value, one * low, one * high, 0) for place, one in table[beyond]]
        average = float(np.average(likely, weights=n))
        interval = _ends(average, float(np.sqrt(((n / n.sum() * error) ** 2).sum())), float(np.median(units)))
    else:
        how = f"{how}; all ranges agree"
        if not len(table):
            slope = errors.range_sigma_slope * whole
            one = math.exp(mean) * (float(np.max(errors.range_sigma)) or float(not slope) if whole else 1.0)
            changes["range_sigma_slope"] = float(f"{math.exp(mean) * slope:.3g}")
            return Found(one, (times[0] * one, times[1] * one), total, how, changes=changes)
        table[:, 1] *= math.exp(mean)
        rows = [(place, one, times[0] * one, times[1] * one, total) for place, one in table]
        average = float(table[:, 1].mean())
        interval = times[0] * average, times[1] * average
    rows = [(float(place), float(one), float(low), float(high), int(count)) for place, one, low, high, count in rows]
    parts = tuple((f"{row[0]:.3g} m", *row[1:]) for row in sorted(rows))
    return Found(tuple(row[:2] for row in sorted(rows)), interval, total, how, parts, changes)


def _noise_at(errors: Measurement, ranges: Floats) -> Floats:
    """Return the noise of strong echoes at some ranges, m; 1 m for none."""
    table = errors.range_sigma
    noise = np.interp(ranges, *np.transpose(table)) if isinstance(table, tuple) else np.full(ranges.shape, table)
    noise = np.hypot(noise, errors.range_sigma_slope * ranges)
    return np.where(noise > 0.0, noise, 1.0)


def _draw_to(mean: float, values: Floats, errors: Floats) -> Floats:
    """Draw values that scatter about a mean by more than their errors towards it, to the most likely ones.

    Their spread is that of R. DerSimonian and N. Laird, Controlled Clinical Trials 7, 1986.
    """
    weight = errors**-2
    excess = (weight * (values - mean) ** 2).sum() - len(values) + 1.0
    square = max(excess / (weight.sum() - (weight**2).sum() / weight.sum()), 0.0)
    likely: Floats = mean + square / (square + errors**2) * (values - mean)
    return likely


def _agree(values: Floats, errors: Floats, mean: float) -> bool:
    """Return whether values are one number to chance: by their sum of squares, at the level of 5 %."""
    from scipy.special import chdtrc

    return len(values) < 2 or bool(chdtrc(len(values) - 1, (((values - mean) / errors) ** 2).sum()) > 0.05)


@value("channel_bias_sigma", "m")
def _channel_bias(fit: Fit) -> Found:
    """How much rings are biased: standard deviation of their deviations from planes over several rings, less errors.

    Biases that a plane follows, equal ones and those linear in the elevation of neighbouring rings, do not show. If the
    rings differ, each gets its own deviation as `range_bias`, in place of one that is drawn, less the share of it that
    is error, to which rough and curved surfaces add.
    """
    found, rings, likely = _ring_spread(fit, "bias", "deviations of rings from planes", 1.5)
    if not found.interval[0]:
        return found
    biases = np.full(fit.lidar.pattern.shape[0], np.mean(fit.lidar.measurement.range_bias))
    biases[rings] += likely
    own = tuple(float(f"{bias:.4g}") for bias in biases)
    how = f"{found.how}, which are their range_bias in its place"
    return replace(found, how=how, changes={"range_bias": own, "channel_bias_sigma": 0.0})


def _ring_spread(fit: Fit, name: str, how: str, fewest: float) -> tuple[Found, Indices, Floats]:
    """Return the standard deviation between rings of numbers that lack what is linear within the rows of a tile.

    The numbers solve the normal equations by least squares, restricted to the eigenvectors that enough points determine
    in more than `fewest` equal blocks of columns. A block is one unit over all frames, which may see the same walls.
    The arrays have the ring of each row, and its most likely number.
    """
    from scipy.special import chdtri

    units = fit.equations[name]
    count, right, matrix = units[..., 0], units[..., 1], units[..., 2:]
    if not count.any():
        raise UntoldError(fit.reason(name))
    weights, vectors = np.linalg.eigh(matrix.sum(axis=0))
    squares = (np.einsum("ik,uij,jk->uk", vectors, matrix, vectors, optimize=True) ** 2).sum(axis=0)
    told = (weights > FEWEST_OF_RING) & (weights**2 > fewest * squares)
    freedom = int(np.count_nonzero(told))
    if freedom < 4:
        raise UntoldError("fewer than 4 rings more than planes over them need have 50 points on planes")
    inverse = vectors[:, told] / weights[told] @ vectors[:, told].T
    numbers = inverse @ right.sum(axis=0)
    # Of units: what each adds to the solution (P. J. Huber, Proc. 5th Berkeley Symposium, 1967).
    adds = (right - matrix @ numbers) @ inverse
    noise = float((adds**2).sum()) * len(units) / (len(units) - 1.0)
    each = noise / freedom
    square = float(numbers @ numbers)
    low, value, high = (
        math.sqrt(max(square / float(by) - each, 0.0))
        for by in (chdtri(freedom, 0.025), freedom, chdtri(freedom, 0.975))
    )
    if not high:
        raise UntoldError("the errors of the rings hide it")
    rings = np.flatnonzero(matrix.sum(axis=0).diagonal() > FEWEST_OF_RING)
    reach = critical(1, np.array(float(len(units)))) * np.sqrt(noise * inverse.diagonal() / np.trace(inverse))
    ends = zip(rings, numbers[rings], reach[rings], count.sum(axis=0)[rings], strict=True)
    rows = tuple((f"ring {i}", float(at), float(at - by), float(at + by), int(n)) for i, at, by, n in ends)
    # Of normal numbers with this spread, the most likely ones: each component less the share of errors in its variance.
    errors = noise / weights[told] / np.trace(inverse)
    likely = vectors[:, told] * (value**2 / (value**2 + errors)) @ vectors[:, told].T @ numbers
    how = f"{how}, {quantity(len(rows), 'ring')}"
    return Found(value, (low, high), int(count.sum()), how, rows), rings, likely[rings]


@value("response.resolution")
def _intensity_step(fit: Fit) -> Found:
    """Step of which all intensities are multiples."""
    count = _count_intensities(fit)
    step = fit.step_of_intensity
    if not step:
        raise UntoldError("intensities are no multiples of a common step")
    return Found(step, (step, step), count, f"{len(fit.levels)} different intensities are multiples of it")


@value("response.limit")
def _intensity_limit(fit: Fit) -> Found:
    """Greatest intensity, if more than three times as many points have it as any in the tenth below it."""
    count = _count_intensities(fit)
    most = float(fit.levels[-1])
    at, above = fit.light(np.array([most, most + fit.step_of_intensity]))
    if most > fit.brightest and above > (1.0 + 1.0 / FEWEST_STEPS) * at:
        raise UntoldError("the curve is flat there, so that intensities pile up")
    top = fit.level_counts[-1]
    below = fit.level_counts[:-1][fit.levels[:-1] > 0.9 * most].max(initial=0)
    if top < 20 or top <= 3 * below:
        raise UntoldError("no intensities pile up at the greatest")
    return Found(most, (most, most), count, f"{top:,} points have it")


def _count_intensities(fit: Fit) -> int:
    """Return the number of intensities, or raise the reason why they tell nothing."""
    if "intensity" in fit.missing:
        raise UntoldError("the clouds have no intensity")
    if fit.levels[-1] == 0.0:
        raise UntoldError("all intensities are 0")
    return int(fit.level_counts.sum())


@value("detection.range", "m")
def _detection(fit: Fit) -> Found:
    """Range of the detection limit, at its reflectivity, from the share of the pulses that the ground returns."""
    fade = fit.fade
    reflectivity = (fit.lidar.measurement.detection or Detection(0.1, 1.0)).reflectivity
    at, high, low = (math.sqrt(reflectivity) * math.exp(-0.5 * limit) for limit in (fade.limit, *fade.limit_interval))
    return Found(at, (low, high), fade.count, f"for a reflectivity of {reflectivity:g}; {fade.how}")


@value("detection.sigma")
def _softness(fit: Fit) -> Found:
    """Softness of the detection limit, from how gradually returns from the ground fade with range.

    Patches and markings of the ground soften it, too.
    """
    fade = fit.fade
    return Found(fade.sigma, fade.sigma_interval, fade.count, fade.how)


@value("power_sigma")
def _power_sigma(_: Fit) -> Found:
    """Scatter of the logarithm of the power."""
    raise UntoldError("what fades softly is detection.sigma, and what flickers response.sigma")


@value("dropout")
def _dropout(fit: Fit) -> Found:
    """Share of the pulses without a return between four neighbours that agree, where echoes are far above the limit.

    Only beyond a metre, and only if that share is the same at all ranges: to chance, and to what `compare` neglects.
    """
    from scipy.special import betaincinv

    errors = fit.lidar.measurement
    detection = errors.detection or Detection(0.1, 30.0)  # any lidar sees as far
    limit = math.log(detection.reflectivity / detection.range**2)
    width = math.hypot(errors.power_sigma, detection.sigma)
    bright = limit + 0.5 * width**2 + max(FAINT * width, 0.5)
    enough = bright < POWERS
    if not len(fit.units["holes"]):
        raise UntoldError(fit.reason("holes"))
    if len(fit.units["ground by range"]) and fit.ground_rate < 0.8:
        raise UntoldError("the ground does not return most pulses, so that the detection limit is not known")
    sums = fit.units["holes"].sums(BY_RANGE * len(POWERS)).reshape(-1, BY_RANGE, len(POWERS), 3)
    sums = sums[:, :, enough, 1:].sum(axis=2)
    cells = np.flatnonzero(sums[..., 0].sum(axis=0) >= FEWEST)
    sums = sums[:, cells]
    if len(cells) < 2 or sums[..., 0].sum() < FEWEST_POINTS:
        raise UntoldError(
            f"too few pulses at smooth surfaces at several ranges beyond {NEAR_FIELD:g} m "
            "whose echoes are far above the detection limit"
        )
    _check_constant(cells, *sums.sum(axis=0).T)
    n, lost = sums.sum(axis=1).T
    share = lost.sum() / n.sum()
    # Of blocks: the linearised variance of a ratio (W. G. Cochran, Sampling Techniques, Wiley, 1977, 2.11).
    units = np.count_nonzero(n)
    square = units / (units - 1.0) * ((lost - share * n) ** 2).sum() / n.sum() ** 2 if units > 1 else math.inf
    alike = min(n.sum(), share * (1.0 - share) / square) if share and square else n.sum()
    low, high = (
        float(betaincinv(share * alike + up, alike - share * alike + 1 - up, level)) if share or up else 0.0
        for up, level in ((0, 0.025), (1, 0.975))
    )
    return Found(float(share), (low, high), int(n.sum()), "pulses lost within smooth rings")


def _check_constant(cells: Indices, count: Floats, lost: Floats) -> None:
    """Raise an error if the share of lost pulses depends on range, beyond chance and what `compare` neglects."""
    holes = STATISTICS["holes in smooth rings"]
    rates, share = lost / count, (lost.sum() + 0.5) / (count.sum() + 1.0)
    apart = np.maximum(np.abs(rates - share) - holes.least, 0.0)
    if not _agree(apart, np.sqrt(share * (1.0 - share) / count), 0.0):
        ends = (f"{rates[i]:.2g} at {holes.cells.label(int(cells[i]))}" for i in (rates.argmax(), rates.argmin()))
        raise UntoldError(f"the share of lost pulses depends on range: {', '.join(ends)}")


@value("response.ring_sigma")
def _ring_factors(fit: Fit) -> Found:
    """How much the factors of rings scatter: standard deviation of their logarithms, from intensities on planes."""
    _count_intensities(fit)
    # Unlike ranges on planes, intensities have textures, which are alike in one block.
    found, *_ = _ring_spread(fit, "brightness", "intensities of rings on planes", FEWEST_UNITS)
    response = fit.lidar.measurement.response or Response()
    scale = 1.0 / response.exponent
    low, high = found.interval
    return replace(
        found,
        value=scale * found.mean if isinstance(found.value, float) else found.value,
        interval=(scale * low, scale * high),
    )


@value("response.sigma")
def _flicker(fit: Fit) -> Found:
    """Relative standard deviation of intensities from frame to frame, where the sensor stands still.

    Scatter along a ring is not told from the texture of surfaces. What `power_sigma` makes is subtracted.
    """
    _count_intensities(fit)
    found, rounding = fit.estimate("flicker"), fit.estimate("rounding")
    if not found.has(FEWEST)[0]:
        raise UntoldError("too few points have the intensity and the place of the frame before")
    errors = fit.lidar.measurement
    response = errors.response or Response()
    if response.sigma_block:
        raise UntoldError("it is stronger in some blocks of pulses than in others")
    exponent = response.exponent
    rounding_part = fit.step_of_intensity**2 / 12.0 * float(rounding.value[0])
    square, error = float(found.value[0] ** 2) - rounding_part, float(2.0 * found.value[0] * found.error[0])
    # Squares of two differences that share a frame are correlated by 1/4.
    shared = 1.5 - 0.5 / (fit.frames - 1.0)
    reach = float(critical(1, found.units)[0]) * error * math.sqrt(shared)
    low, at, high = (max(square + by - (exponent * errors.power_sigma) ** 2, 0.0) ** 0.5 for by in (-reach, 0.0, reach))
    if not low and errors.power_sigma:
        raise UntoldError(f"the fluctuation of the power, {errors.power_sigma:.2g}, hides it")
    if not high:
        raise UntoldError("the rounding of intensities hides it")
    # In its middle 80 %, ln(1 + s·g) scatters like a normal number of standard deviation s·(1 + 0.37 s²).
    at, low, high = (each / (1.0 + 0.37 * each**2) for each in (at, low, high))
    return Found(at, (low, high), int(found.count[0]), "differences from frame to frame")


@value("response.range")
def _factors(fit: Fit) -> Found:
    """Factor of intensities by range, from the ground, where all its echoes are detected."""
    _count_intensities(fit)
    if not fit.known_ground:
        raise UntoldError("it is not told from the reflectivity of surfaces; the argument ground gives that of one")
    rates, found = fit.estimate("ground by range"), fit.estimate("factor")
    sums = fit.units["factor"].sums(BY_RANGE).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        bright = sums[:, 2] / sums[:, 0]
        told = (rates.value > RETURNING * (1.0 - fit.lidar.measurement.dropout)) & found.has(FEWEST)
        told &= bright > fit.light(np.array(FEWEST_STEPS * fit.step_of_intensity))
    if not told.any():
        raise UntoldError(f"nowhere {FEWEST} pulses or more meet the ground and all return")
    response = fit.lidar.measurement.response or Response()
    # Few rings see the ground at a range, and each has a factor of its own.
    rings = np.maximum(fit.ground_rings.sum(axis=1), 1)
    error = np.hypot(found.error, found.value * response.ring_sigma / np.sqrt(rings))
    at = fit.estimate("factor at").value
    table, rows = [], []
    for i in np.flatnonzero(told):
        table.append((float(at[i]), float(found.value[i])))
        ends = _ends(found.value[i], error[i], min(found.units[i], max(rings[i], 2.0)))
        rows.append((f"{at[i]:.3g} m", float(found.value[i]), *ends, int(found.count[i])))
    weight = found.count[told] / found.count[told].sum()
    interval = _ends(float(weight @ found.value[told]), float(np.sqrt(((weight * error[told]) ** 2).sum())), 16.0)
    return Found(tuple(table), interval, int(found.count[told].sum()), "from the ground given", tuple(rows))


@value("response.exponent")
def _exponent(_: Fit) -> Found:
    """Exponent of the response to intensities."""
    raise UntoldError("this takes targets of known reflectivities")


@value("min_range", "m")
def _min_range(fit: Fit) -> Found:
    """Least range: that at which surfaces end that come nearer along a ring, if they end at the same range."""
    if len(fit.cuts) < EDGES:
        raise UntoldError("no surfaces come so near")
    first, last = fit.cuts[0], fit.cuts[EDGES - 1]
    middle = np.sqrt(APPROACHES[1:] * APPROACHES[:-1])
    near, far = (
        fit.approaches[(middle > start * first) & (middle < end * first)].sum(axis=0)
        for start, end in ((0.99, max(last / first, 1.02)), (1.1, 1.5))
    )
    # Where the sensor is blind, more of them end than farther away, where pulses are lost as anywhere.
    often = near[1] * max(far[0], 1.0) > 3.0 * max(far[1], 1.0) * near[0]
    if not often or fit.least < first - 0.01 or last > 1.1 * first + 0.05:
        raise UntoldError("no surfaces are cut off at the least range")
    # The least of n numbers that are even from an unknown start on is beyond it by more than three mean gaps in 5 %.
    start = first - math.log(20.0) * (last - first) / (EDGES - 1) - fit.lidar.measurement.range_resolution
    return Found(float(fit.least), (float(start), float(fit.least)), EDGES, "surfaces end there")


@dataclass(frozen=True)
class Fade:
    """How returns from the ground fade with the received power.

    Attributes
    ----------
    limit, sigma : float
        Logarithm of the power at the detection limit, and the softness of the limit.
    limit_interval, sigma_interval : tuple of float
        Their 95 % intervals.
    count : int
        Number of pulses.
    how : str
        What they rest on.
    """

    limit: float
    sigma: float
    limit_interval: Interval
    sigma_interval: Interval
    count: int
    how: str


def _fade(fit: Fit) -> Fade:
    """Return how the ground fades, by maximum likelihood.

    A pulse of mean power P gives a point with probability (1 − d)·Φ((ln P − l − w²/2)/w): l is the logarithm of the
    power at the limit, d the share that returns from nowhere.
    """
    from scipy.optimize import minimize
    from scipy.special import log_ndtr, ndtr

    by_range = fit.estimate("ground by range")
    rates = by_range.value[by_range.has(100)]
    if fit.ground_rate < 0.8:
        raise UntoldError("the ground does not return most pulses at any range")
    if rates.min() > 0.5:
        raise UntoldError("the ground returns most pulses wherever it is seen")
    units = fit.units["ground"].sums(len(POWERS))[..., 1:]
    units = units[units.sum(axis=(1, 2)) > 0]
    told = units.sum(axis=(0, 2)) > 0
    x, total, back = fit.estimate("ground at").value[told], units[:, told, 0], units[:, told, 1]

    def losses(parameters: Floats) -> Floats:
        """Return the negative logarithm of the likelihood of each unit."""
        start, log_width, lost = float(parameters[0]), float(parameters[1]), float(ndtr(parameters[2]))
        z = (x - start) * math.exp(-log_width)
        missed = np.log(1.0 - (1.0 - lost) * ndtr(z))  # of at least the share lost, which `bounds` keep above 2e-7
        of_units: Floats = -(back @ (np.log1p(-lost) + log_ndtr(z)) + (total - back) @ missed)
        return of_units

    start = np.array([x[np.argmin(np.abs(np.cumsum(back.sum(axis=0)) / back.sum() - 0.1))], -0.7, -2.5])
    bounds = [(-20.0, 5.0), (-4.0, 1.5), (-5.0, -0.5)]

    def loss(parameters: Floats) -> float:
        return float(losses(parameters).sum())

    best: Floats = minimize(loss, start, method="L-BFGS-B", bounds=bounds).x
    # Variances of units that are no independent pulses (P. J. Huber, Proc. 5th Berkeley Symposium, 1967).
    steps = 1e-3 * np.eye(3)
    slopes = np.array([losses(best + step) - losses(best - step) for step in steps]).T / 2e-3
    signs = ((1, 1), (-1, -1), (1, -1), (-1, 1))
    curve = np.array(
        [[sum(a * b * loss(best + a * one + b * other) for a, b in signs) for other in steps] for one in steps]
    )
    inverse, n = np.linalg.pinv(curve / 4e-6, hermitian=True), len(total)
    covariance = inverse @ (slopes.T @ slopes) @ inverse * n / max(n - 1.0, 1.0)
    reach = float(critical(1, np.array(n)))
    square = math.exp(2.0 * best[1])
    towards = np.array([1.0, -square, 0.0])
    limit, error = best[0] - 0.5 * square, reach * math.sqrt(towards @ covariance @ towards)
    if best[1] >= bounds[1][1] or error > VAGUE:
        raise UntoldError("the ground fades too gradually")
    ends = best[1] + reach * math.sqrt(covariance[1, 1]) * np.array([0.0, -1.0, 1.0])
    # The power of the echoes and the texture of the ground scatter together with the limit.
    others = fit.lidar.measurement.power_sigma**2 + fit.ground.variation**2
    sigma, low, high = np.sqrt(np.maximum(np.exp(2.0 * ends) - others, 0.0)).tolist()
    reflectivity = fit.ground.reflectivity
    return Fade(
        limit=float(limit),
        sigma=sigma,
        limit_interval=(float(limit - error), float(limit + error)),
        sigma_interval=(low, high),
        count=int(total.sum()),
        how=f"returns from the ground, of reflectivity {reflectivity} and roughness {fit.ground.roughness:g}",
    )
