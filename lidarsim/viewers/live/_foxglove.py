"""Foxglove: a server on this machine to which the Foxglove app connects."""

from __future__ import annotations

import threading
import time
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from lidarsim._base.extras import import_extra
from lidarsim.errors import LidarsimError
from lidarsim.viewers._boxes import lines

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.viewers.live._moment import Moment, Painted, World

__all__ = ["PORT", "Foxglove"]

PORT = 8765
"""Foxglove's own default port."""
WORLD = "map"
_OFFSETS = {"position": 0, "color": 12, "intensity": 16, "ring": 20, "label": 22}
_POINT = np.dtype(
    {
        "names": list(_OFFSETS),
        "formats": [("<f4", 3), ("u1", 4), "<f4", "<u2", "<u4"],
        "offsets": list(_OFFSETS.values()),
    }
)


class Foxglove:
    """Serve frames to the Foxglove app, which connects to ``ws://127.0.0.1:8765``.

    Topics are ``/SENSOR/points``, ``/boxes``, ``/surfaces``, ``/moving`` and ``/tf``. The first frame waits until the
    app shows one of them.

    Parameters
    ----------
    port : int
        Port of the server; 0 for any.
    """

    def __init__(self, port: int = PORT) -> None:
        self._foxglove = import_extra("foxglove", "live", "Foxglove")
        self._messages: Any = import_extra("foxglove.messages", "live", "Foxglove")
        self._channels: Any = import_extra("foxglove.channels", "live", "Foxglove")
        self._port = port
        self.paced = True
        self.where = f"ws://127.0.0.1:{port}"
        self._static: Any = None
        self._topics: dict[str, Any] = {}
        self._wanted = threading.Event()
        """Whether a viewer has come since the surfaces were sent."""

    def __enter__(self) -> Self:
        """Start the server."""
        wanted = self._wanted

        class Listener(self._foxglove.ServerListener):  # type: ignore[misc, name-defined]
            def on_subscribe(self, *_: object) -> None:
                wanted.set()

        self._context = self._foxglove.Context()
        try:
            self._server = self._foxglove.start_server(
                name="lidarsim", port=self._port, server_listener=Listener(), context=self._context
            )
        except RuntimeError as error:
            raise LidarsimError(f"{self.where}: no server can be started ({error})") from error
        self.where = f"ws://127.0.0.1:{self._server.port}"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the server."""
        self._server.stop()

    def begin(self, world: World) -> None:
        """Keep the surfaces, which each new viewer is sent, and wait for the first viewer."""
        self._origin = world.origin
        self._static = [self._entity(f"{k} {part.name}", part, 0.0) for k, part in enumerate(world.static)]
        for topic, kind in (("/surfaces", "SceneUpdate"), ("/tf", "FrameTransforms")):
            self._channel(topic, kind)
        while not self._wanted.wait(0.1):
            pass

    def wait(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(seconds)

    def show(self, moment: Moment) -> bool:
        """Send a frame."""
        new, now = self._messages, moment.time
        if self._wanted.is_set():
            self._wanted.clear()
            self._send("/surfaces", new.SceneUpdate(entities=self._static), now)
        transforms = [
            new.FrameTransform(
                timestamp=self._stamp(now),
                parent_frame_id=WORLD,
                child_frame_id=name,
                translation=new.Vector3(**_xyz(sensor.pose[:3, 3] - self._origin)),
                rotation=self._turn(sensor.pose[:3, :3]),
            )
            for name, sensor in moment.sensors.items()
        ]
        self._send("/tf", new.FrameTransforms(transforms=transforms), now)
        for name, sensor in moment.sensors.items():
            records = np.zeros(len(sensor.cloud), _POINT)
            records["position"] = sensor.cloud.xyz
            records["color"][:, :3], records["color"][:, 3] = sensor.rgb, 255
            for field in ("intensity", "ring", "label"):
                if field in sensor.cloud.fields:
                    records[field] = getattr(sensor.cloud, field)
            cloud = new.PointCloud(
                timestamp=self._stamp(now),
                frame_id=name,
                pose=self._pose(np.eye(4)),
                point_stride=_POINT.itemsize,
                fields=_fields(new),
                data=records.tobytes(),
            )
            self._send(f"/{name}/points", cloud, now)
        boxes = moment.boxes
        if boxes is not None:
            wires = [
                new.LinePrimitive(
                    type=new.LinePrimitiveLineType.LineList,
                    pose=self._pose(np.eye(4)),
                    thickness=2.0,
                    scale_invariant=True,
                    points=[new.Point3(**_xyz(end)) for end in ends.reshape(-1, 3)],
                    color=self._color(color, 1.0),
                )
                for ends, color in zip(lines(boxes) - self._origin, moment.box_colors, strict=True)
            ]
            self._send("/boxes", new.SceneUpdate(entities=[self._scene_entity("boxes", now, lines=wires)]), now)
        if moment.movers:
            entities = [self._entity(f"{mover.name} {k}", mover, now) for k, mover in enumerate(moment.movers)]
            self._send("/moving", new.SceneUpdate(entities=entities), now)
        return True

    def _entity(self, name: str, part: Painted, time: float) -> Any:
        new = self._messages
        triangles = new.TriangleListPrimitive(
            pose=self._pose(np.eye(4)),
            points=[new.Point3(**_xyz(point)) for point in part.surface.points() - self._origin],
            indices=part.surface.outward().ravel().tolist(),
            color=self._color(part.color, 0.3),
        )
        return self._scene_entity(name, time, triangles=[triangles])

    def _scene_entity(self, name: str, time: float, **parts: Any) -> Any:
        return self._messages.SceneEntity(timestamp=self._stamp(time), frame_id=WORLD, id=name, **parts)

    def _channel(self, topic: str, kind: str) -> Any:
        if topic not in self._topics:
            self._topics[topic] = getattr(self._channels, f"{kind}Channel")(topic, context=self._context)
        return self._topics[topic]

    def _send(self, topic: str, message: Any, time: float) -> None:
        self._channel(topic, type(message).__name__).log(message, log_time=_nanoseconds(time))

    def _stamp(self, time: float) -> Any:
        return self._messages.Timestamp(*divmod(_nanoseconds(time), 10**9))

    def _pose(self, pose: Floats) -> Any:
        new = self._messages
        return new.Pose(position=new.Vector3(**_xyz(pose[:3, 3])), orientation=self._turn(pose[:3, :3]))

    def _turn(self, rotation: Floats) -> Any:
        from scipy.spatial.transform import Rotation

        x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
        return self._messages.Quaternion(x=x, y=y, z=z, w=w)

    def _color(self, color: str, opacity: float) -> Any:
        red, green, blue = (channel / 255 for channel in bytes.fromhex(color[1:]))
        return self._messages.Color(r=red, g=green, b=blue, a=opacity)


def _fields(new: ModuleType) -> list[Any]:
    kinds = new.PackedElementFieldNumericType
    places: dict[str, tuple[int, Any]] = {}
    for axis, name in enumerate("xyz"):
        places[name] = (4 * axis, kinds.Float32)
    for channel, name in enumerate(("red", "green", "blue", "alpha")):
        places[name] = (12 + channel, kinds.Uint8)
    for name, kind in (("intensity", kinds.Float32), ("ring", kinds.Uint16), ("label", kinds.Uint32)):
        places[name] = (_OFFSETS[name], kind)
    return [new.PackedElementField(name=name, offset=offset, type=kind) for name, (offset, kind) in places.items()]


def _xyz(values: Floats) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def _nanoseconds(time: float) -> int:
    return max(0, round(time * 1e9))
