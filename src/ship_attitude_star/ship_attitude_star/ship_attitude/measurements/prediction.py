"""Prediction of a measurement, and its linearisation for one Kalman update (iterated extended Kalman filter).

The INS attitude is matched to a measurement by the clock offsets, and the attitude of the device is predicted from the
INS attitude. Both steps depend on the state nonlinearly. One linearisation at the predicted state is enough if the
predicted rotation and the clock offset have small standard deviations. Otherwise the measurement is linearised again at
the new estimate until the estimate converges (Gauss–Newton).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ship_attitude.measurements.device import (
    ComparedMeasurement,
    Device,
    InsMatch,
    LinearisationPoint,
    PredictedAttitude,
)
from ship_attitude_star.ship_attitude.model import ShipStateModel
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_estimation.rejection_rules import Reason, Rejection, singular_covariance
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.late_libraries import lapack
from ship_geometry.rotations import FloatArray, exp_rotation, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeTrack, InterpolatedAttitude
from ship_kernels import compiled_kalman, compiled_rotations
from ship_stars.attitude_from_stars.selection import LINEAR_RANGE
from ship_stars.sky.sky_model import SkyModel

_CONVERGED_RAD = 2e-4
"""Convergence limit of the distance between linearisation point and estimate, rad; the second-order term is 0.004″."""

_LINEAR_CLOCK_SIGMA_S = 0.01
"""Maximum standard deviation of a clock offset for one linearisation, s.

A roll of 10° with a period of 10 s has an angular acceleration of 14 000″/s², which causes 0.7″ in this time.
"""

_CORRELATED_MOTION_S = 3.0
"""Correlation time of the ship's angular acceleration, s, and so of the nonlinear effect of a clock offset."""

_FAR_SIGMAS = 3.0
"""Clock offset at which the nonlinear effect is evaluated, in standard deviations from the estimate."""

_MAX_ITERATIONS = 20


class LinearisedMeasurement(NamedTuple):
    """A linearised measurement.

    Attributes:
        measurement: the measurement as compared; an attitude relative to the ICRS is converted to the horizon.
        compared: the comparison at the linearisation point x. The residual ``compared.linear.residual`` is relative to
            the predicted mean, measured - predicted(x) + jacobian @ (x - mean). A Kalman update of the predicted state
            with this residual gives the estimate. The NIS is a sum of two normalised squares, minimised over all
            states: the deviation of the state from the prediction, and the remaining residual. The NIS is chi²
            distributed with as many degrees of freedom as residuals.
        ins: attitude of the INS, matched with the predicted clock offsets.
        matched_ins_ns: stamp of the INS attitude that is matched with the clock offsets at x.
        ins_time_ns: latest INS stamp that the comparison depends on.
    """

    measurement: Measurement
    compared: ComparedMeasurement
    ins: InterpolatedAttitude
    matched_ins_ns: int
    ins_time_ns: int


@dataclass(frozen=True)
class NotEvaluable:
    """A measurement that cannot be evaluated.

    Attributes:
        rejection: the rejection, with its reason.
        ins_time_ns: latest INS stamp that the rejection depends on.
    """

    rejection: Rejection
    ins_time_ns: int

    @property
    def is_contradiction(self) -> bool:
        """True if the measurement contradicts the prediction."""
        return self.rejection.reason in (Reason.UNIDENTIFIED, Reason.MISIDENTIFIED, Reason.GATE)


class _LinearisationTask(NamedTuple):
    """Inputs of a linearisation.

    Attributes:
        measurement: measurement as received.
        device: device that measured.
        mean: mean of the predicted state, shape (n,).
        covariance: covariance of the predicted state, shape (n, n).
        last_used_ns: stamp of the last accepted measurement of each source, ns.
        track: attitudes of the INS.
        sky_model: sky model.
        may_wait: True if INS samples may still arrive.
        offset_sigma_s: standard deviation of the clock offset, at most as configured, s.
    """

    measurement: Measurement
    device: Device
    mean: FloatArray
    covariance: FloatArray
    last_used_ns: Mapping[str, int]
    track: AttitudeTrack
    sky_model: SkyModel | None
    may_wait: bool
    offset_sigma_s: float

    def count_within(self, period_s: float) -> float:
        """Return the number of measurements of the source in a period, at its present rate; at least 1."""
        last_ns = self.last_used_ns.get(self.measurement.source)
        if last_ns is None:
            return 1.0
        return max(period_s * SECOND_NS / max(self.measurement.time_ns - last_ns, 1), 1.0)

    def count_between(self, ins: InterpolatedAttitude) -> float:
        """Return the number of measurements between the two samples of an interpolated INS attitude; at least 1."""
        if ins.sample is None or ins.next_sample is None:
            return 1.0
        interval_ns = ins.next_sample.time_ns - ins.sample.time_ns
        own, since_ns = self.measurement.source, self.measurement.time_ns - interval_ns
        others = sum(last_ns > since_ns for source, last_ns in self.last_used_ns.items() if source != own)
        return (1 + others) * self.count_within(interval_ns / SECOND_NS)


class _MatchedMeasurement(NamedTuple):
    """A measurement with the INS attitude that is matched to it.

    Attributes:
        measurement: the measurement, converted for the comparison.
        ins: matched INS attitude.
        matched_ins_ns: stamp of the matched INS attitude.
        ins_time_ns: latest INS stamp needed.
    """

    measurement: Measurement
    ins: InterpolatedAttitude
    matched_ins_ns: int
    ins_time_ns: int


def predict_attitude(
    device: Device, model: ShipStateModel, mean: FloatArray, ins: InterpolatedAttitude
) -> PredictedAttitude:
    """Predict the attitude of a device from an (interpolated) INS attitude.

    The rotations are multiplied from the device outwards. An error dv of a factor exp(v) is a small rotation J_left(v)
    dv in the frame to the left of the factor. The transpose of the product of this factor and all factors to its right
    rotates J_left(v) dv into the device frame.
    """
    chain = model.rotation_chains[device.name]
    links, clocks = (chain.links, chain.fixed, chain.hull_link), (chain.clock_states, chain.clock_signs)
    of_ins = ins.rotation_nd, ins.rate_d, ins.error_covariance_d
    noise_gain = math.sqrt(ins.noise_gain)
    return PredictedAttitude(
        *compiled_rotations.composed_attitude(mean, *links, chain.noise_link, noise_gain, *clocks, *of_ins)
    )


class Linearisation:
    """Linearisation of the measurements of all devices of a filter.

    Args:
        model: state vector.
        devices: devices by name.
        vertical: vertical along the track; None if the deflection is not modelled.

    Attributes:
        longest_shift_s: bound of the difference of INS stamp and device stamp at one time, configured offset plus 5
            sigma, s.
        longest_reach_s: bound of the time from a measurement to the required INS samples, configured offset plus 8
            sigma, s.
    """

    def __init__(
        self, model: ShipStateModel, devices: Mapping[str, Device], vertical: VerticalTrack | None = None
    ) -> None:
        self._model, self._devices, self._vertical = model, devices, vertical
        # For each device the Jacobian of its clock offset from the INS with respect to the state, shape (n,).
        self._offset_jacobians = {name: np.zeros(model.size) for name in devices}
        for name, chain in model.rotation_chains.items():
            self._offset_jacobians[name][chain.clock_states] = chain.clock_signs
        # The nonzero elements of these Jacobians are stored as pairs of a state and its sign.
        self._clocks = {
            name: tuple(zip(chain.clock_states.tolist(), chain.clock_signs.tolist(), strict=True))
            for name, chain in model.rotation_chains.items()
        }
        self._configured_sigma_s = {
            name: float(np.linalg.norm([model.blocks[state].sigma[0] for state, _ in device.ins_time_states]))
            for name, device in devices.items()
        }
        shifts_s = [(abs(device.ins_time_s), self._configured_sigma_s[name]) for name, device in devices.items()]
        self.longest_shift_s, self.longest_reach_s = (
            max((shift_s + sigmas * sigma_s for shift_s, sigma_s in shifts_s), default=0.0)
            for sigmas in (5.0, 5.0 + _FAR_SIGMAS)
        )

    def ins_time_ns(self, mean: FloatArray, measurement: Measurement) -> int:
        """Return the INS stamp of the measured attitude, ns, with the clock offsets of a mean, shape (n,)."""
        source = measurement.source
        estimated_s: float = sum(sign * mean.item(state) for state, sign in self._clocks[source])
        shift_s = self._devices[source].ins_time_s + estimated_s
        return measurement.time_ns + round(shift_s * SECOND_NS)

    def linearise(
        self,
        measurement: Measurement,
        mean: FloatArray,
        covariance: FloatArray,
        last_used_ns: Mapping[str, int],
        track: AttitudeTrack,
        sky_model: SkyModel | None,
        may_wait: bool = False,
    ) -> LinearisedMeasurement | NotEvaluable | None:
        """Linearise a measurement at the predicted state, or iteratively if this state is too uncertain.

        Args:
            measurement: measurement of any kind.
            mean: mean of the predicted state, shape (n,).
            covariance: covariance of the predicted state, shape (n, n).
            last_used_ns: stamp of the last accepted measurement of each source, ns.
            track: attitudes of the INS.
            sky_model: sky model; None if no sensor needs it.
            may_wait: True if INS samples may still arrive.

        Returns:
            The linearised measurement, or the reason why it is not evaluable; None if required INS samples may still
            arrive.
        """
        source = measurement.source
        device, by_offset = self._devices[source], self._offset_jacobians[source]
        # An inflation of the covariance must not raise the sigma of a clock offset above the configured sigma.
        offset_variance = compiled_kalman.variance_along(by_offset, covariance)
        offset_sigma_s = min(math.sqrt(max(offset_variance, 0.0)), self._configured_sigma_s[source])
        task = _LinearisationTask(
            measurement, device, mean, covariance, last_used_ns, track, sky_model, may_wait, offset_sigma_s
        )
        matched = self._match_to_ins(task, mean)
        if not isinstance(matched, _MatchedMeasurement):
            return matched
        predicted = predict_attitude(device, self._model, mean, matched.ins)
        rotation_variance = compiled_kalman.projected_variance(predicted.jacobian_v, covariance, by_offset)
        if offset_sigma_s > _LINEAR_CLOCK_SIGMA_S or rotation_variance > LINEAR_RANGE**2:
            return self._iterate(task, matched, predicted)
        at = LinearisationPoint(self._model, mean, covariance, predicted, sky_model)
        compared = device.linearise(matched.measurement, at)
        if isinstance(compared, Rejection):
            return NotEvaluable(compared, matched.ins_time_ns)
        return LinearisedMeasurement(
            matched.measurement, compared, matched.ins, matched.matched_ins_ns, matched.ins_time_ns
        )

    def _match_to_ins(self, task: _LinearisationTask, mean: FloatArray) -> _MatchedMeasurement | NotEvaluable | None:
        """Match the INS attitude to a measurement, with the clock offsets of a mean, shape (n,).

        Returns:
            The matched measurement, or the reason why it is not evaluable; None if INS samples are pending.
        """
        measurement, track = task.measurement, task.track
        ins_time_ns = self.ins_time_ns(mean, measurement)
        around_ns = 0
        if task.offset_sigma_s > _LINEAR_CLOCK_SIGMA_S:
            around_ns = round(_FAR_SIGMAS * task.offset_sigma_s * SECOND_NS)
        if task.may_wait and not track.is_final_at(ins_time_ns + max(measurement.reach_ns, around_ns)):
            return None
        ins = track.at(ins_time_ns)
        if ins is None:
            text = "no INS samples on both sides of the measurement"
            return NotEvaluable(Rejection(Reason.GAP, text), ins_time_ns)
        match = InsMatch(ins, ins_time_ns, track, task.sky_model, self._vertical)
        converted = task.device.convert(measurement, match)
        if isinstance(converted, Rejection):
            return NotEvaluable(converted, ins_time_ns)
        measurement, ins = converted
        shared_count = task.count_between(ins)
        if shared_count > 1.0:
            # All measurements between two samples share one interpolation error, but the filter treats it as noise. The
            # variance is therefore multiplied by the number of these measurements, so that their mean has the variance
            # of the shared error.
            ins = replace(ins, error_covariance_d=shared_count * ins.error_covariance_d)
        if around_ns:
            nonlinear_d = _nonlinear_offset_covariance(track, ins_time_ns, around_ns, ins)
            if nonlinear_d is None:
                text = "no INS samples around the measurement, and its clock offset is not known"
                return NotEvaluable(Rejection(Reason.GAP, text), ins_time_ns + around_ns)
            ins = replace(
                ins, error_covariance_d=ins.error_covariance_d + task.count_within(_CORRELATED_MOTION_S) * nonlinear_d
            )
        return _MatchedMeasurement(measurement, ins, ins_time_ns, ins_time_ns + around_ns)

    def _iterate(
        self, task: _LinearisationTask, matched: _MatchedMeasurement, expected: PredictedAttitude
    ) -> LinearisedMeasurement | NotEvaluable | None:
        """Linearise a measurement iteratively; the residual is relative to the predicted mean.

        Args:
            task: inputs of the linearisation.
            matched: the measurement matched with the predicted mean.
            expected: attitude of the device predicted with the predicted mean.
        """
        model, until_ns = self._model, matched.ins_time_ns
        correction = self._start_correction(task, matched, expected)
        for _ in range(_MAX_ITERATIONS):
            mean = task.mean + correction
            # The INS attitude is matched again with the clock offset of this mean. Otherwise the rotation of the ship
            # during the estimated offset would be in the residual and in the Jacobian, and would count twice.
            found = self._match_to_ins(task, mean) if correction.any() else matched
            if not isinstance(found, _MatchedMeasurement):
                return found if found is None else replace(found, ins_time_ns=max(until_ns, found.ins_time_ns))
            until_ns = max(until_ns, found.ins_time_ns)
            predicted = predict_attitude(task.device, model, mean, found.ins)
            at = LinearisationPoint(model, mean, task.covariance, predicted, task.sky_model, expected)
            at_point = task.device.linearise(found.measurement, at)
            if isinstance(at_point, Rejection):
                return NotEvaluable(at_point, until_ns)
            linear = replace(at_point.linear, residual=at_point.linear.residual + at_point.linear.jacobian @ correction)
            next_correction = _correction(linear, task.covariance)
            if next_correction is None:
                return NotEvaluable(singular_covariance(), until_ns)
            step = float(np.linalg.norm(predicted.jacobian_v @ (next_correction - correction)))
            if step < _CONVERGED_RAD:
                compared = at_point._replace(linear=linear, predicted_nv=expected.rotation_nv)
                return LinearisedMeasurement(found.measurement, compared, matched.ins, found.matched_ins_ns, until_ns)
            correction = next_correction
        text = f"the linearisation did not converge in {_MAX_ITERATIONS} iterations"
        return NotEvaluable(Rejection(Reason.GATE, text), until_ns)

    def _start_correction(
        self, task: _LinearisationTask, matched: _MatchedMeasurement, expected: PredictedAttitude
    ) -> FloatArray:
        """Return the first linearisation point, relative to the predicted mean, shape (n,).

        For a device with an initial attitude this point is that attitude. Otherwise the correction is zero.
        """
        correction = np.zeros_like(task.mean)
        at = LinearisationPoint(self._model, task.mean, task.covariance, expected, task.sky_model)
        initial_nv = task.device.initial_attitude(matched.measurement, at)
        if initial_nv is None:
            return correction
        rotation_n = initial_nv @ expected.rotation_nv.T
        ins_attitude = self._model.slices["ins.attitude"]
        mean = task.mean[ins_attitude]
        correction[ins_attitude] = log_rotation(rotation_n @ exp_rotation(mean)) - mean
        return correction


def _nonlinear_offset_covariance(
    track: AttitudeTrack, ins_time_ns: int, around_ns: int, here: InterpolatedAttitude
) -> FloatArray | None:
    """Return the covariance of the nonlinear effect of an unknown clock offset, deck frame, rad², shape (3, 3).

    The covariance is computed from two rotations: from the attitude ``here`` to the attitudes earlier and later by
    :data:`_FAR_SIGMAS` standard deviations of the offset. Half of their sum is the quadratic part; half of their
    difference, less the rotation at a constant rate, is the cubic part. Each part is taken as :data:`_FAR_SIGMAS`
    standard deviations of a normal error, which is conservative for most offsets.

    If the track does not contain both attitudes, nearer attitudes are used, down to an eighth of ``around_ns``. The
    result is None if nearer attitudes are missing too.
    """
    for nearer in (1, 2, 4, 8):
        off_ns = around_ns // nearer
        before, after = track.at(ins_time_ns - off_ns), track.at(ins_time_ns + off_ns)
        if before is None or after is None:
            continue
        to_before, to_after = (log_rotation(here.rotation_nd.T @ other.rotation_nd) for other in (before, after))
        square = 0.5 * (to_after + to_before) * nearer**2
        cube = (0.5 * (to_after - to_before) - here.rate_d * (off_ns / SECOND_NS)) * nearer**3
        covariance: FloatArray = (np.outer(square, square) + np.outer(cube, cube)) / _FAR_SIGMAS**2
        return covariance
    return None


def _correction(linear: LinearMeasurement, covariance: FloatArray) -> FloatArray | None:
    """Return the correction of the mean by a linearised measurement, shape (n,); None if singular or not finite."""
    cross = linear.jacobian @ covariance
    _, solution, failed = lapack.dposv(cross @ linear.jacobian.T + linear.noise, linear.residual)
    correction: FloatArray = cross.T @ solution
    return None if failed or not np.all(np.isfinite(correction)) else correction
