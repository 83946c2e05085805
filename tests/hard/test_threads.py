"""Many Python threads, and an environment or an interpreter that changes beneath them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hard.children import output

import lidarsim as ls
from lidarsim import _native
from lidarsim.cli import main
from lidarsim.errors import ArgumentValueError


@pytest.mark.slow("eight threads share growing scenes, and the environment changes beside them")
def test_casts_beside_a_thread_that_changes_the_environment() -> None:
    """The C library's environment has no lock, so that only who holds the interpreter may read it."""
    code = """
        from unittest import mock

        os.environ.pop("LIDARSIM_THREADS", None)
        sphere = ls.Sphere((0, 0, 0), 1.0)
        origins, directions = rays(10)
        ended = threading.Event()

        def work():
            while not ended.is_set():
                sphere.cast(origins, directions)

        threads = [threading.Thread(target=work) for _ in range(3)]
        for thread in threads:
            thread.start()
        # So many that they take long to read; MALLOC_PERTURB_ overwrites the memory that they leave when they grow.
        for i in range(300):
            os.environ[f"VARIABLE_{i}"] = "x"
        end, rounds = time.monotonic() + 1.0, 0
        while time.monotonic() < end:
            with mock.patch.dict(os.environ, {f"ANOTHER_{i}": "x" for i in range(300)}):
                rounds += 1
        ended.set()
        for thread in threads:
            thread.join()
        print(rounds > 5)
    """
    assert output(code, environment={"MALLOC_PERTURB_": "85"}) == "True"


def test_settings_are_those_of_the_environment_at_each_cast(monkeypatch: pytest.MonkeyPatch) -> None:
    for count in (1, 5, 2):
        monkeypatch.setenv("LIDARSIM_THREADS", str(count))
        assert _native.threads() == count
    available = [monkeypatch.delenv("LIDARSIM_THREADS"), _native.threads()][1]
    monkeypatch.setenv("LIDARSIM_THREADS", "")
    assert _native.threads() == available >= 1


@pytest.mark.parametrize("count", ["0", "-1", "many", "2.0", "1025", "99999999999999999999"])
def test_a_wrong_number_of_threads_is_refused(count: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIDARSIM_THREADS", count)
    expected = re.escape(f'LIDARSIM_THREADS: expected an integer from 1 to 1024, got "{count}"')
    with pytest.raises(ArgumentValueError, match=f"^{expected}$"):
        ls.Sphere((5, 0, 0), 1.0).cast([(0, 0, 0)], [(1, 0, 0)])


@pytest.mark.parametrize("name", ["LIDARSIM_THREADS", "LIDARSIM_ISA"])
def test_a_wrong_environment_is_no_error_of_a_configuration(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv(name, "many")
    with pytest.raises(SystemExit) as end:
        main(["scan", "demo", "--output", str(tmp_path / "demo.pcd")])
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith(f"lidarsim: {name}: expected ")


def test_a_number_of_threads_that_is_set_goes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIDARSIM_THREADS", "3")
    try:
        _native.set_threads(7)
        assert _native.threads() == 7
    finally:
        _native.set_threads(None)
    assert _native.threads() == 3
    for wrong in (0, -1):
        with pytest.raises((ValueError, OverflowError)):
            _native.set_threads(wrong)


@pytest.mark.slow("eight threads share growing scenes, and the environment changes beside them")
def test_eight_threads_on_shared_and_growing_scenes() -> None:
    """Casts, scans, builds and new objects at once; whatever a thread added before it casts, it sees."""
    code = """
        shared = ls.Scene()
        shared.add(field(40))
        origins, directions = rays(3000)
        want = shared.cast(origins, directions).t.tobytes()
        lidar = ls.Lidar.preset("velodyne-vlp16")
        end = time.monotonic() + 1.5
        grown = ls.Scene()

        def work(seed):
            rounds = 0
            while time.monotonic() < end:
                rounds += 1
                assert shared.cast(origins, directions).t.tobytes() == want
                mesh = field(20 + seed)
                assert mesh.cast(origins, directions).t.tobytes() == mesh.cast(origins, directions).t.tobytes()
                x, y = 1000.0 * (rounds + 1), 1000.0 * seed
                new = grown.add(ls.Sphere((x, y, 0), 1.0))
                assert grown.cast([[x, y, 5.0]], [[0, 0, -1.0]]).object_id[0] == new
                if seed == 0:
                    lidar.scan(shared)
            return rounds

        with concurrent.futures.ThreadPoolExecutor(8) as pool:
            print(min(pool.map(work, range(8))) > 0, len(grown) > 8)
    """
    assert output(code) == "True True"


@pytest.mark.slow("the interpreter ends beside daemon threads")
@pytest.mark.parametrize("work", ["cast", "build", "scan"])
def test_the_interpreter_ends_while_daemon_threads_work(work: str) -> None:
    code = """
        scene = ls.Scene()
        scene.add(field(300))
        origins, directions = rays(300_000)
        lidar = ls.Lidar.preset("velodyne-vlp16")

        def forever():
            while True:
                if sys.argv[1] == "cast":
                    scene.cast(origins, directions)
                elif sys.argv[1] == "build":
                    field(300).cast([[0, 0, 9]], [[0, 0, -1]])
                else:
                    lidar.scan(scene).point_cloud()

        for _ in range(3):
            threading.Thread(target=forever, daemon=True).start()
        time.sleep(0.5)
        print("end")
    """
    assert output(code, work) == "end"


@pytest.mark.parametrize("isa", ["scalar", "avx2", "avx512"])
def test_a_thread_with_a_small_stack_casts_and_scans(isa: str, instruction_sets: list[str]) -> None:
    if isa not in instruction_sets:
        pytest.skip(f"needs {isa}")
    code = """
        mesh, scene = field(30), ls.Scene()
        drive = ls.Trajectory.from_twist(np.eye(4), (1, 0, 0), (0, 0, 1))
        egg, can = ls.Ellipsoid((0, 5, 0), (1, 2, 3)), ls.Cylinder((5, 0, 0), (5, 0, 1), 1.0)
        for shape in (ls.Box((1, 1, 1)), egg, can, mesh):
            scene.add(shape)
            scene.add(shape, motion=drive)
        lidar = ls.Lidar(
            ls.patterns.Spinning([-0.3, 0.0], columns=64),
            measurement=ls.Measurement(range_sigma=0.1, beam=ls.Beam(0.01, rays=7), returns=3),
        )

        def work():
            scan = lidar.scan(scene, drive)
            found.append([
                scene.cast(*rays(500), time=np.linspace(0, 1, 500)).t.tobytes(), field(30).cast(*rays(500)).t.tobytes(),
                scan.range.tobytes(), scan.point_cloud("world").xyz.tobytes(), mesh.roots(*rays(50)).tobytes(),
            ])

        found = []
        work()
        for size in (64, 128, 256, 512, 1024, 4096):
            threading.stack_size(size << 10)
            thread = threading.Thread(target=work)
            thread.start()
            thread.join()
        print([each == found[0] for each in found], len(found[0][3]) > 1000)
    """
    assert output(code, environment={"LIDARSIM_ISA": isa}) == f"{[True] * 7} True"
