"""Tables of a report: events, outages, shares of the safety states, alignment, rejections; texts of numbers.

Repeated changes of one subject between two states are combined in one row of the events.
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from itertools import pairwise

import numpy as np

from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_replay.report.recording import RecordedHistory, RejectedMeasurement
from ship_watch.history.history import ParameterEstimate
from ship_watch.suite_state import ANGLES, Event, Safety

MIN_REPEATED = 6
"""Minimum number of changes between two states that are combined in one row: there and back, three times."""

MAX_INTERVAL_NS = 60 * NS_PER_S
"""Maximum time between two changes combined in one row, ns."""

_ORDER = ("IN", "OUT", "SAFE", "CAUTION", "UNSAFE", "VALID", "COASTING", "DEGRADED", "INVALID")
"""States of each kind, the better state first."""

_CHANGE = re.compile(r"(?:(?P<before>[\w/]+) → )?(?P<after>[\w/]+)(?:, (?P<reason>.*))?$")
_SOURCE_STATES = ("IN", "OUT")

_NEEDS = "needs "
"""Prefix of the reason for an outage that is caused by another source."""


def duration(seconds: float) -> str:
    """Return a duration for people: "1 h 02 min", "4 min 05 s", "12 s"."""
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


def number(value: float) -> str:
    """Return a value with three significant digits, or from 1000 on in whole numbers; a dash if it is not finite."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return text.replace("-", "−")


def rounded_to_sigma(value: float, sigma: float) -> str:
    """Return a value with as many decimals as its sigma justifies."""
    if not math.isfinite(value):
        return "–"
    places = 2 if not sigma > 0.0 else int(np.clip(1 - math.floor(math.log10(sigma)), 0, 6))
    return f"{value:.{places}f}".replace("-", "−")


def utc(time_ns: int, form: str = "%H:%M:%S") -> str:
    """Return a POSIX time in ns as UTC in whole seconds, by default with hours, minutes and seconds."""
    return datetime.fromtimestamp(time_ns // NS_PER_S, tz=timezone.utc).strftime(form)


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
            if len(run) >= MIN_REPEATED:
                rows.append((places[id(run[0])], _row(run)))
            else:
                rows += [(places[id(e)], EventRow(e.utc_ns, e.utc_ns, e.kind, e.subject, e.text)) for e in run]
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


@dataclass(frozen=True)
class SourceOutage:
    """An outage of a source.

    Attributes:
        source: name of the source.
        from_ns: beginning, UTC.
        to_ns: end, UTC; 0 if the source did not return.
        why: first reported reason.
    """

    source: str
    from_ns: int
    to_ns: int
    why: str

    @property
    def text(self) -> str:
        """Text of the outage for a sentence: "12:00:05 to 12:00:20 (no data)"."""
        return f"{utc(self.from_ns)} to {utc(self.to_ns) if self.to_ns else 'the end'} ({self.why})"


def outages(recording: RecordedHistory) -> list[SourceOutage]:
    """Return the outages of all sources; an outage whose reason changes counts as one outage."""
    found: list[SourceOutage] = []
    last: dict[str, int] = {}
    for event in recording.events:
        if event.kind != "source":
            continue
        number, is_out = last.get(event.subject), f"{event.subject} OUT" in event.text
        if is_out and number is None:
            last[event.subject] = len(found)
            found.append(SourceOutage(event.subject, event.utc_ns, 0, event.text.partition(", ")[2]))
        elif not is_out and number is not None:
            found[number] = replace(found[number], to_ns=event.utc_ns)
            del last[event.subject]
    return found


def root_outages(found: Sequence[SourceOutage]) -> list[SourceOutage]:
    """Return the outages that are not caused by another source."""
    return [outage for outage in found if not outage.why.startswith(_NEEDS)]


def outage_rows(recording: RecordedHistory) -> list[dict[str, str]]:
    """Return a row for each outage: source, from, to, length and reason."""
    _, end_ns = recording.span_ns
    return [
        {
            "source": one.source, "from": utc(one.from_ns), "to": utc(one.to_ns) if one.to_ns else "the end",
            "length": duration(((one.to_ns or end_ns) - one.from_ns) / NS_PER_S), "why": one.why,
        }
        for one in outages(recording)
    ]


def shares(recording: RecordedHistory) -> list[tuple[str, dict[str, float], Counter[Safety]]]:
    """Return angle, share of the time and number of seconds of each safety state, for each published angle."""
    rows = []
    for name in ANGLES:
        seconds = recording.seconds(name)
        if total := sum(seconds.values()):
            rows.append((name, {word.name: seconds[word] / total for word in Safety}, seconds))
    return rows


def alignment_changes(before: Sequence[ParameterEstimate], after: Sequence[ParameterEstimate]) -> list[dict[str, str]]:
    """Return a row for each parameter: first and last estimate with their σ, and the change in units of the first σ."""
    first = {shown.name: shown for shown in before}
    rows = []
    for shown in after:
        start = first.get(shown.name, shown)
        scale, unit = shown_scale(shown)
        (before_text, before_sigma), (after_text, after_sigma) = (estimate_texts(one, scale) for one in (start, shown))
        change = estimate_change(start, shown)
        rows.append({
            "name": shown.name,
            "unit": unit,
            "before": before_text,
            "before_sigma": before_sigma,
            "after": after_text,
            "after_sigma": after_sigma,
            "change": f"{change / start.sigma:+.1f} σ".replace("-", "−") if start.sigma > 0.0 else "",
            "note": "" if shown.is_observable else "not observable",
        })
    return rows


def estimate_texts(shown: ParameterEstimate, scale: float) -> tuple[str, str]:
    """Return value and σ of an estimate, divided by a scale; azimuths around 0 do not jump to 360°."""
    value = float(wrap_pi(shown.value)) if shown.unit == "rad" else shown.value
    return rounded_to_sigma(value / scale, shown.sigma / scale), number(shown.sigma / scale)


def estimate_change(first: ParameterEstimate, last: ParameterEstimate) -> float:
    """Return the difference of two estimates of a parameter, of angles from -pi to pi."""
    return float(wrap_pi(last.value - first.value)) if last.unit == "rad" else last.value - first.value


def rejection_rows(recording: RecordedHistory) -> list[dict[str, str]]:
    """Return a row for each source, place and reason: count, first and last time. Rejections come before notes."""
    return [
        {**rejection_cells(key), "count": f"{sum(one.count for one in rejections)}",
         "first": utc(min(one.utc_ns for one in rejections)), "last": utc(max(one.utc_ns for one in rejections))}
        for key, rejections in sorted(rejections_by_key(recording).items())
    ]


RejectionKey = tuple[bool, str, str, str]
"""True for a note, source, place and reason of rejections."""


def rejections_by_key(recording: RecordedHistory) -> dict[RejectionKey, list[RejectedMeasurement]]:
    """Return the rejections and notes of each source, place and reason."""
    found: dict[RejectionKey, list[RejectedMeasurement]] = {}
    for one in recording.rejections:
        found.setdefault((one.is_note, one.source, one.by, one.reason), []).append(one)
    return found


def rejection_cells(key: RejectionKey) -> dict[str, str]:
    """Return the first cells of a row of rejections: source, place and reason."""
    is_note, source, by, reason = key
    return {"source": source, "by": by, "reason": f"{reason} (note: used)" if is_note else reason}


def shown_scale(shown: ParameterEstimate) -> tuple[float, str]:
    """Return the divisor for display and the unit of the result."""
    if shown.unit == "rad":
        large = abs(float(wrap_pi(shown.value))) > math.radians(1.0)
        return (math.pi / 180.0, "deg") if large else (ARCSEC, "arcsec")
    return {"s": (1e-3, "ms"), "m": (1e-3, "mm")}.get(shown.unit, (1.0, shown.unit))
