"""Interfaces of a node's adapter: to the node runtime and the replay, and to the core that processes its inputs.

An adapter (:class:`Adapter`) defines which topic feeds which method of a core (:class:`Feed`) and which result goes to
which topic. An adapter only reads and sets attributes of messages, so the same adapter serves rclpy messages in a live
node and decoded messages of a bag. The node runtime reports to the adapter when the node cannot keep up with its inputs
(:class:`Overload`).
"""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeVar

from ship_bags.cdr_template import CdrRows
from ship_bags.message_factory import MessageFactory
from ship_estimation.rejection_rules import Rejection
from ship_geometry.earth.time_scales import StampArray
from ship_node.health.input_health import InputHealthMonitor
from ship_node.messages.field_checks import ReadMessage
from ship_node.messages.inputs_outputs import Batch, BatchOutputs, InputTopic, OutputMessage, OutputTopic, ReadBlock
from ship_node.saved_files.saved_document import DISK, Files

if TYPE_CHECKING:
    # Nodes that are no estimators would import 20 more modules at their start.
    from ship_estimation.plausibility.checked_ins import CheckedBlock
    from ship_node.health.duplicate_publishers import StreamQuantity

TICK_PERIOD_NS = 100_000_000
"""Period of :meth:`Adapter.tick` by the timeout clock, ns."""


@dataclass(frozen=True)
class Overload:
    """Change of the overload state: messages were dropped because they waited too long, or the node keeps up again.

    Attributes:
        behind_s: time that the oldest message has waited, s; 0 if the node keeps up again.
        cores: number of processor cores that the node may use.
        load: mean number of runnable processes in the last minute.
        cut: topic → number of messages dropped since the last report to the adapter.
    """

    behind_s: float
    cores: int
    load: float
    cut: Mapping[str, int] = field(default_factory=dict)

    def text(self, node: str) -> str:
        """Return the text for the user.

        Example:
            >>> Overload(3.24, 2, 12.3).text("ship_attitude")
            'ship_attitude is 3.2 s behind: the computer is too slow (2 cores, load 12)'
        """
        cores = f"{self.cores} core{'s' if self.cores > 1 else ''}"
        return f"{node} is {self.behind_s:.1f} s behind: the computer is too slow ({cores}, load {self.load:.0f})"


class EvaluatedBlock(Protocol):
    """Block of samples that a core has evaluated and not yet committed.

    Attributes:
        checked: result of the INS check.
        pending_outcomes: outcomes without estimates that are not published yet, each with the index of its sample.
    """

    checked: "CheckedBlock"
    pending_outcomes: list[tuple[int, Any]]


Evaluated = TypeVar("Evaluated", bound=EvaluatedBlock)


class BlockCore(Protocol[Evaluated]):
    """Interface of a core that evaluates blocks of samples before it commits them."""

    def evaluate_block(self, samples: Any, arrivals_ns: StampArray) -> Evaluated | None:
        """Evaluate the leading samples that need no special treatment; return None if the first sample needs it."""
        ...

    def commit_block(self, block: Evaluated, stop: int, /) -> None:
        """Commit the evaluated samples before index ``stop``."""
        ...

    def finish_block(self, block: Evaluated, /) -> Any:
        """Finish a committed block; return the outcome of the sample that needs special treatment, or None."""
        ...

    def block_estimates(self, block: Evaluated, /) -> list[tuple[slice, Any]]:
        """Return slices of samples, each with its estimates from one state, or with their rejection."""
        ...


class DeferringPart(Protocol):
    """Part of a core that computes several outputs together.

    Attributes:
        pending: data of each pending output, with its stamp ``time_ns``; None if each output is published at once.
    """

    pending: list[Any] | None

    def compute_pending(self) -> list[tuple[slice, Any | Rejection]]:
        """Compute all pending outputs; return slices of ``pending``, each with its outputs or its rejection."""
        ...


class BlockFeed(NamedTuple):
    """Processing of the messages of a block by a core, with the results of messages one by one to the last bit.

    Attributes:
        read: reader, called with the messages and their receive times.
        core: core that processes the samples.
    """

    read: Callable[[CdrRows, StampArray], ReadBlock]
    core: BlockCore[Any]


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
        shows_present: source, named as in exclusions, that a usable message shows to be present; empty for a topic
            whose decisions show this, or that no VALID output needs.
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
    shows_present: str = ""
    stream_quantity: "StreamQuantity | None" = None


def ignore_time(process: Callable[[Any], Any]) -> Callable[[Any, int], Any]:
    """Return a core's method without a time argument in the form of :attr:`Feed.process`."""
    return lambda value, _waiting_ns: process(value)


class ServiceResult(NamedTuple):
    """Answer of a service: success, and one sentence for the user."""

    success: bool
    message: str


class Adapter(Protocol):
    """Adapter of one node; ``--help`` prints the first line of the adapter's docstring.

    All times are integer ns. Each message and each tick has two times:

    - ``receive_ns`` or ``now_ns``: the node's time, with which stamps are compared.
    - ``waiting_ns``: the timeout-clock time, by which timeouts are measured; None if it equals the node's time. The
      timeout clock never steps. In a live node, a pause in which the node processes no events counts as at most 0.2 s.
      With ``use_sim_time`` the timeout clock follows /clock while /clock is published, and in a replay the log time.

    The adapter reads and writes files only through ``files``, so that a black box can record the files read. The
    adapter updates ``health`` and publishes it in :meth:`tick`; the node runtime adds information of the middleware to
    ``health``. ``start_warnings`` has one line for each missing part of the configuration, and for a saved document
    that cannot be read. ``notices`` are log lines that the node runtime has not taken yet.
    """

    node_name: ClassVar[str]
    config_type: ClassVar[type]
    services: ClassVar[tuple[str, ...]]
    inputs: tuple[InputTopic, ...]
    outputs: tuple[OutputTopic, ...]
    health: InputHealthMonitor
    start_warnings: tuple[str, ...]
    notices: list[str]

    def __init__(self, config: Any, factory: MessageFactory, files: Files = DISK) -> None: ...

    @property
    def block_topics(self) -> Set[str]:
        """Input topics whose messages a batch may contain as a block."""
        ...

    def process(self, batch: Batch) -> BatchOutputs:
        """Process messages of input topics, and the ticks between them; return the messages to publish.

        A live node processes batches of one message, with ticks by :meth:`tick`. No other call may belong between the
        messages of a batch. Where batches end does not change the outputs.
        """
        ...

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """Process timeouts and periodic outputs; called every ``TICK_PERIOD_NS``."""
        ...

    def overload(self, change: Overload, now_ns: int, waiting_ns: int | None = None) -> list[OutputMessage]:
        """Publish no valid output while the node is behind its inputs.

        The node runtime calls this method when messages are dropped, and when the node keeps up again.
        """
        ...

    def clock_jumped_back(self, now_ns: int) -> list[OutputMessage]:
        """Restart, because the clock went back, for example when a bag is played again."""
        ...

    def clock_stepped(self, step_ns: int, now_ns: int, waiting_ns: int) -> list[OutputMessage]:
        """Record that the computer's clock was set by ``step_ns``; ``now_ns`` is the time after the step."""
        ...

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """Call one of ``services``."""
        ...

    def set_duplicate_publishers(self, topic: str, text: str) -> None:
        """Set that two publishers send on an input topic; an empty text ends this state.

        Which publisher is right is unknown, so outputs that depend on the topic are not VALID in this state.

        Args:
            topic: the input topic.
            text: text for the user, with the names of the publishers.
        """
        ...

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Apply live parameters, dotted name → value.

        Raises:
            ParameterError: a change is invalid; then no parameter is changed.
        """
        ...
