"""Prediction of the INS errors at times after an estimate, with their cross-covariance to the next estimate."""

from collections.abc import Sequence

import numpy as np

from ship_attitude_star.ins_errors.process import Propagation, own_error_matrix
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.kalman.kalman_filter import propagate_correlated_error
from ship_estimation.kalman.rts_smoother import Anchor, GaussianEstimate
from ship_geometry.rotations import FloatArray

_TIME_OFFSET = 3
"""Index of the INS time offset among the output quantities; the three components of the attitude error come first."""


ShipAnchor = Anchor[LocalVertical | None]
"""Estimate with the vertical at its time; the vertical is None if the filter does not need it."""


class InsErrorPredictor:
    """Prediction of the quantities that correct the INS: attitude error (north, up, east) and time offset.

    Args:
        filter_: filter and model.
        to_gravity: True if the attitude is published relative to the gravity horizon.
    """

    def __init__(self, filter_: ShipFilter, to_gravity: bool) -> None:
        self._model, self._vertical, self._to_gravity = filter_.model, filter_.vertical, to_gravity
        attitude, rest = np.split(self._model.process_indices, [3])
        self._rows = np.concatenate([attitude, self._model.state_indices("ins.time_offset"), rest])

    @property
    def predicts_before_first(self) -> bool:
        """True if the errors can be predicted before the first measurement, as Gauss-Markov processes can."""
        return self._model.ins_process is None

    def cross_to(self, anchor: ShipAnchor, later: ShipAnchor) -> FloatArray:
        """See :meth:`ship_estimation.kalman.rts_smoother.StatePredictor.cross_to`."""
        assert later.time_ns is not None
        transition, _, _ = self._transition_to(anchor, [later.time_ns])
        cross: FloatArray = anchor.estimate.covariance @ transition[0].T
        return cross

    def estimates_at(
        self, anchor: ShipAnchor, times_ns: Sequence[int], later: ShipAnchor | None
    ) -> tuple[GaussianEstimate, FloatArray | None]:
        """Return the four quantities that correct the INS.

        See :class:`ship_estimation.kalman.rts_smoother.StatePredictor`.

        For a jump, the covariance is inflated earlier than the jump by the bound of the clock offsets. Times between
        inflation and jump are treated as the time of the inflation.
        """
        if later is not None:
            assert later.time_ns is not None
            times_ns = [min(time_ns, later.time_ns) for time_ns in times_ns]
        mean, covariance = anchor.estimate
        if anchor.time_ns is None:
            # Before the first measurement Gauss-Markov errors are stationary.
            means, covariances = np.tile(mean, (len(times_ns), 1)), np.tile(covariance, (len(times_ns), 1, 1))
        else:
            transition, means, noise = self._transition_to(anchor, times_ns)
            covariances = transition @ covariance @ np.swapaxes(transition, -1, -2) + noise
        to_output = self._output_matrix(times_ns)
        output_covariance = to_output @ covariances
        output_means = (to_output @ means[..., None])[..., 0]
        known = GaussianEstimate(output_means, output_covariance @ np.swapaxes(to_output, -1, -2))
        if later is None:
            return known, None
        assert later.time_ns is not None
        onward = self._transition_from(anchor, times_ns, later.time_ns)
        return known, output_covariance @ np.swapaxes(onward, -1, -2)

    def _transition_to(self, anchor: ShipAnchor, times_ns: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the propagation of the n states from an anchor to N times.

        Returns:
            Transition matrices (N, n, n), propagated means (N, n), and added covariance (N, n, n).
        """
        assert anchor.time_ns is not None
        model, mean = self._model, anchor.estimate.mean
        dt_s = 1e-9 * (np.array(times_ns) - anchor.time_ns).astype(float)
        decay, variance = model.transition(dt_s)
        transition, noise, means = _diagonal(decay), _diagonal(variance), decay * mean
        propagation = self._process_propagation(anchor, times_ns)
        if propagation is None:
            ins_attitude = model.slices["ins.attitude"]
            means[:, ins_attitude] = propagate_correlated_error(
                mean[ins_attitude], decay[:, ins_attitude], model.ins_attitude_block.sigma
            )
            return transition, means, noise
        assert model.ins_process is not None
        assert anchor.prediction_input is not None
        block = np.s_[:, model.process_indices[:, None], model.process_indices]
        transition[block] = propagation.transition
        noise[block] += propagation.ins_noise + propagation.deflection_noise
        of_process = model.ins_process.propagated_means(
            mean[None, model.process_indices], anchor.prediction_input, propagation
        )
        means[:, model.process_indices] = of_process[:, 0]
        return transition, means, noise

    def _transition_from(self, anchor: ShipAnchor, times_ns: Sequence[int], later_ns: int) -> FloatArray:
        """Return the transition matrices from N times after an anchor to a later time, shape (N, n, n)."""
        model = self._model
        left_s = 1e-9 * (later_ns - np.array(times_ns)).astype(float)
        onward = _diagonal(model.transition(left_s)[0])
        propagation = self._process_propagation(anchor, [*times_ns, later_ns])
        if propagation is not None:
            # The transition to the later time is the transition to each time, followed by the returned transition.
            to_each, to_later = propagation.transition[:-1], propagation.transition[-1]
            left = np.linalg.solve(np.swapaxes(to_each, -1, -2), np.broadcast_to(to_later.T, to_each.shape))
            onward[:, model.process_indices[:, None], model.process_indices] = np.swapaxes(left, -1, -2)
        return onward

    def _process_propagation(self, anchor: ShipAnchor, times_ns: Sequence[int]) -> Propagation | None:
        """Return the propagation of the INS error process; None if the model has no such process."""
        process = self._model.ins_process
        if process is None:
            return None
        assert anchor.time_ns is not None
        assert anchor.prediction_input is not None
        assert self._vertical is not None
        return process.propagation(anchor.time_ns, anchor.prediction_input, times_ns, self._vertical)

    def _output_matrix(self, times_ns: Sequence[int]) -> FloatArray:
        """Return the matrices from the states to the output quantities, shape (N, 4, n)."""
        matrix = np.zeros((len(times_ns), _TIME_OFFSET + 1, self._model.size))
        matrix[:, np.arange(_TIME_OFFSET + 1), self._rows[: _TIME_OFFSET + 1]] = 1.0
        if self._to_gravity:
            assert self._vertical is not None
            own = [own_error_matrix(self._vertical.at(time_ns)) for time_ns in times_ns]
            matrix[:, :_TIME_OFFSET, self._model.process_indices[:5]] = own
        return matrix


def _diagonal(values: FloatArray) -> FloatArray:
    """Return diagonal matrices, shape (N, n, n), with given diagonals, shape (N, n)."""
    matrices: FloatArray = values[..., None] * np.eye(values.shape[-1])
    return matrices
