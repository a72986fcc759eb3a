"""The page of two recordings side by side."""

from collections.abc import Mapping
from pathlib import Path

from ship_node.pages.html_page import render
from ship_replay.comparison.configurations import parameter_differences, text_differences
from ship_replay.comparison.pair import Pair
from ship_replay.comparison.pair_drawings import difference_svg, sides_svg, states_svg
from ship_replay.comparison.pair_summary import pair_summary
from ship_replay.comparison.pair_tables import (
    alerts_of_one,
    alignment_tables,
    budget_tables,
    consistency_rows,
    difference_rows,
    error_rows,
    events_of_one,
    rejection_rows_of_both,
)
from ship_replay.comparison.pair_warnings import pair_warnings
from ship_replay.report.page import metadata_texts, period_texts, recorded_versions, versions
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.tables import shares
from ship_replay.report.wording import number, utc
from ship_watch.suite_state import ANGLES, Safety

PAIR_SECTIONS = (
    ("verdict", "Summary"),
    ("states", "States"),
    ("difference", "Output differences"),
    ("errors", "Errors with their ±3σ"),
    ("budget", "Error budget"),
    ("consistency", "NIS and NEES"),
    ("alignment", "Alignment at the end"),
    ("alerts", "Alerts in one run only"),
    ("events", "Events in one run only"),
    ("refusals", "Rejections by reason"),
    ("configuration", "Configuration"),
    ("provenance", "Versions and hashes"),
)
"""Ids and titles of the sections, in order."""

_DATE_TIME = "%Y-%m-%d %H:%M:%S"


def pair_page(pair: Pair) -> str:
    """Return the comparison of two recordings as a single HTML file; the same recordings give the same text."""
    a, b = pair.recordings
    parameters, errors = parameter_differences(a, b), error_rows(pair)
    warnings = pair_warnings(pair, _problems(pair))
    warned = [warning.what for warning in warnings]
    return render(
        Path(__file__).with_name("compare.html.j2"),
        sections=PAIR_SECTIONS,
        a=a,
        b=b,
        title="A and B side by side",
        **period_texts(*pair.span_ns),
        differing=lambda rows: [row for row in rows if row[1::2] != row[2::2]],
        verdict=[text for text in pair_summary(pair, errors, parameters) if text not in warned],
        warnings=warnings,
        shares=_shares_of_both(a, b),
        states=states_svg(pair),
        differences=difference_rows(pair.differences),
        difference_drawings=[
            difference_svg(found, pair.span_ns) for found in pair.differences if not all(found.channels_equal)
        ],
        sides=sides_svg(pair),
        errors=[
            ["" if previous is not None and previous.label == row.label else row.label, row.name,
             *map(number, row.rms), f"{row.ratio:.2f}", *map(number, row.size_95), *row.samples]
            for previous, row in zip([None, *errors], errors, strict=False)
        ],
        budgets=budget_tables(pair),
        consistency=consistency_rows(pair),
        alignment=alignment_tables(pair),
        alerts=alerts_of_one(pair),
        events=events_of_one(pair),
        refusals=rejection_rows_of_both(pair),
        parameters=parameters,
        texts=text_differences(a, b),
        provenance=[
            ("bag", a.path.name, b.path.name),
            ("SHA-256", a.sha256, b.sha256),
            ("first and last message, UTC", *(
                f"{utc(night.start_ns, _DATE_TIME)} to {utc(night.end_ns, _DATE_TIME)}" for night in (a, b)
            )),
            *_rows_of_both(*map(metadata_texts, (a, b))),
            ("topics in this bag only", *(
                ", ".join(sorted(mine.topics.keys() - other.topics.keys())) or "none"
                for mine, other in ((a, b), (b, a))
            )),
        ],
        recorded_versions=_rows_of_both(*(dict(recorded_versions(night)) for night in (a, b))),
        versions=versions(),
    )


def _problems(pair: Pair) -> list[str]:
    """Return the problems of the bags, each preceded by the letters of the bags with this problem."""
    found: dict[str, str] = {}
    for letter, report_data in zip("AB", (pair.a, pair.b), strict=True):
        for problem in sorted({*report_data.recording.problems, *report_data.evaluation.problems}):
            found[problem] = f"{found[problem]} and {letter}" if problem in found else letter
    return [f"{letters}: {problem}" for problem, letters in found.items()]


def _shares_of_both(a: RecordedHistory, b: RecordedHistory) -> list[list[str]]:
    """Return angle, and shares of each safety state in A and in B; a dash where the angle was not published."""
    of_a, of_b = ({name: share for name, share, _ in shares(recording)} for recording in (a, b))
    return [
        [name, *(
            f"{100.0 * of_run[name][word.name]:.1f} %" if name in of_run else "–"
            for word in Safety for of_run in (of_a, of_b)
        )]
        for name in ANGLES if name in of_a or name in of_b
    ]


def _rows_of_both(a: Mapping[str, str], b: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return each name with its values in A and in B; a missing value is empty."""
    return [(name, a.get(name, ""), b.get(name, "")) for name in dict.fromkeys([*a, *b])]
