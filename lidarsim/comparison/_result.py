"""The result of a comparison: a table of measures, as text, as JSON and as a page."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, overload

from lidarsim._base.files import PathLike, atomic_writer, check_suffix
from lidarsim._base.names import AnsweringABC
from lidarsim._base.pickling import Immutable
from lidarsim._base.shown import quantity, text_table
from lidarsim._base.validation import short_repr
from lidarsim._base.views import view

Verdict = Literal["alike", "differs", "cannot tell", "not measured"]
Interval = tuple[float, float]

UNKNOWN: Interval = (math.nan, math.nan)


@dataclass(frozen=True, kw_only=True, repr=False)
class Contrast(Immutable):
    """A real value beside a simulated one.

    Attributes
    ----------
    real, simulated : float
        The values, in the unit of the measure; nan if not measured.
    real_interval, simulated_interval : tuple of float
        Their 95 % intervals, by bootstrap.
    difference : float
        Simulated minus real.
    difference_interval : tuple of float
        Its 95 % interval.
    n_real, n_simulated : int
        Numbers of samples.
    least : float
        The least difference that would count: both relevant and beyond chance; nan if the values are not compared.
    """

    real: float = math.nan
    simulated: float = math.nan
    real_interval: Interval = UNKNOWN
    simulated_interval: Interval = UNKNOWN
    difference: float = math.nan
    difference_interval: Interval = UNKNOWN
    n_real: int = 0
    n_simulated: int = 0
    least: float = math.nan


@dataclass(frozen=True, kw_only=True, repr=False)
class Cell(Contrast):
    """A part of a measure, such as a bin of range or a ring, with the values of a `Contrast`.

    Attributes
    ----------
    label : str
        Which part.
    differs : bool
        Whether the difference exceeds the least that counts.
    """

    label: str
    differs: bool


@dataclass(frozen=True, kw_only=True, repr=False)
class Measure(Contrast):
    """One measure of a comparison, with the values of a `Contrast`.

    Values are those of the cell that `where` names, in which the sides differ most for what is relevant and beyond
    chance; `cells` has all.

    Attributes
    ----------
    name, unit : str
        Name, and unit of the values: "m", "rad", "share" or "1".
    verdict : {"alike", "differs", "cannot tell", "not measured"}
        "differs": in some cell, or over all, the difference is relevant, and beyond chance in as many tests as the
        comparison makes. "alike": no such difference was found, and one that is relevant over all would have been.
        "cannot tell": none was found, but chance could hide one.
    why : str
        What the verdict rests on.
    where : str
        The cell of the values.
    by : str
        What the cells are bins of; "" if there is one.
    meaning : str
        What the measure says.
    cells : tuple of Cell
        All cells that either side has samples in.
    """

    name: str
    unit: str
    verdict: Verdict
    why: str
    where: str = ""
    by: str = ""
    meaning: str = ""
    cells: tuple[Cell, ...] = ()

    def __repr__(self) -> str:
        """Return the name, the values and the verdict."""
        real, simulated = values(self)
        return f"Measure({self.name}: {real} and {simulated} {self.unit}, {self.verdict})"


@dataclass(frozen=True)
class Side(Immutable):
    """What was compared, of one side.

    Attributes
    ----------
    name : str
        Where it came from; "" of an iterable.
    frames, points, rings : int
        Numbers of frames, of points, and of rings that have points; 0 without rings.
    """

    name: str
    frames: int
    points: int
    rings: int

    def __str__(self) -> str:
        """Return the numbers; of a sensor without frames its name."""
        if not self.frames:
            return self.name
        rings = f", {quantity(self.rings, 'ring')}" if self.rings else ""
        name = f"{self.name}: " if self.name else ""
        return f"{name}{quantity(self.frames, 'frame')}, {quantity(self.points, 'point')}{rings}"


@dataclass(frozen=True, repr=False)
class Comparison(Immutable, Sequence[Measure], metaclass=AnsweringABC):
    """Measures of real point clouds beside the same of simulated ones; a sequence of `Measure`.

    Attributes
    ----------
    measures : tuple of Measure
        All measures, also those that could not be taken; `comparison["range noise"]` finds one by name.
    real, simulated : Side
        What was compared.
    notes : tuple of str
        What to keep in mind when reading the table.
    """

    measures: tuple[Measure, ...]
    real: Side
    simulated: Side
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.measures)

    def __iter__(self) -> Iterator[Measure]:
        return iter(self.measures)

    @overload
    def __getitem__(self, index: int | str) -> Measure: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Measure, ...]: ...
    def __getitem__(self, index: int | str | slice) -> Measure | tuple[Measure, ...]:
        """Return a measure by its place or its name."""
        if isinstance(index, str):
            for measure in self.measures:
                if measure.name == index:
                    return measure
            names = ", ".join(measure.name for measure in self.measures)
            raise KeyError(f"index: expected one of {names}, got {short_repr(index)}")
        return self.measures[index]

    @property
    def differing(self) -> tuple[Measure, ...]:
        """The measures that differ."""
        return tuple(measure for measure in self.measures if measure.verdict == "differs")

    def __repr__(self) -> str:
        """Return the table."""
        return str(self)

    def __str__(self) -> str:
        """Return one line for each measure, and why those that are missing could not be taken."""
        rows = [("measure", "real", "simulated", "unit", "at", "verdict")]
        for measure in self.measures:
            if measure.verdict != "not measured":
                where = "" if measure.where == "all" else measure.where
                rows.append((measure.name, *values(measure), measure.unit, where, measure.verdict))
        title = f"real {self.real}\nsimulated {self.simulated}"
        missing = [f"  not measured, since {why}: {', '.join(names)}" for why, names in reasons(self).items()]
        notes = [f"  note: {note}" for note in self.notes]
        return "\n".join([text_table(title, rows), *missing, *notes])

    def _repr_html_(self) -> str:
        """Return what notebooks show: the tables of the report."""
        summary: str = view(Comparison, "summary")(self)
        return summary

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain dictionaries, lists, texts and numbers.

        Returns
        -------
        dict
            Attributes by name. What is not finite is None, as JSON has no word for it.
        """
        plain: dict[str, Any] = _plain(self)
        return plain

    def save(self, path: PathLike) -> None:
        """Write a report: a page with plots that needs nothing else, or JSON.

        Parameters
        ----------
        path : path-like
            The file, ``.html`` or ``.json``.

        Raises
        ------
        FileFormatError
            If the suffix is another.
        OSError
            If the file cannot be written.
        """
        suffix = check_suffix(path, SUFFIXES)
        text = (
            view(Comparison, "page")(self)
            if suffix == ".html"
            else json.dumps(self.to_dict(), indent=1, ensure_ascii=False)
        )
        with atomic_writer(path) as file:
            file.write(f"{text.rstrip()}\n".encode(errors="backslashreplace"))  # names that are not UTF-8


SUFFIXES = (".html", ".json")


def _plain(value: Any) -> Any:
    if isinstance(value, Immutable):
        return {name: _plain(part) for name, part in value._contents().items()}
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def reasons(comparison: Comparison) -> dict[str, list[str]]:
    """Return the names of the measures that could not be taken, by why."""
    found: dict[str, list[str]] = {}
    for measure in comparison:
        if measure.verdict == "not measured":
            found.setdefault(measure.why, []).append(measure.name)
    return found


def values(what: Contrast) -> tuple[str, str]:
    """Return the real and the simulated value with their intervals, as text."""
    pairs = (what.real, what.real_interval), (what.simulated, what.simulated_interval)
    real, simulated = (_with_interval(*pair, what.least) for pair in pairs)
    return real, simulated


def number(value: float, least: float = math.nan) -> str:
    """Return a number as text: to a hundredth of the least difference that counts, with four significant digits else.

    "" stands for a number that is not known.
    """
    if not math.isfinite(value):
        return ""
    if not (math.isfinite(least) and least > 0.0):
        return f"{value:.4g}"
    digits = 2 - math.floor(math.log10(least))
    return f"{round(value, digits) + 0.0:.{max(digits, 0)}f}"


def _with_interval(value: float, ends: Interval, least: float) -> str:
    low, high = (number(end, least) for end in ends)
    return f"{number(value, least)} [{low}, {high}]" if low else number(value, least)
