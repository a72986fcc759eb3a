"""Attitude from all stars of one or all sensors, with a covariance that includes every error.

The attitude is the solution of Wahba's problem ([P15] (13)-(16)), computed by
:func:`ship_stars.attitude_from_stars.attitude_fit.fit_attitude`. Its error is linear in the errors listed there, and
one set of normal equations contains the sensitivity of the attitude to each error. The noise of the stars averages over
the stars; errors that the stars share do not.
"""

import enum
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.frames import SINGULAR_ELEVATION
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_kernels import compiled_stars
from ship_kernels.compiled_innovations import square_root
from ship_stars.attitude_from_stars.attitude_fit import (
    ATTITUDE,
    AttitudeFit,
    MatchedStars,
    field_columns,
    fit_attitude,
    linearise_stars,
)
from ship_stars.attitude_from_stars.selection import (
    MIN_VERIFIED_STARS,
    StarPrior,
    ambiguous_identity_rejection,
    select_stars,
)
from ship_stars.camera.errors import SOURCE_FIELD, SOURCE_OPTICS, SOURCE_PIXEL
from ship_stars.sky.sky_model import SHARED_TERMS, UTC

SOLUTION_TERMS = (
    "star_noise",
    "installation",
    "refraction",
    "earth_rotation",
    "ship_position",
    "catalogue",
    SOURCE_OPTICS,
    UTC,
    SOURCE_FIELD,
    SOURCE_PIXEL,
)
"""Error sources of :attr:`StarSolution.covariance_by_source_n`, in order; only star_noise is independent in time.

The spatial errors at the end are absent for a camera without such errors, and then UTC is absent if taken as exact.
"""

_STAR_NOISE, _INSTALLATION, _CATALOGUE, _OPTICS, _FIELD, _PIXEL = (
    SOLUTION_TERMS.index(term)
    for term in ("star_noise", "installation", "catalogue", SOURCE_OPTICS, SOURCE_FIELD, SOURCE_PIXEL)
)
_TERMS_OF_SHARED = np.array([SOLUTION_TERMS.index(term) for term in SHARED_TERMS], dtype=np.intp)
"""Index in SOLUTION_TERMS of each shared error."""

_SINGULAR_UP = float(np.sin(SINGULAR_ELEVATION))
"""Magnitude of the Up component of the forward axis above which azimuth and roll are not separated."""

_MAX_STEPS, _SMALL_TURN = 10, 1e-3
"""Limits of the search for the most likely attitude: maximum number of steps, and maximum of the last step, rad."""


class SolutionStatus(enum.IntEnum):
    """Status of a solution; the values are equal to the constants of ship_msgs/StarHorizonAttitude."""

    VALID = 0
    UNVERIFIED = 1
    ANGLES_SINGULAR = 2
    INVALID = 3


@dataclass(frozen=True)
class StarSolution:
    """Attitude from k stars.

    Attributes:
        status: status of the solution; INVALID if there is no attitude.
        rejection: reason of an INVALID solution; else None.
        rotation_nb: attitude (horizon from b), shape (3, 3); NaN if INVALID.
        covariance_by_source_n: covariance by SOLUTION_TERMS, rotation vector in the horizon frame, rad², shape
            (n_terms, 3, 3).
        members: True for each star used, shape (k,).
        residual_n: reference minus measured direction of each star, used or not, rad, shape (k, 3); NaN if INVALID.
        rejected: rejection of each star that is not consistent with the attitude, by the row of the star.
    """

    status: SolutionStatus
    rejection: Rejection | None
    rotation_nb: FloatArray
    covariance_by_source_n: FloatArray
    members: NDArray[np.bool_]
    residual_n: FloatArray
    rejected: dict[int, Rejection] = field(default_factory=dict)

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance of the total error, rotation vector in the horizon frame, rad², shape (3, 3)."""
        total: FloatArray = self.covariance_by_source_n.sum(axis=0)
        return total

    @property
    def noise_n(self) -> FloatArray:
        """Covariance of the error that is independent in each exposure, rad², shape (3, 3)."""
        noise: FloatArray = self.covariance_by_source_n[_STAR_NOISE]
        return noise

    def with_added_noise(self, variance: float) -> "StarSolution":
        """Return the attitude with an additional independent error of a given variance about each axis, rad²."""
        parts_n = self.covariance_by_source_n.copy()
        parts_n[_STAR_NOISE] += variance * np.eye(3)
        return replace(self, covariance_by_source_n=parts_n)

    @property
    def star_count(self) -> int:
        """Number of stars used; 0 if INVALID."""
        return 0 if self.status is SolutionStatus.INVALID else int(self.members.sum())

    @property
    def residual_rms(self) -> float:
        """Root mean square of the angle between used stars and their sky directions, rad; NaN if INVALID."""
        squares = np.sum(self.residual_n[self.members] ** 2, axis=-1)
        return float(np.sqrt(np.mean(squares))) if squares.size else float("nan")


def solve_stars(stars: MatchedStars, prior: StarPrior | None = None) -> StarSolution:
    """Return the attitude (horizon from b), its covariance by error source, and the rejected stars.

    Args:
        stars: all measured stars that have a sky direction.
        prior: attitude used to select the stars, and to verify fewer than three stars. The attitude of the selected
            stars does not depend on the prior.
    """
    initial_nb = initial_attitude(stars, prior) if prior is not None and prior.is_wide and len(stars) else None
    choice = select_stars(stars, prior, initial_nb)
    members = choice.members
    if choice.false_matches is not None:
        return invalid_solution(members, ambiguous_identity_rejection(choice.false_matches))
    count = int(np.count_nonzero(members))
    fitted = members if count else np.ones_like(members)
    found = choice.attitude_fit or fit_attitude(stars, fitted)
    if found is None:
        text = _undetermined_text(int(np.count_nonzero(fitted)))
        return invalid_solution(members, Rejection(Reason.TOO_FEW_STARS, text))
    if not count:
        text = f"{len(stars)} stars, no set of them is more consistent than another"
        reason = Reason.TOO_FEW_STARS if len(stars) < MIN_VERIFIED_STARS else Reason.MISIDENTIFIED
        return invalid_solution(members, Rejection(reason, text))
    residual_n = found.fit.residual_n
    return StarSolution(
        status=_status(count, prior, found.rotation_nb),
        rejection=None,
        rotation_nb=found.rotation_nb,
        covariance_by_source_n=_covariance_by_source(stars, found, members),
        members=members,
        residual_n=residual_n,
        rejected=_rejections(residual_n, stars.single_star_sigma, members),
    )


def solve_with_fallback(stars: MatchedStars, prior: StarPrior | None) -> tuple[StarSolution, bool]:
    """Return the solution with the prior, or the solution from the stars alone if they contradict the prior.

    Args:
        stars: all measured stars that have a sky direction.
        prior: as for :func:`solve_stars`.

    Returns:
        The solution, and True if it is from the stars alone, which verify one another but contradict the prior.
    """
    solution = solve_stars(stars, prior)
    if prior is None or solution.rejection is None or solution.rejection.reason is Reason.UNIDENTIFIED:
        return solution, False
    alone = solve_stars(stars)
    if alone.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return solution, False
    return alone, True


def initial_attitude(stars: MatchedStars, prior: StarPrior) -> FloatArray:
    """Return an attitude (horizon from b) at which stars can be linearised, shape (3, 3).

    A wide prior may be too far from the truth for a linearisation. The returned attitude is from the stars alone if
    they verify one another; else it is the most likely attitude given the prior and all stars.

    Args:
        stars: all measured stars that have a sky direction.
        prior: predicted attitude with a standard deviation of any size.
    """
    alone = solve_stars(stars)
    if alone.status in (SolutionStatus.VALID, SolutionStatus.ANGLES_SINGULAR):
        return alone.rotation_nb
    rotation_nb = prior.rotation_nb
    for _ in range(_MAX_STEPS):
        expected_n, covariance_n = prior.relative_to(rotation_nb)
        sigmas = linearise_stars(stars, rotation_nb).with_prior(covariance_n, expected_n).solve().unknowns[ATTITUDE]
        turn_n = expected_n + square_root(covariance_n) @ sigmas
        rotation_nb = exp_rotation(turn_n) @ rotation_nb
        if np.linalg.norm(turn_n) < _SMALL_TURN:
            break
    return rotation_nb


def _undetermined_text(count: int) -> str:
    if count < 2:
        return "no star" if count == 0 else "one star: the rotation about it is undetermined"
    return f"{count} stars, all in one direction: the rotation about it is undetermined"


def _status(count: int, prior: StarPrior | None, rotation_nb: FloatArray) -> SolutionStatus:
    if prior is None and count < MIN_VERIFIED_STARS:
        return SolutionStatus.UNVERIFIED
    return SolutionStatus.ANGLES_SINGULAR if abs(rotation_nb[1, 0]) > _SINGULAR_UP else SolutionStatus.VALID


def _covariance_by_source(stars: MatchedStars, found: AttitudeFit, members: NDArray[np.bool_]) -> FloatArray:
    """Return the covariance of the attitude by error source (SOLUTION_TERMS), rad², shape (n_terms, 3, 3)."""
    share = stars.position_sigma / stars.white_sigma
    share[~members] = 0.0
    information, jacobian = found.solution.information, found.fit.jacobian
    # Order of the unknowns: mounting and time transfer, field errors, shared errors.
    shared, of_field = stars.shared_n.shape[-1], [SOLUTION_TERMS.index(source) for source in stars.field_sources]
    installed = len(information) - ATTITUDE.stop - len(of_field) - shared
    kinds = [np.full(installed, _INSTALLATION), np.array(of_field, dtype=np.intp), _TERMS_OF_SHARED[:shared]]
    spatial = stars.pixel_sigma is not None or SOURCE_FIELD in stars.field_sources
    terms = len(SOLUTION_TERMS) if spatial else _FIELD - (len(SHARED_TERMS) - shared)
    if of_field and found.field_weight is not None:
        fields = field_columns(stars, len(information))
        jacobian = jacobian.copy()
        jacobian[..., ATTITUDE] -= jacobian[..., fields] @ found.field_weight[ATTITUDE].T
        information = information - found.field_weight @ information[fields]
    covariance_n, by_catalogue = compiled_stars.attitude_covariances(
        found.white_covariance_n, information, jacobian, share, np.concatenate(kinds), terms
    )
    # The white covariance contains the field errors, but not the errors of mountings and sky.
    by_fields = covariance_n[_OPTICS] + covariance_n[_FIELD] if spatial else covariance_n[_OPTICS]
    covariance_n[_CATALOGUE] = by_catalogue
    covariance_n[_STAR_NOISE] = found.white_covariance_n - by_fields - by_catalogue
    if stars.pixel_sigma is not None:
        share = np.where(members, stars.pixel_sigma / stars.white_sigma, 0.0)
        no_terms = np.zeros(len(information) - ATTITUDE.stop, dtype=np.intp)
        _, covariance_n[_PIXEL] = compiled_stars.attitude_covariances(
            found.white_covariance_n, information, jacobian, share, no_terms, 1
        )
        covariance_n[_STAR_NOISE] -= covariance_n[_PIXEL]
    solved: FloatArray = covariance_n
    return solved


def _rejections(residual_n: FloatArray, sigma: FloatArray, members: NDArray[np.bool_]) -> dict[int, Rejection]:
    rejected = {}
    for row in np.flatnonzero(~members).tolist():
        angle = float(np.linalg.norm(residual_n[row]))
        away = f'{angle / ARCSEC:.1f}"' if angle < 600.0 * ARCSEC else f"{np.rad2deg(angle):.2f}°"
        text = f'{away} from its expected direction, sigma {sigma[row] / ARCSEC:.1f}"'
        rejected[row] = Rejection(Reason.MISIDENTIFIED, text)
    return rejected


def invalid_solution(members: NDArray[np.bool_], rejection: Rejection) -> StarSolution:
    """Return an INVALID solution.

    Args:
        members: True for each star that is consistent with the others, shape (k,).
        rejection: reason why there is no attitude.
    """
    unknown = np.full((3, 3), np.nan)
    return StarSolution(
        status=SolutionStatus.INVALID,
        rejection=rejection,
        rotation_nb=unknown,
        covariance_by_source_n=np.full((len(SOLUTION_TERMS), 3, 3), np.nan),
        members=members,
        residual_n=np.full((len(members), 3), np.nan),
    )
