"""First five sentences of a report: availability, worst source, causes, mountings, what to do."""

import math
import re
from collections import Counter
from collections.abc import Sequence

from ship_bags.stamps import NS_PER_S
from ship_replay.report.event_groups import states_of
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.tables import SourceOutage, outages, root_outages
from ship_replay.report.wording import duration, number, utc
from ship_watch.suite_state import ANGLES, Safety

_MOST_NAMED = 3
_SHIFTED = "mounting shifted by"
_MUCH_CHANGED_SIGMAS = 3.0
_ADVISED = 2
_CONSEQUENCE_SUFFIX = ".degraded"
"""Suffix of the id of an alert about an output over its limit; the source that is the cause has a separate alert."""


def summary(recording: RecordedHistory) -> list[str]:
    """Return the five sentences; a single sentence if neither an attitude nor a pointing was published."""
    if not any(recording.safety_states.get(name) for name in ANGLES):
        return ["Availability: no attitude and no pointing was published."]
    found = outages(recording)
    return [
        _availability_sentence(recording),
        _worst_source_sentence(recording, found),
        _cause_sentence(recording, found),
        _mounting_sentence(recording),
        _advice_sentence(recording),
    ]


def worst_source(recording: RecordedHistory) -> str:
    """Return the source that was out longest in all, not counting outages by another source; empty if there is none."""
    seconds = _seconds_out(recording, root_outages(outages(recording)))
    return max(seconds, key=lambda source: seconds[source], default="")


def valid_shares(recording: RecordedHistory) -> dict[str, float]:
    """Return topic of an output → share of the recording's length in which the output was VALID."""
    length_s = max((recording.end_ns - recording.start_ns) / NS_PER_S, 1e-9)
    return {
        topic: min(seconds.get("VALID", 0.0) / length_s, 1.0) for topic, seconds in sorted(recording.status_s.items())
    }


def _availability_sentence(recording: RecordedHistory) -> str:
    parts = [
        f"{name} SAFE {100.0 * seconds[Safety.SAFE] / total:.1f} %"
        for name in ANGLES if (total := (seconds := recording.seconds(name)).total())
    ]
    parts += [f"{topic} VALID {100.0 * share:.1f} %" for topic, share in valid_shares(recording).items()]
    return f"Availability: {', '.join(parts)} of the time."


def _worst_source_sentence(recording: RecordedHistory, found: Sequence[SourceOutage]) -> str:
    roots = root_outages(found)
    source = worst_source(recording)
    if not source:
        return "Worst source: none; no source was out."
    mine = [outage for outage in roots if outage.source == source]
    seconds = _seconds_out(recording, mine)[source]
    share = 100.0 * seconds / max((recording.end_ns - recording.start_ns) / NS_PER_S, 1e-9)
    times = "once" if len(mine) == 1 else f"{len(mine)} times"
    length = f"{duration(seconds)} in all ({share:.0f} % of the time)"
    return f"Worst source: {source}, out {times}, {length}, {mine[0].text}."


def _cause_sentence(recording: RecordedHistory, found: Sequence[SourceOutage]) -> str:
    """Return the sentence about up to three sources that failed, and the sources and angles affected by each."""
    roots = list(dict.fromkeys(outage.source for outage in root_outages(found)))
    if not roots:
        unsafe = [name for name in ANGLES if _was_not_always_safe(recording, name)]
        return f"Cause: no source failed; {_joined_names(unsafe)} not SAFE because of accuracy." if unsafe else \
            "Cause: nothing failed."
    texts = []
    for source in roots[:_MOST_NAMED]:
        first = next(outage for outage in root_outages(found) if outage.source == source)
        needs = [one.source for one in found if one.why.startswith(f"needs {source}")]
        angles = [
            event.subject for event in recording.events
            if event.kind == "state" and states_of(event)[1] in ("CAUTION", "UNSAFE")
            and re.search(rf"(^|\W){re.escape(source)}(\W|$)", states_of(event)[2])
        ]
        effects = [f"{_joined_names(list(dict.fromkeys(angles)))} not SAFE"] if angles else []
        effects += [f"{_joined_names(list(dict.fromkeys(needs)))} not usable"] if needs else []
        consequence = f" → {', '.join(effects)}" if effects else ""
        texts.append(f"{source} out at {utc(first.from_ns)} ({first.why}){consequence}")
    more = f"; {len(roots) - _MOST_NAMED} more in the table" if len(roots) > _MOST_NAMED else ""
    return f"Cause → consequence: {'; '.join(texts)}{more}."


def _mounting_sentence(recording: RecordedHistory) -> str:
    """Return the sentence about shifted mountings, or about estimates far from their first values."""
    shifted = [event for event in recording.events if event.kind == "source" and _SHIFTED in event.text]
    if shifted:
        return f"Mountings: {'; '.join(f'{event.text} at {utc(event.utc_ns)}' for event in shifted[:_MOST_NAMED])}."
    changed: dict[str, float] = {}
    for topic, after in recording.last_estimates.items():
        before = {shown.name: shown for shown in recording.first_estimates[topic]}
        for shown in after:
            start = before.get(shown.name, shown)
            sigmas = abs(math.remainder(shown.value - start.value, math.tau)) / start.sigma if (
                shown.unit == "rad" and start.sigma > 0.0) else 0.0
            if sigmas > _MUCH_CHANGED_SIGMAS:
                changed[shown.name] = sigmas
    if not changed:
        return "Mountings: no shift; all estimates stayed within 3σ of their first values."
    worst = sorted(changed, key=lambda name: -changed[name])[:_MOST_NAMED]
    texts = [f"{name} changed by {number(changed[name])} σ" for name in worst]
    return f"Mountings: no source was reinstated with a shifted mounting, but {', '.join(texts)}."


def _advice_sentence(recording: RecordedHistory) -> str:
    """Return the sentence with the first two advices of the raised alerts, causes first, then by priority."""
    raised = [record.alert for record in recording.alerts if record.what in ("raised", "active not acknowledged")]
    raised.sort(key=lambda alert: (alert.id.endswith(_CONSEQUENCE_SUFFIX), -int(alert.priority)))
    texts = [
        f"{alert.source or alert.id}: {alert.advice[:1].lower()}{alert.advice[1:]}" for alert in raised if alert.advice
    ]
    kept = list(dict.fromkeys(texts))[:_ADVISED]
    return f"To do: {'. '.join(kept)}." if kept else "To do: nothing."


def _seconds_out(recording: RecordedHistory, found: Sequence[SourceOutage]) -> Counter[str]:
    _, end_ns = recording.span_ns
    seconds: Counter[str] = Counter()
    for outage in found:
        # Whole seconds are precise enough.
        seconds[outage.source] += round(((outage.to_ns or end_ns) - outage.from_ns) / NS_PER_S)
    return seconds


def _was_not_always_safe(recording: RecordedHistory, name: str) -> bool:
    """True if an angle was published and not always SAFE."""
    seconds = recording.seconds(name)
    return seconds.total() > seconds[Safety.SAFE]


def _joined_names(names: Sequence[str]) -> str:
    return " and ".join(([", ".join(names[:-1])] if len(names) > 1 else []) + list(names[-1:]))
