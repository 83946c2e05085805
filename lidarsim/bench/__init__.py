"""Speed and accuracy, measured: lidarsim beside other ray casters, on the same rays, in the same run."""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str]) -> int:
    """Run ``lidarsim bench``: the ray casters' speed and errors, or the speed of this build beside another one.

    Parameters
    ----------
    arguments : sequence of str
        What follows ``lidarsim bench``.

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
