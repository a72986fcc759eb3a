"""Axis states at times between two sightings, and their covariance with the states at the next sighting.

Between two sightings the states are predicted as in :class:`CalibrationFilter`. The messages state a covariance of the
ship's error at each time. If this covariance differs much from the covariance stated at the previous sighting, part of
the old error is removed and a new error is added (:func:`ship_error_steps`). A new error may thus arise at the
requested time, and another one at the next sighting. The cross-covariance of these two errors is the largest covariance
contained in the covariances of both, reduced by the decay between the two times.
"""

from collections.abc import Callable, Sequence

import numpy as np

from ship_estimation.kalman.rts_smoother import Anchor, GaussianEstimate
from ship_geometry.mount.axes import SHIP
from ship_geometry.rotations import FloatArray
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.model import ShipErrorStep, axis_state_indices, ship_error_steps
from theodolite_calib.samples.samples import StampArray

AxisAnchor = Anchor[FloatArray | None]
"""Estimate after an update, with the stated covariance of the ship's error from then on, rad², shape (3, 3)."""


class AxisStatePredictor:
    """Predictor of the states that turn the main axis, and of the parallelism of the calibration telescope.

    Args:
        filter_: filter with its model.
        stated_n: returns the stated covariance of the ship's error at N times, rad², shape (N, 3, 3), or None if the
            messages state no covariance.

    Attributes:
        state_indices: indices of the r predicted states, shape (r,).
    """

    predicts_before_first = True
    """True: before the first sighting all errors have their prior at any time."""

    def __init__(
        self, filter_: CalibrationFilter, stated_n: Callable[[Sequence[int]], FloatArray | None]
    ) -> None:
        self._model, self._ship, self._stated_n = filter_.model, filter_.ship_error, stated_n
        self.state_indices = np.concatenate([axis_state_indices(self._model), self._model.state_indices("parallelism")])
        # The ship's error comes first, both among all states and among the predicted states.
        assert self._ship.columns == SHIP

    def cross_to(self, anchor: AxisAnchor, later: AxisAnchor) -> FloatArray:
        """See :meth:`ship_estimation.kalman.rts_smoother.StatePredictor.cross_to`."""
        assert anchor.time_ns is not None
        assert later.time_ns is not None
        decay, _ = self._model.transition(max(later.time_ns - anchor.time_ns, 0) * 1e-9)
        cross: FloatArray = anchor.estimate.covariance * (decay * self._retained_until(anchor, later))
        return cross

    def estimates_at(
        self, anchor: AxisAnchor, times_ns: Sequence[int], later: AxisAnchor | None
    ) -> tuple[GaussianEstimate, FloatArray | None]:
        """Return the states in :attr:`state_indices`; see ``ship_estimation.kalman.rts_smoother.StatePredictor``."""
        moments_ns, step = np.array(times_ns), self._step_at(anchor, times_ns)
        wide = self._cross_covariance(anchor, moments_ns)
        known = _apply_step(GaussianEstimate(self._means(anchor, moments_ns), wide[:, :, self.state_indices]), step)
        if later is None:
            return known, None
        assert later.time_ns is not None
        # A time before a jump may be later than the estimate whose covariance the jump inflates.
        together_ns = np.minimum(moments_ns, later.time_ns)
        if np.any(together_ns < moments_ns):
            wide = (
                self._cross_covariance(anchor, together_ns)
                * self._decay(moments_ns - together_ns)[:, self.state_indices, None]
            )
        onward = self._decay(later.time_ns - together_ns)
        cross = wide * (onward * self._retained_until(anchor, later))[:, None, :]
        if step is not None:
            cross[:, SHIP] *= step.retained[:, :, None]
            then = self._step_to(anchor, later)
            if then is not None:
                shared_n = np.array([_common_covariance(new_n, then.added_n[0]) for new_n in step.added_n])
                cross[:, SHIP, SHIP] += shared_n * onward[:, None, SHIP]
        return known, cross

    def _means(self, anchor: AxisAnchor, times_ns: StampArray) -> FloatArray:
        """Return the expected states at N times, before any step of the ship's error, shape (N, r)."""
        mean, decay = anchor.estimate.mean, self._decay(_since_ns(anchor, times_ns))
        means: FloatArray = (decay * mean)[:, self.state_indices]
        means[:, SHIP] = self._ship.propagate(mean[SHIP], decay[:, SHIP])
        return means

    def _cross_covariance(self, anchor: AxisAnchor, times_ns: StampArray) -> FloatArray:
        """Return the covariance of the predicted states with all states at N times, before any step, (N, r, n)."""
        since_s = _since_ns(anchor, times_ns).astype(float) * 1e-9
        decay, noise = self._model.transition(since_s)
        wide: FloatArray = (
            decay[:, self.state_indices, None] * anchor.estimate.covariance[self.state_indices] * decay[:, None, :]
        )
        wide[:, np.arange(len(self.state_indices)), self.state_indices] += noise[:, self.state_indices]
        if anchor.prediction_input is not None:
            wide[:, SHIP, SHIP] += (1.0 - decay[:, 0] ** 2)[:, None, None] * anchor.prediction_input
        return wide

    def _decay(self, some_ns: StampArray) -> FloatArray:
        """Return the decay factors of all states over N times, ns, shape (N, n)."""
        return self._model.transition(some_ns.astype(float) * 1e-9)[0]

    def _step_at(self, anchor: AxisAnchor, times_ns: Sequence[int]) -> ShipErrorStep | None:
        """Return the step of the ship's error at N times."""
        stated_n = self._stated_n(times_ns)
        return None if stated_n is None else ship_error_steps(anchor.prediction_input, stated_n)

    def _step_to(self, anchor: AxisAnchor, later: AxisAnchor) -> ShipErrorStep | None:
        """Return the step of the ship's error at the next sighting, with arrays for one time (N = 1)."""
        return (
            None
            if later.prediction_input is None
            else ship_error_steps(anchor.prediction_input, later.prediction_input[None])
        )

    def _retained_until(self, anchor: AxisAnchor, later: AxisAnchor) -> FloatArray:
        """Return the ratio of each state that the step at the next sighting retains, shape (n,)."""
        kept, step = np.ones(self._model.size), self._step_to(anchor, later)
        if step is not None:
            kept[SHIP] = step.retained[0]
        return kept


def _since_ns(anchor: AxisAnchor, times_ns: StampArray) -> StampArray:
    """Return the time since the anchor, ns; zero before the first sighting, when the errors have their prior."""
    if anchor.time_ns is None:
        return np.zeros_like(times_ns)
    since_ns: StampArray = np.maximum(times_ns - anchor.time_ns, 0)
    return since_ns


def _apply_step(known: GaussianEstimate, step: ShipErrorStep | None) -> GaussianEstimate:
    """Apply the steps of the ship's error at N times; the argument is changed."""
    if step is not None:
        known.mean[:, SHIP] *= step.retained
        known.covariance[:, SHIP] *= step.retained[:, :, None]
        known.covariance[:, :, SHIP] *= step.retained[:, None, :]
        known.covariance[:, SHIP, SHIP] += step.added_n
    return known


def _common_covariance(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the largest covariance within two covariances, along axes that diagonalise both, shape (3, 3).

    Example:
        >>> print(_common_covariance(np.diag([4.0, 1.0, 0.0]), np.diag([1.0, 9.0, 5.0])).round(12))
        [[1. 0. 0.]
         [0. 1. 0.]
         [0. 0. 0.]]
    """
    values, vectors = np.linalg.eigh(one + other)
    positive = values > 3.0 * np.finfo(float).eps * values[-1]
    root = vectors[:, positive] * np.sqrt(values[positive])
    to_unit = vectors[:, positive] / np.sqrt(values[positive])
    # In units of the sum, the two covariances have common axes, and their variances along each axis add up to one.
    shares, axes = np.linalg.eigh(to_unit.T @ one @ to_unit)
    along = root @ axes
    smaller: FloatArray = (along * np.clip(np.minimum(shares, 1.0 - shares), 0.0, None)) @ along.T
    return smaller
