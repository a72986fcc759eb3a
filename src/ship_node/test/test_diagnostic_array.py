"""Diagnostics encoded as bytes equal those of the message objects of rclpy and of rosbags."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from ship_bags.message_factory import RosidlFactory
from ship_bags.message_store import RosbagsFactory, message_store, serialize
from ship_node.messages.common_messages import DIAGNOSTICS_TYPE, DiagnosticStatus, Level, diagnostic_array

NOW_NS = 1_700_000_000_123_456_789
STATUSES = [
    DiagnosticStatus("input ins/imu", Level.ERROR, "silent", {"age [s]": "3", "": "0.25 ″"}),
    DiagnosticStatus("", Level.OK, ""),
    DiagnosticStatus("clocks", Level.WARN, "abc", {"a": "", "bb": "1234567", "ccc": "12", "dddd": "1"}),
]


def make_array(factory, statuses, hardware_id):
    """Return the same array by message objects."""
    fields = [
        {
            "level": int(status.level),
            "name": f"node: {status.name}",
            "message": status.message,
            "hardware_id": hardware_id,
            "values": [{"key": key, "value": value} for key, value in status.values.items()],
        }
        for status in statuses
    ]
    return factory.make(DIAGNOSTICS_TYPE, header={"stamp": NOW_NS, "frame_id": ""}, status=fields)


@pytest.mark.parametrize("statuses", [[], STATUSES[:1], STATUSES[:2], STATUSES, STATUSES[::-1]])
@pytest.mark.parametrize("full_name", ["", "/ship/node"])
def test_bytes_are_those_of_message_objects(statuses, full_name):
    array = diagnostic_array(NOW_NS, "node", statuses, full_name)
    assert serialize(array) == serialize(make_array(RosbagsFactory(), statuses, full_name or "node"))
    by_rclpy = deserialize_message(serialize(array), DiagnosticArray)
    assert by_rclpy == make_array(RosidlFactory(), statuses, full_name or "node")


@pytest.mark.parametrize("value", ["", "1", "12", "123", "1234", "12345", "12″"])
def test_the_last_text_is_not_padded(value):
    statuses = [DiagnosticStatus("a", Level.OK, "b", {"key": value})]
    assert serialize(diagnostic_array(NOW_NS, "node", statuses)) == serialize(
        make_array(RosbagsFactory(), statuses, "node")
    )


def test_fields_are_those_of_the_bytes():
    array = diagnostic_array(NOW_NS, "node", STATUSES)
    read = message_store().deserialize_cdr(serialize(array), DIAGNOSTICS_TYPE)
    assert (array.header.stamp.sec, array.header.stamp.nanosec) == divmod(NOW_NS, 10**9)
    for made, status in zip(array.status, read.status, strict=True):
        for name in ("level", "name", "message", "hardware_id"):
            assert getattr(made, name) == getattr(status, name)
        assert [(one.key, one.value) for one in made.values] == [(one.key, one.value) for one in status.values]
