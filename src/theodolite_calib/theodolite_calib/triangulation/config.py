"""Parameters of triangulation: theodolites, common frame, refraction and gate.

The command ``triangulate`` and the node ``triangulation`` use these parameters under the same names.
"""

import re
from dataclasses import dataclass

import numpy as np

from ship_estimation.parameters.fields import mapping_of, parameter, section, sources_off, stamp_age
from ship_estimation.parameters.frame_names import HorizonFrame
from ship_estimation.parameters.schema import ParameterError
from ship_geometry.earth.geodetic import GeodeticPosition
from theodolite_calib.triangulation.triangulation import Air, Station

DIRECTION_TOPIC = "theodolite/target_direction"

_RELATIVE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True, kw_only=True)
class PositionConfig:
    """Position on WGS 84."""

    latitude_deg: float = parameter(doc="geodetic latitude", unit="deg", minimum=-90.0, maximum=90.0)
    longitude_deg: float = parameter(doc="longitude, East positive", unit="deg", minimum=-180.0, maximum=360.0)
    height_m: float = parameter(doc="height over the ellipsoid WGS 84", unit="m", minimum=-500.0, maximum=9000.0)

    @property
    def position(self) -> GeodeticPosition:
        """Geodetic position."""
        latitude, longitude = np.deg2rad([self.latitude_deg, self.longitude_deg]).tolist()
        return GeodeticPosition(latitude, longitude, self.height_m)


@dataclass(frozen=True, kw_only=True)
class StationPositionConfig(PositionConfig):
    """Position of a theodolite's centre, and its error. The theodolite is fixed to the Earth."""

    sigma_m: float = parameter(0.05, doc="error of the position, each axis", unit="m", minimum=0.0, maximum=1000.0)

    def station(self, name: str) -> Station:
        """Return the theodolite with a name at this position."""
        return Station(name, self.position, self.sigma_m)


@dataclass(frozen=True, kw_only=True)
class RefractionConfig:
    """Refraction on the path to the target; the target's direction is raised by k · (horizontal distance) / (2 R)."""

    coefficient: float = parameter(
        0.13, doc="coefficient k of terrestrial refraction", minimum=-5.0, maximum=5.0, live=True
    )
    sigma: float = parameter(0.06, doc="error of k, common to all theodolites", minimum=0.0, maximum=5.0, live=True)


@dataclass(frozen=True, kw_only=True)
class PositioningConfig:
    """Parameters common to the command and the node, except the theodolites."""

    origin: PositionConfig = parameter(doc="origin of the common frame: East, North, Up there")
    refraction: RefractionConfig = section(RefractionConfig)
    max_gap_s: float = parameter(
        1.0, doc="directions further apart in time are not interpolated", unit="s", minimum=0.001, maximum=60.0
    )
    gate_probability: float = parameter(
        0.999, doc="probability that consistent directions are accepted", minimum=0.5, maximum=0.999999, live=True
    )

    @property
    def air(self) -> Air:
        """Refraction on the path to the target."""
        return Air(self.refraction.coefficient, self.refraction.sigma)


@dataclass(frozen=True, kw_only=True)
class LiveStationConfig(StationPositionConfig):
    """One theodolite of the node."""

    topic: str = parameter("", doc=f"relative name of the topic of its directions; empty for <id>/{DIRECTION_TOPIC}")


@dataclass(frozen=True, kw_only=True)
class TriangulationConfig(PositioningConfig):
    """All parameters of the node ``triangulation``."""

    stations: dict[str, LiveStationConfig] = mapping_of("theodolites fixed to the Earth, by name")
    lag_s: float = parameter(
        2.0,
        doc="directions wait for the next report of each theodolite until it is overdue by this time",
        unit="s",
        minimum=0.0,
        maximum=60.0,
    )
    frames: HorizonFrame = section(HorizonFrame)
    sources_off: tuple[str, ...] = sources_off()
    max_age_s: float = stamp_age()
    slow_topics_period_s: float = parameter(
        1.0, doc="period of health topics and diagnostics", unit="s", minimum=0.1, maximum=60.0
    )

    def __post_init__(self) -> None:
        """Check that each theodolite has a topic of its own, with a relative name.

        Raises:
            ParameterError: the check fails; the text names the parameter.
        """
        station_by_topic: dict[str, str] = {}
        for name, station in self.stations.items():
            parameter_name = f"stations.{name}.topic"
            if station.topic and not _RELATIVE_NAME.fullmatch(station.topic):
                raise ParameterError(
                    f"parameter '{parameter_name}' = {station.topic}: expected a relative name, such as "
                    f"west/{DIRECTION_TOPIC}; remap it at the start if it differs",
                    parameter_name,
                    value=station.topic,
                )
            topic = self.topic_of(name)
            if topic in station_by_topic:
                raise ParameterError(
                    f"parameter '{parameter_name}': {topic} is already used by '{station_by_topic[topic]}': "
                    "each theodolite needs "
                    "its own",
                    parameter_name,
                    value=station.topic,
                )
            station_by_topic[topic] = name

    def topic_of(self, name: str) -> str:
        """Return the topic of a theodolite's directions."""
        return self.stations[name].topic or f"{name}/{DIRECTION_TOPIC}"
