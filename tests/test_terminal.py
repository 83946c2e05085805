"""Terminal output: escaping, alignment and streams of every kind."""

from __future__ import annotations

import io
import logging
import sys
import warnings

import pytest
from rich.cells import cell_len

from lidarsim._base import terminal
from lidarsim._base.shown import plain
from lidarsim.errors import LidarsimError

ODD = [
    "[red]x[/]",
    "[/]",
    "[bold",
    ":car:",
    "\x1b]0;owned\a\x1b[2J",
    "\x9b31m",
    "a\nb\tc",
    "a\u202eb\u2066c",
    "\u2028",
    "\udcff",
    "道路",
    "e\u0301" * 5,
    "ß…°",
]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain, ünïcödé, 道路 and e\u0301", "plain, ünïcödé, 道路 and e\u0301"),
        ("\x1b[31m\a\x7f\x9b", r"\x1b[31m\x07\x7f\x9b"),
        ("a\r\nb\tc\u2028d", r"a\r\nb\tc\u2028d"),
        ("\u202ea\u2066b\u200b\ufeff\U000e0041", r"\u202ea\u2066b\u200b\ufeff\U000e0041"),
        ("\ud800\udcff", r"\ud800\udcff"),
        (7, "7"),
    ],
)
def test_what_cannot_be_printed_is_escaped(text: object, shown: str) -> None:
    assert plain(text) == shown
    assert plain(text).isprintable()


def test_a_text_may_have_a_greatest_length() -> None:
    assert plain("x" * 10, most=10) == "x" * 10
    assert plain("x" * 11, most=10) == "x" * 9 + "…"
    assert plain("\x1b" * 11, most=10) == r"\x1b\x1b\…"


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "latin-1", "cp1252"])
def test_tables_keep_their_columns(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    terminal.table(("name", "angle °"), [(name, "END") for name in ODD], left=("name",))
    rows = [line for line in raw.getvalue().decode(encoding).splitlines() if "END" in line]
    assert len(rows) == len(ODD)
    assert len({cell_len(row[: row.index("END")]) for row in rows}) == 1
    for name, row in zip(ODD, rows, strict=True):
        assert row.isprintable()
        escaped = plain(name).translate(terminal.ASCII).encode(encoding, "backslashreplace").decode(encoding)
        assert plain(name) in row or escaped in row


def test_paragraphs_wrap_between_words_where_the_width_is_known(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = "/a/long/path/that/is/wider/than/the/terminal.pcd"
    texts = ("one two three four five", f"  in {path} and 道路道路道路", "- one two three four five", "")
    monkeypatch.setenv("COLUMNS", "16")
    for text in texts:
        terminal.paragraph(text)
    assert capsys.readouterr().out.splitlines() == [
        "one two three", "four five", "  in", f"  {path}", "  and", "  道路道路道路", "- one two three", "  four five",
        "",
    ]  # fmt: skip
    monkeypatch.delenv("COLUMNS")
    for text in texts:
        terminal.paragraph(text)
    assert capsys.readouterr().out.splitlines() == list(texts)  # a pipe gets whole lines


def test_a_message_is_one_line_of_a_bounded_length(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.say("a.yaml: no such\n   file\n\x1b[31m")
    terminal.say(f"begin {'9' * 10_000} end")
    first, second = capsys.readouterr().err.splitlines()
    assert first == r"lidarsim: a.yaml: no such file \x1b[31m"
    assert second.startswith("lidarsim: begin 999")
    assert second.endswith("999 end")
    assert len(second) < 2100


class Broken(io.StringIO):
    """A stream that takes nothing."""

    def __init__(self, error: type[OSError], number: int) -> None:
        super().__init__()
        self.error = error, number

    def write(self, _text: str) -> int:
        kind, number = self.error
        raise kind(number, "No space left on device")


def test_a_full_disk_is_an_error_and_a_closed_pipe_is_one_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Broken(OSError, 28))
    for write in (terminal.print_line, terminal.paragraph, lambda text: terminal.table(("a",), [(text,)])):
        with pytest.raises(LidarsimError, match=r"^standard output: cannot be written: No space left on device$"):
            write("text")
    monkeypatch.setattr(sys, "stdout", Broken(BrokenPipeError, 32))
    with pytest.raises(BrokenPipeError):
        terminal.print_line("text")
    monkeypatch.setattr(sys, "stderr", Broken(OSError, 28))
    terminal.say("nobody hears this")


def test_warnings_and_logs_are_messages(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.standard_streams():
        warnings.simplefilter("always")
        warnings.warn("odd \x1b[31m", UserWarning, stacklevel=1)
        logging.getLogger("lidarsim").warning("%s: flat", "a\x1b[2J.ply")
    assert capsys.readouterr().err == "lidarsim: warning: odd \\x1b[31m\nlidarsim: warning: a\\x1b[2J.ply: flat\n"
    assert not any(isinstance(handler, terminal._Log) for handler in logging.getLogger().handlers)


def test_warnings_of_gdal_that_are_no_text_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rasterio fails to decode a warning that quotes the bytes of a damaged file, which Python reports as ignored."""

    class Failing:
        def __init__(self, error: Exception) -> None:
            self.error = error

        def __del__(self) -> None:
            raise self.error

    reported: list[type[BaseException]] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: reported.append(dropped.exc_type))
    undecodable = UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte")
    with terminal.standard_streams():
        Failing(undecodable)
        Failing(KeyError())
    assert reported == [KeyError]
    Failing(undecodable)
    assert reported == [KeyError, UnicodeDecodeError]
