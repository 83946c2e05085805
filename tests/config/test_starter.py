"""The packaged configurations, by name and as a new project, in which everything that its notes name runs."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.config import starter

CONFIGS = Path(__file__).parents[2] / "configs"
NOTES = (starter.STARTER / "README.md").read_text(encoding="utf-8")
COMMANDS = [
    line
    for block in re.findall(r"^```bash\n(.*?)^```$", NOTES, re.DOTALL | re.MULTILINE)
    for line in block.splitlines()
]


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def lidarsim(*arguments: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    return int(left.value.code or 0)


def test_the_packaged_configurations_are_those_of_the_repository() -> None:
    shared = [file for file in starter.files() if file.name not in {"README.md", "scan.py"}]
    assert len(shared) == 10
    for file in shared:
        assert (starter.STARTER / file).read_bytes() == (CONFIGS / file).read_bytes(), file


def test_the_next_command_quotes_the_folder(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("new", "my project") == 0
    assert "next: cd 'my project' && lidarsim scan" in capsys.readouterr().out


@pytest.mark.slow("a new project has all that its notes and names promise")
def test_every_command_of_the_notes_runs_in_a_new_project(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert lidarsim("new", "project") == 0
    assert [Path("project", file).is_file() for file in starter.files()] == [True] * 12
    assert all(f"`{file.as_posix()}`" in NOTES for file in starter.files() if file.suffix in {".yaml", ".py"})
    said = capsys.readouterr().out
    first = said.partition("next: cd project && ")[2].splitlines()[0]
    assert first == COMMANDS[0]
    monkeypatch.chdir("project")
    assert len(COMMANDS) == 9
    for command in COMMANDS:
        program, *words = shlex.split(command)
        if program == "python":
            subprocess.run([sys.executable, "-W", "error", *words], check=True)
            continue
        assert program == "lidarsim"
        if words[0] == "view":
            words += ["--screenshot", "seen.png", "--size", "320x200"]
        if words[0] == "generate":
            words += ["--set", "sequences=1", "--set", "frames=1", "--pictures", "0"]  # so that it takes seconds
        assert lidarsim(*words) == 0, command
    made = {"street.pcd", "other.pcd", "seen.png", "detection", "street.ply"}
    assert {path.name for path in Path().iterdir()} == made | {file.parts[0] for file in starter.files()}


def test_a_folder_with_files_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("full").mkdir()
    Path("full", "mine.txt").write_text("mine")
    assert lidarsim("new", "full") == 2
    assert capsys.readouterr().err == "lidarsim: full: expected a new or an empty folder, got one with files\n"
    assert [path.name for path in Path("full").iterdir()] == ["mine.txt"]
    Path("file").write_text("mine")
    assert lidarsim("new", "file") == 2
    assert capsys.readouterr().err == "lidarsim: file: cannot be written: File exists\n"
    assert lidarsim("new", "no/where") == 2
    assert capsys.readouterr().err == "lidarsim: no/where: cannot be written: No such file or directory\n"


def test_an_empty_folder_is_filled() -> None:
    assert starter.new_project(".") == starter.files()
    assert all(file.is_file() for file in starter.files())


@pytest.mark.parametrize("there", [False, True])
def test_a_project_that_cannot_be_finished_is_removed(there: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if there:
        Path("project").mkdir()
    last = starter.files()[-1]
    monkeypatch.setattr(starter, "files", lambda: [Path("demo.yaml"), last, Path("gone.yaml")])
    with pytest.raises(OSError, match=r"^project: cannot be written: No such file or directory$"):
        starter.new_project("project")
    assert list(Path().rglob("*")) == [Path("project")] * there


@pytest.mark.slow("a new project has all that its notes and names promise")
def test_names_stand_for_packaged_configurations(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(starter.names()) == ["ahead", "demo", "detection", "segmentation"]
    assert lidarsim("check", "demo") == 0
    assert "demo: ok" in capsys.readouterr().out
    assert lidarsim("scan", "demo", "-o", "demo.npz", "--set", "sensor.preset=velodyne-vlp16") == 0
    expected = ls.config.load(CONFIGS / "demo.yaml", ["sensor.preset=velodyne-vlp16"]).scan().point_cloud("world")
    assert (ls.PointCloud.load("demo.npz").xyz == expected.xyz).all()
    assert ls.generate("detection", "set", sequences=1, frames=1, layout="semantickitti", pictures=0).frames == 1
    for name in ("ahead", "detection"):
        assert lidarsim("view", name, "--screenshot", f"{name}.png", "--size", "320x200") == 0
        assert Path(f"{name}.png").is_file()


def test_a_file_comes_before_a_packaged_configuration() -> None:
    Path("demo").write_text("{sensor: {preset: velodyne-vlp16}, scene: []}")
    assert ls.config.load("demo").lidar.name == "velodyne-vlp16"
    assert lidarsim("check", "demo") == 0


def test_a_folder_does_not_come_before_a_packaged_configuration() -> None:
    short = ["--set", "scatter={}", "--set", "vary={}"]
    small = ["--set", "sequences=1", "--set", "frames=1", "--set", "run.sensor={preset: rplidar-a1}", "--pictures", "0"]
    again = ["generate", "segmentation", "-o", "segmentation", *short, *small]
    assert [lidarsim(*again), lidarsim(*again)] == [0, 0]  # the second finds the folder of the first
    assert len(ls.datasets.load("segmentation")) == 1
    assert lidarsim("check", "segmentation", "--sequences", "1", *short) == 0
    assert lidarsim("view", "segmentation", "--seed", "1", "--html", "a.html") == 2  # a data set, which has no seed


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("check deom", "deom"),
        ("view deom --screenshot a.png", "deom"),
        ("generate deom -o a", "deom"),
        ("check ☃", "☃"),
    ],
)
def test_an_unknown_name_is_answered_with_those_there_are(
    command: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert lidarsim(*command.split()) == 2
    known = "ahead, demo, detection, segmentation"
    assert capsys.readouterr().err == f"lidarsim: {name}: expected a file, or one of the packaged {known}\n"
