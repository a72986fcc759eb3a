"""Attitudes in the lines of an instrument, stamped by its own time or by the receive time, unchanged or resampled.

PASHR and PSAT,HPR contain their own time of day. An attitude without time (PSXN,23, PRDID, PTNTHPR) is valid at the
time in the ZDA of its burst.

Instruments send bursts of sentences. The ZDA is the first sentence of a burst for Seapath and the last sentence for
other instruments. Therefore the ZDA before an attitude may belong to the previous burst. The pairing is decided by the
receive times: the delay from stamp to receive time must be the usual delay of the instrument, within half a period. The
usual delay is the delay of a recent GGA, which contains a time. Without a recent GGA of similar delay, or with several
attitudes in a burst, the usual delay is the delay of the ZDA.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime, timezone
from statistics import median
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from ship_bags.nmea import sentences
from ship_bags.nmea.instrument_lines import (
    InstrumentLine,
    LineReport,
    corrected_ns,
    datetime_ns,
    instrument_ns,
    time_of_day_ns,
)
from ship_bags.nmea.sentences import number
from ship_bags.stamps import NS_PER_S
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import FloatArray

_LONGEST_PERIOD_NS = NS_PER_S
"""Period of bursts until it is known, ns; slower bursts are paired as if they had this period."""
_SHORTEST_PERIOD_NS = NS_PER_S // 100
_GAP_COUNT = 9
"""Number of intervals between attitudes whose median is the period of the attitudes."""
_EARLIEST_NS = NS_PER_S // 100
"""Maximum time by which an attitude may be received before its stamp, ns."""
_MIN_PERIOD_RATIO = 0.75
"""Ratio of the attitude period to the ZDA period below which a burst has several attitudes."""

MAX_GAP_S = 3.0
"""Maximum interval between attitudes that a spline bridges, s."""

ATTITUDE_KINDS = ("PSXN23", "PASHR", *sentences.ATTITUDES)
"""Kinds of sentences with an attitude."""

_INVALID_QUALITY = 2

_PASHR_SIGMAS, _LARGEST_SIGMA_DEG = slice(7, 10), 180.0
"""Fields of PASHR with the standard deviations of roll, pitch and heading, and the limit of these values, degrees."""

_PASHR_STATUS = slice(10, 12)
"""Fields of PASHR after the accuracies: aiding, and status of the IMU."""

NOT_LATER = "not later than the attitude before"
WITHOUT_TIME = "attitude without ZDA"
"""Reason: no ZDA is near enough to the attitude to be of the same burst."""

UNAIDED = "PASHR: no aiding, and the IMU's status is 0"
"""Reason: both last fields are 0, which NovAtel and Trimble define as not aligned. The meaning of a single 0 depends on
the maker."""


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


@dataclass(frozen=True)
class LoggedAttitude:
    """Attitude of an instrument.

    Attributes:
        stamp_ns: time of validity, POSIX UTC.
        log_time_ns: time at which the attitude was available.
        rotation_nd: rotation deck → horizon, shape (3, 3).
        rate_d: angular velocity (bow, up, starboard) rad/s, shape (3,); None if not given.
        sigmas: standard deviations of roll, pitch and heading by the instrument, rad; None if not given.
    """

    stamp_ns: int
    log_time_ns: int
    rotation_nd: FloatArray
    rate_d: FloatArray | None = None
    sigmas: FloatArray | None = None


class AttitudeReader:
    """Attitudes in the lines of one instrument, in order of stamps.

    Args:
        by_instrument: True to stamp by the instrument's time, False by the receive time.
        report: counts of unusable attitudes: invalid by PSXN,20 or by PASHR's status, without a ZDA, of a wrong time,
            or not later than the previous attitude.
    """

    def __init__(self, by_instrument: bool, report: LineReport) -> None:
        self._by_instrument = by_instrument
        self._report = report
        self._bursts = BurstClock()
        self._is_invalid = False
        self._last_ns: int | None = None

    def take(self, line: InstrumentLine) -> LoggedAttitude | None:
        """Return the attitude that is usable now: of this line, or of an earlier line that waited for its ZDA."""
        if line.kind == "ZDA" and self._by_instrument:
            pair = self._bursts.pair_time(line)
            if pair is not None:
                attitude, zda = pair
                return self._attitude(attitude, instrument_ns(zda.stamp_ns, zda.line, self._report), line.receive_ns)
        elif line.kind == "GGA":
            self._bursts.note_position(line)
        elif line.kind == "PSXN20":
            self._is_invalid = _INVALID_QUALITY in (line.content.head_qual, line.content.rp_qual)
        elif line.kind in ATTITUDE_KINDS and self._is_usable(line):
            return self._attitude(line, self._stamp_ns(line), line.receive_ns)
        return None

    def _is_usable(self, line: InstrumentLine) -> bool:
        """Return False for an attitude that the instrument marks as invalid, and count it."""
        if self._is_invalid:
            self._report.reject("invalid by PSXN,20", line.number, str(line.content))
            return False
        if line.kind == "PASHR" and [number(field) for field in line.content.data[_PASHR_STATUS]] == [0, 0]:
            self._report.reject(UNAIDED, line.number, str(line.content))
            return False
        return True

    def _stamp_ns(self, line: InstrumentLine) -> int | None:
        """Return the time of validity of an attitude; None if the time is wrong or not known yet."""
        if not self._by_instrument:
            return line.receive_ns
        time_of_day = getattr(line.content, "timestamp", None)
        if time_of_day is not None:
            return instrument_ns(time_of_day_ns(time_of_day, line.receive_ns), line, self._report)
        self.reject_waiting()
        zda = self._bursts.pair_attitude(line)
        return None if zda is None else instrument_ns(zda.stamp_ns, zda.line, self._report)

    def reject_waiting(self) -> None:
        """Count the attitude whose ZDA did not arrive."""
        waiting, self._bursts.pending_attitude = self._bursts.pending_attitude, None
        if waiting is not None:
            self._report.reject(WITHOUT_TIME, waiting.number, str(waiting.content))

    def _attitude(self, line: InstrumentLine, stamp_ns: int | None, usable_ns: int) -> LoggedAttitude | None:
        content = line.content
        if stamp_ns is None:
            return None
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            self._report.reject(NOT_LATER, line.number, str(content))
            return None
        self._last_ns = stamp_ns
        heading_deg = content.head if line.kind == "PSXN23" else content.true_heading
        angles = np.deg2rad([heading_deg, content.pitch, content.roll])
        sigmas = _pashr_sigmas(content) if line.kind == "PASHR" else None
        return LoggedAttitude(stamp_ns, usable_ns, rotation_from_angles(*angles), sigmas=sigmas)


def _pashr_sigmas(content: Any) -> FloatArray | None:
    """Return the standard deviations in a PASHR, rad; None if a value is missing or invalid."""
    sigmas_deg = np.array([number(field) or 0.0 for field in content.data[_PASHR_SIGMAS]])
    is_known = len(sigmas_deg) == 3 and bool(np.all((sigmas_deg > 0.0) & (sigmas_deg < _LARGEST_SIGMA_DEG)))
    return np.deg2rad(sigmas_deg) if is_known else None


def resample(logged: Sequence[LoggedAttitude], rate_hz: float) -> list[LoggedAttitude]:
    """Resample attitudes by a rotation spline, at whole multiples of the period; the rates are those of the spline.

    Linear interpolation of a ship's motion sampled at 1 Hz would cause errors of 0.14°. Gaps longer than
    :data:`MAX_GAP_S` remain. The log time is the stamp plus the median delay of the log.
    """
    delay_ns = int(np.median([attitude.log_time_ns - attitude.stamp_ns for attitude in logged]))
    result: list[LoggedAttitude] = []
    for segment in _segments(logged):
        if len(segment) < 2:
            continue
        origin_ns, end_ns = segment[0].stamp_ns, segment[-1].stamp_ns
        spline = RotationSpline(
            [(attitude.stamp_ns - origin_ns) / NS_PER_S for attitude in segment],
            Rotation.from_matrix([attitude.rotation_nd for attitude in segment]),
        )
        first, last = np.ceil(origin_ns / NS_PER_S * rate_hz), np.floor(end_ns / NS_PER_S * rate_hz)
        stamps = [round(number * NS_PER_S / rate_hz) for number in range(int(first), int(last) + 1)]
        stamps = [stamp_ns for stamp_ns in stamps if origin_ns <= stamp_ns <= end_ns]
        times_s = np.array([(stamp_ns - origin_ns) / NS_PER_S for stamp_ns in stamps])
        if len(stamps):
            rotations, rates = spline(times_s).as_matrix(), spline(times_s, 1)
            result += [
                LoggedAttitude(stamp_ns, stamp_ns + delay_ns, rotation, rate)
                for stamp_ns, rotation, rate in zip(stamps, rotations, rates, strict=True)
            ]
    return result


def _segments(logged: Sequence[LoggedAttitude]) -> list[list[LoggedAttitude]]:
    segments: list[list[LoggedAttitude]] = []
    for attitude in logged:
        gap_ns = attitude.stamp_ns - segments[-1][-1].stamp_ns if segments else None
        if gap_ns is None or gap_ns > MAX_GAP_S * NS_PER_S:
            segments.append([])
        segments[-1].append(attitude)
    return segments
