"""Process of a program that is a ROS node: set-up of DDS, start of a command with its node, signals, heartbeat.

DDS is set up before ROS starts: the suite's profile, and security if it is requested. A process that is requested to
use DDS security must not run without it. ROS uses security only if ``ROS_SECURITY_ENABLE`` is exactly ``true``; with
``TRUE`` or ``1`` ROS runs unprotected without a warning. The same happens with the strategy ``Permissive`` if DDS was
built without security.

The supervisor of a suite gives its programs one end of a datagram socket. Each program sends its process id there once
a second, from its main loop: its heartbeat. A stopped program, or a program whose callback does not return, sends
nothing. ROS and DDS are not involved.
"""

import argparse
import contextlib
import functools
import math
import mmap
import os
import re
import signal
import socket
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from ship_bags.command_line import CommandParser, run_command
from ship_bags.errors import BadInput

ENABLE, STRATEGY = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"

_FALSE_VALUES = ("", "0", "false", "no", "off")
_LIBRARY = "libfastrtps."
_WITH_SECURITY, _WITHOUT_SECURITY = b"process_data_message_with_security", b"process_data_message_without_security"
"""Parts of symbol names that the library exports: the second always, the first only if built with security."""

DDS_PROFILE = Path(__file__).with_name("dds_profile.xml")
"""Fast DDS profile of every program of the suite, for discovery and retransmission; the file gives the reasons."""

PROFILE_VARIABLE, QOS_FROM_PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML"
"""Environment variable that names a profile, and the variable by which the profile applies to writers and readers too.
"""


HEARTBEAT_SOCKET = "SHIP_SUITE_HEARTBEAT"
"""Environment variable with the file descriptor of the socket."""

HEARTBEAT_PERIOD_NS = 1_000_000_000
"""Heartbeat period, ns."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)


def prepare_dds() -> None:
    """Prepare DDS before ROS starts: check requested security, set the profile; every program of the suite calls this.

    Raises:
        BadInput: DDS security is requested and not available.
    """
    require_security()
    use_dds_profile()


def use_dds_profile() -> None:
    """Set the suite's Fast DDS profile for this process and its child processes; a profile set by the user stays."""
    if os.environ.setdefault(PROFILE_VARIABLE, str(DDS_PROFILE)) == str(DDS_PROFILE):
        os.environ.setdefault(QOS_FROM_PROFILE_VARIABLE, "1")


def require_security() -> None:
    """Refuse to start if the environment requests DDS security and this installation does not have it.

    If the process may start, its environment gets the request in the spelling that ROS accepts.

    Raises:
        BadInput: see :func:`security_environment`.
    """
    if is_security_requested(os.environ):
        os.environ.update(security_environment(os.environ, dds_has_security(loaded_libraries())))


def is_security_requested(environment: Mapping[str, str]) -> bool:
    """Return True if an environment requests DDS security: by any text that does not mean "no"."""
    return environment.get(ENABLE, "").strip().lower() not in _FALSE_VALUES


def security_environment(environment: Mapping[str, str], has_security: bool | None) -> dict[str, str]:
    """Return the environment that requests DDS security in the spelling that ROS accepts.

    Args:
        environment: environment with the request.
        has_security: True if DDS was built with security; None if unknown.

    Raises:
        BadInput: DDS was built without security; or this is unknown, and the middleware would not refuse to start.
    """
    demand, enforced = environment[ENABLE], environment.get(STRATEGY, "").strip().lower() == "enforce"
    if has_security is False:
        raise BadInput(
            f"{ENABLE}={demand} requests DDS security, and this installation's DDS was built without security: "
            "not started, because it would run unprotected"
        )
    if has_security is None and not enforced:
        raise BadInput(
            f"{ENABLE}={demand} requests DDS security, and it is unknown whether this DDS has it: "
            f"set {STRATEGY}=Enforce, with which the middleware itself refuses to start"
        )
    return {ENABLE: "true"} | ({STRATEGY: "Enforce"} if enforced else {})


def dds_has_security(libraries: Iterable[Path]) -> bool | None:
    """Return True if the Fast DDS among some libraries was built with security; None if unknown."""
    for path in libraries:
        if not path.name.startswith(_LIBRARY):
            continue
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if content.find(_WITH_SECURITY) >= 0:
                return True
            if content.find(_WITHOUT_SECURITY) >= 0:
                return False
    return None


def loaded_libraries() -> list[Path]:
    """Return the files from which this process has loaded Fast DDS; empty with another middleware."""
    get_rmw_implementation_identifier()  # loads the middleware
    lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    return sorted({Path(line[line.index("/") :]) for line in lines if f"/{_LIBRARY}" in line})


class Heartbeat:
    """Heartbeat of this process; outside a suite nothing is sent.

    Args:
        descriptor: file descriptor of the socket, as text; empty outside a suite.
    """

    def __init__(self, descriptor: str) -> None:
        self._socket: socket.socket | None = None
        self._last_ns = 0
        with contextlib.suppress(OSError, ValueError):
            if descriptor:
                self._socket = socket.socket(fileno=int(descriptor))
                self._socket.set_inheritable(False)

    def beat(self, steady_ns: int) -> None:
        """Send a heartbeat if the last heartbeat is a period old.

        Args:
            steady_ns: steady time, ns.
        """
        if self._socket is None or steady_ns - self._last_ns < HEARTBEAT_PERIOD_NS:
            return
        self._last_ns = steady_ns
        # A stopped supervisor reads nothing, and its queue may be full.
        with contextlib.suppress(OSError):
            self._socket.send(b"%d" % os.getpid(), socket.MSG_DONTWAIT)


@functools.cache
def heartbeat() -> Heartbeat:
    """Return the heartbeat of this process; child processes do not inherit it."""
    return Heartbeat(os.environ.pop(HEARTBEAT_SOCKET, ""))


def run_ros_command(
    parser: CommandParser,
    command: Callable[[argparse.Namespace, list[str]], int],
    arguments: Sequence[str] | None,
) -> int:
    """Run a command that also takes arguments for ROS; return its exit code.

    Args:
        parser: parser of the command's own arguments.
        command: does the work with the parsed arguments and the arguments for ROS.
        arguments: the command line without the program's name; None for the command line of the process.
    """
    own, ros = split_ros_arguments(sys.argv[1:] if arguments is None else arguments)
    return run_command(parser, lambda parsed: command(parsed, ros), own)


def split_ros_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the command's own arguments, and for rclpy.init those from ``--ros-args`` up to ``--`` (or the end).

    rclpy's function would also remove arguments that look like a remap rule, as ``--remap OLD:=NEW`` of `play`.
    """
    own: list[str] = []
    ros: list[str] = []
    taken = own
    for argument in arguments:
        if argument == "--ros-args":
            taken = ros
        if argument == "--" and taken is ros:
            taken = own
            continue
        taken.append(argument)
    return own, ros


@contextlib.contextmanager
def command_node(name: str, ros_arguments: list[str], use_sim_time: bool = False) -> Iterator[Node]:
    """Yield the node of a command. ROS installs no signal handlers, and ends with the node.

    Raises:
        BadInput: DDS security is requested and not available.
    """
    prepare_dds()
    rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        overrides = [Parameter("use_sim_time", value=True)] if use_sim_time else []
        node = rclpy.create_node(name, parameter_overrides=overrides)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def call_on_end_signals(stop: Callable[[], None]) -> None:
    """Call `stop` on Ctrl-C and SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop())


def positive_number(text: str) -> float:
    """Return an argument as a positive number."""
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def executable(package: str, name: str) -> list[str]:
    """Return the command of a package's executable, found as by ``ros2 run``.

    Raises:
        BadInput: the executable is not installed.
    """
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "lib" / package / name
        if prefix and path.is_file():
            return [sys.executable, str(path)]
    raise BadInput(f"package {package} has no executable '{name}': build the workspace and source its environment")


def namespace_name(text: str) -> str:
    """Return an argument as a ROS namespace without its outer slashes."""
    name = text.strip("/")
    if name and not all(_NAME.fullmatch(part) for part in name.split("/")):
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a namespace: expected letters, digits and _ between single slashes"
        )
    return name
