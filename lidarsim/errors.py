"""The exceptions of lidarsim: each is also the built-in exception that its kind of fault calls for."""

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
    """An argument that cannot be used.

    What is raised is an `ArgumentValueError`, which is a ValueError, or an `ArgumentTypeError`, which is a TypeError.

    Parameters
    ----------
    argument : str
        The name of the argument.
    expected : str
        What it has to be.
    got : object
        What it is, or what shows the fault, such as the first wrong element of an array.
    hint : str
        What may have been meant, or how to go on; empty if there is nothing to say.

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
        """What is wrong, without the name of the argument and the hint."""
        return f"expected {self.expected}, got {self.got}"

    def __str__(self) -> str:
        """Return all of it on one line: ``radius: expected a finite number > 0, got -1.0; hint``."""
        return f"{self.argument}: {self.problem}{self.hint and f'; {self.hint}'}"


class ArgumentValueError(ArgumentError, ValueError):
    """An argument of the right type with a value that cannot be used."""


class ArgumentTypeError(ArgumentError, TypeError):
    """An argument of a type that cannot be used."""


class ConfigError(LidarsimError, ValueError):
    """A configuration that cannot be used; the message names file, line and key."""


class FileFormatError(LidarsimError, ValueError):
    """A file that is not what its name or its content promises, or that cannot be read."""


class MissingExtraError(LidarsimError, ImportError):
    """An optional package is needed; the message names the extra that installs it."""
