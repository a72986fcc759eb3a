"""Faults of the messages of a topic: kinds, and the sizes that each kind needs.

A size is a parameter that belongs to some kinds only, such as ``delay_s`` or ``field``.
Scenarios and the files for ``inject`` contain faults, which :mod:`ship_simulation.faults` applies.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from ship_estimation.parameters.fields import parameter
from ship_estimation.parameters.schema import ParameterError
from ship_simulation.scenario.motion_scenario import DELAY, TIME

_TO_THE_END_S = 1e6
_STEP: dict[str, Any] = {"unit": "arcsec", "minimum": -1_296_000.0, "maximum": 1_296_000.0}
_RATE: dict[str, Any] = {"unit": "arcsec/min", "minimum": -1_296_000.0, "maximum": 1_296_000.0}
_WAY: dict[str, Any] = {"unit": "m", "minimum": -1e7, "maximum": 1e7}

_HORIZON = ("north_arcsec", "up_arcsec", "east_arcsec")
_DEVICE = ("forward_arcsec", "up_arcsec", "right_arcsec")
_ENCODERS = ("azimuth_arcsec", "elevation_arcsec")
_RATES = ("forward", "up", "right", "azimuth", "elevation")
_DRIFT = tuple(f"{name}_arcsec_per_min" for name in _RATES)
_VECTOR = ("east_m", "north_m", "up_m")

AXES = ("", "exchanged", "ned_frd")


class FaultKind(NamedTuple):
    """A kind of fault.

    Attributes:
        doc: effect of the kind on messages.
        required: groups of sizes; a fault needs at least one size of each group.
        optional: optional sizes.
    """

    doc: str
    required: tuple[tuple[str, ...], ...] = ()
    optional: tuple[str, ...] = ()

    @property
    def sizes(self) -> tuple[str, ...]:
        """All sizes that belong to the kind."""
        return (*(name for group in self.required for name in group), *self.optional)


KINDS = {
    "drop": FaultKind("no message arrives"),
    "delay": FaultKind("messages arrive delay_s later", (("delay_s",),)),
    "reorder": FaultKind("each message arrives later by a random time between 0 and delay_s", (("delay_s",),)),
    "duplicate": FaultKind("each message arrives again 1 ms later, with the same bytes"),
    "conflict": FaultKind(
        "a message with the same stamp and the values of the next message arrives 1 ms later; none after the last"
    ),
    "flood": FaultKind(
        "each message is replaced by times messages; the additional ones have random stamps, up to spread_s earlier",
        (("times",),),
        ("spread_s",),
    ),
    "freeze": FaultKind("messages keep their stamps and repeat the values of the first affected message"),
    "nan": FaultKind("NaN in a field; default: the first value (of the first star, if there is one)", (), ("field",)),
    "infinite": FaultKind("infinity in a field; default: the first value", (), ("field",)),
    "corrupt": FaultKind("a field is set to the value", (("field",),), ("value",)),
    "offset": FaultKind("the value is added to a field", (("field",), ("value",))),
    "stamp_zero": FaultKind("stamp zero"),
    "stamp_late": FaultKind("stamps are delay_s later than the measurement", (("delay_s",),)),
    "clock_step": FaultKind("step_s is added to the stamps, positive or negative", (("step_s",),)),
    "frame": FaultKind("another frame_id"),
    "covariance_unknown": FaultKind("covariances all zero"),
    "covariance_negative": FaultKind("a negative variance"),
    "rate_in_degrees": FaultKind("angular rate in degrees per second"),
    "angles_in_degrees": FaultKind("encoder or attitude angles in degrees"),
    "units": FaultKind(
        "a wrong unit: angles and angular rates in degrees; a fix in radians; air in hPa, K, percent; baselines and "
        "images in millimetres"
    ),
    "axes": FaultKind("other axes: x and y exchanged, or north-east-down and forward-right-down", (("axes",),)),
    "bias": FaultKind("attitude rotated about the horizon's axes, with unchanged rates", (_HORIZON,)),
    "position_off": FaultKind("a vector is added to the position", (_VECTOR,)),
    "knock": FaultKind("mounting shift: the device is rotated in its own frame; stars and lights move", (_DEVICE,)),
    "drift": FaultKind("the device rotates slowly in its own frame, or encoders drift", (_DRIFT,)),
    "slip": FaultKind("a step is added to the encoders", (_ENCODERS,)),
    "wrong_fix": FaultKind("a vector is added to a baseline with fix FIXED", (_VECTOR,)),
    "false_stars": FaultKind(
        "count additional spots that are not stars, identified in the same way as the stars", (("count",),)
    ),
    "false_lights": FaultKind("count lights are moved in the image; additional ones have new ids", (("count",),)),
    "hide": FaultKind("the first light of the image is missing"),
    "swap": FaultKind("the identities of the first two lights of the image, or stars of the exposure, are swapped"),
    "wrong_id": FaultKind("the first light of the image, or the rover of a baseline, has an unknown id"),
}


@dataclass(frozen=True)
class Fault:
    """A fault of one topic from ``start_s`` to ``end_s``."""

    topic: str = parameter(doc="topic, for example ins/imu")
    kind: str = parameter(doc="kind of the fault", choices=tuple(KINDS))
    start_s: float = parameter(doc="begin, after the start, by stamps", **TIME)
    end_s: float = parameter(_TO_THE_END_S, doc="end, after the start, by stamps; default: no end", **TIME)
    share: float = parameter(1.0, doc="share of the messages that are affected, drawn", minimum=0.0, maximum=1)
    delay_s: float = parameter(0.0, doc="delay: delay, stamp_late; maximum delay: reorder", **DELAY)
    step_s: float = parameter(0.0, doc="step of the stamps: clock_step", unit="s", minimum=-1e9, maximum=1e9)
    field: str = parameter("", doc="field of nan, infinite, corrupt, offset: orientation.x, covariance[4], stars[*].u")
    value: float = parameter(0.0, doc="value of corrupt, offset, in the field's unit", minimum=-1e300, maximum=1e300)
    axes: str = parameter("", doc="wrong axes: axes", choices=AXES)
    north_arcsec: float = parameter(0.0, doc="rotation about North: bias", **_STEP)
    up_arcsec: float = parameter(0.0, doc="rotation about Up, or the device's up axis: bias, knock", **_STEP)
    east_arcsec: float = parameter(0.0, doc="rotation about East: bias", **_STEP)
    forward_arcsec: float = parameter(0.0, doc="rotation about the device's forward axis: knock", **_STEP)
    right_arcsec: float = parameter(0.0, doc="rotation about the device's right axis: knock", **_STEP)
    azimuth_arcsec: float = parameter(0.0, doc="step of the azimuth encoder: slip", **_STEP)
    elevation_arcsec: float = parameter(0.0, doc="step of the elevation encoder: slip", **_STEP)
    forward_arcsec_per_min: float = parameter(0.0, doc="drift about the device's forward axis", **_RATE)
    up_arcsec_per_min: float = parameter(0.0, doc="drift about the device's up axis", **_RATE)
    right_arcsec_per_min: float = parameter(0.0, doc="drift about the device's right axis", **_RATE)
    azimuth_arcsec_per_min: float = parameter(0.0, doc="drift of the azimuth encoder", **_RATE)
    elevation_arcsec_per_min: float = parameter(0.0, doc="drift of the elevation encoder", **_RATE)
    east_m: float = parameter(0.0, doc="offset to the East: position_off, wrong_fix", **_WAY)
    north_m: float = parameter(0.0, doc="offset to the North: position_off, wrong_fix", **_WAY)
    up_m: float = parameter(0.0, doc="offset upwards: position_off, wrong_fix", **_WAY)
    count: int = parameter(0, doc="number of spots per message: false_stars, false_lights", minimum=0, maximum=1000)
    times: int = parameter(0, doc="number of messages that replace each message: flood", minimum=0, maximum=10_000)
    spread_s: float = parameter(2.0, doc="maximum age of the random stamps: flood", **DELAY)

    @property
    def sizes(self) -> tuple[str, ...]:
        """Sizes that belong to the fault's kind."""
        return KINDS[self.kind].sizes

    @property
    def window_text(self) -> str:
        """Time of the fault, in seconds after the first message, as text."""
        end = "the end" if self.end_s >= _TO_THE_END_S else f"{self.end_s:g} s"
        return f"from {self.start_s:g} s to {end}"


_DEFAULTS = {field.name: field.default for field in dataclasses.fields(Fault)}
_SIZES = tuple(name for name in _DEFAULTS if name not in ("topic", "kind", "start_s", "end_s", "share"))


def size_problems(key: str, fault: Fault) -> Iterator[ParameterError]:
    """Yield the errors in the times and sizes of a fault; ``key`` is the dotted name of the fault in the file."""
    if fault.end_s <= fault.start_s:
        name = f"{key}.end_s"
        yield ParameterError(f"'{name}' = {fault.end_s} s must be after start_s = {fault.start_s} s", name)
    kind = KINDS[fault.kind]
    for group in kind.required:
        if all(getattr(fault, name) == _DEFAULTS[name] for name in group):
            wanted = " or ".join(group)
            yield ParameterError(f"'{key}' of kind {fault.kind} needs {wanted}", f"{key}.{group[0]}")
    for name in _SIZES:
        if name not in kind.sizes and getattr(fault, name) != _DEFAULTS[name]:
            owners = " and ".join(owner for owner, other in KINDS.items() if name in other.sizes)
            text = f"'{key}.{name}' is not used by kind {fault.kind}: it belongs to {owners}"
            yield ParameterError(text, f"{key}.{name}")


def kind_rows() -> list[str]:
    """Return the kinds of faults as text, one line each."""
    width = max(map(len, KINDS))
    rows = []
    for name, kind in KINDS.items():
        needed = "; needs " + ", ".join(" or ".join(group) for group in kind.required) if kind.required else ""
        rows.append(f"  {name:{width}}  {kind.doc}{needed}")
    return rows
