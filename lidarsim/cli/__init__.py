"""The command line: ``lidarsim new | scan | generate | stream | view | compare | fit | sensors | check | bench``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer
from typer.main import get_command

from lidarsim import _native
from lidarsim._base.files import format_error
from lidarsim._base.terminal import say, standard_streams
from lidarsim.cli.commands import app
from lidarsim.cli.interrupts import insistent_interrupts, unwinding_at_sigterm
from lidarsim.cli.options import OPTIONS
from lidarsim.errors import ArgumentError, LidarsimError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with 0, or with 2 and one line on stderr after an error.

    The exit code is 130 after Ctrl-C, 141 after a broken pipe and 143 after SIGTERM, as in shells. The traceback of an
    error is shown in Python's development mode (``python -X dev -m lidarsim``).

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: the arguments of the process.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    code: object = 0
    with standard_streams():
        try:
            with insistent_interrupts(), unwinding_at_sigterm():
                _run(given or ["--help"])
        except (typer.Exit, SystemExit) as end:
            code = end.exit_code if isinstance(end, typer.Exit) else end.code
        except KeyboardInterrupt:
            # An interrupted constructor, such as that of ZipFile, leaves an object whose deletion fails.
            sys.unraisablehook = lambda _: None
            code = 130
        except BrokenPipeError:  # of stdout; errors of files name the file
            code = 141
        except BaseException as error:  # a panic of the core is not an `Exception`
            if sys.flags.dev_mode:
                raise
            say(_reason(error))
            code = 2
    sys.exit(code)  # type: ignore[arg-type]


def _run(arguments: list[str]) -> None:
    _native.isa()  # wrong environment variables are no error of a configuration
    _native.threads()
    try:
        with get_command(app).make_context("lidarsim", arguments) as context:
            context.command.invoke(context)
    finally:
        sys.stdout.flush()  # output of libraries; a failure must not wait for interpreter exit


def _reason(error: BaseException) -> str:
    """Return the message of an error for the user."""
    if isinstance(error, OSError) and error.errno is not None:  # from the system; the message of ours names the path
        return format_error(error)
    if hasattr(error, "format_message"):  # typer's errors about arguments, whichever module defines them
        return str(error.format_message())
    text = str(error) or type(error).__name__
    if isinstance(error, ArgumentError):
        option = OPTIONS.get(error.argument.partition("[")[0], error.argument)
        return f"{option}{text.removeprefix(error.argument)}"
    if isinstance(error, MemoryError):
        return text if "memory" in text else f"out of memory: {text}"
    if isinstance(error, LidarsimError | OSError | ValueError | TypeError):
        return text
    return f"internal error, please report it: {type(error).__name__}: {text}"
