"""Focal length and principal point of a camera from fields of identified stars, and the check of the focal length.

No attitude is needed. The angles between the stars of one exposure are known from the catalogue. The measured angles
depend on the optics, but not on the attitude. Each field is linearised at the attitude that its stars give. The error
of this attitude is eliminated, and the remaining displacements determine the optics (equations as in
:mod:`ship_stars.attitude_from_stars.attitude_fit`):

    d_i = δ × v_i + R S_i θ - R F_i f - G_i z + noise

θ is the correction of (logarithm of the focal length, principal u, principal v) of the camera, and S_i the derivative
of the measured direction with respect to θ. The coefficients f of the field-spatial error and the shared errors z
(refraction) are constant over all fields and have a prior sigma of 1. The information of several fields is the sum of
the information of each field.

The focal length is determined well: a field of ten stars over 13°, each with a sigma of 3″, determines it to 0.005 %.
The principal point is determined badly, because its shift acts nearly like a rotation of the camera; at the edge of
such a field the two displacements differ by 1 %.

If the focal length is wrong by far more than its sigma, the stars of a field are inconsistent: only few of them fit one
attitude. The field is then solved again with a nearly free focal length. If the stars are consistent with a focal
length far from the configured value, the whole exposure is rejected, because the few stars that fit would give a wrong
attitude.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import FloatArray
from ship_stars.attitude_from_stars.attitude_fit import ATTITUDE, MatchedStars, fit_attitude, linearise_stars
from ship_stars.attitude_from_stars.exposure import StarExposure, visible_stars
from ship_stars.attitude_from_stars.selection import MIN_VERIFIED_STARS, StarPrior, select_stars
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.errors import SOURCE_OPTICS, OpticsErrors
from ship_stars.sky.sky_model import SkyModel

OPTICS = slice(0, 3)
"""Slice of the optics among the unknowns; the coefficients of the field-spatial error and the shared errors follow."""

_FREE = (np.inf, np.inf, np.inf)
_LEAST_EIGENVALUE = 1e-9
"""Minimum eigenvalue of the information, normalised to a diagonal of ones, for which the unknowns are determined."""

FREE_FOCAL_SIGMA = 0.01
"""Relative standard deviation of a nearly free focal length."""

MAX_SIGMAS = 4.0
"""Threshold of the difference between fitted and configured focal length, standard deviations."""

_ENOUGH_STARS = 6
"""Minimum number of stars consistent with one attitude for which the focal length is not checked.

With a wrong focal length fewer stars would be consistent.
"""


@dataclass(frozen=True)
class FieldInformation:
    """Information from star fields about the q unknowns, with each field's attitude eliminated.

    The sum of two objects is the information from the fields of both.

    Attributes:
        matrix: information without priors, shape (q, q).
        right_side: right side of the normal equations, shape (q,).
        chi_square: chi-square of the displacements at the best attitude of each field, with unchanged optics.
        degrees: degrees of freedom of ``chi_square``.
    """

    matrix: FloatArray
    right_side: FloatArray
    chi_square: float
    degrees: int

    def __add__(self, other: "FieldInformation") -> "FieldInformation":
        """Return the information from the fields of both objects."""
        return FieldInformation(
            self.matrix + other.matrix,
            self.right_side + other.right_side,
            self.chi_square + other.chi_square,
            self.degrees + other.degrees,
        )


@dataclass(frozen=True)
class OpticsEstimate:
    """Correction of a camera's optics: estimated minus configured.

    Attributes:
        scale: relative correction of the focal length.
        principal_px: correction of the principal point (u, v), px, shape (2,).
        covariance: covariance of (scale, u, v), shape (3, 3).
        chi_square: chi-square of the displacements with the corrected optics, and of the unknowns under their priors.
        degrees: degrees of freedom of ``chi_square``.
    """

    scale: float
    principal_px: FloatArray
    covariance: FloatArray
    chi_square: float
    degrees: int

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of the relative correction of the focal length."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def principal_sigma_px(self) -> FloatArray:
        """Standard deviation of the correction of the principal point (u, v), px, shape (2,)."""
        sigma: FloatArray = np.sqrt(np.diagonal(self.covariance)[1:])
        return sigma


def field_information(
    camera: StarCamera, stars: MatchedStars, members: NDArray[np.bool_] | None = None
) -> FieldInformation | None:
    """Return the information from one field about the optics; None if the members do not determine an attitude.

    Args:
        camera: camera that measured the directions, with a focal length correct to 1 %.
        stars: stars of one exposure, in the frame of the camera; a star with a wrong identity must not be a member.
        members: True for the stars that are used, shape (k,); None to use all stars.
    """
    count = len(stars) if members is None else int(np.count_nonzero(members))
    found = fit_attitude(stars, members) if count > 1 else None
    if found is None:
        return None
    slopes_b = -camera.optics_jacobian(stars.measured_b)[..., OPTICS]
    # The optics are unknowns here, so the errors of the configured optics are left out.
    is_other = [source != SOURCE_OPTICS for source in stars.field_sources]
    field_b = slopes_b if stars.field_b is None else np.concatenate([slopes_b, stars.field_b[..., is_other]], axis=-1)
    fit = linearise_stars(replace(stars, field_b=field_b), found.rotation_nb)
    information, right_side = fit.normal_equations(members)
    used = fit.displacement if members is None else fit.displacement[members]
    rest = slice(ATTITUDE.stop, None)
    by_attitude = np.linalg.solve(information[ATTITUDE, ATTITUDE], information[ATTITUDE, rest])
    attitude = np.linalg.solve(information[ATTITUDE, ATTITUDE], right_side[ATTITUDE])
    return FieldInformation(
        matrix=information[rest, rest] - information[rest, ATTITUDE] @ by_attitude,
        right_side=right_side[rest] - by_attitude.T @ right_side[ATTITUDE],
        chi_square=float(np.sum(used**2) - right_side[ATTITUDE] @ attitude),
        degrees=2 * count - 3,
    )


def estimate_optics(
    information: FieldInformation, prior_sigma: tuple[float, float, float] = _FREE
) -> OpticsEstimate | None:
    """Return the optics that best fit the fields of stars; None if stars and priors do not determine all parameters.

    Args:
        information: information from all fields.
        prior_sigma: standard deviations of the configured logarithm of the focal length, principal u (px) and principal
            v (px); infinite for no prior, 0 for a fixed value.
    """
    count = len(information.right_side)
    # Unknowns with a prior are in units of their sigma, so that a fixed value (sigma 0) causes no division by zero.
    sigma = np.append(np.asarray(prior_sigma, dtype=float), np.ones(count - OPTICS.stop))
    is_free = np.isinf(sigma)
    unit = np.where(is_free, 1.0, sigma)
    matrix = unit[:, None] * information.matrix * unit + np.diag(np.where(is_free, 0.0, 1.0))
    right_side = unit * information.right_side
    degrees = information.degrees - int(np.count_nonzero(is_free))
    size = np.sqrt(np.diagonal(matrix))
    if degrees < 0 or not np.all(size > 0.0):
        return None
    normed = matrix / np.outer(size, size)
    if not np.linalg.eigvalsh(normed)[0] > _LEAST_EIGENVALUE:
        return None
    inverse = np.linalg.inv(normed) / np.outer(size, size)
    solution = inverse @ right_side
    covariance = unit[:, None] * inverse * unit
    return OpticsEstimate(
        scale=float(unit[0] * solution[0]),
        principal_px=(unit * solution)[1:3],
        covariance=covariance[OPTICS, OPTICS],
        chi_square=float(information.chi_square - right_side @ solution),
        degrees=degrees,
    )


def check_focal_length(
    exposure: StarExposure, sky_model: SkyModel, prior: StarPrior | None, used_count: int
) -> Rejection | None:
    """Return the rejection of an exposure whose stars contradict the focal length; None without a contradiction.

    The result is also None if the stars do not determine the focal length.

    Args:
        exposure: all detections.
        sky_model: the sky model.
        prior: attitude of the sensor known without these stars; None if no such attitude is known.
        used_count: number of detections that fit one attitude with the configured optics. The field is not solved again
            if all detections fit, or at least ``_ENOUGH_STARS``.
    """
    optics = exposure.optics
    if optics is None or used_count >= min(len(exposure), _ENOUGH_STARS) or len(exposure) < MIN_VERIFIED_STARS:
        return None
    free_sigma = max(FREE_FOCAL_SIGMA, optics.focal_sigma)
    visible = visible_stars(replace(exposure, optics=replace(optics, focal_sigma=free_sigma)), sky_model, prior)
    if isinstance(visible, Rejection):
        return None
    stars = visible[1]
    members = select_stars(stars, prior).members
    count = int(np.count_nonzero(members))
    if count < MIN_VERIFIED_STARS or count <= used_count:
        return None
    information = field_information(optics.camera, stars, members)
    principal = optics.principal_sigma_px
    found = None if information is None else estimate_optics(information, (np.inf, principal, principal))
    # Written so that NaN leads to the rejection.
    if found is None or abs(found.scale) <= MAX_SIGMAS * np.hypot(optics.focal_sigma, found.scale_sigma):
        return None
    return focal_length_rejection(optics, found.scale, f"the angles between {count} stars")


def check_estimated_focal_length(optics: OpticsErrors, error: float, variance: float) -> Rejection | None:
    """Return the rejection of an exposure if the filter's focal length is far from the configured one; else None.

    Args:
        optics: errors of the configured optics.
        error: estimate of the focal length's error, in sigmas.
        variance: variance of this estimate, in sigmas².
    """
    if abs(error) <= MAX_SIGMAS * np.sqrt(1.0 + variance):
        return None
    return focal_length_rejection(optics, error * optics.focal_sigma, "the stars up to now")


def focal_length_rejection(optics: OpticsErrors, scale: float, evidence: str) -> Rejection:
    """Return a rejection that states the fitted focal length.

    Args:
        optics: errors of the configured optics.
        scale: relative difference of the focal length, fitted minus configured.
        evidence: data to which the focal length is fitted, for the text.
    """
    configured_mm = 1e3 * optics.camera.focal_length_m
    text = (
        f"focal length {configured_mm * (1.0 + scale):.3f} mm fits {evidence}, configured {configured_mm:.3f} mm, "
        f"sigma {configured_mm * optics.focal_sigma:.3f} mm: check camera.focal_length_m"
    )
    return Rejection(Reason.MISIDENTIFIED, text)
