"""Outcome of an input, in types that all estimators share.

A core returns an :class:`Outcome` for each input: the rejection of that input, the decisions about measurements that
could be evaluated now, and the estimates to publish. :class:`MeasurementDecision` has the fields that all decisions
have in common; an estimator adds fields in a subclass.
"""

import enum
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
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
        estimates: estimates to publish. The stamps of valid estimates strictly increase
            (:class:`ship_estimation.time_order.time_ordered_estimator.OutputSequence`).
        failures: stamp and rejection of each output that could not be computed because the software failed.
    """

    rejection: Rejection | None = None
    decisions: list[DecisionT] = field(default_factory=list)
    estimates: list[Estimate] = field(default_factory=list)
    failures: list[tuple[int, Rejection]] = field(default_factory=list)
