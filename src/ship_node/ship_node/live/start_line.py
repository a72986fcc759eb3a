"""The one line that a node says of itself at the start."""

import dataclasses
from typing import Any

from ship_node.edge.adapter import Adapter

_FILE = "_file"


def start_line(adapter: Adapter, config: Any, is_simulated_time: bool, black_box: str) -> str:
    """Devices by kind, files, clock and black box of a node.

    Args:
        adapter: of the node, as configured.
        config: its configuration: a group of devices is a mapping, a file a text whose name ends with ``_file``.
        is_simulated_time: whether the node's clock is /clock.
        black_box: path of its box, empty for none.
    """
    parts = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if isinstance(value, dict):
            parts.append(f"{field.name.replace('_', ' ')}: {', '.join(value) or 'none'}")
        elif field.name.endswith(_FILE):
            parts.append(f"{field.name}: {value or 'none'}")
    required = [topic.topic for topic in adapter.inputs if topic.required]
    parts += [
        f"needs {', '.join(required) or 'no topic'}",
        f"clock: {'/clock' if is_simulated_time else 'system time'}",
        f"black box: {black_box or 'none'}",
    ]
    return "; ".join(parts)
