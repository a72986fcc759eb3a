"""Parameters of the ``star_attitude`` node, with unit, range and meaning."""

from dataclasses import dataclass

from ship_estimation.parameters.fields import DeckFrame, mapping_of, parameter, section, sources_off, stamp_age
from ship_estimation.parameters.ship_devices import StarInsConfig
from ship_stars.camera.config import MountingConfig, RequiredCameraConfig, StarSensorsById
from ship_stars.sky.config import SkyConfig


@dataclass(frozen=True, kw_only=True)
class ObservingSensorConfig(MountingConfig):
    """Parameters of a star sensor whose attitude is computed from ``star/<id>/observations``."""

    camera: RequiredCameraConfig = section(RequiredCameraConfig)


@dataclass(frozen=True, kw_only=True)
class JointConfig:
    """Parameters for joint solutions: one attitude of the deck from exposures of several sensors."""

    window_s: float = parameter(
        0.1,
        doc="maximum time between joined exposures; ins/imu propagates them to one time",
        unit="s",
        minimum=0.0,
        maximum=10.0,
    )
    simultaneous_s: float = parameter(
        1e-4,
        doc="maximum time between joined exposures without ins/imu: the ship's rotation in it is neglected",
        unit="s",
        minimum=0.0,
        maximum=0.1,
    )
    wait_s: float = parameter(
        0.5,
        doc="maximum time for which an exposure waits for exposures of other sensors and for ins/imu",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    )


@dataclass(frozen=True, kw_only=True)
class StarAttitudeConfig(StarSensorsById):
    """All parameters of ``star_attitude``."""

    star_sensors: dict[str, ObservingSensorConfig] = mapping_of("star sensors by id")
    sky: SkyConfig = section(SkyConfig)
    use_ins: bool = parameter(
        True, doc="use ins/imu, if received, to select stars and to propagate exposures to one time"
    )
    ins: StarInsConfig = section(StarInsConfig)
    joint: JointConfig = section(JointConfig)
    lag_s: float = parameter(
        2.0, doc="maximum age of a used exposure relative to the newest data", unit="s", minimum=0.0, maximum=600.0
    )
    frames: DeckFrame = section(DeckFrame)
    sources_off: tuple[str, ...] = sources_off()
    max_age_s: float = stamp_age()
    slow_topics_period_s: float = parameter(
        1.0, doc="period of budget and health topics", unit="s", minimum=0.1, maximum=60.0
    )
