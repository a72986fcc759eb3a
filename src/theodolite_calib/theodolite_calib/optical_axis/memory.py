"""Remembered state of the calibration: restart from it, comparison with beacons and other states, and consistency.

The rules that use these functions are in :mod:`ship_estimation.recovery`. Stars are not compared with a remembered
state, because beacons reinstate excluded sources.
"""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from ship_estimation.fault_detection.isolation import MAX_MEASUREMENT_AGE_NS
from ship_estimation.recovery.displacement import MemoryResidual
from ship_estimation.recovery.recoverable_core import Consistency
from ship_estimation.rejection_rules import Rejection
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.mount.axes import axis_geometry, telescope_rotation
from ship_geometry.rotations import FloatArray
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState
from theodolite_calib.filter.subfilters import BEACON_PREFIX
from theodolite_calib.optical_axis.pointings import Pointings
from theodolite_calib.optical_axis.streams import AxisEstimator, MeasuredStreams, StreamJump
from theodolite_calib.samples.samples import Exposure, ExposureDecision
from theodolite_calib.samples.sighting import Sighting
from theodolite_calib.samples.tracks import EncoderAt, ShipAt


def start_from_memory(filter_: CalibrationFilter, memory: CalibrationState) -> CalibrationState:
    """Return an initial state with the remembered errors, without later faults."""
    return replace(
        filter_.initial_state_from(memory.mean, memory.covariance_by_source),
        time_ns=memory.time_ns,
        observability=memory.observability,
        ship_covariance_n=memory.ship_covariance_n,
        sighting_count=memory.sighting_count,
        point_count=memory.point_count,
        residual_square_sum=memory.residual_square_sum,
    )


def propagate_memory(
    filter_: CalibrationFilter, memory: CalibrationState, jumps: Sequence[StreamJump], time_ns: int
) -> CalibrationState:
    """Return the remembered state propagated to a time, with its covariance inflated for jumps."""
    for stream_jump in jumps:
        memory = filter_.inflate_covariance(memory, stream_jump.jump)
    return filter_.propagate(memory, time_ns, memory.ship_covariance_n)


def memory_residuals(
    filter_: CalibrationFilter, memory: CalibrationState, sighting: Sighting
) -> dict[str, MemoryResidual]:
    """Return each beacon's residual against a remembered state: rotations of its direction to the right and up."""
    state = filter_.propagate(memory, sighting.time_ns, sighting.ship.correlated_covariance_n)
    drift, prediction = _growth_per_second(filter_, state), filter_.sightings.predict(state.mean, sighting)
    noise_m2 = sum(prediction.noise_by_source.values(), np.zeros((2 * len(sighting.names),) * 2))
    found = {}
    for light, name in enumerate(sighting.names):
        rows = slice(2 * light, 2 * light + 2)
        residual_m = prediction.residual[rows]
        if not np.all(np.isfinite(residual_m)):
            continue  # behind the telescope
        by_light_m = -prediction.by_attitude_n[rows] @ _turns_right_and_up(prediction.lines.direction_n[light])
        to_turn = np.linalg.inv(by_light_m)
        by_state = to_turn @ prediction.jacobian[rows]
        found[name] = MemoryResidual(
            turn=to_turn @ residual_m,
            noise=to_turn @ noise_m2[rows, rows] @ to_turn.T,
            expected=by_state @ state.covariance @ by_state.T,
            drift=by_state @ drift @ by_state.T,
        )
    return found


def largest_difference_sigmas(
    filter_: CalibrationFilter,
    state: CalibrationState,
    memory: CalibrationState,
    ship: ShipAt,
    encoder: EncoderAt,
    is_later: bool = False,
) -> float:
    """Return the largest difference from a remembered state, in joint standard deviations of both states.

    Constant states are compared one by one. The effect of all states on the telescope is compared about North, Up and
    East, because this effect is known better than the single states.

    Args:
        filter_: filter of the estimator.
        state: state of the filter.
        memory: the remembered state.
        ship: ship's attitude at the time of ``state``.
        encoder: encoders at that time.
        is_later: True if ``state`` is a later state of the same estimator, with all information of ``memory``; the
            standard deviations of ``memory`` are then used.
    """
    assert state.time_ns is not None
    memory = filter_.propagate(memory, state.time_ns, ship.correlated_covariance_n)
    sightings = filter_.sightings
    errors = sightings.geometry_errors(memory.mean)
    geometry = axis_geometry(errors, ship.rotation_nd, ship.rate_d, encoder.azimuth, encoder.elevation)
    _, by_parallelism = telescope_rotation(sightings.parallelism(memory.mean), geometry.rotation_nm)
    decay, _ = filter_.model.transition(1.0)
    compared = np.vstack([
        sightings.by_state_n(geometry, by_parallelism, "parallelism"),
        np.eye(filter_.model.size)[decay == 1.0],
    ])  # fmt: skip
    difference = np.abs(compared @ (state.mean - memory.mean))
    covariance = memory.covariance if is_later else state.covariance + memory.covariance
    variance = np.diagonal(compared @ covariance @ compared.T)
    # States without variance do not differ. The condition is written so that a variance of NaN is used.
    varies = variance != 0.0
    return float(np.max(difference[varies] / np.sqrt(variance[varies]), initial=0.0))


def _turns_right_and_up(direction_n: FloatArray) -> FloatArray:
    """Return the rotation vectors that move a direction to the right and up, per rad, as columns, shape (3, 2)."""
    north, up, east = direction_n
    level = np.hypot(north, east)
    right_n = np.array([-east, 0.0, north]) / level
    up_n = np.array([-up * north / level, level, -up * east / level])
    return np.column_stack([np.cross(direction_n, right_n), np.cross(direction_n, up_n)])


def _growth_per_second(filter_: CalibrationFilter, state: CalibrationState) -> FloatArray:
    """Return the covariance that propagation adds to a state in one second, shape (n, n)."""
    assert state.time_ns is not None
    before = replace(
        state, time_ns=state.time_ns - SECOND_NS, covariance_by_source=np.zeros_like(state.covariance_by_source)
    )
    return filter_.propagate(before, state.time_ns, state.ship_covariance_n).covariance


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
        state, streams = self._estimator.state, self._streams
        if state.last_update_ns is None or state.consecutive_rejections or state.fault_state.excluded:
            return False
        now_ns = self._estimator.window.newest_ns
        unconfirmed_reason = streams.encoder_check.unconfirmed_reason or streams.unconfirmed_reason(now_ns)
        return state.fault_state.unresolved_fault is None and not unconfirmed_reason

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
        if isinstance(sighting, Rejection):
            return {}
        found = memory_residuals(self._pointings.filter, memory, sighting)
        return {BEACON_PREFIX + name: residual for name, residual in found.items()}

    def largest_difference_sigmas(
        self, state: CalibrationState, memory: CalibrationState, is_later: bool = False
    ) -> float:
        """Return the largest difference from a stored state, in joint standard deviations; inf in a gap of the data."""
        axes = None if state.time_ns is None else self._streams.tracks.axes_at(state.time_ns)
        if axes is None or isinstance(axes, Rejection):
            return math.inf
        return largest_difference_sigmas(self._pointings.filter, state, memory, *axes, is_later)

    def unused_sources(self, sources: Set[str]) -> set[str]:
        """Return those beacons among ``sources`` from which no recent measurement was accepted."""
        means = self._estimator.state.fault_state.innovation_means
        since_ns = self._estimator.window.newest_ns - MAX_MEASUREMENT_AGE_NS
        used = (means.last_measured_ns >= since_ns) & (means.rejection_counts[0] == 0)
        lights = self._pointings.filter.subfilters.sources
        return {name for name, is_used in zip(lights, used.tolist(), strict=True) if name in sources and not is_used}
