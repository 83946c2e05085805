"""Views: what can be made of an object to look at it, registered by modules which that object must not import."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Unpack

if TYPE_CHECKING:
    from lidarsim.viewers._show import Looks
    from lidarsim.viewers.html import Page

_VIEWS: dict[tuple[type, str], Callable[..., Any]] = {}


def register_view(kind: type, name: str, function: Callable[..., Any]) -> None:
    """Let a method of a class work by a function: ``to_<name>``, ``from_<name>``, or ``plot``.

    Parameters
    ----------
    kind : type
        The class whose instances are converted or shown.
    name : str
        Name of the library that they are converted for, "from_" and that name for the way back, or "plot".
    function : callable
        Takes what the method takes: an instance, or what it is made from, and keywords.
    """
    _VIEWS[kind, name] = function


def view(kind: type, name: str) -> Callable[..., Any]:
    """Return the function that is registered for a class by a name."""
    return _VIEWS[kind, name]


class Plotted:
    """Base of the public classes whose objects can be looked at."""

    __slots__ = ()

    def plot(self, **options: Unpack[Looks]) -> Page | None:
        """Show this in a window, in a notebook or as a file: a short way to write ``lidarsim.show(this, …)``.

        Parameters
        ----------
        **options
            Those of `lidarsim.show`: `color_by`, `scene`, `save`, `camera` and others.

        Returns
        -------
        Page or None
            What `lidarsim.show` returns.
        """
        page: Page | None = view(Plotted, "plot")(self, **options)
        return page
