"""A baseline between two antennas aboard: a direction on the ship, measured relative to the horizon by RTK."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

BASELINE = "baseline"
"""Source name of the baseline."""

BASELINE_COMPONENTS = ("baseline up", "baseline right")
"""Components of its residual: direction of the rover antenna, across the baseline, rad."""


@dataclass(frozen=True)
class BaselineMeasurement:
    """One RTK solution for the vector from the base antenna to the rover antenna, both aboard.

    Attributes:
        time_ns: stamp.
        vector_n: vector (North, Up, East), m, shape (3,).
        noise_n: covariance of the noise, independent between solutions, m², shape (3, 3).
        covariance_known: False if the message contained none and the configured sigma is used.
    """

    time_ns: int
    vector_n: FloatArray
    noise_n: FloatArray
    covariance_known: bool = True
    source = BASELINE
    reach_ns = 0  # a baseline is valid at its stamp

    def content(self) -> bytes:
        """Return all values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.vector_n.tobytes() + self.noise_n.tobytes()

    @property
    def direction_n(self) -> FloatArray:
        """Unit vector from the base to the rover, (North, Up, East), shape (3,)."""
        direction_n: FloatArray = self.vector_n / self.length_m
        return direction_n

    @property
    def length_m(self) -> float:
        """Measured length, m."""
        return float(np.linalg.norm(self.vector_n))
