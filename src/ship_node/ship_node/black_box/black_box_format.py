"""Format of a black box: events of a node besides its messages, and names of topics and records.

A black box is an MCAP bag. Inputs and outputs have their own topics; events are JSON texts on :data:`EVENTS_TOPIC`. The
order in the file is the order of use; an input or event is followed by its results. The sequence numbers count all
entries from 1. The log time is the node time of the use, which may go back; the publish time is the timeout-clock time
(:class:`ship_node.adapters.adapter.Adapter`).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ship_bags.errors import BadInput
from ship_bags.topic_names import BLACK_BOX_METADATA
from ship_node.adapters.adapter import Overload

FORMAT = "2"
"""Version of this format."""

EVENTS_TOPIC = "black_box/events"
EVENTS_TYPE = "std_msgs/msg/String"
METADATA = BLACK_BOX_METADATA
"""Name of the metadata record with the entries ``format``, ``node``, ``namespace``, ``box`` (the same in all files of a
black box), ``part`` (from 1) and ``first`` (name of the first file). The last three may be missing in a black box of
one file."""

VERSIONS_ATTACHMENT = "versions.json"
"""Name of the attachment with the result of :func:`ship_bags.provenance.versions`; the parameters are in
:data:`ship_bags.mcap.bag_writer.SUITE_ATTACHMENT`."""


@dataclass(frozen=True)
class Tick:
    """Tick of the adapter."""


@dataclass(frozen=True)
class ClockJumpedBack:
    """Report to the adapter that the clock went back."""


@dataclass(frozen=True)
class DuplicatePublishersChanged:
    """Report to the adapter that two publishers send on an input topic or, with an empty text, that this has ended."""

    topic: str
    text: str


@dataclass(frozen=True)
class ClockStepped:
    """Step of the computer's clock by ``step_ns`` against a steady clock; the log time is the time after the step."""

    step_ns: int


@dataclass(frozen=True)
class ParametersChanged:
    """Live parameters, dotted name → value, passed to the adapter.

    ``refused`` is the reason if the adapter refused them; None if the adapter applied them.
    """

    changes: Mapping[str, Any]
    refused: str | None


@dataclass(frozen=True)
class ChangeRefused:
    """Live parameters, dotted name → value, refused by the node without calling the adapter."""

    changes: Mapping[str, Any]
    reason: str


@dataclass(frozen=True)
class ServiceCalled:
    """Service call with its answer; the answer is None if the call raised an exception."""

    name: str
    success: bool | None
    message: str | None


@dataclass(frozen=True)
class FileUsed:
    """File read or written by the adapter, during its construction or during the use whose entry follows.

    Attributes:
        path: path given by the adapter.
        written: True if the file was written or set aside, False if it was read.
        attachment: name of the attachment with the content, or with the new path of a file set aside; None if the
            operation failed.
        error: error number (errno) if the operation failed.
    """

    path: str
    written: bool
    attachment: str | None
    error: int | None


@dataclass(frozen=True)
class EntriesLost:
    """Number of entries missing at this place, for example because the disk was too slow or full."""

    count: int


@dataclass(frozen=True)
class Closed:
    """Regular end of the node; a black box without this event ended abruptly."""


Event = (
    Tick
    | ClockJumpedBack
    | ClockStepped
    | Overload
    | DuplicatePublishersChanged
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
    "contested": DuplicatePublishersChanged,
    "parameters": ParametersChanged,
    "change_refused": ChangeRefused,
    "service": ServiceCalled,
    "file": FileUsed,
    "lost": EntriesLost,
    "closed": Closed,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def event_text(event: Event) -> str:
    """Return an event as text."""
    import json  # needed for black boxes only

    # A refused value may be of any type, also bytes.
    return json.dumps({"event": _NAMES[type(event)], **asdict(event)}, default=repr)


def event_from_text(text: str) -> Event:
    """Return the event of a text.

    Raises:
        BadInput: the text is not an event.
    """
    import json

    try:
        fields = json.loads(text)
        return _KINDS[fields.pop("event")](**fields)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise BadInput(f"'{text:.100}' on {EVENTS_TOPIC} is not an event of a black box") from error
