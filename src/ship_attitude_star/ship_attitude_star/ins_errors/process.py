"""Error process of the INS: interface, Gauss-Markov process, and propagation of the errors to later times.

The INS is levelled by gravity, and stars refer to the ellipsoid. The attitude error relative to the geodetic horizon is
u = a + G d. The correlated error a of the INS decays with time. The deflection d = (xi, eta) changes with the distance
over ground. G is the Jacobian of the horizon's rotation with respect to d (:attr:`LocalVertical.deflection_jacobian`).
The state ``ins.attitude`` is u, the state ``gravity.deflection`` is d.

The time is t, the distance s, the correlation time T, the correlation length L, and the known deflection is g before
and g' after. If g alone is unknown, g = g'; if g' is unknown, both are zero:

    a' = exp(-t / T) a + noise        d' = g' + exp(-s / L) (d - g) + noise        u' = a' + G d'

The noise of d keeps the covariance of d - g at :attr:`LocalVertical.covariance` (docs/explanation/vertical.md).
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.vertical.vertical_track import LocalVertical, VerticalTrack
from ship_estimation.kalman.kalman_filter import StateBlock, exceeds_model
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray

ATTITUDE_ERROR = slice(0, 3)
"""Slice of the INS attitude error (north, up, east) relative to the geodetic horizon: the first states of a process."""

DEFLECTION = slice(3, 5)
"""Slice of the deflection of the vertical (xi, eta), in processes that contain it."""

_CLOCK = 3
"""Index of the INS time offset among the states that correct the INS; all other states belong to the INS process."""

_DEFLECTION = slice(4, 6)
"""Slice of the deflection of the vertical, if modelled, among the states that correct the INS."""


class Propagation(NamedTuple):
    """Propagation of the n states of a process to N times; each shape is preceded by N.

    Attributes:
        transition: transition matrix of the states, shape (n, n).
        shift: shift added to the states, shape (n,).
        ins_noise: covariance added due to INS errors, shape (n, n).
        deflection_noise: covariance added due to the deflection, shape (n, n).
    """

    transition: FloatArray
    shift: FloatArray
    ins_noise: FloatArray
    deflection_noise: FloatArray


class Vertical(Protocol):
    """Source of the vertical at any time."""

    def at(self, time_ns: int) -> LocalVertical:
        """Return the vertical at a time: one object per two seconds, until an input changes the vertical."""


class InsProcess(Protocol):
    """An error process of the INS.

    Attributes:
        blocks: names of the state blocks, in order; ``ins.attitude`` is the first.
        size: number of states.
        needs_latitude: True if the process is not valid before the first position fix.
    """

    blocks: tuple[str, ...]
    size: int
    needs_latitude: bool

    def initial_state(self, here: LocalVertical) -> tuple[FloatArray, FloatArray]:
        """Return mean, shape (n,), and covariance, shape (n, n), of the initial states due to the deflection alone."""

    def propagation(
        self, since_ns: int, before: LocalVertical, times_ns: Sequence[int], vertical: Vertical
    ) -> Propagation:
        """Return the propagation of the states.

        Args:
            since_ns: start time.
            before: vertical at the start time.
            times_ns: N times, none before the start, in ascending order.
            vertical: source of the vertical along the track.
        """

    def propagated_means(self, means: FloatArray, before: LocalVertical, propagation: Propagation) -> FloatArray:
        """Return the propagated states of h filters, shape (h, n), at N times, shape (N, h, n).

        An attitude error far beyond its standard deviation, as after a jump, does not decay
        (:func:`ship_estimation.kalman.kalman_filter.exceeds_model`).
        """


class DeflectionChange(NamedTuple):
    """Change of the deflection d over a distance: remaining_ratio * d + shift, with added noise.

    Attributes:
        remaining_ratio: ratio of the earlier deflection that remains.
        shift: shift, rad, shape (2,).
        noise: covariance of the added error, rad², shape (2, 2).
    """

    remaining_ratio: float
    shift: FloatArray
    noise: FloatArray


def deflection_change(before: LocalVertical, here: LocalVertical, length_m: float) -> DeflectionChange:
    """Return the change of the deflection between two positions, for a correlation length ``length_m``."""
    remaining_ratio = float(np.exp(-max(here.distance_run_m - before.distance_run_m, 0.0) / length_m))
    shift = np.zeros(2)
    if here.given_deflection is not None:
        # A deflection known for the first time has no immediate effect: the estimate approaches it over distance.
        earlier = here.given_deflection if before.given_deflection is None else before.given_deflection
        shift = here.given_deflection - remaining_ratio * earlier
    return DeflectionChange(remaining_ratio, shift, (1.0 - remaining_ratio * remaining_ratio) * here.covariance)


def own_error_matrix(here: LocalVertical) -> FloatArray:
    """Return the matrix from attitude error and deflection to the INS error relative to the gravity horizon, (3, 5)."""
    return np.hstack([np.eye(3), -here.deflection_jacobian])


class GaussMarkovIns:
    """Process of the states ``ins.attitude`` and ``gravity.deflection``.

    Args:
        slow: correlated error of the INS: standard deviation and correlation time about (North, Up, East).
        length_m: correlation length of the deflection over ground, m.
    """

    blocks: tuple[str, ...] = ("ins.attitude", "gravity.deflection")
    size = 5
    needs_latitude = False

    def __init__(self, slow: StateBlock, length_m: float) -> None:
        self._time_s, self._sigma, self._length_m = slow.time_s, slow.sigma, length_m

    def initial_state(self, here: LocalVertical) -> tuple[FloatArray, FloatArray]:
        """See :class:`InsProcess`."""
        return initial_deflection(here)

    def propagation(
        self, since_ns: int, before: LocalVertical, times_ns: Sequence[int], vertical: Vertical
    ) -> Propagation:
        """See :class:`InsProcess`."""
        # Times within one interval of the vertical share one vertical object.
        distinct, index_of = _distinct_verticals([vertical.at(time_ns) for time_ns in times_ns])
        terms = [self._propagation_terms(before, here) for here in distinct]
        turn, left, shift, fresh = (np.array(column)[index_of] for column in zip(*terms, strict=True))
        dt_s = np.array([(time_ns - since_ns) / SECOND_NS for time_ns in times_ns])
        decay = np.exp(-dt_s[:, None] / self._time_s)
        transition = np.zeros((len(index_of), self.size, self.size))
        transition[:, range(3), range(3)] = decay
        transition[:, ATTITUDE_ERROR, DEFLECTION] = turn * left[:, None, None] - decay[:, :, None] * turn
        transition[:, (3, 4), (3, 4)] = left[:, None]
        ins_noise = np.zeros((len(index_of), self.size, self.size))
        ins_noise[:, range(3), range(3)] = self._sigma**2 * (1.0 - decay * decay)
        return Propagation(transition, shift, ins_noise, fresh)

    def propagated_means(self, means: FloatArray, before: LocalVertical, propagation: Propagation) -> FloatArray:
        """See :class:`InsProcess`."""
        after: FloatArray = means @ np.swapaxes(propagation.transition, -1, -2) + propagation.shift[:, None]
        own = means[:, ATTITUDE_ERROR] - means[:, DEFLECTION] @ before.deflection_jacobian.T
        exceeds = exceeds_model(own, self._sigma)
        after[..., ATTITUDE_ERROR] = np.where(exceeds, means[:, ATTITUDE_ERROR], after[..., ATTITUDE_ERROR])
        return after

    def _propagation_terms(
        self, before: LocalVertical, here: LocalVertical
    ) -> tuple[FloatArray, float, FloatArray, FloatArray]:
        """Return deflection Jacobian, remaining ratio, shift of the states, and covariance added to the states."""
        change, by_deflection = deflection_change(before, here, self._length_m), _states_by_deflection(here)
        return (
            here.deflection_jacobian,
            change.remaining_ratio,
            by_deflection @ change.shift,
            by_deflection @ change.noise @ by_deflection.T,
        )


def initial_deflection(here: LocalVertical) -> tuple[FloatArray, FloatArray]:
    """Return mean, shape (5,), and covariance, shape (5, 5), of attitude error and deflection by the deflection."""
    given = np.zeros(2) if here.given_deflection is None else here.given_deflection
    by_deflection = _states_by_deflection(here)
    return by_deflection @ given, by_deflection @ here.covariance @ by_deflection.T


def _states_by_deflection(here: LocalVertical) -> FloatArray:
    """Return the derivative of the states with respect to the deflection, shape (5, 2)."""
    return np.vstack([here.deflection_jacobian, np.eye(2)])


def _distinct_verticals(verticals: list[LocalVertical]) -> tuple[list[LocalVertical], list[int]]:
    """Return the distinct objects among successive verticals, and the index of each vertical's object."""
    distinct, index_of = [verticals[0]], []
    for here in verticals:
        if here is not distinct[-1]:
            distinct.append(here)
        index_of.append(len(distinct) - 1)
    return distinct, index_of


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
        transition = np.tile(np.eye(size), (count, 1, 1))
        noise = np.zeros((count, len(covariance_by_source), size, size))
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
