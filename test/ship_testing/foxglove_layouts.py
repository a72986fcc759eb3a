"""Names in a layout of Foxglove or Lichtblick, compared with the outputs of a suite.

Both viewers read message paths: ``/topic.field[0].field``, ``/topic{name=="value"}.field``. ``$name`` is a variable of
the layout.
"""

import re
from collections.abc import Iterator
from typing import Any

import ship_attitude_star.ship_attitude.config as attitude_devices
import ship_attitude_star.ship_attitude.model as attitude_model
import theodolite_calib.filter.model as pointing_model

MessagesByTopic = dict[str, list[Any]]
"""Messages by absolute topic."""

SCRIPTS = "/studio_script/"
STEP = re.compile(r'\.(?P<name>\w+)|\[(?P<index>\d+|:)\]|\{(?P<field>\w+)==(?P<value>\$\w+|"[^"]*")\}')
PANELS = {  # panel type: required and optional keys of its configuration
    "Plot": (
        {"paths", "xAxisVal", "isSynced"},
        {"yAxisLabel", "minYValue", "showLegend", "legendDisplay", "showPlotValuesInLegend", "showXAxisLabels",
         "showYAxisLabels", "sidebarDimension"},
    ),
    "StateTransitions": ({"paths", "isSynced"}, set()),
    "Indicator": ({"path", "style", "fallbackColor", "fallbackLabel", "rules"}, set()),
    "Table": ({"topicPath"}, set()),
    "RawMessages": (
        {"topicPath"},
        {"diffEnabled", "diffMethod", "diffTopicPath", "showFullMessageForDiff", "expansion"},
    ),
    "DiagnosticSummary": ({"topicToRender", "minLevel"}, {"pinnedIds", "hardwareIdFilter", "sortByLevel"}),
    "Tab": ({"activeTabIdx", "tabs"}, set()),
}  # fmt: skip
"""Panels in use; the keys are those of the settings in Lichtblick 1.28."""
TITLES = {"lichtblickPanelTitle", "foxglovePanelTitle"}
SERIES = {"value", "label", "enabled", "timestampMethod", "color"}
ERROR_SOURCES = {
    value
    for model in (attitude_devices, attitude_model, pointing_model)
    for name, value in vars(model).items()
    if name.startswith("SOURCE_")
}


class Missing(AssertionError):
    """A name in a layout does not exist."""


class Scripts:
    """Scripts of a layout: their inputs exist, and their outputs have types that panels show."""

    def __init__(self, layout: dict[str, Any], messages: MessagesByTopic) -> None:
        self.outputs: dict[str, dict[str, dict[str, str]]] = {}
        for key, script in layout["userNodes"].items():
            code = script["sourceCode"]
            topic = single_item(re.findall(r'^export const inputs = \["(.*)"\];$', code, re.MULTILINE))
            assert script["name"] == key
            assert f'export default function script(event: Input<"{topic}">): Output' in code
            for field in re.findall(r"event\.message\.(\w+)", code):
                resolve(f"{topic}.{field}", messages, layout["globalVariables"])
            for names in re.findall(r"const LEVELS = \[(.*)\]", code):
                for value, name in enumerate(re.findall(r'"(\w+)"', names)):
                    check_constant(messages, topic, name, value)
            types = {
                name: dict(re.findall(r"(\w+): (\w+(?:\[\])?);?\s", body))
                for name, body in re.findall(r"^type (\w+) = \{(.*?)\};$", code, re.MULTILINE | re.DOTALL)
            }
            self.outputs[single_item(re.findall(r'^export const output = "(.*)";$', code, re.MULTILINE))] = types

    def output_type(self, topic: str, steps: list[re.Match[str]]) -> str:
        """Return the name of the type at the end of a path in the output of a script."""
        if topic not in self.outputs:
            raise Missing(f"no script gives {topic}")
        types, kind = self.outputs[topic], "Output"
        for step in steps:
            if name := step["name"] or step["field"]:
                field = types.get(kind, {}).get(name)
                if field is None:
                    raise Missing(f"{topic}: {kind} has no {name}")
                kind = kind if step["field"] else field
            elif kind.endswith("[]"):
                kind = kind.removesuffix("[]")
            else:
                raise Missing(f"{topic}: {kind} is no array")
        return kind


def single_item(found: list[str]) -> str:
    (one,) = found
    return one


def split(path: str) -> tuple[str, list[re.Match[str]]]:
    """Return topic and steps of a message path; refuse modifiers, because Lichtblick's plots ignore most of them."""
    topic = single_item(re.findall(r"^/?[\w/]+", path))
    steps, at = [], len(topic)
    while at < len(path):
        step = STEP.match(path, at)
        if step is None:
            raise Missing(f"{path}: not understood from {path[at:]!r}")
        steps.append(step)
        at = step.end()
    return topic, steps


def resolve(path: str, messages: MessagesByTopic, variables: dict[str, str]) -> list[Any]:
    """Return the values of a message path in the messages; at least one."""
    topic, steps = split(path)
    if topic not in messages:
        raise Missing(f"{path}: no topic {topic}")
    found = messages[topic]
    for step in steps:
        if step["name"]:
            found = [value_of(holder, step["name"], path) for holder in found]
        elif step["field"]:
            wanted = wanted_value(step, variables)
            found = [holder for holder in found if value_of(holder, step["field"], path) == wanted]
        elif step["index"] == ":":
            found = [item for holder in found for item in holder]
        else:
            found = [holder[int(step["index"])] for holder in found if len(holder) > int(step["index"])]
        if not found:
            raise Missing(f"{path}: nothing at {step[0]}")
    return found


def value_of(holder: Any, name: str, path: str) -> Any:
    if name.startswith("_") or not hasattr(holder, name) or name.isupper():
        raise Missing(f"{path}: no field {name}")
    return getattr(holder, name)


def wanted_value(step: re.Match[str], variables: dict[str, str]) -> str:
    value = step["value"]
    if not value.startswith("$"):
        return value.strip('"')
    if value[1:] not in variables:
        raise Missing(f"no variable {value}")
    return variables[value[1:]]


def check_constant(messages: MessagesByTopic, topic: str, name: str, value: int) -> None:
    """Raise unless messages of a topic have this constant."""
    if getattr(messages[topic][0], name, None) != value:
        raise Missing(f"{topic}: {name} is not {value}")


def named_constants(text: str) -> list[tuple[int, str]]:
    """Return (value, name) in a text such as "status: 0 VALID, 1 COASTING"."""
    return [(int(value), name) for value, name in re.findall(r"\b(\d) ([A-Z_]{2,})\b", text)]


def check_path(
    path: str, layout: dict[str, Any], messages_by_topic: MessagesByTopic, scripts: Scripts, is_shown: tuple[type, ...]
) -> None:
    """Raise unless a path leads to a type that its panel can show."""
    topic, steps = split(path)
    if not topic.startswith(SCRIPTS):
        values = resolve(path, messages_by_topic, layout["globalVariables"])
        if not all(isinstance(getattr(value, "item", lambda value=value: value)(), is_shown) for value in values[:1]):
            raise Missing(f"{path}: {values[0]!r} cannot be shown")
        return
    kind = scripts.output_type(topic, steps)
    if is_shown != (object,) and kind != "number":
        raise Missing(f"{path}: a {kind} cannot be shown")
    sources = {
        message.source
        for name, messages in messages_by_topic.items()
        if name.endswith("/innovation")
        for message in messages
    }
    for step in steps:
        if step["field"] and wanted_value(step, layout["globalVariables"]) not in sources | ERROR_SOURCES:
            raise Missing(f"{path}: no source {step['value']}")


def panels_of(mosaic: Any) -> Iterator[str]:
    """Return the panels in an arrangement."""
    if isinstance(mosaic, str):
        yield mosaic
        return
    assert set(mosaic) == {"direction", "first", "second", "splitPercentage"}
    assert mosaic["direction"] in ("row", "column")
    assert 0 < mosaic["splitPercentage"] < 100
    yield from panels_of(mosaic["first"])
    yield from panels_of(mosaic["second"])


def check_foxglove(layout: dict[str, Any], messages: MessagesByTopic) -> None:
    """Raise if a name in a layout does not exist."""
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    scripts = Scripts(layout, messages)
    panels = list(panels_of(layout["layout"]))
    for panel, config in layout["configById"].items():
        kind = panel.partition("!")[0]
        needed, more = PANELS[kind]
        assert needed <= set(config) <= needed | more | TITLES, panel
        if kind == "Tab":
            assert all(set(tab) == {"title", "layout"} for tab in config["tabs"])
            panels += [leaf for tab in config["tabs"] for leaf in panels_of(tab["layout"])]
        check_panel(kind, config, layout, messages, scripts)
    assert sorted(panels) == sorted(layout["configById"])


def check_panel(
    kind: str, config: dict[str, Any], layout: dict[str, Any], messages: MessagesByTopic, scripts: Scripts
) -> None:
    shown: tuple[type, ...] = (int, float) if kind == "Plot" else (int, float, str, bool)
    for series in config.get("paths", []):
        assert {"value", "enabled", "timestampMethod"} <= set(series) <= SERIES
        check_path(series["value"], layout, messages, scripts, shown)
        for value, name in named_constants(series["label"]):
            check_constant(messages, split(series["value"])[0], name, value)
    if kind == "Indicator":
        check_path(config["path"], layout, messages, scripts, (int,))
        for rule in config["rules"]:
            assert set(rule) == {"operator", "rawValue", "color", "label"}
            check_constant(messages, split(config["path"])[0], rule["label"], int(rule["rawValue"]))
    if "topicPath" in config:
        check_path(config["topicPath"], layout, messages, scripts, (object,))
    if "topicToRender" in config:
        check_path(config["topicToRender"], layout, messages, scripts, (object,))


def paths(layout: dict[str, Any]) -> list[str]:
    """Return all message paths of a layout."""
    configs = layout["configById"].values()
    found = [series["value"] for config in configs for series in config.get("paths", [])]
    keys = ("path", "topicPath", "topicToRender")
    return found + [config[key] for config in configs for key in keys if key in config]
