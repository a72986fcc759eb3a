"""Order and timeouts of an estimator's outputs.

Two clocks are used. Outputs are ordered by their stamps, the time of the data. Timeouts are measured by the timeout
clock, which is monotonic; the node runtime passes the time of this clock (``waiting_ns``) with each input and tick. Old
stamps, or a correction of the system clock, cause no timeout.
"""

from collections.abc import Callable
from typing import Any

from ship_estimation.rejection_rules import failure_rejection
from ship_estimation.time_order.outcome import Estimate, Outcome
from ship_geometry.earth.time_scales import SECOND_NS


class OutputSequence:
    """The sequence of an estimator's published outputs: their stamps increase, and INVALID follows after a timeout."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Restart the sequence after a clock jump: the next output may have an earlier stamp."""
        self._last_ns: int | None = None
        self._timeout_ns: int | None = None
        self._invalid_reported_ns: int | None = None

    def step_time_base(self, step_ns: int) -> None:
        """Shift the last stamp, because all clocks were stepped; outputs stay in order."""
        if self._last_ns is not None:
            self._last_ns += step_ns

    def continue_from(self, before: "OutputSequence") -> None:
        """Continue the sequence of another estimator; own outputs so far were not published."""
        self._last_ns, self._timeout_ns = before._last_ns, before._timeout_ns
        self._invalid_reported_ns = before._invalid_reported_ns

    def can_publish(self, time_ns: int) -> bool:
        """True if an output with a stamp may be published, because the stamp is later than all stamps before."""
        return self._last_ns is None or time_ns > self._last_ns

    def add(
        self,
        outcome: Outcome[Any, Estimate],
        time_ns: int,
        waiting_ns: int,
        estimate: Callable[[], Estimate | None],
        timeout_ns: int = SECOND_NS,
    ) -> None:
        """Add the estimate of a stamp to the outcome if the stamp is later than all output stamps before.

        If ``estimate`` raises an exception, a failure is reported; the next estimate is computed as usual.

        Args:
            outcome: receives the estimate.
            time_ns: the stamp.
            waiting_ns: time by the timeout clock.
            estimate: function that computes the estimate; it may return None.
            timeout_ns: time without a further output after which INVALID is reported; at least a second.
        """
        if not self.can_publish(time_ns):
            return
        try:
            found = estimate()
        except Exception as error:
            outcome.failures.append((time_ns, failure_rejection(error)))
            return
        if found is not None:
            outcome.estimates.append(found)
            self.record(time_ns, waiting_ns, timeout_ns)

    def record(self, time_ns: int, waiting_ns: int, timeout_ns: int = SECOND_NS) -> None:
        """Record the stamp and time of a published estimate; arguments as for :meth:`add`."""
        self._last_ns, self._invalid_reported_ns = time_ns, None
        self._timeout_ns = waiting_ns + max(timeout_ns, SECOND_NS)

    def report_invalid(
        self, outcome: Outcome[Any, Estimate], waiting_ns: int, make_invalid: Callable[[], Estimate]
    ) -> None:
        """Add an INVALID output, at most once a second, if no estimate was published within the timeout or at all.

        The INVALID output has the time of a tick. This output does not count for the order of outputs, so an older
        valid estimate may follow.
        """
        if self._timeout_ns is not None and waiting_ns <= self._timeout_ns:
            return
        if self._invalid_reported_ns is not None and waiting_ns - self._invalid_reported_ns < SECOND_NS:
            return
        self._invalid_reported_ns = waiting_ns
        outcome.estimates.append(make_invalid())
