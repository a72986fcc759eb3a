"""Estimator that a second estimator can replace, around its time-ordered estimator, and time shift of its states.

A step of the time base shifts all stamps and keeps all other values (:func:`with_shifted_stamps`).
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.time_order.time_ordered_estimator import TimeOrderedEstimator
from ship_geometry.earth.time_scales import NEVER_NS
from ship_geometry.rotations import FloatArray

Value = TypeVar("Value")

MAX_JUMPS = 100
"""Maximum number of jumps stored until :meth:`Consistency.take_jumps`, which is called once a second."""


def with_shifted_stamps(value: Value, step_ns: int) -> Value:
    """Return a copy of an immutable value in which every field named ``…_ns`` is shifted by a step.

    Such fields hold stamps: an integer, None, an array or a mapping of integers; ``NEVER_NS`` in an array stays. Fields
    of other names are searched recursively.

    Args:
        value: a frozen dataclass, a named tuple, a mapping, or anything without stamps.
        step_ns: the step, ns.

    Example:
        >>> from ship_estimation.fault_detection.exclusion import UnconfirmedStep
        >>> with_shifted_stamps(UnconfirmedStep(10, "why", "stars"), -3).since_ns
        7
    """
    anything: Any = value
    kind: Any = type(value)
    shifted: Any = value
    if is_dataclass(value) and not isinstance(value, type):
        shifted = object.__new__(kind)
        shifted.__dict__.update(value.__dict__)
        for one in fields(value):
            shifted.__dict__[one.name] = _shifted_field(one.name, getattr(value, one.name), step_ns)
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        named = anything._asdict()
        shifted = anything._replace(**{name: _shifted_field(name, held, step_ns) for name, held in named.items()})
    elif isinstance(value, Mapping):
        shifted = kind({key: with_shifted_stamps(entry, step_ns) for key, entry in value.items()})
    return shifted  # type: ignore[no-any-return]


def _shifted_field(name: str, value: Any, step_ns: int) -> Any:
    return _shifted_stamps(value, step_ns) if name.endswith("_ns") else with_shifted_stamps(value, step_ns)


def _shifted_stamps(value: Any, step_ns: int) -> Any:
    if value is None:
        return None
    if isinstance(value, Mapping):
        kind: Any = type(value)
        return kind({key: _shifted_stamps(entry, step_ns) for key, entry in value.items()})
    if isinstance(value, np.ndarray):
        return np.where(value == NEVER_NS, value, value + step_ns)
    return value + step_ns


class Jump(Protocol):
    """A jump that a source itself reported or showed."""

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance of the change, in the components of :attr:`MemoryResidual.turn`, rad², shape (k, k)."""
        ...


State = TypeVar("State")
AnyJump = TypeVar("AnyJump", bound=Jump)


class Consistency(ABC, Generic[State, AnyJump]):
    """Consistency of an estimator's state with its sources and with a stored state.

    Args:
        jumps: jumps that sources themselves reported or showed; the streams of samples append here.
    """

    def __init__(self, jumps: deque[AnyJump]) -> None:
        self._jumps = jumps

    @property
    @abstractmethod
    def is_consistent(self) -> bool:
        """True if the state results from measurements, no source is excluded, and all sources are consistent."""

    @property
    @abstractmethod
    def has_unresolved_fault(self) -> bool:
        """True if the sources are inconsistent and no faulty source is isolated."""

    def take_jumps(self) -> list[AnyJump]:
        """Return the jumps that sources themselves reported or showed since the last call."""
        jumps = list(self._jumps)
        self._jumps.clear()
        return jumps

    @abstractmethod
    def propagate_memory(self, memory: State, jumps: Sequence[AnyJump]) -> State:
        """Return a stored state propagated to the oldest time that measurements may still have.

        The covariance of the state is inflated for the jumps.
        """

    @abstractmethod
    def memory_residuals(self, decision: Any, memory: State) -> Mapping[str, MemoryResidual]:
        """Return the residual of a measurement from a stored state, by source; empty without a residual."""

    @abstractmethod
    def largest_difference_sigmas(self, state: State, memory: State, is_later: bool = False) -> float:
        """Return the largest difference between a state and a stored state, in standard deviations of both.

        A later state of the same estimator depends on the stored state. The difference is then in standard deviations
        of the stored state alone.
        """

    @abstractmethod
    def unused_sources(self, sources: Set[str]) -> Set[str]:
        """Return the sources without a recently used measurement."""


class RecoverableCore(ABC, Generic[State, AnyJump]):
    """An estimator with immutable states that a second estimator can replace.

    A core also has a time-ordered estimator and the saved estimate from which it starts.

    Attributes:
        config: configuration; like the sky model an argument of the constructor.
        sky_model: sky model; None if no sensor needs it.
        consistency: consistency of the state with the sources and with a stored state.
    """

    config: Any
    sky_model: Any
    consistency: Consistency[State, AnyJump]
    _estimator: TimeOrderedEstimator[State, Any, Any, Any, Any]
    _start: Any

    @property
    def state(self) -> State:
        """State of the filter after the last applied measurement."""
        return self._estimator.state

    @property
    @abstractmethod
    def excluded_sources(self) -> Set[str]:
        """Names of the excluded sources."""

    def start_from(self, prior: Any, now_ns: int) -> list[str]:
        """Reset to a saved estimate; return remarks for the operator."""
        self._start = (prior, now_ns)
        return self.reset()

    @abstractmethod
    def reset(self, clock_jumped: bool = False) -> list[str]:
        """Discard all measurements; after a jump of the clock, outputs may start again at earlier times.

        Returns:
            Remarks about the saved estimate, if the core starts from a saved estimate.
        """

    def make_second(self, memory: State | None) -> Any:
        """Return another estimator of the same configuration, which starts from a stored state if given.

        Otherwise it starts from the saved estimate or the prior. With a stored state the estimator also gets the
        current position and air data.
        """
        second = self._new_estimator(None if self.sky_model is None else self.sky_model.clone(memory is not None))
        second._start = self._start
        if memory is None:
            second.reset()
        else:
            second._start_from_memory(memory, self)
        return second

    def _new_estimator(self, sky_model: Any) -> Any:
        """Return an estimator of the same class and configuration."""
        return type(self)(self.config, sky_model)  # type: ignore[call-arg]

    @abstractmethod
    def _start_from_memory(self, memory: State, live: Any) -> None:
        """Start from a stored state of another estimator."""

    @abstractmethod
    def take_over_outputs(self, live: Any) -> None:
        """Continue the sequence of outputs of another estimator, which ends."""
