"""``alerts``: raises the alerts of a suite, publishes them and accepts acknowledgements."""

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ship_bags.command_line import EXIT_DONE, CommandParser
from ship_bags.live.ros_process import call_on_end_signals, command_node, heartbeat, run_ros_command
from ship_bags.message_factory import RosidlFactory
from ship_bags.stamps import NS_PER_S
from ship_monitor.alerts.alert_manager import AlertManager
from ship_monitor.live.topic_reader import ALERTS_TOPIC, MAX_QUEUE_DEPTH, TopicReader, steady_ns
from ship_msgs.msg import AlertArray, SuiteState
from ship_msgs.srv import AcknowledgeAlert
from ship_node.live.node_report import ExceptionGuard
from ship_node.messages.common_messages import (
    DIAGNOSTICS_TOPIC,
    DIAGNOSTICS_TYPE,
    DiagnosticStatus,
    Level,
    diagnostic_array,
)
from ship_watch.alerts.alert_conditions import NodeStatus
from ship_watch.alerts.alerts import AlertChange
from ship_watch.published_state import PERIOD_NS, STATE_TOPIC, STATE_TYPE, change_key, suite_state_fields
from ship_watch.safety.limits import Limits, read_limits
from ship_watch.suite_state import Priority
from ship_watch.topics import monitored_topic

UPDATE_PERIOD_NS = NS_PER_S // 5
"""Period of the updates, ns."""

_NAME = "alerts"
_REPORT_NS = NS_PER_S
_LEVELS = {Priority.CAUTION: Level.OK, Priority.WARNING: Level.WARN, Priority.ALARM: Level.ERROR}

_DESCRIPTION = """\
Raises alerts if outputs or inputs of a suite are not within the limits of the ship, after IEC 62923-1: one alert per
situation (caution, warning or alarm) until it is over and acknowledged.

It publishes ship/alerts (all alerts, latched, at every change), ship/suite_state (the state of angles and sources that
page and terminal show) and, in /diagnostics, each lost function with the input that caused it. ~/acknowledge takes id
and instance of an alert, ~/silence switches the sound off for 30 s. Alerts and acknowledgements are saved in a file and
restored at the next start.

ROS arguments may follow after --ros-args (namespace of the suite, use_sim_time).
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``alerts``; returns the exit code."""
    return run_ros_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_monitor",
        prog=_NAME,
        example="--limits ship.yaml --ros-args -r __ns:=/demo",
        description=_DESCRIPTION,
        epilog="exit code: 0 ended by a signal; 2 bad input or usage",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--limits", type=Path, metavar="FILE", help="limits of the ship, YAML (defaults)")
    parser.add_argument(
        "--state",
        type=Path,
        metavar="FILE",
        help="file in which alerts are saved for the next start (~/.ros/alerts_NAMESPACE.json; none with use_sim_time, "
        "since a played bag is another voyage)",
    )
    return parser


def _run(parsed: argparse.Namespace, ros_arguments: list[str]) -> int:
    limits = read_limits(parsed.limits) if parsed.limits else Limits()
    with command_node(_NAME, ros_arguments) as node:
        state = parsed.state
        if state is None and not node.get_parameter("use_sim_time").value:
            state = default_state(node.get_namespace())
        # The time comes from the messages: a subscription of /clock would wake the node a hundred times a second.
        node.set_parameters([Parameter("use_sim_time", value=False)])
        alerts = AlertNode(node, limits, state)
        call_on_end_signals(alerts.stop)
        alerts.run()
    return EXIT_DONE


def default_state(namespace: str) -> Path:
    """Return the path of the file with the alerts of a namespace, in ROS_HOME or, without this variable, ``~/.ros``."""
    home = Path(os.environ.get("ROS_HOME") or "~/.ros").expanduser()
    return home / f"{'_'.join(filter(None, ['alerts', *namespace.split('/')]))}.json"


class AlertNode:
    """Publishes the alerts of the suite in a node's namespace and serves acknowledgements.

    Args:
        node: ROS node, spun by :meth:`run`.
        limits: limits of the ship.
        state_file: file of the alerts; None for no file.
    """

    def __init__(self, node: Node, limits: Limits, state_file: Path | None) -> None:
        self._node = node
        self._full_name = node.get_fully_qualified_name()
        self._factory = RosidlFactory()
        self._guard = ExceptionGuard(node.get_logger(), time.monotonic_ns)
        self._reader = TopicReader("alerts_reader", node.get_namespace(), _queue_depth)
        self._manager = AlertManager(limits, state_file, steady_ns(), lambda text: node.get_logger().error(text))
        latched = QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        self._alerts = node.create_publisher(AlertArray, ALERTS_TOPIC, latched)
        self._states = node.create_publisher(SuiteState, STATE_TOPIC, 1)
        self._published_ns = 0
        self._published_change: tuple[Any, ...] = ()
        self._diagnostics = node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, 10)
        node.create_service(AcknowledgeAlert, "~/acknowledge", self._acknowledge)
        node.create_service(Trigger, "~/silence", self._silence)
        self._is_stopped = False
        kept = ", ".join(alert.id for alert in self._manager.alerts)
        known = f"; restored: {kept}" if kept else ""
        node.get_logger().info(f"alerts of {self._reader.location}; saved in {state_file or 'no file'}{known}")
        self._publish()

    def stop(self) -> None:
        """Request the end; for signal handlers."""
        self._is_stopped = True

    def run(self) -> None:
        """Update periodically until stopped."""
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        next_update_ns = next_report_ns = steady_ns()
        try:
            while not self._is_stopped:
                now_ns = steady_ns()
                heartbeat().beat(now_ns)
                if now_ns >= next_update_ns:
                    next_update_ns = now_ns + UPDATE_PERIOD_NS
                    self._guard.call("the suite", self._update)
                if now_ns >= next_report_ns:
                    next_report_ns = now_ns + _REPORT_NS
                    self._guard.call("diagnostics", self._publish_diagnostics)
                executor.spin_once(timeout_sec=max(0, next_update_ns - steady_ns()) / NS_PER_S)
        finally:
            executor.shutdown()
            self._reader.close()

    def _update(self) -> None:
        batch = self._reader.fetch()
        if batch.time_went_back:
            self._manager.reset(steady_ns())
        for received in batch.messages:
            if received.topic == DIAGNOSTICS_TOPIC:
                self._guard.call(received.topic, self._process_diagnostics, received.message, received.arrival_ns)
            else:
                self._guard.call(
                    received.topic, self._manager.process_message, received.topic, received.message, received.arrival_ns
                )
        self._report_changes(self._manager.update(steady_ns(), time.time_ns()))
        self._publish_state(steady_ns())

    def _process_diagnostics(self, message: Any, arrival_ns: int) -> None:
        namespaces = self._namespaces()
        for status in message.status:
            node, _, name = status.name.partition(": ")
            where = namespaces.get(node, set())
            if status.hardware_id.startswith("/"):
                where = {status.hardware_id.rpartition("/")[0] or "/"}
            if node == _NAME or self._node.get_namespace() not in where:
                continue
            # Statuses of other software contain no namespace: two nodes with the same name cannot be distinguished.
            other = "" if len(where) == 1 else f" (a node of one of {', '.join(sorted(where))})"
            values = {pair.key: pair.value for pair in status.values}
            node_status = NodeStatus(node, name, status.level[0], status.message + other, values)
            self._manager.process_status(node_status, arrival_ns)

    def _namespaces(self) -> dict[str, set[str]]:
        """Return node name → namespaces of the nodes that publish diagnostics, because all suites share the topic."""
        found: dict[str, set[str]] = {}
        for endpoint in self._node.get_publishers_info_by_topic(DIAGNOSTICS_TOPIC):
            found.setdefault(endpoint.node_name, set()).add(endpoint.node_namespace)
        return found

    def _acknowledge(self, request: Any, response: Any) -> Any:
        change, response.message = self._manager.acknowledge(request.id, request.instance, time.time_ns())
        response.success = change is not None
        if change is None:
            self._node.get_logger().info(f"not acknowledged: {response.message}")
        else:
            self._report_changes((change,))
        return response

    def _silence(self, _request: Any, response: Any) -> Any:
        changes = self._manager.silence(steady_ns(), time.time_ns())
        self._report_changes(changes)
        response.success, response.message = True, f"{len(changes)} silenced"
        return response

    def _report_changes(self, changes: Sequence[AlertChange]) -> None:
        for change in changes:
            alert = change.alert
            line = f"{alert.priority.name} {alert.id} {alert.instance}: {alert.text}: {change.description}"
            # Three calls, because in rclpy each line of code may log with one severity only.
            if alert.is_acknowledged or alert.priority is Priority.CAUTION:
                self._node.get_logger().info(line)
            elif alert.priority is Priority.WARNING:
                self._node.get_logger().warning(line)
            else:
                self._node.get_logger().error(line)
        if changes:
            self._publish()
            self._publish_diagnostics()

    def _publish(self) -> None:
        header = {"stamp": self._utc_ns(), "frame_id": ""}
        # The fields of an alert have the names of those of the message, apart from the unit of the times.
        alerts = [
            {name.removesuffix("_ns"): value for name, value in vars(alert).items()} for alert in self._manager.alerts
        ]
        self._alerts.publish(self._factory.make("ship_msgs/msg/AlertArray", header=header, alerts=alerts))

    def _publish_state(self, now_ns: int) -> None:
        """Publish the state from which the alerts are derived, at once after a change and otherwise twice a second."""
        suite_state = self._manager.suite_state
        change = change_key(suite_state)
        if change != self._published_change or now_ns - self._published_ns >= PERIOD_NS:
            self._published_ns, self._published_change = now_ns, change
            self._states.publish(self._factory.make(STATE_TYPE, **suite_state_fields(suite_state)))

    def _publish_diagnostics(self) -> None:
        alerts = self._manager.alerts
        waiting = sum(not alert.is_acknowledged for alert in alerts)
        text = f"{len(alerts)} alerts, {waiting} unacknowledged" + (f": {alerts[0].text}" if alerts else "")
        level = max((_LEVELS[alert.priority] for alert in alerts), default=Level.OK)
        statuses = [DiagnosticStatus("list", level, text), self._guard.status()]
        statuses += [
            DiagnosticStatus(f"functions/{entry.path}", Level(entry.level), entry.text)
            for entry in self._manager.diagnostic_entries()
        ]
        message = diagnostic_array(self._utc_ns(), _NAME, statuses, self._full_name)
        self._diagnostics.publish(message.__cdr__)

    def _utc_ns(self) -> int:
        """Return the time of the suite, UTC, ns; the time of the computer until the suite has a time."""
        return self._manager.suite_state.utc_ns or time.time_ns()


def _queue_depth(topic: str, type_name: str) -> int:
    """Return the queue depth of a topic; 0 for topics that are not needed."""
    if topic == DIAGNOSTICS_TOPIC:
        return MAX_QUEUE_DEPTH if type_name == DIAGNOSTICS_TYPE else 0
    row = monitored_topic(topic, type_name) if topic != ALERTS_TOPIC else None
    return 0 if row is None else MAX_QUEUE_DEPTH if row.keeps_every_message else 1
