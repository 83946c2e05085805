"""Watch a run while it is scanned."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from lidarsim._base import validation
from lidarsim._base.files import PathLike
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.run import Run
from lidarsim.scan.scan import Scan
from lidarsim.viewers._moment import Painter
from lidarsim.viewers.rerun import Rerun
from lidarsim.world.scene import Scene

if TYPE_CHECKING:
    Frames: TypeAlias = Iterable[Scan | Mapping[str, Scan]]


def stream(
    what: Run | Frames,
    to: Literal["rerun"] | PathLike = "rerun",
    *,
    scene: Scene | None = None,
    color_by: str | None = None,
    class_names: Mapping[int, str] | None = None,
    boxes: bool = True,
    surfaces: bool = True,
    expose: bool = False,
    each: Callable[[int], object] | None = None,
) -> int:
    """Show a run in Rerun while it is scanned: points, boxes, surfaces, and the poses of the sensors.

    A viewer shows no frame sooner than the sensor would; a file is written as fast as possible. For Foxglove, write the
    run to a bag (``.mcap``), which Foxglove opens.

    Parameters
    ----------
    what : Run, or iterable of Scan or of mappings of str to Scan
        What to show: a run, as from `lidarsim.config.load`, or scans, as from `Lidar.frames` and `Rig.frames`.
    to : {"rerun"} or path-like
        "rerun" opens Rerun; a path, ``.rrd``, is a file that Rerun opens; ``"rerun+http://HOST:9876/proxy"`` is a
        viewer that already runs, also on another machine.
    scene : Scene, optional
        Surfaces to show. Default: those of the run.
    color_by : str, optional
        Scalar field to colour the points by, or ``"height"``. Default: the label if the scene has labels, else the
        intensity. The colours of numbers span the values of the first frame with points.
    class_names : mapping of int to str, optional
        Class names by label. Default: those of the scene, then the names of the objects with the label.
    boxes : bool
        Show the boxes of instances with points, as `Scan.boxes`.
    surfaces : bool
        Show the surfaces of the scene. Planes end a tenth beyond everything else and the points of the first frame.
    expose : bool
        Let other machines reach the viewer that "rerun" opens, which otherwise listens on the loopback interface alone.
    each : callable, optional
        Called with the number of frames shown so far, after each of them.

    Returns
    -------
    int
        Number of frames shown.

    Raises
    ------
    LidarsimError
        If there is no display for a window.
    MissingExtraError
        If Rerun is not installed.
    OSError
        If the file cannot be written, or the viewer does not start, does not run at the address, or has ended.
    TypeError, ValueError
        If there are no frames, `to` is none of these, the scans have no scalar field `color_by`, or an argument is of
        the wrong type.

    Notes
    -----
    Points are deskewed to the start of their scan. Coordinates are relative to whole kilometres near the first pose of
    the sensor, since Rerun uses float32; the property ``origin`` of ``world`` tells them.
    """
    if not isinstance(scene, Scene | None):
        raise ArgumentTypeError("scene", "a Scene", validation.short_repr(scene))
    if class_names is not None:
        class_names = validation.named_labels("class_names", class_names)
    boxes, surfaces = validation.flag("boxes", boxes), validation.flag("surfaces", surfaces)
    expose = validation.flag("expose", expose)
    if each is not None and not callable(each):
        raise ArgumentTypeError("each", "a function of the number of frames", validation.short_repr(each))
    if isinstance(what, Run):
        scene = what.scene if scene is None else scene
        what.check_coverage()
    shown = Rerun(to, expose=expose)
    frames = _frames(what.scans() if isinstance(what, Run) else what)
    first = next(frames, None)
    if first is None:
        raise ArgumentValueError("what", "at least one frame with a scan", "none")
    painter = Painter(scene, color_by=color_by, class_names=class_names, boxes=boxes, surfaces=surfaces)
    painter.moment(0, first)  # tells what is wrong with the arguments before a viewer opens
    with shown:
        return _show(shown, painter, chain([first], frames), each or (lambda _: None))


def _show(viewer: Rerun, painter: Painter, frames: Iterator[Mapping[str, Scan]], each: Callable[[int], object]) -> int:
    count, begin = 0, 0.0
    for scans in frames:
        moment = painter.moment(count, scans)
        if not count:
            viewer.begin(painter.world(moment))
            moment = painter.moment(count, scans)  # with the objects that move
            begin = time.monotonic() - moment.time
        if viewer.paced:
            time.sleep(max(0.0, begin + moment.time - time.monotonic()))
        viewer.show(moment)
        count += 1
        each(count)
    return count


def _frames(scans: Frames) -> Iterator[Mapping[str, Scan]]:
    """Yield the frames that have scans, by sensor name."""
    if not isinstance(scans, Iterable) or isinstance(scans, Scan | Mapping):
        raise ArgumentTypeError("what", "a run, or an iterable of scans", type(scans).__name__)
    for given in scans:
        named: Mapping[str, Any] = given if isinstance(given, Mapping) else {"": given}
        for scan in named.values():
            if not isinstance(scan, Scan):
                raise ArgumentTypeError("what", "a run, or an iterable of scans", f"one of {type(scan).__name__}")
        if named:
            yield named
