"""Single stars against the predicted attitude of their sensor: two components each, errors they share as states.

With R the predicted attitude (horizon from sensor), v a star's place in the sky and u its measured direction, the
residual is u - Rᵀ v across the line of sight, up and right in the sensor. A rotation ε of the sensor (its own frame)
moves the prediction by p × ε with p = Rᵀ v; one sigma of refraction, Earth rotation or position by Rᵀ g.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.measurements.samples import AttitudeMeasurement
from ship_attitude_star.measurements.star_exposure import StarExposure
from ship_attitude_star.ship_attitude.measurement_models import PredictedAttitude
from ship_attitude_star.ship_attitude.model import sky_rows
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.stars.camera import tangent_basis
from ship_attitude_star.stars.fit import SightedStars
from ship_attitude_star.stars.identification import identified
from ship_attitude_star.stars.selection import AttitudePrior, select
from ship_attitude_star.stars.solution import SolutionStatus, solve_stars
from ship_estimation.refusals import Reason, Refusal
from ship_estimation.state import StateModel
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, skew

_ONE_SENSOR: FloatArray = np.empty((0, 3, 3))
"""Mounting errors of stars that are compared in their sensor's own frame."""


@dataclass(frozen=True)
class StarResiduals:
    """The stars of an exposure that can be used, linearised at the prediction.

    Attributes:
        residual: rad, shape (2 k,).
        jacobian: per state, shape (2 k, n).
        by_turn: per turn of the predicted sensor, rotation vector in its own frame, shape (2 k, 3).
        noise: covariance, rad², shape (2 k, 2 k).
        components: name of each residual.
        refused: the other stars, by name.
        rotation_ns: the sensor's attitude by these stars alone, where they contradict the prediction; None otherwise.
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
        exposure: at a moment that the watch's ``reason_against`` has nothing against.
        predicted: attitude of the sensor.
        covariance: of the state, shape (n, n).
        watch: the sky.
        model: what the states are.
        mean: of the state, shape (n,).

    Returns:
        The refusal of the whole exposure where no star can be used.
    """
    rotation_ns, to_sensor = predicted.rotation_nv, predicted.jacobian_v
    prior_s = to_sensor @ covariance @ to_sensor.T + predicted.interpolation_v
    prior_n = rotation_ns @ prior_s @ rotation_ns.T
    prior = AttitudePrior(rotation_ns, prior_n)
    seen, stars, refused = visible_stars(exposure, watch, prior)
    if len(stars) == 0:
        return Refusal(Reason.TOO_FEW_STARS, _listed(f"none of {len(exposure)} stars can be used", refused))
    rows = sky_rows(model)
    # Where the estimate of the shared errors puts them.
    expected_n = stars.reference_n + stars.shared_n @ mean[rows]
    expected_n /= np.linalg.norm(expected_n, axis=-1, keepdims=True)
    members, alone_ns = select(replace(stars, reference_n=expected_n), prior).members, None
    if not members.any():
        # Do the stars contradict the prediction, or one another?
        alone = solve_stars(stars)
        if alone.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
            refused += [(seen.name(row), _misfit(stars, row, rotation_ns)) for row in range(len(stars))]
            text = (
                f"none of {len(stars)} stars is where it is expected, and they do not agree on another attitude: "
                "where this lasts, look at the camera's parameters, gnss/fix and the clock"
            )
            return Refusal(Reason.MISIDENTIFIED, _listed(text, refused))
        members, alone_ns = alone.members, alone.rotation_nb
    turned_ns = rotation_ns if alone_ns is None else alone_ns
    refused += [(seen.name(row), _misfit(stars, row, turned_ns)) for row in np.flatnonzero(~members).tolist()]
    chosen = expected_n[members]
    predicted_s = chosen @ rotation_ns
    basis = tangent_basis(predicted_s)
    residual = np.einsum("kij,kj->ki", basis, stars.measured_b[members] - predicted_s)
    by_turn = basis @ skew(predicted_s)
    jacobian = by_turn @ to_sensor
    jacobian[:, :, rows] = basis @ rotation_ns.T @ stars.shared_n[members]
    names = [seen.name(row) for row in np.flatnonzero(members).tolist()]
    return StarResiduals(
        residual=residual.ravel(),
        jacobian=jacobian.reshape(-1, jacobian.shape[-1]),
        by_turn=by_turn.reshape(-1, 3),
        noise=_noise(stars, basis, members),
        components=tuple(f"{name} {axis}" for name in names for axis in ("up", "right")),
        refused=tuple(refused),
        rotation_ns=alone_ns,
    )


def _noise(stars: SightedStars, basis: FloatArray, members: NDArray[np.bool_]) -> FloatArray:
    """Covariance of the residuals of the members, along their basis (k, 2, 3), rad², shape (2 k, 2 k)."""
    noise = np.diag(np.repeat(stars.white_sigma[members] ** 2, 2))
    if stars.smear_b is not None:
        smear = basis @ stars.smear_b[members] @ np.swapaxes(basis, -1, -2)
        for row, added in enumerate(smear):
            noise[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += added
    return noise


def attitude_by_stars(
    exposure: StarExposure, watch: SkyWatch, untold_acceleration: float
) -> AttitudeMeasurement | Refusal:
    """The sensor's attitude by one exposure alone: what is left to go by when the INS is gone.

    Args:
        exposure: its stars.
        watch: the sky.
        untold_acceleration: angular acceleration of the sensor that nothing tells, sigma of each axis, rad/s².
    """
    _, stars, refused = visible_stars(exposure, watch, None)
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


def visible_stars(
    exposure: StarExposure, watch: SkyWatch, prior: AttitudePrior | None
) -> tuple[StarExposure, SightedStars, list[tuple[str, Refusal]]]:
    """The stars of an exposure with their places in the sky, and the others by name.

    Args:
        exposure: at a moment that the watch's ``reason_against`` has nothing against.
        watch: the sky.
        prior: attitude of the sensor, by which stars without an identity are identified; None leaves them out.
    """
    refused: list[tuple[str, Refusal]] = []
    unidentified = ~exposure.identified
    if unidentified.any():
        reasons: dict[int, Refusal] = {}
        if prior is not None:
            exposure, reasons = identified(exposure, prior, watch)
        nobody = Refusal(Reason.UNIDENTIFIED, "no identity, and no attitude to identify it by")
        unknown = np.flatnonzero(~exposure.identified)
        refused += [(exposure.name(row), reasons.get(row, nobody)) for row in unknown.tolist()]
        exposure = exposure[exposure.identified]
    apparent = watch.apparent(exposure.positions, exposure.time_ns)
    for row in np.flatnonzero(~apparent.visible).tolist():
        refused.append((exposure.name(row), watch.sky.too_low(float(apparent.elevation[row]))))
    keep = apparent.visible
    exposure = exposure[keep]
    stars = SightedStars(
        measured_b=exposure.directions_s,
        reference_n=apparent.direction_n[keep],
        sigma=exposure.sigma,
        position_sigma=exposure.position_sigma,
        shared_n=apparent.shared_n[keep],
        sensor=np.zeros(len(exposure), dtype=np.intp),
        mounting_b=_ONE_SENSOR,
        smear_b=exposure.smear_s,
    )
    return exposure, stars, refused


def _misfit(stars: SightedStars, row: int, rotation_ns: FloatArray) -> Refusal:
    angle = float(angle_between(rotation_ns @ stars.measured_b[row], stars.reference_n[row]))
    text = f'{angle / ARCSEC:.1f}" from its place, sigma {stars.white_sigma[row] / ARCSEC:.1f}"'
    return Refusal(Reason.MISIDENTIFIED, text)


def _listed(text: str, refused: list[tuple[str, Refusal]]) -> str:
    return "; ".join([text, *(f"{name}: {refusal.text}" for name, refusal in refused)])
