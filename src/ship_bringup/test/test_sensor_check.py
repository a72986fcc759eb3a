"""Checks of the received data of a sensor, one fault at a time."""

import dataclasses
import math
from types import MappingProxyType

import pytest

from ship_bringup.checks.check_line import Result
from ship_bringup.checks.network_check import check_sensors, find_requested_qos
from ship_bringup.checks.network_state import STRONGER_QOS, NetworkState, ObservedTopic, Publisher, observed_rate_hz
from ship_node.messages.inputs_outputs import InputTopic
from ship_watch.safety.limits import InputLimits, Limits

IMU = "sensor_msgs/msg/Imu"
DRIVER = Publisher("/ins_driver", IMU)
GOOD = ObservedTopic(InputTopic("ins/imu", IMU, True, 1000), (DRIVER,), 100.0, 316.0, 500, 0.012)
LIMITS = Limits(inputs={"ins": InputLimits(rate_hz=90.0)})


def evaluate(limits=LIMITS, requested_qos=MappingProxyType({}), **changes):
    observed = dataclasses.replace(GOOD, **changes)
    (row,) = check_sensors(NetworkState("rmw", inputs=(observed,)), limits, {"ins/imu": 2.0}, requested_qos)
    return row.result, row.finding


def test_good_sensor():
    assert evaluate() == (Result.OK, "ins/imu: 100 Hz from /ins_driver, stamps 0.012 s old")
    assert evaluate(age_s=None) == (Result.OK, "ins/imu: 100 Hz from /ins_driver")
    assert evaluate(requested_qos={"ins/imu": dict.fromkeys(STRONGER_QOS, "x")})[0] is Result.OK


@pytest.mark.parametrize(
    ("changes", "expected"),
    [({"publishers": ()}, "no publisher"),
     ({"publishers": (Publisher("/d", "std_msgs/msg/String"),)}, "/d publishes std_msgs/msg/String, expected " + IMU),
     ({"count": 0}, "/ins_driver publishes it, but no message arrived"),
     ({"rate_hz": 89.9}, "expected 90 Hz at least"),
     ({"count": 1, "rate_hz": 0.0}, "one message from /ins_driver: expected 90 Hz at least"),
     ({"rate_hz": float("nan")}, "expected 90 Hz at least"),
     ({"age_s": -0.051}, "stamps 0.051 s in the future"),
     ({"age_s": 10.1}, "stamps 10.100 s old"),
     ({"age_s": 2.1}, "later than lag_s"),
     ({"age_s": float("nan")}, "stamps nan")],
)  # fmt: skip
def test_unusable_sensor_fails(changes, expected):
    result, found = evaluate(**changes)
    assert result is Result.FAIL
    assert expected in found


def test_single_message_of_a_slow_sensor():
    text = "ins/imu: one message from /ins_driver, stamps 0.012 s old"
    assert evaluate(limits=Limits(), count=1, rate_hz=0.0) == (Result.OK, text)


@pytest.mark.parametrize(
    ("count", "span_s", "rate_hz"),
    [(0, math.nan, 0.0), (1, 0.0, 0.0), (10, 4.5, 2.0), (11, 4.99, 10.0 / 4.99), (3, 0.5, 0.6), (4, 0.0, 0.8)],
)
def test_rate_from_mean_interval(count, span_s, rate_hz):
    """Messages in five seconds: none, one, ten at 2 Hz, an eleventh just in time, three and then none, four at once."""
    assert observed_rate_hz(count, span_s, observed_s=5.0) == pytest.approx(rate_hz)


@pytest.mark.parametrize(
    ("age_s", "text"),
    [(390513437.825, "12 years old"), (-390513437.825, "12 years in the future"), (119.0, "119.000 s old"),
     (130.0, "2 minutes old"), (3.0 * 3600.0, "3 hours old"), (5.0 * 86400.0, "5 days old")],
)  # fmt: skip
def test_age_texts(age_s, text):
    """390513437.825 s / (365.25 x 86400 s) = 12.4 years."""
    assert evaluate(age_s=age_s)[1].endswith(f"stamps {text}")


def test_old_stamps_with_clock_are_of_a_bag():
    old = dataclasses.replace(GOOD, age_s=390513437.825)
    for has_clock, advice in ((True, "a bag is being played"), (False, "set the clock of the device")):
        (row,) = check_sensors(NetworkState("rmw", inputs=(old,), has_clock=has_clock), LIMITS, {"ins/imu": 2.0}, {})
        assert row.result is Result.FAIL
        assert row.advice.startswith(advice)


@pytest.mark.parametrize("age_s", [-0.049, 1.99])
def test_stamps_within_the_limits(age_s):
    assert evaluate(age_s=age_s)[0] is Result.OK


def test_weather_and_position_may_exceed_lag():
    for name in ("gnss/fix", "met/pressure"):
        topic = InputTopic(name, IMU, required=True, depth=100)
        observed = dataclasses.replace(GOOD, input=topic, age_s=2.1)
        (row,) = check_sensors(NetworkState("rmw", inputs=(observed,)), LIMITS, {name: 2.0}, {})
        assert row.result is Result.OK


def test_optional_sensor_without_data_is_a_warning():
    topic = InputTopic("met/humidity", IMU, required=False, depth=100)
    assert evaluate(input=topic, publishers=())[0] is Result.WARN
    assert evaluate(input=topic, count=0)[0] is Result.WARN
    assert evaluate(input=dataclasses.replace(topic, is_configured=True), publishers=())[0] is Result.FAIL


@pytest.mark.parametrize("quality", ["reliable", "transient_local"])
def test_unmet_quality_of_service_fails(quality):
    weak = (dataclasses.replace(DRIVER, offered_qos=STRONGER_QOS - {quality}),)
    assert evaluate(publishers=weak)[0] is Result.OK
    setting = "qos_overrides in the suite file"
    result, found = evaluate(publishers=weak, requested_qos={"ins/imu": {quality: setting}})
    assert result is Result.FAIL
    assert f"does not offer {quality}, required by {setting}: no message will arrive" in found


def test_advice_names_the_setting_of_the_unmet_quality(tmp_path):
    weak = dataclasses.replace(GOOD, publishers=(dataclasses.replace(DRIVER, offered_qos=frozenset()),))
    path = tmp_path / "suite.yaml"
    for parameters, by_option, setting in (
        ("{a: 1}", True, "--reliable-inputs"),
        ("{reliable_inputs: true}", False, "reliable_inputs in the suite file"),
        ("{qos_overrides: {/ins/imu: {subscription: {reliability: reliable}}}}", False,
         "qos_overrides in the suite file"),
    ):  # fmt: skip
        path.write_text(f"/**/ship_attitude: {{ros__parameters: {parameters}}}\n")
        requested = find_requested_qos(path, ["ins/imu"], "", by_option)
        (row,) = check_sensors(NetworkState("rmw", inputs=(weak,)), LIMITS, {"ins/imu": 2.0}, requested)
        assert (row.result, row.advice) == (Result.FAIL, f"let the driver offer it, or leave out {setting}")


def test_required_input_of_nmea_in_fails_until_received():
    without_publisher = NetworkState("rmw", inputs=(dataclasses.replace(GOOD, publishers=()),))
    (row,) = check_sensors(without_publisher, LIMITS, {}, {}, ["ins/imu"], "./ros2run nmea_in")
    assert row.result is Result.FAIL
    assert row.finding == "ins/imu: no publisher yet: the suite starts nmea_in, which may publish it"
    assert row.advice == "start ./ros2run nmea_in and run preflight again; end nmea_in before you start the suite"
    spare = dataclasses.replace(GOOD, input=dataclasses.replace(GOOD.input, required=False), publishers=())
    (row,) = check_sensors(NetworkState("rmw", inputs=(spare,)), LIMITS, {}, {}, ["ins/imu"])
    assert row.result is Result.NOT_CHECKED
    network = NetworkState("rmw", inputs=(dataclasses.replace(GOOD, rate_hz=1.0),))
    (row,) = check_sensors(network, LIMITS, {}, {}, ["ins/imu"])
    assert row.result is Result.FAIL


def test_two_publishers_are_a_warning():
    assert evaluate(publishers=(DRIVER, Publisher("/again", IMU)))[0] is Result.WARN


def test_failed_observation_fails():
    (row,) = check_sensors(NetworkState(failure="no rmw"), LIMITS, {}, {})
    assert (row.result, row.finding) == (Result.FAIL, "nothing could be received: no rmw")


def test_requested_quality_of_service_of_a_suite_file(tmp_path):
    path = tmp_path / "suite.yaml"
    path.write_text(
        "/**/ship_attitude:\n  ros__parameters:\n    qos_overrides:\n"
        "      /demo/ins/imu: {subscription: {reliability: reliable}}\n"
        "      /demo/gnss/fix: {subscription: {reliability: best_effort}}\n"
        "      /demo/met/pressure: {subscription: {durability: transient_local, depth: 5}}\n"
    )
    topics = ["ins/imu", "gnss/fix", "met/pressure"]
    by = "qos_overrides in the suite file"
    expected = {"ins/imu": {"reliable": by}, "met/pressure": {"transient_local": by}}
    assert find_requested_qos(path, topics, "demo") == expected
    assert find_requested_qos(path, topics, "aurora") == {}
    path.write_text("/**/ship_attitude: {ros__parameters: {reliable_inputs: true}}\n")
    by = "reliable_inputs in the suite file"
    assert find_requested_qos(path, topics, "demo") == {name: {"reliable": by} for name in topics}
