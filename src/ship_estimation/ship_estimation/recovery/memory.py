"""The last state of an estimator at which nothing was disputed."""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from ship_estimation.recovery.trouble import ENDS_AFTER_NS
from ship_geometry.time_scales import SECOND_NS

State = TypeVar("State")

LEAST_AGE_NS = 10 * SECOND_NS
"""Time from the remembered state to the first sign of trouble, at least: a fault may act before it shows, ns."""

BEFORE_STEP_NS = 2 * SECOND_NS
"""The same for the state that a step is measured from: a step shows at once, and the INS drifts little in this time."""

LEAST_UNDISPUTED_NS = ENDS_AFTER_NS
"""Time without a dispute after which a state is remembered, as after trouble: a fault may be all it knew before, ns."""


class Memory(Generic[State]):
    """The newest undisputed state that is old enough, kept until a newer one is.

    Example:
        >>> memory: Memory[int] = Memory()
        >>> for second in range(40):
        ...     memory.keep(second * SECOND_NS, second)
        >>> memory.recall(40 * SECOND_NS)
        30
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[int, State]] = deque()
        self._undisputed_since_ns = 0

    def keep(self, time_ns: int, state: State) -> None:
        """Keep an undisputed state.

        Args:
            time_ns: the time now, later than all before.
            state: not changed in place later.
        """
        if not self._kept:
            self._undisputed_since_ns = time_ns
        self._kept.append((time_ns, state))
        while len(self._kept) > 1 and self._kept[1][0] <= time_ns - LEAST_AGE_NS:
            self._kept.popleft()

    def recall(self, first_sign_ns: int, least_age_ns: int = LEAST_AGE_NS) -> State | None:
        """Return the newest state that is old enough at the first sign of trouble; None where there is none.

        There is none where the estimator has not been undisputed for :data:`LEAST_UNDISPUTED_NS`.
        """
        if first_sign_ns - self._undisputed_since_ns < LEAST_UNDISPUTED_NS:
            return None
        old = [state for time_ns, state in self._kept if time_ns <= first_sign_ns - least_age_ns]
        return old[-1] if old else None

    def replace_all(self, by: Callable[[State], State]) -> None:
        """Replace every state that is kept, for a time that has moved or an INS that has jumped since."""
        self._kept = deque((time_ns, by(state)) for time_ns, state in self._kept)

    def forget_newer(self, state: State | None) -> None:
        """Keep no other state than one that was recalled: those after it may already contain the fault."""
        self._kept = deque(kept for kept in self._kept if kept[1] is state)
