"""Situations of alerts, states of an alert, and the transitions between them.

The states are from IEC 62923-1 and IMO MSC.302(87), section 7. A warning or an alarm stays until its situation is
over and a person has acknowledged it. An alert also ends when another alert explains its situation. A caution lasts as
long as its situation and needs no acknowledgement.
"""

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass

from ship_watch.suite_state import Priority


@dataclass(frozen=True)
class Condition:
    """A present situation, the basis of an :class:`ship_watch.suite_state.AlertEntry`.

    Attributes:
        id: name of the situation.
        priority: priority of the alert.
        source: name of the source that the situation concerns; empty if it concerns no single source.
        text: the situation in a few words, without changing figures, because a new text is a change of the alert.
        value: measured value; NaN if there is none.
        limit: limit of ``value``; NaN if there is none.
        unit: unit of ``value`` and ``limit``.
        becomes_alarm: True if an unacknowledged warning becomes an alarm; otherwise the warning is repeated.
        may_be_startup: True if the situation is normal during the start of the suite; its alert is then raised only
            after the start.
        is_never_received: True if the situation is only that an output was never received. Such a situation does not
            change an alert that was active before a restart.
        explained_by: ids of situations that explain this situation. This situation has no alert of its own while the
            alert of one of those situations is active with at least the same priority.
        lost_functions: functions that are over their limits in the situation. A new instance of the alert is raised if
            further functions are over their limits after an acknowledgement.
    """

    id: str
    priority: Priority
    source: str
    text: str
    value: float = math.nan
    limit: float = math.nan
    unit: str = ""
    becomes_alarm: bool = False
    may_be_startup: bool = False
    is_never_received: bool = False
    explained_by: tuple[str, ...] = ()
    lost_functions: frozenset[str] = frozenset()


class AlertState(enum.IntEnum):
    """State of an alert, as in ship_msgs/Alert."""

    NORMAL = 0
    ACTIVE_UNACKNOWLEDGED = 1
    ACTIVE_SILENCED = 2
    ACTIVE_ACKNOWLEDGED = 3
    RECTIFIED_UNACKNOWLEDGED = 4


class AlertEvent(enum.Enum):
    """Event that may change the state of an alert."""

    COMES = "the situation is present"
    GOES = "the situation is over"
    ACKNOWLEDGED = "acknowledged by a person"
    SILENCED = "silenced by a person"
    SILENCE_ENDS = "the silence has ended"
    UNANSWERED = "not acknowledged in time"
    EXPLAINED = "another alert covers the situation"


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
"""(State, event) → next state of a warning or an alarm. Other combinations change nothing."""

CAUTION_TRANSITIONS: Mapping[tuple[AlertState, AlertEvent], AlertState] = {
    (_S.NORMAL, _E.COMES): _S.ACTIVE_ACKNOWLEDGED,
    (_S.ACTIVE_ACKNOWLEDGED, _E.GOES): _S.NORMAL,
    (_S.ACTIVE_ACKNOWLEDGED, _E.EXPLAINED): _S.NORMAL,
}
"""(State, event) → next state of a caution, which needs no acknowledgement."""

UNACKNOWLEDGED = frozenset((_S.ACTIVE_UNACKNOWLEDGED, _S.ACTIVE_SILENCED))
"""States of a present situation that is not acknowledged."""

ACTIVE = UNACKNOWLEDGED | {_S.ACTIVE_ACKNOWLEDGED}
"""States of a present situation."""


def next_state(state: AlertState, event: AlertEvent, priority: Priority) -> AlertState:
    """Return the state after an event; the same state if the event changes nothing."""
    table = CAUTION_TRANSITIONS if priority is Priority.CAUTION else TRANSITIONS
    return table.get((state, event), state)
