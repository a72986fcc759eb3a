"""Configuration dataclass as parameters of an rclpy node: declared with unit and range, changed live."""

import re
import sys
import typing
from collections.abc import Callable, Iterable
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import (
    BLACK_BOX_PARAMETER,
    BLACK_BOX_PART_PARAMETER,
    RELIABLE_INPUTS_PARAMETER,
    is_runtime_parameter,
)
from ship_bags.topic_names import TOPICS_PARAMETER, topic_map
from ship_estimation.parameters.schema import (
    ParameterDescription,
    ParameterError,
    build,
    describe,
    flatten,
    nest,
    with_changes,
)
from ship_estimation.rejection_rules import shorten
from ship_node.live.adapter_calls import AdapterCalls
from ship_node.live.node_report import NodeLog
from ship_node.messages.common_messages import DiagnosticStatus, Level

USE_SIM_TIME = "use_sim_time"

_BLACK_BOX_DOC = "file (.mcap) or folder for all inputs and outputs of the node; empty if there is none"
_BLACK_BOX_PART_DOC = "size at which the black box continues in a new file [MB]; 0 for never"
BLACK_BOX_PART_MB = 1000
_BYTES_PER_MB = 1_000_000
_RELIABLE_INPUTS_DOC = "inputs are reliable: lost messages are sent again, and newer ones wait for them"

_LISTS = {(str,): Parameter.Type.STRING_ARRAY, (float,): Parameter.Type.DOUBLE_ARRAY}
"""Parameter type of a list by the type of its elements."""

_LEAST_INTEGER, _GREATEST_INTEGER = -(2**63), 2**63 - 1


class ParameterNode(Node):
    """Node that passes every live change of parameters through one function.

    A parameter callback would not suffice, because rclpy does not call it for a change that rclpy refuses (range, type,
    read-only, unknown name). Such a refusal must be logged and recorded, too.

    Attributes:
        change: function that processes a request; its second argument is rclpy's method for the request. If the
            function is None, only rclpy's method is called.
    """

    change: Callable[[list[Parameter], Callable[..., SetParametersResult]], SetParametersResult] | None = None

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Apply or refuse all parameters of a request; rclpy's services call this."""
        apply = super().set_parameters_atomically
        return apply(parameter_list) if self.change is None else self.change(parameter_list, apply)


class NodeParameters:
    """Parameters of one node.

    Attributes:
        config: the current configuration.
        black_box: path of the node's black box; empty if there is none.
        black_box_part_bytes: size at which a black box continues in a new file; 0 for never.
        has_reliable_inputs: True if messages lost on the way to the node are sent again.
        topics: the suite's name of an input → the ship's name, as given by the parameters ``topics``.

    Args:
        node: node without declared parameters of the suite.
        config_type: a dataclass in the style of :mod:`ship_estimation.parameters.schema`.
        has_black_box: True if the node can write a black box; otherwise the parameters of the black box are ignored.

    Raises:
        ParameterError: an override is unknown, of the wrong type, out of its range or missing.
        InputError: a parameter of the node runtime has a wrong type or value.
    """

    def __init__(self, node: ParameterNode, config_type: type, has_black_box: bool = True) -> None:
        self._node, self._log = node, NodeLog(node)
        self.config: Any = build(config_type, nest(_overrides(node)))
        self._at_start = flatten(self.config)
        self._last_refusal = ""
        self.black_box = str(_declare_common(node, BLACK_BOX_PARAMETER, "", _BLACK_BOX_DOC)) if has_black_box else ""
        self.black_box_part_bytes = _declare_part_size(node) * _BYTES_PER_MB if has_black_box else 0
        self.has_reliable_inputs = bool(_declare_common(node, RELIABLE_INPUTS_PARAMETER, False, _RELIABLE_INPUTS_DOC))
        overrides = node._parameter_overrides
        self.topics = topic_map({name: parameter.value for name, parameter in overrides.items()})
        for name in self.topics:
            _declare_common(node, f"{TOPICS_PARAMETER}.{name}", "", f"the ship's name of the topic {name}")
        self._descriptions = _descriptions(flatten(self.config), config_type)
        for name, value in flatten(self.config).items():
            # The value already includes the override, converted to a float where the file has an integer.
            _declare(node, name, value, self._descriptions[name])

    def connect_adapter(
        self, calls: AdapterCalls, now_ns: Callable[[], int], before_change: Callable[[], None]
    ) -> None:
        """Pass live changes to the adapter from now on; a change is refused if the adapter raises.

        Args:
            calls: calls of the adapter.
            now_ns: returns the node's time.
            before_change: called before each change, to process the messages received earlier.
        """
        self._calls = calls
        self._now_ns = now_ns
        self._before_change = before_change
        self._node.add_on_set_parameters_callback(self._apply)
        self._node.change = self._change

    def status(self) -> DiagnosticStatus:
        """Return the status with the parameters changed since the start and the last refusal."""
        now = flatten(self.config)
        changed = {name: f"{now[name]}, {was} at the start" for name, was in self._at_start.items() if now[name] != was}
        lines = [f"{name} = {change}" for name, change in changed.items()]
        text = f"changed: {'; '.join(lines)}" if lines else "as at the start"
        return DiagnosticStatus("parameters", Level.OK, text + self._last_refusal, changed)

    def _change(
        self, parameters: list[Parameter], apply: Callable[[list[Parameter]], SetParametersResult]
    ) -> SetParametersResult:
        """Apply a request, or refuse it with a reason for log, diagnostics and black box."""
        self._before_change()
        parameters = [self._with_list_type(parameter) for parameter in parameters]
        requested = {p.name: _as_plain_value(p.value) for p in parameters}
        self._was_adapter_called = False
        try:
            if isinstance(requested.get(USE_SIM_TIME), bool):
                # The node times before and after the change would be years apart.
                reason = "cannot be changed while the node runs: set it at the start"
                raise ParameterError(f"parameter '{USE_SIM_TIME}' {reason}", USE_SIM_TIME)
            # The suite's own check comes first: its text contains the unit.
            own = {name: value for name, value in requested.items() if not self._is_runtime_parameter(name)}
            with_changes(self.config, own)
            result = apply(parameters)
        except (ParameterError, ParameterNotDeclaredException) as error:
            result = SetParametersResult(successful=False, reason=str(error))
        result.reason = shorten(result.reason)
        if not result.successful:
            self._last_refusal = f"; last refusal: {result.reason}"
            self._log.warning(f"refused: {result.reason}")
            if not self._was_adapter_called:
                self._calls.record_refusal(requested, result.reason, self._now_ns())
        return result

    def _with_list_type(self, parameter: Parameter) -> Parameter:
        """Return the parameter; an empty list gets its element type, which a request does not contain."""
        description = self._descriptions.get(parameter.name)
        if description is None or _as_plain_value(parameter.value) != []:
            return parameter
        kind = _LISTS.get(typing.get_args(description.kind)[:1])
        return parameter if kind is None else Parameter(parameter.name, kind, [])

    def _is_runtime_parameter(self, name: str) -> bool:
        return name not in self._descriptions and self._node.has_parameter(name)

    def _apply(self, parameters: list[Parameter]) -> SetParametersResult:
        changes = {p.name: _as_plain_value(p.value) for p in parameters if p.name in self._descriptions}
        if not changes:
            return SetParametersResult(successful=True)
        before = flatten(self.config)
        config: Any = with_changes(self.config, changes)
        self._was_adapter_called = True
        try:
            self._calls.set_parameters({name: flatten(config)[name] for name in changes}, self._now_ns())
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:
            return SetParametersResult(successful=False, reason=f"not changed: {type(error).__name__}: {error}")
        self.config = config
        for name, value in changes.items():
            unit = self._descriptions[name].unit
            self._log.info(f"parameter {name} = {value} {unit}".rstrip() + f", was {before[name]}")
        return SetParametersResult(successful=True)


def _overrides(node: Node) -> dict[str, Any]:
    """Return dotted name → value of the configuration's parameters in parameter files and on the command line.

    Before the declaration, rclpy has no public method for these values. For an empty list, as ``ros2 param dump``
    writes it, rcl keeps the name without a value.
    """
    given = {name: p for name, p in node._parameter_overrides.items() if not is_runtime_parameter(name)}
    return {name: [] if p.value is None else _as_plain_value(p.value) for name, p in given.items()}


def _declare_common(node: Node, name: str, default: Any, description: str) -> Any:
    """Declare a read-only parameter of the node runtime; return its value."""
    descriptor = ParameterDescriptor(description=description, read_only=True)
    try:
        return node.declare_parameter(name, default, descriptor).value
    except InvalidParameterTypeException as error:
        reason = f"parameter '{name}' must be of type {type(default).__name__}: {error}"
        raise BadInput(reason, parameters=(name,)) from error


def _declare_part_size(node: Node) -> int:
    name = BLACK_BOX_PART_PARAMETER
    value = int(_declare_common(node, name, BLACK_BOX_PART_MB, _BLACK_BOX_PART_DOC))
    if value < 0:
        raise BadInput(f"parameter '{name}' = {value}: expected 0 MB or more", parameters=(name,), value=value)
    return value


def _declare(node: Node, name: str, value: Any, description: ParameterDescription) -> None:
    descriptor = _descriptor(description)
    kind = _LISTS.get(typing.get_args(description.kind)[:1]) if value == [] else None
    if kind is None:
        node.declare_parameter(name, value, descriptor, ignore_override=True)
        return
    # rclpy would declare an empty list permanently as a list of bytes.
    node.declare_parameter(name, kind, ignore_override=True)
    node.set_parameters([Parameter(name, kind, value)])
    descriptor.type = kind.value
    node.set_descriptor(name, descriptor)


def _as_plain_value(value: Any) -> Any:
    """Return a value, with an array converted to a list."""
    return value if value is None or isinstance(value, (bool, int, float, str)) else list(value)


def _descriptions(names: Iterable[str], config_type: type) -> dict[str, ParameterDescription]:
    """Return the description of each dotted name; ``<id>`` in a description stands for any one part of a name."""
    described = {description.name: description for description in describe(config_type)}
    patterns = {
        re.compile(re.escape(name).replace("<id>", r"[^.]+")): description
        for name, description in described.items()
        if "<id>" in name
    }
    found = {}
    for name in names:
        fitting = (description for pattern, description in patterns.items() if pattern.fullmatch(name))
        description = described.get(name) or next(fitting, None)
        if description is None:
            raise ParameterError(f"parameter '{name}' has no description", name)
        found[name] = description
    return found


def _descriptor(description: ParameterDescription) -> ParameterDescriptor:
    low, high = description.minimum, description.maximum
    descriptor = ParameterDescriptor(
        description=f"{description.doc} [{description.unit}]" if description.unit else description.doc,
        read_only=not description.live,
    )
    if description.choices:
        descriptor.additional_constraints = "one of " + ", ".join(description.choices)
    if description.kind is float and (low is not None or high is not None):
        limit = sys.float_info.max
        bounds = FloatingPointRange(
            from_value=-limit if low is None else float(low), to_value=limit if high is None else float(high), step=0.0
        )
        descriptor.floating_point_range = [bounds]
    if description.kind is int and (low is not None or high is not None):
        bounds = IntegerRange(
            from_value=_LEAST_INTEGER if low is None else int(low),
            to_value=_GREATEST_INTEGER if high is None else int(high),
            step=0,
        )
        descriptor.integer_range = [bounds]
    return descriptor
