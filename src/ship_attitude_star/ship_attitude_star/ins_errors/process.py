"""What a process of the INS's error is: the states that it carries, and what a time and a way make of them."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_geometry.rotations import FloatArray

WHOLE = slice(0, 3)
"""The first states of each process: the whole error of the INS's attitude (north, up, east) against the geodetic
horizon."""

DEFLECTION = slice(3, 5)
"""The deflection of the vertical (xi, eta), in processes that carry it."""


class Carried(NamedTuple):
    """What a time and a way make of the n states of a process, at N moments; all shapes with (N,) in front.

    Attributes:
        transition: of the states, shape (n, n).
        shift: added to them, shape (n,).
        ins_noise: covariance of the INS's own new error, shape (n, n).
        deflection_noise: covariance of what comes new by the deflection, shape (n, n).
    """

    transition: FloatArray
    shift: FloatArray
    ins_noise: FloatArray
    deflection_noise: FloatArray


class Vertical(Protocol):
    """What tells the vertical at any moment."""

    def at(self, time_ns: int) -> VerticalHere:
        """The vertical; within one even second the same object."""


class InsProcess(Protocol):
    """The process of the INS's error.

    Attributes:
        blocks: names of the blocks of states that it carries, in its own order; ``ins.attitude`` is the first.
        size: how many states these are.
        needs_latitude: whether it says nothing that is true before the first position fix.
    """

    blocks: tuple[str, ...]
    size: int
    needs_latitude: bool

    def begun(self, here: VerticalHere) -> tuple[FloatArray, FloatArray]:
        """The states where nothing was measured yet, shape (n,), and their covariance by the deflection, (n, n)."""

    def carried(
        self, since_ns: int, before: VerticalHere, times_ns: Sequence[int], vertical: Vertical
    ) -> Carried:
        """What time and way make of the states.

        Args:
            since_ns: the moment from which on.
            before: the vertical at that moment.
            times_ns: N moments, none before it, in ascending order.
            vertical: the vertical under way.
        """

    def means(self, means: FloatArray, before: VerticalHere, carried: Carried) -> FloatArray:
        """The states of h rows, shape (h, n), at N moments, shape (N, h, n).

        An error of the attitude far beyond its sigma, as after a jump, does not die out
        (:func:`ship_estimation.kalman.lasting`).
        """


class DeflectionChange(NamedTuple):
    """What a way makes of the deflection d: left * d + moved, and its error's own new part.

    Attributes:
        left: how much of the deflection before is left.
        moved: what is added, shape (2,).
        fresh: covariance of what is added, shape (2, 2).
    """

    left: float
    moved: FloatArray
    fresh: FloatArray


def deflection_change(before: VerticalHere, here: VerticalHere, length_m: float) -> DeflectionChange:
    """How the deflection changes from one place to a later one, its errors being correlated over ``length_m``."""
    left = float(np.exp(-max(here.along_m - before.along_m, 0.0) / length_m))
    moved = np.zeros(2)
    if here.given is not None:
        # What is given for the first time changes nothing at once: the estimate goes there with the way.
        moved = here.given - left * (here.given if before.given is None else before.given)
    return DeflectionChange(left, moved, (1.0 - left * left) * here.covariance)


def own_from_whole(here: VerticalHere) -> FloatArray:
    """Matrix that takes the whole error and the deflection to the INS's own error against gravity's horizon, (3, 5)."""
    return np.hstack([np.eye(3), -here.turn])
