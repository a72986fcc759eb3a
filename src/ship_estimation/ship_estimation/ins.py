"""What more than one estimator knows of an INS: its parameters, and a jump of its attitude that is believed."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ship_estimation.parameter_fields import accept_unset_covariance, arcsec, degrees, parameter
from ship_estimation.value_guards import JUMP_SAMPLES, size
from ship_geometry.attitude_track import ExtraNoise
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray

_CLOCK_SIGMAS, _CLOCK_SHARE = 3.0, 0.1
"""What a step of the clock leaves of a jump is at most so many sigmas, and this share of the jump."""
_CLEAR_SIGMAS = 15.0
"""A jump of so many sigmas lies along the ship's turn, to a few tenths of it, only where a clock makes it."""


@dataclass(frozen=True, kw_only=True)
class InsInputConfig:
    """What must be known of an INS to use its attitudes: axes, size of the errors, clock."""

    convention: str = parameter(
        "enu_flu", doc="axes of ins/imu: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that ins/imu must carry; empty accepts any")
    accept_unset_covariance: bool = accept_unset_covariance()
    installation_heading_deg: float = degrees(0.0, doc="azimuth of the INS's forward axis in the deck")
    installation_pitch_deg: float = degrees(0.0, doc="elevation of the INS's forward axis in the deck")
    installation_roll_deg: float = degrees(0.0, doc="roll of the INS in the deck, right side down")
    tilt_sigma_arcsec: float = arcsec(10.0, doc="slow error in tilt, each axis", live=True)
    heading_sigma_arcsec: float = arcsec(72.0, doc="slow error in heading", live=True)
    white_sigma_arcsec: float = arcsec(1.0, doc="noise of each sample, each axis, quantisation included", live=True)
    time_offset_s: float = parameter(
        0.0, doc="a sample is valid at its stamp plus this", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(
        0.005, doc="uncertainty of time_offset_s; 0 holds it fixed", unit="s", minimum=0.0, maximum=1.0
    )
    max_gap_s: float = parameter(
        0.5, doc="samples further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )

    @cached_property
    def rotation_di(self) -> FloatArray:
        """Deck from INS by the installation angles, shape (3, 3)."""
        angles_deg = self.installation_heading_deg, self.installation_pitch_deg, self.installation_roll_deg
        return rotation_from_angles(*np.deg2rad(angles_deg))


@dataclass(frozen=True, kw_only=True)
class GuardedInsConfig(InsInputConfig):
    """The parameters of an INS whose attitudes are watched for jumps."""

    jump_samples: int = parameter(
        JUMP_SAMPLES,
        doc="samples refused for a jump of the attitude that agree among themselves; the next is believed",
        minimum=1,
        maximum=1000,
        live=True,
    )
    rate_sigma_arcsec_per_s: float = parameter(
        0.0,
        doc="noise of the angular rate, each axis, 0 where it is not known; what is met is learnt where it is larger",
        unit="arcsec/s",
        minimum=0.0,
        maximum=36_000.0,
        live=True,
    )
    rate_has_earth_rate: bool = parameter(
        False, doc="the angular rate is the gyroscopes' own: the Earth's turn, 15 arcsec/s, has not been taken out"
    )


@dataclass(frozen=True, kw_only=True)
class StarInsConfig(GuardedInsConfig):
    """The parameters of an INS beside stars: it tells how the ship turned during their exposures."""

    untold_acceleration_deg_per_s2: float = parameter(
        2.0,
        doc="angular acceleration of the deck, each axis, taken for an exposure during which the INS tells none",
        unit="deg/s2",
        minimum=0.0,
        maximum=100.0,
        live=True,
    )


@dataclass(frozen=True, kw_only=True)
class InsErrorConfig(InsInputConfig):
    """The parameters of an INS whose slow errors are estimated: how long these last besides."""

    tilt_time_s: float = parameter(
        1800.0, doc="correlation time of the tilt error", unit="s", minimum=1.0, maximum=1e7
    )
    heading_time_s: float = parameter(
        10800.0, doc="correlation time of the heading error", unit="s", minimum=1.0, maximum=1e7
    )


@dataclass(frozen=True)
class InsJump:
    """An attitude of the INS that has jumped for good.

    Attributes:
        time_ns: just before the first sample after the jump.
        jump_n: the jump, rotation vector in the horizon frame, rad, shape (3,).
        sigma_rad: standard deviation of the jump about each axis.
        clock_s: step of the INS's clock that would explain the jump, s; NaN where none would.
        creeps: whether the attitude did not jump but crept so far, and may creep on.

    >>> jump = InsJump(time_ns=0, jump_n=np.array([0.0, 0.1, 0.0]), sigma_rad=0.001)
    >>> [round(float(sigma), 3) for sigma in np.sqrt(np.diagonal(jump.covariance_n))]
    [0.005, 0.1, 0.005]
    """

    time_ns: int
    jump_n: FloatArray
    sigma_rad: float
    clock_s: float = math.nan
    creeps: bool = False

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance of what the INS's slow error may have become by the jump, rad², shape (3, 3).

        Along the jump it is the square of the jump. About every axis it is the jump's own variance and, because two
        large turns do not commute, the square of half the squared jump.
        """
        covariance_n: FloatArray = np.outer(self.jump_n, self.jump_n) + self._across_rad**2 * np.eye(3)
        return covariance_n

    @property
    def shared(self) -> tuple[FloatArray, FloatArray]:
        """Half of the jump laid to the attitude and half to the clock, and how surely.

        Which of the two has jumped nothing tells as long as the ship turns as she does. It may be the one or the other
        alone: both are one sigma away from the half, and what the one has more the other has less.

        Returns:
            By how much the slow error and the offset of the clock have changed, rad and s, shape (4,); its covariance,
            shape (4, 4).
        """
        half, jump_rad = 0.5 * np.append(self.jump_n, self.clock_s), size(self.jump_n)
        covariance = np.outer(half, half)
        covariance[:3, :3] += self._across_rad**2 * np.eye(3)
        covariance[3, 3] += (self.clock_s * math.hypot(_CLOCK_SHARE, self.sigma_rad / jump_rad)) ** 2
        return half * [-1.0, -1.0, -1.0, 1.0], covariance

    @property
    def is_of_clock(self) -> bool:
        """Whether it was the clock that jumped: the jump is large beside its sigma, and a step explains it."""
        clear = size(self.jump_n) >= _CLEAR_SIGMAS * self.sigma_rad
        return clear and not math.isnan(self.clock_s)

    @property
    def _across_rad(self) -> float:
        return math.hypot(self.sigma_rad, 0.5 * float(self.jump_n @ self.jump_n))


InsChange = InsJump | ExtraNoise
"""What makes the error of an INS uncertain: its attitude has jumped, or the noise of its samples has changed."""


def clock_step_s(jump_n: FloatArray, sigma_rad: float, rate_n: FloatArray) -> float:
    """Step of a clock that explains a jump: the ship has turned no further than she does in that time; NaN where none.

    Args:
        jump_n: rotation vector, rad, shape (3,).
        sigma_rad: its standard deviation about each axis.
        rate_n: angular velocity at the jump in the same frame, rad/s, shape (3,).

    Example:
        A ship that rolls at 0.1 rad/s jumps by 2 mrad in roll, and in heading:

        >>> roll_n, heading_n = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.1, 0.0])
        >>> [round(clock_step_s(0.02 * turned_n, 1e-5, roll_n), 4) for turned_n in (roll_n, heading_n)]
        [0.02, nan]
    """
    square = float(rate_n @ rate_n)
    if not square > 0.0:
        return math.nan
    step_s = float(jump_n @ rate_n) / square
    # The rate changes in that time.
    explained = size(jump_n - step_s * rate_n) <= _CLOCK_SIGMAS * sigma_rad + _CLOCK_SHARE * size(jump_n)
    return step_s if explained else math.nan
