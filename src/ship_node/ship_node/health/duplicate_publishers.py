"""Detection of two publishers on one input; which publisher is right is unknown.

A live node finds the active publishers by the sequence numbers of their messages. The middleware numbers the messages
of each publisher from 1. The numbers of one publisher increase; the numbers of two publishers alternate. The ROS graph
is not sufficient: a publisher may never send, and a killed publisher stays in the graph until its lease ends.

In a recording only the values reveal two publishers, as two continuous streams that alternate
(:mod:`ship_estimation.plausibility.interleaved`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ship_estimation.plausibility.interleaved import InterleavedStreams
from ship_geometry.earth.geodetic import ecef_from_geodetic
from ship_geometry.earth.time_scales import SECOND_NS, StampArray
from ship_geometry.rotations import ARCSEC, FloatArray

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
