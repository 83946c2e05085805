"""What there is to show something on."""

from __future__ import annotations

import os
import sys

from lidarsim.errors import LidarsimError


def require_display() -> None:
    """Raise `LidarsimError` on a Linux machine without a display, where the libraries would crash or show nothing."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise LidarsimError("no display to show a window on (DISPLAY is not set): write a file: save=, --screenshot")


def in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this, which displays what a cell returns."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")
