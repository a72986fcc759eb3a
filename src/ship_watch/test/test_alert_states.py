"""State table of alerts: next state for each event and state, for warnings, alarms and cautions.

The rows are from IMO MSC.302(87), section 7 (unacknowledged, silenced for a while, acknowledged, rectified without
acknowledgement), not from the code.
"""

import itertools

from ship_testing.every_case import check_every_case
from ship_watch.alerts.alerts import AlertEvent, AlertState, next_state
from ship_watch.suite_state import Priority

N, U, S, A, R = "NUSAR"
"""Normal, active unacknowledged, active silenced, active acknowledged, rectified unacknowledged."""

STATES = dict(zip("NUSAR", AlertState, strict=True))

# State before:  N  U  S  A  R
WARNING_ROWS = {
    "COMES":        (U, U, S, A, U),
    "GOES":         (N, R, R, N, R),
    "ACKNOWLEDGED": (N, A, A, A, N),
    "SILENCED":     (N, S, S, A, R),
    "SILENCE_ENDS": (N, U, U, A, R),
    "UNANSWERED":   (N, U, U, A, R),
    "EXPLAINED":    (N, N, N, N, R),
}  # fmt: skip
CAUTION_ROWS = {
    "COMES":        (A, A),
    "GOES":         (N, N),
    "ACKNOWLEDGED": (N, A),
    "SILENCED":     (N, A),
    "SILENCE_ENDS": (N, A),
    "UNANSWERED":   (N, A),
    "EXPLAINED":    (N, N),
}  # fmt: skip

WARNING_CASES = [
    (priority, before, event, after)
    for priority in (Priority.WARNING, Priority.ALARM)
    for event, row in WARNING_ROWS.items()
    for before, after in zip("NUSAR", row, strict=True)
]
CAUTION_CASES = [
    (Priority.CAUTION, before, event, after)
    for event, row in CAUTION_ROWS.items()
    for before, after in zip("NA", row, strict=True)
]


def test_transition() -> None:
    check_every_case(WARNING_CASES + CAUTION_CASES, check_transition)


def check_transition(priority: Priority, before: str, event: str, after: str) -> None:
    """Check the next state for one event in one state."""
    assert next_state(STATES[before], AlertEvent[event], priority) is STATES[after]


def test_table_is_complete() -> None:
    """Every event is a row; the numbers of the states are those of the message."""
    assert set(WARNING_ROWS) == set(CAUTION_ROWS) == {event.name for event in AlertEvent}
    assert [state.value for state in AlertState] == [0, 1, 2, 3, 4]


def test_caution_is_never_unacknowledged() -> None:
    """From NORMAL, no sequence of events leads a caution to a third state."""
    for events in itertools.product(AlertEvent, repeat=3):
        state = AlertState.NORMAL
        for event in events:
            state = next_state(state, event, Priority.CAUTION)
            assert state in (AlertState.NORMAL, AlertState.ACTIVE_ACKNOWLEDGED)
