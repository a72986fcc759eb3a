"""Templates compared with the CDR of rosbags and rclpy."""

import math
import random
import struct

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.message_factory import CdrReader, RosidlFactory, message_class
from ship_bags.message_store import RosbagsFactory, message_store, serialize, ship_message_folder

SHIP_TYPES = sorted(f"ship_msgs/msg/{path.stem}" for path in ship_message_folder().glob("*.msg"))
TYPES = [
    *SHIP_TYPES,
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/FluidPressure",
    "sensor_msgs/msg/Temperature",
    "sensor_msgs/msg/RelativeHumidity",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/String",
    "std_msgs/msg/Bool",
    "rosgraph_msgs/msg/Clock",
]
TEXTS = ["", "a", "deck", "Grüße", "x" * 5000]
FACTORIES = [RosbagsFactory, RosidlFactory]


def random_fields(draw, type_name):
    """Return a message's fields with random numbers, texts and lengths."""
    return {name: random_value(draw, field) for name, field in RosbagsFactory().definition(type_name).items()}


def random_value(draw, field):
    if field.length is None and not field.is_sequence:
        return random_element(draw, field.element)
    values = [random_element(draw, field.element) for _ in range(field.length or draw.choice([0, 0, 1, 2, 7, 40]))]
    return np.array(values, dtype=field.element) if len(field.element) == 1 else values


def random_element(draw, element):
    if element == "string":
        return draw.choice(TEXTS)
    if element == "builtin_interfaces/msg/Time":
        return draw.choice([0, -1, draw.randrange(2**31 * 10**9)])
    if "/" in element:
        return random_fields(draw, element)
    if element == "?":
        return draw.random() < 0.5
    if element in "df":
        number = draw.choice([draw.gauss(0.0, 1e6), 0.0, -0.0, math.nan, -math.inf, 5e-324])
        return float(np.float32(number)) if element == "f" else number
    bits = 8 * struct.calcsize("<" + element)
    return draw.choice([0, draw.getrandbits(bits - 1), 2 ** (bits - element.islower()) - 1])


@pytest.mark.slow
@pytest.mark.parametrize("type_name", TYPES)
@pytest.mark.parametrize("factory", FACTORIES)
def test_bytes_are_those_of_rosbags(type_name, factory):
    draw = random.Random(type_name)
    for _ in range(30):
        fields = random_fields(draw, type_name)
        expected = serialize(RosbagsFactory().make(type_name, **fields))
        encoded = factory().encode(type_name, **fields)
        assert encoded.__cdr__ == expected
        assert encoded.__msgtype__ == type_name


@pytest.mark.parametrize("type_name", TYPES)
def test_rclpy_reads_what_was_encoded(type_name):
    draw, factory, store = random.Random(type_name), RosidlFactory(), message_store()
    for _ in range(10):
        encoded = factory.encode(type_name, **random_fields(draw, type_name)).__cdr__
        # rclpy writes undefined bytes into the gaps between fields, so rosbags encodes the message again.
        again = serialize_message(deserialize_message(encoded, message_class(type_name)))
        assert serialize(store.deserialize_cdr(again[: len(encoded)], type_name)) == encoded


@pytest.mark.parametrize("type_name", TYPES)
@pytest.mark.parametrize("factory", FACTORIES)
def test_fields_decoded_on_access_equal_those_of_the_message_object(type_name, factory):
    draw = random.Random(type_name)
    for _ in range(10):
        data = serialize(RosbagsFactory().make(type_name, **random_fields(draw, type_name)))
        read = CdrTemplate.of_message(type_name, factory().definition, data).message(data)
        assert_same(read, message_store().deserialize_cdr(data, type_name))
        assert serialize(read) == data


def assert_same(read, expected):
    if hasattr(expected, "__msgtype__"):
        for name, _ in message_store().fielddefs[expected.__msgtype__][1]:
            assert_same(getattr(read, name), getattr(expected, name))
    elif isinstance(expected, np.ndarray):
        np.testing.assert_array_equal(read, expected)
        assert read.dtype == expected.dtype
    elif isinstance(expected, list):
        assert len(read) == len(expected)
        for one, other in zip(read, expected, strict=True):
            assert_same(one, other)
    elif isinstance(expected, float):
        assert struct.pack("<d", read) == struct.pack("<d", expected)
    else:
        assert read == expected


def imu_fields(draw, frame_id="ins"):
    header = {"stamp": draw.randrange(2**60), "frame_id": frame_id}
    return random_fields(draw, "sensor_msgs/msg/Imu") | {"header": header}


def test_many_at_once_are_the_same_as_one_by_one():
    draw, factory = random.Random(1), RosbagsFactory()
    messages = [serialize(factory.make("sensor_msgs/msg/Imu", **imu_fields(draw))) for _ in range(100)]
    template = CdrTemplate("sensor_msgs/msg/Imu", factory.definition, ("ins",))
    numbers = CdrRows(template, np.frombuffer(b"".join(messages), np.uint8).reshape(-1, template.size)).numbers
    expected = [message_store().deserialize_cdr(data, "sensor_msgs/msg/Imu") for data in messages]
    np.testing.assert_array_equal(numbers["header.stamp.nanosec"], [each.header.stamp.nanosec for each in expected])
    np.testing.assert_array_equal(numbers["orientation.w"], [each.orientation.w for each in expected])
    np.testing.assert_array_equal(numbers["orientation_covariance"], [each.orientation_covariance for each in expected])
    rows = template.encode_many([numbers[name] for name in template.dtype.names], len(numbers))
    assert rows.tobytes() == b"".join(messages)


def test_columns_must_be_all_and_no_others():
    template = CdrTemplate("geometry_msgs/msg/Vector3", RosbagsFactory().definition, ())
    for columns in ([[1.0, 2.0]], [[1.0, 2.0], 0.0, 0.0, 0.0]):
        with pytest.raises(ValueError, match="argument"):
            template.encode_many(columns, 2)
    assert template.encode_many([[1.0, 2.0], 0.0, 0.0], 2).shape == (2, 28)


def test_rows_are_the_bytes_of_messages_encoded_one_by_one():
    """Texts, a sequence and an array of messages are the same in all; each number differs."""
    draw, factory, count = random.Random(4), RosbagsFactory(), 20
    one_by_one = [random_fields(draw, "ship_msgs/msg/ShipAttitude") for _ in range(count)]
    for number, fields in enumerate(one_by_one):
        fields |= {"header": {"stamp": 7 + number * 10**9, "frame_id": "deck"}, "sources": ["ins", "star.fore"]}

    def column(values):
        if isinstance(values[0], dict):
            return {name: column([value[name] for value in values]) for name in values[0]}
        return values[0] if isinstance(values[0], (str, list)) else np.array(values).T

    columns = {name: column([fields[name] for fields in one_by_one]) for name in one_by_one[0]}
    rows = factory.encode_rows("ship_msgs/msg/ShipAttitude", count, **columns)
    for number, fields in enumerate(one_by_one):
        assert rows.message(number).__cdr__ == serialize(factory.make("ship_msgs/msg/ShipAttitude", **fields))


def test_a_constant_value_of_all_rows_is_given_once():
    factory = RosbagsFactory()
    fields = {"x": 1.5, "y": np.array([1.0, 2.0]), "z": 0.0}
    rows = factory.encode_rows("geometry_msgs/msg/Vector3", 2, **fields)
    assert [rows.message(number).y for number in range(2)] == [1.0, 2.0]
    assert [rows.message(number).x for number in range(2)] == [1.5, 1.5]


def test_a_signalling_nan_keeps_its_bits():
    data = serialize(RosbagsFactory().make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0))
    data = data[:4] + bytes.fromhex("01000000000ff07f") + data[12:]
    template = CdrTemplate.of_message("geometry_msgs/msg/Vector3", RosbagsFactory().definition, data)
    numbers = CdrRows(template, np.frombuffer(data, np.uint8).reshape(1, -1)).numbers
    assert template.encode_many([numbers[name] for name in numbers.dtype.names], 1).tobytes() == data


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"\x00\x00" + data[2:],
        lambda data: b"\x00\x07" + data[2:],
        lambda data: data[:-1],
        lambda data: data + b"\x00",
        lambda data: data[:12] + b"\xff\xff\xff\xff" + data[16:],
        lambda data: data[:12] + b"\x00\x00\x00\x00" + data[16:],
        lambda data: data[:16] + b"\xff" + data[17:],
        lambda data: data[:16] + b"\x00" + data[17:],
        lambda data: data[:10],
        lambda data: b"",
    ],
)
def test_unusual_messages_are_left_to_message_objects(spoil):
    factory = RosbagsFactory()
    data = serialize(factory.make("sensor_msgs/msg/Imu", **imu_fields(random.Random(2))))
    with pytest.raises(ValueError):  # noqa: PT011 - there is a text for each way of being spoilt
        CdrTemplate.of_message("sensor_msgs/msg/Imu", factory.definition, spoil(data))
    reader = CdrReader("sensor_msgs/msg/Imu", factory.definition)
    assert reader.message(spoil(data)) is None


def test_a_reader_gives_other_texts_of_the_same_length_to_message_objects():
    draw, factory = random.Random(3), RosbagsFactory()
    reader = CdrReader("sensor_msgs/msg/Imu", factory.definition)
    first, other, longer = (
        serialize(factory.make("sensor_msgs/msg/Imu", **imu_fields(draw, frame)))
        for frame in ("ins", "gps", "ins_of_the_bow")
    )
    assert reader.message(first).header.frame_id == "ins"
    assert reader.message(other) is None
    assert reader.message(longer).header.frame_id == "ins_of_the_bow"
    assert reader.message(first).__cdr__ == first


def test_changing_texts_do_not_fill_the_memory():
    draw, factory = random.Random(5), RosbagsFactory()
    reader = CdrReader("sensor_msgs/msg/Imu", factory.definition)
    frames = ["x" * length for length in range(0, 800, 8)]
    read = [reader.message(factory.encode("sensor_msgs/msg/Imu", **imu_fields(draw, name)).__cdr__) for name in frames]
    assert [message.header.frame_id for message in read[:16]] == frames[:16]
    assert read[16:] == [None] * 84


def test_a_type_with_sequences_is_left_to_message_objects():
    factory = RosbagsFactory()
    data = factory.encode("ship_msgs/msg/AlertArray", **random_fields(random.Random(4), "ship_msgs/msg/AlertArray"))
    assert CdrReader("ship_msgs/msg/AlertArray", factory.definition).message(data.__cdr__) is None


def test_missing_and_unknown_fields_are_named():
    with pytest.raises(TypeError, match=r"Vector3: missing fields \['z'\], unknown fields \['w'\]"):
        RosbagsFactory().encode("geometry_msgs/msg/Vector3", x=0.0, y=0.0, w=0.0)
    with pytest.raises(AttributeError, match="no field 'w'"):
        _ = RosbagsFactory().encode("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0).w


@pytest.mark.parametrize("variables", [(), ("a", "b")])
def test_a_template_is_given_as_many_texts_as_there_are(variables):
    with pytest.raises(ValueError, match="texts and sequences"):
        CdrTemplate("std_msgs/msg/String", RosbagsFactory().definition, variables)


def test_a_field_for_which_there_is_no_template_is_named():
    for factory in FACTORIES:
        with pytest.raises(TypeError, match="no template for a field of type"):
            factory().definition("diagnostic_msgs/msg/DiagnosticStatus")
