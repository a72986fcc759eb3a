"""Detection of two publishers on one input; which publisher is right is unknown.

A live node finds the active publishers by the sequence numbers of their messages. The middleware numbers the messages
of each publisher from 1. The numbers of one publisher increase; the numbers of two publishers alternate. The ROS graph
is not sufficient: a publisher may never send, and a killed publisher stays in the graph until its lease ends.

In a recording only the values reveal two publishers, as two continuous streams that alternate. A window of values is
fitted by a cubic in time. If the residuals form two narrow, distant groups and the values change between them
repeatedly, the window contains two streams.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_geometry.earth.geodetic import ecef_from_geodetic
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.rotations import ARCSEC, FloatArray

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

_ROTATION = np.sqrt(2.0)
"""Distance of two rotation matrices (all nine elements) per radian of a small angle between them."""

_TIMEOUT_NS = 30 * SECOND_NS
"""Time without values after which two detected streams count as one again, ns."""

UNNUMBERED = 2**64 - 1
"""Number of every message if the middleware does not count messages (CycloneDDS); publishers are then unknown."""

MIN_TIMEOUT_NS = 1_000_000_000
"""Minimum timeout of a publisher, ns."""

_TIMEOUT_PERIODS = 3
"""Timeout of a publisher in units of its longest interval between two messages."""

_REMOVAL_TIMEOUT_NS = 10_000_000_000
"""Time without a message after which a publisher is removed, ns."""

_MIN_RETURNS = 2
"""Minimum number of returns that shows two publishers.

A return is a message of a known publisher after a message of another publisher. A restart of a publisher causes no
return. A message lost after a restart may cause one, when the new numbers pass the last number before the restart.
"""


class StreamQuantity(NamedTuple):
    """Quantity of an input that is continuous within one stream.

    Attributes:
        quantity: returns the quantity of a value, shape (n,).
        min_distance: distance of two streams below which they count as one.
        distance_text: returns a distance as text.
    """

    quantity: Callable[[Any], FloatArray]
    min_distance: float
    distance_text: Callable[[float], str]


def _degrees(angle_rad: float) -> str:
    return f"{np.degrees(angle_rad):.3g}° apart"


def _metres(distance_m: float) -> str:
    return f"{distance_m:.3g} m apart"


ATTITUDE = StreamQuantity(
    lambda sample: sample.rotation_nd.ravel(),
    30.0 * ARCSEC * _ROTATION,
    lambda distance: _degrees(2.0 * np.arcsin(min(distance / (2.0 * _ROTATION), 1.0))),
)
"""Attitude; the minimum distance, 30″, is six times the noise of a coarse system."""


def _normalised_residual(decision: Any) -> FloatArray:
    """Return the innovation in standard deviations of the measurement noise, which is at least 0.1″."""
    in_sigmas: FloatArray = decision.residual / np.sqrt(np.maximum(decision.noise.diagonal(), (0.1 * ARCSEC) ** 2))
    return in_sigmas


INNOVATION = StreamQuantity(
    _normalised_residual,
    10.0,
    lambda distance: f"{distance:.0f} sigma of their noise apart",
)
"""Innovation of an attitude in standard deviations of its noise; it does not depend on the ship's motion."""

POSITION = StreamQuantity(lambda fix: ecef_from_geodetic(fix.position), 5.0, _metres)
"""Position fix; the minimum distance, 5 m, corresponds to 0.2″ of the horizon."""

BASELINE = StreamQuantity(lambda sample: sample.vector, 0.05, _metres)
"""Baseline to a drone."""

ENCODERS = StreamQuantity(
    lambda sample: np.concatenate([np.cos(sample.vector), np.sin(sample.vector)]), 10.0 * ARCSEC, _degrees
)
"""Both encoder angles, modulo a full turn."""


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


class DuplicatePublishers:
    """Inputs on which two publishers send, by the middleware's information and by the values.

    Args:
        continuous: topic → continuous quantity, for the inputs whose values are checked.
    """

    def __init__(self, continuous: dict[str, StreamQuantity]) -> None:
        self._quantities = continuous
        self.restart()
        self._publisher_texts: dict[str, str] = {}

    def restart(self) -> None:
        """Reset the value checks, after the clock went back or stepped, or the node was reset."""
        self._streams = {topic: InterleavedStreams(kind.min_distance) for topic, kind in self._quantities.items()}
        # For each topic with two streams: stamp of its newest value, and timeout-clock time at which this stamp was
        # found.
        self._newest_stamps: dict[str, tuple[int | None, int]] = {}

    def end_timed_out(self, waiting_ns: int) -> list[str]:
        """End each pair of streams without a value for 30 s; return the topics of these pairs.

        Args:
            waiting_ns: time by the timeout clock.
        """
        doubled = {topic: streams.newest_ns for topic, streams in self._streams.items() if streams.distance}
        self._newest_stamps = {topic: self._newest_stamps.get(topic, (None, 0)) for topic in doubled}
        timed_out = []
        for topic, newest_ns in doubled.items():
            if newest_ns != self._newest_stamps[topic][0]:
                self._newest_stamps[topic] = newest_ns, waiting_ns
            elif waiting_ns - self._newest_stamps[topic][1] > _TIMEOUT_NS:
                self._streams[topic] = InterleavedStreams(self._quantities[topic].min_distance)
                timed_out.append(topic)
        return timed_out

    def set_publisher_text(self, topic: str, text: str) -> None:
        """Set the text about two publishers that the middleware reports for a topic; an empty text ends this state.

        The end also restarts the topic's value check, which for slow messages would otherwise report two streams for
        another minute.
        """
        if text:
            self._publisher_texts[topic] = text
        elif self._publisher_texts.pop(topic, None) is not None and topic in self._streams:
            self._streams[topic] = InterleavedStreams(self._quantities[topic].min_distance)

    def text(self, topic: str) -> str:
        """Return the text for the user if two publishers send on a topic; empty otherwise."""
        streams = self._streams.get(topic)
        if topic in self._publisher_texts or streams is None or not streams.distance:
            return self._publisher_texts.get(topic, "")
        distance = self._quantities[topic].distance_text(streams.distance)
        return f"two streams alternate on {topic}, {distance}: stop one of its two publishers"

    def add_value(self, topic: str, time_ns: int, value: Any) -> bool:
        """Add a value of a topic; return True if the text may have changed."""
        streams = self._streams.get(topic)
        return streams is not None and streams.add(time_ns, self._quantities[topic].quantity(value))

    def count_before_change(self, topic: str, times_ns: StampArray, rotations_nd: FloatArray) -> int:
        """Return the number of leading attitudes of a block that change no text."""
        return self._streams[topic].count_before_change(times_ns, rotations_nd.reshape(-1, 9))

    def add_block(self, topic: str, times_ns: StampArray, rotations_nd: FloatArray) -> None:
        """Add the attitudes of a block, which change no text."""
        self._streams[topic].add_all(times_ns, rotations_nd.reshape(-1, 9))


@dataclass
class _Publisher:
    """Publisher, by its messages.

    Attributes:
        number: sequence number of its last message.
        last_ns: receive time of its last message by the steady clock.
        longest_ns: longest interval between two of its messages.
    """

    number: int
    last_ns: int
    longest_ns: int = 0

    def is_timed_out(self, now_ns: int) -> bool:
        """Return True if the publisher has timed out."""
        return now_ns - self.last_ns > max(MIN_TIMEOUT_NS, _TIMEOUT_PERIODS * self.longest_ns)


class ActivePublishers:
    """Active publishers of one topic.

    >>> publishers = ActivePublishers()
    >>> [publishers.add_message(number, n * 10_000_000) for n, number in enumerate((700, 701, 1, 702, 2, 703))]
    [False, False, False, False, True, True]
    """

    def __init__(self) -> None:
        self._publishers: list[_Publisher] = []
        self._latest: _Publisher | None = None
        self._returns = 0

    def add_message(self, number: int, now_ns: int) -> bool:
        """Add a message by its sequence number and steady time, ns; return True if two publishers send."""
        if number == UNNUMBERED:
            return False
        latest = self._latest
        if len(self._publishers) == 1 and latest is not None and number > latest.number:
            # This is the case for nearly every message.
            latest.longest_ns = max(latest.longest_ns, now_ns - latest.last_ns)
            latest.number, latest.last_ns = number, now_ns
            return False
        self._publishers = [each for each in self._publishers if now_ns - each.last_ns <= _REMOVAL_TIMEOUT_NS]
        earlier = [each for each in self._publishers if each.number < number]
        # If two publishers have the same number, the message counts for the latest publisher.
        found = max(earlier, key=lambda each: (each.number, each is latest), default=None)
        if found is None:
            found = _Publisher(number, now_ns)
            self._publishers.append(found)
            self._returns = 0
        else:
            self._returns += found is not latest
            found.longest_ns = max(found.longest_ns, now_ns - found.last_ns)
            found.number, found.last_ns = number, now_ns
        self._latest = found
        return self.has_two(now_ns)

    def has_two(self, now_ns: int) -> bool:
        """Return True if two publishers send: each has continued after the other, and neither has timed out."""
        return self._returns >= _MIN_RETURNS and sum(not each.is_timed_out(now_ns) for each in self._publishers) >= 2

    def keep_latest(self) -> None:
        """Keep only the latest publisher, because the middleware lists no other publisher."""
        self._publishers, self._returns = [self._latest] if self._latest is not None else [], 0


def publisher_names(publishers: Sequence[Any]) -> list[str]:
    """Return the full names of the nodes of publishers, from rclpy's endpoint information, in alphabetical order."""
    names = (f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in publishers)
    return sorted("a node without a name" if "_UNKNOWN_" in name else name for name in names)


def duplicate_publishers_text(topic: str, names: Sequence[str]) -> str:
    """Return the text for the user about two publishers of a topic, with the names of their nodes if both are known."""
    publishers = " and ".join(names) if len(names) > 1 else "the middleware does not name both nodes"
    return f"two publishers send on {topic}: {publishers}; stop all but one"
