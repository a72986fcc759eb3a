"""Run one cell of the return matrix: give its messages, created in memory, to the nodes in a fork of this process.

A run ends when every output has been VALID for :data:`STEADY_S` after the last fault, and no source is excluded,
contradicted or rejected. Otherwise the run ends 5 s after the longest bound of the return times.
"""

import copy
import functools
import gc
import heapq
import json
import os
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S, ns_from_stamp, stamp_fields
from ship_node.adapters.adapter import TICK_PERIOD_NS
from ship_node.messages.common_messages import DIAGNOSTICS_TOPIC
from ship_replay.evaluation.sources import JOINT_SOLUTION, Truth
from ship_replay.offline.replay_summary import INTEGRITY_TOPICS
from ship_simulation.faults.faults import Delivery, apply_faults
from ship_simulation.scenario.fault import Fault
from ship_testing.one_message import process_message
from ship_testing.returns.cells import FIX_TOPIC, START_S, Cell
from ship_testing.returns.voyages import BOUND_S, VOYAGES, Message, VoyageData, load_voyage
from ship_testing.trials.voyage_outputs import VoyageSink

STEADY_S = 15.0
"""Duration of normal state before a run ends, s."""

_AFTER_BOUND_S = 5.0
_AFTER_JUMP_S = 30.0
"""Bound of the return time of ``star/joint/solution`` in a cell with a fault on ``gnss/fix``, s."""

_LONGEST_GAP_NS = 3 * NS_PER_S // 2
"""Longest gap between the messages of an output that still counts as VALID, ns."""

_VALID, _UNAVAILABLE = 0, 2
_WARN = 1
_SOURCE_STATUS_PARTS = ": input ", ": conflict "
"""Parts of the names of diagnostics that report a rejected or contradicted source."""


def run_cell(cell: Cell, path: Path) -> dict[str, Any]:
    """Run a cell over the bag of its voyage; return its result as plain data."""
    is_prepared = cell.starts_s >= START_S and not cell.node_starts_s
    run = _prepared_run(path) if is_prepared else _Run(load_voyage(path))
    return _in_child(lambda: _result(cell, run))


def _in_child(task: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the result of a task in a forked copy of this process, which leaves the nodes here unchanged."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        gc.disable()  # the copy lives for seconds; collecting would visit all messages of all voyages
        try:
            with os.fdopen(writing, "w") as out:
                json.dump(task(), out)
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as given:
        text = given.read()
    os.waitpid(child, 0)
    result: dict[str, Any] = json.loads(text)
    return result


def _result(cell: Cell, run: "_Run") -> dict[str, Any]:
    start_cpu_s = time.process_time()
    result: dict[str, Any] = {
        "voyage": cell.number,
        "cell": cell.name,
        "row": cell.row,
        "unseen": cell.undetectable_reason,
        "exception": "",
    }
    try:
        result |= _evaluate(cell, run)
    except Exception:
        # The matrix looks for such defects of the software: the result records them, and the other cells go on.
        result |= {"exception": traceback.format_exc(limit=-4), "returned": False}
    return result | {"cpu_s": round(time.process_time() - start_cpu_s, 2)}


class ReturnSink(VoyageSink):
    """A :class:`VoyageSink` that also records since when each output has been VALID.

    Args:
        truths: topic of an orientation → its truth.
        outputs: topics of the outputs that must return.
    """

    def __init__(self, truths: dict[str, Any], outputs: Sequence[str]) -> None:
        super().__init__(truths)
        self.valid_since_ns: dict[str, int | None] = dict.fromkeys(outputs)
        self.last_ns = dict.fromkeys(outputs, 0)
        self.states: dict[str, int] = {}
        self.excluded: dict[str, list[str]] = {}
        self.texts: dict[str, str] = {}

    def write(self, topic: str, message: Any, log_time_ns: int) -> None:
        """Record an output."""
        super().write(topic, message, log_time_ns)
        if topic in self.valid_since_ns:
            is_valid = int(message.status) == _VALID
            gap_ns = log_time_ns - self.last_ns[topic]
            if not is_valid:
                self.valid_since_ns[topic] = None
            elif self.valid_since_ns[topic] is None or gap_ns > _LONGEST_GAP_NS:
                self.valid_since_ns[topic] = log_time_ns
            self.last_ns[topic] = log_time_ns
        elif topic in INTEGRITY_TOPICS.values():
            self.states[topic] = int(message.state)
            self.excluded[topic] = list(message.excluded)
        elif topic == DIAGNOSTICS_TOPIC:
            # A message contains all statuses of its nodes; a status that is missing now has ended.
            nodes = {status.name.partition(":")[0] for status in message.status}
            self.texts = {name: text for name, text in self.texts.items() if name.partition(":")[0] not in nodes}
            for status in message.status:
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                if level >= _WARN:
                    self.texts[status.name] = status.message

    def is_recovered(self, since_ns: int, now_ns: int) -> bool:
        """True if all outputs have been VALID since a time, and no source is excluded, contradicted or rejected.

        No integrity state may be UNAVAILABLE.
        """
        return (
            all(
                valid_since_ns is not None
                and valid_since_ns <= since_ns
                and now_ns - self.last_ns[topic] <= _LONGEST_GAP_NS
                for topic, valid_since_ns in self.valid_since_ns.items()
            )
            and not any(self.excluded.values())
            and _UNAVAILABLE not in self.states.values()
            and not any(part in name for name in self.texts for part in _SOURCE_STATUS_PARTS)
        )


class SteppedTruth:
    """The truth of a voyage with steps of the time base: stamps of the new clock are converted to the old one."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self.offset_ns = 0

    def rotation_at_stamp(self, stamp_ns: int) -> Any:
        """Return the true attitude at a stamp; None if there is none."""
        return self._truth.rotation_at_stamp(stamp_ns - self.offset_ns)


def _evaluate(cell: Cell, run: "_Run") -> dict[str, Any]:
    """Run the messages of a cell until all is normal, or the bound is exceeded; return the result of its outputs."""
    data, sink = run.data, run.sink
    bounds_s = {topic: _bound_s(cell, topic) for topic in sink.valid_since_ns}
    consistent_ns = data.time_ns(cell.consistent_from_s)
    end_ns = consistent_ns + round((max(bounds_s.values()) + _AFTER_BOUND_S) * NS_PER_S)
    steady_ns = round(STEADY_S * NS_PER_S)
    run.steps = [(data.time_ns(step.at_s), round(step.step_s * NS_PER_S)) for step in cell.steps]
    first_ns = max(data.time_ns(cell.node_starts_s), run.next_ns)
    now_ns = first_ns
    for message in deliver_messages(cell, data):
        if first_ns <= message.log_ns <= end_ns:
            now_ns = message.log_ns
            run.process(message)
            if now_ns >= consistent_ns + steady_ns and sink.is_recovered(now_ns - steady_ns, now_ns):
                break
    returns_s = {}
    for topic, since_ns in sink.valid_since_ns.items():
        is_there = since_ns is not None and now_ns - sink.last_ns[topic] <= _LONGEST_GAP_NS
        returns_s[topic] = round(max(since_ns - consistent_ns, 0) / NS_PER_S, 2) if is_there else None
    claims = [claim for claim in sink.outputs.valid_outputs if claim.log_ns >= data.time_ns(cell.starts_s)]
    worst = max(claims, key=lambda claim: np.nan_to_num(claim.level_ratio), default=None)
    return {
        "returned": all(time_s is not None and time_s <= bounds_s[topic] for topic, time_s in returns_s.items()),
        "returns_s": returns_s,
        "ran_s": round((now_ns - consistent_ns) / NS_PER_S, 1),
        "worst_over_level": round(float(np.nan_to_num(worst.level_ratio)), 3) if worst else 0.0,
        "worst_at_s": round((worst.log_ns - data.start_ns) / NS_PER_S, 2) if worst else 0.0,
        "failures": sink.outputs.failure_count,
        "excluded": sorted({source for sources in sink.excluded.values() for source in sources}),
        "texts": sink.texts,
    }


def _bound_s(cell: Cell, topic: str) -> float:
    if topic == JOINT_SOLUTION and any(fault.topic == FIX_TOPIC for fault in cell.faults):
        return _AFTER_JUMP_S
    return BOUND_S[topic]


class _Run:
    """The nodes of a voyage; they process messages, and ticks at fixed times between the messages.

    Attributes:
        data: the voyage.
        sink: records the outputs of the nodes.
        steps: (time, size) of the steps of the time base, ns.
        next_ns: time before which all arrived messages have been processed.
    """

    def __init__(self, data: VoyageData) -> None:
        chain = data.chain()
        self.data, self.steps, self.next_ns = data, list[tuple[int, int]](), data.start_ns
        self._adapters = list(zip(chain.adapters, chain.input_topics, strict=True))
        self._truths = {topic: SteppedTruth(truth) for topic, truth in data.truths.items()}
        published = {output.topic for output in chain.outputs}
        self.sink = ReturnSink(self._truths, [topic for topic in BOUND_S if topic in published])
        self._offset_ns = 0
        self._last_ns: int | None = None

    def process(self, message: Message) -> None:
        """Process a message at its arrival, after the ticks that are due by then."""
        log_ns = message.log_ns
        last_ns = log_ns if self._last_ns is None else self._last_ns
        for tick_ns in range((last_ns // TICK_PERIOD_NS + 1) * TICK_PERIOD_NS, log_ns + 1, TICK_PERIOD_NS):
            self._set_clock(tick_ns)
            for adapter, _ in self._adapters:
                self._publish(adapter.tick(tick_ns + self._offset_ns, tick_ns), tick_ns)
        self._last_ns = log_ns
        self._set_clock(log_ns)
        content, step_ns = message.content, self._clock_offset_ns(message.stamp_ns)
        if step_ns:
            content = copy.deepcopy(content)
            stamp = content.header.stamp
            stamp.sec, stamp.nanosec = stamp_fields(ns_from_stamp(stamp) + step_ns)
        for adapter, taken in self._adapters:
            if message.topic in taken:
                published = process_message(adapter, message.topic, content, log_ns + self._offset_ns, log_ns)
                self._publish(published, log_ns)

    def _set_clock(self, time_ns: int) -> None:
        """Step the computer's clock if its offset at ``time_ns`` differs from the present offset."""
        offset_ns = self._clock_offset_ns(time_ns)
        if offset_ns != self._offset_ns:
            step_ns, self._offset_ns = offset_ns - self._offset_ns, offset_ns
            for truth in self._truths.values():
                truth.offset_ns = offset_ns
            for adapter, _ in self._adapters:
                self._publish(adapter.clock_stepped(step_ns, time_ns + offset_ns, time_ns), time_ns)

    def _clock_offset_ns(self, time_ns: int) -> int:
        return sum(step_ns for at_ns, step_ns in self.steps if time_ns >= at_ns)

    def _publish(self, published: Sequence[tuple[str, Any]], log_ns: int) -> None:
        for topic, message in published:
            self.sink.write(topic, message, log_ns)


@functools.lru_cache(maxsize=len(VOYAGES))
def _prepared_run(path: Path) -> _Run:
    """Return the nodes of a voyage, run until ``START_S``; use them only in a forked copy of this process."""
    run = _Run(load_voyage(path))
    run.next_ns = run.data.time_ns(START_S)
    for message in run.data.messages:
        if message.log_ns < run.next_ns:
            run.process(message)
    return run


def deliver_messages(cell: Cell, data: VoyageData) -> Iterator[Message]:
    """Return the messages of a voyage with the faults of a cell, in order of arrival."""
    by_topic: dict[str, dict[str, Fault]] = {}
    for number, fault in enumerate(cell.faults):
        by_topic.setdefault(fault.topic, {})[f"f{number}"] = fault
    streams: list[Iterable[Message]] = [[message for message in data.messages if message.topic not in by_topic]]
    streams += [_faulty_messages(topic, faults, cell.number, data) for topic, faults in by_topic.items()]
    return heapq.merge(*streams, key=lambda message: (message.log_ns, message.order))


def _faulty_messages(topic: str, faults: dict[str, Fault], seed: int, data: VoyageData) -> Iterator[Message]:
    """Return the messages of a topic with its faults."""
    given = _topic_messages(topic, list(faults.values()), data)
    for one in apply_faults(given, data.topics[topic], faults, data.start_ns, seed, data.optics):
        yield Message(topic, one.message, one.stamp_ns or 0, one.log_time_ns, one.order)


def _topic_messages(topic: str, faults: Sequence[Fault], data: VoyageData) -> Iterator[Delivery]:
    """Return the messages of a topic; those that a fault may change are copies."""
    for message in data.messages:
        if message.topic == topic:
            since_s = (message.stamp_ns - data.start_ns) / NS_PER_S
            is_hit = any(fault.start_s <= since_s < fault.end_s for fault in faults)
            content = copy.deepcopy(message.content) if is_hit else message.content
            yield Delivery(content, message.log_ns, message.stamp_ns, message.order)
