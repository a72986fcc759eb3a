"""What was measured so far, each source in a track of its own, and what each source says at one moment.

The encoders, the ship, the baseline to each drone and the attitude of each drone have their own stamps and rates. Each
is interpolated at the moment asked for, and says how much noise it has there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ship_estimation.outcome import Status
from ship_estimation.refusals import Reason, Refusal
from ship_geometry.attitude_track import AttitudeTrack
from ship_geometry.exposure_mean import LONGEST_EXPOSURE_S, Nodes, exposure_nodes
from ship_geometry.rotations import ARCSEC, FloatArray, skew
from ship_geometry.sample_track import SampleTrack
from ship_geometry.time_scales import SECOND_NS
from ship_geometry.vector_track import VectorTrack
from theodolite_calib.chain.axes import AxisErrors, main_axis_rotation
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.measured.baseline_track import BaselineJump, BaselineTrack
from theodolite_calib.measured.contradiction import Streams, ship_crept, streams_since
from theodolite_calib.measured.samples import AnyExposure, EncoderSample, Exposure, ShipSample

_LONGEST_REACH_NS = exposure_nodes(LONGEST_EXPOSURE_S).reach_ns
_FULL_TURN = 2.0 * np.pi
_LOOKED_BACK_NS = 3 * SECOND_NS
"""So long back the encoders and the ship's attitude are looked at where lights contradict them."""
_BEFORE_NS = SECOND_NS
"""And so much longer, for what they did before."""

_CREPT_WITHIN_NS = 60 * SECOND_NS
"""So long back the ship's attitude is compared with its own rates where lights creep away from it."""

_DROP_EVERY_NS = SECOND_NS // 10
"""What is not needed any more is forgotten so often, not at each sample."""


@dataclass(frozen=True)
class ShipAt:
    """The ship's attitude at one moment.

    Attributes:
        rotation_nd: horizon from deck, shape (3, 3).
        rate_d: angular velocity in the deck frame, rad/s, shape (3,).
        slow_covariance_n: as in :class:`theodolite_calib.measured.samples.ShipSample`.
        noise: variance of each component of what is new with each sample, and of interpolation, rad².
        status: what the source says that it is worth; between two attitudes, of the lesser one.
        chord_nd: horizon from deck as tf2 gives it, which turns steadily from one ship/attitude to the next; None where
            the attitude is that of the INS alone.
    """

    rotation_nd: FloatArray
    rate_d: FloatArray
    slow_covariance_n: FloatArray | None
    noise: float
    status: Status = Status.VALID
    chord_nd: FloatArray | None = None


@dataclass(frozen=True)
class ShipRun:
    """The ship's attitude at N moments; each field is that of :class:`ShipAt`.

    Attributes:
        rotation_nd: shape (N, 3, 3).
        rate_d: shape (N, 3).
        slow_covariance_n: shape (N, 3, 3); None where the configuration states it.
        noise: shape (N,).
        status: N of them.
        chord_nd: shape (N, 3, 3); None where the attitude is that of the INS alone.
    """

    rotation_nd: FloatArray
    rate_d: FloatArray
    slow_covariance_n: FloatArray | None
    noise: FloatArray
    status: list[Status]
    chord_nd: FloatArray | None

    @classmethod
    def of(cls, ships: Sequence[ShipAt]) -> "ShipRun":
        """The run of some moments, all of one source, whose covariances are stated by the same."""
        slow_n = [ship.slow_covariance_n for ship in ships if ship.slow_covariance_n is not None]
        chords_nd = [ship.chord_nd for ship in ships if ship.chord_nd is not None]
        return cls(
            rotation_nd=np.array([ship.rotation_nd for ship in ships]),
            rate_d=np.array([ship.rate_d for ship in ships]),
            slow_covariance_n=np.array(slow_n) if slow_n else None,
            noise=np.array([ship.noise for ship in ships]),
            status=[ship.status for ship in ships],
            chord_nd=np.array(chords_nd) if chords_nd else None,
        )


@dataclass(frozen=True)
class EncoderAt:
    """The encoders at one moment.

    Attributes:
        azimuth: rad.
        elevation: rad.
        noise: variance of each, that of interpolation included, rad².
    """

    azimuth: float
    elevation: float
    noise: float


@dataclass(frozen=True)
class LightAt:
    """Where a light is said to be at one moment.

    Attributes:
        baseline_n: from the ship's antenna to the drone's, m, shape (3,).
        covariance_n: of what is new in it, and of interpolation, m², shape (3, 3).
        rotation_nb: horizon from drone, shape (3, 3); the identity where the light is at the drone's antenna.
        jump: of the baseline among its last solutions; None where they go on smoothly.
    """

    baseline_n: FloatArray
    covariance_n: FloatArray
    rotation_nb: FloatArray
    jump: BaselineJump | None = None


class MeasuredTracks:
    """The tracks of one run.

    Args:
        config: the node's parameters.

    Attributes:
        encoder: readings of the encoders.
        ship: attitudes of the ship, in the stamps of their source.
        baselines: from the ship's antenna to each drone's, by beacon_id.
        drones: attitudes of the drones whose light is not at their antenna, by beacon_id.
        ship_shift_ns: the ship's attitudes are valid so much later than their stamps.
        reach_ns: so far from its moment data may lie that an exposure is compared with.
    """

    def __init__(self, config: OpticalAxisConfig) -> None:
        self.reconfigure(config)
        self.ship_shift_ns = round(config.ins.time_offset_s * SECOND_NS) if self._by_ins else 0
        self.encoder: VectorTrack[EncoderSample] = VectorTrack(_ns(config.encoder.max_gap_s), _FULL_TURN)
        self.ship = AttitudeTrack(_ns(config.ins.max_gap_s if self._by_ins else config.ship.max_gap_s))
        self.baselines = {id_: BaselineTrack(_ns(b.rtk.max_gap_s)) for id_, b in config.beacons.items()}
        self._levers_b = {id_: b.light.vector_m for id_, b in config.beacons.items()}
        # The place of a light at the antenna does not depend on the drone's attitude.
        self.drones = {
            id_: AttitudeTrack(_ns(b.imu.max_gap_s)) for id_, b in config.beacons.items() if np.any(b.light.vector_m)
        }
        self.encoder.keeps_ns, self.ship.keeps_ns = _LOOKED_BACK_NS + _BEFORE_NS, _CREPT_WITHIN_NS
        self._dropped_until_ns = -_DROP_EVERY_NS
        self._all: list[SampleTrack[Any]] = [self.encoder, self.ship, *self.baselines.values(), *self.drones.values()]
        widest_gap_ns = max(track.max_gap_ns for track in self._all)
        self.reach_ns = widest_gap_ns + abs(self.ship_shift_ns) + _LONGEST_REACH_NS

    def reconfigure(self, config: OpticalAxisConfig) -> None:
        """Go on with other noise."""
        self._by_ins = config.ship.source == "ins/imu"
        white_arcsec = config.ins.white_sigma_arcsec if self._by_ins else config.ship.white_sigma_arcsec
        self._ship_noise = (white_arcsec * ARCSEC) ** 2

    def drop_before(self, time_ns: int) -> None:
        """Forget what no exposure at or after ``time_ns`` needs; of the last moments nothing yet."""
        if time_ns < self._dropped_until_ns + _DROP_EVERY_NS:
            return
        self._dropped_until_ns, keep_from_ns = time_ns, time_ns - abs(self.ship_shift_ns)
        for track in self._all:
            track.drop_before(keep_from_ns)

    def awaits(self, exposure: AnyExposure) -> bool:
        """True while data still to come may belong to an exposure."""
        # The slowest sources first: most often one of these is awaited.
        for light in exposure.lights if isinstance(exposure, Exposure) else ():
            if not self.baselines[light.beacon_id].covers(exposure.time_ns):
                return True
            drone = self.drones.get(light.beacon_id)
            if drone is not None and not drone.covers(exposure.time_ns):
                return True
        return not self.covers_mount(exposure.time_ns + exposure.reach_ns)

    def covers_mount(self, time_ns: int) -> bool:
        """Whether no data still to come, in order, can change encoders and ship at a moment."""
        return self.encoder.covers(time_ns) and self.ship.covers(time_ns - self.ship_shift_ns)

    @property
    def ship_covered_until_ns(self) -> int | None:
        """The latest moment at which later samples can no longer change the ship's attitude; None for none."""
        until_ns = self.ship.covered_until_ns
        return None if until_ns is None else until_ns + self.ship_shift_ns

    def ship_at(self, time_ns: int, over: Nodes | None = None) -> ShipAt | None:
        """The ship's attitude at a moment; None in a gap.

        Args:
            time_ns: the moment.
            over: moments of an exposure about it that the track spans; the noise is then that of the mean over it.
        """
        attitude = self.ship.at(time_ns - self.ship_shift_ns)
        if attitude is None:
            return None
        sample = attitude.sample
        assert isinstance(sample, ShipSample)
        gain = attitude.noise_gain
        if over is not None:
            gain = self.ship.noise_gain_of_mean(over.moments(time_ns - self.ship_shift_ns))
        noise = gain * self._ship_noise + float(attitude.error_covariance_d.trace())
        # An attitude between two is worth no more than either of them: the source may have jumped there.
        after = attitude.next_sample
        degraded = isinstance(after, ShipSample) and after.status is Status.DEGRADED
        status = Status.DEGRADED if degraded else sample.status
        chord_nd = None if self._by_ins else attitude.chord_nd(time_ns)
        return ShipAt(attitude.rotation_nd, attitude.rate_d, sample.slow_covariance_n, noise, status, chord_nd)

    def encoder_at(self, time_ns: int, over: Nodes | None = None) -> EncoderAt | None:
        """The encoders at a moment; None in a gap. For ``over`` see :meth:`ship_at`."""
        angles = self.encoder.at(time_ns)
        sample = self.encoder.last_before(time_ns)
        if angles is None or sample is None:
            return None
        azimuth, elevation = angles.vector.tolist()
        gain = angles.noise_gain if over is None else self.encoder.noise_gain_of_mean(over.moments(time_ns))
        noise = gain * sample.sigma**2 + float(angles.error_covariance.trace())
        return EncoderAt(azimuth, elevation, noise)

    def main_axis_at(self, moments_ns: list[int], axes: AxisErrors) -> FloatArray | None:
        """Horizon from main frame at m moments by given axis errors, shape (m, 3, 3); None where one is not known."""
        ships, encoders = map(self.ship_at, moments_ns), map(self.encoder_at, moments_ns)
        turned = [
            ship.rotation_nd @ main_axis_rotation(axes, encoder.azimuth, encoder.elevation)
            for ship, encoder in zip(ships, encoders, strict=True)
            if ship is not None and encoder is not None
        ]
        return np.array(turned) if len(turned) == len(moments_ns) else None

    def streams_since(self, since_ns: int, until_ns: int) -> Streams | None:
        """What encoders and ship say by themselves of the time between two moments; None of a time too long ago."""
        if until_ns - since_ns > _LOOKED_BACK_NS:
            return None
        first_ns, shift_ns = since_ns - _BEFORE_NS, self.ship_shift_ns
        ship = self.ship.between(first_ns - shift_ns, until_ns - shift_ns)
        return streams_since(
            since_ns,
            self.encoder.between(first_ns, until_ns),
            [replace(sample, time_ns=sample.time_ns + shift_ns) for sample in ship if isinstance(sample, ShipSample)],
            (self.encoder.max_gap_ns, self.ship.max_gap_ns),
            float(np.sqrt(self._ship_noise)),
        )

    def ship_crept(self, time_ns: int) -> bool | None:
        """Whether the ship's attitude has left its own rates within a minute, and since it last jumped.

        None where nothing tells.
        """
        until_ns = time_ns - self.ship_shift_ns
        first_ns, jumped_ns = until_ns - _CREPT_WITHIN_NS, self.ship.last_cut_ns(until_ns)
        ship = self.ship.between(first_ns if jumped_ns is None else max(first_ns, jumped_ns + 1), until_ns)
        samples = [sample for sample in ship if isinstance(sample, ShipSample)]
        return ship_crept(samples, self.ship.max_gap_ns, float(np.sqrt(self._ship_noise)))

    def light_at(self, beacon_id: str, time_ns: int) -> LightAt | Refusal:
        """Where a light is said to be at a moment, or why that is not known."""
        baseline = self.baselines[beacon_id].usable_at(time_ns)
        if isinstance(baseline, Refusal):
            return baseline
        jump = self.baselines[beacon_id].jump_before(time_ns)
        if beacon_id not in self.drones:
            return LightAt(*baseline, np.eye(3), jump)
        attitude = self.drones[beacon_id].at(time_ns)
        if attitude is None:
            return Refusal(Reason.GAP, "no attitudes of the drone on both sides of the exposure")
        lever_n = attitude.rotation_nd @ self._levers_b[beacon_id]
        by_turn = skew(lever_n)
        interpolated = by_turn @ attitude.error_covariance_n @ by_turn.T
        return LightAt(baseline[0], baseline[1] + interpolated, attitude.rotation_nd, jump)


def _ns(time_s: float) -> int:
    return round(time_s * SECOND_NS)
