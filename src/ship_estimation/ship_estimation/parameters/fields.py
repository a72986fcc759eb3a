"""Fields of a configuration, which describe each parameter with unit, range and text.

A component's configuration is a frozen dataclass with these fields; :mod:`ship_estimation.parameters.schema` builds and
checks this dataclass. Parameters that every estimator has are defined here once: age of a stamp, switched-off sources,
autosave, transforms, and the names of the ship's frames, which differ between the frame trees of ROS systems.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

from ship_estimation.parameters.schema import ParameterError


def parameter(
    default: Any = dataclasses.MISSING,
    *,
    doc: str,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    live: bool = False,
) -> Any:
    """Return a dataclass field with its description; without ``default`` the parameter must be given.

    Args:
        default: value if the parameter is not given.
        doc: one sentence for the parameter's description.
        unit: unit of the value; empty without a unit.
        minimum: least value allowed (of each element of a tuple).
        maximum: greatest value allowed (of each element of a tuple).
        choices: allowed texts.
        live: True if the parameter can change while the node runs (for example noise and gates; never geometry).

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Camera:
        ...     focal_length_m: float = parameter(0.1, doc="focal length", unit="m", minimum=0.001, maximum=10.0)
        >>> Camera().focal_length_m
        0.1
    """
    metadata = {
        "doc": doc,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "live": live,
    }
    return dataclasses.field(default=default, metadata=metadata)


def changed_parameter(kind: type, name: str, **changes: Any) -> Any:
    """Return the field of a parameter of another configuration with changes, to override it in a derived one.

    Args:
        kind: dataclass with the parameter.
        name: name of the parameter.
        changes: arguments of :func:`parameter` that differ.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Antenna:
        ...     sigma_m: float = parameter(0.01, doc="correlated error", unit="m", minimum=0.0)
        >>> @dataclasses.dataclass(frozen=True)
        ... class PerfectAntenna(Antenna):
        ...     sigma_m: float = changed_parameter(Antenna, "sigma_m", default=0.0)
        >>> PerfectAntenna().sigma_m, dataclasses.fields(PerfectAntenna)[0].metadata["unit"]
        (0.0, 'm')
    """
    (field,) = (field for field in dataclasses.fields(kind) if field.name == name)
    return parameter(**{"default": field.default, **field.metadata, **changes})


def degrees(default: Any = dataclasses.MISSING, *, doc: str) -> Any:
    """Return the field of a geometric angle, degrees; without a default the parameter must be given.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Mount:
        ...     azimuth_deg: float = degrees(doc="from the bow, to starboard")
        >>> Mount(azimuth_deg=90.0).azimuth_deg
        90.0
    """
    return parameter(default, doc=doc, unit="deg", minimum=-360.0, maximum=360.0)


def arcsec(default: float, *, doc: str, live: bool = False) -> Any:
    """Return the field of a standard deviation, arcseconds.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Noise:
        ...     sigma_arcsec: float = arcsec(3.0, doc="across the boresight", live=True)
        >>> Noise().sigma_arcsec
        3.0
    """
    return parameter(default, doc=doc, unit="arcsec", minimum=0.0, maximum=360_000.0, live=live)


def stamp_age() -> Any:
    """Return the parameter ``max_age_s`` of an estimator, the age of a stamp above which an error is reported, s.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Node:
        ...     max_age_s: float = stamp_age()
        >>> Node().max_age_s
        10.0
    """
    return parameter(
        10.0,
        doc="age of a stamp above which an input error is reported; the data are used all the same",
        unit="s",
        minimum=0.1,
        maximum=1e9,
    )


def accept_unset_covariance() -> Any:
    """Return the parameter ``accept_unset_covariance`` of every input of type sensor_msgs/Imu.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Input:
        ...     accept_unset_covariance: bool = accept_unset_covariance()
        >>> Input().accept_unset_covariance
        False
    """
    return parameter(
        False,
        doc="use orientations whose covariance begins with -1, which means in sensor_msgs/Imu that there is no"
        " orientation: for drivers that set -1 although they give an orientation",
    )


def autosave_period() -> Any:
    """Return the parameter ``alignment_autosave_s``, the period at which a node saves its estimated alignment, s.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Node:
        ...     alignment_autosave_s: float = autosave_period()
        >>> Node().alignment_autosave_s
        60.0
    """
    return parameter(
        60.0,
        doc="period at which the node saves its alignment, while its output is VALID and the existing file is not"
        " more accurate; 0 for never",
        unit="s",
        minimum=0.0,
        maximum=86400.0,
        live=True,
    )


def saved_age(saved: str) -> Any:
    """Return the parameter with the age above which a saved alignment or calibration counts as uncertain, d.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Node:
        ...     alignment_max_age_d: float = saved_age("alignment")
        >>> Node().alignment_max_age_d
        30.0
    """
    doc = f"age above which the configured uncertainty is added to a saved {saved}"
    return parameter(30.0, doc=doc, unit="d", minimum=0.0, maximum=36500.0)


def sources_off() -> Any:
    """Return the live parameter ``sources_off`` of an estimator, the sources that are switched off.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Node:
        ...     sources_off: tuple[str, ...] = sources_off()
        >>> Node().sources_off
        ()
    """
    return parameter(
        (),
        doc="sources, by their names in innovations and health, that are switched off: their messages are read and"
        " counted, but not used",
        live=True,
    )


def mapping_of(doc: str) -> Any:
    """Return a field of type ``dict[str, Dataclass]``, empty by default.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Ship:
        ...     star_sensors: dict[str, Any] = mapping_of(doc="star sensors by their ids")
        >>> Ship().star_sensors
        {}
    """
    return dataclasses.field(default_factory=dict, metadata={"doc": doc})


def section(kind: type) -> Any:
    """Return a field that is itself a configuration dataclass with defaults.

    Example:
        >>> from ship_estimation.innovations.gates import GateConfig
        >>> @dataclasses.dataclass(frozen=True)
        ... class Filter:
        ...     gate: GateConfig = section(GateConfig)
        >>> Filter().gate.conflict_after
        10
    """
    return dataclasses.field(default_factory=kind)


def publish_tf() -> Any:
    """Return the parameter ``publish_tf`` of a node that publishes transforms.

    Example:
        >>> @dataclasses.dataclass(frozen=True)
        ... class Node:
        ...     publish_tf: bool = publish_tf()
        >>> Node().publish_tf
        True
    """
    return parameter(
        True, doc="publish transforms on /tf and /tf_static; false if another node publishes those of these frames"
    )


def _check_name(name: str, frame: str) -> None:
    """Raise :class:`ParameterError` for a name that tf2 does not accept as a frame."""
    if not frame or frame.startswith("/") or frame != frame.strip():
        raise ParameterError(
            f"parameter '{name}' = {frame!r} is not a frame name: expected one like 'base_link', no slash first",
            name,
            value=frame,
        )


@dataclass(frozen=True, kw_only=True)
class DeckFrame:
    """Name of the ship's frame."""

    deck: str = parameter("deck", doc="name of the ship's frame (forward, left, up), as base_link")

    def __post_init__(self) -> None:
        _check_name("frames.deck", self.deck)


@dataclass(frozen=True, kw_only=True)
class HorizonFrame:
    """Name of the horizon frame."""

    horizon: str = parameter("horizon", doc="name of the frame East, North, Up at the ship")

    def __post_init__(self) -> None:
        _check_name("frames.horizon", self.horizon)


@dataclass(frozen=True, kw_only=True)
class FrameNames(DeckFrame, HorizonFrame):
    """Names of the ship's frame and of the horizon frame.

    Raises:
        ParameterError: a name is invalid, or both names are the same.
    """

    def __post_init__(self) -> None:
        DeckFrame.__post_init__(self)
        HorizonFrame.__post_init__(self)
        if self.deck == self.horizon:
            raise ParameterError(
                f"parameter 'frames.deck' = {self.deck!r} equals 'frames.horizon': expected two different names",
                "frames.deck",
                value=self.deck,
            )


FRAME_NAMES = FrameNames()
"""The default names."""
