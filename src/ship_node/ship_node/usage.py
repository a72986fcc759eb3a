"""The text that ``--help`` prints: what a node does, its parameters with units and ranges, its topics."""

import inspect
from typing import Any

from ship_estimation.parameters import ParameterDescription, build, describe, nest
from ship_node.adapter import Adapter
from ship_node.message_factory import MessageFactory
from ship_node.parameter_file import BLACK_BOX_PARAMETER

_BLACK_BOX_ROW = (
    BLACK_BOX_PARAMETER,
    "-",
    "''",
    "",
    "file (.mcap) or folder that takes everything the node uses and gives, for replay --verify; empty for none",
)
_PLACEHOLDERS: dict[type, Any] = {float: 0.0, int: 0, bool: False, str: ""}


def usage_text(adapter_class: type[Adapter], package: str, factory: MessageFactory) -> str:
    """The help of a node.

    Args:
        adapter_class: what the node runs.
        package: where its executable is found.
        factory: makes the adapter's messages.
    """
    name = adapter_class.node_name
    descriptions = list(describe(adapter_class.config_type))
    config = build(adapter_class.config_type, _example_values(descriptions), placeholder="<id>")
    adapter = adapter_class(config, factory)
    return "\n".join(
        [
            f"usage: {package} {name} [--help] [--ros-args [--params-file FILE] [-p NAME:=VALUE] ...]",
            "",
            (inspect.getdoc(adapter_class) or name).splitlines()[0],
            "",
            "topics in (best effort; qos_overrides./TOPIC.subscription.reliability: reliable changes that):",
            *_rows([(t.topic, t.type_name, "required" if t.required else "optional") for t in adapter.inputs]),
            "topics out (reliable):",
            *_rows([(t.topic, t.type_name, "latched" if t.latched else "") for t in adapter.outputs]),
            "services (std_srvs/srv/Trigger):",
            *_rows([(f"~/{service}",) for service in adapter_class.services]),
            "parameters (* may be changed while the node runs):",
            *_rows([*(_parameter_row(description) for description in descriptions), _BLACK_BOX_ROW]),
            "",
            "exit code: 0 ended by SIGINT or SIGTERM, 2 bad parameters or arguments (one line says which)",
        ]
    )


def _example_values(descriptions: list[ParameterDescription]) -> dict[str, Any]:
    """The least configuration that has one entry ``<id>`` in each group of devices."""
    values = {}
    for description in descriptions:
        if description.default is not None:
            values[description.name] = description.default
        else:
            placeholder, low = _PLACEHOLDERS.get(description.kind, ()), description.minimum
            is_number = description.kind in (float, int) and low is not None
            values[description.name] = max(placeholder, description.kind(low)) if is_number else placeholder
    return nest(values)


def _parameter_row(description: ParameterDescription) -> tuple[str, ...]:
    default = "must be given" if description.default is None else f"{description.default!r}"
    allowed = " | ".join(description.choices)
    if description.minimum is not None or description.maximum is not None:
        low = "-inf" if description.minimum is None else f"{description.minimum:.12g}"
        high = "inf" if description.maximum is None else f"{description.maximum:.12g}"
        allowed = f"[{low}, {high}]"
    live = "*" if description.live else ""
    return description.name + live, description.unit or "-", default, allowed, description.doc


def _rows(rows: list[tuple[str, ...]]) -> list[str]:
    """Rows in columns, the last one ragged."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)) for row in rows]
    return ["  " + line.rstrip() for line in lines]
