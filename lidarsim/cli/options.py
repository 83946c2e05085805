"""Options that several commands take, and how their texts are read."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from lidarsim._base.validation import short_repr
from lidarsim._base.views import Camera
from lidarsim.errors import LidarsimError
from lidarsim.run import _output as outputs
from lidarsim.viewers._show import check_size


def parse_path(text: str) -> Path:
    """Parse a path."""
    if not text:  # `Path` would make it the current folder
        raise typer.BadParameter("expected a path, got an empty one")
    return Path(text)


def parse_output(text: str) -> str:
    """Parse a path, or a folder that ends in a slash."""
    return text if parse_path(text) else ""


def parse_integer(text: str) -> int:
    """Parse an integer."""
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"expected an integer, got {short_repr(text)}") from None


def parse_real(text: str) -> float:
    """Parse a number."""
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"expected a number, got {short_repr(text)}") from None


def make_option(names: str, metavar: str, text: str, **more: Any) -> Any:
    """Return an option; `names`: long and short, separated by a space."""
    return typer.Option(*names.split(), metavar=metavar, help=text, show_default=False, **more)


def make_choice(names: str, kind: object, text: str) -> Any:
    """Return an option that takes one of the values of a `Literal`."""
    return make_option(names, "|".join(get_args(kind)), text)


def make_file_option(names: str, metavar: str, text: str) -> Any:
    """Return an option that takes a path."""
    return make_option(names, metavar, text, parser=parse_path)


def make_file_argument(metavar: str, text: str) -> Any:
    """Return an argument that is a path."""
    return typer.Argument(metavar=metavar, help=text, parser=parse_path, show_default=False)


def make_output_option(option: outputs.Option) -> Any:
    """Return the option of a kind of output."""
    if option.kind is bool:
        return typer.Option(option.flag, help=option.help)
    texts = {int: parse_integer, float: parse_real}
    return make_option(option.flag, option.metavar, option.help, parser=texts.get(option.kind))


OPTIONS = {
    "color_by": "--color-by",
    "limits": "--limits",
    "pictures": "--pictures",
    "sensor": "--sensor",
    "size": "--size",
    **{name: option.flag.partition("/")[0] for name, option in outputs.options().items()},
}
"""Options by the Python arguments that they set: errors of the command line name the option."""

Configuration = Annotated[Path, make_file_argument("CONFIG", "YAML configuration, or a packaged one: demo, ahead.")]
Overrides = Annotated[
    list[str] | None, make_option("--set", "KEY=VALUE", "Override a value in CONFIG, e.g. scene.0.radius_m=2.")
]
Seed = Annotated[int | None, make_option("--seed", "N", "Noise seed; overrides CONFIG.", parser=parse_integer)]
Frame = Annotated[
    int | None, make_option("--frame", "N", "Number of the first frame; overrides CONFIG.", parser=parse_integer)
]
Frames = Annotated[
    int | None, make_option("--frames", "N", "Number of frames; overrides CONFIG.", parser=parse_integer)
]
Screenshot = Annotated[Path | None, make_file_option("--screenshot", "PNG|JPG", "Write a picture; needs no display.")]
ColorBy = Annotated[str | None, make_option("--color-by", "FIELD", "Colour the points by this field, or by height.")]
Surfaces = Annotated[
    bool, typer.Option("--surfaces/--no-surfaces", help="Show the surfaces of the scene with the points.")
]
View = Annotated[Camera, make_choice("--camera", Camera, "Camera position.")]
Size = Annotated[
    str, make_option("--size", "WIDTHxHEIGHT", "Size of windows and pictures in pixels; default 1600x1000.")
]

Variant = Annotated[str | None, make_output_option(outputs.options()["variant"])]


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of all kinds of output, which it takes as ``**options``."""
    own = inspect.signature(command, eval_str=True)
    named = [parameter for parameter in own.parameters.values() if parameter.kind is not inspect.Parameter.VAR_KEYWORD]
    for name, option in outputs.options().items():
        info = make_output_option(option)
        annotation = Annotated[option.kind | None, info]  # type: ignore[name-defined] # known when it runs
        named.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation))
    command.__signature__ = own.replace(parameters=named)  # type: ignore[attr-defined]
    return command


def parse_part(text: str | None) -> tuple[int, int]:
    """Parse a part such as 0/4 as its number and the number of parts."""
    if text is None:
        return 0, 1
    found = re.fullmatch(r"([0-9]{1,18})/([0-9]{1,18})", text)
    if found is None or not int(found[1]) < int(found[2]):
        raise LidarsimError(f"--shard: expected I/N with I from 0 to N - 1, got {short_repr(text)}")
    return int(found[1]), int(found[2])


def parse_limits(text: str | None) -> tuple[float, float] | None:
    """Parse limits such as 0,50; `lidarsim.show` checks their order."""
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise LidarsimError(f"--limits: expected LOW,HIGH, such as 0,50, got {short_repr(text)}") from None
    return low, high


def parse_size(text: str) -> tuple[int, int]:
    """Parse a size such as 1600x1000 as width and height."""
    found = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    if found is None:
        raise LidarsimError(f"--size: expected WIDTHxHEIGHT in pixels, such as 1600x1000, got {short_repr(text)}")
    return check_size((int(found[1]), int(found[2])))
