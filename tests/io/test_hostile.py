"""No reader is led by a damaged or a hostile file to anything but a cloud or a clear error, nor to much memory."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import NoReturn

import numpy as np
import PIL.Image
import pytest

import lidarsim as ls
from lidarsim import config
from lidarsim.errors import ConfigError, FileFormatError
from lidarsim.io import _records
from lidarsim.patterns import Table
from tests.io.scenes.gltf_files import Gltf
from tests.io.scenes.test_formats import collada

DATA = Path(__file__).parents[1] / "data" / "sensors"
KINDS = 71
"""Of files, at least."""
LONGEST = 1500
"""Characters that an error has at most, with a short path."""

LASERS = "lasers:\n- {laser_id: 0, vert_correction: 0.1}\n"
BOMB = "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n" for before, name in zip("abcdefg", "bcdefgh", strict=True)
)
BOMB = f"a: &a [{', '.join(['1'] * 9)}]\n{BOMB}"


REST = "scene: []\nsensor: {preset: velodyne-vlp16}\n"


def refusal(read: Callable[[], object], kind: type[Exception]) -> str:
    """The text of the error, after checking that it is one short line."""
    with pytest.raises(kind) as caught:
        read()
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < LONGEST
    return text


@pytest.mark.slow("damaged files of each format end in documented errors")
def test_mutations(slow: bool) -> None:
    count = 20_000 if slow else 10  # 71 × 20,000: 1.4 million files, in hours
    command = [sys.executable, str(Path(__file__).with_name("mutations.py")), str(count), "3"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [line for line in result.stdout.splitlines() if " refused, " in line]
    assert result.returncode == 0, result.stdout + result.stderr[-2000:]
    assert len(lines) >= KINDS
    outcomes = [tuple(int(n) for n in re.findall(r"(\d+) (?:read|refused|faults)", line)) for line in lines]
    for line, (read, refused, _) in zip(lines, outcomes, strict=True):
        assert read + refused == count, line
        assert refused > 0, line
    assert sum(read > 0 for read, _, _ in outcomes) > KINDS // 2  # what is damaged is not damaged beyond reading


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (f"{LASERS}x: {'[' * 500}", "expected a list of lasers, got deeper nesting or an alias"),
        (f"{LASERS}{BOMB}num_lasers: *h\n", "expected a list of lasers, got deeper nesting or an alias"),
        (f"{LASERS}num_lasers: {'9' * 5000}\n", "Exceeds the limit (4300 digits) for integer string conversion"),
        (f"{LASERS}num_lasers: {'x' * 10**5}\n", "num_lasers: expected 1, the number of lasers listed, got 'xxx"),
        (f"{LASERS}num_lasers: \x01\n", "not valid YAML: "),
        (f"{LASERS}{'x' * 1000}: 1\n{'*' * 2}\n", "not valid YAML at line 4: "),
        ("x: |\n lasers\n vert_correction\nlasers :\n", "lasers: expected a list of mappings"),
        ("x: |2\n   a\nlasers: []\n...\n# vert_correction", "num_lasers: expected 0"),
        ("- |\n  vert_correction\n- |\n x\n\nlasers: 1", "not valid YAML at line 6"),
        ('"x\nlasers: vert_correction"', "lasers is missing"),
    ],
)
def test_calibrations_of_velodyne(content: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(content, encoding="utf-8")
    assert refusal(lambda: ls.Lidar.from_file(path), FileFormatError).startswith(
        f"{path}: Velodyne calibration YAML: {reason}"
    )


def test_calibrations_of_velodyne_nested_beyond_what_yaml_reads(tmp_path: Path) -> None:
    """Libyaml has a limit of its own from some version on, which it may reach before ours is."""
    path = tmp_path / "a.yaml"
    path.write_text(f"{LASERS}x: {'[' * 50_000}", encoding="utf-8")
    message = refusal(lambda: ls.Lidar.from_file(path), FileFormatError)
    assert message.startswith(f"{path}: Velodyne calibration YAML: ")
    assert "nesting" in message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ('"x": ' + "[" * 100_000, "nested too deeply"),
        ('"x": ' + "1" * 5000, "Exceeds the limit (4300 digits) for integer string conversion"),
        (f'"prod_line": "{"x" * 10**5}"', "prod_line: expected a product that starts with OS-0, OS-1, OS-2, got 'xxx"),
        (f'"lidar_mode": "{"x" * 10**5}"', "lidar_mode: expected one of 512x10, "),
        (f'"lidar_data_format": "{"x" * 10**5}"', "lidar_data_format: expected an object, got 'xxx"),
    ],
)
def test_metadata_of_ouster(changes: str, reason: str, tmp_path: Path) -> None:
    document = json.loads((DATA / "ouster" / "1_14_6cccd_os-882002000138-128_legacy.json").read_text(encoding="utf-8"))
    path = tmp_path / "a.json"
    path.write_text(f"{json.dumps(document)[:-1]}, {changes}}}", encoding="utf-8")
    assert refusal(lambda: ls.Lidar.from_file(path), FileFormatError).startswith(
        f"{path}: Ouster metadata JSON: {reason}"
    )


def test_firing_times_of_hesai(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Channel,fire time(us)\n" + "".join(f"{i + 1},{-1e300 * i}\n" for i in range(40)), encoding="utf-8")
    angles = DATA / "hesai" / "Pandar40P_Angle_Correction_File.csv"
    text = refusal(lambda: ls.Lidar.from_file(angles, firing_times=path), FileFormatError)
    assert text.startswith(f"{path}: Hesai firetime correction CSV: firing_times: expected")
    loops = DATA / "hesai" / "Pandar128E3X_Firetime_Correction_File.csv"
    mirror = DATA / "hesai" / "AT128E2X_Angle_Correction_File.dat"
    text = refusal(lambda: ls.Lidar.from_file(mirror, firing_times=loops), FileFormatError)
    assert text == f"{loops}: Hesai firetime correction CSV: expected one time of each channel, got 2"


def test_channels_of_hesai_that_are_none(tmp_path: Path) -> None:
    data = DATA / "hesai" / "QT128C2X_Firetime_Correction_File.csv"
    lines = data.read_text(encoding="utf-8-sig").splitlines()
    angles = data.with_name("QT128C2X_Angle_Correction_File.csv")
    for number in ("1e300", "-3", "1.5"):
        path = tmp_path / "a.csv"
        path.write_text("\n".join([*lines[:3], f"{number},{lines[3].partition(',')[2]}", *lines[4:]]), encoding="utf-8")
        text = refusal(lambda: ls.Lidar.from_file(angles, firing_times=path), FileFormatError)  # noqa: B023
        kind = "Hesai firetime correction CSV"
        assert text == f"{path}: {kind}: expected numbers of channels, got some that are negative, broken or too great"


def test_times_of_other_poses(tmp_path: Path) -> None:
    path, times = tmp_path / "a.kitti", tmp_path / "times"
    ls.Trajectory([0, 1], [np.eye(4)] * 2).save(path)
    times.write_text("0\n", encoding="utf-8")
    text = refusal(lambda: ls.Trajectory.load(path, times=times), FileFormatError)
    assert text == f"{times}: expected 2 times, one for each pose of {path}, got 1"


def test_angles_of_robosense(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("1\n" * 15 + "200\n", encoding="utf-8")
    text = refusal(lambda: ls.Lidar.from_file(path), FileFormatError)
    assert text.startswith(f"{path}: RoboSense angle CSV: elevations: expected numbers from")


def npy(header: str) -> bytes:
    head = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(64)


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        (
            f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({2**32}, 3)}}",
            "its array claims 103,079,215,104 bytes",
        ),
        (f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({10**30}, 3)}}", "its array claims 24,000,000,000,"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (8,", ""),  # tokenize.TokenError
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (-8, -1)}", ""),
        ("[" * 100, ""),
    ],
)
def test_headers_of_arrays(header: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(npy(header))
    tracemalloc.start()
    text = refusal(lambda: Table.from_file(path, rate=10.0), FileFormatError)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 26
    assert text.startswith(f"{path}: not a readable .npy file: {reason}")
    run = tmp_path / "run.yaml"
    run.write_text("sensor: {preset: velodyne-vlp16}\nscene: [{shape: heightfield, file: a.npy, spacing_m: 1}]\n")
    text = refusal(lambda: config.load(run), ConfigError)
    assert text.startswith(f"{run}:2: scene.0.file: {path}: not a readable .npy file: {reason}")
    archive = tmp_path / "a.npz"
    with zipfile.ZipFile(archive, "w") as file:
        file.write(path, "xyz.npy")
    text = refusal(lambda: ls.PointCloud.load(archive), FileFormatError)
    assert text.startswith(f"{archive}: not a readable .npz point cloud: {reason and f'xyz: {reason}'}")


def test_texts_of_no_characters_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("xyz.npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 3)}"))
        empty = "[('label', 'V0'), ('name', 'V0')]"
        file.writestr("class_names.npy", npy(f"{{'descr': {empty}, 'fortran_order': False, 'shape': (2000000000,)}}"))
    text = refusal(lambda: ls.PointCloud.load(path), FileFormatError)
    assert text == f"{path}: not a readable .npz point cloud: class_names: its array claims 2,000,000,000 bytes of 192"


@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".npz", ".pcd", ".ply"])
def test_columns_are_counted(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / f"a{suffix}"
    cloud = ls.PointCloud(xyz=np.zeros((1, 3)), **{f"a{k}": np.zeros(1) for k in range(9)})
    cloud.save(path)
    count = len(cloud.fields) if suffix == ".npz" else len(cloud.fields) + 2
    assert ls.PointCloud.load(path).fields == cloud.fields
    monkeypatch.setattr(_records, "MOST_COLUMNS", count - 1)
    expected = f"expected at most {count - 1} columns, got {count}"
    assert refusal(lambda: ls.PointCloud.load(path), FileFormatError).endswith(expected)
    assert refusal(lambda: cloud.save(path), FileFormatError).endswith(expected)


def test_an_archive_whose_compression_is_damaged(tmp_path: Path) -> None:
    path, content = tmp_path / "a.npz", BytesIO()
    np.save(content, np.ones((10, 3)))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as file:
        file.writestr("xyz.npy", content.getvalue())
    data = path.read_bytes()
    place = data.index(b"BZh") + 10
    path.write_bytes(data[:place] + bytes(8) + data[place + 8 :])
    text = refusal(lambda: ls.PointCloud.load(path), FileFormatError)
    assert text == f"{path}: not a readable .npz point cloud: Invalid data stream"


def test_a_scene_that_claims_more_than_it_has(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(b"glTF" + b"".join(n.to_bytes(4, "little") for n in (2, 2**31, 2**31 - 20, 0x4E4F534A)) + b"{}")
    assert "cannot be read as a mesh" in refusal(lambda: ls.TriangleMesh.from_file(path), FileFormatError)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (f"{BOMB}seed: *h\n", ":7: expected at most 1,000,000 values, counting aliases, got 5,380,840"),
        (f"seed: {'[' * 99}1{']' * 99}\n", ":1: seed: expected an integer, got a list of 1"),
        (f"seed: {'[' * 100}1{']' * 100}\n", ":1: not valid YAML: nested too deeply"),
        (f"seed: {'[' * 50_000}\n", ":1: not valid YAML: nested too deeply"),
        (
            "".join(f"a{i}: &a{i} [{f'*a{i - 1}' if i else 1}]\n" for i in range(5000)),
            ":101: not valid YAML: nested too",
        ),
        ("seed: &a [*a]\n", ":1: not valid YAML: this value contains itself"),
        (f"? {'x' * 10**5}\n: 1\n", ":1: xxx"),
        (f"seed: {'x' * 10**5}\n", ":1: seed: expected an integer, got 'xxx"),
        (f"seed: !{'x' * 10**5} 1\n", ":1: not valid YAML: !xxx"),
        (f"seed: *{'x' * 10**5}\n", ":1: not valid YAML: found undefined alias"),
        (
            f"seed: {'9' * 5000}\n",
            ":1: seed: expected a number from -1.8e308 to 1.8e308, got 999999999999...9999999999999",
        ),
        (f"seed: 0x{'f' * 5000}\n", ":1: seed: "),
        (f"pose: {{position_m: [0x{'f' * 5000}, 0, 0]}}\n", ":1: "),
        (f"pose: {{file: {'x' * 10**5}}}\n", ":1: pose.file: cannot read "),
        ('pose: {file: "a\\0b"}\n', ":1: pose.file: cannot read "),
        ("a" * (1 << 24) + "\n", ": expected at most 16,777,216 bytes of YAML, got more"),
    ],
)
def test_configurations(content: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text(f"{content}{REST}", encoding="utf-8")
    assert refusal(lambda: config.load(path), ConfigError).startswith(f"{path}{reason}")


def test_overrides(tmp_path: Path) -> None:
    path = tmp_path / "run.yaml"
    path.write_text("seed: 1\n", encoding="utf-8")
    for assignment in ("a." * 5000 + "b=1", f"seed={BOMB[:-1]}", "seed=" + "[" * 300 + "]" * 300):
        with pytest.raises(ConfigError, match=r"^--set "):
            config.load(path, [assignment])


@pytest.mark.parametrize("content", ["root:x:0:0:secret\nhidden:y:1:1:secret\n", "secret\n", '"secret"', "- secret\n"])
def test_a_file_that_is_no_configuration_is_not_quoted(content: str, tmp_path: Path) -> None:
    path = tmp_path / "passwords"
    path.write_text(content, encoding="utf-8")
    run = tmp_path / "run.yaml"
    run.write_text("scene: {file: passwords}\nsensor: {preset: velodyne-vlp16}\n", encoding="utf-8")
    for read in (lambda: config.load(path), lambda: config.read_lidar(path), lambda: config.load(run)):
        assert "secret" not in refusal(read, ConfigError) or content.startswith("-")
    assert "secret" not in refusal(lambda: ls.Lidar.from_file(path), FileFormatError)


@pytest.mark.skipif(not Path("/dev/zero").is_char_device(), reason="there is no such device here")
def test_only_regular_files_are_read(tmp_path: Path) -> None:
    for suffix in (".bin", ".csv", ".npy", ".mcap", ".label", ".json", ".ply", ".glb", ".tum", ".laz", ".tif"):
        (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    expected = "expected a regular file, got a pipe or device"
    angles = DATA / "hesai" / "Pandar40P_Angle_Correction_File.csv"
    for read in (
        lambda: ls.PointCloud.load(tmp_path / "zero.bin"),
        lambda: ls.PointCloud.load(tmp_path / "zero.mcap"),
        lambda: ls.io.semantickitti.read_labels(tmp_path / "zero.label"),
        lambda: list(ls.io.las.read(tmp_path / "zero.laz")),
        lambda: Table.from_file(tmp_path / "zero.csv", rate=10.0),
        lambda: Table.from_file(tmp_path / "zero.npy", rate=10.0),
        lambda: ls.Lidar.from_file(tmp_path / "zero.json"),
        lambda: ls.Lidar.from_file(angles, firing_times=tmp_path / "zero.csv"),
        lambda: ls.TriangleMesh.from_raster(tmp_path / "zero.tif"),
    ):
        assert expected in refusal(read, FileFormatError)
    with pytest.raises(FileNotFoundError, match="no such mesh file"):
        ls.TriangleMesh.from_file(tmp_path / "zero.ply")
    for scene in (
        "[{shape: mesh, file: zero.ply}]",
        "[{shape: scene_file, file: zero.glb}]",
        "[{shape: heightfield, file: zero.npy, spacing_m: 1}]",
        "[{shape: raster, file: zero.tif}]",
        "{file: zero.ply}",
    ):
        run = tmp_path / "run.yaml"
        run.write_text(f"sensor: {{preset: velodyne-vlp16}}\nscene: {scene}\n", encoding="utf-8")
        assert expected in refusal(lambda: config.load(run), ConfigError)  # noqa: B023
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    with pytest.raises(ConfigError, match=expected):
        config.load(tmp_path / "zero.yaml")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_clouds_are_not_read_from_pipes(tmp_path: Path) -> None:
    for suffix in (
        ".npz",
        ".pcd",
        ".ply",
        ".las",
        ".laz",
        ".csv",
        ".xyz",
        ".bin",
        ".pcd.bin",
        ".label",
        ".mcap",
        ".db3",
    ):
        path = tmp_path / f"pipe{suffix}"
        os.mkfifo(path)
        readers = [ls.PointCloud.load]
        readers += [lambda path: list(ls.io.las.read(path))] if suffix in {".las", ".laz"} else []
        readers += [ls.io.semantickitti.read_labels] if suffix == ".label" else []
        for read in readers:
            text = refusal(lambda: read(path), FileFormatError)  # noqa: B023
            assert text == f"{path}: expected a regular file, got a pipe or device"


@pytest.mark.skipif(sys.platform == "win32", reason="links take permission there")
def test_a_link_to_itself_is_one_line(tmp_path: Path) -> None:
    for suffix in (".yaml", ".ply"):
        (tmp_path / f"loop{suffix}").symlink_to(f"loop{suffix}")
    (tmp_path / "run.yaml").write_text("sensor: {preset: velodyne-vlp16}\nscene: [{shape: plane, normal: [0, 0, 1]}]\n")
    for arguments in (
        ["check", "loop.yaml"],
        ["scan", "run.yaml", "-o", "loop.ply"],
    ):
        result = subprocess.run(
            [sys.executable, "-c", "from lidarsim.cli import main; main()", *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert result.returncode == 2, result.stderr
        assert result.stderr.startswith("lidarsim: loop.")
        assert result.stderr.count("\n") == 1


LINES = "root:x:0:0:hunter2:/root:/bin/bash\n-----BEGIN KEY-----\nMIIhunter2==\n\"hunter2\" 'hunter2' `hunter2`\n"
FOREIGN = [
    LINES,
    '{"hunter2": "hunter2", "b": {"hunter2": 1}}',
    "[hunter2]\nhunter2 = hunter2\n",
    "hunter2,password,hunter2\nhunter2,x,hunter2\n",
    "x,y,z\nhunter2,x,y\n",
    "1 2 3 4\n1 2 3 hunter2\n",
    "2\n1 2 hunter2\n",
    "0 1 2 3 0 0 0 1\n1 2 3 4 hunter2 0 0 1\n",
    "hunter2: hunter2\nother: [hunter2]\n",
    "<?xml version='1.0'?><hunter2 hunter2='hunter2'>hunter2</hunter2>",
    "\x1b[2Jhunter2\x1b[31m\n",
    "ply\nhunter2 hunter2\n",
    "solid hunter2\nhunter2 hunter2\n",
]


def readers(path: Path) -> dict[str, Callable[[], object]]:
    """Every reader of files on one file of somebody else's; `path` has no suffix."""
    angles = DATA / "hesai" / "Pandar40P_Angle_Correction_File.csv"
    poses = path.with_name("poses.txt")
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n", encoding="utf-8")
    suffixes = [".obj", ".off", ".ply", ".stl", ".glb", ".gltf", ".xyz", ".dxf", ".zip"]
    clouds = [
        ".bin",
        ".csv",
        ".db3",
        ".las",
        ".laz",
        ".mcap",
        ".npz",
        ".pcd",
        ".pcd.bin",
        ".ply",
        ".pts",
        ".ptx",
        ".txt",
        ".xyz",
    ]
    return {
        "trajectory": lambda: ls.Trajectory.load(path),
        "times": lambda: ls.Trajectory.load(poses, times=path),
        "table": lambda: Table.from_file(link_to(path, ".csv"), rate=10.0),
        "table of NumPy": lambda: Table.from_file(link_to(path, ".npy"), rate=10.0),
        "firing times": lambda: ls.Lidar.from_file(angles, firing_times=path),
        "sensor": lambda: ls.Lidar.from_file(path),
        "labels": lambda: ls.io.semantickitti.read_labels(link_to(path, ".label")),
        "bag": lambda: list(ls.io.rosbag.read(link_to(path, ".mcap"))),
        "bag of SQLite": lambda: list(ls.io.rosbag.read(link_to(path, ".db3"))),
        "scene in YAML": lambda: ls.Scene.from_file(path),
        "run": lambda: config.load(path),
        "raster": lambda: ls.TriangleMesh.from_raster(path),
        **{f"scene{suffix}": lambda suffix=suffix: ls.Scene.from_file(link_to(path, suffix)) for suffix in suffixes},
        **{
            f"mesh{suffix}": lambda suffix=suffix: ls.TriangleMesh.from_file(link_to(path, suffix))
            for suffix in suffixes
        },
        **{f"cloud{suffix}": lambda suffix=suffix: ls.PointCloud.load(link_to(path, suffix)) for suffix in clouds},
    }


def link_to(path: Path, suffix: str) -> Path:
    """A link to `path` whose name ends in `suffix`."""
    link = path.with_name(f"link{suffix}")
    if not link.is_symlink():
        link.symlink_to(path)
    return link


@pytest.mark.skipif(sys.platform == "win32", reason="links take permission there")
@pytest.mark.parametrize("content", FOREIGN)
def test_no_error_shows_lines_of_a_file_that_is_something_else(content: str, tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.write_text(f"{content}\n" if len(content) % 4 == 0 else content, encoding="utf-8")  # may be no labels
    shown = {}
    for name, read in readers(path).items():
        with pytest.raises((FileFormatError, ConfigError)) as caught:
            read()
        if re.search("root|hunter2|KEY|[^ -~§–…°×²]", str(caught.value).replace(str(tmp_path), "")):
            shown[name] = str(caught.value)
    assert shown == {}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_no_reader_waits_for_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)

    def give_up(*_: object) -> NoReturn:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, give_up)
    try:
        for name, read in readers(path).items():
            signal.alarm(60)
            with pytest.raises((FileFormatError, ConfigError, FileNotFoundError)) as caught:
                read()
            assert re.search("expected a regular file, got a pipe or device|no such mesh file", str(caught.value)), name
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


TRIANGLE = np.array([[5, 0, 0], [5, 1, 0], [5, 0, 1]], "<f4").tobytes()


def gltf(uri: str, image: str | None = None) -> str:
    """A triangle whose corners are in the file `uri`, with a texture."""
    document: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, **({"material": 0} if image else {})}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": uri}],
    }
    if image:
        document["images"] = [{"uri": image}]
        document["textures"] = [{"source": 0}]
        document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    return json.dumps(document)


def both(path: Path) -> Iterator[Callable[[], object]]:
    yield lambda: ls.TriangleMesh.from_file(path)
    yield lambda: ls.Scene.from_file(path)


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A folder, with files beside it and in it."""
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    for file in (tmp_path / "corners.bin", folder / "a b.bin", folder / "sub" / "corners.bin"):
        file.write_bytes(TRIANGLE)
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe")
    (folder / "link.bin").symlink_to(tmp_path / "corners.bin")
    (folder / "within.bin").symlink_to(folder / "sub" / "corners.bin")
    return folder


@pytest.mark.skipif(sys.platform == "win32", reason="links take permission there")
@pytest.mark.parametrize("uri", ["a%20b.bin", "a b.bin", "sub/corners.bin", "./sub/../a%20b.bin", "within.bin"])
def test_files_beside_and_below_are_read(outside: Path, uri: str) -> None:
    path = outside / "a.gltf"
    path.write_text(gltf(uri, image="nowhere.png"), encoding="utf-8")
    corners = [[5, 0, 0], [5, 1, 0], [5, 0, 1]]
    assert ls.TriangleMesh.from_file(path).vertices.tolist() == [[x, -z, y] for x, y, z in corners]
    assert ls.Scene.from_file(path)[0].shape.vertices.tolist() == corners  # type: ignore[attr-defined]


@pytest.mark.skipif(sys.platform == "win32", reason="links take permission there")
def test_files_beside_what_a_link_leads_to_are_read(outside: Path, tmp_path: Path) -> None:
    (outside / "a.gltf").write_text(gltf("a%20b.bin"), encoding="utf-8")
    (tmp_path / "else").mkdir()
    link = tmp_path / "else" / "link.gltf"
    link.symlink_to(outside / "a.gltf")
    assert len(ls.TriangleMesh.from_file(link)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="links take permission there")
@pytest.mark.parametrize(
    "uri",
    [
        "pipe",
        "sub",
        "link.bin",
        "../corners.bin",
        "%2e%2e/corners.bin",
        "sub/../../corners.bin",
        "..%2fcorners.bin",
        "..\\corners.bin",
        "\\\\host\\share\\corners.bin",
        "//host/share/corners.bin",
        "C:\\corners.bin",
        "C:/corners.bin",
        "/dev/zero",
        "{outside}/a b.bin",
        "file://{outside}/a%20b.bin",
        "FILE:///etc/passwd",
        "http://127.0.0.1:9/corners.bin",
        "a%00b.bin",
        "none.bin",
        "",
    ],
)
def test_no_other_file_is_read(outside: Path, uri: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def connect(*_: object) -> NoReturn:
        raise AssertionError("asked the network")

    monkeypatch.setattr(socket, "socket", connect)
    path = outside / "a.gltf"
    path.write_text(gltf(uri.format(outside=outside)), encoding="utf-8")
    for read in both(path):
        assert "it names " in refusal(read, FileFormatError)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("name", ["pipe", "/dev/zero", "http://127.0.0.1:9/a"])
def test_textures_and_materials_are_not_opened(outside: Path, name: str) -> None:
    vertices = "v 5 0 0\nv 5 1 0\nv 5 0 1\nvt 0 0\n"
    (outside / "maps.mtl").write_text(f"newmtl m\nmap_Kd {name}\n", encoding="utf-8")
    header = (
        "property float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_index\n"
    )
    header = f"ply\nformat ascii 1.0\ncomment TextureFile {name}\nelement vertex 3\n{header}end_header\n"
    for suffix, text in (
        ("gltf", gltf("a b.bin", image=name)),
        ("obj", f"{vertices}mtllib {name}\nusemtl m\nf 1/1 2/1 3/1\n"),
        ("obj", f"{vertices}mtllib maps.mtl\nusemtl m\nf 1/1 2/1 3/1\n"),
        ("ply", f"{header}5 0 0\n5 1 0\n5 0 1\n3 0 1 2\n"),
    ):
        path = outside / f"a.{suffix}"
        path.write_text(text, encoding="utf-8")
        for read in both(path):
            read()


ZEROS = {"componentType": 5126, "count": 3_000_000, "type": "VEC3"}


def shared_positions(file: Gltf) -> None:
    position = file.numbers(np.ones((30_000, 3)))
    for _ in range(100):
        file.node(mesh=file.mesh({"attributes": {"POSITION": position}}))


def overlapping_views(file: Gltf) -> None:
    view = file.view(bytes(360_000))
    for k in range(200):
        place = {"bufferView": view, "byteOffset": 12 * k, "componentType": 5126, "count": 29_700, "type": "VEC3"}
        file.node(mesh=file.mesh({"attributes": {"POSITION": file.put("accessors", place)}}))


def shared_zeros(file: Gltf) -> None:
    zeros = file.put("accessors", ZEROS)
    for _ in range(30):
        file.node(mesh=file.mesh({"attributes": {"POSITION": zeros}}))


def copies_from_nothing(file: Gltf) -> None:
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": file.put("accessors", ZEROS)}}}
    file.node(mesh=file.mesh(), extensions=instancing)


def parts_at_many_places(file: Gltf) -> None:
    mesh = file.mesh(*[file.primitive()] * 300)
    for _ in range(300):
        file.node(mesh=mesh)


def shared_targets(file: Gltf) -> None:
    position = file.numbers(np.ones((30_000, 3)))
    primitive = {"attributes": {"POSITION": position}, "targets": [{"POSITION": position}] * 200}
    file.node(mesh=file.mesh(primitive, weights=[1.0] * 200))


def many_sets_of_joints(file: Gltf) -> None:
    attributes = {"POSITION": file.numbers(np.ones((3000, 3)))}
    joints, weights = file.numbers(np.zeros((3000, 4)), "u1"), file.numbers(np.ones((3000, 4)))
    for k in range(400):
        attributes |= {f"JOINTS_{k}": joints, f"WEIGHTS_{k}": weights}
    file.node(mesh=file.mesh({"attributes": attributes}), skin=file.put("skins", {"joints": [0]}))


def textures_of_one_image(file: Gltf) -> None:
    image = BytesIO()
    PIL.Image.new("1", (4000, 4000)).save(image, "PNG")
    content = file.view(image.getvalue())
    for k in range(5):
        file.put("images", {"bufferView": content})
        texture = {"baseColorTexture": {"index": file.put("textures", {"source": k})}}
        material = file.put("materials", {"pbrMetallicRoughness": texture})
        places = {"TEXCOORD_0": file.numbers(np.zeros((3, 2)))}
        file.node(mesh=file.mesh(file.primitive(attributes=places, material=material)))


BOMBS = (
    shared_positions,
    overlapping_views,
    shared_zeros,
    copies_from_nothing,
    parts_at_many_places,
    shared_targets,
    many_sets_of_joints,
    textures_of_one_image,
)


@pytest.mark.slow("what small files name again and again is counted")
@pytest.mark.parametrize("bomb", BOMBS)
def test_what_a_scene_names_again_is_counted(bomb: Callable[[Gltf], None], tmp_path: Path) -> None:
    file = Gltf()
    bomb(file)
    path = file.save(tmp_path / "a.glb")
    assert path.stat().st_size < 1 << 20
    tracemalloc.start()
    text = refusal(lambda: ls.Scene.from_file(path, reflectivity="color"), FileFormatError)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert re.search("refused as a decompression bomb|at most 67,108,864 pixels in all textures", text)
    assert peak < 1 << 29


def test_one_mesh_of_a_scene_that_places_a_mesh_many_times(tmp_path: Path) -> None:
    file = Gltf()
    mesh = file.mesh({"attributes": {"POSITION": file.numbers(np.ones((9000, 3)))}})
    for _ in range(1000):
        file.node(mesh=mesh)
    path = file.save(tmp_path / "a.glb")
    assert len(ls.Scene.from_file(path)) == 1000
    text = refusal(lambda: ls.TriangleMesh.from_file(path), FileFormatError)
    assert text.endswith(
        "expected at most 268,435,456 bytes of meshes that are placed again in one mesh, got more; read it as a scene"
    )


def test_nodes_of_collada_that_multiply(tmp_path: Path) -> None:
    below = [f'<instance_node url="#n{k + 1}"/>' * 10 for k in range(9)]
    nodes = "".join(f'<node id="n{k}">{many}</node>' for k, many in enumerate(below))
    path = tmp_path / "a.dae"
    path.write_text(collada(f'{nodes}<node id="n9"/>'), encoding="utf-8")
    assert "refused as a decompression bomb" in refusal(lambda: ls.Scene.from_file(path), FileFormatError)


def test_a_geometry_of_collada_in_many_materials(tmp_path: Path) -> None:
    corners = " ".join(map(str, range(9000)))
    vertex = '<input semantic="VERTEX" source="#v" offset="0"/>'
    faces = f'<triangles material="m" count="3000">{vertex}<p>{corners}</p></triangles>'
    bound = "<bind_material><technique_common>{}</technique_common></bind_material>"
    materials = [bound.format(f'<instance_material symbol="m" target="#{k}"/>') for k in range(300)]
    nodes = "".join(f'<instance_geometry url="#g">{material}</instance_geometry>' for material in materials)
    path = tmp_path / "a.dae"
    path.write_text(collada(f"<node>{nodes}</node>", faces, positions="0 1 2 " * 9000), encoding="utf-8")
    assert "refused as a decompression bomb" in refusal(lambda: ls.Scene.from_file(path), FileFormatError)


@pytest.mark.parametrize(
    "messages",
    [
        "CREATE TABLE messages (id, topic_id, timestamp, data BLOB AS (zeroblob(900000000)))",
        "CREATE VIEW messages AS SELECT 1 AS id, 1 AS topic_id, 1 AS timestamp, zeroblob(900000000) AS data",
        "CREATE TABLE messages (id, topic_id, timestamp, data); CREATE VIEW schema AS SELECT 3 AS schema_version",
    ],
)
def test_databases_that_compute_what_they_hold(messages: str, tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as database:
        columns = "id, name, type, serialization_format, offered_qos_profiles"
        database.executescript(f"CREATE TABLE topics ({columns}); {messages};")
    text = refusal(lambda: list(ls.io.rosbag.read(path)), FileFormatError)
    name = "schema" if "schema" in messages else "messages"
    assert text.endswith(f"its table '{name}' computes rows; expected tables that hold them")
