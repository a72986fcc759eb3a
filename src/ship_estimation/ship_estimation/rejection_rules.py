"""Rules by which inputs are rejected, and their reasons, the same for every estimator of the suite.

A measurement is checked in this order (files without the folder that repeats the name of the package):

1. the live node (``ship_node/live``): BEHIND if it cannot keep up (set in ``ship_node/adapters/node_adapter``),
   OVERFLOW if its inbox is full;
2. the reader of the message (``messages/`` of each estimator, with the checks of ``ship_node/messages/field_checks``):
   all reasons for a wrong field. The adapter (``ship_node/adapters/input_processing``): OFF for a source that is
   switched off, and by ``ship_node/health/time_base`` CLOCK and FUTURE for a wrong clock;
3. :class:`ship_estimation.time_order.time_ordered_estimator.LagWindow`: LATE;
4. the checks of a single stream (:mod:`ship_estimation.plausibility.ins_check` for an INS,
   :mod:`ship_estimation.plausibility.stuck_check` for star sensors and references,
   ``theodolite_calib/samples/encoder_check`` for encoders): STUCK, UNITS, and GATE for a single sample that jumps. The
   checks of position and weather (``ship_stars/sky/stamped_values``): DUPLICATE, CONFLICT, LATE and JUMP;
5. :class:`ship_estimation.time_order.time_ordered_estimator.TimeOrderedEstimator`: DUPLICATE, CONFLICT, OVERFLOW, and
   FAILED for defects of the software;
6. the filter (``ship_attitude_star/ship_attitude/filter``, ``theodolite_calib/filter/sighting_gate``): GATE if the NIS
   of the innovation exceeds the χ² quantile of ``gate.probability``, EXCLUDED for a source that fault detection has
   excluded. NO_FIX means that the INS model lacks the latitude, GAP that the INS jumped since. After repeated
   rejections GATE becomes ATTITUDE_CONFLICT (``ship_attitude/decision_effects``); lights that contradict each other are
   in LIGHT_CONFLICT. While stars may show a wrong UTC, they are rejected with CLOCK (``ship_attitude/state``). The
   measurement model (``ship_attitude/measurements``, ``theodolite_calib/samples/sighting``): GAP without an attitude at
   its time, and others. Single stars: identification, selection and fit (``ship_stars/attitude_from_stars``), and the
   sky (``ship_stars/sky``).

``star_attitude`` checks 5 before 4, and encoder readings in degrees are rejected before their age is checked.
``theodolite_calib/triangulation`` rejects pairs of bearings with reasons of 3, 5 and 6.
"""

import enum
from collections.abc import Iterable, Set
from dataclasses import dataclass
from typing import Protocol

from ship_geometry.earth.time_scales import NEVER_NS, SECOND_NS

CONFLICT_HOLD_S = 10.0
"""Time without a conflict of stamps after which results from a source may be VALID again, s."""
_CONFLICT_HOLD_NS = round(CONFLICT_HOLD_S * SECOND_NS)

DETECTION_TIME_S = 2.0
"""Maximum delay of the detection of two publishers of one source after both have sent two messages, s."""

LONGEST_TEXT = 200
"""Maximum length of a reason, and of any text from outside in an output, characters."""


def shorten(text: str, most: int = LONGEST_TEXT) -> str:
    """Return a text, shortened to ``most`` characters with an ellipsis if it is longer.

    Example:
        >>> shorten("star_fore_of_a_very_long_name", most=12)
        'star_fore_o…'
    """
    return text if len(text) <= most else text[: most - 1] + "…"


class Reason(enum.IntEnum):
    """Reason of a rejection; values and meanings are those of ship_msgs/Innovation."""

    NONE = 0
    NON_FINITE = 1
    BAD_QUATERNION = 2
    COVARIANCE_UNKNOWN = 3
    BAD_COVARIANCE = 4
    BAD_STAMP = 5
    DUPLICATE = 6
    CONFLICT = 7
    LATE = 8
    FUTURE = 9
    FRAME = 10
    UNITS = 11
    STUCK = 12
    NOT_FIXED = 13
    MISIDENTIFIED = 14
    TOO_FEW_STARS = 15
    ATTITUDE_CONFLICT = 16
    LIGHT_CONFLICT = 17
    OVERFLOW = 18
    GATE = 19
    REVISED = 20
    GAP = 21
    NO_FIX = 22
    NO_EARTH_ORIENTATION = 23
    UNKNOWN_STAR = 24
    BELOW_HORIZON = 25
    UNIDENTIFIED = 26
    UNKNOWN_SENSOR = 27
    CLOCK = 28
    FAILED = 29
    EXCLUDED = 30
    JUMP = 31
    OFF = 32
    BEHIND = 33
    NOT_GIVEN = 34

    @property
    def word(self) -> str:
        """Name of the reason in health, diagnostics and reports: ``bad_stamp``."""
        return self.name.lower()


@dataclass(frozen=True)
class Rejection:
    """Rejection of an input, with reason and text; the text is shortened to :data:`LONGEST_TEXT`."""

    reason: Reason
    text: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", shorten(self.text))


def failure_rejection(error: Exception) -> Rejection:
    """Return the rejection of an input because of an exception in this software.

    The exception is reported as a defect of the software; other inputs are processed as usual.

    Example:
        >>> failure_rejection(ZeroDivisionError("division by zero"))
        Rejection(reason=<Reason.FAILED: 29>, text='ZeroDivisionError: division by zero (nowhere)')
    """
    return Rejection(Reason.FAILED, f"{type(error).__name__}: {shorten(str(error))} ({_error_place(error)})")


def singular_covariance() -> Rejection:
    """Return the rejection of a measurement whose innovation covariance is singular.

    Example:
        >>> singular_covariance().reason.word
        'bad_covariance'
    """
    text = "the covariance of the residual cannot be inverted: it is singular, or not positive definite"
    return Rejection(Reason.BAD_COVARIANCE, text)


def _error_place(error: Exception) -> str:
    """Return file name and line where an exception was raised; "nowhere" without a traceback."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f"{trace.tb_frame.f_code.co_filename.rpartition('/')[2]}:{trace.tb_lineno}" if trace else "nowhere"


class Content(Protocol):
    """An object whose content can be compared as bytes."""

    def content(self) -> bytes:
        """Return all values as bytes; repeated messages have equal bytes, and the bytes order conflicting messages."""
        ...


def resolve_same_stamp(known: Content, new: Content) -> tuple[bool, Rejection]:
    """Return True if a new input replaces a known input with the same stamp, and the rejection of the dropped input.

    The input whose bytes sort first is kept, so that the order of arrival does not matter.

    Example:
        >>> from ship_geometry.tracks.sample_track import VectorSample
        >>> import numpy as np
        >>> known, other = VectorSample(1, np.array([1.0])), VectorSample(1, np.array([2.0]))
        >>> takes_its_place, rejection = resolve_same_stamp(known, known)
        >>> takes_its_place, rejection.reason.name
        (False, 'DUPLICATE')
        >>> resolve_same_stamp(known, other)[1].reason.name
        'CONFLICT'
    """
    known_bytes, new_bytes = known.content(), new.content()
    if known_bytes == new_bytes:
        return False, Rejection(Reason.DUPLICATE, "the same stamp and the same content again")
    text = "the same stamp with other content: the message whose bytes sort first is kept"
    return new_bytes < known_bytes, Rejection(Reason.CONFLICT, text)


class StampConflicts:
    """Sources that sent conflicting data with the same stamp, or that have two publishers.

    One of two conflicting inputs is kept, perhaps the wrong one, so results from such a source are not VALID. Results
    from a source with two publishers are not VALID either.

    Attributes:
        latest_ns: stamp of the last conflict of each source, however old.
        since_ns: stamp of the first conflict in the last series of each source; each conflict of a series is within ten
            seconds of another.
        duplicate_publishers: stamp since which two publishers of a source send, and a text that names them, by source.

    Example:
        >>> conflicts = StampConflicts()
        >>> conflicts.record("ship", 5 * SECOND_NS, Rejection(Reason.CONFLICT, "the same stamp with other content"))
        >>> conflicts.record("encoder", 5 * SECOND_NS, Rejection(Reason.DUPLICATE, "the same again"))

        A conflict is active for ten seconds; a duplicate is not a conflict:

        >>> conflicts.active_at(12 * SECOND_NS)
        {'ship': 5000000000}
        >>> conflicts.active_at(16 * SECOND_NS)
        {}
        >>> conflicts.common_interval({"ship", "encoder"}), conflicts.common_interval({"ship"})
        (None, (5000000000, 15000000000))

        Two publishers are a conflict until a call with an empty text:

        >>> conflicts.set_duplicate_publishers("ins", 20 * SECOND_NS, "two publishers send on ins/imu")
        >>> conflicts.active_at(30 * SECOND_NS), conflicts.text({"ins"})
        ({'ins': 18000000000}, 'two publishers send on ins/imu')
    """

    def __init__(self) -> None:
        self.duplicate_publishers: dict[str, tuple[int, str]] = {}
        self.reset()

    def reset(self) -> None:
        """Clear the conflicts; two publishers remain recorded until :meth:`set_duplicate_publishers` removes them.

        The record then applies to all stamps, because stamps may restart before the stamp of the detection.
        """
        self.latest_ns: dict[str, int] = {}
        self.since_ns: dict[str, int] = {}
        self.duplicate_publishers = {
            source: (NEVER_NS, text) for source, (_, text) in self.duplicate_publishers.items()
        }

    @property
    def is_empty(self) -> bool:
        """True if no source has had a conflict or has two publishers."""
        return not (self.latest_ns or self.duplicate_publishers)

    def set_duplicate_publishers(self, source: str, time_ns: int, text: str) -> None:
        """Record that a source has two publishers; an empty text removes the record.

        Args:
            source: the source.
            time_ns: stamp of the detection; both publishers may have sent for :data:`DETECTION_TIME_S` before.
            text: text for users, with the names of the publishers.
        """
        if text:
            since_ns = time_ns - round(DETECTION_TIME_S * SECOND_NS)
            self.duplicate_publishers[source] = self.duplicate_publishers.get(source, (since_ns,))[0], text
        else:
            self.duplicate_publishers.pop(source, None)

    def record(self, source: str, time_ns: int, rejection: Rejection | None) -> None:
        """Record the rejection of an input with a stamp if the reason of the rejection is CONFLICT."""
        if rejection is not None and rejection.reason is Reason.CONFLICT:
            latest_ns = self.latest_ns.get(source, time_ns)
            since_ns = self.since_ns.get(source, time_ns)
            # A conflict long after the last conflict starts a series; a conflict shortly before the first becomes the
            # first.
            is_new = time_ns - latest_ns > _CONFLICT_HOLD_NS
            if is_new or since_ns - _CONFLICT_HOLD_NS <= time_ns < since_ns:
                since_ns = time_ns
            self.since_ns[source], self.latest_ns[source] = since_ns, max(time_ns, latest_ns)

    def active_at(self, time_ns: int) -> dict[str, int]:
        """Return the sources with a recent conflict, each with the stamp of its last conflict.

        A source with two publishers is returned with the stamp from which both may have sent.
        """
        if self.is_empty:
            return {}
        since_ns = time_ns - _CONFLICT_HOLD_NS
        latest = {source: latest_ns for source, latest_ns in self.latest_ns.items() if latest_ns >= since_ns}
        return latest | {source: since_ns for source, (since_ns, _) in self.duplicate_publishers.items()}

    def text(self, sources: Iterable[str]) -> str:
        """Return the text for sources that have a conflict or two publishers; empty without sources.

        Example:
            >>> StampConflicts().text(["ship"])
            'ship sent conflicting data with one stamp'
        """
        words = [
            self.duplicate_publishers[source][1]
            if source in self.duplicate_publishers
            else f"{source} sent conflicting data with one stamp"
            for source in sorted(sources)
        ]
        return " and ".join(words)

    def common_interval(self, sources: Set[str]) -> tuple[int, int] | None:
        """Return the interval in which each source has a conflict, from :attr:`since_ns` to the hold's end, or None."""
        if not sources <= self.latest_ns.keys():
            return None
        first_ns = max(self.since_ns[source] for source in sources)
        until_ns = min(self.latest_ns[source] for source in sources) + _CONFLICT_HOLD_NS
        return (first_ns, until_ns) if first_ns <= until_ns else None
