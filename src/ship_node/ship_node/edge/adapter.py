"""What the shell of a node, and the offline replay, expect of an adapter.

An adapter says which topic feeds which method of a core and which result goes to which topic. It only reads and
sets attributes of messages, so it serves rclpy messages in a live node and decoded messages of a bag alike.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

from ship_bags.message_factory import MessageFactory
from ship_node.documents.saved_document import DISK, Files
from ship_node.edge.input_health import InputHealthBook
from ship_node.edge.overload import Overload
from ship_node.edge.topics import InputTopic, OutputTopic, Published

TICK_PERIOD_NS = 100_000_000
"""Period of :meth:`Adapter.tick` in the time of the node, ns."""


class ServiceResult(NamedTuple):
    """Answer of a service: whether it was done, and a sentence for people."""

    success: bool
    message: str


class Adapter(Protocol):
    """One per node; the first line of its docstring is what ``--help`` says that the node does.

    All times are integer ns. A message and a tick come with two: the node's clock, which judges stamps, and the time of
    waiting, which judges silence. Nobody sets the second: it is the time in which a live node was listening, or /clock
    where that rules, or the log time in replay; without it the two are one. Files are read and written through
    ``files`` alone, so that a black box can hold what was read. ``health`` is fed by the adapter and, with what only
    the middleware knows, by the shell; the adapter publishes it in :meth:`tick`. ``start_warnings`` say what the
    configuration lacks, one line each; ``notices`` what happened that a log should tell, until the shell has taken it.
    """

    node_name: ClassVar[str]
    config_type: ClassVar[type]
    services: ClassVar[tuple[str, ...]]
    inputs: tuple[InputTopic, ...]
    outputs: tuple[OutputTopic, ...]
    health: InputHealthBook
    start_warnings: tuple[str, ...]
    notices: list[str]

    def __init__(self, config: Any, factory: MessageFactory, files: Files = DISK) -> None: ...

    def handle(self, topic: str, message: Any, receive_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Take one message of an input topic."""
        ...

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Do what depends on waiting; called every ``TICK_PERIOD_NS``."""
        ...

    def overload(self, change: Overload, now_ns: int, waiting_ns: int | None = None) -> list[Published]:
        """Claim nothing while the node is behind its inputs; called where messages are cut, and where it keeps up."""
        ...

    def clock_jumped_back(self, now_ns: int) -> list[Published]:
        """Start anew: the clock went back, as when a bag starts over."""
        ...

    def clock_stepped(self, step_ns: int, now_ns: int, waiting_ns: int) -> list[Published]:
        """Take note that the computer's clock was set by ``step_ns``; ``now_ns`` is by the clock as it is set."""
        ...

    def service(self, name: str, now_ns: int) -> ServiceResult:
        """Do one of ``services``."""
        ...

    def contest(self, topic: str, text: str) -> None:
        """Set that two publishers send on an input topic, with a text that names them; an empty text ends it.

        Which of the two is right cannot be known: what rests on the topic meanwhile is not VALID.
        """
        ...

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Take live parameters, dotted name → value.

        Raises:
            ParameterError: nothing was changed; the text says why.
        """
        ...
