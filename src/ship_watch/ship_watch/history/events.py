"""Log of changes: sources that go OUT or IN, alerts, nodes that start, safety, status and modes."""

import re
from collections import deque
from collections.abc import Iterable
from typing import Any

from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_watch.names import MAX_NAMES
from ship_watch.suite_state import AlertEntry, Event, Presence, Priority, SourceState

MAX_EVENTS = 200
"""Number of events that are kept."""

START_UP_NS = 3 * NS_PER_S
"""Time after the start of monitoring, and after a reported start of a node, without reports of further starts, ns."""

_NUMBER = re.compile(r"\d+ ")
_PRIORITIES = {int(priority) for priority in Priority}
_ALERT_STATE_TEXTS = {0: "over", 1: "raised", 2: "silenced", 3: "acknowledged", 4: "rectified, not acknowledged"}
"""State of an alert, as in ship_msgs/Alert → its text."""


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


def alerts_from_message(message: Any) -> list[AlertEntry]:
    """Return the first MAX_NAMES alerts of an AlertArray in its order, without alerts of an unknown priority."""
    return [_alert_from_message(alert) for alert in message.alerts[:MAX_NAMES] if alert.priority in _PRIORITIES]


def _alert_from_message(alert: Any) -> AlertEntry:
    return AlertEntry(
        id=str(alert.id),
        instance=int(alert.instance),
        priority=Priority(alert.priority),
        state=int(alert.state),
        source=str(alert.source),
        text=str(alert.text),
        value=float(alert.value),
        limit=float(alert.limit),
        unit=str(alert.unit),
        raised_ns=ns_from_stamp(alert.raised),
        changed_ns=ns_from_stamp(alert.changed),
    )
