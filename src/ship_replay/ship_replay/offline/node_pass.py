"""One node's way through the messages and ticks of some time, its inputs in blocks where they go the usual way.

A node is given, moment by moment, what it is given one by one: what the nodes before it published, then the message of
the bag or the tick. Only what does not depend on the others is done for the messages of a block together.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_node.edge.adapter import TICK_PERIOD_NS, Adapter
from ship_node.edge.block_adapter import BlockAdapter
from ship_node.edge.blocks import BlockPart, BlockTurn, PublishedRows, StampArray
from ship_node.edge.deferring_adapter import DeferringAdapter
from ship_node.edge.messages_in import ReadMessage
from ship_node.edge.topics import Published

_PATIENCE = 8
"""Where a message does not go the usual way, so many after it are taken one by one."""


@dataclass(slots=True)
class Moment:
    """A tick, or a message of the bag.

    Attributes:
        now_ns: the time.
        topic: of the message, relative; empty for a tick.
        message: decoded; None for a tick, and where it cannot be decoded.
    """

    now_ns: int
    topic: str = ""
    message: Any = None


class TopicBlock(NamedTuple):
    """The messages of one topic among the moments, all laid out alike.

    Attributes:
        messages: the messages.
        times_ns: when each came, shape (N,).
        places: numbers of their moments, shape (N,).
    """

    messages: CdrRows
    times_ns: StampArray
    places: StampArray


def read_ahead(
    adapter: Adapter, topic: str, messages: CdrRows, times_ns: StampArray
) -> Sequence[ReadMessage[Any] | None]:
    """What a node reads of messages before their turn; None for each that it reads then."""
    if isinstance(adapter, BlockAdapter) and adapter.reads_rows(topic):
        return adapter.read_rows(topic, messages, times_ns)
    return [None] * len(times_ns)


class EstimatesOfMoments(NamedTuple):
    """Estimates, one at each of several moments; ``orders`` are their places among what else was published there."""

    topic: str
    places: StampArray
    orders: StampArray
    estimates: Any


class RowsOfMoments(NamedTuple):
    """The messages of estimates on one topic, and the number of the moment and the order of each."""

    rows: PublishedRows
    places: StampArray
    orders: StampArray


@dataclass
class Passed:
    """What a node published.

    Attributes:
        single: number of the moment, order within it, and messages.
        runs: estimates.
        rows: the messages that these become.
    """

    single: list[tuple[int, int, list[Published]]] = field(default_factory=list)
    runs: list[EstimatesOfMoments] = field(default_factory=list)
    rows: list[RowsOfMoments] = field(default_factory=list)


class NodePass:
    """The way of one node.

    Args:
        adapter: the node.
        taken: topics that it takes.
        moments: in order.
        rows: topic → its messages, of topics that some node may take in blocks; the others are decoded.
        given: number of a moment → what the nodes before it published there, of topics that it takes: messages, and
            what :func:`read_ahead` gave of such.
    """

    def __init__(
        self,
        adapter: Adapter,
        taken: Set[str],
        moments: list[Moment],
        rows: Mapping[str, TopicBlock],
        given: Mapping[int, list[Published]],
    ) -> None:
        self._adapter, self._taken, self._moments, self._given = adapter, taken, moments, given
        self._rows, self._next = rows, dict.fromkeys(rows, 0)
        self._read = {
            topic: read_ahead(adapter, topic, block.messages, block.times_ns)
            for topic, block in rows.items()
            if topic in taken
        }
        # The same node, as one that takes blocks; None where it does not.
        self._ahead = adapter if isinstance(adapter, BlockAdapter) else None
        self._turn: BlockTurn | None = None
        self._turn_places: StampArray = np.empty(0, dtype=np.int64)
        self._arrived = self._patience = self._order = 0
        # The same node, as one whose outputs are put out together, and the moment and the order of each of these.
        self._deferring = adapter if isinstance(adapter, DeferringAdapter) else None
        self._promised: list[tuple[int, int]] = []
        if self._deferring is not None:
            self._deferring.defer()
        self.passed = Passed()

    def run(self) -> Passed:
        """Go through all moments, then make the messages of the estimates."""
        for place, moment in enumerate(self._moments):
            for topic, message in self._given.get(place, ()):
                self._handle(place, topic, message)
            if not moment.topic:
                self._tick(place, moment.now_ns)
            elif moment.topic in self._taken:
                if moment.topic in self._rows:
                    self._arrive(place, moment)
                elif moment.message is not None:
                    self._handle(place, moment.topic, moment.message)
        if self._deferring is not None and self._promised:
            self._publish_promised(self._deferring)
        if self._ahead is not None and self.passed.runs:
            self._make_messages(self._ahead, self.passed.runs)
        return self.passed

    def _make_messages(self, adapter: BlockAdapter, runs: list[EstimatesOfMoments]) -> None:
        places = np.concatenate([run.places for run in runs])
        orders = np.concatenate([run.orders for run in runs])
        for rows in adapter.block_messages([run.estimates for run in runs]):
            self.passed.rows.append(RowsOfMoments(rows, places[rows.places], orders[rows.places]))

    def _tick(self, place: int, now_ns: int) -> None:
        # In the time of a block a tick does nothing for the node itself, or the block would end before it.
        if self._turn is not None and self._ahead is not None and self._ahead.quiet_ticks:
            return
        self._take_arrived()
        self._publish(place, self._adapter.tick(now_ns))

    def _take_arrived(self) -> None:
        """Let the messages of a block that came have their turn, before another input has."""
        if self._turn is not None:
            assert self._ahead is not None
            self._publish_parts(self._ahead.take_ahead(self._turn, self._arrived))

    def _handle(self, place: int, topic: str, message: Any) -> None:
        self._take_arrived()
        now_ns = self._moments[place].now_ns
        if isinstance(message, ReadMessage):
            assert self._ahead is not None
            self._publish(place, self._ahead.handle_read(topic, message, now_ns))
        else:
            self._publish(place, self._adapter.handle(topic, message, now_ns))

    def _arrive(self, place: int, moment: Moment) -> None:
        """A message that stands among rows."""
        number = self._next[moment.topic]
        self._next[moment.topic] += 1
        if self._turn is None and self._ahead is not None and self._ahead.takes_blocks(moment.topic):
            self._turn = self._begin(self._ahead, moment.topic, number)
        if self._ahead is None or self._turn is None or self._turn.topic != moment.topic:
            reading = self._read[moment.topic][number]
            message = self._rows[moment.topic].messages.message(number) if reading is None else reading
            self._handle(place, moment.topic, message)
            return
        self._arrived += 1
        if self._arrived == self._turn.ahead.followed.count:
            turn, self._turn = self._turn, None
            self._publish_parts(self._ahead.take_ahead(turn, self._arrived))
            self._publish_parts(self._ahead.end_ahead(turn))

    def _begin(self, adapter: BlockAdapter, topic: str, number: int) -> BlockTurn | None:
        """Begin a block with a message, where it goes the usual way."""
        if self._patience:
            self._patience -= 1
            return None
        rows, turn = self._rows[topic], None
        # The first tick that is not quiet comes before the message logged with it.
        tick_ns = -(-adapter.quiet_until_ns // TICK_PERIOD_NS) * TICK_PERIOD_NS
        some = slice(number, int(np.searchsorted(rows.times_ns, tick_ns)))
        if some.stop > some.start:
            turn = adapter.look_ahead(topic, rows.messages.some(some), rows.times_ns[some])
        if turn is None:
            self._patience = _PATIENCE
        self._turn_places, self._arrived = rows.places[some], 0
        return turn

    def _publish(self, place: int, published: list[Published]) -> None:
        if published:
            self.passed.single.append((place, self._order, published))
            self._order += 1
        if self._deferring is not None:
            while len(self._promised) < self._deferring.promised:
                self._promised.append((place, self._order))
                self._order += 2  # for what is published before it, and itself

    def _publish_promised(self, adapter: DeferringAdapter) -> None:
        """What the moments of this pass have led to and was put out together."""
        places, orders = np.array(self._promised, dtype=np.int64).T
        for part in adapter.take_parts():
            if part.published:
                self.passed.single.append((int(places[part.place]), int(orders[part.place]), part.published))
            if part.estimates is not None:
                some = slice(part.place, part.place + len(part.estimates.time_ns))
                run = EstimatesOfMoments(adapter.main_topic, places[some], orders[some] + 1, part.estimates)
                self.passed.runs.append(run)

    def _publish_parts(self, parts: list[BlockPart]) -> None:
        assert self._ahead is not None
        for part in parts:
            self._publish(int(self._turn_places[part.place]), part.published)
            if part.estimates is not None:
                places = self._turn_places[part.place : part.place + len(part.estimates.time_ns)]
                orders = np.full(len(places), self._order)
                self.passed.runs.append(EstimatesOfMoments(self._ahead.main_topic, places, orders, part.estimates))
                self._order += 1
