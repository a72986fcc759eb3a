"""The air from the last readings: error growth with age, default parameters, any order of arrival."""

import itertools

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason
from ship_geometry.air.refraction import Weather
from ship_geometry.earth.geodetic import GeodeticPosition
from ship_stars.attitude_samples import AirReading, PositionFix
from ship_stars.sky.config import SkyConfig
from ship_stars.sky.surroundings import Air, Surroundings

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
CONFIG = SkyConfig(
    pressure_hpa=1000.0,
    temperature_c=-3.0,
    relative_humidity=0.9,
    pressure_sigma_hpa=15.0,
    temperature_sigma_k=10.0,
    measured_pressure_sigma_hpa=0.5,
    measured_temperature_sigma_k=1.0,
    weather_max_age_s=3600.0,
    fix_max_age_s=3600.0,
)
POSITION = GeodeticPosition(0.9, 0.1, 20.0)


def ns(since_s: float) -> int:
    return START_NS + round(since_s * SECOND_NS)


class Readings(Surroundings):
    """Surroundings of a ship at anchor, for requests of the air only."""

    def __init__(self, config: SkyConfig) -> None:
        super().__init__(config)
        for since_s in (0, 3600):
            self.insert(PositionFix(ns(since_s), POSITION, np.eye(3)))

    def air(self, time_ns: int) -> Air:
        return self.position_and_air_at(time_ns)[1]


def test_without_any_measurement_the_parameters_are_used() -> None:
    air = Readings(CONFIG).air(ns(0))
    assert air.weather == Weather(1000.0, -3.0, 0.9)
    assert (air.pressure_sigma_hpa, air.temperature_sigma_k) == (15.0, 10.0)
    assert Readings(CONFIG).unmeasured_quantities(ns(0)) == ["pressure", "temperature", "humidity"]


def test_the_last_reading_is_used_after_its_delay_and_the_first_one_from_its_stamp() -> None:
    track = Readings(CONFIG)
    track.insert(AirReading("pressure", ns(0), 1010.0))
    track.insert(AirReading("pressure", ns(60), 1011.0))
    track.insert(AirReading("temperature", ns(30), 20.0))
    track.insert(AirReading("humidity", ns(30), 0.4))
    assert track.air(ns(-1)).weather == Weather(1000.0, -3.0, 0.9)
    assert track.air(ns(0)).weather == Weather(1010.0, -3.0, 0.9)
    assert track.air(ns(60.4)).weather == Weather(1010.0, 20.0, 0.4)
    assert track.air(ns(60.5)).weather == Weather(1011.0, 20.0, 0.4)
    assert track.unmeasured_quantities(ns(10)) == ["temperature", "humidity"]
    assert track.unmeasured_quantities(ns(40)) == []


def test_the_variance_grows_to_that_of_the_parameter_which_is_then_used() -> None:
    track = Readings(CONFIG)
    track.insert(AirReading("pressure", ns(0), 1010.0, 0.3))
    track.insert(AirReading("temperature", ns(0), 20.0))
    fresh, half, last, gone = (track.air(ns(t)) for t in (0, 1800, 3600, 3601))
    assert (fresh.pressure_sigma_hpa, fresh.temperature_sigma_k) == (0.3, 1.0)
    # Halfway between 0.3² and 15², and between 1² and 10².
    assert (half.pressure_sigma_hpa**2, half.temperature_sigma_k**2) == pytest.approx((112.545, 50.5))
    assert (last.pressure_sigma_hpa, last.temperature_sigma_k) == pytest.approx((15.0, 10.0))
    assert last.weather.pressure_hpa == 1010.0
    assert gone.weather == Weather(1000.0, -3.0, 0.9)


def test_a_large_variance_does_not_decrease_with_age() -> None:
    track = Readings(CONFIG)
    track.insert(AirReading("temperature", ns(0), 20.0, 30.0))
    assert [track.air(ns(t)).temperature_sigma_k for t in (0, 1800)] == [30.0, 30.0]


def test_any_order_of_arrival_gives_the_same_air() -> None:
    readings = [(0, 1010.0), (10, 1011.0), (10, 1009.0), (20, 1012.0), (30, 1013.0)]

    def answers(order) -> list:
        track = Readings(CONFIG)
        for since_s, pressure_hpa in order:
            track.insert(AirReading("pressure", ns(since_s), pressure_hpa))
        return [track.air(ns(t)) for t in (-1, 0, 5, 10, 15, 25, 100)]

    assert all(answers(order) == answers(readings) for order in itertools.permutations(readings))


def test_nothing_changes_at_or_before_the_returned_time() -> None:
    track = Readings(CONFIG)
    track.insert(AirReading("pressure", ns(0), 1010.0))
    track.insert(AirReading("pressure", ns(20), 1010.0))
    before = {t: track.air(ns(t)) for t in (0, 9, 10, 10.4, 10.5, 19, 20.4, 20.5)}
    assert track.insert(AirReading("pressure", ns(10), 1014.0)) == ns(10.5) - 1
    assert [t for t in before if track.air(ns(t)) != before[t]] == [10.5, 19, 20.4]
    assert track.insert(AirReading("pressure", ns(10), 1014.0)) is None


def test_a_first_reading_and_one_after_a_gap_are_used_from_their_stamps() -> None:
    track = Readings(CONFIG)
    for since_s in (0, 4000):
        assert track.insert(AirReading("pressure", ns(since_s), 1010.0)) == ns(since_s) - 1
        assert track.unmeasured_quantities(ns(since_s)) == ["temperature", "humidity"]


def test_a_repeated_stamp_is_rejected() -> None:
    track = Readings(CONFIG)
    track.insert(AirReading("humidity", ns(0), 0.5))
    assert track.rejection(AirReading("humidity", ns(0), 0.5, None)).reason is Reason.DUPLICATE
    assert track.rejection(AirReading("humidity", ns(0), 0.6, None)).reason is Reason.CONFLICT
    assert track.rejection(AirReading("pressure", ns(0), 1000.0, None)) is None


def test_dropped_readings_are_not_needed() -> None:
    track = Readings(CONFIG)
    for since_s in range(10):
        track.insert(AirReading("temperature", ns(since_s), float(since_s)))
    track.drop_before(ns(5.75))
    assert track.air(ns(5.75)).weather.temperature_c == 5.0
    assert track.air(ns(4.0)).weather.temperature_c == CONFIG.temperature_c


def insert_all(quantity: str, readings: list[tuple[float, float]]) -> tuple[list, Readings]:
    """Return the times of the rejected readings, s, and the surroundings after all readings."""
    track, rejected = Readings(CONFIG), []
    for since_s, value in readings:
        rejection = track.rejection(AirReading(quantity, ns(since_s), value))
        if rejection is not None:
            assert rejection.reason is Reason.JUMP
            rejected.append(since_s)
        track.insert(AirReading(quantity, ns(since_s), value))
    return rejected, track


@pytest.mark.parametrize("off_hpa", [20.0, -30.0])
def test_a_pressure_jump_is_rejected_and_the_last_reading_kept_with_a_larger_error(off_hpa: float) -> None:
    wrong = [(float(t), 1010.0 + off_hpa) for t in range(20, 40, 2)]
    rejected, track = insert_all("pressure", [(float(t), 1010.0) for t in range(0, 20, 2)] + wrong)
    assert rejected == [since_s for since_s, _ in wrong]
    assert track.air(ns(38)).weather.pressure_hpa == 1010.0
    # The variance has grown from 0.5² towards 15² for 20 s of 3600 s.
    assert track.air(ns(38)).pressure_sigma_hpa**2 == pytest.approx(0.25 + (225.0 - 0.25) * 20.0 / 3600.0)
    assert track.rejection(AirReading("pressure", ns(40), 1010.3)) is None


def test_a_temperature_jump_is_rejected() -> None:
    # Kelvin is detected by its size; Fahrenheit is not: 20 °C become 68, 5 °C become 41.
    rejected, track = insert_all("temperature", [(0.0, 5.0), (60.0, 5.1), (120.0, 41.0), (180.0, 41.1), (240.0, 5.2)])
    assert rejected == [120.0, 180.0]
    assert track.air(ns(200)).weather.temperature_c == 5.1


def test_weather_changes_are_not_rejected() -> None:
    # The eye of a typhoon: 30 hPa within an hour, with a reading every minute and every ten minutes.
    for period_s in (60.0, 600.0):
        times = [period_s * n for n in range(round(3600.0 / period_s) + 1)]
        assert insert_all("pressure", [(t, 980.0 - 30.0 * t / 3600.0) for t in times])[0] == []
    # A squall: 3 hPa up and 12 K down within five minutes.
    assert insert_all("pressure", [(10.0 * n, 1005.0 + 0.1 * min(n, 30)) for n in range(60)])[0] == []
    assert insert_all("temperature", [(10.0 * n, 30.0 - 0.4 * min(n, 30)) for n in range(60)])[0] == []
    # From dry air into fog.
    assert insert_all("humidity", [(0.0, 0.1), (1.0, 1.0)])[0] == []


def test_another_pressure_is_accepted_after_the_maximum_age() -> None:
    rejected, track = insert_all(
        "pressure", [(0.0, 1010.0), (60.0, 1010.0), *((60.0 * n, 1040.0) for n in range(2, 63))]
    )
    assert rejected == [60.0 * n for n in range(2, 62)]
    assert track.air(ns(3720)).weather.pressure_hpa == 1040.0
