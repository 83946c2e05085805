"""lidarsim's exceptions; each is also a built-in exception of its kind."""

from __future__ import annotations

__all__ = [
    "ArgumentError",
    "ArgumentTypeError",
    "ArgumentValueError",
    "ConfigError",
    "FileFormatError",
    "LidarsimError",
    "MissingExtraError",
]


class LidarsimError(Exception):
    """Base of lidarsim's own exceptions."""


class ArgumentError(LidarsimError):
    """Invalid argument.

    Raised as `ArgumentValueError`, which is a ValueError, or as `ArgumentTypeError`, which is a TypeError.

    Parameters
    ----------
    argument : str
        Name of the argument.
    expected : str
        The expected value.
    got : object
        The given value or its wrong part, such as the first wrong element of an array.
    hint : str
        The likely intention or remedy; empty if there is none.

    Attributes
    ----------
    argument, expected, got, hint : str
        The parameters, as text.
    """

    def __init__(self, argument: str, expected: str, got: object, hint: str = "") -> None:
        super().__init__(argument, expected, got, hint)
        self.argument = argument
        self.expected = expected
        self.got = str(got)
        self.hint = hint

    @property
    def problem(self) -> str:
        """The error without the name of the argument and the hint."""
        return f"expected {self.expected}, got {self.got}"

    def __str__(self) -> str:
        """Return the error on one line: ``radius: expected a finite number > 0, got -1.0; hint``."""
        return f"{self.argument}: {self.problem}{self.hint and f'; {self.hint}'}"


class ArgumentValueError(ArgumentError, ValueError):
    """Argument of the right type with an invalid value."""


class ArgumentTypeError(ArgumentError, TypeError):
    """Argument of the wrong type."""


class ConfigError(LidarsimError, ValueError):
    """Invalid configuration; the message names the file, line and key."""


class FileFormatError(LidarsimError, ValueError):
    """Unreadable file, or one that is not of the format that its name or signature indicates."""


class MissingExtraError(LidarsimError, ImportError):
    """Missing optional package; the message names the extra that installs it."""
