"""Exclusions and reinstatements of sources in a run, with their times, from the Integrity messages."""

from dataclasses import dataclass
from typing import Any

from ship_bags.stamps import NS_PER_S, ns_from_stamp

INTEGRITY_TOPICS = {"ship/attitude": "ship/integrity", "theodolite/pointing": "theodolite/integrity"}
"""Topic of an output → topic of its protection levels and excluded sources."""


@dataclass
class ExclusionSpan:
    """One exclusion of a source.

    Attributes:
        source: name of the source.
        start_ns: stamp from which the source is excluded.
        end_ns: stamp of the first Integrity message without the source; None if it is still excluded at the end.
    """

    source: str
    start_ns: int
    end_ns: int | None = None


class ExclusionHistory:
    """Exclusions reported by one output's Integrity messages, in order of their beginning."""

    def __init__(self) -> None:
        self._exclusions: list[ExclusionSpan] = []
        self._current: dict[str, ExclusionSpan] = {}

    def add(self, message: Any) -> None:
        """Add the next Integrity message in order of stamps."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        for source in [source for source in self._current if source not in message.excluded]:
            self._current.pop(source).end_ns = stamp_ns
        for source, excluded_for_s in zip(message.excluded, message.excluded_for_s, strict=False):
            if source not in self._current:
                exclusion = ExclusionSpan(source, stamp_ns - round(excluded_for_s * NS_PER_S))
                self._current[source] = exclusion
                self._exclusions.append(exclusion)

    def lines(self, start_ns: int) -> list[str]:
        """Return one line per exclusion, with times in seconds from `start_ns`."""
        lines = []
        for one in self._exclusions:
            line = f"  {one.source} excluded at {(one.start_ns - start_ns) / NS_PER_S:.1f} s"
            if one.end_ns is None:
                lines.append(f"{line}, still excluded at the end")
            else:
                lines.append(f"{line}, reinstated at {(one.end_ns - start_ns) / NS_PER_S:.1f} s")
        return lines
