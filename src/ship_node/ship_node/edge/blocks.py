"""Blocks: the messages of one topic that follow one another and differ in numbers alone, taken together offline.

A message of a block becomes what it becomes by itself, to the last bit; only the work is done for all at once. Where
one is not as the others, the block ends before it, and it is taken by itself.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import CdrRows
from ship_estimation.ins_guard import Followed
from ship_estimation.told_levels import ToldLevels
from ship_geometry.rotations import FloatArray
from ship_node.edge.topics import Published

StampArray = NDArray[np.int64]
"""Stamps, ns."""


class ReadBlock(NamedTuple):
    """What a reader makes of the messages of a block, as far as nothing is to be said of them.

    Attributes:
        samples: what the core takes, with the stamps ``times_ns``, shape (N,), of the messages from the first one on;
            the next one is to be read by itself.
        covariance_known: False where they give no covariance, and the configured sigma stands in.
    """

    samples: Any
    covariance_known: bool = True


class Ahead(Protocol):
    """Samples of a block that a core has judged before their turn.

    Attributes:
        followed: what the guard said of them.
        told: number of a sample, and what its turn led to besides estimates, as far as nobody has asked for it.
    """

    followed: Followed
    told: list[tuple[int, Any]]


SamplesAhead = TypeVar("SamplesAhead", bound=Ahead)


class AheadCore(Protocol[SamplesAhead]):
    """What a core has for samples of a block that it judges before their turn."""

    def look_ahead(self, samples: Any, arrivals_ns: StampArray) -> SamplesAhead | None:
        """Judge samples, from the first one on, as long as they go the usual way; None where the first does not."""
        ...

    def take_ahead(self, ahead: SamplesAhead, stop: int) -> None:
        """Those that go the usual way have their turn, up to one that is not included."""
        ...

    def end_ahead(self, ahead: SamplesAhead) -> Any:
        """All had their turn: the outcome of the last one where that does not go the usual way, or None."""
        ...

    def estimates_ahead(self, ahead: SamplesAhead) -> list[tuple[slice, Any]]:
        """Numbers of samples, and their estimates, which rest on one state, or why they could not be computed."""
        ...


class BlockFeed(NamedTuple):
    """The way of a block of messages into a core, beside that of one message.

    Attributes:
        read: of the messages, and the times at which they come.
        core: takes the samples read.
    """

    read: Callable[[CdrRows, StampArray], ReadBlock]
    core: AheadCore[Any]


class BlockTurn(NamedTuple):
    """Messages of a block that were read and judged ahead, and have their turn among others.

    Attributes:
        topic: of the messages.
        reading: what was read of them.
        receive_ns: when each comes by the node's clock, which is the time of waiting too.
        ahead: what the core knows of them.
    """

    topic: str
    reading: ReadBlock
    receive_ns: StampArray
    ahead: Ahead


class BlockPart(NamedTuple):
    """Some of what the messages of a block lead to.

    Attributes:
        place: number of the message in the block, or of the first one.
        published: messages on their way out, all with that message.
        estimates: outputs of which messages are still to be made, one with each message from there on; None for none.
    """

    place: int
    published: list[Published]
    estimates: Any = None


class PublishedRows(NamedTuple):
    """The messages of one topic that some of N outputs become.

    Attributes:
        topic: the topic.
        messages: in order.
        places: which of the outputs each message is of.
    """

    topic: str
    messages: CdrRows
    places: NDArray[np.int64]


def parts_with_levels(
    place: int,
    run: Any,
    told: ToldLevels,
    checked_by: list[tuple[Any, ...]],
    directions: FloatArray,
    levels_before: Callable[[Any], list[Published]],
) -> Iterator[BlockPart]:
    """A run of outputs, cut where protection levels are told before one of them.

    Args:
        place: of the first one in its block.
        run: N outputs that rest on one state.
        told: the levels told last; ``levels_before`` changes it.
        checked_by: of each output, what decides beside the state whether its sources check one another.
        directions: of each output, shape (N, 3, 3).
        levels_before: the levels of one output, where those told last do not cover it.
    """
    start, count = 0, len(run.time_ns)
    while start < count:
        yield BlockPart(place + start, levels_before(run.one(start)))
        rest = slice(start + 1, count)
        end = start + 1 + told.covered(run.time_ns[rest], run.covariance_n[rest], directions[rest])
        end = next((other for other in range(start + 1, end) if checked_by[other] != told.checked_by), end)
        yield BlockPart(place + start, [], run if end - start == count else run.some(slice(start, end)))
        start = end
