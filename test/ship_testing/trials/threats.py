"""Random faults of a voyage: threats, sizes, and times at which each fault begins and ends.

A threat is a kind of fault on one sort of topic, with realistic sizes. :data:`DATA_LIKE` contains faults that look like
data. :data:`BY_FORM` contains input that is malformed or wrong in time, which is possible on every topic but those of
the weather.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.names import FIRST_VALUE, is_applicable
from ship_simulation.scenario.scenario_file import numeric_fields

Sizes = dict[str, Any]
Draw = Callable[[np.random.Generator], Sizes]

SINGLE, OVERLAPPING = "single", "overlapping"

FIRST_START_S = 15.0
"""Earliest beginning of a fault, s; the filter has converged by then."""

SHORTEST_S, LONGEST_S = 6.0, 25.0
_MOST_FAULTS = 5
_LAST_START_BEFORE_END_S = 8.0

_INS, _STAR, _SHIP = r"ins/imu", r"star/\w+/(horizon_attitude|inertial_attitude|observations)", r"ship/attitude"
_REFERENCE, _BASELINE, _DRONE = r"reference/\w+/imu", r"beacon/\w+/baseline", r"beacon/\w+/imu"
_ENCODER, _LIGHTS, _FIX, _ANY = r"theodolite/encoder", r"theodolite/beacons", r"gnss/fix", r"(?!met/).*"


@dataclass(frozen=True)
class Threat:
    """One row of the table of threats.

    Attributes:
        label: name in tables.
        topics: pattern of the topics that the threat may affect.
        kind: kind of the fault.
        draw: function that draws the sizes of the fault.
        sigma: name of a size → standard deviation of one measurement; None if the threat is not a step.
        weight: relative frequency of the threat.
    """

    label: str
    topics: str
    kind: str
    draw: Draw = lambda rng: {}
    sigma: Mapping[str, float] | None = None
    weight: float = 1.0

    def sigmas(self, sizes: Sizes) -> float | None:
        """Return the largest size in sigmas of one measurement; None if the threat is not a step."""
        if self.sigma is None:
            return None
        return max(float(abs(sizes[name])) / sigma for name, sigma in self.sigma.items() if name in sizes)


def _size(names: tuple[str, ...], least: float, most: float) -> Draw:
    """Return a function that draws a value of one of the named sizes, log-uniform in magnitude, with random sign."""

    def draw(rng: np.random.Generator) -> Sizes:
        magnitude = float(np.exp(rng.uniform(np.log(least), np.log(most))))
        return {str(rng.choice(names)): round(float(rng.choice([-1.0, 1.0])) * magnitude, 4)}

    return draw


def _one_of(**choices: tuple[Any, ...]) -> Draw:
    return lambda rng: {name: values[int(rng.integers(len(values)))] for name, values in choices.items()}


_ACROSS = ("up_arcsec", "right_arcsec")
_TURNING = ("forward_arcsec_per_min", "up_arcsec_per_min", "right_arcsec_per_min")
_HORIZON = ("north_arcsec", "up_arcsec", "east_arcsec")
_DEVICE = ("forward_arcsec", "up_arcsec", "right_arcsec")
_VECTOR = ("east_m", "north_m", "up_m")


def _sigma_of_each(names: tuple[str, ...], sigma: float) -> dict[str, float]:
    return dict.fromkeys(names, sigma)


DATA_LIKE = (
    Threat("ins step", _INS, "bias", _size(_HORIZON, 5.0, 300.0), _sigma_of_each(_HORIZON, 1.0), 4.0),
    Threat("ins drift", _INS, "drift", _size(_TURNING, 10.0, 200.0), weight=2.0),
    Threat("ins frozen", _INS, "freeze"),
    Threat("ins axes", _INS, "axes", _one_of(axes=("exchanged", "ned_frd"))),
    Threat("ins clock", _INS, "clock_step", _size(("step_s",), 0.02, 1.0), weight=2.0),
    Threat("ins rates in degrees", _INS, "units"),
    Threat("star knock", _STAR, "knock", _size(_ACROSS, 10.0, 100.0), _sigma_of_each(_ACROSS, 3.0), 4.0),
    Threat("star drift", _STAR, "drift", _size(_TURNING[1:], 2.0, 30.0), weight=2.0),
    Threat("star frozen", _STAR, "freeze"),
    Threat("star clock", _STAR, "clock_step", _size(("step_s",), 0.05, 1.0)),
    Threat("false stars", _STAR, "false_stars", _one_of(count=(1, 2, 5)), weight=2.0),
    Threat("stars swapped", _STAR, "swap", weight=2.0),
    Threat("reference knock", _REFERENCE, "knock", _size(_DEVICE, 200.0, 3000.0), _sigma_of_each(_DEVICE, 60.0), 2.0),
    Threat("reference drift", _REFERENCE, "drift", _size(_TURNING, 60.0, 600.0)),
    Threat("reference frozen", _REFERENCE, "freeze"),
    Threat("reference clock", _REFERENCE, "clock_step", _size(("step_s",), 0.1, 2.0)),
    Threat("position off", _FIX, "position_off", _size(_VECTOR[:2], 300.0, 10_000.0), weight=2.0),
    Threat("air pressure off", "met/pressure", "offset", _one_of(field=("fluid_pressure",), value=(-3e3, 2e3))),
    Threat("ship step", _SHIP, "bias", _size(_HORIZON, 10.0, 300.0), _sigma_of_each(_HORIZON, 1.0), 4.0),
    Threat("ship drift", _SHIP, "drift", _size(_TURNING, 10.0, 200.0), weight=2.0),
    Threat("ship frozen", _SHIP, "freeze"),
    Threat("encoder slip", _ENCODER, "slip", _size(("azimuth_arcsec", "elevation_arcsec"), 20.0, 300.0),
           _sigma_of_each(("azimuth_arcsec", "elevation_arcsec"), 1.0), 4.0),
    Threat("encoder drift", _ENCODER, "drift",
           _size(("azimuth_arcsec_per_min", "elevation_arcsec_per_min"), 20.0, 300.0), weight=2.0),
    Threat("encoder frozen", _ENCODER, "freeze"),
    Threat("wrong fix", _BASELINE, "wrong_fix", _size(_VECTOR, 0.1, 3.0), _sigma_of_each(_VECTOR, 0.02), 4.0),
    Threat("baseline frozen", _BASELINE, "freeze"),
    Threat("drone knock", _DRONE, "knock", _size(_DEVICE, 3600.0, 36_000.0), weight=1.0),
    Threat("lights swapped", _LIGHTS, "swap"),
    Threat("false lights", _LIGHTS, "false_lights", _one_of(count=(1, 2, 3)), weight=2.0),
    Threat("light hidden", _LIGHTS, "hide"),
    Threat("telescope knock", _LIGHTS, "knock", _size(_ACROSS, 10.0, 300.0), _sigma_of_each(_ACROSS, 1.34), 2.0),
)  # fmt: skip
"""Faults that look like data."""

_VALUES = (0.0, -1.0, 1e-300, 1e6, -1e9, 1e300)

BY_FORM = (
    Threat("nan", _ANY, "nan"),
    Threat("infinite", _ANY, "infinite"),
    Threat("a value", _ANY, "corrupt", weight=3.0),
    Threat("stamp zero", _ANY, "stamp_zero"),
    Threat("stamp late", _ANY, "stamp_late", _one_of(delay_s=(0.03, 0.3, 3.0))),
    Threat("clock step", _ANY, "clock_step", _one_of(step_s=(-3600.0, -5.0, 5.0, 619_315_200.0))),
    Threat("frame", _ANY, "frame"),
    Threat("covariance unknown", _ANY, "covariance_unknown"),
    Threat("covariance negative", _ANY, "covariance_negative"),
    Threat("units", _ANY, "units"),
    Threat("axes", _ANY, "axes", _one_of(axes=("exchanged", "ned_frd"))),
    Threat("angles in degrees", _ANY, "angles_in_degrees"),
    Threat("silence", _ANY, "drop"),
    Threat("losses", _ANY, "drop", _one_of(share=(0.1, 0.5, 0.9))),
    Threat("delay", _ANY, "delay", _one_of(delay_s=(0.3, 1.0, 5.0))),
    Threat("reorder", _ANY, "reorder", _one_of(delay_s=(0.5, 1.5))),
    Threat("duplicate", _ANY, "duplicate"),
    Threat("conflict", _ANY, "conflict"),
    Threat("flood", _ANY, "flood", _one_of(times=(5, 20), spread_s=(2.0, 10.0))),
    Threat("wrong id", _ANY, "wrong_id"),
)
"""Faults of input that is malformed, or wrong in time."""

_SHARE_BY_FORM = 0.35


@dataclass(frozen=True)
class DrawnFault:
    """A fault of a voyage with its threat."""

    threat: Threat
    fault: Fault


def draw_faults(
    topics: Mapping[str, str], length_s: float, mode: str, return_after_s: float, rng: np.random.Generator
) -> list[DrawnFault]:
    """Draw up to five faults of a voyage, in order of their beginnings.

    In mode SINGLE, no fault is drawn if the voyage is too short. In mode OVERLAPPING, the voyage must have room for a
    fault.

    Args:
        topics: topic → type of the inputs that the nodes of the voyage use.
        length_s: length of the voyage.
        mode: SINGLE if a fault begins at least ``return_after_s`` after the end of the previous fault; OVERLAPPING if
            faults begin at any time.
        return_after_s: time after which an excluded source is reinstated.
        rng: random generator.
    """
    drawn: list[DrawnFault] = []
    start_s = FIRST_START_S + float(rng.uniform(0.0, 10.0))
    for _ in range(int(rng.integers(1, _MOST_FAULTS + 1))):
        if mode == OVERLAPPING:
            start_s = float(rng.uniform(FIRST_START_S, length_s - _LAST_START_BEFORE_END_S))
        if start_s > length_s - _LAST_START_BEFORE_END_S:
            break
        end_s = start_s + float(rng.uniform(SHORTEST_S, LONGEST_S))
        drawn.append(_draw_fault(topics, round(start_s, 3), round(end_s, 3), rng))
        start_s = end_s + return_after_s + float(rng.uniform(0.0, 5.0))
    return sorted(drawn, key=lambda one: one.fault.start_s)


def _draw_fault(topics: Mapping[str, str], start_s: float, end_s: float, rng: np.random.Generator) -> DrawnFault:
    """Draw a fault: first a threat that is possible with the topics, then the affected topic."""
    table = BY_FORM if rng.random() < _SHARE_BY_FORM else DATA_LIKE
    possible = [(threat, fitting) for threat in table if (fitting := _matching_topics(threat, topics))]
    weights = np.array([threat.weight for threat, _ in possible])
    threat, fitting = possible[int(rng.choice(len(possible), p=weights / weights.sum()))]
    topic = fitting[int(rng.integers(len(fitting)))]
    sizes = threat.draw(rng)
    if threat.kind in ("nan", "infinite", "corrupt"):
        sizes = _draw_field(threat.kind, topics[topic], rng)
    return DrawnFault(threat, Fault(topic=topic, kind=threat.kind, start_s=start_s, end_s=end_s, **sizes))


def _draw_field(kind: str, type_name: str, rng: np.random.Generator) -> Sizes:
    """Draw a numeric field of a message and, for ``corrupt``, a value within the range of the field."""
    fields = numeric_fields(type_name)
    floats = [path for path, base in fields.items() if base.startswith("float")]
    path = str(rng.choice(list(fields) if kind == "corrupt" else floats))
    if kind != "corrupt":
        return {"field": path}
    if path in floats:
        largest = float(np.finfo(fields[path]).max)
        return {"field": path, "value": max(min(float(rng.choice(_VALUES)), largest), -largest)}
    limits = np.iinfo(fields[path])
    return {"field": path, "value": float(rng.choice([0, 1, limits.min, limits.max]))}


def _matching_topics(threat: Threat, topics: Mapping[str, str]) -> list[str]:
    return [
        topic
        for topic, type_name in sorted(topics.items())
        if re.fullmatch(threat.topics, topic) and is_applicable(threat.kind, type_name) and type_name in FIRST_VALUE
    ]
