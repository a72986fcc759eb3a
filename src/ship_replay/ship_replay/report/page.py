"""The report page of one recording."""

import json
import platform
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from ship_bags.progress import with_count
from ship_bags.stamps import NS_PER_S
from ship_bags.suite_commit import COMMIT_RECORD, suite_commit
from ship_geometry.rotations import ARCSEC
from ship_node.black_box.black_box_format import VERSIONS_ATTACHMENT
from ship_node.black_box.versions import LIBRARIES, SUITE_PACKAGES, package_versions
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
from ship_replay.report.event_groups import EventRow, event_rows
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.report_data import ReportData
from ship_replay.report.summary import summary
from ship_replay.report.tables import alignment_changes, outage_rows, rejection_rows, shares
from ship_replay.report.wording import duration, number, utc
from ship_watch.suite_state import Safety

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


def page(report_data: ReportData) -> str:
    """Return the report of one recording as a single HTML file; the same recording gives the same text."""
    recording, evaluation = report_data.recording, report_data.evaluation
    start_ns = recording.start_utc_ns
    events, colours = event_rows(recording.events), source_colours(recording, evaluation)
    drawn = _draw_all({
        "status": partial(status_svg, recording, [row.from_ns // NS_PER_S for row in events]),
        "errors": partial(errors_svg, evaluation, colours),
        "refusals": partial(rejections_svg, recording, colours),
        **{topic: partial(budget_svg, topic, points, start_ns) for topic, points in sorted(recording.budgets.items())},
    })
    return render(
        Path(__file__).with_name("report.html.j2"),
        sections=SECTIONS,
        night=recording,
        title=recording.path.name,
        **period_texts(start_ns, start_ns + recording.end_ns - recording.start_ns),
        verdict=summary(recording),
        outages=outage_rows(recording),
        events=[(_linked_time(row) if drawn["status"] else row.when, row.kind, row.text) for row in events],
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
        suite={
            name: data.decode(errors="replace")
            for name, data in sorted(recording.attachments.items())
            if name.endswith((".yaml", ".yml"))
        },
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


def _linked_time(row: EventRow) -> tuple[str, str]:
    return row.when, f"#status-{MARK_ID_PREFIX}{row.from_ns // NS_PER_S}"


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


def _draw_all(drawings: Mapping[str, Callable[[], Any]]) -> dict[str, Any]:
    """Draw the figures of a page, with progress on stderr."""
    return {name: draw() for name, draw in with_count(drawings.items(), "drawing", len(drawings))}


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
