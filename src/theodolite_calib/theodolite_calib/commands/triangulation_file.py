"""File of the command ``triangulate``: parameters of the node ``triangulation``, and bags with the directions."""

from dataclasses import dataclass

from ship_estimation.parameters.fields import mapping_of, parameter
from theodolite_calib.triangulation.config import DIRECTION_TOPIC, PositioningConfig, StationPositionConfig


@dataclass(frozen=True, kw_only=True)
class RecordedStationConfig(StationPositionConfig):
    """One theodolite: its position, and the bag with its directions."""

    bag: str = parameter(doc="bag with its directions; a relative path starts at the file")
    topic: str = parameter(DIRECTION_TOPIC, doc="topic of ship_msgs/msg/TargetDirection in that bag")


@dataclass(frozen=True, kw_only=True)
class RecordedTriangulationConfig(PositioningConfig):
    """All parameters of the file."""

    stations: dict[str, RecordedStationConfig] = mapping_of("theodolites by name, two or more")
