"""Faults between the devices and the bag: one implementation for scenarios and for existing bags.

The messages of a topic pass through its faults one after another, in order of arrival.
:mod:`ship_simulation.scenario.fault` lists the kinds. Each fault draws from a random stream of its own, selected by its
name.
"""

import copy
import heapq
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_bags.stamps import stamp_fields
from ship_geometry.earth.time_scales import SECOND_NS
from ship_simulation.faults.device_geometry import SuiteOptics
from ship_simulation.faults.values import ValueFault
from ship_simulation.random_draws import random_stream
from ship_simulation.scenario.fault import Fault

_REPETITION_AFTER_NS = 1_000_000
_LONGEST_PERIOD_NS = SECOND_NS

WATERMARK = object()
"""Message of a delivery that only marks a time: all further deliveries arrive after this time. Faults do not affect
such a delivery."""


@dataclass(slots=True)
class Delivery:
    """A message with its arrival time.

    Attributes:
        message: the message, which may be changed; None if it cannot be decoded.
        log_time_ns: arrival time.
        stamp_ns: stamp of the message before all faults; None if the message has no header.
        order: position of the message in the bag, which orders equal arrival times.
        data: original bytes of the message; None once the message has been changed.
    """

    message: Any
    log_time_ns: int
    stamp_ns: int | None
    order: int
    data: bytes | None = None


Deliveries = Iterator[Delivery]


def apply_faults(
    deliveries: Deliveries, type_name: str, faults: Mapping[str, Fault], start_ns: int, seed: int, optics: SuiteOptics
) -> Deliveries:
    """Return the deliveries of one topic with its faults, in order of arrival.

    Args:
        deliveries: messages of the topic in order of arrival.
        type_name: message type.
        faults: name → fault of this topic. The faults are applied in the order of their names.
        start_ns: time zero of the times of the faults.
        seed: seed of the faults' draws.
        optics: cameras of the devices.
    """
    for name, fault in sorted(faults.items()):
        rng = random_stream(seed, f"fault.{name}")
        window = _FaultWindow(fault, start_ns, rng)
        stream = _STREAMS.get(fault.kind)
        if stream is not None:
            deliveries = stream(deliveries, window)
        else:
            deliveries = _apply_to_values(deliveries, window, ValueFault(fault, type_name, optics, rng))
    return deliveries


@dataclass(frozen=True)
class _FaultWindow:
    """Selects the messages that a fault affects."""

    fault: Fault
    start_ns: int
    rng: np.random.Generator

    def elapsed_s(self, delivery: Delivery) -> float | None:
        """Return the time from the fault's start to the stamp of an affected message, s; None if it is not affected.

        If the fault affects a share of the messages, each call draws a random number. Call this method only once per
        message.
        """
        if delivery.stamp_ns is None:
            return None
        since_start_s = (delivery.stamp_ns - self.start_ns) / SECOND_NS
        if not self.fault.start_s <= since_start_s < self.fault.end_s:
            return None
        if self.fault.share < 1.0 and self.rng.random() >= self.fault.share:
            return None
        return since_start_s - self.fault.start_s

    def is_hit(self, delivery: Delivery) -> bool:
        """True if the fault affects a message. Call this method only once per message, like :meth:`elapsed_s`."""
        return self.elapsed_s(delivery) is not None


class _DeliveryQueue:
    """Deliveries that wait until all earlier arrivals are known."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Delivery]] = []
        self._count = 0

    def push(self, delivery: Delivery) -> None:
        heapq.heappush(self._heap, (delivery.log_time_ns, self._count, delivery))
        self._count += 1

    def pop_until(self, now_ns: int | None) -> Deliveries:
        """Yield the deliveries that have arrived by a time; all deliveries for None."""
        while self._heap and (now_ns is None or self._heap[0][0] <= now_ns):
            yield heapq.heappop(self._heap)[2]


def _apply_to_values(deliveries: Deliveries, window: _FaultWindow, spoiler: ValueFault) -> Deliveries:
    for delivery in deliveries:
        since_s = window.elapsed_s(delivery)
        if since_s is not None:
            spoiler.apply(delivery.message, since_s)
            delivery.data = None
        yield delivery


def _drop(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    return (delivery for delivery in deliveries if not window.is_hit(delivery))


def _delay(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    queue = _DeliveryQueue()
    for delivery in deliveries:
        now_ns = delivery.log_time_ns
        if window.is_hit(delivery):
            share = window.rng.random() if window.fault.kind == "reorder" else 1.0
            delivery.log_time_ns += round(share * window.fault.delay_s * SECOND_NS)
        queue.push(delivery)
        # All later deliveries arrive after the original arrival time of this delivery.
        yield from queue.pop_until(now_ns)
    yield from queue.pop_until(None)


def _duplicate(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    queue = _DeliveryQueue()
    for delivery in deliveries:
        queue.push(delivery)
        if window.is_hit(delivery):
            queue.push(_repeat(delivery, delivery.log_time_ns + _REPETITION_AFTER_NS))
        yield from queue.pop_until(delivery.log_time_ns)
    yield from queue.pop_until(None)


def _conflict(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    queue = _DeliveryQueue()
    waiting: Delivery | None = None
    for delivery in deliveries:
        if delivery.message is WATERMARK:
            # The waiting delivery is still pending, so the watermark must not pass it.
            delivery.log_time_ns = delivery.log_time_ns if waiting is None else waiting.log_time_ns
            queue.push(delivery)
        else:
            if waiting is not None:
                queue.push(_copy_with_values(waiting, delivery))
            queue.push(delivery)
            waiting = _repeat(delivery, delivery.log_time_ns) if window.is_hit(delivery) else None
        yield from queue.pop_until(delivery.log_time_ns)
    yield from queue.pop_until(None)


def _freeze(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    frozen_message: Any = None
    for delivery in deliveries:
        if window.is_hit(delivery):
            if frozen_message is None:
                frozen_message = copy.deepcopy(delivery.message)
            else:
                frozen = copy.deepcopy(frozen_message)
                frozen.header = delivery.message.header
                delivery.message, delivery.data = frozen, None
        yield delivery


def _flood(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    queue = _DeliveryQueue()
    last_ns: int | None = None
    for delivery in deliveries:
        now_ns = delivery.log_time_ns
        queue.push(delivery)
        period_ns = 0 if last_ns is None else min(now_ns - last_ns, _LONGEST_PERIOD_NS)
        if window.is_hit(delivery):
            for number in range(1, window.fault.times):
                other = _repeat(delivery, now_ns + period_ns * number // window.fault.times)
                back_ns = round(window.rng.random() * window.fault.spread_s * SECOND_NS)
                stamp = other.message.header.stamp
                stamp.sec, stamp.nanosec = stamp_fields((delivery.stamp_ns or 0) - back_ns)
                other.data = None
                queue.push(other)
        last_ns = last_ns if delivery.message is WATERMARK else now_ns
        yield from queue.pop_until(now_ns)
    yield from queue.pop_until(None)


def _repeat(delivery: Delivery, log_time_ns: int) -> Delivery:
    """Return a copy of the delivery, whose message a further fault may change independently."""
    return replace(delivery, message=copy.deepcopy(delivery.message), log_time_ns=log_time_ns)


def _copy_with_values(delivery: Delivery, other: Delivery) -> Delivery:
    """Return a message with the stamp of ``delivery`` and the values of ``other``, arriving 1 ms after ``delivery``."""
    message = copy.deepcopy(other.message)
    message.header = delivery.message.header
    return replace(delivery, message=message, log_time_ns=delivery.log_time_ns + _REPETITION_AFTER_NS, data=None)


_STREAMS: dict[str, Callable[[Deliveries, _FaultWindow], Deliveries]] = {
    "drop": _drop,
    "delay": _delay,
    "reorder": _delay,
    "duplicate": _duplicate,
    "conflict": _conflict,
    "freeze": _freeze,
    "flood": _flood,
}
"""Kind → function, for the kinds that do more than change the values of single messages."""
