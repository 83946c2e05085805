"""Benchmarks of speed and accuracy: lidarsim and other ray casters on the same rays in the same run."""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str]) -> int:
    """Run ``lidarsim bench``: measure speed and errors of ray casters, or compare this build with another one.

    Parameters
    ----------
    arguments : sequence of str
        Arguments after ``lidarsim bench``.

    Returns
    -------
    int
        The exit code.
    """
    if any(argument.partition("=")[0] == "--against" for argument in arguments):
        from lidarsim.bench import against

        return against.main(arguments)
    from lidarsim.bench import speed

    if {"-h", "--help"} & set(arguments):
        sys.stdout.write("For the speed beside another build see: lidarsim bench --against WHEEL --help\n\n")
    return speed.main(arguments)
