"""Directions to the beacons from baselines and attitudes, with their errors.

The equations are [W18] (3)-(11) with the corrections of docs/explanation/errata.md. The path from the telescope to the
light, in n, is

    W = baseline + rotation_nb · light lever - rotation_nd · (theodolite lever + rotation_dm · N')

with n horizon (North, Up, East), d deck, m main frame of the theodolite, b drone (nose, up, right). Terrestrial
refraction raises the light by the angle k/(2 R) times the *horizontal* distance; on a level path of length d this is
k d²/(2 R) in height. Refraction vanishes at the zenith, because layers of air do not bend a vertical ray.

Each error is a named :class:`ErrorTerm` in its natural axes.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ship_geometry.mount.image import block_diagonal, flatten_exposures
from ship_geometry.rotations import FloatArray
from ship_kernels import compiled_pointing

EARTH_RADIUS_M = 6_371_000.0
"""Mean radius of the Earth, m; its error is negligible against the error of the refraction coefficient."""

BASELINE, LEVER, PRINCIPAL_POINT, BEACON_LEVER, SHIP_ROTATION, DRONE_ROTATION, REFRACTION = (
    *(slice(start, start + 3) for start in range(0, 18, 3)),
    slice(18, 19),
)
"""Columns of :attr:`LinesOfSight.jacobian_n`."""

TERM_COLUMNS = {
    "rtk_noise": BASELINE,
    "rtk_bias": BASELINE,
    "rtk_base": BASELINE,
    "theodolite_lever": LEVER,
    "principal_point": PRINCIPAL_POINT,
    "light_lever": BEACON_LEVER,
    "ship_attitude": SHIP_ROTATION,
    "drone_attitude": DRONE_ROTATION,
    "refraction": REFRACTION,
    "light_refraction": REFRACTION,
}
"""Columns of each error term in :attr:`LinesOfSight.jacobian_n`."""


@dataclass(frozen=True)
class LeverArm:
    """A surveyed vector in the axes of the device that carries it.

    Attributes:
        vector_m: vector, shape (3,), or vectors for N lights, shape (N, 3).
        sigma_m: standard deviation of each component, shape of ``vector_m`` or (3,).
    """

    vector_m: FloatArray
    sigma_m: FloatArray


@dataclass(frozen=True)
class BeaconPoses:
    """Measured poses of N beacons at the middle of an exposure.

    Attributes:
        baseline_n: vectors from the ship's antenna to the drones' antennas, m, shape (..., N, 3).
        baseline_covariance_n: covariance of each baseline's white error, which is independent of other beacons, m²,
            shape (..., N, 3, 3).
        rotation_nb: horizon from drone, shape (..., N, 3, 3).
        attitude_covariance_n: covariance of the drone's attitude, rotation vector in n, rad², shape (..., N, 3, 3).
    """

    baseline_n: FloatArray
    baseline_covariance_n: FloatArray
    rotation_nb: FloatArray
    attitude_covariance_n: FloatArray


@dataclass(frozen=True)
class Ship:
    """Attitude of ship and theodolite at the middle of an exposure.

    Attributes:
        rotation_nd: horizon from deck, shape (..., 3, 3).
        attitude_covariance_n: covariance of the ship's attitude, rotation vector in n, rad², shape (..., 3, 3).
        rotation_dm: deck from main frame, shape (..., 3, 3); an accuracy of one degree suffices.
    """

    rotation_nd: FloatArray
    attitude_covariance_n: FloatArray
    rotation_dm: FloatArray


@dataclass(frozen=True)
class Survey:
    """Surveyed quantities and their errors, which are constant or correlated in time.

    Attributes:
        theodolite_lever: vector from the ship's antenna to the intersection of the theodolite's axes, in the deck.
        principal_point: vector from this intersection to the principal point N' of the telescope's lens, in the main
            frame. The error of this vector shifts beacons at equal distances equally and then appears in no residual.
        beacon_lever: vector from the drone's antenna to its light, in the drone's frame.
        rtk_base_sigma_m: sigma of the error common to all baselines (N, U, E), due to the ship's antenna, shape (3,).
        rtk_bias_sigma_m: sigma of the correlated error of each baseline (N, U, E), shape (3,) or (N, 3).
        refraction_coefficient: k of the air near the sea, about 0.13, common or for each beacon, shape (..., N).
        refraction_sigma: sigma of the error of k common to all beacons.
        refraction_beacon_sigma: sigma of the further error of k on the path to each beacon, common or shape (..., N).
    """

    theodolite_lever: LeverArm
    principal_point: LeverArm
    beacon_lever: LeverArm
    rtk_base_sigma_m: FloatArray
    rtk_bias_sigma_m: FloatArray
    refraction_coefficient: FloatArray | float
    refraction_sigma: float
    refraction_beacon_sigma: FloatArray | float


@dataclass(frozen=True)
class ErrorTerm:
    """One error of the lines of sight: true value minus used value, in the natural axes of the quantity.

    The true direction is the used direction plus ``jacobian_n`` times the error.

    Attributes:
        name: name of the error.
        source: source of the error in the error budget.
        is_common: True if one error affects all directions; False if each beacon has an independent error.
        jacobian_n: derivative of the unit directions with respect to the error, rad per unit, shape (..., N, 3, k).
        covariance: covariance of the error, shape (..., k, k) if common, (..., N, k, k) if not; or (k, k) in both
            cases.
    """

    name: str
    source: str
    is_common: bool
    jacobian_n: FloatArray
    covariance: FloatArray

    def direction_covariance_n(self) -> FloatArray:
        """Return the joint covariance of all directions, in the order of the beacons, rad², shape (..., 3 N, 3 N)."""
        beacon_count = self.jacobian_n.shape[-3]
        leading = self.jacobian_n.shape[:-3]
        if self.is_common:
            rows = self.jacobian_n.reshape(*leading, 3 * beacon_count, -1)
            return rows @ self.covariance @ np.swapaxes(rows, -1, -2)
        return block_diagonal(self.jacobian_n @ self.covariance @ np.swapaxes(self.jacobian_n, -1, -2))


@dataclass(frozen=True)
class LinesOfSight:
    """Lines of sight to the beacons.

    Attributes:
        direction_n: unit vectors from the telescope, refraction included, shape (..., N, 3).
        distance_m: distances to the beacons, shape (..., N).
        jacobian_n: derivative of the unit directions with respect to the errors of :data:`TERM_COLUMNS`, rad per unit,
            shape (..., N, 3, 19).
        beacons: poses of the beacons.
        ship: attitude of ship and theodolite.
        survey: surveyed quantities.
    """

    direction_n: FloatArray
    distance_m: FloatArray
    jacobian_n: FloatArray
    beacons: BeaconPoses
    ship: Ship
    survey: Survey

    @cached_property
    def terms(self) -> tuple[ErrorTerm, ...]:
        """Independent errors of the directions."""
        beacons, ship, survey = self.beacons, self.ship, self.survey
        own, common = False, True

        def term(name: str, source: str, is_common: bool, covariance: FloatArray) -> ErrorTerm:
            return ErrorTerm(name, source, is_common, self.jacobian_n[..., TERM_COLUMNS[name]], covariance)

        lever_m, lens_m = survey.theodolite_lever.sigma_m, survey.principal_point.sigma_m
        return (
            term("rtk_noise", "rtk", own, beacons.baseline_covariance_n),
            term("rtk_bias", "rtk", own, _diagonal(survey.rtk_bias_sigma_m)),
            term("rtk_base", "rtk", common, _diagonal(survey.rtk_base_sigma_m)),
            term("theodolite_lever", "lever_arms", common, _diagonal(lever_m)),
            term("principal_point", "lever_arms", common, _diagonal(lens_m)),
            term("light_lever", "lever_arms", own, _diagonal(survey.beacon_lever.sigma_m)),
            term("ship_attitude", "ship_attitude", common, ship.attitude_covariance_n),
            term("drone_attitude", "drone_attitude", own, beacons.attitude_covariance_n),
            term("refraction", "refraction", common, np.array([[survey.refraction_sigma**2]])),
            term("light_refraction", "refraction", own, _one_by_one(survey.refraction_beacon_sigma)),
        )


def lines_of_sight(beacons: BeaconPoses, ship: Ship, survey: Survey) -> LinesOfSight:
    """Return the directions to the beacons with their errors.

    Example:
        A drone with RTK noise of 2 cm hovers 2 km ahead of the antenna; refraction raises it by k d / (2 R):

        >>> none = LeverArm(np.zeros(3), np.zeros(3))
        >>> beacons = BeaconPoses(np.array([[2000.0, 0.0, 0.0]]), 4e-4 * np.eye(3), np.eye(3)[None], np.zeros((3, 3)))
        >>> ship = Ship(np.eye(3), np.zeros((3, 3)), np.eye(3))
        >>> survey = Survey(none, none, none, np.zeros(3), np.zeros(3), 0.13, 0.0, 0.0)
        >>> lines = lines_of_sight(beacons, ship, survey)
        >>> print(lines.direction_n[0].round(7), lines.distance_m)
        [1.00e+00 2.04e-05 0.00e+00] [2000.]
        >>> print(np.sqrt(covariance_by_source(lines.terms)["rtk"].diagonal()).round(7))  # rad
        [0.e+00 1.e-05 1.e-05]
    """
    leading, count = beacons.baseline_n.shape[:-2], beacons.baseline_n.shape[-2]
    found = compiled_pointing.sight_lines(
        flatten_exposures(beacons.baseline_n, leading, (count, 3)),
        flatten_exposures(beacons.rotation_nb, leading, (count, 3, 3)),
        flatten_exposures(survey.beacon_lever.vector_m, leading, (count, 3)),
        flatten_exposures(ship.rotation_nd, leading, (3, 3)),
        flatten_exposures(ship.rotation_dm, leading, (3, 3)),
        survey.theodolite_lever.vector_m,
        survey.principal_point.vector_m,
        flatten_exposures(survey.refraction_coefficient, leading, (count,)),
        EARTH_RADIUS_M,
    )
    direction_n, distance_m, jacobian_n = (of_all.reshape(*leading, *of_all.shape[1:]) for of_all in found)
    return LinesOfSight(direction_n, distance_m, jacobian_n, beacons, ship, survey)


def covariance_by_source(terms: Iterable[ErrorTerm]) -> dict[str, FloatArray]:
    """Return the joint covariance of all directions by error source, rad², shape (..., 3 N, 3 N) each.

    Example:
        >>> noise, bias = (
        ...     ErrorTerm(name, "rtk", False, np.eye(3)[None], variance * np.eye(3))
        ...     for name, variance in {"noise": 1.0, "bias": 3.0}.items()
        ... )
        >>> covariance_by_source([noise, bias])["rtk"].diagonal().tolist()
        [4.0, 4.0, 4.0]
    """
    parts: dict[str, FloatArray] = {}
    for term in terms:
        covariance = term.direction_covariance_n()
        parts[term.source] = parts[term.source] + covariance if term.source in parts else covariance
    return parts


def _diagonal(sigma: FloatArray) -> FloatArray:
    """Return the covariance (..., 3, 3) of independent components."""
    return np.asarray(sigma, dtype=float)[..., None] ** 2 * np.eye(3)


def _one_by_one(sigma: FloatArray | float) -> FloatArray:
    """Return the covariance (..., 1, 1) of one number."""
    return np.asarray(sigma, dtype=float)[..., None, None] ** 2
