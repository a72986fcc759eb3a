"""Star attitudes read as a block equal those read singly, to the last bit; for others the block returns None."""

import functools
from typing import Any

import numpy as np
import pytest

from ship_attitude_star.messages import input_messages
from ship_attitude_star.ship_attitude.config import StarSensorConfig
from ship_bags.message_store import RosbagsFactory
from ship_estimation.parameters.schema import build
from ship_geometry.rotations import FloatArray
from ship_node.messages.field_checks import MessageRejected, ReadMessage
from ship_stars.attitude_samples import SHARED_BY_MESSAGES, SHARED_BY_SKY, AttitudeMeasurement
from ship_testing.message_rows import rows

TYPE, FRAME = "ship_msgs/msg/StarHorizonAttitude", "star_bow"
START_NS, COUNT = 1_400_000_000_000_000_000, 60
FACTORY = RosbagsFactory()
NAN = float("nan")

ODD: list[dict[str, Any]] = [
    *({"azimuth": value} for value in (NAN, float("inf"), 7.0, 45.0)),
    *({"elevation": value} for value in (NAN, 1.6, -30.0)),
    *({"roll": value} for value in (NAN, -7.0)),
    *(
        {name: value}
        for name in ("rotation_covariance", "noise_covariance")
        for value in (
            np.zeros(9),
            np.full(9, NAN),
            np.full(9, -1.0),
            -np.eye(3).ravel(),
            np.diag([1e-9, 0.0, 1e-9]).ravel(),
            100.0 * np.eye(3).ravel(),
            (1e-9 * np.eye(3) + np.eye(3, k=1)).ravel(),
        )
    ),
    {"noise_covariance": 1e-8 * np.eye(3).ravel()},  # larger than the total
    {"status": 3},
    *({"header": {"stamp": stamp, "frame_id": FRAME}} for stamp in (0, 5, START_NS + 10**12)),
    {"header": {"stamp": START_NS, "frame_id": "deck"}},
]
SAME_LAYOUT = [odd for odd in ODD if odd.get("header", {}).get("frame_id", FRAME) == FRAME]


def covariance(rng: np.random.Generator) -> FloatArray:
    root = 1e-5 * rng.standard_normal((3, 3))
    found: FloatArray = (root @ root.T).ravel()
    return found


def message(number: int, **changed: Any) -> Any:
    rng = np.random.default_rng(number)
    azimuth, elevation, roll = rng.uniform([0.0, -1.5, -3.0], [6.28, 1.5, 3.0]).tolist()
    noise = covariance(rng)
    fields = {
        "header": {"stamp": START_NS + 10_000_000 * number, "frame_id": FRAME},
        "sensor_id": "bow",
        "azimuth": azimuth,
        "elevation": elevation,
        "roll": roll,
        "covariance": covariance(rng),
        "rotation_covariance": noise + covariance(rng) if number % 2 else noise,
        "noise_covariance": noise,
        "star_count": 8,
        "rejected_count": 0,
        "residual_rms": 1e-5,
        "status": number % 3,
    }
    return FACTORY.make(TYPE, **{**fields, **changed})


def star(sharing: str) -> StarSensorConfig:
    mounted = {"azimuth_deg": 0.0, "elevation_deg": 60.0}
    return build(StarSensorConfig, {**mounted, "frame_id": FRAME, "shared": sharing}, prefix="")


def content(reading: ReadMessage[AttitudeMeasurement]) -> tuple[Any, ...]:
    properties = {name: getattr(reading.value, name) for name in ("source", "shared_by", "covariance_known")}
    return type(reading.value), reading.value.time_ns, reading.value.content(), reading.covariance_known, properties


@pytest.mark.parametrize("sharing", [SHARED_BY_SKY, SHARED_BY_MESSAGES, "none"])
def test_messages_read_as_a_block_equal_those_read_singly(sharing: str) -> None:
    read = functools.partial(input_messages.star_measurement, sensor_id="bow", config=star(sharing))
    changes = SAME_LAYOUT + [{}] * (COUNT - len(SAME_LAYOUT))
    block = rows(TYPE, [message(number, **changed) for number, changed in enumerate(changes)])
    receive_ns = START_NS + 10_000_000 * np.arange(COUNT)
    found = input_messages.star_attitudes(block, receive_ns, "bow", star(sharing))
    for number, reading in enumerate(found):
        if reading is not None:
            alone = read(block.message(number), receive_ns=int(receive_ns[number]))
            assert content(reading) == content(alone)
    assert [reading is None for reading in found[len(SAME_LAYOUT) :]] == [False] * (COUNT - len(SAME_LAYOUT))


def test_messages_rejected_singly_are_not_read_as_a_block() -> None:
    config, receive_ns, rejected = star(SHARED_BY_MESSAGES), START_NS + 10_000_000, 0
    for changed in ODD:
        one = message(1, **changed)
        try:
            input_messages.star_measurement(one, "bow", config, receive_ns)
        except MessageRejected:
            rejected += 1
            assert input_messages.star_attitudes(rows(TYPE, [one]), np.array([receive_ns]), "bow", config) == [None]
    assert rejected > len(ODD) // 2
