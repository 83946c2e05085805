"""Detection of displays and notebooks."""

from __future__ import annotations

import os
import socket
import sys
from contextlib import suppress

from lidarsim.errors import LidarsimError


def require_display() -> None:
    """Raise `LidarsimError` on Linux without a working display: the libraries would crash or show nothing."""
    if sys.platform != "linux" or os.environ.get("WAYLAND_DISPLAY"):
        return
    display = os.environ.get("DISPLAY", "")
    if not display:
        raise LidarsimError(
            "no display to open a window on (DISPLAY is not set): write a file instead (save=, --screenshot)"
        )
    if not _answers(display):
        raise LidarsimError(f"no display to open a window on (DISPLAY is {display}, where nothing answers)")


def _answers(display: str) -> bool:
    """Return whether an X server listens at a display's address by X(7): a local socket, or a host's port."""
    host, _, number = display.rpartition(":")
    number = number.partition(".")[0]
    if not number.isdecimal():
        return False
    local = host in {"", "unix"} or host.startswith("/")
    places = [f"/tmp/.X11-unix/X{number}", f"\0/tmp/.X11-unix/X{number}", display]  # noqa: S108
    for place in places if local else [(host, 6000 + int(number))]:
        with socket.socket(socket.AF_UNIX if local else socket.AF_INET) as line, suppress(OSError):
            line.settimeout(5.0)
            line.connect(place)
            return True
    return False


def in_notebook() -> bool:
    """Return whether this runs in a Jupyter kernel, which displays the value of a cell."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")
