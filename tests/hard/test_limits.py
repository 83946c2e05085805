"""The ends of float64, of memory and of what arrays may look like."""

from __future__ import annotations

import math
import platform
import re
import sys

import numpy as np
import pytest
from hard.children import output

import lidarsim as ls
import lidarsim._native as core

LARGEST, LEAST = sys.float_info.max, 5e-324

# For each shape, one whose surface is at x = 0.
WALLS = {
    "plane": lambda: ls.Plane((1, 0, 0), 0.0),
    "triangle": lambda: ls.Triangle((0, -1, -1), (0, 3, -1), (0, -1, 3)),
    "mesh": lambda: ls.TriangleMesh([(0, -1, -1), (0, 3, -1), (0, -1, 3)], [[0, 1, 2]]),
    "polygon": lambda: ls.Polygon([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)]),
    "box": lambda: ls.Box((2, 2, 2), (-1, 0, 0)),
    "sphere": lambda: ls.Sphere((-1, 0, 0), 1.0),
    "cylinder": lambda: ls.Cylinder((-1, 0, 0), (0, 0, 0), 1.0),
    "capsule": lambda: ls.Capsule((-2, 0, 0), (-1, 0, 0), 1.0),
    "side of a capsule": lambda: ls.Capsule((-1, -1, 0), (-1, 1, 0), 1.0),
    "disk": lambda: ls.Disk((0, 0, 0), (1, 0, 0), 1.0),
    "spheres": lambda: ls.Spheres([(-1, 0, 0), (-1, 0, 3)], 1.0),
    "disks": lambda: ls.Disks([(0, 0, 0), (-1, 0, 0)], [(1, 0, 0)] * 2, 1.0),
}


@pytest.mark.parametrize("wall", WALLS)
def test_the_largest_t_is_a_hit_and_the_next_is_not(wall: str) -> None:
    # 1 / 2^-1024 is beyond float64, and (1 - 2^-53) of it is the largest number.
    origins = [[1.0 - 2.0**-53, 0, 0], [1.0, 0, 0]]
    hits = WALLS[wall]().cast(origins, [[-(2.0**-1024), 0, 0]] * 2)
    assert hits.t.tolist() == [LARGEST, math.inf]
    assert hits.object_id.tolist() == [0, -1]
    np.testing.assert_array_equal(hits.normal[0], [1, 0, 0])


@pytest.mark.parametrize("wall", WALLS)
def test_a_t_below_zero_is_no_hit_even_where_it_rounds_to_zero(wall: str) -> None:
    origins = [[LEAST, 0, 0], [-0.0, 0, 0], [0.0, 0, 0]]
    hits = WALLS[wall]().cast(origins, [[2.0**100, 0, 0]] * 3)
    assert hits.t.tolist() == [math.inf, 0.0, 0.0]
    hits = WALLS[wall]().cast(origins, [[-(2.0**100), 0, 0]] * 3)
    assert hits.t.tolist() == [0.0, 0.0, 0.0]


def test_noise_makes_no_infinite_hit() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 1.5e308))
    measurement = ls.Measurement(range_sigma=[[1.0, 0.1], [1.6e308, 1.6e308]])
    lidar = ls.Lidar(ls.patterns.Grid([0.0] * 200, [0.0], rate=10.0), measurement=measurement)
    scan = lidar.scan(scene)
    hit = scan.status == ls.Status.hit
    assert 0 < hit.sum() < 200
    assert np.isfinite(scan.range[hit]).all()
    assert set(scan.status[~hit]) == {ls.Status.below_min_range, ls.Status.beyond_max_range}


def misalign(array: np.ndarray) -> np.ndarray:
    """Return a copy whose numbers lie a byte off."""
    room = np.zeros(array.nbytes + 1, np.uint8)
    copy = room[1:].view(array.dtype).reshape(array.shape)
    copy[:] = array
    assert not copy.flags.aligned
    return copy


def test_misaligned_arrays_are_copied() -> None:
    rng = np.random.default_rng(1)
    vertices, faces = rng.normal(size=(90, 3)), rng.integers(0, 90, (60, 3)).astype(np.uint32)
    origins, directions = rng.normal(size=(500, 3)), rng.normal(size=(500, 3))
    mesh, other = ls.TriangleMesh(vertices, faces), ls.TriangleMesh(misalign(vertices), misalign(faces))
    hits, same = mesh.cast(origins, directions), other.cast(misalign(origins), misalign(directions))
    assert np.isfinite(hits.t).any()
    np.testing.assert_array_equal(hits.t, same.t)
    times = np.linspace(0, 1, 9)
    drive = ls.Trajectory.from_twist(np.eye(4), linear=(5, 0, 0))
    assert (drive.at(misalign(times)).as_matrix() == drive.at(times).as_matrix()).all()
    ring = misalign(np.arange(2, dtype=np.uint16))
    pulses = ls.patterns.Pulses(misalign(np.eye(3)[:2]), np.zeros((2, 3)), time=[0, 0], ring=ring, column=[0, 1])
    assert pulses.ring.flags.aligned
    assert pulses.ring.tolist() == [0, 1]


def test_a_scan_beyond_memory_is_refused_before_its_pulses_are_made() -> None:
    class Enormous:
        rate = 10.0
        shape = (2**20, 2**30)

        def pulses(self, _frame: int = 0) -> ls.patterns.Pulses:
            raise AssertionError

    lidar = ls.Lidar(Enormous(), measurement=ls.Measurement(beam=ls.Beam(1e-3, rays=7), returns=3))
    # 80 bytes a return, and two a pulse: its status and how many returns it has.
    message = f"out of memory: {2**50 * (3 * 80 + 2)} bytes for the returns of {2**50} pulses, 3 each"
    with pytest.raises(MemoryError, match=f"^{re.escape(message)}$"):
        lidar.scan(ls.Scene())


MEMORY = """
import resource

def used():
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[0]) * resource.getpagesize()

def refused(work):
    resource.setrlimit(resource.RLIMIT_AS, (used() + (1 << 20), resource.RLIM_INFINITY))
    try:
        work()
    except MemoryError as error:
        return str(error)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))

sphere = ls.Sphere((0, 0, 0), 1.0)
sphere.cast(*rays(70_000))  # the threads stand
many = rays(1_000_000)
mesh = field(400)
room = ls.Scene()
room.add(ls.Sphere((0, 0, 0), 50.0))
lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-3, 3, 1000), np.linspace(-1, 1, 500), rate=10.0))
scan = lidar.scan(room)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit of the address space that holds, and /proc")
@pytest.mark.parametrize(
    ("work", "purpose"),
    [
        ("sphere.cast(*many)", "the hits of 1000000 rays"),
        ("mesh.cast([[0, 0, 9]], [[0, 0, -1]])", "a hierarchy over 318402 triangles"),
        ("lidar.scan(room)", "the returns of 500000 pulses, 1 each"),
        ("scan.point_cloud()", "an array of 1500000 elements"),
    ],
)
def test_work_without_memory_raises_and_can_be_done_later(work: str, purpose: str) -> None:
    # Arrays of some pages are the system's each, so that what was freed before is of no help.
    code = f"""
        print(refused(lambda: {work}))
        {work}
    """
    found = output(code, setup=MEMORY, environment={"MALLOC_MMAP_THRESHOLD_": "65536"})
    assert re.search(rf"^out of memory: \d+ bytes for {purpose}$", found, re.MULTILINE)


def test_memory_stays_flat_over_scans() -> None:
    code = """
        def resident():
            with open("/proc/self/statm") as statm:
                return int(statm.read().split()[1]) * 4096

        sizes = []
        for k in range(200):
            lidar.scan(room, frame=k).point_cloud()
            fresh = field(30)
            fresh.cast([[0, 0, 9]], [[0, 0, -1]])
            sizes.append(resident())
        most = np.reshape(sizes, (5, 40)).max(axis=1)
        print(np.diff(most).min())
    """
    setup = """
room = ls.Scene()
room.add(ls.Sphere((0, 0, 0), 50.0))
lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-3, 3, 100), np.linspace(-1, 1, 50), rate=10.0))
"""
    if sys.platform != "linux":
        pytest.skip("needs /proc")
    # Scans that each kept one array of a byte a pulse would take twice this for each 40 of them. Allocator and threads
    # take some for themselves, too, but not over and over.
    assert int(output(code, setup=setup)) < 40 * 5000 / 2


NO_THREADS = """
import ctypes, hashlib

class Instruction(ctypes.Structure):
    _fields_ = [("code", ctypes.c_uint16), ("jt", ctypes.c_uint8), ("jf", ctypes.c_uint8), ("k", ctypes.c_uint32)]

class Program(ctypes.Structure):
    _fields_ = [("length", ctypes.c_ushort), ("filter", ctypes.POINTER(Instruction))]

def refuse_threads():
    # Load the number of the system call; of clone3 and clone return EAGAIN, and allow all others (seccomp(2)).
    steps = (0x20, 0, 0, 0), (0x15, 2, 0, 435), (0x15, 1, 0, 56), (0x06, 0, 0, 0x7FFF0000), (0x06, 0, 0, 0x50000 | 11)
    program = Program(len(steps), (Instruction * len(steps))(*steps))
    libc = ctypes.CDLL(None, use_errno=True)
    assert libc.prctl(38, 1, 0, 0, 0) == 0 and libc.prctl(22, 2, ctypes.byref(program)) == 0, ctypes.get_errno()
    try:
        threading.Thread(target=print).start()
    except RuntimeError:
        return
    raise AssertionError("a thread was had")
"""


@pytest.mark.skipif((sys.platform, platform.machine()) != ("linux", "x86_64"), reason="needs seccomp, and its numbers")
def test_where_the_system_refuses_threads_the_caller_does_all() -> None:
    code = """
        if sys.argv[1] == "refused":
            refuse_threads()
        mesh, scene = field(50), ls.Scene()
        for k in range(3):
            scene.add(mesh, motion=ls.Trajectory.from_twist(np.eye(4), (k, 0, 0), (0, 0, 0.1)))
        before = len(os.listdir("/proc/self/task"))
        hits = [mesh.cast(*rays(5000)), scene.cast(*rays(5000), time=np.linspace(0, 1, 5000)), field(20).cast(*rays(9))]
        print(len(os.listdir("/proc/self/task")) - before)
        print([hashlib.sha256(hit.t.tobytes() + hit.object_id.tobytes()).hexdigest() for hit in hits])
        print(*(hit.hit.sum() for hit in hits[:2]))
    """
    refused, allowed = (
        output(code, how, setup=NO_THREADS, environment={"LIDARSIM_THREADS": "3"}).splitlines()
        for how in ("refused", "allowed")
    )
    # Three that build the hierarchy of a mesh, and two that help with casts, where the caller is the third.
    assert (refused[0], allowed[0]) == ("0", str(3 + 2))
    assert refused[1:] == allowed[1:]
    assert all(int(hits) > 500 for hits in refused[2].split())


def test_a_panic_of_the_core_is_a_runtime_error() -> None:
    """One that no caller can bring about: the core is given the label of one face of two."""
    mesh = ls.TriangleMesh([(5, -1, -1), (5, 1, -1), (5, 1, 1), (5, -1, 1)], [(0, 1, 2), (0, 2, 3)])
    scene, lidar = ls.Scene(), ls.Lidar(ls.patterns.Grid([0.05, -0.05], [0.0], rate=10.0))
    scene.add(mesh, label=[3, 4])
    one = np.array([3], np.uint32)
    scene._items[0] = core.SceneObject(0, mesh, "", one, 1, ls.Material(), None, None)
    message = "a fault in lidarsim, please report it: index out of bounds: the len is 1 but the index is 1"
    with pytest.raises(RuntimeError, match=f"^{re.escape(message)}$"):
        lidar.scan(scene)
    scene = ls.Scene()
    scene.add(mesh, label=[3, 4])
    assert lidar.scan(scene).label.ravel().tolist() == [3, 4]
