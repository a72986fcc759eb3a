"""Alerts of a suite: one for each situation; raised, acknowledged, silenced, repeated, over.

:class:`AlertList` is updated again and again with the present situations. Each has one alert, however often it flaps.
An alert is kept until its situation is over and, if necessary, a person has acknowledged it. The caller passes a steady
time for durations, and UTC for the stamps.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ship_bags.stamps import NS_PER_S
from ship_watch.alert_states import ACTIVE, UNANSWERED, AlertEvent, AlertState, Condition, next_state
from ship_watch.limits import AlertTimes
from ship_watch.picture import AlertShown, Priority

LONGEST_HOLD_S = 60.0
"""Maximum hold of an active alert after its situation disappears, s; the hold doubles each time it comes back."""

FORGOTTEN_S = 1.0
"""Time within which a brief situation that appears twice counts as one, s."""

QUIET_S = 300.0
"""Time without the situation after which the hold is no longer doubled, s."""


MOST_KEPT = 1000
"""Maximum number of alerts, including those that are over."""

_EXAMPLE = AlertShown("", 1, Priority.CAUTION, AlertState.NORMAL, "", "", math.nan, math.nan, "", 0, 0)


@dataclass(frozen=True)
class AlertChange:
    """An alert after a change (NORMAL if it is over), and the change in words."""

    alert: AlertShown
    what: str


@dataclass
class _Kept:
    """An alert with the data of its situation; steady times in ns."""

    alert: AlertShown
    hold_ns: int
    present_ns: int
    """Last time at which the situation was present."""
    deviates_since_ns: int | None = None
    """Time since which the situation has a lower priority or another text than its alert; None if it has not."""
    lost_functions: frozenset[str] = frozenset()
    becomes_alarm: bool = False
    unanswered_from_ns: int = 0
    silenced_ns: int = 0


class AlertBook:
    """All alerts of a suite.

    Args:
        times: delays until a situation is raised, cleared and escalated.
        saved_alerts: alerts from :meth:`serialise` of an earlier list, which continue with their acknowledgements. They
            are kept for at least ``times.start_s``, until the situations can be evaluated.
        now_ns: steady time of the start.

    Raises:
        ValueError: ``saved_alerts`` are not from :meth:`serialise`.
    """

    def __init__(self, times: AlertTimes, saved: Iterable[Mapping[str, Any]] = (), now_ns: int = 0) -> None:
        self._times = times
        self._start_ns = now_ns
        self._kept: dict[str, _Kept] = {}
        self._pending: dict[str, tuple[int, int]] = {}
        hold_ns = max(_ns(times.clear_after_s), _ns(times.start_s))
        for entry in saved:
            alert, lost = _loaded(entry)
            self._kept[alert.id] = _Kept(alert, hold_ns, now_ns, None, lost, False, now_ns, now_ns)

    @property
    def alerts(self) -> tuple[AlertShown, ...]:
        """Alerts that are not NORMAL, the most urgent first: unacknowledged before acknowledged, alarms first."""
        active = [kept.alert for kept in self._kept.values() if kept.alert.state != AlertState.NORMAL]
        return tuple(sorted(active, key=lambda alert: alert.urgency))

    def saved(self) -> list[dict[str, Any]]:
        """Return the alerts as plain values for a file, with the instance counts of those that are over."""
        return [
            {**dataclasses.asdict(kept.alert), "lost": sorted(kept.lost_functions)} for _, kept in sorted(self._kept.items())
        ]

    def take(self, conditions: Iterable[Condition], now_ns: int, utc_ns: int) -> tuple[AlertChange, ...]:
        """Update with all situations that are present; return the changes.

        Args:
            conditions: present situations, one for each id.
            now_ns: steady time.
            utc_ns: UTC as POSIX time.
        """
        changes = []
        there = {each.id: each for each in conditions}
        self._forget_pending(now_ns)
        self._forget_over()
        # Situations that explain others come first, so that none is raised twice in one call.
        for condition in sorted(there.values(), key=lambda each: (len(each.under), each.id)):
            changes += self._present(condition, now_ns, utc_ns)
        for id_, kept in self._kept.items():
            if id_ not in there:
                changes += self._absent(kept, now_ns, utc_ns)
            changes += self._waited(kept, now_ns, utc_ns)
        return tuple(changes)

    def acknowledge(self, id_: str, instance: int, utc_ns: int) -> tuple[AlertChange | None, str]:
        """Acknowledge one instance of an alert; return the change, None without one, and the result in words."""
        kept = self._kept.get(id_)
        if kept is None or kept.alert.state == AlertState.NORMAL:
            there = ", ".join(alert.id for alert in self.alerts) or "none"
            return None, f"no alert '{id_}'; current alerts: {there}"
        alert = kept.alert
        if alert.instance != instance:
            return None, f"'{id_}' is now instance {alert.instance}, not {instance}: read it again"
        if alert.is_acknowledged:
            return None, f"'{id_}' needs no acknowledgement: it is {_words(alert)}"
        change = self._happens(kept, AlertEvent.ACKNOWLEDGED, utc_ns, "acknowledged")
        return change, f"'{id_}' {'acknowledged' if change.alert.state else 'acknowledged, and over'}"

    def silence(self, now_ns: int, utc_ns: int) -> tuple[AlertChange, ...]:
        """Silence all sounding alerts for ``times.silence_s``; return the changes."""
        changes = []
        for kept in self._kept.values():
            if kept.alert.state == AlertState.ACTIVE_UNACKNOWLEDGED:
                kept.silenced_ns = now_ns
                changes.append(self._happens(kept, AlertEvent.SILENCED, utc_ns, "silenced"))
        return tuple(changes)

    def _forget_pending(self, now_ns: int) -> None:
        """Remove situations that disappeared before they were raised."""
        for what, (_, last_ns) in list(self._pending.items()):
            if now_ns - last_ns > _ns(FORGOTTEN_S):
                del self._pending[what]

    def _forget_over(self) -> None:
        """Remove the oldest alerts that are over if there are too many; their instances then start at 1 again."""
        over = [id_ for id_, kept in self._kept.items() if kept.alert.state == AlertState.NORMAL]
        for id_ in over[: max(0, len(self._kept) - MOST_KEPT)]:
            del self._kept[id_]

    def _has_lasted(self, what: str, now_ns: int) -> bool:
        """True if a present situation that is not raised yet has lasted long enough."""
        first_ns, _ = self._pending.get(what, (now_ns, now_ns))
        self._pending[what] = first_ns, now_ns
        return now_ns - first_ns >= _ns(self._times.raise_after_s)

    def _is_explained(self, condition: Condition) -> bool:
        """True if an active alert of at least the same priority already explains this situation."""
        for id_ in condition.under:
            kept = self._kept.get(id_)
            if kept is not None and kept.alert.state in ACTIVE and kept.alert.priority >= condition.priority:
                return True
        return False

    def _present(self, condition: Condition, now_ns: int, utc_ns: int) -> list[AlertChange]:
        kept = self._kept.get(condition.id)
        if any(id_ in self._pending for id_ in condition.under):
            # A situation that explains it may be raised soon.
            return []
        if self._is_explained(condition):
            self._pending.pop(condition.id, None)
            if kept is None or kept.alert.state not in ACTIVE:
                return []
            return [self._happens(kept, AlertEvent.EXPLAINED, utc_ns, "covered by another alert")]
        if kept is None or kept.alert.state not in ACTIVE:
            has_lasted = self._has_lasted(condition.id, now_ns)
            starting = condition.may_be_startup and now_ns - self._start_ns < _ns(self._times.start_s)
            if starting or not has_lasted:
                return []
            del self._pending[condition.id]
            return [self._raise(condition, kept, now_ns, utc_ns)]
        kept.present_ns, kept.becomes_alarm = now_ns, condition.becomes_alarm
        if condition.is_blind:
            return []
        more, is_graver = condition.lost_functions - kept.lost_functions, condition.priority > kept.alert.priority
        if (more or is_graver) and not self._has_lasted(f"{condition.id}, graver", now_ns):
            return []
        kept.lost_functions |= condition.lost_functions
        if is_graver:
            what = f"was a {kept.alert.priority.name.lower()}, is a{_n(condition.priority)} now"
            return [self._worsen(condition, kept, what, now_ns, utc_ns)]
        if more and condition.priority is not Priority.CAUTION:
            if kept.alert.is_acknowledged:
                return [self._worsen(condition, kept, f"now also affects {', '.join(sorted(more))}", now_ns, utc_ns)]
            kept.alert = _with_condition(kept.alert, condition)
            return [AlertChange(kept.alert, f"now also affects {', '.join(sorted(more))}")]
        return self._ease(condition, kept, now_ns, utc_ns)

    def _raise(self, condition: Condition, kept: _Kept | None, now_ns: int, utc_ns: int) -> AlertChange:
        hold_ns = _ns(self._times.clear_after_s)
        instance, state, priority = 1, AlertState.NORMAL, condition.priority
        if kept is not None:
            instance, state = kept.alert.instance + 1, AlertState(kept.alert.state)
            if state is AlertState.RECTIFIED_UNACKNOWLEDGED:
                priority = max(priority, kept.alert.priority)
            # It came back: the hold is doubled, so that it is not raised again and again.
            flaps = now_ns - kept.present_ns < _ns(QUIET_S)
            hold_ns = min(2 * kept.hold_ns, max(_ns(LONGEST_HOLD_S), hold_ns)) if flaps else hold_ns
        alert = AlertShown(
            id=condition.id, instance=instance, priority=priority, state=state, source=condition.source,
            text=condition.text, value=condition.value, limit=condition.limit, unit=condition.unit,
            raised_ns=utc_ns, changed_ns=utc_ns,
        )
        new = _Kept(alert, hold_ns, now_ns, None, condition.lost_functions, condition.becomes_alarm, now_ns)
        self._kept[condition.id] = new
        return self._happens(new, AlertEvent.COMES, utc_ns, "raised")

    @staticmethod
    def _worsen(condition: Condition, kept: _Kept, what: str, now_ns: int, utc_ns: int) -> AlertChange:
        """Raise a new instance: the situation is more severe than the one that was acknowledged."""
        kept.unanswered_from_ns, kept.deviates_since_ns = now_ns, None
        kept.alert = dataclasses.replace(
            _with_condition(kept.alert, condition), priority=max(condition.priority, kept.alert.priority),
            instance=kept.alert.instance + 1, state=AlertState.ACTIVE_UNACKNOWLEDGED, changed_ns=utc_ns,
        )
        return AlertChange(kept.alert, what)

    @staticmethod
    def _ease(condition: Condition, kept: _Kept, now_ns: int, utc_ns: int) -> list[AlertChange]:
        """Update text and value; take over another text or a lower priority after the hold time.

        The priority of an unacknowledged alert is never lowered.
        """
        alert = kept.alert
        if condition.text == alert.text and condition.priority == alert.priority:
            kept.deviates_since_ns = None
            kept.alert = _with_condition(alert, condition)
            return []
        kept.deviates_since_ns = kept.deviates_since_ns if kept.deviates_since_ns is not None else now_ns
        is_lower = condition.priority < alert.priority
        if (is_lower and not alert.is_acknowledged) or now_ns - kept.deviates_since_ns < kept.hold_ns:
            return []
        kept.deviates_since_ns = None
        kept.alert = _with_condition(alert, condition)
        if not is_lower:
            return [AlertChange(kept.alert, "text changed")]
        kept.alert = dataclasses.replace(kept.alert, priority=condition.priority, changed_ns=utc_ns)
        return [AlertChange(kept.alert, f"now only a {condition.priority.name.lower()}")]

    def _absent(self, kept: _Kept, now_ns: int, utc_ns: int) -> list[AlertChange]:
        if kept.alert.state not in ACTIVE or now_ns - kept.present_ns < kept.hold_ns:
            return []
        return [self._happens(kept, AlertEvent.GOES, utc_ns, "over")]

    def _waited(self, kept: _Kept, now_ns: int, utc_ns: int) -> list[AlertChange]:
        """Repeat or escalate an unacknowledged warning, and end a silence, when their times have passed."""
        alert, patience_ns = kept.alert, _ns(self._times.escalate_after_s)
        is_due = now_ns - kept.unanswered_from_ns >= patience_ns
        if alert.state in UNANSWERED and alert.priority is Priority.WARNING and is_due:
            kept.unanswered_from_ns = now_ns
            what = f"repeated: not acknowledged for {self._times.escalate_after_s:g} s"
            if kept.becomes_alarm:
                # A new instance: an acknowledgement of the warning does not count for the alarm.
                kept.alert = dataclasses.replace(alert, priority=Priority.ALARM, instance=alert.instance + 1)
                what = f"became an alarm: not acknowledged for {self._times.escalate_after_s:g} s"
            return [self._happens(kept, AlertEvent.UNANSWERED, utc_ns, what)]
        if alert.state == AlertState.ACTIVE_SILENCED and now_ns - kept.silenced_ns >= _ns(self._times.silence_s):
            return [self._happens(kept, AlertEvent.SILENCE_ENDS, utc_ns, "sounds again")]
        return []

    @staticmethod
    def _happens(kept: _Kept, event: AlertEvent, utc_ns: int, what: str) -> AlertChange:
        state = next_state(AlertState(kept.alert.state), event, kept.alert.priority)
        kept.alert = dataclasses.replace(kept.alert, state=state, changed_ns=utc_ns)
        return AlertChange(kept.alert, what)


def _with_condition(alert: AlertShown, condition: Condition) -> AlertShown:
    return dataclasses.replace(
        alert, source=condition.source, text=condition.text, value=condition.value, limit=condition.limit,
        unit=condition.unit,
    )


def _loaded(entry: Mapping[str, Any]) -> tuple[AlertShown, frozenset[str]]:
    """Return an alert from its plain values, and the functions that its situation affects.

    Raises:
        ValueError: the values are not those of an alert.
    """
    try:
        fields = {**entry, "priority": Priority(entry["priority"]), "state": AlertState(entry["state"])}
        lost = frozenset(map(str, fields.pop("lost")))
        alert = AlertShown(**fields)
    except (TypeError, KeyError, ValueError) as problem:
        raise ValueError(f"not a saved alert: {problem}") from problem
    for field in dataclasses.fields(alert):
        value, default = getattr(alert, field.name), getattr(_EXAMPLE, field.name)
        if not isinstance(value, type(default)):
            raise ValueError(f"not a saved alert: {field.name} is {value!r}")
    return alert, lost


def _words(alert: AlertShown) -> str:
    return f"a {alert.priority.name.lower()}, {AlertState(alert.state).name.lower().replace('_', ' ')}"


def _n(priority: Priority) -> str:
    return f"{'n' if priority is Priority.ALARM else ''} {priority.name.lower()}"


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
