"""The situations that alerts tell, the states of an alert, and what leads from one to the next.

The states are those of IEC 62923-1 and IMO MSC.302(87), section 7. A warning or an alarm stays until a person has
acknowledged it, also where its situation is over. A caution is told as long as its situation is there, and nobody
needs to acknowledge it.
"""

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass

from ship_watch.picture import Priority


@dataclass(frozen=True)
class Condition:
    """A situation that is there now, as :class:`ship_watch.picture.AlertShown` tells it.

    Attributes:
        id: name of the situation.
        priority: its urgency.
        source: who is to blame; empty where nobody is known.
        text: the situation in a few words. It holds no figure that runs, or each look would be a change.
        value: what was measured; NaN for nothing.
        limit: what it is held against; NaN for nothing.
        unit: of both.
        becomes_alarm: whether a warning that nobody acknowledges becomes an alarm; otherwise it is repeated.
        needs_start: whether the situation may be nothing but a suite that is about to start.
        is_blind: whether it only says that nothing was ever heard: an alert that is there, of before a restart, is not
            changed by that.
        under: ids of situations that explain this one. While one of them is active, and not less urgent, this one is
            told by it and is no alert of its own.
        lost: what the situation takes away. When more is lost than a person has acknowledged, it is told anew.
    """

    id: str
    priority: Priority
    source: str
    text: str
    value: float = math.nan
    limit: float = math.nan
    unit: str = ""
    becomes_alarm: bool = False
    needs_start: bool = False
    is_blind: bool = False
    under: tuple[str, ...] = ()
    lost: frozenset[str] = frozenset()


class AlertState(enum.IntEnum):
    """The states of ship_msgs/Alert."""

    NORMAL = 0
    ACTIVE_UNACKNOWLEDGED = 1
    ACTIVE_SILENCED = 2
    ACTIVE_ACKNOWLEDGED = 3
    RECTIFIED_UNACKNOWLEDGED = 4


class AlertEvent(enum.Enum):
    """What may happen to an alert."""

    COMES = "the situation is there"
    GOES = "the situation is over"
    ACKNOWLEDGED = "a person has seen it"
    SILENCED = "a person has switched off the sound"
    SILENCE_ENDS = "the sound has been off for long enough"
    UNANSWERED = "nobody acknowledged it in time"
    EXPLAINED = "another alert tells the situation"


_S, _E = AlertState, AlertEvent
TRANSITIONS: Mapping[tuple[AlertState, AlertEvent], AlertState] = {
    (_S.NORMAL, _E.COMES): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.GOES): _S.RECTIFIED_UNACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.ACKNOWLEDGED): _S.ACTIVE_ACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.SILENCED): _S.ACTIVE_SILENCED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.UNANSWERED): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_UNACKNOWLEDGED, _E.EXPLAINED): _S.NORMAL,
    (_S.ACTIVE_SILENCED, _E.GOES): _S.RECTIFIED_UNACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.ACKNOWLEDGED): _S.ACTIVE_ACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.SILENCE_ENDS): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.UNANSWERED): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.ACTIVE_SILENCED, _E.EXPLAINED): _S.NORMAL,
    (_S.ACTIVE_ACKNOWLEDGED, _E.GOES): _S.NORMAL,
    (_S.ACTIVE_ACKNOWLEDGED, _E.EXPLAINED): _S.NORMAL,
    (_S.RECTIFIED_UNACKNOWLEDGED, _E.COMES): _S.ACTIVE_UNACKNOWLEDGED,
    (_S.RECTIFIED_UNACKNOWLEDGED, _E.ACKNOWLEDGED): _S.NORMAL,
}
"""The state of a warning or an alarm after an event; whatever is not named changes nothing."""

CAUTION_TRANSITIONS: Mapping[tuple[AlertState, AlertEvent], AlertState] = {
    (_S.NORMAL, _E.COMES): _S.ACTIVE_ACKNOWLEDGED,
    (_S.ACTIVE_ACKNOWLEDGED, _E.GOES): _S.NORMAL,
    (_S.ACTIVE_ACKNOWLEDGED, _E.EXPLAINED): _S.NORMAL,
}
"""Likewise of a caution, which nobody needs to acknowledge."""

UNANSWERED = frozenset((_S.ACTIVE_UNACKNOWLEDGED, _S.ACTIVE_SILENCED))
"""The situation is there, and nobody has acknowledged it."""

ACTIVE = UNANSWERED | {_S.ACTIVE_ACKNOWLEDGED}
"""The situation is there."""


def next_state(state: AlertState, event: AlertEvent, priority: Priority) -> AlertState:
    """The state after an event; the same where the event changes nothing."""
    table = CAUTION_TRANSITIONS if priority is Priority.CAUTION else TRANSITIONS
    return table.get((state, event), state)
