"""Messages of the ship's attitude: fused, or true."""

from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import enu_covariance, flu_from_device_vector, quaternion_from_rotation
from ship_geometry.rotations import FloatArray
from ship_simulation.messages.device_messages import Maker, make_quaternion, make_vector
from ship_simulation.messages.topics import SHIP_ATTITUDE
from ship_simulation.ship.fused_attitude import FusedSamples

DECK_FRAME = "deck"


def fused_maker(samples: FusedSamples, factory: MessageFactory) -> Maker:
    """Maker of ship/attitude."""
    angles = angles_from_rotation(samples.rotation_nd)
    covariances = angle_covariance(samples.covariance_n, angles[:, 0], angles[:, 1]).reshape(-1, 9)
    total = enu_covariance(samples.covariance_n).ravel()
    told = {"rotation_covariance": total, "sources": ["ins", "star"], "star_age_s": 0.0}
    return _maker(samples.time_ns, samples.rotation_nd, samples.rate_d, covariances, told, factory)


def true_attitude_maker(
    time_ns: np.ndarray, rotation_nd: FloatArray, rate_d: FloatArray, factory: MessageFactory
) -> Maker:
    """Maker of truth/attitude."""
    told = {"rotation_covariance": np.zeros(9), "sources": ["truth"], "star_age_s": float("nan")}
    return _maker(time_ns, rotation_nd, rate_d, np.zeros((time_ns.size, 9)), told, factory)


def _maker(
    time_ns: np.ndarray,
    rotation_nd: FloatArray,
    rate_d: FloatArray,
    covariances: FloatArray,
    told: dict[str, Any],
    factory: MessageFactory,
) -> Maker:
    """Maker of ShipAttitude; ``told`` are the fields that all messages have alike."""
    angles = angles_from_rotation(rotation_nd).tolist()
    quaternions = quaternion_from_rotation(rotation_nd).tolist()
    rates = flu_from_device_vector(rate_d).tolist()

    def make(stamp: int, value: int) -> Any:
        heading, pitch, roll = angles[value]
        return factory.make(
            SHIP_ATTITUDE,
            header=make_header(factory, int(time_ns[stamp]), DECK_FRAME),
            heading=heading,
            pitch=pitch,
            roll=roll,
            covariance=covariances[value],
            orientation=make_quaternion(factory, quaternions[value]),
            angular_velocity=make_vector(factory, rates[value]),
            status=0,
            horizon=0,
            **told,
        )

    return make
