"""One thing that goes wrong with the messages of a topic: what a fault is called, and which sizes it needs.

A scenario lists faults, and so does the file that ``inject`` takes. :mod:`ship_simulation.faults` makes them.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from ship_estimation.parameter_fields import parameter
from ship_estimation.parameters import ParameterError
from ship_simulation.scenario.motion_scenario import DELAY, MOMENT

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


class Kind(NamedTuple):
    """A kind of fault.

    Attributes:
        doc: what it does to a message.
        needs: sizes that it needs; of each group one or more.
        may: sizes that it takes besides.
    """

    doc: str
    needs: tuple[tuple[str, ...], ...] = ()
    may: tuple[str, ...] = ()

    @property
    def sizes(self) -> tuple[str, ...]:
        """All sizes that belong to the kind."""
        return (*(name for group in self.needs for name in group), *self.may)


KINDS = {
    "drop": Kind("nothing arrives"),
    "delay": Kind("arrives later by delay_s", (("delay_s",),)),
    "reorder": Kind("arrives later by something between 0 and delay_s, each message by its own", (("delay_s",),)),
    "duplicate": Kind("arrives again, the same bytes, 1 ms later"),
    "conflict": Kind("a message of the same stamp with the next one's values arrives 1 ms later; none for the last"),
    "flood": Kind(
        "arrives times as often; the others have random stamps, up to spread_s earlier", (("times",),), ("spread_s",)
    ),
    "freeze": Kind("new stamps, the values of the first message of the time"),
    "nan": Kind("NaN in a field; without one in the first value (of the first star, if there is one)", (), ("field",)),
    "infinite": Kind("infinity in a field; without one in the first value", (), ("field",)),
    "corrupt": Kind("a field has the value", (("field",),), ("value",)),
    "offset": Kind("a field is off by the value", (("field",), ("value",))),
    "stamp_zero": Kind("stamp zero"),
    "stamp_late": Kind("stamps later by delay_s than the moment that they are of", (("delay_s",),)),
    "clock_step": Kind("stamps off by step_s, to both sides", (("step_s",),)),
    "frame": Kind("another frame_id"),
    "covariance_unknown": Kind("covariances all zero"),
    "covariance_negative": Kind("a negative variance"),
    "rate_in_degrees": Kind("angular rate in degrees per second"),
    "angles_in_degrees": Kind("encoder or attitude angles in degrees"),
    "units": Kind(
        "the wrong unit: degrees; of a fix radians; hPa, K, percent; millimetres of a baseline and of an image"
    ),
    "axes": Kind("axes as axes says: x and y exchanged, or north-east-down and forward-right-down", (("axes",),)),
    "bias": Kind("attitude turned about the horizon's axes, the rates as before", (_HORIZON,)),
    "position_off": Kind("position off by a vector", (_VECTOR,)),
    "knock": Kind("the device is turned in its own frame; of single stars and lights the points move", (_DEVICE,)),
    "drift": Kind("the device turns slowly in its own frame, or encoders drift", (_DRIFT,)),
    "slip": Kind("encoders off by a step", (_ENCODERS,)),
    "wrong_fix": Kind("a baseline that says FIXED and is off by a vector", (_VECTOR,)),
    "false_stars": Kind("count spots more that are no stars; with numbers where the others have some", (("count",),)),
    "false_lights": Kind("count lights stand elsewhere in the image; those beyond them have new ids", (("count",),)),
    "hide": Kind("the first light of the image is missing"),
    "swap": Kind("the first two lights of the image, or stars of the exposure, bear each other's identity"),
    "wrong_id": Kind("the first light of the image, or the rover of a baseline, has an id that nobody knows"),
}

AXES = ("", "exchanged", "ned_frd")


@dataclass(frozen=True)
class Fault:
    """A fault of one topic that lasts for a time."""

    topic: str = parameter(doc="topic, for example ins/imu")
    kind: str = parameter(doc="what goes wrong", choices=tuple(KINDS))
    start_s: float = parameter(doc="from, after the start, by stamps", **MOMENT)
    end_s: float = parameter(_TO_THE_END_S, doc="to, after the start, by stamps; for good where not given", **MOMENT)
    share: float = parameter(1.0, doc="share of the messages of that time, drawn, that are hit", minimum=0.0, maximum=1)
    delay_s: float = parameter(0.0, doc="how late: delay, stamp_late; at most: reorder", **DELAY)
    step_s: float = parameter(0.0, doc="of the stamps: clock_step", unit="s", minimum=-1e9, maximum=1e9)
    field: str = parameter("", doc="of nan, infinite, corrupt, offset: orientation.x, covariance[4], stars[*].u")
    value: float = parameter(0.0, doc="of corrupt, offset, in the field's own unit", minimum=-1e300, maximum=1e300)
    axes: str = parameter("", doc="of axes", choices=AXES)
    north_arcsec: float = parameter(0.0, doc="turn about North: bias", **_STEP)
    up_arcsec: float = parameter(0.0, doc="turn about Up, or the device's up axis: bias, knock", **_STEP)
    east_arcsec: float = parameter(0.0, doc="turn about East: bias", **_STEP)
    forward_arcsec: float = parameter(0.0, doc="turn about the device's forward axis: knock", **_STEP)
    right_arcsec: float = parameter(0.0, doc="turn about the device's right axis: knock", **_STEP)
    azimuth_arcsec: float = parameter(0.0, doc="step of the azimuth encoder: slip", **_STEP)
    elevation_arcsec: float = parameter(0.0, doc="step of the elevation encoder: slip", **_STEP)
    forward_arcsec_per_min: float = parameter(0.0, doc="drift about the device's forward axis", **_RATE)
    up_arcsec_per_min: float = parameter(0.0, doc="drift about the device's up axis", **_RATE)
    right_arcsec_per_min: float = parameter(0.0, doc="drift about the device's right axis", **_RATE)
    azimuth_arcsec_per_min: float = parameter(0.0, doc="drift of the azimuth encoder", **_RATE)
    elevation_arcsec_per_min: float = parameter(0.0, doc="drift of the elevation encoder", **_RATE)
    east_m: float = parameter(0.0, doc="off to the East: position_off, wrong_fix", **_WAY)
    north_m: float = parameter(0.0, doc="off to the North: position_off, wrong_fix", **_WAY)
    up_m: float = parameter(0.0, doc="off upwards: position_off, wrong_fix", **_WAY)
    count: int = parameter(0, doc="spots of each message: false_stars, false_lights", minimum=0, maximum=1000)
    times: int = parameter(0, doc="messages for each one: flood", minimum=0, maximum=10_000)
    spread_s: float = parameter(2.0, doc="how far back the stamps of a flood go", **DELAY)

    @property
    def sizes(self) -> tuple[str, ...]:
        """The sizes that belong to its kind."""
        return KINDS[self.kind].sizes

    @property
    def window_text(self) -> str:
        """When the fault is active, in seconds after the first message, for people."""
        end = "the end" if self.end_s >= _TO_THE_END_S else f"{self.end_s:g} s"
        return f"from {self.start_s:g} s to {end}"


_DEFAULTS = {field.name: field.default for field in dataclasses.fields(Fault)}
_SIZES = tuple(name for name in _DEFAULTS if name not in ("topic", "kind", "start_s", "end_s", "share"))


def size_problems(key: str, fault: Fault) -> Iterator[ParameterError]:
    """What is wrong with the times and the sizes of a fault whose name in the file is ``key``."""
    if fault.end_s <= fault.start_s:
        name = f"{key}.end_s"
        yield ParameterError(f"'{name}' = {fault.end_s} s must be after start_s = {fault.start_s} s", name)
    kind = KINDS[fault.kind]
    for group in kind.needs:
        if all(getattr(fault, name) == _DEFAULTS[name] for name in group):
            wanted = " or ".join(group)
            yield ParameterError(f"'{key}' of kind {fault.kind} needs {wanted}", f"{key}.{group[0]}")
    for name in _SIZES:
        if name not in kind.sizes and getattr(fault, name) != _DEFAULTS[name]:
            owners = " and ".join(owner for owner, other in KINDS.items() if name in other.sizes)
            text = f"'{key}.{name}' is not used by kind {fault.kind}: it belongs to {owners}"
            yield ParameterError(text, f"{key}.{name}")


def kind_rows() -> list[str]:
    """The kinds of faults for people, one line each."""
    width = max(map(len, KINDS))
    rows = []
    for name, kind in KINDS.items():
        needed = "; needs " + ", ".join(" or ".join(group) for group in kind.needs) if kind.needs else ""
        rows.append(f"  {name:{width}}  {kind.doc}{needed}")
    return rows
