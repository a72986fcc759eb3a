"""Conversion of the messages of a batch to the core's structs: all regular messages at once.

Each result equals the result of :mod:`theodolite_calib.messages.input_messages` to the last bit. A result None stands
for a message that must be read by that module.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ship_bags.cdr_template import CdrRows
from ship_estimation.time_order.outcome import Status
from ship_geometry.ros_axes import device_vector_from_ros, horizon_covariance, rotation_from_quaternion
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.messages.batch import StampArray
from ship_node.messages.column_checks import (
    ReadRows,
    angular_covariances,
    imu_quaternions,
    read_valid,
    ship_rates,
    stamps,
    unit_quaternions,
)
from ship_node.messages.field_checks import ReadMessage
from theodolite_calib.config import BeaconConfig, OpticalAxisConfig
from theodolite_calib.messages.input_messages import ENCODER_INVALID, without_white
from theodolite_calib.samples.samples import EncoderSample, ShipSample


def encoders(messages: CdrRows, receive_ns: StampArray, config: OpticalAxisConfig) -> ReadRows:
    """Read ``theodolite/encoder``; see :func:`theodolite_calib.messages.input_messages.encoder`."""
    numbers = messages.numbers
    times_ns, good = stamps(numbers, receive_ns)
    angles = np.stack([numbers["azimuth"], numbers["elevation"]], axis=1)
    sigma = numbers["sigma"].astype(np.float64)
    unknown = np.isnan(sigma) | (sigma == 0.0)
    good &= (numbers["status"] != ENCODER_INVALID) & np.isfinite(angles).all(axis=1)
    good &= unknown | ((sigma > 0.0) & (sigma <= 2.0 * np.pi))
    sigma[unknown] = config.encoder.sigma_arcsec * ARCSEC

    def samples() -> Iterator[ReadMessage[Any]]:
        read = map(EncoderSample, times_ns[good].tolist(), angles[good], sigma[good].tolist())
        return map(ReadMessage, read, (~unknown[good]).tolist())

    return read_valid(messages, config.encoder.frame_id, good, samples)


def ship_attitudes(messages: CdrRows, receive_ns: StampArray, config: OpticalAxisConfig) -> ReadRows:
    """Read ``ship/attitude`` with rates and covariances; see ``input_messages.ship_attitude``."""
    numbers = messages.numbers
    times_ns, timely = stamps(numbers, receive_ns)
    quaternions, of_norm_1 = unit_quaternions(numbers)
    rates_ros, of_ship = ship_rates(numbers)
    covariances_enu, positive = angular_covariances(numbers["rotation_covariance"])
    good = timely & of_norm_1 & of_ship & positive & (numbers["status"] < int(Status.INVALID))

    def samples() -> Iterator[ReadMessage[Any]]:
        rotations_nd = rotation_from_quaternion(quaternions[good])
        rates_d = device_vector_from_ros(rates_ros[good])
        slow_n = without_white(horizon_covariance(covariances_enu[good]), config.ship.white_sigma_arcsec)
        status = map(Status, numbers["status"][good].tolist())
        return map(ReadMessage, map(ShipSample, times_ns[good].tolist(), rotations_nd, rates_d, slow_n, status))

    return read_valid(messages, config.ship.frame_id, good, samples)


def drone_attitudes(messages: CdrRows, receive_ns: StampArray, beacon: BeaconConfig) -> ReadRows:
    """Read ``beacon/<id>/imu``; see :func:`theodolite_calib.messages.input_messages.drone_attitude`."""
    times_ns, timely = stamps(messages.numbers, receive_ns)
    quaternions, given = imu_quaternions(messages.numbers, beacon.imu.accept_unset_covariance)
    good = timely & given

    def samples() -> Iterator[ReadMessage[Any]]:
        rotations_nb = rotation_from_quaternion(quaternions[good], beacon.imu.convention)
        return map(ReadMessage, map(AttitudeSample, times_ns[good].tolist(), rotations_nb))

    return read_valid(messages, beacon.imu.frame_id, good, samples)
