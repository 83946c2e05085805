"""Script that casts on request with the build of lidarsim on the path, so that any build can be measured.

Its argument is a file of pickled casts; see `lidarsim.bench.against`. Each line of its input is the number of a cast.
The answer to the first request for a cast is the hash of its hits; to each further request, its duration, s.
"""

from __future__ import annotations

import hashlib
import pickle
import sys
import time
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import lidarsim as ls


def _call(objects: list[tuple[str, tuple[Any, ...], Any]], rays: tuple[Any, Any]) -> Callable[[], ls.Hits]:
    scene, shared = ls.Scene(), {}
    for kind, arguments, transform in objects:
        key = (kind, *map(id, arguments))  # instances share one mesh
        if key not in shared:
            shared[key] = attrgetter(kind)(ls)(*arguments)
        scene.add(shared[key], transform=transform)
    return partial(scene.cast, *rays)


def main(path: str) -> None:
    """Answer requests until the end of the input."""
    casts = pickle.loads(Path(path).read_bytes())  # noqa: S301 - the parent process wrote it
    current, call = -1, None  # only the current scene is kept
    for line in sys.stdin:
        number = int(line)
        if call is not None and number == current:
            begin = time.perf_counter()
            call()
            answer = repr(time.perf_counter() - begin)
        else:
            current, call = number, _call(*casts[number])
            hits = call()
            parts = (hits.t, hits.object_id, hits.primitive_id, hits.normal)
            answer = hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()
        print(answer, flush=True)  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1])
