"""Fits of a sensor to frames of a real unit: which sensor to start from, and the report of what `_estimators` tells."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from lidarsim._base.validation import short_repr
from lidarsim.comparison._captures import MISFIT, UntoldError, misfit
from lidarsim.comparison._estimators import FEWEST_POINTS, VALUES, Fit, Found
from lidarsim.comparison._inferred import Beams, NoRingsError, rings_of
from lidarsim.comparison._result import Cell, Comparison, Measure, Side
from lidarsim.comparison._sources import Source
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.lidar import Lidar
from lidarsim.materials import Material
from lidarsim.patterns import Spinning
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan
from lidarsim.sensor.measurement import Detection, Response


def fit_source(real: Source, sensor: Lidar, ground: Material | None) -> tuple[Lidar, Comparison]:
    """Fit a sensor to frames; see `lidarsim.fit`."""
    fit = Fit(sensor, ground)
    for given in real.frames:
        fit.add(given)
    if fit.points < FEWEST_POINTS:
        raise ArgumentValueError("real", f"{FEWEST_POINTS:,} points or more", f"{fit.points:,}")
    measures = []
    for name, (unit, estimator) in VALUES.items():
        meaning = " ".join((estimator.__doc__ or "").split())
        old = _attribute(fit.lidar, name)
        try:
            found = estimator(fit)
        except UntoldError as error:
            measures.append(Measure(name=name, unit=unit, verdict="not measured", why=str(error), meaning=meaning))
        else:
            found = _round(found)
            fit.lidar = _with(fit.lidar, name, found)
            measures.append(_measure(name, unit, meaning, found, old))
    rings = len(fit.rings)
    sides = Side(real.name, fit.frames, fit.points, rings), Side(sensor.name, 0, 0, sensor.pattern.shape[0])
    notes = (f"the rings of the real clouds are inferred from {fit.inferred}",) if fit.inferred else ()
    return fit.lidar, Comparison(tuple(measures), *sides, notes)


def sensor_of(given: str | os.PathLike[str] | Lidar) -> tuple[Lidar, str | None]:
    """Return the sensor to start from and, of a preset, its noise: measured if it has that, else of the datasheet.

    Parameters
    ----------
    given : str, path-like or Lidar
        A preset, a file or a sensor.

    Raises
    ------
    TypeError, ValueError
        If it is none of these.
    """
    if isinstance(given, Lidar):
        return given, None
    if not isinstance(given, str | os.PathLike):
        raise ArgumentTypeError("sensor", "a Lidar, the name of a preset or a file", short_repr(given))
    if Path(given).suffix:
        return Lidar.from_file(Path(given)), None
    for noise in ("measured", "datasheet"):
        try:
            return Lidar.preset(str(given), noise=noise), noise
        except ArgumentValueError as error:
            if error.argument != "noise":
                raise
    return Lidar.preset(str(given)), None


def recognise(real: Source) -> tuple[Source, str]:
    """Return the same frames, and the name of the spinning preset on whose beams the points of the first one are.

    Raises
    ------
    ValueError
        If there is none, or it cannot be told for want of points.
    """
    first = next(real.frames, None)
    cloud = first.point_cloud() if isinstance(first, Scan) else first
    if cloud is None:
        cloud = PointCloud({"xyz": np.zeros((0, 3))})
    cloud = cloud[np.isfinite(cloud.xyz).all(axis=1) & cloud.xyz.any(axis=1)]
    xyz = cloud.xyz
    found: dict[str, float] = {}
    for name in Lidar.presets() if len(xyz) else ():
        lidar = Lidar.preset(name)
        if not isinstance(lidar.pattern, Spinning):
            continue
        try:
            ring = cloud.ring.astype(np.intp)
        except AttributeError:
            try:
                ring, _ = rings_of(lidar, xyz)
            except NoRingsError:
                continue
        if 0.9 * lidar.pattern.shape[0] <= len(np.unique(ring)) and ring.max() < lidar.pattern.shape[0]:
            found[name] = misfit(Beams.of(lidar), xyz, ring)
    best = min(found, key=lambda name: found[name], default="")
    if not best or found[best] > MISFIT:
        if len(xyz) < FEWEST_POINTS:
            expected = f"{FEWEST_POINTS:,} points or more in the first frame"
            raise ArgumentValueError("real", expected, f"{len(xyz):,}", "of smaller frames, give the --preset")
        raise ArgumentValueError("preset", "the name of a sensor", "none", "no preset has beams where the points are")
    return replace(real, frames=chain([] if first is None else [first], real.frames)), best


def _attribute(lidar: Lidar, name: str) -> Any:
    """Return a value of a sensor by its name; None if it has no such part."""
    found: Any = lidar if hasattr(lidar, name) else lidar.measurement
    for part in name.split("."):
        found = getattr(found, part, None)
    return found


def _round(found: Found) -> Found:
    """Return a value with the digits that files have."""
    if isinstance(found.value, tuple):
        return replace(found, value=tuple((float(f"{at:.3g}"), float(f"{one:.6g}")) for at, one in found.value))
    return replace(found, value=float(f"{found.value:.6g}"))


def _with(lidar: Lidar, name: str, found: Found) -> Lidar:
    """Return a sensor with a value."""
    changes: dict[str, Any] = {name: found.value}
    if hasattr(lidar, name):
        return replace(lidar, **changes)
    whole, _, part = name.partition(".")
    if part:
        old = getattr(lidar.measurement, whole) or (Detection(0.1, 1.0) if whole == "detection" else Response())
        changes = {whole: replace(old, **{part: found.value})}
    return replace(lidar, measurement=replace(lidar.measurement, **(changes | found.changes)))


def _measure(name: str, unit: str, meaning: str, found: Found, old: Any) -> Measure:
    """Return a value beside that of the sensor as it was."""
    low, high = found.interval
    table = old if isinstance(old, tuple) else None
    cells = []
    for label, new, *ends, count in found.rows:
        at = float(label.removesuffix(" m")) if label.endswith(" m") else math.nan
        was = math.nan if math.isnan(at) or old is None else _at(table, at) if table else float(old)
        cells.append(
            Cell(
                label=label,
                real=new,
                simulated=was,
                real_interval=(ends[0], ends[1]),
                difference=was - new,
                n_real=count,
                differs=not math.isnan(was) and not ends[0] <= was <= ends[1],
            )
        )
    if table:
        weights = [cell.n_real for cell in cells]
        was = float(np.average([cell.simulated for cell in cells], weights=weights)) if cells else _at(table, 10.0)
    else:
        was = math.nan if old is None else float(old)
    differs = any(cell.differs for cell in cells) or not low <= was <= high
    return Measure(
        name=name,
        unit=unit,
        verdict="differs" if differs else "alike",
        why=found.how,
        where="all" if cells else "",
        by="range" if isinstance(found.value, tuple) else "ring" if cells else "",
        meaning=meaning,
        cells=tuple(cells),
        real=found.mean,
        simulated=was,
        real_interval=found.interval,
        difference=was - found.mean,
        n_real=found.count,
    )


def _at(table: tuple[tuple[float, float], ...], at: float) -> float:
    """Return a table at a range."""
    ranges, values = zip(*table, strict=True)
    return float(np.interp(at, ranges, values))
