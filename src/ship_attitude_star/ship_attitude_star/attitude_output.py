"""From the filter's state and one INS sample to the published attitude and its covariance by source."""

import numpy as np

from ship_attitude_star.filter_model import SOURCE_INS_NOISE, Device
from ship_attitude_star.samples import AttitudeMeasurement
from ship_attitude_star.ship_filter import FilterState
from ship_estimation.state import StateModel
from ship_geometry.attitude_track import InterpolatedAttitude
from ship_geometry.rotations import FloatArray, exp_rotation, left_jacobian


class CorrectedIns:
    """INS attitudes corrected by one filter state; made once per state, used at the INS's rate.

    Only the INS's slow error and its time offset enter, so only those rows of the covariance are carried.

    Args:
        model: the state vector.
        state: the filter's state after its last measurement.
    """

    def __init__(self, model: StateModel, state: FilterState) -> None:
        rows = np.r_[model.slices["ins.attitude"], model.slices["ins.time_offset"]]
        self._model = model
        self._rows = rows
        self._time_ns = state.time_ns
        self._mean = state.mean[rows]
        self._parts = state.parts[:, rows[:, None], rows]
        self._white_index = model.sources.index(SOURCE_INS_NOISE)
        self._white_variance = model.blocks["ins.noise"].sigma ** 2

    @property
    def time_offset_s(self) -> float:
        """Estimated tau, on top of the configured constant, s."""
        return float(self._mean[3])

    def attitude(self, time_ns: int, ins: InterpolatedAttitude) -> tuple[FloatArray, FloatArray]:
        """Attitude and its covariance parts, horizon frame, rad², shapes (3, 3), (n_sources, 3, 3).

        Args:
            time_ns: the moment.
            ins: the INS's attitude of that moment (its samples moved by tau).
        """
        dt_s = max(time_ns - self._time_ns, 0) * 1e-9 if self._time_ns is not None else 0.0
        decay, noise = self._model.transition(dt_s)
        error = decay[self._rows[:3]] * self._mean[:3]
        correction = exp_rotation(error)
        rotation_nd = correction @ ins.rotation_nd

        # Errors now, from errors at the state's moment.
        jacobian = np.empty((3, 4))
        jacobian[:, :3] = left_jacobian(error)
        jacobian[:, 3] = -(rotation_nd @ ins.rate_d)
        propagated = jacobian * np.append(decay[self._rows[:3]], 1.0)
        parts = propagated @ self._parts @ propagated.T
        drift = jacobian[:, :3] * np.sqrt(noise[self._rows[:3]])
        parts[self._model.sources.index(self._model.blocks["ins.attitude"].source)] += drift @ drift.T
        white = correction * np.sqrt(self._white_variance * ins.noise_gain)
        parts[self._white_index] += white @ white.T
        return rotation_nd, parts


def attitude_by_device(
    device: Device, model: StateModel, state: FilterState, measurement: AttitudeMeasurement
) -> tuple[FloatArray, FloatArray]:
    """The ship's attitude by one device alone, for when the INS is gone: its measurement, its installation.

    Returns:
        Attitude (3, 3) and covariance parts (n_sources, 3, 3), horizon frame, rad².
    """
    rows = model.slices[f"{device.name}.installation"]
    vector = state.mean[rows]
    rotation_nd = measurement.rotation_nv @ (device.rotation_dv0 @ exp_rotation(vector)).T
    to_horizon = measurement.rotation_nv
    installation = to_horizon @ left_jacobian(vector).T
    parts = installation @ state.parts[:, rows, rows] @ installation.T
    parts[model.sources.index(device.noise_source)] += to_horizon @ measurement.noise_v @ to_horizon.T
    common = model.blocks[f"{device.name}.common"].source
    parts[model.sources.index(common)] += measurement.common_n
    return rotation_nd, parts
