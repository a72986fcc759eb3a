"""Exclusion, monitoring and reinstatement of the ship's sources.

Star sensors that contradict the INS together are excluded together, and reinstated together once most of their offset
is gone. An offset that keeps growing is a drift of the INS, which is then excluded in their place. After a mounting
shift of a single device its mounting is estimated again, and the device is reinstated once it is consistent.

The state of an exclusion, and how it acts on the filters, is common to both estimators
(:mod:`ship_estimation.fault_detection.exclusion`). Which source is at fault, and when it is excluded, is decided by
:mod:`ship_attitude_star.ship_attitude.faults.fault_detection`; an INS whose clock steps is excluded by
:mod:`ship_attitude_star.ship_attitude.faults.ins_fault_handling`. A source that is rejected again and again is also
reinstated by :mod:`ship_attitude_star.ship_attitude.decision_effects`, with an inflated covariance.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.ship_attitude.faults.ins_fault_handling import InsFaultHandling, is_ins_excluded_by_stars
from ship_attitude_star.ship_attitude.measurements.device import Device
from ship_attitude_star.ship_attitude.model import INS, ShipStateModel, ShipSubfilters
from ship_attitude_star.ship_attitude.state import FilterState, shared_rotation
from ship_estimation.fault_detection.exclusion import (
    MAX_REMAINING_RATIO,
    ExcludedSource,
    SourceExclusion,
    evaluate_reinstatement,
    reinstatement_time_s,
    with_changes,
    with_entry,
)
from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS, cleared_means
from ship_estimation.fault_detection.subfilters import FilterInnovations, add_error, restart_from_subfilter
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray

_SHIFT_SIGMA_RATIO = 2.0
"""Standard deviation of the mounting after a mounting shift, as a ratio to the observed shift."""

_MIN_SHIFT_RAD, _MAX_SHIFT_RAD = 10.0 * ARCSEC, 3600.0 * ARCSEC
"""Minimum and maximum standard deviation of the mounting after a mounting shift, rad."""

_DRIFT_DURATION_NS = 10 * SECOND_NS
"""Time for which the offset of the INS from all stars must grow to count as a drift (half a slow roll period), ns."""

_DRIFT_SIGMAS = 3.0
"""Minimum size of half of the offset for a reinstatement, in standard deviations of the error of the other sources. A
smaller offset is not observable, because an INS without stars may itself have drifted by half of the offset."""


class ShipSourceExclusion(SourceExclusion):
    """Exclusion and reinstatement of star sensors, references and INS.

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

    subfilters: ShipSubfilters

    def __init__(self, config: ShipAttitudeConfig, model: ShipStateModel, devices: Mapping[str, Device]) -> None:
        subfilters = ShipSubfilters(config, model, devices)
        super().__init__(subfilters, subfilters.k.false_exclusion, config.gate, config.integrity)
        self.ins_fault = InsFaultHandling(config, model, subfilters)
        self._model, self._ins_attitude = model, model.slices["ins.attitude"]

    def exclude_sources(self, state: FilterState, faulty: tuple[str, ...], time_ns: int) -> tuple[FilterState, str]:
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
        exclusions, exclusion_counts, used_ns = {}, dict(state.exclusion_counts), dict(state.last_used_ns)
        for name in faulty:
            # An offset larger than any mounting shift has another cause, so the mounting is not estimated again.
            has_mounting_shift = name != INS and self._inflate_mounting(stack, state, name)
            exclusion_counts[name] = state.exclusion_counts.get(name, 0) + 1
            rotation_v = None if has_mounting_shift or name == INS else state.last_innovations[name].rotation_v
            exclusions[name] = ExcludedSource(time_ns, exclusion_counts[name], offset=rotation_v)
            used_ns.pop(name, None)
        cleared = cleared_means(state.innovation_means, slice(None), slice(None))
        state = with_changes(
            self.exclude(state, exclusions, cleared),
            means=means,
            stack=stack,
            recent_innovations=MappingProxyType({}),
            correction_sums=state.correction_sums.without_corrections(),
            exclusion_counts=MappingProxyType(exclusion_counts),
            separation_covariance_n=None,
            last_used_ns=MappingProxyType(used_ns),
        )
        are, them = ("is", "it") if len(faulty) == 1 else ("are", "them")
        remaining = ", ".join(name for name in (INS, *self.subfilters.sources) if name not in state.excluded)
        return state, f"{' and '.join(faulty)} {are} excluded: without {them} {remaining} are consistent"

    def exclude_stars(self, state: FilterState, stars: tuple[str, ...], shared: bool, time_ns: int) -> FilterState:
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

    def evaluate_reinstatement(
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
        index, means, before = self.subfilters.indices[source], state.innovation_means, state.excluded[source]
        ratio = self._remaining_offset_ratio(state, source, time_ns)
        is_observable = _DRIFT_SIGMAS * _remaining_offset_sigma(state, source, innovations) <= MAX_REMAINING_RATIO
        exclusion, is_reinstated = evaluate_reinstatement(
            before, means, index, time_ns, self._return_after_s, ratio, is_observable
        )
        if not is_reinstated:
            after_s = reinstatement_time_s(exclusion, self._return_after_s)
            state = with_changes(state, excluded=with_entry(state.excluded, source, exclusion))
            if exclusion.offset is None and not self.is_consistent(state, source):
                # After another mounting shift the mounting is estimated again from now on.
                stack = state.stack.copy()
                self._inflate_mounting(stack, state, source)
                cleared = cleared_means(means, slice(None), [index])
                state = with_changes(state, stack=stack, innovation_means=cleared)
            since_s = (time_ns - exclusion.since_ns) / SECOND_NS
            consistency = "not consistent with the others"
            if exclusion.consistent_since_ns is not None:
                consistent_s = (time_ns - exclusion.consistent_since_ns) / SECOND_NS
                consistency = f"consistent with the others for {consistent_s:.0f} s of {after_s:g} s"
            return state, f"{source} has been excluded for {since_s:.0f} s: {consistency}"
        reinstated = self._reinstated_with(state, source)
        text = f"{' and '.join(reinstated)} {'is' if len(reinstated) == 1 else 'are'} reinstated"
        return with_changes(self.reinstate(state, reinstated), unresolved_fault=None), text

    def exclude_drifting_ins(self, state: FilterState, time_ns: int) -> FilterState:
        """Return the state after a drift of the INS, which is excluded if enough other sources check one another.

        The filters restart from the subfilter without the INS, which the drift does not affect. Before this restart an
        unresolved fault is reset, and the stars excluded for that fault are reinstated.
        """
        after_reset = state if state.unresolved_fault is None else self.reset_for_ins_jump(state, time_ns)
        in_use = after_reset.in_use(self.subfilters.sources, time_ns)
        if INS in state.excluded or not self.ins_fault.can_be_excluded(in_use):
            return state
        return self.exclude_sources(after_reset, (INS,), time_ns)[0]

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
        all_stars = len(stars) >= len(self.subfilters.stars) and self.ins_fault.can_be_excluded([*stars])
        return (
            state.unresolved_fault is not None
            and all_stars
            and all(
                one.growing_since_ns is not None and time_ns - one.growing_since_ns >= _DRIFT_DURATION_NS
                for one in stars.values()
            )
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
            measured_ns = state.innovation_means.last_measured_ns
            names = [name for name in shared if measured_ns[self.subfilters.indices[name]] >= since_ns]
        along = square = 0.0
        for name in names:
            measured, offset = state.last_innovations[name], state.excluded[name].offset
            if offset is not None:
                whitened_offset = np.linalg.pinv(measured.root) @ offset
                along += float(whitened_offset @ measured.whitened)
                square += float(whitened_offset @ whitened_offset)
        return along / square if square > 0.0 else 0.0

    def _inflate_mounting(self, stack: FloatArray, state: FilterState, source: str) -> bool:
        """Inflate the covariance of a source's mounting, in place, if a mounting shift explains its last innovation.

        Returns:
            False if the innovation is larger than any mounting shift.
        """
        shift_v = _SHIFT_SIGMA_RATIO * state.last_innovations[source].rotation_v
        if not np.linalg.norm(shift_v) <= _MAX_SHIFT_RAD:
            return False
        block = self._model.blocks[f"{source}.installation"]
        covariance = np.outer(shift_v, shift_v) + _MIN_SHIFT_RAD**2 * np.eye(3)
        part = self._model.sources.index(block.source)
        add_error(stack, len(state.means), part, self._model.slices[block.name], covariance)
        return True


def _remaining_offset_sigma(state: FilterState, source: str, innovations: FilterInnovations) -> float:
    """Return the standard deviation of the remaining offset ratio due to state errors, without measurement noise."""
    offset = state.excluded[source].offset
    if offset is None:
        return 0.0
    whitened_offset = np.linalg.pinv(state.last_innovations[source].root) @ offset
    by_state, square = np.eye(3) - innovations.whitened_noise, float(whitened_offset @ whitened_offset)
    return math.sqrt(max(float(whitened_offset @ by_state @ whitened_offset), 0.0)) / square
