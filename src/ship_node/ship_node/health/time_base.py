"""Detection of steps of the time base: all clocks that stamp the inputs jump by the same time at once.

The offset of an input's clock is the stamp of a message minus the timeout-clock time, which never steps. A late message
looks like a clock that is behind. A clock has moved only if no delay explains the change of its offset. Changes below
0.5 s count only in the last of these cases:

- A clock has moved back if a stamp is not newer than the newest stamp of the same input.
- A clock has moved forward if a stamp is ahead of the node's clock, or if the offset has grown by more than
  :data:`_LONGEST_DELAY_NS`.
- A clock has moved back or forward if the change follows an equal step of the computer's clock within a second.

The time base has stepped if every present input with a mean period up to 1 s has moved by the same time and no message
has contradicted this step for 0.3 s. At least two clocks must agree; the computer's clock counts as one of them. A step
of one device alone is never a step of the time base.

A step back of the computer's clock is confirmed by the first input that follows it. The stamps of an input that does
not follow are ahead of the node's clock, so these stamps are unusable in any case.
"""

import bisect
from dataclasses import dataclass, field
from typing import Any

from ship_bags.stamps import duration_text
from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.time_scales import SECOND_NS, leap_seconds
from ship_node.messages.common_messages import DiagnosticStatus, Level

_MIN_STEP_NS = SECOND_NS // 2
"""Smallest step of stamps that counts without a step of the computer's clock, ns."""

_LONGEST_DELAY_NS = 10 * SECOND_NS
"""Largest growth of an offset that a shorter delay explains, ns."""

_AHEAD_NS = SECOND_NS // 20
"""Tolerance for stamps ahead of the node's clock, ns."""

_FOLLOWS_WITHIN_NS = SECOND_NS
"""Longest time between the steps of the computer's clock and of an input that follows it, ns."""

_CONFIRMATION_NS = 3 * SECOND_NS // 10
"""Time without contradiction after which a step counts, ns."""

_LONGEST_PERIOD_NS = SECOND_NS
"""Longest mean period of an input that a decision waits for, ns."""

_PRESENCE_PERIODS = 3.0
"""Number of mean periods without a message after which an input counts as absent."""

_ABSENCE_TIMEOUT_NS = 2 * SECOND_NS
"""Minimum timeout after which a moved input no longer keeps a step pending, ns; see :data:`_PRESENCE_PERIODS`."""

_OWN_CLOCK_AFTER_NS = 60 * SECOND_NS
"""Time after which the offset of an input that moved alone becomes its normal offset, ns."""

_TOLERANCE, _LARGEST_TOLERANCE_NS = 0.1, 2 * SECOND_NS
"""Largest difference of two steps that count as equal: ratio of a step, and upper limit of the difference, ns."""

_SMALL_STEP_NS, _LEAST_MESSAGES = 3 * SECOND_NS, 8
"""Size of a step below which unordered messages may explain it, ns, and number of messages that confirm such a step.

Messages may arrive up to two seconds late."""

_STEADY_AFTER_NS = 10 * SECOND_NS
"""Time for which a small step is ignored after another small step was reversed, ns."""

_LEAP_NS = -SECOND_NS
_LEAP_TOLERANCE_NS = SECOND_NS // 4
_LEAP_KNOWN_NS = 3 * SECOND_NS
"""Time for which an inserted leap second is remembered, ns."""

_STARS = "star."
_LEAP_SECOND = "a leap second is inserted: two seconds have the same UTC, so this stamp is ambiguous"
_MAX_PENDING_STEP_NS = 60 * SECOND_NS
"""Maximum age of the state from before a possible time step, ns; the core is not reset to an older state."""
_STEP_SHOWN_NS = 60 * SECOND_NS
"""Time for which a step of the time base is a warning, ns."""


@dataclass(slots=True)
class _InputClock:
    """Clock of one input.

    Attributes:
        level_ns: offset at the last message for which the clock had not moved, less ``own_offset_ns``.
        newest_ns: newest stamp.
        arrival_ns: timeout-clock time of the last message.
        period_ns: mean time between messages.
        own_offset_ns: change of the offset of this input alone, which lasted a minute or preceded the input's absence.
        moved_ns: change of the offset from ``level_ns`` plus ``own_offset_ns``; 0 if the clock has not moved.
        moved_since_ns: timeout-clock time at which the clock moved.
        last_delay_ns: change of the offset at the last message that a delay explained.
        last_delay_at_ns: timeout-clock time of that message.
        last_return_ns: timeout-clock time at which a small step was last reversed; None if never.
    """

    level_ns: int
    newest_ns: int
    arrival_ns: int
    period_ns: float = 0.0
    own_offset_ns: int = 0
    moved_ns: int = 0
    moved_since_ns: int = 0
    last_delay_ns: int = 0
    last_delay_at_ns: int = 0
    last_return_ns: int | None = None


@dataclass(slots=True)
class _Candidate:
    """Possible step of the time base.

    Attributes:
        step_ns: the step.
        since_ns: timeout-clock time since which no message has contradicted it.
        agree: inputs that have moved by ``step_ns`` since then.
        messages: number of messages of inputs that have moved by ``step_ns``.
    """

    step_ns: int
    since_ns: int
    agree: set[str] = field(default_factory=set)
    messages: int = 0


class TimeBase:
    """Clocks of all inputs of a node.

    Attributes:
        steps: number of steps of the time base.
        last_step_ns: the last step; 0 before the first.
    """

    def __init__(self) -> None:
        self.steps, self.last_step_ns, self._stepped_at_ns = 0, 0, 0
        self._leaps_ns = leap_seconds().starts_ns.tolist()
        self.restart()

    def restart(self) -> None:
        """Reset all clocks; keep the count of steps."""
        self._clocks: dict[str, _InputClock] = {}
        self._candidate: _Candidate | None = None
        self._computer: tuple[int, int] | None = None
        self._leap_at_ns: int | None = None
        # State of the core, and timeout-clock time, when the first input with a moved clock was found.
        self._state_before: tuple[Any, int] | None = None

    @property
    def is_step_pending(self) -> bool:
        """True if an input's clock has moved and it is undecided whether all clocks have."""
        return self._candidate is not None

    def note_computer_step(self, step_ns: int, waiting_ns: int) -> None:
        """Record a step of the computer's clock, which inputs may follow.

        Args:
            step_ns: the step.
            waiting_ns: time by the timeout clock.
        """
        self._computer = step_ns, waiting_ns + _FOLLOWS_WITHIN_NS

    def check_message(
        self, topic: str, source: str, stamp_ns: int, receive_ns: int, waiting_ns: int, core: Any
    ) -> tuple[int | None, Rejection | None]:
        """Add a message; return the step that it confirms, and its rejection, each None if there is none.

        A message is rejected if its stamp is ahead of the other inputs or ambiguous.

        Args:
            topic: topic of the message.
            source: name of the device.
            stamp_ns: stamp of the message.
            receive_ns: receive time by the node's clock.
            waiting_ns: receive time by the timeout clock.
            core: the estimator, whose state from before a possible step is kept.
        """
        step_ns = self.add_arrival(topic, stamp_ns, receive_ns, waiting_ns)
        if step_ns is None and self._candidate is None:
            self._state_before = None
        elif step_ns is None and self._state_before is None:
            self._state_before = getattr(core, "state", None), waiting_ns
        if self._candidate is not None and (ahead_ns := self.ahead_ns(topic)):
            text = f"stamp is {duration_text(ahead_ns)} ahead of the other inputs: check the clock of {source}"
            return step_ns, Rejection(Reason.FUTURE, text)
        if source.startswith(_STARS) and self.is_misdated(stamp_ns, waiting_ns):
            return step_ns, Rejection(Reason.CLOCK, _LEAP_SECOND)
        return step_ns, None

    def record_step(self, core: Any, waiting_ns: int) -> Any:
        """Record the step just found; return the core's state from before it, to which the core is reset."""
        state, before = getattr(core, "state", None), self._state_before
        self._state_before, self._stepped_at_ns = None, waiting_ns
        # Messages from after the step may have been used as late messages from before the step.
        return before[0] if before is not None and waiting_ns - before[1] <= _MAX_PENDING_STEP_NS else state

    def statuses(self, waiting_ns: int) -> list[DiagnosticStatus]:
        """Return one status with the last step of the time base; an empty list if there was no step."""
        if not self.steps:
            return []
        level = Level.WARN if waiting_ns - self._stepped_at_ns <= _STEP_SHOWN_NS else Level.OK
        text = f"stepped by {step_text(self.last_step_ns)}: reset, mountings and calibration kept"
        return [DiagnosticStatus("time base", level, text, {"steps": str(self.steps)})]

    def add_arrival(self, topic: str, stamp_ns: int, receive_ns: int, waiting_ns: int) -> int | None:
        """Add a message; return the step of the time base if the message confirms one.

        Args:
            topic: topic of the message.
            stamp_ns: stamp of the message.
            receive_ns: receive time by the node's clock.
            waiting_ns: receive time by the timeout clock.
        """
        clock, offset_ns = self._clocks.get(topic), stamp_ns - waiting_ns
        if clock is None:
            self._clocks[topic] = _InputClock(offset_ns, stamp_ns, waiting_ns)
            return None
        interval_ns, clock.arrival_ns = waiting_ns - clock.arrival_ns, waiting_ns
        clock.period_ns += (interval_ns - clock.period_ns) / (8.0 if clock.period_ns else 1.0)
        nothing_moves = (
            self._candidate is None and self._computer is None and not (clock.moved_ns or clock.own_offset_ns)
        )
        if nothing_moves and abs(offset_ns - clock.level_ns) < _MIN_STEP_NS:
            # This is the case for nearly all messages.
            clock.level_ns = offset_ns
            if stamp_ns > clock.newest_ns:
                clock.newest_ns = stamp_ns
            return None
        return self._process_move(topic, clock, stamp_ns, receive_ns, waiting_ns)

    def _process_move(
        self, topic: str, clock: _InputClock, stamp_ns: int, receive_ns: int, waiting_ns: int
    ) -> int | None:
        """Process a message while some clock has moved or may have moved; return the result of :meth:`add_arrival`."""
        if self._computer is not None and waiting_ns > self._computer[1]:
            self._computer = None
        offset_ns = stamp_ns - waiting_ns
        if clock.own_offset_ns and abs(offset_ns - clock.level_ns) < _MIN_STEP_NS:
            clock.own_offset_ns = 0
        moved_ns = offset_ns - clock.level_ns - clock.own_offset_ns
        if not self._has_moved(clock, moved_ns, stamp_ns, receive_ns, waiting_ns):
            if 0 < abs(clock.moved_ns) < _SMALL_STEP_NS:
                clock.last_return_ns = waiting_ns
            if moved_ns <= -_MIN_STEP_NS:
                clock.last_delay_ns, clock.last_delay_at_ns = moved_ns, waiting_ns
            clock.level_ns, clock.moved_ns = offset_ns - clock.own_offset_ns, 0
            clock.newest_ns = max(clock.newest_ns, stamp_ns)
        elif not clock.moved_ns:
            clock.moved_ns, clock.moved_since_ns = moved_ns, waiting_ns
        else:
            clock.moved_ns = moved_ns
        if self._candidate is None and not clock.moved_ns:
            return None
        return self._decide(topic, clock, waiting_ns)

    def count_without_step(self, topic: str, stamps_ns: list[int], arrivals_ns: list[int]) -> int:
        """Return the number of leading messages that need no check for a step.

        The number is 0 before the first message of the input, after the input's clock has moved, and after a step of
        the computer's clock.

        Args:
            topic: topic of the messages.
            stamps_ns: stamps of the messages, in ascending order.
            arrivals_ns: receive times, equal by both clocks.
        """
        clock = self._clocks.get(topic)
        if clock is None or clock.moved_ns or clock.own_offset_ns or self._computer is not None:
            return 0
        level_ns = clock.level_ns
        for number, (stamp_ns, arrival_ns) in enumerate(zip(stamps_ns, arrivals_ns, strict=True)):
            offset_ns = stamp_ns - arrival_ns
            if abs(offset_ns - level_ns) >= _MIN_STEP_NS:
                return number
            level_ns = offset_ns
        return len(stamps_ns)

    def add_block(self, topic: str, stamp_ns: int, arrival_ns: int, count: int) -> None:
        """Add messages without a step (:meth:`count_without_step`), given their number and the last message's times."""
        clock = self._clocks[topic]
        clock.period_ns = (arrival_ns - clock.arrival_ns) / count
        clock.level_ns, clock.newest_ns, clock.arrival_ns = stamp_ns - arrival_ns, stamp_ns, arrival_ns

    def ahead_ns(self, topic: str) -> int:
        """Return the lead of an input's clock, ns, if other frequent inputs are present; else 0.

        A lead up to :data:`_LONGEST_DELAY_NS` counts as 0, except within a second after a step of the computer's clock.
        Messages of an input with a lead are not used until it is decided whether the other clocks have moved too.
        """
        clock = self._clocks[topic]
        if clock.moved_ns <= (_LONGEST_DELAY_NS if self._computer is None else 0):
            return 0
        others = (other for name, other in self._clocks.items() if name != topic)
        return clock.moved_ns if any(_is_awaited(other, clock.arrival_ns) for other in others) else 0

    def is_misdated(self, stamp_ns: int, waiting_ns: int) -> bool:
        """True if a UTC stamp is ambiguous by one second because a leap second is being inserted.

        Clocks that count seconds since 1970 give the inserted second the number of a neighbour: of the last second of
        the old day or of the first second of the new day. Only the step back by one second shows which of the two
        seconds a stamp means.
        """
        number = bisect.bisect_right(self._leaps_ns, stamp_ns + SECOND_NS) - 1
        since_ns = stamp_ns - self._leaps_ns[number] if number >= 0 else SECOND_NS
        if since_ns >= SECOND_NS:
            return False
        was_inserted = self._leap_at_ns is not None and waiting_ns <= self._leap_at_ns + _LEAP_KNOWN_NS
        return self.is_step_pending or (since_ns < 0) == was_inserted

    # -- decisions ------------------------------------------------------------------------------------------

    def _has_moved(self, clock: _InputClock, moved_ns: int, stamp_ns: int, receive_ns: int, waiting_ns: int) -> bool:
        """True if no delay explains the offset of an input's clock."""
        computer_ns = 0 if self._computer is None else self._computer[0]
        if computer_ns and _are_equal(moved_ns, computer_ns):
            return True
        if abs(moved_ns) < _MIN_STEP_NS:
            return False
        if abs(moved_ns) < _SMALL_STEP_NS and clock.last_return_ns is not None:
            # Repeated or unordered messages look like a clock that steps back and forth.
            if waiting_ns - clock.last_return_ns <= _STEADY_AFTER_NS:
                return False
            clock.last_return_ns = None
        is_future = stamp_ns > receive_ns + _AHEAD_NS
        if clock.moved_ns and _are_equal(moved_ns, clock.moved_ns):
            # A clock far ahead of other present inputs stays moved, so that its messages are not used. A stamp in the
            # future is rejected in any case.
            keeps = moved_ns > _LONGEST_DELAY_NS and not is_future and self._has_unmoved_other(clock, waiting_ns)
            if not keeps and waiting_ns - clock.moved_since_ns > _OWN_CLOCK_AFTER_NS:
                clock.own_offset_ns += moved_ns
                return False
            return True
        if self._candidate is not None and _are_equal(moved_ns, self._candidate.step_ns):
            return True
        return stamp_ns <= clock.newest_ns if moved_ns < 0 else is_future or moved_ns > _LONGEST_DELAY_NS

    def _mark_late_inputs(self, first: _InputClock, waiting_ns: int) -> set[str]:
        """Mark as moved, and return, the inputs that seemed late but moved with the first input."""
        found = set()
        for name, clock in self._clocks.items():
            is_recent = clock.last_delay_ns and waiting_ns - clock.last_delay_at_ns <= _FOLLOWS_WITHIN_NS
            if is_recent and not clock.moved_ns and _are_equal(clock.last_delay_ns, first.moved_ns):
                clock.level_ns -= clock.last_delay_ns
                clock.moved_ns, clock.moved_since_ns = clock.last_delay_ns, clock.last_delay_at_ns
                clock.last_delay_ns = 0
                found.add(name)
        return found

    def _has_unmoved_other(self, clock: _InputClock, waiting_ns: int) -> bool:
        """True if another present input has not moved."""
        others = (other for other in self._clocks.values() if other is not clock and not other.moved_ns)
        return any(_is_awaited(other, waiting_ns) for other in others)

    def _decide(self, topic: str, clock: _InputClock, waiting_ns: int) -> int | None:
        """Update the possible step after a message of an input; return the step if it is now confirmed."""
        for other in self._clocks.values():
            if other.moved_ns and waiting_ns - other.arrival_ns > max(
                _ABSENCE_TIMEOUT_NS, _PRESENCE_PERIODS * other.period_ns
            ):
                other.own_offset_ns, other.moved_ns = other.own_offset_ns + other.moved_ns, 0
        candidate = self._candidate
        if not any(other.moved_ns for other in self._clocks.values()):
            self._candidate = None
            return None
        if candidate is None or (clock.moved_ns and not _are_equal(clock.moved_ns, candidate.step_ns)):
            agree = self._mark_late_inputs(clock, waiting_ns)
            candidate = self._candidate = _Candidate(clock.moved_ns, waiting_ns, agree)
        elif not clock.moved_ns:
            candidate.since_ns = waiting_ns
            candidate.agree.clear()
            return None
        candidate.agree.add(topic)
        candidate.messages += 1
        computer_ns = 0 if self._computer is None else self._computer[0]
        with_computer = computer_ns != 0 and _are_equal(candidate.step_ns, computer_ns)
        if not (with_computer and computer_ns < 0):
            awaited = {name for name, other in self._clocks.items() if _is_awaited(other, waiting_ns)}
            if len(candidate.agree) + with_computer < 2 or not awaited <= candidate.agree:
                return None
            may_be_disorder = abs(candidate.step_ns) < _SMALL_STEP_NS and candidate.messages < _LEAST_MESSAGES
            if waiting_ns - candidate.since_ns < _CONFIRMATION_NS or (may_be_disorder and not with_computer):
                return None
        fastest = min(candidate.agree, key=lambda name: (self._clocks[name].period_ns, name))
        return self._accept_step(computer_ns if with_computer else self._clocks[fastest].moved_ns, waiting_ns)

    def _accept_step(self, step_ns: int, waiting_ns: int) -> int:
        """Count a step of the time base and shift all clocks by it; return the step."""
        for clock in self._clocks.values():
            clock.level_ns += step_ns
            clock.newest_ns += step_ns
            clock.moved_ns = 0
        self._candidate = None
        self.steps, self.last_step_ns = self.steps + 1, step_ns
        if abs(step_ns - _LEAP_NS) <= _LEAP_TOLERANCE_NS:
            self._leap_at_ns = waiting_ns
        return step_ns


def step_text(step_ns: int) -> str:
    """Return the text of a time step."""
    return f"{step_ns / SECOND_NS:+.3f} s"


def _are_equal(step_ns: int, other_ns: int) -> bool:
    """True if two steps are equal within the accuracy that delays allow."""
    return abs(step_ns - other_ns) <= min(_TOLERANCE * abs(other_ns), _LARGEST_TOLERANCE_NS)


def _is_awaited(clock: _InputClock, waiting_ns: int) -> bool:
    """True if an input is present and so frequent that a decision waits for its next message."""
    if not 0.0 < clock.period_ns <= _LONGEST_PERIOD_NS:
        return False
    return waiting_ns - clock.arrival_ns <= _PRESENCE_PERIODS * clock.period_ns
