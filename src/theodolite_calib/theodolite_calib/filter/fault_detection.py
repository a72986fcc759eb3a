"""Fault detection and exclusion (FDE) for the theodolite: isolate, exclude, monitor and reinstate sources.

A source is excluded if the other sources are consistent without it (:mod:`ship_estimation.fault_isolation`). A drone is
also excluded if its baseline jumps by more than its flight allows. If beacons are rejected and no single source
explains the rejections, the fault is unresolved, and the pointing covariance covers the disagreement.

An excluded source is monitored. It is reinstated after it has been consistent for ``return_after_s``. Consistency
counts only if the fault would still be detectable: the standard deviation of the predicted beacon must be small against
the rejected residual. A baseline that has jumped back has no residual left.
"""

from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace

import numpy as np

from ship_estimation.fault_isolation import (
    MAX_MEASUREMENT_AGE_NS,
    ExcludedSource,
    FaultIsolation,
    evaluate_reinstatement,
    isolate_fault,
)
from ship_estimation.gates import GateConfig, chi_square_gate
from ship_estimation.innovation_means import (
    CONSISTENT_RATIO,
    FIELDS_BY_SUBFILTER,
    InnovationMeans,
    cleared_means,
    excess_limit,
    initial_means,
    updated_means,
)
from ship_estimation.protection_levels import IntegrityConfig
from ship_estimation.subfilters import FilterInnovations
from ship_geometry.rotations import FloatArray
from ship_geometry.time_scales import SECOND_NS
from theodolite_calib.filter.subfilters import (
    AXIS_SOURCES,
    BEACON_PREFIX,
    ENCODER,
    SHIP,
    TELESCOPE,
    SubfilterInnovations,
    SubfilterSet,
)
from theodolite_calib.measured.baseline_track import BaselineJump
from theodolite_calib.measured.stream_consistency import StreamConsistency

_SAME_JUMP_NS = SECOND_NS
"""Jumps of one baseline within this time count as one jump, ns."""
_JUMP_REVERSED_SIGMAS = 4.0
"""A baseline counts as returned if the sum of its jumps is below this many standard deviations."""
_COMMON_DRIFT_SIGMAS, _COMMON_DRIFT_COSINE = 2.0, 0.7
"""Beacons drift together if each mean exceeds the first value (standard deviations) and each pair of means has at least
the second value as the cosine of the angle between them."""
_DRIFT_INDICATION_RATIO = 0.3
"""Ratio of an innovation mean to its limit above which a ship attitude that departs from its own rates is faulty.
Neither sign alone suffices."""
_DETECTABLE_SIGMAS = 5.0
"""A rejected residual counts as detectable again if it exceeds this many standard deviations of the predicted
beacon."""


@dataclass(frozen=True)
class ExclusionRecord:
    """Excluded source, with the reason of its exclusion.

    Attributes:
        exclusion: time of the exclusion, and time since which the source has been consistent.
        reason: reason, as text.
        rejected_residual_m: size of the rejected residual on the detector, m; 0 if the baseline jumped.
        jump_sum_n: sum of the jumps of the baseline (North, Up, East), m, shape (3,); zeros if it has jumped back or
            never jumped.
        jump_sum_sigma_m: standard deviation of that sum, m.
        last_jump_ns: stamp of the last jump, ns.
    """

    exclusion: ExcludedSource
    reason: str
    rejected_residual_m: float = 0.0
    jump_sum_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    jump_sum_sigma_m: float = 0.0
    last_jump_ns: int = 0


@dataclass(frozen=True)
class UnresolvedFault:
    """Unresolved fault: beacons contradict the encoders and the ship's attitude, and no single source explains it.

    Attributes:
        disagreement_n: possible error of the pointing: covariance of the rotation vector in n, rad², shape (3, 3).
        is_persistent: True if more than one or two sightings disagreed; the fault then ends only after a period of
            consistency.
        consistent_since_ns: time since which beacons have been accepted again; None while they are rejected.
    """

    disagreement_n: FloatArray
    is_persistent: bool = False
    consistent_since_ns: int | None = None


@dataclass(frozen=True)
class FaultState:
    """State of fault detection and exclusion.

    Attributes:
        innovation_means: windowed innovation means of every drone in the main filter (first) and in every subfilter.
        exclusions: excluded sources by name.
        unresolved_fault: unresolved fault; None if there is none.
        known_jumps_ns: stamps up to which jumps of baselines have been processed, by source.
    """

    innovation_means: InnovationMeans
    exclusions: Mapping[str, ExclusionRecord] = field(default_factory=dict)
    unresolved_fault: UnresolvedFault | None = None
    known_jumps_ns: Mapping[str, int] = field(default_factory=dict)

    @property
    def excluded_sources(self) -> Set[str]:
        """Names of the excluded sources."""
        return self.exclusions.keys()


def isolate_step_fault(
    source: str, explaining_sources: Set[str], streams: StreamConsistency, offset_rad: float
) -> str | None:
    """Return the faulty source of a sudden contradiction between beacons and prediction; None if it is not isolated.

    Args:
        source: encoders or ship's attitude, as isolated by the subfilters.
        explaining_sources: all sources without which the rest is consistent.
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
    right = all(step is not None and step.is_ruled_out(offset_rad) for step in candidate_steps)
    return TELESCOPE if right else source


def isolate_drift_fault(
    source: str | None, explaining_sources: Set[str], is_common: bool, has_ship_drifted: bool | None
) -> str | None:
    """Return the faulty source of a drift of accepted beacons; None if it is not isolated.

    If all beacons drift together, the encoders or the ship's attitude drift, because two drones do not drift together.
    The ship's own rates distinguish the two. If the beacons drift differently and the encoders or the ship explain that
    as well as a drone does, no source is isolated.

    Args:
        source: as isolated by the subfilters; None if they isolate none.
        explaining_sources: all sources without which the rest is consistent.
        is_common: True if all beacons drift together.
        has_ship_drifted: True if the ship's attitude has departed from its own rates; None if unknown.
    """
    axis_sources = explaining_sources & {ENCODER, SHIP}
    if has_ship_drifted is not None:
        axis_sources = axis_sources & {SHIP if has_ship_drifted else ENCODER}
    if not axis_sources:
        return source
    if len(axis_sources) == 1 and (is_common or has_ship_drifted or source in AXIS_SOURCES):
        return next(iter(axis_sources))
    return source if source in AXIS_SOURCES else None


def initial_fault_state(subfilters: SubfilterSet) -> FaultState:
    """Return the initial state: no source is excluded and no fault is unresolved."""
    return FaultState(initial_means(1 + len(subfilters.sources), len(subfilters.beacons)))


class FaultDetector:
    """Fault detector for the sources of a configuration, from the innovations in the subfilters.

    Args:
        config: probabilities for exclusions, and the reinstatement time.
        gate: gate of the beacons.
        subfilters: set of subfilters.
        threshold: threshold of a solution separation, in standard deviations.
    """

    def __init__(self, config: IntegrityConfig, gate: GateConfig, subfilters: SubfilterSet, threshold: float) -> None:
        self._config, self._subfilters, self._threshold = config, subfilters, threshold
        self._limit = excess_limit(config, max(len(subfilters.beacons), 1))
        self._beacon_gate, self._degraded_after = chi_square_gate(gate.probability, 2), gate.degraded_after
        own = np.array(
            [[BEACON_PREFIX + id_ == source for id_ in subfilters.beacons] for source in subfilters.sources], dtype=bool
        )
        self._excludes = np.vstack([np.zeros((1, len(subfilters.beacons)), dtype=bool), own])

    def restart_timers(self, fault_state: FaultState, names: tuple[str, ...], time_ns: int) -> FaultState:
        """Restart the timers of sources that had no data before a sighting: a gap is not consistency.

        Args:
            fault_state: state after the previous sighting.
            names: beacons of this sighting.
            time_ns: time of the sighting.
        """
        received_ns, silent_ns = fault_state.innovation_means.last_measured_ns, time_ns - MAX_MEASUREMENT_AGE_NS
        timed_out: Set[str] = {
            BEACON_PREFIX + name for name in names if received_ns[self._subfilters.beacons.index(name)] < silent_ns
        }
        if not timed_out or not (fault_state.exclusions or fault_state.unresolved_fault):
            return fault_state
        conflict = fault_state.unresolved_fault
        if received_ns.max() < silent_ns:
            timed_out = timed_out | AXIS_SOURCES
            conflict = None if conflict is None else replace(conflict, consistent_since_ns=None)
        exclusions = dict(fault_state.exclusions)
        for name in timed_out & exclusions.keys():
            exclusion = replace(exclusions[name].exclusion, consistent_since_ns=None)
            exclusions[name] = replace(exclusions[name], exclusion=exclusion)
        return replace(fault_state, exclusions=exclusions, unresolved_fault=conflict)

    def update_means(
        self,
        fault_state: FaultState,
        names: tuple[str, ...],
        innovations: SubfilterInnovations,
        is_used: bool,
        time_ns: int,
    ) -> FaultState:
        """Update the innovation means with a sighting, accepted or not, of beacons that are not excluded."""
        beacons = [self._subfilters.beacons.index(name) for name in names]
        by_row = np.concatenate([[is_used], innovations.accepted])[:, None]
        accepted = np.where(self._excludes[:, beacons], innovations.beacon_nis <= self._beacon_gate, by_row)
        means = updated_means(
            fault_state.innovation_means, beacons, innovations.whitened_innovation, accepted, time_ns, self._limit
        )
        return replace(fault_state, innovation_means=means)

    def isolate_fault(
        self, fault_state: FaultState, separations: FloatArray, time_ns: int
    ) -> tuple[bool, str | None, Set[str]]:
        """Return True if a source is faulty, the isolated source or None, and all sources that explain the fault.

        Args:
            fault_state: state after the sighting.
            separations: solution separation of each subfilter in standard deviations, shape (h,).
            time_ns: time of the sighting.
        """
        sources, excluded = self._subfilters.sources, fault_state.excluded_sources
        is_excluded = np.array([BEACON_PREFIX + id_ in excluded for id_ in self._subfilters.beacons], dtype=bool)
        uses = ~(self._excludes | is_excluded)
        all_separations = np.concatenate([[0.0], separations])

        def isolate(names: list[str]) -> FaultIsolation:
            rows = [1 + sources.index(name) for name in names]
            return isolate_fault(
                fault_state.innovation_means,
                uses,
                all_separations,
                self._threshold,
                rows,
                time_ns,
                self._degraded_after,
            )

        candidates = [name for name in sources if name not in excluded]
        finding = isolate(candidates)
        if not finding.is_detected:
            return False, None, set()
        explaining = {sources[row - 1] for row in finding.explaining_subfilters}
        if finding.subfilter is not None:
            return True, sources[finding.subfilter - 1], explaining
        # Faults of encoders and ship's attitude have similar effects on the beacons: either may explain both.
        for name, other in ((ENCODER, SHIP), (SHIP, ENCODER)):
            alone = isolate([candidate for candidate in candidates if candidate != other])
            if alone.subfilter is not None and sources[alone.subfilter - 1] == name:
                return True, name, explaining
        return True, None, explaining

    def drift_together(self, fault_state: FaultState, time_ns: int) -> bool:
        """True if at least two beacons are in use and all of them drift in the same direction in the image."""
        recent = [
            row
            for row, id_ in enumerate(self._subfilters.beacons)
            if BEACON_PREFIX + id_ not in fault_state.excluded_sources
            and fault_state.innovation_means.last_measured_ns[row] >= time_ns - MAX_MEASUREMENT_AGE_NS
        ]
        if len(recent) < 2:
            return False
        # Longer windows only, in standard deviations: shape (w, l, 2).
        running = fault_state.innovation_means.running[0, recent, 1:].swapaxes(0, 1)
        offset_sigmas = running[..., :2] / np.sqrt(running[..., 4:])
        size = np.linalg.norm(offset_sigmas, axis=-1)
        cosines = np.einsum("wlk,wmk->wlm", offset_sigmas, offset_sigmas) / (size[:, :, None] * size[:, None, :])
        is_common = (size.min(axis=1) > _COMMON_DRIFT_SIGMAS) & (
            cosines.min(axis=(1, 2)) > _COMMON_DRIFT_COSINE
        )  # NaN is not
        return bool(np.any(is_common))

    def indicates_ship_drift(self, fault_state: FaultState, time_ns: int) -> bool:
        """True if beacons drift within their limit and are consistent without the ship's attitude."""
        is_recent = fault_state.innovation_means.last_measured_ns >= time_ns - MAX_MEASUREMENT_AGE_NS
        if (
            fault_state.excluded_sources
            or fault_state.unresolved_fault is not None
            or not np.any(fault_state.innovation_means.excess[0, is_recent] > _DRIFT_INDICATION_RATIO)
        ):
            return False
        row = 1 + self._subfilters.sources.index(SHIP)
        return bool(
            np.all(fault_state.innovation_means.excess[row, is_recent] <= CONSISTENT_RATIO)
            and np.all(fault_state.innovation_means.rejection_counts[row, is_recent] == 0)
        )

    def exclude_source(
        self, fault_state: FaultState, source: str, exclusion: ExclusionRecord, explaining_subfilter: str | None = None
    ) -> FaultState:
        """Exclude a source; all means restart from those of its subfilter, or of ``explaining_subfilter``."""
        row, means = 1 + self._subfilters.sources.index(explaining_subfilter or source), fault_state.innovation_means
        same = {
            name: np.repeat(getattr(means, name)[row : row + 1], 1 + len(self._subfilters.sources), axis=0)
            for name in FIELDS_BY_SUBFILTER
        }
        exclusions = {**fault_state.exclusions, source: exclusion}
        return replace(
            fault_state, innovation_means=replace(means, **same), exclusions=exclusions, unresolved_fault=None
        )

    def record_baseline_jump(self, fault_state: FaultState, source: str, jump: BaselineJump) -> FaultState:
        """Record another jump of the baseline of an excluded drone, which may have jumped back."""
        record = fault_state.exclusions[source]
        if jump.time_ns <= record.last_jump_ns + _SAME_JUMP_NS:
            return fault_state
        jumped_n, sigma_m = record.jump_sum_n + jump.jump_n, float(np.hypot(record.jump_sum_sigma_m, jump.sigma_m))
        new_record = replace(record, jump_sum_n=jumped_n, jump_sum_sigma_m=sigma_m, last_jump_ns=jump.time_ns)
        means = fault_state.innovation_means
        if np.linalg.norm(jumped_n) <= _JUMP_REVERSED_SIGMAS * sigma_m:
            new_record = replace(new_record, jump_sum_n=np.zeros(3), jump_sum_sigma_m=0.0)
            means = cleared_means(means, slice(None), [self._subfilters.sources.index(source)])
        return replace(fault_state, innovation_means=means, exclusions={**fault_state.exclusions, source: new_record})

    def monitor_beacon(
        self,
        fault_state: FaultState,
        name: str,
        innovation: FilterInnovations,
        time_ns: int,
        expected_rejection_m: float,
    ) -> FaultState:
        """Compare a beacon of an excluded drone with the estimate by the others; reinstate the drone when due.

        Args:
            fault_state: state before.
            name: beacon.
            innovation: innovation against the estimate by all other sources; one filter.
            time_ns: time of the sighting.
            expected_rejection_m: residual on the detector that the fault would cause now, m; 0 if there is none.
        """
        index, source = self._subfilters.beacons.index(name), BEACON_PREFIX + name
        record = fault_state.exclusions[source]
        rows = 1 + len(self._subfilters.sources)
        whitened_innovation = np.repeat(innovation.whitened_innovation, rows, axis=0)
        accepted = np.full(rows, bool(innovation.nis[0] <= self._beacon_gate))
        means = updated_means(
            fault_state.innovation_means,
            index,
            whitened_innovation,
            accepted,
            time_ns,
            self._limit,
            innovation.whitened_noise,
        )
        exclusion, returns = evaluate_reinstatement(
            record.exclusion, means, index, time_ns, self._config.return_after_s
        )
        sigma_m = float(np.sqrt(np.max(np.linalg.eigvalsh(innovation.covariance[0]))))
        if 0.0 < expected_rejection_m <= _DETECTABLE_SIGMAS * sigma_m:
            exclusion, returns = replace(exclusion, consistent_since_ns=None), False
        return self._update_exclusion(replace(fault_state, innovation_means=means), source, exclusion, returns)

    def monitor_prediction(self, fault_state: FaultState, source: str, is_consistent: bool, time_ns: int) -> FaultState:
        """Record whether excluded encoders, or an excluded ship's attitude, predict a sighting; reinstate when due."""
        exclusion = fault_state.exclusions[source].exclusion
        since_ns = (exclusion.consistent_since_ns or time_ns) if is_consistent else None
        returns = since_ns is not None and time_ns - since_ns >= self._config.return_after_s * SECOND_NS
        return self._update_exclusion(fault_state, source, replace(exclusion, consistent_since_ns=since_ns), returns)

    def _update_exclusion(
        self, fault_state: FaultState, source: str, exclusion: ExcludedSource, is_reinstated: bool
    ) -> FaultState:
        exclusions, jumped_ns, means = (
            dict(fault_state.exclusions),
            dict(fault_state.known_jumps_ns),
            fault_state.innovation_means,
        )
        if is_reinstated:
            jumped_ns[source] = exclusions.pop(source).last_jump_ns + _SAME_JUMP_NS
            row = len(self._subfilters.beacons) if source in AXIS_SOURCES else self._subfilters.sources.index(source)
            if row < len(self._subfilters.beacons):
                # Means of an excluded source are not valid for subfilters that use it again.
                others = [other for other in range(1 + len(self._subfilters.sources)) if other != 1 + row]
                means = cleared_means(means, others, [row])
        else:
            exclusions[source] = replace(exclusions[source], exclusion=exclusion)
        return replace(fault_state, innovation_means=means, exclusions=exclusions, known_jumps_ns=jumped_ns)

    def set_unresolved_fault(
        self, fault_state: FaultState, disagreement_n: FloatArray, is_persistent: bool
    ) -> FaultState:
        """Record a fault that no single source explains."""
        before = fault_state.unresolved_fault
        if before is not None and np.trace(before.disagreement_n) > np.trace(disagreement_n):
            disagreement_n = before.disagreement_n
        is_persistent = is_persistent or (before is not None and before.is_persistent)
        return replace(fault_state, unresolved_fault=UnresolvedFault(disagreement_n, is_persistent))

    def record_acceptance(self, fault_state: FaultState, time_ns: int) -> FaultState:
        """Record an accepted sighting: end an unresolved fault, at once or after a period of consistency."""
        conflict = fault_state.unresolved_fault
        if conflict is None:
            return fault_state
        if not conflict.is_persistent:
            return replace(fault_state, unresolved_fault=None)
        if conflict.consistent_since_ns is None:
            # Innovations from the time when all beacons were rejected must not isolate a source from now on.
            means = cleared_means(fault_state.innovation_means, slice(None), slice(None))
            return replace(
                fault_state, innovation_means=means, unresolved_fault=replace(conflict, consistent_since_ns=time_ns)
            )
        has_ended = time_ns - conflict.consistent_since_ns >= self._config.return_after_s * SECOND_NS
        return replace(fault_state, unresolved_fault=None if has_ended else conflict)
