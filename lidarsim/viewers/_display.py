"""Whether this machine can show a window."""

from __future__ import annotations

import os
import sys

from lidarsim.errors import LidarsimError


def require_display() -> None:
    """Raise `LidarsimError` on a Linux machine without a display, where the libraries would crash or show nothing."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise LidarsimError("no display to show a window on (DISPLAY is not set): write a screenshot instead")
