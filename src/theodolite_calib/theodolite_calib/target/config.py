"""How places of targets are made of directions: the theodolites, the common frame, the air, what must fit.

The command ``triangulate`` and the node ``triangulation`` have these parameters by the same names.
"""

import re
from dataclasses import dataclass

import numpy as np

from ship_estimation.frame_names import HorizonFrame
from ship_estimation.parameter_fields import mapping_of, parameter, section, sources_off, stamp_age
from ship_estimation.parameters import ParameterError
from ship_geometry.geodetic import GeodeticPosition
from theodolite_calib.target.triangulation import Air, Station

DIRECTION_TOPIC = "theodolite/target_direction"

_RELATIVE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True, kw_only=True)
class PositionConfig:
    """A place on WGS 84."""

    latitude_deg: float = parameter(doc="geodetic latitude", unit="deg", minimum=-90.0, maximum=90.0)
    longitude_deg: float = parameter(doc="longitude, East positive", unit="deg", minimum=-180.0, maximum=360.0)
    height_m: float = parameter(doc="height over the ellipsoid WGS 84", unit="m", minimum=-500.0, maximum=9000.0)

    @property
    def position(self) -> GeodeticPosition:
        """The place."""
        latitude, longitude = np.deg2rad([self.latitude_deg, self.longitude_deg]).tolist()
        return GeodeticPosition(latitude, longitude, self.height_m)


@dataclass(frozen=True, kw_only=True)
class StationPlaceConfig(PositionConfig):
    """Where a theodolite stands: its centre, and how well that is known. It stands still on the Earth."""

    sigma_m: float = parameter(0.05, doc="error of the place, each axis", unit="m", minimum=0.0, maximum=1000.0)

    def station(self, name: str) -> Station:
        """The theodolite of a name that stands there."""
        return Station(name, self.position, self.sigma_m)


@dataclass(frozen=True, kw_only=True)
class RefractionConfig:
    """How the air bends light on its way to the target: it is raised by k times distance over twice Earth's radius."""

    coefficient: float = parameter(
        0.13, doc="coefficient k of terrestrial refraction", minimum=-5.0, maximum=5.0, live=True
    )
    sigma: float = parameter(0.06, doc="its error, common to all theodolites", minimum=0.0, maximum=5.0, live=True)


@dataclass(frozen=True, kw_only=True)
class PlacingConfig:
    """What the command and the node have in common, beside the theodolites."""

    origin: PositionConfig = parameter(doc="origin of the common frame: East, North, Up there")
    refraction: RefractionConfig = section(RefractionConfig)
    max_gap_s: float = parameter(
        1.0, doc="a theodolite's directions further apart in time are not joined", unit="s", minimum=0.001, maximum=60.0
    )
    gate_probability: float = parameter(
        0.999, doc="share of right sets of directions that fit one another", minimum=0.5, maximum=0.999999, live=True
    )

    @property
    def air(self) -> Air:
        """The air on the way to the target."""
        return Air(self.refraction.coefficient, self.refraction.sigma)


@dataclass(frozen=True, kw_only=True)
class LiveStationConfig(StationPlaceConfig):
    """One theodolite that the node hears."""

    topic: str = parameter("", doc=f"relative name of the topic of its directions; empty for <id>/{DIRECTION_TOPIC}")


@dataclass(frozen=True, kw_only=True)
class TriangulationConfig(PlacingConfig):
    """All parameters of the node ``triangulation``."""

    stations: dict[str, LiveStationConfig] = mapping_of("theodolites that stand still on the Earth, by name")
    lag_s: float = parameter(
        2.0,
        doc="directions wait for a theodolite that reports on the target until its next report is so long overdue",
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
        """Check that each theodolite has a topic of its own.

        Raises:
            ParameterError: names the parameter.
        """
        taken: dict[str, str] = {}
        for name, station in self.stations.items():
            parameter_name = f"stations.{name}.topic"
            if station.topic and not _RELATIVE_NAME.fullmatch(station.topic):
                raise ParameterError(
                    f"parameter '{parameter_name}' = {station.topic}: expected a relative name, such as "
                    f"west/{DIRECTION_TOPIC}; remap it at the start where it is elsewhere",
                    parameter_name,
                    value=station.topic,
                )
            topic = self.topic_of(name)
            if topic in taken:
                raise ParameterError(
                    f"parameter '{parameter_name}': {topic} is that of '{taken[topic]}' already: each theodolite has "
                    "its own",
                    parameter_name,
                    value=station.topic,
                )
            taken[topic] = name

    def topic_of(self, name: str) -> str:
        """The topic of a theodolite's directions."""
        return self.stations[name].topic or f"{name}/{DIRECTION_TOPIC}"
