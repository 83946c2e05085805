"""The few exceptions of our own; everything else is a plain ``ValueError`` or ``TypeError``."""

from __future__ import annotations

__all__ = ["ConfigError", "FileFormatError", "LidarsimError", "MissingExtraError"]


class LidarsimError(Exception):
    """Base of lidarsim's own exceptions."""


class ConfigError(LidarsimError, ValueError):
    """A configuration that cannot be used; the message names file, line and key."""


class FileFormatError(LidarsimError, ValueError):
    """A file that is not what its name or its content promises, or that cannot be read."""


class MissingExtraError(LidarsimError, ImportError):
    """An optional package is needed; the message names the extra that installs it."""
