"""Text of ``--help``: purpose of a node, parameters with units and ranges, topics."""

import inspect
from typing import Any

from ship_bags.command_line import launcher
from ship_bags.message_factory import MessageFactory
from ship_bags.parameter_yaml import BLACK_BOX_PARAMETER, BLACK_BOX_PART_PARAMETER, RELIABLE_INPUTS_PARAMETER
from ship_bags.renamed_topics import TOPICS_PARAMETER
from ship_estimation.parameters.rows import aligned_lines, parameter_row, wrapped_lines
from ship_estimation.parameters.schema import ParameterDescription, build, describe, nest
from ship_node.adapters.adapter import Adapter
from ship_node.messages.topics import InputTopic

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
