"""Forks, while other threads do whatever they do."""

from __future__ import annotations

import sys

import pytest
from hard.children import output

pytestmark = pytest.mark.skipif(sys.platform in {"win32", "darwin"}, reason="no fork, or none beside threads")


@pytest.mark.parametrize("place", ["mesh", "scene"])
def test_a_child_builds_what_its_parent_was_building(place: str) -> None:
    """The thread that builds is not in the child, so nobody there must wait for it."""
    code = """
        mesh = field(350)
        shapes = [ls.Sphere((i, 0, -50), 0.9) for i in range(30_000)] if sys.argv[1] == "scene" else [mesh]
        scene = ls.Scene()
        for shape in shapes:
            scene.add(shape)
        builder = threading.Thread(target=lambda: scene.cast([[0.5, 0.5, 9]], [[0, 0, -1]]))
        scene._snapshot()  # made by the core, but not built
        builder.start()
        time.sleep(0.01)
        children = []
        for _ in range(3):
            child = os.fork()
            if child == 0:
                signal.alarm(40)
                t = scene.cast([[0.5, 0.5, 9]], [[0, 0, -1]]).t[0]
                os._exit(0 if 8 < t < 100 else 1)
            children.append(child)
        was_built = not builder.is_alive()
        codes = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]
        builder.join()
        print(was_built, codes)
    """
    assert output(code, place) == "False [0, 0, 0]"


def test_a_pool_of_forked_workers_casts_beside_a_thread_that_builds() -> None:
    code = """
        scene = ls.Scene()
        scene.add(field(500))
        scene._snapshot()

        def cast(_):
            return scene.cast([[0.5, 0.5, 9]], [[0, 0, -1]]).t[0]

        builder = threading.Thread(target=cast, args=(0,))
        builder.start()
        with multiprocessing.get_context("fork").Pool(3) as pool:
            found = pool.map_async(cast, range(9)).get(30)
        builder.join()
        print(len(found), set(found) == {cast(0)})
    """
    assert output(code) == "9 True"


def test_children_forked_in_the_middle_of_casts_cast() -> None:
    """Whatever the threads of the parent hold at that moment."""
    code = """
        scene = ls.Scene()
        scene.add(field(60))
        scene.add(ls.Sphere((0, 0, 3), 1.0))
        origins, directions = rays(20_000)
        want = scene.cast(origins, directions).t.tobytes()
        lidar = ls.Lidar.preset("velodyne-vlp16")
        seen = lidar.scan(scene).range.tobytes()
        ended = threading.Event()

        def work():
            while not ended.is_set():
                scene.cast(origins, directions)
                lidar.scan(scene)

        threads = [threading.Thread(target=work) for _ in range(3)]
        for thread in threads:
            thread.start()
        right = 0
        for _ in range(int(sys.argv[1])):
            child = os.fork()
            if child == 0:
                signal.alarm(20)
                same = scene.cast(origins, directions).t.tobytes() == want and lidar.scan(scene).range.tobytes() == seen
                os._exit(0 if same else 1)
            right += os.waitpid(child, 0)[1] == 0
        ended.set()
        for thread in threads:
            thread.join()
        print(right)
    """
    assert output(code, "15") == "15"


def test_a_grandchild_casts() -> None:
    code = """
        sphere = ls.Sphere((0, 0, 0), 1.0)
        origins, directions = rays(20_000)
        want = sphere.cast(origins, directions).t.tobytes()
        depth = 0
        while depth < 3:
            child = os.fork()
            if child:
                os._exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
            depth += 1
            assert sphere.cast(origins, directions).t.tobytes() == want
        os._exit(0)
    """
    output(code)
