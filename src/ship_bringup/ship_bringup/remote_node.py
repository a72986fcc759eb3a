"""Client of a running node: find it by name, call its services, read and set its parameters."""

import argparse
import contextlib
import difflib
import os
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

from ship_bags.command_line import CommandParser
from ship_bags.errors import BadInput
from ship_bags.live.ros_process import command_node, positive_number
from ship_bags.parameter_yaml import full_name

_POLL_S = 0.05
_MAX_LISTED = 12
"""Number of known names above which an error text gives only a similar name; without a similar name, all are listed."""
_TIMEOUT_S = 5.0

_NOTHING = "[]"
"""Text of an empty list."""


def node_command_parser(prog: str, example: str, description: str, epilog: str) -> CommandParser:
    """Return the parser of a command for a node, with the arguments ``node`` and ``timeout``.

    Args:
        prog: name of the command.
        example: example of its arguments.
        description: description of the command.
        epilog: exit codes of the command.
    """
    parser = CommandParser(
        package="ship_bringup",
        prog=prog,
        example=example,
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("node", metavar="NODE", help="name of the node, with its namespace: /demo/ship_attitude")
    parser.add_argument(
        "--timeout",
        type=positive_number,
        default=_TIMEOUT_S,
        metavar="S",
        help=f"timeout of a response, s ({_TIMEOUT_S:g})",
    )
    return parser


@contextlib.contextmanager
def connect_node(own_name: str, name: str, timeout_s: float) -> Iterator["RemoteNode"]:
    """Yield a node of the network, accessed through our own node, which ends with the ``with`` statement.

    Args:
        own_name: name of our node.
        name: see :class:`RemoteNode`.
        timeout_s: see :class:`RemoteNode`.

    Raises:
        BadInput: see :class:`RemoteNode`.
    """
    # The process id makes the name unique among commands that run at the same time.
    with command_node(f"{own_name}_{os.getpid()}", []) as own_node:
        executor = SingleThreadedExecutor()
        executor.add_node(own_node)
        try:
            yield RemoteNode(own_node, name, timeout_s, lambda seconds: executor.spin_once(timeout_sec=seconds))
        finally:
            executor.shutdown()


class RemoteNode:
    """A node of the network.

    Attributes:
        name: name of the node, with its namespace.

    Args:
        own_node: our own node, which calls the services.
        name: name of the node, with its namespace if it is in a namespace.
        timeout_s: timeout for the discovery of the node and for each of its responses, s.
        wait: handles callbacks of the own node for at most the given number of seconds.

    Raises:
        BadInput: there is no such node; the text contains the nearest name, or the existing nodes, or both.
    """

    def __init__(self, own_node: Node, name: str, timeout_s: float, wait: Callable[[float], None]) -> None:
        self._own_node, self._timeout_s, self._wait = own_node, timeout_s, wait
        self._namespace, _, self._bare_name = ("/" + name.strip("/")).rpartition("/")
        self.name = full_name(self._bare_name, self._namespace)
        if not self._wait_until(lambda: self.name in self._node_names()):
            others = sorted(self._node_names() - {full_name(own_node.get_name(), own_node.get_namespace())})
            raise BadInput(unknown_name_text("node", self.name, others))
        # The services of a discovered node may be discovered later.
        self._wait_until(lambda: bool(self.services()))

    def services(self) -> dict[str, str]:
        """Return the types of the node's services by service name, without the services that ROS adds to every node."""
        found = self._own_node.get_service_names_and_types_by_node(self._bare_name, self._namespace or "/")
        own = {name.removeprefix(f"{self.name}/"): types[0] for name, types in found}
        return {name: kind for name, kind in own.items() if not kind.startswith(("rcl_", "type_description"))}

    def call(self, service: str, kind: Any, **fields: Any) -> Any:
        """Return the response of a service.

        Args:
            service: name of the service, without the node's name.
            kind: class of the service's type.
            fields: fields of the request.

        Raises:
            BadInput: the service does not exist, or does not respond within the timeout.
        """
        client = self._own_node.create_client(kind, f"{self.name}/{service}")
        if not self._wait_until(client.service_is_ready):
            raise BadInput(f"node {self.name} has no service '{service}', or is ending")
        answer: Future = client.call_async(kind.Request(**fields))
        if not self._wait_until(answer.done):
            raise BadInput(f"{self.name}/{service} did not respond within {self._timeout_s:g} s")
        return answer.result()

    def parameter_names(self) -> list[str]:
        """Return the names of the node's parameters, sorted."""
        answer: ListParameters.Response = self.call("list_parameters", ListParameters)
        return sorted(answer.result.names)

    def describe_parameters(self, names: Sequence[str]) -> list[tuple[ParameterDescriptor, ParameterValue]]:
        """Return description and value of some parameters."""
        descriptions: DescribeParameters.Response = self.call(
            "describe_parameters", DescribeParameters, names=list(names)
        )
        values: GetParameters.Response = self.call(
            "get_parameters", GetParameters, names=list(names)
        )
        return list(zip(descriptions.descriptors, values.values, strict=True))

    def set_parameter(self, name: str, value: ParameterValue) -> str:
        """Set a parameter; return why the value was refused, empty if it was accepted."""
        answer: SetParametersAtomically.Response = self.call(
            "set_parameters_atomically",
            SetParametersAtomically,
            parameters=[Parameter(name=name, value=value)],
        )
        return "" if answer.result.successful else str(answer.result.reason)

    def _node_names(self) -> set[str]:
        return {full_name(name, namespace) for name, namespace in self._own_node.get_node_names_and_namespaces()}

    def _wait_until(self, condition: Callable[[], bool]) -> bool:
        deadline_s = time.monotonic() + self._timeout_s
        while not condition():
            if time.monotonic() >= deadline_s:
                return False
            self._wait(_POLL_S)
        return True


def unknown_name_text(kind: str, name: str, known: Collection[str]) -> str:
    """Return the error text for an unknown name, with the nearest name, the existing names or both."""
    bare = {each.rpartition("/")[2]: each for each in known}
    nearest = difflib.get_close_matches(name, known, 1) or [
        bare[each] for each in difflib.get_close_matches(name.rpartition("/")[2], bare, 1)
    ]
    if nearest and len(known) > _MAX_LISTED:
        return f"no {kind} '{name}': did you mean '{nearest[0]}'?"
    meant = f"did you mean '{nearest[0]}'? There are" if nearest else "there are"
    return f"no {kind} '{name}': {meant} {', '.join(sorted(known)) or 'none'}"


def parse_value(text: str, like: ParameterValue) -> ParameterValue:
    """Return a value with the type of another value. Lists are comma-separated; an empty list is [] or an empty text.

    Raises:
        ValueError: the text is not a value of this type, or this type cannot be set. The error text contains what was
            expected.
    """
    kind, value = like.type, ParameterValue(type=like.type)
    if kind == ParameterType.PARAMETER_BOOL:
        value.bool_value = _parse_bool(text)
    elif kind == ParameterType.PARAMETER_INTEGER:
        value.integer_value = _parse_number(int, text, "a whole number")
    elif kind == ParameterType.PARAMETER_DOUBLE:
        value.double_value = _parse_number(float, text, "a number")
    elif kind == ParameterType.PARAMETER_STRING:
        value.string_value = text
    elif kind == ParameterType.PARAMETER_DOUBLE_ARRAY:
        value.double_array_value = [
            _parse_number(float, part, "numbers with commas between") for part in _list_parts(text)
        ]
    elif kind == ParameterType.PARAMETER_STRING_ARRAY:
        value.string_array_value = _list_parts(text)
    else:
        raise ValueError("a value that this command can set: number, text, true or false")
    return value


def value_text(value: ParameterValue) -> str:
    """Return a value as text in the notation of :func:`parse_value`; an empty text is shown as ``''``."""
    plain = parameter_value_to_python(value)
    if isinstance(plain, bool):
        return str(plain).lower()
    if isinstance(plain, str):
        return plain or "''"
    if plain is None or isinstance(plain, (int, float)):
        return str(plain)
    return ",".join(str(part) for part in plain) or _NOTHING


def _list_parts(text: str) -> list[str]:
    return [] if text in ("", _NOTHING) else text.split(",")


def _parse_bool(text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise ValueError("true or false")
    return text.lower() == "true"


def _parse_number(kind: type, text: str, expected: str) -> Any:
    try:
        return kind(text)
    except ValueError as problem:
        raise ValueError(expected) from problem
