"""Faults in a bag that is played live into the suite: alerts and the tree in /diagnostics name who is to blame."""

import signal
import time
from pathlib import Path

import pytest

from ship_bags.live.ros_process import executable
from ship_bags.mcap.bag_reader import read_bag
from ship_msgs.msg import Alert
from ship_replay.trials.live_process import LiveProcess, free_domain_id, live_environment
from ship_simulation.inject_command import main as inject

pytestmark = pytest.mark.live

ROOT = Path(__file__).parents[1]
KNOCK_S, STEP_S = 15.0, 21.0
FAULTS = f"""faults:
  knock: {{topic: star/starboard/horizon_attitude, kind: knock, start_s: {KNOCK_S}, right_arcsec: 50.0}}
  step: {{topic: ins/imu, kind: bias, start_s: {STEP_S}, up_arcsec: 100.0}}
"""
STAR_PERIOD_S = 0.5


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """What was said on the network, and the time of the bag's first message, ns."""
    folder = tmp_path_factory.mktemp("alerts")
    (folder / "faults.yaml").write_text(FAULTS)
    demo, faulty, out = ROOT / "bags" / "demo.mcap", folder / "faulty.mcap", folder / "out.mcap"
    assert inject([str(demo), "--faults", str(folder / "faults.yaml"), "--out", str(faulty)]) == 0
    environment = live_environment(free_domain_id(), folder) | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}

    def started(name, package, *arguments):
        return LiveProcess([*executable(package, name), *map(str, arguments)], folder / f"{name}.log", environment)

    clock = ("--ros-args", "-p", "use_sim_time:=true")
    with (
        started("record", "ship_bags", "--out", out, "--use-sim-time") as record,
        started("alerts", "ship_monitor", *clock) as alerts,
        started("suite", "ship_bringup", "--bag", faulty) as suite,
    ):
        deadline_s = time.monotonic() + 90.0
        while "ins.out" not in alerts.log() and time.monotonic() < deadline_s:
            time.sleep(0.5)
        time.sleep(0.5)
        assert suite.exit_code is None, suite.log()
        assert alerts.end(signal.SIGTERM) == 0, alerts.log()
        assert record.end(signal.SIGINT) == 0, record.log()
        assert suite.end(signal.SIGTERM) == 0, suite.log()
    with read_bag(faulty) as bag:
        start_ns = bag.start_ns
    return out, start_ns


def times_s(recorded, topic):
    """(time since the bag's first message, message) of a topic, by the clock of the bag."""
    path, start_ns = recorded
    with read_bag(path) as bag:
        return [((record.log_time_ns - start_ns) * 1e-9, record.decode()) for record in bag.records([topic])]


@pytest.mark.parametrize(
    ("id_", "source", "start_s"),
    [("star.starboard.out", "star.starboard", KNOCK_S + STAR_PERIOD_S), ("ins.out", "ins", STEP_S)],
)
def test_alert_names_the_source_within_two_seconds_of_what_can_be_known(recorded, id_, source, start_s):
    told = [
        (time_s, alert) for time_s, array in times_s(recorded, "/ship/alerts") for alert in array.alerts
        if alert.id == id_
    ]  # fmt: skip
    time_s, first = told[0]
    assert start_s - STAR_PERIOD_S < time_s <= start_s + 2.0
    assert (first.source, first.state) == (source, Alert.ACTIVE_UNACKNOWLEDGED)
    assert first.priority >= Alert.WARNING


def test_nobody_else_is_blamed(recorded):
    blamed = {alert.source for _, array in times_s(recorded, "/ship/alerts") for alert in array.alerts}
    assert blamed - {""} == {"ins", "star.starboard"}


def test_tree_says_which_function_is_lost_because_of_which_input(recorded):
    told = [
        (time_s, status) for time_s, array in times_s(recorded, "/diagnostics") for status in array.status
        if status.name.startswith("alerts: functions/heading within 5″/")
    ]  # fmt: skip
    out = [(time_s, status.name.rpartition("/")[2]) for time_s, status in told if status.level not in (0, b"\x00")]
    first = {name: min(time_s for time_s, other in out if other == name) for name in {name for _, name in out}}
    assert set(first) == {"ins", "star.starboard"}
    assert first["star.starboard"] <= KNOCK_S + STAR_PERIOD_S + 2.0
    assert first["ins"] <= STEP_S + 2.0
