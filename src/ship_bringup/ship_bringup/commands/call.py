"""``call``: call a service of a running node, without ``ros2 service call``."""

import argparse
from collections.abc import Sequence
from typing import Any

from std_srvs.srv import Trigger

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, run_command
from ship_bags.errors import BadInput, one_line
from ship_bringup.remote_node import connect_node, node_command_parser, unknown_name_text
from ship_msgs.srv import AcknowledgeAlert

_DESCRIPTION = """\
Calls a service of a running node and prints the response: save_alignment, reset, pause and similar (std_srvs/Trigger),
and acknowledge of the alerts, which needs the alert's id and instance. Without SERVICE it lists the node's services.
"""
_EPILOG = "exit code: 0 done; 1 the node reports that it was not done; 2 bad input or usage, or no such node"
_KINDS: dict[str, Any] = {"std_srvs/srv/Trigger": Trigger, "ship_msgs/srv/AcknowledgeAlert": AcknowledgeAlert}
"""Types of services that nodes of the suite have."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``call``; return the exit code."""
    parser = node_command_parser("call", "/ship_attitude save_alignment", _DESCRIPTION, _EPILOG)
    parser.add_argument("service", metavar="SERVICE", nargs="?", help="name of the service, without the node's name")
    parser.add_argument(
        "fields", metavar="FIELD=VALUE", nargs="*", default=[], help="fields of the request: id=ins.out instance=1"
    )
    return run_command(parser, _call, arguments)


def _call(parsed: argparse.Namespace) -> int:
    with connect_node("call", parsed.node, parsed.timeout) as node:
        services = {name: kind for name, kind in node.services().items() if kind in _KINDS}
        if parsed.service is None:
            for name, kind in sorted(services.items()):
                print(" ".join([name, *(f"{field}=<{type_}>" for field, type_ in _fields(kind).items())]))
            return EXIT_DONE
        if parsed.service not in services:
            raise BadInput(f"node {node.name}: {unknown_name_text('service', parsed.service, services)}")
        kind = services[parsed.service]
        answer = node.call(parsed.service, _KINDS[kind], **_request(parsed.service, kind, parsed.fields))
    done = bool(getattr(answer, "success", True))
    print(f"{'done' if done else 'not done'}: {one_line(getattr(answer, 'message', ''))}")
    return EXIT_DONE if done else EXIT_BOUND_NOT_MET


def _fields(kind: str) -> dict[str, str]:
    return dict(_KINDS[kind].Request.get_fields_and_field_types())


def _request(service: str, kind: str, given: Sequence[str]) -> dict[str, Any]:
    """Return the fields of a request.

    Raises:
        BadInput: a field is missing, unknown or not of its type.
    """
    wanted, values = _fields(kind), {}
    for text in given:
        name, separator, value = text.partition("=")
        if not separator or name not in wanted:
            expected = ", ".join(f"{field}=<{type_}>" for field, type_ in wanted.items()) or "no fields"
            raise BadInput(f"service '{service}' takes {expected}, not '{text}'")
        try:
            values[name] = int(value) if "int" in wanted[name] else value
        except ValueError as problem:
            raise BadInput(f"field '{name}' of service '{service}': '{value}' is no {wanted[name]}") from problem
    missing = [f"{name}=<{type_}>" for name, type_ in wanted.items() if name not in values]
    if missing:
        raise BadInput(f"service '{service}' needs {', '.join(missing)}")
    return values


if __name__ == "__main__":
    raise SystemExit(main())
