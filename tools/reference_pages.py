"""Writes docs/reference: parameters, messages, topics and executables, each page from the code that it is about."""

import contextlib
import importlib
import inspect
import io
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from unittest import mock

from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ros.star_attitude_adapter import StarAttitudeAdapter
from ship_bags.message_factory import RosidlFactory
from ship_estimation.parameters import ParameterDescription, describe
from ship_node.edge.adapter import Adapter
from ship_node.parameters.companions import COMPANIONS
from ship_node.parameters.usage import topic_rows, usage_text
from ship_simulation.messages.to_messages import TRUTH_TYPES
from ship_simulation.scenario.scenario import Scenario
from ship_watch.limits import Limits
from theodolite_calib.ros.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.ros.triangulation_adapter import TriangulationAdapter

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "reference"
ADAPTERS: tuple[type[Adapter], ...] = (
    ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter, TriangulationAdapter
)  # fmt: skip

_HELP_WIDTH = "110"
_LIST_INDENT, _CONTINUED_INDENT = 3, 10
"""Spaces before an entry of a list in a message's comments, and before the second line of an entry."""
_WRITTEN = "This page is written by `python tools/reference_pages.py`; a test compares it with the code.\n"
_PARAMETER_COLUMNS = "| parameter | default | unit | allowed | |\n|---|---|---|---|---|\n"

PARAMETERS_HEAD = f"""# Parameters

Units are in the names. `<id>` stands for the id of a star sensor, a camera or a beacon, or the name of a reference, of
a sink or of a source: naming it declares it. A parameter marked *live* may be changed while the node runs
(`ros2 param set`); the others are read at the start. An unknown parameter, or one out of its range, stops the node at
the start and is refused later, each time with the reason.

A parameter file holds a section for each node. `/**/ship_attitude:` is for the node of that name in every namespace,
`/**:` for all nodes; `ship_attitude:` alone fits the node without a namespace and no other. A file in which no section
fits the node, but one has (nearly) its name, ends the node at the start with both names; a file about other nodes is a
warning. `check_config` and `replay` judge names in the same way.

Every estimator has `black_box` besides: a file (`.mcap`) or folder that takes everything the node uses and gives, in
that order; `replay BOX.mcap --verify` runs it again to the last bit. A file that is there is kept: the next box is
`BOX_2.mcap`. After `black_box_part_mb` (`1000`; 0 for never) it goes on in `BOX.part2.mcap`.
Every node has `reliable_inputs` (`false`): what is lost on the way to its inputs is sent again
([lossy links](../how-to/lossy_links.md)). Every node has the map `topics`: the ship's names of its inputs, where they
are other ones ([topics under other names](../how-to/replay_a_night.md#topics-under-other-names)).

{_WRITTEN}"""

SCENARIO_HEAD = f"""# Keys of a scenario

What `simulate` reads, nested at the dots; `<id>` is any name. Units are in the names.
[bags/README.md](../../bags/README.md) tells what is drawn from it, and which scenarios are there.

{_WRITTEN}
"""

LIMITS_HEAD = f"""# Limits of a ship

What page, terminal, alerts and report hold a suite against: a YAML file that a ship has for herself, given with
`--limits FILE`. What the file does not name keeps its default. An unknown key or a value out of its range is one line
with file, line, key and what was expected.

Limits of heading, tilt and pointing are those of the task; their defaults are of no task. `suite --bag BAG --limits`
shows how much of the time they would be held ([Watch a suite](../how-to/watch.md#limits-for-your-task)).

`<id>` is a source or a kind of sources: `ins`, `star`, `reference`, `lights`, `encoder`, `baselines`, `ship_attitude`,
`gnss`, `weather`, or one of several, as `star_bow` for `star.bow`. A source takes the limits of its own name, else
those of its kind, else `every_input`.

    heading_arcsec: 8.0
    every_input: {{refusals: 10}}
    inputs:
      star_bow: {{rate_hz: 2.0}}
    machine: {{disk_path: /data, disk_free_gb: 50}}

{_WRITTEN}
"""

MESSAGES_HEAD = f"""# Messages

The messages of the package `ship_msgs`. Constants come first in each table, then the fields. Beside them the nodes use
messages of ROS 2 itself; [topics.md](topics.md) says where.

{_WRITTEN}"""

TOPICS_HEAD = f"""# Topics

Names are relative: a ship puts all of them in a namespace of its own (`-r __ns:=/aurora`). `<id>` is the id of a star
sensor or of a beacon, or the name of a reference. Inputs are best effort unless `qos_overrides` say otherwise; outputs
are reliable, and a *latched* one gives its last message to who comes later. An input is *required* where the node is of
no use without it.

{_WRITTEN}"""

EXECUTABLES_HEAD = f"""# Executables

What `./ros2run PACKAGE EXECUTABLE` starts, or `ros2 run` where ROS 2 is installed. Each prints its help with `--help`.
The parameters of nodes are in [parameters.md](parameters.md), the keys of a scenario in [scenario.md](scenario.md).

{_WRITTEN}"""


def parameters_page() -> str:
    """Every parameter of every node, from the dataclasses that the nodes themselves use."""
    text = PARAMETERS_HEAD
    for node in (*ADAPTERS, *COMPANIONS):
        text += f"\n## `{node.node_name}`\n\n{_PARAMETER_COLUMNS}"
        text += "".join(_parameter_row(parameter) for parameter in describe(node.config_type))
    return text


def scenario_page() -> str:
    """Every key of a scenario."""
    rows = "".join(_parameter_row(key) for key in describe(Scenario))
    return SCENARIO_HEAD + _PARAMETER_COLUMNS.replace("parameter", "key") + rows


def limits_page() -> str:
    """Every limit that a ship may set."""
    return LIMITS_HEAD + _PARAMETER_COLUMNS.replace("parameter", "key") + "".join(map(_parameter_row, describe(Limits)))


def _parameter_row(parameter: ParameterDescription) -> str:
    given = "" if parameter.default == "" else f"`{parameter.default}`"
    default = "must be given" if parameter.default is None else given
    live = " *live*" if parameter.live else ""
    doc = parameter.doc.replace("<", "&lt;")
    return f"| `{parameter.name}` | {default} | {parameter.unit} | {_allowed(parameter)} | {doc}{live} |\n"


def _allowed(parameter: ParameterDescription) -> str:
    if parameter.choices:
        return ", ".join(f"`{choice}`" for choice in parameter.choices)
    if parameter.minimum is None and parameter.maximum is None:
        return ""
    low = "" if parameter.minimum is None else f"{parameter.minimum:.12g}"
    high = "" if parameter.maximum is None else f"{parameter.maximum:.12g}"
    return f"{low} … {high}"


def messages_page() -> str:
    """Every message of ship_msgs with the comments of its file."""
    paths = sorted((ROOT / "src" / "ship_msgs" / "msg").glob("*.msg"))
    return MESSAGES_HEAD + "".join(_message(path.stem, path.read_text(encoding="utf-8")) for path in paths)


def _message(name: str, text: str) -> str:
    head, _, body = text.partition("\n\n")
    about = " ".join(line.lstrip("# ") for line in head.splitlines())
    rows, comment = "", ""
    follows_declaration = True
    for line in body.splitlines():
        if not line.strip():
            comment, follows_declaration = "", True
        elif line.startswith("#"):
            comment = "" if follows_declaration else comment
            comment += _in_cell(line[1:])
            follows_declaration = False
        else:
            # A declaration without a comment of its own shares the one above.
            kind, declared = line.split(maxsplit=1)
            rows += f"| `{kind}` | `{declared.replace('=', ' = ')}` | {comment.strip()} |\n"
            follows_declaration = True
    return f"\n## {name}\n\n{about}\n\n| type | name | |\n|---|---|---|\n{rows}"


def _in_cell(line: str) -> str:
    """A line of a comment as part of a table's cell; the entries of a list stay lines."""
    plain = line.strip().replace("<", "&lt;").replace("|", r"\|")
    aligned = re.sub(r"  +", ": ", plain, count=1)
    indent = len(line) - len(line.lstrip())
    return f"<br>{aligned}" if _LIST_INDENT <= indent < _CONTINUED_INDENT else f" {plain}"


def topics_page() -> str:
    """Every topic of every node, and the truth in simulated bags."""
    text = TOPICS_HEAD
    for adapter in ADAPTERS:
        inputs, outputs = topic_rows(adapter, RosidlFactory())
        text += f"\n## In: `{adapter.node_name}`\n\n| topic | type | |\n|---|---|---|\n"
        text += "".join(f"| `{topic}` | {_type(kind)} | {_condition(need)} |\n" for topic, kind, need in inputs)
        text += f"\n## Out: `{adapter.node_name}`\n\n| topic | type | |\n|---|---|---|\n"
        text += "".join(f"| `{topic}` | {_type(kind)} | {latched} |\n" for topic, kind, latched in outputs)
        text += "\nServices (`std_srvs/srv/Trigger`): " + ", ".join(f"`~/{name}`" for name in adapter.services) + ".\n"
    rows = "".join(f"| `{topic}` | {_type(kind)} |\n" for topic, kind in sorted(TRUTH_TYPES.items()))
    return text + f"\n## Truth in simulated bags, which no node sees\n\n| topic | type |\n|---|---|\n{rows}"


def _condition(need: str) -> str:
    """Whether a topic is required, with the parameter that makes it so as code."""
    return re.sub(r"with (.*)", r"with `\1`", need)


def _type(name: str) -> str:
    package, _, short = name.partition("/msg/")
    return f"[{short}](messages.md#{short.lower()})" if package == "ship_msgs" else f"`{name}`"


def executables_page() -> str:
    """Every executable with its help, without the long tables that have pages of their own."""
    text = EXECUTABLES_HEAD
    entries = {package: _executables(package) for package in sorted(path.parent.name for path in _setup_files())}
    text += "\n| package | executables |\n|---|---|\n"
    for package, found in entries.items():
        if found:
            text += f"| `{package}` | {', '.join(f'[`{name}`](#{name})' for name, _ in found)} |\n"
    for package, found in entries.items():
        for name, module in found:
            shown = _cut(_help_of(package, name, module)).strip("\n")
            text += f"\n## `{name}`\n\n```text\n{shown}\n```\n"
    return text


def _setup_files() -> list[Path]:
    return sorted(ROOT.glob("src/*/setup.py"))


def _executables(package: str) -> list[tuple[str, str]]:
    """Name and module of each, without the hints that tell where an executable has moved."""
    text = (ROOT / "src" / package / "setup.py").read_text(encoding="utf-8")
    found = re.findall(r'"(\w+) = ([\w.]+):\w+"', text)
    return [(name, module) for name, module in found if not module.endswith(".moved")]


def _help_of(package: str, name: str, module: str) -> str:
    for adapter in ADAPTERS:
        if adapter.node_name == name:
            return usage_text(adapter, package, RosidlFactory())
    printed = io.StringIO()
    with (
        mock.patch.dict(os.environ, {"COLUMNS": _HELP_WIDTH}),
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        importlib.import_module(module).main(["--help"])
    return printed.getvalue()


def _cut(shown: str) -> str:
    """The help without the parameters of a node and the keys of a scenario."""
    for block, instead in ((r"parameters \(", "parameters: parameters.md"), ("keys of SCENARIO", "keys: scenario.md")):
        shown = re.sub(rf"^{block}.*?\n\n", f"{instead}\n\n", shown, flags=re.MULTILINE | re.DOTALL)
    return shown


PAGES: dict[str, Callable[[], str]] = {
    "parameters": parameters_page,
    "scenario": scenario_page,
    "limits": limits_page,
    "messages": messages_page,
    "topics": topics_page,
    "executables": executables_page,
}
"""Name of each page → what makes its text."""


if __name__ == "__main__":
    for name, page in PAGES.items():
        path = FOLDER / f"{name}.md"
        path.write_text(page(), encoding="utf-8")
        sys.stdout.write(f"{path.relative_to(ROOT)}: {(inspect.getdoc(page) or '').rstrip('.')}\n")
