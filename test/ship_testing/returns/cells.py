"""Cells of the return matrix: the faults of each, and the time from which all inputs are consistent.

Every kind of fault is combined with every topic to which it applies, for several durations, and once with nodes that
start during the fault. Further cells have clock steps, overlapping pairs of faults and random sequences. The list is
the same in every run.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ship_simulation.random_draws import random_stream
from ship_simulation.scenario.fault import KINDS, Fault
from ship_simulation.scenario.names import (
    BASELINE,
    DEFLECTION,
    ENCODER,
    FIRST_VALUE,
    FIX,
    HUMIDITY,
    IMAGE,
    IMAGE_TOPIC,
    IMU,
    INERTIAL,
    OBSERVATIONS,
    PRESSURE,
    SHIP_ATTITUDE,
    STAR,
    TARGET,
    TEMPERATURE,
    is_applicable,
)
from ship_testing.returns.voyages import VOYAGES, VoyageData
from ship_testing.trials.threats import OVERLAPPING, draw_faults

START_S = 40.0
"""Start of the first fault after the beginning of the voyage, in all cells but random histories, s."""

DURATIONS_S = (0.4, 4.0, 30.0, 120.0)
STEPS_S = (0.1, -0.1, 1.0, -1.0, 18.0, -18.0, 300.0, -300.0, 900.0, -900.0)
PAIRS, HISTORIES = 200, 200
_MIDDLE_S, _STEP_LASTS_S = 30.0, 30.0
_HISTORY_S = 140.0

FIX_TOPIC = "gnss/fix"
STARTS, CLOCKS, TIME_BASE = "start in the middle", "clocks of a device or a group", "time base"
PAIR, HISTORY = "overlapping pair", "random history"

_SIZES: dict[str, dict[str, Any]] = {
    "delay": {"delay_s": 5.0},
    "reorder": {"delay_s": 1.5},
    "flood": {"times": 10},
    "stamp_late": {"delay_s": 0.3},
    "clock_step": {"step_s": 0.5},
    "axes": {"axes": "exchanged"},
    "bias": {"up_arcsec": 100.0},
    "position_off": {"east_m": 3000.0},
    "knock": {"up_arcsec": 100.0},
    "drift": {"up_arcsec_per_min": 60.0},
    "slip": {"azimuth_arcsec": 100.0},
    "wrong_fix": {"east_m": 1.0},
    "false_stars": {"count": 5},
    "false_lights": {"count": 2},
}
"""Kind → its sizes, which are clearly visible; :func:`sizes_of` adds ``offset`` and ``corrupt``; others need none."""

_OFFSETS = {
    IMU: 1e-3,
    INERTIAL: 1e-3,
    STAR: 1e-3,
    OBSERVATIONS: 5.0,
    SHIP_ATTITUDE: 1e-3,
    ENCODER: 1e-3,
    IMAGE: 1e-4,
    BASELINE: 1.0,
    TARGET: 1e-3,
    FIX: 0.01,
    PRESSURE: -3000.0,
    TEMPERATURE: 10.0,
    HUMIDITY: 0.3,
    DEFLECTION: 1e-4,
}
"""Message type → offset of the field that :data:`FIRST_VALUE` names, in the unit of the field."""

_CORRUPT_VALUE = 0.25
_COARSE = {"reference/": 30.0, "beacon/": 300.0}
"""Beginning of a topic → factor on arcsecond sizes, for devices whose attitude is less accurate than that of stars."""

POSITION_FROM_START = "a position that is wrong from the start"
COMMON_CLOCK_STEP = "one clock of the INS and all stars: two faults that agree"
IMAGE_MOVED = "an image that drifts on the detector (N′), or is off from the start: it looks like encoders that do so"
SMALL_SLIP = "an encoder that slips by less than its readings show, until the second exposure after it"
_SLIP_SEEN_ARCSEC = 50.0
"""Encoder slip above which the 10 Hz readings of a sweeping mount show the slip, arcsec."""
_POSITION_FAULTS = ("offset", "corrupt", "position_off", "units")
_INS_AND_STARS = "ins and stars"

_GROUPS: dict[str, tuple[str, ...]] = {
    "all stars": ("star/",),
    _INS_AND_STARS: ("ins/", "star/"),
    "stars and references": ("star/", "reference/"),
    "ins and references": ("ins/", "reference/"),
    "encoder and lights": ("theodolite/",),
    "ship and encoder": ("ship/", "theodolite/encoder"),
    "drones": ("beacon/",),
    "drones and lights": ("beacon/", "theodolite/beacons"),
    "all devices but the ship": ("beacon/", "theodolite/"),
}
"""Name → beginnings of the topics whose clocks step together."""


@dataclass(frozen=True)
class ClockStep:
    """A step of the time base: all stamps and the computer's clock are shifted from a time on.

    Attributes:
        at_s: time after the beginning of the voyage.
        step_s: size; the shift at a time is the sum of all steps until then.
    """

    at_s: float
    step_s: float


@dataclass(frozen=True)
class Cell:
    """One case of the matrix.

    Attributes:
        number: place in the list; seed of the random numbers of its faults.
        voyage: name of the voyage.
        row: row of the table: a kind of fault, or a set of cells.
        name: of the cell, for people.
        faults: of the inputs.
        steps: of the time base.
        undetectable_reason: why the faults cannot be detected from the data; empty if they can.
        node_starts_s: time after the beginning of the voyage at which the nodes get their first input.
    """

    number: int
    voyage: str
    row: str
    name: str
    faults: tuple[Fault, ...] = ()
    steps: tuple[ClockStep, ...] = ()
    undetectable_reason: str = ""
    node_starts_s: float = 0.0

    @property
    def key(self) -> tuple[int, str]:
        """Return the key of the cell's result."""
        return self.number, self.name

    @property
    def starts_s(self) -> float:
        """Return the time at which the first input is wrong, s."""
        return min([fault.start_s for fault in self.faults] + [step.at_s for step in self.steps])

    @property
    def consistent_from_s(self) -> float:
        """Return the time from which all inputs are consistent, s: last end of a fault (with delay) or clock step."""
        ends_s = [fault.end_s + (fault.delay_s if fault.kind in ("delay", "reorder") else 0.0) for fault in self.faults]
        return max(ends_s + [step.at_s for step in self.steps])


def sizes_of(kind: str, topic: str, type_name: str) -> dict[str, Any]:
    """Return the sizes of a kind of fault on a topic."""
    if kind == "offset":
        return {"field": FIRST_VALUE[type_name], "value": _OFFSETS[type_name]}
    if kind == "corrupt":
        return {"field": FIRST_VALUE[type_name], "value": _CORRUPT_VALUE}
    sizes = dict(_SIZES.get(kind, {}))
    if kind == "drift" and type_name == ENCODER:
        sizes = {"azimuth_arcsec_per_min": sizes["up_arcsec_per_min"]}
    factor = next((factor for start, factor in _COARSE.items() if topic.startswith(start)), 1.0)
    return {name: value * factor if "arcsec" in name else value for name, value in sizes.items()}


def all_cells(voyages: Mapping[str, VoyageData]) -> list[Cell]:
    """Return all cells of the matrix, each with its number."""
    found: list[Cell] = []
    for draft in itertools.chain(
        _single_faults(voyages),
        _node_starts(voyages),
        _clocks(voyages),
        _time_bases(),
        _pairs(voyages),
        _histories(voyages),
    ):
        from_start = "node_starts_s" in draft
        undetectable_reason = draft.pop("unseen", "") or _undetectable_class(draft.get("faults", ()), from_start)
        found.append(Cell(len(found), undetectable_reason=undetectable_reason, **draft))
    return found


def _undetectable_class(faults: Sequence[Fault], from_start: bool) -> str:
    """Return the class of the first undetectable fault; empty if all faults are detectable."""
    for fault in faults:
        if from_start and fault.topic == FIX_TOPIC and fault.kind in _POSITION_FAULTS:
            return POSITION_FROM_START
        if fault.topic == IMAGE_TOPIC and (fault.kind == "drift" or (from_start and fault.kind == "knock")):
            return IMAGE_MOVED
        if fault.kind == "slip" and max(abs(fault.azimuth_arcsec), abs(fault.elevation_arcsec)) < _SLIP_SEEN_ARCSEC:
            return SMALL_SLIP
    return ""


def sample_cells(cells: Sequence[Cell], count: int) -> list[Cell]:
    """Return a seeded sample of cells; a larger sample begins with the cells of each smaller sample."""
    chosen = random_stream(1, "returns.sample").permutation(len(cells))[:count]
    return [cells[place] for place in chosen.tolist()]


Draft = dict[str, Any]


def _kinds(voyages: Mapping[str, VoyageData]) -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    """Yield voyage, kind, topic and sizes of every kind of fault on every topic of :func:`_own_topics` that it fits."""
    for voyage, data in voyages.items():
        for topic, kind in itertools.product(_own_topics(voyage, data), KINDS):
            type_name = data.topics[topic]
            if is_applicable(kind, type_name):
                yield voyage, kind, topic, sizes_of(kind, topic, type_name)


_OWN_TOPICS = {
    "tracker": ("star/starboard/", "gnss/", "gravity/"),
    "mount": ("theodolite/night/", "theodolite/target", "gnss/"),
}
"""Voyage → beginnings of the topics that have single faults; the voyage's other topics have theirs in other voyages."""


def _own_topics(voyage: str, data: VoyageData) -> list[str]:
    """Return the topics of a voyage that have single faults; all topics if the voyage is not in ``_OWN_TOPICS``."""
    return [topic for topic in sorted(data.topics) if topic.startswith(_OWN_TOPICS.get(voyage, ""))]


def _single_faults(voyages: Mapping[str, VoyageData]) -> Iterator[Draft]:
    for voyage, kind, topic, sizes in _kinds(voyages):
        for lasts_s in DURATIONS_S:
            fault = Fault(topic=topic, kind=kind, start_s=START_S, end_s=START_S + lasts_s, **sizes)
            yield {"voyage": voyage, "row": kind, "name": f"{voyage}: {kind} {topic} {lasts_s:g} s", "faults": (fault,)}


def _node_starts(voyages: Mapping[str, VoyageData]) -> Iterator[Draft]:
    for voyage, kind, topic, sizes in _kinds(voyages):
        fault = Fault(topic=topic, kind=kind, start_s=START_S, end_s=START_S + _MIDDLE_S, **sizes)
        yield {
            "voyage": voyage,
            "row": STARTS,
            "name": f"{voyage}: {kind} {topic}, node starts after {_MIDDLE_S / 2.0:g} of {_MIDDLE_S:g} s",
            "faults": (fault,),
            "node_starts_s": START_S + _MIDDLE_S / 2.0,
        }


def _clocks(voyages: Mapping[str, VoyageData]) -> Iterator[Draft]:
    """Return cells in which the clock of one topic or of a group of topics steps, and later steps back."""
    for voyage, data in voyages.items():
        devices = {topic: (topic,) for topic in _own_topics(voyage, data)}
        for name, beginnings in _GROUPS.items():
            members = tuple(topic for topic in sorted(data.topics) if topic.startswith(beginnings))
            if 1 < len(members) < len(data.topics) and members not in devices.values():
                devices[name] = members
        for (name, members), step_s in itertools.product(devices.items(), STEPS_S):
            faults = tuple(
                Fault(topic=topic, kind="clock_step", start_s=START_S, end_s=START_S + _STEP_LASTS_S, step_s=step_s)
                for topic in members
            )
            yield {
                "voyage": voyage,
                "row": CLOCKS,
                "name": f"{voyage}: clock {name} {step_s:+g} s and back",
                "faults": faults,
                "unseen": COMMON_CLOCK_STEP if name == _INS_AND_STARS else "",
            }


_BY_UTC = ("sky", "tracker", "mount")
"""Voyages with star directions in the sky: after a permanent step, the stars contradict UTC permanently."""


def _time_bases() -> Iterator[Draft]:
    for voyage, step_s in itertools.product(VOYAGES, STEPS_S):
        there, back = ClockStep(START_S, step_s), ClockStep(START_S + _STEP_LASTS_S, -step_s)
        name = f"{voyage}: time base {step_s:+g} s"
        yield {"voyage": voyage, "row": TIME_BASE, "name": f"{name} and back", "steps": (there, back)}
        if voyage not in _BY_UTC:
            yield {"voyage": voyage, "row": TIME_BASE, "name": f"{name} for good", "steps": (there,)}


def _pairs(voyages: Mapping[str, VoyageData]) -> Iterator[Draft]:
    """Return cells with two faults, of which the second begins during the first."""
    kinds = list(_kinds(voyages))
    for number in range(PAIRS):
        rng = random_stream(number, "returns.pair")
        first = kinds[int(rng.integers(len(kinds)))]
        others = [other for other in kinds if other[0] == first[0] and other[1:3] != first[1:3]]
        second = others[int(rng.integers(len(others)))]
        lasts_s = rng.choice(DURATIONS_S[1:], 2).tolist()
        starts_s = START_S, START_S + round(float(rng.uniform(0.0, lasts_s[0])), 3)
        faults = tuple(
            Fault(topic=topic, kind=kind, start_s=start_s, end_s=start_s + length_s, **sizes)
            for (_, kind, topic, sizes), start_s, length_s in zip((first, second), starts_s, lasts_s, strict=True)
        )
        yield {"voyage": first[0], "row": PAIR, "name": f"{first[0]}: {_faults_text(faults)}", "faults": faults}


def _histories(voyages: Mapping[str, VoyageData]) -> Iterator[Draft]:
    names = list(voyages)
    for number in range(HISTORIES):
        voyage = names[number % len(names)]
        rng = random_stream(number, "returns.history")
        drawn = draw_faults(voyages[voyage].topics, _HISTORY_S, OVERLAPPING, math.nan, rng)
        faults = tuple(one.fault for one in drawn)
        yield {
            "voyage": voyage,
            "row": HISTORY,
            "name": f"{voyage}: history {number}: {_faults_text(faults)}",
            "faults": faults,
        }


def _faults_text(faults: Sequence[Fault]) -> str:
    return " + ".join(f"{one.kind} {one.topic} {one.start_s:g}-{one.end_s:g} s" for one in faults)
