"""A voyage with faults, from the bag to the user: page, terminal, alerts and diagnostics name the right source, soon.

Times are seconds of the data after the first message of the bag. A fault is named within 2 s of the first time at which
it can be detected: the first wrong measurement, or the time at which a message is overdue. This limit also holds live:
with 15 processes competing for four cores, the last output named each source 0.3 s to 0.9 s after the fault could be
detected.
"""

import json
import math
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ship_bags.live.ros_process import executable
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_monitor.alerts.alert_manager import AlertManager
from ship_monitor.live.live_suite import LiveSuite
from ship_monitor.live.topic_reader import MAX_QUEUE_DEPTH, TopicReader
from ship_monitor.page.first_screen import first_screen
from ship_monitor.terminal.screen import View, alert_to_show, screen
from ship_simulation.inject_command import main as inject
from ship_testing.monitored_voyages import (
    BAGS,
    DETECTABLE_S,
    DETECTION_LIMIT_S,
    END_S,
    FAULTS,
    detection_limit_s,
    records,
    replay_with_faults,
)
from ship_testing.suite_states import plain_text
from ship_testing.trials.live_process import LiveProcess, free_domain_id, live_environment
from ship_watch.history.history import History
from ship_watch.safety.limits import Limits
from ship_watch.suite_monitor import SuiteMonitor
from ship_watch.suite_state import Presence, SuiteState

LIVE_EARLY_S = 0.1
"""Maximum time by which a report of a live state may be early, s: the state has its own steady clock."""
LOOK_NS = NS_PER_S // 5
OUTPUTS = ("picture", "page", "terminal", "alerts", "diagnostics")


class FirstReports:
    """First times at which each output named each source as out, or with an alert."""

    def __init__(self, bag: str, start_ns: int) -> None:
        self._bag, self._start_ns = bag, start_ns
        self.first_s: dict[tuple[str, str], float] = {}

    def seconds(self, utc_ns: int) -> float:
        """Seconds since the first message of the bag."""
        return (utc_ns - self._start_ns) / NS_PER_S

    def record(self, output: str, source: str, utc_ns: int) -> None:
        """Record that an output names a source at a time of the data."""
        self.first_s.setdefault((output, source), self.seconds(utc_ns))

    def record_state(self, picture: SuiteState, history: History) -> None:
        """Record the sources named in a suite state, on the page, and in the lines of a terminal."""
        page = first_screen(picture, history, "LIVE", "")
        lines = screen(picture, picture.alerts, View(80, 24, "ship", "LIVE", ""))
        rows = [plain_text(line) for line in lines]
        for source in picture.sources:
            text = source.reason or source.disagreement
            if source.because_of or not text or source.presence is Presence.OFF:
                continue
            self.record("picture", source.name, picture.utc_ns)
            if any(source.name in row and text[:20] in row for row in rows):
                self.record("terminal", source.name, picture.utc_ns)
            texts = json.dumps(page["sources"], ensure_ascii=False)
            if source.name in texts and text in texts:
                self.record("page", source.name, picture.utc_ns)

    def record_branch(self, path: str, text: str, utc_ns: int) -> None:
        """Record the source of an entry of the function tree, unless it is OUT only because it needs another source."""
        if text != "in" and "needs" not in text and "/" in path:
            self.record("diagnostics", path.rpartition("/")[2], utc_ns)

    def check(self, soon_s: Callable[[str], float], early_s: float = 0.0) -> None:
        """Assert that every output named every faulty source soon after it could be detected, and no other source."""
        detectable = {
            (output, source): known_s for source, known_s in DETECTABLE_S[self._bag].items() for output in OUTPUTS
        }
        for (output, source), known_s in detectable.items():
            first_s = self.first_s.get((output, source), math.inf)
            assert known_s - early_s <= first_s <= known_s + soon_s(source), (output, source, self.first_s)
        # Only faulty sources are named; the attitude in the alerts is not a source.
        assert {source for _, source in self.first_s} <= {*DETECTABLE_S[self._bag], "", "attitude"}, self.first_s


@pytest.mark.slow
@pytest.mark.parametrize("bag", FAULTS)
def test_all_outputs_name_the_right_source_in_a_replay(bag: str, tmp_path: Path) -> None:
    given, replayed_path = replay_with_faults(tmp_path, bag, FAULTS[bag])
    paths = (given, replayed_path) if bag == "theodolite" else (replayed_path,)
    with read_bag(given) as played:
        start_ns = played.start_ns
    monitor, manager, named = (
        SuiteMonitor(Limits()),
        AlertManager(Limits(), None, start_ns, print),
        FirstReports(bag, start_ns),
    )
    due_ns = start_ns
    for time_ns, topic, message in records(*paths):
        if time_ns > start_ns + END_S[bag] * NS_PER_S:
            break
        while due_ns <= time_ns:
            manager.update(due_ns, due_ns)
            named.record_state(monitor.current_state(due_ns), monitor.history)
            for alert in manager.alerts:
                named.record("alerts", alert.source, due_ns)
            for branch in manager.diagnostic_entries():
                named.record_branch(branch.path, branch.text, due_ns)
            due_ns += LOOK_NS
        monitor.process_message(topic, message, time_ns)
        manager.process_message(topic, message, time_ns)
    named.check(detection_limit_s)


class SuiteUnderTest:
    """Suite started with one command, a bag played into it, and its observers."""

    def __init__(self, bag: Path, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        command = [*executable("ship_bringup", "suite"), "--bag", str(bag), "--monitor", "--port", str(port)]
        domain = int(os.environ["ROS_DOMAIN_ID"])
        self.process = LiveProcess(command, folder / "suite.log", live_environment(domain, folder / "ros"))
        self.live_suite = LiveSuite("watcher", "", Limits())
        self.diagnostics = TopicReader(
            "statuses", "", lambda topic, _: MAX_QUEUE_DEPTH if topic == "/diagnostics" else 0
        )

    def close(self) -> None:
        """End all processes; first the observers."""
        self.live_suite.close()
        self.diagnostics.close()
        self.process.end()

    def read(self, named: FirstReports) -> SuiteState:
        """Process received messages, and record the sources they name."""
        self.live_suite.tick()
        picture = self.live_suite.current_state()
        if picture.utc_ns:
            named.record_state(picture, self.live_suite.history)
        for alert in picture.alerts or ():
            named.record("alerts", alert.source, alert.raised_ns)
        for arrived in self.diagnostics.fetch().messages:
            for status in arrived.message.status:
                node, _, path = status.name.partition(": functions/")
                if node == "alerts":
                    named.record_branch(path, status.message, ns_from_stamp(arrived.message.header.stamp))
        return picture


@pytest.mark.live
@pytest.mark.parametrize("bag", FAULTS)
def test_all_outputs_name_the_right_source_live(bag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
    faulty = tmp_path / "faulty.mcap"
    (tmp_path / "faults.yaml").write_text(f"faults: {{{FAULTS[bag]}}}\n")
    files = ["--faults", str(tmp_path / "faults.yaml"), "--out", str(faulty), "--seed", "1"]
    assert inject([str(BAGS / f"{bag}.mcap"), *files]) == 0
    with read_bag(faulty) as played:
        named = FirstReports(bag, played.start_ns)
    suite = SuiteUnderTest(faulty, tmp_path)
    acknowledged = ""
    try:
        deadline_s = time.monotonic() + 240.0
        while not (picture := suite.read(named)).utc_ns or named.seconds(picture.utc_ns) < END_S[bag]:
            assert suite.process.exit_code is None, suite.process.log_text()
            assert time.monotonic() < deadline_s, suite.process.log_text()
            alert = alert_to_show(picture.alerts)
            if alert is not None and not alert.is_acknowledged and not acknowledged:
                acknowledged = suite.live_suite.acknowledge(alert.id, alert.instance)
            time.sleep(0.1)
    finally:
        suite.close()
    assert "acknowledged" in acknowledged
    assert "not acknowledged" not in acknowledged
    assert any("acknowledged" in event.text for event in picture.events if event.kind == "alert")
    named.check(lambda _: DETECTION_LIMIT_S, LIVE_EARLY_S)
