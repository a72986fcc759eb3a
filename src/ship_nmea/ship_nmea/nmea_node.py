"""Runtime of ``nmea_in`` and ``nmea_out``: parameters, guarded callbacks, the clock, and diagnostics once a second.

A node of this package consists of this runtime and its :class:`Work`. Played data, which must not reach the bridge like
live data, is detected by the clock.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ship_bags.command_line import CommandParser
from ship_bags.live.ros_process import split_ros_arguments
from ship_bags.message_factory import RosidlFactory, message_class
from ship_bags.parameter_yaml import BLACK_BOX_PARAMETER
from ship_estimation.parameters.schema import key_rows
from ship_geometry.input_error import InputError
from ship_node.live.node_clock import NodeClock
from ship_node.live.node_events import NodeEvents
from ship_node.live.node_report import ExceptionGuard, StatusLog, name_status
from ship_node.live.node_runtime import run_node
from ship_node.live.node_topics import check_overrides, create_publisher, input_qos, overriding_options
from ship_node.live.ros_parameters import NodeParameters, ParameterNode
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, DiagnosticStatus, diagnostic_array
from ship_node.messages.inputs_outputs import InputTopic, OutputTopic
from ship_node.parameters.parameter_file import error_with_location, section_warnings

SPIN_TIMEOUT_S = 0.1
REPORT_PERIOD_S = 1.0

_EXIT_CODE_TEXT = "0 ended by SIGINT or SIGTERM, 2 bad parameters or arguments (reported in one line)"

PLAYBACK_TEXT = "this node follows /clock, and tell_simulated is false"


def run_nmea_node(
    name: str,
    description: str,
    config_type: type,
    make_work: "Callable[[NmeaNode], Work]",
    arguments: Sequence[str] | None,
) -> int:
    """Run a node of this package until SIGINT or SIGTERM.

    Args:
        name: name of the node and of its executable.
        description: text of ``--help`` before the parameters.
        config_type: a dataclass in the style of :mod:`ship_estimation.parameters.schema`.
        make_work: creates the work of the node.
        arguments: command line without the program's name; None for the command line of the process.

    Returns:
        Exit code: 0 after a signal, 2 for bad arguments or parameters (reported in one line on stderr).
    """
    rows = "\n".join(key_rows(config_type))
    parser = CommandParser(
        package="ship_nmea",
        prog=name,
        usage="%(prog)s [--help] [--ros-args [--params-file FILE] [-p NAME:=VALUE] ...]",
        example="--ros-args --params-file suite.yaml -r __ns:=/aurora",
        description=description,
        epilog=f"parameters (read at the start):\n{rows}\n\nexit code: {_EXIT_CODE_TEXT}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    own, ros = split_ros_arguments(sys.argv[1:] if arguments is None else arguments)
    parser.parse_args(own)
    return run_node("ship_nmea", name, partial(NmeaNode, name, config_type, make_work), ros)


class Work(Protocol):
    """Work of a node, created from its :class:`NmeaNode`. The creation raises InputError for unusable parameters."""

    def statuses(self) -> Iterable[DiagnosticStatus]:
        """Return the diagnostics of the work; called once a second."""
        ...

    def close(self) -> None:
        """Release sockets, devices and threads."""
        ...


class NmeaNode:
    """A node and its runtime; it is run by :func:`ship_node.live.node_runtime.run_node`.

    Attributes:
        node: the rclpy node.
        config: parameters of the node, which do not change while it runs.
        factory: makes messages.
        clock: the node's time, from /clock if the node follows it.
        guard: calls functions, and counts and reports their exceptions.

    Args:
        name: name of the node.
        config_type: a dataclass in the style of :mod:`ship_estimation.parameters.schema`.
        make_work: creates the work of the node.
        context: an initialised rclpy context.
        parameter_files: files given on the command line, so that an error text can name file and line of a bad
            parameter.

    Raises:
        BadInput: a parameter is unknown, of the wrong type, out of its range or missing, or the work cannot start with
            its value. The error text contains file and line if a parameter file gives the parameter.
    """

    def __init__(
        self,
        name: str,
        config_type: type,
        make_work: "Callable[[NmeaNode], Work]",
        context: Context,
        parameter_files: tuple[Path, ...] = (),
    ) -> None:
        self.node: Node = ParameterNode(name, context=context)
        self.factory = RosidlFactory()
        self.guard = ExceptionGuard(self.node.get_logger(), time.monotonic_ns)
        self._context = context
        self._full_name = self.node.get_fully_qualified_name()
        self._parameter_files = parameter_files
        self._events = NodeEvents(context, self.guard, time.monotonic_ns)
        self.clock = NodeClock(self.node, time.monotonic_ns, self._events.note_event)
        self._status_log = StatusLog(self.node.get_logger())
        try:
            for warning in section_warnings(parameter_files, self._full_name):
                self.node.get_logger().warning(warning)
            if BLACK_BOX_PARAMETER in self.node._parameter_overrides:
                text = f"parameter '{BLACK_BOX_PARAMETER}' is not used: no replay runs this node"
                self.node.get_logger().warning(text)
            self._parameters = NodeParameters(self.node, config_type, has_black_box=False)
            self.config: Any = self._parameters.config
            self._diagnostics = self.publisher(OutputTopic(DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE))
            self._work = make_work(self)
        except InputError as error:
            self.node.destroy_node()
            raise error_with_location(error, parameter_files, self._full_name) from error
        self.add_timer(REPORT_PERIOD_S, "report", self._report)
        self._events.start(self.node)

    def require_one_open(self, errors: Sequence[InputError], count: int) -> None:
        """Raise an error if no place (link or sink) can be opened; otherwise log the places that cannot be opened.

        Args:
            errors: errors of the places that cannot be opened until the user acts.
            count: number of all places.

        Raises:
            InputError: the first error, if no place can be opened.
        """
        if len(errors) == count:
            raise errors[0]
        for error in errors:
            text = error_with_location(error, self._parameter_files, self._full_name)
            self.node.get_logger().error(f"{text}; the others continue, and opening it is retried")

    def subscribe(self, topic: InputTopic, callback: Callable[[Any], None], latched: bool = False) -> None:
        """Call ``callback`` with each message of a topic.

        Args:
            topic: the topic.
            callback: called with the message; its exceptions are counted and reported.
            latched: True if the last message published before the subscription is needed too.
        """
        qos = input_qos(topic, self._parameters.has_reliable_inputs)
        if latched:
            qos = QoSProfile(
                depth=topic.depth, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
            )
        name = self._parameters.topics.get(topic.topic, topic.topic)
        with check_overrides(self.node, name):
            self.node.create_subscription(
                message_class(topic.type_name),
                name,
                partial(self._call, topic.topic, callback),
                qos,
                qos_overriding_options=overriding_options(),
            )

    def publisher(self, topic: OutputTopic) -> Publisher:
        """Return a publisher of a topic."""
        return create_publisher(self.node, topic)

    def add_timer(self, period_s: float, name: str, function: Callable[[], None]) -> None:
        """Call a function periodically, by a steady clock; reports of exceptions contain ``name``."""
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.node.create_timer(period_s, partial(self._call, name, function), clock=clock)

    def spin(self, stop: Callable[[], bool]) -> None:
        """Handle callbacks until ``stop()`` is true or the context ends."""
        while not stop() and self._context.ok():
            self._events.process_events(SPIN_TIMEOUT_S)

    def close(self) -> None:
        """Close the work and destroy the node."""
        self.guard.call("end", self._work.close)
        self._events.close()
        self.node.destroy_node()

    def _call(self, name: str, function: Callable[..., None], *arguments: Any) -> None:
        self._events.note_event()
        self.guard.call(name, function, *arguments)

    def _report(self) -> None:
        statuses = [self.clock.status(), name_status(self.node), self._events.status(), *self._work.statuses()]
        self._status_log.update(statuses)
        statuses += [self.guard.status(), self._parameters.status()]
        now_ns, name = self.clock.now_ns(), self.node.get_name()
        self._diagnostics.publish(diagnostic_array(now_ns, name, statuses, self._full_name).__cdr__)


def is_played(runtime: NmeaNode) -> bool:
    """True if the data is played or simulated, and ``tell_simulated`` is not set."""
    return runtime.clock.is_simulated() and not runtime.config.tell_simulated


def utc_ns(runtime: NmeaNode) -> int:
    """Return the node's time, POSIX UTC, ns; before the first /clock, the machine's time."""
    return runtime.clock.now_ns() or time.time_ns()
