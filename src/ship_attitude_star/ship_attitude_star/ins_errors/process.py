"""Interface of an error process of the INS: its states and their propagation over time and distance."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from ship_attitude_star.vertical.vertical_track import LocalVertical
from ship_geometry.rotations import FloatArray

ATTITUDE_ERROR = slice(0, 3)
"""Slice of the INS attitude error (north, up, east) relative to the geodetic horizon: the first states of a process."""

DEFLECTION = slice(3, 5)
"""Slice of the deflection of the vertical (xi, eta), in processes that contain it."""


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
        shift = here.given_deflection - remaining_ratio * (
            here.given_deflection if before.given_deflection is None else before.given_deflection
        )
    return DeflectionChange(remaining_ratio, shift, (1.0 - remaining_ratio * remaining_ratio) * here.covariance)


def own_error_matrix(here: LocalVertical) -> FloatArray:
    """Return the matrix from attitude error and deflection to the INS error relative to the gravity horizon, (3, 5)."""
    return np.hstack([np.eye(3), -here.deflection_jacobian])
