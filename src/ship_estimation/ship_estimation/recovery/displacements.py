"""Displacements of all sources of an estimator, to find out whether one source or all together have moved.

A rotation that all sources have in common is measured by their weighted mean, because one star sensor measures a
rotation about its line of sight poorly. A source that moves by itself changes that mean, too.
"""

from ship_estimation.recovery.displacement import Displacement, MemoryResidual
from ship_geometry.rotations import FloatArray

TOGETHER = "all together"
"""Name of the displacement that all sources have in common."""


class Displacements:
    """The displacement of each source, and the displacement of all sources together."""

    def __init__(self) -> None:
        self._by_source: dict[str, Displacement] = {}
        self._together = Displacement()

    def add(self, source: str, residual: MemoryResidual) -> None:
        """Add a measurement of a source."""
        for displacement in (self._by_source.setdefault(source, Displacement()), self._together):
            displacement.add(residual)

    def inflate(self, covariance: FloatArray) -> None:
        """Add the covariance of a jump that a source (for example the INS) itself showed, rad², shape (k, k)."""
        for displacement in (*self._by_source.values(), self._together):
            displacement.inflate(covariance)

    def end_second(self) -> None:
        """Compare the measurements of the last second with earlier measurements."""
        for displacement in (*self._by_source.values(), self._together):
            displacement.end_second()

    @property
    def displaced(self) -> dict[str, float]:
        """Sources that have moved and not moved back, with their largest displacement, rad; :data:`TOGETHER` for all.

        A source has moved by itself only if another source has not moved with it. The result is empty if the weighted
        mean of all sources is not displaced.
        """
        if not self._together.is_displaced:
            return {}
        moved = {name: one for name, one in self._by_source.items() if one.is_displaced}
        if any(other.has_not_moved_as(one) for one in moved.values() for other in self._by_source.values()):
            return {name: one.largest_rad for name, one in moved.items()}
        return {TOGETHER: self._together.largest_rad}

    @property
    def is_undecided_by_memory(self) -> bool:
        """True if all sources have moved together by an amount that the stored state cannot show."""
        return TOGETHER in self.displaced and self._together.is_beyond_memory
