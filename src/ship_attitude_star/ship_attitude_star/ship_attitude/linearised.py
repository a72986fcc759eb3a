"""A measurement, linearised where the estimate will be: what the filter's one Kalman step needs.

The INS's attitude that belongs to a measurement is taken at the offset of the clocks, and the device's attitude is
predicted from it; both depend on the state, and not in a straight line. One linearisation at the predicted state is
enough where that is known well beside the measurement's own noise. Otherwise the measurement is linearised anew at the
estimate that it leads to, until that stays (Gauss-Newton; the iterated Kalman filter).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.measurements.samples import SHARED_BY_GRAVITY, AttitudeMeasurement, SolvedAttitude
from ship_attitude_star.ship_attitude.comparison import Compared, PredictedAttitude, compare, predict_attitude
from ship_attitude_star.ship_attitude.model import Device, ShipStateModel
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.stars.exposure import StarExposure, at_middle, visible_stars
from ship_attitude_star.stars.selection import LINEAR_RANGE
from ship_attitude_star.stars.solution import likely_attitude
from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation import compiled_steps
from ship_estimation.kalman import LinearMeasurement
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason, Refusal, singular_covariance
from ship_geometry import lapack
from ship_geometry.attitude_track import AttitudeTrack, InterpolatedAttitude
from ship_geometry.exposure_mean import turning_over
from ship_geometry.rotations import FloatArray, exp_rotation, log_rotation
from ship_geometry.time_scales import SECOND_NS

_SMALL_TURN = 2e-4
"""A linearisation that lies closer than this (rad) to the estimate is at the estimate: the square is 0.004
arcseconds."""

_KNOWN_CLOCK_S = 0.01
"""An offset of the clocks that is known to better than this (sigma) needs one linearisation: a ship that rolls by 10
degrees in 10 s accelerates by 14 000 arcseconds per s², which makes 0.7 arcseconds in that time."""

_SAME_MOTION_S = 3.0
"""For so long a ship goes on accelerating the same way: what an unknown offset of the clocks does to one measurement it
does to the next one too."""

_FAR = 3.0
"""Sigmas from the estimate at which an offset of the clocks is called far off."""

_MOST_STEPS = 20

_AGAINST_SKY = (InertialAttitude, SolvedAttitude)


class Linearised(NamedTuple):
    """A measurement as the filter uses it.

    Attributes:
        measured: the measurement as it is compared: an attitude against the ICRS is one in the horizon here.
        compared: the comparison at the point of linearisation; its ``linear.residual`` is told relative to the
            predicted mean: measured - predicted(x) + jacobian @ (x - mean), where x is that point. One Kalman step with
            it, from the predicted state, leads to the estimate, and its NIS is the least sum of squares that any state
            can reach against prediction and measurement together: chi² with as many degrees of freedom as residuals.
        ins: attitude of the INS that belongs to the measurement.
        paired_ns: stamp of the INS at which it was compared.
        ins_time_ns: the latest stamp of the INS that the comparison rests on.
    """

    measured: Measurement
    compared: Compared
    ins: InterpolatedAttitude
    paired_ns: int
    ins_time_ns: int


@dataclass(frozen=True)
class NotCompared:
    """A measurement that cannot be compared.

    Attributes:
        refusal: why not.
        ins_time_ns: the latest stamp of the INS that this rests on.
    """

    refusal: Refusal
    ins_time_ns: int

    @property
    def contradicts(self) -> bool:
        """Whether it speaks against what is predicted: where that is right, most measurements fit it somehow."""
        return self.refusal.reason in (Reason.UNIDENTIFIED, Reason.MISIDENTIFIED, Reason.GATE)


class _Task(NamedTuple):
    """What a measurement is to be linearised with.

    Attributes:
        measurement: as it came.
        device: that measured.
        mean: of the predicted state, shape (n,).
        covariance: of the predicted state, shape (n, n).
        used_ns: by source, the stamp of its last measurement that was used.
        track: attitudes of the INS.
        watch: the sky.
        may_wait: whether samples of the INS may still come.
        offset_sigma_s: sigma of the offset of the clocks.
    """

    measurement: Measurement
    device: Device
    mean: FloatArray
    covariance: FloatArray
    used_ns: Mapping[str, int]
    track: AttitudeTrack
    watch: SkyWatch | None
    may_wait: bool
    offset_sigma_s: float

    def count_within(self, period_s: float) -> float:
        """Number of measurements of the source in a period, by the time since its last one; at least 1."""
        last_ns = self.used_ns.get(self.measurement.source)
        if last_ns is None:
            return 1.0
        return max(period_s * SECOND_NS / max(self.measurement.time_ns - last_ns, 1), 1.0)

    def count_between(self, ins: InterpolatedAttitude) -> float:
        """Number of measurements that are compared between the two samples of an attitude of the INS; at least 1."""
        if ins.sample is None or ins.next_sample is None:
            return 1.0
        interval_ns = ins.next_sample.time_ns - ins.sample.time_ns
        own, since_ns = self.measurement.source, self.measurement.time_ns - interval_ns
        others = sum(last_ns > since_ns for source, last_ns in self.used_ns.items() if source != own)
        return (1 + others) * self.count_within(interval_ns / SECOND_NS)


class _Paired(NamedTuple):
    """A measurement as it is compared, the INS's attitude that belongs to it, its stamp and the latest one needed."""

    measurement: Measurement
    ins: InterpolatedAttitude
    paired_ns: int
    ins_time_ns: int


class Linearisation:
    """How measurements follow from the state.

    Args:
        model: what the states are.
        devices: by name.
        vertical: the vertical under way; None where no deflection of it is modelled.
    """

    def __init__(
        self, model: ShipStateModel, devices: Mapping[str, Device], vertical: VerticalTrack | None = None
    ) -> None:
        self._model, self._devices, self._vertical = model, devices, vertical
        # The derivative of the offset of each device's clock by the state, shape (n,).
        self._offsets = {name: np.zeros(model.size) for name in devices}
        for name, chain in model.chains.items():
            self._offsets[name][chain.clocks] = chain.signs
        # The same as pairs of a state and its sign.
        self._clocks = {
            name: tuple(zip(chain.clocks.tolist(), chain.signs.tolist(), strict=True))
            for name, chain in model.chains.items()
        }
        self._told_sigma_s = {name: _told_sigma_s(model, device) for name, device in devices.items()}

    @property
    def longest_shift_s(self) -> float:
        """Bound on how far the INS's stamp of an attitude may lie from a device's: configured offsets and 5 sigma."""
        return self._longest_s(5.0)

    @property
    def longest_reach_s(self) -> float:
        """Bound on how far samples of the INS matter: beside that shift, as far around it as tells how a ship moves."""
        return self._longest_s(5.0 + _FAR)

    def _longest_s(self, sigmas: float) -> float:
        shifts_s = (abs(one.ins_time_s) + sigmas * self._told_sigma_s[name] for name, one in self._devices.items())
        return max(shifts_s, default=0.0)

    def ins_time_ns(self, mean: FloatArray, measurement: Measurement) -> int:
        """Stamp (ns) of the INS for the attitude that was measured, by a mean of the state, shape (n,)."""
        source = measurement.source
        estimated_s: float = sum(sign * mean.item(state) for state, sign in self._clocks[source])
        shift_s = self._devices[source].ins_time_s + estimated_s
        return measurement.time_ns + round(shift_s * SECOND_NS)

    def of(
        self,
        measurement: Measurement,
        mean: FloatArray,
        covariance: FloatArray,
        used_ns: Mapping[str, int],
        track: AttitudeTrack,
        watch: SkyWatch | None,
        may_wait: bool = False,
    ) -> Linearised | NotCompared | None:
        """The measurement linearised where it leads the predicted state.

        Args:
            measurement: of any kind.
            mean: of the predicted state, shape (n,).
            covariance: of the predicted state, shape (n, n).
            used_ns: by source, the stamp of its last measurement that was used.
            track: attitudes of the INS.
            watch: the sky; None where no sensor needs it.
            may_wait: whether samples of the INS may still come.

        Returns:
            None where samples of the INS that may still come belong to the measurement.
        """
        source = measurement.source
        device, by_offset = self._devices[source], self._offsets[source]
        # A state that was opened for another reason does not make a clock less known than it was told.
        offset_variance = compiled_steps.variance_along(by_offset, covariance)
        offset_sigma_s = min(math.sqrt(max(offset_variance, 0.0)), self._told_sigma_s[source])
        task = _Task(measurement, device, mean, covariance, used_ns, track, watch, may_wait, offset_sigma_s)
        paired = self._paired(task, mean)
        if not isinstance(paired, _Paired):
            return paired
        predicted = predict_attitude(device, self._model, mean, paired.ins)
        turn_variance = compiled_steps.spread(predicted.jacobian_v, covariance, by_offset)
        if offset_sigma_s > _KNOWN_CLOCK_S or turn_variance > LINEAR_RANGE**2:
            return self._settled(task, paired, predicted)
        compared = compare(paired.measurement, device, predicted, self._model, mean, covariance, watch)
        if isinstance(compared, Refusal):
            return NotCompared(compared, paired.ins_time_ns)
        return Linearised(paired.measurement, compared, paired.ins, paired.paired_ns, paired.ins_time_ns)

    def _paired(self, task: _Task, mean: FloatArray) -> _Paired | NotCompared | None:
        """What of a measurement is compared, with the attitude of the INS that belongs to it by a mean of the state.

        Returns:
            Why it cannot be compared; None where it waits for samples of the INS.
        """
        measurement, track = task.measurement, task.track
        ins_time_ns = self.ins_time_ns(mean, measurement)
        around_ns = 0
        if task.offset_sigma_s > _KNOWN_CLOCK_S:
            around_ns = round(_FAR * task.offset_sigma_s * SECOND_NS)
        if task.may_wait and not track.covers(ins_time_ns + max(measurement.reach_ns, around_ns)):
            return None
        ins = track.at(ins_time_ns)
        if ins is None:
            text = "no INS samples on both sides of the measurement"
            return NotCompared(Refusal(Reason.GAP, text), ins_time_ns)
        alike = task.count_between(ins)
        if isinstance(measurement, _AGAINST_SKY):
            assert task.watch is not None
            turned = in_horizon(measurement, task.watch)
            if isinstance(turned, Refusal):
                return NotCompared(turned, ins_time_ns)
            measurement = turned
        elif self._vertical is not None and isinstance(measurement, AttitudeMeasurement) and not task.device.is_star:
            # Another attitude system levels itself on gravity, as the INS does.
            turn = self._vertical.at(measurement.time_ns).turn
            measurement = replace(measurement, shared_n=turn, shared_by=SHARED_BY_GRAVITY)
        elif isinstance(measurement, StarExposure) and measurement.length is not None:
            turning = turning_over(track, ins_time_ns, measurement.length.nodes)
            if turning is None:
                return NotCompared(measurement.length.not_covered, ins_time_ns)
            # What is predicted is the mean over the exposure: its errors and its rate are those of the mean. A rate
            # between two samples holds their noise divided by their step. Across a streak, where a star is known best,
            # this noise would count as knowledge of the clock.
            ins = replace(
                ins,
                rate_d=turning.rate,
                noise_gain=turning.noise_gain,
                error_covariance_d=turning.error_covariance,
            )
            measurement = at_middle(measurement, turning.mounted(task.device.rotation_dv0).turns)
        if alike > 1.0:
            # Between two samples the error is one curve, which all measurements there have in common. The filter takes
            # it for noise: with so many times the variance in each, their mean has the variance of the common error.
            ins = replace(ins, error_covariance_d=alike * ins.error_covariance_d)
        if around_ns:
            bent_d = _bent_by_offset(track, ins_time_ns, around_ns, ins)
            if bent_d is None:
                text = "no INS samples around the measurement, and its clock offset is not known"
                return NotCompared(Refusal(Reason.GAP, text), ins_time_ns + around_ns)
            ins = replace(ins, error_covariance_d=ins.error_covariance_d + task.count_within(_SAME_MOTION_S) * bent_d)
        return _Paired(measurement, ins, ins_time_ns, ins_time_ns + around_ns)

    def _settled(self, task: _Task, paired: _Paired, expected: PredictedAttitude) -> Linearised | NotCompared | None:
        """The measurement linearised at the point that it leads to, its residual relative to the predicted mean."""
        model, until_ns = self._model, paired.ins_time_ns
        correction = self._start(task, paired, expected)
        for _ in range(_MOST_STEPS):
            mean = task.mean + correction
            # Prediction and Jacobian belong to the same state, its clock included: otherwise the turn by the estimated
            # offset counts twice.
            found = self._paired(task, mean) if correction.any() else paired
            if not isinstance(found, _Paired):
                return found if found is None else replace(found, ins_time_ns=max(until_ns, found.ins_time_ns))
            until_ns = max(until_ns, found.ins_time_ns)
            predicted = predict_attitude(task.device, model, mean, found.ins)
            there = compare(
                found.measurement, task.device, predicted, model, mean, task.covariance, task.watch, expected
            )
            if isinstance(there, Refusal):
                return NotCompared(there, until_ns)
            linear = replace(there.linear, residual=there.linear.residual + there.linear.jacobian @ correction)
            reached = _correction(linear, task.covariance)
            if reached is None:
                return NotCompared(singular_covariance(), until_ns)
            step = float(np.linalg.norm(predicted.jacobian_v @ (reached - correction)))
            if step < _SMALL_TURN:
                compared = there._replace(linear=linear, predicted_nv=expected.rotation_nv)
                return Linearised(found.measurement, compared, paired.ins, found.paired_ns, until_ns)
            correction = reached
        text = f"the linearisation did not converge in {_MOST_STEPS} iterations"
        return NotCompared(Refusal(Reason.GATE, text), until_ns)

    def _start(self, task: _Task, paired: _Paired, expected: PredictedAttitude) -> FloatArray:
        """Where the search begins, relative to the predicted mean: for stars, where they themselves say, shape (n,)."""
        correction, exposure = np.zeros_like(task.mean), paired.measurement
        if not isinstance(exposure, StarExposure):
            return correction
        assert task.watch is not None
        prior = expected.prior(task.covariance)
        visible = visible_stars(exposure, task.watch, prior)
        if isinstance(visible, Refusal) or not len(visible[1]):
            return correction
        turn_ns = likely_attitude(visible[1], prior) @ expected.rotation_nv.T
        rows = self._model.slices["ins.attitude"]
        correction[rows] = log_rotation(turn_ns @ exp_rotation(task.mean[rows])) - task.mean[rows]
        return correction


def _told_sigma_s(model: ShipStateModel, device: Device) -> float:
    """Sigma of the offset of a device's clock as it is configured."""
    return float(np.linalg.norm([model.blocks[name].sigma[0] for name, _ in device.ins_time_states]))


def _bent_by_offset(
    track: AttitudeTrack, ins_time_ns: int, around_ns: int, here: InterpolatedAttitude
) -> FloatArray | None:
    """Covariance of what an unknown offset does beside the turn that grows with it evenly; deck frame, rad², (3, 3).

    The attitudes that belong to offsets far off, :data:`_FAR` sigma before and after, tell it: half their sum is the
    part that grows with the square of the offset, and what half their difference has more than the rate says grows with
    its cube. They count as that many sigma of a normal error. For most offsets this is too much; the offset is known
    the sooner for it. Where the track does not reach so far, nearer attitudes tell it; None where not an eighth as far.
    """
    for nearer in (1, 2, 4, 8):
        off_ns = around_ns // nearer
        before, after = track.at(ins_time_ns - off_ns), track.at(ins_time_ns + off_ns)
        if before is None or after is None:
            continue
        to_before, to_after = (log_rotation(here.rotation_nd.T @ other.rotation_nd) for other in (before, after))
        square = 0.5 * (to_after + to_before) * nearer**2
        cube = (0.5 * (to_after - to_before) - here.rate_d * (off_ns / SECOND_NS)) * nearer**3
        covariance: FloatArray = (np.outer(square, square) + np.outer(cube, cube)) / _FAR**2
        return covariance
    return None


def _correction(linear: LinearMeasurement, covariance: FloatArray) -> FloatArray | None:
    """Where a linearised measurement moves the mean, shape (n,); None where that is no number."""
    cross = linear.jacobian @ covariance
    _, solution, failed = lapack.dposv(cross @ linear.jacobian.T + linear.noise, linear.residual)
    moved: FloatArray = cross.T @ solution
    return None if failed or not np.all(np.isfinite(moved)) else moved
