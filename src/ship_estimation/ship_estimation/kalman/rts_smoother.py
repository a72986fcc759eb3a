"""Rauch-Tung-Striebel smoother over the states of a filter, with a fixed lag.

Forward in time the filter goes from an estimate x of covariance P to the prediction of a later state y. The prediction
has the mean p and the covariance Q. C is the covariance between x and y (C = P F^T where y = F x + noise). Then, for
Gaussian errors,

    x = (mean + C Q^-1 (y - p)) + error of covariance (P - C Q^-1 C^T)

where the error is independent of later measurements. Applied from the last state to the first, this relation is the
smoother of Rauch, Tung and Striebel (AIAA Journal 3 (1965) 1445). The estimate of y by all measurements gives the
estimate of x by all measurements.

A link is an estimate by the measurements up to its time. Between two links are the prediction, an inflation of the
covariance (for a jump of a source or a mounting shift), and the measurement of the later link. If the estimate changed
otherwise, because a source was excluded or only some states were updated, there is no backward step. The smoother then
restarts, and earlier times get no information from later measurements.

Each filter defines the smoothed quantities between two links, and the prediction from one link to the next
(:class:`StatePredictor`). The states of the filter must record their last update (:class:`TracedState`).
"""

import bisect
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from ship_geometry.rotations import FloatArray

_MOST_AT_ONCE = 1000
"""Maximum number of times between two links that are predicted together."""

_ROUNDING = 1e-9
"""Size of a negative eigenvalue that counts as zero in a difference of two normalised covariances."""


class GaussianEstimate(NamedTuple):
    """A Gaussian estimate of r quantities, or several such estimates, with mean (..., r) and covariance (..., r, r)."""

    mean: FloatArray
    covariance: FloatArray


class SmootherStep(NamedTuple):
    """Linear relation of r quantities at an earlier time to n states at a later time, or several such relations.

    Attributes:
        gain: smoother gain, shape (..., r, n).
        offset: mean of the earlier quantities if all later states are zero, shape (..., r).
        covariance: covariance of the remaining error for exactly known later states, shape (..., r, r).
    """

    gain: FloatArray
    offset: FloatArray
    covariance: FloatArray

    def apply(self, later: GaussianEstimate) -> GaussianEstimate:
        """Return the estimate of the earlier quantities from an estimate of the later states."""
        gain = self.gain
        covariance = self.covariance + gain @ later.covariance @ np.swapaxes(gain, -1, -2)
        return GaussianEstimate(self.offset + gain @ later.mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2)))


def smoother_step(earlier: GaussianEstimate, cross: FloatArray, predicted: GaussianEstimate) -> SmootherStep:
    """Return the backward step from n predicted states to r earlier quantities, or several such steps.

    Args:
        earlier: estimate by the measurements up to the earlier time, shapes (..., r) and (..., r, r).
        cross: covariance between these quantities and the predicted states, shape (..., r, n).
        predicted: prediction of the later states by the same measurements, shapes (n,) and (n, n).

    Example:
        In a random walk the first position has variance 1 and the next position variance 2. If the next position is
        known to be 4, the first position was about 2, with half of its variance:

        >>> first, second = GaussianEstimate(np.zeros(1), np.eye(1)), GaussianEstimate(np.zeros(1), 2.0 * np.eye(1))
        >>> found = smoother_step(first, np.eye(1), second).apply(GaussianEstimate(np.array([4.0]), np.zeros((1, 1))))
        >>> print(found.mean, found.covariance.round(12))
        [2.] [[0.5]]
    """
    gain = cross @ _inverse(predicted.covariance)
    left = earlier.covariance - gain @ predicted.covariance @ np.swapaxes(gain, -1, -2)
    return SmootherStep(gain, earlier.mean - gain @ predicted.mean, left)


def _inverse(covariance: FloatArray) -> FloatArray:
    """Return the pseudo-inverse, in which directions known exactly, or within rounding, have no effect."""
    sigma = np.sqrt(covariance.diagonal())
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / (scale[:, None] * scale))
    uncertain = values > len(values) * np.finfo(float).eps * values[-1]
    inverse = np.where(uncertain, 1.0 / np.where(uncertain, values, 1.0), 0.0)
    found: FloatArray = (vectors * inverse) @ vectors.T / (scale[:, None] * scale)
    return found


Given = TypeVar("Given")
"""Further input of the prediction, besides an estimate and its time."""
GivenOut = TypeVar("GivenOut", covariant=True)


@dataclass(frozen=True)
class StateUpdate:
    """Last update of a filter state.

    Attributes:
        predicted: prediction from the state before, with inflations of its covariance.
        estimate: estimate after the measurement.
        is_update: True if ``estimate`` is the full update of ``predicted``. False if only some states were updated, or
            if another filter replaced the estimate; then there is no backward step.
        jumped_ns: stamp of the last sample before a jump of a source; this stamp may be later than the state. None for
            a measurement.
    """

    predicted: GaussianEstimate
    estimate: GaussianEstimate
    is_update: bool
    jumped_ns: int | None = None


class TracedState(Protocol[GivenOut]):
    """A filter state that records its last update."""

    @property
    def time_ns(self) -> int | None:
        """Time of the state; None before the first measurement."""
        ...

    @property
    def mean(self) -> FloatArray:
        """Mean of the state, shape (n,)."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state, shape (n, n)."""
        ...

    @property
    def last_update(self) -> StateUpdate | None:
        """The last update, by an accepted measurement or a jump; None before the first update."""
        ...

    @property
    def prediction_input(self) -> GivenOut:
        """Further input of the prediction from this state."""
        ...


@dataclass(frozen=True)
class Anchor(Generic[Given]):
    """An estimate of all n states as the start of predictions.

    Attributes:
        time_ns: time of the estimate; None before the first measurement.
        estimate: mean and covariance.
        prediction_input: further input of the prediction.
    """

    time_ns: int | None
    estimate: GaussianEstimate
    prediction_input: Given


class StatePredictor(Protocol[Given]):
    """Prediction of a filter's states between two links."""

    @property
    def predicts_before_first(self) -> bool:
        """True if quantities can be given for times before the first measurement."""
        ...

    def cross_to(self, anchor: Anchor[Given], later: Anchor[Given]) -> FloatArray:
        """Return the covariance between states at an anchor and predicted states at a later anchor, shape (n, n)."""
        ...

    def estimates_at(
        self, anchor: Anchor[Given], times_ns: Sequence[int], later: Anchor[Given] | None
    ) -> tuple[GaussianEstimate, FloatArray | None]:
        """Return the r quantities to smooth, predicted at N ascending times at or after the anchor.

        Args:
            anchor: last estimate before the times.
            times_ns: the N times. If ``later`` is inflated for a jump, the times up to the jump may be after ``later``.
            later: next estimate; None without a next estimate or without a backward step from the next estimate.

        Returns:
            Estimates, shapes (N, r) and (N, r, r), and covariance with all states at the next estimate,
            shape (N, r, n), or None without a next estimate.
        """
        ...


class Piece(NamedTuple):
    """Requested times between two links, in ascending order.

    Attributes:
        times_ns: N times.
        found: backward step from the later link to these times; the estimate at these times if there is no backward
            step.
    """

    times_ns: list[int]
    found: SmootherStep | GaussianEstimate


@dataclass
class _Link:
    """An estimate, and the backward steps from it.

    Attributes:
        back: backward step to the link before; the estimate of that link if there is no backward step. None for the
            first link.
        pieces: requested times between the link before and this link.
    """

    back: SmootherStep | GaussianEstimate | None
    pieces: deque[Piece] = field(default_factory=deque)


class RtsSmoother(Generic[Given]):
    """Links and the requested times between them, from the oldest required link on.

    Args:
        between: predictor of states and quantities between links.
        start: state before the added states.

    Attributes:
        predictor: ``between``, which is replaced when noise and gates are reconfigured.
    """

    def __init__(self, between: StatePredictor[Given], start: TracedState[Given]) -> None:
        self.predictor = between
        self._links: deque[_Link] = deque()
        self._last_update = start.last_update
        self._last = Anchor(start.time_ns, GaussianEstimate(start.mean, start.covariance), start.prediction_input)
        self._requested_ns: deque[int] = deque()
        self._link_estimates: list[GaussianEstimate] = []

    @property
    def newest_ns(self) -> int | None:
        """Time of the last link, or of the start; None before the first measurement."""
        return self._last.time_ns

    def request_time(self, time_ns: int) -> None:
        """Request a time, later than the last link and than all times requested before."""
        self._requested_ns.append(time_ns)

    def add_state(self, state: TracedState[Given]) -> None:
        """Add the next state; a new update or a changed estimate makes a link, unless the state has no time."""
        came, before, now = state.last_update, self._last_update, GaussianEstimate(state.mean, state.covariance)
        self._last_update = came
        if state.time_ns is None:
            if not _is_equal(now, self._last.estimate):
                # The estimate changed before the first measurement, so earlier requests are dropped.
                self._requested_ns.clear()
                self._last = Anchor(None, now, state.prediction_input)
            return
        if came is not None and came is not before:
            self._add_link(state, came.predicted, came.estimate, came.is_update, came.jumped_ns)
        if not _is_equal(now, self._last.estimate):
            # Without a measurement or jump, the covariance was inflated or the filters restarted from a subfilter.
            self._add_link(state, now, now, _is_inflated(self._last.estimate, now))

    def take_smoothed(self, time_ns: int) -> list[tuple[list[int], GaussianEstimate]]:
        """Return the requested times up to ``time_ns`` with their smoothed estimates, and remove these requests.

        A time before the first link is omitted if no estimate exists.

        Returns:
            A list of pieces, each with N times in ascending order, mean (N, r) and covariance (N, r, r); see
            :class:`StatePredictor`.
        """
        taken = []
        while self._links:
            stretches = self._links[0].pieces
            while stretches and stretches[0].times_ns[0] <= time_ns:
                due, rest = _split_piece(stretches.popleft(), time_ns)
                taken.append((due.times_ns, self._smooth(due)))
                if rest is not None:
                    stretches.appendleft(rest)
            if stretches:
                return taken
            self._links.popleft()
            if self._link_estimates:
                self._link_estimates.pop()
        times_ns = self._take_requested(time_ns)
        if times_ns and self._last.time_ns is not None:
            taken.append((times_ns, self.predictor.estimates_at(self._last, times_ns, None)[0]))
        return taken

    def _add_link(
        self,
        state: TracedState[Given],
        predicted: GaussianEstimate,
        estimate: GaussianEstimate,
        leads_back: bool,
        jumped_ns: int | None = None,
    ) -> None:
        """Add a link with the requested times up to the link or, for a jump, up to the last sample before the jump."""
        assert state.time_ns is not None
        last, is_first = self._last, self._last.time_ns is None
        reached = Anchor(state.time_ns, estimate, state.prediction_input)
        back: SmootherStep | GaussianEstimate | None = None if is_first else last.estimate
        if leads_back and not is_first:
            back = smoother_step(last.estimate, self.predictor.cross_to(last, reached), predicted)
        link, times_ns = _Link(back), self._take_requested(max(state.time_ns, jumped_ns or 0))
        if is_first and not self.predictor.predicts_before_first:
            times_ns = []
        for start in range(0, len(times_ns), _MOST_AT_ONCE):
            some = times_ns[start : start + _MOST_AT_ONCE]
            found, cross = self.predictor.estimates_at(last, some, reached if leads_back else None)
            link.pieces.append(Piece(some, found if cross is None else smoother_step(found, cross, predicted)))
        self._links.append(link)
        self._last = reached
        self._link_estimates = []

    def _take_requested(self, time_ns: int) -> list[int]:
        """Remove and return the requested times up to ``time_ns`` that belong to no link yet."""
        times_ns = []
        while self._requested_ns and self._requested_ns[0] <= time_ns:
            times_ns.append(self._requested_ns.popleft())
        return times_ns

    def _smooth(self, stretch: Piece) -> GaussianEstimate:
        """Return the smoothed estimates at times before the first remaining link."""
        if isinstance(stretch.found, GaussianEstimate):
            return stretch.found
        if not self._link_estimates:
            known = self._last.estimate
            for link in reversed(self._links):
                self._link_estimates.append(known)
                if isinstance(link.back, SmootherStep):
                    known = link.back.apply(known)
                elif link.back is not None:
                    known = link.back
        return stretch.found.apply(self._link_estimates[-1])


def _split_piece(stretch: Piece, time_ns: int) -> tuple[Piece, Piece | None]:
    """Split a piece at a time; return the part up to that time and the rest, or None without a rest."""
    count = bisect.bisect_right(stretch.times_ns, time_ns)
    if count == len(stretch.times_ns):
        return stretch, None
    first, rest = (
        Piece(stretch.times_ns[some], type(stretch.found)(*(values[some] for values in stretch.found)))
        for some in (slice(count), slice(count, None))
    )
    return first, rest


def _is_equal(one: GaussianEstimate, other: GaussianEstimate) -> bool:
    return np.array_equal(one.mean, other.mean) and np.array_equal(one.covariance, other.covariance)


def _is_inflated(before: GaussianEstimate, after: GaussianEstimate) -> bool:
    """True if ``after`` is ``before`` with an inflated covariance."""
    if not np.array_equal(before.mean, after.mean):
        return False
    sigma = np.sqrt(after.covariance.diagonal())
    scale = np.where(sigma > 0.0, sigma, 1.0)
    added = (after.covariance - before.covariance) / (scale[:, None] * scale)
    # The result for NaN is False.
    return bool(np.linalg.eigvalsh(added)[0] >= -_ROUNDING)
