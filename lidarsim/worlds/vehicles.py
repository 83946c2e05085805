"""Vehicles: closed bodies lofted through cross-sections, on wheels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Generic, Literal, TypeVar, get_args

import numpy as np

from lidarsim import materials
from lidarsim._base.validation import Floats, one_of
from lidarsim.materials import Material
from lidarsim.worlds._asset import (
    Asset,
    Piece,
    along,
    box,
    bridge,
    check_generator,
    lathe,
    loft,
    merge,
    move,
    translation,
    tube,
)
from lidarsim.worlds._labels import BICYCLE, BICYCLIST, BUS, CAR, MOTORCYCLE, MOTORCYCLIST, TRUCK
from lidarsim.worlds.pedestrians import person

__all__ = ["VEHICLES", "VehicleKind", "vehicle"]

VehicleKind = Literal["hatchback", "saloon", "estate", "suv", "van", "pickup", "lorry", "bus", "motorcycle", "bicycle"]
VEHICLES: tuple[VehicleKind, ...] = get_args(VehicleKind)

Span = tuple[float, float]
T = TypeVar("T", float, Span)


@dataclass(frozen=True)
class Size(Generic[T]):
    """Length, width, height and wheelbase of a vehicle, radius of its wheels and ground clearance, m."""

    length: T
    width: T
    height: T
    wheelbase: T
    wheel: T
    clearance: T


# From the manufacturers' technical data of the models that are named: the least and the greatest of both. Lorries and
# buses keep within Council Directive 96/53/EC: 12 m by 2.55 m by 4 m.
SIZES: dict[VehicleKind, Size[Span]] = {
    # Ford Fiesta (2008), Volkswagen Golf VII
    "hatchback": Size((3.95, 4.26), (1.72, 1.80), (1.45, 1.48), (2.49, 2.64), (0.29, 0.32), (0.13, 0.15)),
    # BMW 3 (E90), Mercedes-Benz E (W213)
    "saloon": Size((4.52, 4.92), (1.82, 1.85), (1.42, 1.47), (2.76, 2.94), (0.31, 0.34), (0.12, 0.15)),
    # Volkswagen Golf VII Variant, Škoda Superb III Combi
    "estate": Size((4.56, 4.86), (1.80, 1.86), (1.48, 1.52), (2.63, 2.84), (0.31, 0.34), (0.13, 0.15)),
    # Volkswagen Tiguan II, BMW X5 (F15)
    "suv": Size((4.49, 4.89), (1.84, 1.94), (1.64, 1.76), (2.68, 2.93), (0.35, 0.38), (0.19, 0.22)),
    # Volkswagen Transporter T6, Mercedes-Benz Sprinter (906) of medium length and height
    "van": Size((4.90, 5.91), (1.90, 1.99), (1.99, 2.73), (3.00, 3.67), (0.33, 0.35), (0.17, 0.20)),
    # Toyota Hilux (2015), Volkswagen Amarok (2010), both with a double cab
    "pickup": Size((5.25, 5.33), (1.86, 1.95), (1.81, 1.83), (3.08, 3.10), (0.37, 0.39), (0.20, 0.28)),
    # Mercedes-Benz Atego with a box, wheelbases of 4.22 m to 5.40 m
    "lorry": Size((7.40, 9.60), (2.45, 2.55), (3.30, 3.90), (4.22, 5.40), (0.42, 0.48), (0.30, 0.45)),
    # MAN Lion's City, Mercedes-Benz Citaro, both of 12 m
    "bus": Size((11.95, 12.00), (2.50, 2.55), (2.99, 3.13), (5.84, 6.00), (0.46, 0.49), (0.25, 0.32)),
    # Honda CB500F, BMW R 1200 GS; without the rider
    "motorcycle": Size((2.08, 2.21), (0.79, 0.95), (1.06, 1.30), (1.41, 1.51), (0.30, 0.33), (0.15, 0.20)),
    # City bicycles with tyres of 37-622 to 47-622 (ISO 5775); without the rider
    "bicycle": Size((1.72, 1.82), (0.56, 0.64), (1.02, 1.12), (1.03, 1.10), (0.348, 0.358), (0.10, 0.12)),
}


@dataclass(frozen=True)
class Profile:
    """The side view of a body: shares of the length from the nose, and of the height.

    Attributes
    ----------
    top : tuple of (float, float)
        Upper outline from nose to tail.
    screen, rear : (float, float)
        Where the windscreen and the rear window begin and end, from the nose; `rear` may be empty.
    panes : tuple of (float, float)
        Where side windows begin and end.
    belt : float
        Height of the lower edge of the side windows.
    lean : float
        Half the width of the roof over that of the body.
    front : float
        Front overhang over the sum of both.
    """

    top: tuple[Span, ...]
    screen: Span
    rear: Span
    panes: tuple[Span, ...]
    belt: float = 0.62
    lean: float = 0.76
    front: float = 0.52


PROFILES: dict[VehicleKind, Profile] = {
    "hatchback": Profile(
        ((0, 0.46), (0.04, 0.54), (0.24, 0.66), (0.42, 0.96), (0.55, 1), (0.85, 0.95), (0.96, 0.68), (1, 0.5)),
        (0.24, 0.42), (0.86, 0.95), ((0.33, 0.56), (0.59, 0.82)),
    ),
    "saloon": Profile(
        ((0, 0.44), (0.03, 0.53), (0.27, 0.67), (0.42, 0.97), (0.52, 1), (0.68, 0.96), (0.84, 0.73), (0.98, 0.68),
         (1, 0.5)),
        (0.27, 0.42), (0.69, 0.83), ((0.35, 0.52), (0.55, 0.7)), belt=0.64, front=0.46,
    ),
    "estate": Profile(
        ((0, 0.44), (0.03, 0.52), (0.26, 0.65), (0.4, 0.96), (0.52, 1), (0.88, 0.96), (0.97, 0.66), (1, 0.5)),
        (0.26, 0.4), (0.89, 0.96), ((0.33, 0.51), (0.54, 0.7), (0.72, 0.86)), front=0.48,
    ),
    "suv": Profile(
        ((0, 0.5), (0.03, 0.58), (0.25, 0.68), (0.38, 0.96), (0.5, 1), (0.88, 0.96), (0.96, 0.66), (1, 0.5)),
        (0.25, 0.38), (0.89, 0.95), ((0.32, 0.52), (0.55, 0.72), (0.74, 0.85)), belt=0.65, lean=0.78, front=0.46,
    ),
    "van": Profile(
        ((0, 0.36), (0.04, 0.44), (0.13, 0.52), (0.27, 0.92), (0.36, 1), (0.97, 0.99), (1, 0.9)),
        (0.13, 0.27), (0, 0), ((0.2, 0.34),), belt=0.52, lean=0.86, front=0.5,
    ),
    "pickup": Profile(
        ((0, 0.48), (0.03, 0.57), (0.25, 0.64), (0.36, 0.95), (0.44, 1), (0.6, 0.97), (0.65, 0.62), (0.99, 0.6),
         (1, 0.55)),
        (0.25, 0.36), (0.61, 0.64), ((0.31, 0.44), (0.47, 0.58)), belt=0.62, lean=0.78, front=0.43,
    ),
    "bus": Profile(
        ((0, 0.4), (0.015, 0.93), (0.05, 1), (0.96, 1), (0.988, 0.93), (1, 0.5)),
        (0, 0.015), (0.988, 1), tuple((0.03 + 0.094 * i, 0.112 + 0.094 * i) for i in range(10)),
        belt=0.42, lean=0.94, front=0.46,
    ),
    "lorry": Profile(  # the cab alone
        ((0, 0.72), (0.04, 0.84), (0.35, 1), (0.98, 1), (1, 0.98)),
        (0, 0.3), (0, 0), ((0.25, 0.8),), belt=0.52, lean=0.9,
    ),
}  # fmt: skip

LABELS: dict[VehicleKind, int] = {
    **dict.fromkeys(VEHICLES, CAR),
    "lorry": TRUCK,
    "bus": BUS,
    "motorcycle": MOTORCYCLE,
    "bicycle": BICYCLE,
}

PAINTS: tuple[tuple[float, float], ...] = ((0.34, 0.2), (0.21, 0.01), (0.19, 0.027), (0.08, 0.15), (0.18, 0.04))
"""Share and reflectivity of white, black, grey, silver and coloured cars. Shares: Axalta, 2022, Global Automotive Color
Popularity Report. Reflectivities: a third to a fifth of those in `lidarsim.materials.SOURCES`, since lacquer and flakes
throw most of the light ahead: half of the points on cars in SemanticKITTI 00 and 08 read 0."""

PLATE = Material(reflectivity=220.0)
"""Sheeting of type I, 70 cd/lx/m² (ASTM D4956), times π for a white diffuser's 1/π."""

REFLECTOR = Material(reflectivity=377.0)
"""Reflex reflectors of class IA: 300 mcd/lx at 20′ (UN Regulation 3) from 25 cm², times π."""

LAMP = Material(reflectivity=2.0)
"""A head lamp, whose mirror returns some of the light: assumed."""

PLATE_SIZE = (0.02, 0.52, 0.11)
"""Number plates are 520 mm by 110 mm (Germany, FZV, annex 4)."""


def vehicle(kind: VehicleKind, rng: np.random.Generator, *, rider: bool = True) -> Asset:
    """Make a vehicle that heads along x, its middle above the origin.

    Parameters
    ----------
    kind : str
        "hatchback", "saloon", "estate", "suv", "van", "pickup", "lorry", "bus", "motorcycle" or "bicycle".
    rng : numpy.random.Generator
        Draws size and paint, from the ranges of real models.
    rider : bool
        Whether someone rides a motorcycle or bicycle, all of which is then a motorcyclist or bicyclist, as in
        SemanticKITTI.

    Returns
    -------
    Asset
        Body, glass and wheels; the wheels' names begin with "wheel".

    Raises
    ------
    TypeError, ValueError
        If `rng` is no generator, or there is no such kind.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> ls.worlds.vehicle("suv", np.random.default_rng(1))
    Asset(7 parts, 4.73 × 1.89 × 1.69 m)
    """
    one_of("kind", kind, VEHICLES)
    check_generator(rng)
    share = rng.random()  # long models are wide, too
    size = Size(
        *(
            low + (high - low) * float(np.clip(share + rng.normal(0.0, 0.1), 0.0, 1.0))
            for low, high in vars(SIZES[kind]).values()
        )
    )
    paint = _paint(rng)
    if kind in {"bicycle", "motorcycle"}:
        return _two_wheeler(kind, rng, size, paint, rider=rider)
    front = size.wheelbase / 2 + (PROFILES[kind].front - 0.5) * (size.wheelbase - size.length)
    axles = (front, front - size.wheelbase)
    body = _lorry(size, axles, paint) if kind == "lorry" else _body(kind, size, axles, paint)
    thick = (0.13 if kind in {"lorry", "bus"} else 0.11) * size.width
    wheel = next(merge("wheel", _wheel(size.wheel, thick)))
    label = LABELS[kind]
    parts = [replace(part, label=label) for part in merge("body", body)]
    for number, (x, side) in enumerate(product(axles, (1, -1)), 1):
        place = translation(x, side * (size.width / 2 - thick / 2 - 0.02), size.wheel)
        parts.append(replace(wheel, name=f"wheel {number}", label=label, transform=place))
    return Asset(tuple(parts))


def _paint(rng: np.random.Generator) -> Material:
    shares, values = np.array(PAINTS).T
    value = float(rng.choice(values, p=shares / shares.sum()) * rng.uniform(0.8, 1.25))
    return Material(reflectivity=value, specular=1.0, specular_width=0.1)


def _body(kind: VehicleKind, size: Size[float], axles: tuple[float, ...], paint: Material) -> Iterator[Piece]:
    """Yield the shell with its wells for the wheels, its panes, seats, plates and lamps."""
    profile, length, width, height = PROFILES[kind], size.length, size.width, size.height
    shell, shares = _shell(profile, size, axles)
    yield from _glaze(shell, shares, profile, paint)
    nose, tail = length / 2 - 0.01, -length / 2 + 0.01
    bumper = size.clearance + 0.25
    for x, lamp in ((nose, LAMP), (tail, REFLECTOR)):
        yield box(PLATE_SIZE, (x, 0.0, bumper), material=PLATE)
        for side in (1, -1):
            place = x, side * 0.33 * width, min(0.44 * height, size.clearance + 0.55)
            yield box((0.02, 0.17 * width, 0.07), place, material=lamp)
    for row in SEATS.get(kind, (0.5, 0.75)):
        middle = length / 2 - row * length, 0.0, (size.clearance + 0.8 * height) / 2
        yield box((0.15, 0.6 * width, 0.75 * height - size.clearance), middle, material=materials.CLOTH_DARK)


SEATS: dict[VehicleKind, tuple[float, ...]] = {"van": (0.35,), "pickup": (0.42, 0.55), "bus": ()}
"""Where rows of seats are, from the nose, over the length; behind glass, they are seen by a `depth` of more than 1."""

HALF = 9
"""Corners of half a cross-section, from the middle of the floor to that of the roof."""
BELT, RAIL, ROOF = 5, 6, 8
"""Those at the lower edge of a window, at its upper edge, and in the middle of the roof."""


def _shell(profile: Profile, size: Size[float], axles: tuple[float, ...]) -> tuple[Piece, Floats]:
    """Return the closed shell from tail to nose, and where its cross-sections are, from the nose, over the length."""
    width, height, clearance, wheel = size.width, size.height, size.clearance, size.wheel
    inner = size.length - 0.03  # plates and lamps stand out
    well = wheel + 0.06
    arch = np.cos(np.linspace(0, np.pi, 9)) * well
    around = np.concatenate([[x + d for d in (*arch, -well - 0.01, well + 0.01)] for x in axles])
    edges = [share for span in (profile.screen, profile.rear, *profile.panes) for share in span if any(span)]
    edges += [share for share, _ in profile.top] + [0.01, 0.03, 0.06, 0.94, 0.97, 0.99]
    x = np.concatenate([(0.5 - np.array(edges)) * inner, around])
    x = np.unique(np.round(np.clip(x, -inner / 2, inner / 2), 3))
    share = 0.5 - x / inner
    top = np.interp(share, *np.array(profile.top).T) * height
    # Both ends are rounded in plan, over the last 6 % of the length, and the bumpers rise towards them.
    end = np.clip((np.abs(x) / (inner / 2) - 0.88) / 0.12, 0.0, 1.0)
    half = width / 2 * (1 - 0.12 * end**2)
    low = clearance + 0.06 * end
    gap = np.min([np.abs(x - axle) for axle in axles], axis=0)
    over = np.where(gap <= well, wheel + np.sqrt(np.maximum(well**2 - gap**2, 0.0)), 0.0)
    raised = np.maximum(low + 0.02, np.minimum(over, 0.9 * top))
    belt = np.minimum(profile.belt * height, top - 0.08)
    middle = np.clip((low + belt) / 2, raised + 0.02, None)
    belt = np.maximum(belt, middle + 0.02)
    rise = np.clip((top - belt) / (height - profile.belt * height), 0.0, 1.0)
    roof = half * (0.97 + (profile.lean - 0.97) * rise)
    none, thick = np.zeros(len(x)), 0.14 * width
    inside = np.maximum(half - thick, 0.3 * half)
    corners = (
        (none, low), (inside, low), (inside, np.where(over > 0, raised, low + 0.01)), (0.98 * half, raised),
        (half, middle), (0.98 * half, belt), (roof, np.maximum(top - 0.05, belt + 0.01)),
        (0.86 * roof, top - 0.005), (none, top),
    )  # fmt: skip
    right = np.array([np.column_stack([x, y, z]) for y, z in corners]).swapaxes(0, 1)
    left = right[:, HALF - 2 : 0 : -1] * (1, -1, 1)
    return loft(np.concatenate([right, left], axis=1)), share


def _glaze(shell: Piece, shares: Floats, profile: Profile, paint: Material) -> Iterator[Piece]:
    """Yield the panes of a shell, and the rest of it."""
    sides = 2 * (HALF - 1)
    middle = (shares[:-1] + shares[1:]) / 2
    glass = np.zeros((len(middle), sides), bool)
    for span in profile.panes:
        inside = (span[0] < middle) & (middle < span[1])
        glass[:, BELT] |= inside
        glass[:, sides - BELT - 1] |= inside
    for span in (profile.screen, profile.rear):
        inside = (span[0] < middle) & (middle < span[1])
        glass[:, RAIL : sides - RAIL] |= inside[:, None]
    caps = np.zeros(len(shell.faces) - 2 * glass.size, bool)
    is_glass = np.concatenate([np.repeat(glass.ravel(), 2), caps])
    yield shell.of(is_glass, materials.GLASS)
    yield shell.of(~is_glass, paint)


def _lorry(size: Size[float], axles: tuple[float, ...], paint: Material) -> Iterator[Piece]:
    """Yield cab, box and frame."""
    cab, length, width, height, wheel = 2.0, size.length, size.width, size.height, size.wheel
    profile = PROFILES["lorry"]
    small = replace(size, length=cab, width=0.96 * width, height=min(0.88 * height, 2.9))
    ahead = (length - cab) / 2
    shell, shares = _shell(profile, small, (axles[0] - ahead,))
    yield from _glaze(replace(shell, vertices=move(shell.vertices, (ahead, 0.0, 0.0))), shares, profile, paint)
    deck = 2 * wheel + 0.12
    back = length - cab - 0.12
    yield box(
        (back, width, height - deck), (back / 2 - length / 2, 0, (height + deck) / 2), material=materials.PAINTED_METAL
    )
    yield box((length - 1.0, 0.8, 0.25), (-0.5, 0, deck - 0.13), material=materials.CAR_PAINT_DARK)
    for side in (1, -1):
        span = axles[0] - axles[1] - 2 * wheel - 0.4
        middle = (axles[0] + axles[1]) / 2
        yield box((span, 0.05, 0.45), (middle, side * (width / 2 - 0.06), 0.65), material=materials.PAINTED_METAL)
        yield box((0.02, 0.3, 0.12), (-length / 2, side * 0.4 * width, deck + 0.06), material=REFLECTOR)
    yield box(PLATE_SIZE, (length / 2 - 0.01, 0, size.clearance + 0.3), material=PLATE)


def _wheel(radius: float, thick: float) -> Iterator[Piece]:
    """Yield a tyre with its rim, about the y axis."""
    half = thick / 2
    tyre = lathe(
        [
            (0.62 * radius, -half),
            (0.93 * radius, -half),
            (radius, -0.7 * half),
            (radius, 0.7 * half),
            (0.93 * radius, half),
            (0.62 * radius, half),
        ],
        20,
        material=materials.RUBBER,
    )
    rim = lathe([(0.6 * radius, -1.02 * half), (0.6 * radius, 1.02 * half)], 10, material=materials.PAINTED_METAL)
    for piece in (tyre, rim):
        yield Piece(along("y", piece.vertices), piece.faces, material=piece.material)


def _two_wheeler(
    kind: VehicleKind, rng: np.random.Generator, size: Size[float], paint: Material, *, rider: bool
) -> Asset:
    """Return a bicycle or motorcycle, with its rider in the saddle, whose feet are on the pedals or pegs."""
    motor = kind == "motorcycle"
    rear, front = -size.wheelbase / 2, size.wheelbase / 2
    bend: dict[str, Any]
    if motor:
        label, tyre = MOTORCYCLIST if rider else MOTORCYCLE, 0.07
        saddle, grips = (-0.25, 0.0, 0.8), (0.28 * size.wheelbase, 0.82 * size.height)
        pieces = list(_motorcycle(size, grips, paint))
        bend = {"hip": (75, 75), "knee": (95, 95), "lean": 15.0}
    else:
        label, tyre = BICYCLIST if rider else BICYCLE, 0.022
        saddle, grips = (rear + 0.32, 0.0, 0.93 * size.height - 0.08), (front - 0.2, size.height - 0.03)
        pieces = list(_frame(size, saddle, grips, paint))
        bend = {"hip": (95, 40), "knee": (100, 30), "lean": 30.0}
    pieces.append(_bar(grips, size.width))
    parts = [replace(part, label=label) for part in merge("frame", pieces)]
    wheel = next(merge("wheel", [_ring(size.wheel - tyre, tyre, materials.RUBBER)]))
    for number, x in enumerate((front, rear), 1):
        parts.append(replace(wheel, name=f"wheel {number}", label=label, transform=translation(x, 0.0, size.wheel)))
    if rider:
        tall = float(np.clip(rng.normal(1.72, 0.08), 1.5, 1.95))
        seat = saddle[0], 0.0, saddle[2] + 0.05 * tall
        helmet = motor or bool(rng.random() < 0.4)
        parts += person(rng, tall, seat, label, shoulder=(75, 75), elbow=(25, 25), helmet=helmet, **bend)
    return Asset(tuple(parts))


def _ring(radius: float, thick: float, material: Material) -> Piece:
    """Return a torus about the y axis."""
    turn, around = (2 * np.pi * np.arange(count) / count for count in (24, 6))
    radii = radius + thick * np.cos(around)
    rings = np.stack(
        [
            radii * np.cos(turn)[:, None],
            np.broadcast_to(thick * np.sin(around), (24, 6)),
            radii * np.sin(turn)[:, None],
        ],
        axis=-1,
    )
    closed = np.concatenate([rings, rings[:1]])
    faces = bridge(closed) % np.uint32(24 * 6)
    return Piece(rings.reshape(-1, 3), faces, material=material)


def _bar(at: Span, width: float) -> Piece:
    """Return a handlebar at x and z."""
    x, z = at
    return tube(
        [(x - 0.12, width / 2, z), (x, 0.1, z), (x, -0.1, z), (x - 0.12, -width / 2, z)],
        0.016,
        6,
        material=materials.PAINTED_METAL,
    )


def _frame(size: Size[float], saddle: tuple[float, float, float], grips: Span, paint: Material) -> Iterator[Piece]:
    """Yield the tubes of a bicycle, with saddle, cranks and reflector."""
    wheel, rear, front = size.wheel, -size.wheelbase / 2, size.wheelbase / 2
    crank, seat, head = (
        (rear + 0.45, 0, 0.28),
        (saddle[0] + 0.03, 0, saddle[2] - 0.25),
        (front - 0.14, 0, 0.85 * grips[1]),
    )
    hubs = (rear, 0, wheel), (front, 0, wheel)
    for start, end, radius in (
        (crank, seat, 0.018), (crank, head, 0.02), (seat, head, 0.018), (hubs[1], head, 0.016), (crank, hubs[0], 0.012),
        (seat, hubs[0], 0.01), (seat, (saddle[0], 0, saddle[2]), 0.014), (head, (grips[0], 0, grips[1]), 0.014),
    ):  # fmt: skip
        yield tube([start, end], radius, 6, material=paint)
    yield box((0.26, 0.16, 0.06), (saddle[0], 0, saddle[2]), material=materials.RUBBER)
    yield box((0.34, 0.04, 0.03), (crank[0], 0.06, crank[2]), material=materials.PAINTED_METAL)
    yield box((0.02, 0.06, 0.05), (rear - 0.1, 0, 0.7), material=REFLECTOR)


def _motorcycle(size: Size[float], grips: Span, paint: Material) -> Iterator[Piece]:
    """Yield engine, tank, seat, fork, swing arm, lamp, screen, plate and tail."""
    length, height, wheel, rear, front = size.length, size.height, size.wheel, -size.wheelbase / 2, size.wheelbase / 2
    x, z = grips
    dark, metal = materials.CLOTH_DARK, materials.PAINTED_METAL
    yield box((0.5, 0.34, 0.36), (0.0, 0, 0.42), material=metal)
    tank = [(-0.12, 0, 0.84), (0.02, 0, 0.92), (0.22, 0, 0.9), (0.34, 0, 0.82)]
    yield tube(tank, [0.1, 0.15, 0.16, 0.08], 10, material=paint)
    yield tube([(-0.75, 0, 0.88), (-0.4, 0, 0.78), (-0.05, 0, 0.8)], [0.06, 0.13, 0.11], 8, material=dark)
    yield tube([(front, 0, wheel), (x, 0, z)], 0.07, 8, material=metal)
    yield tube([(rear, 0, wheel), (-0.15, 0, 0.4)], 0.06, 8, material=metal)
    yield tube([(x + 0.03, 0, 0.72 * height), (x + 0.12, 0, 0.76 * height)], 0.1, 10, material=LAMP)
    yield tube([(x - 0.02, 0, 0.98 * z), (x - 0.08, 0, height)], [0.16, 0.1], 8, material=materials.GLASS)
    yield box((0.02, 0.18, 0.2), (-length / 2 + 0.01, 0, 0.6), material=PLATE)
    yield tube([(-length / 2 + 0.01, 0, 0.66), (-0.7, 0, 0.86)], 0.04, 6, material=dark)
