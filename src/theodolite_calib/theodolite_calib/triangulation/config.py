"""What the file of ``triangulate`` may say: the theodolites, where they stand, what they recorded, the air."""

from dataclasses import dataclass

from ship_estimation.parameter_fields import mapping_of, parameter, section


@dataclass(frozen=True, kw_only=True)
class StationConfig:
    """One theodolite: where it stands, and where its directions are."""

    bag: str = parameter(doc="bag with its directions; a relative path starts at the file")
    topic: str = parameter("theodolite/target_direction", doc="topic of ship_msgs/msg/TargetDirection in that bag")
    latitude_deg: float = parameter(doc="geodetic latitude of its centre", unit="deg", minimum=-90.0, maximum=90.0)
    longitude_deg: float = parameter(doc="longitude, East positive", unit="deg", minimum=-180.0, maximum=360.0)
    height_m: float = parameter(doc="height over the ellipsoid WGS 84", unit="m", minimum=-500.0, maximum=9000.0)
    sigma_m: float = parameter(0.05, doc="error of the place, each axis", unit="m", minimum=0.0, maximum=1000.0)


@dataclass(frozen=True, kw_only=True)
class OriginConfig:
    """The origin of the common frame: East, North, Up there."""

    latitude_deg: float = parameter(doc="geodetic latitude", unit="deg", minimum=-90.0, maximum=90.0)
    longitude_deg: float = parameter(doc="longitude, East positive", unit="deg", minimum=-180.0, maximum=360.0)
    height_m: float = parameter(doc="height over the ellipsoid WGS 84", unit="m", minimum=-500.0, maximum=9000.0)


@dataclass(frozen=True, kw_only=True)
class AirConfig:
    """How the air bends light on its way to the target: it is raised by k times distance over twice Earth's radius."""

    coefficient: float = parameter(0.13, doc="coefficient k of terrestrial refraction", minimum=-5.0, maximum=5.0)
    sigma: float = parameter(0.06, doc="its error, common to all theodolites", minimum=0.0, maximum=5.0)


@dataclass(frozen=True, kw_only=True)
class TriangulationConfig:
    """All that the file says."""

    origin: OriginConfig = parameter(doc="origin of the common frame")
    stations: dict[str, StationConfig] = mapping_of("theodolites by name, two or more")
    refraction: AirConfig = section(AirConfig)
    max_gap_s: float = parameter(
        1.0, doc="a theodolite's directions further apart in time are not joined", unit="s", minimum=0.001, maximum=60.0
    )
    gate_probability: float = parameter(
        0.999, doc="share of right sets of directions that fit one another", minimum=0.5, maximum=0.999999
    )
