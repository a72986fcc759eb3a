"""Gaps between the messages of a node's inputs, and delays between their stamps and log times.

A recorder that stalls logs the waiting messages in a burst when it continues, so a replay by log time sees a gap and
then a burst. In a replay by stamps every message arrives at its stamp, without such gaps.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Any

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_bags.mcap.bag_reader import BagRecord
from ship_bags.stamps import NS_PER_S, stamp_of_bytes, utc_text
from ship_estimation.parameters.schema import flatten
from theodolite_calib.config import OpticalAxisConfig

_MAJORITY_SHARE = 0.5
"""A limit counts as a configuration error if gaps longer than the limit take more than this share of the time."""

_MIN_REPORTED_SHARE = 0.01
_MARGIN_SHARE = 0.5
"""If the median gap is longer than this share of a limit, gaps may exceed the limit although no message was lost."""

_REORDER_DEPTH = 1000
"""Number of times buffered for sorting."""

_GAP_RESOLUTION_NS = 100_000

LATE_NS = NS_PER_S // 2
"""Excess of a delay over the median of its topic above which a message counts as logged late, ns."""

MAX_STAMP_OFFSET_NS = 60 * NS_PER_S
"""Maximum difference between a stamp and the time expected from the log time, ns; a stamp beyond is not used."""

_DELAY_RESOLUTION_NS = 1_000_000


@dataclass(frozen=True)
class GapLimit:
    """A parameter that limits the time between two messages of a topic.

    Attributes:
        topic: relative name of the topic.
        parameter: dotted name of the parameter, whose value is in seconds.
        by_arrival: True for gaps between arrivals, False for gaps between stamps.
        meaning: effect of a longer gap.
    """

    topic: str
    parameter: str
    by_arrival: bool
    meaning: str


@dataclass(frozen=True)
class ExceededLimit:
    """A limit exceeded by the gaps between the messages of its topic.

    Attributes:
        limit: limit that is exceeded.
        text: text with parameter, value, actual gaps, effect and advice.
        is_most_of_the_time: True if most of the time lies in gaps longer than the limit.
    """

    limit: GapLimit
    text: str
    is_most_of_the_time: bool


class Gaps:
    """Statistics of the gaps between nearly sorted times, in constant memory."""

    def __init__(self) -> None:
        self._pending: list[int] = []
        self._last_ns: int | None = None
        self._counts: Counter[int] = Counter()

    def add(self, time_ns: int) -> None:
        """Add a time. Times may be out of order by up to `_REORDER_DEPTH` places; times further out are ignored."""
        heappush(self._pending, time_ns)
        if len(self._pending) > _REORDER_DEPTH:
            self._count_gap(heappop(self._pending))

    def add_block(self, times_ns: np.ndarray) -> None:
        """Add times, with the same result as :meth:`add` for each time."""
        if np.any(np.diff(times_ns) < 0):
            for time_ns in times_ns.tolist():
                self.add(time_ns)
            return
        ordered = sorted([*self._pending, *times_ns.tolist()])
        counted, self._pending = ordered[:-_REORDER_DEPTH], ordered[-_REORDER_DEPTH:]  # a list in order is a heap
        if not counted:
            return
        last_ns = counted[0] if self._last_ns is None else self._last_ns
        later_ns = np.maximum.accumulate([last_ns, *counted])
        gaps_ns = np.diff(later_ns)
        lengths, counts = np.unique(np.rint(gaps_ns[gaps_ns > 0] / _GAP_RESOLUTION_NS), return_counts=True)
        for length, count in zip(lengths.tolist(), counts.tolist(), strict=True):
            self._counts[int(length)] += count
        self._last_ns = int(later_ns[-1])

    def seconds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lengths of the gaps in ascending order, s, and the count of each. Equal times make no gap."""
        while self._pending:
            self._count_gap(heappop(self._pending))
        lengths = sorted(self._counts)
        return np.array(lengths) * _GAP_RESOLUTION_NS / NS_PER_S, np.array([self._counts[length] for length in lengths])

    @property
    def rate_hz(self) -> float:
        """Rate from the median gap; 0 without gaps, or if the median gap is below the resolution."""
        lengths_s, counts = self.seconds()
        if not len(counts):
            return 0.0
        median_s = lengths_s[np.searchsorted(np.cumsum(counts), 0.5 * counts.sum())]
        return float(1.0 / median_s) if median_s > 0.0 else 0.0

    def _count_gap(self, time_ns: int) -> None:
        if self._last_ns is not None and time_ns > self._last_ns:
            self._counts[round((time_ns - self._last_ns) / _GAP_RESOLUTION_NS)] += 1
        self._last_ns = time_ns if self._last_ns is None else max(time_ns, self._last_ns)


class MessageTimes:
    """Stamps and arrival times of the messages of a topic."""

    def __init__(self) -> None:
        self.stamps, self.arrivals = Gaps(), Gaps()

    def add(self, record: BagRecord) -> None:
        """Add a message. Every input begins with a header; the rest of the message is not decoded."""
        self.arrivals.add(record.log_time_ns)
        stamp_ns = stamp_of_bytes(record.data)
        if stamp_ns is not None:
            self.stamps.add(stamp_ns)

    def add_block(self, stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> None:
        """Add messages, with the same result as :meth:`add` for each message."""
        self.arrivals.add_block(log_times_ns)
        self.stamps.add_block(stamps_ns)


def gap_limits(config: Any) -> Iterator[GapLimit]:
    """Yield the parameters that limit the gaps between a node's inputs.

    Args:
        config: configuration of a node; only for ``optical_axis`` and nodes with an INS a parameter is yielded.
    """
    if isinstance(config, OpticalAxisConfig):
        group = "ins" if config.ship.source == "ins/imu" else "ship"
        yield _between_stamps(config.ship.source, f"{group}.max_gap_s", "there is no pointing")
        yield _between_stamps("theodolite/encoder", "encoder.max_gap_s", "there is no pointing")
        for id_ in config.beacons:
            yield _between_stamps(f"beacon/{id_}/baseline", f"beacons.{id_}.rtk.max_gap_s", "its light is not used")
            yield _between_stamps(f"beacon/{id_}/imu", f"beacons.{id_}.imu.max_gap_s", "its light is not used")
    elif hasattr(config, "ins"):
        yield _between_stamps("ins/imu", "ins.max_gap_s", "stars are not compared with the INS")
    if isinstance(config, ShipAttitudeConfig):
        yield GapLimit("ins/imu", "ins.silence_s", True, "the INS times out, and without stars the output is INVALID")


def exceeded_limits(config: Any, times: dict[str, MessageTimes], source: str) -> Iterator[ExceededLimit]:
    """Yield the limits of a node that are exceeded by gaps which take more than 1 % of the time.

    Args:
        config: configuration of the node.
        times: stamps and arrival times by relative topic.
        source: origin of the messages, for the text.
    """
    for limit in gap_limits(config):
        if limit.topic not in times:
            continue
        own = times[limit.topic]
        lengths_s, counts = (own.arrivals if limit.by_arrival else own.stamps).seconds()
        allowed_s = float(flatten(config)[limit.parameter])
        times_s = lengths_s * counts
        # All gaps may be shorter than the resolution, so that their sum is zero.
        share = times_s[lengths_s > allowed_s].sum() / max(times_s.sum(), 1e-9)
        if share > _MIN_REPORTED_SHARE:
            yield ExceededLimit(
                limit, _limit_text(limit, allowed_s, lengths_s, counts, source), share > _MAJORITY_SHARE
            )


def _between_stamps(topic: str, parameter: str, meaning: str) -> GapLimit:
    return GapLimit(topic, parameter, False, f"no interpolation across such a gap, and {meaning}")


def _limit_text(limit: GapLimit, allowed_s: float, lengths_s: np.ndarray, counts: np.ndarray, source: str) -> str:
    usual_s = float(lengths_s[np.searchsorted(np.cumsum(counts), counts.sum() / 2)])
    how_far = f"{usual_s:.4g} s apart" if usual_s > allowed_s else f"up to {lengths_s[-1]:.4g} s apart"
    advice = "look for lost messages"
    if usual_s > _MARGIN_SHARE * allowed_s:
        resample = " (import_nmea --resample HZ)" if limit.topic == "ins/imu" else ""
        advice = f"record it more often{resample}, or set '{limit.parameter}' to {1.5 * max(usual_s, allowed_s):.2g}"
    longer = f"{counts[lengths_s > allowed_s].sum()} of {counts.sum()} gaps are longer"
    return (
        f"parameter '{limit.parameter}' = {allowed_s:g} s, but messages of '{limit.topic}' in {source} "
        f"{'arrive' if limit.by_arrival else 'are stamped'} {how_far} ({longer}): {limit.meaning}; {advice}"
    )


class LogDelays:
    """Statistics of log time minus stamp by topic, in constant memory."""

    def __init__(self) -> None:
        self._delays: dict[str, Counter[int]] = {}
        self._latest: dict[str, tuple[int, int]] = {}

    def add(self, topic: str, record: BagRecord) -> None:
        """Add a message; a message without a stamp is ignored."""
        stamp_ns = stamp_of_bytes(record.data)
        if not stamp_ns:
            return
        delay_ns = record.log_time_ns - stamp_ns
        self._delays.setdefault(topic, Counter())[round(delay_ns / _DELAY_RESOLUTION_NS)] += 1
        self._latest[topic] = max(self._latest.get(topic, (delay_ns, 0)), (delay_ns, record.log_time_ns))

    def add_block(self, topic: str, stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> None:
        """Add messages, with the same result as :meth:`add` for each message."""
        stamped = stamps_ns != 0
        if not stamped.any():
            return
        log_times_ns, delays_ns = log_times_ns[stamped], (log_times_ns - stamps_ns)[stamped]
        counts = self._delays.setdefault(topic, Counter())
        lengths, numbers = np.unique(np.rint(delays_ns / _DELAY_RESOLUTION_NS), return_counts=True)
        for length, number in zip(lengths.tolist(), numbers.tolist(), strict=True):
            counts[int(length)] += number
        # Index of the largest delay; the last index if several delays are equal.
        place = len(delays_ns) - 1 - int(np.argmax(delays_ns[::-1]))
        latest = int(delays_ns[place]), int(log_times_ns[place])
        self._latest[topic] = max(self._latest.get(topic, (latest[0], 0)), latest)

    def median_ns(self) -> int:
        """Return the median of log time minus stamp over all messages; 0 if no message has a stamp."""
        return _median_ns(sum(self._delays.values(), Counter[int]()))

    def irregularity_text(self) -> str:
        """Return one line about messages logged late; empty if no message was late."""
        late, most_ns, topic_of_most, at_ns = 0, 0, "", 0
        for topic, delays in self._delays.items():
            usual_ns = _median_ns(delays)
            late += sum(count for delay, count in delays.items() if delay * _DELAY_RESOLUTION_NS - usual_ns > LATE_NS)
            longest_ns, when_ns = self._latest[topic]
            if longest_ns - usual_ns > most_ns:
                most_ns, topic_of_most, at_ns = longest_ns - usual_ns, topic, when_ns
        if not late:
            return ""
        count = sum(sum(delays.values()) for delays in self._delays.values())
        return (
            f"log times are irregular: {late} of {count} messages were logged more than {LATE_NS / NS_PER_S:g} s later "
            f"after their stamps than usual, the most by {most_ns / NS_PER_S:.2f} s ({topic_of_most} at "
            f"{utc_text(at_ns)}): the recorder stalled, or the data arrived late"
        )


def sort_by_stamp(records: Iterator[BagRecord], usual_ns: int) -> Iterator[BagRecord]:
    """Yield the records of a bag in order of their stamps, which replace the log times; equal stamps keep their order.

    A message without a stamp, or with a stamp far from its log time, gets its log time minus the usual delay.

    Args:
        records: records in order of log time.
        usual_ns: median of log time minus stamp.
    """
    pending: list[tuple[int, int, BagRecord]] = []
    for number, record in enumerate(records):
        logged_ns = record.log_time_ns - usual_ns
        stamp_ns = stamp_of_bytes(record.data)
        record.log_time_ns = stamp_ns if stamp_ns and abs(stamp_ns - logged_ns) <= MAX_STAMP_OFFSET_NS else logged_ns
        heappush(pending, (record.log_time_ns, number, record))
        # No record that follows can have an earlier time.
        while pending[0][0] < logged_ns - MAX_STAMP_OFFSET_NS:
            yield heappop(pending)[2]
    while pending:
        yield heappop(pending)[2]


def _median_ns(delays: Counter[int]) -> int:
    middle, seen = (delays.total() + 1) // 2, 0
    for delay in sorted(delays):
        seen += delays[delay]
        if seen >= middle:
            return delay * _DELAY_RESOLUTION_NS
    return 0
