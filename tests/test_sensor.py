"""Sensors: arguments, presets and files."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim import lidar
from lidarsim.errors import FileFormatError
from lidarsim.world import scene

PATTERN = ls.patterns.Spinning([0.0, 0.1], columns=8)


def test_defaults_limit_and_add_nothing() -> None:
    lidar = ls.Lidar(PATTERN)
    assert lidar.pattern is PATTERN
    assert (lidar.min_range, lidar.max_range, lidar.name, lidar.measurement) == (0.0, math.inf, "", ls.Measurement())


def test_range_offset_is_a_number_or_one_a_ring() -> None:
    assert ls.Lidar(PATTERN, range_offset=1).range_offset == 1.0
    each = ls.Lidar(PATTERN, range_offset=np.array([0.012, 0.028]))
    assert each.range_offset == (0.012, 0.028)
    assert each == ls.Lidar(PATTERN, range_offset=[0.012, 0.028])


@pytest.mark.parametrize("name", ["range_offset", "range_bias"])
def test_rings_without_a_number_are_named(name: str) -> None:
    class MoreRings:
        rate = 5.0
        shape = (2, 8)

        def pulses(self, frame: int = 0) -> ls.patterns.Pulses:
            pulses = PATTERN.pulses(frame)
            return dataclasses.replace(pulses, ring=pulses.ring + np.uint16(1))

    biased = ls.Measurement(range_bias=(0.1, 0.2) if name == "range_bias" else 0.0)
    lidar = ls.Lidar(MoreRings(), measurement=biased, range_offset=(0.1, 0.2) if name == "range_offset" else 0.0)
    message = f"{name}: expected a number for each ring of the pulses, got 2 of them and pulses.ring[1] = 2"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        lidar.scan(ls.Scene())


def test_lidar_is_frozen_and_varied_by_replace() -> None:
    lidar = ls.Lidar(PATTERN, max_range=50.0, name="front")
    with pytest.raises(dataclasses.FrozenInstanceError):
        lidar.max_range = 60.0  # type: ignore[misc]
    with pytest.raises(dataclasses.FrozenInstanceError):
        lidar.max_rnge = 60.0  # type: ignore[attr-defined]
    far = dataclasses.replace(lidar, max_range=60.0)
    assert (far.max_range, far.name, lidar.max_range) == (60.0, "front", 50.0)


def test_own_pattern_needs_no_base_class() -> None:
    class Single:
        rate = 5.0
        shape = (1, 1)

        def pulses(self, frame: int = 0) -> ls.patterns.Pulses:
            return ls.patterns.Table([[1, 0, 0]], rate=self.rate).pulses()

    assert len(ls.Lidar(Single()).pattern.pulses()) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"pattern": None}, "pattern: expected a scan pattern (rate, shape, pulses), got None"),
        ({"measurement": 0.1}, "measurement: expected a Measurement, got 0.1"),
        ({"min_range": -1.0}, "min_range: expected a finite number >= 0, got -1.0"),
        ({"min_range": 2.0, "max_range": 1.0}, "max_range: expected a real number >= 2, got 1.0"),
        ({"max_range": math.nan}, "max_range: expected a real number >= 0, got nan"),
        ({"name": 3}, "name: expected a text, got 3"),
        ({"name": "\udc00"}, r"name: expected text that UTF-8 can encode, got '\udc00'"),
        ({"model": 3}, "model: expected a string, got 3"),
        ({"range_offset": math.inf}, "range_offset: expected a finite number, got inf"),
        ({"range_offset": "12 mm"}, "range_offset: expected a finite number, got '12 mm'"),
        ({"range_offset": [0.1]}, "range_offset: expected one number, or one per ring (2), got 1"),
        (
            {"measurement": ls.Measurement(range_bias=(0.1, 0.2, 0.3))},
            "range_bias: expected one number, or one per ring (2), got 3",
        ),
        ({"range_offset": [[0.1], [0.2]]}, "range_offset: expected shape (rings,), got (2, 1)"),
        ({"range_offset": (0.1, math.nan)}, "range_offset: expected finite numbers, got range_offset[1] = nan"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{re.escape(message)}$"):
        ls.Lidar(**{"pattern": PATTERN, **arguments})


def test_scan_measures_the_distance_along_each_pulse() -> None:
    scene = ls.Scene()
    scene.add(ls.Sphere((0.0, 0.0, 0.0), 5.0))
    scan = ls.Lidar(PATTERN).scan(scene, frame=3, seed=7)
    np.testing.assert_allclose(scan.range[:, 0], 5.0, rtol=4 * 2.0**-53)
    assert (len(scan.range), scan.frame) == (16, 3)


def test_presets_are_listed_by_name() -> None:
    names = ls.Lidar.presets()
    assert names == sorted(names)
    assert len(names) >= 25
    assert {"velodyne-vlp16", "ouster-os1-128", "livox-mid360"} <= set(names)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("vlp16", "preset: expected the name of a sensor, got 'vlp16'; did you mean velodyne-vlp16?"),
        ("os1", "preset: expected the name of a sensor, got 'os1'; did you mean ouster-os1-128 or ouster-os1-64?"),
        (
            "velodine-hdl64",
            (
                "preset: expected the name of a sensor, got 'velodine-hdl64'; "
                "did you mean velodyne-hdl64e-s3 or velodyne-hdl64e-s2 or velodyne-hdl32e?"
            ),
        ),
    ],
)
def test_unknown_preset_suggests_the_nearest(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Lidar.preset(name)


def test_unknown_preset_unlike_any_lists_all() -> None:
    with pytest.raises(
        ValueError,
        match=r"^preset: expected the name of a sensor, got ''; there are faro-focus-s150, .*velodyne-vls128$",
    ):
        ls.Lidar.preset("")


def test_own_yaml_is_a_sensor(tmp_path: Path) -> None:
    path = tmp_path / "front.yaml"
    path.write_text("preset: ouster-os1-128\nname: front\npattern: {columns: 512}\nmax_range_m: 60\n")
    lidar = ls.Lidar.from_file(path)
    assert (lidar.name, lidar.max_range, lidar.pattern.shape) == ("front", 60.0, (128, 512))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read the file: No such file or directory"),
        (
            b"{}",
            (
                "expected a file of one of these kinds: Hesai angle correction CSV, Hesai angle correction DAT, "
                "Hesai firetime correction CSV, Livox scan pattern CSV, Ouster metadata JSON, RoboSense angle CSV, "
                "Velodyne calibration YAML, lidarsim YAML"
            ),
        ),
    ],
)
def test_foreign_file_is_named(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "sensor.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}: {message}')}$"):
        ls.Lidar.from_file(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("# mine\nmin_range_m: 1\n", "2: expected one of the keys preset, file, pattern, got none of them"),
        ("\tpattern:\n", "1: not valid YAML: found character '\\t' that cannot start any token"),
        ("{pattern: {type: spinning}}\n", "1: pattern: missing key 'elevations_deg'"),
    ],
)
def test_yaml_of_no_vendor_is_our_own(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(content)
    with pytest.raises(ls.errors.ConfigError, match=f"^{re.escape(f'{path}:{message}')}$"):
        ls.Lidar.from_file(path)


def test_reader_is_one_registration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lidar, "_readers", dict(lidar._readers))
    given: list[object] = []

    def read(path: Path, *, gain: float = 1.0) -> ls.Lidar:
        given.extend([path, gain])
        return ls.Lidar(PATTERN, name="mine")

    lidar.register_lidar_reader("my format", lambda path, text: path.suffix == ".bin" and text == "MINE\ufffd", read)
    path = tmp_path / "a.bin"
    path.write_bytes(b"\xef\xbb\xbfMINE\xff")
    assert ls.Lidar.from_file(str(path), gain=2.0).name == "mine"
    assert given == [path, 2.0]


@pytest.mark.parametrize(
    ("module", "register", "load"),
    [(lidar, ls.register_lidar_reader, ls.Lidar), (scene, ls.register_scene_reader, ls.Scene)],
    ids=["Lidar", "Scene"],
)
def test_a_reader_that_returns_nothing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Any, register: Any, load: Any
) -> None:
    monkeypatch.setattr(module, "_readers", dict(module._readers))
    register("mine", lambda path, _: path.suffix == ".mine", lambda _: None)
    (tmp_path / "a.mine").write_bytes(b"")
    with pytest.raises(TypeError, match=f"^reader 'mine': expected a {load.__name__}, got None$"):
        load.from_file(tmp_path / "a.mine")


def test_a_reader_may_take_any_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[object] = []

    def read(file: Path, **options: object) -> ls.Scene:
        given.extend([file.name, options])
        return ls.Scene()

    monkeypatch.setattr(scene, "_readers", dict(scene._readers))
    ls.register_scene_reader("mine", lambda path, _: path.suffix == ".mine", read)
    (tmp_path / "a.mine").write_bytes(b"")
    ls.Scene.from_file(tmp_path / "a.mine", up="y", unit=0.01)
    assert given == ["a.mine", {"up": "y", "unit": 0.01}]


def test_the_first_argument_of_a_reader_is_no_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lidar, "_readers", dict(lidar._readers))

    def read(file: Path, *, gain: float = 1.0) -> ls.Lidar:
        return ls.Lidar(PATTERN, name=f"{file.stem} {gain}")

    ls.register_lidar_reader("mine", lambda path, _: path.suffix == ".mine", read)
    (tmp_path / "a.mine").write_bytes(b"")
    assert ls.Lidar.from_file(tmp_path / "a.mine", gain=2.0).name == "a 2.0"
    with pytest.raises(TypeError, match=r"^file: expected none, since mine has gain as options, got 3$"):
        ls.Lidar.from_file(tmp_path / "a.mine", file=3)


def test_a_preset_at_another_rate() -> None:
    lidar, faster = ls.Lidar.preset("livox-mid360"), ls.Lidar.preset("livox-mid360", rate=20)
    assert (lidar.pattern.rate, faster.pattern.rate, faster.pattern.shape) == (10.0, 20.0, (4, 2500))
    assert faster == dataclasses.replace(lidar, pattern=ls.patterns.Mid360(rate=20.0))
    for name in ls.Lidar.presets():
        # A mirror of a terrestrial scanner takes seconds for the lines of a dome.
        rate = 5.0 if ls.Lidar.preset(name).pattern.rate > 1.0 else 0.1
        assert ls.Lidar.preset(name, rate=rate).pattern.rate == rate
    with pytest.raises(ValueError, match=r"rate: expected a finite number > 0, got 0\.0"):
        ls.Lidar.preset("ouster-os1-64", rate=0.0)
