"""Errors of arguments are objects: what a caller shows of them is not cut out of their text."""

import copy
import inspect
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import ArgumentError, ArgumentTypeError, ArgumentValueError, LidarsimError

PACKAGE = Path(ls.__file__).parent

REFUSED = {
    "a number": (lambda: ls.Sphere((0, 0, 0), -1.0), ("radius", "a finite number > 0", "-1.0", "")),
    "a shape of the core": (
        lambda: ls.Cylinder((0, 0, 0), (0, 0, 0), 1.0),
        ("end", "a point other than start", "(0.0, 0.0, 0.0) for both", ""),
    ),
    "a ray": (
        lambda: ls.Scene().cast([[0, 0, 0]], [[0, 0, 0]]),
        ("directions", "non-zero vectors", "directions[0] = (0, 0, 0)", ""),
    ),
    "degrees": (
        lambda: ls.patterns.Grid(azimuths=[45.0], elevations=[0.0], rate=10.0),
        ("azimuths", "numbers from -6.28319 to 6.28319", "azimuths[0] = 45", "degrees?"),
    ),
    "milliradians": (
        lambda: ls.Beam(0.5),
        ("divergence_azimuth", "a finite number from 0 to 0.1", "0.5", "mrad?"),
    ),
    "milliradians of the elevation": (
        lambda: ls.Beam(1e-3, 3.0),
        ("divergence_elevation", "a finite number from 0 to 0.1", "3.0", "mrad?"),
    ),
    "a negative divergence": (
        lambda: ls.Beam(-0.001),
        ("divergence_azimuth", "a finite number from 0 to 0.1", "-0.001", ""),
    ),
    "an integer beyond float64": (
        lambda: ls.Beam(10**400),
        ("divergence_azimuth", "a finite number from 0 to 0.1", "a number beyond float64", ""),
    ),
    "a shape of an array": (
        lambda: ls.Scene().cast([0, 0, 0], [[1, 0, 0]]),
        ("origins", "shape (n, 3)", "(3,)", "of one, [[x, y, z]]"),
    ),
    "a file name": (
        lambda: ls.Lidar.preset("velodine-vlp16"),
        ("preset", "the name of a sensor", "'velodine-vlp16'", None),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_error_of_an_argument_holds_its_parts(case):
    call, (argument, expected, got, hint) = REFUSED[case]
    with pytest.raises(ArgumentValueError) as caught:
        call()
    error = caught.value
    assert (error.argument, error.expected, error.got) == (argument, expected, got)
    assert error.hint == hint if hint is not None else error.hint.startswith("did you mean velodyne-vlp16")
    text = f"{argument}: expected {expected}, got {got}"
    assert str(error) == (f"{text}; {error.hint}" if error.hint else text)
    assert f"{argument}: {error.problem}" == text


def test_the_greatest_divergence_of_a_beam_is_allowed():
    assert ls.Beam(0.1).divergence_elevation == 0.1
    with pytest.raises(ArgumentValueError):
        ls.Beam(np.nextafter(0.1, 1.0))


def test_errors_of_arguments_are_the_built_in_ones_too():
    with pytest.raises(ValueError, match="radius"):
        ls.Sphere((0, 0, 0), 0.0)
    with pytest.raises(TypeError, match="radius") as caught:
        ls.Sphere((0, 0, 0), "1")
    assert isinstance(caught.value, ArgumentTypeError)
    assert isinstance(caught.value, LidarsimError)
    assert not isinstance(caught.value, ValueError)


@pytest.mark.parametrize("kind", [ArgumentError, ArgumentTypeError, ArgumentValueError])
def test_errors_of_arguments_survive_copies_and_pickles(kind):
    error = kind("n", "a number", 3, "two?")
    for again in (copy.copy(error), copy.deepcopy(error), pickle.loads(pickle.dumps(error))):  # noqa: S301
        assert type(again) is kind
        assert (again.argument, again.expected, again.got, again.hint) == ("n", "a number", "3", "two?")
        assert str(again) == "n: expected a number, got 3; two?"


def test_no_argument_is_named_in_the_text_of_a_built_in_error():
    named = re.compile(
        r"""raise (?:ValueError|TypeError)\(\s*f?"(?:[a-z_]+|{name}|{argument}): expected [^\n]*, got """
    )
    sources = {path: path.read_text("utf-8") for path in PACKAGE.rglob("*.py")}
    assert sum(source.count("raise Argument") for source in sources.values()) > 150
    found = {path.name: matches for path, source in sources.items() if (matches := named.findall(source))}
    assert set(found) == {"exact.py"}  # which shares no code with what it judges


def test_a_configuration_names_the_key_and_its_unit(tmp_path):
    config = tmp_path / "run.yaml"
    config.write_text(
        "scene:\n  - {shape: plane, normal: [0, 0, 1], distance_m: 0}\n"
        "sensor:\n  preset: velodyne-vlp16\n  measurement:\n    beam: {divergence_azimuth_mrad: 500}\n"
    )
    with pytest.raises(ls.errors.ConfigError) as caught:
        ls.config.load(config)
    assert str(caught.value) == (
        f"{config}:6: sensor.measurement.beam.divergence_azimuth_mrad: "
        "expected a finite number from 0 to 0.1, got 0.5 (in rad)"
    )
    assert isinstance(caught.value.__cause__, ArgumentValueError)
    assert inspect.signature(ls.Beam).parameters["divergence_azimuth"].name == caught.value.__cause__.argument
