"""Residuals of stars relative to the predicted attitude of their sensor, with Jacobian and noise.

Each star has a residual of two components, up and right in the sensor. Let R be the predicted attitude (horizon from
sensor), v the star's sky direction and u its measured direction. The residual is the part of u - Rᵀ v perpendicular to
the line of sight. A rotation ε of the sensor (rotation vector in the sensor frame) moves the predicted direction
p = Rᵀ v by p × ε.

The errors that all stars share (refraction, Earth rotation, position) are states of the filter
(:mod:`ship_stars.sky.sky_model`). One sigma of such an error displaces v by g, and the predicted direction
by Rᵀ g. The errors of the camera's optics and the coefficients of the field-spatial error
(:mod:`ship_stars.camera.errors`) are states too; they displace the measured direction.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between
from ship_kernels import compiled_stars
from ship_stars.attitude_from_stars.attitude_fit import MatchedStars
from ship_stars.attitude_from_stars.exposure import StarExposure, visible_stars
from ship_stars.attitude_from_stars.field_scale import check_focal_length
from ship_stars.attitude_from_stars.selection import StarPrior, ambiguous_identity_rejection, select_stars
from ship_stars.attitude_from_stars.solution import SolutionStatus, solve_stars
from ship_stars.camera.errors import SOURCE_PIXEL, PixelDwell
from ship_stars.sky.sky_model import SkyModel

SOURCE_STAR_NOISE = "star_noise"
"""Error source of the stars' noise; this noise includes the errors of the catalogue."""


class PredictedSensor(NamedTuple):
    """Attitude of a sensor predicted from a state.

    Attributes:
        rotation_ns: predicted attitude (horizon from sensor), shape (3, 3).
        to_sensor: derivative of this attitude, as rotation vector in the sensor frame, with respect to the n states,
            shape (3, n).
        mean: mean of the state, shape (n,).
    """

    rotation_ns: FloatArray
    to_sensor: FloatArray
    mean: FloatArray


@dataclass(frozen=True)
class StarResiduals:
    """Residuals of the k stars of an exposure that are used, linearised at the prediction.

    Attributes:
        residual: measured minus predicted direction, up and right of each star, rad, shape (2 k,).
        jacobian: derivative of the predicted measurement with respect to the n states, shape (2 k, n).
        rotation_jacobian: derivative of the predicted direction with respect to a rotation of the predicted attitude,
            rotation vector in the sensor frame, shape (2 k, 3).
        noise: noise covariance by error source, rad², shape (2 k, 2 k) each.
        components: name of each residual component.
        rejected: names of the stars that are not used, each with its rejection.
        rotation_ns: attitude of the sensor (horizon from sensor) from these stars alone if they contradict the
            prediction, shape (3, 3); None if they are consistent with the prediction.
    """

    residual: FloatArray
    jacobian: FloatArray
    rotation_jacobian: FloatArray
    noise: dict[str, FloatArray]
    components: tuple[str, ...]
    rejected: tuple[tuple[str, Rejection], ...]
    rotation_ns: FloatArray | None


def star_residuals(
    exposure: StarExposure,
    predicted: PredictedSensor,
    prior: StarPrior,
    sky_model: SkyModel,
    sky_slice: slice,
    initial_ns: FloatArray | None = None,
    camera_indices: NDArray[np.intp] | None = None,
) -> StarResiduals | Rejection:
    """Select the correctly identified stars, and compare them with the prediction.

    Args:
        exposure: the stars at mid-exposure.
        predicted: predicted attitude of the sensor.
        prior: attitude of the sensor with its error covariance, used to select the stars.
        sky_model: the sky model.
        sky_slice: slice of the states of the shared errors.
        initial_ns: attitude within a degree of the truth, shape (3, 3); None if the prior is that near.
        camera_indices: state indices of the correlated errors of the sensor's camera; None without such states.

    Returns:
        The residuals, or the rejection of the whole exposure: the sky model gives no directions at the exposure's time,
        no star can be used, or the stars contradict the focal length of the camera.
    """
    found = _compare(exposure, predicted, prior, sky_model, sky_slice, initial_ns, camera_indices)
    used_count = 0 if isinstance(found, Rejection) else len(found.components) // 2
    return check_focal_length(exposure, sky_model, prior, used_count) or found


def _compare(
    exposure: StarExposure,
    predicted: PredictedSensor,
    prior: StarPrior,
    sky_model: SkyModel,
    sky_slice: slice,
    initial_ns: FloatArray | None,
    camera_indices: NDArray[np.intp] | None,
) -> StarResiduals | Rejection:
    """Compare the correctly identified stars with the prediction; see :func:`star_residuals`."""
    rotation_ns, to_sensor, mean = predicted
    visible = visible_stars(exposure, sky_model, prior)
    if isinstance(visible, Rejection):
        return visible
    seen, stars, rejected = visible
    if len(stars.sigma) == 0:
        has_unidentified = any(rejection.reason is Reason.UNIDENTIFIED for _, rejection in rejected)
        reason = Reason.UNIDENTIFIED if has_unidentified else Reason.TOO_FEW_STARS
        return Rejection(reason, _with_rejected_stars(f"none of {len(exposure)} stars is usable", rejected))
    # The estimate of the shared errors corrects the expected directions.
    expected_n = compiled_stars.expected_directions(stars.reference_n, stars.shared_n, mean[sky_slice])
    measured_s, field_s = stars.measured_b, None if camera_indices is None else stars.field_b
    if field_s is not None:
        measured_s = measured_s - field_s @ mean[camera_indices]
    at_estimate = replace(stars, reference_n=expected_n, measured_b=measured_s)
    selection = _select_consistent(stars, at_estimate, prior, initial_ns)
    if isinstance(selection, Rejection):
        return Rejection(selection.reason, _with_rejected_stars(selection.text, rejected))
    members, alone_ns = selection
    fitted_ns = rotation_ns if alone_ns is None else alone_ns
    rejected += [
        (seen.name(row), _misfit_rejection(stars, row, fitted_ns)) for row in np.flatnonzero(~members).tolist()
    ]
    if not members.any():
        return Rejection(Reason.MISIDENTIFIED, _with_rejected_stars(_inconsistency_text(len(members)), rejected))
    names = [seen.name(row) for row in np.flatnonzero(members).tolist()]
    residual, jacobian, by_turn, basis = compiled_stars.residuals(
        measured_s, expected_n, stars.shared_n, members.view(np.uint8), rotation_ns, to_sensor, sky_slice.start
    )
    if field_s is not None:
        jacobian[:, camera_indices] = (basis @ field_s[members]).reshape(len(residual), -1)
    return StarResiduals(
        residual=residual,
        jacobian=jacobian,
        rotation_jacobian=by_turn,
        noise=_noise(at_estimate, seen.pixel_dwell, basis, members),
        components=tuple(f"{name} {axis}" for name in names for axis in ("up", "right")),
        rejected=tuple(rejected),
        rotation_ns=alone_ns,
    )


def _select_consistent(
    stars: MatchedStars, at_estimate: MatchedStars, prior: StarPrior, initial_ns: FloatArray | None
) -> tuple[NDArray[np.bool_], FloatArray | None] | Rejection:
    """Return the stars consistent with the prediction, or, without such a star, the stars consistent with one another.

    Args:
        stars: stars with their directions from the sky model.
        at_estimate: the same stars, with directions corrected by the estimates of shared errors and camera errors.
        prior: the predicted attitude.
        initial_ns: attitude within a degree of the truth, shape (3, 3); None if the prediction is that near.

    Returns:
        True for each selected star, shape (k,); all False if the stars are consistent neither with the prediction nor
            with one another.
        Attitude of the sensor from the selected stars alone if they contradict the prediction; else None.
    """
    choice = select_stars(at_estimate, prior, initial_ns)
    if choice.false_matches is not None:
        return ambiguous_identity_rejection(choice.false_matches)
    if choice.members.any():
        return choice.members, None
    alone = solve_stars(stars)
    if alone.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return choice.members, None
    return alone.members, alone.rotation_nb


def _inconsistency_text(count: int) -> str:
    return (
        f"none of {count} stars is near its expected direction, and they are not consistent with another attitude: "
        "if this persists, check the camera's parameters, gnss/fix and the clock"
    )


def _noise(
    stars: MatchedStars, pixel_dwell: PixelDwell | None, basis: FloatArray, members: NDArray[np.bool_]
) -> dict[str, FloatArray]:
    """Return the noise covariance of the members' residuals along ``basis`` by error source, rad², shape (2 k, 2 k)."""
    noise = np.diag(np.repeat(np.hypot(stars.sigma, stars.position_sigma)[members] ** 2, 2))
    if stars.smear_b is not None:
        smear = basis @ stars.smear_b[members] @ np.swapaxes(basis, -1, -2)
        for row, added in enumerate(smear):
            noise[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += added
    if stars.pixel_sigma is None:
        return {SOURCE_STAR_NOISE: noise}
    of_pixels = stars.pixel_sigma**2 * (1.0 if pixel_dwell is None else 1.0 + pixel_dwell.excess_ratio)
    return {SOURCE_STAR_NOISE: noise, SOURCE_PIXEL: np.diag(np.repeat(of_pixels[members], 2))}


def _misfit_rejection(stars: MatchedStars, row: int, rotation_ns: FloatArray) -> Rejection:
    angle = float(angle_between(rotation_ns @ stars.measured_b[row], stars.reference_n[row]))
    text = f'{angle / ARCSEC:.1f}" from its expected direction, sigma {stars.single_star_sigma[row] / ARCSEC:.1f}"'
    return Rejection(Reason.MISIDENTIFIED, text)


def _with_rejected_stars(text: str, rejected: list[tuple[str, Rejection]]) -> str:
    return "; ".join([text, *(f"{name}: {rejection.text}" for name, rejection in rejected)])
