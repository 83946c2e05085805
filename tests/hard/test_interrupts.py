"""Ctrl-C ends whatever the core does, and soon."""

from __future__ import annotations

import signal

import pytest
from hard.children import output, start

# Each takes many times as long as a test may, if it is not interrupted.
WORK = {
    "many rays": "s.cast(*rays(3_000_000))",
    "coincident triangles": "stacked.cast(*down(20_000))",
    "a mesh": "field(2200).cast([[0, 0, 9]], [[0, 0, -1]])",
    "many objects": "crowd().cast([[0, 0, 9]], [[0, 0, -1]])",
    "exact rays": "exact()",
    "roots": "stacked.roots(*down(300))",
    "a polygon": "ls.Polygon(zigzag(100_001))",
    "scans": "lidar.scan(s)",
}

SETUP = """
s = ls.Scene()
s.add(field(300))
s.cast(*rays(10))
corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
stacked = ls.TriangleMesh(corners, np.tile([[0, 1, 2]], (20_000, 1)), transform=np.diag([1.5, 1.5, 1.0, 1.0]))
stacked.cast([[9, 9, 9]], [[0, 0, 1]])
lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-3, 3, 3000), np.linspace(-1, 1, 1000), rate=10.0))

def down(n):
    return np.full((n, 3), (0.2, 0.2, 1.0)), np.full((n, 3), (0.0, 0.0, -1.0))

def crowd():
    scene = ls.Scene()
    ball = ls.Sphere((0, 0, 0), 1.0)
    for i in range(200_000):
        scene.add(ball)
    return scene

def exact():
    ball = ls.Sphere((0, 0, 0), 1.0)
    while True:  # all of them tangents
        ball.cast(np.full((100_000, 3), (-5.0, 1.0, 0.0)), np.full((100_000, 3), (1.0, 0.0, 0.0)))

# Long edges at 45 degrees: the boxes of all pairs overlap, so that the search for crossings takes minutes. What comes
# after it, the triangulation of another library, cannot be interrupted.
def zigzag(n):
    i = np.arange(n)
    along = np.where(i % 2, 1e6, 0.0)
    return np.c_[along + i, along - i, 0 * i]

# The first polygon imports that library, and Python drops exceptions in the callbacks of weak references that an import
# has: an alarm that rings there would never be heard of again.
ls.Polygon(zigzag(3))
"""


@pytest.mark.slow("Ctrl-C and handlers of signals end each kind of work")
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no such alarms on this system")
@pytest.mark.parametrize("work", WORK)
def test_a_handler_of_signals_ends_the_work(work: str) -> None:
    code = f"""
        class Enough(Exception):
            pass

        def ring(number, frame):
            if late.is_set():
                os._exit(1)  # the handler comes too late
            raise Enough

        late = threading.Event()
        signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, 0.15)
        watch = threading.Timer(5.0, late.set)  # it takes up to 0.1 s, but others may use the machine
        watch.start()
        try:
            while True:
                {WORK[work]}
        except Enough:
            watch.cancel()
            hits = s.cast([[1.5, 1.5, 9.0]], [[0, 0, -1.0]])
            print(8 < hits.t[0] < 10)
    """
    assert output(code, setup=SETUP) == "True"


@pytest.mark.slow("Ctrl-C and handlers of signals end each kind of work")
@pytest.mark.parametrize("place", ["callback", "except", "nowhere"])
def test_a_ctrl_c_that_is_dropped_in_the_command_line_comes_again(place: str) -> None:
    """Python drops exceptions in callbacks of weak references, which each import has, and libraries in `except:`."""
    code = """
import signal, sys, threading, time, types, weakref
from lidarsim import cli

def interrupted(*_):
    signal.raise_signal(signal.SIGINT)

def work(*_, **__):
    if sys.argv[1] == "callback":
        sys.unraisablehook = lambda _: print("dropped")
        event = threading.Event()
        reference = weakref.ref(event, interrupted)
        del event
    elif sys.argv[1] == "except":
        try:
            interrupted()
        except BaseException:
            print("dropped")
    else:
        print("dropped")
        interrupted()
    time.sleep(20)

cli.get_command = lambda _: types.SimpleNamespace(make_context=work)
cli.main([])
"""
    with start(code, place) as child:
        out, err = child.communicate(timeout=60)
    assert (child.returncode, out, err) == (130, "dropped\n", "")


def test_a_ctrl_c_that_is_dropped_at_the_end_of_the_command_line_is_told() -> None:
    """The command ends before Ctrl-C comes again."""
    code = """
import contextlib, signal, threading, types, weakref
from lidarsim import cli

def work(_):
    event = threading.Event()
    reference = weakref.ref(event, lambda _: signal.raise_signal(signal.SIGINT))
    del event

@contextlib.contextmanager
def context(*_):
    yield types.SimpleNamespace(command=types.SimpleNamespace(invoke=work))

cli.get_command = lambda _: types.SimpleNamespace(make_context=context)
cli.main([])
"""
    with start(code) as child:
        out, err = child.communicate(timeout=60)
    assert (child.returncode, out, err) == (130, "", "")


def test_what_a_ctrl_c_leaves_half_made_is_deleted_in_silence() -> None:
    """As a ZipFile is whose constructor was interrupted."""
    code = """
import signal, types
from lidarsim import cli

class HalfMade:
    def __init__(self):
        signal.raise_signal(signal.SIGINT)
        self.file = None

    def __del__(self):
        self.file.close()

cli.get_command = lambda _: types.SimpleNamespace(make_context=lambda *_, **__: HalfMade())
cli.main([])
"""
    with start(code) as child:
        out, err = child.communicate(timeout=60)
    assert (child.returncode, out, err) == (130, "", "")
