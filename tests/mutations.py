"""Weaken the bounds of the core one by one, and say which tests notice.

Run by hand, from anywhere: ``python tests/mutations.py [--only WORDS] [--target DIR]``. It takes about half a minute a
mutant, and leaves the working tree as it is: the core is copied to a temporary folder, patched there and built without
optimisation.

A mutant replaces a text of the core's sources, in whichever of them it is; that it is there exactly once is checked for
all of them first. The unit tests of the core are asked, and for mutants that concern whole casts, where these do not
notice, tests of the Python package with the patched core. The exit code is 1 if there is a mutant that no test notices.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
CORE = Path("lidarsim", "native")
# Dependencies are optimised, as they are built only once: among them the exact arithmetic that the tests compare with.
CARGO = ["cargo", "--config", 'profile.test.package."*".opt-level=2', "--config", "profile.test.debug=0"]


@dataclass(frozen=True)
class Mutant:
    """A bound, the text that sets it, what takes its place, and which tests of the package are asked besides."""

    name: str
    text: str
    instead: str
    tests: tuple[str, ...] = ()


PACKETS = ("tests/hard/test_packets.py", "-k", "short_rays")
ROUNDING = ("tests/hard/test_cases.py", "-k", "midpoints or small_sphere")

MUTANTS = [
    Mutant("leaf: volumes, rounding 32u", "reach * (32.0 * UNIT * reach +", "reach * (16.0 * UNIT * reach +"),
    Mutant("leaf: volumes, vertices 8ε", "* reach + 8.0 * error), 8.0", "* reach + 4.0 * error), 8.0"),
    Mutant("leaf: volumes, direction 8ε", "error), 8.0 * reach * reach]", "error), 4.0 * reach * reach]"),
    Mutant("leaf: t, vertices 4δ", "moved: 4.0 * (size * off", "moved: 2.0 * (size * off"),
    Mutant("leaf: t, distance 32u", "off + 32.0 * UNIT * square", "off + 16.0 * UNIT * square"),
    Mutant("leaf: t, volumes 256u", "turned: [256.0 * UNIT", "turned: [128.0 * UNIT"),
    Mutant("leaf: t, direction 4ε", "square, 4.0 * size]", "square, 2.0 * size]"),
    Mutant("triple products 320u²", "BOUND: f64 = 320.0 *", "BOUND: f64 = 160.0 *"),
    Mutant("corrected quotient 16u", "ROUNDINGS: f64 = 16.0 *", "ROUNDINGS: f64 = 8.0 *"),
    Mutant("crossing: bounds of t 8u", "high.abs().mul(I::F64x8::splat(8.0", "high.abs().mul(I::F64x8::splat(4.0"),
    Mutant("crossing: normals 2⁻⁶⁰", "BOUND * 2_f64.powi(60)", "BOUND * 2_f64.powi(59)"),
    Mutant("sides: from 2⁻²⁰⁰", "f64::from_bits((1023 - 200) << 52)", "f64::from_bits((1023 - 300) << 52)"),
    Mutant("sides: to 2²⁰⁰", "f64::from_bits((1023 + 200) << 52)", "f64::from_bits((1023 + 400) << 52)"),
    Mutant("double-double sum 4u²", "PLUS: f64 = 4.0 *", "PLUS: f64 = 2.0 *"),
    Mutant("double-double product 5u²", "TIMES: f64 = 5.0 *", "TIMES: f64 = 2.5 *"),
    Mutant("double-double quotient 16u²", "OVER: f64 = 16.0 *", "OVER: f64 = 8.0 *"),
    Mutant("double-double root 4u²", "SQRT: f64 = 4.0 *", "SQRT: f64 = 2.0 *"),
    Mutant(
        "double-double from 2⁻⁸⁰⁰",
        "SMALL: f64 = f64::from_bits((1023 - 800)",
        "SMALL: f64 = f64::from_bits((1023 - 1000)",
    ),
    Mutant("double-double rounding 2u", "low().abs().mul(splat::<L, N>(2.0 *", "low().abs().mul(splat::<L, N>(1.0 *"),
    Mutant(
        "double-double sign 2u",
        "least = self.high.mul(splat::<L, N>(1.0 - 2.0 *",
        "least = self.high.mul(splat::<L, N>(1.0 - 0.0 *",
    ),
    Mutant(
        "double-double proportions 2⁻⁶⁰",
        "largest.mul(splat::<L, N>(UNIT / 128.0))",
        "largest.mul(splat::<L, N>(UNIT / 64.0))",
    ),
    Mutant("running error of a sum", "other.weight) + UNIT) * PAD", "other.weight) + 0.5 * UNIT) * PAD"),
    Mutant("running error of a product", "(v + w + v * w + UNIT)", "(v + w + v * w + 0.5 * UNIT)"),
    Mutant("running error of a quotient 3u", "WEIGHT: f64 = 3.0 *", "WEIGHT: f64 = 1.5 *"),
    Mutant("running error of a root", "size, weight: UNIT, ..self", "size, weight: 0.5 * UNIT, ..self"),
    Mutant("interval 4u", "(splat::<L, N>(4.0 * UNIT))", "(splat::<L, N>(2.0 * UNIT))"),
    Mutant("PAD 16u", "PAD: f64 = 1.0 + 8.0 *", "PAD: f64 = 1.0 + 4.0 *"),
    Mutant("UNDERFLOW 2⁻⁹⁰⁰", "UNDERFLOW: f64 = f64::from_bits((1023 - 900) << 52)", "UNDERFLOW: f64 = 0.0"),
    Mutant("packet: near slopes 12u", "SHRINK: f32 = 1.0 - 12.0 *", "SHRINK: f32 = 1.0 - 6.0 *"),
    Mutant("packet: far slopes 12u", "STRETCH: f32 = 1.0 + 12.0 *", "STRETCH: f32 = 1.0 + 6.0 *"),
    Mutant("packet: origins 4u", "o.abs().mul(I::F32x16::splat(4.0", "o.abs().mul(I::F32x16::splat(2.0"),
    Mutant("packet: directions 4u", "add(d.mul(I::F32x16::splat(4.0", "add(d.mul(I::F32x16::splat(2.0"),
    Mutant("packet: limits 4u", "limit.mul(I::F32x16::splat(1.0 + 4.0", "limit.mul(I::F32x16::splat(1.0 + 2.0"),
    Mutant("packet: limit of one 4u", "as f32 * (1.0 + 4.0 * U)", "as f32 * (1.0 + 2.0 * U)"),
    Mutant("packet: start 4u", "as f32 * (1.0 - 4.0 * U)", "as f32 * (1.0 - 2.0 * U)"),
    Mutant(
        "packet: floor of directions",
        "direction_error.add(I::F32x16::splat(f32::MIN_POSITIVE))",
        "direction_error.add(I::F32x16::splat(0.0))",
    ),
    Mutant(
        "packet: vague in float64",
        "none.lt(low) | none.lt(high) != 0;",
        "zero.lt(I::narrow(low.mul(shrink), high.mul(shrink))) != 0;",
        PACKETS,
    ),
    Mutant("ray: near slopes 4u", "SHRINK: f32 = 1.0 - 4.0 *", "SHRINK: f32 = 1.0 - 2.0 *"),
    Mutant("ray: far slopes 4u", "STRETCH: f32 = 1.0 + 4.0 *", "STRETCH: f32 = 1.0 + 2.0 *"),
    Mutant("boxes rounded down", "(x as f32).next_down()", "(x as f32)"),
    Mutant("boxes rounded up", "(x as f32).next_up()", "(x as f32)"),
    Mutant("grid of a leaf", "(error as f32).next_up()", "(0.5 * error) as f32"),
    Mutant("midpoint below", "Ordering::Less => below,", "Ordering::Less => near,", ROUNDING),
    Mutant("midpoint above", "Ordering::Greater => above,", "Ordering::Greater => near,", ROUNDING),
    Mutant(
        "bits of a root for its normal",
        "longest.unwrap_or(0) + BEYOND",
        "0 * longest.unwrap_or(0) + 2 * BEYOND",
        ROUNDING,
    ),
    Mutant(
        "axis planes: products from 2⁻⁹⁰⁰", "product.abs() > ORDINARY || self.high", "product.abs() > 0.0 || self.high"
    ),
    Mutant("axis planes: quotients from 2⁻⁹⁰⁰", "a.abs() > ORDINARY && quotient", "a.abs() > 0.0 && quotient"),
    Mutant("axis planes: the rest of a sum", "if beyond == 0.0 {", "if beyond == beyond {"),
    Mutant("logarithm, exponential: ln 2", "0x3dea_39ef_3579_3c76", "0x3dea_39ef_3000_0000"),
    Mutant("sine, cosine: π/2", "0x3ba3_198a_2e03_7073", "0x3b83_198a_2e03_7073"),
    Mutant("|d|² − 1", "ROUNDER: f64 = 1.5 * (1_u64 << 26)", "ROUNDER: f64 = 1.5 * (1_u64 << 25)"),
    Mutant("t·|d|", "e * (0.125 - e * 0.0625)", "e * 0.125"),
]


def sources(core: Path) -> list[Path]:
    """Return the Rust sources of the core."""
    return sorted(p for p in core.rglob("*.rs") if "target" not in p.parts)


def place(core: Path, mutant: Mutant) -> Path:
    """Return the source that holds the text of a mutant, exactly once."""
    found = [path for path in sources(core) for _ in range(path.read_text().count(mutant.text))]
    if len(found) != 1:
        sys.exit(
            f"{mutant.name}: expected {mutant.text!r} once in the sources of the core, found it {len(found)} times"
        )
    return found[0]


def module(source: Path) -> str:
    """Return the path of the module that a source is."""
    parts = source.with_suffix("").parts
    return "::".join(part for part in parts[parts.index("src") + 1 :] if part not in {"mod", "lib"})


def unit_tests(core: Path, environment: dict[str, str], within: str = "") -> list[str]:
    """Return the unit tests of the core, of those in a module, that fail."""
    command = [*CARGO, "test", "--lib", "--locked", "--workspace", "--no-fail-fast", within]
    run = subprocess.run(command, cwd=core, env=environment, capture_output=True, text=True, check=False)
    failed = re.findall(r"^test (\S+) \.\.\. FAILED$", run.stdout, re.MULTILINE)
    if run.returncode and not failed:
        sys.exit(f"the core does not build:\n{run.stderr[-4000:]}")
    return failed


def package_tests(copy: Path, arguments: tuple[str, ...], environment: dict[str, str]) -> list[str]:
    """Return the tests of the package that fail with the core of this copy."""
    build = [*CARGO, "build", "--lib", "--locked", "--features", "pyo3/extension-module"]
    subprocess.run(build, cwd=copy / CORE, env=environment, capture_output=True, check=True)
    library = max(Path(environment["CARGO_TARGET_DIR"], "debug").glob("lib*native.so"), key=lambda p: p.stat().st_mtime)
    shutil.copy(library, copy / "lidarsim" / "_native.abi3.so")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    run = subprocess.run(
        command, cwd=copy, env=environment | {"PYTHONPATH": str(copy)}, capture_output=True, text=True, check=False
    )
    return re.findall(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)


def main() -> int:
    """Print a table of mutants and of the tests that notice them."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--only", default="", help="mutants whose names hold this")
    parser.add_argument(
        "--target", default=str(Path(tempfile.gettempdir(), "lidarsim-mutations")), help="folder of builds"
    )
    options = parser.parse_args()
    environment = os.environ | {"CARGO_TARGET_DIR": options.target, "PYO3_PYTHON": sys.executable}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        ignored = shutil.ignore_patterns("target", "*.so", "__pycache__")
        for name in ("lidarsim", "tests"):
            # As new files: cargo takes those older than its last build, which may be of a mutant, for built.
            shutil.copytree(ROOT / name, copy / name, ignore=ignored, copy_function=shutil.copy)
        places = {mutant: place(copy / CORE, mutant) for mutant in MUTANTS}
        chosen = [mutant for mutant in MUTANTS if options.only in mutant.name]
        if failed := unit_tests(copy / CORE, environment):
            sys.exit(f"tests fail as it is: {', '.join(failed)}")
        unnoticed = 0
        print("| mutant | noticed by |\n|---|---|", flush=True)  # noqa: T201
        for mutant in chosen:
            source = places[mutant]
            before = source.read_text()
            source.write_text(before.replace(mutant.text, mutant.instead))
            # Those beside the text first: the others take longer, and most need not be asked.
            failed = unit_tests(copy / CORE, environment, module(source)) or unit_tests(copy / CORE, environment)
            if mutant.tests and not failed:
                failed = package_tests(copy, mutant.tests, environment)
            source.write_text(before)
            unnoticed += not failed
            print(f"| {mutant.name} | {', '.join(failed) or '**no test**'} |", flush=True)  # noqa: T201
    return int(unnoticed > 0)


if __name__ == "__main__":
    sys.exit(main())
