"""Comparison of two builds of lidarsim: the same casts in two processes, in turns.

``lidarsim bench --against WHEEL`` reports the speed of this build relative to the other for each instruction set of the
machine, and whether both give the same bits. It measures the casts of ``lidarsim bench`` and some that are dominated by
the fixed cost of a ray. It takes about a minute on two cores.
"""

from __future__ import annotations

import argparse
import math
import os
import pickle
import statistics
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import lidarsim
from lidarsim.bench import report, scenes
from lidarsim.bench.scenes import Rays, Spec, World
from lidarsim.errors import ArgumentValueError

LEVELS = ("avx512", "avx2", "scalar")


@dataclass(frozen=True, eq=False)
class Cast:
    """Rays and their target shapes."""

    name: str
    shapes: tuple[Spec, ...]
    rays: Rays


@dataclass(frozen=True)
class Comparison:
    """One cast with one instruction set.

    Attributes
    ----------
    name, level : str
        The cast and the instruction set.
    before, now : float
        Median times per ray of the other build and of this one, ns.
    ratio : float
        Speed of this build relative to the other: the median over the turns.
    same : bool
        Whether both find the same hits to the last bit.
    """

    name: str
    level: str
    before: float
    now: float
    ratio: float
    same: bool


def casts(*, quick: bool = False) -> Iterator[Cast]:
    """Yield the casts to compare, from the cheapest rays to the most expensive; `quick`: a tenth of the triangles."""
    columns, few = 1024, 1800
    box = Spec("Box", (np.array([8.0, 6.0, 3.0]), np.zeros(3)))
    room = World("room", (box,), np.array([0.5, -0.4, 0.3]), np.array([-3.9, -2.9, -1.4]), np.array([3.9, 2.9, 1.4]))
    rays = scenes.lidar(room, 128, columns, math.pi / 4)
    above, upward = rays.origins + np.array([0.0, 0.0, 9.0]), rays.directions + np.array([0.0, 0.0, 2.0])
    ground = Spec("Plane", ((0.0, 0.0, 1.0), -1.5))
    walls = room.tessellate(0).shapes
    yield Cast("all miss", walls, Rays("upward", above, upward, one_origin=True))
    yield Cast("room of 12 triangles", walls, rays)
    yield Cast("plane", (ground,), rays)
    yield Cast("box", (box,), rays)
    share = 10 if quick else 1
    for make, triangles in ((scenes.city, 740_000), (scenes.terrain, 1_000_000), (scenes.scans, 718_000)):
        world = make(triangles // share)
        for rays in (
            scenes.lidar(world, 128, columns, math.pi / 4),
            scenes.lidar(world, 16, few, math.pi / 6),
            scenes.random_rays(world, 200_000 // share),
        ):
            yield Cast(f"{world.name}, {rays.name}", world.shapes, rays)
        if world.name == "terrain":
            yield from _from_above(world, 200_000 // share)
    world = scenes.analytic()
    yield Cast("400 shapes", world.shapes, scenes.lidar(world, 128, columns, math.pi / 4))
    world = scenes.instances(64_618 // share)
    yield Cast("50 instances that overlap", world.shapes, scenes.lidar(world, 128, columns, math.pi / 4))


def _from_above(world: World, count: int) -> Iterator[Cast]:
    """Yield vertical rays from an aircraft to ground moved by a transform, and slanted rays from an orbit."""
    draw, (mesh,) = np.random.default_rng(8), world.shapes
    ground, moved = draw.uniform(0.98 * world.low, 0.98 * world.high, (count, 3)), np.eye(4)
    moved[:3, 3] = 0.1, -0.7, 0.3
    down, slanted = np.array([0.0, 0.0, -1.0]), np.array([0.2, 0.1, -1.0])
    few = count // 100  # in some builds each of these rays visits the whole mesh
    rays = Rays("", ground[:few] - 900.0 * down, np.tile(down, (few, 1)), one_origin=False)
    yield Cast("moved terrain, downward", (replace(mesh, transform=moved),), rays)
    rays = Rays("", ground - 5e5 * slanted, np.tile(slanted, (count, 1)), one_origin=False)
    yield Cast("terrain, from 500 km", world.shapes, rays)


class _Worker:
    """A process that casts with the build in a given folder."""

    def __init__(self, folder: Path, level: str, file: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(folder), "LIDARSIM_ISA": level}
        # -P keeps the modules beside the script off the path.
        command = [sys.executable, "-P", str(Path(__file__).with_name("_worker.py")), str(file)]
        self.process = subprocess.Popen(  # noqa: S603
            command, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def ask(self, number: int) -> str:
        stdin, stdout = self.process.stdin, self.process.stdout
        assert stdin is not None  # noqa: S101
        assert stdout is not None  # noqa: S101
        stdin.write(f"{number}\n")
        stdin.flush()
        answer = stdout.readline()
        if not answer:
            raise RuntimeError("a build of lidarsim ended while it was measured; its error is above")
        return answer.strip()

    def __enter__(self) -> _Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


def compare(before: Path, now: Path, these: Sequence[Cast], levels: Sequence[str], rounds: int) -> Iterator[Comparison]:
    """Compare two builds, in folders with the package, on each cast with each instruction set, in `rounds` turns."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "casts"
        plain = [
            (
                [(spec.kind, spec.args, spec.transform) for spec in cast.shapes],
                (cast.rays.origins, cast.rays.directions),
            )
            for cast in these
        ]
        file.write_bytes(pickle.dumps(plain))
        for level in levels:
            with _Worker(before, level, file) as first, _Worker(now, level, file) as second:
                for number, cast in enumerate(these):
                    same = first.ask(number) == second.ask(number)
                    times: list[tuple[float, float]] = []
                    for turn in range(rounds):
                        # The builds go first in alternate turns.
                        order = (first, second) if turn % 2 else (second, first)
                        taken = {worker: float(worker.ask(number)) for worker in order}
                        times.append((taken[first], taken[second]))
                    ns = [statistics.median(column) / len(cast.rays) * 1e9 for column in zip(*times, strict=True)]
                    ratio = statistics.median(a / b for a, b in times)
                    yield Comparison(cast.name, level, ns[0], ns[1], ratio, same)


@contextmanager
def _unpack(path: Path) -> Iterator[Path]:
    """Yield a folder with the package from a wheel, or from a checkout with its built module."""
    with ExitStack() as stack:
        if path.is_file():
            if not zipfile.is_zipfile(path):
                raise ArgumentValueError("--against", "a wheel or a folder", path)
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            stack.enter_context(zipfile.ZipFile(path)).extractall(folder)
            path = folder
        if not list(path.glob("lidarsim/_native*")):
            raise ArgumentValueError("--against", "a build of lidarsim with its native module", path)
        yield path.resolve()


def main(arguments: Sequence[str]) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="lidarsim bench", description=__doc__)
    parser.add_argument(
        "--against", type=Path, required=True, metavar="WHEEL", help="the other build: a wheel, or a folder"
    )
    parser.add_argument("--quick", action="store_true", help="fewer turns, smaller meshes")
    options = parser.parse_args(arguments)
    machine = report.machine()
    levels = LEVELS[LEVELS.index(machine["instructions"]) :][:2]
    now = Path(lidarsim.__file__).parents[1]
    rows: list[Comparison] = []
    try:
        with _unpack(options.against) as before:
            these = list(casts(quick=options.quick))
            sys.stdout.write(f"{machine['cpu']}, {machine['cores']} cores; ns per ray\n\n")
            sys.stdout.write(f"{'':28}{'':8}{'before':>10}{'now':>10}{'ratio':>8}  bits\n")
            for row in compare(before, now, these, levels, 5 if options.quick else 21):
                rows.append(row)
                bits = "same" if row.same else "DIFFERENT"
                line = f"{row.name:28}{row.level:8}{row.before:10.1f}{row.now:10.1f}{row.ratio:8.3f}  {bits}\n"
                sys.stdout.write(line)
                sys.stdout.flush()
    except (OSError, ValueError, RuntimeError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    for level in levels:
        mean = statistics.geometric_mean(row.ratio for row in rows if row.level == level)
        sys.stdout.write(f"{'geometric mean':28}{level:8}{'':20}{mean:8.3f}\n")
    return int(not all(row.same for row in rows))
