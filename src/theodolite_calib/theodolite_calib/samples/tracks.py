"""Tracks of the measured samples, one per source, and interpolated values at one time.

The encoders, the ship, the baseline to each drone and the attitude of each drone have their own stamps and rates. Each
source is interpolated at the requested time, with the noise at that time.

The baselines to a drone are also tested for jumps. A receiver with wrong ambiguities still reports FIXED, with an error
of decimetres. A change to or from such a solution is a step in an otherwise smooth path. Over one or two seconds the
path of a drone is a cubic polynomial. Cubics are fitted to the last solutions by least squares, with a step at each
solution in turn. The noise is the larger of the solutions' scatter about the cubic and their stated noise. In gusts a
step may therefore be missed, but gusts are not reported as a step.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import Status
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, skew
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_geometry.tracks.exposure_mean import LONGEST_EXPOSURE_S, Nodes, exposure_nodes
from ship_geometry.tracks.sample_track import SampleTrack, VectorTrack
from ship_kernels import compiled_tracks
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.samples.samples import AnyExposure, BaselineSample, EncoderSample, Exposure, ShipSample
from theodolite_calib.samples.stream_consistency import StreamConsistency, has_ship_drifted, stream_consistency

_MAX_SOLUTIONS, _MIN_BEFORE_STEP = 14, 5
"""Maximum number of solutions in the fit, and minimum number of solutions before a step."""
_MAX_SPAN_NS = 2 * SECOND_NS
"""Maximum time over which the path of a drone is a cubic, ns."""
_JUMP_SIGMAS = 7.0
"""Threshold of a jump in standard deviations. With ten solutions a second and ten candidate steps, less than one false
jump per voyage exceeds it."""
_CUBIC, _COMPONENTS = 3, 3
_MIN_DEGREES = 9
"""Minimum degrees of freedom of the scatter for the test of a jump."""

_LONGEST_REACH_NS = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns
_STREAM_WINDOW_NS = 3 * SECOND_NS
"""Maximum time range in which the streams of encoders and ship are checked after a contradiction, ns."""
_LEAD_IN_NS = SECOND_NS
"""Time before the checked range from which samples are used too, ns."""
_DRIFT_WINDOW_NS = 60 * SECOND_NS
"""Time range in which the ship's attitude is compared with its rates, ns."""


@dataclass(frozen=True)
class BaselineJump:
    """Jump of a baseline that the flight of the drone cannot explain.

    Attributes:
        time_ns: stamp of the first solution after the jump.
        jump_n: size of the jump (North, Up, East), m, shape (3,).
        sigma_m: standard deviation of each component.
    """

    time_ns: int
    jump_n: FloatArray
    sigma_m: float


class BaselineTrack(VectorTrack[BaselineSample]):
    """Baselines to one drone, valid and rejected; rejected baselines are not used, nor interpolated across."""

    history_ns = _MAX_SPAN_NS

    def baseline_at(self, time_ns: int) -> tuple[FloatArray, FloatArray] | Rejection:
        """Return the baseline at a time (N, U, E), m, and the covariance of its white error, m²; or a rejection."""
        interval = self._interval(time_ns)
        if interval is None:
            return Rejection(Reason.GAP, "no baselines on both sides of the exposure")
        left, fraction = interval
        around = self._samples[left : left + (1 if fraction == 0.0 else 2)]
        for sample in around:
            if sample.rejection is not None:
                return sample.rejection
        baseline = self.at(time_ns)
        assert baseline is not None  # in an interval of good samples
        nearest = around[0] if fraction < 0.5 else around[-1]
        return baseline.vector, baseline.noise_gain * nearest.covariance_n + baseline.error_covariance

    def velocity_at(self, time_ns: int) -> FloatArray:
        """Return the drone's velocity relative to the ship (N, U, E) where :meth:`baseline_at` is valid, m/s.

        The velocity is zero at the stamp of a baseline without a valid neighbour.
        """
        interval = self._interval(time_ns)
        assert interval is not None
        left, fraction = interval
        before, after = self._neighbours(left) if fraction == 0.0 else (left, left + 1)
        if before == after:
            return np.zeros(3)
        velocity: FloatArray = self._change(before, after) / self._seconds(before, after)
        return velocity

    def latest_jump(self, time_ns: int) -> BaselineJump | None:
        """Return the most significant jump among the last solutions; None without a jump.

        The newest of these solutions is the first solution at or after ``time_ns``. Later solutions are not used, so
        that the result does not depend on their arrival.
        """
        interval = self._interval(time_ns)
        if interval is None:
            return None
        last = interval[0] + (interval[1] > 0.0)
        first = last
        while first > 0 and last - first + 1 < _MAX_SOLUTIONS and self._are_joined(first - 1):
            if self._times[last] - self._times[first - 1] > _MAX_SPAN_NS:
                break
            first -= 1
        end, count = last + 1, last + 1 - first
        degrees = _COMPONENTS * (count - _CUBIC - 2)
        if degrees < _MIN_DEGREES:
            return None
        samples = self._samples[first:end]
        position_m = np.array([sample.vector for sample in samples]) - samples[-1].vector
        since = (np.array(self._times[first:end]) - self._times[end - 1]) / _MAX_SPAN_NS
        place, jump_m, weight, squares = compiled_tracks.clearest_step(since, position_m, _MIN_BEFORE_STEP)
        stated = sum(sample.variance_m2 for sample in samples) / (count * _COMPONENTS)
        sigma_m = math.sqrt(max(stated, squares / degrees, 0.0) / weight)
        if not math.hypot(*jump_m.tolist()) > _JUMP_SIGMAS * sigma_m:
            return None
        return BaselineJump(samples[place].time_ns, jump_m, sigma_m)

    def _are_joined(self, left: int) -> bool:
        """True if two baselines are valid and close in time; a jump is no cut, because it is a fault of the drone."""
        start, end = self._samples[left], self._samples[left + 1]
        return start.rejection is None and end.rejection is None and end.time_ns - start.time_ns <= self.max_gap_ns


@dataclass(frozen=True)
class ShipAt:
    """Ship's attitude at one time.

    Attributes:
        rotation_nd: horizon from deck, shape (3, 3).
        rate_d: angular velocity in the deck frame, rad/s, shape (3,).
        correlated_covariance_n: as in :class:`theodolite_calib.samples.samples.ShipSample`.
        noise: variance of each component due to white error and interpolation, rad².
        status: status of the last attitude up to this time; DEGRADED if the next attitude is DEGRADED.
        chord_nd: horizon from deck, interpolated as in tf2 with a constant rate between two messages of ship/attitude;
            None if the source is ins/imu.
    """

    rotation_nd: FloatArray
    rate_d: FloatArray
    correlated_covariance_n: FloatArray | None
    noise: float
    status: Status = Status.VALID
    chord_nd: FloatArray | None = None


@dataclass(frozen=True)
class EncoderAt:
    """Encoders at one time.

    Attributes:
        azimuth: azimuth reading, rad.
        elevation: elevation reading, rad.
        noise: variance of each angle, interpolation included, rad².
    """

    azimuth: float
    elevation: float
    noise: float


@dataclass(frozen=True)
class BeaconAt:
    """Pose of a beacon at one time.

    Attributes:
        baseline_n: vector from the ship's antenna to the drone's antenna, m, shape (3,).
        covariance_n: covariance of the light's position due to baseline noise and interpolation, m², shape (3, 3).
        rotation_nb: horizon from drone, shape (3, 3); the identity if the light is at the drone's antenna.
        jump: jump among the last baselines; None without a jump.
    """

    baseline_n: FloatArray
    covariance_n: FloatArray
    rotation_nb: FloatArray
    jump: BaselineJump | None = None


class MeasuredTracks:
    """Tracks of one run.

    Args:
        config: parameters of the node.

    Attributes:
        encoder: encoder readings.
        ship: attitudes of the ship, with the stamps of their source.
        baselines: baselines from the ship's antenna to each drone's antenna, by beacon_id.
        drones: attitudes of the drones whose light is not at the antenna, by beacon_id.
        ship_shift_ns: time of validity minus stamp of the ship's attitudes, ns.
        reach_ns: maximum time between an exposure and the data with which it is compared, ns.
    """

    def __init__(self, config: OpticalAxisConfig) -> None:
        self.reconfigure(config)
        self.ship_shift_ns = round(config.ins.time_offset_s * SECOND_NS) if self._by_ins else 0
        self.encoder: VectorTrack[EncoderSample] = VectorTrack(_to_ns(config.encoder.max_gap_s), 2.0 * np.pi)
        self.ship = AttitudeTrack(_to_ns(config.ins.max_gap_s if self._by_ins else config.ship.max_gap_s))
        self.baselines = {id_: BaselineTrack(_to_ns(b.rtk.max_gap_s)) for id_, b in config.beacons.items()}
        self._levers_b = {id_: b.light.vector_m for id_, b in config.beacons.items()}
        # The position of a light at the antenna does not depend on the drone's attitude.
        self.drones = {
            id_: AttitudeTrack(_to_ns(b.imu.max_gap_s)) for id_, b in config.beacons.items() if np.any(b.light.vector_m)
        }
        self.encoder.history_ns, self.ship.history_ns = _STREAM_WINDOW_NS + _LEAD_IN_NS, _DRIFT_WINDOW_NS
        self._all: list[SampleTrack[Any]] = [self.encoder, self.ship, *self.baselines.values(), *self.drones.values()]
        widest_gap_ns = max(track.max_gap_ns for track in self._all)
        self.reach_ns = widest_gap_ns + abs(self.ship_shift_ns) + _LONGEST_REACH_NS

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Apply the noise parameters of a changed configuration."""
        self._by_ins = config.ship.source == "ins/imu"
        white_arcsec = config.ins.white_sigma_arcsec if self._by_ins else config.ship.white_sigma_arcsec
        self._ship_noise = (white_arcsec * ARCSEC) ** 2

    def drop_before(self, time_ns: int) -> None:
        """Drop the samples that no exposure at or after ``time_ns`` needs."""
        for track in self._all:
            track.drop_before(time_ns - abs(self.ship_shift_ns))

    def is_waiting_for_data(self, exposure: AnyExposure) -> bool:
        """True if data at the time of an exposure may still come."""
        # The slowest sources are tested first, because data of these sources are missing most often.
        for light in exposure.beacons if isinstance(exposure, Exposure) else ():
            if not self.baselines[light.beacon_id].is_final_at(exposure.time_ns):
                return True
            drone = self.drones.get(light.beacon_id)
            if drone is not None and not drone.is_final_at(exposure.time_ns):
                return True
        return not self.are_axes_final_at(exposure.time_ns + exposure.reach_ns)

    def are_axes_final_at(self, time_ns: int) -> bool:
        """True if later data, received in order, can no longer change encoders and ship at a time."""
        return self.encoder.is_final_at(time_ns) and self.ship.is_final_at(time_ns - self.ship_shift_ns)

    def ship_at(self, time_ns: int, nodes: Nodes | None = None) -> ShipAt | None:
        """Return the ship's attitude at a time; None in a gap.

        Args:
            time_ns: time of the attitude.
            nodes: times within an exposure around ``time_ns``, all within the track. If given, the noise of the mean
                attitude over the exposure is returned.
        """
        attitude = self.ship.at(time_ns - self.ship_shift_ns)
        if attitude is None:
            return None
        sample = attitude.sample
        assert isinstance(sample, ShipSample)
        gain = attitude.noise_gain
        if nodes is not None:
            gain = self.ship.noise_gain_of_mean(nodes.times_and_weights(time_ns - self.ship_shift_ns))
        noise = gain * self._ship_noise + float(attitude.error_covariance_d.trace())
        # Before a DEGRADED attitude the status is DEGRADED, because the source may have jumped in between.
        after = attitude.next_sample
        degraded = isinstance(after, ShipSample) and after.status is Status.DEGRADED
        status = Status.DEGRADED if degraded else sample.status
        chord_nd = None if self._by_ins else attitude.chord_nd(time_ns)
        return ShipAt(attitude.rotation_nd, attitude.rate_d, sample.correlated_covariance_n, noise, status, chord_nd)

    def encoder_at(self, time_ns: int, nodes: Nodes | None = None) -> EncoderAt | None:
        """Return the encoders at a time; None in a gap. For ``nodes`` see :meth:`ship_at`."""
        angles = self.encoder.at(time_ns)
        sample = self.encoder.last_before(time_ns)
        if angles is None or sample is None:
            return None
        azimuth, elevation = angles.vector.tolist()
        gain = angles.noise_gain if nodes is None else self.encoder.noise_gain_of_mean(nodes.times_and_weights(time_ns))
        noise = gain * sample.sigma**2 + float(angles.error_covariance.trace())
        return EncoderAt(azimuth, elevation, noise)

    def axes_at(self, time_ns: int, nodes: Nodes | None = None) -> tuple[ShipAt, EncoderAt] | Rejection:
        """Return ship and encoders at a time, or the rejection for a gap; for ``nodes`` see :meth:`ship_at`."""
        ship, encoder = self.ship_at(time_ns, nodes), self.encoder_at(time_ns, nodes)
        if encoder is None:
            return Rejection(Reason.GAP, "no encoder readings on both sides of the exposure")
        if ship is None:
            return Rejection(Reason.GAP, "no attitudes of the ship on both sides of the exposure")
        return ship, encoder

    def main_axis_over(self, time_ns: int, nodes: Nodes, axes: AxisErrors) -> FloatArray | None:
        """Return horizon from main frame at the nodes of an exposure, shape (m, 3, 3); None in a gap.

        Args:
            time_ns: middle of the exposure.
            nodes: times within the exposure.
            axes: axis errors.
        """
        times_ns = [node_ns for node_ns, _ in nodes.times_and_weights(time_ns)]
        known = [at for at in map(self.axes_at, times_ns) if not isinstance(at, Rejection)]
        if len(known) < len(times_ns):
            return None
        return np.array([ship.rotation_nd @ main_axis_rotation(axes, at.azimuth, at.elevation) for ship, at in known])

    def stream_consistency(self, since_ns: int, until_ns: int) -> StreamConsistency | None:
        """Return the consistency of the encoder and ship streams between two times; None if the range is too long."""
        if until_ns - since_ns > _STREAM_WINDOW_NS:
            return None
        first_ns, shift_ns = since_ns - _LEAD_IN_NS, self.ship_shift_ns
        ship = self.ship.samples_between(first_ns - shift_ns, until_ns - shift_ns)
        return stream_consistency(
            since_ns,
            self.encoder.samples_between(first_ns, until_ns),
            [replace(sample, time_ns=sample.time_ns + shift_ns) for sample in ship if isinstance(sample, ShipSample)],
            (self.encoder.max_gap_ns, self.ship.max_gap_ns),
            float(np.sqrt(self._ship_noise)),
        )

    def has_ship_drifted(self, time_ns: int) -> bool | None:
        """True if the ship's attitude departed from the integral of its rates; None if unknown.

        The last minute is compared, or the time since the last jump of the attitude if this time is shorter.
        """
        until_ns = time_ns - self.ship_shift_ns
        first_ns, jumped_ns = until_ns - _DRIFT_WINDOW_NS, self.ship.last_cut_ns(until_ns)
        ship = self.ship.samples_between(first_ns if jumped_ns is None else max(first_ns, jumped_ns + 1), until_ns)
        samples = [sample for sample in ship if isinstance(sample, ShipSample)]
        return has_ship_drifted(samples, self.ship.max_gap_ns, float(np.sqrt(self._ship_noise)))

    def beacon_at(self, beacon_id: str, time_ns: int) -> BeaconAt | Rejection:
        """Return the pose of a beacon at a time, or a rejection."""
        baseline = self.baselines[beacon_id].baseline_at(time_ns)
        if isinstance(baseline, Rejection):
            return baseline
        jump = self.baselines[beacon_id].latest_jump(time_ns)
        if beacon_id not in self.drones:
            return BeaconAt(*baseline, np.eye(3), jump)
        attitude = self.drones[beacon_id].at(time_ns)
        if attitude is None:
            return Rejection(Reason.GAP, "no attitudes of the drone on both sides of the exposure")
        lever_n = attitude.rotation_nd @ self._levers_b[beacon_id]
        by_turn = skew(lever_n)
        interpolated = by_turn @ attitude.error_covariance_n @ by_turn.T
        return BeaconAt(baseline[0], baseline[1] + interpolated, attitude.rotation_nd, jump)


def _to_ns(time_s: float) -> int:
    return round(time_s * SECOND_NS)
