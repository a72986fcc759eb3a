"""Events of a report, with repeated changes of one subject between two states combined in one row."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from ship_bags.stamps import NS_PER_S
from ship_replay.report.wording import duration, utc
from ship_watch.suite_state import Event

MIN_REPEATED = 6
"""Minimum number of changes between two states that are combined in one row: there and back, three times."""

MAX_INTERVAL_NS = 60 * NS_PER_S
"""Maximum time between two changes combined in one row, ns."""

_ORDER = ("IN", "OUT", "SAFE", "CAUTION", "UNSAFE", "VALID", "COASTING", "DEGRADED", "INVALID")
"""States of each kind, the better state first."""

_CHANGE = re.compile(r"(?:(?P<before>[\w/]+) → )?(?P<after>[\w/]+)(?:, (?P<reason>.*))?$")
_SOURCE_STATES = ("IN", "OUT")


@dataclass(frozen=True)
class EventRow:
    """One row of the events: a single event, or repeated changes between two states.

    Attributes:
        from_ns: time of the event or of the first change, UTC.
        to_ns: time of the last change.
        kind: kind of the events.
        subject: subject of the events.
        text: text for people.
        count: number of events in the row.
    """

    from_ns: int
    to_ns: int
    kind: str
    subject: str
    text: str
    count: int = 1

    @property
    def when(self) -> str:
        """Time of the event, or times of the first and last change, in UTC."""
        return utc(self.from_ns) if self.count == 1 else f"{utc(self.from_ns)}–{utc(self.to_ns)}"


def event_rows(events: Sequence[Event]) -> list[EventRow]:
    """Return the rows in order of time, with repeated changes of one subject between the same two states combined."""
    by_subject: dict[tuple[str, str], list[Event]] = {}
    for event in events:
        by_subject.setdefault((event.kind, event.subject), []).append(event)
    rows: list[tuple[int, EventRow]] = []
    places = {id(event): place for place, event in enumerate(events)}
    for of_subject in by_subject.values():
        for run in _runs(of_subject):
            shown = [_row(run)] if len(run) >= MIN_REPEATED else [_single_row(event) for event in run]
            rows += [(places[id(event)], row) for event, row in zip(run, shown, strict=False)]
    return [row for _, row in sorted(rows, key=lambda entry: (entry[1].from_ns, entry[0]))]


def states_of(event: Event) -> tuple[str, str, str]:
    """Return state before, state after and reason of an event; a missing text is empty."""
    rest = event.text.removeprefix(event.subject).lstrip()
    found = _CHANGE.match(rest)
    if found is None:
        return "", "", ""
    before, after, reason = (found[name] or "" for name in ("before", "after", "reason"))
    if event.kind == "source":
        if after not in _SOURCE_STATES:
            return "", "", ""
        before = _SOURCE_STATES[after == "IN"]
    return before, after, reason


def _runs(events: Sequence[Event]) -> list[list[Event]]:
    """Split the events of one subject into runs that alternate between two states."""
    runs: list[list[Event]] = []
    pair: frozenset[str] = frozenset()
    last, last_ns = "", 0
    for event in events:
        before, after, _ = states_of(event)
        here = frozenset((before, after))
        is_soon = event.utc_ns - last_ns <= MAX_INTERVAL_NS
        if runs and before and is_soon and here == pair and before == last:
            runs[-1].append(event)
        else:
            runs.append([event])
        pair, last, last_ns = (here, after, event.utc_ns) if before else (frozenset(), "", 0)
    return runs


def _row(run: Sequence[Event]) -> EventRow:
    first, last = run[0], run[-1]
    better, worse = sorted(states_of(first)[:2], key=lambda word: _ORDER.index(word) if word in _ORDER else len(_ORDER))
    reasons = Counter(reason for event in run if (reason := states_of(event)[2])).most_common()
    stays_s = [
        (later.utc_ns - event.utc_ns) / NS_PER_S for event, later in pairwise(run) if states_of(event)[1] == worse
    ]
    because = f" ({reasons[0][0]}{' and others' if len(reasons) > 1 else ''})" if reasons else ""
    times = sum(states_of(event)[1] == worse for event in run)
    text = f"{first.subject} {better} ↔ {worse}{because}, {times} times, longest {worse} {duration(max(stays_s))}"
    return EventRow(first.utc_ns, last.utc_ns, first.kind, first.subject, text, len(run))


def _single_row(event: Event) -> EventRow:
    return EventRow(event.utc_ns, event.utc_ns, event.kind, event.subject, event.text)
