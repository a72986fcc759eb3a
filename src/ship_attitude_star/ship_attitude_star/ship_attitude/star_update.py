"""Single stars against the predicted attitude of their sensor.

Each star has a residual of two components, up and right in the sensor. With R the predicted attitude (horizon from
sensor), v the star's place in the sky and u its measured direction, the residual is the part of u - Rᵀ v across the
line of sight. A rotation ε of the sensor (rotation vector in its own frame) moves the predicted direction p = Rᵀ v by
p × ε. The errors that all stars share (refraction, Earth rotation, position) are states of the filter: one sigma of
such an error displaces v by g, and the predicted direction by Rᵀ g.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.ship_attitude.model import PredictedAttitude, sky_rows
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.stars.camera import tangent_basis
from ship_attitude_star.stars.exposure import StarExposure, visible_stars
from ship_attitude_star.stars.fit import SightedStars
from ship_attitude_star.stars.selection import StarPrior, select
from ship_attitude_star.stars.solution import SolutionStatus, solve_stars
from ship_estimation.kalman import StateModel
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, skew


@dataclass(frozen=True)
class StarResiduals:
    """The stars of an exposure that are used, linearised at the prediction.

    Attributes:
        residual: measured minus predicted direction, up and right of each of k stars, rad, shape (2 k,).
        jacobian: derivative of the residual by the n states, shape (2 k, n).
        by_turn: its derivative by a turn of the predicted sensor, rotation vector in its own frame, shape (2 k, 3).
        noise: covariance, rad², shape (2 k, 2 k).
        components: name of each residual.
        refused: the other stars by name, each with its refusal.
        rotation_ns: the sensor's attitude (horizon from sensor) by these stars alone, where they contradict the
            prediction, shape (3, 3); None where they agree with it.
    """

    residual: FloatArray
    jacobian: FloatArray
    by_turn: FloatArray
    noise: FloatArray
    components: tuple[str, ...]
    refused: tuple[tuple[str, Refusal], ...]
    rotation_ns: FloatArray | None


def star_residuals(
    exposure: StarExposure,
    predicted: PredictedAttitude,
    covariance: FloatArray,
    watch: SkyWatch,
    model: StateModel,
    mean: FloatArray,
) -> StarResiduals | Refusal:
    """Choose the stars that are what they are taken for, and compare them with the prediction.

    Args:
        exposure: the stars where they stood at its middle.
        predicted: attitude of the sensor.
        covariance: of the state, shape (n, n).
        watch: the sky.
        model: what the states are.
        mean: of the state, shape (n,).

    Returns:
        The refusal of the whole exposure where no star can be placed in the sky at its moment, or none can be used.
    """
    rotation_ns, to_sensor = predicted.rotation_nv, predicted.jacobian_v
    prior_s = to_sensor @ covariance @ to_sensor.T + predicted.interpolation_v
    prior = StarPrior(rotation_ns, rotation_ns @ prior_s @ rotation_ns.T)
    visible = visible_stars(exposure, watch, prior)
    if isinstance(visible, Refusal):
        return visible
    seen, stars, refused = visible
    if len(stars.sigma) == 0:
        return Refusal(Reason.TOO_FEW_STARS, _listed(f"none of {len(exposure)} stars can be used", refused))
    rows = sky_rows(model)
    # The estimate of the shared errors moves the stars to where they are expected.
    expected_n = stars.reference_n + stars.shared_n @ mean[rows]
    expected_n /= np.linalg.norm(expected_n, axis=-1, keepdims=True)
    expected = replace(stars, reference_n=expected_n)
    chosen = _chosen(stars, expected, prior)
    turned_ns = rotation_ns if chosen.rotation_ns is None else chosen.rotation_ns
    left_out = np.flatnonzero(~chosen.members).tolist()
    refused += [(seen.name(row), _misfit(stars, row, turned_ns)) for row in left_out]
    if chosen.contradictory:
        return Refusal(Reason.MISIDENTIFIED, _listed(_contradiction(len(left_out)), refused))
    names = [seen.name(row) for row in np.flatnonzero(chosen.members).tolist()]
    predicted_s = expected_n[chosen.members] @ rotation_ns
    basis, about_star = tangent_basis(predicted_s), skew(predicted_s)
    residual = np.einsum("kij,kj->ki", basis, stars.measured_b[chosen.members] - predicted_s)
    by_turn = basis @ about_star
    jacobian = by_turn @ to_sensor
    jacobian[:, :, rows] = basis @ rotation_ns.T @ stars.shared_n[chosen.members]
    return StarResiduals(
        residual=residual.ravel(),
        jacobian=jacobian.reshape(-1, jacobian.shape[-1]),
        by_turn=by_turn.reshape(-1, 3),
        noise=_noise(expected, basis, chosen.members),
        components=tuple(f"{name} {axis}" for name in names for axis in ("up", "right")),
        refused=tuple(refused),
        rotation_ns=chosen.rotation_ns,
    )


@dataclass(frozen=True)
class _Chosen:
    """The stars that belong together.

    Attributes:
        members: shape (k,); none where the stars contradict the prediction as well as one another.
        rotation_ns: attitude of the sensor by the members alone, where they contradict the prediction; else None.
    """

    members: NDArray[np.bool_]
    rotation_ns: FloatArray | None

    @property
    def contradictory(self) -> bool:
        return not self.members.any()


def _chosen(stars: SightedStars, expected: SightedStars, prior: StarPrior) -> _Chosen:
    """The stars that agree with the prediction; where none does, those that agree on another attitude.

    Args:
        stars: with their places by the sky.
        expected: the same where the estimate of the shared errors expects them.
        prior: the prediction.
    """
    members = select(expected, prior).members
    if members.any():
        return _Chosen(members, None)
    alone = solve_stars(stars)
    if alone.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return _Chosen(members, None)
    return _Chosen(alone.members, alone.rotation_nb)


def _contradiction(count: int) -> str:
    return (
        f"none of {count} stars is where it is expected, and they do not agree on another attitude: "
        "where this lasts, look at the camera's parameters, gnss/fix and the clock"
    )


def _noise(stars: SightedStars, basis: FloatArray, members: NDArray[np.bool_]) -> FloatArray:
    """Covariance of the residuals of the k members, along their basis (k, 2, 3), rad², shape (2 k, 2 k)."""
    noise = np.diag(np.repeat(stars.white_sigma[members] ** 2, 2))
    if stars.smear_b is not None:
        smear = basis @ stars.smear_b[members] @ np.swapaxes(basis, -1, -2)
        for row, added in enumerate(smear):
            noise[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += added
    return noise


def attitude_by_stars(
    exposure: StarExposure, watch: SkyWatch, untold_acceleration: float
) -> AttitudeMeasurement | Refusal:
    """The sensor's attitude by one exposure alone: it carries the ship's attitude when the INS is gone.

    Args:
        exposure: its stars.
        watch: the sky.
        untold_acceleration: angular acceleration that the sensor may have, standard deviation of each axis, rad/s².

    Returns:
        The refusal where the stars do not give an attitude that others of them verify.
    """
    visible = visible_stars(exposure, watch, None)
    if isinstance(visible, Refusal):
        return visible
    _, stars, refused = visible
    solution = solve_stars(stars)
    if solution.status is SolutionStatus.INVALID:
        assert solution.refusal is not None
        return replace(solution.refusal, text=_listed(solution.refusal.text, refused))
    if solution.status is SolutionStatus.UNVERIFIED:
        return Refusal(Reason.TOO_FEW_STARS, f"{len(stars)} stars, and nothing else to verify them by")
    rotation_ns = solution.rotation_nb
    noise_s = rotation_ns.T @ solution.noise_n @ rotation_ns
    if exposure.length is not None:
        noise_s = noise_s + exposure.length.untold_turn_variance(untold_acceleration) * np.eye(3)
    return AttitudeMeasurement(
        exposure.source, exposure.time_ns, rotation_ns, noise_s, solution.covariance_n - solution.noise_n
    )


def _misfit(stars: SightedStars, row: int, rotation_ns: FloatArray) -> Refusal:
    angle = float(angle_between(rotation_ns @ stars.measured_b[row], stars.reference_n[row]))
    text = f'{angle / ARCSEC:.1f}" from its place, sigma {stars.white_sigma[row] / ARCSEC:.1f}"'
    return Refusal(Reason.MISIDENTIFIED, text)


def _listed(text: str, refused: list[tuple[str, Refusal]]) -> str:
    return "; ".join([text, *(f"{name}: {refusal.text}" for name, refusal in refused)])
