"""State of fault detection: innovation means, excluded sources and an unresolved fault.

States are immutable, so the time-ordered log can store states and go back to any of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from ship_estimation.fault_detection.exclusions import ExcludedSource
from ship_estimation.fault_detection.innovation_means import InnovationMeans
from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_geometry.rotations import FloatArray

__all__ = ["FaultState", "UnresolvedFault", "with_changes", "with_entry", "without_entry"]

Value = TypeVar("Value")

if TYPE_CHECKING:
    from dataclasses import replace as with_changes
else:

    def with_changes(of, **fields):
        """Return a copy of a frozen dataclass with some fields replaced.

        The function takes a fifth of the time of ``dataclasses.replace``, because ``__init__`` and ``__post_init__``
        are not called. A filter step replaces fields several times.

        Example:
            >>> with_changes(UnresolvedFault("a contradiction", None), consistent_since_ns=5).consistent_since_ns
            5
        """
        after = object.__new__(type(of))
        after.__dict__.update(of.__dict__, **fields)
        return after


@dataclass(frozen=True)
class UnresolvedFault:
    """A fault that is detected and not isolated.

    Attributes:
        text: description for the user.
        covariance_n: covariance that an output adds for the contradiction; rotation vector in the horizon frame, rad²,
            shape (3, 3).
        is_persistent: False for a contradiction that ends with the next accepted measurement.
        consistent_since_ns: stamp since which measurements have been accepted without a detected fault; None before
            that, and after a gap in the measurements.
    """

    text: str
    covariance_n: FloatArray
    is_persistent: bool = True
    consistent_since_ns: int | None = None


@dataclass(frozen=True, kw_only=True)
class FaultState:
    """State of fault detection, for h filters and s measured sources.

    Attributes:
        innovation_means: windowed innovation means of each source in each filter.
        excluded: excluded sources by name.
        unresolved_fault: fault that is detected and not isolated; None without such a fault.
    """

    innovation_means: InnovationMeans
    excluded: Mapping[str, ExcludedSource] = field(default_factory=lambda: MappingProxyType({}))
    unresolved_fault: UnresolvedFault | None = None

    def in_use(self, sources: Sequence[str], time_ns: int) -> list[str]:
        """Return the sources, in the given order, that are not excluded and have measured recently."""
        received = zip(sources, self.innovation_means.last_measured_ns.tolist(), strict=True)
        since_ns = time_ns - MAX_MEASUREMENT_AGE_NS
        return [name for name, measured_ns in received if measured_ns >= since_ns and name not in self.excluded]


def with_entry(mapping: Mapping[str, Value], key: str, value: Value) -> MappingProxyType[str, Value]:
    """Return a copy of a mapping with one entry set.

    Example:
        >>> dict(with_entry({"ins": 1}, "star.fore", 2))
        {'ins': 1, 'star.fore': 2}
    """
    return MappingProxyType({**mapping, key: value})


def without_entry(mapping: Mapping[str, Value], key: str) -> MappingProxyType[str, Value]:
    """Return a copy of a mapping without one key.

    Example:
        >>> dict(without_entry({"ins": 1, "star.fore": 2}, "ins"))
        {'star.fore': 2}
    """
    return MappingProxyType({name: value for name, value in mapping.items() if name != key})
