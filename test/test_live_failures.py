"""A live run whose node does not start, or ends prematurely, reports this failure with the end of the node's log."""

import signal
from pathlib import Path

import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_testing.trials.live_run import LiveFailure, LiveRun

pytestmark = pytest.mark.live

BAG = Path(__file__).parents[1] / "bags" / "demo.mcap"


@pytest.fixture(autouse=True)
def stay_on_this_machine(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def test_live_tests_run_on_a_separate_worker(request):
    """If xdist ignored the group of the live tests, their nodes would run at the same time, and sometimes fail."""
    if not hasattr(request.config, "workerinput"):
        pytest.skip("all tests run one after another here: no xdist")
    assert request.node.nodeid.rpartition("@")[2] == "live"


def test_a_node_that_does_not_start(tmp_path):
    with pytest.raises(LiveFailure, match=r"the node ended with exit code 2(.|\n)*parameter 'lag_s'"):
        LiveRun(BAG, ShipAttitudeAdapter, "ship_attitude_star", tmp_path, {"lag_s": "-1.0"})


def test_a_node_that_ends_during_the_run(tmp_path):
    with LiveRun(BAG, ShipAttitudeAdapter, "ship_attitude_star", tmp_path) as run:

        def kill_after_a_second(elapsed_s):
            if elapsed_s > 1.0 and run.node.exit_code is None:
                run.node.end(signal.SIGKILL)

        with pytest.raises(LiveFailure, match=r"the node ended with exit code -9; its log .*ship_attitude\.log ends:"):
            run.play(1.0, report_elapsed=kill_after_a_second)
