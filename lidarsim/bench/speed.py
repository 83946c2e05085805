"""Speed against error: lidarsim and its peers on the same rays, in one process, in turns.

``lidarsim bench --quick -o DIR`` takes about a minute on two cores. Without ``--quick`` it takes about half an hour and
goes up to ten million triangles.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.extras import import_extra
from lidarsim._base.terminal import paragraph
from lidarsim.bench import (
    building,
    changing,
    exact,
    frames,
    in_plane,
    motion,
    patterns,
    presets,
    realistic,
    report,
    robots,
    scenes,
)
from lidarsim.bench.exact import Truth
from lidarsim.bench.peers import CASTERS, Caster, Found, Lidarsim, Open3D, find_installed, threads_kept
from lidarsim.bench.scenes import Rays, World

Progress = Callable[[str], None]
Row = dict[str, Any]

MESHES: dict[str, Callable[..., World]] = {"city": scenes.city, "terrain": scenes.terrain, "scans": scenes.scans}
FINE = 1.0  # mm: greatest median error of the tessellation that represents Open3D among the analytic shapes


@dataclass(frozen=True)
class Plan:
    """The size of the measurement.

    Attributes
    ----------
    triangles : int or None
        Size of the three meshes; None for their nominal sizes.
    shapes : int
        Number of shapes of the analytic scene, without its ground.
    columns : tuple of int
        Columns of the lidars of 128 and of 16 channels.
    random : int
        Number of random rays.
    levels : tuple of int
        Icosphere levels of the tessellations.
    sizes : tuple of int
        Triangles of the terrains, for the growth of the cost.
    distances : tuple of float
        Distances from the origin of coordinates at which errors are measured, m.
    threads : tuple of int
        Threads to cast with.
    rounds : int
        Turns of each method; the median counts.
    seconds : float
        A method that has used this time in a comparison skips its further turns.
    builds : int
        Number of builds of each mesh.
    scenes : int
        Number of random scenes that are built and scanned.
    robots : int
        Number of robots that scan at once.
    memory : tuple of str
        Meshes whose memory is measured, each in a fresh process.
    sample : int
        Greatest number of judged rays per comparison.
    """

    triangles: int | None = None
    shapes: int = 400
    columns: tuple[int, int] = (1024, 1800)
    random: int = 200_000
    levels: tuple[int, ...] = (2, 3, 4, 5, 6)
    sizes: tuple[int, ...] = (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
    distances: tuple[float, ...] = (0.0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7)
    threads: tuple[int, ...] = (1, 2)
    rounds: int = 41
    seconds: float = 8.0
    builds: int = 7
    scenes: int = 200
    robots: int = robots.ROWS
    memory: tuple[str, ...] = tuple(MESHES)
    sample: int = 4000


FULL = Plan()
QUICK = Plan(
    levels=(1, 2, 3, 4, 5),
    sizes=(10_000, 100_000, 1_000_000),
    rounds=5,
    seconds=0.15,
    builds=1,
    scenes=20,
    memory=("city",),
    sample=200,
)


@dataclass(frozen=True)
class Error:
    """Errors of a method on the judged rays.

    Attributes
    ----------
    rays, hits : int
        Judged rays, and those with an exact hit.
    lost, invented : int
        Hits that were not found, and reported hits that do not exist.
    other : int or None
        Hits on a triangle or object other than the nearest; None if the method does not report what it hit.
    median_mm, p99_mm, max_mm : float or None
        Error of the range over the telling hits that were found, mm; None if there are none.
    max_ulp : float or None
        Largest error of the range over all hits that were found, in ulp of its float64.
    """

    rays: int
    hits: int
    lost: int
    invented: int
    other: int | None
    median_mm: float | None
    p99_mm: float | None
    max_mm: float | None
    max_ulp: float | None


@dataclass(frozen=True)
class Speed:
    """One method on one set of rays: million rays per second (median cast), ratio to Open3D, and errors."""

    scene: str
    triangles: int
    rays: str
    threads: int
    method: str
    one_thread: bool
    mrays: float
    ratio: float | None
    reference: bool
    error: Error


@dataclass(frozen=True)
class Build:
    """One method's time from arrays to the first answered ray, Open3D's time relative to it, and bytes per triangle.

    `resident` is the growth of a fresh process, `counted` the memory counted by lidarsim's core.
    """

    scene: str
    triangles: int
    method: str
    seconds: float
    ratio: float | None
    resident: float | None
    counted: float | None


def interleave(
    calls: Mapping[str, Callable[[], Any]],
    rounds: int,
    seconds: float,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Run the calls in turns, as many as `rounds`, and return the median time of each, s.

    A call that has taken `seconds` in total skips its further turns.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            if sum(times[name]) < seconds:
                begin = clock()
                call()
                times[name].append(clock() - begin)
    return {name: statistics.median(values) for name, values in times.items()}


def judge(truth: Truth, found: Found) -> Error:
    """Compare the hits of a method with the exact hits of the same rays."""
    t, surface = found
    rounded = np.array([math.inf if s is None else float(s) for s in truth.t])
    hit, said = np.isfinite(rounded), np.isfinite(t)
    both = hit & said
    pairs = zip(truth.t, t.tolist(), strict=True)
    ulps = np.array([exact.ulps(s, v) for s, v in pairs if s is not None and math.isfinite(v)])
    mm = (ulps * np.spacing(rounded[both]) * 1e3)[truth.telling[both]]
    return Error(
        rays=len(t),
        hits=int(hit.sum()),
        lost=int((hit & ~said).sum()),
        invented=int((said & ~hit).sum()),
        other=None if surface is None else int((surface != truth.surface)[both].sum()),
        median_mm=float(np.median(mm)) if len(mm) else None,
        p99_mm=float(np.percentile(mm, 99)) if len(mm) else None,
        max_mm=float(mm.max()) if len(mm) else None,
        max_ulp=float(ulps.max()) if len(ulps) else None,
    )


class _Run:
    """The measurements of one process."""

    def __init__(self, plan: Plan, progress: Progress) -> None:
        self.plan, self.progress = plan, progress
        self.casters, self.states = find_installed()
        self.speed: list[Speed] = []
        self.builds: list[Build] = []
        self.scaling: list[Row] = []
        self.presets: list[Row] = []
        self.stand_in: str | None = None  # the tessellation that represents Open3D

    def meshes(self) -> None:
        """Measure the three meshes, near the origin of coordinates and far from it."""
        for make in MESHES.values():
            world = self._world(make)
            methods = self._build(world, self.plan.builds)
            for rays in self._rays(world):
                self.speed += self._compare(world, rays, methods, self.plan.threads)
            self._scale(world, self._rays(world)[0], methods["lidarsim"])
            self._sensors(world, methods)
            world = self._world(make, scenes.UTM)
            methods = self._build(world, 0)
            self.speed += self._compare(world, self._rays(world)[0], methods, self.plan.threads[-1:])

    def analytic(self) -> None:
        """Measure the analytic shapes and their tessellations."""
        for offset in ((0.0, 0.0, 0.0), scenes.UTM):
            world = scenes.analytic(self.plan.shapes, offset)
            methods = self._build(world, int(not world.far))
            for level in self.plan.levels if "Open3D" in self.casters else ():
                if not world.far or _level(level) == self.stand_in:
                    methods[_level(level)] = _Tessellation(world.tessellate(level), self.plan.threads[-1])
            threads, sets = (self.plan.threads[-1:], 1) if world.far else (self.plan.threads, 3)
            for rays in self._rays(world)[:sets]:
                self.speed += self._compare(world, rays, methods, threads)

    def _scale(self, world: World, rays: Rays, caster: Caster) -> None:
        """Measure the speed-up by more threads, in turns."""
        self.progress(f"{world.name}: threads")
        times = interleave(
            {str(n): partial(caster.cast, caster.prepare(rays), n) for n in self.plan.threads},
            self.plan.rounds,
            self.plan.seconds,
        )
        alone = times[str(self.plan.threads[0])]
        self.scaling += [
            {
                "scene": world.name,
                "rays": rays.name,
                "threads": int(n),
                "mrays": len(rays) / seconds / 1e6,
                "ratio": alone / seconds,
            }
            for n, seconds in times.items()
        ]

    def _sensors(self, world: World, methods: dict[str, Caster]) -> None:
        """Measure the rays of sensors beside Open3D."""
        self.progress(f"{world.name}: sensors")
        casters = {name: caster for name, caster in methods.items() if name in {"lidarsim", "Open3D"}}
        what = presets.calls(world, casters, self.plan.threads[-1])
        self.presets += presets.over(self._time(what), world)

    def sizes(self) -> list[Speed]:
        """Measure terrains with increasing numbers of triangles."""
        rows: list[Speed] = []
        for triangles in self.plan.sizes:
            world = scenes.terrain(triangles)
            methods = self._build(world, 0)
            rows += self._compare(world, self._rays(world)[0], methods, self.plan.threads[-1:])
        return rows

    def distances(self) -> list[Row]:
        """Measure errors of the range at increasing distances from the origin of coordinates."""
        found: list[Row] = []
        for distance in self.plan.distances:
            world = scenes.terrain(10_000, (distance, 0.0, 0.0))
            rows = self._compare(
                world, scenes.lidar(world, 16, 250, math.pi / 6), self._build(world, 0), self.plan.threads[-1:]
            )
            found += [{"distance": distance, "method": row.method, "error": asdict(row.error)} for row in rows]
        return found

    def whole_scan(self) -> list[Row]:
        """Measure whole scans relative to the bare cast of the same rays."""
        import lidarsim as ls

        world = self._world(scenes.city)
        pattern = scenes.spinning(128, self.plan.columns[0], math.pi / 4)
        rays = self._rays(world)[0]
        caster = Lidarsim(world, self.plan.threads[-1])
        pose = np.eye(4)
        pose[:3, 3] = world.sensor
        noise = ls.Measurement(range_sigma=0.02)
        effects = ls.Measurement(
            range_sigma=0.02,
            range_sigma_slope=1e-4,
            range_bias=0.01,
            range_resolution=0.004,
            azimuth_sigma=1e-4,
            elevation_sigma=1e-4,
            dropout=0.01,
            detection=ls.Detection(0.1, 100.0),
            extinction=1e-4,
        )
        beam = replace(effects, beam=ls.Beam(3e-3, rays=7), returns="dual")

        def scan(measurement: ls.Measurement) -> ls.Scan:
            return ls.Lidar(pattern, measurement=measurement).scan(caster.scene, pose, seed=1)

        calls: dict[str, Callable[[], Any]] = {
            "Scene.cast": lambda: caster.cast(rays, self.plan.threads[-1]),
            "Lidar.scan, range noise": lambda: scan(noise),
            "Lidar.scan, range noise, point_cloud": lambda: scan(noise).point_cloud(),
            "Lidar.scan, every effect but the beam": lambda: scan(effects),
            "Lidar.scan, every effect, beam of 7 rays": lambda: scan(beam),
        }
        times = self._time(calls)
        return [
            {"what": name, "rays": len(rays), "seconds": s, "ratio": s / times["Scene.cast"]}
            for name, s in times.items()
        ]

    def overlapping_instances(self) -> list[Row]:
        """Measure overlapping instances of one mesh, and the same triangles merged into one mesh, as Open3D needs."""
        import lidarsim as ls

        world = scenes.instances(*(() if self.plan.triangles is None else (self.plan.triangles,)))
        whole, rays, threads = scenes.merge(world), self._rays(world)[0], self.plan.threads[-1]
        self.progress(f"{len(world.shapes)} instances")
        shape, scene = ls.TriangleMesh(*world.shapes[0].args), ls.Scene()
        for spec in world.shapes:
            scene.add(shape, transform=spec.transform)
        casters: dict[str, Caster] = {"lidarsim, one mesh": Lidarsim(whole, threads)}
        if "Open3D" in self.casters:
            casters["Open3D, one mesh"] = self.casters["Open3D"](whole, threads)
        ready = {name: caster.prepare(rays) for name, caster in casters.items()}
        own = "lidarsim, instances"
        calls: dict[str, Callable[[], Any]] = {own: partial(scene.cast, rays.origins, rays.directions)}
        calls |= {name: partial(caster.cast, ready[name], threads) for name, caster in casters.items()}
        placed, count = calls[own](), len(shape.faces)
        triangle = np.where(placed.hit, count * placed.object_id.astype(np.int64) + placed.primitive_id, -1)
        found: dict[str, Found] = {own: (placed.t, triangle)}
        found |= {name: caster.convert(calls[name]()) for name, caster in casters.items()}
        times = interleave(calls, self.plan.rounds, self.plan.seconds)
        rows = []
        for name, seconds in times.items():
            t, surface = found[name]
            both = placed.hit & np.isfinite(t)
            rows.append(
                {
                    "what": name,
                    "rays": len(rays),
                    "triangles": whole.triangles,
                    "hits": int(np.isfinite(t).sum()),
                    "ns": seconds / len(rays) * 1e9,
                    "ratio": times["Open3D, one mesh"] / seconds if "Open3D" in self.casters else None,
                    "other": int((np.asarray(surface) != triangle)[both].sum()),
                    "off_mm": float(np.abs(t[both] - placed.t[both]).max() * 1e3),
                }
            )
        return rows

    def coincident_surfaces(self) -> list[Row]:
        """Measure scenes with coincident surfaces relative to the scenes without the second surface."""
        import lidarsim as ls

        rows, rays = [], scenes.downward(self.plan.columns[0] * 64)
        _native.set_threads(self.plan.threads[-1])
        for name, pair in scenes.coincident(self.plan.triangles or 130_000).items():
            self.progress(f"coincident surfaces: {name}")
            built = {"once": ls.Scene(), "twice": ls.Scene()}
            for scene, specs in zip(built.values(), pair, strict=True):
                for spec in specs:
                    scene.add(spec.build())
            calls = {key: partial(scene.cast, rays.origins, rays.directions) for key, scene in built.items()}
            once, twice = (call() for call in calls.values())
            times = interleave(calls, self.plan.rounds, self.plan.seconds)
            rows.append(
                {
                    "what": name,
                    "rays": len(rays),
                    "hits": int(np.isfinite(once.t).sum()),
                    "ns": times["twice"] / len(rays) * 1e9,
                    "ratio": times["twice"] / times["once"],
                    "wrong": int(((once.t != twice.t) | (once.primitive_id != twice.primitive_id)).sum()),
                }
            )
        return rows

    def lines_of_sight(self) -> list[Row]:
        """Measure occlusion queries relative to casts for the nearest hit."""
        rows, world = [], self._world(scenes.city)
        scene = Lidarsim(world, self.plan.threads[-1]).scene
        for rays in self._rays(world)[::2]:
            self.progress(f"lines of sight: {rays.name} rays")
            calls = {
                call: partial(getattr(scene, call), rays.origins, rays.directions) for call in ("cast", "occluded")
            }
            hits, dark = (call() for call in calls.values())
            times = interleave(calls, self.plan.rounds, self.plan.seconds)
            rows.append(
                {
                    "rays": rays.name,
                    "hits": int(hits.hit.sum()),
                    "cast": times["cast"] / len(rays) * 1e9,
                    "occluded": times["occluded"] / len(rays) * 1e9,
                    "ratio": times["cast"] / times["occluded"],
                    "wrong": int((hits.hit != dark).sum()),
                }
            )
        return rows

    def moving(self) -> list[Row]:
        """Measure moving scenes relative to the same scenes at rest."""
        world = self._world(scenes.city)
        caster = Lidarsim(world, self.plan.threads[-1])
        self.progress("motion")
        what = motion.calls(caster.scene, world.sensor, scenes.spinning(128, self.plan.columns[0], math.pi / 4))
        return motion.over(self._time(motion.unpaired(what)), what)

    def labelled_frames(self) -> list[Row]:
        """Measure labelled frames relative to their scans, on one thread and in its time of the processor."""
        self.progress("labelled frames")
        _native.set_threads(1)
        with ExitStack() as files:
            what = frames.calls(files)
            return motion.over(self._time(motion.unpaired(what), time.process_time), what)

    def changing_scenes(self) -> list[Row]:
        """Measure changes of scenes between frames, on one thread and in its time of the processor."""
        self.progress("scenes that change")
        _native.set_threads(1)
        what = changing.calls(self.casters, 1)
        return motion.over(self._time(motion.unpaired(what), time.process_time), what)

    def many_robots(self) -> list[Row]:
        """Measure the scans of many robots in one call."""
        self.progress("robots")
        _native.set_threads(self.plan.threads[-1])
        what = robots.calls(self.casters, self.plan.threads[-1], self.plan.robots)
        return robots.over(self._time(motion.unpaired(what)), what, self.plan.robots)

    def rays_in_planes(self) -> list[Row]:
        """Measure rays that lie in the plane of a surface."""
        self.progress("rays in planes")
        _native.set_threads(self.plan.threads[-1])
        return in_plane.over(self._time(in_plane.calls()))

    def new_frames(self) -> list[Row]:
        """Measure the pulses of new frames, and their scans relative to casts."""
        world = self._world(scenes.city)
        self.progress("patterns")
        _native.set_threads(1)
        return patterns.over(self._time(patterns.calls(Lidarsim(world, 1).scene, world.sensor)))

    def real_sensors(self) -> list[Row]:
        """Measure scans with the noise and beam of real units relative to those without, and beside Open3D."""
        world, threads = self._world(scenes.city), self.plan.threads[-1]
        self.progress("realistic")
        own = Lidarsim(world, threads)
        peers = {"Open3D": self.casters["Open3D"](world, threads)} if "Open3D" in self.casters else {}
        return realistic.over(self._time(realistic.calls(world, own.scene, peers, threads)))

    def random_scenes(self) -> list[Row]:
        """Measure the share of building in the total time of scenes that are scanned once."""
        rows: list[Row] = []
        for threads in self.plan.threads:
            self.progress(f"random scenes, {threads} threads")
            _native.set_threads(threads)
            rows += [{"threads": threads, **row} for row in building.rows(self.plan.scenes, self.plan.builds)]
        return rows

    def _time(
        self, calls: Mapping[str, Callable[[], Any]], clock: Callable[[], float] = time.perf_counter
    ) -> dict[str, float]:
        """Return the median time of each call, after calling each once."""
        for call in calls.values():
            call()
        return interleave(calls, self.plan.rounds, self.plan.seconds, clock)

    def _world(self, make: Callable[..., World], offset: npt.ArrayLike = (0.0, 0.0, 0.0)) -> World:
        return make(offset=offset) if self.plan.triangles is None else make(self.plan.triangles, offset)

    def _rays(self, world: World) -> list[Rays]:
        many, few = self.plan.columns
        return [
            scenes.lidar(world, 128, many, math.pi / 4),
            scenes.lidar(world, 16, few, math.pi / 6),
            scenes.random_rays(world, self.plan.random),
        ]

    def _build(self, world: World, rounds: int) -> dict[str, Caster]:
        """Build every caster that can represent the world; record time and memory if `rounds` is above 0."""
        self.progress(f"{world.name}, {world.triangles or len(world.shapes):,}: building")
        threads, one = self.plan.threads[-1], scenes.lidar(world, 1, 1, 0.0)
        built: list[tuple[str, Caster]] = []  # kept, so that no build pays for freeing another

        def build(name: str) -> None:
            caster = self.casters[name](world, threads)
            caster.cast(caster.prepare(one), threads)
            built.append((name, caster))

        calls = {name: partial(build, name) for name, kind in self.casters.items() if kind.serves(world)}
        times = interleave(calls, max(rounds, 1), math.inf)
        methods = dict(built)
        for name, seconds in times.items() if rounds else ():
            caster = methods[name]
            self.builds.append(
                Build(
                    scene=world.name,
                    triangles=world.triangles,
                    method=name,
                    seconds=seconds,
                    ratio=times["Open3D"] / seconds if "Open3D" in times else None,
                    resident=_resident(name, world) if world.name in self.plan.memory else None,
                    counted=caster.bytes() / world.triangles if isinstance(caster, Lidarsim) and world.mesh else None,
                )
            )
        return methods

    def _compare(self, world: World, rays: Rays, methods: dict[str, Caster], threads: Sequence[int]) -> list[Speed]:
        """Cast the rays with every capable method, in turns, and judge the answers."""
        self.progress(f"{world.name}, {world.triangles or len(world.shapes):,}: {rays.name} rays")
        methods = {name: caster for name, caster in methods.items() if rays.one_origin or caster.any_origin}
        stride = max(caster.stride for caster in methods.values())
        groups = len(rays) // stride
        judged = stride * np.random.default_rng(0).choice(groups, min(self.plan.sample, groups), replace=False)
        truth = exact.first_hits(world, rays[judged])
        ready = {name: caster.prepare(rays[:: caster.stride]) for name, caster in methods.items()}
        rows: list[Speed] = []
        for n in threads:
            calls = {name: partial(caster.cast, ready[name], n) for name, caster in methods.items()}
            errors = {name: judge(truth, _at(judged, caster, calls[name]())) for name, caster in methods.items()}
            times = interleave(calls, self.plan.rounds, self.plan.seconds)
            mrays = {name: -(-len(rays) // methods[name].stride) / seconds / 1e6 for name, seconds in times.items()}
            reference = self._reference(errors)
            rows += [
                Speed(
                    scene=world.name,
                    triangles=caster.triangles or world.triangles,
                    rays=rays.name,
                    threads=n,
                    method=name,
                    one_thread=caster.one_thread,
                    mrays=mrays[name],
                    ratio=mrays[name] / mrays[reference] if reference else None,
                    reference=name == reference,
                    error=errors[name],
                )
                for name, caster in methods.items()
            ]
        return rows

    def _reference(self, errors: dict[str, Error]) -> str | None:
        """Return the method for Open3D: among tessellations, the coarsest within `FINE`, else the finest."""
        if "Open3D" in errors:
            return "Open3D"
        if self.stand_in is None:
            names = [name for name in errors if name.startswith("Open3D")]
            fine = [name for name in names if (median := errors[name].median_mm) is not None and median <= FINE]
            self.stand_in = next(iter(fine or names[-1:]), None)
        return self.stand_in


class _Tessellation(Open3D):
    """Open3D on the tessellation of a world; it reports the object of each triangle."""

    def __init__(self, world: World, threads: int) -> None:
        super().__init__(world, threads)
        self.triangles = world.triangles
        self.owner = world.owner

    def convert(self, answer: Any) -> Found:
        """Return t and the object."""
        t, triangle = super().convert(answer)
        hit = np.isfinite(t)
        surface = np.full(len(t), -1)
        surface[hit] = np.asarray(self.owner)[np.asarray(triangle)[hit]]
        return t, surface


def _level(level: int) -> str:
    return f"Open3D, icosphere {level}"


def _at(judged: Any, caster: Caster, answer: Any) -> Found:
    """Return the answers for the judged rays, which are multiples of the stride of every caster."""
    t, surface = caster.convert(answer)
    rows = judged // caster.stride
    return t[rows], None if surface is None else surface[rows]


def _resident(method: str, world: World) -> float | None:
    """Return the growth of a fresh process that builds the world, bytes per triangle; None except on Linux."""
    if not Path("/proc/self/statm").exists():
        return None
    code = f"from lidarsim.bench import speed; speed.print_growth({method!r}, {world.name!r}, {world.triangles})"
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    return float(output.stdout.split()[-1])


def print_growth(method: str, name: str, triangles: int) -> None:
    """Print the result of `_resident`. Call it in a separate process."""
    kind = CASTERS[method]
    kind.load()

    def build(world: World) -> Caster:
        caster = kind(world, 1)
        caster.cast(caster.prepare(scenes.lidar(world, 1, 1, 0.0)), 1)
        return caster

    build(scenes.terrain(100))  # excludes one-time allocations of the libraries
    world = MESHES[name](triangles)
    before = _pages()
    caster = build(world)
    growth = _pages() - before
    sys.stdout.write(f"\n{growth / world.triangles}\n")
    del caster


def _pages() -> int:
    """Return the resident memory of this process after releasing unused memory, bytes."""
    gc.collect()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def measure(plan: Plan, progress: Progress = lambda _: None) -> dict[str, Any]:
    """Measure everything, and return the figures in the format of `lidarsim.bench.report`.

    `progress` is called with a line of text at each step.
    """
    with threads_kept():
        bench = _Run(plan, progress)
        began = time.perf_counter()
        bench.meshes()
        bench.analytic()
        results = {
            "machine": report.machine(),
            "plan": asdict(plan),
            "casters": bench.states,
            "speed": [asdict(row) for row in bench.speed],
            "growth": [asdict(row) for row in bench.sizes()],
            "distance": bench.distances(),
            "builds": [asdict(row) for row in bench.builds],
            "scan": bench.whole_scan(),
            "instances": bench.overlapping_instances(),
            "coincident": bench.coincident_surfaces(),
            "motion": bench.moving(),
            "frames": bench.labelled_frames(),
            "changing": bench.changing_scenes(),
            "robots": bench.many_robots(),
            "in_plane": bench.rays_in_planes(),
            "patterns": bench.new_frames(),
            "presets": bench.presets,
            "realistic": bench.real_sensors(),
            "sight": bench.lines_of_sight(),
            "scaling": bench.scaling,
            "scenes": bench.random_scenes(),
            "seconds": round(time.perf_counter() - began, 1),
        }
        progress("")
        return results


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="lidarsim bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="take about a minute, in place of about half an hour")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="DIR", default=Path("out/bench"), help="folder to write to"
    )
    parser.add_argument(
        "--from", dest="known", type=Path, metavar="JSON", help="report an earlier run; measure nothing"
    )
    options = parser.parse_args(arguments)
    import_extra("matplotlib", "bench", "the plot")  # fail before the measurement, not after it
    options.output.mkdir(parents=True, exist_ok=True)
    if options.known is None:
        results = measure(QUICK if options.quick else FULL, _show if sys.stderr.isatty() else lambda _: None)
    else:
        results = json.loads(options.known.read_text(encoding="utf-8"))
    report.write(results, options.output)
    for line in [*report.summary(results).split("\n"), "", f"The tables are in {options.output / 'speed.md'}."]:
        paragraph(line)
    return 0


def _show(line: str) -> None:
    sys.stderr.write(f"\r\033[K{time.process_time():4.0f} s  {line}" if line else "\r\033[K")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
