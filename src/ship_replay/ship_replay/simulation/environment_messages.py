"""Messages of the satellite receiver and of the weather station; see :mod:`device_messages` for what a maker is."""

import numpy as np

from ship_node.message_factory import MessageFactory
from ship_node.stamps import make_header
from ship_replay.simulation.device_messages import Maker
from ship_replay.simulation.noise import random_stream
from ship_replay.simulation.scenario import Position, Weather

_EARTH_RADIUS_M = 6_371_000.0
"""Mean radius, good enough to turn the noise of a fix into degrees."""

_FIX, _GPS, _DIAGONAL_KNOWN = 0, 1, 2
"""NavSatStatus.STATUS_FIX, NavSatStatus.SERVICE_GPS, NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN."""


def fix_maker(time_ns: np.ndarray, position: Position, seed: int, factory: MessageFactory) -> Maker:
    """Maker of gnss/fix: the ship's place, which stays, with white noise."""
    noise_m = position.sigma_m * random_stream(seed, "gnss.white").standard_normal((time_ns.size, 3))
    north_deg, east_deg = np.rad2deg(noise_m[:, :2] / _EARTH_RADIUS_M).T
    latitude_deg = np.clip(position.latitude_deg + north_deg, -90.0, 90.0)
    # At the poles a longitude has no error that matters.
    longitude_deg = position.longitude_deg + east_deg / max(np.cos(np.deg2rad(position.latitude_deg)), 1e-3)
    covariance = np.diag(np.full(3, position.sigma_m**2)).ravel()

    def make(stamp: int, value: int) -> object:
        return factory.make(
            "sensor_msgs/msg/NavSatFix",
            header=make_header(factory, int(time_ns[stamp]), "gnss"),
            status=factory.make("sensor_msgs/msg/NavSatStatus", status=_FIX, service=_GPS),
            latitude=float(latitude_deg[value]),
            longitude=float(longitude_deg[value]),
            altitude=float(position.height_m + noise_m[value, 2]),
            position_covariance=covariance,
            position_covariance_type=_DIAGONAL_KNOWN,
        )

    return make


def weather_makers(time_ns: np.ndarray, weather: Weather, factory: MessageFactory) -> dict[str, Maker]:
    """Makers of met/pressure (Pa), met/temperature (°C) and met/humidity (0 to 1) by topic."""
    values = {
        "met/pressure": ("sensor_msgs/msg/FluidPressure", "fluid_pressure", 100.0 * weather.pressure_hpa),
        "met/temperature": ("sensor_msgs/msg/Temperature", "temperature", weather.temperature_c),
        "met/humidity": ("sensor_msgs/msg/RelativeHumidity", "relative_humidity", 0.01 * weather.humidity_percent),
    }
    return {topic: _constant_maker(time_ns, *content, factory) for topic, content in values.items()}


def _constant_maker(time_ns: np.ndarray, type_name: str, field: str, constant: float, factory: MessageFactory) -> Maker:
    def make(stamp: int, value: int) -> object:
        header = make_header(factory, int(time_ns[stamp]), "met")
        # A variance of zero says unknown.
        return factory.make(type_name, header=header, variance=0.0, **{field: constant})

    return make
