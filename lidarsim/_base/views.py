"""Registry of conversions and plots, filled by modules that the converted classes must not import."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypedDict, Unpack

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike
    from lidarsim._base.validation import Floats, Transform

Camera = Literal["behind", "birds-eye", "first-person", "orbit", "top"]
"""Camera position of a picture."""

Viewer = Literal["pyvista", "open3d"]
"""Library that shows point clouds in a window."""

ColorMap = Literal["magma", "viridis", "cividis", "grey"]
"""Colours of numbers."""

Background = Literal["dark", "white"]
"""Colour of the background of a picture."""


class Boxed(Protocol):
    """Boxes that a picture shows: `lidarsim.Boxes`."""

    @property
    def center(self) -> Floats:
        """Centres, m: shape (n, 3)."""

    @property
    def size(self) -> Floats:
        """Extents along the axes of the boxes, m: shape (n, 3)."""

    @property
    def rotation(self) -> Floats:
        """Box to the frame of the centres: shape (n, 3, 3)."""


class Looks(TypedDict, total=False):
    """Keyword arguments of `lidarsim.show`."""

    scene: Plotted | None
    boxes: Boxed | Sequence[Boxed | None] | None
    color_by: str | None
    class_names: Mapping[int, str] | None
    pose: Transform | Sequence[Transform] | None
    time: float | Sequence[float] | None
    save: PathLike | None
    camera: Camera | Sequence[Sequence[float]]
    size: tuple[int, int]
    point_size: float | None
    viewer: Viewer
    title: str | Sequence[str] | None
    limits: tuple[float, float] | None
    color_map: ColorMap | None
    background: Background
    accumulate: bool


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
    """Register the function behind a method of a class: ``to_<name>``, ``from_<name>`` or ``plot``.

    Parameters
    ----------
    kind : type
        The class whose instances are converted or shown.
    name : str
        Name of the library to convert to, "from_" and that name for the reverse, "plot", or the name of a page.
    function : callable
        Takes the arguments of the method: an instance, or the object to convert from, and keywords.
    """
    _VIEWS[kind, name] = function


def view(kind: type, name: str) -> Callable[..., Any]:
    """Return the function that is registered for a class under a name."""
    return _VIEWS[kind, name]


class Plotted:
    """Base of the public classes whose objects can be plotted."""

    __slots__ = ()

    def plot(self, **options: Unpack[Looks]) -> Page | None:
        """Show this in a window or notebook, or save a picture: short for ``lidarsim.show(this, …)``.

        Parameters
        ----------
        **options
            Keyword arguments of `lidarsim.show`: `color_by`, `scene`, `save`, `camera` and others.

        Returns
        -------
        Page or None
            The result of `lidarsim.show`.
        """
        page: Page | None = view(Plotted, "plot")(self, **options)
        return page
