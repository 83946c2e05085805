"""Rerun: a viewer with a time line, and its files (``.rrd``)."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from io import FileIO
from pathlib import Path
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

import numpy as np

from lidarsim._base.extras import import_extra
from lidarsim._base.files import PathLike, Place, check_folder, replacing
from lidarsim._base.validation import short, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.viewers._colors import DARK, PATH
from lidarsim.viewers._display import require_display
from lidarsim.viewers._surfaces import merge_surfaces

if TYPE_CHECKING:
    import rerun

    from lidarsim._base.validation import Floats
    from lidarsim.viewers._moment import Moment, Painted, World

NAME = "rerun"
"""What opens a window."""
APPLICATION = "lidarsim"
PORT = 9876
"""Rerun's own default port."""
OPACITY = 0x14
"""Opacity of surfaces, of 255."""
TIMEOUT = 5.0
"""Time in which a viewer must answer, s."""
PATIENCE = 60.0
"""Time in which a viewer must have started, or have taken a frame, s."""
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
"""What a client of HTTP/2, and so of gRPC, sends first: a fixed text and a frame of settings (RFC 9113, 3.4)."""
SETTINGS = 4
"""Type of the frame that a server of HTTP/2 sends first."""

_started: list[subprocess.Popen[bytes]] = []
"""Viewers that were started: they outlive the streams."""


class Rerun:
    """Show frames in Rerun: in a window, in a viewer that runs already, or in a file.

    Entities are ``world/SENSOR`` (the sensor's pose and axes) and its ``points``, ``world/boxes``,
    ``world/surfaces/CLASS``, ``world/moving/OBJECT`` and ``paths``, on the time lines ``time`` and ``frame``.

    Parameters
    ----------
    to : path-like
        `NAME` for a window, a ``.rrd`` file, or the address of a viewer, ``rerun+http://HOST:PORT/proxy``.
    expose : bool
        Whether the viewer that is started for a window can be reached from other machines.

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
        If the file cannot be written, or no viewer answers; also while frames are shown.
    TypeError, ValueError
        If `to` is none of these, or is exposed without being a window.
    """

    def __init__(self, to: PathLike, *, expose: bool = False) -> None:
        self._to, self._place = check_target(to)
        self._expose = expose
        if expose and self._to != NAME:
            raise ArgumentValueError("expose", f"False unless `to` is {NAME!r}", True)
        if self._to == NAME:
            require_display()
        elif self._place is None:
            _check_viewer(self._to)
        self._rerun = import_extra("rerun", "live", "Rerun")
        self.paced = self._place is None
        self._pipe: _Pipe | None = None
        self._last: dict[str, Floats] = {}
        self._made: set[str] = set()

    def __enter__(self) -> Self:
        """Start the recording."""
        with ExitStack() as stack:
            if self._place:
                stack.enter_context(self._place.errors_as_given())
                temporary = stack.enter_context(replacing(self._place.path))
                self._pipe = stack.enter_context(_Pipe(temporary))
            address = _viewer(expose=self._expose) if self._to == NAME else self._to
            self._log: rerun.RecordingStream = self._rerun.RecordingStream(APPLICATION)
            stack.push(self._close)
            self._log.set_log_time_enabled(False)
            if self._pipe:
                self._log.save(self._pipe.name)
            else:
                self._log.connect_grpc(address)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Send what is left; a file gets its name unless there was an error."""
        self._stack.__exit__(kind, error, trace)

    def _close(self, _: object, error: BaseException | None, __: object) -> None:
        """Close the recording, and end its threads."""
        try:
            if error is None:
                self._flush()
        finally:
            self._log.disconnect()
            del self._log
            import_extra("rerun_bindings", "live", "Rerun").flush_and_cleanup_orphaned_recordings()

    def _send(self, blueprint: rerun.blueprint.Blueprint) -> None:
        """Send a layout as `RecordingStream.send_blueprint`, which keeps the two threads of its own recording."""
        bindings = import_extra("rerun_bindings", "live", "Rerun")
        stream = bindings.new_blueprint(APPLICATION, make_default=False, make_thread_default=False)
        layout = self._rerun.RecordingStream._from_native(stream)
        layout.set_time("blueprint", sequence=0)
        blueprint._log_to_stream(layout)
        sent = layout.memory_recording()
        bindings.send_blueprint(sent.storage, True, True, recording=self._log.to_native())
        layout.disconnect()

    def _flush(self) -> None:
        """Wait until all that was logged is in the file or with the viewer."""
        try:
            self._log.flush(timeout_sec=PATIENCE)
        except RuntimeError as error:
            reason = str(error).partition("\n")[0]
            raise OSError(f"{self._to}: the viewer takes no more frames: {reason}") from error
        if self._pipe and self._pipe.failure:
            raise self._pipe.failure

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
            vertices, faces = merge_surfaces([part.surface for part in parts], world.origin)
            log(["world", "surfaces", name], self._mesh(vertices, faces, color), static=True)
        self._send(_blueprint(rr, world))

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
        self._flush()

    def _mesh(self, vertices: Floats, faces: Any, color: str) -> rerun.Mesh3D:
        mesh: rerun.Mesh3D = self._rerun.Mesh3D(
            vertex_positions=vertices, triangle_indices=faces, albedo_factor=[*_rgb(color), OPACITY]
        )
        return mesh


class _Pipe:
    """A pipe under a name, whose content goes to a new file: Rerun would report a full disk in lines of its own.

    Without names of pipes, as on Windows, the name is that of the file.

    Attributes
    ----------
    name : str
        What to write to.
    failure : OSError or None
        Why the file lacks what has come since.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.name = str(path)
        self.failure: OSError | None = None

    def __enter__(self) -> Self:
        """Create the file."""
        self._copier: threading.Thread | None = None
        if Path("/dev/fd").is_dir():
            read, self._write = os.pipe()
            self.name = f"/dev/fd/{self._write}"
            try:
                file = self._path.open("xb", buffering=0)
            except OSError:
                os.close(read)
                os.close(self._write)
                raise
            self._copier = threading.Thread(target=self._copy, args=(open(read, "rb", buffering=0), file))  # noqa: PTH123 - closed by the thread
            self._copier.start()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Wait for the end of the content, which is when nobody writes to the pipe any more."""
        if self._copier:
            os.close(self._write)
            self._copier.join()
        if self.failure and error is None:
            raise self.failure

    def _copy(self, pipe: FileIO, file: FileIO) -> None:
        with pipe, file:
            while data := memoryview(pipe.read(1 << 20)):
                while data and not self.failure:
                    try:
                        data = data[file.write(data) :]
                    except OSError as error:
                        self.failure = error


def check_target(to: PathLike) -> tuple[str, Place | None]:
    """Return what `Rerun` shows frames in, as it was given, and the place of a file whose folder exists."""
    if not isinstance(to, str | os.PathLike):
        raise ArgumentTypeError("to", f"{NAME} or a path", type(to).__name__)
    name = os.fspath(to)
    if name == NAME or name.startswith(("rerun://", "rerun+http://", "rerun+https://")):
        return name, None
    if Path(to).suffix.lower() != ".rrd":
        raise ArgumentValueError("to", f"{NAME}, a .rrd file or rerun+http://HOST:PORT/proxy", short_repr(to))
    check_folder(to)
    return name, Place(to)


def _check_viewer(to: str) -> None:
    """Raise an error unless a viewer answers at the address; what answers by TLS may be one."""
    try:
        parts = urlsplit(to)
        host, port = parts.hostname, parts.port
    except ValueError:  # of the port or of an IPv6 address
        host, port = None, None
    if not host or not port or parts.path != "/proxy":
        raise ArgumentValueError("to", "rerun+http://HOST:PORT/proxy", short_repr(to))
    expected = f"to: expected a Rerun viewer that runs, got {short(to)!r}"
    try:
        if parts.scheme != "rerun+http":
            socket.create_connection((host, port), timeout=TIMEOUT).close()
        elif not _is_viewer(host, port):
            raise OSError(f"{expected}, where something else answers")
    except (ConnectionError, TimeoutError, socket.gaierror, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OSError(f"{expected}: no answer ({reason})") from None


def _is_viewer(host: str, port: int) -> bool:
    """Return whether what listens at an address speaks HTTP/2, as viewers do; `OSError` if nothing listens."""
    with socket.create_connection((host, port), timeout=TIMEOUT) as line, line.makefile("rb") as answers:
        try:
            line.sendall(PREFACE)
            frame = answers.read(9)  # its length (3), type (1), flags (1) and stream (4)
        except OSError:
            return False
    return len(frame) == 9 and frame[3] == SETTINGS


def _viewer(*, expose: bool) -> str:
    """Return the address of the viewer on this machine; start it unless it runs.

    It belongs to the Python environment in use, and listens on the loopback interface unless it is exposed.
    """
    here = "127.0.0.1"
    started: subprocess.Popen[bytes] | None = None
    end = time.monotonic() + PATIENCE
    while True:
        with suppress(ConnectionError):
            found = _is_viewer(here, PORT)
            if not found and not started:
                raise OSError(f"{NAME}: port {PORT} of this machine is taken by something other than a viewer")
            if expose and not started:
                raise OSError(f"{NAME}: a viewer runs already at port {PORT}: close it, for the next one to be exposed")
            if found:
                return f"rerun+http://{here}:{PORT}/proxy"
        if started is None:
            options = ["--port", str(PORT), "--bind", "0.0.0.0" if expose else here]  # noqa: S104
            started = subprocess.Popen(  # noqa: S603
                [sys.executable, "-P", "-m", "rerun_cli", *options, "--hide-welcome-screen", "--expect-data-soon"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "RERUN_APP_ONLY": "true"},
                start_new_session=True,
            )
            _started.append(started)
        ended = started.poll() is not None
        if ended or time.monotonic() > end:
            what = "has ended" if ended else "does not answer"
            raise OSError(f"{NAME}: the viewer that was started {what}; `rerun` in a terminal says why")
        time.sleep(0.05)


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
