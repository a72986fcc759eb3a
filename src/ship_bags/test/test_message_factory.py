import math

import numpy as np
import pytest

from ship_bags.message_factory import RosidlFactory, message_class
from ship_bags.stamps import make_header, ns_from_stamp, stamp_fields

# Before 1970 too: nanosec must stay positive.
TIMES_NS = [0, 1, 999_999_999, 1_400_000_000_123_456_789, -1]


@pytest.mark.parametrize("ns", TIMES_NS)
def test_stamps_there_and_back(ns):
    sec, nanosec = stamp_fields(ns)
    assert 0 <= nanosec < 10**9
    assert ns_from_stamp(RosidlFactory().make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)) == ns


def test_arrays_of_numbers_texts_and_messages():
    factory = RosidlFactory()
    health = factory.make(
        "ship_msgs/msg/InputHealth",
        header=make_header(factory, 1_500_000_000, "ins"),
        topic="ins/imu",
        received=np.uint64(7),
        accepted=5,
        rejected=2,
        rate_hz=10,
        latency_s=math.nan,
        age_s=np.float32(0.5),
        level=1,
        reasons=["late"],
        reason_counts=np.array([2**63], dtype=np.uint64),
    )
    assert (health.header.stamp.sec, health.header.stamp.nanosec, health.header.frame_id) == (1, 500_000_000, "ins")
    assert list(health.reason_counts) == [2**63]
    assert (health.received, health.rate_hz, health.age_s, health.reasons) == (7, 10.0, 0.5, ["late"])


def test_fixed_and_dynamic_arrays_of_floats():
    factory = RosidlFactory()
    budget = factory.make(
        "ship_msgs/msg/ErrorBudget",
        header=make_header(factory, 0),
        quantity="ship",
        sources=["a", "b"],
        covariances=np.arange(18.0),
        total=np.arange(9.0),
    )
    assert list(budget.covariances) == list(range(18))
    assert list(budget.total) == list(range(9))


def test_missing_and_unknown_fields_are_named():
    with pytest.raises(TypeError, match=r"std_msgs/msg/Header: missing fields \['frame_id'\], unknown.*\['seq'\]"):
        RosidlFactory().make("std_msgs/msg/Header", stamp=None, seq=1)


def test_unknown_message_is_an_import_error():
    with pytest.raises(ImportError, match="package ship_msgs has no msg ShipAltitude"):
        message_class("ship_msgs/msg/ShipAltitude")
