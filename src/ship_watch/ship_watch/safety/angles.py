"""Angles of a suite against the ship's limits, from the last messages of the two outputs with angles.

The outputs are ``ship/attitude`` and ``theodolite/pointing``. From their messages follow the inputs of the safety of
each angle, its hysteresis, and the time over the limit.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from ship_estimation.integrity.protection_levels import NORMAL_95, IntegrityState
from ship_estimation.time_order.outcome import Status
from ship_watch.safety.functions import SHIP_SOURCES, THEODOLITE_SOURCES
from ship_watch.safety.limits import Limits
from ship_watch.safety.safety import AngleInputs, AngleProtection, SafetyHysteresis, TimeOverLimit, angle_safety
from ship_watch.sources.sources import OverloadedNodes, SourceRecords, first_faulty_source
from ship_watch.suite_state import ANGLES, CAUSE_NODE, AngleState, Safety, SourceState

INTEGRITY_AGE_NS = 3_000_000_000
"""Minimum of the age limit of an Integrity message, ns. The limit is three message periods if these are longer."""

_INVALID_PERIOD_NS = 1_000_000_000
"""Period at which an output is published while it is INVALID, ns."""

_STATUSES = {int(status): status for status in Status}
_INTEGRITY_STATES = {int(state): state for state in IntegrityState}
_HORIZONS = {0: "geodetic", 1: "gravity"}
_ONE_LIGHT, _ENCODER = 1, 2
_STARS, _STARS_AND_LIGHTS = 3, 4
_COUNTS = {2: "two", 3: "three", 4: "four"}

_SHIP_REQUIRED = ("ins", "star", "reference")
_POINTING_REQUIRED = ("encoder", "ship_attitude")
"""Kinds of sources that each output requires; without a source of another kind only the quality is reduced."""


class OutputRecord:
    """Last message of an output, with its last Integrity message.

    Args:
        max_age_s: age above which the output is old, s.

    Attributes:
        values: angle → value, rad.
        accuracies_95: angle → 1.96 sigma, rad.
        status: status of the last message; None before the first message, and for an unknown status number.
        stamp_ns: UTC of the last message; 0 before the first message.
    """

    topic: ClassVar[str]
    quantities: ClassVar[dict[str, str]]
    """Angle → its name in Integrity messages."""

    def __init__(self, max_age_s: float) -> None:
        self._max_age_ns = round(max_age_s * 1e9)
        self._arrived_ns: int | None = None
        self.values: dict[str, float] = {}
        self.accuracies_95: dict[str, float] = {}
        self.status: Status | None = None
        self.stamp_ns = 0
        self._protection: dict[str, AngleProtection] = {}
        self._integrity_ns: int | None = None
        self._integrity_age_ns = INTEGRITY_AGE_NS

    @property
    def is_received(self) -> bool:
        """True if the output was received at least once."""
        return self._arrived_ns is not None

    def age_s(self, now_ns: int) -> float:
        """Return the time since the last message, s; infinite before the first message."""
        return math.inf if self._arrived_ns is None else max(0, now_ns - self._arrived_ns) * 1e-9

    def is_old(self, now_ns: int) -> bool:
        """True if the last message is older than the age limit, or if there is no message."""
        # An INVALID output is published only once a second.
        longest_ns = self._max_age_ns + (_INVALID_PERIOD_NS if self.status is Status.INVALID else 0)
        return self._arrived_ns is None or now_ns - self._arrived_ns >= longest_ns

    def is_available(self, now_ns: int) -> bool:
        """True if the output is neither old nor INVALID."""
        return self.status not in (None, Status.INVALID) and not self.is_old(now_ns)

    def protection(self, angle: str, now_ns: int) -> AngleProtection:
        """Return the protection level of an angle from the last Integrity message; state None if it is too old."""
        if self._integrity_ns is None or now_ns - self._integrity_ns > self._integrity_age_ns:
            return AngleProtection(None)
        return self._protection.get(angle, AngleProtection(None))

    def record_integrity(self, message: Any, now_ns: int) -> None:
        """Record an Integrity message."""
        if self._integrity_ns is not None:
            self._integrity_age_ns = max(INTEGRITY_AGE_NS, 3 * (now_ns - self._integrity_ns))
        self._integrity_ns = now_ns
        places = {str(name): place for place, name in enumerate(message.quantities)}
        state = _INTEGRITY_STATES.get(int(message.state))
        levels, limits = list(map(float, message.protection_level)), list(map(float, message.alert_limit))
        self._protection = {
            angle: AngleProtection(state, levels[places[quantity]], limits[places[quantity]])
            for angle, quantity in self.quantities.items()
            if places.get(quantity, math.inf) < min(len(levels), len(limits))
        }

    def record(self, message: Any, stamp_ns: int, now_ns: int) -> list[tuple[str, str]]:
        """Record a message of the output; return the changes: kind of event and text."""
        raise NotImplementedError

    def diagnosis_hint(self, now_ns: int, beacon_count: int) -> str:
        """Return the cause of a reduced accuracy, from the fields of the output; empty if no cause is known."""
        raise NotImplementedError

    def has_reduced_input(self, beacon_count: int) -> bool:
        """True if the output uses only one light although several are configured; always False for the attitude."""
        return False

    def _record_common(self, message: Any, stamp_ns: int, now_ns: int) -> list[tuple[str, str]]:
        """Record the fields common to both outputs; return the changes as :meth:`record` does."""
        # A repetition has the stamp and status of the last message, and does not renew the arrival time.
        status = _STATUSES.get(int(message.status))
        if stamp_ns != self.stamp_ns or status is not self.status:
            self._arrived_ns = now_ns
        changes = []
        if self.stamp_ns and status is not self.status:
            changes.append(("status", f"{self.topic} {_status_name(self.status)} → {_status_name(status)}"))
        self.status, self.stamp_ns = status, stamp_ns
        return changes


class AttitudeRecord(OutputRecord):
    """``ship/attitude``: heading, pitch and roll."""

    topic: ClassVar[str] = "ship/attitude"
    quantities: ClassVar[dict[str, str]] = {name: name for name in ("heading", "pitch", "roll")}

    def __init__(self, limits: Limits) -> None:
        super().__init__(limits.attitude_age_s)
        self.horizon = ""
        self._star_age_s = math.inf
        self._uses_ins = False

    def record(self, message: Any, stamp_ns: int, now_ns: int) -> list[tuple[str, str]]:
        """Record a ShipAttitude; return the changes."""
        covariance = message.covariance
        self.values = {name: float(getattr(message, name)) for name in self.quantities}
        self.accuracies_95 = {name: _accuracy_95(covariance[4 * i]) for i, name in enumerate(self.quantities)}
        star_age_s = float(message.star_age_s)
        self._star_age_s = star_age_s if math.isfinite(star_age_s) else math.inf
        self._uses_ins = "ins" in message.sources
        horizon, before = _HORIZONS.get(int(message.horizon), ""), self.horizon
        changes = self._record_common(message, stamp_ns, now_ns)
        if before and horizon != before and self.status is not Status.INVALID:
            changes.append(("mode", f"horizon {before} → {horizon}"))
        self.horizon = horizon
        return changes

    def star_age_s(self, now_ns: int) -> float:
        """Return the time since the last used star attitude, s; infinite before the first."""
        return self._star_age_s + (self.age_s(now_ns) if self.is_received else 0.0)

    def ins_age_s(self, reported_s: float, now_ns: int) -> float:
        """Return the time since the last INS sample, s.

        While the INS is used, each INS sample leads to an attitude, so the age of the attitude is an upper bound.

        Args:
            reported_s: time since the last INS sample according to the reports of the node, s.
            now_ns: current time.
        """
        return min(reported_s, self.age_s(now_ns)) if self._uses_ins else reported_s

    def diagnosis_hint(self, now_ns: int, beacon_count: int) -> str:
        """Return the time without stars, as text; empty unless the attitude is COASTING or no star was ever used."""
        age_s = self.star_age_s(now_ns)
        if math.isinf(age_s):
            return "no stars yet"
        return f"no stars for {age_s:.0f} s" if self.status is Status.COASTING else ""


class PointingRecord(OutputRecord):
    """``theodolite/pointing``: azimuth and elevation of the main axis."""

    topic: ClassVar[str] = "theodolite/pointing"
    quantities: ClassVar[dict[str, str]] = {"azimuth": "azimuth_cos_elevation", "elevation": "elevation"}

    def __init__(self, limits: Limits) -> None:
        super().__init__(limits.pointing_age_s)
        self._mode, self._lights = _ENCODER, 0

    @property
    def pointing_method(self) -> str:
        """Method of the pointing, for people, such as "2 lights" or "no pointing"; empty before the first message."""
        if not self.is_received:
            return ""
        if self.status is Status.INVALID:
            return "no pointing"
        lights = f"{self._lights} light{'s' if self._lights > 1 else ''}"
        texts = {_ENCODER: "encoder", _STARS: "stars", _STARS_AND_LIGHTS: f"stars, {lights}"}
        return texts.get(self._mode, lights)

    def record(self, message: Any, stamp_ns: int, now_ns: int) -> list[tuple[str, str]]:
        """Record an OpticalAxisPointing; return the changes."""
        azimuth, elevation = float(message.azimuth), float(message.elevation)
        self.values = {"azimuth": azimuth, "elevation": elevation}
        self.accuracies_95 = {
            "azimuth": _accuracy_95(message.covariance[0]) * abs(float(np.cos(elevation))),
            "elevation": _accuracy_95(message.covariance[4]),
        }
        before = self.pointing_method
        self._mode, self._lights = int(message.mode), int(message.light_count)
        changes = self._record_common(message, stamp_ns, now_ns)
        if before and self.pointing_method != before:
            changes.append(("mode", f"pointing by {before} → {self.pointing_method}"))
        return changes

    def diagnosis_hint(self, now_ns: int, beacon_count: int) -> str:
        """Return a text if only one of several lights is used, or if the mode is the encoder; empty otherwise."""
        if self.has_reduced_input(beacon_count):
            return f"one of {_COUNTS.get(beacon_count, beacon_count)} lights used"
        return "no lights" if self._mode == _ENCODER else ""

    def has_reduced_input(self, beacon_count: int) -> bool:
        """True if only one light is used although several are configured."""
        return self._mode == _ONE_LIGHT and beacon_count > 1


def _accuracy_95(variance: float) -> float:
    """Return 1.96 sigma; NaN for an invalid variance, and for zero, which means "not given" in ROS messages."""
    return NORMAL_95 * math.sqrt(variance) if variance > 0.0 else math.nan


def _status_name(status: Status | None) -> str:
    return "unknown" if status is None else status.name


class Angles:
    """Safety of all angles of a suite.

    Args:
        limits: limits of the ship.
        attitude: record of the ship's attitude.
        pointing: record of the pointing.
        sources: records of the sources.
        overload: nodes that are overloaded.
    """

    def __init__(
        self,
        limits: Limits,
        attitude: AttitudeRecord,
        pointing: PointingRecord,
        sources: SourceRecords,
        overload: OverloadedNodes,
    ) -> None:
        self._limits, self._attitude, self._pointing = limits, attitude, pointing
        self._sources, self._overload = sources, overload
        self._safety = {name: SafetyHysteresis(limits.better_after_s) for name in ANGLES}
        self._time_over_limit = {name: TimeOverLimit() for name in ANGLES}

    def update(self, sources: Sequence[SourceState], now_ns: int) -> dict[str, tuple[Safety, str]]:
        """Update hysteresis and time over the limit; return the displayed safety and reason of each received angle."""
        safety_by_angle: dict[str, tuple[Safety, str]] = {}
        for name, inputs in self.inputs(sources, now_ns).items():
            self._time_over_limit[name].update(inputs, now_ns)
            if self.output(name).is_received:
                now = angle_safety(inputs)
                self._safety[name].update(now, now_ns)
                displayed = self._safety[name].displayed_safety(now, now_ns)
                safety_by_angle[name] = displayed.safety, displayed.reason(now, inputs.limit)
        return safety_by_angle

    def inputs(self, sources: Sequence[SourceState], now_ns: int) -> dict[str, AngleInputs]:
        """Return the data for the safety of each angle; angles of a theodolite only if the suite has one.

        If an output is old and a node has stopped reporting, the node is the cause and no faulty source is given.
        """
        has_node_stopped = any(source.because_of == CAUSE_NODE for source in sources)
        ship = first_faulty_source(sources, SHIP_SOURCES if self._attitude.is_available(now_ns) else _SHIP_REQUIRED)
        inputs_by_angle = {name: self._inputs_of_angle(name, ship, now_ns) for name in ANGLES[:3]}
        if self._pointing.is_received or self._sources.has_theodolite:
            needed = THEODOLITE_SOURCES if self._pointing.is_available(now_ns) else _POINTING_REQUIRED
            faulty_source = first_faulty_source(sources, needed) or ship
            inputs_by_angle |= {name: self._inputs_of_angle(name, faulty_source, now_ns) for name in ANGLES[3:]}
        if has_node_stopped:
            inputs_by_angle = {
                name: replace(inputs, faulty_source=None) if inputs.is_old else inputs
                for name, inputs in inputs_by_angle.items()
            }
        return inputs_by_angle

    def _inputs_of_angle(self, name: str, faulty_source: SourceState | None, now_ns: int) -> AngleInputs:
        output, beacons = self.output(name), self._sources.beacon_count
        behind = self._overload.overload_text(
            now_ns, output is self._pointing, self._sources.is_reported(self._attitude.topic)
        )
        return AngleInputs(
            topic=output.topic,
            is_received=output.is_received,
            is_old=output.is_old(now_ns),
            value=output.values.get(name, math.nan),
            accuracy_95=output.accuracies_95.get(name, math.nan),
            limit=self._limits.angle_limit(name),
            unsafe_factor=self._limits.unsafe_factor,
            status=output.status,
            diagnosis_hint=output.diagnosis_hint(now_ns, beacons),
            has_reduced_input=output.has_reduced_input(beacons),
            protection=output.protection(name, now_ns),
            faulty_source=None if behind else faulty_source,
            overload=behind,
        )

    def state(self, name: str, inputs: AngleInputs, now_ns: int, utc_offset_ns: int) -> AngleState:
        """Return the state of an angle; ``utc_offset_ns`` is the suite's time minus the caller's time."""
        output, hysteresis, now = self.output(name), self._safety[name], angle_safety(inputs)
        displayed = hysteresis.displayed_safety(now, now_ns)
        safety, is_held = displayed.safety, hysteresis.safety is displayed.safety
        return AngleState(
            name=name,
            value=inputs.value,
            accuracy_95=inputs.accuracy_95,
            limit=inputs.limit,
            protection_level=inputs.protection.level,
            safety=safety,
            reason=displayed.reason(now, inputs.limit),
            age_s=output.age_s(now_ns),
            is_old=inputs.is_old,
            stamp_ns=output.stamp_ns,
            since_ns=(hysteresis.since_ns if is_held else now_ns) + utc_offset_ns if inputs.is_received else 0,
            because_of=inputs.faulty_source.name
            if inputs.faulty_source is not None and safety is not Safety.SAFE
            else "",
            over_limit_s=self._time_over_limit[name].duration_s(now_ns),
            unheld_safety=(now.safety, now.reason),
        )

    def output(self, name: str) -> OutputRecord:
        """Return the output that contains an angle."""
        return self._attitude if name in ANGLES[:3] else self._pointing
