"""The error of the INS at moments after a state of the filter, where the deflection of the vertical is a state."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.ins_process import SIZE, Carried, InsOnGravity, own_from_whole
from ship_attitude_star.vertical.vertical_track import VerticalHere, VerticalTrack
from ship_geometry.rotations import FloatArray

_OF_PROCESS, _CLOCK = [0, 1, 2, 4, 5], 3
"""Of the six states that correct the INS: those of its process (error of the attitude, deflection); its time offset."""

_DEFLECTION = slice(4, 6)


class InsErrors(NamedTuple):
    """The INS's error at N moments, against the horizon that was asked for.

    Attributes:
        error_n: of the attitude (north, up, east), rad, shape (N, 3).
        parts: covariance of it and of the time offset by source, shape (N, n_sources, 4, 4).
        deflection: (xi, eta), rad, shape (N, 2).
        deflection_covariance: of it, rad², shape (N, 2, 2).
        vertical_known: whether the deflection is given, or known better than half of what it may be where none is,
            shape (N,).
    """

    error_n: FloatArray
    parts: FloatArray
    deflection: FloatArray
    deflection_covariance: FloatArray
    vertical_known: NDArray[np.bool_]


class OnGravity:
    """What carries the six states that correct the INS: its attitude error, its time offset, the deflection.

    Args:
        process: of the attitude error and the deflection.
        vertical: the vertical under way.
        sources: indices of the error sources of the INS and of the deflection.
        to_gravity: whether the attitude is told against gravity's horizon.
    """

    def __init__(
        self, process: InsOnGravity, vertical: VerticalTrack, sources: tuple[int, int], to_gravity: bool
    ) -> None:
        self._process, self._vertical, self._to_gravity = process, vertical, to_gravity
        self._ins, self._deflection = sources
        self._unknown_variance = vertical.unknown_variance

    def errors(
        self,
        since_ns: int | None,
        before: VerticalHere | None,
        mean: FloatArray,
        parts: FloatArray,
        times_ns: Sequence[int],
    ) -> InsErrors:
        """The INS's error at some moments.

        Args:
            since_ns: the moment of the state; None before the first measurement.
            before: the vertical at that moment; None likewise.
            mean: of the six states, shape (6,).
            parts: their covariance by source, shape (n_sources, 6, 6).
            times_ns: the moments, none before that of the state, in ascending order, N of them.
        """
        verticals = [self._vertical.at(time_ns) for time_ns in times_ns]
        count = len(times_ns)
        of_process = np.tile(mean[_OF_PROCESS], (count, 1))
        transition, noise = np.tile(np.eye(6), (count, 1, 1)), np.zeros((count, len(parts), 6, 6))
        rows, columns = np.ix_(_OF_PROCESS, _OF_PROCESS)
        if since_ns is None or before is None:
            # Nothing was measured: at each moment the state would begin anew.
            begun = [self._process.begun(here) for here in verticals]
            of_process += [shift for shift, _ in begun]
            noise[:, self._deflection, rows, columns] = [covariance for _, covariance in begun]
        else:
            dt_s = np.array([(time_ns - since_ns) * 1e-9 for time_ns in times_ns])
            carried: Carried = self._process.carried(dt_s, before, verticals)
            of_process = self._process.means(mean[None, _OF_PROCESS], before, carried)[:, 0]
            transition[:, rows, columns] = carried.transition
            noise[:, self._ins, rows, columns] += carried.ins_noise
            noise[:, self._deflection, rows, columns] += carried.deflection_noise
        after = transition[:, None] @ parts @ np.swapaxes(transition, -1, -2)[:, None] + noise
        told, of_deflection = self._told(verticals), after[:, :, _DEFLECTION, _DEFLECTION].sum(axis=1)
        # Written so that NaN is not known.
        known = 4.0 * np.trace(of_deflection, axis1=1, axis2=2) <= 2.0 * self._unknown_variance
        to_four = np.zeros((count, 4, 6))
        to_four[:, :3, _OF_PROCESS], to_four[:, 3, _CLOCK] = told, 1.0
        return InsErrors(
            error_n=(told @ of_process[:, :, None])[..., 0],
            parts=np.ascontiguousarray(to_four[:, None] @ after @ np.swapaxes(to_four, -1, -2)[:, None]),
            deflection=of_process[:, 3:],
            deflection_covariance=of_deflection,
            vertical_known=known | np.array([here.given is not None for here in verticals]),
        )

    def _told(self, verticals: Sequence[VerticalHere]) -> FloatArray:
        """What is told of the states of the process: the error against the horizon asked for, shape (N, 3, 5)."""
        if not self._to_gravity:
            return np.tile(np.eye(3, SIZE), (len(verticals), 1, 1))
        return np.array([own_from_whole(here) for here in verticals])
