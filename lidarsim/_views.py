"""Views: what can be made of an object to look at it, registered by modules which that object must not import."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_VIEWS: dict[tuple[type, str], Callable[..., Any]] = {}


def register_view(kind: type, name: str, function: Callable[..., Any]) -> None:
    """Let a method of `PointCloud`, `Scan` or `Scene` work by a function: ``to_<name>``, or ``plot``.

    Parameters
    ----------
    kind : type
        The class whose instances are converted or shown.
    name : str
        Name of the library that they are converted for, or "plot".
    function : callable
        Takes an instance, and the keywords of the method.
    """
    _VIEWS[kind, name] = function


def view(kind: type, name: str) -> Callable[..., Any]:
    """Return the function that is registered for a class by a name."""
    return _VIEWS[kind, name]
