"""INS messages read as a block equal those read one by one, to the last bit; a block ends before a differing message.
"""

import functools
from typing import Any

import numpy as np
import pytest

from ship_bags.cdr_template import CdrRows, CdrTemplate
from ship_bags.message_store import RosbagsFactory, definition_in, message_store, serialize
from ship_estimation.parameters.ship_devices import InsInputConfig
from ship_node.messages.field_checks import MessageRejected
from ship_node.messages.sensor_readers import ins_block, ins_sample

START_NS, COUNT, ODD = 1_400_000_000_000_000_000, 30, 17
FACTORY = RosbagsFactory()
CONFIGS = {
    "as it is": InsInputConfig(),
    "another mounting": InsInputConfig(installation_heading_deg=91.0, installation_pitch_deg=-3.0),
    "other axes": InsInputConfig(convention="ned_frd", installation_roll_deg=7.0),
}


def message(number: int, **changes: Any) -> Any:
    """Return an Imu of a turning ship whose quaternion has almost unit norm."""
    rng = np.random.default_rng(number)
    quaternion = rng.standard_normal(4)
    quaternion *= rng.uniform(0.995, 1.005) / np.linalg.norm(quaternion)
    fields = {
        "header": {"stamp": START_NS + 10_000_000 * number, "frame_id": "ins"},
        "orientation": dict(zip("xyzw", quaternion.tolist(), strict=True)),
        "orientation_covariance": 1e-9 * np.eye(3).ravel(),
        "angular_velocity": dict(zip("xyz", rng.standard_normal(3).tolist(), strict=True)),
        "angular_velocity_covariance": np.zeros(9),
        "linear_acceleration": {"x": 0.0, "y": 0.0, "z": 9.8},
        "linear_acceleration_covariance": np.zeros(9),
    }
    return FACTORY.make("sensor_msgs/msg/Imu", **{**fields, **changes})


def rows(messages: list[Any]) -> CdrRows:
    data = [bytes(serialize(one)) for one in messages]
    definitions = functools.partial(definition_in, message_store())
    template = CdrTemplate.of_message("sensor_msgs/msg/Imu", definitions, data[0])
    return CdrRows(template, np.frombuffer(b"".join(data), dtype=np.uint8).reshape(len(data), -1))


def receive_times(count: int = COUNT) -> np.ndarray:
    return START_NS + 10_000_000 * np.arange(count) + 2_000_000


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_a_block_equals_its_messages(config: InsInputConfig) -> None:
    messages = [message(number) for number in range(COUNT)]
    found = ins_block(rows(messages), receive_times(), config)
    alone = [ins_sample(one, config, int(now_ns)) for one, now_ns in zip(messages, receive_times(), strict=True)]
    together = found.samples.samples()
    assert [sample.time_ns for sample in together] == [one.value.time_ns for one in alone]
    assert [sample.content() for sample in together] == [one.value.content() for one in alone]
    assert found.covariance_known


NAN, INF = float("nan"), float("inf")
ONES = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
REJECTED = {
    "no number in the quaternion": {"orientation": {**ONES, "x": NAN}},
    "infinite quaternion": {"orientation": {**ONES, "z": INF}},
    "quaternion overflows": {"orientation": {**ONES, "y": 1e200}},
    "no quaternion": {"orientation": {**ONES, "w": 0.0}},
    "quaternion too long": {"orientation": {**ONES, "w": 1.02}},
    "no stamp": {"header": {"stamp": 0, "frame_id": "ins"}},
    "future": {"header": {"stamp": START_NS + 10_000_000_000, "frame_id": "ins"}},
    "no number in the rate": {"angular_velocity": {"x": 0.0, "y": NAN, "z": 0.0}},
    "no ship's rate": {"angular_velocity": {"x": 0.0, "y": -101.0, "z": 0.0}},
    "another covariance": {"orientation_covariance": 2e-9 * np.eye(3).ravel()},
    "no covariance": {"orientation_covariance": np.full(9, NAN)},
    "no orientation": {"orientation_covariance": np.r_[-1.0, np.zeros(8)]},
    "no rate": {"angular_velocity_covariance": np.r_[-1.0, np.zeros(8)]},
}


@pytest.mark.parametrize("changes", REJECTED.values(), ids=REJECTED)
def test_a_block_ends_before_a_differing_message(changes: dict[str, Any]) -> None:
    messages = [message(number, **(changes if number == ODD else {})) for number in range(COUNT)]
    assert len(ins_block(rows(messages), receive_times(), InsInputConfig()).samples.times_ns) == ODD


def test_a_block_ends_before_an_invalid_stamp() -> None:
    messages = [message(number) for number in range(COUNT)]
    messages[ODD].header.stamp.nanosec = 1_000_000_000
    assert len(ins_block(rows(messages), receive_times(), InsInputConfig()).samples.times_ns) == ODD


@pytest.mark.parametrize(
    ("changes", "config"),
    [
        ({"orientation_covariance": np.full(9, NAN)}, InsInputConfig()),
        ({"orientation_covariance": np.r_[-1.0, np.zeros(8)]}, InsInputConfig()),
        ({}, InsInputConfig(frame_id="another")),
    ],
    ids=["covariance", "no orientation", "frame"],
)
def test_a_block_of_bad_messages_is_empty(changes: dict[str, Any], config: InsInputConfig) -> None:
    messages = [message(number, **changes) for number in range(COUNT)]
    assert len(ins_block(rows(messages), receive_times(), config).samples.times_ns) == 0
    with pytest.raises(MessageRejected):
        ins_sample(messages[0], config, int(receive_times()[0]))


@pytest.mark.parametrize(
    ("unknown", "config"),
    [(np.zeros(9), InsInputConfig()), (np.r_[-1.0, np.zeros(8)], InsInputConfig(accept_unset_covariance=True))],
    ids=["zero", "minus one accepted"],
)
def test_an_unknown_covariance_is_marked(unknown: np.ndarray, config: InsInputConfig) -> None:
    messages = [message(number, orientation_covariance=unknown) for number in range(COUNT)]
    found = ins_block(rows(messages), receive_times(), config)
    assert (len(found.samples.times_ns), found.covariance_known) == (COUNT, False)
    alone = ins_sample(messages[0], config, int(receive_times()[0]))
    assert (alone.value.content(), alone.covariance_known) == (found.samples.sample(0).content(), False)
