"""Streams of encoders, ship's attitude and drones: tracks, checks, and faults that a stream shows by itself.

Attitudes of the ship and the rates in the same messages are checked against each other, both with the INS alone and
with ``ship/attitude``. With the INS alone the rates have no other use, because the pointing uses only the attitudes.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ship_estimation.fault_detection.exclusion import UnconfirmedStep
from ship_estimation.parameters.ship_devices import CheckedInsConfig
from ship_estimation.plausibility.checked_ins import CheckedInsSample
from ship_estimation.plausibility.ins_check import InsCheck
from ship_estimation.recovery.recoverable_core import MAX_JUMPS
from ship_estimation.rejection_rules import Reason, Rejection, resolve_same_stamp
from ship_estimation.time_order.time_ordered_estimator import TimeOrderedEstimator
from ship_geometry.earth.time_scales import NEVER_NS, SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.tracks.sample_track import OrderedSamples
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationState, Jump
from theodolite_calib.filter.subfilters import ENCODER, SHIP, TELESCOPE
from theodolite_calib.optical_axis.output import PendingPointing
from theodolite_calib.samples.encoder_check import CheckedReading, EncoderCheck, EncoderJump
from theodolite_calib.samples.samples import (
    AnyExposure,
    BaselineSample,
    EncoderSample,
    ExposureDecision,
    PointingEstimate,
    PointingOutcome,
    ShipSample,
)
from theodolite_calib.samples.sighting import SightingAssembler
from theodolite_calib.samples.tracks import MeasuredTracks

_STATED_STEP_SIGMAS = 5.0
"""Possible step of a source's attitude, in multiples of the square root of the change of its stated variance."""

AxisEstimator = TimeOrderedEstimator[CalibrationState, AnyExposure, ExposureDecision, Jump, PointingEstimate]
"""Time-ordered estimator of the calibration filter."""

_STREAM_FAULT_REASONS = frozenset({Reason.STUCK, Reason.CONFLICT, Reason.GATE})
"""Reasons of rejections that show a fault of the encoder or ship stream: stuck, repeated stamp, or jump."""

STUCK_SIGMA_RAD = float(np.deg2rad(20.0))
"""Standard deviation of each zero point after encoders were stuck while the axis rotated, rad."""


class ShipCheck:
    """Check of the ship's attitudes of one run, in the order of their stamps.

    An attitude with a stated covariance may step as far as the change of this covariance allows. For example, a
    correction of the fused attitude by stars reduces the covariance.

    Args:
        config: parameters of the node.
        shift_ns: offset of the time of validity from the stamps, ns.

    Attributes:
        unconfirmed_step: last step of the attitude that beacons have not confirmed; None without such a step.
    """

    def __init__(self, config: OpticalAxisConfig, shift_ns: int) -> None:
        self._source = "the INS" if config.ship.source == "ins/imu" else "the ship's attitude"
        check_config = _check_config(config)
        self._ins_check, self._shift_ns = InsCheck(check_config), shift_ns
        # Accepted samples with their rates, for the check of samples that come out of order.
        self._accepted = AttitudeTrack(round(check_config.max_gap_s * SECOND_NS))
        self._stated_covariance_n: FloatArray | None = None
        self.unconfirmed_step: UnconfirmedStep | None = None

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Apply a changed noise."""
        self._ins_check.reconfigure(_check_config(config))

    def check(self, sample: ShipSample, oldest_ns: int) -> CheckedInsSample:
        """Check a sample; later samples will not be older than ``oldest_ns``."""
        stated_n, before_n, reported_step_rad = sample.correlated_covariance_n, self._stated_covariance_n, 0.0
        if stated_n is not None and before_n is not None:
            reported_step_rad = _STATED_STEP_SIGMAS * math.sqrt(abs(float((stated_n - before_n).trace())))
        result = self._ins_check.check(sample, self._accepted, {}, reported_step_rad)
        if result.rates_wrong_after_ns is not None:
            self._accepted.drop_rates(result.rates_wrong_after_ns)
        if result.jumps:
            since_ns = result.jumps[-1].time_ns + self._shift_ns
            self.unconfirmed_step = UnconfirmedStep(since_ns, f"{self._source} has jumped", "lights")
        if result.rejection is None:
            if self._accepted.newest is None or sample.time_ns > self._accepted.newest.time_ns:
                self._stated_covariance_n = stated_n
            known = self._accepted.get(sample.time_ns)
            if known is None or resolve_same_stamp(known, result.sample)[0]:
                self._accepted.insert(result.sample)
            self._accepted.drop_before(oldest_ns)
        return result

    def confirm(self, time_ns: int) -> None:
        """Record that beacons were consistent with the attitude at a time."""
        if self.unconfirmed_step is not None:
            self.unconfirmed_step = self.unconfirmed_step.with_confirmation(time_ns)

    def unconfirmed_reason(self, time_ns: int) -> str:
        """Return the reason why the attitude at a time is unconfirmed; empty if it is confirmed."""
        step = self.unconfirmed_step
        return step.text if step is not None and time_ns > step.since_ns else ""


def _check_config(config: OpticalAxisConfig) -> CheckedInsConfig:
    if config.ship.source == "ins/imu":
        return config.ins
    return CheckedInsConfig(white_sigma_arcsec=config.ship.white_sigma_arcsec, max_gap_s=config.ship.max_gap_s)


@dataclass(frozen=True)
class StreamJump:
    """Jump of the encoders or of the ship's attitude that its stream itself has shown."""

    jump: Jump

    @property
    def covariance_n(self) -> FloatArray:
        """Covariance of the change of directions to beacons, to the right and up, rad², shape (2, 2)."""
        if isinstance(self.jump, EncoderJump):
            return float(self.jump.jump @ self.jump.jump + self.jump.sigma_rad**2) * np.eye(2)
        return float(np.trace(self.jump.covariance_n)) * np.eye(2)


class _WaitingReading(NamedTuple):
    """Encoder reading that waits for the ship's attitude; ``unconfirmed_reason`` is empty for a confirmed reading."""

    sample: EncoderSample
    unconfirmed_reason: str
    unconfirmed_sigma_rad: float


class MeasuredStreams:
    """Streams of samples that give the axis between exposures, and the encoder readings that wait for an attitude.

    Args:
        config: parameters of the node.
        estimator: time-ordered estimator of the calibration filter.

    Attributes:
        tracks: accepted samples.
        sightings: assembles sightings from exposures and these samples.
        encoder_check: check of the encoders.
        ship_check: check of the ship's attitude.
        jumps: jumps that the encoder and ship streams have shown, and that were not yet read.
    """

    def __init__(self, config: OpticalAxisConfig, estimator: AxisEstimator) -> None:
        self._config, self._estimator = config, estimator
        self.jumps: deque[StreamJump] = deque(maxlen=MAX_JUMPS)
        self.reset()

    def reset(self) -> None:
        """Discard all samples and the states of the checks."""
        self.tracks = MeasuredTracks(self._config)
        self.sightings = SightingAssembler(self._config, self.tracks)
        self.encoder_check = EncoderCheck(*_encoder_limits(self._config))
        self.ship_check = ShipCheck(self._config, self.tracks.ship_shift_ns)
        self.jumps.clear()
        self._waiting_readings: deque[_WaitingReading] = deque()
        self._newest_encoder_ns = self._ship_final_until_ns = NEVER_NS
        self._encoder_arrival_ns: int | None = None
        self._ship_arrival_ns: int | None = None
        self._repeated_time_ns: tuple[int, int] | None = None
        self._fault_ns: dict[str, int] = {}
        self._is_stuck = False

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Apply changed noise."""
        self._config = config
        self.tracks.reconfigure(config)
        self.sightings = SightingAssembler(config, self.tracks)
        self.encoder_check.reconfigure(*_encoder_limits(config))
        self.ship_check.reconfigure(config)

    def add_encoder(self, sample: EncoderSample, arrival_ns: int, outcome: PointingOutcome) -> bool:
        """Add an encoder reading, which waits for the ship's attitude; return True if it is accepted and the newest."""
        track, estimator, is_newest = self.tracks.encoder, self._estimator, sample.time_ns > self._newest_encoder_ns
        result = self.encoder_check.check(sample, track, estimator.window.late_rejection(sample.time_ns))
        outcome.rejection = result.rejection
        self._record_fault(ENCODER, sample.time_ns, result.rejection, result.jump is not None)
        self._record_encoder_jump(sample.time_ns, result)
        if result.jump is not None and is_newest:
            estimator.add_jump(result.jump.time_ns, ENCODER, result.jump, track.add_cut(result.jump.time_ns))
        if result.rejection is not None:
            estimator.add_rejected(ENCODER, track, sample)
            self._check_repeated_time()
            return False
        estimator.add_sample(ENCODER, track, sample, outcome)
        if outcome.rejection is not None:
            self._record_fault(ENCODER, sample.time_ns, outcome.rejection)
            self._check_repeated_time()
        elif is_newest:
            self._newest_encoder_ns, self._encoder_arrival_ns = sample.time_ns, arrival_ns
            check = self.encoder_check
            self._waiting_readings.append(
                _WaitingReading(sample, check.unconfirmed_reason, check.unconfirmed_sigma_rad)
            )
            return True
        return False

    def add_ship(self, sample: ShipSample, arrival_ns: int, outcome: PointingOutcome) -> None:
        """Add an attitude of the ship."""
        outcome.rejection = self._estimator.window.late_rejection(sample.time_ns)
        if outcome.rejection is None:
            outcome.rejection, sample = self._check_ship(sample, outcome)
        source, track = self._config.ship.source, self.tracks.ship
        if outcome.rejection is not None:
            self._estimator.add_rejected(source, track, sample)
        elif self._estimator.add_sample(source, track, sample, outcome):
            until_ns, self._ship_arrival_ns = track.final_until_ns, arrival_ns
            self._ship_final_until_ns = NEVER_NS if until_ns is None else until_ns + self.tracks.ship_shift_ns
        if outcome.rejection is not None:
            self._record_fault(SHIP, sample.time_ns, outcome.rejection)
            self._check_repeated_time()

    def take_ready_readings(self) -> list[PendingPointing]:
        """Remove the waiting readings for which the ship's attitude is final or overdue; return those with an attitude.

        The readings are in the order of their stamps.
        """
        until_ns = max(self._ship_final_until_ns, self._estimator.window.oldest_ns - 1)
        if not (self._waiting_readings and self._waiting_readings[0].sample.time_ns <= until_ns):
            return []
        state, ready = self._estimator.state_now, []
        is_ship_confirmed = self.ship_check.unconfirmed_step is None and self._estimator.stamp_conflicts.is_empty
        while self._waiting_readings and self._waiting_readings[0].sample.time_ns <= until_ns:
            sample, reason, sigma_rad = self._waiting_readings.popleft()
            ship = self.tracks.ship_at(sample.time_ns)
            if ship is not None:
                if not (reason or is_ship_confirmed):
                    reason = self.unconfirmed_reason(sample.time_ns)
                ready.append(PendingPointing(sample, ship, reason, sigma_rad, state))
        return ready

    def add_baseline(self, beacon_id: str, sample: BaselineSample) -> PointingOutcome:
        """Add a baseline to a drone.

        An unusable baseline is rejected but stored, so that exposures do not wait for a usable one.
        """
        outcome = self._add(f"baseline.{beacon_id}", self.tracks.baselines[beacon_id], sample)
        if outcome.rejection is None:
            outcome.rejection = sample.rejection
        return outcome

    def add_drone_attitude(self, beacon_id: str, sample: AttitudeSample) -> PointingOutcome:
        """Add an attitude of a drone; a drone with its light at the antenna needs no attitudes."""
        track = self.tracks.drones.get(beacon_id)
        return PointingOutcome() if track is None else self._add(f"drone.{beacon_id}", track, sample)

    def _add(self, source: str, track: OrderedSamples[Any], sample: Any) -> PointingOutcome:
        outcome = PointingOutcome(self._estimator.window.late_rejection(sample.time_ns))
        if outcome.rejection is None:
            self._estimator.add_sample(source, track, sample, outcome)
        return outcome

    def faults(self, time_ns: int) -> set[str]:
        """Return which of the encoder and ship streams had a fault since ``integrity.return_after_s`` before a time."""
        since_ns = time_ns - round(self._config.integrity.return_after_s * SECOND_NS)
        return {source for source, fault_ns in self._fault_ns.items() if fault_ns >= since_ns}

    def is_time_repeated(self, time_ns: int) -> bool:
        """True if encoders and ship have both sent other data with the stamps around a time."""
        repeated_ns = self._repeated_time_ns
        return repeated_ns is not None and repeated_ns[0] <= time_ns <= repeated_ns[1]

    def timed_out(self, waiting_ns: int) -> list[str]:
        """Return which of ship's attitude and encoders have no data yet, or the last data more than a second ago."""
        arrivals_ns = {self._config.ship.source: self._ship_arrival_ns, "the encoders": self._encoder_arrival_ns}
        return [name for name, at_ns in arrivals_ns.items() if at_ns is None or waiting_ns - at_ns > SECOND_NS]

    def unconfirmed_reason(self, time_ns: int) -> str:
        """Return the reason why the ship's attitude at a time is unconfirmed, or sources contradict themselves."""
        conflicts = self._estimator.stamp_conflicts
        return self.ship_check.unconfirmed_reason(time_ns) or conflicts.text(conflicts.active_at(time_ns))

    def record_decision(self, decision: ExposureDecision) -> None:
        """Pass the result of an exposure to the checks of encoders and ship's attitude."""
        time_ns = decision.measurement.time_ns
        if decision.telescope_dt is not None:
            self.encoder_check.record_beacon_attitude(time_ns, *decision.telescope_dt)
        # Beacons in a telescope that has shifted carry no information.
        if not decision.accepted or TELESCOPE in decision.excluded_sources:
            return
        if ENCODER in decision.excluded_sources:
            self.encoder_check.set_encoder_offset_from_beacons(time_ns)
        else:
            self.encoder_check.confirm(time_ns)
        if SHIP not in decision.excluded_sources:
            self.ship_check.confirm(time_ns)

    def _check_ship(self, sample: ShipSample, outcome: PointingOutcome) -> tuple[Rejection | None, ShipSample]:
        """Check an attitude of the ship and apply detected jumps; return its rejection or None, and its usable part."""
        result = self.ship_check.check(sample, self._estimator.window.oldest_ns)
        if result.rates_wrong_after_ns is not None:
            # Exposures compared with wrong rates are compared again without rates.
            changed_after_ns = self.tracks.ship.drop_rates(result.rates_wrong_after_ns)
            if changed_after_ns is not None:
                self._estimator.rewind_after(changed_after_ns + self.tracks.ship_shift_ns)
                self._estimator.apply(outcome)
        if result.noise is not None:
            self._estimator.rewind_after(self.tracks.ship.add_noise(result.noise) + self.tracks.ship_shift_ns)
            self._estimator.apply(outcome)
        for jump in result.jumps:
            self._record_fault(SHIP, jump.time_ns, None, jumped=True)
            changed_after_ns = self.tracks.ship.add_cut(jump.time_ns)
            time_ns = jump.time_ns + self.tracks.ship_shift_ns  # in the time scale of the exposures
            if changed_after_ns is not None:
                changed_after_ns += self.tracks.ship_shift_ns
            jump = replace(jump, time_ns=time_ns)
            self.jumps.append(StreamJump(jump))
            self._estimator.add_jump(time_ns, "ins", jump, changed_after_ns)
        assert isinstance(result.sample, ShipSample)
        # If the ship's attitude is that of the INS, no rates are used, so that no wrong rate can affect the pointing.
        by_ins = self._config.ship.source == "ins/imu"
        return result.rejection, replace(result.sample, rate_d=None) if by_ins else result.sample

    def _record_fault(self, source: str, time_ns: int, rejection: Rejection | None, jumped: bool = False) -> None:
        """Record the time if the encoder or ship stream was stuck, jumped or repeated a stamp."""
        if jumped or (rejection is not None and rejection.reason in _STREAM_FAULT_REASONS):
            self._fault_ns[source] = max(time_ns, self._fault_ns.get(source, time_ns))

    def _record_encoder_jump(self, time_ns: int, result: CheckedReading) -> None:
        """Record a jump of the encoders, or the first of several stuck readings."""
        if result.jump is not None:
            self.jumps.append(StreamJump(result.jump))
        is_stuck = result.rejection is not None and result.rejection.reason is Reason.STUCK
        if is_stuck and not self._is_stuck:
            self.jumps.append(StreamJump(EncoderJump(time_ns, np.zeros(2), STUCK_SIGMA_RAD)))
        self._is_stuck = is_stuck

    def _check_repeated_time(self) -> None:
        """Apply exposures again if rejections show that encoders and ship both repeat a range of stamps."""
        before = self._repeated_time_ns
        together = self._estimator.stamp_conflicts.common_interval({ENCODER, self._config.ship.source})
        if together is None:
            return
        first_ns = together[0] - self.tracks.reach_ns
        self._repeated_time_ns = first_ns, together[1]
        if before is None or before[0] != first_ns:
            self._estimator.rewind_after(first_ns if before is None else min(before[0], first_ns))
        elif together[1] > before[1]:
            self._estimator.rewind_after(before[1])


def _encoder_limits(config: OpticalAxisConfig) -> tuple[float, float]:
    """Return the noise of a reading, rad, and the largest acceleration of an axis, rad/s²."""
    return config.encoder.sigma_arcsec * ARCSEC, math.radians(config.encoder.max_acceleration_deg_per_s2)
