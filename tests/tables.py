"""Measure the errors of each ray caster against the exact answer, and rewrite the tables of `lidarsim/bench/README.md`.

Run by hand: ``python tests/tables.py [out/speed.json]``. It takes minutes, prints the tables on accuracy and writes
them to the page. Given the results of ``lidarsim bench -o out``, it also writes the section on speed and its pictures.
With ``--random N`` it checks lidarsim on N random adversarial rays instead, and writes nothing.

The exit code is 1 if lidarsim makes a wrong decision, leaks or rounds a range wrongly.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from exact import accuracy

from lidarsim._base.files import atomic_writer
from lidarsim.bench import report

PAGE = Path(__file__).parents[1] / "lidarsim" / "bench" / "README.md"
PICTURES = "../../examples/images/"  # from the folder of the page


def replace_section(page: Path, name: str, text: str) -> None:
    """Write what stands between the comments ``<!-- NAME: begin … -->`` and ``<!-- NAME: end -->`` anew."""
    before = page.read_text(encoding="utf-8")
    head, begin, rest = before.partition(f"<!-- {name}: begin")
    opening, close, rest = rest.partition("-->\n")
    _, end, tail = rest.partition(f"<!-- {name}: end -->")
    if not (begin and close and end):
        raise ValueError(f"{page}: expected a section between the comments '{name}: begin' and '{name}: end'")
    with atomic_writer(page) as file:
        file.write(f"{head}{begin}{opening}{close}{text}\n{end}{tail}".encode())


def write_speed(results: report.Results, page: Path) -> None:
    """Write the section on speed, and its pictures."""
    folder = (page.parent / PICTURES).resolve()
    replace_section(page, "speed", report.overview(results, PICTURES))
    folder.mkdir(parents=True, exist_ok=True)
    report.plot_speed(results, folder / "speed.png")
    report.plot_distance(results, folder / "distance.png")


def main(arguments: Sequence[str] | None = None, page: Path = PAGE) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("speed", nargs="?", type=Path, metavar="SPEED_JSON", help="figures of `lidarsim bench`")
    parser.add_argument("--random", type=int, metavar="N", help="judge lidarsim on N random adversarial rays instead")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random rays")
    options = parser.parse_args(arguments)
    if options.random is not None:
        verdicts = accuracy.measure_random(options.random, options.seed, lambda line: print(line, flush=True))  # noqa: T201
        return int(any(verdict.errs for verdict in verdicts.values()))
    table = accuracy.measure()
    table.leaks = accuracy.measure_leaks()
    sys.stdout.write(table.to_markdown())
    replace_section(page, "accuracy", table.to_markdown())
    if options.speed is not None:
        write_speed(json.loads(options.speed.read_text(encoding="utf-8")), page)
    return int(table.errs("lidarsim"))


if __name__ == "__main__":
    sys.exit(main())
