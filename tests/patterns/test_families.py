"""What holds for every family of scan patterns."""

from __future__ import annotations

import dataclasses
import inspect
import pickle
import re
import tracemalloc
from collections.abc import Callable
from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
from mpmath import mpf

from lidarsim import patterns
from lidarsim.patterns import (
    Grid,
    Mid360,
    OscillatingMirror,
    Palmer,
    Pattern,
    PolygonMirror,
    Prism,
    Pulses,
    Risley,
    Spinning,
    Table,
    _parts,
)
from tests.patterns.families import FAMILIES, LATE, ORACLES

CLOCKED = {name: pattern for name, pattern in FAMILIES.items() if type(pattern) in ORACLES}
"""All but those that have their own oracle: tables of the vendor, lists, grids."""

TIMED = {name: pattern for name, pattern in FAMILIES.items() if name != "flash"}
"""All but the flash, which fires all its columns at once."""


def for_each(families: dict[str, Pattern]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("pattern", families.values(), ids=families.keys())


def ticks_of(pattern: Pattern, frame: int, pulses: Pulses, clock: Fraction) -> list[int]:
    """Return the ticks since time 0 at which the pulses' cycles start."""
    firing = getattr(pattern, "firing_times", np.zeros(pattern.shape[0]))[pulses.ring]
    since = [Fraction(float(time)) - Fraction(float(late)) for time, late in zip(pulses.time, firing, strict=True)]
    return [round((frame / Fraction(pattern.rate) + time) * clock) for time in since]


@pytest.mark.parametrize("frame", [0, 1, 2, LATE])
@for_each(FAMILIES)
def test_every_family_gives_whole_pulses(pattern: Pattern, frame: int) -> None:
    pulses = pattern.pulses(frame)
    count = len(pulses)
    assert count >= 2
    assert isinstance(pattern, Pattern)
    for name, dtype, shape in (
        ("directions", np.float64, (count, 3)),
        ("origins", np.float64, (count, 3)),
        ("time", np.float64, (count,)),
        ("ring", np.uint16, (count,)),
        ("column", np.uint32, (count,)),
    ):
        values = getattr(pulses, name)
        assert (values.dtype, values.shape, values.flags.c_contiguous) == (dtype, shape, True), name
        assert not values.flags.writeable, name
        assert np.isfinite(values).all(), name
    rings, columns = pattern.shape
    assert pulses.ring.max() < rings
    assert pulses.column.max() < columns
    # A firing cycle that starts in a frame may end after it.
    assert pulses.time.min() >= 0.0
    assert pulses.time.max() < 1.0 / pattern.rate + np.max(getattr(pattern, "firing_times", 0.0))
    assert len(np.unique(np.stack([pulses.ring, pulses.column]), axis=1).T) == count


@pytest.mark.parametrize("frame", [0, 3, LATE])
@for_each(FAMILIES)
def test_directions_are_unit_to_two_ulp(pattern: Pattern, frame: int) -> None:
    directions = pattern.pulses(frame).directions
    for direction in directions[:: max(1, len(directions) // 300)]:
        length = mp.sqrt(sum(mpf(float(component)) ** 2 for component in direction))
        assert abs(length - 1) <= 2 * 2.0**-52


@pytest.mark.parametrize("frame", [0, LATE])
@for_each(TIMED)
def test_pulses_are_in_firing_order_then_by_ring(pattern: Pattern, frame: int) -> None:
    pulses = pattern.pulses(frame)
    np.testing.assert_array_equal(np.lexsort((pulses.ring, pulses.time)), np.arange(len(pulses)))


@pytest.mark.parametrize("frame", [0, 1, LATE])
@for_each(TIMED)
def test_no_ring_fires_twice_at_a_time(pattern: Pattern, frame: int) -> None:
    pulses = pattern.pulses(frame)
    assert len(np.unique(np.stack([pulses.time, pulses.ring]), axis=1).T) == len(pulses)


@pytest.mark.parametrize("frame", [0, 1, 2, 36_000, LATE])
@for_each(CLOCKED)
def test_pulses_are_what_the_definition_says_in_50_digits(pattern: Pattern, frame: int) -> None:
    oracle, clock = ORACLES[type(pattern)]
    pulses = pattern.pulses(frame)
    chosen = np.unique(np.r_[0, 1, len(pulses) - 1, np.random.default_rng(5).integers(0, len(pulses), 30)])
    sample = Pulses(*(getattr(pulses, field.name)[chosen] for field in dataclasses.fields(Pulses)))
    ticks = ticks_of(pattern, frame, sample, clock(pattern))
    # Phases of prisms and mirrors are not rounded, however long a frame is: directions are within 2 ulp of 1. Of a head
    # or a polygon the angle swept within the frame is rounded six times: turns, phase, sum, sine, two products.
    tolerance = 2.0 * 2.0**-52
    if isinstance(pattern, Spinning | PolygonMirror):
        swept = 4.0 * np.pi + 2.0 * np.pi * getattr(pattern, "line_rate", 0.0) / pattern.rate
        tolerance = 6 * swept * 2.0**-53
    with mp.workdps(50):
        for i, tick in enumerate(ticks):
            direction, origin, time = oracle(pattern, frame, tick, int(sample.ring[i]))
            for got, expected in zip((*sample.directions[i], *sample.origins[i]), (*direction, *origin), strict=True):
                assert abs(mpf(float(got)) - expected) <= tolerance
            assert abs(mpf(float(sample.time[i])) - (time - frame / mpf(pattern.rate))) <= 2.0**-51 / pattern.rate


@for_each(CLOCKED)
def test_frames_share_out_the_ticks_of_the_clock(pattern: Pattern) -> None:
    clock = ORACLES[type(pattern)][1](pattern)
    ticks: list[int] = []
    for frame in range(7):
        pulses = pattern.pulses(frame)
        first = pulses.ring == pulses.ring[0]
        late = getattr(pattern, "firing_times", np.zeros(pattern.shape[0]))[pulses.ring[0]]
        ticks += np.rint((frame / pattern.rate + pulses.time[first] - late) * float(clock)).astype(int).tolist()
    end = 7 * clock / Fraction(pattern.rate)
    if isinstance(pattern, PolygonMirror):
        period, used = clock / Fraction(pattern.line_rate), Fraction(pattern.field_of_view) / Fraction(pattern.sweep)
    elif isinstance(pattern, Spinning):
        period, used = Fraction(pattern.columns_per_turn), Fraction(pattern.field_of_view) / Fraction(2.0 * np.pi)
    else:
        period, used = Fraction(1), Fraction(1)
    # At the very edge the rounding of the angles decides.
    least, whole = (used - Fraction(1, 10**12)) * period.numerator, period.numerator
    inside = [tick for tick in range(-int(-end // 1)) if tick * period.denominator % whole < least]
    assert len(inside) > 700
    assert ticks == inside


@for_each(FAMILIES)
def test_frames_that_are_alike_are_made_once(pattern: Pattern) -> None:
    if isinstance(pattern, Grid) or (isinstance(pattern, Spinning) and float(pattern.columns_per_turn).is_integer()):
        assert pattern.pulses(3) is pattern.pulses(0)
    elif not isinstance(pattern, Table):
        assert pattern.pulses(1) is not pattern.pulses(0)


@for_each(FAMILIES)
def test_instruction_sets_and_threads_change_nothing(
    pattern: Pattern, instruction_sets: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Copies have nothing that was made before; three times as long frames are shared among threads."""
    made = []
    for isa, threads in [*((isa, "1") for isa in instruction_sets), (instruction_sets[-1], "2")]:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        monkeypatch.setenv("LIDARSIM_THREADS", threads)
        copies = [pickle.loads(pickle.dumps(pattern))]  # noqa: S301
        if type(pattern) in ORACLES and not isinstance(pattern, Spinning):
            copies.append(dataclasses.replace(pattern, rate=pattern.rate / 3.0))
        frames = [copy.pulses(frame) for copy in copies for frame in (1, LATE)]
        made.append(
            [getattr(pulses, field.name).tobytes() for pulses in frames for field in dataclasses.fields(Pulses)]
        )
    assert all(bits == made[0] for bits in made)


@for_each(FAMILIES)
def test_scans_know_whether_pulses_have_a_common_origin(pattern: Pattern) -> None:
    """Scans then do not read the origins."""
    pulses = pattern.pulses(1)
    same = bool((pulses.origins == pulses.origins[0]).all())
    assert pulses._origin == (tuple(pulses.origins[0]) if same else None)


@for_each(CLOCKED)
def test_frames_share_what_they_have_in_common(pattern: Pattern) -> None:
    first, second = pattern.pulses(1), pattern.pulses(2)
    assert np.shares_memory(first.ring, second.ring)
    assert np.shares_memory(first.column, second.column)
    assert first is second or not np.shares_memory(first.directions, second.directions)
    count = min(len(first), len(second))
    late = pattern.pulses(LATE)
    for name in ("ring", "column"):
        np.testing.assert_array_equal(getattr(first, name)[:count], getattr(second, name)[:count])
        assert not getattr(late, name).flags.writeable


@for_each(FAMILIES)
def test_patterns_survive_pickling(pattern: Pattern) -> None:
    copy = pickle.loads(pickle.dumps(pattern))  # noqa: S301
    for field in dataclasses.fields(Pulses):
        np.testing.assert_array_equal(getattr(copy.pulses(2), field.name), getattr(pattern.pulses(2), field.name))


@for_each(FAMILIES)
def test_replace_changes_one_thing(pattern: Pattern) -> None:
    assert dataclasses.is_dataclass(pattern)
    slower = dataclasses.replace(pattern, rate=pattern.rate / 2.0)
    assert slower.rate == pattern.rate / 2.0
    assert len(slower.pulses()) > 0


@pytest.mark.parametrize(
    ("frame", "message"),
    [(-1, "frame: expected an integer >= 0, got -1"), (1.5, "frame: expected an integer >= 0, got 1.5")],
)
@for_each(FAMILIES)
def test_frames_are_whole_numbers(pattern: Pattern, frame: float, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        pattern.pulses(frame)  # type: ignore[arg-type]


def test_no_family_is_forgotten() -> None:
    families = {
        value
        for name, value in vars(patterns).items()
        if name in patterns.__all__ and inspect.isclass(value) and hasattr(value, "pulses") and value is not Pattern
    }
    assert {type(sample) for sample in FAMILIES.values()} == families
    assert families - ORACLES.keys() == {Grid, Mid360, Table}


MANY = {"pulse_rate": 2.0**32, "rate": 1.0}
GREEDY = {
    "risley": lambda **more: Risley([Prism(10.0, exit_tilt=0.1)], refractive_index=1.5, **{**MANY, **more}),
    "palmer": lambda **more: Palmer(half_angle=0.3, scan_rate=50.0, **{**MANY, **more}),
    "oscillating": lambda **more: OscillatingMirror(field_of_view=0.3, scan_rate=50.0, **{**MANY, **more}),
    "polygon": lambda **more: PolygonMirror(sweep=1.0, field_of_view=0.5, line_rate=50.0, **{**MANY, **more}),
    "mid360": lambda rate=5e4 / 2**32: Mid360(rate=rate),
    "spinning": lambda rate=2.0**32: Spinning([0.0, 0.1], columns=rate),
    "grid": lambda **_: Grid(np.zeros(1 << 16), np.zeros(1 << 16), rate=1.0),
}


@pytest.mark.parametrize("make", GREEDY.values(), ids=GREEDY)
def test_too_many_pulses_are_refused_before_they_are_made(
    make: Callable[..., Pattern], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A constructor makes none, or few; a frame of more than can be kept is one error."""
    tracemalloc.start()
    try:
        pattern = make()
        # More memory than any machine has, if a pulse took this.
        monkeypatch.setattr(_parts, "PULSE_BYTES", 1 << 40)
        with pytest.raises(MemoryError, match=r"^out of memory: \d+ bytes for the \d+ pulses of a frame$"):
            pattern.pulses()
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: GREEDY["risley"](pulse_rate=1e11),
            "pulse_rate: expected at most 4294967296 firing cycles a frame, got",
        ),
        (lambda: GREEDY["palmer"](rate=0.5), "pulse_rate: expected at most 4294967296 firing cycles a frame"),
        (lambda: GREEDY["polygon"](rate=0.5), "pulse_rate: expected at most 4294967296 firing cycles a frame"),
        (lambda: GREEDY["oscillating"](rate=0.5), "pulse_rate: expected at most 4294967296 firing cycles a frame"),
        (lambda: GREEDY["mid360"](rate=1e-6), "rate: expected at most 4294967296 firing cycles a frame"),
        (lambda: GREEDY["spinning"](rate=1e10), "columns: expected at most 4294967296 columns a turn, got 1e+10"),
        (
            lambda: Spinning([0.0], column_period=1e-15),
            "column_period: expected at most 4294967296 columns a turn, got",
        ),
        (lambda: GREEDY["palmer"](rate=1e-12), "rate: expected a rate from 1e-09 to 1e+12 Hz, got 1e-12"),
        (lambda: Grid([0.0], [0.0], rate=1e300), "rate: expected a rate from 1e-09 to 1e+12 Hz, got 1e+300"),
        (
            lambda: Table([(1, 0, 0)], times=1e300, rate=1.0),
            "times: expected fewer than 9007199254740992 frames at 1 Hz",
        ),
        (lambda: Prism(1e300), "rotation_rate: expected one up to 1e+12 Hz either way, got 1e+300"),
        (
            lambda: Risley([Prism(1.0)], refractive_index=1e300, pulse_rate=10.0, rate=1.0),
            "refractive_index: expected one up to 10, got 1e+300",
        ),
    ],
)
def test_what_no_pattern_can_do_is_refused_when_it_is_made(make: Callable[[], Pattern], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        make()


@pytest.mark.parametrize("make", [make for name, make in GREEDY.items() if name != "grid"])
def test_frames_of_any_number_have_pulses(make: Callable[..., Pattern]) -> None:
    """Numbers beyond float64, too: the phases of clocks are reduced exactly."""
    few = {GREEDY["mid360"]: {"rate": 1e3}, GREEDY["spinning"]: {"rate": 16.0}}
    pattern = make(**few.get(make, {"pulse_rate": 100.0}))
    for frame in (2**53 + 1, 10**400):
        assert len(pattern.pulses(frame)) > 0
