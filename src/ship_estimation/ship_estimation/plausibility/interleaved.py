"""Detection of two interleaved streams in values that alternate between two continuous streams.

Two publishers on one topic cause interleaved streams in a recording, which does not name publishers. A window of values
is fitted by a cubic in time. If the residuals form two narrow, distant groups and the values change between them
repeatedly, the window contains two streams.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.rotations import FloatArray

WINDOW = 32
"""Number of values of a window."""

_EVERY_NS = SECOND_NS // 2
"""Least time from the first value of a window to the first value of the next window. No value is skipped if a window
lasts longer."""

_FEWEST, _FEWEST_CHANGES = 3, 4
"""Least number of values in the smaller group, and of changes between the two groups."""

_SCATTERS = 8.0
"""Least distance of the two groups, in standard deviations within a group. Noise divided into two groups has a distance
of about 3."""

_STEPS = 5.0
"""Least distance of the two groups, in smallest steps within a group, if values are repeated. Rounding alone makes
groups that are one digit apart."""

_MOVES = 2.0
"""Least distance of the two groups, in largest changes of the value between two samples. Wrong stamps move a value by
up to one such change."""

_CLEAN = 2
"""Number of successive windows with one stream after which the source has one stream again."""


class _WindowResult(NamedTuple):
    """Distance of two streams in a window, 0 for one stream, and True if motion may explain the distance."""

    distance: float
    may_be_motion: bool = False


_ONE = _WindowResult(0.0)


class InterleavedStreams:
    """Detector of two streams in the values of one source, which are added in the order of arrival.

    Args:
        least: distance below which two streams count as one, in the unit of the values.

    Attributes:
        distance: distance of the two streams in the unit of the values; 0 for one stream.
        newest_ns: stamp of the last value; None before the first value.

    >>> streams = InterleavedStreams(least=0.01)
    >>> for n in range(64):
    ...     added = streams.add(n * 50_000_000, np.array([0.001 * math.sin(0.7 * n) + n % 2]))
    >>> round(streams.distance, 1)
    1.0
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self.distance = 0.0
        self.newest_ns: int | None = None
        self._times: list[int] = []
        self._values: list[FloatArray] = []
        self._due_ns = -1
        self._clean = 0

    def add(self, time_ns: int, value: FloatArray) -> bool:
        """Add a value, shape (n,); return True if the number of streams changed.

        A value between two windows is ignored.
        """
        self.newest_ns = time_ns
        if not self._times and self._due_ns - _EVERY_NS < time_ns < self._due_ns:
            return False
        self._times.append(time_ns)
        self._values.append(value)
        if len(self._times) < WINDOW:
            return False
        return self._evaluate_window()

    def count_before_change(self, times_ns: StampArray, values: FloatArray) -> int:
        """Return the number of leading values that leave the number of streams unchanged, without adding them.

        Args:
            times_ns: stamps in ascending order, shape (N,).
            values: values at these stamps, shape (N, n).
        """
        tried = InterleavedStreams(self._least)
        tried.distance, tried._due_ns, tried._clean = self.distance, self._due_ns, self._clean
        tried._times, tried._values = self._times.copy(), self._values.copy()
        return tried.add_all(times_ns, values)

    def add_all(self, times_ns: StampArray, values: FloatArray) -> int:
        """Add values until one changes the number of streams; return the number of values before the change."""
        start = 0
        if len(times_ns):
            self.newest_ns = int(times_ns[-1])
        while start < len(times_ns):
            if not self._times:
                start += int(times_ns[start:].searchsorted(self._due_ns)) if times_ns[start] < self._due_ns else 0
            stop = min(start + WINDOW - len(self._times), len(times_ns))
            self._times += times_ns[start:stop].tolist()
            self._values += list(values[start:stop])
            if len(self._times) == WINDOW and self._evaluate_window():
                return stop - 1
            start = stop
        return len(times_ns)

    def _evaluate_window(self) -> bool:
        """Evaluate a full window and start another window; return True if the number of streams changed."""
        result = _evaluate(np.array(self._times), np.array(self._values), self._least)
        self._due_ns = self._times[0] + _EVERY_NS
        self._times, self._values = [], []
        was_two = self.distance > 0.0
        if result.distance and (was_two or not result.may_be_motion):
            self._clean, self.distance = 0, result.distance
        elif was_two:
            self._clean += 1
            if self._clean >= _CLEAN:
                self._clean, self.distance = 0, 0.0
        return (self.distance > 0.0) is not was_two


def _evaluate(times_ns: StampArray, values: FloatArray, least: float) -> _WindowResult:
    """Evaluate the values of a window, in their order of arrival."""
    # A change between two streams makes a third difference of twice their distance. Smooth motion makes small
    # differences.
    thirds = np.diff(values, n=3, axis=0)
    if float(np.max(np.einsum("ij,ij->i", thirds, thirds))) < least**2:  # false for NaN
        return _ONE
    span_ns = int(times_ns.max() - times_ns.min())
    if span_ns == 0 or not np.isfinite(values).all():
        return _ONE
    at = (times_ns - times_ns.min()) / span_ns
    moved, design = values - values[0], np.column_stack([np.ones(WINDOW), at, at**2, at**3])
    left = moved - design @ np.linalg.lstsq(design, moved, rcond=None)[0]
    along = left @ left[np.argmax(np.einsum("ij,ij->i", left, left))]
    order = np.sort(along)
    widest = int(np.argmax(np.diff(order)[_FEWEST - 1 : WINDOW - _FEWEST])) + _FEWEST - 1
    upper = along > 0.5 * (order[widest] + order[widest + 1])
    if np.count_nonzero(upper[1:] != upper[:-1]) < _FEWEST_CHANGES:
        return _ONE
    design = np.column_stack([design, upper])
    fit = np.linalg.lstsq(design, moved, rcond=None)[0]
    left, distance = moved - design @ fit, float(np.linalg.norm(fit[4]))
    scatter = math.sqrt(float(np.sum(left * left)) / (WINDOW - 5))
    if not distance >= max(least, _SCATTERS * scatter, _STEPS * _smallest_step(moved, upper)):
        return _ONE
    ends = fit[1], fit[1] + 2.0 * fit[2] + 3.0 * fit[3]
    fastest = max(float(np.linalg.norm(slope)) for slope in ends)
    return _WindowResult(distance, distance < _MOVES * fastest * float(np.abs(np.diff(at)).max()))


def _smallest_step(values: FloatArray, upper: NDArray[np.bool_]) -> float:
    """Return the smallest step within a group; 0 if no value is repeated, infinite if all values are equal."""
    steps = np.concatenate([np.linalg.norm(np.diff(values[group], axis=0), axis=1) for group in (upper, ~upper)])
    return float(steps[steps > 0.0].min(initial=math.inf)) if np.any(steps == 0.0) else 0.0
