"""Memory of the last consistent state of an estimator."""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from ship_estimation.recovery.trouble import ENDS_AFTER_NS
from ship_geometry.earth.time_scales import SECOND_NS

State = TypeVar("State")

LEAST_AGE_NS = 10 * SECOND_NS
"""Minimum age, at the first sign of trouble, of a stored state, ns; a fault may act before its detection."""

BEFORE_STEP_NS = 2 * SECOND_NS
"""Minimum age, at the first sign of trouble, of the state against which displacements are measured, ns.

This age is shorter than :data:`LEAST_AGE_NS`, because a step is detected at once and the INS drifts little in two
seconds."""

MIN_CONSISTENT_NS = ENDS_AFTER_NS
"""Minimum time of consistency before a state is used, ns; an earlier state may contain a fault."""


class StateMemory(Generic[State]):
    """The newest consistent state that is old enough.

    Example:
        >>> memory: StateMemory[int] = StateMemory()
        >>> for second in range(40):
        ...     memory.keep(second * SECOND_NS, second)
        >>> memory.recall(40 * SECOND_NS)
        30
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[int, State]] = deque()
        self._consistent_since_ns = 0

    def keep(self, time_ns: int, state: State) -> None:
        """Store a consistent state.

        Args:
            time_ns: present time, later than all times before.
            state: immutable state.
        """
        if not self._kept:
            self._consistent_since_ns = time_ns
        self._kept.append((time_ns, state))
        while len(self._kept) > 1 and self._kept[1][0] <= time_ns - LEAST_AGE_NS:
            self._kept.popleft()

    def recall(self, first_sign_ns: int, least_age_ns: int = LEAST_AGE_NS) -> State | None:
        """Return the newest state that is old enough at the first sign of trouble, or None.

        The result is None if no state is old enough, or if states have been stored for less than
        :data:`MIN_CONSISTENT_NS`.
        """
        if first_sign_ns - self._consistent_since_ns < MIN_CONSISTENT_NS:
            return None
        old = [state for time_ns, state in self._kept if time_ns <= first_sign_ns - least_age_ns]
        return old[-1] if old else None

    def replace_all(self, by: Callable[[State], State]) -> None:
        """Replace every stored state, after a step of the time base or a jump of the INS."""
        self._kept = deque((time_ns, by(state)) for time_ns, state in self._kept)

    def forget_newer(self, state: State | None) -> None:
        """Drop all states but a recalled state, because later states may already contain the fault."""
        self._kept = deque(kept for kept in self._kept if kept[1] is state)
