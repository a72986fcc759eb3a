"""``nmea_out`` as a process of its own: attitudes over DDS are sent as sentences; errors at the start are reported."""

import math
import os
import signal
import socket
import subprocess
import sys
import time
from datetime import datetime, timezone

import pynmea2
import pytest
from rosgraph_msgs.msg import Clock

from ship_msgs.msg import Alert, AlertArray, ShipAttitude
from ship_nmea.out.nmea_out import Throttle, main
from ship_testing.bridge import LATCHED, AttitudePublisher, Display, wait_until
from ship_testing.nmea_in_peer import free_port
from ship_testing.trials.live_process import free_domain_id

pytestmark = pytest.mark.live

NODE = [sys.executable, "-m", "ship_nmea.out.nmea_out", "--ros-args"]


@pytest.fixture(scope="module")
def ship():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_DOMAIN_ID", str(free_domain_id()))
        ship = AttitudePublisher()
        yield ship
        ship.stop()


def parameters(**values):
    return [part for name, value in values.items() for part in ("-p", f"{name.replace('__', '.')}:={value}")]


def start_node(log, *arguments):
    environment = os.environ | {"ROS_LOG_DIR": str(log.parent)}
    with log.open("w") as file:
        return subprocess.Popen([*NODE, *arguments, "-r", "__ns:=/demo"], stderr=file, stdout=file, env=environment)


def stop_node(process):
    process.send_signal(signal.SIGINT)
    return process.wait(20.0)


@pytest.fixture(scope="module")
def bridge(tmp_path_factory, ship):
    """A display at the TCP sink of a node that also has a slow file sink."""
    folder, port = tmp_path_factory.mktemp("bridge"), free_port(socket.SOCK_STREAM)
    process = start_node(folder / "log.txt", *parameters(
        sinks__bridge__kind="tcp_server", sinks__bridge__port=port, sinks__bridge__decimals=3,
        sinks__bridge__sentences="[HDT, THS, ROT, PASHR, PSXN20, PSXN23]", sinks__bridge__rate_hz=100.0,
        sinks__log__kind="file", sinks__log__path=folder / "log.nmea", sinks__log__rate_hz=1.0, longest_age_s=0.5,
        black_box="boxes/",
    ))  # fmt: skip
    listener = Display(port)
    listener.file, listener.log, listener.process = folder / "log.nmea", folder / "log.txt", process
    wait_until(ship, listener.connect)
    yield listener
    listener.close()
    code = process.poll() if process.poll() is not None else stop_node(process)
    assert code == 0, (folder / "log.txt").read_text()


def read_until(ship, bridge, found, publish=lambda: None):
    """Read the bridge's sentences, from now on, until ``found`` is true."""
    bridge.clear()

    def look():
        bridge.read()
        return found()

    return wait_until(ship, look, publish)


def shows(bridge, heading_deg):
    last = bridge.last("HDT")
    return last is not None and last.heading and abs(float(last.heading) - heading_deg) < 0.01


@pytest.mark.parametrize(("status", "mode", "quality"), [
    (ShipAttitude.VALID, "A", 0), (ShipAttitude.COASTING, "E", 1), (ShipAttitude.DEGRADED, "E", 1),
])  # fmt: skip
def test_attitude_is_sent_with_its_quality(ship, bridge, status, mode, quality):
    heading_deg = 100.0 + 10.0 * status
    messages = {}

    def publish():
        message = ship.publish(heading_deg, status=status)
        stamp = message.header.stamp
        messages[f"{stamp.sec % 60:02d}.{round(stamp.nanosec / 1e6):03d}"] = message

    read_until(ship, bridge, lambda: shows(bridge, heading_deg) and bridge.last("SXN23"), publish)
    assert bridge.last("THS").mode == mode
    assert (bridge.last("SXN20").head_qual, bridge.last("SXN20").rp_qual) == (quality, quality)
    assert bridge.last("ROT").status == "A"
    assert float(bridge.last("ROT").rate_of_turn) == pytest.approx(30.0, abs=0.2)
    pashr = bridge.last("ASHRATT")
    assert (pashr.pitch, pashr.roll) == (2.0, -3.0)
    # 3″, 2″ and 1″, rounded up to a multiple of 0.0001°.
    assert (pashr.heading_accuracy, pashr.pitch_accuracy, pashr.roll_accuracy) == (0.0009, 0.0006, 0.0003)
    assert pashr.data[1][4:] in messages  # the time is that of the stamp


def is_void(bridge):
    names = ("HDT", "THS", "ROT", "ASHRATT", "SXN20", "SXN23")
    if any(bridge.last(name) is None for name in names) or bridge.last("HDT").heading:
        return False
    _, ths, rot, pashr, quality, motion = map(bridge.last, names)
    assert (ths.heading, ths.mode, rot.rate_of_turn, rot.status) == (None, "V", "", "V")
    assert pashr.data[2:10] == [""] * 8
    assert (quality.head_qual, quality.rp_qual) == (2, 2)
    assert motion.data[2:] == [""] * 4
    return True


@pytest.mark.parametrize(("how", "text"), [
    ({"status": ShipAttitude.INVALID}, "ship/attitude is INVALID"),
    ({"status": 17}, "ship/attitude is INVALID"),
    ({"heading_deg": math.nan}, "ship/attitude has an angle that is not a number"),
    ({"roll_deg": math.inf}, "ship/attitude has an angle that is not a number"),
    ({"age_s": 5.0}, "the stamp of ship/attitude is 5.0"),
    ({"age_s": -5.0}, "after this node's clock"),
    (None, "ship/attitude: no message for"),
])  # fmt: skip
def test_invalid_or_old_attitude_is_sent_void(ship, bridge, how, text):
    read_until(ship, bridge, lambda: shows(bridge, 55.0), lambda: ship.publish(55.0))
    ship.statuses.clear()
    read_until(ship, bridge, lambda: is_void(bridge), lambda: how and ship.publish(**how))
    bridge.clear()

    def status_has_reason():
        status = ship.statuses.get("nmea_out: attitude")
        return status is not None and text in status.message

    wait_until(ship, status_has_reason, lambda: how and ship.publish(**how))
    bridge.read()
    assert bridge.sentences
    assert not any(one.heading for one in bridge.sentences if type(one).__name__ == "HDT")


def test_attitude_at_ten_kilohertz_is_sent_at_the_rate_of_the_sink(ship, bridge):
    """The node stays alive, its sentences are recent, and another sink keeps its own rate."""
    read_until(ship, bridge, lambda: shows(bridge, 1.0), lambda: ship.publish(1.0))
    began_s, before = time.monotonic(), bridge.file.read_text().count("HDT")
    while time.monotonic() - began_s < 3.0:
        for _ in range(500):
            ship.publish(1.0)
        bridge.clear()
        ship.spin(0.0)
    read_until(ship, bridge, lambda: shows(bridge, 2.0), lambda: ship.publish(2.0))
    lasted_s = time.monotonic() - began_s
    assert bridge.file.read_text().count("HDT") - before <= lasted_s * 1.0 + 2
    assert bridge.process.poll() is None


def test_unused_black_box_parameter_is_a_warning(bridge):
    assert "parameter 'black_box' is not used: no replay runs this node" in bridge.log.read_text()


def test_diagnostics_contain_every_sink(ship, bridge):
    wait_until(ship, lambda: {"nmea_out: sink bridge", "nmea_out: sink log"} <= set(ship.statuses))
    assert ship.statuses["nmea_out: sink bridge"].hardware_id == "/demo/nmea_out"
    assert ship.statuses["nmea_out: sink log"].level == b"\x00"


SINK = "/**/nmea_out:\n  ros__parameters:\n    sinks:\n      bridge:\n"


@pytest.mark.parametrize(("text", "expected"), [
    (SINK + "        kind: tcp_server\n        prt: 10110\n",
     ":6: parameter 'sinks.bridge.prt' is unknown: expected one of port,"),
    (SINK + "        kind: tcp\n", ":5: parameter 'sinks.bridge.kind' = 'tcp' must be one of udp, tcp_server,"),
    (SINK + "        kind: serial\n", ":5: parameter 'sinks.bridge.device' must be given for kind serial"),
    (SINK + "        kind: file\n        path: log\n        port: 7\n",
     ":7: parameter 'sinks.bridge.port' does not apply to kind file, which takes path"),
    (SINK + "        kind: udp\n        address: bridge\n        port: 10110\n",
     ":6: parameter 'sinks.bridge.address' is 'bridge': expected an IPv4 address"),
    (SINK + "        kind: tcp_server\n        port: 10110\n        sentences: [HDT, VTG]\n",
     ":7: parameter 'sinks.bridge.sentences[1]' = 'VTG' must be one of HDT,"),
    (SINK + "        kind: tcp_server\n        port: 10110\n    talker: hehe\n",
     ":7: parameter 'talker' = 'hehe': expected 2 capital letters"),
    (SINK + "        kind: tcp_server\n        port: BUSY\n",
     ":6: parameter 'sinks.bridge.port' = BUSY: Address already in use: another program uses it"),
    ("/**/nmea_out:\n  ros__parameters:\n    talker: HE\n", ": parameter 'sinks' names no sink"),
    ("/**/nmeaout:\n  ros__parameters:\n    talker: HE\n", ":1: section '/**/nmeaout' does not fit node '/nmea_out'"),
])  # fmt: skip
def test_bad_parameter_is_one_line_with_file_line_and_expectation(tmp_path, monkeypatch, capsys, text, expected):
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # keep the handlers of the tests
    path = tmp_path / "suite.yaml"
    with socket.socket() as busy:
        busy.bind(("", 0))
        busy.listen()
        port = str(busy.getsockname()[1])
        path.write_text(text.replace("BUSY", port))
        code = main(["--ros-args", "--params-file", str(path)])
    printed = capsys.readouterr()
    assert (code, printed.out) == (2, "")
    place = f"nmea_out: {path}" if expected.startswith(":") and "names no sink" not in expected else "nmea_out"
    assert printed.err.count("\n") == 1
    assert printed.err.startswith(place + expected.replace("BUSY", port)), printed.err


def test_busy_port_of_one_sink_does_not_stop_the_others(tmp_path):
    log = tmp_path / "log.txt"
    with socket.socket() as busy:
        busy.bind(("", 0))
        busy.listen()
        port, path = busy.getsockname()[1], tmp_path / "log.nmea"
        process = start_node(log, *parameters(
            sinks__busy__kind="tcp_server", sinks__busy__port=port, sinks__log__kind="file", sinks__log__path=path,
        ))  # fmt: skip
        try:
            wait_s = time.monotonic() + 60.0
            while not (path.exists() and path.stat().st_size):
                assert time.monotonic() < wait_s, log.read_text()
                time.sleep(0.05)
        finally:
            assert stop_node(process) == 0
    assert path.read_text().startswith("$INHDT,,T*")
    expected = f"parameter 'sinks.busy.port' = {port}: Address already in use: another program uses it"
    assert expected in log.read_text()


def test_no_alert_of_a_played_bag_is_sent(tmp_path):
    """A void PASHR before the first /clock does not have the time of 1970."""
    ship = AttitudePublisher()
    path, began = tmp_path / "log.nmea", datetime.now(timezone.utc)
    process = start_node(tmp_path / "log.txt", *parameters(
        use_sim_time="true", sinks__log__kind="file", sinks__log__path=path, alerts_period_s=0.2,
        sinks__log__sentences="[PASHR, ALF, ALC, HBT]",
    ))  # fmt: skip
    alerts = ship.node.create_publisher(AlertArray, "ship/alerts", LATCHED)
    alerts.publish(AlertArray(alerts=[Alert(id="attitude.lost", priority=Alert.ALARM, text="no attitude")]))
    clock = ship.node.create_publisher(Clock, "/clock", 10)
    try:
        wait_until(ship, lambda: path.exists() and path.read_text().count("PASHR") > 2)
        wait_until(
            ship,
            lambda: "no alert is sent, heartbeat status V" in status_text(ship, "alerts"),
            lambda: tick(clock, began),
        )
        beats = path.read_text().count("HBT")
        wait_until(ship, lambda: path.read_text().count("HBT") > beats + 2, lambda: tick(clock, began))
    finally:
        ship.stop()
        assert stop_node(process) == 0
    sentences = [pynmea2.parse(line, check=True) for line in path.read_text().splitlines()]
    assert {type(sentence).__name__ for sentence in sentences} == {"ASHRATT", "HBT"}
    assert {sentence.status for sentence in sentences if type(sentence).__name__ == "HBT"} == {"V"}
    first = sentences[0].timestamp
    assert abs(first.hour * 60 + first.minute - began.hour * 60 - began.minute) <= 2


def status_text(ship, name):
    status = ship.statuses.get(f"nmea_out: {name}")
    return status.message if status else ""


def tick(clock, began):
    """Publish the bag's time, a year ago, on /clock."""
    message = Clock()
    message.clock.sec = int(began.timestamp()) - 31_536_000
    message.clock.nanosec = time.monotonic_ns() % 10**9
    clock.publish(message)


def test_bad_parameter_ends_the_process_with_2():
    result = subprocess.run([*NODE, "-p", "talker:=x"], capture_output=True, text=True, timeout=60, check=False)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == "nmea_out: parameter 'sinks' names no sink: expected one as 'sinks.bridge.kind'\n"


def test_throttle_selects_the_rate():
    """The rate holds with jitter too, and there is no burst after a gap."""
    period_ns = 10_000_000
    jitter = [0, 3_000_000, -2_000_000, 1_000_000, -3_000_000]
    for rate_hz, taken in ((10.0, 100), (100.0, 1000), (1000.0, 1000), (30.0, 300)):
        pace = Throttle(rate_hz)
        sent = [pace.is_due(number * period_ns + jitter[number % 5]) for number in range(1000)]
        assert abs(sum(sent) - taken) <= 2
    pace = Throttle(10.0)
    assert [pace.is_due(time_ns) for time_ns in (0, 10**12, 10**12 + 1, 10**12 + 10**8)] == [True, True, False, True]
