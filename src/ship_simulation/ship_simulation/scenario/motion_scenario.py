"""Parameters of the ship's motion in a scenario file, and units and ranges that all parts of a scenario share."""

from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters.fields import mapping_of, parameter, section
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S

ANGLE: dict[str, Any] = {"unit": "deg", "minimum": -360.0, "maximum": 360.0}
SIGMA: dict[str, Any] = {"unit": "arcsec", "minimum": 0.0, "maximum": 360_000.0}
MIN_CORRELATION_S = 0.1
CORRELATION: dict[str, Any] = {"unit": "s", "minimum": MIN_CORRELATION_S, "maximum": 1e7}
DEFLECTION: dict[str, Any] = {"unit": "arcsec", "minimum": -300.0, "maximum": 300.0}
RATE: dict[str, Any] = {"unit": "Hz", "minimum": 0.01, "maximum": 1000.0}
TIME: dict[str, Any] = {"unit": "s", "minimum": 0.0, "maximum": 1e6}
DELAY: dict[str, Any] = {"unit": "s", "minimum": 0.0, "maximum": 60.0}

EXPOSURE: dict[str, Any] = {"unit": "s", "minimum": 0.0, "maximum": LONGEST_EXPOSURE_S}

_GAIN: dict[str, Any] = {"doc": "angle per slope of a long wave", "minimum": 0.0, "maximum": 10.0}
_PERIOD: dict[str, Any] = {"doc": "natural period", "unit": "s", "minimum": 0.5, "maximum": 100.0}
_DAMPING: dict[str, Any] = {"doc": "damping ratio", "minimum": 0.01, "maximum": 5.0}
_LENGTH: dict[str, Any] = {"doc": "hull length that averages the slope", "unit": "m", "minimum": 0.0, "maximum": 500.0}

SECTIONS_OF_KIND = {
    "sinusoids": ("heading", "pitch", "roll", "turn"),
    "sea_state": ("heading", "pitch", "roll", "turn", "sea"),
    "recorded": ("recording",),
}
"""Kind of carrier → parameter groups that it uses."""


@dataclass(frozen=True)
class Outage:
    """A time span in seconds after the start, such as an outage or a time in which a light is hidden."""

    start_s: float = parameter(doc="begin, after the start", **TIME)
    end_s: float = parameter(doc="end, after the start", **TIME)


@dataclass(frozen=True)
class Wave:
    """One sinusoid of an angle: amplitude * sin(2 pi t / period + phase)."""

    amplitude_deg: float = parameter(doc="amplitude", unit="deg", minimum=0.0, maximum=90.0)
    period_s: float = parameter(doc="period", unit="s", minimum=0.1, maximum=1e6)
    phase_rad: float = parameter(0.0, doc="phase at the start", unit="rad", minimum=-10.0, maximum=10.0)


@dataclass(frozen=True)
class AngleMotion:
    """One angle of the ship: its mean and its sinusoids."""

    mean_deg: float = parameter(0.0, doc="mean", **ANGLE)
    waves: dict[str, Wave] = mapping_of("sinusoids by name")


@dataclass(frozen=True)
class Turn:
    """A turn of the ship at constant rate, with linear ramps of the rate at both ends."""

    start_s: float = parameter(0.0, doc="begin of the turn", **TIME)
    angle_deg: float = parameter(
        0.0, doc="change of heading, to starboard positive", unit="deg", minimum=-36_000.0, maximum=36_000.0
    )
    rate_deg_per_s: float = parameter(1.0, doc="rate of turn", unit="deg/s", minimum=0.001, maximum=60.0)
    ramp_s: float = parameter(10.0, doc="duration of each ramp of the rate", unit="s", minimum=0.1, maximum=600.0)


@dataclass(frozen=True)
class Sea:
    """A long-crested sea and the ship's response to it. Defaults: sea state 5, a research vessel of 80 m."""

    significant_height_m: float = parameter(3.25, doc="significant wave height", unit="m", minimum=0.0, maximum=20.0)
    modal_period_s: float = parameter(
        9.7, doc="period at the peak of the spectrum", unit="s", minimum=1.0, maximum=30.0
    )
    direction_deg: float = parameter(
        135.0, doc="direction to which the waves travel: 0 bow, 90 starboard, 180 stern", **ANGLE
    )
    component_count: int = parameter(100, doc="number of wave components", minimum=10, maximum=2000)
    heading_gain: float = parameter(2.0, **_GAIN)
    heading_period_s: float = parameter(8.0, **_PERIOD)
    heading_damping: float = parameter(1.0, **_DAMPING)
    heading_length_m: float = parameter(80.0, **_LENGTH)
    pitch_gain: float = parameter(1.0, **_GAIN)
    pitch_period_s: float = parameter(6.5, **_PERIOD)
    pitch_damping: float = parameter(0.4, **_DAMPING)
    pitch_length_m: float = parameter(60.0, **_LENGTH)
    roll_gain: float = parameter(1.0, **_GAIN)
    roll_period_s: float = parameter(11.0, **_PERIOD)
    roll_damping: float = parameter(0.12, **_DAMPING)
    roll_length_m: float = parameter(18.0, **_LENGTH)


@dataclass(frozen=True)
class Recording:
    """A recorded attitude that the simulated ship follows."""

    bag: str = parameter("", doc="bag with the attitude; path relative to the scenario file")
    topic: str = parameter("ins/imu", doc="topic of the attitude, type sensor_msgs/msg/Imu")


@dataclass(frozen=True)
class CarrierMotion:
    """Motion of the ship."""

    kind: str = parameter(doc="source of the motion", choices=("sinusoids", "sea_state", "recorded"))
    heading: AngleMotion = section(AngleMotion)
    pitch: AngleMotion = section(AngleMotion)
    roll: AngleMotion = section(AngleMotion)
    turn: Turn = section(Turn)
    sea: Sea = section(Sea)
    recording: Recording = section(Recording)
