"""Pairing of an attitude without time with the ZDA of the same burst, which comes before or after the attitude.

Instruments send bursts of sentences. The ZDA is the first sentence of a burst for Seapath and the last sentence for
other instruments. Therefore the ZDA before an attitude may belong to the previous burst. The pairing is decided by the
receive times: the delay from stamp to receive time must be the usual delay of the instrument, within half a period. The
usual delay is the delay of a recent GGA, which contains a time. Without a recent GGA of similar delay, or with several
attitudes in a burst, the usual delay is the delay of the ZDA.
"""

from collections import deque
from dataclasses import dataclass
from datetime import date, datetime, timezone
from statistics import median

from ship_bags.nmea.instrument_line import InstrumentLine, corrected_ns, datetime_ns, time_of_day_ns
from ship_bags.stamps import NS_PER_S

_LONGEST_PERIOD_NS = NS_PER_S
"""Period of bursts until it is known, ns; slower bursts are paired as if they had this period."""
_SHORTEST_PERIOD_NS = NS_PER_S // 100
_GAP_COUNT = 9
"""Number of intervals between attitudes whose median is the period of the attitudes."""
_EARLIEST_NS = NS_PER_S // 100
"""Maximum time by which an attitude may be received before its stamp, ns."""
_MIN_PERIOD_RATIO = 0.75
"""Ratio of the attitude period to the ZDA period below which a burst has several attitudes."""


@dataclass(frozen=True)
class ZdaTime:
    """ZDA sentence with its time.

    Attributes:
        line: the sentence, with its receive time.
        stamp_ns: date and time as stated by the instrument.
        delay_ns: time from the stamp, corrected for GPS week rollovers, to the receive time.
    """

    line: InstrumentLine
    stamp_ns: int
    delay_ns: int


class BurstClock:
    """Pairing of each ZDA with one attitude of its burst; lines must be given in order of reception.

    Attributes:
        pending_attitude: the attitude whose ZDA may follow.
    """

    def __init__(self) -> None:
        self._zda: ZdaTime | None = None
        self._last_zda_ns = self._last_attitude_ns = 0
        self._zda_gap_ns = _LONGEST_PERIOD_NS
        self._attitude_gaps_ns: deque[int] = deque(maxlen=_GAP_COUNT)
        self._gga_ns, self._gga_delay_ns = 0, 0
        self.pending_attitude: InstrumentLine | None = None

    def note_position(self, gga: InstrumentLine) -> None:
        """Record the delay of a GGA."""
        stamp_ns = time_of_day_ns(gga.content.timestamp, gga.receive_ns)
        self._gga_ns, self._gga_delay_ns = gga.receive_ns, gga.receive_ns - stamp_ns

    def pair_attitude(self, attitude: InstrumentLine) -> ZdaTime | None:
        """Return the ZDA before an attitude if the ZDA is of the same burst.

        Otherwise the attitude becomes :attr:`pending_attitude`.
        """
        if self._last_attitude_ns:
            self._attitude_gaps_ns.append(max(attitude.receive_ns - self._last_attitude_ns, 0))
        self._last_attitude_ns = attitude.receive_ns
        zda, self._zda = self._zda, None
        if zda is not None and self._is_of_burst(attitude, zda):
            self.pending_attitude = None
            return zda
        self.pending_attitude = attitude
        return None

    def pair_time(self, line: InstrumentLine) -> tuple[InstrumentLine, ZdaTime] | None:
        """Return the pending attitude with the ZDA in this line if both are of the same burst."""
        zda = _zda_time(line)
        if zda is None:
            return None
        if zda.stamp_ns > self._last_zda_ns:
            self._zda_gap_ns = min(zda.stamp_ns - self._last_zda_ns, _LONGEST_PERIOD_NS)
        self._last_zda_ns = zda.stamp_ns
        attitude = self.pending_attitude
        if attitude is not None and self._is_of_burst(attitude, zda) and _is_possible(attitude, zda):
            self._zda, self.pending_attitude = None, None
            return attitude, zda
        self._zda = zda
        return None

    def _is_of_burst(self, attitude: InstrumentLine, zda: ZdaTime) -> bool:
        """True if the attitude's delay after the time of this ZDA equals the usual delay within half a period."""
        attitude_gap_ns = int(median(self._attitude_gaps_ns)) if self._attitude_gaps_ns else self._zda_gap_ns
        period_ns = max(min(attitude_gap_ns, self._zda_gap_ns), _SHORTEST_PERIOD_NS)
        delay_ns, usual_ns = attitude.receive_ns - (zda.line.receive_ns - zda.delay_ns), zda.delay_ns
        is_one_to_a_burst = attitude_gap_ns >= _MIN_PERIOD_RATIO * self._zda_gap_ns
        is_recent = abs(attitude.receive_ns - self._gga_ns) < self._zda_gap_ns
        if is_one_to_a_burst and is_recent and abs(self._gga_delay_ns - zda.delay_ns) < 2 * self._zda_gap_ns:
            usual_ns = self._gga_delay_ns
        return abs(delay_ns - usual_ns) <= period_ns // 2


def _is_possible(attitude: InstrumentLine, zda: ZdaTime) -> bool:
    """False for an attitude received before its stamp; a receive clock that is behind allows no check."""
    return zda.delay_ns < 0 or attitude.receive_ns - (zda.line.receive_ns - zda.delay_ns) >= -_EARLIEST_NS


def _zda_time(line: InstrumentLine) -> ZdaTime | None:
    """Return the time of a ZDA; None if its date is invalid."""
    content = line.content
    try:
        moment = datetime.combine(date(content.year, content.month, content.day), content.timestamp, timezone.utc)
    except ValueError:
        return None
    stamp_ns = datetime_ns(moment)
    return ZdaTime(line, stamp_ns, line.receive_ns - (corrected_ns(stamp_ns, line.receive_ns) or stamp_ns))
