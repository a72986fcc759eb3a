"""Alerts of a suite, one for each situation: raised, acknowledged, silenced, repeated and ended.

The states are from IEC 62923-1 and IMO MSC.302(87), section 7. A warning or an alarm stays until its situation is
over and a person has acknowledged it. An alert also ends when another alert explains its situation. A caution lasts as
long as its situation and needs no acknowledgement.

:class:`AlertList` is updated periodically with the present situations. A situation has one alert, even if it comes and
goes repeatedly. The caller passes a steady time for durations, and UTC for the stamps.
"""

import dataclasses
import enum
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ship_bags.stamps import NS_PER_S
from ship_watch.safety.limits import AlertTimes
from ship_watch.suite_state import AlertEntry, Priority


@dataclass(frozen=True)
class Condition:
    """A present situation, the basis of an :class:`ship_watch.suite_state.AlertEntry`.

    Attributes:
        id: name of the situation.
        priority: priority of the alert.
        source: name of the source that the situation concerns; empty if it concerns no single source.
        text: the situation in a few words, without changing figures, because a new text is a change of the alert.
        value: measured value; NaN if there is none.
        limit: limit of ``value``; NaN if there is none.
        unit: unit of ``value`` and ``limit``.
        becomes_alarm: True if an unacknowledged warning becomes an alarm; otherwise the warning is repeated.
        may_be_startup: True if the situation is normal during the start of the suite; its alert is then raised only
            after the start.
        is_never_received: True if the situation is only that an output was never received. Such a situation does not
            change an alert that was active before a restart.
        explained_by: ids of situations that explain this situation. This situation has no alert of its own while the
            alert of one of those situations is active with at least the same priority.
        lost_functions: functions that are over their limits in the situation. A new instance of the alert is raised if
            further functions are over their limits after an acknowledgement.
    """

    id: str
    priority: Priority
    source: str
    text: str
    value: float = math.nan
    limit: float = math.nan
    unit: str = ""
    becomes_alarm: bool = False
    may_be_startup: bool = False
    is_never_received: bool = False
    explained_by: tuple[str, ...] = ()
    lost_functions: frozenset[str] = frozenset()


class AlertState(enum.IntEnum):
    """State of an alert, as in ship_msgs/Alert."""

    NORMAL = 0
    ACTIVE_UNACKNOWLEDGED = 1
    ACTIVE_SILENCED = 2
    ACTIVE_ACKNOWLEDGED = 3
    RECTIFIED_UNACKNOWLEDGED = 4


class AlertEvent(enum.Enum):
    """Event that may change the state of an alert."""

    COMES = "the situation is present"
    GOES = "the situation is over"
    ACKNOWLEDGED = "acknowledged by a person"
    SILENCED = "silenced by a person"
    SILENCE_ENDS = "the silence has ended"
    UNANSWERED = "not acknowledged in time"
    EXPLAINED = "another alert covers the situation"


_S, _E = AlertState, AlertEvent
TRANSITIONS: Mapping[tuple[AlertState, AlertEvent], AlertState] = {
    (_S.NORMAL, _E.COMES): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.GOES): _S.RECTIFIED_UNACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.ACKNOWLEDGED): _S.ACTIVE_ACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.SILENCED): _S.ACTIVE_SILENCED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.UNANSWERED): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.EXPLAINED): _S.NORMAL,
    (_S.ACTIVE_SILENCED, _E.GOES): _S.RECTIFIED_UNACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.ACKNOWLEDGED): _S.ACTIVE_ACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.SILENCE_ENDS): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.UNANSWERED): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.EXPLAINED): _S.NORMAL,
    (_S.ACTIVE_ACKNOWLEDGED, _E.GOES): _S.NORMAL,
    (_S.ACTIVE_ACKNOWLEDGED, _E.EXPLAINED): _S.NORMAL,
    (_S.RECTIFIED_UNACKNOWLEDGED, _E.COMES): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.RECTIFIED_UNACKNOWLEDGED, _E.ACKNOWLEDGED): _S.NORMAL,
}
"""(State, event) → next state of a warning or an alarm. Other combinations change nothing."""

CAUTION_TRANSITIONS: Mapping[tuple[AlertState, AlertEvent], AlertState] = {
    (_S.NORMAL, _E.COMES): _S.ACTIVE_ACKNOWLEDGED,
    (_S.ACTIVE_ACKNOWLEDGED, _E.GOES): _S.NORMAL,
    (_S.ACTIVE_ACKNOWLEDGED, _E.EXPLAINED): _S.NORMAL,
}
"""(State, event) → next state of a caution, which needs no acknowledgement."""

UNACKNOWLEDGED = frozenset((_S.ACTIVE_UNACKNOWLEDGED, _S.ACTIVE_SILENCED))
"""States of a present situation that is not acknowledged."""

ACTIVE = UNACKNOWLEDGED | {_S.ACTIVE_ACKNOWLEDGED}
"""States of a present situation."""


def next_state(state: AlertState, event: AlertEvent, priority: Priority) -> AlertState:
    """Return the state after an event; the same state if the event changes nothing."""
    table = CAUTION_TRANSITIONS if priority is Priority.CAUTION else TRANSITIONS
    return table.get((state, event), state)


MAX_HOLD_S = 60.0
"""Maximum doubled hold of an active alert after its situation disappears, s, unless ``clear_after_s`` is longer.

The hold doubles each time the alert is raised again within :data:`FLAPPING_MEMORY_S`.
"""

GLITCH_MEMORY_S = 1.0
"""Maximum gap in a situation that is not raised yet, s; after a longer gap its delay starts again."""

FLAPPING_MEMORY_S = 300.0
"""Time without the situation after which the hold is not doubled but starts at ``clear_after_s`` again, s."""


MAX_ALERTS = 1000
"""Number of alerts above which alerts that are over are removed, in the order in which their ids were first listed."""

_EXAMPLE = AlertEntry("", 1, Priority.CAUTION, AlertState.NORMAL, "", "", math.nan, math.nan, "", 0, 0)


@dataclass(frozen=True)
class AlertChange:
    """An alert after a change, and the change in words. The state is NORMAL if the alert is no longer listed."""

    alert: AlertEntry
    description: str


@dataclass
class _TrackedAlert:
    """An alert with the data of its situation; steady times in ns."""

    alert: AlertEntry
    hold_ns: int
    last_present_ns: int
    """Last time at which the situation was present."""
    deviates_since_ns: int | None = None
    """Time since which the situation has a lower priority or another text than its alert; None if both are equal."""
    lost_functions: frozenset[str] = frozenset()
    becomes_alarm: bool = False
    unacknowledged_from_ns: int = 0
    silenced_ns: int = 0


class AlertList:
    """All alerts of a suite.

    Args:
        times: delays until a situation is raised, cleared and escalated.
        saved_alerts: alerts from :meth:`serialise` of an earlier list, which continue with their acknowledgements.
            These alerts are kept for at least ``times.start_s``, until the situations can be evaluated.
        now_ns: steady time of the start.

    Raises:
        ValueError: ``saved_alerts`` are not from :meth:`serialise`.
    """

    def __init__(self, times: AlertTimes, saved_alerts: Iterable[Mapping[str, Any]] = (), now_ns: int = 0) -> None:
        self._times = times
        self._start_ns = now_ns
        self._tracked: dict[str, _TrackedAlert] = {}
        self._pending: dict[str, tuple[int, int]] = {}
        hold_ns = max(_ns(times.clear_after_s), _ns(times.start_s))
        for entry in saved_alerts:
            alert, lost = _alert_from_saved(entry)
            self._tracked[alert.id] = _TrackedAlert(alert, hold_ns, now_ns, None, lost, False, now_ns, now_ns)

    @property
    def alerts(self) -> tuple[AlertEntry, ...]:
        """Alerts that are not NORMAL, the most urgent first: unacknowledged before acknowledged, then by priority."""
        active = [tracked.alert for tracked in self._tracked.values() if tracked.alert.state != AlertState.NORMAL]
        return tuple(sorted(active, key=lambda alert: alert.urgency))

    def serialise(self) -> list[dict[str, Any]]:
        """Return all alerts as plain values for a file; alerts that are over are included for their instance counts."""
        return [
            {**dataclasses.asdict(tracked.alert), "lost": sorted(tracked.lost_functions)}
            for _, tracked in sorted(self._tracked.items())
        ]

    def update(self, conditions: Iterable[Condition], now_ns: int, utc_ns: int) -> tuple[AlertChange, ...]:
        """Update the alerts with all present situations; return the changes.

        Args:
            conditions: present situations, one for each id.
            now_ns: steady time.
            utc_ns: UTC as POSIX time.
        """
        changes = []
        present = {each.id: each for each in conditions}
        self._drop_pending(now_ns)
        self._drop_normal()
        # Situations that explain others come first, so that an explained situation is not raised in the same call.
        for condition in sorted(present.values(), key=lambda each: (len(each.explained_by), each.id)):
            changes += self._update_present(condition, now_ns, utc_ns)
        for id_, tracked in self._tracked.items():
            if id_ not in present:
                changes += self._update_absent(tracked, now_ns, utc_ns)
            changes += self._apply_timeouts(tracked, now_ns, utc_ns)
        return tuple(changes)

    def acknowledge(self, id_: str, instance: int, utc_ns: int) -> tuple[AlertChange | None, str]:
        """Acknowledge an instance of an alert; return the change (None if nothing changes) and the result in words."""
        tracked = self._tracked.get(id_)
        if tracked is None or tracked.alert.state == AlertState.NORMAL:
            active_ids = ", ".join(alert.id for alert in self.alerts) or "none"
            return None, f"no alert '{id_}'; current alerts: {active_ids}"
        alert = tracked.alert
        if alert.instance != instance:
            return None, f"'{id_}' is now instance {alert.instance}, not {instance}: read the alert again"
        if alert.is_acknowledged:
            state = AlertState(alert.state).name.lower().replace("_", " ")
            return None, f"'{id_}' needs no acknowledgement: it is a{_after_article(alert.priority)}, {state}"
        change = self._apply_event(tracked, AlertEvent.ACKNOWLEDGED, utc_ns, "acknowledged")
        return change, f"'{id_}' {'acknowledged' if change.alert.state else 'acknowledged, and over'}"

    def silence(self, now_ns: int, utc_ns: int) -> tuple[AlertChange, ...]:
        """Silence all sounding alerts for ``times.silence_s``; return the changes."""
        changes = []
        for tracked in self._tracked.values():
            if tracked.alert.state == AlertState.ACTIVE_UNACKNOWLEDGED:
                tracked.silenced_ns = now_ns
                changes.append(self._apply_event(tracked, AlertEvent.SILENCED, utc_ns, "silenced"))
        return tuple(changes)

    def _drop_pending(self, now_ns: int) -> None:
        """Remove situations that disappeared before they were raised."""
        for what, (_, last_ns) in list(self._pending.items()):
            if now_ns - last_ns > _ns(GLITCH_MEMORY_S):
                del self._pending[what]

    def _drop_normal(self) -> None:
        """If the list is too long, remove alerts that are over, in the order in which their ids were first listed.

        The instances of a removed alert start at 1 again.
        """
        over = [id_ for id_, tracked in self._tracked.items() if tracked.alert.state == AlertState.NORMAL]
        for id_ in over[: max(0, len(self._tracked) - MAX_ALERTS)]:
            del self._tracked[id_]

    def _has_lasted(self, what: str, now_ns: int) -> bool:
        """Record a present situation that is not raised yet; return True if it has lasted long enough."""
        first_ns, _ = self._pending.get(what, (now_ns, now_ns))
        self._pending[what] = first_ns, now_ns
        return now_ns - first_ns >= _ns(self._times.raise_after_s)

    def _is_explained(self, condition: Condition) -> bool:
        """True if an active alert of at least the same priority already explains this situation."""
        for id_ in condition.explained_by:
            tracked = self._tracked.get(id_)
            if tracked is not None and tracked.alert.state in ACTIVE and tracked.alert.priority >= condition.priority:
                return True
        return False

    def _update_present(self, condition: Condition, now_ns: int, utc_ns: int) -> list[AlertChange]:
        tracked = self._tracked.get(condition.id)
        if any(id_ in self._pending for id_ in condition.explained_by):
            # The explaining situation may be raised soon.
            return []
        if self._is_explained(condition):
            self._pending.pop(condition.id, None)
            if tracked is None or tracked.alert.state not in ACTIVE:
                return []
            return [self._apply_event(tracked, AlertEvent.EXPLAINED, utc_ns, "covered by another alert")]
        if tracked is None or tracked.alert.state not in ACTIVE:
            has_lasted = self._has_lasted(condition.id, now_ns)
            starting = condition.may_be_startup and now_ns - self._start_ns < _ns(self._times.start_s)
            if starting or not has_lasted:
                return []
            del self._pending[condition.id]
            return [self._raise(condition, tracked, now_ns, utc_ns)]
        tracked.last_present_ns, tracked.becomes_alarm = now_ns, condition.becomes_alarm
        if condition.is_never_received:
            return []
        more, is_graver = condition.lost_functions - tracked.lost_functions, condition.priority > tracked.alert.priority
        if (more or is_graver) and not self._has_lasted(f"{condition.id}, graver", now_ns):
            return []
        tracked.lost_functions |= condition.lost_functions
        if is_graver:
            what = f"was a{_after_article(tracked.alert.priority)}, is a{_after_article(condition.priority)} now"
            return [self._escalate(condition, tracked, what, now_ns, utc_ns)]
        if more and condition.priority is not Priority.CAUTION:
            if tracked.alert.is_acknowledged:
                return [
                    self._escalate(condition, tracked, f"now also affects {', '.join(sorted(more))}", now_ns, utc_ns)
                ]
            tracked.alert = _with_condition(tracked.alert, condition)
            return [AlertChange(tracked.alert, f"now also affects {', '.join(sorted(more))}")]
        return self._deescalate(condition, tracked, now_ns, utc_ns)

    def _raise(self, condition: Condition, tracked: _TrackedAlert | None, now_ns: int, utc_ns: int) -> AlertChange:
        hold_ns = _ns(self._times.clear_after_s)
        instance, state, priority = 1, AlertState.NORMAL, condition.priority
        if tracked is not None:
            instance, state = tracked.alert.instance + 1, AlertState(tracked.alert.state)
            if state is AlertState.RECTIFIED_UNACKNOWLEDGED:
                priority = max(priority, tracked.alert.priority)
            # The hold doubles if the situation comes back soon, so that its alert is not raised repeatedly.
            flaps = now_ns - tracked.last_present_ns < _ns(FLAPPING_MEMORY_S)
            hold_ns = min(2 * tracked.hold_ns, max(_ns(MAX_HOLD_S), hold_ns)) if flaps else hold_ns
        alert = AlertEntry(
            id=condition.id, instance=instance, priority=priority, state=state, source=condition.source,
            text=condition.text, value=condition.value, limit=condition.limit, unit=condition.unit,
            raised_ns=utc_ns, changed_ns=utc_ns,
        )
        new = _TrackedAlert(alert, hold_ns, now_ns, None, condition.lost_functions, condition.becomes_alarm, now_ns)
        self._tracked[condition.id] = new
        return self._apply_event(new, AlertEvent.COMES, utc_ns, "raised")

    @staticmethod
    def _escalate(
        condition: Condition, tracked: _TrackedAlert, description: str, now_ns: int, utc_ns: int
    ) -> AlertChange:
        """Raise a new instance of an alert whose situation has become more severe or affects more functions."""
        tracked.unacknowledged_from_ns, tracked.deviates_since_ns = now_ns, None
        tracked.alert = dataclasses.replace(
            _with_condition(tracked.alert, condition), priority=max(condition.priority, tracked.alert.priority),
            instance=tracked.alert.instance + 1, state=AlertState.ACTIVE_UNACKNOWLEDGED, changed_ns=utc_ns,
        )
        return AlertChange(tracked.alert, description)

    @staticmethod
    def _deescalate(condition: Condition, tracked: _TrackedAlert, now_ns: int, utc_ns: int) -> list[AlertChange]:
        """Update the value while text and priority are the same; adopt another text or a lower priority after the hold.

        An unacknowledged alert keeps priority, text and value while its situation has a lower priority.
        """
        alert = tracked.alert
        if condition.text == alert.text and condition.priority == alert.priority:
            tracked.deviates_since_ns = None
            tracked.alert = _with_condition(alert, condition)
            return []
        tracked.deviates_since_ns = tracked.deviates_since_ns if tracked.deviates_since_ns is not None else now_ns
        is_lower = condition.priority < alert.priority
        if (is_lower and not alert.is_acknowledged) or now_ns - tracked.deviates_since_ns < tracked.hold_ns:
            return []
        tracked.deviates_since_ns = None
        tracked.alert = _with_condition(alert, condition)
        if not is_lower:
            return [AlertChange(tracked.alert, "text changed")]
        tracked.alert = dataclasses.replace(tracked.alert, priority=condition.priority, changed_ns=utc_ns)
        return [AlertChange(tracked.alert, f"now only a {condition.priority.name.lower()}")]

    def _update_absent(self, tracked: _TrackedAlert, now_ns: int, utc_ns: int) -> list[AlertChange]:
        if tracked.alert.state not in ACTIVE or now_ns - tracked.last_present_ns < tracked.hold_ns:
            return []
        return [self._apply_event(tracked, AlertEvent.GOES, utc_ns, "over")]

    def _apply_timeouts(self, tracked: _TrackedAlert, now_ns: int, utc_ns: int) -> list[AlertChange]:
        """Repeat or escalate an unacknowledged warning, and end a silence, when their times have passed."""
        alert, timeout_ns = tracked.alert, _ns(self._times.escalate_after_s)
        is_due = now_ns - tracked.unacknowledged_from_ns >= timeout_ns
        if alert.state in UNACKNOWLEDGED and alert.priority is Priority.WARNING and is_due:
            tracked.unacknowledged_from_ns = now_ns
            what = f"repeated: not acknowledged for {self._times.escalate_after_s:g} s"
            if tracked.becomes_alarm:
                # A new instance: an acknowledgement of the warning does not count for the alarm.
                tracked.alert = dataclasses.replace(alert, priority=Priority.ALARM, instance=alert.instance + 1)
                what = f"became an alarm: not acknowledged for {self._times.escalate_after_s:g} s"
            return [self._apply_event(tracked, AlertEvent.UNANSWERED, utc_ns, what)]
        if alert.state == AlertState.ACTIVE_SILENCED and now_ns - tracked.silenced_ns >= _ns(self._times.silence_s):
            return [self._apply_event(tracked, AlertEvent.SILENCE_ENDS, utc_ns, "sounds again")]
        return []

    @staticmethod
    def _apply_event(tracked: _TrackedAlert, event: AlertEvent, utc_ns: int, description: str) -> AlertChange:
        state = next_state(AlertState(tracked.alert.state), event, tracked.alert.priority)
        tracked.alert = dataclasses.replace(tracked.alert, state=state, changed_ns=utc_ns)
        return AlertChange(tracked.alert, description)


def _with_condition(alert: AlertEntry, condition: Condition) -> AlertEntry:
    return dataclasses.replace(
        alert, source=condition.source, text=condition.text, value=condition.value, limit=condition.limit,
        unit=condition.unit,
    )


def _alert_from_saved(entry: Mapping[str, Any]) -> tuple[AlertEntry, frozenset[str]]:
    """Return an alert from its plain values, and the functions that its situation affects.

    Raises:
        ValueError: the values do not describe an alert.
    """
    try:
        fields = {**entry, "priority": Priority(entry["priority"]), "state": AlertState(entry["state"])}
        lost = frozenset(map(str, fields.pop("lost")))
        alert = AlertEntry(**fields)
    except (TypeError, KeyError, ValueError) as problem:
        raise ValueError(f"not a saved alert: {problem}") from problem
    for field in dataclasses.fields(alert):
        value, default = getattr(alert, field.name), getattr(_EXAMPLE, field.name)
        if not isinstance(value, type(default)):
            raise ValueError(f"not a saved alert: {field.name} is {value!r}")
    return alert, lost


def _after_article(priority: Priority) -> str:
    return f"{'n' if priority is Priority.ALARM else ''} {priority.name.lower()}"


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
