"""Batches of consecutive messages of one topic that differ only in numbers, for processing together offline.

Each message gives bit for bit the same result as when it is processed alone. A message that differs in more than
numbers ends the batch and is processed alone.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ship_bags.cdr_template import CdrRows
from ship_estimation.integrity.published_levels import PublishedLevels
from ship_estimation.plausibility.checked_ins import CheckedBlock
from ship_geometry.rotations import FloatArray
from ship_node.messages.topics import OutputMessage

StampArray = NDArray[np.int64]
"""Stamps, ns."""


class ReadBatch(NamedTuple):
    """Leading messages of a batch that were read and passed all checks.

    Attributes:
        samples: input of the core, with the stamps ``times_ns``, shape (N,). The message after the last sample must be
            read alone.
        covariance_known: False if the messages give no covariance; the configured sigma is used then.
    """

    samples: Any
    covariance_known: bool = True


class EvaluatedBatch(Protocol):
    """Batch of samples that a core has evaluated and not yet committed.

    Attributes:
        checked: result of the INS check.
        pending_outcomes: outcomes without estimates that are not published yet, each with the index of its sample.
    """

    checked: CheckedBlock
    pending_outcomes: list[tuple[int, Any]]


Batch = TypeVar("Batch", bound=EvaluatedBatch)


class BatchCore(Protocol[Batch]):
    """Interface of a core that evaluates batches of samples before it commits them."""

    def evaluate_batch(self, samples: Any, arrivals_ns: StampArray) -> Batch | None:
        """Evaluate the leading samples that need no special treatment; return None if the first sample needs it."""
        ...

    def commit_batch(self, batch: Batch, stop: int) -> None:
        """Commit the evaluated samples before index ``stop``."""
        ...

    def finish_batch(self, batch: Batch) -> Any:
        """Finish a committed batch; return the outcome of the sample that needs special treatment, or None."""
        ...

    def batch_estimates(self, batch: Batch) -> list[tuple[slice, Any]]:
        """Return slices of samples, each with its estimates from one state, or with their rejection."""
        ...


class BatchFeed(NamedTuple):
    """Processing of a batch of messages by a core.

    Attributes:
        read: reader, called with the messages and their receive times.
        core: core that processes the samples.
    """

    read: Callable[[CdrRows, StampArray], ReadBatch]
    core: BatchCore[Any]


class PendingBatch(NamedTuple):
    """Batch of messages that were read and evaluated, and are committed in order with messages of other topics.

    Attributes:
        topic: topic of the messages.
        reading: the messages as read, possibly more messages than the batch contains.
        receive_ns: receive times of the messages of the batch, equal by both clocks.
        evaluated: the core's evaluation.
    """

    topic: str
    reading: ReadBatch
    receive_ns: StampArray
    evaluated: EvaluatedBatch


class BatchOutput(NamedTuple):
    """Part of the outputs of a batch.

    Attributes:
        place: index of an input message in the batch; with ``estimates``, index of the first of their input messages.
        published: messages to publish at that input message.
        estimates: outputs still to be converted to messages, one for each message of the batch from ``place`` on; None
            if there are no outputs.
    """

    place: int
    published: list[OutputMessage]
    estimates: Any = None


class OutputRows(NamedTuple):
    """Messages of one topic for some of N outputs.

    Attributes:
        topic: the topic.
        messages: messages in order of the outputs.
        places: index of the output of each message.
    """

    topic: str
    messages: CdrRows
    places: NDArray[np.int64]


def outputs_with_levels(
    place: int,
    run: Any,
    published: PublishedLevels,
    redundancy_keys: list[tuple[Any, ...]],
    directions: FloatArray,
    protection_level_messages: Callable[[Any], list[OutputMessage]],
) -> Iterator[BatchOutput]:
    """Yield a run of outputs, split where protection levels are published before an output.

    Args:
        place: index of the first output in its batch.
        run: N outputs from one state.
        published: the published protection levels; ``protection_level_messages`` changes them.
        redundancy_keys: attributes of each output that determine, together with its state, the redundancy of its
            sources.
        directions: directions of each output, as in :meth:`PublishedLevels.covered_count`, shape (N, k, l).
        protection_level_messages: returns the protection levels of one output if the published levels do not cover it.
    """
    start, count = 0, len(run.time_ns)
    while start < count:
        yield BatchOutput(place + start, protection_level_messages(run.estimate(start)))
        rest = slice(start + 1, count)
        end = start + 1 + published.covered_count(run.time_ns[rest], run.covariance_n[rest], directions[rest])
        end = next(
            (other for other in range(start + 1, end) if redundancy_keys[other] != published.redundancy_key), end
        )
        yield BatchOutput(place + start, [], run if end - start == count else run.subset(slice(start, end)))
        start = end
