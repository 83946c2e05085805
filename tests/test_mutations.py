"""The mutants in `mutations.py` match the sources of the core."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutations import CORE, MUTANTS, ROOT, Mutant, places


def test_each_mutant_is_in_place_once() -> None:
    if not (ROOT / CORE).is_dir():
        pytest.skip("the tests run without the sources")
    found = places(ROOT / CORE)
    assert len(found) > 100
    assert {mutant.name: [str(path) for path in where] for mutant, where in found.items() if len(where) != 1} == {}


def test_each_mutant_changes_its_text_and_has_its_name() -> None:
    assert [mutant.name for mutant in MUTANTS if mutant.instead == mutant.text] == []
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)


def test_lost_and_doubled_texts_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.rs").write_text("one; two; two;", encoding="utf-8")
    (tmp_path / "b.rs").write_text("two;", encoding="utf-8")
    (tmp_path / "target").mkdir()
    (tmp_path / "target" / "a.rs").write_text("one;", encoding="utf-8")
    mutants = [Mutant(text, text, "") for text in ("one", "two", "three")]
    a, b = tmp_path / "a.rs", tmp_path / "b.rs"
    assert list(places(tmp_path, mutants).values()) == [[a], [a, a, b], []]
