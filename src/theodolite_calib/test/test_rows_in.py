"""Messages read as a batch equal those read one by one, to the last bit; irregular ones are not read as a batch."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory
from ship_node.messages.field_checks import MessageRejected, ReadMessage
from ship_testing.message_rows import rows
from ship_testing.small_session import config
from theodolite_calib.messages import input_messages

START_NS, COUNT = 1_400_000_000_000_000_000, 60
FACTORY = RosbagsFactory()
CONFIG = config()
BEACON = CONFIG.beacons["alpha"]
NAN = float("nan")

KINDS: dict[str, tuple[str, Callable[..., Any], Callable[..., Any], dict[str, list[Any]]]] = {
    "encoder": (
        "ship_msgs/msg/TheodoliteEncoder",
        functools.partial(input_messages.encoder, config=CONFIG),
        functools.partial(input_messages.encoders, config=CONFIG),
        {
            "sigma": [0.0, NAN, -1e-6, 7.0, float("inf")],
            "status": [1, 2],
            "azimuth": [NAN, 400.0],
            "elevation": [float("inf")],
        },
    ),
    "ship": (
        "ship_msgs/msg/ShipAttitude",
        functools.partial(input_messages.ship_attitude, config=CONFIG),
        functools.partial(input_messages.ship_attitudes, config=CONFIG),
        {
            "orientation": [dict.fromkeys("xyzw", 0.0), dict.fromkeys("xyzw", NAN), dict.fromkeys("xyzw", 1e200)],
            "rotation_covariance": [
                np.zeros(9),
                np.full(9, NAN),
                np.full(9, -1.0),
                -np.eye(3).ravel(),
                np.ones(9),
                np.diag([1.0, 0.0, 1.0]).ravel(),
                100.0 * np.eye(3).ravel(),
                (1e-9 * np.eye(3) + np.eye(3, k=1)).ravel(),
            ],
            "angular_velocity": [dict.fromkeys("xyz", NAN), dict.fromkeys("xyz", 101.0)],
            "status": [2, 3, 4],
        },
    ),
    "drone": (
        "sensor_msgs/msg/Imu",
        functools.partial(input_messages.drone_attitude, beacon=BEACON),
        functools.partial(input_messages.drone_attitudes, beacon=BEACON),
        {
            "orientation": [dict.fromkeys("xyzw", 0.0), {**dict.fromkeys("xyz", NAN), "w": 1.0}],
            "orientation_covariance": [np.r_[-1.0, np.zeros(8)]],
        },
    ),
}
FRAMES = {"encoder": "theodolite_base", "ship": "deck", "drone": ""}
STAMPS = [0, 5, START_NS + 10**12]


def fields(kind: str, number: int) -> dict[str, Any]:
    rng = np.random.default_rng(number)
    quaternion = rng.standard_normal(4)
    quaternion *= rng.uniform(0.995, 1.005) / np.linalg.norm(quaternion)
    root = 1e-5 * rng.standard_normal((3, 3))
    orientation = dict(zip("xyzw", quaternion.tolist(), strict=True))
    rate = dict(zip("xyz", rng.standard_normal(3).tolist(), strict=True))
    header = {"stamp": START_NS + 10_000_000 * number, "frame_id": FRAMES[kind]}
    nine = np.zeros(9)
    if kind == "encoder":
        azimuth, elevation = rng.uniform(-1.0, 1.0, 2).tolist()
        return {"header": header, "azimuth": azimuth, "elevation": elevation, "sigma": 5e-6, "status": 0}
    if kind == "drone":
        return {
            "header": header,
            "orientation": orientation,
            "orientation_covariance": nine,
            "angular_velocity": rate,
            "angular_velocity_covariance": nine,
            "linear_acceleration": {"x": 0.0, "y": 0.0, "z": 9.8},
            "linear_acceleration_covariance": nine,
        }
    angles = {"heading": 1.0, "pitch": 0.1, "roll": 0.1, "covariance": (root @ root.T).ravel()}
    rotation = {"orientation": orientation, "rotation_covariance": (root @ root.T).ravel(), "angular_velocity": rate}
    return {"header": header, **angles, **rotation, "status": 0, "horizon": 0, "sources": ["ins"], "star_age_s": 1.0}


def content(reading: ReadMessage[Any]) -> tuple[Any, ...]:
    return reading.value.time_ns, reading.value.content(), reading.covariance_known, type(reading.value)


@pytest.mark.parametrize("kind", KINDS)
def test_messages_read_together_are_those_read_alone(kind: str) -> None:
    type_name, read, read_rows, odd = KINDS[kind]
    changes = [{name: value} for name, values in odd.items() for value in values]
    changes += [{"header": {"stamp": stamp, "frame_id": FRAMES[kind]}} for stamp in STAMPS]
    changes += [{}] * (COUNT - len(changes))
    messages = [FACTORY.make(type_name, **{**fields(kind, n), **changed}) for n, changed in enumerate(changes)]
    block, receive_ns = rows(type_name, messages), START_NS + 10_000_000 * np.arange(COUNT)
    found = read_rows(block, receive_ns)
    for number, reading in enumerate(found):
        if reading is not None:
            assert content(reading) == content(read(block.message(number), receive_ns=int(receive_ns[number])))
    assert sum(reading is not None for reading in found) > COUNT // 2


@pytest.mark.parametrize("kind", KINDS)
def test_messages_rejected_alone_are_not_read_in_a_batch(kind: str) -> None:
    type_name, read, read_rows, odd = KINDS[kind]
    for changed in [{name: value} for name, values in odd.items() for value in values]:
        message = FACTORY.make(type_name, **{**fields(kind, 0), **changed})
        try:
            read(message, receive_ns=START_NS)
        except MessageRejected:
            assert read_rows(rows(type_name, [message]), np.array([START_NS])) == [None]
