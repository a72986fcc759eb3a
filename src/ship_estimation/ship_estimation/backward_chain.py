"""The chain of a filter's states, along which later measurements tell of earlier moments.

A link of the chain is an estimate by the measurements up to its moment. What comes between two links is prediction, an
error that was added (a jump of a source, a gate re-opened), and the measurement of the later one. Where the estimate
changed otherwise, because a source was excluded or only some states were learnt, nothing leads back: the chain begins
anew there, and what is before it knows nothing of what comes after.

What is told of the moments between two links, and how the states go on from one to the next, each filter knows itself
(:class:`Between`). Its states must tell how they came about (:class:`Traced`).
"""

import bisect
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from ship_estimation.backward import Backward, Known, backward
from ship_geometry.rotations import FloatArray

Given = TypeVar("Given")
"""What else than an estimate and its moment the prediction from there asks for."""
GivenOut = TypeVar("GivenOut", covariant=True)

_MOST_AT_ONCE = 1000
"""Moments between two links that are predicted together."""

_ROUNDING = 1e-9
"""Of a difference of two covariances that counts as none."""


@dataclass(frozen=True)
class Came:
    """How a filter came to an estimate.

    Attributes:
        predicted: from the state before, with all that was added to its covariance before the measurement was used.
        estimate: with the measurement.
        is_update: whether it is what prediction and measurement together tell. Otherwise nothing leads back from it:
            only some states were learnt, or another estimate has taken its place.
        jumped_ns: of a jump of a source the stamp of its last sample before it, which may be later than the state;
            None for a measurement.
    """

    predicted: Known
    estimate: Known
    is_update: bool
    jumped_ns: int | None = None


class Traced(Protocol[GivenOut]):
    """A filter's state that tells its last step."""

    @property
    def time_ns(self) -> int | None:
        """Its moment; None before the first measurement."""
        ...

    @property
    def mean(self) -> FloatArray:
        """The estimate, shape (n,)."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """Of its error, shape (n, n)."""
        ...

    @property
    def came(self) -> Came | None:
        """By the last measurement used, or the last jump; None before the first."""
        ...

    @property
    def given(self) -> GivenOut:
        """What else the prediction from it asks for."""
        ...


@dataclass(frozen=True)
class Anchor(Generic[Given]):
    """An estimate of all n states from which is predicted.

    Attributes:
        time_ns: its moment; None before the first measurement.
        known: mean and covariance.
        given: what else the prediction from there asks for.
    """

    time_ns: int | None
    known: Known
    given: Given


class Between(Protocol[Given]):
    """What a filter's states are at moments between two links of a chain."""

    @property
    def knows_before_the_first(self) -> bool:
        """Whether anything is known of moments before the first measurement."""
        ...

    def cross_to(self, anchor: Anchor[Given], later: Anchor[Given]) -> FloatArray:
        """Covariance between the states at an anchor and those that are predicted at a later one, shape (n, n)."""
        ...

    def at(
        self, anchor: Anchor[Given], times_ns: Sequence[int], later: Anchor[Given] | None
    ) -> tuple[Known, FloatArray | None]:
        """The r quantities that are told of N moments, none before the anchor, in ascending order.

        Args:
            anchor: the last estimate before them.
            times_ns: the moments; those before a jump may be later than the estimate which that opens.
            later: the next estimate; None where there is none, or nothing leads back from it.

        Returns:
            Shapes (N, r) and (N, r, r); and the covariance with all states at the next estimate, shape (N, r, n).
        """
        ...


class Piece(NamedTuple):
    """Moments between two links, in ascending order.

    Attributes:
        times_ns: N of them.
        found: what is told of them, by the later link; where nothing leads back from that, as it is known.
    """

    times_ns: list[int]
    found: Backward | Known


@dataclass
class _Link:
    """An estimate, and what leads back from it.

    Attributes:
        back: to the link before; where nothing leads there, that link as it is known. None for the first link.
        stretches: moments between the two.
    """

    back: Backward | Known | None
    stretches: deque[Piece] = field(default_factory=deque)


class Chain(Generic[Given]):
    """Links of a chain and the moments between them, from the oldest one that is still asked for.

    Args:
        between: predicts.
        start: the state before those that are added.

    Attributes:
        between: the same; another one from the moment on at which noise and gates are others.
    """

    def __init__(self, between: Between[Given], start: Traced[Given]) -> None:
        self.between = between
        self._links: deque[_Link] = deque()
        self._last_came = start.came
        self._last = Anchor(start.time_ns, Known(start.mean, start.covariance), start.given)
        self._asked: deque[int] = deque()
        self._by_all: list[Known] = []

    @property
    def newest_ns(self) -> int | None:
        """Moment of the last link, or of the start; None before the first measurement."""
        return self._last.time_ns

    def ask(self, time_ns: int) -> None:
        """A moment is asked for, after the last link and after all others that were asked for."""
        self._asked.append(time_ns)

    def add(self, state: Traced[Given]) -> None:
        """The state after a measurement or a jump, which follows the one added last; most make a link."""
        came, before, now = state.came, self._last_came, Known(state.mean, state.covariance)
        self._last_came = came
        if state.time_ns is None:
            if not _same(now, self._last.known):
                # Changed before the first measurement: of what was until then nothing is told back.
                self._asked.clear()
                self._last = Anchor(None, now, state.given)
            return
        if came is not None and came is not before:
            self._lead_to(state, came.predicted, came.estimate, came.is_update, came.jumped_ns)
        if not _same(now, self._last.known):
            # Beside measurement and jump: the gate was re-opened, a mounting may have been knocked, or another row is
            # the first one now.
            self._lead_to(state, now, now, _is_opened(self._last.known, now))

    def take_until(self, time_ns: int) -> list[tuple[list[int], Known]]:
        """The moments up to one, and what is told of them by all links; they are not asked for again.

        A moment before the first link is left out where nothing is known of it.

        Returns:
            N moments in ascending order, and shapes (N, r) and (N, r, r) (:class:`Between`), more than once.
        """
        taken = []
        while self._links:
            stretches = self._links[0].stretches
            while stretches and stretches[0].times_ns[0] <= time_ns:
                due, rest = _cut(stretches.popleft(), time_ns)
                taken.append((due.times_ns, self._known(due)))
                if rest is not None:
                    stretches.appendleft(rest)
            if stretches:
                return taken
            self._links.popleft()
            if self._by_all:
                self._by_all.pop()
        times_ns = self._asked_until(time_ns)
        if times_ns and self._last.time_ns is not None:
            taken.append((times_ns, self.between.at(self._last, times_ns, None)[0]))
        return taken

    def _lead_to(
        self, state: Traced[Given], predicted: Known, estimate: Known, leads_back: bool, jumped_ns: int | None = None
    ) -> None:
        """A link more, and the moments before it; before a jump of a source are all that its samples tell of."""
        assert state.time_ns is not None
        last, is_first = self._last, self._last.time_ns is None
        reached = Anchor(state.time_ns, estimate, state.given)
        back: Backward | Known | None = None if is_first else last.known
        if leads_back and not is_first:
            back = backward(last.known, self.between.cross_to(last, reached), predicted)
        link, times_ns = _Link(back), self._asked_until(max(state.time_ns, jumped_ns or 0))
        if is_first and not self.between.knows_before_the_first:
            times_ns = []
        for start in range(0, len(times_ns), _MOST_AT_ONCE):
            some = times_ns[start : start + _MOST_AT_ONCE]
            found, cross = self.between.at(last, some, reached if leads_back else None)
            link.stretches.append(Piece(some, found if cross is None else backward(found, cross, predicted)))
        self._links.append(link)
        self._last = reached
        self._by_all = []

    def _asked_until(self, time_ns: int) -> list[int]:
        """The moments up to one that are asked for and belong to no link yet; they belong to one from now on."""
        times_ns = []
        while self._asked and self._asked[0] <= time_ns:
            times_ns.append(self._asked.popleft())
        return times_ns

    def _known(self, stretch: Piece) -> Known:
        """Moments before the first link that is left, by all links."""
        if isinstance(stretch.found, Known):
            return stretch.found
        if not self._by_all:
            known = self._last.known
            for link in reversed(self._links):
                self._by_all.append(known)
                if isinstance(link.back, Backward):
                    known = link.back.by(known)
                elif link.back is not None:
                    known = link.back
        return stretch.found.by(self._by_all[-1])


def _cut(stretch: Piece, time_ns: int) -> tuple[Piece, Piece | None]:
    """Its moments up to one, and the others."""
    count = bisect.bisect_right(stretch.times_ns, time_ns)
    if count == len(stretch.times_ns):
        return stretch, None
    first, rest = (
        Piece(stretch.times_ns[some], type(stretch.found)(*(values[some] for values in stretch.found)))
        for some in (slice(count), slice(count, None))
    )
    return first, rest


def _same(one: Known, other: Known) -> bool:
    return np.array_equal(one.mean, other.mean) and np.array_equal(one.covariance, other.covariance)


def _is_opened(before: Known, after: Known) -> bool:
    """Whether the one is the other with an error added."""
    if not np.array_equal(before.mean, after.mean):
        return False
    sigma = np.sqrt(after.covariance.diagonal())
    scale = np.where(sigma > 0.0, sigma, 1.0)
    added = (after.covariance - before.covariance) / (scale[:, None] * scale)
    # Written so that NaN is not.
    return bool(np.linalg.eigvalsh(added)[0] >= -_ROUNDING)
