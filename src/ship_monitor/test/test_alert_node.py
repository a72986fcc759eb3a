"""The alert node over DDS, as a process: alerts raised, acknowledged, and restored after a kill."""

import json
import subprocess
import sys
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

from ship_bags.commands.record import main as record
from ship_bags.mcap.bag_reader import read_bag
from ship_bags.stamps import stamp_fields
from ship_monitor.alerts.alert_node import default_state, main
from ship_msgs.msg import Alert, AlertArray, ShipAttitude
from ship_msgs.srv import AcknowledgeAlert

pytestmark = pytest.mark.live

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
START = "import sys; from ship_monitor.alerts.alert_node import main; sys.exit(main())"


class Ship:
    """A suite in the namespace demo with a good attitude, and a subscriber of its alerts."""

    def __init__(self):
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node("ship_attitude", context=self.context, namespace="demo")
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.attitudes = self.node.create_publisher(ShipAttitude, "ship/attitude", 10)
        self.diagnostics = self.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.alert_messages, self.statuses = [], {}
        self.node.create_subscription(AlertArray, "ship/alerts", self.alert_messages.append, LATCHED)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take_statuses, 100)
        self.acknowledger = self.node.create_client(AcknowledgeAlert, "alerts/acknowledge")
        self.silencer = self.node.create_client(Trigger, "alerts/silence")
        self.black_box_level = None

    def _take_statuses(self, message):
        self.statuses |= {status.name: status for status in message.status}

    def sail(self, seconds=0.1, sigma_arcsec=0.5, is_stopped=False):
        """Run for some seconds, with or without attitudes at 20 Hz."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            if not is_stopped:
                message = ShipAttitude(heading=1.0, star_age_s=0.1)
                message.header.stamp.sec, message.header.stamp.nanosec = stamp_fields(time.time_ns())
                variance = (sigma_arcsec * 4.848e-6) ** 2
                message.covariance = [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]
                self.attitudes.publish(message)
            if self.black_box_level is not None:
                text, values = "writing failed: No space left on device", [KeyValue(key="bytes", value="1")]
                name = "ship_attitude: black box"
                status = DiagnosticStatus(level=self.black_box_level, name=name, message=text, values=values)
                self.diagnostics.publish(DiagnosticArray(status=[status]))
            self.executor.spin_once(timeout_sec=0.05)

    def alerts(self):
        """Return id → alert of the last message; None before the first."""
        return {alert.id: alert for alert in self.alert_messages[-1].alerts} if self.alert_messages else None

    def call(self, client, request):
        """Return the answer of a service."""
        answer = client.call_async(request)
        self.executor.spin_until_future_complete(answer, 10.0)
        return answer.result()

    def acknowledge(self, id_, instance):
        """Acknowledge an alert; return the node's answer."""
        return self.call(self.acknowledger, AcknowledgeAlert.Request(id=id_, instance=instance))

    def stop(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def ship():
    ship = Ship()
    yield ship
    ship.stop()


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Start the node; end all running processes after the test."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    started = []

    def begin(*arguments):
        command = [sys.executable, "-c", START, *arguments, "--ros-args", "-r", "__ns:=/demo"]
        log = (tmp_path / f"{len(started)}.txt").open("w+")
        process = subprocess.Popen(command, stderr=log, stdout=log, text=True)
        process.log_path = tmp_path / f"{len(started)}.txt"
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.poll() is None:
            process.terminate()
            process.wait(10)


def states(alerts):
    return {id_: (alert.priority, alert.state) for id_, alert in (alerts or {}).items()}


UNACKNOWLEDGED, ACKNOWLEDGED = Alert.ACTIVE_UNACKNOWLEDGED, Alert.ACTIVE_ACKNOWLEDGED


def test_alert_is_raised_acknowledged_and_survives_its_node(ship, start, until, tmp_path):
    """A missing attitude is an alarm; a wrong instance is refused; kill -9 and a restart keep the state."""
    limits, state = tmp_path / "limits.yaml", tmp_path / "alerts.json"
    limits.write_text("alerts: {clear_after_s: 1.0}\n")
    named = ("--limits", str(limits), "--state", str(state))
    node = start(*named)

    def result_of_sailing(found, **how):
        def look():
            ship.sail(0.2, **how)
            return found(ship.alerts())

        return until(look, 30.0)

    result_of_sailing(lambda alerts: alerts is not None and ship.acknowledger.service_is_ready())
    # Without ship/integrity the attitude is a caution, which needs no acknowledgement.
    result_of_sailing(lambda alerts: states(alerts) == {"attitude.degraded": (Alert.CAUTION, ACKNOWLEDGED)})
    result_of_sailing(lambda alerts: "attitude.silent" in alerts, is_stopped=True)
    alarm = ship.alerts()["attitude.silent"]
    assert (alarm.priority, alarm.state, alarm.instance) == (Alert.ALARM, UNACKNOWLEDGED, 1)
    assert alarm.text == "Heading and tilt lost: no data on ship/attitude"
    assert abs(alarm.raised.sec - time.time()) < 20.0

    wrong = ship.acknowledge("attitude.silent", 2)
    assert not wrong.success
    assert "is now instance 1, not 2" in wrong.message
    unknown = ship.acknowledge("attitude.silence", 1)
    assert not unknown.success
    assert "attitude.silent" in unknown.message
    assert ship.call(ship.silencer, Trigger.Request()).message == "1 silenced"
    result_of_sailing(lambda alerts: alerts["attitude.silent"].state == Alert.ACTIVE_SILENCED, is_stopped=True)
    right = ship.acknowledge("attitude.silent", 1)
    assert (right.success, right.message) == (True, "'attitude.silent' acknowledged")
    result_of_sailing(lambda alerts: alerts["attitude.silent"].state == ACKNOWLEDGED, is_stopped=True)

    node.kill()
    node.wait(10)
    ship.alert_messages.clear()
    again = start(*named)
    # The first message of the new node contains the alert with its acknowledgement.
    result_of_sailing(lambda alerts: alerts is not None, is_stopped=True)
    first = {alert.id: (alert.priority, alert.state, alert.instance) for alert in ship.alert_messages[0].alerts}
    assert first["attitude.silent"] == (Alert.ALARM, ACKNOWLEDGED, 1)
    result_of_sailing(lambda alerts: "attitude.silent" not in alerts)
    assert states(ship.alerts()) == {"attitude.degraded": (Alert.CAUTION, ACKNOWLEDGED)}
    assert json.loads(state.read_text())["format"] == "ship_alerts"

    again.terminate()
    assert again.wait(10) == 0
    log = node.log_path.read_text()
    assert "ALARM attitude.silent 1: Heading and tilt lost: no data on ship/attitude: raised" in log
    assert "attitude.silent 1: Heading and tilt lost: no data on ship/attitude: acknowledged" in log
    assert "not acknowledged: 'attitude.silent' is now instance 1, not 2" in log


@pytest.mark.smoke
def test_diagnostics_are_received_and_published(ship, start, until, tmp_path):
    """A node's ended black box is a warning; /diagnostics reports which functions are lost."""
    start("--state", str(tmp_path / "alerts.json"))

    def look():
        ship.sail(0.2, sigma_arcsec=20.0)
        return "ship_attitude.box" in (ship.alerts() or {})

    ship.black_box_level = DiagnosticStatus.ERROR
    until(look, 30.0)
    assert ship.alerts()["ship_attitude.box"].priority == Alert.WARNING
    name = "alerts: functions/heading within 6″"

    def is_lost():
        # Before the first message the function is unknown, not lost.
        ship.sail(0.2, sigma_arcsec=20.0)
        return name in ship.statuses and ship.statuses[name].level == DiagnosticStatus.ERROR

    until(is_lost, 10.0)
    lost = ship.statuses[name]
    assert lost.message.startswith("lost, ")
    assert "39.2″ (95 %), limit 6″" in lost.message
    assert ship.statuses["alerts: callbacks"].level == DiagnosticStatus.OK


def test_wrong_limits_end_the_node_at_once(tmp_path, capsys):
    """The error is one line with file, line, unknown key and similar known key; the exit code is 2."""
    limits = tmp_path / "limits.yaml"
    limits.write_text("tilt_arcsec: 3.0\nhedding_arcsec: 5.0\n")
    assert main(["--limits", str(limits)]) == 2
    error = capsys.readouterr().err
    assert f"{limits}:2: parameter 'hedding_arcsec' is unknown" in error
    assert "did you mean 'heading_arcsec'?" in error
    assert error.count("\n") == 1


def test_each_namespace_has_its_own_file(monkeypatch, tmp_path):
    """Two suites on one computer have different files."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    names = [default_state(namespace) for namespace in ("/", "/demo", "/fleet/demo")]
    assert names == [tmp_path / "alerts.json", tmp_path / "alerts_demo.json", tmp_path / "alerts_fleet_demo.json"]


def test_alerts_are_in_the_recording(start, tmp_path):
    """Each state of each alert is a message in the bag, also a state from before the recorder discovered the node."""
    limits = tmp_path / "limits.yaml"
    limits.write_text("alerts: {start_s: 4.0, escalate_after_s: 3.0}\n")
    start("--limits", str(limits), "--state", str(tmp_path / "alerts.json"))
    bag = tmp_path / "voyage.mcap"
    assert record(["--out", str(bag), "--duration-s", "14"]) == 0
    with read_bag(bag) as recorded:
        messages = [each.decode() for each in recorded.records(["/demo/ship/alerts"])]
    states = [[(alert.id, alert.priority, alert.state) for alert in message.alerts] for message in messages]
    warning, alarm = (("attitude.silent", priority, UNACKNOWLEDGED) for priority in (Alert.WARNING, Alert.ALARM))
    assert [warning] in states
    assert states[-1] == [alarm]


@pytest.mark.parametrize(
    ("node", "hardware_id"),
    [("star_attitude", ""), ("ship_attitude", "/other/ship_attitude")],
    ids=["by name", "by hardware id"],
)
def test_diagnostics_of_another_suite_are_ignored(node, hardware_id, ship, start, until, tmp_path):
    """A node of another namespace publishes its clock status on the same topic: no alert of this suite.

    The hardware id distinguishes the nodes of the two suites if they have the same name.
    """
    other_node = Node(node, context=ship.context, namespace="other")
    diagnostics = other_node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    start("--state", str(tmp_path / "alerts.json"))
    # The second status belongs to this suite by its hardware id. Both are in one message, so both are received
    # together.
    statuses = [
        DiagnosticStatus(level=b"\x02", name=f"{node}: clock", message="stands", hardware_id=hardware_id),
        DiagnosticStatus(level=b"\x02", name="ship_attitude: stamps", hardware_id="/demo/ship_attitude"),
    ]

    def look():
        diagnostics.publish(DiagnosticArray(status=statuses))
        ship.sail(0.2)
        return "ship_attitude.stamps" in (ship.alerts() or {})

    until(look, 30.0)
    assert not [id_ for id_ in ship.alerts() if id_.endswith(".clock")]
    other_node.destroy_node()
