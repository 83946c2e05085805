"""Files are whole or not there."""

import errno
from pathlib import Path

import pytest

from lidarsim._files import atomic_writer


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
