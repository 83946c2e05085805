"""Ctrl-C that is not lost."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def insistent_interrupts() -> Iterator[None]:
    """Make Ctrl-C end the block; if the exception is lost, raise it again a second later or at the end of the block.

    Python drops exceptions in callbacks, of which imports run many, and some libraries drop any exception.
    """
    main = threading.main_thread()
    if threading.current_thread() is not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    repeats: list[threading.Timer] = []

    def repeat(number: int) -> None:
        if sys.platform == "win32":
            signal.raise_signal(number)
        else:  # which also wakes a sleeping thread
            signal.pthread_kill(main.ident or 0, number)

    def interrupt(number: int, frame: FrameType | None) -> None:
        repeats.append(threading.Timer(1.0, repeat, [number]))
        repeats[-1].daemon = True
        repeats[-1].start()
        signal.default_int_handler(number, frame)

    report = sys.unraisablehook

    def report_others(dropped: sys.UnraisableHookArgs) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            report(dropped)

    signal.signal(signal.SIGINT, interrupt)
    sys.unraisablehook = report_others
    try:
        yield
        if repeats:
            raise KeyboardInterrupt
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = report
        for timer in repeats:
            timer.cancel()
