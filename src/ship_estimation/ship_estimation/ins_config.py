"""Parameters of the INS that more than one node has."""

from dataclasses import dataclass

from ship_estimation.parameters import arcsec, degrees, parameter
from ship_estimation.value_guards import JUMP_SAMPLES


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


@dataclass(frozen=True, kw_only=True)
class GuardedInsConfig(InsInputConfig):
    """The same of an INS whose attitudes are watched for jumps."""

    jump_samples: int = parameter(
        JUMP_SAMPLES,
        doc="samples refused for a jump of the attitude that agree among themselves; the next is believed",
        minimum=1,
        maximum=1000,
        live=True,
    )


@dataclass(frozen=True, kw_only=True)
class StarInsConfig(GuardedInsConfig):
    """The same of an INS beside stars: it tells how their exposures turned."""

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
    """The same, and how long its slow errors last."""

    tilt_time_s: float = parameter(
        1800.0, doc="correlation time of the tilt error", unit="s", minimum=1.0, maximum=1e7
    )
    heading_time_s: float = parameter(
        10800.0, doc="correlation time of the heading error", unit="s", minimum=1.0, maximum=1e7
    )
