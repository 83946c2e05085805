"""Optional packages: errors if one is missing or cannot be imported."""

import sys
from pathlib import Path

import pytest

from lidarsim._base.extras import import_extra
from lidarsim.errors import MissingExtraError


def test_present() -> None:
    assert import_extra("json", "formats", "this") is sys.modules["json"]


def test_missing() -> None:
    with pytest.raises(MissingExtraError) as caught:
        import_extra("no_such_package", "formats", "reading PLY files")
    assert str(caught.value) == 'reading PLY files needs no_such_package: pip install "lidarsim[formats]"'


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import no_such_part", "No module named 'no_such_part'"),
        ("raise ImportError('libEGL.so.1: not found')", "libEGL.so.1: not found"),
        ("raise OSError('libGL.so.1: not found')", "libGL.so.1: not found"),
    ],
)
def test_broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, reason: str) -> None:
    (tmp_path / "broken_package.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingExtraError) as caught:
        import_extra("broken_package", "open3d", "this view")
    assert str(caught.value) == f"this view needs broken_package, which does not import here: {reason}"
