"""``param``: read and set parameters of a running node, without ``ros2 param``."""

import argparse
import sys
from collections.abc import Sequence

from rcl_interfaces.msg import ParameterDescriptor, ParameterValue

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, run_command
from ship_bags.errors import BadInput, one_line
from ship_bringup.remote_node import connect_node, node_command_parser, parse_value, unknown_name_text, value_text
from ship_estimation.parameters.schema import aligned_lines

_DESCRIPTION = """\
Lists the parameters of a running node with values, units and descriptions (* may be changed while it runs); with NAME
it shows one parameter, and with VALUE it sets it. The node itself checks the value and reports why it refuses one.
"""
_EPILOG = "exit code: 0 done; 1 the node refuses the value; 2 bad input or usage, or no such node or parameter"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``param``; return the exit code."""
    parser = node_command_parser("param", "/ship_attitude gate.probability 0.999", _DESCRIPTION, _EPILOG)
    parser.add_argument("name", metavar="NAME", nargs="?", help="dotted name of a parameter")
    parser.add_argument("value", metavar="VALUE", nargs="?", help="new value; a list has commas between elements")
    return run_command(parser, _param, arguments)


def _param(parsed: argparse.Namespace) -> int:
    with connect_node("param", parsed.node, parsed.timeout) as node:
        names = node.parameter_names()
        if parsed.name is not None and parsed.name not in names:
            raise BadInput(f"node {node.name}: {unknown_name_text('parameter', parsed.name, names)}")
        shown = [parsed.name] if parsed.name is not None else names
        rows = list(zip(shown, node.describe_parameters(shown), strict=True))
        if parsed.value is None:
            print("\n".join(aligned_lines([_row(name, *description) for name, description in rows])))
            return EXIT_DONE
        old_value = rows[0][1][1]
        try:
            value = parse_value(parsed.value, old_value)
        except ValueError as problem:
            raise BadInput(f"parameter '{parsed.name}' is {value_text(old_value)}: expected {problem}") from problem
        refusal = node.set_parameter(parsed.name, value)
    if refusal:
        print(f"param: refused: {one_line(refusal)}", file=sys.stderr)
        return EXIT_BOUND_NOT_MET
    print(f"{parsed.name} = {value_text(value)}, was {value_text(old_value)}")
    return EXIT_DONE


def _row(name: str, descriptor: ParameterDescriptor, value: ParameterValue) -> tuple[str, ...]:
    """Return name, value, range, and description with unit, as declared by the node."""
    bounds = [*descriptor.floating_point_range, *descriptor.integer_range]
    allowed = f"[{_bound(bounds[0].from_value)}, {_bound(bounds[0].to_value)}]" if bounds else ""
    live = "" if descriptor.read_only else "*"
    meaning = ": ".join(filter(None, [descriptor.description, descriptor.additional_constraints]))
    return name + live, value_text(value), allowed, meaning


def _bound(value: float) -> str:
    """Return a bound of a range; the largest numbers mean that there is no bound."""
    return ("-inf" if value < 0 else "inf") if abs(value) >= sys.maxsize else f"{value:g}"


if __name__ == "__main__":
    raise SystemExit(main())
