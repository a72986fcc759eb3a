"""Exposures received within the lag: repeated stamps of a sensor, and contradictions of its sources."""

from collections.abc import Set
from dataclasses import replace

from ship_estimation.rejection_rules import CONFLICT_HOLD_S, Reason, Rejection, StampConflicts, resolve_same_stamp
from ship_stars.solution.exposure import StarExposure


class ReceivedExposures:
    """Received exposures of all star sensors.

    Args:
        sources: names of all sensors.

    Attributes:
        stamp_conflicts: sensors, position and air with conflicting data, or with two publishers.
    """

    def __init__(self, sources: Set[str]) -> None:
        self._sources = sources
        self.stamp_conflicts = StampConflicts()
        self.reset()

    def reset(self) -> None:
        """Discard all exposures and conflicts; two publishers of a source remain recorded."""
        self._exposures: dict[tuple[str, int], StarExposure] = {}
        self.stamp_conflicts.reset()

    def get(self, exposure: StarExposure) -> StarExposure | None:
        """Return the earlier exposure of the same sensor with the same stamp, or None."""
        return self._exposures.get((exposure.source, exposure.time_ns))

    def add(self, exposure: StarExposure) -> None:
        """Store an exposure, in place of one of the same sensor and stamp."""
        self._exposures[exposure.source, exposure.time_ns] = exposure

    def compare(self, known: StarExposure, exposure: StarExposure) -> Rejection:
        """Return the rejection of an exposure with the sensor and stamp of a known one: a duplicate or a conflict.

        Of two exposures in conflict neither is solved; a solution that was already published is replaced by an INVALID
        solution.
        """
        conflict = resolve_same_stamp(known, exposure)[1]
        if conflict.reason is Reason.DUPLICATE:
            return conflict
        self.stamp_conflicts.record(exposure.source, exposure.time_ns, conflict)
        return replace(conflict, text="the same stamp with different content: do two sensors publish on one topic?")

    def drop_before(self, time_ns: int) -> None:
        """Discard the exposures before a stamp."""
        self._exposures = {key: exposure for key, exposure in self._exposures.items() if exposure.time_ns >= time_ns}

    def contradiction(self, source: str, time_ns: int) -> Rejection | None:
        """Return the rejection for conflicting data of the sensor, the position or the air; None without a conflict."""
        contested = [
            name for name in self.stamp_conflicts.duplicate_publishers if name == source or name not in self._sources
        ]
        if contested:
            return Rejection(Reason.CONFLICT, self.stamp_conflicts.text(contested))
        if source not in self.stamp_conflicts.active_at(time_ns):
            return None
        text = f"its stars are used again after {CONFLICT_HOLD_S:g} s without a contradiction"
        return Rejection(Reason.CONFLICT, f"{self.stamp_conflicts.text([source])}: {text}")
