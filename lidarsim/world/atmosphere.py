"""The air of a scene: fog, rain and snow, which weaken light and send some of it back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from lidarsim import _native
from lidarsim._base.pickling import Immutable
from lidarsim._base.validation import UINT32, beam_angle, integer, real, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.sensor.sensor import Sensor

CONTRAST = 0.05
"""The contrast of a black object against the sky that is just seen, by which visibility is defined."""
FOG_BACKSCATTER = 0.046
"""Backscatter of fog times its visibility, 1/sr (R. H. Rasshofer et al., 2011)."""
MOST_RAIN, MOST_SNOW = 200.0, 10.0
"""The largest rates, mm/h."""

WATER = 1.328
"""Refractive index of water at 905 nm (G. M. Hale, M. R. Querry, Optical constants of water, Appl. Optics 12, 1973)."""
MIRRORED = ((WATER - 1.0) / (WATER + 1.0)) ** 2
FOCUSED = (WATER / (2.0 - WATER)) ** 2
DROP = 0.25 * MIRRORED * (1.0 + (1.0 - MIRRORED) ** 2 * FOCUSED)
"""What a drop returns as a share of what a white diffuse disk of its diameter does: the reflections of its near and far
side, where light passes straight through."""

SNOW_DENSITY = 100.0
"""Of a flake, kg/m³."""
FLAKE = 2.0 / 3.0 * 0.9 * (1000.0 / SNOW_DENSITY) ** (2.0 / 3.0)
"""The same of a flake, with the diameter of the drop that it melts to: that of a diffuse ball of reflectivity 0.9."""


@dataclass(frozen=True, kw_only=True)
class Atmosphere(Immutable):
    """The air of a scene, the same everywhere.

    `fog`, `rain` and `snow` make the usual ones; `dataclasses.replace` changes a value. A scene without one
    (``scene.atmosphere = None``) has clear air.

    Parameters
    ----------
    extinction : float
        Extinction coefficient α, 1/m, >= 0: an echo from range R is weakened by the factor exp(−2αR). It adds to the
        `extinction` of a `Measurement`.
    backscatter : float
        Differential backscatter β, 1/(m·sr), >= 0: of light along a way dr, the air sends the share β·dr back per
        steradian. It gives each pulse one more echo, close to the sensor.
    intercept : float
        N₀, the number of drops or flakes per volume and diameter at the diameter 0, 1/m⁴, >= 0. Of the diameter D there
        are N₀·exp(−ΛD).
    slope : float
        Λ, 1/m, > 0.
    reflectance : float
        What a drop or flake returns as a share of what a white diffuse disk of the same diameter does at normal
        incidence, >= 0.
    label : int
        Label of the echoes of the air, 0 to 2³² − 1.
    aperture : float
        Width of a beam at the sensor, m, > 0: where single drops are in it, and how bright they are. Default: 10 mm.
    divergence : float
        Full angle by which the beam widens, 0 to 0.1 rad, for sensors without a `Beam`. Default: 3 mrad. (A Velodyne
        VLP-16 has 9.5 mm × 12.7 mm and 3.0 mrad × 1.5 mrad.)

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range.

    Notes
    -----
    Echoes of the air compete with those of surfaces for the returns of a pulse, with the same effects: fluctuation,
    detection, drop-out, range noise, quantisation and range gate. `Scan.source` is `Source.atmosphere` for them; they
    have `object_id` -1, `instance` 0 and the `label` above. Their `true_range` is the range of the echo before all
    errors; they have no normal and no incidence. Only the air in front of the first surface on a ray has echoes, not
    that behind panes or in mirrors (`Measurement.depth`).

    **The unit.** A slice dr of the air at range r has the intensity π·β·dr, since a white diffuser, whose intensity is
    1, sends 1/π back per steradian. So the receiver gets π·β·ξ(r)·exp(−2αr)/r²·dr of it in the unit in which it gets
    I/R² of a surface; ξ is the overlap (`Measurement.crossover`).

    **Fog.** The response to a pulse, whose shape is a Gaussian g of the height 1 and the standard deviation σ =
    c/2·`pulse_length`/2.355 (5 ns without a `Beam`), is W(R) = π·β·∫ g(R − r)·ξ(r)/r²·exp(−2αr) dr (R. H. Rasshofer, M.
    Spies, H. Spies, Influences of weather phenomena on automotive laser radar systems, Advances in Radio Science 9,
    2011; M. Hahner et al., Fog simulation on real LiDAR point clouds for 3D object detection in adverse weather, ICCV
    2021). Its one peak is the echo of the fog, of the power W and the intensity W·R². A surface nearer than 2σ behind
    the peak hides it; with a beam, the sub-rays that hit such a surface do. The integral diverges at the sensor, so the
    receiver must see the air only from some range on: where the `crossover` begins or, without one that begins beyond
    0, the `min_range` of the `Lidar`. A scan in fog without either is refused.

    **The receiver near by.** Real receivers are far less sensitive so close: without a `near_threshold`, the echo of
    the air outshines all but the nearest surfaces. Every preset has one with ``noise="datasheet"`` or ``"measured"``,
    none without noise. A scan in fog is refused without a `near_threshold`, unless the measurement has a
    `crossover`.

    A receiver with a `near_threshold` sees fog only where it is brighter than on average. Its power, x times the mean,
    is assumed to have Weibull's distribution, P(X > x) = exp(−(Γ(1 + 1/k)·x)^k) with the shape k = 0.7, that of clutter
    (M. Sekine, Y. Mao, Weibull Radar Clutter, 1990), independent in each length L = √(2π)·σ. Then the echoes that
    exceed the least intensity i(R) are a Poisson process along the beam of the density P(X > i/(W·R²))/L. The shape is
    an assumption: no measurement was found.

    **Rain and snow.** Drops and flakes are single echoes, a Poisson process along the beam; it widens from `aperture`
    by the divergence of the `Beam`, and is taken to be uniformly bright. One of the diameter D has the intensity
    `reflectance`·(πD²/4)/A(r)·ξ(r)·exp(−2αr), where A(r) is the section of the beam, but no more than a white diffuser.
    Only those are drawn that the `detection` limit and the `near_threshold` let through, and they are drawn exactly.
    Without a limit, these are the ones as bright as a target of reflectivity 0.1 at the `max_range` of the `Lidar`; a
    scan in rain by a sensor without either, below 1e154 m, is refused. The positions in one frame say nothing about
    those in the next. At most the 21 845 nearest of a pulse are drawn. With a `Beam`, each is in a sub-ray that is
    drawn by energy, and seen if that sub-ray has not met a surface before.

    With a `Beam`, an echo of the air and another nearer to it than `separation`, or than 2σ, are one: the stronger.

    Examples
    --------
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> wall = scene.add(ls.Plane((1, 0, 0), 30.0))
    >>> scene.atmosphere = ls.Atmosphere.fog(visibility=50.0, label=99)
    >>> pattern = ls.patterns.Grid([0.0], [0.0], rate=10.0)
    >>> lidar = ls.Lidar(pattern, measurement=ls.Measurement(crossover=(0.9, 1.0)))
    >>> scan = lidar.scan(scene)
    >>> ls.Source(scan.source[0, 0]).name, scan.range.round(2), scan.label
    ('atmosphere', array([[1.27]]), array([[99]], dtype=uint32))
    """

    extinction: float = 0.0
    backscatter: float = 0.0
    intercept: float = 0.0
    slope: float = 1.0
    reflectance: float = 1.0
    label: int = 0
    aperture: float = 0.01
    divergence: float = 0.003

    def __post_init__(self) -> None:
        """Check the arguments."""
        for name in ("extinction", "backscatter", "intercept", "reflectance"):
            object.__setattr__(self, name, real(name, getattr(self, name), at_least=0.0))
        for name in ("slope", "aperture"):
            object.__setattr__(self, name, real(name, getattr(self, name), above=0.0))
        object.__setattr__(self, "label", integer("label", self.label, at_least=0, at_most=UINT32))
        object.__setattr__(self, "divergence", beam_angle("divergence", self.divergence))

    @classmethod
    def fog(cls, visibility: float, *, label: int = 0) -> Self:
        """Return fog of a visibility.

        Parameters
        ----------
        visibility : float
            Meteorological optical range V, m, > 0: the way on which light falls to 5 %.
        label : int
            Label of its echoes.

        Returns
        -------
        Atmosphere
            α = −ln 0.05/V = 2.996/V (H. Koschmieder, Theorie der horizontalen Sichtweite, 1924) and β = 0.046 sr⁻¹/V
            (Rasshofer et al. 2011).

        Raises
        ------
        TypeError, ValueError
            If an argument is out of its range.

        Examples
        --------
        >>> import lidarsim as ls
        >>> ls.Atmosphere.fog(visibility=50.0)
        Atmosphere(extinction=0.0599, backscatter=0.00092)
        """
        visibility = real("visibility", visibility, above=0.0)
        extinction, backscatter = -math.log(CONTRAST) / visibility, FOG_BACKSCATTER / visibility
        if not math.isfinite(extinction):
            raise ArgumentValueError("visibility", "a visibility with a finite extinction", visibility)
        return cls(extinction=extinction, backscatter=backscatter, label=label)

    @classmethod
    def rain(cls, rate: float, *, label: int = 0) -> Self:
        """Return rain of a rate.

        Parameters
        ----------
        rate : float
            Rainfall rate R, mm/h, > 0 and at most 200: light rain has 1, heavy rain 10, a cloudburst 50.
        label : int
            Label of its echoes.

        Returns
        -------
        Atmosphere
            α = 0.01·R^0.6 per m (C. Goodin et al., Predicting the influence of rain on LIDAR in ADAS, Electronics 8,
            2019), and drops with N₀ = 8000 per m³ and mm and Λ = 4.1·R^−0.21 per mm (J. S. Marshall, W. M. Palmer, The
            distribution of raindrops with size, Journal of Meteorology 5, 1948). The `reflectance` of a drop, 0.0236,
            is that of the reflections on its near and its far side on the axis, the latter focused (H. C. van de
            Hulst, Light Scattering by Small Particles, 1957, chapter 12), at the refractive index 1.328 of 905 nm.

        Raises
        ------
        TypeError, ValueError
            If an argument is out of its range.

        Notes
        -----
        This α is far above that of the drops of Marshall and Palmer. Their cross-sections for extinction are twice the
        geometric ones and come to 8000·π/Λ³ mm² per m³: α is 0.0016 per m at 10 mm/h, not 0.040. To use it,
        ``dataclasses.replace`` the extinction.

        Examples
        --------
        >>> import lidarsim as ls
        >>> round(ls.Atmosphere.rain(10.0).extinction, 4)
        0.0398
        """
        rate = real("rate", rate, above=0.0, at_most=MOST_RAIN)
        return cls(
            extinction=0.01 * rate**0.6,
            intercept=8000.0 * 1e3,
            slope=4.1 * rate**-0.21 * 1e3,
            reflectance=DROP,
            label=label,
        )

    @classmethod
    def snow(cls, rate: float, *, label: int = 0) -> Self:
        """Return dry snow of a rate.

        Parameters
        ----------
        rate : float
            Rate R of the water that the snow melts to, mm/h, > 0 and at most 10: heavy snow has more than 4.
        label : int
            Label of its echoes.

        Returns
        -------
        Atmosphere
            α of 5.545·R^1.38 dB/km (Recommendation ITU-R P.1814, dry snow, at 905 nm), and flakes, by the diameter of
            the drop that they melt to, with N₀ = 2500·R^−0.94 per m³ and mm and Λ = 2.29·R^−0.45 per mm (R. S. Sekhon,
            R. C. Srivastava, Snow size spectra and radar reflectivity, Journal of the Atmospheric Sciences 27, 1970).
            A flake is taken to be a diffuse ball of reflectivity 0.9, which returns 2/3 of what a disk does, and of the
            density 100 kg/m³, which gives it 4.6 times the area of its drop: `reflectance` is 2.78.

        Raises
        ------
        TypeError, ValueError
            If an argument is out of its range.

        Examples
        --------
        >>> import lidarsim as ls
        >>> round(ls.Atmosphere.snow(2.0).extinction, 5)
        0.00332
        """
        rate = real("rate", rate, above=0.0, at_most=MOST_SNOW)
        decibels_per_km = (5.42e-5 * 905.0 + 5.4958776) * rate**1.38
        return cls(
            extinction=decibels_per_km * math.log(10.0) / 10.0 / 1e3,
            intercept=2500.0 * rate**-0.94 * 1e3,
            slope=2.29 * rate**-0.45 * 1e3,
            reflectance=FLAKE,
            label=label,
        )

    def fog_echo(self, lidar: Sensor) -> tuple[float, float] | None:
        """Return the mean echo of fog in front of no surface.

        A sensor without a `near_threshold` reports it; one with it only what exceeds the threshold (`patches_seen`).

        Parameters
        ----------
        lidar : Lidar
            The sensor.

        Returns
        -------
        tuple of float, or None
            Its range R, m, and its intensity W·R²; None without backscatter.

        Raises
        ------
        TypeError, ValueError
            If `lidar` is not a Lidar, or cannot be used in this air; see the notes above.

        Examples
        --------
        >>> import lidarsim as ls
        >>> lidar = ls.Lidar.preset("hesai-pandar64", noise="datasheet")
        >>> [round(number, 4) for number in ls.Atmosphere.fog(50.0).fog_echo(lidar)]
        [0.4994, 0.0014]
        """
        check_sensor(self, lidar)
        echo, _ = _native.air_echoes(lidar, self)
        return None if echo is None else (echo[0], echo[1] * echo[0] ** 2)

    def patches_seen(self, lidar: Sensor) -> float:
        """Return how many echoes of fog a sensor with a `near_threshold` detects per pulse, in front of no surface.

        Parameters
        ----------
        lidar : Lidar
            The sensor.

        Returns
        -------
        float
            The mean number, before drop-out, fluctuation of the power and range gate; 0 without a `near_threshold`.

        Raises
        ------
        TypeError, ValueError
            If `lidar` is not a Lidar, or cannot be used in this air; see the notes above.

        Examples
        --------
        >>> import lidarsim as ls
        >>> lidar = ls.Lidar.preset("hesai-pandar64", noise="datasheet")
        >>> round(ls.Atmosphere.fog(50.0).patches_seen(lidar), 3)
        0.15
        """
        check_sensor(self, lidar)
        return _native.air_echoes(lidar, self)[1][0]

    def particles_seen(self, lidar: Sensor) -> float:
        """Return how many drops or flakes a sensor detects per pulse, on average, in front of no surface.

        Parameters
        ----------
        lidar : Lidar
            The sensor.

        Returns
        -------
        float
            The mean number, before drop-out and range gate, and with a fluctuation of the power or a soft detection
            limit more than are detected.

        Raises
        ------
        TypeError, ValueError
            If `lidar` is not a Lidar, or cannot be used in this air; see the notes above.

        Examples
        --------
        >>> import lidarsim as ls
        >>> lidar = ls.Lidar.preset("hesai-pandar64", noise="datasheet")
        >>> round(ls.Atmosphere.snow(1.0).particles_seen(lidar), 3)
        0.184
        """
        check_sensor(self, lidar)
        return _native.air_echoes(lidar, self)[1][1]

    def __repr__(self) -> str:
        """Return the values that are not the default."""
        defaults = type(self)()
        values = {name: value for name, value in self._contents().items() if value != getattr(defaults, name)}
        return f"Atmosphere({', '.join(f'{name}={value:.3g}' for name, value in values.items())})"


def check_sensor(atmosphere: Atmosphere | None, lidar: Sensor, *, of: str = "") -> None:
    """Raise an error if a sensor lacks what it needs in this air.

    Parameters
    ----------
    atmosphere : Atmosphere or None
        The air.
    lidar : Lidar
        The sensor.
    of : str
        Text that errors append to the name of the missing argument.

    Raises
    ------
    TypeError
        If `lidar` is not a Lidar.
    ValueError
        In fog without a threshold near the sensor or a crossover, or without a range from which on the receiver sees
        it, or in rain or snow without a limit of what it sees.
    """
    if atmosphere is None:
        return
    if not isinstance(lidar, Sensor):
        raise ArgumentTypeError("lidar", "a Lidar", short_repr(lidar))
    measurement = lidar.measurement
    is_bare = measurement.near_threshold == 0.0 and measurement.crossover is None
    if atmosphere.backscatter > 0.0 and is_bare:
        hint = (
            'a preset has one with the noise "datasheet"; give a sensor of your own 0.01, a near range of 20 m and a'
            " minimum range > 0; or, to see all of the fog from a range on, a crossover such as 0.9 to 1 m"
        )
        raise ArgumentValueError(f"near_threshold{of}", "a number > 0 in fog", 0.0, hint)
    begins = measurement.crossover[0] if measurement.crossover else 0.0
    if atmosphere.backscatter > 0.0 and begins == 0.0 and lidar.min_range == 0.0:
        hint = (
            "or give the measurement a crossover that begins beyond 0, such as 0.3 to 1 m: at the sensor, the echo of"
            " fog is infinite"
        )
        raise ArgumentValueError(f"min_range{of}", "a number > 0 in fog", 0.0, hint)
    farthest = lidar.max_range if measurement.detection is None else measurement.detection.range
    if atmosphere.intercept > 0.0 and farthest * farthest == math.inf:
        got = measurement.detection and repr(measurement.detection)
        hint = "or a maximum range below that; without either, each of the countless drops in the beam would be an echo"
        raise ArgumentValueError(f"detection{of}", "a detection limit below 1e154 m in rain or snow", got, hint)
