"""When the messages of a node's inputs come: how far apart they are and may be, and how regularly they were logged.

A recorder that stalls notes what came meanwhile when it goes on, so that a replay by log time meets silence and then a
flood. By the stamps, every message arrives at its own time of validity, whatever the recorder did.
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
from ship_estimation.parameters import flatten
from theodolite_calib.config import OpticalAxisConfig

_MOST_OF_THE_TIME = 0.5
"""Share of the time in gaps longer than a limit from which on the configuration does not serve."""

_WORTH_SAYING = 0.01
_TOO_NEAR = 0.5
"""Gaps that are usually longer than this share of a limit exceed it now and then, though nothing was lost."""

_REACH = 1000
"""Times that wait to be put in order."""

_GAP_RESOLUTION_NS = 100_000

LATE_NS = NS_PER_S // 2
"""A message that was logged so much later after its stamp than its topic's usually are was held up, ns."""

FAR_NS = 60 * NS_PER_S
"""A stamp so far from where the log time puts its message is no time to go by, ns."""

_DELAY_RESOLUTION_NS = 1_000_000


@dataclass(frozen=True)
class GapLimit:
    """A parameter that bounds the time between two messages of a topic.

    Attributes:
        topic: relative name.
        parameter: dotted name; its value is in seconds.
        by_arrival: between arrivals, otherwise between stamps.
        meaning: what a longer gap leads to.
    """

    topic: str
    parameter: str
    by_arrival: bool
    meaning: str


@dataclass(frozen=True)
class Exceeded:
    """A limit that is exceeded by the gaps between the messages of its topic.

    Attributes:
        limit: which one.
        text: in words: parameter, value, what the messages do, what follows, what to do.
        mostly: whether most of the time lies in such gaps.
    """

    limit: GapLimit
    text: str
    mostly: bool


class Gaps:
    """Gaps between times that come nearly in order; memory does not grow with their number."""

    def __init__(self) -> None:
        self._waiting: list[int] = []
        self._last_ns: int | None = None
        self._counts: Counter[int] = Counter()

    def add(self, time_ns: int) -> None:
        """Note a time. A time that comes later than _REACH others that it belongs before is left out."""
        heappush(self._waiting, time_ns)
        if len(self._waiting) > _REACH:
            self._take(heappop(self._waiting))

    def add_block(self, times_ns: np.ndarray) -> None:
        """Note times, as by :meth:`add` of each."""
        if np.any(np.diff(times_ns) < 0):
            for time_ns in times_ns.tolist():
                self.add(time_ns)
            return
        ordered = sorted([*self._waiting, *times_ns.tolist()])
        taken, self._waiting = ordered[:-_REACH], ordered[-_REACH:]  # a list in order is a heap
        if not taken:
            return
        last_ns = taken[0] if self._last_ns is None else self._last_ns
        later_ns = np.maximum.accumulate([last_ns, *taken])
        gaps_ns = np.diff(later_ns)
        lengths, counts = np.unique(np.rint(gaps_ns[gaps_ns > 0] / _GAP_RESOLUTION_NS), return_counts=True)
        for length, count in zip(lengths.tolist(), counts.tolist(), strict=True):
            self._counts[int(length)] += count
        self._last_ns = int(later_ns[-1])

    def seconds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lengths of the gaps in ascending order, s, and how many there are of each. Equal times are no gap."""
        while self._waiting:
            self._take(heappop(self._waiting))
        lengths = sorted(self._counts)
        return np.array(lengths) * _GAP_RESOLUTION_NS / NS_PER_S, np.array([self._counts[length] for length in lengths])

    @property
    def rate_hz(self) -> float:
        """Rate by the median of the gaps; 0 where there is none."""
        lengths_s, counts = self.seconds()
        if not len(counts):
            return 0.0
        median_s = lengths_s[np.searchsorted(np.cumsum(counts), 0.5 * counts.sum())]
        return float(1.0 / median_s) if median_s > 0.0 else 0.0

    def _take(self, time_ns: int) -> None:
        if self._last_ns is not None and time_ns > self._last_ns:
            self._counts[round((time_ns - self._last_ns) / _GAP_RESOLUTION_NS)] += 1
        self._last_ns = time_ns if self._last_ns is None else max(time_ns, self._last_ns)


class MessageTimes:
    """When the messages of a topic were stamped, and when they arrived."""

    def __init__(self) -> None:
        self.stamps, self.arrivals = Gaps(), Gaps()

    def add(self, record: BagRecord) -> None:
        """Note a message that begins with a header, as every input does; the rest is not decoded."""
        self.arrivals.add(record.log_time_ns)
        stamp_ns = stamp_of_bytes(record.data)
        if stamp_ns is not None:
            self.stamps.add(stamp_ns)

    def add_block(self, stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> None:
        """Note messages, as by :meth:`add` of each."""
        self.arrivals.add_block(log_times_ns)
        self.stamps.add_block(stamps_ns)


def gap_limits(config: Any) -> Iterator[GapLimit]:
    """The parameters that bound the gaps between a node's inputs.

    Args:
        config: of one of the suite's nodes; for one of another node there are none.
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
        yield GapLimit("ins/imu", "ins.silence_s", True, "the INS counts as gone, and without stars it is INVALID")


def exceeded(config: Any, times: dict[str, MessageTimes], source: str) -> Iterator[Exceeded]:
    """The limits of a node that are exceeded by the gaps between its inputs.

    Args:
        config: of the node.
        times: by relative topic.
        source: where the messages are from, for the text.
    """
    for limit in gap_limits(config):
        if limit.topic not in times:
            continue
        own = times[limit.topic]
        lengths_s, counts = (own.arrivals if limit.by_arrival else own.stamps).seconds()
        allowed_s = float(flatten(config)[limit.parameter])
        times_s = lengths_s * counts
        # Times within the resolution of one another fill no time at all.
        share = times_s[lengths_s > allowed_s].sum() / max(times_s.sum(), 1e-9)
        if share > _WORTH_SAYING:
            yield Exceeded(limit, _words(limit, allowed_s, lengths_s, counts, source), share > _MOST_OF_THE_TIME)


def _between_stamps(topic: str, parameter: str, meaning: str) -> GapLimit:
    return GapLimit(topic, parameter, False, f"nothing is interpolated there, and {meaning}")


def _words(limit: GapLimit, allowed_s: float, lengths_s: np.ndarray, counts: np.ndarray, source: str) -> str:
    usual_s = float(lengths_s[np.searchsorted(np.cumsum(counts), counts.sum() / 2)])
    how_far = f"{usual_s:.4g} s apart" if usual_s > allowed_s else f"up to {lengths_s[-1]:.4g} s apart"
    advice = "look for what was lost"
    if usual_s > _TOO_NEAR * allowed_s:
        resample = " (import_nmea --resample HZ)" if limit.topic == "ins/imu" else ""
        advice = f"record it faster{resample}, or set '{limit.parameter}' to {1.5 * max(usual_s, allowed_s):.2g}"
    longer = f"{counts[lengths_s > allowed_s].sum()} of {counts.sum()} gaps are longer"
    return (
        f"parameter '{limit.parameter}' = {allowed_s:g} s, but messages of '{limit.topic}' in {source} "
        f"{'arrive' if limit.by_arrival else 'are stamped'} {how_far} ({longer}): {limit.meaning}; {advice}"
    )


class LogTimes:
    """Log time minus stamp, topic by topic; memory does not grow with the number of messages."""

    def __init__(self) -> None:
        self._delays: dict[str, Counter[int]] = {}
        self._latest: dict[str, tuple[int, int]] = {}

    def add(self, topic: str, record: BagRecord) -> None:
        """Note a message."""
        stamp_ns = stamp_of_bytes(record.data)
        if not stamp_ns:
            return
        delay_ns = record.log_time_ns - stamp_ns
        self._delays.setdefault(topic, Counter())[round(delay_ns / _DELAY_RESOLUTION_NS)] += 1
        self._latest[topic] = max(self._latest.get(topic, (delay_ns, 0)), (delay_ns, record.log_time_ns))

    def add_block(self, topic: str, stamps_ns: np.ndarray, log_times_ns: np.ndarray) -> None:
        """Note messages, as by :meth:`add` of each."""
        stamped = stamps_ns != 0
        if not stamped.any():
            return
        log_times_ns, delays_ns = log_times_ns[stamped], (log_times_ns - stamps_ns)[stamped]
        counts = self._delays.setdefault(topic, Counter())
        lengths, numbers = np.unique(np.rint(delays_ns / _DELAY_RESOLUTION_NS), return_counts=True)
        for length, number in zip(lengths.tolist(), numbers.tolist(), strict=True):
            counts[int(length)] += number
        # Of equal delays the last one.
        place = len(delays_ns) - 1 - int(np.argmax(delays_ns[::-1]))
        latest = int(delays_ns[place]), int(log_times_ns[place])
        self._latest[topic] = max(self._latest.get(topic, (latest[0], 0)), latest)

    def usual_ns(self) -> int:
        """Log time minus stamp of the middle message of all; 0 where none has a stamp."""
        return _median_ns(sum(self._delays.values(), Counter[int]()))

    def held_up(self) -> str:
        """One line that tells how irregular the log times are; empty where they are regular."""
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
            f"{utc_text(at_ns)}): the recorder stalled, or the data came late"
        )


def in_order_of_stamps(records: Iterator[BagRecord], usual_ns: int) -> Iterator[BagRecord]:
    """Records of a bag with their stamps as log times, in that order; equal ones as they lie in the bag.

    A message without a stamp, or with one far from where it was logged, gets its log time less the usual delay.

    Args:
        records: in order of log time.
        usual_ns: log time minus stamp of most messages.
    """
    waiting: list[tuple[int, int, BagRecord]] = []
    for number, record in enumerate(records):
        logged_ns = record.log_time_ns - usual_ns
        stamp_ns = stamp_of_bytes(record.data)
        record.log_time_ns = stamp_ns if stamp_ns and abs(stamp_ns - logged_ns) <= FAR_NS else logged_ns
        heappush(waiting, (record.log_time_ns, number, record))
        # Nothing that is yet to come can be earlier.
        while waiting[0][0] < logged_ns - FAR_NS:
            yield heappop(waiting)[2]
    while waiting:
        yield heappop(waiting)[2]


def _median_ns(delays: Counter[int]) -> int:
    middle, seen = (delays.total() + 1) // 2, 0
    for delay in sorted(delays):
        seen += delays[delay]
        if seen >= middle:
            return delay * _DELAY_RESOLUTION_NS
    return 0
