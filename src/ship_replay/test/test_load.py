"""The load of a suite from its rates: contributions, limits, and the speed of this computer."""

import pytest

from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_estimation.parameters.schema import build
from ship_replay.commands.check_config import main
from ship_replay.offline.replay import ADAPTERS
from ship_replay.preflight.check_bag import load_text, load_warnings, measured_slowness, node_loads
from ship_testing.hand_made_bags import START_NS, imu

CONFIGS = {
    "ship_attitude": {"star_sensors": {"bow": {"azimuth_deg": 0.0, "elevation_deg": 45.0, "input": "solution"}}},
    "optical_axis": {"telescope": {"telescope_id": "main", "focal_length_m": 1.0}},
}


@pytest.fixture(scope="module")
def adapters():
    kinds = [kind for kind in ADAPTERS if kind.node_name in CONFIGS]
    return [kind(build(kind.config_type, CONFIGS[kind.node_name]), RosbagsFactory()) for kind in kinds]


def shares(adapters, rates_hz, slowness=1.0):
    return {load.node: load.share for load in node_loads(adapters, rates_hz, slowness)}


def test_the_load_grows_with_the_rates_and_with_the_slowness_of_the_computer(adapters):
    idle, usual, fast = (shares(adapters, {"ins/imu": rate_hz})["ship_attitude"] for rate_hz in (0.0, 100.0, 200.0))
    assert 0.0 < idle < usual < fast
    assert fast - usual == pytest.approx(usual - idle)
    assert shares(adapters, {"ins/imu": 100.0}, 3.0)["ship_attitude"] == pytest.approx(3.0 * usual)


def test_what_one_node_gives_another_comes_at_the_rate_of_what_it_is_made_of(adapters):
    given = shares(adapters, {"ins/imu": 100.0, "star/bow/observations": 5.0})
    named = {"ins/imu": 100.0, "ship/attitude": 100.0, "star/bow/solution": 5.0}
    assert given == shares(adapters, named)
    assert given["optical_axis"] > shares(adapters, {})["optical_axis"]


def test_too_much_for_one_core_and_for_all_of_them_is_named(adapters):
    few, many = (node_loads(adapters, {"ins/imu": rate_hz}, 1.0) for rate_hz in (100.0, 2000.0))
    assert list(load_warnings(few, cores=2)) == []
    one, other, both = load_warnings(many, cores=2)
    assert "% of one core, limit 70 %: it may fall behind; largest load: ins/imu at 2000 Hz" in one + other
    assert "largest load: ship/attitude at 2000 Hz" in one + other
    assert "all nodes together" in both
    assert load_text(many).startswith("load: about ")


def test_the_speed_of_this_computer_is_a_figure_that_makes_sense():
    assert 0.02 < measured_slowness() < 50.0


def test_check_config_prints_the_load_and_warns_if_too_high(tmp_path, capsys):
    (tmp_path / "suite.yaml").write_text("ship_attitude:\n  ros__parameters:\n    ins:\n      frame_id: ins\n")
    with BagWriter(tmp_path / "fast.mcap") as bag:
        for number in range(2000):
            stamp_ns = START_NS + number * 100_000
            bag.write("ins/imu", imu(stamp_ns, "ins"), stamp_ns)
    assert main([str(tmp_path / "suite.yaml"), str(tmp_path / "fast.mcap")]) == 0
    printed = capsys.readouterr().out
    assert "load: about " in printed
    assert "of one core for ship_attitude" in printed
    assert "it may fall behind; largest load: ins/imu at " in printed
