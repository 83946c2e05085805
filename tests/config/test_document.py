"""YAML documents: what they may hold, how they merge, and where errors say that things are."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from lidarsim.config import document
from lidarsim.config.document import Node, Place, argument, dump, merge, parse, parse_assignment, plain, read, replace
from lidarsim.errors import ConfigError


def override(node: Node, assignment: str) -> Node:
    return replace(node, *parse_assignment(assignment))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("-1.5E+3", -1500.0),
        (".5", 0.5),
        ("3.", 3.0),
        ("-.inf", -math.inf),
        (".INF", math.inf),
        ("+5", 5),
        ("0x1F", 31),
        ("010", 10),
        ("-010", -10),
        ("0o10", 8),
        ("0o8", "0o8"),
        ("-0x1F", "-0x1F"),
        ("1_000", "1_000"),
        ("1:30", "1:30"),
        ("no", "no"),
        ("on", "on"),
        ("true", True),
        ("False", False),
        ("~", None),
        ("2024-01-01", "2024-01-01"),
        ("'1'", "1"),
        ("[1, {a: b}]", [1, {"a": "b"}]),
    ],
)
def test_values_are_read_by_the_core_schema_of_yaml_1_2(text: str, value: object) -> None:
    got = plain(parse(f"key: {text}", "f.yaml"))["key"]
    assert (got, type(got)) == (value, type(value))


def test_nan_is_a_number() -> None:
    assert math.isnan(plain(parse(".nan", "f.yaml")))


def test_keys_are_text_whatever_they_look_like() -> None:
    assert plain(parse("{1: a, true: b}", "f.yaml")) == {"1": "a", "true": "b"}


def test_an_alias_stands_for_its_anchor() -> None:
    assert plain(parse("{a: &x [1], b: *x}", "f.yaml")) == {"a": [1], "b": [1]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "f.yaml: expected YAML, got nothing"),
        ("# only a comment", "f.yaml: expected YAML, got nothing"),
        ("a: 1\nb: 2\na: 3", "f.yaml:3: a: this key is already on line 1"),
        ("a: [1", "f.yaml:1: not valid YAML: expected ',' or ']', but got '<stream end>'"),
        ("a: 1\n---\nb: 2", "f.yaml:2: not valid YAML: but found another document"),
        ("a:\n\t- 1", "f.yaml:2: not valid YAML: found character '\\t' that cannot start any token"),
        ("a: *x", "f.yaml:1: not valid YAML: found undefined alias 'x'"),
        ("a: &x [*x]", "f.yaml:1: not valid YAML: this value contains itself"),
        ("? [a]\n: 1", "f.yaml:1: expected a word as a key"),
        (
            "a: &x {b: 1}\nc:\n  <<: *x",
            "f.yaml:3: expected no merge key <<, which YAML 1.2 lacks; write out what it adds",
        ),
        ("a: \0", "f.yaml:1: not valid YAML: character U+0000"),
        ("[" * 2_000, "f.yaml:1: not valid YAML: nested too deeply"),
        ("a: !!int x", "f.yaml:1: not valid YAML: int is unknown or does not fit the value"),
        (
            "a: !!python/name:os.system",
            "f.yaml:1: not valid YAML: python/name:os.system is unknown or does not fit the value",
        ),
        ("a: !!python/tuple [1]", "f.yaml:1: not valid YAML: python/tuple is unknown or does not fit the value"),
        ("a: !!set {b: }", "f.yaml:1: not valid YAML: set is unknown or does not fit the value"),
        ("a: !<x%1B[31m> 1", "f.yaml:1: not valid YAML: x\\x1b[31m is unknown or does not fit the value"),
        ('a: 1\nb: "\\U00110000"', "f.yaml:2: not valid YAML: an escape or a version is out of range"),
        ('a: 1\nb: "\\UFFFFFFFF"', "f.yaml:2: not valid YAML: an escape or a version is out of range"),
        (f"%YAML {'9' * 5000}.1\n---\na: 1", "f.yaml:1: not valid YAML: an escape or a version is out of range"),
        ('a: 1\nb: "x\\ud800"', "f.yaml:2: expected text, got half a character in 'x\\ud800'"),
        ('"x\\ud800": 1', "f.yaml:1: expected text, got half a character in 'x\\ud800'"),
        ('{"a\\nb\\e[31m": 1, "a\\nb\\e[31m": 2}', r"f.yaml:1: a\nb\x1b[31m: this key is already on line 1"),
        ("a: 1\nb:\n- {c: 1e400}",
         "f.yaml:3: b.0.c: expected a number from -1.8e308 to 1.8e308, got 1e400"),
        (f"a: {'9' * 401}",
         "f.yaml:1: a: expected a number from -1.8e308 to 1.8e308, got 999999999999...9999999999999"),
        (f"a: -{'9' * 5000}",
         "f.yaml:1: a: expected a number from -1.8e308 to 1.8e308, got -99999999999...9999999999999"),
        (f"a: {2**1024}",
         "f.yaml:1: a: expected a number from -1.8e308 to 1.8e308, got 179769313486...9624224137216"),
        (f"a: 0x{'f' * 400}",
         "f.yaml:1: a: expected a number from -1.8e308 to 1.8e308, got 0xffffffffff...fffffffffffff"),
        ("\n".join(" " * k + "a:" for k in range(3000)), "f.yaml:101: not valid YAML: nested too deeply"),
        ("- " * 100_000 + "x", "f.yaml:1: not valid YAML: nested too deeply"),
        ("{a: " * 100_000, "f.yaml:1: not valid YAML: nested too deeply"),
        ("? " * 100_000, "f.yaml:1: not valid YAML: nested too deeply"),
        ("a: 1\r\n\0", "f.yaml:2: not valid YAML: character U+0000"),
    ],
)  # fmt: skip
def test_what_is_no_document(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        plain(parse(text, "f.yaml"))
    assert str(caught.value) == message


def nest(levels: int, width: int, inner: str) -> str:
    """A list of lists of lists …, each of which says the one before many times."""
    lines = [f"a0: &a0 {inner}"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * width)}]" for k in range(1, levels + 1)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (nest(30, 10, "x"), "f.yaml:7: expected at most 1,000,000 values, counting aliases, got 1,111,111"),
        (nest(101, 1, "x"), "f.yaml:102: not valid YAML: nested too deeply"),
        (
            nest(2, 200, "x" * 1000),
            "f.yaml:3: expected at most 16,777,216 characters, counting aliases, got 40,000,000",
        ),
    ],
)
def test_aliases_do_not_multiply(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text, "f.yaml")
    assert str(caught.value) == message


def test_the_largest_numbers() -> None:
    greatest = 2**1024 - 2**970 - 1  # rounded down to the greatest float64
    assert plain(parse(f"[{greatest}, -{greatest}, 1.7976931348623157e308, .inf]", "f")) == [
        greatest, -greatest, 1.7976931348623157e308, math.inf,
    ]  # fmt: skip


def test_byte_order_marks_and_line_ends_of_all_systems(tmp_path: Path) -> None:
    path = tmp_path / "f.yaml"
    for end in ("\n", "\r\n", "\r"):
        for mark in (b"", b"\xef\xbb\xbf"):
            path.write_bytes(mark + f"a: 1{end}b:{end}- c{end}".encode())
            assert plain(read(path)) == {"a": 1, "b": ["c"]}
            assert str((Place(read(path)) / "b" / 0).error("x")) == f"{path}:3: b.0: x"
    path.write_bytes("a: 1".encode("utf-16"))
    with pytest.raises(ConfigError, match=r"f\.yaml:1: not valid YAML: byte 0 is not UTF-8"):
        read(path)


def test_no_such_name(tmp_path: Path) -> None:
    for name in ("a\0b", "a\ud800", "a" * 5000):
        with pytest.raises(ConfigError, match="cannot read the file: ") as caught:
            read(tmp_path / name)
        assert str(caught.value).isprintable()


YAMLISH = st.text(alphabet=st.sampled_from("ab1 .-:,?[]{}#&*!|>'\"%@`\n\t\\\0\x85\u2028\ufeffexU~=<+_é🚗"), max_size=60)


@given(YAMLISH)
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        node = parse(text, "f")
    except ConfigError as error:
        refusal = str(error)
    else:
        assert plain(parse(dump(plain(node)), "f")) == plain(node) or "nan" in text.lower()
        refusal = "f:"
    assert refusal.startswith("f:")
    assert refusal.isprintable()
    assert len(refusal) < 600


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "f.yaml"
    path.write_bytes(content)
    try:
        read(path)
    except ConfigError as error:
        refusal = str(error)
    else:
        refusal = str(path)
    assert refusal.startswith(str(path))
    assert refusal.isprintable()


NASTY = [
    "1e3", "yes", "no", "on", "null", "Null", "~", "", "=", "<<", "0x10", "010", "0o17", "0b1", "1_000", "12:30:45",
    "2026-11-25", "2026-11-25T10:00:00Z", ".inf", "-.INF", ".nan", "+1", "1.", ".5", "1e400", "9" * 500, "true", "True",
    "y", " ", "a ", " a", "- a", "-", "--", "---", "...", "? b", ": c", ":", "#x", "a #b", "a: b", "|", ">", "&a", "*a",
    "!t", "%d", "@x", "`x", "'q'", '"d"', "'", '"', "{a}", "[b]", ",", "\\", "\\x", "\n", "a\nb", "a\n\n b\n", "\ta",
    "a\t", "\r", "\r\n", "\x85", "\u2028", "\u2029", "\ufeff", "\0", "\x1b[31m", "\x7f", "\xa0", "🚗", "x" * 300,
    " \n ", "a\n---\nb",
]  # fmt: skip
TEXTS = st.one_of(st.sampled_from(NASTY), st.text(alphabet=st.characters(exclude_categories=["Cs"])))
PLAIN = st.recursive(
    st.one_of(TEXTS, st.integers(-(2**70), 2**70), st.floats(allow_nan=False), st.booleans(), st.none()),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(TEXTS, inner, max_size=4)),
    max_leaves=12,
)


def assert_read_back(value: Any) -> None:
    text = dump(value)
    for again in (plain(parse(text, "f")), yaml.safe_load(text)):  # YAML 1.2, and 1.1
        assert again == value
        assert repr(again) == repr(value)  # 1 is not 1.0, nor True


@pytest.mark.parametrize("text", NASTY)
def test_nasty_texts_are_read_as_they_are_written(text: str) -> None:
    for value in (text, [text], {text: text}, {"a": [{text: [text, text]}]}):
        assert_read_back(value)


@given(PLAIN)
def test_values_are_read_as_they_are_written(value: Any) -> None:
    assert_read_back(value)


@given(PLAIN)
def test_values_given_from_python_are_read_as_they_are(value: Any) -> None:
    assert repr(plain(argument("key", value))) == repr(value)


def test_values_of_other_types_are_not_given() -> None:
    for value in (b"x", {1}, object(), [b"x"], {"a": 1j}):
        with pytest.raises(TypeError, match="value: expected numbers, text, or lists or mappings of them, got "):
            argument("key", value)


def test_each_mapping_is_looked_through_once_for_all_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.config.loader import validate
    from lidarsim.config.schema import SceneDocument

    looked = []
    monkeypatch.setattr(document, "entries", lambda node, of=document.entries: looked.append(node) or of(node))
    labels = list(range(500))
    random.Random(1).shuffle(labels)
    root = parse("scene: []\nclass_names:\n" + "".join(f"  {label}: 5\n" for label in labels), "f")
    with pytest.raises(ConfigError) as caught:
        validate(SceneDocument, root)
    assert str(caught.value) == f"f:3: class_names.{labels[0]}: expected text, got 5 (and 499 more)"
    assert len(looked) < 20


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path / "no.yaml")
    assert str(caught.value) == f"{tmp_path}/no.yaml: cannot read the file: No such file or directory"


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path)
    assert str(caught.value) == f"{tmp_path}: cannot read the file: Is a directory"


def test_file_that_is_not_text(tmp_path: Path) -> None:
    path = tmp_path / "image.yaml"
    path.write_bytes(b"a: \x89PNG")
    with pytest.raises(ConfigError) as caught:
        read(path)
    assert str(caught.value) == f"{path}:1: not valid YAML: byte 3 is not UTF-8"


def test_differences_are_merged_mapping_by_mapping() -> None:
    base = parse("{a: 1, b: {c: [1, 2], d: 2}, e: 3}", "base.yaml")
    difference = parse("{b: {c: [9]}, e: null, f: 4}", "difference.yaml")
    assert plain(merge(base, difference)) == {"a": 1, "b": {"c": [9], "d": 2}, "e": None, "f": 4}
    assert plain(base) == {"a": 1, "b": {"c": [1, 2], "d": 2}, "e": 3}


def test_a_mapping_of_another_type_replaces() -> None:
    base = parse("{pattern: {type: spinning, columns: 3}}", "base.yaml")
    assert plain(merge(base, parse("{pattern: {type: spinning}}", "d"))) == {
        "pattern": {"type": "spinning", "columns": 3}
    }
    assert plain(merge(base, parse("{pattern: {type: grid}}", "d"))) == {"pattern": {"type": "grid"}}


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("a=2", {"a": 2, "b": [{"c": 1}]}),
        ("b.0.c=[1, 2]", {"a": 1, "b": [{"c": [1, 2]}]}),
        ("b.0.new.key=x=y", {"a": 1, "b": [{"c": 1, "new": {"key": "x=y"}}]}),
        ("b=", {"a": 1, "b": None}),
    ],
)
def test_override(assignment: str, value: object) -> None:
    node = parse("{a: 1, b: [{c: 1}]}", "f.yaml")
    assert plain(override(node, assignment)) == value
    assert plain(node) == {"a": 1, "b": [{"c": 1}]}


def test_override_fills_an_empty_value() -> None:
    assert plain(override(parse("a:", "f.yaml"), "a.b=1")) == {"a": {"b": 1}}


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("a", "--set a: expected KEY=VALUE, such as scene.0.radius_m=2"),
        ("=1", "--set =1: expected KEY=VALUE, such as scene.0.radius_m=2"),
        ("a..b=1", "--set a..b=1: expected KEY=VALUE, such as scene.0.radius_m=2"),
        ("a.b=1", "--set a.b=1: '1' has no key 'b' to set"),
        ("b.1=1", "--set b.1=1: expected an index below 1, got '1'"),
        ("b.-1=1", "--set b.-1=1: expected an index below 1, got '-1'"),
        ("b.c=1", "--set b.c=1: expected an index below 1, got 'c'"),
        ("b.٠=1", "--set b.٠=1: expected an index below 1, got '٠'"),
        (f"b.{'9' * 5000}=1", f"--set b.{'9' * 191}…: expected an index below 1, got '999999999999...9999999999999'"),
        (f"{'a.' * 5000}a=1", f"--set {'a.' * 96}a…: expected KEY=VALUE, such as scene.0.radius_m=2"),
        (
            f"c={'9' * 401}",
            f"--set c={'9' * 191}…: expected a number from -1.8e308 to 1.8e308, got 999999999999...9999999999999",
        ),
        ("a\nb", "--set a\\nb: expected KEY=VALUE, such as scene.0.radius_m=2"),
        ("a=[", "--set a=[: not valid YAML: expected the node content, but found '<stream end>'"),
    ],
)
def test_bad_override(assignment: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        override(parse("{a: 1, b: [{c: 1}]}", "f.yaml"), assignment)
    assert str(caught.value) == message


def test_places_survive_merging_and_overriding() -> None:
    base = parse("a: 1\nb:\n  c: 2\n  d: 3", "base.yaml")
    node = override(merge(base, parse("\nb:\n  c: 4", "difference.yaml")), "e.f=5")
    assert str((Place(node) / "a").error("x")) == "base.yaml:1: a: x"
    assert str((Place(node) / "b" / "c").error("x")) == "difference.yaml:3: b.c: x"
    assert str((Place(node) / "b" / "d").error("x")) == "base.yaml:4: b.d: x"
    assert str((Place(node) / "e" / "f").error("x")) == "--set e.f=5: x"


def test_a_place_passes_over_what_no_document_has() -> None:
    place = Place(parse("a:\n  - {shape: sphere}", "f.yaml")) / "a" / 0
    assert str((place / "sphere" / "radius_m").error("missing")) == "f.yaml:2: a.0: missing"


def test_files_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "mesh.ply").touch()
    place = Place(parse("file: mesh.ply", str(tmp_path / "f.yaml"))) / "file"
    assert place.file("mesh.ply") == tmp_path / "mesh.ply"
    with pytest.raises(ConfigError) as caught:
        place.file("other.ply")
    assert (
        str(caught.value) == f"{tmp_path}/f.yaml:1: file: cannot read {tmp_path}/other.ply: No such file or directory"
    )


def test_files_of_an_override_are_relative_to_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here.ply").touch()
    node = override(parse("file: mesh.ply", "/somewhere/f.yaml"), "file=here.ply")
    assert (Place(node) / "file").file("here.ply") == Path("here.ply")


def test_a_document_loads_a_file_once(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("x", encoding="utf-8")
    place = Place(parse("{one: a, two: a}", str(tmp_path / "f.yaml")))
    assert (place / "one").load("a", Path.stat) is (place / "two").load("a", Path.stat)
