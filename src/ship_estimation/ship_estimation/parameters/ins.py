"""INS parameters that several estimators share."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ship_estimation.parameters.fields import accept_unset_covariance, degrees, parameter
from ship_estimation.parameters.ins_errors import InsErrors, InsRateErrors
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray

JUMP_SAMPLES = 5
"""Default number of rejected, mutually consistent values after which a jump is accepted."""


@dataclass(frozen=True, kw_only=True)
class InsInputConfig(InsErrors):
    """Parameters required to use the attitudes of an INS: axes, standard deviations, clock."""

    convention: str = parameter(
        "enu_flu", doc="axes of ins/imu: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that ins/imu must carry; empty accepts any")
    accept_unset_covariance: bool = accept_unset_covariance()
    installation_heading_deg: float = degrees(0.0, doc="azimuth of the INS's forward axis in the deck")
    installation_pitch_deg: float = degrees(0.0, doc="elevation of the INS's forward axis in the deck")
    installation_roll_deg: float = degrees(0.0, doc="roll of the INS in the deck, right side down")
    max_gap_s: float = parameter(
        0.5, doc="samples further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )

    @cached_property
    def rotation_di(self) -> FloatArray:
        """Rotation "deck from INS" by the installation angles, shape (3, 3)."""
        angles_deg = self.installation_heading_deg, self.installation_pitch_deg, self.installation_roll_deg
        return rotation_from_angles(*np.deg2rad(angles_deg))


@dataclass(frozen=True, kw_only=True)
class CheckedInsConfig(InsRateErrors, InsInputConfig):
    """Parameters of an INS whose attitudes are checked for jumps."""

    jump_samples: int = parameter(
        JUMP_SAMPLES,
        doc="rejected, mutually consistent samples after which a jump of the attitude is accepted",
        minimum=1,
        maximum=1000,
        live=True,
    )


@dataclass(frozen=True, kw_only=True)
class StarInsConfig(CheckedInsConfig):
    """Parameters of an INS that measures the ship's rotation during star exposures."""

    untold_acceleration_deg_per_s2: float = parameter(
        2.0,
        doc="angular acceleration of the deck, each axis, assumed for an exposure without INS data",
        unit="deg/s2",
        minimum=0.0,
        maximum=100.0,
        live=True,
    )
