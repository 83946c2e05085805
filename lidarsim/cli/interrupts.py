"""The signals that end the command line: Ctrl-C that is not lost, and SIGTERM."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


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


@contextmanager
def ignore_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C in the block; only the main thread can set signal handlers."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


@contextmanager
def unwinding_at_sigterm() -> Iterator[None]:
    """Let SIGTERM raise `SystemExit` in the block; by default it would end the process and leave incomplete files."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _exit(number: int, _: object) -> NoReturn:
    raise SystemExit(128 + number)  # the shells' exit status of a process ended by a signal
