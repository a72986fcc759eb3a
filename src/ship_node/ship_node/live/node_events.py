"""What the middleware tells a live node, taken promptly and without letting it pile up.

:class:`NodeEvents` calls back for what happened; the callbacks only put messages into the :class:`Inbox`, where they
wait for the adapter in order of arrival, so many of each topic and no more.
"""

from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription

from ship_bags.live.heartbeat import heartbeat
from ship_bags.stamps import stamp_of_bytes
from ship_node.edge.messages_out import DiagnosticStatus, Level
from ship_node.live.node_clock import WaitingClock
from ship_node.live.node_report import Guard

MOST_EVENTS = 1000
"""Events taken in one go: a flood must not stop the node's own work."""

LONGEST_BEHIND_NS = 1_000_000_000
"""Where an event waits for longer than that, all of them are dropped, ns."""

LARGEST_MESSAGE_BYTES = 65_536
"""An exposure of a thousand stars is smaller. To decode a larger message alone would hold up the node."""

_PULSE_S = 0.2

_AT_ONCE_S = -1e-3
"""Wait for no event: until a moment that is past. Linux lets a thread that waits until now sleep for 50 us and more."""

_WAITED_NS = 200_000
"""An event that is there is taken, and its callback is called, in less than that, ns."""

_SHOWN_NS = 10_000_000_000


class NodeEvents:
    """The events executor of one node.

    The events executor of rclpy takes half the processor time of the single-threaded one, and learns of messages of all
    topics in the order in which they came. But it queues an event for each message, without bound, even where the
    message has been displaced meanwhile. So callbacks must be quick, and where more comes than even they can take, the
    queue is thrown away. How far the node is behind is told by a timer, whose event waits in the queue like all others.

    The middleware tells of each message once. What it told in a queue that is thrown away would stay there, and every
    later message would be taken that many messages late, for ever. So it is taken without an event: the newest message
    of each topic is used, and each request is answered.

    Args:
        context: of the node.
        guard: catches what callbacks raise.
        steady_ns: a clock that never jumps.
    """

    def __init__(self, context: Context, guard: Guard, steady_ns: Callable[[], int]) -> None:
        self._context = context
        self._guard = guard
        self._steady_ns = steady_ns
        self._heartbeat = heartbeat()
        self._event_came = False
        self._dropped_count = 0
        self._dropped_ns = 0
        # A standstill of the node is no sign of too many events.
        self._listening = WaitingClock(steady_ns)
        self._pulse_ns = self._listening.now_ns(0)

    def start(self, node: Node) -> None:
        """From now on call the node's callbacks."""
        self._node = node
        node.create_timer(_PULSE_S, self._pulse, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._listen()

    def _listen(self) -> None:
        self._pulse_ns = self._listening.now_ns(0)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def close(self) -> None:
        """Call no more."""
        self._executor.remove_node(self._node)
        self._executor.shutdown()

    def came(self) -> None:
        """Every callback calls this: another event may wait."""
        self._event_came = True

    def take(self, timeout_s: float) -> bool:
        """Call back for what happened, until nothing is left; wait at most so long for the first.

        Where the first one had to be waited for, no other was there, and none is looked for: that takes 20 us and more.
        The answer is False where something may be left.
        """
        begin_ns = self._steady_ns()
        self._heartbeat.beat(begin_ns)
        may_be_more = self._take_one(timeout_s or _AT_ONCE_S)
        may_be_more &= not timeout_s or self._steady_ns() - begin_ns < _WAITED_NS
        taken = 1
        while may_be_more and taken < MOST_EVENTS:
            may_be_more = self._take_one(_AT_ONCE_S)
            taken += 1
        if self._listening.now_ns(0) - self._pulse_ns > LONGEST_BEHIND_NS + round(_PULSE_S * 1e9):
            self._drop()
        return not may_be_more

    def _take_one(self, timeout_s: float) -> bool:
        """Call back for one event, and wait at most so long for it; returns whether there was one."""
        self._event_came = False
        self._guard.call("executor", self._executor.spin_once, timeout_s)
        return self._event_came

    def status(self) -> DiagnosticStatus:
        """Whether the node can take what comes."""
        if self._dropped_count == 0:
            return DiagnosticStatus("events", Level.OK, "taken as they come")
        recent = self._steady_ns() - self._dropped_ns <= _SHOWN_NS
        text = f"overflow: more came than this node can take; what waited was dropped {self._dropped_count} times"
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

    def _pulse(self) -> None:
        self.came()
        self._pulse_ns = self._listening.now_ns(0)


def _use_newest(subscription: Subscription) -> None:
    """Take what waits on a topic, without an event, and call back for the newest message."""
    newest = None
    # What comes meanwhile is told of by an event.
    for _ in range(subscription.qos_profile.depth):
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            break
        newest = taken
    if newest is not None:
        is_message_alone = subscription._callback_type is Subscription.CallbackType.MessageOnly
        subscription.callback(newest[0] if is_message_alone else newest)


def _answer_all(service: Service) -> None:
    """Answer the requests that wait at a service, without an event."""
    while True:
        request, header = service.handle.service_take_request(service.srv_type.Request)
        if header is None:
            return
        service.send_response(service.callback(request, service.srv_type.Response()), header)


class Arrival(NamedTuple):
    """A message as it came.

    Attributes:
        topic: of the message.
        data: its CDR bytes.
        now_ns: the node's time then; 0 before the first /clock.
        waiting_ns: the time of waiting then; 0 before the first /clock.
        since_ns: from when on it waits, by :meth:`ship_node.live.node_clock.NodeClock.running_ns`; 0: from now on.
        stepped_ns: :attr:`ship_node.live.node_clock.NodeClock.stepped_ns` then.
    """

    topic: str
    data: bytes
    now_ns: int
    waiting_ns: int
    since_ns: int = 0
    stepped_ns: int = 0


class Inbox:
    """A queue per topic, taken from in the order of arrival over all topics.

    Where a queue is full, its oldest message makes room for the newest: the data of a node that does not keep up are
    at most so old, and a flood on one topic displaces nothing of another.

    Where a node is behind (:mod:`ship_node.live.backlog`), all topics are cut to one time: the newest stamp on the
    topic of which most is cut, of those that are not ahead of the node's clock. What comes after that with an earlier
    stamp would be compared with nothing.

    Args:
        depths: topic → messages that may wait.
        lasting: topics whose messages hold until the next one: they are not cut where the node is behind.
    """

    def __init__(self, depths: Mapping[str, int], lasting: Collection[str] = ()) -> None:
        self._depths, self._lasting = depths, lasting
        self._waiting: OrderedDict[int, Arrival] = OrderedDict()
        self._numbers: dict[str, deque[int]] = {topic: deque() for topic in depths}
        self._next_number = 0
        self._cuts: Counter[tuple[str, str]] = Counter()
        self._behind: Counter[str] = Counter()
        self._cut_until_ns: int | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, arrival: Arrival) -> None:
        """Take in what just came, unless it is too large."""
        topic, size = arrival.topic, len(arrival.data)
        if size > LARGEST_MESSAGE_BYTES:
            self._cuts[topic, f"larger than {LARGEST_MESSAGE_BYTES} bytes"] += 1
            return
        if self._cut_until_ns is not None and topic not in self._lasting:
            stamp_ns = stamp_of_bytes(arrival.data)
            if stamp_ns is not None and stamp_ns <= self._cut_until_ns:
                self._behind[topic] += 1
                return
        numbers = self._numbers[topic]
        if len(numbers) == self._depths[topic]:
            del self._waiting[numbers.popleft()]
            self._cuts[topic, f"the oldest of more than {self._depths[topic]} that waited: the node is behind"] += 1
        numbers.append(self._next_number)
        self._waiting[self._next_number] = arrival
        self._next_number += 1

    def take(self) -> Arrival:
        """The message that waits longest, which then waits no more."""
        _, arrival = self._waiting.popitem(last=False)
        self._numbers[arrival.topic].popleft()
        return arrival

    @property
    def since_ns(self) -> int:
        """Time from which on the oldest message waits; 0 where none waits."""
        return next(iter(self._waiting.values())).since_ns if self._waiting else 0

    def cut(self, now_ns: int, waiting_ns: int, since_ns: int) -> None:
        """Cut all that waits, up to one time, because the node is behind.

        Args:
            now_ns: the node's time now, which the messages that are kept get as that of their arrival.
            waiting_ns: the same in the time of waiting.
            since_ns: the same by the clock of waiting times.
        """
        cut = [arrival for arrival in self._waiting.values() if arrival.topic not in self._lasting]
        kept = [arrival for arrival in self._waiting.values() if arrival.topic in self._lasting]
        counts = Counter(arrival.topic for arrival in cut)
        if counts:
            most = counts.most_common(1)[0][0]
            all_ns = [stamp_of_bytes(arrival.data) for arrival in cut if arrival.topic == most]
            stamps_ns = [stamp_ns for stamp_ns in all_ns if stamp_ns is not None]
            # By a stamp ahead of that, good messages would be dropped until its time comes.
            past_ns = [stamp_ns for stamp_ns in stamps_ns if stamp_ns <= now_ns]
            self._cut_until_ns = max(past_ns, default=now_ns if stamps_ns else None)
        self._behind += counts
        self._waiting.clear()
        for numbers in self._numbers.values():
            numbers.clear()
        for arrival in kept:
            self.put(arrival._replace(now_ns=now_ns, waiting_ns=waiting_ns, since_ns=since_ns))

    def take_behind(self) -> Counter[str]:
        """Topic → messages that were cut since the last call because the node is behind."""
        cut, self._behind = self._behind, Counter()
        return cut

    def keeps_up(self) -> None:
        """Take messages with stamps before the last cut again: the node keeps up, or its clock went back."""
        self._cut_until_ns = None

    def take_cuts(self) -> Counter[tuple[str, str]]:
        """(topic, why) → messages that were not kept since the last call."""
        if not self._cuts:
            return self._cuts
        cuts, self._cuts = self._cuts, Counter()
        return cuts
