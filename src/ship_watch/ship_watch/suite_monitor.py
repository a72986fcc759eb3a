"""State of a suite at any time, from its messages, with the suite's time and the log of changes.

The caller passes each message to :meth:`SuiteMonitor.process_message` and gets the state from
:meth:`SuiteMonitor.current_state`. The caller also passes the arrival times: times of a steady clock for live messages,
log times for a bag. Safety and events are evaluated ten times per second of this time, independent of requests for the
state. Therefore a bag gives the same events as the live messages. Events are sources that go OUT or IN, alerts, nodes
that start, and changes of safety, status and mode.
"""

import functools
import re
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import Status
from ship_watch.history.history import History
from ship_watch.history.history_recorder import HistoryRecorder
from ship_watch.published_state import PublishedState, alerts_from_message, published_state
from ship_watch.safety.angles import Angles, AttitudeRecord, OutputRecord, PointingRecord
from ship_watch.safety.limits import Limits
from ship_watch.safety.safety import COUNTDOWN
from ship_watch.sources.source_history import MountingShifts
from ship_watch.sources.sources import STAR_INNOVATION, OverloadedNodes, SourceRecords, newest_age_s
from ship_watch.suite_state import (
    ANGLES,
    AlertEntry,
    Event,
    Presence,
    Safety,
    SourceDetails,
    SourceState,
    SuiteState,
)
from ship_watch.topics import has_room, monitored_topic, reading_node, source_of_topic

CLOCK_TOLERANCE_NS = NS_PER_S // 10
"""Maximum delay, behind the suite's time, of a stamp that confirms this time, ns.

The stamp is that of an output or InputHealth.
"""

CLOCK_TIMEOUT_NS = 5 * NS_PER_S
"""Time without a confirming stamp after which the suite's time is set again, ns."""


MAX_EVENTS = 200
"""Number of events that are kept."""

START_UP_NS = 3 * NS_PER_S
"""Time after the start of monitoring, and after a reported start of a node, without reports of further starts, ns."""

_NUMBER = re.compile(r"\d+ ")
_ALERT_STATE_TEXTS = {0: "over", 1: "raised", 2: "silenced", 3: "acknowledged", 4: "rectified, not acknowledged"}
"""State of an alert, as in ship_msgs/Alert → its text."""

EVALUATION_PERIOD_NS = 100_000_000
"""Period at which safety and events are evaluated, ns."""

MAX_GAP_NS = 120 * NS_PER_S
"""Longest part of a gap without messages that is evaluated, ns.

Of a longer gap only the end is evaluated, because all ages are then over their limits.
"""

TIME_JUMP_NS = NS_PER_S
"""Step back of an output's stamp that resets all except the alerts, ns, as when a bag is played in a loop."""


class SuiteTime:
    """The suite's time: stamp of the output or InputHealth with the least delay, plus the time since then.

    If the stamps of all these messages stay behind this time for some seconds, that stamp was wrong or the clock was
    set. The suite's time is then set again.

    Attributes:
        utc_offset_ns: suite's time minus the caller's time.
    """

    def __init__(self) -> None:
        self._newest_ns, self.utc_offset_ns, self._confirmed_ns = 0, 0, 0

    @property
    def is_known(self) -> bool:
        """True after the first stamp."""
        return self._newest_ns != 0

    def utc_ns(self, now_ns: int) -> int:
        """Return the suite's time at a time of the caller."""
        return now_ns + self.utc_offset_ns

    def update(self, stamp_ns: int, now_ns: int) -> None:
        """Update the suite's time by the stamp of a message that arrives now."""
        offset_ns = stamp_ns - now_ns
        if offset_ns > self.utc_offset_ns or not self._newest_ns or now_ns - self._confirmed_ns > CLOCK_TIMEOUT_NS:
            self.utc_offset_ns, self._confirmed_ns = offset_ns, now_ns
        elif offset_ns > self.utc_offset_ns - CLOCK_TOLERANCE_NS:
            self._confirmed_ns = now_ns
        self._newest_ns = max(self._newest_ns, stamp_ns)


class EventLog:
    """Events of a suite, the newest first."""

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._presence: dict[str, tuple[Presence, str]] = {}

    def add(self, kind: str, subject: str, text: str, utc_ns: int) -> None:
        """Add a change; see :class:`~ship_watch.suite_state.Event`."""
        self.events.appendleft(Event(utc_ns, kind, subject, text))

    def add_node_start(self, node: str, utc_ns: int) -> None:
        """Add the start of a node, unless a start of any node was added shortly before: a node has several topics."""
        is_reported = any(event.kind == "node" and utc_ns - event.utc_ns < START_UP_NS for event in self.events)
        if not is_reported:
            self.add("node", node, f"{node} started", utc_ns)

    def add_source_changes(self, sources: Iterable[SourceState], utc_ns: int) -> None:
        """Add the sources that went OUT or IN, and the sources whose reason or correction changed."""
        for source in sources:
            is_out = source.presence is Presence.OUT
            text = source.reason if is_out else source.disagreement
            kind = _NUMBER.sub("", text) if text else ""
            before = self._presence.get(source.name, (Presence.IN, ""))
            if kind.endswith("accepted again") or before == (source.presence, kind):
                continue
            self._presence[source.name] = source.presence, kind
            if is_out:
                details = ", ".join(part for part in (source.reason, source.disagreement) if part)
                self.add("source", source.name, f"{source.name} OUT, {details}", utc_ns)
            elif before[0] is Presence.OUT or kind:
                text = f"{source.name} {source.presence.value}" + (f", {kind}" if kind else "")
                self.add("source", source.name, text, utc_ns)

    def add_alert_changes(self, before: Iterable[AlertEntry], now: Iterable[AlertEntry], utc_ns: int) -> None:
        """Add the alerts whose state changed, and the alerts that are no longer published, which are over."""
        states = {(alert.id, alert.instance): alert.state for alert in before}
        for alert in now:
            if states.pop((alert.id, alert.instance), None) != alert.state:
                text = f"{alert.priority.name} {_ALERT_STATE_TEXTS.get(alert.state, '')}: {alert.text}"
                self.add("alert", alert.id, text, alert.changed_ns)
        for name, _ in states:
            self.add("alert", name, f"{name} is over", utc_ns)


class SuiteMonitor:
    """Evaluates the outputs of a suite against the limits of the ship.

    Args:
        limits: limits of the ship.
        make_recorder: function that returns a new recorder of the history; a recorder for fewer plots may record less.
    """

    def __init__(
        self, limits: Limits | None = None, make_recorder: Callable[[], HistoryRecorder] = HistoryRecorder
    ) -> None:
        self.limits = limits or Limits()
        self._make_recorder = make_recorder
        self._handlers: dict[str, Callable[[Any, int], None]] = {}
        self._alerts: tuple[AlertEntry, ...] | None = None
        self._published: PublishedState | None = None
        self.reset()

    @property
    def history(self) -> History:
        """History for plots; a new object after a reset."""
        return self._recorder.history

    def clear_alerts(self) -> None:
        """Clear alerts and published state after the end of the alert node."""
        self._alerts, self._published = None, None

    def reset(self) -> None:
        """Reset everything except the alerts, as when a bag is played in a loop."""
        self._recorder = self._make_recorder()
        self._handlers.clear()
        self._attitude, self._pointing = AttitudeRecord(self.limits), PointingRecord(self.limits)
        self._sources = SourceRecords(self.limits)
        self._overload = OverloadedNodes()
        self._mountings = MountingShifts()
        self._angles = Angles(self.limits, self._attitude, self._pointing, self._sources, self._overload)
        self._events = EventLog()
        self._time = SuiteTime()
        self._published = None
        self._displayed_safety: dict[str, Safety] = {}
        self._start_ns: int | None = None
        self._evaluated_ns: int | None = None

    # -- messages -------------------------------------------------------------------------------------------

    def process_message(self, topic: str, message: Any, arrival_ns: int) -> None:
        """Process one message; topics that are not monitored are ignored.

        Args:
            topic: name of the message's topic, relative to the namespace of the suite.
            message: the message, with the fields of its type as attributes.
            arrival_ns: arrival time of the message, caller's steady time, ns.
        """
        handler = self._handlers.get(topic) or self._handler(topic)
        if handler is not None:
            self._handlers[topic] = handler
            self._evaluate_until(arrival_ns)
            with np.errstate(all="ignore"):  # invalid values become NaN, which fails every comparison
                handler(message, arrival_ns)

    def process_suite_state(self, message: Any, arrival_ns: int) -> None:
        """Process a SuiteState message: while such messages arrive, angles and sources are taken from them.

        Raises:
            ValueError: the message contains an undefined safety or presence.
        """
        self._evaluate_until(arrival_ns)
        self._published = published_state(message, arrival_ns)

    def _handler(self, topic: str) -> Callable[[Any, int], None] | None:
        """Return the handler of a topic's messages; None if it is not monitored or there are too many topics."""
        if monitored_topic(topic) is None or not has_room(self._handlers, topic, "topic"):
            return None
        recorder = self._recorder
        first, _, last = topic.rpartition("/")
        handlers: dict[str, Callable[[Any, int], None]] = {
            "attitude": lambda message, now_ns: self._process_output(self._attitude, message, now_ns),
            "pointing": lambda message, now_ns: self._process_output(self._pointing, message, now_ns),
            "innovation": lambda message, now_ns: self._process_innovation(topic, message, now_ns),
            "integrity": lambda message, now_ns: self._process_integrity(topic, message, now_ns),
            "input_health": self._process_health,
            "alerts": self._process_alerts,
            "error_budget": lambda message, _: recorder.record_budget(topic, message),
            "error_arcsec": lambda message, _: recorder.record_error(topic, message),
            "alignment": functools.partial(self._process_alignment, topic),
            "calibration": lambda message, _: recorder.record_parameters(topic, message),
        }
        if first == "truth":
            return lambda message, _: recorder.record_truth(topic, message)
        return handlers.get(last, functools.partial(self._process_input, topic))

    def _process_output(self, output: OutputRecord, message: Any, now_ns: int) -> None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        if message.status != Status.INVALID and stamp_ns < output.stamp_ns - TIME_JUMP_NS:
            self.reset()
            self._events.add("node", "time", "time went back: history cleared", stamp_ns)
            output = self._attitude if output.topic == self._attitude.topic else self._pointing
        self._time.update(stamp_ns, now_ns)
        changes = output.record(message, stamp_ns, now_ns)
        for kind, text in changes:
            self._events.add(kind, output.topic, text, stamp_ns)
        self._sources.record_arrival(output.topic, now_ns)
        self._recorder.record_output(output.topic, message, stamp_ns)

    def _process_innovation(self, topic: str, message: Any, now_ns: int) -> None:
        if message.reason == Reason.BEHIND:
            self._overload.record_report(message, now_ns)
            return
        source = self._sources.record_innovation(topic, message, now_ns)
        if source and topic != STAR_INNOVATION:
            self._recorder.record_innovation(source, message, now_ns)

    def _process_alignment(self, topic: str, message: Any, _now_ns: int) -> None:
        self._recorder.record_parameters(topic, message)
        self._mountings.record_alignment(message)

    def _process_input(self, topic: str, message: Any, now_ns: int) -> None:
        self._sources.record_arrival(topic, now_ns)
        if topic.endswith("/solution"):
            self._sources.record_solution(source_of_topic(topic), message, now_ns)
        self._recorder.record_input(topic, message, now_ns)

    def _process_integrity(self, topic: str, message: Any, now_ns: int) -> None:
        (self._attitude if topic.startswith("ship/") else self._pointing).record_integrity(message, now_ns)
        self._sources.record_integrity(topic, message, ns_from_stamp(message.header.stamp))

    def _process_health(self, message: Any, now_ns: int) -> None:
        self._time.update(ns_from_stamp(message.header.stamp), now_ns)
        has_started = self._sources.record_health(message, now_ns)
        if has_started and self._start_ns is not None and now_ns - self._start_ns > START_UP_NS:
            self._events.add_node_start(reading_node(str(message.topic)), ns_from_stamp(message.header.stamp))

    def _process_alerts(self, message: Any, now_ns: int) -> None:
        alerts = alerts_from_message(message)
        self._events.add_alert_changes(self._alerts or (), alerts, ns_from_stamp(message.header.stamp))
        self._alerts = tuple(sorted(alerts, key=lambda alert: alert.urgency))

    # -- state ----------------------------------------------------------------------------------------------

    def current_state(self, now_ns: int) -> SuiteState:
        """Return the state at the caller's time; the state does not depend on the number of requests."""
        self._evaluate_until(now_ns)
        utc_ns = self._time.utc_ns(now_ns)
        sources = [
            self._with_output_data(each, now_ns)
            for each in self._sources.source_details(self._source_states(now_ns), now_ns)
        ]
        angles = [
            self._angles.state(name, inputs, now_ns, self._time.utc_offset_ns)
            for name, inputs in self._angles.inputs(sources, now_ns).items()
        ]
        suite_state = SuiteState(
            utc_ns=utc_ns if self._time.is_known else 0,
            angles=tuple(angles),
            ages_s={
                "stars": newest_age_s("star", sources, self._attitude.star_age_s(now_ns)),
                "lights": newest_age_s("lights", sources, self._sources.used_age_s("lights", now_ns)),
                "ins": newest_age_s(
                    "ins", sources, self._attitude.ins_age_s(self._sources.age_s("ins", now_ns), now_ns)
                ),
            },
            pointing_by=self._pointing.pointing_method,
            horizon=self._attitude.horizon,
            sources=tuple(sources),
            alerts=self._alerts,
            inputs=tuple(reports.input_state(now_ns) for reports in self._sources.inputs),
            events=tuple(self._events.events),
            waiting_for="" if self._attitude.is_received else self._attitude.topic,
        )
        published = self._current_published_state(now_ns)
        return suite_state if published is None else published.merge_into(suite_state, now_ns)

    def _current_published_state(self, now_ns: int) -> PublishedState | None:
        """Return the published state if it is current; None without an alert node, or if its last state is too old."""
        published = self._published
        return published if published is not None and published.is_current(now_ns) else None

    def _with_output_data(self, source: SourceDetails, now_ns: int) -> SourceDetails:
        """Return a source with data from the outputs: its mounting shift, and the age of the INS."""
        shift = self._mountings.shift_of(source.name, self._time.utc_ns(now_ns))
        age_s = self._attitude.ins_age_s(source.age_s, now_ns) if source.name == "ins" else source.age_s
        return replace(source, mounting_shift=shift, age_s=age_s)

    def _evaluate_until(self, now_ns: int) -> None:
        """Evaluate at each step of time until now, before a message that arrives now is processed."""
        if self._evaluated_ns is None:
            self._evaluated_ns = self._start_ns = now_ns - now_ns % EVALUATION_PERIOD_NS
        if now_ns - self._evaluated_ns > MAX_GAP_NS:
            self._evaluated_ns += (
                (now_ns - self._evaluated_ns - MAX_GAP_NS) // EVALUATION_PERIOD_NS * EVALUATION_PERIOD_NS
            )
        while self._evaluated_ns + EVALUATION_PERIOD_NS <= now_ns:
            self._evaluated_ns += EVALUATION_PERIOD_NS
            self._evaluate(self._evaluated_ns)

    def _source_states(self, now_ns: int) -> list[SourceState]:
        return self._overload.with_causes(self._sources.source_states(now_ns, self._time.utc_offset_ns), now_ns)

    def _evaluate(self, now_ns: int) -> None:
        """Evaluate sources and angles, or take them from a current published state; record events and safety."""
        sources, utc_ns = self._source_states(now_ns), self._time.utc_ns(now_ns)
        safety_by_angle = self._angles.update(sources, now_ns)
        are_old = {name for name in ANGLES if self._angles.output(name).is_old(now_ns)}
        if (published := self._current_published_state(now_ns)) is not None:
            sources = list(published.sources)
            safety_by_angle = {angle.name: (angle.safety, angle.reason) for angle in published.angles if angle.stamp_ns}
            are_old = {angle.name for angle in published.angles if angle.is_old}
        self._events.add_source_changes(sources, utc_ns)
        for name, text in self._mountings.record_sources(sources, utc_ns):
            self._events.add("source", name, text, utc_ns)
        for name, (safety, reason) in safety_by_angle.items():
            before = self._displayed_safety.get(name)
            if safety is not before:
                self._displayed_safety[name] = safety
                change = safety.name if before is None else f"{before.name} → {safety.name}"
                why = reason.partition(COUNTDOWN)[0]
                self._events.add("state", name, f"{name} {change}" + (f", {why}" if why else ""), utc_ns)
        if self._time.is_known:
            recorded = {
                name: None if name in are_old or name not in safety_by_angle else safety_by_angle[name][0]
                for name in ANGLES
            }
            self._recorder.record_safety(utc_ns, recorded)
