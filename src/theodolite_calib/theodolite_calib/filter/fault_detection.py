"""Fault detection and exclusion (FDE) for the theodolite: isolate, exclude, monitor and reinstate sources.

A source is excluded if the other sources are consistent without it (:mod:`ship_estimation.fault_detection`). A drone is
also excluded if its baseline jumps by more than its flight allows. If no faulty source is isolated, the fault is
unresolved, and the pointing covariance covers the disagreement.

An excluded source is monitored, and reinstated after it has been consistent for ``return_after_s``. For a drone
without other beacons in use, or with a jumped baseline, consistency counts only if the fault would be detectable. The
standard deviation of the predicted beacon must then be small against the residual that the fault would cause. After
the baseline has jumped back, consistency always counts.
"""

from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from ship_estimation.fault_detection.exclusion import (
    ExcludedSource,
    FaultState,
    SourceExclusion,
    UnresolvedFault,
    evaluate_reinstatement,
    with_consistency,
    with_entry,
)
from ship_estimation.fault_detection.isolation import (
    CONSISTENT_RATIO,
    FIELDS_BY_SUBFILTER,
    MAX_MEASUREMENT_AGE_NS,
    cleared_means,
    initial_means,
    updated_means,
)
from ship_estimation.fault_detection.subfilters import FilterInnovations
from ship_estimation.innovations.gates import GateConfig, chi_square_gate
from ship_estimation.integrity.protection_levels import IntegrityConfig
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import FloatArray
from theodolite_calib.filter.subfilters import (
    AXIS_SOURCES,
    BEACON_PREFIX,
    ENCODER,
    SHIP,
    TELESCOPE,
    AxisSubfilters,
    SubfilterInnovations,
)
from theodolite_calib.samples.stream_consistency import StreamConsistency
from theodolite_calib.samples.tracks import BaselineJump

_SAME_JUMP_NS = SECOND_NS
"""Jumps of one baseline within this time count as one jump, ns."""
_JUMP_REVERSED_SIGMAS = 4.0
"""A baseline counts as returned if the sum of its jumps is below this many standard deviations."""
_DETECTABLE_SIGMAS = 5.0
"""Ratio of a residual to the standard deviation of the predicted beacon above which the residual is detectable."""
_COMMON_DRIFT_SIGMAS, _COMMON_DRIFT_COSINE = 2.0, 0.7
"""Beacons drift together if each innovation mean exceeds the first value (standard deviations), and the cosine of the
angle between any two means exceeds the second value."""
_DRIFT_INDICATION_RATIO = 0.3
"""Ratio of the chi² of an innovation mean to its limit above which the beacons indicate a drift of the ship's attitude.

The ship's attitude is excluded only if it also departs from the integral of its rates."""
_UNRESOLVED_TEXT = "unresolved fault: lights are inconsistent with encoders and ship's attitude"


@dataclass(frozen=True, kw_only=True)
class AxisExclusion(ExcludedSource):
    """Excluded source, with the reason of its exclusion.

    Attributes:
        reason: reason, as text.
        rejected_residual_m: largest residual component at the exclusion, on the detector, m; 0 if the baseline jumped.
        jump_sum_n: sum of the jumps of the baseline (North, Up, East), m, shape (3,); zeros without a jump or after a
            jump back.
        jump_sum_sigma_m: standard deviation of ``jump_sum_n``, m.
        last_jump_ns: stamp of the last jump, ns.
    """

    reason: str
    rejected_residual_m: float = 0.0
    jump_sum_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    jump_sum_sigma_m: float = 0.0
    last_jump_ns: int = 0


@dataclass(frozen=True, kw_only=True)
class AxisFaultState(FaultState):
    """State of fault detection and exclusion.

    Attributes:
        excluded: excluded sources by name.
        known_jumps_ns: reinstated source → stamp up to which jumps of the drone's baseline are ignored.
    """

    excluded: Mapping[str, AxisExclusion] = field(default_factory=lambda: MappingProxyType({}))
    known_jumps_ns: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))


def initial_fault_state(subfilters: AxisSubfilters) -> AxisFaultState:
    """Return the initial state, without excluded sources and unresolved faults."""
    return AxisFaultState(innovation_means=initial_means(subfilters.count, len(subfilters.sources)))


def isolate_step_fault(
    source: str, explaining_sources: Set[str], streams: StreamConsistency, offset_rad: float
) -> str | None:
    """Return the faulty source of a sudden contradiction between beacons and prediction; None if not isolated.

    The telescope is faulty if no candidate source can have made the step.

    Args:
        source: source that the subfilters isolate: encoders or ship's attitude.
        explaining_sources: sources whose fault explains the contradiction: if one is excluded, the others are
            consistent.
        streams: largest steps of the two streams since the last accepted sighting.
        offset_rad: offset of the beacons on the sky, rad.
    """
    if streams.is_ship_unreliable:
        return SHIP if SHIP in explaining_sources else None
    steps = {ENCODER: streams.encoder, SHIP: streams.ship}
    stepped = [name for name, step in steps.items() if step is not None and step.is_detected(offset_rad)]
    if stepped:
        return stepped[0] if len(stepped) == 1 and stepped[0] in explaining_sources else source
    candidate_steps = [steps[name] for name in {source, *explaining_sources} & steps.keys()]
    is_none_faulty = all(step is not None and step.is_ruled_out(offset_rad) for step in candidate_steps)
    return TELESCOPE if is_none_faulty else source


def isolate_drift_fault(
    source: str | None, explaining_sources: Set[str], is_common: bool, has_ship_drifted: bool | None
) -> str | None:
    """Return the faulty source of a drift of accepted beacons; None if not isolated.

    If all beacons drift together, the encoders or the ship's attitude drift, because two drones do not drift together.
    The rates of the ship show whether the ship's attitude drifts. If the beacons drift differently, and both an axis
    source and a drone explain the drift, no source is isolated.

    Args:
        source: source that the subfilters isolate, or None.
        explaining_sources: sources whose fault explains the drift: if one is excluded, the others are consistent.
        is_common: True if all beacons drift together.
        has_ship_drifted: True if the ship's attitude has departed from the integral of its rates; None if unknown.
    """
    axis_sources = explaining_sources & {ENCODER, SHIP}
    if has_ship_drifted is not None:
        axis_sources = axis_sources & {SHIP if has_ship_drifted else ENCODER}
    if not axis_sources:
        return source
    if len(axis_sources) == 1 and (is_common or has_ship_drifted or source in AXIS_SOURCES):
        return next(iter(axis_sources))
    return source if source in AXIS_SOURCES else None


class AxisFaultDetector(SourceExclusion):
    """Fault detector for the sources of a configuration, from the innovations in all filters.

    Args:
        subfilters: subfilters.
        gate: gate of the beacons.
        integrity: reinstatement time.
    """

    def __init__(self, subfilters: AxisSubfilters, gate: GateConfig, integrity: IntegrityConfig) -> None:
        super().__init__(subfilters, subfilters.k.false_exclusion, gate, integrity)
        self._beacon_gate = chi_square_gate(gate.probability, 2)

    def update_means(
        self,
        fault_state: AxisFaultState,
        names: tuple[str, ...],
        innovations: SubfilterInnovations,
        is_used: bool,
        time_ns: int,
    ) -> AxisFaultState:
        """Update the innovation means with an accepted or rejected sighting of beacons that are not excluded."""
        beacons = [self.subfilters.indices[BEACON_PREFIX + name] for name in names]
        by_row = np.concatenate([[is_used], innovations.accepted])[:, None]
        uses = self.subfilters.uses[:, beacons]
        accepted = np.where(uses, by_row, innovations.beacon_nis <= self._beacon_gate)
        whitened, limit = innovations.whitened_innovation, self.subfilters.innovation_mean_limit
        means = updated_means(fault_state.innovation_means, beacons, whitened, accepted, time_ns, limit)
        return replace(fault_state, innovation_means=means)

    def isolate_source(
        self, fault_state: AxisFaultState, separations: FloatArray, time_ns: int
    ) -> tuple[bool, str | None, Set[str]]:
        """Return True if a fault is detected, the isolated source or None, and all sources that explain the fault.

        Args:
            fault_state: state after the sighting.
            separations: solution separation of each subfilter in standard deviations, shape (h - 1,).
            time_ns: time of the sighting.
        """
        names, candidates = self.subfilters.names, self.candidates(fault_state)
        all_separations = np.concatenate([[0.0], separations])
        isolation = self.isolate(fault_state, all_separations, candidates, time_ns)
        explaining = {names[row - 1] for row in isolation.explaining_subfilters}
        if not isolation.is_detected or isolation.subfilter is not None:
            source = None if isolation.subfilter is None else names[isolation.subfilter - 1]
            return isolation.is_detected, source, explaining
        # Encoders and ship's attitude have similar effects on the beacons, so both subfilters may explain one fault.
        # One of the two is faulty if it is isolated when the other is not a candidate.
        for name, other in ((ENCODER, SHIP), (SHIP, ENCODER)):
            without_other = [row for row in candidates if names[row - 1] != other]
            alone = self.isolate(fault_state, all_separations, without_other, time_ns)
            if alone.subfilter is not None and names[alone.subfilter - 1] == name:
                return True, name, explaining
        return True, None, explaining

    def drift_together(self, fault_state: AxisFaultState, time_ns: int) -> bool:
        """True if at least two beacons are in use, and all used beacons drift in one direction in the image."""
        in_use = fault_state.in_use(self.subfilters.sources, time_ns)
        recent = [self.subfilters.indices[source] for source in in_use]
        if len(recent) < 2:
            return False
        # Means over the longer windows only, in standard deviations, shape (w, l, 2).
        running = fault_state.innovation_means.running[0, recent, 1:].swapaxes(0, 1)
        offset_sigmas = running[..., :2] / np.sqrt(running[..., 4:])
        size = np.linalg.norm(offset_sigmas, axis=-1)
        cosines = np.einsum("wlk,wmk->wlm", offset_sigmas, offset_sigmas) / (size[:, :, None] * size[:, None, :])
        is_common = cosines.min(axis=(1, 2)) > _COMMON_DRIFT_COSINE
        return bool(np.any((size.min(axis=1) > _COMMON_DRIFT_SIGMAS) & is_common))  # false for NaN

    def indicates_ship_drift(self, fault_state: AxisFaultState, time_ns: int) -> bool:
        """True if a chi² is above 0.3 of its limit, and the subfilter without the ship's attitude is consistent.

        False while a source is excluded or a fault is unresolved.
        """
        means, row = fault_state.innovation_means, self.subfilters.subfilter_of(SHIP)
        is_recent = means.last_measured_ns >= time_ns - MAX_MEASUREMENT_AGE_NS
        is_indicated = np.any(means.excess[0, is_recent] > _DRIFT_INDICATION_RATIO)
        if fault_state.excluded or fault_state.unresolved_fault is not None or not is_indicated:
            return False
        is_consistent = np.all(means.excess[row, is_recent] <= CONSISTENT_RATIO)
        return bool(is_consistent and np.all(means.rejection_counts[row, is_recent] == 0))

    def exclude_source(
        self, fault_state: AxisFaultState, source: str, exclusion: AxisExclusion, subfilter: str | None = None
    ) -> AxisFaultState:
        """Exclude a source and end an unresolved fault.

        The innovation means of all filters restart from those of the source's subfilter, or of ``subfilter`` if given.
        """
        row, means = self.subfilters.subfilter_of(subfilter or source), fault_state.innovation_means
        rows = [row] * self.subfilters.count
        same = {name: getattr(means, name)[rows] for name in FIELDS_BY_SUBFILTER}
        return self.exclude(fault_state, {source: exclusion}, replace(means, **same))

    def record_baseline_jump(self, fault_state: AxisFaultState, source: str, jump: BaselineJump) -> AxisFaultState:
        """Record another jump of an excluded drone's baseline, which may be a jump back to the former position."""
        record = fault_state.excluded[source]
        if jump.time_ns <= record.last_jump_ns + _SAME_JUMP_NS:
            return fault_state
        jumped_n, sigma_m = record.jump_sum_n + jump.jump_n, float(np.hypot(record.jump_sum_sigma_m, jump.sigma_m))
        new_record = replace(record, jump_sum_n=jumped_n, jump_sum_sigma_m=sigma_m, last_jump_ns=jump.time_ns)
        means = fault_state.innovation_means
        if np.linalg.norm(jumped_n) <= _JUMP_REVERSED_SIGMAS * sigma_m:
            new_record = replace(new_record, jump_sum_n=np.zeros(3), jump_sum_sigma_m=0.0)
            means = cleared_means(means, slice(None), [self.subfilters.indices[source]])
        excluded = with_entry(fault_state.excluded, source, new_record)
        return replace(fault_state, innovation_means=means, excluded=excluded)

    def monitor_beacon(
        self,
        fault_state: AxisFaultState,
        source: str,
        innovation: FilterInnovations,
        time_ns: int,
        expected_rejection_m: float,
    ) -> AxisFaultState:
        """Monitor an excluded drone with a sighting of its beacon; reinstate the drone after a time of consistency.

        Args:
            fault_state: state before the sighting.
            source: the drone.
            innovation: innovation of the beacon in the main filter, which does not use the drone.
            time_ns: time of the sighting.
            expected_rejection_m: residual on the detector that the fault would cause now, m. This residual must be
                detectable for a reinstatement; 0 omits this test.
        """
        index, rows = self.subfilters.indices[source], self.subfilters.count
        whitened, limit = np.repeat(innovation.whitened_innovation, rows, axis=0), self.subfilters.innovation_mean_limit
        accepted, noise = np.full(rows, bool(innovation.nis[0] <= self._beacon_gate)), innovation.whitened_noise
        means = updated_means(fault_state.innovation_means, index, whitened, accepted, time_ns, limit, noise)
        sigma_m = float(np.sqrt(np.max(np.linalg.eigvalsh(innovation.covariance[0]))))
        is_observable = not 0.0 < expected_rejection_m <= _DETECTABLE_SIGMAS * sigma_m
        exclusion, is_reinstated = evaluate_reinstatement(
            fault_state.excluded[source], means, index, time_ns, self._return_after_s, is_observable=is_observable
        )
        return self._keep_or_reinstate(replace(fault_state, innovation_means=means), source, exclusion, is_reinstated)

    def monitor_prediction(
        self, fault_state: AxisFaultState, source: str, is_consistent: bool, time_ns: int
    ) -> AxisFaultState:
        """Monitor excluded encoders or ship's attitude with a sighting; reinstate them after a time of consistency.

        Args:
            fault_state: state before the sighting.
            source: the excluded source.
            is_consistent: True if the sighting passes the gate against the prediction from this source.
            time_ns: time of the sighting.
        """
        after = with_consistency(fault_state.excluded[source], is_consistent, time_ns, self._return_after_s)
        return self._keep_or_reinstate(fault_state, source, *after)

    def _keep_or_reinstate(
        self, fault_state: AxisFaultState, source: str, exclusion: AxisExclusion, is_reinstated: bool
    ) -> AxisFaultState:
        """Return the state with an excluded source reinstated, or with its updated exclusion."""
        if not is_reinstated:
            return replace(fault_state, excluded=with_entry(fault_state.excluded, source, exclusion))
        known_jumps_ns = with_entry(fault_state.known_jumps_ns, source, exclusion.last_jump_ns + _SAME_JUMP_NS)
        return replace(self.reinstate(fault_state, (source,)), known_jumps_ns=known_jumps_ns)


def with_unresolved_fault(state: AxisFaultState, disagreement_n: FloatArray, is_persistent: bool) -> AxisFaultState:
    """Record a fault without an isolated source; a larger earlier disagreement is kept.

    Args:
        state: state after the sighting.
        disagreement_n: possible error of the pointing, as covariance of a rotation vector in n, rad², shape (3, 3).
        is_persistent: True if fault detection has detected the fault, which then ends only after a period of
            consistency. Any other fault ends with the next accepted sighting.
    """
    before = state.unresolved_fault
    if before is not None and np.trace(before.covariance_n) > np.trace(disagreement_n):
        disagreement_n = before.covariance_n
    is_persistent = is_persistent or (before is not None and before.is_persistent)
    return replace(state, unresolved_fault=UnresolvedFault(_UNRESOLVED_TEXT, disagreement_n, is_persistent))


def record_acceptance(fault_state: AxisFaultState, time_ns: int, return_after_s: float) -> AxisFaultState:
    """Record an accepted sighting; an unresolved fault ends at once, or after a period of consistency."""
    conflict = fault_state.unresolved_fault
    if conflict is None:
        return fault_state
    if not conflict.is_persistent:
        return replace(fault_state, unresolved_fault=None)
    if conflict.consistent_since_ns is None:
        # Innovations of rejected beacons must not isolate a source after this acceptance.
        means = cleared_means(fault_state.innovation_means, slice(None), slice(None))
        conflict = replace(conflict, consistent_since_ns=time_ns)
        return replace(fault_state, innovation_means=means, unresolved_fault=conflict)
    has_ended = time_ns - conflict.consistent_since_ns >= return_after_s * SECOND_NS
    return replace(fault_state, unresolved_fault=None if has_ended else conflict)
