"""What more than one estimator knows of an INS: its parameters, and a jump of its attitude that is believed."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ship_estimation.parameter_fields import arcsec, degrees, parameter
from ship_estimation.value_guards import JUMP_SAMPLES
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray


@dataclass(frozen=True, kw_only=True)
class InsInputConfig:
    """What must be known of an INS to use its attitudes: axes, size of the errors, clock."""

    convention: str = parameter(
        "enu_flu", doc="axes of ins/imu: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that ins/imu must carry; empty accepts any")
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
        doc="noise of the angular rate, each axis; what is met is learnt where it is larger",
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
        large turns do not commute, the square of half the squared jump.
        """
        across_rad = math.hypot(self.sigma_rad, 0.5 * float(self.jump_n @ self.jump_n))
        covariance_n: FloatArray = np.outer(self.jump_n, self.jump_n) + across_rad**2 * np.eye(3)
        return covariance_n
