"""Cost of encoding and decoding a message by templates, relative to encoding and decoding by message objects."""

from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from bench_rows import Row, alternate, median_ratio, median_us
from ship_bags.message_factory import CdrReader, RosidlFactory, message_class
from ship_bags.message_store import RosbagsFactory, message_store, serialize
from ship_estimation.parameters.ship_devices import InsInputConfig
from ship_node.messages.sensor_readers import ins_sample

ROUNDS = 5
MOST_TEMPLATE_RATIO = 0.5
MOST_READ_RATIO = 0.85
"""Maximum ratios of the times by templates to the times by message objects: encoding, and decoding with checks."""

_IMU_TYPE = "sensor_msgs/msg/Imu"


def message_cost() -> list[Row]:
    """Measure encoding and decoding of a sensor_msgs/Imu by templates and by objects of rosbags and rclpy."""
    offline, live, kind = RosbagsFactory(), RosidlFactory(), message_class(_IMU_TYPE)
    vector = dict.fromkeys("xyz", 0.25)
    unknown = (0.0,) * 9
    fields = {
        "header": {"stamp": 1_700_000_000_123_456_789, "frame_id": "ins"},
        "orientation": {**vector, "w": 0.9},
        "angular_velocity": vector,
        "linear_acceleration": vector,
        **{f"{name}_covariance": unknown for name in ("orientation", "angular_velocity", "linear_acceleration")},
    }
    data = serialize(offline.make(_IMU_TYPE, **fields))
    assert live.encode(_IMU_TYPE, **fields).__cdr__ == data
    reader, store, config = CdrReader(_IMU_TYPE, live.definition), message_store(), InsInputConfig()

    def sample_of(message: Any) -> None:
        ins_sample(message, config, 1_800_000_000_000_000_000)

    made_us, by_rosbags_us, by_rclpy_us, read_us, read_by_rosbags_us, read_by_rclpy_us = alternate(
        ROUNDS,
        lambda: median_us(lambda: live.encode(_IMU_TYPE, **fields)),
        lambda: median_us(lambda: serialize(offline.make(_IMU_TYPE, **fields))),
        lambda: median_us(lambda: serialize_message(live.make(_IMU_TYPE, **fields))),
        lambda: median_us(lambda: sample_of(reader.message(data))),
        lambda: median_us(lambda: sample_of(store.deserialize_cdr(data, _IMU_TYPE))),
        lambda: median_us(lambda: sample_of(deserialize_message(data, kind))),
    )
    read_by_rosbags, read_by_rclpy = median_ratio(read_us, read_by_rosbags_us), median_ratio(read_us, read_by_rclpy_us)
    return [
        Row("Imu made as bytes by its template: median", float(np.median(made_us)), "us"),
        Row("ratio: by its template / by rosbags", median_ratio(made_us, by_rosbags_us), "x", MOST_TEMPLATE_RATIO),
        Row("ratio: by its template / by rclpy", median_ratio(made_us, by_rclpy_us), "x", MOST_TEMPLATE_RATIO),
        Row("Imu read into a sample by its template: median", float(np.median(read_us)), "us"),
        Row("ratio: read by its template / by rosbags", read_by_rosbags, "x"),
        Row("ratio: read by its template / by rclpy", read_by_rclpy, "x", MOST_READ_RATIO),
    ]
