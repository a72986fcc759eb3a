"""Why an input is not used: the same reasons for every estimator of the suite.

This module names the reasons. A measurement meets those who decide in this order:

1. the inbox of a live node that cannot keep up (``ship_node/live/backlog``): BEHIND;
2. the reader of its message (``ros/`` of each estimator, with the checks of ``ship_node/edge/messages_in``): fields;
   and the adapter (``ship_node/edge/reporting_adapter``), where people have taken the source out: OFF;
3. :class:`ship_estimation.estimator_shell.LagWindow`: LATE;
4. the guards, which look at one stream by itself: :mod:`ship_estimation.ins_guard` at an INS, ``guards/`` at star
   sensors and references, ``theodolite_calib/measured/encoder_watch`` at encoders: STUCK, UNITS, and GATE for one
   sample that jumps; ``sky/stamped_values`` at the fix and the air: JUMP;
5. :class:`ship_estimation.estimator_shell.EstimatorShell`: DUPLICATE, CONFLICT, OVERFLOW, and FAILED for our own
   defects;
6. the filter that compares it with its state (``ship_attitude/filter``, ``theodolite_calib/filter/judgement``) and, in
   it, what it is compared with (``ship_attitude/comparison``, ``theodolite_calib/measured/sighting``): all others.

``star_attitude`` asks 5 before 4, and a reading of the encoders in degrees is told before its age.
"""

import enum
from collections.abc import Iterable, Set
from dataclasses import dataclass
from typing import Protocol

from ship_geometry.time_scales import SECOND_NS

AGREES_AGAIN_AFTER_S = 10.0
"""So long a source that contradicted itself must have agreed with itself before what rests on it is VALID again."""
_AGREES_AGAIN_AFTER_NS = round(AGREES_AGAIN_AFTER_S * SECOND_NS)

_AT_ALL_STAMPS_NS = -(2**62)
"""Stamp from which a source is contested where its stamps may have restarted meanwhile."""

FOUND_WITHIN_S = 2.0
"""Two publishers of one source are found within this time from their second message on."""

LONGEST_TEXT = 200
"""Characters of a reason; and what comes from outside is never longer than that in anything that goes out."""


def shortened(text: str, most: int = LONGEST_TEXT) -> str:
    """The text itself, or where it has more characters its beginning with an ellipsis, ``most`` in all.

    Example:
        >>> shortened("star_fore_of_a_very_long_name", most=12)
        'star_fore_o…'
    """
    return text if len(text) <= most else text[: most - 1] + "…"


class Reason(enum.IntEnum):
    """Why a measurement was not used; the values are those of ship_msgs/Innovation."""

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
        """The reason as people read it in health, diagnostics and reports: ``bad_stamp``."""
        return self.name.lower()


@dataclass(frozen=True)
class Refusal:
    """Why an input was not used at all."""

    reason: Reason
    text: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", shortened(self.text))


def failure(error: Exception) -> Refusal:
    """The refusal of an input on which our own code stumbled.

    Reported as a defect of this software; other inputs go on.

    Example:
        >>> failure(ZeroDivisionError("division by zero"))
        Refusal(reason=<Reason.FAILED: 29>, text='ZeroDivisionError: division by zero (nowhere)')
    """
    return Refusal(Reason.FAILED, f"{type(error).__name__}: {shortened(str(error))} ({_place_of(error)})")


def singular_covariance() -> Refusal:
    """The refusal of a measurement whose residual cannot be judged, nor weighed, by its covariance.

    Example:
        >>> singular_covariance().reason.word
        'bad_covariance'
    """
    text = "the covariance of the residual cannot be inverted: it is singular, or not positive definite"
    return Refusal(Reason.BAD_COVARIANCE, text)


def _place_of(error: Exception) -> str:
    """File and line that raised; where the file lies is known from its name."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f"{trace.tb_frame.f_code.co_filename.rpartition('/')[2]}:{trace.tb_lineno}" if trace else "nowhere"


class Content(Protocol):
    """Something that can be told from another of its kind."""

    def content(self) -> bytes:
        """All values as bytes: equal for a repeated message, and an order for conflicting ones."""
        ...


def same_stamp(known: Content, new: Content) -> tuple[bool, Refusal]:
    """Of two inputs with the same stamp: whether the new one takes the place of the known one, and what to say of it.

    The one whose bytes sort first is kept, so that the order of arrival does not matter.

    Example:
        >>> from ship_geometry.vector_track import VectorSample
        >>> import numpy as np
        >>> known, other = VectorSample(1, np.array([1.0])), VectorSample(1, np.array([2.0]))
        >>> takes_its_place, refusal = same_stamp(known, known)
        >>> takes_its_place, refusal.reason.name
        (False, 'DUPLICATE')
        >>> same_stamp(known, other)[1].reason.name
        'CONFLICT'
    """
    known_bytes, new_bytes = known.content(), new.content()
    if known_bytes == new_bytes:
        return False, Refusal(Reason.DUPLICATE, "the same stamp and the same content again")
    text = "the same stamp with other content: the one whose bytes sort first is kept"
    return new_bytes < known_bytes, Refusal(Reason.CONFLICT, text)


class Contradictions:
    """The sources that said different things of one moment not long ago.

    Of the two things one is kept, which may as well be the wrong one: what rests on such a source is not VALID. Nor is
    what rests on a contested source, as which two publishers send.

    Attributes:
        latest_ns: by source, the stamp of its last conflict, however long ago.
        since_ns: by source, the stamp of the first of the conflicts that led to it, each within ten seconds of another.
        contested: by source, the stamp from which on two publishers send, and a text for people that names them.

    Example:
        >>> told = Contradictions()
        >>> told.note("ship", 5 * SECOND_NS, Refusal(Reason.CONFLICT, "the same stamp with other content"))
        >>> told.note("encoder", 5 * SECOND_NS, Refusal(Reason.DUPLICATE, "the same again"))
        >>> told.at(12 * SECOND_NS)
        {'ship': 5000000000}
        >>> told.at(16 * SECOND_NS)
        {}
        >>> told.together({"ship", "encoder"}), told.together({"ship"})
        (None, (5000000000, 15000000000))
        >>> told.contest("ins", 20 * SECOND_NS, "two publishers send on ins/imu")
        >>> told.at(30 * SECOND_NS), told.text({"ins"})
        ({'ins': 18000000000}, 'two publishers send on ins/imu')
    """

    def __init__(self) -> None:
        self.contested: dict[str, tuple[int, str]] = {}
        self.forget()

    def __bool__(self) -> bool:
        """True if any source has contradicted itself, or is contested."""
        return bool(self.latest_ns or self.contested)

    def forget(self) -> None:
        """Forget the conflicts; a contested source stays so until :meth:`contest` ends that, at all stamps from now on.

        Stamps may begin anew, before the one from which on it was contested.
        """
        self.latest_ns: dict[str, int] = {}
        self.since_ns: dict[str, int] = {}
        self.contested = {source: (_AT_ALL_STAMPS_NS, text) for source, (_, text) in self.contested.items()}

    def contest(self, source: str, time_ns: int, text: str) -> None:
        """Set that two publishers send as a source; an empty text ends it.

        Args:
            source: the source.
            time_ns: stamp at which that is found: they may have sent for :data:`FOUND_WITHIN_S` before.
            text: for people, with the names of the publishers.
        """
        if text:
            since_ns = time_ns - round(FOUND_WITHIN_S * SECOND_NS)
            self.contested[source] = self.contested.get(source, (since_ns,))[0], text
        else:
            self.contested.pop(source, None)

    def note(self, source: str, time_ns: int, refusal: Refusal | None) -> None:
        """Take note of what was said of an input with this stamp; only CONFLICT counts."""
        if refusal is not None and refusal.reason is Reason.CONFLICT:
            latest_ns = self.latest_ns.get(source, time_ns)
            since_ns = self.since_ns.get(source, time_ns)
            # A conflict long after the last one begins anew; one long before it is over.
            begins_anew = time_ns - latest_ns > _AGREES_AGAIN_AFTER_NS
            if begins_anew or since_ns - _AGREES_AGAIN_AFTER_NS <= time_ns < since_ns:
                since_ns = time_ns
            self.since_ns[source], self.latest_ns[source] = since_ns, max(time_ns, latest_ns)

    def at(self, time_ns: int) -> dict[str, int]:
        """The sources that have not agreed with themselves for long, each with the stamp of its last conflict.

        A contested source comes with the stamp since when it is contested.
        """
        if not self:
            return {}
        since_ns = time_ns - _AGREES_AGAIN_AFTER_NS
        latest = {source: latest_ns for source, latest_ns in self.latest_ns.items() if latest_ns >= since_ns}
        return latest | {source: since_ns for source, (since_ns, _) in self.contested.items()}

    def text(self, sources: Iterable[str]) -> str:
        """Words for sources that contradict themselves or are contested; empty where there are none.

        Example:
            >>> Contradictions().text(["ship"])
            'ship says different things of one moment'
        """
        words = [
            self.contested[source][1] if source in self.contested else f"{source} says different things of one moment"
            for source in sorted(sources)
        ]
        return " and ".join(words)

    def together(self, sources: Set[str]) -> tuple[int, int] | None:
        """From when until when sources all contradict themselves, each since its first conflict; None for never."""
        if not sources <= self.latest_ns.keys():
            return None
        first_ns = max(self.since_ns[source] for source in sources)
        until_ns = min(self.latest_ns[source] for source in sources) + _AGREES_AGAIN_AFTER_NS
        return (first_ns, until_ns) if first_ns <= until_ns else None
