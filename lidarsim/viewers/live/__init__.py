"""Viewers that show frames while they are scanned: one module per viewer, which draws what `_moment` prepares."""

from __future__ import annotations

from pathlib import Path

from lidarsim._base.files import PathLike, check_folder
from lidarsim._base.validation import shown
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.viewers.live._foxglove import PORT as FOXGLOVE_PORT
from lidarsim.viewers.live._foxglove import Foxglove
from lidarsim.viewers.live._moment import Moment, Painter, SensorView, Viewer
from lidarsim.viewers.live._open3d import Open3D
from lidarsim.viewers.live._rerun import Rerun

__all__ = ["FOXGLOVE_PORT", "NAMES", "Moment", "Painter", "SensorView", "Viewer", "viewer"]

NAMES = ("rerun", "foxglove", "open3d")
"""Names of the viewers; rerun also takes a file or the address of a viewer that runs."""


def viewer(to: PathLike) -> Viewer:
    """Return the viewer, or the writer of a file, that `to` names; it opens nothing yet.

    Parameters
    ----------
    to : path-like
        One of `NAMES`, a ``.rrd`` file, or the address of a Rerun viewer, ``rerun+http://HOST:PORT/proxy``.

    Returns
    -------
    Viewer
        A context manager.

    Raises
    ------
    LidarsimError
        If there is no display for a window.
    MissingExtraError
        If its package is not installed.
    OSError
        If the file cannot be written.
    TypeError, ValueError
        If it is none of these.
    """
    if to == "foxglove":
        return Foxglove()
    if to == "open3d":
        return Open3D()
    if to == "rerun":
        return Rerun(None)
    if not isinstance(to, str | Path):
        raise ArgumentTypeError("to", f"{', '.join(NAMES)} or a path", type(to).__name__)
    if str(to).startswith(("rerun://", "rerun+http://", "rerun+https://")):
        return Rerun(str(to))
    if Path(to).suffix.lower() != ".rrd":
        raise ArgumentValueError("to", f"{', '.join(NAMES)}, a .rrd file or rerun+http://HOST:PORT/proxy", shown(to))
    check_folder(to)
    return Rerun(Path(to))
