"""Gauss-Markov error process of the INS attitude with the deflection of the vertical as a state.

The INS is levelled by gravity, stars refer to the ellipsoid. The attitude error relative to the geodetic horizon is
u = a + G d. Here a is the correlated error of the INS, which decays with time, d = (xi, eta) the deflection, which
changes with the distance over ground, and G the rotation by it (:attr:`LocalVertical.deflection_jacobian`). The state
``ins.attitude`` holds u, the state ``gravity.deflection`` holds d.

Over the time t and the distance s, with the known deflection before (g) and after (g'):

    a' = exp(-t / T) a + noise        d' = g' + exp(-s / L) (d - g) + noise        u' = a' + G d'

The noise of d keeps the covariance of its error at :attr:`LocalVertical.covariance` (docs/explanation/vertical.md).
"""

from collections.abc import Sequence

import numpy as np

from ship_attitude_star.ins_errors.process import DEFLECTION, WHOLE, Propagation, Vertical, deflection_change
from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_estimation.kalman import StateBlock, lasting
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

_SIZE = 5


class InsOnGravity:
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

    def initial_state(self, here: VerticalHere) -> tuple[FloatArray, FloatArray]:
        """See :class:`InsProcess`."""
        given = np.zeros(2) if here.given is None else here.given
        moved_by = _moved_by_deflection(here)
        return moved_by @ given, moved_by @ here.covariance @ moved_by.T

    def propagation(
        self, since_ns: int, before: VerticalHere, times_ns: Sequence[int], vertical: Vertical
    ) -> Propagation:
        """See :class:`InsProcess`."""
        # Times within one interval of the vertical share its object.
        kinds, of = _kinds([vertical.at(time_ns) for time_ns in times_ns])
        along = [self._along(before, here) for here in kinds]
        turn, left, shift, fresh = (np.array(column)[of] for column in zip(*along, strict=True))
        dt_s = np.array([(time_ns - since_ns) / SECOND_NS for time_ns in times_ns])
        decay = np.exp(-dt_s[:, None] / self._time_s)
        transition = np.zeros((len(of), _SIZE, _SIZE))
        transition[:, range(3), range(3)] = decay
        transition[:, WHOLE, DEFLECTION] = turn * left[:, None, None] - decay[:, :, None] * turn
        transition[:, (3, 4), (3, 4)] = left[:, None]
        ins_noise = np.zeros((len(of), _SIZE, _SIZE))
        ins_noise[:, range(3), range(3)] = self._sigma**2 * (1.0 - decay * decay)
        return Propagation(transition, shift, ins_noise, fresh)

    def propagated_means(self, means: FloatArray, before: VerticalHere, propagation: Propagation) -> FloatArray:
        """See :class:`InsProcess`."""
        after: FloatArray = means @ np.swapaxes(propagation.transition, -1, -2) + propagation.shift[:, None]
        own = means[:, WHOLE] - means[:, DEFLECTION] @ before.turn.T
        stays = lasting(own, self._sigma)
        after[..., WHOLE] = np.where(stays, means[:, WHOLE], after[..., WHOLE])
        return after

    def _along(self, before: VerticalHere, here: VerticalHere) -> tuple[FloatArray, float, FloatArray, FloatArray]:
        """Return the deflection Jacobian, remaining ratio, shift of the states, and covariance added to them."""
        change, moved_by = deflection_change(before, here, self._length_m), _moved_by_deflection(here)
        return here.turn, change.left, moved_by @ change.shift, moved_by @ change.noise @ moved_by.T


def _moved_by_deflection(here: VerticalHere) -> FloatArray:
    """Return the derivative of the states by the deflection, shape (5, 2)."""
    return np.vstack([here.turn, np.eye(2)])


def _kinds(verticals: list[VerticalHere]) -> tuple[list[VerticalHere], list[int]]:
    """Return the distinct objects among successive verticals, and the index of each into them."""
    kinds, of = [verticals[0]], []
    for here in verticals:
        if here is not kinds[-1]:
            kinds.append(here)
        of.append(len(kinds) - 1)
    return kinds, of
