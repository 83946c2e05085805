"""YAML documents: what they may hold, how they merge, and where errors say that things are."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from lidarsim.config.document import Place, merge, override, parse, plain, read
from lidarsim.errors import ConfigError


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
        ("a: \0", "f.yaml:1: not valid YAML: character U+0000"),
        ("[" * 2_000, "f.yaml:1: not valid YAML: nested too deeply"),
        ("a: !!int x", "f.yaml:1: not valid YAML: int is unknown or does not fit the value"),
        (
            "a: !!python/name:os.system",
            "f.yaml:1: not valid YAML: python/name:os.system is unknown or does not fit the value",
        ),
        ("a: !!python/tuple [1]", "f.yaml:1: not valid YAML: python/tuple is unknown or does not fit the value"),
    ],
)
def test_what_is_no_document(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        plain(parse(text, "f.yaml"))
    assert str(caught.value) == message


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
