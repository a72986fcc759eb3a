"""How the INS's attitude error goes on where the deflection of the vertical is a state of its own.

The INS levels itself on gravity, stars know the ellipsoid. The whole error of its attitude against the geodetic horizon
is u = a + G d, with a its own slow error, which dies out with time, d = (xi, eta) the deflection, which changes with
the way over ground, and G the turn by it (:attr:`VerticalHere.turn`). The state ``ins.attitude`` holds u, so that
everything that asks how wrong the INS is finds the answer there, and ``gravity.deflection`` holds d.

Over the time t and the way s, with what is given of the deflection before (g) and after (g'):

    a' = exp(-t / T) a + noise        d' = g' + exp(-s / L) (d - g) + noise        u' = a' + G d'

The noise of d is such that its error keeps the covariance that :attr:`VerticalHere.covariance` tells (docs/explanation/
vertical.md).
"""

from collections.abc import Sequence

import numpy as np

from ship_attitude_star.ins_errors.process import DEFLECTION, WHOLE, Carried, Vertical, deflection_change
from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_estimation.kalman import StateBlock, lasting
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS

_SIZE = 5


class InsOnGravity:
    """The process of the states ``ins.attitude`` and ``gravity.deflection``.

    Args:
        slow: the INS's own slow error: its sigma and correlation time about (North, Up, East).
        length_m: correlation length of the deflection over ground.
    """

    blocks: tuple[str, ...] = ("ins.attitude", "gravity.deflection")
    size = _SIZE
    needs_latitude = False

    def __init__(self, slow: StateBlock, length_m: float) -> None:
        self._time_s, self._sigma, self._length_m = slow.time_s, slow.sigma, length_m

    def begun(self, here: VerticalHere) -> tuple[FloatArray, FloatArray]:
        """See :class:`InsProcess`."""
        given = np.zeros(2) if here.given is None else here.given
        moved_by = _moved_by_deflection(here)
        return moved_by @ given, moved_by @ here.covariance @ moved_by.T

    def carried(
        self, since_ns: int, before: VerticalHere, times_ns: Sequence[int], vertical: Vertical
    ) -> Carried:
        """See :class:`InsProcess`."""
        # Moments within an even second share one vertical.
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
        return Carried(transition, shift, ins_noise, fresh)

    def means(self, means: FloatArray, before: VerticalHere, carried: Carried) -> FloatArray:
        """See :class:`InsProcess`."""
        after: FloatArray = means @ np.swapaxes(carried.transition, -1, -2) + carried.shift[:, None]
        own = means[:, WHOLE] - means[:, DEFLECTION] @ before.turn.T
        stays = lasting(own, self._sigma)
        after[..., WHOLE] = np.where(stays, means[:, WHOLE], after[..., WHOLE])
        return after

    def _along(self, before: VerticalHere, here: VerticalHere) -> tuple[FloatArray, float, FloatArray, FloatArray]:
        """Turn, what is left of the deflection, what is added to the states, and the covariance of what comes new."""
        change, moved_by = deflection_change(before, here, self._length_m), _moved_by_deflection(here)
        return here.turn, change.left, moved_by @ change.moved, moved_by @ change.fresh @ moved_by.T


def _moved_by_deflection(here: VerticalHere) -> FloatArray:
    """How the states follow a change of the deflection, shape (5, 2)."""
    return np.vstack([here.turn, np.eye(2)])


def _kinds(verticals: list[VerticalHere]) -> tuple[list[VerticalHere], list[int]]:
    """The different ones of successive verticals, and which of these each one is."""
    kinds, of = [verticals[0]], []
    for here in verticals:
        if here is not kinds[-1]:
            kinds.append(here)
        of.append(len(kinds) - 1)
    return kinds, of
