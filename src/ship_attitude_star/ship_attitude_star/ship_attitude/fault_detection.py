"""Fault detection and exclusion (FDE) of the ship filter, from innovations and solution separations of the subfilters.

The filters are defined in :mod:`ship_attitude_star.ship_attitude.subfilter_set`. A source is excluded if only the
subfilter without this source is consistent with all sources that the subfilter uses. An INS that drifts away from all
other sources is excluded in the same way.

A step between the INS and all stars is treated differently, because a position error rotates all stars just as a step
of the INS would. If all stars suddenly contradict the INS, the fault is unresolved, and the stars are excluded until
they are consistent with the INS again. A jump of the INS is detected from its own rates
(:mod:`ship_estimation.plausibility.ins_check`). If such a jump was reported recently, the INS is excluded instead
(:mod:`ship_attitude_star.ship_attitude.ins_fault_handling`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.comparison import ComparedMeasurement
from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.ins_fault_handling import InsFaultHandling, is_ins_excluded_by_stars
from ship_attitude_star.ship_attitude.model import Device, ShipStateModel
from ship_attitude_star.ship_attitude.state import (
    FilterState,
    RecentInnovations,
    SourceInnovation,
    UnresolvedFault,
    shared_rotation,
    with_changes,
    with_entry,
)
from ship_attitude_star.ship_attitude.subfilter_set import INS, MIN_SOURCES_FOR_PAIRS, SubfilterSet
from ship_estimation.fault_detection.common_error import COMMON_ERROR_START_SIGMAS
from ship_estimation.fault_detection.fault_isolation import (
    MAX_MEASUREMENT_AGE_NS,
    ExcludedSource,
    FaultIsolation,
    evaluate_reinstatement,
    is_consistent_with_all,
    isolate_fault,
    reinstatement_time_s,
)
from ship_estimation.fault_detection.innovation_means import (
    INITIAL_MEANS,
    cleared_means,
    initial_means,
    updated_mean,
    updated_means,
)
from ship_estimation.fault_detection.subfilters import (
    FilterInnovations,
    add_error,
    are_consistent,
    restart_from_subfilter,
    solution_separations,
    update_subfilters,
)
from ship_estimation.integrity.protection_levels import INFLATION_START_SIGMAS, separation_inflation
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray

_SHIFT_SIGMA_RATIO = 2.0
"""Standard deviation of the mounting after a mounting shift, as a ratio to the observed shift."""

_MIN_SHIFT_RAD, _MAX_SHIFT_RAD = 10.0 * ARCSEC, 3600.0 * ARCSEC
"""Minimum and maximum standard deviation of the mounting after a mounting shift, rad."""

_DRIFT_OBSERVED_NS = 3 * SECOND_NS
"""Minimum uninterrupted reception of all sources in use before a drift of the INS is detected, ns."""

_DRIFT_DURATION_NS = 10 * SECOND_NS
"""Time for which the offset of the INS from all stars must grow to count as a drift (half a slow roll period), ns."""


class FaultDetector:
    """Fault detection and exclusion with the filters of a configuration.

    Args:
        config: configuration of the node.
        model: state vector.
        devices: sources by name.

    Attributes:
        subfilters: the filters.
        ins_fault: handling of INS faults.

    Raises:
        ParameterError: there are more filters than ``integrity.max_hypotheses``.
    """

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        self._integrity, self._model = config.integrity, model
        self._degraded_after = config.gate.degraded_after
        self.subfilters = SubfilterSet(config, model, devices)
        self._sources = self.subfilters.sources
        self._indices = {name: index for index, name in enumerate(self._sources)}
        self.ins_fault = InsFaultHandling(config, model, self.subfilters)
        self._ins_attitude = model.slices["ins.attitude"]
        self._consistent_sigmas = min(INFLATION_START_SIGMAS, self.subfilters.k.false_exclusion)

    def initial_state(self, mean: FloatArray, covariance_by_source: FloatArray) -> FilterState:
        """Return the state before any measurement, with all filters at one mean and covariance.

        Args:
            mean: estimated errors, shape (n,).
            covariance_by_source: covariance by error source, shape (n_sources, n, n).
        """
        return FilterState(
            None,
            *self.ins_fault.all_filters_at(mean, covariance_by_source),
            initial_means(self.subfilters.count, len(self._sources)),
        )

    def uses(self, state: FilterState) -> NDArray[np.bool_]:
        """Return a mask of the sources that each filter uses, shape (h, s)."""
        if not state.excluded:
            return self.subfilters.uses
        excluded = np.array([name in state.excluded for name in self._sources], dtype=bool)
        used: NDArray[np.bool_] = self.subfilters.uses & ~excluded
        return used

    def update_filters(
        self,
        state: FilterState,
        predicted: FilterState,
        measurement: Measurement,
        comparison: ComparedMeasurement,
        innovations: FilterInnovations,
        accepted: NDArray[np.bool_],
    ) -> FilterState:
        """Return the state after the measurement update of all filters.

        If the measurement updates no filter, ``state`` is returned without propagation; only its innovations and timers
        are updated.

        Args:
            state: state before the measurement.
            predicted: ``state`` propagated to the time of the measurement.
            measurement: the measurement.
            comparison: the measurement compared with the main filter.
            innovations: innovations of all filters.
            accepted: True for each filter whose gate the measurement passed, shape (h,).
        """
        source, index = measurement.source, self._indices[measurement.source]
        used = self.subfilters.used_by[source] if not state.excluded else self.uses(state)[:, index]
        noise = None if used[0] else innovations.whitened_noise
        innovation_means = updated_means(
            state.innovation_means,
            index,
            innovations.whitened_innovation,
            accepted,
            measurement.time_ns,
            self.subfilters.innovation_mean_limit,
            noise,
        )
        if state.innovation_means.last_measured_ns[index] < measurement.time_ns - MAX_MEASUREMENT_AGE_NS:
            state, predicted = (
                self._with_restarted_timers(one, source, measurement.time_ns) for one in (state, predicted)
            )
        innovation = SourceInnovation(
            innovations.whitened_innovation[0], innovations.whitening_root[0], comparison.predicted_nv
        )
        last_innovations = with_entry(state.last_innovations, source, innovation)
        exclusion = state.excluded.get(source)
        # A measurement that no filter uses leaves all filters bit-identical. A source excluded for a mounting shift
        # still updates its own mounting states.
        is_update = any((used & accepted).tolist()) if exclusion is None else exclusion.offset is None
        if not is_update:
            return with_changes(state, innovation_means=innovation_means, last_innovations=last_innovations)
        updatable = self.ins_fault.updatable_states(
            state, self._updatable_states(state, source, used) & accepted[:, None]
        )
        corrections, stack = update_subfilters(predicted.stack, comparison.linear, innovations, updatable)
        recent, correction_sums = state.recent_innovations, state.correction_sums
        if used[0] and accepted[0]:
            windowed = recent[source].windowed_means if source in recent else INITIAL_MEANS
            recent = with_entry(
                recent, source, RecentInnovations(*updated_mean(windowed, innovations.whitened_innovation[0]))
            )
            if source in self.subfilters.stars and INS not in state.excluded:
                correction_sums = correction_sums.with_correction(
                    innovations, comparison.linear.jacobian, self._ins_attitude.start
                )
        means = predicted.means + corrections
        return with_changes(
            predicted,
            means=means,
            stack=stack,
            innovation_means=innovation_means,
            last_innovations=last_innovations,
            recent_innovations=recent,
            correction_sums=correction_sums,
        )

    def _updatable_states(self, state: FilterState, source: str, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask of the states that each filter may update with a source, shape (h, n).

        Args:
            state: state of the filters.
            source: name of the source.
            used: True for each filter that uses the source, shape (h,).
        """
        return (
            self.subfilters.updatable_states[source]
            if not state.excluded
            else used[:, None] | self.subfilters.own_states[source]
        )

    def _with_restarted_timers(self, state: FilterState, source: str, time_ns: int) -> FilterState:
        """Return the state with the timers of a source restarted, before its first measurement after a timeout.

        The reinstatement timer of an INS excluded by the stars restarts if all sources have timed out.
        """
        excluded = dict(state.excluded)
        if source in excluded:
            excluded[source] = replace(excluded[source], consistent_since_ns=None)
        if (
            is_ins_excluded_by_stars(state)
            and state.innovation_means.last_measured_ns.max() < time_ns - MAX_MEASUREMENT_AGE_NS
        ):
            excluded[INS] = replace(excluded[INS], consistent_since_ns=time_ns)
        received_since_ns = with_entry(state.received_since_ns, source, time_ns)
        return with_changes(state, excluded=MappingProxyType(excluded), received_since_ns=received_since_ns)

    def solution_separations(self, state: FilterState) -> tuple[FloatArray, FloatArray]:
        """Return the solution separations of the filters from the main filter.

        Returns:
            Separations about North, Up and East, rad, shape (h, 3), and the largest of each filter in standard
            deviations, shape (h,).
        """
        return solution_separations(state.means, state.stack, self._ins_attitude)

    def detect_faults(
        self, state: FilterState, source: str, innovations: FilterInnovations, is_ins_confirmed: bool, time_ns: int
    ) -> tuple[FilterState, str]:
        """Detect and isolate faults after a measurement.

        Args:
            state: state after the measurement.
            source: source of the measurement.
            innovations: innovations of all filters.
            is_ins_confirmed: True if the rates of the INS rule out a step of the INS.
            time_ns: stamp of the measurement.

        Returns:
            The state after exclusions and reinstatements, and a text about the source, which may be empty.
        """
        if self._is_all_consistent(state):
            return state, ""
        state = self.ins_fault.reinstate_ins(state, time_ns)
        if source in state.excluded:
            state, text = self._evaluate_reinstatement(state, source, innovations, time_ns)
            if source in state.excluded:
                return state, text
        if is_ins_excluded_by_stars(state):
            is_consistent = not self._is_inconsistent(state, self._sources.index(source))
            return self.ins_fault.monitor(state, innovations, is_consistent, time_ns), ""
        subfilters, uses, in_use = self.subfilters, self.uses(state), state.in_use(self._sources, time_ns)
        separations_n, separation_sigmas = self.solution_separations(state)
        candidates: Sequence[int] = subfilters.single_subfilters
        if state.excluded:
            candidates = [row for row in candidates if subfilters.names[row - 1] not in state.excluded]
        pairs = subfilters.relevant_pairs(in_use, state.excluded) if subfilters.pair_subfilters else []
        # Rejections show a step. Rates that rule out a step of the INS do not rule out a drift of the INS.
        stepped = any(state.innovation_means.rejection_counts[0].tolist())
        if is_ins_confirmed and stepped:
            candidates, pairs = (
                [row for row in rows if row not in subfilters.ins_subfilters] for rows in (candidates, pairs)
            )
        elif stepped and len(in_use) <= MIN_SOURCES_FOR_PAIRS:
            # The pair of the INS and one source and the pair of the two other sources explain a fault equally well.
            pairs = []
        threshold, after = subfilters.k.false_exclusion, self._degraded_after
        isolation = isolate_fault(
            state.innovation_means, uses, separation_sigmas, threshold, candidates, time_ns, after, pairs
        )
        # True for an error that all stars share. NaN counts as such an error.
        shared = not state.correction_sums.sigmas <= subfilters.common_threshold and INS not in state.excluded
        if not isolation.is_detected and not shared:
            return self._with_no_fault(state, in_use, separations_n, separation_sigmas, time_ns), ""
        faulty = self._faulty_sources(state, isolation)
        if state.correction_sums.sigmas > COMMON_ERROR_START_SIGMAS and not subfilters.stars.isdisjoint(faulty):
            faulty = ()  # All stars contradict the INS, so the fault is not that of single star sensors.
        if self.ins_fault.has_reported_jump(state, time_ns):
            state = with_changes(state, ins_fault_ns=time_ns)
            if INS not in faulty and not set(subfilters.ins_subfilters).isdisjoint(isolation.explaining_subfilters):
                faulty = ()  # The INS may be at fault as well: after the reported jump its axes may be rotated.
        contradicting = self._contradicting_stars(state, faulty, in_use, shared)
        against_ins = len(contradicting) > 1 or (INS in faulty and stepped)
        if against_ins and self.ins_fault.has_reported_jump(state, time_ns) and self.ins_fault.can_be_excluded(in_use):
            state, text = self._exclude(state, (INS,), time_ns)
            return self.ins_fault.with_contradiction(state, time_ns), text
        others = [name for name in in_use if name not in faulty]
        if INS in faulty and (stepped or not subfilters.can_show_ins_fault(others)):
            faulty = ()  # The fault may be a position error, which has the same effect as a fault of the INS.
        if INS in faulty and any(time_ns - state.received_since_ns[name] < _DRIFT_OBSERVED_NS for name in in_use):
            faulty = ()  # A mounting may have shifted during the timeout, so the INS is not excluded yet.
        if INS in state.excluded and len(in_use) < MIN_SOURCES_FOR_PAIRS:
            faulty = ()  # If two sources contradict each other, a fault of either explains this.
        if faulty and not set(in_use).issubset(faulty):
            return self._exclude(state, faulty, time_ns)
        unresolved = self._with_unresolved_fault(state, separations_n, separation_sigmas, contradicting)
        return self._exclude_stars(unresolved, contradicting, shared, time_ns) if contradicting else unresolved, ""

    def _is_all_consistent(self, state: FilterState) -> bool:
        """True if all sources are consistent, no source is excluded, and no covariance for an earlier fault is left."""
        if state.excluded or state.unresolved_fault is not None or state.separation_covariance_n is not None:
            return False
        # NaN is inconsistent.
        return (
            state.correction_sums.sigmas <= COMMON_ERROR_START_SIGMAS
            and is_consistent_with_all(state.innovation_means, self._degraded_after)
            and all(one.largest_sigmas <= INFLATION_START_SIGMAS for one in state.recent_innovations.values())
            and are_consistent(state.means, state.stack, self._ins_attitude, self._consistent_sigmas)
        )

    def _with_no_fault(
        self,
        state: FilterState,
        in_use: list[str],
        separations_n: FloatArray,
        separation_sigmas: FloatArray,
        time_ns: int,
    ) -> FilterState:
        """Return the state if no fault is detected, with a covariance that covers large solution separations.

        A drifting source separates the main filter from the subfilter without the source long before the exclusion. A
        mounting shift of a few standard deviations separates these filters within a second. Even earlier the recent
        innovations of the source are inconsistent, so the covariance is inflated for these innovations too.
        """
        if INS not in state.excluded and self.ins_fault.can_be_excluded(in_use):
            separation_sigmas = separation_sigmas.copy()
            for row, source in enumerate(self._sources, start=1):
                if source in in_use and source in state.recent_innovations:
                    separation_sigmas[row] = np.maximum(
                        separation_sigmas[row], state.recent_innovations[source].largest_sigmas
                    )
        # NaN counts as large.
        within = all(sigmas <= INFLATION_START_SIGMAS for sigmas in separation_sigmas.tolist())
        correction_sums = state.correction_sums.with_unresolved_error(
            time_ns, round(self._integrity.return_after_s * SECOND_NS)
        )
        shared_error = correction_sums.unresolved
        is_covered = state.unresolved_fault is not None or state.separation_covariance_n is not None
        if within and not is_covered and shared_error is None:
            return state
        separation_covariance_n = None if within else separation_inflation(separations_n, separation_sigmas)
        if shared_error is not None:
            shared_n = np.diag(shared_error.variance)
            separation_covariance_n = (
                shared_n if separation_covariance_n is None else separation_covariance_n + shared_n
            )
        return with_changes(
            state,
            unresolved_fault=None,
            separation_covariance_n=separation_covariance_n,
            correction_sums=correction_sums,
        )

    def reset_for_ins_jump(self, state: FilterState, time_ns: int) -> FilterState:
        """Return the state after a reported jump of the INS, which may have caused the faults detected so far.

        If a fault is unresolved, all filters restart from the main filter, because their differences are due to that
        fault. Detected faults are then reset. If the stars have excluded the INS, its reinstatement timer restarts
        instead.
        """
        if state.unresolved_fault is not None:
            means, stack = self.ins_fault.all_filters_at(state.mean, state.covariance_by_source)
            state = with_changes(state, means=means, stack=stack)
        if is_ins_excluded_by_stars(state):
            return self.ins_fault.with_contradiction(state, time_ns)
        return self._reset_faults(state)

    def exclude_drifting_ins(self, state: FilterState, time_ns: int) -> FilterState:
        """Return the state after a drift of the INS, which is excluded if enough other sources check one another.

        The filters restart from the subfilter without the INS, which the drift does not affect. Before this restart an
        unresolved fault is reset, and the stars excluded for that fault are reinstated.
        """
        after_reset = state if state.unresolved_fault is None else self.reset_for_ins_jump(state, time_ns)
        if INS in state.excluded or not self.ins_fault.can_be_excluded(after_reset.in_use(self._sources, time_ns)):
            return state
        return self._exclude(after_reset, (INS,), time_ns)[0]

    def restart_subfilters(self, state: FilterState) -> FilterState:
        """Return the state with all filters restarted from the main filter and faults reset."""
        means, stack = self.ins_fault.all_filters_at(state.mean, state.covariance_by_source)
        return self._reset_faults(with_changes(state, means=means, stack=stack))

    def _reset_faults(self, state: FilterState) -> FilterState:
        """Return the state without detected faults; only the INS and sources with a mounting shift stay excluded.

        An unresolved fault stays if the stars have excluded the INS. All innovation means are cleared.
        """
        remaining = {name: exclusion for name, exclusion in state.excluded.items() if exclusion.offset is None}
        innovation_means = cleared_means(state.innovation_means, slice(None), slice(None))
        unresolved_fault = state.unresolved_fault if is_ins_excluded_by_stars(state) else None
        return with_changes(
            state,
            excluded=MappingProxyType(remaining),
            innovation_means=innovation_means,
            recent_innovations=MappingProxyType({}),
            correction_sums=state.correction_sums.without_corrections(),
            unresolved_fault=unresolved_fault,
            separation_covariance_n=None,
        )

    # -- exclusion and reinstatement ------------------------------------------------------------------------

    def _faulty_sources(self, state: FilterState, isolation: FaultIsolation) -> tuple[str, ...]:
        """Return the isolated sources; empty without an isolated source.

        If several subfilters explain the fault, and exactly one of them excludes only sources that were excluded
        before, the fault is attributed to the sources that this subfilter excludes.
        """
        excluded_sources = self.subfilters.excluded_sources
        known = [
            row
            for row in isolation.explaining_subfilters
            if state.exclusion_counts.keys() >= set(excluded_sources[row - 1])
        ]
        row = known[0] if len(known) == 1 else isolation.subfilter
        return () if row is None else excluded_sources[row - 1]

    def _exclude(self, state: FilterState, faulty: tuple[str, ...], time_ns: int) -> tuple[FilterState, str]:
        """Exclude sources; all filters restart from the subfilter without these sources.

        Args:
            state: state after the measurement.
            faulty: the sources to exclude.
            time_ns: stamp of the measurement.

        Returns:
            The state, and a text that names the excluded and the remaining sources.
        """
        row, rows = self.subfilters.excluded_sources.index(faulty) + 1, len(state.means)
        means = np.tile(state.means[row], (rows, 1))
        stack = restart_from_subfilter(state.stack, rows, row)
        excluded, exclusion_counts, used_ns = (
            dict(state.excluded),
            dict(state.exclusion_counts),
            dict(state.last_used_ns),
        )
        for name in faulty:
            # An offset larger than any mounting shift has another cause, so the mounting is not estimated again.
            has_mounting_shift = name != INS and self._mounting_shift(state, name) is not None
            if has_mounting_shift:
                self._inflate_mounting(stack, state, name)
            exclusion_counts[name] = state.exclusion_counts.get(name, 0) + 1
            rotation_v = None if has_mounting_shift or name == INS else state.last_innovations[name].rotation_v
            excluded[name] = ExcludedSource(time_ns, exclusion_counts[name], offset=rotation_v)
            used_ns.pop(name, None)
        state = with_changes(
            state,
            means=means,
            stack=stack,
            innovation_means=cleared_means(state.innovation_means, slice(None), slice(None)),
            recent_innovations=MappingProxyType({}),
            correction_sums=state.correction_sums.without_corrections(),
            excluded=MappingProxyType(excluded),
            exclusion_counts=MappingProxyType(exclusion_counts),
            unresolved_fault=None,
            separation_covariance_n=None,
            last_used_ns=MappingProxyType(used_ns),
        )
        are, them = ("is", "it") if len(faulty) == 1 else ("are", "them")
        remaining = ", ".join(name for name in (INS, *self._sources) if name not in excluded)
        return state, f"{' and '.join(faulty)} {are} excluded: without {them} {remaining} are consistent"

    def _exclude_stars(
        self, state: FilterState, stars: tuple[str, ...], shared: bool, time_ns: int
    ) -> FilterState:
        """Exclude all star sensors, which contradict the INS, for a fault that is not isolated.

        No mounting shift is known, so the mountings are not estimated again. All filters restart from the main filter.
        If the sum of the star corrections shows an error that the stars share, these corrections are removed before the
        restart.
        """
        offset_n = shared_rotation([state.last_innovations[name] for name in stars])
        mean, covariance_by_source = state.mean, state.covariance_by_source
        if shared:
            correction_sums = state.correction_sums
            offset_n = offset_n + correction_sums.correction_n
            mean, covariance_by_source = mean.copy(), covariance_by_source.copy()
            mean[self._ins_attitude] -= correction_sums.correction_n
            self.ins_fault.inflate_ins_attitude(covariance_by_source, np.diag(correction_sums.variance))
        excluded = {
            name: ExcludedSource(time_ns, offset=state.last_innovations[name].predicted_nv.T @ offset_n, is_shared=True)
            for name in stars
        }
        means, stack = self.ins_fault.all_filters_at(mean, covariance_by_source)
        return with_changes(
            state,
            means=means,
            stack=stack,
            excluded=MappingProxyType({**state.excluded, **excluded}),
            correction_sums=state.correction_sums.without_corrections(),
        )

    def _evaluate_reinstatement(
        self, state: FilterState, source: str, innovations: FilterInnovations, time_ns: int
    ) -> tuple[FilterState, str]:
        """Evaluate the reinstatement of an excluded source after one of its measurements.

        If the INS has drifted away from all stars, the INS is excluded instead (:meth:`exclude_drifting_ins`).

        Returns:
            The state, in which the source may be reinstated, and a text about the source.
        """
        state = self._with_offset_growth(state, source, time_ns)
        if self._is_ins_drift_sustained(state, source, time_ns):
            return self.exclude_drifting_ins(state, time_ns), "ins is excluded: it drifts away from all stars"
        index, exclusion = self._sources.index(source), state.excluded[source]
        after_s = self._integrity.return_after_s
        remaining_ratio = self._remaining_offset_ratio(state, source, time_ns)
        sigma = _remaining_offset_sigma(state, source, innovations)
        exclusion, is_reinstated = evaluate_reinstatement(
            exclusion, state.innovation_means, index, time_ns, after_s, remaining_ratio, sigma
        )
        after_s = reinstatement_time_s(exclusion, after_s)
        if not is_reinstated:
            state = with_changes(state, excluded=with_entry(state.excluded, source, exclusion))
            if exclusion.offset is None and self._is_inconsistent(state, index):
                # After another mounting shift the mounting is estimated again from now on.
                stack = state.stack.copy()
                self._inflate_mounting(stack, state, source)
                state = with_changes(
                    state, stack=stack, innovation_means=cleared_means(state.innovation_means, slice(None), [index])
                )
            since_s = (time_ns - exclusion.since_ns) / SECOND_NS
            consistency = "not consistent with the others"
            if exclusion.consistent_since_ns is not None:
                consistent_s = (time_ns - exclusion.consistent_since_ns) / SECOND_NS
                consistency = f"consistent with the others for {consistent_s:.0f} s of {after_s:g} s"
            return state, f"{source} has been excluded for {since_s:.0f} s: {consistency}"
        reinstated = self._reinstated_with(state, source)
        means = cleared_means(state.innovation_means, slice(None), [self._indices[name] for name in reinstated])
        remaining = {name: one for name, one in state.excluded.items() if name not in reinstated}
        are = "is" if len(reinstated) == 1 else "are"
        text = f"{' and '.join(reinstated)} {are} reinstated"
        excluded = MappingProxyType(remaining)
        return with_changes(state, innovation_means=means, excluded=excluded, unresolved_fault=None), text

    def _with_offset_growth(self, state: FilterState, source: str, time_ns: int) -> FilterState:
        """Return the state with the stamp since which the offset of an excluded source is larger than at its exclusion.

        The larger offset must have the same direction.
        """
        exclusion, last = state.excluded[source], state.last_innovations[source]
        if exclusion.offset is None:
            return state
        before = np.linalg.pinv(last.root) @ exclusion.offset
        change = last.whitened - before
        # Each of the two offsets contains measurement noise, hence the factor 2.
        is_farther = change @ change > 2.0 * self.subfilters.innovation_mean_limit and change @ before > 0.0
        since_ns = exclusion.growing_since_ns
        since_ns = None if not is_farther else time_ns if since_ns is None else since_ns
        if since_ns == exclusion.growing_since_ns:
            return state
        exclusion = replace(exclusion, growing_since_ns=since_ns)
        return with_changes(state, excluded=with_entry(state.excluded, source, exclusion))

    def _is_ins_drift_sustained(self, state: FilterState, source: str, time_ns: int) -> bool:
        """True if the INS has drifted away, for ``_DRIFT_DURATION_NS``, from all stars that were excluded together.

        Other errors do not let the offset grow so long. The offset of a constant star error changes only by the random
        walk of the INS, which the covariance contains. The offset of a clock error oscillates with the ship's motion.
        """
        since_ns = state.excluded[source].since_ns
        stars = {name: one for name, one in state.excluded.items() if one.since_ns == since_ns and name != INS}
        if (
            state.unresolved_fault is None
            or len(stars) < len(self.subfilters.stars)
            or not self.ins_fault.can_be_excluded([*stars])
        ):
            return False
        return all(
            one.growing_since_ns is not None and time_ns - one.growing_since_ns >= _DRIFT_DURATION_NS
            for one in stars.values()
        )

    @staticmethod
    def _reinstated_with(state: FilterState, source: str) -> list[str]:
        """Return the sources to reinstate: ``source``, and consistent sources that were excluded together with it.

        Star sensors that were excluded together check one another. The offset of a single sensor cannot be
        distinguished from a drift of the INS.
        """
        own = state.excluded[source]
        if own.offset is None:
            return [source]
        return [
            name
            for name, one in state.excluded.items()
            if name == source
            or (one.offset is not None and one.since_ns == own.since_ns and one.consistent_since_ns is not None)
        ]

    def _remaining_offset_ratio(self, state: FilterState, source: str, time_ns: int) -> float:
        """Return the ratio of an excluded source's current offset to its offset at the exclusion; 0 without an offset.

        If all star sensors were excluded for a shared error, the ratio is computed from the offsets of these sensors
        together. A single sensor hardly measures the rotation about its line of sight, so its ratio would change as the
        INS drifts.
        """
        own, since_ns = state.excluded[source], time_ns - MAX_MEASUREMENT_AGE_NS
        names = [source]
        if own.is_shared:
            shared = [name for name, one in state.excluded.items() if one.is_shared and one.since_ns == own.since_ns]
            names = [
                name for name in shared if state.innovation_means.last_measured_ns[self._indices[name]] >= since_ns
            ]
        along = square = 0.0
        for name in names:
            measured, offset = state.last_innovations[name], state.excluded[name].offset
            if offset is not None:
                whitened_offset = np.linalg.pinv(measured.root) @ offset
                along += float(whitened_offset @ measured.whitened)
                square += float(whitened_offset @ whitened_offset)
        return along / square if square > 0.0 else 0.0

    def _is_inconsistent(self, state: FilterState, index: int) -> bool:
        """True if the main filter's innovations of a source are inconsistent."""
        means = state.innovation_means
        return not (means.excess[0, index] <= 1.0 and means.rejection_counts[0, index] < self._degraded_after)

    def _with_unresolved_fault(
        self,
        state: FilterState,
        separations_n: FloatArray,
        separation_sigmas: FloatArray,
        contradicting: tuple[str, ...],
    ) -> FilterState:
        """Return the state with an unresolved fault, whose covariance covers rejected innovations and separations.

        Args:
            state: state after the measurement.
            separations_n: solution separations about North, Up and East, rad, shape (h, 3).
            separation_sigmas: largest solution separation of each filter in standard deviations, shape (h,).
            contradicting: the star sensors, if all of them contradict the INS; else empty.
        """
        vectors = [
            innovation.rotation_n
            for name, innovation in state.last_innovations.items()
            if state.consecutive_rejections.get(name, 0)
        ]
        vectors += [vector for vector, size in zip(separations_n, separation_sigmas, strict=True) if size > 1.0]
        if state.correction_sums.sigmas > COMMON_ERROR_START_SIGMAS:
            vectors.append(state.correction_sums.error_n)
        covariance_n = sum((np.outer(vector, vector) for vector in vectors), start=np.zeros((3, 3)))
        if contradicting:
            text = f"{', '.join(contradicting)} {'are' if len(contradicting) > 1 else 'is'} rejected: the INS and all "
            text += "stars contradict each other"
        else:
            text = "the sources contradict each other; the faulty source is not isolated"
        return with_changes(state, unresolved_fault=UnresolvedFault(text, covariance_n), separation_covariance_n=None)

    def _contradicting_stars(
        self, state: FilterState, faulty: tuple[str, ...], in_use: list[str], shared: bool
    ) -> tuple[str, ...]:
        """Return all star sensors in use if each contradicts the main filter or their corrections show a shared error.

        Otherwise an empty tuple is returned.

        Args:
            state: state after the measurement.
            faulty: the isolated sources.
            in_use: sources in use.
            shared: True if the sum of the star corrections exceeds its threshold.
        """
        received = [name for name in in_use if name in self.subfilters.stars]
        if shared:
            return tuple(received)
        is_rejected = state.innovation_means.rejection_counts[0] >= self._degraded_after
        contradicting = [name for name in received if name in faulty or is_rejected[self._sources.index(name)]]
        return tuple(received) if received and len(contradicting) == len(received) else ()

    def _mounting_shift(self, state: FilterState, source: str) -> FloatArray | None:
        """Return the standard deviation of a mounting shift that explains a source's last innovation.

        Returns:
            Rotation vector in the device frame, rad, shape (3,); None if the vector is longer than any mounting shift.
        """
        shift_v = _SHIFT_SIGMA_RATIO * state.last_innovations[source].rotation_v
        return shift_v if np.linalg.norm(shift_v) <= _MAX_SHIFT_RAD else None

    def _inflate_mounting(self, stack: FloatArray, state: FilterState, source: str) -> None:
        """Inflate the covariance of a source's mounting, in place, if a mounting shift explains its last innovation."""
        shift_v = self._mounting_shift(state, source)
        if shift_v is not None:
            block = self._model.blocks[f"{source}.installation"]
            covariance = np.outer(shift_v, shift_v) + _MIN_SHIFT_RAD**2 * np.eye(3)
            part = self._model.sources.index(block.source)
            add_error(stack, len(state.means), part, self._model.slices[block.name], covariance)


def _remaining_offset_sigma(state: FilterState, source: str, innovations: FilterInnovations) -> float:
    """Return the standard deviation of the remaining offset ratio due to state errors, without measurement noise."""
    offset = state.excluded[source].offset
    if offset is None:
        return 0.0
    whitened_offset = np.linalg.pinv(state.last_innovations[source].root) @ offset
    by_state = np.eye(3) - innovations.whitened_noise
    return math.sqrt(max(float(whitened_offset @ by_state @ whitened_offset), 0.0)) / float(
        whitened_offset @ whitened_offset
    )
