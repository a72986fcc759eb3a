"""Start of a command that is a ROS node: arguments, node, signals; :mod:`ship_bags.live.dds` prepares DDS."""

import argparse
import contextlib
import math
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from ship_bags.command_line import CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.live.dds import prepare_dds

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)


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
