"""Files are written completely or not at all."""

import errno
import os
import pkgutil
import signal
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim._base.files import atomic_writer, format_error, redact, replacing
from lidarsim.errors import FileFormatError
from lidarsim.scan.pointcloud import PointCloud


def write(path: Path) -> None:
    if path.suffix == ".tum":
        ls.Trajectory([0, 1], [np.eye(4)] * 2).save(path)
    else:
        PointCloud(xyz=np.ones((10, 3))).save(path)


@pytest.fixture
def target(tmp_path: Path) -> Path:
    path = tmp_path / "out.bin"
    path.write_bytes(b"old")
    return path


def test_replaces_when_the_block_ends_well(target: Path) -> None:
    with atomic_writer(target) as file:
        file.write(b"new")
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new"
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("error", [ValueError("boom"), KeyboardInterrupt()])
def test_an_error_in_the_block_passes_and_leaves_the_old_file(target: Path, error: BaseException) -> None:
    with pytest.raises(type(error)) as caught, atomic_writer(target) as file:  # noqa: PT012
        file.write(b"half")
        raise error
    assert caught.value is error
    assert target.read_bytes() == b"old"
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("interrupted", ["pathlib.Path.mkdir", "shutil.rmtree"])
def test_ctrl_c_at_either_end_of_the_block_leaves_nothing(
    target: Path, monkeypatch: pytest.MonkeyPatch, interrupted: str
) -> None:
    call = pkgutil.resolve_name(interrupted)
    calls: list[object] = []

    def once(*given: Any, **options: Any) -> None:
        calls.append(given)
        if len(calls) > 1 or interrupted.endswith("mkdir"):
            call(*given, **options)
        if len(calls) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(interrupted, once)
    with pytest.raises(KeyboardInterrupt), atomic_writer(target) as file:
        file.write(b"new")
    assert calls
    assert list(target.parent.iterdir()) == [target]
    assert target.read_bytes() == (b"old" if interrupted.endswith("mkdir") else b"new")


@pytest.mark.parametrize("failing", ["pathlib.Path.replace", "os.fsync"])
def test_a_failing_disk_leaves_the_old_file(target: Path, monkeypatch: pytest.MonkeyPatch, failing: str) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(failing, fail)
    with pytest.raises(OSError, match="cannot be written") as caught, atomic_writer(target) as file:
        file.write(b"new")
    assert str(caught.value) == f"{target}: cannot be written: No space left on device"
    assert target.read_bytes() == b"old"
    assert list(target.parent.iterdir()) == [target]


def test_a_file_written_beside_another_is_named_in_its_own_error(target: Path) -> None:
    other = target.with_name("other.bin")
    with pytest.raises(OSError, match="cannot be written") as caught, atomic_writer(other), atomic_writer(target):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert str(caught.value) == f"{target}: cannot be written: No space left on device"
    assert list(target.parent.iterdir()) == [target]


def test_a_temporary_file_is_not_named_in_the_error_of_its_file(target: Path) -> None:
    with pytest.raises(OSError, match="cannot be written") as caught, replacing(target) as path, atomic_writer(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert str(caught.value) == f"{target}: cannot be written: No space left on device"


def test_a_link_keeps_pointing_to_its_file(target: Path) -> None:
    link = target.with_name("link.bin")
    link.symlink_to(target)
    with atomic_writer(link) as file:
        file.write(b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


def test_permissions_are_those_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    with atomic_writer(tmp_path / "ours"):
        pass
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_permissions_of_a_replaced_file_stay(target: Path) -> None:
    target.chmod(0o600)
    with atomic_writer(target) as file:
        file.write(b"secret")
        assert Path(file.name).parent.stat().st_mode & 0o077 == 0, "nobody else reads it meanwhile"
    assert (target.read_bytes(), stat.S_IMODE(target.stat().st_mode)) == (b"secret", 0o600)


@pytest.mark.parametrize("suffix", [".npz", ".laz", ".mcap", ".tum"])
def test_the_longest_names(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / ("n" * (255 - len(suffix)) + suffix)
    write(path)
    assert path.stat().st_size > 0
    assert list(tmp_path.iterdir()) == [path]
    too_long = path.with_name(f"n{path.name}")
    with pytest.raises(OSError, match="File name too long"):
        write(too_long)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("suffix", [".npz", ".laz", ".mcap", ".tum"])
def test_a_pipe_stays_one_and_gets_the_content(suffix: str, tmp_path: Path) -> None:
    pipe, plain, folder = tmp_path / f"pipe{suffix}", tmp_path / f"plain{suffix}", tmp_path / "fixed"
    folder.mkdir()
    os.mkfifo(pipe)
    os.mkfifo(folder / pipe.name)
    folder.chmod(0o500)  # where no file could be made
    write(plain)
    for path in (pipe, folder / pipe.name):
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            write(path)
            assert os.read(reader, 1 << 16) == plain.read_bytes()  # all fits in a pipe
        finally:
            os.close(reader)
        assert path.is_fifo()
    assert sorted(tmp_path.iterdir()) == sorted([pipe, plain, folder])


@pytest.mark.skipif(sys.platform != "linux", reason="the numbers of devices are Linux's")
def test_a_device_stays_one(tmp_path: Path) -> None:
    null, full = tmp_path / "null.npz", tmp_path / "full.npz"  # never the system's own: a failure would replace them
    try:
        for path, number in ((null, 3), (full, 7)):
            os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, number))
            path.open("r+b").close()
    except PermissionError:
        pytest.skip("only root makes devices, where a file system lets them be used")
    write(null)
    with pytest.raises(OSError, match=f"{full}: cannot be written: No space left on device"):
        write(full)
    assert null.is_char_device()
    assert full.is_char_device()
    assert sorted(tmp_path.iterdir()) == [full, null]


def test_links_that_lead_nowhere(tmp_path: Path) -> None:
    loop, dangling = tmp_path / "loop.npz", tmp_path / "dangling.npz"
    loop.symlink_to(loop.name)
    with pytest.raises(OSError, match="symbolic link"):
        write(loop)
    assert loop.is_symlink()
    dangling.symlink_to("new.npz")
    write(dangling)
    assert dangling.is_symlink()
    assert (tmp_path / "new.npz").stat().st_size > 0
    with pytest.raises(OSError, match="symbolic link"):
        PointCloud.load(loop)


@pytest.mark.slow("a process that is ended leaves no half-written file")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without a signal")
@pytest.mark.parametrize("suffix", [".npz", ".laz", ".mcap", ".db3"])
def test_the_command_line_leaves_nothing_at_sigterm(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cloud{suffix}"
    path.write_bytes(b"old")
    script = f"""
import os, time
from lidarsim.cli import main
def stay(_):
    print("writing", flush=True)
    time.sleep(60)
os.fsync = stay
main(["scan", "demo", "-o", {str(path)!r}])
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        assert len(list(tmp_path.iterdir())) == 2
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"old"


def test_signals_are_left_to_the_program(target: Path) -> None:
    before = {number: signal.getsignal(number) for number in signal.valid_signals()}
    with atomic_writer(target):
        assert {number: signal.getsignal(number) for number in signal.valid_signals()} == before


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ValueError("could not convert string to float: 'root:x'"), "could not convert string to float: …"),
        (ValueError('invalid literal for int() with base 10: "it\'s"'), "invalid literal for int() with base 10: …"),
        (ValueError("expected b'\\x93NUMPY', got b'root:x'"), "expected …, got …"),
        (ValueError("an open 'quote"), "an open …"),
        (ValueError(r"an escaped 'quo\'te' ends"), "an escaped … ends"),
        (ValueError("it can't be `this`"), "it can't be …"),
        (KeyError("root"), "…"),
        (FileFormatError("expected 'ply'"), "expected 'ply'"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "why"), "'utf-8' codec can't decode byte 0xff in position 0: why"),
    ],
)
def test_what_others_quote_is_left_out(error: Exception, text: str) -> None:
    assert redact(error) == text


def test_what_lidarsim_says_is_kept() -> None:
    with pytest.raises(ValueError, match="name of a sensor") as caught:
        ls.Lidar.preset("nobody's")
    assert '"nobody\'s"' in str(caught.value)
    assert redact(caught.value) == str(caught.value)


READERS = {
    "x.glb": ls.Scene.from_file,
    "x.obj": ls.Scene.from_file,
    "x.stl": ls.TriangleMesh.from_file,
    "x.asc": ls.TriangleMesh.from_raster,
    "x.pcd": ls.PointCloud.load,
    "x.txt": ls.Trajectory.load,
    "x.json": ls.Lidar.from_file,
    "x.yaml": ls.config.load,
    "x.npz": ls.Waveforms.load,
    "x.mcap": lambda path: next(ls.io.rosbag.read(path)),
    "bag": lambda path: next(ls.io.rosbag.read(path)),
    "x.csv": ls.ImuSamples.load,
    "x.npy": lambda path: ls.patterns.Table.from_file(path, rate=10.0),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("state", ["missing", "a folder", "in a file"])
def test_what_cannot_be_opened_is_named_without_the_number_of_the_error(name: str, state: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if state == "a folder":
        path.mkdir()
    elif state == "in a file":
        (tmp_path / "file").write_text("")
        path = tmp_path / "file" / name
    with pytest.raises((OSError, ls.errors.LidarsimError)) as caught:
        READERS[name](path)
    assert name in str(caught.value)
    assert "Errno" not in str(caught.value)
    if isinstance(caught.value, OSError) and state == "missing":
        assert type(caught.value) is FileNotFoundError


def test_an_error_of_the_system_reads_as_ours() -> None:
    with pytest.raises(FileNotFoundError) as caught:
        Path("nowhere").read_bytes()
    assert format_error(caught.value) == "nowhere: No such file or directory"
    assert format_error(OSError(errno.ENOSPC, "No space left on device")) == "No space left on device"
