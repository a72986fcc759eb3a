"""Consistency of the calibration with its sources and with a stored state, for the recovery."""

import math
from collections.abc import Mapping, Sequence, Set

from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.recovery.recoverable_core import Consistency
from theodolite_calib.filter.filter import CalibrationState
from theodolite_calib.filter.subfilters import BEACON_PREFIX
from theodolite_calib.optical_axis.memory import (
    is_consistent,
    largest_difference_sigmas,
    memory_residuals,
    propagate_memory,
)
from theodolite_calib.optical_axis.pointings import Pointings
from theodolite_calib.optical_axis.streams import AxisEstimator, MeasuredStreams, StreamJump
from theodolite_calib.samples.samples import Exposure, ExposureDecision


class AxisConsistency(Consistency[CalibrationState, StreamJump]):
    """See :class:`Consistency`.

    Args:
        estimator: time-ordered estimator of the calibration filter.
        streams: streams of encoders and ship's attitude.
        pointings: published pointings, with the filter.
    """

    def __init__(self, estimator: AxisEstimator, streams: MeasuredStreams, pointings: Pointings) -> None:
        super().__init__(streams.jumps)
        self._estimator, self._streams, self._pointings = estimator, streams, pointings

    @property
    def is_consistent(self) -> bool:
        """True after sightings of beacons or stars if no source is excluded, contradictory or unconfirmed."""
        now_ns = self._estimator.window.newest_ns
        streams = self._streams
        unconfirmed_reason = streams.encoder_check.unconfirmed_reason or streams.unconfirmed_reason(now_ns)
        return is_consistent(self._estimator.state) and not unconfirmed_reason

    @property
    def has_unresolved_fault(self) -> bool:
        """True if beacons contradict encoders and ship in several sightings, and the faulty source is not isolated."""
        conflict = self._estimator.state.fault_state.unresolved_fault
        return conflict is not None and conflict.is_persistent

    def propagate_memory(self, memory: CalibrationState, jumps: Sequence[StreamJump]) -> CalibrationState:
        """Return a stored state propagated to the oldest time of measurements that may still come."""
        return propagate_memory(self._pointings.filter, memory, jumps, self._estimator.window.oldest_ns)

    def memory_residuals(self, decision: ExposureDecision, memory: CalibrationState) -> Mapping[str, MemoryResidual]:
        """Return the residuals of the beacons of an exposure against a stored state; empty without a sighting."""
        if not isinstance(decision.measurement, Exposure):
            return {}
        sighting = self._streams.sightings.assemble(decision.measurement).sighting
        if sighting is None:
            return {}
        found = memory_residuals(self._pointings.filter, memory, sighting)
        return {BEACON_PREFIX + name: residual for name, residual in found.items()}

    def largest_difference_sigmas(
        self, state: CalibrationState, memory: CalibrationState, is_later: bool = False
    ) -> float:
        """Return the largest difference from a stored state, in joint standard deviations; inf in a gap of the data."""
        time_ns = state.time_ns
        ship = None if time_ns is None else self._streams.tracks.ship_at(time_ns)
        encoder = None if time_ns is None else self._streams.tracks.encoder_at(time_ns)
        if ship is None or encoder is None:
            return math.inf
        return largest_difference_sigmas(self._pointings.filter, state, memory, ship, encoder, is_later)

    def unused_sources(self, sources: Set[str]) -> set[str]:
        """Return those beacons among ``sources`` from which no recent measurement was accepted."""
        means = self._estimator.state.fault_state.innovation_means
        since_ns = self._estimator.window.newest_ns - MAX_MEASUREMENT_AGE_NS
        used = (means.last_measured_ns >= since_ns) & (means.rejection_counts[0] == 0)
        lights = self._pointings.filter.subfilters.sources
        return {name for name, is_used in zip(lights, used.tolist(), strict=True) if name in sources and not is_used}
