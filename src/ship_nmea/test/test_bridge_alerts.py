"""A simulated alert management of a bridge: it receives ALF, ALC and HBT and acknowledges with ACN.

The alerts are those of the real node ``alerts``, over DDS. The bridge is connected to a TCP sink, a second display
(``wing``) to a UDP sink.
"""

import os
import signal
import socket
import subprocess
import sys
import zlib

import pynmea2
import pytest

from ship_msgs.msg import Alert
from ship_testing.bridge import AttitudePublisher, Display, wait_until
from ship_testing.nmea_in_peer import free_port

pytestmark = pytest.mark.live

NO_DATA = 10_000 + zlib.crc32(b"attitude.silent") % 9_990_000
"""Number of the alert for a missing ship attitude."""


class AlertManagement:
    """The state of the alerts on a bridge, from the sentences alone."""

    def __init__(self):
        self.alerts, self.refusals, self.beats = {}, [], []
        self.listed = None
        self._list = {}

    def process(self, sentence):
        kind = type(sentence).__name__
        if kind == "ALF":
            key = sentence.manufacturer, sentence.alert, sentence.instance
            if sentence.number == 1:
                self.alerts[key] = sentence
            else:
                # The second sentence contains only the identity of the alert.
                assert (sentence.sequence, sentence.revision) == (self.alerts[key].sequence, self.alerts[key].revision)
                assert sentence.state == sentence.priority == sentence.category == ""
        elif kind == "ALC":
            if sentence.number == 1:
                self._list = {}
            entries = sentence.data[4:]
            for at in range(0, len(entries), 4):
                self._list[entries[at], int(entries[at + 1]), int(entries[at + 2])] = int(entries[at + 3])
            if sentence.number == sentence.total:
                self.listed = self._list
        elif kind == "ARC":
            self.refusals.append((sentence.alert, sentence.instance, sentence.command))
        elif kind == "HBT":
            assert not self.beats or sentence.sequence == (self._beat + 1) % 10
            self._beat = sentence.sequence
            self.beats.append(sentence.status)

    def state(self, identifier):
        """Return the state of the newest instance of an alert."""
        found = [alert for (_, number, _), alert in self.alerts.items() if number == identifier]
        return found[-1].state if found else None


class Bridge:
    """An alert management at a TCP sink."""

    def __init__(self, port):
        self.display, self.alert_management, self._taken = Display(port), AlertManagement(), 0

    def read(self):
        self.display.read()
        for sentence in self.display.sentences[self._taken :]:
            self.alert_management.process(sentence)
        self._taken = len(self.display.sentences)

    def command(self, identifier, instance, command):
        self.display.send(f"BNACN,120000.00,ZZZ,{identifier},{instance},{command},C")


@pytest.fixture
def processes(tmp_path):
    """Start programs in the namespace demo; at the end stop those that still run, and print all logs."""
    running = []
    environment = os.environ | {"ROS_LOG_DIR": str(tmp_path / "log")}

    def start(name, *command):
        log = (tmp_path / f"{name}.txt").open("w")
        process = subprocess.Popen([sys.executable, *command], stdout=log, stderr=log, env=environment)
        running.append(process)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(20.0)
    for log in sorted(tmp_path.glob("*.txt")):
        print(f"{log.name}:\n{log.read_text()}")


@pytest.fixture
def ship():
    ship = AttitudePublisher()
    yield ship
    ship.stop()


@pytest.fixture
def bridge():
    bridge = Bridge(free_port(socket.SOCK_STREAM))
    yield bridge
    bridge.display.close()


def acknowledgement(identifier):
    """Return an ACN without an instance, which refers to the present instance of the alert."""
    body = f"BNACN,,ZZZ,{identifier},,A,C"
    return f"${body}*{pynmea2.NMEASentence.checksum(body):02X}\r\n".encode()


def connect_as_other_host(kind, port):
    """Return a socket that a sink sees as another host."""
    found = socket.socket(socket.AF_INET, kind)
    found.bind(("127.0.0.2", 0))
    found.connect(("127.0.0.1", port))
    return found


def count(ship, name):
    """Return a count in the diagnostics of the alerts."""
    status = ship.statuses.get("nmea_out: alerts")
    return int(next((pair.value for pair in status.values if pair.key == name), 0)) if status else 0


def test_alert_is_received_acknowledged_and_rectified_on_the_bridge(ship, bridge, processes, tmp_path):
    udp_port, listen_port = free_port(), free_port()
    heading_display = Display(free_port(socket.SOCK_STREAM))
    limits = tmp_path / "limits.yaml"
    limits.write_text("alerts: {clear_after_s: 1.0}\n")
    suite = tmp_path / "suite.yaml"
    suite.write_text(
        "/**/nmea_out:\n  ros__parameters:\n    alerts_period_s: 0.5\n    sinks:\n"
        f"      bridge: {{kind: tcp_server, port: {bridge.display.port}, sentences: [ALF, ALC, HBT], "
        "from: [127.0.0.1]}\n"
        f"      wing: {{kind: udp, address: 127.0.0.1, port: {udp_port}, listen_port: {listen_port}, "
        "sentences: [ALF]}\n"
        f"      heading: {{kind: tcp_server, port: {heading_display.port}, sentences: [HDT], from: [127.0.0.1]}}\n"
    )
    processes("nmea_out", "-m", "ship_nmea.out.nmea_out", "--ros-args", "--params-file", str(suite),
              "-r", "__ns:=/demo")  # fmt: skip

    def wait_for(found, act=lambda: None):
        def look():
            bridge.read()
            return found(bridge.alert_management)

        return wait_until(ship, look, act)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wing:
        wing.bind(("127.0.0.1", udp_port))
        wing.setblocking(False)
        wait_until(ship, bridge.display.connect)
        # No alert node yet: an empty list would report that there is no alert.
        wait_for(lambda state: "V" in state.beats)
        assert bridge.alert_management.listed is None
        alerts = processes(
            "alerts", "-c", "import sys; from ship_monitor.alerts.alert_node import main; sys.exit(main())",
            "--limits", str(limits), "--state", str(tmp_path / "alerts.json"), "--ros-args", "-r", "__ns:=/demo",
        )  # fmt: skip
        wait_for(lambda state: state.beats[-1] == "A" and state.listed is not None, ship.publish)
        wait_until(
            ship, lambda: set(ship.alerts or ()) == {"attitude.degraded"}, ship.publish
        )  # ship/attitude was received
        wait_for(lambda state: state.state(NO_DATA) == "V")  # no ship/attitude any more
        shown = bridge.alert_management.alerts["ZZZ", NO_DATA, 1]
        assert (shown.priority, shown.text) == ("A", "ATTITUDE SILENT")
        wait_for(lambda state: ("ZZZ", NO_DATA, 1) in state.listed)

        # A client that receives no alerts cannot acknowledge any.
        wait_until(ship, heading_display.connect)
        heading_display.send(f"BNACN,120000.00,ZZZ,{NO_DATA},1,A,C")
        wait_until(ship, lambda: heading_display.read() or heading_display.last("ARC"))
        heading_display.close()
        # A host that is not the bridge cannot acknowledge an alert, and receives no answer.
        for number, (kind, port) in enumerate(
            ((socket.SOCK_STREAM, bridge.display.port), (socket.SOCK_DGRAM, listen_port)), start=1
        ):
            with connect_as_other_host(kind, port) as other_host:
                other_host.send(acknowledgement(NO_DATA))
                wait_until(ship, lambda number=number: count(ship, "not allowed") == number)
        bridge.command(NO_DATA, 2, "A")  # no such instance
        bridge.command(NO_DATA, 1, "S")  # silencing one alert is not supported
        bridge.command(NO_DATA + 1, 1, "A")  # no such alert
        refused = [(NO_DATA, 2, "A"), (NO_DATA, 1, "S"), (NO_DATA + 1, 1, "A")]
        wait_for(lambda state: sorted(state.refusals) == sorted(refused))
        assert ship.alerts["attitude.silent"].state == Alert.ACTIVE_UNACKNOWLEDGED
        bridge.display.send(f"BNACN,120000.00,FEC,{NO_DATA},1,A,C")  # addressed to another source: no answer at all
        bridge.display.connection.sendall(b"$BNACN,broken*00\r\n\xff\xfe$\r\n")
        bridge.command(NO_DATA, 1, "Q")
        bridge.command(NO_DATA, 1, "A")
        wait_for(lambda state: state.state(NO_DATA) == "A")
        wait_until(ship, lambda: ship.alerts["attitude.silent"].state == Alert.ACTIVE_ACKNOWLEDGED)
        assert sorted(bridge.alert_management.refusals) == sorted(refused)
        revision = bridge.alert_management.alerts["ZZZ", NO_DATA, 1].revision
        assert revision == shown.revision + 1
        wait_for(lambda state: state.listed.get(("ZZZ", NO_DATA, 1)) == revision)
        # ship/attitude is published again: the alert is rectified and removed from the list.
        wait_for(lambda state: state.state(NO_DATA) == "N", ship.publish)
        wait_for(lambda state: ("ZZZ", NO_DATA, 1) not in state.listed, ship.publish)

        # The wing receives the same, and may acknowledge, too.
        received = []

        def wing_alert(state):
            try:
                received.extend(
                    pynmea2.parse(line, check=True) for line in wing.recv(2000).decode().split("\r\n") if line
                )
            except BlockingIOError:
                return None
            fitting = [one for one in received if one.number == 1 and (one.alert, one.state) == (NO_DATA, state)]
            return fitting[-1] if fitting else None

        again = wait_until(ship, lambda: (found := wing_alert("V")) and found.instance == 2 and found)
        wing.sendto(acknowledgement(NO_DATA), ("127.0.0.1", listen_port))
        wait_until(ship, lambda: (found := wing_alert("A")) and found.instance == again.instance)

        # The alert node has ended: the heartbeat reports it to the bridge, and no empty list is sent.
        alerts.send_signal(signal.SIGINT)
        alerts.wait(20.0)
        wait_for(lambda state: state.beats[-1] == "V")
        wait_until(ship, lambda: ship.statuses["nmea_out: alerts"].level == b"\x01")
        values = {pair.key: pair.value for pair in ship.statuses["nmea_out: alerts"].values}
        assert values["not allowed"] == "2"
        assert (values["acknowledged"], values["refused"], values["for others"], values["unreadable"]) == (
            "2", "4", "1", "2"
        )  # fmt: skip
