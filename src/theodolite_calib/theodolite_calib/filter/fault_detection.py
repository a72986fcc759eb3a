"""Fault detection and exclusion (FDE) for the theodolite: isolate, exclude, monitor and reinstate sources.

A source is excluded if the other sources are consistent without it
(:mod:`ship_estimation.fault_detection.fault_isolation`). A drone is also excluded if its baseline jumps by more than
its flight allows. If no faulty source is isolated, the fault is unresolved, and the pointing covariance covers the
disagreement.

An excluded source is monitored, and reinstated after it has been consistent for ``return_after_s``. For a drone
without other beacons in use, or with a jumped baseline, consistency counts only if the fault would be detectable. The
standard deviation of the predicted beacon must then be small against the residual that the fault would cause. After
the baseline has jumped back, consistency always counts.
"""

from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace

import numpy as np

from ship_estimation.fault_detection.fault_isolation import (
    MAX_MEASUREMENT_AGE_NS,
    ExcludedSource,
    FaultIsolation,
    evaluate_reinstatement,
    isolate_fault,
)
from ship_estimation.fault_detection.innovation_means import (
    CONSISTENT_RATIO,
    FIELDS_BY_SUBFILTER,
    InnovationMeans,
    cleared_means,
    excess_limit,
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
    SubfilterInnovations,
    SubfilterSet,
)
from theodolite_calib.samples.baseline_track import BaselineJump
from theodolite_calib.samples.stream_consistency import StreamConsistency

_SAME_JUMP_NS = SECOND_NS
"""Jumps of one baseline within this time count as one jump, ns."""
_JUMP_REVERSED_SIGMAS = 4.0
"""A baseline counts as returned if the sum of its jumps is below this many standard deviations."""
_COMMON_DRIFT_SIGMAS, _COMMON_DRIFT_COSINE = 2.0, 0.7
"""Beacons drift together if each innovation mean exceeds the first value (standard deviations), and the cosine of the
angle between any two means exceeds the second value."""
_DRIFT_INDICATION_RATIO = 0.3
"""Ratio of the chi² of an innovation mean to its limit above which the beacons indicate a drift of the ship's attitude.

The ship's attitude is excluded only if it also departs from the integral of its rates."""
_DETECTABLE_SIGMAS = 5.0
"""Ratio of a residual to the standard deviation of the predicted beacon above which the residual is detectable."""


@dataclass(frozen=True)
class ExclusionRecord:
    """Excluded source, with the reason of its exclusion.

    Attributes:
        exclusion: time of the exclusion, and time since which the source has been consistent.
        reason: reason, as text.
        rejected_residual_m: largest residual component at the exclusion, on the detector, m; 0 if the baseline jumped.
        jump_sum_n: sum of the jumps of the baseline (North, Up, East), m, shape (3,); zeros without a jump or after a
            jump back.
        jump_sum_sigma_m: standard deviation of ``jump_sum_n``, m.
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
    """Unresolved fault: beacons contradict encoders and ship's attitude, and no faulty source is isolated.

    Attributes:
        disagreement_n: possible error of the pointing, as covariance of a rotation vector in n, rad², shape (3, 3).
        is_persistent: True once :meth:`FaultDetector.isolate_fault` has detected the fault, which then ends only after
            a period of consistency. Any other fault ends with the next accepted sighting.
        consistent_since_ns: time since which sightings have been accepted without a detected fault; None before that,
            and after a gap in the beacons.
    """

    disagreement_n: FloatArray
    is_persistent: bool = False
    consistent_since_ns: int | None = None


@dataclass(frozen=True)
class FaultState:
    """State of fault detection and exclusion.

    Attributes:
        innovation_means: windowed innovation means of every drone in the main filter (first) and in every subfilter.
        exclusions: records of the excluded sources, by source.
        unresolved_fault: unresolved fault, or None.
        known_jumps_ns: reinstated source → stamp up to which jumps of the drone's baseline are ignored.
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


def initial_fault_state(subfilters: SubfilterSet) -> FaultState:
    """Return the initial state, without excluded sources and unresolved faults."""
    return FaultState(initial_means(1 + len(subfilters.sources), len(subfilters.beacons)))


class FaultDetector:
    """Fault detector for the sources of a configuration, from the innovations in all filters.

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
        """Restart the reinstatement timers of a sighting's drones that were not sighted in the 10 s before.

        After a gap in all beacons, the timers of encoders, ship's attitude, telescope and unresolved fault restart too.

        Args:
            fault_state: state after the previous sighting.
            names: beacons of this sighting.
            time_ns: time of the sighting.
        """
        received_ns, since_ns = fault_state.innovation_means.last_measured_ns, time_ns - MAX_MEASUREMENT_AGE_NS
        timed_out: Set[str] = {
            BEACON_PREFIX + name for name in names if received_ns[self._subfilters.beacons.index(name)] < since_ns
        }
        if not timed_out or not (fault_state.exclusions or fault_state.unresolved_fault):
            return fault_state
        conflict = fault_state.unresolved_fault
        if received_ns.max() < since_ns:
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
        """Update the innovation means with an accepted or rejected sighting of beacons that are not excluded."""
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
        """Return True if a fault is detected, the isolated source or None, and all sources that explain the fault.

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
        isolation = isolate(candidates)
        if not isolation.is_detected:
            return False, None, set()
        explaining = {sources[row - 1] for row in isolation.explaining_subfilters}
        if isolation.subfilter is not None:
            return True, sources[isolation.subfilter - 1], explaining
        # Encoders and ship's attitude have similar effects on the beacons, so both subfilters may explain one fault.
        # One of the two is faulty if it is isolated when the other is not a candidate.
        for name, other in ((ENCODER, SHIP), (SHIP, ENCODER)):
            alone = isolate([candidate for candidate in candidates if candidate != other])
            if alone.subfilter is not None and sources[alone.subfilter - 1] == name:
                return True, name, explaining
        return True, None, explaining

    def drift_together(self, fault_state: FaultState, time_ns: int) -> bool:
        """True if at least two beacons are in use, and all used beacons drift in one direction in the image."""
        recent = [
            row
            for row, id_ in enumerate(self._subfilters.beacons)
            if BEACON_PREFIX + id_ not in fault_state.excluded_sources
            and fault_state.innovation_means.last_measured_ns[row] >= time_ns - MAX_MEASUREMENT_AGE_NS
        ]
        if len(recent) < 2:
            return False
        # Means over the longer windows only, in standard deviations, shape (w, l, 2).
        running = fault_state.innovation_means.running[0, recent, 1:].swapaxes(0, 1)
        offset_sigmas = running[..., :2] / np.sqrt(running[..., 4:])
        size = np.linalg.norm(offset_sigmas, axis=-1)
        cosines = np.einsum("wlk,wmk->wlm", offset_sigmas, offset_sigmas) / (size[:, :, None] * size[:, None, :])
        is_common = (size.min(axis=1) > _COMMON_DRIFT_SIGMAS) & (
            cosines.min(axis=(1, 2)) > _COMMON_DRIFT_COSINE
        )  # false for NaN
        return bool(np.any(is_common))

    def indicates_ship_drift(self, fault_state: FaultState, time_ns: int) -> bool:
        """True if a chi² is above 0.3 of its limit, and the subfilter without the ship's attitude is consistent.

        False while a source is excluded or a fault is unresolved.
        """
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
        """Exclude a source and end an unresolved fault.

        The innovation means of all filters restart from those of the source's subfilter, or of
        ``explaining_subfilter`` if given.
        """
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
        """Record another jump of an excluded drone's baseline, which may be a jump back to the former position."""
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
        """Monitor an excluded drone with a sighting of its beacon; reinstate the drone after a time of consistency.

        Args:
            fault_state: state before the sighting.
            name: name of the beacon.
            innovation: innovation of the beacon in the main filter, which does not use the drone.
            time_ns: time of the sighting.
            expected_rejection_m: residual on the detector that the fault would cause now, m. This residual must be
                detectable for a reinstatement; 0 omits this test.
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
        exclusion, is_reinstated = evaluate_reinstatement(
            record.exclusion, means, index, time_ns, self._config.return_after_s
        )
        sigma_m = float(np.sqrt(np.max(np.linalg.eigvalsh(innovation.covariance[0]))))
        if 0.0 < expected_rejection_m <= _DETECTABLE_SIGMAS * sigma_m:
            exclusion, is_reinstated = replace(exclusion, consistent_since_ns=None), False
        return self._keep_or_reinstate(replace(fault_state, innovation_means=means), source, exclusion, is_reinstated)

    def monitor_prediction(self, fault_state: FaultState, source: str, is_consistent: bool, time_ns: int) -> FaultState:
        """Monitor excluded encoders or ship's attitude with a sighting; reinstate them after a time of consistency.

        Args:
            fault_state: state before the sighting.
            source: the excluded source.
            is_consistent: True if the sighting passes the gate against the prediction from this source.
            time_ns: time of the sighting.
        """
        exclusion = fault_state.exclusions[source].exclusion
        since_ns = (exclusion.consistent_since_ns or time_ns) if is_consistent else None
        is_reinstated = since_ns is not None and time_ns - since_ns >= self._config.return_after_s * SECOND_NS
        exclusion = replace(exclusion, consistent_since_ns=since_ns)
        return self._keep_or_reinstate(fault_state, source, exclusion, is_reinstated)

    def _keep_or_reinstate(
        self, fault_state: FaultState, source: str, exclusion: ExcludedSource, is_reinstated: bool
    ) -> FaultState:
        """Return the state with an excluded source reinstated, or with its updated exclusion."""
        exclusions, jumped_ns, means = (
            dict(fault_state.exclusions),
            dict(fault_state.known_jumps_ns),
            fault_state.innovation_means,
        )
        if is_reinstated:
            jumped_ns[source] = exclusions.pop(source).last_jump_ns + _SAME_JUMP_NS
            row = len(self._subfilters.beacons) if source in AXIS_SOURCES else self._subfilters.sources.index(source)
            if row < len(self._subfilters.beacons):
                # Innovation means of an excluded source are not valid for subfilters that use the source again.
                others = [other for other in range(1 + len(self._subfilters.sources)) if other != 1 + row]
                means = cleared_means(means, others, [row])
        else:
            exclusions[source] = replace(exclusions[source], exclusion=exclusion)
        return replace(fault_state, innovation_means=means, exclusions=exclusions, known_jumps_ns=jumped_ns)

    def set_unresolved_fault(
        self, fault_state: FaultState, disagreement_n: FloatArray, is_persistent: bool
    ) -> FaultState:
        """Record a fault without an isolated source; a larger earlier disagreement is kept."""
        before = fault_state.unresolved_fault
        if before is not None and np.trace(before.disagreement_n) > np.trace(disagreement_n):
            disagreement_n = before.disagreement_n
        is_persistent = is_persistent or (before is not None and before.is_persistent)
        return replace(fault_state, unresolved_fault=UnresolvedFault(disagreement_n, is_persistent))

    def record_acceptance(self, fault_state: FaultState, time_ns: int) -> FaultState:
        """Record an accepted sighting; an unresolved fault ends at once, or after a period of consistency."""
        conflict = fault_state.unresolved_fault
        if conflict is None:
            return fault_state
        if not conflict.is_persistent:
            return replace(fault_state, unresolved_fault=None)
        if conflict.consistent_since_ns is None:
            # Innovations of rejected beacons must not isolate a source after this acceptance.
            means = cleared_means(fault_state.innovation_means, slice(None), slice(None))
            return replace(
                fault_state, innovation_means=means, unresolved_fault=replace(conflict, consistent_since_ns=time_ns)
            )
        has_ended = time_ns - conflict.consistent_since_ns >= self._config.return_after_s * SECOND_NS
        return replace(fault_state, unresolved_fault=None if has_ended else conflict)
