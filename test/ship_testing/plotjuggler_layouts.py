"""Names in a layout of PlotJuggler, compared with the outputs of a suite.

PlotJuggler names a number ``/topic/field[0]/field``, and a number of diagnostics ``/topic/node/status/key``.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import pytest

from ship_testing.foxglove_layouts import MessagesByTopic, Missing, check_constant, named_constants


def curves(messages_by_topic: MessagesByTopic) -> set[str]:
    """Return PlotJuggler's names of the numbers of the messages."""
    found: set[str] = set()
    for topic, messages in messages_by_topic.items():
        for message in messages:
            if topic == "/diagnostics":
                for status in message.status:
                    place = f"{topic}/{status.hardware_id}/{status.name}"
                    keys = [pair.key for pair in status.values if is_number(pair.value)]
                    found |= {f"{place}/{key}" for key in ("level", *keys)}
            else:
                found |= set(flat_names(message, topic))
    return found


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def flat_names(value: Any, name: str) -> Iterator[str]:
    """Return the names of the numbers in a value."""
    if is_dataclass(value):
        for field in fields(value):
            yield from flat_names(getattr(value, field.name), f"{name}/{field.name}")
    elif isinstance(value, str):
        return
    elif hasattr(value, "__len__"):
        for index, item in enumerate(value):
            yield from flat_names(item, f"{name}[{index}]")
    else:
        yield name


def check_plotjuggler(root: ET.Element, messages_by_topic: MessagesByTopic) -> None:
    """Raise if a name in a layout does not exist."""
    known = curves(messages_by_topic)
    assert {element.tag for element in root} == {
        "tabbed_widget", "use_relative_time_offset", "streaming_buffer_size", "customMathEquations"
    }  # fmt: skip
    made = set()
    for snippet in root.iter("snippet"):
        assert [element.tag for element in snippet] == ["global", "function", "linked_source"]
        if snippet.findtext("linked_source") not in known:
            raise Missing(snippet.findtext("linked_source"))
        made.add(snippet.get("name"))
    shown = [curve.get("name") for curve in root.iter("curve")]
    if unknown := set(shown) - known - made:
        raise Missing(sorted(unknown))
    assert made <= set(shown)
    for transform in root.iter("transform"):
        assert transform.get("name") == "Scale/Offset"
        assert set(transform.find("options").attrib) == {"time_offset", "value_offset", "value_scale"}
    for splitter in root.iter("DockSplitter"):
        assert splitter.get("orientation") in ("|", "-")
        sizes = [float(size) for size in splitter.get("sizes").split(";")]
        assert int(splitter.get("count")) == len(splitter) == len(sizes)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-4)
    for area in root.iter("DockArea"):
        for value, name in named_constants(area.get("name")):
            topic = area.find("plot/curve").get("name").rpartition("/")[0]
            check_constant(messages_by_topic, topic, name, value)
    assert {plot.get("style") for plot in root.iter("plot")} <= {"Lines", "Dots", "Steps"}
