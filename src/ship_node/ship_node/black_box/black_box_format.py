"""What stands in a black box besides the messages: the events of a node, and the names of everything.

A box is an MCAP bag. Inputs lie in it under their own topics, outputs under theirs, events as JSON text on
:data:`EVENTS_TOPIC`; the order in the file is the order of use, and what a use led to follows it. The sequence numbers
count all of them from 1. The log time is the node's time of the use, which may go back; the publish time is the time of
waiting (:class:`ship_node.edge.adapter.Adapter`).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.renamed_topics import BOX_METADATA
from ship_node.edge.overload import Overload

FORMAT = "2"
"""Version of this description."""

EVENTS_TOPIC = "black_box/events"
EVENTS_TYPE = "std_msgs/msg/String"
METADATA = BOX_METADATA
"""Metadata record with the entries ``format``, ``node``, ``namespace``, and ``box`` (the same in all files of a box),
``part`` (from 1) and ``first`` (name of the first file), which boxes of one file alone may lack."""

VERSIONS_ATTACHMENT = "versions.json"
"""Attachment with :func:`ship_node.black_box.versions.versions`; that with the parameters is
:data:`ship_bags.mcap.bag_writer.SUITE_ATTACHMENT`."""


@dataclass(frozen=True)
class Tick:
    """The adapter was ticked."""


@dataclass(frozen=True)
class ClockJumpedBack:
    """The adapter was told that the clock went back."""


@dataclass(frozen=True)
class Contested:
    """The adapter was told that two publishers send on an input topic; an empty text: that they do no more."""

    topic: str
    text: str


@dataclass(frozen=True)
class ClockStepped:
    """The computer's clock was set by ``step_ns`` against a steady clock; the log time is by the clock as it is set."""

    step_ns: int


@dataclass(frozen=True)
class ParametersChanged:
    """Live parameters were given to the adapter, dotted name → value.

    ``refused`` is its reason to refuse them, None where it took them.
    """

    changes: Mapping[str, Any]
    refused: str | None


@dataclass(frozen=True)
class ChangeRefused:
    """The node refused live parameters, dotted name → value, before the adapter was asked."""

    changes: Mapping[str, Any]
    reason: str


@dataclass(frozen=True)
class ServiceCalled:
    """A service was called, with its answer; None where it raised."""

    name: str
    success: bool | None
    message: str | None


@dataclass(frozen=True)
class FileUsed:
    """The adapter read or wrote a file, during its construction or the use that follows.

    Attributes:
        path: as the adapter named it.
        written: whether it was written, not read.
        attachment: name of the attachment that holds the content; None where it failed.
        error: error number (errno) where it failed.
    """

    path: str
    written: bool
    attachment: str | None
    error: int | None


@dataclass(frozen=True)
class EntriesLost:
    """The disk was too slow or full: so many entries are missing here."""

    count: int


@dataclass(frozen=True)
class Closed:
    """The node ended in order; a box without it ends suddenly."""


Event = (
    Tick
    | ClockJumpedBack
    | ClockStepped
    | Overload
    | Contested
    | ParametersChanged
    | ChangeRefused
    | ServiceCalled
    | FileUsed
    | EntriesLost
    | Closed
)

_KINDS: dict[str, type[Event]] = {
    "tick": Tick,
    "clock_jumped_back": ClockJumpedBack,
    "clock_stepped": ClockStepped,
    "overload": Overload,
    "contested": Contested,
    "parameters": ParametersChanged,
    "change_refused": ChangeRefused,
    "service": ServiceCalled,
    "file": FileUsed,
    "lost": EntriesLost,
    "closed": Closed,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def event_text(event: Event) -> str:
    """The event as it lies in the box."""
    import json  # only a node that keeps a box needs it

    # A value that was refused may be of any type, bytes too.
    return json.dumps({"event": _NAMES[type(event)], **asdict(event)}, default=repr)


def event_from_text(text: str) -> Event:
    """The event of a text.

    Raises:
        BadInput: it is none.
    """
    import json

    try:
        fields = json.loads(text)
        return _KINDS[fields.pop("event")](**fields)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise BadInput(f"'{text:.100}' on {EVENTS_TOPIC} is no event of a black box") from error
