"""What the commands that are nodes themselves do alike: ROS arguments, node, signals."""

import argparse
import contextlib
import math
import signal
import sys
from collections.abc import Callable, Iterator, Sequence

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from ship_bags.command_line import CommandParser, run_command
from ship_bags.live.security import require_demanded_security


def run_ros_command(
    parser: CommandParser,
    command: Callable[[argparse.Namespace, list[str]], int],
    arguments: Sequence[str] | None,
) -> int:
    """Exit code of a command that takes arguments for ROS, too.

    Args:
        parser: parser of the command's own arguments.
        command: does the work with those, parsed, and with the arguments for ROS.
        arguments: the command line without the program's name; None takes the process's own.
    """
    own, ros = split_ros_arguments(sys.argv[1:] if arguments is None else arguments)
    return run_command(parser, lambda parsed: command(parsed, ros), own)


def split_ros_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The command's own arguments, and those between ``--ros-args`` and ``--`` (or the end), as rclpy.init takes them.

    rclpy's own function would also take away whatever looks like a remap rule, as ``--remap OLD:=NEW`` of `play`.
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
    """The node of a command; ROS leaves the signals alone and ends with it.

    Raises:
        BadInput: DDS security is demanded and not there.
    """
    require_demanded_security()
    rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        overrides = [Parameter("use_sim_time", value=True)] if use_sim_time else []
        yield rclpy.create_node(name, parameter_overrides=overrides)
    finally:
        rclpy.try_shutdown()


def on_end_signals(stop: Callable[[], None]) -> None:
    """Call `stop` on Ctrl-C and SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop())


def positive(text: str) -> float:
    """A positive number, as an argument's type."""
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value
