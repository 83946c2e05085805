"""Python in a process of its own, which may crash, hang or run out of memory without the tests."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Mapping

PREAMBLE = """
import concurrent.futures, multiprocessing, os, signal, sys, threading, time
import numpy as np
import lidarsim as ls

def field(n):
    x, y = np.meshgrid(np.arange(float(n)), np.arange(float(n)))
    return ls.TriangleMesh.from_heightfield(np.sin(x) * np.cos(y), 1.0)

def rays(n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-5, 5, (n, 3)), rng.normal(size=(n, 3))
"""


def start(code: str, *arguments: str, environment: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
    """Start Python on `code`."""
    command = [sys.executable, "-W", "ignore::DeprecationWarning", "-c", code, *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, env={**os.environ, **(environment or {})}, **streams)


def output(
    code: str, *arguments: str, setup: str = "", environment: Mapping[str, str] | None = None, timeout: float = 60.0
) -> str:
    """Return what `code` prints, which may use what `PREAMBLE` and `setup` define, if it ends well and in time."""
    with start(PREAMBLE + setup + textwrap.dedent(code), *arguments, environment=environment) as child:
        try:
            out, err = child.communicate(timeout=timeout)
        finally:
            child.kill()
    assert child.returncode == 0, f"exit code {child.returncode}: {err}"
    return out.strip()
