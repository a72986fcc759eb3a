"""Angles of a suite against the ship's limits: inputs of their safety, hysteresis, and time over the limit."""

import math
from collections.abc import Sequence
from dataclasses import replace

from ship_watch.safety.limits import Limits
from ship_watch.safety.outputs import AttitudeRecord, OutputRecord, PointingRecord
from ship_watch.safety.safety import AngleInputs, SafetyHysteresis, TimeOverLimit, angle_safety
from ship_watch.sources.overload import OverloadedNodes
from ship_watch.sources.sources import SourceRecords, first_faulty_source
from ship_watch.suite_state import ANGLES, CAUSE_NODE, AngleState, Safety, SourceState

_SHIP_SOURCES = ("ins", "star", "reference", "gnss", "weather")
_POINTING_SOURCES = ("encoder", "lights", "baselines", "ship_attitude")
_SHIP_REQUIRED = ("ins", "star", "reference")
_POINTING_REQUIRED = ("encoder", "ship_attitude")
"""``_SHIP_REQUIRED`` and ``_POINTING_REQUIRED`` are the kinds of sources that an output requires. Without a source of
another kind only the quality is reduced."""


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
        ship = first_faulty_source(sources, _SHIP_SOURCES if self._attitude.is_available(now_ns) else _SHIP_REQUIRED)
        inputs_by_angle = {name: self._inputs_of_angle(name, ship, now_ns) for name in ANGLES[:3]}
        if self._pointing.is_received or self._sources.has_theodolite:
            needed = _POINTING_SOURCES if self._pointing.is_available(now_ns) else _POINTING_REQUIRED
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
