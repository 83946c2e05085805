"""Rerun: a viewer with a time line, and its files (``.rrd``)."""

from __future__ import annotations

import os
import socket
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

import numpy as np

from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, check_folder, replacing
from lidarsim._base.validation import short, shown
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.viewers._colors import DARK, PATH
from lidarsim.viewers._display import require_display
from lidarsim.viewers._surfaces import joined

if TYPE_CHECKING:
    import rerun

    from lidarsim._base.validation import Floats
    from lidarsim.viewers._moment import Moment, Painted, World

__all__ = ["NAME", "Rerun"]

NAME = "rerun"
"""What opens a window."""

OPACITY = 0x14
"""Opacity of surfaces, of 255."""
TIMEOUT = 5.0
"""Time in which a viewer must answer, s."""


class Rerun:
    """Show frames in Rerun: in a window, in a viewer that runs already, or in a file.

    Entities are ``world/SENSOR`` (the sensor's pose and axes) and its ``points``, ``world/boxes``,
    ``world/surfaces/CLASS``, ``world/moving/OBJECT`` and ``paths``, on the time lines ``time`` and ``frame``.

    Parameters
    ----------
    to : path-like
        `NAME` for a window, a ``.rrd`` file, or the address of a viewer, ``rerun+http://HOST:PORT/proxy``.

    Attributes
    ----------
    paced : bool
        Whether to show each frame no sooner than its time after the first one.

    Raises
    ------
    LidarsimError
        If there is no display for a window.
    MissingExtraError
        If Rerun is not installed.
    OSError
        If the file cannot be written, or nothing answers at the address.
    TypeError, ValueError
        If `to` is none of these.
    """

    def __init__(self, to: PathLike) -> None:
        self._to: Path | str = checked_target(to)
        if self._to == NAME:
            require_display()
        elif isinstance(self._to, str):
            _check_answers(self._to)
        self._rerun = import_rerun()
        self.paced = isinstance(self._to, str)
        self._stack = ExitStack()
        self._last: dict[str, Floats] = {}
        self._made: set[str] = set()

    def __enter__(self) -> Self:
        """Start the recording."""
        rr = self._rerun
        self._log: rerun.RecordingStream = rr.RecordingStream("lidarsim")
        self._log.set_log_time_enabled(False)
        if isinstance(self._to, Path):
            self._log.save(self._stack.enter_context(replacing(self._to)))
        elif self._to == NAME:
            self._log.spawn(hide_welcome_screen=True)
        else:
            self._log.connect_grpc(self._to)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Send what is left; a file gets its name unless there was an error."""
        self._log.flush()
        self._log.disconnect()
        self._stack.__exit__(kind, error, trace)

    def begin(self, world: World) -> None:
        """Log the surfaces, the classes and how to show all."""
        rr, log = self._rerun, self._log.log
        self._origin = world.origin
        named = [
            rr.AnnotationInfo(id=label, label=name, color=_rgb(color)) for label, (name, color) in world.classes.items()
        ]
        log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, rr.AnnotationContext(named), static=True)
        log("world", rr.AnyValues(origin=world.origin), static=True)
        groups: dict[tuple[str, str], list[Painted]] = {}
        for part in world.static:
            groups.setdefault((part.name, part.color), []).append(part)
        for (name, color), parts in groups.items():
            vertices, faces = joined([part.surface for part in parts], world.origin)
            log(["world", "surfaces", name], self._mesh(vertices, faces, color), static=True)
        self._log.send_blueprint(_blueprint(rr, world))

    def show(self, moment: Moment) -> None:
        """Log a frame."""
        from scipy.spatial.transform import Rotation

        rr, log = self._rerun, self._log.log
        self._log.set_time("time", duration=moment.time)
        self._log.set_time("frame", sequence=moment.number)
        steps: list[list[Floats]] = []
        for name, sensor in moment.sensors.items():
            position = sensor.pose[:3, 3] - self._origin
            turn = Rotation.from_matrix(sensor.pose[:3, :3]).as_quat()
            log(["world", name], rr.Transform3D(translation=position, quaternion=turn), rr.TransformAxes3D(1.0))
            labels = getattr(sensor.cloud, "label", None)
            ids = None if labels is None else labels.clip(max=0xFFFF).astype(np.uint16)  # of Rerun's classes
            points = rr.Points3D(sensor.cloud.xyz, colors=sensor.rgb, radii=rr.Radius.ui_points(1.5), class_ids=ids)
            log(["world", name, "points"], points)
            if name in self._last:
                steps.append([self._last[name], position])
            self._last[name] = position
        log("paths", rr.LineStrips3D(steps, colors=_rgb(PATH), radii=rr.Radius.ui_points(1.0)))
        if (boxes := moment.boxes) is not None:
            turns = Rotation.from_matrix(boxes.rotation).as_quat() if len(boxes) else np.empty((0, 4))
            wires = rr.Boxes3D(
                centers=boxes.center - self._origin,
                half_sizes=boxes.size / 2,
                quaternions=turns,
                colors=[_rgb(color) for color in moment.box_colors],
                labels=[f"{name} {k}" for name, k in zip(moment.box_names, boxes.instance.tolist(), strict=True)],
                show_labels=False,
            )
            log("world/boxes", wires)
        for mover in moment.movers:
            surface = mover.surface
            path = rr.new_entity_path(["world", "moving", mover.name, mover.color[1:]])
            if path not in self._made:
                self._made.add(path)
                log(path, self._mesh(surface.vertices, surface.outward(), mover.color), static=True)
            place = surface.matrix
            log(path, rr.Transform3D(translation=place[:3, 3] - self._origin, mat3x3=place[:3, :3]))

    def _mesh(self, vertices: Floats, faces: Any, color: str) -> rerun.Mesh3D:
        mesh: rerun.Mesh3D = self._rerun.Mesh3D(
            vertex_positions=vertices, triangle_indices=faces, albedo_factor=[*_rgb(color), OPACITY]
        )
        return mesh


def checked_target(to: PathLike) -> Path | str:
    """Return what `Rerun` shows frames in, a file as a path, after checking that it is one and its folder exists."""
    if not isinstance(to, str | os.PathLike):
        raise ArgumentTypeError("to", f"{NAME} or a path", type(to).__name__)
    if to == NAME or str(to).startswith(("rerun://", "rerun+http://", "rerun+https://")):
        return str(to)
    if Path(to).suffix.lower() != ".rrd":
        raise ArgumentValueError("to", f"{NAME}, a .rrd file or rerun+http://HOST:PORT/proxy", shown(to))
    check_folder(to)
    return Path(to)


def _check_answers(to: str) -> None:
    """Raise an error unless something listens at the address of a viewer."""
    try:
        parts = urlsplit(to)
        host, port = parts.hostname, parts.port
    except ValueError:  # of the port or of an IPv6 address
        host, port = None, None
    if not host or not port or parts.path != "/proxy":
        raise ArgumentValueError("to", "rerun+http://HOST:PORT/proxy", shown(to))
    try:
        socket.create_connection((host, port), timeout=TIMEOUT).close()
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OSError(f"to: expected a Rerun viewer that runs, got {short(to)!r}: no answer ({reason})") from None


def import_rerun() -> ModuleType:
    """Import Rerun, which the extra ``live`` installs."""
    return import_extra("rerun", "live", "Rerun")


def _blueprint(rr: ModuleType, world: World) -> rerun.blueprint.Blueprint:
    """Return the layout of the viewer: one view from behind the sensor, in which the paths have their whole past."""
    new = import_extra("rerun.blueprint", "live", "Rerun")
    boundary = new.TimeRangeBoundary
    past = [
        rr.VisibleTimeRange(name, start=boundary.infinite(), end=boundary.cursor_relative())
        for name in ("time", "frame")
    ]
    view = new.Spatial3DView(
        origin="/",
        name="lidarsim",
        background=_rgb(DARK.background),
        overrides={"paths": new.VisibleTimeRanges(past)},
        eye_controls=new.EyeControls3D(
            position=world.eye - world.origin, look_target=world.target - world.origin, eye_up=(0.0, 0.0, 1.0)
        ),
    )
    made: rerun.blueprint.Blueprint = new.Blueprint(view, collapse_panels=True)
    return made


def _rgb(color: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue
