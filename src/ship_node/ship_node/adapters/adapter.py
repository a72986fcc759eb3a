"""Interface of a node's adapter, as the node runtime and the offline replay use it.

An adapter defines which topic feeds which method of a core and which result goes to which topic. An adapter only reads
and sets attributes of messages, so the same adapter serves rclpy messages in a live node and decoded messages of a bag.
"""

from collections.abc import Mapping, Set
from typing import Any, ClassVar, NamedTuple, Protocol

from ship_bags.message_factory import MessageFactory
from ship_node.health.input_health import InputHealthMonitor
from ship_node.health.overload import Overload
from ship_node.messages.batch import Batch, BatchOutputs
from ship_node.messages.topics import InputTopic, OutputMessage, OutputTopic
from ship_node.saved_files.saved_document import DISK, Files

TICK_PERIOD_NS = 100_000_000
"""Period of :meth:`Adapter.tick` by the timeout clock, ns."""


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
