"""No reader is led by a damaged file to anything but a cloud or a clear error, nor to much memory."""

import subprocess
import sys
from pathlib import Path


def test_mutations(slow: bool) -> None:
    count = 20_000 if slow else 150
    command = [sys.executable, str(Path(__file__).with_name("mutations.py")), str(count), "3"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = result.stdout.splitlines()
    assert result.returncode == 0, result.stdout + result.stderr[-2000:]
    assert len(lines) == 19
    for line in lines:
        outcomes = line.split()
        read, refused = (int(outcomes[outcomes.index(word) - 1]) for word in ("read,", "refused,"))
        assert read + refused == count
        assert min(read, refused) > 0, line
