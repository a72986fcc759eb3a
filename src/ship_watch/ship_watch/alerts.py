"""All alerts of a suite: one of each situation, raised, acknowledged, silenced, repeated, over.

:class:`AlertBook` is told again and again which situations are there. It makes one alert of each, however often the
situation flaps, and keeps the alert until it is over and, where that is needed, a person has acknowledged it. The book
knows no clock: the caller gives a steady time, from which durations are counted, and UTC, which goes into the stamps.
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
"""A situation that comes and goes is held active for the longer the more often it came back, up to this time, s."""

FORGOTTEN_S = 1.0
"""A situation that was there for less time than it must last is remembered so long: twice within it is no glitch, s."""

QUIET_S = 300.0
"""A situation that stayed away for so long does not flap any more, s."""


MOST_KEPT = 1000
"""Alerts that are remembered where they are over."""

_EXAMPLE = AlertShown("", 1, Priority.CAUTION, AlertState.NORMAL, "", "", math.nan, math.nan, "", 0, 0)


@dataclass(frozen=True)
class AlertChange:
    """What became of an alert, NORMAL where it is no more, and in words what happened."""

    alert: AlertShown
    what: str


@dataclass
class _Kept:
    """What the book remembers of one situation beside its alert; steady times in ns."""

    alert: AlertShown
    hold_ns: int
    present_ns: int
    """When the situation was last there."""
    other_since_ns: int | None = None
    """Since when it is less urgent than its alert says, or another text tells it."""
    lost: frozenset[str] = frozenset()
    becomes_alarm: bool = False
    unanswered_from_ns: int = 0
    silenced_ns: int = 0


class AlertBook:
    """All alerts of a suite.

    Args:
        times: how long situations last before they are told, and people have to answer.
        saved: what :meth:`saved` of an earlier book gave: its alerts go on with their acknowledgements. They are kept
            for at least ``times.start_s``, until it can be known whether the situations are still there.
        now_ns: steady time of the start.

    Raises:
        ValueError: ``saved`` is not what :meth:`saved` gives.
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
        """All that are not NORMAL, the most urgent first: unacknowledged before acknowledged, alarms before others."""
        told = [kept.alert for kept in self._kept.values() if kept.alert.state != AlertState.NORMAL]
        return tuple(sorted(told, key=lambda alert: alert.urgency))

    def saved(self) -> list[dict[str, Any]]:
        """The book as plain values for a file, the counts of instances of alerts that are over among them."""
        return [
            {**dataclasses.asdict(kept.alert), "lost": sorted(kept.lost)} for _, kept in sorted(self._kept.items())
        ]

    def take(self, conditions: Iterable[Condition], now_ns: int, utc_ns: int) -> tuple[AlertChange, ...]:
        """Take the situations that are there now, all of them.

        Args:
            conditions: one for each id.
            now_ns: steady time.
            utc_ns: UTC as POSIX time.
        """
        changes = []
        there = {each.id: each for each in conditions}
        self._forget_pending(now_ns)
        self._forget_over()
        # Those that explain others come first, so that nothing is told twice within one call.
        for condition in sorted(there.values(), key=lambda each: (len(each.under), each.id)):
            changes += self._present(condition, now_ns, utc_ns)
        for id_, kept in self._kept.items():
            if id_ not in there:
                changes += self._absent(kept, now_ns, utc_ns)
            changes += self._waited(kept, now_ns, utc_ns)
        return tuple(changes)

    def acknowledge(self, id_: str, instance: int, utc_ns: int) -> tuple[AlertChange | None, str]:
        """What a person's acknowledgement changed, None for nothing, and in words what was done or why not."""
        kept = self._kept.get(id_)
        if kept is None or kept.alert.state == AlertState.NORMAL:
            there = ", ".join(alert.id for alert in self.alerts) or "none"
            return None, f"there is no alert '{id_}' now; there is {there}"
        alert = kept.alert
        if alert.instance != instance:
            return None, f"'{id_}' is instance {alert.instance} now, not {instance}: look at it again"
        if alert.is_acknowledged:
            return None, f"'{id_}' needs no acknowledgement: it is {_words(alert)}"
        change = self._happens(kept, AlertEvent.ACKNOWLEDGED, utc_ns, "acknowledged")
        return change, f"'{id_}' {'acknowledged' if change.alert.state else 'acknowledged, and over'}"

    def silence(self, now_ns: int, utc_ns: int) -> tuple[AlertChange, ...]:
        """Switch off the sound of all alerts that sound, for a while."""
        changes = []
        for kept in self._kept.values():
            if kept.alert.state == AlertState.ACTIVE_UNACKNOWLEDGED:
                kept.silenced_ns = now_ns
                changes.append(self._happens(kept, AlertEvent.SILENCED, utc_ns, "silenced"))
        return tuple(changes)

    def _forget_pending(self, now_ns: int) -> None:
        """What went before it had lasted long enough to be told."""
        for what, (_, last_ns) in list(self._pending.items()):
            if now_ns - last_ns > _ns(FORGOTTEN_S):
                del self._pending[what]

    def _forget_over(self) -> None:
        """Remove the oldest alerts that are over where there are too many; their next instances begin at 1 again."""
        over = [id_ for id_, kept in self._kept.items() if kept.alert.state == AlertState.NORMAL]
        for id_ in over[: max(0, len(self._kept) - MOST_KEPT)]:
            del self._kept[id_]

    def _has_lasted(self, what: str, now_ns: int) -> bool:
        """Whether what was told to nobody yet has lasted long enough to be told; it is there now."""
        first_ns, _ = self._pending.get(what, (now_ns, now_ns))
        self._pending[what] = first_ns, now_ns
        return now_ns - first_ns >= _ns(self._times.raise_after_s)

    def _is_explained(self, condition: Condition) -> bool:
        """Whether an alert that is active, or about to be, tells this situation already."""
        for id_ in condition.under:
            kept = self._kept.get(id_)
            if kept is not None and kept.alert.state in ACTIVE and kept.alert.priority >= condition.priority:
                return True
        return False

    def _present(self, condition: Condition, now_ns: int, utc_ns: int) -> list[AlertChange]:
        kept = self._kept.get(condition.id)
        if any(id_ in self._pending for id_ in condition.under):
            # What explains it may be told in a moment.
            return []
        if self._is_explained(condition):
            self._pending.pop(condition.id, None)
            if kept is None or kept.alert.state not in ACTIVE:
                return []
            return [self._happens(kept, AlertEvent.EXPLAINED, utc_ns, "told by another alert")]
        if kept is None or kept.alert.state not in ACTIVE:
            has_lasted = self._has_lasted(condition.id, now_ns)
            starting = condition.needs_start and now_ns - self._start_ns < _ns(self._times.start_s)
            if starting or not has_lasted:
                return []
            del self._pending[condition.id]
            return [self._raise(condition, kept, now_ns, utc_ns)]
        kept.present_ns, kept.becomes_alarm = now_ns, condition.becomes_alarm
        if condition.is_blind:
            return []
        more, is_graver = condition.lost - kept.lost, condition.priority > kept.alert.priority
        if (more or is_graver) and not self._has_lasted(f"{condition.id}, graver", now_ns):
            return []
        kept.lost |= condition.lost
        if is_graver:
            what = f"was a {kept.alert.priority.name.lower()}, is a{_n(condition.priority)} now"
            return [self._worsen(condition, kept, what, now_ns, utc_ns)]
        if more and condition.priority is not Priority.CAUTION:
            if kept.alert.is_acknowledged:
                return [self._worsen(condition, kept, f"{', '.join(sorted(more))} as well", now_ns, utc_ns)]
            kept.alert = _told(kept.alert, condition)
            return [AlertChange(kept.alert, f"{', '.join(sorted(more))} as well")]
        return self._ease(condition, kept, now_ns, utc_ns)

    def _raise(self, condition: Condition, kept: _Kept | None, now_ns: int, utc_ns: int) -> AlertChange:
        hold_ns = _ns(self._times.clear_after_s)
        instance, state, priority = 1, AlertState.NORMAL, condition.priority
        if kept is not None:
            instance, state = kept.alert.instance + 1, AlertState(kept.alert.state)
            if state is AlertState.RECTIFIED_UNACKNOWLEDGED:
                priority = max(priority, kept.alert.priority)
            # It came back: held for twice as long from now on, so that it does not come again and again.
            flaps = now_ns - kept.present_ns < _ns(QUIET_S)
            hold_ns = min(2 * kept.hold_ns, max(_ns(LONGEST_HOLD_S), hold_ns)) if flaps else hold_ns
        alert = AlertShown(
            id=condition.id, instance=instance, priority=priority, state=state, source=condition.source,
            text=condition.text, value=condition.value, limit=condition.limit, unit=condition.unit,
            raised_ns=utc_ns, changed_ns=utc_ns,
        )
        new = _Kept(alert, hold_ns, now_ns, None, condition.lost, condition.becomes_alarm, now_ns)
        self._kept[condition.id] = new
        return self._happens(new, AlertEvent.COMES, utc_ns, "raised")

    @staticmethod
    def _worsen(condition: Condition, kept: _Kept, what: str, now_ns: int, utc_ns: int) -> AlertChange:
        """The situation is graver than what people acknowledged: an instance of its own, which they have not seen."""
        kept.unanswered_from_ns, kept.other_since_ns = now_ns, None
        kept.alert = dataclasses.replace(
            _told(kept.alert, condition), priority=max(condition.priority, kept.alert.priority),
            instance=kept.alert.instance + 1, state=AlertState.ACTIVE_UNACKNOWLEDGED, changed_ns=utc_ns,
        )
        return AlertChange(kept.alert, what)

    @staticmethod
    def _ease(condition: Condition, kept: _Kept, now_ns: int, utc_ns: int) -> list[AlertChange]:
        """The situation is as before, or not as grave, or told in other words: taken when that has lasted for a while.

        An alert that nobody acknowledged never gets less urgent.
        """
        alert = kept.alert
        if condition.text == alert.text and condition.priority == alert.priority:
            kept.other_since_ns = None
            kept.alert = _told(alert, condition)
            return []
        kept.other_since_ns = kept.other_since_ns if kept.other_since_ns is not None else now_ns
        is_lower = condition.priority < alert.priority
        if (is_lower and not alert.is_acknowledged) or now_ns - kept.other_since_ns < kept.hold_ns:
            return []
        kept.other_since_ns = None
        kept.alert = _told(alert, condition)
        if not is_lower:
            return [AlertChange(kept.alert, "told in other words")]
        kept.alert = dataclasses.replace(kept.alert, priority=condition.priority, changed_ns=utc_ns)
        return [AlertChange(kept.alert, f"is only a {condition.priority.name.lower()} now")]

    def _absent(self, kept: _Kept, now_ns: int, utc_ns: int) -> list[AlertChange]:
        if kept.alert.state not in ACTIVE or now_ns - kept.present_ns < kept.hold_ns:
            return []
        return [self._happens(kept, AlertEvent.GOES, utc_ns, "over")]

    def _waited(self, kept: _Kept, now_ns: int, utc_ns: int) -> list[AlertChange]:
        """What the time that has passed does to an alert that nobody has acknowledged."""
        alert, patience_ns = kept.alert, _ns(self._times.escalate_after_s)
        is_due = now_ns - kept.unanswered_from_ns >= patience_ns
        if alert.state in UNANSWERED and alert.priority is Priority.WARNING and is_due:
            kept.unanswered_from_ns = now_ns
            what = f"repeated: nobody acknowledged it for {self._times.escalate_after_s:g} s"
            if kept.becomes_alarm:
                # An instance of its own: who has seen a warning has not seen an alarm.
                kept.alert = dataclasses.replace(alert, priority=Priority.ALARM, instance=alert.instance + 1)
                what = f"became an alarm: nobody acknowledged it for {self._times.escalate_after_s:g} s"
            return [self._happens(kept, AlertEvent.UNANSWERED, utc_ns, what)]
        if alert.state == AlertState.ACTIVE_SILENCED and now_ns - kept.silenced_ns >= _ns(self._times.silence_s):
            return [self._happens(kept, AlertEvent.SILENCE_ENDS, utc_ns, "sounds again")]
        return []

    @staticmethod
    def _happens(kept: _Kept, event: AlertEvent, utc_ns: int, what: str) -> AlertChange:
        state = next_state(AlertState(kept.alert.state), event, kept.alert.priority)
        kept.alert = dataclasses.replace(kept.alert, state=state, changed_ns=utc_ns)
        return AlertChange(kept.alert, what)


def _told(alert: AlertShown, condition: Condition) -> AlertShown:
    return dataclasses.replace(
        alert, source=condition.source, text=condition.text, value=condition.value, limit=condition.limit,
        unit=condition.unit,
    )


def _loaded(entry: Mapping[str, Any]) -> tuple[AlertShown, frozenset[str]]:
    """An alert out of a file, and what its situation takes away.

    Raises:
        ValueError: it is none.
    """
    try:
        fields = {**entry, "priority": Priority(entry["priority"]), "state": AlertState(entry["state"])}
        lost = frozenset(map(str, fields.pop("lost")))
        alert = AlertShown(**fields)
    except (TypeError, KeyError, ValueError) as problem:
        raise ValueError(f"no saved alert: {problem}") from problem
    for field in dataclasses.fields(alert):
        value, default = getattr(alert, field.name), getattr(_EXAMPLE, field.name)
        if not isinstance(value, type(default)):
            raise ValueError(f"no saved alert: {field.name} is {value!r}")
    return alert, lost


def _words(alert: AlertShown) -> str:
    return f"a {alert.priority.name.lower()}, {AlertState(alert.state).name.lower().replace('_', ' ')}"


def _n(priority: Priority) -> str:
    return f"{'n' if priority is Priority.ALARM else ''} {priority.name.lower()}"


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
