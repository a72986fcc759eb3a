"""Messages without a ROS installation equal those of ROS: same bytes, type hashes and definitions."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from ship_bags.errors import BadInput
from ship_bags.message_factory import RosidlFactory
from ship_bags.message_store import (
    RosbagsFactory,
    definition,
    message_store,
    serialize,
    store_with_definitions,
    type_hash,
    use_installed_definition,
)
from ship_bags.stamps import make_header
from ship_testing.hand_made_bags import FACTORY, START_NS, innovation, ship_attitude

SHIP_TYPES = sorted(name for name in message_store().fielddefs if name.startswith("ship_msgs/"))


def health(factory):
    return factory.make(
        "ship_msgs/msg/InputHealth",
        header=make_header(factory, START_NS),
        topic="ins/imu",
        received=7,
        accepted=6,
        rejected=1,
        rate_hz=100.0,
        latency_s=0.1,
        age_s=0.2,
        level=1,
        reasons=["gate"],
        reason_counts=np.array([1], dtype=np.uint64),
    )


def budget(factory):
    return factory.make(
        "ship_msgs/msg/ErrorBudget",
        header=make_header(factory, START_NS, "deck"),
        quantity="ship_attitude",
        sources=["ins", "star.fore"],
        covariances=np.arange(18.0),
        total=np.arange(9.0),
    )


@pytest.mark.parametrize("make", [health, budget])
def test_rclpy_and_rosbags_read_each_other(make):
    """Not compared byte by byte, because the middleware leaves undefined bytes between fields."""
    from rclpy.serialization import deserialize_message, serialize_message

    ours, theirs = make(RosbagsFactory()), make(RosidlFactory())
    assert deserialize_message(serialize(ours), type(theirs)) == theirs
    back = message_store().deserialize_cdr(serialize_message(theirs), ours.__msgtype__)
    assert serialize(back) == serialize(ours)


def within_and_before(factory):
    """Return one message made in one call, and the same made of existing messages."""
    make, header = factory.make, {"stamp": START_NS, "frame_id": "deck"}
    numbers = {"x": 0.5, "y": 1, "z": -2.0}
    kind = "geometry_msgs/msg/Vector3Stamped"
    vector = make("geometry_msgs/msg/Vector3", **numbers)
    before = make(kind, header=make_header(factory, START_NS, "deck"), vector=vector)
    return make(kind, header=header, vector=numbers), before


@pytest.mark.parametrize("factory", [RosbagsFactory(), RosidlFactory()])
def test_a_nested_message_is_given_as_a_dict_and_a_stamp_as_ns(factory):
    whole, before = within_and_before(factory)
    assert whole == before
    assert (whole.header.stamp.sec, whole.header.stamp.nanosec) == divmod(START_NS, 10**9)
    entry = {"key": "a", "value": "b"}
    status = {"level": 1, "name": "n", "message": "m", "hardware_id": "h", "values": [entry, entry]}
    array = factory.make("diagnostic_msgs/msg/DiagnosticArray", header=whole.header, status=[status])
    assert [(value.key, value.value) for value in array.status[0].values] == [("a", "b"), ("a", "b")]
    with pytest.raises(TypeError, match="frame_id"):
        factory.make("geometry_msgs/msg/Vector3Stamped", header={"stamp": START_NS}, vector=whole.vector)


@pytest.mark.parametrize("type_name", SHIP_TYPES)
def test_type_hash_is_that_of_the_built_messages(type_name):
    name = type_name.rsplit("/", 1)[1]
    candidates = [
        Path(prefix) / "share" / "ship_msgs" / "msg" / f"{name}.json"
        for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)
    ]
    built = json.loads(next(path for path in candidates if path.is_file()).read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in built["type_hashes"]}
    assert type_hash(type_name) == hashes[type_name]


def test_all_messages_of_the_contract_exist():
    # system.md §2 lists 17 messages; Integrity, Alert, AlertArray, AttitudeDeg, TargetImage, TargetDirection,
    # EscortAdvice, Deflection, SuiteState, SuiteAngle and SuiteSource are among the new ones.
    assert len(SHIP_TYPES) == 28


def test_factory_converts_arrays_to_the_type_of_the_field():
    message = FACTORY.make("sensor_msgs/msg/NavSatStatus", status=0, service=1)
    assert message.service == 1
    attitude = ship_attitude(START_NS, covariance_enu=[[1, 0, 0], [0, 2, 0], [0, 0, 3]])
    assert attitude.rotation_covariance.dtype == np.float64
    back = message_store().deserialize_cdr(serialize(attitude), attitude.__msgtype__)
    np.testing.assert_array_equal(back.rotation_covariance, [1, 0, 0, 0, 2, 0, 0, 0, 3])


@pytest.mark.parametrize("level", [2, b"\x02"])
def test_diagnostic_level_is_an_integer_or_a_byte(level):
    status = FACTORY.make(
        "diagnostic_msgs/msg/DiagnosticStatus", level=level, name="", message="", hardware_id="", values=[]
    )
    assert message_store().deserialize_cdr(serialize(status), status.__msgtype__).level == 2


@pytest.mark.parametrize("fields", [{"sec": 1}, {"sec": 1, "nanosec": 2, "more": 3}])
def test_a_missing_or_unknown_field_is_refused(fields):
    with pytest.raises(TypeError):
        FACTORY.make("builtin_interfaces/msg/Time", **fields)


def test_wrong_array_length_is_refused():
    with pytest.raises(Exception, match="array length"):
        serialize(ship_attitude(START_NS, covariance_enu=np.zeros(8)))


def test_the_same_definitions_need_no_store_of_their_own():
    types = store_with_definitions({"sensor_msgs/msg/Imu": definition("sensor_msgs/msg/Imu")})
    assert types.store is message_store()
    assert (types.differences, types.unreadable) == ({}, {})


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("float64 w", "float32 w"), "geometry_msgs/msg/Quaternion.w is float32 in the bag and float64 here"),
        (("string frame_id", "string frame"), "std_msgs/msg/Header.frame_id is missing in the bag"),
        (("string frame_id", "string frame_id\nuint8 more"), "std_msgs/msg/Header.more is unknown to this suite"),
        (("float64 x\nfloat64 y", "float64 y\nfloat64 x"), "Quaternion.y has another position in the bag"),
        (("float64[9] linear", "float64[] linear"), "is float64[] in the bag and float64[9] here"),
    ],
)
def test_a_difference_names_the_field(change, line):
    text = definition("sensor_msgs/msg/Imu").replace(*change)
    differences = store_with_definitions({"sensor_msgs/msg/Imu": text}).differences
    assert any(line in difference for difference in differences["sensor_msgs/msg/Imu"])


HEADER = "=" * 80 + "\nMSG: std_msgs/Header\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("float64 [", "definition of x_msgs/msg/X cannot be parsed"),
        ("x_msgs/Y y", "its definition refers to x_msgs/msg/Y, which is not in the bag"),
        (f"std_msgs/Header header\n{HEADER}uint8 seq\n", "its definition contradicts those of other topics"),
    ],
)
def test_an_unusable_definition_affects_only_its_type(text, why):
    types = store_with_definitions({"x_msgs/msg/X": text, "sensor_msgs/msg/Imu": definition("sensor_msgs/msg/Imu")})
    assert list(types.unreadable) == ["x_msgs/msg/X"]
    assert types.unreadable["x_msgs/msg/X"].startswith(why)
    assert types.differences == {}
    assert "sensor_msgs/msg/Imu" in types.store.fielddefs


def test_an_installed_definition_that_cannot_be_parsed_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "share/x_msgs/msg/X.msg"
    path.parent.mkdir(parents=True)
    path.write_text("float64 [")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(BadInput, match="definition of x_msgs/msg/X cannot be parsed"):
        use_installed_definition("x_msgs/msg/X")


def test_missing_parts_of_a_definition_are_taken_from_the_suite():
    types = store_with_definitions({"x_msgs/msg/X": "std_msgs/Header header\nfloat64 value\n"})
    assert types.unreadable == {}
    assert {"std_msgs/msg/Header", "builtin_interfaces/msg/Time"} <= types.store.fielddefs.keys()


def test_definitions_may_end_their_lines_as_windows_does():
    text = definition("sensor_msgs/msg/Imu").replace("\n", "\r\n")
    assert store_with_definitions({"sensor_msgs/msg/Imu": text}).store is message_store()


def test_innovation_round_trip_keeps_nan_and_text():
    message = innovation(START_NS, "star.fore", [1.0, np.nan], [2.0, 3.0], 0.5, components=("up", "right"))
    back = message_store().deserialize_cdr(serialize(message), message.__msgtype__)
    assert back.components == ["up", "right"]
    np.testing.assert_array_equal(back.residual, [1.0, np.nan])
