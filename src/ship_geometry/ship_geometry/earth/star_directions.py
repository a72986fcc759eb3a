"""Directions of catalogue stars in the horizon of a moving ship: ICRS → (North, Up, East), without refraction.

ERFA computes the steps of docs/explanation/stars.md: proper motion and parallax, light deflection by the Sun, annual
aberration, bias-precession-nutation (IAU 2006/2000A), Earth rotation with UT1, polar motion, diurnal aberration. The
last step is the aberration by the velocity of the ship (10 mas at 15 m/s). Refraction is added by
:mod:`ship_geometry.air.refraction`.

:func:`directions` computes all steps for each time. :class:`RefreshedSky` computes the slow steps once in ten seconds,
which is several times faster. The two agree within 0.1 mas for stars more than 5° from the Sun.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_geometry.earth.earth_orientation import EarthOrientation, EarthOrientationTable
from ship_geometry.earth.geodetic import GeodeticPosition, rotation_horizon_from_ecef
from ship_geometry.earth.time_scales import SECOND_NS, JulianDate, TimeNs, julian_date, tt_julian_date
from ship_geometry.late_libraries import erfa
from ship_geometry.rotations import FloatArray

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
REFRESH_PERIOD_NS = 10 * SECOND_NS
"""Period of the slow steps, ns; in this time the annual aberration changes by 0.04 mas."""

_J2000 = 2_451_545.0
_JULIAN_YEAR_D = 365.25
_INTERVALS_KEPT = 4

_NO_REFRACTION = 0.0
"""Value of ERFA's refraction constants for no air; refraction is computed in :mod:`ship_geometry.air.refraction`."""


@dataclass(frozen=True)
class StarPositions:
    """Places and motions of stars in the ICRS at epoch J2000.0, as ERFA needs them; all arrays have one shape.

    Attributes:
        right_ascension: right ascension, rad.
        declination: declination, rad.
        pm_right_ascension: proper motion dα/dt, rad/year, **not** multiplied by cos δ.
        pm_declination: proper motion dδ/dt, rad/year.
        parallax_arcsec: parallax, not negative.
    """

    right_ascension: FloatArray
    declination: FloatArray
    pm_right_ascension: FloatArray
    pm_declination: FloatArray
    parallax_arcsec: FloatArray

    def __getitem__(self, index: Any) -> StarPositions:
        """Return the stars selected by an index, a slice or a mask."""
        return StarPositions(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def fixed_stars(right_ascension: FloatArray, declination: FloatArray) -> StarPositions:
    """Return stars without proper motion and parallax.

    Args:
        right_ascension: right ascension in the ICRS at J2000.0, rad.
        declination: declination in the ICRS at J2000.0, rad.

    Example:
        >>> vega = fixed_stars(np.deg2rad(279.2347), np.deg2rad(38.7837))
        >>> print(float(vega.parallax_arcsec))
        0.0
    """
    alpha, delta = np.asarray(right_ascension, float), np.asarray(declination, float)
    if alpha.shape != delta.shape:
        alpha, delta = np.broadcast_arrays(alpha, delta)
    none = np.zeros(alpha.shape)
    return StarPositions(alpha, delta, none, none, none)


def stars_from_epoch(stars: StarPositions, epoch_year: float) -> StarPositions:
    """Return stars at J2000.0 from their places at another Julian epoch (Hipparcos: 1991.25).

    Radial velocities are assumed to be zero.

    Args:
        stars: places and motions at ``epoch_year``; parallaxes may be negative, because they are measurements.
        epoch_year: Julian year of the places.

    Example:
        Barnard's star moves by 10.3″ a year to the north, so by 90.4″ from 1991.25 to 2000:

        >>> mas = np.deg2rad(1e-3 / 3600.0)
        >>> alpha, delta = np.deg2rad(269.4540), np.deg2rad(4.6683)
        >>> then = StarPositions(alpha, delta, -798.6 * mas / np.cos(delta), 10_328.1 * mas, 0.5482)

        >>> print(((stars_from_epoch(then, 1991.25).declination - delta) / (1e3 * mas)).round(1))
        90.4
    """
    parallax_arcsec = np.maximum(stars.parallax_arcsec, 0.0)
    epoch_d = (epoch_year - 2000.0) * _JULIAN_YEAR_D
    with warnings.catch_warnings():
        # ERFA warns "distance overridden" for a star without parallax, which it places at a large distance as intended.
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        alpha, delta, pm_alpha, pm_delta, _, _ = erfa.pmsafe(
            stars.right_ascension,
            stars.declination,
            stars.pm_right_ascension,
            stars.pm_declination,
            parallax_arcsec,
            0.0,
            _J2000,
            epoch_d,
            _J2000,
            0.0,
        )
    return StarPositions(alpha, delta, pm_alpha, pm_delta, parallax_arcsec)


@dataclass(frozen=True)
class Observer:
    """Position and velocity of the sensor.

    Attributes:
        position: position on WGS 84, whose ellipsoid defines the horizon.
        velocity_n_m_per_s: velocity over ground (North, Up, East), shape (..., 3).
    """

    position: GeodeticPosition
    velocity_n_m_per_s: FloatArray = field(default_factory=lambda: np.zeros(3))


def directions(stars: StarPositions, time_ns: TimeNs, observer: Observer, orientation: EarthOrientation) -> FloatArray:
    """Return unit vectors (North, Up, East) to stars, without refraction; all steps are computed for each time.

    Args:
        stars: positions of the stars, shape (...).
        time_ns: one time or several. Times, places and orientations broadcast against the stars.
        observer: position and velocity of the sensor at these times.
        orientation: orientation of the Earth at these times.

    Returns:
        Unit vectors, shape (..., 3).

    Example:
        Beta Lyrae from the ship of [P15] at 2014-07-09 11:50:07.8 UTC. The paper gives an azimuth of 71.9528° and an
        elevation of 42.2207° without aberration and UT1:

        >>> from ship_geometry.earth.earth_orientation import earth_orientation_table
        >>> mas = np.deg2rad(1e-3 / 3600.0)
        >>> motion = 1.90 * mas / np.cos(0.5822885787), -3.53 * mas  # a year
        >>> hip_92420 = StarPositions(4.9309037606, 0.5822885787, *motion, parallax_arcsec=0.00339)

        >>> time_ns = 1_404_906_607_800_000_000
        >>> ship = Observer(GeodeticPosition(np.deg2rad(31.945213), np.deg2rad(120.293086), height_m=0.0))

        >>> orientation = earth_orientation_table().at(time_ns)
        >>> north, up, east = directions(stars_from_epoch(hip_92420, 1991.25), time_ns, ship, orientation)
        >>> print(np.rad2deg([np.arctan2(east, north), np.arcsin(up)]).round(4))  # azimuth, elevation
        [71.9496 42.2137]
    """
    tt = tt_julian_date(time_ns)
    heliocentric, barycentric = erfa.epv00(*tt)
    astrom = erfa.apco(
        *tt,
        barycentric,
        heliocentric["p"],
        *erfa.xys06a(*tt),
        *_site(time_ns, observer, orientation),
        erfa.sp00(*tt),
        _NO_REFRACTION,
        _NO_REFRACTION,
    )
    return _horizon_directions(stars, astrom, astrom, observer)


@dataclass(frozen=True)
class _SlowSteps:
    """Results of the slow steps: ERFA's parameters from ICRS to CIRS at the geocentre, and Earth orientation."""

    to_cirs: Any
    orientation: EarthOrientation
    tio_locator: FloatArray


class RefreshedSky:
    """Directions of stars; the slow steps are computed once in 10 s, Earth rotation and ship's place for each time.

    The slow steps are computed for the middle of fixed intervals, so a direction does not depend on earlier calls. Leap
    seconds are between two intervals.

    ERFA's short cut, ``apco13`` refreshed by ``aper13``, is not used. The short cut keeps the observer's first place,
    which gives an error of 5″ or more after the ship has moved by 150 m.

    Args:
        table: table of Earth orientation parameters.

    Example:
        Vega over a ship at 45° N, 150° E, on 2014-07-09 at 11:50:07.8 UTC:

        >>> from ship_geometry.earth.earth_orientation import earth_orientation_table
        >>> sky = RefreshedSky(earth_orientation_table())
        >>> vega = fixed_stars(np.deg2rad(279.2347), np.deg2rad(38.7837))
        >>> ship = Observer(GeodeticPosition(np.deg2rad(45.0), np.deg2rad(150.0), height_m=0.0))
        >>> _, up, _ = sky.directions(vega, 1_404_906_607_800_000_000, ship)
        >>> print(f"elevation {np.rad2deg(np.arcsin(up)):.2f} deg")
        elevation 70.83 deg
    """

    def __init__(self, table: EarthOrientationTable) -> None:
        self._table = table
        self._slow_steps: dict[int, _SlowSteps] = {}

    def directions(self, stars: StarPositions, time_ns: int, observer: Observer) -> FloatArray:
        """Return unit vectors (North, Up, East) to stars, without refraction, shape (..., 3).

        Raises:
            OutsideEarthOrientation: the table has no value for this time.
        """
        slow = self._slow_steps_at(time_ns)
        to_horizon = erfa.apio(
            slow.tio_locator, *_site(time_ns, observer, slow.orientation), _NO_REFRACTION, _NO_REFRACTION
        )
        return _horizon_directions(stars, slow.to_cirs, to_horizon, observer)

    def rotation_horizon_from_icrs(self, time_ns: int, position: GeodeticPosition) -> FloatArray:
        """Return the rotation "horizon (North, Up, East) from ICRS", shape (3, 3).

        The rotation is for the axes of a body, and does not include aberration, which shifts directions of stars only.

        Raises:
            OutsideEarthOrientation: the table has no value for this time.
        """
        slow = self._slow_steps_at(time_ns)
        polar_motion = erfa.pom00(slow.orientation.pole_x, slow.orientation.pole_y, slow.tio_locator)
        earth_rotation = erfa.era00(*_ut1(time_ns, slow.orientation))
        rotation_ec = erfa.c2tcio(slow.to_cirs["bpn"], earth_rotation, polar_motion)
        rotation_nc: FloatArray = rotation_horizon_from_ecef(position.latitude, position.longitude) @ rotation_ec
        return rotation_nc

    def orientation(self, time_ns: int) -> EarthOrientation:
        """Return the Earth orientation that is used at a time, with its standard deviations."""
        return self._slow_steps_at(time_ns).orientation

    def _slow_steps_at(self, time_ns: int) -> _SlowSteps:
        index = time_ns // REFRESH_PERIOD_NS
        slow = self._slow_steps.get(index)
        if slow is None:
            middle_ns = index * REFRESH_PERIOD_NS + REFRESH_PERIOD_NS // 2
            tt = tt_julian_date(middle_ns)
            slow = _SlowSteps(erfa.apci13(*tt)[0], self._table.at(middle_ns), erfa.sp00(*tt))
            self._slow_steps[index] = slow
            if len(self._slow_steps) > _INTERVALS_KEPT:
                del self._slow_steps[next(iter(self._slow_steps))]
        return slow


def _ut1(time_ns: TimeNs, orientation: EarthOrientation) -> JulianDate:
    return julian_date(time_ns, orientation.ut1_minus_utc_s)


def _site(time_ns: TimeNs, observer: Observer, orientation: EarthOrientation) -> tuple[Any, ...]:
    """Return Earth rotation angle, place and pole in the order of ERFA's arguments, rad and m."""
    place = observer.position
    angle = erfa.era00(*_ut1(time_ns, orientation))
    return angle, place.longitude, place.latitude, place.height_m, orientation.pole_x, orientation.pole_y


def _horizon_directions(stars: StarPositions, to_cirs: Any, to_horizon: Any, observer: Observer) -> FloatArray:
    """Return unit vectors (North, Up, East) by the steps ICRS to CIRS, CIRS to horizon, aberration by the ship."""
    # atciqz would neglect proper motion and parallax.
    cirs_alpha, cirs_delta = erfa.atciq(
        stars.right_ascension,
        stars.declination,
        stars.pm_right_ascension,
        stars.pm_declination,
        stars.parallax_arcsec,
        0.0,
        to_cirs,
    )
    azimuth, zenith_distance, *_ = erfa.atioq(cirs_alpha, cirs_delta, to_horizon)
    beta = observer.velocity_n_m_per_s / SPEED_OF_LIGHT_M_PER_S
    horizontal = np.sin(zenith_distance)
    direction = np.empty((*horizontal.shape, 3))
    direction[..., 0] = np.cos(azimuth) * horizontal
    direction[..., 1] = np.cos(zenith_distance)
    direction[..., 2] = np.sin(azimuth) * horizontal
    # Aberration to first order: beta² is 1e-15, and the product of beta and the Earth's velocity is 1 µas.
    direction += beta
    unit: FloatArray = direction / np.sqrt(np.einsum("...i,...i->...", direction, direction))[..., None]
    return unit
