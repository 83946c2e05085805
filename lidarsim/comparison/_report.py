"""A comparison as a page: one file that needs nothing else, with a plot for each measure in SVG."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

from lidarsim._base.views import register_view
from lidarsim.comparison._result import Cell, Comparison, Contrast, Measure, number, reasons, values

WIDTH, DOWN = 760, 180
"""Width of a plot, and height of its axis."""
LEFT, RIGHT, TOP, TITLE = 100, 12, 12, 20
"""Margins, and height of the title of the horizontal axis."""
MOST_LABELS = 16
UNITS = {"1": "no unit"}
"""Units as axes have them."""

STYLE = """
:root { color-scheme: light dark; --ink: #1c2430; --faint: #66707d; --line: #d9dee5; --page: #ffffff; --card: #f5f7fa;
  --real: #1d4ed8; --simulated: #c2410c; --differs: #b42318; --alike: #1a7f4b; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6eaf0; --faint: #9aa5b4; --line: #333c49; --page: #12161c;
  --card: #1a2029; --real: #7aa2ff; --simulated: #ff9d5c; --differs: #ff7b72; --alike: #56d28e; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--page); margin: 2rem auto;
  max-width: 60rem; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin: 0; }
p, caption { color: var(--faint); margin: .25rem 0; text-align: left; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; font-size: .875rem; }
th, td { text-align: left; padding: .25rem .6rem .25rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
section { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: 1rem; margin: 1rem 0; }
a { color: inherit; } svg { width: 100%; height: auto; } svg text { fill: var(--faint); font-size: 11px; }
.differs { color: var(--differs); font-weight: 600; } .alike { color: var(--alike); font-weight: 600; }
.cannot-tell { color: var(--faint); font-weight: 600; }
.key { display: inline-block; width: .7em; height: .7em; border-radius: 50%; margin: 0 .3em 0 .8em; }
.key:first-child { margin-left: 0; } .key.few { border: 1.5px solid var(--faint); width: .5em; height: .5em; }
.key.shaded { background: var(--differs); opacity: .2; border-radius: 0; } .interval { white-space: nowrap; }
details { margin-top: .5rem; } .wide { overflow-x: auto; }
"""


def page(comparison: Comparison) -> str:
    """Return a comparison as a page in HTML, which loads nothing."""
    measured = [measure for measure in comparison if measure.verdict != "not measured"]
    sections = "".join(_section(i, measure) for i, measure in enumerate(measured))
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>lidarsim compare</title><style>{STYLE}</style></head><body><h1>Real and simulated point clouds</h1>"
        f"{summary(comparison)}{sections}</body></html>"
    )


def summary(comparison: Comparison) -> str:
    """Return the tables of a comparison: what was compared, the measures, and what could not be measured."""
    measured = [measure for measure in comparison if measure.verdict != "not measured"]
    rows = [
        (
            f'<a href="#measure-{i}">{escape(measure.name)}</a>',
            *_values(measure),
            *map(escape, (measure.unit, "" if measure.where == "all" else measure.where)),
            f'<span class="{_kind(measure)}">{measure.verdict}</span>',
            escape(measure.why),
        )
        for i, measure in enumerate(measured)
    ]
    heads = ("measure", "real", "simulated", "unit", "where they differ most", "verdict", "why")
    differing = len(comparison.differing)
    few = sum(measure.verdict == "cannot tell" for measure in measured)
    untold = f"; of {few} these data cannot tell" if few else ""
    told = (
        f"<p>Real: {escape(str(comparison.real))}.<br>Simulated: {escape(str(comparison.simulated))}.</p>"
        f"<p>{differing} of {len(measured)} measures differ{untold}. In brackets: 95 % intervals.</p>"
    )
    notes = "".join(f"<p>Note: {escape(note)}.</p>" for note in comparison.notes)
    table = f'<div class="wide">{_table(heads, rows)}</div>' if rows else ""
    missing = [(escape(", ".join(names)), escape(why)) for why, names in reasons(comparison).items()]
    absent = _table(("not measured", "why"), missing) if missing else ""
    return f"{told}{notes}{table}{absent}"


def _kind(measure: Measure) -> str:
    """Return the class of a verdict in the style of the page."""
    return measure.verdict.replace(" ", "-")


def _values(what: Contrast) -> tuple[str, str]:
    """Return both values with their intervals, which stay on one line."""
    real, simulated = (
        f'{value} <span class="interval">{bracket}{ends}</span>' if bracket else value
        for value, bracket, ends in (escape(text).partition("[") for text in values(what))
    )
    return real, simulated


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose cells are HTML."""
    head = "".join(f"<th>{name}</th>" for name in heads)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _section(place: int, measure: Measure) -> str:
    """Return the plot and the numbers of a measure."""
    rows = [
        (
            escape(cell.label),
            *_values(cell),
            *map(escape, (number(cell.difference, cell.least), number(cell.least))),
            f"{cell.n_real:,}",
            f"{cell.n_simulated:,}",
            '<span class="differs">differs</span>' if cell.differs else "" if _is_compared(cell) else "too few",
        )
        for cell in measure.cells
    ]
    unit = f" ({escape(measure.unit)})"
    values_of = ("real", "simulated", "difference", "least that counts")
    heads = (escape(measure.by), *(name + unit for name in values_of), "n real", "n simulated", "")
    return (
        f'<section id="measure-{place}"><h2>{escape(measure.name)}'
        f' <span class="{_kind(measure)}">{measure.verdict}</span></h2><p>{escape(measure.meaning)}</p>'
        f"{plot(measure)}<details><summary>Numbers</summary>"
        f'<div class="wide">{_table(heads, rows)}</div></details></section>'
    )


def plot(measure: Measure) -> str:
    """Return the values of both sides by cell, with their intervals, as SVG in the colours of the page.

    The axis spans the cells that are compared. Those with too few samples are hollow, and left out beyond it.
    """
    cells = measure.cells
    ends = [x for cell in cells if _is_compared(cell) for x in _extent(cell) if math.isfinite(x)]
    if not ends:
        return ""
    ticks = _ticks(min(ends), max(ends))
    low, high = ticks[0], ticks[-1]
    across = WIDTH - LEFT - RIGHT
    several = len(cells) > 1
    height = TOP + DOWN + 24  # below it are the labels, which are turned, and what they are
    height += 4 * max(len(_brief(cell.label)) for cell in cells) + TITLE if several else 0

    def x_of(i: int, side: float) -> float:
        return LEFT + across * (i + 0.5 + side) / len(cells)

    def y_of(value: float) -> float:
        return TOP + DOWN * (high - value) / (high - low)

    parts = [
        f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y_of(tick):.1f}" y2="{y_of(tick):.1f}" stroke="var(--line)"/>'
        f'<text x="{LEFT - 6}" y="{y_of(tick) + 4:.1f}" text-anchor="end">{tick:.6g}</text>'
        for tick in ticks
    ]
    every = -(-len(cells) // MOST_LABELS)
    for i, cell in enumerate(cells):
        if i % every == 0 and several:
            x, y = x_of(i, 0.0), TOP + DOWN + 14
            parts.append(
                f'<text x="{x:.1f}" y="{y}" text-anchor="end" transform="rotate(-40 {x:.1f} {y})">'
                f"{escape(_brief(cell.label))}</text>"
            )
        if cell.differs:
            left, right = x_of(i, -0.5), x_of(i, 0.5)
            parts.append(
                f'<rect x="{left:.1f}" y="{TOP}" width="{right - left:.1f}" height="{DOWN}" fill="var(--differs)" '
                'opacity="0.12"/>'
            )
        sides = (
            (-0.12, "real", cell.real, cell.real_interval),
            (0.12, "simulated", cell.simulated, cell.simulated_interval),
        )
        for side, name, value, (bottom, top) in sides:
            if not low <= value <= high:  # nor is nan
                continue
            x = x_of(i, side)
            fill = f'fill="var(--{name})"'
            if not _is_compared(cell):
                fill = f'fill="var(--card)" stroke="var(--{name})" stroke-width="1.5"'
            elif math.isfinite(bottom):
                parts.append(
                    f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y_of(bottom):.1f}" y2="{y_of(top):.1f}" '
                    f'stroke="var(--{name})" stroke-width="1.5"/>'
                )
            parts.append(
                f'<circle cx="{x:.1f}" cy="{y_of(value):.1f}" r="3" {fill}>'
                f"<title>{escape(cell.label)}, {name}: {number(value, cell.least)}</title></circle>"
            )
    parts.append(
        f'<text x="14" y="{TOP + DOWN / 2}" text-anchor="middle" '
        f'transform="rotate(-90 14 {TOP + DOWN / 2})">{escape(UNITS.get(measure.unit, measure.unit))}</text>'
    )
    if several:
        parts.append(f'<text x="{LEFT + across / 2}" y="{height - 6}" text-anchor="middle">{escape(measure.by)}</text>')
    key = "".join(f'<span class="key" style="background: var(--{n})"></span>{n}' for n in ("real", "simulated"))
    if any(cell.differs for cell in cells):
        key += '<span class="key shaded"></span>differs'
    if not all(map(_is_compared, cells)):
        key += '<span class="key few"></span>too few samples'
    label = f"{escape(measure.name)}, real and simulated"
    return f'<p>{key}</p><svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def _brief(label: str) -> str:
    return label.replace("intensity ", "").replace("ring ", "")


def _is_compared(cell: Cell) -> bool:
    return math.isfinite(cell.least)


def _extent(cell: Cell) -> tuple[float, ...]:
    """Return the ends of what a cell shows."""
    return (cell.real, cell.simulated, *cell.real_interval, *cell.simulated_interval)


def _ticks(low: float, high: float) -> list[float]:
    """Return four to ten round numbers, the first below and the last above what is to be shown."""
    if high <= low:
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    rough = (high - low) / 5.0
    unit = 10.0 ** math.floor(math.log10(rough))
    step = next(unit * factor for factor in (1, 2, 5, 10) if unit * factor >= rough)
    first, last = math.floor(low / step), math.ceil(high / step)
    return [step * i for i in range(first, last + 1)]


register_view(Comparison, "page", page)
register_view(Comparison, "summary", summary)
