"""What holds for the project as a whole: its layout, its packaging, its README, its public docstrings."""

from __future__ import annotations

import ast
import dataclasses
import enum
import importlib.metadata
import inspect
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Protocol

import pytest
from numpydoc.validate import validate

import lidarsim

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")

# Checks of numpydoc that a public docstring has to pass; the others ask for sections that not every function needs.
CHECKS = {
    *("GL05", "GL06", "GL07", "GL08", "GL09", "GL10"),
    *("SS01", "SS02", "SS03", "SS04", "SS05", "SS06"),
    *("PR01", "PR02", "PR03", "PR04", "PR05", "PR07", "PR10", "RT01", "RT03", "YD01"),
}


def blocks(language: str) -> list[str]:
    """Code blocks of the README in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)


def public(module: ModuleType) -> Iterator[tuple[str, object]]:
    """Dotted name and object of everything public: what `__all__` lists, and the members of its classes."""
    for name in module.__all__:
        thing = getattr(module, name)
        dotted = f"{module.__name__}.{name}"
        if inspect.ismodule(thing):
            yield from public(thing)
        elif inspect.isroutine(thing) or inspect.isclass(thing):
            yield dotted, thing
        if inspect.isclass(thing):
            for member, value in inspect.getmembers(thing):
                source = getattr(value, "fget", value)
                ours = str(getattr(source, "__module__", "")).startswith("lidarsim")
                if not member.startswith("_") and ours and (inspect.isroutine(value) or isinstance(value, property)):
                    yield f"{dotted}.{member}", value


def faults(dotted: str, thing: object) -> list[str]:
    """What numpydoc finds wrong in a docstring; a dataclass may document its fields as attributes."""
    checks = CHECKS
    if inspect.isclass(thing) and (
        dataclasses.is_dataclass(thing) or issubclass(thing, enum.Enum | Exception) or Protocol in thing.__bases__
    ):
        checks = checks - {"PR01"}
    found = [f"{code} {text}" for code, text in validate(dotted)["errors"] if code in checks]
    if inspect.isclass(thing) and dataclasses.is_dataclass(thing):
        documented = ", ".join(re.findall(r"^ *(\w+(?:, \w+)*) : ", thing.__doc__ or "", re.MULTILINE)).split(", ")
        fields = [field.name for field in dataclasses.fields(thing)]
        found += [f"field {name!r} is not documented" for name in fields if name not in documented]
    return found


def badly_documented(count: int, *, scale: float = 1.0) -> float:
    """Counts things"""
    return count * scale


def test_the_docstring_check_finds_faults() -> None:
    found = faults(f"{__name__}.badly_documented", badly_documented)
    assert {text.partition(" ")[0] for text in found} == {"SS03", "SS05", "PR01", "RT01"}


def test_public_docstrings_are_complete() -> None:
    api = dict(public(lidarsim))
    assert len(api) > 50
    assert {name: found for name, thing in api.items() if (found := faults(name, thing))} == {}


def test_import_is_light() -> None:
    heavy = "laspy matplotlib open3d plyfile pydantic pyvista rich rosbags scipy trimesh typer vtk yaml"
    code = f"import sys, lidarsim; print(*sorted(set({heavy!r}.split()) & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == []


def test_only_the_top_imports_the_package_as_a_whole() -> None:
    package = ROOT / "lidarsim"
    modules = {path.stem for path in package.iterdir()} | {"_native"}
    users = set()
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            whole = isinstance(node, ast.Import) and any(name.name == "lidarsim" for name in node.names)
            part = isinstance(node, ast.ImportFrom) and node.module == "lidarsim"
            if whole or (part and not {name.name for name in node.names} <= modules):
                users.add(path.relative_to(package).parts[0])
    assert users == {"bench", "cli.py"}


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    crate = tomllib.loads((ROOT / "lidarsim/native/Cargo.toml").read_text(encoding="utf-8"))["package"]
    assert lidarsim.__version__ == importlib.metadata.version("lidarsim") == project["version"] == crate["version"]


def test_top_level_holds_the_four_folders_alone() -> None:
    ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()}
    folders = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")}
    assert folders - ignored - {"__pycache__"} == {"lidarsim", "tests", "configs", "examples"}


def test_tests_mirror_the_package() -> None:
    tests, package = ROOT / "tests", ROOT / "lidarsim"
    folders = {path.parent.relative_to(tests) for path in tests.rglob("test_*.py")}
    assert {str(folder) for folder in folders if not (package / folder).is_dir()} <= {"conformance", "hard"}


def test_readme_has_two_set_up_commands() -> None:
    commands = blocks("bash")
    assert len(commands) == 2
    assert "configs/demo.yaml" in commands[0]
    assert "pytest" in commands[1]


def test_readme_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = blocks("python")
    subprocess.run([sys.executable, "-W", "error", "-c", example], check=True)


def test_readme_links_lead_somewhere() -> None:
    links = re.findall(r"\]\((?!https?:|#)([^)]+)\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []
