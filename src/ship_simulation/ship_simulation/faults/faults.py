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
from ship_geometry.time_scales import SECOND_NS
from ship_simulation.draws.noise import random_stream
from ship_simulation.faults.optics import Optics
from ship_simulation.faults.values import Spoiler
from ship_simulation.scenario.fault import Fault

_REPETITION_AFTER_NS = 1_000_000
_LONGEST_PERIOD_NS = SECOND_NS

PASSED = object()
"""Marks a time without a message: all further deliveries arrive later. Faults do not affect it."""


@dataclass(slots=True)
class Delivery:
    """A message with its arrival time.

    Attributes:
        message: the message, which may be changed; None if it cannot be decoded.
        log_time_ns: arrival time.
        stamp_ns: its stamp before all faults; None if it has no header.
        order: its place in the bag, the order of equal arrival times.
        data: its original bytes; None once the message has been changed.
    """

    message: Any
    log_time_ns: int
    stamp_ns: int | None
    order: int
    data: bytes | None = None


Deliveries = Iterator[Delivery]


def spoilt(
    deliveries: Deliveries, type_name: str, faults: Mapping[str, Fault], start_ns: int, seed: int, optics: Optics
) -> Deliveries:
    """Return the deliveries of one topic with its faults, in order of arrival.

    Args:
        deliveries: in order of arrival.
        type_name: message type.
        faults: name → fault, of this topic; they are applied in the order of their names.
        start_ns: time from which the faults' times count.
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
            deliveries = _values(deliveries, window, Spoiler(fault, type_name, optics, rng))
    return deliveries


@dataclass(frozen=True)
class _FaultWindow:
    """Selects the messages that a fault affects."""

    fault: Fault
    start_ns: int
    rng: np.random.Generator

    def since_s(self, delivery: Delivery) -> float | None:
        """Return the time from the fault's start to the stamp of an affected message, s; None if it is not affected."""
        if delivery.stamp_ns is None:
            return None
        since_start_s = (delivery.stamp_ns - self.start_ns) / SECOND_NS
        if not self.fault.start_s <= since_start_s < self.fault.end_s:
            return None
        if self.fault.share < 1.0 and self.rng.random() >= self.fault.share:
            return None
        return since_start_s - self.fault.start_s

    def hits(self, delivery: Delivery) -> bool:
        """True if the fault affects a message."""
        return self.since_s(delivery) is not None


class _DeliveryQueue:
    """Deliveries that wait for others that arrive before them."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Delivery]] = []
        self._count = 0

    def put(self, delivery: Delivery) -> None:
        heapq.heappush(self._heap, (delivery.log_time_ns, self._count, delivery))
        self._count += 1

    def ready(self, now_ns: int | None) -> Deliveries:
        """Yield the deliveries that have arrived by a time; None: all."""
        while self._heap and (now_ns is None or self._heap[0][0] <= now_ns):
            yield heapq.heappop(self._heap)[2]


def _values(deliveries: Deliveries, window: _FaultWindow, spoiler: Spoiler) -> Deliveries:
    for delivery in deliveries:
        since_s = window.since_s(delivery)
        if since_s is not None:
            spoiler.spoil(delivery.message, since_s)
            delivery.data = None
        yield delivery


def _drop(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    return (delivery for delivery in deliveries if not window.hits(delivery))


def _delay(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    queue = _DeliveryQueue()
    for delivery in deliveries:
        now_ns = delivery.log_time_ns
        if window.hits(delivery):
            share = window.rng.random() if window.fault.kind == "reorder" else 1.0
            delivery.log_time_ns += round(share * window.fault.delay_s * SECOND_NS)
        queue.put(delivery)
        # Later deliveries arrive later than this one did without the fault.
        yield from queue.ready(now_ns)
    yield from queue.ready(None)


def _duplicate(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    queue = _DeliveryQueue()
    for delivery in deliveries:
        queue.put(delivery)
        if window.hits(delivery):
            queue.put(_again(delivery, delivery.log_time_ns + _REPETITION_AFTER_NS))
        yield from queue.ready(delivery.log_time_ns)
    yield from queue.ready(None)


def _conflict(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    queue = _DeliveryQueue()
    waiting: Delivery | None = None
    for delivery in deliveries:
        if delivery.message is PASSED:
            # The waiting delivery is still pending, so the watermark must not pass it.
            delivery.log_time_ns = delivery.log_time_ns if waiting is None else waiting.log_time_ns
            queue.put(delivery)
        else:
            if waiting is not None:
                queue.put(_with_values(waiting, delivery))
            queue.put(delivery)
            waiting = _again(delivery, delivery.log_time_ns) if window.hits(delivery) else None
        yield from queue.ready(delivery.log_time_ns)
    yield from queue.ready(None)


def _freeze(deliveries: Deliveries, window: _FaultWindow) -> Deliveries:
    frozen_message: Any = None
    for delivery in deliveries:
        if window.hits(delivery):
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
        queue.put(delivery)
        period_ns = 0 if last_ns is None else min(now_ns - last_ns, _LONGEST_PERIOD_NS)
        if window.hits(delivery):
            for number in range(1, window.fault.times):
                other = _again(delivery, now_ns + period_ns * number // window.fault.times)
                back_ns = round(window.rng.random() * window.fault.spread_s * SECOND_NS)
                stamp = other.message.header.stamp
                stamp.sec, stamp.nanosec = stamp_fields((delivery.stamp_ns or 0) - back_ns)
                other.data = None
                queue.put(other)
        last_ns = last_ns if delivery.message is PASSED else now_ns
        yield from queue.ready(now_ns)
    yield from queue.ready(None)


def _again(delivery: Delivery, log_time_ns: int) -> Delivery:
    """Return a copy of the delivery: a further fault may change one and not the other."""
    return replace(delivery, message=copy.deepcopy(delivery.message), log_time_ns=log_time_ns)


def _with_values(delivery: Delivery, other: Delivery) -> Delivery:
    """Return a message with the stamp of one delivery and the values of another, shortly after the first one."""
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
"""Functions of the kinds that change number or arrival time of messages."""
