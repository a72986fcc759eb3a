"""Entry points of a node's executable: help, arguments, start, spin, clean end, exit codes.

The help gives the purpose of the node, its parameters with units and ranges, and its topics.
"""

import inspect
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import rclpy
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ship_bags.command_line import launcher, print_text
from ship_bags.errors import BadInput
from ship_bags.live.ros_process import prepare_dds
from ship_bags.message_factory import MessageFactory, RosidlFactory
from ship_bags.parameter_yaml import BLACK_BOX_PARAMETER, BLACK_BOX_PART_PARAMETER, RELIABLE_INPUTS_PARAMETER
from ship_bags.topic_names import TOPICS_PARAMETER
from ship_estimation.parameters.schema import (
    ParameterDescription,
    aligned_lines,
    build,
    describe,
    nest,
    parameter_row,
    wrapped_lines,
)
from ship_node.adapters.adapter import Adapter
from ship_node.live.live_node import LiveNode
from ship_node.messages.inputs_outputs import InputTopic
from ship_node.parameters.parameter_file import read_matching_sections

_RUNTIME_ROWS = (
    (
        BLACK_BOX_PARAMETER,
        "-",
        "''",
        "",
        "black box: file (.mcap) or folder for all inputs and outputs of the node, for replay --verify; empty for none",
    ),
    (
        BLACK_BOX_PART_PARAMETER,
        "MB",
        "1000",
        "0 or more",
        "size at which the black box continues in a new file next to the first (NAME.part2.mcap); 0 for never",
    ),
    (
        RELIABLE_INPUTS_PARAMETER,
        "-",
        "False",
        "",
        "inputs are reliable: lost messages are sent again, and newer ones wait for them",
    ),
    (
        f"{TOPICS_PARAMETER}.<input>",
        "-",
        "",
        "",
        "the ship's name of an input, if it is different: topics: {ins/imu: /imu/data}",
    ),
)
_PLACEHOLDERS: dict[type, Any] = {float: 0.0, int: 0, bool: False, str: ""}

EXIT_DONE, EXIT_BAD_INPUT = 0, 2

_BAD_START = ValueError, OSError, ImportError, rclpy_implementation.RCLError
"""Exceptions that end the start, for example due to bad parameters, bad arguments or a missing message package.

The exceptions of all packages for bad input are ValueErrors."""


def usage_text(adapter_class: type[Adapter], package: str, factory: MessageFactory) -> str:
    """Return the help of a node.

    Args:
        adapter_class: adapter of the node.
        package: package of the node's executable.
        factory: makes the adapter's messages.
    """
    name = adapter_class.node_name
    command = f"{launcher()} {package} {name}"
    inputs, outputs = topic_rows(adapter_class, factory)
    return "\n".join(
        [
            f"usage: {command} [--help] [--ros-args [--params-file FILE] [-p NAME:=VALUE] ...]",
            "",
            (inspect.getdoc(adapter_class) or name).splitlines()[0],
            "",
            "topics in (best effort, all reliable with reliable_inputs; for one TOPIC the parameter",
            "qos_overrides./TOPIC.subscription.reliability: reliable | best_effort rules):",
            *aligned_lines(inputs),
            "topics out (reliable):",
            *aligned_lines(outputs),
            "services (std_srvs/srv/Trigger):",
            *aligned_lines([(f"~/{service}",) for service in adapter_class.services]),
            "parameters (* may be changed while the node runs):",
            *wrapped_lines([*map(parameter_row, describe(adapter_class.config_type)), *_RUNTIME_ROWS]),
            "",
            "exit code: 0 ended by SIGINT or SIGTERM, 2 bad parameters or arguments (with one line of reason)",
            "",
            "example:",
            f"  {command} --ros-args --params-file suite.yaml -p black_box:=/var/log/ship/",
        ]
    )


def topic_rows(
    adapter_class: type[Adapter], factory: MessageFactory
) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Return name, type and remark of each input and output topic of a node with one device of each kind."""
    descriptions = list(describe(adapter_class.config_type))
    values = _example_values(descriptions)
    adapter = adapter_class(build(adapter_class.config_type, nest(values), placeholder="<id>"), factory)
    outputs: list[tuple[str, ...]] = [
        (t.topic, t.type_name, "latched" if t.latched else "") for t in adapter.outputs
    ]
    return _input_rows(adapter_class, descriptions, values, factory), outputs


def _input_rows(
    adapter_class: type[Adapter],
    descriptions: list[ParameterDescription],
    values: dict[str, Any],
    factory: MessageFactory,
) -> list[tuple[str, ...]]:
    """Return the inputs of the example configuration, and the inputs that other choices of its parameters add."""
    rows: dict[str, tuple[str, ...]] = {}
    example = [("", {}), *(
        (f"with {d.name}: {choice}", {d.name: choice})
        for d in descriptions for choice in d.choices if choice != values[d.name]
    )]  # fmt: skip
    for condition, choice in example:
        device = "".join(choice).rpartition(".")[0]
        given = {
            d.name: d.maximum
            for d in descriptions
            if d.name.startswith(device) and d.default == 0.0 and d.maximum is not None
        }
        for topic in _inputs_with(adapter_class, {**values, **choice}, given, factory):
            need = "required" if topic.required else "optional"
            rows.setdefault(topic.topic, (topic.topic, topic.type_name, ", ".join(filter(None, (need, condition)))))
    return list(rows.values())


def _inputs_with(
    adapter_class: type[Adapter], values: dict[str, Any], given: dict[str, Any], factory: MessageFactory
) -> tuple[InputTopic, ...]:
    """Return the inputs of a configuration; empty if the configuration is invalid.

    Args:
        adapter_class: adapter of the node.
        values: values of the parameters.
        given: maxima of a device's parameters that are zero by default; used only if ``values`` alone are invalid.
        factory: makes the adapter's messages.
    """
    for attempt in (values, values | given):
        try:
            config: Any = build(adapter_class.config_type, nest(attempt), placeholder="<id>")
            return adapter_class(config, factory).inputs
        except ValueError:  # noqa: PERF203 - twice at most
            continue
    return ()


def _example_values(descriptions: list[ParameterDescription]) -> dict[str, Any]:
    """Return dotted name → value of a minimal configuration with one entry ``<id>`` in each group of devices.

    A group within a device, such as the masks of a sensor, stays empty.
    """
    values = {}
    for description in descriptions:
        if description.name.count("<id>") > 1:
            continue
        if description.default is not None:
            values[description.name] = description.default
        else:
            placeholder, low = _PLACEHOLDERS.get(description.kind, ()), description.minimum
            is_number = description.kind in (float, int) and low is not None
            values[description.name] = max(placeholder, description.kind(low)) if is_number else placeholder
    return values


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
