"""Parameters of a surveyed vector."""

from dataclasses import dataclass

import numpy as np

from ship_estimation.parameters import parameter
from ship_geometry.rotations import FloatArray

_LONGEST_M = 200.0
"""No ship has a longer one: more are millimetres, or another mistake."""


@dataclass(frozen=True, kw_only=True)
class LeverConfig:
    """A surveyed vector in the axes (forward, up, right) of the device that carries it."""

    forward_m: float = parameter(
        0.0, doc="component along forward (bow)", unit="m", minimum=-_LONGEST_M, maximum=_LONGEST_M
    )
    up_m: float = parameter(0.0, doc="component along up", unit="m", minimum=-_LONGEST_M, maximum=_LONGEST_M)
    right_m: float = parameter(
        0.0, doc="component along right (starboard)", unit="m", minimum=-_LONGEST_M, maximum=_LONGEST_M
    )
    sigma_m: float = parameter(
        0.0, doc="error of the survey, each axis; 0 for none", unit="m", minimum=0.0, maximum=10.0
    )

    @property
    def vector_m(self) -> FloatArray:
        """The vector, shape (3,)."""
        return np.array([self.forward_m, self.up_m, self.right_m])
