"""Make a data set on a Dask cluster, here of two processes on this machine; any other cluster works the same way.

Needs `pip install "lidarsim[cluster]"`. On a real cluster, the client connects to its scheduler, `Client("tcp://…")`,
and recipe and output are on storage that all workers see, such as s3://bucket/folder. The work of killed workers is
done again, and the same call resumes after a crash.
"""

from __future__ import annotations

from pathlib import Path

from distributed import Client, LocalCluster

import lidarsim as ls

SMALL = {"sequences": 2, "frames": 1, "shard_frames": 1, "pictures": 0}


def checksums(folder: str) -> list[str]:
    """Return the lines of a manifest: a file each, with its SHA-256."""
    return sorted(Path(folder, "manifest.jsonl").read_text(encoding="utf-8").splitlines())


if __name__ == "__main__":  # workers import this file
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        made = ls.generate("detection", "from_cluster", client=client, **SMALL)
    print(f"{made.frames} frames, {made.points:,} points in {made.seconds:.1f} s from two workers")

    ls.generate("detection", "from_here", **SMALL)
    same = checksums("from_cluster") == checksums("from_here")
    print(f"the files are the same to the last bit as those of one process: {same}")
