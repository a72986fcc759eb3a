"""Writes docs/reference: every parameter of every node, from the dataclasses that the nodes themselves use."""

import sys
from pathlib import Path

from ship_attitude_star.ros.ship_attitude_adapter import ShipAttitudeAdapter
from ship_attitude_star.ros.star_attitude_adapter import StarAttitudeAdapter
from ship_estimation.parameters import ParameterDescription, describe
from theodolite_calib.ros.optical_axis_adapter import OpticalAxisAdapter

ADAPTERS = (ShipAttitudeAdapter, StarAttitudeAdapter, OpticalAxisAdapter)
PAGE = Path(__file__).parents[1] / "docs" / "reference" / "parameters.md"
HEAD = """# Parameters

Units are in the names. `<id>` stands for the id of a star sensor or of a beacon, or the name of a reference: naming it
declares it. A parameter marked *live* may be changed while the node runs (`ros2 param set`); the others are read at the
start. An unknown parameter, or one out of its range, stops the node at the start and is refused later, each time with
the reason.

A parameter file holds a section for each node. `/**/ship_attitude:` is for the node of that name in every namespace,
`/**:` for all nodes; `ship_attitude:` alone fits the node without a namespace and no other. A file in which no section
fits the node, but one has (nearly) its name, ends the node at the start with both names; a file about other nodes is a
warning. `check_config` and `replay` judge names in the same way.

Every node has `black_box` besides: a file (`.mcap`) or folder that takes everything the node uses and gives, in that
order; `replay BOX.mcap --verify` runs it again to the last bit. A file that is there is kept: the next box is
`BOX_2.mcap`.

This page is written by `python tools/reference_pages.py`; a test compares it with the code.
"""


def page() -> str:
    """The whole page."""
    text = HEAD
    for adapter in ADAPTERS:
        text += f"\n## `{adapter.node_name}`\n\n| parameter | default | unit | allowed | |\n|---|---|---|---|---|\n"
        text += "".join(_row(parameter) for parameter in describe(adapter.config_type))
    return text


def _row(parameter: ParameterDescription) -> str:
    given = "" if parameter.default == "" else f"`{parameter.default}`"
    default = "must be given" if parameter.default is None else given
    live = " *live*" if parameter.live else ""
    return f"| `{parameter.name}` | {default} | {parameter.unit} | {_allowed(parameter)} | {parameter.doc}{live} |\n"


def _allowed(parameter: ParameterDescription) -> str:
    if parameter.choices:
        return ", ".join(f"`{choice}`" for choice in parameter.choices)
    if parameter.minimum is None and parameter.maximum is None:
        return ""
    low = "" if parameter.minimum is None else f"{parameter.minimum:.12g}"
    high = "" if parameter.maximum is None else f"{parameter.maximum:.12g}"
    return f"{low} … {high}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE.relative_to(PAGE.parents[2])} written\n")
