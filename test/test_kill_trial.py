"""Three of the forty kills of tools/kill_campaign.py, of a recorder and of a node with its black box."""

import pytest

from ship_testing.trials.kill_trial import KillTrial, kill_node, kill_recorder

SEEDS = (1, 2, 3)


@pytest.fixture(autouse=True)
def this_machine_only(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # The trial sets these variables; monkeypatch restores them after the test.
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)


@pytest.mark.live
@pytest.mark.parametrize("seed", SEEDS)
def test_a_killed_recorder_loses_one_flush_period_at_most(tmp_path, seed):
    trial = kill_recorder(tmp_path, seed, flush_period_s=0.3)
    assert trial.is_within_flush_period(0.3), trial
    assert trial.sent_count > 50


@pytest.mark.live
@pytest.mark.parametrize("seed", SEEDS)
def test_a_killed_node_has_its_inputs_in_the_black_box(tmp_path, seed):
    trial = kill_node(tmp_path, seed)
    # The black box is flushed every 0.1 s; a loaded machine may take twice as long.
    assert trial.is_within_flush_period(0.2), trial
    # The outputs are there too: more than the inputs alone.
    assert trial.recovered_count > 1.5 * trial.kept_count


@pytest.mark.parametrize(
    ("lost_s", "has_gap", "recovered", "readable"),
    [
        (0.11, False, 90, (90, 90)),
        (0.05, True, 90, (90, 90)),
        (0.05, False, 89, (90, 89)),
        (0.05, False, 90, (90, 89)),
        (0.05, False, 0, (0, 0)),
    ],
    ids=["more than a period", "a gap", "rosbags reads less", "mcap reads less", "nothing is left"],
)
def test_a_failed_trial_is_reported(lost_s, has_gap, recovered, readable):
    assert KillTrial(100, 90, 0.05, False, 90, (90, 90)).is_within_flush_period(0.1)
    assert not KillTrial(100, 90, lost_s, has_gap, recovered, readable).is_within_flush_period(0.1)
