"""Values ordered by stamp, with rejection of jumps; the result does not depend on the order of arrival.

One receiver and one instrument provide the ship's position and the air for all stars. Star residuals do not reveal an
error of these: all directions change equally, as if the INS tilted. But a ship's speed is limited, and so is the rate
at which the air changes. A value whose distance from the last accepted one exceeds these limits (:class:`JumpLimits`)
has jumped. It is rejected, and so are the values after it that are consistent with it, until

- a value is again within the limits of the last accepted one, and is not on the course of the rejected ones; or
- the rejected values have been consistent for the confirmation time. Then nothing older is valid any more, and they are
  accepted.

Nothing confirms a first value: where the second contradicts it, the third decides. Where ``JumpLimits.min_consistent``
is given, values without a predecessor are provisional until that number of different values are consistent. Until then,
the same number of consistent rejected values replace them. A value equal to the last one to the bit carries no
information, since the source may be frozen; the ship may have moved meanwhile.

The decision on each value depends only on the values before it, by stamp. A late value is evaluated at its place, and
those after it are evaluated again.
"""

import bisect
import math
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from ship_estimation.refusals import Content, Reason, Rejection, same_stamp
from ship_geometry.time_scales import SECOND_NS

_SIGMAS = 5.0
"""Number of standard deviations of two values' difference that are attributed to noise."""

_STANDS_S = 60.0
"""Largest frozen time that widens the limits, s: a ship at anchor may really be stationary for days."""

_TIME_STEP_HISTORY_NS = 10 * SECOND_NS
"""Maximum age before the last value of the values that are kept over a step of the clocks, ns."""

_REMEMBERED = 100
"""Number of rejected values that are kept with their stamps; a value older than these is late."""


class Quantity(Content, Protocol):
    """A measured quantity."""

    @property
    def sigma(self) -> float:
        """Standard deviation of the value."""
        ...

    def away(self, other: Any) -> float:
        """Return the distance to another value of the same kind, in the unit of ``sigma``."""
        ...


Value = TypeVar("Value", bound=Quantity)


@dataclass(frozen=True)
class JumpLimits:
    """Limits of the distance between a value and an earlier one.

    Attributes:
        max_step: allowed distance without any time between the two, in addition to their noise.
        max_rate: allowed distance per second between the two.
        confirmation_s: time after which consistent values beyond the limits are accepted, s.
        unit: unit of these limits, for texts.
        min_consistent: number of different consistent values after which they are no longer provisional; also the
            number of rejected values that replace provisional ones. 1: no value is provisional.
    """

    at_once: float
    per_s: float
    confirmation_s: float
    unit: str
    settled_by: int = 1

    def between(self, earlier: Quantity, later: Quantity, seconds: float) -> float:
        """Return the maximum distance of two values that both have their stated accuracy."""
        return self.at_once + self.per_s * seconds + _SIGMAS * math.hypot(earlier.sigma, later.sigma)


@dataclass(frozen=True, eq=False)
class _Stamped(Generic[Value]):
    """A value with its stamp; instances compare by identity."""

    time_ns: int
    value: Value


@dataclass(frozen=True)
class _Belief(Generic[Value]):
    """State of acceptance after a value.

    Attributes:
        last_accepted: the last accepted value.
        constant_since_ns: stamp since which the value has been constant.
        is_first: True if it was accepted without a predecessor.
        last_rejected: the last one of the consistent rejected values; None if the last value was accepted.
        rejected_since_ns: stamp of the first of them.
        follows_jump: True if the last value was accepted although it had jumped.
        consistent_count: number of different values consistent with the last accepted one, itself included, at most
            ``min_consistent``.
        rejected_count: number of consistent rejected values.
    """

    last_accepted: _Stamped[Value] | None = None
    stood_ns: int = 0
    alone: bool = True
    last_rejected: _Stamped[Value] | None = None
    since_ns: int = 0
    follows_jump: bool = False
    consistent_count: int = 1
    opposed: int = 0


class StampedValues(Generic[Value]):
    """Values in the order of their stamps; of two with the same stamp, the one whose bytes sort first is kept.

    Args:
        limits: a value beyond these limits from the last accepted value has jumped.

    Attributes:
        times: stamps of the accepted values, increasing.
        values: the accepted values, of the same length.
        follows_jump: True if the value had jumped, so that it is not connected to the one before; of the same length.
        conflict_changed_ns: stamp from which on the last :meth:`insert` changed :meth:`has_conflict_at`; None for none.
    """

    def __init__(self, limits: JumpLimits) -> None:
        self.times: list[int] = []
        self.values: list[Value] = []
        self.follows_jump: list[bool] = []
        self._limits = limits
        self._lasts_ns = limits.confirmation_s * SECOND_NS
        # All values, and the state after each of them; `_initial_state` is the state after the dropped values.
        self._stamps: list[int] = []
        self._taken: list[_Stamped[Value]] = []
        self._beliefs: list[_Belief[Value]] = []
        self._before: _Belief[Value] = _Belief()
        self._forgotten_ns: int | None = None
        self.conflict_changed_ns: int | None = None

    # -- inputs ---------------------------------------------------------------------------------------------

    def rejection(self, time_ns: int, value: Value) -> Rejection | None:
        """Return DUPLICATE or CONFLICT if a value with this stamp exists, LATE, or JUMP if the value has jumped."""
        place = bisect.bisect_left(self._stamps, time_ns)
        if place < len(self._stamps) and self._stamps[place] == time_ns:
            return same_stamp(self._taken[place].value, value)[1]
        if self._is_forgotten(time_ns):
            return Rejection(Reason.LATE, "its stamp is older than the values kept of its own source")
        before = self._belief_before(place)
        if before.last_accepted is None or self._next_state(before, _Stamped(time_ns, value)).last_rejected is None:
            return None
        limits, away, allowed = self._limits, value.away(before.last_accepted.value), self._reach(before, time_ns, value)
        seconds = (time_ns - before.last_accepted.time_ns) / SECOND_NS
        jumped = f"{away:.4g} {limits.unit} from the last accepted value, {seconds:.1f} s before it"
        if away > allowed:
            jumped += f", limit {allowed:.3g} {limits.unit}"
        else:
            jumped += ", consistent with other values that had jumped"
        lasts = f"it has lasted for {limits.confirmation_s:g} s"
        if self._is_provisional(before):
            lasts = f"{limits.settled_by} in a row are consistent (the accepted one is provisional), or {lasts}"
        return Rejection(Reason.JUMP, f"{jumped}; accepted once {lasts}")

    def insert(self, time_ns: int, value: Value) -> int | None:
        """Insert a value at its stamp; return the stamp from which accepted values have changed, None for none."""
        self.conflict_changed_ns = None
        if self._is_forgotten(time_ns):
            return None
        place = bisect.bisect_left(self._stamps, time_ns)
        if place < len(self._stamps) and self._stamps[place] == time_ns:
            if self._taken[place].value.content() <= value.content():
                return None
            self._taken[place] = _Stamped(time_ns, value)
        else:
            self._stamps.insert(place, time_ns)
            self._taken.insert(place, _Stamped(time_ns, value))
            self._beliefs.insert(place, self._belief_before(place))
        return self._evaluate_from(place)

    def drop_before(self, time_ns: int, keep: int = 1) -> None:
        """Drop old values, but keep the last ``keep`` accepted ones at or before a time and all later ones."""
        count = bisect.bisect_right(self.times, time_ns) - keep
        if count > 0:
            del self.times[:count], self.values[:count], self.follows_jump[:count]
        elif len(self._stamps) <= _REMEMBERED:
            return
        passed = bisect.bisect_right(self._stamps, time_ns)
        needed = bisect.bisect_left(self._stamps, self.times[0]) if self.times else 0
        forgotten = min(passed, max(needed, passed - _REMEMBERED))
        if forgotten > 0:
            self._before, self._forgotten_ns = self._beliefs[forgotten - 1], self._stamps[forgotten - 1]
            del self._stamps[:forgotten], self._taken[:forgotten], self._beliefs[:forgotten]

    def with_shifted_stamps(self, step_ns: int) -> "StampedValues[Value]":
        """Return the accepted values of the last seconds, or the last one, with stamps later by a step.

        They are provisional only if the last one is.
        """
        shifted: StampedValues[Value] = StampedValues(self._limits)
        for time_ns, value in zip(self.times, self.values, strict=True):
            if time_ns >= self.times[-1] - _TIME_STEP_HISTORY_NS:
                shifted.insert(time_ns + step_ns, value)
        if not self._is_provisional(self._belief_before(len(self._stamps))):
            shifted._beliefs = [replace(belief, agreed=self._limits.settled_by) for belief in shifted._beliefs]
        return shifted

    # -- results --------------------------------------------------------------------------------------------

    def last_before(self, time_ns: int) -> int:
        """Return the index of the last value accepted at or before a time; -1 if there is none."""
        return bisect.bisect_right(self.times, time_ns) - 1

    def has_conflict_at(self, time_ns: int) -> bool:
        """True if provisional values are contradicted at a time: a single one by one value, several by two values."""
        return self._has_conflict(self._belief_before(bisect.bisect_right(self._stamps, time_ns)))

    # -- decisions ------------------------------------------------------------------------------------------

    def _evaluate_from(self, place: int) -> int | None:
        """Evaluate a value and those after it until their state is unchanged; returns as :meth:`insert`."""
        belief, first = self._belief_before(place), place
        while place < len(self._taken):
            belief = self._next_state(belief, self._taken[place])
            as_before = place > first and belief == self._beliefs[place]
            if self.conflict_changed_ns is None and self._has_conflict(belief) != self._has_conflict(self._beliefs[place]):
                self.conflict_changed_ns = self._stamps[place]
            self._beliefs[place] = belief
            place += 1
            if as_before:
                break
        return self._put(first, place)

    def _put(self, first: int, last: int) -> int | None:
        """Replace the accepted values of a range by newly evaluated ones; returns as :meth:`insert`.

        Args:
            first: index of the first value of the range, among all values.
            last: index after the last one.
        """
        begin = bisect.bisect_left(self.times, self._stamps[first])
        end = bisect.bisect_right(self.times, self._stamps[last - 1])
        evaluated = zip(self._taken[first:last], self._beliefs[first:last], strict=True)
        good = [(one, belief.follows_jump) for one, belief in evaluated if belief.last_accepted is one]
        # Skip the values that are unchanged; the rest differs from its first one on.
        while good and begin < end and good[0][0].value is self.values[begin] and good[0][1] is self.follows_jump[begin]:
            del good[0]
            begin += 1
        changed_ns = min([one.time_ns for one, _ in good[:1]] + self.times[begin:end][:1], default=None)
        self.times[begin:end] = [one.time_ns for one, _ in good]
        self.values[begin:end] = [one.value for one, _ in good]
        self.follows_jump[begin:end] = [anew for _, anew in good]
        return changed_ns

    def _next_state(self, before: _Belief[Value], new: _Stamped[Value]) -> _Belief[Value]:
        """Return the state of acceptance after a value."""
        last_accepted, last_rejected, limits = before.last_accepted, before.last_rejected, self._limits
        if last_accepted is None:
            return _Belief(new, new.time_ns)
        away, step_s = new.value.away(last_accepted.value), 0.0
        consistent_count = min(before.consistent_count + (away != 0.0), limits.settled_by)
        taken = _Belief(new, before.stood_ns if away == 0.0 else new.time_ns, alone=False, consistent_count=consistent_count)
        if last_rejected is not None:
            step_s = (new.time_ns - last_rejected.time_ns) / SECOND_NS
        if last_rejected is None or not new.value.away(last_rejected.value) <= limits.between(last_rejected.value, new.value, step_s):
            # Written so that NaN is rejected.
            is_near = away <= self._reach(before, new.time_ns, new.value)
            opposed = replace(before, refused=new, since_ns=new.time_ns, anew=False, opposed=1)
            return taken if is_near else opposed
        # For a value consistent with rejected ones, the time since the last accepted value does not widen the limit.
        if away <= limits.between(last_accepted.value, new.value, step_s):
            return taken
        count = before.opposed + 1
        has_lasted = new.time_ns - before.since_ns >= self._lasts_ns
        if before.alone or has_lasted or (self._is_provisional(before) and count >= limits.settled_by):
            consistent_count = limits.settled_by if has_lasted else min(count, limits.settled_by)
            return _Belief(new, new.time_ns, alone=False, follows_jump=True, consistent_count=consistent_count)
        return replace(before, refused=new, anew=False, opposed=count)

    def _is_provisional(self, belief: _Belief[Value]) -> bool:
        """True if too few values are consistent with the last accepted one."""
        return belief.consistent_count < self._limits.settled_by

    def _has_conflict(self, belief: _Belief[Value]) -> bool:
        """True if a value contradicts a single provisional one, or two values contradict several."""
        opposed = 0 if belief.last_rejected is None else belief.opposed
        return opposed >= min(2, belief.consistent_count) and self._is_provisional(belief)

    def _reach(self, before: _Belief[Value], time_ns: int, value: Value) -> float:
        """Return the maximum distance of a value from the last accepted one."""
        last_accepted = before.last_accepted
        assert last_accepted is not None
        stood_s = min((last_accepted.time_ns - before.stood_ns) / SECOND_NS, _STANDS_S)
        return self._limits.between(last_accepted.value, value, (time_ns - last_accepted.time_ns) / SECOND_NS + stood_s)

    def _belief_before(self, place: int) -> _Belief[Value]:
        return self._beliefs[place - 1] if place > 0 else self._before

    def _is_forgotten(self, time_ns: int) -> bool:
        return self._forgotten_ns is not None and time_ns <= self._forgotten_ns
