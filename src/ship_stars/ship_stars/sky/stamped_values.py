"""Values ordered by stamp, with rejection of jumps; the result does not depend on the order of arrival.

One receiver and one instrument provide the ship's position and the air for all stars. Star residuals do not reveal
errors of position and air, because all directions change equally, as if the INS tilted. But the speed of a ship is
limited, and so is the rate of change of the air. A value has jumped if its distance from the last accepted value
exceeds these limits (:class:`JumpLimits`). A value that has jumped is rejected, with the consistent values after it,
until one of two conditions is met:

- A value is again within the limits of the last accepted value. For a value that is consistent with the rejected
  values, the limits do not grow with the time since the last accepted value.
- The rejected values have been consistent for the confirmation time. Then the next consistent value is accepted; it is
  not connected to the values accepted before.

No earlier value confirms the first value; if the second value contradicts the first, the third value decides. With
``JumpLimits.min_consistent``, values without a predecessor are provisional until this number of different values are
consistent. Until then, the same number of consistent rejected values replace the provisional values. If the distance
of a value from the last accepted value is 0, the source may be frozen while the ship moves. Such a value does not count
as a different value, and the limits grow with the time during which the value is constant.

The decision on a value depends only on values with earlier stamps. A late value is evaluated in the order of stamps,
and the values after it are evaluated again.
"""

import bisect
import math
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from ship_estimation.rejection_rules import Content, Reason, Rejection, resolve_same_stamp
from ship_geometry.earth.time_scales import SECOND_NS

_NOISE_SIGMAS = 5.0
"""Number of standard deviations of the difference of two values that are attributed to noise."""

_MAX_FROZEN_S = 60.0
"""Maximum time of a constant value that widens the limits, s, because a ship at anchor may be stationary for days."""

_TIME_STEP_HISTORY_NS = 10 * SECOND_NS
"""Time before the last value for which values are kept over a step of the clocks, ns."""

_MAX_REJECTED = 100
"""Number of rejected values that are kept with their stamps; a value older than the kept values is late."""


class Quantity(Content, Protocol):
    """A measured quantity."""

    @property
    def sigma(self) -> float:
        """Standard deviation of the value."""
        ...

    def distance_to(self, other: Any) -> float:
        """Return the distance to another value of the same kind, in the unit of ``sigma``."""
        ...


Value = TypeVar("Value", bound=Quantity)


@dataclass(frozen=True)
class JumpLimits:
    """Limits of the distance between a value and an earlier one.

    Attributes:
        max_step: maximum distance of two values at the same time, in addition to their noise.
        max_rate: additional distance per second between the values.
        confirmation_s: time after which consistent values beyond the limits are accepted, s.
        unit: unit of the distance, for texts.
        min_consistent: number of different consistent values from which on values are not provisional, and number of
            consistent rejected values that replace provisional values. With 1, no value is provisional.
    """

    max_step: float
    max_rate: float
    confirmation_s: float
    unit: str
    min_consistent: int = 1

    def max_distance(self, earlier: Quantity, later: Quantity, seconds: float) -> float:
        """Return the maximum distance of two values ``seconds`` apart."""
        return self.max_step + self.max_rate * seconds + _NOISE_SIGMAS * math.hypot(earlier.sigma, later.sigma)


@dataclass(frozen=True, eq=False)
class _Stamped(Generic[Value]):
    """Value with its stamp; instances are compared by identity."""

    time_ns: int
    value: Value


@dataclass(frozen=True)
class _AcceptanceState(Generic[Value]):
    """State of acceptance after a value.

    Attributes:
        last_accepted: last accepted value.
        constant_since_ns: stamp since which the accepted value has been constant.
        is_first: True if the last accepted value has no predecessor.
        last_rejected: last of the consistent rejected values; None if the last value was accepted.
        rejected_since_ns: stamp of the first of the consistent rejected values.
        follows_jump: True if the last value was accepted although it had jumped.
        consistent_count: number of different consistent values up to the last accepted one, at most ``min_consistent``.
        rejected_count: number of consistent rejected values.
    """

    last_accepted: _Stamped[Value] | None = None
    constant_since_ns: int = 0
    is_first: bool = True
    last_rejected: _Stamped[Value] | None = None
    rejected_since_ns: int = 0
    follows_jump: bool = False
    consistent_count: int = 1
    rejected_count: int = 0


class StampedValues(Generic[Value]):
    """Values in the order of their stamps, with decisions on jumps.

    Of two values with the same stamp, the value whose bytes sort first is kept.

    Args:
        limits: limits beyond which a value has jumped.

    Attributes:
        times: stamps of the n accepted values in ascending order.
        values: the n accepted values.
        follows_jump: True for each of the n values that had jumped, so that it is not connected to the value before.
        conflict_changed_ns: stamp from which the last :meth:`insert` changed :meth:`has_conflict_at`; None without a
            change.
    """

    def __init__(self, limits: JumpLimits) -> None:
        self.times: list[int] = []
        self.values: list[Value] = []
        self.follows_jump: list[bool] = []
        self._limits = limits
        self._confirmation_ns = limits.confirmation_s * SECOND_NS
        # Stamps of all values, the values, and the state after each value.
        # `_initial_state` is the state after the dropped values.
        self._stamps: list[int] = []
        self._inputs: list[_Stamped[Value]] = []
        self._states: list[_AcceptanceState[Value]] = []
        self._initial_state: _AcceptanceState[Value] = _AcceptanceState()
        self._dropped_until_ns: int | None = None
        self.conflict_changed_ns: int | None = None

    # -- inputs ---------------------------------------------------------------------------------------------

    def rejection(self, time_ns: int, value: Value) -> Rejection | None:
        """Return the rejection of a value; None if the value is accepted.

        DUPLICATE or CONFLICT: a value with this stamp exists; of two different values, the value whose bytes sort first
        is kept. LATE: all stored stamps are later. JUMP: the value has jumped.
        """
        place = bisect.bisect_left(self._stamps, time_ns)
        if place < len(self._stamps) and self._stamps[place] == time_ns:
            return resolve_same_stamp(self._inputs[place].value, value)[1]
        if self._is_dropped(time_ns):
            return Rejection(Reason.LATE, "the stamp is older than all stored values of this source")
        before = self._state_before(place)
        if before.last_accepted is None or self._next_state(before, _Stamped(time_ns, value)).last_rejected is None:
            return None
        limits, distance = self._limits, value.distance_to(before.last_accepted.value)
        allowed = self._max_distance(before, time_ns, value)
        seconds = (time_ns - before.last_accepted.time_ns) / SECOND_NS
        jumped = f"jump by {distance:.4g} {limits.unit} from the last accepted value, {seconds:.1f} s earlier"
        if distance > allowed:
            jumped += f", limit {allowed:.3g} {limits.unit}"
        else:
            jumped += ", consistent with other values that jumped"
        condition = f"the jump has lasted for {limits.confirmation_s:g} s"
        if self._is_provisional(before):
            in_a_row = f"{limits.min_consistent} in a row are consistent (the accepted one is provisional)"
            condition = f"{in_a_row}, or {condition}"
        return Rejection(Reason.JUMP, f"{jumped}; accepted once {condition}")

    def insert(self, time_ns: int, value: Value) -> int | None:
        """Insert a value at its stamp; return the stamp from which accepted values changed, None without a change."""
        self.conflict_changed_ns = None
        if self._is_dropped(time_ns):
            return None
        place = bisect.bisect_left(self._stamps, time_ns)
        if place < len(self._stamps) and self._stamps[place] == time_ns:
            if self._inputs[place].value.content() <= value.content():
                return None
            self._inputs[place] = _Stamped(time_ns, value)
        else:
            self._stamps.insert(place, time_ns)
            self._inputs.insert(place, _Stamped(time_ns, value))
            self._states.insert(place, self._state_before(place))
        return self._evaluate_from(place)

    def drop_before(self, time_ns: int, keep: int = 1) -> None:
        """Drop old values, but keep the last ``keep`` accepted values at or before a time, and all later values."""
        count = bisect.bisect_right(self.times, time_ns) - keep
        if count > 0:
            del self.times[:count], self.values[:count], self.follows_jump[:count]
        elif len(self._stamps) <= _MAX_REJECTED:
            return
        passed = bisect.bisect_right(self._stamps, time_ns)
        needed = bisect.bisect_left(self._stamps, self.times[0]) if self.times else 0
        forgotten = min(passed, max(needed, passed - _MAX_REJECTED))
        if forgotten > 0:
            self._initial_state, self._dropped_until_ns = self._states[forgotten - 1], self._stamps[forgotten - 1]
            del self._stamps[:forgotten], self._inputs[:forgotten], self._states[:forgotten]

    def with_shifted_stamps(self, step_ns: int) -> "StampedValues[Value]":
        """Return the accepted values of the last ten seconds before the last value, with stamps later by a step.

        The returned values are provisional only if the last value is provisional.
        """
        shifted: StampedValues[Value] = StampedValues(self._limits)
        for time_ns, value in zip(self.times, self.values, strict=True):
            if time_ns >= self.times[-1] - _TIME_STEP_HISTORY_NS:
                shifted.insert(time_ns + step_ns, value)
        if not self._is_provisional(self._state_before(len(self._stamps))):
            shifted._states = [
                replace(belief, consistent_count=self._limits.min_consistent) for belief in shifted._states
            ]
        return shifted

    # -- results --------------------------------------------------------------------------------------------

    def last_before(self, time_ns: int) -> int:
        """Return the index of the last accepted value at or before a time; -1 without such a value."""
        return bisect.bisect_right(self.times, time_ns) - 1

    def has_conflict_at(self, time_ns: int) -> bool:
        """True if, at a time, one value contradicts the only provisional value, or two values contradict several."""
        return self._has_conflict(self._state_before(bisect.bisect_right(self._stamps, time_ns)))

    # -- decisions ------------------------------------------------------------------------------------------

    def _evaluate_from(self, place: int) -> int | None:
        """Evaluate values from an index on until a state is unchanged; the result is as for :meth:`insert`."""
        state, first = self._state_before(place), place
        while place < len(self._inputs):
            state = self._next_state(state, self._inputs[place])
            as_before = place > first and state == self._states[place]
            if self.conflict_changed_ns is None and self._has_conflict(state) != self._has_conflict(
                self._states[place]
            ):
                self.conflict_changed_ns = self._stamps[place]
            self._states[place] = state
            place += 1
            if as_before:
                break
        return self._replace_accepted(first, place)

    def _replace_accepted(self, first: int, last: int) -> int | None:
        """Replace the accepted values of a range after a new evaluation; the result is as for :meth:`insert`.

        Args:
            first: index of the first value of the range, among all values.
            last: index after the last value of the range.
        """
        begin = bisect.bisect_left(self.times, self._stamps[first])
        end = bisect.bisect_right(self.times, self._stamps[last - 1])
        evaluated = zip(self._inputs[first:last], self._states[first:last], strict=True)
        good = [(one, belief.follows_jump) for one, belief in evaluated if belief.last_accepted is one]
        # Skip the unchanged values at the start; the first of the others differs.
        while (
            good and begin < end and good[0][0].value is self.values[begin] and good[0][1] is self.follows_jump[begin]
        ):
            del good[0]
            begin += 1
        changed_ns = min([one.time_ns for one, _ in good[:1]] + self.times[begin:end][:1], default=None)
        self.times[begin:end] = [one.time_ns for one, _ in good]
        self.values[begin:end] = [one.value for one, _ in good]
        self.follows_jump[begin:end] = [follows_jump for _, follows_jump in good]
        return changed_ns

    def _next_state(self, before: _AcceptanceState[Value], new: _Stamped[Value]) -> _AcceptanceState[Value]:
        """Return the state of acceptance after a value."""
        last_accepted, last_rejected, limits = before.last_accepted, before.last_rejected, self._limits
        if last_accepted is None:
            return _AcceptanceState(new, new.time_ns)
        distance, step_s = new.value.distance_to(last_accepted.value), 0.0
        consistent_count = min(before.consistent_count + (distance != 0.0), limits.min_consistent)
        constant_since_ns = before.constant_since_ns if distance == 0.0 else new.time_ns
        accepted = _AcceptanceState(new, constant_since_ns, is_first=False, consistent_count=consistent_count)
        if last_rejected is not None:
            step_s = (new.time_ns - last_rejected.time_ns) / SECOND_NS
        if last_rejected is None or not new.value.distance_to(last_rejected.value) <= limits.max_distance(
            last_rejected.value, new.value, step_s
        ):
            # With the comparison in this form, a NaN distance leads to a rejection.
            is_near = distance <= self._max_distance(before, new.time_ns, new.value)
            rejected_state = replace(
                before, last_rejected=new, rejected_since_ns=new.time_ns, follows_jump=False, rejected_count=1
            )
            return accepted if is_near else rejected_state
        # For a value consistent with rejected values, the time since the last accepted value does not widen the limit.
        if distance <= limits.max_distance(last_accepted.value, new.value, step_s):
            return accepted
        count = before.rejected_count + 1
        has_lasted = new.time_ns - before.rejected_since_ns >= self._confirmation_ns
        if before.is_first or has_lasted or (self._is_provisional(before) and count >= limits.min_consistent):
            consistent_count = limits.min_consistent if has_lasted else min(count, limits.min_consistent)
            return _AcceptanceState(
                new, new.time_ns, is_first=False, follows_jump=True, consistent_count=consistent_count
            )
        return replace(before, last_rejected=new, follows_jump=False, rejected_count=count)

    def _is_provisional(self, state: _AcceptanceState[Value]) -> bool:
        """True if too few values are consistent with the last accepted one."""
        return state.consistent_count < self._limits.min_consistent

    def _has_conflict(self, state: _AcceptanceState[Value]) -> bool:
        """True if one value contradicts the only provisional value, or two values contradict several."""
        rejected_count = 0 if state.last_rejected is None else state.rejected_count
        return rejected_count >= min(2, state.consistent_count) and self._is_provisional(state)

    def _max_distance(self, before: _AcceptanceState[Value], time_ns: int, value: Value) -> float:
        """Return the maximum distance of a value from the last accepted one."""
        last_accepted = before.last_accepted
        assert last_accepted is not None
        constant_s = min((last_accepted.time_ns - before.constant_since_ns) / SECOND_NS, _MAX_FROZEN_S)
        return self._limits.max_distance(
            last_accepted.value, value, (time_ns - last_accepted.time_ns) / SECOND_NS + constant_s
        )

    def _state_before(self, place: int) -> _AcceptanceState[Value]:
        return self._states[place - 1] if place > 0 else self._initial_state

    def _is_dropped(self, time_ns: int) -> bool:
        return self._dropped_until_ns is not None and time_ns <= self._dropped_until_ns
