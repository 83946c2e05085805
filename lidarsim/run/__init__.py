"""One configured run: its frames, and the kinds of output that they are written to."""

from lidarsim.run import bags, packets, clouds  # noqa: F401, I001 (register their outputs; clouds take what is left)
from lidarsim.run._frames import CloudArguments, Deskew, Frames, Leg, RunFrame
from lidarsim.run._output import checked_output
from lidarsim.run._run import Run

__all__ = ["CloudArguments", "Deskew", "Frames", "Leg", "Run", "RunFrame", "checked_output"]
