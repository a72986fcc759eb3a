"""Where a catalogue star stands in the horizon of a moving ship: ICRS → (North, Up, East), without refraction.

The chain is that of docs/explanation/stars.md, all of it ERFA's: proper motion and parallax, light deflection by the
Sun, annual aberration, bias-precession-nutation (IAU 2006/2000A), Earth rotation with UT1, polar motion, diurnal
aberration. The ship's own velocity comes last (10 mas at 15 m/s). :mod:`ship_geometry.refraction` adds the air.

There are two ways. :func:`directions` does all steps at each moment. :class:`RefreshedSky` does the slow steps once for
ten seconds; it is several times faster, and within 0.1 mas as long as the Sun is more than 5° away.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_geometry import late_erfa as erfa
from ship_geometry.earth_orientation import EarthOrientation, EarthOrientationTable
from ship_geometry.geodetic import GeodeticPosition, rotation_horizon_from_ecef
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS, JulianDate, TimeNs, julian_date, tt_julian_date

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
REFRESH_PERIOD_NS = 10 * SECOND_NS
"""The annual aberration changes by 0.04 mas in this time."""

_J2000 = 2_451_545.0
_JULIAN_YEAR_D = 365.25
_EPOCHS_KEPT = 4

_NO_REFRACTION = 0.0
"""ERFA's refraction constants: the air is allowed for in :mod:`ship_geometry.refraction`."""


@dataclass(frozen=True)
class StarPositions:
    """Stars in the ICRS at epoch J2000.0, as ERFA wants them; arrays of one shape.

    Attributes:
        right_ascension: rad.
        declination: rad.
        pm_right_ascension: dα/dt, rad/year: **not** multiplied by cos δ.
        pm_declination: dδ/dt, rad/year.
        parallax_arcsec: not negative.
    """

    right_ascension: FloatArray
    declination: FloatArray
    pm_right_ascension: FloatArray
    pm_declination: FloatArray
    parallax_arcsec: FloatArray

    def __getitem__(self, index: Any) -> StarPositions:
        """The stars at an index or slice, or where a mask is true."""
        return StarPositions(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def fixed_stars(right_ascension: FloatArray, declination: FloatArray) -> StarPositions:
    """Stars without motion and parallax.

    Args:
        right_ascension: ICRS, J2000.0, rad.
        declination: ICRS, J2000.0, rad.

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
    """Stars at J2000.0 from their places at another Julian epoch (Hipparcos: 1991.25).

    Radial velocities are taken as zero.

    Args:
        stars: places and motions at ``epoch_year``; parallaxes may be negative, as measured ones are.
        epoch_year: Julian year.

    Example:
        Barnard's star moves by 10.4″ a year to the north, hence by 90.4″ from 1991.25 to 2000:

        >>> mas = np.deg2rad(1e-3 / 3600.0)
        >>> alpha, delta = np.deg2rad(269.4540), np.deg2rad(4.6683)
        >>> then = StarPositions(alpha, delta, -798.6 * mas / np.cos(delta), 10_328.1 * mas, 0.5482)
        >>> print(((stars_from_epoch(then, 1991.25).declination - delta) / (1e3 * mas)).round(1))
        90.4
    """
    parallax_arcsec = np.maximum(stars.parallax_arcsec, 0.0)
    epoch_d = (epoch_year - 2000.0) * _JULIAN_YEAR_D
    with warnings.catch_warnings():
        # "distance overridden": a star without parallax is put far away, which is what is meant.
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
    """Where the sensor is and how it moves over the Earth.

    Attributes:
        position: on WGS 84; the horizon is the ellipsoid's.
        velocity_n_m_per_s: over ground in (North, Up, East), shape (..., 3).
    """

    position: GeodeticPosition
    velocity_n_m_per_s: FloatArray = field(default_factory=lambda: np.zeros(3))


def directions(stars: StarPositions, time_ns: TimeNs, observer: Observer, orientation: EarthOrientation) -> FloatArray:
    """Unit vectors (North, Up, East) to stars, without refraction, by all steps at each moment.

    Args:
        stars: arrays of shape (...).
        time_ns: one moment or several. Moments, places and orientations broadcast against the stars.
        observer: where the sensor is at these moments.
        orientation: orientation of the Earth at these moments.

    Returns:
        Shape (..., 3).

    Example:
        Beta Lyrae from the ship of [P15], 2014-07-09 11:50:07.8 UTC (the paper prints azimuth 71.9528°, elevation
        42.2207°: it lacks aberration and UT1):

        >>> from ship_geometry.earth_orientation import earth_orientation_table
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
class _Epoch:
    """What changes slowly: the sky seen from the Earth's centre, and the orientation of the Earth."""

    to_cirs: Any
    orientation: EarthOrientation
    tio_locator: FloatArray


class RefreshedSky:
    """Directions moment by moment: the slow steps once per 10 s, Earth rotation and the ship's place each time.

    The slow steps are done for the middle of fixed intervals of time, so the result does not depend on what was asked
    before. Leap seconds fall between intervals.

    ERFA has a short cut, ``apco13`` refreshed by ``aper13``. It is not used, because it keeps the place of the first
    moment: a ship that has moved by 150 m is 6″ off.

    Args:
        table: orientation of the Earth.

    Example:
        Vega over a ship at 45° N, 150° E, on 2014-07-09 at 11:50:07.8 UTC:

        >>> from ship_geometry.earth_orientation import earth_orientation_table
        >>> sky = RefreshedSky(earth_orientation_table())
        >>> vega = fixed_stars(np.deg2rad(279.2347), np.deg2rad(38.7837))
        >>> ship = Observer(GeodeticPosition(np.deg2rad(45.0), np.deg2rad(150.0), height_m=0.0))
        >>> _, up, _ = sky.directions(vega, 1_404_906_607_800_000_000, ship)
        >>> print(f"elevation {np.rad2deg(np.arcsin(up)):.2f} deg")
        elevation 70.83 deg
    """

    def __init__(self, table: EarthOrientationTable) -> None:
        self._table = table
        self._epochs: dict[int, _Epoch] = {}

    def directions(self, stars: StarPositions, time_ns: int, observer: Observer) -> FloatArray:
        """Unit vectors (N, U, E) without refraction, shape (..., 3).

        Raises:
            OutsideEarthOrientation: the table has no value for this moment.
        """
        epoch = self._epoch(time_ns)
        to_horizon = erfa.apio(
            epoch.tio_locator, *_site(time_ns, observer, epoch.orientation), _NO_REFRACTION, _NO_REFRACTION
        )
        return _horizon_directions(stars, epoch.to_cirs, to_horizon, observer)

    def rotation_horizon_from_icrs(self, time_ns: int, position: GeodeticPosition) -> FloatArray:
        """Rotation "horizon (North, Up, East) from ICRS", shape (3, 3).

        It turns axes, as those of a body; aberration, which bends directions, is not in it.

        Raises:
            OutsideEarthOrientation: the table has no value for this moment.
        """
        epoch = self._epoch(time_ns)
        polar_motion = erfa.pom00(epoch.orientation.pole_x, epoch.orientation.pole_y, epoch.tio_locator)
        earth_rotation = erfa.era00(*_ut1(time_ns, epoch.orientation))
        rotation_ec = erfa.c2tcio(epoch.to_cirs["bpn"], earth_rotation, polar_motion)
        rotation_nc: FloatArray = rotation_horizon_from_ecef(position.latitude, position.longitude) @ rotation_ec
        return rotation_nc

    def orientation(self, time_ns: int) -> EarthOrientation:
        """Earth orientation used at a moment, with its error."""
        return self._epoch(time_ns).orientation

    def _epoch(self, time_ns: int) -> _Epoch:
        index = time_ns // REFRESH_PERIOD_NS
        epoch = self._epochs.get(index)
        if epoch is None:
            middle_ns = index * REFRESH_PERIOD_NS + REFRESH_PERIOD_NS // 2
            tt = tt_julian_date(middle_ns)
            epoch = _Epoch(erfa.apci13(*tt)[0], self._table.at(middle_ns), erfa.sp00(*tt))
            self._epochs[index] = epoch
            if len(self._epochs) > _EPOCHS_KEPT:
                del self._epochs[next(iter(self._epochs))]
        return epoch


def _ut1(time_ns: TimeNs, orientation: EarthOrientation) -> JulianDate:
    return julian_date(time_ns, orientation.ut1_minus_utc_s)


def _site(time_ns: TimeNs, observer: Observer, orientation: EarthOrientation) -> tuple[Any, ...]:
    """How the ship lies in space, in the order of ERFA's arguments: Earth rotation angle, place and pole, rad and m."""
    place = observer.position
    angle = erfa.era00(*_ut1(time_ns, orientation))
    return angle, place.longitude, place.latitude, place.height_m, orientation.pole_x, orientation.pole_y


def _horizon_directions(stars: StarPositions, to_cirs: Any, to_horizon: Any, observer: Observer) -> FloatArray:
    """Unit vectors: ICRS → intermediate frame CIRS → (North, Up, East) → aberration by the ship's own velocity."""
    # atciq, not atciqz: only the former knows proper motion and parallax.
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
    # Aberration to first order: the square of beta is 1e-15, its product with the Earth's velocity 1 µas.
    direction += beta
    unit: FloatArray = direction / np.sqrt(np.einsum("...i,...i->...", direction, direction))[..., None]
    return unit
