"""Options and profiles: fast tests by default, slow ones with ``-m slow``, all with more cases with ``--slow``."""

from __future__ import annotations

import os
import signal
import sys
from collections import Counter
from pathlib import Path

import hypothesis
import pytest

sys.path.append(str(Path(__file__).parent))  # for helpers such as conformance.samples

hypothesis.settings.register_profile("fast", max_examples=40, deadline=None, derandomize=True)
hypothesis.settings.register_profile("slow", max_examples=5000, deadline=None, print_blob=True)

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes would compile the package anew
os.environ.pop("COLUMNS", None)  # readline sets it for the processes of pytest-xdist, and tables would follow it


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="many more random cases (also LIDARSIM_SLOW=1)")


def pytest_configure(config: pytest.Config) -> None:
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        # A shell leaves Ctrl-C ignored in what it runs in the background, and processes pass that on.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.slow = config.getoption("--slow") or os.environ.get("LIDARSIM_SLOW", "0") not in {"", "0"}
    hypothesis.settings.load_profile("slow" if config.slow else "fast")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out tests marked as slow, unless ``-m`` or ``--slow`` is given."""
    marked = {item: marker for item in items if (marker := item.get_closest_marker("slow"))}
    if unexplained := [item.nodeid for item, marker in marked.items() if not marker.args]:
        raise pytest.UsageError(f"slow: expected what the test guards, got none at {unexplained[0]}")
    if not config.slow and not config.option.markexpr:
        config.hook.pytest_deselected(items=list(marked))
        items[:] = [item for item in items if item not in marked]


def available(isa: str) -> bool:
    """Whether this machine has an instruction set."""
    from lidarsim import _native

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIDARSIM_ISA", isa)
        try:
            return _native.isa() == isa
        except ValueError:
            return False


@pytest.fixture(scope="session")
def instruction_sets() -> list[str]:
    """Those that the core has code for and this machine has."""
    return [isa for isa in ("scalar", "avx2", "avx512") if available(isa)]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many of the tests that are run with each instruction set passed with which."""
    passed = [dict(report.user_properties).get("isa") for report in terminalreporter.stats.get("passed", [])]
    counts = Counter(isa for isa in passed if isa)
    if counts:
        terminalreporter.line("instruction sets: " + ", ".join(f"{isa} {n} passed" for isa, n in counts.items()))


@pytest.fixture(scope="session")
def slow(request: pytest.FixtureRequest) -> bool:
    """Whether the thorough run was asked for."""
    return request.config.slow
