"""Which files describe a sensor in lidarsim's own YAML; read without the YAML reader, so importing this is cheap."""

from __future__ import annotations

import re
from pathlib import Path


def recognise(path: Path, text: str) -> bool:
    """Return whether `text`, the head of the file `path`, describes a sensor in lidarsim's own YAML."""
    own = re.search(r"^(pattern|preset|file)\s*:", text, re.MULTILINE)
    return path.suffix.lower() in (".yaml", ".yml") and own is not None
