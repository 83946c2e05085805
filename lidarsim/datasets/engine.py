"""Making the shards of a data set, in this process or on the workers of a Dask cluster."""

from __future__ import annotations

import dataclasses
import errno
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.extras import import_extra
from lidarsim._base.files import format_error
from lidarsim.datasets import manifest
from lidarsim.datasets.layouts import Files
from lidarsim.datasets.samples import RANGES, Record
from lidarsim.datasets.sampling import samples
from lidarsim.datasets.scattered import Scattered
from lidarsim.datasets.store import causes
from lidarsim.errors import LidarsimError

if TYPE_CHECKING:
    from distributed import Client

    from lidarsim.datasets.manifest import Plan
    from lidarsim.datasets.recipe import Recipe

TRIES = 3
SUBMITTED = 2
"""Shards submitted for each thread of a worker: one is made, and one waits."""

START = 300
"""Longest that the workers of this machine may take to start, s: idle, they take three."""

LOOKAHEAD = 1000
"""Shards among which the next one of a worker is chosen."""

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@dataclass(frozen=True)
class Made:
    """Result of a shard: what was made and, if it failed, the `problem` and its frame.

    `full` means that the disk is full, so that nothing more can be made; `scattered` has the counts of the sequences
    that begin in the shard.
    """

    shard: int
    frames: int = 0
    points: int = 0
    problem: str = ""
    sequence: int = 0
    frame: int = 0
    seed: int = 0
    full: bool = False
    scattered: Scattered = field(default_factory=Scattered)

    def __str__(self) -> str:
        """Return the problem in one line."""
        return f"sequence {self.sequence}, frame {self.frame} (seed {self.seed}): {self.problem}"


def make_shard(plan: Plan, shard: int, tell: Callable[[int, int], object]) -> Made:
    """Make the frames of a shard, then record that it is done."""
    recipe = plan.recipe
    labels: Counter[int] = Counter()
    ranges = np.zeros(len(RANGES) - 1, np.int64)
    records: list[Record] = []
    sequence, frame, seed = 0, 0, recipe.seed
    made: list[int] = []
    scattered = Scattered()
    try:
        with plan.store.batch() as store, recipe.layout.writer(files := Files(store), shard) as write:
            for sequence, frames in recipe.shard(shard):
                for step in [range(k, k + 1) for k in frames] if recipe.source.by_frame else [frames]:
                    frame = step[0]
                    run = recipe.source.run(sequence, step[0])
                    recipe.layout.check(run)
                    seed, first = run.seed, run.frames.start
                    scans = dataclasses.replace(run, frames=range(first + step.start, first + step.stop)).scans()
                    for frame in step:
                        points = 0
                        for sample in samples(recipe, run, sequence, frame, next(scans)):
                            records.append(dataclasses.replace(sample.record, extra=write(sample)))
                            labels.update(_count(np.asarray(sample.cloud.label)))
                            ranges += _histogram(sample.cloud.range)
                            points += sample.record.points
                        tell(1, points)
                        made.append(points)
                if frames.start == 0:
                    scattered += recipe.source.scatter_counts(sequence)
        part = {
            "recipe": plan.head.recipe,
            "shard": shard,
            "files": files.entries,
            "records": records,
            "labels": {str(label): count for label, count in sorted(labels.items())},
            "ranges": ranges.tolist(),
            "scattered": scattered,
        }
        manifest.write_part(plan.store, manifest.Part.model_validate(part))
    except Exception as error:  # noqa: BLE001 - any error is reported with its frame
        return Made(shard, len(made), sum(made), _describe(error), sequence, frame, seed, _full(error))
    return Made(shard, len(made), sum(made), scattered=scattered)


def _count(labels: npt.NDArray[np.uint32]) -> dict[int, int]:
    """Return the number of points by label."""
    if labels.max(initial=0) < len(labels):  # without sorting them
        counts = np.bincount(labels)
        return {label: int(counts[label]) for label in np.flatnonzero(counts).tolist()}
    values, numbers = np.unique(labels, return_counts=True)
    return dict(zip(values.tolist(), numbers.tolist(), strict=True))


def _histogram(ranges: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Return the numbers of ranges between the edges `RANGES`, as `numpy.histogram`, which sorts them, does."""
    below = [np.count_nonzero(ranges < edge) for edge in RANGES[:-1]]
    return np.diff([*below, np.count_nonzero(ranges <= RANGES[-1])])


def _describe(error: BaseException) -> str:
    if isinstance(error, OSError):
        return format_error(error)
    return str(error) if isinstance(error, LidarsimError) else f"{type(error).__name__}: {error}"


def _full(error: BaseException) -> bool:
    """Return whether an error is, or was caused by, a full disk."""
    return any(isinstance(one, OSError) and one.errno in FULL for one in causes(error))


def make(
    plan: Plan, shards: Iterable[int], client: Client | None, tell: Callable[[int, int], object]
) -> Iterator[Made]:
    """Make shards, and yield the result of each as it ends; a failing shard is tried three times in all.

    Parameters
    ----------
    plan : Plan
        The data set.
    shards : iterable of int
        Numbers of the shards.
    client : dask.distributed.Client or None
        Client whose workers make the shards; None for this process.
    tell : callable
        Called with the numbers of new frames and points.

    Raises
    ------
    LidarsimError
        If the scheduler is lost.
    OSError
        If the disk is full.
    """
    return _here(plan, shards, tell) if client is None else _there(plan, shards, client, tell)


def _here(plan: Plan, shards: Iterable[int], tell: Callable[[int, int], object]) -> Iterator[Made]:
    for shard in shards:
        for _ in range(TRIES):
            made = make_shard(plan, shard, tell)
            if not made.problem:
                break
            if made.full:
                raise OSError(made.problem)
            tell(-made.frames, -made.points)
        yield made


def _there(plan: Plan, shards: Iterable[int], client: Client, tell: Callable[[int, int], object]) -> Iterator[Made]:
    distributed = import_extra("distributed", "cluster", "a cluster")
    lost = CancelledError, distributed.client.ClosedClientError, distributed.comm.CommClosedError
    try:
        yield from _submit(plan, shards, client, tell)
    except lost:
        raise LidarsimError("lost the connection to the scheduler: run the same command again to resume") from None


def _submit(plan: Plan, shards: Iterable[int], client: Client, tell: Callable[[int, int], object]) -> Iterator[Made]:
    distributed = import_extra("distributed", "cluster", "a cluster")
    pickled = import_extra("cloudpickle", "cluster", "a cluster").dumps(plan)
    tries, choice = Counter[int](), Choice(plan.recipe, shards)
    submitted: dict[Any, tuple[str | None, int]] = {}
    """The worker that each future was meant for, and its shard."""
    futures = distributed.as_completed()

    def submit(worker: str | None) -> bool:
        shard = choice.next(worker, {shard for _, shard in submitted.values()})
        if shard is None:
            return False
        # Other workers take over the shards of one that is busy or gone.
        wish = {"workers": worker, "allow_other_workers": True} if worker else {}
        future = client.submit(_task, pickled, shard, pure=False, **wish)
        submitted[future.key] = worker, shard
        futures.add(future)
        return True

    def fill() -> None:
        for worker, threads in client.nthreads().items():  # type: ignore[no-untyped-call]
            for _ in range(SUBMITTED * threads - sum(worker == theirs for theirs, _ in submitted.values())):
                if not submit(worker):
                    return
        if not submitted:  # no worker has come yet
            submit(None)

    if isinstance(client.cluster, distributed.LocalCluster):  # its workers may still be starting
        try:
            client.wait_for_workers(len(client.cluster.worker_spec), timeout=START)
        except TimeoutError as late:  # its message has the numbers of workers
            raise LidarsimError(f"expected all workers to start within {START} s, but {late}") from None
    fill()
    for future in futures:
        _, shard = submitted.pop(future.key)
        if future.status == "error":
            error = future.exception()
            sequence, frames = next(plan.recipe.shard(shard))
            made = Made(shard, 0, 0, _describe(error), sequence, frames[0], plan.recipe.seed)
        else:
            made = future.result()
        if made.full:
            raise OSError(made.problem)
        tries[shard] += 1
        again = made.problem and tries[shard] < TRIES
        if again:
            choice.add(shard)
        fill()
        if again:
            continue
        if not made.problem:
            tell(made.frames, made.points)
        yield made


class Choice:
    """The order in which workers get shards: each continues its own sequence if it can.

    A worker keeps the run of its last sequence. If shards were made in the order of their numbers, each worker would
    build the run of every sequence.
    """

    def __init__(self, recipe: Recipe, shards: Iterable[int]) -> None:
        self._recipe, self._shards = recipe, iter(shards)
        self._waiting: dict[int, int] = {}
        """The first sequence of each of the next shards."""
        self._last: dict[str | None, int] = {}
        """The last sequence of the last shard of each worker."""

    def add(self, shard: int) -> None:
        """Let a shard be chosen again."""
        self._waiting[shard] = self._sequences(shard)[0]

    def next(self, worker: str | None, others: Iterable[int]) -> int | None:
        """Return the next shard for a worker; None if all are chosen.

        Parameters
        ----------
        worker : str or None
            Address of the worker, if there is one.
        others : iterable of int
            Shards that are being made.

        Returns
        -------
        int or None
            A shard of the worker's sequence, else of a sequence that none of `others` belongs to, else the first.
        """
        for shard in islice(self._shards, max(LOOKAHEAD - len(self._waiting), 0)):
            self.add(shard)
        if not self._waiting:
            return None
        own, taken = self._last.get(worker), {self._sequences(shard)[-1] for shard in others}
        ranks = ((first != own, first in taken, shard) for shard, first in self._waiting.items())
        *_, chosen = min(ranks)
        del self._waiting[chosen]
        self._last[worker] = self._sequences(chosen)[-1]
        return chosen

    def _sequences(self, shard: int) -> list[int]:
        return [sequence for sequence, _ in self._recipe.shard(shard)]


def _task(pickled: bytes, shard: int) -> Made:
    plan = _plan(pickled)
    if plan.versions != manifest.versions():
        raise LidarsimError(f"expected a worker with {plan.versions}, got one with {manifest.versions()}")
    return make_shard(plan, shard, lambda *_: None)


@lru_cache(maxsize=1)
def _plan(pickled: bytes) -> Plan:
    """Return a plan, cached between tasks, since it keeps the meshes that it loads."""
    plan: Plan = import_extra("cloudpickle", "cluster", "a cluster").loads(pickled)
    return plan
