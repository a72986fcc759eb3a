"""Attitude of a sensor from one exposure, attitude of the deck from several exposures, and the rejected stars.

The attitude itself is computed in :mod:`ship_stars.attitude_from_stars.solution`, for both from the star vectors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate

import numpy as np

from ship_attitude_star.star_attitude.config import ObservingSensorConfig
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import FloatArray
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars, square_roots
from ship_stars.attitude_from_stars.exposure import StarExposure, visible_stars
from ship_stars.attitude_from_stars.field_scale import check_focal_length
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.attitude_from_stars.solution import SolutionStatus, StarSolution, invalid_solution, solve_with_fallback
from ship_stars.camera.camera import tangent_basis
from ship_stars.camera.config import JOINT
from ship_stars.sky.sky_model import SkyModel

_IDENTITY: FloatArray = np.eye(3)
_AGAINST_INS = "the stars are consistent with each other, but not with ins/imu"


@dataclass(frozen=True)
class RejectedStar:
    """A star that is not part of a solution.

    Attributes:
        source: name of the sensor that measured the star, ``star.<id>``.
        time_ns: stamp of the exposure.
        name: name of the star for texts.
        rejection: reason of the rejection.
        residual: measured minus predicted direction, up and right in the sensor, rad; empty for a star that was not
            compared.
        sigma: standard deviation of each residual component, rad; NaN for a star that was not compared.
    """

    source: str
    time_ns: int
    name: str
    rejection: Rejection
    residual: tuple[float, ...] = ()
    sigma: float = float("nan")


@dataclass(frozen=True)
class AttitudeSolution:
    """Attitude of a sensor from stars, or attitude of the deck from stars of several sensors.

    Attributes:
        sensor_id: id of the sensor, or JOINT.
        time_ns: time of validity, which is the stamp of the exposure, or of the first exposure for a joint solution.
        solution: attitude and status.
        rejected_stars: stars that are not part of the solution; of a joint solution, only those that the solutions of
            the sensors did not reject.
        sources: names of the sensors whose stars are used, ``star.<id>``.
        text: remark for the user; mostly empty.
    """

    sensor_id: str
    time_ns: int
    solution: StarSolution
    rejected_stars: tuple[RejectedStar, ...]
    sources: tuple[str, ...]
    text: str = ""

    @property
    def is_valid(self) -> bool:
        """True if there is an attitude."""
        return self.solution.status is not SolutionStatus.INVALID


@dataclass
class StarOutcome:
    """Outcome of one input of the core.

    Attributes:
        rejection: rejection of the input, or remark about it; None if the input was used or is pending.
        solved: solutions to publish, in order.
        not_joined: exposures (source, stamp) that arrived too late for the joint solution of their time.
    """

    rejection: Rejection | None = None
    solved: list[AttitudeSolution] = field(default_factory=list)
    not_joined: list[tuple[str, int]] = field(default_factory=list)


@dataclass(frozen=True)
class PlacedExposure:
    """An exposure with the apparent directions of its stars.

    Attributes:
        source: name of the sensor, ``star.<id>``.
        time_ns: stamp of the exposure.
        exposure: the usable stars.
        stars: the usable stars with measured and apparent directions; None if the exposure is rejected as a whole.
        rejected_stars: stars rejected before the solution of the sensor or by this solution.
        turn_variance: variance of an error that rotates all directions equally, each axis, rad². This error remains
            after the correction for the motion during the exposure; the INS noise is not included.
        rotation_ds: for a joint solution, rotation "deck at the common time from sensor at the exposure", shape (3, 3),
            set by the caller of :func:`solve_deck`; the identity for the solution of the sensor alone.
    """

    source: str
    time_ns: int
    exposure: StarExposure
    stars: MatchedStars | None
    rejected_stars: tuple[RejectedStar, ...]
    turn_variance: float = 0.0
    rotation_ds: FloatArray = field(default_factory=lambda: _IDENTITY)


def rejected_exposure(
    exposure: StarExposure, rejected_stars: tuple[RejectedStar, ...], rejection: Rejection
) -> tuple[PlacedExposure, AttitudeSolution]:
    """Return the results for an exposure that is rejected as a whole: no stars and no attitude."""
    solution = invalid_solution(np.zeros(len(exposure), dtype=bool), rejection)
    placed = PlacedExposure(exposure.source, exposure.time_ns, exposure, None, rejected_stars)
    return placed, AttitudeSolution(exposure.source.partition(".")[2], exposure.time_ns, solution, rejected_stars, ())


def rejected_group(time_ns: int, rejection: Rejection) -> AttitudeSolution:
    """Return the joint solution without an attitude of a group of exposures."""
    return AttitudeSolution(JOINT, time_ns, invalid_solution(np.zeros(0, dtype=bool), rejection), (), ())


def solve_exposure(
    exposure: StarExposure,
    rejected_stars: tuple[RejectedStar, ...],
    prior: StarPrior | None,
    sky_model: SkyModel,
    noise_variance: float = 0.0,
    turn_variance: float = 0.0,
) -> tuple[PlacedExposure, AttitudeSolution]:
    """Solve the attitude of a sensor from one exposure.

    The exposure is rejected as a whole if its stars contradict the focal length of the camera.

    Args:
        exposure: stars of the exposure.
        rejected_stars: stars that were already rejected.
        prior: attitude of the sensor for the selection of stars; None without a known attitude.
        sky_model: sky model.
        noise_variance: variance of a rotation of all directions due to INS noise, each axis, rad².
        turn_variance: variance of a rotation of all directions due to another error, each axis, rad²; this error is
            independent in each exposure.
    """
    source, time_ns = exposure.source, exposure.time_ns
    visible = visible_stars(exposure, sky_model, prior)
    if isinstance(visible, Rejection):
        return rejected_exposure(exposure, rejected_stars, visible)
    detections = exposure
    exposure, stars, invisible = visible
    if invisible:
        rejected_stars += tuple(RejectedStar(source, time_ns, name, rejection) for name, rejection in invisible)
    solution, against_prior = solve_with_fallback(stars, prior)
    contradicted = check_focal_length(detections, sky_model, prior, solution.star_count)
    if contradicted is not None:
        return rejected_exposure(detections, rejected_stars, contradicted)
    if noise_variance + turn_variance > 0.0:
        solution = solution.with_added_noise(noise_variance + turn_variance)
    placed = PlacedExposure(source, time_ns, exposure, stars, rejected_stars, turn_variance)
    if solution.rejected:
        rejected_stars += tuple(_rejected_stars(solution, [placed]))
        placed = replace(placed, rejected_stars=rejected_stars)
    sources = (source,) if solution.status is not SolutionStatus.INVALID else ()
    text = _AGAINST_INS if against_prior else ""
    return placed, AttitudeSolution(source.partition(".")[2], time_ns, solution, rejected_stars, sources, text)


def solve_deck(
    time_ns: int,
    group: Sequence[PlacedExposure],
    turn_covariance_d: FloatArray,
    sensors: dict[str, ObservingSensorConfig],
    prior: StarPrior | None,
) -> AttitudeSolution:
    """Solve the attitude of the deck from exposures of different sensors.

    Args:
        time_ns: time of the attitude.
        group: the m exposures, each with its rotation to the deck at the time of the attitude.
        turn_covariance_d: error covariance of these rotations, rotation vectors in the deck frame, rad², shape
            (m, 3, m, 3).
        sensors: parameters of the sensors by id, with the standard deviations of their mountings.
        prior: attitude of the deck for the selection of stars; None without a known attitude.
    """
    with_stars = [index for index, placed in enumerate(group) if placed.stars is not None]
    usable = group
    if len(with_stars) < len(group):
        usable = [group[index] for index in with_stars]
        turn_covariance_d = turn_covariance_d[with_stars][:, :, with_stars]
    if not usable:
        return rejected_group(time_ns, Rejection(Reason.TOO_FEW_STARS, "no exposure could be compared with the sky"))
    solution, against_prior = solve_with_fallback(_stars_in_deck(usable, turn_covariance_d, sensors), prior)
    rejected = _rejected_stars(solution, usable)
    known = {(star.source, star.name) for placed in group for star in placed.rejected_stars}
    newly_rejected = tuple(star for star in rejected if (star.source, star.name) not in known)
    sources: tuple[str, ...] = ()
    if solution.status is not SolutionStatus.INVALID:
        members, rows = solution.members.tolist(), _rows(usable)
        sources = tuple(placed.source for placed, own in zip(usable, rows, strict=True) if any(members[own]))
    return AttitudeSolution(JOINT, time_ns, solution, newly_rejected, sources, _AGAINST_INS if against_prior else "")


def _stars_in_deck(
    group: Sequence[PlacedExposure], turn_covariance_d: FloatArray, sensors: dict[str, ObservingSensorConfig]
) -> MatchedStars:
    """Return all stars in the deck frame, with the errors of mountings and of rotations to the common time."""
    stars = [placed.stars for placed in group if placed.stars is not None]
    mounting_b = np.empty((len(group), 3, 3))
    for index, placed in enumerate(group):
        sensor = sensors[placed.source.partition(".")[2]]
        mounting_b[index] = placed.rotation_ds * sensor.installation_sigma_s
    return MatchedStars(
        measured_b=np.concatenate([s.measured_b @ m.rotation_ds.T for s, m in zip(stars, group, strict=True)]),
        reference_n=np.concatenate([s.reference_n for s in stars]),
        sigma=np.concatenate([s.sigma for s in stars]),
        position_sigma=np.concatenate([s.position_sigma for s in stars]),
        shared_n=np.concatenate([s.shared_n for s in stars]),
        sensor=np.repeat(np.arange(len(stars), dtype=np.intp), [len(s) for s in stars]),
        mounting_b=mounting_b,
        smear_b=_smear_in_deck(stars, group),
        time_transfer_b=_turn_errors_in_deck(group, turn_covariance_d),
        false_match_density=_values_of_all([s.false_match_density for s in stars], stars),
        pixel_sigma=_values_of_all([s.pixel_sigma for s in stars], stars),
        field_b=_field_in_deck(stars, group),
        field_sources=tuple(source for s in stars for source in s.field_sources),
    )


def _turn_errors_in_deck(group: Sequence[PlacedExposure], turn_covariance_d: FloatArray) -> FloatArray | None:
    """Return a square root of the covariance of the rotation errors of m exposures, rad, shape (m, 3, 3 m).

    Each column has the rotation vectors of all exposures for one sigma of one independent error. The result is None
    without rotation errors.
    """
    own = [placed.turn_variance for placed in group]
    if not (any(own) or turn_covariance_d.any()):
        return None
    size = 3 * len(group)
    covariance_d = turn_covariance_d.reshape(size, size) + np.diag(np.repeat(own, 3))
    return square_roots(covariance_d).reshape(len(group), 3, size)


def _smear_in_deck(stars: Sequence[MatchedStars], group: Sequence[PlacedExposure]) -> FloatArray | None:
    """Return the covariance that streaks add to each star, deck frame, rad², shape (k, 3, 3); None without streaks."""
    if all(s.smear_b is None for s in stars):
        return None
    return np.concatenate(
        [
            np.zeros((len(s), 3, 3)) if s.smear_b is None else m.rotation_ds @ s.smear_b @ m.rotation_ds.T
            for s, m in zip(stars, group, strict=True)
        ]
    )


def _values_of_all(values: Sequence[FloatArray | None], stars: Sequence[MatchedStars]) -> FloatArray | None:
    """Return one value per star, shape (k,), 0 for the stars of a sensor without values; None without any value."""
    if all(value is None for value in values):
        return None
    return np.concatenate([np.zeros(len(s)) if one is None else one for one, s in zip(values, stars, strict=True)])


def _field_in_deck(stars: Sequence[MatchedStars], group: Sequence[PlacedExposure]) -> FloatArray | None:
    """Return star displacements by correlated camera errors, deck frame, rad, (k, 3, f); None without such errors."""
    count = sum(len(s.field_sources) for s in stars)
    if not count:
        return None
    of_all, begin, rows = np.zeros((sum(len(s) for s in stars), 3, count)), 0, _rows(group)
    for s, placed, own in zip(stars, group, rows, strict=True):
        if s.field_b is not None:
            end = begin + len(s.field_sources)
            of_all[own, :, begin:end] = placed.rotation_ds @ s.field_b
            begin = end
    return of_all


def _rows(group: Sequence[PlacedExposure]) -> list[slice]:
    """Return the slice of each sensor's stars among the stars of all sensors."""
    ends = list(accumulate(len(placed.exposure) for placed in group))
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def _rejected_stars(solution: StarSolution, group: Sequence[PlacedExposure]) -> list[RejectedStar]:
    """Return the stars that a solution rejects, each with its residual in the frame of its sensor."""
    rejected: list[RejectedStar] = []
    if not solution.rejected:
        return rejected
    for placed, rows in zip(group, _rows(group), strict=True):
        exposure, stars = placed.exposure, placed.stars
        assert stars is not None
        rotation_ns = solution.rotation_nb @ placed.rotation_ds
        for row in range(len(exposure)):
            rejection = solution.rejected.get(rows.start + row)
            if rejection is not None:
                predicted_s = stars.reference_n[row] @ rotation_ns
                residual = tangent_basis(predicted_s) @ (stars.measured_b[row] - predicted_s)
                rejected.append(
                    RejectedStar(
                        source=exposure.source,
                        time_ns=exposure.time_ns,
                        name=exposure.name(row),
                        rejection=rejection,
                        residual=tuple(residual.tolist()),
                        sigma=float(stars.single_star_sigma[row]),
                    )
                )
    return rejected
