"""Fault detection and exclusion (FDE) of the ship filter, from innovations and solution separations of the subfilters.

The filters are defined in :mod:`ship_attitude_star.ship_attitude.model`. A source is excluded if only
the subfilter without this source is consistent with all sources that the subfilter uses. An INS that drifts away from
all other sources is excluded in the same way.

A step between the INS and all stars is treated differently, because a position error rotates all stars just as a step
of the INS would. If all stars suddenly contradict the INS, the fault is unresolved, and the stars are excluded until
they are consistent with the INS again. A jump of the INS is detected from its own rates
(:mod:`ship_estimation.plausibility.ins_check`). If such a jump was reported recently, the INS is excluded instead
(:mod:`ship_attitude_star.ship_attitude.faults.ins_fault_handling`).
"""

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.faults.ins_fault_handling import is_ins_excluded_by_stars
from ship_attitude_star.ship_attitude.faults.source_exclusion import ShipSourceExclusion
from ship_attitude_star.ship_attitude.measurements.device import ComparedMeasurement
from ship_attitude_star.ship_attitude.model import INS, MIN_SOURCES_FOR_PAIRS
from ship_attitude_star.ship_attitude.state import FilterState, RecentInnovations, SourceInnovation
from ship_estimation.fault_detection.common_error import COMMON_ERROR_START_SIGMAS
from ship_estimation.fault_detection.exclusion import UnresolvedFault, with_changes, with_entry
from ship_estimation.fault_detection.isolation import (
    INITIAL_MEANS,
    MAX_MEASUREMENT_AGE_NS,
    FaultIsolation,
    initial_means,
    is_consistent_with_all,
    updated_mean,
    updated_means,
)
from ship_estimation.fault_detection.subfilters import (
    FilterInnovations,
    are_consistent,
    solution_separations,
    update_subfilters,
)
from ship_estimation.integrity.protection_levels import INFLATION_START_SIGMAS, separation_inflation
from ship_estimation.kalman.rts_smoother import GaussianEstimate, StateUpdate
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray

_DRIFT_OBSERVED_NS = 3 * SECOND_NS
"""Minimum uninterrupted reception of all sources in use before a drift of the INS is detected, ns."""


class ShipFaultDetector(ShipSourceExclusion):
    """Fault detection and exclusion with the filters of a configuration.

    Attributes:
        records_updates: True to record in the state the update by each accepted measurement, for smoothing. The
            smoothing core records the changes of the INS.
    """

    records_updates = False

    def initial_state(self, mean: FloatArray, covariance_by_source: FloatArray) -> FilterState:
        """Return the state before any measurement, with all filters at one mean and covariance.

        Args:
            mean: estimated errors, shape (n,).
            covariance_by_source: covariance by error source, shape (n_sources, n, n).
        """
        return FilterState(
            None,
            *self.ins_fault.all_filters_at(mean, covariance_by_source),
            innovation_means=initial_means(self.subfilters.count, len(self.subfilters.sources)),
        )

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
        source, time_ns, whitened = measurement.source, measurement.time_ns, innovations.whitened_innovation
        index, limit = self.subfilters.indices[source], self.subfilters.innovation_mean_limit
        used = self.subfilters.used_by[source] if not state.excluded else self.uses(state)[:, index]
        noise = None if used[0] else innovations.whitened_noise
        innovation_means = updated_means(state.innovation_means, index, whitened, accepted, time_ns, limit, noise)
        if state.innovation_means.last_measured_ns[index] < time_ns - MAX_MEASUREMENT_AGE_NS:
            received_since_ns = with_entry(state.received_since_ns, source, time_ns)
            state, predicted = (
                with_changes(self.restart_timers(one, (source,), time_ns), received_since_ns=received_since_ns)
                for one in (state, predicted)
            )
        innovation = SourceInnovation(whitened[0], innovations.whitening_root[0], comparison.predicted_nv)
        exclusion = state.excluded.get(source)
        # A measurement that no filter uses leaves all filters bit-identical. A source excluded for a mounting shift
        # still updates its own mounting states.
        is_update = any((used & accepted).tolist()) if exclusion is None else exclusion.offset is None
        if not is_update:
            last_innovations = with_entry(state.last_innovations, source, innovation)
            return with_changes(state, innovation_means=innovation_means, last_innovations=last_innovations)
        recent, correction_sums = state.recent_innovations.get(source), state.correction_sums
        if used[0] and accepted[0]:
            windowed = INITIAL_MEANS if recent is None else recent.windowed_means
            recent = RecentInnovations(*updated_mean(windowed, whitened[0]))
            if source in self.subfilters.stars and INS not in state.excluded:
                correction_sums = correction_sums.with_correction(
                    innovations, comparison.linear.jacobian, self._ins_attitude.start
                )
        updatable = self.subfilters.updatable_states[source]
        if state.excluded:
            updatable = used[:, None] | self.subfilters.own_states[source]
            updatable = self.ins_fault.updatable_states(state, updatable)
        updatable = updatable & accepted[:, None]
        corrections, stack = update_subfilters(predicted.stack, comparison.linear, innovations, updatable)
        after = with_changes(
            predicted,
            means=predicted.means + corrections,
            stack=stack,
            innovation_means=innovation_means,
            last_innovations=with_entry(state.last_innovations, source, innovation),
            recent_innovations=(
                state.recent_innovations if recent is None else with_entry(state.recent_innovations, source, recent)
            ),
            correction_sums=correction_sums,
        )
        if not self.records_updates:
            return after
        leads_back = exclusion is None and not is_ins_excluded_by_stars(state)
        before, now = (GaussianEstimate(one.mean, one.covariance) for one in (predicted, after))
        return with_changes(after, last_update=StateUpdate(before, now, leads_back))

    def is_ins_confirmed(self, state: FilterState, rates_ns: int | None) -> bool:
        """True if the rates of the INS rule out a step: rates are available, and no jump was reported recently."""
        return rates_ns is not None and not self.ins_fault.has_reported_jump(state, rates_ns)

    def detect_faults(
        self, state: FilterState, source: str, innovations: FilterInnovations, rates_ns: int | None, time_ns: int
    ) -> tuple[FilterState, str]:
        """Detect and isolate faults after a measurement.

        Args:
            state: state after the measurement.
            source: source of the measurement.
            innovations: innovations of all filters.
            rates_ns: stamp of the INS attitude with rates that is matched to the measurement; None without rates.
            time_ns: stamp of the measurement.

        Returns:
            The state after exclusions and reinstatements, and a text about the source, which may be empty.
        """
        if self._is_all_consistent(state):
            return state, ""
        is_ins_confirmed = self.is_ins_confirmed(state, rates_ns)
        state = self.ins_fault.reinstate_ins(state, time_ns)
        if source in state.excluded:
            state, text = self.evaluate_reinstatement(state, source, innovations, time_ns)
            if source in state.excluded:
                return state, text
        if is_ins_excluded_by_stars(state):
            return self.ins_fault.monitor(state, innovations, self.is_consistent(state, source), time_ns), ""
        subfilters, in_use = self.subfilters, state.in_use(self.subfilters.sources, time_ns)
        separations_n, separation_sigmas = solution_separations(state.means, state.stack, self._ins_attitude)
        candidates = self.candidates(state)
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
        isolation = self.isolate(state, separation_sigmas, candidates, time_ns, pairs)
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
            state, text = self.exclude_sources(state, (INS,), time_ns)
            return self.ins_fault.with_contradiction(state, time_ns), text
        others = [name for name in in_use if name not in faulty]
        if INS in faulty and (stepped or not subfilters.can_show_ins_fault(others)):
            faulty = ()  # The fault may be a position error, which has the same effect as a fault of the INS.
        if INS in faulty and any(time_ns - state.received_since_ns[name] < _DRIFT_OBSERVED_NS for name in in_use):
            faulty = ()  # A mounting may have shifted during the timeout, so the INS is not excluded yet.
        if INS in state.excluded and len(in_use) < MIN_SOURCES_FOR_PAIRS:
            faulty = ()  # If two sources contradict each other, a fault of either explains this.
        if faulty and not set(in_use).issubset(faulty):
            return self.exclude_sources(state, faulty, time_ns)
        unresolved = self._with_unresolved_fault(state, separations_n, separation_sigmas, contradicting)
        if contradicting:
            return self.exclude_stars(unresolved, contradicting, shared, time_ns), ""
        return unresolved, ""

    def _is_all_consistent(self, state: FilterState) -> bool:
        """True if all sources are consistent, no source is excluded, and no covariance for an earlier fault is left."""
        if state.excluded or state.unresolved_fault is not None or state.separation_covariance_n is not None:
            return False
        consistent_sigmas = min(INFLATION_START_SIGMAS, self._threshold_sigmas)
        # NaN is inconsistent.
        return (
            state.correction_sums.sigmas <= COMMON_ERROR_START_SIGMAS
            and all(one.largest_sigmas <= INFLATION_START_SIGMAS for one in state.recent_innovations.values())
            and is_consistent_with_all(state.innovation_means, self._degraded_after)
            and are_consistent(state.means, state.stack, self._ins_attitude, consistent_sigmas)
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
            for row, source in enumerate(self.subfilters.sources, start=1):
                if source in in_use and source in state.recent_innovations:
                    largest_sigmas = state.recent_innovations[source].largest_sigmas
                    separation_sigmas[row] = np.maximum(separation_sigmas[row], largest_sigmas)
        # NaN counts as large.
        within = all(sigmas <= INFLATION_START_SIGMAS for sigmas in separation_sigmas.tolist())
        correction_sums = state.correction_sums.with_unresolved_error(time_ns, round(self._return_after_s * SECOND_NS))
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
        contradicting = [name for name in received if name in faulty or is_rejected[self.subfilters.indices[name]]]
        return tuple(received) if received and len(contradicting) == len(received) else ()
