from __future__ import annotations

from collections.abc import Iterator

import pytest

from lidarsim.bench import peers


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    with peers.threads_kept():
        yield
