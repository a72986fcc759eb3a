"""Values by their stamps, of which those that jump are left out; any order of arrival ends in the same.

What all stars share, the ship's place and the air around her, is told by one receiver and one instrument. No star tells
that these are wrong: all of them move alike, as if the INS tilted. But a ship sails no faster than she can, and the air
changes no faster than weather does. A value further from the last one believed than that (:class:`JumpLimits`) has
jumped. It is refused, and so are those after it that hang together with it, until

- a value is again where the last one believed allows it, and not where the refused ones lead; or
- they have hung together for as long as a value holds: then nothing older holds any more, and they are believed anew.

Nothing speaks for a first value but itself: where the second contradicts it, the third decides. Where
``JumpLimits.settled_by`` is given, values without a predecessor are provisional until that number of different ones
agree; before, the same number of refused values that hang together replace them. A value that stands to the last bit
tells nothing new, be it that the source is frozen: meanwhile the ship may have sailed.

Each verdict follows from the values before it alone, by their stamps. A late value is judged at its place, and those
after it anew.
"""

import bisect
import math
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from ship_estimation.refusals import Content, Reason, Refusal, same_stamp
from ship_geometry.time_scales import SECOND_NS

_SIGMAS = 5.0
"""So many sigmas of two values taken together are noise."""

_STANDS_S = 60.0
"""What a frozen source has not told counts for so long: a ship at anchor may truly stand for days."""

_CARRIED_NS = 10 * SECOND_NS
"""Values that are older than this before the last one are not carried over a step of the clocks, ns."""

_REMEMBERED = 100
"""So many refused values are kept with their stamps; what comes later than that behind its own stream is late."""


class Quantity(Content, Protocol):
    """Something that was measured."""

    @property
    def sigma(self) -> float:
        """Its standard deviation."""
        ...

    def away(self, other: Any) -> float:
        """How far it is from another one of its kind, in the unit of sigma."""
        ...


Value = TypeVar("Value", bound=Quantity)


@dataclass(frozen=True)
class JumpLimits:
    """How far a true value may be from an earlier one.

    Attributes:
        at_once: in no time at all, beside the noise of both.
        per_s: more for each second between the two.
        lasts_s: what is further away is believed after it has lasted for so long.
        unit: of all these, for people.
        settled_by: number of different values that agree after which they are no longer provisional; also number of
            refused ones that replace provisional ones. 1: no value is provisional.
    """

    at_once: float
    per_s: float
    lasts_s: float
    unit: str
    settled_by: int = 1

    def between(self, earlier: Quantity, later: Quantity, seconds: float) -> float:
        """How far two values may be apart that are both as good as they say."""
        return self.at_once + self.per_s * seconds + _SIGMAS * math.hypot(earlier.sigma, later.sigma)


@dataclass(frozen=True, eq=False)
class _Stamped(Generic[Value]):
    """A value with its stamp; equal to itself alone."""

    time_ns: int
    value: Value


@dataclass(frozen=True)
class _Belief(Generic[Value]):
    """What is believed after a value.

    Attributes:
        good: the last value believed.
        stood_ns: stamp since when it is the same.
        alone: whether it was believed without any before it.
        refused: the last one of those that hang together and are refused; None where the last value was believed.
        since_ns: stamp of the first of them.
        anew: whether the last value was believed although it had jumped.
        agreed: number of different values that agree with the last one believed, itself included; no more are counted
            than make it settled.
        opposed: number of refused values that hang together.
    """

    good: _Stamped[Value] | None = None
    stood_ns: int = 0
    alone: bool = True
    refused: _Stamped[Value] | None = None
    since_ns: int = 0
    anew: bool = False
    agreed: int = 1
    opposed: int = 0


class StampedValues(Generic[Value]):
    """Values in the order of their stamps; of two with the same stamp the one whose bytes sort first is kept.

    Args:
        limits: what is further than that from the last value believed has jumped.

    Attributes:
        times: stamps of the values that are believed, increasing.
        values: of the same length.
        anew: whether the value had jumped, so that nothing leads from the one before to it; of the same length.
        disputed_since_ns: stamp from which on the last :meth:`insert` has changed :meth:`is_disputed`; None for none.
    """

    def __init__(self, limits: JumpLimits) -> None:
        self.times: list[int] = []
        self.values: list[Value] = []
        self.anew: list[bool] = []
        self._limits = limits
        self._lasts_ns = limits.lasts_s * SECOND_NS
        # All values, and what is believed after each of them; before them, what is forgotten has led to a belief too.
        self._stamps: list[int] = []
        self._taken: list[_Stamped[Value]] = []
        self._beliefs: list[_Belief[Value]] = []
        self._before: _Belief[Value] = _Belief()
        self._forgotten_ns: int | None = None
        self.disputed_since_ns: int | None = None

    # -- inputs ---------------------------------------------------------------------------------------------

    def refusal(self, time_ns: int, value: Value) -> Refusal | None:
        """DUPLICATE or CONFLICT where there is a value of that stamp, LATE, or JUMP where the value has jumped."""
        place = bisect.bisect_left(self._stamps, time_ns)
        if place < len(self._stamps) and self._stamps[place] == time_ns:
            return same_stamp(self._taken[place].value, value)[1]
        if self._is_forgotten(time_ns):
            return Refusal(Reason.LATE, "its stamp lies before what is remembered of its own source")
        before = self._belief_before(place)
        if before.good is None or self._believed(before, _Stamped(time_ns, value)).refused is None:
            return None
        limits, away, allowed = self._limits, value.away(before.good.value), self._reach(before, time_ns, value)
        seconds = (time_ns - before.good.time_ns) / SECOND_NS
        jumped = f"{away:.4g} {limits.unit} from the last one believed, {seconds:.1f} s before it"
        if away > allowed:
            jumped += f": more than {allowed:.3g} {limits.unit} cannot be"
        else:
            jumped += ": it hangs together with others that had jumped"
        lasts = f"it has lasted for {limits.lasts_s:g} s"
        if self._is_provisional(before):
            lasts = f"{limits.settled_by} in a row agree, as the one believed is provisional, or {lasts}"
        return Refusal(Reason.JUMP, f"{jumped}; believed once {lasts}")

    def insert(self, time_ns: int, value: Value) -> int | None:
        """Put a value in its place; returns the stamp from which on what is believed has changed, None for nothing."""
        self.disputed_since_ns = None
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
        return self._judge_from(place)

    def drop_before(self, time_ns: int, keep: int = 1) -> None:
        """Forget old values, but keep the last ``keep`` believed at or before a moment and all after it."""
        count = bisect.bisect_right(self.times, time_ns) - keep
        if count > 0:
            del self.times[:count], self.values[:count], self.anew[:count]
        elif len(self._stamps) <= _REMEMBERED:
            return
        passed = bisect.bisect_right(self._stamps, time_ns)
        needed = bisect.bisect_left(self._stamps, self.times[0]) if self.times else 0
        forgotten = min(passed, max(needed, passed - _REMEMBERED))
        if forgotten > 0:
            self._before, self._forgotten_ns = self._beliefs[forgotten - 1], self._stamps[forgotten - 1]
            del self._stamps[:forgotten], self._taken[:forgotten], self._beliefs[:forgotten]

    def with_shifted_stamps(self, step_ns: int) -> "StampedValues[Value]":
        """Return the values that are believed, of the last seconds or the last one, with stamps later by a step.

        They are provisional only where the last one is.
        """
        shifted: StampedValues[Value] = StampedValues(self._limits)
        for time_ns, value in zip(self.times, self.values, strict=True):
            if time_ns >= self.times[-1] - _CARRIED_NS:
                shifted.insert(time_ns + step_ns, value)
        if not self._is_provisional(self._belief_before(len(self._stamps))):
            shifted._beliefs = [replace(belief, agreed=self._limits.settled_by) for belief in shifted._beliefs]
        return shifted

    # -- answers --------------------------------------------------------------------------------------------

    def last_before(self, time_ns: int) -> int:
        """Index of the last value believed at or before a moment; -1 where there is none."""
        return bisect.bisect_right(self.times, time_ns) - 1

    def is_disputed(self, time_ns: int) -> bool:
        """True if a provisional value was contradicted last before a moment, more than by one outlier among several."""
        return self._disputes(self._belief_before(bisect.bisect_right(self._stamps, time_ns)))

    # -- verdicts -------------------------------------------------------------------------------------------

    def _judge_from(self, place: int) -> int | None:
        """Judge a value, and those after it until they are believed or not as before; returns as :meth:`insert`."""
        belief, first = self._belief_before(place), place
        while place < len(self._taken):
            belief = self._believed(belief, self._taken[place])
            as_before = place > first and belief == self._beliefs[place]
            if self.disputed_since_ns is None and self._disputes(belief) != self._disputes(self._beliefs[place]):
                self.disputed_since_ns = self._stamps[place]
            self._beliefs[place] = belief
            place += 1
            if as_before:
                break
        return self._put(first, place)

    def _put(self, first: int, last: int) -> int | None:
        """Put what is believed of some values in the place of what was; returns as :meth:`insert`.

        Args:
            first: index of the first of them, among all values.
            last: index after the last one.
        """
        begin = bisect.bisect_left(self.times, self._stamps[first])
        end = bisect.bisect_right(self.times, self._stamps[last - 1])
        judged = zip(self._taken[first:last], self._beliefs[first:last], strict=True)
        good = [(one, belief.anew) for one, belief in judged if belief.good is one]
        # Where all before are as they were, what is left differs from its first on.
        while good and begin < end and good[0][0].value is self.values[begin] and good[0][1] is self.anew[begin]:
            del good[0]
            begin += 1
        changed_ns = min([one.time_ns for one, _ in good[:1]] + self.times[begin:end][:1], default=None)
        self.times[begin:end] = [one.time_ns for one, _ in good]
        self.values[begin:end] = [one.value for one, _ in good]
        self.anew[begin:end] = [anew for _, anew in good]
        return changed_ns

    def _believed(self, before: _Belief[Value], new: _Stamped[Value]) -> _Belief[Value]:
        """What is believed after a value."""
        good, refused, limits = before.good, before.refused, self._limits
        if good is None:
            return _Belief(new, new.time_ns)
        away, step_s = new.value.away(good.value), 0.0
        agreed = min(before.agreed + (away != 0.0), limits.settled_by)
        taken = _Belief(new, before.stood_ns if away == 0.0 else new.time_ns, alone=False, agreed=agreed)
        if refused is not None:
            step_s = (new.time_ns - refused.time_ns) / SECOND_NS
        if refused is None or not new.value.away(refused.value) <= limits.between(refused.value, new.value, step_s):
            # Written so that NaN is not believed.
            is_near = away <= self._reach(before, new.time_ns, new.value)
            opposed = replace(before, refused=new, since_ns=new.time_ns, anew=False, opposed=1)
            return taken if is_near else opposed
        # What hangs together with refused values does not profit from the time that has passed since the last good one.
        if away <= limits.between(good.value, new.value, step_s):
            return taken
        count = before.opposed + 1
        has_lasted = new.time_ns - before.since_ns >= self._lasts_ns
        if before.alone or has_lasted or (self._is_provisional(before) and count >= limits.settled_by):
            agreed = limits.settled_by if has_lasted else min(count, limits.settled_by)
            return _Belief(new, new.time_ns, alone=False, anew=True, agreed=agreed)
        return replace(before, refused=new, anew=False, opposed=count)

    def _is_provisional(self, belief: _Belief[Value]) -> bool:
        """True if too few values agree with the last one believed."""
        return belief.agreed < self._limits.settled_by

    def _disputes(self, belief: _Belief[Value]) -> bool:
        """True if a value contradicts a single provisional one, or two values contradict several."""
        opposed = 0 if belief.refused is None else belief.opposed
        return opposed >= min(2, belief.agreed) and self._is_provisional(belief)

    def _reach(self, before: _Belief[Value], time_ns: int, value: Value) -> float:
        """How far a value may be from the last one believed."""
        good = before.good
        assert good is not None
        stood_s = min((good.time_ns - before.stood_ns) / SECOND_NS, _STANDS_S)
        return self._limits.between(good.value, value, (time_ns - good.time_ns) / SECOND_NS + stood_s)

    def _belief_before(self, place: int) -> _Belief[Value]:
        return self._beliefs[place - 1] if place > 0 else self._before

    def _is_forgotten(self, time_ns: int) -> bool:
        return self._forgotten_ns is not None and time_ns <= self._forgotten_ns
