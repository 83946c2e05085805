"""The Dask cluster of ``lidarsim generate``."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from lidarsim._base.extras import import_extra
from lidarsim._base.files import format_error
from lidarsim._base.validation import integer, short_repr
from lidarsim.cli.interrupts import ignore_interrupts
from lidarsim.errors import LidarsimError

if TYPE_CHECKING:
    from distributed import Client

PRELOAD = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); import lidarsim.datasets.recipe"
"""Code that workers run first. It ignores Ctrl-C, which reaches all processes of a terminal, as only the main one must
end the others; and it imports what their first task needs."""

LOCAL = {
    # With Dask's threshold, malloc returns each array to the system and gets zeroed pages again, which takes a sixth of
    # a worker's time; None restores the default of a process without Dask.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    # The profiler samples a hundred times per second, which takes a fortieth of a worker's time.
    "distributed.worker.profile.enabled": False,
    # By default the loops of scheduler, nannies and workers wake fifty times per second to time themselves, and read
    # memory and counters of the system ten times and twice: with two workers, a twelfth of a core.
    "distributed.admin.tick.interval": "1s",
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.admin.system-monitor.interval": "2s",
}
"""Dask's settings for workers on this machine."""

QUIET = ("distributed", "distributed.client", "tornado.application")
"""Loggers, each with a level of its own, of what lidarsim's errors report once. An interrupt may come before
distributed has the future that it then cancels, which the loop of tornado reports."""


@contextmanager
def cluster(workers: int | None, scheduler: str | None) -> Iterator[Client | None]:
    """Yield a Dask client: of `workers` single-threaded processes on this machine, or of an existing scheduler.

    Without both, yield None, which means this process. Local workers may still be starting. They, their scheduler
    and its dashboard listen only on the loopback interface.

    Raises
    ------
    LidarsimError
        If both are given, or the scheduler cannot be reached.
    ValueError
        If `workers` is less than 1.
    """
    if workers is not None and scheduler is not None:
        raise LidarsimError("--workers, --scheduler: expected one of them, got both")
    if workers is None and scheduler is None:
        yield None
        return
    if workers is not None:
        integer("--workers", workers, at_least=1)
    distributed = import_extra("distributed", "cluster", "a cluster")
    with ExitStack() as stack:
        for name in QUIET:
            logger = logging.getLogger(name)
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        if workers is None:
            try:
                client = distributed.Client(scheduler)
            except (OSError, TimeoutError, ValueError) as error:
                raise LidarsimError(
                    f"--scheduler: cannot reach {short_repr(scheduler)}: {format_error(error)}"
                ) from None
            yield stack.enter_context(client)
            return
        config = import_extra("dask.config", "cluster", "a cluster")
        stack.enter_context(config.set(LOCAL))  # stays set for workers that replace killed ones
        local = distributed.LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            memory_limit=1.0 / workers,  # a share of the machine's
            env={"LIDARSIM_THREADS": os.environ.get("LIDARSIM_THREADS", "1")},
            preload=PRELOAD,
            silence_logs="CRITICAL",
            # Anyone who reaches a scheduler can run code, and its dashboard shows logs: both listen only locally.
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
        )
        client = stack.enter_context(distributed.Client(stack.enter_context(local)))
        local.scale(workers)
        try:
            yield client
        finally:
            with ignore_interrupts():  # a second interrupt while workers stop makes the cluster hang for a while
                stack.close()
