"""A voyage with faults in the report: the same events as in live monitoring, at the times of the faults, by source.

Faults, and their times of detection, are those of ``test_watched_faults``. Events are derived from the outputs alone,
which are all that ``replay`` writes.
"""

import base64
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S
from ship_replay.report.page import page
from ship_replay.report.recording import ReportData, read_report_data
from ship_replay.report.tables import outages, utc
from ship_testing.browser import CHROMIUM, Browser
from ship_testing.monitored_voyages import DETECTABLE_S, END_S, FAULTS, detection_limit_s, replay_with_faults
from ship_testing.report_bags import section
from ship_watch.suite_state import Event

# The report evaluates the outputs twice a second; an alert is raised one evaluation after its reason was detected.
ALERTS_LATER_S = 1.0
# Source → text of the event at its fault.
TEXTS = {
    "star.starboard": r"star\.starboard OUT, excluded, reads 4\d″ high",
    "ins": r"ins OUT, 5 rejected in a row",
    "star.fore": r"star\.fore OUT, no data",
    "baselines": r"baselines OUT, a: 5 rejected in a row: not fixed",
    "lights": r"lights IN, names exchanged",
    "encoder": r"encoder OUT, no data",
}
# Source → earliest and latest time of its reported return, s since the first message. The INS, which is used again with
# its new bias, and a displaced sensor, which stays out after the displacement has ended, are not listed. The return of
# a source is reported after enough uses.
BACK_S = {"star.fore": (44.0, 46.0), "baselines": (14.0, 17.0), "encoder": (36.0, 37.0)}


@dataclass(frozen=True)
class FaultReport:
    """Faulty voyage: the time of its first message, the data read from its outputs, and its page."""

    bag: str
    start_ns: int
    events: ReportData
    path: Path

    def seconds(self, utc_ns: int) -> float:
        """Return the seconds since the first message of the bag."""
        return (utc_ns - self.start_ns) / NS_PER_S


@pytest.fixture(scope="module", params=list(FAULTS))
def fault_report(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> FaultReport:
    folder = tmp_path_factory.mktemp(request.param)
    given, out = replay_with_faults(folder, request.param, FAULTS[request.param])
    with read_bag(given) as played:
        start_ns = played.start_ns
    data = read_report_data(out, given)
    (folder / "report.html").write_text(page(data))
    return FaultReport(request.param, start_ns, data, folder / "report.html")


@pytest.mark.slow
def test_the_report_lists_each_fault_with_its_time_and_source(fault_report: FaultReport) -> None:
    bag, recording, seconds = fault_report.bag, fault_report.events.recording, fault_report.seconds
    text = fault_report.path.read_text()
    known_s = DETECTABLE_S[bag]
    # Affected sources are reported with the faulty one, and none before the first fault.
    by_source: dict[str, list[Event]] = {}
    for event in recording.events:
        if event.kind == "source" and seconds(event.utc_ns) < END_S[bag] and "needs" not in event.text:
            by_source.setdefault(event.subject, []).append(event)
    assert set(by_source) == set(known_s)
    for source, fault_s in known_s.items():
        event = next(one for one in by_source[source] if seconds(one.utc_ns) >= fault_s)
        assert fault_s <= seconds(event.utc_ns) <= fault_s + detection_limit_s(source), event
        assert re.fullmatch(TEXTS[source], event.text)
        link = f'<a href="#status-mark-{event.utc_ns // NS_PER_S}">{utc(event.utc_ns)}</a>'
        assert f'<tr><td class="w">{link}</td><td>source</td><td>{event.text}</td></tr>' in text
        raised = [one for one in recording.alerts if one.what == "raised" and one.alert.source == source]
        assert fault_s <= seconds(raised[0].utc_ns) <= fault_s + detection_limit_s(source) + ALERTS_LATER_S, raised[0]
        assert f'<tr><td class="w">{utc(raised[0].utc_ns)}</td>' in text
    assert {one.alert.source for one in recording.alerts if seconds(one.utc_ns) < END_S[bag]} <= {*known_s, ""}

    summary = section(text, "verdict")
    out_first = {one.source: one for one in reversed(outages(recording))}
    for source in known_s.keys() - {"lights"}:  # exchanged lights are put right and remain in use
        first = out_first[source]
        assert f'<td>{source}</td><td class="w">{utc(first.from_ns)}</td>' in summary
        if source in BACK_S:
            least_s, most_s = BACK_S[source]
            assert least_s <= seconds(first.to_ns) <= most_s


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_the_page_opens_without_network_fits_its_window_and_prints(fault_report: FaultReport) -> None:
    browser = Browser()
    try:
        for width, height in ((1280, 800), (390, 844)):
            browser.open(fault_report.path.as_uri(), width, height)
            assert browser.problems == []
            assert [address for address in browser.addresses if not address.startswith("file:")] == []
            # Nothing but tables and figures, which have scroll bars of their own, is wider than the window.
            assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
            browser.take_screenshot(fault_report.path.with_name(f"report_{width}.png"))
        browser.open(fault_report.path.as_uri(), 1000, 1180)
        browser.take_screenshot(fault_report.path.with_name("report.png"))
        printed = base64.b64decode(browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    finally:
        browser.close()
    fault_report.path.with_suffix(".pdf").write_bytes(printed)
    sizes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", printed)
    assert 5 <= len(sizes) <= 15
    # A4 in points.
    assert all((float(width), float(height)) == pytest.approx((595.0, 842.0), abs=1.0) for width, height in sizes)
