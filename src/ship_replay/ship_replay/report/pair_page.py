"""The page of two recordings side by side."""

from collections.abc import Mapping

from ship_bags.stamps import NS_PER_S
from ship_replay.report.configurations import parameter_differences, text_differences
from ship_replay.report.page import recorded_versions, render, versions
from ship_replay.report.pair import Pair
from ship_replay.report.pair_drawings import difference_svg, sides_svg, states_svg
from ship_replay.report.pair_summary import pair_summary
from ship_replay.report.pair_tables import (
    alerts_of_one,
    alignment_tables,
    budget_tables,
    consistency_rows,
    difference_rows,
    error_rows,
    events_of_one,
    rejection_rows_of_both,
)
from ship_replay.report.pair_warnings import pair_warnings
from ship_replay.report.recording import RecordedHistory
from ship_replay.report.tables import shares
from ship_replay.report.wording import duration, utc
from ship_watch.suite_state import ANGLES

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


def pair_page(pair: Pair) -> str:
    """Return the comparison of two recordings as a single HTML file; the same recordings give the same text."""
    a, b = pair.recordings
    start_ns, end_ns = pair.span_ns
    parameters, errors = parameter_differences(a, b), error_rows(pair)
    warnings = pair_warnings(pair, _problems(pair))
    warned = [warning.what for warning in warnings]
    return render(
        "compare.html.j2",
        sections=PAIR_SECTIONS,
        pair=pair,
        a=a,
        b=b,
        title="A and B side by side",
        date=utc(start_ns, "%Y-%m-%d"),
        start=utc(start_ns),
        end=utc(end_ns),
        length=duration((end_ns - start_ns) / NS_PER_S),
        verdict=[text for text in pair_summary(pair, errors, parameters) if text not in warned],
        warnings=warnings,
        shares=_shares_of_both(a, b),
        states=states_svg(pair),
        differences=difference_rows(pair.differences),
        difference_drawings=[
            difference_svg(found, pair.span_ns) for found in pair.differences if not all(found.channels_equal)
        ],
        sides=sides_svg(pair),
        errors=errors,
        budgets=budget_tables(pair),
        consistency=consistency_rows(pair),
        alignment=alignment_tables(pair),
        alerts=alerts_of_one(pair),
        events=events_of_one(pair),
        refusals=rejection_rows_of_both(pair),
        parameters=parameters,
        texts=text_differences(a, b),
        only_topics=[(letter, sorted(mine.keys() - others.keys()))
                     for letter, mine, others in (("A", a.topics, b.topics), ("B", b.topics, a.topics))],
        metadata=_rows_of_both(*({name: " ".join(f"{key} {value}" for key, value in sorted(entries.items()))
                             for name, entries in sorted(recording.metadata.items())} for recording in (a, b))),
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


def _shares_of_both(
    a: RecordedHistory, b: RecordedHistory
) -> list[tuple[str, dict[str, float] | None, dict[str, float] | None]]:
    """Return angle, and shares of the safety states in A and in B; None where the angle was not published."""
    of_a, of_b = ({name: share for name, share, _ in shares(recording)} for recording in (a, b))
    return [(name, of_a.get(name), of_b.get(name)) for name in ANGLES if name in of_a or name in of_b]


def _rows_of_both(a: Mapping[str, str], b: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return each name with its values in A and in B; a missing value is empty."""
    return [(name, a.get(name, ""), b.get(name, "")) for name in dict.fromkeys([*a, *b])]
