"""Poses of nuScenes: those of the ego vehicle in a scene, from the tables of a version.

``ego_pose.json`` has a pose per sample data, with a timestamp in µs. Those of a scene are found through ``scene.json``,
``sample.json`` and ``sample_data.json`` beside it. The tables of the full data set have millions of rows, so they are
read row by row, and only what is needed is kept.

Format: https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from lidarsim._base.files import check_regular
from lidarsim._base.validation import Floats, short_repr
from lidarsim.errors import FileFormatError
from lidarsim.io.trajectories._quaternions import poses_of
from lidarsim.motion.formats import register_trajectory_tables

TABLES = "scene.json", "sample.json", "sample_data.json", "ego_pose.json"
CHUNK = 1 << 20
"""Characters read at a time, and the most of a row."""
MOST_ROWS = 100_000_000
MOST_POSES = 10_000_000
"""Most rows of a table, and most poses of a scene; the full data set has 2.6 million of all scenes."""
NAMES = {str: "a string", int: "an integer", list: "a list"}
MOST_SHOWN = 5
"""Scenes that an error names."""


def recognise(path: Path) -> bool:
    """Return whether a path is that of a table of poses."""
    return path.name == TABLES[-1]


def read(path: Path, scene: str | None) -> tuple[Floats, Floats]:
    """Return the times since the first pose, s, shape (n,), and the poses of a scene, shape (n, 4, 4)."""
    scenes, samples, data, poses = (path.with_name(name) for name in TABLES)
    token = _scene(scenes, scene)
    of_scene = {row["token"] for row in _rows(samples, token=str, scene_token=str) if row["scene_token"] == token}
    keys = {"sample_token": str, "ego_pose_token": str}
    wanted = {row["ego_pose_token"] for row in _rows(data, **keys) if row["sample_token"] in of_scene}
    if not wanted:
        named = "" if scene is None else short_repr(scene)
        raise FileFormatError(f"{data}: expected data of the scene {named}, got none")
    if len(wanted) > MOST_POSES:
        raise FileFormatError(f"{data}: expected at most {MOST_POSES:,} poses of a scene, got {len(wanted):,}")
    found: dict[int, list[float]] = {}
    for row in _rows(poses, token=str, timestamp=int, translation=list, rotation=list):
        if row["token"] in wanted:
            wanted.remove(row["token"])
            w, x, y, z = _numbers(row, "rotation", 4, poses)
            where = _numbers(row, "translation", 3, poses)
            found.setdefault(row["timestamp"], [*where, x, y, z, w])  # sensors that fire at once have the same pose
    if wanted:
        more = f" and {len(wanted) - 1} more" if len(wanted) > 1 else ""
        got = f"got none of token {short_repr(min(wanted))}{more}"
        raise FileFormatError(f"{poses}: expected the poses of all sample data, {got}")
    times = sorted(found)
    try:
        return poses_of([(time - times[0]) / 1e6, *found[time]] for time in times)
    except ValueError as error:
        raise FileFormatError(f"{poses}: {error}") from None


def _scene(path: Path, name: str | None) -> str:
    """Return the token of a scene, by its name; the only one's if no name is given."""
    tokens: dict[str, str] = {row["name"]: row["token"] for row in _rows(path, token=str, name=str)}
    if name is None and len(tokens) == 1:
        return next(iter(tokens.values()))
    if name is None or name not in tokens:
        some = ", ".join(map(short_repr, sorted(tokens)[:MOST_SHOWN])) + (", …" if len(tokens) > MOST_SHOWN else "")
        got = "none" if name is None else short_repr(name)
        raise FileFormatError(f"{path}: expected the name of a scene, of {some or 'none'}, got {got}")
    return tokens[name]


def _numbers(row: dict[str, Any], key: str, count: int, path: Path) -> list[float]:
    values = row[key]
    if len(values) != count or not all(type(value) in {int, float} and np.isfinite(value) for value in values):
        raise FileFormatError(
            f"{path}: row {short_repr(row['token'])}: {key}: expected {count} finite numbers, got others"
        )
    return [float(value) for value in values]


def _rows(path: Path, **kinds: type) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table after checking that they have keys of these types."""
    number = 0
    try:
        check_regular(path)
        with path.open(encoding="utf-8", errors="replace") as file:
            for row in _Table(file):
                number += 1
                _check(row, kinds, number)
                yield row
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read the file: {error.strerror}") from None
    except RecursionError:
        raise FileFormatError(f"{path}: row {number + 1}: expected a table, got values nested too deeply") from None
    except FileFormatError:
        raise
    except ValueError as error:
        raise FileFormatError(f"{path}: row {max(number, 1)}: {error}") from None


def _check(row: dict[str, Any], kinds: dict[str, type], number: int) -> None:
    if number > MOST_ROWS:
        raise ValueError(f"expected at most {MOST_ROWS:,} rows, got more")
    for key, kind in kinds.items():
        if type(row.get(key)) is not kind:
            raise ValueError(f"{key}: expected {NAMES[kind]}, got {'something else' if key in row else 'none'}")
    if "timestamp" in kinds and not abs(row["timestamp"]) < 2**63:
        raise ValueError(f"expected a timestamp of 64 bits, got {short_repr(row['timestamp'])}")


class _Table:
    """A list of objects in JSON, of which two chunks are in memory."""

    def __init__(self, file: TextIO) -> None:
        self.file = file
        self.text = ""
        self.at = 0
        self.decoder = json.JSONDecoder()

    def __iter__(self) -> Iterator[dict[str, Any]]:
        self.take("[")
        if self.next() == "]":
            return
        while True:
            if self.next() != "{":
                raise ValueError("expected an object in JSON, got something else")
            yield self.row()
            if self.take(",]") == "]":
                return

    def next(self) -> str:
        """Return the next character that is no space; empty at the end."""
        while True:
            while self.at < len(self.text) and self.text[self.at] in " \t\r\n":
                self.at += 1
            if self.at < len(self.text):
                return self.text[self.at]
            self.text, self.at = self.file.read(CHUNK), 0
            if not self.text:
                return ""

    def take(self, expected: str) -> str:
        """Return the next character after checking that it is one of those expected."""
        found = self.next()
        if not found or found not in expected:
            raise ValueError(
                f"expected {' or '.join(expected)} in JSON, got {short_repr(found) if found else 'the end'}"
            )
        self.at += 1
        return found

    def row(self) -> dict[str, Any]:
        """Return the object that begins here."""
        if len(self.text) - self.at < CHUNK:
            self.text, self.at = self.text[self.at :] + self.file.read(CHUNK), 0
        try:
            value, self.at = self.decoder.raw_decode(self.text, self.at)
        except json.JSONDecodeError:
            raise ValueError(f"expected an object in JSON of at most {CHUNK:,} characters, got others") from None
        row: dict[str, Any] = value
        return row


register_trajectory_tables("nuScenes", recognise, read)
