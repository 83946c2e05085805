"""The encoders of the sensors of a rig, and the files that their decoders need."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from lidarsim import _validation
from lidarsim.errors import ArgumentValueError
from lidarsim.io.packets._format import Encoder, format_of

if TYPE_CHECKING:
    from lidarsim.sensor import Lidar

__all__ = ["START", "companions", "encoders"]

START = 1_577_836_800.0
"""Moment of time 0 of the scans unless another is given: 2020-01-01T00:00:00Z, as in `lidarsim.io.rosbag`."""


def encoders(
    sensors: Mapping[str, Lidar], *, start: float = START, variant: str | None = None, port: int | None = None
) -> dict[str, Encoder]:
    """Return an encoder for each sensor, each with UDP ports of its own.

    Parameters
    ----------
    sensors : mapping of str to Lidar
        The sensors by name.
    start : float
        Moment at time 0 of the scans, s since 1970.
    variant : str, optional
        Layout of the packets, one of those of the sensors' format. Default: the first.
    port : int, optional
        First UDP port; each further sensor takes the next two. Default: the vendor's.

    Returns
    -------
    dict of str to Encoder
        The encoders by name of the sensor.

    Raises
    ------
    FileFormatError
        If a sensor has no packet format, or its pattern or returns do not fit in the packets.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range.
    """
    moment = round(_validation.real("start", start, at_least=0.0) * 1e9)
    if port is not None:
        port = _validation.integer("port", port, at_least=1)
    found: dict[str, Encoder] = {}
    for number, (name, lidar) in enumerate(sensors.items()):
        layout = format_of(lidar, variant)
        of_it = (layout.port if port is None else port) + 2 * number
        if of_it > 0xFFFE:
            raise ArgumentValueError("port", f"at most {0xFFFE - 2 * number} for {number + 1} sensors", str(port))
        found[name] = layout.encoder(lidar, start=moment, port=of_it, variant=variant)
    return found


def companions(path: Path, of: Mapping[str, Encoder]) -> dict[Path, bytes]:
    """Return the content of the files that decoders need beside `path`, by their paths.

    With several sensors, the name of each is in the name of its file.
    """
    return {
        path.with_stem(f"{path.stem}_{name}" if name else path.stem).with_suffix(suffix): content
        for name, encoder in of.items()
        for suffix, content in encoder.companions().items()
    }
