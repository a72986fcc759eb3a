"""Gauss-Markov error process of the INS attitude with the deflection of the vertical as a state.

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

import numpy as np

from ship_attitude_star.ins_errors.process import ATTITUDE_ERROR, DEFLECTION, Propagation, Vertical, deflection_change
from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_estimation.kalman.kalman_filter import StateBlock, exceeds_model
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray

_SIZE = 5


class GaussMarkovIns:
    """Process of the states ``ins.attitude`` and ``gravity.deflection``.

    Args:
        slow: correlated error of the INS: standard deviation and correlation time about (North, Up, East).
        length_m: correlation length of the deflection over ground, m.
    """

    blocks: tuple[str, ...] = ("ins.attitude", "gravity.deflection")
    size = _SIZE
    needs_latitude = False

    def __init__(self, slow: StateBlock, length_m: float) -> None:
        self._time_s, self._sigma, self._length_m = slow.time_s, slow.sigma, length_m

    def initial_state(self, here: LocalVertical) -> tuple[FloatArray, FloatArray]:
        """See :class:`InsProcess`."""
        given = np.zeros(2) if here.given_deflection is None else here.given_deflection
        by_deflection = _states_by_deflection(here)
        return by_deflection @ given, by_deflection @ here.covariance @ by_deflection.T

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
        transition = np.zeros((len(index_of), _SIZE, _SIZE))
        transition[:, range(3), range(3)] = decay
        transition[:, ATTITUDE_ERROR, DEFLECTION] = turn * left[:, None, None] - decay[:, :, None] * turn
        transition[:, (3, 4), (3, 4)] = left[:, None]
        ins_noise = np.zeros((len(index_of), _SIZE, _SIZE))
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
