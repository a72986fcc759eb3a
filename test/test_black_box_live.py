"""The live node's black box: bit-exact after all operations, after a restart, and after kill -9.

``tools/black_box_run.py`` does the operations and the restart over a voyage of ten minutes, without kill -9.
"""

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.recover import recovered_path
from ship_testing.trials.live_run import LiveFailure, LiveRun, executable
from tools.black_box_run import eventful_runs, verify_box

ROOT = Path(__file__).parents[1]

pytestmark = [pytest.mark.live, pytest.mark.slow]

DEMO = ROOT / "bags" / "demo.mcap"


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Return the black boxes of two runs: 30 s with changes, save, reset and load; started from the saved alignment.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        return eventful_runs(tmp_path_factory.mktemp("black_box"), duration_s=30.0, rate=3.0)


def test_a_run_with_changes_and_services_is_equal_to_the_last_bit(paths):
    outcome = verify_box(paths[0])
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    services = "~/save_alignment 1", "~/reset 1", "~/load_alignment 1"
    for used in ("ins/imu 3001", "parameters 4", "parameters refused 1", *services):
        assert used in outcome.stdout
    # Every sample has its attitude, however busy the machine is.
    assert re.search(r"^equal: .*ship/imu 3001", outcome.stdout, re.MULTILINE)


def test_a_run_from_the_saved_alignment_is_equal_to_the_last_bit(paths):
    assert [path.name for path in paths] == ["ship_attitude.mcap", "ship_attitude_2.mcap"]
    with read_bag(paths[1]) as bag:
        read_at_start = bag.attachments["files/0001/alignment.yaml"]
    with read_bag(paths[0]) as bag:
        # Written by the save, read by the load, and still there for the next start.
        assert bag.attachments["files/0001/alignment.yaml"] == read_at_start
        assert bag.attachments["files/0002/alignment.yaml"] == read_at_start
    outcome = verify_box(paths[1])
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


@pytest.fixture(scope="module")
def killed_path(tmp_path_factory):
    """Return the black box of a node killed in the middle of a voyage."""
    folder = tmp_path_factory.mktemp("killed")
    path = folder / "box.mcap"

    def kill_late(elapsed_s):
        if elapsed_s > 6.0:
            os.kill(run.node.pid, signal.SIGKILL)

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        parameters = {"black_box": str(path)}
        with (
            LiveRun(DEMO, ShipAttitudeAdapter, "ship_attitude_star", folder / "run", parameters) as run,
            pytest.raises(LiveFailure, match="the node ended with exit code -9"),
        ):
            run.play(4.0, kill_late)
    return path


def test_a_killed_nodes_black_box_is_verified_up_to_the_cut(killed_path):
    outcome = verify_box(killed_path)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "the black box ends without a footer" in outcome.stdout
    assert "no footer" in outcome.stdout
    assert "outputs are equal to the last bit" in outcome.stdout


def test_a_recovered_black_box_is_verified(killed_path):
    command = [*executable("ship_bags", "record"), "--recover", str(killed_path)]
    recovery = subprocess.run(command, capture_output=True, text=True, check=False)
    assert recovery.returncode == 0, recovery.stdout + recovery.stderr
    assert "all read back by mcap and rosbags" in recovery.stdout
    recovered, original = verify_box(recovered_path(killed_path)), verify_box(killed_path)
    assert recovered.returncode == 0, recovered.stdout + recovered.stderr
    # The file is whole now, but the node still ended suddenly.
    assert "no footer" not in recovered.stdout
    assert "the black box ends without a footer" in recovered.stdout
    # The recovered black box has as many used and equal messages as the original.
    assert counts(recovered) == counts(original)
    assert len(counts(original)) == 2


def counts(outcome):
    """Return the two lines of a verification that count the used and the equal messages."""
    return [line for line in outcome.stdout.splitlines() if line.startswith(("used:", "equal:"))]
