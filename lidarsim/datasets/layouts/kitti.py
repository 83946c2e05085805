"""KITTI's object detection, as OpenPCDet and MMDetection3D read it.

``training/velodyne/000000.bin`` holds the points of a frame, ``training/label_2/000000.txt`` its boxes, one per line,
``training/calib/000000.txt`` the calibration, and ``ImageSets/train.txt`` the frames of a split. Frames are numbered
through all sequences; those of the split ``test`` are in ``testing``, with labels, which KITTI keeps to itself. Without
splits, all frames are in ``train``. ``trainval.txt`` has those of ``train`` and ``val``. With a rig, each sensor has a
folder with all of these.

KITTI labels what its camera sees, so there is a virtual camera in the sensor's origin, which looks along x, with y to
its left and z up: an ideal pinhole with KITTI's resolution and focal length, the principal point in the middle of the
image. All of P0 to P3 are its projection. A label has:

- the class; a class without a name, say 10, is ``class_10``,
- truncation: share of the box's volume outside of the view of the camera. Boxes wholly outside have no label,
- occlusion, from the share of an instance's pulses that reach it: 0 from 0.8, 1 from 0.4, 2 below, 3 without any,
- alpha, the bearing of the camera relative to the instance,
- the rectangle of the image, in pixels, around what of the box is in view,
- height, width and length, the middle of its bottom in the frame of the camera, and rotation_y about its y axis, which
  points down. If an instance is tilted towards the sensor, these are of the upright box of its heading around its box.

A frame without labels has one line DontCare of no area, since OpenPCDet does not read empty files. There are no images;
``image_2`` has a black one per frame, because both packages read the size of the image from it.

Points are deskewed to the start of the frame unless the run says otherwise, and points of moving instances are moved
along. With ``cloud: {deskew: false}``, each box is where its points are on average.

Format: https://www.cvlibs.net/datasets/kitti/eval_object.php, the object development kit, readme.txt.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from lidarsim._base.vectors import CUBE, inverse, matvec, product
from lidarsim.config.factories import Model
from lidarsim.datasets.layouts._camera import view_of_box
from lidarsim.datasets.layouts._detection import IGNORED, SETS, Detection, Upright, upright, write_sets
from lidarsim.datasets.layouts._images import black_png
from lidarsim.datasets.layouts._kitti import TO_CAMERA, calibration, read_points
from lidarsim.datasets.layouts._layout import Files, Summary, class_name, encode, number_name, root
from lidarsim.datasets.samples import Annotation, Record, Sample
from lidarsim.io import kitti

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.datasets.store import Store
    from lidarsim.scan.fields import Fields

TRAINING, TESTING = "training", "testing"
NOTHING = f"{IGNORED} -1 -1 -10 0 0 0 0 -1 -1 -1 -1000 -1000 -1000 -10\n"
"""A label that says nothing about no pixel."""

OCCLUSION = (0.8, 0.4)
"""Least visibility of instances that are fully visible (0), and partly occluded (1)."""


class Camera(Model):
    """A virtual camera: width and height of its image and its focal length, all in pixels."""

    width: Annotated[int, Field(ge=1, le=16384)] = 1242
    """Width of the image, pixels."""
    height: Annotated[int, Field(ge=1, le=16384)] = 375
    """Height of the image, pixels."""
    focal: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 721.5377
    """Focal length, pixels."""

    @property
    def projection(self) -> Floats:
        """Frame of the camera to pixels, shape (3, 4)."""
        focal, column, row = self.focal, self.width / 2, self.height / 2
        return np.array([[focal, 0.0, column, 0.0], [0.0, focal, row, 0.0], [0.0, 0.0, 1.0, 0.0]])


class Kitti(Detection):
    """Points and boxes for detectors that learn from KITTI."""

    top: ClassVar[tuple[str, ...]] = (SETS, TRAINING, TESTING)
    reading: ClassVar[str] = """
Labels are of what a virtual camera sees that looks along the sensor's x axis. There are no images: those in `image_2`
are black, and only tell their size.
"""

    type: Literal["kitti"]
    camera: Camera = Camera()
    """Virtual camera in the sensor's origin, looking along x: what it sees has labels."""

    def annotations(self, frame: Iterable[Record]) -> Iterator[tuple[Record, Annotation]]:
        """Yield the boxes that the camera sees."""
        return (pair for pair in super().annotations(frame) if self._sees(pair[1]))

    def contents(self, record: Record, sample: Sample) -> dict[str, bytes]:
        """Return points, labels, calibration and image."""
        labels = "".join(self._label(box, sample.class_names) for box in record.boxes)
        return {
            _file(record, "velodyne", "bin"): encode(kitti.save, sample.cloud._arrays()),
            _file(record, "label_2", "txt"): (labels or NOTHING).encode(),
            _file(record, "calib", "txt"): self._calibration(record),
            _file(record, "image_2", "png"): black_png(self.camera.width, self.camera.height),
        }

    def _label(self, box: Annotation, names: Mapping[int, str]) -> str:
        """Return the line of a box; empty if the camera does not see it."""
        view = self._view(box)
        if view is None:
            return ""
        around, rectangle, truncation = view
        size, yaw = around.size, around.yaw
        x, y, z = matvec(TO_CAMERA[:3, :3], box.center - np.array([0.0, 0.0, size[2] / 2])).tolist()
        length, width, height = size.tolist()
        rotation = _wrap_angle(-yaw - math.pi / 2)
        alpha = _wrap_angle(rotation - math.atan2(x, z))
        numbers = (alpha, *rectangle, height, width, length, x, y, z, rotation)
        occlusion = 3 if box.visibility is None else sum(box.visibility < least for least in OCCLUSION)
        name = class_name(box.label, names)
        return f"{name} {truncation!r} {occlusion} {' '.join(map(repr, numbers))}\n"

    def _sees(self, box: Annotation) -> bool:
        """Return whether any of a box is in view. If its centre is, the box need not be clipped."""
        # Pixels run from 0 to width - 1, so the nearer side of the image is width / 2 - 1 from the principal point.
        camera, (ahead, *aside) = self.camera, box.center
        halves = zip(aside, (camera.width, camera.height), strict=True)
        if all(2 * camera.focal * abs(off) < (pixels - 2) * ahead for off, pixels in halves):
            return True
        return self._view(box) is not None

    def _view(self, box: Annotation) -> tuple[Upright, tuple[float, ...], float] | None:
        """Return the upright box, the rectangle around what the camera sees of it, and the share that it does not.

        None if the camera does not see it; see `view_of_box`. Of most boxes, a sphere around the upright box, whose
        diagonal is at most √3 times as long as that of the box, lies beyond a side of the view.
        """
        camera, (ahead, *aside), reach = self.camera, box.center, math.hypot(*box.size)
        for off, pixels in zip(aside, (camera.width, camera.height), strict=True):
            half = pixels / 2
            if camera.focal * abs(off) - half * ahead > reach * math.hypot(camera.focal, half):
                return None
        around = upright(box)
        corners = product(CUBE * around.size, around.axes.T) + around.center
        view = view_of_box(product(corners, TO_CAMERA[:3, :3].T), camera.projection, camera.width, camera.height)
        return None if view is None else (around, *view)

    def _calibration(self, record: Record) -> bytes:
        body_to_sensor = product(inverse(record.matrix), record.body_matrix)
        matrices = {f"P{index}": self.camera.projection for index in range(4)}
        matrices |= {"R0_rect": np.eye(3), "Tr_velo_to_cam": TO_CAMERA[:3], "Tr_imu_to_velo": body_to_sensor[:3]}
        return calibration(matrices)

    def read(self, store: Store, record: Record) -> Fields:
        """Return coordinates and intensity."""
        return read_points(store, _file(record, "velodyne", "bin"))

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the frames of each split."""
        write_sets(files, summary)


def _file(record: Record, folder: str, suffix: str) -> str:
    part = TESTING if record.split == "test" else TRAINING
    return f"{root(record.sensor)}{part}/{folder}/{number_name(record)}.{suffix}"


def _wrap_angle(angle: float) -> float:
    """Return an angle from −π to π, rad."""
    return math.remainder(angle, 2 * math.pi)
