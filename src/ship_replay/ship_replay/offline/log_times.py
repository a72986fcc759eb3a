"""How regularly a recorder noted the times of its messages; and arrival by their stamps where it did not.

A recorder that stalls notes what came meanwhile when it goes on, so that a replay by log time meets silence and then a
flood. By the stamps, every message arrives at its own time of validity, whatever the recorder did.
"""

from collections import Counter
from collections.abc import Iterator
from heapq import heappop, heappush

from ship_bags.mcap.bag_reader import BagRecord
from ship_bags.stamps import NS_PER_S, utc_text
from ship_replay.offline.gaps import stamp_of_bytes

LATE_NS = NS_PER_S // 2
"""A message that was logged so much later after its stamp than its topic's usually are was held up, ns."""

FAR_NS = 60 * NS_PER_S
"""A stamp so far from where the log time puts its message is no time to go by, ns."""

_RESOLUTION_NS = 1_000_000


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
        self._delays.setdefault(topic, Counter())[round(delay_ns / _RESOLUTION_NS)] += 1
        self._latest[topic] = max(self._latest.get(topic, (delay_ns, 0)), (delay_ns, record.log_time_ns))

    def usual_ns(self) -> int:
        """Log time minus stamp of the middle message of all; 0 where none has a stamp."""
        return _median_ns(sum(self._delays.values(), Counter[int]()))

    def held_up(self) -> str:
        """One line that tells how irregular the log times are; empty where they are regular."""
        late, most_ns, topic_of_most, at_ns = 0, 0, "", 0
        for topic, delays in self._delays.items():
            usual_ns = _median_ns(delays)
            late += sum(count for delay, count in delays.items() if delay * _RESOLUTION_NS - usual_ns > LATE_NS)
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
            return delay * _RESOLUTION_NS
    return 0
