"""Parameters of a drone with a light."""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters import parameter, section
from theodolite_calib.config.lever import LeverConfig


def _sigma_deg(default: float, doc: str) -> Any:
    return parameter(default, doc=doc, unit="deg", minimum=0.0, maximum=90.0)


@dataclass(frozen=True, kw_only=True)
class RtkConfig:
    """The baseline from the ship's antenna to the drone's."""

    frame_id: str = parameter("", doc="frame_id that beacon/<id>/baseline must carry; empty accepts any")
    base_id: str = parameter("", doc="base_id that it must carry; empty accepts any")
    rover_id: str = parameter("", doc="rover_id that it must carry; empty accepts any")
    sigma_m: float = parameter(
        0.02,
        doc="noise of each solution, each axis, where the message gives none",
        unit="m",
        minimum=1e-4,
        maximum=100.0,
        live=True,
    )
    bias_sigma_m: float = parameter(
        0.01, doc="slow error of its own, each axis, beside what the message says", unit="m", minimum=0.0, maximum=100.0
    )
    bias_time_s: float = parameter(300.0, doc="its correlation time", unit="s", minimum=0.0, maximum=1e7)
    max_gap_s: float = parameter(
        0.5, doc="solutions further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class DroneImuConfig:
    """What the drone says of its own attitude; used only where its light has a lever."""

    frame_id: str = parameter("", doc="frame_id that beacon/<id>/imu must carry; empty accepts any")
    convention: str = parameter(
        "enu_flu", doc="axes of its messages: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    tilt_sigma_deg: float = _sigma_deg(0.3, "slow error in tilt, each axis")
    heading_sigma_deg: float = _sigma_deg(1.0, "slow error in heading")
    time_s: float = parameter(300.0, doc="their correlation time", unit="s", minimum=0.0, maximum=1e7)
    max_gap_s: float = parameter(
        0.5, doc="samples further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class BeaconConfig:
    """One drone with its light."""

    light: LeverConfig = section(LeverConfig)
    rtk: RtkConfig = section(RtkConfig)
    imu: DroneImuConfig = section(DroneImuConfig)
