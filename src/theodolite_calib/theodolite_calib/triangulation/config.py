"""What the file of ``triangulate`` may say: as the node's parameters, with the bags in which the directions are."""

from dataclasses import dataclass

from ship_estimation.parameter_fields import mapping_of, parameter
from theodolite_calib.target.config import DIRECTION_TOPIC, PlacingConfig, StationPlaceConfig


@dataclass(frozen=True, kw_only=True)
class RecordedStationConfig(StationPlaceConfig):
    """One theodolite: where it stands, and where its directions are."""

    bag: str = parameter(doc="bag with its directions; a relative path starts at the file")
    topic: str = parameter(DIRECTION_TOPIC, doc="topic of ship_msgs/msg/TargetDirection in that bag")


@dataclass(frozen=True, kw_only=True)
class RecordedTriangulationConfig(PlacingConfig):
    """All that the file says."""

    stations: dict[str, RecordedStationConfig] = mapping_of("theodolites by name, two or more")
