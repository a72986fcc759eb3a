"""Blocks: the messages of one topic that follow one another and differ in numbers alone, taken together offline.

A message of a block becomes what it becomes by itself, to the last bit; only the work is done for all at once. Where
one is not as the others, the block ends before it, and it is taken by itself.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import CdrRows
from ship_estimation.outcome import BlockOutcome
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


class BlockFeed(NamedTuple):
    """The way of a block of messages into a core, beside that of one message.

    Attributes:
        read: of the messages and the times at which they came.
        take: the core's method: of the samples read and the times of waiting.
    """

    read: Callable[[CdrRows, StampArray], ReadBlock]
    take: Callable[[Any, StampArray], BlockOutcome]


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
    run: Any,
    told: ToldLevels,
    checked_by: list[tuple[Any, ...]],
    directions: FloatArray,
    levels_before: Callable[[Any], list[Published]],
) -> Iterator[BlockPart]:
    """A run of outputs, cut where protection levels are told before one of them.

    Args:
        run: N outputs that rest on one state.
        told: the levels told last; ``levels_before`` changes it.
        checked_by: of each output, what decides beside the state whether its sources check one another.
        directions: of each output, shape (N, 3, 3).
        levels_before: the levels of one output, where those told last do not cover it.
    """
    variances, count = run.covariance_n.trace(axis1=1, axis2=2), len(run.time_ns)
    start = 0
    while start < count:
        yield BlockPart(start, levels_before(run.one(start)))
        # Asked for each output, and so no more than this; NaN is within no bound.
        covered = (
            (run.time_ns[start:] < told.until_ns)
            & (variances[start:] <= told.greatest_variance)
            & (np.abs(directions[start:] - told.directions).max(axis=(1, 2)) <= told.most_turned)
        )
        covered[0] = True
        end = count if covered.all() else start + int(np.argmin(covered))
        other = next((place for place in range(start, end) if checked_by[place] != told.checked_by), end)
        end = max(other, start + 1)
        yield BlockPart(start, [], run.some(slice(start, end)))
        start = end
