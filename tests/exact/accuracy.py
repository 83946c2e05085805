"""How far each ray caster is from the exact answer, case by case; ``python tests/tables.py`` writes the tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from exact import adversarial, cases, oracle

Floats = npt.NDArray[np.float64]

#: Returns t of the nearest hit with t ≥ 0 of each ray, inf for a miss; None if the engine has no such shape.
Engine = Callable[[cases.Spec, Floats, Floats], Floats | None]


@dataclass
class Verdict:
    """Errors of an engine.

    Attributes
    ----------
    rays, hits : int
        Rays judged, and those that hit.
    missed, invented, other : int
        Hits that were lost, that do not exist, and that are on another root or primitive than the nearest.
    worst : float
        Largest error of t, in ulp of the exact t, over rays that the engine decided correctly.
    rounded : int
        Values of t that are the exact value correctly rounded.
    values : int
        Values of t judged.
    first : str
        Description of the first wrong decision, or of the first t that is more than an ulp off.
    """

    rays: int = 0
    hits: int = 0
    missed: int = 0
    invented: int = 0
    other: int = 0
    worst: float = 0.0
    rounded: int = 0
    values: int = 0
    first: str = ""

    @property
    def wrong(self) -> int:
        """Wrong decisions of any sort."""
        return self.missed + self.invented + self.other

    @property
    def errs(self) -> bool:
        """Whether there is a wrong decision, or a value that is not correctly rounded."""
        return self.wrong > 0 or self.rounded < self.values

    def add(self, more: Verdict) -> None:
        """Count another verdict in."""
        for name in ("rays", "hits", "missed", "invented", "other", "rounded", "values"):
            setattr(self, name, getattr(self, name) + getattr(more, name))
        self.worst = max(self.worst, more.worst)
        self.first = self.first or more.first

    def _value(self, exact: oracle.Surd, t: float, where: Callable[[], str]) -> None:
        self.values += 1
        if t == float(exact):
            self.rounded += 1
            self.worst = max(self.worst, 0.5)
            return
        error = exact.ulps(t)
        self.worst = max(self.worst, error)
        if error > 1:
            self.first = self.first or f"t = {t!r}, exactly {float(exact)!r}, {error:.3g} ulp off: {where()}"


def _where(spec: cases.Spec, origin: Sequence[float], direction: Sequence[float]) -> str:
    return f"{spec!r}, origin {list(origin)!r}, direction {list(direction)!r}"


def judge_cast(
    spec: cases.Spec, origins: Floats, directions: Floats, t: Floats, *, primitives: npt.NDArray[np.int32] | None = None
) -> Verdict:
    """Judge nearest hits: t of each ray, inf for a miss, and its primitive if the engine reports it."""
    shape = spec.judge()
    verdict = Verdict(rays=len(t))
    for i, (o, d, got) in enumerate(zip(origins.tolist(), directions.tolist(), t.tolist(), strict=True)):
        ray = oracle.Ray.of(o, d)
        want = oracle.nearest(shape, ray)
        verdict.hits += want is not None
        hit = not math.isinf(got)
        if want is None or not hit:
            verdict.missed += want is not None
            verdict.invented += hit
            if hit or want is not None:
                verdict.first = (
                    verdict.first or f"{'invented' if hit else 'missed'} t = {got!r}, {want}: {_where(spec, o, d)}"
                )
            continue
        primitive = min(want.faces) if shape.primitives else 0
        # another root of the same line is a wrong decision, not an error of the right one
        off = abs(float(want.t) - got)
        nearer = off > 0 and any(abs(float(c.t) - got) < off for c in shape.crossings(ray) if c.t != want.t)
        if nearer or (primitives is not None and int(primitives[i]) != primitive):
            verdict.other += 1
            verdict.first = verdict.first or f"t = {got!r} is not of {want}: {_where(spec, o, d)}"
            continue
        verdict._value(want.t, got, partial(_where, spec, o, d))
    return verdict


def judge_roots(spec: cases.Spec, origins: Floats, directions: Floats, roots: Floats) -> Verdict:
    """Judge every root, (n, k), nan-padded: their number, their order, their values."""
    shape = spec.judge()
    verdict = Verdict(rays=len(roots))
    for o, d, row in zip(origins.tolist(), directions.tolist(), roots.tolist(), strict=True):
        want = [crossing.t for crossing in shape.crossings(oracle.Ray.of(o, d))]
        got = [t for t in row if not math.isnan(t)]
        verdict.hits += bool(want)
        if len(got) != len(want) or row[: len(got)] != got:
            verdict.missed += len(got) < len(want)
            verdict.invented += len(got) > len(want)
            verdict.other += len(got) == len(want)
            verdict.first = verdict.first or f"roots {row}, expected {want}: {_where(spec, o, d)}"
            continue
        for exact, t in zip(want, got, strict=True):
            verdict._value(exact, t, partial(_where, spec, o, d))
    return verdict


def _first_ahead(roots: Floats) -> Floats:
    """Return the least root ≥ 0 of each row, inf if there is none."""
    with np.errstate(invalid="ignore"):
        ahead: Floats = np.where(roots >= 0, roots, np.inf).min(axis=1, initial=np.inf)
    return ahead


def _textbook(spec: cases.Spec, origins: Floats, directions: Floats) -> Floats | None:
    with np.errstate(all="ignore"):
        roots = spec.textbook(origins, directions)
    return None if roots is None else _first_ahead(roots)


def _lidarsim(spec: cases.Spec, origins: Floats, directions: Floats) -> Floats:
    t: Floats = spec.build().cast(origins, directions).t
    return t


def _undo_scaling(t: Floats, exponent: npt.NDArray[np.int32]) -> Floats:
    """Return t for the directions as they were before `_of_order_one`, inf where it overflows."""
    with np.errstate(over="ignore"):
        return np.ldexp(t, -exponent)


def _of_order_one(directions: Floats) -> tuple[Floats, npt.NDArray[np.int32]]:
    """Return directions · 2^−e, components below 1, and e: a courtesy to peers that cannot do with other lengths."""
    _, exponent = np.frexp(np.abs(directions).max(axis=1))
    return np.ldexp(directions, -exponent[:, None]), exponent


def _open3d(spec: cases.Spec, origins: Floats, directions: Floats) -> Floats | None:
    if spec.kind not in {"Triangle", "TriangleMesh"}:
        return None
    vertices, faces = spec.args if spec.kind == "TriangleMesh" else (np.array(spec.args), np.array([[0, 1, 2]]))
    if spec.transform is not None:
        vertices = vertices @ spec.transform[:3, :3].T + spec.transform[:3, 3]
    return _open3d_cast(vertices, faces, origins, directions)


def _open3d_cast(vertices: Floats, faces: Any, origins: Floats, directions: Floats) -> Floats:
    from lidarsim.viewers.open3d import import_open3d

    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(np.asarray(faces, dtype=np.uint32))
    )
    unit, exponent = _of_order_one(directions)
    rays = np.concatenate([origins, unit], axis=1).astype(np.float32)
    return _undo_scaling(scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy().astype(np.float64), exponent)


def _mujoco(spec: cases.Spec, origins: Floats, directions: Floats) -> Floats | None:
    import mujoco

    geom = _mujoco_geom(spec)
    if geom is None:
        return None
    try:
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geom}</worldbody></mujoco>")
    except ValueError:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found, normal = np.zeros(1, dtype=np.int32), np.zeros(3)
    unit, exponent = _of_order_one(directions)
    t = np.array(
        [mujoco.mj_ray(model, data, o, d, None, 1, -1, found, normal) for o, d in zip(origins, unit, strict=True)]
    )
    return np.where(t < 0, np.inf, _undo_scaling(t, exponent))


def _mujoco_geom(spec: cases.Spec) -> str | None:
    """Return geoms in MJCF, with every digit of their numbers; None for what MuJoCo lacks."""

    def geom(kind: str, **attributes: Any) -> str:
        texts = {name: " ".join(repr(float(v)) for v in np.ravel(value)) for name, value in attributes.items()}
        return f'<geom type="{kind}" {" ".join(f"{name}={text!r}" for name, text in texts.items())}/>'

    match spec.kind, spec.args, spec.transform:
        case "Plane.from_point", (point, normal), None:  # MuJoCo's planes are met from the front alone, so two make one
            return "".join(geom("plane", size=(0, 0, 1), pos=point, zaxis=n) for n in (normal, np.negative(normal)))
        case "Sphere", (center, radius), None:
            return geom("sphere", size=radius, pos=center)
        case "Ellipsoid", (center, radii, *rotation), None:
            axes = np.asarray(rotation[0] if rotation else np.eye(3))
            return geom("ellipsoid", size=radii, pos=center, xyaxes=axes[:, :2].T)
        case "Box", (size, *center), None:
            return geom("box", size=np.divide(size, 2), pos=center[0] if center else (0, 0, 0))
        case "Cylinder" | "Capsule" as kind, (start, end, radius, *capped), None if not capped or capped[0]:
            return geom(kind.lower(), size=radius, fromto=(start, end))
    return None


#: The engines of the table, by name.
ENGINES: dict[str, Engine] = {"textbook": _textbook, "lidarsim": _lidarsim, "Open3D": _open3d, "MuJoCo": _mujoco}


def _available_engines() -> dict[str, Engine]:
    from lidarsim.errors import MissingExtraError
    from lidarsim.viewers.open3d import import_open3d

    engines = dict(ENGINES)
    try:
        import_open3d()
    except MissingExtraError:
        del engines["Open3D"]
    try:
        import mujoco  # noqa: F401
    except ImportError:
        del engines["MuJoCo"]
    return engines


@dataclass
class Report:
    """The table: for each group of cases and each engine a verdict, and the leaks of closed meshes."""

    rows: dict[str, dict[str, Verdict | None]] = field(default_factory=dict)
    leaks: dict[str, dict[str, tuple[int, int]]] = field(default_factory=dict)

    def to_markdown(self) -> str:
        """Return the tables as Markdown: wrong decisions and, of those decided rightly, the worst error of t in ulp."""
        engines = list(next(iter(self.rows.values())))
        lines = [
            "Wrong decisions and, in brackets, the worst error of t in ulp where the decision was right.",
            "A dash: the engine has no such shape, or decided nothing rightly.",
            "",
            f"| case | rays | {' | '.join(engines)} |",
            f"|---|---:|{'---:|' * len(engines)}",
        ]
        for group, verdicts in self.rows.items():
            rays = max(v.rays for v in verdicts.values() if v is not None)
            cells = ["—" if v is None else f"{v.wrong} ({_ulps(v)})" for v in verdicts.values()]
            lines.append(f"| {group} | {rays} | {' | '.join(cells)} |")
        if self.leaks:
            engines = list(next(iter(self.leaks.values())))
            lines += [
                "",
                "Leaks: rays from inside closed meshes, to vertices, edges and centroids, that hit nothing.",
                "",
            ]
            lines += [f"| offset, m | rays | {' | '.join(engines)} |", f"|---|---:|{'---:|' * len(engines)}"]
            for offset, counts in self.leaks.items():
                rays = next(iter(counts.values()))[1]
                lines.append(f"| {offset} | {rays} | {' | '.join(str(leaked) for leaked, _ in counts.values())} |")
        return "\n".join(lines) + "\n"

    def errs(self, engine: str) -> bool:
        """Return whether an engine decides or rounds wrongly, leaks, or cannot answer."""
        leaks = sum(counts[engine][0] for counts in self.leaks.values())
        verdicts = [row[engine] for row in self.rows.values()]
        return leaks > 0 or any(verdict is None or verdict.errs for verdict in verdicts)


def _ulps(verdict: Verdict) -> str:
    if not verdict.values:
        return "—"
    if verdict.worst < 1000:
        return f"{verdict.worst:.3g}"
    return f"{verdict.worst:.0e}".replace("e+", "e") if math.isfinite(verdict.worst) else "∞"


def measure(groups: Iterable[cases.Case] | None = None, engines: dict[str, Engine] | None = None) -> Report:
    """Judge every engine on the hard cases.

    Parameters
    ----------
    groups : iterable of Case, optional
        The cases; by default `exact.cases.hard_cases`.
    engines : dict of str to callable, optional
        The engines; by default those of `ENGINES` that are installed.

    Returns
    -------
    Report
        One row per group.
    """
    engines = _available_engines() if engines is None else engines
    report = Report()
    for case in cases.hard_cases() if groups is None else groups:
        row = report.rows.setdefault(case.group, dict.fromkeys(engines))
        for name, engine in engines.items():
            t = engine(case.spec, case.origins, case.directions)
            if t is not None:
                verdict = row[name] or Verdict()
                verdict.add(judge_cast(case.spec, case.origins, case.directions, t))
                row[name] = verdict
    return report


def measure_leaks(offsets: dict[str, float] | None = None) -> dict[str, dict[str, tuple[int, int]]]:
    """Count rays that leave closed meshes, which stand at several offsets from the origin of coordinates.

    Parameters
    ----------
    offsets : dict of str to float, optional
        Offsets in metres by name; by default `exact.cases.OFFSETS`.

    Returns
    -------
    dict
        For each offset and engine, the number of leaks and of rays.
    """
    import lidarsim

    casters: dict[str, Callable[[Floats, Any, Floats, Floats], Floats]] = {
        "textbook": lambda v, f, o, d: _first_ahead(cases.Spec("TriangleMesh", (v, f)).textbook(o, d)),  # type: ignore[arg-type]
        "lidarsim": lambda v, f, o, d: np.asarray(lidarsim.TriangleMesh(v, f).cast(o, d).t),
    }
    if "Open3D" in _available_engines():
        casters["Open3D"] = _open3d_cast
    counts: dict[str, dict[str, tuple[int, int]]] = {}
    for offset, shift in (cases.OFFSETS if offsets is None else offsets).items():
        counts[offset] = dict.fromkeys(casters, (0, 0))
        for vertices, faces, inside in cases.closed_meshes().values():
            origins, directions = cases.leak_rays(vertices + shift, faces, inside + shift, np.random.default_rng(0))
            for name, caster in casters.items():
                leaked, rays = counts[offset][name]
                t = caster(vertices + shift, faces, origins, directions)
                counts[offset][name] = leaked + int(np.isinf(t).sum()), rays + len(t)
    return counts


def measure_random(rays: int, seed: int = 0, progress: Callable[[str], None] = lambda _: None) -> dict[str, Verdict]:
    """Judge lidarsim on random adversarial rays: every root, the nearest hit and its primitive, for each kind of shape.

    Parameters
    ----------
    rays : int
        Number of rays, shared equally by the kinds of shape.
    seed : int
        Seed of the generator; the same seed gives the same rays.
    progress : callable
        Called with a line of text now and then.

    Returns
    -------
    dict of str to Verdict
        A verdict a kind; `values` counts roots and nearest hits.
    """
    verdicts = {kind: Verdict() for kind in adversarial.KINDS}
    share = rays // len(adversarial.KINDS)
    for number, (kind, verdict) in enumerate(verdicts.items()):
        rng = np.random.default_rng((seed, number))
        while verdict.rays < share:
            case = adversarial.random_case(rng, kind, min(100, share - verdict.rays))
            shape = case.spec.build()
            hits = shape.cast(case.origins, case.directions)
            one = judge_cast(case.spec, case.origins, case.directions, hits.t, primitives=hits.primitive_id)
            roots = judge_roots(case.spec, case.origins, case.directions, shape.roots(case.origins, case.directions))
            roots.rays = roots.hits = 0
            one.add(roots)
            verdict.add(one)
        progress(f"{kind}: {_random_line(verdict)}")
    return verdicts


def _random_line(verdict: Verdict) -> str:
    line = f"{verdict.rays} rays, {verdict.hits} hits, {verdict.wrong} wrong, {verdict.values} values of t, "
    line += f"{verdict.values - verdict.rounded} not correctly rounded, worst {verdict.worst:.3g} ulp"
    return f"{line}; first: {verdict.first}" if verdict.first else line
