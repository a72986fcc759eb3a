"""Differences between the configurations of two recordings: line by line as written, and parameter by parameter."""

import difflib
from dataclasses import dataclass
from typing import Any

from ship_bags.mcap.bag_writer import SUITE_ATTACHMENT
from ship_estimation.parameters.schema import flatten
from ship_replay.evaluation.evaluate import named_config
from ship_replay.offline.nodes import ADAPTERS
from ship_replay.report.recording import RecordedHistory

_NODES = {kind.node_name: kind.config_type for kind in ADAPTERS}
_TEXTS = (".yaml", ".yml")


@dataclass(frozen=True)
class ParameterDifference:
    """A parameter that differs between A and B; the value of a run without this device is empty.

    For a node of one run only, the name is empty, and the values are "configured" and "not configured".
    """

    node: str
    name: str
    a: str
    b: str


def attached_texts(recording: RecordedHistory) -> dict[str, str]:
    """Return name → text of the configurations attached to a bag."""
    return {
        name: data.decode(errors="replace") for name, data in sorted(recording.attachments.items())
        if name.endswith(_TEXTS)
    }


def text_differences(a: RecordedHistory, b: RecordedHistory) -> dict[str, list[str]]:
    """Return name of an attached configuration → lines of its unified diff from A to B; no lines if both are equal."""
    texts_a, texts_b = attached_texts(a), attached_texts(b)
    return {
        name: list(
            difflib.unified_diff(
                texts_a.get(name, "").splitlines(), texts_b.get(name, "").splitlines(),
                f"A {name}" if name in texts_a else "A: not attached",
                f"B {name}" if name in texts_b else "B: not attached", lineterm="",
            )
        )
        for name in sorted(texts_a.keys() | texts_b.keys())
    }


def parameter_differences(a: RecordedHistory, b: RecordedHistory) -> list[ParameterDifference]:
    """Return the parameters that differ, defaults included.

    A parameter does not differ if one file sets it to its default and the other file omits it. A node that only one
    file configures is one row.

    Raises:
        BadInput: a suite file is not valid in this version; the evaluation of the bags checks this first.
    """
    found = []
    for node, kind in _NODES.items():
        values_a, values_b = _parameters(a, node, kind), _parameters(b, node, kind)
        if values_a is None or values_b is None:
            if values_a is not values_b:
                texts = ["not configured" if values is None else "configured" for values in (values_a, values_b)]
                found.append(ParameterDifference(node, "", *texts))
            continue
        for name in dict.fromkeys([*values_a, *values_b]):
            value_a, value_b = values_a.get(name), values_b.get(name)
            if value_a != value_b:
                found.append(ParameterDifference(node, name, _text(value_a), _text(value_b)))
    return found


def _parameters(recording: RecordedHistory, node: str, kind: type) -> dict[str, Any] | None:
    if SUITE_ATTACHMENT not in recording.attachments:
        return None
    config = named_config(recording.attachments[SUITE_ATTACHMENT].decode(errors="replace"), kind, node)
    return None if config is None else flatten(config)


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, (list, tuple)):
        return ", ".join(_text(entry) for entry in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
