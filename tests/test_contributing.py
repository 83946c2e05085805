"""The checklists of `.github/CONTRIBUTING.md`, applied to toys in a copy of the tree.

A toy is a copy of an existing shape, effect, pattern or preset under another name, or a small column, format, packet
format, layout or output of a run. The tests of the copy must pass with the files of its checklist alone, and fail
without one of them: without the last, and with ``--slow`` without each in turn that existing tests notice without the
compiler.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

import lidarsim

ROOT = Path(__file__).parents[1]
GUIDE = (ROOT / ".github" / "CONTRIBUTING.md").read_text(encoding="utf-8")
CORE = Path("lidarsim", "native")
WHOLE = (
    "tests/test_pages.py",
    "tests/test_mistakes.py",
    "tests/config/test_loader.py",
    "tests/config/test_schema.py",
    "tests/conformance/test_completeness.py",
    "tests/datasets/test_layouts.py",
    "tests/io/packets/test_udp.py",
    "tests/io/packets/test_acme.py",
    "tests/presets/test_presets.py",
)
"""Quick files of tests of what toys are added to. They pass as a whole."""
CASES = (
    "tests/conformance",
    "tests/hard/test_cases.py",
    "tests/patterns",
    "tests/test_compare.py",
    "tests/test_house.py",
    "tests/test_pickling.py",
    "tests/test_run.py",
    "tests/viewers/test_surfaces.py",
    "lidarsim/patterns/cone.py",
    "lidarsim/world/shapes/ball.py",
    "-k",
    "ball or cone or tally or farthest or page_names or every_public or forgotten or loaded or docstring or as_a_whole",
)
"""Slow files, whose cases follow from the samples: those of the toys, and tests of the package as a whole."""
COMMAND = "from lidarsim.cli import main; main()"

Edit = Callable[[Path], None]


@dataclass(frozen=True)
class Toy:
    """Something new: its name, what is done to each file, and tests of the copy that are to pass and to notice."""

    name: str
    edits: dict[str, Edit]
    tests: tuple[str, ...]

    @property
    def files(self) -> list[str]:
        """Its files, with NAME for its name."""
        return sorted(file.replace(self.name, "NAME") for file in self.edits)


def checklist(what: str) -> list[str]:
    """The files that the guide lists for something new."""
    (line,) = re.findall(rf"^\| {what} \|(.*)\|$", GUIDE, re.MULTILINE)
    return sorted(re.findall(r"`([^`]+)`", line))


def twin(original: str, *names: tuple[str, str]) -> Edit:
    """Make a file that is the original one but for names."""

    def edit(path: Path) -> None:
        text = (ROOT / original).read_text(encoding="utf-8")
        for old, new in names:
            text = re.sub(rf"\b{re.escape(old)}\b", new, text)
        path.write_text(text, encoding="utf-8")

    return edit


def beside(*names: tuple[str, str], until: str = "#[cfg(test)]") -> Edit:
    """Name the twin wherever its original is named: in a list of the same line, or in a line of its own."""

    def edit(path: Path) -> None:
        head, end, tail = path.read_text(encoding="utf-8").partition(until)
        lines = []
        for line in head.splitlines():
            other = line
            for old, new in names:
                other = re.sub(rf"\b{re.escape(old)}\b", new, other)
            old, new = names[-1]
            if other == line:
                lines.append(line)
            elif re.search(rf"[(,] *{old},? ", line):
                lines.append(re.sub(rf"\b{old}\b", f"{new}, {old}", line))
            else:
                lines += [other, line]
        path.write_text("\n".join(lines) + "\n" + end + tail, encoding="utf-8")

    return edit


def after(line: str, text: str) -> Edit:
    """Put a text below a line, the first that begins so."""

    def edit(path: Path) -> None:
        before = path.read_text(encoding="utf-8")
        (start,) = re.findall(rf"^{re.escape(line)}.*\n", before, re.MULTILINE)[:1]
        path.write_text(before.replace(start, f"{start}{text}\n", 1), encoding="utf-8")

    return edit


def instead(old: str, new: str) -> Edit:
    """Put a text in place of another, which is there once."""

    def edit(path: Path) -> None:
        before, after = path.read_text(encoding="utf-8").split(old)
        path.write_text(f"{before}{new}{after}", encoding="utf-8")

    return edit


def at_end(text: str) -> Edit:
    """Put a text at the end."""
    return lambda path: path.write_text(f"{path.read_text(encoding='utf-8')}\n\n{text}\n", encoding="utf-8")


def in_turn(*edits: Edit) -> Edit:
    """Make several edits."""

    def edit(path: Path) -> None:
        for each in edits:
            each(path)

    return edit


def as_new(text: str) -> Edit:
    """Make a file of its own."""
    return lambda path: path.write_text(text, encoding="utf-8")


def as_printed(*command: str) -> Edit:
    """Make a file that a command prints in the copy; leave it if the command fails."""

    def edit(path: Path) -> None:
        copy, words = path.parents[1], [sys.executable, "-m", "lidarsim", *command]
        environment = os.environ | {"PYTHONPATH": str(copy)}
        done = subprocess.run(words, cwd=copy, env=environment, capture_output=True, check=False)
        if done.returncode == 0:
            path.write_bytes(done.stdout)

    return edit


REFERENCE = as_printed("check", "--keys", "all")
SPHERE = ("sphere", "ball"), ("Sphere", "Ball")
PALMER = ("palmer", "cone"), ("Palmer", "Cone")

SHAPE = Toy(
    "ball",
    {
        f"{CORE}/core/src/shapes/ball.rs": twin(f"{CORE}/core/src/shapes/sphere.rs", *SPHERE),
        f"{CORE}/core/src/shapes/mod.rs": beside(*SPHERE),
        "lidarsim/world/shapes/ball.py": twin("lidarsim/world/shapes/sphere.py", *SPHERE),
        "lidarsim/world/shapes/__init__.py": beside(*SPHERE),
        "lidarsim/__init__.py": beside(*SPHERE),
        "tests/exact/oracle.py": at_end("class Ball(Sphere):\n    pass"),
        "tests/conformance/samples.py": after(
            "SAMPLES = [",
            '    Sample("ball", "Ball", lambda m: (m.point((0, 0.25, 0)), m.length(1.25)), (0.5, 0, 0.25)),',
        ),
        "lidarsim/cli/keys.py": after('    "box": ', '    "ball": "{shape: ball, center_m: [12, 3, 1], radius_m: 1}",'),
        "configs/REFERENCE.md": REFERENCE,
    },
    (
        "tests/test_pages.py",
        "tests/conformance/test_completeness.py",
        "-k",
        "ball or hidden or loaded or section",
    ),
)
PATTERN = Toy(
    "cone",
    {
        "lidarsim/patterns/cone.py": twin("lidarsim/patterns/palmer.py", *PALMER),
        "lidarsim/patterns/__init__.py": beside(*PALMER),
        "tests/patterns/families.py": in_turn(
            after("    Palmer,", "    Cone,"),
            after("FAMILIES: ", '    "cone": Cone(half_angle=0.3, scan_rate=70.0, pulse_rate=100e3, rate=10.0),'),
            after("ORACLES: ", "    Cone: (palmer, lambda p: Fraction(p.pulse_rate)),"),
        ),
        "lidarsim/cli/keys.py": after(
            '    "grid": ',
            '    "cone": "{type: cone, half_angle_deg: 20, scan_rate_hz: 70, pulse_rate_khz: 100, rate_hz: 10}",',
        ),
        "configs/REFERENCE.md": REFERENCE,
    },
    ("tests/test_pages.py", "tests/patterns/test_families.py", "-k", "cone or forgotten or loaded or section"),
)
FORMAT = Toy(
    "tsv",
    {
        "lidarsim/io/tsv.py": as_new(
            '"""Tab-separated text."""\n\nfrom functools import partial\n\nfrom lidarsim.io import text\n'
            "from lidarsim.scan.formats import register_format\n\n"
            'register_format(".tsv", save=partial(text.save, head="", between="\\t"), load=text.load)\n'
        ),
        "lidarsim/io/__init__.py": after("    text,", "    tsv,"),
        "lidarsim/io/README.md": after(
            "| `.csv`,", "| `.tsv` | read, write | all | any spreadsheet | 23.8 | 1713, 437 |"
        ),
    },
    ("tests/test_pages.py",),
)
PRESET = Toy(
    "acme-one",
    {
        "lidarsim/presets/acme-one.yaml": twin("lidarsim/presets/sick-lms111.yaml", ("sick-lms111", "acme-one")),
        "tests/presets/test_presets.py": after("SHEETS = {", '    "acme-one": (1, 27_050, 0, 0),'),
    },
    ("tests/presets/test_presets.py", "-k", "acme or every_sensor"),
)
TALLY = '''"""The number of points of each frame, a line each."""

from contextlib import contextmanager

from lidarsim.run._output import Output, register_output


@register_output
class Tally(Output):
    kind = "a tally"
    suffixes = (".tally",)

    def files(self, part, path, frames):
        return [path]

    @contextmanager
    def open(self, part, path, number, samples):
        with path.open("w") as file:
            yield lambda frame: [file.write(f"{sum(map(len, frame.clouds.values()))}\\n")] and [path]
'''
OUTPUT = Toy(
    "tally",
    {
        "tests/test_run.py": at_end(
            "def test_tally(tmp_path):\n    run = ls.config.load(Path(__file__).parents[1] / 'configs/demo.yaml')\n"
            "    run.write(tmp_path / 'a.tally')\n"
            "    counts = [sum(int(x.return_count.sum()) for x in scans.values()) for scans in run.scans()]\n"
            "    assert (tmp_path / 'a.tally').read_text().split() == [*map(str, counts)]"
        ),
        "lidarsim/run/tally.py": as_new(TALLY),
        "lidarsim/run/__init__.py": instead("import bags,", "import tally, bags,"),
    },
    ("tests/test_run.py", "-k", "tally"),
)
ACME = '''"""Ranges of ACME's sensors, a packet a frame."""

import numpy as np

from lidarsim.io.packets._format import Packet, PacketFormat, register


class Encoder:
    def __init__(self, start, port):
        self.start, self.port = start, port

    def packets(self, scan):
        moment = self.start + round((scan.time + scan.pulses.time[-1]) * 1e9)
        yield Packet(moment, self.port, scan.range[:, 0].astype("<f4").tobytes())

    def rest(self):
        return iter(())

    def companions(self):
        return {}


def encoder(lidar, *, start, port, variant):
    return Encoder(start, port)


register(PacketFormat("acme", {"acme-one": "a packet a frame"}, ("ranges",), 2400, encoder))
'''
ACME_TEST = '''"""A frame is a packet."""

import numpy as np

import lidarsim as ls


def test_ranges_are_those_of_the_scan():
    lidar, scene = ls.Lidar(ls.patterns.Grid([0.0, 0.1], [0.0], rate=10.0), model="acme-one"), ls.Scene()
    scene.add(ls.Sphere((5, 0, 0), 1.0))
    scan = lidar.scan(scene)
    (packet,) = ls.io.packets.encoders({"": lidar})[""].packets(scan)
    np.testing.assert_array_equal(np.frombuffer(packet.payload, "<f4"), scan.range[:, 0].astype("f4"))
'''
PACKETS = Toy(
    "acme",
    {
        "tests/io/packets/test_acme.py": as_new(ACME_TEST),
        "lidarsim/io/packets/acme.py": as_new(ACME),
        "lidarsim/io/packets/__init__.py": instead("import _pcap, hesai,", "import _pcap, acme, hesai,"),
        "lidarsim/io/README.md": after("| Velodyne VLP-16,", "| ACME acme-one | `ranges` | | none |"),
    },
    ("tests/io/packets/test_acme.py", "tests/test_pages.py", "-k", "acme or loaded or row"),
)
PLAIN = '''"""Coordinates alone, a file a frame."""

from typing import ClassVar, Literal

import numpy as np

from lidarsim.datasets.layouts._layout import SampleFiles, number_name, root


class Plain(SampleFiles):
    """Coordinates."""

    columns: ClassVar[tuple[str, ...] | None] = ()
    top: ClassVar[tuple[str, ...]] = ("points",)

    type: Literal["plain"]

    def contents(self, record, sample):
        return {self._name(record): sample.cloud.xyz.tobytes()}

    def read(self, store, record):
        with store.reading(self._name(record)) as path:
            return {"xyz": np.fromfile(path).reshape(-1, 3)}

    def finish(self, files, summary):
        pass

    @staticmethod
    def _name(record):
        return f"{root(record.sensor)}points/{number_name(record)}.bin"
'''
LAYOUT = Toy(
    "plain",
    {
        "tests/datasets/test_layouts.py": at_end(
            "def test_plain(recipe, tmp_path):\n    make(recipe, tmp_path / 'out', 'plain')\n"
            "    frame = ls.datasets.load(tmp_path / 'out')[0]\n    assert len(frame.cloud.xyz) > 10\n"
            "    points = np.fromfile(tmp_path / 'out' / 'points' / '000000.bin').reshape(-1, 3)\n"
            "    np.testing.assert_array_equal(frame.cloud.xyz, points)"
        ),
        "lidarsim/datasets/layouts/plain.py": as_new(PLAIN),
        "lidarsim/datasets/layouts/__init__.py": in_turn(
            after("from lidarsim.datasets.layouts.openpcdet", "from lidarsim.datasets.layouts.plain import Plain"),
            after('    "openpcdet": ', '    "plain": Plain,'),
        ),
        "lidarsim/cli/keys.py": after('    "openpcdet": ', '    "plain": "{type: plain}",'),
        "configs/REFERENCE.md": REFERENCE,
    },
    ("tests/test_pages.py", "tests/datasets/test_layouts.py", "-k", "plain or section or prints"),
)
DROPOUT = ("dropout", "lapse"), ("Dropout", "Lapse")
EFFECT = Toy(
    "lapse",
    {
        "tests/test_measurement.py": at_end(
            "def test_lapse():\n    lost = {}\n    for name in ('lapse', 'dropout'):\n"
            "        scan = measure(before_wall(np.full(1000, 5.0)), wall(), **{name: 0.5})\n"
            "        lost[name] = scan.status == ls.Status.dropped\n"
            "        assert abs(lost[name].mean() - 0.5) < 5 * 0.5 / 1000**0.5\n"
            "    assert (lost['lapse'] != lost['dropout']).any()"
        ),
        f"{CORE}/core/src/measure/effects/lapse.rs": twin(
            f"{CORE}/core/src/measure/effects/dropout.rs", *DROPOUT, ("2", "12")
        ),
        f"{CORE}/core/src/measure/effects/mod.rs": beside(*DROPOUT),
        "lidarsim/sensor/measurement.py": in_turn(
            instead("    dropout : float\n", "    lapse : float\n        Another, 0 to 1.\n    dropout : float\n"),
            after('        "dropout": float,', '        "lapse": float,'),
            after("    dropout: float = ", "    lapse: float = 0.0"),
            after('    "dropout": 1.0,', '    "lapse": 1.0,'),
        ),
        "configs/REFERENCE.md": REFERENCE,
    },
    ("tests/test_pages.py", "tests/test_house.py", "-k", "row or prints or docstrings"),
)
COLUMN = Toy(
    "slant",
    {
        "tests/test_scan.py": at_end(
            "def test_slant():\n    scan = lidar().scan(room())\n    assert np.isfinite(scan.slant).sum() > 100\n"
            "    np.testing.assert_array_equal(scan.slant, -scan.range.astype('f4'))"
        ),
        f"{CORE}/core/src/measure/columns.rs": after(
            "                incidence: ", "                slant: f32 = f32::NAN, always, copied;"
        ),
        f"{CORE}/core/src/measure/single_ray.rs": after(
            "                range: range", "                slant: range.store().map(|x| -x as f32),"
        ),
        f"{CORE}/core/src/measure/footprint.rs": after(
            "                range: [", "                slant: [-range as f32],"
        ),
        "lidarsim/scan/columns.py": after("    incidence: F32", '    slant: F32 = declare("Minus the range", "m")'),
    },
    ("tests/test_scan.py", "-k", "columns_are or slant"),
)
MEASURE = Toy(
    "farthest",
    {
        "tests/test_compare.py": at_end(
            "def test_farthest():\n    (cloud,) = frames(count=1)\n"
            "    (cell,) = ls.compare(cloud, cloud)['range of points'].cells\n"
            "    assert cell.real == pytest.approx(np.linalg.norm(cloud.xyz, axis=1).mean())"
        ),
        "lidarsim/comparison/_measures.py": at_end(
            '@measure("range of points", "m", Mean(), ONE, least=0.1)\ndef farthest(frame: Frame) -> Samples:\n'
            '    """Mean range."""\n    return Samples(np.zeros(len(frame), int), frame.block, frame.reach)'
        ),
        "lidarsim/comparison/README.md": after("| `density-aware", "| `range of points` | mean range | | 0.1 m |"),
    },
    ("tests/test_compare.py", "-k", "page_names"),
)
TOYS = {
    "shape": SHAPE,
    "pattern": PATTERN,
    "format": FORMAT,
    "packets": PACKETS,
    "preset": PRESET,
    "output of a run": OUTPUT,
    "layout": LAYOUT,
    "measure": MEASURE,
    "effect": EFFECT,
    "column": COLUMN,
}


class Copy:
    """A copy of the tree in which a toy may be made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # Copies keep the times of their sources, so the bytecode is copied, too.
        ignored = shutil.ignore_patterns("target", "*.so", "*.pyd", ".*_cache", ".hypothesis")
        folder.mkdir(exist_ok=True)
        for name in ("lidarsim", "tests", "configs", ".cargo"):
            shutil.copytree(ROOT / name, folder / name, ignore=ignored)
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, folder)
        native = Path(lidarsim._native.__file__)
        (folder / "lidarsim" / native.name).symlink_to(native)

    def make(self, toy: Toy, *, without: str = "") -> None:
        """Make the edits of a toy but one."""
        for file, edit in toy.edits.items():
            if file != without:
                edit(self.folder / file)

    def compile(self) -> None:
        """Compile the core of the copy, at a level of optimization that takes less time and gives the same bits."""
        target = self.folder / "target"
        environment = os.environ | {"PYO3_PYTHON": sys.executable, "CARGO_PROFILE_RELEASE_OPT_LEVEL": "1"}
        command = ["cargo", "build", "--lib", "--release", "--locked", "--features", "pyo3/extension-module"]
        subprocess.run(
            [*command, "--target-dir", target], cwd=self.folder / CORE / "python", env=environment, check=True
        )
        (built,) = [
            path for path in (target / "release").glob("*_native.*") if path.suffix in {".so", ".dylib", ".dll"}
        ]
        native = self.folder / "lidarsim" / Path(lidarsim._native.__file__).name
        native.unlink()
        shutil.copy(built, native)

    def run(self, *command: str) -> str:
        """Run Python there; return what it prints and how it ends."""
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        done = subprocess.run(
            [sys.executable, *command], cwd=self.folder, env=environment, capture_output=True, text=True, check=False
        )
        return f"{done.stdout}{done.stderr}\nexit code {done.returncode}"

    def test(self, *arguments: str) -> tuple[int, int]:
        """Run tests there; return how many passed, and how many failed or could not run."""
        said = self.run("-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments)
        summary = [line for line in said.splitlines() if re.search(r"\d+ \w+.* in \d+", line)]
        assert summary, said[-3000:]
        counts = {word: int(n) for n, word in re.findall(r"(\d+) (passed|failed|errors?)\b", summary[-1])}
        passed = counts.pop("passed", 0)
        assert not counts or "exit code 0" not in said
        if counts:
            sys.stdout.write(said)  # which pytest shows if the test fails
        return passed, sum(counts.values())


pytestmark = pytest.mark.skipif(not (ROOT / CORE).is_dir(), reason="the tests run without the sources")


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    return Copy(tmp_path)


def borrow(path: Path) -> None:
    """Let the toy shape be the core's sphere, so that the core need not be compiled."""
    path.write_text(
        path.read_text(encoding="utf-8").replace('self._set("Ball"', 'self._set("Sphere"'), encoding="utf-8"
    )


@pytest.mark.parametrize("what", TOYS)
def test_the_guide_lists_the_files_of_a_toy(what: str) -> None:
    assert TOYS[what].files == checklist(what)


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """A copy with all toys that need no compiler; they do not know of each other."""
    copy = Copy(tmp_path_factory.mktemp("toys"))
    for toy in TOYS.values():
        if toy not in (EFFECT, COLUMN):
            copy.make(toy)
    borrow(copy.folder / "lidarsim/world/shapes/ball.py")
    return copy


@pytest.mark.slow("the lists of the guide are true")
@pytest.mark.parametrize(("files", "least"), [(WHOLE, 1000), (CASES, 150)], ids=["whole files", "cases"])
def test_toys_need_their_checklists_alone(files: tuple[str, ...], least: int, toys: Copy) -> None:
    passed, failed = toys.test(*files)
    assert (passed > least, failed) == (True, 0)


@pytest.mark.slow("the lists of the guide are true")
def test_toys_are_used(toys: Copy) -> None:
    source = (toys.folder / CORE / "core/src/shapes/mod.rs").read_text(encoding="utf-8")
    assert len(re.findall(r"\b[bB]all\b", source)) >= 3
    script = (
        "import lidarsim as ls; print(ls.patterns.Cone(half_angle=0.3, scan_rate=80, pulse_rate=2e5, rate=10).shape)"
    )
    assert "(1, 20000)" in toys.run("-c", script)
    assert "exit code 0" in toys.run("-c", COMMAND, "scan", "configs/demo.yaml", "-o", "demo.tsv")
    script = "import lidarsim as ls; print(ls.PointCloud.load('demo.tsv').fields[:2])"
    assert "('xyz', 'range')" in toys.run("-c", script)
    damaged = toys.run("tests/io/mutations.py", "20", "3", ".tsv")
    assert re.search(r"\.tsv.* 0 faults", damaged), damaged
    assert "acme-one" in toys.run("-c", COMMAND, "sensors")
    assert ".tally" in toys.run("-c", COMMAND, "scan", "configs/demo.yaml", "-o", "demo.other")


def files_that_are_noticed(toy: Toy) -> list[str]:
    """The files of a toy whose absence existing tests notice without the compiler."""
    files = [*toy.edits]
    if toy is EFFECT:
        return files[-1:]
    return files[1:] if toy in (PACKETS, OUTPUT, LAYOUT, MEASURE) else files  # all but its own test


@pytest.mark.slow("the lists of the guide are true")
@pytest.mark.parametrize("what", [what for what in TOYS if what != "column"])
def test_what_is_left_out_is_noticed(what: str, tmp_path: Path, slow: bool) -> None:
    """Each file in turn if thorough tests are asked for, else the last one alone."""
    toy = TOYS[what]
    files = files_that_are_noticed(toy)
    for number, file in enumerate(files if slow else files[-1:]):
        copy = Copy(tmp_path / str(number))
        copy.make(toy, without=file)
        if what == "shape" and file != "lidarsim/world/shapes/ball.py":
            borrow(copy.folder / "lidarsim/world/shapes/ball.py")
        said = copy.run("-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *toy.tests)
        assert re.search(r"\d+ (failed|error)|Error", said), f"{file}: {said[-2000:]}"
        assert "exit code 0" not in said, file


@pytest.mark.slow("the lists of the guide for what has Rust of its own are true")
def test_toys_of_the_core_are_compiled(copy: Copy) -> None:
    """The listed files of a shape, an effect and a column suffice for the compiler, and are used."""
    for toy in (SHAPE, EFFECT, COLUMN):
        copy.make(toy)
    copy.compile()
    passed, failed = copy.test("tests/conformance", "tests/hard/test_cases.py", "-k", "ball")
    assert (passed > 100, failed) == (True, 0)
    whole = [f"tests/test_{name}.py" for name in ("measurement", "scan", "batch", "pages", "pointcloud", "mistakes")]
    passed, failed = copy.test(*whole, "tests/io/test_round_trip.py")
    assert (passed > 800, failed) == (True, 0)
    for toy in (EFFECT, COLUMN):
        (file,) = [file for file in toy.edits if file.endswith(".py") and not file.startswith("tests/")]
        text = (copy.folder / file).read_text(encoding="utf-8")
        shutil.copy(ROOT / file, copy.folder / file)
        _, failed = copy.test(*whole[:2], "-k", f"columns_are or {toy.name}")
        assert failed > 0
        (copy.folder / file).write_text(text, encoding="utf-8")
