"""Damage files in every way that pays, and see that a reader gives what it reads or a clear error, in little memory.

    python tests/io/mutations.py [mutations a reader] [seed] [what the name of a reader begins with ...]

On Linux a limit on the address space makes an allocation of more than `ROOM` a `MemoryError`, which counts as a fault.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from io import BytesIO
from pathlib import Path

import DracoPy
import numpy as np
import PIL.Image
import plyfile
import pypcd4
import rasterio
import trimesh
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as BagReader
from rosbags.rosbag2 import Writer as BagWriter
from scipy.spatial.transform import Rotation

from lidarsim import Lidar, PointCloud, Rule, Scene, Trajectory, TriangleMesh, config, io
from lidarsim.errors import ConfigError, FileFormatError
from lidarsim.io import rosbag
from lidarsim.io.semantickitti import read_labels
from lidarsim.patterns import Table
from lidarsim.scan.formats import FORMATS

sys.path.append(str(Path(__file__).parents[2]))
from tests.io.scenes.gltf_files import Gltf
from tests.io.scenes.test_formats import BOUND, COLORED, collada

ROOM = 1 << 30
LONGEST = 2000  # characters of an error, path and place included
ROOT = Path(__file__).parents[2]
BESIDE = ("scene_file.yaml", "heightfield.yaml", "Angle_Correction", "Firetime_Correction")
"""Files that are read with a damaged one, and may be blamed."""
NUMBERS = (0, 1, 2, 255, 65_535, 2**31 - 1, 2**31, 2**32 - 1, 10**12, 2**63 - 1, 2**64 - 1)


def cloud(points: int = 60) -> PointCloud:
    rng = np.random.default_rng(5)
    return PointCloud(
        xyz=rng.normal(scale=30, size=(points, 3)),
        range=rng.random(points) * 50,
        intensity=rng.random(points),
        time=np.sort(rng.random(points)) * 0.1,
        ring=rng.integers(0, 16, points),
        return_number=np.ones(points),
        return_count=np.ones(points),
        label=rng.integers(0, 99, points),
        normal=rng.normal(size=(points, 3)),
        flow=rng.normal(size=(points, 2)),
    )


def samples(folder: Path) -> Iterator[tuple[str, Path, Callable[[Path], object]]]:
    """Name, file and reader of a sound file of each kind."""
    for suffix in sorted(FORMATS.keys() - {".label"}):
        path = folder / f"plain{suffix}"
        cloud().save(path)
        yield suffix, path, PointCloud.load
    path = folder / "labels.label"
    cloud().save(path)
    yield ".label", path, read_labels

    path = folder / "deflated.npz"
    np.savez_compressed(path, **{name: getattr(cloud(), name) for name in cloud().fields})
    yield ".npz deflated", path, PointCloud.load

    points = np.column_stack((cloud().xyz, cloud().intensity)).astype(np.float32)
    for encoding in (pypcd4.Encoding.ASCII, pypcd4.Encoding.BINARY_COMPRESSED):
        path = folder / f"{encoding.name}.pcd"
        pypcd4.PointCloud.from_xyzi_points(points).save(path, encoding)
        yield f".pcd {encoding.name.lower()}", path, PointCloud.load

    vertices = np.zeros(20, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("near", "O")])
    vertices["near"] = [[1.0, 2.0]] * 20
    faces = np.array([([0, 1, 2],)] * 5, [("vertex_indices", "O")])
    for text in (True, False):
        path = folder / f"lists{text}.ply"
        elements = [plyfile.PlyElement.describe(vertices, "vertex"), plyfile.PlyElement.describe(faces, "face")]
        plyfile.PlyData(elements, text=text).write(path)
        yield f".ply lists {'text' if text else 'binary'}", path, PointCloud.load

    custom = folder / "custom.mcap"
    with rosbag.Writer(custom, layout="livox", trajectory=np.eye(4)) as bag:
        bag.write_cloud(cloud())
    yield ".mcap livox", custom, PointCloud.load

    with BagReader(folder / "plain.mcap") as old:
        new = BagWriter(folder / "zstd", version=8, storage_plugin=StoragePlugin.MCAP)
        new.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with new:
            topics = {}
            for connection, stamp, data in old.messages():
                if connection.id not in topics:
                    topics[connection.id] = new.add_connection(
                        connection.topic,
                        connection.msgtype,
                        msgdef=connection.msgdef.data,
                        rihs01=connection.digest or "x",
                    )
                new.write(topics[connection.id], stamp, data)
    yield ".mcap zstd", folder / "zstd" / "zstd.mcap", PointCloud.load


URDF = """<?xml version="1.0"?>
<robot name="arm">
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name="base"><collision><geometry><box size="1 1 0.2"/></geometry></collision></link>
  <link name="upper">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arm/upper.dae"/></geometry><material name="blue"/></visual>
    <collision><geometry><mesh filename="package://arm/mesh.stl" scale="1 1 2"/></geometry></collision>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.1" rpy="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def texts(folder: Path) -> Iterator[tuple[str, Path, Callable[[Path], object]]]:
    """The same of configurations, of vendors' files and of what else describes a scene, a sensor or a path."""
    shutil.copytree(ROOT / "configs", folder / "configs")
    for path in sorted((folder / "configs").glob("*.yaml")):
        yield f"config {path.stem}", path, config.load
    yield "config sensor", folder / "configs" / "sensors" / "city-lidar.yaml", Lidar.from_file
    shutil.copytree(ROOT / "tests" / "data" / "sensors", folder / "sensors")
    for path in sorted((folder / "sensors").glob("*/*.*")):
        if path.parent.name == "hesai" and "Firetime" in path.name:
            angles = path.with_name(path.name.replace("Firetime", "Angle"))
            yield f"vendor {path.name}", path, partial(with_firing_times, angles)
        elif path.suffix in {".yaml", ".json", ".csv", ".dat"} and not path.name.startswith(("xyz", "QT128", "mid")):
            yield f"vendor {path.name}", path, Lidar.from_file

    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.linspace([0, 0, 0], [0, 0, 1], 30)).as_matrix()
    drive = Trajectory(np.arange(30) / 10, poses)
    (folder / "times").write_text("".join(f"{index}\n" for index in range(30)))
    for suffix in (".tum", ".csv", ".kitti"):
        path = folder / f"drive{suffix}"
        drive.save(path)
        yield f"trajectory {suffix}", path, partial(load_path, suffix)
    path = folder / "livox.csv"
    rows = [f"{i},{i * 0.9},{38 + 59.4 * (i * 7 % 400) / 399}\n" for i in range(401)]  # the field of view of a Mid-360
    path.write_text(f"Time/s,Azimuth/deg,Zenith/deg\n{''.join(rows)}")
    yield "vendor livox.csv", path, Lidar.from_file
    path = folder / "table.csv"
    path.write_text(
        "azimuth_deg,elevation_deg,time_s,ring\n" + "".join(f"{i},{i / 9},{i / 99},{i % 4}\n" for i in range(60))
    )
    yield "table .csv", path, partial(Table.from_file, rate=10.0)
    np.save(folder / "table.npy", np.random.default_rng(1).normal(size=(50, 3)))
    yield "table .npy", folder / "table.npy", partial(Table.from_file, rate=10.0)
    mesh = trimesh.creation.icosphere(subdivisions=1)
    for suffix in (".ply", ".stl", ".obj", ".off", ".glb"):
        path = folder / f"mesh{suffix}"
        mesh.export(path)
        yield f"mesh {suffix}", path, TriangleMesh.from_file
    for suffix, options in ((".ply", {"encoding": "ascii"}), (".stl", {"file_type": "stl_ascii"})):
        path = folder / f"mesh_text{suffix}"
        mesh.export(path, **options)
        yield f"mesh text {suffix}", path, TriangleMesh.from_file
    yield from rasters(folder)
    yield from scenes(folder)
    for path in (folder / "configs" / "scenes" / "warehouse.xml", folder / "robot.urdf"):
        if path.suffix == ".urdf":
            path.write_text(URDF)
        yield f"scene {path.suffix}", path, Scene.from_file
    for shape, file in (("scene_file", "mesh.glb"), ("heightfield", "table.npy")):
        scene = folder / f"{shape}.yaml"
        more = ", spacing_m: 1" if shape == "heightfield" else ""
        scene.write_text(
            f"sensor: {{preset: velodyne-vlp16}}\nscene: [{{shape: {shape}, file: damaged{file[-4:]}{more}}}]\n"
        )
        yield shape, folder / file, partial(load_scene, scene)


def rasters(folder: Path) -> Iterator[tuple[str, Path, Callable[[Path], object]]]:
    """The same of elevation models."""
    z = np.random.default_rng(6).normal(300, 20, (20, 24)).astype(np.float32)
    z[3:6, 4:9] = -9999
    profile = {"height": 20, "width": 24, "count": 1, "dtype": "float32", "nodata": -9999, "crs": "EPSG:32632"}
    profile["transform"] = rasterio.Affine(10, 0, 500_000, 0, -10, 5_200_000)
    tiles = {"tiled": True, "blockxsize": 16, "blockysize": 16}
    for name, options in (
        ("strips", {}),
        ("tiles", {**tiles, "compress": "deflate", "predictor": 3}),
        ("lzw", {"compress": "lzw", "BIGTIFF": "YES"}),
        ("lerc", {**tiles, "compress": "lerc_zstd"}),
    ):
        path = folder / f"{name}.tif"
        with rasterio.open(path, "w", driver="GTiff", **profile, **options) as file:
            file.write(z, 1)
        yield f"raster {name}", path, TriangleMesh.from_raster
    path = folder / "dem.asc"
    text = "\n".join(" ".join(map(str, row)) for row in z.tolist())
    head = "ncols 24\nnrows 20\nxllcorner 500000\nyllcorner 5200000\ncellsize 10\nNODATA_value -9999\n"
    path.write_text(f"{head}{text}\n", encoding="ascii")
    yield "raster .asc", path, TriangleMesh.from_raster


def scenes(folder: Path) -> Iterator[tuple[str, Path, Callable[[Path], object]]]:
    """The same of scene files that have all that a reader reads."""
    for suffix in (".gltf", ".glb"):
        path = all_of_gltf().save(folder / f"scene{suffix}", uri="scene.bin" if suffix == ".gltf" else None)
        (folder / "scene.bin").write_bytes(all_of_gltf().data)
        yield f"scene {suffix}", path, load_colored
    compressed = Gltf()
    content = DracoPy.encode(np.random.default_rng(1).normal(size=(30, 3)), np.arange(30).reshape(10, 3))
    extension = {"bufferView": compressed.view(content), "attributes": {"POSITION": 0}}
    position = compressed.put("accessors", {"componentType": 5126, "count": 30, "type": "VEC3"})
    primitive = {"attributes": {"POSITION": position}, "extensions": {"KHR_draco_mesh_compression": extension}}
    compressed.node(mesh=compressed.mesh(primitive))
    yield "scene draco.glb", compressed.save(folder / "draco.glb"), load_colored
    path = folder / "scene.dae"
    path.write_text(collada(BOUND, more=COLORED.format("<color>0.5 0.25 1 1</color>")), encoding="utf-8")
    yield "scene .dae", path, load_colored
    path = folder / "scene.obj"
    path.write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 1\no a\nusemtl m\nf 1/1 2/2 -1/-1\n", encoding="utf-8"
    )
    (folder / "a.mtl").write_text("newmtl m\nKd 0.5 0 0\nmap_Kd a.png\n", encoding="utf-8")
    PIL.Image.new("RGB", (4, 4), "red").save(folder / "a.png")
    yield "scene .obj", path, load_colored


def all_of_gltf() -> Gltf:
    """A document with all that is read of glTF but Draco."""
    rng = np.random.default_rng(2)
    file = Gltf(materials=[{"name": "m", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}])
    image = BytesIO()
    PIL.Image.new("RGB", (4, 4), "red").save(image, "PNG")
    file.put("images", {"bufferView": file.view(image.getvalue()), "mimeType": "image/png"})
    file.put("textures", {"source": 0, "sampler": 0})
    file.put("samplers", {"wrapS": 33648, "wrapT": 33071})
    colored = {"TEXCOORD_0": file.numbers(rng.random((3, 2))), "COLOR_0": file.numbers(rng.random((3, 3)))}
    joints = {"JOINTS_0": file.numbers(np.ones((3, 4)), "u1"), "WEIGHTS_0": file.numbers(np.full((3, 4), 0.25))}
    moves = [{"POSITION": file.numbers(rng.normal(size=(3, 3)))}]
    plain = file.mesh(file.primitive(attributes=colored, material=0), file.primitive(mode=5))
    skinned = file.mesh(file.primitive(attributes=joints, targets=moves), weights=[0.5])
    sparse = {
        "count": 1,
        "indices": {"bufferView": file.view(b"\1"), "componentType": 5121},
        "values": {"bufferView": file.view(bytes(12))},
    }
    file.tree["accessors"][file.tree["meshes"][plain]["primitives"][1]["attributes"]["POSITION"]]["sparse"] = sparse
    copies = {"attributes": {"TRANSLATION": file.numbers(rng.normal(size=(2, 3)))}}
    file.put("skins", {"joints": [2, 3], "inverseBindMatrices": file.numbers(np.tile(np.eye(4).ravel(), (2, 1)))})
    file.node(name="a", mesh=plain, extensions={"EXT_mesh_gpu_instancing": copies}, children=[2])
    file.node(name="b", mesh=skinned, skin=0)
    file.node(top=False, scale=[1, 2, 3], children=[3])
    file.node(top=False, matrix=np.eye(4).ravel().tolist(), mesh=plain)
    return file


def load_colored(path: Path) -> Scene:
    if path.name == "damaged.gltf":
        path.with_name("scene.bin").write_bytes(all_of_gltf().data)
    return Scene.from_file(path, reflectivity="color", rules=[Rule(node="a*", label=1), Rule(material="m", instance=2)])


def with_firing_times(angles: Path, path: Path) -> Lidar:
    return Lidar.from_file(angles, firing_times=path)


def load_path(suffix: str, path: Path) -> Trajectory:
    return Trajectory.load(path, times=path.with_name("times") if suffix == ".kitti" else None)


def load_scene(scene: Path, path: Path) -> object:
    path.replace(scene.with_name(f"damaged{path.suffix}"))
    return config.load(scene)


WORDS = (
    *(
        "&a",
        "*a",
        "[*a, *a]",
        "<<: *a",
        "[",
        "{",
        "]",
        "- ",
        ": ",
        "? ",
        "|",
        ">",
        "'",
        '"',
        "#",
        "%",
        "@",
        "\t",
        "\0",
        ",",
    ),
    *("!!binary", "!!python/name:os.system", "!x", "---", "null", "~", "true", "no", "NaN", ".nan", ".inf", "-.inf"),
    *("1e999", "-1", "0", "1e-320", "0x" + "f" * 5000, "9" * 5000, "1" * 400, "é", "\u2028", "\ufeff", "x" * 100_000),
    *(
        "[" * 2000,
        "{a: " * 500,
        "- " * 500,
        "../..",
        "/dev/zero",
        "/",
        "file",
        "preset",
        "type",
        "1_000",
        "0o17",
        "12:30:45",
    ),
)


def reword(content: bytes, rng: np.random.Generator) -> bytes:
    """Change one to three words of a text: by another of its words, by a hostile one, by none, or with its line."""
    parts = re.split(r"(\w+|\n)", content.decode("utf-8", errors="replace"))
    for _ in range(rng.integers(1, 4)):
        i, j = (int(k) for k in rng.integers(len(parts), size=2))
        match rng.integers(6):
            case 0 | 1:
                parts[i] = WORDS[rng.integers(len(WORDS))]
            case 2:
                parts[i] = str(NUMBERS[rng.integers(len(NUMBERS))])
            case 3:
                parts[i] = parts[j]
            case 4:
                parts[i] = ""
            case 5:
                parts[i:i] = parts[min(i, j) : max(i, j)][:40]
    return "".join(parts).encode("utf-8", errors="replace")


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """Change one to three places, half of them near an end, where headers and indices are."""
    if content.isascii() and rng.integers(2):
        return reword(content, rng)
    data = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        if not data:
            break
        near = min(len(data), 400)
        place = int(
            [rng.integers(near), len(data) - 1 - rng.integers(near), *rng.integers(len(data), size=2)][rng.integers(4)]
        )
        number = NUMBERS[rng.integers(len(NUMBERS))]
        match rng.integers(8):
            case 0:
                data[place] ^= 1 << int(rng.integers(8))
            case 1:
                data[place] = int(rng.integers(256))
            case 2 | 3:
                size = int(rng.choice([1, 2, 4, 8]))
                data[place : place + size] = (number % 2 ** (8 * size)).to_bytes(size, "little")
            case 4:
                del data[place:]
            case 5:
                del data[place : place + int(rng.integers(1, 20))]
            case 6:
                data[place:place] = bytes(data[place : place + int(rng.integers(1, 60))])
            case 7:  # another number where the text of a header has one
                end = place
                while end < len(data) and chr(data[end]).isdigit():
                    end += 1
                data[place:end] = str(number).encode()
    return bytes(data)


def faults(
    name: str, path: Path, read: Callable[[Path], object], count: int, seed: int
) -> tuple[Counter[str], list[str]]:
    """Read mutations of a file; return how often each outcome came, and what should never happen."""
    content, rng = path.read_bytes(), np.random.default_rng(seed)
    damaged = path.with_name(f"damaged{''.join(path.suffixes[-2:])}")
    outcomes: Counter[str] = Counter()
    wrong = []
    for index in range(count):
        damaged.write_bytes(mutate(content, rng))
        try:
            read(damaged)
            outcomes["read"] += 1
        except (ConfigError, FileFormatError) as error:
            outcomes["refused"] += 1
            told, causes = str(error), [error]
            while causes[-1].__cause__:
                causes.append(causes[-1].__cause__)
            named = any(file in told for file in (damaged.name, *BESIDE))
            if "\n" in told or len(told) > LONGEST or not named or isinstance(causes[-1], MemoryError):
                wrong.append(f"{name}, mutation {index}: {told[:LONGEST]}, {len(told)} characters, from {causes[-1]!r}")
        except BaseException as error:  # noqa: BLE001 - that is what is looked for
            wrong.append(f"{name}, mutation {index}: {repr(error)[:LONGEST]}")
    return outcomes, wrong


def main(count: int = 300, seed: int = 0, *suffixes: str) -> int:
    """Run all, and return how many faults there were."""
    warnings.simplefilter("error")
    warnings.filterwarnings("ignore", r".*\?$", UserWarning)  # questions about sizes of damaged models
    assert io, "the formats register themselves on import"
    total = 0
    with tempfile.TemporaryDirectory() as folder:
        everything = [*samples(Path(folder)), *texts(Path(folder))]
        everything = [sample for sample in everything if not suffixes or sample[0].startswith(suffixes)]
        for _, path, read in everything:
            shutil.copy(path, copy := path.with_name(f"damaged{''.join(path.suffixes[-2:])}"))
            read(copy)  # imports what it needs before the limit
        if sys.platform == "linux":
            import resource

            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (used + ROOM, resource.RLIM_INFINITY))
        for name, path, read in everything:
            begin = time.perf_counter()
            outcomes, wrong = faults(name, path, read, count, seed)
            seconds = time.perf_counter() - begin
            report = f"{name:22} {outcomes['read']:6} read, {outcomes['refused']:6} refused, {len(wrong)} faults"
            sys.stdout.write(f"{report}, {seconds:.0f} s\n")
            sys.stdout.writelines(f"    {line}\n" for line in wrong[:5])
            sys.stdout.flush()
            total += len(wrong)
    return total


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:3]), *sys.argv[3:]), 1))
