"""Entries of an adapter's table: how the messages of one topic reach the core, one by one or as a block."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

from ship_bags.cdr_template import CdrRows
from ship_estimation.plausibility.checked_ins import CheckedBlock
from ship_node.health.duplicate_publishers import StreamQuantity
from ship_node.messages.batch import ReadBatch, StampArray
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.topics import InputTopic


class EvaluatedBatch(Protocol):
    """Batch of samples that a core has evaluated and not yet committed.

    Attributes:
        checked: result of the INS check.
        pending_outcomes: outcomes without estimates that are not published yet, each with the index of its sample.
    """

    checked: CheckedBlock
    pending_outcomes: list[tuple[int, Any]]


Evaluated = TypeVar("Evaluated", bound=EvaluatedBatch)


class BatchCore(Protocol[Evaluated]):
    """Interface of a core that evaluates batches of samples before it commits them."""

    def evaluate_batch(self, samples: Any, arrivals_ns: StampArray) -> Evaluated | None:
        """Evaluate the leading samples that need no special treatment; return None if the first sample needs it."""
        ...

    def commit_batch(self, batch: Evaluated, stop: int) -> None:
        """Commit the evaluated samples before index ``stop``."""
        ...

    def finish_batch(self, batch: Evaluated) -> Any:
        """Finish a committed batch; return the outcome of the sample that needs special treatment, or None."""
        ...

    def batch_estimates(self, batch: Evaluated) -> list[tuple[slice, Any]]:
        """Return slices of samples, each with its estimates from one state, or with their rejection."""
        ...


class BlockFeed(NamedTuple):
    """Processing of the messages of a block by a core, with the results of messages one by one to the last bit.

    Attributes:
        read: reader, called with the messages and their receive times.
        core: core that processes the samples.
    """

    read: Callable[[CdrRows, StampArray], ReadBatch]
    core: BatchCore[Any]


@dataclass(frozen=True)
class Feed:
    """Entry of an adapter's table: how the messages of one topic reach the core.

    Attributes:
        input: the topic.
        source: name of the device in innovation messages.
        read: reader, called with a message and ``receive_ns=``, the receive time by the node's clock, ns; it raises
            :class:`ship_node.messages.field_checks.MessageRejected` if the message cannot be used.
        process: method of the core, called with the value read and the timeout-clock time, ns; it returns the outcome.
        has_decision: True if the core decides on each message of the topic, perhaps later; False if a message counts as
            used unless the core rejects it at once.
        measurement_source: name of the device in measurements; empty if it equals ``source``.
        block: processing of many messages at once; None if messages are only processed one by one.
        read_rows: reader, called with many messages and their receive times; it returns None for each message that
            ``read`` must read.
        stream_quantity: quantity whose values show two publishers, live and in a recording; None if the topic is not
            checked.
            The quantity is computed from the decision if ``has_decision``, otherwise from the value read.
    """

    input: InputTopic
    source: str
    read: Callable[..., ReadMessage[Any]]
    process: Callable[[Any, int], Any]
    has_decision: bool = False
    measurement_source: str = ""
    block: BlockFeed | None = None
    read_rows: Callable[[CdrRows, StampArray], Sequence[ReadMessage[Any] | None]] | None = None
    stream_quantity: StreamQuantity | None = None


def ignore_time(process: Callable[[Any], Any]) -> Callable[[Any, int], Any]:
    """Return a core's method without a time argument in the form of :attr:`Feed.process`."""
    return lambda value, _waiting_ns: process(value)
