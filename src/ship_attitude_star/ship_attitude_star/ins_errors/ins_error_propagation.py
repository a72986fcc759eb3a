"""INS errors at times after a filter state, propagated by an error process."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ins_errors.process import DEFLECTION, InsProcess, own_error_matrix
from ship_attitude_star.vertical.vertical_track import LocalVertical, VerticalTrack
from ship_geometry.rotations import FloatArray

_CLOCK = 3
"""Index of the INS time offset among the states that correct the INS; all other states belong to the INS process."""

_DEFLECTION = slice(4, 6)
"""Slice of the deflection of the vertical, if modelled, among the states that correct the INS."""


class PropagatedInsErrors(NamedTuple):
    """INS errors at N times, relative to the published horizon.

    Attributes:
        error_n: attitude error (north, up, east), rad, shape (N, 3).
        covariance_by_source: covariance of attitude error and time offset by error source, shape (N, n_sources, 4, 4).
        deflection: deflection (xi, eta), rad, shape (N, 2); (N, 0) if it is not modelled.
        deflection_covariance: covariance of the deflection, rad², shape (N, 2, 2), or (N, 0, 0).
        vertical_known: True if the deflection is modelled, and is known or estimated to half its prior standard
            deviation or better, shape (N,).
    """

    error_n: FloatArray
    covariance_by_source: FloatArray
    deflection: FloatArray
    deflection_covariance: FloatArray
    vertical_known: NDArray[np.bool_]


class InsErrorPropagation:
    """Propagation of the states that correct the INS: attitude error, time offset and other states of the INS process.

    Args:
        process: error process of the INS.
        vertical: vertical along the track.
        sources: indices of the error sources of the INS and of the deflection; equal if no deflection is modelled.
        models_deflection: True if the process contains the deflection.
        to_gravity: True if the attitude is published relative to the gravity horizon.
    """

    def __init__(
        self,
        process: InsProcess,
        vertical: VerticalTrack,
        sources: tuple[int, int],
        models_deflection: bool,
        to_gravity: bool,
    ) -> None:
        self._process, self._vertical, self._to_gravity = process, vertical, to_gravity
        self._ins, self._deflection = sources
        self._models_deflection, self._unknown_variance = models_deflection, vertical.unknown_variance
        self._of_process = np.delete(np.arange(process.size + 1), _CLOCK)

    def errors(
        self,
        since_ns: int | None,
        before: LocalVertical | None,
        mean: FloatArray,
        covariance_by_source: FloatArray,
        times_ns: Sequence[int],
    ) -> PropagatedInsErrors:
        """Return the INS errors at N times.

        Args:
            since_ns: time of the state; None before the first measurement.
            before: vertical at the time of the state; None before the first measurement.
            mean: mean of the n states that correct the INS, shape (n,).
            covariance_by_source: covariance of these states by error source, shape (n_sources, n, n).
            times_ns: N times, none before the time of the state, in ascending order.
        """
        verticals = [self._vertical.at(time_ns) for time_ns in times_ns]
        count, size = len(times_ns), len(mean)
        of_process = np.tile(mean[self._of_process], (count, 1))
        transition, noise = (
            np.tile(np.eye(size), (count, 1, 1)),
            np.zeros((count, len(covariance_by_source), size, size)),
        )
        rows, columns = np.ix_(self._of_process, self._of_process)
        if since_ns is None or before is None:
            # Before the first measurement, each time has the initial state.
            initial = [self._process.initial_state(here) for here in verticals]
            of_process += [shift for shift, _ in initial]
            noise[:, self._deflection, rows, columns] = [covariance for _, covariance in initial]
        else:
            propagation = self._process.propagation(since_ns, before, times_ns, self._vertical)
            of_process = self._process.propagated_means(mean[None, self._of_process], before, propagation)[:, 0]
            transition[:, rows, columns] = propagation.transition
            noise[:, self._ins, rows, columns] += propagation.ins_noise
            noise[:, self._deflection, rows, columns] += propagation.deflection_noise
        after = transition[:, None] @ covariance_by_source @ np.swapaxes(transition, -1, -2)[:, None] + noise
        to_output, of_deflection = self._output_matrix(verticals), after[:, :, _DEFLECTION, _DEFLECTION].sum(axis=1)
        to_four = np.zeros((count, 4, size))
        to_four[:, :3, self._of_process], to_four[:, 3, _CLOCK] = to_output, 1.0
        return PropagatedInsErrors(
            error_n=(to_output @ of_process[:, :, None])[..., 0],
            covariance_by_source=np.ascontiguousarray(to_four[:, None] @ after @ np.swapaxes(to_four, -1, -2)[:, None]),
            deflection=of_process[:, DEFLECTION] if self._models_deflection else np.empty((count, 0)),
            deflection_covariance=of_deflection if self._models_deflection else np.empty((count, 0, 0)),
            vertical_known=self._is_vertical_known(of_deflection, verticals),
        )

    def _is_vertical_known(self, covariance: FloatArray, verticals: Sequence[LocalVertical]) -> NDArray[np.bool_]:
        """Return :attr:`PropagatedInsErrors.vertical_known`, shape (N,)."""
        if not self._models_deflection:
            return np.zeros(len(verticals), dtype=bool)
        # A NaN covariance compares as false: the deflection then counts as not estimated.
        known: NDArray[np.bool_] = np.array([here.given_deflection is not None for here in verticals])
        known |= 4.0 * np.trace(covariance, axis1=1, axis2=2) <= 2.0 * self._unknown_variance
        return known

    def _output_matrix(self, verticals: Sequence[LocalVertical]) -> FloatArray:
        """Return the matrix from process states to the error relative to the published horizon, shape (N, 3, n)."""
        size = self._process.size
        if not self._to_gravity:
            return np.tile(np.eye(3, size), (len(verticals), 1, 1))
        return np.array([np.pad(own_error_matrix(here), ((0, 0), (0, size - 5))) for here in verticals])
