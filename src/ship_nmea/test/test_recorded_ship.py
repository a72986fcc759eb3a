"""Recorded lines of a ship, sent live, give the same messages as import_nmea gives."""

from datetime import datetime, timezone
from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message

from ship_bags.commands.import_nmea import main as import_nmea
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.nmea.instrument_lines import datetime_ns
from ship_bags.stamps import NS_PER_S
from ship_testing.message_values import value_bytes
from ship_testing.nmea_in_peer import free_port

LOGS = Path(__file__).parents[4] / "shared" / "data" / "nbp1406"
FILES = {"seapath": "seap", "s330": "s330", "gyro": "gyr1", "mast": "mwx1"}
ROLES = {"seapath": "ins", "s330": "reference", "gyro": "gyro", "mast": "weather"}
ARRIVAL_STAMPED = ("reference/gyro/imu", "met/temperature", "met/humidity", "met/pressure")
"""Topics whose sentences contain no time: the stamp is the arrival."""

MIDNIGHT_NS = datetime_ns(datetime(2014, 8, 1, tzinfo=timezone.utc))
EXCERPT_S, CLOCK_STEP_S, BLOCK_S = 240, 80, 10
"""During each step of 80 s /clock stays at the middle of the step: instrument times may differ from it by a minute."""

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(not LOGS.is_dir(), reason=f"the ship's records are not here: {LOGS}"),
]


def excerpt(source):
    """Return (receive time in s since midnight, line) of the first minutes of a log."""
    lines = []
    for line in (LOGS / f"NBP1406_{FILES[source]}-2014-08-01").read_text().splitlines():
        hours, minutes, seconds = (float(part) for part in line.partition(" ")[0][11:-1].split(":"))
        lines.append((3600.0 * hours + 60.0 * minutes + seconds, line))
    return [(time_s, line) for time_s, line in lines if time_s < EXCERPT_S]


@pytest.fixture
def imported_messages(tmp_path):
    """Topic → (log time in s since midnight, CDR bytes) of the messages of import_nmea from the excerpts."""
    paths = {}
    for source in FILES:
        paths[source] = tmp_path / f"{source}.log"
        paths[source].write_text("".join(f"{line}\n" for _, line in excerpt(source)))
    out = tmp_path / "imported.mcap"
    options = ["--ins", paths["seapath"], "--reference", f"s330={paths['s330']}", "--gyro", paths["gyro"]]
    options += ["--weather", paths["mast"], "--out", out]
    assert import_nmea([str(option) for option in options]) == 0
    found = {}
    with read_bag(out) as bag:
        for record in bag.records():
            time_s = (record.log_time_ns - MIDNIGHT_NS) / NS_PER_S
            found.setdefault(record.topic, []).append((time_s, bytes(record.data)))
    return found


def test_live_messages_equal_imported_ones(listening, imported_messages):
    node = listening(
        {
            source: {"kind": "udp", "address": "127.0.0.1", "port": free_port(), "becomes": ROLES[source]}
            for source in FILES
        },
        use_sim_time=True,
    )
    assert node.received.keys() == imported_messages.keys()
    lines = sorted((time_s, source, line) for source in FILES for time_s, line in excerpt(source))
    for begin_s in range(0, EXCERPT_S, BLOCK_S):
        if begin_s % CLOCK_STEP_S == 0:
            node.set_time(MIDNIGHT_NS + (begin_s + CLOCK_STEP_S // 2) * NS_PER_S)
        for time_s, source, line in lines:
            if begin_s <= time_s < begin_s + BLOCK_S:
                node.send(source, line.partition(" ")[2].encode())
        # The next lines are sent when the node has published all messages of these: no line is lost.
        for topic, expected in imported_messages.items():
            count = sum(time_s < begin_s + BLOCK_S for time_s, _ in expected)
            node.wait_until(lambda topic=topic, count=count: len(node.received[topic]) >= count)
    for topic, expected in imported_messages.items():
        received, kind = node.received[topic], type(node.received[topic][0])
        assert len(received) == len(expected) > 200
        wanted = [deserialize_message(data, kind) for _, data in expected]
        if topic in ARRIVAL_STAMPED:
            for message in (*received, *wanted):
                message.header.stamp.sec = message.header.stamp.nanosec = 0
        assert [value_bytes(message) for message in received] == [value_bytes(message) for message in wanted]
    assert node.exception_text() == "no exception"
