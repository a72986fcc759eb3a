"""Alerts of whole voyages with faults, read from bags; no alert is lost when the process ends."""

import json
from pathlib import Path

import pytest

from ship_bags.stamps import NS_PER_S
from ship_monitor.alerts.alert_manager import MAX_STATUS_AGE_NS, MAX_STATUSES, AlertManager
from ship_testing.monitored_voyages import records, replay_with_faults
from ship_watch.alerts.alert_conditions import NodeStatus
from ship_watch.alerts.alerts import AlertChange, AlertState
from ship_watch.safety.limits import Limits
from ship_watch.suite_state import Priority

LOOK_NS = NS_PER_S // 5
CLOCK_NS = 1_700_000_000 * NS_PER_S

INS_STEP = "step: {topic: ins/imu, kind: bias, start_s: 20.0, up_arcsec: 100.0}"
MOUNTING_SHIFT = "knock: {topic: star/starboard/horizon_attitude, kind: knock, start_s: 40.0, right_arcsec: 50.0}"


THEODOLITE = (
    "float: {topic: beacon/a/baseline, kind: corrupt, field: fix, value: 3, start_s: 10.0, end_s: 16.0}, "
    "swap: {topic: theodolite/beacons, kind: swap, start_s: 25.0, end_s: 33.0}, "
    "silent: {topic: theodolite/encoder, kind: drop, start_s: 60.0, end_s: 66.0}"
)


class Voyage:
    """A voyage with an alert manager updated five times a second; times are s after the first message."""

    def __init__(self, *paths: Path, state: Path | None = None, acknowledge: bool = False) -> None:
        self.changes: list[tuple[float, AlertChange]] = []
        self.reports: list[str] = []
        manager: AlertManager | None = None
        start_ns = due_ns = 0
        for time_ns, topic, message in records(*paths):
            if manager is None:
                start_ns = due_ns = time_ns
                manager = AlertManager(Limits(), state, time_ns, self.reports.append)
            while due_ns <= time_ns:
                for change in manager.update(due_ns, CLOCK_NS):
                    self.changes.append(((due_ns - start_ns) / NS_PER_S, change))
                    if acknowledge:
                        manager.acknowledge(change.alert.id, change.alert.instance, CLOCK_NS)
                due_ns += LOOK_NS
            manager.process_message(topic, message, time_ns)
        assert manager is not None
        self.manager, self.end_ns = manager, due_ns

    def first(self, id_: str) -> tuple[float, AlertChange]:
        """Return time and change of the first report of an alert."""
        return next((time_s, change) for time_s, change in self.changes if change.alert.id == id_)


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the outputs of the demo voyage with an INS step and a shifted star sensor."""
    return replay_with_faults(tmp_path_factory.mktemp("faulty"), "demo", f"{INS_STEP}, {MOUNTING_SHIFT}")[1]


@pytest.mark.slow
def test_each_fault_names_its_source_within_two_seconds(faulty: Path) -> None:
    """INS step of 100″ at 20 s, star sensor shifted by 50″ at 40 s: two alerts of two sources.

    The heading is lost for three tenths of a second after the step; then angles over their limits are reported.
    """
    voyage = Voyage(faulty)
    time_s, ins = voyage.first("ins.out")
    assert 20.0 <= time_s <= 22.0
    assert (ins.alert.priority, ins.alert.source) == (Priority.WARNING, "ins")
    assert ins.alert.text == "Heading and tilt over their limits: ins rejected"
    time_s, star = voyage.first("star.starboard.out")
    assert 40.0 <= time_s <= 42.0
    assert star.alert.priority is Priority.WARNING
    named = {change.alert.source for time_s, change in voyage.changes if 20.0 <= time_s < 60.0}
    assert named == {"ins", "star.starboard", ""}
    assert not [change for _, change in voyage.changes if "fore" in change.alert.id]


@pytest.mark.slow
def test_faults_of_a_theodolite_name_their_sources(tmp_path: Path) -> None:
    """A FLOAT baseline at 10 s, exchanged names of lights from 25 s, no encoder data from 60 s."""
    voyage = Voyage(*replay_with_faults(tmp_path, "theodolite", THEODOLITE))
    for start_s, id_, source, priority in (
        (10.0, "baselines.out", "baselines", Priority.CAUTION),
        (25.0, "lights.mended", "lights", Priority.CAUTION),
        (60.0, "encoder.out", "encoder", Priority.ALARM),
    ):
        time_s, change = voyage.first(id_)
        # The alert comes at most two seconds after the filter can detect the fault; the encoder's timeout is two
        # seconds.
        assert start_s < time_s <= start_s + 2.0 + 2 * LOOK_NS / NS_PER_S
        assert (change.alert.source, change.alert.priority) == (source, priority)
    named = {change.alert.source for time_s, change in voyage.changes if time_s < 79.0}
    assert named <= {"baselines", "lights", "encoder", ""}
    assert "Pointing lost" in voyage.first("encoder.out")[1].alert.text


@pytest.mark.slow
def test_alerts_of_sources_name_the_lost_functions(faulty: Path) -> None:
    """While a source that causes a lost angle is OUT, the output has no alert of its own."""
    voyage = Voyage(faulty)
    active: set[str] = set()
    for time_s, change in voyage.changes:
        (active.add if change.alert.state in (1, 2, 3) else active.discard)(change.alert.id)
        if 20.6 <= time_s <= 25.0:
            assert active == {"ins.out"}


@pytest.mark.slow
def test_clean_voyage_has_no_alert_of_a_source(tmp_path: Path) -> None:
    """Without faults only the gap in the stars of the scenario gives alerts, not a brief excess of a limit."""
    voyage = Voyage(replay_with_faults(tmp_path, "demo")[1])
    assert {change.alert.id for _, change in voyage.changes} == {"stars.out"}
    assert all(change.alert.priority is not Priority.ALARM for _, change in voyage.changes)
    assert all(change.description != "raised" or time_s >= 10.0 for time_s, change in voyage.changes)


@pytest.mark.slow
def test_crash_loses_no_alert(faulty: Path, tmp_path: Path) -> None:
    """After a crash at the end of the voyage, a restart from the file gives the same alerts, and none is raised again.

    The voyage is run without and with acknowledged alerts.
    """
    state = tmp_path / "alerts.json"
    for acknowledge in (False, True):
        state.unlink(missing_ok=True)
        before = Voyage(faulty, state=state, acknowledge=acknowledge)
        assert before.manager.alerts
        again = AlertManager(Limits(), state, before.end_ns, before.reports.append)
        assert repr(again.alerts) == repr(before.manager.alerts)
        states = {alert.id: alert.state for alert in again.alerts}
        # No data for nine seconds after the start: no alert ends, none is raised twice.
        for tenth in range(90):
            assert again.update(before.end_ns + tenth * NS_PER_S // 10, CLOCK_NS) == ()
        assert {alert.id: alert.state for alert in again.alerts} == states
        assert before.reports == []


@pytest.mark.parametrize("content", ["", "[]", "{", '{"format": "ship_alerts", "version": 9, "alerts": []}', "\0"])
def test_corrupt_file_is_reported_and_replaced(tmp_path: Path, content: str) -> None:
    """One line names the file; the node continues and writes a valid file."""
    state = tmp_path / "alerts.json"
    state.write_text(content)
    reports: list[str] = []
    manager = AlertManager(Limits(), state, 0, reports.append)
    assert len(reports) == 1
    assert str(state) in reports[0]
    assert "\n" not in reports[0]
    for second in range(20):
        manager.update(second * NS_PER_S, CLOCK_NS)
    assert [alert.id for alert in manager.alerts] == ["attitude.silent"]
    assert json.loads(state.read_text())["alerts"][0]["id"] == "attitude.silent"


def test_full_disk_is_reported_once_and_retried(tmp_path: Path) -> None:
    """Alerts continue while the file cannot be written, and are saved as soon as writing is possible."""
    state = tmp_path / "folder" / "alerts.json"
    reports: list[str] = []
    manager = AlertManager(Limits(), state, 0, reports.append)
    state.parent.write_text("a file in the place of the folder")
    for tenth in range(150):
        manager.update(tenth * NS_PER_S // 10, CLOCK_NS)
    assert len(reports) == 1
    assert [alert.id for alert in manager.alerts] == ["attitude.silent"]
    state.parent.unlink()
    manager.update(151 * NS_PER_S // 10, CLOCK_NS)
    assert json.loads(state.read_text())["alerts"][0]["state"] == AlertState.ACTIVE_UNACKNOWLEDGED


def test_sleep_of_the_computer_raises_no_false_alarm(faulty: Path) -> None:
    """An hour of sleep is not a timeout of the suite: no alert changes for nine seconds, so that data can arrive."""
    voyage = Voyage(faulty)
    before = voyage.manager.alerts
    later_ns = voyage.end_ns + 3600 * NS_PER_S
    for tenth in range(90):
        assert voyage.manager.update(later_ns + tenth * NS_PER_S // 10, CLOCK_NS) == ()
    assert repr(voyage.manager.alerts) == repr(before)


def test_node_status_expires() -> None:
    """An ended black box is a warning; the warning clears when the node stops publishing its status."""
    manager = AlertManager(Limits(), None, 0, lambda _: None)
    ended = NodeStatus("ship_attitude", "black box", 2, "box.mcap: writing failed: No space left on device")
    for second in range(8):
        manager.process_status(ended, second * NS_PER_S)
        manager.update(second * NS_PER_S, CLOCK_NS)
    assert [alert.id for alert in manager.alerts] == ["ship_attitude.box"]
    states = set()
    for second in range(8, 30):
        manager.update(second * NS_PER_S, CLOCK_NS)
        states |= {alert.state for alert in manager.alerts if alert.id == "ship_attitude.box"}
    assert states == {AlertState.ACTIVE_UNACKNOWLEDGED, AlertState.RECTIFIED_UNACKNOWLEDGED}


def test_full_or_missing_disk_raises_an_alert(tmp_path: Path) -> None:
    """First the limit is more than the free space of any disk; then the disk does not exist."""
    machine = Limits().machine
    for path in (tmp_path, tmp_path / "gone"):
        limits = Limits(machine=type(machine)(disk_path=str(path), disk_free_gb=1e6))
        manager = AlertManager(limits, None, 0, lambda _: None)
        for tenth in range(5):
            manager.update(tenth * LOOK_NS, CLOCK_NS)
        assert [alert.id for alert in manager.alerts] == ["disk.full"]


def test_number_of_statuses_is_bounded():
    manager = AlertManager(Limits(), None, 0, print)
    for number in range(3 * MAX_STATUSES):
        manager.process_status(NodeStatus("ship_attitude", f"invented {number}", 2, "x"), number)
    assert len(manager._statuses) == MAX_STATUSES
    manager.update(MAX_STATUS_AGE_NS + 3 * MAX_STATUSES, CLOCK_NS)
    assert not manager._statuses
