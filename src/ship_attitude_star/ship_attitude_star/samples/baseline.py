"""Measurement of the baseline between two antennas aboard: a direction of the ship in the horizon, measured by RTK."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

BASELINE = "baseline"
"""Source name of the baseline."""

BASELINE_COMPONENTS = ("baseline up", "baseline right")
"""Components of the residual of a baseline: measured minus predicted direction, in the up and right axes, rad."""


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
    def direction_n(self) -> FloatArray:
        """Unit vector from the base antenna to the rover antenna, (North, Up, East), shape (3,)."""
        direction_n: FloatArray = self.vector_n / self.length_m
        return direction_n

    @property
    def length_m(self) -> float:
        """Measured length of the baseline, m."""
        return float(np.linalg.norm(self.vector_n))
