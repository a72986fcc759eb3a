"""What an estimator says of its inputs, and what an output is worth: the same words for every estimator of the suite.

A core answers each input with an :class:`Outcome`: the refusal of that very input, the decisions about measurements
that could be judged now, and the estimates to publish. What every decision has stands in :class:`Decision`; an
estimator adds what is its own in a subclass.
"""

import enum
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

import numpy as np

from ship_estimation.refusals import Reason, Refusal
from ship_geometry.rotations import FloatArray


class Status(enum.IntEnum):
    """What an attitude or a pointing is worth; the values are those of the messages."""

    VALID = 0
    COASTING = 1
    DEGRADED = 2
    INVALID = 3


class Measurement(Protocol):
    """What every kind of measurement has: its source, its stamp, and bytes to tell it from another of its stamp."""

    @property
    def source(self) -> str:
        """Who measured: ``star.<id>``, ``reference.<name>``, ``beacons``."""
        ...

    @property
    def time_ns(self) -> int:
        """Stamp of the device."""
        ...

    @property
    def covariance_known(self) -> bool:
        """False where the message gave none and the configured sigma stands in."""
        ...

    @property
    def reach_ns(self) -> int:
        """Data up to this long before and after the stamp belong to it: half of an exposure; mostly 0."""
        ...

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        ...


Measured = TypeVar("Measured", bound=Measurement, covariant=True)


@dataclass(frozen=True)
class Decision(Generic[Measured]):
    """What became of a measurement.

    Attributes:
        measurement: the measurement itself.
        reason: why it was not used, or what was wrong with it although it was; NONE where nothing is to be said.
        accepted: True where the measurement entered the estimate.
        components: names of the residuals.
        residual: measured minus predicted, rad, shape (m,); empty where the measurement was not compared at all.
        sigma: predicted standard deviation of each component of the residual, rad, shape (m,).
        nis: normalised innovation squared, chi² with m degrees of freedom.
        gate: the value that ``nis`` must not exceed.
        text: explanation for people.
        left_out: parts of the measurement (stars, lights) that were not used, by name, and why.
        revised: True where a measurement that arrived late changed an earlier decision.
        covariance: predicted covariance of the residual, rad², shape (m, m).
        noise: the part of it that is the measurement's own noise, rad², shape (m, m).
    """

    measurement: Measured
    reason: Reason
    accepted: bool = False
    components: tuple[str, ...] = ()
    residual: FloatArray = field(default_factory=lambda: np.empty(0))
    sigma: FloatArray = field(default_factory=lambda: np.empty(0))
    nis: float = float("nan")
    gate: float = float("nan")
    text: str = ""
    left_out: tuple[tuple[str, Refusal], ...] = ()
    revised: bool = False
    covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    noise: FloatArray = field(default_factory=lambda: np.empty((0, 0)))


Judged = TypeVar("Judged", bound=Decision[Measurement])
Estimate = TypeVar("Estimate")


@dataclass
class Outcome(Generic[Judged, Estimate]):
    """What one input led to.

    Attributes:
        refusal: why this very input was not used; None where it was, or still waits.
        decisions: measurements judged now: this one, or others that had waited for it.
        estimates: what to publish. The times of those that claim something strictly increase
            (:meth:`ship_estimation.estimator_shell.EstimatorShell.put_out`).
        failures: by stamp, outputs that could not be computed: the software itself failed.
    """

    refusal: Refusal | None = None
    decisions: list[Judged] = field(default_factory=list)
    estimates: list[Estimate] = field(default_factory=list)
    failures: list[tuple[int, Refusal]] = field(default_factory=list)
