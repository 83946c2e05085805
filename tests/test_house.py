"""Project-wide checks: layout, packaging, README and public docstrings."""

from __future__ import annotations

import ast
import dataclasses
import enum
import graphlib
import importlib.metadata
import inspect
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Protocol

import pictures
import pytest
from numpydoc.validate import validate

import lidarsim
from lidarsim.cli.commands import app

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")

# Checks of numpydoc that a public docstring has to pass; the others ask for sections that not every function needs.
CHECKS = {
    *("GL05", "GL06", "GL07", "GL08", "GL09", "GL10"),
    *("SS01", "SS02", "SS03", "SS04", "SS05", "SS06"),
    *("PR01", "PR02", "PR03", "PR04", "PR05", "PR07", "PR10", "RT01", "RT03", "YD01"),
}


NATIVE = ROOT / "lidarsim" / "native"

# Of the Rust core, from the lowest to the highest: a layer may use those before it alone.
LAYERS = [
    "testing",
    "memory",
    "stop",
    "once",
    "parallel",
    "arith",
    "geometry",
    "shapes",
    "bvh",
    "scene",
    "cast",
    "measure",
    "patterns",
    "kernels",
]

RustModule = tuple[str, ...]


def blocks(language: str) -> list[str]:
    """Code blocks of the README in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)


def public(module: ModuleType) -> Iterator[tuple[str, object]]:
    """Dotted name and object of everything public: what `__all__` lists, and the members of its classes."""
    for name in module.__all__:
        item = getattr(module, name)
        dotted = f"{module.__name__}.{name}"
        if inspect.ismodule(item):
            yield from public(item)
        elif inspect.isroutine(item) or inspect.isclass(item):
            yield dotted, item
        if inspect.isclass(item):
            for member, value in inspect.getmembers(item):
                source = getattr(value, "fget", value)
                ours = str(getattr(source, "__module__", "")).startswith("lidarsim")
                if not member.startswith("_") and ours and (inspect.isroutine(value) or isinstance(value, property)):
                    yield f"{dotted}.{member}", value


def faults(dotted: str, item: object) -> list[str]:
    """What numpydoc finds wrong in a docstring; a dataclass may document its fields as attributes."""
    checks = CHECKS
    if inspect.isclass(item) and (
        dataclasses.is_dataclass(item) or issubclass(item, enum.Enum | Exception) or Protocol in item.__bases__
    ):
        checks = checks - {"PR01"}
    found = [f"{code} {text}" for code, text in validate(dotted)["errors"] if code in checks]
    if inspect.isclass(item) and dataclasses.is_dataclass(item):
        documented = ", ".join(re.findall(r"^ *(\w+(?:, \w+)*) : ", item.__doc__ or "", re.MULTILINE)).split(", ")
        fields = [field.name for field in dataclasses.fields(item) if not field.name.startswith("_")]
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
    assert {name: found for name, item in api.items() if (found := faults(name, item))} == {}


def test_import_is_light() -> None:
    heavy = "laspy matplotlib mujoco open3d plyfile pydantic pyproj pyvista rasterio rerun rich rosbags scipy"
    heavy += " trimesh typer vtk yaml"
    code = f"import sys, lidarsim; print(*sorted(set({heavy!r}.split()) & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == []


def python_imports(package: Path) -> dict[str, set[str]]:
    """Of each Python module of a package, those that it imports at any time, also for types alone."""
    files = {
        ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__"): path
        for path in package.rglob("*.py")
    }
    modules = files.keys() | {f"{package.name}._native"}  # compiled: it imports none
    found: dict[str, set[str]] = {}
    for module, path in files.items():
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names.update(name.name for name in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{module} has a relative import"
                wholes = [f"{node.module}.{name.name}" for name in node.names]
                names.update(whole if whole in modules else str(node.module) for whole in wholes)
        found[module] = names & files.keys()
    return found


def python_cycle(imports: dict[str, set[str]]) -> list[str]:
    """The modules of a cycle of imports, each of which imports the next; none if there is no cycle."""
    try:
        graphlib.TopologicalSorter(imports).prepare()
    except graphlib.CycleError as error:
        return list(reversed(error.args[1]))
    return []


def test_the_check_of_python_imports_finds_cycles(tmp_path: Path) -> None:
    package = tmp_path / "toy"
    files = {
        "__init__.py": "from toy.high import high\n",
        "high.py": "import numpy\nfrom toy import _native, inner\ndef high() -> None: ...\n",
        "inner/__init__.py": "from toy.inner.low import low\n",
        "inner/low.py": "",
    }
    for name, text in files.items():
        (package / name).parent.mkdir(exist_ok=True)
        (package / name).write_text(text, encoding="utf-8")
    imports = python_imports(package)
    assert imports == {
        "toy": {"toy.high"}, "toy.high": {"toy.inner"}, "toy.inner": {"toy.inner.low"}, "toy.inner.low": set(),
    }  # fmt: skip
    assert python_cycle(imports) == []
    for closing in (
        "if TYPE_CHECKING:\n    from toy.high import high\n",
        "def f() -> None:\n    import toy.high\n",
        "from toy import high\n",
    ):
        (package / "inner" / "low.py").write_text(closing, encoding="utf-8")
        assert set(python_cycle(python_imports(package))) == {"toy.high", "toy.inner", "toy.inner.low"}
    (package / "inner" / "low.py").write_text("from toy.inner.low import f\n", encoding="utf-8")
    assert python_cycle(python_imports(package)) == ["toy.inner.low", "toy.inner.low"]


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    return python_imports(ROOT / "lidarsim")


def test_only_the_top_imports_the_package_as_a_whole(imports: dict[str, set[str]]) -> None:
    users = {module.split(".")[1] for module, names in imports.items() if "lidarsim" in names}
    assert users == {"bench", "cli", "starter"}  # the starter has a script for users


def test_no_python_files_import_each_other(imports: dict[str, set[str]]) -> None:
    """`lint-imports` holds the order of the packages; within one, files could still import each other in a cycle."""
    assert len(imports) >= 100
    assert sum(map(len, imports.values())) >= 500
    assert python_cycle(imports) == []


BLAS = {"dot", "inner", "matmul", "tensordot", "vdot", "einsum", "linalg"}
"""Functions of NumPy that may call BLAS, whose threads spin and whose sums depend on the processor."""


def calls_blas(source: str) -> bool:
    return any(
        (isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Attribute) and node.attr in BLAS)
        or (isinstance(node, ast.Name) and node.id in BLAS)
        for node in ast.walk(ast.parse(source))
    )


def test_no_scan_pattern_calls_blas() -> None:
    """The core makes the rest of a scan."""
    assert all(map(calls_blas, ("a @ b", "a @= b", "np.dot(a, b)", "np.linalg.norm(a)", "matmul(a, b)")))
    sources = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "lidarsim/patterns").glob("*.py")}
    assert len(sources) > 10
    assert {name for name, source in sources.items() if calls_blas(source)} == {"description.py"}  # of no scan


# Modules of one crate may import each other in circles: the compiler refuses none, and crates for the layers of the
# core would be compiled one after the other. cargo-modules sees no paths in the bodies of functions, and knows no
# layers. So the imports are read here.
RUST_TOKEN = re.compile(
    r"""
      (?P<skipped> \s+ | //[^\n]* | b?r(?P<hashes>\#*)".*?"(?P=hashes) | [bc]?"(?:\\.|[^"\\])*"
                 | b?'(?:\\u\{\w+\}|\\x\w\w|\\.|[^'\\])' )  # white space, comments, strings and characters
    | (?P<block> /\*)
    | (?P<token> (?:r\#)?\w+ | :: | . )
    """,
    re.VERBOSE | re.DOTALL,
)


def rust_tokens(source: str) -> list[str]:
    """Names, `::` and signs of a source, without comments and strings."""
    found, at = [], 0
    while at < len(source):
        match = RUST_TOKEN.match(source, at)
        assert match is not None
        at = match.end()
        if match["block"]:  # which nest
            depth = 1
            while depth:
                sign = re.compile(r"/\*|\*/").search(source, at)
                assert sign is not None
                at, depth = sign.end(), depth + (1 if sign[0] == "/*" else -1)
        elif match["token"]:
            found.append(match["token"].removeprefix("r#"))
    return found


class RustSources:
    """The modules of a Rust crate, by their paths, and what each imports."""

    def __init__(self, folder: Path) -> None:
        files = {path.relative_to(folder).with_suffix("").parts: path for path in folder.rglob("*.rs")}
        self.sources: dict[RustModule, list[str]] = {
            parts[:-1] if parts[-1] in {"lib", "mod"} else parts: rust_tokens(path.read_text(encoding="utf-8"))
            for parts, path in files.items()
        }
        self.named: list[tuple[RustModule, RustModule, list[str]]] = []
        """Of each path from the crate or from a parent: the file it is in, the module within that, and its names."""
        self.passed_on: dict[RustModule, list[list[str]]] = {module: [] for module in self.sources}
        """Of each file, the paths that it re-exports."""
        for module, tokens in self.sources.items():
            self._read(module, tokens)

    def _read(self, file: RustModule, tokens: list[str]) -> None:
        open_: list[str] = []  # what stands before each brace that is open: a module's name, or nothing
        for k, word in enumerate(tokens):
            if word == "{":
                open_.append(tokens[k - 1] if tokens[k - 2 : k - 1] == ["mod"] else "")
            elif word == "}":
                open_.pop()
            elif word in {"crate", "super"} and tokens[k + 1] == "::" and tokens[k - 1] != "::":
                here = (*file, *filter(None, open_))
                self.named += [(file, here, path) for path in self.leaves(tokens, k)[0]]
            elif word == "use" and not open_ and tokens[k - 1] in {"pub", ")"}:
                self.passed_on[file] += self.leaves(tokens, k + 1)[0]

    def imports(self) -> set[tuple[RustModule, RustModule]]:
        """Of each path from the crate or from a parent, the file it is in and the one that defines what it names."""
        found = {(file, self.resolve(here, path)) for file, here, path in self.named}
        return {(user, used) for user, used in found if user != used}

    def leaves(self, tokens: list[str], start: int) -> tuple[list[list[str]], int]:
        """The paths of a tree of imports, such as a::{b, c::{self, d as e}}, and where it ends."""
        path: list[str] = []
        k = start
        while re.fullmatch(r"\w+|\*", tokens[k]):
            path.append(tokens[k])
            k += 1
            if tokens[k] != "::":
                return [path], k + 2 * (tokens[k] == "as")
            k += 1
        found: list[list[str]] = []
        while tokens[k] in {"{", ","}:
            if tokens[k + 1] == "}":
                k += 1
                break
            inner, k = self.leaves(tokens, k + 1)
            found += inner
        return [path + leaf for leaf in found], k + 1

    def resolve(self, module: RustModule, path: list[str]) -> RustModule:
        """The file that defines what a path names: where it is only passed on, the one that it comes from."""
        for k, name in enumerate(path):
            if name in {"crate", "self"}:
                module = () if name == "crate" else module
            elif name == "super":
                module = module[:-1]
            elif (*module, name) in self.sources:
                module = (*module, name)
            else:
                for passed in self.passed_on.get(module, []):
                    # A path of one name passes on a macro of the module itself.
                    if passed[-1] == name and len(passed) > 1:
                        return self.resolve(module, [*passed[:-1], *path[k:]])
                break
        while module not in self.sources:  # a module within a file
            module = module[:-1]
        return module

    def siblings(self) -> dict[RustModule, dict[str, set[str]]]:
        """Of each module with others in it, which of these uses which; its own file and what uses that do not count."""
        graphs: dict[RustModule, dict[str, set[str]]] = {}
        for module in self.sources:
            for k, name in enumerate(module):
                graphs.setdefault(module[:k], {}).setdefault(name, set())
        for user, used in self.imports():
            k = next((k for k, (a, b) in enumerate(zip(user, used, strict=False)) if a != b), None)
            if k is not None:
                graphs[user[:k]][user[k]].add(used[k])
        return graphs


def rust_faults(sources: RustSources, layers: list[str]) -> list[str]:
    """Cycles of imports between modules of one parent, and imports from a lower layer of a higher one."""
    found = []
    for parent, graph in sources.siblings().items():
        try:
            graphlib.TopologicalSorter(graph).prepare()
        except graphlib.CycleError as error:
            found.append(f"cycle in {'::'.join(('crate', *parent))}: {' -> '.join(reversed(error.args[1]))}")
    top = sources.siblings()[()]
    found += [f"{name} is in no layer" for name in top.keys() - set(layers)]
    known = {name: used & set(layers) for name, used in top.items() if name in layers}
    found += [
        f"{name} uses {other}"
        for name, used in known.items()
        for other in used
        if layers.index(other) > layers.index(name)
    ]
    return sorted(found)


def test_the_check_of_rust_imports_finds_faults(tmp_path: Path) -> None:
    files = {
        "lib.rs": "mod low;\nmod high;\nmod lost;\npub use high::High;\n",
        "low/mod.rs": "mod a;\npub mod b;\nmod c;\npub use a::{A, Other};\nuse c::C;\n",
        "low/a.rs": "use super::c::{self, C as D};\nuse crate::{High, low::b};\n",
        "low/b.rs": "// use crate::high;\n/* /* */ use crate::high; */\nuse super::A;\nconst C: char = '\"';\n"
        'const S: &str = "use crate::high; //"; const R: &str = r#"" crate::high"#; fn f<\'a>(x: &\'a u8) {}\n',
        "low/c.rs": "fn f() { let x = super::b::B; }\nmod tests {\n    use super::*;\n    use super::super::Low;\n"
        "    mod deep { use super::super::C; }\n}\n",
        "high.rs": "use crate::low::{b::{B, X}, A};\n",
        "lost.rs": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    sources = RustSources(tmp_path)
    a, b, c, high = ("low", "a"), ("low", "b"), ("low", "c"), ("high",)
    assert sources.imports() == {(a, c), (a, high), (a, b), (b, a), (c, b), (c, ("low",)), (high, a), (high, b)}
    cycle, *others = rust_faults(sources, ["low", "high"])
    assert cycle.startswith("cycle in crate: ")
    assert others[0].startswith("cycle in crate::low: ")
    assert others[1:] == ["lost is in no layer", "low uses high"]


def test_rust_imports_run_one_way() -> None:
    core, python = RustSources(NATIVE / "core" / "src"), RustSources(NATIVE / "python" / "src")
    assert len(core.imports()) > 100
    assert rust_faults(core, LAYERS) == []
    modules = ["plain", "affine", "path", "shape", "texture", "object", "scene", "scan", "waveforms", "many", "cloud"]
    modules += ["coverage", "patterns"]
    assert rust_faults(python, modules) == []
    assert not any({"pyo3", "numpy"} & set(tokens) for tokens in core.sources.values())


def native_files(page: str) -> list[str]:
    """Rust files and folders that the page about the core names: paths in code, and the names of its layout."""
    named = re.findall(r"`([\w/]+\.rs)`", page)
    (layout,) = re.findall(r"^```\n(python/src.*?)^```$", page, re.DOTALL | re.MULTILINE)
    folder = ""
    for line in layout.splitlines():
        head, names = re.match(r"(\S+|  \S+)? +(\S.*?)(?:   |$)", line).groups() if " " in line else (line, "")
        if head and not set(head) <= {"─"}:
            folder = head.strip() if not head.startswith(" ") else f"core/src/{head.strip().strip('/')}"
        named += [f"{folder}/{name}".replace("/./", "/") for name in re.findall(r"\w+/?", names)]
    return named


def missing_files(page: str, native: Path) -> list[str]:
    """Those of the files that a page names that do not exist; a name may leave out leading folders."""
    there = {"/" + path.relative_to(native).as_posix() for path in native.rglob("*") if "target" not in path.parts}
    there |= {path.removesuffix(".rs") for path in there} | {f"{path}/" for path in there}
    return [name for name in native_files(page) if not any(path.endswith(f"/{name}") for path in there)]


def test_the_page_about_the_core_names_all_files_and_no_others() -> None:
    page = (NATIVE / "README.md").read_text(encoding="utf-8")
    assert len(native_files(page)) > 80
    assert missing_files(page, NATIVE) == []
    core = [path for path in (NATIVE / "core/src").rglob("*.rs") if path.stem not in {"mod", "lib", "testing"}]
    named = set(native_files(page))
    folders = tuple(name for name in named if name.endswith("/"))
    files = {path.relative_to(NATIVE).with_suffix("").as_posix() for path in core}
    unnamed = {name for name in files if name not in named and not name.startswith(folders)}
    assert len(files) > 120
    assert unnamed == set()
    odd = page.replace("`shapes/newton.rs`", "`shapes/nowhere.rs`").replace("frame, fire", "frame, water")
    assert set(missing_files(odd, NATIVE)) == {"shapes/nowhere.rs", "core/src/measure/water"}


def test_the_page_about_the_package_draws_all_rooms() -> None:
    """In the order of the layers that `lint-imports` holds, above the core."""
    (drawing,) = re.findall(
        r"^```\n(.*?)^```$", (ROOT / "lidarsim/README.md").read_text("utf-8"), re.DOTALL | re.MULTILINE
    )
    drawn = re.findall(r"^(\w+)(/?) ", drawing, re.MULTILINE)
    (layers,) = [
        contract["layers"]
        for contract in tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
        if contract["id"] == "layers"
    ]
    assert ["__main__", *(name for name, _ in drawn)] == [*re.findall(r"\w+", " ".join(layers)), "_native"]
    folders = {path.parent.name for path in (ROOT / "lidarsim").glob("*/__init__.py")}
    assert {name for name, folder in drawn if folder} == folders


def test_lines_of_the_core_are_short() -> None:
    width = tomllib.loads((NATIVE / "rustfmt.toml").read_text(encoding="utf-8"))["max_width"]
    assert width == 110
    sources = {
        path: path.read_text(encoding="utf-8")
        for folder in ("core", "python")
        for path in (NATIVE / folder).rglob("*.rs")
    }
    assert len(sources) > 80
    assert [
        f"{path.relative_to(NATIVE)}:{number}"
        for path, source in sources.items()
        for number, line in enumerate(source.splitlines(), 1)
        if len(line) > width
    ] == []


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    native = tomllib.loads((NATIVE / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]
    assert lidarsim.__version__ == importlib.metadata.version("lidarsim") == project["version"] == native["version"]


def test_top_level_holds_the_four_folders_alone() -> None:
    ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()}
    folders = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")}
    assert folders - ignored - {"__pycache__"} == {"lidarsim", "tests", "configs", "examples"}


def test_tests_mirror_the_package() -> None:
    tests, package = ROOT / "tests", ROOT / "lidarsim"
    folders = {path.parent.relative_to(tests) for path in tests.rglob("test_*.py")}
    assert {str(folder) for folder in folders if not (package / folder).is_dir()} <= {"conformance", "exact", "hard"}


def test_readme_has_two_set_up_commands() -> None:
    commands = blocks("bash")
    assert len(commands) == 2
    assert "configs/demo.yaml" in commands[0]
    assert "pytest" in commands[1]


@pytest.mark.slow("the README shows what its example draws, and its commands run")
def test_the_readme_shows_what_its_example_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer colours and pixels move the means of blocks by up to 3 of 255; an object that is missing, by tens."""
    monkeypatch.chdir(tmp_path)
    (example,) = blocks("python")
    subprocess.run([sys.executable, "-W", "error", "-c", example], check=True)
    shown, drawn = ROOT / "examples" / "images" / "snippet.png", tmp_path / "scan.png"
    assert f"](examples/images/{shown.name})" in README.split(example)[1].split("\n## ")[0]
    assert pictures.difference(drawn, shown) < 6
    less, count = re.subn(r"^scene\.add.*tank.*\n", "", example, flags=re.MULTILINE)
    assert count == 1
    subprocess.run([sys.executable, "-W", "error", "-c", less], check=True)
    assert pictures.difference(drawn, shown) > 20


@pytest.mark.slow("the README shows what its example draws, and its commands run")
def test_the_commands_that_the_readme_names_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    named = [shlex.split(text) for text in re.findall(r"`(lidarsim [^`]+)`", README)]
    assert {words[1] for words in named} == {"scan", "new"}
    for words in named:
        subprocess.run([sys.executable, "-m", *words], check=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["FOLDER", "street.pcd"]


def test_the_readme_lists_every_page() -> None:
    pages = {page.name for page in (ROOT / "examples").glob("*.md")} - {"README.md"}
    assert set(re.findall(r"\]\(examples/(\w+\.md)\)", README)) == pages


def test_the_readme_lists_every_command() -> None:
    (block,) = re.findall(r"^## Command line\n\n((?:    .*\n)+)", README, re.MULTILINE)
    listed = re.findall(r"^    lidarsim (\w+)", block, re.MULTILINE)
    assert sorted(listed) == sorted(command.name or command.callback.__name__ for command in app.registered_commands)


def test_the_readme_is_a_front_page() -> None:
    assert len(README.split()) <= 900


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings}


def dead_links(page: Path) -> list[str]:
    """Links of a page to files that are not there, or to headings that their pages do not have."""
    dead = []
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", page.read_text(encoding="utf-8")):
        name, _, anchor = link.partition("#")
        there = page.parent / name if name else page
        if not there.exists() or (anchor and anchor not in anchors(there)):
            dead.append(link)
    return dead


WRITTEN = ["*.md", ".github/*.md", "configs/*.md", "examples/*.md", "lidarsim/*.md", "lidarsim/*/*.md"]
PAGES = [page for pattern in WRITTEN for page in sorted(ROOT.glob(pattern))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    assert dead_links(page) == []


def test_dead_links_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A b?\n[1](#a-b) [2](page.md#a-b) [3](#b) [4](page.md#b) [5](other.md)", encoding="utf-8")
    assert dead_links(page) == ["#b", "page.md#b", "other.md"]
