"""The errors of the INS at moments after an estimate, and how they go together with the state at the next one."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ship_attitude_star.ins_errors.process import Carried, own_from_whole
from ship_attitude_star.ship_attitude.filter import ShipFilter
from ship_attitude_star.vertical.vertical_track import VerticalHere
from ship_estimation.backward import Known
from ship_estimation.backward_chain import Anchor
from ship_estimation.kalman import slow_error_later
from ship_geometry.rotations import FloatArray

_CLOCK = 3
"""Where the INS's time offset stands among the quantities that are told; the error of its attitude is before it."""


ShipAnchor = Anchor[VerticalHere | None]
"""An estimate with the vertical at its moment; None where the configuration has no process that asks for it."""


class _Passage(NamedTuple):
    """What some times make of the n states, N of them.

    Attributes:
        transition: shape (N, n, n).
        means: of the states then, shape (N, n).
        noise: covariance of what comes new, shape (N, n, n).
    """

    transition: FloatArray
    means: FloatArray
    noise: FloatArray


class Between:
    """Predicts what corrects the INS: the error of its attitude (north, up, east) and its time offset.

    Args:
        filter_: the filter and its model.
        to_gravity: whether the attitude is told against gravity's horizon.
    """

    def __init__(self, filter_: ShipFilter, to_gravity: bool) -> None:
        self._model, self._vertical, self._to_gravity = filter_.model, filter_.vertical, to_gravity
        attitude, rest = np.split(self._model.process_rows, [3])
        self._rows = np.concatenate([attitude, self._model.rows("ins.time_offset"), rest])

    @property
    def knows_before_the_first(self) -> bool:
        """Whether the errors are known at moments before the first measurement: those that only die out are."""
        return self._model.ins_process is None

    def cross_to(self, anchor: ShipAnchor, later: ShipAnchor) -> FloatArray:
        """See :meth:`ship_estimation.backward_chain.Between.cross_to`."""
        assert later.time_ns is not None
        (transition,) = self._passage(anchor, [later.time_ns]).transition
        cross: FloatArray = anchor.known.covariance @ transition.T
        return cross

    def at(
        self, anchor: ShipAnchor, times_ns: Sequence[int], later: ShipAnchor | None
    ) -> tuple[Known, FloatArray | None]:
        """What corrects the INS, four quantities; see :meth:`ship_estimation.backward_chain.Between.at`.

        A jump opens the state as much earlier as clocks may differ: the moments between are told as at that.
        """
        if later is not None:
            assert later.time_ns is not None
            times_ns = [min(time_ns, later.time_ns) for time_ns in times_ns]
        mean, covariance = anchor.known
        if anchor.time_ns is None:
            # Errors that only die out are, before the first measurement, what they may be at any moment.
            means, everywhere = np.tile(mean, (len(times_ns), 1)), np.tile(covariance, (len(times_ns), 1, 1))
        else:
            passage = self._passage(anchor, times_ns)
            means = passage.means
            transition = passage.transition
            everywhere = transition @ covariance @ np.swapaxes(transition, -1, -2) + passage.noise
        told = self._told(times_ns)
        of_told = told @ everywhere
        known = Known((told @ means[..., None])[..., 0], of_told @ np.swapaxes(told, -1, -2))
        if later is None:
            return known, None
        assert later.time_ns is not None
        onward = self._onward(anchor, times_ns, later.time_ns)
        return known, of_told @ np.swapaxes(onward, -1, -2)

    def _passage(self, anchor: ShipAnchor, times_ns: Sequence[int]) -> _Passage:
        """From an anchor to N moments."""
        assert anchor.time_ns is not None
        model, mean = self._model, anchor.known.mean
        dt_s = 1e-9 * (np.array(times_ns) - anchor.time_ns).astype(float)
        decay, variance = model.transition(dt_s)
        transition, noise, means = _diagonal(decay), _diagonal(variance), decay * mean
        carried = self._carried(anchor, times_ns)
        if carried is None:
            slow = model.slices["ins.attitude"]
            means[:, slow] = slow_error_later(mean[slow], decay[:, slow], model.slow.sigma)
            return _Passage(transition, means, noise)
        assert model.ins_process is not None
        assert anchor.given is not None
        block = np.s_[:, model.process_rows[:, None], model.process_rows]
        transition[block] = carried.transition
        noise[block] += carried.ins_noise + carried.deflection_noise
        of_process = model.ins_process.means(mean[None, model.process_rows], anchor.given, carried)
        means[:, model.process_rows] = of_process[:, 0]
        return _Passage(transition, means, noise)

    def _onward(self, anchor: ShipAnchor, times_ns: Sequence[int], later_ns: int) -> FloatArray:
        """Transition from N moments after an anchor to a later one, shape (N, n, n)."""
        model = self._model
        left_s = 1e-9 * (later_ns - np.array(times_ns)).astype(float)
        onward = _diagonal(model.transition(left_s)[0])
        carried = self._carried(anchor, [*times_ns, later_ns])
        if carried is not None:
            # The way from the anchor to the later moment is the way to each moment and that which is left.
            to_each, to_later = carried.transition[:-1], carried.transition[-1]
            left = np.linalg.solve(np.swapaxes(to_each, -1, -2), np.broadcast_to(to_later.T, to_each.shape))
            onward[:, model.process_rows[:, None], model.process_rows] = np.swapaxes(left, -1, -2)
        return onward

    def _carried(self, anchor: ShipAnchor, times_ns: Sequence[int]) -> Carried | None:
        """What the way makes of the process of the INS's error; None where it has none."""
        process = self._model.ins_process
        if process is None:
            return None
        assert anchor.time_ns is not None
        assert anchor.given is not None
        assert self._vertical is not None
        return process.carried(anchor.time_ns, anchor.given, times_ns, self._vertical)

    def _told(self, times_ns: Sequence[int]) -> FloatArray:
        """Matrices that take the states to what is told, shape (N, 4, n)."""
        told = np.zeros((len(times_ns), _CLOCK + 1, self._model.size))
        told[:, np.arange(_CLOCK + 1), self._rows[: _CLOCK + 1]] = 1.0
        if self._to_gravity:
            assert self._vertical is not None
            own = [own_from_whole(self._vertical.at(time_ns)) for time_ns in times_ns]
            told[:, :_CLOCK, self._model.process_rows[:5]] = own
        return told


def _diagonal(values: FloatArray) -> FloatArray:
    """Diagonal matrices, shape (N, n, n), of their diagonals, shape (N, n)."""
    matrices: FloatArray = values[..., None] * np.eye(values.shape[-1])
    return matrices
