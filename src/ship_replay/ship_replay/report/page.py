"""The report page of one recording.

The page begins with a summary in five sentences: availability, worst source, causes, mountings, what to do.
"""

import json
import math
import platform
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ship_bags.command_line import with_count
from ship_bags.provenance import COMMIT_RECORD, LIBRARIES, SUITE_PACKAGES, package_versions, suite_commit
from ship_bags.stamps import NS_PER_S
from ship_geometry.rotations import ARCSEC
from ship_node.black_box.black_box_format import VERSIONS_ATTACHMENT
from ship_node.pages.html_page import render
from ship_replay.evaluation.evaluate import Evaluation
from ship_replay.evaluation.tables import STATISTICS
from ship_replay.report.consistency import SigmaFit, consistency
from ship_replay.report.drawings import (
    MARK_ID_PREFIX,
    budget_svg,
    errors_svg,
    rejections_svg,
    source_colours,
    status_svg,
)
from ship_replay.report.recording import RecordedHistory, ReportData
from ship_replay.report.tables import (
    SourceOutage,
    alignment_changes,
    duration,
    event_rows,
    number,
    outage_rows,
    outages,
    rejection_rows,
    root_outages,
    shares,
    states_of,
    utc,
)
from ship_watch.suite_state import ANGLES, Safety

_MOST_NAMED = 3
_SHIFTED = "mounting shifted by"
_MUCH_CHANGED_SIGMAS = 3.0
_ADVISED = 2
_CONSEQUENCE_SUFFIX = ".degraded"
"""Suffix of the id of an alert about an output over its limit; the source that is the cause has a separate alert."""

SECTIONS = (
    ("verdict", "Summary"),
    ("status", "Status over time"),
    ("errors", "Errors with their ±3σ"),
    ("budget", "Error budget over time"),
    ("consistency", "NIS and NEES"),
    ("alignment", "Alignment before and after"),
    ("alerts", "Alerts"),
    ("events", "Events"),
    ("refusals", "Rejections by reason and time"),
    ("inputs", "Inputs"),
    ("configuration", "Configuration"),
    ("provenance", "Versions and hash of the bag"),
)
"""Ids and titles of the sections, in order."""

_PACKAGES = (
    *SUITE_PACKAGES, "ship_attitude_star", "theodolite_calib", "ship_watch", "ship_replay",
    *LIBRARIES, "scipy", "matplotlib",
)


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


def page(report_data: ReportData) -> str:
    """Return the report of one recording as a single HTML file; the same recording gives the same text."""
    recording, evaluation = report_data.recording, report_data.evaluation
    start_ns = recording.start_utc_ns
    events, colours = event_rows(recording.events), source_colours(recording, evaluation)
    drawings: dict[str, Callable[[], Any]] = {
        "status": partial(status_svg, recording, [row.from_ns // NS_PER_S for row in events]),
        "errors": partial(errors_svg, evaluation, colours),
        "refusals": partial(rejections_svg, recording, colours),
        **{topic: partial(budget_svg, topic, points, start_ns) for topic, points in sorted(recording.budgets.items())},
    }
    drawn = {name: draw() for name, draw in with_count(drawings.items(), "drawing", len(drawings))}
    return render(
        Path(__file__).with_name("report.html.j2"),
        sections=SECTIONS,
        night=recording,
        title=recording.path.name,
        **period_texts(start_ns, start_ns + recording.end_ns - recording.start_ns),
        verdict=summary(recording),
        outages=outage_rows(recording),
        events=[
            ((row.when, f"#status-{MARK_ID_PREFIX}{row.from_ns // NS_PER_S}") if drawn["status"] else row.when,
             row.kind, row.text)
            for row in events
        ],
        shares=[
            [name, *(f"{100.0 * share[word.name]:.1f} %" for word in Safety),
             f"{round(recording.limits.angle_limit(name) / ARCSEC, 3):g}″"]
            for name, share, _ in shares(recording)
        ],
        errors=list(_error_rows(evaluation)),
        consistency=[_consistency_row(fit) for fit in consistency(evaluation)],
        status=drawn["status"],
        drawn_errors=drawn["errors"],
        budgets=[(topic, drawn[topic]) for topic in sorted(recording.budgets)],
        alignment=[
            (topic, alignment_changes(recording.first_estimates[topic], recording.last_estimates[topic]))
            for topic in sorted(recording.last_estimates)
        ],
        alerts=[
            (utc(row.utc_ns), row.alert.priority.name, row.alert.id, row.what, row.alert.text)
            for row in recording.alerts
        ],
        refusals=rejection_rows(recording),
        refusal_drawing=drawn["refusals"],
        inputs=[
            (shown.topic, number(shown.rate_hz), number(shown.latency_s), number(shown.age_s))
            for shown in (recording.last.inputs if recording.last is not None else ())
        ],
        suite=recording.attached_texts,
        provenance=[
            ("bag", recording.path.name), ("SHA-256", recording.sha256), *metadata_texts(recording).items(),
        ],
        versions=versions(),
        recorded_versions=recorded_versions(recording),
        left_out=[problem for problem in evaluation.problems if problem not in recording.problems],
    )


def period_texts(start_ns: int, end_ns: int) -> dict[str, str]:
    """Return the texts of a period below the title of a page, from its first and last time in UTC."""
    length = duration((end_ns - start_ns) / NS_PER_S)
    return {"date": utc(start_ns, "%Y-%m-%d"), "start": utc(start_ns), "end": utc(end_ns), "length": length}


def metadata_texts(recording: RecordedHistory) -> dict[str, str]:
    """Return the metadata of a bag as text, by name in alphabetical order."""
    return {
        name: " ".join(f"{key} {value}" for key, value in sorted(entries.items()))
        for name, entries in sorted(recording.metadata.items())
    }


def _error_rows(evaluation: Evaluation) -> Iterator[list[str]]:
    for series in evaluation.errors:
        values = series.statistics()
        for channel in series.channels:
            first = channel == series.channels[0]
            numbers = (values[f"{channel}.{name}"] for name in STATISTICS)
            yield [
                series.label if first else "", channel, *map(number, numbers),
                str(len(series.time_ns)) if first else "",
            ]


def _consistency_row(fit: SigmaFit) -> list[str]:
    independent = number(fit.independent) if fit.kind == "NEES" else ""
    minutes = " / ".join(map(str, fit.minutes.values()))
    numbers = number(fit.mean), number(fit.degrees), number(fit.ratio), str(fit.count)
    return [fit.kind, fit.name, *numbers, independent, minutes, fit.words]


def versions() -> list[tuple[str, str]]:
    """Return the versions of the suite and of the libraries with which the report is made."""
    own = suite_commit() or "unknown: no git checkout"
    return [("suite, commit", own), ("python", platform.python_version()), *package_versions(_PACKAGES).items()]


def recorded_versions(recording: RecordedHistory) -> list[tuple[str, str]]:
    """Return the commit of the suite that made the bag, and the versions in a black box; empty if both are missing."""
    commit = recording.metadata.get(COMMIT_RECORD, {}).get("commit", "")
    of_commit = [("suite, commit", commit)] if commit else []
    try:
        versions_there = json.loads(recording.attachments.get(VERSIONS_ATTACHMENT, b"{}"))
        return (
            of_commit
            + [(name, str(versions_there[name])) for name in ("python", "machine") if name in versions_there]
            + [
                (name, str(version))
                for group in ("suite", "libraries")
                for name, version in versions_there.get(group, {}).items()
            ]
        )
    except (ValueError, AttributeError, TypeError):
        return of_commit  # the versions in the black box are damaged
