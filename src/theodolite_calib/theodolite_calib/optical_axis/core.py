"""Encoders, ship, baselines and lights in, the main axis out: the core that the node and the replay share.

Knows no ROS, no files, no clock. Measurements enter in any order; within ``lag_s`` each is applied at its own time. A
pointing is published at the stamp of each encoder reading, as soon as the ship's attitude of that moment is there.
Arrivals and ticks are given in the time of waiting, stamps in that of the data: :mod:`ship_estimation.estimator_shell`.
"""

import functools
import math
from collections import deque
from dataclasses import replace
from typing import Any

from ship_estimation.estimator_shell import OutputOrder
from ship_estimation.refusals import Reason, Refusal, failure, same_stamp
from ship_estimation.time_ordered_log import TimeOrderedLog
from ship_geometry.attitude_track import AttitudeSample
from ship_geometry.rotations import ARCSEC
from ship_geometry.sample_track import SECOND_NS, SampleTrack
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.filter.filter import CalibrationFilter, CalibrationState, Jump
from theodolite_calib.filter.judgement import SightingStep
from theodolite_calib.measured.encoder_watch import EncoderWatch
from theodolite_calib.measured.samples import BaselineSample, Decision, EncoderSample, Exposure, Outcome, ShipSample
from theodolite_calib.measured.ship_watch import ShipWatch
from theodolite_calib.measured.sighting import Sighting, SightingAssembler
from theodolite_calib.measured.tracks import MeasuredTracks, insert
from theodolite_calib.optical_axis.calibration import (
    Calibration,
    CalibrationPrior,
    calibration_of,
    prior_of,
    state_from_prior,
)
from theodolite_calib.optical_axis.output import PointingOutput, no_pointing


class OpticalAxisCore:
    """The estimator of the main optical axis.

    Args:
        config: the node's parameters.
    """

    def __init__(self, config: OpticalAxisConfig) -> None:
        self.config = config
        self._lag_ns = round(config.lag_s * SECOND_NS)
        self._start: tuple[CalibrationPrior, int] | None = None
        self._order = OutputOrder()
        self._take_models(config)
        self.reset()

    def start_from(self, prior: CalibrationPrior, now_ns: int) -> list[str]:
        """Reset to a saved calibration; returns what is to be said of it."""
        self._start = (prior, now_ns)
        self.reset()
        return state_from_prior(self.filter, self.config, prior, now_ns)[1]

    def reset(self, clock_jumped: bool = False) -> None:
        """Forget all measurements. After a jump of the clock, outputs may start again at earlier times."""
        initial = self.filter.initial_state()
        if self._start is not None:
            initial, _ = state_from_prior(self.filter, self.config, *self._start)
        self._log: TimeOrderedLog[CalibrationState, Exposure | Jump, Decision | Jump] = TimeOrderedLog(initial)
        self._jumps: list[Jump] = []
        self._tracks = MeasuredTracks(self.config)
        self._sightings = SightingAssembler(self.config, self._tracks)
        self._watch = EncoderWatch(*_encoder_limits(self.config))
        self._ship_watch = ShipWatch(self.config.ins) if self.config.ship.source == "ins/imu" else None
        self._pointing = PointingOutput(self.config, self.filter)
        self._newest_ns = 0
        self._waiting: deque[tuple[EncoderSample, str]] = deque()
        self._encoder_arrival_ns: int | None = None
        if clock_jumped:
            self._order.restart()

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Go on with other noise and gates; geometry and the set of lights stay."""
        self.config = config
        self._take_models(config)
        self._tracks.reconfigure(config)
        self._sightings = SightingAssembler(config, self._tracks)
        self._watch.reconfigure(*_encoder_limits(config))
        if self._ship_watch is not None:
            self._ship_watch.reconfigure(config.ins)
        self._pointing = PointingOutput(config, self.filter)

    def add_encoder(self, sample: EncoderSample, arrival_ns: int | None = None) -> Outcome:
        """A reading of the encoders; the pointing of its moment follows.

        Args:
            sample: the reading.
            arrival_ns: when it came, in the time of waiting; None where each comes at its stamp.
        """
        arrival_ns = sample.time_ns if arrival_ns is None else arrival_ns
        newest = self._tracks.encoder.newest
        latest = newest is None or sample.time_ns > newest.time_ns
        judged = self._watch.judge(sample, self._tracks.encoder, self._late(sample.time_ns))
        if judged.refusal is not None:
            return Outcome(judged.refusal)
        if latest and judged.jump is not None:
            self._tracks.encoder.cut(judged.jump.time_ns)
            self._take_jump("encoder", judged.jump)
        outcome = self._insert(self._tracks.encoder, sample)
        if latest and outcome.refusal is None:
            self._encoder_arrival_ns = arrival_ns
            if self._order.follows(sample.time_ns):
                self._waiting.append((sample, self._watch.doubt))
                self._publish(outcome, arrival_ns)
        return outcome

    def add_ship(self, sample: ShipSample, arrival_ns: int | None = None) -> Outcome:
        """An attitude of the ship; the arrival is that of :meth:`add_encoder`."""
        refusal = self._late(sample.time_ns)
        if refusal is None and self._ship_watch is not None:
            refusal = self._judge_ins(self._ship_watch, sample)
            sample = replace(sample, rate_d=None)
        outcome = self._insert(self._tracks.ship, sample) if refusal is None else Outcome(refusal)
        self._publish(outcome, sample.time_ns if arrival_ns is None else arrival_ns)
        return outcome

    def add_baseline(self, beacon_id: str, sample: BaselineSample) -> Outcome:
        """A baseline to a drone. One that must not be used is refused, and no exposure waits for a better one."""
        outcome = self._add(self._tracks.baselines[beacon_id], sample)
        if outcome.refusal is None:
            outcome.refusal = sample.refusal
        return outcome

    def add_drone_attitude(self, beacon_id: str, sample: AttitudeSample) -> Outcome:
        """An attitude of a drone; not needed where its light is at its antenna."""
        track = self._tracks.drones.get(beacon_id)
        return Outcome() if track is None else self._add(track, sample)

    def add_exposure(self, exposure: Exposure) -> Outcome:
        """Lights on the detector, one or more."""
        refusal = self._late(exposure.time_ns)
        if refusal is not None:
            return Outcome(refusal)
        key = (exposure.time_ns, "")
        known, outcome = self._log.get(key), Outcome()
        if known is not None:
            taken, outcome.refusal = same_stamp(known, exposure)
            if not taken:
                return outcome
        self._log.insert(key, exposure)
        self._advance(exposure.time_ns, outcome)
        return outcome

    def tick(self, now_ns: int, waiting_ns: int | None = None) -> Outcome:
        """Says INVALID, once a second, when no pointing was put out for a second, whatever came in.

        Args:
            now_ns: the time now.
            waiting_ns: the same in the time of waiting; None where the two are one.
        """
        waiting_ns = now_ns if waiting_ns is None else waiting_ns
        outcome = Outcome()
        if self._order.invalid_due(waiting_ns):
            silent = self._encoder_arrival_ns is None or waiting_ns - self._encoder_arrival_ns > SECOND_NS
            missing = "no usable reading of the encoders" if silent else f"no attitude on {self.config.ship.source}"
            outcome.estimates.append(no_pointing(self.filter, now_ns, missing))
        return outcome

    def calibration(self) -> Calibration:
        """What the filter now knows of axis errors, focal length and deformation."""
        return calibration_of(self.filter, self.config, self.state)

    def calibration_to_save(self) -> CalibrationPrior | None:
        """The part of it that the next session can start from; None where nothing was ever sighted."""
        if self.state.used_ns is None:
            return self._start[0] if self._start is not None else None
        return prior_of(self.filter, self.config, self.state)

    @property
    def state(self) -> CalibrationState:
        """The filter's state after the last exposure applied."""
        return self._log.state

    # -- time order -----------------------------------------------------------------------------------------

    def sighting(self, exposure: Exposure) -> Sighting | None:
        """An exposure within ``lag_s`` with all that belongs to it; None where that is not there."""
        return self._sightings.assemble(exposure).sighting

    def _take_models(self, config: OpticalAxisConfig) -> None:
        self.filter = CalibrationFilter(config)
        self._step_to = SightingStep(config, self.filter)

    @property
    def _oldest_ns(self) -> int:
        return self._newest_ns - self._lag_ns

    def _late(self, time_ns: int) -> Refusal | None:
        if time_ns >= self._oldest_ns:
            return None
        late_s = (self._newest_ns - time_ns) / SECOND_NS
        return Refusal(Reason.LATE, f"{late_s:.3f} s behind the newest data: more than lag_s = {self.config.lag_s:g}")

    def _add(self, track: SampleTrack[Any], sample: Any) -> Outcome:
        refusal = self._late(sample.time_ns)
        return Outcome(refusal) if refusal is not None else self._insert(track, sample)

    def _insert(self, track: SampleTrack[Any], sample: Any) -> Outcome:
        inserted = insert(track, sample)
        outcome, changed_after_ns = Outcome(inserted.refusal), inserted.changed_after_ns
        if inserted.taken:
            if changed_after_ns is not None:
                self._log.rewind_where(lambda decided: _until_ns(decided) > changed_after_ns)
            self._advance(sample.time_ns, outcome)
        return outcome

    def _advance(self, time_ns: int, outcome: Outcome) -> None:
        """Apply what can be applied now, then close the window behind ``lag_s``."""
        self._newest_ns = max(self._newest_ns, time_ns)
        for decision, previous in self._log.apply(self._step, _failed, (self._oldest_ns, self._newest_ns)):
            if isinstance(decision, Jump):
                self._jumps = [jump for jump in self._jumps if jump is not decision]
                continue
            self._tell_watch(decision)
            if previous is None:
                outcome.decisions.append(decision)
            elif not isinstance(previous, Jump) and previous.accepted != decision.accepted:
                outcome.decisions.append(replace(decision, revised=True))
        reach_ns = self._oldest_ns - self._tracks.reach_ns
        self._log.forget_before(reach_ns)
        self._tracks.drop_before(reach_ns)
        if self._ship_watch is not None:
            self._ship_watch.drop_before(reach_ns)

    def _judge_ins(self, watch: ShipWatch, sample: ShipSample) -> Refusal | None:
        """Why a sample of the INS is not used."""
        judged = watch.judge(sample)
        if judged.jump is not None:
            self._tracks.ship.cut(judged.jump.time_ns)
            time_ns = judged.jump.time_ns + self._tracks.ship_shift_ns  # in the time of the exposures
            watch.jumped(time_ns)
            self._take_jump("ins", replace(judged.jump, time_ns=time_ns))
        return judged.refusal

    def _take_jump(self, source: str, jump: Jump) -> None:
        """The state behind a jump is open by as much."""
        self._log.insert((jump.time_ns, source), jump)
        self._jumps.append(jump)

    def _step(
        self, state: CalibrationState, exposure: Exposure | Jump
    ) -> tuple[CalibrationState, Decision | Jump] | None:
        if isinstance(exposure, Jump):
            return self.filter.opened(state, exposure), exposure
        if exposure.time_ns >= self._oldest_ns and self._tracks.awaits(exposure):
            return None
        assembled = self._sightings.assemble(exposure)
        if assembled.sighting is None:
            assert assembled.refusal is not None
            reason, text = assembled.refusal.reason, assembled.refusal.text
            return state, Decision(exposure, reason, text=text, lights_refused=assembled.lights_refused)
        state, decision = self._step_to(state, assembled.sighting, exposure)
        return state, replace(decision, lights_refused=assembled.lights_refused + decision.lights_refused)

    def _tell_watch(self, decision: Decision) -> None:
        if decision.telescope_dt is not None:
            self._watch.see_lights(decision.exposure.time_ns, *decision.telescope_dt)
        if decision.accepted:
            self._watch.confirm(decision.exposure.time_ns)
            if self._ship_watch is not None:
                self._ship_watch.confirm(decision.exposure.time_ns)

    # -- outputs --------------------------------------------------------------------------------------------

    def _publish(self, outcome: Outcome, waiting_ns: int) -> None:
        """The pointings of readings whose moment the ship's attitude now covers."""
        while self._waiting:
            sample, doubt = self._waiting[0]
            if sample.time_ns >= self._oldest_ns and not self._tracks.ship_covers(sample.time_ns):
                return
            self._waiting.popleft()
            if not doubt and self._ship_watch is not None:
                doubt = self._ship_watch.doubt(sample.time_ns)
            ship = self._tracks.ship_at(sample.time_ns)
            if ship is not None and self._order.follows(sample.time_ns):
                try:
                    # A jump counts at once, also where exposures of before it still wait.
                    state = functools.reduce(self.filter.opened, self._jumps, self.state)
                    estimate = self._pointing.estimate(state, sample, ship, doubt)
                except Exception as error:
                    outcome.failures.append((sample.time_ns, failure(error)))
                    continue
                outcome.estimates.append(estimate)
                self._order.claimed(sample.time_ns, waiting_ns)


def _encoder_limits(config: OpticalAxisConfig) -> tuple[float, float]:
    """Noise of a reading, rad, and largest acceleration of an axis, rad/s²."""
    return config.encoder.sigma_arcsec * ARCSEC, math.radians(config.encoder.max_acceleration_deg_per_s2)


def _until_ns(decided: Decision | Jump) -> int:
    """Up to when data matter to what was decided."""
    if isinstance(decided, Jump):
        return decided.time_ns
    return decided.exposure.time_ns + decided.exposure.reach_ns


def _failed(exposure: Exposure | Jump, error: Exception) -> Decision | Jump:
    if isinstance(exposure, Jump):
        return exposure
    refusal = failure(error)
    return Decision(exposure, refusal.reason, text=refusal.text)
