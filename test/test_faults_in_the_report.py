"""A voyage with faults, in the report: the same events as those who watched had, at the times of the faults, by source.

Faults, and when they could be known, are those of ``test_watched_faults``. The report sees the outputs alone: they are
all that ``replay`` writes.
"""

import re
from pathlib import Path

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S
from ship_replay.report.page import page
from ship_replay.report.tables import outages
from ship_replay.report.told import read_told
from ship_replay.report.wording import utc
from ship_testing.watched_voyages import END_S, FAULTS, KNOWN_S, SILENT, SILENT_WITHIN_S, WITHIN_S, replayed
from ship_watch.picture import Event

# The report looks twice a second, and an alert is raised at the look after the one that found its reason.
ALERTS_LATER_S = 1.0
# What is written of each fault.
TEXTS = {
    "star.starboard": r"star\.starboard OUT, excluded, right \+4\d″",
    "ins": r"ins OUT, 5 refused in a row",
    "star.fore": r"star\.fore OUT, silent",
    "baselines": r"baselines OUT, a 5 refused in a row: not fixed",
    "lights": r"lights IN, names exchanged",
    "encoder": r"encoder OUT, silent",
}
# Until when each source was out because of its fault; the INS is believed again with its new bias, and the knock of a
# sensor that ended is still held against it. A source that is back is told so when it was used often enough.
BACK_S = {"star.fore": (44.0, 46.0), "baselines": (14.0, 17.0), "encoder": (36.0, 37.0)}


@pytest.mark.parametrize("bag", FAULTS)
def test_the_report_lists_each_fault_with_its_time_and_source(bag: str, tmp_path: Path) -> None:
    given, out = replayed(tmp_path, bag, FAULTS[bag])
    with read_bag(given) as played:
        start_ns = played.start_ns or 0
    told = read_told(out)
    night, text = told.night, page(told)

    def seconds(utc_ns: int) -> float:
        return (utc_ns - start_ns) / NS_PER_S

    known_s = KNOWN_S[bag]
    # Innocent sources are told with who is to blame, and nobody before the first fault.
    by_source: dict[str, list[Event]] = {}
    for event in night.events:
        if event.kind == "source" and seconds(event.utc_ns) < END_S[bag] and "needs" not in event.text:
            by_source.setdefault(event.subject, []).append(event)
    assert set(by_source) == set(known_s)
    for source, fault_s in known_s.items():
        within_s = SILENT_WITHIN_S if source in SILENT else WITHIN_S
        event = next(one for one in by_source[source] if seconds(one.utc_ns) >= fault_s)
        assert fault_s <= seconds(event.utc_ns) <= fault_s + within_s, event
        assert re.fullmatch(TEXTS[source], event.text)
        row = f'<tr><td class="w">{utc(event.utc_ns)}</td><td>source</td><td>{event.text}</td></tr>'
        assert row in text
        raised = [one for one in night.alerts if one.what == "raised" and one.alert.source == source]
        assert fault_s <= seconds(raised[0].utc_ns) <= fault_s + within_s + ALERTS_LATER_S, raised[0]
        assert f'<tr><td class="w">{utc(raised[0].utc_ns)}</td>' in text
    assert {one.alert.source for one in night.alerts if seconds(one.utc_ns) < END_S[bag]} <= {*known_s, ""}

    verdict = re.search(r'<div class="verdict"><p>(.*?)</p>', text, re.DOTALL)
    assert verdict is not None
    out_first = {one.source: one for one in reversed(outages(night))}
    for source in known_s.keys() - {"lights"}:  # exchanged lights are put right and remain in use
        first = out_first[source]
        assert f"{source} was out from {utc(first.from_ns)} to" in verdict[1]
        if source in BACK_S:
            least_s, most_s = BACK_S[source]
            assert least_s <= seconds(first.to_ns) <= most_s
