"""Parameters of the ``ship_attitude`` node. Each states its unit, range and meaning; names are dotted."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters import mapping_of, parameter, section


def _degrees(default: Any = dataclasses.MISSING, *, doc: str) -> Any:
    """An angle of the geometry; without a default it must be given."""
    return parameter(default, doc=doc, unit="deg", minimum=-360.0, maximum=360.0)


def _arcsec(default: float, *, doc: str, live: bool = False) -> Any:
    """A standard deviation."""
    return parameter(default, doc=doc, unit="arcsec", minimum=0.0, maximum=360_000.0, live=live)


@dataclass(frozen=True, kw_only=True)
class InsConfig:
    """The inertial navigation system: its axes, its slow errors, its clock."""

    convention: str = parameter(
        "enu_flu", doc="axes of ins/imu: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that ins/imu must carry; empty accepts any")
    installation_heading_deg: float = _degrees(0.0, doc="azimuth of the INS's forward axis in the deck")
    installation_pitch_deg: float = _degrees(0.0, doc="elevation of the INS's forward axis in the deck")
    installation_roll_deg: float = _degrees(0.0, doc="roll of the INS in the deck, right side down")
    tilt_sigma_arcsec: float = _arcsec(10.0, doc="slow error in tilt, each axis", live=True)
    tilt_time_s: float = parameter(
        1800.0, doc="correlation time of the tilt error", unit="s", minimum=1.0, maximum=1e7
    )
    heading_sigma_arcsec: float = _arcsec(72.0, doc="slow error in heading", live=True)
    heading_time_s: float = parameter(
        10800.0, doc="correlation time of the heading error", unit="s", minimum=1.0, maximum=1e7
    )
    white_sigma_arcsec: float = _arcsec(1.0, doc="noise of each sample, each axis, quantisation included", live=True)
    time_offset_s: float = parameter(
        0.0, doc="a sample is valid at its stamp plus this", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(
        0.005, doc="uncertainty of time_offset_s; 0 holds it fixed", unit="s", minimum=0.0, maximum=1.0
    )
    silence_s: float = parameter(
        1.0, doc="without samples for this long the INS counts as gone", unit="s", minimum=0.05, maximum=60.0
    )
    max_gap_s: float = parameter(
        0.5, doc="samples further apart are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )


@dataclass(frozen=True, kw_only=True)
class StarSensorConfig:
    """One star sensor: where it is bolted, how well that is known, how good it is."""

    input: str = parameter(
        "horizon_attitude",
        doc="topic under star/<id>/ that feeds the filter",
        choices=("horizon_attitude", "solution"),
    )
    frame_id: str = parameter("", doc="frame_id that its messages must carry; empty accepts any")
    serial: str = parameter("", doc="serial number; a saved alignment of another one becomes a wider prior")
    azimuth_deg: float = _degrees(doc="installation azimuth of the boresight in the deck")
    elevation_deg: float = parameter(
        doc="installation elevation of the boresight over the deck", unit="deg", minimum=-90.0, maximum=90.0
    )
    roll_deg: float = _degrees(0.0, doc="installation roll about the boresight, right side down")
    installation_sigma_forward_arcsec: float = _arcsec(20.0, doc="installation error about the boresight")
    installation_sigma_up_arcsec: float = _arcsec(1.0, doc="installation error about the up axis")
    installation_sigma_right_arcsec: float = _arcsec(1.0, doc="installation error about the right axis")
    installation_walk_forward_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the installation about the boresight", unit="arcsec/sqrt(h)", minimum=0.0
    )
    installation_walk_up_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the installation about the up axis", unit="arcsec/sqrt(h)", minimum=0.0
    )
    installation_walk_right_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the installation about the right axis", unit="arcsec/sqrt(h)", minimum=0.0
    )
    sigma_forward_arcsec: float = _arcsec(
        100.0, doc="noise about the boresight where the message gives none", live=True
    )
    sigma_up_arcsec: float = _arcsec(
        3.0, doc="noise about the up axis where the message gives none", live=True
    )
    sigma_right_arcsec: float = _arcsec(
        3.0, doc="noise about the right axis where the message gives none", live=True
    )
    common_time_s: float = parameter(
        3600.0,
        doc="correlation time of what a message's stars share (covariance minus noise_covariance)",
        unit="s",
        minimum=1.0,
        maximum=1e7,
    )
    time_offset_s: float = parameter(
        0.0, doc="a message is valid at its stamp plus this", unit="s", minimum=-1.0, maximum=1.0
    )
    time_offset_sigma_s: float = parameter(
        0.0, doc="uncertainty of time_offset_s; 0 holds it fixed", unit="s", minimum=0.0, maximum=1.0
    )
    flexure_sigma_arcsec: float = _arcsec(
        0.0, doc="hull flexure between INS and sensor, each axis; 0 leaves it out"
    )
    flexure_time_s: float = parameter(
        10.0, doc="correlation time of the flexure", unit="s", minimum=0.1, maximum=1e7
    )


@dataclass(frozen=True, kw_only=True)
class ReferenceConfig:
    """Another attitude system: its turn against the INS, its noise, its clock against the INS's."""

    convention: str = parameter(
        "enu_flu", doc="axes of its messages: ENU <- FLU (REP-103) or NED <- FRD", choices=("enu_flu", "ned_frd")
    )
    frame_id: str = parameter("", doc="frame_id that its messages must carry; empty accepts any")
    heading_deg: float = _degrees(0.0, doc="heading of the reference minus heading of the INS")
    pitch_deg: float = _degrees(0.0, doc="pitch of the reference minus pitch of the INS")
    roll_deg: float = _degrees(0.0, doc="roll of the reference minus roll of the INS")
    installation_sigma_arcsec: float = _arcsec(7200.0, doc="uncertainty of the three angles")
    installation_walk_arcsec_per_sqrt_h: float = parameter(
        0.0, doc="random walk of the three angles", unit="arcsec/sqrt(h)", minimum=0.0
    )
    sigma_roll_arcsec: float = _arcsec(
        60.0, doc="noise in roll where the message gives none", live=True
    )
    sigma_pitch_arcsec: float = _arcsec(
        60.0, doc="noise in pitch where the message gives none", live=True
    )
    sigma_heading_arcsec: float = _arcsec(
        60.0, doc="noise in heading where the message gives none", live=True
    )
    slow_sigma_roll_arcsec: float = _arcsec(0.0, doc="slow error of its own in roll")
    slow_sigma_pitch_arcsec: float = _arcsec(0.0, doc="slow error of its own in pitch")
    slow_sigma_heading_arcsec: float = _arcsec(
        0.0, doc="slow error of its own in heading; 0 for all three leaves it out"
    )
    slow_time_s: float = parameter(
        300.0, doc="correlation time of its slow error", unit="s", minimum=0.1, maximum=1e7
    )
    time_offset_s: float = parameter(
        0.0,
        doc="stamp of the reference minus stamp of the INS for the same attitude",
        unit="s",
        minimum=-10.0,
        maximum=10.0,
    )
    time_offset_sigma_s: float = parameter(
        0.2, doc="uncertainty of time_offset_s; 0 holds it fixed", unit="s", minimum=0.0, maximum=10.0
    )


@dataclass(frozen=True, kw_only=True)
class GateConfig:
    """When a measurement is too improbable to use, and what a run of such means."""

    probability: float = parameter(
        0.9999, doc="a consistent measurement passes with this probability", minimum=0.5, maximum=0.999999999, live=True
    )
    conflict_after: int = parameter(
        10, doc="refusals in a row of one source that are reported as a conflict", minimum=1, live=True
    )
    reopen_after: int = parameter(
        0, doc="refusals in a row that inflate the covariance to let the source back in; 0 never", minimum=0, live=True
    )
    reopen_factor: float = parameter(
        100.0, doc="factor on the covariance when a gate is re-opened", minimum=1.0, maximum=1e9, live=True
    )


@dataclass(frozen=True, kw_only=True)
class ShipAttitudeConfig:
    """All parameters of ``ship_attitude``."""

    ins: InsConfig = section(InsConfig)
    star_sensors: dict[str, StarSensorConfig] = mapping_of("star sensors by id")
    references: dict[str, ReferenceConfig] = mapping_of("other attitude systems by name")
    gate: GateConfig = section(GateConfig)
    lag_s: float = parameter(
        2.0, doc="measurements up to this late are applied at their own time", unit="s", minimum=0.0, maximum=600.0
    )
    coasting_after_s: float = parameter(
        2.0, doc="without stars for this long the status is COASTING", unit="s", minimum=0.1, maximum=3600.0, live=True
    )
    slow_topics_period_s: float = parameter(
        1.0, doc="period of budget, alignment, error and health topics", unit="s", minimum=0.1, maximum=60.0
    )
    alignment_file: str = parameter("", doc="file of the saved alignment, read at the start where it exists")
    alignment_max_age_d: float = parameter(
        30.0, doc="an alignment older than this is a wider prior", unit="d", minimum=0.0, maximum=36500.0
    )
