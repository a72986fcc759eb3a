"""Detection of several instruments of one kind in one stream by their talkers, and comparison of their values.

Two receivers or compasses in one log or on one line would be mixed on one topic.
"""

from collections import Counter

import numpy as np

from ship_bags.nmea.instrument_line import InstrumentLine
from ship_bags.nmea.sentences import number
from ship_geometry.rotations import FloatArray

_MAX_TALKERS = 20
"""Maximum number of compared talkers per kind of sentence; further talkers count as one."""
_OTHERS = "others"
_EARTH_M_PER_DEG = 111_000.0
_SIMULTANEOUS_NS = 5_000_000_000
"""Maximum interval between two values that are compared, ns."""


class TalkerComparison:
    """Comparison of the headings or positions of the talkers in one stream."""

    def __init__(self) -> None:
        self._counts: dict[str, Counter[str]] = {}
        self._last: dict[tuple[str, str], tuple[int, FloatArray]] = {}
        self._largest: dict[str, float] = {}

    def add(self, line: InstrumentLine) -> None:
        """Add a line that is used."""
        value = _value(line)
        if value is None or not line.talker:
            return
        counts = self._counts.setdefault(line.kind, Counter())
        talker = line.talker if line.talker in counts or len(counts) < _MAX_TALKERS else _OTHERS
        counts[talker] += 1
        if len(counts) > 1:
            for other in counts.keys() - {talker}:
                self._compare(line, value, other)
        self._last[line.kind, talker] = line.receive_ns, value

    def texts(self, since_ns: int = 0) -> list[str]:
        """Return one line for each kind of sentence that several talkers have sent since a time.

        The line states the largest difference so far.
        """
        found = []
        for kind, counts in sorted(self._counts.items()):
            recent = [talker for talker in sorted(counts) if self._last[kind, talker][0] >= since_ns]
            if len(recent) > 1:
                names = ", ".join(f"{talker} {counts[talker]}" for talker in recent)
                largest = self._largest.get(kind)
                difference = "" if largest is None else f", up to {_quantity(kind, largest)} apart"
                found.append(f"{kind} of several talkers ({names}){difference}")
        return found

    def _compare(self, line: InstrumentLine, value: FloatArray, other: str) -> None:
        time_ns, others = self._last.get((line.kind, other), (0, value))
        if 0 <= line.receive_ns - time_ns <= _SIMULTANEOUS_NS:
            self._largest[line.kind] = max(self._largest.get(line.kind, 0.0), _difference(line.kind, value, others))


def _value(line: InstrumentLine) -> FloatArray | None:
    """Return the heading or the position in a line, degrees; None for any other line."""
    if line.kind in ("HDT", "THS"):
        heading_deg = number(line.content.heading)
        return None if heading_deg is None else np.array([heading_deg])
    if line.kind == "GGA" and line.content.lat:
        return np.array([line.content.latitude, line.content.longitude])
    return None


def _difference(kind: str, one: FloatArray, other: FloatArray) -> float:
    """Return the distance of two positions in metres, or the angle between two headings in degrees."""
    difference_deg = (one - other + 180.0) % 360.0 - 180.0
    if kind != "GGA":
        return float(abs(difference_deg[0]))
    north_east = difference_deg * [1.0, np.cos(np.deg2rad(one[0]))]
    return float(np.linalg.norm(north_east)) * _EARTH_M_PER_DEG


def _quantity(kind: str, value: float) -> str:
    return f"{value:.0f} m" if kind == "GGA" else f"{value:.1f}°"
