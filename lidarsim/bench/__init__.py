"""Speed and accuracy, measured: the exact oracle, the textbook baseline, the peers, the reports."""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str]) -> int:
    """Run ``lidarsim bench``: the speed of the ray casters, their errors, or the speed beside another build.

    Parameters
    ----------
    arguments : sequence of str
        What follows ``lidarsim bench``.

    Returns
    -------
    int
        The exit code.
    """
    if "--accuracy" in arguments:
        from lidarsim.bench import accuracy

        return accuracy.main([argument for argument in arguments if argument != "--accuracy"])
    if any(argument.partition("=")[0] == "--against" for argument in arguments):
        from lidarsim.bench import against

        return against.main(arguments)
    from lidarsim.bench import speed

    if {"-h", "--help"} & set(arguments):
        sys.stdout.write("For the accuracy of the ray casters see: lidarsim bench --accuracy --help\n")
        sys.stdout.write("For the speed beside another build see: lidarsim bench --against WHEEL --help\n\n")
    return speed.main(arguments)
