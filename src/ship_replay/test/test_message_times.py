"""A bag whose recorder stalled: reported, and replayed by stamps like a regular recording."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_bags.mcap.bag_reader import BagRecord, read_bag
from ship_bags.mcap.bag_writer import BagWriter
from ship_bags.message_store import message_store, serialize
from ship_bags.stamps import ns_from_stamp
from ship_replay.commands.replay import main
from ship_replay.offline.message_times import Gaps, LogDelays, sort_by_stamp
from ship_replay.offline.replay import replay
from ship_testing.hand_made_bags import START_NS, imu

DEMO = Path(__file__).parents[3] / "bags" / "demo.mcap"
SECOND_NS = 10**9
STALL_S = (6.0, 9.0)


def write_stalled(path, stall_s):
    """Write the first fifteen seconds of the demo; messages of the stall are logged at its end."""
    with read_bag(DEMO) as bag, BagWriter(path) as out:
        out.add_attachment("suite.yaml", bag.attachments["suite.yaml"])
        first_ns, last_ns = (bag.start_ns + round(limit * SECOND_NS) for limit in stall_s)
        for record in bag.records():
            if record.log_time_ns > bag.start_ns + 15 * SECOND_NS:
                break
            inside = first_ns <= record.log_time_ns < last_ns
            out.write_raw(record.topic, record.type_name, record.data, last_ns if inside else record.log_time_ns)
    return path


def attitudes(path):
    """Return stamp → heading of outputs other than INVALID."""
    with read_bag(path) as bag:
        messages = (record.decode() for record in bag.records({"ship/attitude"}))
        return {ns_from_stamp(m.header.stamp): m.heading for m in messages if m.status != m.INVALID}


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stall")
    return write_stalled(folder / "regular.mcap", (0.0, 0.0)), write_stalled(folder / "stalled.mcap", STALL_S)


def test_replay_by_stamps_of_a_stalled_recording(bags, tmp_path):
    outputs, summaries = [], []
    for number, bag in enumerate(bags):
        out = tmp_path / f"{number}.mcap"
        summaries.append(replay(bag, out, (ShipAttitudeAdapter,), by_stamps=True))
        outputs.append(out)
    regular, held_up = map(attitudes, outputs)
    assert len(regular) > 700
    assert held_up == regular
    # No warning if there is no effect.
    assert [summary.log_delays.irregularity_text() for summary in summaries] == ["", ""]
    again = tmp_path / "again.mcap"
    replay(bags[1], again, (ShipAttitudeAdapter,), by_stamps=True)
    assert again.read_bytes() == outputs[1].read_bytes()


def test_irregular_log_times_are_reported(bags, tmp_path, capsys):
    for bag in bags:
        assert main([str(bag), "--out", str(tmp_path / f"out_{bag.name}")]) == 0
    reported = [line for line in capsys.readouterr().out.splitlines() if "log times" in line]
    (line,) = reported
    assert "messages were logged more than 0.5 s later after their stamps than usual, the most by 3.00 s" in line
    assert "--arrival stamps" in line


def record_of(stamp_ns, log_time_ns):
    return BagRecord("ins/imu", "sensor_msgs/msg/Imu", log_time_ns, serialize(imu(stamp_ns)), message_store())


def test_messages_without_a_usable_stamp_keep_their_place():
    """Log times are half a second or more after the stamps; one stamp is zero, one is 12 days ahead."""
    rng = np.random.default_rng(1)
    stamps = START_NS + np.arange(300) * 10**8
    logged = np.maximum.accumulate(stamps + 5 * 10**8 + np.where(rng.random(300) < 0.1, 2 * SECOND_NS, 0))
    shown = stamps.copy()
    shown[40], shown[70] = 0, START_NS + 10**9 * SECOND_NS // 10**3
    records = [record_of(int(s), int(log)) for s, log in zip(shown, logged, strict=True)]
    times = LogDelays()
    for record in records:
        times.add(record.topic, record)
    assert times.median_ns() >= 5 * 10**8
    places = [int(log) - times.median_ns() for log in logged]
    arrived = [record.log_time_ns for record in sort_by_stamp(iter(records), times.median_ns())]
    assert arrived == sorted(arrived)
    expected = Counter(int(stamp) for number, stamp in enumerate(stamps) if number not in (40, 70))
    assert Counter(arrived) == expected + Counter([places[40], places[70]])


@pytest.mark.parametrize("option", ["--verify"])
def test_arrival_by_stamps_does_not_verify(bags, option, tmp_path, capsys):
    assert main([str(bags[0]), "--out", str(tmp_path / "o.mcap"), "--arrival", "stamps", option]) == 2
    assert "contradict each other" in capsys.readouterr().err


@pytest.mark.parametrize("late", [0, 10, 3000])
def test_times_noted_together_are_those_noted_one_by_one(late):
    """Times are out of order by up to ``late`` places, also by more than :class:`Gaps` sorts."""
    rng = np.random.default_rng(late)
    times_ns = np.cumsum(rng.integers(0, 20_000_000, 5000))
    times_ns = times_ns[np.argsort(np.arange(5000) + rng.uniform(0, late, 5000), kind="stable")]
    one, many = Gaps(), Gaps()
    for time_ns in times_ns.tolist():
        one.add(time_ns)
    for part in np.split(times_ns, [1, 700, 4000]):
        many.add_block(part)
    for expected, found in zip(one.seconds(), many.seconds(), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_of_messages_noted_together_one_without_a_stamp_is_left_out():
    stamps_ns = np.array([START_NS, 0, START_NS + SECOND_NS])
    log_times_ns = START_NS + np.array([2_000_000, 500_000_000, SECOND_NS + 2_000_000])
    times = LogDelays()
    times.add_block("ins/imu", stamps_ns, log_times_ns)
    times.add_block("ins/imu", stamps_ns[1:2], log_times_ns[1:2])
    assert (times.median_ns(), times.irregularity_text()) == (2_000_000, "")
