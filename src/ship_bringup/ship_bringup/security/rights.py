"""Rights of each program of a suite (publish, subscribe, serve, request): least privilege, as declared in the code.

An enclave is the identity of one process in SROS2, named by the full name of the process's node. Sensors have an
enclave for each device, named by the first words of the device's topics, for example ``sensors/star_fore``.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import full_name
from ship_bags.topic_names import TRUTH_PREFIX
from ship_estimation.parameters.schema import describe
from ship_node.adapters.adapter import Adapter
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC, DIAGNOSTICS_TYPE, TF_STATIC_TOPIC, TF_TOPIC
from ship_node.parameters.parameter_file import configured_companions, load_config
from ship_replay.offline.adapter_chain import AdapterChain
from ship_watch.published_state import STATE_TOPIC, STATE_TYPE
from ship_watch.topics import MESSAGES, TOPICS, monitored_topic

ALERTS_TOPIC = "ship/alerts"
SENSORS = "sensors"
"""First part of the names of sensors' enclaves, inside the namespace of the suite."""

_CLOCK = "/clock"
_TOPICS_OF_EVERY_NODE = frozenset({"/rosout", "/parameter_events"})
_GET = "list_parameters", "describe_parameters", "get_parameters", "get_parameter_types"
_SET = "set_parameters", "set_parameters_atomically"
_TYPE_DESCRIPTION = "get_type_description"
_KINDS_WITH_ID = "star", "reference", "beacon"
"""First words of topics whose second word is the id of a device."""

_FRAMES = TF_TOPIC, TF_STATIC_TOPIC
"""Topics of frames; a suite in a namespace publishes these topics inside the namespace, not globally."""


@dataclass(frozen=True)
class Rights:
    """Rights of one enclave. All names are full, and may contain ``*`` for any text.

    Attributes:
        enclave: path of the enclave, for example ``/demo/ship_attitude``.
        publishes: topics that the enclave may publish.
        subscribes: topics to which it may subscribe.
        serves: services that it may provide.
        requests: services that it may call.
        declarations: further declarations in the code of the node (types and parameters). They grant nothing, but
            after a change of these declarations a policy is out of date.
        is_needed: True if the enclave must be on this computer, for example the enclave of an estimator.
    """

    enclave: str
    publishes: frozenset[str]
    subscribes: frozenset[str] = frozenset()
    serves: frozenset[str] = frozenset()
    requests: frozenset[str] = frozenset()
    declarations: tuple[str, ...] = field(default=(), repr=False)
    is_needed: bool = False

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the enclave's name, rights and declarations, in hexadecimal."""
        parts = (self.publishes, self.subscribes, self.serves, self.requests, self.declarations)
        text = json.dumps([self.enclave, *map(sorted, parts)])
        return hashlib.sha256(text.encode("utf-8")).hexdigest()


def suite_rights(
    adapters: Sequence[Adapter],
    namespace: str = "",
    is_locked: bool = False,
    is_played: bool = False,
    companions: Mapping[str, Any] = MappingProxyType({}),
    ship_names: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Rights, ...]:
    """Return the rights of all programs of a suite, with the estimators first.

    Args:
        adapters: adapters of the nodes of the suite.
        namespace: namespace of the suite, without its outer slashes; empty for no namespace.
        is_locked: True if no parameter of a running node may be set.
        is_played: True if a bag may be played into the suite (/clock and topics of sensors); False for a voyage.
        companions: result of :func:`load_companions` for the suite file.
        ship_names: names of the inputs on the ship, see :func:`ship_bags.topic_names.ship_names`.
    """
    return tuple(_SuiteRights(adapters, namespace, is_locked, is_played, companions, ship_names).all_rights())


def load_companions(suite_path: Path, namespace: str) -> dict[str, Any]:
    """Return name → configuration of each companion (``nmea_in``, ``nmea_out``) of the estimators in a suite file.

    Raises:
        BadInput: a parameter of a companion is wrong, or its package is not installed.
    """
    found = {}
    for companion in configured_companions(suite_path, namespace):
        name = full_name(companion.node_name, namespace)
        try:
            found[companion.node_name] = load_config(companion.config_type, suite_path, name)
        except ImportError as problem:
            reason = f"section of {name}: package {companion.package} is not installed"
            raise BadInput(reason, file=suite_path) from problem
    return found


def nmea_in_topics(companions: Mapping[str, Any]) -> dict[str, str]:
    """Return relative topic → type of the topics of a suite's ``nmea_in``; empty without ``nmea_in``."""
    config = companions.get("nmea_in")
    topics: dict[str, str] = {}
    if config is not None:
        for id_ in config.sources:
            topics |= config.role(id_).topics(id_)
    return topics


def device_of(topic: str) -> str:
    """Return the device of a topic: ``star_fore`` of ``star/fore/observations``, ``ins`` of ``ins/imu``."""
    first, *others = topic.split("/")
    return f"{first}_{others[0]}" if first in _KINDS_WITH_ID and len(others) > 1 else first


def parameter_services(node: str, names: Iterable[str] = (*_GET, *_SET)) -> frozenset[str]:
    """Return the full names of the parameter services of a node, which is given by its full name."""
    return frozenset(f"{node}/{name}" for name in names)


class _SuiteRights:
    """Rights of one suite; see :func:`suite_rights`."""

    def __init__(
        self,
        adapters: Sequence[Adapter],
        namespace: str,
        is_locked: bool,
        is_played: bool,
        companions: Mapping[str, Any],
        ship_names: Mapping[str, str],
    ) -> None:
        chain = AdapterChain(adapters)
        self._adapters, self._namespace, self._is_locked = chain.adapters, namespace, is_locked
        self._external_inputs = {topic.topic: topic.type_name for topic in chain.inputs}
        self._clock = frozenset({full_name("clock", namespace), _CLOCK}) if is_played else frozenset()
        self._is_played, self._companions, self._ship_names = is_played, companions, ship_names
        given = {topic.topic: topic.type_name for topic in chain.outputs}
        self._types = {**nmea_in_topics(companions), **self._external_inputs, **given}
        self._types |= {ALERTS_TOPIC: MESSAGES + "AlertArray", STATE_TOPIC: STATE_TYPE}
        self._types |= {DIAGNOSTICS_TOPIC: DIAGNOSTICS_TYPE}
        if is_played:
            truth = (row for row in TOPICS if row.pattern.startswith(TRUTH_PREFIX))
            self._types |= {row.pattern: row.type_name for row in truth}
        self._monitored = {name for name, kind in self._types.items() if monitored_topic(name, kind)} - {ALERTS_TOPIC}
        self._alerts = self._full_name("alerts")
        self._nodes = [self._full_name(adapter.node_name) for adapter in self._adapters]

    def all_rights(self) -> Iterator[Rights]:
        for adapter in self._adapters:
            yield self._node_rights(adapter)
        yield from self._companion_rights()
        yield self._alerts_rights()
        everything = self._topics(self._types) | self._inputs(self._external_inputs)
        monitored = self._topics([*self._monitored, ALERTS_TOPIC, STATE_TOPIC, DIAGNOSTICS_TOPIC]) | self._clock
        acknowledge = {f"{self._alerts}/acknowledge"}
        # The monitor also forwards topics to Foxglove.
        yield self._tool_rights("monitor", everything | self._clock, acknowledge, own_nodes=("monitor", "acknowledge"))
        yield self._tool_rights(
            "monitor_terminal", monitored, acknowledge, own_nodes=("monitor_terminal", "acknowledge")
        )
        # The recorder reads the parameters of all nodes, and sets no parameter.
        parameter_reads = {"/*/list_parameters", "/*/get_parameters"}
        yield self._tool_rights("record", everything | self._clock | _TOPICS_OF_EVERY_NODE, parameter_reads)
        yield self._tool_rights("preflight", self._inputs(self._external_inputs))
        yield self._tool_rights("call", (), self._callable_services(), own_nodes=("/call_*",))
        settable = () if self._is_locked else ("set_parameters_atomically",)
        yield self._tool_rights("param", (), self._parameter_services(*_GET, *settable), own_nodes=("/param_*",))
        yield from self._sensor_rights()
        if self._is_played:
            services = {self._full_name(f"play/{name}") for name in ("pause", "resume", "toggle_paused", "play_next")}
            played = self._inputs([*self._external_inputs, *(n for n in self._types if n.startswith(TRUTH_PREFIX))])
            yield self._tool_rights("play", publishes=played | self._clock, serves=services)

    def _node_rights(self, adapter: Adapter) -> Rights:
        name = self._full_name(adapter.node_name)
        types = [f"{each.topic} {each.type_name}" for each in adapter.inputs]
        types += [f"{each.topic} {each.type_name}" for each in adapter.outputs]
        parameters = [f"parameter {parameter.name}" for parameter in describe(adapter.config_type)]
        return Rights(
            enclave=name,
            publishes=self._topics([t.topic for t in adapter.outputs] + [DIAGNOSTICS_TOPIC]) | _TOPICS_OF_EVERY_NODE,
            subscribes=self._inputs(t.topic for t in adapter.inputs) | self._clock,
            serves=frozenset(f"{name}/{service}" for service in adapter.services) | _own_services(name),
            declarations=tuple(sorted([*types, *parameters])),
            is_needed=True,
        )

    def _alerts_rights(self) -> Rights:
        services = {f"{self._alerts}/acknowledge", f"{self._alerts}/silence"}
        return Rights(
            enclave=self._alerts,
            publishes=self._topics([ALERTS_TOPIC, STATE_TOPIC, DIAGNOSTICS_TOPIC]) | _TOPICS_OF_EVERY_NODE,
            subscribes=self._topics([*self._monitored, DIAGNOSTICS_TOPIC]) | self._clock,
            serves=frozenset({*services, f"{self._alerts}_reader/{_TYPE_DESCRIPTION}"}) | _own_services(self._alerts),
        )

    def _companion_rights(self) -> Iterator[Rights]:
        diagnostics = {DIAGNOSTICS_TOPIC}
        if "nmea_out" in self._companions:
            subscribed = self._inputs(["ship/attitude", ALERTS_TOPIC]) | self._clock
            acknowledge = {f"{self._alerts}/acknowledge"}
            yield replace(self._tool_rights("nmea_out", subscribed, acknowledge, diagnostics), is_needed=True)
        if "nmea_in" in self._companions:
            given = {*nmea_in_topics(self._companions), *diagnostics}
            yield replace(self._tool_rights("nmea_in", self._clock, (), self._topics(given)), is_needed=True)

    def _sensor_rights(self) -> Iterator[Rights]:
        """Yield the rights of each device; the node of the driver is expected to have the device's name."""
        # An instrument read by nmea_in has no driver: a certificate for its driver could only be misused.
        with_driver = set(self._external_inputs) - set(nmea_in_topics(self._companions))
        for device in sorted({device_of(topic) for topic in with_driver}):
            topics = self._inputs(topic for topic in with_driver if device_of(topic) == device)
            node = self._full_name(device)
            enclave = self._full_name(f"{SENSORS}/{device}")
            # A node of rclcpp also subscribes to /parameter_events, and does not start without this subscription.
            subscribed = self._clock | {"/parameter_events"}
            yield Rights(enclave, topics | _TOPICS_OF_EVERY_NODE | {DIAGNOSTICS_TOPIC}, subscribed, _own_services(node))

    def _tool_rights(
        self,
        name: str,
        subscribes: Iterable[str] = (),
        requests: Iterable[str] = (),
        publishes: Iterable[str] = (),
        serves: Iterable[str] = (),
        own_nodes: Iterable[str] = (),
    ) -> Rights:
        """Return the rights of a program that is not an estimator, including the rights of its nodes `own_nodes`."""
        own = frozenset[str]().union(*(_own_services(self._full_name(node)) for node in (own_nodes or (name,))))
        return Rights(
            enclave=self._full_name(name),
            publishes=frozenset(publishes) | _TOPICS_OF_EVERY_NODE,
            subscribes=frozenset(subscribes),
            serves=frozenset(serves) | own,
            requests=frozenset(requests),
        )

    def _callable_services(self) -> frozenset[str]:
        """Return the services that users may call with ``call``."""
        own = [
            self._full_name(f"{adapter.node_name}/{name}") for adapter in self._adapters for name in adapter.services
        ]
        return frozenset([*own, f"{self._alerts}/acknowledge", f"{self._alerts}/silence"])

    def _parameter_services(self, *names: str) -> frozenset[str]:
        nodes = [*self._nodes, self._alerts]
        return frozenset[str]().union(*(parameter_services(node, names) for node in nodes))

    def _inputs(self, names: Iterable[str]) -> frozenset[str]:
        """Return topics as the nodes receive them, under the names on the ship if these names differ."""
        return self._topics(self._ship_names.get(name, name) for name in names)

    def _topics(self, names: Iterable[str]) -> frozenset[str]:
        return frozenset(map(self._full_name, names))

    def _full_name(self, name: str) -> str:
        if self._namespace and name in _FRAMES:
            name = name[1:]
        return name if name.startswith("/") else full_name(name, self._namespace)


def _own_services(node: str) -> frozenset[str]:
    """Return the services that rclpy adds to every node, for its parameters and for its types."""
    return parameter_services(node) | {f"{node}/{_TYPE_DESCRIPTION}"}
