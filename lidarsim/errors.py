"""lidarsim's own exceptions; other errors in arguments are plain ``ValueError`` or ``TypeError``."""

from __future__ import annotations

__all__ = ["ConfigError", "FileFormatError", "LidarsimError", "MissingExtraError"]


class LidarsimError(Exception):
    """Base of lidarsim's own exceptions."""


class ConfigError(LidarsimError, ValueError):
    """Invalid configuration; the message names the file, line and key."""


class FileFormatError(LidarsimError, ValueError):
    """Unreadable file, or one that is not of the format that its name or signature indicates."""


class MissingExtraError(LidarsimError, ImportError):
    """Missing optional package; the message names the extra that installs it."""
