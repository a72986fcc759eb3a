"""Events of a live node, the bounded queues of its messages, and the detection of overload.

:class:`NodeEvents` runs the callbacks without delay. The callbacks only add messages to the :class:`Inbox`. There a
bounded number of messages of each topic waits for the adapter in order of arrival.

:class:`Backlog` detects when a node is behind its inputs, and when it keeps up again. The queue time of a message is
the time from its arrival to its use. The queue time is measured by the running clock: a steady clock or, with
``use_sim_time``, /clock, so that a bag played too fast is detected as well. After a short standstill of the node,
messages have waited long but are processed at once, so the node is not behind. A node is behind if queue times stay
long while the node is working, or if a queue time exceeds :data:`MAX_QUEUE_TIME_NS`.
"""

import enum
import os
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription

from ship_bags.live.ros_process import heartbeat
from ship_bags.stamps import stamp_of_bytes
from ship_node.adapters.adapter import Overload
from ship_node.live.node_clock import TimeoutClock
from ship_node.live.node_report import ExceptionGuard
from ship_node.messages.common_messages import DiagnosticStatus, Level

MAX_EVENTS = 1000
"""Maximum number of events processed at once, so that a flood does not stop the node's own work."""

MAX_BEHIND_NS = 1_000_000_000
"""Time of an event in the queue above which all queued events are dropped, ns."""

MAX_MESSAGE_BYTES = 65_536
"""Maximum size of a message: an exposure of 1000 stars is smaller, and decoding a larger message takes too long."""

_PULSE_S = 0.2

_NO_WAIT_S = -1e-3
"""Timeout without any wait, s; negative, because with a timeout of zero the thread sleeps for at least 50 us."""

_WAITED_NS = 200_000
"""Time that suffices to take an existing event and run its callback, ns."""

_SHOWN_NS = 10_000_000_000

LONG_QUEUE_TIME_NS = 1_000_000_000
"""Queue time that counts as long, ns.

The sum of this time and :data:`BEHIND_AFTER_NS` does not exceed the default ``lag_s``. So the next node
does not reject as late the outputs of a node that is not behind."""

BEHIND_AFTER_NS = 1_000_000_000
"""Working time, without standstills, for which queue times may stay long before the node is behind, ns."""

MAX_QUEUE_TIME_NS = 3_000_000_000
"""Queue time above which a node is behind at once, ns."""

SHORT_QUEUE_TIME_NS = 200_000_000
"""Maximum queue time in a node that keeps up, ns: twice the longest wait for an event.

If /clock runs faster than real time, queue times are divided by its rate before the comparison."""

RECOVERED_AFTER_NS = 1_000_000_000
"""Steady time with short queue times after which a node keeps up again, ns."""


class NodeEvents:
    """Events executor of one node.

    The events executor of rclpy needs half the processor time of the single-threaded one, and reports messages of all
    topics in the order of arrival. But the events executor queues an event for each message without a bound, even if
    the message was overwritten meanwhile. Therefore callbacks must be quick. If a timer's event nevertheless waits in
    the queue for too long, the queue is dropped.

    The middleware reports each message once. A message whose event was dropped would stay in the middleware's queue and
    delay every later message. Therefore after a drop all waiting messages are taken without events. The newest message
    of each topic is used, and each service request is answered.

    Args:
        context: context of the node.
        guard: catches exceptions of callbacks.
        steady_ns: a steady clock, ns.
    """

    def __init__(self, context: Context, guard: ExceptionGuard, steady_ns: Callable[[], int]) -> None:
        self._context = context
        self._guard = guard
        self._steady_ns = steady_ns
        self._heartbeat = heartbeat()
        self._has_event = False
        self._dropped_count = 0
        self._dropped_ns = 0
        # A standstill of the node must not count as time in the queue.
        self._listening = TimeoutClock(steady_ns)
        self._pulse_ns = self._listening.now_ns(0)

    def start(self, node: Node) -> None:
        """Start calling the node's callbacks."""
        self._node = node
        node.create_timer(_PULSE_S, self._note_pulse, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._listen()

    def _listen(self) -> None:
        self._pulse_ns = self._listening.now_ns(0)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def close(self) -> None:
        """Stop calling callbacks."""
        self._executor.remove_node(self._node)
        self._executor.shutdown()

    def note_event(self) -> None:
        """Record that a callback ran, so that another event may wait; every callback calls this."""
        self._has_event = True

    def process_events(self, timeout_s: float) -> bool:
        """Process the waiting events; wait for the first event no longer than ``timeout_s``.

        If the call had to wait for the first event, no other event was queued. The call then ends without a search for
        another event, which would take at least 20 us. If an event has waited too long, the queue is dropped.

        Returns:
            False if events may be left.
        """
        begin_ns = self._steady_ns()
        self._heartbeat.beat(begin_ns)
        may_be_more = self._process_one(timeout_s or _NO_WAIT_S)
        may_be_more &= not timeout_s or self._steady_ns() - begin_ns < _WAITED_NS
        taken = 1
        while may_be_more and taken < MAX_EVENTS:
            may_be_more = self._process_one(_NO_WAIT_S)
            taken += 1
        if self._listening.now_ns(0) - self._pulse_ns > MAX_BEHIND_NS + round(_PULSE_S * 1e9):
            self._drop()
        return not may_be_more

    def _process_one(self, timeout_s: float) -> bool:
        """Process one event, waiting no longer than ``timeout_s``; return True if there was an event."""
        self._has_event = False
        self._guard.call("executor", self._executor.spin_once, timeout_s)
        return self._has_event

    def status(self) -> DiagnosticStatus:
        """Return the status of the event queue."""
        if self._dropped_count == 0:
            return DiagnosticStatus("events", Level.OK, "processed as they arrive")
        recent = self._steady_ns() - self._dropped_ns <= _SHOWN_NS
        text = f"overflow: too many events for this node; the queue was dropped {self._dropped_count} times"
        return DiagnosticStatus("events", Level.ERROR if recent else Level.WARN, text)

    def _drop(self) -> None:
        self._dropped_count += 1
        self._dropped_ns = self._steady_ns()
        self.close()
        for subscription in self._node.subscriptions:
            self._guard.call(subscription.topic, _use_newest, subscription)
        for service in self._node.services:
            self._guard.call(service.srv_name, _answer_all, service)
        self._listen()

    def _note_pulse(self) -> None:
        self.note_event()
        self._pulse_ns = self._listening.now_ns(0)


def _use_newest(subscription: Subscription) -> None:
    """Take the waiting messages of a topic without an event, and process the newest one."""
    newest = None
    # Messages that arrive meanwhile have their own events.
    for _ in range(subscription.qos_profile.depth):
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            break
        newest = taken
    if newest is not None:
        is_message_alone = subscription._callback_type is Subscription.CallbackType.MessageOnly
        subscription.callback(newest[0] if is_message_alone else newest)


def _answer_all(service: Service) -> None:
    """Answer the waiting requests of a service without an event."""
    while True:
        request, header = service.handle.service_take_request(service.srv_type.Request)
        if header is None:
            return
        service.send_response(service.callback(request, service.srv_type.Response()), header)


class WaitingMessage(NamedTuple):
    """Received message.

    Attributes:
        topic: topic of the message.
        data: CDR bytes of the message.
        now_ns: receive time by the node's clock; 0 before the first /clock.
        waiting_ns: receive time by the timeout clock; 0 before the first /clock.
        queued_ns: start of the queue time by the running clock
            (:meth:`ship_node.live.node_clock.NodeClock.running_ns`); 0 if unknown, so that the queue time counts as 0.
        stepped_ns: :attr:`ship_node.live.node_clock.NodeClock.stepped_ns` at reception.
    """

    topic: str
    data: bytes
    now_ns: int
    waiting_ns: int
    queued_ns: int = 0
    stepped_ns: int = 0


class Inbox:
    """Bounded queue per topic, processed in order of arrival over all topics.

    If a queue is full, its oldest message is dropped for the newest. The bound limits the age of the data in a node
    that is behind. A flood on one topic displaces no message of another topic.

    If a node is behind, all waiting messages are dropped. Messages that arrive later are dropped as well if their
    stamp is not after the cut time, because their counterparts of other topics are gone. The cut time is the newest
    stamp on the topic with most dropped messages; stamps ahead of the node's clock do not count.

    Args:
        depths: topic → maximum number of waiting messages.
        valid_until_next: topics whose messages are valid until the next one; these messages are not dropped if the node
            is behind.
    """

    def __init__(self, depths: Mapping[str, int], valid_until_next: Collection[str] = ()) -> None:
        self._depths, self._valid_until_next = depths, valid_until_next
        self._waiting: OrderedDict[int, WaitingMessage] = OrderedDict()
        self._numbers: dict[str, deque[int]] = {topic: deque() for topic in depths}
        self._next_number = 0
        self._cuts: Counter[tuple[str, str]] = Counter()
        self._overload_cuts: Counter[str] = Counter()
        self._cut_until_ns: int | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, message: WaitingMessage) -> None:
        """Add a received message, unless it is too large or its stamp is not after the cut time.

        If the queue of its topic is full, the oldest message there is dropped.
        """
        topic, size = message.topic, len(message.data)
        if size > MAX_MESSAGE_BYTES:
            self._cuts[topic, f"larger than {MAX_MESSAGE_BYTES} bytes"] += 1
            return
        if self._cut_until_ns is not None and topic not in self._valid_until_next:
            stamp_ns = stamp_of_bytes(message.data)
            if stamp_ns is not None and stamp_ns <= self._cut_until_ns:
                self._overload_cuts[topic] += 1
                return
        numbers = self._numbers[topic]
        if len(numbers) == self._depths[topic]:
            del self._waiting[numbers.popleft()]
            self._cuts[topic, f"the oldest of more than {self._depths[topic]} that waited: the node is behind"] += 1
        numbers.append(self._next_number)
        self._waiting[self._next_number] = message
        self._next_number += 1

    def take(self) -> WaitingMessage:
        """Remove and return the oldest message."""
        _, message = self._waiting.popitem(last=False)
        self._numbers[message.topic].popleft()
        return message

    @property
    def oldest_queued_ns(self) -> int:
        """Start of the queue time of the oldest message; 0 if no message waits."""
        return next(iter(self._waiting.values())).queued_ns if self._waiting else 0

    def cut_all(self, now_ns: int, waiting_ns: int, since_ns: int) -> None:
        """Drop waiting messages, except of the topics in ``valid_until_next``, and set the cut time.

        Args:
            now_ns: the node's current time; the remaining messages get the three times given here.
            waiting_ns: current time by the timeout clock.
            since_ns: current time by the running clock.
        """
        removed = [message for message in self._waiting.values() if message.topic not in self._valid_until_next]
        kept = [message for message in self._waiting.values() if message.topic in self._valid_until_next]
        counts = Counter(message.topic for message in removed)
        if counts:
            most = counts.most_common(1)[0][0]
            all_ns = [stamp_of_bytes(message.data) for message in removed if message.topic == most]
            stamps_ns = [stamp_ns for stamp_ns in all_ns if stamp_ns is not None]
            # With a cut time in the future, good messages would be dropped until then.
            past_ns = [stamp_ns for stamp_ns in stamps_ns if stamp_ns <= now_ns]
            self._cut_until_ns = max(past_ns, default=now_ns if stamps_ns else None)
        self._overload_cuts += counts
        self._waiting.clear()
        for numbers in self._numbers.values():
            numbers.clear()
        for message in kept:
            self.add(message._replace(now_ns=now_ns, waiting_ns=waiting_ns, queued_ns=since_ns))

    def take_overload_cuts(self) -> Counter[str]:
        """Return topic → number of messages dropped since the last call because the node is behind."""
        cut, self._overload_cuts = self._overload_cuts, Counter()
        return cut

    def resume(self) -> None:
        """Accept stamps before the cut time again, because the node keeps up or its clock went back."""
        self._cut_until_ns = None

    def take_cuts(self) -> Counter[tuple[str, str]]:
        """Return (topic, reason) → number of messages dropped since the last call for their size or a full queue."""
        if not self._cuts:
            return self._cuts
        cuts, self._cuts = self._cuts, Counter()
        return cuts


class OverloadChange(enum.Enum):
    """Change of the overload state."""

    NONE = enum.auto()
    BEHIND = enum.auto()
    """The node is behind; its waiting messages must be dropped."""
    KEEPS_UP = enum.auto()


class Backlog:
    """Overload detector based on the queue time of a node's oldest message.

    Args:
        steady_ns: a steady clock, ns.

    Attributes:
        is_behind: True from the detection of an overload until the node keeps up again.
    """

    def __init__(self, steady_ns: Callable[[], int]) -> None:
        self._steady_ns = steady_ns
        self.is_behind = False
        self._last_long_ns = self._last_long_running_ns = 0
        self.restart()

    def restart(self) -> None:
        """Reset the working time, because the running clock went back."""
        self._running_ns = 0
        self._worked = TimeoutClock(lambda: self._running_ns)
        self._last_short_ns: int | None = None

    def evaluate(self, waited_ns: int, running_ns: int) -> OverloadChange:
        """Return the change of the overload state; BEHIND also if a node that is behind must drop messages again.

        Args:
            waited_ns: queue time of the oldest message; 0 if no message waits.
            running_ns: current time by the running clock.
        """
        self._running_ns = running_ns
        worked_ns = self._worked.now_ns(0)
        if waited_ns < LONG_QUEUE_TIME_NS or self._last_short_ns is None:
            self._last_short_ns = worked_ns
        if waited_ns > MAX_QUEUE_TIME_NS or worked_ns - self._last_short_ns > BEHIND_AFTER_NS:
            self._last_short_ns = worked_ns
            self._last_long_ns, self._last_long_running_ns = self._steady_ns(), running_ns
            self.is_behind = True
            return OverloadChange.BEHIND
        if not self.is_behind:
            return OverloadChange.NONE
        steady_ns = self._steady_ns()
        since_long_ns = steady_ns - self._last_long_ns
        # The queue time is divided by the rate of /clock since the last long queue time, at least 1; the comparison
        # needs no division.
        if waited_ns * since_long_ns > SHORT_QUEUE_TIME_NS * max(
            since_long_ns, running_ns - self._last_long_running_ns
        ):
            self._last_long_ns, self._last_long_running_ns, since_long_ns = steady_ns, running_ns, 0
        if since_long_ns < RECOVERED_AFTER_NS:
            return OverloadChange.NONE
        self.is_behind = False
        return OverloadChange.KEEPS_UP


def current_overload(behind_ns: int, cut: Mapping[str, int]) -> Overload:
    """Return the overload state of a node, with the current load of the computer."""
    return Overload(behind_ns * 1e-9, len(os.sched_getaffinity(0)), os.getloadavg()[0], dict(cut))
