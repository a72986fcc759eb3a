"""The carrier that a scenario asks for."""

import functools

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag
from ship_geometry.ros_axes import rotation_from_quaternion
from ship_geometry.rotations import FloatArray
from ship_simulation.draws.noise import SECOND_NS, random_stream
from ship_simulation.draws.sea import Response, ship_phasors, wave_components
from ship_simulation.scenario.motion_scenario import CarrierMotion, Recording, Sea
from ship_simulation.ship.motion import Carrier, HarmonicMotion, RecordedMotion, SteadyTurn

_IMU = "sensor_msgs/msg/Imu"

RECORDING_MARGIN_S = 1.0
"""Simulated time zero lies this long after the begin of a recording, so that time offsets do not leave it."""


def carrier_of(motion: CarrierMotion, seed: int) -> Carrier:
    """The motion of the ship; the phases of a sea come from the seed.

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
    """How (heading, pitch, roll) answer the waves: pitch to the slope along the ship, roll to that across."""
    along, across = np.cos(np.deg2rad(sea.direction_deg)), np.sin(np.deg2rad(sea.direction_deg))
    return (
        Response(along * across, sea.heading_gain, sea.heading_period_s, sea.heading_damping, sea.heading_length_m),
        Response(along, sea.pitch_gain, sea.pitch_period_s, sea.pitch_damping, sea.pitch_length_m),
        Response(across, sea.roll_gain, sea.roll_period_s, sea.roll_damping, sea.roll_length_m),
    )


def _sea_components(sea: Sea, rng: np.random.Generator) -> tuple[FloatArray, np.ndarray]:
    frequency, elevation = wave_components(sea.significant_height_m, sea.modal_period_s, sea.component_count, rng)
    return frequency, ship_phasors(frequency, elevation, sea_responses(sea))


@functools.lru_cache(maxsize=4)
def read_recording(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Moments (s, from the first) and attitudes (horizon from deck) of a recorded Imu topic.

    Raises:
        BadInput: the bag cannot be read, or has no such topic, or fewer than three attitudes.
    """
    time_ns, quaternions = [], []
    with read_bag(recording.bag) as bag:
        found = bag.topics.get(recording.topic)
        if found != _IMU:
            there = f"carries {found}" if found else f"is not there (it has: {', '.join(sorted(bag.topics))})"
            raise BadInput(f"{recording.bag}: topic '{recording.topic}' {there}: expected {_IMU}")
        for record in bag.records([recording.topic]):
            message = record.decode()
            time_ns.append(message.header.stamp.sec * SECOND_NS + message.header.stamp.nanosec)
            q = message.orientation
            quaternions.append((q.x, q.y, q.z, q.w))
    unique_ns, first = np.unique(np.array(time_ns, dtype=np.int64), return_index=True)
    if unique_ns.size < 3:
        raise BadInput(f"{recording.bag}: topic '{recording.topic}' has {unique_ns.size} attitudes: expected 3 or more")
    return (unique_ns - unique_ns[0]) / SECOND_NS, rotation_from_quaternion(np.array(quaternions)[first])
