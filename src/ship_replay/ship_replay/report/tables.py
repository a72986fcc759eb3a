"""Tables of a report: outages, shares of the safety states, alignment, rejections."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC, wrap_pi
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.wording import duration, number, rounded_to_sigma, utc
from ship_watch.history.history import ParameterEstimate
from ship_watch.suite_state import ANGLES, Safety

_NEEDS = "needs "
"""Prefix of the reason for an outage that is caused by another source."""


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
        change = float(wrap_pi(shown.value - start.value)) if shown.unit == "rad" else shown.value - start.value
        rows.append({
            "name": shown.name,
            "unit": unit,
            "before": rounded_to_sigma(shown_value(start) / scale, start.sigma / scale),
            "before_sigma": number(start.sigma / scale),
            "after": rounded_to_sigma(shown_value(shown) / scale, shown.sigma / scale),
            "after_sigma": number(shown.sigma / scale),
            "change": f"{change / start.sigma:+.1f} σ".replace("-", "−") if start.sigma > 0.0 else "",
            "note": "" if shown.is_observable else "not observable",
        })
    return rows


def rejection_rows(recording: RecordedHistory) -> list[dict[str, str]]:
    """Return a row for each source, place and reason: count, first and last time. Rejections come before notes."""
    counts: Counter[tuple[bool, str, str, str]] = Counter()
    times: dict[tuple[bool, str, str, str], tuple[int, int]] = {}
    for refusal in recording.rejections:
        key = refusal.is_note, refusal.source, refusal.by, refusal.reason
        first, last = times.get(key, (refusal.utc_ns, refusal.utc_ns))
        counts[key] += refusal.count
        times[key] = min(first, refusal.utc_ns), max(last, refusal.utc_ns)
    return [
        {
            "source": key[1], "by": key[2], "reason": key[3] + (" (note: used)" if key[0] else ""),
            "count": f"{counts[key]}", "first": utc(times[key][0]), "last": utc(times[key][1]),
        }
        for key in sorted(counts)
    ]


def shown_value(shown: ParameterEstimate) -> float:
    """Return the value of a parameter; angles from -pi to pi, so that azimuths around 0 do not jump to 360°."""
    return float(wrap_pi(shown.value)) if shown.unit == "rad" else shown.value


def shown_scale(shown: ParameterEstimate) -> tuple[float, str]:
    """Return the divisor for display and the unit of the result."""
    if shown.unit == "rad":
        large = abs(float(wrap_pi(shown.value))) > math.radians(1.0)
        return (math.pi / 180.0, "deg") if large else (ARCSEC, "arcsec")
    return {"s": (1e-3, "ms"), "m": (1e-3, "mm")}.get(shown.unit, (1.0, shown.unit))
