"""A measurement, linearised where the estimate will be: what the filter's one Kalman step needs.

The INS's attitude that belongs to a measurement is taken at the offset of the clocks, and the device's attitude is
predicted from it; both depend on the state, and not in a straight line. One linearisation at the predicted state is
enough where that is known well beside the measurement's own noise. Otherwise the measurement is linearised anew at the
estimate that it leads to, until that stays (Gauss-Newton; the iterated Kalman filter).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from ship_attitude_star.measurements.readings import InertialAttitude
from ship_attitude_star.ship_attitude.comparison import Compared, PredictedAttitude, compare, predict_attitude
from ship_attitude_star.ship_attitude.model import Device, ShipStateModel
from ship_attitude_star.sky.sky_watch import SkyWatch
from ship_attitude_star.sky.tracker_attitude import in_horizon
from ship_attitude_star.stars.exposure import StarExposure, at_middle
from ship_estimation.kalman import LinearMeasurement
from ship_estimation.outcome import Measurement
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.attitude_track import AttitudeTrack, InterpolatedAttitude
from ship_geometry.exposure_mean import turning_over
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

_STEPS = 5
_LARGE_STEP = 5e-3
"""The square of a smaller correction (rad) is nothing beside the errors of what was measured."""

_FAR = 5.0
"""The state is hardly ever further from the predicted one than by this many sigma."""


@dataclass(frozen=True)
class Linearised:
    """A measurement as the filter uses it.

    Attributes:
        measured: the measurement as it is compared: an attitude against the ICRS is one in the horizon here.
        compared: the comparison at the point of linearisation; its ``linear.residual`` is told relative to the
            predicted mean: measured - predicted(x) + jacobian @ (x - mean), where x is that point. One Kalman step with
            it, from the predicted state, leads to the estimate, and its NIS is the least sum of squares that any state
            can reach against prediction and measurement together: chi² with as many degrees of freedom as residuals.
        ins: attitude of the INS that belongs to the measurement.
        ins_time_ns: the latest stamp of the INS that the comparison rests on.
    """

    measured: Measurement
    compared: Compared
    ins: InterpolatedAttitude
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


class Linearisation:
    """How measurements follow from the state.

    Args:
        model: what the states are.
        devices: by name.
    """

    def __init__(self, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        self._model, self._devices = model, devices

    @property
    def longest_shift_s(self) -> float:
        """Bound on how far the INS's stamp of an attitude may lie from a device's: configured offsets and 5 sigma."""
        longest_s = 0.0
        for device in self._devices.values():
            sigma_s = [self._model.blocks[name].sigma[0] for name, _ in device.ins_time_states]
            longest_s = max(longest_s, abs(device.ins_time_s) + 5.0 * float(np.linalg.norm(sigma_s)))
        return longest_s

    def ins_time_ns(self, mean: FloatArray, measurement: Measurement) -> int:
        """Stamp (ns) of the INS for the attitude that was measured, by a mean of the state, shape (n,)."""
        device = self._devices[measurement.source]
        shift_s = device.ins_time_s
        for name, sign in device.ins_time_states:
            shift_s += sign * mean[self._model.slices[name]][0]
        return measurement.time_ns + round(shift_s * SECOND_NS)

    def of(
        self,
        measurement: Measurement,
        mean: FloatArray,
        covariance: FloatArray,
        track: AttitudeTrack,
        watch: SkyWatch | None,
        may_wait: bool = False,
    ) -> Linearised | NotCompared | None:
        """The measurement linearised where it leads the predicted state.

        Args:
            measurement: of any kind.
            mean: of the predicted state, shape (n,).
            covariance: of the predicted state, shape (n, n).
            track: attitudes of the INS.
            watch: the sky; None where no sensor needs it.
            may_wait: whether samples of the INS may still come.

        Returns:
            None where samples of the INS that may still come belong to the measurement.
        """
        ins_time_ns = self.ins_time_ns(mean, measurement)
        if may_wait and not track.covers(ins_time_ns + measurement.reach_ns):
            return None
        paired = self._paired(measurement, track, ins_time_ns, watch)
        if isinstance(paired, Refusal):
            return NotCompared(paired, ins_time_ns)
        compared = self._settled(paired, mean, covariance, watch)
        if isinstance(compared, Refusal):
            return NotCompared(compared, ins_time_ns)
        return Linearised(paired.measurement, compared, paired.ins, ins_time_ns)

    def _paired(
        self, measurement: Measurement, track: AttitudeTrack, ins_time_ns: int, watch: SkyWatch | None
    ) -> "_Paired | Refusal":
        """What of a measurement is compared, with the attitude of the INS that belongs to it; or why it cannot be."""
        device, ins = self._devices[measurement.source], track.at(ins_time_ns)
        if ins is None:
            return Refusal(Reason.GAP, "no INS samples on both sides of it: it cannot be compared")
        if isinstance(measurement, InertialAttitude):
            assert watch is not None
            turned = in_horizon(measurement, watch)
            return turned if isinstance(turned, Refusal) else _Paired(turned, device, ins)
        if isinstance(measurement, StarExposure) and measurement.length is not None:
            turning = turning_over(track, ins_time_ns, measurement.length.nodes)
            if turning is None:
                text = f"no INS samples over its whole exposure of {measurement.length.exposure_s:g} s"
                return Refusal(Reason.GAP, text)
            # What is predicted is the mean over the exposure: its errors are those of the mean.
            ins = replace(ins, noise_gain=turning.noise_gain, error_covariance_d=turning.error_covariance)
            return _Paired(at_middle(measurement, turning.mounted(device.rotation_dv0)), device, ins)
        return _Paired(measurement, device, ins)

    def _settled(
        self, paired: "_Paired", mean: FloatArray, covariance: FloatArray, watch: SkyWatch | None
    ) -> Compared | Refusal:
        """The comparison at the point that it leads to, its residual relative to the predicted mean."""
        predicted = predict_attitude(paired.device, self._model, mean, paired.ins)
        first = self._compared(paired, predicted, mean, covariance, watch)
        if isinstance(first, Refusal):
            return first
        prior_v = predicted.jacobian_v @ covariance @ predicted.jacobian_v.T
        if _FAR * np.sqrt(np.trace(prior_v)) <= _LARGE_STEP:
            return first
        compared, rows, found = first, self._model.slices["ins.attitude"], np.zeros_like(mean)
        for _ in range(_STEPS - 1):
            correction = _correction(compared.linear, covariance)
            if correction is None or not np.linalg.norm(correction[rows] - found[rows]) > _LARGE_STEP:
                break
            predicted = predict_attitude(paired.device, self._model, mean + correction, paired.ins)
            there = self._compared(paired, predicted, mean + correction, covariance, watch)
            if isinstance(there, Refusal):
                break
            linear = replace(there.linear, residual=there.linear.residual + there.linear.jacobian @ correction)
            compared, found = replace(there, linear=linear, predicted_nv=first.predicted_nv), correction
        return compared

    def _compared(
        self,
        paired: "_Paired",
        predicted: PredictedAttitude,
        mean: FloatArray,
        covariance: FloatArray,
        watch: SkyWatch | None,
    ) -> Compared | Refusal:
        """A measurement against its prediction by a mean that may differ from the predicted one."""
        return compare(paired.measurement, paired.device, predicted, self._model, mean, covariance, watch)


@dataclass(frozen=True)
class _Paired:
    """A measurement as it is compared, its device, and the attitude of the INS that belongs to it."""

    measurement: Measurement
    device: Device
    ins: InterpolatedAttitude


def _correction(linear: LinearMeasurement, covariance: FloatArray) -> FloatArray | None:
    """Where a linearised measurement moves the mean, shape (n,); None where its covariance is singular."""
    cross = linear.jacobian @ covariance
    _, solution, failed = lapack.dposv(cross @ linear.jacobian.T + linear.noise, linear.residual)
    moved: FloatArray = cross.T @ solution
    return None if failed else moved
