"""Contradictions between a suite configuration and a bag's topics: types, frames, gaps, rates and processor load.

The processor load on this computer is estimated from the rates of the inputs. The cost of a message is the processor
time in a live node for receipt, estimation and outputs, measured on one reference computer. The speed of another
computer is measured with a small computation of the same kind. The load is accurate to a factor of about 1.5.
"""

import os
import re
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_bags.topic_names import likely_namespace, remap_advice
from ship_node.adapters.adapter import Adapter
from ship_replay.offline.message_times import MessageTimes, exceeded_limits
from ship_replay.preflight.check_config import INS_TOPIC, BagCheck, CheckedNode

MOST_SHARE = 0.7
"""Share of a core above which a node may fall behind at times."""

_IDLE_SHARE = 0.06
"""Share of a core that a node needs without inputs: ticks, diagnostics."""

_COST_MS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "ship_attitude": (("ins/", 0.7), ("star/", 1.5), ("", 0.6)),
    "star_attitude": (("star/", 2.0), ("", 0.4)),
}
"""Node → prefix of a topic and cost of a message on it, ms; the first matching row counts."""

_OTHER_COST_MS = 0.6
"""Cost of a message of any other node, ms."""

_REFERENCE_S = 14e-6
"""Duration of the test computation on the reference computer, s."""

_MEASURED_S, _SLICES = 0.2, 10

_SENSOR_TOPIC = re.compile(
    r"(?P<group>star|reference)/(?P<name>[^/]+)/(horizon_attitude|inertial_attitude|observations|solution|imu)"
)
_GROUPS = {"star": "star_sensors", "reference": "references"}


@dataclass(frozen=True)
class NodeLoad:
    """Load of one node.

    Attributes:
        node: name of the node.
        share: share of one core of this computer.
        busiest: input with the largest share, with its rate.
    """

    node: str
    share: float
    busiest: str

    @property
    def is_too_much(self) -> bool:
        """True if the node is expected to fall behind at times."""
        return self.share > MOST_SHARE


def node_loads(adapters: Sequence[Adapter], rates_hz: Mapping[str, float], slowness: float) -> list[NodeLoad]:
    """Return the load of each node.

    Args:
        adapters: adapters of the nodes.
        rates_hz: topic → rate of inputs from outside; rates of topics between nodes are derived from these rates.
        slowness: relative slowness of this computer, see :func:`measured_slowness`.
    """
    found = []
    for adapter in adapters:
        rates = {topic.topic: rate for topic in adapter.inputs if (rate := _rate_hz(topic.topic, rates_hz)) > 0.0}
        shares = {topic: rate * _cost_s(adapter.node_name, topic) for topic, rate in rates.items()}
        busiest = max(shares, key=lambda topic: shares[topic], default="")
        text = f"{busiest} at {rates[busiest]:.4g} Hz" if busiest else ""
        found.append(NodeLoad(adapter.node_name, slowness * (_IDLE_SHARE + sum(shares.values())), text))
    return found


def load_text(found: Sequence[NodeLoad]) -> str:
    """Return the loads of the nodes as a line for the user.

    Example:
        >>> load_text([NodeLoad("ship_attitude", 0.142, ""), NodeLoad("star_attitude", 0.093, "")])
        'load: about 14 % of one core for ship_attitude, 9 % for star_attitude'
    """
    first, *others = found
    words = [f"load: about {100.0 * first.share:.0f} % of one core for {first.node}"]
    return ", ".join([*words, *(f"{100.0 * load.share:.0f} % for {load.node}" for load in others)])


def load_warnings(found: Sequence[NodeLoad], cores: int) -> Iterator[str]:
    """Yield a warning for each node, and for all nodes together, if this computer is expected to be too slow.

    Args:
        found: the loads of the nodes.
        cores: processor cores of this computer.

    Example:
        >>> for text in load_warnings([NodeLoad("ship_attitude", 0.84, "imu at 1000 Hz")], cores=1):
        ...     print(text)
        ship_attitude takes about 84 % of one core, limit 70 %: it may fall behind; largest load: imu at 1000 Hz
    """
    for load in found:
        if load.is_too_much:
            yield (
                f"{load.node} takes about {100.0 * load.share:.0f} % of one core, limit {100.0 * MOST_SHARE:.0f} %: "
                f"it may fall behind; largest load: {load.busiest}"
            )
    total = sum(load.share for load in found)
    if len(found) > 1 and total > MOST_SHARE * cores:
        limit = f"limit {100.0 * MOST_SHARE:.0f} % of each"
        yield f"all nodes together take about {100.0 * total:.0f} % of a core, {limit}, and there are {cores}"


def measured_slowness() -> float:
    """Return the computing time of this computer relative to the reference computer; the measurement takes 0.2 s."""
    matrix, times_s = np.eye(21) + 0.01, []
    for _ in range(_SLICES):
        begin_s, count = time.process_time(), 0
        while time.process_time() - begin_s < _MEASURED_S / _SLICES:
            _reference_step(matrix)
            count += 1
        times_s.append((time.process_time() - begin_s) / count)
    # Other programs can only increase the time.
    return min(times_s) / _REFERENCE_S


def _reference_step(matrix: np.ndarray) -> None:
    """Do a computation typical of a filter step: small matrices, and Python around them."""
    known = {str(number): 0.5 * number for number in range(40)}
    matrix = matrix @ (known["2"] * (matrix + matrix.T))
    np.linalg.cholesky(matrix @ matrix.T + np.eye(len(matrix)))


def _cost_s(node: str, topic: str) -> float:
    rows = _COST_MS.get(node, ())
    return 1e-3 * next((cost_ms for begin, cost_ms in rows if topic.startswith(begin)), _OTHER_COST_MS)


def _rate_hz(topic: str, rates_hz: Mapping[str, float]) -> float:
    """Return the rate of a topic; for the output of another node, the rate of the input from which it is computed."""
    if topic in rates_hz:
        return rates_hz[topic]
    made_of = "ins/imu" if topic == "ship/attitude" else topic.replace("/solution", "/observations")
    return rates_hz.get(made_of, 0.0)


def check_bag(check: BagCheck) -> None:
    """Check a configuration against the topics of a bag: presence, type, definition, frame_id, unconfigured sensors."""
    published = {topic.topic for node in check.nodes for topic in node.adapter.outputs}
    _check_presence(check, check.topic_names.keys() | published)
    for node in check.nodes:
        _check_inputs(check, node)
    # A problem of a topic is found for each node that uses the topic, but is reported once.
    check.findings.errors = list(dict.fromkeys(check.findings.errors))
    input_topics = {topic.topic for node in check.nodes for topic in node.adapter.inputs}
    check.findings.warnings += [*_not_configured(check, input_topics | published), *check.bag.problems]


def _check_presence(check: BagCheck, present: Collection[str]) -> None:
    """Report each input that is neither in the bag nor published by a node, with the nodes that use the input.

    Occasional inputs may be missing.
    """
    absent: dict[str, list[tuple[CheckedNode, bool]]] = {}
    for node in check.nodes:
        for topic in node.adapter.inputs:
            if topic.topic not in present and not topic.is_occasional:
                absent.setdefault(topic.topic, []).append((node, topic.required))
    adapters = [node.adapter for node in check.nodes]
    kinds = {topic.topic: topic.type_name for each in adapters for topic in each.outputs}
    kinds |= {topic.topic: topic.type_name for each in adapters for topic in each.inputs}
    for name, takers in absent.items():
        needing = [node.adapter.node_name for node, required in takers if required]
        optional = [node.adapter.node_name for node, required in takers if not required]
        roles = ("needed by", needing), ("optional for", optional)
        whose = ", ".join(f"{role} {' and '.join(names)}" for role, names in roles if names)
        hint = likely_namespace(check.bag.topics, [name])
        similar = remap_advice(name, kinds[name], check.bag.topics, kinds, check.namespace)
        advice = f" (found in namespace '{hint}')" if hint else f" ({similar})" if similar else ""
        place = takers[0][0].place(check.path, _section(name))
        check.report(bool(needing), f"{place}: topic '{name}' is not in {check.bag.path}: {whose}{advice}")


def _check_inputs(check: BagCheck, node: CheckedNode) -> None:
    bag, errors = check.bag, check.findings.errors
    readable: dict[str, str] = {}
    for topic in node.adapter.inputs:
        if topic.topic not in check.topic_names:
            continue
        type_name = bag.topics[check.topic_names[topic.topic]]
        if type_name != topic.type_name:
            place = node.place(check.path, _section(topic.topic))
            errors.append(f"{place}: topic '{topic.topic}' in {bag.path} is {type_name}: expected {topic.type_name}")
            continue
        errors += [f"{bag.path}: topic '{topic.topic}': {line}" for line in bag.differences.get(type_name, [])]
        if type_name not in bag.differences:
            readable[topic.topic] = check.topic_names[topic.topic]
    errors += _frame_errors(check, node, readable)


def _frame_errors(check: BagCheck, node: CheckedNode, readable: dict[str, str]) -> Iterator[str]:
    """Yield an error for each topic whose first message would be rejected because of its frame_id."""
    expected = {topic: _frame_id(node.config, topic) for topic in readable}
    pending = {readable[topic]: topic for topic, frame in expected.items() if frame}
    for record in check.bag.records(pending) if pending else ():
        topic = pending.pop(record.topic, None)
        if topic is not None:
            frame = record.decode().header.frame_id
            if frame != expected[topic]:
                name = f"{_section(topic)}.frame_id"
                yield (
                    f"{node.place(check.path, name)}: parameter '{name}' = '{expected[topic]}', but "
                    f"topic '{topic}' in {check.bag.path} carries frame_id '{frame}'"
                )
        if not pending:
            break


def _frame_id(config: Any, topic: str) -> str:
    """Return the configured frame_id of an input topic; empty if any frame_id is accepted."""
    if topic == INS_TOPIC:
        return str(config.ins.frame_id)
    group, *rest = topic.split("/")
    return str(getattr(config, _GROUPS[group])[rest[0]].frame_id) if group in _GROUPS else ""


def _not_configured(check: BagCheck, known: set[str]) -> Iterator[str]:
    """Yield warnings for sensors in the bag that the configuration does not use."""
    found, where = check.topic_names, check.bag.path
    for topic in sorted(found.keys() - known):
        match = _SENSOR_TOPIC.fullmatch(topic)
        if match is None:
            continue
        name, group = match["name"], _GROUPS[match["group"]]
        if not any(name in getattr(config, group, {}) for config in (node.config for node in check.nodes)):
            yield f"{where}: topic '{topic}' has no {group}.{name} in the configuration: not used"
        elif group == "star_sensors" and not any(t.startswith(f"star/{name}/") for t in known & found.keys()):
            yield f"{where}: topic '{topic}' is not used: star_sensors.{name}.input names another output"


def _section(topic: str) -> str:
    """Return the dotted name of the parameter section of an input topic."""
    group, *rest = topic.split("/")
    return f"{_GROUPS[group]}.{rest[0]}" if group in _GROUPS else group


def check_rates(check: BagCheck) -> None:
    """Compare the gaps between messages of a bag with the parameters, and estimate the load from the rates."""
    input_topics = {topic.topic for node in check.nodes for topic in node.adapter.inputs} & check.topic_names.keys()
    times = {topic: MessageTimes() for topic in input_topics}
    relative_names = {check.topic_names[topic]: topic for topic in input_topics}
    for record in check.bag.records(relative_names) if input_topics else ():
        times[relative_names[record.topic]].add(record)
    for node in check.nodes:
        for excess in exceeded_limits(node.config, times, str(check.bag.path)):
            check.report(excess.is_most_of_the_time, f"{node.place(check.path, excess.limit.parameter)}: {excess.text}")
    rates_hz = {topic: found.arrivals.rate_hz for topic, found in times.items()}
    if any(rates_hz.values()):
        found = node_loads([node.adapter for node in check.nodes], rates_hz, measured_slowness())
        check.findings.notes.append(load_text(found))
        check.findings.warnings += load_warnings(found, len(os.sched_getaffinity(0)))
