"""Entry points of a node's executable: arguments, start, spin, clean end, exit codes."""

import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ship_bags.command_line import launcher, print_text
from ship_bags.errors import BadInput
from ship_bags.live.dds import prepare_dds
from ship_bags.message_factory import RosidlFactory
from ship_node.adapters.adapter import Adapter
from ship_node.live.live_node import LiveNode
from ship_node.parameters.parameter_file import read_matching_sections
from ship_node.parameters.usage import usage_text

EXIT_DONE, EXIT_BAD_INPUT = 0, 2

_BAD_START = ValueError, OSError, ImportError, rclpy_implementation.RCLError
"""Exceptions that end the start, for example due to bad parameters, bad arguments or a missing message package.

The exceptions of all packages for bad input are ValueErrors."""


class RunnableNode(Protocol):
    """Interface of a node that :func:`run_node` runs."""

    def spin(self, stop: Callable[[], bool]) -> None:
        """Run until ``stop()`` returns True or the context ends."""
        ...

    def close(self) -> None:
        """Release all resources."""
        ...


def run(adapter_class: type[Adapter], args: Sequence[str] | None = None) -> int:
    """Run the node of an adapter until SIGINT or SIGTERM.

    Args:
        adapter_class: adapter of the node.
        args: command line without the program's name; by default the command line of the process.

    Returns:
        Exit code: 0 after a signal or the help text, 2 if the start failed (with one line on stderr), 141 if the reader
        of the help text is gone.
    """
    arguments = list(sys.argv[1:] if args is None else args)
    package = adapter_class.__module__.partition(".")[0]
    if "-h" in arguments or "--help" in arguments:
        return print_text(usage_text(adapter_class, package, RosidlFactory()))
    return run_node(package, adapter_class.node_name, partial(LiveNode, adapter_class), arguments)


def run_node(
    package: str,
    name: str,
    make: Callable[[Context, tuple[Path, ...]], RunnableNode],
    arguments: Sequence[str],
) -> int:
    """Run a node until SIGINT or SIGTERM.

    Args:
        package: package of the node's executable.
        name: name of the node, without namespace.
        make: returns the node, from an initialised context and the parameter files of the command line.
        arguments: command-line arguments for ROS.

    Returns:
        Exit code, see :func:`run`.
    """
    stopping = False

    def stop(_number: int, _frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    context = Context()
    try:
        node = _start(package, name, make, list(arguments), context)
    except _BAD_START as error:
        context.try_shutdown()
        reason = str(error).strip().partition("\n")[0]
        print(f"{name}: {reason}", file=sys.stderr)
        return EXIT_BAD_INPUT
    node.spin(lambda: stopping)
    node.close()
    context.try_shutdown()
    return EXIT_DONE


def _start(
    package: str,
    name: str,
    make: Callable[[Context, tuple[Path, ...]], RunnableNode],
    arguments: list[str],
    context: Context,
) -> RunnableNode:
    files = tuple(Path(path) for flag, path in pairwise(arguments) if flag == "--params-file")
    for path in files:
        # rcl reads the files too, but its errors have no line number.
        read_matching_sections(path, name)
    prepare_dds()
    # Signals are handled here, so that spin ends between two callbacks and the node closes cleanly.
    rclpy.init(args=[name, *arguments], context=context, signal_handler_options=SignalHandlerOptions.NO)
    unknown = remove_ros_args([name, *arguments])[1:]
    if unknown:
        command = f"{launcher()} {package} {name}"
        raise BadInput(f"unknown argument '{unknown[0]}': parameters follow --ros-args (see {command} --help)")
    return make(context, files)
