"""The INS as the one that is wrong: in the rows that do without it, and in all of them once it is distrusted.

Where the INS is wrong its slow error is unknown, but its turn from one measurement to the next is used. An INS that
creeps away from all others is excluded in this way. One that told a fault of its own, by a jump, and that all stars
contradict after that has lost its word: it is distrusted. Its turn may be wrong too, as when its clock or its axes are;
so each measurement that contradicts it finds all rows open for that, the attitude is in doubt, and nothing is learnt
but the error of the INS itself: a lie that is over has left nothing. It is believed again once it has agreed for
``integrity.return_after_s``.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.model import SOURCE_INS, ShipStateModel
from ship_attitude_star.ship_attitude.row_table import INS, RowTable
from ship_attitude_star.ship_attitude.state import Doubt, FilterState, changed, with_entry, without
from ship_estimation.exclusion import Exclusion, must_agree_s
from ship_estimation.gates import chi_square_gate
from ship_estimation.hypotheses import RowsCompared, add_error
from ship_estimation.running_means import forgotten
from ship_estimation.unconfirmed import Unconfirmed
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.time_scales import SECOND_NS

_UNKNOWN_RAD = 600.0 * ARCSEC
UNKNOWN_INS_RAD_PER_SQRT_S = 2.0 * ARCSEC
"""Where the INS is the one that is wrong, its slow error starts with the first sigma and walks by the second.

With two or three sensors at 5 Hz such a row remembers for half a second, in heading by two sensors for a little more
than one: an INS that creeps by 200″ a minute is one to two sigmas of the row ahead of it. A larger walk would follow
faster, and raise every protection level.
"""

_ABOUT_EACH_AXIS = np.eye(3)

_LEAST_AGAINST = 2
"""Sources that check each other: with fewer nobody tells whether the INS is wrong or the one that there is."""

_UNCONTRADICTED_S = 10.0
"""An INS whose clock has stepped, and that nobody has contradicted for so long, is believed again: the ship has rolled
one way and the other, and the clocks of all devices stepped alike, as with a leap second."""


class InsAtFault:
    """What is done with the rows where the INS is wrong.

    Args:
        config: the node's configuration.
        model: what the states are.
        table: the rows.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, table: RowTable) -> None:
        self._table, self._return_after_s = table, config.integrity.return_after_s
        self._degraded_after = config.gate.degraded_after
        self._agreed = chi_square_gate(config.gate.probability, 3)
        self._slow, self._part = model.slices["ins.attitude"], model.sources.index(SOURCE_INS)
        self._all_but_slow = np.ones(model.size, dtype=bool)
        self._all_but_slow[self._slow] = False

    def all_rows_at(self, mean: FloatArray, parts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Means and covariances of all rows that begin at one state, of shapes (n,) and (n_sources, n, n)."""
        rows = self._table.rows
        stack = np.concatenate([parts, np.tile(parts.sum(axis=0), (rows - 1, 1, 1))])
        for row in self._table.ins_rows:
            self._open(stack, rows, _UNKNOWN_RAD**2 * np.eye(3), row)
        return np.tile(mean, (rows, 1)), stack

    def open_slow_error(self, parts: FloatArray, covariance_n: FloatArray) -> None:
        """Inflate the covariance of the INS's slow error, in place, in an estimate that has no other rows."""
        self._open(parts, 1, covariance_n, None)

    def carried(self, state: FilterState, stack: FloatArray, dt_s: float) -> None:
        """Let the INS wander, in place, where it is the one that is wrong."""
        walked = UNKNOWN_INS_RAD_PER_SQRT_S**2 * dt_s * _ABOUT_EACH_AXIS
        for row in (None,) if INS in state.excluded else self._table.ins_rows:
            self._open(stack, len(state.means), walked, row)

    def opened_against(
        self, state: FilterState, source: str, compared: RowsCompared, predicted_nv: FloatArray, gate: float
    ) -> tuple[FloatArray, list[int]]:
        """Covariances where the INS has turned by what a measurement contradicts, and the rows that were opened.

        A row in which the INS is the one that is wrong is opened once the source has contradicted it for so long that
        one refusal more makes it a fault; all rows are opened at once where the INS is distrusted.

        Args:
            state: predicted.
            source: who measured.
            compared: the measurement with every row.
            predicted_nv: the device as the first row has it, shape (3, 3).
            gate: of the NIS.
        """
        everywhere = distrusted(state) and source not in state.excluded
        # Written so that NaN opens nothing.
        far = [row for row in ((0,) if everywhere else self._table.ins_rows) if compared.nis[row] > gate]
        wrong = far if everywhere else [row for row in far if self._contradicted(state, source, row)]
        if not wrong:
            return state.stack, []
        stack: FloatArray = state.stack.copy()
        for row in wrong:
            turn_n = predicted_nv @ compared.turn_root[row] @ compared.turn[row]
            covariance_n = np.outer(turn_n, turn_n) + 0.01 * (turn_n @ turn_n) * np.eye(3)
            self._open(stack, len(state.means), covariance_n, None if everywhere else row)
        return stack, list(range(len(state.means))) if everywhere else wrong

    def learns(self, state: FilterState, learns: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which states each row may learn, shape (h, n): clocks and mountings stay as they were under distrust."""
        return learns & ~self._all_but_slow if distrusted(state) else learns

    # -- distrust -------------------------------------------------------------------------------------------

    def told(self, state: FilterState, time_ns: int) -> bool:
        """True if the INS reported a jump of its own and has not gone uncontradicted for ``return_after_s`` since."""
        since_ns = state.ins_suspected_ns
        return since_ns is not None and time_ns - since_ns <= self._return_after_s * SECOND_NS

    def may_be_excluded(self, in_use: Sequence[str]) -> bool:
        """Whether enough sources are in use that check each other without the INS."""
        return len(in_use) >= _LEAST_AGAINST

    def clock_has_stepped(self, state: FilterState, time_ns: int) -> FilterState:
        """The state after the INS's clock has stepped by more than can be estimated: it is distrusted at once."""
        if distrusted(state) or not self.may_be_excluded(state.in_use(self._table.sources, time_ns)):
            return state
        times = state.record.get(INS, 0) + 1
        excluded = with_entry(state.excluded, INS, Exclusion(time_ns, times, on_suspicion=True))
        state = changed(state, excluded=excluded, record=with_entry(state.record, INS, times))
        return self._doubted(state, time_ns, "the INS is excluded: its clock has stepped")

    def contradicted_now(self, state: FilterState, time_ns: int) -> FilterState:
        """The state in which an INS that is excluded is distrusted, and was contradicted just now.

        Its turn from one measurement to the next may be as wrong as it was of late: the attitude is in doubt by that.
        """
        names = state.in_use(self._table.sources, time_ns)
        excluded = with_entry(state.excluded, INS, changed(state.excluded[INS], on_suspicion=False))
        text = f"the INS is excluded: it told a fault of its own, and {', '.join(names) or 'all'} contradicted it"
        return self._doubted(changed(state, excluded=excluded), time_ns, text)

    def not_compared(self, state: FilterState, time_ns: int) -> FilterState:
        """The state after a measurement that contradicts it so much that the two cannot be compared."""
        if not distrusted(state):
            return state
        stack = state.stack.copy()
        self._open(stack, len(state.means), _UNKNOWN_RAD**2 * np.eye(3), None)
        return self.contradicted_now(changed(state, stack=stack), time_ns)

    def watched(self, state: FilterState, compared: RowsCompared, agrees: bool, time_ns: int) -> FilterState:
        """The state in which the INS is distrusted, after a measurement.

        Args:
            state: with the measurement.
            compared: the measurement with every row.
            agrees: whether what its source measured of late agrees with the first row.
            time_ns: its stamp.
        """
        turn = compared.turn[0]
        # NaN does not agree.
        return state if agrees and turn @ turn <= self._agreed else self.contradicted_now(state, time_ns)

    def believed_again(self, state: FilterState, time_ns: int) -> FilterState:
        """The state in which an excluded INS is used again.

        One that is distrusted must have agreed for so long. One that crept is tried after a while: there no single
        measurement tells.
        """
        exclusion = state.excluded.get(INS)
        if exclusion is None:
            return state
        distrust = distrusted(state)
        if state.doubt is not None and not distrust:
            return state
        since_ns = exclusion.since_ns if exclusion.agrees_since_ns is None else exclusion.agrees_since_ns
        after_s = _UNCONTRADICTED_S if exclusion.on_suspicion else must_agree_s(exclusion, self._return_after_s)
        if (time_ns - since_ns) / SECOND_NS < after_s:
            return state
        if distrust:
            # The rows learnt nothing that tells them apart.
            means, stack = self.all_rows_at(state.mean, state.parts)
            state = changed(state, means=means, stack=stack)
        if not exclusion.on_suspicion:
            # What its open error has hidden, the stars show once it is closed, within half of a slow roll.
            confirmed_ns = time_ns + round(_UNCONTRADICTED_S * SECOND_NS)
            state = changed(state, unconfirmed=Unconfirmed(confirmed_ns, "the INS is used again", "stars"))
        return changed(state, excluded=without(state.excluded, INS), doubt=None, ins_suspected_ns=time_ns)

    # ---------------------------------------------------------------------------------------------------------

    def _doubted(self, state: FilterState, time_ns: int, text: str) -> FilterState:
        """The state in which an INS that is excluded is distrusted from now on: the attitude is in doubt."""
        names = state.in_use(self._table.sources, time_ns)
        disputed = [state.apart[name].turn_n for name in names if name in state.apart]
        covariance_n = sum((np.outer(turn_n, turn_n) for turn_n in disputed), start=np.zeros((3, 3)))
        excluded = with_entry(state.excluded, INS, changed(state.excluded[INS], agrees_since_ns=time_ns))
        seen = forgotten(state.seen, slice(None), slice(None))
        return changed(state, excluded=excluded, seen=seen, doubt=Doubt(text, covariance_n))

    def _contradicted(self, state: FilterState, source: str, row: int) -> bool:
        """Whether a source that a row uses has contradicted it for so long that one refusal more makes it a fault."""
        index = self._table.sources.index(source)
        if source in state.excluded or not self._table.uses[row, index]:
            return False
        return bool(state.seen.refused[row, index] >= self._degraded_after - 1)

    def _open(self, stack: FloatArray, rows: int, covariance_n: FloatArray, row: int | None) -> None:
        add_error(stack, rows, self._part, self._slow, covariance_n, row)


def distrusted(state: FilterState) -> bool:
    """Whether the INS is excluded because all stars contradicted it after it had told a fault of its own."""
    exclusion = state.excluded.get(INS)
    return exclusion is not None and exclusion.agrees_since_ns is not None
