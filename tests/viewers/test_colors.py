"""Colours by a field."""

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lidarsim.bench import report
from lidarsim.comparison import _report
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.viewers._classes import MEANINGS, SEMANTIC_KITTI, class_color
from lidarsim.viewers._colors import (
    BACKGROUND,
    DIVERGING,
    MAPS,
    MISSING,
    QUALITATIVE,
    SEQUENTIAL,
    THEMES,
    Coloring,
    Known,
    coloring,
    legible,
    luminance,
)


def cloud(**fields: object) -> PointCloud:
    return PointCloud({"xyz": np.arange(12.0).reshape(4, 3), **fields})


def rgb_of(points: PointCloud, field: str) -> npt.NDArray[np.uint8]:
    return coloring([points], field).rgb(points)


def test_default_is_intensity_then_height() -> None:
    assert coloring([cloud()], None).title == "height [m]"
    assert coloring([cloud(intensity=[1, 2, 3, 4])], None).title == "intensity"


def test_sequential_colours_run_from_end_to_end() -> None:
    rgb = rgb_of(cloud(range=[0.0, 1.0, 2.0, 3.0]), "range")
    assert bytes(rgb[0]).hex() == SEQUENTIAL[0][1:]
    assert bytes(rgb[3]).hex() == SEQUENTIAL[-1][1:]
    lightness = rgb @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > 0).all()


def test_limits_pass_over_outliers_and_nan() -> None:
    values = np.concatenate([np.linspace(0, 1, 999), [1e6, np.nan, -np.inf]])
    points = PointCloud(xyz=np.zeros((1002, 3)), gain=values)
    colors = coloring([points], "gain")
    low, high = colors.limits
    assert 0 < low < 0.02
    assert 0.98 < high < 1.0
    assert colors.extent == (0.0, 1e6)
    assert colors.clipped == "all: 0 to 1,000,000"  # what is clipped is said
    rgb = colors.rgb(points)
    assert f"#{bytes(rgb[1000]).hex()}" == MISSING
    assert rgb[999].tolist() == rgb[998].tolist()


def test_without_outliers_nothing_is_clipped() -> None:
    colors = coloring([cloud(range=[2.0, 3.0, 4.0, 8.0])], "range")
    assert colors.limits == colors.extent == (2.0, 8.0)
    assert colors.clipped == ""


def test_errors_and_velocities_have_zero_in_the_middle_of_two_colours() -> None:
    points = cloud(range_error=[-0.01, 0.0, 0.02, 0.04], radial_velocity=np.float32([0, 0, -3, 1]))
    for field, most in (("range_error", 0.04), ("radial_velocity", 3.0)):
        colors = coloring([points], field)
        assert colors.limits == pytest.approx((-most, most))
    rgb = rgb_of(points, "range_error").astype(int)
    assert rgb[0][2] > rgb[0][0]  # blue below
    assert abs(rgb[1] - rgb[1].mean()).max() < 12  # grey at 0
    assert rgb[3][0] > rgb[3][2]  # red above


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0.0, 1550.0, ["0", "500", "1,000", "1,500"]),
        (-0.013, 0.013, ["-0.010", "-0.005", "0.000", "0.005", "0.010"]),
        (0.0, 1.0, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]),
        (3.0, 3.0, ["2.6", "2.8", "3.0", "3.2", "3.4"]),
        (0.0, 1e-9, ["0", "2e-10", "4e-10", "6e-10", "8e-10", "1e-09"]),
        (0.1, 0.7, ["0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7"]),  # 0.7 − 0.1 and 3 × 0.1 are rounded in float64
        (-0.3, 1.2, ["-0.25", "0.00", "0.25", "0.50", "0.75", "1.00"]),
        (1e17, 1e17, ["99,999,999,999,999,984", "100,000,000,000,000,000", "100,000,000,000,000,016"]),
        (0.0, 6e300, ["0", "1e+300", "2e+300", "3e+300", "4e+300", "5e+300", "6e+300"]),
    ],
)
def test_ticks_are_round_numbers_that_one_reads(low: float, high: float, texts: list[str]) -> None:
    ticks = coloring([PointCloud(xyz=np.zeros((2, 3)), gain=[low, high])], "gain").ticks()
    assert list(ticks.values()) == texts
    for number, text in ticks.items():
        assert number == float(text.replace(",", ""))


@given(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300))
@example(0.1, 0.7)
@example(0.0, 5e-324)
@example(1e16, 1e16 + 2)
def test_ticks_are_between_the_limits_and_as_many_as_one_reads(low: float, high: float) -> None:
    low, high = min(low, high), max(low, high)
    if low < high:
        numbers = list(Coloring("gain", (low, high), (low, high), [], {}).ticks())
        assert low <= numbers[0] < numbers[-1] <= high
        assert 2 <= len(numbers) <= 7


def test_classes_have_names_and_those_of_surfaces_are_among_them() -> None:
    colors = coloring([cloud(label=[40, 10, 40, 81])], "label", Known({"label": {10: "car"}}, {"label": [7]}))
    assert colors.names == {7: "7", 10: "car", 40: "40", 81: "81"}
    assert colors.table == [QUALITATIVE[7], "#6496f5", QUALITATIVE[40], QUALITATIVE[81]]  # a car of SemanticKITTI


def test_points_without_a_label_look_like_none_of_the_classes_with_names() -> None:
    points = cloud(label=[0, 81, 0, 40])
    named = coloring([points], "label", Known({"label": {81: "traffic sign"}}))
    assert list(named.names.values()) == ["unlabelled", "40", "traffic sign"]
    shown = np.array([list(bytes.fromhex(color[1:])) for color in (named.table[0], *MEANINGS)], np.uint8)
    places = oklab(shown)
    assert len(MEANINGS) > 10
    assert np.linalg.norm(places[1:] - places[0], axis=-1).min() > 4 * 0.02
    # Without names, and where label 0 has one, it is a label as any other.
    assert coloring([points], "label").table[0] == QUALITATIVE[0]
    assert coloring([points], "label", Known({"label": {0: "car"}})).names[0] == "car"
    assert coloring([cloud(instance=[0, 1, 2, 3])], "instance").names[0] == "0"


def test_sources_have_their_names() -> None:
    points = cloud(source=np.array([0, 1, 2, 1], np.uint8))
    assert coloring([points], "source").names == {0: "surface", 1: "air", 2: "false return"}
    assert len(np.unique(rgb_of(points, "source"), axis=0)) == 3


def test_frames_share_their_colours() -> None:
    first, second = cloud(range=[0.0, 1, 2, 3], label=[1, 1, 1, 1]), cloud(range=[6.0, 7, 8, 9], label=[2, 2, 2, 9])
    assert coloring([first, second], "range").limits == (0.0, 9.0)
    assert list(coloring([first, second], "label").names) == [1, 2, 9]


def test_categories_have_a_colour_each_and_keep_their_names() -> None:
    points = cloud(label=[40, 10, 40, 81])
    assert coloring([points], "label").names == {10: "10", 40: "40", 81: "81"}
    assert [f"#{bytes(rgb).hex()}" for rgb in rgb_of(points, "label")] == [QUALITATIVE[i] for i in (40, 10, 40, 81)]


def test_a_category_has_one_colour_whatever_others_there_are() -> None:
    labels = np.array([0, 7, 40, 259, 4_000_000_000])
    together = rgb_of(PointCloud(xyz=np.zeros((5, 3)), label=labels), "label")
    for label, rgb in zip(labels, together, strict=True):
        for others in ([], [1, 2, 3], [39, 41, 4_000_000_001]):
            alone = rgb_of(PointCloud(xyz=np.zeros((1 + len(others), 3)), label=[label, *others]), "label")
            assert alone[0].tolist() == rgb.tolist()
    assert rgb_of(cloud(object_id=[-1, 0, 1, 2]), "object_id").shape == (4, 3)


def linear(colors: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Return sRGB as linear light (IEC 61966-2-1)."""
    part = colors / 255
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def oklab(colors: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Return colours in OKLab (B. Ottosson, 2020), in which 0.02 is about the least difference that one sees."""
    return oklab_of_linear(linear(colors))


def oklab_of_linear(light: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return linear light in OKLab."""
    to_cones = [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005]]  # fmt: skip
    to_lab = [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
              [0.0259040371, 0.7827717662, -0.8086757660]]  # fmt: skip
    lab: npt.NDArray[np.float64] = np.cbrt(light @ np.transpose(to_cones)) @ np.transpose(to_lab)
    return lab


# Classes of SemanticKITTI, semantic-kitti.yaml of its API.
KITTI = (
    0, 1, 10, 11, 13, 15, 16, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 52, 60, 70, 71, 72, 80, 81, 99,
    252, 253, 254, 255, 256, 257, 258, 259,
)  # fmt: skip


@pytest.mark.parametrize(
    ("labels", "least"),
    [(range(20), 0.13), (range(34), 0.11), (KITTI, 0.09), (range(260), 0.045)],
    ids=["first 20", "first 34", "SemanticKITTI", "all"],
)
def test_categories_differ_for_the_eye(labels: Sequence[int], least: float) -> None:
    lab = oklab(np.array([list(bytes.fromhex(QUALITATIVE[label][1:])) for label in labels], np.uint8))
    apart = np.linalg.norm(lab[:, None] - lab, axis=-1)[np.triu_indices(len(lab), 1)]
    assert apart.min() >= least


def test_categories_are_seen_before_the_background() -> None:
    # Contrast as WCAG 2.1 defines it, of 3 to 1 at least, as it wants of graphics.
    colors = np.array([list(bytes.fromhex(color[1:])) for color in (BACKGROUND, *QUALITATIVE)], np.uint8)
    luminance = linear(colors) @ [0.2126, 0.7152, 0.0722]
    assert len(luminance) == 261
    assert ((luminance[1:] + 0.05) / (luminance[0] + 0.05)).min() >= 3.0


def test_each_category_after_the_first_eight_is_the_colour_farthest_from_those_before() -> None:
    colors = np.array([list(bytes.fromhex(color[1:])) for color in QUALITATIVE], np.uint8)
    steps = np.arange(0, 256, 17, dtype=np.uint8)  # the colours that CSS writes with three digits
    candidates = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    background = np.array([list(bytes.fromhex(BACKGROUND[1:]))], np.uint8)
    weights = [0.2126, 0.7152, 0.0722]
    contrast = (linear(candidates) @ weights + 0.05) / (linear(background) @ weights + 0.05)
    places, table = oklab(candidates[contrast >= 3.0]), oklab(colors)
    order = list(dict.fromkeys([*range(34), *KITTI, *range(260)]))
    nearest = np.full(len(places), np.inf)
    for number, category in enumerate(order):
        if number >= 8:
            # The best two are never closer than 1.2e-6, far above any rounding of these numbers of about 1.
            chosen = int(np.argmax(nearest))
            assert np.abs(places[chosen] - table[category]).max() <= 64 * 2.0**-53
        nearest = np.minimum(nearest, np.linalg.norm(places - table[category], axis=-1))


@pytest.mark.parametrize("field", ["label", "range", "height"])
def test_no_points(field: str) -> None:
    empty = PointCloud(xyz=np.empty((0, 3)), label=np.empty(0, np.uint32), range=np.empty(0))
    assert rgb_of(empty, field).shape == (0, 3)


def test_unknown_field_names_those_there_are() -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        coloring([cloud(ring=[1, 2, 3, 4], normal=np.zeros((4, 3)))], "normal")
    assert str(caught.value) == "color_by: expected one of height, ring, got 'normal'"


def test_what_is_not_finite_is_grey_and_said() -> None:
    points = PointCloud(xyz=np.zeros((4, 3)), gain=[np.nan, np.inf, 0.0, 1.0], none=[np.nan] * 4)
    colors = coloring([points], "gain")
    assert (colors.limits, colors.scaled, colors.notes) == ((0.0, 1.0), True, ["grey: not finite"])
    assert [f"#{bytes(rgb).hex()}" for rgb in colors.rgb(points)] == [MISSING, MISSING, SEQUENTIAL[0], SEQUENTIAL[-1]]
    none = coloring([points], "none")
    assert (none.scaled, none.missing) == (False, True)
    assert {f"#{bytes(rgb).hex()}" for rgb in none.rgb(points)} == {MISSING}
    empty = coloring([points[:0]], "gain")
    assert (empty.scaled, empty.missing, empty.notes) == (False, False, [])


def test_true_and_false_are_categories() -> None:
    for values in ([True, False, True, True], [True] * 4):
        points = cloud(on=np.array(values))
        colors = coloring([points], "on")
        assert colors.names == {0: "false", 1: "true"}
        assert [f"#{bytes(rgb).hex()}" for rgb in colors.rgb(points)] == [QUALITATIVE[value] for value in values]


@pytest.mark.parametrize(
    "values",
    [
        [-1.7e308, 0.0, 1.7e308],
        [0.0, 5e-324, 1e-323],
        np.array([2**63, 2**63 + 4096, 2**63 + 8192], np.uint64),
        np.array([-128, 0, 127], np.int8),
        1.3e9 + np.array([0.0, 0.05, 0.1]),
        np.float32([1.0, 2.0, 3.0]),
    ],
    ids=["great", "small", "uint64", "int8", "time", "float32"],
)
def test_colours_run_from_end_to_end_whatever_the_numbers(values: Sequence[float]) -> None:
    points = PointCloud(xyz=np.zeros((3, 3)), gain=values)
    colors = coloring([points], "gain")
    low, middle, high = (bytes(rgb).hex() for rgb in colors.rgb(points))
    assert (low, high) == (SEQUENTIAL[0][1:], SEQUENTIAL[-1][1:])
    assert middle not in {low, high}
    assert colors.places(values)[[0, 2]].tolist() == [0.0, 1.0]
    ticks = colors.places(list(colors.ticks()))
    assert ticks.min() >= 0.0
    assert ticks.max() <= 1.0


def test_a_rig_without_scans_in_a_frame_does_not_hide_a_field() -> None:
    nothing = PointCloud(xyz=np.empty((0, 3)))
    full = cloud(range=[0.0, 1.0, 2.0, 3.0])
    colors = coloring([nothing, full], "range")
    assert colors.limits == (0.0, 3.0)
    assert colors.rgb(nothing).shape == (0, 3)
    assert coloring([nothing, cloud(intensity=[1, 2, 3, 4])], None).field == "intensity"


def test_names_are_legible() -> None:
    names = {1: "a\nb\x1b[31m", 2: " ", 3: "x" * 10_000, 4: "\ud800"}
    found = coloring([cloud(label=[1, 2, 3, 4])], "label", Known({"label": names})).names
    assert found == {1: r"a\nb\x1b[31m", 2: "2", 3: "x" * 39 + "…", 4: r"\ud800"}


@pytest.mark.parametrize("color_by", [5, ["range"], np.arange(4)])
def test_what_is_no_name_of_a_field(color_by: object) -> None:
    with pytest.raises(TypeError, match=r"^color_by: expected the name of a field, got "):
        coloring([cloud()], color_by)  # type: ignore[arg-type]


# Machado, Oliveira and Fernandes, A physiologically-based model for simulation of color vision deficiency, 2009: linear
# RGB as people without L, M or S cones see it.
DEFICIENCIES = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
COMMON = ("road", "sidewalk", "building", "vegetation", "ground", "person", "car", "pole", "sign")


def simulate_vision(vision: str, colors: Sequence[str]) -> npt.NDArray[np.float64]:
    """Return colours in OKLab as people with that kind of vision see them."""
    light = linear(np.array([list(bytes.fromhex(color[1:])) for color in colors], np.uint8))
    return oklab_of_linear(np.clip(light @ np.transpose(DEFICIENCIES[vision]), 0, 1))


def least_apart(vision: str, colors: Sequence[str]) -> float:
    lab = simulate_vision(vision, colors)
    return float(np.linalg.norm(lab[:, None] - lab, axis=-1)[np.triu_indices(len(colors), 1)].min())


@pytest.mark.parametrize("vision", DEFICIENCIES)
@pytest.mark.parametrize("theme", THEMES)
def test_palettes_differ_for_every_kind_of_vision(vision: str, theme: str) -> None:
    """0.02 is about the least difference that one sees."""
    background = THEMES[theme].background
    assert least_apart(vision, [legible(color, background) for color in MEANINGS]) >= 0.055
    assert least_apart(vision, [legible(color, background) for color in QUALITATIVE[:8]]) >= 0.07
    common = [legible(str(class_color(name)), background) for name in COMMON]
    assert least_apart(vision, common) >= 0.06
    assert least_apart(vision, [DIVERGING[0], DIVERGING[2], DIVERGING[-1]]) >= 0.2


@pytest.mark.parametrize("vision", DEFICIENCIES)
def test_plots_differ_for_every_kind_of_vision(vision: str) -> None:
    assert least_apart(vision, list(report.COLORS.values())) >= 0.09
    for name in ("real", "simulated"):
        assert re.findall(rf"--{name}: (#[0-9a-f]{{6}})", _report.STYLE)
    light, dark = zip(*(re.findall(rf"--{name}: (#[0-9a-f]{{6}})", _report.STYLE) for name in ("real", "simulated")),
                      strict=True)  # fmt: skip
    assert min(least_apart(vision, light), least_apart(vision, dark)) >= 0.2


@pytest.mark.parametrize("vision", DEFICIENCIES)
@pytest.mark.parametrize("name", MAPS)
def test_colour_maps_rise_in_lightness_for_every_kind_of_vision(vision: str, name: str) -> None:
    lightness = simulate_vision(vision, MAPS[name])[:, 0]
    assert np.diff(lightness).min() > 0.02


def test_classes_have_the_colours_of_their_sets_or_of_their_meaning() -> None:
    assert class_color("road", 40) == "#ff00ff"  # SemanticKITTI's
    assert class_color("road", 8) == class_color("Road") == class_color("main road") == class_color("asphalt")
    assert class_color("vehicle.car") == "#ff9e00"  # nuScenes'
    assert class_color("high vegetation") == "#00aa00"  # QGIS's
    assert class_color("thing") is None
    assert class_color("tree, road") is None
    for name in ("vegetation", "oak tree", "static.vegetation", "medium vegetation"):
        red, green, blue = bytes.fromhex(str(class_color(name))[1:])
        assert green > max(red, blue), name


def test_a_label_without_a_name_has_that_of_its_objects() -> None:
    points = cloud(label=[40, 10, 40, 81])
    known = Known({"label": {10: "van"}}, objects={10: "first", 40: "road", 81: "ball, cone, 3 more"})
    colors = coloring([points], "label", known)
    assert colors.names == {10: "van", 40: "road", 81: "ball, cone, 3 more"}
    meant = [legible(str(class_color(name))) for name in ("van", "road")]  # not the road of SemanticKITTI
    assert colors.table == [*meant, QUALITATIVE[81]]


def test_integers_of_few_values_have_a_legend() -> None:
    colors = coloring([cloud(ring=[0, 3, 3, 7])], "ring")
    assert (colors.names, colors.scaled) == ({0: "0", 3: "3", 7: "7"}, False)
    many = PointCloud(xyz=np.zeros((13, 3)), ring=np.arange(13))
    assert coloring([many], "ring").scaled


@pytest.mark.parametrize("background", ["#14181d", "#ffffff"])
def test_all_classes_show_on_the_background(background: str) -> None:
    names = [name for name, _ in SEMANTIC_KITTI.values()] + list(COMMON)
    for color in [class_color(name, label) for label, (name, _) in SEMANTIC_KITTI.items()] + [
        class_color(name) for name in names
    ]:
        if color is not None:
            low, high = sorted((luminance(legible(color, background)), luminance(background)))
            assert (high + 0.05) / (low + 0.05) >= 3.0
