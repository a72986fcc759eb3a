"""A jump of the INS's attitude that is believed, as the filters apply it: at its own time, among the measurements."""

import math
from dataclasses import dataclass

import numpy as np

from ship_geometry.rotations import FloatArray


@dataclass(frozen=True)
class InsJump:
    """An attitude of the INS that has jumped for good.

    Attributes:
        time_ns: just before the first sample after the jump.
        jump_n: the jump, rotation vector in the horizon frame, rad, shape (3,).
        sigma_rad: standard deviation of the jump about each axis.

    >>> jump = InsJump(time_ns=0, jump_n=np.array([0.0, 0.1, 0.0]), sigma_rad=0.001)
    >>> [round(float(sigma), 3) for sigma in np.sqrt(np.diagonal(jump.covariance_n))]
    [0.005, 0.1, 0.005]
    """

    time_ns: int
    jump_n: FloatArray
    sigma_rad: float

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance of what the INS's slow error may have become by the jump, rad², shape (3, 3).

        Along the jump it is the square of the jump. About every axis it is the jump's own variance and, because two
        large turns do not commute, half the squared jump.
        """
        across_rad = math.hypot(self.sigma_rad, 0.5 * float(self.jump_n @ self.jump_n))
        covariance_n: FloatArray = np.outer(self.jump_n, self.jump_n) + across_rad**2 * np.eye(3)
        return covariance_n
