"""Views: what can be made of an object to look at it, registered by modules which that object must not import."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypedDict, Unpack

if TYPE_CHECKING:
    from lidarsim._files import PathLike
    from lidarsim._validation import Transform
    from lidarsim.scene import Scene

Camera = Literal["behind", "birds-eye", "first-person", "orbit"]
"""Where a picture is taken from."""


class Looks(TypedDict, total=False):
    """The keywords of `lidarsim.show`."""

    scene: Scene | None
    color_by: str | None
    class_names: Mapping[int, str] | None
    pose: Transform | Sequence[Transform] | None
    time: float | Sequence[float] | None
    save: PathLike | None
    camera: Camera | Sequence[Sequence[float]]
    size: tuple[int, int]
    point_size: float | None
    viewer: Literal["pyvista", "open3d"]


class Page(Protocol):
    """A page that a notebook displays."""

    @property
    def text(self) -> str:
        """The whole page in HTML."""

    @property
    def height(self) -> int:
        """Height of its frame in the notebook, pixels."""

    def _repr_html_(self) -> str: ...


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
