"""Outcome of an input, in types that all estimators share, and order and timeouts of the outputs.

A core returns an :class:`Outcome` for each input: the rejection of that input, the decisions about measurements that
could be evaluated now, and the estimates to publish. :class:`MeasurementDecision` has the fields that all decisions
have in common; an estimator adds fields in a subclass.

Two clocks are used for the outputs (:class:`OutputSequence`). Outputs are ordered by their stamps, the time of the
data. Timeouts are measured by the timeout clock, which is monotonic; the node runtime passes the time of this clock
(``waiting_ns``) with each input and tick. Old stamps, or a correction of the system clock, cause no timeout.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection, failure_rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray


class Status(enum.IntEnum):
    """Status of an attitude or a pointing; the values are those of the messages."""

    VALID = 0
    COASTING = 1
    DEGRADED = 2
    INVALID = 3


class Measurement(Protocol):
    """Common properties of all measurements: source, stamp, and content as bytes."""

    @property
    def source(self) -> str:
        """Source of the measurement, for example ``star.<id>``, ``reference.<name>``, ``beacons``."""
        ...

    @property
    def time_ns(self) -> int:
        """Stamp of the device."""
        ...

    @property
    def covariance_known(self) -> bool:
        """False if the message had no covariance and the configured sigma is used."""
        ...

    @property
    def reach_ns(self) -> int:
        """Time before and after the stamp for which motion data are needed, ns; 0 if only the stamp matters."""
        ...

    def content(self) -> bytes:
        """Return all values as bytes; repeated messages have equal bytes, and the bytes order conflicting messages."""
        ...


MeasurementT = TypeVar("MeasurementT", bound=Measurement, covariant=True)


@dataclass(frozen=True)
class MeasurementDecision(Generic[MeasurementT]):
    """Decision to accept or reject a measurement.

    Attributes:
        measurement: the measurement itself.
        reason: reason of the rejection, or of the remark in ``text`` on an accepted measurement; otherwise NONE.
        accepted: True if the measurement updated the estimate.
        components: names of the components of the residual.
        residual: measured minus predicted, rad, shape (m,); empty if no residual was computed.
        sigma: predicted standard deviation of each component of the residual, rad, shape (m,).
        nis: normalised innovation squared, chi² with m degrees of freedom.
        gate: the value that ``nis`` must not exceed.
        text: explanation for people.
        rejected_parts: parts of the measurement (stars, beacons) that were not used, by name, with the reason.
        revised: True if this decision replaces an earlier decision, because data that affect it arrived afterwards.
        covariance: innovation covariance, rad², shape (m, m).
        noise: part of ``covariance`` from the measurement noise, rad², shape (m, m).
    """

    measurement: MeasurementT
    reason: Reason
    accepted: bool = False
    components: tuple[str, ...] = ()
    residual: FloatArray = field(default_factory=lambda: np.empty(0))
    sigma: FloatArray = field(default_factory=lambda: np.empty(0))
    nis: float = float("nan")
    gate: float = float("nan")
    text: str = ""
    rejected_parts: tuple[tuple[str, Rejection], ...] = ()
    revised: bool = False
    covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    noise: FloatArray = field(default_factory=lambda: np.empty((0, 0)))


DecisionT = TypeVar("DecisionT", bound=MeasurementDecision[Measurement])
Estimate = TypeVar("Estimate")


@dataclass
class Outcome(Generic[DecisionT, Estimate]):
    """Result of one input.

    Attributes:
        rejection: rejection of this input, or of the conflicting input that this input replaces; None if no input was
            rejected now.
        decisions: decisions made now, about this input or about measurements that waited for this input.
        estimates: estimates to publish. The stamps of valid estimates strictly increase (:class:`OutputSequence`).
        failures: stamp and rejection of each output that could not be computed because the software failed.
    """

    rejection: Rejection | None = None
    decisions: list[DecisionT] = field(default_factory=list)
    estimates: list[Estimate] = field(default_factory=list)
    failures: list[tuple[int, Rejection]] = field(default_factory=list)


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
