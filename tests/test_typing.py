"""Type checkers accept correct user scripts and report errors in incorrect ones."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

RIGHT = """
from typing import assert_type

import numpy as np
import numpy.typing as npt

import lidarsim as ls

mesh = ls.TriangleMesh.from_heightfield(np.zeros((3, 3)), 1.0)
assert_type(mesh.faces, npt.NDArray[np.uint32])
assert_type(ls.Sphere((0, 0, 0), 1.0).radius, float)

scene = ls.Scene(class_names={1: "car"})
car = scene.add(mesh, name="car", label=[1] * len(mesh), transform=np.eye(4))
assert_type(car, int)
scene.update(car, transform=None, material=ls.Material(reflectivity=0.2))
assert_type(scene[car], ls.SceneObject)
assert_type(scene.find("car"), list[int])
assert_type(scene.occluded([[0, 0, 1]], [[1, 0, 0]]), npt.NDArray[np.bool_])
assert_type(scene.cast([[0, 0, 1]], [[1, 0, 0]]).t, npt.NDArray[np.float64])

drive = ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0))
for scan in ls.Lidar.preset("velodyne-vlp16").frames(scene, drive, 2):
    assert_type(scan, ls.Scan)
    cloud = ls.PointCloud.concatenate([scan.point_cloud(deskew="end"), scan.point_cloud("sensor")])
    assert_type(cloud[cloud.ring == 3][0], ls.PointCloud)
    assert_type(cloud.label, npt.NDArray[np.uint32])
    cloud.transformed(np.eye(4)).save("scan.pcd", fields=["label"])
    scan.plot(scene=scene, color_by="label", camera="orbit", save="scan.png")

lidar = ls.Lidar.preset("velodyne-vlp16")
rig = ls.Rig({"left": (lidar, None), "right": (lidar, drive.at(0.5), 0.05)})
assert_type(next(rig.frames(scene, drive, 2)), dict[str, ls.Scan])
"""

WRONG = {
    'ls.Sphere(1.0, "0 0 0")\n': "radius",
    "ls.Scene().update(0, transfrom=None)\n": "transfrom",
    "ls.Scene(class_names={'car': 1})\n": "class_names",
    "ls.Lidar.preset('velodyne-vlp16').scan(ls.Scene()).point_cloud('map')\n": "frame",
    "ls.Scene().plot(colour_by='label')\n": "colour_by",
    "ls.Rig({'left': ls.Lidar.preset('velodyne-vlp16')})\n": "Rig",
}


def errors_of(tool: str, *paths: Path) -> list[str]:
    """The lines of errors."""
    mypy = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary"]
    command = mypy if tool == "mypy" else [tool, "--level", "error", "--pythonpath", sys.executable]
    run = subprocess.run([*command, *paths], capture_output=True, text=True, check=False, cwd=Path(__file__).parents[1])
    said = run.stdout + run.stderr
    assert run.returncode == 1, said
    return [line for line in said.splitlines() if ".py:" in line and "error" in line]


@pytest.mark.slow("type checkers find the mistakes in a script of a user, and no others")
@pytest.mark.parametrize("tool", ["mypy", "basedpyright", "pyright"])
def test_a_script_is_checked(tool: str, tmp_path: Path) -> None:
    if tool == "mypy":
        pytest.importorskip("mypy")
    elif shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    right, wrong = tmp_path / "right.py", tmp_path / "wrong.py"
    right.write_text(RIGHT)
    wrong.write_text("import lidarsim as ls\n\n" + "".join(WRONG))
    errors = errors_of(tool, right, wrong)
    assert [line for line in errors if "wrong.py" not in line] == []
    assert len({line.split(":")[1] for line in errors}) == len(WRONG), errors
