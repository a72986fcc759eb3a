"""The predicted attitude of a device, and a measurement of any kind against it: residual, Jacobian, noise.

Single stars are compared one by one. Each star has a residual of two components, up and right in the sensor. With R the
predicted attitude (horizon from sensor), v the star's place in the sky and u its measured direction, the residual is
the part of u - Rᵀ v across the line of sight. A rotation ε of the sensor (rotation vector in its own frame) moves the
predicted direction p = Rᵀ v by p × ε. The errors that all stars share (refraction, Earth rotation, position) are states
of the filter: one sigma of such an error displaces v by g, and the predicted direction by Rᵀ g.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.measurements.baseline import BASELINE_COMPONENTS, BaselineMeasurement
from ship_attitude_star.measurements.samples import ATTITUDE_COMPONENTS, AttitudeMeasurement
from ship_attitude_star.ship_attitude.model import SOURCE_INTERPOLATION, Device, ShipStateModel
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.stars import compiled_fit
from ship_attitude_star.stars.chance import improbable_identity
from ship_attitude_star.stars.exposure import StarExposure, visible_stars
from ship_attitude_star.stars.fit import SightedStars
from ship_attitude_star.stars.selection import StarPrior, select
from ship_attitude_star.stars.solution import SolutionStatus, solve_stars
from ship_estimation.kalman import LinearMeasurement
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason, Refusal
from ship_geometry import compiled_rotations
from ship_geometry.attitude_track import InterpolatedAttitude
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, exp_rotation, left_jacobian

_ACROSS = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""What a turn of the device makes of a point straight ahead: (up, right) by (forward, up, right)."""
_ACROSS.flags.writeable = False

_LENGTH_SIGMAS = 5.0
"""A baseline whose length is off by more is a wrong solution."""

_TURNED_AS_DEVICE = np.eye(3)
_TURNED_AS_DEVICE.flags.writeable = False


class PredictedAttitude(NamedTuple):
    """A device's attitude as the state predicts it.

    Attributes:
        rotation_nv: horizon from device, shape (3, 3).
        jacobian_v: rotation vector in the device frame per state error, shape (3, n).
        interpolation_v: covariance of the error of the INS's attitude between its samples, rotation vector in the
            device frame, rad², shape (3, 3).
    """

    rotation_nv: FloatArray
    jacobian_v: FloatArray
    interpolation_v: FloatArray

    def prior(self, covariance: FloatArray) -> StarPrior:
        """The same as the choice of a sensor's stars takes it, by the covariance of the state, shape (n, n)."""
        prior_v = self.jacobian_v @ covariance @ self.jacobian_v.T + self.interpolation_v
        return StarPrior(self.rotation_nv, self.rotation_nv @ prior_v @ self.rotation_nv.T)


class Compared(NamedTuple):
    """A measurement against its prediction.

    Attributes:
        linear: residual, rad, shape (m,), its Jacobian per state and its noise by source.
        by_turn: derivative of the residual by a turn of the device, rotation vector in its own frame, shape (m, 3).
        components: names of the residuals.
        rotation_nv: horizon from device as measured, shape (3, 3); as predicted where single stars agree with that.
        predicted_nv: the same as predicted, shape (3, 3).
        attitude_noise_v: noise of a measured attitude, rotation vector in the device frame, rad², shape (3, 3); zero
            for single stars.
        left_out: stars that had no part in it, by name.
    """

    linear: LinearMeasurement
    by_turn: FloatArray
    components: tuple[str, ...]
    rotation_nv: FloatArray
    predicted_nv: FloatArray
    attitude_noise_v: FloatArray
    left_out: tuple[tuple[str, Refusal], ...] = ()

    @property
    def attitude_noise_n(self) -> FloatArray:
        """The noise of a measured attitude about the horizon's axes, rad², shape (3, 3)."""
        noise_n: FloatArray = self.rotation_nv @ self.attitude_noise_v @ self.rotation_nv.T
        return noise_n


def predict_attitude(
    device: Device, model: ShipStateModel, mean: FloatArray, ins: InterpolatedAttitude
) -> PredictedAttitude:
    """The attitude of a device at the moment of an (interpolated) INS attitude.

    The chain is multiplied from the device outwards; an error of a factor exp(v) is a small rotation
    J_left(v) dv in the frame on its left, which everything multiplied so far brings into the device frame.
    """
    chain = model.chains[device.name]
    found = compiled_rotations.hung(
        mean,
        chain.links,
        chain.fixed,
        chain.hull,
        chain.white,
        math.sqrt(ins.noise_gain),
        chain.clocks,
        chain.signs,
        ins.rotation_nd,
        ins.rate_d,
        ins.error_covariance_d,
    )
    return PredictedAttitude(*found)


def compare(
    measurement: Measurement,
    device: Device,
    predicted: PredictedAttitude,
    model: ShipStateModel,
    mean: FloatArray,
    covariance: FloatArray,
    watch: SkyWatch | None,
    expected: PredictedAttitude | None = None,
) -> Compared | Refusal:
    """Compare a measurement with the attitude predicted for its device.

    Args:
        measurement: an attitude in the horizon, a baseline, or single stars.
        device: that measured.
        predicted: attitude of the device at the moment of the measurement.
        model: what the states are.
        mean: of the state, shape (n,).
        covariance: of the state, shape (n, n).
        watch: the sky; None where no sensor needs it.
        expected: attitude of the device by the mean that the covariance belongs to, where ``mean`` is another one; it
            is what tells which stars are believed.

    Returns:
        The refusal where it cannot be compared.
    """
    index, between = model.source_indices, model.source_indices[SOURCE_INTERPOLATION]
    if isinstance(measurement, AttitudeMeasurement):
        residual, jacobian = _attitude_residual(measurement, predicted, model, mean)
        noise, interpolation = measurement.noise_v, predicted.interpolation_v
        return Compared(
            linear=LinearMeasurement(residual, jacobian, {index[device.noise_source]: noise, between: interpolation}),
            by_turn=_TURNED_AS_DEVICE,
            components=ATTITUDE_COMPONENTS,
            rotation_nv=measurement.rotation_nv,
            predicted_nv=predicted.rotation_nv,
            attitude_noise_v=noise,
        )
    if isinstance(measurement, BaselineMeasurement):
        return _baseline_compared(measurement, device, predicted, model)
    assert watch is not None
    assert isinstance(measurement, StarExposure)
    stars = star_residuals(measurement, predicted, covariance, watch, model, mean, expected)
    if isinstance(stars, Refusal):
        return stars
    interpolation = stars.by_turn @ predicted.interpolation_v @ stars.by_turn.T
    noise_by_source = {index[device.noise_source]: stars.noise, between: interpolation}
    return Compared(
        linear=LinearMeasurement(stars.residual, stars.jacobian, noise_by_source),
        by_turn=stars.by_turn,
        components=stars.components,
        rotation_nv=predicted.rotation_nv if stars.rotation_ns is None else stars.rotation_ns,
        predicted_nv=predicted.rotation_nv,
        attitude_noise_v=np.zeros((3, 3)),
        left_out=stars.refused,
    )


def _baseline_compared(
    measurement: BaselineMeasurement, device: Device, predicted: PredictedAttitude, model: ShipStateModel
) -> Compared | Refusal:
    """A baseline against the direction predicted for it; its length against that which it has on the ship.

    The residual is where its end is seen, up and right in its own frame, rad: two components, as of a single star.
    """
    length_m, told_m, noise_n = device.length_m, measurement.length_m, measurement.noise_n
    along = measurement.direction_n
    sigma_m = math.sqrt(float(along @ noise_n @ along) + device.length_sigma_m**2)
    # Written so that NaN is refused.
    if not abs(told_m - length_m) <= _LENGTH_SIGMAS * sigma_m:
        text = f"the baseline came out {told_m:.3f} m long, and is {length_m:.3f} m (sigma {sigma_m:.3f} m)"
        return Refusal(Reason.GATE, f"{text}: a wrong solution, or ship_baseline")
    to_device = predicted.rotation_nv.T
    seen_v = to_device @ along
    if not seen_v[0] > 0.0:
        return Refusal(Reason.GATE, "the baseline points the other way: are base and rover exchanged?")
    noise_v = to_device @ noise_n @ to_device.T / length_m**2
    turn_v = np.array([0.0, -seen_v[2], seen_v[1]]) / seen_v[0]
    return Compared(
        linear=LinearMeasurement(
            _ACROSS @ turn_v,
            _ACROSS @ predicted.jacobian_v,
            {
                model.source_indices[device.noise_source]: noise_v[1:, 1:],
                model.source_indices[SOURCE_INTERPOLATION]: _ACROSS @ predicted.interpolation_v @ _ACROSS.T,
            },
        ),
        by_turn=_ACROSS,
        components=BASELINE_COMPONENTS,
        rotation_nv=predicted.rotation_nv @ exp_rotation(turn_v),
        predicted_nv=predicted.rotation_nv,
        attitude_noise_v=np.zeros((3, 3)),
    )


def _attitude_residual(
    measurement: AttitudeMeasurement, predicted: PredictedAttitude, model: ShipStateModel, mean: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Measured minus predicted attitude and its Jacobian per state.

    The residual is log(R_predicted^T R_measured), a rotation vector in the device frame, rad, shape (3,); the Jacobian
    has the shape (3, n).
    """
    rotation_nv, jacobian_v = predicted.rotation_nv, predicted.jacobian_v
    if measurement.shared_n is not None:
        rows = model.shared_rows[measurement.shared_by]
        turn = -measurement.shared_n @ mean[rows]
        rotation_nv = exp_rotation(turn) @ rotation_nv
        jacobian_v = jacobian_v.copy()
        jacobian_v[:, rows] = -rotation_nv.T @ left_jacobian(turn) @ measurement.shared_n
    return compiled_rotations.turn_between(rotation_nv, measurement.rotation_nv), jacobian_v


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
    model: ShipStateModel,
    mean: FloatArray,
    expected: PredictedAttitude | None = None,
) -> StarResiduals | Refusal:
    """Choose the stars that are what they are taken for, and compare them with the prediction.

    Args:
        exposure: the stars where they stood at its middle.
        predicted: attitude of the sensor.
        covariance: of the state, shape (n, n).
        watch: the sky.
        model: what the states are.
        mean: of the state, shape (n,).
        expected: as for :func:`compare`.

    Returns:
        The refusal of the whole exposure where no star can be placed in the sky at its moment, or none can be used.
    """
    rotation_ns, to_sensor = predicted.rotation_nv, predicted.jacobian_v
    prior = (expected or predicted).prior(covariance)
    visible = visible_stars(exposure, watch, prior)
    if isinstance(visible, Refusal):
        return visible
    seen, stars, refused = visible
    if len(stars.sigma) == 0:
        nameless = any(refusal.reason is Reason.UNIDENTIFIED for _, refusal in refused)
        reason = Reason.UNIDENTIFIED if nameless else Reason.TOO_FEW_STARS
        return Refusal(reason, _listed(f"none of {len(exposure)} stars can be used", refused))
    rows = model.sky_rows
    # The estimate of the shared errors moves the stars to where they are expected.
    expected_n = compiled_fit.expected(stars.reference_n, stars.shared_n, mean[rows])
    at_estimate = replace(stars, reference_n=expected_n)
    believed = _believed(stars, at_estimate, prior, None if expected is None else rotation_ns)
    if isinstance(believed, Refusal):
        return Refusal(believed.reason, _listed(believed.text, refused))
    members, alone_ns = believed
    turned_ns = rotation_ns if alone_ns is None else alone_ns
    refused += [(seen.name(row), _misfit(stars, row, turned_ns)) for row in np.flatnonzero(~members).tolist()]
    if not members.any():
        return Refusal(Reason.MISIDENTIFIED, _listed(_contradiction(len(members)), refused))
    names = [seen.name(row) for row in np.flatnonzero(members).tolist()]
    residual, jacobian, by_turn, basis = compiled_fit.residuals(
        stars.measured_b, expected_n, stars.shared_n, members.view(np.uint8), rotation_ns, to_sensor, rows.start
    )
    return StarResiduals(
        residual=residual,
        jacobian=jacobian,
        by_turn=by_turn,
        noise=_noise(at_estimate, basis, members),
        components=tuple(f"{name} {axis}" for name in names for axis in ("up", "right")),
        refused=tuple(refused),
        rotation_ns=alone_ns,
    )


def _believed(
    stars: SightedStars, at_estimate: SightedStars, prior: StarPrior, near_ns: FloatArray | None
) -> tuple[NDArray[np.bool_], FloatArray | None] | Refusal:
    """The stars that agree with the prediction; where none does, those that agree on another attitude.

    Args:
        stars: with their places by the sky.
        at_estimate: the same where the estimate of the shared errors expects them.
        prior: the prediction.
        near_ns: an attitude near the truth, where the prediction's own is perhaps not, shape (3, 3).

    Returns:
        True for each of them, shape (k,), none where the stars contradict the prediction as well as one another; and
        the attitude of the sensor by them alone where they contradict the prediction, else None.
    """
    choice = select(at_estimate, prior, near_ns)
    if choice.by_chance is not None:
        return improbable_identity(choice.by_chance)
    if choice.members.any():
        return choice.members, None
    alone = solve_stars(stars)
    if alone.status in (SolutionStatus.INVALID, SolutionStatus.UNVERIFIED):
        return choice.members, None
    return alone.members, alone.rotation_nb


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


def _misfit(stars: SightedStars, row: int, rotation_ns: FloatArray) -> Refusal:
    angle = float(angle_between(rotation_ns @ stars.measured_b[row], stars.reference_n[row]))
    text = f'{angle / ARCSEC:.1f}" from its place, sigma {stars.white_sigma[row] / ARCSEC:.1f}"'
    return Refusal(Reason.MISIDENTIFIED, text)


def _listed(text: str, refused: list[tuple[str, Refusal]]) -> str:
    return "; ".join([text, *(f"{name}: {refusal.text}" for name, refusal in refused)])
