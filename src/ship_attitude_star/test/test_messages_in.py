"""Readers of position and air messages: axes, units and impossible values."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ship_bags.message_factory import RosidlFactory
from ship_bags.stamps import make_header
from ship_node.messages.field_checks import MessageRejected
from ship_stars.messages.surroundings_messages import humidity, position_fix, pressure, temperature
from ship_stars.sky.config import SkyConfig

FACTORY = RosidlFactory()
STAMP_NS = 1_404_906_607_800_000_000
NOW_NS = STAMP_NS + 100_000_000


def fix(**changes: Any) -> Any:
    fields = {
        "header": make_header(FACTORY, STAMP_NS, "gnss"),
        "status": FACTORY.make("sensor_msgs/msg/NavSatStatus", status=0, service=1),
        "latitude": 31.945213,
        "longitude": 120.293086,
        "altitude": 25.0,
        "position_covariance": np.array([4.0, 1.0, 0.0, 1.0, 9.0, 0.0, 0.0, 0.0, 25.0]),
        "position_covariance_type": 3,
    }
    return FACTORY.make("sensor_msgs/msg/NavSatFix", **fields | changes)


def test_a_fix_is_a_position_with_a_covariance() -> None:
    reading = position_fix(fix(), SkyConfig(), NOW_NS)
    taken = reading.value
    assert (taken.time_ns, reading.covariance_known) == (STAMP_NS, True)
    assert np.rad2deg([taken.position.latitude, taken.position.longitude]) == pytest.approx([31.945213, 120.293086])
    assert taken.position.height_m == 25.0
    # The message has sigmas of 2 m East, 3 m North and 5 m Up; the result has the order North, Up, East.
    np.testing.assert_array_equal(taken.covariance_m2, [[9, 0, 1], [0, 25, 0], [1, 0, 4]])


@pytest.mark.parametrize(
    "changes", [{"position_covariance_type": 0}, {"position_covariance": np.zeros(9)}], ids=["type", "all zero"]
)
def test_a_fix_without_error_has_the_configured_one(changes: dict[str, Any]) -> None:
    reading = position_fix(fix(**changes), SkyConfig(fix_sigma_m=7.0), NOW_NS)
    assert not reading.covariance_known
    np.testing.assert_array_equal(reading.value.covariance_m2, 49.0 * np.eye(3))


def test_a_receiver_without_height_variance_is_accepted() -> None:
    flat = np.diag([4.0, 9.0, 0.0]).ravel()
    assert position_fix(fix(position_covariance=flat), SkyConfig(), NOW_NS).covariance_known


def test_a_receiver_without_height_is_at_sea_level() -> None:
    assert position_fix(fix(altitude=np.nan), SkyConfig(), NOW_NS).value.position.height_m == 0.0


def test_longitudes_beyond_180_are_accepted() -> None:
    taken = position_fix(fix(longitude=190.0), SkyConfig(), NOW_NS).value
    assert np.rad2deg(taken.position.longitude) == pytest.approx(190.0)


NO_FIX = FACTORY.make("sensor_msgs/msg/NavSatStatus", status=-1, service=1)
FIXES = [
    ("no fix", {"status": NO_FIX}, "no_fix", "STATUS_NO_FIX"),
    ("latitude NaN", {"latitude": np.nan}, "non_finite", "latitude"),
    ("longitude infinite", {"longitude": np.inf}, "non_finite", "longitude"),
    ("latitude beyond the pole", {"latitude": 90.5}, "units", "90.5"),
    ("longitude in minutes", {"longitude": 7217.6}, "units", "7217.6"),
    ("altitude nonsense", {"altitude": 1e300}, "units", "altitude"),
    ("negative variance", {"position_covariance": -np.eye(3).ravel() * 4.0}, "bad_covariance", "negative"),
    ("covariance NaN", {"position_covariance": np.full(9, np.nan)}, "non_finite", "position_covariance"),
    ("east exact", {"position_covariance": np.diag([0.0, 9.0, 25.0]).ravel()}, "bad_covariance", "is zero"),
    ("north exact", {"position_covariance": np.diag([4.0, 0.0, 25.0]).ravel()}, "bad_covariance", "is zero"),
    ("sigma of half the Earth", {"position_covariance": np.eye(3).ravel() * 1e13}, "bad_covariance", "too large"),
    ("stamp zero", {"header": make_header(FACTORY, 0)}, "bad_stamp", "0 ns"),
]


@pytest.mark.parametrize(("changes", "reason", "text"), [f[1:] for f in FIXES], ids=[f[0] for f in FIXES])
def test_a_bad_fix_is_rejected(changes: dict[str, Any], reason: str, text: str) -> None:
    with pytest.raises(MessageRejected) as caught:
        position_fix(fix(**changes), SkyConfig(), NOW_NS)
    assert caught.value.rejection.reason.word == reason
    assert text in caught.value.rejection.text


AIR: dict[Callable[..., Any], tuple[str, str]] = {
    pressure: ("FluidPressure", "fluid_pressure"),
    temperature: ("Temperature", "temperature"),
    humidity: ("RelativeHumidity", "relative_humidity"),
}


def air(converter: Callable[..., Any], value: float, variance: float = 0.0, stamp_ns: int = STAMP_NS) -> Any:
    type_name, field = AIR[converter]
    header = make_header(FACTORY, stamp_ns)
    return FACTORY.make(f"sensor_msgs/msg/{type_name}", header=header, **{field: value}, variance=variance)


@pytest.mark.parametrize(
    ("converter", "value", "variance", "expected"),
    [
        (pressure, 100_830.0, 2500.0, (1008.3, 0.5)),
        (pressure, 100_830.0, 0.0, (1008.3, None)),
        (temperature, 28.2, 0.09, (28.2, 0.3)),
        (temperature, -40.0, 0.0, (-40.0, None)),
        (humidity, 0.82, 0.0, (0.82, None)),
        (humidity, 1.0, 0.0, (1.0, None)),
    ],
)
def test_weather_is_converted_from_its_units(
    converter: Callable[..., Any], value: float, variance: float, expected: tuple[float, float | None]
) -> None:
    taken = converter(air(converter, value, variance), NOW_NS)
    reading = taken.value
    assert (reading.time_ns, taken.covariance_known) == (STAMP_NS, variance > 0.0 or converter is humidity)
    assert reading.value == pytest.approx(expected[0])
    assert reading.sigma == (None if expected[1] is None else pytest.approx(expected[1]))


@pytest.mark.parametrize(
    ("converter", "value", "variance", "reason", "text"),
    [
        (pressure, 1008.3, 0.0, "units", "hPa, not Pa?"),
        (pressure, 0.0, 0.0, "units", "expected 80000 to 110000 Pa"),
        (pressure, np.nan, 0.0, "non_finite", "pressure"),
        (temperature, 301.35, 0.0, "units", "kelvin, not °C?"),
        (temperature, 82.8, 0.0, "units", "-60 to 60 °C"),
        (humidity, 82.0, 0.0, "units", "percent?"),
        (humidity, -0.1, 0.0, "units", "0 to 1"),
        (humidity, np.inf, 0.0, "non_finite", "humidity"),
        (temperature, 20.0, -1.0, "bad_covariance", "negative"),
        (temperature, 20.0, np.nan, "non_finite", "variance"),
        (temperature, 20.0, 1e300, "bad_covariance", "too large"),
    ],
)
def test_bad_weather_is_rejected(
    converter: Callable[..., Any], value: float, variance: float, reason: str, text: str
) -> None:
    with pytest.raises(MessageRejected) as caught:
        converter(air(converter, value, variance), NOW_NS)
    assert caught.value.rejection.reason.word == reason
    assert text in caught.value.rejection.text


def test_weather_without_a_stamp_is_rejected() -> None:
    with pytest.raises(MessageRejected, match="bad_stamp"):
        humidity(air(humidity, 0.5, stamp_ns=0), NOW_NS)
