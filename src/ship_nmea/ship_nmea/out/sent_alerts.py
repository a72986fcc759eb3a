"""Alerts as sent to the bridge: their numbers and revisions, and the alert that a command refers to."""

import dataclasses
import string
import zlib
from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import Any

from ship_bags.stamps import ns_from_stamp
from ship_nmea.sentences.alerts import (
    FIRST_IDENTIFIER,
    LAST_IDENTIFIER,
    MAX_ALERTS,
    MAX_INSTANCE,
    AlertCommand,
    SentenceAlert,
)

NORMAL = "N"

_PRIORITIES = "CWA"
_STATES = "NVSAU"
"""Letter of each priority and of each state of ship_msgs/Alert, in the order of its constants."""
_LAST_REVISION = 99
_LAST_ESCALATION = 9
_TITLE_LENGTH = 16


@dataclass(frozen=True)
class _Entry:
    """An alert as received and as sent."""

    key: tuple[Any, ...]
    id: str
    instance: int
    sent: SentenceAlert


class SentAlerts:
    """All alerts of the suite as sent to the bridge.

    The number of an alert follows from its id, so that the number is the same after a restart and on other ships. Only
    ids whose checksums give the same or adjacent numbers may exchange numbers. After a restart, revisions start at 1
    again.

    Attributes:
        omitted_count: number of alerts of the last message that are not sent, because there are more than MAX_ALERTS.
    """

    def __init__(self) -> None:
        self._entries: dict[int, _Entry] = {}
        self.omitted_count = 0

    @property
    def all(self) -> list[SentenceAlert]:
        """Return all alerts, the most urgent first."""
        return [entry.sent for entry in self._entries.values()]

    def update(self, alerts: Sequence[Any], now_ns: int) -> list[SentenceAlert]:
        """Return new and changed alerts, and alerts that no longer exist (with the state normal).

        An instance that is replaced by another instance is first returned as normal: the bridge identifies an alert by
        number and instance, and would keep both instances.

        Args:
            alerts: the ship_msgs/Alert of an AlertArray.
            now_ns: time at which the alerts that no longer exist became normal.
        """
        self.omitted_count = max(0, len(alerts) - MAX_ALERTS)
        before, now = self._entries, dict[int, _Entry]()
        changed = []
        for alert in alerts[:MAX_ALERTS]:
            number = _identifier(alert.id, now)
            former = before.get(number)
            entry = now[number] = _make_entry(number, alert, former)
            if former is not None and former.sent.instance != entry.sent.instance:
                changed.append(_normal_alert(former.sent, now_ns))
            if former is None or entry.key != former.key:
                changed.append(entry.sent)
        # Assigned at the end, so that a list that cannot be read changes nothing.
        self._entries = now
        return changed + [_normal_alert(entry.sent, now_ns) for number, entry in before.items() if number not in now]

    def alert_key(self, command: AlertCommand) -> tuple[str, int] | None:
        """Return id and instance of the alert of a command; None if there is no such alert.

        A command without an instance refers to the present instance. The alert node checks an instance that is given.
        """
        entry = self._entries.get(command.identifier)
        if entry is None:
            return None
        return entry.id, entry.instance if command.instance is None else command.instance

    def alert_of(self, command: AlertCommand) -> SentenceAlert | None:
        """Return the alert of a command as it was sent; None if there is no such alert."""
        entry = self._entries.get(command.identifier)
        return None if entry is None else entry.sent


def _identifier(id_: str, used: Container[int]) -> int:
    """Return the number of an alert from its id; if another alert of the list has this number, the next free number."""
    count = LAST_IDENTIFIER - FIRST_IDENTIFIER + 1
    number = zlib.crc32(id_.encode()) % count
    while (FIRST_IDENTIFIER + number) in used:
        number = (number + 1) % count
    return FIRST_IDENTIFIER + number


def _normal_alert(alert: SentenceAlert, now_ns: int) -> SentenceAlert:
    return dataclasses.replace(alert, state=NORMAL, changed_ns=now_ns, revision=alert.revision % _LAST_REVISION + 1)


def _make_entry(number: int, alert: Any, before: _Entry | None) -> _Entry:
    changed_ns = ns_from_stamp(alert.changed)
    key = alert.id, alert.instance, alert.priority, alert.state, alert.text, changed_ns
    if before is not None and before.key == key:
        return before
    priority = _PRIORITIES[alert.priority]
    revision, escalation = 1, 0
    if before is not None:
        revision = before.sent.revision % _LAST_REVISION + 1
        is_escalated = _PRIORITIES.index(priority) > _PRIORITIES.index(before.sent.priority)
        # A more urgent alert is another instance (docs/explanation/alerts.md). Another instance that is not more urgent
        # has escalation 0.
        if is_escalated or before.instance == alert.instance:
            escalation = min(before.sent.escalation + is_escalated, _LAST_ESCALATION)
    instance = (alert.instance - 1) % MAX_INSTANCE + 1
    sent = SentenceAlert(
        number, instance, revision, escalation, priority, _STATES[alert.state], changed_ns, _title(alert.id),
        alert.text,
    )  # fmt: skip
    return _Entry(key, alert.id, alert.instance, sent)


def _title(id_: str) -> str:
    """Return all words of an id; if too long, the longest word is shortened by its last letter until the title fits.

    For example, "attitude.degraded" is ATTITUD DEGRADED and "star.starboard2.out" is STAR STARBO2 OUT. A number at the
    end of a word is kept, because it distinguishes two devices.
    """
    words = id_.upper().replace("_", " ").replace(".", " ").split()
    while len(" ".join(words)) > _TITLE_LENGTH and (longest := max(map(_length_without_number, words), default=0)) > 1:
        at = next(at for at, word in enumerate(words) if _length_without_number(word) == longest)
        words[at] = words[at][: longest - 1] + words[at][longest:]
    return " ".join(words)


def _length_without_number(word: str) -> int:
    """Return the length of a word without the number at its end."""
    return len(word.rstrip(string.digits))
