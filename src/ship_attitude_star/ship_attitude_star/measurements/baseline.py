"""A baseline between two antennas aboard: a direction on the ship that satellite positioning sees in the horizon."""

from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray

BASELINE = "baseline"
"""Name of the source."""

BASELINE_COMPONENTS = ("baseline up", "baseline right")
"""Of its residual: where the rover antenna is seen, across the baseline, rad."""


@dataclass(frozen=True)
class BaselineMeasurement:
    """One solution for the way from the base antenna to the rover antenna, both aboard.

    Attributes:
        time_ns: stamp.
        vector_n: (North, Up, East), m, shape (3,).
        noise_n: covariance of what is new in each solution, m², shape (3, 3).
        covariance_known: False where the message gave none and the configured sigma stands in.
    """

    time_ns: int
    vector_n: FloatArray
    noise_n: FloatArray
    covariance_known: bool = True
    source = BASELINE
    reach_ns = 0  # a baseline is that of its moment

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        return self.vector_n.tobytes() + self.noise_n.tobytes()

    @property
    def direction_n(self) -> FloatArray:
        """Unit vector from the base to the rover, (North, Up, East), shape (3,)."""
        direction_n: FloatArray = self.vector_n / self.length_m
        return direction_n

    @property
    def length_m(self) -> float:
        """How long it came out."""
        return float(np.linalg.norm(self.vector_n))
