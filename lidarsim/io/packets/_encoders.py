"""The encoders of the sensors of a rig, and the files that their decoders need."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from lidarsim._base import validation
from lidarsim.errors import ArgumentValueError, FileFormatError
from lidarsim.io.packets._format import Encoder, format_of
from lidarsim.lidar import Lidar
from lidarsim.motion.georeference import START, unix_time
from lidarsim.rig import Rig, RigSensor

LIMIT = 2**32
"""Seconds since 1970 by which packets end: some hold them in 32 bits."""


def lidars(sensors: Mapping[str, Lidar] | Rig | Lidar) -> Mapping[str, Lidar]:
    """Return the lidars by name; the name of a single one is empty."""
    if not isinstance(sensors, Mapping):
        return {"": sensors}
    return {name: sensor.lidar if isinstance(sensor, RigSensor) else sensor for name, sensor in sensors.items()}


def encoders(
    sensors: Mapping[str, Lidar] | Rig,
    *,
    start: float | datetime = START,
    variant: str | None = None,
    port: int | None = None,
) -> dict[str, Encoder]:
    """Return an encoder for each sensor, each with UDP ports of its own.

    Parameters
    ----------
    sensors : mapping of str to Lidar, or Rig
        The sensors by name.
    start : float or datetime
        Moment at time 0 of the scans, before 2106: s since 1970, or a datetime with its time zone. Default: the start
        of 2020.
    variant : str, optional
        Variant of the packets, one of each sensor's format. Default: the first that holds the sensor's returns.
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
    moment = unix_time(start, limit=LIMIT)
    if port is not None:
        port = validation.integer("port", port, at_least=1)
    if not sensors:
        raise ArgumentValueError("sensors", "one or more", "none")
    found: dict[str, Encoder] = {}
    for number, (name, lidar) in enumerate(lidars(sensors).items()):
        try:
            layout = format_of(lidar, variant)
            of_it = (layout.port if port is None else port) + 2 * number
            if of_it > 0xFFFE:
                raise ArgumentValueError("port", f"at most {0xFFFE - 2 * number} for {number + 1} sensors", str(port))
            found[name] = layout.encoder(lidar, start=moment, port=of_it, variant=variant)
        except FileFormatError as error:
            raise FileFormatError(f"{name}: {error}" if name else str(error)) from None
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
