"""Carriers: the true attitude and angular rate of the ship at any time, also in a sea state.

The angular rate of a carrier is the analytical derivative of its attitude. A sea state is a wave spectrum, to which the
ship responds by a sum of sinusoids. The wave elevation has the two-parameter spectrum of Bretschneider (1959), which
ITTC (15th conference, 1978; Recommended Procedure 7.5-02-07-01.1) recommends for the open ocean:

    S(w) = 5/16 Hs² wp⁴ / w⁵ exp(-5/4 (wp / w)⁴)

Hs is the significant wave height, w the angular frequency, and wp its modal value. Sea state 5 of STANAG 4194 has Hs of
2.5 m to 4 m, mean 3.25 m, and a modal period of 9.7 s in the North Atlantic.

The response of each angle is a damped resonance, excited by the wave slope averaged over the hull, at zero speed:

    angle / elevation = direction factor * gain * k * sinc(k L / 2) / (1 - (w / wn)² + 2 i z w / wn),  k = w² / g

L is the length of hull that averages the slope, wn the natural frequency, and z the damping ratio.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.frames import rotation_from_angles, rotation_from_quaternion, rotation_vector_from_angle_errors
from ship_geometry.rotations import FloatArray
from ship_simulation.random_draws import random_stream
from ship_simulation.scenario.motion_scenario import CarrierMotion, Recording, Sea

_GRAVITY = 9.80665
"""Standard gravity, m/s²."""

# Multiples of the modal frequency. Only 0.5 % of the variance of the elevation lies outside them, at high frequencies
# to which the hull does not respond.
_LOWEST, _HIGHEST = 0.5, 4.0

_HEADING = 0
"""Index of the heading in (heading, pitch, roll)."""

# Number of times for which the wave components are computed at once, to limit the memory of long runs. A product with
# fewer rows is padded to this number, because the last bits of a product may depend on the number of its rows.
_ROWS_AT_ONCE = 4096

_IMU = "sensor_msgs/msg/Imu"

RECORDING_MARGIN_S = 1.0
"""Time from the begin of a recording to simulated time zero, so that time offsets stay within the recording, s."""


@dataclass(frozen=True)
class Response:
    """Response of one angle of the ship to the slope of the waves.

    Attributes:
        direction_factor: factor of the slope due to the direction of the waves.
        gain: angle per slope of a long wave.
        period_s: natural period.
        damping: damping ratio.
        length_m: length of hull that averages the slope.
    """

    direction_factor: float
    gain: float
    period_s: float
    damping: float
    length_m: float

    def transfer(self, angular_frequency: FloatArray) -> np.ndarray:
        """Return the angle per wave elevation, rad/m, complex, shape (n,)."""
        wave_number = angular_frequency**2 / _GRAVITY
        averaged_slope = wave_number * np.sinc(wave_number * self.length_m / (2.0 * np.pi))
        ratio = angular_frequency * self.period_s / (2.0 * np.pi)
        return self.direction_factor * self.gain * averaged_slope / (1.0 - ratio**2 + 2j * self.damping * ratio)


def wave_components(
    significant_height_m: float, modal_period_s: float, count: int, rng: np.random.Generator
) -> tuple[FloatArray, np.ndarray]:
    """Return a realisation of the sea as sinusoids: angular frequencies, rad/s, and complex amplitudes, m, each (n,).

    Each of the equal frequency bands contains one component with a random frequency, a random phase, and the exact
    variance of the band. Due to the random frequencies the sum is not periodic.
    """
    modal = 2.0 * np.pi / modal_period_s
    edges = modal * np.linspace(_LOWEST, _HIGHEST, count + 1)
    # The integral of the spectrum from 0 to w is Hs² / 16 exp(-5/4 (wp / w)⁴).
    variance = significant_height_m**2 / 16.0 * np.diff(np.exp(-1.25 * (modal / edges) ** 4))
    angular_frequency = edges[:-1] + np.diff(edges) * rng.random(count)
    phase = 2.0 * np.pi * rng.random(count)
    return angular_frequency, np.sqrt(2.0 * variance) * np.exp(1j * phase)


class Carrier(Protocol):
    """The motion of the ship. ``t_s`` contains times in seconds after the start, with any shape (...)."""

    def attitude(self, t_s: FloatArray) -> FloatArray:
        """Return horizon from deck, shape (..., 3, 3)."""

    def body_rate(self, t_s: FloatArray) -> FloatArray:
        """Return the angular velocity in the deck frame (bow, up, starboard), rad/s, shape (..., 3)."""


@dataclass(frozen=True)
class SteadyTurn:
    """A change of heading whose rate rises linearly, is constant, and falls linearly.

    Attributes:
        start_s: begin of the turn.
        angle: total change, rad, clockwise positive.
        rate: greatest rate, rad/s, positive.
        ramp_s: length of the rise and of the fall.
    """

    start_s: float
    angle: float
    rate: float
    ramp_s: float

    def heading(self, t_s: FloatArray) -> FloatArray:
        """Return the change of heading up to ``t_s``, rad."""
        return self._sum_over_corners(0.5 * self._since_corners(t_s) ** 2)

    def heading_rate(self, t_s: FloatArray) -> FloatArray:
        """Return the rate of the change of heading, rad/s."""
        return self._sum_over_corners(self._since_corners(t_s))

    def _since_corners(self, t_s: FloatArray) -> FloatArray:
        """Return the time since each corner of the rate, zero before the corner, shape (..., 4)."""
        steady_s = abs(self.angle) / self.rate
        corners = self.start_s + np.array([0.0, self.ramp_s, steady_s, steady_s + self.ramp_s])
        return np.maximum(np.asarray(t_s, dtype=float)[..., None] - corners, 0.0)

    def _sum_over_corners(self, terms: FloatArray) -> FloatArray:
        # The rate's slope changes by +-slope at each corner.
        slope = np.sign(self.angle) * self.rate / self.ramp_s
        summed: FloatArray = slope * (terms @ np.array([1.0, -1.0, -1.0, 1.0]))
        return summed


class HarmonicMotion:
    """Heading, pitch and roll as sums of sinusoids about means, and turns.

    Args:
        mean: (heading, pitch, roll), rad, shape (3,).
        angular_frequency: angular frequency of each component, rad/s, shape (n,).
        phasor: complex amplitude of each component in each angle, rad, shape (n, 3): a component adds
            Re(phasor * exp(i w t)) to the angle.
        turns: turns, whose changes of heading are added to the heading.
    """

    def __init__(
        self,
        mean: FloatArray,
        angular_frequency: FloatArray,
        phasor: np.ndarray,
        turns: Sequence[SteadyTurn] = (),
    ) -> None:
        self.mean = np.asarray(mean, dtype=float)
        self.angular_frequency = np.asarray(angular_frequency, dtype=float)
        self.phasor = np.asarray(phasor, dtype=complex).reshape(self.angular_frequency.size, 3)
        self.turns = tuple(turns)

    def attitude(self, t_s: FloatArray) -> FloatArray:
        """See :class:`Carrier`."""
        return rotation_from_angles(*np.moveaxis(self.angles(t_s), -1, 0))

    def body_rate(self, t_s: FloatArray) -> FloatArray:
        """See :class:`Carrier`."""
        # Both sums in one pass, because the sines dominate the computing time.
        rate_phasor = 1j * self.angular_frequency[:, None] * self.phasor
        both = self._harmonics(t_s, np.hstack([self.phasor, rate_phasor]))
        harmonics, rates = np.split(both, 2, axis=-1)
        angles = self.mean + harmonics
        for turn in self.turns:
            angles[..., _HEADING] += turn.heading(t_s)
            rates[..., _HEADING] += turn.heading_rate(t_s)
        heading, pitch, roll = np.moveaxis(angles, -1, 0)
        rate_n = rotation_vector_from_angle_errors(heading, pitch) @ rates[..., None]
        rotation_nd = rotation_from_angles(heading, pitch, roll)
        return (np.swapaxes(rotation_nd, -1, -2) @ rate_n)[..., 0]

    def angles(self, t_s: FloatArray) -> FloatArray:
        """Return heading, pitch, roll, rad, shape (..., 3)."""
        angles = self.mean + self._harmonics(t_s, self.phasor)
        for turn in self.turns:
            angles[..., _HEADING] += turn.heading(t_s)
        return angles

    def _harmonics(self, t_s: FloatArray, phasor: np.ndarray) -> FloatArray:
        """Return the real part of the sum of phasor (n, k) * exp(i w t) over the components, shape (..., k)."""
        t_s = np.asarray(t_s, dtype=float)
        flat = t_s.reshape(-1, 1)
        summed = np.empty((flat.shape[0], phasor.shape[1]))
        for first in range(0, flat.shape[0], _ROWS_AT_ONCE):
            rows = slice(first, first + _ROWS_AT_ONCE)
            angle = flat[rows] * self.angular_frequency
            waves = np.zeros((2, _ROWS_AT_ONCE, self.angular_frequency.size))
            waves[0, : len(angle)], waves[1, : len(angle)] = np.cos(angle), np.sin(angle)
            whole = waves[0] @ phasor.real - waves[1] @ phasor.imag
            summed[rows] = whole[: len(angle)]
        return summed.reshape(*t_s.shape, phasor.shape[1])


class RecordedMotion:
    """A recorded attitude, interpolated by a rotation spline (twice differentiable).

    Args:
        time_s: times of the record, in seconds from any zero, increasing, shape (n,).
        rotation_nd: horizon from deck, shape (n, 3, 3).
        start_s: time of the record at the start of the simulation.
    """

    def __init__(self, time_s: FloatArray, rotation_nd: FloatArray, start_s: float = 0.0) -> None:
        self._start_s = start_s
        self._spline = RotationSpline(np.asarray(time_s, dtype=float), Rotation.from_matrix(rotation_nd))

    def attitude(self, t_s: FloatArray) -> FloatArray:
        """See :class:`Carrier`.

        Raises:
            BadInput: the record does not cover the time.
        """
        t_s = np.asarray(t_s, dtype=float)
        rotation_nd: FloatArray = self._spline(self._record_time(t_s)).as_matrix()
        return rotation_nd.reshape(*t_s.shape, 3, 3)

    def body_rate(self, t_s: FloatArray) -> FloatArray:
        """See :class:`Carrier`.

        Raises:
            BadInput: the record does not cover the time.
        """
        t_s = np.asarray(t_s, dtype=float)
        rate: FloatArray = self._spline(self._record_time(t_s), 1)
        return rate.reshape(*t_s.shape, 3)

    def _record_time(self, t_s: FloatArray) -> FloatArray:
        moments = t_s.ravel() + self._start_s
        first, last = self._spline.times[0], self._spline.times[-1]
        if moments.size and (moments.min() < first or moments.max() > last):
            raise BadInput(
                f"the recorded motion lasts {last - first:.1f} s, the simulation needs "
                f"{np.ptp(moments):.1f} s from {self._start_s - first:.1f} s after its start: reduce duration_s"
            )
        return moments


def make_carrier(motion: CarrierMotion, seed: int) -> Carrier:
    """Return the motion of the ship; the phases of a sea depend on the seed.

    Raises:
        BadInput: the recording cannot be used.
    """
    if motion.kind == "recorded":
        time_s, rotation_nd = read_recording(motion.recording)
        return RecordedMotion(time_s, rotation_nd, start_s=RECORDING_MARGIN_S)
    angles = (motion.heading, motion.pitch, motion.roll)
    waves = [(index, wave) for index, angle in enumerate(angles) for _, wave in sorted(angle.waves.items())]
    frequency = np.array([2.0 * np.pi / wave.period_s for _, wave in waves])
    phasor = np.zeros((len(waves), 3), dtype=complex)
    for row, (index, wave) in enumerate(waves):
        # A sin(w t + p) = Re(-i A exp(i p) exp(i w t))
        phasor[row, index] = -1j * np.deg2rad(wave.amplitude_deg) * np.exp(1j * wave.phase_rad)
    if motion.kind == "sea_state":
        sea_frequency, sea_phasor = _sea_components(motion.sea, random_stream(seed, "sea"))
        frequency, phasor = np.append(frequency, sea_frequency), np.vstack([phasor, sea_phasor])
    turn = motion.turn
    turns = [SteadyTurn(turn.start_s, np.deg2rad(turn.angle_deg), np.deg2rad(turn.rate_deg_per_s), turn.ramp_s)]
    mean = np.deg2rad([angle.mean_deg for angle in angles])
    return HarmonicMotion(mean, frequency, phasor, turns if turn.angle_deg else [])


def sea_responses(sea: Sea) -> tuple[Response, Response, Response]:
    """Return the responses of (heading, pitch, roll) to the slope of the sea."""
    along, across = np.cos(np.deg2rad(sea.direction_deg)), np.sin(np.deg2rad(sea.direction_deg))
    return (
        Response(along * across, sea.heading_gain, sea.heading_period_s, sea.heading_damping, sea.heading_length_m),
        Response(along, sea.pitch_gain, sea.pitch_period_s, sea.pitch_damping, sea.pitch_length_m),
        Response(across, sea.roll_gain, sea.roll_period_s, sea.roll_damping, sea.roll_length_m),
    )


def _sea_components(sea: Sea, rng: np.random.Generator) -> tuple[FloatArray, np.ndarray]:
    """Return each wave's frequency, rad/s, (n,), and complex amplitude of (heading, pitch, roll), rad, (n, 3)."""
    frequency, elevation = wave_components(sea.significant_height_m, sea.modal_period_s, sea.component_count, rng)
    phasors = [elevation * response.transfer(frequency) for response in sea_responses(sea)]
    return frequency, np.stack(phasors, axis=-1)


@functools.lru_cache(maxsize=4)
def read_recording(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return times (s, from the first) and attitudes (horizon from deck) of a recorded Imu topic.

    Raises:
        BadInput: the bag cannot be read, has no Imu topic of this name, or has fewer than three different stamps.
    """
    time_ns, quaternions = [], []
    with read_bag(recording.bag) as bag:
        found = bag.topics.get(recording.topic)
        if found != _IMU:
            there = f"has type {found}" if found else f"does not exist (topics: {', '.join(sorted(bag.topics))})"
            raise BadInput(f"topic '{recording.topic}' {there}: expected {_IMU}", file=recording.bag)
        for record in bag.records([recording.topic]):
            message = record.decode()
            time_ns.append(message.header.stamp.sec * SECOND_NS + message.header.stamp.nanosec)
            q = message.orientation
            quaternions.append((q.x, q.y, q.z, q.w))
    unique_ns, first = np.unique(np.array(time_ns, dtype=np.int64), return_index=True)
    if unique_ns.size < 3:
        text = f"topic '{recording.topic}' has {unique_ns.size} attitudes: expected 3 or more"
        raise BadInput(text, file=recording.bag)
    return (unique_ns - unique_ns[0]) / SECOND_NS, rotation_from_quaternion(np.array(quaternions)[first])
