"""Run adapters with messages that are changed, lost or late, and record their outputs.

Shared by the tests of all packages whose nodes are adapters.
"""

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from ship_bags.cdr_template import CdrMessage
from ship_bags.message_factory import RosidlFactory
from ship_bags.stamps import ns_from_stamp
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.time_ordered_log import MOST_REPEATS_PER_S
from ship_node.adapters.adapter import Adapter
from ship_node.live.node_clock import TickGrid
from ship_testing.one_message import process_message

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
FACTORY = RosidlFactory()

Arrivals = tuple["Arrival", ...]


@dataclass(frozen=True)
class Arrival:
    """Message with its time of arrival at the adapter."""

    topic: str
    message: Any
    receive_ns: int

    @property
    def stamp_ns(self) -> int:
        return stamp_of(self.message)


@dataclass
class AdapterRun:
    """Outputs of an adapter for some arrivals: (time of publishing by the timeout clock, topic, message)."""

    adapter: Adapter
    published: list[tuple[int, str, Any]] = field(default_factory=list)
    now_ns: int = 0

    def messages(self, topic: str) -> list[Any]:
        return [message for _, name, message in self.published if name == topic]

    def results(self) -> list[tuple[int, str, Any]]:
        """Return all estimates, bit-exact, without the diagnostics and innovations about inputs."""
        evaluations = "/innovation", "input_health", "/diagnostics"
        return [(ns, topic, exact_value(m)) for ns, topic, m in self.published if not topic.endswith(evaluations)]

    def reasons(self, topic: str) -> dict[str, int]:
        health = self.health(topic)
        return dict(zip(health.reasons, health.reason_counts, strict=True))

    def health(self, topic: str) -> Any:
        return next(m for m in self.adapter.health.messages(FACTORY, self.now_ns) if m.topic == topic)

    def innovations(self, reason: int) -> list[Any]:
        published = [message for _, topic, message in self.published if topic.endswith("/innovation")]
        return [message for message in published if message.reason == reason]

    def diagnostics(self, name: str, since_ns: int, until_ns: int) -> list[tuple[int, str]]:
        """Return (level, text) of one status in all reports of a time span."""
        return [
            (status.level, status.message)
            for ns, topic, report in self.published
            if topic == "/diagnostics" and since_ns <= ns <= until_ns
            for status in report.status
            if status.name == f"{self.adapter.node_name}: {name}"
        ]


def exact_value(value: Any) -> Any:
    """Return a message as tuples of bytes and texts: NaN equals NaN, and 0.0 is not -0.0."""
    if isinstance(value, CdrMessage):
        return value.__cdr__
    if hasattr(value, "get_fields_and_field_types"):
        return tuple(exact_value(getattr(value, name)) for name in value.get_fields_and_field_types())
    if isinstance(value, list):
        return tuple(exact_value(element) for element in value)
    return value if isinstance(value, str) else np.asarray(value).tobytes()


def sort_by_arrival(arrivals: Iterable[Arrival]) -> Arrivals:
    return tuple(sorted(arrivals, key=lambda arrival: arrival.receive_ns))


def stamp_of(message: Any) -> int:
    return ns_from_stamp(message.header.stamp)


def index_at(arrivals: Arrivals, topic: str, since_s: float) -> int:
    """Return the index of the first arrival of a topic stamped this long after the start."""
    limit_ns = START_NS + round(since_s * SECOND_NS)
    return next(i for i, a in enumerate(arrivals) if a.topic == topic and a.stamp_ns >= limit_ns)


def without(arrivals: Arrivals, index: int) -> Arrivals:
    return (*arrivals[:index], *arrivals[index + 1 :])


def replace_message(
    arrivals: Arrivals, index: int, change: Callable[[Any], None], receive_ns: int | None = None
) -> Arrivals:
    """Return the arrivals with one message changed, at another time of arrival if given."""
    return sort_by_arrival((*without(arrivals, index), changed_copy(arrivals[index], change, receive_ns)))


def add_copy(arrivals: Arrivals, index: int, change: Callable[[Any], None], receive_ns: int) -> Arrivals:
    """Return the arrivals with an additional, changed copy of one message."""
    return sort_by_arrival((*arrivals, changed_copy(arrivals[index], change, receive_ns)))


def changed_copy(arrival: Arrival, change: Callable[[Any], None], receive_ns: int | None = None) -> Arrival:
    message = copy.deepcopy(arrival.message)
    change(message)
    return replace(arrival, message=message, receive_ns=arrival.receive_ns if receive_ns is None else receive_ns)


def change_where(
    arrivals: Iterable[Arrival], is_chosen: Callable[[Arrival], bool], change: Callable[[Any], None]
) -> Arrivals:
    """Return the arrivals with all chosen messages changed."""
    return tuple(changed_copy(a, change) if is_chosen(a) else a for a in arrivals)


def delay_arrivals(arrivals: Arrivals, delays_s: np.ndarray) -> Arrivals:
    """Return the arrivals, each received at its stamp plus its delay."""
    return sort_by_arrival(
        replace(a, receive_ns=a.stamp_ns + round(delay_s * SECOND_NS))
        for a, delay_s in zip(arrivals, delays_s.tolist(), strict=True)
    )


def flood_topic(arrivals: Arrivals, topic: str, factor: int, up_to_s: float, seed: int = 1) -> Arrivals:
    """Return the arrivals, and ``factor - 1`` copies of each arrival of ``topic`` with random earlier stamps."""
    rng = np.random.default_rng(seed)

    def set_earlier_stamp(message: Any) -> None:
        ns = stamp_of(message) - int(rng.uniform(0.0, up_to_s * SECOND_NS))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, SECOND_NS)

    more = [changed_copy(a, set_earlier_stamp) for a in arrivals if a.topic == topic for _ in range(factor - 1)]
    return sort_by_arrival([*arrivals, *more])


def without_rejected(arrivals: Arrivals, topic: str, innovations: Iterable[Any]) -> Arrivals:
    """Return the arrivals without the messages of ``topic`` whose stamps are the stamps of ``innovations``."""
    rejected_ns = {stamp_of(message) for message in innovations}
    return tuple(a for a in arrivals if a.topic != topic or a.stamp_ns not in rejected_ns)


def assert_flood_costs_little(
    monkeypatch: pytest.MonkeyPatch,
    core: type,
    drive: Callable[[Arrivals], AdapterRun],
    arrivals: Arrivals,
    topic: str,
    source: str,
    other_measurements: int = 0,
) -> None:
    """Assert that a topic with 50 times its measurements causes few steps, and that results without the rejected
    measurements are equal.

    Args:
        monkeypatch: counts the steps.
        core: class whose ``_step`` is counted.
        drive: runs some arrivals through a new adapter.
        arrivals: arrivals without the flood.
        topic: flooded topic.
        source: name of the topic's source in innovations.
        other_measurements: number of other measurements that cause steps.
    """
    steps, step = [0], core._step  # type: ignore[attr-defined]

    def count_steps(*arguments: Any) -> Any:
        steps[0] += 1
        return step(*arguments)

    monkeypatch.setattr(core, "_step", count_steps)
    flood = flood_topic(arrivals, topic, 50, up_to_s=1.9)
    run = drive(flood)
    overflow = run.innovations(Reason.OVERFLOW)
    assert {message.source for message in overflow} == {source}
    received = run.health(topic).received
    assert run.reasons(topic)["overflow"] == len(overflow) > 0.4 * received
    lasts_s = (arrivals[-1].receive_ns - arrivals[0].receive_ns) / SECOND_NS + 3.0
    assert steps[0] < 2 * (received - len(overflow) + other_measurements) + MOST_REPEATS_PER_S * lasts_s
    assert drive(without_rejected(flood, topic, overflow)).results() == run.results()


def hand_over(
    run: AdapterRun, arrivals: Iterable[Arrival], until_ns: int = 0, node_ns: Callable[[int], int] = lambda ns: ns
) -> None:
    """Give the arrivals to a run's adapter, with the ticks between them as in node and replay; then continue the ticks.

    Arrival times are by the timeout clock; ``node_ns`` converts them to the node's clock.
    """
    grid = TickGrid()
    for arrival in arrivals:
        waiting_ns = arrival.receive_ns
        _tick(run, grid, waiting_ns, node_ns)
        published = process_message(run.adapter, arrival.topic, arrival.message, node_ns(waiting_ns), waiting_ns)
        run.published += [(waiting_ns, *item) for item in published]
    _tick(run, grid, max(until_ns, run.now_ns), node_ns)


def _tick(run: AdapterRun, grid: TickGrid, waiting_ns: int, node_ns: Callable[[int], int]) -> None:
    for tick_ns in grid.ticks_until(waiting_ns):
        run.published += [(tick_ns, *item) for item in run.adapter.tick(node_ns(tick_ns), tick_ns)]
    run.now_ns = waiting_ns
