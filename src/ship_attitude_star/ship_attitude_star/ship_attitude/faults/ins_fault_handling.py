"""Handling of INS faults in the subfilters that exclude the INS, and in all filters while the INS is excluded.

There are two kinds of exclusion. After a drift only the correlated error of the INS is unknown. The covariance of this
error grows by a random walk, and the change of the INS attitude between measurements is still used. The subfilters
without the INS treat the INS error as unknown in the same way.

An INS that reported a jump, and that all stars contradict afterwards, is *excluded by the stars*. The change of the INS
attitude may then be wrong as well, for example after an error of the INS clock or axes. Therefore each inconsistent
measurement inflates the covariance in all filters, the fault counts as unresolved, and only the error of the INS is
estimated. The fault therefore does not affect the other states. An INS with a clock step too large to estimate is
treated in the same way.

The INS is reinstated after ``integrity.return_after_s``, doubled by each further exclusion, or earlier after a clock
step without contradiction (:meth:`InsFaultHandling.reinstate_ins`).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.model import INS, SOURCE_INS, ShipStateModel, ShipSubfilters
from ship_attitude_star.ship_attitude.state import FilterState
from ship_estimation.fault_detection.exclusion import (
    ExcludedSource,
    UnconfirmedStep,
    UnresolvedFault,
    reinstatement_time_s,
    with_changes,
    with_entry,
    without_entry,
)
from ship_estimation.fault_detection.isolation import cleared_means
from ship_estimation.fault_detection.subfilters import FilterInnovations, add_error
from ship_estimation.innovations.gates import chi_square_gate
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray

_UNKNOWN_INS_RAD = 600.0 * ARCSEC
UNKNOWN_INS_RAD_PER_SQRT_S = 2.0 * ARCSEC
"""Initial standard deviation, rad, and random walk, rad/√s, of the correlated error of an excluded INS.

With two or three sensors at 5 Hz the subfilter without the INS then has a time constant of 0.5 s, in heading with two
sensors about 1 s. If the INS drifts by 200″ per minute, its error is one to two standard deviations ahead of the
estimate. A larger random walk would reduce this lag, and would increase every protection level.
"""

_IDENTITY = np.eye(3)

_MIN_SOURCES = 2
"""Minimum number of other sources to exclude the INS; a single source cannot be checked without the INS."""

_CONSISTENT_FOR_S = 10.0
"""Time without contradiction after which an INS with a clock step is reinstated, s.

In this time the ship has rolled to both sides, so a wrong clock would have shown. A clock step without contradiction is
a step of all clocks, as at a leap second.
"""


class InsFaultHandling:
    """Covariances, exclusion and reinstatement for INS faults.

    Args:
        config: configuration of the node.
        model: state vector.
        subfilters: the filters.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, subfilters: ShipSubfilters) -> None:
        self._subfilters, self._return_after_s = subfilters, config.integrity.return_after_s
        self._degraded_after = config.gate.degraded_after
        self._consistent_gate = chi_square_gate(config.gate.probability, 3)
        self._ins_attitude, self._part = model.slices["ins.attitude"], model.sources.index(SOURCE_INS)
        self._all_but_ins_attitude = np.ones(model.size, dtype=bool)
        self._all_but_ins_attitude[self._ins_attitude] = False

    def all_filters_at(self, mean: FloatArray, covariance_by_source: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means and covariances of all filters started from one state.

        In the subfilters without the INS the covariance of the INS error is inflated, because this error is unknown
        there.

        Args:
            mean: estimated errors, shape (n,).
            covariance_by_source: covariance by error source, shape (n_sources, n, n).

        Returns:
            Means, shape (h, n), and covariances, shape (n_sources + h - 1, n, n).
        """
        count = self._subfilters.count
        stack = np.concatenate([covariance_by_source, np.tile(covariance_by_source.sum(axis=0), (count - 1, 1, 1))])
        for subfilter in self._subfilters.ins_subfilters:
            self._inflate(stack, count, _UNKNOWN_INS_RAD**2 * np.eye(3), subfilter)
        return np.tile(mean, (count, 1)), stack

    def inflate_ins_attitude(self, covariance_by_source: FloatArray, covariance_n: FloatArray) -> None:
        """Inflate the covariance of the correlated INS error, in place, in a main filter without subfilters."""
        self._inflate(covariance_by_source, 1, covariance_n, None)

    def propagate(self, state: FilterState, stack: FloatArray, dt_s: float) -> None:
        """Add the random walk of an unknown INS error, in place.

        The random walk is added in the subfilters without the INS, or in all filters while the INS is excluded.
        """
        walk = UNKNOWN_INS_RAD_PER_SQRT_S**2 * dt_s * _IDENTITY
        for subfilter in (None,) if INS in state.excluded else self._subfilters.ins_subfilters:
            self._inflate(stack, len(state.means), walk, subfilter)

    def inflate_against(
        self, state: FilterState, source: str, innovations: FilterInnovations, predicted_nv: FloatArray, gate: float
    ) -> tuple[FloatArray, list[int]]:
        """Inflate the covariance of the INS error for an inconsistent innovation.

        A subfilter without the INS is inflated if one more rejection of the source would count as a fault. If the stars
        have excluded the INS, all filters are inflated at the first rejection.

        Args:
            state: state propagated to the time of the measurement.
            source: source of the measurement.
            innovations: innovations of all filters.
            predicted_nv: attitude of the device predicted by the main filter, shape (3, 3).
            gate: threshold of the NIS.

        Returns:
            The covariances, and the indices of the inflated filters.
        """
        in_all = is_ins_excluded_by_stars(state) and source not in state.excluded
        # NaN inflates nothing.
        rejecting = [
            subfilter
            for subfilter in ((0,) if in_all else self._subfilters.ins_subfilters)
            if innovations.nis[subfilter] > gate
        ]
        inflated = rejecting if in_all else [row for row in rejecting if self._is_contradicted(state, source, row)]
        if not inflated:
            return state.stack, []
        stack: FloatArray = state.stack.copy()
        for row in inflated:
            rotation_n = predicted_nv @ innovations.whitening_root[row] @ innovations.whitened_innovation[row]
            covariance_n = np.outer(rotation_n, rotation_n) + 0.01 * (rotation_n @ rotation_n) * np.eye(3)
            self._inflate(stack, len(state.means), covariance_n, None if in_all else row)
        return stack, list(range(len(state.means))) if in_all else inflated

    def updatable_states(self, state: FilterState, updatable: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the mask of states to update, shape (h, n); only the INS attitude if the stars excluded the INS."""
        return updatable & ~self._all_but_ins_attitude if is_ins_excluded_by_stars(state) else updatable

    # -- exclusion by the stars -----------------------------------------------------------------------------

    def has_reported_jump(self, state: FilterState, time_ns: int) -> bool:
        """True for ``return_after_s`` after a reported jump, a later contradiction or a reinstatement of the INS."""
        since_ns = state.ins_fault_ns
        return since_ns is not None and time_ns - since_ns <= self._return_after_s * SECOND_NS

    def can_be_excluded(self, in_use: Sequence[str]) -> bool:
        """True if enough sources are in use to check each other without the INS."""
        return len(in_use) >= _MIN_SOURCES

    def exclude_for_clock_step(self, state: FilterState, time_ns: int) -> FilterState:
        """Exclude the INS after a clock step that is too large to estimate, if enough other sources are in use."""
        if is_ins_excluded_by_stars(state) or not self.can_be_excluded(state.in_use(self._subfilters.sources, time_ns)):
            return state
        times = state.exclusion_counts.get(INS, 0) + 1
        excluded = with_entry(state.excluded, INS, ExcludedSource(time_ns, times, is_self_reported=True))
        state = with_changes(state, excluded=excluded, exclusion_counts=with_entry(state.exclusion_counts, INS, times))
        return self._with_unresolved_fault(state, time_ns, "the INS is excluded: step of its clock")

    def with_contradiction(self, state: FilterState, time_ns: int) -> FilterState:
        """Return the state after other sources contradicted an excluded INS, with the reinstatement timer restarted.

        The fault is unresolved, and its covariance follows from the last innovations, because the change of the INS
        attitude may remain wrong by as much as these innovations.
        """
        names = state.in_use(self._subfilters.sources, time_ns)
        excluded = with_entry(state.excluded, INS, with_changes(state.excluded[INS], is_self_reported=False))
        text = f"the INS is excluded: its rates showed a jump, and {', '.join(names) or 'all sources'} contradicted it"
        return self._with_unresolved_fault(with_changes(state, excluded=excluded), time_ns, text)

    def with_not_evaluable(self, state: FilterState, time_ns: int) -> FilterState:
        """Return the state after a measurement that was not evaluable because it contradicts the state.

        If the stars have excluded the INS, the INS error is treated as unknown again.
        """
        if not is_ins_excluded_by_stars(state):
            return state
        stack = state.stack.copy()
        self._inflate(stack, len(state.means), _UNKNOWN_INS_RAD**2 * np.eye(3), None)
        return self.with_contradiction(with_changes(state, stack=stack), time_ns)

    def monitor(
        self, state: FilterState, innovations: FilterInnovations, is_consistent: bool, time_ns: int
    ) -> FilterState:
        """Restart the reinstatement timer if a measurement contradicts the INS that the stars have excluded.

        Args:
            state: state after the measurement.
            innovations: innovations of all filters.
            is_consistent: True if the recent innovations of the measurement's source are consistent.
            time_ns: stamp of the measurement.
        """
        innovation = innovations.whitened_innovation[0]
        # NaN is inconsistent.
        if is_consistent and innovation @ innovation <= self._consistent_gate:
            return state
        return self.with_contradiction(state, time_ns)

    def reinstate_ins(self, state: FilterState, time_ns: int) -> FilterState:
        """Reinstate an excluded INS after its reinstatement time, but not while another fault is unresolved.

        If the stars have excluded the INS, the INS must have been consistent for that time. An INS excluded for a drift
        is reinstated without a test, because no measurement shows the end of a drift. An INS that still drifts is
        excluded again, and each exclusion doubles the reinstatement time.
        """
        exclusion = state.excluded.get(INS)
        if exclusion is None:
            return state
        is_by_stars = is_ins_excluded_by_stars(state)
        if state.unresolved_fault is not None and not is_by_stars:
            return state
        since_ns = exclusion.since_ns if exclusion.consistent_since_ns is None else exclusion.consistent_since_ns
        after_s = reinstatement_time_s(exclusion, self._return_after_s)
        if exclusion.is_self_reported:
            after_s = _CONSISTENT_FOR_S
        if (time_ns - since_ns) / SECOND_NS < after_s:
            return state
        if is_by_stars:
            # The filters were updated equally and do not differ.
            means, stack = self.all_filters_at(state.mean, state.covariance_by_source)
            state = with_changes(state, means=means, stack=stack)
        if not exclusion.is_self_reported:
            # Faults hidden by the inflated covariance show within half a slow roll period after the reinstatement.
            confirmed_ns = time_ns + round(_CONSISTENT_FOR_S * SECOND_NS)
            step = UnconfirmedStep(confirmed_ns, "the INS was reinstated", "stars")
            state = with_changes(state, unconfirmed_step=step)
        excluded = without_entry(state.excluded, INS)
        return with_changes(state, excluded=excluded, unresolved_fault=None, ins_fault_ns=time_ns)

    # ---------------------------------------------------------------------------------------------------------

    def _with_unresolved_fault(self, state: FilterState, time_ns: int, text: str) -> FilterState:
        """Return the state with an unresolved fault of the excluded INS; the reinstatement timer starts now."""
        names = state.in_use(self._subfilters.sources, time_ns)
        rotations = [state.last_innovations[name].rotation_n for name in names if name in state.last_innovations]
        covariance_n = sum((np.outer(rotation_n, rotation_n) for rotation_n in rotations), start=np.zeros((3, 3)))
        excluded = with_entry(state.excluded, INS, with_changes(state.excluded[INS], consistent_since_ns=time_ns))
        means = cleared_means(state.innovation_means, slice(None), slice(None))
        return with_changes(
            state, excluded=excluded, innovation_means=means, unresolved_fault=UnresolvedFault(text, covariance_n)
        )

    def _is_contradicted(self, state: FilterState, source: str, subfilter: int) -> bool:
        """True if this subfilter would be inconsistent with the source after one more rejection."""
        index = self._subfilters.indices[source]
        if source in state.excluded or not self._subfilters.uses[subfilter, index]:
            return False
        return bool(state.innovation_means.rejection_counts[subfilter, index] >= self._degraded_after - 1)

    def _inflate(self, stack: FloatArray, count: int, covariance_n: FloatArray, subfilter: int | None) -> None:
        add_error(stack, count, self._part, self._ins_attitude, covariance_n, subfilter)


def is_ins_excluded_by_stars(state: FilterState) -> bool:
    """True if the INS is excluded by the stars (module docstring); the filter then follows the stars.

    Only such an exclusion of the INS has a reinstatement timer that starts from a time of consistency.
    """
    exclusion = state.excluded.get(INS)
    return exclusion is not None and exclusion.consistent_since_ns is not None
