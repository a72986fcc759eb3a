"""Measured baseline between two antennas aboard: a direction of the ship in the horizon, measured by RTK."""

import math
from dataclasses import dataclass

import numpy as np

from ship_attitude_star.ship_attitude.measurements.kind import (
    SOURCE_INTERPOLATION,
    ComparedMeasurement,
    Device,
    LinearisationPoint,
)
from ship_estimation.kalman.kalman_filter import LinearMeasurement
from ship_estimation.plausibility.value_checks import StuckValue, largest_sigma
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.rotations import FloatArray, exp_rotation

BASELINE = "baseline"
"""Source name of the baseline."""

BASELINE_COMPONENTS = ("baseline up", "baseline right")
"""Components of the residual of a baseline: measured minus predicted direction, in the up and right axes, rad."""

_UP_RIGHT_BY_ROTATION = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Jacobian of the forward axis's direction (up, right) with respect to a rotation of the device (forward, up, right).
"""
_UP_RIGHT_BY_ROTATION.flags.writeable = False

_LENGTH_SIGMAS = 5.0
"""Maximum error of a baseline length, in standard deviations."""


@dataclass(frozen=True)
class BaselineMeasurement:
    """One RTK solution for the vector from the base antenna to the rover antenna, both aboard.

    Attributes:
        time_ns: stamp of the solution.
        vector_n: vector (North, Up, East), m, shape (3,).
        noise_n: noise covariance, m², shape (3, 3); the noise of different solutions is independent.
        covariance_known: False if the message has no covariance, so that the configured sigma is used.
    """

    time_ns: int
    vector_n: FloatArray
    noise_n: FloatArray
    covariance_known: bool = True
    source = BASELINE
    reach_ns = 0  # a baseline is valid at its stamp

    def content(self) -> bytes:
        """Return all values as bytes, to recognise a repeated message and to sort conflicting messages."""
        return self.vector_n.tobytes() + self.noise_n.tobytes()

    @property
    def stuck_value(self) -> StuckValue:
        """Value that must not stay constant while the ship rotates."""
        return self.direction_n, largest_sigma(self.noise_n) / self.length_m, "baseline is constant"

    @property
    def direction_n(self) -> FloatArray:
        """Unit vector from the base antenna to the rover antenna, (North, Up, East), shape (3,)."""
        direction_n: FloatArray = self.vector_n / self.length_m
        return direction_n

    @property
    def length_m(self) -> float:
        """Measured length of the baseline, m."""
        return float(np.linalg.norm(self.vector_n))


@dataclass(frozen=True, kw_only=True)
class BaselineDevice(Device):
    """The baseline as a device with a forward axis along the baseline.

    Attributes:
        length_m: configured length, m.
        length_sigma_m: standard deviation of the correlated error of a measured length, m.
    """

    angles = (("azimuth", 0), ("elevation", 1))

    length_m: float
    length_sigma_m: float

    def linearise(self, measurement: BaselineMeasurement, at: LinearisationPoint) -> ComparedMeasurement | Rejection:
        """See :class:`Device`; the residual is measured minus predicted direction, up and right in the baseline frame.

        The residual has two components, rad, as for a single star.
        """
        measured_m, noise_n, direction_n = measurement.length_m, measurement.noise_n, measurement.direction_n
        sigma_m = math.sqrt(float(direction_n @ noise_n @ direction_n) + self.length_sigma_m**2)
        # NaN is rejected.
        if not abs(measured_m - self.length_m) <= _LENGTH_SIGMAS * sigma_m:
            text = f"baseline length {measured_m:.3f} m, expected {self.length_m:.3f} m (sigma {sigma_m:.3f} m)"
            return Rejection(Reason.GATE, f"{text}: wrong RTK solution, or wrong parameters of ship_baseline")
        to_device = at.predicted.rotation_nv.T
        direction_v = to_device @ direction_n
        if not direction_v[0] > 0.0:
            text = "the baseline points in the opposite direction: are base and rover exchanged?"
            return Rejection(Reason.GATE, text)
        noise_v = to_device @ noise_n @ to_device.T / self.length_m**2
        rotation_v = np.array([0.0, -direction_v[2], direction_v[1]]) / direction_v[0]
        index, interpolation_v = at.model.source_indices, at.predicted.interpolation_v
        noise_by_source = {
            index[self.noise_sources[0]]: noise_v[1:, 1:],
            index[SOURCE_INTERPOLATION]: _UP_RIGHT_BY_ROTATION @ interpolation_v @ _UP_RIGHT_BY_ROTATION.T,
        }
        return ComparedMeasurement(
            linear=LinearMeasurement(
                _UP_RIGHT_BY_ROTATION @ rotation_v, _UP_RIGHT_BY_ROTATION @ at.predicted.jacobian_v, noise_by_source
            ),
            rotation_jacobian=_UP_RIGHT_BY_ROTATION,
            components=BASELINE_COMPONENTS,
            rotation_nv=at.predicted.rotation_nv @ exp_rotation(rotation_v),
            predicted_nv=at.predicted.rotation_nv,
        )

    def information(self, measurement: BaselineMeasurement) -> FloatArray:
        """See :class:`Device`."""
        variance = float(np.trace(measurement.noise_n)) / 3.0 / measurement.length_m**2
        return np.diag([0.0, 1.0, 1.0]) / variance
