"""Reports of a folder of bags, and one page with a row for each session."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ship_bags.mcap.folder import INFORMATION_FILE
from ship_bags.stamps import NS_PER_S
from ship_geometry.input_error import InputError
from ship_node.pages.html_page import render
from ship_replay.report.page import page, summary, valid_shares, versions, worst_source
from ship_replay.report.recording import ReportData
from ship_replay.report.tables import duration, outages, root_outages, utc
from ship_watch.suite_state import ANGLES, Safety


@dataclass(frozen=True)
class SessionRow:
    """One session of a folder.

    Attributes:
        name: name of the bag.
        error: reason why there is no report; empty if there is one.
        start_ns: UTC at which the outputs begin, ns.
        length_s: length of the recording, s.
        shares: "ship/attitude VALID", "heading SAFE" → share of the time.
        worst_source: source that was out longest in all, without outages caused by another source; empty if there is
            none.
        faults: number of outages not caused by another source.
        to_do: last sentence of the summary: the recommended actions, or that no attitude and no pointing was published.
    """

    name: str
    error: str = ""
    start_ns: int = 0
    length_s: float = 0.0
    shares: dict[str, float] = field(default_factory=dict)
    worst_source: str = ""
    faults: int = 0
    to_do: str = ""

    @property
    def file(self) -> str:
        """File name of the session's report."""
        return f"{self.name}.html"


def bags_in(folder: Path) -> list[Path]:
    """Return the MCAP files and rosbag2 folders in a folder, sorted by name; empty if it is a bag or no folder."""
    if not folder.is_dir() or (folder / INFORMATION_FILE).exists():
        return []
    return sorted(
        path for path in folder.iterdir()
        if (path.suffix == ".mcap" and path.is_file()) or (path / INFORMATION_FILE).is_file()
    )


def session_reports(
    bags: Sequence[Path], read: Callable[[Path], ReportData], write: Callable[[str, str], None]
) -> Iterator[SessionRow]:
    """Write the report of each bag and yield the bag's row; a bag without a report yields a row with the error.

    Args:
        bags: bags of the folder.
        read: function that reads and evaluates a bag.
        write: function that writes a page, given by file name and text.
    """
    for path in bags:
        try:
            report_data = read(path)
            row = session_row(report_data)
            write(row.file, page(report_data))
        except (InputError, OSError) as problem:
            row = SessionRow(path.name, error=str(problem))
        yield row


def session_row(report_data: ReportData) -> SessionRow:
    """Return the row of a session."""
    recording = report_data.recording
    shares = {f"{topic} VALID": share for topic, share in valid_shares(recording).items()}
    for name in ANGLES:
        if total := (seconds := recording.seconds(name)).total():
            shares[f"{name} SAFE"] = seconds[Safety.SAFE] / total
    faults = len(root_outages(outages(recording)))
    length_s = (recording.end_ns - recording.start_ns) / NS_PER_S
    return SessionRow(
        recording.path.name,
        "",
        recording.start_utc_ns,
        length_s,
        shares,
        worst_source(recording),
        faults,
        summary(recording)[-1],
    )


def index_page(folder: Path, rows: Sequence[SessionRow], reports: str) -> str:
    """Return the page of a folder: its sessions in order of time, bags without a report last.

    Args:
        folder: folder of the bags.
        rows: rows of all bags.
        reports: folder of the reports, relative to the page.
    """
    sessions = sorted((row for row in rows if not row.error), key=lambda row: (row.start_ns, row.name))
    columns = list(dict.fromkeys(name for row in sessions for name in row.shares))
    before: list[SessionRow | None] = [None, *sessions[:-1]]
    return render(
        Path(__file__).with_name("folder.html.j2"),
        title=folder.resolve().name,
        reports=reports,
        columns=columns,
        sessions=[_row_texts(row, last, columns) for row, last in zip(sessions, before, strict=False)],
        failed=[row for row in rows if row.error],
        count=len(rows),
        versions=versions(),
    )


def _row_texts(row: SessionRow, before: SessionRow | None, columns: Sequence[str]) -> dict[str, object]:
    """Return the texts of a row, each value with its difference to the previous session."""
    cells = []
    for name in columns:
        share = row.shares.get(name)
        last = None if before is None else before.shares.get(name)
        cells.append((
            "–" if share is None else f"{100.0 * share:.1f} %",
            "" if share is None or last is None else _signed_text(100.0 * (share - last), 1),
        ))
    return {
        "row": row, "date": utc(row.start_ns, "%Y-%m-%d"), "start": utc(row.start_ns), "length": duration(row.length_s),
        "cells": cells, "worst": row.worst_source or "none",
        "is_other": before is not None and before.worst_source != row.worst_source,
        "more_faults": "" if before is None else _signed_text(row.faults - before.faults, 0),
    }


def _signed_text(value: float, places: int) -> str:
    text = f"{value:+.{places}f}"
    return "=" if float(text) == 0.0 else text.replace("-", "−")
