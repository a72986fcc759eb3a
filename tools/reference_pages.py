"""Writes docs/reference from the code: parameters, scenarios, limits, messages, topics, executables, glossary."""

import contextlib
import importlib
import io
import os
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from unittest import mock

from ship_attitude_star.adapters.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.adapters.star_attitude_adapter import StarAttitudeAdapter
from ship_bags.command_line import LAUNCHER_VARIABLE
from ship_bags.message_factory import RosidlFactory
from ship_estimation.parameters.schema import ParameterDescription, describe
from ship_node.adapters.adapter import Adapter
from ship_node.live.node_runtime import topic_rows, usage_text
from ship_node.parameters.parameter_file import COMPANIONS
from ship_simulation.messages.message_stream import TRUTH_TYPES
from ship_simulation.scenario.scenario import scenario_keys
from ship_watch.safety.limits import Limits
from theodolite_calib.adapters.optical_axis_adapter import OpticalAxisAdapter
from theodolite_calib.adapters.triangulation_adapter import TriangulationAdapter

ROOT = Path(__file__).parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tools import glossary  # noqa: E402
from tools import reference_groups as groups  # noqa: E402  # found by the path above, also from a script

FOLDER = ROOT / "docs" / "reference"
ADAPTERS: tuple[type[Adapter], ...] = (
    ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter, TriangulationAdapter
)  # fmt: skip

_HELP_WIDTH = "110"
_LIST_INDENT, _CONTINUED_INDENT = 3, 10
"""Spaces before an entry of a list in a message's comments, and before the second line of an entry."""
_PARAMETER_COLUMNS = "| parameter | default | unit | allowed | |\n|---|---|---|---|---|\n"
_KEY_COLUMNS = _PARAMETER_COLUMNS.replace("parameter", "key")

PARAMETERS_HEAD = f"""# Parameters

Units are in the names. `<id>` stands for the id of a star sensor, a camera or a beacon, or the name of a reference, of
a sink or of a source: a parameter with this name declares it. A parameter marked *live* may be changed while the node
runs (`ros2 param set`); the others are read at the start. An unknown parameter, or one out of its range, ends the node
at the start and is rejected later, each time with the reason.

A parameter file has a section for each node. `/**/ship_attitude:` is for the node of that name in every namespace,
`/**:` for all nodes; `ship_attitude:` alone is only for the node without a namespace. If no section of a file fits the
node, but one has (nearly) its name, the node ends at the start with both names; a file with sections for other nodes
only is a warning. `check_config` and `replay` compare names in the same way.

Every estimator also has `black_box`: a file (`.mcap`) or folder in which all inputs and outputs of the node are
recorded in their order; `replay BOX.mcap --verify` repeats them bit by bit. An existing file is not overwritten: the
next box is `BOX_2.mcap`. After `black_box_part_mb` (`1000`; 0 for never) it continues in `BOX.part2.mcap`.
Every node has `reliable_inputs` (`false`): messages to its inputs that were lost are sent again
([lossy links](../how-to/lossy_links.md)). Every node has the map `topics`: the ship's names of its inputs, if they
differ ([topics under other names](../how-to/replay_a_night.md#topics-under-other-names)).

{groups.WRITTEN}"""

SCENARIO_HEAD = f"""# Keys of a scenario

Input of `simulate`, nested at the dots; `<id>` is any name. Units are in the names.
[bags/README.md](../../bags/README.md) describes what is simulated from it, and lists the scenarios.

{groups.WRITTEN}"""

LIMITS_HEAD = f"""# Limits of a ship

Limits with which page, terminal, alerts and report compare a suite: a YAML file of the ship, given with
`--limits FILE`. A key that is not in the file has its default. An unknown key or a value out of its range is an error
of one line with file, line, key and the expected value.

Limits of heading, tilt and pointing depend on the task; their defaults are of no task. `suite --bag BAG --limits`
shows the share of time within them ([Watch a suite](../how-to/watch.md#limits-for-your-task)).

`<id>` is a source or a kind of sources: `ins`, `star`, `reference`, `lights`, `encoder`, `baselines`, `ship_attitude`,
`gnss`, `weather`, or one of several, as `star_bow` for `star.bow`. A source takes the limits of its own name, else
those of its kind, else `every_input`.

    heading_arcsec: 8.0
    every_input: {{refusals: 10}}
    inputs:
      star_bow: {{rate_hz: 2.0}}
    machine: {{disk_path: /data, disk_free_gb: 50}}

{groups.WRITTEN}
"""

MESSAGES_HEAD = f"""# Messages

The messages of the package `ship_msgs`. Constants come first in each table, then the fields. The nodes also use
messages of ROS 2 itself; they are listed in [topics.md](topics.md).

{groups.WRITTEN}"""

TOPICS_HEAD = f"""# Topics

Names are relative: a ship sets a namespace for all of them (`-r __ns:=/aurora`). `<id>` is the id of a star sensor or
of a beacon, or the name of a reference. Inputs are best effort unless set by `qos_overrides`; outputs are reliable, and
of a *latched* one late subscribers receive the last message. An input is *required* if the node has no valid output
without it.

{groups.WRITTEN}"""

EXECUTABLES_HEAD = f"""# Executables

Each is started with `./ros2run PACKAGE EXECUTABLE`, or `ros2 run` where ROS 2 is installed, and prints its help with
`--help`.
The parameters of nodes are in [parameters.md](parameters.md), the keys of a scenario in [scenario.md](scenario.md).

{groups.WRITTEN}"""


def parameters_pages() -> dict[str, str]:
    """Return the pages with all parameters of all nodes, from the dataclasses of the nodes."""
    sections: dict[str, str] = {}
    for node in (*ADAPTERS, *COMPANIONS):
        tables = _tables(describe(node.config_type), _PARAMETER_COLUMNS, node.node_name)
        sections |= {f"{node.node_name}/{section}": table for section, table in tables.items()}
    return groups.split("parameters", PARAMETERS_HEAD, sections, groups.PARAMETERS)


def scenario_pages() -> dict[str, str]:
    """Return the pages with all keys of a scenario."""
    sections = _tables(scenario_keys(), _KEY_COLUMNS, "scenario")
    return groups.split("scenario", SCENARIO_HEAD, sections, groups.SCENARIO)


def limits_page() -> str:
    """Return the page with all limits that a ship may set."""
    return LIMITS_HEAD + _KEY_COLUMNS + "".join(map(_parameter_row, describe(Limits)))


def _tables(parameters: Iterable[ParameterDescription], columns: str, general: str) -> dict[str, str]:
    """Return a table for each first part of the names; parameters without parts are in the table `general`."""
    tables: dict[str, str] = {}
    for parameter in parameters:
        first, dot, _ = parameter.name.partition(".")
        section = first if dot else general
        tables[section] = tables.get(section, columns) + _parameter_row(parameter)
    return tables


def _parameter_row(parameter: ParameterDescription) -> str:
    given = "" if parameter.default == "" else f"`{parameter.default}`"
    default = "must be given" if parameter.default is None else given
    live = " *live*" if parameter.live else ""
    doc = parameter.doc.replace("<", "&lt;")
    return f"| `{parameter.name}` | {default} | {parameter.unit} | {_range_text(parameter)} | {doc}{live} |\n"


def _range_text(parameter: ParameterDescription) -> str:
    if parameter.choices:
        return ", ".join(f"`{choice}`" for choice in parameter.choices)
    if parameter.minimum is None and parameter.maximum is None:
        return ""
    low = "" if parameter.minimum is None else f"{parameter.minimum:.12g}"
    high = "" if parameter.maximum is None else f"{parameter.maximum:.12g}"
    return f"{low} … {high}"


def messages_pages() -> dict[str, str]:
    """Return the pages with all messages of ship_msgs and the comments in their files."""
    paths = sorted((ROOT / "src" / "ship_msgs" / "msg").glob("*.msg"))
    sections = {path.stem: _message(path.read_text(encoding="utf-8")) for path in paths}
    return groups.split("messages", MESSAGES_HEAD, sections, groups.MESSAGES)


def _message(text: str) -> str:
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
            # A declaration without a comment has the comment above.
            kind, declared = line.split(maxsplit=1)
            rows += f"| `{kind}` | `{declared.replace('=', ' = ')}` | {comment.strip()} |\n"
            follows_declaration = True
    return f"{about}\n\n| type | name | |\n|---|---|---|\n{rows}"


def _in_cell(line: str) -> str:
    """Return a line of a comment as part of a table cell; the entries of a list remain separate lines."""
    plain = line.strip().replace("<", "&lt;").replace("|", r"\|")
    aligned = re.sub(r"  +", ": ", plain, count=1)
    indent = len(line) - len(line.lstrip())
    return f"<br>{aligned}" if _LIST_INDENT <= indent < _CONTINUED_INDENT else f" {plain}"


def topics_page() -> str:
    """Return the page with all topics of all nodes, and the truth in simulated bags."""
    text = TOPICS_HEAD
    for adapter in ADAPTERS:
        inputs, outputs = topic_rows(adapter, RosidlFactory())
        text += f"\n## In: `{adapter.node_name}`\n\n| topic | type | |\n|---|---|---|\n"
        text += "".join(f"| `{topic}` | {_type(kind)} | {_condition(need)} |\n" for topic, kind, need in inputs)
        text += f"\n## Out: `{adapter.node_name}`\n\n| topic | type | |\n|---|---|---|\n"
        text += "".join(f"| `{topic}` | {_type(kind)} | {latched} |\n" for topic, kind, latched in outputs)
        text += "\nServices (`std_srvs/srv/Trigger`): " + ", ".join(f"`~/{name}`" for name in adapter.services) + ".\n"
    rows = "".join(f"| `{topic}` | {_type(kind)} |\n" for topic, kind in sorted(TRUTH_TYPES.items()))
    return text + f"\n## Truth in simulated bags, which no node receives\n\n| topic | type |\n|---|---|\n{rows}"


def _condition(need: str) -> str:
    """Return the condition under which a topic is required; a parameter in the condition is formatted as code."""
    return re.sub(r"with (.*)", r"with `\1`", need)


def _type(name: str) -> str:
    package, _, short = name.partition("/msg/")
    if package != "ship_msgs":
        return f"`{name}`"
    return f"[{short}](messages/{groups.page_of(short, groups.MESSAGES)}.md#{short.lower()})"


def executables_pages() -> dict[str, str]:
    """Return the pages with all executables and their help, without the long tables, which are on other pages."""
    sections = {}
    for package in sorted(path.parent.name for path in _setup_files()):
        for name, module in _executables(package):
            shown = _without_tables(_help_of(package, name, module)).strip("\n")
            sections[f"{package}/{name}"] = f"```text\n{shown}\n```\n"
    return groups.split("executables", EXECUTABLES_HEAD, sections, groups.EXECUTABLES)


def _setup_files() -> list[Path]:
    return sorted(ROOT.glob("src/*/setup.py"))


def _executables(package: str) -> list[tuple[str, str]]:
    """Return name and module of each executable, except executables that only print the name of the new package."""
    text = (ROOT / "src" / package / "setup.py").read_text(encoding="utf-8")
    found = re.findall(r'"(\w+) = ([\w.]+):\w+"', text)
    return [(name, module) for name, module in found if not module.endswith(".moved")]


@mock.patch.dict(os.environ, {"COLUMNS": _HELP_WIDTH, LAUNCHER_VARIABLE: "./ros2run"})
def _help_of(package: str, name: str, module: str) -> str:
    for adapter in ADAPTERS:
        if adapter.node_name == name:
            return usage_text(adapter, package, RosidlFactory())
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        importlib.import_module(module).main(["--help"])
    return printed.getvalue()


def _without_tables(shown: str) -> str:
    """Return the help without the parameters of a node and the keys of a scenario."""
    for block, page in ((r"parameters \(", "parameters"), ("keys of SCENARIO", "scenario")):
        shown = re.sub(rf"^{block}.*?\n\n", f"{page}: ../{page}.md\n\n", shown, flags=re.MULTILINE | re.DOTALL)
    return shown


PAGES: dict[str, Callable[[], str]] = {
    "limits": limits_page,
    "topics": topics_page,
    "glossary": glossary.page,
}
"""Name of each page → function that returns its text."""
SPLIT_PAGES = parameters_pages, scenario_pages, messages_pages, executables_pages
"""Functions that return the texts of an index and of its pages."""


def texts() -> dict[str, str]:
    """Return the text of every page, by its path in docs/reference."""
    found = {f"{name}.md": page() for name, page in PAGES.items()}
    for pages in SPLIT_PAGES:
        found |= pages()
    return found


if __name__ == "__main__":
    for name, text in texts().items():
        path = FOLDER / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        sys.stdout.write(f"{path.relative_to(ROOT)}\n")
