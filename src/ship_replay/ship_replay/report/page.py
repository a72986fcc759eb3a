"""The report page of one recording."""

import json
import platform
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jinja2

from ship_bags.progress import with_count
from ship_bags.stamps import NS_PER_S
from ship_bags.suite_commit import COMMIT_RECORD, suite_commit
from ship_node.black_box.black_box_format import VERSIONS_ATTACHMENT
from ship_node.black_box.versions import LIBRARIES, SUITE_PACKAGES, package_versions
from ship_replay.report.consistency import consistency
from ship_replay.report.drawings import budget_svg, errors_svg, rejections_svg, source_colours, status_svg
from ship_replay.report.event_groups import event_rows
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.report_data import ReportData
from ship_replay.report.summary import summary
from ship_replay.report.tables import alignment_changes, outage_rows, rejection_rows, shares
from ship_replay.report.wording import duration, number, utc

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
    *SUITE_PACKAGES, "ship_stars", "ship_attitude_star", "theodolite_calib", "ship_watch", "ship_replay",
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
        "report.html.j2",
        sections=SECTIONS,
        night=recording,
        title=recording.path.name,
        date=utc(start_ns, "%Y-%m-%d"),
        start=utc(start_ns),
        end=utc(start_ns + recording.end_ns - recording.start_ns),
        length=duration((recording.end_ns - recording.start_ns) / NS_PER_S),
        verdict=summary(recording),
        outages=outage_rows(recording),
        events=events,
        shares=shares(recording),
        evaluation=evaluation,
        errors=[(series, series.statistics()) for series in evaluation.errors],
        consistency=consistency(evaluation),
        status=drawn["status"],
        drawn_errors=drawn["errors"],
        budgets=[(topic, drawn[topic]) for topic in sorted(recording.budgets)],
        alignment=[
            (topic, alignment_changes(recording.first_estimates[topic], recording.last_estimates[topic]))
            for topic in sorted(recording.last_estimates)
        ],
        refusals=rejection_rows(recording),
        refusal_drawing=drawn["refusals"],
        suite={
            name: data.decode(errors="replace")
            for name, data in sorted(recording.attachments.items())
            if name.endswith((".yaml", ".yml"))
        },
        versions=versions(),
        recorded_versions=recorded_versions(recording),
        problems=recording.problems,
        left_out=[problem for problem in evaluation.problems if problem not in recording.problems],
    )


def _draw_all(drawings: Mapping[str, Callable[[], Any]]) -> dict[str, Any]:
    """Draw the figures of a page, with progress on stderr."""
    return {name: draw() for name, draw in with_count(drawings.items(), "drawing", len(drawings))}


def render(template: str, **values: Any) -> str:
    """Fill a template of this package."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ship_replay", "report"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )
    environment.filters |= {"utc": utc, "number": number, "percent": lambda share: f"{100.0 * share:.0f} %"}
    return environment.get_template(template).render(**values)


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
