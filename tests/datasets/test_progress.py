"""Progress in a log: a line a minute."""

from __future__ import annotations

import pytest

from lidarsim.datasets import progress


def test_a_line_a_minute(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.Progress(1000, 100) as bar:
        for _ in range(180):  # a frame a second for three minutes
            now[0] += 1.0
            bar.add(1, 2000)
        assert bar.seconds == 180
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "lidarsim: 160 of 1,000 frames, 2,000 points/s, 14 min remaining",
        "lidarsim: 220 of 1,000 frames, 2,000 points/s, 13 min remaining",
        "lidarsim: 280 of 1,000 frames, 2,000 points/s, 12 min remaining",
    ]
    assert (bar.new, bar.points) == (180, 360_000)


def test_a_bar_on_a_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress.sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with progress.Progress(10, 4) as bar:
        bar.add(3, 5)
    assert "7/10" in capsys.readouterr().err
