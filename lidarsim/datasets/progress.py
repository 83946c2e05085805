"""Progress of a data set: a bar on a terminal, one line per minute in a log."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from lidarsim._base.terminal import say

MINUTE = 60.0


class Progress:
    """Counts frames and points, and reports them on stderr."""

    def __init__(self, frames: int, done: int) -> None:
        self.total, self.done, self.new, self.points = frames, done, 0, 0
        self.begin = self.reported = time.monotonic()
        self._bar: Bar | None = None

    def __enter__(self) -> Self:
        """Show the bar."""
        if sys.stderr.isatty():
            rate = TextColumn("{task.fields[rate]}")
            columns = (TextColumn("frames"), BarColumn(), MofNCompleteColumn(), rate, TimeRemainingColumn(compact=True))
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True, speed_estimate_period=10 * MINUTE)
            self._bar.start()
            self._bar.add_task("frames", total=self.total, completed=self.done, rate="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the bar."""
        if self._bar:
            self._bar.stop()

    @property
    def seconds(self) -> float:
        """Time since the start, s."""
        return time.monotonic() - self.begin

    def add(self, frames: int, points: int) -> None:
        """Count new frames and points."""
        self.new += frames
        self.points += points
        now = time.monotonic()
        rate = self.points / (now - self.begin) if now > self.begin else 0.0
        if self._bar:
            self._bar.update(self._bar.task_ids[0], completed=self.done + self.new, rate=f"{rate:,.0f} points/s")
        elif now - self.reported >= MINUTE:
            self.reported = now
            made = self.done + self.new
            left = (self.total - made) * self.seconds / max(self.new, 1)
            text = f"{made:,} of {self.total:,} frames, {rate:,.0f} points/s, {left / MINUTE:,.0f} min remaining"
            say(text)
