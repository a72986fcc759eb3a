"""The end of a replay's output: the status history, and reasons for poor statuses."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from ship_bags.mcap.bag_reader import read_bag
from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT, BagWriter
from ship_bags.message_store import RosbagsFactory
from ship_bags.stamps import make_header
from ship_replay.commands.check_config import main as check_config
from ship_replay.commands.replay import main as replay
from ship_replay.offline.message_times import Gaps
from ship_replay.offline.replay_summary import StatusHistory
from ship_testing.bag_parts import write_beginning
from ship_testing.hand_made_bags import START_NS, imu, ship_attitude

DEMO = Path(__file__).parents[3] / "bags" / "demo.mcap"
SECOND_NS = 1_000_000_000
VALID, COASTING, DEGRADED, INVALID = range(4)
SUITE = """\
/**/ship_attitude:
  ros__parameters:
    ins: {max_gap_s: 0.5}
    references:
      b: {frame_id: b}
"""


@dataclass
class Output:
    header: object
    status: int


def history_of(*entries: tuple[float, int]) -> StatusHistory:
    history, factory = StatusHistory(), RosbagsFactory()
    for time_s, status in entries:
        history.add(Output(make_header(factory, START_NS + round(time_s * SECOND_NS), ""), status))
    return history


def test_spans_of_a_status_are_merged_and_share_the_time() -> None:
    begin = (0.0, DEGRADED), (1.0, DEGRADED), (2.0, VALID), (3.0, VALID)
    history = history_of(*begin, (4.0, COASTING), (9.0, VALID), (10.0, VALID))
    assert [(s.status, (s.start_ns - START_NS) / SECOND_NS, s.count) for s in history.spans] == [
        ("DEGRADED", 0.0, 2),
        ("VALID", 2.0, 2),
        ("COASTING", 4.0, 1),
        ("VALID", 9.0, 2),
    ]
    lines = [" ".join(line.split()) for line in history.lines("ship/attitude")]
    assert lines[0].startswith("status of ship/attitude from ")
    assert lines[0].endswith(", 10.0 s:")
    assert lines[1:4] == [
        "VALID 30.0% of the time, 4 of 7 outputs",
        "COASTING 50.0% of the time, 1 of 7 outputs",
        "DEGRADED 20.0% of the time, 2 of 7 outputs",
    ]
    assert lines[4] == "0.0 s to 2.0 s DEGRADED 2 outputs"
    assert lines[-1] == "9.0 s to 10.0 s VALID 2 outputs"


def test_invalid_ticks_are_placed_by_their_time() -> None:
    """INVALID is stamped by the clock: the message can follow an attitude with a later stamp."""
    history = history_of((0.0, VALID), (5.0, VALID), (3.0, INVALID), (6.0, VALID))
    assert [span.status for span in history.spans] == ["VALID", "INVALID", "VALID"]
    assert [span.count for span in history.spans] == [2, 1, 1]


def test_of_many_spans_the_longest_are_shown() -> None:
    history = history_of(*((float(second), second % 2) for second in range(60)))
    assert history.lines("ship/attitude")[-1] == "  and 48 shorter spans"
    assert StatusHistory().lines("ship/attitude") == ["status of ship/attitude: no output"]


def test_gaps_are_those_between_times_in_order() -> None:
    gaps = Gaps()
    for time_ms in (0, 200, 100, 100, 1300):
        gaps.add(START_NS + time_ms * 1_000_000)
    lengths_s, counts = gaps.seconds()
    assert lengths_s == pytest.approx([0.1, 1.1 + 0.0])
    assert counts.tolist() == [2, 1]


def slow_bag(path, period_s=1.0, count=60):
    with BagWriter(path) as bag:
        for number in range(count):
            stamp_ns = START_NS + round(number * period_s * SECOND_NS)
            bag.write("ins/imu", imu(stamp_ns), stamp_ns)
            bag.write("reference/b/imu", imu(stamp_ns - round(0.3 * period_s * SECOND_NS), "b"), stamp_ns)
    return path


def test_an_ins_at_one_hertz_is_an_error_with_advice(tmp_path, capsys):
    """Samples 1 s apart exceed the maximum gap of 0.5 s, so no attitude between them could be interpolated."""
    config, bag = tmp_path / "suite.yaml", slow_bag(tmp_path / "a.mcap")
    config.write_text(SUITE)
    assert check_config([str(config), str(bag)]) == 2
    lines = capsys.readouterr().err.splitlines()
    text = f"error: {config}:3: parameter 'ins.max_gap_s' = 0.5 s, but messages of 'ins/imu' in {bag} are stamped 1 s"
    assert lines[0].startswith(f"{text} apart (59 of 59 gaps are longer): no interpolation across such a gap")
    assert lines[0].endswith("record it more often (import_nmea --resample HZ), or set 'ins.max_gap_s' to 1.5")
    assert check_config([str(config), str(slow_bag(tmp_path / "b.mcap", period_s=0.1))]) == 0


def test_a_gap_is_a_warning(tmp_path, capsys):
    config, bag = tmp_path / "suite.yaml", tmp_path / "a.mcap"
    config.write_text(SUITE)
    with BagWriter(bag) as writer:
        for number in range(300):
            stamp_ns = START_NS + (number + (30 if number > 100 else 0)) * SECOND_NS // 10
            writer.write("ins/imu", imu(stamp_ns), stamp_ns)
            writer.write("reference/b/imu", imu(stamp_ns, "b"), stamp_ns)
    assert check_config([str(config), str(bag)]) == 0
    warnings = [line for line in capsys.readouterr().out.splitlines() if line.startswith("warning")]
    assert [line.partition("parameter ")[2].partition(" =")[0] for line in warnings] == [
        "'ins.max_gap_s'",
        "'ins.silence_s'",
    ]
    assert all("up to 3.1 s apart (1 of 299 gaps are longer)" in line for line in warnings)
    assert all(line.endswith("look for lost messages") for line in warnings)


def test_a_replay_prints_why_nothing_was_valid(tmp_path, capsys):
    config, bag = tmp_path / "suite.yaml", slow_bag(tmp_path / "a.mcap")
    config.write_text(SUITE)
    assert replay([str(bag), "--config", str(config), "--out", str(tmp_path / "out.mcap")]) == 0
    lines = capsys.readouterr().out.splitlines()
    (heading,) = [number for number, line in enumerate(lines) if line.startswith("why ")]
    assert lines[heading].endswith("outputs of ship_attitude:")
    assert lines[heading + 1] == "  diagnostics, 59 of 59: DEGRADED: INS alone, no star yet"
    assert lines[heading + 3].startswith("  parameter 'ins.max_gap_s' = 0.5 s, but messages of 'ins/imu' in the bag")
    assert any(line.startswith("status of ship/attitude from ") for line in lines[:heading])
    assert any("0 of 60 messages on 'reference/b/imu' were used, " in line for line in lines[heading:])


def test_a_replay_names_a_missing_input(tmp_path, capsys):
    config, bag = tmp_path / "suite.yaml", tmp_path / "a.mcap"
    config.write_text("/**/ship_attitude: {ros__parameters: {references: {b: {frame_id: b}}}}\n")
    with BagWriter(bag) as writer:
        for number in range(400):
            stamp_ns = START_NS + number * SECOND_NS // 20
            writer.write("truth/attitude", ship_attitude(stamp_ns), stamp_ns)
            writer.write("ins/imu", imu(stamp_ns), stamp_ns)
    assert replay([str(bag), "--config", str(config), "--out", str(tmp_path / "out.mcap")]) == 0
    out = capsys.readouterr().out
    heading = "why 400 DEGRADED of 400 outputs of ship_attitude:\n"
    no_stars = "  no star_sensors are configured: by references alone the attitude stays DEGRADED, horizon GRAVITY\n"
    text = "  diagnostics, 20 of 20: DEGRADED: INS alone, no star yet\n"
    assert f"{heading}{text}{no_stars}  no messages on 'reference/b/imu'" in out


def test_a_replay_gives_the_reason_that_the_node_itself_gave(tmp_path, capsys):
    """The reason is the exceeded alert limit, also if an optional sensor has no data."""
    config, bag = tmp_path / "suite.yaml", tmp_path / "a.mcap"
    write_beginning(DEMO, bag, 6)
    with read_bag(DEMO) as demo:
        suite = demo.attachments[SUITE_ATTACHMENT].decode()
    limit = "    integrity: {alert_limit_arcsec: [0.1, 0.1, 0.1]}\n"
    absent = "    references: {gyro: {frame_id: gyro}}\n"
    for more, line in ((limit, None), (limit + absent, "  no messages on 'reference/gyro/imu'")):
        config.write_text(suite.replace("    star_sensors:\n", f"{more}    star_sensors:\n"))
        assert replay([str(bag), "--config", str(config), "--out", str(tmp_path / "out.mcap"), "--force"]) == 0
        why = capsys.readouterr().out.partition("\nwhy ")[2].splitlines()[1:]
        assert why[0].startswith("  diagnostics, ")
        assert ": DEGRADED: a protection level is above its alert limit: heading " in why[0]
        assert [each for each in why if not each.startswith("  diagnostics, ")] == ([line] if line else [])


def test_diagnostics_are_counted_without_numbers_and_only_if_poor() -> None:
    history = history_of((0.0, DEGRADED))
    for text in ("above its limit: 3.5″", "above its limit: 12″", "INS alone"):
        history.add_diagnostic(text)
    history.add(Output(make_header(RosbagsFactory(), START_NS + SECOND_NS, ""), VALID))
    history.add_diagnostic("VALID")
    assert history.diagnostic_lines == ["diagnostics, 2 of 3: above its limit: 12″", "diagnostics, 1 of 3: INS alone"]
