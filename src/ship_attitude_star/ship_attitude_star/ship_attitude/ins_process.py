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

from typing import NamedTuple

import numpy as np

from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_estimation.kalman import StateBlock, lasting
from ship_geometry.rotations import FloatArray

_WHOLE, _DEFLECTION = slice(0, 3), slice(3, 5)
"""The states of the process: the whole error of the INS's attitude (north, up, east), then the deflection (xi, eta)."""

SIZE = 5


class Carried(NamedTuple):
    """What a time and a way make of the states of the process, at N moments; all shapes with (N,) in front.

    Attributes:
        transition: of the states, shape (5, 5).
        shift: added to them, shape (5,).
        ins_noise: covariance of the INS's own new error, shape (5, 5).
        deflection_noise: covariance of the deflection's new error, shape (5, 5).
    """

    transition: FloatArray
    shift: FloatArray
    ins_noise: FloatArray
    deflection_noise: FloatArray


class InsOnGravity:
    """The process of the states ``ins.attitude`` and ``gravity.deflection``.

    Args:
        slow: the INS's own slow error: its sigma and correlation time about (North, Up, East).
        length_m: correlation length of the deflection over ground.
    """

    def __init__(self, slow: StateBlock, length_m: float) -> None:
        self._time_s, self._sigma, self._length_m = slow.time_s, slow.sigma, length_m

    def begun(self, here: VerticalHere) -> tuple[FloatArray, FloatArray]:
        """The states where nothing was measured yet, shape (5,), and the covariance of the deflection, (5, 5)."""
        given = np.zeros(2) if here.given is None else here.given
        moved_by = _moved_by_deflection(here)
        return moved_by @ given, moved_by @ here.covariance @ moved_by.T

    def carried(self, dt_s: FloatArray, before: VerticalHere, after: list[VerticalHere]) -> Carried:
        """What time and way make of the states.

        Args:
            dt_s: time to each of N moments, not negative, shape (N,).
            before: the vertical at the beginning.
            after: the vertical at each of the moments.
        """
        # Moments within an even second share one vertical.
        kinds, of = _kinds(after)
        along = [self._along(before, here) for here in kinds]
        turn, left, shift, fresh = (np.array(column)[of] for column in zip(*along, strict=True))
        decay = np.exp(-np.asarray(dt_s)[:, None] / self._time_s)
        transition = np.zeros((len(of), SIZE, SIZE))
        transition[:, range(3), range(3)] = decay
        transition[:, _WHOLE, _DEFLECTION] = turn * left[:, None, None] - decay[:, :, None] * turn
        transition[:, (3, 4), (3, 4)] = left[:, None]
        ins_noise = np.zeros((len(of), SIZE, SIZE))
        ins_noise[:, range(3), range(3)] = self._sigma**2 * (1.0 - decay * decay)
        return Carried(transition, shift, ins_noise, fresh)

    def means(self, means: FloatArray, before: VerticalHere, carried: Carried) -> FloatArray:
        """The states of h rows, shape (h, 5), at N moments, shape (N, h, 5).

        An error of the INS far beyond its sigma, as after a jump, does not die out (:func:`lasting`).
        """
        after: FloatArray = means @ np.swapaxes(carried.transition, -1, -2) + carried.shift[:, None]
        own = means[:, _WHOLE] - means[:, _DEFLECTION] @ before.turn.T
        stays = lasting(own, self._sigma)
        after[..., _WHOLE] = np.where(stays, means[:, _WHOLE], after[..., _WHOLE])
        return after

    def _along(self, before: VerticalHere, here: VerticalHere) -> tuple[FloatArray, float, FloatArray, FloatArray]:
        """Turn, what is left of the deflection, what is added to the states, and the covariance of what comes new."""
        way_m = max(here.along_m - before.along_m, 0.0)
        left = float(np.exp(-way_m / self._length_m))
        moved_by, shift = _moved_by_deflection(here), np.zeros(SIZE)
        if here.given is not None:
            # What is given for the first time changes nothing at once: the estimate goes there with the way.
            given_before = here.given if before.given is None else before.given
            shift = moved_by @ (here.given - left * given_before)
        return here.turn, left, shift, (1.0 - left * left) * moved_by @ here.covariance @ moved_by.T


def own_from_whole(here: VerticalHere) -> FloatArray:
    """Matrix that takes the states of the process to the INS's own error against gravity's horizon, shape (3, 5)."""
    return np.hstack([np.eye(3), -here.turn])


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
